//! Scenes whose truth is known: textured planes seen by a moving camera, cast ray by ray, and [`Thing`]s added to them.
//!
//! A picture is the mean of many pinhole views, spread over the pixel, the lens and the time that the shutter is open
//! (Cook, Porter & Carpenter 1984). With one point in the lens and one in time it is the sharp frame. Rows may be read one after the other,
//! as by a rolling shutter.
//!
//! A thing that is added with [`Scene::with`] is filmed with the rest; [`Scene::layer`] renders it alone, as a game engine does, so that
//! its composite over the picture without it can be compared with the picture in which it really is.

use crate::rectangles::{Met, Rectangles, in_lanes};
use crate::thing::{LAMP, Marker, Path, Thing, lit};
use blindaug::composite::VirtualLayer;
use blindaug::{Flow, Linear, Pixel, Plane, Premultiplied, Raster};
use rand::{Rng, SeedableRng, rngs::StdRng};
use std::f32::consts::TAU;
use std::ops::{Add, Mul};
use std::sync::Arc;
use wide::f32x4;

/// A point or a direction in space: x to the right, y down, z forward, m.
pub type V3 = [f32; 3];

pub(crate) fn add(a: V3, b: V3) -> V3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(crate) fn scaled(a: V3, k: f32) -> V3 {
    a.map(|v| v * k)
}

/// The dot product of two vectors, or of as many pairs as a number has lanes.
pub(crate) fn dot<T: Copy + Add<Output = T> + Mul<Output = T>>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: V3, b: V3) -> V3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// What a rectangle looks like.
#[derive(Clone)]
struct Surface {
    texture: usize,
    /// Texels of the texture per metre.
    density: f32,
    light: f32,
}

/// A texture that repeats, and its successive halvings, finest first.
///
/// Each texel has a fourth value, which is 0, so that it is one vector of the processor.
pub(crate) struct Texture(Vec<Raster<[f32; 4]>>);

/// The side of a texture's finest level, px.
const TEXTURE: usize = 1024;
/// The least number of views that a pixel uses.
const FEWEST: usize = 24;
/// The number of all views of a picture through a lens, divided by the number that one pixel uses.
const POOL: usize = 64;
/// The least number of views that a pixel uses through a lens.
const OF_LENS: usize = 128;
/// The share of a lens blur's variance that smoothing of the textures stands for; the smoothing removes most of the noise of so few
/// rays. Its std is the distance between the rays of a frame, which has two pictures of n rays: sqrt(pi radius^2 / (2 n)). The std
/// of the lens blur is half its radius.
const SMOOTHED: f32 = 4.0 * std::f32::consts::PI / (2 * OF_LENS) as f32;
/// The least std by which textures are smoothed, px.
const FINEST: f32 = 0.2;
/// The number of rows whose views are made at once if each row has its own.
const BAND: usize = 16;

/// The kinds of textures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextureKind {
    /// Disks of all sizes that cover each other, which have the statistics of photographs (Lee, Mumford & Huang 2001).
    LargeLeaves,
    /// Smaller disks that cover each other.
    SmallLeaves,
    /// Courses of bricks.
    Bricks,
    /// The grain of wood.
    Wood,
    /// A rough surface.
    Rough,
}

/// A room with things in it, and the path of a camera through it. Clones share the textures.
#[derive(Clone)]
pub struct Scene {
    surfaces: Vec<Surface>,
    /// The places of the surfaces.
    rectangles: Rectangles,
    textures: Arc<[Texture]>,
    /// The things that were added.
    things: Vec<Thing>,
    /// Whether the camera stays where it is at time 0.
    still: bool,
    /// The camera's path: two radii in m, a phase in radians, and radians per frame.
    path: [f32; 4],
    /// The phases, in radians, of the swings of a hand that shakes, for each of [`SWINGS`] sideways and up; `None`: nothing shakes.
    shake: Option<[[f32; 2]; SWINGS.len()]>,
    /// The times, in frames, at which the camera moves on faster for a moment.
    surges: Vec<f32>,
    /// Width and height of the picture, px.
    size: (usize, usize),
}

/// The swings of a hand that shakes: their periods in frames, which are 4 and 9 Hz at 30 frames a second, and how far they turn the
/// camera, as shares of the picture's width. The largest speeds are 3.4 and 2.3 px a frame in a picture 512 px wide.
const SWINGS: [(f32, f32); 2] = [(30.0 / 4.0, 4.0 / 512.0), (30.0 / 9.0, 1.2 / 512.0)];

/// The position and the orientation of the camera or of a thing.
#[derive(Clone, Copy)]
pub(crate) struct Pose {
    pub(crate) position: V3,
    /// Unit vectors to the right, down and forward.
    pub(crate) axes: [V3; 3],
}

impl Pose {
    /// A point of space in the axes of the pose.
    pub(crate) fn local(&self, point: V3) -> V3 {
        self.axes.map(|axis| dot(add(point, scaled(self.position, -1.0)), axis))
    }

    /// A direction that is given in the axes of the pose.
    pub(crate) fn turned(&self, [x, y, z]: V3) -> V3 {
        add(add(scaled(self.axes[0], x), scaled(self.axes[1], y)), scaled(self.axes[2], z))
    }

    /// The point of space that is given in the axes of the pose.
    fn point(&self, local: V3) -> V3 {
        add(self.position, self.turned(local))
    }
}

/// The poses of everything that moves, at one time.
struct Instant {
    camera: Pose,
    /// The poses of the things that were added, in their order.
    things: Vec<Pose>,
}

/// What a ray meets first.
struct Hit<'a> {
    /// The depth along the view axis, m.
    depth: f32,
    on: On<'a>,
}

/// The place that a ray meets.
#[derive(Clone, Copy)]
enum On<'a> {
    /// A place on one of the scene's own surfaces, m along its sides.
    Surface(&'a Surface, [f32; 2]),
    /// A place on the thing of this number, in the thing's own axes.
    Thing(usize, V3),
}

/// A point that can be seen.
#[derive(Clone, Copy)]
enum Point {
    /// A point that does not move.
    Still(V3),
    /// A point of the thing of this number, in the thing's own axes.
    OfThing(usize, V3),
}

/// A thing rendered alone: sharp, anti-aliased, lit as in the scene, and not cut out where the scene's things are in front of it.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Premultiplied colour, in linear light.
    pub color: Premultiplied,
    /// Inverse depth of the thing, 1/m, NaN where there is none.
    pub inverse_depth: Plane,
    /// Motion of the thing, px per frame interval, centred on the time; 0 where there is none.
    pub motion: Flow,
}

impl From<Layer> for VirtualLayer {
    fn from(layer: Layer) -> Self {
        Self { color: layer.color, inverse_depth: Some(layer.inverse_depth), flow: Some(layer.motion) }
    }
}

/// A point of the rim of a marker's disk, in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RimPoint {
    /// The place, px from the middle of the first pixel.
    pub place: [f32; 2],
    /// The unit vector at right angles to the rim, away from the disk.
    pub normal: [f32; 2],
    /// Whether the point is inside the picture and nothing hides it.
    pub visible: bool,
}

/// The shutter and the lens of a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Exposure {
    /// Exposure fraction, in [0, 1]; 0 is an instant.
    pub fraction: f32,
    /// The lens `(sigma_px_at_infinity, focus_m)`, whose blur has the std `sigma_px_at_infinity |1 - focus_m / Z|` in px; `None` is
    /// a pinhole.
    pub lens: Option<(f32, f32)>,
    /// The time from the first row to the last one as a share of the frame interval, in [0, 1], of a rolling shutter: row y of h is
    /// taken at t + readout (y / (h - 1) - 1/2). At 0, all rows are taken at once.
    pub readout: f32,
}

impl Scene {
    /// The scene that a number, the seed, stands for, in pictures of this size in px.
    pub fn new(number: u64, size: (usize, usize)) -> Self {
        let mut rng = StdRng::seed_from_u64(number);
        let textures = (0..5).map(|kind| Texture::new(kind, &mut rng)).collect();
        let mut scene = Self {
            surfaces: vec![],
            rectangles: Rectangles::default(),
            textures,
            things: vec![],
            still: false,
            path: [0.0; 4],
            shake: None,
            surges: vec![],
            size,
        };
        // Walls and floor, then things in front of them.
        let (far, floor) = (rng.random_range(6.0..9.0), 1.3);
        let (right, down) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let kind = |rng: &mut StdRng| rng.random_range(0..5);
        let texture = kind(&mut rng);
        scene.rectangle([-9.0, -6.0, far], right, down, [18.0, 6.0 + floor], texture, 200.0);
        let texture = kind(&mut rng);
        scene.rectangle([-9.0, floor, 0.3], right, [0.0, 0.0, 1.0], [18.0, far], texture, 700.0);
        let texture = kind(&mut rng);
        scene.rectangle([-3.4, -6.0, 2.0], [0.0, 0.0, 1.0], down, [far, 6.0 + floor], texture, 400.0);
        for i in 0..8 {
            // The things are spread in inverse depth from near to far, so that the whole range is in view.
            let inverse = 1.0 + (1.0 / far - 1.0) * (i as f32 + rng.random_range(0.0..0.8)) / 8.0;
            let z = 1.0 / inverse;
            let side = z * rng.random_range(0.28..0.5);
            // The things stand on the left and on the right in turn.
            let across = z * rng.random_range(0.03..0.55) * if i % 2 == 0 { -1.0 } else { 1.0 };
            let up = z * rng.random_range(-0.42..0.3);
            let (s, c) = rng.random_range(-0.5f32..0.5).sin_cos();
            let tall = side * rng.random_range(0.7..1.3);
            let corner = [across - 0.5 * side * c, up - 0.5 * tall, z - 0.5 * side * s];
            // The texture is fine enough for the distance.
            let texture = kind(&mut rng);
            scene.rectangle(corner, [c, 0.0, s], down, [side, tall], texture, 2.2 * scene.focal() / z);
        }
        let speed = rng.random_range(0.07..0.13);
        scene.path =
            [rng.random_range(0.5..0.9), rng.random_range(0.15..0.5), rng.random_range(0.0..TAU), speed];
        scene
    }

    /// The scene with its camera held by a hand that shakes; the seed gives the phases of its swings.
    pub fn shaken(mut self, seed: u64) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        self.shake = Some(SWINGS.map(|_| [rng.random_range(0.0..TAU), rng.random_range(0.0..TAU)]));
        self
    }

    /// The scene with a camera that does not move: it stays where it is at time 0.
    pub fn still_camera(self) -> Self {
        Self { still: true, ..self }
    }

    /// The scene with one more thing in it.
    pub fn with(mut self, thing: Thing) -> Self {
        self.things.push(thing);
        self
    }

    /// The scene with a marker in it.
    pub fn with_marker(self, marker: Marker) -> Self {
        self.with(marker.into())
    }

    /// A still marker whose board faces the camera at time `t` and is wholly visible, as near to the middle of the picture as possible;
    /// `None` if a board of that size is hidden in part wherever it is put in that depth. Its disk has this radius in px.
    pub fn visible_marker(
        &self,
        t: f32,
        depth_m: f32,
        radius_px: f32,
        white_on_black: bool,
    ) -> Option<Marker> {
        // Half of the board's side, with a margin for what is between the points that are looked at.
        let half = 0.5 * Marker::BOARD * radius_px + 2.0;
        let now = self.instant(t);
        let free = |[x, y]: [f32; 2]| {
            const STEPS: usize = 12;
            (0..=STEPS * STEPS + 2 * STEPS).all(|i| {
                let at = |i: usize| half * (2.0 * i as f32 / STEPS as f32 - 1.0);
                let place = [x + at(i % (STEPS + 1)), y + at(i / (STEPS + 1))];
                let direction = self.direction(&now.camera, place[0], place[1], [0.0; 2]);
                self.inside(place) && self.hit(&now, direction).is_none_or(|h| h.depth > 1.02 * depth_m)
            })
        };
        let middle = [self.size.0, self.size.1].map(|n| 0.5 * (n as f32 - 1.0));
        let from_middle = |p: [f32; 2]| (p[0] - middle[0]).hypot(p[1] - middle[1]);
        let step = (0.25 * half).max(1.0);
        let columns = (middle[0] / step) as i32;
        let rows = (middle[1] / step) as i32;
        let mut places: Vec<[f32; 2]> = (-rows..=rows)
            .flat_map(|j| (-columns..=columns).map(move |i| [i as f32 * step, j as f32 * step]))
            .map(|d| [middle[0] + d[0], middle[1] + d[1]])
            .collect();
        places.sort_by(|a, b| from_middle(*a).total_cmp(&from_middle(*b)));
        let place = places.into_iter().find(|p| free(*p))?;
        Some(Marker {
            centre: self.point_at(t, place, depth_m),
            axes: self.facing(t),
            radius_m: radius_px * depth_m / self.focal(),
            white_on_black,
            path: Path::Still,
        })
    }

    /// Points of the rim of a marker's disk at time `t`, evenly spaced around the disk. The marker is one that was added to the scene.
    pub fn rim(&self, marker: &Marker, t: f32, points: usize) -> Vec<RimPoint> {
        let (now, pose) = (self.instant(t), marker.pose(t));
        (0..points)
            .map(|i| {
                let (s, c) = (TAU * i as f32 / points as f32).sin_cos();
                let [point, along] =
                    [pose.point([marker.radius_m * c, marker.radius_m * s, 0.0]), pose.turned([-s, c, 0.0])];
                let seen = now.camera.local(point);
                let place = self.place(&now, Point::Still(point));
                let centre = self.place(&now, Point::Still(pose.position));
                // The derivative of the projection along the rim, whose length does not matter.
                let d = now.camera.axes.map(|axis| dot(along, axis));
                let [u, v] = [0, 1].map(|i| d[i] * seen[2] - seen[i] * d[2]);
                let length = u.hypot(v).max(f32::MIN_POSITIVE);
                let normal = [v / length, -u / length];
                let outward = normal[0] * (place[0] - centre[0]) + normal[1] * (place[1] - centre[1]);
                let direction = scaled(add(point, scaled(now.camera.position, -1.0)), 1.0 / seen[2]);
                let visible = seen[2] > 0.05
                    && self.inside(place)
                    && self.hit(&now, direction).is_none_or(|h| h.depth > seen[2] * (1.0 - 1e-3));
                RimPoint { place, normal: normal.map(|n| if outward < 0.0 { -n } else { n }), visible }
            })
            .collect()
    }

    /// Whether a place in px is inside the picture.
    fn inside(&self, [x, y]: [f32; 2]) -> bool {
        let within = |v: f32, n: usize| (-0.5..=n as f32 - 0.5).contains(&v);
        within(x, self.size.0) && within(y, self.size.1)
    }

    /// The scene with a camera that surges at these times, in frames: within about one frame interval it goes on as far as else in two, so
    /// that its streaks grow too.
    pub fn surging(mut self, times: &[f32]) -> Self {
        self.surges = times.to_vec();
        self
    }

    /// The angles, in radians, by which the hand turns the camera at time `t`: sideways and up.
    fn shake(&self, t: f32) -> [f32; 2] {
        let Some(phases) = self.shake else { return [0.0; 2] };
        std::array::from_fn(|axis| {
            let swings = SWINGS.iter().zip(phases);
            swings
                .map(|((period, reach), phase)| {
                    reach * self.size.0 as f32 / self.focal() * (TAU * t / period + phase[axis]).sin()
                })
                .sum()
        })
    }

    fn rectangle(&mut self, corner: V3, a: V3, b: V3, size: [f32; 2], texture: usize, density: f32) {
        let light = lit(dot(cross(a, b), LAMP).abs());
        self.surfaces.push(Surface { texture, density, light });
        self.rectangles.add(corner, [a, b], size);
    }

    /// Width and height of the picture, px.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// The point of space, m, that the camera sees at a place in px at time `t`, if it is in this depth along the view axis.
    pub fn point_at(&self, t: f32, [x, y]: [f32; 2], depth_m: f32) -> V3 {
        let pose = self.pose(t);
        add(pose.position, scaled(self.direction(&pose, x, y, [0.0; 2]), depth_m))
    }

    /// The unit vectors to the right and down in the picture that is taken at time `t`: those of a board that faces the camera.
    pub fn facing(&self, t: f32) -> [V3; 2] {
        let [right, down, _] = self.pose(t).axes;
        [right, down]
    }

    /// Focal length, px: something of 1 m in a depth of 1 m is as large in the picture.
    pub fn focal(&self) -> f32 {
        0.95 * self.size.0 as f32
    }

    fn instant(&self, t: f32) -> Instant {
        Instant { camera: self.pose(t), things: self.things.iter().map(|thing| thing.pose(t)).collect() }
    }

    /// The pose of the camera.
    fn pose(&self, t: f32) -> Pose {
        const SURGE: f32 = 0.5;
        let t = if self.still { 0.0 } else { t };
        let [wide, high, phase, speed] = self.path;
        let ahead: f32 = self.surges.iter().map(|at| 0.5 + 0.5 * ((t - at) / SURGE).tanh()).sum();
        let angle = phase + speed * (t + ahead);
        let position = [wide * angle.cos(), high * angle.sin(), 0.12 * (0.7 * angle).sin()];
        // The camera turns against its motion, as if it looked at something, but not by as much.
        let [sideways, up] = self.shake(t);
        let (ys, yc) = (-0.06 * (angle + 0.4).cos() - 0.03 * (1.7 * angle).sin() + sideways).sin_cos();
        let (ps, pc) = (0.03 * (0.9 * angle).sin() + up).sin_cos();
        let axes = [[yc, 0.0, -ys], [ps * ys, pc, ps * yc], [pc * ys, -ps, pc * yc]];
        Pose { position, axes }
    }

    fn direction(&self, pose: &Pose, x: f32, y: f32, [a, b]: [f32; 2]) -> V3 {
        let [u, v] = self.off_axis(x, y);
        add(add(scaled(pose.axes[0], u - a), scaled(pose.axes[1], v - b)), pose.axes[2])
    }

    fn off_axis(&self, x: f32, y: f32) -> [f32; 2] {
        let (w, h) = (self.size.0 as f32, self.size.1 as f32);
        [(x - 0.5 * (w - 1.0)) / self.focal(), (y - 0.5 * (h - 1.0)) / self.focal()]
    }

    /// What a ray from the camera meets first.
    fn hit(&self, now: &Instant, direction: V3) -> Option<Hit<'_>> {
        let [from, towards] = [now.camera.position, direction].map(|v| in_lanes([v; 4]));
        let [met, ..] = self.rectangles.nearest(0..self.rectangles.len(), from, towards);
        self.hit_or_thing(met, 0..self.things.len(), now, direction)
    }

    /// What a ray from the camera meets first: the nearest rectangle, which is given, or one of the things of these numbers before it.
    ///
    /// This and what else is done for each ray of a picture is always inlined, so that nothing goes through memory in between: filming takes
    /// three quarters of the time that it takes with calls.
    #[inline(always)]
    fn hit_or_thing(
        &self,
        met: Option<Met>,
        things: impl IntoIterator<Item = usize>,
        now: &Instant,
        direction: V3,
    ) -> Option<Hit<'_>> {
        let from = now.camera.position;
        let on = |m: Met| Hit { depth: m.depth, on: On::Surface(&self.surfaces[m.rectangle], m.place) };
        let mut nearest = met.map(on);
        for i in things {
            let beyond = nearest.as_ref().map_or(f32::INFINITY, |h| h.depth);
            if let Some((depth, place)) = self.things[i].hit(&now.things[i], from, direction, beyond) {
                nearest = Some(Hit { depth, on: On::Thing(i, place) });
            }
        }
        nearest
    }

    /// The light of a ray from what it meets. `apart` gives the distance of a pixel's rays where they meet a surface, px, at the surface's
    /// inverse depth. The texture is smoothed by a box of twice that distance and by linear interpolation, which together have the std
    /// `apart`; that is at least [`FINEST`], as a pixel has few rays.
    #[inline(always)]
    fn light(&self, now: &Instant, hit: &Hit, apart: impl Fn(f32) -> f32) -> V3 {
        match hit.on {
            On::Surface(s, place) => {
                let level = self.level(hit.depth, s.density, &apart);
                let value = self.textures[s.texture].at(place.map(|p| p * s.density), level);
                scaled(value, s.light)
            }
            On::Thing(i, place) => self.light_of(&self.things[i], &now.things[i], place, hit.depth, &apart),
        }
    }

    /// The light of a place on a thing, seen in this depth.
    fn light_of(&self, thing: &Thing, pose: &Pose, place: V3, depth: f32, apart: impl Fn(f32) -> f32) -> V3 {
        let soft = apart(1.0 / depth) * depth / self.focal();
        // The texture is as fine for the distance as those of the scene's own things.
        let density = |rest: f32| 2.2 * self.focal() / rest.max(0.1);
        thing.light(pose, place, density, |density| self.level(depth, density, &apart), soft)
    }

    /// The level of a texture of `density` texels per m.
    #[inline(always)]
    fn level(&self, depth: f32, density: f32, apart: impl Fn(f32) -> f32) -> f32 {
        (depth * density / self.focal() * 2.0 * apart(1.0 / depth).max(FINEST)).log2()
    }

    /// The picture that is taken at time `t` (in frames). Through a lens each pixel has its own views, as in a path tracer: their limited
    /// number leaves white noise, which differs between seeds. The same views for all pixels would leave gaps that look like sharp texture.
    pub fn picture(&self, t: f32, exposure: Exposure, seed: u64) -> Linear {
        const SKY: V3 = [0.5, 0.55, 0.6];
        Linear(self.mean_of_views(t, exposure, seed, |now, hit, apart| {
            hit.map_or(SKY, |hit| self.light(now, &hit, apart))
        }))
    }

    /// A thing that the camera takes alone at time `t`, with its shutter and its lens: premultiplied colour in linear light, as pictures
    /// before a black and before a white backdrop give it (Smith & Blinn 1996). The scene gives the camera's pose only.
    pub fn cutout(&self, thing: &Thing, t: f32, exposure: Exposure, seed: u64) -> Premultiplied {
        let alone = Self { rectangles: Rectangles::default(), things: vec![thing.clone()], ..self.clone() };
        Premultiplied(alone.mean_of_views(t, exposure, seed, |now, hit, apart| {
            let Some(hit) = hit else { return [0.0; 4] };
            let [r, g, b] = alone.light(now, &hit, apart);
            [r, g, b, 1.0]
        }))
    }

    /// The mean over a pixel's views of what `of` gives for the view's time and for what its ray meets. The last argument of `of` is the
    /// distance of the pixel's rays, px, at an inverse depth.
    fn mean_of_views<const N: usize>(
        &self,
        t: f32,
        exposure: Exposure,
        seed: u64,
        of: impl Fn(&Instant, Option<Hit>, &dyn Fn(f32) -> f32) -> [f32; N] + Sync,
    ) -> Raster<[f32; N]>
    where
        [f32; N]: Pixel,
    {
        let (width, height) = self.size;
        let along = self.along(t, exposure);
        let each = if exposure.lens.is_some() { OF_LENS.max(along) } else { along };
        // At once, all rows have the same views; one after the other, each row has its own, of its own time.
        let (band, pool) = if exposure.readout == 0.0 { (height, POOL) } else { (BAND, POOL / 4) };
        let apart = |d: f32| {
            let radius = exposure.lens.map_or(0.0, |(sigma, focus)| 2.0 * sigma * (1.0 - focus * d));
            SMOOTHED.sqrt() * 0.5 * radius.abs()
        };
        let mut pixels = Vec::with_capacity(width * height);
        for top in (0..height).step_by(band.max(1)) {
            let rows = band.min(height - top);
            let views: Vec<Vec<View>> = if exposure.readout == 0.0 {
                vec![self.views(t, exposure, each, pool)]
            } else {
                let late = |y: usize| y as f32 / (height.max(2) - 1) as f32 - 0.5;
                let of_row = |y| self.views(t + exposure.readout * late(y), exposure, each, pool);
                (top..top + rows).map(of_row).collect()
            };
            let extents = self.extents(&views);
            let part = Raster::from_fn(width, rows, |x, row| {
                let (views, y) = (&views[row % views.len()], top + row);
                let starts = (views.len() - each + 1) as u64;
                let first = hash(seed, (y * width + x) as u64) % starts;
                let (rectangles, things): (Vec<usize>, Vec<usize>) = (0..extents.len())
                    .filter(|n| may_be_seen(extents[*n], x, y))
                    .partition(|n| *n < self.rectangles.len());
                let mut sum = [0.0; N];
                for four in views[first as usize..][..each].chunks(4) {
                    // Where there are fewer than four, the last one stands for the missing ones.
                    let view = |k: usize| &four[k.min(four.len() - 1)];
                    let directions = std::array::from_fn(|k| {
                        let v = view(k);
                        let [px, py] = v.pixel;
                        self.direction(&v.instant.camera, x as f32 + px, y as f32 + py, v.tilt)
                    });
                    let from = std::array::from_fn(|k| view(k).instant.camera.position);
                    let tried = rectangles.iter().copied();
                    let met = self.rectangles.nearest(tried, in_lanes(from), in_lanes(directions));
                    for ((v, direction), met) in four.iter().zip(directions).zip(met) {
                        let things = things.iter().map(|n| n - self.rectangles.len());
                        let hit = self.hit_or_thing(met, things, &v.instant, direction);
                        let value = of(&v.instant, hit, &apart);
                        sum = std::array::from_fn(|c| sum[c] + value[c]);
                    }
                }
                sum.map(|s| s * (1.0 / each as f32))
            });
            pixels.extend_from_slice(part.data());
        }
        Raster::from_vec(width, height, pixels).expect("as many as pixels")
    }

    /// For each rectangle, and then for each thing, the part of the picture in which any of the views may see it.
    fn extents(&self, views: &[Vec<View>]) -> Vec<Extent> {
        // The corners of a rectangle, or of the nearer and the farther side of a cube around a thing, in the camera's axes.
        let corners = |number: usize, now: &Instant| -> [f32x4; 3] {
            let Some(thing) = number.checked_sub(self.rectangles.len()) else {
                let corners = self.rectangles.corners(number);
                let Pose { position, axes } = now.camera;
                let relative = std::array::from_fn(|i| corners[i] - f32x4::splat(position[i]));
                return axes.map(|axis| dot(relative, axis.map(f32x4::splat)));
            };
            let centre = now.camera.local(now.things[thing].position);
            let reach = f32x4::splat(self.things[thing].reach());
            let side = f32x4::from([1.0, -1.0, 1.0, -1.0]);
            let away = [side, side, f32x4::from([1.0, 1.0, -1.0, -1.0])];
            std::array::from_fn(|i| f32x4::splat(centre[i]) + reach * away[i])
        };
        let focal = f32x4::splat(self.focal());
        let middle = [self.size.0, self.size.1].map(|n| f32x4::splat(0.5 * (n as f32 - 1.0)));
        let in_row = |number: usize, row: usize| {
            let [mut least, mut largest] = [f32::INFINITY, f32::NEG_INFINITY].map(|v| [f32x4::splat(v); 2]);
            for view in &views[row] {
                let seen = corners(number, &view.instant);
                // What reaches behind the camera may be seen anywhere.
                if seen[2].simd_lt(f32x4::splat(0.05)).any() {
                    return EVERYWHERE;
                }
                for i in 0..2 {
                    let place = focal * (seen[i] / seen[2] + f32x4::splat(view.tilt[i])) + middle[i];
                    (least[i], largest[i]) = (least[i].fast_min(place), largest[i].fast_max(place));
                }
            }
            let least = least.map(|v| v.to_array().into_iter().fold(f32::INFINITY, f32::min));
            let largest = largest.map(|v| v.to_array().into_iter().fold(f32::NEG_INFINITY, f32::max));
            [least[0], least[1], largest[0], largest[1]]
        };
        let numbers = self.rectangles.len() + self.things.len();
        let in_rows = Raster::from_fn(numbers, views.len(), in_row);
        (0..numbers).map(|n| (0..views.len()).map(|row| in_rows.at(n, row)).fold(NOWHERE, united)).collect()
    }

    /// A thing rendered alone at time `t`: through a pinhole, in an instant. It may be one that is in the scene or one that is not.
    pub fn layer(&self, thing: &Thing, t: f32) -> Layer {
        let exposure = Exposure::default();
        let views = self.views(t, exposure, FEWEST, POOL);
        let [now, before, after] =
            [0.0, -0.5, 0.5].map(|d| Instant { camera: self.pose(t + d), things: vec![thing.pose(t + d)] });
        // Colour, alpha, inverse depth and motion of each pixel, each the mean over the rays that meet the thing.
        let pixels = Raster::from_fn(self.size.0, self.size.1, |x, y| {
            let mut sum = [0.0f32; 7];
            for v in &views {
                let direction =
                    self.direction(&now.camera, x as f32 + v.pixel[0], y as f32 + v.pixel[1], [0.0; 2]);
                let hit = thing.hit(&now.things[0], now.camera.position, direction, f32::INFINITY);
                let Some((depth, place)) = hit else { continue };
                let [r, g, b] = self.light_of(thing, &now.things[0], place, depth, |_| 0.0);
                let [from, to] = [&before, &after].map(|i| self.place(i, Point::OfThing(0, place)));
                let of_ray = [r, g, b, 1.0 / depth, to[0] - from[0], to[1] - from[1], 1.0];
                sum = std::array::from_fn(|i| sum[i] + of_ray[i]);
            }
            sum
        });
        let share = 1.0 / views.len() as f32;
        Layer {
            color: Premultiplied(pixels.map(|[r, g, b, .., n]| [r, g, b, n].map(|v| v * share))),
            inverse_depth: pixels.map(|[.., d, _, _, n]| if n > 0.0 { d / n } else { f32::NAN }),
            motion: pixels.map(|[.., u, v, n]| if n > 0.0 { [u / n, v / n] } else { [0.0; 2] }),
        }
    }

    /// Inverse depth in 1/m at the middle of the pixels, 0 where there is no surface.
    pub fn inverse_depth(&self, t: f32) -> Plane {
        let now = self.instant(t);
        Raster::from_fn(self.size.0, self.size.1, |x, y| {
            let direction = self.direction(&now.camera, x as f32, y as f32, [0.0; 2]);
            self.hit(&now, direction).map_or(0.0, |h| 1.0 / h.depth)
        })
    }

    /// Optical flow from time `t` to `t + 1`.
    pub fn flow(&self, t: f32) -> Flow {
        let next = self.instant(t + 1.0);
        self.of_points(t, |x, y, point| {
            let [u, v] = self.place(&next, point);
            [u - x as f32, v - y as f32]
        })
    }

    /// Motion at time `t`, px per frame interval: the path of each point seen then, from half an interval before to half an
    /// interval after `t`.
    pub fn motion(&self, t: f32) -> Flow {
        let [before, after] = [-0.5, 0.5].map(|d| self.instant(t + d));
        self.of_points(t, |_, _, point| {
            let (a, b) = (self.place(&before, point), self.place(&after, point));
            [b[0] - a[0], b[1] - a[1]]
        })
    }

    /// A flow whose value at each pixel follows from the pixel and the point that is seen there at time `t`.
    fn of_points(&self, t: f32, of: impl Fn(usize, usize, Point) -> [f32; 2] + Sync) -> Flow {
        let now = self.instant(t);
        Raster::from_fn(self.size.0, self.size.1, |x, y| {
            let direction = self.direction(&now.camera, x as f32, y as f32, [0.0; 2]);
            let still = |z: f32| Point::Still(add(now.camera.position, scaled(direction, z)));
            let point = match self.hit(&now, direction) {
                None => still(1e4),
                Some(Hit { on: On::Thing(i, place), .. }) => Point::OfThing(i, place),
                Some(Hit { depth, .. }) => still(depth),
            };
            of(x, y, point)
        })
    }

    /// The place in the picture, px, at which the camera sees a point.
    fn place(&self, at: &Instant, point: Point) -> [f32; 2] {
        let seen = at.camera.local(match point {
            Point::Still(point) => point,
            Point::OfThing(i, place) => at.things[i].point(place),
        });
        let place = |i: usize, n: usize| self.focal() * seen[i] / seen[2] + 0.5 * (n as f32 - 1.0);
        [place(0, self.size.0), place(1, self.size.1)]
    }

    /// The number of views that a pixel of a picture uses: along a streak enough for neighbours to lie less than a pixel apart.
    fn along(&self, t: f32, exposure: Exposure) -> usize {
        let along = if exposure.fraction > 0.0 {
            let flow = self.flow(t);
            let fastest = flow.data().iter().map(|f| f[0].hypot(f[1])).fold(0.0f32, f32::max);
            exposure.fraction * fastest.min(60.0)
        } else {
            0.0
        };
        ((1.2 * along).ceil() as usize).max(FEWEST)
    }

    /// The views of a picture, of which a pixel uses `each` in a row. Through a lens there are `pool` times as many, and the first ones come
    /// again after the last, so that a row can begin at any of them.
    fn views(&self, t: f32, exposure: Exposure, each: usize, pool: usize) -> Vec<View> {
        let (n, again) = if exposure.lens.is_some() { (pool * each, each - 1) } else { (each, 0) };
        let view = |i: usize| {
            // This sequence fills a cube evenly (Roberts 2018), and so does any run of it.
            let [time, px, py, radius, angle] =
                [0.881_271_46, 0.776_639_39, 0.684_430_13, 0.603_168_74, 0.531_555_4]
                    .map(|a: f64| (0.5 + a * i as f64).fract() as f32);
            // Without a lens, the times are evenly spaced.
            let in_time = if exposure.lens.is_some() { time } else { (i as f32 + 0.5) / n as f32 } - 0.5;
            let tilt = exposure.lens.map_or([0.0; 2], |(sigma, _)| {
                // A point moves by radius (1 - focus / Z) px; the std of a uniform disk is half its radius. The share `SMOOTHED` of
                // the variance is left to the textures' smoothing.
                let r = 2.0 * sigma * ((1.0 - SMOOTHED) * radius).sqrt() / self.focal();
                [r * (TAU * angle).cos(), r * (TAU * angle).sin()]
            });
            let mut instant = self.instant(t + in_time * exposure.fraction);
            if let Some((_, focus)) = exposure.lens {
                // All rays of a pixel meet in the plane in focus.
                let pose = &mut instant.camera;
                for (axis, tilt) in pose.axes.into_iter().zip(tilt) {
                    pose.position = add(pose.position, scaled(axis, focus * tilt));
                }
            }
            View { instant, pixel: [px - 0.5, py - 0.5], tilt }
        };
        (0..n + again).map(|i| view(i % n)).collect()
    }
}

/// A part of the picture: left, top, right and bottom, px.
type Extent = [f32; 4];

const NOWHERE: Extent = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];
const EVERYWHERE: Extent = [f32::NEG_INFINITY, f32::NEG_INFINITY, f32::INFINITY, f32::INFINITY];

/// The least part of the picture that holds two parts.
fn united(a: Extent, b: Extent) -> Extent {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
}

/// Whether what is seen in this part of the picture may be seen in the pixel (x, y). Rays are up to half a pixel from the pixel's middle;
/// the rest is a margin for rounding.
fn may_be_seen([left, top, right, bottom]: Extent, x: usize, y: usize) -> bool {
    (left - 1.0..right + 1.0).contains(&(x as f32)) && (top - 1.0..bottom + 1.0).contains(&(y as f32))
}

/// A hash of two numbers (Splitmix64, Steele et al. 2014).
fn hash(a: u64, b: u64) -> u64 {
    let z = a.wrapping_mul(0xd1b5_4a32_d192_ed03).wrapping_add(b.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// One of the pinhole views whose mean is a picture.
struct View {
    instant: Instant,
    /// The place within the pixel, px from its middle.
    pixel: [f32; 2],
    /// The change of the rays' slopes that makes them meet in the plane in focus.
    tilt: [f32; 2],
}

impl Texture {
    /// The texture of a kind, a [`TextureKind`] as a number.
    pub(crate) fn new(kind: usize, rng: &mut StdRng) -> Self {
        let finest = match kind {
            0 => leaves(rng, 2.5..160.0, 0.05),
            1 => leaves(rng, 1.5..30.0, 0.12),
            2 => bricks(rng),
            3 => cloudy(rng, [6.0, 90.0], 0.5),
            _ => cloudy(rng, [40.0, 40.0], 0.45),
        };
        let mut levels = vec![finest.map(|[r, g, b]| [r, g, b, 0.0])];
        while levels[levels.len() - 1].width() > 4 {
            let fine = &levels[levels.len() - 1];
            let side = fine.width() / 2;
            let coarse = Raster::from_fn(side, side, |x, y| {
                let at = |i: usize, j: usize| fine.at(2 * x + i, 2 * y + j);
                std::array::from_fn(|c| 0.25 * ((at(0, 0)[c] + at(1, 0)[c]) + (at(0, 1)[c] + at(1, 1)[c])))
            });
            levels.push(coarse);
        }
        Self(levels)
    }

    /// The colour at a place in texels of the texture after `level` halvings.
    #[inline(always)]
    pub(crate) fn at(&self, [x, y]: [f32; 2], level: f32) -> V3 {
        let level = level.clamp(0.0, (self.0.len() - 1) as f32);
        let low = level as usize;
        let share = level - low as f32;
        let levels = [low, (low + 1).min(self.0.len() - 1)];
        // The places in the texels of both levels.
        let [a, b] = levels.map(|l| SCALES[l]);
        let places = f32x4::from([x, y, x, y]) * f32x4::from([a, a, b, b]) - f32x4::splat(0.5);
        // The library's floor takes many steps where the processor is taken for any.
        let towards_zero = places.fast_trunc_int().round_float();
        let floor = towards_zero - (towards_zero.simd_gt(places) & f32x4::ONE);
        let (texel, within) = (floor.fast_trunc_int().to_array(), (places - floor).to_array());
        let between = |k: usize| {
            let [right, down] = [within[2 * k], within[2 * k + 1]];
            between(&self.0[levels[k]], [texel[2 * k], texel[2 * k + 1]], [right, down])
        };
        let mut colour = between(0);
        if share > 0.0 {
            colour = mixed(colour, between(1), share);
        }
        let [r, g, b, _] = colour.to_array();
        [r, g, b]
    }
}

/// The texels of a texture's levels per texel of the finest one.
const SCALES: [f32; TEXTURE.ilog2() as usize + 1] = {
    let mut scales = [1.0; TEXTURE.ilog2() as usize + 1];
    let mut i = 1;
    while i < scales.len() {
        scales[i] = 0.5 * scales[i - 1];
        i += 1;
    }
    scales
};

/// The colour between four texels: from the one at a place towards the next ones, by this share of the way to the right and down.
#[inline(always)]
fn between(texels: &Raster<[f32; 4]>, [x, y]: [i32; 2], [right, down]: [f32; 2]) -> f32x4 {
    // The sides of all levels are powers of 2.
    let side = texels.width();
    let wrap = |v: i32| v as usize & (side - 1);
    let (near, far) = (wrap(x), wrap(x + 1));
    let row = |y: usize| mixed(texels.at(near, y).into(), texels.at(far, y).into(), right);
    mixed(row(wrap(y)), row(wrap(y + 1)), down)
}

/// The colour between two others, `share` of the way from the first to the second.
fn mixed(a: f32x4, b: f32x4, share: f32) -> f32x4 {
    a * f32x4::splat(1.0 - share) + b * f32x4::splat(share)
}

/// A random reflectance like those of real things: mostly dark, little saturated.
fn colour(rng: &mut StdRng) -> V3 {
    let grey = 0.03 * 25f32.powf(rng.random_range(0.0..1.0));
    [0; 3].map(|_| (grey * rng.random_range(0.75..1.25f32)).min(0.95))
}

/// Disks of all sizes that cover each other; `rough` is the variation of the colour within a disk.
fn leaves(rng: &mut StdRng, radii: std::ops::Range<f32>, rough: f32) -> Raster<[f32; 3]> {
    let grain = fractal(rng, [60.0; 2], 0.6);
    let mut picture = Raster::filled(TEXTURE, TEXTURE, [0.2; 3]);
    let (inner, outer) = (radii.start.powi(-2), radii.end.powi(-2));
    // The number of disks is large enough to cover the background: it follows from their mean area and the texture's area.
    let mean_area = TAU * radii.start.powi(2) * (radii.end / radii.start).ln();
    let count = (5.0 * (TEXTURE * TEXTURE) as f32 / mean_area) as usize;
    for _ in 0..count {
        // The density of the radii is proportional to r^-3.
        let r = (inner + (outer - inner) * rng.random_range(0.0..1.0f32)).powf(-0.5);
        let (cx, cy) = (rng.random_range(0..TEXTURE) as isize, rng.random_range(0..TEXTURE) as isize);
        let c = colour(rng);
        let reach = r.ceil() as isize;
        for dy in -reach..=reach {
            let half = r * r - (dy * dy) as f32;
            if half < 0.0 {
                continue;
            }
            let half = half.sqrt() as isize;
            let wrap = |v: isize| v.rem_euclid(TEXTURE as isize) as usize;
            let row = picture.row_mut(wrap(cy + dy));
            for dx in -half..=half {
                row[wrap(cx + dx)] = c;
            }
        }
    }
    textured(&picture, &grain, rough)
}

/// Courses of bricks with mortar between them.
fn bricks(rng: &mut StdRng) -> Raster<[f32; 3]> {
    const LONG: usize = 128;
    const HIGH: usize = 64;
    let grain = fractal(rng, [30.0; 2], 0.7);
    let colours: Vec<V3> = (0..TEXTURE / LONG * (TEXTURE / HIGH))
        .map(|_| scaled([0.45, 0.22, 0.15], rng.random_range(0.5..1.4)))
        .collect();
    let picture = Raster::from_fn(TEXTURE, TEXTURE, |x, y| {
        let course = y / HIGH;
        let x = (x + course % 2 * LONG / 2) % TEXTURE;
        let mortar = x % LONG < 8 || y % HIGH < 8;
        if mortar { [0.5, 0.48, 0.45] } else { colours[course * (TEXTURE / LONG) + x / LONG] }
    });
    textured(&picture, &grain, 0.25)
}

/// A texture of fractal brightness, whose coarsest octave has these periods along x and y, texels.
fn cloudy(rng: &mut StdRng, periods: [f32; 2], rough: f32) -> Raster<[f32; 3]> {
    let (grain, base) = (fractal(rng, periods, 0.65), colour(rng));
    let base = scaled(base, 0.3 / base[1].max(0.1));
    textured(&Raster::filled(TEXTURE, TEXTURE, base), &grain, rough)
}

fn textured(picture: &Raster<[f32; 3]>, grain: &Plane, rough: f32) -> Raster<[f32; 3]> {
    Raster::from_fn(TEXTURE, TEXTURE, |x, y| {
        picture.at(x, y).map(|v| (v * (rough * grain.at(x, y)).exp()).min(1.0))
    })
}

/// A sum of octaves of value noise, of std about 1; `keep` is the amplitude of an octave over that of the next coarser one.
fn fractal(rng: &mut StdRng, periods: [f32; 2], keep: f32) -> Plane {
    const OCTAVES: i32 = 6;
    let lattices: Vec<(Plane, f32)> = (0..OCTAVES)
        .map(|o| {
            let cells = periods.map(|p| ((TEXTURE as f32 / p * 2f32.powi(o)) as usize).clamp(1, TEXTURE));
            let values: Vec<f32> = (0..cells[0] * cells[1]).map(|_| rng.random_range(-1.0..1.0)).collect();
            (Plane::from_vec(cells[0], cells[1], values).expect("as many as cells"), 2.0 * keep.powi(o))
        })
        .collect();
    Plane::from_fn(TEXTURE, TEXTURE, |x, y| {
        lattices
            .iter()
            .map(|(lattice, amplitude)| {
                let (w, h) = lattice.size();
                let at = |v: usize, n: usize| {
                    let v = v as f32 * n as f32 / TEXTURE as f32;
                    let f = v.fract();
                    (v as usize % n, (v as usize + 1) % n, f * f * (3.0 - 2.0 * f))
                };
                let ((xa, xb, fx), (ya, yb, fy)) = (at(x, w), at(y, h));
                let row = |y: usize| lattice.at(xa, y) + fx * (lattice.at(xb, y) - lattice.at(xa, y));
                amplitude * (row(ya) + fy * (row(yb) - row(ya)))
            })
            .sum()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean difference of the green values well inside the picture.
    fn difference(a: &Raster<[f32; 3]>, b: impl Fn(usize, usize) -> f32) -> f32 {
        let (w, h) = a.size();
        let places = || (h / 8..h * 7 / 8).flat_map(|y| (w / 8..w * 7 / 8).map(move |x| (x, y)));
        places().map(|(x, y)| (a.at(x, y)[1] - b(x, y)).abs()).sum::<f32>() / places().count() as f32
    }

    #[test]
    fn flow_leads_to_the_same_point_of_the_next_picture() {
        let scene = Scene::new(3, (256, 192));
        let picture = |t: f32| scene.picture(t, Exposure::default(), 0).0;
        let (now, next, flow) = (picture(2.0), picture(3.0), scene.flow(2.0));
        let error = |share: f32| {
            difference(&now, |x, y| {
                let [u, v] = flow.at(x, y).map(|v| share * v);
                next.bilinear(x as f32 + u, y as f32 + v)[1]
            })
        };
        assert!(
            error(1.0) < 0.6 * error(0.0) && error(1.0) < 0.8 * error(0.8),
            "{} {}",
            error(1.0),
            error(0.0)
        );
    }

    #[test]
    fn the_lens_blurs_what_is_out_of_focus_by_the_formula() {
        // Next to the plane in focus, a lens changes nothing; elsewhere it is the disk blur of the synthesis.
        let scene = Scene::new(5, (160, 120));
        let (sigma, focus) = (2.0, 2.0);
        let sharp = scene.picture(0.0, Exposure::default(), 0);
        let filmed = scene.picture(0.0, Exposure { lens: Some((sigma, focus)), ..Exposure::default() }, 0);
        let depth = scene.inverse_depth(0.0);
        let std = depth.map(|d| sigma * (1.0 - focus * d).abs());
        let model =
            blindaug::synth::defocus::defocus(&sharp.0, &std, blindaug::synth::defocus::Bokeh::Disk).unwrap();
        let median = |a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>| {
            let mut e: Vec<f32> = a.data().iter().zip(b.data()).map(|(a, b)| (a[1] - b[1]).abs()).collect();
            e.sort_by(f32::total_cmp);
            e[e.len() / 2]
        };
        assert!(median(&filmed.0, &model) < 0.25 * median(&filmed.0, &sharp.0));
    }

    #[test]
    fn what_a_lens_s_few_views_leave_is_weak_white_noise() {
        let scene = Scene::new(5, (160, 120));
        let through = |lens, seed| scene.picture(0.0, Exposure { fraction: 0.5, lens, readout: 0.0 }, seed).0;
        let lens = Some((6.0, 1.2));
        let (a, b) = (through(lens, 0), through(lens, 1));
        let apart = Raster::from_fn(160, 120, |x, y| a.at(x, y)[1] - b.at(x, y)[1]);
        let product = |dx: usize, dy: usize| {
            let places = || (0..119).flat_map(|y| (0..159).map(move |x| (x, y)));
            places().map(|(x, y)| apart.at(x, y) * apart.at(x + dx, y + dy)).sum::<f32>()
                / places().count() as f32
        };
        let variance = product(0, 0);
        assert!(variance > 0.0 && variance.sqrt() < 0.012, "{}", variance.sqrt());
        for (dx, dy) in [(1, 0), (0, 1)] {
            assert!(product(dx, dy).abs() < 0.1 * variance, "{dx} {dy}: {}", product(dx, dy) / variance);
        }
        // A pinhole has the same views for all pixels and leaves no noise.
        assert!(through(None, 0).data() == through(None, 1).data());
    }

    #[test]
    fn the_shutter_blurs_along_the_flow() {
        let scene = Scene::new(7, (256, 192));
        let sharp = scene.picture(4.0, Exposure::default(), 0);
        let filmed = scene.picture(4.0, Exposure { fraction: 0.8, ..Exposure::default() }, 0);
        let flow = scene.flow(4.0);
        let error = |e: f32| {
            let exposure = blindaug::model::ExposureFraction(e);
            let model = blindaug::synth::motion_blur::motion_blur(&sharp.0, &flow, exposure).unwrap();
            difference(&filmed.0, |x, y| model.at(x, y)[1])
        };
        assert!(
            error(0.8) < 0.5 * error(0.0) && error(0.8) < error(0.5),
            "{} {} {}",
            error(0.8),
            error(0.5),
            error(0.0)
        );
    }

    #[test]
    fn scenes_without_things_stay_as_they_were() {
        // Values of the first version of the scenes.
        let both = Exposure { fraction: 0.5, lens: Some((4.0, 1.0)), readout: 0.0 };
        let known = [
            (
                Exposure::default(),
                [0.219_786_44, 0.268_120_74, 0.313_481_87],
                [0.254_332_1, 0.219_841_27, 0.206_633_51],
            ),
            (both, [0.221_369_37, 0.270_051_93, 0.315_739_75], [0.264_278_14, 0.211_025_13, 0.201_401_55]),
        ];
        let off = |scene: &Scene| {
            let apart = |a: V3, b: V3| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
            let of = |(exposure, a, b)| {
                let picture = scene.picture(2.0, exposure, 1).0;
                apart(picture.at(10, 10), a).max(apart(picture.at(40, 30), b))
            };
            known.map(of).into_iter().fold(0.0, f32::max)
        };
        let scene = Scene::new(3, (64, 48));
        assert!(off(&scene) < 1e-5, "{}", off(&scene));
        // A clone is the same scene; negative control: another scene is not.
        assert!(off(&scene.clone()) == off(&scene) && off(&Scene::new(4, (64, 48))) > 0.01);
    }

    #[test]
    fn nothing_is_seen_outside_of_its_extent() {
        let scene = Scene::new(3, (64, 48));
        let things = [([20.0, 30.0], 0.1), ([50.0, 8.0], 0.3)].map(|(place, radius)| {
            let path = Path::Bouncing { height_m: 0.2, period: 9.0, phase: 0.2 };
            let centre = scene.point_at(2.0, place, 0.9);
            Thing::ball(centre, radius, TextureKind::Wood, 1).moving(path)
        });
        let scene = things.into_iter().fold(scene, Scene::with);
        let exposure = Exposure { fraction: 0.8, lens: Some((2.0, 1.5)), readout: 0.0 };
        let views = [scene.views(2.0, exposure, 32, 2)];
        let extents = scene.extents(&views);
        let rectangles = scene.rectangles.len();
        let mut seen = vec![Raster::filled(64, 48, false); extents.len()];
        for (y, x) in (0..48).flat_map(|y| (0..64).map(move |x| (y, x))) {
            for v in &views[0] {
                let [px, py] = v.pixel;
                let camera = &v.instant.camera;
                let direction = scene.direction(camera, x as f32 + px, y as f32 + py, v.tilt);
                let [from, towards] = [camera.position, direction].map(|v| in_lanes([v; 4]));
                for (n, seen) in seen[..rectangles].iter_mut().enumerate() {
                    let [met, ..] = scene.rectangles.nearest([n], from, towards);
                    seen.row_mut(y)[x] |= met.is_some();
                }
                for (i, (thing, pose)) in scene.things.iter().zip(&v.instant.things).enumerate() {
                    let hit = thing.hit(pose, camera.position, direction, f32::INFINITY);
                    seen[rectangles + i].row_mut(y)[x] |= hit.is_some();
                }
            }
        }
        // Most extents are not much larger than what is seen: without their outermost 3 px they would be too small.
        let mut tight = 0;
        for (extent, seen) in extents.iter().zip(&seen) {
            let outside = |[left, top, right, bottom]: Extent| {
                let places = (0..48).flat_map(|y| (0..64).map(move |x| (x, y)));
                let out = |&(x, y): &(usize, usize)| {
                    seen.at(x, y) && !may_be_seen([left, top, right, bottom], x, y)
                };
                places.filter(out).count()
            };
            assert_eq!(outside(*extent), 0, "{extent:?}");
            let [left, top, right, bottom] = *extent;
            tight += usize::from(outside([left + 3.0, top + 3.0, right - 3.0, bottom - 3.0]) > 0);
        }
        assert!(tight >= 6, "{tight} of {}", extents.len());
    }

    #[test]
    fn a_still_camera_sees_nothing_move_but_things() {
        let scene = Scene::new(3, (64, 48));
        let fastest = |scene: &Scene| {
            let flow = scene.flow(2.0);
            flow.data().iter().map(|f| f[0].hypot(f[1])).fold(0.0, f32::max)
        };
        let still = scene.clone().still_camera();
        assert!(fastest(&still) < 1e-3 && fastest(&scene) > 1.0);
        let picture = |scene: &Scene, t| scene.picture(t, Exposure::default(), 0);
        assert!(picture(&still, 7.0) == picture(&scene, 0.0) && picture(&scene, 7.0) != picture(&scene, 0.0));
    }

    #[test]
    fn a_rolling_shutter_makes_upright_edges_lean_as_the_motion_says() {
        // A marker that moves to the side, as its pivot is far above; it is nearer than all things of the scene.
        let scene = Scene::new(3, (160, 120)).still_camera();
        let (centre, axes) = (scene.point_at(0.0, [79.5, 59.5], 0.8), scene.facing(0.0));
        let path =
            Path::Swinging { pivot: add(centre, [0.0, -50.0, 0.0]), angle: 0.002, period: 12.0, phase: 0.0 };
        let marker = Marker { centre, axes, radius_m: 0.18, white_on_black: true, path };
        let scene = scene.with_marker(marker);
        let motion = scene.motion(0.0).at(80, 60)[0];
        assert!(motion.abs() > 5.0, "{motion}");
        // The centre of the white disk in a row, px.
        let centre = |picture: &Linear, y: usize| {
            let row = &picture.0.row(y)[18..142];
            let black = row.iter().map(|p| p[1]).fold(f32::INFINITY, f32::min);
            let sum = |f: &dyn Fn(usize) -> f32| {
                row.iter().enumerate().map(|(x, p)| f(x) * (p[1] - black)).sum::<f32>()
            };
            sum(&|x| x as f32) / sum(&|_| 1.0)
        };
        for fraction in [0.0, 0.4] {
            let of = |readout| scene.picture(0.0, Exposure { fraction, lens: None, readout }, 0);
            let (at_once, rolling) = (of(0.0), of(0.8));
            for y in [35, 50, 59, 70, 85] {
                let want = motion * 0.8 * (y as f32 / 119.0 - 0.5);
                let lean = centre(&rolling, y) - centre(&at_once, y);
                assert!((lean - want).abs() < 0.1, "row {y}: {lean} px, want {want}");
            }
            // Negative control: without it, the disk's upper and lower half lie one above the other.
            assert!((centre(&at_once, 35) - centre(&at_once, 85)).abs() < 0.25);
            assert!((centre(&rolling, 35) - centre(&rolling, 85)).abs() > 1.0);
        }
        // Through a lens, too, each row is of its own time.
        let lens = Some((1.0, 2.0));
        let of = |t, readout| scene.picture(t, Exposure { fraction: 0.0, lens, readout }, 0);
        let (rolling, early, middle) = (of(0.0, 0.8), of(-0.4 + 0.8 * 20.0 / 119.0, 0.0), of(0.0, 0.0));
        let apart = |a: &Linear| {
            let row = a.0.row(20).iter().zip(rolling.0.row(20));
            row.map(|(a, b)| (a[1] - b[1]).abs()).sum::<f32>()
        };
        assert!(apart(&early) < 0.5 * apart(&middle), "{} {}", apart(&early), apart(&middle));
    }
}
