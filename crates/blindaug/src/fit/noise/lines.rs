//! The lines of the paper's model: std over luminance, through the mean variances of the chosen blocks.

use super::choose::Chosen;
use super::{LocalVariance, NoiseEvidence};
use crate::portable::Portable;
use crate::synth::noise::white_band_std;
use crate::{LUMA, Transfer};
use std::ops::Range;

/// The luminance below which a sensor has less noise even without a coder.
pub(super) const DARK: f32 = 0.25;

/// The errors of H.264 at a quality that is just bearable, as a std of luma of full scale 1. The quality of a coder is not known, and to
/// allow for larger errors than there are costs little (docs/lab-log.md).
pub(in crate::fit) const MAX_CODING_ERROR: f32 = 0.045;

/// The pull of lines towards a constant std, without which one bin alone would say nothing about the slope.
pub(super) const PULL: f32 = 1e-4;

/// The mean of the chosen blocks in a bin of luminance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bin {
    /// The index of the bin.
    pub(super) index: usize,
    /// The mean luminance of the blocks.
    pub(super) y: f32,
    /// The variances of R, G, B and luma.
    pub(super) variance: [f32; 4],
    /// The squared correlation of R, G and B with luma.
    pub(super) squared_correlation: [f32; 3],
    /// The number of values in all the blocks' variances.
    pub(super) values: f32,
    /// The number of blocks.
    pub(super) blocks: usize,
}

/// The line `std = slope * Y + intercept`, with the standard errors of slope and intercept.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Line {
    pub(super) slope: f32,
    pub(super) intercept: f32,
    pub(super) slope_error: f32,
    pub(super) intercept_error: f32,
}

impl Line {
    fn at(&self, y: f32) -> f32 {
        (self.slope * y + self.intercept).max(0.0)
    }
}

impl NoiseEvidence {
    /// The mean variance, in bins of luminance, of the [`NoiseEvidence::chosen`] blocks.
    pub(super) fn bins(&self, level: usize, max_squared_correlation: [f32; 3], all: bool) -> Vec<Bin> {
        let of = |(index, blocks)| {
            let Chosen { blocks, squared_correlation, correction } =
                self.chosen(level, blocks, max_squared_correlation, all)?;
            let n = blocks.len() as f32;
            let mean = |f: &dyn Fn(&LocalVariance) -> f32| blocks.iter().map(|b| f(b)).sum::<f32>() / n;
            Some(Bin {
                index,
                y: mean(&|b| b.y),
                variance: std::array::from_fn(|c| {
                    mean(&|b| b.variance[c]) * correction[c] * self.shared_noise_factor(all)
                }),
                squared_correlation,
                values: blocks.iter().map(|b| b.count).sum(),
                blocks: blocks.len(),
            })
        };
        self.by_luminance(level, all).into_iter().enumerate().filter_map(of).collect()
    }
}

/// Limits the variances of a coarse level's bins to this share of the finest level's at the same luminance. A small frame may have no bin of
/// that level; then the finest level's bins with this share of their variances stand for them.
pub(super) fn limit(bins: &mut Vec<Bin>, finest: &[Bin], share: f32) {
    if bins.is_empty() {
        let of = |f: &Bin| Bin { variance: f.variance.map(|v| share * v), ..*f };
        bins.extend(finest.iter().map(of));
    }
    let finest: [Line; 4] = std::array::from_fn(|c| line(finest, c, PULL));
    for b in bins {
        for (variance, finest) in b.variance.iter_mut().zip(&finest) {
            *variance = variance.min(finest.at(b.y).powi(2) * share);
        }
    }
}

/// The bins of a coarse level that are expected at all luminances of the finest level's bins, if the spectrum of the noise is the same at
/// all luminances. They are needed since the coarse level has few blocks.
pub(super) fn by_spectrum(bins: &[Bin], finest: &[Bin]) -> Vec<Bin> {
    /// The number of values that leave a std uncertain by 15 %, by which the spectrum may differ between luminances.
    const VALUES: f32 = 22.0;
    let pairs: Vec<(&Bin, &Bin)> =
        bins.iter().filter_map(|b| Some((b, finest.iter().find(|f| f.index == b.index)?))).collect();
    let total: f32 = pairs.iter().map(|p| p.0.values).sum();
    if total <= 0.0 {
        return vec![];
    }
    // The finest level of a camera that denoises may hold no noise.
    let some = |b: &Bin, c: usize| b.variance[c].max(1e-12);
    let ratio: [f32; 4] = std::array::from_fn(|c| {
        let log = |(b, f): &(&Bin, &Bin)| (some(b, c) / some(f, c)).portable_ln();
        (pairs.iter().map(|p| p.0.values * log(p)).sum::<f32>() / total).portable_exp()
    });
    let of = |f: &Bin| Bin {
        variance: std::array::from_fn(|c| ratio[c] * some(f, c)),
        values: VALUES.min(f.values),
        ..*f
    };
    finest.iter().map(of).collect()
}

/// Robust weighted least squares of std on luminance; the line is never negative at Y = 0.
///
/// Anything but noise (structure, bad matches) only adds to the std, so a bin loses weight the farther it lies above the line. `pull`, at least
/// [`PULL`], draws the line towards a constant std in the end: the slope of bins whose luminances have this variance is halved.
pub(super) fn line(bins: &[Bin], channel: usize, pull: f32) -> Line {
    /// The number of times that the bins are weighted anew.
    const TURNS: usize = 8;
    let std = |b: &Bin| f64::from(b.variance[channel].sqrt());
    let total: f32 = bins.iter().map(|b| b.values).sum();
    let mean_variance = bins.iter().map(|b| b.variance[channel] * b.values).sum::<f32>() / total.max(1.0);
    let mut weights: Vec<f64> = bins
        .iter()
        .map(|b| {
            // The std of a std is s / sqrt(2 n). A floor of the variance keeps a bin with little noise by chance from dominating the
            // fit, and a cap of n keeps one crowded bin from outweighing the others, since the line itself is an approximation.
            f64::from(b.values.min(4000.0))
                / f64::from(b.variance[channel].max(0.1 * mean_variance).max(1e-10))
        })
        .collect();
    let base = weights.clone();
    let mut fit = Line::default();
    for turn in 1..=TURNS {
        // A pull in between would make bins seem to lie above the line that only lie on a steep one.
        let pull = f64::from(if turn == TURNS { pull } else { PULL });
        let sum = |f: &dyn Fn(&Bin) -> f64| bins.iter().zip(&weights).map(|(b, w)| w * f(b)).sum::<f64>();
        let sw = sum(&|_| 1.0);
        if sw <= 0.0 {
            return fit;
        }
        let (my, ms) = (sum(&|b| f64::from(b.y)) / sw, sum(&std) / sw);
        let var_y = sum(&|b| (f64::from(b.y) - my).powi(2)) + sw * pull;
        let mut slope = sum(&|b| (f64::from(b.y) - my) * (std(b) - ms)) / var_y;
        let mut intercept = ms - slope * my;
        if intercept < 0.0 {
            let squares = sum(&|b| f64::from(b.y).powi(2)).max(f64::MIN_POSITIVE);
            (slope, intercept) = (sum(&|b| f64::from(b.y) * std(b)) / squares, 0.0);
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

/// The mean of the bins' squared correlations of R, G and B with luma.
pub(super) fn squared_correlation(bins: &[Bin]) -> [f32; 3] {
    let values: f32 = bins.iter().map(|b| b.values).sum();
    std::array::from_fn(|c| {
        bins.iter().map(|b| b.values * b.squared_correlation[c]).sum::<f32>() / values.max(1.0)
    })
}

/// The squared correlation of the noise of red and blue with luma's beyond their share of luma, of the channel that has less; green is most of
/// luma anyway.
pub(super) fn in_common(bins: &[Bin]) -> f32 {
    let squares = LUMA.map(|w| w * w);
    let total: f32 = squares.iter().sum();
    let squared = squared_correlation(bins);
    let beyond = |c: usize| (squared[c] - squares[c] / total) / (1.0 - squares[c] / total);
    beyond(0).min(beyond(2))
}

/// [`LumaNoise::coding_error`], given the finest level's bins and whether chroma has no noise of its own: after a coder there is little noise, in
/// some places none, and none in chroma. `transfer` is the curve that encodes the frames: noise counts as it would be in sRGB, since a log
/// curve makes the noise of bright parts weaker than sRGB does.
pub(super) fn coding_error(finest: &[Bin], transfer: Transfer, has_no_chroma: bool) -> f32 {
    if has_no_chroma {
        return MAX_CODING_ERROR;
    }
    let least = |lit: bool| {
        let in_srgb = |b: &Bin| {
            let light = transfer.decode_by(b.y, Portable::portable_powf);
            let [own, srgb] = [transfer, Transfer::Srgb].map(|t| t.slope_by(light, Portable::portable_powf));
            b.variance[3].sqrt() * (srgb / own)
        };
        let std = finest.iter().filter(|b| !lit || b.y >= DARK).map(in_srgb);
        std.min_by(f32::total_cmp).map(|std| std / white_band_std()[0])
    };
    let Some(std) = least(true).or_else(|| least(false)) else { return 0.0 };
    MAX_CODING_ERROR * lost(std).powi(2)
}

/// How surely noise was taken away, in [0, 1], where white noise of this std is left in luma.
pub(in crate::fit) fn lost(std: f32) -> f32 {
    /// The range of stds from noise that hardly survives the rounding to 8 bits to noise of a sensor.
    const SURVIVING: Range<f32> = 0.0008..0.0025;
    ((SURVIVING.end - std) / (SURVIVING.end - SURVIVING.start)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::super::PULL_OF_SINGLE;
    use super::*;

    /// Bins at these luminances of noise of this std.
    fn bins(luminances: &[f32], std: impl Fn(f32) -> f32) -> Vec<Bin> {
        let bin = |&y: &f32| Bin {
            index: 0,
            y,
            variance: [std(y).powi(2); 4],
            squared_correlation: [0.0; 3],
            values: 1000.0,
            blocks: 10,
        };
        luminances.iter().map(bin).collect()
    }

    #[test]
    fn steep_lines_are_given_back() {
        let luminances = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];
        for (slope, intercept) in [(0.02, 0.001), (-0.01, 0.02), (0.05, 0.002)] {
            let all = bins(&luminances, |y| slope * y + intercept);
            for (pull, within) in [(PULL, 0.01), (PULL_OF_SINGLE, 0.1)] {
                for y in [0.1, 0.5, 0.9] {
                    let ratio = line(&all, 0, pull).at(y) / (slope * y + intercept);
                    // In the dark, the pull makes the most of a std that is next to nothing.
                    let floor = if slope > 0.0 && y < 0.2 { 3.0 * within } else { within };
                    assert!((ratio - 1.0).abs() < floor, "{slope} {intercept} {pull} at {y}: {ratio}");
                }
            }
        }
        // A line that would be negative in the dark goes through 0, and is as near as such a line can be.
        let through_zero = line(&bins(&luminances, |y| 0.02 * y - 0.0005), 0, PULL);
        assert_eq!(through_zero.intercept, 0.0);
        assert!((through_zero.at(0.5) / 0.0095 - 1.0).abs() < 0.05, "{through_zero:?}");
    }

    #[test]
    fn two_luminances_of_single_frames_do_not_lead_far_off_at_others() {
        // A little more texture at the brighter one.
        let two = bins(&[0.3, 0.36], |y| if y < 0.33 { 0.01 } else { 0.012 });
        let at = |pull: f32| line(&two, 0, pull).at(0.9);
        assert!(at(PULL_OF_SINGLE) < 0.02 && at(PULL) > 0.025, "{} {}", at(PULL_OF_SINGLE), at(PULL));
    }

    #[test]
    fn a_sensor_s_noise_in_log_values_is_not_what_a_coder_left() {
        let light_noise = |light: f32| (0.0008f32.powi(2) + 6e-5 * light).sqrt();
        for transfer in [Transfer::LogC3, Transfer::SLog3, Transfer::VLog] {
            let of_sensor = bins(&[0.3, 0.4, 0.5, 0.6, 0.7], |y| {
                let light = transfer.decode(y);
                white_band_std()[0] * light_noise(light) * transfer.slope(light)
            });
            assert_eq!(coding_error(&of_sensor, transfer, false), 0.0, "{transfer:?}");
            // Negative controls: so little noise in sRGB is what a coder leaves, and so is a fifth of it in log values.
            assert!(coding_error(&of_sensor, Transfer::Srgb, false) > 0.0, "{transfer:?}");
            let left: Vec<Bin> =
                of_sensor.iter().map(|b| Bin { variance: b.variance.map(|v| 0.04 * v), ..*b }).collect();
            assert!(coding_error(&left, transfer, false) > 0.0, "{transfer:?}");
        }
    }
}
