//! The tiles of frames: their places and their spectra.

use super::fourier::{self, Complex4};
use super::noise::LumaNoise;
use super::noise::NoiseLine;
use super::robust::median;
use crate::model::{BlurSpace, NOISE_LEVELS, Space};
use crate::portable::Portable;
use crate::strips::{STRIP, Strip, strips};
use crate::synth::noise::white_band_std;
use crate::{Encoded, Error, Flow, LUMA, Plane, Raster, Result, Transfer, luma, par};
use std::ops::Range;
use std::sync::OnceLock;
use wide::f32x4;

/// The side of a tile, px. Tiles overlap by half.
pub const TILE: usize = 48;

/// The number of resolutions at which a frame has tiles, each half the one before.
pub const LEVELS: usize = 4;

/// The least width and height, px, that a frame must have at its third or fourth resolution to have tiles at that resolution.
const COARSE_SIDE: usize = 4 * TILE;

/// The most tiles of a frame that are observations of the exposure; those of most contrast are taken.
pub const EXPOSURE_TILES: usize = 400;

/// The most tiles of each block of the image that are observations of the lens; those of most contrast are taken, block by block, since
/// the tiles of most contrast in the whole image are those in focus. If a frame has more than [`EXPOSURE_TILES`] tiles, the fifth of
/// least contrast is left out.
pub const LENS_TILES_PER_BLOCK: usize = 32;

/// The frequencies that are used, cycles per px. Lower frequencies hold the window's leakage, and higher ones are altered by resampling,
/// demosaicing and denoising inside the camera.
pub(super) const BAND: Range<f32> = 0.03..0.35;

/// The most tiles of each block of the image, at each resolution, whose spectra are computed: those in which neighbouring pixels differ
/// most. No block of a frame of 960 x 720 px has more.
const SEARCHED_PER_BLOCK: usize = 56;

/// A frequency in the middle of the band, cycles per px, that stands for the band where the strength of a tile's noise is needed.
pub const MIDDLE: f32 = 0.25;

/// The speeds at which a tile tells the exposure, px per frame interval. A slower tile shows no streak, and the flow of a faster one is
/// not relied on.
pub const SPEEDS: Range<f32> = 1.5..60.0;

/// The ratio of signal to noise below which a tile is left out.
pub const MIN_CONTRAST: f32 = 3.0;

/// The number of the bootstrap's blocks along each side of the image. Tiles of one block show one surface and err alike.
pub const BLOCKS: usize = 5;

/// The number of the bootstrap's blocks.
pub const BLOCK_COUNT: usize = BLOCKS * BLOCKS;

/// The spectrum of one tile of one frame, with its motion, depth and noise.
#[derive(Clone, Debug)]
pub struct Tile {
    /// The number of the image's block that the tile lies in, < [`BLOCK_COUNT`], the same in all frames.
    pub(super) block: u32,
    /// The number of px of the frame, each way, that make one px of the tile. All other fields are in px of the tile.
    pub(super) scale: f32,
    /// The median speed, px per frame interval; 0 without flow.
    pub(super) speed: f32,
    /// The relative std of what the speed at the frame's own time may differ from that.
    pub(super) speed_error: f32,
    /// The median inverse depth; NaN if it is unknown or spans much.
    pub(super) inverse_depth: f32,
    /// The means of g Y^2, g Y and g over the tile, with luminance Y and [`noise_gain`] g, from which the variance of its noise follows.
    pub(super) noise_moments: [f32; 3],
    /// Whether the tile is an observation of the exposure.
    pub(super) of_exposure: bool,
    /// Whether the tile is an observation of the lens.
    pub(super) of_lens: bool,
    /// The periodogram in bins, ring by ring.
    pub(super) bins: Vec<Bin>,
    /// The index in `bins` at which each ring of like modulus ends.
    pub(super) rings: Vec<u16>,
}

/// The mean periodogram of frequencies of like modulus and like component along the motion.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Bin {
    /// The sum of the weights of the bin's frequencies.
    pub(super) weight: f32,
    /// The mean of the periodogram over the bin.
    pub(super) power: f32,
    /// The mean component along the motion, without its sign, cycles per px.
    pub(super) along: f32,
    /// The mean modulus, cycles per px.
    pub(super) modulus: f32,
}

/// The tiles of a frame, given its motion in px per frame interval (NaN: unknown) and its inverse depth (NaN: no reading), if known.
/// The motion should be that at the frame's own time ([`motion_at_frame`](crate::analysis::flow::motion_at_frame)).
///
/// # Errors
/// If the sizes differ.
pub fn tiles(
    frame: &Encoded,
    flow: Option<&Flow>,
    inverse_depth: Option<&Plane>,
    space: Space,
) -> Result<Vec<Tile>> {
    tiles_in_strips(frame, flow, inverse_depth, space, STRIP)
}

/// [`tiles`], found in strips of at most `most` pixels each.
pub(super) fn tiles_in_strips(
    frame: &Encoded,
    flow: Option<&Flow>,
    inverse_depth: Option<&Plane>,
    space: Space,
    most: usize,
) -> Result<Vec<Tile>> {
    let (w, h) = frame.0.size();
    if flow.is_some_and(|f| f.size() != (w, h)) || inverse_depth.is_some_and(|d| d.size() != (w, h)) {
        return Err(Error::new("flow and depth must have the frame's size"));
    }
    let searched: Vec<Vec<(usize, usize)>> = levels((w, h))
        .enumerate()
        .map(|(level, size)| searched_corners(frame, size, 1 << level, space))
        .collect();
    let of_flow = flow.map(|flow| move |x: usize, y: usize| flow.at(x, y));
    let motion = of_flow.as_ref().map(|of| of as &MotionOf);
    let mut found: [Vec<Tile>; LEVELS] = Default::default();
    for Strip { rows, .. } in strips((w, h), most) {
        // A tile belongs to the strip in which its corner lies.
        let seen = rows.start..(rows.end + (TILE << (LEVELS - 1))).min(h);
        let mut light = Light::of_rows(frame, seen, space);
        // Coarser levels are needed since large blur leaves only frequencies that a tile of 48 px of the frame hardly resolves.
        for (level, size) in levels((w, h)).enumerate() {
            if level > 0 {
                light = light.halved();
            }
            let mut corners = searched[level].clone();
            corners.retain(|(_, y)| rows.contains(&(y << level)));
            let tiles = par::map(corners.len(), |i| {
                let corner @ (x, y) = corners[i];
                let at = (x, y - (rows.start >> level));
                tile((&light, at), motion, inverse_depth, corner, block_of(corner, size))
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

/// The sizes, px, at which a frame of w x h px has tiles, each half the one before.
pub fn levels((w, h): (usize, usize)) -> impl Iterator<Item = (usize, usize)> {
    (0..LEVELS)
        .take_while(move |&level| level < 2 || w.min(h) >> level >= COARSE_SIDE)
        .map(move |level| (w >> level, h >> level))
}

/// The corners of a frame's tiles, row by row; empty if the frame is smaller than a tile.
pub(super) fn corners((w, h): (usize, usize)) -> Vec<(usize, usize)> {
    if w < TILE || h < TILE {
        return vec![];
    }
    let along = |size: usize| (0..=size - TILE).step_by(TILE / 2);
    along(h).flat_map(|y| along(w).map(move |x| (x, y))).collect()
}

/// The [`corners`] in this turn: about `about` of them, spread over the frame, others in the next turn.
pub(super) fn corners_in_turn(
    size: (usize, usize),
    turn: usize,
    about: usize,
) -> impl Iterator<Item = (usize, usize)> {
    let all = corners(size);
    let turns = (all.len() / about).max(1);
    all.into_iter().skip(turn % turns).step_by(turns)
}

/// The [`corners`] of a frame at the resolution of `size`, at which `scale` px of the frame make one. In blocks of many tiles, those of
/// least contrast are left out.
fn searched_corners(
    frame: &Encoded,
    size: (usize, usize),
    scale: usize,
    space: Space,
) -> Vec<(usize, usize)> {
    let mut of_block = vec![vec![]; BLOCK_COUNT];
    let all = corners(size);
    for (i, corner) in all.iter().enumerate() {
        of_block[block_of(*corner, size) as usize].push(i);
    }
    let decoder = Decoder::new(space.transfer);
    let contrast = |i: usize| match (space.blur, space.transfer) {
        // The square is nearly the light.
        (BlurSpace::Linear, Transfer::Srgb) => contrast(frame, all[i], scale, |v| v * v),
        (BlurSpace::Linear, _) => contrast(frame, all[i], scale, |v| decoder.look_up(v, 0)),
        (BlurSpace::Encoded, _) => contrast(frame, all[i], scale, |v| v),
    };
    let chosen = par::map(BLOCK_COUNT, |block| {
        let places = &of_block[block];
        if places.len() <= SEARCHED_PER_BLOCK {
            return places.clone();
        }
        let mut ranked: Vec<(f32, usize)> = places.iter().map(|&i| (contrast(i), i)).collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        ranked.into_iter().take(SEARCHED_PER_BLOCK).map(|(_, i)| i).collect()
    });
    let mut chosen: Vec<usize> = chosen.into_iter().flatten().collect();
    chosen.sort_unstable();
    chosen.into_iter().map(|i| all[i]).collect()
}

/// How much neighbouring pixels of a tile differ in green, of which `of` is taken: a sum of squares.
pub(super) fn contrast(
    frame: &Encoded,
    (x0, y0): (usize, usize),
    scale: usize,
    of: impl Fn(f32) -> f32,
) -> f32 {
    let step = 4 * scale;
    let [columns, rows] = [x0, y0].map(|v| scale * v..scale * (v + TILE) - step);
    let square = |v: f32| v * v;
    let green = |x: usize, y: usize| of(frame.0.at(x, y)[1]);
    let places = rows.step_by(step).flat_map(|y| columns.clone().step_by(step).map(move |x| (x, y)));
    places
        .map(|(x, y)| square(green(x + step, y) - green(x, y)) + square(green(x, y + step) - green(x, y)))
        .sum()
}

/// The block of an image of w x h px that a tile with its corner at (x, y) lies in.
pub(super) fn block_of((x, y): (usize, usize), (w, h): (usize, usize)) -> u32 {
    (y * BLOCKS / h * BLOCKS + x * BLOCKS / w) as u32
}

/// The corners, at most `most`, of the tiles of most contrast among those that move fast enough or have a known depth. `scale` px of the frame
/// make one px of the tiles.
pub(super) fn of_most_contrast(
    frame: &Encoded,
    corners: impl Iterator<Item = (usize, usize)>,
    scale: usize,
    motion: Option<&MotionOf>,
    depth: Option<&Plane>,
    most: usize,
) -> Vec<(usize, usize)> {
    let tells = |&(x, y): &(usize, usize)| {
        let (x, y) = (scale * (x + TILE / 2), scale * (y + TILE / 2));
        let moves = motion.map(|of| of(x, y)).is_some_and(|[u, v]| u.portable_hypot(v) >= SPEEDS.start);
        moves || depth.is_some_and(|d| d.at(x, y).is_finite())
    };
    let mut tried: Vec<_> =
        corners.filter(tells).map(|c| (contrast(frame, c, scale, |v| v), c)).filter(|t| t.0 >= 0.0).collect();
    tried.sort_by(|a, b| b.0.total_cmp(&a.0));
    tried.into_iter().take(most).map(|t| t.1).collect()
}

/// The tiles at some of the [`corners`] only, so that light is computed for these alone. `scale` px of the frame, a power of two, make one px of
/// the tiles.
pub(super) fn tiles_at(
    frame: &Encoded,
    corners: &[(usize, usize)],
    scale: usize,
    motion: Option<&MotionOf>,
    inverse_depth: Option<&Plane>,
    space: Space,
) -> Vec<Tile> {
    let found = par::map(corners.len(), |i| {
        let (corner, side) = (corners[i], scale * TILE);
        let (x, y) = (scale * corner.0, scale * corner.1);
        let light = Light::new(&Encoded(frame.0.crop(x, y, side, side)), space);
        let light = (0..scale.ilog2()).fold(light, |light, _| light.halved());
        tile((&light, (0, 0)), motion, inverse_depth, corner, block_of((x, y), frame.0.size()))
    });
    found.into_iter().flatten().collect()
}

/// The light of a frame that is blurred, and the values whose means are [`Tile::noise_moments`].
pub(super) struct Light {
    /// The light, or encoded values, with luma's weights of R, G and B.
    pub(super) plane: Plane,
    /// The values g Y^2, g Y and g at every second pixel of the frame each way.
    moments: Raster<[f32; 3]>,
    /// The number of px of the frame, each way, that make one px of `plane`.
    scale: usize,
}

impl Light {
    pub(super) fn new(frame: &Encoded, space: Space) -> Self {
        Self::of_rows(frame, 0..frame.0.height(), space)
    }

    /// The light of some rows of a frame.
    fn of_rows(Encoded(frame): &Encoded, rows: Range<usize>, space: Space) -> Self {
        let (w, h, top) = (frame.width(), rows.len(), rows.start);
        let moments = |of: &(dyn Fn([f32; 3]) -> f32 + Sync)| {
            Raster::from_fn(w / 2, h / 2, |x, y| {
                let p = frame.at(2 * x, top + 2 * y);
                let (y, gain) = (luma(p), of(p));
                [y * y * gain, y * gain, gain]
            })
        };
        let (plane, moments) = match space.blur {
            BlurSpace::Encoded => (frame.map_rows(rows, luma), moments(&|_| 1.0)),
            BlurSpace::Linear => {
                let decoder = Decoder::new(space.transfer);
                let plane = frame.map_rows(rows, |[r, g, b]| {
                    luma([decoder.look_up(r, 0), decoder.look_up(g, 0), decoder.look_up(b, 0)])
                });
                let slope = |v: f32| decoder.look_up(v.max(0.02), 1);
                (plane, moments(&|[r, g, b]| noise_gain([slope(r), slope(g), slope(b)])))
            }
        };
        Self { plane, moments, scale: 1 }
    }

    /// The [`Tile::noise_moments`] of the tile whose corner lies at (x0, y0) of `plane`.
    pub(super) fn noise_moments(&self, (x0, y0): (usize, usize)) -> [f32; 3] {
        let [x0, y0, side] = [x0, y0, TILE].map(|v| v * self.scale / 2);
        let mut sum = [0.0; 3];
        for p in (y0..y0 + side).flat_map(|y| &self.moments.row(y)[x0..x0 + side]) {
            (0..3).for_each(|k| sum[k] += p[k]);
        }
        sum.map(|v| v / (side * side) as f32)
    }

    /// The frame at half the resolution: means of 2 x 2 px.
    pub(super) fn halved(self) -> Self {
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

/// The variance of the noise of light with luma's weights, over the variance of luma's noise, where the transfer curve has these slopes
/// in R, G and B. The noise is taken to be independent and equally strong in all three.
fn noise_gain(slopes: [f32; 3]) -> f32 {
    let weights = LUMA.map(|w| w * w);
    (0..3).map(|c| weights[c] / (slopes[c] * slopes[c])).sum::<f32>() / weights.iter().sum::<f32>()
}

/// The light of encoded values, and the slope of the transfer curve there: from a table, which is ten times as fast as powers.
struct Decoder {
    transfer: Transfer,
    table: &'static [[f32; 2]],
}

impl Decoder {
    fn new(transfer: Transfer) -> Self {
        static TABLES: [OnceLock<Vec<[f32; 2]>>; Transfer::ALL.len()] =
            [const { OnceLock::new() }; Transfer::ALL.len()];
        // What is encoded as 1 has a neighbour above it, too.
        let of_all = || (0..=STEPS + 1).map(|i| exact(transfer, i as f32 / STEPS as f32)).collect();
        Self { transfer, table: TABLES[transfer as usize].get_or_init(of_all) }
    }

    /// The light (0) or the slope (1) at an encoded value.
    #[inline(always)]
    fn look_up(&self, encoded: f32, of: usize) -> f32 {
        if !(0.0..=1.0).contains(&encoded) {
            return exact(self.transfer, encoded)[of];
        }
        let at = encoded * STEPS as f32;
        let i = at as usize;
        let t = at - i as f32;
        let (low, high) = (self.table[i][of], self.table[i + 1][of]);
        low + t * (high - low)
    }
}

/// Steps of the [`Decoder`]'s table.
const STEPS: usize = 1024;

#[cold]
fn exact(transfer: Transfer, encoded: f32) -> [f32; 2] {
    let light = transfer.decode_by(encoded, Portable::portable_powf);
    [light, transfer.slope_by(light, Portable::portable_powf)]
}

/// The tile at a corner in px of `light`'s resolution; `at` is the same corner within `light`. `None` if its parts move differently, too
/// fast, or unknown.
pub(super) fn tile(
    (light, at): (&Light, (usize, usize)),
    motion: Option<&MotionOf>,
    inverse_depth: Option<&Plane>,
    corner: (usize, usize),
    block: u32,
) -> Option<Tile> {
    let (speed, motion, _) = match motion {
        Some(of) => common_motion(of, corner, light.scale)?,
        None => (0.0, [0.0; 2], 0.0),
    };
    let inverse_depth =
        inverse_depth.and_then(|map| common_depth(map, corner, light.scale)).unwrap_or(f32::NAN);
    let noise_moments = light.noise_moments(at);
    let (bins, rings) = spectrum(&periodogram(&light.plane, at), motion, speed);
    let (of_exposure, of_lens) = (true, true);
    let scale = light.scale as f32;
    let speed_error = 0.0;
    Some(Tile {
        block,
        scale,
        speed,
        speed_error,
        inverse_depth,
        noise_moments,
        of_exposure,
        of_lens,
        bins,
        rings,
    })
}

/// The moving tiles at some of the [`corners`], each with its motion turned by each of these angles, in radians.
pub(super) fn turned_tiles(
    frame: &Encoded,
    corners: &[(usize, usize)],
    motion: &MotionOf,
    angles: &[f32],
    space: Space,
) -> Vec<Vec<Tile>> {
    let found = par::map(corners.len(), |i| {
        let corner @ (x, y) = corners[i];
        let (speed, motion, _) = common_motion(motion, corner, 1)?;
        if speed < SPEEDS.start {
            return None;
        }
        let light = Light::new(&Encoded(frame.0.crop(x, y, TILE, TILE)), space);
        let tile = tile((&light, (0, 0)), None, None, corner, block_of(corner, frame.0.size()))?;
        let power = periodogram(&light.plane, (0, 0));
        let turned = angles.iter().map(|angle| {
            let (bins, rings) = spectrum(&power, turned(motion, *angle), speed);
            Tile { speed, bins, rings, ..tile.clone() }
        });
        Some(turned.collect())
    });
    found.into_iter().flatten().collect()
}

/// A motion turned by an angle in radians.
pub(super) fn turned([u, v]: [f32; 2], angle: f32) -> [f32; 2] {
    let (sin, cos) = angle.portable_sin_cos();
    [u * cos - v * sin, u * sin + v * cos]
}

/// The values of a raster at every second pixel, each way, of the tile at a corner, if `scale` px of the raster make one px of the tile.
pub(super) fn samples<T>(
    of: impl Fn(usize, usize) -> T,
    (x0, y0): (usize, usize),
    scale: usize,
) -> impl Iterator<Item = T> {
    let places =
        (y0..y0 + TILE).step_by(2).flat_map(move |y| (x0..x0 + TILE).step_by(2).map(move |x| (x, y)));
    places.map(move |(x, y)| of(scale * x, scale * y))
}

/// The motion at a pixel of a frame, px per frame interval; NaN where it is unknown.
pub(super) type MotionOf<'a> = dyn Fn(usize, usize) -> [f32; 2] + Sync + 'a;

/// The number of a tile's pixels, every second one each way, at which flow and depth are read.
pub const SAMPLES: usize = TILE * TILE / 4;

/// The fewest of a tile's [`SAMPLES`] at which its motion must be known. Where it is not, something else may come into view or go out of it,
/// such as what stands still between the legs of a passer-by, and may have most of the tile's contrast.
pub const KNOWN_SAMPLES: usize = SAMPLES * 7 / 8;

/// The speed and the motion of a tile, and the mean deviation of its parts from that motion, in px of the tile; `None` if its parts
/// move differently or too fast, or if their motion is unknown.
pub(super) fn common_motion(
    motion: &MotionOf,
    corner: (usize, usize),
    scale: usize,
) -> Option<(f32, [f32; 2], f32)> {
    let known: Vec<[f32; 2]> = samples(motion, corner, scale)
        .filter(|f| f[0].is_finite() && f[1].is_finite())
        .map(|f| f.map(|v| v / scale as f32))
        .collect();
    if known.len() < KNOWN_SAMPLES {
        return None;
    }
    let [Some(u), Some(v)] = [0, 1].map(|c| median(known.iter().map(|f| f[c]).collect())) else {
        return None;
    };
    let motion = [u, v];
    let speed = motion[0].portable_hypot(motion[1]);
    // `hypot` would be slow here.
    let length = |x: f32, y: f32| (x * x + y * y).sqrt();
    let deviation =
        known.iter().map(|f| length(f[0] - motion[0], f[1] - motion[1])).sum::<f32>() / known.len() as f32;
    (deviation <= (0.15 * speed).max(0.5) && speed <= SPEEDS.end).then_some((speed, motion, deviation))
}

/// The median inverse depth of a tile; `None` if the tile spans much depth, or its depth is unknown.
pub(super) fn common_depth(map: &Plane, corner: (usize, usize), scale: usize) -> Option<f32> {
    let mut d: Vec<f32> = samples(|x, y| map.at(x, y), corner, scale).filter(|d| d.is_finite()).collect();
    if d.len() < SAMPLES / 2 {
        return None;
    }
    d.sort_by(f32::total_cmp);
    let at = |q: f32| d[(q * (d.len() - 1) as f32) as usize];
    (at(0.9) - at(0.1) <= 0.25 * at(0.5).abs()).then_some(at(0.5))
}

/// The periodogram `|FFT(window (patch - mean))|^2 / TILE^2`, [wx][wy], for the [`COLUMNS`] of wx up to the end of [`BAND`].
fn periodogram(light: &Plane, at: (usize, usize)) -> Vec<f32> {
    transform(light, at).iter().map(|[re, im]| (re * re + im * im) / (TILE * TILE) as f32).collect()
}

/// The spectrum `FFT(window (patch - mean))`, [wx][wy], for the same [`COLUMNS`]: real and imaginary parts.
pub(super) fn transform(light: &Plane, (x0, y0): (usize, usize)) -> Vec<[f32; 2]> {
    let window = hann();
    let row = |y: usize| &light.row(y0 + y)[x0..x0 + TILE];
    let weights: f32 = window.iter().sum::<f32>().powi(2);
    let sum: f32 =
        (0..TILE).map(|y| window[y] * row(y).iter().zip(window).map(|(v, w)| v * w).sum::<f32>()).sum();
    let mean = sum / weights;
    // Two rows of real values are transformed as one row of complex values, and four such pairs at once.
    let mut columns = vec![[0.0; 2]; COLUMNS * TILE];
    for y in (0..TILE).step_by(8) {
        let rows: [&[f32]; 8] = std::array::from_fn(|k| row(y + k));
        let mut values: [Complex4; TILE] = std::array::from_fn(|x| {
            let part = |odd: usize| {
                let of = |k: usize| (rows[2 * k + odd][x] - mean) * window[x] * window[y + 2 * k + odd];
                f32x4::from([of(0), of(1), of(2), of(3)])
            };
            Complex4 { re: part(0), im: part(1) }
        });
        fourier::transform(&mut values);
        for i in 0..COLUMNS {
            let (z, mirrored) = (values[i], values[(TILE - i) % TILE]);
            let even = [z.re + mirrored.re, z.im - mirrored.im].map(|v| (0.5 * v).to_array());
            let odd = [z.im + mirrored.im, mirrored.re - z.re].map(|v| (0.5 * v).to_array());
            for (k, out) in columns[i * TILE + y..][..8].chunks_exact_mut(2).enumerate() {
                (out[0], out[1]) = ([even[0][k], even[1][k]], [odd[0][k], odd[1][k]]);
            }
        }
    }
    for four in columns.chunks_mut(4 * TILE) {
        let count = four.len() / TILE;
        let mut values: [Complex4; TILE] = std::array::from_fn(|y| {
            let part = |c: usize| {
                f32x4::from(std::array::from_fn::<f32, 4, _>(|k| four[k.min(count - 1) * TILE + y][c]))
            };
            Complex4 { re: part(0), im: part(1) }
        });
        fourier::transform(&mut values);
        for (y, Complex4 { re, im }) in values.into_iter().enumerate() {
            let [re, im] = [re, im].map(f32x4::to_array);
            (0..count).for_each(|k| four[k * TILE + y] = [re[k], im[k]]);
        }
    }
    columns
}

/// The number of frequencies in x of a tile's periodogram that are used.
pub const COLUMNS: usize = (BAND.end * TILE as f32) as usize + 1;

/// A frequency of a tile's periodogram, cycles per px of the tile.
#[derive(Clone, Copy, Debug)]
pub struct Frequency {
    /// The index in a periodogram, which holds [`TILE`] values for each column x.
    pub at: usize,
    /// The horizontal component, cycles per px.
    pub x: f32,
    /// The vertical component, cycles per px, positive down.
    pub y: f32,
    /// The length of the vector of both components, cycles per px.
    pub modulus: f32,
    /// The weight, 1 or 0.5: a frequency stands for itself and its mirror image, but the first column holds the mirror images as well.
    pub(super) weight: f32,
}

/// The frequencies of a tile's periodogram that are used, of modulus 0.03 to 0.35 cycles per px of the tile.
pub fn frequencies() -> &'static [Frequency] {
    static FREQUENCIES: OnceLock<Vec<Frequency>> = OnceLock::new();
    FREQUENCIES.get_or_init(|| {
        let all = (0..COLUMNS).flat_map(|i| (0..TILE).map(move |j| (i, j))).map(|(i, j)| {
            let x = i as f32 / TILE as f32;
            let y = if j < TILE / 2 { j as f32 } else { j as f32 - TILE as f32 } / TILE as f32;
            let weight = if i == 0 { 0.5 } else { 1.0 };
            Frequency { at: i * TILE + j, x, y, modulus: x.portable_hypot(y), weight }
        });
        all.filter(|f| BAND.contains(&f.modulus)).collect()
    })
}

/// The periodogram in bins as wide as the window's resolution, and the ends of the rings of like modulus.
pub(super) fn spectrum(periodogram: &[f32], motion: [f32; 2], speed: f32) -> (Vec<Bin>, Vec<u16>) {
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

/// The density of the noise over the modulus in a tile with these [`Tile::noise_moments`] and this scale, including the padding by
/// [`padding_density`] noise for a coder's errors of std `coding_error`.
pub(super) fn noise_density(
    moments @ [squares, products, ones]: [f32; 3],
    scale: f32,
    noise: &LumaNoise,
    coding_error: f32,
) -> impl Fn(f32) -> f32 {
    let white = white_band_std();
    // The spectral density of the noise in each level is that of white noise with the variance of the level.
    let density: [f32; NOISE_LEVELS] = std::array::from_fn(|l| {
        let NoiseLine { slope, intercept } = noise.levels[l];
        let variance =
            slope * slope * squares + 2.0 * slope * intercept * products + intercept * intercept * ones;
        variance.max(0.0) / (white[l] * white[l])
    });
    // A px of the tile is a mean of scale^2 px, by which the variance is divided.
    let mean = (scale * scale).recip();
    let padding_density = padding_density(moments, scale, coding_error);
    move |modulus| {
        // Level l holds the frequencies around 0.35 / 2^l cycles per px.
        let level = (0.35 * scale / modulus).portable_log2().clamp(0.0, (NOISE_LEVELS - 1) as f32);
        let i = (level as usize).min(NOISE_LEVELS - 2);
        (mean * (density[i] + (level - i as f32) * (density[i + 1] - density[i]))).max(1e-9) + padding_density
    }
}

/// The density of the white noise that hides a coder's errors in a tile. The noise-padded tile has this density added to both its power and
/// its noise.
pub(super) fn padding_density(noise_moments: [f32; 3], scale: f32, coding_error: f32) -> f32 {
    coding_error * coding_error * noise_moments[2] / (scale * scale)
}

/// The window of a tile along each axis: a Hann window of mean square 1.
pub fn hann() -> &'static [f32; TILE] {
    static WINDOW: OnceLock<[f32; TILE]> = OnceLock::new();
    WINDOW.get_or_init(|| {
        let angle = |i: usize| std::f32::consts::TAU * (i as f32 + 1.0) / (TILE as f32 + 1.0);
        let w: [f32; TILE] = std::array::from_fn(|i| 0.5 - 0.5 * angle(i).portable_sin_cos().1);
        let rms = (w.iter().map(|v| v * v).sum::<f32>() / TILE as f32).sqrt();
        w.map(|v| v / rms)
    })
}

/// The light that is blurred, or encoded values, with luma's weights of R, G and B, since the noise of luma is known.
pub(super) fn light_of(image: &Encoded, space: Space) -> Plane {
    match space.blur {
        BlurSpace::Linear => image.0.map(|p| luma(p.map(|v| space.transfer.decode(v)))),
        BlurSpace::Encoded => image.luma(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_many_tiles_those_of_most_contrast_are_searched_in_each_block() {
        let searched = |size @ (w, h): (usize, usize), scale: usize| {
            let noise = crate::fit::noise::tests::white(w, h, 2);
            // Contrast grows to the right.
            let frame = Encoded(Raster::from_fn(w, h, |x, y| {
                noise.at(x, y).map(|n| 0.5 + 0.1 * n * (x as f32 / w as f32))
            }));
            let size = (size.0 / scale, size.1 / scale);
            let all = corners(size);
            let searched = searched_corners(&frame, size, scale, BlurSpace::Encoded.into());
            let of_block =
                |of: &[(usize, usize)], b: u32| of.iter().filter(|c| block_of(**c, size) == b).count();
            for b in 0..BLOCK_COUNT as u32 {
                assert_eq!(of_block(&searched, b), of_block(&all, b).min(SEARCHED_PER_BLOCK));
            }
            assert!(searched.is_sorted_by_key(|&(x, y)| (y, x)));
            let mean = |of: &[(usize, usize)]| of.iter().map(|c| c.0).sum::<usize>() as f32 / of.len() as f32;
            (searched.len(), all.len(), mean(&searched) - mean(&all))
        };
        let (few, all, moved) = searched((1920, 1080), 1);
        assert!(few < all / 2 && moved > 40.0, "{few} of {all}, {moved} px to the right");
        // Negative control: small frames, and large ones at half the resolution, have few enough.
        for (size, scale) in [((960, 540), 1), ((960, 720), 1), ((1920, 1080), 2)] {
            let (searched, all, moved) = searched(size, scale);
            assert!(searched == all && moved == 0.0, "{size:?}: {searched} of {all}");
        }
    }

    #[test]
    fn a_tile_in_which_something_else_comes_into_view_is_not_used() {
        let (w, h) = (4 * TILE, 4 * TILE);
        let frame = Encoded(crate::fit::noise::tests::white(w, h, 2).map(|n| n.map(|v| 0.5 + 0.1 * v)));
        // The number of tiles at the finest resolution, if the motion is unknown at some pixels.
        let found = |is_unknown: &(dyn Fn(usize, usize) -> bool + Sync)| {
            let at = |x, y| if is_unknown(x, y) { [f32::NAN; 2] } else { [8.0, 0.0] };
            let tiles = tiles(&frame, Some(&Flow::from_fn(w, h, at)), None, Space::default()).unwrap();
            tiles.iter().filter(|t| t.scale == 1.0).count()
        };
        assert_eq!((found(&|_, _| false), found(&|x, _| x % (TILE / 2) < 4)), (49, 0));
        // What a few pixels show does not count.
        assert_eq!(found(&|x, y| x % TILE < 4 && y % TILE < 4), 49);
    }
}
