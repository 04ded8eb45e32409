//! `blindaug inspect`: a camera model in words and units, or per-frame models in a table.

use crate::console::{Result, failure, print, print_words};
use blindaug::model::TrackedCamera;
use blindaug_report::words::{derived, table, words};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Show a camera model in words and units
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug inspect camera.json --at-depth 0.5,1,2")]
pub struct Inspect {
    /// The camera model, or per-frame models
    camera: PathBuf,
    /// Also say the blur at these depths, in metres (in relative inverse depth, if that is what the model has)
    #[arg(long, value_name = "DEPTHS", value_delimiter = ',', value_parser = crate::arguments::positive)]
    at_depth: Vec<f32>,
    /// Print the derived values as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Inspect) -> Result<()> {
    let track = blindaug_io::read_camera_track(&args.camera)?;
    match (track.frames(), args.json) {
        ([one], false) => print_words(&words(&one.camera, &args.at_depth)),
        (_, false) if !args.at_depth.is_empty() => Err(failure(
            &args.camera,
            "it holds a model for each frame, and their table has no blur at depths; with --json each frame tells it",
        )),
        (_, false) => print(&table(&track)),
        (frames, true) => {
            let values: Vec<Value> = frames.iter().map(|f| derived(&f.camera, &args.at_depth)).collect();
            let numbered = |(f, mut value): (&TrackedCamera, Value)| {
                (value["frame"], value["changed"]) = (json!(f.frame), json!(f.changed));
                value
            };
            let value = match <[Value; 1]>::try_from(values) {
                Ok([one]) => one,
                Err(values) => frames.iter().zip(values).map(numbered).collect(),
            };
            let mut text = serde_json::to_string_pretty(&value).unwrap_or_default();
            text.push('\n');
            print(&text)
        }
    }
}
