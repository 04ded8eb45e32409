//! `blindaug completions` and `blindaug man`: what a shell and a manual reader know of the command line.

use crate::console::{Result, note, print};
use blindaug_io::{check_folder, make_folder, write_atomically};
use blindaug_report::words::count;
use clap::Command;
use clap_complete::{Shell, generate};
use std::path::PathBuf;

/// Print a script with which a shell completes blindaug's commands and options
#[derive(clap::Args)]
pub struct Completions {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Write manual pages, one for each command
#[derive(clap::Args)]
pub struct Man {
    /// A folder for the pages, such as ~/.local/share/man/man1
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// Runs `completions`.
pub fn completions(args: &Completions, mut command: Command) -> Result<()> {
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    generate(args.shell, &mut command, name, &mut script);
    print(&String::from_utf8_lossy(&script))
}

/// Runs `man`.
pub fn man(args: &Man, command: Command) -> Result<()> {
    let folder = &args.output;
    check_folder(folder)?;
    if !folder.exists() {
        make_folder(folder)?;
    }
    let mut command = command.disable_help_subcommand(true);
    // This gives each command its whole name.
    command.build();
    let all = with_subcommands(&command);
    for command in &all {
        let page = clap_mangen::Man::new(command.clone());
        let path = folder.join(page.get_filename());
        write_atomically(path, |partial| page.render(&mut std::fs::File::create(partial)?))?;
    }
    note(format_args!("{}: {} written", folder.display(), count(all.len() as u64, "page")));
    Ok(())
}

/// A command, its subcommands, and theirs.
fn with_subcommands(command: &Command) -> Vec<Command> {
    let below = command.get_subcommands().filter(|c| !c.is_hide_set());
    [command.clone()].into_iter().chain(below.flat_map(with_subcommands)).collect()
}
