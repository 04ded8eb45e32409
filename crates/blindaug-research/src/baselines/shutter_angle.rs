//! "Shutter-angle-like": the exposure fraction from the extent of linear blur over the optical flow, the idea of "Video shutter angle
//! estimation using optical flow and linear blur" (arXiv 2303.10247). The extent of the blur is found by our own version of a textbook
//! method, not by the authors' network.
//!
//! The derivative along the motion of what a box of length L has blurred is anticorrelated at the distance L: its autocorrelation has
//! its minimum there (Yitzhaky & Kopeika 1997).

use super::light;
use blindaug::{Encoded, Flow, Plane, Transfer};

/// The side of a patch and the distance of one patch from the next, px.
const PATCH: usize = 64;
const STRIDE: usize = 32;
/// The motion in a patch must be at least this long, px, and differ by at most this share of its length.
const SHORTEST: f32 = 4.0;
const UNEVEN: f32 = 0.15;
/// The fewest patches that tell the exposure.
const FEWEST: usize = 8;

/// An exposure fraction and the number of patches that it rests on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShutterAngle {
    /// The exposure fraction.
    pub exposure: f32,
    /// The number of patches.
    pub patches: usize,
}

/// The median over patches of blur extent over motion; `None` if too few patches tell it. Each frame comes with its motion in px per
/// frame interval.
pub fn measure(frames: &[(&Encoded, &Flow)]) -> Option<ShutterAngle> {
    let mut ratios = vec![];
    for (frame, motion) in frames {
        let light = light(&frame.to_linear(Transfer::Srgb));
        let (w, h) = light.size();
        for top in (0..h.saturating_sub(PATCH - 1)).step_by(STRIDE) {
            for left in (0..w.saturating_sub(PATCH - 1)).step_by(STRIDE) {
                ratios.extend(of_patch(&light, motion, left, top));
            }
        }
    }
    ratios.sort_by(f32::total_cmp);
    let patches = ratios.len();
    (patches >= FEWEST).then(|| ShutterAngle { exposure: ratios[patches / 2].min(1.0), patches })
}

/// The blur's extent in a patch over its motion; `None` if the motion is short or uneven, or there is no clear minimum.
fn of_patch(light: &Plane, motion: &Flow, left: usize, top: usize) -> Option<f32> {
    let at = |i: usize| motion.at(left + i % PATCH, top + i / PATCH);
    let places = || (0..PATCH * PATCH).step_by(7);
    let n = places().count() as f32;
    let mean: [f32; 2] = [0, 1].map(|k| places().map(|i| at(i)[k]).sum::<f32>() / n);
    let length = mean[0].hypot(mean[1]);
    let apart = places().map(|i| (at(i)[0] - mean[0]).hypot(at(i)[1] - mean[1])).sum::<f32>() / n;
    if !(length >= SHORTEST && apart <= UNEVEN * length && 1.2 * length < 0.5 * PATCH as f32) {
        return None;
    }
    let [u, v] = mean.map(|m| m / length);
    // Derivatives along lines of the motion's direction, which lie a pixel apart.
    let half = 0.5 * PATCH as f32;
    let (x0, y0) = (left as f32 + half, top as f32 + half);
    // A rotated square of this half side lies within the patch.
    let reach = (half / (u.abs() + v.abs())) as i32 - 1;
    let value = |along: f32, across: i32| {
        let across = across as f32;
        light.bilinear(x0 + along * u - across * v, y0 + along * v + across * u)
    };
    let lines: Vec<Vec<f32>> = (-reach..=reach)
        .map(|across| {
            (-reach..reach).map(|i| value(i as f32 + 1.0, across) - value(i as f32, across)).collect()
        })
        .collect();
    let longest = (1.2 * length).ceil() as usize + 1;
    let correlation = |lag: usize| {
        let products =
            lines.iter().flat_map(|l| l.iter().zip(l.get(lag..).unwrap_or(&[])).map(|(a, b)| a * b));
        let (sum, n) = products.fold((0.0f32, 0usize), |(sum, n), p| (sum + p, n + 1));
        sum / n.max(1) as f32
    };
    let curve: Vec<f32> = (0..=longest).map(correlation).collect();
    let lowest = (2..longest).min_by(|&a, &b| curve[a].total_cmp(&curve[b]))?;
    // Noise alone has minima, too, but shallow ones.
    if curve[lowest] > -0.12 * curve[0] {
        return None;
    }
    // A parabola through the minimum and its neighbours.
    let [a, b, c] = [lowest - 1, lowest, lowest + 1].map(|i| curve[i]);
    let shift = 0.5 * (a - c) / (a - 2.0 * b + c).max(1e-12);
    Some((lowest as f32 + shift.clamp(-0.5, 0.5)) / length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::ExposureFraction;
    use blindaug::synth::motion_blur::motion_blur;
    use blindaug_scenes::scene::{Exposure, Scene};

    #[test]
    fn the_exposure_is_found_where_the_motion_is_known() {
        let sharp = Scene::new(3, (320, 240)).picture(2.0, Exposure::default(), 0);
        let motion = Flow::filled(320, 240, [13.0, 5.0]);
        for exposure in [0.4, 0.6, 0.9] {
            let moved = motion_blur(&sharp.0, &motion, ExposureFraction(exposure)).unwrap();
            let frame = blindaug::Linear(moved).to_encoded(Transfer::Srgb);
            let found = measure(&[(&frame, &motion)]).unwrap();
            assert!((found.exposure - exposure).abs() < 0.06, "{exposure}: {found:?}");
            // A motion that is taken for longer than it is gives a shorter exposure.
            let wrong = measure(&[(&frame, &motion.map(|m| m.map(|v| 1.5 * v)))]);
            assert!(wrong.is_none_or(|w| (w.exposure - exposure).abs() > 0.06), "{exposure}: {wrong:?}");
        }
        // A still picture tells nothing.
        assert!(measure(&[(&sharp.to_encoded(Transfer::Srgb), &motion.map(|_| [0.0; 2]))]).is_none());
    }
}
