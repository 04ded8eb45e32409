//! Motion that changes much from one frame to the next, as under a shaking hand.
//!
//! The streaks that a frame shows are as long and have the direction of the motion while the shutter is open. Flow tells where things are
//! at the frames' times, so where speed and direction swing within a few frames, the motion at a frame's own time is known badly: a hand
//! that shakes by 50 % of its speed and half a radian with a period of three frames leaves errors of a third. Their direction the frame
//! itself tells, since the zeros of its spectrum lie across it ([`turn`]); what is left of the speed's error widens what the frame says of
//! the exposure ([`over_speeds`]).

use super::likelihood::{
    CLIP, EXPOSURE_STEP, EXPOSURES, LAMBDA_STEPS, MAX_LAMBDA, Prepared, STREAK_STEP, interpolate,
};
use super::noise::LumaNoise;
use super::robust::median;
use super::tiles::{SPEEDS, TILE, corners, turned, turned_tiles};
use crate::model::Space;
use crate::portable::Portable;
use crate::{Encoded, Flow, par};

/// The change of motion from one frame interval to the next, as a share of the speed, up to which motion counts as even. Own scenes and
/// steady cameras have less.
const EVEN: f32 = 0.2;

/// The number of frames before and after a frame whose uneven motion makes the motion of that frame count as uneven.
pub(super) const NEAR: usize = 2;

/// The relative std of the speed at a frame's own time, over the change of motion.
const SPEED_ERROR: f32 = 0.42;

/// The factor of [`SPEED_ERROR`] at the ends of a shot, where the change of motion is known on one side only.
const AT_ENDS: f32 = 1.5;

/// The angles, in radians, by which the motion of an uneven frame may be turned from what the flow says.
const ANGLES: [f32; 9] = [0.0, -0.15, 0.15, -0.3, 0.3, -0.45, 0.45, -0.6, 0.6];

/// The change of the motion from one frame interval to the next over the mean speed of both: the median over the pixels whose motion is
/// known in both. `to_next` is the flow to the next frame, `motion` that at the frame's own time.
pub(super) fn change_of(to_next: &Flow, motion: &Flow) -> Option<f32> {
    const STEP: usize = 8;
    let (w, h) = motion.size();
    let places = (0..h).step_by(STEP).flat_map(|y| (0..w).step_by(STEP).map(move |x| (x, y)));
    let changes: Vec<f32> = places
        .filter_map(|(x, y)| {
            let (next, mean) = (to_next.at(x, y), motion.at(x, y));
            let half = (next[0] - mean[0]).portable_hypot(next[1] - mean[1]);
            let speed = mean[0].portable_hypot(mean[1]);
            // Where only one of both is known, it stands for the mean.
            (half > 0.0 && speed >= SPEEDS.start).then_some(2.0 * half / speed)
        })
        .collect();
    if changes.len() < 2 * TILE / STEP { None } else { median(changes) }
}

/// The relative std of the speed at a frame's own time if the motion changes by the share `change`; 0 if the motion is even.
pub(super) fn speed_error(change: f32, at_end: bool) -> f32 {
    let error = SPEED_ERROR * change * if at_end { AT_ENDS } else { 1.0 };
    if change > EVEN { error } else { 0.0 }
}

/// The std, in radians, of the direction at a frame's own time, over the change of motion.
const DIRECTION_ERROR: f32 = 0.4;

/// The number of nats of the sum over the tiles of a frame that count as one, since the tiles err alike.
const ALIKE: f32 = 40.0;

/// The likeliest angle, in radians, between the motion while the shutter was open and `motion`, by the direction and the length of the
/// streaks in a part of the frame's tiles. `change` is the share by which the motion changes.
pub(super) fn turn(frame: &Encoded, motion: &Flow, change: f32, noise: &LumaNoise, space: Space) -> f32 {
    let mut corners = corners(frame.0.size());
    // Every second tile is left out, as on a checkerboard: tiles overlap by half, so the others tell hardly more.
    corners.retain(|(x, y)| (x + y) % TILE == 0);
    let tiles = turned_tiles(frame, &corners, motion, &ANGLES, space);
    // A table for each tile: its log-likelihood in nats over the angle and over the length of the streaks.
    const LENGTHS: usize = 32;
    let tables = par::map(tiles.len(), |i| {
        let turned = tiles[i].iter().map(|tile| {
            let step = (STREAK_STEP / tile.speed).clamp(LAMBDA_STEPS.start, LAMBDA_STEPS.end);
            let step = MAX_LAMBDA / (MAX_LAMBDA / step).round();
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
            change_of(&next, &motion_at_frame(&next, &flow(last[0], last[1])))
        };
        let swings = change([6.0, 2.0], [6.0, -2.0]).expect("it moves");
        assert!((swings - 4.0 / 6.0).abs() < 1e-3 && speed_error(swings, false) > 0.2, "{swings}");
        assert!(speed_error(swings, true) > speed_error(swings, false));
        let goes_on = change([6.3, 0.0], [5.7, 0.0]).expect("it moves");
        assert!((goes_on - 0.1).abs() < 1e-3 && speed_error(goes_on, true) == 0.0, "{goes_on}");
        // What hardly moves shows no streaks, however it swings.
        assert_eq!(change([0.6, 0.0], [0.2, 0.0]), None);
    }

    #[test]
    fn a_speed_that_may_be_off_widens_what_a_frame_says() {
        let curve: Vec<f32> =
            (0..EXPOSURES).map(|i| -2e4 * (i as f32 * EXPOSURE_STEP - 0.5).powi(2)).collect();
        let at = |curve: &[f32], exposure: f32| curve[(exposure / EXPOSURE_STEP).round() as usize];
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
        let found =
            |frame: &Encoded| turn(frame, &motion(0.0), 0.8, &noise, crate::model::BlurSpace::Encoded.into());
        let angle = found(&Encoded(blurred));
        assert!((angle - 0.3).abs() < 0.01, "{angle}");
        let angle = found(&Encoded(motion_blur(&texture, &motion(0.0), ExposureFraction(1.0)).unwrap()));
        assert!(angle.abs() < 0.01, "{angle}");
    }
}
