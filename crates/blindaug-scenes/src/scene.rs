//! Scenes whose truth is known: textured planes seen by a moving camera, cast ray by ray.
//!
//! A picture is the mean of many pinhole views, spread over the pixel, the lens and the time that the shutter is open
//! (Cook, Porter & Carpenter 1984). With one point in the lens and one in time it is the sharp frame.

use blindaug::{Flow, Linear, Plane, Raster};
use rand::{Rng, SeedableRng, rngs::StdRng};
use std::f32::consts::TAU;

type V3 = [f32; 3];

fn add(a: V3, b: V3) -> V3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn scaled(a: V3, k: f32) -> V3 {
    a.map(|v| v * k)
}

fn dot(a: V3, b: V3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: V3, b: V3) -> V3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A rectangle with a texture.
struct Surface {
    corner: V3,
    /// Unit vectors along the sides.
    sides: [V3; 2],
    size: [f32; 2],
    normal: V3,
    texture: usize,
    /// Texels of the texture per metre.
    density: f32,
    light: f32,
}

/// A texture that repeats, and its successive halvings, finest first.
struct Texture(Vec<Raster<[f32; 3]>>);

/// The side of a texture's finest level, px.
const TEXTURE: usize = 1024;
/// The number of all views of a picture through a lens, divided by the number that one pixel uses.
const POOL: usize = 64;
/// The least number of views that a pixel uses through a lens.
const OF_LENS: usize = 128;
/// The share of a lens blur's variance that smoothing of the textures stands for; the smoothing removes most of the noise of so few
/// rays. Its std is the distance between the rays of a frame, which has two pictures of n rays: sqrt(pi radius^2 / (2 n)). The std
/// of the lens blur is half its radius.
const SMOOTHED: f32 = 4.0 * std::f32::consts::PI / (2 * OF_LENS) as f32;

/// A room with things in it, and the path of a camera through it.
pub struct Scene {
    surfaces: Vec<Surface>,
    textures: Vec<Texture>,
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

/// The position and the orientation of the camera.
#[derive(Clone, Copy)]
struct Pose {
    position: V3,
    /// Unit vectors to the right, down and forward.
    axes: [V3; 3],
}

/// The shutter and the lens of a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Exposure {
    /// Exposure fraction, in [0, 1]; 0 is an instant.
    pub fraction: f32,
    /// The lens `(sigma_px_at_infinity, focus_m)`, whose blur has the std `sigma_px_at_infinity |1 - focus_m / Z|` in px; `None` is
    /// a pinhole.
    pub lens: Option<(f32, f32)>,
}

impl Scene {
    /// The scene that a number, the seed, stands for, in pictures of this size in px.
    pub fn new(number: u64, size: (usize, usize)) -> Self {
        let mut rng = StdRng::seed_from_u64(number);
        let textures = (0..5).map(|kind| Texture::new(kind, &mut rng)).collect();
        let mut scene =
            Self { surfaces: vec![], textures, path: [0.0; 4], shake: None, surges: vec![], size };
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
        let normal = cross(a, b);
        // One light comes from above on the left, another from everywhere.
        let light = 0.55 + 0.45 * dot(normal, [-0.45, -0.6, -0.66]).abs();
        self.surfaces.push(Surface { corner, sides: [a, b], size, normal, texture, density, light });
    }

    /// Focal length, px.
    fn focal(&self) -> f32 {
        0.95 * self.size.0 as f32
    }

    fn pose(&self, t: f32) -> Pose {
        const SURGE: f32 = 0.5;
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

    /// The nearest surface, its depth along the view axis in m, and the place on the surface in m.
    fn hit(&self, from: V3, direction: V3) -> Option<(&Surface, f32, [f32; 2])> {
        let mut nearest: Option<(&Surface, f32, [f32; 2])> = None;
        for s in &self.surfaces {
            let relative = add(s.corner, scaled(from, -1.0));
            let t = dot(relative, s.normal) / dot(direction, s.normal);
            if t.is_nan() || t <= 0.05 || nearest.is_some_and(|n| n.1 <= t) {
                continue;
            }
            let at = add(scaled(direction, t), scaled(relative, -1.0));
            let place = s.sides.map(|side| dot(at, side));
            if (0..2).all(|i| (0.0..=s.size[i]).contains(&place[i])) {
                nearest = Some((s, t, place));
            }
        }
        nearest
    }

    /// The light of a ray. `apart` gives the distance of a pixel's rays where they meet a surface, px, at the surface's inverse depth.
    /// The texture is smoothed by a box of twice that distance and by linear interpolation, which together have the std `apart`.
    fn light(&self, from: V3, direction: V3, apart: impl Fn(f32) -> f32) -> V3 {
        const SKY: V3 = [0.5, 0.55, 0.6];
        let Some((s, t, place)) = self.hit(from, direction) else { return SKY };
        let level = (t * s.density / self.focal() * 2.0 * apart(1.0 / t)).log2();
        let value = self.textures[s.texture].at(place.map(|p| p * s.density), level);
        scaled(value, s.light)
    }

    /// The picture that is taken at time `t` (in frames). Through a lens each pixel has its own views, as in a path tracer: their limited
    /// number leaves white noise, which differs between seeds. The same views for all pixels would leave gaps that look like sharp texture.
    pub fn picture(&self, t: f32, exposure: Exposure, seed: u64) -> Linear {
        let views = self.views(t, exposure);
        let each = if exposure.lens.is_some() { views.len() / POOL } else { views.len() };
        let apart = |d: f32| {
            let radius = exposure.lens.map_or(0.0, |(sigma, focus)| 2.0 * sigma * (1.0 - focus * d));
            (SMOOTHED.sqrt() * 0.5 * radius.abs()).max(0.2)
        };
        Linear(Raster::from_fn(self.size.0, self.size.1, |x, y| {
            let first = if each == views.len() { 0 } else { hash(seed, (y * self.size.0 + x) as u64) };
            let first = (first % views.len() as u64) as usize;
            let mut sum = [0.0; 3];
            for v in views.iter().cycle().skip(first).take(each) {
                let direction = self.direction(&v.pose, x as f32 + v.pixel[0], y as f32 + v.pixel[1], v.tilt);
                sum = add(sum, self.light(v.pose.position, direction, apart));
            }
            scaled(sum, 1.0 / each as f32)
        }))
    }

    /// Inverse depth in 1/m at the middle of the pixels, 0 where there is no surface.
    pub fn inverse_depth(&self, t: f32) -> Plane {
        let pose = self.pose(t);
        Raster::from_fn(self.size.0, self.size.1, |x, y| {
            let direction = self.direction(&pose, x as f32, y as f32, [0.0; 2]);
            self.hit(pose.position, direction).map_or(0.0, |h| 1.0 / h.1)
        })
    }

    /// Optical flow from time `t` to `t + 1`.
    pub fn flow(&self, t: f32) -> Flow {
        let next = self.pose(t + 1.0);
        self.of_points(t, |x, y, point| {
            let [u, v] = self.place(&next, point);
            [u - x as f32, v - y as f32]
        })
    }

    /// Motion at time `t`, px per frame interval: the path of each point seen then, from half an interval before to half an
    /// interval after `t`.
    pub fn motion(&self, t: f32) -> Flow {
        let [before, after] = [-0.5, 0.5].map(|d| self.pose(t + d));
        self.of_points(t, |_, _, point| {
            let (a, b) = (self.place(&before, point), self.place(&after, point));
            [b[0] - a[0], b[1] - a[1]]
        })
    }

    /// A flow whose value at each pixel follows from the pixel and the point that is seen there at time `t`.
    fn of_points(&self, t: f32, of: impl Fn(usize, usize, [f32; 3]) -> [f32; 2] + Sync) -> Flow {
        let pose = self.pose(t);
        Raster::from_fn(self.size.0, self.size.1, |x, y| {
            let direction = self.direction(&pose, x as f32, y as f32, [0.0; 2]);
            let z = self.hit(pose.position, direction).map_or(1e4, |h| h.1);
            of(x, y, add(pose.position, scaled(direction, z)))
        })
    }

    /// The place in the picture, px, at which a camera sees a point.
    fn place(&self, pose: &Pose, point: [f32; 3]) -> [f32; 2] {
        let seen = pose.axes.map(|axis| dot(add(point, scaled(pose.position, -1.0)), axis));
        let place = |i: usize, n: usize| self.focal() * seen[i] / seen[2] + 0.5 * (n as f32 - 1.0);
        [place(0, self.size.0), place(1, self.size.1)]
    }

    /// The views of a picture: along a streak enough for neighbours to lie less than a pixel apart; through a lens [`POOL`] times
    /// as many as a pixel uses.
    fn views(&self, t: f32, exposure: Exposure) -> Vec<View> {
        const FEWEST: usize = 24;
        let along = if exposure.fraction > 0.0 {
            let flow = self.flow(t);
            let fastest = flow.data().iter().map(|f| f[0].hypot(f[1])).fold(0.0f32, f32::max);
            exposure.fraction * fastest.min(60.0)
        } else {
            0.0
        };
        let along = ((1.2 * along).ceil() as usize).max(FEWEST);
        let n = if exposure.lens.is_some() { POOL * OF_LENS.max(along) } else { along };
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
            let mut pose = self.pose(t + in_time * exposure.fraction);
            if let Some((_, focus)) = exposure.lens {
                // All rays of a pixel meet in the plane in focus.
                for (axis, tilt) in pose.axes.into_iter().zip(tilt) {
                    pose.position = add(pose.position, scaled(axis, focus * tilt));
                }
            }
            View { pose, pixel: [px - 0.5, py - 0.5], tilt }
        };
        (0..n).map(view).collect()
    }
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
    pose: Pose,
    /// The place within the pixel, px from its middle.
    pixel: [f32; 2],
    /// The change of the rays' slopes that makes them meet in the plane in focus.
    tilt: [f32; 2],
}

impl Texture {
    /// The texture of a kind: 0 and 1 are large and small dead leaves, which have the statistics of photographs (Lee, Mumford &
    /// Huang 2001), 2 is bricks, 3 wood, 4 a rough surface.
    fn new(kind: usize, rng: &mut StdRng) -> Self {
        let finest = match kind {
            0 => leaves(rng, 2.5..160.0, 0.05),
            1 => leaves(rng, 1.5..30.0, 0.12),
            2 => bricks(rng),
            3 => cloudy(rng, [6.0, 90.0], 0.5),
            _ => cloudy(rng, [40.0, 40.0], 0.45),
        };
        let mut levels = vec![finest];
        while levels[levels.len() - 1].width() > 4 {
            let fine = &levels[levels.len() - 1];
            let side = fine.width() / 2;
            let coarse = Raster::from_fn(side, side, |x, y| {
                let at = |i: usize, j: usize| fine.at(2 * x + i, 2 * y + j);
                scaled(add(add(at(0, 0), at(1, 0)), add(at(0, 1), at(1, 1))), 0.25)
            });
            levels.push(coarse);
        }
        Self(levels)
    }

    /// The colour at a place in texels of the texture after `level` halvings.
    fn at(&self, place: [f32; 2], level: f32) -> V3 {
        let level = level.clamp(0.0, (self.0.len() - 1) as f32);
        let (low, f) = (level as usize, level.fract());
        let a = self.within(low, place);
        if f == 0.0 {
            return a;
        }
        let b = self.within((low + 1).min(self.0.len() - 1), place);
        add(scaled(a, 1.0 - f), scaled(b, f))
    }

    fn within(&self, level: usize, place: [f32; 2]) -> V3 {
        let texture = &self.0[level];
        let (side, texel) = (texture.width(), (1 << level) as f32);
        let [x, y] = place.map(|p| p / texel - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let wrap = |v: f32| (v as isize).rem_euclid(side as isize) as usize;
        let (xa, xb, ya, yb) = (wrap(x0), wrap(x0 + 1.0), wrap(y0), wrap(y0 + 1.0));
        let row = |y: usize| add(scaled(texture.at(xa, y), 1.0 - fx), scaled(texture.at(xb, y), fx));
        add(scaled(row(ya), 1.0 - fy), scaled(row(yb), fy))
    }
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
        let filmed = scene.picture(0.0, Exposure { fraction: 0.0, lens: Some((sigma, focus)) }, 0);
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
        let through = |lens, seed| scene.picture(0.0, Exposure { fraction: 0.5, lens }, seed).0;
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
        let filmed = scene.picture(4.0, Exposure { fraction: 0.8, lens: None }, 0);
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
}
