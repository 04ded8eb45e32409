//! The input and the output of an estimator.

use super::defocus::BlurPoint;
use super::noise;
use crate::model::{CameraModel, DepthKind, Estimate, MotionBlurModel, NoiseKind, Space};
use crate::{Encoded, Flow, Plane};
use std::ops::Range;

/// The family of estimators that measures blur.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Family {
    /// For each distortion the family with the tighter interval: the spectra or, if clean frames are given, the comparison with these.
    #[default]
    Auto,
    /// The spectra of the frames.
    Spectral,
    /// Comparison with clean frames if they are given, else removal of blur from the frames alone ([`super::removal`]).
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
    /// The family of estimators that measures blur; [`Family::Auto`] by default.
    pub family: Family,
    /// The curve of defocus over inverse depth; a thin lens by default.
    pub curve: Curve,
    /// The values that the shutter and the lens are taken to act on, and the curve of the frames' values; light, and sRGB, by default.
    pub space: Space,
    /// The kind of noise model; curves by default.
    pub noise_kind: NoiseKind,
    /// Frames per second, if known, which are only copied into the model.
    pub fps: Option<f64>,
}

/// One frame with its neighbours and its evidence. All rasters have the frame's size.
#[derive(Clone, Copy, Debug)]
pub struct FrameObservation<'a> {
    /// The frame.
    pub frame: &'a Encoded,
    /// The frame after this one; a frame without any neighbour shows no motion.
    pub next: Option<&'a Encoded>,
    /// The frame before this one. The motion at the frame's own time, pairs of tiles and the correlation of noise need it; if there is no next
    /// frame, its flow stands for the motion.
    pub previous: Option<&'a Encoded>,
    /// The evidence beside the pixels.
    pub evidence: Evidence<'a>,
}

impl<'a> FrameObservation<'a> {
    /// The observations of successive frames, each with its neighbours and nothing else.
    pub fn of_frames(frames: &'a [Encoded]) -> impl Iterator<Item = Self> {
        frames.iter().enumerate().map(|(i, frame)| Self {
            frame,
            next: frames.get(i + 1),
            previous: i.checked_sub(1).map(|i| &frames[i]),
            evidence: Evidence::default(),
        })
    }
}

/// Optional knowledge of a frame beside its pixels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evidence<'a> {
    /// Optical flow to the next frame, px; estimated from the frames if not given.
    pub flow: Option<&'a Flow>,
    /// Inverse depth, NaN where there is no reading, and its unit; estimated from parallax if not given.
    pub inverse_depth: Option<(&'a Plane, DepthKind)>,
    /// The frame without noise, but with its blur.
    pub denoised: Option<&'a Encoded>,
    /// The frame without noise and motion blur.
    pub motion_deblurred: Option<&'a Encoded>,
    /// The frame without noise and defocus, but with its motion blur.
    pub defocus_deblurred: Option<&'a Encoded>,
    /// The frame without noise, motion blur and defocus.
    pub clean: Option<&'a Encoded>,
    /// Whether a network made these images from the frame; the intervals are then wider, to allow for the blur and noise that it leaves.
    pub by_network: bool,
    /// Whether flow and depth are what an estimator found in these frames before ([`super::Estimator::flow`]), rather than knowledge from
    /// elsewhere: then the same is made of them as if they were found now.
    pub found_before: bool,
}

/// The result of an estimator.
#[derive(Clone, Debug)]
pub struct Estimation {
    /// The model.
    pub model: CameraModel,
    /// The measurements that the model rests on.
    pub diagnostics: Diagnostics,
}

/// The measurements that an estimate rests on, for plots and messages.
#[derive(Clone, Debug, Default)]
pub struct Diagnostics {
    /// Sentences for the user on what was chosen, why, and what was left out.
    pub notes: Vec<String>,
    /// The measured points of the noise curves.
    pub noise_points: Vec<noise::NoisePoint>,
    /// The points (exposure fraction, log-likelihood) of a spectral estimate, or (exposure fraction, minus the scaled error) of one by
    /// removal; 0 at the maximum.
    pub exposure_curve: Vec<[f32; 2]>,
    /// The local blur over inverse depth.
    pub blur_points: Vec<BlurPoint>,
    /// The exposure that each frame alone gives: (index of the frame among the added frames, exposure fraction).
    pub exposure_per_frame: Vec<(usize, f32)>,
    /// The shots if there is a cut between the frames, else an empty list.
    pub shots: Vec<Shot>,
    /// The index of the last frame whose depth is known, and its inverse depth as it was used (NaN: unknown).
    pub inverse_depth: Option<(usize, Plane)>,
}

/// The frames between two cuts.
#[derive(Clone, Debug)]
pub struct Shot {
    /// The indices of the shot's frames among the added frames.
    pub frames: Range<usize>,
    /// The exposure that the shot's frames alone give.
    pub motion_blur: Estimate<MotionBlurModel>,
}
