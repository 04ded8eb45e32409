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
mod validate;

use clap::Parser;
use console::Failure;
use std::{
    io::{IsTerminal, Write},
    ops::RangeInclusive,
    process::ExitCode,
};

// Whole images are allocated and freed all the time: see the note in Cargo.toml.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Makes rendered objects look filmed: estimates a camera's noise, motion blur and defocus from its footage alone, and
/// gives virtual layers the same.
#[derive(Parser)]
#[command(name = "blindaug", version, max_term_width = 110, arg_required_else_help = true)]
struct Cli {
    /// How much memory may be taken: a number with M or G (millions or billions of bytes), from 64M to 1000G [default: half of what
    /// the machine has]
    #[arg(long, global = true, value_name = "SIZE", value_parser = memory_size)]
    memory: Option<u64>,
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
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => return said(&e),
    };
    if let Some(bytes) = cli.memory {
        blindaug_io::memory::set_budget(bytes);
    }
    console::catch_size_limit();
    // The others end at once.
    if !matches!(cli.command, Command::Models(_) | Command::Inspect(_)) {
        console::catch_signals();
    }
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
        Err(failure) => failed(&failure),
    }
}

/// Says why a command failed.
fn failed(Failure(sentence): &Failure) -> ExitCode {
    // Standard error may be closed; there is nobody else to tell.
    let _ = writeln!(std::io::stderr(), "blindaug: {}", console::for_terminal(sentence));
    ExitCode::from(console::exit_status())
}

/// Prints what the argument parser has to say: help, or what is wrong with the arguments.
fn said(e: &clap::Error) -> ExitCode {
    if e.use_stderr() {
        let _ = write!(std::io::stderr(), "{}", console::for_terminal(&e.render().to_string()));
        return ExitCode::from(2);
    }
    let help = e.render();
    let help = if std::io::stdout().is_terminal() { help.ansi().to_string() } else { help.to_string() };
    match console::print(&help) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failed(&failure),
    }
}

/// Parses a number in a range.
fn within(text: &str, range: RangeInclusive<f64>) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(v) if range.contains(&v) => Ok(v),
        _ => Err(format!("it must be a number from {} to {}", range.start(), range.end())),
    }
}

/// Parses a size of memory, to bytes.
fn memory_size(text: &str) -> Result<u64, String> {
    const RANGE: std::ops::RangeInclusive<f64> = 64e6..=1000e9;
    let text = text.trim();
    let unit = match text.chars().last() {
        Some('M' | 'm') => 1e6,
        Some('G' | 'g') => 1e9,
        _ => f64::NAN,
    };
    let number = text.get(..text.len().saturating_sub(1)).and_then(|n| n.parse::<f64>().ok());
    match number.map(|n| n * unit) {
        Some(bytes) if RANGE.contains(&bytes) => Ok(bytes as u64),
        _ => Err("give a number with M or G (millions or billions of bytes), from 64M to 1000G".into()),
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
    fn sizes_of_memory_are_parsed() {
        for (text, bytes) in
            [("4G", 4_000_000_000), ("1500M", 1_500_000_000), ("0.5g", 500_000_000), ("64m", 64_000_000)]
        {
            assert_eq!(super::memory_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "4", "4K", "4GB", "-4G", "63M", "1001G", "nanG", "infG", "4 é"] {
            assert!(super::memory_size(text).is_err(), "{text}");
        }
    }

    #[test]
    fn the_arguments_are_consistent() {
        use clap::CommandFactory;
        super::Cli::command().debug_assert();
    }
}
