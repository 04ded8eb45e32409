//! `blindaug live`: hands over to the program with the window, which is built and installed apart from this one.

use crate::console::{Failure, Result};
use std::{ffi::OsString, path::PathBuf, process::Command};

/// The name of the program with the window.
const PROGRAM: &str = "blindaug-live";

/// Put an animated object into the footage of a camera or a video while it runs (needs the program blindaug-live)
#[derive(clap::Args)]
#[command(disable_help_flag = true)]
pub struct Live {
    /// The arguments that `blindaug live --help` lists
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

/// Runs the command: the program beside this one, or else one on the path.
pub fn run(args: &Live, memory: Option<u64>) -> Result<()> {
    let beside = std::env::current_exe()
        .ok()
        .map(|exe| exe.with_file_name(PROGRAM).with_extension(std::env::consts::EXE_EXTENSION));
    let program = beside.filter(|p| p.is_file()).unwrap_or_else(|| PathBuf::from(PROGRAM));
    let mut command = Command::new(&program);
    command.args(&args.arguments);
    if let Some(bytes) = memory {
        command.arg("--memory").arg(format!("{}M", bytes.div_ceil(1_000_000)));
    }
    let e = replace_by(command);
    match e.kind() {
        std::io::ErrorKind::NotFound => Err(Failure(format!(
            "the program {PROGRAM} is not installed, neither beside this one nor on the path: cargo install --path apps/live (with the source code) \
             builds it"
        ))),
        _ => Err(Failure(format!("{}: cannot be run ({e})", program.display()))),
    }
}

/// Becomes another program, with this one's terminal, signals and exit status.
#[cfg(unix)]
fn replace_by(mut command: Command) -> std::io::Error {
    std::os::unix::process::CommandExt::exec(&mut command)
}

/// Runs another program and ends with its exit status.
#[cfg(not(unix))]
fn replace_by(mut command: Command) -> std::io::Error {
    match command.status() {
        Ok(status) => std::process::exit(status.code().unwrap_or(1)),
        Err(e) => e,
    }
}
