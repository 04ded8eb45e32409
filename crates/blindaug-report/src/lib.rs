//! Reports of an estimated camera, as a page of HTML without outside resources or in words: a model and its diagnostics in, a `String` out.
//!
//! [`page`] reports one model, [`track_page`] a model for each frame, [`words`] both in plain text. Nothing here reads or writes a file.
//!
//! ```
//! use blindaug::CameraModel;
//! use blindaug::fit::Diagnostics;
//! use blindaug::model::{Capture, Estimate, ExposureFraction, MotionBlurModel};
//! use blindaug_report::{ReportInput, page, words};
//!
//! let capture = Capture { width: 640, height: 480, fps: Some(25.0), frames_used: 5, pixel_aspect: 1.0 };
//! let mut model = CameraModel::unknown(capture, "nobody looked");
//! model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.5)));
//! let diagnostics = Diagnostics::default();
//! let html = page(&ReportInput::new("My clip", &model, &diagnostics))?;
//! assert!(html.contains("180°") && html.contains("nobody looked"));
//! assert!(words::words(&model, &[]).contains("a shutter angle of 180 degrees"));
//! # Ok::<(), blindaug_report::Error>(())
//! ```

mod balls;
mod clip;
mod defocus;
mod depth_map;
mod error;
mod exposure;
mod noise;
mod numbers;
mod page;
mod pictures;
pub mod plots;
mod samples;
mod track;
mod two_sample;
pub mod words;

use blindaug::fit::Diagnostics;
use blindaug::model::CameraTrack;
use blindaug::{CameraModel, Encoded, Sample};
pub use error::{Error, Result};
pub use numbers::tidy;
pub use page::page_with;
pub use pictures::{Shown, shown};

/// The contents of a report.
pub struct ReportInput<'a> {
    /// Heading of the page, such as the clip's name.
    pub title: String,
    /// The estimated model.
    pub model: &'a CameraModel,
    /// The measurements on which the model rests.
    pub diagnostics: &'a Diagnostics,
    /// A few frames with what is known of their motion and depth.
    pub samples: Vec<Sample>,
    /// Estimated beside true values, where the truth is known.
    pub comparison: Vec<TruthRow>,
    /// More pictures, such as composites.
    pub pictures: Vec<Picture>,
    /// The numbers of the frames that the estimator was given, in their order. Frames that are missing here are counted from 1.
    pub numbers: Vec<u64>,
    /// Where the estimate comes from.
    pub provenance: Option<Provenance>,
}

/// Where an estimate comes from, for a line of its report.
#[derive(Clone, Debug, PartialEq)]
pub struct Provenance {
    /// The command line.
    pub command: String,
    /// The version of the program.
    pub version: String,
    /// The date and the time.
    pub date: String,
    /// What was read.
    pub inputs: Vec<ReadInput>,
}

/// An input of an estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadInput {
    /// The input's name.
    pub name: String,
    /// Its SHA-256, and what was hashed; `None` where there is nothing to hash, as of a live camera.
    pub sha256: Option<(String, String)>,
}

/// A row of the table of estimated and true values.
pub struct TruthRow {
    /// The name of the quantity, with its unit.
    pub name: String,
    /// The estimated value.
    pub estimated: String,
    /// The true value.
    pub truth: String,
}

/// A picture with a title.
pub struct Picture {
    /// The caption below the picture.
    pub title: String,
    /// The picture.
    pub image: Encoded,
}

impl<'a> ReportInput<'a> {
    /// The report of a model alone, without frames, truth or pictures.
    pub fn new(title: &str, model: &'a CameraModel, diagnostics: &'a Diagnostics) -> Self {
        let (samples, comparison, pictures, numbers) = (vec![], vec![], vec![], vec![]);
        let (title, provenance) = (title.into(), None);
        Self { title, model, diagnostics, samples, comparison, pictures, numbers, provenance }
    }
}

/// The contents of the report of a track.
pub struct TrackReportInput<'a> {
    /// Heading of the page, such as the clip's name.
    pub title: String,
    /// The estimated model of each frame.
    pub track: &'a CameraTrack,
    /// A few frames with what is known of their motion and depth.
    pub samples: Vec<Sample>,
    /// Where the estimate comes from.
    pub provenance: Option<Provenance>,
}

/// The page of one model.
///
/// # Errors
/// If a plot cannot be drawn.
pub fn page(input: &ReportInput) -> Result<String> {
    Ok(clip::page(input)?.into_string())
}

/// The page of a track, which has a model for each frame: each number over time.
///
/// # Errors
/// If a plot cannot be drawn.
pub fn track_page(input: &TrackReportInput) -> Result<String> {
    Ok(track::page(input)?.into_string())
}

#[cfg(test)]
mod tests;
