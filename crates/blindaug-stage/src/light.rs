//! The light on the object, estimated from the frame that it is put into.

use blindaug::{Encoded, Transfer, luma};
use glam::{Vec2, Vec3};

/// The strengths of the light from all sides and of that from one direction, relative to the frame's light.
const AMBIENT: f32 = 0.7;
const DIRECT: f32 = 1.3;
/// The step along each axis, px, between the pixels that are looked at.
const STRIDE: usize = 8;
/// The direction towards the light where no part of the frame is brighter than the others: from above on the left, behind the viewer.
const USUAL: Vec3 = Vec3::new(-0.5, -0.7, -0.6);
/// The distance of the viewer behind the picture, in halves of its width, at which the brightest part is seen in the direction of the light.
const BEHIND: f32 = 0.6;
/// The share of the frame's light above its mean from which on the direction of the brightest part counts alone.
const SURE: f32 = 0.25;

/// Light on the object, as radiance that a white surface reflects; linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// The light on a surface that faces upward.
    pub above: Vec3,
    /// The light on a surface that faces downward.
    pub below: Vec3,
    /// The light that comes from one direction.
    pub key: Vec3,
    /// The direction towards that light, of length 1, in camera coordinates: x right, y down, z away from the viewer.
    pub direction: Vec3,
}

impl Light {
    /// The light that a frame shows. Light from above and from below has the mean colour of the frame's upper and lower half. The one
    /// direction is that of the brightest part, as if the frame were a window behind which the viewer stands: light that falls on
    /// things on the left comes from the left. Its colour is that of the bright part, its strength that of the whole frame.
    pub fn of_frame(frame: &Encoded) -> Self {
        let (w, h) = frame.0.size();
        // A frame that is smaller than a step has one pixel at least.
        let steps = |size: usize| (size.min(STRIDE) / 2..size).step_by(STRIDE);
        let grid = || steps(h).flat_map(|y| steps(w).map(move |x| (x, y)));
        let light = |(x, y)| Vec3::from(frame.0.at(x, y).map(|v| Transfer::Srgb.decode(v)));
        let mean_of = |is_seen: &dyn Fn(usize) -> bool| {
            let seen = || grid().filter(|&(_, y)| is_seen(y));
            seen().map(light).sum::<Vec3>() / seen().count().max(1) as f32
        };
        let mean = mean_of(&|_| true);
        let half = |is_seen: &dyn Fn(usize) -> bool| match grid().any(|(_, y)| is_seen(y)) {
            true => mean_of(is_seen),
            false => mean,
        };
        let bright = luma(mean.into());
        // Where things are brighter than the mean, in halves of the frame's width from its middle, and how much in all.
        let (mut place, mut colour, mut excess) = (Vec2::ZERO, Vec3::ZERO, 0.0);
        for at in grid() {
            let light = light(at);
            let more = (luma(light.into()) - bright).max(0.0);
            let from_middle =
                Vec2::new(at.0 as f32 + 0.5, at.1 as f32 + 0.5) - 0.5 * Vec2::new(w as f32, h as f32);
            place += more * from_middle * 2.0 / w as f32;
            colour += more * light;
            excess += more;
        }
        let (direction, tint) = if excess > 0.0 {
            let share = excess / (bright * grid().count() as f32);
            let sure = (share / SURE).min(1.0);
            let found = (place / excess).extend(-BEHIND).normalize();
            let tint = colour / luma(colour.into());
            (USUAL.normalize().lerp(found, sure), Vec3::ONE.lerp(tint, sure))
        } else {
            (USUAL, Vec3::ONE)
        };
        Self {
            above: AMBIENT * half(&|y| y < h / 2),
            below: AMBIENT * half(&|y| y >= h / 2),
            key: DIRECT * bright * tint,
            direction: direction.normalize(),
        }
    }

    /// The same light from all sides, and nothing else.
    #[cfg(test)]
    pub fn even(light: f32) -> Self {
        let light = Vec3::splat(light);
        Self { above: light, below: light, key: Vec3::ZERO, direction: Vec3::NEG_Y }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::Raster;

    fn of(at: impl Fn(f32, f32) -> [f32; 3] + Sync) -> Light {
        Light::of_frame(&Encoded(Raster::from_fn(160, 90, |x, y| at(x as f32 / 160.0, y as f32 / 90.0))))
    }

    #[test]
    fn light_comes_from_where_the_frame_is_bright_in_its_colours() {
        let flat = of(|_, _| [0.5; 3]);
        let grey = Transfer::Srgb.decode(0.5);
        assert!((flat.direction - USUAL.normalize()).length() < 1e-3, "{flat:?}");
        for (got, want) in [(flat.above, AMBIENT), (flat.below, AMBIENT), (flat.key, DIRECT)] {
            assert!((got - want * grey).length() < 1e-4, "{flat:?}");
        }
        // A window on one side lights from there, in its own colour.
        let window = |left: f32| {
            of(move |x, y| {
                if (left..left + 0.2).contains(&x) && (0.1..0.6).contains(&y) {
                    [1.0, 0.9, 0.6]
                } else {
                    [0.2; 3]
                }
            })
        };
        let (left, right) = (window(0.05), window(0.75));
        assert!(left.direction.x < -0.5 && right.direction.x > 0.5, "{left:?} {right:?}");
        // The frame's mirror image has the mirrored light: neither has a side that the frame does not show.
        assert!((left.direction * Vec3::new(-1.0, 1.0, 1.0) - right.direction).length() < 0.02);
        assert!(right.key.x > 1.5 * right.key.z && right.direction.y < 0.0 && right.direction.z < 0.0);
        assert!((right.direction.length() - 1.0).abs() < 1e-5);
        // A blue sky over brown ground.
        let outside = of(|_, y| if y < 0.5 { [0.4, 0.6, 1.0] } else { [0.5, 0.4, 0.2] });
        assert!(outside.above.z > 2.0 * outside.above.x && outside.below.x > 2.0 * outside.below.z);
        assert!(outside.direction.y < -0.2, "{outside:?}");
    }

    #[test]
    fn a_black_frame_and_a_tiny_one_have_finite_light() {
        for (w, h) in [(1, 1), (3, 2), (9, 1), (40, 30)] {
            for value in [0.0, 1.0] {
                let light = Light::of_frame(&Encoded(Raster::filled(w, h, [value; 3])));
                let all = [light.above, light.below, light.key, light.direction];
                assert!(all.iter().all(|v| v.is_finite()), "{light:?}");
                assert!((light.above.x - AMBIENT * value).abs() < 1e-5);
            }
        }
    }
}
