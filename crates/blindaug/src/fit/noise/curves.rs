//! From local covariances of noise to [`NoiseCurves`]: curves over the picture's colour by non-negative least squares, and the mixture of
//! independent noises that gives the channels their correlation.

use super::PAIRS;
use crate::LUMA;
use crate::fit::linear::{cholesky, solved};
use crate::model::{
    CurveLevel, KNOTS, NOISE_KNOTS, NOISE_LEVELS, NoiseCurves, NoiseLevel, NoiseLines, place,
};
use crate::portable::Portable;
use wide::f32x4;

/// The number of points of the three curves of one channel.
const POINTS: usize = 3 * NOISE_KNOTS;

/// The unknowns of one channel's fit: the points of its curves, and the share of the picture's texture that a residual between moving
/// frames holds because the frames do not match to the last fraction of a px.
const UNKNOWNS: usize = POINTS + 1;

/// The encoded colours in a block: for each channel, the share of each of a curve's points in the mean of the curve over the block, of
/// 255. A block at an edge has noise of both sides, which its mean colour would not tell.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Colours([[u8; NOISE_KNOTS]; 3]);

impl Colours {
    /// The colours of the pixels.
    pub fn of(pixels: impl Iterator<Item = [f32; 3]>) -> Self {
        let mut shares = [[0.0f32; NOISE_KNOTS]; 3];
        let mut count = 0.0f32;
        for pixel in pixels {
            count += 1.0;
            for (shares, v) in shares.iter_mut().zip(pixel) {
                let (i, t) = place(v);
                shares[i] += 1.0 - t;
                shares[i + 1] += t;
            }
        }
        Self(shares.map(|shares| shares.map(|s| (255.0 * s / count.max(1.0)).round() as u8)))
    }

    /// The shares, which may sum to a little more or less than 1 by rounding.
    fn shares(&self) -> impl Iterator<Item = f32> + '_ {
        self.0.as_flattened().iter().map(|&s| f32::from(s) / 255.0)
    }

    /// The mean variances of R, G and B over the block, if they are these over the greys of [`KNOTS`] and each channel counts as much as in luma.
    fn over_luma(&self, over_grey: &[[f32; 3]; NOISE_KNOTS]) -> [f32; 3] {
        let mut mean = [0.0; 3];
        for (i, share) in self.shares().enumerate() {
            let (weight, variance) = (LUMA[i / NOISE_KNOTS] * share, over_grey[i % NOISE_KNOTS]);
            (0..3).for_each(|c| mean[c] += weight * variance[c]);
        }
        mean
    }

    /// The mean variances of R, G and B over the block.
    fn variance(&self, level: &CurveLevel) -> [f32; 3] {
        level.variance.map(|curves| {
            let shares = self.0.as_flattened().iter().map(|&s| f32::from(s));
            curves.as_flattened().iter().zip(shares).map(|(v, s)| v * s).sum::<f32>() / 255.0
        })
    }
}

/// The covariance of one band in one block of one residual.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    /// The encoded colours in the block.
    pub colours: Colours,
    /// The variances of R, G and B, and the covariances RG, RB and GB, for a residual of unit gain.
    pub covariance: [f32; 6],
    /// The power of the picture's own texture in the same band beyond its noise, which a residual between moving frames may hold a share
    /// of; 0 if the residual is known to hold noise alone.
    pub texture: f32,
    /// The number of values.
    pub count: f32,
}

/// What noise has in its coarse levels, over what it has in the finest one.
pub(super) struct Spectrum {
    /// The std of each level over that of the finest one.
    pub ratios: [f32; NOISE_LEVELS],
    /// The correlation of the channels in each level, as a share of their correlation in the finest one plus a constant.
    correlations: [(f64, f64); NOISE_LEVELS],
}

impl Spectrum {
    /// The spectrum of white noise (share 0), of the noise of cameras with a colour filter array (share 1), or between the two.
    /// Demosaicing and removal of noise take from fine grain, and of colour more than of brightness: coarse noise is stronger than white
    /// noise has it, and its channels have little in common. Means over the cameras that were looked at, docs/lab-log.md.
    pub fn between_white_and_camera(share: f32) -> Self {
        const CAMERA: [f32; NOISE_LEVELS] = [1.0, 0.51, 0.32, 0.2];
        const CORRELATIONS: [(f64, f64); NOISE_LEVELS] = [(1.0, 0.0), (0.65, 0.0), (0.2, -0.1), (0.0, -0.15)];
        let white = crate::synth::noise::white_band_std();
        let share64 = f64::from(share);
        Self {
            ratios: std::array::from_fn(|l| {
                let white: f32 = white[l] / white[0];
                white * (CAMERA[l] / white).portable_powf(share)
            }),
            correlations: CORRELATIONS.map(|(k, c)| (1.0 + share64 * (k - 1.0), share64 * c)),
        }
    }
}

/// The number of blocks of a level beyond which more tell hardly more, and take time.
pub(super) const ENOUGH: usize = 6000;

/// What is known of the blocks through which curves are laid.
#[derive(Clone, Copy)]
pub(super) struct BlockKind<'a> {
    /// Whether the residuals hold nothing but noise.
    pub pure: bool,
    /// Whether they are the flattest blocks of single frames that no coder made.
    pub of_single_frames: bool,
    /// The spectrum by which coarse levels follow from the finest one where their blocks show more, so that only the finest level needs blocks.
    pub prior: Option<&'a Spectrum>,
}

/// The curves through at most `most` blocks of each level; `None` if a level has fewer than eight blocks.
pub(super) fn fit(
    levels: &[Vec<Block>; NOISE_LEVELS],
    lines: NoiseLines,
    BlockKind { pure, of_single_frames, prior }: BlockKind,
    most: usize,
) -> Option<NoiseCurves> {
    let measured = if prior.is_some() { 1 } else { NOISE_LEVELS };
    if levels[..measured].iter().any(|blocks| blocks.len() < 8) {
        return None;
    }
    let mut fitted = [CurveLevel::default(); NOISE_LEVELS];
    let mut covariances = [[[0.0; 3]; 3]; NOISE_LEVELS];
    let mut typical = [[0.0f64; 3]; NOISE_LEVELS];
    for (l, blocks) in levels.iter().enumerate() {
        if let (Some(spectrum), 1..) = (prior, l) {
            let finest = fitted[0].variance;
            fitted[l].variance = limited(&finest, blocks, spectrum.ratios[l].powi(2));
            typical[l] = typical_covariance(&evenly(&levels[0], most), &fitted[l]).0;
            let (k, constant) = spectrum.correlations[l];
            covariances[l] = std::array::from_fn(|a| {
                std::array::from_fn(|b| {
                    let finest = covariances[0][a][b] / (typical[0][a] * typical[0][b]);
                    let correlation = if a == b { 1.0 } else { (k * finest + constant).clamp(-0.45, 0.98) };
                    correlation * typical[l][a] * typical[l][b]
                })
            });
            continue;
        }
        let rows = Rows::of(blocks, most);
        let over_grey = OverGrey::new(&lines.levels[l], &rows, of_single_frames);
        for (curves, points) in fitted[l].variance.iter_mut().zip(curves_of(&rows, &over_grey, pure)) {
            for (curve, points) in curves.iter_mut().zip(points.chunks_exact(NOISE_KNOTS)) {
                curve.copy_from_slice(points);
            }
        }
        (typical[l], covariances[l]) = typical_covariance(&rows.blocks, &fitted[l]);
    }
    let mixing = mixing(&covariances)?;
    for l in 0..NOISE_LEVELS {
        fitted[l].mixing = std::array::from_fn(|c| {
            mixing[l][c].map(|m| (m / typical[l][c].max(1e-9)).clamp(-16.0, 16.0) as f32)
        });
    }
    Some(NoiseCurves { lines, levels: fitted, temporal_correlation: 0.0 })
}

/// The finest level's curves times `share`, or times what the blocks show if that is less.
fn limited(
    finest: &[[[f32; NOISE_KNOTS]; 3]; 3],
    blocks: &[Block],
    share: f32,
) -> [[[f32; NOISE_KNOTS]; 3]; 3] {
    let level = CurveLevel { variance: *finest, ..Default::default() };
    let mut shown = [0.0f32; 3];
    let mut expected = [1e-12f32; 3];
    for b in blocks {
        let variance = b.colours.variance(&level);
        // Each block counts alike, whatever its colour.
        let scale = 1.0 / variance.iter().sum::<f32>().max(1e-10);
        for c in 0..3 {
            shown[c] += scale * b.covariance[c];
            expected[c] += scale * variance[c];
        }
    }
    std::array::from_fn(|c| {
        let share = if blocks.is_empty() { share } else { share.min(shown[c] / expected[c]) };
        finest[c].map(|curve| curve.map(|v| share * v))
    })
}

/// At most `most` of the blocks, evenly spread over all.
fn evenly(all: &[Block], most: usize) -> Vec<&Block> {
    all.iter().step_by(all.len().div_ceil(most).max(1)).collect()
}

/// The blocks through which curves are laid, with the coefficients of each that are not 0 and the unknowns that these belong to: the colours of
/// a block lie near few of the curves' points.
struct Rows<'a> {
    blocks: Vec<&'a Block>,
    coefficients: Vec<(u8, f32)>,
    /// The end of each block's coefficients.
    ends: Vec<usize>,
}

impl<'a> Rows<'a> {
    /// At most `most` of the blocks, evenly spread over all.
    fn of(all: &'a [Block], most: usize) -> Self {
        let blocks = evenly(all, most);
        let (mut coefficients, mut ends) = (vec![], vec![]);
        // Texture counts in the unit of the blocks' mean variance, so that all unknowns are of one size.
        let all: f32 = blocks.iter().flat_map(|b| &b.covariance[..3]).sum();
        let unit = 3.0 * blocks.len() as f32 / all.max(1e-12);
        for b in &blocks {
            let row = (0..).zip(b.colours.shares().chain([unit * b.texture]));
            coefficients.extend(row.filter(|(_, v)| *v != 0.0));
            ends.push(coefficients.len());
        }
        Self { blocks, coefficients, ends }
    }

    fn iter(&self) -> impl Iterator<Item = (&Block, &[(u8, f32)])> {
        let starts = [0].into_iter().chain(self.ends.iter().copied());
        let rows = starts.zip(&self.ends).map(|(start, &end)| &self.coefficients[start..end]);
        self.blocks.iter().copied().zip(rows)
    }
}

/// The variance that curves should have over grey. Blocks tell the noise over the picture's own colours; what they leave open, such as the noise
/// over grey in a picture without grey, the lines over luminance tell (docs/lab-log.md, "Noise over colours that are not there").
struct OverGrey {
    /// The variances of R, G and B over the grey of each of [`KNOTS`].
    variance: [[f32; 3]; NOISE_KNOTS],
    /// The weight of each grey, as a share of the mean weight of a curve's point.
    weight: f64,
}

impl OverGrey {
    /// The weights of lines of single frames and of pairs.
    const WEIGHTS: (f64, f64) = (0.03, 0.01);

    /// The variance over grey that a level's lines tell. Lines of single frames go through the flattest blocks alone, and tell only how the noise
    /// depends on the luminance: their std is scaled to the mean std of the blocks.
    fn new(lines: &NoiseLevel, rows: &Rows, single: bool) -> Self {
        let mut variance = KNOTS.map(|y| lines.sigma(y).map(|std| std * std));
        let (of_single, of_pairs) = Self::WEIGHTS;
        if !single {
            return Self { variance, weight: of_pairs };
        }
        let mut ratios = [0.0f32; 3];
        for b in &rows.blocks {
            let of_grey = b.colours.over_luma(&variance);
            (0..3).for_each(|c| ratios[c] += (b.covariance[c].max(0.0) / of_grey[c].max(1e-8)).sqrt());
        }
        let scale = ratios.map(|sum| (sum / rows.blocks.len() as f32).powi(2));
        variance = variance.map(|v| std::array::from_fn(|c| scale[c] * v[c]));
        Self { variance, weight: of_single }
    }
}

/// For each channel, the points of the three curves whose sum is its variance: weighted non-negative least squares, with weights from the
/// variance that the curves themselves predict, drawn towards the variance over grey. The channels are fitted side by side, since they have the same coefficients.
fn curves_of(rows: &Rows, over_grey: &OverGrey, pure: bool) -> [[f32; POINTS]; 3] {
    /// A curve's successive points are pulled together by this share of the mean weight of a point, so that points without blocks follow
    /// their neighbours.
    const SMOOTH: f64 = 2e-3;
    /// The texture in a residual may differ from block to block by more than the noise does; a block whose variance is above the prediction
    /// by this many of its standard errors counts half.
    const OUTLIER: f32 = 4.0;
    /// The change of a point, as a share of the mean variance, that is none.
    const SAME: f64 = 1e-4;
    /// The weights are found through every fifth block first, which brings the points near to where all blocks have them.
    const STEPS: [usize; 6] = [5, 5, 5, 5, 1, 1];
    let means: [f64; 3] = std::array::from_fn(|c| {
        let sum: f64 = rows.blocks.iter().map(|b| f64::from(b.covariance[c])).sum();
        (sum / rows.blocks.len() as f64).max(1e-12)
    });
    // Variances are those of R, G and B over their means.
    let scale = means.map(|m| (1.0 / m) as f32);
    let variance = |b: &Block| {
        f32x4::from([scale[0] * b.covariance[0], scale[1] * b.covariance[1], scale[2] * b.covariance[2], 0.0])
    };
    let predicted = |row: &[(u8, f32)], x: &[f32x4; UNKNOWNS]| {
        row.iter().fold(f32x4::ZERO, |sum, &(i, a)| sum + x[usize::from(i)] * f32x4::splat(a))
    };
    let lanes = |x: &[[f64; UNKNOWNS]; 3]| -> [f32x4; UNKNOWNS] {
        std::array::from_fn(|i| f32x4::from([x[0][i] as f32, x[1][i] as f32, x[2][i] as f32, 0.0]))
    };
    let mut x = [[1.0 / 3.0; UNKNOWNS]; 3];
    x.iter_mut().for_each(|x| x[POINTS] = 0.0);
    for step in STEPS {
        let mut normal = vec![f32x4::ZERO; UNKNOWNS * UNKNOWNS];
        let mut right = vec![f32x4::ZERO; UNKNOWNS];
        let now = lanes(&x);
        for (b, row) in rows.iter().step_by(step) {
            let (variance, all) = (variance(b), predicted(row, &now));
            // The share of texture differs from block to block by about as much as it is.
            let texture = match row.last() {
                Some(&(i, a)) if usize::from(i) == POINTS => now[POINTS] * f32x4::splat(a),
                _ => f32x4::ZERO,
            };
            let of_noise = all.max(f32x4::splat(0.02)) * f32x4::splat((2.0 / b.count).sqrt());
            let error = (of_noise * of_noise + texture * texture).sqrt();
            let mut weight = f32x4::ONE / (error * error);
            if !pure {
                let above = (variance - all).max(f32x4::ZERO) / (f32x4::splat(OUTLIER) * error);
                weight /= f32x4::ONE + above * above;
            }
            for (k, &(i, a)) in row.iter().enumerate() {
                let weighted = weight * f32x4::splat(a);
                right[usize::from(i)] += weighted * variance;
                let normal = &mut normal[UNKNOWNS * usize::from(i)..];
                row[..=k].iter().for_each(|&(j, b)| normal[usize::from(j)] += weighted * f32x4::splat(b));
            }
        }
        let mut same = true;
        for (c, x) in x.iter_mut().enumerate() {
            let of = |v: &f32x4| f64::from(v.as_array()[c]);
            let mut normal: Vec<f64> = normal.iter().map(of).collect();
            // The upper half mirrors the lower one.
            for (i, j) in (0..UNKNOWNS).flat_map(|i| (0..i).map(move |j| (i, j))) {
                normal[UNKNOWNS * j + i] = normal[UNKNOWNS * i + j];
            }
            let diagonal = normal.iter().step_by(UNKNOWNS + 1).take(POINTS);
            let of_point = diagonal.sum::<f64>() / POINTS as f64;
            let weight = SMOOTH * of_point;
            for i in (0..POINTS).filter(|i| (i + 1) % NOISE_KNOTS != 0) {
                for (a, b, sign) in [(i, i, 1.0), (i + 1, i + 1, 1.0), (i, i + 1, -1.0), (i + 1, i, -1.0)] {
                    normal[UNKNOWNS * a + b] += sign * weight;
                }
            }
            let weight = over_grey.weight * of_point;
            let mut right: Vec<f64> = right.iter().map(of).collect();
            for (i, grey) in over_grey.variance.iter().enumerate() {
                let points = [0, 1, 2].map(|k| NOISE_KNOTS * k + i);
                for a in points {
                    points.iter().for_each(|b| normal[UNKNOWNS * a + b] += weight);
                    right[a] += weight * f64::from(scale[c] * grey[c]);
                }
            }
            let next = non_negative(&normal, &right, *x);
            same &= next.iter().zip(&*x).all(|(next, x)| (next - x).abs() <= SAME);
            *x = next;
        }
        if same && step == 1 {
            break;
        }
    }
    // The weights favour quiet blocks, but noise alone has its whole power.
    let now = lanes(&x);
    let mut sums = [0.0f64; 3];
    for (_, row) in rows.iter() {
        sums.iter_mut().zip(predicted(row, &now).to_array()).for_each(|(sum, v)| *sum += f64::from(v));
    }
    std::array::from_fn(|c| {
        let whole = if pure { (rows.blocks.len() as f64 / sums[c].max(1e-12)).clamp(0.5, 2.0) } else { 1.0 };
        std::array::from_fn(|i| (means[c] * whole * x[c][i]) as f32)
    })
}

/// The vector without negative entries that minimises x A x / 2 - b x for a symmetric A, row by row (Lawson & Hanson 1974), from `x`.
fn non_negative(a: &[f64], b: &[f64], mut x: [f64; UNKNOWNS]) -> [f64; UNKNOWNS] {
    /// The least that an entry, as a share of the largest one, must gain to be no longer 0.
    const NONE: f64 = 1e-9;
    let own = |i: usize| a[UNKNOWNS * i + i];
    let mut free: [bool; UNKNOWNS] = std::array::from_fn(|i| x[i] > 0.0 && own(i) > 0.0);
    for _ in 0..4 * UNKNOWNS {
        let Some(best) = solved_freely(a, b, &free) else { return x };
        let falls = |i: &usize| free[*i] && best[*i] < 0.0;
        if let Some(share) =
            (0..UNKNOWNS).filter(falls).map(|i| x[i] / (x[i] - best[i])).min_by(f64::total_cmp)
        {
            // On the way there, some entries come to 0 first.
            for i in 0..UNKNOWNS {
                if free[i] && best[i] < 0.0 && x[i] / (x[i] - best[i]) <= share {
                    (x[i], free[i]) = (0.0, false);
                } else if free[i] {
                    x[i] += share * (best[i] - x[i]);
                }
            }
            continue;
        }
        x = best;
        let most = x.iter().copied().fold(0.0, f64::max);
        let gain = |i: usize| {
            let row = &a[UNKNOWNS * i..][..UNKNOWNS];
            let slope = row.iter().zip(&x).map(|(a, x)| a * x).sum::<f64>() - b[i];
            -slope / own(i)
        };
        let held = (0..UNKNOWNS).filter(|&i| !free[i] && own(i) > 0.0).map(|i| (gain(i), i));
        match held.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((gain, i)) if gain > NONE * most => free[i] = true,
            _ => return x,
        }
    }
    x
}

/// The typical std of each channel over the blocks, and the covariance of the channels where each has that std.
///
/// A covariance of two channels is their correlation times their stds, and a share of the picture's texture, which is common to the
/// channels: both by least squares.
fn typical_covariance(blocks: &[&Block], level: &CurveLevel) -> ([f64; 3], [[f64; 3]; 3]) {
    let mut variances = [0.0f64; 3];
    let mut sums = [Products::default(); PAIRS.len()];
    for b in blocks {
        let variance = b.colours.variance(level).map(f64::from);
        for (sum, v) in variances.iter_mut().zip(variance) {
            *sum += v / blocks.len() as f64;
        }
        // The share of texture differs from block to block, so those with more texture than noise count little.
        let texture = f64::from(b.texture);
        let weight = f64::from(b.count) / (variances_mean(&variance).max(1e-12) + texture).powi(2);
        for ((sum, covariance), (i, j)) in sums.iter_mut().zip(&b.covariance[3..]).zip(PAIRS) {
            let stds = (variance[i] * variance[j]).max(0.0).sqrt();
            sum.add(weight, [stds, texture], f64::from(*covariance));
        }
    }
    let std = variances.map(|v| v.max(1e-14).sqrt());
    let [rg, rb, gb] = sums.map(|s| s.first_coefficient().clamp(-0.98, 0.98));
    let correlations = [[1.0, rg, rb], [rg, 1.0, gb], [rb, gb, 1.0]];
    (std, std::array::from_fn(|a| std::array::from_fn(|b| correlations[a][b] * std[a] * std[b])))
}

/// Weighted sums for the least squares `y = a x0 + b x1` with b >= 0.
#[derive(Clone, Copy, Default)]
struct Products {
    /// The sums of x0 x0, x0 x1 and x1 x1.
    own: [f64; 3],
    /// The sums of x0 y and x1 y.
    right: [f64; 2],
}

impl Products {
    fn add(&mut self, weight: f64, x: [f64; 2], y: f64) {
        for (sum, v) in self.own.iter_mut().zip([x[0] * x[0], x[0] * x[1], x[1] * x[1]]) {
            *sum += weight * v;
        }
        for (sum, x) in self.right.iter_mut().zip(x) {
            *sum += weight * x * y;
        }
    }

    /// The coefficient a.
    fn first_coefficient(&self) -> f64 {
        let ([xx, xt, tt], [xy, ty]) = (self.own, self.right);
        let determinant = xx * tt - xt * xt;
        let second = ty * xx - xy * xt;
        if determinant > 1e-9 * xx * tt && second > 0.0 {
            (xy * tt - ty * xt) / determinant
        } else {
            xy / xx.max(1e-30)
        }
    }
}

fn variances_mean(v: &[f64; 3]) -> f64 {
    v.iter().sum::<f64>() / 3.0
}

/// The unknowns of the mixing of all levels: a lower triangle each.
const TRIANGLES: usize = 6 * NOISE_LEVELS;

/// The lower triangle of a symmetric or triangular matrix, by rows.
const TRIANGLE: [(usize, usize); 6] = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)];

/// `REANALYSED[k][i][j]`: the mean product, in level k of the pyramid of an image, of what levels i and j contributed to the image where
/// both are those of one white noise, each with std 1. The levels of a Laplacian pyramid reach into each other. Measured on 2048 x 2048 px
/// of white noise; a test repeats it.
const REANALYSED: [[[f64; NOISE_LEVELS]; NOISE_LEVELS]; NOISE_LEVELS] = [
    [
        [0.95569, 0.07481, 0.00234, 0.00003],
        [0.07481, 0.10794, 0.01281, 0.00034],
        [0.00234, 0.01281, 0.01031, 0.00102],
        [0.00003, 0.00034, 0.00102, 0.00073],
    ],
    [
        [0.02454, 0.04320, 0.00754, 0.00027],
        [0.04320, 0.14402, 0.05464, 0.00329],
        [0.00754, 0.05464, 0.06507, 0.01099],
        [0.00027, 0.00329, 0.01099, 0.00880],
    ],
    [
        [0.00070, 0.00459, 0.00518, 0.00092],
        [0.00459, 0.03569, 0.05119, 0.01191],
        [0.00518, 0.05119, 0.11839, 0.05079],
        [0.00092, 0.01191, 0.05079, 0.05855],
    ],
    [
        [0.00001, 0.00017, 0.00063, 0.00066],
        [0.00017, 0.00212, 0.00831, 0.00922],
        [0.00063, 0.00831, 0.03796, 0.05233],
        [0.00066, 0.00922, 0.05233, 0.11285],
    ],
];

/// The triangular matrices that mix the independent noises of each level so that the levels of the result have these covariances:
/// Levenberg and Marquardt's iteration from the covariances' Cholesky factors. `None` if a covariance is not one.
fn mixing(covariances: &[[[f64; 3]; 3]; NOISE_LEVELS]) -> Option<[[[f64; 3]; 3]; NOISE_LEVELS]> {
    let scale: [f64; NOISE_LEVELS] =
        std::array::from_fn(|l| (0..3).map(|c| covariances[l][c][c]).sum::<f64>() / 3.0);
    if scale.iter().any(|s| !s.is_finite() || *s <= 0.0) {
        return None;
    }
    let matrices = |x: &[f64; TRIANGLES]| -> [[[f64; 3]; 3]; NOISE_LEVELS] {
        std::array::from_fn(|l| {
            let mut m = [[0.0; 3]; 3];
            TRIANGLE.iter().zip(&x[6 * l..]).for_each(|(&(a, b), v)| m[a][b] = *v);
            m
        })
    };
    let residuals = |x: &[f64; TRIANGLES]| -> [f64; TRIANGLES] {
        let made = reanalysed(&matrices(x));
        std::array::from_fn(|i| {
            let (l, (a, b)) = (i / 6, TRIANGLE[i % 6]);
            (made[l][a][b] - covariances[l][a][b]) / scale[l]
        })
    };
    let mut x = [0.0; TRIANGLES];
    for l in 0..NOISE_LEVELS {
        let factor = cholesky(covariances[l].as_flattened(), 3)?;
        TRIANGLE.iter().zip(&mut x[6 * l..]).for_each(|(&(a, b), v)| *v = factor[3 * a + b]);
    }
    let squares = |r: &[f64; TRIANGLES]| r.iter().map(|v| v * v).sum::<f64>();
    let mut now = residuals(&x);
    let mut damping = 1e-3;
    for _ in 0..60 {
        let mut columns = [[0.0; TRIANGLES]; TRIANGLES];
        for (i, column) in columns.iter_mut().enumerate() {
            let step = 1e-5 * scale[i / 6].sqrt();
            let mut moved = x;
            moved[i] += step;
            let there = residuals(&moved);
            *column = std::array::from_fn(|r| (there[r] - now[r]) / step);
        }
        let product =
            |a: &[f64; TRIANGLES], b: &[f64; TRIANGLES]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut normal: Vec<f64> =
            columns.iter().flat_map(|a| columns.iter().map(|b| product(a, b))).collect();
        let right = columns.iter().map(|column| -product(column, &now)).collect();
        normal.iter_mut().step_by(TRIANGLES + 1).for_each(|v| *v *= 1.0 + damping);
        let Some(step) = solved(&normal, right) else { break };
        let next: [f64; TRIANGLES] = std::array::from_fn(|i| x[i] + step[i]);
        let there = residuals(&next);
        if squares(&there) < squares(&now) {
            (x, now, damping) = (next, there, damping * 0.3);
        } else {
            damping *= 10.0;
        }
        if squares(&now) < 1e-10 || damping > 1e8 {
            break;
        }
    }
    Some(matrices(&x))
}

/// The covariances of the levels of a noise whose levels were mixed by these matrices.
fn reanalysed(mixing: &[[[f64; 3]; 3]; NOISE_LEVELS]) -> [[[f64; 3]; 3]; NOISE_LEVELS] {
    let mut made = [[[0.0; 3]; 3]; NOISE_LEVELS];
    for (made, gains) in made.iter_mut().zip(&REANALYSED) {
        for (mi, gains) in mixing.iter().zip(gains) {
            for (mj, gain) in mixing.iter().zip(gains) {
                for (a, row) in made.iter_mut().enumerate() {
                    for (b, v) in row.iter_mut().enumerate() {
                        *v += gain * (0..3).map(|k| mi[a][k] * mj[b][k]).sum::<f64>();
                    }
                }
            }
        }
    }
    made
}

/// The solution of A x = b, A row by row, in which the entries that are not free are 0.
fn solved_freely(a: &[f64], b: &[f64], free: &[bool; UNKNOWNS]) -> Option<[f64; UNKNOWNS]> {
    let chosen: Vec<usize> = (0..UNKNOWNS).filter(|&i| free[i]).collect();
    let system = chosen.iter().flat_map(|&i| chosen.iter().map(move |&j| a[UNKNOWNS * i + j]));
    let right = chosen.iter().map(|&i| b[i]);
    let small = solved(&system.collect::<Vec<f64>>(), right.collect())?;
    let mut x = [0.0; UNKNOWNS];
    chosen.iter().zip(small).for_each(|(&i, v)| x[i] = v);
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::noise::{unit_bands, white_band_std};
    use crate::{Raster, pyramid};

    /// The level `level` of an image of `side` px, enlarged to the image.
    fn enlarged(band: &Raster<[f32; 3]>, level: usize, side: usize) -> Raster<[f32; 3]> {
        (0..level).rev().fold(band.clone(), |b, l| pyramid::upsample(&b, side >> l, side >> l))
    }

    #[test]
    fn the_reach_of_the_levels_into_each_other_is_the_measured_one() {
        const SIDE: usize = 2048;
        let bands = unit_bands(SIDE, SIDE, 3, 0);
        let again: Vec<Vec<Raster<[f32; 3]>>> = bands
            .iter()
            .enumerate()
            .map(|(l, b)| pyramid::laplacian(&enlarged(b, l, SIDE), NOISE_LEVELS).0)
            .collect();
        for k in 0..NOISE_LEVELS {
            for i in 0..NOISE_LEVELS {
                for j in 0..NOISE_LEVELS {
                    let (a, b) = (again[i][k].data().as_flattened(), again[j][k].data().as_flattened());
                    let mean = a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>() / a.len() as f64;
                    println!("{k} {i} {j} {mean:.6}");
                    assert!(
                        (mean - REANALYSED[k][i][j]).abs() < 0.004 + 0.02 * mean.abs(),
                        "{k} {i} {j}: {mean}"
                    );
                }
            }
        }
    }

    #[test]
    fn white_noise_is_mixed_as_it_is_and_correlated_noise_as_asked() {
        let white = white_band_std().map(f64::from);
        let diagonal =
            |l: usize| std::array::from_fn(|a| std::array::from_fn(|b| f64::from(a == b) * white[l].powi(2)));
        let mixed = mixing(&std::array::from_fn(diagonal)).unwrap();
        for (l, m) in reanalysed(&mixed).iter().enumerate() {
            let power = white[l].powi(2);
            assert!((m[1][1] / power - 1.0).abs() < 0.01 && m[1][0].abs() < 0.01 * power, "{l}: {m:?}");
        }
        // A camera's noise: coarser than white, channels that share much of the finest level and little of the coarsest.
        let covariance = |l: usize| {
            let (std, shared) = ([2.6, 1.5, 1.0, 0.75][l], [0.9, 0.6, 0.1, -0.2][l]);
            std::array::from_fn(|a| std::array::from_fn(|b| std * std * if a == b { 1.0 } else { shared }))
        };
        let want: [[[f64; 3]; 3]; NOISE_LEVELS] = std::array::from_fn(covariance);
        let error = |m: &[[[f64; 3]; 3]; NOISE_LEVELS]| {
            let made = reanalysed(m);
            (0..NOISE_LEVELS)
                .flat_map(|l| TRIANGLE.map(|(a, b)| ((made[l][a][b] - want[l][a][b]) / want[l][0][0]).abs()))
                .fold(0.0, f64::max)
        };
        assert!(error(&mixing(&want).unwrap()) < 0.02);
        let factor = |covariance: &[[f64; 3]; 3]| -> [[f64; 3]; 3] {
            let factor = cholesky(covariance.as_flattened(), 3).unwrap();
            std::array::from_fn(|a| std::array::from_fn(|b| factor[3 * a + b]))
        };
        // Negative control: the levels mixed by their own covariances alone.
        assert!(error(&std::array::from_fn(|l| factor(&want[l]))) > 0.2);
    }

    #[test]
    fn curves_follow_the_colour_and_leave_out_what_does_not_match() {
        let truth = |[r, g, b]: [f32; 3]| 1e-4 * (0.2 + 0.5 * g + 0.9 * r * r + 0.1 * b);
        let uniform = |i: usize, k: u64| crate::fit::uniform(k, i as u64);
        let block = |i: usize, mismatch: f32| {
            let colour = [uniform(i, 1), uniform(i, 2), uniform(i, 3)];
            let texture = if mismatch > 0.0 { 0.01 * uniform(i, 4).powi(3) } else { 0.0 };
            let chance = 1.0 + 0.3 * (uniform(i, 5) + uniform(i, 6) - 1.0);
            let v = chance * truth(colour) + mismatch * texture * (0.5 + uniform(i, 7));
            Block {
                colours: Colours::of(std::iter::once(colour)),
                covariance: [v, v, v, 0.5 * v, 0.0, 0.0],
                texture,
                count: 64.0,
            }
        };
        let worst = |mismatch: f32, told: bool| {
            let blocks: Vec<Block> = (0..3000)
                .map(|i| block(i, mismatch))
                .map(|b| if told { b } else { Block { texture: 0.0, ..b } })
                .collect();
            let unknown = OverGrey { variance: [[0.0; 3]; NOISE_KNOTS], weight: 0.0 };
            let points = curves_of(&Rows::of(&blocks, ENOUGH), &unknown, !told && mismatch == 0.0);
            let mut level = CurveLevel::default();
            level.variance[0].as_flattened_mut().copy_from_slice(&points[0]);
            [[0.2; 3], [0.5; 3], [0.8; 3], [0.8, 0.3, 0.2], [0.2, 0.4, 0.8]]
                .map(|v| (level.std(v)[0].powi(2) / truth(v) - 1.0).abs())
                .into_iter()
                .fold(0.0, f32::max)
        };
        assert!(worst(0.0, true) < 0.1, "{}", worst(0.0, true));
        assert!(worst(0.02, true) < 0.15, "{}", worst(0.02, true));
        // Negative control: the texture is taken for noise.
        assert!(worst(0.02, false) > 0.2, "{}", worst(0.02, false));
    }

    #[test]
    fn over_greys_that_the_picture_does_not_have_the_lines_tell_the_noise() {
        // Noise of std 0.01 everywhere, in a picture of reds: some blocks hold texture, as those of bright reds.
        let block = |i: usize| {
            let uniform = |k: u64| crate::fit::uniform(k, i as u64);
            let red = 0.2 + 0.7 * uniform(1);
            let v = 1e-4 * (1.0 + 0.4 * (uniform(2) - 0.5)) * if red > 0.8 { 3.0 } else { 1.0 };
            let colour = [red, 0.4 * red, 0.3 * red];
            let colours = Colours::of(std::iter::once(colour));
            Block { colours, covariance: [v, v, v, 0.0, 0.0, 0.0], texture: 0.0, count: 64.0 }
        };
        let blocks: Vec<Block> = (0..2000).map(block).collect();
        let rows = Rows::of(&blocks, ENOUGH);
        let lines = NoiseLevel { slope: [0.0; 3], intercept: [0.01; 3] };
        let over = |grey: &OverGrey, colour: [f32; 3]| {
            let mut level = CurveLevel::default();
            let points = curves_of(&rows, grey, true);
            level.variance[0].as_flattened_mut().copy_from_slice(&points[0]);
            level.std(colour)[0] / 0.01
        };
        let unknown = OverGrey { variance: [[0.0; 3]; NOISE_KNOTS], weight: 0.0 };
        for single in [true, false] {
            let told = OverGrey::new(&lines, &rows, single);
            let (white, red) = (over(&told, [0.95; 3]), over(&told, [0.5, 0.2, 0.15]));
            assert!((0.8..1.4).contains(&white) && (red - 1.0).abs() < 0.15, "{single}: {white} {red}");
        }
        // Negative control: from reds alone, the texture of the bright ones is taken for noise over white.
        assert!(over(&unknown, [0.95; 3]) > 1.5, "{}", over(&unknown, [0.95; 3]));
    }
}
