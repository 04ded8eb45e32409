//! Relative inverse depth from the parallax of a moving camera.
use crate::{Flow, Plane};

/// tmp
#[derive(Default)]
pub struct ParallaxTracker {}

impl ParallaxTracker {
    /// tmp
    pub fn add(&mut self, _flow: &Flow) -> Result<Plane, String> {
        Err("not built".into())
    }
}
