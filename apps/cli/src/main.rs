//! The blindaug command line: estimates a camera's noise, motion blur and defocus from its footage, and composites virtual objects
//! so that they look filmed by it.

mod composite;
mod console;
mod demo;
mod estimate;
mod export;
mod inspect;
#[cfg(feature = "live")]
mod live;
mod models;
mod networks;
mod report;
mod validate;

use clap::Parser;
use console::Failure;
use std::{io::Write, process::ExitCode};

// Whole images are allocated and freed all the time: see the note in Cargo.toml.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Makes rendered objects look filmed: estimates a camera's noise, motion blur and defocus from its footage alone, and
/// gives virtual layers the same.
#[derive(Parser)]
#[command(name = "blindaug", version, max_term_width = 110, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    Demo(demo::Demo),
    Estimate(Box<estimate::Estimate>),
    Composite(Box<composite::Composite>),
    Apply(Box<composite::Apply>),
    Inspect(inspect::Inspect),
    Export(export::Export),
    Validate(validate::Validate),
    Models(models::Models),
    #[cfg(feature = "live")]
    Live(live::Live),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    console::catch_interrupt();
    let result = match &cli.command {
        Command::Demo(args) => demo::run(args),
        Command::Estimate(args) => estimate::run(args),
        Command::Composite(args) => composite::run(args),
        Command::Apply(args) => composite::run_apply(args),
        Command::Inspect(args) => inspect::run(args),
        Command::Export(args) => export::run(args),
        Command::Validate(args) => validate::run(args),
        Command::Models(args) => models::run(args),
        #[cfg(feature = "live")]
        Command::Live(args) => live::run(args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure(sentence)) => {
            // Standard error may be closed; there is nobody else to tell.
            let _ = writeln!(std::io::stderr(), "blindaug: {sentence}");
            ExitCode::FAILURE
        }
    }
}

/// Parses a number > 0.
fn positive(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err("it must be a number greater than 0".into()),
    }
}

/// Parses a frame rate.
fn frame_rate(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err("frames per second must be a number greater than 0".into()),
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_arguments_are_consistent() {
        use clap::CommandFactory;
        super::Cli::command().debug_assert();
    }
}
