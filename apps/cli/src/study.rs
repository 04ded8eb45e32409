//! `blindaug study`: the kit of the paper's user study.

use crate::console::{self, CONSOLE, Result, failure, note};
use blindaug_io::{Error, Inputs, VideoWriter};
use blindaug_research::run::{Provenance, Run};
use blindaug_research::study::{REAL, analyse, findings, make, read_answers};
use std::path::PathBuf;

/// Run the paper's user study anew: make its stimuli and its questionnaire, analyse the answers
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug study make --quick -o kit")]
pub struct Study {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    Make(Make),
    Analyse(Analyse),
}

/// Make the kit of the study: stills and 8 s clips of six scenes by five methods and with the object really there, and a page that asks
/// the questions, works without a network and gives the answers as CSV. Takes half an hour to an hour on two cores; Ctrl-C stops it, and the
/// same command goes on
#[derive(clap::Args)]
struct Make {
    /// A folder for the kit: questionnaire.html, stimuli.csv, and the stimuli in stimuli/
    #[arg(short, long, value_name = "DIR", default_value = "blindaug-kit")]
    output: PathBuf,
    /// The seed of the scenes, of the noise, and of the participants' orders
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u64).range(..1_000_000))]
    seed: u64,
    /// Small stimuli and short clips, to look at: two minutes
    #[arg(long)]
    quick: bool,
    /// Only stills, no clips; without the ffmpeg program there are no clips anyway
    #[arg(long)]
    no_clips: bool,
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
        Command::Make(args) => run_make(args),
        Command::Analyse(args) => run_analyse(args),
    }
}

fn run_make(args: &Make) -> Result<()> {
    Inputs::default().check_output_folder(&args.output, |_| true)?;
    let has_encoder = VideoWriter::is_available();
    if !has_encoder && !args.no_clips {
        note("no ffmpeg program found: the kit has stills alone, and the task Consistency is left out");
    }
    let run = Run::new(&args.output, Provenance::here(args.seed), false, CONSOLE)?;
    match make(&run, args.quick, has_encoder && !args.no_clips)? {
        Some(kit) => {
            note(format_args!(
                "written: {} ({} stimuli, {:.1} MB); give it to each participant with ?participant=NAME behind its address",
                Error::shown_path(&kit.page),
                kit.stimuli,
                kit.bytes as f64 / 1e6
            ));
            Ok(())
        }
        None => {
            let [_, done, all] = run.counts();
            let sentence =
                format!("stopped after {done} of {all} scenes; run the same command again to go on");
            Err(failure(&args.output, sentence))
        }
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
