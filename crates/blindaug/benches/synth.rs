//! Synthesis of a 1080p frame.
//!
//! Floors on the machine it was written on (two cores, about 10 GB/s and 30 GFLOP/s together), for 1920 x 1080 RGB f32
//! (25 MB read, 25 MB written): 5 ms for any of them by memory.

use blindaug::model::ExposureFraction;
use blindaug::synth::defocus::{Bokeh, defocus};
use blindaug::synth::motion_blur::motion_blur;
use blindaug::{Flow, Plane, Raster};
use criterion::{Criterion, criterion_group, criterion_main};

const W: usize = 1920;
const H: usize = 1080;

fn frame() -> Raster<[f32; 3]> {
    Raster::from_fn(W, H, |x, y| {
        [((x * 7 + y * 13) % 11) as f32 / 11.0, ((x * y) % 5) as f32 / 5.0, (x + y) as f32 / 3000.0]
    })
}

/// Bands of depth with jumps between them: `least` to `most` px.
fn sigma(least: f32, most: f32) -> Plane {
    Plane::from_fn(W, H, |x, y| {
        least + (most - least) * (((x / 300 + y / 250) % 4) as f32 + 0.2 * x as f32 / W as f32) / 3.2
    })
}

fn bench(c: &mut Criterion) {
    let mut group = c.benchmark_group("synth/1080p");
    group.sample_size(10);
    let frame = frame();
    let flow = Flow::from_fn(W, H, |x, _| [10.0 + 10.0 * (x as f32 / W as f32), 5.0]);
    group.bench_function("motion_blur", |b| b.iter(|| motion_blur(&frame, &flow, ExposureFraction(0.5))));
    for (bokeh, name) in [(Bokeh::Gaussian, "gaussian"), (Bokeh::Disk, "disk")] {
        for most in [4.0, 10.0] {
            let sigma = sigma(0.0, most);
            group.bench_function(format!("defocus_{name}_to_{most}_px"), |b| {
                b.iter(|| defocus(&frame, &sigma, bokeh))
            });
        }
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
