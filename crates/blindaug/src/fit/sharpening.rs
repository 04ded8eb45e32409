//! The camera's sharpening, from its noise: a sensor's noise is white, and optics, demosaicing, denoising and coding can only
//! take from its fine detail. Where that is stronger than white noise has it, an unsharp mask has put it there.
//!
//! Overshoot at edges, the other trace that sharpening leaves, is not used: the edges of natural images have as much of
//! their own (docs/accuracy.md).

use super::uniform;
use crate::model::{NOISE_LEVELS, NoiseModel, SharpeningModel};
use crate::synth::noise::white_band_std;
use crate::{Plane, filter, pyramid};
use std::sync::OnceLock;

/// Std of the mask's Gaussian, px: taken to be this, since two numbers of the noise do not tell a second one.
const RADIUS: f32 = 1.0;
/// Of the ratio of the two finest levels, relative, as a std: what real noise leaves out of the model.
const FLOOR: f32 = 0.05;
/// A weaker mask is not called one.
const MIN_AMOUNT: f32 = 0.15;
const MAX_AMOUNT: f32 = 8.0;

/// What the noise says; `None` if it is not sure to have been sharpened.
pub(super) fn of_noise(noise: &NoiseModel) -> Option<SharpeningModel> {
    const MIDDLE: f32 = 0.5;
    let white = white_band_std();
    let interval = noise.interval.as_ref()?;
    // The mean over the channels, and its std, relative.
    let level = |l: usize| {
        let mean = noise.levels[l].sigma(MIDDLE).iter().sum::<f32>() / 3.0;
        let width = (0..3).map(|c| interval[l].intercept[c]).map(|[low, high]| high - low).sum::<f32>() / 3.0;
        (mean / white[l], width / (2.0 * 1.96) / mean)
    };
    let ((fine, fine_std), (coarse, coarse_std)) = (level(0), level(1));
    let ratio = fine / coarse;
    let reach = 1.96 * (fine_std * fine_std + coarse_std * coarse_std + FLOOR * FLOOR).sqrt();
    let [amount, low, high] = [ratio, ratio * (-reach).exp(), ratio * reach.exp()].map(amount_of);
    (low > MIN_AMOUNT).then_some(SharpeningModel {
        amount,
        radius_px: RADIUS,
        interval: [low, high],
        method: noise.method,
        samples: noise.samples,
    })
}

/// The amount after which white noise has this ratio of the stds of its two finest levels, each relative to white noise's.
fn amount_of(ratio: f32) -> f32 {
    let (mut low, mut high) = (0.0, MAX_AMOUNT);
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        let [fine, coarse, ..] = band_gains(middle);
        if fine / coarse < ratio { low = middle } else { high = middle }
    }
    low
}

/// By how much the stds of the levels grow in white noise that is sharpened.
fn band_gains(amount: f32) -> [f32; NOISE_LEVELS] {
    // Of the levels of noise x and of y = x - G x: the mean of x y and of y y over that of x x.
    static MOMENTS: OnceLock<[[f32; 2]; NOISE_LEVELS]> = OnceLock::new();
    let moments = MOMENTS.get_or_init(|| {
        let noise = Plane::from_fn(256, 256, |x, y| uniform(x as u64, y as u64) - 0.5);
        let smooth = filter::gaussian_blur(&noise, RADIUS);
        let detail = Plane::from_fn(256, 256, |x, y| noise.at(x, y) - smooth.at(x, y));
        let [x, y] = [&noise, &detail].map(|p| pyramid::laplacian(p, NOISE_LEVELS).0);
        std::array::from_fn(|l| {
            let dot = |a: &Plane, b: &Plane| a.data().iter().zip(b.data()).map(|(a, b)| a * b).sum::<f32>();
            [dot(&x[l], &y[l]), dot(&y[l], &y[l])].map(|v| v / dot(&x[l], &x[l]))
        })
    });
    moments.map(|[xy, yy]| (1.0 + 2.0 * amount * xy + amount * amount * yy).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{NoiseInterval, NoiseLevel};

    /// White noise of std 0.01 times some factor in each level, known to within 4 %.
    fn noise(factors: [f32; NOISE_LEVELS]) -> NoiseModel {
        let white = white_band_std();
        let std = |l: usize| 0.01 * white[l] * factors[l];
        let levels = std::array::from_fn(|l| NoiseLevel { slope: [0.0; 3], intercept: [std(l); 3] });
        let interval =
            |l: usize| NoiseInterval { slope: [[0.0; 2]; 3], intercept: [[0.96 * std(l), 1.04 * std(l)]; 3] };
        NoiseModel { interval: Some(std::array::from_fn(interval)), ..NoiseModel::given(levels, 1.0) }
    }

    #[test]
    fn sharpened_noise_tells_by_how_much() {
        for amount in [0.8, 1.2, 2.0] {
            let found = of_noise(&noise(band_gains(amount))).expect("its fine detail is too strong");
            assert!((found.amount - amount).abs() < 1e-2, "{found:?}");
            assert!(found.interval[0] < amount && amount < found.interval[1], "{found:?}");
        }
    }

    #[test]
    fn white_and_smoothed_noise_were_not_sharpened() {
        assert!(of_noise(&noise([1.0; NOISE_LEVELS])).is_none());
        assert!(of_noise(&noise([0.6, 0.9, 1.0, 1.0])).is_none());
        let unsure = NoiseModel { interval: None, ..noise(band_gains(1.0)) };
        assert!(of_noise(&unsure).is_none());
    }
}
