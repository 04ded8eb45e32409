//! What the models of all distortions have in common.

use super::{Estimate, Method, Unknown};
use crate::Result;

/// A number of a camera, for whoever tells it: `inspect`, the report, a window, a page, Python.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// What it is called, in lower case.
    pub name: &'static str,
    /// Its unit; empty where it has none.
    pub unit: &'static str,
    /// The estimate.
    pub value: f32,
    /// Its 95 % confidence interval, low and high, where there is one.
    pub interval: Option<[f32; 2]>,
    /// What it means, in one sentence.
    pub meaning: &'static str,
}

/// What the model of each distortion can do.
pub(super) trait DistortionModel {
    /// The same for frames `s` times as wide.
    fn scaled(self, s: f32) -> Self
    where
        Self: Sized;

    /// `self` at t = 0, `other` at t = 1, both of one camera.
    fn between(&self, other: &Self, t: f32) -> Self
    where
        Self: Sized;

    /// Checks the range of every number.
    fn validate(&self) -> Result<()>;

    /// Its numbers, the most telling one first.
    fn parameters(&self) -> Vec<Parameter>;

    /// How it was estimated, and on how many samples that rests.
    fn basis(&self) -> (Method, u64);
}

/// What is known, or why it is not.
pub(super) fn known<T: DistortionModel>(
    estimate: &Estimate<T>,
) -> std::result::Result<&dyn DistortionModel, &Unknown> {
    match estimate {
        Estimate::Known(model) => Ok(model),
        Estimate::Unknown(why) => Err(why),
    }
}

/// `a` at t = 0, `b` at t = 1; if one of them is unknown, the other.
pub(super) fn between<T: DistortionModel + Clone>(a: &Estimate<T>, b: &Estimate<T>, t: f32) -> Estimate<T> {
    match (a, b) {
        (Estimate::Known(a), Estimate::Known(b)) => Estimate::Known(a.between(b, t)),
        (Estimate::Unknown(_), _) => b.clone(),
        _ => a.clone(),
    }
}
