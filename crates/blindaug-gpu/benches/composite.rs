//! The time that a frame of the compositor takes, step by step, beside the time of moving its bytes: `cargo bench -p blindaug-gpu`.
//!
//! The size is 2 x 2064 x 2208 px on a GPU and 640 x 360 px on a software device; `cargo bench -p blindaug-gpu -- WIDTH HEIGHT EYES`
//! chooses another.

use blindaug::composite::CompositeOptions;
use blindaug::model::{
    Capture, DefocusModel, Estimate, ExposureFraction, MotionBlurModel, NoiseLevel, NoiseModel,
    SharpeningModel,
};
use blindaug::synth::defocus::Bokeh;
use blindaug::{CameraModel, Error, Flow, Plane, Raster, Result};
use blindaug_gpu::{
    Compositor, Depth, Frame, Gpu, Inputs, Quality, STEPS, Timer, Velocity, unsharpening_steps,
};
use std::time::Instant;
use wgpu::TextureFormat;

fn main() -> Result<()> {
    let gpu = Gpu::new()?;
    let sizes: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let software = gpu.info.device_type == wgpu::DeviceType::Cpu;
    let [w, h, eyes] = match sizes[..] {
        [] if software => [640, 360, 1],
        [] => [2064, 2208, 2],
        [w, h, eyes] => [w, h, eyes],
        _ => return Err(Error::new("give three numbers: width and height in px, and eyes")),
    };
    let frames = if software { 5 } else { 50 };
    println!("{} ({:?}), {eyes} x {w} x {h}, median of {frames} frames", gpu.info.name, gpu.info.backend);
    if software {
        println!("This device computes on the CPU: its times say nothing of a GPU; bytes and taps do.");
    }
    let bandwidth = copy_bandwidth(&gpu, if software { 32 << 20 } else { 512 << 20 }, frames)?;
    println!("copy bandwidth {:.1} GB/s (read and written)\n", bandwidth * 1e-9);
    let scene = Scene::new(&gpu, w, h, eyes)?;
    let compositor = Compositor::new(&gpu.device, &gpu.queue, TextureFormat::Rgba8Unorm);
    println!(
        "| quality, bokeh | step | bytes/px | taps/px, mean over the object, most | ms | of the bandwidth's bound |"
    );
    println!("|---|---|---|---|---|---|");
    for (quality, bokeh, sharpening) in [
        (Quality::High, Bokeh::Gaussian, None),
        (Quality::Medium, Bokeh::Gaussian, None),
        (Quality::Low, Bokeh::Gaussian, None),
        (Quality::High, Bokeh::Disk, None),
        (Quality::Medium, Bokeh::Disk, None),
        (Quality::Low, Bokeh::Disk, None),
        (Quality::High, Bokeh::Gaussian, Some(SharpeningModel::given(0.5, 1.0))),
        (Quality::High, Bokeh::Gaussian, Some(SharpeningModel::given(1.0, 1.0))),
        (Quality::High, Bokeh::Gaussian, Some(SharpeningModel::given(5.0, 1.0))),
    ] {
        let times = scene.time(&gpu, &compositor, (quality, bokeh, sharpening), frames)?;
        let taps = scene.taps(quality, bokeh);
        let moved = bytes(sharpening.as_ref());
        let name = match sharpening {
            Some(s) => format!("{quality:?}, {bokeh:?}, sharpening by {}", s.amount),
            None => format!("{quality:?}, {bokeh:?}"),
        };
        let bound = |bytes: f64| 1e3 * bytes * (w * h * eyes) as f64 / bandwidth;
        let row = |step: &str, bytes: f64, taps: &str, ms: Option<f64>| {
            let time = ms.map_or("|".into(), |ms| format!("{ms:.3} | {:.0} %", 100.0 * bound(bytes) / ms));
            println!("| {name} | {step} | {bytes:.0} | {taps} | {time} |");
        };
        for (i, (step, bytes)) in STEPS.iter().zip(moved).enumerate() {
            let taps = match *step {
                "defocus" => taps.defocus.as_str(),
                "composite" => taps.motion.as_str(),
                _ => "",
            };
            row(step, bytes, taps, times.steps.map(|ms| f64::from(ms[i])));
        }
        row("whole frame", moved.iter().sum(), "", Some(times.frame));
    }
    phone(&scene);
    Ok(())
}

/// The assumed speed of a GPU like the Adreno 740: 70 % of the bandwidth of 64 bit of LPDDR5X at 8533 MT/s, bytes/s, and bilinear samples
/// of four half floats per second.
const PHONE: (f64, f64) = (0.7 * 68.3e9, 20e9);

/// Texels and bilinear samples per pixel that each of [`STEPS`] reads for a camera that does not sharpen, without those that depend on blur:
/// extension three textures in tiles of 20 x 20 for 16 x 16 (the pull and the push read 0.5); octaves 9/16 * 4/3; defocus six of depth
/// and its continuation; sharpening none; composite six of motion and its continuation, the frame, and three of the noise tile.
const SAMPLES: [f64; STEPS.len()] = [3.0 * 400.0 / 256.0 + 0.5, 0.75, 7.0, 0.0, 11.0];

/// Prints the time of a frame on a phone, computed from the counts: a step takes as long as its bytes or its samples, whichever is longer;
/// outside the object's area, the frame is only read and written.
fn phone(scene: &Scene) {
    let (bandwidth, rate) = PHONE;
    println!(
        "\nEstimated, not measured: 2 x 2064 x 2208 at {:.0} GB/s and {:.0} G samples/s\n",
        bandwidth * 1e-9,
        rate * 1e-9
    );
    println!("| quality | the object's area | ms | of a frame at 45 Hz | 72 Hz | 90 Hz |");
    println!("|---|---|---|---|---|---|");
    let pixels = 2.0 * 2064.0 * 2208.0;
    for quality in [Quality::High, Quality::Medium, Quality::Low] {
        let mean = |taps: &dyn Fn(&(f32, f32)) -> u32| {
            scene.blur.iter().map(|b| f64::from(taps(b))).sum::<f64>() / scene.blur.len().max(1) as f64
        };
        let mut samples = SAMPLES;
        samples[2] += mean(&|b| quality.defocus_taps(Bokeh::Gaussian, b.0));
        samples[4] += mean(&|b| quality.motion_blur_taps(b.1));
        let inside: f64 =
            bytes(None).iter().zip(samples).map(|(bytes, n)| (bytes / bandwidth).max(n / rate)).sum();
        for share in [0.05, 0.2, 0.5] {
            let ms = 1e3 * pixels * (share * inside + (1.0 - share) * 8.0 / bandwidth);
            let of = |hz: f64| format!("{:.0} %", 0.1 * ms * hz);
            let share = 100.0 * share;
            println!("| {quality:?} | {share:.0} % | {ms:.1} | {} | {} | {} |", of(45.0), of(72.0), of(90.0));
        }
    }
}

/// Bytes per pixel of the continued depth and motion: 1/2 + 1/4 at a quarter of the size, and 1/8 on the next level.
const CONTINUATION: f64 = 0.875;

/// Bytes per pixel that each of [`STEPS`] must move if each texel is read once and written once: 8 bytes for the half floats in four
/// channels between the passes, 4 each for depth, velocity, the frame and the target; the coarser levels of a pyramid add a third of its
/// finest.
fn bytes(sharpening: Option<&SharpeningModel>) -> [f64; STEPS.len()] {
    // Bytes of the iteration's first step, which blurs the frame: rows 4 + 8, columns 8 + 4 + 8. Each further step: rows 8 + 8, columns 8 +
    // 8 + 8 + 8; the second one 8 less, since its source is the first one's result. Then the difference: frame 4, unsharpening 8, layer 8,
    // motion 4, its continuation, result 8; its rows 8 + 8.
    let unsharpening = |steps: u32| 32.0 + 48.0 * f64::from(steps - 1) - 8.0;
    let sharpening = sharpening.map(|s| unsharpening(unsharpening_steps(s)) + 32.0 + CONTINUATION + 16.0);
    [
        // Prepare 8 + 4 + 4, writes 8, at half size 2, at a quarter of it 1/2 and 1/4; pull (1/2 + 1/8) * 4/3; push (2/8 + 1/32) * 4/3.
        26.75 + 2.5 / 3.0 + 0.375,
        // From half size on: (2 + 1/2) * 4/3.
        10.0 / 3.0,
        // Depth 4, its continuation, octaves 8 * 4/3, result 8.
        4.0 + CONTINUATION + 32.0 / 3.0 + 8.0,
        sharpening.unwrap_or(0.0),
        // Without sharpening: frame 4, layer 8, motion 4, its continuation, target 4; the noise tile stays in the cache. With sharpening:
        // frame 4, difference 8, its rows 8, unsharpening 8, target 4.
        if sharpening.is_some() { 32.0 } else { 20.0 + CONTINUATION },
    ]
}

struct Times {
    /// The milliseconds of each step, if the device has timestamps.
    steps: Option<[f32; STEPS.len()]>,
    /// The milliseconds from submission to the end.
    frame: f64,
}

/// The bytes per second that are read and written while a buffer of `size` bytes is copied.
fn copy_bandwidth(gpu: &Gpu, size: u64, times: usize) -> Result<f64> {
    let buffer = || {
        gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("copy"),
            size,
            usage: wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    };
    let (a, b) = (buffer(), buffer());
    let copies = 4;
    let mut best = f64::INFINITY;
    for _ in 0..times {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for _ in 0..copies {
            encoder.copy_buffer_to_buffer(&a, 0, &b, 0, size);
        }
        gpu.wait()?;
        let start = Instant::now();
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok((2 * copies * size) as f64 / best)
}

struct Scene {
    frame: wgpu::Texture,
    color: wgpu::Texture,
    depth: wgpu::Texture,
    velocity: wgpu::Texture,
    target: wgpu::Texture,
    camera: CameraModel,
    /// The defocus std and the length of the path, px, of each of the object's pixels.
    blur: Vec<(f32, f32)>,
}

struct Taps {
    defocus: String,
    motion: String,
}

impl Scene {
    /// A scene of an object over 40 % of the frame, with a defocus std of up to 4.3 px and paths of up to 17 px.
    fn new(gpu: &Gpu, w: usize, h: usize, eyes: usize) -> Result<Self> {
        let inside = |x: usize, y: usize| {
            let (u, v) = (x as f32 / w as f32 - 0.5, y as f32 / h as f32 - 0.5);
            u.hypot(v) < 0.357
        };
        let frame = Raster::from_fn(w, h, |x, y| [0.3 + 0.2 * ((x * 7 + y * 13) % 31) as f32 / 31.0; 4]);
        let color = Raster::from_fn(w, h, |x, y| {
            if inside(x, y) { [0.5, ((x / 8 + y / 8) % 2) as f32, 0.2, 1.0] } else { [0.0; 4] }
        });
        let depth = Plane::from_fn(w, h, |x, _| 0.2 + 0.6 * x as f32 / w as f32);
        let flow = Flow::from_fn(w, h, |x, y| [25.0 * y as f32 / h as f32, 10.0 * x as f32 / w as f32]);
        let mut camera =
            CameraModel::unknown(Capture { width: w, height: h, fps: None, frames_used: 1 }, "not given");
        let lens = DefocusModel::given_lens(10.0, 0.5);
        camera.defocus = Estimate::Known(lens);
        camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.75)));
        let level = NoiseLevel { slope: [0.02; 3], intercept: [0.01; 3] };
        camera.noise = Estimate::Known(NoiseModel::given([level; 4], 1.0));
        let blur = (0..w * h).map(|i| (i % w, i / w)).filter(|&(x, y)| inside(x, y)).map(|(x, y)| {
            let [u, v] = flow.at(x, y);
            (lens.sigma_px(depth.at(x, y)), 0.75 * u.hypot(v))
        });
        let blur = blur.collect();
        let target = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("target"),
            size: wgpu::Extent3d { width: w as u32, height: h as u32, depth_or_array_layers: eyes as u32 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        Ok(Self {
            frame: gpu.upload(&vec![&frame; eyes], TextureFormat::Rgba8Unorm)?,
            color: gpu.upload(&vec![&color; eyes], TextureFormat::Rgba16Float)?,
            depth: gpu.upload(&vec![&depth; eyes], TextureFormat::R32Float)?,
            velocity: gpu.upload(&vec![&flow; eyes], TextureFormat::Rg16Float)?,
            target,
            camera,
            blur,
        })
    }

    fn taps(&self, quality: Quality, bokeh: Bokeh) -> Taps {
        let words = |taps: Vec<u32>| {
            let mean = taps.iter().map(|&t| f64::from(t)).sum::<f64>() / taps.len().max(1) as f64;
            format!("{mean:.0}, {}", taps.iter().max().copied().unwrap_or(0))
        };
        Taps {
            defocus: words(self.blur.iter().map(|b| quality.defocus_taps(bokeh, b.0)).collect()),
            motion: words(self.blur.iter().map(|b| quality.motion_blur_taps(b.1)).collect()),
        }
    }

    fn time(
        &self,
        gpu: &Gpu,
        compositor: &Compositor,
        (quality, bokeh, sharpening): (Quality, Bokeh, Option<SharpeningModel>),
        frames: usize,
    ) -> Result<Times> {
        let mut camera = self.camera.clone();
        if let Some(sharpening) = sharpening {
            camera.sharpening = Estimate::Known(sharpening);
        }
        let inputs = Inputs {
            frame: &self.frame,
            color: &self.color,
            depth: Some(Depth { texture: &self.depth, scale: 1.0, offset: 0.0 }),
            velocity: Some(Velocity { texture: &self.velocity, scale: [1.0; 2] }),
            apart: false,
        };
        let bound = compositor.bind(&gpu.device, &inputs)?;
        let views: Vec<_> = (0..self.target.depth_or_array_layers())
            .map(|eye| {
                self.target.create_view(&wgpu::TextureViewDescriptor {
                    dimension: Some(wgpu::TextureViewDimension::D2),
                    base_array_layer: eye,
                    array_layer_count: Some(1),
                    ..Default::default()
                })
            })
            .collect();
        // A software device's timestamps do not tell when a step ended.
        let software = gpu.info.device_type == wgpu::DeviceType::Cpu;
        let timer = Timer::new(gpu).ok().filter(|_| !software);
        let (mut whole, mut steps) = (Vec::new(), vec![Vec::new(); STEPS.len()]);
        // The first frames warm the device up.
        for number in 0..frames as u64 + 2 {
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            let frame = Frame {
                model: &camera,
                options: CompositeOptions { bokeh, ..Default::default() },
                quality,
                number,
                area: None,
                targets: &views,
                timer: timer.as_ref(),
            };
            compositor.encode(&gpu.queue, &mut encoder, &bound, &frame)?;
            gpu.wait()?;
            let start = Instant::now();
            gpu.queue.submit([encoder.finish()]);
            gpu.wait()?;
            let elapsed = 1e3 * start.elapsed().as_secs_f64();
            if number < 2 {
                continue;
            }
            whole.push(elapsed);
            if let Some(timer) = &timer {
                steps.iter_mut().zip(timer.read(gpu)?).for_each(|(s, ms)| s.push(ms));
            }
        }
        whole.sort_by(f64::total_cmp);
        let median = |mut ms: Vec<f32>| {
            ms.sort_by(f32::total_cmp);
            ms[ms.len() / 2]
        };
        let steps = timer.map(|_| std::array::from_fn(|i| median(std::mem::take(&mut steps[i]))));
        Ok(Times { steps, frame: whole[whole.len() / 2] })
    }
}
