//! The estimation of one camera model from a clip.

use crate::{
    Error, Result,
    footage::{Clip, Footage, READ_AHEAD},
    observer::{Observer, Steps},
    operators::{EvidenceSink, Operators},
    window::{Save, Seen, Viewer, show},
};
use blindaug::{
    Flow, Plane, Sample, analysis,
    fit::{Estimation, Estimator, EstimatorOptions, FrameObservation, Shot},
    model::SceneDepth,
};

/// An estimate and the frames that it rests on.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The estimate.
    pub estimation: Estimation,
    /// A few frames for a report, if they were asked for.
    pub samples: Vec<Sample>,
    /// The first frame's number.
    pub first: u64,
    /// The last frame's number.
    pub last: u64,
    /// The numbers of the frames that the estimator was given, in their order.
    pub numbers: Vec<u64>,
    /// The numbers of the first and last frame of each shot, in the order of time. A clip without a cut is one shot.
    pub shots: Vec<(u64, u64)>,
}

/// The most frames that are kept for a report.
const SAMPLES: usize = 3;

pub(crate) fn of_frame(clip: &dyn Clip, number: u64, error: blindaug::Error) -> Error {
    Error::Frame { clip: clip.name(), number, error }
}

pub(crate) fn of_clip(clip: &dyn Clip, error: blindaug::Error) -> Error {
    Error::Clip { clip: clip.name(), error }
}

/// Fails if the frames that are in memory at once, the accompanying data of one of them, the frames kept as samples, and `work` bytes for
/// the work on a frame do not fit into the budget.
pub(crate) fn check_memory(footage: &Footage, reach: usize, keep_samples: bool, work: u64) -> Result<()> {
    /// Bytes per pixel of a frame, and of a sample with its accompanying data.
    const FRAME: u64 = 12;
    const SAMPLE: u64 = 36;
    let clip = &*footage.clip;
    let (width, height) = clip.size();
    let frames = clip.len_hint().unwrap_or(usize::MAX).clamp(1, 2 * reach.max(1) + 1 + READ_AHEAD);
    let frames = frames + footage.removed().iter().filter(|f| f.is_some()).count();
    let per_pixel = FRAME * frames as u64
        + if footage.depth.is_some() { 4 } else { 0 }
        + if footage.flow.is_some() { 8 } else { 0 }
        + if keep_samples { SAMPLE * frames.min(SAMPLES) as u64 } else { 0 }
        // The flow of a sample is found at its own size.
        + if keep_samples && footage.flow.is_none() { analysis::flow::BYTES_PER_PIXEL } else { 0 };
    let what = format!("estimation from frames of {width} x {height} pixels");
    clip.check_memory(&what, per_pixel * (width * height) as u64 + work)
}

/// Keeps a few frames for a report, if they are wanted.
pub(crate) struct Samples {
    /// The number of frames of the clip, if it is known.
    of: Option<usize>,
    wanted: bool,
    /// The number of frames seen so far.
    seen: usize,
    pub kept: Vec<Sample>,
}

impl Samples {
    pub fn new(of: Option<usize>, wanted: bool) -> Self {
        Self { of, wanted, seen: 0, kept: Vec::new() }
    }

    /// Whether the next frame is kept. The kept frames are spread over the clip if its length is known, else they are the first ones.
    fn wants_next(&self) -> bool {
        let spread = |i: usize| match self.of {
            Some(n) if n > SAMPLES => (2 * i + 1) * n / (2 * SAMPLES),
            _ => i,
        };
        let kept = self.kept.len();
        self.wanted && kept < SAMPLES && self.seen >= spread(kept)
    }

    /// Takes the next frame; `found` is the inverse depth that was found in it where none is given.
    pub fn keep(
        &mut self,
        clip: &dyn Clip,
        number: u64,
        observation: &FrameObservation,
        found: Option<&Plane>,
    ) -> Result<()> {
        if self.wants_next() {
            let FrameObservation { frame, next, evidence, .. } = *observation;
            let flow = match (evidence.flow, next) {
                (None, Some(next)) => Some(
                    analysis::flow::flow(&frame.luma(), &next.luma())
                        .map_err(|e| of_frame(clip, number, e))?,
                ),
                (flow, _) => flow.cloned(),
            };
            self.kept.push(Sample {
                number,
                frame: frame.clone(),
                next: next.cloned(),
                flow,
                inverse_depth: evidence.inverse_depth.map(|d| d.0).or(found).cloned(),
                clean: evidence.clean.cloned(),
            });
        }
        self.seen += 1;
        Ok(())
    }
}

/// Estimates one model from all frames.
struct WholeClip<'a> {
    clip: &'a dyn Clip,
    options: EstimatorOptions,
    estimator: Estimator,
    /// The numbers of the frames so far.
    numbers: Vec<u64>,
    samples: Samples,
}

impl WholeClip<'_> {
    /// The flow from the last frame of a part to the frame after it, which an estimate of the whole finds; `None` if it needs none, or there is a cut.
    fn flow_after(&self, last: &FrameObservation, save: &Save) -> blindaug::Result<Option<Flow>> {
        let Some(after) = save.after.filter(|_| last.evidence.flow.is_none()) else { return Ok(None) };
        let mut beyond = Estimator::new(self.options);
        beyond.add(&FrameObservation { next: Some(after), previous: None, ..*last })?;
        Ok(beyond.flow().cloned())
    }
}

impl Viewer for WholeClip<'_> {
    fn wants_next(&self) -> bool {
        self.estimator.wants_next() || self.samples.wants_next()
    }

    fn view(&mut self, number: u64, observation: &FrameObservation, save: Option<Save>) -> Result<()> {
        self.numbers.push(number);
        let used = self.estimator.add(observation).map_err(|e| of_frame(self.clip, number, e))?;
        if let (true, Some(save)) = (used, save) {
            let found = self.flow_after(observation, &save).map_err(|e| of_frame(self.clip, number, e))?;
            let flow = self.estimator.flow().or(found.as_ref());
            save.sink.geometry(number, flow, self.estimator.inverse_depth())?;
        }
        let found = self.estimator.inverse_depth().map(|d| d.0);
        self.samples.keep(self.clip, number, observation, found)
    }
}

/// The options of an estimation from a clip.
#[derive(Default)]
pub struct Job<'a> {
    /// The options of the estimator. If they have no frame rate, it is the clip's.
    pub options: EstimatorOptions,
    /// Whether a few frames are kept for a report.
    pub keep_samples: bool,
    /// The operators, such as networks, that process frames before the estimation.
    pub operators: Option<&'a mut dyn Operators>,
    /// The sink that keeps the evidence.
    pub save: Option<&'a mut dyn EvidenceSink>,
}

/// Estimates the model of a clip. If the observer stops it, the model rests on the frames so far and says so
/// ([`blindaug::CameraModel::stopped`]).
///
/// # Errors
/// If a frame or its accompanying data cannot be used, or memory does not suffice.
pub fn estimate(footage: &Footage, job: Job, observer: &dyn Observer) -> Result<Fitted> {
    let Job { mut options, keep_samples, mut operators, mut save } = job;
    let clip = &*footage.clip;
    let frames = clip.len_hint().unwrap_or(Estimator::MAX_FRAMES);
    let moving = footage.flow.is_none();
    let work = Estimator::bytes(clip.size(), frames, options.family, moving);
    check_memory(footage, operators.as_ref().map_or(0, |o| o.reach()), keep_samples, work)?;
    options.fps = options.fps.or(clip.fps());
    let mut expected = clip.len_hint();
    let (whole, Seen { first, last, stopped, .. }) = loop {
        let estimator = Estimator::new(options).expecting(expected.unwrap_or(0));
        let samples = Samples::new(expected, keep_samples);
        let mut whole = WholeClip { clip, options, estimator, numbers: vec![], samples };
        let operators = operators.as_mut().map(|o| &mut **o as &mut dyn Operators);
        let sink = save.as_mut().map(|s| &mut **s as &mut dyn EvidenceSink);
        let seen = show(footage, operators, sink, "estimating", &mut whole, observer)?;
        if let Some(n) = expected.filter(|&n| seen.stopped.is_none() && misled(n, seen.frames)) {
            let announced = format!("{} announces {n} frames and has {}", clip.name(), seen.frames);
            if save.is_none() {
                observer.note(&format!("{announced}: it is gone through again, for more of them"));
                expected = Some(seen.frames);
                continue;
            }
            // The evidence that was saved would be saved again.
            observer.warning(&format!(
                "{announced}: only a few of them were used, since evidence is being saved; save none to use more"
            ));
        }
        break (whole, seen);
    };
    let fitting = Steps::begin(observer, "fitting", "", None);
    let mut estimation = whole.estimator.estimate().map_err(|e| of_clip(clip, e))?;
    drop(fitting);
    estimation.model.stopped = stopped;
    if let Some(aspect) = clip.pixel_aspect().filter(|&aspect| aspect != 1.0) {
        estimation.model = estimation.model.measured_in_pixels_of(aspect);
        if estimation.model.defocus.known().is_some() {
            estimation.diagnostics.notes.push(format!(
                "the pixels are {aspect:.3} times as wide as high: the lens was fitted as if its blur in px were round, then converted, so that \
                 its interval is too narrow"
            ));
        }
    }
    // Only the lens relates the depth to anything.
    if let (Some(lens), Some((index, depth))) =
        (estimation.model.defocus.known(), &estimation.diagnostics.inverse_depth)
    {
        let number = whole.numbers.get(*index).copied().unwrap_or(first);
        estimation.model.scene_depth = SceneDepth::of(depth, lens.depth_kind, number);
    }
    let diagnostics = &mut estimation.diagnostics;
    if !diagnostics.shots.is_empty() {
        diagnostics.notes.insert(0, words_of_shots(&diagnostics.shots, &whole.numbers));
    }
    let number = |index: usize| whole.numbers[index];
    let mut shots: Vec<(u64, u64)> =
        diagnostics.shots.iter().map(|s| (number(s.frames.start), number(s.frames.end - 1))).collect();
    if shots.is_empty() {
        shots.push((first, last));
    }
    let WholeClip { numbers, samples, .. } = whole;
    Ok(Fitted { estimation, samples: samples.kept, first, last, numbers, shots })
}

/// Whether a clip that announced so many frames has so much fewer that an estimator which left out frames by that number used too few.
fn misled(announced: usize, frames: usize) -> bool {
    announced > Estimator::MAX_FRAMES && 4 * frames < 3 * announced
}

/// A sentence about the shots: the frames and the exposure of each of the first ten.
fn words_of_shots(shots: &[Shot], numbers: &[u64]) -> String {
    const TOLD: usize = 10;
    let words = |shot: &Shot| {
        let (first, last) = (numbers[shot.frames.start], numbers[shot.frames.end - 1]);
        match shot.motion_blur.known() {
            Some(m) => {
                let [low, high] = m.interval;
                format!("{first} to {last} (exposure {:.2}, {low:.2} to {high:.2})", m.exposure.0)
            }
            None => format!("{first} to {last} (exposure unknown)"),
        }
    };
    let told = shots.iter().take(TOLD).map(words).collect::<Vec<String>>().join(", ");
    let rest = if shots.len() > TOLD { ", .." } else { "" };
    format!(
        "there are {} shots: frames {told}{rest}; estimate one alone by its frames, or track a model for each frame",
        shots.len()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::footage::AlteredClip;
    use crate::observer::Silent;
    use blindaug::{Encoded, Raster};

    #[test]
    fn a_clip_with_fewer_frames_than_it_announces_is_gone_through_again() {
        let frame = |i: usize| {
            Encoded(Raster::from_fn(64, 48, |x, y| [0.3 + 0.05 * ((x * 7 + y * 13 + 31 * i) % 8) as f32; 3]))
        };
        let used = |announced: usize| {
            let clip = AlteredClip::of((0..20).map(frame).collect());
            let footage = Footage::new(AlteredClip { len_hint: Some(announced), ..clip });
            estimate(&footage, Job::default(), &Silent).unwrap().estimation.model.capture.frames_used
        };
        assert_eq!((used(20), used(400)), (20, 20));
        // A clip that announces a few too many, or of which no frame is left out, is not gone through again.
        assert!(misled(444, 68) && !misled(444, 440) && !misled(20, 5));
    }
}
