//! The blindaug command line: estimates a camera's noise, motion blur and defocus from its footage, and composites virtual objects
//! so that they look filmed by it.
//!
//! All of it is [`run`], which the program `blindaug` calls, and the command of the Python package. What it computes is in the crates below
//! it. Messages, signals, exit statuses and the arguments that several commands share are public, for the program `blindaug-live`.

pub mod arguments;
mod composite;
pub mod console;
mod demo;
mod estimate;
mod export;
mod frames;
mod inspect;
mod live;
mod models;
pub mod output;
mod provenance;
mod reproduce;
mod shell;
mod source;
mod study;
mod validate;

use arguments::memory_size;
use clap::{
    CommandFactory, FromArgMatches, Parser,
    builder::styling::{AnsiColor, Styles},
};
use std::{ffi::OsString, fmt::Write};

/// The colours of help on a terminal.
const STYLES: Styles = Styles::styled()
    .header(AnsiColor::Yellow.on_default().bold())
    .usage(AnsiColor::Yellow.on_default().bold())
    .literal(AnsiColor::Green.on_default().bold())
    .placeholder(AnsiColor::Cyan.on_default());

/// The commands by what they are for, with an example of each group.
const GROUPS: [(&str, &[&str], &str); 4] = [
    (
        "From footage to a composite",
        &["demo", "estimate", "composite", "apply", "inspect", "export", "live"],
        "blindaug estimate shot.mp4 -o camera.json --report report.html",
    ),
    (
        "Footage alone",
        &["match", "frames"],
        "blindaug match b.mp4 --from camera_b.json --to camera_a.json -o out/",
    ),
    ("Research", &["validate", "reproduce", "study"], "blindaug reproduce --quick -o results"),
    (
        "Networks, the shell, manuals",
        &["models", "completions", "man"],
        "blindaug models install ffdnet-color",
    ),
];

/// The command line with its commands in groups: clap itself lists them without.
fn command_line() -> clap::Command {
    let command = Cli::command();
    let width = command.get_subcommands().map(|c| c.get_name().len()).max().unwrap_or(0);
    let (head, literal) = (STYLES.get_header(), STYLES.get_literal());
    let mut text = String::new();
    for (group, names, example) in GROUPS {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{head}{group}:{head:#}");
        for name in names {
            let about = command.find_subcommand(name).and_then(clap::Command::get_about);
            let about = about.map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(text, "  {literal}{name:width$}{literal:#}  {about}");
        }
        let _ = writeln!(text, "  for example: {example}\n");
    }
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{text}{head}Options:{head:#}\n{{options}}\n\n\
         blindaug help COMMAND says all of a command; blindaug demo needs nothing else.\n"
    );
    command.help_template(template)
}

/// Makes rendered objects look filmed: estimates a camera's noise, motion blur and defocus from its footage alone, and
/// gives virtual layers the same.
#[derive(Parser)]
#[command(name = "blindaug", version, max_term_width = 110, arg_required_else_help = true, styles = STYLES)]
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

/// Runs the command line of these arguments, of which the first is the program's name, and gives the exit status: 0, or 1 after one
/// sentence on standard error, or 2 for wrong usage, or what shells make of the signal that stopped it.
///
/// Most commands catch the signals that ask a program to end, for the rest of the process; a second signal ends the process.
pub fn run(arguments: Vec<OsString>) -> u8 {
    let parsed = command_line().try_get_matches_from(&arguments).and_then(|m| Cli::from_arg_matches(&m));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(e) => return console::said(&e),
    };
    provenance::begin(&arguments);
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
        super::command_line().debug_assert();
    }

    #[test]
    fn every_command_stands_in_one_group() {
        use clap::CommandFactory;
        let mut grouped: Vec<&str> = super::GROUPS.iter().flat_map(|g| g.1).copied().collect();
        let mut all: Vec<String> =
            super::Cli::command().get_subcommands().map(|c| c.get_name().to_owned()).collect();
        grouped.sort_unstable();
        all.sort_unstable();
        assert_eq!(grouped, all);
    }
}
