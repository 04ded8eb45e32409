//! Statistics that several fits share: medians, robust scores of many samples, and the choice of places for samples in a frame.

use crate::par;

/// The weighted median of (value, variance) over frames, and its 95 % interval, which holds the scatter within and between frames and
/// a floor (std) for errors of the model. `None` if there is no finite value.
pub(super) fn aggregate(values: &[(f32, f64)], floor: f32) -> Option<(f32, [f32; 2])> {
    let mut sorted: Vec<(f32, f64)> =
        values.iter().filter(|v| v.0.is_finite() && v.1.is_finite()).copied().collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let weight = |v: f64| 1.0 / (v.max(0.0) + f64::from(floor * floor) + 1e-12);
    let total: f64 = sorted.iter().map(|v| weight(v.1)).sum();
    let mut sum = 0.0;
    let middle = sorted.iter().find(|v| {
        sum += weight(v.1);
        sum >= 0.5 * total
    })?;
    let n = sorted.len() as f64;
    let between = 1.4826 * median(sorted.iter().map(|v| (v.0 - middle.0).abs()).collect())?;
    let within: f64 = 1.0 / sorted.iter().map(|v| 1.0 / v.1.max(1e-12)).sum::<f64>();
    let variance = within.max(f64::from(between * between) / n) + f64::from(floor * floor);
    let half = 1.96 * variance.sqrt() as f32;
    Some((middle.0, [(middle.0 - half).max(0.0), middle.0 + half]))
}

pub(super) fn median(mut v: Vec<f32>) -> Option<f32> {
    if v.is_empty() {
        return None;
    }
    let middle = v.len() / 2;
    Some(*v.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// A uniform number in [0, 1) that depends only on `a` and `b` (splitmix64, Steele et al. 2014).
pub(crate) fn uniform(a: u64, b: u64) -> f32 {
    let mut z = a.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(b.wrapping_mul(0xd1b5_4a32_d192_ed03));
    for k in [0xbf58_476d_1ce4_e5b9u64, 0x94d0_49bb_1331_11eb] {
        z = (z ^ (z >> 30)).wrapping_mul(k);
    }
    ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
}

/// The place of most contrast (in stds of the noise) in each cell of a few px, if that place is eligible.
pub(super) fn places_of_contrast(
    width: usize,
    height: usize,
    margin: usize,
    eligible: impl Fn(usize, usize) -> bool + Sync + Send,
    contrast: impl Fn(usize, usize) -> f32 + Sync + Send,
) -> Vec<(usize, usize)> {
    const MAX_PLACES: f32 = 8000.0;
    const MIN_CONTRAST: f32 = 1.0;
    if width <= 2 * margin || height <= 2 * margin {
        return vec![];
    }
    let cell = ((width * height) as f32 / MAX_PLACES).sqrt().ceil().max(2.0) as usize;
    let (columns, rows) = ((width - 2 * margin) / cell, (height - 2 * margin) / cell);
    // Every second pixel each way is enough to find a place of high contrast.
    let found = par::map(rows * columns, |i| {
        let (x0, y0) = (margin + i % columns * cell, margin + i / columns * cell);
        let inside = (y0..y0 + cell).step_by(2).flat_map(|y| (x0..x0 + cell).step_by(2).map(move |x| (x, y)));
        inside
            .map(|(x, y)| (contrast(x, y), (x, y)))
            .filter(|(c, _)| *c > MIN_CONTRAST)
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .filter(|(_, (x, y))| eligible(*x, *y))
            .map(|(_, at)| at)
    });
    found.into_iter().flatten().collect()
}

/// The side, in px, of the blocks of an image in which neighbouring places err alike.
pub const BLOCK: usize = 48;

/// Observed values at some places, with the robust score of a model of these values and its curvature.
pub(super) struct Samples {
    /// The observed values.
    observed: Vec<f32>,
    /// The inverse std of the noise of each value.
    weight: Vec<f32>,
    /// The block of the image that each value lies in, since neighbours err alike.
    block: Vec<u32>,
}

impl Samples {
    pub(super) fn new(places: &[(usize, usize)], at: impl Fn(usize, usize) -> (f32, f32)) -> Self {
        let values: Vec<(f32, f32)> = places.iter().map(|&(x, y)| at(x, y)).collect();
        Self {
            observed: values.iter().map(|v| v.0).collect(),
            weight: values.iter().map(|v| v.1).collect(),
            block: places.iter().map(|&(x, y)| (y / BLOCK * 1000 + x / BLOCK) as u32).collect(),
        }
    }

    pub(super) fn residual(&self, i: usize, model: f32) -> f32 {
        (self.observed[i] - model) * self.weight[i]
    }

    /// Minus Huber's function (half the square up to 1.5, linear beyond) of residual over scale of sample i.
    #[inline(always)]
    pub(super) fn score_of(&self, i: usize, scale: f32, model: f32) -> f32 {
        let r = self.residual(i, model).abs() / scale;
        if r < 1.5 { -0.5 * r * r } else { 1.125 - 1.5 * r }
    }

    /// The sum of [`Self::score_of`] over the samples.
    pub(super) fn score(&self, scale: f32, model: impl Fn(usize) -> f32) -> f32 {
        (0..self.observed.len()).map(|i| self.score_of(i, scale, model(i))).sum::<f32>()
    }

    /// A robust std of the residuals.
    pub(super) fn scale(&self, model: impl Fn(usize) -> f32) -> f32 {
        let r = (0..self.observed.len()).map(|i| self.residual(i, model(i)).abs()).collect();
        1.4826 * median(r).unwrap_or(0.0).max(1e-4)
    }

    /// The covariance of up to two parameters by the sandwich estimator `H^-1 (sum over blocks of g g') H^-1`, which holds even if
    /// neighbours err alike. `derivative(i, k)` is the derivative of the model at sample i by parameter k.
    pub(super) fn covariance(
        &self,
        scale: f32,
        model: impl Fn(usize) -> f32,
        derivative: impl Fn(usize, usize) -> f32,
    ) -> [[f64; 2]; 2] {
        let mut hessian = [[0.0f64; 2]; 2];
        let mut gradients = std::collections::BTreeMap::<u32, [f64; 2]>::new();
        for i in 0..self.observed.len() {
            let r = self.residual(i, model(i)) / scale;
            let huber = (1.5 / r.abs().max(1e-9)).min(1.0);
            let j = [0, 1].map(|k| f64::from(derivative(i, k) * self.weight[i] / scale));
            let g = gradients.entry(self.block[i]).or_default();
            for a in 0..2 {
                g[a] += f64::from(huber * r) * j[a];
                (0..2).for_each(|b| hessian[a][b] += f64::from(huber) * j[a] * j[b]);
            }
        }
        let mut meat = [[0.0f64; 2]; 2];
        for g in gradients.values() {
            (0..2).for_each(|a| (0..2).for_each(|b| meat[a][b] += g[a] * g[b]));
        }
        // If the second parameter has no influence, only the first is solved for.
        let single = hessian[1][1] <= 0.0;
        let determinant = if single {
            hessian[0][0]
        } else {
            hessian[0][0] * hessian[1][1] - hessian[0][1] * hessian[1][0]
        };
        if determinant <= 1e-30 {
            return [[f64::INFINITY; 2]; 2];
        }
        if single {
            return [[meat[0][0] / (determinant * determinant), 0.0], [0.0, 0.0]];
        }
        let inverse = [
            [hessian[1][1] / determinant, -hessian[0][1] / determinant],
            [-hessian[1][0] / determinant, hessian[0][0] / determinant],
        ];
        let times = |a: [[f64; 2]; 2], b: [[f64; 2]; 2]| {
            [0, 1].map(|i| [0, 1].map(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j]))
        };
        times(times(inverse, meat), inverse)
    }
}
