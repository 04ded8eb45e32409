//! The blindaug command line: estimates a camera's noise, motion blur and defocus from its footage, and composites virtual objects
//! so that they look filmed by it.

mod composite;
mod demo;
mod estimate;
mod export;
mod frames;
mod inspect;
mod live;
mod models;
mod reproduce;
mod shell;
mod source;
mod study;
mod validate;

use blindaug_cli::{arguments::memory_size, console};
use clap::{CommandFactory, Parser};
use std::process::ExitCode;

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
    Match(Box<composite::Match>),
    Frames(frames::Frames),
    Inspect(inspect::Inspect),
    Export(export::Export),
    Validate(validate::Validate),
    Reproduce(reproduce::Reproduce),
    Study(study::Study),
    Models(models::Models),
    Live(live::Live),
    Completions(shell::Completions),
    Man(shell::Man),
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => return console::said(&e),
    };
    console::begin(cli.memory);
    // The other commands end at once, or become another program.
    if !matches!(
        cli.command,
        Command::Models(_) | Command::Inspect(_) | Command::Live(_) | Command::Completions(_)
    ) {
        console::catch_signals();
    }
    let result = match &cli.command {
        Command::Demo(args) => demo::run(args),
        Command::Estimate(args) => estimate::run(args),
        Command::Composite(args) => composite::run(args),
        Command::Apply(args) => composite::run_apply(args),
        Command::Match(args) => composite::run_match(args),
        Command::Frames(args) => frames::run(args),
        Command::Inspect(args) => inspect::run(args),
        Command::Export(args) => export::run(args),
        Command::Validate(args) => validate::run(args),
        Command::Reproduce(args) => reproduce::run(args),
        Command::Study(args) => study::run(args),
        Command::Models(args) => models::run(args),
        Command::Live(args) => live::run(args, cli.memory),
        Command::Completions(args) => shell::completions(args, Cli::command()),
        Command::Man(args) => shell::man(args, Cli::command()),
    };
    console::ended(result)
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_arguments_are_consistent() {
        use clap::CommandFactory;
        super::Cli::command().debug_assert();
    }
}
