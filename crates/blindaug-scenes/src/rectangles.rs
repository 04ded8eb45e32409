//! The rectangles of a scene, four of which a ray is tried on at a time.

use crate::scene::{V3, cross, dot};
use wide::f32x4;

/// Rectangles in the order in which they were added.
#[derive(Clone, Default)]
pub(crate) struct Rectangles {
    fours: Vec<Four>,
    len: usize,
}

/// Four rectangles, one in each lane. Lanes without one have a size that no place is within.
#[derive(Clone)]
struct Four {
    corner: [f32x4; 3],
    normal: [f32x4; 3],
    /// The unit vectors along the sides.
    sides: [[f32x4; 3]; 2],
    /// The lengths of the sides, m.
    size: [f32x4; 2],
}

/// The place at which a ray meets a rectangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Met {
    /// The number of the rectangle.
    pub(crate) rectangle: usize,
    /// The depth along the view axis, m.
    pub(crate) depth: f32,
    /// The place, m along the sides.
    pub(crate) place: [f32; 2],
}

impl Rectangles {
    /// Adds a rectangle with unit vectors along its sides, at right angles, and lengths in m.
    pub(crate) fn add(&mut self, corner: V3, sides: [V3; 2], size: [f32; 2]) {
        let lane = self.len % 4;
        if lane == 0 {
            let nothing = [f32x4::ZERO; 3];
            let size = [f32x4::splat(-1.0); 2];
            self.fours.push(Four { corner: nothing, normal: nothing, sides: [nothing; 2], size });
        }
        let four = self.fours.last_mut().expect("there is one with a free lane");
        let put = |to: &mut [f32x4], from: &[f32]| {
            for (to, &v) in to.iter_mut().zip(from) {
                let mut lanes = to.to_array();
                lanes[lane] = v;
                *to = lanes.into();
            }
        };
        put(&mut four.corner, &corner);
        put(&mut four.normal, &cross(sides[0], sides[1]));
        four.sides.iter_mut().zip(&sides).for_each(|(to, side)| put(to, side));
        put(&mut four.size, &size);
        self.len += 1;
    }

    /// The place that a ray meets first, more than 0.05 m away. The direction's part along the view axis has length 1.
    pub(crate) fn nearest(&self, from: V3, direction: V3) -> Option<Met> {
        let [from, direction] = [from, direction].map(|v| v.map(f32x4::splat));
        let mut depth = f32x4::splat(f32::INFINITY);
        let (mut number, mut place) = (f32x4::ZERO, [f32x4::ZERO; 2]);
        for (i, four) in self.fours.iter().enumerate() {
            let relative: [f32x4; 3] = std::array::from_fn(|k| four.corner[k] - from[k]);
            let t = dot(relative, four.normal) / dot(direction, four.normal);
            let at: [f32x4; 3] = std::array::from_fn(|k| direction[k] * t - relative[k]);
            let here = four.sides.map(|side| dot(at, side));
            let inside = |k: usize| here[k].simd_ge(f32x4::ZERO) & here[k].simd_le(four.size[k]);
            let met = t.simd_gt(f32x4::splat(0.05)) & t.simd_lt(depth) & inside(0) & inside(1);
            depth = met.select(t, depth);
            number = met.select(f32x4::splat(i as f32), number);
            place = std::array::from_fn(|k| met.select(here[k], place[k]));
        }
        let (depths, numbers, places) = (depth.to_array(), number.to_array(), place.map(|p| p.to_array()));
        let of_lane = |lane: usize| 4 * numbers[lane] as usize + lane;
        // Of rectangles in one depth, the first counts.
        let lane =
            (0..4).min_by(|&a, &b| depths[a].total_cmp(&depths[b]).then(of_lane(a).cmp(&of_lane(b))))?;
        (depths[lane] < f32::INFINITY).then(|| Met {
            rectangle: of_lane(lane),
            depth: depths[lane],
            place: places.map(|p| p[lane]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_of_many_is_found_and_its_place() {
        let mut rectangles = Rectangles::default();
        let (right, down) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        // They stand one behind the other, each to the right of the one before, the farthest first; two are in one depth.
        for i in 0..7 {
            rectangles.add([i as f32, -1.0, 10.0 - i as f32], [right, down], [2.0, 2.0]);
        }
        rectangles.add([6.0, -1.0, 4.0], [right, down], [2.0, 2.0]);
        let at = |x: f32, from: V3| rectangles.nearest(from, [x, 0.25, 1.0]);
        let met = |rectangle, depth, place| Some(Met { rectangle, depth, place });
        // At a depth of 10 m, 0.05 per m is 0.5 m to the right.
        assert_eq!(at(0.05, [0.0; 3]), None);
        assert_eq!(rectangles.nearest([0.0; 3], [0.05, 0.0, 1.0]), met(0, 10.0, [0.5, 1.0]));
        let straight = |x: f32| rectangles.nearest([x, 0.0, 0.0], [0.0, 0.0, 1.0]);
        assert_eq!(straight(1.5), met(1, 9.0, [0.5, 1.0]));
        assert_eq!(straight(5.5), met(5, 5.0, [0.5, 1.0]));
        assert_eq!(straight(6.5), met(6, 4.0, [0.5, 1.0]));
        assert_eq!(straight(-0.5), None);
        // What lies behind the eye, or right before it, is not met.
        assert_eq!(rectangles.nearest([6.5, 0.0, 3.96], [0.0, 0.0, 1.0]).map(|m| m.rectangle), Some(5));
        assert_eq!(rectangles.nearest([6.5, 0.0, 20.0], [0.0, 0.0, 1.0]), None);
        assert_eq!(Rectangles::default().nearest([0.0; 3], [0.0, 0.0, 1.0]), None);
    }
}
