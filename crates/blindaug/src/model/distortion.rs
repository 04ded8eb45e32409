//! What a camera does to the light of a scene, in its order.

use super::{CameraModel, Estimate, Unknown};
use crate::Result;

/// A distortion that is estimated and applied. The order of [`Distortion::ALL`] is that in which a camera makes them, and in which
/// everything here applies and reports them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Distortion {
    /// The lens blurs what is out of focus.
    Defocus,
    /// What moves while the shutter is open is smeared.
    MotionBlur,
    /// The camera adds contrast at edges.
    Sharpening,
    /// The sensor's noise, as it is after the camera's sharpening.
    Noise,
}

impl Distortion {
    /// All, in the order in which a camera makes them.
    pub const ALL: [Self; 4] = [Self::Defocus, Self::MotionBlur, Self::Sharpening, Self::Noise];

    /// Its name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Defocus => "defocus",
            Self::MotionBlur => "motion blur",
            Self::Sharpening => "sharpening",
            Self::Noise => "noise",
        }
    }
}

/// What the model of each distortion can do.
pub(super) trait DistortionModel: Clone {
    /// The same for frames `s` times as wide.
    fn scaled(self, s: f32) -> Self;

    /// `self` at t = 0, `other` at t = 1, both of one camera.
    fn between(&self, other: &Self, t: f32) -> Self;

    /// Checks the range of every number.
    fn validate(&self) -> Result<()>;
}

impl CameraModel {
    /// Why a distortion is unknown, if it is.
    pub fn why_unknown(&self, distortion: Distortion) -> Option<&Unknown> {
        match distortion {
            Distortion::Defocus => self.defocus.why_unknown(),
            Distortion::MotionBlur => self.motion_blur.why_unknown(),
            Distortion::Sharpening => self.sharpening.why_unknown(),
            Distortion::Noise => self.noise.why_unknown(),
        }
    }

    /// The model at t = 0, `other` at t = 1. What is unknown in one is the other's.
    pub(super) fn between(&self, other: &Self, t: f32) -> Self {
        Self {
            defocus: between(&self.defocus, &other.defocus, t),
            motion_blur: between(&self.motion_blur, &other.motion_blur, t),
            sharpening: between(&self.sharpening, &other.sharpening, t),
            noise: between(&self.noise, &other.noise, t),
            ..if t < 0.5 { self.clone() } else { other.clone() }
        }
    }

    /// The distortions for frames `s` times as wide.
    pub(super) fn scaled(self, s: f32) -> Self {
        Self {
            defocus: self.defocus.map(|m| m.scaled(s)),
            motion_blur: self.motion_blur.map(|m| m.scaled(s)),
            sharpening: self.sharpening.map(|m| m.scaled(s)),
            noise: self.noise.map(|m| m.scaled(s)),
            ..self
        }
    }

    /// Checks the numbers of each distortion.
    pub(super) fn validate_distortions(&self) -> Result<()> {
        validate(&self.noise)?;
        validate(&self.motion_blur)?;
        validate(&self.defocus)?;
        validate(&self.sharpening)
    }
}

/// `a` at t = 0, `b` at t = 1; if one of them is unknown, the other.
fn between<T: DistortionModel>(a: &Estimate<T>, b: &Estimate<T>, t: f32) -> Estimate<T> {
    match (a, b) {
        (Estimate::Known(a), Estimate::Known(b)) => Estimate::Known(a.between(b, t)),
        (Estimate::Unknown(_), _) => b.clone(),
        _ => a.clone(),
    }
}

/// Checks the range of every number that is known.
fn validate<T: DistortionModel>(estimate: &Estimate<T>) -> Result<()> {
    estimate.known().map_or(Ok(()), T::validate)
}
