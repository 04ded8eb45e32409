//! `blindaug frames`: doubled, dropped and interpolated frames of a clip.

use crate::console::{self, CONSOLE, Result, failure, note};
use crate::source::SourceArgs;
use blindaug::fit::timing::{Event, Finding, Interpolation, Kind, Timing};
use blindaug_io::{Error, Inputs, write_atomically};
use blindaug_pipeline::timing::{self, Timed};
use blindaug_report::{tidy, words::count};
use serde_json::{Value, json};
use std::{collections::BTreeMap, fmt::Write, path::PathBuf};

/// Find doubled, dropped and interpolated frames of a clip
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug frames clip.mp4 -o report.json")]
pub struct Frames {
    /// The clip: a video, or a folder of images in the order of the numbers in their names
    input: PathBuf,
    /// Where to write the findings, with their evidence, as JSON
    #[arg(short, long, value_name = "report.json")]
    output: Option<PathBuf>,
    #[command(flatten)]
    source: SourceArgs,
}

/// Runs the command.
pub fn run(args: &Frames) -> Result<()> {
    let output = args.output.as_deref();
    console::check_outputs(&Inputs::of([&args.input]), output)?;
    let source = args.source.open(&args.input)?;
    let Timed { timing, first, last, stopped } = timing::timing(&source, source.space().transfer, CONSOLE)?;
    let name = Error::shown_path(&args.input);
    let table = table(&name, &timing);
    match output {
        None => console::print(&table)?,
        Some(path) => {
            let mut report = json!(timing);
            report["clip"] = json!(name);
            (report["first"], report["last"]) = (json!(first), json!(last));
            report["stopped"] = stopped.map_or(Value::Null, |s| json!(s));
            let text = serde_json::to_string_pretty(&tidy(report)).unwrap_or_default() + "\n";
            write_atomically(path, |partial| std::fs::write(partial, text))?;
            console::print_beside(path, &table)?;
            note(format_args!("written: {}", path.display()));
        }
    }
    match stopped {
        None => Ok(()),
        Some(_) => Err(failure(
            &args.input,
            format_args!(
                "stopped: only frames {first} to {last} were looked at; for the others, run it again with --frames {}..",
                last + 1
            ),
        )),
    }
}

/// The findings as a table, and what could not be told.
fn table(name: &str, timing: &Timing) -> String {
    let mut text =
        format!("{name}: {} in {}", count(timing.frames as u64, "frame"), count(timing.shots as u64, "shot"));
    if let Some(exposure) = timing.exposure {
        let _ = write!(text, ", exposure about {exposure:.2} of the frame interval");
    }
    text.push('\n');
    for finding in &timing.findings {
        let _ = writeln!(text, "  {}", line(finding));
    }
    for kind in Kind::ALL {
        let found = timing.findings.iter().filter(|f| f.event.kind() == kind).count();
        let cadence = timing.cadences.iter().find(|c| c.kind == kind);
        let regular = match cadence {
            Some(c) if c.of_period == 1 => format!(", regularly one of every {} frames", c.period),
            Some(c) => format!(", regularly {} of every {} frames", c.of_period, c.period),
            None => String::new(),
        };
        let mut untold: BTreeMap<&str, u64> = BTreeMap::new();
        for u in timing.unknown.iter().filter(|u| u.kind == kind) {
            *untold.entry(u.reason.words()).or_default() += u.last + 1 - u.first;
        }
        let untold: Vec<String> = untold.iter().map(|(why, n)| format!("{n} unknown: {why}")).collect();
        let untold = if untold.is_empty() { String::new() } else { format!(" ({})", untold.join("; ")) };
        let _ = writeln!(text, "{}: {found}{regular}{untold}", kind.name());
    }
    text
}

/// A finding in words and numbers.
fn line(Finding { frame, event, log_likelihood_ratio }: &Finding) -> String {
    let what = match event {
        Event::Doubled { difference, expected } => {
            format!(
                "frame {frame} is doubled: it differs by {difference:.2}/255 from the one before, frames around by {expected:.2}/255"
            )
        }
        Event::Dropped { missing, motion_ratio, streaks } => {
            let missing = count(u64::from(*missing), "frame");
            let streaks =
                streaks.map_or("streaks tell nothing".into(), |s| format!("streaks tell {s:+.1} nats"));
            format!(
                "{missing} missing between {frame} and {}: {motion_ratio:.2} times the motion around, {streaks}",
                frame + 1
            )
        }
        Event::Interpolated { how, share, to_blend, to_warp, detail } => {
            let (how, by) = match how {
                Interpolation::Blend => ("blended", to_blend),
                Interpolation::Warp => ("warped", to_warp),
            };
            format!(
                "frame {frame} is {how} from its neighbours: it differs by {by:.2}/255 from {share:.2} of the next and the rest of the one before, and has {detail:.2} of their finest detail"
            )
        }
    };
    format!("{what} ({log_likelihood_ratio:.1} nats)")
}
