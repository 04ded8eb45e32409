//! Benchmark of the tracker's time for a frame of 640x480 px, with flow and depth estimated. A camera of 30 frames a second leaves 33 ms.
//!
//!     cargo bench -p blindaug --bench track

#[path = "../tests/leaves/mod.rs"]
mod leaves;
#[path = "../tests/shaken/mod.rs"]
mod shaken;

use blindaug::Encoded;
use blindaug::fit::{Evidence, FrameObservation, track::Tracker};
use criterion::{Criterion, criterion_group, criterion_main};
use leaves::{CAMERA, Scene};
use std::hint::black_box;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn bench(c: &mut Criterion) {
    // The number of frames has no common divisor with the periods of the tracker's work.
    const FRAMES: usize = 14;
    const SIZE: (usize, usize) = (640, 480);
    let steady = Scene::new(1, SIZE).clip(FRAMES, |_| CAMERA).into_iter().map(|shot| shot.frame).collect();
    let clips: [(&str, Vec<Encoded>); 2] =
        [("640x480", steady), ("640x480, shaken", shaken::shaken(SIZE, FRAMES, |_| 0.5, 3.0))];
    let mut group = c.benchmark_group("track");
    for (name, clip) in clips {
        let pairs = clip.len() - 1;
        let mut tracker = Tracker::new(Default::default(), None);
        let mut push = |t: usize| {
            let (frame, next, evidence) = (&clip[t], Some(&clip[t + 1]), Evidence::default());
            let observation = FrameObservation { frame, next, previous: None, evidence };
            tracker.push(black_box(&observation)).expect("one size").motion_blur.known().is_some()
        };
        group.sample_size(10).throughput(criterion::Throughput::Elements(3 * pairs as u64));
        group.bench_function(format!("{name}, {} frames", 3 * pairs), |b| {
            b.iter(|| (0..3 * pairs).filter(|t| push(t % pairs)).count());
        });
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
