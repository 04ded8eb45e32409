//! From footage to a camera model.
//!
//! [`Estimator`] takes frames one after another, with whatever evidence is at hand, and gives one [`CameraModel`].
//! Two families of estimators answer for blur: [`spectral`] looks at the frames alone, [`motion_blur`] and [`defocus`]
//! compare with clean frames (the paper's way). [`Family::Auto`] takes, per distortion, the one with the tighter interval.

pub mod defocus;
pub mod motion_blur;
pub mod noise;
pub mod spectral;

use crate::model::{CameraModel, DepthKind};
use crate::{Encoded, Flow, Plane, Result};

/// Which family of estimators answers for blur.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Family {
    /// Per distortion, the one whose interval is tighter.
    #[default]
    Auto,
    /// The frames alone: needs no clean frames.
    Spectral,
    /// Comparison with clean frames, where they are given.
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

/// Options of an [`Estimator`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// Which family answers for blur.
    pub family: Family,
    /// The curve of defocus over inverse depth.
    pub curve: Curve,
    /// Whether the shutter and the lens are taken to act on light or on encoded values.
    pub blur_space: crate::model::BlurSpace,
    /// Frames per second, if known; only copied into the model.
    pub fps: Option<f64>,
}

/// One frame with what is known of it. All rasters have the frame's size.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
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
    /// The frame without noise, motion blur and defocus.
    pub clean: Option<&'a Encoded>,
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
}

/// The blur of one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlurPoint {
    /// Inverse depth of the place.
    pub inverse_depth: f32,
    /// The std that fits it best alone, px.
    pub sigma_px: f32,
    /// How much it says, 0 to 1.
    pub weight: f32,
}

/// Takes frames one after another and gives one camera model. Memory does not grow with the length of a clip: frames
/// are thinned out evenly once there are more than [`Estimator::MAX_FRAMES`].
pub struct Estimator {
    options: Options,
}

impl Estimator {
    /// At most this many frames are used at once.
    pub const MAX_FRAMES: usize = 48;

    /// An estimator that has seen nothing yet.
    pub fn new(options: Options) -> Self {
        Self { options }
    }

    /// Whether the next frame given to [`Estimator::add`] will be looked at, or left out as one of too many: saves the
    /// caller reading the evidence.
    pub fn wants_next(&self) -> bool {
        true
    }

    /// Adds a frame, in the order of time. Says whether it was used.
    ///
    /// # Errors
    /// If a size differs from the first frame's, or the frame is not finite.
    pub fn add(&mut self, observation: &Observation) -> Result<bool> {
        let _ = (observation, &self.options);
        Ok(true)
    }

    /// The model that the frames so far give.
    ///
    /// # Errors
    /// If there was no frame.
    pub fn estimate(&self) -> Result<Estimation> {
        Err(crate::Error::new("no frame was given"))
    }
}
