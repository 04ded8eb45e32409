//! The estimate of one camera model from the frames of a clip.

mod clean;
mod fit;

use super::defocus::BlurPoint;
use super::distant::DistantPairs;
use super::geometry::{Follower, WantsParallax, check_sizes, no_parallax, parallax_of};
use super::noise::NoiseEvidence;
use super::observation::{EstimatorOptions, Evidence, Family, FrameObservation};
use super::timing::{Copies, Look};
use super::uneven::SpeedBy;
use super::{defocus, motion_blur, removal, spectral, streaks, tiles, uneven};
use crate::analysis::active_area::ActiveArea;
use crate::analysis::cuts::{MIN_CONFIRMED, cut_between};
use crate::analysis::depth::Parallax;
use crate::analysis::flow::motion_at_frame;
use crate::model::{DepthKind, Method, Reason, Unknown};
use crate::strips::largest_strip;
use crate::{Encoded, Flow, Plane, Result, Transfer, analysis};
use std::borrow::Cow;

/// Takes frames one after another and gives one camera model. The memory used does not grow with the length of a clip, since frames
/// are thinned out evenly once there are more than [`Estimator::MAX_FRAMES`].
pub struct Estimator {
    options: EstimatorOptions,
    size: Option<(usize, usize)>,
    /// The number of frames that are expected; 0 if it is unknown.
    expected: usize,
    /// The number of frames given so far.
    given: usize,
    /// The number of frames given so far but of those that the next one repeats.
    pictures: usize,
    copies: Copies,
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
    /// The number of pictures before the frame.
    order: usize,
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

/// The evidence of one frame.
struct FrameEvidence {
    /// The frame's index among the given frames.
    index: usize,
    /// The number of pictures before the frame.
    order: usize,
    shot: usize,
    temporal: NoiseEvidence,
    spatial: NoiseEvidence,
    denoised: NoiseEvidence,
    tiles: Vec<tiles::Tile>,
    /// The pairs of this frame's tiles with those of the frame before; none where motion is uneven.
    pairs: Vec<spectral::Pair>,
    /// Where motion is uneven, this frame and the one before it.
    from_before: Option<streaks::Link>,
    /// Where motion is uneven and frames are left out, this frame and the next one.
    to_next_frame: Option<streaks::Link>,
    removal: Vec<removal::Tile>,
    has_motion: bool,
    /// The change of the frame's motion as a share of its speed ([`uneven::change_of`]); `None` where it is not known.
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
    /// Whether the motion of the frame, as far as it has any, is even.
    fn is_even(&self) -> bool {
        self.tiles.iter().all(|t| t.speed_error == 0.0)
    }

    /// The exposure fraction, the std of the blur at infinity (px) and the inverse depth in focus; 0 in place of each that was not found.
    fn numbers(&self) -> [f32; 3] {
        let lens = self.lens.as_ref().map_or([0.0; 2], |l| [l.lens.sigma_px_at_infinity(), l.lens.focus]);
        [self.exposure.as_ref().map_or(0.0, |e| e.exposure.0), lens[0], lens[1]]
    }

    fn new(
        [index, order]: [usize; 2],
        shot: usize,
        has_motion: bool,
        has_depth: bool,
        transfer: Transfer,
    ) -> Self {
        let noise = |method| NoiseEvidence::new(method).encoded_by(transfer);
        Self {
            index,
            order,
            shot,
            temporal: noise(Method::Temporal),
            spatial: noise(Method::Spatial),
            denoised: noise(Method::Removal),
            tiles: vec![],
            pairs: vec![],
            from_before: None,
            to_next_frame: None,
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

/// Noise of frames of more px than this is measured in a part of each frame.
const NOISE_WHOLE: usize = 1 << 20;
/// The fewest rows of such a part: as many again around it are computed with it.
const NOISE_ROWS: usize = 256;
/// The most pairs of distant frames in which the noise is measured.
const DISTANT_PAIRS: usize = 10;
/// The most frames that are used of a clip that is longer than [`Estimator::MAX_FRAMES`]: the flow from the frame before each of them takes
/// about the time of the frames that are left out.
const THINNED_FRAMES: usize = 40;
/// The number of last frames of which most must move evenly for a sudden speed to be that over missing frames.
const RECENT: usize = 8;
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
        /// The measured bytes for each pixel: of a strip, of the motion of a frame with the frame before one that is repeated, of removal, and of
        /// the evidence kept of each frame.
        const OF_STRIP: u64 = 80;
        const MOTION: u64 = 72 + 12;
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
            pictures: 0,
            copies: Copies::default(),
            stride: 1,
            frames: vec![],
            follower: Follower::new(Self::FLOW_WIDTH, false),
            backward: Follower::new(Self::FLOW_WIDTH / 2, false),
            distant: DistantPairs::new(DISTANT_PAIRS, 0, options.space.transfer),
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
        self.distant = DistantPairs::new(DISTANT_PAIRS, frames, self.options.space.transfer);
        self
    }

    /// Whether the next frame given to [`Estimator::add`] will be used rather than thinned out. If not, the caller need not read the
    /// frame's evidence.
    pub fn wants_next(&self) -> bool {
        self.pictures.is_multiple_of(self.stride)
    }

    /// Adds the next frame in the order of time, and says whether the frame was used: frames are thinned out, and of a picture that is repeated
    /// only the last frame is used.
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
        let active = ActiveArea::of(frame);
        let within_bars = active.flow_within(evidence.flow);
        evidence.flow = within_bars.as_ref().or(evidence.flow);
        let index = self.given;
        self.given += 1;
        self.by_network |= evidence.by_network;
        let opens = std::mem::take(&mut self.cut_ahead);
        if opens {
            self.shots.push(index);
            self.follower.forget_scale();
            self.distant.begin_shot();
            self.last_motion = None;
            self.copies.begin_shot();
        }
        let Look::At { repeated, repeated_before, before } = self.copies.look(frame, next, previous) else {
            return Ok(false);
        };
        // What a frame repeats is no neighbour.
        let previous = if repeated > 0 { before.as_ref() } else { previous };
        let order = self.pictures;
        self.pictures += 1;
        self.cut_ahead = next.map_or(Ok(false), |next| cut_between(frame, next))?;
        if !order.is_multiple_of(self.stride) {
            return Ok(false);
        }
        if self.cut_ahead {
            // A flow that was given leads to another shot.
            evidence.flow = None;
        }
        // A frame beyond a cut is no neighbour.
        let (mut next, previous) = (next.filter(|_| !self.cut_ahead), previous.filter(|_| !opens));
        let mut neighbour = next.map(|n| (n, 1.0)).or(previous.map(|p| (p, -1.0)));
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
        let flow_given = evidence.flow.is_some() && !evidence.found_before;
        let last = self.last_motion.take().filter(|l| l.order + 1 == order);
        let mut left_out = match (previous, next) {
            // Frames were left out, so that this flow was not needed before.
            (Some(previous), Some(_))
                if last.is_none() && flow.is_some() && !flow_given && (self.stride > 1 || repeated > 0) =>
            {
                self.backward.follow(previous, frame, None, Flow::filled(0, 0, [0.0; 2]))?.flow
            }
            _ => None,
        };
        let from_before = last.as_ref().map(|l| &l.flow).or(left_out.as_ref());
        let ratio = flow.as_deref().filter(|_| next.is_some()).zip(from_before);
        let ratio = ratio.and_then(|(to_next, from_before)| uneven::speed_ratio(to_next, from_before));
        if let (Some(ratio), Some(before)) = (ratio, previous) {
            let is_even = self.moves_evenly();
            if self.copies.gap_beside(repeated, ratio, is_even) {
                (next, neighbour, evidence.flow) = (None, Some((before, -1.0)), None);
                let followed = self.follower.follow(frame, before, None, Flow::filled(0, 0, [0.0; 2]))?;
                (flow, left_out) = (followed.flow.map(Cow::Owned), None);
            } else if left_out.is_some() && self.copies.gap_beside(repeated_before, 1.0 / ratio, is_even) {
                left_out = None;
            }
        }
        let depth = self.depth_of(&evidence, parallax)?;
        let mut kept = FrameEvidence::new(
            [index, order],
            self.shots.len() - 1,
            flow.is_some(),
            depth.is_some(),
            self.options.space.transfer,
        );
        // Given flow leads to the next frame.
        let mut still = false;
        let to_neighbour = flow.as_deref().filter(|_| evidence.flow.is_none() || next.is_some());
        if let (Some(flow), Some((other, _))) = (to_neighbour, neighbour) {
            let turns = self.noise_turns();
            let turn = (order / self.stride % turns, turns);
            still = kept.temporal.add_pair_in_turn(frame, other, flow, turn)?;
            let was_still = last.as_ref().is_some_and(|l| l.still);
            if let (true, Some(before), Some(next)) = (still && was_still, previous, next) {
                kept.temporal.add_successive([before, frame, next]);
            }
        }
        // A single image has no pair, so it need not be held.
        if neighbour.is_some() {
            // A single frame may be one with which a coder begins a group, or be copied for the most part.
            let hides_noise = |since: usize| {
                let mut all = kept.temporal.clone();
                let recent = self.frames.iter().rev().take_while(|f| f.order >= since);
                recent.for_each(|f| all.merge(&f.temporal));
                all.may_hide_noise()
            };
            let turns = self.noise_turns();
            self.distant.push((order, frame), hides_noise, &mut self.follower, turns)?;
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
        let from_previous = last.as_ref().map(|l| &l.flow).or(left_out.as_ref());
        let at_frame = to_next.as_ref().zip(from_previous).map(|(flow, last)| motion_at_frame(flow, last));
        // A motion that is only taken to continue says nothing of a difference between the motions of two frames.
        let measured = next.is_some() || (flow_given && evidence.flow.is_some());
        let (mut speed_error, mut turned) = (0.0, None);
        if let (Some(to_next), true) = (&to_next, self.options.family != Family::Removal && !flow_given) {
            kept.to_next = measured.then(|| uneven::SampledFlow::new(to_next));
            let mean = at_frame.as_ref().unwrap_or(to_next);
            (speed_error, turned) = self.uneven(&mut kept, frame, measured.then_some(&**to_next), mean);
            if speed_error > 0.0 {
                let space = self.options.space;
                let link = |frames, flow: &Flow, [first, second]: [&Flow; 2]| {
                    let motions: [&tiles::MotionOf; 2] = [&|x, y| first.at(x, y), &|x, y| second.at(x, y)];
                    streaks::Link::new(frames, flow, motions, space)
                };
                let before = previous.zip(from_previous);
                let motion_before = last.as_ref().map(LastMotion::motion);
                kept.from_before = before.and_then(|(other, flow)| {
                    link([other, frame], flow, [motion_before.unwrap_or(flow), mean])
                });
                if let (Some(next), true) = (next, self.stride > 1) {
                    kept.to_next_frame = link([frame, next], to_next, [mean, to_next]);
                }
            }
        }
        let mean = at_frame.as_ref().or(to_next.as_deref());
        let motion = turned.as_ref().or(mean);
        if self.options.family != Family::Removal {
            // The edge of a bar is as sharp without a lens.
            let still = motion.is_none().then(|| active.motion(frame.0.size(), |_, _| [0.0; 2])).flatten();
            kept.tiles = tiles::tiles(frame, motion.or(still.as_ref()), depth.as_ref(), self.options.space)?;
            kept.tiles.iter_mut().for_each(|t| t.speed_error = speed_error);
            if let (true, Some(before), Some(last), Some(own)) =
                (measured && speed_error == 0.0, previous, &last, mean)
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
            order,
            flow: flow.into_owned(),
            at_frame,
            still,
        });
        self.keep(kept);
        self.correct_speeds();
        Ok(true)
    }

    /// Whether the motion of most of the shot's last frames is even.
    fn moves_evenly(&self) -> bool {
        let shot = self.shots.len() - 1;
        let recent = self.frames.iter().rev().take(RECENT).filter(|f| f.shot == shot);
        let changes: Vec<f32> = recent.filter_map(|f| f.change).collect();
        2 * changes.iter().filter(|&&change| uneven::is_even(change)).count() > changes.len()
    }

    /// Corrects the speeds of the last frames' tiles, where motion is uneven, by the frames around them that are known by now.
    fn correct_speeds(&mut self) {
        let follows = |w: &&[FrameEvidence]| w[0].shot == w[1].shot && w[0].order + 1 == w[1].order;
        let pairs = self.frames.windows(2).rev().take(2 * uneven::SPLINE_REACH);
        let first = self.frames.len() - 1 - pairs.take_while(follows).count();
        let frames = &self.frames[first..];
        let flows: Vec<Option<&uneven::SampledFlow>> = frames.iter().map(|f| f.to_next.as_ref()).collect();
        let corrected = frames.len().saturating_sub(uneven::SPLINE_REACH + 1)..frames.len();
        let uneven = |i: &usize| !frames[*i].is_even();
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
            f.shot == kept.shot && f.order + uneven::NEAR * self.stride >= kept.order
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

    /// The number of parts of a frame's rows, in one of which its noise is measured: 1 for a frame of at most [`NOISE_WHOLE`] px, more for a
    /// larger one, if so many frames are looked at that each part is seen [`NOISE_SEEN`] times.
    fn noise_turns(&self) -> usize {
        let (width, height) = self.size.unwrap_or_default();
        let turns = (height / NOISE_ROWS).min(self.expected / self.stride / NOISE_SEEN);
        if width * height > NOISE_WHOLE { turns.max(1) } else { 1 }
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

    /// The flow to the next frame that was used for the frame added last, px; `None` if the frame was not used or its flow is unknown.
    pub fn flow(&self) -> Option<&Flow> {
        self.last_motion.as_ref().filter(|l| l.order + 1 == self.pictures).map(|l| &l.flow)
    }

    /// The inverse depth that was used for the frame added last, and its unit; `None` if the frame was not used or its depth is unknown.
    pub fn inverse_depth(&self) -> Option<(&Plane, DepthKind)> {
        let depth = self.last_depth.as_ref().filter(|d| d.0 + 1 == self.given);
        depth.map(|d| &d.1).zip(self.depth_kind)
    }
}
