//! The estimation of a camera model for each frame of a clip.

use crate::{
    Result,
    estimate::{Samples, check_memory, of_clip, of_frame},
    footage::{Clip, Footage},
    observer::Observer,
    operators::{EvidenceSink, Operators},
    window::{Seen, Viewer, show},
};
use blindaug::{
    Flow, Frame, Plane, Sample,
    fit::{Evidence, FrameObservation, track::Tracker},
    model::{CameraTrack, DepthKind, NoiseKind, Space, TrackedCamera},
};

/// The options of tracking a clip.
#[derive(Default)]
pub struct Job<'a> {
    /// The values that blur acts on: light or encoded values.
    pub space: Space,
    /// The kind of noise model.
    pub noise_kind: NoiseKind,
    /// Frames per second; `None`: the clip's.
    pub fps: Option<f64>,
    /// Whether a few frames are kept for a report.
    pub keep_samples: bool,
    /// The operators, such as networks that find flow or depth, that process frames before the tracker.
    pub operators: Option<&'a mut dyn Operators>,
}

/// A tracked camera and the frames that it rests on.
#[derive(Clone, Debug)]
pub struct Tracked {
    /// The models. The last one says if the observer stopped the job before the end of the clip.
    pub track: CameraTrack,
    /// A few frames for a report, if they were asked for.
    pub samples: Vec<Sample>,
    /// The first frame's number.
    pub first: u64,
    /// The last frame's number.
    pub last: u64,
}

/// Estimates a model for each frame.
struct Following<'a> {
    clip: &'a dyn Clip,
    tracker: Tracker,
    noise_kind: NoiseKind,
    each: &'a mut dyn FnMut(&TrackedCamera) -> Result<()>,
    /// The models so far; all but the last one were handed on.
    cameras: Vec<TrackedCamera>,
    samples: Samples<'a>,
}

impl Viewer for Following<'_> {
    fn wants_next(&self) -> bool {
        true
    }

    fn view(
        &mut self,
        number: u64,
        observation: &FrameObservation,
        _: Option<&mut dyn EvidenceSink>,
    ) -> Result<()> {
        let aspect = self.clip.pixel_aspect();
        let camera = tracked(&mut self.tracker, (number, observation), (self.noise_kind, aspect));
        let camera = camera.map_err(|e| of_frame(self.clip, number, e))?;
        if let Some(last) = self.cameras.last() {
            (self.each)(last)?;
        }
        self.cameras.push(camera);
        self.samples.keep(number, observation)
    }
}

/// The model of the frame of this number.
fn tracked(
    tracker: &mut Tracker,
    (frame, observation): (u64, &FrameObservation),
    (noise_kind, pixel_aspect): (NoiseKind, Option<f32>),
) -> blindaug::Result<TrackedCamera> {
    let mut camera = tracker.push(observation)?.clone();
    noise_kind.reduce(&mut camera.noise);
    if let Some(aspect) = pixel_aspect {
        camera = camera.measured_in_pixels_of(aspect);
    }
    Ok(TrackedCamera { frame, changed: tracker.changes(), camera })
}

/// What is given beside a frame that is handed to a [`FrameTracker`].
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// Inverse depth (NaN: no reading) and its kind.
    pub depth: Option<(Plane, DepthKind)>,
    /// Optical flow to the next frame, px.
    pub flow: Option<Flow>,
}

/// The estimation of a model for each frame where frames are handed over one after another, instead of being taken from a clip: the models
/// are those of [`track`].
pub struct FrameTracker {
    tracker: Tracker,
    noise_kind: NoiseKind,
    pixel_aspect: Option<f32>,
    /// The frame before the one that waits.
    previous: Option<Frame>,
    /// The last frame, whose model needs the next one.
    waiting: Option<(Frame, Beside)>,
}

impl FrameTracker {
    /// A tracker that has seen nothing yet, of frames whose blur acts in this space. `fps` is only copied into the models; `pixel_aspect` is the
    /// width of a pixel over its height, as the picture is shown, if that is known.
    pub fn new(space: Space, noise_kind: NoiseKind, fps: Option<f64>, pixel_aspect: Option<f32>) -> Self {
        Self { tracker: Tracker::new(space, fps), noise_kind, pixel_aspect, previous: None, waiting: None }
    }

    /// Takes the next frame in the order of time, and gives the model of the frame before it; `None` for the first frame. A gap in the
    /// frames' numbers is a gap in time.
    ///
    /// # Errors
    /// If the frame before, or what was given beside it, cannot be used. That frame is then left out.
    pub fn push(&mut self, frame: Frame, beside: Beside) -> blindaug::Result<Option<TrackedCamera>> {
        let camera = self.look(Some(&frame));
        self.waiting = Some((frame, beside));
        camera
    }

    /// The model of the last frame; `None` if there is none that waits. Frames that are pushed later are taken to follow after a gap.
    ///
    /// # Errors
    /// The same as [`FrameTracker::push`].
    pub fn finish(&mut self) -> blindaug::Result<Option<TrackedCamera>> {
        let camera = self.look(None);
        self.previous = None;
        camera
    }

    /// The model of the frame that waits, which `next` follows.
    fn look(&mut self, next: Option<&Frame>) -> blindaug::Result<Option<TrackedCamera>> {
        let Some((frame, beside)) = self.waiting.take() else { return Ok(None) };
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
        let shape = (self.noise_kind, self.pixel_aspect);
        let camera = tracked(&mut self.tracker, (number, &observation), shape);
        self.previous = Some(frame);
        camera.map(Some)
    }
}

/// Estimates a model for each frame of a clip, and hands each to `each` as it comes, one frame late.
///
/// # Errors
/// If a frame or its accompanying data cannot be used, memory does not suffice, or `each` fails.
pub fn track(
    footage: &Footage,
    job: Job,
    observer: &dyn Observer,
    each: &mut dyn FnMut(&TrackedCamera) -> Result<()>,
) -> Result<Tracked> {
    let Job { space, noise_kind, fps, keep_samples, operators } = job;
    let clip = &*footage.clip;
    let reach = operators.as_ref().map_or(0, |o| o.reach());
    check_memory(footage, reach, keep_samples, Tracker::bytes(clip.size()))?;
    let tracker = Tracker::new(space, fps.or(clip.fps()));
    let samples = Samples::new(clip, keep_samples);
    let mut following = Following { clip, tracker, noise_kind, each, cameras: Vec::new(), samples };
    let Seen { first, last, stopped, .. } =
        show(footage, operators, None, "tracking", &mut following, observer)?;
    let Following { each, mut cameras, samples, .. } = following;
    if let Some(last) = cameras.last_mut() {
        last.camera.stopped = stopped;
        each(last)?;
    }
    let track = CameraTrack::from_frames(cameras).map_err(|e| of_clip(clip, e))?;
    Ok(Tracked { track, samples: samples.kept, first, last })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MemoryClip, Silent};
    use blindaug::{Encoded, Raster};

    /// A moving texture with noise.
    fn frame(t: usize) -> Encoded {
        let hash = |x: usize, y: usize, t: usize| {
            let mut h = (x as u32) ^ ((y as u32) << 12) ^ ((t as u32) << 24);
            (0..3).for_each(|_| h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d));
            (h >> 16) as f32 / 65536.0 - 0.5
        };
        let texture =
            |x: usize, y: usize| 0.5 + 0.3 * hash((x + 2 * t) / 4, y / 4, 0) + 0.03 * hash(x, y, t + 1);
        Encoded(Raster::from_fn(160, 128, |x, y| [texture(x, y); 3]))
    }

    #[test]
    fn frames_that_are_pushed_give_the_models_of_a_clip() {
        let frames: Vec<Encoded> = (0..5).map(frame).collect();
        let footage = Footage::new(MemoryClip { frames: frames.clone(), fps: Some(25.0) });
        let wanted = track(&footage, Job::default(), &Silent, &mut |_| Ok(())).unwrap().track;
        let pushed = |number: &dyn Fn(u64) -> u64| {
            let mut tracker = FrameTracker::new(Space::default(), NoiseKind::default(), Some(25.0), None);
            let mut cameras = vec![];
            for (i, image) in (1..).zip(&frames) {
                let frame = Frame { number: number(i), image: image.clone() };
                cameras.extend(tracker.push(frame, Beside::default()).unwrap());
                assert_eq!(cameras.len() as u64, i - 1);
            }
            cameras.extend(tracker.finish().unwrap());
            assert_eq!(tracker.finish().unwrap(), None);
            CameraTrack::from_frames(cameras).unwrap()
        };
        assert_eq!(pushed(&|i| i), wanted);
        assert!(wanted.frames()[4].camera.noise.known().is_some());
        // Negative control: with gaps between them, the frames show no motion, and their noise is not told.
        assert_ne!(pushed(&|i| 2 * i).frames()[4].camera.noise, wanted.frames()[4].camera.noise);
    }
}
