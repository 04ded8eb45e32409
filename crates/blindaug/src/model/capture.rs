//! What was filmed, and how a camera's numbers were found.

use serde::{Deserialize, Serialize};

/// How a part of the model was estimated.
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
    /// Known beforehand, not estimated.
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

/// What was filmed, for which the numbers in px and in fractions of a frame hold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Capture {
    /// Width in px.
    pub width: usize,
    /// Height in px.
    pub height: usize,
    /// Frames per second; `None` where it is not known (an image sequence).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fps: Option<f64>,
    /// How many frames gave evidence.
    pub frames_used: usize,
}

/// How far an estimation came that was stopped before the end of its clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stopped {
    /// How many frames it had looked at.
    pub after: usize,
    /// How many frames the clip has; `None` where it does not say.
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
