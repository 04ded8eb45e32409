//! Measures of how close two frames are.

use crate::{Encoded, Error, Plane, Raster, Result, filter};

/// Peak signal-to-noise ratio in dB for a peak of 1, over all three channels of the pixels in `mask` (all pixels if `None`).
/// Infinite if the two are the same.
///
/// # Errors
/// If sizes differ, or there is no pixel to compare.
pub fn psnr(a: &Encoded, b: &Encoded, mask: Option<&Raster<bool>>) -> Result<f64> {
    check_sizes(a, b, mask)?;
    let squares = Raster::from_fn(a.0.width(), a.0.height(), |x, y| {
        a.0.at(x, y).iter().zip(b.0.at(x, y)).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / 3.0
    });
    Ok(-10.0 * mean_over(&squares, mask)?.log10())
}

/// Structural similarity of the luma (Wang et al. 2004: 11 x 11 Gaussian window of std 1.5 px, K1 0.01, K2 0.03), its mean over the
/// pixels in `mask` (all pixels if `None`); 1 if the two are the same. Outside the image, the nearest pixel inside is repeated.
///
/// # Errors
/// If sizes differ, or there is no pixel to compare.
pub fn ssim(a: &Encoded, b: &Encoded, mask: Option<&Raster<bool>>) -> Result<f64> {
    check_sizes(a, b, mask)?;
    let (a, b) = (a.luma(), b.luma());
    let products = Raster::from_fn(a.width(), a.height(), |x, y| {
        let (a, b) = (a.at(x, y), b.at(x, y));
        [a, b, a * a, b * b, a * b]
    });
    let gaussian: Vec<f32> = (0..6).map(|i| (-(i * i) as f32 / 4.5).exp()).collect();
    let sum = 2.0 * gaussian.iter().sum::<f32>() - gaussian[0];
    let window: Vec<f32> = gaussian.iter().map(|g| g / sum).collect();
    let similarity = filter::convolve(&products, &window).map(|means| {
        let [a, b, aa, bb, ab] = means.map(f64::from);
        let (c1, c2) = (0.01f64.powi(2), 0.03f64.powi(2));
        ((2.0 * a * b + c1) * (2.0 * (ab - a * b) + c2))
            / ((a * a + b * b + c1) * (aa - a * a + bb - b * b + c2))
    });
    mean_over(&similarity, mask)
}

/// The pixels at most `distance` px (in x and in y) from a pixel that the object covers by more than a hundredth: the area in which
/// composites are compared.
pub fn object_area(alpha: &Plane, distance: usize) -> Raster<bool> {
    let (w, h) = alpha.size();
    let near = |i: usize, n: usize| i.saturating_sub(distance)..(i + distance + 1).min(n);
    let rows = Raster::from_fn(w, h, |x, y| near(x, w).any(|x| alpha.at(x, y) > 0.01));
    Raster::from_fn(w, h, |x, y| near(y, h).any(|y| rows.at(x, y)))
}

fn check_sizes(a: &Encoded, b: &Encoded, mask: Option<&Raster<bool>>) -> Result<()> {
    let size = a.0.size();
    if b.0.size() != size || mask.is_some_and(|m| m.size() != size) {
        return Err(Error::new(
            "frames of different sizes cannot be compared; give frames and a mask of one size",
        ));
    }
    Ok(())
}

fn mean_over(values: &Raster<f64>, mask: Option<&Raster<bool>>) -> Result<f64> {
    let (mut sum, mut count) = (0.0, 0usize);
    for (i, v) in values.data().iter().enumerate() {
        if mask.is_none_or(|m| m.data()[i]) {
            sum += v;
            count += 1;
        }
    }
    if count == 0 {
        return Err(Error::new("there is no pixel to compare; the frames or the mask are empty"));
    }
    Ok(sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(offset: f32) -> Encoded {
        Encoded(Raster::from_fn(64, 48, |x, y| {
            let v = 0.3 + offset + 0.2 * ((0.7 * x as f32).sin() * (0.5 * y as f32).cos());
            [v, v * 0.9, v * 0.8]
        }))
    }

    #[test]
    fn equal_frames_are_perfect() {
        assert_eq!(psnr(&texture(0.0), &texture(0.0), None).unwrap(), f64::INFINITY);
        assert!((ssim(&texture(0.0), &texture(0.0), None).unwrap() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn known_differences_have_known_values() {
        assert!((psnr(&texture(0.0), &texture(0.1), None).unwrap() - 20.88).abs() < 0.02); // channels differ by 0.1, 0.09, 0.08
        let flat = |v: f32| Encoded(Raster::filled(20, 20, [v; 3]));
        assert!((psnr(&flat(0.4), &flat(0.5), None).unwrap() - 20.0).abs() < 1e-4);
        let (a, b, c) = (0.4, 0.5, 1e-4);
        let want = (2.0 * a * b + c) / (a * a + b * b + c);
        assert!((ssim(&flat(0.4), &flat(0.5), None).unwrap() - want).abs() < 1e-3);
    }

    #[test]
    fn what_is_wrong_is_seen() {
        let shifted = Encoded(Raster::from_fn(64, 48, |x, y| texture(0.0).0.at((x + 2) % 64, y)));
        assert!(psnr(&texture(0.0), &shifted, None).unwrap() < 25.0);
        assert!(ssim(&texture(0.0), &shifted, None).unwrap() < 0.8);
        let inverted = Encoded(texture(0.0).0.map(|p| p.map(|v| 0.6 - v)));
        assert!(ssim(&texture(0.0), &inverted, None).unwrap() < 0.0);
    }

    #[test]
    fn only_the_mask_counts() {
        let mut b = texture(0.0);
        b.0.row_mut(5)[7] = [1.0; 3];
        let mut mask = Raster::filled(64, 48, true);
        assert!(psnr(&texture(0.0), &b, Some(&mask)).unwrap() < 50.0);
        mask.row_mut(5)[7] = false;
        assert_eq!(psnr(&texture(0.0), &b, Some(&mask)).unwrap(), f64::INFINITY);
    }

    #[test]
    fn nothing_to_compare_is_an_error() {
        assert!(psnr(&texture(0.0), &Encoded(Raster::filled(3, 3, [0.0; 3])), None).is_err());
        assert!(ssim(&texture(0.0), &texture(0.0), Some(&Raster::filled(64, 48, false))).is_err());
        assert!(psnr(&texture(0.0), &texture(0.0), Some(&Raster::filled(64, 47, true))).is_err());
    }

    #[test]
    fn the_object_s_area_grows_by_the_distance() {
        let mut alpha = Plane::filled(30, 20, 0.0);
        alpha.row_mut(10)[12] = 0.5;
        let area = object_area(&alpha, 3);
        assert_eq!(area.data().iter().filter(|v| **v).count(), 49);
        assert!(area.at(9, 13) && !area.at(8, 10));
    }
}
