//! The results of the GPU against those of the reference on the CPU.

use blindaug::composite::{self, CompositeOptions, Plate, VirtualLayer};
use blindaug::model::{
    BlurSpace, Capture, CurveLevel, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction, KNOTS,
    MotionBlurModel, NOISE_LEVELS, NoiseCurves, NoiseLevel, NoiseModel, SharpeningModel,
};
use blindaug::pyramid;
use blindaug::synth::{self, defocus::Bokeh};
use blindaug::{CameraModel, Encoded, Flow, Plane, Premultiplied, Raster, Transfer};
use blindaug_gpu::{Area, Block, Compositor, Depth, Frame, Inputs, Quality, Velocity, layer_views};
use std::sync::LazyLock;
use wgpu::TextureFormat;

mod common;
use common::{GPU, no_gpu};
static COMPOSITOR: LazyLock<Compositor> =
    LazyLock::new(|| Compositor::new(&GPU.device, &GPU.queue, TextureFormat::Rgba16Float));

fn camera(width: usize, height: usize) -> CameraModel {
    CameraModel::unknown(Capture { width, height, fps: None, frames_used: 1, pixel_aspect: 1.0 }, "not given")
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

fn with_sharpening(mut camera: CameraModel, amount: f32, radius_px: f32) -> CameraModel {
    camera.sharpening = Estimate::Known(SharpeningModel::given(amount, radius_px));
    camera
}

/// A number in [0, 1) that looks random.
fn hash(x: usize, y: usize, c: usize) -> f32 {
    let mut v = (x as u32).wrapping_mul(0x9e37_79b9) ^ (y as u32).wrapping_mul(0x85eb_ca6b) ^ (c as u32) << 7;
    v = (v ^ (v >> 15)).wrapping_mul(0x2c1b_3c6d);
    v = (v ^ (v >> 12)).wrapping_mul(0x297a_2d39);
    ((v ^ (v >> 15)) >> 8) as f32 / 16_777_216.0
}

/// A frame of values that half floats and 8 bits hold exactly, so that rounding of the input does not enter the comparison.
fn frame(w: usize, h: usize) -> Encoded {
    Encoded(Raster::from_fn(w, h, |x, y| {
        std::array::from_fn(|c| {
            let smooth = 0.4 + 0.2 * (0.11 * x as f32 + c as f32).sin() + 0.15 * (0.07 * y as f32).cos();
            ((smooth + 0.1 * (hash(x, y, c) - 0.5)).clamp(0.0, 1.0) * 255.0).round() / 255.0
        })
    }))
}

/// A layer with a textured disk with a hole and a soft rim, whose depth and motion vary.
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

/// The input textures, with an array layer for each eye.
struct Eyes {
    frame: wgpu::Texture,
    color: wgpu::Texture,
    depth: Option<wgpu::Texture>,
    velocity: Option<wgpu::Texture>,
}

impl Eyes {
    fn new(frames: &[&Encoded], layers: &[&VirtualLayer]) -> Self {
        let each = |of: &dyn Fn(&VirtualLayer) -> Option<Plane>| {
            layers.iter().map(|l| of(l)).collect::<Option<Vec<_>>>()
        };
        let frames: Vec<_> = frames.iter().map(|f| rgba(&f.0)).collect();
        let color: Vec<_> = layers.iter().map(|l| &l.color.0).collect();
        let depth = each(&|l| l.inverse_depth.clone());
        let flow = layers.iter().map(|l| l.flow.as_ref()).collect::<Option<Vec<_>>>();
        Self {
            frame: GPU.upload(&frames.iter().collect::<Vec<_>>(), TextureFormat::Rgba8Unorm).unwrap(),
            color: GPU.upload(&color, TextureFormat::Rgba16Float).unwrap(),
            depth: depth.map(|d| GPU.upload(&d.iter().collect::<Vec<_>>(), TextureFormat::R32Float).unwrap()),
            velocity: flow.map(|f| GPU.upload(&f, TextureFormat::Rg16Float).unwrap()),
        }
    }

    fn inputs(&self) -> Inputs<'_> {
        Inputs {
            frame: &self.frame,
            color: &self.color,
            depth: self.depth.as_ref().map(|texture| Depth {
                texture,
                scale: 1.0,
                offset: 0.0,
                nothing: None,
            }),
            velocity: self.velocity.as_ref().map(|texture| Velocity { texture, scale: [1.0; 2] }),
            cleared: false,
            apart: true,
        }
    }

    fn composite(
        &self,
        model: &CameraModel,
        options: &CompositeOptions,
        number: u64,
    ) -> Vec<Raster<[f32; 3]>> {
        composite_of(&self.inputs(), Frame { number, ..of_frame(model, options) })
    }
}

/// Frame 3 over its whole area and in high quality, without targets.
fn of_frame<'a>(model: &'a CameraModel, options: &CompositeOptions) -> Frame<'a> {
    let (options, quality) = (*options, Quality::High);
    Frame {
        model,
        options,
        quality,
        number: 3,
        area: None,
        targets: &[],
        frame_in_targets: false,
        timer: None,
    }
}

/// A texture that can be composited into, of the size of `frame`.
fn target_like(frame: &wgpu::Texture) -> wgpu::Texture {
    GPU.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: frame.size(),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: TextureFormat::Rgba16Float,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT
            | wgpu::TextureUsages::COPY_SRC
            | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })
}

/// The eyes' composites; the targets are made here.
fn composite_of(inputs: &Inputs, frame: Frame) -> Vec<Raster<[f32; 3]>> {
    composite_by(&COMPOSITOR, inputs, frame)
}

/// The eyes' composites by a compositor for targets of half floats.
fn composite_by(compositor: &Compositor, inputs: &Inputs, frame: Frame) -> Vec<Raster<[f32; 3]>> {
    let target = target_like(inputs.frame);
    let views = layer_views(&target);
    let bound = compositor.bind(&GPU.device, inputs).unwrap();
    let mut encoder = GPU.device.create_command_encoder(&Default::default());
    compositor.encode(&GPU.queue, &mut encoder, &bound, &Frame { targets: &views, ..frame }).unwrap();
    GPU.queue.submit([encoder.finish()]);
    let images = GPU.download::<[f32; 4]>(&target).unwrap();
    images.iter().map(|i| i.map(|[r, g, b, _]| [r, g, b])).collect()
}

fn on_gpu(
    frame: &Encoded,
    layer: &VirtualLayer,
    model: &CameraModel,
    options: &CompositeOptions,
) -> Raster<[f32; 3]> {
    Eyes::new(&[frame], &[layer]).composite(model, options, 3).remove(0)
}

fn on_cpu(
    frame: &Encoded,
    layer: &VirtualLayer,
    model: &CameraModel,
    options: &CompositeOptions,
) -> Raster<[f32; 3]> {
    let plate = Plate::new(frame, 3);
    composite::composite(&plate, layer, model, options).unwrap().0
}

/// The root mean square difference of encoded values.
fn difference(a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>) -> f32 {
    let pairs = a.data().as_flattened().iter().zip(b.data().as_flattened());
    (pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>() / (3 * a.data().len()) as f32).sqrt()
}

/// The tolerance of half floats between the passes and in the target: 2^-11 of the value, and half that again.
const ROUNDING: f32 = 5e-4;

/// The tolerance of blur. Where it is computed on a smaller image, its rim is as soft as that image's pixels, and beyond the frame's edge
/// the last pixel of the smaller image is repeated instead of that of the frame. Both errors grow as the image that is used shrinks.
fn blur_tolerance(quality: Quality, bokeh: Bokeh) -> f32 {
    match (quality, bokeh) {
        (Quality::High, Bokeh::Gaussian) => 0.002,
        (Quality::Medium, Bokeh::Gaussian) => 0.0025,
        (Quality::Low, Bokeh::Gaussian) => 0.0035,
        (Quality::High, _) => 0.003,
        (Quality::Medium, _) => 0.0035,
        (Quality::Low, _) => 0.006,
    }
}

const QUALITIES: [Quality; 3] = [Quality::High, Quality::Medium, Quality::Low];

/// Cameras with one effect or several, whose parameters are off by the factor `wrong`.
fn cameras(w: usize, h: usize, wrong: f32) -> Vec<(&'static str, CameraModel)> {
    let c = || camera(w, h);
    let quadratic = DefocusCurve::Quadratic { a: 4.0, b: 9.0, c: -1.5, inverse_depth_range: [0.25, 0.6] };
    let mut of_paper = c();
    of_paper.defocus = Estimate::Known(DefocusModel::given(quadratic, DepthKind::Metric));
    of_paper.blur_space = BlurSpace::Encoded;
    if let (Estimate::Known(d), true) = (&mut of_paper.defocus, wrong != 1.0)
        && let DefocusCurve::Quadratic { c, .. } = &mut d.curve
    {
        *c *= wrong.powi(2);
    }
    vec![
        ("slightly out of focus", with_lens(c(), wrong * 1.0, 1.0)),
        ("out of focus", with_lens(c(), wrong * 4.0, 1.0)),
        ("far out of focus", with_lens(c(), wrong * 12.0, 1.0)),
        ("in focus inside", with_lens(c(), wrong * 12.0, 0.4)),
        ("the paper's, in encoded values", of_paper),
        ("motion", with_exposure(c(), wrong * 0.7)),
        ("lens and motion", with_lens(with_exposure(c(), wrong * 0.7), wrong * 8.0, 0.4)),
    ]
}

#[test]
fn every_blur_agrees_with_the_reference() {
    if no_gpu() {
        return;
    }
    for (w, h) in [(1, 1), (3, 2), (5, 90), (160, 120), (257, 129)] {
        let (frame, layer) = (frame(w, h), layer(w, h));
        let (right, wrong) = (cameras(w, h, 1.0), cameras(w, h, 1.2));
        for ((name, model), (_, wrong)) in right.iter().zip(&wrong) {
            for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
                let options = CompositeOptions { bokeh: Some(bokeh), ..Default::default() };
                let reference = on_cpu(&frame, &layer, model, &options);
                let eyes = Eyes::new(&[&frame], &[&layer]);
                for quality in QUALITIES {
                    let of_frame = Frame { quality, ..of_frame(model, &options) };
                    let got = difference(&composite_of(&eyes.inputs(), of_frame)[0], &reference);
                    let tolerance = blur_tolerance(quality, bokeh);
                    println!("{w} x {h}, {name}, {quality:?}, {bokeh:?}: {got:.5} (tolerance {tolerance})");
                    assert!(got < tolerance, "{w} x {h}, {name}, {quality:?}, {bokeh:?}: {got}");
                }
                // A camera with other parameters exceeds the tolerance.
                if (w, h) == (160, 120) {
                    let other = on_gpu(&frame, &layer, wrong, &options);
                    let got = difference(&other, &reference);
                    assert!(got > blur_tolerance(Quality::High, bokeh), "{name}, {bokeh:?}: {got}");
                }
            }
        }
    }
}

#[test]
fn a_shutter_s_phase_moves_the_object_as_in_the_reference() {
    if no_gpu() {
        return;
    }
    let (w, h) = (160, 120);
    let (frame, layer) = (frame(w, h), layer(w, h));
    let options = CompositeOptions { no_noise: true, ..Default::default() };
    let of = |phase_degrees: Option<f32>| {
        let mut model = with_exposure(camera(w, h), 0.5);
        if let Estimate::Known(m) = &mut model.motion_blur {
            m.phase_degrees = phase_degrees;
        }
        model
    };
    let tolerance = blur_tolerance(Quality::High, Bokeh::Gaussian);
    for phase in [0.0, -180.0, -90.0, 20.0] {
        let reference = on_cpu(&frame, &layer, &of(Some(phase)), &options);
        let got = difference(&on_gpu(&frame, &layer, &of(Some(phase)), &options), &reference);
        println!("{phase} degrees: {got:.5} (tolerance {tolerance})");
        assert!(got < tolerance, "{phase}: {got}");
        // A centred shutter is another, except at -90 degrees, where it is the same.
        let centred = difference(&on_gpu(&frame, &layer, &of(None), &options), &reference);
        assert_eq!(centred > tolerance, phase != -90.0, "{phase}: {centred}");
    }
}

/// The tolerance of sharpening. Half floats hold the change that the layer makes to the frame, and the mask multiplies their rounding by at
/// most 1 + amount. Both iterations that unsharpen leave up to 0.002 of what the sharpening did, which the mask brings back to the frame's
/// contrast.
fn sharpening_tolerance(amount: f32) -> f32 {
    ROUNDING + 0.0001 * (1.0 + amount)
}

#[test]
fn sharpening_agrees_with_the_reference() {
    if no_gpu() {
        return;
    }
    for (w, h) in [(1, 1), (3, 2), (160, 120), (257, 129)] {
        let (frame, layer) = (frame(w, h), layer(w, h));
        for (amount, radius) in [(0.2, 0.6), (0.5, 1.0), (1.0, 1.0), (1.0, 4.0), (5.0, 1.5), (20.0, 1.0)] {
            let both = |c| with_lens(with_exposure(c, 0.7), 8.0, 0.4);
            let encoded = |mut c: CameraModel| {
                c.blur_space = BlurSpace::Encoded;
                c
            };
            for (name, model, blurs) in [
                ("sharpening", camera(w, h), false),
                ("sharpening of encoded values", encoded(camera(w, h)), false),
                ("sharpening, lens and motion", both(camera(w, h)), true),
            ] {
                let options = CompositeOptions::default();
                let reference =
                    on_cpu(&frame, &layer, &with_sharpening(model.clone(), amount, radius), &options);
                let gpu =
                    |model: &CameraModel| difference(&on_gpu(&frame, &layer, model, &options), &reference);
                // The error of blur is smooth, so that the mask adds little to it.
                let blur = if blurs { blur_tolerance(Quality::High, Bokeh::Gaussian) } else { 0.0 };
                let tolerance = sharpening_tolerance(amount) + blur;
                let got = gpu(&with_sharpening(model.clone(), amount, radius));
                println!("{w} x {h}, {name} by {amount}, {radius} px: {got:.5} (tolerance {tolerance:.5})");
                assert!(got < tolerance, "{w} x {h}, {name} by {amount}, {radius} px: {got}");
                // The tolerance is small enough to detect another amount, and sharpening that is left out.
                if (w, h) == (160, 120) && !blurs {
                    let [other, none] =
                        [gpu(&with_sharpening(model.clone(), 1.25 * amount, radius)), gpu(&model)];
                    println!("  amount * 1.25: {other:.5}; without: {none:.5}");
                    assert!(other > tolerance && none > 2.0 * tolerance, "{other} {none}");
                }
            }
        }
    }
}

#[test]
fn a_camera_may_begin_to_sharpen_and_stop_again() {
    if no_gpu() {
        return;
    }
    let (w, h) = (97, 61);
    let frames = [frame(w, h), Encoded(frame(w, h).0.map(|[r, g, b]| [b, r, g]))];
    let layers = [layer(w, h), layer(w, h)];
    let eyes = Eyes::new(&frames.each_ref(), &layers.each_ref());
    let plain = with_lens(camera(w, h), 8.0, 0.4);
    let target = target_like(&eyes.frame);
    let views = layer_views(&target);
    let bound = COMPOSITOR.bind(&GPU.device, &eyes.inputs()).unwrap();
    let composite = |model: &CameraModel| {
        let frame = Frame { targets: &views, ..of_frame(model, &CompositeOptions::default()) };
        let mut encoder = GPU.device.create_command_encoder(&Default::default());
        COMPOSITOR.encode(&GPU.queue, &mut encoder, &bound, &frame).unwrap();
        GPU.queue.submit([encoder.finish()]);
        let images = GPU.download::<[f32; 4]>(&target).unwrap();
        images.iter().map(|i| i.map(|[r, g, b, _]| [r, g, b])).collect::<Vec<_>>()
    };
    // The composite of each eye is the same as that of the eye alone, whatever was composited before.
    for (amount, radius) in [(0.0, 1.0), (1.0, 2.0), (0.4, 0.7), (0.0, 1.0)] {
        let model = match amount {
            0.0 => plain.clone(),
            _ => with_sharpening(plain.clone(), amount, radius),
        };
        let both = composite(&model);
        for eye in 0..2 {
            let alone = on_gpu(&frames[eye], &layers[eye], &model, &CompositeOptions::default());
            assert_eq!(both[eye], alone, "amount {amount}, eye {eye}");
        }
        assert!(difference(&both[0], &both[1]) > 0.05);
    }
    // Neither a camera with an amount of 0 nor a naive composite sharpens.
    assert_eq!(composite(&with_sharpening(plain.clone(), 0.0, 1.0)), composite(&plain));
    let naive = CompositeOptions { naive: true, ..Default::default() };
    let sharpening = with_sharpening(plain.clone(), 1.0, 1.0);
    assert_eq!(
        on_gpu(&frames[0], &layers[0], &sharpening, &naive),
        on_gpu(&frames[0], &layers[0], &plain, &naive)
    );
    // A mask with too many taps is an error.
    let wide = with_sharpening(plain, 1.0, 1000.0);
    let frame = Frame { targets: &views, ..of_frame(&wide, &CompositeOptions::default()) };
    let mut encoder = GPU.device.create_command_encoder(&Default::default());
    let error = COMPOSITOR.encode(&GPU.queue, &mut encoder, &bound, &frame).unwrap_err().to_string();
    assert!(error.contains("a radius of 1000 px"), "{error}");
}

#[test]
fn without_effects_it_is_the_naive_composite() {
    if no_gpu() {
        return;
    }
    let (frame, layer) = (frame(97, 61), layer(97, 61));
    let model = with_noise(with_lens(with_exposure(camera(97, 61), 0.5), 9.0, 1.0), 1.0);
    let naive = CompositeOptions { naive: true, ..Default::default() };
    let reference = on_cpu(&frame, &layer, &model, &naive);
    for model in [&model, &camera(97, 61)] {
        assert!(difference(&on_gpu(&frame, &layer, model, &naive), &reference) < ROUNDING);
    }
    assert!(
        difference(&on_gpu(&frame, &layer, &model, &CompositeOptions::default()), &reference)
            > 10.0 * ROUNDING
    );
    // Where nothing virtual is seen, the result is the frame, bit by bit.
    let empty = VirtualLayer { color: Premultiplied(Raster::filled(97, 61, [0.0; 4])), ..layer };
    let out = on_gpu(&frame, &empty, &model, &CompositeOptions::default());
    let eight_bit = |i: &Raster<[f32; 3]>| i.map(|v| v.map(|v| (v * 255.0).round()));
    assert_eq!(eight_bit(&out), eight_bit(&frame.0));
}

#[test]
fn linear_output_is_the_light_of_the_reference() {
    if no_gpu() {
        return;
    }
    let (w, h) = (160, 120);
    let (frame, layer) = (frame(w, h), layer(w, h));
    let plain = with_lens(with_exposure(camera(w, h), 0.7), 8.0, 0.4);
    let linear = Compositor::new(&GPU.device, &GPU.queue, TextureFormat::Rgba16Float).with_linear_output();
    let eyes = Eyes::new(&[&frame], &[&layer]);
    let options = CompositeOptions::default();
    // A camera that sharpens has a last pass of its own.
    for model in [plain.clone(), with_sharpening(plain, 1.0, 1.0)] {
        let reference = on_cpu(&frame, &layer, &model, &options);
        let by = |compositor: &Compositor| {
            let light = composite_by(compositor, &eyes.inputs(), of_frame(&model, &options)).remove(0);
            difference(&light.map(|v| v.map(|v| Transfer::Srgb.encode(v))), &reference)
        };
        let tolerance = blur_tolerance(Quality::High, Bokeh::Gaussian) + sharpening_tolerance(1.0);
        let [light, encoded] = [&linear, &*COMPOSITOR].map(by);
        println!("light: {light}; encoded values taken for light: {encoded}");
        assert!(light < tolerance && encoded > 10.0 * tolerance, "{light} {encoded}");
    }
}

#[test]
fn eyes_do_not_see_each_other() {
    if no_gpu() {
        return;
    }
    let (w, h) = (70, 50);
    let frames = [frame(w, h), Encoded(frame(w, h).0.map(|[r, g, b]| [b, r, g]))];
    let mut other = layer(w, h);
    other.color = Premultiplied(Raster::from_fn(w, h, |x, y| layer(w, h).color.0.at(w - 1 - x, y)));
    other.inverse_depth = other.inverse_depth.map(|d| Raster::from_fn(w, h, |x, y| d.at(w - 1 - x, y)));
    other.flow = None;
    let flow = layer(w, h).flow.unwrap();
    other.flow = Some(Raster::from_fn(w, h, |x, y| flow.at(w - 1 - x, y)));
    let layers = [layer(w, h), other];
    let model = with_lens(with_exposure(camera(w, h), 0.7), 8.0, 0.4);
    let options = CompositeOptions::default();
    let both = Eyes::new(&frames.each_ref(), &layers.each_ref()).composite(&model, &options, 3);
    for eye in 0..2 {
        assert_eq!(both[eye], on_gpu(&frames[eye], &layers[eye], &model, &options));
    }
    assert!(difference(&both[0], &both[1]) > 0.05);
    // The noise of the two eyes differs, though.
    let noisy = with_noise(camera(w, h), 1.0);
    let both = Eyes::new(&[&frames[0]; 2], &[&layers[0]; 2]).composite(&noisy, &options, 3);
    assert!(difference(&both[0], &both[1]) > 0.005);
}

#[test]
fn a_depth_buffer_and_any_unit_of_velocity_do() {
    if no_gpu() {
        return;
    }
    let (w, h) = (64, 48);
    let (frame, layer) = (frame(w, h), layer(w, h));
    let model = with_lens(with_exposure(camera(w, h), 0.7), 8.0, 0.4);
    let reference = on_gpu(&frame, &layer, &model, &CompositeOptions::default());
    // Reversed depth of a near plane at 0.1 m; velocity in normalised device coordinates, which point up.
    let buffer = layer.inverse_depth.as_ref().map(|d| d.map(|d| if d.is_nan() { 0.0 } else { 0.1 * d }));
    let device = layer.flow.as_ref().map(|f| f.map(|[u, v]| [2.0 * u / w as f32, -2.0 * v / h as f32]));
    let eyes = Eyes::new(&[&frame], &[&VirtualLayer { inverse_depth: buffer, flow: device, ..layer }]);
    let mut inputs = eyes.inputs();
    inputs.depth.as_mut().unwrap().scale = 10.0;
    inputs.velocity.as_mut().unwrap().scale = [w as f32 / 2.0, -(h as f32) / 2.0];
    let again = &composite_of(&inputs, of_frame(&model, &CompositeOptions::default()))[0];
    let got = difference(again, &reference);
    assert!(got < ROUNDING, "{got}");
    inputs.depth.as_mut().unwrap().scale = 8.0;
    let wrong = &composite_of(&inputs, of_frame(&model, &CompositeOptions::default()))[0];
    assert!(difference(wrong, &reference) > 10.0 * ROUNDING);
}

#[test]
fn broken_values_stay_where_they_are() {
    if no_gpu() {
        return;
    }
    let (w, h) = (40, 30);
    let mut layer = layer(w, h);
    let model = with_noise(with_lens(with_exposure(camera(w, h), 1.0), 20.0, 0.4), 1.0);
    let frame = frame(w, h);
    for (i, bad) in
        [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -f32::MAX, -0.0].into_iter().enumerate()
    {
        layer.color.0.row_mut(14)[16 + i] = [bad, 1.0, 1.0, 1.0];
        layer.color.0.row_mut(15)[16 + i] = [1.0, 1.0, 1.0, bad];
        layer.inverse_depth.as_mut().unwrap().row_mut(12)[16 + i] = bad;
        layer.flow.as_mut().unwrap().row_mut(13)[16 + i] = [bad, 1.0];
    }
    let out = on_gpu(&frame, &layer, &model, &CompositeOptions::default());
    assert!(out.data().as_flattened().iter().all(|v| (0.0..=1.0).contains(v)));
    let unknown = VirtualLayer {
        color: layer.color.clone(),
        inverse_depth: Some(Plane::filled(w, h, f32::NAN)),
        flow: Some(Flow::filled(w, h, [f32::NAN; 2])),
    };
    let out = on_gpu(&frame, &unknown, &model, &CompositeOptions::default());
    assert!(out.data().as_flattened().iter().all(|v| (0.0..=1.0).contains(v)));
}

#[test]
fn broken_values_are_mended_as_the_copy_of_a_layer_mends_them() {
    if no_gpu() {
        return;
    }
    let (w, h) = (100, 90);
    let (plate, whole) = (frame(w, h), layer(w, h));
    // Broken values, one at a time, each with what it counts as.
    let opaque = [0.25, 0.5, 0.25, 1.0];
    for (bad, instead) in [
        ([f32::NAN, 0.5, 0.5, 1.0], [0.0; 4]),
        ([0.5, 0.5, f32::INFINITY, 1.0], [0.0; 4]),
        ([0.5, 0.5, 0.5, f32::NAN], [0.0; 4]),
        ([0.5, 0.5, 0.5, -1.0], [0.0; 4]),
        ([0.25, 0.5, 0.25, 4.0], opaque),
    ] {
        let with = |value: [f32; 4]| {
            let mut layer = whole.clone();
            layer.color.0.row_mut(60)[30] = value;
            layer
        };
        // The other eye's layer is whole and stays as it is.
        let of = |layer: &VirtualLayer, model: &CameraModel| {
            let eyes = Eyes::new(&[&plate, &plate], &[&whole, layer]);
            let inputs = Inputs { apart: false, ..eyes.inputs() };
            composite_of(&inputs, of_frame(model, &CompositeOptions::default()))
        };
        let lens = with_lens(camera(w, h), 3.0, 0.4);
        let shutter = with_exposure(camera(w, h), 0.7);
        let both = with_exposure(lens.clone(), 0.7);
        let sharpened = with_sharpening(both.clone(), 1.0, 1.5);
        for model in [&camera(w, h), &lens, &shutter, &both, &sharpened] {
            let (got, want) = (of(&with(bad), model), of(&with(instead), model));
            assert!(
                got == want,
                "{bad:?}: {}, {}",
                difference(&got[0], &want[0]),
                difference(&got[1], &want[1])
            );
            // Whether the value is mended can be seen.
            assert_ne!(got[1], of(&whole, model)[1], "{bad:?}");
        }
    }
}

#[test]
fn what_does_not_fit_is_said() {
    if no_gpu() {
        return;
    }
    let (small, large) =
        (Eyes::new(&[&frame(8, 8)], &[&layer(8, 8)]), Eyes::new(&[&frame(9, 8)], &[&layer(9, 8)]));
    let mixed = Inputs { color: &large.color, ..small.inputs() };
    let error = |e: blindaug::Result<blindaug_gpu::Bound>| e.unwrap_err().to_string();
    assert_eq!(
        error(COMPOSITOR.bind(&GPU.device, &mixed)),
        "the virtual layer has 9 x 8 pixels for 1 eyes but the frame 8 x 8 for 1; give textures of one size"
    );
    let bound = COMPOSITOR.bind(&GPU.device, &small.inputs()).unwrap();
    let encode = |model: &CameraModel, targets: &[wgpu::TextureView]| {
        let mut encoder = GPU.device.create_command_encoder(&Default::default());
        let options = CompositeOptions::default();
        let frame = Frame { targets, ..of_frame(model, &options) };
        COMPOSITOR.encode(&GPU.queue, &mut encoder, &bound, &frame).unwrap_err()
    };
    assert!(encode(&camera(8, 8), &[]).to_string().starts_with("there are 0 targets for 1 eyes"));
    let view = [small.color.create_view(&Default::default())];
    assert!(encode(&camera(9, 8), &view).to_string().contains("9 px wide but the frame is 8"));
    let mut relative = with_lens(camera(8, 8), 3.0, 0.5);
    if let Estimate::Known(d) = &mut relative.defocus {
        d.depth_kind = DepthKind::Relative;
    }
    assert!(encode(&relative, &view).to_string().contains("relative inverse depth"));
    let srgb = GPU.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: small.frame.size(),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: TextureFormat::Rgba8UnormSrgb,
        usage: wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    let floats = GPU.upload(&[&Raster::filled(8, 8, [0.0f32; 4])], TextureFormat::Rgba32Float).unwrap();
    for frame in [&srgb, &floats] {
        let error = error(COMPOSITOR.bind(&GPU.device, &Inputs { frame, ..small.inputs() }));
        assert!(
            error.starts_with("the frame is a texture of Rgba") && error.contains("give one of floats"),
            "{error}"
        );
    }
    let huge = Raster::filled(40_000, 1, 0.0f32);
    let error = GPU.upload(&[&huge], TextureFormat::R32Float).unwrap_err().to_string();
    assert!(error.contains("more than this graphics device can hold"), "{error}");
    assert!(GPU.upload::<f32>(&[], TextureFormat::R32Float).is_err());
    assert!(GPU.upload(&[&Raster::filled(0, 4, 0.0f32)], TextureFormat::R32Float).is_err());
}

/// The tolerance of the tile: half floats of values up to 4, and the error of sines and logarithms on GPUs, up to 2^-11 (Vulkan's
/// specification).
const TILE_TOLERANCE: f32 = 0.002;

#[test]
fn the_noise_tile_is_that_of_the_reference() {
    if no_gpu() {
        return;
    }
    let side = blindaug_gpu::noise::TILE;
    let tile = |seed| {
        let texture = blindaug_gpu::noise::tile(&GPU.device, &GPU.queue, seed);
        GPU.download::<[f32; 4]>(&texture).unwrap()
    };
    let tiles = tile(7 + (3 << 40));
    let bands = synth::noise::tileable_bands(side, 7 + (3 << 40));
    let of_tile = |level: usize, x, y| -> [f32; 3] {
        std::array::from_fn(|c| if level < 3 { tiles[level].at(x, y)[c] } else { tiles[c].at(x, y)[3] })
    };
    for (level, band) in bands.iter().enumerate() {
        let got = difference(&Raster::from_fn(side, side, |x, y| of_tile(level, x, y)), band);
        println!("level {level}: {got}");
        assert!(got < TILE_TOLERANCE, "level {level}: {got}");
    }
    let other = tile(8);
    let got = difference(&other[0].map(|[r, g, b, _]| [r, g, b]), &bands[0]);
    assert!(got > 1.0, "{got}");
}

/// A grey layer of this encoded value and alpha.
fn grey(w: usize, h: usize, value: f32, alpha: f32) -> VirtualLayer {
    let linear = blindaug::Transfer::Srgb.decode(value) * alpha;
    VirtualLayer {
        color: Premultiplied(Raster::filled(w, h, [linear, linear, linear, alpha])),
        inverse_depth: None,
        flow: None,
    }
}

/// The std of each pyramid level and channel of an image.
fn band_stds(image: &Raster<[f32; 3]>) -> Vec<[f32; 3]> {
    let (bands, _) = pyramid::laplacian(image, NOISE_LEVELS);
    let std = |band: &Raster<[f32; 3]>| {
        let inside = band.crop(8, 8, band.width() - 16, band.height() - 16);
        std::array::from_fn(|c| {
            let n = inside.data().len() as f32;
            let mean = inside.data().iter().map(|v| v[c]).sum::<f32>() / n;
            (inside.data().iter().map(|v| (v[c] - mean).powi(2)).sum::<f32>() / n).sqrt()
        })
    };
    bands.iter().map(std).collect()
}

/// The largest relative difference between the stds of two images.
fn band_difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f32::max)
}

/// The relative tolerance of a level's std: 4 standard errors of about 2000 independent samples in the coarsest level on either side.
const NOISE_TOLERANCE: f32 = 0.06;

#[test]
fn noise_has_the_reference_s_std_in_each_level() {
    if no_gpu() {
        return;
    }
    let (w, h) = (512, 384);
    let frame = frame(w, h);
    for value in [0.2, 0.6] {
        let layer = grey(w, h, value, 1.0);
        let model = with_noise(camera(w, h), 1.0);
        let gpu = on_gpu(&frame, &layer, &model, &CompositeOptions::default());
        let cpu = on_cpu(&frame, &layer, &model, &CompositeOptions::default());
        let got = band_difference(&band_stds(&gpu), &band_stds(&cpu));
        println!("grey of {value}: {got}");
        assert!(got < NOISE_TOLERANCE, "{got}");
        let wrong = on_gpu(&frame, &layer, &with_noise(camera(w, h), 1.1), &CompositeOptions::default());
        assert!(band_difference(&band_stds(&wrong), &band_stds(&cpu)) > NOISE_TOLERANCE);
    }
    // Past clipping there is no noise.
    let white =
        on_gpu(&frame, &grey(w, h, 0.99, 1.0), &with_noise(camera(w, h), 1.0), &CompositeOptions::default());
    assert!(white.data().as_flattened().iter().all(|v| (v - 0.97).abs() < ROUNDING));
}

/// Noise that grows with red, and whose channels and frames are correlated.
fn with_curves(mut camera: CameraModel, scale: f32, shared: f32, temporal_correlation: f32) -> CameraModel {
    let level = |l: usize| {
        let std = [0.02, 0.008, 0.005, 0.003][l] * scale;
        let curve = |k: usize| KNOTS.map(|v| std * std * (0.2 + if k == 0 { 2.0 * v } else { 0.0 }));
        let own = (1.0 - shared * shared).sqrt();
        CurveLevel {
            variance: [std::array::from_fn(curve); 3],
            mixing: [[1.0, 0.0, 0.0], [shared, own, 0.0], [shared, 0.0, own]],
        }
    };
    let lines = with_noise(camera.clone(), 1.0).noise.known().unwrap().lines().clone();
    camera.noise = Estimate::Known(NoiseModel::Curves(Box::new(NoiseCurves {
        lines,
        levels: std::array::from_fn(level),
        temporal_correlation,
    })));
    camera
}

/// The largest relative difference of the std of a level where channels share most of their noise: both noises are random, their coarsest
/// levels have few values, and three channels that are alike scatter together. Measured: 0.06.
const SHARED_NOISE_TOLERANCE: f32 = 0.1;

/// The correlation of R and G.
fn shared_by_channels(image: &Raster<[f32; 3]>) -> f32 {
    let n = image.data().len() as f32;
    let mean: [f32; 3] = std::array::from_fn(|c| image.data().iter().map(|v| v[c]).sum::<f32>() / n);
    let sum =
        |a: usize, b: usize| image.data().iter().map(|v| (v[a] - mean[a]) * (v[b] - mean[b])).sum::<f32>();
    sum(0, 1) / (sum(0, 0) * sum(1, 1)).sqrt()
}

#[test]
fn noise_by_curves_is_that_of_the_reference_in_strength_colour_and_time() {
    if no_gpu() {
        return;
    }
    let (w, h) = (512, 384);
    let frame = frame(w, h);
    let layer = grey(w, h, 0.4, 1.0);
    let model = with_curves(camera(w, h), 1.0, 0.8, 0.5);
    let options = CompositeOptions::default();
    let (gpu, cpu) = (on_gpu(&frame, &layer, &model, &options), on_cpu(&frame, &layer, &model, &options));
    let got = band_difference(&band_stds(&gpu), &band_stds(&cpu));
    let colours = (shared_by_channels(&gpu) - shared_by_channels(&cpu)).abs();
    println!("{got} from the reference, channels {colours}");
    assert!(got < SHARED_NOISE_TOLERANCE && colours < 0.03, "{got} {colours}");
    // Negative controls: stronger noise, and channels that share nothing.
    let wrong = on_gpu(&frame, &layer, &with_curves(camera(w, h), 1.25, 0.8, 0.5), &options);
    assert!(band_difference(&band_stds(&wrong), &band_stds(&cpu)) > SHARED_NOISE_TOLERANCE);
    let wrong = on_gpu(&frame, &layer, &with_curves(camera(w, h), 1.0, 0.0, 0.5), &options);
    assert!((shared_by_channels(&wrong) - shared_by_channels(&cpu)).abs() > 0.3);
}

/// A frame of middle grey as a camera films it, in 8 bit.
fn filmed_grey(model: &CameraModel, w: usize, h: usize) -> Encoded {
    let Estimate::Known(noise) = &model.noise else { unreachable!() };
    let noise = synth::noise::noise(noise, &blindaug::Raster::filled(w, h, [0.5; 3]), 9, 1);
    Encoded(noise.map(|n| n.map(|n| ((0.5 + n).clamp(0.0, 1.0) * 255.0).round() / 255.0)))
}

#[test]
fn where_the_layer_is_transparent_only_the_missing_noise_is_added() {
    if no_gpu() {
        return;
    }
    let (w, h) = (512, 384);
    let model = with_noise(camera(w, h), 1.0);
    let filmed = filmed_grey(&model, w, h);
    for alpha in [0.25, 0.75] {
        let layer = grey(w, h, 0.5, alpha);
        let gpu = on_gpu(&filmed, &layer, &model, &CompositeOptions::default());
        let cpu = on_cpu(&filmed, &layer, &model, &CompositeOptions::default());
        let got = band_difference(&band_stds(&gpu), &band_stds(&cpu));
        let frame = band_difference(&band_stds(&gpu), &band_stds(&filmed.0));
        println!("alpha {alpha}: {got} from the reference, {frame} from the frame");
        assert!(got < NOISE_TOLERANCE && frame < 0.1, "{got} {frame}");
        // Without added noise, the composite has less noise than the frame.
        let none = CompositeOptions { no_noise: true, ..Default::default() };
        let without = on_gpu(&filmed, &layer, &model, &none);
        assert!(band_difference(&band_stds(&without), &band_stds(&filmed.0)) > 0.15);
    }
}

#[test]
fn sharpening_leaves_the_noise_as_it_is() {
    if no_gpu() {
        return;
    }
    let (w, h) = (512, 384);
    let plain = with_noise(camera(w, h), 1.0);
    let model = with_sharpening(plain.clone(), 1.0, 1.0);
    // A camera model's noise is that after the camera's sharpening.
    let filmed = filmed_grey(&plain, w, h);
    let off = |a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>| band_difference(&band_stds(a), &band_stds(b));
    for alpha in [0.25, 0.75, 1.0] {
        let layer = grey(w, h, 0.5, alpha);
        let gpu = on_gpu(&filmed, &layer, &model, &CompositeOptions::default());
        let cpu = on_cpu(&filmed, &layer, &model, &CompositeOptions::default());
        let (got, frame) = (off(&gpu, &cpu), off(&gpu, &filmed.0));
        println!("alpha {alpha}: {got} from the reference, {frame} from the frame");
        assert!(got < NOISE_TOLERANCE && frame < 0.1, "{got} {frame}");
        // Without added noise, the composite has less noise than the frame.
        let none = CompositeOptions { no_noise: true, ..Default::default() };
        assert!(off(&on_gpu(&filmed, &layer, &model, &none), &filmed.0) > 0.15);
    }
}

#[test]
fn noise_of_layers_does_not_add_up() {
    if no_gpu() {
        return;
    }
    // Two half-transparent layers are composited one after the other.
    let (w, h) = (512, 384);
    let model = with_noise(camera(w, h), 1.0);
    let filmed = filmed_grey(&model, w, h);
    let layer = grey(w, h, 0.5, 0.6);
    let twice = |second: u64| {
        let first = Encoded(on_gpu(&filmed, &layer, &model, &CompositeOptions::default()));
        on_gpu(&first, &layer, &model, &CompositeOptions { seed: second, ..Default::default() })
    };
    let off = |image: &Raster<[f32; 3]>| band_difference(&band_stds(image), &band_stds(&filmed.0));
    let [another, same] = [twice(1), twice(0)].map(|i| off(&i));
    println!("seeds of their own: {another}, the same: {same}");
    assert!(another < 0.1 && same > 0.2, "{another} {same}");
}

#[test]
fn noise_does_not_repeat() {
    if no_gpu() {
        return;
    }
    let (w, h) = (1024, 96);
    let (frame, layer) = (frame(w, h), grey(w, h, 0.5, 1.0));
    let model = with_noise(camera(w, h), 1.0);
    let noise = |number| {
        let image =
            Eyes::new(&[&frame], &[&layer]).composite(&model, &CompositeOptions::default(), number).remove(0);
        image.map(|v| v[1] - 0.5)
    };
    let correlation = |a: &Plane, b: &Plane, lag: usize| {
        let pairs = || (0..h).flat_map(|y| (0..w - lag).map(move |x| (x, y)));
        let product: f32 = pairs().map(|(x, y)| a.at(x, y) * b.at(x + lag, y)).sum();
        product / pairs().map(|(x, y)| a.at(x, y).powi(2)).sum::<f32>()
    };
    let (one, two) = (noise(1), noise(2));
    assert!(correlation(&one, &one, 0) > 0.999);
    for lag in [64, 128, 192, 256, 384, 512] {
        let got = correlation(&one, &one, lag);
        assert!(got.abs() < 0.05, "lag {lag}: {got}");
    }
    assert!(correlation(&one, &two, 0).abs() < 0.05);
    assert_eq!(one, noise(1));
    // A tile that is laid side by side does repeat.
    let tiled = Plane::from_fn(w, h, |x, y| one.at(x % 256, y));
    assert!(correlation(&tiled, &tiled, 256) > 0.9);
    // There is no seam where cells meet: neighbours differ as much everywhere.
    let step = |x: usize| (0..h).map(|y| (one.at(x, y) - one.at(x + 1, y)).powi(2)).sum::<f32>();
    let steps: Vec<f32> = (0..w - 1).map(step).collect();
    let mean = steps.iter().sum::<f32>() / steps.len() as f32;
    assert!(steps.iter().all(|s| (0.4..2.0).contains(&(s / mean))));
}

#[test]
fn it_agrees_at_4k() {
    if no_gpu() {
        return;
    }
    let (w, h) = (3840, 2160);
    let model = with_lens(with_exposure(camera(w, h), 0.5), 40.0, 0.35);
    // The object's layer covers 500 x 400 px of the frame.
    let small = layer(500, 400);
    let put = |x: usize, y: usize| (1700..2200).contains(&x) && (900..1300).contains(&y);
    let layer = VirtualLayer {
        color: Premultiplied(Raster::from_fn(w, h, |x, y| {
            if put(x, y) { small.color.0.at(x - 1700, y - 900) } else { [0.0; 4] }
        })),
        inverse_depth: small.inverse_depth.as_ref().map(|d| {
            Raster::from_fn(w, h, |x, y| if put(x, y) { d.at(x - 1700, y - 900) } else { f32::NAN })
        }),
        flow: small.flow.as_ref().map(|f| {
            Raster::from_fn(w, h, |x, y| if put(x, y) { f.at(x - 1700, y - 900) } else { [f32::NAN; 2] })
        }),
    };
    let frame = frame(w, h);
    let [gpu, cpu, naive] = [
        on_gpu(&frame, &layer, &model, &CompositeOptions::default()),
        on_cpu(&frame, &layer, &model, &CompositeOptions::default()),
        on_cpu(&frame, &layer, &model, &CompositeOptions { naive: true, ..Default::default() }),
    ]
    .map(|i| i.crop(1600, 800, 700, 600));
    let got = difference(&gpu, &cpu);
    println!("4K: {got}");
    assert!(got < blur_tolerance(Quality::High, Bokeh::Gaussian), "{got}");
    assert!(difference(&gpu, &naive) > 0.05);
}

/// The rendered clip `shelf3` with the camera it was rendered with; `None`, with a message, without the shared data.
fn rendered_clip() -> Option<(Encoded, VirtualLayer, CameraModel)> {
    let shared = std::env::var("BLINDAUG_SHARED")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared").to_string());
    let clip = std::path::PathBuf::from(shared).join("data/clips/shelf3");
    if !clip.is_dir() {
        eprintln!(
            "NOT TESTED: no clip in {} (set BLINDAUG_SHARED to the folder that holds data/clips)",
            clip.display()
        );
        return None;
    }
    let frame = blindaug_io::read_frame(clip.join("full_plain/0003.png")).unwrap();
    let layer = blindaug_io::read_virtual_layer(clip.join("virtual/0003.exr")).unwrap();
    let (w, h) = layer.color.0.size();
    let model = with_noise(with_lens(with_exposure(camera(w, h), 0.5), 3.6, 1.0 / 1.3), 0.5);
    let layer = VirtualLayer { color: layer.color, inverse_depth: layer.inverse_depth, flow: layer.flow };
    Some((frame, layer, model))
}

#[test]
fn a_rendered_object_over_a_filmed_frame_agrees() {
    if no_gpu() {
        return;
    }
    let Some((frame, layer, model)) = rendered_clip() else { return };
    for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
        let options = CompositeOptions { no_noise: true, bokeh: Some(bokeh), ..Default::default() };
        let (gpu, cpu) = (on_gpu(&frame, &layer, &model, &options), on_cpu(&frame, &layer, &model, &options));
        let got = difference(&gpu, &cpu);
        println!("{bokeh:?}: {got}");
        assert!(got < blur_tolerance(Quality::High, bokeh), "{got}");
        let naive = on_cpu(&frame, &layer, &model, &CompositeOptions { naive: true, ..options });
        println!("naive: {}", difference(&gpu, &naive));
        assert!(difference(&gpu, &naive) > blur_tolerance(Quality::High, bokeh));
    }
}

#[test]
fn within_an_area_it_is_the_same() {
    if no_gpu() {
        return;
    }
    let (w, h) = (301, 200);
    let (frame, whole) = (frame(w, h), layer(w, h));
    // The object lies in the middle, 60 px from the area's edges, so that blur ends before them.
    let color = Premultiplied(Raster::from_fn(w, h, |x, y| {
        if (120..180).contains(&x) && (80..130).contains(&y) { whole.color.0.at(x, y) } else { [0.0; 4] }
    }));
    let layer = VirtualLayer { color, ..whole };
    let plain = with_noise(with_lens(with_exposure(camera(w, h), 0.7), 10.0, 0.35), 1.0);
    for model in [plain.clone(), with_sharpening(plain, 1.0, 2.0)] {
        within_an_area_of_a_camera_it_is_the_same((w, h), &frame, &layer, &model);
    }
}

fn within_an_area_of_a_camera_it_is_the_same(
    (w, h): (usize, usize),
    frame: &Encoded,
    layer: &VirtualLayer,
    model: &CameraModel,
) {
    assert_eq!((w, h), (301, 200));
    let eyes = Eyes::new(&[frame], &[layer]);
    let of = |area| {
        composite_of(&eyes.inputs(), Frame { area, ..of_frame(model, &CompositeOptions::default()) })
            .remove(0)
    };
    let everywhere = of(None);
    for (x, y, width, height) in [(61, 21, 180, 170), (40, 12, 261, 999), (0, 0, 301, 200)] {
        let got = difference(&of(Some(Area { x, y, width, height })), &everywhere);
        assert!(got < ROUNDING, "{got}");
    }
    let cut = of(Some(Area { x: 61, y: 21, width: 90, height: 170 }));
    assert!(difference(&cut, &everywhere) > 10.0 * ROUNDING);
    for nothing in [Area { x: 5, y: 5, width: 0, height: 9 }, Area { x: 999, y: 999, width: 5, height: 5 }] {
        assert!(difference(&of(Some(nothing)), &frame.0) < ROUNDING);
    }
}

/// A layer whose object lies `x` px from the left.
fn layer_at(w: usize, h: usize, x: usize) -> VirtualLayer {
    let small = layer(60, 50);
    let at = |px: usize, py: usize| {
        (px.wrapping_sub(x) < 60 && py.wrapping_sub(40) < 50).then(|| (px - x, py - 40))
    };
    VirtualLayer {
        color: Premultiplied(Raster::from_fn(w, h, |px, py| {
            at(px, py).map_or([0.0; 4], |(x, y)| small.color.0.at(x, y))
        })),
        inverse_depth: small
            .inverse_depth
            .as_ref()
            .map(|d| Plane::from_fn(w, h, |px, py| at(px, py).map_or(f32::NAN, |(x, y)| d.at(x, y)))),
        flow: small
            .flow
            .as_ref()
            .map(|f| Flow::from_fn(w, h, |px, py| at(px, py).map_or([f32::NAN; 2], |(x, y)| f.at(x, y)))),
    }
}

#[test]
fn frames_before_leave_no_trace() {
    if no_gpu() {
        return;
    }
    // The object moves, disappears and comes back, and the camera has a lens, a shutter, both or none.
    let (w, h) = (420, 130);
    let frame = frame(w, h);
    let [left, right] = [layer_at(w, h, 20), layer_at(w, h, 330)];
    let empty = VirtualLayer { color: Premultiplied(Raster::filled(w, h, [0.0; 4])), ..layer_at(w, h, 20) };
    let plain = camera(w, h);
    let lens = with_lens(plain.clone(), 9.0, 0.4);
    let sharp = with_lens(plain.clone(), 1e-4, 0.4);
    let shutter = with_exposure(plain.clone(), 0.7);
    let both = with_exposure(lens.clone(), 0.7);
    let [crisp, wide] = [(1.0, 1.0), (0.4, 4.0)].map(|(a, r)| with_sharpening(both.clone(), a, r));
    // The object moves by a few blocks, so that where it was is beside where the sharpening works now.
    let (beside, only_crisp) = (layer_at(w, h, 68), with_sharpening(plain.clone(), 1.0, 1.0));
    let eyes = Eyes::new(&[&frame], &[&left]);
    let target = target_like(&eyes.frame);
    let views = layer_views(&target);
    let options = CompositeOptions::default();
    // A layer of which a copy is needed.
    let mut broken = left.clone();
    broken.color.0.row_mut(50)[30] = [f32::NAN; 4];
    for apart in [false, true] {
        let inputs = Inputs { apart, ..eyes.inputs() };
        let bound = COMPOSITOR.bind(&GPU.device, &inputs).unwrap();
        let mut last: Option<Raster<[f32; 3]>> = None;
        for (layer, model, area) in [
            (&left, &both, None),
            (&right, &both, None),
            (&empty, &both, None),
            (&empty, &both, None),
            (&left, &lens, None),
            (&right, &shutter, None),
            (&left, &sharp, None),
            (&right, &lens, None),
            (&right, &lens, Some(Area { x: 0, y: 0, width: 100, height: 100 })),
            (&left, &lens, Some(Area { x: 0, y: 0, width: 45, height: 100 })),
            (&left, &lens, Some(Area { x: 0, y: 0, width: 0, height: 100 })),
            (&empty, &plain, None),
            (&left, &plain, None),
            (&right, &both, None),
            (&left, &crisp, None),
            (&right, &wide, None),
            (&left, &plain, None),
            (&empty, &crisp, None),
            (&right, &crisp, None),
            (&left, &crisp, None),
            (&left, &wide, Some(Area { x: 0, y: 0, width: 45, height: 100 })),
            (&left, &wide, Some(Area { x: 0, y: 0, width: 45, height: 0 })),
            (&right, &wide, None),
            (&left, &only_crisp, None),
            (&beside, &only_crisp, None),
            (&left, &only_crisp, None),
            (&right, &both, None),
            (&broken, &both, None),
            (&right, &shutter, None),
            (&broken, &shutter, None),
            (&beside, &crisp, None),
            (&broken, &crisp, None),
            (&empty, &both, None),
        ] {
            GPU.write(&eyes.color, &[&layer.color.0]);
            GPU.write(eyes.depth.as_ref().unwrap(), &[layer.inverse_depth.as_ref().unwrap()]);
            GPU.write(eyes.velocity.as_ref().unwrap(), &[layer.flow.as_ref().unwrap()]);
            let of = Frame { area, ..of_frame(model, &options) };
            let fresh = composite_of(&inputs, of).remove(0);
            let mut encoder = GPU.device.create_command_encoder(&Default::default());
            COMPOSITOR.encode(&GPU.queue, &mut encoder, &bound, &Frame { targets: &views, ..of }).unwrap();
            GPU.queue.submit([encoder.finish()]);
            let again = GPU.download::<[f32; 4]>(&target).unwrap()[0].map(|[r, g, b, _]| [r, g, b]);
            assert_eq!(again, fresh);
            if layer.color.0.data().iter().any(|c| c[3] > 0.0) && area.is_none() {
                assert!(last.as_ref().is_none_or(|l| difference(l, &again) > 0.01));
            }
            last = Some(again);
        }
    }
}

#[test]
fn only_blocks_near_the_object_cost_anything() {
    if no_gpu() {
        return;
    }
    let (w, h) = (420, 130);
    let eyes = Eyes::new(&[&frame(w, h)], &[&layer_at(w, h, 20)]);
    let inputs = Inputs { apart: false, ..eyes.inputs() };
    let target = target_like(&eyes.frame);
    let views = layer_views(&target);
    let counts = |model: &CameraModel| {
        let bound = COMPOSITOR.bind(&GPU.device, &inputs).unwrap();
        // The first frame of all writes everything.
        for _ in 0..2 {
            let frame = Frame { targets: &views, ..of_frame(model, &CompositeOptions::default()) };
            let mut encoder = GPU.device.create_command_encoder(&Default::default());
            COMPOSITOR.encode(&GPU.queue, &mut encoder, &bound, &frame).unwrap();
            GPU.queue.submit([encoder.finish()]);
        }
        let blocks = bound.read_blocks(&GPU).unwrap();
        assert_eq!(blocks.len(), 27 * 9);
        let count = |is: &dyn Fn(&Block) -> bool| blocks.iter().filter(|b| is(b)).count();
        assert_eq!(blocks.iter().any(|b| b.sharpened), model.sharpening.known().is_some());
        [count(&|b| b.occupied), count(&|b| b.visible), count(&|b| b.focused), count(&|b| b.sharpened)]
    };
    // The object's radius is 16 px.
    let [occupied, visible, focused, _] = counts(&camera(w, h));
    assert!(
        (9..=16).contains(&occupied) && visible == occupied && focused == 0,
        "{occupied} {visible} {focused}"
    );
    let [_, visible, focused, _] = counts(&with_lens(camera(w, h), 12.0, 0.4));
    assert!(visible > occupied && visible < 100 && focused == visible, "{visible} {focused}");
    // Neither a lens that puts nothing out of focus nor a shutter needs the focused layer.
    assert_eq!(counts(&with_lens(camera(w, h), 1e-4, 0.4)), [occupied, occupied, 0, 0]);
    let [_, visible, focused, _] = counts(&with_exposure(camera(w, h), 0.7));
    assert!(visible > occupied && focused == 0, "{visible} {focused}");
    // A camera that sharpens works on the blocks around those in which the object is seen, the more the wider its mask.
    let [narrow, wide] = [1.0, 6.0].map(|radius| counts(&with_sharpening(camera(w, h), 1.0, radius)));
    println!("sharpened blocks: {} and {} of {}", narrow[3], wide[3], 27 * 9);
    assert!(narrow[3] > occupied && wide[3] > narrow[3] && wide[3] < 100, "{narrow:?} {wide:?}");
}

#[test]
fn what_the_caller_promises_changes_nothing_in_the_picture() {
    if no_gpu() {
        return;
    }
    let (w, h) = (420, 130);
    let plate = frame(w, h);
    let [mut left, mut right] = [layer_at(w, h, 20), layer_at(w, h, 330)];
    let eyes = Eyes::new(&[&plate, &plate], &[&left, &right]);
    let inputs = Inputs { apart: false, ..eyes.inputs() };
    // The depth tells where nothing is.
    for layer in [&mut left, &mut right] {
        layer.inverse_depth =
            layer.inverse_depth.as_ref().map(|d| d.map(|d| if d.is_nan() { -1.0 } else { d }));
    }
    let mut told = Eyes::new(&[&plate, &plate], &[&left, &right]);
    let halves = [&left, &right].map(|l| l.inverse_depth.as_ref().unwrap());
    told.depth = Some(GPU.upload(&halves, TextureFormat::R16Float).unwrap());
    let depth = |nothing| Some(Depth { nothing: Some(nothing), ..told.inputs().depth.unwrap() });
    let promised = Inputs { apart: false, cleared: true, depth: depth(-1.0), ..told.inputs() };
    let options = CompositeOptions::default();
    // The frame as the compositor writes it, in half floats.
    let nothing = Some(Area { x: 0, y: 0, width: 0, height: 0 });
    let filmed =
        rgba(&composite_of(&inputs, Frame { area: nothing, ..of_frame(&camera(w, h), &options) })[0]);
    let over = |inputs: &Inputs, model: &CameraModel, before: &Raster<[f32; 4]>| {
        let target = target_like(&told.frame);
        GPU.write(&target, &[before, before]);
        let views = layer_views(&target);
        let bound = COMPOSITOR.bind(&GPU.device, inputs).unwrap();
        let frame = Frame { targets: &views, frame_in_targets: true, ..of_frame(model, &options) };
        let mut encoder = GPU.device.create_command_encoder(&Default::default());
        COMPOSITOR.encode(&GPU.queue, &mut encoder, &bound, &frame).unwrap();
        GPU.queue.submit([encoder.finish()]);
        let images = GPU.download::<[f32; 4]>(&target).unwrap();
        images.iter().map(|i| i.map(|[r, g, b, _]| [r, g, b])).collect::<Vec<_>>()
    };
    let lens = with_lens(camera(w, h), 9.0, 0.4);
    let all = with_noise(with_exposure(lens.clone(), 0.7), 1.0);
    let sharpened = with_sharpening(all.clone(), 1.0, 1.5);
    let mut encoded = all.clone();
    encoded.blur_space = BlurSpace::Encoded;
    for (name, model) in [
        ("nothing", &camera(w, h)),
        ("lens", &lens),
        ("all", &all),
        ("in encoded values", &encoded),
        ("sharpened", &sharpened),
    ] {
        let want = composite_of(&inputs, of_frame(model, &options));
        let got = over(&promised, model, &filmed);
        for (got, want) in got.iter().zip(&want) {
            let off = difference(got, want);
            println!("{name}: {off}");
            assert!(off < 0.1 * ROUNDING, "{name}: {off}");
        }
        // The eyes differ, and a broken promise is seen: here two columns of the object are taken for nothing.
        assert!(difference(&got[0], &got[1]) > 0.01, "{name}");
        let hidden = Inputs { cleared: false, depth: depth(0.34375), ..promised };
        let black = Raster::filled(w, h, [0.0f32; 4]);
        let without = over(&hidden, model, &filmed).remove(0);
        assert!(difference(&without, &want[0]) > 0.0005, "{name}");
        // They are read from the layer itself if it is said to be cleared, where blur acts on light.
        let shown = over(&Inputs { cleared: true, ..hidden }, model, &filmed).remove(0);
        assert_eq!(shown != without, model.blur_space == BlurSpace::Linear, "{name}");
        // Only where the object may be seen, and around it for a camera that sharpens, is anything drawn.
        let drawn = |image: &Raster<[f32; 3]>| image.data().iter().filter(|v| **v != [0.0; 3]).count();
        let over_black = over(&promised, model, &black).remove(0);
        assert_eq!(over_black.at(410, 5), [0.0; 3], "{name}");
        assert!((100..w * h / 3).contains(&drawn(&over_black)), "{name}");
    }
}

#[test]
fn something_sharp_does_not_bleed_into_blurred_surroundings() {
    if no_gpu() {
        return;
    }
    // There is a square in front of a wall, and one of the two is in focus.
    let (w, h) = (120, 90);
    let square = |x: usize, y: usize| (40..80).contains(&x) && (30..60).contains(&y);
    let [wall, near] = [([0.1, 0.1, 0.1, 1.0], 0.1), ([0.9, 0.8, 0.7, 1.0], 0.5)];
    let layer = |here: &(dyn Fn(usize, usize) -> bool + Sync)| VirtualLayer {
        color: Premultiplied(Raster::from_fn(w, h, |x, y| {
            if !here(x, y) {
                [0.0; 4]
            } else if square(x, y) {
                near.0
            } else {
                wall.0
            }
        })),
        inverse_depth: Some(Plane::from_fn(w, h, |x, y| if square(x, y) { near.1 } else { wall.1 })),
        flow: None,
    };
    let (frame, options) = (frame(w, h), CompositeOptions::default());
    let both = layer(&|_, _| true);
    for (focus, sigma_at_infinity) in [(near.1, 5.0), (wall.1, 1.2)] {
        let model = with_lens(camera(w, h), sigma_at_infinity, focus);
        let one = on_gpu(&frame, &both, &model, &options);
        let cpu = on_cpu(&frame, &both, &model, &options);
        let got = difference(&one, &cpu);
        println!("focus {focus}: {got}");
        assert!(got < blur_tolerance(Quality::High, Bokeh::Gaussian), "focus {focus}: {got}");
        // The result is that of two layers composited one after the other, but only if the parts are blurred apart from each other.
        let mut whole_wall = layer(&|_, _| true);
        whole_wall.color = Premultiplied(Raster::filled(w, h, wall.0));
        whole_wall.inverse_depth = Some(Plane::filled(w, h, wall.1));
        let behind = Encoded(on_gpu(&frame, &whole_wall, &model, &options));
        let separate = on_gpu(&behind, &layer(&square), &model, &options);
        let eyes = Eyes::new(&[&frame], &[&both]);
        let together = Inputs { apart: false, ..eyes.inputs() };
        let together = &composite_of(&together, of_frame(&model, &options))[0];
        let [apart, together] = [&one, together].map(|i| difference(i, &separate));
        println!("focus {focus}: {apart} apart, {together} together");
        assert!(apart < 0.01 && together > 2.0 * apart, "focus {focus}: {apart} {together}");
    }
}
