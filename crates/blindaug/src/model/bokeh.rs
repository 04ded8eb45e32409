//! The shape of an out-of-focus point.

use super::{check, lerp};
use crate::Result;
use serde::{Deserialize, Serialize};

/// The shape of an out-of-focus point. Each shape has the second moment of the Gaussian whose std the lens's curve gives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
pub enum Bokeh {
    /// A Gaussian, as in the paper.
    #[default]
    Gaussian,
    /// A uniform disk of the same std per axis, whose diameter is 4 std, as of a real lens with a round aperture.
    Disk,
    /// A uniform regular polygon, as of an aperture with blades.
    Polygon {
        /// The number of blades, 3 to 16.
        blades: u8,
        /// The curvature of the blades over that of the circle through the corners: from 0, straight blades, to 1, a disk.
        #[serde(default)]
        roundness: f32,
        /// The angle by which the polygon is turned clockwise, degrees, as it is seen in points behind the focus; at 0, one corner is on top.
        #[serde(default)]
        rotation_degrees: f32,
    },
}

/// The numbers of blades that a polygon may have.
pub const BLADES: std::ops::RangeInclusive<u8> = 3..=16;

/// The greatest squeeze of an aperture; the least one is its inverse.
pub const MOST_SQUEEZE: f32 = 4.0;

/// The image of an out-of-focus point: its shape, and how that is stretched and cut.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Aperture {
    /// The shape.
    #[serde(flatten)]
    pub bokeh: Bokeh,
    /// The shape's extent from top to bottom over that from left to right, as the picture is shown: 1 for spherical lenses, 2 for anamorphic
    /// ones that squeeze the picture to half its width. The mean of both axes' variances stays.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub squeeze: f32,
    /// How much the lens's barrel cuts the shape towards the picture's edges, 0 to 1: at 1, a disk keeps 39 % of its area in the corners.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub cats_eye: f32,
}

fn one() -> f32 {
    1.0
}

fn is_one(v: &f32) -> bool {
    *v == 1.0
}

fn is_zero(v: &f32) -> bool {
    *v == 0.0
}

impl Default for Aperture {
    fn default() -> Self {
        Bokeh::default().into()
    }
}

/// The shape alone, neither stretched nor cut.
impl From<Bokeh> for Aperture {
    fn from(bokeh: Bokeh) -> Self {
        Self { bokeh, squeeze: 1.0, cats_eye: 0.0 }
    }
}

impl Aperture {
    /// Whether this is the paper's Gaussian.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// The std along x and along y of a point whose equivalent Gaussian has std 1, in pixels that are `pixel_aspect` times as wide as high.
    pub fn stds(&self, pixel_aspect: f32) -> [f32; 2] {
        let s = self.squeeze;
        let x = (2.0 / (1.0 + s * s)).sqrt();
        [x / pixel_aspect, s * x]
    }

    /// Whether the shape is the same when it is turned by 180 degrees, so that points before and behind the focus look alike.
    pub fn is_symmetric(&self) -> bool {
        let even = match self.bokeh {
            Bokeh::Gaussian | Bokeh::Disk => true,
            Bokeh::Polygon { blades, .. } => blades.is_multiple_of(2),
        };
        even && self.cats_eye == 0.0
    }

    /// The shape in words, such as `a polygon of 6 blades, squeezed by 2`.
    pub fn words(&self) -> String {
        let mut words = match self.bokeh {
            Bokeh::Gaussian => "a Gaussian".into(),
            Bokeh::Disk => "a disk".into(),
            Bokeh::Polygon { blades, .. } => format!("a polygon of {blades} blades"),
        };
        if self.squeeze != 1.0 {
            words += &format!(", {} times as high as wide", self.squeeze);
        }
        if self.cats_eye > 0.0 {
            words += &format!(", cut towards the edges (cat's eye {})", self.cats_eye);
        }
        words
    }

    /// Interpolates the stretch and the cut; the shape itself is that of the nearer aperture.
    pub(super) fn between(&self, other: &Self, t: f32) -> Self {
        let nearer = if t < 0.5 { self } else { other };
        Self {
            bokeh: nearer.bokeh,
            squeeze: lerp(self.squeeze, other.squeeze, t),
            cats_eye: if nearer.bokeh == Bokeh::Gaussian {
                nearer.cats_eye
            } else {
                lerp(self.cats_eye, other.cats_eye, t)
            },
        }
    }

    pub(super) fn validate(&self) -> Result<()> {
        if let Bokeh::Polygon { blades, roundness, rotation_degrees } = self.bokeh {
            check(BLADES.contains(&blades), "defocus.bokeh.blades must be a number from 3 to 16")?;
            check((0.0..=1.0).contains(&roundness), "defocus.bokeh.roundness must lie in [0, 1]")?;
            check(rotation_degrees.is_finite(), "defocus.bokeh.rotation_degrees must be a number")?;
        }
        check(
            (MOST_SQUEEZE.recip()..=MOST_SQUEEZE).contains(&self.squeeze),
            "defocus.bokeh.squeeze must lie in [0.25, 4]",
        )?;
        check((0.0..=1.0).contains(&self.cats_eye), "defocus.bokeh.cats_eye must lie in [0, 1]")?;
        check(
            self.bokeh != Bokeh::Gaussian || self.cats_eye == 0.0,
            "defocus.bokeh.cats_eye needs the shape of a disk or a polygon, since a Gaussian has no edge that could be cut",
        )
    }
}
