//! The choice of the blocks that hold nothing but noise, or as little else as can be.

use super::curves::Block;
use super::{LocalVariance, NoiseEvidence, PAIRS};
use crate::fit::robust::median;
use crate::model::{Method, NOISE_LEVELS};
use crate::portable::Portable;
use crate::synth::noise::white_band_std;

/// The mean of the lower half of the blocks' variances over the mean of all, for pure noise, for each level. It is below 1 since
/// variances of few values scatter widely. A test checks these numbers.
pub(super) const LOWER_HALF: [f32; NOISE_LEVELS] = [0.93, 0.84, 0.821, 0.658];

/// Mean squares of pure noise in the next coarser band differ by less than these factors; the coarsest are means of only four values.
const APART: [f32; NOISE_LEVELS] = [6.0, 6.0, 6.0, 12.0];

/// The share of the blocks of a luminance that are the flat parts of the picture, and the fewest.
const FLATTEST: (f32, usize) = (0.25, 8);

/// The number of bins of luminance from 0 to 1.
const UP_TO_ONE: usize = 16;

/// The number of all bins of luminance: three from 1 to 2, a third of an octave wide each, and one for all above 2.
const LUMINANCES: usize = UP_TO_ONE + 4;

/// Blocks of like luminance that are least likely to hold structure.
pub(super) struct Chosen<'a> {
    pub(super) blocks: Vec<&'a LocalVariance>,
    /// [`Bin::squared_correlation`].
    pub(super) squared_correlation: [f32; 3],
    /// The factors by which the variances of R, G, B and luma in these blocks fall short of, or exceed, the noise's.
    pub(super) correction: [f32; 4],
}

impl NoiseEvidence {
    /// The blocks of a level that are known to hold nothing but noise. Where nothing moves between two frames, light may still flicker and
    /// small things may move; that shows in the next coarser band, in which noise is weaker.
    pub(super) fn pure_blocks(&self, level: usize) -> Vec<&LocalVariance> {
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
        /// The most of a block's variance, over the median.
        const MOST: f32 = 2.0;
        fn undoubted(mut blocks: Vec<&LocalVariance>) -> Vec<&LocalVariance> {
            // By a band of its own, since the chance by which some blocks have less noise than others must not choose them; and by the power
            // of the frames, since little of the texture is left in a mean of frames that do not match.
            blocks.sort_by(|a, b| a.coarser_power.total_cmp(&b.coarser_power));
            blocks.truncate(((FLATTEST.0 * blocks.len() as f32) as usize).max(FLATTEST.1));
            if let Some(usual) = median(blocks.iter().map(|b| b.variance[3]).collect()) {
                blocks.retain(|b| b.variance[3] <= MOST * usual);
            }
            blocks
        }
        let mut bins: [Vec<&LocalVariance>; LUMINANCES] = Default::default();
        self.sound_blocks(level).for_each(|b| bins[luminance_bin(b.y)].push(b));
        bins.into_iter().flat_map(undoubted).collect()
    }

    /// Puts the rank of each block among those of its frame that are about as bright, in [0, 1], in place of its structure, so that the same share
    /// of each frame's blocks is chosen where frames are put together. A coder leaves less of everything in some frames: all that is chosen would
    /// be theirs. The blocks must be those of one whole frame.
    pub(in crate::fit) fn rank(&mut self) {
        for blocks in &mut self.levels {
            let mut bins: [Vec<&mut LocalVariance>; LUMINANCES] = Default::default();
            blocks.iter_mut().for_each(|b| bins[luminance_bin(b.y)].push(b));
            for mut bin in bins {
                bin.sort_by(|a, b| a.structure.total_cmp(&b.structure));
                let count = bin.len() as f32;
                bin.iter_mut().enumerate().for_each(|(i, b)| b.structure = (i as f32 + 0.5) / count);
            }
        }
    }

    /// The mean variance of the finest level's luma where the picture has least texture; `None` if there are no such parts.
    pub(in crate::fit) fn flat_power(&self) -> Option<f32> {
        let blocks = self.flat_blocks(0);
        let sum: f32 = blocks.iter().map(|b| b.variance[3]).sum();
        (!blocks.is_empty()).then(|| sum / blocks.len() as f32)
    }

    /// The share of the picture's power by which two frames differ, beyond noise, in the half of the blocks with most texture, in the band
    /// next to the finest level: 0 if the picture was found again, up to 1 if it was not; without this share of these blocks, those that
    /// differ most. `None` without blocks.
    pub(in crate::fit) fn mismatch(&self, without: f32) -> Option<f32> {
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
    pub(super) fn is_pure(&self) -> bool {
        /// The least share of blocks in which nothing flickers or moves.
        const CALM: f32 = 0.85;
        /// The most by which the variance where the picture has most texture exceeds that where it has least. Of noise it was 0.8 to 1.2 in
        /// coded footage of a camera that stands still, of leaves in the wind 2.4.
        const BY_TEXTURE: f32 = 1.8;
        if self.flat {
            return self.method == Method::Temporal;
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
    pub(super) fn blocks(&self, pure: bool) -> [Vec<Block>; NOISE_LEVELS] {
        let block = |b: &LocalVariance, correction: [f32; 3]| Block {
            colours: b.colours,
            covariance: std::array::from_fn(|i| match i {
                0..3 => b.variance[i] * correction[i],
                _ => b.between[i - 3] * (correction[PAIRS[i - 3].0] * correction[PAIRS[i - 3].1]).sqrt(),
            }),
            texture: b.texture,
            count: b.count,
        };
        let factor = self.shared_noise_factor(pure);
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
                let noise = |b| Block { texture: 0.0, ..block(b, [factor; 3]) };
                self.pure_blocks(level).into_iter().map(noise).collect()
            }
            _ => self.sound_blocks(level).map(|b| block(b, [1.0; 3])).collect(),
        })
    }

    /// The blocks in which no more than a few pixels clip, by luminance.
    pub(super) fn by_luminance(&self, level: usize, pure: bool) -> [Vec<&LocalVariance>; LUMINANCES] {
        let mut bins: [Vec<&LocalVariance>; LUMINANCES] = Default::default();
        let blocks = if pure { self.pure_blocks(level) } else { self.sound_blocks(level).collect() };
        for v in blocks.into_iter().filter(|b| !b.clipped) {
            bins[luminance_bin(v.y)].push(v);
        }
        bins
    }

    /// Of blocks of like luminance those that are least likely to hold structure, or all; `None` if there are too few.
    /// `max_squared_correlation` limits [`Bin::squared_correlation`].
    pub(super) fn chosen<'a>(
        &self,
        level: usize,
        mut blocks: Vec<&'a LocalVariance>,
        max_squared_correlation: [f32; 3],
        all: bool,
    ) -> Option<Chosen<'a>> {
        // Of the blocks with the least structure, the half with the lower variance is used, since anything but noise only adds
        // variance. The windows of a denoiser's residual are all used, as in the paper.
        let (keep, fewest, lower_half) = match self.method {
            _ if self.windowed || all => (1.0, 8, false),
            Method::Spatial if self.flat => (FLATTEST.0, FLATTEST.1, false),
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
        let squared_correlation = std::array::from_fn(|c| {
            let both = mean(&|b| b.with_luma[c]).powi(2);
            (both / (mean(&|b| b.variance[c]) * mean(&|b| b.variance[3])).max(1e-20))
                .min(max_squared_correlation[c])
        });
        // The choice of blocks by luma's variance biases a channel as far as the channel correlates with luma.
        let correction = std::array::from_fn(|c| {
            share * (1.0 + squared_correlation.get(c).unwrap_or(&1.0) * (correction - 1.0))
        });
        Some(Chosen { blocks, squared_correlation, correction })
    }
}

/// The share of noise in the variance of the chosen blocks of a bin, in [0.25, 1]. It is below 1 if many other blocks match so much
/// worse at the next coarser level that the chosen blocks cannot be expected to match well.
///
/// The variance of a mismatch in this band is a share of that in the coarser band, taken as about the least share in the other blocks.
pub(super) fn noise_share(level: usize, variance: f32, coarser: f32, others: &[&LocalVariance]) -> f32 {
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

/// The index of the bin of a luminance.
fn luminance_bin(y: f32) -> usize {
    match y < 1.0 {
        true => (y * UP_TO_ONE as f32) as usize,
        false => (UP_TO_ONE + (3.0 * y.portable_log2()) as usize).min(LUMINANCES - 1),
    }
}
