//! Clips of dead leaves (Lee et al., IJCV 2001): occluding discs with radii of density r^-3, which have a natural image's
//! statistics, in layers at several depths, past which the camera moves.

use blindaug::model::ExposureFraction;
use blindaug::synth::{self, defocus::Bokeh};
use blindaug::{Encoded, Flow, Linear, Plane, Raster, Transfer};

/// The inverse depths of the layers, the farthest first. A layer at inverse depth 1 moves by [`SPEED`] px a frame.
pub const LAYERS: [f32; 3] = [0.3, 0.55, 1.0];
const SPEED: f32 = 12.0;

/// The parameters of the camera in a frame.
#[derive(Clone, Copy)]
pub struct Camera {
    pub exposure: f32,
    pub sigma_at_infinity: f32,
    pub bokeh: Bokeh,
    pub focus: f32,
    pub noise: f32,
    pub moves: bool,
}

/// The camera that all tests start from.
pub const CAMERA: Camera = Camera {
    exposure: 0.5,
    sigma_at_infinity: 2.0,
    bokeh: Bokeh::Disk,
    focus: 0.9,
    noise: 0.01,
    moves: true,
};

/// A number in [0, 1) that depends only on `seed` and `i`.
fn uniform(seed: u64, i: u64) -> f32 {
    let mut z = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ i.wrapping_mul(0xd1b5_4a32_d192_ed03);
    for k in [0xbf58_476d_1ce4_e5b9u64, 0x94d0_49bb_1331_11eb] {
        z = (z ^ (z >> 30)).wrapping_mul(k);
    }
    ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
}

/// A periodic image of leaves in linear RGB with coverage, at twice the frame's resolution.
fn leaves(side: usize, seed: u64, sparse: bool) -> Raster<[f32; 4]> {
    let mut image = Raster::filled(side, side, [0.0f32; 4]);
    // The first disc that covers a pixel is the one in front.
    let discs = (side * side) as u64 / if sparse { 30_000 } else { 175 };
    for i in 0..discs {
        let u = |k: u64| uniform(seed, 16 * i + k);
        let (smallest, largest) = if sparse { (50.0f32, 80.0f32) } else { (3.0, 160.0) };
        // The radius is drawn by the inverse of the cumulative distribution of density r^-3.
        let r = (smallest.powi(-2) - u(0) * (smallest.powi(-2) - largest.powi(-2))).powf(-0.5);
        let (cx, cy) = (u(1) * side as f32, u(2) * side as f32);
        let level = 0.08 + 0.8 * u(3);
        let color: [f32; 3] = std::array::from_fn(|c| {
            Transfer::Srgb.decode((level + 0.25 * (u(4 + c as u64) - 0.5)).clamp(0.05, 0.92))
        });
        let reach = r.ceil() as isize;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                if ((dx * dx + dy * dy) as f32) < r * r {
                    let at = |c: f32, d: isize| (c as isize + d).rem_euclid(side as isize) as usize;
                    let p = &mut image.row_mut(at(cy, dy))[at(cx, dx)];
                    if p[3] == 0.0 {
                        *p = [color[0], color[1], color[2], 1.0];
                    }
                }
            }
        }
    }
    image
}

/// The scene that is filmed.
pub struct Scene {
    size: (usize, usize),
    /// The side of the textures, px.
    side: usize,
    layers: [Raster<[f32; 4]>; 3],
    /// The masks of the nearer layers, which have holes where the coverage is 0.
    holes: [Raster<[f32; 4]>; 3],
}

/// A frame with its true flow and inverse depth, which benchmarks do not use.
#[allow(dead_code)]
pub struct Shot {
    pub frame: Encoded,
    pub flow: Flow,
    pub inverse_depth: Plane,
}

impl Scene {
    pub fn new(seed: u64, size: (usize, usize)) -> Self {
        let side = (2 * size.0).next_power_of_two();
        Self {
            size,
            side,
            layers: std::array::from_fn(|i| leaves(side, seed + i as u64, false)),
            holes: std::array::from_fn(|i| leaves(side, seed + 10 + i as u64, true)),
        }
    }

    /// The frame of the scene after the camera has moved for `way` frames.
    pub fn seen(&self, way: usize, camera: &Camera, seed: u64) -> Shot {
        let (w, h) = self.size;
        let start = |layer: usize| (2.0 * SPEED * LAYERS[layer]).round() as usize * way;
        let front = |x: usize, y: usize| {
            let there = |l: usize| l == 0 || self.holes[l].at((2 * x + start(l)) % self.side, 2 * y)[3] > 0.0;
            (0..3).rev().find(|&l| there(l)).unwrap_or(0)
        };
        let sharp: Raster<[f32; 3]> = Raster::from_fn(w, h, |x, y| {
            let l = front(x, y);
            let mut sum = [0.0; 3];
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let p = self.layers[l].at((2 * x + dx + start(l)) % self.side, 2 * y + dy);
                (0..3).for_each(|c| sum[c] += 0.25 * p[c]);
            }
            sum
        });
        let inverse_depth = Plane::from_fn(w, h, |x, y| LAYERS[front(x, y)]);
        let speed = |d: f32| if camera.moves { (2.0 * SPEED * d).round() / 2.0 } else { 0.0 };
        let flow = inverse_depth.map(|d| [-speed(d), 0.0]);
        let sigma = inverse_depth.map(|d| camera.sigma_at_infinity * (1.0 - d / camera.focus).abs());
        let defocused = synth::defocus::defocus(&sharp, &sigma, camera.bokeh).unwrap();
        let blurred =
            synth::motion_blur::motion_blur(&defocused, &flow, ExposureFraction(camera.exposure)).unwrap();
        let encoded = Linear(blurred).to_encoded(Transfer::Srgb);
        let white = synth::noise::white_band_std();
        let noise = synth::noise::modulated(synth::noise::unit_bands(w, h, seed, 0), |l, _, _| {
            [camera.noise * white[l]; 3]
        });
        let frame = Raster::from_fn(w, h, |x, y| {
            let (v, n) = (encoded.0.at(x, y), noise.at(x, y));
            std::array::from_fn(|c| ((v[c] + n[c]).clamp(0.0, 1.0) * 255.0).round() / 255.0)
        });
        Shot { frame: Encoded(frame), flow, inverse_depth }
    }

    /// A clip of the scene by a camera whose parameters depend on time.
    pub fn clip(&self, frames: usize, camera: impl Fn(usize) -> Camera) -> Vec<Shot> {
        let mut way = 0;
        (0..frames)
            .map(|t| {
                let shot = self.seen(way, &camera(t), t as u64);
                way += usize::from(camera(t).moves);
                shot
            })
            .collect()
    }
}
