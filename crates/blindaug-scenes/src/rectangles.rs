//! The rectangles of a scene, each of which is tried on four rays at a time.

use crate::scene::{V3, cross, dot};
use wide::f32x4;

/// Rectangles in the order in which they were added.
#[derive(Clone, Default)]
pub(crate) struct Rectangles(Vec<Rectangle>);

/// A rectangle, with each number in all lanes.
#[derive(Clone)]
struct Rectangle {
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

/// Four vectors as one whose components have a lane for each.
pub(crate) fn in_lanes(vectors: [V3; 4]) -> [f32x4; 3] {
    std::array::from_fn(|i| f32x4::from(vectors.map(|v| v[i])))
}

impl Rectangles {
    /// Adds a rectangle with unit vectors along its sides, at right angles, and lengths in m.
    pub(crate) fn add(&mut self, corner: V3, sides: [V3; 2], size: [f32; 2]) {
        let [corner, normal] = [corner, cross(sides[0], sides[1])].map(|v| v.map(f32x4::splat));
        let sides = sides.map(|v| v.map(f32x4::splat));
        self.0.push(Rectangle { corner, normal, sides, size: size.map(f32x4::splat) });
    }

    /// The number of rectangles.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// The corners of the rectangle of this number, one in each lane.
    pub(crate) fn corners(&self, number: usize) -> [f32x4; 3] {
        let of = &self.0[number];
        let [first, second] = [[0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]].map(f32x4::from);
        std::array::from_fn(|i| {
            of.corner[i] + of.sides[0][i] * of.size[0] * first + of.sides[1][i] * of.size[1] * second
        })
    }

    /// The places that four rays meet first, more than 0.05 m away, among the rectangles of these numbers, which ascend. The directions'
    /// parts along the view axis have length 1.
    #[inline(always)]
    pub(crate) fn nearest(
        &self,
        numbers: impl IntoIterator<Item = usize>,
        from: [f32x4; 3],
        direction: [f32x4; 3],
    ) -> [Option<Met>; 4] {
        let mut depth = f32x4::splat(f32::INFINITY);
        let (mut rectangle, mut place) = (f32x4::ZERO, [f32x4::ZERO; 2]);
        for number in numbers {
            let r = &self.0[number];
            let relative: [f32x4; 3] = std::array::from_fn(|k| r.corner[k] - from[k]);
            let t = dot(relative, r.normal) / dot(direction, r.normal);
            // Of rectangles in one depth, the first counts.
            let nearer = t.simd_gt(f32x4::splat(0.05)) & t.simd_lt(depth);
            if nearer.none() {
                continue;
            }
            let at: [f32x4; 3] = std::array::from_fn(|k| direction[k] * t - relative[k]);
            let here = r.sides.map(|side| dot(at, side));
            let inside = |k: usize| here[k].simd_ge(f32x4::ZERO) & here[k].simd_le(r.size[k]);
            let met = nearer & inside(0) & inside(1);
            depth = met.select(t, depth);
            rectangle = met.select(f32x4::splat(number as f32), rectangle);
            place = std::array::from_fn(|k| met.select(here[k], place[k]));
        }
        let (depth, rectangle, place) = (depth.to_array(), rectangle.to_array(), place.map(|p| p.to_array()));
        std::array::from_fn(|k| {
            (depth[k] < f32::INFINITY).then(|| Met {
                rectangle: rectangle[k] as usize,
                depth: depth[k],
                place: place.map(|p| p[k]),
            })
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
        let among = |numbers: std::ops::Range<usize>, from: V3, direction: V3| {
            let [from, direction] = [from, direction].map(|v| in_lanes([v; 4]));
            let met = rectangles.nearest(numbers, from, direction);
            assert!(met.iter().all(|m| *m == met[0]));
            met[0]
        };
        let nearest = |from: V3, direction: V3| among(0..rectangles.len(), from, direction);
        let met = |rectangle, depth, place| Some(Met { rectangle, depth, place });
        // At a depth of 10 m, 0.05 per m is 0.5 m to the right.
        assert_eq!(nearest([0.0; 3], [0.05, 0.25, 1.0]), None);
        assert_eq!(nearest([0.0; 3], [0.05, 0.0, 1.0]), met(0, 10.0, [0.5, 1.0]));
        let straight = |x: f32| nearest([x, 0.0, 0.0], [0.0, 0.0, 1.0]);
        assert_eq!(straight(1.5), met(1, 9.0, [0.5, 1.0]));
        assert_eq!(straight(5.5), met(5, 5.0, [0.5, 1.0]));
        assert_eq!(straight(6.5), met(6, 4.0, [0.5, 1.0]));
        assert_eq!(straight(-0.5), None);
        assert_eq!(among(0..1, [1.5, 0.0, 0.0], [0.0, 0.0, 1.0]), met(0, 10.0, [1.5, 1.0]));
        // What lies behind the eye, or right before it, is not met.
        assert_eq!(nearest([6.5, 0.0, 3.96], [0.0, 0.0, 1.0]).map(|m| m.rectangle), Some(5));
        assert_eq!(nearest([6.5, 0.0, 20.0], [0.0, 0.0, 1.0]), None);
        // Each ray meets what is before it.
        let from = in_lanes([1.5, 5.5, -0.5, 6.5].map(|x| [x, 0.0, 0.0]));
        let met = rectangles.nearest(0..rectangles.len(), from, in_lanes([[0.0, 0.0, 1.0]; 4]));
        assert_eq!(met.map(|m| m.map(|m| m.rectangle)), [Some(1), Some(5), None, Some(6)]);
    }

    #[test]
    fn corners_are_those_of_the_sides() {
        let mut rectangles = Rectangles::default();
        rectangles.add([1.0, 2.0, 3.0], [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]], [2.0, 4.0]);
        let corners = [[1.0, 2.0, 3.0], [1.0, 2.0, 5.0], [1.0, 6.0, 3.0], [1.0, 6.0, 5.0]];
        assert_eq!(rectangles.corners(0), in_lanes(corners));
    }
}
