//! Benchmarks of the fits to one 512x512 frame with evidence in memory. The paper reports 36, 235 and 895 ms for noise, motion blur
//! and defocus on its GPU.
//!
//!     cargo bench -p blindaug --bench fit
//!
//! Least times: each fit reads its images (3 MB of RGB, 1 MB a plane) a few times, which takes less than 1 ms; the rest is arithmetic:
//! the five bands of a pyramid for noise; 8000 places x 21 exposures x up to 20 cubic taps for the shutter; 8000 places x 23 stds
//! x up to 41 rows of a disk for the lens.

#[path = "../tests/leaves/mod.rs"]
mod leaves;

use blindaug::fit::{
    Estimator, Evidence, FrameObservation, defocus, motion_blur, noise::NoiseEvidence, spectral,
    track::Tracker,
};
use blindaug::model::{BlurSpace, ExposureFraction, Method};
use blindaug::synth::{self, defocus::Bokeh};
use blindaug::{Encoded, Flow, Plane, Raster};
use criterion::{Criterion, criterion_group, criterion_main};
use std::{hint::black_box, time::Duration};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const N: usize = 512;

/// A texture at every scale: waves of many lengths and directions.
fn texture() -> Plane {
    Plane::from_fn(N, N, |x, y| {
        let (x, y) = (x as f32, y as f32);
        let wave = |k: i32| {
            let k = k as f32;
            let f = 0.04 * 1.17f32.powf(k);
            ((x * (2.4 * k).cos() + y * (2.4 * k).sin()) * f + k).sin() / (1.0 + 0.3 * k)
        };
        0.4 + 0.09 * (0..20).map(wave).sum::<f32>()
    })
}

fn bench(c: &mut Criterion) {
    let sharp = texture();
    let flow = Flow::from_fn(N, N, |x, y| [12.0 + 0.01 * y as f32, 4.0 - 0.01 * x as f32]);
    let depth = Plane::from_fn(N, N, |x, _| 0.2 + x as f32 / N as f32);
    let exposure = ExposureFraction(0.5);
    let moved = synth::motion_blur::motion_blur(&sharp, &flow, exposure).expect("one size");
    let sigma = depth.map(|d| 6.0 * (d - 0.6).abs());
    let defocused = synth::defocus::defocus(&sharp, &sigma, Bokeh::Disk).expect("one size");
    let weight = Plane::filled(N, N, 100.0);
    let frame = |p: &Plane, seed: u64| {
        let noise = synth::noise::unit_bands(N, N, seed, 0);
        let white = synth::noise::white_band_std();
        let noise = synth::noise::modulated(noise, |l, _, _| [0.01 * white[l]; 3]);
        Encoded(Raster::from_fn(N, N, |x, y| noise.at(x, y).map(|n| p.at(x, y) + n)))
    };
    let (noisy, next) = (frame(&moved, 1), frame(&moved, 2));
    let clean = Encoded(moved.map(|v| [v; 3]));
    let still = Flow::filled(N, N, [0.3, 0.2]);

    let mut g = c.benchmark_group("fit");
    g.sample_size(10).measurement_time(Duration::from_secs(3)).warm_up_time(Duration::from_secs(1));
    g.bench_function("noise/denoised", |b| {
        b.iter(|| {
            let mut e = NoiseEvidence::new(Method::Removal);
            e.add_denoised(black_box(&noisy), &clean).expect("one size");
            e.fit()
        })
    });
    g.bench_function("noise/temporal", |b| {
        b.iter(|| {
            let mut e = NoiseEvidence::new(Method::Temporal);
            e.add_pair(black_box(&noisy), &next, &still).expect("one size");
            e.fit()
        })
    });
    g.bench_function("motion_blur/clean", |b| {
        b.iter(|| motion_blur::fit_exposure(black_box(&moved), &weight, &sharp, &flow))
    });
    g.bench_function("defocus/clean", |b| {
        b.iter(|| defocus::fit_lens(black_box(&defocused), &weight, &sharp, &depth, None))
    });
    g.bench_function("defocus/search", |b| {
        b.iter(|| defocus::pooled_search(black_box(&defocused), &sharp, &depth))
    });
    let noise = Default::default();
    let (seen, blurred) = (frame(&moved, 3), frame(&defocused, 4));
    g.bench_function("motion_blur/spectral", |b| {
        b.iter(|| {
            let tiles = spectral::tiles(black_box(&seen), Some(&flow), None, BlurSpace::Encoded.into())
                .expect("one size");
            spectral::fit_exposure(&[&tiles], &[], &noise)
        })
    });
    g.bench_function("defocus/spectral", |b| {
        b.iter(|| {
            let tiles = spectral::tiles(black_box(&blurred), None, Some(&depth), BlurSpace::Encoded.into())
                .expect("one size");
            spectral::fit_lens(&[&tiles], &noise, ExposureFraction(0.0), None)
        })
    });
    // The whole estimate is made from a pair of frames alone, including flow and depth.
    let clip = leaves::Scene::new(1, (N, N)).clip(2, |_| leaves::CAMERA);
    let pair = || FrameObservation {
        frame: black_box(&clip[0].frame),
        next: Some(&clip[1].frame),
        previous: None,
        evidence: Evidence::default(),
    };
    g.bench_function("pair/estimator", |b| {
        b.iter(|| {
            let mut estimator = Estimator::new(Default::default());
            estimator.add(&pair()).expect("one size");
            estimator.estimate()
        })
    });
    g.bench_function("pair/tracker", |b| {
        b.iter(|| Tracker::new(Default::default(), None).push(&pair()).expect("one size").clone())
    });
    g.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
