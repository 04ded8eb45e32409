//! The statistics of the experiments: means with their spread, tests of proportions, and resampling.

use rand::{Rng, SeedableRng, rngs::StdRng};
use serde::{Deserialize, Serialize};

/// A mean with its spread over samples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mean {
    /// The mean.
    pub mean: f64,
    /// The standard deviation over the samples; 0 for one sample.
    pub std: f64,
    /// The number of samples.
    pub n: usize,
}

/// The mean, the standard deviation and the number of the finite values; `None` if there is none.
pub fn mean(values: impl IntoIterator<Item = f64>) -> Option<Mean> {
    let values: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    let n = values.len();
    let mean = values.iter().sum::<f64>() / n as f64;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (n > 0).then(|| Mean { mean, std: (squares / (n.max(2) - 1) as f64).sqrt(), n })
}

/// The number of successes among a number of trials.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Proportion {
    /// The number of successes, at most that of trials.
    pub successes: u64,
    /// The number of trials.
    pub trials: u64,
}

impl Proportion {
    /// The share of successes, in [0, 1]; 0 where there is no trial.
    pub fn share(self) -> f64 {
        self.successes as f64 / self.trials.max(1) as f64
    }
}

/// The two-sided p-value of the two-proportion z-test with the pooled variance: how probable so large a difference is if both have the
/// same true proportion. 1 where nothing can be told, since one has no trial, or all trials of both ended alike.
pub fn two_proportion_test(a: Proportion, b: Proportion) -> f64 {
    let [m, n] = [a.trials, b.trials].map(|n| n as f64);
    let pooled = (a.successes + b.successes) as f64 / (m + n);
    let variance = pooled * (1.0 - pooled) * (1.0 / m + 1.0 / n);
    let z = (a.share() - b.share()).abs() / variance.sqrt();
    if z.is_finite() { libm::erfc(z / std::f64::consts::SQRT_2) } else { 1.0 }
}

/// The value below which a standard normal variable lies with this probability, in (0, 1).
pub fn normal_quantile(probability: f64) -> f64 {
    let below = |z: f64| 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
    let (mut low, mut high) = (-40.0, 40.0);
    // 60 halvings reach the precision of the number format.
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if below(middle) < probability { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// The number of trials of each of two methods that tell their proportions apart with this power, in a two-sided test at `level`
/// (Fleiss, Levin & Paik 2003, without the continuity correction); `None` if the proportions are the same.
pub fn trials_for_power(a: f64, b: f64, level: f64, power: f64) -> Option<u64> {
    if a == b {
        return None;
    }
    let middle = 0.5 * (a + b);
    let of_test = normal_quantile(1.0 - 0.5 * level) * (2.0 * middle * (1.0 - middle)).sqrt();
    let of_power = normal_quantile(power) * (a * (1.0 - a) + b * (1.0 - b)).sqrt();
    Some((((of_test + of_power) / (a - b)).powi(2)).ceil() as u64)
}

/// The standard deviation and the 95 % interval of a statistic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resampled {
    /// The standard deviation over the resamples.
    pub std: f64,
    /// The 2.5th and the 97.5th percentile of the resamples.
    pub interval: [f64; 2],
}

/// The bootstrap of a statistic over whole groups, such as all answers of a participant: the groups, by their numbers below `groups`,
/// are drawn with replacement 4000 times. `None` for fewer than two groups.
pub fn bootstrap(groups: usize, seed: u64, statistic: impl Fn(&[usize]) -> f64) -> Option<Resampled> {
    const DRAWS: usize = 4000;
    if groups < 2 {
        return None;
    }
    let mut rng = StdRng::seed_from_u64(seed);
    let mut values: Vec<f64> = (0..DRAWS)
        .map(|_| statistic(&(0..groups).map(|_| rng.random_range(0..groups)).collect::<Vec<_>>()))
        .filter(|v| v.is_finite())
        .collect();
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((share * (values.len().max(1) - 1) as f64).round() as usize).copied();
    Some(Resampled { std: mean(values.iter().copied())?.std, interval: [at(0.025)?, at(0.975)?] })
}

/// A straight line fitted by least squares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// The slope.
    pub slope: f64,
    /// The 95 % interval of the slope, by Student's t; infinite for two points.
    pub interval: [f64; 2],
    /// The number of points.
    pub n: usize,
}

/// The line through the origin that fits the points `(x, y)` best; `None` for fewer than two points, or if all x are 0.
pub fn proportional(points: &[(f64, f64)]) -> Option<Line> {
    let xx: f64 = points.iter().map(|p| p.0 * p.0).sum();
    let slope = points.iter().map(|p| p.0 * p.1).sum::<f64>() / xx;
    fitted(points, slope, xx, 1, |x| slope * x)
}

/// The line that fits the points `(x, y)` best; `None` for fewer than three points, or if all x are the same.
pub fn line(points: &[(f64, f64)]) -> Option<Line> {
    let n = points.len() as f64;
    let [x, y] = [points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n];
    let xx: f64 = points.iter().map(|p| (p.0 - x).powi(2)).sum();
    let slope = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>() / xx;
    fitted(points, slope, xx, 2, |at| y + slope * (at - x))
}

/// The slope with its interval, for a fit with so many parameters that leaves `points` their residuals.
fn fitted(
    points: &[(f64, f64)],
    slope: f64,
    xx: f64,
    parameters: usize,
    at: impl Fn(f64) -> f64,
) -> Option<Line> {
    let free = points.len().checked_sub(parameters).filter(|&free| free > 0)?;
    if !slope.is_finite() {
        return None;
    }
    let squares: f64 = points.iter().map(|p| (p.1 - at(p.0)).powi(2)).sum();
    let half = student_quantile(free) * (squares / free as f64 / xx).sqrt();
    Some(Line { slope, interval: [slope - half, slope + half], n: points.len() })
}

/// The 97.5th percentile of Student's t with this many degrees of freedom, 1 or more (exact for 1 and 2; from 3 on by the expansion of
/// Cornish and Fisher, within 1 %).
fn student_quantile(free: usize) -> f64 {
    let n = free as f64;
    let z = normal_quantile(0.975);
    match free {
        1 => (std::f64::consts::PI * 0.475).tan(),
        2 => (2.0 * 0.95f64.powi(2) / (1.0 - 0.95f64.powi(2))).sqrt(),
        _ => {
            let z2 = z * z;
            z * (1.0
                + (z2 + 1.0) / (4.0 * n)
                + ((5.0 * z2 + 16.0) * z2 + 3.0) / (96.0 * n * n)
                + (((3.0 * z2 + 19.0) * z2 + 17.0) * z2 - 15.0) / (384.0 * n.powi(3)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_and_tests_are_those_of_tables() {
        for (p, z) in [(0.5, 0.0), (0.975, 1.959_964), (0.8, 0.841_621), (1e-9, -5.997_807)] {
            assert!((normal_quantile(p) - z).abs() < 1e-5, "{p}");
        }
        for (free, t) in [(1, 12.706), (2, 4.303), (3, 3.182), (5, 2.571), (10, 2.228), (100, 1.984)] {
            assert!((student_quantile(free) / t - 1.0).abs() < 0.01, "{free}");
        }
        // 65 % and 50 %: Fleiss, Levin & Paik's formula by hand.
        assert_eq!(trials_for_power(0.65, 0.5, 0.05, 0.8), Some(170));
        assert_eq!(trials_for_power(0.5, 0.5, 0.05, 0.8), None);
        let none = Proportion { successes: 0, trials: 10 };
        assert_eq!(two_proportion_test(none, none), 1.0);
        assert_eq!(two_proportion_test(none, Proportion::default()), 1.0);
    }

    #[test]
    fn a_mean_knows_its_spread() {
        assert_eq!(mean([1.0, 3.0, f64::NAN]), Some(Mean { mean: 2.0, std: 2f64.sqrt(), n: 2 }));
        assert_eq!(mean([]), None);
    }

    #[test]
    fn the_bootstrap_draws_whole_groups() {
        // All answers of a group are the same: four groups are four independent answers, however many each has.
        let share = |drawn: &[usize]| drawn.iter().filter(|&&g| g < 2).count() as f64 / drawn.len() as f64;
        let r = bootstrap(4, 1, share).unwrap();
        assert!((r.std - 0.25).abs() < 0.02, "{r:?}");
        assert_eq!(bootstrap(1, 1, share), None);
    }

    #[test]
    fn lines_are_found_with_intervals_that_hold_them() {
        let points = [(1.0, 2.1), (2.0, 3.9), (3.0, 6.05), (4.0, 7.95)];
        let l = proportional(&points).unwrap();
        assert!((l.slope - 2.0).abs() < 0.02 && l.interval[0] < 2.0 && l.interval[1] > 2.0, "{l:?}");
        let l = line(&points.map(|(x, y)| (x, y - 7.0))).unwrap();
        assert!((l.slope - 1.97).abs() < 0.03 && l.interval[0] < 2.0 && l.interval[1] > 2.0, "{l:?}");
        assert_eq!(line(&points[..2]), None);
        assert_eq!(line(&[(1.0, 1.0), (1.0, 2.0), (1.0, 3.0)]), None);
    }
}
