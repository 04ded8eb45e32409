//! Gaussian and Laplacian pyramids (Burt & Adelson 1983), and pull-push filling (Gortler et al. 1996).

use crate::{Pixel, Plane, Raster, luma, par};

/// The image at half its size, rounded up: smoothed with the binomial kernel [1 4 6 4 1] / 16, of which every second pixel is kept.
pub fn downsample<P: Pixel>(src: &Raster<P>) -> Raster<P> {
    downsample_with(src, |p| p)
}

/// [`downsample`] of a linear function of the pixels.
fn downsample_with<P: Pixel, Q: Pixel>(src: &Raster<P>, f: impl Fn(P) -> Q + Sync) -> Raster<Q> {
    let (w, h) = src.size();
    let mut half = Raster::filled(w.div_ceil(2), h.div_ceil(2), Q::default());
    par::for_each_row(half.data_mut(), w.div_ceil(2), |y, out| {
        // Only the rows, and then the columns, that are kept are smoothed.
        let row = |dy: isize| P::flat(src.row((2 * y as isize + dy).clamp(0, h as isize - 1) as usize));
        let [a, b, c, d, e] = [row(-2), row(-1), row(0), row(1), row(2)];
        let mut mean = vec![P::default(); w];
        for (i, out) in P::flat_mut(&mut mean).iter_mut().enumerate() {
            *out = 0.375 * c[i] + 0.25 * (b[i] + d[i]) + 0.0625 * (a[i] + e[i]);
        }
        // The line has two repeated pixels more on both sides.
        let column = |i: usize| f(mean[i.saturating_sub(2).min(w - 1)]);
        let line: Vec<Q> = (0..w + 4).map(column).collect();
        for (out, taps) in out.iter_mut().zip(line.windows(5).step_by(2)) {
            for (&tap, k) in taps.iter().zip([0.0625, 0.25, 0.375, 0.25, 0.0625]) {
                out.add_scaled(tap, k);
            }
        }
    });
    half
}

/// The image at half, a quarter, .. of its size: `n` times [`downsample`], largest first.
pub fn halvings<P: Pixel>(src: &Raster<P>, n: usize) -> Vec<Raster<P>> {
    let mut halvings: Vec<Raster<P>> = Vec::with_capacity(n);
    while halvings.len() < n {
        halvings.push(downsample(halvings.last().unwrap_or(src)));
    }
    halvings
}

/// Luma of encoded values, halved while its width and height are too large.
pub(crate) fn halved_luma(image: &Raster<[f32; 3]>, too_large: impl Fn(usize, usize) -> bool) -> Plane {
    let mut halved =
        if too_large(image.width(), image.height()) { downsample_with(image, luma) } else { image.map(luma) };
    while too_large(halved.width(), halved.height()) {
        halved = downsample(&halved);
    }
    halved
}

/// The image at twice its size, exactly `width` x `height`, by the binomial kernel; `src` has the size that [`downsample`] makes of that.
pub fn upsample<P: Pixel>(src: &Raster<P>, width: usize, height: usize) -> Raster<P> {
    upsample_with(src, width, height, |_, _, v| v)
}

/// `f(x, y, value)` of each pixel of [`upsample`].
fn upsample_with<P: Pixel>(
    src: &Raster<P>,
    width: usize,
    height: usize,
    f: impl Fn(usize, usize, P) -> P + Sync,
) -> Raster<P> {
    /// The number of rows that are made at once: the rows of `src` that neighbours share are widened twice.
    const ROWS: usize = 32;
    // Even pixels are (1 6 1) / 8 of the coarse pixels, odd ones (1 1) / 2: first along rows, then along columns.
    let mid = |a: P, b: P| P::lerp(a, b, 0.5);
    let even = |l: P, c: P, r: P| P::lerp(c, mid(l, r), 0.25);
    let last = src.height().saturating_sub(1);
    let mut out = Raster::filled(width, height, P::default());
    par::for_each_row(out.data_mut(), width * ROWS, |i, rows| {
        let mut y = i * ROWS;
        let widen = |y: usize| -> Vec<P> {
            let row = src.row(y.min(last));
            let at = |x: usize| row[x.min(row.len() - 1)];
            let of = |x: usize| {
                let i = x / 2;
                if x % 2 == 1 {
                    mid(row[i], at(i + 1))
                } else {
                    even(row[i.saturating_sub(1)], row[i], at(i + 1))
                }
            };
            (0..width).map(of).collect()
        };
        let (mut above, mut this) = (widen((y / 2).saturating_sub(1)), widen(y / 2));
        for pair in rows.chunks_mut(2 * width) {
            let below = widen(y / 2 + 1);
            let (first, second) = pair.split_at_mut(width);
            for (x, out) in first.iter_mut().enumerate() {
                *out = f(x, y, even(above[x], this[x], below[x]));
            }
            for (x, out) in second.iter_mut().enumerate() {
                *out = f(x, y + 1, mid(this[x], below[x]));
            }
            (above, this) = (this, below);
            y += 2;
        }
    });
    out
}

/// The `levels` band-pass levels of a Laplacian pyramid, finest first, and the low-pass that is left.
pub fn laplacian<P: Pixel>(src: &Raster<P>, levels: usize) -> (Vec<Raster<P>>, Raster<P>) {
    let mut bands = Vec::with_capacity(levels);
    let mut low = None;
    for _ in 0..levels {
        let current = low.as_ref().unwrap_or(src);
        let half = downsample(current);
        bands.push(upsample_with(&half, current.width(), current.height(), |x, y, predicted| {
            let mut v = current.at(x, y);
            v.add_scaled(predicted, -1.0);
            v
        }));
        low = Some(half);
    }
    (bands, low.unwrap_or_else(|| src.clone()))
}

/// The image whose Laplacian pyramid has these band-pass levels (finest first) and this low-pass.
pub fn collapse<P: Pixel>(bands: Vec<Raster<P>>, low: Raster<P>) -> Raster<P> {
    bands.into_iter().rev().fold(low, |low, band| {
        upsample_with(&low, band.width(), band.height(), |x, y, mut v| {
            v.add_scaled(band.at(x, y), 1.0);
            v
        })
    })
}

/// Fills the pixels of weight 0 smoothly from their surroundings, at the scale of the hole; pixels of weight 1 keep their value,
/// pixels of a weight in between are mixed with the value of their surroundings. Where every weight is 0, the result is 0.
pub fn pull_push<P: Pixel>(values: &Raster<P>, weight: &Plane) -> Raster<P> {
    let (w, h) = values.size();
    // Pull: weighted means at half the size, until everything is covered.
    if weight.data().iter().all(|&a| a >= 1.0) {
        return values.clone();
    }
    if w * h <= 1 {
        return Raster::from_fn(
            w,
            h,
            |x, y| if weight.at(x, y) > 0.0 { values.at(x, y) } else { P::default() },
        );
    }
    // The product of `v` and `a`, where a value of weight 0 may be NaN and counts as 0.
    let times = |v: P, a: f32| {
        let mut product = P::default();
        if a > 0.0 {
            product.add_scaled(v, a);
        }
        product
    };
    let weighted = Raster::from_fn(w, h, |x, y| times(values.at(x, y), weight.at(x, y)));
    let (sum, coverage) = (downsample(&weighted), downsample(weight));
    let mean = Raster::from_fn(sum.width(), sum.height(), |x, y| {
        let a = coverage.at(x, y);
        times(sum.at(x, y), if a > 1e-6 { 1.0 / a } else { 0.0 })
    });
    // A coarse pixel of which at least a quarter is covered counts as known; the next level fills the others.
    let confidence = coverage.map(|a| if a > 1e-6 { (4.0 * a).min(1.0) } else { 0.0 });
    upsample_with(&pull_push(&mean, &confidence), w, h, |x, y, filled| {
        let a = weight.at(x, y).clamp(0.0, 1.0);
        if a > 0.0 { P::lerp(filled, values.at(x, y), a) } else { filled }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(w: usize, h: usize) -> Raster<[f32; 3]> {
        Raster::from_fn(w, h, |x, y| [((x * 7 + y * 13) % 11) as f32, ((x * y) % 5) as f32, (x + y) as f32])
    }

    #[test]
    fn collapse_inverts_laplacian_at_any_size() {
        for (w, h) in [(64, 48), (37, 21), (5, 1), (1, 1), (2, 3)] {
            let t = texture(w, h);
            let (bands, low) = laplacian(&t, 4);
            for (a, b) in collapse(bands, low).data().iter().flatten().zip(t.data().iter().flatten()) {
                assert!((a - b).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn bands_of_a_constant_are_zero() {
        let (bands, low) = laplacian(&Plane::filled(40, 30, 3.0), 4);
        assert!(bands.iter().flat_map(|b| b.data()).all(|v| v.abs() < 1e-5));
        assert!(low.data().iter().all(|v| (v - 3.0).abs() < 1e-5));
    }

    #[test]
    fn pull_push_keeps_what_is_known_and_continues_it() {
        let w = Plane::from_fn(40, 30, |x, _| if x < 12 { 1.0 } else { 0.0 });
        let v = Plane::from_fn(40, 30, |x, y| if x < 12 { 5.0 + 0.1 * y as f32 } else { f32::NAN });
        let f = pull_push(&v, &w);
        for y in 0..30 {
            assert_eq!(f.at(3, y), v.at(3, y));
            assert!((5.0..=8.0).contains(&f.at(39, y)), "{}", f.at(39, y));
        }
        assert!((f.at(12, 15) - 6.5).abs() < 0.3);
        assert!(pull_push(&v, &Plane::filled(40, 30, 0.0)).data().iter().all(|&v| v == 0.0));
    }
}
