use super::distortion::DistortionModel;
use super::{Method, Parameter, Unknown, check, lerp, lerp_all};
use crate::Result;
use serde::{Deserialize, Serialize};

/// The fraction of the frame interval that the shutter is open, in [0, 1]: the shutter angle over 360 degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
pub struct ExposureFraction(pub f32);

impl ExposureFraction {
    /// The shutter angle in degrees.
    pub fn shutter_angle(self) -> f32 {
        360.0 * self.0
    }

    /// The exposure time in seconds at this frame rate.
    pub fn seconds(self, fps: f64) -> f64 {
        f64::from(self.0) / fps
    }
}

/// The camera's exposure, as a fraction of the frame interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionBlurModel {
    /// The estimated exposure fraction.
    pub exposure: ExposureFraction,
    /// The 95 % confidence interval of the exposure fraction, low and high.
    pub interval: [f32; 2],
    /// The method of the estimate.
    pub method: Method,
    /// The number of tiles (spectral) or places (removal) that the estimate rests on.
    pub samples: u64,
}

impl MotionBlurModel {
    /// A model of an exposure that is known beforehand.
    pub fn given(exposure: ExposureFraction) -> Self {
        Self { exposure, interval: [exposure.0; 2], method: Method::Given, samples: 0 }
    }

    /// The middle of the exposures that fit, where the exposure is unknown: a composite without motion blur looks pasted on, one whose
    /// motion blur is somewhat off does not. `None` where the footage does not tell which exposures fit.
    pub fn middle(why: &Unknown) -> Option<Self> {
        let interval @ [low, high] = why.fits?;
        Some(Self { interval, ..Self::given(ExposureFraction(0.5 * (low + high))) })
    }
}

impl DistortionModel for MotionBlurModel {
    /// A fraction of time does not depend on the frame's size.
    fn scaled(self, _: f32) -> Self {
        self
    }

    fn between(&self, other: &Self, t: f32) -> Self {
        Self {
            exposure: ExposureFraction(lerp(self.exposure.0, other.exposure.0, t)),
            interval: lerp_all(self.interval, other.interval, t),
            ..if t < 0.5 { *self } else { *other }
        }
    }

    fn validate(&self) -> Result<()> {
        check((0.0..=1.0).contains(&self.exposure.0), "motion_blur.exposure must lie in [0, 1]")?;
        let [lo, hi] = self.interval;
        check(0.0 <= lo && lo <= hi && hi.is_finite(), "motion_blur.interval must be two rising numbers >= 0")
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![Parameter {
            name: "exposure",
            unit: "",
            value: self.exposure.0,
            interval: Some(self.interval),
            meaning: "The part of the time from one frame to the next in which the shutter is open.",
        }]
    }

    fn basis(&self) -> (Method, u64) {
        (self.method, self.samples)
    }
}
