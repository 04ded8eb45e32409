//! Blind fit of exposure and defocus: the Whittle likelihood of local spectra.
//!
//! The windowed periodogram P of a tile is compared with `V = S |K_MB|^2 |K_DoF|^2 + n`: S is the spectrum of the sharp
//! scene, `K_MB = sinc(lambda F.w)` the shutter, `K_DoF` the lens at the tile's depth, n the noise, which was measured
//! before. Log-likelihood: `-sum(ln V + P / V)`.
//!
//! Motion blur acts along the flow, defocus alike in all directions, and that separates them:
//! - **lambda**: `S |K_DoF|^2` is any function of the frequency's modulus, one amplitude per ring, integrated over: whatever
//!   is isotropic (the lens, the slope of the scene's spectrum, the pixel's response, sharpening) has no say. It is also any
//!   smooth function of the direction, the same in all rings, under a prior, so that boards or bars have none either: what
//!   remains of motion blur is its zeros, which lie at a distance along the motion, not in a direction. Where a surface moves
//!   differently in two frames, [`pairs()`] tells lambda whatever S is.
//! - **lens**, given lambda: `S = a / |w|^alpha` times a small pixel response, a and the noise's exact power profiled out and alpha
//!   integrated out under a prior of what natural images have.
//!
//! The global unknowns maximise the sum over the tiles of all frames, each tile's loss clipped against outliers.
//! Intervals: bootstrap over blocks of the image and parts of the clip, and a floor for what the models leave out.

mod pairs;

use super::defocus::{self, Lens};
use super::noise::{LumaNoise, MAX_CODING_ERROR, NoiseLine};
use super::{BlurPoint, NOTABLE_CODING_ERROR};
use crate::model::{BlurSpace, Estimate, ExposureFraction, NOISE_LEVELS, Reason, SharpeningModel};
use crate::strips::{STRIP, Strip, strips};
use crate::synth::noise::white_band_std;
use crate::{Encoded, Error, Flow, LUMA, Plane, Raster, Result, Transfer, luma, par};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use std::ops::Range;
use std::sync::{Arc, OnceLock};
use wide::f32x4;

pub use pairs::{Pair, pairs};

/// Side of a tile, px; tiles overlap by half.
pub const TILE: usize = 48;
/// Resolutions at which a frame has tiles, each half the one before.
pub const LEVELS: usize = 4;
/// From the third on only if it has this many px each way.
const COARSE_SIDE: usize = 4 * TILE;
/// At most this many tiles of a frame are observations of the exposure, those of most contrast.
pub const EXPOSURE_TILES: usize = 400;
/// And this many of each block of the image are observations of the lens, again those of most contrast: what has most contrast in the
/// whole image is what is in focus. Of more than [`EXPOSURE_TILES`] the fifth of least contrast is left out.
pub const LENS_TILES_PER_BLOCK: usize = 32;
/// The frequencies looked at, cycles per px: below is the window's leakage, above what resampling, demosaicing and
/// denoising inside the camera have touched.
const BAND: Range<f32> = 0.03..0.35;
/// About their mean.
const MIDDLE: f32 = 0.25;
/// Below this speed, px per frame interval, a tile says nothing about lambda; above the other the flow is not relied on.
pub(super) const SPEEDS: Range<f32> = 1.5..60.0;
/// Largest exposure fraction of the tables: past 1, so that a maximum at 1 is seen from both sides.
const MAX_LAMBDA: f32 = 1.25;
/// An exposure that seems longer is unknown: no shutter is open for so long, so something else looks like its streaks. Of 1, about 1.05
/// may be seen.
pub(super) const LONGEST: f32 = 1.15;
/// Steps of the tables: this length of streak, px, within this range of exposure fractions.
const STREAK_STEP: f32 = 0.6;
const LAMBDA_STEPS: Range<f32> = 0.05..0.125;
/// Exposure fractions of a curve: from 0 in steps of 0.005, to past 1.
pub const EXPOSURES: usize = 251;
pub(super) const EXPOSURE_STEP: f32 = 0.005;
/// Defocus stds of the tables: steps of 0.15 px to 3, of 0.5 px to 10, of 2 px to 40.
pub const SIGMAS: usize = 50;
/// Those of them, px of the tile, that a tile is asked for: to 3.5 px. From there on it does not tell how large a blur is: what the window
/// leaks from frequencies below it is more than what the blur has left.
pub const TILE_SIGMAS: usize = 22;
/// So many nats a tile objects to each px more.
const LARGER_BLUR: f32 = 0.1;
/// Prior of the spectral slope alpha: mean and std, and the values that the integral is taken over.
const ALPHA: (f32, f32) = (2.4, 0.4);
const ALPHAS: usize = 6;
/// Std of the Gaussian that stands for the pixel's own response, px.
const PIXEL_RESPONSE: f32 = 0.5;
/// Power that motion and lens leave at the zeros of their ideal kernels: leakage of the window, motion within a tile.
const SHUTTER_FLOOR: f32 = 1e-3;
const LENS_FLOOR: f32 = 1e-4;
/// A tile's log-likelihood counts this much: neighbouring frequencies are correlated by the window, neighbouring tiles
/// by their overlap, and no scene is exactly what the prior says.
const TEMPER: f32 = 0.15;
/// At most this much, in nats, a tile may object.
pub(super) const CLIP: f32 = 8.0;
/// A tile whose strongest objection to an exposure is this, in nats, counts half of what it says, and one that says less counts less: tiles
/// that hardly see any motion blur may all err to the same side.
const TELLING: f32 = 24.0;
/// The window makes so many neighbouring frequencies one, so the log-likelihood is so many times too large where it is weighed against what a
/// ring's amplitude costs.
const CORRELATED: f32 = 2.25;
/// Prior precision of the log of that amplitude, in the units of the likelihood before it is tempered.
const AMPLITUDE_PRECISION: f32 = 1.0;
/// An exposure whose interval is wider is unknown.
pub(super) const MAX_UNCERTAINTY: f32 = 0.7;
/// Prior stds of what a tile is allowed beside its rings' amplitudes: the scene's log spectrum in cos 2 theta and
/// cos 4 theta, theta from the motion.
const DIRECTION: [f32; 2] = [1.4, 1.0];
/// By how much a tile's noise may be off where the exposure is asked for, and where the lens is: the log of its power (std), and noise
/// that is there unseen (std of luma). A sharp lens leaves little room for noise that is stronger than it was measured.
const EXPOSURE_NOISE_ERROR: NoiseError = NoiseError { log_power: 0.2, unseen: 0.006 };
const LENS_NOISE_ERROR: NoiseError = NoiseError { log_power: 0.1, unseen: 0.002 };
/// Signal over noise below which a tile is left out.
const MIN_CONTRAST: f32 = 3.0;
/// What a tile's texture may add to the apparent length of its streaks, px (std): matters where little moves.
const STREAK_ERROR: f32 = 0.4;
/// Streaks of this length, px, cannot be told from none at all.
const HIDDEN_STREAK: f32 = 1.2;
/// What the models leave out, as stds: of lambda, and relative of sigma at infinity and of the focus's inverse depth.
pub(super) const EXPOSURE_FLOOR: f32 = 0.025;
const LENS_FLOORS: (f32, f32) = (0.08, 0.06);
/// The same of lambda where a coder's errors are as large as they may be.
const CODING_FLOOR: f32 = 0.05;
/// So much of a coder's errors the lens is to be kept from: it needs the fine detail that lambda can do without.
pub const CODING_OF_LENS: f32 = 0.45;
/// Textures that are soft themselves look blurred by a lens, and sharp ones hide blur: so much of it, px (std). Matters where it is small.
const TEXTURE_BLUR: f32 = 0.2;
/// A lens is a candidate of the likeliest one if its loss, in nats, is larger by at most this share. That saves time: what is worse is best on
/// hardly any replica.
const CANDIDATE: f32 = 0.5;
/// A lens needs places whose inverse depths span this share of the largest.
const MIN_DEPTH_SPAN: f32 = 0.2;
/// Tiles whose inverse depths differ by less than this share of the largest mostly show one surface, and what a surface tells grows with its
/// share of all tiles up to one over this number.
const SAME_DEPTH: f32 = 0.03;
const SURFACES: f32 = 25.0;
/// Replicas of the bootstrap for a whole clip.
pub const BOOTSTRAPS: usize = 120;
/// The bootstrap's blocks, per side of the image: tiles of one block show one surface, and err alike.
const BLOCKS: usize = 5;
/// As many blocks.
pub const BLOCK_COUNT: usize = BLOCKS * BLOCKS;
/// And its parts in time, each of which may be another shot.
const PARTS: usize = 8;

/// What one tile of one frame tells.
#[derive(Clone, Debug)]
pub struct Tile {
    /// Which block of the image it lies in, the same in all frames.
    block: u32,
    /// px of the frame that make one of the tile's, in which all else is given.
    scale: f32,
    /// Median speed, px per frame interval; 0 without flow.
    speed: f32,
    /// Median inverse depth; NaN if it is unknown or spans much.
    inverse_depth: f32,
    /// Means of g Y^2, g Y and g, g the [`noise_gain`]: what the noise of the tile follows from.
    noise_moments: [f32; 3],
    /// Whether it is an observation of the exposure, and of the lens.
    of_exposure: bool,
    of_lens: bool,
    bins: Vec<Bin>,
    /// Ends of the rings of like modulus in `bins`.
    rings: Vec<u16>,
}

/// The mean periodogram of frequencies of like modulus and like component along the motion.
#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    weight: f32,
    power: f32,
    along: f32,
    modulus: f32,
}

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

/// The tiles of a frame, given its motion in px per frame interval (NaN: unknown) and inverse depth (NaN: no reading), where known.
/// The motion is best that at the frame's own time ([`motion_at_frame`](crate::analysis::flow::motion_at_frame)).
///
/// # Errors
/// If the sizes differ.
pub fn tiles(
    frame: &Encoded,
    flow: Option<&Flow>,
    inverse_depth: Option<&Plane>,
    space: BlurSpace,
) -> Result<Vec<Tile>> {
    tiles_in_strips(frame, flow, inverse_depth, space, STRIP)
}

/// [`tiles`], found in strips of at most so many pixels.
fn tiles_in_strips(
    frame: &Encoded,
    flow: Option<&Flow>,
    inverse_depth: Option<&Plane>,
    space: BlurSpace,
    most: usize,
) -> Result<Vec<Tile>> {
    let (w, h) = frame.0.size();
    if flow.is_some_and(|f| f.size() != (w, h)) || inverse_depth.is_some_and(|d| d.size() != (w, h)) {
        return Err(Error::new("flow and depth must have the frame's size"));
    }
    let fft = FftPlanner::new().plan_fft_forward(TILE);
    let mut found: [Vec<Tile>; LEVELS] = Default::default();
    for Strip { rows, .. } in strips((w, h), most) {
        // A tile belongs to the strip in which its corner lies.
        let seen = rows.start..(rows.end + (TILE << (LEVELS - 1))).min(h);
        let mut light = Light::of_rows(frame, seen, space);
        // Large blur leaves only frequencies that a tile of 48 px of the frame hardly tells apart.
        for (level, size) in levels((w, h)).enumerate() {
            if level > 0 {
                light = light.halved();
            }
            let mut corners = corners(size);
            corners.retain(|(_, y)| rows.contains(&(y << level)));
            let tiles = par::map(corners.len(), |i| {
                let corner @ (x, y) = corners[i];
                let at = (x, y - (rows.start >> level));
                tile((&light, at), flow, inverse_depth, corner, block_of(corner, size), &fft)
            });
            found[level].extend(tiles.into_iter().flatten());
        }
    }
    let contrast = |t: &Tile| t.bins.iter().map(|b| b.weight * b.power).sum::<f32>();
    let mut ranked: Vec<(f32, Tile)> = found.into_iter().flatten().map(|t| (contrast(&t), t)).collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let enough = (4 * ranked.len() / 5).max(EXPOSURE_TILES);
    let mut of_block = [0; BLOCK_COUNT];
    let tiles = ranked.into_iter().enumerate().map(|(rank, (_, tile))| {
        let rank_in_block = &mut of_block[tile.block as usize];
        *rank_in_block += 1;
        let of_lens = rank < enough && *rank_in_block <= LENS_TILES_PER_BLOCK;
        Tile { of_exposure: rank < EXPOSURE_TILES, of_lens, ..tile }
    });
    Ok(tiles.filter(|t| t.of_exposure || t.of_lens).collect())
}

/// The sizes at which a frame of that size has tiles, each half the one before.
pub fn levels((w, h): (usize, usize)) -> impl Iterator<Item = (usize, usize)> {
    (0..LEVELS)
        .take_while(move |&level| level < 2 || w.min(h) >> level >= COARSE_SIDE)
        .map(move |level| (w >> level, h >> level))
}

/// The corners of a frame's tiles, row by row; of none if it is smaller than one.
pub(super) fn corners((w, h): (usize, usize)) -> Vec<(usize, usize)> {
    if w < TILE || h < TILE {
        return vec![];
    }
    let along = |size: usize| (0..=size - TILE).step_by(TILE / 2);
    along(h).flat_map(|y| along(w).map(move |x| (x, y))).collect()
}

/// The block of the image that a tile lies in.
pub(super) fn block_of((x, y): (usize, usize), (w, h): (usize, usize)) -> u32 {
    (y * BLOCKS / h * BLOCKS + x * BLOCKS / w) as u32
}

/// The tiles at some of the [`corners`] only: no light is computed but theirs.
pub(super) fn tiles_at(
    frame: &Encoded,
    corners: &[(usize, usize)],
    flow: Option<&Flow>,
    inverse_depth: Option<&Plane>,
    space: BlurSpace,
) -> Vec<Tile> {
    let fft = FftPlanner::new().plan_fft_forward(TILE);
    let found = par::map(corners.len(), |i| {
        let corner @ (x, y) = corners[i];
        let light = Light::new(&Encoded(frame.0.crop(x, y, TILE, TILE)), space);
        let block = block_of(corner, frame.0.size());
        tile((&light, (0, 0)), flow, inverse_depth, corner, block, &fft)
    });
    found.into_iter().flatten().collect()
}

/// What is seen of a frame: the light that is blurred, and at every second pixel of the frame each way what
/// [`Tile::noise_moments`] are the means of.
struct Light {
    plane: Plane,
    moments: Raster<[f32; 3]>,
    /// px of the frame that make one of `plane`, each way.
    scale: usize,
}

impl Light {
    fn new(frame: &Encoded, space: BlurSpace) -> Self {
        Self::of_rows(frame, 0..frame.0.height(), space)
    }

    /// Of some rows of a frame.
    fn of_rows(Encoded(frame): &Encoded, rows: Range<usize>, space: BlurSpace) -> Self {
        let (w, h, top) = (frame.width(), rows.len(), rows.start);
        let moments = |of: &(dyn Fn([f32; 3]) -> f32 + Sync)| {
            Raster::from_fn(w / 2, h / 2, |x, y| {
                let p = frame.at(2 * x, top + 2 * y);
                let (y, gain) = (luma(p), of(p));
                [y * y * gain, y * gain, gain]
            })
        };
        let (plane, moments) = match space {
            BlurSpace::Encoded => (frame.map_rows(rows, luma), moments(&|_| 1.0)),
            BlurSpace::Linear => {
                let plane = frame.map_rows(rows, |p| luma(p.map(|v| decoded(v)[0])));
                (plane, moments(&|p| noise_gain(p.map(|v| decoded(v.max(0.02))[1]))))
            }
        };
        Self { plane, moments, scale: 1 }
    }

    /// Of the tile there.
    fn noise_moments(&self, (x0, y0): (usize, usize)) -> [f32; 3] {
        let [x0, y0, side] = [x0, y0, TILE].map(|v| v * self.scale / 2);
        let mut sum = [0.0; 3];
        for p in (y0..y0 + side).flat_map(|y| &self.moments.row(y)[x0..x0 + side]) {
            (0..3).for_each(|k| sum[k] += p[k]);
        }
        sum.map(|v| v / (side * side) as f32)
    }

    /// At half the resolution: means of 2 x 2 px.
    fn halved(self) -> Self {
        let (w, h) = self.plane.size();
        let plane = &self.plane;
        Self {
            plane: Raster::from_fn(w / 2, h / 2, |x, y| {
                let pair = |row: &[f32]| row[2 * x] + row[2 * x + 1];
                0.25 * (pair(plane.row(2 * y)) + pair(plane.row(2 * y + 1)))
            }),
            moments: self.moments,
            scale: 2 * self.scale,
        }
    }
}

/// Variance of the noise of light, weighted as luma is, over that of luma, where the transfer curve has these slopes in R, G and B: for
/// noise that is as strong in all three, and independent.
fn noise_gain(slopes: [f32; 3]) -> f32 {
    let weights = LUMA.map(|w| w * w);
    (0..3).map(|c| weights[c] / (slopes[c] * slopes[c])).sum::<f32>() / weights.iter().sum::<f32>()
}

/// The light of an encoded value, and the slope of the transfer curve there: from a table, which is ten times as fast as powers.
fn decoded(encoded: f32) -> [f32; 2] {
    const STEPS: usize = 1024;
    static TABLE: OnceLock<Vec<[f32; 2]>> = OnceLock::new();
    let exact = |v: f32| {
        let light = Transfer::Srgb.decode(v);
        [light, Transfer::Srgb.slope(light)]
    };
    if !(0.0..1.0).contains(&encoded) {
        return exact(encoded);
    }
    let table = TABLE.get_or_init(|| (0..=STEPS).map(|i| exact(i as f32 / STEPS as f32)).collect());
    let at = encoded * STEPS as f32;
    let (i, t) = (at as usize, at.fract());
    [0, 1].map(|k| table[i][k] + t * (table[i + 1][k] - table[i][k]))
}

/// The tile at a corner, at the resolution of `light`, and where in that it is; `None` if its motion is not one.
fn tile(
    (light, at): (&Light, (usize, usize)),
    flow: Option<&Flow>,
    inverse_depth: Option<&Plane>,
    corner: (usize, usize),
    block: u32,
    fft: &Arc<dyn Fft<f32>>,
) -> Option<Tile> {
    let (speed, motion, _) = match flow {
        Some(flow) => common_motion(flow, corner, light.scale)?,
        None => (0.0, [0.0; 2], 0.0),
    };
    let inverse_depth =
        inverse_depth.and_then(|map| common_depth(map, corner, light.scale)).unwrap_or(f32::NAN);
    let noise_moments = light.noise_moments(at);
    let (bins, rings) = spectrum(&periodogram(fft, &light.plane, at), motion, speed);
    let (of_exposure, of_lens) = (true, true);
    let scale = light.scale as f32;
    Some(Tile { block, scale, speed, inverse_depth, noise_moments, of_exposure, of_lens, bins, rings })
}

/// Every second pixel, each way, of the tile at a corner at so many px of the raster to one of its own.
fn samples<T: Copy + Send + Sync>(
    raster: &Raster<T>,
    (x0, y0): (usize, usize),
    scale: usize,
) -> impl Iterator<Item = T> + '_ {
    let row = move |y: usize| raster.row(scale * y)[scale * x0..].iter().step_by(2 * scale).take(TILE / 2);
    (y0..y0 + TILE).step_by(2).flat_map(row).copied()
}

/// How many those are.
const SAMPLES: usize = TILE * TILE / 4;

/// Speed and motion of a tile, in its px, and its parts' mean deviation from it; `None` if they move differently, too fast, or unknown.
fn common_motion(flow: &Flow, corner: (usize, usize), scale: usize) -> Option<(f32, [f32; 2], f32)> {
    let known: Vec<[f32; 2]> = samples(flow, corner, scale)
        .filter(|f| f[0].is_finite() && f[1].is_finite())
        .map(|f| f.map(|v| v / scale as f32))
        .collect();
    if known.len() < SAMPLES / 2 {
        return None;
    }
    let [Some(u), Some(v)] = [0, 1].map(|c| super::median(known.iter().map(|f| f[c]).collect())) else {
        return None;
    };
    let motion = [u, v];
    let speed = motion[0].hypot(motion[1]);
    // Not hypot, which is slow.
    let length = |x: f32, y: f32| (x * x + y * y).sqrt();
    let deviation =
        known.iter().map(|f| length(f[0] - motion[0], f[1] - motion[1])).sum::<f32>() / known.len() as f32;
    (deviation <= (0.15 * speed).max(0.5) && speed <= SPEEDS.end).then_some((speed, motion, deviation))
}

/// Inverse depth of a tile; `None` if it spans much of it, or is unknown.
fn common_depth(map: &Plane, corner: (usize, usize), scale: usize) -> Option<f32> {
    let mut d: Vec<f32> = samples(map, corner, scale).filter(|d| d.is_finite()).collect();
    if d.len() < SAMPLES / 2 {
        return None;
    }
    d.sort_by(f32::total_cmp);
    let at = |q: f32| d[(q * (d.len() - 1) as f32) as usize];
    (at(0.9) - at(0.1) <= 0.25 * at(0.5).abs()).then_some(at(0.5))
}

/// `|FFT(window (patch - mean))|^2 / TILE^2`, [wx][wy], as far as [`BAND`] goes in x.
fn periodogram(fft: &Arc<dyn Fft<f32>>, light: &Plane, at: (usize, usize)) -> Vec<f32> {
    transform(fft, light, at).iter().map(|c| c.norm_sqr() / (TILE * TILE) as f32).collect()
}

/// `FFT(window (patch - mean))`, likewise.
fn transform(fft: &Arc<dyn Fft<f32>>, light: &Plane, (x0, y0): (usize, usize)) -> Vec<Complex<f32>> {
    let window = hann();
    let row = |y: usize| &light.row(y0 + y)[x0..x0 + TILE];
    let weights: f32 = window.iter().sum::<f32>().powi(2);
    let sum: f32 =
        (0..TILE).map(|y| window[y] * row(y).iter().zip(window).map(|(v, w)| v * w).sum::<f32>()).sum();
    let mean = sum / weights;
    // Two rows of real values make one of complex ones.
    let mut pairs = Vec::with_capacity(TILE * TILE / 2);
    for y in (0..TILE).step_by(2) {
        let (a, b) = (row(y), row(y + 1));
        pairs.extend((0..TILE).map(|x| {
            Complex::new((a[x] - mean) * window[x] * window[y], (b[x] - mean) * window[x] * window[y + 1])
        }));
    }
    let mut scratch = vec![Complex::default(); fft.get_inplace_scratch_len()];
    fft.process_with_scratch(&mut pairs, &mut scratch);
    let mut columns = vec![Complex::default(); COLUMNS * TILE];
    for (pair, row) in pairs.chunks(TILE).enumerate() {
        for i in 0..COLUMNS {
            let (z, mirrored) = (row[i], row[(TILE - i) % TILE].conj());
            columns[i * TILE + 2 * pair] = 0.5 * (z + mirrored);
            columns[i * TILE + 2 * pair + 1] = Complex::new(0.0, -0.5) * (z - mirrored);
        }
    }
    fft.process_with_scratch(&mut columns, &mut scratch);
    columns
}

/// Frequencies in x of a tile's periodogram that are looked at.
pub const COLUMNS: usize = (BAND.end * TILE as f32) as usize + 1;

/// A frequency of a tile's periodogram, cycles per px of the tile.
#[derive(Clone, Copy, Debug)]
pub struct Frequency {
    /// Where it lies in a periodogram: in column x, [`TILE`] values of y each.
    pub at: usize,
    /// Across.
    pub x: f32,
    /// Down.
    pub y: f32,
    /// Of both.
    pub modulus: f32,
    /// The half plane stands for the whole; its first column stands for itself.
    weight: f32,
}

/// The frequencies that are looked at.
pub fn frequencies() -> &'static [Frequency] {
    static FREQUENCIES: OnceLock<Vec<Frequency>> = OnceLock::new();
    FREQUENCIES.get_or_init(|| {
        let all = (0..COLUMNS).flat_map(|i| (0..TILE).map(move |j| (i, j))).map(|(i, j)| {
            let x = i as f32 / TILE as f32;
            let y = if j < TILE / 2 { j as f32 } else { j as f32 - TILE as f32 } / TILE as f32;
            let weight = if i == 0 { 0.5 } else { 1.0 };
            Frequency { at: i * TILE + j, x, y, modulus: x.hypot(y), weight }
        });
        all.filter(|f| BAND.contains(&f.modulus)).collect()
    })
}

/// The periodogram in bins as wide as the window's own resolution, and the ends of the rings of like modulus.
fn spectrum(periodogram: &[f32], motion: [f32; 2], speed: f32) -> (Vec<Bin>, Vec<u16>) {
    let moves = speed >= SPEEDS.start;
    let along_bins = if moves { COLUMNS + 1 } else { 1 };
    let mut bins = vec![Bin::default(); along_bins * COLUMNS];
    let direction = motion.map(|v| v / speed.max(f32::MIN_POSITIVE));
    for f in frequencies() {
        let along = if moves { (f.x * direction[0] + f.y * direction[1]).abs() } else { 0.0 };
        let bin = &mut bins[(along * TILE as f32) as usize + (f.modulus * TILE as f32) as usize * along_bins];
        bin.weight += f.weight;
        bin.power += f.weight * periodogram[f.at];
        bin.along += f.weight * along;
        bin.modulus += f.weight * f.modulus;
    }
    let (mut kept, mut rings) = (vec![], vec![]);
    for ring in bins.chunks(along_bins) {
        let before = kept.len();
        kept.extend(ring.iter().filter(|b| b.weight > 0.0).map(|b| Bin {
            weight: b.weight,
            power: b.power / b.weight,
            along: b.along / b.weight,
            modulus: b.modulus / b.weight,
        }));
        if kept.len() > before {
            rings.push(kept.len() as u16);
        }
    }
    (kept, rings)
}

/// Density of the noise at a modulus in a tile of such [`Tile::noise_moments`] and scale, with [`hidden`] if a coder's errors are of such a std.
fn noise_density(
    moments @ [squares, products, ones]: [f32; 3],
    scale: f32,
    noise: &LumaNoise,
    coding_error: f32,
) -> impl Fn(f32) -> f32 {
    let white = white_band_std();
    // Spectral density of the noise in each level: that of the white noise which has the level's variance.
    let density: [f32; NOISE_LEVELS] = std::array::from_fn(|l| {
        let NoiseLine { slope, intercept } = noise.levels[l];
        let variance =
            slope * slope * squares + 2.0 * slope * intercept * products + intercept * intercept * ones;
        variance.max(0.0) / (white[l] * white[l])
    });
    // A mean of so many pixels has that much less of it.
    let mean = (scale * scale).recip();
    let hidden = hidden(moments, scale, coding_error);
    move |modulus| {
        // Level l holds the frequencies around 0.35 / 2^l cycles per px.
        let level = (0.35 * scale / modulus).log2().clamp(0.0, (NOISE_LEVELS - 1) as f32);
        let i = (level as usize).min(NOISE_LEVELS - 2);
        (mean * (density[i] + (level - i as f32) * (density[i + 1] - density[i]))).max(1e-9) + hidden
    }
}

/// What a coder has taken from a tile and what it has put there is drowned in as much white noise: this density of it, which is added to the
/// tile's power and to its noise.
fn hidden(noise_moments: [f32; 3], scale: f32, coding_error: f32) -> f32 {
    coding_error * coding_error * noise_moments[2] / (scale * scale)
}

/// By how much a tile's noise may be off.
struct NoiseError {
    log_power: f32,
    unseen: f32,
}

/// A tile with its noise, ready for the likelihood.
struct Prepared<'a> {
    tile: &'a Tile,
    frame: usize,
    /// Which part of the clip the frame lies in.
    part: usize,
    /// Power and density of the noise at the bins, with what is [`hidden`].
    power: Vec<f32>,
    noise: Vec<f32>,
    /// Density of white noise of luma of std 1, over that of the tile's noise in the middle of the band.
    white_over_noise: f32,
}

impl<'a> Prepared<'a> {
    /// `None` if the tile holds hardly more than noise.
    fn new(tile: &'a Tile, frame: usize, part: usize, noise: &LumaNoise, coding_error: f32) -> Option<Self> {
        let density = noise_density(tile.noise_moments, tile.scale, noise, coding_error);
        let hidden = hidden(tile.noise_moments, tile.scale, coding_error);
        let noise: Vec<f32> = tile.bins.iter().map(|b| density(b.modulus)).collect();
        let power: Vec<f32> = tile.bins.iter().map(|b| b.power + hidden).collect();
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

    /// Prior precision of the log of the noise's factor, in the units of the likelihood before it is tempered.
    fn noise_precision(&self, error: &NoiseError) -> f32 {
        let log_unseen = (error.unseen * error.unseen * self.white_over_noise).ln_1p();
        (TEMPER * (error.log_power * error.log_power + log_unseen * log_unseen)).recip()
    }

    /// Log-likelihood over lambda in steps of so much, 0 at its maximum, of
    /// `V = amplitude of the ring * exp(c2 cos 2 theta + c4 cos 4 theta) |K_MB|^2 + exp(e) n`; c2, c4 and e at their most likely values, the
    /// amplitudes integrated over.
    fn over_lambda(&self, step: f32) -> Vec<f32> {
        let shutter = Shutter::new(self.tile);
        let mut scene = RingScene::new(self);
        let mut gain = vec![];
        relative((0..=(MAX_LAMBDA / step).round() as usize).map(|l| {
            shutter.gain(l as f32 * step, &mut gain);
            // Starts near the solution except for the first value of a table.
            for _ in 0..if l == 0 { 12 } else { 1 } {
                scene.improve(&gain);
            }
            scene.improve(&gain) * TEMPER
        }))
    }

    /// What the tile objects to the exposures of a curve, in nats, within [-CLIP, 0].
    fn clipped_log_likelihood(&self) -> Vec<f32> {
        let step = (STREAK_STEP / self.tile.speed).clamp(LAMBDA_STEPS.start, LAMBDA_STEPS.end);
        let step = MAX_LAMBDA / (MAX_LAMBDA / step).round();
        let table = self.over_lambda(step);
        let width = STREAK_ERROR / self.tile.speed / EXPOSURE_STEP;
        // A wide blur leaves nothing between so many steps.
        let stride = ((0.25 * width) as usize).clamp(1, 8);
        let at = |i: usize| interpolate(&table, (i * stride) as f32 * EXPOSURE_STEP / step);
        let likelihood: Vec<f32> = (0..=(EXPOSURES - 1).div_ceil(stride)).map(|i| at(i).exp()).collect();
        let blurred: Vec<f32> =
            blurred(&likelihood, width / stride as f32).into_iter().map(f32::ln).collect();
        let curve = (0..EXPOSURES).map(|i| interpolate(&blurred, i as f32 / stride as f32));
        let curve = relative(curve);
        let most = -curve.iter().copied().fold(0.0, f32::min);
        curve.into_iter().map(|v| (v * most / (most + TELLING)).max(-CLIP)).collect()
    }

    /// The same over the stds in px of the frame, as far as the tile tells them.
    fn over_sigma_of_frame(&self, lambda: f32, sharpening: Option<&SharpeningModel>) -> Vec<f32> {
        let table = self.over_sigma(lambda, sharpening);
        let largest = sigma_of(TILE_SIGMAS - 1);
        relative((0..SIGMAS).map(|i| {
            let sigma = sigma_of(i) / self.tile.scale;
            interpolate(&table, index_of_sigma(sigma.min(largest))) - LARGER_BLUR * (sigma - largest).max(0.0)
        }))
    }

    /// Log-likelihood over sigma, 0 at its maximum: one amplitude and the noise's factor at their most likely values, and the slope of the
    /// spectrum integrated out.
    fn over_sigma(&self, lambda: f32, sharpening: Option<&SharpeningModel>) -> Vec<f32> {
        let bins = self.alike(lambda);
        let column = |f: &dyn Fn(&Alike) -> f32| lanes(bins.iter().map(f), 0.0);
        let data = Amplitude {
            precision: self.noise_precision(&LENS_NOISE_ERROR),
            weight: column(&|b| b.weight),
            power: column(&|b| b.power),
            noise: lanes(bins.iter().map(|b| b.noise), 1.0),
        };
        let deviation = |k: usize| 0.8 * (k as f32 - 0.5 * (ALPHAS - 1) as f32);
        let scenes: [Vec<f32x4>; ALPHAS] = std::array::from_fn(|k| {
            let alpha = ALPHA.0 + ALPHA.1 * deviation(k);
            column(&|b| {
                let pixel = std::f32::consts::TAU * PIXEL_RESPONSE / self.tile.scale * b.modulus;
                let sharpened = sharpening.map_or(1.0, |s| s.gain(b.modulus / self.tile.scale).powi(2));
                b.shutter * (b.modulus / 0.2).powf(-alpha) * (-pixel * pixel).exp() * sharpened
            })
        });
        let mut starts = [None; ALPHAS];
        let mut gain = vec![f32x4::ZERO; data.power.len()];
        relative((0..TILE_SIGMAS).map(|s| {
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
            max + terms.iter().map(|v| (v - max).exp()).sum::<f32>().ln()
        }))
    }

    /// The bins at an exposure, neighbours of a ring that motion blur leaves alike taken together.
    fn alike(&self, lambda: f32) -> Vec<Alike> {
        let mut gain = vec![];
        Shutter::new(self.tile).gain(lambda, &mut gain);
        let mut merged: Vec<Alike> = vec![];
        for (ring, lanes) in self.tile.rings().zip(self.tile.ring_lanes()) {
            // The first of those taken together, by which the others are judged.
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

/// A bin, or several, at some exposure.
struct Alike {
    weight: f32,
    power: f32,
    modulus: f32,
    noise: f32,
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

/// Four at a time, the last of them filled up.
fn lanes(values: impl Iterator<Item = f32>, rest: f32) -> Vec<f32x4> {
    let mut values = values.peekable();
    std::iter::from_fn(|| {
        values.peek()?;
        Some(f32x4::from(std::array::from_fn(|_| values.next().unwrap_or(rest))))
    })
    .collect()
}

impl Tile {
    /// The bins of each ring of like modulus.
    fn rings(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        let ends = self.rings.iter().map(|&end| usize::from(end));
        [0].into_iter().chain(ends.clone()).zip(ends).map(|(a, b)| a..b)
    }

    /// Where they lie in a [`Tile::column`].
    fn ring_lanes(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.rings().scan(0, |at, ring| {
            let start = *at;
            *at += ring.len().div_ceil(4);
            Some(start..*at)
        })
    }

    /// Something of each bin, four at a time, the end of each ring filled up.
    fn column(&self, f: impl Fn(usize) -> f32, rest: f32) -> Vec<f32x4> {
        self.rings().flat_map(|ring| lanes(ring.map(&f), rest)).collect()
    }
}

/// What motion blur does to a tile's bins, in the order of [`Tile::column`].
struct Shutter {
    speed: f32,
    along: Vec<f32x4>,
    /// By how much the scene is stronger at the two frequencies beside a bin's along the motion, from which power leaks into it.
    leaks: [Vec<f32x4>; 2],
}

/// Where those lie, cycles per px: three points then have the variance of the Hann window's squared spectrum and of a bin's
/// width, 1/3 + 1/12 squared cycles per tile.
const LEAK: f32 = 1.118 / TILE as f32;

/// How much stronger a scene is at a frequency that lies so far along the motion from one of this component and modulus.
fn slope_gain(along: f32x4, modulus: f32x4, by: f32) -> f32x4 {
    let square = 1.0 + (2.0 * along + by) * by / (modulus * modulus);
    (square.max(f32x4::splat(0.1)).ln() * (-0.5 * ALPHA.0)).exp()
}

impl Shutter {
    fn new(tile: &Tile) -> Self {
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
        let (sin_leak, cos_leak) = (reach * LEAK).sin_cos();
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

/// Data for the amplitude a of `V = a gain + exp(e) noise`.
struct Amplitude {
    /// Of the prior of the log of the noise's factor.
    precision: f32,
    weight: Vec<f32x4>,
    power: Vec<f32x4>,
    noise: Vec<f32x4>,
}

impl Amplitude {
    /// Profiles ln a and the log of the noise's factor out: (the two, the log-likelihood -sum w (ln V + P / V) with the factor's prior).
    fn profiled(&self, gain: &[f32x4], start: Option<[f32; 2]>) -> ([f32; 2], f32) {
        let n = self.power.len();
        let (weight, power, noise, gain) =
            (&self.weight[..n], &self.power[..n], &self.noise[..n], &gain[..n]);
        let dot = |v: &[f32x4]| v.iter().zip(weight).map(|(v, w)| v * w).sum::<f32x4>().reduce_add();
        let [mut log_a, mut e] = start.unwrap_or_else(|| [(dot(power) / dot(gain)).max(1e-12).ln(), 0.0]);
        // Fisher scoring; starts near the solution except for the first value of a table.
        let steps = if start.is_some() { 2 } else { 10 };
        let mut log_likelihood = 0.0;
        for step in 1..=steps {
            let (a, factor) = (log_a.exp(), e.exp());
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
                // ln V = -ln (1 / V), of which the last step alone makes use.
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
            // As it will be after the step, if it is quadratic.
            log_likelihood = ll.reduce_add() - 0.5 * self.precision * e * e
                + 0.5 * (score_a * change_a + score_e * change_e);
            (log_a, e) = ((log_a + change_a).max(-27.0), e + change_e);
        }
        ([log_a, e], log_likelihood)
    }
}

/// What a tile shows but for motion blur: an amplitude per ring, the spectrum's dependence on direction, and the noise.
struct RingScene {
    rings: Vec<Range<usize>>,
    weight: Vec<f32x4>,
    power: Vec<f32x4>,
    noise: Vec<f32x4>,
    /// cos 2 theta and cos 4 theta of the bins.
    harmonics: [Vec<f32x4>; 2],
    /// Logarithms.
    amplitudes: Vec<f32>,
    /// c2, c4 and the log of the noise's factor, and their prior's precisions.
    nuisances: [f32; 3],
    precisions: [f32; 3],
    eliminated: Vec<Eliminated>,
}

/// Of a ring: score and information of its amplitude, and its information with the nuisances.
#[derive(Clone, Copy)]
struct Eliminated {
    score: f32,
    own: f32,
    mixed: [f32; 3],
}

impl RingScene {
    fn new(prepared: &Prepared) -> Self {
        let (tile, noise) = (prepared.tile, &prepared.noise);
        let amplitude = |ring: Range<usize>| {
            let sum = |f: &dyn Fn(usize) -> f32| ring.clone().map(f).sum::<f32>();
            let (power, noise) = (sum(&|i| prepared.power[i]), sum(&|i| noise[i]));
            ((power - noise).max(0.01 * power).max(1e-12) / ring.len() as f32).ln()
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

    /// One step of Fisher scoring in all unknowns at once; a ring's amplitude touches no other's, and is eliminated.
    /// Gives the log-likelihood with the nuisances' prior that the step leads to, if it is quadratic, the amplitudes integrated over
    /// (Laplace's approximation): where blur drowns a ring in noise its amplitude is free, which maximising over it would not reward.
    fn improve(&mut self, shutter: &[f32x4]) -> f32 {
        let n = self.power.len();
        let (weight, power, noise, shutter) =
            (&self.weight[..n], &self.power[..n], &self.noise[..n], &shutter[..n]);
        let (cos2, cos4) = (&self.harmonics[0][..n], &self.harmonics[1][..n]);
        let [c2, c4, e] = self.nuisances;
        let factor = e.exp();
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
        // Far from the solution a whole step may go too far.
        let step = cholesky_solve(information, left).map(|s| s.clamp(-0.7, 0.7));
        let mut gain: f32 = (0..3).map(|k| 0.5 * score[k] * step[k]).sum();
        let mut log_information = 0.0;
        for (r, amplitude) in self.eliminated.iter().zip(&mut self.amplitudes) {
            let explained: f32 = (0..3).map(|k| r.mixed[k] * step[k]).sum();
            let change = ((r.score - explained) / r.own).clamp(-1.5, 1.5);
            *amplitude += change;
            gain += 0.5 * r.score * change;
            log_information += (r.own + AMPLITUDE_PRECISION).ln();
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

/// Of the sum of the observations' [`ExposureObservation::speed`] and of that of its squares: fast ones tell more.
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

/// The tiles that move, as observations of the exposure.
pub(super) fn exposure_observations(frames: &[&[Tile]], noise: &LumaNoise) -> Vec<ExposureObservation> {
    let moving: Vec<Prepared> =
        prepare(frames, noise, noise.coding_error, |t| t.of_exposure && t.speed >= SPEEDS.start);
    par::map(moving.len(), |i| {
        let Prepared { tile, frame, .. } = moving[i];
        let speed = tile.speed * tile.scale;
        ExposureObservation {
            block: tile.block,
            frame,
            speed,
            log_likelihood: moving[i].clipped_log_likelihood(),
        }
    })
}

/// The exposure that the tiles of all frames agree on, and the pairs of each frame with the one before.
///
/// # Errors
/// As [`exposure_of`].
pub fn fit_exposure(
    frames: &[&[Tile]],
    pairs: &[&[Pair]],
    noise: &LumaNoise,
) -> Result<Estimate<ExposureFit>> {
    let mut observations = exposure_observations(frames, noise);
    let of_tiles = exposure_of(&observations, frames.len(), noise.coding_error)?;
    let Estimate::Known(ExposureFit { samples, .. }) = of_tiles else { return Ok(of_tiles) };
    // Pairs sharpen what tiles tell. Where those cannot tell, a few pairs may be sure of anything.
    let pairs: Vec<(usize, &Pair)> =
        pairs.iter().enumerate().flat_map(|(f, pairs)| pairs.iter().map(move |p| (f, p))).collect();
    let of_pairs = par::map(pairs.len(), |i| {
        let (frame, pair) = pairs[i];
        let log_likelihood = pair.clipped_log_likelihood(noise)?;
        Some(ExposureObservation { block: pair.block, frame, speed: pair.speed(), log_likelihood })
    });
    observations.extend(of_pairs.into_iter().flatten());
    if observations.len() == samples {
        return Ok(of_tiles);
    }
    exposure_of(&observations, frames.len(), noise.coding_error)
}

/// The exposure that the observations of so many frames agree on, found with noise of this [`LumaNoise::coding_error`].
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

/// The thin lens that the tiles of all frames agree on, given the exposure (0 if nothing is known of it) and the camera's
/// sharpening, which hides blur.
///
/// # Errors
/// As [`lens_of`].
pub fn fit_lens(
    frames: &[&[Tile]],
    noise: &LumaNoise,
    exposure: ExposureFraction,
    sharpening: Option<&SharpeningModel>,
) -> Result<Estimate<LensFit>> {
    lens_of(&lens_observations(frames, noise, exposure, sharpening), BOOTSTRAPS)
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

/// The tiles whose depth is known, as observations of the lens.
pub(super) fn lens_observations(
    frames: &[&[Tile]],
    noise: &LumaNoise,
    exposure: ExposureFraction,
    sharpening: Option<&SharpeningModel>,
) -> Vec<LensObservation> {
    let prepared: Vec<Prepared> = prepare(frames, noise, CODING_OF_LENS * noise.coding_error, |t| {
        t.of_lens && t.inverse_depth.is_finite()
    });
    par::map(prepared.len(), |i| LensObservation {
        inverse_depth: prepared[i].tile.inverse_depth,
        table: prepared[i].over_sigma_of_frame(exposure.0, sharpening),
        tiles: 1.0,
        block: prepared[i].tile.block,
        part: prepared[i].part,
    })
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
fn surface_weights(observations: &[LensObservation]) -> Vec<f32> {
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

fn prepare<'a>(
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

/// The part of the clip that a frame of so many lies in.
fn part_of(frame: usize, frames: usize) -> usize {
    frame * PARTS.min(frames) / frames.max(1)
}

/// Weight of a block's tiles in one part of the clip in a replica of the bootstrap: exponential ones of mean 1 (Rubin 1981) of
/// the block and of the part. What only one surface or one shot says thus counts as one observation.
fn resampled(replica: usize, block: u32, part: usize) -> f32 {
    let weight = |i: u64| -(1.0 - super::uniform(replica as u64, i)).ln();
    weight(u64::from(block)) * weight((BLOCKS * BLOCKS + part) as u64)
}

/// 95 %: the replicas' scatter around the estimate and a floor, >= 0.
fn interval(estimate: f32, replicas: &[f32], floor: f32) -> [f32; 2] {
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

/// A curve's mean under a Gaussian of std `sigma` steps, as far as the curve goes.
fn blurred(curve: &[f32], sigma: f32) -> Vec<f32> {
    let weight: Vec<f32> =
        (0..1 + (3.0 * sigma) as usize).map(|i| (-0.5 * (i as f32 / sigma).powi(2)).exp()).collect();
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

/// Minus the maximum.
pub(super) fn relative(values: impl Iterator<Item = f32>) -> Vec<f32> {
    let mut v: Vec<f32> = values.collect();
    let max = v.iter().copied().fold(f32::MIN, f32::max);
    v.iter_mut().for_each(|v| *v -= max);
    v
}

/// Cubic (Catmull-Rom) interpolation of equidistant values; the ends continue in a straight line.
fn interpolate(v: &[f32], at: f32) -> f32 {
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

fn index_of_sigma(sigma: f32) -> f32 {
    let index = if sigma <= 3.0 {
        sigma / 0.15
    } else {
        (20.0 + (sigma - 3.0) / 0.5).min(34.0 + (sigma - 10.0).max(0.0) / 2.0)
    };
    index.clamp(0.0, (SIGMAS - 1) as f32)
}

/// The window of a tile, each way: Hann's, of mean square 1.
pub fn hann() -> &'static [f32; TILE] {
    static WINDOW: OnceLock<[f32; TILE]> = OnceLock::new();
    WINDOW.get_or_init(|| {
        let angle = |i: usize| std::f32::consts::TAU * (i as f32 + 1.0) / (TILE as f32 + 1.0);
        let w: [f32; TILE] = std::array::from_fn(|i| 0.5 - 0.5 * angle(i).cos());
        let rms = (w.iter().map(|v| v * v).sum::<f32>() / TILE as f32).sqrt();
        w.map(|v| v / rms)
    })
}

/// `|K_DoF|^2` at a modulus in [0, 0.5) cycles per px, of a uniform disk of the std of index `s < TILE_SIGMAS` of the tables, averaged over
/// the radii (+-20 %) that occur in a tile: in straight lines between multiples of 1/256 cycles per px.
pub fn lens_gain(s: usize, modulus: f32) -> f32 {
    const STEPS: usize = 128;
    static GAINS: OnceLock<Box<[[f32; STEPS]; TILE_SIGMAS]>> = OnceLock::new();
    let gains = GAINS.get_or_init(|| {
        Box::new(std::array::from_fn(|s| {
            std::array::from_fn(|i| {
                let modulus = 0.5 * i as f32 / STEPS as f32;
                let gain = |scale: f32| {
                    // Radius 2 sigma: |2 J1(x) / x|^2, x = 2 pi R |w|.
                    let x = std::f32::consts::TAU * 2.0 * sigma_of(s) * scale * modulus + 1e-4;
                    (2.0 * libm::j1f(x) / x).powi(2)
                };
                (0..9).map(|k| gain(0.8 + 0.05 * k as f32)).sum::<f32>() / 9.0
            })
        }))
    });
    let at = (modulus * 2.0 * STEPS as f32).min(STEPS as f32 - 1.001);
    let (i, f) = (at as usize, at.fract());
    gains[s][i] + f * (gains[s][i + 1] - gains[s][i]) + LENS_FLOOR
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_of_coloured_light_is_what_that_of_luma_predicts() {
        const COLOUR: [f32; 3] = [0.85, 0.35, 0.2];
        const STD: f32 = 0.01;
        let side = 8 * TILE;
        let normal = crate::fit::noise::tests::white(side, side, 0);
        let frame = Encoded(Raster::from_fn(side, side, |x, y| {
            let n = normal.at(x, y);
            std::array::from_fn(|c| COLOUR[c] + STD * n[c])
        }));
        let std = STD * LUMA.iter().map(|w| w * w).sum::<f32>().sqrt();
        let levels = white_band_std().map(|white| NoiseLine { slope: 0.0, intercept: std * white });
        let noise = LumaNoise { levels, coding_error: 0.0 };
        for space in [BlurSpace::Linear, BlurSpace::Encoded] {
            let tiles = tiles(&frame, None, None, space).unwrap();
            // Mean power over what is predicted, as a tile of this colour and as a grey one.
            let over = |moments: &dyn Fn(&Tile) -> [f32; 3]| {
                let (mut power, mut predicted) = (0.0, 0.0);
                for tile in &tiles {
                    let density = noise_density(moments(tile), tile.scale, &noise, 0.0);
                    power += tile.bins.iter().map(|b| b.weight * b.power).sum::<f32>();
                    predicted += tile.bins.iter().map(|b| b.weight * density(b.modulus)).sum::<f32>();
                }
                power / predicted
            };
            let own = over(&|tile| tile.noise_moments);
            assert!((own - 1.0).abs() < 0.03, "{space:?}: {own}");
            let grey = Encoded(frame.0.map(|p| [luma(p); 3]));
            let of_grey = Light::new(&grey, space).noise_moments((0, 0));
            let other = over(&|_| of_grey);
            assert_eq!((other - 1.0).abs() > 0.1, space == BlurSpace::Linear, "{space:?}: {other}");
        }
    }

    #[test]
    fn strips_give_the_tiles_of_the_whole_frame() {
        let (w, h) = (770, 807);
        let noise = crate::fit::noise::tests::white(w, h, 1);
        let frame = Encoded(Raster::from_fn(w, h, |x, y| {
            noise.at(x, y).map(|n| 0.3 + 0.3 * ((x / 37 + y / 43) % 2) as f32 + 0.02 * n)
        }));
        let flow = Flow::from_fn(w, h, |_, y| [4.0 + 0.002 * y as f32, 1.0]);
        let depth = Plane::from_fn(w, h, |x, y| 0.3 + 0.0001 * (x + y) as f32);
        for space in [BlurSpace::Linear, BlurSpace::Encoded] {
            let found = |most: usize| {
                let tiles = tiles_in_strips(&frame, Some(&flow), Some(&depth), space, most).unwrap();
                assert_eq!(tiles.iter().map(|t| t.scale as usize).max(), Some(4));
                format!("{tiles:?}")
            };
            let whole = found(w * h);
            for rows in [32, 224, 800] {
                assert!(found(rows * w) == whole, "{rows} rows");
            }
        }
    }

    #[test]
    fn surfaces_that_disagree_about_the_lens_leave_it_unknown() {
        let lenses = [Lens { slope: 4.0, focus: 0.2 }, Lens { slope: 4.0, focus: 0.8 }];
        let observation = |i: usize, lens: &Lens| {
            let inverse_depth = 0.1 + 0.8 * (i / BLOCK_COUNT) as f32 / 9.0;
            let objection =
                |s: usize| (-20.0 * (sigma_of(s) - lens.sigma_px(inverse_depth)).powi(2)).max(-CLIP);
            let table = (0..SIGMAS).map(objection).collect();
            LensObservation { inverse_depth, table, tiles: 1.0, block: (i % BLOCK_COUNT) as u32, part: 0 }
        };
        let fit = |of_block: &dyn Fn(usize) -> usize| {
            let observations: Vec<LensObservation> =
                (0..250).map(|i| observation(i, &lenses[of_block(i % BLOCK_COUNT)])).collect();
            lens_of(&observations, BOOTSTRAPS)
        };
        let agreed = fit(&|_| 0).unwrap().into_known().expect("all surfaces agree");
        let [low, high] = agreed.focus_inverse_depth;
        assert!((low..high).contains(&lenses[0].focus) && high < 0.5 * lenses[1].focus, "{agreed:?}");
        let disagreed = fit(&|block| block % 2).unwrap();
        assert_eq!(disagreed.why_unknown().expect("they do not").reason, Reason::Uncertain);
    }

    #[test]
    fn a_soft_wall_does_not_outvote_all_that_stands_before_it() {
        // Most tiles are of a far wall that looks blurred; what stands before it, down to the wall, is sharp.
        let observation = |i: usize, inverse_depth: f32, blur: f32| LensObservation {
            inverse_depth,
            table: (0..SIGMAS).map(|s| (-4.0 * (sigma_of(s) - blur).powi(2)).max(-CLIP)).collect(),
            tiles: 1.0,
            block: (i % BLOCK_COUNT) as u32,
            part: 0,
        };
        let wall = (0..150).map(|i| observation(i, 0.1, 0.8));
        let things = (0..100).map(|i| observation(i, 0.11 + 0.008 * i as f32, 0.0));
        let observations: Vec<LensObservation> = wall.chain(things).collect();
        let tables = FineTables::new(&observations);
        let lens = |log_likelihood: &(dyn Fn(Lens) -> f32 + Sync)| {
            defocus::best_lens(lens_range(&observations), log_likelihood)
        };
        let weighted = lens(&|l| tables.log_likelihood(l, None)).sigma_px(0.1);
        // Negative control: one observation, one vote.
        let undo: Vec<f32> = surface_weights(&observations).iter().map(|w| 1.0 / w).collect();
        let plain = lens(&|l| tables.log_likelihood(l, Some(&undo))).sigma_px(0.1);
        assert!(weighted < 0.4 && plain > 0.6, "{weighted} {plain}");
    }

    #[test]
    fn weak_noise_is_known_less_exactly_than_strong_noise() {
        let side = 4 * TILE;
        let frame =
            Encoded(Raster::from_fn(side, side, |x, y| [0.3 + 0.2 * ((x / 5 + y / 7) % 2) as f32; 3]));
        let tiles = tiles(&frame, None, None, BlurSpace::Linear).unwrap();
        let std_of_factor = |std: f32, scale: f32| {
            let levels = white_band_std().map(|white| NoiseLine { slope: 0.0, intercept: std * white });
            let noise = LumaNoise { levels, coding_error: 0.0 };
            let tile = tiles.iter().find(|t| t.scale == scale).expect("both scales");
            let prepared = Prepared::new(tile, 0, 0, &noise, 0.0).expect("it has contrast");
            (TEMPER * prepared.noise_precision(&EXPOSURE_NOISE_ERROR)).powf(-0.5)
        };
        for scale in [1.0, 2.0] {
            let [strong, weak] = [0.06, 0.001].map(|std| std_of_factor(std, scale));
            assert!((0.2..0.203).contains(&strong) && weak > 10.0 * strong, "{strong} {weak}");
        }
    }
}
