//! Relative inverse depth from the parallax of a moving camera.
//!
//! A pinhole camera that moves by T and turns by Omega in front of a scene at rest sees the flow
//! `d A(x) T + B(x) Omega` (Longuet-Higgins & Prazdny 1980), d = 1 / Z, at x = (x, y) in focal lengths from the centre:
//!
//! ```text
//! A = [ -1  0  x ]    B = [ x y      -(1 + x^2)   y ]
//!     [  0 -1  y ]        [ 1 + y^2  -x y        -x ]
//! ```
//!
//! Whatever d is, the part of the flow across `A T` is that of Omega alone. So each direction of T has its best Omega and
//! a residual (Heeger & Jepson 1992), and the best direction is searched on the hemisphere. The flow along `A T` then is
//! d. The equations are taken halfway between the two frames, where they hold to second order.
//!
//! The focal length is assumed to be 1.2 times the width (45 degrees across). A wrong one bends the depth only slightly; what it
//! cannot tell from a turn adds a constant to d. So d is relative: known up to scale, and less well up to an offset.
//!
//! What moves by itself across the epipolar lines is found and unknown; what moves along them is taken for nearer or farther.

use super::flow::FlowPair;
use super::quantile;
use crate::model::{Reason, Unknown};
use crate::{Error, Flow, Plane, Raster, Result, par};

/// Assumed focal length, in image widths.
const FOCAL_LENGTH: f64 = 1.2;
/// About how many pixels the motion is estimated from.
const SAMPLES: usize = 1500;
/// Directions of T that are tried before refinement.
const DIRECTIONS: usize = 256;
/// How many of them are refined.
const STARTS: usize = 3;
/// Cosine of the angle between them, 25 degrees.
const NEIGHBOURS: f64 = 0.9;
/// Fewer samples than this are no basis.
const FEWEST_SAMPLES: usize = 100;
/// Parts of the picture that must agree.
const PARTS: usize = 4;
/// Smallest share of matched pixels: with fewer, there is a cut, or much of the flow is wrong.
const MATCHED: f32 = 0.6;
/// Smallest share of matched pixels that agree with one motion of the camera.
const INLIERS: f64 = 0.65;
/// A flow below this is none, px: dense flow of noisy frames is not better.
const STILL_PX: f64 = 0.15;
/// Largest share of the picture that may stand still while the camera is said to move: a turn that follows a wall stops a part of it.
const STILL: f64 = 0.4;
/// Smallest median parallax, px, and in robust std of the flow across the epipolar lines: a turn alone reaches 1 to 2 by chance.
const PARALLAX_PX: f64 = 0.25;
const PARALLAX_TO_STD: f64 = 6.0;
/// Largest disagreement with a part of the picture, in units of the map's range.
const UNCERTAINTY: f64 = 0.15;
/// A pixel this far off its epipolar line moves by itself: in robust std of all, but at least and at most in px. Flow that is
/// right is better than the upper limit, which grows with frames wider than 500 px.
const OUTLIER: f64 = 4.0;
const OUTLIER_PX: [f64; 2] = [0.2, 1.0];

/// What parallax says of the depth of a frame.
#[derive(Clone, Debug)]
pub enum Parallax {
    /// The camera has moved enough.
    Known(RelativeDepth),
    /// Why nothing is known.
    Unknown(Unknown),
}

/// Relative inverse depth, and what it rests on.
#[derive(Clone, Debug)]
pub struct RelativeDepth {
    /// In [0, 1]: proportional to 1 / Z, up to a small offset. The 98th percentile is 1 in a single frame, or in the first of
    /// a [`ParallaxTracker`]. NaN where unknown: hidden in the other frame, moving by itself, or near the point that the camera heads for.
    pub inverse_depth: Plane,
    /// How far from this map are those that four parts of the picture find, each by itself: the 90th percentile of the
    /// difference for the worst part, in units of the map. Errors of the offset are in it.
    pub uncertainty: f32,
    /// Median length of the flow that no turn of the camera explains, px.
    pub parallax: f32,
    /// Robust std of the flow across the epipolar lines, px.
    pub residual: f32,
    /// Share of the matched pixels that agree with the camera's motion, in [0, 1].
    pub inliers: f32,
    /// Direction of the camera's motion (x right, y down, z forward), of length 1.
    pub translation: [f32; 3],
    /// Turn of the camera about the same axes, in radian if the focal length is 1.2 widths.
    pub rotation: [f32; 3],
}

/// Relative inverse depth of the frame where `flow` starts; `occluded` pixels, and those of unknown flow (NaN), are left out.
///
/// Both as in [`FlowPair`]. Unknown if nothing moves, if the camera only turns, and if the scene moves.
///
/// # Errors
/// If the two differ in size, or have no pixels.
pub fn inverse_depth_from_flow(flow: &Flow, occluded: &Raster<bool>) -> Result<Parallax> {
    Ok(match unscaled(flow, occluded, None)? {
        Err(reason) => Parallax::Unknown(reason),
        Ok(mut depth) => {
            let scale = 1.0 / largest(&depth.inverse_depth);
            scale_to_unit(&mut depth.inverse_depth, scale);
            Parallax::Known(depth)
        }
    })
}

/// Relative inverse depth of one frame after another, all on one scale. Keeps one map.
#[derive(Clone, Debug, Default)]
pub struct ParallaxTracker {
    /// The last known map on the common scale, moved along with the picture to the next frame.
    last: Option<Plane>,
    /// The direction in which the camera last moved, if the next one is looked for near it.
    heading: Option<[f64; 3]>,
    stays_near: bool,
}

impl ParallaxTracker {
    /// A tracker that has seen nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Looks for the camera's direction near the last one only, which takes a fraction of the time; everywhere if
    /// nothing was found the last time. For live footage, in which a camera does not turn about from pair to pair.
    pub fn near_the_last(mut self) -> Self {
        self.stays_near = true;
        self
    }

    /// Relative inverse depth of the first frame of a pair.
    ///
    /// The next pair begins `ahead` frames after this one; if that is more than 1, what moves is taken to go on as it
    /// does between the two. Pairs with too little parallax are unknown; the scale
    /// survives them, but no cut (nor a change of size): after it a new one begins.
    ///
    /// # Errors
    /// The same as [`inverse_depth_from_flow`].
    pub fn push(&mut self, pair: &FlowPair, ahead: usize) -> Result<Parallax> {
        let near = self.heading.take().filter(|_| self.stays_near);
        let fresh = unscaled(&pair.forward, &pair.occluded, near)?;
        self.heading = fresh.as_ref().ok().map(|depth| depth.translation.map(f64::from));
        if self.last.as_ref().is_some_and(|last| last.size() != pair.forward.size())
            || pair.confirmed() < MATCHED
        {
            self.last = None;
        }
        let parallax = match fresh {
            Err(reason) => Parallax::Unknown(reason),
            Ok(mut depth) => {
                let ratio = self.last.as_ref().and_then(|last| median_ratio(last, &depth.inverse_depth));
                let scale = ratio.unwrap_or_else(|| 1.0 / largest(&depth.inverse_depth));
                // Kept without the limit at 1, which would pull the next ratio.
                self.last = Some(depth.inverse_depth.map(|d| d * scale));
                scale_to_unit(&mut depth.inverse_depth, scale);
                Parallax::Known(depth)
            }
        };
        self.last = self.last.as_ref().map(|last| follow(last, &pair.backward, ahead));
        Ok(parallax)
    }
}

/// `map`, seen `ahead` frames later, if the flow back by one frame is given and goes on; NaN where that was out of frame.
fn follow(map: &Plane, backward: &Flow, ahead: usize) -> Plane {
    let (w, h) = map.size();
    Plane::from_fn(w, h, |x, y| {
        let [u, v] = backward.at(x, y).map(|v| ahead as f32 * v);
        let (x, y) = ((x as f32 + u).round(), (y as f32 + v).round());
        let inside = x >= 0.0 && y >= 0.0 && x < w as f32 && y < h as f32;
        if inside { map.at(x as usize, y as usize) } else { f32::NAN }
    })
}

/// Median of `old` / `new` where both are known and not too far away to tell; none if that is hardly anywhere.
fn median_ratio(old: &Plane, new: &Plane) -> Option<f32> {
    let floor = 0.1 * largest(new);
    let pairs = old.data().iter().zip(new.data());
    let mut ratios: Vec<f32> = pairs
        .filter(|(o, n)| **o > 0.05 && **n > floor)
        .map(|(o, n)| o / n)
        .filter(|r| r.is_finite())
        .collect();
    (ratios.len() >= FEWEST_SAMPLES).then(|| *quantile(&mut ratios, 0.5))
}

/// The 98th percentile of what is known.
fn largest(d: &Plane) -> f32 {
    let mut known: Vec<f32> = d.data().iter().copied().filter(|d| d.is_finite()).collect();
    if known.is_empty() { 1.0 } else { quantile(&mut known, 0.98).max(f32::MIN_POSITIVE) }
}

fn scale_to_unit(d: &mut Plane, scale: f32) {
    for d in d.data_mut() {
        *d = if d.is_nan() { f32::NAN } else { (*d * scale).clamp(0.0, 1.0) };
    }
}

/// A pixel in focal lengths from the centre, halfway along its flow, and its flow in focal lengths.
#[derive(Clone, Copy)]
struct Sample {
    x: f64,
    y: f64,
    u: f64,
    v: f64,
}

impl Sample {
    /// `None` where the flow is unknown.
    fn new(flow: &Flow, occluded: &Raster<bool>, x: usize, y: usize) -> Option<Self> {
        let (w, h) = flow.size();
        let [u, v] = flow.at(x, y).map(f64::from);
        if occluded.at(x, y) || !(u.is_finite() && v.is_finite()) {
            return None;
        }
        let f = FOCAL_LENGTH * w as f64;
        let x = (x as f64 + 0.5 * u - 0.5 * (w as f64 - 1.0)) / f;
        let y = (y as f64 + 0.5 * v - 0.5 * (h as f64 - 1.0)) / f;
        Some(Self { x, y, u: u / f, v: v / f })
    }

    /// The flow of a turn, `B Omega`.
    fn turn(&self, o: [f64; 3]) -> [f64; 2] {
        let [bx, by] = self.b();
        [dot(bx, o), dot(by, o)]
    }

    fn b(&self) -> [[f64; 3]; 2] {
        let (x, y) = (self.x, self.y);
        [[x * y, -(1.0 + x * x), y], [1.0 + y * y, -x * y, -x]]
    }

    /// `A T`: its direction, and its length.
    fn epipolar(&self, t: [f64; 3]) -> ([f64; 2], f64) {
        let (x, y) = (self.x * t[2] - t[0], self.y * t[2] - t[1]);
        let length = (x * x + y * y).sqrt().max(1e-9);
        ([x / length, y / length], length)
    }

    /// The equation for Omega across the epipolar line: row, right-hand side.
    fn across(&self, t: [f64; 3]) -> ([f64; 3], f64) {
        let [ex, ey] = self.epipolar(t).0;
        let [bx, by] = self.b();
        (std::array::from_fn(|i| ex * by[i] - ey * bx[i]), ex * self.v - ey * self.u)
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    a.map(|v| v / dot(a, a).sqrt())
}

/// Equations that are worked on at once.
const LANES: usize = 2;

/// Weighted normal equations of three unknowns.
#[derive(Default)]
struct Normal {
    /// Products of the unknowns' coefficients: 00, 01, 02, 11, 12, 22.
    products: [[f64; LANES]; 6],
    /// The products with the right-hand side.
    right: [[f64; LANES]; 3],
}

impl Normal {
    /// Coefficients, right-hand sides and weights.
    fn add(&mut self, [a, b, c]: [[f64; LANES]; 3], right: [f64; LANES], weight: [f64; LANES]) {
        for l in 0..LANES {
            let w = weight[l];
            let (wa, wb, wc) = (w * a[l], w * b[l], w * c[l]);
            self.products[0][l] += wa * a[l];
            self.products[1][l] += wa * b[l];
            self.products[2][l] += wa * c[l];
            self.products[3][l] += wb * b[l];
            self.products[4][l] += wb * c[l];
            self.products[5][l] += wc * c[l];
            self.right[0][l] += wa * right[l];
            self.right[1][l] += wb * right[l];
            self.right[2][l] += wc * right[l];
        }
    }

    fn solve(&self) -> [f64; 3] {
        let sum = |lanes: [f64; LANES]| lanes.iter().sum::<f64>();
        let [aa, ab, ac, bb, bc, cc] = self.products.map(sum);
        let right = self.right.map(sum);
        let ridge = 1e-9 * (aa + bb + cc) + 1e-30;
        // Cramer's rule.
        let [a, b, c] = [[aa + ridge, ab, ac], [ab, bb + ridge, bc], [ac, bc, cc + ridge]];
        let det = dot(a, cross(b, c));
        [cross(b, c), cross(c, a), cross(a, b)].map(|row| dot(row, right) / det)
    }
}

/// Geman & McClure's weight of a residual at a scale; 1 at an infinite one.
fn weight(residual: f64, scale: f64) -> f64 {
    let q = residual / (2.0 * scale);
    1.0 / (1.0 + q * q).powi(2)
}

/// A turn, and the robust std that it leaves of the flow across the epipolar lines, in focal lengths.
#[derive(Clone, Copy)]
struct Turn {
    by: [f64; 3],
    std: f64,
}

/// The equations for the turn across the epipolar lines of one direction, [`LANES`] by [`LANES`].
struct Across {
    /// Three coefficients and the right-hand side; zeros at the end, which say nothing.
    groups: Vec<[[f64; LANES]; 4]>,
    count: usize,
}

impl Across {
    fn new(samples: &[Sample], t: [f64; 3]) -> Self {
        let group = |some: &[Sample]| {
            let mut group = [[0.0; LANES]; 4];
            for (lane, s) in some.iter().enumerate() {
                let ([a, b, c], right) = s.across(t);
                (0..4).for_each(|i| group[i][lane] = [a, b, c, right][i]);
            }
            group
        };
        Self { groups: samples.chunks(LANES).map(group).collect(), count: samples.len() }
    }

    /// What a turn leaves.
    fn residuals(&self, o: [f64; 3]) -> impl Iterator<Item = [f64; LANES]> + '_ {
        self.groups.iter().map(move |[a, b, c, right]| {
            std::array::from_fn(|l| right[l] - (a[l] * o[0] + b[l] * o[1] + c[l] * o[2]))
        })
    }

    /// The turn that fits best with the weights that another's residuals have at a scale.
    fn reweighted(&self, turn: Turn) -> [f64; 3] {
        let mut normal = Normal::default();
        for (&[a, b, c, right], residual) in self.groups.iter().zip(self.residuals(turn.by)) {
            normal.add([a, b, c], right, residual.map(|r| weight(r, turn.std)));
        }
        normal.solve()
    }

    /// Robust std of what a turn leaves.
    fn std(&self, o: [f64; 3]) -> f64 {
        let mut lengths: Vec<f64> = self.residuals(o).flatten().take(self.count).map(f64::abs).collect();
        1.4826 * *quantile(&mut lengths, 0.5) + 1e-9
    }

    /// Geman & McClure's cost of what a turn leaves, in [0, 1].
    fn cost(&self, turn: Turn) -> f64 {
        let mut sums = [0.0; LANES];
        for residual in self.residuals(turn.by) {
            for l in 0..LANES {
                let q = residual[l] / (2.0 * turn.std);
                sums[l] += q * q / (1.0 + q * q);
            }
        }
        sums.iter().sum::<f64>() / self.count as f64
    }
}

/// The turn that fits best across the epipolar lines of `t`. `near` is the start and the scale of the residuals; without it,
/// all samples count alike at first, and the scale is found. And its robust cost at that scale, in [0, 1].
fn turn_for(samples: &[Sample], t: [f64; 3], near: Option<Turn>) -> (Turn, f64) {
    let equations = Across::new(samples, t);
    let mut turn = near.unwrap_or(Turn { by: [0.0; 3], std: f64::INFINITY });
    for _ in 0..if near.is_some() { 2 } else { 5 } {
        turn.by = equations.reweighted(turn);
        if near.is_none() {
            turn.std = equations.std(turn.by);
        }
    }
    (turn, equations.cost(turn))
}

/// Median length of what a turn alone leaves of the flow, for the best one.
fn parallax_beside_turn(samples: &[Sample]) -> f64 {
    let mut turn = [0.0; 3];
    let mut median = f64::INFINITY;
    for _ in 0..10 {
        let mut normal = Normal::default();
        for s in samples {
            let [x, y] = s.turn(turn);
            let weight = weight((s.u - x).hypot(s.v - y), median);
            let [bx, by] = s.b();
            normal.add(std::array::from_fn(|i| [bx[i], by[i]]), [s.u, s.v], [weight; LANES]);
        }
        turn = normal.solve();
        let mut lengths: Vec<f64> = samples
            .iter()
            .map(|s| {
                let [x, y] = s.turn(turn);
                (s.u - x).hypot(s.v - y)
            })
            .collect();
        median = *quantile(&mut lengths, 0.5) + 1e-9;
    }
    median
}

/// What moves the camera.
#[derive(Clone, Copy)]
struct Motion {
    /// Direction.
    translation: [f64; 3],
    turn: Turn,
}

impl Motion {
    /// Inverse depth; how much one unit of it moves the pixel along its epipolar line; how far it is off the line.
    fn measure(&self, s: &Sample) -> [f64; 3] {
        let ([ex, ey], length) = s.epipolar(self.translation);
        let [bx, by] = s.turn(self.turn.by);
        let (u, v) = (s.u - bx, s.v - by);
        [(ex * u + ey * v) / length, length, ex * v - ey * u]
    }

    /// The same with most of `samples` in front of the camera.
    fn forward(self, samples: &[Sample]) -> Self {
        let ahead = samples.iter().filter(|s| self.measure(s)[0] > 0.0).count();
        let sign = if 2 * ahead < samples.len() { -1.0 } else { 1.0 };
        Self { translation: self.translation.map(|t| sign * t), ..self }
    }
}

/// The motion that explains `samples` best, from any direction, or from one nearby.
fn searched(samples: &[Sample], near: Option<[f64; 3]>) -> Motion {
    if let Some(near) = near {
        return refined(samples, near, [0.05, 0.002]);
    }
    // A spiral of even density over the hemisphere; T and -T are the same but for the sign of d.
    let direction = |i: usize| {
        let (z, angle) = ((i as f64 + 0.5) / DIRECTIONS as f64, i as f64 * 2.399_963);
        let r = (1.0 - z * z).sqrt();
        [r * angle.cos(), r * angle.sin(), z]
    };
    let some: Vec<Sample> = samples.iter().copied().step_by(2).collect();
    let mut tried: Vec<(f64, [f64; 3])> =
        par::map(DIRECTIONS, |i| (turn_for(&some, direction(i), None).0.std, direction(i)));
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    // The best of the coarse ones may lie in the wrong valley: the others that are not its neighbours get their chance.
    let mut starts: Vec<[f64; 3]> = Vec::new();
    for (_, t) in tried {
        if starts.len() < STARTS && starts.iter().all(|s| dot(*s, t).abs() < NEIGHBOURS) {
            starts.push(t);
        }
    }
    let found = starts.into_iter().map(|t| refined(samples, t, [0.1, 0.01]));
    let best = found.min_by(|a, b| a.turn.std.total_cmp(&b.turn.std));
    refined(samples, best.map_or([0.0, 0.0, 1.0], |motion| motion.translation), [0.05, 0.002])
}

/// The motion near a direction that explains `samples` best: by steps from `coarsest` to `finest`, radian.
fn refined(samples: &[Sample], mut t: [f64; 3], [coarsest, finest]: [f64; 2]) -> Motion {
    let mut turn = turn_for(samples, t, None).0;
    // Twice, since the scale of the residuals falls with a better direction.
    for mut step in [coarsest, 4.0 * finest] {
        let mut cost = turn_for(samples, t, Some(turn)).1;
        for _ in 0..200 {
            if step < finest {
                break;
            }
            let e = unit(cross(t, if t[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] }));
            let n = cross(t, e);
            let around = par::map(8, |k| {
                let (sin, cos) = (std::f64::consts::FRAC_PI_4 * k as f64).sin_cos();
                let t = unit(std::array::from_fn(|i| t[i] + step * (cos * e[i] + sin * n[i])));
                (t, turn_for(samples, t, Some(turn)))
            });
            match around.into_iter().filter(|(_, (_, c))| *c < cost).min_by(|a, b| a.1.1.total_cmp(&b.1.1)) {
                Some(better) => (t, (turn, cost)) = better,
                None => step *= 0.5,
            }
        }
        turn = turn_for(samples, t, None).0;
    }
    Motion { translation: t, turn }
}

/// The camera's motion, and how far from its inverse depths are those that parts of the picture find, each by itself: the
/// 90th percentile of the difference, in units of the largest, for the worst part.
fn camera_motion(
    samples: &[(usize, usize, Sample)],
    (w, h): (usize, usize),
    near: Option<[f64; 3]>,
) -> (Motion, f64) {
    // Fields of a board: each part sees all of the picture, but the errors of the flow there are its own.
    let part = |k: usize| -> Vec<Sample> {
        let field = |x: usize, y: usize| (6 * x / w) % 2 + 2 * ((6 * y / h) % 2);
        samples.iter().filter(|(x, y, _)| field(*x, *y) == k).map(|s| s.2).collect()
    };
    let all: Vec<Sample> = samples.iter().map(|s| s.2).collect();
    let depths = |motion: &Motion| all.iter().map(|s| motion.measure(s)[0]).collect::<Vec<f64>>();
    let parts: Vec<Vec<Sample>> =
        (0..PARTS).map(part).filter(|part| part.len() >= FEWEST_SAMPLES / PARTS).collect();
    let found = par::map(parts.len(), |i| searched(&parts[i], near));
    let std = |motion: &Motion| turn_for(&all, motion.translation, None).0.std;
    let best = found.iter().map(|m| (std(m), m.translation)).min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, start)) = best else { return (searched(&all, near), f64::INFINITY) };
    // What a part finds is near already.
    let motion = refined(&all, start, [0.02, 2e-4]).forward(&all);
    let d = depths(&motion);
    let largest = *quantile(&mut d.clone(), 0.98);
    let disagreement = |other: Motion| {
        let other = depths(&other.forward(&all));
        // The scale of each is its own.
        let near = d.iter().zip(&other).filter(|(d, _)| **d > 0.1 * largest);
        let mut ratios: Vec<f64> = near.map(|(d, o)| d / o).collect();
        if ratios.is_empty() {
            return f64::INFINITY;
        }
        let ratio = *quantile(&mut ratios, 0.5);
        let mut gaps: Vec<f64> = d.iter().zip(&other).map(|(d, o)| (d - ratio * o).abs() / largest).collect();
        *quantile(&mut gaps, 0.9)
    };
    let worst = found.into_iter().map(disagreement).fold(0.0, |a, b| if b > a || b.is_nan() { b } else { a });
    (motion, worst)
}

/// Inverse depth in units of the camera's motion, which may be looked `near` a direction only, or why there is none.
fn unscaled(
    flow: &Flow,
    occluded: &Raster<bool>,
    near: Option<[f64; 3]>,
) -> Result<std::result::Result<RelativeDepth, Unknown>> {
    let (w, h) = flow.size();
    if occluded.size() != (w, h) {
        let (ow, oh) = occluded.size();
        return Err(Error::new(format!(
            "the flow has {w} x {h} pixels, but what is occluded {ow} x {oh}: give both of one pair"
        )));
    }
    if w == 0 || h == 0 {
        return Err(Error::new(format!("a flow of {w} x {h} pixels says nothing of depth")));
    }
    Ok(par::within(|| depth_of(flow, occluded, near)))
}

// Long, since it is a list of conditions, each with the reason for which depth is unknown if it fails.
fn depth_of(
    flow: &Flow,
    occluded: &Raster<bool>,
    near: Option<[f64; 3]>,
) -> std::result::Result<RelativeDepth, Unknown> {
    let (w, h) = flow.size();
    let f = FOCAL_LENGTH * w as f64;
    let step = ((w * h) as f64 / SAMPLES as f64).sqrt().max(1.0) as usize;
    let grid = |size: usize| (step / 2..size).step_by(step);
    let tried = grid(w).count() * grid(h).count();
    let samples: Vec<(usize, usize, Sample)> = grid(h)
        .flat_map(|y| grid(w).filter_map(move |x| Some((x, y, Sample::new(flow, occluded, x, y)?))))
        .collect();
    if tried < FEWEST_SAMPLES {
        return Err(Unknown::new(
            Reason::Flat,
            format!("{w} x {h} pixels are too few to find the camera's motion"),
        ));
    }
    if samples.len() < FEWEST_SAMPLES || (samples.len() as f32) < MATCHED * tried as f32 {
        return Err(Unknown::new(
            Reason::NotFollowed,
            format!(
                "only {} % of the picture is found again in the next frame (a cut, or too large a motion)",
                100 * samples.len() / tried
            ),
        ));
    }
    let flat: Vec<Sample> = samples.iter().map(|s| s.2).collect();
    let share =
        |of: &dyn Fn(&Sample) -> bool| flat.iter().filter(|s| of(s)).count() as f64 / flat.len() as f64;
    let still = share(&|s| f * s.u.hypot(s.v) < STILL_PX);
    if still > 0.9 {
        return Err(Unknown::new(Reason::NoMotion, "nothing moves between the frames"));
    }
    if still > STILL {
        return Err(Unknown::new(
            Reason::SceneMoves,
            format!(
                "{:.0} % of the picture stands still while the rest moves, so it is the scene that moves, not the camera",
                100.0 * still
            ),
        ));
    }
    let parallax = f * parallax_beside_turn(&flat);
    if parallax < PARALLAX_PX {
        return Err(Unknown::new(
            Reason::NoMotion,
            format!("the camera hardly does more than turn: {parallax:.2} px of parallax between the frames"),
        ));
    }
    let (motion, uncertainty) = camera_motion(&samples, (w, h), near);
    let residual = f * motion.turn.std;
    let [least, most] = [OUTLIER_PX[0], OUTLIER_PX[1] * (w as f64 / 500.0).max(1.0)];
    let limit = (OUTLIER * f * motion.turn.std).min(most).max(least) / f;
    // What is farther behind than infinity by more than the noise moves by itself too.
    let agrees = |[d, length, across]: [f64; 3]| across.abs() <= limit && d * length >= -limit;
    let inliers = share(&|s| agrees(motion.measure(s)));
    if inliers < INLIERS {
        return Err(Unknown::new(
            Reason::SceneMoves,
            format!(
                "the scene moves, or the flow is wrong: only {:.0} % of the picture agrees with one motion of the camera",
                100.0 * inliers
            ),
        ));
    }
    if parallax < PARALLAX_TO_STD * residual {
        return Err(Unknown::new(
            Reason::NoMotion,
            format!(
                "{parallax:.2} px of parallax are too little beside {residual:.2} px of contradiction in the flow (the \
             camera hardly does more than turn, or the scene moves)"
            ),
        ));
    }
    // Also where it is not a number.
    if uncertainty.is_nan() || uncertainty > UNCERTAINTY {
        return Err(Unknown::new(
            Reason::Contradicting,
            format!(
                "parts of the picture tell of different motions of the camera: their depths differ by {:.0} % of the range",
                100.0 * uncertainty
            ),
        ));
    }
    let mut known: Vec<f64> =
        flat.iter().map(|s| motion.measure(s)).filter(|m| agrees(*m)).map(|m| m[0]).collect();
    let nearest = *quantile(&mut known, 0.98);
    let inverse_depth = Plane::from_fn(w, h, |x, y| {
        let Some(s) = Sample::new(flow, occluded, x, y) else { return f32::NAN };
        let m @ [d, length, _] = motion.measure(&s);
        // Where the camera heads, the noise of the flow is more than a tenth of the range of d.
        if !agrees(m) || motion.turn.std > 0.1 * nearest * length {
            return f32::NAN;
        }
        // From halfway back to this frame, when the camera was half a step farther behind.
        let d = d.max(0.0);
        (d / (1.0 + 0.5 * d * motion.translation[2])) as f32
    });
    Ok(RelativeDepth {
        inverse_depth,
        uncertainty: uncertainty as f32,
        parallax: parallax as f32,
        residual: residual as f32,
        inliers: inliers as f32,
        translation: motion.translation.map(|t| t as f32),
        rotation: motion.turn.by.map(|o| o as f32),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_moved_along_with_the_picture_also_over_frames_that_are_left_out() {
        let map = Plane::from_fn(60, 4, |x, _| x as f32);
        let backward = Flow::filled(60, 4, [-3.0, 0.0]);
        assert_eq!(follow(&map, &backward, 1).at(40, 2), 37.0);
        assert_eq!(follow(&map, &backward, 5).at(40, 2), 25.0);
        assert!(follow(&map, &backward, 5).at(10, 2).is_nan());
    }
}
