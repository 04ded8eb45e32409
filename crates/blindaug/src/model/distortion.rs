//! The interface that the models of all distortions share.

use super::{Estimate, Method, Unknown};
use crate::Result;

/// A number of a camera as it is shown to people by `inspect`, the report, a window, a page or Python.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// The name of the number, in lower case.
    pub name: &'static str,
    /// The unit of the number; empty if there is none.
    pub unit: &'static str,
    /// The estimate, in `unit`.
    pub value: f32,
    /// The 95 % confidence interval of the number, low and high, if there is one.
    pub interval: Option<[f32; 2]>,
    /// The meaning of the number, in one sentence.
    pub meaning: &'static str,
}

impl Parameter {
    /// The unit as it follows the value: after a space, or nothing if there is none.
    pub fn unit_after_value(&self) -> String {
        if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) }
    }
}

/// The operations that the model of each distortion supports.
pub(crate) trait DistortionModel {
    /// The model for frames that are `s` times as wide.
    fn scaled(self, s: f32) -> Self
    where
        Self: Sized;

    /// Interpolates between two models of one camera: `self` at t = 0, `other` at t = 1.
    fn between(&self, other: &Self, t: f32) -> Self
    where
        Self: Sized;

    /// Checks that every number of the model is in its range.
    fn validate(&self) -> Result<()>;

    /// The numbers of the model, the most important one first.
    fn parameters(&self) -> Vec<Parameter>;

    /// The method of the estimate, and the number of samples that it rests on.
    fn basis(&self) -> (Method, u64);
}

/// The model if it is known, else the reason why it is unknown.
pub(super) fn known<T: DistortionModel>(
    estimate: &Estimate<T>,
) -> std::result::Result<&dyn DistortionModel, &Unknown> {
    match estimate {
        Estimate::Known(model) => Ok(model),
        Estimate::Unknown(why) => Err(why),
    }
}

/// Interpolates between two estimates: `a` at t = 0, `b` at t = 1. If one of them is unknown, the result is the other.
pub(super) fn between<T: DistortionModel + Clone>(a: &Estimate<T>, b: &Estimate<T>, t: f32) -> Estimate<T> {
    match (a, b) {
        (Estimate::Known(a), Estimate::Known(b)) => Estimate::Known(a.between(b, t)),
        (Estimate::Unknown(_), _) => b.clone(),
        _ => a.clone(),
    }
}
