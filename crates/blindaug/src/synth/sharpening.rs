//! The camera's sharpening, an unsharp mask of encoded values, and its inverse.

use crate::model::SharpeningModel;
use crate::{Raster, filter};

/// The sharpened image `v + amount (v - G v)`, not clamped.
pub fn sharpen(image: &Raster<[f32; 3]>, model: &SharpeningModel) -> Raster<[f32; 3]> {
    let blurred = filter::gaussian_blur(image, model.radius_px);
    Raster::from_fn(image.width(), image.height(), |x, y| {
        let (v, g) = (image.at(x, y), blurred.at(x, y));
        std::array::from_fn(|c| v[c] + model.amount * (v[c] - g[c]))
    })
}

/// The share of sharpening's change that unsharpening may leave, which is less than a step of 8 bits.
pub const LEFT: f32 = 2e-3;

/// The image of which [`sharpen`] makes the given one. It stays in the given image's range, as the inverse is a mean with positive weights.
pub(crate) fn unsharpen(image: &Raster<[f32; 3]>, model: &SharpeningModel) -> Raster<[f32; 3]> {
    // Sharpening's gain lies between 1 and 1 + amount, so that each of Richardson's steps leaves at most this share of the error.
    let left = model.amount / (2.0 + model.amount);
    let steps = (LEFT.ln() / left.ln()).ceil() as usize;
    (0..steps).fold(image.clone(), |guess, _| {
        let again = sharpen(&guess, model);
        Raster::from_fn(image.width(), image.height(), |x, y| {
            let (v, g, a) = (image.at(x, y), guess.at(x, y), again.at(x, y));
            std::array::from_fn(|c| g[c] + (1.0 - left) * (v[c] - a[c]))
        })
    })
}

/// The distance, px, to which a change of one pixel changes the sharpened image.
pub(crate) fn reach_px(model: &SharpeningModel) -> usize {
    filter::gaussian_kernel(model.radius_px).len() - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: fn(f32) -> SharpeningModel = |amount| SharpeningModel::given(amount, 1.5);

    fn worst(a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>) -> f32 {
        let differences =
            a.data().iter().flatten().zip(b.data().iter().flatten()).map(|(a, b)| (a - b).abs());
        differences.fold(0.0, f32::max)
    }

    fn step() -> Raster<[f32; 3]> {
        Raster::from_fn(41, 30, |x, _| [if x < 20 { 0.3 } else { 0.7 }, 0.5, 0.1])
    }

    #[test]
    fn a_constant_stays_and_a_step_overshoots_by_what_the_formula_says() {
        let sharp = sharpen(&step(), &MODEL(0.8));
        // The kernel of the last pixel before the step lies beyond the step right of its centre.
        let beyond: f32 = filter::gaussian_kernel(1.5)[1..].iter().sum();
        for (x, want) in [(0, 0.3), (19, 0.3 - 0.8 * 0.4 * beyond), (20, 0.7 + 0.8 * 0.4 * beyond), (40, 0.7)]
        {
            let [r, g, b] = sharp.at(x, 15);
            assert!((r - want).abs() < 1e-5 && (g - 0.5).abs() < 1e-5 && (b - 0.1).abs() < 1e-5, "{x}: {r}");
        }
        assert!(sharpen(&step(), &MODEL(0.0)) == step());
        let far = 20 + reach_px(&MODEL(0.8));
        assert!((sharp.at(far - 1, 15)[0] - 0.7).abs() > 1e-6 && (sharp.at(far, 15)[0] - 0.7).abs() < 1e-6);
    }

    #[test]
    fn unsharpen_is_the_inverse() {
        let texture = Raster::from_fn(50, 40, |x, y| {
            [((x * 37 + y * 91) % 17) as f32 / 17.0, (x / 7 + y / 5) as f32 % 2.0, 0.02 * x as f32]
        });
        for amount in [0.0, 0.3, 1.0, 5.0] {
            let sharp = sharpen(&texture, &MODEL(amount));
            let back = unsharpen(&sharp, &MODEL(amount));
            let done = worst(&sharp, &texture);
            assert!(worst(&back, &texture) <= 3e-3 * done + 1e-5, "{amount}: {}", worst(&back, &texture));
            assert!(amount == 0.0 || done > 0.1, "{amount}: {done}");
        }
    }
}
