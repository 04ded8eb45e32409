//! Changes of brightness from one frame to the next: an exposure or a white balance that changes, a fade, or lamps that flicker while a
//! rolling shutter passes by. The estimators of flow and noise assume that a point is equally bright in both frames, so that such a
//! change would read as motion and as coarse noise.

use super::quantile;
use crate::par;
use crate::portable::Portable;
use std::ops::Range;

/// The offset of sRGB: light times g is encoded as `(v + OFFSET) g^(1 / 2.4) - OFFSET`, except in the darkest part of the curve.
const OFFSET: f32 = 0.055;

/// A value of the next frame as it would be without the change of brightness, with `k` the factor from [`brightening`].
#[inline]
pub(crate) fn undone(v: f32, k: f32) -> f32 {
    (v + OFFSET) / k - OFFSET
}

/// The factor by which `value + OFFSET` grows to the next frame in each of N channels, for each row; `None` if nothing changes.
///
/// `pair` gives the encoded values, in both frames, of the point seen at a pixel (x, y), if that point is seen in both.
pub(crate) fn brightening<const N: usize>(
    (width, height): (usize, usize),
    pair: impl Fn(usize, usize) -> Option<[[f32; N]; 2]> + Sync + Send,
) -> Option<Vec<[f32; N]>> {
    /// The number of bands of rows. Each band has a factor of its own, and between the middles of bands the log of the factor is linear.
    const BANDS: usize = 16;
    /// The least number of rows of a band.
    const LEAST: usize = 16;
    /// The least number of values for which a band counts.
    const ENOUGH: usize = 200;
    /// The absolute log of a factor below which a change of brightness does no harm.
    const SMALL: f32 = 0.004;
    /// The mean, over bands and channels, of the squared log over its variance above which a change is not chance. It lies far above 1
    /// since neighbouring pixels are not independent.
    const CERTAIN: f32 = 10.0;
    /// The encoded values that are used: not so dark that the transfer curve is linear, and not near to clipping.
    const SURE: Range<f32> = 0.06..0.94;
    let side = height.div_ceil(BANDS).max(LEAST);
    // The distance between the pixels that are used, px.
    let apart = (width / 128).clamp(2, 8);
    let of_band = |band: usize| {
        let mut values: [Vec<[f32; 2]>; N] = std::array::from_fn(|_| vec![]);
        for y in (band * side..((band + 1) * side).min(height)).step_by(apart) {
            for [a, b] in (0..width).step_by(apart).filter_map(|x| pair(x, y)) {
                for (values, (a, b)) in values.iter_mut().zip(a.into_iter().zip(b)) {
                    if SURE.contains(&a) && SURE.contains(&b) {
                        values.push([a + OFFSET, b + OFFSET]);
                    }
                }
            }
        }
        let enough = values.iter().all(|v| v.len() >= ENOUGH);
        enough.then(|| Band {
            middle: (band as f32 + 0.5) * side as f32,
            factors: values.map(|v| log_factor(&v)),
        })
    };
    let mut bands: Vec<Band<N>> = par::map(height.div_ceil(side), of_band).into_iter().flatten().collect();
    let differ_from = |bands: &[Band<N>], from: [f32; N]| {
        let beyond = |f: &LogFactor, from: f32| (f.log - from).powi(2) / f.variance;
        let of_band = |b: &Band<N>| b.factors.iter().zip(from).map(|(f, from)| beyond(f, from)).sum::<f32>();
        bands.iter().map(of_band).sum::<f32>() > CERTAIN * (N * bands.len()) as f32
    };
    let small = |b: &Band<N>| b.factors.iter().all(|f| f.log.abs() < SMALL);
    if !differ_from(&bands, [0.0; N]) || bands.iter().all(small) {
        return None;
    }
    let mean = std::array::from_fn(|c| {
        let of_channel = || bands.iter().map(|b| b.factors[c]);
        of_channel().map(|f| f.log / f.variance).sum::<f32>()
            / of_channel().map(|f| 1.0 / f.variance).sum::<f32>()
    });
    if !differ_from(&bands, mean) {
        let alike = bands.iter_mut().flat_map(|b| b.factors.iter_mut().zip(mean));
        alike.for_each(|(f, mean)| f.log = mean);
    }
    // Rows beyond the first and the last band that has values get the factor at the edge of that band.
    let half = 0.5 * side as f32;
    let last = bands.len() - 1;
    let known = bands[0].middle - half..=bands[last].middle + half;
    let of_row = |y: usize| {
        let y = (y as f32 + 0.5).clamp(*known.start(), *known.end());
        let after = bands.iter().position(|b| b.middle > y).unwrap_or(last).max(1).min(last);
        let (low, high) = (&bands[after.saturating_sub(1)], &bands[after]);
        let t = (y - low.middle) / (high.middle - low.middle).max(1.0);
        std::array::from_fn(|c| {
            let (low, high) = (low.factors[c].log, high.factors[c].log);
            (low + t * (high - low)).portable_exp()
        })
    };
    Some((0..height).map(of_row).collect())
}

/// The change of brightness in a band of rows.
struct Band<const N: usize> {
    /// The middle of the band, in rows.
    middle: f32,
    factors: [LogFactor; N],
}

/// The log of a factor, with its variance.
#[derive(Clone, Copy)]
struct LogFactor {
    log: f32,
    variance: f32,
}

/// The factor by which the second values are larger than the first: the ratio of the sums over the pairs that match about as well as most
/// pairs do. There must be at least one pair.
fn log_factor(values: &[[f32; 2]]) -> LogFactor {
    /// The largest deviation of a pair that counts, as a multiple of the median deviation.
    const MATCHING: f32 = 4.0;
    let logs: Vec<f32> = values.iter().map(|[a, b]| (b / a).portable_ln()).collect();
    let middle = *quantile(&mut logs.clone(), 0.5);
    let mut deviations: Vec<f32> = logs.iter().map(|l| (l - middle).abs()).collect();
    let widest = MATCHING * quantile(&mut deviations, 0.5).max(1e-3);
    let matching = || values.iter().zip(&logs).filter(|(_, l)| (*l - middle).abs() <= widest).map(|(v, _)| v);
    let n = matching().count() as f32;
    let (first, second) = matching().fold((0.0, 0.0), |(a, b), v| (a + v[0], b + v[1]));
    let k = second / first;
    let scatter = matching().map(|[a, b]| (b - k * a).powi(2)).sum::<f32>();
    // The least variance stands for the rounding to 8 bits.
    LogFactor { log: k.portable_ln(), variance: (scatter / (first * first)).max(1e-5 / n) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The factors found between two noisy frames, of which the second is brighter by the factor `light` of each row.
    fn found(light: impl Fn(usize) -> f32 + Sync + Send) -> Option<Vec<[f32; 3]>> {
        let size = (256, 192);
        let noise = |x: usize, y: usize, frame: u64| {
            [0, 1, 2].map(|c| 0.05 * (crate::fit::uniform(3 * frame + c, (y * size.0 + x) as u64) - 0.5))
        };
        brightening(size, |x, y| {
            let v = 0.15 + 0.6 * (x * 7 % 256) as f32 / 256.0;
            let brighter = (v + OFFSET) * light(y).powf(1.0 / 2.4) - OFFSET;
            Some([noise(x, y, 1).map(|n| v + n), noise(x, y, 2).map(|n| brighter + n)])
        })
    }

    #[test]
    fn a_change_is_found_row_by_row_and_undone() {
        let flicker = |y: usize| 1.0 + 0.06 * (std::f32::consts::TAU * 1.5 * y as f32 / 192.0).sin();
        let k = found(flicker).expect("it flickers");
        for (y, k) in k.into_iter().enumerate() {
            let truth = flicker(y).powf(1.0 / 2.4);
            assert!(k.iter().all(|k| (k / truth - 1.0).abs() < 0.006), "{y}: {k:?} for {truth}");
            assert!((undone((0.4 + OFFSET) * truth - OFFSET, truth) - 0.4).abs() < 1e-6);
        }
        let darker = found(|_| 0.7).expect("it is darker");
        assert!(darker.iter().flatten().all(|k| (k - 0.7f32.powf(1.0 / 2.4)).abs() < 0.006));
    }

    #[test]
    fn rows_that_tell_nothing_are_as_the_nearest_that_do() {
        let k = brightening((256, 192), |x, y| {
            let v = 0.15 + 0.6 * (x * 7 % 256) as f32 / 256.0;
            let light = 1.0 + 0.001 * y as f32;
            (y < 64).then_some([[v], [(v + OFFSET) * light - OFFSET]])
        });
        let k = k.expect("it changes");
        assert!(k[64..].iter().all(|k| (k[0] - 1.064).abs() < 0.01), "{:?}", k[191]);
    }

    #[test]
    fn noise_alone_is_no_change() {
        assert_eq!(found(|_| 1.0), None);
        assert_eq!(found(|_| 1.002), None);
        assert_eq!(brightening::<1>((256, 192), |_, _| None), None);
        assert_eq!(brightening((1, 1), |_, _| Some([[0.5], [0.9]])), None);
        assert_eq!(brightening((256, 192), |_, _| Some([[f32::NAN], [0.5]])), None);
    }
}
