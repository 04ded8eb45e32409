//! The user study of the paper: its stimuli, its questionnaire, its answers and what they say.
//!
//! Two tasks, each a question with the answers yes and no. *Identification*: "Is there a virtual object in this image?", where no is the
//! better answer for a method. *Consistency*: "Is blur on the virtual object consistent with the background?", where yes is.

mod analysis;
mod answers;
mod findings;
mod make;
mod questionnaire;

pub use analysis::{Analysis, Comparison, LEVEL, MethodResult, POWER, TaskResult, analyse};
pub use answers::{Answer, Answers, REAL, Task, read_answers};
pub use findings::findings;
pub use make::{Kit, METHODS, make};
pub use questionnaire::{Media, MediaFormat, Stimulus, order, questionnaire};
