//! The size and frame rate of the footage, and the methods by which a camera's numbers were found.

use crate::Transfer;
use serde::{Deserialize, Serialize};

/// The method by which a part of the model was estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Noise from motion-compensated differences of frames.
    Temporal,
    /// Noise from the flattest parts of single frames.
    Spatial,
    /// The Whittle likelihood of local spectra.
    Spectral,
    /// Comparison with clean frames, given or restored.
    Removal,
    /// Not estimated: the value was known beforehand.
    Given,
}

/// The values that blur acts on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BlurSpace {
    /// Light, as in a real lens and shutter.
    #[default]
    Linear,
    /// Encoded values, as in the paper and in many engines.
    Encoded,
}

/// The space in which values are blurred and mixed, and the curve of the frame's encoded values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Space {
    /// The values that blur acts on.
    pub blur: BlurSpace,
    /// The curve between light and the frame's values.
    pub transfer: Transfer,
}

impl From<BlurSpace> for Space {
    /// This space of frames that are encoded as sRGB.
    fn from(blur: BlurSpace) -> Self {
        Self { blur, transfer: Transfer::Srgb }
    }
}

impl Space {
    pub(crate) fn of_encoded(&self, v: [f32; 3]) -> [f32; 3] {
        match self.blur {
            BlurSpace::Linear => v.map(|v| self.transfer.decode(v)),
            BlurSpace::Encoded => v,
        }
    }

    pub(crate) fn encoded(&self, v: [f32; 3]) -> [f32; 3] {
        match self.blur {
            BlurSpace::Linear => v.map(|v| self.transfer.encode(v)),
            BlurSpace::Encoded => v,
        }
    }

    pub(crate) fn of_linear(&self, v: [f32; 3]) -> [f32; 3] {
        match self.blur {
            BlurSpace::Linear => v,
            BlurSpace::Encoded => v.map(|v| self.transfer.encode(v)),
        }
    }

    /// The premultiplied colour in this space; broken pixels (NaN, infinite) become empty.
    pub(crate) fn of_premultiplied(&self, v: [f32; 4]) -> [f32; 4] {
        let [r, g, b, a] = v;
        if !v.iter().all(|v| v.is_finite()) || a < 0.0 {
            return [0.0; 4];
        }
        let a = a.min(1.0);
        match self.blur {
            BlurSpace::Encoded if a > 0.0 => {
                let [r, g, b] = self.of_linear([r / a, g / a, b / a]);
                [r * a, g * a, b * a, a]
            }
            _ => [r, g, b, a],
        }
    }

    /// The slope d encoded / d value of this space's values, at the one that is encoded as `v`.
    pub(crate) fn slope(&self, v: f32) -> f32 {
        match self.blur {
            BlurSpace::Linear => self.transfer.slope(self.transfer.decode(v)),
            BlurSpace::Encoded => 1.0,
        }
    }
}

/// The footage for which the model's numbers in px and in fractions of a frame interval hold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Capture {
    /// Width in px.
    pub width: usize,
    /// Height in px.
    pub height: usize,
    /// Frames per second; `None` if the rate is unknown, as of an image sequence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fps: Option<f64>,
    /// The number of frames that gave evidence.
    pub frames_used: usize,
    /// The width of a pixel over its height, as the picture is shown: 1 for square pixels, 2 for the plates of anamorphic lenses of squeeze 2.
    #[serde(default = "square", skip_serializing_if = "is_square")]
    pub pixel_aspect: f32,
}

/// The frames per second that cameras and renderers have, with room at both ends.
pub const FRAME_RATES: std::ops::RangeInclusive<f64> = 0.01..=1e5;

/// The pixel aspects that a capture may have.
pub const PIXEL_ASPECTS: std::ops::RangeInclusive<f32> = 0.1..=10.0;

fn square() -> f32 {
    1.0
}

fn is_square(aspect: &f32) -> bool {
    *aspect == 1.0
}

/// The progress of an estimation that was stopped before the end of its clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stopped {
    /// The number of frames that the estimation had looked at.
    pub after: usize,
    /// The number of frames of the clip; `None` if the clip does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<usize>,
}

impl std::fmt::Display for Stopped {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.of {
            Some(of) => write!(f, "stopped after {} of {of} frames", self.after),
            None => write!(f, "stopped after {} frames", self.after),
        }
    }
}
