//! The camera and the object's place, estimated while the frames come.

use super::{
    frames::LiveFrame,
    placement::{Pinhole, Placed, Placement},
};
use blindaug::{
    CameraModel, Plane, Result,
    fit::{
        Evidence, FrameObservation,
        track::{TileObserver, Tracker},
    },
    model::{DepthKind, Estimate, Reason, SceneScale, Space, TrackedCamera},
};
use glam::DVec2;

/// The reach around the object's foot within which depth is read, as a share of the frame's width.
const AROUND: f64 = 0.1;
/// The most frames over which the object's place is extrapolated. After a longer gap, the object is placed anew.
const FARTHEST: u64 = 10;
/// The weight of the last scale of relative depth in the running mean of the scale, 0 to 1.
const KEPT: f32 = 0.9;

/// The place of the object until a plane is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Home {
    /// The object's foot, in shares of the frame's width and height.
    pub at: DVec2,
    /// The distance of the foot along the view axis, m.
    pub distance: f64,
}

/// The estimates at a frame.
#[derive(Clone, Debug)]
pub struct LiveEstimate {
    /// The frame's number and the camera, as the tracker gives it.
    pub tracked: TrackedCamera,
    /// The camera with its lens over inverse depth in 1/m, to be applied.
    pub camera: CameraModel,
    /// The object's poses in this frame and in the next one.
    pub placed: Placed,
    /// The state of the placement for the next frame.
    placement: Placement,
}

impl LiveEstimate {
    /// The object's poses in this frame or a later one, to which its motion is extrapolated.
    pub fn placed_at(&self, number: u64) -> Placed {
        let mut placement = self.placement;
        let later = number.saturating_sub(self.tracked.frame).min(FARTHEST);
        (0..later).fold(self.placed, |_, _| placement.skip())
    }
}

/// Estimates frame after frame.
pub struct LiveEstimator {
    tracker: Tracker,
    pinhole: Pinhole,
    home: Home,
    placement: Placement,
    /// The relative inverse depth of things that are 1 m away.
    scale: Option<f32>,
    /// The number of the last frame.
    number: u64,
    lap: u64,
}

impl LiveEstimator {
    /// An estimator for a camera that is nearly this pinhole, and for an object that is first at `home`; `fps` is in frames per second.
    pub fn new(pinhole: Pinhole, home: Home, fps: Option<f64>) -> Self {
        Self {
            tracker: Tracker::new(Space::default(), fps),
            pinhole,
            home,
            placement: Placement::new(pinhole, home.at, home.distance),
            scale: None,
            number: 0,
            lap: 0,
        }
    }

    /// Takes a frame. If a few frames were left out before it, the object's motion is extrapolated over them. If the last frame is pushed
    /// once more, only the object's place is updated. The tiles of the frame are looked at by `observer`, if there is one.
    ///
    /// # Errors
    /// If the frame's size differs from that of the first one, or the observer fails.
    pub fn push(
        &mut self,
        shown: &LiveFrame,
        home: Home,
        observer: Option<&mut dyn TileObserver>,
    ) -> Result<LiveEstimate> {
        let LiveFrame { number, lap, frame, next, previous } = shown;
        let observation = FrameObservation {
            frame,
            next: next.as_deref(),
            previous: previous.as_deref(),
            evidence: Evidence::default(),
        };
        let camera = match self.tracker.model() {
            Some(camera) if *number == self.number => camera,
            _ => match observer {
                Some(observer) => self.tracker.push_with(&observation, observer)?,
                None => self.tracker.push(&observation)?,
            },
        }
        .clone();
        let left_out = number.saturating_sub(self.number + 1);
        if home != self.home || *lap != self.lap || left_out > FARTHEST {
            (self.home, self.lap) = (home, *lap);
            self.placement = Placement::new(self.pinhole, home.at, home.distance);
            self.scale = None;
        } else {
            for _ in 0..left_out {
                self.placement.skip();
            }
        }
        self.number = *number;
        // The flow of a clip's last frame leads to the frame before it, so it is not used.
        let placed = match next {
            Some(_) => self.placement.push(self.tracker.flow()),
            None => self.placement.skip(),
        };
        let inverse_depth = self.tracker.inverse_depth();
        let scale = inverse_depth.and_then(|d| self.scale_at(d, &placed));
        // Depth that is found again after a cut is in another unit.
        self.scale = match (scale, self.scale.filter(|_| inverse_depth.is_some())) {
            (Some(new), Some(old)) => Some(KEPT * old + (1.0 - KEPT) * new),
            (new, old) => new.or(old),
        };
        Ok(LiveEstimate {
            tracked: TrackedCamera {
                frame: *number,
                changed: self.tracker.changes(),
                camera: camera.clone(),
            },
            camera: in_metres(camera, self.scale),
            placed,
            placement: self.placement,
        })
    }

    /// The relative inverse depth of things that are 1 m away, from the object's distance: the surroundings of its foot are as far away.
    fn scale_at(&self, inverse_depth: &Plane, placed: &Placed) -> Option<f32> {
        let place = placed.now.translation;
        let foot = self.pinhole.centre() + self.pinhole.focal_length * place.truncate() / place.z;
        let (w, h) = inverse_depth.size();
        let reach = DVec2::splat(AROUND * w as f64);
        let inside = |v: f64, size: usize| v.clamp(0.0, size as f64) as usize;
        let (low, high) = (foot - reach, foot + reach);
        let rows = inside(low.y, h)..inside(high.y, h);
        let columns = inside(low.x, w)..inside(high.x, w);
        let mut near: Vec<f32> = rows
            .flat_map(|y| inverse_depth.row(y)[columns.clone()].iter().copied())
            .filter(|d| d.is_finite())
            .collect();
        if near.is_empty() {
            return None;
        }
        let middle = near.len() / 2;
        let (_, median, _) = near.select_nth_unstable_by(middle, f32::total_cmp);
        (*median > 0.0).then_some(*median * place.z as f32)
    }
}

/// The camera with its lens over inverse depth in 1/m, where `scale` is the relative inverse depth of things that are 1 m away.
fn in_metres(mut camera: CameraModel, scale: Option<f32>) -> CameraModel {
    let is_relative = camera.defocus.known().is_some_and(|lens| lens.depth_kind == DepthKind::Relative);
    match scale {
        Some(scale) => camera.to_metric(SceneScale { scale, offset: 0.0 }),
        None if is_relative => {
            let why = "nothing is known of the depth where the object stands";
            camera.defocus = Estimate::unknown(Reason::NoDepth, why);
            camera
        }
        None => camera,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::{Encoded, Flow, Raster};
    use std::sync::Arc;

    #[test]
    fn after_a_long_gap_and_a_new_start_nothing_of_before_is_kept() {
        let pinhole = Pinhole::new((64, 48), 50.0);
        let home = Home { at: DVec2::new(0.5, 0.7), distance: 2.0 };
        let frame = Arc::new(Encoded(Raster::filled(64, 48, [0.25; 3])));
        let pushed = |number, lap| {
            let mut estimation = LiveEstimator::new(pinhole, home, None);
            for _ in 0..6 {
                estimation.placement.push(Some(&Flow::filled(64, 48, [1.0, 0.0])));
            }
            (estimation.number, estimation.scale) = (6, Some(5.0));
            let shot = LiveFrame { number, lap, frame: frame.clone(), next: None, previous: None };
            let placed = estimation.push(&shot, home, None).unwrap().placed;
            // A picture without anything in it has no depth.
            assert_eq!(estimation.scale, None);
            placed
        };
        let at_home = Placement::new(pinhole, home.at, home.distance).skip().now;
        assert!(pushed(7, 0).on_plane && pushed(7 + FARTHEST, 0).on_plane);
        assert_eq!(pushed(8 + FARTHEST, 0).now, at_home);
        assert_eq!(pushed(7, 1).now, at_home);
    }

    #[test]
    fn the_object_is_moved_in_a_frame_that_stands_still() {
        let pinhole = Pinhole::new((64, 48), 50.0);
        let home = Home { at: DVec2::new(0.5, 0.7), distance: 2.0 };
        let frame =
            |i| Arc::new(Encoded(Raster::from_fn(64, 48, |x, y| [((x + i) * y % 7) as f32 / 7.0; 3])));
        let shot = |i| LiveFrame {
            number: i as u64,
            lap: 0,
            frame: frame(i),
            next: Some(frame(i + 1)),
            previous: (i > 1).then(|| frame(i - 1)),
        };
        let mut moved = LiveEstimator::new(pinhole, home, None);
        let mut still = LiveEstimator::new(pinhole, home, None);
        let elsewhere = Home { at: DVec2::new(0.2, 0.6), distance: 5.0 };
        let first = moved.push(&shot(1), home, None).unwrap();
        still.push(&shot(1), home, None).unwrap();
        let again = moved.push(&shot(1), elsewhere, None).unwrap();
        assert_eq!(again.tracked, first.tracked);
        assert_eq!(again.placed.now, Placement::new(pinhole, elsewhere.at, elsewhere.distance).skip().now);
        // The camera is estimated as if nothing had been moved.
        assert_eq!(
            moved.push(&shot(2), elsewhere, None).unwrap().tracked,
            still.push(&shot(2), home, None).unwrap().tracked
        );
    }
}
