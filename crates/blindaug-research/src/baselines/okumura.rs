//! "Okumura-like": one Gaussian from the rim of a circular marker. It follows what the paper says of Okumura et al. (2006), whose code is
//! not public.
//!
//! The picture is sampled across the rim of a disk whose place is known. The std of each edge depends on the angle of its normal: defocus
//! spreads every edge by `sigma_d`, and motion along `phi` spreads it by `sigma_m |cos(theta - phi)|`, so that the variance is
//! linear in 1, cos 2 theta and sin 2 theta. The layer as a whole is blurred by that one elliptical Gaussian.

use super::light;
use blindaug::{Linear, Plane, Premultiplied, Raster};
use blindaug_scenes::scene::RimPoint;

/// An elliptical Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EllipticalGaussian {
    /// The std in every direction, px.
    pub sigma_d: f32,
    /// The std that is added, in variance, along `phi`, px.
    pub sigma_m: f32,
    /// The direction of the motion, radians from x to y, in [-pi/2, pi/2].
    pub phi: f32,
}

/// The variance that a sharp edge has by the pixel's own area and by the linear interpolation between pixels, px^2.
const SHARP: f32 = 1.0 / 12.0 + 1.0 / 6.0;
/// The least contrast of an edge, of light in [0, 1].
const LEAST_CONTRAST: f32 = 0.05;
/// The fewest edges from which a Gaussian is found.
const FEWEST: usize = 12;

/// The Gaussian that spreads the rim's edges; `None` if too few of them are seen. `reach_px` is how far on either side of the rim nothing
/// but the disk and its board is seen.
pub fn measure(picture: &Linear, rim: &[RimPoint], reach_px: f32) -> Option<EllipticalGaussian> {
    let light = light(picture);
    let edges: Vec<(f32, f32)> = rim
        .iter()
        .filter(|p| p.visible)
        .filter_map(|p| {
            let variance = spread(&light, p, reach_px)?;
            Some((p.normal[1].atan2(p.normal[0]), variance - SHARP))
        })
        .collect();
    if edges.len() < FEWEST {
        return None;
    }
    let mut weights = vec![1.0; edges.len()];
    let mut fitted = [0.0; 3];
    // Edges that do not fit count for less: Cauchy's weights, at the median of the residuals.
    for _ in 0..20 {
        fitted = least_squares(&edges, &weights)?;
        let residual = |&(theta, variance): &(f32, f32)| {
            let [a, b, c] = fitted;
            (variance - a - b * (2.0 * theta).cos() - c * (2.0 * theta).sin()).abs()
        };
        let mut sorted: Vec<f32> = edges.iter().map(residual).collect();
        sorted.sort_by(f32::total_cmp);
        let scale = 2.0 * sorted[sorted.len() / 2].max(1e-4);
        for (w, e) in weights.iter_mut().zip(&edges) {
            *w = 1.0 / (1.0 + (residual(e) / scale).powi(2));
        }
    }
    let [a, b, c] = fitted;
    let motion = 2.0 * b.hypot(c);
    Some(EllipticalGaussian {
        sigma_d: (a - 0.5 * motion).max(0.0).sqrt(),
        sigma_m: motion.min(2.0 * a.max(0.0)).sqrt(),
        phi: 0.5 * c.atan2(b),
    })
}

/// The variance of the Gaussian step that fits the picture across the rim best, px^2; `None` where there is no step.
fn spread(light: &Plane, at: &RimPoint, reach_px: f32) -> Option<f32> {
    const STEP: f32 = 0.5;
    let n = (reach_px / STEP) as i32;
    let ([x, y], [u, v]) = (at.place, at.normal);
    let inside = |s: f32| {
        let (x, y) = (x + s * u, y + s * v);
        x >= 0.0 && y >= 0.0 && x <= light.width() as f32 - 1.0 && y <= light.height() as f32 - 1.0
    };
    if !inside(-reach_px) || !inside(reach_px) {
        return None;
    }
    let profile: Vec<[f32; 2]> =
        (-n..=n).map(|i| i as f32 * STEP).map(|s| [s, light.bilinear(x + s * u, y + s * v)]).collect();
    // For each width and offset, the levels on both sides follow by linear least squares.
    let misfit = |sigma: f32, offset: f32| -> (f32, f32) {
        let mut sums = [0.0f32; 5];
        for [s, value] in &profile {
            let step = 0.5 * libm::erff((s - offset) / (sigma * std::f32::consts::SQRT_2));
            for (sum, v) in sums.iter_mut().zip([step, *value, step * step, step * value, value * value]) {
                *sum += v;
            }
        }
        let n = profile.len() as f32;
        let [t, v, tt, tv, vv] = sums;
        let (stt, stv, svv) = (tt - t * t / n, tv - t * v / n, vv - v * v / n);
        let contrast = stv / stt.max(1e-9);
        (svv - contrast * stv, contrast)
    };
    let mut best = (f32::INFINITY, 0.0, 1.0, 0.0);
    let widths = (0..30).map(|i| 0.25 * (reach_px / 0.5).powf(i as f32 / 29.0));
    for sigma in widths {
        for offset in (-6..=6).map(|i| 0.25 * i as f32) {
            let (error, contrast) = misfit(sigma, offset);
            if error < best.0 {
                best = (error, offset, sigma, contrast);
            }
        }
    }
    let (_, offset, mut sigma, contrast) = best;
    // A finer search between the neighbours of the best width.
    let finer = (-10..=10).map(|i| sigma * 1.012f32.powi(i));
    let error = |s: &f32| misfit(*s, offset).0;
    sigma = finer.min_by(|a, b| error(a).total_cmp(&error(b)))?;
    (contrast.abs() >= LEAST_CONTRAST).then_some(sigma * sigma)
}

/// The weighted least squares of variance over 1, cos 2 theta and sin 2 theta, by Cramer's rule.
fn least_squares(edges: &[(f32, f32)], weights: &[f32]) -> Option<[f32; 3]> {
    let (mut m, mut r) = ([[0.0f64; 3]; 3], [0.0f64; 3]);
    for ((theta, variance), w) in edges.iter().zip(weights) {
        let basis = [1.0, f64::from(2.0 * theta).cos(), f64::from(2.0 * theta).sin()];
        for i in 0..3 {
            r[i] += f64::from(*w) * basis[i] * f64::from(*variance);
            for j in 0..3 {
                m[i][j] += f64::from(*w) * basis[i] * basis[j];
            }
        }
    }
    let det = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = det(m);
    (whole.abs() > 1e-9).then(|| {
        std::array::from_fn(|k| {
            let mut replaced = m;
            (0..3).for_each(|i| replaced[i][k] = r[i]);
            (det(replaced) / whole) as f32
        })
    })
}

/// The layer blurred as a whole.
pub fn blurred(layer: &Premultiplied, by: EllipticalGaussian) -> Premultiplied {
    let reach = (3.0 * by.sigma_d.hypot(by.sigma_m)).ceil() as i32;
    let (s, c) = by.phi.sin_cos();
    let (across, along) =
        ((by.sigma_d.powi(2)).max(1e-3), (by.sigma_d.powi(2) + by.sigma_m.powi(2)).max(1e-3));
    let mut taps: Vec<(i32, i32, f32)> = (-reach..=reach)
        .flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)))
        .map(|(dx, dy)| {
            let (x, y) = (dx as f32, dy as f32);
            let (u, v) = (c * x + s * y, c * y - s * x);
            (dx, dy, (-0.5 * (u * u / along + v * v / across)).exp())
        })
        .filter(|t| t.2 > 1e-4)
        .collect();
    let sum: f32 = taps.iter().map(|t| t.2).sum();
    taps.iter_mut().for_each(|t| t.2 /= sum);
    let (w, h) = layer.0.size();
    let mut out = Raster::filled(w, h, [0.0f32; 4]);
    // Only what is not transparent spreads.
    for y in 0..h {
        for (x, value) in layer.0.row(y).iter().enumerate().filter(|(_, p)| p[3] > 0.0) {
            for (dx, dy, weight) in &taps {
                let (x, y) = (x as i32 + dx, y as i32 + dy);
                if (0..w as i32).contains(&x) && (0..h as i32).contains(&y) {
                    let to = &mut out.row_mut(y as usize)[x as usize];
                    (0..4).for_each(|k| to[k] += weight * value[k]);
                }
            }
        }
    }
    Premultiplied(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    /// A black disk on white with noise, blurred by a Gaussian, and its rim.
    fn disk(by: EllipticalGaussian) -> (Linear, Vec<RimPoint>) {
        const W: usize = 128;
        const R: f32 = 30.0;
        let middle = 0.5 * (W as f32 - 1.0);
        let sharp = Premultiplied(Raster::from_fn(W, W, |x, y| {
            // The mean over 8 x 8 places of the pixel.
            let covered = (0..64).filter(|i| {
                let place = |v: usize, k: usize| v as f32 + (k as f32 + 0.5) / 8.0 - 0.5 - middle;
                place(x, i % 8).hypot(place(y, i / 8)) < R
            });
            [1.0 - 0.9 * covered.count() as f32 / 64.0, 0.0, 0.0, 1.0]
        }));
        let seen = blurred(&sharp, by);
        let mut rng = StdRng::seed_from_u64(1);
        let noise: Vec<f32> = (0..W * W).map(|_| 0.03 * (rng.random::<f32>() - 0.5)).collect();
        let picture = Linear(Raster::from_fn(W, W, |x, y| [seen.0.at(x, y)[0] + noise[y * W + x]; 3]));
        let rim = (0..64).map(|i| {
            let (s, c) = (std::f32::consts::TAU * i as f32 / 64.0).sin_cos();
            RimPoint { place: [middle + R * c, middle + R * s], normal: [c, s], visible: true }
        });
        (picture, rim.collect())
    }

    #[test]
    fn the_rim_tells_the_gaussian() {
        for (sigma_d, sigma_m, phi) in [(1.0, 3.0, 0.4), (2.0, 4.0, -1.2), (3.0, 0.0, 0.0)] {
            let (picture, rim) = disk(EllipticalGaussian { sigma_d, sigma_m, phi });
            let found = measure(&picture, &rim, 20.0).unwrap();
            assert!((found.sigma_d - sigma_d).abs() < 0.25, "{found:?}");
            if sigma_m > 0.0 {
                assert!((found.sigma_m - sigma_m).abs() < 0.3 && (found.phi - phi).abs() < 0.06, "{found:?}");
                // Normals that are turned by a right angle turn the motion, too.
                let turned: Vec<RimPoint> =
                    rim.iter().map(|p| RimPoint { normal: [-p.normal[1], p.normal[0]], ..*p }).collect();
                let wrong = measure(&picture, &turned, 20.0);
                assert!(wrong.is_none_or(|w| (w.phi - phi).abs() > 0.5), "{wrong:?}");
            }
        }
        let (picture, rim) = disk(EllipticalGaussian::default());
        let sharp = measure(&picture, &rim, 20.0).unwrap();
        assert!(sharp.sigma_d < 0.35 && sharp.sigma_m < 0.4, "{sharp:?}");
        assert!(measure(&picture, &rim[..8], 20.0).is_none());
    }
}
