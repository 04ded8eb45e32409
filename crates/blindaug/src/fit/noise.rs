//! The estimate of the noise std over luminance, for each pyramid level and channel, from motion-compensated differences of frames, from
//! the flattest parts of single frames, or from the residual of a denoiser.
//!
//! All three methods collect local variances of the Laplacian bands of a residual (`collect`); [`NoiseEvidence::fit`] chooses those that
//! hold least else (`choose`) and lays the model through them: curves over the picture's colour (`curves`), and the 24 numbers of the
//! paper's lines, each with an interval (`lines`).

mod choose;
mod collect;
mod curves;
mod lines;
mod mismatch;

use self::choose::Chosen;
use self::curves::{Colours, Spectrum};
use self::lines::{Bin, PULL, by_spectrum, coding_error, in_common, limit, line, squared_correlation};
pub(super) use self::lines::{MAX_CODING_ERROR, lost};
use super::robust::median;
use crate::model::{
    Estimate, Method, NOISE_LEVELS, NoiseCurves, NoiseInterval, NoiseLevel, NoiseLines, NoiseModel, Reason,
};
use crate::portable::Portable;
use crate::synth::noise::white_band_std;
use crate::{Encoded, Pixel, Transfer};
use std::ops::Range;

/// The least errors of a coder, as a std of luma of full scale 1, of which the user is told.
pub(super) const NOTABLE_CODING_ERROR: f32 = 0.01;

/// The variance of one band in one block (or window) of one residual.
#[derive(Clone, Copy, Debug, Default)]
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
    /// The power of the picture's own texture, of which the residual may hold a share: [`curves::Block::texture`].
    texture: f32,
    /// The mean power of luma in the next coarser band of the two frames, with their noise.
    coarser_power: f32,
    /// Whether the residual is known to hold nothing but noise.
    pure: bool,
    /// Whether so many pixels clip that a part of the noise is lost.
    clipped: bool,
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
    /// The std of the logarithm of the factor by which the noise of compressed footage is off, which is the same in all of its frames and which the
    /// model's interval does not hold yet. 0 where nothing tells of a coder.
    pub coding_spread: f32,
    /// The std of the logarithm of another such factor, by which noise is off that was measured in single frames, whose flat parts hold some
    /// texture, or less noise than the rest. 0 for noise between frames or beside clean ones.
    pub single_spread: f32,
}

impl NoiseFit {
    /// The std of the logarithm of the factor by which the noise of all frames is off alike, for [`NoiseModel::allow_for`].
    pub fn shared_spread(&self) -> f32 {
        self.coding_spread.portable_hypot(self.single_spread)
    }

    /// The same fit with a [`coding_spread`](Self::coding_spread) of at least this.
    pub(super) fn with_coding_spread(mut self, least: f32) -> Self {
        self.coding_spread = self.coding_spread.max(least);
        self
    }
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

    /// How surely a coder has taken away noise, in [0, 1].
    pub(super) fn lost(&self) -> f32 {
        (self.coding_error / MAX_CODING_ERROR).sqrt()
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
    /// The curve that encodes the frames.
    transfer: Transfer,
    /// Whether the variances are those of the paper's windows, which are used without a choice or a correction.
    windowed: bool,
    /// Whether all flat parts of the picture count, rather than those that match best, or that are flattest of all.
    flat: bool,
    /// The number of blocks of [`collect::COPIED`] px that were compared between two frames and could show noise, and how many of these were the same.
    compared: [usize; 2],
    levels: [Vec<LocalVariance>; NOISE_LEVELS],
    /// The histogram of the 8-bit value of each pixel's brightest channel.
    brightest: Box<[u64; 256]>,
    /// The encoded values at which R, G and B end: 1, or more in footage that goes beyond, as scene-linear plates do.
    white: [f32; 3],
    /// Whether any pixel is not grey.
    coloured: bool,
    /// The correlations of noise between successive frames that were measured.
    successive: Vec<f32>,
}

/// The std, in encoded values, of noise that cannot be seen: a quarter of a step of 8 bits.
pub const UNSEEN_STD: f32 = 0.25 / 255.0;

/// The std of the logarithm of the std on a grey card, over what is told, where a coder was surely at work, in 330 clips of 15 photographs by
/// eleven coders (docs/lab-log.md): a coder keeps noise where the picture has texture and takes it where it has none, and not every picture
/// has flat parts.
pub(super) const CODING_SPREAD: f32 = 0.45;

/// The std of the logarithm of the true std over what single frames tell, in images by simulated cameras (docs/lab-log.md): where neighbouring
/// pixels are independent, so that the flattest parts hold white noise and no texture, and where neighbouring pixels are alike.
const SINGLE_SPREAD: [f32; 2] = [0.2, 0.4];

/// The pull towards a constant std ([`lines::line`]) of the lines of single frames, in whose bright or dark parts more texture is taken for
/// noise. Without it, lines of images with few flat parts lead far off at other luminances (docs/lab-log.md).
const PULL_OF_SINGLE: f32 = 3e-3;

/// The largest correlation between successive frames that is believed: beyond it, next to nothing of the noise shows in a difference.
pub(super) const MOST_CORRELATED: f32 = 0.9;

/// The pairs of channels, in the order in which their covariances are kept.
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

impl NoiseEvidence {
    /// No evidence yet; `method` is [`Method::Temporal`], [`Method::Spatial`] or [`Method::Removal`].
    pub fn new(method: Method) -> Self {
        Self {
            method,
            transfer: Transfer::Srgb,
            windowed: false,
            flat: false,
            compared: [0; 2],
            levels: Default::default(),
            brightest: Box::new([0; 256]),
            white: [1.0; 3],
            coloured: false,
            successive: vec![],
        }
    }

    /// The same for frames that are encoded by this curve, sRGB by default: what little noise a coder has left, and what a sensor makes, differ
    /// between curves.
    pub fn encoded_by(self, transfer: Transfer) -> Self {
        Self { transfer, ..self }
    }

    /// The evidence of a single frame alone.
    pub fn of_frame(frame: &Encoded) -> Self {
        let mut evidence = Self::new(Method::Spatial);
        evidence.add_single(frame);
        evidence
    }

    /// No evidence yet of compressed footage. A coder copies or smooths some blocks and renews others, and those that match best, or that have
    /// least structure, were copied or smoothed: so all flat parts of the picture count. `method` is [`Method::Temporal`], for differences of
    /// frames that lie apart along the flow, or [`Method::Spatial`].
    pub(super) fn of_flat_parts(method: Method) -> Self {
        Self { flat: true, ..Self::new(method) }
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

    /// Adds the evidence of another collection of the same method, whose curve it takes.
    pub fn merge(&mut self, other: &Self) {
        self.transfer = other.transfer;
        self.windowed |= other.windowed;
        self.flat |= other.flat;
        (0..2).for_each(|i| self.compared[i] += other.compared[i]);
        self.coloured |= other.coloured;
        (0..3).for_each(|c| self.white[c] = self.white[c].max(other.white[c]));
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
        self.fit_to(curves::ENOUGH)
    }

    /// [`NoiseEvidence::fit`] with curves through at most `most` blocks of each level.
    // Long, since the lines of all levels lean on the finest one's bins, and the curves and the coder's errors on both.
    pub(super) fn fit_to(&self, most: usize) -> NoiseFit {
        let finest = self.finest();
        if finest.is_empty() {
            let (reason, why) = match self.method {
                Method::Temporal => {
                    (Reason::NotFollowed, "no part of the frames could be followed from one to the next")
                }
                _ => (
                    Reason::Flat,
                    "the frames are too small, clipped everywhere, or have too few parts that are about as bright",
                ),
            };
            return NoiseFit {
                model: Estimate::unknown(reason, why),
                luma: None,
                points: vec![],
                coding_spread: 0.0,
                single_spread: 0.0,
            };
        }
        let of_single_frames = self.method == Method::Spatial && !self.flat;
        let pull = if of_single_frames { PULL_OF_SINGLE } else { PULL };
        let pure = self.is_pure();
        let camera_share = (self.method == Method::Spatial).then(|| self.camera_share());
        let single = camera_share.map(Spectrum::between_white_and_camera);
        let white = white_band_std();
        let mut points = vec![];
        let mut levels = [NoiseLevel::default(); NOISE_LEVELS];
        let mut interval = [NoiseInterval::default(); NOISE_LEVELS];
        let mut luma = [NoiseLine::default(); NOISE_LEVELS];
        // A mismatch is common to all channels, and the finest level holds least of it.
        let max_squared_correlation = squared_correlation(&finest);
        for level in 0..NOISE_LEVELS {
            let mut bins =
                if level == 0 { finest.clone() } else { self.bins(level, max_squared_correlation, false) };
            let measured = bins.clone();
            if self.method == Method::Spatial && level > 0 {
                // For estimators that look at luma, coarse noise is at most that of white noise: to take structure for noise would blind
                // them.
                limit(&mut bins, &finest, (white[level] / white[0]).powi(2));
            }
            let expected = if level == 0 || self.windowed { vec![] } else { by_spectrum(&bins, &finest) };
            let of_line: Vec<Bin> = bins.iter().copied().chain(expected).collect();
            let l = line(&of_line, 3, PULL);
            luma[level] = NoiseLine { slope: l.slope, intercept: l.intercept };
            // Where a residual holds nothing but noise, a choice of quiet blocks would only make the noise too weak.
            let of_line = if pure {
                bins = self.bins(level, [1.0; 3], true);
                bins.clone()
            } else if let (Some(single), 1..) = (&single, level) {
                bins = measured;
                limit(&mut bins, &finest, single.ratios[level].powi(2));
                bins.clone()
            } else {
                of_line
            };
            for c in 0..3 {
                let l = line(&of_line, c, pull);
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
        let kind = curves::BlockKind { pure, of_single_frames, prior: single.as_ref() };
        let model = match curves::fit(&self.blocks(pure), lines.clone(), kind, most) {
            Some(curves) => NoiseModel::Curves(Box::new(NoiseCurves {
                temporal_correlation: if pure { self.temporal_correlation() } else { 0.0 },
                ..curves
            })),
            None => NoiseModel::Lines(lines),
        };
        // The flattest blocks of single frames, through which their lines go, hold least noise.
        let model = if of_single_frames { model.with_agreeing_lines() } else { model };
        let coding_error = self.coding_error_by(&finest);
        let luma = LumaNoise { levels: luma, coding_error };
        let [white, camera] = SINGLE_SPREAD;
        NoiseFit {
            model: Estimate::Known(model),
            luma: Some(luma),
            points,
            coding_spread: CODING_SPREAD * luma.lost(),
            single_spread: camera_share.map_or(0.0, |share| white + share * (camera - white)),
        }
    }

    /// Whether a coder may have taken away any of the noise, or has copied so much that there is too little to tell.
    pub(super) fn may_hide_noise(&self) -> bool {
        let finest = self.finest();
        finest.is_empty() || self.is_copied() || self.coding_error_by(&finest) > 0.0
    }

    /// Whether so much of one frame is the same in the next one that a coder must have copied it: noise that shows is never the same.
    pub(super) fn is_copied(&self) -> bool {
        /// The least share of the blocks.
        const SHARE: f32 = 0.25;
        let [all, same] = self.compared;
        same as f32 > SHARE * all as f32
    }

    /// The finest level's bins; none if there are too few variances.
    fn finest(&self) -> Vec<Bin> {
        if self.is_enough() { self.bins(0, [1.0; 3], false) } else { vec![] }
    }

    /// [`LumaNoise::coding_error`], given the finest level's bins.
    fn coding_error_by(&self, finest: &[Bin]) -> f32 {
        /// The largest squared correlations of red and blue with luma ([`in_common`]) in the two finest levels, that they have by chance or since
        /// chroma has half the resolution.
        const IN_COMMON: [f32; 2] = [0.3, 0.2];
        match self.method {
            Method::Temporal => {
                // In grey footage noise is common to all channels: that says nothing of a coder. Chroma of half the resolution has no noise from pixel
                // to pixel either, but coarser noise, which a coder takes away, too. Both levels have the same blocks.
                let has_no_chroma = self.coloured
                    && in_common(finest) > IN_COMMON[0]
                    && in_common(&self.bins(1, [1.0; 3], false)) > IN_COMMON[1];
                coding_error(finest, self.transfer, has_no_chroma)
            }
            // Remaining structure is common to all channels.
            Method::Spatial => coding_error(finest, self.transfer, false),
            // The difference from the clean frame includes a coder's errors, so no others are allowed for.
            _ => 0.0,
        }
    }

    /// How much the noise of single frames is taken to have the spectrum of a camera's, from 0, white noise, to 1. Coarse noise cannot be told
    /// from structure there, but whether a sensor with a colour filter array made the noise can: interpolation makes neighbouring pixels
    /// alike, in all channels, where the picture is flat.
    fn camera_share(&self) -> f32 {
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
        share.clamp(0.0, 1.0)
    }

    /// The factor by which noise exceeds what a difference of frames shows of it: what successive frames share does not show.
    fn shared_noise_factor(&self, pure: bool) -> f32 {
        if pure { 1.0 / (1.0 - self.temporal_correlation()) } else { 1.0 }
    }

    /// The correlation of noise between successive frames, 0 to [`MOST_CORRELATED`]; 0 where it was not measured.
    fn temporal_correlation(&self) -> f32 {
        let measured = median(self.successive.clone());
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
        median(
            blocks
                .iter()
                .map(|b| 0.5 * b.variance[3].max(1e-10).portable_ln() - std(b.y).portable_ln())
                .collect(),
        )
    }

    /// The brightest encoded value that occurs, if values accumulate there or go beyond 1; else 1.
    fn clip_level(&self) -> f32 {
        let white = self.white.into_iter().fold(1.0, f32::max);
        if white > 1.0 {
            return white;
        }
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

#[cfg(test)]
pub(crate) mod tests;
