//! Speed of the analysis: `cargo bench --bench analysis`.

use blindaug::{Plane, analysis::flow};
use criterion::{Criterion, criterion_group, criterion_main};

/// A texture with detail at every scale that moves by (11.3, -4.6) px, with a little noise.
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
    group.bench_function("512", |bench| bench.iter(|| flow::flow(&a, &b)));
    group.bench_function("512 with occlusion", |bench| bench.iter(|| flow::flow_with_occlusion(&a, &b)));
    group.finish();
}

criterion_group!(analysis, benches);
criterion_main!(analysis);
