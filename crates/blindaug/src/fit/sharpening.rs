//! The estimate of the camera's sharpening from its noise: a sensor's noise is white, and optics, demosaicing, denoising and coding can
//! only weaken its fine detail. If the fine detail is stronger than that of white noise, an unsharp mask has amplified it.
//!
//! Overshoot at edges, the other trace that sharpening leaves, is not used, since the edges of natural images have as much overshoot
//! without sharpening (docs/lab-log.md).

use super::noise::{NoiseFit, NoisePoint};
use super::robust::uniform;
use crate::model::{Estimate, Method, NOISE_LEVELS, Reason, SharpeningModel};
use crate::portable::Portable;
use crate::synth::noise::white_band_std;
use crate::{Plane, filter, pyramid};
use std::sync::OnceLock;

/// The assumed std of the mask's Gaussian, px, which the ratio of two levels of noise does not tell beside the amount.
const RADIUS: f32 = 1.0;
/// The relative std of the ratio of the two finest levels that stands for errors of the model of real noise.
const FLOOR: f32 = 0.05;
/// The amount that the interval must exceed for the camera to count as one that sharpens.
const MIN_AMOUNT: f32 = 0.15;
/// The largest amount of the search.
const MAX_AMOUNT: f32 = 8.0;

/// The sharpening that noise between frames shows; unknown if the noise may not have been sharpened.
pub(super) fn of_noise(fit: &NoiseFit) -> Estimate<SharpeningModel> {
    const MIDDLE: f32 = 0.5;
    let noise = match &fit.model {
        Estimate::Known(noise) => noise,
        Estimate::Unknown(_) => {
            return Estimate::unknown(Reason::Flat, "it shows in noise, which is unknown");
        }
    };
    if noise.method() == Method::Spatial {
        // In one frame coarse noise is taken to be white, so the ratio of levels tells nothing.
        let why = "it shows in noise between frames, and noise was measured in single frames";
        return Estimate::unknown(Reason::TooShort, why);
    }
    let white = white_band_std();
    let mean = |v: [f32; 3]| v.iter().sum::<f32>() / 3.0;
    // The std of a level over that of white noise, and its relative variance by the scatter of the level's points around the line.
    let level = |l: usize| {
        let off = |p: &NoisePoint| (mean(p.sigma) / mean(noise.std(l, p.y)).max(1e-6)).portable_ln().powi(2);
        let of_points: Vec<f32> = fit.points.iter().filter(|p| p.level == l).map(off).collect();
        let points = of_points.len().max(1) as f32;
        (mean(noise.std(l, MIDDLE)) / white[l], of_points.iter().sum::<f32>() / (points * points))
    };
    let ((fine, fine_variance), (coarse, coarse_variance)) = (level(0), level(1));
    if fine <= 0.0 || coarse <= 0.0 {
        return Estimate::unknown(
            Reason::NotSeen,
            "it shows in noise, of which there is none in the middle greys",
        );
    }
    let ratio = fine / coarse;
    let reach = 1.96 * (fine_variance + coarse_variance + FLOOR * FLOOR).sqrt();
    let [amount, low, high] =
        [ratio, ratio * (-reach).portable_exp(), ratio * reach.portable_exp()].map(amount_of);
    if low <= MIN_AMOUNT {
        let why = "none is seen: fine noise is no stronger than white noise is";
        return Estimate::unknown(Reason::NotSeen, why);
    }
    Estimate::Known(SharpeningModel {
        amount,
        radius_px: RADIUS,
        interval: [low, high],
        method: noise.method(),
        samples: noise.samples(),
    })
}

/// The amount of a mask after which white noise has this ratio of the stds of its two finest levels, each over its std before.
fn amount_of(ratio: f32) -> f32 {
    let (mut low, mut high) = (0.0, MAX_AMOUNT);
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        let [fine, coarse, ..] = band_gains(middle);
        if fine / coarse < ratio { low = middle } else { high = middle }
    }
    low
}

/// The factors by which the stds of the levels of white noise grow when it is sharpened.
fn band_gains(amount: f32) -> [f32; NOISE_LEVELS] {
    // For each level of noise x and of y = x - G x: the mean of x y and that of y y, both over the mean of x x.
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
    use crate::model::{Estimate, NoiseLevel, NoiseLines, NoiseModel};

    /// White noise of std 0.01, times a factor in each level, in points that scatter by 4 %.
    fn noise(factors: [f32; NOISE_LEVELS], method: Method) -> NoiseFit {
        let std = |l: usize| 0.01 * white_band_std()[l] * factors[l];
        let levels = std::array::from_fn(|l| NoiseLevel { slope: [0.0; 3], intercept: [std(l); 3] });
        let point = |level: usize, i: usize| NoisePoint {
            level,
            y: 0.1 * i as f32,
            sigma: [std(level) * if i.is_multiple_of(2) { 0.96 } else { 1.04 }; 3],
            samples: 50,
        };
        NoiseFit {
            model: Estimate::Known(NoiseModel::Lines(NoiseLines {
                method,
                ..NoiseModel::given(levels, 1.0).lines().clone()
            })),
            luma: None,
            points: (0..NOISE_LEVELS).flat_map(|l| (1..9).map(move |i| point(l, i))).collect(),
            coding_spread: 0.0,
            single_spread: 0.0,
        }
    }

    #[test]
    fn sharpened_noise_tells_by_how_much() {
        for amount in [0.6, 1.2, 2.0] {
            let found =
                of_noise(&noise(band_gains(amount), Method::Temporal)).into_known().expect("it is blue");
            assert!((found.amount - amount).abs() < 1e-2, "{found:?}");
            assert!(found.interval[0] < amount && amount < found.interval[1], "{found:?}");
        }
    }

    #[test]
    fn white_and_smoothed_noise_were_not_sharpened_and_a_single_frame_does_not_tell() {
        assert!(of_noise(&noise([1.0; NOISE_LEVELS], Method::Temporal)).known().is_none());
        assert!(of_noise(&noise([0.6, 0.9, 1.0, 1.0], Method::Temporal)).known().is_none());
        assert!(of_noise(&noise(band_gains(1.2), Method::Spatial)).known().is_none());
    }
}
