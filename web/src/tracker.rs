//! The estimation of a camera for each frame.

use crate::{failure::of, frames::frame};
use blindaug::{
    Frame,
    model::{NoiseKind, Space, TrackedCamera},
};
use blindaug_pipeline::track::{Beside, FrameTracker as Tracker};
use wasm_bindgen::prelude::*;

/// Estimates a camera for each of the frames that are pushed one after another.
#[wasm_bindgen]
pub struct FrameTracker {
    tracker: Tracker,
}

#[wasm_bindgen]
impl FrameTracker {
    /// A tracker that has seen nothing yet. `fps`, frames per second, is only copied into the cameras. `lines`: the noise as straight lines over
    /// luminance only.
    #[wasm_bindgen(constructor)]
    pub fn new(fps: Option<f64>, lines: bool) -> FrameTracker {
        let kind = if lines { NoiseKind::Lines } else { NoiseKind::Curves };
        FrameTracker { tracker: Tracker::new(Space::default(), kind, fps, None) }
    }

    /// Takes the next frame, bytes R, G, B, A, and gives the camera of the frame before it as JSON; nothing for the first frame. A gap in the
    /// numbers is a gap in time.
    ///
    /// # Errors
    /// If the frame cannot be used.
    pub fn push(
        &mut self,
        number: u32,
        width: usize,
        height: usize,
        rgba: &[u8],
    ) -> Result<Option<String>, JsError> {
        let image = frame((width, height), rgba)?;
        let frame = Frame { number: number.into(), image };
        json(self.tracker.push(frame, Beside::default()))
    }

    /// The camera of the last frame as JSON; nothing if none waits.
    ///
    /// # Errors
    /// If the last frame cannot be used.
    pub fn finish(&mut self) -> Result<Option<String>, JsError> {
        json(self.tracker.finish())
    }
}

fn json(camera: blindaug::Result<Option<TrackedCamera>>) -> Result<Option<String>, JsError> {
    Ok(camera.map_err(of)?.map(|camera| camera.to_json_line()))
}
