//! What goes into an estimator and what comes out.

use super::defocus::BlurPoint;
use super::noise;
use crate::model::{BlurSpace, CameraModel, DepthKind, Estimate, MotionBlurModel};
use crate::{Encoded, Flow, Plane};
use std::ops::Range;

/// Which family of estimators answers for blur.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Family {
    /// Per distortion, the one whose interval is tighter: of the spectra and, where clean frames are given, of the comparison
    /// with them.
    #[default]
    Auto,
    /// The spectra of the frames.
    Spectral,
    /// Comparison with clean frames where they are given, else with what [`super::removal`] makes of the frames.
    Removal,
}

/// The curve of defocus over inverse depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Curve {
    /// A thin lens.
    #[default]
    ThinLens,
    /// The paper's quadratic.
    Quadratic,
}

/// The options of an [`super::Estimator`].
#[derive(Clone, Copy, Debug, Default)]
pub struct EstimatorOptions {
    /// Which family answers for blur.
    pub family: Family,
    /// The curve of defocus over inverse depth.
    pub curve: Curve,
    /// Whether the shutter and the lens are taken to act on light or on encoded values.
    pub blur_space: BlurSpace,
    /// Frames per second, if known; only copied into the model.
    pub fps: Option<f64>,
}

/// One frame with what is known of it. All rasters have the frame's size.
#[derive(Clone, Copy, Debug)]
pub struct FrameObservation<'a> {
    /// The frame.
    pub frame: &'a Encoded,
    /// The frame after it; without both neighbours there is no motion to see.
    pub next: Option<&'a Encoded>,
    /// The frame before it; used where there is no next one.
    pub previous: Option<&'a Encoded>,
    /// What else is known.
    pub evidence: Evidence<'a>,
}

/// What may be known of a frame beside its pixels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evidence<'a> {
    /// Optical flow to the next frame; estimated from the frames if not given.
    pub flow: Option<&'a Flow>,
    /// Inverse depth, NaN where there is no reading, and what it is measured in; estimated from parallax if not given.
    pub inverse_depth: Option<(&'a Plane, DepthKind)>,
    /// The frame without noise, blurred as it is.
    pub denoised: Option<&'a Encoded>,
    /// The frame without noise and motion blur.
    pub motion_deblurred: Option<&'a Encoded>,
    /// The frame without noise and defocus, its motion blur still there.
    pub defocus_deblurred: Option<&'a Encoded>,
    /// The frame without noise, motion blur and defocus.
    pub clean: Option<&'a Encoded>,
    /// Whether these images are what a network made of the frame, not known: what it leaves of blur and noise widens the intervals.
    pub by_network: bool,
}

/// What an estimator gives.
#[derive(Clone, Debug)]
pub struct Estimation {
    /// The model.
    pub model: CameraModel,
    /// What it rests on.
    pub diagnostics: Diagnostics,
}

/// What an estimate rests on, for plots and messages.
#[derive(Clone, Debug, Default)]
pub struct Diagnostics {
    /// Sentences for the user: what was chosen and why, what was left out.
    pub notes: Vec<String>,
    /// Measured points of the noise curves.
    pub noise_points: Vec<noise::NoisePoint>,
    /// Log-likelihood (spectral) or minus the scaled error (removal) over the exposure fraction, 0 at its maximum.
    pub exposure_curve: Vec<[f32; 2]>,
    /// Local blur over inverse depth.
    pub blur_points: Vec<BlurPoint>,
    /// The exposure that each frame alone gives: (index of the frame among those added, exposure fraction).
    pub exposure_per_frame: Vec<(usize, f32)>,
    /// The shots, if there is a cut between the frames; else empty.
    pub shots: Vec<Shot>,
    /// Inverse depth of the last frame that has it, as it was used (NaN: unknown), and the frame's index.
    pub inverse_depth: Option<(usize, Plane)>,
}

/// The frames between two cuts.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Their indices among those added.
    pub frames: Range<usize>,
    /// The exposure that they alone give.
    pub motion_blur: Estimate<MotionBlurModel>,
}
