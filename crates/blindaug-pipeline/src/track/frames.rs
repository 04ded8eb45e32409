//! Trackers to which frames are handed one after another.

use super::models::{ClipModels, Models};
use blindaug::{
    Flow, Frame, Plane, Result,
    fit::{Evidence, FrameObservation, track::Tracker},
    model::{DepthKind, NoiseKind, Space, TrackedCamera},
};

/// What is given beside a frame that is handed to a [`FrameTracker`] or a [`ClipTracker`].
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// Inverse depth (NaN: no reading) and its kind.
    pub depth: Option<(Plane, DepthKind)>,
    /// Optical flow to the next frame, px.
    pub flow: Option<Flow>,
}

/// Frames that come one after another, each of which is observed with those next to it.
#[derive(Default)]
struct Successive {
    /// The frame before the one that waits.
    previous: Option<Frame>,
    /// The last frame, whose observation needs the next one.
    waiting: Option<(Frame, Beside)>,
}

impl Successive {
    /// Takes the next frame, and looks at the frame before it; `None` for the first frame. A gap in the frames' numbers is a gap in time.
    fn push<R>(
        &mut self,
        frame: Frame,
        beside: Beside,
        look: impl FnOnce(u64, &FrameObservation) -> R,
    ) -> Option<R> {
        let found = self.look(Some(&frame), look);
        self.waiting = Some((frame, beside));
        found
    }

    /// Looks at the last frame, if there is one that waits. Frames that are pushed later follow after a gap.
    fn finish<R>(&mut self, look: impl FnOnce(u64, &FrameObservation) -> R) -> Option<R> {
        let found = self.look(None, look);
        self.previous = None;
        found
    }

    /// Looks at the frame that waits, which `next` follows.
    fn look<R>(&mut self, next: Option<&Frame>, look: impl FnOnce(u64, &FrameObservation) -> R) -> Option<R> {
        let (frame, beside) = self.waiting.take()?;
        let number = frame.number;
        let observation = FrameObservation {
            frame: &frame.image,
            next: next.filter(|n| number.checked_add(1) == Some(n.number)).map(|n| &n.image),
            previous: self
                .previous
                .as_ref()
                .filter(|p| p.number.checked_add(1) == Some(number))
                .map(|p| &p.image),
            evidence: Evidence {
                flow: beside.flow.as_ref(),
                inverse_depth: beside.depth.as_ref().map(|(depth, kind)| (depth, *kind)),
                ..Evidence::default()
            },
        };
        let found = look(number, &observation);
        self.previous = Some(frame);
        Some(found)
    }
}

/// The estimation of a model for each frame where frames are handed over one after another, and each model is wanted as soon as the next
/// frame is there. The models are those of [`track`](super::track), except for the noise, which `track` takes from the frames after a frame,
/// too, and for changes of the noise: here each is told in the frame in which it is noticed, whether or not it stands.
pub struct FrameTracker {
    models: Models,
    frames: Successive,
}

impl FrameTracker {
    /// A tracker that has seen nothing yet, of frames whose blur acts in this space. `fps` is only copied into the models; `pixel_aspect` is the
    /// width of a pixel over its height, as the picture is shown, if that is known.
    pub fn new(space: Space, noise_kind: NoiseKind, fps: Option<f64>, pixel_aspect: Option<f32>) -> Self {
        let models = Models { tracker: Tracker::new(space, fps), noise_kind, pixel_aspect };
        Self { models, frames: Successive::default() }
    }

    /// Takes the next frame in the order of time, and gives the model of the frame before it; `None` for the first frame. A gap in the
    /// frames' numbers is a gap in time.
    ///
    /// # Errors
    /// If the frame before, or what was given beside it, cannot be used. That frame is then left out.
    pub fn push(&mut self, frame: Frame, beside: Beside) -> Result<Option<TrackedCamera>> {
        self.frames.push(frame, beside, |number, seen| self.models.push(number, seen)).transpose()
    }

    /// The model of the last frame; `None` if there is none that waits. Frames that are pushed later are taken to follow after a gap.
    ///
    /// # Errors
    /// The same as [`FrameTracker::push`].
    pub fn finish(&mut self) -> Result<Option<TrackedCamera>> {
        self.frames.finish(|number, seen| self.models.push(number, seen)).transpose()
    }
}

/// [`track`](super::track) where frames are handed over one after another: the models are the same to the bit, and come as late. They are
/// taken by [`ClipTracker::take`].
pub struct ClipTracker {
    models: ClipModels,
    frames: Successive,
}

impl ClipTracker {
    /// A tracker that has seen nothing yet; the arguments are those of [`FrameTracker::new`].
    pub fn new(space: Space, noise_kind: NoiseKind, fps: Option<f64>, pixel_aspect: Option<f32>) -> Self {
        let models = Models { tracker: Tracker::new(space, fps), noise_kind, pixel_aspect };
        Self { models: ClipModels::new(models), frames: Successive::default() }
    }

    /// Takes the next frame in the order of time. A gap in the frames' numbers is a gap in time.
    ///
    /// # Errors
    /// If the frame before, or what was given beside it, cannot be used. That frame is then left out.
    pub fn push(&mut self, frame: Frame, beside: Beside) -> Result<()> {
        self.frames.push(frame, beside, |number, seen| self.models.push(number, seen)).unwrap_or(Ok(()))
    }

    /// Ends the clip: all models can be taken then.
    ///
    /// # Errors
    /// The same as [`ClipTracker::push`]. The models of the other frames can be taken all the same.
    pub fn finish(&mut self) -> Result<()> {
        let last = self.frames.finish(|number, seen| self.models.push(number, seen));
        self.models.end();
        last.unwrap_or(Ok(()))
    }

    /// Ends the clip before the last frame, whose neighbour cannot be had: the models of the frames before it can be taken then.
    pub fn stop(&mut self) {
        self.frames = Successive::default();
        self.models.end();
    }

    /// Takes the next model that will not change any more, in the order of the frames; `None`: there is none yet.
    pub fn take(&mut self) -> Option<TrackedCamera> {
        self.models.take()
    }
}
