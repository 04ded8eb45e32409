//! The estimate of one camera model from the frames of a clip.

use super::defocus::BlurPoint;
use super::distant::DistantPairs;
use super::geometry::{Follower, WantsParallax, check_sizes, no_parallax, parallax_of};
use super::noise::{LumaNoise, NoiseEvidence, NoiseFit};
use super::observation::{
    Curve, Diagnostics, Estimation, EstimatorOptions, Evidence, Family, FrameObservation, Shot,
};
use super::robust::{aggregate, median};
use super::uneven::SpeedBy;
use super::{agreement, bokeh, defocus, motion_blur, removal, sharpening, spectral, tiles, uneven};
use crate::analysis::cuts::{MIN_CONFIRMED, cut_between};
use crate::analysis::depth::Parallax;
use crate::analysis::flow::motion_at_frame;
use crate::model::{
    CameraModel, Capture, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction, Method,
    MotionBlurModel, Reason, SharpeningModel, ThinLensInterval, Unknown,
};
use crate::strips::largest_strip;
use crate::synth::{self, defocus::Bokeh};
use crate::{Encoded, Error, Flow, Plane, Result, analysis, filter};
use std::borrow::Cow;
use std::ops::Range;

/// Takes frames one after another and gives one camera model. The memory used does not grow with the length of a clip, since frames
/// are thinned out evenly once there are more than [`Estimator::MAX_FRAMES`].
pub struct Estimator {
    options: EstimatorOptions,
    size: Option<(usize, usize)>,
    /// The number of frames that are expected; 0 if it is unknown.
    expected: usize,
    /// The number of frames given so far.
    given: usize,
    /// The distance between the frames that are used.
    stride: usize,
    frames: Vec<FrameEvidence>,
    follower: Follower,
    /// Finds the flow from the frame before where frames are left out; half the resolution is enough for its part in a mean.
    backward: Follower,
    distant: DistantPairs,
    /// The reason why parallax gave no depth for the last frame whose depth is unknown.
    why_no_depth: Unknown,
    depth_kind: Option<DepthKind>,
    depth_given: bool,
    last_depth: Option<(usize, Plane)>,
    last_motion: Option<LastMotion>,
    /// The number of frames of which too little is found again in their neighbour.
    unfollowed: usize,
    /// The index of the first frame of each shot.
    shots: Vec<usize>,
    /// Whether the next frame belongs to another shot.
    cut_ahead: bool,
    /// Whether a network made any of the given images.
    by_network: bool,
}

/// The motion of the frame added last.
struct LastMotion {
    /// The frame's index among the given frames.
    index: usize,
    /// The flow to the next frame, px.
    flow: Flow,
    /// The motion at the frame's own time, px per frame interval, if it is not the flow.
    at_frame: Option<Flow>,
    /// Whether nothing moves between the frame and its neighbour.
    still: bool,
}

impl LastMotion {
    /// The motion at the frame's own time, px per frame interval.
    fn motion(&self) -> &Flow {
        self.at_frame.as_ref().unwrap_or(&self.flow)
    }
}

/// The exposure fraction that each frame alone gives, with the frame's index among the added frames.
type ExposurePerFrame = Vec<(usize, f32)>;

/// An exposure, its curve, and the exposure fraction of each frame with the frame's index.
type ExposureEvidence = (MotionBlurModel, Vec<[f32; 2]>, Vec<(usize, f32)>);

/// The evidence of one frame.
struct FrameEvidence {
    index: usize,
    shot: usize,
    temporal: NoiseEvidence,
    spatial: NoiseEvidence,
    denoised: NoiseEvidence,
    tiles: Vec<tiles::Tile>,
    /// The pairs of this frame's tiles with those of the frame before.
    pairs: Vec<spectral::Pair>,
    removal: Vec<removal::Tile>,
    has_motion: bool,
    /// [`uneven::change_of`] it; `None` where it is not known.
    change: Option<f32>,
    /// The flow to the next frame, where it was estimated.
    to_next: Option<uneven::SampledFlow>,
    /// The [`uneven::speed_factor`] by which the speeds of the tiles were multiplied.
    speed_factor: f32,
    has_depth: bool,
    exposure: Option<motion_blur::ExposureFit>,
    lens: Option<defocus::LensFit>,
    /// Local blur by the paper's search, for the quadratic.
    search: Vec<BlurPoint>,
}

impl FrameEvidence {
    /// The exposure fraction, the std of the blur at infinity (px) and the inverse depth in focus; 0 in place of each that was not found.
    fn numbers(&self) -> [f32; 3] {
        let lens = self.lens.as_ref().map_or([0.0; 2], |l| [l.lens.sigma_px_at_infinity(), l.lens.focus]);
        [self.exposure.as_ref().map_or(0.0, |e| e.exposure.0), lens[0], lens[1]]
    }

    fn new(index: usize, shot: usize, has_motion: bool, has_depth: bool) -> Self {
        Self {
            index,
            shot,
            temporal: NoiseEvidence::new(Method::Temporal),
            spatial: NoiseEvidence::new(Method::Spatial),
            denoised: NoiseEvidence::new(Method::Removal),
            tiles: vec![],
            pairs: vec![],
            removal: vec![],
            has_motion,
            change: None,
            to_next: None,
            speed_factor: 1.0,
            has_depth,
            exposure: None,
            lens: None,
            search: vec![],
        }
    }
}

/// The least correlation of noise between successive frames of which the user is told.
const NOTABLE_CORRELATION: f32 = 0.1;
/// The shape of a real lens's blur. A Gaussian would fit a disk only with a std that is a fifth too large.
const BOKEH: Bokeh = Bokeh::Disk;
/// The largest change at which the alternating fits of exposure and lens to clean frames stop: of the exposure fraction, of the blur at
/// infinity in px, and of the inverse depth in focus.
const SETTLED: f32 = 1e-3;
/// The std of the exposure fraction that stands for errors of the comparison with clean frames: of the flow, and of what interpolation
/// along the path adds and leaves out (docs/lab-log.md).
const REMOVAL_EXPOSURE_FLOOR: f32 = 0.02;
/// The relative std of the lens's numbers that stands for errors of the comparison with clean frames.
const REMOVAL_LENS_FLOOR: f32 = 0.04;
/// The std of the blur, px, that comparison with clean frames does not tell from none.
const REMOVAL_UNTOLD_PX: f32 = 0.1;
/// The std of the exposure fraction if a network made the clean frames: its errors on other scenes (docs/lab-log.md).
const NETWORK_EXPOSURE_FLOOR: f32 = 0.1;
/// The relative std of the lens's numbers if a network made the clean frames: its errors on other scenes (docs/lab-log.md).
const NETWORK_LENS_FLOOR: f32 = 0.3;

/// Noise of frames of more px than this is measured in a part of each frame.
const NOISE_WHOLE: usize = 1 << 20;
/// The fewest rows of such a part: as many again around it are computed with it.
const NOISE_ROWS: usize = 256;
/// The most pairs of distant frames in which the noise is measured.
const DISTANT_PAIRS: usize = 10;
/// The most frames that are used of a clip that is longer than [`Estimator::MAX_FRAMES`]: the flow from the frame before each of them takes
/// about the time of the frames that are left out.
const THINNED_FRAMES: usize = 40;
/// An estimate from fewer frames comes with a warning.
const FEW_FRAMES: usize = 5;
/// In how many frames each part is measured at least.
const NOISE_SEEN: usize = 4;

impl Estimator {
    /// The most frames of a clip that are used.
    pub const MAX_FRAMES: usize = 48;

    /// The width, px, to which frames are halved before their flow is found.
    const FLOW_WIDTH: usize = 960;

    /// The most bytes, approximately, that an estimator takes for `frames` frames of this size, beside the frames and their given evidence.
    /// `moving`: whether the flow of the frames is to be estimated.
    pub fn bytes(size @ (width, height): (usize, usize), frames: usize, family: Family, moving: bool) -> u64 {
        /// The measured bytes for each pixel: of a strip, of the motion of a frame, of removal, and of the evidence kept of each frame.
        const OF_STRIP: u64 = 80;
        const MOTION: u64 = 72;
        const REMOVAL: u64 = 120;
        const KEPT: u64 = 1;
        let pixels = (width * height) as u64;
        let motion = if frames > 1 { MOTION } else { 0 };
        let flow = if moving && frames > 1 {
            let halvings = (0..).find(|k| width.div_ceil(1 << k) <= Self::FLOW_WIDTH).unwrap_or(0);
            analysis::flow::BYTES_PER_PIXEL * (pixels >> (2 * halvings))
        } else {
            0
        };
        let removal = if family == Family::Removal { REMOVAL * pixels } else { 0 };
        let kept = KEPT * frames.clamp(1, Self::MAX_FRAMES) as u64;
        // Flow is estimated before blur is removed, so only the larger of the two counts.
        (motion + kept) * pixels + flow.max(removal) + OF_STRIP * largest_strip(size)
    }

    /// An estimator that has seen nothing yet.
    pub fn new(options: EstimatorOptions) -> Self {
        Self {
            options,
            size: None,
            expected: 0,
            given: 0,
            stride: 1,
            frames: vec![],
            follower: Follower::new(Self::FLOW_WIDTH, false),
            backward: Follower::new(Self::FLOW_WIDTH / 2, false),
            distant: DistantPairs::new(DISTANT_PAIRS, 0),
            why_no_depth: Unknown::new(Reason::NoDepth, "no depth was given and there is only one frame"),
            depth_kind: None,
            depth_given: false,
            last_depth: None,
            last_motion: None,
            unfollowed: 0,
            shots: vec![0],
            cut_ahead: false,
            by_network: false,
        }
    }

    /// Announces that the clip has about this many frames. Evenly spaced frames are then used from the start, which saves time.
    pub fn expecting(mut self, frames: usize) -> Self {
        self.expected = frames;
        self.stride = if frames > Self::MAX_FRAMES { frames.div_ceil(THINNED_FRAMES) } else { 1 };
        self.distant = DistantPairs::new(DISTANT_PAIRS, frames);
        self
    }

    /// Whether the next frame given to [`Estimator::add`] will be used rather than thinned out. If not, the caller need not read the
    /// frame's evidence.
    pub fn wants_next(&self) -> bool {
        self.given.is_multiple_of(self.stride)
    }

    /// Adds the next frame in the order of time, and says whether the frame was used.
    ///
    /// # Errors
    /// If a size differs from the first frame's, or the frame is not finite.
    // Long, since each kind of evidence of a frame builds on the motion that was found before.
    pub fn add(&mut self, observation: &FrameObservation) -> Result<bool> {
        let FrameObservation { frame, next, previous, mut evidence } = *observation;
        check_sizes(&mut self.size, observation)?;
        if evidence.found_before && next.is_none() {
            // Flow that was saved with a part of a clip may lead to the frame after it, which an estimate of the part alone does not look at.
            evidence.flow = None;
        }
        let index = self.given;
        self.given += 1;
        self.by_network |= evidence.by_network;
        let opens = std::mem::take(&mut self.cut_ahead);
        if opens {
            self.shots.push(index);
            self.follower.forget_scale();
            self.distant.begin_shot();
            self.last_motion = None;
        }
        self.cut_ahead = next.map_or(Ok(false), |next| cut_between(frame, next))?;
        if !index.is_multiple_of(self.stride) {
            return Ok(false);
        }
        // A frame beyond a cut is no neighbour.
        let (next, previous) = (next.filter(|_| !self.cut_ahead), previous.filter(|_| !opens));
        let neighbour = next.map(|n| (n, 1.0)).or(previous.map(|p| (p, -1.0)));
        let mut parallax = None;
        let mut flow = evidence.flow.map(Cow::Borrowed);
        if let (None, Some((other, _))) = (&flow, neighbour) {
            let wants = WantsParallax { confirmed: MIN_CONFIRMED, stride: self.stride };
            let wants = evidence.inverse_depth.is_none().then_some(wants);
            let followed = self.follower.follow(frame, other, wants, Flow::filled(0, 0, [0.0; 2]))?;
            self.unfollowed += usize::from(followed.flow.is_none());
            flow = followed.flow.map(Cow::Owned);
            parallax = followed.parallax;
        }
        let depth = self.depth_of(&evidence, parallax)?;
        let mut kept = FrameEvidence::new(index, self.shots.len() - 1, flow.is_some(), depth.is_some());
        // Given flow leads to the next frame.
        let mut still = false;
        let flow_given = evidence.flow.is_some() && !evidence.found_before;
        let to_neighbour = flow.as_deref().filter(|_| evidence.flow.is_none() || next.is_some());
        if let (Some(flow), Some((other, _))) = (to_neighbour, neighbour) {
            still = kept.temporal.add_pair_in_turn(frame, other, flow, self.noise_turn(index))?;
            let was_still = self.last_motion.as_ref().is_some_and(|l| l.index + 1 == index && l.still);
            if let (true, Some(before), Some(next)) = (still && was_still, previous, next) {
                kept.temporal.add_successive([before, frame, next]);
            }
        }
        // A single image has no pair, so it need not be held.
        if neighbour.is_some() {
            let coded = || kept.temporal.fit().luma.is_some_and(|l| l.may_be_compressed());
            let part = self.noise_turn(index);
            self.distant.push((index, frame), coded, &mut self.follower, part)?;
        }
        if !kept.temporal.is_enough() {
            kept.spatial.add_single(frame);
        }
        // The flow to the next frame; if there is none, the motion from the previous frame is taken to continue.
        let to_next = match neighbour {
            Some((_, -1.0)) if evidence.flow.is_none() => flow.map(|f| Cow::Owned(f.map(|v| v.map(|c| -c)))),
            _ => flow,
        };
        // The shutter is open around the frame's own time, not on the way to the next frame.
        let last = self.last_motion.take().filter(|l| l.index + 1 == index);
        let from_previous = match (&last, previous, next) {
            // Frames were left out, so that this flow was not needed before.
            (None, Some(previous), Some(_)) if self.stride > 1 && to_next.is_some() && !flow_given => {
                self.backward.follow(previous, frame, None, Flow::filled(0, 0, [0.0; 2]))?.flow
            }
            _ => None,
        };
        let from_previous = last.as_ref().map(|l| &l.flow).or(from_previous.as_ref());
        let mut at_frame =
            to_next.as_ref().zip(from_previous).map(|(flow, last)| motion_at_frame(flow, last));
        // A motion that is only taken to continue says nothing of a difference between the motions of two frames.
        let measured = next.is_some() || flow_given;
        let mut speed_error = 0.0;
        if let (Some(to_next), true) = (&to_next, self.options.family != Family::Removal && !flow_given) {
            kept.to_next = measured.then(|| uneven::SampledFlow::new(to_next));
            let motion = at_frame.as_ref().unwrap_or(to_next);
            let turned;
            (speed_error, turned) = self.uneven(&mut kept, frame, measured.then_some(&**to_next), motion);
            at_frame = turned.or(at_frame);
        }
        let motion = at_frame.as_ref().or(to_next.as_deref());
        if self.options.family != Family::Removal {
            kept.tiles = tiles::tiles(frame, motion, depth.as_ref(), self.options.space)?;
            kept.tiles.iter_mut().for_each(|t| t.speed_error = speed_error);
            if let (true, Some(before), Some(last), Some(own)) =
                (measured && speed_error == 0.0, previous, &last, motion)
            {
                let motions = [last.motion(), own];
                kept.pairs = spectral::pairs([before, frame], &last.flow, motions, self.options.space);
            }
        }
        // Removal is needed for distortions that no given image shows.
        let deblurred = evidence.motion_deblurred.is_some() && evidence.defocus_deblurred.is_some();
        if self.options.family == Family::Removal && evidence.clean.is_none() && !deblurred {
            let moves = to_next.as_deref().zip(motion);
            let within_shot = FrameObservation { next, previous, ..*observation };
            kept.removal = self.removal_tiles(&within_shot, &kept, moves, depth.as_ref());
        }
        if self.options.family != Family::Spectral {
            self.compare_with_clean(&mut kept, frame, &evidence, motion, depth.as_ref())?;
        }
        self.last_depth = depth.map(|d| (index, d)).or(self.last_depth.take());
        self.last_motion = to_next.filter(|_| measured).map(|flow| LastMotion {
            index,
            flow: flow.into_owned(),
            at_frame,
            still,
        });
        self.keep(kept);
        self.correct_speeds();
        Ok(true)
    }

    /// Corrects the speeds of the last frames' tiles, where motion is uneven, by the frames around them that are known by now.
    fn correct_speeds(&mut self) {
        let follows = |w: &&[FrameEvidence]| w[0].shot == w[1].shot && w[0].index + 1 == w[1].index;
        let pairs = self.frames.windows(2).rev().take(2 * uneven::SPLINE_REACH);
        let first = self.frames.len() - 1 - pairs.take_while(follows).count();
        let frames = &self.frames[first..];
        let flows: Vec<Option<&uneven::SampledFlow>> = frames.iter().map(|f| f.to_next.as_ref()).collect();
        let corrected = frames.len().saturating_sub(uneven::SPLINE_REACH + 1)..frames.len();
        let uneven = |i: &usize| frames[*i].tiles.iter().any(|t| t.speed_error > 0.0);
        let factors: Vec<(usize, f32)> = corrected
            .filter(uneven)
            .map(|i| {
                let before: Vec<_> = flows[..i].iter().rev().map_while(|f| *f).collect();
                let after: Vec<_> = flows[i..].iter().map_while(|f| *f).collect();
                (first + i, uneven::speed_factor(&before, &after))
            })
            .collect();
        for (i, factor) in factors {
            let frame = &mut self.frames[i];
            frame.tiles.iter_mut().for_each(|t| t.speed *= factor / frame.speed_factor);
            frame.speed_factor = factor;
        }
    }

    /// Finds out whether the motion of a frame is uneven. If so, it is turned to the direction of the frame's streaks, and that is given
    /// with the relative std of its speed. `to_next` is the flow to the next frame, if there is one.
    fn uneven(
        &mut self,
        kept: &mut FrameEvidence,
        frame: &Encoded,
        to_next: Option<&Flow>,
        motion: &Flow,
    ) -> (f32, Option<Flow>) {
        let at = |x: usize, y: usize| motion.at(x, y);
        kept.change = to_next.and_then(|next| uneven::change_of(next.size(), &|x, y| next.at(x, y), &at));
        let near = |f: &&mut FrameEvidence| {
            f.shot == kept.shot && f.index + uneven::NEAR * self.stride >= kept.index
        };
        let by = |change: Option<f32>| match change {
            None => SpeedBy::OneFlow,
            Some(_) if self.stride > 1 => SpeedBy::Mean,
            Some(_) => SpeedBy::Spline,
        };
        let mut largest = kept.change;
        for before in self.frames.iter_mut().rev().take_while(near) {
            largest = [largest, before.change].into_iter().flatten().reduce(f32::max);
            // What swings between any two of them swings in all of them, but not always at their own times.
            let Some(change) = kept.change else { continue };
            let error = uneven::speed_error(change, by(before.change));
            if error > 0.0 {
                before.tiles.iter_mut().for_each(|t| t.speed_error = t.speed_error.max(error));
                before.pairs.clear();
            }
        }
        let Some(change) = largest else { return (0.0, None) };
        let error = uneven::speed_error(change, by(kept.change));
        let turned = (error > 0.0).then(|| {
            let noise = kept.temporal.fit().luma.or_else(|| kept.spatial.fit().luma)?;
            let corners = uneven::every_second_corner(frame.0.size());
            let angle = uneven::turn(frame, &corners, &at, change, &noise, self.options.space);
            Some(uneven::turned_by(motion, angle))
        });
        (error, turned.flatten())
    }

    /// Which of how many parts of a frame's rows its noise is measured in: all of a frame of at most [`NOISE_WHOLE`] px, of a larger one a
    /// part, another in each frame that is looked at, if there are enough of them that each part is seen [`NOISE_SEEN`] times.
    fn noise_turn(&self, index: usize) -> (usize, usize) {
        let (width, height) = self.size.unwrap_or_default();
        let turns = (height / NOISE_ROWS).min(self.expected / self.stride / NOISE_SEEN);
        let turns = if width * height > NOISE_WHOLE { turns.max(1) } else { 1 };
        (index / self.stride % turns, turns)
    }

    /// The inverse depth of a frame: the given one, else that from parallax, else `None`.
    fn depth_of(&mut self, evidence: &Evidence, mut parallax: Option<Parallax>) -> Result<Option<Plane>> {
        Ok(match evidence.inverse_depth {
            Some((d, kind)) => {
                self.depth_kind = Some(kind);
                self.depth_given = true;
                Some(d.clone())
            }
            // Given depth of some frames is not mixed with depth from parallax, which is in another unit.
            None if self.depth_given => None,
            None => {
                if let (None, Some(flow), false) = (&parallax, evidence.flow, evidence.found_before) {
                    parallax = Some(parallax_of(flow)?);
                }
                match parallax {
                    Some(Parallax::Known(depth)) => {
                        self.depth_kind.get_or_insert(DepthKind::Relative);
                        Some(depth.inverse_depth)
                    }
                    Some(Parallax::Unknown(why)) => {
                        self.why_no_depth = no_parallax(&why);
                        None
                    }
                    None => {
                        if evidence.found_before && evidence.flow.is_some() {
                            let why = "no depth was given, and none was found when this evidence was saved";
                            self.why_no_depth = Unknown::new(Reason::NoDepth, why);
                        }
                        None
                    }
                }
            }
        })
    }

    /// Keeps the evidence of a frame; if there are too many frames, every second one is dropped.
    fn keep(&mut self, frame: FrameEvidence) {
        self.frames.push(frame);
        if self.frames.len() > Self::MAX_FRAMES {
            let mut keep = false;
            self.frames.retain(|_| {
                keep = !keep;
                keep
            });
            self.stride *= 2;
        }
    }

    /// The tiles by which removal measures the blur of a frame without clean images. The noise is that of this frame alone, since the whole
    /// clip's is known only at the end.
    fn removal_tiles(
        &self,
        observation: &FrameObservation,
        kept: &FrameEvidence,
        flow_and_motion: Option<(&Flow, &Flow)>,
        depth: Option<&Plane>,
    ) -> Vec<removal::Tile> {
        let noise = kept.temporal.fit().luma.or_else(|| kept.spatial.fit().luma).unwrap_or_default();
        let light = removal::NoisyLight::new(observation.frame, &noise.levels[0], self.options.space);
        let Some((flow, motion)) = flow_and_motion else { return removal::tiles(&light, None, depth) };
        let neighbours: Vec<(Plane, f32)> = [(observation.next, 1.0), (observation.previous, -1.0)]
            .into_iter()
            .filter_map(|(other, later)| Some((tiles::light_of(other?, self.options.space), later)))
            .collect();
        removal::tiles(&removal::denoise(&light, &neighbours, flow), Some(motion), depth)
    }

    /// The paper's fits, to all clean images that are given.
    fn compare_with_clean(
        &self,
        kept: &mut FrameEvidence,
        frame: &Encoded,
        evidence: &Evidence,
        motion: Option<&Flow>,
        depth: Option<&Plane>,
    ) -> Result<()> {
        let light = |image: &Encoded| tiles::light_of(image, self.options.space);
        let Evidence { denoised, motion_deblurred, defocus_deblurred, clean, .. } = evidence;
        if [denoised, motion_deblurred, defocus_deblurred, clean].iter().all(|image| image.is_none()) {
            return Ok(());
        }
        // The chain is that of the paper: each distortion is fitted between the images before and after its removal, or else between the
        // frame and the clean frame with the other distortion applied.
        let target = light(evidence.denoised.unwrap_or(frame));
        let weight = self.noise_weight(frame);
        let clean = evidence.clean.map(light);
        let exposure_alone =
            |sharp: &Plane| motion.and_then(|f| motion_blur::fit_exposure(&target, &weight, sharp, f));
        let lens_alone = |target: &Plane, sharp: &Plane| {
            depth.and_then(|d| defocus::fit_lens(target, &weight, sharp, d, None))
        };
        if let Some(deblurred) = evidence.motion_deblurred {
            let deblurred = light(deblurred);
            kept.exposure = exposure_alone(&deblurred);
            if let Some(clean) = &clean {
                kept.lens = lens_alone(&deblurred, clean);
                if let (Some(d), Curve::Quadratic) = (depth, self.options.curve) {
                    kept.search = defocus::pooled_search(&deblurred, clean, d);
                }
            }
        } else if let Some(clean) = &clean {
            kept.exposure = exposure_alone(clean);
            kept.lens = lens_alone(&target, clean);
            if let (Some(motion), Some(depth), Some(_), Some(_)) = (motion, depth, &kept.exposure, &kept.lens)
            {
                for _ in 0..3 {
                    let lens = kept.lens.as_ref().map(|l| l.lens);
                    let defocused = match lens {
                        Some(l) => synth::defocus::defocus(clean, &depth.map(|d| l.sigma_px(d)), BOKEH)?,
                        None => clean.clone(),
                    };
                    let before = kept.numbers();
                    kept.exposure = exposure_alone(&defocused);
                    let exposure = kept.exposure.as_ref().map_or(ExposureFraction(0.0), |e| e.exposure);
                    kept.lens = defocus::fit_lens(&target, &weight, clean, depth, Some((motion, exposure)));
                    if before.iter().zip(kept.numbers()).all(|(a, b)| (a - b).abs() < SETTLED) {
                        break;
                    }
                }
            }
            if let (Some(d), Curve::Quadratic) = (depth, self.options.curve) {
                let exposure = kept.exposure.as_ref().map_or(ExposureFraction(0.0), |e| e.exposure);
                let still = motion
                    .map_or(Ok(clean.clone()), |f| synth::motion_blur::motion_blur(clean, f, exposure))?;
                kept.search = defocus::pooled_search(&target, &still, d);
            }
        }
        if let Some(sharp) = evidence.defocus_deblurred {
            let sharp = light(sharp);
            kept.lens = lens_alone(&target, &sharp);
            if let (Some(d), Curve::Quadratic) = (depth, self.options.curve) {
                kept.search = defocus::pooled_search(&target, &sharp, d);
            }
        }
        match (evidence.denoised, evidence.clean) {
            (Some(denoised), _) => kept.denoised.add_denoised(frame, denoised)?,
            (None, Some(clean)) => {
                let blurred = self.reblurred(clean, kept, motion, depth)?;
                kept.denoised.add_residual(frame, &blurred, clean)?;
            }
            _ => {}
        }
        Ok(())
    }

    /// The clean frame with the blur that was found in this frame.
    fn reblurred(
        &self,
        clean: &Encoded,
        found: &FrameEvidence,
        motion: Option<&Flow>,
        depth: Option<&Plane>,
    ) -> Result<Encoded> {
        let space = self.options.space;
        let mut image = clean.0.map(|v| space.of_encoded(v));
        if let (Some(l), Some(d)) = (&found.lens, depth) {
            image = synth::defocus::defocus(&image, &d.map(|d| l.lens.sigma_px(d)), BOKEH)?;
        }
        if let (Some(e), Some(f)) = (&found.exposure, motion) {
            image = synth::motion_blur::motion_blur(&image, f, e.exposure)?;
        }
        Ok(Encoded(image.map(|v| space.encoded(v))))
    }

    /// The inverse std of the frame's noise in the light that is blurred, up to a constant: noise is nearly the same at all encoded values,
    /// so the std in light is in proportion to the inverse slope of the transfer curve.
    fn noise_weight(&self, frame: &Encoded) -> Plane {
        let space = self.options.space;
        filter::gaussian_blur(&frame.luma(), 1.5).map(|v| space.slope(v.clamp(0.02, 1.0)) * 100.0)
    }

    /// The flow to the next frame that was used for the frame added last, px; `None` if the frame was not used or its flow is unknown.
    pub fn flow(&self) -> Option<&Flow> {
        self.last_motion.as_ref().filter(|l| l.index + 1 == self.given).map(|l| &l.flow)
    }

    /// The inverse depth that was used for the frame added last, and its unit; `None` if the frame was not used or its depth is unknown.
    pub fn inverse_depth(&self) -> Option<(&Plane, DepthKind)> {
        let depth = self.last_depth.as_ref().filter(|d| d.0 + 1 == self.given);
        depth.map(|d| &d.1).zip(self.depth_kind)
    }

    /// The model that the frames so far give.
    ///
    /// # Errors
    /// If there was no frame.
    pub fn estimate(&self) -> Result<Estimation> {
        let Some((width, height)) = self.size else { return Err(Error::new("no frame was given")) };
        let capture = Capture {
            width,
            height,
            fps: self.options.fps,
            frames_used: self.frames.len(),
            pixel_aspect: 1.0,
        };
        let mut model = CameraModel::unknown(capture, "not looked at");
        (model.blur_space, model.transfer) = (self.options.space.blur, self.options.space.transfer);
        let mut diagnostics = Diagnostics { inverse_depth: self.last_depth.clone(), ..Default::default() };
        if self.frames.len() < FEW_FRAMES {
            let few = if self.frames.len() == 1 {
                "one frame".into()
            } else {
                format!("{} frames", self.frames.len())
            };
            model.warnings.push(format!("the model rests on {few} only: more frames would make it surer"));
        }
        if self.unfollowed > 0 {
            model.warnings.push(format!(
                "{} of {} frames could not be followed to their neighbour (too much changed)",
                self.unfollowed,
                self.frames.len()
            ));
        }
        let luma_noise = self.fit_noise(&mut model, &mut diagnostics);
        self.fit_exposure(&mut model, &mut diagnostics, luma_noise.as_ref())?;
        self.fit_defocus(&mut model, &mut diagnostics, luma_noise.as_ref())?;
        model.validate()?;
        Ok(Estimation { model, diagnostics })
    }

    fn fit_noise(&self, model: &mut CameraModel, diagnostics: &mut Diagnostics) -> Option<LumaNoise> {
        let merged = |method: Method, of: &dyn Fn(&FrameEvidence) -> &NoiseEvidence| {
            let mut all = NoiseEvidence::new(method);
            self.frames.iter().for_each(|f| all.merge(of(f)));
            let fit = all.fit();
            if method == Method::Temporal { self.distant.complete(&all, fit) } else { fit }
        };
        // The difference between frames holds nothing of the image's structure, so temporal noise comes first; clean frames come next.
        let temporal = || merged(Method::Temporal, &|f| &f.temporal);
        let denoised = || merged(Method::Removal, &|f| &f.denoised);
        let spatial = || merged(Method::Spatial, &|f| &f.spatial);
        let order: [&dyn Fn() -> NoiseFit; 3] = match self.options.family {
            // A network's residual holds more of the image than the flattest parts of a frame do.
            _ if self.by_network => [&temporal, &spatial, &denoised],
            Family::Removal => [&denoised, &temporal, &spatial],
            Family::Auto | Family::Spectral => [&temporal, &denoised, &spatial],
        };
        let fit = order.iter().map(|f| f()).find(|f| f.luma.is_some()).unwrap_or_else(spatial);
        if fit.model.known().is_some_and(|m| m.method() == Method::Spatial) {
            diagnostics.notes.push(
                "noise was measured in single frames: coarse noise cannot be told from structure there; how it goes with fine noise is taken from cameras, or from white noise where neighbouring pixels are independent"
                    .into(),
            );
        }
        if let Some(LumaNoise { coding_error, .. }) = fit.luma.filter(LumaNoise::is_compressed) {
            model.warnings.push(format!(
                "there is less noise than a sensor has, or none of it in chroma: the footage was compressed or denoised, and detail weaker than {:.1} % of full scale is not relied on for blur",
                100.0 * coding_error
            ));
        }
        model.sharpening = sharpening::of_noise(&fit);
        if let Estimate::Known(SharpeningModel { amount, interval: [low, high], .. }) = model.sharpening {
            diagnostics.notes.push(format!(
                "the camera sharpens: fine noise is stronger than white noise, as after an unsharp mask of {amount:.1} ({low:.1} to {high:.1})"
            ));
        }
        if let Estimate::Known(noise) = &fit.model
            && noise.temporal_correlation() >= NOTABLE_CORRELATION
        {
            diagnostics.notes.push(format!(
                "noise stays from frame to frame: its correlation between successive frames is {:.2}, as a coder's copying or a denoiser over time leaves it",
                noise.temporal_correlation()
            ));
        }
        diagnostics.noise_points = fit.points;
        model.noise = fit.model;
        self.options.noise_kind.reduce(&mut model.noise);
        fit.luma
    }

    fn fit_exposure(
        &self,
        model: &mut CameraModel,
        diagnostics: &mut Diagnostics,
        noise: Option<&LumaNoise>,
    ) -> Result<()> {
        let moving: Vec<&FrameEvidence> = self.frames.iter().filter(|f| f.has_motion).collect();
        let why = if self.given < 2 {
            Unknown::new(Reason::TooShort, "a single image says nothing about the exposure")
        } else {
            Unknown::new(Reason::NotFollowed, "no frame could be followed to the next")
        };
        let method = self.blind_method();
        (diagnostics.shots, diagnostics.exposure_per_frame) = self.exposure_of_shots(&moving, noise)?;
        let blind = match contradiction(&diagnostics.shots) {
            _ if moving.is_empty() => Estimate::Unknown(why),
            Some(why) => Estimate::Unknown(why),
            None => self.blind_exposure(&moving, noise)?,
        };
        let compared = self.aggregate_exposure();
        let width = |i: [f32; 2]| i[1] - i[0];
        let (known, curve, per_frame, by_tiles) = match (blind, compared) {
            (Estimate::Known(b), Some(c))
                if method != Method::Removal && width(b.interval) <= width(c.0.interval) =>
            {
                (blind_model(method, &b), b.curve, b.per_frame, true)
            }
            (_, Some((m, curve, per_frame))) => (m, curve, per_frame, false),
            (Estimate::Known(b), None) => (blind_model(method, &b), b.curve, b.per_frame, true),
            (Estimate::Unknown(why), None) => {
                model.motion_blur = Estimate::Unknown(why);
                return Ok(());
            }
        };
        model.motion_blur = Estimate::Known(known);
        diagnostics.exposure_curve = curve;
        // The tiles' frames are numbered among the moving frames, and get their index among the given frames here.
        diagnostics.exposure_per_frame =
            per_frame.into_iter().map(|(i, v)| (if by_tiles { moving[i].index } else { i }, v)).collect();
        Ok(())
    }

    /// The exposure that each shot alone gives without clean frames, and that of each frame; both lists are empty if there is no cut.
    fn exposure_of_shots(
        &self,
        moving: &[&FrameEvidence],
        noise: Option<&LumaNoise>,
    ) -> Result<(Vec<Shot>, ExposurePerFrame)> {
        let mut per_frame = vec![];
        if self.shots.len() < 2 {
            return Ok((vec![], per_frame));
        }
        let ends = self.shots[1..].iter().copied().chain([self.given]);
        let shot = |(number, frames): (usize, Range<usize>)| {
            let own: Vec<&FrameEvidence> = moving.iter().filter(|f| f.shot == number).copied().collect();
            let motion_blur = match self.blind_exposure(&own, noise)? {
                // The error of one frame may be larger than its interval.
                Estimate::Known(_) if own.len() < 2 => {
                    Estimate::unknown(Reason::TooShort, "only one of its frames was looked at")
                }
                Estimate::Known(fit) => {
                    per_frame.extend(fit.per_frame.iter().map(|&(i, v)| (own[i].index, v)));
                    Estimate::Known(blind_model(self.blind_method(), &fit))
                }
                Estimate::Unknown(why) => Estimate::Unknown(why),
            };
            Ok(Shot { frames, motion_blur })
        };
        let frames = self.shots.iter().zip(ends).map(|(&first, end)| first..end);
        let shots = frames.enumerate().map(shot).collect::<Result<Vec<Shot>>>()?;
        Ok((shots, per_frame))
    }

    /// The exposure that frames agree on, without clean frames.
    fn blind_exposure(
        &self,
        frames: &[&FrameEvidence],
        noise: Option<&LumaNoise>,
    ) -> Result<Estimate<agreement::ExposureFit>> {
        if self.blind_method() == Method::Removal {
            return Ok(removal::fit_exposure(&removal_tiles(frames)));
        }
        let Some(noise) = noise else { return Ok(Estimate::Unknown(noise_unknown())) };
        let pairs: Vec<&[spectral::Pair]> = frames.iter().map(|f| f.pairs.as_slice()).collect();
        spectral::fit_exposure(&spectral_tiles(frames), &pairs, noise)
    }

    /// The method that measures blur if no clean frames are given. It is not the one with the tighter interval, since the intervals of
    /// [`removal`] are too narrow (docs/lab-log.md), and [`removal`] is slower.
    fn blind_method(&self) -> Method {
        if self.options.family == Family::Removal { Method::Removal } else { Method::Spectral }
    }

    /// The weighted median of the exposure over the frames that were compared with clean frames; `None` if its interval is too wide.
    fn aggregate_exposure(&self) -> Option<ExposureEvidence> {
        let fits: Vec<(usize, &motion_blur::ExposureFit)> =
            self.frames.iter().filter_map(|f| f.exposure.as_ref().map(|e| (f.index, e))).collect();
        let values: Vec<(f32, f64)> = fits.iter().map(|(_, e)| (e.exposure.0, e.variance)).collect();
        let floor = if self.by_network { NETWORK_EXPOSURE_FLOOR } else { REMOVAL_EXPOSURE_FLOOR };
        let (value, interval) = aggregate(&values, floor)?;
        let typical = fits
            .iter()
            .min_by(|a, b| (a.1.exposure.0 - value).abs().total_cmp(&(b.1.exposure.0 - value).abs()))?;
        let model = MotionBlurModel {
            exposure: ExposureFraction(value.min(1.0)),
            interval: interval.map(|v| v.min(1.0)),
            method: Method::Removal,
            samples: fits.iter().map(|(_, e)| e.samples as u64).sum(),
            phase_degrees: None,
        };
        (interval[1] - interval[0] <= agreement::MAX_UNCERTAINTY)
            .then(|| (model, typical.1.curve.clone(), fits.iter().map(|(i, e)| (*i, e.exposure.0)).collect()))
    }

    fn fit_defocus(
        &self,
        model: &mut CameraModel,
        diagnostics: &mut Diagnostics,
        noise: Option<&LumaNoise>,
    ) -> Result<()> {
        let Some(depth_kind) = self.depth_kind else {
            model.defocus = Estimate::Unknown(self.why_no_depth.clone());
            return Ok(());
        };
        let mut deep: Vec<&FrameEvidence> = self.frames.iter().filter(|f| f.has_depth).collect();
        // Relative depth has a unit of its own in each shot, and shots with different shutters may be from different cameras.
        let apart = depth_kind == DepthKind::Relative || contradiction(&diagnostics.shots).is_some();
        let shot = (apart && self.shots.len() > 1).then(|| {
            let frames = |shot: usize| deep.iter().filter(|f| f.shot == shot).count();
            (0..self.shots.len()).rev().max_by_key(|&shot| frames(shot)).unwrap_or(0)
        });
        let mut motion_blur = model.motion_blur.known();
        if let Some(shot) = shot {
            deep.retain(|f| f.shot == shot);
            motion_blur = motion_blur.or_else(|| diagnostics.shots.get(shot)?.motion_blur.known());
        }
        let blind_method = self.blind_method();
        let blind = match blind_method {
            Method::Removal => {
                let exposure = motion_blur.map_or(ExposureFraction(0.0), |m| m.exposure);
                removal::fit_lens(&removal_tiles(&deep), exposure)?
            }
            _ => self.blind_lens(&spectral_tiles(&deep), noise, motion_blur, model.sharpening.known())?,
        };
        let compared = self.aggregate_lens();
        let width = |i: [f32; 2]| i[1] - i[0];
        let (fit, method) = match (blind, compared) {
            (Estimate::Known(b), Some(c))
                if blind_method != Method::Removal && width(b.sigma_px_at_infinity) <= width(c.1) =>
            {
                (b, blind_method)
            }
            (blind, Some((lens, sigma_px_at_infinity, focus_inverse_depth, samples))) => {
                let ranges = self.frames.iter().filter_map(|f| f.lens.as_ref()).map(|l| l.range);
                let compared = agreement::LensFit {
                    lens,
                    sigma_px_at_infinity,
                    focus_inverse_depth,
                    samples,
                    points: self.frames.iter().flat_map(|f| f.search.iter().copied()).collect(),
                    inverse_depth_seen: agreement::seen(ranges.flat_map(|(far, near)| [far, near])),
                    // What looks like Gaussians is only said of the lens whose interval takes that in.
                    bokeh: blind.known().and_then(|b| b.bokeh).filter(|&b| b == Bokeh::Disk),
                };
                (compared, Method::Removal)
            }
            (Estimate::Known(b), None) => (b, blind_method),
            (Estimate::Unknown(why), None) => {
                model.defocus = Estimate::Unknown(why);
                return Ok(());
            }
        };
        let thin = DefocusCurve::ThinLens {
            sigma_px_at_infinity: fit.lens.sigma_px_at_infinity(),
            focus_inverse_depth: fit.lens.focus,
            interval: Some(ThinLensInterval {
                sigma_px_at_infinity: fit.sigma_px_at_infinity,
                focus_inverse_depth: fit.focus_inverse_depth,
            }),
        };
        let curve = match (self.options.curve, defocus::quadratic(&fit.points)) {
            (Curve::ThinLens, _) => thin,
            (Curve::Quadratic, Some(([a, b, c], (lo, hi)))) => {
                DefocusCurve::Quadratic { a, b, c, inverse_depth_range: [lo, hi] }
            }
            (Curve::Quadratic, None) => {
                diagnostics
                    .notes
                    .push("too few points for a quadratic: the thin lens is given instead".into());
                thin
            }
        };
        if let (Some(shot), true) = (shot, method == blind_method) {
            diagnostics.notes.push(format!(
                "the lens is that of shot {} alone, which shows most depth: the others may have another, or depth in another unit",
                shot + 1
            ));
        }
        if fit.bokeh == Some(Bokeh::Gaussian) {
            diagnostics.notes.push(
                "out-of-focus points look like Gaussians, or the textures are soft: the lens's interval holds what both would make of it"
                    .into(),
            );
        }
        diagnostics.blur_points = fit.points;
        model.defocus = Estimate::Known(DefocusModel {
            method,
            samples: fit.samples as u64,
            inverse_depth_seen: Some(fit.inverse_depth_seen),
            bokeh: fit.bokeh.unwrap_or_default().into(),
            ..DefocusModel::given(curve, depth_kind)
        });
        Ok(())
    }

    /// The lens that the spectra agree on, for all exposures that may be. Where nothing is known of the exposure, only what hardly moves
    /// tells the lens: a streak of unknown length looks like a lens's blur.
    fn blind_lens(
        &self,
        frames: &[&[tiles::Tile]],
        noise: Option<&LumaNoise>,
        motion_blur: Option<&MotionBlurModel>,
        sharpening: Option<&SharpeningModel>,
    ) -> Result<Estimate<agreement::LensFit>> {
        let Some(noise) = noise else { return Ok(Estimate::Unknown(noise_unknown())) };
        let Some(motion_blur) = motion_blur else {
            let slow: Vec<Vec<tiles::Tile>> = frames
                .iter()
                .map(|tiles| tiles.iter().filter(|t| t.speed * t.scale < spectral::STILL).cloned().collect())
                .collect();
            let slow: Vec<&[tiles::Tile]> = slow.iter().map(Vec::as_slice).collect();
            let fit = spectral::fit_lens(&slow, noise, ExposureFraction(0.0), sharpening)?;
            let moving =
                frames.iter().any(|tiles| tiles.iter().any(|t| t.speed * t.scale >= spectral::STILL));
            return Ok(match fit {
                Estimate::Known(mut known) => {
                    bokeh::see(&mut known, &slow, noise, ExposureFraction(0.0), sharpening)?;
                    Estimate::Known(known)
                }
                Estimate::Unknown(why) if moving => Estimate::unknown(
                    Reason::Uncertain,
                    format!(
                        "the exposure is unknown, and its streaks may be taken for the lens's blur; of what does not move: {why}"
                    ),
                ),
                fit => fit,
            });
        };
        let fit = spectral::fit_lens(frames, noise, motion_blur.exposure, sharpening)?;
        let Estimate::Known(mut known) = fit else { return Ok(fit) };
        let speeds: Vec<f32> = frames.iter().copied().flatten().map(|t| t.speed * t.scale).collect();
        let typical = median(speeds).unwrap_or(0.0);
        for end in motion_blur.interval {
            if (end - motion_blur.exposure.0).abs() * typical < spectral::SURE_STREAK {
                continue;
            }
            match spectral::fit_lens(frames, noise, ExposureFraction(end), sharpening)? {
                Estimate::Known(other) => known.widen(&other),
                unknown => return Ok(unknown),
            }
        }
        let [low, high] = known.sigma_px_at_infinity;
        if high - low > 2.0 * known.lens.sigma_px_at_infinity().max(0.5) {
            let why = format!(
                "the exposure is known too badly to tell its streaks from the lens's blur: {low:.1} to {high:.1} px all fit"
            );
            return Ok(Estimate::unknown(Reason::Uncertain, why));
        }
        bokeh::see(&mut known, frames, noise, motion_blur.exposure, sharpening)?;
        Ok(Estimate::Known(known))
    }

    /// The lens over the frames that were compared with clean frames, with the 95 % intervals of the std at infinity and of the inverse
    /// depth in focus, and the number of samples; `None` if there is no such frame or the blur is too uncertain.
    fn aggregate_lens(&self) -> Option<(defocus::Lens, [f32; 2], [f32; 2], usize)> {
        let fits: Vec<&defocus::LensFit> = self.frames.iter().filter_map(|f| f.lens.as_ref()).collect();
        let of = |value: &dyn Fn(defocus::Lens) -> f32,
                  variance: &dyn Fn(&defocus::LensFit) -> f64,
                  least: &dyn Fn(&defocus::LensFit) -> f32| {
            let values: Vec<(f32, f64)> = fits.iter().map(|f| (value(f.lens), variance(f))).collect();
            let middle = median(values.iter().map(|v| v.0).collect())?;
            let floor = if self.by_network { NETWORK_LENS_FLOOR } else { REMOVAL_LENS_FLOOR };
            aggregate(&values, (floor * middle).hypot(median(fits.iter().map(|f| least(f)).collect())?))
        };
        let infinity = |f: &defocus::LensFit| {
            let g = [f64::from(f.lens.focus), f64::from(f.lens.slope)];
            (0..2)
                .flat_map(|i| (0..2).map(move |j| (i, j)))
                .map(|(i, j)| g[i] * f.covariance[i][j] * g[j])
                .sum::<f64>()
        };
        let (sigma, sigma_interval) = of(&|l| l.sigma_px_at_infinity(), &infinity, &|_| REMOVAL_UNTOLD_PX)?;
        let unseen = |f: &defocus::LensFit| agreement::unseen_focus(f.lens, REMOVAL_UNTOLD_PX, f.range.1);
        let (focus, focus_interval) = of(&|l| l.focus, &|f| f.covariance[1][1], &unseen)?;
        // The lens is that of one frame, the nearest to both medians: the two medians together may be a lens that no frame has.
        let off = |f: &defocus::LensFit| {
            let share = |v: f32, of: f32| (v - of).abs() / of.max(1e-3);
            share(f.lens.sigma_px_at_infinity(), sigma) + share(f.lens.focus, focus)
        };
        let lens = fits.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?.lens;
        let (s, f) = (lens.sigma_px_at_infinity(), lens.focus);
        let sigma_interval = [sigma_interval[0].min(s), sigma_interval[1].max(s)];
        let focus_interval = [focus_interval[0].min(f), focus_interval[1].max(f)];
        let sure = sigma_interval[1] - sigma_interval[0] <= 2.0 * sigma.max(0.5);
        sure.then(|| (lens, sigma_interval, focus_interval, fits.iter().map(|f| f.samples).sum()))
    }
}

/// Why blur is unknown where noise is: to take noise for detail of the scene would make all blur too small.
fn noise_unknown() -> Unknown {
    Unknown::new(Reason::Flat, "the noise is unknown, and what is sharp could be either noise or detail")
}

fn blind_model(method: Method, fit: &agreement::ExposureFit) -> MotionBlurModel {
    let (interval, samples) = (fit.interval, fit.samples as u64);
    MotionBlurModel { interval, method, samples, ..MotionBlurModel::given(fit.exposure) }
}

/// The reason why no single exposure fits all shots, if two shots are sure that their exposures differ.
fn contradiction(shots: &[Shot]) -> Option<Unknown> {
    let known = || (1..).zip(shots).filter_map(|(n, s)| Some((n, s.motion_blur.known()?)));
    // The largest of n deviations grows as sqrt(2 ln n), so intervals are widened in proportion for more than two shots.
    let spread = |n: usize| 1.0 + (2.0 * (n as f32).ln()).sqrt();
    let wider = (spread(known().count().max(2)) / spread(2)).max(1.0);
    let end = |m: &MotionBlurModel, i: usize| m.exposure.0 + wider * (m.interval[i] - m.exposure.0);
    let (n, longest) = known().max_by(|a, b| end(a.1, 0).total_cmp(&end(b.1, 0)))?;
    let (m, shortest) = known().min_by(|a, b| end(a.1, 1).total_cmp(&end(b.1, 1)))?;
    let told = |n: usize, m: &MotionBlurModel| {
        format!("{:.2} ({:.2} to {:.2}) in shot {n}", m.exposure.0, m.interval[0], m.interval[1])
    };
    (end(shortest, 1) < end(longest, 0)).then(|| {
        let why = format!(
            "the shots were filmed with different shutters, exposures of {} and {}: estimate each alone, or a model for each frame",
            told(m, shortest),
            told(n, longest)
        );
        Unknown::new(Reason::Contradicting, why)
    })
}

fn spectral_tiles<'a>(frames: &[&'a FrameEvidence]) -> Vec<&'a [tiles::Tile]> {
    frames.iter().map(|f| f.tiles.as_slice()).collect()
}

fn removal_tiles<'a>(frames: &[&'a FrameEvidence]) -> Vec<&'a [removal::Tile]> {
    frames.iter().map(|f| f.removal.as_slice()).collect()
}
