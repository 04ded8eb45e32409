//! A test of whether a patch of real noise could be the model's: a two-sample test by Monte Carlo.
//!
//! The statistics of a patch are the log powers of R, G and B and the correlations of the channels, in the two finest octaves. The model
//! makes [`DRAWS`] patches in the same way. The test's statistic is the largest deviation, in stds of the drawn patches, of any of the
//! patch's statistics from their mean; its p-value is the rank of the real patch's among those of the drawn ones (Davison & Hinkley 1997,
//! section 4.2), so that no table of a distribution is needed, and the number of statistics is allowed for.

use blindaug::model::NoiseModel;
use blindaug::{Raster, pyramid};

/// The number of patches that the model makes for a test: the smallest p-value is 1 / (DRAWS + 1).
const DRAWS: usize = 199;

/// The octaves that are compared, finest first. Coarser ones are left out since the patch is chosen for its lack of coarse structure.
const OCTAVES: usize = 2;

/// The statistics of an octave: three log powers and three correlations.
const OF_OCTAVE: usize = 6;

/// The number of statistics of a patch.
const STATISTICS: usize = OCTAVES * OF_OCTAVE;

/// The level of the test.
pub const LEVEL: f32 = 0.05;

const CHANNELS: [&str; 3] = ["red", "green", "blue"];
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// The result of a test.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoSample {
    /// The probability, in (0, 1], that noise of the model deviates from its own mean at least as much as the real patch does.
    pub p: f32,
    /// What deviates most, in words.
    pub most: String,
}

impl TwoSample {
    /// Whether the test tells the real noise from the model's.
    pub fn told_apart(&self) -> bool {
        self.p <= LEVEL
    }
}

/// Compares the noise of a patch of mean luminance `y` with the model's: `draw` makes a patch of the model's noise for each seed, to which
/// all has been done that was done to the real one.
pub fn two_sample(
    model: &NoiseModel,
    y: f32,
    real: &Raster<[f32; 3]>,
    draw: impl Fn(u64) -> Raster<[f32; 3]>,
) -> TwoSample {
    // A seed that the report's pictures do not use.
    const SEED: u64 = 0x7e57;
    let drawn: Vec<[f32; STATISTICS]> = (0..DRAWS as u64).map(|i| statistics(&draw(SEED + i))).collect();
    let real = statistics(real);
    let mean: [f32; STATISTICS] =
        std::array::from_fn(|i| drawn.iter().map(|s| s[i]).sum::<f32>() / DRAWS as f32);
    let square: [f32; STATISTICS] =
        std::array::from_fn(|i| drawn.iter().map(|s| (s[i] - mean[i]).powi(2)).sum::<f32>() / DRAWS as f32);
    // The model's own numbers have an error, by which its patches would scatter too.
    let error: [f32; STATISTICS] = std::array::from_fn(|i| match (i / OF_OCTAVE, i % OF_OCTAVE) {
        (octave, c @ 0..3) => {
            let std = model.std(octave, y)[c].max(1e-6);
            let [low, high] = model.interval_of_std(octave, c, y);
            (high - low) / (1.96 * std)
        }
        _ => 0.0,
    });
    let deviation = |s: &[f32; STATISTICS], i: usize, square: f32| {
        if square > 1e-12 { (s[i] - mean[i]).abs() / square.sqrt() } else { 0.0 }
    };
    let largest = |s: &[f32; STATISTICS], with_error: bool| {
        (0..STATISTICS)
            .map(|i| (i, deviation(s, i, square[i] + if with_error { error[i].powi(2) } else { 0.0 })))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((0, 0.0))
    };
    // A drawn patch lacks the scatter by the model's error, so that it is measured by its own scatter alone.
    let (worst, observed) = largest(&real, true);
    let above = drawn.iter().filter(|s| largest(s, false).1 >= observed).count();
    TwoSample { p: (1 + above) as f32 / (1 + DRAWS) as f32, most: words(worst, real[worst], mean[worst]) }
}

fn words(statistic: usize, real: f32, expected: f32) -> String {
    let octave = ["the finest octave", "the second octave"][(statistic / OF_OCTAVE).min(1)];
    match statistic % OF_OCTAVE {
        c @ 0..3 => {
            let change = 100.0 * ((0.5 * (real - expected)).exp() - 1.0);
            let how = if change < 0.0 { "weaker" } else { "stronger" };
            format!("real {} noise of {octave} is {:.0} % {how}", CHANNELS[c], change.abs())
        }
        pair => {
            let (a, b) = PAIRS[pair - 3];
            format!(
                "the correlation of real {} and {} noise in {octave} is {:.2}, the model's {:.2}",
                CHANNELS[a],
                CHANNELS[b],
                real.tanh(),
                expected.tanh()
            )
        }
    }
}

/// The log powers of R, G and B, and the correlations of the channels by Fisher's z (atanh, which makes them nearly normal), of each octave.
fn statistics(noise: &Raster<[f32; 3]>) -> [f32; STATISTICS] {
    let (bands, _) = pyramid::laplacian(noise, OCTAVES);
    let mut all = [0.0; STATISTICS];
    for (band, of_octave) in bands.iter().zip(all.chunks_exact_mut(OF_OCTAVE)) {
        let mut products = [[0.0f32; 3]; 3];
        for p in band.data() {
            for a in 0..3 {
                for b in 0..3 {
                    products[a][b] += p[a] * p[b];
                }
            }
        }
        for c in 0..3 {
            of_octave[c] = (products[c][c] / band.data().len().max(1) as f32).max(1e-12).ln();
            let (a, b) = PAIRS[c];
            let norm = (products[a][a] * products[b][b]).sqrt().max(1e-20);
            of_octave[3 + c] = (products[a][b] / norm).clamp(-0.999, 0.999).atanh();
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::NoiseLevel;
    use blindaug::synth::noise;

    const SIDE: usize = 48;

    fn model(factor: f32) -> NoiseModel {
        let level = |std: f32| NoiseLevel { slope: [0.0; 3], intercept: [factor * std; 3] };
        NoiseModel::given([level(0.02), level(0.01), level(0.005), level(0.002)], 1.0)
    }

    fn test_of(real: &Raster<[f32; 3]>) -> TwoSample {
        tested(&model(1.0), real)
    }

    fn tested(model: &NoiseModel, real: &Raster<[f32; 3]>) -> TwoSample {
        let content = Raster::filled(SIDE, SIDE, [0.5; 3]);
        two_sample(model, 0.5, real, |seed| noise::noise(model, &content, seed, 0))
    }

    fn noise_of(factor: f32, seed: u64) -> Raster<[f32; 3]> {
        noise::noise(&model(factor), &Raster::filled(SIDE, SIDE, [0.5; 3]), seed, 9)
    }

    #[test]
    fn noise_of_the_model_is_told_apart_as_seldom_as_the_level_says() {
        let told = (0..20).filter(|&seed| test_of(&noise_of(1.0, seed)).told_apart()).count();
        // At a level of 5 %, more than 4 of 20 happen in 0.3 % of all cases.
        assert!(told <= 4, "{told} of 20");
    }

    #[test]
    fn other_noise_is_told_apart_and_how() {
        let stronger = test_of(&noise_of(1.3, 1));
        assert!(stronger.told_apart() && stronger.most.contains("stronger"), "{stronger:?}");
        let weaker = test_of(&noise_of(0.7, 1));
        assert!(weaker.told_apart() && weaker.most.contains("weaker"), "{weaker:?}");
        // Grey noise of the same strength: only the channels' correlation differs.
        let grey = test_of(&noise_of(1.0, 2).map(|p| [p[1]; 3]));
        assert!(grey.told_apart() && grey.most.contains("correlation"), "{grey:?}");
    }

    #[test]
    fn flat_and_odd_patches_give_a_result() {
        assert!(test_of(&Raster::filled(SIDE, SIDE, [0.0; 3])).told_apart());
        let p = tested(&model(0.0), &noise_of(1.0, 1)).p;
        assert!((0.0..=1.0).contains(&p));
    }
}
