//! The models of frames that are shown one after another.

use super::noise_around::{NoiseAround, Told};
use blindaug::{
    Result,
    fit::{FrameObservation, track::Tracker},
    model::{Distortion, Estimate, NoiseKind, TrackedCamera},
};
use std::collections::VecDeque;

/// The models as soon as their frames are shown.
pub(super) struct Models {
    pub(super) tracker: Tracker,
    pub(super) noise_kind: NoiseKind,
    /// The width of a pixel over its height, as the picture is shown, if it is known.
    pub(super) pixel_aspect: Option<f32>,
}

impl Models {
    /// The model of the frame of this number.
    pub(super) fn push(&mut self, frame: u64, observation: &FrameObservation) -> Result<TrackedCamera> {
        let mut camera = self.tracker.push(observation)?.clone();
        self.noise_kind.reduce(&mut camera.noise);
        if let Some(aspect) = self.pixel_aspect {
            camera = camera.measured_in_pixels_of(aspect);
        }
        Ok(TrackedCamera { frame, changed: self.tracker.changes(), camera })
    }
}

/// The models of a clip, whose noise is a mean over the frames around each, so that they come late.
pub(super) struct ClipModels {
    models: Models,
    noises: NoiseAround,
    /// The models whose mean noise is not known yet.
    waiting: VecDeque<TrackedCamera>,
    /// The models that will not change any more.
    ready: VecDeque<TrackedCamera>,
}

impl ClipModels {
    pub(super) fn new(models: Models) -> Self {
        Self { models, noises: NoiseAround::default(), waiting: VecDeque::new(), ready: VecDeque::new() }
    }

    /// Finds the model of the next frame.
    ///
    /// # Errors
    /// If the frame or its evidence cannot be used. The models of the frames before it stay.
    pub(super) fn push(&mut self, frame: u64, observation: &FrameObservation) -> Result<()> {
        if self.models.tracker.cut_ahead() {
            self.release(true);
        }
        let camera = self.models.push(frame, observation)?;
        let tracker = &self.models.tracker;
        let (noise, shared_spread) = tracker.noise_of_frames().expect("a frame was pushed");
        let mut noise = noise.clone();
        self.models.noise_kind.reduce(&mut noise);
        let told = Told { noise, settled: !tracker.noise_settles(), shared_spread };
        if camera.changed.of(Distortion::Noise) {
            // The last frames have the new noise, too: the change is noticed late.
            let late = tracker.noise_changed_before().min(self.waiting.len());
            self.noises.change(late, &told);
        }
        self.noises.push(told);
        self.waiting.push_back(camera);
        self.release(false);
        Ok(())
    }

    /// Takes the next model that will not change any more, in the order of the frames.
    pub(super) fn take(&mut self) -> Option<TrackedCamera> {
        self.ready.pop_front()
    }

    /// Ends the clip: no model will change any more.
    pub(super) fn end(&mut self) {
        self.release(true);
    }

    /// The model of the last frame, if it may still change.
    pub(super) fn last_mut(&mut self) -> Option<&mut TrackedCamera> {
        self.waiting.back_mut()
    }

    /// The words about copies of frames, if there were some.
    pub(super) fn copies_in_words(&self) -> Option<String> {
        self.models.tracker.copies_in_words()
    }

    /// Makes those models ready that will not change any more: all of them at a cut and at the end (`ends`).
    fn release(&mut self, ends: bool) {
        let known = self.noises.known(ends);
        let cameras = self.waiting.drain(..known.len());
        self.ready.extend(known.into_iter().zip(cameras).map(|(noise, mut camera)| {
            camera.changed.set(Distortion::Noise, noise.changed);
            if let Some(mean) = noise.mean {
                camera.camera.noise = Estimate::Known(mean);
            }
            camera
        }));
    }
}
