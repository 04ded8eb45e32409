//! The values that the observations of many tiles and frames agree on: the clipped log-likelihoods of the observations are summed, the
//! most likely value is taken, and a bootstrap over blocks of the image and parts of the clip gives its interval.

use super::defocus::{self, BlurPoint, Lens};
use super::likelihood::{
    CLIP, EXPOSURE_STEP, EXPOSURES, PARTS, SIGMAS, index_of_exposure, index_of_sigma, interpolate, part_of,
    sigma_of,
};
use super::noise::{MAX_CODING_ERROR, NOTABLE_CODING_ERROR};
use super::tiles::BLOCKS;
use super::uneven::over_speeds;
use crate::model::{
    Bokeh, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction, Method, Reason,
    ThinLensInterval, Unknown,
};
use crate::portable::Portable;
use crate::{Error, Result, par};
use std::collections::BTreeMap;

/// The exposure fraction above which an exposure is unknown: no shutter is open for so long, so something else looks like streaks. The
/// estimate for a shutter that is open all the time may be 1.05.
pub(super) const LONGEST: f32 = 1.15;

/// The width of the interval, as an exposure fraction, above which an exposure is unknown.
pub(super) const MAX_UNCERTAINTY: f32 = 0.7;

/// The lengths of a streak, px, that the picture's own softness can hide or imitate: where the zeros of the streak's spectrum are out of sight,
/// and where they are seen. Little else has such zeros. Without them a streak is less power along the motion than across it, and the
/// filters of cameras and scalers leave that, too, by up to the first of these lengths (docs/lab-log.md, "Short streaks").
const HIDDEN_STREAK: (f32, f32) = (2.1, 1.2);

/// The lengths of streaks, px, between which the first zero of their spectrum comes into sight.
const ZERO_IN_SIGHT: (f32, f32) = (3.0, 4.5);

/// The std of the exposure fraction that stands for errors of the models.
pub(super) const EXPOSURE_FLOOR: f32 = 0.025;

/// The relative stds that stand for errors of the models: of the blur at infinity, and of the inverse depth in focus.
const LENS_FLOORS: (f32, f32) = (0.08, 0.06);

/// The std of the exposure fraction that stands for a coder's errors of the largest size, [`MAX_CODING_ERROR`].
const CODING_FLOOR: f32 = 0.05;

/// The std, in px, of the blur that soft textures add or sharp textures hide. It matters where blur is small.
const TEXTURE_BLUR: f32 = 0.2;

/// A lens is a candidate if its loss in nats exceeds that of the likeliest lens by at most this share. The limit saves time: a worse
/// lens is the best one in hardly any replica of the bootstrap.
const CANDIDATE: f32 = 0.5;

/// The share of the largest inverse depth that the inverse depths of the places must span to tell a lens.
const MIN_DEPTH_SPAN: f32 = 0.2;

/// The share of the largest inverse depth by which the inverse depths of tiles may differ to count as one surface.
const SAME_DEPTH: f32 = 0.03;

/// The factor of the share of all tiles at a tile's depth in the divisor of the tile's weight. So the weight of a surface grows in
/// proportion to its share of all tiles only up to about 1 / `SURFACES`.
const SURFACES: f32 = 25.0;

/// The number of replicas of the bootstrap for a whole clip.
pub const BOOTSTRAPS: usize = 120;

/// The exposure that maximises the likelihood.
#[derive(Clone, Debug)]
pub struct ExposureFit {
    /// The estimate.
    pub exposure: ExposureFraction,
    /// The 95 % interval of the exposure fraction.
    pub interval: [f32; 2],
    /// The number of tiles and pairs of tiles that the estimate rests on.
    pub samples: usize,
    /// The points (exposure fraction, log-likelihood), 0 at the maximum.
    pub curve: Vec<[f32; 2]>,
    /// The number of each frame that tells an exposure by itself, with that exposure fraction.
    pub per_frame: Vec<(usize, f32)>,
}

/// The thin lens that maximises the likelihood.
#[derive(Clone, Debug)]
pub struct LensFit {
    /// The estimate.
    pub lens: Lens,
    /// The 95 % interval of the std of the blur at infinity, px.
    pub sigma_px_at_infinity: [f32; 2],
    /// The 95 % interval of the inverse depth in focus.
    pub focus_inverse_depth: [f32; 2],
    /// The number of tiles that the estimate rests on.
    pub samples: usize,
    /// The blur of each tile by itself, at its inverse depth.
    pub points: Vec<BlurPoint>,
    /// The inverse depths of the farthest and of the nearest tile.
    pub inverse_depth_seen: [f32; 2],
    /// The shape of out-of-focus points: a disk, as of a round aperture or of one with blades, or what looks like a Gaussian, as disks do before
    /// soft textures, too, so that the interval holds both; `None` if too little is blurred or the tiles disagree.
    pub bokeh: Option<Bokeh>,
}

impl LensFit {
    /// The lens with its intervals, as a model has it.
    pub(super) fn thin_lens(&self) -> DefocusCurve {
        DefocusCurve::ThinLens {
            sigma_px_at_infinity: self.lens.sigma_px_at_infinity(),
            focus_inverse_depth: self.lens.focus,
            interval: Some(ThinLensInterval {
                sigma_px_at_infinity: self.sigma_px_at_infinity,
                focus_inverse_depth: self.focus_inverse_depth,
            }),
        }
    }

    /// The model with this curve, which comes from this fit.
    pub(super) fn model(&self, curve: DefocusCurve, method: Method, depth_kind: DepthKind) -> DefocusModel {
        DefocusModel {
            method,
            samples: self.samples as u64,
            inverse_depth_seen: Some(self.inverse_depth_seen),
            bokeh: self.bokeh.unwrap_or_default().into(),
            ..DefocusModel::given(curve, depth_kind)
        }
    }

    /// Takes the intervals of a fit that may be as right into its own.
    pub(super) fn widen(&mut self, other: &Self) {
        self.sigma_px_at_infinity = hull(self.sigma_px_at_infinity, other.sigma_px_at_infinity);
        self.focus_inverse_depth = hull(self.focus_inverse_depth, other.focus_inverse_depth);
    }
}

/// The exposure fraction at the maximum of a curve.
pub(super) fn most_likely_exposure(curve: &[f32]) -> f32 {
    (0..curve.len()).max_by(|&a, &b| curve[a].total_cmp(&curve[b])).unwrap_or(0) as f32 * EXPOSURE_STEP
}

/// The 95 % interval of an exposure by the bootstrap alone, from (block of the image, part of the clip, curve) and a floor (std).
pub(super) fn bootstrapped_exposure(
    estimate: f32,
    parts: &[(u32, usize, Vec<f32>)],
    bootstraps: usize,
    floor: f32,
) -> [f32; 2] {
    let replica = |r: usize| {
        let mut sum = vec![0.0f32; EXPOSURES];
        for (block, part, curve) in parts {
            let w = resampled(r, *block, *part);
            sum.iter_mut().zip(curve).for_each(|(s, v)| *s += w * v);
        }
        most_likely_exposure(&sum)
    };
    let replicas: Vec<f32> = (0..bootstraps).map(replica).collect();
    within_a_frame(estimate, interval(estimate, &replicas, floor))
}

/// An interval within [0, 1], since no shutter is open for longer than a frame interval: if the estimate exceeds 1, the interval is
/// moved down by the excess.
fn within_a_frame(estimate: f32, interval: [f32; 2]) -> [f32; 2] {
    let beyond = (estimate - 1.0).max(0.0);
    interval.map(|v| (v - beyond).clamp(0.0, 1.0))
}

/// The 95 % interval of an exposure from the curves of [`bootstrapped_exposure`], their sum, [`LumaNoise::coding_error`], the
/// [`typical_speed`] of the observations, and whether their motion is even. The interval also holds the exposures whose summed
/// log-likelihood is less than [`CLIP`] below the maximum, which a single tile could explain, and the exposures of streaks that texture or a
/// coder hides.
pub(super) fn exposure_interval(
    estimate: f32,
    sum: &[f32],
    parts: &[(u32, usize, Vec<f32>)],
    bootstraps: usize,
    coding_error: f32,
    speed: f32,
    even: bool,
) -> [f32; 2] {
    let bootstrapped = bootstrapped_exposure(estimate, parts, bootstraps, exposure_floor(coding_error));
    let likely = likely(estimate, sum, CLIP);
    let interval = with_hidden_streak(hull(bootstrapped, likely), speed, even);
    with_coded_streak(interval, coding_error, speed, even)
}

/// The std of the exposure fraction that stands for errors of the models and for those of a coder of this [`LumaNoise::coding_error`].
fn exposure_floor(coding_error: f32) -> f32 {
    EXPOSURE_FLOOR.portable_hypot(CODING_FLOOR * coding_error / MAX_CODING_ERROR)
}

/// The least interval that holds both.
fn hull(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// The 95 % interval of an exposure where motion is uneven, from the summed curve and the exposures of a bootstrap's replicas, by
/// [`LumaNoise::coding_error`], the [`typical_speed`], and whether the flow shows that motion is uneven.
pub(super) fn uneven_interval(
    estimate: f32,
    sum: &[f32],
    replicas: &[f32],
    coding_error: f32,
    speed: f32,
    seen: bool,
) -> [f32; 2] {
    let bootstrapped = within_a_frame(estimate, interval(estimate, replicas, exposure_floor(coding_error)));
    let likely = likely(estimate, sum, UNEVEN_CLIP);
    let interval = with_hidden_streak(hull(bootstrapped, likely), speed, !seen);
    with_coded_streak(interval, coding_error, speed, false)
}

/// The least and the largest exposure that a curve finds less likely than the likeliest one by at most so many nats.
fn likely(estimate: f32, sum: &[f32], nats: f32) -> [f32; 2] {
    let least = sum.iter().copied().fold(f32::MIN, f32::max) - nats;
    let likely = || (0..EXPOSURES).filter(|&i| sum[i] >= least).map(|i| i as f32 * EXPOSURE_STEP);
    within_a_frame(estimate, [likely().fold(f32::MAX, f32::min), likely().fold(0.0, f32::max)])
}

/// Widens an interval for streaks that the picture's own softness hides or imitates: both blur along the motion, and their variances add, so
/// the squares of the lengths differ by the square of a [`hidden_streak`].
fn with_hidden_streak([low, high]: [f32; 2], speed: f32, even: bool) -> [f32; 2] {
    let squared_error = |exposure: f32| (hidden_streak(exposure * speed, even) / speed).powi(2);
    [(low * low - squared_error(low)).max(0.0).sqrt(), (high * high + squared_error(high)).sqrt().min(1.0)]
}

/// The length, px, of a streak that may be hidden in one of this length, px, or imitated by it ([`HIDDEN_STREAK`]). Where motion is uneven,
/// streaks differ from frame to frame, which the picture's own softness does not.
fn hidden_streak(length: f32, even: bool) -> f32 {
    let (begin, end) = ZERO_IN_SIGHT;
    let in_sight = if even { ((length - begin) / (end - begin)).clamp(0.0, 1.0) } else { 1.0 };
    HIDDEN_STREAK.0 + in_sight * (HIDDEN_STREAK.1 - HIDDEN_STREAK.0)
}

/// Says how slow the motion is, if that alone makes an exposure uncertain by half of [`MAX_UNCERTAINTY`] or more; `None` if it does not.
pub(super) fn slow_motion(estimate: f32, speed: f32, even: bool) -> Option<String> {
    let [low, high] = with_hidden_streak([estimate; 2], speed, even);
    (high - low >= 0.5 * MAX_UNCERTAINTY).then(|| {
        format!(
            "what moves does so by about {speed:.1} px a frame, too slowly to tell short streaks from the picture's own softness"
        )
    })
}

/// Raises the upper end of an interval for what a coder of this [`LumaNoise::coding_error`] does to streaks. It takes away fine detail, so that
/// the picture looks as blurred across the motion as along it; and it predicts each frame from others, so that where motion is uneven
/// frames with long streaks look like those with short ones. Both make exposures seem short.
fn with_coded_streak([low, high]: [f32; 2], coding_error: f32, speed: f32, even: bool) -> [f32; 2] {
    /// The lengths of streaks, px, that a coder hides that leaves the largest errors, where motion is even and where it is not: nine of ten
    /// as measured of H.264 at crf 27 (docs/lab-log.md).
    const CODED_STREAK: (f32, f32) = (3.0, 5.0);
    let length = if even { CODED_STREAK.0 } else { CODED_STREAK.1 };
    let squared_error = (length * coding_error / MAX_CODING_ERROR / speed).powi(2);
    [low, (high * high + squared_error).sqrt().min(1.0)]
}

/// Widens an interval to hold the typical frame's exposure, too, given those that frames tell by themselves (NaN: nothing): frames that
/// contradict each other are less sure than their sum. A few frames show it only if motion is even; where it is not, they differ anyway, and
/// the interval has room for that.
pub(super) fn with_typical_frame(
    interval: [f32; 2],
    of_frames: impl Iterator<Item = f32>,
    even: bool,
    speed: f32,
) -> [f32; 2] {
    let of_frames: Vec<f32> = of_frames.filter(|v| v.is_finite()).collect();
    let fewest = if even { 3 } else { 8 };
    if of_frames.len() < fewest {
        return interval;
    }
    hull(interval, with_hidden_streak(interval_of_median(of_frames), speed, even))
}

/// The typical speed of the observations, px per frame interval, from the sum of their [`ExposureObservation::speed`] and the sum of its
/// squares. Fast observations count more, since they tell more.
pub(super) fn typical_speed(sum: f32, squares: f32) -> f32 {
    squares / sum
}

/// The fewest tiles, or pairs of tiles, that tell an exposure.
pub(super) const FEWEST: usize = 6;

/// The observation of the exposure by a tile, or by a pair of tiles.
#[derive(Clone, Debug)]
pub struct ExposureObservation {
    /// The block of the image, < 25; observations of one block err alike.
    pub block: u32,
    /// The number of the frame, from 0.
    pub frame: usize,
    /// The speed, px of the frame per frame interval.
    pub speed: f32,
    /// The relative std of what the speed while the shutter was open may differ from that, in common with all observations of the frame;
    /// 0 where motion is even.
    pub speed_error: f32,
    /// The clipped log-likelihood of each of the [`EXPOSURES`], in nats, <= 0.
    pub log_likelihood: Vec<f32>,
}

/// The exposure that the observations of `frames` frames agree on, found with noise of this
/// [`coding_error`](super::noise::LumaNoise::coding_error).
///
/// # Errors
/// If an observation has another number of log-likelihoods than [`EXPOSURES`], or is of a frame beyond `frames`.
// Long, since each reason for which the exposure is unknown is checked in turn.
pub fn exposure_of(
    observations: &[ExposureObservation],
    frames: usize,
    coding_error: f32,
) -> Result<Estimate<ExposureFit>> {
    if observations.iter().any(|w| w.log_likelihood.len() != EXPOSURES) {
        return Err(Error::new(format!(
            "an observation of the exposure must hold {EXPOSURES} log-likelihoods"
        )));
    }
    if observations.iter().any(|w| w.frame >= frames) {
        return Err(Error::new(format!("an observation is of a frame beyond the {frames} that are given")));
    }
    if observations.len() < FEWEST {
        let why = "too little in the frames moves, or what moves has no texture";
        return Ok(Estimate::unknown(Reason::NoMotion, why));
    }
    let summed = |which: &dyn Fn(&ExposureObservation) -> bool| {
        let mut sum = vec![0.0f32; EXPOSURES];
        for w in observations.iter().filter(|w| which(w)) {
            sum.iter_mut().zip(&w.log_likelihood).for_each(|(s, v)| *s += v);
        }
        sum
    };
    let best = most_likely_exposure;
    let uneven = Uneven::of(observations, frames);
    let sum = uneven.as_ref().map_or_else(|| summed(&|_| true), |u| u.sum(None));
    let estimate = match &uneven {
        None => best(&sum),
        // What seems longer than a frame was faster than its flow says.
        Some(_) => best(&sum[..=index_of_exposure(1.0)]),
    };
    if estimate > LONGEST {
        let why = format!(
            "what moves looks as if the shutter were open for longer than a frame interval ({estimate:.2}), which none is: its texture may run along its motion, or compression has smoothed it"
        );
        return Ok(Estimate::unknown(Reason::Contradicting, why));
    }
    let parts: Vec<(u32, usize, Vec<f32>)> = (0..BLOCKS * BLOCKS * PARTS)
        .map(|i| ((i / PARTS) as u32, i % PARTS))
        .map(|(b, s)| (b, s, summed(&|w| w.block == b && part_of(w.frame, frames) == s)))
        .filter(|(.., curve)| curve.iter().any(|&v| v < 0.0))
        .collect();
    let per_frame: Vec<(usize, f32)> = (0..frames)
        .filter(|&f| observations.iter().filter(|w| w.frame == f).count() >= FEWEST)
        .map(|f| (f, best(&summed(&|w| w.frame == f)).min(1.0)))
        .collect();
    let of_speeds = |f: &dyn Fn(f32) -> f32| observations.iter().map(|w| f(w.speed)).sum::<f32>();
    let speed = typical_speed(of_speeds(&|v| v), of_speeds(&|v| v * v));
    let [low, high] = match &uneven {
        None => exposure_interval(estimate, &sum, &parts, BOOTSTRAPS, coding_error, speed, true),
        Some(uneven) => uneven.interval(estimate, &sum, coding_error, speed),
    };
    let interval = with_typical_frame([low, high], per_frame.iter().map(|f| f.1), uneven.is_none(), speed);
    if interval[1] - interval[0] > MAX_UNCERTAINTY {
        let contradicting = high - low <= MAX_UNCERTAINTY;
        let slow = slow_motion(estimate, speed, uneven.is_none());
        let uneven = uneven.is_some_and(|u| u.seen);
        let coded = coding_error >= NOTABLE_CODING_ERROR;
        let why = if uneven && coded {
            "the motion is uneven, as under a shaking hand, and compression made frames with long and with short streaks alike"
        } else if uneven {
            "the motion is uneven, as under a shaking hand, so its speed while the shutter was open is known too badly to tell"
        } else if contradicting {
            "the frames contradict each other, as those of different shots or of strongly compressed video may"
        } else if let Some(slow) = &slow {
            slow
        } else if coded {
            "too little in the frames moves, or too little of it stands out of what compression has taken, to tell"
        } else {
            "too little in the frames moves, or what moves has too little texture, to tell"
        };
        let reason = match (uneven, contradicting) {
            (true, _) => Reason::UnevenMotion,
            (false, true) => Reason::Contradicting,
            (false, false) => Reason::Uncertain,
        };
        let why = format!("{why}: exposures from {:.2} to {:.2} all fit", interval[0], interval[1]);
        let fits = interval.map(|v| v.clamp(0.0, 1.0));
        return Ok(Estimate::Unknown(Unknown::new(reason, why).with_fits(fits)));
    }
    let max = sum.iter().copied().fold(f32::MIN, f32::max);
    Ok(Estimate::Known(ExposureFit {
        exposure: ExposureFraction(estimate.min(1.0)),
        interval,
        samples: observations.len(),
        curve: sum.iter().enumerate().map(|(i, v)| [i as f32 * EXPOSURE_STEP, v - max]).collect(),
        per_frame,
    }))
}

/// The most nats by which frames of even motion, on average, find the exposure that they agree on less likely than their own.
const EVEN_FRAMES: f32 = 24.0;

/// The fewest frames whose contradiction shows that motion swings.
const SWING: usize = 3;

/// The stds of the speed, relative, that frames may have beyond what their flow shows.
const UNSEEN_SPEED_ERRORS: [f32; 9] = [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5];

/// The nats by which the frames of uneven motion together may find an exposure of the interval less likely than the likeliest one.
const UNEVEN_CLIP: f32 = 4.0;

/// Replicas of the bootstrap where motion is uneven.
const UNEVEN_BOOTSTRAPS: usize = 40;

/// The log-likelihoods of frames whose motion is uneven: the speeds of all tiles of a frame are off by the same factor.
struct Uneven {
    /// The log-likelihood over the exposure of each block of each frame: (frame, part of the clip, block of the image, curve).
    curves: Vec<(usize, usize, u32, Vec<f32>)>,
    /// The relative std of each frame's speed.
    errors: Vec<f32>,
    /// Whether the flow shows the uneven motion; if not, only the contradiction of the frames does.
    seen: bool,
}

impl Uneven {
    /// `None` if motion is even: flow shows no swings, and the frames agree.
    fn of(observations: &[ExposureObservation], frames: usize) -> Option<Self> {
        let mut curves: BTreeMap<(usize, u32), Vec<f32>> = BTreeMap::new();
        let mut errors = vec![(0.0, 0.0f32); frames];
        for w in observations {
            let curve = curves.entry((w.frame, w.block)).or_insert_with(|| vec![0.0; EXPOSURES]);
            curve.iter_mut().zip(&w.log_likelihood).for_each(|(s, v)| *s += v);
            let (sum, count) = &mut errors[w.frame];
            (*sum, *count) = (*sum + w.speed_error, *count + 1.0);
        }
        let curves = curves.into_iter().map(|((f, b), curve)| (f, part_of(f, frames), b, curve)).collect();
        let seen: Vec<f32> = errors.into_iter().map(|(sum, count)| sum / count.max(1.0)).collect();
        let mut observed: Vec<usize> = observations.iter().map(|w| w.frame).collect();
        observed.sort_unstable();
        observed.dedup();
        // Two frames that contradict each other are no swing: a texture that looks like a streak does so in one of them.
        let unseen_errors =
            if observed.len() < SWING { &UNSEEN_SPEED_ERRORS[..1] } else { &UNSEEN_SPEED_ERRORS };
        let mut uneven = Self { curves, errors: vec![], seen: seen.iter().any(|&e| e > 0.0) };
        for &unseen in unseen_errors {
            uneven.errors = seen.iter().map(|e| e.portable_hypot(unseen)).collect();
            if uneven.contradiction() <= EVEN_FRAMES {
                break;
            }
        }
        uneven.errors.iter().any(|&e| e > 0.0).then_some(uneven)
    }

    /// The part of the clip and the curve of each frame, with the blocks weighted as in this replica of the bootstrap; `None`: all alike.
    fn of_frames(&self, replica: Option<usize>) -> Vec<(usize, Vec<f32>)> {
        let mut frames: Vec<(usize, usize, Vec<f32>)> = vec![];
        for (frame, part, block, curve) in &self.curves {
            let weight = replica.map_or(1.0, |r| block_weight(r, *block));
            if frames.last().is_none_or(|f| f.0 != *frame) {
                frames.push((*frame, *part, vec![0.0; EXPOSURES]));
            }
            if let Some((.., sum)) = frames.last_mut() {
                sum.iter_mut().zip(curve).for_each(|(s, v)| *s += weight * v);
            }
        }
        frames.into_iter().map(|(f, part, curve)| (part, over_speeds(&curve, self.errors[f]))).collect()
    }

    fn sum(&self, replica: Option<usize>) -> Vec<f32> {
        let mut sum = vec![0.0f32; EXPOSURES];
        for (part, curve) in self.of_frames(replica) {
            let weight = replica.map_or(1.0, |r| part_weight(r, part));
            sum.iter_mut().zip(&curve).for_each(|(s, v)| *s += weight * v);
        }
        sum
    }

    /// By how many nats the frames, on average, find the exposure that they agree on less likely than their own.
    fn contradiction(&self) -> f32 {
        let frames = self.of_frames(None);
        let agreed = index_of_exposure(most_likely_exposure(&self.sum(None)));
        let loss = |curve: &[f32]| curve.iter().copied().fold(f32::MIN, f32::max) - curve[agreed];
        frames.iter().map(|(_, curve)| loss(curve)).sum::<f32>() / frames.len().max(1) as f32
    }

    fn interval(&self, estimate: f32, sum: &[f32], coding_error: f32, speed: f32) -> [f32; 2] {
        let replicas = par::map(UNEVEN_BOOTSTRAPS, |r| most_likely_exposure(&self.sum(Some(r))));
        uneven_interval(estimate, sum, &replicas, coding_error, speed, self.seen)
    }
}

/// The observation of the lens by a tile, or by several tiles of one block and depth.
#[derive(Clone, Debug)]
pub struct LensObservation {
    /// The inverse depth of the tiles.
    pub inverse_depth: f32,
    /// The log-likelihood over the [`SIGMAS`] stds of the tables, in nats, relative to its maximum.
    pub table: Vec<f32>,
    /// The number of tiles whose log-likelihoods are summed; not whole if older tiles count less.
    pub tiles: f32,
    /// The block of the image, < 25; observations of one block err alike.
    pub block: u32,
    /// The part of the clip, < 8; observations of one part err alike.
    pub part: usize,
}

/// The thin lens that the observations agree on, with intervals from `bootstraps` replicas of the bootstrap.
///
/// # Errors
/// If an observation has a table of another length than [`SIGMAS`].
pub fn lens_of(observations: &[LensObservation], bootstraps: usize) -> Result<Estimate<LensFit>> {
    if observations.iter().any(|w| w.table.len() != SIGMAS) {
        return Err(Error::new(format!("an observation of the lens must have a table of {SIGMAS} stds")));
    }
    let tiles: f32 = observations.iter().map(|w| w.tiles).sum();
    if tiles < 8.0 {
        return Ok(Estimate::unknown(Reason::Flat, "too few textured places whose depth is known"));
    }
    let range = lens_range(observations);
    if range.1 - range.0 <= MIN_DEPTH_SPAN * range.1.abs() {
        let why = "the textured places all lie at about one depth, through which many lenses fit";
        return Ok(Estimate::unknown(Reason::OneDepth, why));
    }
    let fine = FineTables::new(observations);
    // A lens that fits nearly as well as the likeliest one may fit best if other surfaces count more, as in a replica.
    let mut candidates = defocus::best_lenses(range, |lens| fine.log_likelihood(lens, None));
    let (most, lens) = candidates[0];
    candidates.retain(|c| c.0 >= most - (CANDIDATE * most.abs()).max(CLIP));
    let replicas: Vec<Lens> = par::map(bootstraps.max(1), |r| {
        let weights: Vec<f32> = observations.iter().map(|w| resampled(r, w.block, w.part)).collect();
        let of = |l: Lens| fine.log_likelihood(l, Some(&weights));
        let best = candidates.iter().map(|c| defocus::refined_lens(c.1, 5e-3, range, of));
        best.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(lens, |b| b.1)
    });
    // The lens is judged by its blur at the depths of the scene: if this blur scatters about as much as its size, the lens is unknown.
    let spread = |d: f32| {
        let s: Vec<f32> = replicas.iter().map(|l| l.sigma_px(d)).collect();
        std_of(&s)
    };
    let mean = |f: &dyn Fn(f32) -> f32| {
        observations.iter().map(|w| w.tiles * f(w.inverse_depth)).sum::<f32>() / tiles
    };
    let (scatter, typical) = (mean(&spread), mean(&|d| lens.sigma_px(d)));
    if scatter > (0.6 * typical).max(0.4) {
        let why = format!(
            "the textures at hand fit many lenses: blur of {typical:.1} px give or take {:.1}",
            2.0 * scatter
        );
        return Ok(Estimate::unknown(Reason::Uncertain, why));
    }
    let of = |f: &dyn Fn(&Lens) -> f32, floor: f32| {
        interval(f(&lens), &replicas.iter().map(f).collect::<Vec<f32>>(), floor)
    };
    let points = observations
        .iter()
        .map(|w| {
            let at = (0..SIGMAS).max_by(|&a, &b| w.table[a].total_cmp(&w.table[b])).unwrap_or(0);
            // A tile is sure of its blur if blur that is larger by half is excluded.
            let other = interpolate(&w.table, index_of_sigma(1.5 * sigma_of(at) + 0.3));
            let weight = 1.0 - other.portable_exp().min(1.0);
            BlurPoint { inverse_depth: w.inverse_depth, sigma_px: sigma_of(at), weight }
        })
        .collect();
    let sigma = lens.sigma_px_at_infinity();
    let texture = TEXTURE_BLUR / sigma.max(TEXTURE_BLUR);
    // The change of the blur in the middle of the scene per change of the log of the focus, over the blur at infinity.
    let nearness = (mean(&|d| d.abs()) / lens.focus.max(1e-6)).max(0.1);
    Ok(Estimate::Known(LensFit {
        lens,
        sigma_px_at_infinity: of(
            &|l| l.sigma_px_at_infinity(),
            (LENS_FLOORS.0 * sigma).portable_hypot(TEXTURE_BLUR),
        ),
        focus_inverse_depth: of(
            &|l| l.focus,
            lens.focus * LENS_FLOORS.1.portable_hypot(texture / nearness)
                + unseen_focus(lens, TEXTURE_BLUR, range.1),
        ),
        samples: tiles.round() as usize,
        points,
        inverse_depth_seen: seen(observations.iter().map(|w| w.inverse_depth)),
        bokeh: None,
    }))
}

/// The least and the largest of these inverse depths.
pub(super) fn seen(inverse_depths: impl Iterator<Item = f32>) -> [f32; 2] {
    inverse_depths.fold([f32::MAX, f32::MIN], |[far, near], d| [far.min(d), near.max(d)])
}

/// The std that is added to the floor of the focus (inverse depth) where the blur at infinity is below `untold_px`, the blur (px) that is
/// not told from none: such a lens may be in focus wherever its blur at infinity stays below that. It is at most `nearest`, the inverse depth
/// of what is nearest.
pub(super) fn unseen_focus(lens: Lens, untold_px: f32, nearest: f32) -> f32 {
    let share = (1.0 - lens.sigma_px_at_infinity() / untold_px).max(0.0);
    share * (untold_px / lens.slope.max(1e-9)).min(nearest.abs())
}

/// The weight of each observation, 1 on average over the tiles. Tiles of one depth mostly show one surface, whose texture misleads all of
/// them alike: so a wall that fills half of the picture counts less than everything before it.
pub(super) fn surface_weights(observations: &[LensObservation]) -> Vec<f32> {
    let total: f32 = observations.iter().map(|w| w.tiles).sum();
    let reach = SAME_DEPTH * observations.iter().map(|w| w.inverse_depth.abs()).fold(0.0, f32::max);
    let mut order: Vec<&LensObservation> = observations.iter().collect();
    order.sort_by(|a, b| a.inverse_depth.total_cmp(&b.inverse_depth));
    // The number of tiles before each observation, in the order of inverse depth.
    let mut tiles = vec![0.0];
    for w in &order {
        tiles.push(tiles[tiles.len() - 1] + w.tiles);
    }
    let weight = |w: &LensObservation| {
        let below = |limit: f32| tiles[order.partition_point(|o| o.inverse_depth < limit)];
        let near = below(w.inverse_depth + reach) - below(w.inverse_depth - reach);
        1.0 / (1.0 + SURFACES * near / total)
    };
    let weights: Vec<f32> = observations.iter().map(weight).collect();
    let mean = observations.iter().zip(&weights).map(|(w, k)| w.tiles * k).sum::<f32>() / total;
    weights.into_iter().map(|k| k / mean).collect()
}

/// The 5th and the 95th percentile of the observations' inverse depths.
pub(super) fn lens_range(observations: &[LensObservation]) -> (f32, f32) {
    defocus::seen_range(observations.iter().map(|w| w.inverse_depth))
}

/// The tables of observations at steps so small that linear interpolation will do, since they are evaluated for thousands of lenses.
pub(super) struct FineTables {
    inverse_depths: Vec<f32>,
    tables: Vec<f32>,
}

impl FineTables {
    /// The number of fine steps for each step of the observations' tables.
    const STEPS: usize = 4;
    const LEN: usize = Self::STEPS * (SIGMAS - 1) + 2;

    pub fn new(observations: &[LensObservation]) -> Self {
        let weights = surface_weights(observations);
        let fine = |w: &LensObservation, weight: f32, i: usize| {
            weight
                * interpolate(&w.table, (i as f32 / Self::STEPS as f32).min((SIGMAS - 1) as f32))
                    .max(-CLIP * w.tiles)
        };
        let tables =
            observations.iter().zip(&weights).flat_map(|(w, &k)| (0..Self::LEN).map(move |i| fine(w, k, i)));
        Self {
            inverse_depths: observations.iter().map(|w| w.inverse_depth).collect(),
            tables: tables.collect(),
        }
    }

    /// The summed log-likelihood of a lens, in nats. `weights` are those of the observations; without them all are 1.
    pub fn log_likelihood(&self, lens: Lens, weights: Option<&[f32]>) -> f32 {
        let mut sum = 0.0;
        for (i, (&d, table)) in
            self.inverse_depths.iter().zip(self.tables.chunks_exact(Self::LEN)).enumerate()
        {
            let at = index_of_sigma(lens.sigma_px(d)) * Self::STEPS as f32;
            let low = at as usize;
            let share = at - low as f32;
            sum += weights.map_or(1.0, |w| w[i]) * (table[low] + share * (table[low + 1] - table[low]));
        }
        sum
    }
}

/// The weight of a block's tiles in one part of the clip in a replica of the bootstrap: the product of exponential weights of mean 1
/// (Rubin 1981) of the block and of the part. So the evidence of one surface or one shot counts as one observation.
pub(super) fn resampled(replica: usize, block: u32, part: usize) -> f32 {
    block_weight(replica, block) * part_weight(replica, part)
}

fn block_weight(replica: usize, block: u32) -> f32 {
    -(1.0 - super::robust::uniform(replica as u64, u64::from(block))).portable_ln()
}

fn part_weight(replica: usize, part: usize) -> f32 {
    -(1.0 - super::robust::uniform(replica as u64, (BLOCKS * BLOCKS + part) as u64)).portable_ln()
}

/// The 95 % interval, >= 0, from the scatter of the replicas around the estimate and a floor (std).
pub(super) fn interval(estimate: f32, replicas: &[f32], floor: f32) -> [f32; 2] {
    let mut sorted = replicas.to_vec();
    sorted.sort_by(f32::total_cmp);
    let at = |q: f32| sorted[(q * (sorted.len() - 1) as f32).round() as usize];
    let side = |deviation: f32| deviation.max(0.0).portable_hypot(1.96 * floor);
    [(estimate - side(estimate - at(0.025))).max(0.0), estimate + side(at(0.975) - estimate)]
}

/// The 95 % interval of the median of values, of which there is at least one, by ranks; it holds all of fewer than 8 values.
fn interval_of_median(mut values: Vec<f32>) -> [f32; 2] {
    values.sort_by(f32::total_cmp);
    let (middle, half) = (0.5 * values.len() as f32, 0.98 * (values.len() as f32).sqrt());
    [(middle - half).max(0.0), (middle + half).min((values.len() - 1) as f32)]
        .map(|rank| values[rank as usize])
}

fn std_of(v: &[f32]) -> f32 {
    let mean = v.iter().sum::<f32>() / v.len() as f32;
    (v.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / v.len() as f32).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_observation_of_a_frame_that_is_not_given_is_refused() {
        let observation = |frame: usize| ExposureObservation {
            block: 0,
            frame,
            speed: 5.0,
            speed_error: 0.0,
            log_likelihood: vec![0.0; EXPOSURES],
        };
        assert!(exposure_of(&vec![observation(1); FEWEST], 2, 0.0).is_ok());
        assert!(exposure_of(&vec![observation(2); FEWEST], 2, 0.0).is_err());
    }

    #[test]
    fn a_coder_hides_long_streaks_among_short_ones_but_not_short_ones_among_long_ones() {
        let of = |coding_error: f32, speed: f32, even: bool| {
            with_coded_streak([0.3, 0.5], coding_error, speed, even)
        };
        assert_eq!(of(0.0, 5.0, false), [0.3, 0.5]);
        let [low, high] = of(MAX_CODING_ERROR, 10.0, false);
        assert!(low == 0.3 && (high - 0.5f32.hypot(0.5)).abs() < 1e-5, "{low} {high}");
        assert!(of(MAX_CODING_ERROR, 10.0, true)[1] < high);
        // The faster things move, the less a streak of the same length hides.
        assert!(of(MAX_CODING_ERROR, 20.0, false)[1] < 0.6 && of(MAX_CODING_ERROR, 2.0, false)[1] == 1.0);
    }

    #[test]
    fn frames_that_contradict_each_other_widen_the_interval_where_motion_is_even() {
        let told = [0.3, 0.5];
        let widened =
            |frames: &[f32], even: bool| with_typical_frame(told, frames.iter().copied(), even, 1e6);
        let contradict = [0.4, 0.9, f32::NAN, 0.4, 0.9];
        assert_eq!(widened(&contradict, true), [0.3, 0.9]);
        // Where motion is uneven, a few frames differ anyway.
        assert_eq!(widened(&contradict, false), told);
        assert_eq!(widened(&[0.9; 10], false), [0.3, 0.9]);
        // Two frames are too few, and one of many that stands alone is no typical frame.
        assert_eq!(widened(&[0.9, 0.9], true), told);
        assert_eq!(widened(&[&[0.4; 9][..], &[0.9]].concat(), true), told);
    }

    #[test]
    fn places_of_one_depth_do_not_tell_the_lens_not_even_far_away() {
        // Blur of about 1 px is likeliest in all places.
        let table: Vec<f32> = (0..SIGMAS).map(|i| -(sigma_of(i) - 1.0).powi(2)).collect();
        let observed = |depth: &dyn Fn(u32) -> f32| {
            let of = |i: u32| LensObservation {
                inverse_depth: depth(i),
                table: table.clone(),
                tiles: 1.0,
                block: i % 25,
                part: 0,
            };
            lens_of(&(0..50).map(of).collect::<Vec<_>>(), 24).unwrap()
        };
        for depth in [0.0, 0.5] {
            let why = observed(&|_| depth).why_unknown().map(|why| why.reason);
            assert_eq!(why, Some(Reason::OneDepth), "{depth}");
        }
        // Negative control: places of many depths do.
        assert!(observed(&|i| 0.02 * i as f32).known().is_some());
    }
}
