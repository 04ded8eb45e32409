//! Motion and depth in a frame, found with its neighbour, for both [`super::Estimator`] and [`super::track::Tracker`].
//!
//! The estimator looks at whole frames, and detects a cut before it follows them. The tracker looks at reduced frames, with parallax in
//! every third frame, near the camera's last direction, and with a scale of depth that it drops as soon as too little is found again;
//! the parameters of [`Follower::follow`] make these differences.

use super::observation::FrameObservation;
use crate::analysis::active_area::ActiveArea;
use crate::analysis::cuts::MIN_CONFIRMED;
use crate::analysis::depth::{Parallax, ParallaxTracker, inverse_depth_from_flow};
use crate::analysis::flow::{FlowEstimator, FlowPair};
use crate::model::Unknown;
use crate::{Encoded, Error, Flow, Pixel, Plane, Raster, Result, par, pyramid};

/// Finds flow between frames, and depth from its parallax. Both are found in frames of reduced size, and are then enlarged.
pub(super) struct Follower {
    flow: FlowEstimator,
    parallax: ParallaxTracker,
    near_the_last: bool,
    /// The width, px, to which frames are halved.
    width: usize,
}

/// The flow and the depth that were found between a frame and its neighbour.
pub(super) struct Followed {
    /// Optical flow to the neighbour, px of the frame, NaN where the backward flow contradicts it; `None` if too little of the frame is
    /// found again.
    pub flow: Option<Flow>,
    /// The share of the frame that is found again, in [0, 1].
    pub confirmed: f32,
    /// The depth by parallax, if parallax was looked for.
    pub parallax: Option<Parallax>,
}

/// The conditions under which parallax is looked for.
#[derive(Clone, Copy)]
pub(super) struct WantsParallax {
    /// The least share of the frame that must be found again, in [0, 1].
    pub confirmed: f32,
    /// The number of frames until parallax is looked for again.
    pub stride: usize,
}

impl Follower {
    /// A follower that has seen nothing; `near_the_last`: whether the camera's direction is searched near the last direction only; `width`:
    /// the width, px, to which frames are halved.
    pub fn new(width: usize, near_the_last: bool) -> Self {
        let mut new =
            Self { flow: FlowEstimator::new(), parallax: ParallaxTracker::new(), near_the_last, width };
        new.forget_scale();
        new
    }

    /// Forgets the scale of relative depth, so that later depth is in another unit.
    pub fn forget_scale(&mut self) {
        let new = ParallaxTracker::new();
        self.parallax = if self.near_the_last { new.near_the_last() } else { new };
    }

    /// Follows a frame to its neighbour. `spare` is a flow whose buffer may be reused.
    pub fn follow(
        &mut self,
        frame: &Encoded,
        other: &Encoded,
        wants: Option<WantsParallax>,
        spare: Flow,
    ) -> Result<Followed> {
        let size = frame.0.size();
        let small = |image: &Encoded| pyramid::halved_luma(&image.0, |w, _| w > self.width);
        let (from, to) = (small(frame), small(other));
        let mut pair = self.flow.flow_with_occlusion(&from, &to)?;
        let active = [frame, other].map(ActiveArea::of);
        let confirmed = leave_bars_out(&mut pair, &active, size);
        // The tracker, which searches near the last direction, keeps to the limit of whole px: it reduces its frames far more.
        if !self.near_the_last {
            self.parallax.of_reduced(factor_of(pair.forward.width(), size));
        }
        let mut parallax = match wants.filter(|w| confirmed >= w.confirmed) {
            Some(WantsParallax { stride, .. }) => Some(self.parallax.push(&pair, stride)?),
            None => None,
        };
        if let Some(Parallax::Known(depth)) = &mut parallax
            && depth.inverse_depth.size() != size
        {
            depth.inverse_depth = repeated(&depth.inverse_depth, size);
        }
        let flow = (confirmed >= MIN_CONFIRMED).then(|| enlarged(known_flow(&pair, &from, &to), size, spare));
        Ok(Followed { flow, confirmed, parallax })
    }
}

/// Counts as occluded what lies, or goes, outside the active areas of two frames of this size, whose halved frames have this flow. Gives the
/// share of the first active area whose match is confirmed, in [0, 1].
fn leave_bars_out(pair: &mut FlowPair, active: &[ActiveArea; 2], size: (usize, usize)) -> f32 {
    if active.iter().all(|area| area.is_all_of(size)) {
        return pair.confirmed();
    }
    let factor = factor_of(pair.forward.width(), size);
    let holds = |area: &ActiveArea, x: usize, y: usize| area.holds((factor * x, factor * y), factor);
    let (mut inside, mut confirmed) = (0, 0);
    for y in 0..pair.forward.height() {
        for x in 0..pair.forward.width() {
            let [u, v] = pair.forward.at(x, y);
            let (tx, ty) = ((x as f32 + u).round(), (y as f32 + v).round());
            let occluded = &mut pair.occluded.row_mut(y)[x];
            let stays = holds(&active[0], x, y);
            // A negative place, which counts as 0, is occluded already.
            *occluded |= !stays || !holds(&active[1], tx as usize, ty as usize);
            inside += usize::from(stays);
            confirmed += usize::from(!*occluded);
        }
    }
    confirmed as f32 / inside.max(1) as f32
}

/// The depth by parallax of a frame whose flow was given.
pub(super) fn parallax_of(flow: &Flow) -> Result<Parallax> {
    let unknown = flow.map(|f| !f[0].is_finite());
    inverse_depth_from_flow(flow, &unknown)
}

/// The side of the squares, px, of which is told whether they stand still.
const STILL_SIDE: usize = 12;

/// A square stands still if the sum of squares by which it differs from the same place of the other frame is less than this share of that
/// by which it differs from where the flow leads.
const STILL: f32 = 0.5;

/// The forward flow, NaN where the backward flow does not confirm it, and 0 where the picture stands still: flow is smooth, so what moves
/// takes what is beside it along.
pub(super) fn known_flow(pair: &FlowPair, from: &Plane, to: &Plane) -> Flow {
    let (w, h) = pair.forward.size();
    let still = Raster::from_fn(w.div_ceil(STILL_SIDE), h.div_ceil(STILL_SIDE), |i, j| {
        let (x0, y0) = (i * STILL_SIDE, j * STILL_SIDE);
        let (mut moved, mut stayed, mut ways) = (0.0, 0.0, 0.0);
        for (x, y) in
            (y0..(y0 + STILL_SIDE).min(h)).flat_map(|y| (x0..(x0 + STILL_SIDE).min(w)).map(move |x| (x, y)))
        {
            let ([u, v], residual) = (pair.forward.at(x, y), pair.residual.at(x, y));
            if residual.is_finite() {
                moved += residual * residual;
                stayed += (to.at(x, y) - from.at(x, y)).powi(2);
                ways += u * u + v * v;
            }
        }
        ways >= (STILL_SIDE * STILL_SIDE) as f32 && stayed < STILL * moved
    });
    Flow::from_fn(w, h, |x, y| match pair.occluded.at(x, y) {
        true => [f32::NAN; 2],
        false if still.at(x / STILL_SIDE, y / STILL_SIDE) => [0.0; 2],
        false => pair.forward.at(x, y),
    })
}

/// The reason why the depth is unknown if none was given and parallax gives none.
pub(super) fn no_parallax(why: &Unknown) -> Unknown {
    Unknown::new(why.reason, format!("no depth was given, and parallax gives none: {why}"))
}

/// Fails if a frame or its evidence differs in size from the first frame, or if the frame is not finite. `first` is the size of the first
/// frame, and is set by the first call.
pub(super) fn check_sizes(first: &mut Option<(usize, usize)>, observation: &FrameObservation) -> Result<()> {
    let FrameObservation { frame, next, previous, evidence } = observation;
    let size = frame.0.size();
    if size.0 == 0 || size.1 == 0 {
        return Err(Error::new("the frame has no pixels"));
    }
    let first = *first.get_or_insert(size);
    let removed = [evidence.denoised, evidence.motion_deblurred, evidence.defocus_deblurred, evidence.clean];
    let others = [*next, *previous].into_iter().chain(removed).flatten().map(|i| i.0.size());
    let others =
        others.chain(evidence.flow.map(Raster::size)).chain(evidence.inverse_depth.map(|d| d.0.size()));
    for s in others.chain([first]) {
        if s != size {
            return Err(Error::new(format!(
                "a frame or its evidence has {} x {} px, another {} x {}: all must have one size",
                s.0, s.1, size.0, size.1
            )));
        }
    }
    // A chunk is always read to its end, so that the compiler may vectorise it.
    let bad = |some: &[[f32; 3]]| some.iter().flatten().fold(false, |bad, v| bad | !v.is_finite());
    if frame.0.data().chunks(1024).any(bad) {
        return Err(Error::new(
            "the frame holds values that are not finite numbers: export it again without NaN or infinity",
        ));
    }
    Ok(())
}

/// The power of 2 by which a raster of a frame of this size was reduced to this width.
fn factor_of(width: usize, size: (usize, usize)) -> usize {
    size.0.div_ceil(width).next_power_of_two()
}

/// Enlarges the depth of halved frames to the frames' own size by repetition.
fn repeated(small: &Plane, size: (usize, usize)) -> Plane {
    let factor = factor_of(small.width(), size);
    Plane::from_fn(size.0, size.1, |x, y| small.at(x / factor, y / factor))
}

/// Enlarges the flow of halved frames to the frames' own size; the buffer of `into` is reused if it has that size.
pub(super) fn enlarged(small: Flow, (width, height): (usize, usize), into: Flow) -> Flow {
    if small.size() == (width, height) {
        return small;
    }
    let factor = factor_of(small.width(), (width, height));
    let share = |i: usize| (i % factor) as f32 / factor as f32;
    let mut flow = if into.size() == (width, height) { into } else { Flow::filled(width, height, [0.0; 2]) };
    par::for_each_row(flow.data_mut(), width, |y, out| {
        let (above, below) = (small.row(y / factor), small.row((y / factor + 1).min(small.height() - 1)));
        let between = |i: usize| Pixel::lerp(above[i], below[i], share(y)).map(|v| factor as f32 * v);
        let line: Vec<[f32; 2]> = (0..small.width()).map(between).collect();
        for (i, out) in out.chunks_mut(factor).enumerate() {
            let (left, right) = (line[i], line[(i + 1).min(line.len() - 1)]);
            for (x, out) in out.iter_mut().enumerate() {
                *out = Pixel::lerp(left, right, share(x));
            }
        }
    });
    flow
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::noise::tests::white;

    #[test]
    fn an_enlarged_flow_is_that_of_the_frames_themselves() {
        let small = Flow::from_fn(40, 30, |x, y| [0.1 * x as f32, 1.0 - 0.02 * y as f32]);
        let none = || Flow::filled(0, 0, [0.0; 2]);
        let flow = enlarged(small.clone(), (158, 118), none());
        for (x, y) in [(0, 0), (4, 8), (77, 30), (150, 101)] {
            let [u, v] = flow.at(x, y);
            // The flow of a small frame at a quarter of the place is multiplied by four.
            assert!(
                (u - 0.1 * x as f32).abs() < 1e-4 && (v - 4.0 + 0.02 * y as f32).abs() < 1e-4,
                "{x} {y}: {u} {v}"
            );
        }
        assert_eq!(enlarged(small.clone(), (158, 118), Flow::filled(158, 118, [9.0; 2])), flow);
        assert_eq!(enlarged(small.clone(), (40, 30), none()), small);
    }

    #[test]
    fn what_stands_still_beside_something_that_moves_has_no_motion() {
        // The left half moves by 3 px, the right half stands still, and the flow takes all along.
        let texture = white(96, 48, 1).map(|n| 0.5 + 0.1 * n[1]);
        let from = Plane::from_fn(72, 48, |x, y| texture.at(x + 8, y));
        let to = Plane::from_fn(72, 48, |x, y| texture.at(if x < 36 { x + 5 } else { x + 8 }, y));
        let occluded = Raster::from_fn(72, 48, |x, _| x < 4);
        let forward = Flow::filled(72, 48, [3.0, 0.0]);
        let residual =
            |from: &Plane, to: &Plane| {
                Plane::from_fn(72, 48, |x, y| {
                    if x < 69 { (to.at(x + 3, y) - from.at(x, y)).abs() } else { f32::NAN }
                })
            };
        let backward = forward.map(|v| v.map(|c| -c));
        let mut pair = FlowPair { backward, forward, occluded, residual: residual(&from, &to) };
        let flow = known_flow(&pair, &from, &to);
        assert!(flow.at(1, 20)[0].is_nan());
        assert_eq!((flow.at(20, 20), flow.at(60, 20)), ([3.0, 0.0], [0.0; 2]));
        // Where nothing tells, as in a flat part, the flow stays.
        let flat = Plane::filled(72, 48, 0.5);
        pair.residual = residual(&flat, &flat);
        assert_eq!(known_flow(&pair, &flat, &flat).at(60, 20), [3.0, 0.0]);
    }
}
