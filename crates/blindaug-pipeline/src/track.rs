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
    Sample,
    fit::{FrameObservation, track::Tracker},
    model::{CameraTrack, NoiseKind, Space, TrackedCamera},
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
        let mut camera = self.tracker.push(observation).map_err(|e| of_frame(self.clip, number, e))?.clone();
        self.noise_kind.reduce(&mut camera.noise);
        if let Some(aspect) = self.clip.pixel_aspect() {
            camera = camera.measured_in_pixels_of(aspect);
        }
        if let Some(last) = self.cameras.last() {
            (self.each)(last)?;
        }
        self.cameras.push(TrackedCamera { frame: number, changed: self.tracker.changes(), camera });
        self.samples.keep(number, observation, None)
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
