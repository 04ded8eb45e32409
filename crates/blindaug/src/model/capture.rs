//! The size and frame rate of the footage, and the methods by which a camera's numbers were found.

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
