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
//! The part of the flow across `A T` depends on Omega alone, whatever d is. So each direction of T has its best Omega and
//! a residual (Heeger & Jepson 1992), and the best direction is searched on the hemisphere. The flow along `A T` then gives
//! d. The equations are taken halfway between the two frames, where they hold to second order.
//!
//! The focal length is assumed to be 1.2 times the width (45 degrees across). A wrong focal length bends the depth only slightly; errors
//! that look like a turn add a constant to d. So d is relative: known up to a scale, and less well up to an offset.
//!
//! Objects that move by themselves across the epipolar lines are found, and their depth is unknown; objects that move along these lines
//! are taken to be nearer or farther than they are.

use super::flow::FlowPair;
use super::quantile;
use crate::model::{Reason, Unknown};
use crate::{Error, Flow, Plane, Raster, Result, par};
use wide::f64x2;

/// The assumed focal length, in image widths.
const FOCAL_LENGTH: f64 = 1.2;
/// The approximate number of pixels from which the motion is estimated.
const SAMPLES: usize = 1500;
/// The number of directions of T that are tried before refinement.
const DIRECTIONS: usize = 256;
/// The number of those directions that are refined.
const STARTS: usize = 3;
/// The cosine of the least angle between two directions that are refined, 25 degrees.
const NEIGHBOURS: f64 = 0.9;
/// The least number of samples from which the motion is estimated.
const FEWEST_SAMPLES: usize = 100;
/// The number of parts of the picture that must agree.
const PARTS: usize = 4;
/// The smallest share of matched pixels: with fewer, there is a cut, or much of the flow is wrong.
const MATCHED: f32 = 0.6;
/// The smallest share of matched pixels that must agree with one motion of the camera.
const INLIERS: f64 = 0.65;
/// The length of flow, in px, below which a pixel stands still: dense flow of noisy frames is not more accurate.
const STILL_PX: f64 = 0.15;
/// The largest share of the picture that may stand still while the camera moves: a turn that follows a wall can stop a part of the wall.
const STILL: f64 = 0.4;
/// The smallest median parallax, in px.
const PARALLAX_PX: f64 = 0.25;
/// The smallest median parallax, in robust stds of the flow across the epipolar lines; a mere turn reaches 1 to 2 by chance.
const PARALLAX_TO_STD: f64 = 6.0;
/// The largest disagreement with a part of the picture, in units of the map's range.
const UNCERTAINTY: f64 = 0.15;
/// The distance from its epipolar line beyond which a pixel moves by itself, in robust stds of all pixels' distances.
const OUTLIER: f64 = 4.0;
/// The least and the largest value of that distance, in px. Correct flow is more accurate than the largest value, which grows in
/// proportion to the width of frames wider than 500 px.
const OUTLIER_PX: [f64; 2] = [0.2, 1.0];

/// The depth of a frame by parallax, or the reason why it is unknown.
#[derive(Clone, Debug)]
pub enum Parallax {
    /// The camera has moved enough to tell depth.
    Known(RelativeDepth),
    /// The reason why the depth is unknown.
    Unknown(Unknown),
}

/// Relative inverse depth, with the camera's motion and the quality of the fit.
#[derive(Clone, Debug)]
pub struct RelativeDepth {
    /// Inverse depth in [0, 1], proportional to 1 / Z up to a small offset. Its 98th percentile is 1 in a single frame and in the first
    /// frame of a [`ParallaxTracker`]. It is NaN at pixels that are hidden in the other frame, move by themselves, or lie near the point
    /// that the camera heads for.
    pub inverse_depth: Plane,
    /// The disagreement with the maps that four parts of the picture find, each by itself: the 90th percentile of the difference for the
    /// worst part, in units of the map. It includes errors of the offset.
    pub uncertainty: f32,
    /// The median length of the flow that no turn of the camera explains, px.
    pub parallax: f32,
    /// The robust std of the flow across the epipolar lines, px.
    pub residual: f32,
    /// The share of the matched pixels that agree with the camera's motion, in [0, 1].
    pub inliers: f32,
    /// The direction of the camera's motion (x right, y down, z forward), of length 1.
    pub translation: [f32; 3],
    /// The turn of the camera about the axes x right, y down and z forward, in radian if the focal length is 1.2 widths.
    pub rotation: [f32; 3],
}

/// Relative inverse depth of the frame in which `flow` starts; `occluded` pixels, and pixels of unknown flow (NaN), are left out.
///
/// `flow` and `occluded` are as in [`FlowPair`]. The depth is unknown if nothing moves, if the camera only turns, or if the scene moves.
///
/// # Errors
/// If `flow` and `occluded` differ in size, or have no pixels.
pub fn inverse_depth_from_flow(flow: &Flow, occluded: &Raster<bool>) -> Result<Parallax> {
    Ok(match unscaled(flow, occluded, PARALLAX_PX, None)? {
        Err(reason) => Parallax::Unknown(reason),
        Ok(mut depth) => {
            let scale = 1.0 / largest(&depth.inverse_depth);
            scale_to_unit(&mut depth.inverse_depth, scale);
            Parallax::Known(depth)
        }
    })
}

/// Relative inverse depth of one frame after another, all on one scale. The tracker keeps one map.
#[derive(Clone, Debug, Default)]
pub struct ParallaxTracker {
    /// The last known map on the common scale, warped to the next frame.
    last: Option<Plane>,
    /// The direction in which the camera moved between the last two frames, if it is known.
    heading: Option<[f64; 3]>,
    /// Whether the next direction is searched only near `heading`.
    stays_near: bool,
    /// The factor by which the images were reduced; 0 or 1 if they were not.
    reduced: usize,
}

impl ParallaxTracker {
    /// A tracker that has seen nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes the tracker search the camera's direction near the last one only, which takes a fraction of the time, and everywhere if
    /// the last pair gave no direction. This is for live footage, in which the direction does not jump from pair to pair.
    pub fn near_the_last(mut self) -> Self {
        self.stays_near = true;
        self
    }

    /// Announces that the next images are reduced by this factor. A pixel of theirs is a mean, whose flow is more exact in px of its own, so
    /// that parallax of half as many px is relied on.
    pub(crate) fn of_reduced(&mut self, factor: usize) {
        self.reduced = factor;
    }

    /// Relative inverse depth of the first frame of a pair.
    ///
    /// The next pair begins `ahead` frames after this one; if `ahead` is more than 1, the motion between the two frames is taken to
    /// continue. The depth of a pair with too little parallax is unknown, but the scale is kept. After a cut or a change of size a new
    /// scale begins.
    ///
    /// # Errors
    /// The same as [`inverse_depth_from_flow`].
    pub fn push(&mut self, pair: &FlowPair, ahead: usize) -> Result<Parallax> {
        let near = self.heading.take().filter(|_| self.stays_near);
        let least = PARALLAX_PX / self.reduced.clamp(1, 2) as f64;
        let fresh = unscaled(&pair.forward, &pair.occluded, least, near)?;
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
                // The map is kept without the limit at 1, which would bias the next ratio.
                self.last = Some(depth.inverse_depth.map(|d| d * scale));
                scale_to_unit(&mut depth.inverse_depth, scale);
                Parallax::Known(depth)
            }
        };
        self.last = self.last.as_ref().map(|last| follow(last, &pair.backward, ahead));
        Ok(parallax)
    }
}

/// `map` as it is seen `ahead` frames later, if the motion of the given flow back by one frame continues; NaN for pixels that come
/// from outside the frame.
fn follow(map: &Plane, backward: &Flow, ahead: usize) -> Plane {
    let (w, h) = map.size();
    Plane::from_fn(w, h, |x, y| {
        let [u, v] = backward.at(x, y).map(|v| ahead as f32 * v);
        let (x, y) = ((x as f32 + u).round(), (y as f32 + v).round());
        let inside = x >= 0.0 && y >= 0.0 && x < w as f32 && y < h as f32;
        if inside { map.at(x as usize, y as usize) } else { f32::NAN }
    })
}

/// The median of `old` / `new` over the pixels that are known and not too far away in both maps; `None` if these are too few.
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

/// The 98th percentile of the known values; 1 if none is known.
fn largest(d: &Plane) -> f32 {
    let mut known: Vec<f32> = d.data().iter().copied().filter(|d| d.is_finite()).collect();
    if known.is_empty() { 1.0 } else { quantile(&mut known, 0.98).max(f32::MIN_POSITIVE) }
}

fn scale_to_unit(d: &mut Plane, scale: f32) {
    for d in d.data_mut() {
        *d = if d.is_nan() { f32::NAN } else { (*d * scale).clamp(0.0, 1.0) };
    }
}

/// The place halfway along a pixel's flow, in focal lengths from the centre, and the flow in focal lengths.
#[derive(Clone, Copy)]
struct Sample {
    x: f64,
    y: f64,
    u: f64,
    v: f64,
}

impl Sample {
    /// The sample of a pixel; `None` if the pixel is occluded or its flow is unknown.
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

    /// The flow `B Omega` of a turn.
    fn turn(&self, o: [f64; 3]) -> [f64; 2] {
        let [bx, by] = self.b();
        [dot(bx, o), dot(by, o)]
    }

    fn b(&self) -> [[f64; 3]; 2] {
        let (x, y) = (self.x, self.y);
        [[x * y, -(1.0 + x * x), y], [1.0 + y * y, -x * y, -x]]
    }

    /// The direction of `A T`, which is that of the epipolar line, and its length.
    fn epipolar(&self, t: [f64; 3]) -> ([f64; 2], f64) {
        let (x, y) = (self.x * t[2] - t[0], self.y * t[2] - t[1]);
        let length = (x * x + y * y).sqrt().max(1e-9);
        ([x / length, y / length], length)
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length(u: f64, v: f64) -> f64 {
    (u * u + v * v).sqrt()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    a.map(|v| v / dot(a, a).sqrt())
}

/// Weighted normal equations of three unknowns, two equations at once.
#[derive(Default)]
struct Normal {
    /// The sums of products of the unknowns' coefficients: 00, 01, 02, 11, 12, 22.
    products: [f64x2; 6],
    /// The sums of products of the coefficients with the right-hand side.
    right: [f64x2; 3],
}

impl Normal {
    /// Adds two equations with their weights.
    #[inline(always)]
    fn add(&mut self, [a, b, c]: [f64x2; 3], right: f64x2, weight: f64x2) {
        let (wa, wb, wc) = (weight * a, weight * b, weight * c);
        self.products[0] += wa * a;
        self.products[1] += wa * b;
        self.products[2] += wa * c;
        self.products[3] += wb * b;
        self.products[4] += wb * c;
        self.products[5] += wc * c;
        self.right[0] += wa * right;
        self.right[1] += wb * right;
        self.right[2] += wc * right;
    }

    fn solve(&self) -> [f64; 3] {
        let [aa, ab, ac, bb, bc, cc] = self.products.map(sum);
        let right = self.right.map(sum);
        let ridge = 1e-9 * (aa + bb + cc) + 1e-30;
        // The system is solved by Cramer's rule.
        let [a, b, c] = [[aa + ridge, ab, ac], [ab, bb + ridge, bc], [ac, bc, cc + ridge]];
        let det = dot(a, cross(b, c));
        [cross(b, c), cross(c, a), cross(a, b)].map(|row| dot(row, right) / det)
    }
}

fn sum(lanes: f64x2) -> f64 {
    let [a, b] = lanes.to_array();
    a + b
}

/// Geman & McClure's weight of two residuals at a scale; 1 at an infinite scale.
#[inline(always)]
fn weight(residual: f64x2, scale: f64) -> f64x2 {
    let q = residual / (2.0 * scale);
    let one = 1.0 + q * q;
    1.0 / (one * one)
}

/// A turn, and the robust std of the flow across the epipolar lines that the turn does not explain, in focal lengths.
#[derive(Clone, Copy)]
struct Turn {
    by: [f64; 3],
    std: f64,
}

/// Samples two by two, since the search for a direction looks at all of them for each direction.
struct Pairs {
    /// Two samples' x, y, u and v; the last pair may be one sample and one of zeros.
    pairs: Vec<[f64x2; 4]>,
    count: usize,
}

impl Pairs {
    fn of(samples: &[Sample]) -> Self {
        let zero = Sample { x: 0.0, y: 0.0, u: 0.0, v: 0.0 };
        let pair = |some: &[Sample]| {
            let (a, b) = (some[0], *some.get(1).unwrap_or(&zero));
            [[a.x, b.x], [a.y, b.y], [a.u, b.u], [a.v, b.v]].map(f64x2::from)
        };
        Self { pairs: samples.chunks(2).map(pair).collect(), count: samples.len() }
    }
}

/// The equations for the turn across the epipolar lines of one direction, two by two.
struct Across {
    /// Three coefficients and the right-hand side of each equation; the last pair may end with an equation of zeros, which has no effect.
    pairs: Vec<[f64x2; 4]>,
    count: usize,
}

impl Across {
    fn new(samples: &Pairs, t: [f64; 3]) -> Self {
        let of = |&[sx, sy, u, v]: &[f64x2; 4]| {
            let (x, y) = (sx * t[2] - t[0], sy * t[2] - t[1]);
            let length = (x * x + y * y).sqrt().max(f64x2::splat(1e-9));
            let (ex, ey) = (x / length, y / length);
            let (bx, by) = ([sx * sy, -(1.0 + sx * sx), sy], [1.0 + sy * sy, -sx * sy, -sx]);
            [ex * by[0] - ey * bx[0], ex * by[1] - ey * bx[1], ex * by[2] - ey * bx[2], ex * v - ey * u]
        };
        let mut pairs: Vec<[f64x2; 4]> = samples.pairs.iter().map(of).collect();
        if let (1, Some(last)) = (samples.count % 2, pairs.last_mut()) {
            *last = last.map(|v| v * f64x2::from([1.0, 0.0]));
        }
        Self { pairs, count: samples.count }
    }

    /// The residuals of the equations for a turn.
    fn residuals(&self, o: [f64; 3]) -> impl Iterator<Item = f64x2> + '_ {
        self.pairs.iter().map(move |&[a, b, c, right]| right - (a * o[0] + b * o[1] + c * o[2]))
    }

    /// The turn that fits best with the weights that the residuals of `turn` have at its std.
    fn reweighted(&self, turn: Turn) -> [f64; 3] {
        let mut normal = Normal::default();
        for (&[a, b, c, right], residual) in self.pairs.iter().zip(self.residuals(turn.by)) {
            normal.add([a, b, c], right, weight(residual, turn.std));
        }
        normal.solve()
    }

    /// The robust std of the residuals of a turn.
    fn std(&self, o: [f64; 3]) -> f64 {
        let mut lengths = Vec::with_capacity(2 * self.pairs.len());
        self.residuals(o).for_each(|r| lengths.extend_from_slice(&r.abs().to_array()));
        lengths.truncate(self.count);
        1.4826 * *quantile(&mut lengths, 0.5) + 1e-9
    }

    /// Geman & McClure's mean cost of the residuals of a turn, in [0, 1].
    fn cost(&self, turn: Turn) -> f64 {
        let mut sums = f64x2::ZERO;
        for residual in self.residuals(turn.by) {
            let q = residual / (2.0 * turn.std);
            sums += q * q / (1.0 + q * q);
        }
        sum(sums) / self.count as f64
    }
}

/// The turn that fits best across the epipolar lines of `t`, and its robust cost in [0, 1]. `near` gives the start and the scale of the
/// residuals; without it, all samples count alike at first, and the scale is estimated.
fn turn_for(samples: &Pairs, t: [f64; 3], near: Option<Turn>) -> (Turn, f64) {
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

/// The median length of the flow that is left after subtraction of the best turn, in focal lengths.
fn parallax_beside_turn(samples: &[Sample]) -> f64 {
    let mut turn = [0.0; 3];
    let mut median = f64::INFINITY;
    for _ in 0..10 {
        let mut normal = Normal::default();
        for s in samples {
            let [x, y] = s.turn(turn);
            let weight = weight(f64x2::splat(length(s.u - x, s.v - y)), median);
            let [bx, by] = s.b();
            normal.add(std::array::from_fn(|i| f64x2::from([bx[i], by[i]])), f64x2::from([s.u, s.v]), weight);
        }
        turn = normal.solve();
        let mut lengths: Vec<f64> = samples
            .iter()
            .map(|s| {
                let [x, y] = s.turn(turn);
                length(s.u - x, s.v - y)
            })
            .collect();
        median = *quantile(&mut lengths, 0.5) + 1e-9;
    }
    median
}

/// The motion of the camera between two frames.
#[derive(Clone, Copy)]
struct Motion {
    /// The direction of the translation, of length 1.
    translation: [f64; 3],
    turn: Turn,
}

impl Motion {
    /// The inverse depth of a sample, the motion along its epipolar line per unit of inverse depth, and the distance from the line.
    fn measure(&self, s: &Sample) -> [f64; 3] {
        let ([ex, ey], length) = s.epipolar(self.translation);
        let [bx, by] = s.turn(self.turn.by);
        let (u, v) = (s.u - bx, s.v - by);
        [(ex * u + ey * v) / length, length, ex * v - ey * u]
    }

    /// The motion with the sign of the translation for which most of `samples` lie in front of the camera.
    fn forward(self, samples: &[Sample]) -> Self {
        let ahead = samples.iter().filter(|s| self.measure(s)[0] > 0.0).count();
        let sign = if 2 * ahead < samples.len() { -1.0 } else { 1.0 };
        Self { translation: self.translation.map(|t| sign * t), ..self }
    }
}

/// The motion that explains `samples` best, searched over all directions, or near a given direction only.
fn searched(samples: &[Sample], near: Option<[f64; 3]>) -> Motion {
    let all = Pairs::of(samples);
    if let Some(near) = near {
        return refined(&all, near, [0.05, 0.002]);
    }
    // The directions form a spiral of even density over the hemisphere; T and -T differ only in the sign of d.
    let direction = |i: usize| {
        let (z, angle) = ((i as f64 + 0.5) / DIRECTIONS as f64, i as f64 * 2.399_963);
        let (r, (sin, cos)) = ((1.0 - z * z).sqrt(), libm::sincos(angle));
        [r * cos, r * sin, z]
    };
    let some = Pairs::of(&samples.iter().copied().step_by(2).collect::<Vec<Sample>>());
    let mut tried: Vec<(f64, [f64; 3])> =
        par::map(DIRECTIONS, |i| (turn_for(&some, direction(i), None).0.std, direction(i)));
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    // The best coarse direction may lead to a local minimum, so the next best ones that are not its neighbours are refined too.
    let mut starts: Vec<[f64; 3]> = Vec::new();
    for (_, t) in tried {
        if starts.len() < STARTS && starts.iter().all(|s| dot(*s, t).abs() < NEIGHBOURS) {
            starts.push(t);
        }
    }
    let found = starts.into_iter().map(|t| refined(&all, t, [0.1, 0.01]));
    let best = found.min_by(|a, b| a.turn.std.total_cmp(&b.turn.std));
    refined(&all, best.map_or([0.0, 0.0, 1.0], |motion| motion.translation), [0.05, 0.002])
}

/// The motion near a direction that explains `samples` best, found by steps from `coarsest` to `finest`, in radian.
fn refined(samples: &Pairs, mut t: [f64; 3], [coarsest, finest]: [f64; 2]) -> Motion {
    let mut turn = turn_for(samples, t, None).0;
    // The search runs twice, since the scale of the residuals falls with a better direction.
    for mut step in [coarsest, 4.0 * finest] {
        let mut cost = turn_for(samples, t, Some(turn)).1;
        for _ in 0..200 {
            if step < finest {
                break;
            }
            let e = unit(cross(t, if t[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] }));
            let n = cross(t, e);
            let around = par::map(8, |k| {
                let (sin, cos) = libm::sincos(std::f64::consts::FRAC_PI_4 * k as f64);
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

/// The camera's motion, and the disagreement of its inverse depths with those that parts of the picture find, each by itself: the
/// 90th percentile of the difference for the worst part, in units of the largest inverse depth.
fn camera_motion(
    samples: &[(usize, usize, Sample)],
    (w, h): (usize, usize),
    near: Option<[f64; 3]>,
) -> (Motion, f64) {
    // The parts interleave like the fields of a checkerboard: each spans the whole picture, but has flow errors of its own.
    let part = |k: usize| -> Vec<Sample> {
        let field = |x: usize, y: usize| (6 * x / w) % 2 + 2 * ((6 * y / h) % 2);
        samples.iter().filter(|(x, y, _)| field(*x, *y) == k).map(|s| s.2).collect()
    };
    let all: Vec<Sample> = samples.iter().map(|s| s.2).collect();
    let depths = |motion: &Motion| all.iter().map(|s| motion.measure(s)[0]).collect::<Vec<f64>>();
    let parts: Vec<Vec<Sample>> =
        (0..PARTS).map(part).filter(|part| part.len() >= FEWEST_SAMPLES / PARTS).collect();
    let found = par::map(parts.len(), |i| searched(&parts[i], near));
    let pairs = Pairs::of(&all);
    let std = |motion: &Motion| turn_for(&pairs, motion.translation, None).0.std;
    let best = found.iter().map(|m| (std(m), m.translation)).min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, start)) = best else { return (searched(&all, near), f64::INFINITY) };
    // The direction that a part found is near the best one already.
    let motion = refined(&pairs, start, [0.02, 2e-4]).forward(&all);
    let d = depths(&motion);
    let largest = *quantile(&mut d.clone(), 0.98);
    let disagreement = |other: Motion| {
        let other = depths(&other.forward(&all));
        // Each motion has its own scale of inverse depth.
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

/// Inverse depth in units of the camera's motion, whose direction may be searched only `near` a given one, or the reason why the depth
/// is unknown. `least`: the smallest median parallax that is relied on, px.
fn unscaled(
    flow: &Flow,
    occluded: &Raster<bool>,
    least: f64,
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
    Ok(par::within(|| depth_of(flow, occluded, least, near)))
}

// The function is long, since it is a list of conditions, each with the reason why the depth is unknown if the condition fails.
fn depth_of(
    flow: &Flow,
    occluded: &Raster<bool>,
    least: f64,
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
    let still = share(&|s| f * length(s.u, s.v) < STILL_PX);
    if still > 0.9 {
        return Err(Unknown::new(
            Reason::NoMotion,
            "less than a tenth of the picture moves between the frames",
        ));
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
    if parallax < least {
        return Err(Unknown::new(
            Reason::NoMotion,
            format!("the camera hardly does more than turn: {parallax:.2} px of parallax between the frames"),
        ));
    }
    let (motion, uncertainty) = camera_motion(&samples, (w, h), near);
    let residual = f * motion.turn.std;
    let [least, most] = [OUTLIER_PX[0], OUTLIER_PX[1] * (w as f64 / 500.0).max(1.0)];
    let limit = (OUTLIER * f * motion.turn.std).min(most).max(least) / f;
    // A pixel whose inverse depth is negative by more than the noise moves by itself too.
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
    // The depth is unknown too if the uncertainty is not a number.
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
        // Near the point that the camera heads for, the noise of the flow is more than a tenth of the range of d.
        if !agrees(m) || motion.turn.std > 0.1 * nearest * length {
            return f32::NAN;
        }
        // The depth halfway between the frames is converted to that at this frame, when the camera was half a step farther behind.
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
