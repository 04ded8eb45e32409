//! The methods with which ours is compared. What follows a paper's text, but not its code, is called "-like".

pub mod lens_net;
pub(crate) mod made;
pub mod okumura;
pub mod okumura_plus;
pub mod shutter_angle;

use blindaug::{Linear, Plane};
use serde::{Deserialize, Serialize};

/// The mean of the three channels.
fn light(picture: &Linear) -> Plane {
    picture.0.map(|p| p.iter().sum::<f32>() / 3.0)
}

/// A method that makes a composite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Method {
    /// The object pasted as it is.
    Naive,
    /// [`okumura`].
    OkumuraLike,
    /// [`okumura_plus`].
    OkumuraPlusLike,
    /// [`lens_net`].
    LensNetLike,
    /// [`shutter_angle`].
    ShutterAngleLike,
    /// The paper's own way: networks remove the blur, and the synthesis is fitted to what they give.
    Removal,
    /// Ours, by spectra.
    Ours,
    /// The camera that really filmed.
    TrueCamera,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 8] = [
        Self::Naive,
        Self::OkumuraLike,
        Self::OkumuraPlusLike,
        Self::LensNetLike,
        Self::ShutterAngleLike,
        Self::Removal,
        Self::Ours,
        Self::TrueCamera,
    ];

    /// The name in all tables, figures and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Naive => "Naive",
            Self::OkumuraLike => "Okumura-like",
            Self::OkumuraPlusLike => "Okumura++-like",
            Self::LensNetLike => "LensNet-like",
            Self::ShutterAngleLike => "Shutter-angle-like",
            Self::Removal => "Removal",
            Self::Ours => "Ours",
            Self::TrueCamera => "True camera",
        }
    }

    /// What the method is given beside the frames and the object.
    pub fn needs(self) -> &'static str {
        match self {
            Self::Naive => "nothing",
            Self::OkumuraLike => "a circular marker at its true pose in the frame",
            Self::OkumuraPlusLike => "a circular marker at its true pose, its sharp picture, its true motion",
            Self::LensNetLike => "captures of known targets by the camera, the object's true depth",
            Self::ShutterAngleLike => "the true optical flow",
            Self::Removal => "networks that remove blur",
            Self::Ours => "nothing",
            Self::TrueCamera => "the camera's true settings",
        }
    }
}
