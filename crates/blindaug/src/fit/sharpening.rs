//! The camera's sharpening, from profiles across edges: optics and motion only smooth a step, so what rises above its upper
//! side and falls below its lower one was put there afterwards.
//!
//! Straight, isolated steps between two even sides are averaged, the sharpest of them, on both sides of the step together (the
//! transfer curve skews a profile). The mean is compared with a Gaussian edge after an unsharp mask:
//! `E(t, s) + amount (E(t, s) - E(t, sqrt(s^2 + r^2)))`, E the cumulative normal distribution.

use super::spectral::{block_of, resampled};
use crate::model::{Method, SharpeningModel};
use crate::{Encoded, Plane, par};

/// Profiles reach so far from the edge, px; beyond [`EVEN`] both sides must be even.
const REACH: f32 = 7.0;
const EVEN: f32 = 5.0;
/// Samples of a profile per px, and how many there are.
const PER_PX: usize = 2;
const LEN: usize = 2 * REACH as usize * PER_PX + 1;
/// Samples of one half of a profile without the last px, which moving it to its centre uses up.
const HALF: usize = (REACH as usize - 1) * PER_PX + 1;
/// Steps are at least this high, in encoded values, rise this much per px, and their sides scatter by no more than this share.
const MIN_CONTRAST: f32 = 0.1;
const MIN_GRADIENT: f32 = 0.03;
const MAX_SCATTER: f32 = 0.06;
/// One edge is taken in each square of so many px.
const CELL: usize = 6;
/// The share of edges, the sharpest, that counts, and how many there must be.
const SHARPEST: f32 = 0.3;
const MIN_EDGES: usize = 40;
/// Of the step's height: less overshoot is not called sharpening, for resampling leaves as much.
const MIN_OVERSHOOT: f32 = 0.015;
/// Std of the mask's Gaussian, px: taken to be this, since a wider mask and a sharper edge look alike.
const RADIUS: f32 = 1.0;
const REPLICAS: usize = 80;

/// A step in the image.
#[derive(Clone, Debug)]
pub(super) struct Edge {
    block: u32,
    /// From a quarter to three quarters of its height, px.
    width: f32,
    /// From the centre outwards: by how much the upper side lies above, and the lower one below, their levels, on average; of
    /// the step's height. -1/2 at the centre.
    excess: [f32; HALF],
}

/// The edges of a frame that can be judged.
pub(super) fn edges(frame: &Encoded) -> Vec<Edge> {
    let luma = frame.luma();
    let (w, h) = luma.size();
    let margin = REACH as usize + 2;
    if w <= 2 * margin || h <= 2 * margin {
        return vec![];
    }
    let gradient = |x: usize, y: usize| {
        [luma.at(x + 1, y) - luma.at(x - 1, y), luma.at(x, y + 1) - luma.at(x, y - 1)].map(|v| 0.5 * v)
    };
    let (columns, rows) = ((w - 2 * margin) / CELL, (h - 2 * margin) / CELL);
    let found = par::map(rows * columns, |i| {
        let (x0, y0) = (margin + i % columns * CELL, margin + i / columns * CELL);
        let steepest = (y0..y0 + CELL)
            .flat_map(|y| (x0..x0 + CELL).map(move |x| (x, y)))
            .map(|(x, y)| {
                let [u, v] = gradient(x, y);
                ((u * u + v * v).sqrt(), [u, v], (x, y))
            })
            .fold((0.0, [0.0; 2], (0, 0)), |a, b| if b.0 > a.0 { b } else { a });
        let (steepness, [u, v], (x, y)) = steepest;
        if steepness < MIN_GRADIENT {
            return None;
        }
        edge(&luma, (x as f32, y as f32), [u / steepness, v / steepness], block_of((x, y), (w, h)))
    });
    found.into_iter().flatten().collect()
}

/// The step at a place that rises in this direction, if it is one.
fn edge(luma: &Plane, (x, y): (f32, f32), [u, v]: [f32; 2], block: u32) -> Option<Edge> {
    let offset = |i: usize| i as f32 / PER_PX as f32 - REACH;
    let line = |across: f32| -> [f32; LEN] {
        std::array::from_fn(|i| {
            let t = offset(i);
            luma.bilinear(x + t * u - across * v, y + t * v + across * u)
        })
    };
    // A corner, or a bent edge, differs to its sides.
    let lines = [line(-1.5), line(0.0), line(1.5)];
    let profile: [f32; LEN] = std::array::from_fn(|i| (lines[0][i] + lines[1][i] + lines[2][i]) / 3.0);
    let count = ((REACH - EVEN) * PER_PX as f32) as usize + 1;
    let level = |values: &[f32]| {
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / values.len() as f32).sqrt())
    };
    let ((low, low_scatter), (high, high_scatter)) =
        (level(&profile[..count]), level(&profile[LEN - count..]));
    let height = high - low;
    // Clipped values would hide the overshoot.
    let clipped = profile.iter().any(|v| !(0.02..=0.98).contains(v));
    if height < MIN_CONTRAST || low_scatter.max(high_scatter) > MAX_SCATTER * height || clipped {
        return None;
    }
    let relative = |line: &[f32; LEN]| line.map(|v| (v - low) / height);
    let [before, _, after] = lines.each_ref().map(relative);
    if (0..LEN).any(|i| (before[i] - after[i]).abs() > 0.35) {
        return None;
    }
    let profile = relative(&profile);
    // Where it first rises past a level, px; it must do so only once.
    let crossing = |level: f32| {
        let mut at = (1..LEN).filter(|&i| (profile[i - 1] < level) != (profile[i] < level));
        let i = at.next()?;
        let share = (level - profile[i - 1]) / (profile[i] - profile[i - 1]);
        at.next().is_none().then(|| offset(i - 1) + share / PER_PX as f32)
    };
    let (quarter, centre, three) = (crossing(0.25)?, crossing(0.5)?, crossing(0.75)?);
    if centre.abs() > 0.9 {
        return None;
    }
    let at = |t: f32| {
        let place = (t + REACH) * PER_PX as f32;
        let i = (place as usize).min(LEN - 2);
        profile[i] + (place - i as f32) * (profile[i + 1] - profile[i])
    };
    let excess = std::array::from_fn(|i| {
        let t = i as f32 / PER_PX as f32;
        0.5 * (at(centre + t) - 1.0 - at(centre - t))
    });
    Some(Edge { block, width: three - quarter, excess })
}

/// What the edges of all frames say; `None` if they show no sharpening, or are too few to tell.
pub(super) fn fit(frames: &[&[Edge]]) -> Option<SharpeningModel> {
    let mut edges: Vec<(usize, &Edge)> =
        frames.iter().enumerate().flat_map(|(f, edges)| edges.iter().map(move |e| (f, e))).collect();
    edges.sort_by(|a, b| a.1.width.total_cmp(&b.1.width));
    edges.truncate((SHARPEST * edges.len() as f32) as usize);
    if edges.len() < MIN_EDGES {
        return None;
    }
    let mean = |weight: &dyn Fn(usize, &Edge) -> f32| {
        let (mut sum, mut weights) = ([0.0f32; HALF], 0.0);
        for &(frame, edge) in &edges {
            let weight = weight(frame, edge);
            weights += weight;
            sum.iter_mut().zip(edge.excess).for_each(|(s, v)| *s += weight * v);
        }
        sum.map(|s| s / weights)
    };
    let amount = amount_of(&mean(&|_, _| 1.0));
    let replicas: Vec<([f32; HALF], f32)> = par::map(REPLICAS, |r| {
        let excess = mean(&|frame, edge| resampled(r, edge.block, frame));
        (excess, amount_of(&excess))
    });
    let quantile = |mut v: Vec<f32>, q: f32| {
        v.sort_by(f32::total_cmp);
        v[(q * (v.len() - 1) as f32).round() as usize]
    };
    let overshoot = |excess: &[f32; HALF]| excess.iter().copied().fold(f32::MIN, f32::max);
    if quantile(replicas.iter().map(|r| overshoot(&r.0)).collect(), 0.025) < MIN_OVERSHOOT {
        return None;
    }
    let amounts = || replicas.iter().map(|r| r.1).collect::<Vec<f32>>();
    // The edges are no Gaussian ones.
    let floor = 1.96 * 0.1 * amount;
    let interval = [
        (amount - (amount - quantile(amounts(), 0.025)).max(0.0).hypot(floor)).max(0.0),
        amount + (quantile(amounts(), 0.975) - amount).max(0.0).hypot(floor),
    ];
    let samples = edges.len() as u64;
    Some(SharpeningModel { amount, radius_px: RADIUS, interval, method: Method::Edges, samples })
}

/// The amount that explains a profile best, after an edge of any width.
fn amount_of(excess: &[f32; HALF]) -> f32 {
    let half = |t: f32, s: f32| 0.5 * libm::erff(t / (s * std::f32::consts::SQRT_2));
    let of_width = |sigma: f32| {
        let wider = sigma.hypot(RADIUS);
        let (mut top, mut bottom, mut error) = (0.0, 1e-9, 0.0);
        for (i, v) in excess.iter().enumerate() {
            let t = i as f32 / PER_PX as f32;
            let (edge, added) = (half(t, sigma), half(t, sigma) - half(t, wider));
            let missing = v + 0.5 - edge;
            top += missing * added;
            bottom += added * added;
            error += missing * missing;
        }
        let amount = (top / bottom).clamp(0.0, 20.0);
        (amount, error - 2.0 * amount * top + amount * amount * bottom)
    };
    let best = (0..45).map(|i| of_width(0.3 + 0.05 * i as f32)).min_by(|a, b| a.1.total_cmp(&b.1));
    best.map_or(0.0, |b| b.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Raster;

    /// Slanted steps of many heights, smoothed by a Gaussian edge, sharpened by `amount` with a radius of 1 px, and noisy.
    fn steps(amount: f32, sigma: f32) -> Encoded {
        let erf = |t: f32, s: f32| 0.5 + 0.5 * libm::erff(t / (s * std::f32::consts::SQRT_2));
        Encoded(Raster::from_fn(256, 256, |x, y| {
            let (cell, inside) = (x / 32, x as f32 % 32.0 - 16.0 - 0.1 * (y % 64) as f32 + 3.2);
            let height = 0.15 + 0.02 * ((cell * 7 + y / 64 * 3) % 11) as f32;
            let edge = erf(inside, sigma) + amount * (erf(inside, sigma) - erf(inside, sigma.hypot(1.0)));
            // Down again half way to the next.
            let down = (1.0 - (inside.abs() - 9.0) / 4.0).clamp(0.0, 1.0);
            let noise = 0.004 * (super::super::uniform(x as u64, y as u64) - 0.5);
            [0.3 + height * (edge - if inside > 0.0 { 1.0 - down } else { 0.0 }) + noise; 3]
        }))
    }

    #[test]
    fn steps_tell_by_how_much_they_were_sharpened() {
        for (amount, sigma) in [(0.6, 0.8), (1.2, 0.8), (1.2, 1.2)] {
            let found = edges(&steps(amount, sigma));
            let model = fit(&[&found]).expect("they overshoot");
            println!("{amount} after {sigma} px: {model:?}");
            assert!((model.amount / amount - 1.0).abs() < 0.3, "{model:?}");
        }
    }

    #[test]
    fn steps_that_were_only_smoothed_show_none() {
        for sigma in [0.6, 0.8, 1.5] {
            let found = edges(&steps(0.0, sigma));
            assert!(found.len() > 200, "{}", found.len());
            assert!(fit(&[&found]).is_none());
        }
    }
}
