//! Motion that changes much from one frame to the next, as under a shaking hand.
//!
//! The streaks that a frame shows are as long and have the direction of the motion while the shutter is open. Flow tells where things are
//! at the frames' times, so where speed and direction swing within a few frames, the motion at a frame's own time is known badly: a hand
//! that shakes by 50 % of its speed and half a radian with a period of three frames leaves errors of a third. A spline through the places
//! of what is seen over several frames halves the speed's error ([`speed_factor`]), and the direction the frame itself tells, since the
//! zeros of its spectrum lie across it ([`turn`]). What is left of the speed's error widens what the frame says of the exposure
//! ([`over_speeds`]).

use super::likelihood::{CLIP, EXPOSURE_STEP, EXPOSURES, LAMBDA_STEPS, Prepared, interpolate, lambda_step};
use super::noise::LumaNoise;
use super::robust::median;
use super::tiles::{MotionOf, SPEEDS, TILE, corners, turned, turned_tiles};
use crate::model::Space;
use crate::portable::Portable;
use crate::{Encoded, Flow, par};
use std::collections::VecDeque;
use std::ops::Range;

/// The change of motion from one frame interval to the next, as a share of the speed, up to which motion counts as even. Own scenes and
/// steady cameras have less.
const EVEN: f32 = 0.2;

/// The number of frames that are looked at, before and after a frame, whose uneven motion makes the motion of that frame count as uneven.
pub(super) const NEAR: usize = 2;

/// How the speed at a frame's own time is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SpeedBy {
    /// By a spline through several frames ([`speed_factor`]).
    Spline,
    /// By the mean of the two flows around the frame.
    Mean,
    /// By one flow, as at the ends of a shot.
    OneFlow,
}

impl SpeedBy {
    /// The relative std of the speed over the change of motion.
    fn error(self) -> f32 {
        match self {
            Self::Spline => 0.22,
            Self::Mean => 0.42,
            Self::OneFlow => 0.5,
        }
    }
}

/// The number of frames before and after a frame through which the spline of [`speed_factor`] goes.
pub(super) const SPLINE_REACH: usize = 3;

/// The range of [`speed_factor`].
const SPEED_FACTORS: Range<f32> = 0.5..2.0;

/// The angles, in radians, by which the motion of an uneven frame may be turned from what the flow says.
const ANGLES: [f32; 9] = [0.0, -0.15, 0.15, -0.3, 0.3, -0.45, 0.45, -0.6, 0.6];

/// The change of the motion from one frame interval to the next over the mean speed of both: the median over the pixels whose motion is
/// known in both. `to_next` is the flow to the next frame, `motion` that at the frame's own time, of a frame of w x h px.
pub(super) fn change_of(size: (usize, usize), to_next: &MotionOf, motion: &MotionOf) -> Option<f32> {
    median_on_grid(size, |x, y| {
        let (next, mean) = (to_next(x, y), motion(x, y));
        let half = (next[0] - mean[0]).portable_hypot(next[1] - mean[1]);
        let speed = mean[0].portable_hypot(mean[1]);
        // Where only one of both is known, it stands for the mean.
        (half > 0.0 && speed >= SPEEDS.start).then_some(2.0 * half / speed)
    })
}

/// The speed to the next frame over the speed from the frame before: the median over the pixels that move; `None` if too few do.
pub(super) fn speed_ratio(to_next: &Flow, before: &Flow) -> Option<f32> {
    median_on_grid(to_next.size(), |x, y| {
        let [next, before] = [to_next, before].map(|flow| flow.at(x, y)).map(|[u, v]| u.portable_hypot(v));
        (before >= SPEEDS.start && next.is_finite()).then_some(next / before)
    })
}

/// The length of the difference of two motions, px per frame interval: the median over the pixels that move; `None` if too few do.
pub(super) fn median_difference(size: (usize, usize), a: &MotionOf, b: &MotionOf) -> Option<f32> {
    median_on_grid(size, |x, y| {
        let (a, b) = (a(x, y), b(x, y));
        let moves = [a, b].iter().any(|v| v[0].portable_hypot(v[1]) >= SPEEDS.start);
        let difference = (a[0] - b[0]).portable_hypot(a[1] - b[1]);
        (moves && difference.is_finite()).then_some(difference)
    })
}

/// The median, over a coarse grid of a frame's pixels, of what `of` gives; `None` if it gives too few values.
fn median_on_grid((w, h): (usize, usize), of: impl Fn(usize, usize) -> Option<f32>) -> Option<f32> {
    const STEP: usize = 8;
    let places = (0..h).step_by(STEP).flat_map(|y| (0..w).step_by(STEP).map(move |x| (x, y)));
    let values: Vec<f32> = places.filter_map(|(x, y)| of(x, y)).collect();
    if values.len() < 2 * TILE / STEP { None } else { median(values) }
}

/// Whether a motion that changes by the share `change` is even.
pub(super) fn is_even(change: f32) -> bool {
    change <= EVEN
}

/// The relative std of the speed at a frame's own time if the motion changes by the share `change`; 0 if the motion is even.
pub(super) fn speed_error(change: f32, by: SpeedBy) -> f32 {
    if is_even(change) { 0.0 } else { by.error() * change }
}

/// The flow from a frame to the next at the places of a coarse grid.
#[derive(Clone, Debug)]
pub(super) struct SampledFlow {
    flow: Flow,
    /// The distance between the places, px.
    step: usize,
}

impl SampledFlow {
    pub(super) fn new(flow: &Flow) -> Self {
        Self::of(flow.size(), &|x, y| flow.at(x, y))
    }

    /// The same of a motion of a frame of w x h px.
    fn of((w, h): (usize, usize), motion: &MotionOf) -> Self {
        /// The least distance between the places, px, and the most of them in a row.
        const STEP: usize = 8;
        const MOST: usize = 96;
        let step = STEP.max(w.div_ceil(MOST));
        let at =
            |x: usize, y: usize| motion((x * step + step / 2).min(w - 1), (y * step + step / 2).min(h - 1));
        Self { flow: Flow::from_fn(w.div_ceil(step), h.div_ceil(step), at), step }
    }

    /// The flow at the nearest place of the grid; `None` outside the frame and where the flow is unknown.
    fn at(&self, [x, y]: [f32; 2]) -> Option<[f32; 2]> {
        let (w, h) = self.flow.size();
        let [x, y] = [x, y].map(|v| v / self.step as f32);
        let inside = x >= 0.0 && y >= 0.0 && x < w as f32 && y < h as f32;
        let flow = inside.then(|| self.flow.at(x as usize, y as usize))?;
        (flow[0].is_finite() && flow[1].is_finite()).then_some(flow)
    }

    /// The flow that ends at a place of the next frame.
    fn towards(&self, place: [f32; 2]) -> Option<[f32; 2]> {
        let from = |way: [f32; 2]| [place[0] - way[0], place[1] - way[1]];
        self.at(from(self.at(place)?)).and_then(|guess| self.at(from(guess)))
    }
}

/// The typical motion of what moves in a frame of this size, in the motion's unit: the median, component by component, at the places of a grid
/// that move fast enough to leave streaks, or of all if hardly any does; `None` if the motion is known nowhere.
pub(super) fn typical_motion(size: (usize, usize), motion: &MotionOf) -> Option<[f32; 2]> {
    let SampledFlow { flow, step } = SampledFlow::of(size, motion);
    let known = flow.data().iter().copied().filter(|v| v[0].is_finite() && v[1].is_finite());
    let known: Vec<[f32; 2]> = known.collect();
    let moving: Vec<[f32; 2]> =
        known.iter().copied().filter(|v| v[0].portable_hypot(v[1]) >= SPEEDS.start).collect();
    let ways = if moving.len() < 2 * TILE / step { known } else { moving };
    let [x, y] = [0, 1].map(|c| median(ways.iter().map(|v| v[c]).collect()));
    Some([x?, y?])
}

/// The speed at a frame's own time over that of the mean of the flows around it, or of the one flow at the ends of a shot: the median over
/// the places of a grid. `before` are the flows that lead to the frame, the last first, each from one frame to the next, and `after` those
/// that lead away from it, the next first. What is seen at a place of the frame is followed along them, and the speed is that of a natural
/// cubic spline through its places. 1 where too little moves to tell.
pub(super) fn speed_factor(before: &[&SampledFlow], after: &[&SampledFlow]) -> f32 {
    let Some(&SampledFlow { ref flow, step }) = after.first().or(before.first()).copied() else { return 1.0 };
    let (w, h) = flow.size();
    let factors = (0..w * h).filter_map(|i| {
        let start = [i % w, i / w].map(|v| (v as f32 + 0.5) * step as f32);
        let mut steps = vec![];
        let mut at = start;
        for flow in before.iter().take(SPLINE_REACH) {
            let Some(way) = flow.towards(at) else { break };
            steps.insert(0, way);
            at = [at[0] - way[0], at[1] - way[1]];
        }
        let own = steps.len();
        at = start;
        for flow in after.iter().take(SPLINE_REACH) {
            let Some(way) = flow.at(at) else { break };
            steps.push(way);
            at = [at[0] + way[0], at[1] + way[1]];
        }
        let around = &steps[own.saturating_sub(1)..(own + 1).min(steps.len())];
        let length = |v: [f32; 2]| v[0].portable_hypot(v[1]);
        let mean = |c: usize| around.iter().map(|v| v[c]).sum::<f32>() / around.len() as f32;
        let speed = if around.is_empty() { 0.0 } else { length([mean(0), mean(1)]) };
        (speed >= SPEEDS.start).then(|| length(spline_slope(&steps, own)) / speed)
    });
    let factors: Vec<f32> = factors.collect();
    let told = factors.len() >= 2 * TILE / step;
    let factor = if told { median(factors) } else { None };
    factor.map_or(1.0, |f| f.clamp(SPEED_FACTORS.start, SPEED_FACTORS.end))
}

/// The slope, at point `at`, of the natural cubic spline through points at even times, of which `steps` are the differences.
fn spline_slope(steps: &[[f32; 2]], at: usize) -> [f32; 2] {
    // The slopes s of the points satisfy s[i-1] + 4 s[i] + s[i+1] = 3 (steps[i-1] + steps[i]), and at the ends 2 s[0] + s[1] = 3 steps[0]
    // (de Boor, A Practical Guide to Splines). Each is eliminated on the way from its end to `at`.
    let eliminated = |steps: &mut dyn Iterator<Item = [f32; 2]>| {
        let (mut diagonal, mut right, mut last) = (0.0f32, [0.0f32; 2], None::<[f32; 2]>);
        for step in steps {
            (diagonal, right) = match last {
                None => (2.0, step.map(|v| 3.0 * v)),
                Some(last) => {
                    let of = |c: usize| 3.0 * (last[c] + step[c]) - right[c] / diagonal;
                    (4.0 - 1.0 / diagonal, [of(0), of(1)])
                }
            };
            last = Some(step);
        }
        (diagonal, right, last)
    };
    let (d0, r0, last) = eliminated(&mut steps[..at].iter().copied());
    let (d1, r1, next) = eliminated(&mut steps[at..].iter().rev().copied());
    let part = |d: f32, r: [f32; 2]| if d > 0.0 { (1.0 / d, r.map(|v| v / d)) } else { (0.0, [0.0; 2]) };
    let ((w0, p0), (w1, p1)) = (part(d0, r0), part(d1, r1));
    let beside = || last.iter().chain(&next);
    let own = 2.0 * beside().count() as f32;
    [0, 1].map(|c| (3.0 * beside().map(|v| v[c]).sum::<f32>() - p0[c] - p1[c]) / (own - w0 - w1))
}

/// The std, in radians, of the direction at a frame's own time, over the change of motion.
const DIRECTION_ERROR: f32 = 0.4;

/// The number of nats of the sum over the tiles of a frame that count as one, since the tiles err alike.
const ALIKE: f32 = 40.0;

/// The corners of every second tile of a frame of this size, as on a checkerboard: tiles overlap by half, so the others tell hardly more.
/// Of large frames some of these, evenly spaced.
pub(super) fn every_second_corner(size: (usize, usize)) -> Vec<(usize, usize)> {
    /// The most tiles, as many as a frame of 512 x 384 px has.
    const MOST: usize = 160;
    let mut corners = corners(size);
    corners.retain(|(x, y)| (x + y) % TILE == 0);
    let step = corners.len().div_ceil(MOST).max(1);
    corners.into_iter().step_by(step).collect()
}

/// The likeliest angle, in radians, between the motion while the shutter was open and `motion`, by the direction and the length of the
/// streaks in the tiles at these [`corners`]. `change` is the share by which the motion changes.
pub(super) fn turn(
    frame: &Encoded,
    corners: &[(usize, usize)],
    motion: &MotionOf,
    change: f32,
    noise: &LumaNoise,
    space: Space,
) -> f32 {
    let tiles = turned_tiles(frame, corners, motion, &ANGLES, space);
    // A table for each tile: its log-likelihood in nats over the angle and over the length of the streaks.
    const LENGTHS: usize = 32;
    let tables = par::map(tiles.len(), |i| {
        let turned = tiles[i].iter().map(|tile| {
            let step = lambda_step(tile.speed, LAMBDA_STEPS);
            let table = Prepared::new(tile, 0, 0, noise, noise.coding_error)?.absolute_over_lambda(step);
            let at = |l: usize| l as f32 / (LENGTHS - 1) as f32 * (table.len() - 1) as f32;
            Some((0..LENGTHS).map(|l| interpolate(&table, at(l))).collect::<Vec<f32>>())
        });
        turned.collect::<Option<Vec<Vec<f32>>>>()
    });
    let mut sums = vec![[0.0f32; LENGTHS]; ANGLES.len()];
    for table in tables.iter().flatten() {
        let most = table.iter().flatten().copied().fold(f32::MIN, f32::max);
        for (sum, of) in sums.iter_mut().zip(table) {
            sum.iter_mut().zip(of).for_each(|(s, v)| *s += (v - most).max(-CLIP));
        }
    }
    let posterior = |i: usize| {
        let most = sums[i].iter().copied().fold(f32::MIN, f32::max);
        most - 0.5 * ALIKE * (ANGLES[i] / (DIRECTION_ERROR * change)).powi(2)
    };
    let best = (0..ANGLES.len()).max_by(|&a, &b| posterior(a).total_cmp(&posterior(b))).unwrap_or(0);
    ANGLES[best]
}

/// A motion turned by an angle in radians.
pub(super) fn turned_by(motion: &Flow, angle: f32) -> Flow {
    motion.map(|v| turned(v, angle))
}

/// What follows from uneven motion for one frame: the motion while the shutter was open is the mean of the flows around it, turned and
/// made longer or shorter, and its speed is still uncertain.
#[derive(Clone, Copy, Debug)]
pub(super) struct Correction {
    /// The angle, in radians.
    pub angle: f32,
    /// The factor of the speed.
    pub factor: f32,
    /// The relative std of the speed after that; 0 where motion is even.
    pub error: f32,
    /// Whether motion was even until the frame before.
    pub begins: bool,
}

impl Correction {
    /// Motion is even.
    pub const NONE: Self = Self { angle: 0.0, factor: 1.0, error: 0.0, begins: false };

    /// The corrected motion.
    pub fn of(&self, motion: [f32; 2]) -> [f32; 2] {
        if self.error > 0.0 { turned(motion, self.angle).map(|v| self.factor * v) } else { motion }
    }
}

/// The motion of the last frames of a shot, from which that of the present one is corrected before the next ones are known.
#[derive(Default)]
pub(super) struct Swings {
    /// The flows of the last frames, each to the next, the last first.
    flows: VecDeque<SampledFlow>,
    /// The [`change_of`] the motion of the last frames, where it is known, the last first.
    changes: VecDeque<Option<f32>>,
}

impl Swings {
    /// Begins anew, since the next frame belongs to another shot, or the motion to it is not known.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Whether the motion of the last frames is known, and is even.
    pub fn is_even(&self) -> bool {
        !self.flows.is_empty() && is_even(self.change())
    }

    /// The largest change of the last frames' motion; 0 if none is known.
    fn change(&self) -> f32 {
        self.changes.iter().flatten().copied().fold(0.0, f32::max)
    }

    /// The correction of the motion of the next frame, without its angle, and the change of the motion; `to_next` is the flow from the
    /// frame to the one after it, `None` at the end, and `motion` that at the frame's own time.
    pub fn next(&mut self, to_next: Option<&Flow>, motion: &MotionOf) -> (Correction, f32) {
        let before = self.change();
        let Some(to_next) = to_next else {
            self.forget();
            return (Correction { error: speed_error(before, SpeedBy::OneFlow), ..Correction::NONE }, before);
        };
        let first = self.flows.is_empty();
        let own = if first { None } else { change_of(to_next.size(), &|x, y| to_next.at(x, y), motion) };
        self.changes.push_front(own);
        self.changes.truncate(NEAR + 1);
        let change = self.change();
        let error = speed_error(change, if first { SpeedBy::OneFlow } else { SpeedBy::Spline });
        let sampled = SampledFlow::new(to_next);
        let flows: Vec<&SampledFlow> = self.flows.iter().collect();
        let factor = if error > 0.0 { speed_factor(&flows, &[&sampled]) } else { 1.0 };
        self.flows.push_front(sampled);
        self.flows.truncate(SPLINE_REACH);
        (Correction { factor, error, begins: error > 0.0 && is_even(before), ..Correction::NONE }, change)
    }
}

/// The log-likelihood over the exposure of all tiles of a frame, in nats, if their speeds are off by a common factor with the relative std
/// `error`.
pub(super) fn over_speeds(curve: &[f32], error: f32) -> Vec<f32> {
    if error <= 0.0 {
        return curve.to_vec();
    }
    let most = curve.iter().copied().fold(f32::MIN, f32::max);
    let likelihood: Vec<f32> = curve.iter().map(|v| (v - most).portable_exp()).collect();
    // A closed shutter leaves no streak at any speed.
    let narrowest = 0.5 * EXPOSURE_STEP;
    let at = |i: usize| {
        let exposure = i as f32 * EXPOSURE_STEP;
        let std = (error * exposure).max(narrowest);
        let (mut sum, mut total) = (0.0, 0.0);
        let reach = (4.0 * std / EXPOSURE_STEP) as usize + 1;
        let first = i.saturating_sub(reach);
        for (j, near) in (first..).zip(&likelihood[first..(i + reach + 1).min(EXPOSURES)]) {
            let w = (-0.5 * ((j as f32 - i as f32) * EXPOSURE_STEP / std).powi(2)).portable_exp();
            sum += w * near;
            total += w;
        }
        most + (sum / total).max(f32::MIN_POSITIVE).portable_ln()
    };
    (0..EXPOSURES).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::super::likelihood::index_of_exposure;
    use super::*;
    use crate::analysis::flow::motion_at_frame;
    use crate::fit::noise::tests::white;
    use crate::synth::motion_blur::motion_blur;
    use crate::{Raster, filter, model::ExposureFraction};

    #[test]
    fn motion_that_swings_changes_and_motion_that_goes_on_does_not() {
        let flow = |u: f32, v: f32| Flow::filled(128, 96, [u, v]);
        let change = |next: [f32; 2], last: [f32; 2]| {
            let next = flow(next[0], next[1]);
            let motion = motion_at_frame(&next, &flow(last[0], last[1]));
            change_of(next.size(), &|x, y| next.at(x, y), &|x, y| motion.at(x, y))
        };
        let swings = change([6.0, 2.0], [6.0, -2.0]).expect("it moves");
        assert!((swings - 4.0 / 6.0).abs() < 1e-3 && speed_error(swings, SpeedBy::Spline) > 0.1, "{swings}");
        let by = [SpeedBy::Spline, SpeedBy::Mean, SpeedBy::OneFlow].map(|by| speed_error(swings, by));
        assert!(by[0] < by[1] && by[1] < by[2], "{by:?}");
        let goes_on = change([6.3, 0.0], [5.7, 0.0]).expect("it moves");
        assert!((goes_on - 0.1).abs() < 1e-3 && speed_error(goes_on, SpeedBy::OneFlow) == 0.0, "{goes_on}");
        // What hardly moves shows no streaks, however it swings.
        assert_eq!(change([0.6, 0.0], [0.2, 0.0]), None);
    }

    #[test]
    fn a_spline_tells_the_speed_of_a_swing_that_the_mean_of_two_flows_does_not() {
        // Places along a swing with a period of four frames: at its middle the speed is pi / 2 of its amplitude.
        let place = |t: f32| 3.0 * (std::f32::consts::FRAC_PI_2 * t).sin();
        let steps = |frames: Range<i32>| -> Vec<[f32; 2]> {
            frames.map(|t| [place((t + 1) as f32) - place(t as f32), 2.0]).collect()
        };
        let truth = 3.0 * std::f32::consts::FRAC_PI_2;
        let [u, v] = spline_slope(&steps(-3..3), 3);
        assert!((u / truth - 1.0).abs() < 0.06 && (v - 2.0).abs() < 1e-5, "{u} {v}");
        let mean = 0.5 * (place(1.0) - place(-1.0));
        assert!((mean / truth - 1.0).abs() > 0.3, "{mean}");
        // With one frame on one side it is nearer than the mean too; without any, it is at an end.
        let [u, _] = spline_slope(&steps(-3..1), 3);
        assert!((u / truth - 1.0).abs() < 0.25, "{u}");
        assert_eq!(spline_slope(&[[5.0, -1.0]], 0), [5.0, -1.0]);
        assert_eq!(spline_slope(&[[5.0, -1.0]], 1), [5.0, -1.0]);
        // An even motion is a line.
        let even = [[4.0f32, 1.0]; 5];
        assert!((0..=5).all(|i| (spline_slope(&even, i)[0] - 4.0).abs() < 1e-5));
    }

    #[test]
    fn speeds_are_corrected_by_what_is_followed_over_several_frames() {
        let place = |t: f32| 6.0 * t + 3.0 * (std::f32::consts::FRAC_PI_2 * t).sin();
        let step = |t: i32| place((t + 1) as f32) - place(t as f32);
        let camera: Vec<SampledFlow> =
            (-3..3).map(|t| SampledFlow::new(&Flow::filled(160, 120, [step(t), 0.0]))).collect();
        let factor = |flows: &[SampledFlow], at: usize| {
            let before: Vec<&SampledFlow> = flows[..at].iter().rev().collect();
            speed_factor(&before, &flows[at..].iter().collect::<Vec<_>>())
        };
        let (truth, mean) = (6.0 + 3.0 * std::f32::consts::FRAC_PI_2, 0.5 * (place(1.0) - place(-1.0)));
        let found = factor(&camera, 3) * mean;
        assert!((found / truth - 1.0).abs() < 0.03 && (mean / truth - 1.0).abs() > 0.1, "{found} {mean}");
        // A thing that moves evenly before a background that stands still keeps its speed, though it covers other places in each frame.
        let thing: Vec<SampledFlow> =
            (-3..3)
                .map(|t| {
                    let left = 60 + 8 * t;
                    let moves =
                        |x: usize, y: usize| (left..left + 64).contains(&(x as i32)) && (30..90).contains(&y);
                    SampledFlow::new(&Flow::from_fn(160, 120, |x, y| {
                        if moves(x, y) { [8.0, 0.0] } else { [0.0; 2] }
                    }))
                })
                .collect();
        assert!((factor(&thing, 3) - 1.0).abs() < 1e-3, "{}", factor(&thing, 3));
        // Nothing is known where nothing moves, nothing is seen, or no flow is there.
        let still = SampledFlow::new(&Flow::filled(160, 120, [0.1, 0.0]));
        let unknown = SampledFlow::new(&Flow::filled(160, 120, [f32::NAN; 2]));
        assert_eq!([factor(&[still], 1), factor(&[unknown], 0), factor(&[], 0)], [1.0; 3]);
    }

    #[test]
    fn a_speed_that_may_be_off_widens_what_a_frame_says() {
        let curve: Vec<f32> =
            (0..EXPOSURES).map(|i| -2e4 * (i as f32 * EXPOSURE_STEP - 0.5).powi(2)).collect();
        let at = |curve: &[f32], exposure: f32| curve[index_of_exposure(exposure)];
        let wide = over_speeds(&curve, 0.2);
        let best = (0..EXPOSURES).max_by(|&a, &b| wide[a].total_cmp(&wide[b])).unwrap();
        assert!((best as f32 * EXPOSURE_STEP - 0.5).abs() < 0.04, "{best}");
        // A std of 0.2 times 0.6 makes 0.1 less likely by hardly anything; speeds that are known, by 200 nats.
        let fall = |curve: &[f32]| at(curve, 0.5) - at(curve, 0.6);
        assert!(fall(&wide) < 0.7 && fall(&over_speeds(&curve, 0.0)) > 199.0, "{}", fall(&wide));
        assert!(wide.iter().all(|v| v.is_finite()));
    }

    #[test]
    fn the_streaks_tell_the_direction_of_the_motion() {
        // A texture with the slope of a photograph's spectrum, blurred by a streak of 9 px.
        let (w, h) = (288, 240);
        let noise = white(w, h, 3).map(|n| n[1]);
        let octaves: Vec<_> = [1.0, 2.0, 4.0, 8.0].map(|s| filter::gaussian_blur(&noise, s)).into();
        let texture = Raster::from_fn(w, h, |x, y| {
            let sum: f32 = octaves.iter().zip([1.0, 2.0, 4.0, 8.0]).map(|(o, s)| s * o.at(x, y)).sum();
            [0.4 + 0.1 * sum; 3]
        });
        let motion = |angle: f32| Flow::filled(w, h, turned([9.0, 0.0], angle));
        let blurred = motion_blur(&texture, &motion(0.3), ExposureFraction(1.0)).unwrap();
        let noise = LumaNoise::default();
        let found = |frame: &Encoded| {
            let (corners, motion) = (every_second_corner((w, h)), motion(0.0));
            let space = crate::model::BlurSpace::Encoded.into();
            turn(frame, &corners, &|x, y| motion.at(x, y), 0.8, &noise, space)
        };
        let angle = found(&Encoded(blurred));
        assert!((angle - 0.3).abs() < 0.01, "{angle}");
        let angle = found(&Encoded(motion_blur(&texture, &motion(0.0), ExposureFraction(1.0)).unwrap()));
        assert!(angle.abs() < 0.01, "{angle}");
    }
}
