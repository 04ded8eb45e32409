//! Separable filters. Outside the image, the nearest pixel inside is repeated.

use crate::{Pixel, Raster, par};

/// The right half, centre first, of the discrete Gaussian of variance `sigma`^2 (Lindeberg 1990): `exp(-t) I_n(t)`.
///
/// Its variance is exact for every sigma >= 0, and two such kernels in a row equal the one whose variance is their sum. The kernel
/// is cut where less than 1e-5 of its weight is left outside, and normalised.
pub fn gaussian_kernel(sigma: f32) -> Vec<f32> {
    let t = f64::from(sigma) * f64::from(sigma);
    let radius = (6.0 * f64::from(sigma) + 8.0) as usize;
    // exp(-t) I_n(t) = 1/pi int_0^pi exp(t (cos a - 1)) cos(n a) da: the trapezoid rule converges exponentially.
    let steps = 2 * radius + 16;
    let angle = |i: usize| std::f64::consts::PI * i as f64 / steps as f64;
    let weight: Vec<f64> = (0..=steps)
        .map(|i| {
            (t * (angle(i).cos() - 1.0)).exp() * if i == 0 || i == steps { 0.5 } else { 1.0 } / steps as f64
        })
        .collect();
    let mut kernel: Vec<f64> =
        (0..=radius).map(|n| (0..=steps).map(|i| weight[i] * (n as f64 * angle(i)).cos()).sum()).collect();
    let mut outside = 0.0;
    while kernel.len() > 1 && outside + 2.0 * kernel[kernel.len() - 1].abs() < 1e-5 {
        outside += 2.0 * kernel.pop().unwrap_or(0.0).abs();
    }
    let sum = kernel[0] + 2.0 * kernel[1..].iter().sum::<f64>();
    kernel.iter().map(|k| (k / sum) as f32).collect()
}

/// Blurs with a discrete Gaussian of std `sigma` px.
pub fn gaussian_blur<P: Pixel>(src: &Raster<P>, sigma: f32) -> Raster<P> {
    if sigma <= 0.0 {
        return src.clone();
    }
    convolve(src, &gaussian_kernel(sigma))
}

/// Convolves rows and columns with a symmetric kernel, of which `half` is the right half, centre first.
pub fn convolve<P: Pixel>(src: &Raster<P>, half: &[f32]) -> Raster<P> {
    if half.len() <= 1 {
        return src.clone();
    }
    convolve_map(src, half, |v| v, |v| v)
}

/// Applies `before` to each pixel, convolves, and applies `after`, in strips of rows: intermediate images are never held whole,
/// since touching fresh memory takes longer than the sums.
pub(crate) fn convolve_map<S: Pixel, P: Pixel, R: Pixel>(
    src: &Raster<S>,
    half: &[f32],
    before: impl Fn(S) -> P + Sync + Send,
    after: impl Fn(P) -> R + Sync + Send,
) -> Raster<R> {
    let ((w, h), c, r) = (src.size(), P::CHANNELS, half.len() - 1);
    let mut out = Raster::filled(w, h, R::default());
    // The 2 r rows that neighbouring strips share are computed twice.
    let strip = (4 * r).clamp(32, 128);
    par::for_each_row(out.data_mut(), w * strip, |i, out| {
        let top = i * strip;
        let bottom = top + out.len() / w;
        let inside = top.saturating_sub(r)..(bottom + r).min(h);
        let mut rows = vec![P::default(); inside.len() * w];
        let mut padded = vec![P::default(); w + 2 * r];
        for (row, y) in rows.chunks_mut(w).zip(inside.clone()) {
            // The row with its ends repeated, so that the inner loop has no branch.
            for (p, &v) in padded[r..].iter_mut().zip(src.row(y)) {
                *p = before(v);
            }
            let (first, last) = (padded[r], padded[r + w - 1]);
            padded[..r].fill(first);
            padded[r + w..].fill(last);
            let padded = P::flat(&padded);
            for (b, block) in P::flat_mut(row).chunks_mut(BLOCK).enumerate() {
                let at = b * BLOCK + r * c;
                accumulate(block, half, |j, side| &padded[if side { at + j * c } else { at - j * c }..]);
            }
        }
        let mut line = vec![P::default(); w];
        for (y, out) in (top..).zip(out.chunks_mut(w)) {
            for (b, block) in P::flat_mut(&mut line).chunks_mut(BLOCK).enumerate() {
                accumulate(block, half, |j, side| {
                    let y = if side { (y + j).min(h - 1) } else { y.saturating_sub(j) };
                    &P::flat(&rows[(y - inside.start) * w..][..w])[b * BLOCK..]
                });
            }
            for (o, &v) in out.iter_mut().zip(&line) {
                *o = after(v);
            }
        }
    });
    out
}

/// [`convolve`] of the `w` x `h` rectangle at (x, y) alone, which may reach outside the image, with a kernel for rows and one for columns; it
/// runs on this thread.
pub(crate) fn convolve_rectangle<P: Pixel>(
    src: &Raster<P>,
    [along, down]: [&[f32]; 2],
    (x, y): (isize, isize),
    (w, h): (usize, usize),
) -> Raster<P> {
    let c = P::CHANNELS;
    let (r, below) = (along.len() - 1, down.len() - 1);
    let mut rows = Raster::filled(w, h + 2 * below, P::default());
    let mut padded: Vec<P> = Vec::with_capacity(w + 2 * r);
    for j in 0..h + 2 * below {
        let line = src.row((y + j as isize - below as isize).clamp(0, src.height() as isize - 1) as usize);
        let inside = |i: isize| i.clamp(0, line.len() as isize) as usize;
        let (first, last) = (x - r as isize, x + (w + r) as isize);
        padded.clear();
        padded.resize((-first).clamp(0, last - first) as usize, line[0]);
        padded.extend_from_slice(&line[inside(first)..inside(last)]);
        padded.resize(w + 2 * r, line[line.len() - 1]);
        let padded = P::flat(&padded);
        for (b, block) in P::flat_mut(rows.row_mut(j)).chunks_mut(BLOCK).enumerate() {
            let at = b * BLOCK + r * c;
            accumulate(block, along, |j, side| &padded[if side { at + j * c } else { at - j * c }..]);
        }
    }
    let mut out = Raster::filled(w, h, P::default());
    for y in 0..h {
        for (b, block) in P::flat_mut(out.row_mut(y)).chunks_mut(BLOCK).enumerate() {
            accumulate(block, down, |j, side| {
                &P::flat(rows.row(if side { y + below + j } else { y + below - j }))[b * BLOCK..]
            });
        }
    }
    out
}

/// The number of sums that are accumulated together: few enough to stay in registers.
const BLOCK: usize = 64;

/// `out[i] = half[0] tap(0)[i] + sum_j half[j] (tap(j, left)[i] + tap(j, right)[i])`
#[inline(always)]
fn accumulate<'a>(out: &mut [f32], half: &[f32], tap: impl Fn(usize, bool) -> &'a [f32]) {
    let n = out.len();
    let mut acc = [0.0f32; BLOCK];
    for (a, v) in acc[..n].iter_mut().zip(&tap(0, false)[..n]) {
        *a = half[0] * v;
    }
    for (j, &k) in half.iter().enumerate().skip(1) {
        let (left, right) = (&tap(j, false)[..n], &tap(j, true)[..n]);
        if n == BLOCK {
            for i in 0..BLOCK {
                acc[i] += k * (left[i] + right[i]);
            }
        } else {
            for i in 0..n {
                acc[i] += k * (left[i] + right[i]);
            }
        }
    }
    out.copy_from_slice(&acc[..n]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Plane;

    #[test]
    fn the_discrete_gaussian_has_exact_variance() {
        for sigma in [0.0, 0.1, 0.3, 0.7, 1.0, 2.5, 6.0, 12.0] {
            let k = gaussian_kernel(sigma);
            let variance: f32 = k.iter().enumerate().map(|(n, k)| 2.0 * (n * n) as f32 * k).sum();
            assert!(
                (variance - sigma * sigma).abs() < 2e-3 * (sigma * sigma).max(0.1),
                "{sigma}: {variance}"
            );
        }
    }

    #[test]
    fn two_gaussians_compose_to_one() {
        let p = Plane::from_fn(70, 41, |x, y| ((x * 37 + y * 91) % 17) as f32);
        let (a, b) = (gaussian_blur(&gaussian_blur(&p, 1.2), 0.9), gaussian_blur(&p, 1.5));
        for y in 12..29 {
            for x in 12..58 {
                assert!((a.at(x, y) - b.at(x, y)).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn a_constant_stays_and_a_pixel_spreads_symmetrically_with_its_energy_kept() {
        let c = Raster::filled(5, 3, [2.0f32, -1.0, 0.5]);
        for v in gaussian_blur(&c, 4.0).data() {
            assert!(v.iter().zip([2.0, -1.0, 0.5]).all(|(a, b)| (a - b).abs() < 1e-5));
        }
        let mut p = Plane::filled(41, 41, 0.0);
        p.row_mut(20)[20] = 1.0;
        let q = gaussian_blur(&p, 2.0);
        assert!((q.data().iter().sum::<f32>() - 1.0).abs() < 1e-4);
        assert!((q.at(17, 22) - q.at(23, 18)).abs() < 1e-9);
        assert!((q.at(17, 22) - q.at(22, 17)).abs() < 1e-9);
    }

    #[test]
    fn a_rectangle_is_convolved_as_the_whole_is() {
        let p = Raster::from_fn(70, 41, |x, y| [((x * 37 + y * 91) % 17) as f32, (x * y % 7) as f32, 1.0]);
        let kernel = gaussian_kernel(2.0);
        let whole = convolve(&p, &kernel);
        for (x0, y0, w, h) in
            [(0, 0, 70, 41), (5, 7, 33, 12), (60, 30, 10, 11), (-3, -2, 5, 6), (66, 38, 9, 9)]
        {
            let part = convolve_rectangle(&p, [&kernel; 2], (x0, y0), (w, h));
            for y in 0..h {
                for x in 0..w {
                    let (fx, fy) = (x0 + x as isize, y0 + y as isize);
                    if (0..70).contains(&fx) && (0..41).contains(&fy) {
                        assert_eq!(part.at(x, y), whole.at(fx as usize, fy as usize));
                    }
                }
            }
        }
        // Far outside the image, every value is that of the corner pixel.
        let far = convolve_rectangle(&p, [&kernel; 2], (200, -90), (2, 2));
        assert!((far.at(1, 1)[0] - p.at(69, 0)[0]).abs() < 1e-4);
    }

    #[test]
    fn tiny_images_are_fine() {
        for (w, h) in [(0, 0), (1, 1), (1, 9), (9, 1)] {
            assert_eq!(gaussian_blur(&Plane::filled(w, h, 1.0), 3.0).size(), (w, h));
        }
    }
}
