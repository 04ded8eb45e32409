//! What the programs of this project have in common on a command line: what they say, the signals that stop them, their exit statuses,
//! and arguments that several commands share. The binary `blindaug` and the program `blindaug-live` are built on it; it computes
//! nothing.

pub mod arguments;
pub mod console;
pub mod output;
