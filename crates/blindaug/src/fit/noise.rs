//! The estimate of the noise std over luminance, for each pyramid level and channel, from motion-compensated differences of frames, from
//! the flattest parts of single frames, or from the residual of a denoiser.
//!
//! All three methods collect local variances of the Laplacian bands of a residual; [`NoiseEvidence::fit`] turns these into the
//! 24 numbers of the model, each with an interval.

use super::noise_curves::{self, Block, Colours, Spectrum};
use crate::analysis::brightness::{brightening, undone};
use crate::model::{
    Estimate, Method, NOISE_LEVELS, NoiseCurves, NoiseInterval, NoiseLevel, NoiseLines, NoiseModel, Reason,
};
use crate::portable::Portable;
use crate::raster::cubic_weights;
use crate::strips::{STRIP, Strip, rows_in_turn, strips_of};
use crate::synth::noise::white_band_std;
use crate::{Encoded, Error, Flow, LUMA, Pixel, Plane, Raster, Result, filter, luma, par, pyramid};
use std::{ops::Range, sync::OnceLock};

/// The least errors of a coder, as a std of luma of full scale 1, of which the user is told.
pub(super) const NOTABLE_CODING_ERROR: f32 = 0.01;
/// The side of the blocks in which variances are measured, px of the full image, for each level: small blocks are more often free of
/// structure, but a block of a coarse level needs a few values.
const BLOCK: [usize; NOISE_LEVELS] = [16, 16, 32, 32];

/// The mean of the lower half of the blocks' variances over the mean of all, for pure noise, for each level. It is below 1 since
/// variances of few values scatter widely. A test checks these numbers.
const LOWER_HALF: [f32; NOISE_LEVELS] = [0.93, 0.84, 0.821, 0.658];

/// The distance from 0 or 1 within which encoded values count as clipped: they have lost a part of their noise.
const CLIP_MARGIN: f32 = 0.02;
/// The largest share of clipped pixels in a block: if noise is strong, every dark block has a few, which cost little of the variance.
const MAY_CLIP: f32 = 0.04;

/// The errors of H.264 at a quality that is just bearable, as a std of luma of full scale 1. The quality of a coder is not known, and to
/// allow for larger errors than there are costs little (docs/lab-log.md).
pub(super) const MAX_CODING_ERROR: f32 = 0.045;

/// The flaw of a pixel; a block is left out if the sum of its pixels' flaws is too large.
type Flaw = u8;
/// The flaw of a clipped pixel, of which a block may have a share of [`MAY_CLIP`].
const CLIPPED: Flaw = 1;
/// The flaw of a pixel that no block may have: it exceeds the largest sum that is allowed.
const UNUSABLE: Flaw = u8::MAX;

/// The variance of one band in one block (or window) of one residual.
#[derive(Clone, Copy, Debug)]
struct LocalVariance {
    /// The mean luminance, Rec. 601 of encoded values.
    y: f32,
    /// The variances of R, G, B and luma, divided by the gain of the residual.
    variance: [f32; 4],
    /// The covariance of R, G and B with luma, divided by the same gain.
    with_luma: [f32; 3],
    /// A measure of structure beside noise in the block; only its order among blocks counts.
    structure: f32,
    /// The mean square of luma in the next coarser band, in which a mismatch stands out most from noise.
    coarser: f32,
    /// The number of values in the variance.
    count: f32,
    /// The encoded colours in the block.
    colours: Colours,
    /// The covariances RG, RB and GB, divided by the same gain.
    between: [f32; 3],
    /// The mean product of neighbouring values of the band in R, G and B; only of the finest level of single frames.
    neighbours: [f32; 3],
    /// The power of the picture's own texture, of which the residual may hold a share: [`noise_curves::Block::texture`].
    texture: f32,
    /// The mean power of luma in the next coarser band of the two frames, with their noise.
    coarser_power: f32,
    /// Whether the residual is known to hold nothing but noise.
    pure: bool,
    /// Whether so many pixels clip that a part of the noise is lost.
    clipped: bool,
}

/// A residual from which local variances are taken, pixel by pixel.
struct Residual<V, C, F, G> {
    /// R, G and B of the residual, and the image whose band shows the texture of which the residual may hold a share.
    values: V,
    /// The encoded colour of the image, with as little noise as possible.
    colour: C,
    /// The flaw of a pixel.
    flaws: F,
    /// The factor of the residual on the variance of noise, at a pixel and level.
    gain: G,
    /// Whether the residual is known to hold nothing but noise.
    pure: bool,
}

/// A measured point of the noise curve, for plots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoisePoint {
    /// The pyramid level, 0 the finest.
    pub level: usize,
    /// The luminance, Rec. 601 of encoded values.
    pub y: f32,
    /// The std in R, G and B, encoded values in [0, 1].
    pub sigma: [f32; 3],
    /// The number of local variances whose mean the point is.
    pub samples: usize,
}

/// The result of a fit of noise.
#[derive(Clone, Debug)]
pub struct NoiseFit {
    /// The model, or the reason why the noise is unknown.
    pub model: Estimate<NoiseModel>,
    /// The noise of luma, for estimators that work on luma; `None` if the noise is unknown.
    pub luma: Option<LumaNoise>,
    /// The measured points that the lines go through.
    pub points: Vec<NoisePoint>,
}

/// The noise of luma, for estimators that work on luma.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LumaNoise {
    /// The std of luma's noise in each level.
    pub levels: [NoiseLine; NOISE_LEVELS],
    /// The std of luma below which detail may be missing or wrong after a video coder; 0 if there was no coder.
    pub coding_error: f32,
}

impl LumaNoise {
    /// Whether so much of the noise was taken away by a coder that the user is told.
    pub(super) fn is_compressed(&self) -> bool {
        self.coding_error >= NOTABLE_CODING_ERROR
    }

    /// Whether a coder may have taken away any of the noise.
    pub(super) fn may_be_compressed(&self) -> bool {
        self.coding_error > 0.0
    }
}

/// The std of luma's noise in one level: `slope * Y + intercept`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NoiseLine {
    /// The change of the std per unit of luminance Y.
    pub slope: f32,
    /// The std at Y = 0.
    pub intercept: f32,
}

/// Local variances of noise, collected frame by frame.
#[derive(Clone, Debug)]
pub struct NoiseEvidence {
    method: Method,
    /// Whether the variances are those of the paper's windows, which are used without a choice or a correction.
    windowed: bool,
    /// Whether all flat parts of the picture count, rather than those that match best.
    flat: bool,
    levels: [Vec<LocalVariance>; NOISE_LEVELS],
    /// The histogram of the 8-bit value of each pixel's brightest channel.
    brightest: Box<[u64; 256]>,
    /// Whether any pixel is not grey.
    coloured: bool,
    /// The correlations of noise between successive frames that were measured.
    successive: Vec<f32>,
}

/// The side of the blocks that video coders copy, px.
const COPIED: usize = 8;

/// Whether each block is the same in both frames to the last bit: a coder copies a block that seems still together with its noise, so the
/// block says nothing of noise. If nearly all blocks are the same, they count as not copied, since there is then no noise.
fn copied_blocks(frame: &Encoded, next: &Encoded, rows: Range<usize>) -> Raster<bool> {
    let (w, height) = (frame.0.width(), rows.len());
    let same = Raster::from_fn(w.div_ceil(COPIED), height.div_ceil(COPIED), |bx, by| {
        let columns = bx * COPIED..((bx + 1) * COPIED).min(w);
        (by * COPIED..((by + 1) * COPIED).min(height)).all(|y| {
            let y = rows.start + y;
            frame.0.row(y)[columns.clone()] == next.0.row(y)[columns.clone()]
        })
    });
    let copied = same.data().iter().filter(|s| **s).count();
    // This also holds for two frames that differ in a few blocks only, which are not a fair sample of the picture.
    if copied * 20 > same.data().len() * 19 { same.map(|_| false) } else { same }
}

impl NoiseEvidence {
    /// No evidence yet; `method` is [`Method::Temporal`], [`Method::Spatial`] or [`Method::Removal`].
    pub fn new(method: Method) -> Self {
        Self {
            method,
            windowed: false,
            flat: false,
            levels: Default::default(),
            brightest: Box::new([0; 256]),
            coloured: false,
            successive: vec![],
        }
    }

    /// No evidence yet of frames that lie apart in compressed footage, with their differences along the flow. A coder copies some blocks
    /// and renews others, and what matches best was copied: so all flat parts of the picture count.
    pub(super) fn of_flat_parts() -> Self {
        Self { flat: true, ..Self::new(Method::Temporal) }
    }

    /// The number of local variances.
    pub fn len(&self) -> usize {
        self.levels.iter().map(Vec::len).sum()
    }

    /// Whether there are no local variances.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether a model can be fitted.
    pub(super) fn is_enough(&self) -> bool {
        self.sound_blocks(0).count() >= 8
    }

    /// The blocks of a level in which no more than a few pixels clip.
    fn sound_blocks(&self, level: usize) -> impl Iterator<Item = &LocalVariance> {
        self.levels[level].iter().filter(|b| !b.clipped)
    }

    /// Adds the evidence of two successive frames: their difference along the flow is pure noise wherever the match is good.
    /// A change of brightness between the frames is undone.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn add_pair(&mut self, frame: &Encoded, next: &Encoded, flow: &Flow) -> Result<()> {
        self.add_pair_in_turn(frame, next, flow, (0, 1)).map(|_| ())
    }

    /// [`NoiseEvidence::add_pair`] for the blocks in turn `i` of `turns` only ([`rows_in_turn`]); says whether nothing moves between the
    /// frames.
    ///
    /// # Errors
    /// If the sizes differ.
    pub(super) fn add_pair_in_turn(
        &mut self,
        frame: &Encoded,
        next: &Encoded,
        flow: &Flow,
        (i, turns): (usize, usize),
    ) -> Result<bool> {
        let height = frame.0.height();
        self.add_pair_of(frame, next, flow, 0..height, rows_in_turn(i, turns, height))
    }

    /// [`NoiseEvidence::add_pair`] for some rows of `frame` as if it had no others.
    ///
    /// # Errors
    /// If the sizes differ.
    pub(super) fn add_pair_rows(
        &mut self,
        frame: &Encoded,
        next: &Encoded,
        flow: &Flow,
        rows: Range<usize>,
    ) -> Result<()> {
        let all = 0..rows.len();
        self.add_pair_of(frame, next, flow, rows, all).map(|_| ())
    }

    /// What the blocks of two successive frames tell, of those that begin in `own`, which are some of `rows`, counted from the first. Says
    /// whether nothing moves between the frames.
    fn add_pair_of(
        &mut self,
        frame: &Encoded,
        next: &Encoded,
        flow: &Flow,
        rows: Range<usize>,
        own: Range<usize>,
    ) -> Result<bool> {
        let (w, h) = frame.0.size();
        if next.0.size() != (w, h) || flow.size() != (w, h) {
            return Err(Error::new("the two frames and the flow between them must have one size"));
        }
        let (top, height) = (rows.start, rows.len());
        self.count_colours(&frame.0.data()[w * top..w * rows.end]);
        let inside = |x: f32, y: f32| x >= 0.0 && y >= 0.0 && x <= (w - 1) as f32 && y <= (h - 1) as f32;
        // Where nothing moves, each pixel is compared with itself: nothing is interpolated, and nothing can mismatch.
        let still = is_still(flow, &rows);
        let target = |x: usize, y: usize| {
            let [u, v] = if still { [0.0; 2] } else { flow.at(x, top + y) };
            [x as f32 + u, (top + y) as f32 + v]
        };
        let brighter = brightening((w, height), |x, y| {
            let [tx, ty] = target(x, y);
            inside(tx, ty).then(|| [frame.0.at(x, top + y), next.0.bilinear(tx, ty)])
        });
        // Warp and difference are one pass, since the warped frame is not needed again.
        let values = |x: usize, y: usize| {
            let ([tx, ty], a) = (target(x, y), frame.0.at(x, top + y));
            if !inside(tx, ty) {
                return [0.0, 0.0, 0.0, luma(a)];
            }
            let mut b = next.0.cubic(tx, ty);
            if let Some(k) = &brighter {
                b = std::array::from_fn(|c| undone(b[c], k[y][c]));
            }
            [a[0] - b[0], a[1] - b[1], a[2] - b[2], 0.5 * (luma(a) + luma(b))]
        };
        let copied = copied_blocks(frame, next, rows);
        let flaws = |x: usize, y: usize| {
            let [tx, ty] = target(x, y);
            let usable = inside(tx, ty) && !copied.at(x / COPIED, y / COPIED);
            if usable { flaw(frame.0.at(x, top + y)) } else { UNUSABLE }
        };
        // The taps change the noise of the second frame, depending on the distance of the target from a pixel's centre. The taps are cubic,
        // since linear ones would leave as much texture as noise in the coarse levels.
        let gain = |x: usize, y: usize, level: usize| {
            let [tx, ty] = target(x, y);
            1.0 + cubic_gain(tx - tx.floor(), ty - ty.floor(), level)
        };
        let colour = |x: usize, y: usize| frame.0.at(x, top + y);
        self.add_blocks((w, height), own, &Residual { values, colour, flaws, gain, pure: still });
        Ok(still)
    }

    /// Adds the evidence of a single frame: where the frame is flat, its bands are noise.
    pub fn add_single(&mut self, frame: &Encoded) {
        self.count_colours(frame.0.data());
        let values = |x, y| {
            let p = frame.0.at(x, y);
            [p[0], p[1], p[2], luma(p)]
        };
        let residual = Residual {
            values,
            colour: |x, y| frame.0.at(x, y),
            flaws: |x, y| flaw(frame.0.at(x, y)),
            gain: |_, _, _| 1.0,
            pure: false,
        };
        self.add_blocks(frame.0.size(), 0..frame.0.height(), &residual);
    }

    /// Adds the difference between a frame and a prediction of the frame without noise. `sharp` is the clean frame that the prediction
    /// blurs: the blur may be wrong by a share of the difference of the two.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn add_residual(&mut self, frame: &Encoded, predicted: &Encoded, sharp: &Encoded) -> Result<()> {
        check_prediction(frame, predicted)?;
        check_prediction(frame, sharp)?;
        let values = |x, y| {
            let (a, b) = (frame.0.at(x, y), predicted.0.at(x, y));
            [a[0] - b[0], a[1] - b[1], a[2] - b[2], luma(b) - luma(sharp.0.at(x, y))]
        };
        self.count_colours(frame.0.data());
        let residual = Residual {
            values,
            colour: |x, y| predicted.0.at(x, y),
            flaws: |x, y| flaw(frame.0.at(x, y)),
            gain: |_, _, _| 1.0,
            pure: predicted == sharp,
        };
        self.add_blocks(frame.0.size(), 0..frame.0.height(), &residual);
        Ok(())
    }

    fn count_colours(&mut self, pixels: &[[f32; 3]]) {
        for p in pixels {
            let v = p[0].max(p[1]).max(p[2]);
            self.brightest[(v * 255.0 + 0.5).clamp(0.0, 255.0) as usize] += 1;
            self.coloured |= v - p[0].min(p[1]).min(p[2]) > 0.5 / 255.0;
        }
    }

    /// Adds the variances of the blocks of the rows `own`.
    fn add_blocks<V, C, F, G>(
        &mut self,
        size: (usize, usize),
        own: Range<usize>,
        residual: &Residual<V, C, F, G>,
    ) where
        V: Fn(usize, usize) -> [f32; 4] + Sync + Send,
        C: Fn(usize, usize) -> [f32; 3] + Sync + Send,
        F: Fn(usize, usize) -> Flaw + Sync + Send,
        G: Fn(usize, usize, usize) -> f32 + Sync + Send,
    {
        for strip in strips_of(own, size, STRIP) {
            self.add_blocks_of(&strip, size.0, residual);
        }
    }

    fn add_blocks_of<V, C, F, G>(
        &mut self,
        Strip { rows: own, around }: &Strip,
        w: usize,
        of: &Residual<V, C, F, G>,
    ) where
        V: Fn(usize, usize) -> [f32; 4] + Sync + Send,
        C: Fn(usize, usize) -> [f32; 3] + Sync + Send,
        F: Fn(usize, usize) -> Flaw + Sync + Send,
        G: Fn(usize, usize, usize) -> f32 + Sync + Send,
    {
        let (top, h) = (around.start, around.len());
        let residual = Raster::from_fn(w, h, |x, y| (of.values)(x, top + y));
        let flaws = Raster::from_fn(w, h, |x, y| (of.flaws)(x, top + y));
        // The bands of a single frame hold its structure, so only the smoothed gradient tells structure from noise.
        let single = self.method == Method::Spatial;
        let gradient = single.then(|| squared_gradient(&residual.map(|v| v[3])));
        let (bands, _) = pyramid::laplacian(&residual, NOISE_LEVELS + 1);
        for (level, found) in self.levels.iter_mut().enumerate() {
            let block = BLOCK[level];
            let (columns, rows) = (w / block, own.len() / block);
            let of_block = |i: usize| {
                let (x0, y0) = (i % columns * block, own.start - top + i / columns * block);
                let clipped = clipped_block(&flaws, (x0, y0), block)?;
                if clipped && !of.pure {
                    return None;
                }
                // A few places are enough for the mean gain, since the flow is smooth.
                let gain = places(block, 4).map(|(x, y)| (of.gain)(x0 + x, top + y0 + y, level)).sum::<f32>()
                    / places(block, 4).count() as f32;
                let powers = |l: usize| Powers::new(&bands[l], (x0, y0), block, l);
                let own = powers(level);
                let next = powers(level + 1);
                let coarser = next.residual[3] / gain;
                let variance = own.residual.map(|v| v / gain);
                // Eight places each way are enough for the colours of a block.
                let pixels = || places(block, block / 8).map(|(x, y)| (of.colour)(x0 + x, top + y0 + y));
                Some(LocalVariance {
                    y: pixels().map(luma).sum::<f32>() / pixels().count() as f32,
                    variance,
                    with_luma: own.with_luma.map(|v| v / gain),
                    // A mismatch shows in the neighbouring bands too, whose noise is independent. A block with little
                    // texture can have little mismatch.
                    structure: match &gradient {
                        Some(gradient) => block_mean(gradient, (x0, y0), block),
                        None => {
                            let finer = if level > 0 { powers(level - 1).residual[3] / gain } else { 1.0 };
                            finer * coarser * own.image.sqrt()
                        }
                    },
                    coarser,
                    count: ((block >> level) * (block >> level)) as f32,
                    colours: Colours::of(pixels()),
                    between: own.between.map(|v| v / gain),
                    neighbours: if single && level == 0 {
                        products_of_neighbours(&bands[0], (x0, y0), block)
                    } else {
                        [0.0; 3]
                    },
                    // About half of the noise's variance is left in the mean of two frames.
                    texture: (own.image - 0.6 * variance[3]).max(0.0),
                    // Half the sum of two frames' powers is the power of their mean and a quarter of that of their difference.
                    coarser_power: next.image + 0.25 * next.residual[3],
                    pure: of.pure,
                    clipped,
                })
            };
            found.extend(par::map(columns * rows, of_block).into_iter().flatten());
        }
    }

    /// Adds the residual of a denoised frame, as the paper does: the local variance `E[x^2] - E[x]^2` under a 9x9 Gaussian
    /// (std 4 px, halved per level), sampled every 32 px (halved per level).
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn add_denoised(&mut self, frame: &Encoded, denoised: &Encoded) -> Result<()> {
        let (w, h) = frame.0.size();
        let residual = residual(frame, denoised)?;
        self.count_colours(frame.0.data());
        self.windowed = true;
        let (bands, _) = pyramid::laplacian(&residual, NOISE_LEVELS);
        let mut y = denoised.luma();
        for (level, band) in bands.iter().enumerate() {
            let window = window_weights(level);
            let stride = (32 >> level).max(1);
            let (bw, bh) = band.size();
            for cy in (stride / 2..bh).step_by(stride) {
                for cx in (stride / 2..bw).step_by(stride) {
                    if clips(denoised.0.at((cx << level).min(w - 1), (cy << level).min(h - 1))) {
                        continue;
                    }
                    let (mut mean, mut square) = ([0.0f32; 4], [0.0f32; 4]);
                    for (j, row) in window.iter().enumerate() {
                        for (i, k) in row.iter().enumerate() {
                            let v = band.at_clamped((cx + i) as isize - 4, (cy + j) as isize - 4);
                            for c in 0..4 {
                                mean[c] += k * v[c];
                                square[c] += k * v[c] * v[c];
                            }
                        }
                    }
                    let bias = window_bias(level);
                    self.levels[level].push(LocalVariance {
                        y: y.at(cx, cy),
                        variance: std::array::from_fn(|c| (square[c] - mean[c] * mean[c]).max(0.0) / bias),
                        with_luma: [0.0; 3],
                        structure: 0.0,
                        coarser: 0.0,
                        count: 16.0,
                        colours: Colours::default(),
                        between: [0.0; 3],
                        neighbours: [0.0; 3],
                        texture: 0.0,
                        coarser_power: 0.0,
                        pure: false,
                        clipped: false,
                    });
                }
            }
            y = pyramid::downsample(&y);
        }
        Ok(())
    }

    /// Adds the evidence of another collection of the same method.
    pub fn merge(&mut self, other: &Self) {
        self.windowed |= other.windowed;
        self.flat |= other.flat;
        self.coloured |= other.coloured;
        self.successive.extend_from_slice(&other.successive);
        for (a, b) in self.levels.iter_mut().zip(&other.levels) {
            a.extend_from_slice(b);
        }
        for (a, b) in self.brightest.iter_mut().zip(other.brightest.iter()) {
            *a += b;
        }
    }

    /// The model that the collected variances give.
    pub fn fit(&self) -> NoiseFit {
        self.fit_to(noise_curves::ENOUGH)
    }

    /// [`NoiseEvidence::fit`] with curves through at most `most` blocks of each level.
    // Long, since the lines of all levels lean on the finest one's bins, and the curves and the coder's errors on both.
    pub(super) fn fit_to(&self, most: usize) -> NoiseFit {
        if !self.is_enough() {
            let (reason, why) = match self.method {
                Method::Temporal => {
                    (Reason::NotFollowed, "no part of the frames could be followed from one to the next")
                }
                _ => (Reason::Flat, "the frames are too small, or clipped everywhere"),
            };
            return NoiseFit { model: Estimate::unknown(reason, why), luma: None, points: vec![] };
        }
        let pure = self.is_pure();
        let single = self.single_spectrum();
        let white = white_band_std();
        let mut points = vec![];
        let mut levels = [NoiseLevel::default(); NOISE_LEVELS];
        let mut interval = [NoiseInterval::default(); NOISE_LEVELS];
        let mut luma = [NoiseLine::default(); NOISE_LEVELS];
        let finest = self.bins(0, [1.0; 3], false);
        // A mismatch is common to all channels, and the finest level holds least of it.
        let freedom: f32 = finest.iter().map(|b| b.freedom).sum();
        let most_common = std::array::from_fn(|c| {
            finest.iter().map(|b| b.freedom * b.common[c]).sum::<f32>() / freedom.max(1.0)
        });
        for level in 0..NOISE_LEVELS {
            let mut bins = if level == 0 { finest.clone() } else { self.bins(level, most_common, false) };
            let measured = bins.clone();
            if self.method == Method::Spatial && level > 0 {
                // For estimators that look at luma, coarse noise is at most that of white noise: to take structure for noise would blind
                // them.
                limit(&mut bins, &finest, (white[level] / white[0]).powi(2));
            }
            let expected = if level == 0 || self.windowed { vec![] } else { by_spectrum(&bins, &finest) };
            let of_line: Vec<Bin> = bins.iter().copied().chain(expected).collect();
            let l = line(&of_line, 3);
            luma[level] = NoiseLine { slope: l.slope, intercept: l.intercept };
            // Where a residual holds nothing but noise, a choice of quiet blocks would only make the noise too weak.
            let of_line = if pure {
                bins = self.bins(level, [1.0; 3], true);
                bins.clone()
            } else if self.method == Method::Spatial && level > 0 {
                bins = measured;
                limit(&mut bins, &finest, single.ratios[level].powi(2));
                bins.clone()
            } else {
                of_line
            };
            for c in 0..3 {
                let l = line(&of_line, c);
                levels[level].slope[c] = l.slope;
                levels[level].intercept[c] = l.intercept;
                interval[level].slope[c] = [l.slope - 1.96 * l.slope_error, l.slope + 1.96 * l.slope_error];
                interval[level].intercept[c] = [
                    (l.intercept - 1.96 * l.intercept_error).max(0.0),
                    l.intercept + 1.96 * l.intercept_error,
                ];
            }
            points.extend(bins.iter().map(|b| NoisePoint {
                level,
                y: b.y,
                sigma: std::array::from_fn(|c| b.variance[c].sqrt()),
                samples: b.blocks,
            }));
        }
        let lines = NoiseLines {
            levels,
            interval: Some(interval),
            clip: self.clip_level(),
            method: self.method,
            samples: self.len() as u64,
        };
        let prior = (self.method == Method::Spatial).then_some(&single);
        let model = match noise_curves::fit(&self.blocks(pure), lines.clone(), pure, prior, most) {
            Some(curves) => NoiseModel::Curves(Box::new(NoiseCurves {
                temporal_correlation: if pure { self.temporal_correlation() } else { 0.0 },
                ..curves
            })),
            None => NoiseModel::Lines(lines),
        };
        let coding_error = match self.method {
            Method::Temporal if self.coloured => coding_error(&finest, most_common),
            // Remaining structure is common to all channels, and in grey footage so is noise: the correlation says nothing of a coder.
            Method::Temporal | Method::Spatial => coding_error(&finest, [0.0; 3]),
            // The difference from the clean frame includes a coder's errors, so no others are allowed for.
            _ => 0.0,
        };
        let luma = LumaNoise { levels: luma, coding_error };
        NoiseFit { model: Estimate::Known(model), luma: Some(luma), points }
    }

    /// The spectrum that noise of single frames is taken to have. Coarse noise cannot be told from structure there, but whether a sensor
    /// with a colour filter array made the noise can: interpolation makes neighbouring pixels alike, in all channels, where the picture is
    /// flat.
    fn single_spectrum(&self) -> Spectrum {
        /// The correlations of neighbouring values of the finest level of white noise as it is found in flat parts, and of a camera's
        /// noise.
        const NEIGHBOURS: Range<f32> = 0.05..0.3;
        let (mut products, mut squares) = ([0.0; 3], [0.0; 3]);
        let chosen = |blocks| self.chosen(0, blocks, [1.0; 3], false);
        for Chosen { blocks, .. } in self.by_luminance(0, false).into_iter().filter_map(chosen) {
            for b in blocks {
                // Each block counts alike, whatever its luminance.
                let scale = 1.0 / b.variance[3].max(1e-10);
                products.add_scaled(b.neighbours, scale);
                squares.add_scaled([b.variance[0], b.variance[1], b.variance[2]], scale);
            }
        }
        let least = (0..3).map(|c| products[c] / squares[c].max(1e-10)).fold(1.0, f32::min);
        let share = (least - NEIGHBOURS.start) / (NEIGHBOURS.end - NEIGHBOURS.start);
        Spectrum::between_white_and_camera(share.clamp(0.0, 1.0))
    }

    /// The blocks of a level that are known to hold nothing but noise. Where nothing moves between two frames, light may still flicker and
    /// small things may move; that shows in the next coarser band, in which noise is weaker.
    fn pure_blocks(&self, level: usize) -> Vec<&LocalVariance> {
        if self.flat {
            return self.flat_blocks(level);
        }
        let blocks = || self.levels[level].iter().filter(|b| b.pure);
        if self.method != Method::Temporal {
            return blocks().collect();
        }
        let mut usual: [Vec<f32>; LUMINANCES] = Default::default();
        blocks().for_each(|b| usual[luminance_bin(b.y)].push(b.coarser));
        let usual = usual.map(|mut v| {
            v.sort_by(f32::total_cmp);
            v.get(v.len() / 4).copied().unwrap_or(0.0).max(1e-8)
        });
        blocks().filter(|b| b.coarser <= APART[level] * usual[luminance_bin(b.y)]).collect()
    }

    /// The blocks in which the picture has least texture, so that what differs between two frames is noise and a coder's doing, however
    /// well or badly it matches; without those that differ so much more than most that something else is seen.
    fn flat_blocks(&self, level: usize) -> Vec<&LocalVariance> {
        /// The share of the blocks of a luminance that are taken, and the fewest.
        const FLATTEST: (f32, usize) = (0.25, 8);
        /// The most of a block's variance, over the median.
        const MOST: f32 = 2.0;
        fn undoubted(mut blocks: Vec<&LocalVariance>) -> Vec<&LocalVariance> {
            // By a band of its own, since the chance by which some blocks have less noise than others must not choose them; and by the power
            // of the frames, since little of the texture is left in a mean of frames that do not match.
            blocks.sort_by(|a, b| a.coarser_power.total_cmp(&b.coarser_power));
            blocks.truncate(((FLATTEST.0 * blocks.len() as f32) as usize).max(FLATTEST.1));
            if let Some(usual) = super::robust::median(blocks.iter().map(|b| b.variance[3]).collect()) {
                blocks.retain(|b| b.variance[3] <= MOST * usual);
            }
            blocks
        }
        let mut bins: [Vec<&LocalVariance>; LUMINANCES] = Default::default();
        self.sound_blocks(level).for_each(|b| bins[luminance_bin(b.y)].push(b));
        bins.into_iter().flat_map(undoubted).collect()
    }

    /// The mean variance of the finest level's luma where the picture has least texture; `None` if there are no such parts.
    pub(super) fn flat_power(&self) -> Option<f32> {
        let blocks = self.flat_blocks(0);
        let sum: f32 = blocks.iter().map(|b| b.variance[3]).sum();
        (!blocks.is_empty()).then(|| sum / blocks.len() as f32)
    }

    /// The share of the picture's power by which two frames differ, beyond noise, in the half of the blocks with most texture, in the band
    /// next to the finest level: 0 if the picture was found again, up to 1 if it was not; without this share of these blocks, those that
    /// differ most. `None` without blocks.
    pub(super) fn mismatch(&self, without: f32) -> Option<f32> {
        let mut blocks: Vec<&LocalVariance> = self.sound_blocks(0).collect();
        blocks.sort_by(|a, b| a.coarser_power.total_cmp(&b.coarser_power));
        // White noise has this share of its variance there; where the picture does not match, the finest level has less.
        let [finest, coarser, ..] = white_band_std();
        let beyond_noise = |b: &LocalVariance| b.coarser - (coarser / finest).powi(2) * b.variance[3];
        let share = |b: &LocalVariance| beyond_noise(b) / b.coarser_power.max(1e-12);
        let mut textured = blocks.split_off(blocks.len() / 2);
        textured.sort_by(|a, b| share(a).total_cmp(&share(b)));
        let kept = &textured[..textured.len() - (without * textured.len() as f32) as usize];
        let power: f32 = kept.iter().map(|b| b.coarser_power).sum();
        (power > 0.0).then(|| kept.iter().map(|b| beyond_noise(b)).sum::<f32>().max(0.0) / power)
    }

    /// Whether most blocks are of residuals that are known to hold nothing but noise, and are found to hold nothing else.
    fn is_pure(&self) -> bool {
        /// The least share of blocks in which nothing flickers or moves.
        const CALM: f32 = 0.85;
        /// The most by which the variance where the picture has most texture exceeds that where it has least. Of noise it was 0.8 to 1.2 in
        /// coded footage of a camera that stands still, of leaves in the wind 2.4.
        const BY_TEXTURE: f32 = 1.8;
        if self.flat {
            return true;
        }
        let pure = self.levels[1].iter().filter(|b| b.pure).count();
        2 * pure > self.levels[1].len()
            && self.pure_blocks(1).len() as f32 >= CALM * pure as f32
            && (self.method != Method::Temporal || self.textured_over_flat() <= BY_TEXTURE)
    }

    /// The variance of the finest level's noise in the quarter of blocks that have most of the picture's texture, over that in the quarter
    /// that has least: the geometric mean over four ranges of luminance. What moves between two frames leaves more where there is more
    /// texture to move.
    fn textured_over_flat(&self) -> f32 {
        const RANGES: usize = 4;
        /// The fewest blocks of a range that tell something.
        const FEWEST: usize = 40;
        let mut ranges: [Vec<&LocalVariance>; RANGES] = Default::default();
        for b in self.pure_blocks(0).into_iter().filter(|b| !b.clipped) {
            ranges[((b.y * RANGES as f32) as usize).min(RANGES - 1)].push(b);
        }
        let (mut logs, mut count) = (0.0, 0.0);
        for mut blocks in ranges.into_iter().filter(|r| r.len() >= FEWEST) {
            blocks.sort_by(|a, b| a.texture.total_cmp(&b.texture));
            let n = blocks.len();
            let mean = |some: &[&LocalVariance]| some.iter().map(|b| b.variance[3]).sum::<f32>().max(1e-10);
            logs += n as f32 * (mean(&blocks[n - n / 4..]) / mean(&blocks[..n / 4])).portable_ln();
            count += n as f32;
        }
        if count > 0.0 { (logs / count).portable_exp() } else { 1.0 }
    }

    /// The blocks through which curves are laid: all of those that are known to hold nothing but noise, or all that were followed from
    /// frame to frame, or the flattest ones of single frames. None for the windows of a denoiser's residual, which the paper's lines
    /// describe.
    fn blocks(&self, pure: bool) -> [Vec<Block>; NOISE_LEVELS] {
        let block = |b: &LocalVariance, correction: [f32; 3]| Block {
            colours: b.colours,
            covariance: std::array::from_fn(|i| match i {
                0..3 => b.variance[i] * correction[i],
                _ => b.between[i - 3] * (correction[PAIRS[i - 3].0] * correction[PAIRS[i - 3].1]).sqrt(),
            }),
            texture: b.texture,
            count: b.count,
        };
        let hidden = self.hidden(pure);
        std::array::from_fn(|level| match self.method {
            _ if self.windowed => vec![],
            Method::Spatial => self
                .by_luminance(level, false)
                .into_iter()
                .filter_map(|blocks| self.chosen(level, blocks, [1.0; 3], false))
                .flat_map(|chosen| {
                    let quiet = |b: &&LocalVariance| Block {
                        texture: 0.0,
                        ..block(b, [0, 1, 2].map(|c| chosen.correction[c]))
                    };
                    chosen.blocks.iter().map(quiet).collect::<Vec<_>>()
                })
                .collect(),
            _ if pure => {
                let noise = |b| Block { texture: 0.0, ..block(b, [hidden; 3]) };
                self.pure_blocks(level).into_iter().map(noise).collect()
            }
            _ => self.sound_blocks(level).map(|b| block(b, [1.0; 3])).collect(),
        })
    }

    /// Adds the correlation of noise between successive frames, from three frames between which nothing moves.
    ///
    /// For noise n whose correlation falls off as powers of r, the covariance of the differences n1 - n0 and n2 - n1 is -(1 - r) / 2 of
    /// their variance.
    pub(super) fn add_successive(&mut self, [before, frame, next]: [&Encoded; 3]) {
        const SIDE: usize = 16;
        let (w, h) = frame.0.size();
        let columns = w / SIDE;
        let sums_of = |i: usize| {
            let (x0, y0) = (i % columns * SIDE, i / columns * SIDE);
            let (mut sum, mut squares, mut product) = ([0.0f32; 2], 0.0f32, 0.0f32);
            for y in y0..y0 + SIDE {
                for x in x0..x0 + SIDE {
                    let values = [before, frame, next].map(|f| f.0.at(x, y));
                    if values.iter().any(|v| clips(*v)) {
                        return None;
                    }
                    let [a, b, c] = values.map(luma);
                    let (d, e) = (b - a, c - b);
                    sum = [sum[0] + d, sum[1] + e];
                    squares += 0.5 * (d * d + e * e);
                    product += d * e;
                }
            }
            // A brightness that changes is no noise.
            let n = (SIDE * SIDE) as f32;
            squares -= 0.5 * (sum[0] * sum[0] + sum[1] * sum[1]) / n;
            Some((squares, product - sum[0] * sum[1] / n))
        };
        let blocks: Vec<(f32, f32)> = par::map(columns * (h / SIDE), sums_of).into_iter().flatten().collect();
        let Some(middle) = super::robust::median(blocks.iter().map(|b| b.0).collect()) else { return };
        // What moves after all differs far more than noise does.
        let noise = blocks.iter().filter(|b| b.0 <= 4.0 * middle);
        let (squares, products) = noise.fold((0.0, 0.0), |(s, p), b| (s + b.0, p + b.1));
        if squares > 0.0 {
            self.successive.push(1.0 + 2.0 * products / squares);
        }
    }

    /// The factor by which noise exceeds what a difference of frames shows of it: what successive frames share does not show.
    fn hidden(&self, pure: bool) -> f32 {
        if pure { 1.0 / (1.0 - self.temporal_correlation()) } else { 1.0 }
    }

    /// The correlation of noise between successive frames, 0 to [`MOST_CORRELATED`]; 0 where it was not measured.
    fn temporal_correlation(&self) -> f32 {
        let measured = super::robust::median(self.successive.clone());
        measured.map_or(0.0, |r| r.clamp(0.0, MOST_CORRELATED))
    }

    /// The log of the std of the finest level's luma noise over that of a model; `None` if there are fewer than 8 blocks.
    pub(super) fn log_ratio(&self, model: &NoiseLine) -> Option<f32> {
        let mut blocks: Vec<&LocalVariance> = self.sound_blocks(0).collect();
        if blocks.len() < 8 {
            return None;
        }
        blocks.sort_by(|a, b| a.structure.total_cmp(&b.structure));
        blocks.truncate((blocks.len() * 2 / 5).max(8));
        let std = |y: f32| (model.slope * y + model.intercept).max(1e-4);
        super::robust::median(
            blocks
                .iter()
                .map(|b| 0.5 * b.variance[3].max(1e-10).portable_ln() - std(b.y).portable_ln())
                .collect(),
        )
    }

    /// The blocks in which no more than a few pixels clip, by luminance.
    fn by_luminance(&self, level: usize, pure: bool) -> [Vec<&LocalVariance>; LUMINANCES] {
        let mut bins: [Vec<&LocalVariance>; LUMINANCES] = Default::default();
        let blocks = if pure { self.pure_blocks(level) } else { self.sound_blocks(level).collect() };
        for v in blocks.into_iter().filter(|b| !b.clipped) {
            bins[luminance_bin(v.y)].push(v);
        }
        bins
    }

    /// Of blocks of like luminance those that are least likely to hold structure, or all; `None` if there are too few. `most_common`: the
    /// limit of [`Bin::common`].
    fn chosen<'a>(
        &self,
        level: usize,
        mut blocks: Vec<&'a LocalVariance>,
        most_common: [f32; 3],
        all: bool,
    ) -> Option<Chosen<'a>> {
        // Of the blocks with the least structure, the half with the lower variance is used, since anything but noise only adds
        // variance. The windows of a denoiser's residual are all used, as in the paper.
        let (keep, fewest, lower_half) = match self.method {
            _ if self.windowed || all => (1.0, 8, false),
            Method::Spatial => (0.1, 8, true),
            _ => (0.05, 12, true),
        };
        blocks.sort_by(|a, b| a.structure.total_cmp(&b.structure));
        let n = ((blocks.len() as f32 * keep) as usize).max(fewest).min(blocks.len());
        let others = blocks.split_off(n);
        if n < 4 {
            return None;
        }
        let coarser = blocks.iter().map(|b| b.coarser).sum::<f32>() / n as f32;
        let mut correction = 1.0;
        if lower_half {
            blocks.sort_by(|a, b| a.variance[3].total_cmp(&b.variance[3]));
            blocks.truncate(n / 2);
            correction = 1.0 / LOWER_HALF[level];
        }
        let mean = |f: &dyn Fn(&LocalVariance) -> f32| {
            blocks.iter().map(|b| f(b)).sum::<f32>() / blocks.len() as f32
        };
        let share = match self.method {
            Method::Spatial => 1.0,
            _ if all => 1.0,
            _ => noise_share(level, mean(&|b| b.variance[3]) * correction, coarser, &others),
        };
        let common = std::array::from_fn(|c| {
            let both = mean(&|b| b.with_luma[c]).powi(2);
            (both / (mean(&|b| b.variance[c]) * mean(&|b| b.variance[3])).max(1e-20)).min(most_common[c])
        });
        // The choice of blocks by luma's variance biases a channel as far as the channel correlates with luma.
        let correction =
            std::array::from_fn(|c| share * (1.0 + common.get(c).unwrap_or(&1.0) * (correction - 1.0)));
        Some(Chosen { blocks, common, correction })
    }

    /// The mean variance, in bins of luminance, of the [`NoiseEvidence::chosen`] blocks.
    fn bins(&self, level: usize, most_common: [f32; 3], all: bool) -> Vec<Bin> {
        let of = |(of, blocks)| {
            let Chosen { blocks, common, correction } = self.chosen(level, blocks, most_common, all)?;
            let n = blocks.len() as f32;
            let mean = |f: &dyn Fn(&LocalVariance) -> f32| blocks.iter().map(|b| f(b)).sum::<f32>() / n;
            Some(Bin {
                of,
                y: mean(&|b| b.y),
                variance: std::array::from_fn(|c| {
                    mean(&|b| b.variance[c]) * correction[c] * self.hidden(all)
                }),
                common,
                freedom: blocks.iter().map(|b| b.count).sum(),
                blocks: blocks.len(),
            })
        };
        self.by_luminance(level, all).into_iter().enumerate().filter_map(of).collect()
    }

    /// The brightest encoded value that occurs, if values accumulate there; else 1.
    fn clip_level(&self) -> f32 {
        let total: u64 = self.brightest.iter().sum();
        let Some(top) = (0..256).rev().find(|&i| self.brightest[i] as f64 > 1e-4 * total as f64) else {
            return 1.0;
        };
        let below: u64 = self.brightest[top.saturating_sub(6)..top.saturating_sub(1)].iter().sum();
        let piles_up = self.brightest[top] as f64 > 0.8 * below as f64
            && self.brightest[top] as f64 > 1e-3 * total as f64;
        if piles_up && top > 128 { top as f32 / 255.0 } else { 1.0 }
    }
}

/// [`LumaNoise::coding_error`], given the finest level's bins and the squared correlation of R, G and B with luma: after a coder there is
/// little noise, in some places none, and chroma has no noise of its own from pixel to pixel.
fn coding_error(finest: &[Bin], common: [f32; 3]) -> f32 {
    /// The luminance below which a sensor has less noise even without a coder.
    const DARK: f32 = 0.25;
    /// The largest squared correlation with luma, beyond a channel's share of luma, that channels have by chance.
    const IN_COMMON: f32 = 0.3;
    let squares = LUMA.map(|w| w * w);
    let total: f32 = squares.iter().sum();
    // The correlation of red and blue beyond their share of luma is tested; green is most of luma anyway.
    let beyond = |c: usize| (common[c] - squares[c] / total) / (1.0 - squares[c] / total);
    if beyond(0).min(beyond(2)) > IN_COMMON {
        return MAX_CODING_ERROR;
    }
    let least = |lit: bool| {
        let variance = finest.iter().filter(|b| !lit || b.y >= DARK).map(|b| b.variance[3]);
        variance.min_by(f32::total_cmp).map(|v| v.sqrt() / white_band_std()[0])
    };
    let Some(std) = least(true).or_else(|| least(false)) else { return 0.0 };
    MAX_CODING_ERROR * lost(std).powi(2)
}

/// How surely noise was taken away, in [0, 1], where white noise of this std is left in luma.
pub(super) fn lost(std: f32) -> f32 {
    /// The range of stds from noise that hardly survives the rounding to 8 bits to noise of a sensor.
    const SURVIVING: Range<f32> = 0.0008..0.0025;
    ((SURVIVING.end - std) / (SURVIVING.end - SURVIVING.start)).clamp(0.0, 1.0)
}

/// Fails if the sizes of the two frames differ.
fn check_prediction(frame: &Encoded, prediction: &Encoded) -> Result<()> {
    if prediction.0.size() != frame.0.size() {
        return Err(Error::new("the frame and its version without noise must have one size"));
    }
    Ok(())
}

/// The R, G, B and luma of `frame - prediction`.
fn residual(frame: &Encoded, prediction: &Encoded) -> Result<Raster<[f32; 4]>> {
    check_prediction(frame, prediction)?;
    let (w, h) = frame.0.size();
    Ok(Raster::from_fn(w, h, |x, y| {
        let (a, b) = (frame.0.at(x, y), prediction.0.at(x, y));
        let d: [f32; 3] = std::array::from_fn(|c| a[c] - b[c]);
        [d[0], d[1], d[2], luma(d)]
    }))
}

/// The share of noise in the variance of the chosen blocks of a bin, in [0.25, 1]. It is below 1 if many other blocks match so much
/// worse at the next coarser level that the chosen blocks cannot be expected to match well.
///
/// The variance of a mismatch in this band is a share of that in the coarser band, taken as about the least share in the other blocks.
fn noise_share(level: usize, variance: f32, coarser: f32, others: &[&LocalVariance]) -> f32 {
    let mut ratios: Vec<f32> = others
        .iter()
        .filter(|b| b.coarser > APART[level] * coarser)
        .map(|b| b.variance[3] / b.coarser)
        .collect();
    // The least of a few ratios would be chance.
    if ratios.len() < 20.max(others.len() / 5) {
        return 1.0;
    }
    ratios.sort_by(f32::total_cmp);
    let white = white_band_std();
    // The variance of white noise in the coarser band over that in this band.
    let falls = if level + 1 < NOISE_LEVELS { (white[level + 1] / white[level]).powi(2) } else { 0.25 };
    let mismatch = ratios[ratios.len() / 10] * (coarser - falls * variance).max(0.0);
    (1.0 - mismatch / variance.max(1e-12)).clamp(0.25, 1.0)
}

/// The squared gradient of a smoothed image.
fn squared_gradient(image: &Plane) -> Plane {
    let smooth = filter::gaussian_blur(image, 1.5);
    Plane::from_fn(image.width(), image.height(), |x, y| {
        let at = |dx: isize, dy: isize| smooth.at_clamped(x as isize + dx, y as isize + dy);
        0.25 * ((at(1, 0) - at(-1, 0)).powi(2) + (at(0, 1) - at(0, -1)).powi(2))
    })
}

/// The mean over the square of this side at (x, y).
fn block_mean<P: Pixel>(image: &Raster<P>, (x, y): (usize, usize), side: usize) -> P {
    let mut mean = P::default();
    for y in y..y + side {
        let mut row = P::default();
        image.row(y)[x..x + side].iter().for_each(|&v| row.add_scaled(v, 1.0));
        mean.add_scaled(row, 1.0 / (side * side) as f32);
    }
    mean
}

/// Mean squares of pure noise in the next coarser band differ by less than these factors; the coarsest are means of only four values.
const APART: [f32; NOISE_LEVELS] = [6.0, 6.0, 6.0, 12.0];

/// The largest correlation between successive frames that is believed: beyond it, next to nothing of the noise shows in a difference.
pub(super) const MOST_CORRELATED: f32 = 0.9;

/// The pairs of channels, in the order in which their covariances are kept.
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// The places of a block of this side that are `step` apart, px from its corner.
fn places(side: usize, step: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..side).step_by(step).flat_map(move |y| (0..side).step_by(step).map(move |x| (x, y)))
}

/// Whether so many pixels of a block clip that a part of the noise is lost; `None` if a pixel is unusable. The filters of the coarser bands
/// reach outside the block, so flaws near the block count as well.
fn clipped_block(flaws: &Raster<Flaw>, (x0, y0): (usize, usize), side: usize) -> Option<bool> {
    let most = (MAY_CLIP * (side * side) as f32) as usize;
    let columns = x0.saturating_sub(4)..(x0 + side + 4).min(flaws.width());
    let mut clipped = 0;
    for y in y0.saturating_sub(4)..(y0 + side + 4).min(flaws.height()) {
        for &flaw in &flaws.row(y)[columns.clone()] {
            if flaw == UNUSABLE {
                return None;
            }
            clipped += usize::from(flaw == CLIPPED);
        }
    }
    Some(clipped > most)
}

/// Whether nothing moves between two frames in these rows: the flow is about zero nearly everywhere, and has no direction in common.
fn is_still(flow: &Flow, rows: &Range<usize>) -> bool {
    /// The most of the median motion along an axis, px, and of the motion of a pixel that counts as still, px: a flow that was found among
    /// noise is not exactly zero.
    const MOST: (f32, f32) = (0.03, 0.3);
    let known = || rows.clone().flat_map(|y| flow.row(y)).filter(|f| f[0].is_finite() && f[1].is_finite());
    let all = known().count();
    let slow = known().filter(|[u, v]| u.abs().max(v.abs()) <= MOST.1).count();
    let median = |axis: usize| super::robust::median(known().step_by(7).map(|f| f[axis]).collect());
    all > 0
        && slow * 20 >= all * 19
        && [0, 1].into_iter().all(|axis| median(axis).is_some_and(|m| m.abs() <= MOST.0))
}

/// The mean squares of a band of [`NoiseEvidence::add_blocks`] in a block.
struct Powers {
    /// The mean squares of R, G, B and luma of the residual.
    residual: [f32; 4],
    /// The mean products of R, G and B with luma.
    with_luma: [f32; 3],
    /// The mean products RG, RB and GB of the residual.
    between: [f32; 3],
    /// The mean square of the image itself.
    image: f32,
}

impl Powers {
    /// The powers in the block at (x, y) of this side, both in px of the full image, of a band of this level.
    fn new(band: &Raster<[f32; 4]>, (x, y): (usize, usize), side: usize, level: usize) -> Self {
        let (x, y, side) = (x >> level, y >> level, side >> level);
        let (mut residual, mut with_luma, mut between, mut image) = ([0.0; 4], [0.0; 3], [0.0; 3], 0.0);
        for row in y..y + side {
            for v in &band.row(row)[x..x + side] {
                let d = [v[0], v[1], v[2], luma([v[0], v[1], v[2]])];
                (0..4).for_each(|c| residual[c] += d[c] * d[c]);
                (0..3).for_each(|c| with_luma[c] += d[c] * d[3]);
                (0..3).for_each(|i| between[i] += d[PAIRS[i].0] * d[PAIRS[i].1]);
                image += v[3] * v[3];
            }
        }
        let count = (side * side) as f32;
        Self {
            residual: residual.map(|s| s / count),
            with_luma: with_luma.map(|s| s / count),
            between: between.map(|s| s / count),
            image: image / count,
        }
    }
}

/// The mean products of the finest band's values with their right and their lower neighbours, for R, G and B, in the square at (x, y).
fn products_of_neighbours(band: &Raster<[f32; 4]>, (x0, y0): (usize, usize), side: usize) -> [f32; 3] {
    let mut products = [0.0; 3];
    for (x, y) in places(side, 1).map(|(x, y)| (x0 + x, y0 + y)) {
        let (v, right) = (band.at(x, y), band.at((x + 1).min(band.width() - 1), y));
        let below = band.at(x, (y + 1).min(band.height() - 1));
        (0..3).for_each(|c| products[c] += 0.5 * v[c] * (right[c] + below[c]));
    }
    products.map(|s| s / (side * side) as f32)
}

/// Limits the variances of a coarse level's bins to this share of the finest level's at the same luminance. A small frame may have no bin of
/// that level; then the finest level's bins with this share of their variances stand for them.
fn limit(bins: &mut Vec<Bin>, finest: &[Bin], share: f32) {
    if bins.is_empty() {
        let of = |f: &Bin| Bin { variance: f.variance.map(|v| share * v), ..*f };
        bins.extend(finest.iter().map(of));
    }
    let finest: [Line; 4] = std::array::from_fn(|c| line(finest, c));
    for b in bins {
        for (variance, finest) in b.variance.iter_mut().zip(&finest) {
            *variance = variance.min(finest.at(b.y).powi(2) * share);
        }
    }
}

/// The number of bins of luminance.
const LUMINANCES: usize = 16;

/// The index of the bin of a luminance.
fn luminance_bin(y: f32) -> usize {
    ((y * LUMINANCES as f32) as usize).min(LUMINANCES - 1)
}

/// Blocks of like luminance that are least likely to hold structure.
struct Chosen<'a> {
    blocks: Vec<&'a LocalVariance>,
    /// [`Bin::common`].
    common: [f32; 3],
    /// The factors by which the variances of R, G, B and luma in these blocks fall short of, or exceed, the noise's.
    correction: [f32; 4],
}

/// The mean of the chosen blocks in a bin of luminance.
#[derive(Clone, Copy, Debug)]
struct Bin {
    /// The index of the bin.
    of: usize,
    /// The mean luminance of the blocks.
    y: f32,
    /// The variances of R, G, B and luma.
    variance: [f32; 4],
    /// The squared correlation of R, G and B with luma.
    common: [f32; 3],
    /// The number of values in all the blocks' variances.
    freedom: f32,
    /// The number of blocks.
    blocks: usize,
}

/// The bins of a coarse level that are expected at all luminances of the finest level's bins, if the spectrum of the noise is the same at
/// all luminances. They are needed since the coarse level has few blocks.
fn by_spectrum(bins: &[Bin], finest: &[Bin]) -> Vec<Bin> {
    /// The number of values that leave a std uncertain by 15 %, by which the spectrum may differ between luminances.
    const FREEDOM: f32 = 22.0;
    let pairs: Vec<(&Bin, &Bin)> =
        bins.iter().filter_map(|b| Some((b, finest.iter().find(|f| f.of == b.of)?))).collect();
    let total: f32 = pairs.iter().map(|p| p.0.freedom).sum();
    if total <= 0.0 {
        return vec![];
    }
    // The finest level of a camera that denoises may hold no noise.
    let some = |b: &Bin, c: usize| b.variance[c].max(1e-12);
    let ratio: [f32; 4] = std::array::from_fn(|c| {
        let log = |(b, f): &(&Bin, &Bin)| (some(b, c) / some(f, c)).portable_ln();
        (pairs.iter().map(|p| p.0.freedom * log(p)).sum::<f32>() / total).portable_exp()
    });
    let of = |f: &Bin| Bin {
        variance: std::array::from_fn(|c| ratio[c] * some(f, c)),
        freedom: FREEDOM.min(f.freedom),
        ..*f
    };
    finest.iter().map(of).collect()
}

/// The line `std = slope * Y + intercept`, with the standard errors of slope and intercept.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    slope: f32,
    intercept: f32,
    slope_error: f32,
    intercept_error: f32,
}

impl Line {
    fn at(&self, y: f32) -> f32 {
        (self.slope * y + self.intercept).max(0.0)
    }
}

/// Robust weighted least squares of std on luminance; the line is never negative at Y = 0.
///
/// Anything but noise (structure, bad matches) only adds to the std, so a bin loses weight the farther it lies above the line.
fn line(bins: &[Bin], channel: usize) -> Line {
    let std = |b: &Bin| f64::from(b.variance[channel].sqrt());
    let total: f32 = bins.iter().map(|b| b.freedom).sum();
    let mean_variance = bins.iter().map(|b| b.variance[channel] * b.freedom).sum::<f32>() / total.max(1.0);
    let mut weights: Vec<f64> = bins
        .iter()
        .map(|b| {
            // The std of a std is s / sqrt(2 n). A floor of the variance keeps a bin with little noise by chance from dominating the
            // fit, and a cap of n keeps one crowded bin from outweighing the others, since the line itself is an approximation.
            f64::from(b.freedom.min(4000.0))
                / f64::from(b.variance[channel].max(0.1 * mean_variance).max(1e-10))
        })
        .collect();
    let base = weights.clone();
    let mut fit = Line::default();
    for _ in 0..8 {
        let sum = |f: &dyn Fn(&Bin) -> f64| bins.iter().zip(&weights).map(|(b, w)| w * f(b)).sum::<f64>();
        let sw = sum(&|_| 1.0);
        if sw <= 0.0 {
            return fit;
        }
        let (my, ms) = (sum(&|b| f64::from(b.y)) / sw, sum(&std) / sw);
        // A weak pull towards a constant std is needed, since one bin alone says nothing about the slope.
        let pull = sw * 1e-4;
        let var_y = sum(&|b| (f64::from(b.y) - my).powi(2)) + pull;
        let mut slope = sum(&|b| (f64::from(b.y) - my) * (std(b) - ms)) / var_y;
        let mut intercept = ms - slope * my;
        if intercept < 0.0 {
            (slope, intercept) = (sw * my * ms / (var_y + sw * my * my), 0.0);
        }
        let at = |b: &Bin| (slope * f64::from(b.y) + intercept).max(0.0);
        let misfit = sum(&|b| (std(b) - at(b)).powi(2));
        // Weights are inverse variances up to a scale that the residuals of the line show.
        let scale = (misfit / (bins.len() as f64 - 2.0).max(1.0)).max(0.5);
        fit = Line {
            slope: slope as f32,
            intercept: intercept as f32,
            slope_error: (scale / var_y).sqrt() as f32,
            intercept_error: (scale * (1.0 / sw + my * my / var_y)).sqrt() as f32,
        };
        for ((w, b), base) in weights.iter_mut().zip(bins).zip(&base) {
            let excess = (std(b) / at(b).max(1e-6) - 1.0).max(0.0) / 0.1;
            *w = base / (1.0 + excess * excess);
        }
    }
    fit
}

fn flaw(p: [f32; 3]) -> Flaw {
    if clips(p) { CLIPPED } else { 0 }
}

fn clips(p: [f32; 3]) -> bool {
    p.iter().any(|&v| !(CLIP_MARGIN..=1.0 - CLIP_MARGIN).contains(&v))
}

/// The paper's 9x9 Gaussian window at a level.
fn window_weights(level: usize) -> [[f32; 9]; 9] {
    let sigma = 4.0 / (1 << level) as f32;
    let g: [f32; 9] = std::array::from_fn(|i| (-0.5 * ((i as f32 - 4.0) / sigma).powi(2)).portable_exp());
    let sum: f32 = g.iter().sum();
    std::array::from_fn(|j| std::array::from_fn(|i| g[i] * g[j] / (sum * sum)))
}

/// The square of the mean std under the window over the variance, for white noise. It is below 1 since the subtracted mean is that of the
/// same few values, and since the mean of a root of few values is small. A test below checks the noise that follows.
fn window_bias(level: usize) -> f32 {
    [0.988, 0.968, 0.847, 0.423][level]
}

/// The gain of cubic interpolation at the offset (fx, fy) on the variance of white noise in a band: along each axis
/// `|H|^2 = sum of c_k cos k w`, with c the autocorrelation of the four taps, averaged over the band.
fn cubic_gain(fx: f32, fy: f32, level: usize) -> f32 {
    static MOMENTS: OnceLock<[[[f32; 4]; 4]; NOISE_LEVELS]> = OnceLock::new();
    let moments = &MOMENTS.get_or_init(|| std::array::from_fn(band_moments))[level];
    let correlation = |f: f32| {
        let h = cubic_weights(f);
        let at = |k: usize| (0..4 - k).map(|i| h[i] * h[i + k]).sum::<f32>();
        [at(0), 2.0 * at(1), 2.0 * at(2), 2.0 * at(3)]
    };
    let (x, y) = (correlation(fx), correlation(fy));
    (0..4).map(|i| y[i] * (0..4).map(|j| x[j] * moments[i][j]).sum::<f32>()).sum()
}

/// The means of `cos i wy cos j wx` over the spectrum of white noise in a Laplacian band.
fn band_moments(level: usize) -> [[f32; 4]; 4] {
    const N: usize = 128;
    let low = |w: f64| (6.0 + 8.0 * w.cos() + 2.0 * (2.0 * w).cos()) / 16.0;
    let mut sums = [[0.0; 4]; 4];
    for j in 0..N {
        for i in 0..N {
            let w = [i, j].map(|i| std::f64::consts::PI * (i as f64 + 0.5) / N as f64);
            let gain = |level: usize| w.iter().map(|w| low(w * f64::from(1 << level))).product::<f64>();
            let band = (0..level).map(gain).product::<f64>() * (1.0 - gain(level).powi(2));
            for (a, row) in sums.iter_mut().enumerate() {
                for (b, sum) in row.iter_mut().enumerate() {
                    *sum += band * band * (a as f64 * w[1]).cos() * (b as f64 * w[0]).cos();
                }
            }
        }
    }
    sums.map(|row| row.map(|s| (s / sums[0][0]) as f32))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::strips::strips;

    /// White normal noise (a sum of twelve uniforms), made without the project's own synthesis.
    pub fn white(width: usize, height: usize, seed: u64) -> Raster<[f32; 3]> {
        Raster::from_fn(width, height, |x, y| {
            let at = |c: u64| {
                (0..12)
                    .map(|k| crate::fit::uniform(seed * 36 + 12 * c + k, (y * width + x) as u64))
                    .sum::<f32>()
                    - 6.0
            };
            [at(0), at(1), at(2)]
        })
    }

    fn noisy(width: usize, height: usize, seed: u64, sigma: f32) -> Encoded {
        let n = white(width, height, seed);
        Encoded(Raster::from_fn(width, height, |x, y| {
            let base = 0.2 + 0.5 * x as f32 / width as f32;
            n.at(x, y).map(|n| base + sigma * n)
        }))
    }

    /// The largest relative error over levels, luminances and channels against white noise of this std.
    fn worst(e: &NoiseEvidence, sigma: f32) -> f32 {
        let fit = e.fit();
        let model = fit.model.known().expect("there is evidence");
        let mut worst = 0.0f32;
        for (level, white) in model.lines().levels.iter().zip(white_band_std()) {
            for y in [0.25, 0.45, 0.65] {
                worst =
                    level.sigma(y).iter().map(|s| (s / (sigma * white) - 1.0).abs()).fold(worst, f32::max);
            }
        }
        worst
    }

    #[test]
    fn strips_give_the_variances_of_the_whole_frame() {
        let size @ (w, h) = (150, 717);
        let frame = noisy(w, h, 3, 0.05);
        let values = |x, y| {
            let p = frame.0.at(x, y);
            [p[0], p[1], p[2], luma(p)]
        };
        let flaws = |x, y| if x < 20 && y % 300 < 9 { UNUSABLE } else { flaw(frame.0.at(x, y)) };
        let gain = |x: usize, y: usize, level: usize| 1.0 + 0.01 * (x % 7 + y % 11 + level) as f32;
        let residual = Residual { values, colour: |x, y| frame.0.at(x, y), flaws, gain, pure: false };
        for method in [Method::Temporal, Method::Spatial] {
            let found = |strips: &mut dyn Iterator<Item = Strip>| {
                let mut evidence = NoiseEvidence::new(method);
                strips.for_each(|s| evidence.add_blocks_of(&s, w, &residual));
                assert!(evidence.levels.iter().all(|l| l.len() > 20));
                format!("{:?}", evidence.levels)
            };
            let whole = found(&mut [Strip { rows: 0..h, around: 0..h }].into_iter());
            for rows in [32, 160, 704] {
                assert!(found(&mut strips(size, rows * w)) == whole, "{rows} rows");
            }
            // Negative control: strips without the rows around them give other variances.
            let alone = |s: Strip| Strip { around: s.rows.clone(), rows: s.rows };
            assert!(found(&mut strips(size, 160 * w).map(alone)) != whole);
        }
    }

    #[test]
    fn turns_together_give_the_variances_of_the_whole_frame() {
        const TURNS: usize = 3;
        let (w, h) = (150, 700);
        let [frame, next] = [5, 6].map(|seed| noisy(w, h, seed, 0.05));
        let flow = Flow::filled(w, h, [0.3, -1.2]);
        let found = |add: &dyn Fn(&mut NoiseEvidence)| {
            let mut evidence = NoiseEvidence::new(Method::Temporal);
            add(&mut evidence);
            assert!(evidence.levels.iter().all(|l| l.len() > 20));
            format!("{:?}", evidence.levels)
        };
        let whole = found(&|e| e.add_pair(&frame, &next, &flow).unwrap());
        let in_turns = found(&|e| {
            for i in 0..TURNS {
                e.add_pair_in_turn(&frame, &next, &flow, (i, TURNS)).unwrap();
            }
        });
        assert!(in_turns == whole);
        // Negative control: parts without what is around them.
        let in_parts = found(&|e| {
            let parts = (0..TURNS).map(|i| rows_in_turn(i, TURNS, h));
            parts.for_each(|rows| e.add_pair_rows(&frame, &next, &flow, rows).unwrap());
        });
        assert!(in_parts != whole);
    }

    #[test]
    fn lower_half_constants() {
        let mut e = NoiseEvidence::new(Method::Temporal);
        for seed in 0..4 {
            e.add_pair(
                &noisy(512, 512, seed, 0.02),
                &noisy(512, 512, seed + 10, 0.02),
                &Flow::filled(512, 512, [0.0; 2]),
            )
            .unwrap();
        }
        for (level, constant) in LOWER_HALF.into_iter().enumerate() {
            let mut v: Vec<f32> = e.levels[level].iter().map(|v| v.variance[3]).collect();
            v.sort_by(f32::total_cmp);
            let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
            let ratio = mean(&v[..v.len() / 2]) / mean(&v);
            println!("{level} {ratio}");
            assert!((ratio - constant).abs() < 0.02, "level {level}: {ratio}");
        }
    }

    #[test]
    fn a_still_pair_gives_the_noise_back() {
        let mut e = NoiseEvidence::new(Method::Temporal);
        for seed in 0..2 {
            let still = Flow::filled(512, 512, [0.0; 2]);
            e.add_pair(&noisy(512, 512, seed, 0.02), &noisy(512, 512, seed + 10, 0.02), &still).unwrap();
        }
        assert!(worst(&e, 0.02) < 0.12, "{}", worst(&e, 0.02));
        // Negative control: the measure sees noise that is a fifth too strong.
        assert!(worst(&e, 0.02 / 1.2) > 0.15);
    }

    #[test]
    fn light_that_changes_is_no_noise() {
        // The frames have texture of all sizes, and their exposure grows from frame to frame.
        let wave = |x: usize, y: usize, f: f32| (f * x as f32).sin() * (1.1 * f * y as f32).sin();
        let worst_of = |light: &(dyn Fn(usize) -> f32 + Sync)| {
            let mut e = NoiseEvidence::new(Method::Temporal);
            for seed in 0..2 {
                let lit = |seed: u64, k: &(dyn Fn(usize) -> f32 + Sync)| {
                    let n = noisy(512, 512, seed, 0.01);
                    Encoded(Raster::from_fn(512, 512, |x, y| {
                        let texture: f32 = [0.9, 0.4, 0.2, 0.1].map(|f| 0.03 * wave(x, y, f)).iter().sum();
                        n.0.at(x, y).map(|v| (v + texture + 0.055) * k(x) - 0.055)
                    }))
                };
                let still = Flow::filled(512, 512, [0.0; 2]);
                e.add_pair(&lit(seed, &|_| 1.0), &lit(seed + 10, light), &still).unwrap();
            }
            worst(&e, 0.01)
        };
        assert!(worst_of(&|_| 1.06) < 0.2, "{}", worst_of(&|_| 1.06));
        // Negative control: a brightness that changes from left to right is not undone.
        let sideways = |x: usize| 1.0 + 0.12 * (x as f32 / 40.0).sin();
        assert!(worst_of(&sideways) > 0.5, "{}", worst_of(&sideways));
    }

    #[test]
    fn noise_that_the_channels_share_is_given_back_too() {
        // Grey noise is like the noise that chroma at half the resolution leaves.
        let grey = |seed: u64| Encoded(noisy(512, 512, seed, 0.02).0.map(|p| [p[1]; 3]));
        let mut e = NoiseEvidence::new(Method::Temporal);
        for seed in 0..2 {
            e.add_pair(&grey(seed), &grey(seed + 10), &Flow::filled(512, 512, [0.0; 2])).unwrap();
        }
        assert!(worst(&e, 0.02) < 0.12, "{}", worst(&e, 0.02));
        let common = |e: &NoiseEvidence, c: usize| {
            let sum = |f: &dyn Fn(&LocalVariance) -> f32| e.levels[3].iter().map(f).sum::<f32>();
            sum(&|b| b.with_luma[c]).powi(2) / (sum(&|b| b.variance[c]) * sum(&|b| b.variance[3]))
        };
        assert!((0..3).all(|c| common(&e, c) > 0.99));
        // Negative control: the correlation of independent channels with luma is their share of luma.
        let mut e = NoiseEvidence::new(Method::Temporal);
        let (a, b) = (noisy(512, 512, 0, 0.02), noisy(512, 512, 10, 0.02));
        e.add_pair(&a, &b, &Flow::filled(512, 512, [0.0; 2])).unwrap();
        for (c, share) in [0.2, 0.77, 0.03].into_iter().enumerate() {
            assert!((common(&e, c) - share).abs() < 0.1, "{c}: {}", common(&e, c));
        }
    }

    #[test]
    fn a_coarse_level_keeps_its_noise_where_the_finest_has_none() {
        let bin = |of: usize, variance: f32| Bin {
            of,
            y: of as f32 / 16.0,
            variance: [variance; 4],
            common: [0.0; 3],
            freedom: 100.0,
            blocks: 10,
        };
        let expected = |finest: f32, coarse: f32| {
            let bins = [bin(3, coarse), bin(4, coarse)];
            by_spectrum(&bins, &[bin(3, finest), bin(4, finest), bin(9, finest)])
        };
        for finest in [0.0, 1e-5] {
            for b in expected(finest, 4e-6) {
                assert!((b.variance[1] / 4e-6 - 1.0).abs() < 1e-3, "{b:?}");
            }
        }
        assert_eq!(expected(1e-5, 4e-6).len(), 3);
    }

    #[test]
    fn the_smoothing_of_the_taps_is_accounted_for() {
        // A ramp moves by half a pixel: the flow is exact, and the taps take most of the second frame's finest noise.
        let mut e = NoiseEvidence::new(Method::Temporal);
        let half = Flow::filled(512, 512, [0.5, 0.5]);
        for seed in 0..3 {
            e.add_pair(&noisy(512, 512, seed, 0.03), &noisy(512, 512, seed + 10, 0.03), &half).unwrap();
        }
        assert!(worst(&e, 0.03) < 0.15, "{}", worst(&e, 0.03));
        let gain = |f: f32| cubic_gain(f, f, 0);
        assert!(gain(0.5) < 0.6 && (gain(0.0) - 1.0).abs() < 1e-4, "{}", gain(0.5));
    }

    #[test]
    fn what_moves_otherwise_is_left_out_though_it_is_smooth() {
        // Half of the rows have texture that stays the same; soft light flickers over the other rows.
        let wave = |x: usize, y: usize, f: f32| (f * x as f32).sin() * (1.1 * f * y as f32).sin();
        let mut e = NoiseEvidence::new(Method::Temporal);
        for seed in 0..2 {
            let frame = |seed: u64, light: f32| {
                let still = noisy(512, 512, seed, 0.01);
                Encoded(Raster::from_fn(512, 512, |x, y| {
                    let more = if y % 256 < 128 { 0.03 * wave(x, y, 0.3) } else { light * wave(x, y, 0.2) };
                    still.0.at(x, y).map(|v| v + more)
                }))
            };
            let still = Flow::filled(512, 512, [0.0; 2]);
            e.add_pair(&frame(seed, 0.0), &frame(seed + 10, 0.02), &still).unwrap();
        }
        assert!(worst(&e, 0.01) < 0.25, "{}", worst(&e, 0.01));
    }

    #[test]
    fn leaves_in_the_wind_before_a_still_camera_are_no_noise() {
        // In a part of the picture texture moves to and fro by up to 1.2 px, differently from place to place; the flow says that all is still.
        let texture = white(512, 512, 99).map(|v| [v[0]; 3]);
        let texture = filter::gaussian_blur(&texture, 0.7);
        let worst_of = |leaves: usize, sway: f32| {
            let mut e = NoiseEvidence::new(Method::Temporal);
            for seed in 0..3 {
                let frame = |seed: u64| {
                    let still = noisy(512, 512, seed, 0.01);
                    Encoded(Raster::from_fn(512, 512, |x, y| {
                        let phase = seed as f32 * 1.7;
                        let [dx, dy] = [(x as f32 * 0.05 + phase).sin(), (y as f32 * 0.06 - phase).cos()]
                            .map(|v| sway * v);
                        let more = if y < leaves { 0.12 } else { 0.0 };
                        let t = texture
                            .cubic((x as f32 + dx).clamp(0.0, 511.0), (y as f32 + dy).clamp(0.0, 511.0));
                        still.0.at(x, y).map(|v| v + more * t[0])
                    }))
                };
                let still = Flow::filled(512, 512, [0.0; 2]);
                e.add_pair(&frame(seed), &frame(seed + 10), &still).unwrap();
            }
            (e.is_pure(), worst(&e, 0.01))
        };
        for leaves in [200, 300] {
            let (pure, worst) = worst_of(leaves, 1.2);
            assert!(!pure && worst < 0.35, "{leaves}: {pure} {worst}");
        }
        // Where the same texture stands still, all blocks count.
        let (pure, worst) = worst_of(300, 0.0);
        assert!(pure && worst < 0.12, "{worst}");
    }

    #[test]
    fn a_mismatch_is_subtracted_as_far_as_it_is_seen_and_noise_is_not() {
        let block = |variance: f32, coarser: f32| LocalVariance {
            y: 0.5,
            variance: [variance; 4],
            with_luma: [0.0; 3],
            structure: 0.0,
            coarser,
            count: 16.0,
            colours: Colours::default(),
            between: [0.0; 3],
            neighbours: [0.0; 3],
            texture: 0.0,
            coarser_power: 0.0,
            pure: false,
            clipped: false,
        };
        let falls = (white_band_std()[2] / white_band_std()[1]).powi(2);
        // The blocks have noise of variance 1 and a mismatch of half the variance that it has in the coarser band.
        let mismatched: Vec<_> = (20..60).map(|m| block(1.0 + 0.5 * m as f32, falls + m as f32)).collect();
        let share = noise_share(1, 2.0, falls + 2.0, &mismatched.iter().collect::<Vec<_>>());
        assert!((share - 0.5).abs() < 0.1, "{share}");
        let noise: Vec<_> = (0..60).map(|i| block(1.0, falls * (0.5 + i as f32 / 60.0))).collect();
        assert_eq!(noise_share(1, 1.0, 0.5 * falls, &noise.iter().collect::<Vec<_>>()), 1.0);
    }

    #[test]
    fn coarse_noise_is_not_taken_for_a_mismatch() {
        let levels = [0.01, 0.02, 0.03, 0.03];
        let white = white_band_std();
        let levels =
            std::array::from_fn(|l| NoiseLevel { slope: [0.0; 3], intercept: [levels[l] * white[l]; 3] });
        let model = NoiseModel::given(levels, 1.0);
        let clean = noisy(512, 512, 0, 0.0);
        let noise = |i: u64| crate::synth::noise::noise(&model, &clean.0, 5, i);
        let frame = |i: u64| {
            let noise = noise(i);
            Encoded(Raster::from_fn(512, 512, |x, y| {
                let (v, n) = (clean.0.at(x, y), noise.at(x, y));
                std::array::from_fn(|c| v[c] + n[c])
            }))
        };
        let mut e = NoiseEvidence::new(Method::Temporal);
        for i in 0..3 {
            e.add_pair(&frame(2 * i), &frame(2 * i + 1), &Flow::filled(512, 512, [0.0; 2])).unwrap();
        }
        let found = e.fit().model;
        // The levels of the synthesis overlap, so the truth is the power of the synthesised noise in each band.
        let (bands, _) = pyramid::laplacian(&noise(0), NOISE_LEVELS);
        for (found, band) in found.known().expect("there is evidence").lines().levels.iter().zip(&bands) {
            let power = band.data().iter().map(|v| v[1] * v[1]).sum::<f32>() / band.data().len() as f32;
            let ratio = found.sigma(0.45)[1] / power.sqrt();
            assert!((ratio - 1.0).abs() < 0.15, "{ratio}");
        }
    }

    /// A picture of all luminances, in three hues.
    fn colourful() -> Encoded {
        Encoded(Raster::from_fn(512, 384, |x, y| {
            let v = 0.15 + 0.7 * x as f32 / 512.0;
            let hue = [[1.0, 0.9, 0.4], [0.4, 1.0, 0.6], [0.5, 0.5, 1.0]][y / 128];
            hue.map(|h| h * v)
        }))
    }

    /// Noise as a camera makes it: coarser than white, mostly shared by the channels, and stronger where the picture is red.
    fn camera_noise(clean: &Encoded, seed: u64) -> Raster<[f32; 3]> {
        let (w, h) = clean.0.size();
        let own = white(w, h, seed);
        let coarse = filter::gaussian_blur(&white(w, h, seed + 1000), 1.2);
        Raster::from_fn(w, h, |x, y| {
            let (o, s, v) = (own.at(x, y), coarse.at(x, y), clean.0.at(x, y));
            let shared = 0.7 * o[1] + 2.0 * s[1];
            std::array::from_fn(|c| 0.01 * (0.5 + v[0]) * (shared + 0.3 * o[c] + 0.8 * s[c]))
        })
    }

    fn sum(clean: &Encoded, noise: &Raster<[f32; 3]>) -> Encoded {
        let (w, h) = clean.0.size();
        Encoded(Raster::from_fn(w, h, |x, y| {
            let (v, n) = (clean.0.at(x, y), noise.at(x, y));
            std::array::from_fn(|c| v[c] + n[c])
        }))
    }

    /// The std of G in six parts of each level, and the correlation of R and G in each level.
    fn look(noise: &Raster<[f32; 3]>) -> ([[f32; 6]; NOISE_LEVELS], [f32; NOISE_LEVELS]) {
        let (bands, _) = pyramid::laplacian(noise, NOISE_LEVELS);
        let parts = |l: usize| {
            let (w, h) = (bands[l].width() / 2, bands[l].height() / 3);
            std::array::from_fn(|i| {
                let part = bands[l].crop(i % 2 * w, i / 2 * h, w, h);
                (part.data().iter().map(|v| v[1] * v[1]).sum::<f32>() / (w * h) as f32).sqrt()
            })
        };
        let correlation = |l: usize| {
            let sum = |a: usize, b: usize| bands[l].data().iter().map(|v| v[a] * v[b]).sum::<f32>();
            sum(0, 1) / (sum(0, 0) * sum(1, 1)).sqrt()
        };
        (std::array::from_fn(parts), std::array::from_fn(correlation))
    }

    #[test]
    fn a_camera_s_noise_is_made_again_as_strong_as_coarse_and_as_grey() {
        let clean = colourful();
        let mut e = NoiseEvidence::new(Method::Removal);
        for seed in 0..3 {
            e.add_residual(&sum(&clean, &camera_noise(&clean, seed)), &clean, &clean).unwrap();
        }
        let found = e.fit().model;
        let model = found.known().expect("there is evidence");
        let (stds, correlations) = look(&camera_noise(&clean, 77));
        let off = |model: &NoiseModel| {
            let (got, shared) = look(&crate::synth::noise::noise(model, &clean.0, 3, 0));
            let ratio = |(got, want): (&f32, &f32)| (got / want - 1.0).abs();
            let worst = got.as_flattened().iter().zip(stds.as_flattened()).map(ratio).fold(0.0, f32::max);
            let apart = shared.iter().zip(&correlations).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            (worst, apart)
        };
        let (worst, apart) = off(model);
        assert!(worst < 0.2 && apart < 0.1, "{worst} {apart}");
        // Negative control: straight lines know neither colour nor what the channels share, and lose coarse noise.
        let (worst, apart) = off(&NoiseModel::Lines(model.lines().clone()));
        assert!(worst > 0.3 && apart > 0.4, "{worst} {apart}");
    }

    #[test]
    fn noise_that_stays_for_some_frames_is_found_and_made_again() {
        let clean = colourful();
        let made = |correlation: f32| {
            let mut last = camera_noise(&clean, 100);
            let frames: Vec<Encoded> = (0..6)
                .map(|t| {
                    let new = camera_noise(&clean, 101 + t);
                    let mixed = |x, y| {
                        let (a, b): ([f32; 3], [f32; 3]) = (last.at(x, y), new.at(x, y));
                        std::array::from_fn(|c| {
                            correlation * a[c] + (1.0 - correlation * correlation).sqrt() * b[c]
                        })
                    };
                    last = Raster::from_fn(512, 384, mixed);
                    sum(&clean, &last)
                })
                .collect();
            let mut e = NoiseEvidence::new(Method::Temporal);
            for pair in frames.windows(2) {
                e.add_pair(&pair[0], &pair[1], &Flow::filled(512, 384, [0.0; 2])).unwrap();
            }
            for three in frames.windows(3) {
                e.add_successive([&three[0], &three[1], &three[2]]);
            }
            e.fit().model.known().expect("there is evidence").clone()
        };
        let strong = |model: &NoiseModel| look(&crate::synth::noise::noise(model, &clean.0, 1, 5)).0[0][3];
        let shared = |model: &NoiseModel| {
            let [a, b] = [7, 8].map(|t| crate::synth::noise::noise(model, &clean.0, 1, t));
            let sum = |a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>| {
                a.data().iter().zip(b.data()).map(|(a, b)| a[1] * b[1]).sum::<f32>()
            };
            sum(&a, &b) / (sum(&a, &a) * sum(&b, &b)).sqrt()
        };
        let want = look(&camera_noise(&clean, 77)).0[0][3];
        let stays = made(0.6);
        assert!((stays.temporal_correlation() - 0.6).abs() < 0.08, "{}", stays.temporal_correlation());
        assert!((shared(&stays) - 0.6).abs() < 0.1, "{}", shared(&stays));
        assert!((strong(&stays) / want - 1.0).abs() < 0.15, "{} {want}", strong(&stays));
        // Negative control: the noise of independent frames is not found to stay.
        let boils = made(0.0);
        // The straight lines have the whole noise as well; a difference of frames that share it shows 0.63 of its std.
        let ratio = stays.std(0, 0.4)[1] / boils.std(0, 0.4)[1];
        assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
        assert!(boils.temporal_correlation() < 0.1 && shared(&boils) < 0.1);
        assert!((strong(&boils) / want - 1.0).abs() < 0.15, "{} {want}", strong(&boils));
    }

    #[test]
    fn the_paper_s_windows_give_the_noise_back() {
        let mut e = NoiseEvidence::new(Method::Removal);
        let clean = noisy(512, 512, 0, 0.0);
        for seed in 0..3 {
            e.add_denoised(&noisy(512, 512, seed, 0.02), &clean).unwrap();
        }
        assert!(worst(&e, 0.02) < 0.12, "{}", worst(&e, 0.02));
    }

    #[test]
    fn a_small_single_frame_has_the_noise_of_all_levels_and_its_channels_what_they_share() {
        // All channels are the same, as after a camera has removed the noise of colour.
        let std = 0.02;
        for (w, h, levels_with_blocks) in [(96, 96, 2), (128, 128, 4)] {
            let noise = white(w, h, 5);
            let grey = Encoded(noise.map(|n| [0.5 + std * n[1]; 3]));
            let mut e = NoiseEvidence::new(Method::Spatial);
            e.add_single(&grey);
            let found = (0..NOISE_LEVELS).filter(|&l| !e.bins(l, [1.0; 3], false).is_empty()).count();
            assert!(found >= levels_with_blocks, "{found}");
            let fit = e.fit();
            let Estimate::Known(NoiseModel::Curves(curves)) = fit.model else {
                panic!("{w} x {h}: no curves, {found} levels")
            };
            let luma = fit.luma.expect("it is known");
            for (l, white) in white_band_std().into_iter().enumerate() {
                let of_lines = curves.lines.levels[l].sigma(0.5)[1] / (std * white);
                let of_luma = luma.levels[l].intercept + 0.5 * luma.levels[l].slope;
                assert!((0.5..1.5).contains(&of_lines), "level {l}: {of_lines} of the noise");
                assert!((0.5..1.5).contains(&(of_luma / (std * white))), "level {l}: {of_luma}");
            }
            let [a, b] = [0, 1].map(|c| curves.levels[0].mixing[c]);
            let product = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f32>();
            let shared = product(a, b) / (product(a, a) * product(b, b)).sqrt();
            assert!(shared > 0.9, "the channels share {shared}");
        }
    }

    #[test]
    fn a_flat_single_frame_gives_the_noise_back() {
        let mut e = NoiseEvidence::new(Method::Spatial);
        (0..4).for_each(|seed| e.add_single(&noisy(512, 512, seed, 0.02)));
        assert!(worst(&e, 0.02) < 0.12, "{}", worst(&e, 0.02));
    }

    #[test]
    fn saturated_frames_give_no_noise_but_the_clip_level() {
        let mut e = NoiseEvidence::new(Method::Spatial);
        e.add_single(&Encoded(Raster::filled(128, 128, [1.0; 3])));
        assert!(e.fit().model.why_unknown().is_some());
        let mut e = NoiseEvidence::new(Method::Spatial);
        let clipped = noisy(256, 256, 3, 0.05).0.map(|p| p.map(|v| v.min(0.6)));
        e.add_single(&Encoded(clipped));
        assert!((e.clip_level() - 0.6).abs() < 0.01, "{}", e.clip_level());
    }
}
