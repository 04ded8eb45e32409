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

    /// The largest distance, m, of a place of the thing from its pose's position.
    pub(crate) fn reach(&self) -> f32 {
        match self.shape {
            Shape::Ball { radius } => radius,
            Shape::Board { size } => 0.5 * size[0].hypot(size[1]),
        }
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

    /// The light from a place in the thing's own axes. `density` gives the texels per m from the depth of the thing at rest, and
    /// `level` the texture's level from that density; `soft` is the std, in m, by which a lens softens the rim of a disk.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{self, Setting};
    use crate::scene::{Exposure, RimPoint, Scene};
    use blindaug::composite::{CompositeOptions, Plate, VirtualLayer, composite};
    use blindaug::{CameraModel, Encoded, Linear, Transfer};

    const SIZE: (usize, usize) = (160, 120);

    /// Things of all kinds on paths of all kinds, in view at time 2.
    fn things(scene: &Scene) -> [Thing; 4] {
        let at = |x: f32, y: f32, depth| {
            let (w, h) = scene.size();
            scene.point_at(2.0, [x * w as f32, y * h as f32], depth)
        };
        let ball = |centre, seed| Thing::ball(centre, 0.13, TextureKind::SmallLeaves, seed);
        let (floor, hung) = (at(0.55, 0.65, 0.75), at(0.45, 0.5, 0.75));
        let board = at(0.5, 0.5, 0.7);
        let board = Thing::board(board, scene.facing(2.0), [0.3, 0.25], TextureKind::LargeLeaves, 9);
        let pivot = add(hung, [0.0, -0.6, 0.0]);
        [
            ball(floor, 1).moving(Path::Bouncing { height_m: 0.15, period: 14.0, phase: 0.15 }),
            ball(hung, 2).moving(Path::Swinging { pivot, angle: 0.3, period: 24.0, phase: 0.0 }),
            board.clone().moving(Path::Fluttering { shift_m: 0.02, angle: 0.2, period: 9.0, phase: 0.0 }),
            board,
        ]
    }

    #[test]
    fn flow_and_motion_follow_the_things() {
        let scene = Scene::new(3, (256, 192)).still_camera();
        for thing in things(&scene) {
            let with = scene.clone().with(thing.clone());
            let picture = |t: f32| with.picture(t, Exposure::default(), 0).0;
            let (now, next, flow, motion) = (picture(2.0), picture(3.0), with.flow(2.0), with.motion(2.0));
            let (layer, depth, later) =
                (with.layer(&thing, 2.0), with.inverse_depth(2.0), with.layer(&thing, 3.0));
            let on = |x: usize, y: usize| {
                let [u, v] = flow.at(x, y);
                let there = later.color.0.bilinear(x as f32 + u, y as f32 + v)[3];
                layer.color.0.at(x, y)[3] > 0.999
                    && there > 0.999
                    && (layer.inverse_depth.at(x, y) / depth.at(x, y) - 1.0).abs() < 0.02
            };
            let places: Vec<(usize, usize)> =
                (4..188).flat_map(|y| (4..252).map(move |x| (x, y))).filter(|&(x, y)| on(x, y)).collect();
            assert!(places.len() > 1000, "{}", places.len());
            let mean = |f: &dyn Fn(usize, usize) -> f32| {
                places.iter().map(|&(x, y)| f(x, y)).sum::<f32>() / places.len() as f32
            };
            let error = |share: f32| {
                mean(&|x, y| {
                    let [u, v] = flow.at(x, y).map(|v| share * v);
                    (next.bilinear(x as f32 + u, y as f32 + v)[1] - now.at(x, y)[1]).abs()
                })
            };
            let moves = mean(&|x, y| flow.at(x, y)[0].hypot(flow.at(x, y)[1]));
            if thing.path == Path::Still {
                assert!(moves < 1e-3 && error(1.0) < 0.01);
                continue;
            }
            assert!(moves > 1.0 && error(1.0) < 0.5 * error(0.0), "{moves}: {} {}", error(1.0), error(0.0));
            assert!(error(1.0) < 0.8 * error(0.8));
            // The layer's motion is that of the scene.
            let apart = mean(&|x, y| {
                let (a, b) = (layer.motion.at(x, y), motion.at(x, y));
                (a[0] - b[0]).hypot(a[1] - b[1])
            });
            assert!(apart < 0.02 * moves, "{apart}");
        }
    }

    #[test]
    fn a_ball_is_round_and_lit_from_the_upper_left() {
        let scene = Scene::new(3, SIZE).still_camera();
        let ball = Thing::ball(scene.point_at(0.0, [79.5, 59.5], 0.8), 0.2, TextureKind::Rough, 4);
        let layer = scene.layer(&ball, 0.0);
        let seen: Vec<[f32; 6]> = (0..SIZE.1)
            .flat_map(|y| (0..SIZE.0).map(move |x| (x, y)))
            .filter(|&(x, y)| layer.color.0.at(x, y)[3] > 0.0)
            .map(|(x, y)| {
                let c = layer.color.0.at(x, y);
                [x as f32, y as f32, c[3], c[1], layer.inverse_depth.at(x, y), 0.0]
            })
            .collect();
        let area: f32 = seen.iter().map(|p| p[2]).sum();
        let middle = [0, 1].map(|i| seen.iter().map(|p| p[2] * p[i]).sum::<f32>() / area);
        // A ball's outline is larger than the disk through its centre.
        let radius = scene.focal() * 0.2 / (0.8f32.powi(2) - 0.04).sqrt();
        assert!(((area / PI).sqrt() / radius - 1.0).abs() < 0.01, "{area} px");
        let brightness = |sign: f32| {
            let part = || seen.iter().filter(|p| sign * (p[0] + p[1] - middle[0] - middle[1]) > 0.5 * radius);
            part().map(|p| p[3]).sum::<f32>() / part().map(|p| p[2]).sum::<f32>()
        };
        assert!(brightness(-1.0) > 1.15 * brightness(1.0));
        assert!((layer.inverse_depth.at(79, 59) - 1.0 / 0.6).abs() < 0.01);
        assert!(layer.inverse_depth.at(0, 0).is_nan() && layer.color.0.at(0, 0) == [0.0; 4]);
    }

    /// The composite of a layer over a frame of the scene at time 2.
    fn over(scene: &Scene, frame: &Linear, layer: VirtualLayer, model: &CameraModel, naive: bool) -> Encoded {
        let frame = frame.to_encoded(Transfer::Srgb);
        let (depth, motion) = (scene.inverse_depth(2.0), scene.motion(2.0));
        let plate = Plate { inverse_depth: Some(&depth), flow: Some(&motion), ..Plate::new(&frame, 0) };
        let options = CompositeOptions {
            naive,
            no_noise: true,
            bokeh: Some(blindaug::synth::defocus::Bokeh::Disk),
            ..CompositeOptions::default()
        };
        composite(&plate, &layer, model, &options).unwrap()
    }

    /// The mean difference of a picture to the truth, relative to that of the frame without the thing.
    fn share_of(got: &Encoded, truth: &Linear, without: &Linear) -> f32 {
        let [truth, without] = [truth, without].map(|p| p.to_encoded(Transfer::Srgb));
        let apart = |a: &Encoded| {
            let values = a.0.data().iter().flatten().zip(truth.0.data().iter().flatten());
            values.map(|(a, b)| (a - b).abs()).sum::<f32>()
        };
        apart(got) / apart(&without)
    }

    fn setting(exposure: f32, lens: Option<(f32, f32)>) -> Setting {
        Setting { exposure, lens, noise: 0.0, readout: 0.0, rolling_shutter: 0.0 }
    }

    #[test]
    fn a_composited_layer_is_the_thing_in_the_scene() {
        let scene = Scene::new(3, SIZE);
        let model = camera::model(SIZE, &setting(0.0, None));
        let of = |scene: &Scene| scene.picture(2.0, Exposure::default(), 0);
        // The second thing stands behind some of the scene's things.
        let hidden = {
            let centre = scene.point_at(2.0, [80.0, 60.0], 4.0);
            Thing::board(centre, scene.facing(2.0), [3.0, 2.0], TextureKind::Bricks, 3)
        };
        let things = things(&scene);
        for thing in things[..3].iter().cloned().chain([hidden]) {
            let (without, truth) = (of(&scene), of(&scene.clone().with(thing.clone())));
            let error = |layer: crate::scene::Layer| {
                share_of(&over(&scene, &without, layer.into(), &model, false), &truth, &without)
            };
            let got = error(scene.layer(&thing, 2.0));
            assert!(got < 0.03, "{:?}: {got}", thing.path);
            // Negative controls: the layer of another time, and another thing.
            assert!(thing.path == Path::Still || error(scene.layer(&thing, 3.0)) > 4.0 * got);
            let other = Thing { paint: things[3].paint.clone(), ..thing.clone() };
            let painted = Thing { paint: Paint::Disk { radius: 0.1, white: true }, ..thing };
            assert!(error(scene.layer(&other, 2.0)).max(error(scene.layer(&painted, 2.0))) > 4.0 * got);
        }
    }

    #[test]
    fn with_the_true_camera_a_composite_is_what_physics_films() {
        let scene = Scene::new(3, SIZE);
        let (fraction, lens) = (0.6, Some((3.0, 1.5)));
        let model = camera::model(SIZE, &setting(fraction, lens));
        let of = |scene: &Scene| scene.picture(2.0, Exposure { fraction, lens, readout: 0.0 }, 0);
        let thing = things(&scene)[1].clone();
        let (without, truth) = (of(&scene), of(&scene.clone().with(thing.clone())));
        let error = |naive| {
            let layer = scene.layer(&thing, 2.0).into();
            share_of(&over(&scene, &without, layer, &model, naive), &truth, &without)
        };
        assert!(error(false) < 0.25 * error(true), "{} {}", error(false), error(true));
    }

    #[test]
    fn the_rim_of_a_marker_is_where_the_picture_has_its_edge() {
        let scene = Scene::new(3, (256, 192));
        for white_on_black in [false, true] {
            let marker = scene.visible_marker(4.0, 3.0, 14.0, white_on_black).expect("free space");
            let turned = Marker { axes: [turned(marker.axes[0], 0, 2, 0.7), marker.axes[1]], ..marker };
            for (marker, round) in [(marker, true), (turned, false)] {
                let with = scene.clone().with_marker(marker);
                let picture = with.picture(4.0, Exposure::default(), 0).0;
                let rim = with.rim(&marker, 4.0, 60);
                let at = |p: &RimPoint, r: f32| {
                    picture.bilinear(p.place[0] + r * p.normal[0], p.place[1] + r * p.normal[1])[1]
                };
                let centre = [0, 1].map(|i| rim.iter().map(|p| p.place[i]).sum::<f32>() / 60.0);
                for p in &rim {
                    assert!(p.visible);
                    let (inside, outside) = (at(p, -2.0), at(p, 2.0));
                    assert!(if white_on_black { inside > 5.0 * outside } else { outside > 5.0 * inside });
                    assert!((p.normal[0].hypot(p.normal[1]) - 1.0).abs() < 1e-3);
                    let r = (p.place[0] - centre[0]).hypot(p.place[1] - centre[1]);
                    assert!(!round || (r - 14.0).abs() < 0.02, "{r}");
                }
                // The edge lies on the rim: the mean along it is half way between the sides. Negative control: half a px off it is not.
                let mean = |r: f32| rim.iter().map(|p| at(p, r)).sum::<f32>() / 60.0;
                let share = |r: f32| (mean(r) - mean(-2.0)) / (mean(2.0) - mean(-2.0));
                assert!((share(0.0) - 0.5).abs() < 0.06, "{}", share(0.0));
                assert!((share(0.5) - 0.5).abs() > 0.2 && (share(-0.5) - 0.5).abs() > 0.2);
            }
            // A ball before the marker hides it; at the edge of the picture it is cut off.
            let ball = Thing::ball(
                scene.point_at(4.0, scene.rim(&marker, 4.0, 1)[0].place, 1.0),
                0.05,
                TextureKind::Rough,
                1,
            );
            let hidden = scene.clone().with_marker(marker).with(ball);
            let visible = |s: &Scene| s.rim(&marker, 4.0, 60).iter().filter(|p| p.visible).count();
            assert!(visible(&scene.clone().with_marker(marker)) == 60 && visible(&hidden) < 60);
            let away = Marker { centre: add(marker.centre, [9.0, 0.0, 0.0]), ..marker };
            assert!(scene.rim(&away, 4.0, 60).iter().all(|p| !p.visible));
        }
        assert_eq!(scene.visible_marker(0.0, 1.0, 200.0, false), None);
    }
}
