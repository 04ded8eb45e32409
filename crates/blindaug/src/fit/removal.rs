//! Estimation of blur by its removal from the frames alone: for every candidate of blur a sharp version is found under a prior of sparse
//! gradients, and the candidate that explains the frame best is taken.
//!
//! 1. [`denoise`]: the frame is averaged with its neighbours, moved along the flow.
//! 2. Profiles of tiles, along the motion and across it, are deconvolved as [`Line`]s: if a disk or a streak has blurred a picture, the
//!    mean of the picture across a line is blurred by the profile of the disk or the streak, whatever the picture shows. The
//!    gradients of the sharp line have a mixture of Gaussians as their prior, with variances from much less than the noise's to much more
//!    (Fergus et al. 2006): most gradients are about 0, and some are edges. A line is short enough for exact treatment of what
//!    deconvolution of images has to approximate: the posterior's covariance, the noise's covariance and the unknown surroundings.
//! 3. The error of re-synthesis alone would always favour no blur, which explains any frame. The *evidence* does not: it is the
//!    frame's probability under a candidate, integrated over all sharp lines (Levin et al., CVPR 2011).
//!
//! The lens and the rest of the camera blur alike in all directions, the shutter only along the motion: the lines across the motion
//! show how much of the blur along the motion is not the shutter's.

use super::agreement::{ExposureFit, LensFit, LensObservation};
use super::likelihood::{EXPOSURE_STEP, EXPOSURES, SIGMAS, relative, sigma_of};
use super::noise::NoiseLine;
use super::robust::median;
use super::tiles::{SPEEDS, TILE, block_of};
use super::{agreement, tiles};
use crate::model::{Estimate, ExposureFraction, Reason, Space, Unknown};
use crate::synth::noise::white_band_std;
use crate::{Encoded, Flow, Plane, Raster, Result, filter, par, raster};

/// The defocus stds that are tried, px.
const DELTAS: [f32; 10] = [0.0, 0.35, 0.7, 1.05, 1.4, 1.9, 2.6, 3.6, 5.0, 7.0];
/// The number of exposure fractions that are tried, from 0 to 1.2.
const LAMBDAS: usize = 13;
/// The step between the exposure fractions that are tried.
const LAMBDA_STEP: f32 = 0.1;
/// The number of profiles of a tile in each direction.
const PROFILES: usize = 4;
/// The width, in px, of the band of a tile whose mean is a profile.
const BAND: usize = 12;
/// The std of the model's errors, over the std of a profile.
const MISMATCH: f32 = 0.03;
/// The most tiles of a frame that are used: those of most contrast.
const TILES_PER_FRAME: usize = 24;
/// The most frames of a clip that are used.
const MAX_FRAMES: usize = 8;
/// The std, in px, of the Gaussian that stands for the pixel's own response.
const PIXEL_RESPONSE: f32 = 0.5;
/// The number of Gaussians in the prior of a gradient.
const GAUSSIANS: usize = 7;
/// The smallest variance of those Gaussians, over the noise's variance.
const SMALLEST: f64 = 0.05;
/// The ratio of each of those variances to the next smaller one.
const RATIO: f64 = 8.0;
/// The number of variational updates of the gradients' mixtures.
const ROUNDS: usize = 6;
/// The factor of a tile's log evidence. It is below 1 since the lines of a tile show the same things, and no scene follows the prior
/// exactly.
const TEMPER: f32 = 0.25;
/// The most by which a tile's log-likelihood may fall below its maximum, nats.
const CLIP: f32 = 8.0;
/// The number of replicas of the bootstrap.
const BOOTSTRAPS: usize = 120;

/// The light of a frame and the variance of its noise.
#[derive(Clone, Debug)]
pub struct NoisyLight {
    /// Light, or encoded values, with luma's weights of R, G and B.
    pub light: Plane,
    /// The variance of the noise at each pixel.
    pub variance: Plane,
}

impl NoisyLight {
    /// The light of a frame whose noise of luma has this std in the finest level; the noise is taken to be white.
    pub fn new(frame: &Encoded, noise: &NoiseLine, space: Space) -> Self {
        let white = white_band_std()[0];
        let variance = filter::gaussian_blur(&frame.luma(), 1.5).map(|y| {
            let slope = space.slope(y.max(0.02));
            // The least std is that of rounding to 8 bits.
            let std = ((noise.slope * y + noise.intercept) / white).max(0.29 / 255.0);
            (std / slope).powi(2)
        });
        Self { light: tiles::light_of(frame, space), variance }
    }
}

/// Averages a frame with neighbours in time along the flow to the next frame, with weight where they differ by no more than the noise
/// (Buades et al. 2005, along the motion). A neighbour comes with the number of frames by which it is later (-1: earlier).
///
/// The variance of the result is that of the noise that is left. All images must have one size.
pub fn denoise(frame: &NoisyLight, neighbours: &[(Plane, f32)], flow: &Flow) -> NoisyLight {
    let (w, h) = frame.light.size();
    let mut weights = Plane::filled(w, h, 1.0);
    let mut sum = frame.light.clone();
    let mut squares = Plane::filled(w, h, 1.0);
    for (other, later) in neighbours {
        let target = |x: usize, y: usize| {
            let [u, v] = flow.at(x, y);
            [x as f32 + later * u, y as f32 + later * v]
        };
        let inside = |[x, y]: [f32; 2]| x >= 0.0 && y >= 0.0 && x <= (w - 1) as f32 && y <= (h - 1) as f32;
        // The moved neighbour, and the gain of interpolation on the variance of its noise; NaN outside the frame and where flow is unknown.
        let moved = Raster::from_fn(w, h, |x, y| {
            let [tx, ty] = target(x, y);
            let gain = |t: f32| raster::cubic_weights(t.fract()).iter().map(|w| w * w).sum::<f32>();
            if inside([tx, ty]) { [other.cubic(tx, ty), gain(tx) * gain(ty)] } else { [f32::NAN; 2] }
        });
        // The squared difference over what the noise alone would give, averaged around each pixel.
        let ratio = Plane::from_fn(w, h, |x, y| {
            let [value, gain] = moved.at(x, y);
            let expected = (1.0 + gain) * frame.variance.at(x, y);
            if value.is_nan() { 100.0 } else { (frame.light.at(x, y) - value).powi(2) / expected }
        });
        let ratio = filter::gaussian_blur(&ratio, 1.5);
        for i in 0..w * h {
            let [value, gain] = moved.data()[i];
            if !value.is_nan() {
                let weight = (-(ratio.data()[i] - 1.3).max(0.0) / 0.3).exp();
                weights.data_mut()[i] += weight;
                sum.data_mut()[i] += weight * value;
                squares.data_mut()[i] += weight * weight * gain;
            }
        }
    }
    let over = |a: &Plane, x: usize, y: usize, power: i32| a.at(x, y) / weights.at(x, y).powi(power);
    NoisyLight {
        light: Plane::from_fn(w, h, |x, y| over(&sum, x, y, 1)),
        variance: Plane::from_fn(w, h, |x, y| frame.variance.at(x, y) * over(&squares, x, y, 2)),
    }
}

/// The differences between successive pixels of a profile, and the variance of the pixels' noise.
#[derive(Clone, Debug)]
pub struct Line {
    differences: Vec<f64>,
    variance: Vec<f64>,
}

impl Line {
    /// The line of these pixels, given the variance of their noise.
    pub fn new(pixels: &[f32], variance: &[f32]) -> Self {
        Self {
            differences: pixels.windows(2).map(|p| f64::from(p[1] - p[0])).collect(),
            variance: variance.iter().map(|&v| f64::from(v)).collect(),
        }
    }

    /// The posterior mean of the sharp line's gradients given the kernel (of odd length, with taps one pixel apart), and a lower bound of
    /// the kernel's log evidence.
    ///
    /// The approximation is variational: given the line, the gradients are taken as independent of the Gaussians that they come from.
    // The function is long, since the steps of one iteration share all of its state.
    pub fn deconvolved(&self, kernel: &[f64]) -> (Vec<f64>, f64) {
        let (n, taps) = (self.differences.len(), kernel.len());
        // The kernel reaches beyond the line, so gradients around the line are unknown too.
        let m = n + taps - 1;
        let noise = self.variance.iter().sum::<f64>() / self.variance.len() as f64;
        let variances: [f64; GAUSSIANS] = std::array::from_fn(|k| SMALLEST * noise * RATIO.powi(k as i32));
        let power = self.differences.iter().map(|d| d * d).sum::<f64>() / n as f64;
        let start = 1.0 / power.max(2.0 * noise);
        let mut precision = vec![start; m];
        // For a gradient of this mean square: the mean precision of the Gaussians that it may come from, its contribution to the bound, and
        // the probability of each Gaussian.
        let from = |square: f64, prior: &[f64; GAUSSIANS]| {
            let log: [f64; GAUSSIANS] =
                std::array::from_fn(|k| prior[k].ln() - 0.5 * (variances[k].ln() + square / variances[k]));
            let most = log.iter().copied().fold(f64::MIN, f64::max);
            let share = log.map(|l| (l - most).exp());
            let total: f64 = share.iter().sum();
            let expected = share.iter().zip(&variances).map(|(s, v)| s / v).sum::<f64>() / total;
            (
                expected,
                most + total.ln() + 0.5 * (square * expected - expected.ln()),
                share.map(|s| s / total),
            )
        };
        // The share of the line's gradients that come from each Gaussian: equal at first.
        let mut weights = [1.0 / GAUSSIANS as f64; GAUSSIANS];
        let mut mixture_bound = 0.0;
        let mut mean = vec![0.0; m];
        let mut covariance = vec![0.0; n * taps.max(2)];
        let band = taps.max(2);
        let mut rows = vec![0.0; n * m];
        let mut bound = f64::MIN;
        for round in 0..=ROUNDS {
            // The lower band of the covariance of the differences: [j][j - l].
            for j in 0..n {
                for l in 0..band.min(j + 1) {
                    let shared =
                        (0..taps.saturating_sub(l)).map(|t| kernel[t + l] * kernel[t] / precision[j + t]);
                    covariance[j * band + l] = shared.sum::<f64>()
                        + match l {
                            0 => self.variance[j] + self.variance[j + 1],
                            1 => -self.variance[j],
                            _ => 0.0,
                        };
                }
            }
            // The Cholesky factor replaces the covariance. Forward substitution applies it to the differences and, in `rows`, to kernels.
            let mut solved = vec![0.0; n];
            let mut log_determinant = 0.0;
            for j in 0..n {
                let first = (j + 1).saturating_sub(band);
                for i in first..=j {
                    let mut v = covariance[j * band + j - i];
                    for k in first.max((i + 1).saturating_sub(band))..i {
                        v -= covariance[j * band + j - k] * covariance[i * band + i - k];
                    }
                    covariance[j * band + j - i] =
                        if i == j { v.max(1e-18).sqrt() } else { v / covariance[i * band] };
                }
                let diagonal = covariance[j * band];
                log_determinant += 2.0 * diagonal.ln();
                let (done, rest) = rows.split_at_mut(j * m);
                let row = &mut rest[..m];
                row.fill(0.0);
                row[j..j + taps].copy_from_slice(kernel);
                let mut v = self.differences[j];
                for k in first..j {
                    let factor = covariance[j * band + j - k];
                    v -= factor * solved[k];
                    // Row k is 0 to the right of its own kernel.
                    row[..k + taps].iter_mut().zip(&done[k * m..]).for_each(|(r, d)| *r -= factor * d);
                }
                solved[j] = v / diagonal;
                row[..j + taps].iter_mut().for_each(|r| *r /= diagonal);
            }
            bound = mixture_bound - 0.5 * (log_determinant + solved.iter().map(|v| v * v).sum::<f64>());
            // The mean and the mean square of each gradient's posterior.
            let mut spread = vec![0.0; m];
            mean.fill(0.0);
            for (row, s) in rows.chunks(m).zip(&solved) {
                for (i, r) in row.iter().enumerate() {
                    mean[i] += r * s;
                    spread[i] += r * r;
                }
            }
            let squares: Vec<f64> = (0..m)
                .map(|i| {
                    let prior = 1.0 / precision[i];
                    mean[i] *= prior;
                    mean[i] * mean[i] + (prior - prior * prior * spread[i]).max(0.0)
                })
                .collect();
            if round == ROUNDS {
                break;
            }
            // An unobserved gradient should not change the evidence, but it changes the bound, and a longer kernel has more such gradients.
            // So the contribution of an unobserved gradient is subtracted from that of each gradient.
            let unseen = (0..ROUNDS).fold((start, 0.0), |(p, _), _| {
                let (expected, bound, _) = from(1.0 / p, &weights);
                (expected, bound)
            });
            mixture_bound = 0.0;
            let mut shares = [1.0 / GAUSSIANS as f64; GAUSSIANS];
            for (precision, square) in precision.iter_mut().zip(squares) {
                let (expected, bound, share) = from(square, &weights);
                *precision = expected;
                mixture_bound += bound - unseen.1;
                (0..GAUSSIANS).for_each(|k| shares[k] += share[k]);
            }
            weights = shares.map(|s| s / (m as f64 + 1.0));
        }
        (mean, bound)
    }
}

/// The taps, one pixel apart, of the profile that a streak of length `streak` px and a disk of std `sigma` px have along the streak.
/// The number of taps is odd.
pub fn kernel(streak: f32, sigma: f32) -> Vec<f64> {
    // The steps are smaller than the std of the pixel's response.
    let steps = |length: f32| (length / PIXEL_RESPONSE).ceil() as usize + 4;
    let (along, around) = (steps(streak), steps(2.0 * std::f32::consts::PI * sigma));
    let middle = |i: usize, n: usize| (i as f32 + 0.5) / n as f32;
    let reach = (0.5 * streak + 2.0 * sigma + 3.0 * PIXEL_RESPONSE).ceil() as isize;
    let mut taps = vec![0.0f64; 2 * reach as usize + 1];
    for i in 0..along {
        for j in 0..around {
            // The disk's profile at x = R cos t, weighted by sin^2 t: the chord's length is proportional to sin t, and so is dx.
            let angle = std::f32::consts::PI * middle(j, around);
            let at = streak * (middle(i, along) - 0.5) + 2.0 * sigma * angle.cos();
            let weight = f64::from(angle.sin().powi(2));
            for k in (at.round() as isize - 2).max(-reach)..=(at.round() as isize + 2).min(reach) {
                let d = (k as f32 - at) / PIXEL_RESPONSE;
                taps[(k + reach) as usize] += weight * f64::from((-0.5 * d * d).exp());
            }
        }
    }
    let total: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|t| *t /= total);
    taps
}

/// The profiles of one tile of one frame, with its motion and depth.
#[derive(Clone, Debug)]
pub struct Tile {
    /// The block of the image that the tile lies in.
    block: u32,
    /// The speed of the tile, px per frame interval; 0 without flow, or if the tile is too slow to show a streak.
    speed: f32,
    /// The inverse depth of the tile; NaN if it is unknown or spans much.
    inverse_depth: f32,
    /// The profiles along the motion and across it; along x and y without motion.
    directions: [Vec<Line>; 2],
}

/// The tiles of a frame.
pub fn tiles(frame: &NoisyLight, flow: Option<&Flow>, inverse_depth: Option<&Plane>) -> Vec<Tile> {
    let (w, h) = frame.light.size();
    let corners = tiles::corners((w, h));
    // The contrast of a tile is the energy of its gradients over the noise's.
    let contrast = par::map(corners.len(), |i| {
        let (x0, y0) = corners[i];
        let mut sum = 0.0;
        for y in (y0..y0 + TILE - 3).step_by(2) {
            for x in (x0..x0 + TILE - 3).step_by(2) {
                let v = frame.light.at(x, y);
                let d = (frame.light.at(x + 3, y) - v).powi(2) + (frame.light.at(x, y + 3) - v).powi(2);
                sum += (0.25 * d / frame.variance.at(x, y)).min(1000.0);
            }
        }
        sum / (TILE * TILE / 4) as f32
    });
    let mut order: Vec<usize> = (0..corners.len()).filter(|&i| contrast[i] > 3.0).collect();
    order.sort_by(|&a, &b| contrast[b].total_cmp(&contrast[a]));
    let mut found: Vec<((usize, usize), Tile)> = vec![];
    for i in order {
        let (x0, y0) = corners[i];
        // Overlapping tiles show the same, so only one of them is used.
        let overlaps = |(x, y): (usize, usize)| x.abs_diff(x0) < TILE && y.abs_diff(y0) < TILE;
        if found.iter().any(|f| overlaps(f.0)) {
            continue;
        }
        if let Some(tile) = tile(frame, flow, inverse_depth, corners[i]) {
            found.push((corners[i], tile));
            if found.len() == TILES_PER_FRAME {
                break;
            }
        }
    }
    found.into_iter().map(|f| f.1).collect()
}

/// The tile at a corner; `None` if its parts move differently.
fn tile(
    frame: &NoisyLight,
    flow: Option<&Flow>,
    inverse_depth: Option<&Plane>,
    (x0, y0): (usize, usize),
) -> Option<Tile> {
    let around = || (0..25).map(|i| (x0 + i % 5 * (TILE - 1) / 4, y0 + i / 5 * (TILE - 1) / 4));
    let mut motion = [1.0, 0.0];
    let mut speed = 0.0;
    if let Some(flow) = flow {
        let known: Vec<[f32; 2]> =
            around().map(|(x, y)| flow.at(x, y)).filter(|f| f[0].is_finite() && f[1].is_finite()).collect();
        let middle = [0, 1].map(|c| median(known.iter().map(|f| f[c]).collect()).unwrap_or(0.0));
        speed = middle[0].hypot(middle[1]);
        let like = |f: &&[f32; 2]| (f[0] - middle[0]).hypot(f[1] - middle[1]) < (0.2 * speed).max(0.7);
        if known.iter().filter(like).count() < 20 || speed > SPEEDS.end {
            return None;
        }
        if speed >= SPEEDS.start {
            motion = middle;
        } else {
            speed = 0.0;
        }
    }
    let depths: Vec<f32> = inverse_depth
        .map_or(vec![], |map| around().map(|(x, y)| map.at(x, y)).filter(|d| d.is_finite()).collect());
    let inverse_depth = median(depths.clone())
        .filter(|d| depths.iter().filter(|v| (*v - d).abs() < 0.12 * d.abs()).count() >= 20)
        .unwrap_or(f32::NAN);
    let center = [x0, y0].map(|v| v as f32 + 0.5 * (TILE - 1) as f32);
    let directions = [profiles(frame, center, motion)?, profiles(frame, center, [-motion[1], motion[0]])?];
    Some(Tile { block: block_of((x0, y0), frame.light.size()), speed, inverse_depth, directions })
}

/// The profiles of a square of [`TILE`] px around a place, along a direction: each is the mean across a band of the square. If a disk has
/// blurred the picture, such a mean is blurred by the disk's chords, whatever the picture shows.
/// `None` if the square leaves the frame.
fn profiles(frame: &NoisyLight, center: [f32; 2], direction: [f32; 2]) -> Option<Vec<Line>> {
    let (w, h) = frame.light.size();
    let length = direction[0].hypot(direction[1]);
    let [dx, dy] = direction.map(|d| d / length);
    let half = 0.5 * (TILE - 1) as f32;
    let at = |along: f32, across: f32| {
        [center[0] + along * dx - across * dy, center[1] + along * dy + across * dx]
    };
    let inside = |[x, y]: [f32; 2]| x >= 0.0 && y >= 0.0 && x <= (w - 1) as f32 && y <= (h - 1) as f32;
    if ![(-half, -half), (-half, half), (half, -half), (half, half)].iter().all(|&(a, b)| inside(at(a, b))) {
        return None;
    }
    let profile = |band: usize| {
        let rows = || (0..BAND).map(|r| (band * (TILE - BAND) / (PROFILES - 1) + r) as f32 - half);
        let mean_of = |value: &dyn Fn(f32, f32) -> f32| -> Vec<f32> {
            let mean = |i: usize| {
                rows().map(|across| at(i as f32 - half, across)).map(|[x, y]| value(x, y)).sum::<f32>()
            };
            (0..TILE).map(|i| mean(i) / BAND as f32).collect()
        };
        let pixels = mean_of(&|x, y| frame.light.cubic(x, y));
        let gain = |t: f32| raster::cubic_weights(t.fract()).iter().map(|w| w * w).sum::<f32>();
        let mut variance = mean_of(&|x, y| gain(x) * gain(y) * frame.variance.bilinear(x, y));
        // Errors of the model are in proportion to the contrast of the profile.
        let mean = pixels.iter().sum::<f32>() / TILE as f32;
        let power = pixels.iter().map(|p| (p - mean).powi(2)).sum::<f32>() / TILE as f32;
        variance.iter_mut().for_each(|v| *v = *v / BAND as f32 + MISMATCH.powi(2) * power);
        Line::new(&pixels, &variance)
    };
    Some((0..PROFILES).map(profile).collect())
}

impl Tile {
    /// The log evidence of a blur, by the lines along the motion (0) or across it (1).
    fn evidence(&self, direction: usize, lambda: f32, delta: f32) -> f32 {
        let streak = if direction == 0 { lambda * self.speed } else { 0.0 };
        let kernel = kernel(streak, delta);
        self.directions[direction].iter().map(|l| l.deconvolved(&kernel).1 as f32).sum::<f32>() * TEMPER
    }

    /// The log evidence of each of [`DELTAS`] by the lines across the motion, 0 at its maximum.
    fn across(&self) -> Vec<f32> {
        relative(DELTAS.iter().map(|&d| self.evidence(1, 0.0, d)))
    }

    /// The clipped log-likelihood over the exposures of a curve, in nats, within [-CLIP, 0]. The blur by the lens and the texture is one of
    /// the stds that the lines across the motion find likely.
    fn clipped_log_likelihood(&self) -> Vec<f32> {
        let across = self.across();
        let likely = || (0..DELTAS.len()).filter(|&i| across[i] > -2.0);
        let table: Vec<f32> = (0..LAMBDAS)
            .map(|l| {
                likely()
                    .map(|i| across[i] + self.evidence(0, l as f32 * LAMBDA_STEP, DELTAS[i]))
                    .fold(f32::MIN, f32::max)
            })
            .collect();
        let positions: Vec<f32> = (0..LAMBDAS).map(|l| l as f32 * LAMBDA_STEP).collect();
        let curve = (0..EXPOSURES).map(|i| between(&positions, &table, i as f32 * EXPOSURE_STEP));
        relative(curve).into_iter().map(|v| v.max(-CLIP)).collect()
    }
}

/// Interpolates a table: the result changes from the parabola through three values to the parabola through the next three.
fn between(positions: &[f32], values: &[f32], at: f32) -> f32 {
    let parabola = |i: usize| {
        let i = i.clamp(1, positions.len() - 2);
        let [a, b, c] = [positions[i - 1], positions[i], positions[i + 1]];
        values[i - 1] * (at - b) * (at - c) / ((a - b) * (a - c))
            + values[i] * (at - a) * (at - c) / ((b - a) * (b - c))
            + values[i + 1] * (at - a) * (at - b) / ((c - a) * (c - b))
    };
    let i = positions.partition_point(|&p| p <= at).clamp(1, positions.len() - 1);
    let t = (at - positions[i - 1]) / (positions[i] - positions[i - 1]);
    parabola(i - 1) + t * (parabola(i) - parabola(i - 1))
}

/// The tiles of evenly spaced frames, at most [`MAX_FRAMES`], each with its frame's index and the part of the clip that the frame lies in.
fn looked_at<'a>(frames: &[&'a [Tile]]) -> Vec<(usize, usize, &'a Tile)> {
    let step = frames.len().div_ceil(MAX_FRAMES).max(1);
    let chosen = frames.iter().enumerate().step_by(step);
    chosen.flat_map(|(f, tiles)| tiles.iter().map(move |t| (f, f / step, t))).collect()
}

/// The exposure that the tiles of all frames agree on.
pub fn fit_exposure(frames: &[&[Tile]]) -> Estimate<ExposureFit> {
    let moving: Vec<_> = looked_at(frames).into_iter().filter(|t| t.2.speed > 0.0).collect();
    if moving.len() < agreement::FEWEST {
        let why = "too little in the frames moves, or what moves has no texture";
        return Estimate::unknown(Reason::NoMotion, why);
    }
    let curves = par::map(moving.len(), |i| moving[i].2.clipped_log_likelihood());
    let summed = |which: &dyn Fn(usize) -> bool| {
        let mut sum = vec![0.0f32; EXPOSURES];
        for (_, curve) in curves.iter().enumerate().filter(|(i, _)| which(*i)) {
            sum.iter_mut().zip(curve).for_each(|(s, v)| *s += v);
        }
        sum
    };
    let sum = summed(&|_| true);
    let estimate = agreement::most_likely_exposure(&sum);
    let parts: Vec<(u32, usize, Vec<f32>)> = moving
        .iter()
        .zip(&curves)
        .map(|((_, part, tile), curve)| (tile.block, *part, curve.clone()))
        .collect();
    let [low, high] =
        agreement::bootstrapped_exposure(estimate, &parts, BOOTSTRAPS, agreement::EXPOSURE_FLOOR);
    // Tiles that contradict each other are less sure than their sum, so the interval must hold the estimates of the middle half of them.
    let mut alone: Vec<f32> = curves.iter().map(|c| agreement::most_likely_exposure(c)).collect();
    alone.sort_by(f32::total_cmp);
    let (low, high) = (low.min(alone[alone.len() / 4]), high.max(alone[alone.len() * 3 / 4]).min(1.0));
    if high - low > agreement::MAX_UNCERTAINTY {
        let why =
            format!("too little in the frames moves to tell: exposures from {low:.2} to {high:.2} all fit");
        let fits = [low.max(0.0), high];
        return Estimate::Unknown(Unknown::new(Reason::Uncertain, why).with_fits(fits));
    }
    let per_frame = (0..frames.len())
        .filter(|&f| moving.iter().filter(|m| m.0 == f).count() >= agreement::FEWEST)
        .map(|f| (f, agreement::most_likely_exposure(&summed(&|i| moving[i].0 == f)).min(1.0)))
        .collect();
    let curve = relative(sum.into_iter())
        .into_iter()
        .enumerate()
        .map(|(i, v)| [i as f32 * EXPOSURE_STEP, v])
        .collect();
    Estimate::Known(ExposureFit {
        exposure: ExposureFraction(estimate.min(1.0)),
        interval: [low, high],
        samples: moving.len(),
        curve,
        per_frame,
    })
}

/// The thin lens that the tiles of all frames agree on, given the exposure (0 if it is unknown).
///
/// # Errors
/// The same as [`agreement::lens_of`].
pub fn fit_lens(frames: &[&[Tile]], exposure: ExposureFraction) -> Result<Estimate<LensFit>> {
    let known: Vec<_> = looked_at(frames).into_iter().filter(|t| t.2.inverse_depth.is_finite()).collect();
    let observations = par::map(known.len(), |i| {
        let (_, part, tile) = known[i];
        let table: Vec<f32> = (tile.across().iter().zip(DELTAS))
            .map(|(across, delta)| across + tile.evidence(0, exposure.0, delta))
            .collect();
        LensObservation {
            inverse_depth: tile.inverse_depth,
            table: relative(
                (0..SIGMAS).map(|s| between(&DELTAS, &table, sigma_of(s).min(DELTAS[DELTAS.len() - 1]))),
            ),
            tiles: 1.0,
            block: tile.block,
            part,
        }
    });
    agreement::lens_of(&observations, BOOTSTRAPS)
}
