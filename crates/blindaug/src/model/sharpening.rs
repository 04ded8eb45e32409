use super::distortion::DistortionModel;
use super::{Method, Parameter, check, lerp, lerp_all};
use crate::Result;
use crate::portable::Portable;
use serde::{Deserialize, Serialize};

/// The camera's sharpening, which adds contrast at edges after the picture was taken, as an unsharp mask of encoded values v:
/// `v + amount (v - G v)`, G a Gaussian of std `radius_px`. The modelled noise is the noise after this sharpening.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SharpeningModel {
    /// The estimated amount of the mask, >= 0, without a unit.
    pub amount: f32,
    /// The std of the mask's Gaussian, px.
    pub radius_px: f32,
    /// The 95 % confidence interval of the amount, low and high.
    pub interval: [f32; 2],
    /// The method of the estimate.
    pub method: Method,
    /// The number of local stds of noise that the estimate rests on.
    pub samples: u64,
}

impl SharpeningModel {
    /// A model of a mask that is known beforehand.
    pub fn given(amount: f32, radius_px: f32) -> Self {
        Self { amount, radius_px, interval: [amount; 2], method: Method::Given, samples: 0 }
    }

    /// The factor by which the mask multiplies an amplitude at this frequency, given in cycles per px.
    pub fn gain(&self, frequency: f32) -> f32 {
        let x = std::f32::consts::TAU * self.radius_px * frequency;
        1.0 + self.amount * (1.0 - (-0.5 * x * x).portable_exp())
    }
}

impl DistortionModel for SharpeningModel {
    fn scaled(self, s: f32) -> Self {
        Self { radius_px: self.radius_px * s, ..self }
    }

    fn between(&self, other: &Self, t: f32) -> Self {
        Self {
            amount: lerp(self.amount, other.amount, t),
            radius_px: lerp(self.radius_px, other.radius_px, t),
            interval: lerp_all(self.interval, other.interval, t),
            ..if t < 0.5 { *self } else { *other }
        }
    }

    fn validate(&self) -> Result<()> {
        let Self { amount, radius_px, interval: [lo, hi], .. } = *self;
        check((0.0..=20.0).contains(&amount), "sharpening.amount must lie in [0, 20]")?;
        check((0.1..=20.0).contains(&radius_px), "sharpening.radius_px must lie in [0.1, 20]")?;
        check(0.0 <= lo && lo <= hi && hi.is_finite(), "sharpening.interval must be two rising numbers >= 0")
    }

    fn parameters(&self) -> Vec<Parameter> {
        let amount =
            "An unsharp mask adds this share of the difference between the picture and its blurred copy.";
        vec![
            Parameter {
                name: "amount",
                unit: "",
                value: self.amount,
                interval: Some(self.interval),
                meaning: amount,
            },
            Parameter {
                name: "radius",
                unit: "px",
                value: self.radius_px,
                interval: None,
                meaning: "The std of the Gaussian that blurs the copy.",
            },
        ]
    }

    fn basis(&self) -> (Method, u64) {
        (self.method, self.samples)
    }
}
