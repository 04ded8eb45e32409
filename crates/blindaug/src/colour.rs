//! Frames and layers in their colour spaces, as types: display-encoded, scene-linear, premultiplied.

use crate::{Plane, Raster};
use serde::{Deserialize, Serialize};

/// A display-encoded frame (what a camera records and a screen shows), RGB, nominally in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct Encoded(pub Raster<[f32; 3]>);

/// A frame in linear light, RGB, >= 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear(pub Raster<[f32; 3]>);

/// A layer in linear light, RGB premultiplied by its alpha, alpha in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct Premultiplied(pub Raster<[f32; 4]>);

/// The curve between linear light and encoded values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Transfer {
    /// sRGB (IEC 61966-2-1).
    #[default]
    Srgb,
}

impl Transfer {
    /// The encoded value of a linear one. The curve continues past 1, and below 0 as its mirror image.
    #[inline]
    pub fn encode(self, linear: f32) -> f32 {
        let x = linear.abs();
        let y = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
        y.copysign(linear)
    }

    /// The linear value of an encoded one; the inverse of [`Transfer::encode`].
    #[inline]
    pub fn decode(self, encoded: f32) -> f32 {
        let y = encoded.abs();
        let x = if y <= 0.040_45 { y / 12.92 } else { ((y + 0.055) / 1.055).powf(2.4) };
        x.copysign(encoded)
    }

    /// The slope of the curve, d encoded / d linear, at a linear value.
    #[inline]
    pub fn slope(self, linear: f32) -> f32 {
        let x = linear.abs();
        if x <= 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * x.powf(1.0 / 2.4 - 1.0) }
    }
}

impl Encoded {
    /// The same frame in linear light.
    pub fn to_linear(&self, transfer: Transfer) -> Linear {
        Linear(self.0.map(|p| p.map(|v| transfer.decode(v))))
    }

    /// Y of YCbCr (Rec. 601) of the encoded values: the luminance on which the noise model depends.
    pub fn luma(&self) -> Plane {
        self.0.map(luma)
    }
}

impl Linear {
    /// The same frame, display-encoded.
    pub fn to_encoded(&self, transfer: Transfer) -> Encoded {
        Encoded(self.0.map(|p| p.map(|v| transfer.encode(v))))
    }
}

/// Weights of R, G and B in Y of YCbCr (Rec. 601).
pub const LUMA: [f32; 3] = [0.299, 0.587, 0.114];

/// Y of YCbCr (Rec. 601) of encoded RGB; of linear RGB, the sum with the same weights.
#[inline]
pub fn luma([r, g, b]: [f32; 3]) -> f32 {
    LUMA[0] * r + LUMA[1] * g + LUMA[2] * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transfer_known_values_round_trip_and_slope() {
        let t = Transfer::Srgb;
        assert!((t.encode(0.214_041_14) - 0.5).abs() < 1e-6); // IEC 61966-2-1
        for i in -10..40 {
            let v = i as f32 / 20.0;
            assert!((t.decode(t.encode(v)) - v).abs() < 1e-5, "{v}");
            let h = 1e-3;
            let numeric = (t.encode(v + h) - t.encode(v - h)) / (2.0 * h);
            if v.abs() > 0.02 {
                assert!((numeric / t.slope(v) - 1.0).abs() < 0.01, "{v}");
            }
        }
    }
}
