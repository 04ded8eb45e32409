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

/// The number of what is multiplied with each other in [`Sums`]: the derivatives and the difference of the frames.
const FACTORS: usize = TERMS + 1;

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
        let mut factors = [[f32x4::ZERO; CELL]; FACTORS];
        for y in y0..(y0 + CELL).min(h) {
            derivatives.of_row(x0, y, &mut factors);
            let mut sound = 0;
            for i in 0..CELL.min(w - x0) {
                if flaws.at(x0 + i, y) == 0 {
                    factors[TERMS][i] = f32x4::from(difference.at(x0 + i, y));
                    sound += 1;
                } else {
                    factors.iter_mut().for_each(|pixels| pixels[i] = f32x4::ZERO);
                }
            }
            sums.add(&factors, sound);
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
        let mut terms = [[f32x4::ZERO; CELL]; TERMS];
        for (cell, pixels) in row.chunks_mut(CELL).enumerate() {
            let (before, after) = (at(cell), at(cell + 1));
            derivatives.of_row(CELL * cell, y, &mut terms);
            for (i, pixel) in pixels.iter_mut().enumerate() {
                let share = f32x4::splat(i as f32 / CELL as f32);
                let [a, b]: [[f32; 4]; 2] =
                    std::array::from_fn(|i| between(before[i], after[i], share).to_array());
                let sum = terms
                    .iter()
                    .zip(a.iter().chain(&b))
                    .fold(f32x4::ZERO, |sum, (d, k)| sum + d[i] * f32x4::splat(*k));
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

    /// Writes the derivatives of R, G and B at the [`CELL`] pixels of row `y` from `x0` on, or as many as the row has.
    #[inline(always)]
    fn of_row(&self, x0: usize, y: usize, terms: &mut [[f32x4; CELL]]) {
        let (w, h) = self.shares.size();
        let count = CELL.min(w - x0);
        let shares = &self.shares.row(y)[x0..x0 + count];
        for (scale, frames) in self.frames.iter().enumerate() {
            let rows =
                frames.each_ref().map(|f| [y.saturating_sub(1), y, (y + 1).min(h - 1)].map(|y| f.row(y)));
            let columns: [Column; CELL + 2] = std::array::from_fn(|i| {
                let x = (x0 + i).saturating_sub(1).min(w - 1);
                Column::new(rows.map(|frame| frame.map(|row| row[x])))
            });
            let (quarter, eighth) = (f32x4::splat(0.25), f32x4::splat(0.125));
            for (i, share) in shares.iter().enumerate() {
                let [before, own, after] = [0, 1, 2].map(|k| &columns[i + k]);
                let [across, down] = SHARES[usize::from(*share)][scale].map(f32x4::splat);
                let [xx, of_second] =
                    [0, 1].map(|f| second_derivative([before, own, after].map(|c| c.middle[f])));
                terms[2 + 3 * scale][i] = of_second + across * (xx - of_second);
                terms[3 + 3 * scale][i] = own.down[1] + down * (own.down[0] - own.down[1]);
                terms[4 + 3 * scale][i] = eighth * (after.step - before.step);
                // The first derivatives are those of the coarser scale.
                if scale == 1 {
                    terms[0][i] =
                        quarter * (after.middle[0] + after.middle[1] - (before.middle[0] + before.middle[1]));
                    terms[1][i] = quarter * own.step;
                }
            }
        }
    }
}

/// What the derivatives take from three pixels above each other.
struct Column {
    /// The middle pixel of either frame.
    middle: [f32x4; 2],
    /// The second derivative along y of either frame.
    down: [f32x4; 2],
    /// The lowest pixel minus the highest, both frames together.
    step: f32x4,
}

impl Column {
    #[inline(always)]
    fn new(frames: [[[f32; 4]; 3]; 2]) -> Self {
        let frames = frames.map(|pixels| pixels.map(f32x4::from));
        Self {
            middle: frames.map(|[_, middle, _]| middle),
            down: frames.map(second_derivative),
            step: frames[0][2] - frames[0][0] + (frames[1][2] - frames[1][0]),
        }
    }
}

#[inline(always)]
fn second_derivative([before, own, after]: [f32x4; 3]) -> f32x4 {
    before + after - (own + own)
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

/// The side of the squares of products that are summed at once: their sums and factors fit in a processor's registers.
const SQUARE: usize = 3;
const _: () = assert!(FACTORS.is_multiple_of(SQUARE));

/// Sums over pixels.
#[derive(Clone)]
struct Sums {
    /// The sums of the products of two factors, for R, G and B: of the derivatives, and the difference of the frames as the last one. Only those
    /// of a factor with an earlier one or itself are used.
    products: [[f32x4; FACTORS]; FACTORS],
    /// The number of pixels.
    count: usize,
}

impl Default for Sums {
    fn default() -> Self {
        Self { products: [[f32x4::ZERO; FACTORS]; FACTORS], count: 0 }
    }
}

impl Sums {
    /// Adds `count` pixels; the factors of all others are 0.
    fn add(&mut self, factors: &[[f32x4; CELL]; FACTORS], count: usize) {
        self.count += count;
        for i in (0..FACTORS).step_by(SQUARE) {
            for j in (0..=i).step_by(SQUARE) {
                let (left, right) = (&factors[i..i + SQUARE], &factors[j..j + SQUARE]);
                let mut sums = [[f32x4::ZERO; SQUARE]; SQUARE];
                for pixel in 0..CELL {
                    for (row, a) in sums.iter_mut().zip(left) {
                        for (sum, b) in row.iter_mut().zip(right) {
                            *sum += a[pixel] * b[pixel];
                        }
                    }
                }
                for (k, row) in sums.iter().enumerate() {
                    self.products[i + k][j..].iter_mut().zip(row).for_each(|(a, b)| *a += *b);
                }
            }
        }
    }

    fn merge(&mut self, other: &Self) {
        let pairs = self.products.as_flattened_mut().iter_mut().zip(other.products.as_flattened());
        pairs.for_each(|(a, b)| *a += *b);
        self.count += other.count;
    }

    /// The coefficients of the derivatives in the difference: the likeliest ones, if they are normal and of the [`EXPECTED`] stds, and the
    /// rest of the difference is noise.
    fn coefficients(&self) -> [f32x4; 2] {
        // There are so many pixels that it does not matter that their mean square holds more than noise.
        let noise = over_colours(self.products[TERMS][TERMS]) / (3.0 * self.count.max(1) as f64);
        let mut a = [0.0; TERMS * TERMS];
        for i in 0..TERMS {
            for j in 0..=i {
                let v = over_colours(self.products[i][j]);
                (a[TERMS * i + j], a[TERMS * j + i]) = (v, v);
            }
            a[TERMS * i + i] += noise.max(1e-9) / f64::from(EXPECTED[i] * EXPECTED[i]);
        }
        let right = self.products[TERMS][..TERMS].iter().map(|v| over_colours(*v)).collect();
        let found = solved(&a, right).unwrap_or_else(|| vec![0.0; TERMS]);
        [0, 4].map(|first| f32x4::from(std::array::from_fn::<f32, 4, _>(|i| found[first + i] as f32)))
    }
}

/// The sum of R, G and B.
fn over_colours(v: f32x4) -> f64 {
    v.to_array()[..3].iter().map(|v| f64::from(*v)).sum()
}
