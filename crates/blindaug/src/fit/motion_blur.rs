//! The fit of the exposure to a frame and its version without motion blur: the paper's search, made continuous.

pub use super::robust::BLOCK;
use super::robust::{Samples, places_of_contrast};
use crate::model::ExposureFraction;
use crate::{Flow, Plane, par};

/// The number of exposure fractions, evenly from 0 to 1, at which predictions are computed; between them, predictions are interpolated.
pub const STEPS: usize = 21;

/// The fit of an exposure to one frame.
#[derive(Clone, Debug)]
pub struct ExposureFit {
    /// The estimated exposure fraction.
    pub exposure: ExposureFraction,
    /// The variance of the exposure fraction, with the blocks of the image taken as independent.
    pub variance: f64,
    /// The number of pixels that the estimate rests on.
    pub samples: usize,
    /// The points (exposure fraction, minus Huber's loss of the scaled errors), 0 at the maximum.
    pub curve: Vec<[f32; 2]>,
}

/// The mean of an image along the path of pixel (x, y), the same as in [`crate::synth::motion_blur`], but with cubic taps: the bilinear
/// taps of the synthesis add blur of variance 1/6 px^2, for which the estimated exposure would be too short.
pub(super) fn mean_along(image: &Plane, x: usize, y: usize, [u, v]: [f32; 2], lambda: f32) -> f32 {
    let (dx, dy) = (lambda * u, lambda * v);
    let length = dx.hypot(dy);
    if !(length > 0.0 && length < 1000.0) {
        return image.at(x, y);
    }
    let taps = length.ceil() as usize + 1;
    let at = |i: usize| {
        let t = (i as f32 + 0.5) / taps as f32 - 0.5;
        image.cubic(x as f32 + t * dx, y as f32 + t * dy)
    };
    (0..taps).map(at).sum::<f32>() / taps as f32
}

/// The exposure for which `sharp`, blurred along the flow, is closest to `target`. Both are luma in the light that is
/// blurred; `weight` is the inverse std of the target's noise.
///
/// The result is `None` if nothing with texture moves. All images must have one size.
pub fn fit_exposure(target: &Plane, weight: &Plane, sharp: &Plane, flow: &Flow) -> Option<ExposureFit> {
    let (w, h) = sharp.size();
    let blurred = |x: usize, y: usize, lambda: f32| mean_along(sharp, x, y, flow.at(x, y), lambda);
    let moves = |x: usize, y: usize| {
        let [u, v] = flow.at(x, y);
        let speed = u.hypot(v);
        // Next to an edge of the motion, a pixel shows things that move differently.
        let near = |dx: isize, dy: isize| flow.at_clamped(x as isize + dx, y as isize + dy);
        let around = [(-8, 0), (8, 0), (0, -8), (0, 8)];
        (1.0..100.0).contains(&speed)
            && around
                .iter()
                .all(|&(dx, dy)| (near(dx, dy)[0] - u).hypot(near(dx, dy)[1] - v) < 0.15 * speed + 0.3)
    };
    let contrast = |x: usize, y: usize| (sharp.at(x, y) - blurred(x, y, 0.7)).abs() * weight.at(x, y);
    let places = places_of_contrast(w, h, 10, moves, contrast);
    if places.len() < 200 {
        return None;
    }
    let predicted: Vec<[f32; STEPS]> = par::map(places.len(), |i| {
        let (x, y) = places[i];
        std::array::from_fn(|k| blurred(x, y, k as f32 / (STEPS - 1) as f32))
    });
    let samples = Samples::new(&places, |x, y| (target.at(x, y), weight.at(x, y)));
    let model = |lambda: f32, i: usize| {
        let at = lambda.clamp(0.0, 1.0) * (STEPS - 1) as f32;
        let k = (at as usize).min(STEPS - 2);
        predicted[i][k] + (at - k as f32) * (predicted[i][k + 1] - predicted[i][k])
    };
    let best_near = |scale: f32, center: f32, reach: f32| {
        let (n, from) = (20, (center - reach).max(0.0));
        let step = ((center + reach).min(1.0) - from) / n as f32;
        (0..=n)
            .map(|i| from + step * i as f32)
            .map(|l| (samples.score(scale, |i| model(l, i)), l))
            .fold((f32::MIN, 0.0), |a, b| if b.0 > a.0 { b } else { a })
            .1
    };
    let mut lambda = best_near(1.0, 0.5, 0.5);
    for reach in [0.1, 0.05, 0.02] {
        let scale = samples.scale(|i| model(lambda, i));
        lambda = best_near(scale, lambda, reach);
    }
    let scale = samples.scale(|i| model(lambda, i));
    let (below, above) = ((lambda - 0.05).max(0.0), (lambda + 0.05).min(1.0));
    let covariance = samples.covariance(
        scale,
        |i| model(lambda, i),
        |i, k| {
            if k == 0 { (model(above, i) - model(below, i)) / (above - below) } else { 0.0 }
        },
    );
    let max = samples.score(scale, |i| model(lambda, i));
    let curve =
        (0..=50).map(|i| i as f32 / 50.0).map(|l| [l, samples.score(scale, |i| model(l, i)) - max]).collect();
    Some(ExposureFit {
        exposure: ExposureFraction(lambda),
        variance: covariance[0][0],
        samples: places.len(),
        curve,
    })
}
