//! Benchmarks of the analysis: `cargo bench -p blindaug --bench analysis`.

use blindaug::{
    Flow, Plane, Raster,
    analysis::{depth, flow},
};
use criterion::{Criterion, criterion_group, criterion_main};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Two images of a texture with detail at every scale that moves by (11.3, -4.6) px, with a little noise.
fn pair(size: usize) -> [Plane; 2] {
    let texture = |x: f32, y: f32| {
        (0..24)
            .map(|i| {
                let (angle, length) = (2.4 * i as f32, 4.0 * 1.2f32.powi(i));
                let phase = (x * angle.cos() + y * angle.sin()) * std::f32::consts::TAU / length;
                0.01 * length.sqrt() * (phase + 1.7 * i as f32).sin()
            })
            .sum::<f32>()
    };
    let noise = |x: usize, y: usize, seed: usize| ((x * 7919 + y * 104_729 + seed) * 31 % 97) as f32 / 97.0;
    [(0.0, 0.0, 1), (11.3, -4.6, 2)].map(|(dx, dy, seed)| {
        Plane::from_fn(size, size, |x, y| {
            0.5 + texture(x as f32 - dx, y as f32 - dy) + 0.03 * noise(x, y, seed)
        })
    })
}

fn benches(c: &mut Criterion) {
    let [a, b] = pair(512);
    let mut group = c.benchmark_group("flow");
    group.sample_size(20);
    let mut estimator = flow::FlowEstimator::new();
    group.bench_function("512", |bench| bench.iter(|| estimator.flow(&a, &b)));
    group.bench_function("512 with occlusion", |bench| bench.iter(|| estimator.flow_with_occlusion(&a, &b)));
    group.bench_function("512 alone, in fresh memory", |bench| bench.iter(|| flow::flow(&a, &b)));
    group.finish();

    // The camera moves to the side and turns in front of a floor.
    let seen = Flow::from_fn(512, 512, |x, y| {
        let (x, y) = (x as f32 / 614.0 - 0.42, y as f32 / 614.0 - 0.42);
        let d = (0.5 + y).max(0.4);
        [-20.0 * d + 3.0 * (1.0 + x * x), 3.0 * x * y]
    });
    let occluded = Raster::filled(512, 512, false);
    c.bench_function("parallax/512", |bench| bench.iter(|| depth::inverse_depth_from_flow(&seen, &occluded)));
}

criterion_group!(analysis, benches);
criterion_main!(analysis);
