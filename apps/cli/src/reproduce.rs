//! `blindaug reproduce`: the experiments of the paper.

use crate::console::{self, CONSOLE, Result, note};
use crate::validate::finish;
use blindaug_io::{FrameRange, FrameSource, Inputs};
use blindaug_pipeline::Networks;
use blindaug_research::experiments::Experiment;
use blindaug_research::run::{Provenance, Run};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::path::PathBuf;

/// Run the paper's experiments: tables (CSV, LaTeX), figures (SVG, PDF), pictures, and a page with all of them
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug reproduce --quick -o results")]
pub struct Reproduce {
    /// The experiments [default: all]
    #[arg(value_name = "EXPERIMENT", value_parser = experiments())]
    experiments: Vec<Experiment>,
    /// A folder for the results: index.html, reproduce.json, and a folder per experiment; a run that was stopped goes on
    #[arg(short, long, value_name = "DIR", default_value = "blindaug-reproduce")]
    output: PathBuf,
    /// Smaller pictures and fewer scenes and settings: about six minutes on two cores instead of hours
    #[arg(long)]
    quick: bool,
    /// For `cameras`: a real clip, each of another camera; may be repeated. The model of one half of a clip is tried on the other halves
    #[arg(long, value_name = "CLIP")]
    footage: Vec<PathBuf>,
    /// The seed of scenes, noise and everything else that is drawn at random
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u64).range(..1_000_000))]
    seed: u64,
    /// Do everything anew, also what is there already
    #[arg(long)]
    overwrite: bool,
}

fn experiments() -> impl TypedValueParser<Value = Experiment> {
    PossibleValuesParser::new(Experiment::ALL.map(|e| PossibleValue::new(e.name()).help(e.about()))).map(
        |name| Experiment::ALL.into_iter().find(|e| e.name() == name).expect("the parser knows the names"),
    )
}

/// Runs the command.
pub fn run(args: &Reproduce) -> Result<()> {
    Inputs::of(args.footage.iter()).check_output_folder(&args.output, |_| true)?;
    // What cannot be opened is told now, not after an hour.
    for clip in &args.footage {
        FrameSource::open(clip, FrameRange::default())?;
    }
    let all = if args.experiments.is_empty() { Experiment::ALL.to_vec() } else { args.experiments.clone() };
    let minutes: f64 = all.iter().map(|e| e.minutes(args.quick)).sum();
    let time = if minutes > 100.0 {
        format!("about {:.0} hours", minutes / 60.0)
    } else if minutes > 1.5 {
        format!("about {minutes:.0} minutes")
    } else {
        "about a minute".into()
    };
    note(format_args!(
        "this takes {time} on two cores, less what is done already; Ctrl-C stops it, and the same command goes on"
    ));
    let mut networks = Networks::named(&[], true, CONSOLE)?;
    let run = Run::new(&args.output, Provenance::here(args.seed), args.overwrite, CONSOLE)?;
    let mut findings = vec![];
    for experiment in all {
        let found = experiment.run(&run, args.quick, &args.footage, &mut networks)?;
        for table in &found.tables {
            console::print(&format!("{}\n", table.text()))?;
        }
        findings.push(found);
        if console::interrupted() {
            break;
        }
    }
    let page = run.write("reproduce", "Blind Augmentation, reproduced", &findings)?;
    finish(&run, &args.output, &page)
}
