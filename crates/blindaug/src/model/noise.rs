use super::{Method, check};
use crate::Result;
use serde::{Deserialize, Serialize};

/// Levels of the Laplacian pyramid in which noise is modelled, finest first. The low-pass left over carries none.
pub const NOISE_LEVELS: usize = 4;

/// Noise std in one pyramid level: slope * Y + intercept per channel (RGB), never negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NoiseLevel {
    /// Std per unit of luminance Y.
    pub slope: [f32; 3],
    /// Std at Y = 0.
    pub intercept: [f32; 3],
}

impl NoiseLevel {
    /// The std in each channel at luminance `y` (Rec. 601 Y of encoded values), >= 0.
    #[inline]
    pub fn sigma(&self, y: f32) -> [f32; 3] {
        std::array::from_fn(|c| (self.slope[c] * y + self.intercept[c]).max(0.0))
    }
}

/// 95 % confidence intervals, low and high, of a level's numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NoiseInterval {
    /// Of the slopes.
    pub slope: [[f32; 2]; 3],
    /// Of the intercepts.
    pub intercept: [[f32; 2]; 3],
}

/// The noise of encoded frames: std per pyramid level and channel over luminance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseModel {
    /// Finest level first.
    pub levels: [NoiseLevel; NOISE_LEVELS],
    /// 95 % intervals of the levels' numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interval: Option<[NoiseInterval; NOISE_LEVELS]>,
    /// Encoded value at and above which the sensor clips, so that there is no noise.
    pub clip: f32,
    /// How it was estimated.
    pub method: Method,
    /// How many local stds it rests on.
    pub samples: u64,
}

impl NoiseModel {
    /// One that is known beforehand.
    pub fn given(levels: [NoiseLevel; NOISE_LEVELS], clip: f32) -> Self {
        Self { levels, interval: None, clip, method: Method::Given, samples: 0 }
    }

    pub(super) fn validate(&self) -> Result<()> {
        let finite = self.levels.iter().all(|l| l.slope.iter().chain(&l.intercept).all(|v| v.is_finite()));
        check(finite, "noise.levels must be finite numbers")?;
        check(
            self.levels.iter().all(|l| l.intercept.iter().all(|&v| v >= 0.0)),
            "noise.levels' intercept must not be negative",
        )?;
        check(self.clip.is_finite() && self.clip > 0.0, "noise.clip must be a positive number")
    }
}
