//! The GPU against the reference on the CPU.

use blindaug::composite::{self, Shot, VirtualLayer};
use blindaug::model::{
    Capture, DefocusModel, Estimate, ExposureFraction, MotionBlurModel, NOISE_LEVELS, NoiseLevel, NoiseModel,
};
use blindaug::synth::defocus::Bokeh;
use blindaug::{CameraModel, Encoded, Flow, Plane, Premultiplied, Raster};
use blindaug_gpu::{Compositor, Depth, Gpu, Inputs, Options, Quality, Velocity, array_view};
use std::sync::LazyLock;
use wgpu::TextureFormat;

static GPU: LazyLock<Gpu> =
    LazyLock::new(|| Gpu::new().expect("the tests need a graphics device, see the message"));
static COMPOSITOR: LazyLock<Compositor> =
    LazyLock::new(|| Compositor::new(&GPU.device, &GPU.queue, TextureFormat::Rgba16Float));

fn camera(width: usize, height: usize) -> CameraModel {
    CameraModel::unknown(Capture { width, height, fps: None, frames_used: 1 }, "not given")
}

fn with_lens(mut camera: CameraModel, sigma_at_infinity: f32, focus: f32) -> CameraModel {
    camera.defocus = Estimate::Known(DefocusModel::given_lens(sigma_at_infinity, focus));
    camera
}

fn with_exposure(mut camera: CameraModel, exposure: f32) -> CameraModel {
    camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(exposure)));
    camera
}

fn with_noise(mut camera: CameraModel, scale: f32) -> CameraModel {
    let levels = std::array::from_fn::<_, NOISE_LEVELS, _>(|l| NoiseLevel {
        slope: [0.02, 0.01, 0.03].map(|v| scale * v / (l + 1) as f32),
        intercept: [0.01, 0.02, 0.015].map(|v| scale * v / (l + 1) as f32),
    });
    camera.noise = Estimate::Known(NoiseModel::given(levels, 0.97));
    camera
}

/// A number in [0, 1) that looks random.
fn hash(x: usize, y: usize, c: usize) -> f32 {
    let mut v = (x as u32).wrapping_mul(0x9e37_79b9) ^ (y as u32).wrapping_mul(0x85eb_ca6b) ^ (c as u32) << 7;
    v = (v ^ (v >> 15)).wrapping_mul(0x2c1b_3c6d);
    v = (v ^ (v >> 12)).wrapping_mul(0x297a_2d39);
    ((v ^ (v >> 15)) >> 8) as f32 / 16_777_216.0
}

/// Values that half floats and 8 bits hold exactly, so that what is compared is what is computed.
fn frame(w: usize, h: usize) -> Encoded {
    Encoded(Raster::from_fn(w, h, |x, y| {
        std::array::from_fn(|c| {
            let smooth = 0.4 + 0.2 * (0.11 * x as f32 + c as f32).sin() + 0.15 * (0.07 * y as f32).cos();
            ((smooth + 0.1 * (hash(x, y, c) - 0.5)).clamp(0.0, 1.0) * 255.0).round() / 255.0
        })
    }))
}

/// A disk with a hole, textured, of soft rim, whose depth and motion vary.
fn layer(w: usize, h: usize) -> VirtualLayer {
    let centre = (0.45 * w as f32, 0.55 * h as f32);
    let size = w.min(h) as f32;
    let alpha = |x: usize, y: usize| {
        let r = (x as f32 - centre.0).hypot(y as f32 - centre.1);
        ((0.33 * size - r).clamp(0.0, 1.0) * (r - 0.1 * size).clamp(0.0, 1.0) * 64.0).round() / 64.0
    };
    VirtualLayer {
        color: Premultiplied(Raster::from_fn(w, h, |x, y| {
            let a = alpha(x, y);
            let checker = if (x / 5 + y / 5) % 2 == 0 { 0.75 } else { 0.125 };
            [checker * a, 0.5 * a, (0.25 + 0.5 * (hash(x / 3, y / 3, 9) * 16.0).round() / 16.0) * a, a]
        })),
        inverse_depth: Some(Plane::from_fn(w, h, |x, y| {
            if alpha(x, y) > 0.0 { 0.25 + 0.25 * ((x * 32 / w) as f32) / 32.0 } else { f32::NAN }
        })),
        flow: Some(Flow::from_fn(w, h, |x, y| {
            if alpha(x, y) > 0.0 {
                [9.0 - (y * 8 / h) as f32, 3.0 + (x * 4 / w) as f32]
            } else {
                [f32::NAN; 2]
            }
        })),
    }
}

fn rgba(image: &Raster<[f32; 3]>) -> Raster<[f32; 4]> {
    image.map(|[r, g, b]| [r, g, b, 1.0])
}

fn on_gpu(frame: &Encoded, layer: &VirtualLayer, model: &CameraModel, options: &Options) -> Raster<[f32; 3]> {
    let (w, h) = frame.0.size();
    let frame = GPU.upload(&[&rgba(&frame.0)], TextureFormat::Rgba8Unorm).unwrap();
    let color = GPU.upload(&[&layer.color.0], TextureFormat::Rgba16Float).unwrap();
    let depth = layer.inverse_depth.as_ref().map(|d| GPU.upload(&[d], TextureFormat::R32Float).unwrap());
    let velocity = layer.flow.as_ref().map(|f| GPU.upload(&[f], TextureFormat::Rg16Float).unwrap());
    let inputs = Inputs {
        frame: &frame,
        color: &color,
        depth: depth.as_ref().map(|texture| Depth { texture, scale: 1.0, offset: 0.0 }),
        velocity: velocity.as_ref().map(|texture| Velocity { texture, scale: [1.0; 2] }),
    };
    let target = GPU.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width: w as u32, height: h as u32, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: TextureFormat::Rgba16Float,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    let bound = COMPOSITOR.bind(&GPU.device, &inputs).unwrap();
    let mut encoder = GPU.device.create_command_encoder(&Default::default());
    let views = [target.create_view(&Default::default())];
    COMPOSITOR.encode(&GPU.queue, &mut encoder, &bound, model, options, 3, &views, None).unwrap();
    GPU.queue.submit([encoder.finish()]);
    GPU.download::<[f32; 4]>(&target).unwrap()[0].map(|[r, g, b, _]| [r, g, b])
}

fn on_cpu(frame: &Encoded, layer: &VirtualLayer, model: &CameraModel, options: &Options) -> Raster<[f32; 3]> {
    let shot = Shot { frame, number: 3, inverse_depth: None, flow: None, with_and_without: None };
    let options = composite::Options {
        naive: options.naive,
        no_noise: options.no_noise,
        bokeh: options.bokeh,
        seed: options.seed,
    };
    composite::composite(&shot, layer, model, &options).unwrap().0
}

/// (root mean square, largest) difference.
fn difference(a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>) -> (f32, f32) {
    let pairs = || a.data().as_flattened().iter().zip(b.data().as_flattened());
    let mean = pairs().map(|(a, b)| (a - b).powi(2)).sum::<f32>() / (3 * a.data().len()) as f32;
    (mean.sqrt(), pairs().map(|(a, b)| (a - b).abs()).fold(0.0, f32::max))
}

#[test]
fn explore() {
    for (w, h) in [(1, 1), (3, 2), (160, 120), (257, 129)] {
        let (frame, layer) = (frame(w, h), layer(w, h));
        let c = || camera(w, h);
        for (name, model) in [
            ("none", c()),
            ("lens0.6", with_lens(c(), 1.0, 1.0)),
            ("lens2", with_lens(c(), 4.0, 1.0)),
            ("lens6", with_lens(c(), 12.0, 1.0)),
            ("focus", with_lens(c(), 12.0, 0.4)),
            ("motion", with_exposure(c(), 0.7)),
            ("both", with_lens(with_exposure(c(), 0.7), 8.0, 0.4)),
        ] {
            for quality in [Quality::High, Quality::Medium, Quality::Low] {
                for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
                    let options = Options { quality, bokeh, ..Default::default() };
                    let (gpu, cpu) =
                        (on_gpu(&frame, &layer, &model, &options), on_cpu(&frame, &layer, &model, &options));
                    println!("{w}x{h} {name} {quality:?} {bokeh:?} {:?}", difference(&gpu, &cpu));
                }
            }
        }
    }
}
#[test]
fn where_is_it() {
    let (w, h) = (160, 120);
    let (frame, layer) = (frame(w, h), layer(w, h));
    let model = with_lens(camera(w, h), 12.0, 1.0);
    let options = Options::default();
    let (gpu, cpu) = (on_gpu(&frame, &layer, &model, &options), on_cpu(&frame, &layer, &model, &options));
    let mut all: Vec<_> = (0..w * h)
        .map(|i| (i % w, i / w))
        .map(|(x, y)| ((gpu.at(x, y)[0] - cpu.at(x, y)[0]).abs(), x, y))
        .collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (e, x, y) in &all[..30] {
        println!(
            "{e} {x} {y} gpu {:?} cpu {:?} frame {:?}",
            gpu.at(*x, *y),
            cpu.at(*x, *y),
            frame.0.at(*x, *y)
        );
    }
}
