//! Live estimation: the camera and the place of an object, frame by frame.

mod estimate;
mod frames;
mod placement;
#[cfg(feature = "threads")]
mod player;
#[cfg(feature = "files")]
mod source;

pub use estimate::{Home, LiveEstimate, LiveEstimator};
pub use frames::{LiveFrame, Loop};
pub use placement::{Pinhole, Placed, Placement, Pose};
#[cfg(feature = "threads")]
pub use player::{Pace, Player};
#[cfg(feature = "files")]
pub use source::{names_camera, open};
