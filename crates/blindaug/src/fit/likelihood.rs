//! The Whittle likelihood of a tile's spectrum, over the exposure fraction and over the std of the blur.

use super::noise::LumaNoise;
use super::tiles::{Bin, MIDDLE, MIN_CONTRAST, TILE, Tile, noise_density, padding_density};
use crate::model::SharpeningModel;
use crate::portable::Portable;
use std::ops::Range;
use std::sync::OnceLock;
use wide::f32x4;

/// The largest exposure fraction of the tables. It lies above 1, so that a maximum at 1 is seen from both sides.
pub const MAX_LAMBDA: f32 = 1.25;

/// The step of the tables over the exposure, as a length of streak in px of the tile, limited to the fractions in [`LAMBDA_STEPS`].
pub const STREAK_STEP: f32 = 0.6;

/// The power that motion leaves at the zeros of its ideal kernel, by the window's leakage and by motion within a tile.
pub const SHUTTER_FLOOR: f32 = 1e-3;

/// The power that a lens leaves at the zeros of its ideal kernel.
const LENS_FLOOR: f32 = 1e-4;

/// The number of the bootstrap's parts of a clip in time, each of which may be another shot.
pub(super) const PARTS: usize = 8;

/// The part of a clip of `frames` frames that a frame lies in.
pub(super) fn part_of(frame: usize, frames: usize) -> usize {
    frame * PARTS.min(frames) / frames.max(1)
}

/// The least and the largest step of the tables over the exposure fraction.
pub const LAMBDA_STEPS: Range<f32> = 0.05..0.125;

/// The step, within `limits`, of a table over the exposure fraction for this speed, px of the tile per frame interval: [`STREAK_STEP`], so
/// that a table ends at [`MAX_LAMBDA`].
pub(super) fn lambda_step(speed: f32, limits: Range<f32>) -> f32 {
    let step = (STREAK_STEP / speed).clamp(limits.start, limits.end);
    MAX_LAMBDA / (MAX_LAMBDA / step).round()
}

/// The index of this exposure fraction in a curve.
pub(super) fn index_of_exposure(exposure: f32) -> usize {
    (exposure / EXPOSURE_STEP).round() as usize
}

/// The number of exposure fractions of a curve: from 0 on in steps of [`EXPOSURE_STEP`], to past 1.
pub const EXPOSURES: usize = 251;

/// The step of a curve over the exposure fraction.
pub const EXPOSURE_STEP: f32 = 0.005;

/// The number of defocus stds of the tables: in steps of 0.15 px up to 3 px, of 0.5 px up to 10 px, of 2 px up to 40 px.
pub const SIGMAS: usize = 50;

/// The number of defocus stds for which a tile's own likelihood is computed: up to 3.5 px of the tile. Larger blur leaves less in a
/// spectrum than its window leaks from lower frequencies, so that a tile does not tell the size of such blur.
pub const TILE_SIGMAS: usize = 22;

/// The number of nats by which a tile's log-likelihood falls for each px of blur beyond the stds that the tile tells.
pub const LARGER_BLUR: f32 = 0.1;

/// The prior of the spectral slope alpha: its mean and its std.
pub const ALPHA: (f32, f32) = (2.4, 0.4);

/// The number of spectral slopes over which the likelihood is integrated.
pub const ALPHAS: usize = 6;

/// The std of the Gaussian that stands for the pixel's own response, px.
pub const PIXEL_RESPONSE: f32 = 0.5;

/// The factor of a tile's log-likelihood. It is below 1 since the window correlates neighbouring frequencies, tiles overlap, and no scene
/// is exactly what the prior says.
pub const TEMPER: f32 = 0.15;

/// The most nats by which a tile may find a value less likely than its likeliest one.
pub const CLIP: f32 = 8.0;

/// The number of nats between a tile's likeliest and least likely exposure at which the tile counts half. A less informative tile counts
/// less, since tiles that hardly see any motion blur may all err to the same side.
pub const INFORMATIVE: f32 = 24.0;

/// The number of neighbouring frequencies that the window merges into about one. A log-likelihood is too large by this factor when it is
/// weighed against the cost of a ring's amplitude.
pub const CORRELATED: f32 = 2.25;

/// The prior precision of the log of a ring's amplitude, in units of the likelihood before it is tempered.
pub const AMPLITUDE_PRECISION: f32 = 1.0;

/// The prior stds of the coefficients of cos 2 theta and cos 4 theta in the scene's log spectrum, with theta the angle to the motion.
pub const DIRECTION: [f32; 2] = [1.4, 1.0];

/// The errors of a tile's noise that are allowed for where the exposure is estimated.
pub const EXPOSURE_NOISE_ERROR: NoiseError = NoiseError { log_power: 0.2, unseen: 0.006 };

/// The errors of a tile's noise that are allowed for where the lens is estimated. They are smaller than for the exposure, since a sharp
/// lens leaves little room for noise that is stronger than it was measured.
pub const LENS_NOISE_ERROR: NoiseError = NoiseError { log_power: 0.1, unseen: 0.002 };

/// The std, in px, of the length that a tile's texture adds to its apparent streaks. It matters where motion is slow.
pub const STREAK_ERROR: f32 = 0.4;

/// The errors of a tile's noise that are allowed for.
pub struct NoiseError {
    /// The std of the log of the noise's power.
    pub log_power: f32,
    /// The std, in luma of full scale 1, of noise that was not measured.
    pub unseen: f32,
}

impl NoiseError {
    /// Both numbers, in the order of their fields.
    pub fn as_array(&self) -> [f32; 2] {
        [self.log_power, self.unseen]
    }
}

/// A tile with its noise, ready for the likelihood.
pub(super) struct Prepared<'a> {
    /// The tile.
    pub(super) tile: &'a Tile,
    /// The index of the frame.
    pub(super) frame: usize,
    /// The part of the clip that the frame lies in.
    pub(super) part: usize,
    /// The power of each bin, with the padding by [`padding_density`] noise.
    power: Vec<f32>,
    /// The density of the noise at each bin, with the same padding.
    noise: Vec<f32>,
    /// The density of white noise whose luma has std 1, over the density of the tile's noise in the middle of the band.
    white_over_noise: f32,
}

impl<'a> Prepared<'a> {
    /// A tile prepared for the likelihood; `None` if the tile holds hardly more than noise.
    pub(super) fn new(
        tile: &'a Tile,
        frame: usize,
        part: usize,
        noise: &LumaNoise,
        coding_error: f32,
    ) -> Option<Self> {
        let density = noise_density(tile.noise_moments, tile.scale, noise, coding_error);
        let padding_density = padding_density(tile.noise_moments, tile.scale, coding_error);
        let noise: Vec<f32> = tile.bins.iter().map(|b| density(b.modulus)).collect();
        let power: Vec<f32> = tile.bins.iter().map(|b| b.power + padding_density).collect();
        let sum =
            |f: &dyn Fn(usize) -> f32| (0..noise.len()).map(|i| tile.bins[i].weight * f(i)).sum::<f32>();
        let white_over_noise = tile.noise_moments[2] / (tile.scale * tile.scale) / density(MIDDLE);
        (sum(&|i| power[i]) > MIN_CONTRAST * sum(&|i| noise[i])).then_some(Self {
            tile,
            frame,
            part,
            power,
            noise,
            white_over_noise,
        })
    }

    /// The prior precision of the log of the factor by which the noise may be off, in the units of the likelihood before it is tempered.
    pub(super) fn noise_precision(&self, error: &NoiseError) -> f32 {
        let log_unseen = libm::log1pf(error.unseen * error.unseen * self.white_over_noise);
        (TEMPER * (error.log_power * error.log_power + log_unseen * log_unseen)).recip()
    }

    /// The log-likelihood over lambda in steps of `step`, 0 at its maximum, of
    /// `V = amplitude of the ring * exp(c2 cos 2 theta + c4 cos 4 theta) |K_MB|^2 + exp(e) n`, with c2, c4 and e at their most likely
    /// values and the amplitudes integrated over.
    fn over_lambda(&self, step: f32) -> Vec<f32> {
        relative(self.absolute_over_lambda(step).into_iter())
    }

    /// The same, not relative to the maximum: comparable between directions that the tile's motion may have.
    pub(super) fn absolute_over_lambda(&self, step: f32) -> Vec<f32> {
        let shutter = Shutter::new(self.tile);
        let mut scene = RingScene::new(self);
        let mut gain = vec![];
        let at = |l: usize| {
            shutter.gain(l as f32 * step, &mut gain);
            // The scene is near its solution already, except for the first value of a table.
            for _ in 0..if l == 0 { 12 } else { 1 } {
                scene.improve(&gain);
            }
            scene.improve(&gain) * TEMPER
        };
        (0..=(MAX_LAMBDA / step).round() as usize).map(at).collect()
    }

    /// The clipped log-likelihood over the exposures of a curve, in nats, within [-CLIP, 0].
    pub(super) fn clipped_log_likelihood(&self) -> Vec<f32> {
        let step = lambda_step(self.tile.speed, LAMBDA_STEPS);
        let table = self.over_lambda(step);
        let width = STREAK_ERROR / self.tile.speed / EXPOSURE_STEP;
        // A wide blur leaves no detail within `stride` steps of the curve.
        let stride = ((0.25 * width) as usize).clamp(1, 8);
        let at = |i: usize| interpolate(&table, (i * stride) as f32 * EXPOSURE_STEP / step);
        let likelihood: Vec<f32> =
            (0..=(EXPOSURES - 1).div_ceil(stride)).map(|i| at(i).portable_exp()).collect();
        let blurred: Vec<f32> =
            blurred(&likelihood, width / stride as f32).into_iter().map(Portable::portable_ln).collect();
        let curve = (0..EXPOSURES).map(|i| interpolate(&blurred, i as f32 / stride as f32));
        let curve = relative(curve);
        let most = -curve.iter().copied().fold(0.0, f32::min);
        curve.into_iter().map(|v| (v * most / (most + INFORMATIVE)).max(-CLIP)).collect()
    }

    /// The log-likelihood over the [`SIGMAS`] stds in px of the frame, 0 at its maximum, with a slow fall beyond the [`TILE_SIGMAS`], of a
    /// lens with this gain.
    pub(super) fn over_sigma_of_frame(
        &self,
        lambda: f32,
        sharpening: Option<&SharpeningModel>,
        gain: LensGain,
    ) -> Vec<f32> {
        let table = self.absolute_over_sigma(lambda, sharpening, gain);
        let largest = sigma_of(TILE_SIGMAS - 1);
        relative((0..SIGMAS).map(|i| {
            let sigma = sigma_of(i) / self.tile.scale;
            interpolate(&table, index_of_sigma(sigma.min(largest))) - LARGER_BLUR * (sigma - largest).max(0.0)
        }))
    }

    /// The log-likelihood over the [`TILE_SIGMAS`] stds in px of the tile, with the amplitude and the noise's factor at their most likely
    /// values and the slope of the spectrum integrated out. Those of two gains can be compared.
    pub(super) fn absolute_over_sigma(
        &self,
        lambda: f32,
        sharpening: Option<&SharpeningModel>,
        lens_gain: LensGain,
    ) -> Vec<f32> {
        let bins = self.alike(lambda);
        let column = |f: &dyn Fn(&Alike) -> f32| lanes(bins.iter().map(f), 0.0);
        let data = Amplitude {
            precision: self.noise_precision(&LENS_NOISE_ERROR),
            weight: column(&|b| b.weight),
            power: column(&|b| b.power),
            noise: lanes(bins.iter().map(|b| b.noise), 1.0),
        };
        let deviation = |k: usize| 0.8 * (k as f32 - 0.5 * (ALPHAS - 1) as f32);
        let modulus = lanes(bins.iter().map(|b| b.modulus), 1.0);
        let shown =
            column(&|b| b.shutter * sharpening.map_or(1.0, |s| s.gain(b.modulus / self.tile.scale).powi(2)));
        let pixel = std::f32::consts::TAU * PIXEL_RESPONSE / self.tile.scale;
        let scenes: [Vec<f32x4>; ALPHAS] = std::array::from_fn(|k| {
            let alpha = ALPHA.0 + ALPHA.1 * deviation(k);
            let of = |(&m, &shown): (&f32x4, &f32x4)| {
                let pixel = pixel * m;
                shown * (-alpha * (m / 0.2).ln() - pixel * pixel).exp()
            };
            modulus.iter().zip(&shown).map(of).collect()
        });
        let mut starts = [None; ALPHAS];
        let mut gain = vec![f32x4::ZERO; data.power.len()];
        let at = |s: usize| {
            let lens = column(&|b| lens_gain(s, b.modulus));
            let terms: [f32; ALPHAS] = std::array::from_fn(|k| {
                for ((g, a), b) in gain.iter_mut().zip(&scenes[k]).zip(&lens) {
                    *g = a * b;
                }
                let (found, ll) = data.profiled(&gain, starts[k]);
                starts[k] = Some(found);
                ll * TEMPER - 0.5 * deviation(k) * deviation(k)
            });
            let max = terms.iter().copied().fold(f32::MIN, f32::max);
            max + terms.iter().map(|v| (v - max).portable_exp()).sum::<f32>().portable_ln()
        };
        (0..TILE_SIGMAS).map(at).collect()
    }

    /// The bins at an exposure; neighbouring bins of a ring with similar gain of motion blur are merged.
    fn alike(&self, lambda: f32) -> Vec<Alike> {
        let mut gain = vec![];
        Shutter::new(self.tile).gain(lambda, &mut gain);
        let mut merged: Vec<Alike> = vec![];
        for (ring, lanes) in self.tile.rings().zip(self.tile.ring_lanes()) {
            // `first` is the gain of the first of the merged bins, with which the others are compared.
            let mut first = 0.0f32;
            let shutters = gain[lanes].iter().flat_map(|v| v.to_array());
            for (at, (i, shutter)) in ring.zip(shutters).enumerate() {
                let Bin { weight, modulus, .. } = self.tile.bins[i];
                let one = Alike { weight, power: self.power[i], modulus, noise: self.noise[i], shutter };
                match merged.last_mut() {
                    Some(last) if at > 0 && (first / shutter).max(shutter / first) < 1.3 => last.join(&one),
                    _ => {
                        first = shutter;
                        merged.push(one);
                    }
                }
            }
        }
        merged
    }
}

/// A bin, or several merged bins, at an exposure.
struct Alike {
    weight: f32,
    power: f32,
    modulus: f32,
    noise: f32,
    /// The gain `|K_MB|^2` of motion blur.
    shutter: f32,
}

impl Alike {
    fn join(&mut self, other: &Self) {
        let weight = self.weight + other.weight;
        let mean = |a: f32, b: f32| (self.weight * a + other.weight * b) / weight;
        *self = Self {
            weight,
            power: mean(self.power, other.power),
            modulus: mean(self.modulus, other.modulus),
            noise: mean(self.noise, other.noise),
            shutter: mean(self.shutter, other.shutter),
        };
    }
}

/// Packs values four at a time; the last vector is filled up with `rest`.
pub(super) fn lanes(values: impl Iterator<Item = f32>, rest: f32) -> Vec<f32x4> {
    let mut values = values.peekable();
    std::iter::from_fn(|| {
        values.peek()?;
        Some(f32x4::from(std::array::from_fn(|_| values.next().unwrap_or(rest))))
    })
    .collect()
}

impl Tile {
    /// The range of bins of each ring of like modulus.
    fn rings(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        let ends = self.rings.iter().map(|&end| usize::from(end));
        [0].into_iter().chain(ends.clone()).zip(ends).map(|(a, b)| a..b)
    }

    /// The range of each ring in a [`Tile::column`].
    fn ring_lanes(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.rings().scan(0, |at, ring| {
            let start = *at;
            *at += ring.len().div_ceil(4);
            Some(start..*at)
        })
    }

    /// A value of each bin, four bins at a time; the last vector of each ring is filled up with `rest`.
    fn column(&self, f: impl Fn(usize) -> f32, rest: f32) -> Vec<f32x4> {
        self.rings().flat_map(|ring| lanes(ring.map(&f), rest)).collect()
    }
}

/// The data for the gain of motion blur at a tile's bins, in the order of [`Tile::column`].
struct Shutter {
    /// The speed of the tile, px of the tile per frame interval.
    speed: f32,
    /// The component of each bin along the motion, cycles per px.
    along: Vec<f32x4>,
    /// The factors by which the scene is stronger at the two frequencies that leak into a bin, on both sides of it along the motion.
    leaks: [Vec<f32x4>; 2],
}

/// The distance, in cycles per px, of the two frequencies that leak into a bin: the three frequencies, with weights 1, 4 and 1, then have
/// the variance of the Hann window's squared spectrum plus that of a bin's width, 1/3 + 1/12 squared cycles per tile.
pub const LEAK: f32 = 1.118 / TILE as f32;

/// The factor by which a scene is stronger at a frequency that lies `by` cycles per px farther along the motion than the frequency with
/// the component `along` and this modulus.
pub(super) fn slope_gain(along: f32x4, modulus: f32x4, by: f32) -> f32x4 {
    let square = 1.0 + (2.0 * along + by) * by / (modulus * modulus);
    (square.max(f32x4::splat(0.1)).ln() * (-0.5 * ALPHA.0)).exp()
}

impl Shutter {
    pub(super) fn new(tile: &Tile) -> Self {
        let along = tile.column(|i| tile.bins[i].along, 0.0);
        let modulus = tile.column(|i| tile.bins[i].modulus, 1.0);
        let leaks = [-LEAK, LEAK].map(|d| {
            if tile.speed > 0.0 {
                along.iter().zip(&modulus).map(|(&a, &m)| slope_gain(a, m, d)).collect()
            } else {
                vec![f32x4::ONE; along.len()]
            }
        });
        Self { speed: tile.speed, along, leaks }
    }

    /// `|K_MB|^2`, averaged over the frequencies that a bin gathers.
    fn gain(&self, lambda: f32, gain: &mut Vec<f32x4>) {
        gain.clear();
        let reach = std::f32::consts::PI * lambda * self.speed;
        let sinc2 = |sin: f32x4, x: f32x4| {
            let sinc = sin / x;
            x.abs().simd_lt(1e-3).select(f32x4::ONE, sinc * sinc)
        };
        let (sin_leak, cos_leak) = (reach * LEAK).portable_sin_cos();
        gain.extend((0..self.along.len()).map(|i| {
            let x = self.along[i] * reach;
            let (sin, cos) = x.sin_cos();
            let (a, b) = (sin * cos_leak, cos * sin_leak);
            let sum = 4.0 * sinc2(sin, x)
                + self.leaks[0][i] * sinc2(a - b, x - reach * LEAK)
                + self.leaks[1][i] * sinc2(a + b, x + reach * LEAK);
            sum * (1.0 / 6.0) + SHUTTER_FLOOR
        }));
    }
}

/// The data for the fit of the amplitude a of `V = a gain + exp(e) noise`.
struct Amplitude {
    /// The prior precision of e, the log of the noise's factor.
    precision: f32,
    weight: Vec<f32x4>,
    power: Vec<f32x4>,
    noise: Vec<f32x4>,
}

impl Amplitude {
    /// The most likely ln a and e, and the log-likelihood -sum w (ln V + P / V) at these, with the prior of e.
    fn profiled(&self, gain: &[f32x4], start: Option<[f32; 2]>) -> ([f32; 2], f32) {
        let n = self.power.len();
        let (weight, power, noise, gain) =
            (&self.weight[..n], &self.power[..n], &self.noise[..n], &gain[..n]);
        let dot = |v: &[f32x4]| v.iter().zip(weight).map(|(v, w)| v * w).sum::<f32x4>().reduce_add();
        let [mut log_a, mut e] =
            start.unwrap_or_else(|| [(dot(power) / dot(gain)).max(1e-12).portable_ln(), 0.0]);
        // Fisher scoring needs few steps, since it starts near the solution except for the first value of a table.
        let steps = if start.is_some() { 2 } else { 10 };
        let mut log_likelihood = 0.0;
        for step in 1..=steps {
            let (a, factor) = (log_a.portable_exp(), e.portable_exp());
            let [mut score_a, mut score_e, mut ll] = [f32x4::ZERO; 3];
            let [mut own_a, mut own_e, mut mixed] = [f32x4::ZERO; 3];
            for i in 0..n {
                let signal = a * gain[i];
                let inverse = 1.0 / (signal + factor * noise[i]);
                let (share, ratio) = (signal * inverse, power[i] * inverse);
                let rest = 1.0 - share;
                let (of_share, excess) = (weight[i] * share, weight[i] * (ratio - 1.0));
                score_a += share * excess;
                score_e += rest * excess;
                own_a += of_share * share;
                mixed += of_share * rest;
                own_e += weight[i] * rest * rest;
                // ln V = -ln (1 / V). Only the last step needs the log-likelihood.
                if step == steps {
                    ll += weight[i] * (inverse.ln() - ratio);
                }
            }
            let (score_a, score_e) = (score_a.reduce_add(), score_e.reduce_add() - self.precision * e);
            let (own_a, own_e, mixed) =
                (own_a.reduce_add() + 1e-6, own_e.reduce_add() + self.precision, mixed.reduce_add());
            let left = own_e - mixed * mixed / own_a;
            let change_e = ((score_e - mixed * score_a / own_a) / left).clamp(-0.7, 0.7);
            let change_a = ((score_a - mixed * change_e) / own_a).clamp(-1.5, 1.5);
            // The log-likelihood after the step is predicted as if it were quadratic.
            log_likelihood = ll.reduce_add() - 0.5 * self.precision * e * e
                + 0.5 * (score_a * change_a + score_e * change_e);
            (log_a, e) = ((log_a + change_a).max(-27.0), e + change_e);
        }
        ([log_a, e], log_likelihood)
    }
}

/// A tile's scene without motion blur: an amplitude per ring, the spectrum's dependence on direction, and the noise.
struct RingScene {
    /// The range of each ring in the vectors over bins.
    rings: Vec<Range<usize>>,
    weight: Vec<f32x4>,
    power: Vec<f32x4>,
    noise: Vec<f32x4>,
    /// cos 2 theta and cos 4 theta of the bins.
    harmonics: [Vec<f32x4>; 2],
    /// The log of each ring's amplitude.
    amplitudes: Vec<f32>,
    /// The nuisance parameters c2, c4 and e, the log of the noise's factor.
    nuisances: [f32; 3],
    /// The prior precisions of the nuisance parameters.
    precisions: [f32; 3],
    eliminated: Vec<Eliminated>,
}

/// The score and the information of a ring's log amplitude, and its mixed information with the nuisance parameters.
#[derive(Clone, Copy)]
struct Eliminated {
    score: f32,
    own: f32,
    mixed: [f32; 3],
}

impl RingScene {
    pub(super) fn new(prepared: &Prepared) -> Self {
        let (tile, noise) = (prepared.tile, &prepared.noise);
        let amplitude = |ring: Range<usize>| {
            let sum = |f: &dyn Fn(usize) -> f32| ring.clone().map(f).sum::<f32>();
            let (power, noise) = (sum(&|i| prepared.power[i]), sum(&|i| noise[i]));
            ((power - noise).max(0.01 * power).max(1e-12) / ring.len() as f32).portable_ln()
        };
        let cos2 = tile.column(
            |i| {
                let Bin { along, modulus, .. } = tile.bins[i];
                2.0 * (along / modulus).min(1.0).powi(2) - 1.0
            },
            0.0,
        );
        let cos4 = cos2.iter().map(|c| 2.0 * c * c - 1.0).collect();
        Self {
            rings: tile.ring_lanes().collect(),
            weight: tile.column(|i| tile.bins[i].weight, 0.0),
            power: tile.column(|i| prepared.power[i], 0.0),
            noise: tile.column(|i| noise[i], 1.0),
            harmonics: [cos2, cos4],
            amplitudes: tile.rings().map(amplitude).collect(),
            nuisances: [0.0; 3],
            precisions: [
                1.0 / (TEMPER * DIRECTION[0] * DIRECTION[0]),
                1.0 / (TEMPER * DIRECTION[1] * DIRECTION[1]),
                prepared.noise_precision(&EXPOSURE_NOISE_ERROR),
            ],
            eliminated: vec![],
        }
    }

    /// One step of Fisher scoring in all unknowns at once. The amplitudes are independent of each other, so they are eliminated first.
    /// The result is the log-likelihood after the step, as if it were quadratic, with the nuisance parameters' prior and the amplitudes
    /// integrated over (Laplace's approximation): if noise hides a blurred ring, its amplitude is free, which a maximum would not reward.
    fn improve(&mut self, shutter: &[f32x4]) -> f32 {
        let n = self.power.len();
        let (weight, power, noise, shutter) =
            (&self.weight[..n], &self.power[..n], &self.noise[..n], &shutter[..n]);
        let (cos2, cos4) = (&self.harmonics[0][..n], &self.harmonics[1][..n]);
        let [c2, c4, e] = self.nuisances;
        let factor = e.portable_exp();
        let mut information = [[f32x4::ZERO; 3]; 3];
        let mut score = [f32x4::ZERO; 3];
        let mut log_likelihood = f32x4::ZERO;
        self.eliminated.clear();
        for (ring, &amplitude) in self.rings.iter().zip(&self.amplitudes) {
            let (mut own_score, mut own, mut mixed) = (f32x4::ZERO, f32x4::ZERO, [f32x4::ZERO; 3]);
            for i in ring.clone() {
                let direction = c2 * cos2[i] + c4 * cos4[i];
                let signal = (amplitude + direction).exp() * shutter[i];
                let variance = signal + factor * noise[i];
                let inverse = 1.0 / variance;
                let ratio = power[i] * inverse;
                log_likelihood -= weight[i] * (variance.ln() + ratio);
                let excess = weight[i] * (ratio - 1.0);
                let share = signal * inverse;
                let slopes = [share * cos2[i], share * cos4[i], 1.0 - share];
                own_score += share * excess;
                own += weight[i] * share * share;
                for k in 0..3 {
                    score[k] += slopes[k] * excess;
                    let weighted = weight[i] * slopes[k];
                    mixed[k] += share * weighted;
                    (0..=k).for_each(|j| information[k][j] += weighted * slopes[j]);
                }
            }
            self.eliminated.push(Eliminated {
                score: own_score.reduce_add(),
                own: own.reduce_add() + 1e-6,
                mixed: mixed.map(|v| v.reduce_add()),
            });
        }
        let score: [f32; 3] =
            std::array::from_fn(|k| score[k].reduce_add() - self.precisions[k] * self.nuisances[k]);
        let mut information = information.map(|row| row.map(|v| v.reduce_add()));
        let mut left = score;
        for r in &self.eliminated {
            for k in 0..3 {
                left[k] -= r.mixed[k] * r.score / r.own;
                (0..=k).for_each(|j| information[k][j] -= r.mixed[k] * r.mixed[j] / r.own);
            }
        }
        (0..3).for_each(|k| information[k][k] += self.precisions[k]);
        let prior: f32 = (0..3).map(|k| 0.5 * self.precisions[k] * self.nuisances[k].powi(2)).sum();
        // The step is limited, since a whole step far from the solution may go too far.
        let step = cholesky_solve(information, left).map(|s| s.clamp(-0.7, 0.7));
        let mut gain: f32 = (0..3).map(|k| 0.5 * score[k] * step[k]).sum();
        let mut log_information = 0.0;
        for (r, amplitude) in self.eliminated.iter().zip(&mut self.amplitudes) {
            let explained: f32 = (0..3).map(|k| r.mixed[k] * step[k]).sum();
            let change = ((r.score - explained) / r.own).clamp(-1.5, 1.5);
            *amplitude += change;
            gain += 0.5 * r.score * change;
            log_information += (r.own + AMPLITUDE_PRECISION).portable_ln();
        }
        (0..3).for_each(|k| self.nuisances[k] += step[k]);
        log_likelihood.reduce_add() - prior + gain - 0.5 * CORRELATED * log_information
    }
}

/// Solves `m x = v` for a symmetric positive definite `m`, of which the lower half is given.
fn cholesky_solve(m: [[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    let mut l = [[0.0f32; 3]; 3];
    let mut x = v;
    for i in 0..3 {
        for j in 0..i {
            l[i][j] = (m[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f32>()) / l[j][j];
        }
        l[i][i] = (m[i][i] - (0..i).map(|k| l[i][k] * l[i][k]).sum::<f32>()).max(1e-9).sqrt();
        x[i] = (x[i] - (0..i).map(|k| l[i][k] * x[k]).sum::<f32>()) / l[i][i];
    }
    for i in (0..3).rev() {
        x[i] = (x[i] - (i + 1..3).map(|k| l[k][i] * x[k]).sum::<f32>()) / l[i][i];
    }
    x
}

/// The tiles that `observation` selects, prepared for the likelihood, without those that hold hardly more than noise.
pub(super) fn prepare<'a>(
    frames: &[&'a [Tile]],
    noise: &LumaNoise,
    coding_error: f32,
    observation: impl Fn(&Tile) -> bool,
) -> Vec<Prepared<'a>> {
    let all = frames.iter().enumerate().flat_map(|(f, tiles)| tiles.iter().map(move |t| (f, t)));
    all.filter(|(_, t)| observation(t))
        .filter_map(|(f, t)| Prepared::new(t, f, part_of(f, frames.len()), noise, coding_error))
        .collect()
}

/// A curve blurred by a Gaussian of std `sigma` steps; at the ends the mean is over the part of the Gaussian inside the curve.
pub(super) fn blurred(curve: &[f32], sigma: f32) -> Vec<f32> {
    let weight: Vec<f32> =
        (0..1 + (3.0 * sigma) as usize).map(|i| (-0.5 * (i as f32 / sigma).powi(2)).portable_exp()).collect();
    (0..curve.len())
        .map(|at| {
            let near = at.saturating_sub(weight.len() - 1)..(at + weight.len()).min(curve.len());
            let (mut sum, mut total) = (0.0, 0.0);
            for (i, v) in near.clone().zip(&curve[near]) {
                let w = weight[i.abs_diff(at)];
                sum += w * v;
                total += w;
            }
            (sum / total).max(f32::MIN_POSITIVE)
        })
        .collect()
}

/// The values minus their maximum.
pub(super) fn relative(values: impl Iterator<Item = f32>) -> Vec<f32> {
    let mut v: Vec<f32> = values.collect();
    let max = v.iter().copied().fold(f32::MIN, f32::max);
    v.iter_mut().for_each(|v| *v -= max);
    v
}

/// Cubic (Catmull-Rom) interpolation of equidistant values, with straight extrapolation for the tangents at the ends.
pub(super) fn interpolate(v: &[f32], at: f32) -> f32 {
    let i = (at as usize).min(v.len() - 2);
    let f = (at - i as f32).clamp(0.0, 1.0);
    let (a, b) = (v[i], v[i + 1]);
    let before = if i > 0 { v[i - 1] } else { 2.0 * a - b };
    let after = if i + 2 < v.len() { v[i + 2] } else { 2.0 * b - a };
    let (m0, m1) = (0.5 * (b - before), 0.5 * (after - a));
    let f2 = f * f;
    (2.0 * f2 * f - 3.0 * f2 + 1.0) * a
        + (f2 * f - 2.0 * f2 + f) * m0
        + (3.0 * f2 - 2.0 * f2 * f) * b
        + (f2 * f - f2) * m1
}

/// The std that an index of the tables stands for, px.
pub(super) fn sigma_of(index: usize) -> f32 {
    match index {
        0..=20 => 0.15 * index as f32,
        21..=34 => 3.0 + 0.5 * (index - 20) as f32,
        _ => 10.0 + 2.0 * (index - 34) as f32,
    }
}

/// The index of the tables, with its fraction, that stands for a std in px: the inverse of [`sigma_of`].
pub(super) fn index_of_sigma(sigma: f32) -> f32 {
    let index = if sigma <= 3.0 {
        sigma / 0.15
    } else {
        (20.0 + (sigma - 3.0) / 0.5).min(34.0 + (sigma - 10.0).max(0.0) / 2.0)
    };
    index.clamp(0.0, (SIGMAS - 1) as f32)
}

/// The gain `|K_DoF|^2` of a lens at the index of a std in the tables and at a modulus in cycles per px.
pub(super) type LensGain = fn(usize, f32) -> f32;

/// The mean gain of a lens over the shares of a tile's std (+-20 %) that occur in the tile.
fn mean_in_tile(gain: impl Fn(f32) -> f32) -> f32 {
    (0..9).map(|k| gain(0.8 + 0.05 * k as f32)).sum::<f32>() / 9.0
}

/// The gain `|K_DoF|^2` at a modulus in cycles per px of a Gaussian whose std has index `s < TILE_SIGMAS` in the tables, averaged over the
/// same stds as that of [`lens_gain`].
pub(super) fn gaussian_gain(s: usize, modulus: f32) -> f32 {
    let gain = |scale: f32| {
        let x = std::f32::consts::TAU * sigma_of(s) * scale * modulus;
        (-x * x).portable_exp()
    };
    mean_in_tile(gain) + LENS_FLOOR
}

/// The gain `|K_DoF|^2` at a modulus in [0, 0.5) cycles per px of a uniform disk whose std has index `s < TILE_SIGMAS` in the tables. It is
/// averaged over the radii (+-20 %) that occur in a tile, and linear between multiples of 1/256 cycles per px.
pub fn lens_gain(s: usize, modulus: f32) -> f32 {
    const STEPS: usize = 128;
    static GAINS: OnceLock<Box<[[f32; STEPS]; TILE_SIGMAS]>> = OnceLock::new();
    let gains = GAINS.get_or_init(|| {
        Box::new(std::array::from_fn(|s| {
            std::array::from_fn(|i| {
                let modulus = 0.5 * i as f32 / STEPS as f32;
                let gain = |scale: f32| {
                    // A disk of radius R = 2 sigma has the gain |2 J1(x) / x|^2, x = 2 pi R |w|.
                    let x = std::f32::consts::TAU * 2.0 * sigma_of(s) * scale * modulus + 1e-4;
                    (2.0 * libm::j1f(x) / x).powi(2)
                };
                mean_in_tile(gain)
            })
        }))
    });
    let at = (modulus * 2.0 * STEPS as f32).min(STEPS as f32 - 1.001);
    let (i, f) = (at as usize, at.fract());
    gains[s][i] + f * (gains[s][i + 1] - gains[s][i]) + LENS_FLOOR
}
