//! The discrete Fourier transform of as many values as a tile has along a side, of four sequences at once. A library's would take another way on
//! each machine, and give other last bits in WebAssembly than natively.

use super::tiles::TILE;
use std::sync::OnceLock;
use wide::f32x4;

const _: () = assert!(TILE == 4 * 4 * 3, "the passes of `transform` have these radices");

/// A complex value of each of four sequences.
#[derive(Clone, Copy)]
pub(super) struct Complex4 {
    pub re: f32x4,
    pub im: f32x4,
}

impl Complex4 {
    pub const ZERO: Self = Self { re: f32x4::ZERO, im: f32x4::ZERO };

    fn plus(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }

    fn minus(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }

    fn scaled(self, by: f32) -> Self {
        Self { re: self.re * by, im: self.im * by }
    }

    /// This value times the imaginary unit.
    fn turned(self) -> Self {
        Self { re: -self.im, im: self.re }
    }

    fn times(self, [cos, sin]: [f32; 2]) -> Self {
        Self { re: self.re * cos - self.im * sin, im: self.im * cos + self.re * sin }
    }
}

/// The cosine and the sine of -2 pi i / TILE.
fn roots() -> &'static [[f32; 2]; TILE] {
    static ROOTS: OnceLock<[[f32; 2]; TILE]> = OnceLock::new();
    ROOTS.get_or_init(|| {
        std::array::from_fn(|i| {
            let (sin, cos) = libm::sincos(-std::f64::consts::TAU * i as f64 / TILE as f64);
            [cos as f32, sin as f32]
        })
    })
}

/// One pass with radix 4 (Stockham's order, which needs no reordering in the end): transforms of `4 * quarter` values, `stride` of them
/// interleaved, become transforms of `quarter` values.
fn by_four(from: &[Complex4; TILE], to: &mut [Complex4; TILE], quarter: usize, stride: usize) {
    let roots = roots();
    for p in 0..quarter {
        let root = |k: usize| roots[k * p * stride % TILE];
        for q in 0..stride {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| from[q + stride * (p + k * quarter)]);
            let (sum, difference) = (a.plus(c), a.minus(c));
            let (others, turned) = (b.plus(d), b.minus(d).turned());
            let out = &mut to[q + stride * 4 * p..];
            out[0] = sum.plus(others);
            out[stride] = difference.minus(turned).times(root(1));
            out[2 * stride] = sum.minus(others).times(root(2));
            out[3 * stride] = difference.plus(turned).times(root(3));
        }
    }
}

/// The forward transform `sum over x of v[x] exp(-2 pi i k x / TILE)`, in place.
pub(super) fn transform(values: &mut [Complex4; TILE]) {
    let (mut first, mut second) = ([Complex4::ZERO; TILE], [Complex4::ZERO; TILE]);
    by_four(values, &mut first, TILE / 4, 1);
    by_four(&first, &mut second, TILE / 16, 4);
    let third = TILE / 3;
    for q in 0..third {
        let [a, b, c] = [0, 1, 2].map(|k| second[q + k * third]);
        let (sum, turned) = (b.plus(c), b.minus(c).turned().scaled(0.75f32.sqrt()));
        let middle = a.minus(sum.scaled(0.5));
        values[q] = a.plus(sum);
        values[q + third] = middle.minus(turned);
        values[q + 2 * third] = middle.plus(turned);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::uniform;

    #[test]
    fn the_transform_is_the_sum_that_it_stands_for() {
        let value = |x: usize, lane: usize| [0, 1].map(|c| uniform((2 * lane + c) as u64, x as u64) - 0.5);
        let mut values: [Complex4; TILE] = std::array::from_fn(|x| {
            let part = |c: usize| f32x4::from(std::array::from_fn::<f32, 4, _>(|lane| value(x, lane)[c]));
            Complex4 { re: part(0), im: part(1) }
        });
        transform(&mut values);
        let mut power = 0.0f64;
        for (k, found) in values.iter().enumerate() {
            for lane in 0..4 {
                let mut sum = [0.0f64; 2];
                for x in 0..TILE {
                    let (sin, cos) = (-std::f64::consts::TAU * (k * x % TILE) as f64 / TILE as f64).sin_cos();
                    let [re, im] = value(x, lane).map(f64::from);
                    sum = [sum[0] + re * cos - im * sin, sum[1] + re * sin + im * cos];
                }
                let found = [found.re, found.im].map(|v| f64::from(v.to_array()[lane]));
                assert!(
                    (0..2).all(|c| (found[c] - sum[c]).abs() < 2e-6 * TILE as f64),
                    "{k} {found:?} {sum:?}"
                );
                power += sum[0].abs();
            }
        }
        // The sums are far from 0, to which they are compared.
        assert!(power / (4 * TILE) as f64 > 0.5);
    }
}
