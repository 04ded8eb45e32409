//! Benchmark of the tracker's time for a frame of 640x480 px, with flow and depth estimated. A camera of 30 frames a second leaves 33 ms.
//!
//!     cargo bench -p blindaug --bench track

#[path = "../tests/leaves/mod.rs"]
mod leaves;

use blindaug::fit::{Evidence, FrameObservation, track::Tracker};
use criterion::{Criterion, criterion_group, criterion_main};
use leaves::{CAMERA, Scene};
use std::hint::black_box;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn bench(c: &mut Criterion) {
    // The number of frames has no common divisor with the periods of the tracker's work.
    let clip = Scene::new(1, (640, 480)).clip(14, |_| CAMERA);
    let pairs = clip.len() - 1;
    let mut tracker = Tracker::new(Default::default(), None);
    let mut push = |t: usize| {
        let [frame, next] = [t, t + 1].map(|t| &clip[t].frame);
        let observation =
            FrameObservation { frame, next: Some(next), previous: None, evidence: Evidence::default() };
        tracker.push(black_box(&observation)).expect("one size").motion_blur.known().is_some()
    };
    let mut group = c.benchmark_group("track");
    group.sample_size(10).throughput(criterion::Throughput::Elements(3 * pairs as u64));
    group.bench_function("640x480, 39 frames", |b| {
        b.iter(|| (0..3 * pairs).filter(|t| push(t % pairs)).count());
    });
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
