//! What the observations of many tiles and frames agree on: their clipped log-likelihoods are summed, the most likely value is taken,
//! and a bootstrap over blocks of the image and parts of the clip gives its interval.

use super::defocus::{self, BlurPoint, Lens};
use super::likelihood::{
    CLIP, EXPOSURE_STEP, EXPOSURES, PARTS, SIGMAS, index_of_sigma, interpolate, part_of, sigma_of,
};
use super::noise::{MAX_CODING_ERROR, NOTABLE_CODING_ERROR};
use super::tiles::BLOCKS;
use crate::model::{Estimate, ExposureFraction, Reason};
use crate::{Error, Result, par};

/// An exposure that seems longer than this fraction is unknown: no shutter is open for so long, so something else looks like its streaks.
/// A shutter that is open all the time may seem to be open for 1.05.
pub(super) const LONGEST: f32 = 1.15;

/// An exposure whose interval is wider than this is unknown.
pub(super) const MAX_UNCERTAINTY: f32 = 0.7;

/// The length of a streak, px, that cannot be told from none.
const HIDDEN_STREAK: f32 = 1.2;

/// The std of the exposure fraction that stands for what the models leave out.
pub(super) const EXPOSURE_FLOOR: f32 = 0.025;

/// The relative stds that stand for what the models leave out: of the blur at infinity, and of the inverse depth in focus.
const LENS_FLOORS: (f32, f32) = (0.08, 0.06);

/// The std of the exposure fraction that stands for a coder's errors where they are as large as they may be.
const CODING_FLOOR: f32 = 0.05;

/// The std, in px, of the blur that textures which are soft or sharp themselves add or hide. It matters where blur is small.
const TEXTURE_BLUR: f32 = 0.2;

/// A lens is a candidate if its loss in nats exceeds that of the likeliest lens by at most this share. The limit saves time: what is
/// worse is the best on hardly any replica of the bootstrap.
const CANDIDATE: f32 = 0.5;

/// The share of the largest inverse depth that the inverse depths of places must span to tell a lens.
const MIN_DEPTH_SPAN: f32 = 0.2;

/// Tiles whose inverse depths differ by less than this share of the largest mostly show one surface.
const SAME_DEPTH: f32 = 0.03;

/// What a surface counts grows with its share of all tiles up to one over this number.
const SURFACES: f32 = 25.0;

/// The number of replicas of the bootstrap for a whole clip.
pub const BOOTSTRAPS: usize = 120;

/// The exposure that maximises the likelihood.
#[derive(Clone, Debug)]
pub struct ExposureFit {
    /// The estimate.
    pub exposure: ExposureFraction,
    /// Its 95 % interval.
    pub interval: [f32; 2],
    /// How many tiles it rests on.
    pub samples: usize,
    /// (lambda, log-likelihood), 0 at the maximum.
    pub curve: Vec<[f32; 2]>,
    /// The estimate of each frame alone, where it has one.
    pub per_frame: Vec<(usize, f32)>,
}

/// The thin lens that maximises the likelihood.
#[derive(Clone, Debug)]
pub struct LensFit {
    /// The estimate.
    pub lens: Lens,
    /// 95 % interval of sigma at infinity, px.
    pub sigma_px_at_infinity: [f32; 2],
    /// 95 % interval of the focus, inverse depth.
    pub focus_inverse_depth: [f32; 2],
    /// How many tiles it rests on.
    pub samples: usize,
    /// The std that fits each tile best alone.
    pub points: Vec<BlurPoint>,
}

/// The exposure at the maximum of a curve.
pub(super) fn most_likely_exposure(curve: &[f32]) -> f32 {
    (0..curve.len()).max_by(|&a, &b| curve[a].total_cmp(&curve[b])).unwrap_or(0) as f32 * EXPOSURE_STEP
}

/// The 95 % interval of an exposure by the bootstrap alone, from the curves of (block of the image, part of the clip) and a floor (std).
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

/// No shutter is open for longer than a frame: what seems to be is as far below that as it may be below what it seems.
fn within_a_frame(estimate: f32, interval: [f32; 2]) -> [f32; 2] {
    let beyond = (estimate - 1.0).max(0.0);
    interval.map(|v| (v - beyond).clamp(0.0, 1.0))
}

/// The 95 % interval of an exposure from the same curves, their sum, [`LumaNoise::coding_error`], and the [`typical_speed`] of the
/// observations. It also holds exposures to which all of these together object by less than one of them may, and those of streaks that
/// their texture hides.
pub(super) fn exposure_interval(
    estimate: f32,
    sum: &[f32],
    parts: &[(u32, usize, Vec<f32>)],
    bootstraps: usize,
    coding_error: f32,
    speed: f32,
) -> [f32; 2] {
    let floor = EXPOSURE_FLOOR.hypot(CODING_FLOOR * coding_error / MAX_CODING_ERROR);
    let [low, high] = bootstrapped_exposure(estimate, parts, bootstraps, floor);
    let least = sum.iter().copied().fold(f32::MIN, f32::max) - CLIP;
    let likely = || (0..EXPOSURES).filter(|&i| sum[i] >= least).map(|i| i as f32 * EXPOSURE_STEP);
    let [lowest, highest] =
        within_a_frame(estimate, [likely().fold(f32::MAX, f32::min), likely().fold(0.0, f32::max)]);
    with_hidden_streak([low.min(lowest), high.max(highest)], speed)
}

/// A streak adds to the variance that the texture has along it, so textures hide short streaks, and look like them: the least and the
/// largest exposure that such ones may be.
fn with_hidden_streak([low, high]: [f32; 2], speed: f32) -> [f32; 2] {
    let hidden = (HIDDEN_STREAK / speed).powi(2);
    [(low * low - hidden).max(0.0).sqrt(), (high * high + hidden).sqrt().min(1.0)]
}

/// The typical speed, px per frame interval, from the sum of the observations' [`ExposureObservation::speed`] and that of its squares: fast ones tell more.
pub(super) fn typical_speed(sum: f32, squares: f32) -> f32 {
    squares / sum
}

/// What a tile, or a pair of them, says of the exposure.
#[derive(Clone, Debug)]
pub struct ExposureObservation {
    /// The block of the image, < 25: observations of one err alike.
    pub block: u32,
    /// The number of the frame, from 0.
    pub frame: usize,
    /// px per frame interval, of the frame.
    pub speed: f32,
    /// What it objects to each of the [`EXPOSURES`], in nats, <= 0.
    pub log_likelihood: Vec<f32>,
}

/// The exposure that the observations of `frames` frames agree on, found with noise of this
/// [`coding_error`](super::noise::LumaNoise::coding_error).
///
/// # Errors
/// If an observation has another number of log_likelihood than [`EXPOSURES`].
pub fn exposure_of(
    observations: &[ExposureObservation],
    frames: usize,
    coding_error: f32,
) -> Result<Estimate<ExposureFit>> {
    if observations.iter().any(|w| w.log_likelihood.len() != EXPOSURES) {
        return Err(Error::new(format!(
            "an observation of the exposure must hold {EXPOSURES} log_likelihood"
        )));
    }
    if observations.len() < 6 {
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
    let sum = summed(&|_| true);
    let estimate = best(&sum);
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
        .filter(|&f| observations.iter().filter(|w| w.frame == f).count() >= 6)
        .map(|f| (f, best(&summed(&|w| w.frame == f)).min(1.0)))
        .collect();
    let over_speeds = |f: &dyn Fn(f32) -> f32| observations.iter().map(|w| f(w.speed)).sum::<f32>();
    let speed = typical_speed(over_speeds(&|v| v), over_speeds(&|v| v * v));
    let [low, high] = exposure_interval(estimate, &sum, &parts, BOOTSTRAPS, coding_error, speed);
    // Frames that contradict each other are not as sure as their sum: the typical frame's exposure must be covered too.
    let interval = interval_of_median(per_frame.iter().map(|f| f.1))
        .map(|of_frames| with_hidden_streak(of_frames, speed))
        .map_or([low, high], |[l, h]| [low.min(l), high.max(h)]);
    if interval[1] - interval[0] > MAX_UNCERTAINTY {
        let contradicting = high - low <= MAX_UNCERTAINTY;
        let why = if contradicting {
            "the frames contradict each other, as those of different shots or of strongly compressed video may"
        } else if coding_error >= NOTABLE_CODING_ERROR {
            "too little in the frames moves, or too little of it stands out of what compression has taken, to tell"
        } else {
            "too little in the frames moves, or what moves has too little texture, to tell"
        };
        let reason = if contradicting { Reason::Contradicting } else { Reason::Uncertain };
        let why = format!("{why}: exposures from {:.2} to {:.2} all fit", interval[0], interval[1]);
        return Ok(Estimate::unknown(reason, why));
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

/// What a tile, or several of one block and depth, say of the blur there.
#[derive(Clone, Debug)]
pub struct LensObservation {
    /// Inverse depth of the place.
    pub inverse_depth: f32,
    /// Log-likelihood over the [`SIGMAS`] of the tables, relative to its maximum.
    pub table: Vec<f32>,
    /// How many tiles it is the sum of.
    pub tiles: f32,
    /// The block of the image, < 25: observations of one err alike.
    pub block: u32,
    /// The part of the clip, < 8, likewise.
    pub part: usize,
}

/// The thin lens that the observations agree on, its intervals from so many replicas of the bootstrap.
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
    if range.1 - range.0 < MIN_DEPTH_SPAN * range.1.abs() {
        let why = "the textured places all lie at about one depth, through which many lenses fit";
        return Ok(Estimate::unknown(Reason::OneDepth, why));
    }
    let fine = FineTables::new(observations);
    // A lens that fits nearly as well may fit best on other surfaces.
    let mut candidates = defocus::best_lenses(range, |lens| fine.log_likelihood(lens, None));
    let (most, lens) = candidates[0];
    candidates.retain(|c| c.0 >= most - (CANDIDATE * most.abs()).max(CLIP));
    let replicas: Vec<Lens> = par::map(bootstraps.max(1), |r| {
        let weights: Vec<f32> = observations.iter().map(|w| resampled(r, w.block, w.part)).collect();
        let of = |l: Lens| fine.log_likelihood(l, Some(&weights));
        let best = candidates.iter().map(|c| defocus::refined_lens(c.1, 5e-3, range, of));
        best.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(lens, |b| b.1)
    });
    // What matters is the blur where things are: if its own scatter is as large as itself, nothing is known.
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
        interval(f(&lens), &replicas.iter().map(f).collect::<Vec<f32>>(), floor * f(&lens))
    };
    let points = observations
        .iter()
        .map(|w| {
            let at = (0..SIGMAS).max_by(|&a, &b| w.table[a].total_cmp(&w.table[b])).unwrap_or(0);
            // Sure if a blur that differs by half is excluded.
            let other = interpolate(&w.table, index_of_sigma(1.5 * sigma_of(at) + 0.3));
            let weight = 1.0 - other.exp().min(1.0);
            BlurPoint { inverse_depth: w.inverse_depth, sigma_px: sigma_of(at), weight }
        })
        .collect();
    let texture = TEXTURE_BLUR / lens.sigma_px_at_infinity().max(TEXTURE_BLUR);
    // The blur of the scene's middle changes by this much when the focus is nearer by the factor e, over the blur at infinity.
    let nearness = (mean(&|d| d.abs()) / lens.focus.max(1e-6)).max(0.1);
    Ok(Estimate::Known(LensFit {
        lens,
        sigma_px_at_infinity: of(&|l| l.sigma_px_at_infinity(), LENS_FLOORS.0.hypot(texture)),
        focus_inverse_depth: of(&|l| l.focus, LENS_FLOORS.1.hypot(texture / nearness)),
        samples: tiles.round() as usize,
        points,
    }))
}

/// What each observation counts, 1 on average over the tiles. Tiles of one depth mostly show one surface, whose texture misleads all of
/// them alike: so a wall that fills half of the picture is not worth as much as all that is before it.
pub(super) fn surface_weights(observations: &[LensObservation]) -> Vec<f32> {
    let total: f32 = observations.iter().map(|w| w.tiles).sum();
    let reach = SAME_DEPTH * observations.iter().map(|w| w.inverse_depth.abs()).fold(0.0, f32::max);
    let mut order: Vec<&LensObservation> = observations.iter().collect();
    order.sort_by(|a, b| a.inverse_depth.total_cmp(&b.inverse_depth));
    // Tiles up to each.
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

/// 5 % and 95 % of the observations' inverse depths.
pub(super) fn lens_range(observations: &[LensObservation]) -> (f32, f32) {
    defocus::seen_range(observations.iter().map(|w| w.inverse_depth))
}

/// The tables of observations at steps so small that straight lines between them will do: they are asked of thousands of lenses.
pub(super) struct FineTables {
    inverse_depths: Vec<f32>,
    tables: Vec<f32>,
}

impl FineTables {
    /// Steps in one of the observations' tables.
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

    /// What the observations say of a lens, in nats, each with its weight, or 1.
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

/// Weight of a block's tiles in one part of the clip in a replica of the bootstrap: exponential ones of mean 1 (Rubin 1981) of
/// the block and of the part. What only one surface or one shot says thus counts as one observation.
fn resampled(replica: usize, block: u32, part: usize) -> f32 {
    let weight = |i: u64| -(1.0 - super::robust::uniform(replica as u64, i)).ln();
    weight(u64::from(block)) * weight((BLOCKS * BLOCKS + part) as u64)
}

/// 95 %: the replicas' scatter around the estimate and a floor, >= 0.
pub(super) fn interval(estimate: f32, replicas: &[f32], floor: f32) -> [f32; 2] {
    let mut sorted = replicas.to_vec();
    sorted.sort_by(f32::total_cmp);
    let at = |q: f32| sorted[(q * (sorted.len() - 1) as f32).round() as usize];
    let side = |deviation: f32| deviation.max(0.0).hypot(1.96 * floor);
    [(estimate - side(estimate - at(0.025))).max(0.0), estimate + side(at(0.975) - estimate)]
}

/// 95 % interval of the median, by ranks; `None` of fewer than 8 values.
fn interval_of_median(values: impl Iterator<Item = f32>) -> Option<[f32; 2]> {
    let mut v: Vec<f32> = values.collect();
    v.sort_by(f32::total_cmp);
    let n = v.len();
    let half = 0.98 * (n as f32).sqrt();
    (n >= 8).then(|| [v[(0.5 * n as f32 - half) as usize], v[((0.5 * n as f32 + half) as usize).min(n - 1)]])
}

fn std_of(v: &[f32]) -> f32 {
    let mean = v.iter().sum::<f32>() / v.len() as f32;
    (v.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / v.len() as f32).sqrt()
}
