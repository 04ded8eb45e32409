//! The exposure from two frames that show the same surface, whatever its texture.
//!
//! A surface has one sharp spectrum S. Frames in which it moves by `F1` and `F2` show `S K(lambda F1.w)` and `S K(lambda F2.w)`. If
//! the motions differ, in length or direction, a wrong lambda leaves a difference between the frames that no S explains.
//! If the motions do not differ, such a pair of tiles says nothing, and [`super::Tile`] has to rely on a prior of textures.
//! Where motion is uneven, the streaks `lambda F1` and `lambda F2` are unknown themselves; what pairs tell of them is put together in
//! [`streaks`](super::super::streaks).

use super::super::likelihood::{
    CLIP, EXPOSURE_STEP, EXPOSURES, LEAK, MAX_LAMBDA, TEMPER, interpolate, lambda_step, lanes, relative,
    slope_gain,
};
use super::super::noise::LumaNoise;
use super::super::tiles::{
    BAND, COLUMNS, Frequency, Light, MIN_CONTRAST, MotionOf, SAMPLES, SPEEDS, TILE, block_of, common_motion,
    corners, frequencies, noise_density, padding_density, transform,
};
use crate::model::Space;
use crate::portable::Portable;
use crate::{Encoded, Flow, par};
use wide::f32x4;

/// The most pairs of tiles of two frames that are kept: those of most contrast.
const PAIRS_PER_FRAME: usize = 60;
/// The least difference of a pair's motions, px of the tile; smaller differences may be errors of the flow.
const MIN_DIFFERENCE: f32 = 0.3;
/// The least and the largest step of the tables over the exposure fraction.
const LAMBDA_STEPS: std::ops::Range<f32> = 0.04..0.1;
/// The largest mean deviation of the motion within a tile, px of the tile, beyond which the two frames do not show the same surface.
const MAX_DEVIATION: f32 = 0.5;
/// The most pairs of tiles of two frames by which streaks are measured.
const STREAK_PAIRS: usize = 16;
/// The stds, px, of the misregistration of the two frames that are tried; the likeliest one counts.
const MISREGISTRATIONS: [f32; 2] = [0.05, 0.2];
/// The stds, px, that are tried where streaks are measured. Log-likelihoods are not clipped there; with 1 px, tiles that do not match tell
/// nothing.
const STREAK_MISREGISTRATIONS: [f32; 3] = [0.05, 0.2, 1.0];
/// The share of the power that changes of light may alter at any frequency.
const CHANGE: f32 = 1e-3;
/// The number of nats by which a pair's log-likelihood is raised before it is cut off at 0, so that weak preferences do not count.
const TOLERANCE: f32 = 1.0;

/// A tile of one frame and the tile of the next frame that shows the same surface.
#[derive(Clone, Debug)]
pub struct Pair {
    /// The block of the image that the tile of the later frame lies in.
    pub(super) block: u32,
    /// The number of px of the frame, each way, that make one px of the tiles.
    pub(super) scale: f32,
    /// The motion of the surface in both frames, px of the tiles per frame interval.
    motions: [[f32; 2]; 2],
    /// The [`super::Tile::noise_moments`] of the first tile.
    noise_moments: [f32; 3],
    /// The power of the first tile plus that of the second, at each of the [`frequencies`].
    sum: Vec<f32>,
    /// The power of the first tile minus that of the second.
    difference: Vec<f32>,
    /// The real part of the cross spectrum of the tiles, after alignment.
    cross: Vec<f32>,
    /// The expected power of one tile: half of `sum`, smoothed over neighbouring frequencies.
    expected: Vec<f32>,
}

/// The places of a pair's tiles and the motions of its surface in both frames.
struct Place {
    /// The corners of the tiles, px of the tiles' resolution.
    corners: [(usize, usize); 2],
    /// The rest of the surface's displacement beyond the whole pixels between the corners.
    rest: [f32; 2],
    motions: [[f32; 2]; 2],
    contrast: f32,
    block: u32,
    scale: usize,
}

/// The pairs of two successive frames, given the flow from the first to the second and the motion of each frame at its own time (NaN:
/// unknown).
pub fn pairs(frames: [&Encoded; 2], flow: &Flow, [first, second]: [&Flow; 2], space: Space) -> Vec<Pair> {
    let motions: [&MotionOf; 2] = [&|x, y| first.at(x, y), &|x, y| second.at(x, y)];
    at_places(frames, places(frames[0], flow, motions, MIN_DIFFERENCE), PAIRS_PER_FRAME, space)
}

/// The pairs of two successive frames by which streaks are measured where motion is uneven; the motions may be alike.
pub(in crate::fit) fn streak_pairs(
    frames: [&Encoded; 2],
    flow: &Flow,
    motions: [&MotionOf; 2],
    space: Space,
) -> Vec<Pair> {
    at_places(frames, places(frames[0], flow, motions, 0.0), STREAK_PAIRS, space)
}

/// The pairs at those places that have most contrast, at most `most`.
fn at_places(frames: [&Encoded; 2], mut places: Vec<Place>, most: usize, space: Space) -> Vec<Pair> {
    places.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
    places.truncate(most);
    par::map(places.len(), |i| pair(frames, &places[i], space))
}

/// The places of pairs at both resolutions, whose motions differ by at least `least` px of the tile.
fn places(frame: &Encoded, flow: &Flow, motions: [&MotionOf; 2], least: f32) -> Vec<Place> {
    [1, 2].into_iter().flat_map(|scale| places_at(frame, flow, motions, least, scale)).collect()
}

/// The same, if `scale` px of the frame make one px of a tile.
fn places_at(
    frame: &Encoded,
    flow: &Flow,
    [first, second]: [&MotionOf; 2],
    least: f32,
    scale: usize,
) -> Vec<Place> {
    let size @ (w, h) = (flow.width() / scale, flow.height() / scale);
    // Only the corners of a checkerboard are used: a pair costs as much as several of [`super::Tile`], and all pairs tell hardly more.
    let mut corners = corners(size);
    corners.retain(|(x, y)| (x + y) % TILE == 0);
    let found = par::map(corners.len(), |i| {
        let corner @ (x, y) = corners[i];
        let (speed, motion, _) = common_motion(first, corner, scale)?;
        let (_, way, deviation) = common_motion(&|x, y| flow.at(x, y), corner, scale)?;
        let to = |at: usize, by: f32| at.checked_add_signed(by.round() as isize);
        let next @ (next_x, next_y) = (to(x, way[0])?, to(y, way[1])?);
        if deviation > MAX_DEVIATION || next_x + TILE > w || next_y + TILE > h {
            return None;
        }
        let (next_speed, next_motion, deviation) = common_motion(second, next, scale)?;
        let differ = (motion[0] - next_motion[0]).portable_hypot(motion[1] - next_motion[1]);
        if deviation > MAX_DEVIATION || speed.max(next_speed) < SPEEDS.start || differ < least {
            return None;
        }
        let (mut sum, mut squares) = (0.0, 0.0);
        for v in (y..y + TILE)
            .step_by(2)
            .flat_map(|y| frame.0.row(scale * y)[scale * x..].iter().step_by(2 * scale).take(TILE / 2))
        {
            sum += v[1];
            squares += v[1] * v[1];
        }
        let n = SAMPLES as f32;
        let std = (squares / n - (sum / n).powi(2)).max(0.0).sqrt();
        Some(Place {
            corners: [corner, next],
            rest: way.map(|v| v - v.round()),
            motions: [motion, next_motion],
            contrast: std,
            block: block_of(next, size),
            scale,
        })
    });
    found.into_iter().flatten().collect()
}

fn pair(frames: [&Encoded; 2], place: &Place, space: Space) -> Pair {
    let scale = place.scale;
    let lights = [0, 1].map(|i| {
        let (x, y) = place.corners[i];
        let light =
            Light::new(&Encoded(frames[i].0.crop(scale * x, scale * y, scale * TILE, scale * TILE)), space);
        if scale == 2 { light.halved() } else { light }
    });
    let [a, b] = lights.each_ref().map(|l| transform(&l.plane, (0, 0)));
    let power = |[re, im]: &[f32; 2]| (re * re + im * im) / (TILE * TILE) as f32;
    let mean: Vec<f32> = a.iter().zip(&b).map(|(a, b)| 0.5 * (power(a) + power(b))).collect();
    let smooth = |at: usize| {
        let (column, row) = (at / TILE, at % TILE);
        let columns = column.saturating_sub(1)..(column + 2).min(COLUMNS);
        let n = 3.0 * columns.len() as f32;
        columns
            .flat_map(|c| [TILE - 1, 0, 1].map(|d| c * TILE + (row + d) % TILE))
            .map(|i| mean[i])
            .sum::<f32>()
            / n
    };
    let of = |f: &dyn Fn(usize) -> f32| frequencies().iter().map(|q| f(q.at)).collect::<Vec<f32>>();
    Pair {
        block: place.block,
        scale: scale as f32,
        motions: place.motions,
        noise_moments: lights[0].noise_moments((0, 0)),
        sum: of(&|i| power(&a[i]) + power(&b[i])),
        difference: of(&|i| power(&a[i]) - power(&b[i])),
        cross: frequencies()
            .iter()
            .map(|q| {
                let angle = std::f32::consts::TAU * (q.x * place.rest[0] + q.y * place.rest[1]);
                let ((sin, cos), [re, im]) = (angle.portable_sin_cos(), b[q.at]);
                let turned = [re * cos - im * sin, re * sin + im * cos];
                (a[q.at][0] * turned[0] + a[q.at][1] * turned[1]) / (TILE * TILE) as f32
            })
            .collect(),
        expected: of(&smooth),
    }
}

/// The shutter's kernel `K` at the three frequencies whose power a frequency of the windowed spectrum gathers: its own and one on both
/// sides.
struct Gathered {
    along: Vec<f32x4>,
    beside: f32,
}

impl Gathered {
    fn new(motion: [f32; 2], direction: [f32; 2], frequencies: &[Frequency]) -> Self {
        let along = frequencies.iter().map(|q| q.x * motion[0] + q.y * motion[1]);
        Self {
            along: lanes(along, 0.0),
            beside: LEAK * (motion[0] * direction[0] + motion[1] * direction[1]),
        }
    }

    fn kernel(&self, i: usize, lambda: f32) -> [f32x4; 3] {
        let reach = std::f32::consts::PI * lambda;
        let (x, d) = (self.along[i] * reach, self.beside * reach);
        let ((sin, cos), (sin_d, cos_d)) = (x.sin_cos(), d.sin_cos());
        let sinc = |sin: f32x4, x: f32x4| x.abs().simd_lt(1e-3).select(f32x4::ONE, sin / x);
        let (a, b) = (sin * cos_d, cos * sin_d);
        [sinc(a - b, x - d), sinc(sin, x), sinc(a + b, x + d)]
    }

    fn kernels(&self, lambda: f32) -> Kernels {
        (0..self.along.len()).map(|i| self.kernel(i, lambda)).collect()
    }
}

/// The shutter's kernel at all frequencies of a pair, four at a time.
pub(in crate::fit) type Kernels = Vec<[f32x4; 3]>;

impl Pair {
    /// The greater of the pair's speeds, px of the frame per frame interval.
    pub(super) fn speed(&self) -> f32 {
        self.scale * self.longest()
    }

    fn longest(&self) -> f32 {
        self.motions.map(|m| m[0].portable_hypot(m[1])).into_iter().fold(0.0, f32::max)
    }

    /// The clipped log-likelihood over the exposures of a curve, in nats, within [-CLIP, 0]; `None` if the pair is hardly more than noise.
    pub(super) fn clipped_log_likelihood(&self, noise: &LumaNoise) -> Option<Vec<f32>> {
        let prepared = PreparedPair::new(self, noise, &MISREGISTRATIONS, BAND.end)?;
        let step = lambda_step(self.longest(), LAMBDA_STEPS);
        let table = prepared.over_lambda(step);
        let curve = (0..EXPOSURES).map(|i| interpolate(&table, i as f32 * EXPOSURE_STEP / step));
        Some(relative(curve).into_iter().map(|v| (v + TOLERANCE).clamp(-CLIP, 0.0)).collect())
    }
}

/// A pair with its noise, ready for the likelihood.
pub(in crate::fit) struct PreparedPair<'a> {
    pair: &'a Pair,
    /// The frequencies that are looked at.
    frequencies: Vec<Frequency>,
    /// The power by which noise padding is seen.
    padding_density: f32,
    /// The direction of the leak, along the mean motion.
    direction: [f32; 2],
    weight: Vec<f32x4>,
    sum: Vec<f32x4>,
    difference: Vec<f32x4>,
    cross: Vec<f32x4>,
    /// The expected power without noise.
    signal: Vec<f32x4>,
    /// The power, for each misregistration that is tried, by which the frames differ for other reasons than their streaks.
    misregistered_power: Vec<Vec<f32x4>>,
    /// The share of each of the three frequencies that a frequency gathers.
    shares: [Vec<f32x4>; 3],
}

impl<'a> PreparedPair<'a> {
    /// A pair prepared by the frequencies below `highest` cycles per px of the tile; `None` if it is hardly more than noise.
    fn new(pair: &'a Pair, noise: &LumaNoise, misregistrations: &[f32], highest: f32) -> Option<Self> {
        let padding_density = padding_density(pair.noise_moments, pair.scale, noise.coding_error);
        let density = noise_density(pair.noise_moments, pair.scale, noise, noise.coding_error);
        let of_noise: Vec<f32> = frequencies().iter().map(|q| density(q.modulus)).collect();
        if pair.expected.iter().sum::<f32>() < MIN_CONTRAST * of_noise.iter().sum::<f32>() {
            return None;
        }
        let chosen: Vec<usize> =
            (0..of_noise.len()).filter(|&i| frequencies()[i].modulus < highest).collect();
        let column = |rest: f32, of: &dyn Fn(usize) -> f32| lanes(chosen.iter().map(|&i| of(i)), rest);
        let modulus = |i: usize| frequencies()[i].modulus;
        let [a, b] = pair.motions;
        let direction = [a[0] + b[0], a[1] + b[1]];
        let length = direction[0].portable_hypot(direction[1]).max(BAND.start);
        let direction = direction.map(|v| v / length);
        let along = column(0.0, &|i| frequencies()[i].x * direction[0] + frequencies()[i].y * direction[1]);
        let moduli = column(1.0, &modulus);
        Some(Self {
            pair,
            padding_density,
            direction,
            weight: column(0.0, &|i| frequencies()[i].weight),
            sum: column(0.0, &|i| pair.sum[i]),
            difference: column(0.0, &|i| pair.difference[i]),
            cross: column(0.0, &|i| pair.cross[i]),
            // After a coder only power above the noise padding counts as signal, since weaker detail was predicted from the other frame.
            signal: column(0.0, &|i| (pair.expected[i] - of_noise[i]).max(0.0)),
            misregistered_power: misregistrations
                .iter()
                .map(|shift| {
                    column(1.0, &|i| {
                        let moved = (std::f32::consts::TAU * shift * modulus(i)).powi(2).min(1.0);
                        of_noise[i] + pair.expected[i] * (CHANGE + moved)
                    })
                })
                .collect(),
            shares: [-LEAK, 0.0, LEAK].map(|d| {
                let middle = if d == 0.0 { 4.0 } else { 1.0 };
                along.iter().zip(&moduli).map(|(&a, &m)| middle * slope_gain(a, m, d)).collect()
            }),
            frequencies: chosen.iter().map(|&i| frequencies()[i]).collect(),
        })
    }

    /// The same for measuring streaks, by the frequencies below `highest` cycles per px of the frame.
    pub fn of_streaks(pair: &'a Pair, noise: &LumaNoise, highest: f32) -> Option<Self> {
        Self::new(pair, noise, &STREAK_MISREGISTRATIONS, highest * pair.scale)
    }

    /// The motion of the surface in one of both frames, px of the frame per frame interval.
    pub fn motion(&self, frame: usize) -> [f32; 2] {
        self.pair.motions[frame].map(|v| self.pair.scale * v)
    }

    /// The kernels of a streak, px of the frame.
    pub fn kernels(&self, streak: [f32; 2]) -> Kernels {
        let streak = streak.map(|v| v / self.pair.scale);
        Gathered::new(streak, self.direction, &self.frequencies).kernels(1.0)
    }

    /// The log-likelihood over lambda in steps of `step`, 0 at its maximum.
    fn over_lambda(&self, step: f32) -> Vec<f32> {
        let shutters = self.pair.motions.map(|m| Gathered::new(m, self.direction, &self.frequencies));
        relative((0..=(MAX_LAMBDA / step).round() as usize).map(|l| {
            let [first, second] = shutters.each_ref().map(|s| s.kernels(l as f32 * step));
            self.log_likelihood(&first, &second)
        }))
    }

    /// The log-likelihood of the kernels of both frames, with the likeliest of the misregistrations.
    pub fn log_likelihood(&self, first: &Kernels, second: &Kernels) -> f32 {
        self.likeliest(first, second).1
    }

    /// The number of the likeliest misregistration of these kernels of both frames, and their log-likelihood with it.
    pub fn likeliest(&self, first: &Kernels, second: &Kernels) -> (usize, f32) {
        let mut likelihoods = [f32x4::ZERO; STREAK_MISREGISTRATIONS.len()];
        self.each(first, second, |i, power, left| {
            for (likelihood, misregistered_power) in likelihoods.iter_mut().zip(&self.misregistered_power) {
                let variance = misregistered_power[i] + left;
                *likelihood -= self.weight[i] * (variance.ln() + power / variance);
            }
        });
        let tried =
            likelihoods[..self.misregistered_power.len()].iter().map(|v| TEMPER * v.reduce_add()).enumerate();
        tried.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f32::MIN))
    }

    /// The log-likelihood of the kernels of both frames with the misregistration of this number.
    pub fn log_likelihood_at(&self, first: &Kernels, second: &Kernels, misregistration: usize) -> f32 {
        let misregistered_power = &self.misregistered_power[misregistration];
        let mut likelihood = f32x4::ZERO;
        self.each(first, second, |i, power, left| {
            let variance = misregistered_power[i] + left;
            likelihood -= self.weight[i] * (variance.ln() + power / variance);
        });
        TEMPER * likelihood.reduce_add()
    }

    /// Calls `of` with the index of each four frequencies, the power of the component of the two frames' amplitudes at right angles to
    /// `S (K1, K2)`, which is free of any S but for a rest, since the window gathers frequencies at which K differs, and with the power of
    /// that rest.
    #[inline]
    fn each(&self, first: &Kernels, second: &Kernels, mut of: impl FnMut(usize, f32x4, f32x4)) {
        for i in 0..self.weight.len() {
            let (k1, k2) = (&first[i], &second[i]);
            let [mut own1, mut own2, mut both] = [f32x4::splat(1e-5), f32x4::splat(1e-5), f32x4::ZERO];
            for (s, share) in self.shares.iter().enumerate() {
                own1 += share[i] * k1[s] * k1[s];
                own2 += share[i] * k2[s] * k2[s];
                both += share[i] * k1[s] * k2[s];
            }
            // S has hardly any power along the minor axis of the covariance of the two amplitudes.
            let (mean, half) = (0.5 * (own1 + own2), 0.5 * (own1 - own2));
            let root = (half * half + both * both).sqrt().max(f32x4::splat(1e-9));
            let ratio = ((mean - root) / (mean + root)).max(f32x4::ZERO);
            let power = self.padding_density
                + 0.5 * (self.sum[i] - (half * self.difference[i] + 2.0 * both * self.cross[i]) / root);
            of(i, power, 2.0 * ratio * self.signal[i]);
        }
    }
}
