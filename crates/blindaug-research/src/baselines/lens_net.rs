//! LensNet-like: a small network for each camera that blurs a rendered object as the camera's lens does, with what it learnt from
//! captures of known targets. It follows what the Blind Augmentation paper says of its LensNet baseline: colour, alpha and depth go in,
//! the defocused layer comes out, and there is no motion blur.
//!
//! [`captures`] makes the captures of a camera, `train/lensnet.py` trains a network with them, and `models/` holds the networks.

use crate::sceneries::{COUNT, Take};
use blindaug::composite::VirtualLayer;
use blindaug::{Premultiplied, Raster};
use blindaug_io::{Error, Result};
use blindaug_nets::runtime::{Session, Tensor};
use blindaug_scenes::scene::{Exposure, Layer, Scene, TextureKind};
use blindaug_scenes::thing::Thing;
use rand::{Rng, SeedableRng, rngs::StdRng};
use std::path::Path;

/// The width in px of the pictures of the cameras that the networks were trained for.
const WIDTH: usize = 512;
/// The number of cameras that have a network, one for each scenery.
pub const CAMERAS: usize = COUNT;
/// The side of a capture, px.
pub const SIDE: usize = 256;
/// The sides of what a network is shown are multiples of this, since it halves them three times.
const MULTIPLE: usize = 8;
/// The distance from the object that blur does not reach, px of a picture [`WIDTH`] px wide.
const REACH: usize = 40;

/// The network of each scenery's camera, in the order of the sceneries.
const NETWORKS: [&[u8]; COUNT] = [
    include_bytes!("../../models/lensnet-out-of-focus.onnx"),
    include_bytes!("../../models/lensnet-bouncing.onnx"),
    include_bytes!("../../models/lensnet-pendulum.onnx"),
    include_bytes!("../../models/lensnet-fluttering.onnx"),
    include_bytes!("../../models/lensnet-noise.onnx"),
    include_bytes!("../../models/lensnet-still-camera.onnx"),
];

/// A target as it is rendered, and as a camera captures it.
pub struct Capture {
    /// The target, sharp.
    pub layer: Layer,
    /// The target through the camera's lens, cut out from its background.
    pub captured: Premultiplied,
}

/// The name of a scenery and captures of targets by its camera: balls and boards of all textures, 1 to 8 m away, that are none of the
/// scenery's objects. Nothing moves, and there is no noise.
///
/// # Panics
/// If there is no scenery of this number.
pub fn captures(scenery: usize, count: usize, seed: u64) -> (&'static str, impl Iterator<Item = Capture>) {
    assert!(scenery < COUNT, "there are {COUNT} sceneries");
    let of = Take { scenery, seed: 0, frames: 1, size: (WIDTH, WIDTH * 3 / 4) }.scenery();
    let exposure = Exposure { lens: of.device.setting.lens, ..Exposure::default() };
    let scene = Scene::new(seed, (SIDE, SIDE)).still_camera();
    let captures = (0..count as u64).map(move |i| {
        let mut rng = StdRng::seed_from_u64((seed << 32) + i);
        let depth = 1.0 / rng.random_range(1.0 / 8.0..1.0f32);
        let place = [0; 2].map(|_| SIDE as f32 * rng.random_range(0.35..0.65f32));
        let radius = rng.random_range(14.0..56.0f32) * depth / scene.focal();
        use TextureKind::{Bricks, LargeLeaves, Rough, SmallLeaves, Wood};
        let texture = [LargeLeaves, SmallLeaves, Bricks, Wood, Rough][i as usize % 5];
        let centre = scene.point_at(0.0, place, depth);
        let target = match i % 3 {
            0 => {
                let tall = rng.random_range(0.6..1.6f32);
                Thing::board(centre, scene.facing(0.0), [2.0 * radius, tall * radius], texture, rng.random())
            }
            _ => Thing::ball(centre, radius, texture, rng.random()),
        };
        Capture { layer: scene.layer(&target, 0.0), captured: scene.cutout(&target, 0.0, exposure, i) }
    });
    (of.name, captures)
}

/// The layer as the network of a scenery's camera blurs it.
///
/// # Errors
/// If the network does not run.
pub(crate) fn blurred(layer: &VirtualLayer, scenery: usize) -> Result<Premultiplied> {
    let path = Path::new("lensnet");
    let network = Session::new(path, NETWORKS[scenery].to_vec())?;
    let color = &layer.color.0;
    let (width, height) = color.size();
    // A network knows blur in px of one width: the layer is shown to it in that width, and what it gives is brought back.
    let k = WIDTH as f32 / width as f32;
    let Some([x0, x1, y0, y1]) = bounds(color, (REACH as f32 / k) as usize) else {
        return Ok(layer.color.clone());
    };
    // Colour, alpha, and inverse depth times alpha.
    let facts = Raster::from_fn(width, height, |x, y| {
        let [r, g, b, a] = color.at(x, y);
        let inverse = layer.inverse_depth.as_ref().map_or(0.0, |d| d.at(x, y));
        [r, g, b, a, if inverse.is_finite() { a * inverse } else { 0.0 }]
    });
    let [w, h] = [x1 - x0, y1 - y0].map(|n| ((n as f32 * k).ceil() as usize).next_multiple_of(MULTIPLE));
    let shown = Raster::from_fn(w, h, |x, y| {
        let of = |first: usize, i: usize| first as f32 + (i as f32 + 0.5) / k - 0.5;
        facts.bilinear(of(x0, x), of(y0, y))
    });
    let data: Vec<f32> = (0..5).flat_map(|c| shown.data().iter().map(move |p| p[c])).collect();
    let out = network.run(vec![Tensor { shape: vec![1, 5, h, w], data }], 0)?;
    if out.shape != [1, 4, h, w] {
        return Err(Error::new(path, format!("the network gives {:?}, not [1, 4, {h}, {w}]", out.shape)));
    }
    let out = Raster::from_fn(w, h, |x, y| {
        std::array::from_fn::<f32, 4, _>(|c| out.data[(c * h + y) * w + x].max(0.0))
    });
    Ok(Premultiplied(Raster::from_fn(width, height, |x, y| {
        let of = |first: usize, i: usize| ((i - first) as f32 + 0.5) * k - 0.5;
        match (x0..x1).contains(&x) && (y0..y1).contains(&y) {
            true => out.bilinear(of(x0, x), of(y0, y)),
            false => [0.0; 4],
        }
    })))
}

/// The columns and rows, from the first to the one past the last, that are at most `reach` px away from what can be seen; `None` if
/// nothing can.
fn bounds(color: &Raster<[f32; 4]>, reach: usize) -> Option<[usize; 4]> {
    let (width, height) = color.size();
    let column = |x: &usize| (0..height).any(|y| color.at(*x, y)[3] > 0.0);
    let row = |y: &usize| color.row(*y).iter().any(|p| p[3] > 0.0);
    let around =
        |first: usize, last: usize, n: usize| (first.saturating_sub(reach), (last + 1 + reach).min(n));
    let (x0, x1) = around((0..width).find(column)?, (0..width).rfind(column)?, width);
    let (y0, y1) = around((0..height).find(row)?, (0..height).rfind(row)?, height);
    Some([x0, x1, y0, y1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::metrics::psnr;
    use blindaug::{Encoded, Linear, Transfer};

    /// The layer over grey.
    fn over_grey(layer: &Premultiplied) -> Encoded {
        Linear(layer.0.map(|[r, g, b, a]| [r, g, b].map(|v| v + 0.3 * (1.0 - a)))).to_encoded(Transfer::Srgb)
    }

    /// The capture's layer in a picture as wide as those that the networks were trained for.
    fn in_whole_picture(layer: Layer) -> VirtualLayer {
        let color = |x, y| if x < SIDE { layer.color.0.at(x, y) } else { [0.0; 4] };
        let depth = |x, y| if x < SIDE { layer.inverse_depth.at(x, y) } else { f32::NAN };
        let (color, depth) = (Raster::from_fn(WIDTH, SIDE, color), Raster::from_fn(WIDTH, SIDE, depth));
        VirtualLayer { color: Premultiplied(color), inverse_depth: Some(depth), flow: None }
    }

    #[test]
    fn each_network_blurs_as_its_own_camera_does() {
        for scenery in 0..COUNT {
            // The sums of the squared errors of the sharp target, of the own network and of another one, on targets that none learnt from.
            let mut errors = [0.0; 3];
            for capture in captures(scenery, 4, 99).1 {
                let truth = over_grey(&capture.captured);
                let layer = in_whole_picture(capture.layer);
                let by = |of: usize| blurred(&layer, of % COUNT).unwrap();
                for (sum, made) in errors.iter_mut().zip([layer.color.clone(), by(scenery), by(scenery + 3)])
                {
                    let made = Premultiplied(made.0.crop(0, 0, SIDE, SIDE));
                    *sum += 10f64.powf(-0.1 * psnr(&over_grey(&made), &truth, None).unwrap());
                }
            }
            let [sharp, own, other] = errors.map(|e| -10.0 * e.log10());
            assert!(own > sharp && own > other + 3.0, "scenery {scenery}: {sharp}, {own}, {other} dB");
        }
    }
}
