//! Blind fit of exposure and defocus: the Whittle likelihood of local spectra.
//!
//! The windowed periodogram P of a tile is compared with `V = a S |K_MB|^2 |K_DoF|^2 + n`: S is the spectrum of natural
//! images, `K_MB = sinc(lambda F.w)` the shutter, `K_DoF` the lens at the tile's depth, n the noise, and the amplitude a is
//! profiled out. Log-likelihood: `-mean(log V + P / V)`. Motion blur acts along the flow and defocus in all directions,
//! so one table over (lambda, sigma) per tile serves the joint fit; the global unknowns (lambda; sigma at infinity, focus)
//! maximise the sum over all tiles of all frames, each tile's loss clipped against outliers.

use crate::fit::noise::LumaNoise;
use crate::{Encoded, Error, Flow, Plane, Raster, Result, Transfer, luma, par};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use std::sync::{Arc, OnceLock};

/// Side of a tile, px.
const TILE: usize = 64;
/// Exposure fractions of the table: 0 to 1.25 (past 1, so that a maximum at 1 is seen from both sides).
const LAMBDAS: usize = 26;
const LAMBDA_STEP: f32 = 0.05;
/// Defocus stds of the table, px: steps of 0.15 to 3, of 0.5 to 10.
const SIGMAS: usize = 35;
const RADII: usize = 32;

fn sigma_of(index: usize) -> f32 {
    if index <= 20 { 0.15 * index as f32 } else { 3.0 + 0.5 * (index - 20) as f32 }
}

fn index_of_sigma(sigma: f32) -> f32 {
    if sigma <= 3.0 { sigma / 0.15 } else { 20.0 + (sigma - 3.0) / 0.5 }.clamp(0.0, (SIGMAS - 1) as f32)
}

/// What one tile of one frame tells.
#[derive(Clone, Debug)]
struct Tile {
    /// Which place of the image it is, the same in all frames.
    place: u32,
    /// Median speed, px per frame interval; 0 without flow.
    speed: f32,
    /// Median inverse depth; NaN without depth.
    inverse_depth: f32,
    /// Log-likelihood minus its maximum, [lambda][sigma]; one row where the speed is too small to tell lambda.
    spectrum: Spectrum,
    lambda: Vec<f32>,
    sigma: Vec<f32>,
}

/// Options, for experiments.
#[derive(Clone, Copy, Debug)]
pub struct Tuning {
    pub alpha: f32,
    pub response: f32,
    pub floor_mb: f32,
    pub floor_dof: f32,
    pub clip: f32,
    pub linear: bool,
    pub rmax: f32,
    pub rmin: f32,
    pub alpha_sd: f32,
    pub temper: f32,
}

impl Default for Tuning {
    fn default() -> Self {
        Self { alpha: 2.4, response: 0.5, floor_mb: 3e-3, floor_dof: 1e-4, clip: 8.0, linear: true, rmax: 0.35, rmin: 0.03, alpha_sd: 0.4, temper: 0.15 }
    }
}


/// Tiles, collected frame by frame.
pub struct SpectralEvidence {
    pub tuning: Tuning,
    pub lambda: f32,
    tiles: Vec<Tile>,
    fft: Arc<dyn Fft<f32>>,
}

impl SpectralEvidence {
    pub fn new(tuning: Tuning) -> Self {
        Self { tuning, lambda: 0.0, tiles: vec![], fft: FftPlanner::new().plan_fft_forward(TILE) }
    }

    /// Adds a frame, with what is known of it: the flow to the next frame, inverse depth (NaN: no reading), and the std
    /// of its noise.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn add_frame(
        &mut self,
        frame: &Encoded,
        flow: Option<&Flow>,
        inverse_depth: Option<&Plane>,
        noise: &[LumaNoise; 4],
    ) -> Result<()> {
        let (w, h) = frame.0.size();
        if flow.is_some_and(|f| f.size() != (w, h)) || inverse_depth.is_some_and(|d| d.size() != (w, h)) {
            return Err(Error::new("flow and depth must have the frame's size"));
        }
        if w < TILE || h < TILE {
            return Ok(());
        }
        let t = &self.tuning;
        // Luma in the light that was blurred, and the variance of its noise.
        let light = |v: f32| if t.linear { Transfer::Srgb.decode(v) } else { v };
        let y = Raster::from_fn(w, h, |x, y| {
            let p = frame.0.at(x, y).map(light);
            0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]
        });
        let white = crate::synth::noise::white_band_std();
        let variance = Raster::from_fn(w, h, |x, yy| {
            let encoded = luma(frame.0.at(x, yy));
            let slope = if t.linear { Transfer::Srgb.slope(Transfer::Srgb.decode(encoded.max(0.02))) } else { 1.0 };
            std::array::from_fn::<f32, 4, _>(|l| ((noise[l].slope * encoded + noise[l].intercept).max(0.0) / white[l] / slope).powi(2))
        });
        let step = TILE / 2;
        let (columns, rows) = ((w - TILE) / step + 1, (h - TILE) / step + 1);
        let this = &*self;
        let tiles = par::map(columns * rows, |i| {
            let (x, y0) = (i % columns * step, i / columns * step);
            this.tile(i as u32, x, y0, &y, flow, inverse_depth, &variance)
        });
        self.tiles.extend(tiles.into_iter().flatten());
        Ok(())
    }

    #[allow(clippy::too_many_arguments)]
    fn tile(
        &self,
        place: u32,
        x0: usize,
        y0: usize,
        light: &Plane,
        flow: Option<&Flow>,
        inverse_depth: Option<&Plane>,
        variance: &Raster<[f32; 4]>,
    ) -> Option<Tile> {
        let pixels = || (y0..y0 + TILE).flat_map(|y| (x0..x0 + TILE).map(move |x| (x, y)));
        let mut motion = [0.0, 0.0];
        if let Some(flow) = flow {
            let f: Vec<[f32; 2]> = pixels().map(|(x, y)| flow.at(x, y)).filter(|f| f[0].is_finite() && f[1].is_finite()).collect();
            if f.len() < TILE * TILE / 2 {
                return None;
            }
            motion = [0, 1].map(|c| median(f.iter().map(|f| f[c]).collect()));
            let speed = motion[0].hypot(motion[1]);
            let deviation = f.iter().map(|f| (f[0] - motion[0]).hypot(f[1] - motion[1])).sum::<f32>() / f.len() as f32;
            if deviation > (0.15 * speed).max(0.5) || speed > 60.0 {
                return None;
            }
        }
        let mut depth = f32::NAN;
        if let Some(map) = inverse_depth {
            let mut d: Vec<f32> = pixels().map(|(x, y)| map.at(x, y)).filter(|d| d.is_finite()).collect();
            if d.len() < TILE * TILE / 2 {
                return None;
            }
            d.sort_by(f32::total_cmp);
            let at = |q: f32| d[(q * (d.len() - 1) as f32) as usize];
            depth = at(0.5);
            if at(0.9) - at(0.1) > 0.25 * depth {
                return None;
            }
        }
        let mut noise = [0.0; 4];
        for (x, y) in pixels() {
            (0..4).for_each(|l| noise[l] += variance.at(x, y)[l] / (TILE * TILE) as f32);
        }
        let spectrum = self.spectrum(&self.periodogram(light, x0, y0), motion, noise)?;
        Some(Tile { place, speed: motion[0].hypot(motion[1]), inverse_depth: depth, spectrum, lambda: vec![], sigma: vec![] })
    }

    /// `|FFT(window (patch - mean))|^2 / TILE^2`, [wy][wx].
    fn periodogram(&self, light: &Plane, x0: usize, y0: usize) -> Vec<f32> {
        let window = hann();
        let (mut sum, mut weights) = (0.0, 0.0);
        for y in 0..TILE {
            for x in 0..TILE {
                sum += light.at(x0 + x, y0 + y) * window[y] * window[x];
                weights += window[y] * window[x];
            }
        }
        let mean = sum / weights;
        let mut a: Vec<Complex<f32>> = (0..TILE * TILE)
            .map(|i| {
                let (x, y) = (i % TILE, i / TILE);
                Complex::new((light.at(x0 + x, y0 + y) - mean) * window[y] * window[x], 0.0)
            })
            .collect();
        self.fft.process(&mut a);
        let mut b: Vec<Complex<f32>> = (0..TILE * TILE).map(|i| a[i % TILE * TILE + i / TILE]).collect();
        self.fft.process(&mut b);
        (0..TILE * TILE).map(|i| b[i % TILE * TILE + i / TILE].norm_sqr() / (TILE * TILE) as f32).collect()
    }

    /// The periodogram in bins of (modulus, component along the motion).
    fn spectrum(&self, periodogram: &[f32], motion: [f32; 2], noise: [f32; 4]) -> Option<Spectrum> {
        let t = &self.tuning;
        let speed = motion[0].hypot(motion[1]);
        let along_bins = if speed < MIN_SPEED { 1 } else { TILE / 2 + 2 };
        // [ring][along]
        let mut bins = vec![Bin::default(); along_bins * RADII];
        for j in 0..TILE {
            let wy = if j < TILE / 2 { j as f32 } else { j as f32 - TILE as f32 } / TILE as f32;
            for i in 0..=TILE / 2 {
                let wx = i as f32 / TILE as f32;
                let r = wx.hypot(wy);
                if !(t.rmin..t.rmax).contains(&r) {
                    continue;
                }
                let along = if along_bins == 1 { 0.0 } else { (wx * motion[0] + wy * motion[1]).abs() / speed };
                let ring = (r * TILE as f32) as usize;
                let bin = &mut bins[(along * TILE as f32) as usize + ring * along_bins];
                let weight = if i == 0 || i == TILE / 2 { 0.5 } else { 1.0 };
                bin.weight += weight;
                bin.power += weight * periodogram[j * TILE + i];
                bin.along += weight * along;
                bin.radius += weight * r;
            }
        }
        let mut rings = vec![];
        let mut start = 0;
        let mut kept = vec![];
        for ring in bins.chunks(along_bins) {
            kept.extend(ring.iter().filter(|b| b.weight > 0.0).map(|b| Bin {
                weight: b.weight, power: b.power / b.weight, along: b.along / b.weight, radius: b.radius / b.weight }));
            if kept.len() > start {
                rings.push(start..kept.len());
                start = kept.len();
            }
        }
        let power: Vec<f32> = kept.iter().map(|b| b.power).collect();
        let weight: Vec<f32> = kept.iter().map(|b| b.weight).collect();
        let total: f32 = weight.iter().sum();
        let mean = power.iter().zip(&weight).map(|(p, w)| p * w).sum::<f32>() / total;
        // Level l holds the frequencies around 0.35 / 2^l cycles per px.
        let noise: Vec<f32> = kept
            .iter()
            .map(|b| {
                let at = (0.35 / b.radius).log2().clamp(0.0, 3.0);
                let i = (at as usize).min(2);
                (noise[i] + (at - i as f32) * (noise[i + 1] - noise[i])).max(1e-9)
            })
            .collect();
        let mean_noise = noise.iter().zip(&weight).map(|(p, w)| p * w).sum::<f32>() / total;
        if mean < 3.0 * mean_noise {
            return None;
        }
        Some(Spectrum { speed, bins: kept, rings, power, weight, noise })
    }

    pub fn len(&self) -> usize {
        self.tiles.len()
    }

    pub fn solve(&mut self, moving: bool, depth: bool) -> (Vec<f32>, f32, f32) {
        let t = self.tuning;
        let mut history = vec![];
        let mut lambda = 0.0;
        if moving {
            for (tile, v) in self.each(|x| x.spectrum.lambda_rings(&t)) { self.tiles[tile].lambda = v; }
            lambda = self.fit_lambda();
            history.push(lambda);
        }
        let mut lens = (0.0, 0.0);
        for round in 0..3 {
            if !depth { break; }
            for (tile, v) in self.each(|x| x.spectrum.sigma_table(lambda.min(1.0), &t)) { self.tiles[tile].sigma = v; }
            lens = self.fit_lens();
            if moving && round < 2 {
                for (tile, v) in self.each(|x| x.spectrum.lambda_table(lens.0 * (x.inverse_depth - lens.1).abs(), &t)) { self.tiles[tile].lambda = v; }
                lambda = self.fit_lambda();
                history.push(lambda);
            } else { break; }
        }
        (history, lens.0, lens.1)
    }

    fn each(&self, f: impl Fn(&Tile) -> Vec<f32> + Sync + Send) -> Vec<(usize, Vec<f32>)> {
        par::map(self.tiles.len(), |i| (i, f(&self.tiles[i])))
    }

    pub fn lambda_objective(&self, lambda: f32) -> f32 {
        self.tiles.iter().map(|t| t.lambda_at(lambda).max(-self.tuning.clip)).sum()
    }

    pub fn fit_lambda(&self) -> f32 {
        (0..=125).map(|i| i as f32 * 0.01).max_by(|a, b| self.lambda_objective(*a).total_cmp(&self.lambda_objective(*b))).unwrap()
    }

    fn lens_objective(&self, slope: f32, focus: f32) -> f32 {
        self.tiles.iter().map(|t| t.sigma_at(slope * (t.inverse_depth - focus).abs()).max(-self.tuning.clip)).sum()
    }

    pub fn fit_lens(&self) -> (f32, f32) {
        let mut best = (f32::MIN, 0.0, 0.0);
        let mut depths: Vec<f32> = self.tiles.iter().map(|t| t.inverse_depth).filter(|d| d.is_finite()).collect();
        depths.sort_by(f32::total_cmp);
        let (lo, hi) = (depths[depths.len() / 20], depths[depths.len() * 19 / 20]);
        for i in 0..48 {
            let focus = 0.3 * lo * (3.0 * hi / (0.3 * lo)).powf(i as f32 / 47.0);
            let reach = (lo - focus).abs().max((hi - focus).abs());
            for j in 0..40 {
                let slope = 0.1 * 100f32.powf(j as f32 / 39.0) / reach;
                let v = self.lens_objective(slope, focus);
                if v > best.0 {
                    best = (v, slope, focus);
                }
            }
        }
        let mut step = [best.1 * 0.1, best.2 * 0.08];
        for _ in 0..40 {
            let mut improved = false;
            for k in 0..2 {
                for s in [-1.0, 1.0] {
                    let mut y = [best.1, best.2];
                    y[k] = (y[k] + s * step[k]).max(0.0);
                    let v = self.lens_objective(y[0], y[1]);
                    if v > best.0 {
                        best = (v, y[0], y[1]);
                        improved = true;
                    }
                }
            }
            if !improved {
                step = step.map(|s| s * 0.5);
            }
        }
        (best.1, best.2)
    }
}

#[derive(Clone, Debug)]
struct Spectrum {
    speed: f32,
    bins: Vec<Bin>,
    rings: Vec<std::ops::Range<usize>>,
    power: Vec<f32>,
    weight: Vec<f32>,
    noise: Vec<f32>,
}

const ALPHAS: usize = 6;

impl Spectrum {
    fn shutter(&self, lambda: f32, t: &Tuning) -> Vec<f32> {
        self.bins.iter().map(|b| {
            let x = std::f32::consts::PI * lambda * self.speed * b.along;
            let sinc = if x < 1e-3 { 1.0 } else { x.sin() / x };
            (sinc * sinc).max(t.floor_mb)
        }).collect()
    }
    fn lens(&self, s: f32, t: &Tuning) -> Vec<f32> {
        let at_s = index_of_sigma(s);
        let si = (at_s as usize).min(SIGMAS - 2);
        let sf = at_s - si as f32;
        self.bins.iter().map(|b| {
            let at = (b.radius * KERNEL_STEPS as f32 * 2.0).min(KERNEL_STEPS as f32 - 1.001);
            let (i, f) = (at as usize, at.fract());
            let g = |k: &[f32; KERNEL_STEPS]| k[i] + f * (k[i + 1] - k[i]);
            g(&disk_gains()[si]) * (1.0 - sf) + sf * g(&disk_gains()[si + 1]) + t.floor_dof
        }).collect()
    }
    fn priors(&self, t: &Tuning) -> Vec<(f32, Vec<f32>)> {
        (0..ALPHAS).map(|k| {
            let alpha = t.alpha + t.alpha_sd * (k as f32 - 2.5) * 0.8;
            (-0.5 * ((alpha - t.alpha) / t.alpha_sd).powi(2),
             self.bins.iter().map(|b| (b.radius / 0.2).powf(-alpha) * (-(std::f32::consts::TAU * t.response * b.radius).powi(2)).exp()).collect())
        }).collect()
    }
    fn lambda_rings(&self, t: &Tuning) -> Vec<f32> {
        if self.speed < MIN_SPEED { return vec![]; }
        let mut starts: Vec<Option<f32>> = vec![None; self.rings.len()];
        finish((0..LAMBDAS).map(|l| {
            let g = self.shutter(l as f32 * LAMBDA_STEP, t);
            let mut ll = 0.0;
            for (ring, start) in self.rings.iter().zip(&mut starts) {
                let r = ring.clone();
                let (a, v) = log_likelihood(&self.power[r.clone()], &self.weight[r.clone()], &g[r.clone()], &self.noise[r], *start);
                *start = Some(a);
                ll += v;
            }
            ll * t.temper
        }).collect())
    }
    fn lambda_table(&self, sigma: f32, t: &Tuning) -> Vec<f32> {
        if self.speed < MIN_SPEED { return vec![]; }
        let lens = self.lens(sigma, t);
        let priors = self.priors(t);
        let mut starts = [None; ALPHAS];
        finish((0..LAMBDAS).map(|l| {
            let g = self.shutter(l as f32 * LAMBDA_STEP, t);
            self.marginal(&priors, &g, &lens, &mut starts, t)
        }).collect())
    }
    fn sigma_table(&self, lambda: f32, t: &Tuning) -> Vec<f32> {
        let g = self.shutter(lambda, t);
        let priors = self.priors(t);
        let mut starts = [None; ALPHAS];
        finish((0..SIGMAS).map(|s| self.marginal(&priors, &g, &self.lens(sigma_of(s), t), &mut starts, t)).collect())
    }
    fn marginal(&self, priors: &[(f32, Vec<f32>)], shutter: &[f32], lens: &[f32], starts: &mut [Option<f32>; ALPHAS], t: &Tuning) -> f32 {
        let mut terms = [0.0; ALPHAS];
        for (k, (prior, base)) in priors.iter().enumerate() {
            let g: Vec<f32> = base.iter().zip(lens).zip(shutter).map(|((a, b), c)| a * b * c).collect();
            let (a, ll) = log_likelihood(&self.power, &self.weight, &g, &self.noise, starts[k]);
            starts[k] = Some(a);
            terms[k] = ll * t.temper + prior;
        }
        let max = terms.iter().copied().fold(f32::MIN, f32::max);
        max + terms.iter().map(|v| (v - max).exp()).sum::<f32>().ln()
    }
}

fn finish(mut v: Vec<f32>) -> Vec<f32> {
    let max = v.iter().copied().fold(f32::MIN, f32::max);
    v.iter_mut().for_each(|v| *v -= max);
    v
}

#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    weight: f32,
    power: f32,
    along: f32,
    radius: f32,
}

/// Below this speed, px per frame interval, a tile says nothing about lambda.
const MIN_SPEED: f32 = 1.5;

impl Tile {
    fn lambda_at(&self, lambda: f32) -> f32 {
        if self.lambda.is_empty() { return 0.0; }
        interpolate(&self.lambda, lambda / LAMBDA_STEP)
    }
    fn sigma_at(&self, sigma: f32) -> f32 {
        interpolate(&self.sigma, index_of_sigma(sigma))
    }
}

/// Cubic (Catmull-Rom) interpolation.
fn interpolate(v: &[f32], at: f32) -> f32 {
    let i = (at as usize).min(v.len() - 2);
    let f = (at - i as f32).clamp(0.0, 1.0);
    let (a, b) = (v[i], v[i + 1]);
    let before = if i > 0 { v[i - 1] } else { 2.0 * a - b };
    let after = if i + 2 < v.len() { v[i + 2] } else { 2.0 * b - a };
    let (m0, m1) = (0.5 * (b - before), 0.5 * (after - a));
    let f2 = f * f;
    (2.0 * f2 * f - 3.0 * f2 + 1.0) * a + (f2 * f - 2.0 * f2 + f) * m0 + (3.0 * f2 - 2.0 * f2 * f) * b + (f2 * f - f2) * m1
}

/// Profiles the amplitude out: (amplitude, -mean(ln V + P / V)).
fn log_likelihood(power: &[f32], weight: &[f32], g: &[f32], noise: &[f32], start: Option<f32>) -> (f32, f32) {
    let dot = |a: &[f32]| a.iter().zip(weight).map(|(a, w)| a * w).sum::<f32>();
    let n = power.len();
    let (power, weight, g, noise) = (&power[..n], &weight[..n], &g[..n], &noise[..n]);
    let mut a = start.unwrap_or_else(|| dot(power) / dot(g));
    for _ in 0..6 {
        let (mut top, mut bottom) = (0.0, 0.0);
        for i in 0..n {
            let v = a * g[i] + noise[i];
            let k = weight[i] * g[i] / (v * v);
            top += k * (power[i] - noise[i]);
            bottom += k * g[i];
        }
        a = (top / bottom).max(1e-12);
    }
    let mut ll = 0.0;
    for i in 0..n {
        let v = a * g[i] + noise[i];
        ll -= weight[i] * (v.ln() + power[i] / v);
    }
    (a, ll)
}

fn median(mut v: Vec<f32>) -> f32 {
    let middle = v.len() / 2;
    *v.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Hann window with mean square 1 in each direction.
fn hann() -> &'static [f32; TILE] {
    static WINDOW: OnceLock<[f32; TILE]> = OnceLock::new();
    WINDOW.get_or_init(|| {
        let w: [f32; TILE] =
            std::array::from_fn(|i| 0.5 - 0.5 * (std::f32::consts::TAU * (i as f32 + 1.0) / (TILE as f32 + 1.0)).cos());
        let rms = (w.iter().map(|v| v * v).sum::<f32>() / TILE as f32).sqrt();
        w.map(|v| v / rms)
    })
}

/// Samples of the lens's gain over the modulus of the frequency, 0 to 1/2 cycles per px.
const KERNEL_STEPS: usize = 128;

/// `|K_DoF|^2` of a uniform disk of std sigma, averaged over the radii (+-30 %) that occur in a tile.
fn disk_gains() -> &'static [[f32; KERNEL_STEPS]; SIGMAS] {
    static GAINS: OnceLock<Box<[[f32; KERNEL_STEPS]; SIGMAS]>> = OnceLock::new();
    GAINS.get_or_init(|| {
        Box::new(std::array::from_fn(|s| {
            std::array::from_fn(|i| {
                let r = i as f32 / KERNEL_STEPS as f32 / 2.0;
                let gain = |scale: f32| {
                    let x = std::f32::consts::TAU * 2.0 * sigma_of(s) * scale * r + 1e-4;
                    (2.0 * libm::j1f(x) / x).powi(2)
                };
                (0..9).map(|k| gain(0.7 + 0.075 * k as f32)).sum::<f32>() / 9.0
            })
        }))
    })
}
