//! Noise as real cameras make it: stronger where the picture is brighter in any channel, and shared by the channels.

use super::noise::{NOISE_LEVELS, NoiseLines};
use super::{check, lerp_all};
use crate::Result;
use serde::{Deserialize, Serialize};

/// The number of points of a curve.
pub const NOISE_KNOTS: usize = 8;

/// The encoded values at which a curve has its points. Between two points the variance is linear, beyond the ends it is constant. The
/// points are closer together in the dark, where the transfer curve is steep.
pub const KNOTS: [f32; NOISE_KNOTS] = [0.0, 0.08, 0.18, 0.32, 0.5, 0.7, 0.88, 1.0];

/// Noise whose variance is a sum of three curves, one over the picture's value in each channel, per pyramid level and channel; the channels
/// and successive frames are correlated. A sensor's noise is of this kind after its colour matrix: the noise of each output channel is a
/// mixture of that of the sensor's channels, each of which grows with its own light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseCurves {
    /// The paper's straight lines through the std of the same noise.
    #[serde(skip, default = "no_lines")]
    pub lines: NoiseLines,
    /// The pyramid levels, finest first.
    pub levels: [CurveLevel; NOISE_LEVELS],
    /// The correlation of the noise of a frame with that of the frame before it, in place, 0 to less than 1; the correlation with earlier
    /// frames falls off as its powers (a first-order autoregressive process).
    pub temporal_correlation: f32,
}

/// The noise of one pyramid level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CurveLevel {
    /// `variance[c][k][i]`: at [`KNOTS`]`[i]` of the encoded channel k, what that channel's value adds to the variance of channel c; >= 0.
    pub variance: [[[f32; NOISE_KNOTS]; 3]; 3],
    /// The matrix by which three independent noises of std 1 become those of R, G and B; each is then multiplied by its std. The std of a
    /// row can differ from 1, since the levels of a Laplacian pyramid reach into each other.
    pub mixing: [[f32; 3]; 3],
}

/// The lines before those of the file take their place.
fn no_lines() -> NoiseLines {
    let super::NoiseModel::Lines(lines) = super::NoiseModel::given(Default::default(), 1.0) else {
        unreachable!()
    };
    lines
}

/// The point of a curve below this encoded value, and the share of the way from it to the next point, 0 to 1.
#[inline]
pub fn place(value: f32) -> (usize, f32) {
    let v = if value > 0.0 { value.min(1.0) } else { 0.0 };
    let mut i = 0;
    while i < NOISE_KNOTS - 2 && v >= KNOTS[i + 1] {
        i += 1;
    }
    (i, (v - KNOTS[i]) / (KNOTS[i + 1] - KNOTS[i]))
}

impl CurveLevel {
    /// The std of R, G and B over content of this encoded colour, >= 0.
    #[inline]
    pub fn std(&self, colour: [f32; 3]) -> [f32; 3] {
        let places = colour.map(place);
        std::array::from_fn(|c| {
            let curves = self.variance[c].iter().zip(places);
            curves
                .map(|(curve, (i, t))| curve[i] + t * (curve[i + 1] - curve[i]))
                .sum::<f32>()
                .max(0.0)
                .sqrt()
        })
    }

    /// The correlation of the noises of R and G, of R and B, and of G and B, each from -1 to 1.
    pub fn correlation(&self) -> [f32; 3] {
        let product = |a: usize, b: usize| -> f32 {
            self.mixing[a].iter().zip(self.mixing[b]).map(|(x, y)| x * y).sum()
        };
        [(0, 1), (0, 2), (1, 2)].map(|(a, b)| {
            let norm = (product(a, a) * product(b, b)).sqrt();
            if norm > 0.0 { (product(a, b) / norm).clamp(-1.0, 1.0) } else { 0.0 }
        })
    }

    /// The mixture of three independent noises.
    #[inline]
    pub fn mixed(&self, unit: [f32; 3]) -> [f32; 3] {
        self.mixing.map(|row| row[0] * unit[0] + row[1] * unit[1] + row[2] * unit[2])
    }
}

impl NoiseCurves {
    pub(super) fn between(&self, other: &Self, t: f32, lines: NoiseLines) -> Self {
        let level = |l: usize| {
            let (a, b) = (&self.levels[l], &other.levels[l]);
            CurveLevel {
                variance: std::array::from_fn(|c| {
                    std::array::from_fn(|k| lerp_all(a.variance[c][k], b.variance[c][k], t))
                }),
                mixing: std::array::from_fn(|c| lerp_all(a.mixing[c], b.mixing[c], t)),
            }
        };
        let [temporal_correlation] = lerp_all([self.temporal_correlation], [other.temporal_correlation], t);
        Self { lines, levels: std::array::from_fn(level), temporal_correlation }
    }

    pub(super) fn validate(&self) -> Result<()> {
        let all = |f: &dyn Fn(f32) -> bool, of: &dyn Fn(&CurveLevel) -> Vec<f32>| {
            self.levels.iter().all(|l| of(l).into_iter().all(f))
        };
        check(
            all(&|v| (0.0..=1.0).contains(&v), &|l| l.variance.as_flattened().as_flattened().to_vec()),
            "noise.curves' variance must be numbers from 0 to 1",
        )?;
        check(
            all(&|v| v.abs() <= 16.0, &|l| l.mixing.as_flattened().to_vec()),
            "noise.curves' mixing must be numbers from -16 to 16",
        )?;
        check(
            (0.0..1.0).contains(&self.temporal_correlation),
            "noise.curves' temporal_correlation must be from 0 to less than 1",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_correlation_is_that_of_the_mixed_noises() {
        let level = |mixing| CurveLevel { mixing, ..CurveLevel::default() };
        assert_eq!(CurveLevel::default().correlation(), [0.0; 3]);
        let own = level([[0.9, 0.0, 0.0], [0.0, 1.1, 0.0], [0.0, 0.0, 1.0]]);
        assert_eq!(own.correlation(), [0.0; 3]);
        // G is R's noise, B has 0.6 of it and 0.8 of its own.
        let [rg, rb, gb] = level([[2.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.6, 0.0, 0.8]]).correlation();
        assert!((rg - 1.0).abs() < 1e-6 && (rb - 0.6).abs() < 1e-6 && (gb - 0.6).abs() < 1e-6);
    }
}
