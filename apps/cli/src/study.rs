//! `blindaug study`: the kit of the paper's user study.

use blindaug_cli::console::{self, CONSOLE, Result, failure, note};
use blindaug_io::{Error, Inputs};
use blindaug_research::run::{Provenance, Run};
use blindaug_research::study::{REAL, analyse, findings, read_answers};
use std::path::PathBuf;

/// Run the paper's user study anew: analyse its answers
#[derive(clap::Args)]
pub struct Study {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    Analyse(Analyse),
}

/// Say what the answers of a study show: shares, tests, a bootstrap over participants, plots, LaTeX, and how many participants the next
/// study needs
#[derive(clap::Args)]
struct Analyse {
    /// The participants' answers: CSV files with the columns participant, task, scene, method, answer
    #[arg(required = true, value_name = "ANSWERS.csv")]
    answers: Vec<PathBuf>,
    /// A folder for the results: index.html, and tables and plots in study/
    #[arg(short, long, value_name = "DIR", default_value = "blindaug-study")]
    output: PathBuf,
    /// The method with which the others are compared
    #[arg(long, value_name = "METHOD", default_value = "Ours")]
    reference: String,
    /// The seed of the bootstrap
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
}

/// Runs the command.
pub fn run(args: &Study) -> Result<()> {
    match &args.command {
        Command::Analyse(args) => run_analyse(args),
    }
}

fn run_analyse(args: &Analyse) -> Result<()> {
    let answers = read_answers(&args.answers)?;
    let methods = || answers.all.iter().map(|a| &*a.method).filter(|m| *m != REAL);
    let Some(reference) = methods().find(|m| m.eq_ignore_ascii_case(&args.reference)) else {
        let mut all: Vec<&str> = methods().collect();
        all.sort_unstable();
        all.dedup();
        let sentence =
            format!("has no answers on the method {}; name one of: {}", args.reference, all.join(", "));
        return Err(failure(&args.answers[0], sentence));
    };
    Inputs::of(args.answers.iter()).check_output_folder(&args.output, |_| true)?;
    for n in &answers.notes {
        note(n);
    }
    let found = findings(&analyse(&answers.all, reference, args.seed), &answers);
    let run = Run::new(&args.output, Provenance::here(args.seed), false, CONSOLE)?;
    let page = run.write("study", "User study", std::slice::from_ref(&found))?;
    for table in &found.tables {
        console::print(&format!("{}\n", table.text()))?;
    }
    note(format_args!("written: {}", Error::shown_path(&page)));
    Ok(())
}
