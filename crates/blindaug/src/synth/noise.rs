//! Noise: white normal noise, shaped level by level of a Laplacian pyramid (the paper, after Walton et al. 2021).

use crate::model::{NOISE_LEVELS, NoiseModel};
use crate::{Plane, Raster, filter, par, pyramid};
use std::sync::OnceLock;

/// The band-pass levels of a noise of local std 1, finest first.
pub type NoiseBands = [Raster<[f32; 3]>; NOISE_LEVELS];

/// Noise of mean 0 for this noise-free, display-encoded content; add it to the content.
///
/// The noise is the same for the same `seed` and `frame` with any number of threads, and independent between seeds. Between frames it is
/// independent but for [`NoiseModel::temporal_correlation`]. Clipping is left to the caller: see [`NoiseModel::clip`].
pub fn noise(model: &NoiseModel, content: &Raster<[f32; 3]>, seed: u64, frame: u64) -> Raster<[f32; 3]> {
    noise_of_rows(model, content, 0, seed, frame)
}

/// The rows of [`noise`] from `top` on, given their content; rows near the first and the last one differ from those of the whole image.
pub(super) fn noise_of_rows(
    model: &NoiseModel,
    content: &Raster<[f32; 3]>,
    top: usize,
    seed: u64,
    frame: u64,
) -> Raster<[f32; 3]> {
    // Neither content nor std is copied at full resolution: of a strip of a large frame, that is about 60 MB each.
    let smaller = pyramid::halvings(content, NOISE_LEVELS - 1);
    modulated(bands_of_rows(model, content.size(), top, seed, frame), |level, x, y| {
        let content = if level == 0 { content } else { &smaller[level - 1] };
        model.std_over(level, content.at(x, y))
    })
}

/// The levels of the noise of a model over content at which its std is 1: the channels are as correlated as the model's, and so are
/// successive frames.
pub fn bands(model: &NoiseModel, size: (usize, usize), seed: u64, frame: u64) -> NoiseBands {
    bands_of_rows(model, size, 0, seed, frame)
}

fn bands_of_rows(model: &NoiseModel, size: (usize, usize), top: usize, seed: u64, frame: u64) -> NoiseBands {
    let mut weights = temporal_weights(model.temporal_correlation()).into_iter();
    let first = weights.next().unwrap_or(1.0);
    let mut white = white_noise(size, top, seed, frame);
    if first != 1.0 {
        white.data_mut().as_flattened_mut().iter_mut().for_each(|v| *v *= first);
        for (age, weight) in (1..).zip(weights) {
            let older = white_noise(size, top, seed, frame.wrapping_sub(age));
            for (v, o) in white.data_mut().as_flattened_mut().iter_mut().zip(older.data().as_flattened()) {
                *v += weight * o;
            }
        }
    }
    let mut bands = unit_bands_of(white);
    if let Some(curves) = model.curves() {
        for (band, level) in bands.iter_mut().zip(&curves.levels) {
            band.data_mut().iter_mut().for_each(|v| *v = level.mixed(*v));
        }
    }
    bands
}

/// The most frames whose white noise is summed for a frame's noise.
pub const MOST_TERMS: usize = 12;

/// The weights of the white noises of this frame, the one before it, and so on, whose sum is noise of std 1 that is correlated by this much
/// from frame to frame: a first-order autoregressive process, cut off where its weights are small. A frame's noise thus depends on its
/// number alone, and ranges of frames can be made in any order.
pub fn temporal_weights(correlation: f32) -> Vec<f32> {
    const LEAST: f32 = 0.03;
    let correlation = correlation.clamp(0.0, 0.99);
    let powers: Vec<f32> = std::iter::successors(Some(1.0), |w| Some(w * correlation))
        .take(MOST_TERMS)
        .take_while(|&w| w >= LEAST)
        .collect();
    let norm = powers.iter().map(|w| w * w).sum::<f32>().sqrt();
    powers.into_iter().map(|w| w / norm).collect()
}

/// The noise whose level `l` is the unit band times the std `std(l, x, y)` at the level's pixel (x, y); the remaining low-pass is 0. A level
/// has the size of the image after `l` times [`pyramid::downsample`].
pub fn modulated(
    mut bands: NoiseBands,
    std: impl Fn(usize, usize, usize) -> [f32; 3] + Sync,
) -> Raster<[f32; 3]> {
    for (level, band) in bands.iter_mut().enumerate() {
        let width = band.width();
        par::for_each_row(band.data_mut(), width, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                let std = std(level, x, y);
                *v = [v[0] * std[0], v[1] * std[1], v[2] * std[2]];
            }
        });
    }
    let (w, h) = bands[NOISE_LEVELS - 1].size();
    pyramid::collapse(bands.into(), Raster::filled(w.div_ceil(2), h.div_ceil(2), [0.0; 3]))
}

/// The noise of a model that an image lacks whose noise has the variance `there(l, x, y)` in level `l`. `content` holds the levels of the
/// content without noise, the image's own size first.
pub(crate) fn missing(
    model: &NoiseModel,
    content: &[Raster<[f32; 3]>],
    there: impl Fn(usize, usize, usize) -> [f32; 3] + Sync,
    seed: u64,
    frame: u64,
) -> Raster<[f32; 3]> {
    modulated(bands(model, content[0].size(), seed, frame), |level, x, y| {
        let (want, there) = (model.std_over(level, content[level].at(x, y)), there(level, x, y));
        std::array::from_fn(|c| (want[c] * want[c] - there[c]).max(0.0).sqrt())
    })
}

/// An image and its halvings, one for each level of noise.
pub(crate) fn levels_of(image: Raster<[f32; 3]>) -> Vec<Raster<[f32; 3]>> {
    let mut levels = pyramid::halvings(&image, NOISE_LEVELS - 1);
    levels.insert(0, image);
    levels
}

/// The contribution of each level, finest first, to a noise whose std maps are 1, at full resolution: square tiles of `side` px
/// that continue at their opposite edge. Noise of an even luminance is the sum of the tiles, each times its level's std.
///
/// # Panics
/// If `side` is not a multiple of 16, the coarsest level's grid.
pub fn tileable_bands(side: usize, seed: u64) -> NoiseBands {
    // The margin, px, is larger than the reach of the pyramid's kernels and of the window of the coarsest level's local std.
    const MARGIN: usize = 128;
    assert_eq!(side % (2 << (NOISE_LEVELS - 1)), 0, "the side of a tile must be a multiple of 16 px");
    let tile = white_noise((side, side), 0, seed, 0);
    let wrapped = |i: usize| (i + side - MARGIN % side) % side;
    let around = side + 2 * MARGIN;
    let white = Raster::from_fn(around, around, |x, y| tile.at(wrapped(x), wrapped(y)));
    let bands = unit_bands_of(white);
    std::array::from_fn(|level| {
        let enlarged = |band: Raster<[f32; 3]>, finer: &Raster<[f32; 3]>| {
            pyramid::upsample(&band, finer.width(), finer.height())
        };
        let full = bands[..level].iter().rev().fold(bands[level].clone(), enlarged);
        full.crop(MARGIN, MARGIN, side, side)
    })
}

/// The factor for each level that makes the std exactly 1: normal numbers divided by the std of their own window have a std
/// slightly below 1.
pub const WINDOW_GAIN: [f32; NOISE_LEVELS] = [1.0047, 1.0063, 1.0086, 1.0120];

/// The least std by which a level is divided, as a share of its usual std ([`white_band_std`]).
pub const LEAST_STD: f32 = 0.2;

/// The Laplacian pyramid of white normal noise, each level divided by its own local std.
pub fn unit_bands(width: usize, height: usize, seed: u64, frame: u64) -> NoiseBands {
    unit_bands_of(white_noise((width, height), 0, seed, frame))
}

fn unit_bands_of(white: Raster<[f32; 3]>) -> NoiseBands {
    let (bands, _) = pyramid::laplacian(&white, NOISE_LEVELS);
    drop(white);
    let mut bands = bands.into_iter();
    let usual_std = white_band_std();
    std::array::from_fn(|level| {
        let mut band = bands.next().unwrap_or_else(|| Raster::filled(0, 0, [0.0; 3]));
        // A window of next to no variance (in an image of a few pixels) must not be amplified without bound.
        let floor = LEAST_STD * usual_std[level];
        let std = local_std(&band);
        for (b, s) in band.data_mut().as_flattened_mut().iter_mut().zip(std.data().as_flattened()) {
            *b *= WINDOW_GAIN[level] / s.max(floor);
        }
        band
    })
}

/// The local std sqrt(E[x^2] - E[x]^2) in a window of 9 x 9 px, a Gaussian of std 4 px.
fn local_std(band: &Raster<[f32; 3]>) -> Raster<[f32; 3]> {
    let gaussian: Vec<f32> = (0..5).map(|i| (-(i * i) as f32 / 32.0).exp()).collect();
    let sum = 2.0 * gaussian.iter().sum::<f32>() - gaussian[0];
    let window: Vec<f32> = gaussian.iter().map(|g| g / sum).collect();
    filter::convolve_map(
        band,
        &window,
        |[r, g, b]: [f32; 3]| [r, g, b, r * r, g * g, b * b],
        |v| std::array::from_fn(|c| (v[c + 3] - v[c] * v[c]).max(0.0).sqrt()),
    )
}

/// White normal noise of std 1 in each channel, the rows from `top` on.
fn white_noise((width, height): (usize, usize), top: usize, seed: u64, frame: u64) -> Raster<[f32; 3]> {
    let key = pcg4d([seed as u32, (seed >> 32) as u32, frame as u32, (frame >> 32) as u32]);
    Raster::from_fn(width, height, |x, y| {
        let bits = pcg4d([x as u32 ^ key[0], (top + y) as u32 ^ key[1], key[2], key[3]]);
        // The uniform numbers have 24 bits and are never 0, as they lie at the middle of their interval; pairs of them become
        // normal numbers (Box & Muller 1958).
        let [a, b, c, d] = bits.map(|v| ((v >> 8) as f32 + 0.5) / 16_777_216.0);
        let (first, second) = ((-2.0 * a.ln()).sqrt(), (-2.0 * c.ln()).sqrt());
        let (sin, cos) = (std::f32::consts::TAU * b).sin_cos();
        [first * cos, first * sin, second * (std::f32::consts::TAU * d).cos()]
    })
}

/// Turns four counters into four random numbers (pcg4d, Jarzynski & Olano 2020), which is as short in a shader.
fn pcg4d(counters: [u32; 4]) -> [u32; 4] {
    let mix = |[mut x, mut y, mut z, mut w]: [u32; 4]| {
        x = x.wrapping_add(y.wrapping_mul(w));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        w = w.wrapping_add(y.wrapping_mul(z));
        [x, y, z, w]
    };
    let spread = counters.map(|v| v.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    mix(mix(spread).map(|v| v ^ (v >> 16)))
}

/// The std of each level of the Laplacian pyramid of white noise of std 1, from the pyramid's kernels.
pub fn white_band_std() -> [f32; NOISE_LEVELS] {
    static STD: OnceLock<[f32; NOISE_LEVELS]> = OnceLock::new();
    *STD.get_or_init(band_std_by_kernels)
}

fn band_std_by_kernels() -> [f32; NOISE_LEVELS] {
    // Along a line, level l of an input x is A x - B x, where A halves l times, and B also halves and doubles once more; in the
    // image, level l is (A A' - B B') x, where A' and B' act along columns. The mean over pixels of the squared weights takes only
    // the sums of A A, A B and B B along a line, over one period of the inputs.
    const PERIOD: usize = 2 << (NOISE_LEVELS - 1);
    let mut sums = [[0.0f32; 3]; NOISE_LEVELS];
    for input in 0..PERIOD {
        let mut a = Plane::filled(16 * PERIOD, 1, 0.0);
        a.data_mut()[8 * PERIOD + input] = 1.0;
        for sums in &mut sums {
            let low = pyramid::downsample(&a);
            let b = pyramid::upsample(&low, a.width(), 1);
            for (a, b) in a.data().iter().zip(b.data()) {
                sums[0] += a * a;
                sums[1] += a * b;
                sums[2] += b * b;
            }
            a = low;
        }
    }
    std::array::from_fn(|level| {
        let outputs = (PERIOD >> level) as f32;
        let [aa, ab, bb] = sums[level].map(|s| s / outputs);
        (aa * aa - 2.0 * ab * ab + bb * bb).sqrt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::BAND_COVARIANCE;
    use crate::model::NoiseLevel;

    /// (mean, std) of one channel.
    fn statistics(n: &Raster<[f32; 3]>, c: usize) -> (f64, f64) {
        let count = n.data().len() as f64;
        let mean = n.data().iter().map(|v| f64::from(v[c])).sum::<f64>() / count;
        (mean, (n.data().iter().map(|v| (f64::from(v[c]) - mean).powi(2)).sum::<f64>() / count).sqrt())
    }

    fn model(levels: [NoiseLevel; NOISE_LEVELS]) -> NoiseModel {
        NoiseModel::given(levels, 1.0)
    }

    /// White noise whose std is `slope[c]` Y + `intercept[c]`.
    fn white_model(slope: [f32; 3], intercept: [f32; 3]) -> NoiseModel {
        model(
            white_band_std()
                .map(|s| NoiseLevel { slope: slope.map(|v| v * s), intercept: intercept.map(|v| v * s) }),
        )
    }

    #[test]
    fn the_generator_is_normal_and_white_and_its_channels_are_independent() {
        let n = white_noise((400, 300), 0, 7, 3);
        for c in 0..3 {
            let (mean, std) = statistics(&n, c);
            assert!(mean.abs() < 0.01 && (std - 1.0).abs() < 0.01, "{mean} {std}");
            let fourth = n.data().iter().map(|v| f64::from(v[c]).powi(4)).sum::<f64>() / 120_000.0;
            assert!((fourth - 3.0).abs() < 0.1, "{fourth}");
            let beyond = n.data().iter().filter(|v| v[c].abs() > 1.96).count() as f64 / 120_000.0;
            assert!((beyond - 0.05).abs() < 0.003, "{beyond}");
        }
        let correlation = |of: &dyn Fn(usize, usize) -> f32| {
            let pixels = (0..299).flat_map(|y| (0..399).map(move |x| (x, y)));
            pixels.map(|(x, y)| f64::from(of(x, y))).sum::<f64>() / (299.0 * 399.0)
        };
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            assert!(correlation(&|x, y| n.at(x, y)[a] * n.at(x, y)[b]).abs() < 0.012);
        }
        for (dx, dy) in [(1, 0), (0, 1), (1, 1)] {
            assert!(correlation(&|x, y| n.at(x, y)[0] * n.at(x + dx, y + dy)[0]).abs() < 0.012);
        }
    }

    #[test]
    fn the_std_of_the_levels_of_white_noise_agrees_with_simulation() {
        let (bands, _) = pyramid::laplacian(&white_noise((1024, 768), 0, 1, 1), NOISE_LEVELS);
        for ((band, want), tolerance) in bands.iter().zip(white_band_std()).zip([0.003, 0.005, 0.01, 0.02]) {
            // The std is larger near the edge, whose pixels are repeated.
            let band = band.crop(8, 8, band.width() - 16, band.height() - 16);
            let got = (0..3).map(|c| statistics(&band, c).1.powi(2)).sum::<f64>().sqrt() as f32 / 3f32.sqrt();
            assert!((got / want - 1.0).abs() < tolerance, "{got} {want}");
        }
    }

    #[test]
    fn unit_bands_have_mean_0_and_std_1() {
        for (band, tolerance) in unit_bands(1024, 768, 5, 9).iter().zip([0.003, 0.003, 0.005, 0.01]) {
            for c in 0..3 {
                let (mean, std) = statistics(band, c);
                assert!(mean.abs() < 0.005 && (std - 1.0).abs() < tolerance, "{mean} {std}");
            }
        }
    }

    #[test]
    fn a_white_model_gives_white_noise_of_the_right_std_at_each_luminance() {
        let luma = Raster::from_fn(512, 384, |x, _| [if x < 256 { 0.2f32 } else { 0.9 }; 3]);
        let n = noise(&white_model([0.05, 0.0, 0.1], [0.01, 0.02, 0.0]), &luma, 11, 0);
        for (x0, y) in [(16, 0.2f32), (272, 0.9)] {
            let part = n.crop(x0, 0, 224, 384);
            for (c, want) in [0.05 * y + 0.01, 0.02, 0.1 * y].into_iter().enumerate() {
                let (mean, std) = statistics(&part, c);
                assert!(mean.abs() < 0.02 * f64::from(want), "{mean}");
                assert!((std as f32 / want - 1.0).abs() < 0.02, "{std} {want}");
                for (dx, dy) in [(1, 0), (0, 1), (1, 1), (2, 0), (0, 3)] {
                    let mut sum = 0.0;
                    for y in 0..380 {
                        for x in 0..220 {
                            sum += f64::from(part.at(x, y)[c] * part.at(x + dx, y + dy)[c]);
                        }
                    }
                    let correlation = sum / (380.0 * 220.0) / (std * std);
                    assert!(correlation.abs() < 0.02, "lag {dx} {dy}: {correlation}");
                }
            }
        }
        // Negative control: coarse noise is correlated between neighbours.
        let coarse = model(std::array::from_fn(|l| NoiseLevel {
            slope: [0.0; 3],
            intercept: [if l == 1 { 0.1 } else { 0.0 }; 3],
        }));
        let n = noise(&coarse, &luma, 11, 0);
        let lag = n.data().windows(2).map(|p| p[0][0] * p[1][0]).sum::<f32>();
        assert!(lag > 0.3 * n.data().iter().map(|p| p[0] * p[0]).sum::<f32>());
    }

    #[test]
    fn tiles_have_no_seam_and_make_the_same_noise() {
        let side = 128;
        let bands = tileable_bands(side, 5);
        for (level, band) in bands.iter().enumerate() {
            let step = |x: usize, of: &dyn Fn(usize, usize) -> [f32; 3]| {
                let sum: f32 = (0..side).map(|y| (of(x, y)[0] - of((x + 1) % side, y)[0]).powi(2)).sum();
                sum / side as f32
            };
            let across = |of: &dyn Fn(usize, usize) -> [f32; 3]| {
                let inside = (0..side - 1).map(|x| step(x, of)).sum::<f32>() / (side - 1) as f32;
                step(side - 1, of) / inside
            };
            assert!((0.6..1.6).contains(&across(&|x, y| band.at(x, y))), "level {level}");
            // Negative control: the coarse levels of a tile that does not wrap show a seam.
            if level > 1 {
                let cut = |x: usize, y: usize| band.at(x / 2, y);
                assert!(across(&cut) > 3.0, "level {level}");
            }
        }
        let model = model(std::array::from_fn(|l| NoiseLevel {
            slope: [0.02 * (l + 1) as f32; 3],
            intercept: [0.01, 0.02, 0.0],
        }));
        for y in [0.1, 0.7] {
            let made = noise(&model, &Raster::filled(512, 512, [y; 3]), 3, 0).crop(32, 32, 448, 448);
            for (c, want) in model.total_std(y).into_iter().enumerate() {
                let (_, got) = statistics(&made, c);
                assert!((got as f32 / want - 1.0).abs() < 0.03, "{got} {want}");
            }
        }
        // Of white noise, only the low-pass below the four bands is missing.
        for std in white_model([0.0; 3], [0.05; 3]).total_std(0.2) {
            assert!((std / 0.05 - 1.0).abs() < 0.02, "{std}");
        }
    }

    #[test]
    fn it_depends_on_seed_and_frame_and_on_nothing_else() {
        let luma = Raster::from_fn(120, 90, |x, y| [((x + y) % 50) as f32 / 50.0; 3]);
        let m = white_model([0.05; 3], [0.01; 3]);
        let one = noise(&m, &luma, 3, 4);
        assert_eq!(one, noise(&m, &luma, 3, 4));
        #[cfg(feature = "threads")]
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(one, pool.install(|| noise(&m, &luma, 3, 4)));
        }
        let power: f32 = one.data().iter().flatten().map(|v| v * v).sum();
        for (seed, frame) in [(3, 5), (4, 4), (4, 3), (3 + (1 << 40), 4), (3, 4 + (1 << 40))] {
            let other = noise(&m, &luma, seed, frame);
            let both: f32 =
                one.data().iter().flatten().zip(other.data().iter().flatten()).map(|(a, b)| a * b).sum();
            assert!(both.abs() < 0.03 * power, "{seed} {frame}: {}", both / power);
        }
    }

    #[test]
    fn the_covariance_of_the_levels_is_that_of_white_noise_at_full_resolution() {
        let bands = tileable_bands(512, 0);
        let mean = |a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>| {
            let (a, b) = (a.data().as_flattened(), b.data().as_flattened());
            a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>() / a.len() as f64
        };
        for (i, row) in BAND_COVARIANCE.iter().enumerate() {
            for (j, kept) in row.iter().enumerate() {
                let measured = mean(&bands[i], &bands[j]) as f32;
                assert!((measured - kept).abs() < 1e-6, "{i} {j}: {measured} {kept}");
            }
        }
    }

    #[test]
    fn no_noise_in_the_model_gives_none_and_any_size_ends() {
        for (w, h) in [(0, 0), (1, 1), (1, 40), (3, 2), (65, 33)] {
            let luma = Raster::filled(w, h, [0.5; 3]);
            assert!(
                noise(&white_model([0.0; 3], [0.0; 3]), &luma, 1, 1).data().iter().all(|v| *v == [0.0; 3])
            );
            let n = noise(&white_model([0.0; 3], [0.01; 3]), &luma, 1, 1);
            assert_eq!(n.size(), (w, h));
            assert!(n.data().iter().flatten().all(|v| v.abs() < 0.2));
        }
    }
}
