//! Tests on compressed footage, made by a small video coder that predicts along the motion and quantises 8x8 transforms.

use blindaug::fit::noise::{LumaNoise, NoiseEvidence};
use blindaug::fit::{Estimator, EstimatorOptions, Evidence, FrameObservation, spectral, track::Tracker};
use blindaug::model::{ExposureFraction, Method, Space};
use blindaug::{Encoded, Flow, Plane, Raster, Transfer, filter, luma, synth};
use std::f32::consts::PI;

const SIZE: (usize, usize) = (320, 240);
/// The motion of the picture, px per frame.
const MOTION: [isize; 2] = [-11, 4];
/// The quantisation step of the transform's coefficients: 16 of 255, as H.264 has it at QP 28.
const STEP: f32 = 16.0 / 255.0;

/// The quantised residual of 8x8 px; coefficients smaller than two thirds of a step are dropped.
fn quantised(block: [[f32; 8]; 8]) -> [[f32; 8]; 8] {
    let basis = |k: usize, i: usize| {
        let scale = if k == 0 { 0.125f32.sqrt() } else { 0.5 };
        scale * (PI * (i as f32 + 0.5) * k as f32 / 8.0).cos()
    };
    let transformed = |m: [[f32; 8]; 8], inverse: bool| -> [[f32; 8]; 8] {
        std::array::from_fn(|k| {
            std::array::from_fn(|l| {
                (0..64)
                    .map(|n| (n / 8, n % 8))
                    .map(|(i, j)| {
                        let gain =
                            if inverse { basis(i, k) * basis(j, l) } else { basis(k, i) * basis(l, j) };
                        gain * m[i][j]
                    })
                    .sum()
            })
        })
    };
    let levels = |v: f32| v.signum() * (v.abs() / STEP + 1.0 / 3.0).floor() * STEP;
    transformed(transformed(block, false).map(|row| row.map(levels)), true)
}

/// A clip of a camera that moves past a wall, whose spectrum falls like a natural image's and whose contrast changes from place to place.
fn clip(seed: u64, exposure: f32, noise: f32) -> Vec<Encoded> {
    let (w, h) = (SIZE.0 + 96, SIZE.1 + 96);
    let white = |seed: u64, strength: f32| {
        let std = synth::noise::white_band_std().map(|s| s * strength);
        let bands = synth::noise::unit_bands(w, h, seed, 0);
        synth::noise::modulated(bands, |l, _, _| [std[l]; 3])
    };
    let octaves: Vec<(f32, Plane)> = (0..6)
        .map(|i| {
            let gain = 2f32.powi(i);
            (gain, filter::gaussian_blur(&white(seed + i as u64, 1.0).map(|v| v[0]), 0.6 * gain))
        })
        .collect();
    let wall = Plane::from_fn(w, h, |x, y| {
        let contrast = 0.02 + 0.12 * ((x as f32 / 60.0).sin() * (y as f32 / 45.0).cos()).powi(2);
        (0.45 + contrast * octaves.iter().map(|(g, o)| g * o.at(x, y)).sum::<f32>()).clamp(0.03, 0.97)
    });
    let flow = Flow::filled(w, h, MOTION.map(|v| v as f32));
    let light = wall.map(|v| Transfer::Srgb.decode(v));
    let blurred = synth::motion_blur::motion_blur(&light, &flow, ExposureFraction(exposure)).unwrap();
    (0..4)
        .map(|t| {
            let noise = white(100 * seed + t as u64, noise);
            Encoded(Raster::from_fn(SIZE.0, SIZE.1, |x, y| {
                let at = |v: usize, motion: isize| v.checked_add_signed(48 - motion * (t - 2)).unwrap_or(0);
                let v = Transfer::Srgb.encode(blurred.at(at(x, MOTION[0]), at(y, MOTION[1])));
                let n = noise.at(x, y);
                [0, 1, 2].map(|c| {
                    let tint = [1.05, 1.0, 0.8][c];
                    ((tint * v + n[c]).clamp(0.0, 1.0) * 255.0).round() / 255.0
                })
            }))
        })
        .collect()
}

/// The decoded clip: each frame is predicted from the decoded frame before, and chroma has half the resolution.
fn coded(clip: &[Encoded]) -> Vec<Encoded> {
    let (w, h) = SIZE;
    let mut decoded: Vec<Encoded> = vec![];
    for frame in clip {
        let predicted: Raster<[f32; 3]> = match decoded.last() {
            Some(last) => Raster::from_fn(w, h, |x, y| {
                last.0.cubic(x as f32 - MOTION[0] as f32, y as f32 - MOTION[1] as f32)
            }),
            None => Raster::filled(w, h, [0.5; 3]),
        };
        let residual = |x: usize, y: usize| {
            let (a, b) = (frame.0.at(x, y), predicted.at(x, y));
            [0, 1, 2].map(|c| a[c] - b[c])
        };
        // Green stands for luma, and the differences of red and blue from green for chroma.
        let chroma = Raster::from_fn(w / 2, h / 2, |x, y| {
            let of = |c: usize| {
                (0..4)
                    .map(|i| residual(2 * x + i % 2, 2 * y + i / 2))
                    .map(|r| 0.25 * (r[c] - r[1]))
                    .sum::<f32>()
            };
            [of(0), of(2)]
        });
        let plane = |size: (usize, usize), value: &dyn Fn(usize, usize) -> f32| {
            let mut out = Plane::filled(size.0, size.1, 0.0);
            for (bx, by) in (0..size.1 / 8).flat_map(|y| (0..size.0 / 8).map(move |x| (8 * x, 8 * y))) {
                let block =
                    quantised(std::array::from_fn(|y| std::array::from_fn(|x| value(bx + x, by + y))));
                for (y, row) in block.iter().enumerate() {
                    out.row_mut(by + y)[bx..bx + 8].copy_from_slice(row);
                }
            }
            out
        };
        let luma = plane((w, h), &|x, y| residual(x, y)[1]);
        let half = (w / 16 * 8, h / 16 * 8);
        let [red, blue] = [0, 1].map(|c| plane(half, &|x, y| chroma.at(x, y)[c]));
        decoded.push(Encoded(Raster::from_fn(w, h, |x, y| {
            let (p, l) = (predicted.at(x, y), luma.at(x, y));
            let at = |c: &Plane| c.at((x / 2).min(half.0 - 1), (y / 2).min(half.1 - 1));
            [p[0] + l + at(&red), p[1] + l, p[2] + l + at(&blue)]
                .map(|v| (v.clamp(0.0, 1.0) * 255.0).round() / 255.0)
        })));
    }
    decoded
}

/// The frame with chroma of half the resolution, as 4:2:0 has it.
fn with_half_chroma(Encoded(frame): &Encoded) -> Encoded {
    let chroma = frame.map(|p| p.map(|v| v - luma(p)));
    let mean = |x: usize, y: usize| -> [f32; 3] {
        let (x, y) = (x / 2 * 2, y / 2 * 2);
        std::array::from_fn(|c| {
            [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| chroma.at(x + i, y + j)[c]).iter().sum::<f32>()
                / 4.0
        })
    };
    Encoded(Raster::from_fn(frame.width(), frame.height(), |x, y| {
        mean(x, y).map(|c| luma(frame.at(x, y)) + c)
    }))
}

#[test]
fn coded_footage_tells_its_exposure_if_the_coder_s_errors_are_allowed_for() {
    let flow = Flow::filled(SIZE.0, SIZE.1, MOTION.map(|v| v as f32));
    let noise_of = |frames: &[Encoded]| {
        let mut evidence = NoiseEvidence::new(Method::Temporal);
        frames.windows(2).for_each(|pair| evidence.add_pair(&pair[0], &pair[1], &flow).unwrap());
        evidence.fit().luma.expect("much can be followed")
    };
    for (seed, exposure) in [(1, 0.4), (2, 0.6), (3, 0.8)] {
        let plain = clip(seed, exposure, 0.01);
        // A sensor's noise is not taken for a coder's.
        assert_eq!(noise_of(&plain).coding_error, 0.0);
        // Nor is chroma of half the resolution, as ProRes and uncompressed video have it.
        let halved: Vec<Encoded> = plain.iter().map(with_half_chroma).collect();
        assert_eq!(noise_of(&halved).coding_error, 0.0);
        let coded = coded(&plain);
        let noise = noise_of(&coded);
        assert!(noise.coding_error > 0.03, "{noise:?}");
        let mut estimator = Estimator::new(EstimatorOptions::default());
        for observation in FrameObservation::of_frames(&coded) {
            let evidence = Evidence { flow: Some(&flow), ..Evidence::default() };
            estimator.add(&FrameObservation { evidence, ..observation }).unwrap();
        }
        let found = estimator.estimate().unwrap();
        let warnings = &found.model.warnings;
        assert!(warnings.iter().any(|n| n.contains("compressed")), "{warnings:?}");
        // The tracker says so, too, and says nothing of footage that was not coded.
        let tracked = |frames: &[Encoded]| {
            let mut tracker = Tracker::new(Space::default(), None);
            for observation in FrameObservation::of_frames(frames) {
                let evidence = Evidence { flow: Some(&flow), ..Evidence::default() };
                tracker.push(&FrameObservation { evidence, ..observation }).unwrap();
            }
            tracker.model().unwrap().warnings.clone()
        };
        assert!(tracked(&coded).iter().any(|n| n.contains("compressed")), "{:?}", tracked(&coded));
        assert!(tracked(&plain).iter().all(|n| !n.contains("compressed")), "{:?}", tracked(&plain));
        let found = *found.model.motion_blur.known().expect("much moves");
        println!("{exposure}: {:?} {:?}", found.exposure, found.interval);
        let error = (found.exposure.0 - exposure).abs();
        assert!(error < 0.1 && found.interval[1] - found.interval[0] < 0.5);
        assert!((found.interval[0]..=found.interval[1]).contains(&exposure));
        // Negative control: if no coding error is allowed for, the tiles are sure of a wrong exposure.
        let tiles: Vec<Vec<spectral::Tile>> = coded
            .iter()
            .map(|f| spectral::tiles(f, Some(&flow), None, Default::default()).unwrap())
            .collect();
        let tiles: Vec<&[spectral::Tile]> = tiles.iter().map(Vec::as_slice).collect();
        let credulous = LumaNoise { coding_error: 0.0, ..noise };
        let wrong = spectral::fit_exposure(&tiles, &[], &credulous)
            .expect("sound observations")
            .into_known()
            .expect("they are sure of it");
        println!("nothing allowed for: {:?} {:?}", wrong.exposure, wrong.interval);
        assert!((wrong.exposure.0 - exposure).abs() > (5.0 * error).max(0.08));
        assert!(!(wrong.interval[0]..=wrong.interval[1]).contains(&exposure));
    }
}
