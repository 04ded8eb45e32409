//! The program `blindaug`, which is [`blindaug_cli::run`].

use std::process::ExitCode;

// Whole images are allocated and freed all the time: see the note in Cargo.toml.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    ExitCode::from(blindaug_cli::run(std::env::args_os().collect()))
}
