//! What two frames differ by beyond noise. Flow is wrong by a fraction of a px, and where motion is uneven one frame is blurred more than the
//! other. In a small part of the picture both add to the difference of the frames a sum of the picture's own derivatives: of the first order
//! for a shift, of the second order for blur (`f * k - f = sum of M_ij d_i d_j f / 2 + ..` for a symmetric kernel k of second moments M).
//! That sum is found by least squares and taken away, so that noise is left.

use super::collect::{Flaw, cubic_covariance};
use crate::fit::linear::solved;
use crate::{Raster, filter, par};
use std::sync::LazyLock;
use wide::f32x4;

/// The side of the cells in which sums are formed, px. The coefficients are those of squares of twice this side, and pass smoothly from one
/// to the next.
const CELL: usize = 16;

/// The number of derivatives: two of the first order, and three of the second order on two scales, since longer kernels have higher terms,
/// too.
const TERMS: usize = 8;

/// The number of products of two derivatives.
const PRODUCTS: usize = TERMS * (TERMS + 1) / 2;

/// The right half of the kernel, of a std of 1 px, that smooths the picture for the derivatives of the coarser scale.
const SMOOTHING: &[f32] = &[6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];

/// The std of each coefficient that is expected: of the shift, px, and of the second derivatives, px^2, on either scale. It keeps noise from
/// being taken for a difference where the picture has no texture.
const EXPECTED: [f32; TERMS] = [0.25, 0.25, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0];

/// R, G and B, and a fourth value that is not looked at.
type Colours = Raster<[f32; 4]>;

/// The difference of two frames without what is not noise in it. `difference` is `frame` minus the other frame, whose pixels were
/// interpolated at these fractions of a px. The fourth value of `difference`'s pixels is handed on.
pub(super) fn without_mismatch(
    mut difference: Colours,
    frame: Colours,
    flaws: &Raster<Flaw>,
    fraction: impl Fn(usize, usize) -> [f32; 2] + Sync,
) -> Colours {
    let (w, h) = difference.size();
    let derivatives = Derivatives::new(&difference, frame, fraction);
    let (columns, rows) = (w.div_ceil(CELL), h.div_ceil(CELL));
    let cells = par::map(columns * rows, |i| {
        let (x0, y0) = (i % columns * CELL, i / columns * CELL);
        let mut sums = Sums::default();
        for y in y0..(y0 + CELL).min(h) {
            for x in (x0..(x0 + CELL).min(w)).filter(|&x| flaws.at(x, y) == 0) {
                sums.add(&derivatives.at(x, y), f32x4::from(difference.at(x, y)));
            }
        }
        sums
    });
    let corners = columns + 1;
    let coefficients = par::map(corners * (rows + 1), |i| {
        let (x, y) = (i % corners, i / corners);
        let mut sums = Sums::default();
        for y in y.saturating_sub(1)..(y + 1).min(rows) {
            for x in x.saturating_sub(1)..(x + 1).min(columns) {
                sums.merge(&cells[columns * y + x]);
            }
        }
        sums.coefficients()
    });
    par::for_each_row(difference.data_mut(), w, |y, row| {
        let (cell, share) = (y / CELL, f32x4::splat((y % CELL) as f32 / CELL as f32));
        let between = |a: f32x4, b: f32x4, share: f32x4| a + share * (b - a);
        let at = |x: usize| -> [f32x4; 2] {
            let (above, below) = (&coefficients[corners * cell + x], &coefficients[corners * (cell + 1) + x]);
            std::array::from_fn(|i| between(above[i], below[i], share))
        };
        for (cell, pixels) in row.chunks_mut(CELL).enumerate() {
            let (before, after) = (at(cell), at(cell + 1));
            for (i, pixel) in pixels.iter_mut().enumerate() {
                let (x, share) = (CELL * cell + i, f32x4::splat(i as f32 / CELL as f32));
                let [a, b]: [[f32; 4]; 2] =
                    std::array::from_fn(|i| between(before[i], after[i], share).to_array());
                let terms = derivatives.at(x, y);
                let sum = terms
                    .iter()
                    .zip(a.iter().chain(&b))
                    .fold(f32x4::ZERO, |sum, (d, k)| sum + *d * f32x4::splat(*k));
                let [r, g, b, _] = (f32x4::from(*pixel) - sum).to_array();
                [pixel[0], pixel[1], pixel[2]] = [r, g, b];
            }
        }
    });
    difference
}

/// The derivatives of what two frames have in common.
struct Derivatives {
    /// Both frames on either scale.
    frames: [[Colours; 2]; 2],
    /// The index of each pixel's shares in [`SHARES`].
    shares: Raster<u8>,
}

impl Derivatives {
    fn new(difference: &Colours, frame: Colours, fraction: impl Fn(usize, usize) -> [f32; 2] + Sync) -> Self {
        let (w, h) = frame.size();
        let other = Raster::from_fn(w, h, |x, y| {
            let (a, d) = (frame.at(x, y), difference.at(x, y));
            std::array::from_fn(|c| a[c] - d[c])
        });
        let smooth = [&frame, &other].map(|image| filter::convolve(image, SMOOTHING));
        let shares = Raster::from_fn(w, h, |x, y| index_of_shares(fraction(x, y)));
        Self { frames: [[frame, other], smooth], shares }
    }

    /// The derivatives of R, G and B at a pixel.
    #[inline(always)]
    fn at(&self, x: usize, y: usize) -> [f32x4; TERMS] {
        let (w, h) = self.shares.size();
        let columns = [x.saturating_sub(1), x, (x + 1).min(w - 1)];
        let rows = [y.saturating_sub(1), y, (y + 1).min(h - 1)];
        let half = f32x4::splat(0.5);
        let mut terms = [f32x4::ZERO; TERMS];
        let shares = &SHARES[usize::from(self.shares.at(x, y))];
        for (scale, ([first, second], share)) in self.frames.iter().zip(shares).enumerate() {
            let (a, b) = (OfFrame::at(first, columns, rows), OfFrame::at(second, columns, rows));
            let [across, down] = [f32x4::splat(share[0]), f32x4::splat(share[1])];
            terms[2 + 3 * scale] = b.xx + across * (a.xx - b.xx);
            terms[3 + 3 * scale] = b.yy + down * (a.yy - b.yy);
            terms[4 + 3 * scale] = half * (a.xy + b.xy);
            // The first derivatives are those of the coarser scale, which is the last.
            terms[0] = half * (a.x + b.x);
            terms[1] = half * (a.y + b.y);
        }
        terms
    }
}

/// The derivatives of one frame at a pixel, by its eight neighbours.
struct OfFrame {
    x: f32x4,
    y: f32x4,
    xx: f32x4,
    yy: f32x4,
    xy: f32x4,
}

impl OfFrame {
    // Written out, since the compiler copies the nine pixels about if they come as an array.
    #[inline(always)]
    fn at(frame: &Colours, [left, x, right]: [usize; 3], [above, y, below]: [usize; 3]) -> Self {
        let (above, own, below) = (frame.row(above), frame.row(y), frame.row(below));
        let (half, quarter) = (f32x4::splat(0.5), f32x4::splat(0.25));
        let (north, west, middle) = (f32x4::from(above[x]), f32x4::from(own[left]), f32x4::from(own[x]));
        let (east, south) = (f32x4::from(own[right]), f32x4::from(below[x]));
        let (north_west, north_east) = (f32x4::from(above[left]), f32x4::from(above[right]));
        let (south_west, south_east) = (f32x4::from(below[left]), f32x4::from(below[right]));
        let twice = middle + middle;
        Self {
            x: half * (east - west),
            y: half * (south - north),
            xx: west + east - twice,
            yy: north + south - twice,
            xy: quarter * (north_west + south_east - north_east - south_west),
        }
    }
}

/// The number of steps of a px by which fractions are told apart.
const STEPS: usize = 16;

/// The share of the first frame in the second derivatives along x and y on either scale, where the second frame was interpolated at these
/// fractions of a px. With it the noise of a derivative is not correlated with that of the difference of the frames, so that noise by itself
/// is not taken for a difference in blur.
///
/// For independent noise a and b and the derivative D, the covariance of `a - b` and `D (s a + (1 - s) b)` is `s d_a - (1 - s) d_b`, where d
/// is the covariance of a frame's noise and its derivative. The other derivatives are odd, and have none.
static SHARES: LazyLock<[[[f32; 2]; 2]; STEPS * STEPS]> = LazyLock::new(|| {
    std::array::from_fn(|i| shares_at([i % STEPS, i / STEPS].map(|i| i as f32 / STEPS as f32)))
});

fn index_of_shares(fraction: [f32; 2]) -> u8 {
    let [x, y] = fraction.map(|f| (f * STEPS as f32 + 0.5) as usize % STEPS);
    (STEPS * y + x) as u8
}

fn shares_at(fraction: [f32; 2]) -> [[f32; 2]; 2] {
    let covariance = fraction.map(cubic_covariance);
    [&[1.0], SMOOTHING].map(|half| {
        let smoothing = |i: isize| half.get(i.unsigned_abs()).copied().unwrap_or(0.0);
        let second = |i: isize| smoothing(i - 1) + smoothing(i + 1) - 2.0 * smoothing(i);
        let under = |kernel: &dyn Fn(isize) -> f32, covariance: &[f32; 4]| -> f32 {
            (-3..=3).map(|i: isize| kernel(i) * covariance[i.unsigned_abs()]).sum()
        };
        [0, 1].map(|axis| {
            let of_first = second(0) * smoothing(0);
            let of_second = under(&second, &covariance[axis]) * under(&smoothing, &covariance[1 - axis]);
            (of_second / (of_first + of_second)).clamp(0.0, 1.0)
        })
    })
}

/// Sums over pixels, and over R, G and B, which share the coefficients.
#[derive(Clone)]
struct Sums {
    /// The products of derivatives, the lower triangle row by row.
    products: [f32x4; PRODUCTS],
    /// The products of the derivatives with the difference.
    right: [f32x4; TERMS],
    /// The squares of the difference.
    squares: f32x4,
    /// The number of pixels.
    count: f32,
}

impl Default for Sums {
    fn default() -> Self {
        let zero = f32x4::ZERO;
        Self { products: [zero; PRODUCTS], right: [zero; TERMS], squares: zero, count: 0.0 }
    }
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, terms: &[f32x4; TERMS], difference: f32x4) {
        let mut next = 0;
        for (i, a) in terms.iter().enumerate() {
            self.right[i] += *a * difference;
            for b in &terms[..=i] {
                self.products[next] += *a * *b;
                next += 1;
            }
        }
        self.squares += difference * difference;
        self.count += 1.0;
    }

    fn merge(&mut self, other: &Self) {
        self.products.iter_mut().zip(&other.products).for_each(|(a, b)| *a += *b);
        self.right.iter_mut().zip(&other.right).for_each(|(a, b)| *a += *b);
        self.squares += other.squares;
        self.count += other.count;
    }

    /// The coefficients of the derivatives in the difference: the likeliest ones, if they are normal and of the [`EXPECTED`] stds, and the
    /// rest of the difference is noise.
    fn coefficients(&self) -> [f32x4; 2] {
        // There are so many pixels that it does not matter that their mean square holds more than noise.
        let noise = over_colours(self.squares) / (3.0 * f64::from(self.count.max(1.0)));
        let mut a = [0.0; TERMS * TERMS];
        let mut products = self.products.iter().map(|v| over_colours(*v));
        for i in 0..TERMS {
            for (j, v) in (0..=i).zip(&mut products) {
                (a[TERMS * i + j], a[TERMS * j + i]) = (v, v);
            }
            a[TERMS * i + i] += noise.max(1e-9) / f64::from(EXPECTED[i] * EXPECTED[i]);
        }
        let right = self.right.iter().map(|v| over_colours(*v)).collect();
        let found = solved(&a, right).unwrap_or_else(|| vec![0.0; TERMS]);
        [0, 4].map(|first| f32x4::from(std::array::from_fn::<f32, 4, _>(|i| found[first + i] as f32)))
    }
}

/// The sum of R, G and B.
fn over_colours(v: f32x4) -> f64 {
    v.to_array()[..3].iter().map(|v| f64::from(*v)).sum()
}
