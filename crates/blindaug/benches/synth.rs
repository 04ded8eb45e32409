//! Benchmarks of the synthesis of a 1080p frame.
//!
//! Least times for 1920 x 1080 RGB f32 (25 MB in, 25 MB out) on two cores with 10 GB/s and 30 GFLOP/s together:
//! 5 ms for anything, by memory; motion blur 8 taps x 4 reads x 3 channels x 2 flops: 13 ms; Gaussian defocus about 3 levels of
//! 2 x 20 taps: 25 ms; noise 2 M x (2 ln, 2 sqrt, 3 sin or cos): 30 ms, its pyramids 50 MB x 10 passes: 50 ms.

use blindaug::composite::{self, Plate, VirtualLayer, composite};
use blindaug::model::{
    CameraModel, Capture, DefocusModel, Estimate, ExposureFraction, MotionBlurModel, NoiseLevel, NoiseModel,
};
use blindaug::synth::defocus::{Bokeh, defocus};
use blindaug::synth::motion_blur::motion_blur;
use blindaug::synth::noise::{noise, white_band_std};
use blindaug::synth::{self, distort_frame};
use blindaug::{Encoded, Flow, Linear, Plane, Premultiplied, Raster};
use criterion::{Criterion, criterion_group, criterion_main};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const W: usize = 1920;
const H: usize = 1080;
const HEXAGON: Bokeh = Bokeh::Polygon { blades: 6, roundness: 0.0, rotation_degrees: 15.0 };

fn frame() -> Raster<[f32; 3]> {
    Raster::from_fn(W, H, |x, y| {
        [((x * 7 + y * 13) % 11) as f32 / 11.0, ((x * y) % 5) as f32 / 5.0, (x + y) as f32 / 3000.0]
    })
}

/// The std of the blur, `least` to `most` px, in patches with jumps between them.
fn sigma(least: f32, most: f32) -> Plane {
    Plane::from_fn(W, H, |x, y| {
        least + (most - least) * (((x / 300 + y / 250) % 4) as f32 + 0.2 * x as f32 / W as f32) / 3.2
    })
}

fn camera() -> CameraModel {
    let capture = Capture { width: W, height: H, fps: None, frames_used: 0, pixel_aspect: 1.0 };
    let mut model = CameraModel::unknown(capture, "not needed");
    let levels = white_band_std().map(|s| NoiseLevel { slope: [0.03 * s; 3], intercept: [0.01 * s; 3] });
    model.noise = Estimate::Known(NoiseModel::given(levels, 1.0));
    model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.5)));
    model.defocus = Estimate::Known(DefocusModel::given_lens(4.0, 0.5));
    model
}

fn bench(c: &mut Criterion) {
    let mut group = c.benchmark_group("synth/1080p");
    group.sample_size(10);
    let frame = frame();
    let flow = Flow::from_fn(W, H, |x, _| [10.0 + 10.0 * (x as f32 / W as f32), 5.0]);
    group.bench_function("motion_blur", |b| b.iter(|| motion_blur(&frame, &flow, ExposureFraction(0.5))));
    for (bokeh, name) in [(Bokeh::Gaussian, "gaussian"), (Bokeh::Disk, "disk"), (HEXAGON, "hexagon")] {
        for most in [4.0, 10.0] {
            let sigma = sigma(0.0, most);
            group.bench_function(format!("defocus_{name}_to_{most}_px"), |b| {
                b.iter(|| defocus(&frame, &sigma, bokeh))
            });
        }
    }
    let model = camera();
    group.bench_function("noise", |b| b.iter(|| model.noise.known().map(|m| noise(m, &frame, 1, 1))));

    // All distortions are applied to a whole frame of a wall with things in front of it.
    let sharp = Linear(frame.clone());
    let depth =
        Plane::from_fn(W, H, |x, y| [0.2, 0.3, 0.8][(x / 400 + y / 300) % 3] + 0.1 * x as f32 / W as f32);
    group.bench_function("distort_frame", |b| {
        b.iter(|| {
            distort_frame(&sharp, &model, Some(&depth), Some(&flow), &synth::SynthesisOptions::default(), 1)
        })
    });

    // All distortions are applied to an object of 600 x 600 px with a shadow, behind a post.
    let frame = Encoded(frame);
    let inside = |x: usize, y: usize| (600..1200).contains(&x) && (200..800).contains(&y);
    let layer = VirtualLayer {
        color: Premultiplied(Raster::from_fn(W, H, |x, y| {
            if inside(x, y) { [0.3, (x % 7) as f32 / 7.0, 0.1, 1.0] } else { [0.0; 4] }
        })),
        inverse_depth: Some(Plane::from_fn(W, H, |x, y| if inside(x, y) { 0.7 } else { f32::NAN })),
        flow: Some(Flow::filled(W, H, [20.0, 4.0])),
    };
    let real = Plane::from_fn(W, H, |x, _| if (850..950).contains(&x) { 1.5 } else { 0.2 });
    let without = sharp;
    let with = Linear(Raster::from_fn(W, H, |x, y| {
        let v = without.0.at(x, y);
        if (500..1300).contains(&x) && y > 600 { v.map(|v| 0.7 * v) } else { v }
    }));
    let plate = Plate {
        inverse_depth: Some(&real),
        flow: Some(&flow),
        with_and_without: Some((&with, &without)),
        ..Plate::new(&frame, 1)
    };
    group.bench_function("composite", |b| {
        b.iter(|| composite(&plate, &layer, &model, &composite::CompositeOptions::default()))
    });
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
