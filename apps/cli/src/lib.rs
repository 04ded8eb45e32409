//! The common parts of this project's command-line programs: messages, the signals that stop a program, exit statuses, and arguments that
//! several commands share. The binary `blindaug` and the program `blindaug-live` are built on this library, which computes nothing.

pub mod arguments;
pub mod console;
pub mod output;
