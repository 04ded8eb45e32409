//! Functions whose results are the same on every machine to the last bit. Those of the standard library are the platform's own, and differ in
//! the last bit between a native program and WebAssembly; a likelihood that is nearly flat makes much of that.

/// The functions, for values that an estimate depends on.
pub(crate) trait Portable {
    /// e to this power.
    fn portable_exp(self) -> Self;
    /// The natural logarithm.
    fn portable_ln(self) -> Self;
    /// The logarithm to base 2.
    fn portable_log2(self) -> Self;
    /// This value to a power.
    fn portable_powf(self, power: Self) -> Self;
    /// The sine and the cosine.
    fn portable_sin_cos(self) -> (Self, Self)
    where
        Self: Sized;
    /// The length of the hypotenuse over this and the other side.
    fn portable_hypot(self, other: Self) -> Self;
}

impl Portable for f32 {
    #[inline]
    fn portable_exp(self) -> Self {
        libm::expf(self)
    }

    #[inline]
    fn portable_ln(self) -> Self {
        libm::logf(self)
    }

    #[inline]
    fn portable_log2(self) -> Self {
        libm::log2f(self)
    }

    #[inline]
    fn portable_powf(self, power: Self) -> Self {
        libm::powf(self, power)
    }

    #[inline]
    fn portable_sin_cos(self) -> (Self, Self) {
        libm::sincosf(self)
    }

    #[inline]
    fn portable_hypot(self, other: Self) -> Self {
        let [a, b] = [self, other].map(f64::from);
        (a * a + b * b).sqrt() as Self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_values_are_those_of_the_standard_library_up_to_rounding() {
        let near = |a: f32, b: f32| (a - b).abs() <= 3.0 * f32::EPSILON * b.abs().max(1e-6);
        for i in 1..2000 {
            let x = 0.01 * i as f32;
            assert!(near(x.portable_exp(), x.exp()) && near((-x).portable_exp(), (-x).exp()), "{x}");
            assert!(
                (x.portable_ln() - x.ln()).abs() < 1e-6 && (x.portable_log2() - x.log2()).abs() < 1e-6,
                "{x}"
            );
            assert!(
                near(x.portable_powf(-1.3), x.powf(-1.3)) && near(x.portable_hypot(2.0), x.hypot(2.0)),
                "{x}"
            );
            let ((s, c), (s0, c0)) = (x.portable_sin_cos(), x.sin_cos());
            assert!((s - s0).abs() < 1e-6 && (c - c0).abs() < 1e-6, "{x}");
        }
        // The bits are the same on every machine that the tests run on.
        let sum = (1..2000).fold(0u32, |sum, i| {
            let x = 0.01 * i as f32;
            let all = [
                x.portable_exp(),
                x.portable_ln(),
                x.portable_log2(),
                x.portable_powf(0.3),
                x.portable_hypot(1.0),
            ];
            all.iter().fold(sum, |sum, v| sum.rotate_left(5) ^ v.to_bits())
        });
        assert_eq!(sum, 0x5899_1e4b);
    }
}
