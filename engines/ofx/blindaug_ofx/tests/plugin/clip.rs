//! A short clip of known truth, as the hosts give it and as the library composites it.

use crate::host::{Clip, Picture, bytes_of};
use blindaug::{
    CameraModel, Encoded, Flow, Plane, Premultiplied, Raster, Transfer,
    composite::{CompositeOptions, Plate, VirtualLayer, composite, distorted_layer},
    model::inverse_of_metric,
};
use blindaug_scenes::{
    camera::{Setting, model},
    scene::{Exposure, Scene, TextureKind},
    thing::Thing,
};
use half::f16;
use openfx::sys::{generic::core::*, image_effect_v1::image_effect::*};
use std::{ffi::CStr, sync::OnceLock};

pub const SIZE: (usize, usize) = (96, 72);
pub const FRAMES: u64 = 4;
pub const REGION: [f64; 4] = [0.0, 0.0, SIZE.0 as f64, SIZE.1 as f64];
pub const WHOLE: [i32; 4] = [0, 0, SIZE.0 as i32, SIZE.1 as i32];
pub const FULL: [f64; 2] = [1.0; 2];

pub type Values = Raster<[f32; 4]>;

/// A frame's images, rows from the top.
#[derive(Clone)]
pub struct Inputs {
    /// Premultiplied light.
    pub layer: Values,
    /// Depth in m in all channels, 1e10 where there is nothing.
    pub depth: Values,
    /// Motion in px, right and down.
    pub motion: Values,
    /// Light, partly above 1.
    pub plate: Values,
}

/// A camera for the clip.
pub fn camera(exposure: f32) -> CameraModel {
    let lens = Some((2.5, 1.6));
    let setting = Setting { exposure, lens, noise: 0.03, readout: 0.3, rolling_shutter: 0.0 };
    as_kept(&model(SIZE, &setting))
}

/// The camera as a file or the node keeps it: its numbers have six digits there.
pub fn as_kept(model: &CameraModel) -> CameraModel {
    CameraModel::from_json(&model.to_json()).unwrap()
}

/// A frame of the clip, in any size: the same scene, without noise.
pub fn inputs_of(size: (usize, usize), number: u64) -> Inputs {
    let (scene, scale) = (Scene::new(3, size), size.0 as f32 / SIZE.0 as f32);
    let middle = [44.0 * scale, 40.0 * scale];
    let ball = Thing::ball(scene.point_at(1.0, middle, 1.2), 0.24, TextureKind::Bricks, 7);
    let exposure = Exposure { fraction: 0.5, lens: Some((2.5 * scale, 1.6)), readout: 0.0 };
    let t = number as f32;
    let layer = scene.layer(&ball, t);
    let plate = scene.picture(t, exposure, number);
    Inputs {
        depth: layer.inverse_depth.map(|d| [if d > 0.0 { 1.0 / d } else { 1e10 }; 4]),
        motion: layer.motion.map(|[u, v]| [u, v, 0.0, 0.0]),
        layer: layer.color.0,
        plate: plate.0.map(|[r, g, b]| [1.6 * r, 1.6 * g, 1.6 * b, 1.0]),
    }
}

/// Light with a camera's noise.
pub fn noisy(light: &Values, model: &CameraModel, number: u64) -> Values {
    let clean = encoded(light).map(|[r, g, b, _]| [r, g, b]);
    let noise = blindaug::synth::noise::noise(model.noise.known().unwrap(), &clean, 5, number);
    Raster::from_fn(light.width(), light.height(), |x, y| {
        let (v, n) = (clean.at(x, y), noise.at(x, y));
        let [r, g, b] = [0, 1, 2].map(|c| Transfer::Srgb.decode((v[c] + n[c]).max(0.0)));
        [r, g, b, 1.0]
    })
}

/// The frame of this number, from 1 on.
pub fn inputs(number: u64) -> &'static Inputs {
    static ALL: OnceLock<Vec<Inputs>> = OnceLock::new();
    let all = ALL.get_or_init(|| (1..=FRAMES).map(|number| inputs_of(SIZE, number)).collect());
    &all[number as usize - 1]
}

/// A value as a host holds it: its bytes, and what they stand for.
pub fn held(v: f32, depth: &CStr) -> (Vec<u8>, f32) {
    match depth.to_bytes() {
        b"OfxBitDepthByte" => {
            let n = (v.clamp(0.0, 1.0) * 255.0).round();
            (vec![n as u8], n / 255.0)
        }
        b"OfxBitDepthShort" => {
            let n = (v.clamp(0.0, 1.0) * 65_535.0).round();
            ((n as u16).to_ne_bytes().to_vec(), n / 65_535.0)
        }
        b"OfxBitDepthHalf" => (f16::from_f32(v).to_ne_bytes().to_vec(), f16::from_f32(v).to_f32()),
        _ => (v.to_ne_bytes().to_vec(), v),
    }
}

/// The value of bytes.
pub fn value(bytes: &[u8], depth: &CStr) -> f32 {
    match depth.to_bytes() {
        b"OfxBitDepthByte" => f32::from(bytes[0]) / 255.0,
        b"OfxBitDepthShort" => f32::from(u16::from_ne_bytes([bytes[0], bytes[1]])) / 65_535.0,
        b"OfxBitDepthHalf" => f16::from_ne_bytes([bytes[0], bytes[1]]).to_f32(),
        _ => f32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
    }
}

/// What is left of values in a host.
pub fn kept(values: &Values, depth: &CStr) -> Values {
    values.map(|p| p.map(|v| held(v, depth).1))
}

/// Half of the step of a value, and what rounding of floats may add.
pub fn half_step(v: f32, depth: &CStr) -> f32 {
    1e-6 * v.abs().max(1.0)
        + match depth.to_bytes() {
            b"OfxBitDepthByte" => 0.5 / 255.0,
            b"OfxBitDepthShort" => 0.5 / 65_535.0,
            b"OfxBitDepthHalf" => v.abs().max(6.2e-5) / 2048.0,
            _ => 0.0,
        }
}

/// Values as bytes, from the lowest row on.
pub fn bytes(values: &Values, depth: &CStr, channels: usize) -> Vec<u8> {
    let rows = (0..values.height()).rev().flat_map(|y| values.row(y));
    rows.flat_map(|p| p[..channels].iter().flat_map(|v| held(*v, depth).0)).collect()
}

/// The values of bytes of R, G, B and A, from the lowest row on.
pub fn values(bytes: &[u8], (width, height): (usize, usize), depth: &CStr) -> Values {
    let step = bytes_of(depth);
    let at = |x: usize, y: usize, c: usize| {
        value(&bytes[(((height - 1 - y) * width + x) * 4 + c) * step..], depth)
    };
    assert_eq!(bytes.len(), width * height * 4 * step);
    Raster::from_fn(width, height, |x, y| std::array::from_fn(|c| at(x, y, c)))
}

/// A picture at a place of its own.
pub fn picture_at(
    values: &Values,
    [x1, y1]: [i32; 2],
    (depth, components): (&'static CStr, &'static CStr),
    from_top: bool,
) -> Picture {
    let channels = match components.to_bytes() {
        b"OfxImageComponentRGBA" => 4,
        b"OfxImageComponentRGB" => 3,
        _ => 1,
    };
    Picture {
        bounds: [x1, y1, x1 + values.width() as i32, y1 + values.height() as i32],
        depth,
        components,
        bytes: bytes(values, depth, channels),
        from_top,
        premultiplication: kOfxImagePreMultiplied,
    }
}

pub fn picture(values: &Values, depth: &'static CStr, from_top: bool) -> Picture {
    picture_at(values, [0, 0], (depth, kOfxImageComponentRGBA), from_top)
}

/// A clip of what is picked of each frame.
pub fn host_clip(
    depth: &'static CStr,
    from_top: bool,
    pick: impl Fn(&Inputs) -> Values + Send + Sync + 'static,
) -> Clip {
    Clip::new(REGION, move |time| {
        let number = time as u64;
        (1..=FRAMES).contains(&number).then(|| picture(&pick(inputs(number)), depth, from_top))
    })
}

/// An empty picture to be rendered into.
pub fn output(bounds: [i32; 4], depth: &'static CStr, from_top: bool) -> Clip {
    let size = ((bounds[2] - bounds[0]) as usize, (bounds[3] - bounds[1]) as usize);
    Clip::new(REGION, move |_| {
        let nothing = Raster::filled(size.0, size.1, [0.25; 4]);
        let rgba = (depth, kOfxImageComponentRGBA);
        Some(picture_at(&nothing, [bounds[0], bounds[1]], rgba, from_top))
    })
}

/// Display-encoded values of light, R, G and B alone.
pub fn encoded(values: &Values) -> Values {
    values.map(|[r, g, b, a]| {
        let [r, g, b] = [r, g, b].map(|v| Transfer::Srgb.encode(v));
        [r, g, b, a]
    })
}

/// What the library makes of light.
pub struct Reference<'a> {
    pub inputs: &'a Inputs,
    pub model: &'a CameraModel,
    pub number: u64,
    pub seed: u64,
    /// Whether light above 1 is kept.
    pub unclipped: bool,
}

impl Reference<'_> {
    fn made<T>(&self, of: impl FnOnce(&Plate, &VirtualLayer, &CompositeOptions) -> blindaug::Result<T>) -> T {
        let Inputs { layer, depth, motion, plate } = self.inputs;
        let layer = VirtualLayer {
            color: Premultiplied(layer.clone()),
            inverse_depth: Some(depth.map(|z| -> f32 { inverse_of_metric(z[0]) }) as Plane),
            flow: Some(motion.map(|m| -> [f32; 2] { [m[0], m[1]] }) as Flow),
        };
        let frame = Encoded(plate.map(|[r, g, b, _]| [r, g, b].map(|v| Transfer::Srgb.encode(v))));
        let plate = Plate::new(&frame, self.number);
        let options =
            CompositeOptions { seed: self.seed, unclipped: self.unclipped, ..CompositeOptions::default() };
        of(&plate, &layer, &options).unwrap()
    }

    /// The composite, display-encoded.
    pub fn encoded(&self) -> Values {
        let made = self.made(|plate, layer, options| composite(plate, layer, self.model, options));
        made.0.map(|[r, g, b]| [r, g, b, 1.0])
    }

    /// The composite, light.
    pub fn light(&self) -> Values {
        self.encoded().map(|[r, g, b, a]| {
            let [r, g, b] = [r, g, b].map(|v| Transfer::Srgb.decode(v));
            [r, g, b, a]
        })
    }

    /// The layer with its noise, light.
    pub fn layer(&self) -> Values {
        let made = self.made(|plate, layer, options| distorted_layer(plate, layer, self.model, options));
        Raster::from_fn(made.noise.width(), made.noise.height(), |x, y| {
            let ([r, g, b, a], n) = (made.color.0.at(x, y), made.noise.at(x, y));
            [r + n[0], g + n[1], b + n[2], a]
        })
    }
}

/// The largest difference, in the steps that [`half_step`] allows: at most 1 if all values are the same.
pub fn apart(got: &Values, want: &Values, depth: &CStr) -> f32 {
    assert_eq!(got.size(), want.size());
    let pairs = got.data().as_flattened().iter().zip(want.data().as_flattened());
    pairs
        .map(|(g, w)| {
            let w =
                if [kOfxBitDepthByte, kOfxBitDepthShort].contains(&depth) { w.clamp(0.0, 1.0) } else { *w };
            (g - w).abs() / half_step(w, depth)
        })
        .fold(0.0, |a, b| if b > a || b.is_nan() { b } else { a })
}
