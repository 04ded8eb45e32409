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

/// When the shutter is open.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shutter {
    /// For how long.
    pub exposure: ExposureFraction,
    /// The middle of the exposure after the frame's time, in frame intervals: 0 if the exposure is centred on the frame's time.
    pub centre: f32,
}

/// A centred shutter.
impl From<ExposureFraction> for Shutter {
    fn from(exposure: ExposureFraction) -> Self {
        Self { exposure, centre: 0.0 }
    }
}

impl Shutter {
    /// The longest way from where a frame shows a thing, in frame intervals of its motion.
    pub fn reach(self) -> f32 {
        0.5 * self.exposure.0 + self.centre.abs()
    }

    /// Whether the frame shows anything elsewhere than where it is at the frame's time.
    pub fn moves(self) -> bool {
        self.exposure.0 > 0.0 || self.centre != 0.0
    }
}

/// The camera's exposure, as a fraction of the frame interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionBlurModel {
    /// The estimated exposure fraction.
    pub exposure: ExposureFraction,
    /// The 95 % confidence interval of the exposure fraction, low and high.
    pub interval: [f32; 2],
    /// When the shutter opens, after the frame's time, in degrees of which a frame interval has 360, from -180 to 180. `None`: it opens half the
    /// shutter angle before the frame's time, so that the exposure is centred on it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phase_degrees: Option<f32>,
    /// The method of the estimate.
    pub method: Method,
    /// The number of tiles (spectral) or places (removal) that the estimate rests on.
    pub samples: u64,
}

impl MotionBlurModel {
    /// A model of an exposure that is known beforehand.
    pub fn given(exposure: ExposureFraction) -> Self {
        Self { exposure, interval: [exposure.0; 2], phase_degrees: None, method: Method::Given, samples: 0 }
    }

    /// When the shutter is open.
    pub fn shutter(&self) -> Shutter {
        let centre =
            self.phase_degrees.map_or(0.0, |phase| (phase + 0.5 * self.exposure.shutter_angle()) / 360.0);
        Shutter { exposure: self.exposure, centre }
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
        let phase = |m: &Self| m.phase_degrees.unwrap_or(-0.5 * m.exposure.shutter_angle());
        let phase_degrees = match (self.phase_degrees, other.phase_degrees) {
            (None, None) => None,
            _ => Some(lerp(phase(self), phase(other), t)),
        };
        Self {
            phase_degrees,
            exposure: ExposureFraction(lerp(self.exposure.0, other.exposure.0, t)),
            interval: lerp_all(self.interval, other.interval, t),
            ..if t < 0.5 { *self } else { *other }
        }
    }

    fn validate(&self) -> Result<()> {
        check((0.0..=1.0).contains(&self.exposure.0), "motion_blur.exposure must lie in [0, 1]")?;
        check(
            self.phase_degrees.is_none_or(|phase| (-180.0..=180.0).contains(&phase)),
            "motion_blur.phase_degrees must lie in [-180, 180]",
        )?;
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
