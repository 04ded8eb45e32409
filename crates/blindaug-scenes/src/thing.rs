//! Things that are added to a scene: balls, boards and circular markers, still or on a path of their own.
//!
//! The axes of space are x to the right, y down and z forward, in m; the camera is near the origin, and time is counted in frames.

use crate::scene::{Pose, Texture, TextureKind, V3, add, cross, dot, scaled};
use rand::{SeedableRng, rngs::StdRng};
use std::f32::consts::{PI, TAU};
use std::sync::Arc;

/// The path of a thing. Periods are in frames, and phases are shares of a period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Path {
    /// The thing does not move.
    #[default]
    Still,
    /// The thing bounces as a ball does on the floor: its place is the lowest, above which it rises by `height_m |sin|`.
    Bouncing {
        /// The greatest height above the lowest place, m.
        height_m: f32,
        /// The frames from one bounce to the next.
        period: f32,
        /// The time since the last bounce at time 0, as a share of the period.
        phase: f32,
    },
    /// The thing swings about a pivot as a pendulum does, across the line of sight.
    Swinging {
        /// The pivot, m.
        pivot: V3,
        /// The greatest angle from the rest, radians.
        angle: f32,
        /// The frames from one end of the swing back to the same end.
        period: f32,
        /// The phase at time 0, at which a phase of 0 is the rest.
        phase: f32,
    },
    /// The thing is shaken and turned by little and fast, as a leaf in the wind: by two swings, of `period` and of 0.62 `period`.
    Fluttering {
        /// The greatest shift sideways and up, m each.
        shift_m: f32,
        /// The greatest turn about the vertical axis and about the line of sight, radians each.
        angle: f32,
        /// The frames of the slower swing.
        period: f32,
        /// The phase at time 0.
        phase: f32,
    },
}

/// A vector that is turned by `angle` radians in the plane of the axes `a` and `b`, from `a` to `b`.
fn turned(mut v: V3, a: usize, b: usize, angle: f32) -> V3 {
    let (s, c) = angle.sin_cos();
    (v[a], v[b]) = (c * v[a] - s * v[b], s * v[a] + c * v[b]);
    v
}

impl Path {
    /// The pose at time `t` of a thing whose pose at rest is given.
    fn pose(self, rest: Pose, t: f32) -> Pose {
        let swing = |period: f32, phase: f32| (TAU * (t / period + phase)).sin();
        match self {
            Self::Still => rest,
            Self::Bouncing { height_m, period, phase } => {
                let up = height_m * (PI * (t / period + phase)).sin().abs();
                Pose { position: add(rest.position, [0.0, -up, 0.0]), ..rest }
            }
            Self::Swinging { pivot, angle, period, phase } => {
                let turn = |v| turned(v, 0, 1, angle * swing(period, phase));
                let arm = add(rest.position, scaled(pivot, -1.0));
                Pose { position: add(pivot, turn(arm)), axes: rest.axes.map(turn) }
            }
            Self::Fluttering { shift_m, angle, period, phase } => {
                let (slow, fast) = (swing(period, phase), swing(0.62 * period, 1.7 * phase + 0.3));
                let turn = |v| turned(turned(v, 0, 2, angle * fast), 0, 1, angle * slow);
                let shift = [shift_m * slow, shift_m * fast, 0.0];
                Pose { position: add(rest.position, shift), axes: rest.axes.map(turn) }
            }
        }
    }
}

/// A circular marker: a disk in the middle of a square board, with an edge that is exact at any distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Marker {
    /// The centre of the disk, m.
    pub centre: V3,
    /// Unit vectors to the right and down, at right angles.
    pub axes: [V3; 2],
    /// The radius of the disk, m; the board's sides are [`Marker::BOARD`] times as long.
    pub radius_m: f32,
    /// Whether the disk is white and the board black, instead of the other way round.
    pub white_on_black: bool,
    /// The path of the marker.
    pub path: Path,
}

impl Marker {
    /// The sides of the board, in radii of the disk.
    pub const BOARD: f32 = 4.0;

    /// The pose at time `t`.
    pub(crate) fn pose(&self, t: f32) -> Pose {
        self.path.pose(Pose::with_axes(self.centre, self.axes), t)
    }
}

impl From<Marker> for Thing {
    fn from(marker: Marker) -> Self {
        Self {
            rest: Pose::with_axes(marker.centre, marker.axes),
            shape: Shape::Board { size: [Marker::BOARD * marker.radius_m; 2] },
            paint: Paint::Disk { radius: marker.radius_m, white: marker.white_on_black },
            path: marker.path,
        }
    }
}

/// A thing that can be added to a scene, or rendered alone as a virtual object. Its texture is shared by its clones.
#[derive(Clone)]
pub struct Thing {
    /// The pose from which the path departs.
    rest: Pose,
    shape: Shape,
    paint: Paint,
    path: Path,
}

#[derive(Clone, Copy)]
enum Shape {
    Ball { radius: f32 },
    Board { size: [f32; 2] },
}

#[derive(Clone)]
enum Paint {
    Texture(Arc<Texture>),
    /// The disk of a marker, white on black or black on white.
    Disk {
        radius: f32,
        white: bool,
    },
}

impl Thing {
    /// A ball with a centre and a radius in m. Its texture is that of a kind and a seed.
    pub fn ball(centre: V3, radius_m: f32, texture: TextureKind, seed: u64) -> Self {
        // The ball's front is towards the camera.
        let rest = Pose::with_axes(centre, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        Self::textured(rest, Shape::Ball { radius: radius_m }, texture, seed)
    }

    /// A rectangle with a centre and sides in m along two unit vectors at right angles. Its texture is that of a kind and a seed.
    pub fn board(centre: V3, axes: [V3; 2], size_m: [f32; 2], texture: TextureKind, seed: u64) -> Self {
        Self::textured(Pose::with_axes(centre, axes), Shape::Board { size: size_m }, texture, seed)
    }

    fn textured(rest: Pose, shape: Shape, kind: TextureKind, seed: u64) -> Self {
        let texture = Texture::new(kind as usize, &mut StdRng::seed_from_u64(seed));
        Self { rest, shape, paint: Paint::Texture(Arc::new(texture)), path: Path::Still }
    }

    /// The same thing on a path.
    pub fn moving(self, path: Path) -> Self {
        Self { path, ..self }
    }

    /// The pose at time `t`.
    pub(crate) fn pose(&self, t: f32) -> Pose {
        self.path.pose(self.rest, t)
    }

    /// The depth along the view axis, in m, at which a ray meets the thing in this pose, if that is nearer than `nearest`, and the
    /// place in the thing's own axes. The camera must be outside of a ball.
    pub(crate) fn hit(&self, pose: &Pose, from: V3, direction: V3, nearest: f32) -> Option<(f32, V3)> {
        let within = |t: f32| t > 0.05 && t < nearest;
        let relative = add(pose.position, scaled(from, -1.0));
        match self.shape {
            Shape::Ball { radius } => {
                let (a, b) = (dot(direction, direction), dot(direction, relative));
                // The ray passes the centre at this vector, which loses fewer digits than the textbook's discriminant.
                let passed = add(relative, scaled(direction, -b / a));
                let inside = radius * radius - dot(passed, passed);
                if inside < 0.0 {
                    return None;
                }
                let t = b / a - (inside / a).sqrt();
                within(t).then(|| (t, pose.local(add(from, scaled(direction, t)))))
            }
            Shape::Board { size } => {
                let t = dot(relative, pose.axes[2]) / dot(direction, pose.axes[2]);
                if !within(t) {
                    return None;
                }
                let place = pose.local(add(from, scaled(direction, t)));
                (0..2).all(|i| place[i].abs() <= 0.5 * size[i]).then_some((t, place))
            }
        }
    }

    /// The light from a place in the thing's own axes. `lit` gives the light on a surface of some normal, `texel` is the number of
    /// texels per m in the depth of the thing's pose at rest, `level` gives the texture's level from the texels per m, and
    /// `soft` is the std, in m, by which a lens softens the rim of a disk.
    pub(crate) fn light(
        &self,
        pose: &Pose,
        place: V3,
        density: impl Fn(f32) -> f32,
        level: impl Fn(f32) -> f32,
        soft: f32,
    ) -> V3 {
        let (light, [x, y]) = match self.shape {
            Shape::Ball { radius } => {
                let normal = scaled(place, 1.0 / radius);
                // The map keeps areas (Lambert 1772); its only pole is in the middle of the back.
                let k = (2.0 / (1.0 - normal[2]).max(1e-6)).sqrt();
                (lit(dot(pose.turned(normal), LAMP).max(0.0)), [k * place[0], k * place[1]])
            }
            // A board is lit from both sides, as the scene's own rectangles are.
            Shape::Board { size } => {
                (lit(dot(pose.axes[2], LAMP).abs()), [0, 1].map(|i| place[i] + 0.5 * size[i]))
            }
        };
        match &self.paint {
            Paint::Texture(texture) => {
                let density = density(self.rest.position[2]);
                scaled(texture.at([x * density, y * density], level(density)), light)
            }
            &Paint::Disk { radius, white } => {
                // An edge that a box softens is a ramp; the std of a box is its width over the square root of 12.
                let inside = radius - place[0].hypot(place[1]);
                let ramp = 12f32.sqrt() * soft;
                let share = if inside.abs() >= 0.5 * ramp {
                    if inside > 0.0 { 1.0 } else { 0.0 }
                } else {
                    0.5 + inside / ramp
                };
                let share = if white { share } else { 1.0 - share };
                [light * (BLACK + share * (WHITE - BLACK)); 3]
            }
        }
    }
}

/// The reflectances of a marker's black and white.
const BLACK: f32 = 0.03;
const WHITE: f32 = 0.9;

/// The direction to the lamp: above, on the left, on the camera's side.
pub(crate) const LAMP: V3 = [-0.45, -0.6, -0.66];

/// The light on a surface that the lamp meets under an angle of this cosine; another light comes from everywhere.
pub(crate) fn lit(cosine: f32) -> f32 {
    0.55 + 0.45 * cosine
}

impl Pose {
    /// The pose whose first two axes are given.
    fn with_axes(position: V3, [right, down]: [V3; 2]) -> Self {
        Self { position, axes: [right, down, cross(right, down)] }
    }
}
