//! The times that the parts of a picture take.

use blindaug::Result;
use blindaug_pipeline::live::{LiveEstimate, LiveFrame};
use blindaug_stage::{Look, Stage};
use std::time::{Duration, Instant};

/// The times that the parts of a picture took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// The time to draw the object.
    pub render: Duration,
    /// The time to composite the object.
    pub composite: Duration,
}

impl Times {
    /// Draws the picture of a frame on a stage, and takes the times.
    ///
    /// # Errors
    /// The same as [`Stage::draw`].
    pub fn of_drawing(stage: &Stage, shot: &LiveFrame, estimate: &LiveEstimate, look: &Look) -> Result<Self> {
        let start = Instant::now();
        stage.render(shot, estimate, look)?;
        let render = start.elapsed();
        stage.composite(shot, estimate, look)?;
        Ok(Self { render, composite: start.elapsed() - render })
    }
}
