//! How near a composite is to the picture in which the object is really there.

use blindaug::metrics::{psnr, ssim};
use blindaug::{Encoded, Raster, Result, byte_from_encoded};
use nv_flip::{DEFAULT_PIXELS_PER_DEGREE, FlipImageRgb8, flip};
use serde::{Deserialize, Serialize};

/// The likeness of two pictures over an area.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fidelity {
    /// The PSNR, dB.
    pub psnr: f64,
    /// The structural similarity of the luma, at most 1.
    pub ssim: f64,
    /// The mean of FLIP's error (Andersson et al. 2020) in [0, 1] for a viewer who sees 67 px per degree; 0 is best.
    pub flip: f64,
}

impl Fidelity {
    /// The likeness of `made` and `truth` over the pixels of `area`.
    ///
    /// # Errors
    /// If sizes differ or the area is empty.
    pub fn new(made: &Encoded, truth: &Encoded, area: &Raster<bool>) -> Result<Self> {
        let [psnr, ssim] = [psnr(made, truth, Some(area))?, ssim(made, truth, Some(area))?];
        let errors = flip(image(truth), image(made), DEFAULT_PIXELS_PER_DEGREE).to_vec();
        let within =
            errors.iter().zip(area.data()).filter(|(_, inside)| **inside).map(|(e, _)| f64::from(*e));
        let (sum, n) = within.fold((0.0, 0.0f64), |(sum, n), e| (sum + e, n + 1.0));
        Ok(Self { psnr, ssim, flip: sum / n.max(1.0) })
    }

    /// The values in the order of [`Self::NAMES`].
    pub fn values(self) -> [f64; 3] {
        [self.psnr, self.ssim, self.flip]
    }

    /// The names of the measures.
    pub const NAMES: [&str; 3] = ["PSNR, dB", "SSIM", "FLIP"];

    /// The digits after the point with which the measures are shown.
    pub const DIGITS: [usize; 3] = [2, 4, 4];

    /// Whether a larger value is better, for each measure.
    pub const LARGER_IS_BETTER: [bool; 3] = [true, true, false];
}

fn image(frame: &Encoded) -> FlipImageRgb8 {
    let bytes: Vec<u8> = frame.0.data().iter().flatten().map(|&v| byte_from_encoded(v)).collect();
    FlipImageRgb8::with_data(frame.0.width() as u32, frame.0.height() as u32, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(shift: usize) -> Encoded {
        let value = |x: usize, y: usize| ((x + shift) * 7 % 64 + y * 5 % 64) as f32 / 128.0;
        Encoded(Raster::from_fn(48, 32, |x, y| [value(x, y); 3]))
    }

    #[test]
    fn the_same_picture_is_best_and_a_shifted_one_worse() {
        let area = Raster::from_fn(48, 32, |x, _| x < 24);
        let same = Fidelity::new(&picture(0), &picture(0), &area).unwrap();
        assert!(same.psnr.is_infinite() && same.ssim > 0.9999 && same.flip < 1e-6, "{same:?}");
        let worse = Fidelity::new(&picture(2), &picture(0), &area).unwrap();
        assert!(worse.psnr < 20.0 && worse.ssim < 0.9 && worse.flip > 0.1, "{worse:?}");
    }

    #[test]
    fn what_differs_outside_the_area_does_not_count_for_the_psnr() {
        let area = Raster::from_fn(48, 32, |x, _| x < 24);
        let mut other = picture(0);
        other.0.row_mut(3)[40] = [1.0; 3];
        let seen = Fidelity::new(&other, &picture(0), &area).unwrap();
        assert!(seen.psnr.is_infinite() && seen.flip < 1e-3, "{seen:?}");
    }
}
