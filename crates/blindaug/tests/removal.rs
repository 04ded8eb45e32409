//! Tests of the removal of noise and blur from the frames alone, with known answers and negative controls.

mod leaves;

use blindaug::fit::removal::{Line, NoisyLight, denoise, kernel};
use blindaug::fit::{Estimation, Estimator, EstimatorOptions, Evidence, Family, FrameObservation};
use blindaug::model::{DefocusCurve, DepthKind, Method};
use blindaug::{Flow, Plane, synth};
use leaves::{CAMERA, Camera, Scene};

/// White noise of std 1 that depends on the seed.
fn white(w: usize, h: usize, seed: u64) -> Plane {
    let std = synth::noise::white_band_std();
    synth::noise::modulated(synth::noise::unit_bands(w, h, seed, 0), |l, _, _| [std[l]; 3]).map(|v| v[0])
}

/// The mean square over the middle of an image.
fn power(image: &Plane) -> f32 {
    let middle = image.crop(16, 16, image.width() - 32, image.height() - 32);
    middle.data().iter().map(|v| v * v).sum::<f32>() / middle.data().len() as f32
}

#[test]
fn denoising_leaves_a_third_of_the_noise_and_smears_nothing_where_the_flow_is_wrong() {
    const NOISE: f32 = 0.02;
    let (w, h) = (128, 96);
    let scene = |x: f32, y: f32| 0.5 + 0.2 * (0.35 * x).sin() * (0.3 * y).cos();
    // The scene moves by 3 px a frame.
    let seen = |t: f32| Plane::from_fn(w, h, |x, y| scene(x as f32 - 3.0 * t, y as f32));
    let noisy = |t: f32, seed: u64| {
        let (image, noise) = (seen(t), white(w, h, seed));
        Plane::from_fn(w, h, |x, y| image.at(x, y) + NOISE * noise.at(x, y))
    };
    let frame = NoisyLight { light: noisy(0.0, 1), variance: Plane::filled(w, h, NOISE * NOISE) };
    let neighbours = [(noisy(1.0, 2), 1.0), (noisy(-1.0, 3), -1.0)];
    let error = |denoised: &Plane| {
        let truth = seen(0.0);
        power(&Plane::from_fn(w, h, |x, y| denoised.at(x, y) - truth.at(x, y))) / (NOISE * NOISE)
    };
    let right = denoise(&frame, &neighbours, &Flow::filled(w, h, [3.0, 0.0]));
    let left = error(&right.light);
    println!("{left}");
    assert!((0.3..0.42).contains(&left), "{left} of the noise's power is left");
    let told = right.variance.at(64, 48) / (NOISE * NOISE);
    assert!((told / left - 1.0).abs() < 0.25, "{told} told, {left} left");
    // With a flow that is wrong by 7 px, a plain mean would be far from the truth.
    let wrong = denoise(&frame, &neighbours, &Flow::filled(w, h, [10.0, 0.0]));
    let mean = Plane::from_fn(w, h, |x, y| {
        let moved = |n: &Plane, by: isize| n.at_clamped(x as isize + by, y as isize);
        (frame.light.at(x, y) + moved(&neighbours[0].0, 10) + moved(&neighbours[1].0, -10)) / 3.0
    });
    println!("{} {}", error(&wrong.light), error(&mean));
    assert!(error(&wrong.light) < 1.1 && error(&mean) > 5.0);
    // Unknown flow changes nothing.
    assert_eq!(denoise(&frame, &neighbours, &Flow::filled(w, h, [f32::NAN; 2])).light, frame.light);
}

/// The gradients of a line with a few edges, and the line blurred by a kernel, with noise.
fn edges(kernel: &[f64], noise: f32, seed: u64) -> (Vec<f64>, Line) {
    const N: usize = 48;
    let random = white(N, 4, seed);
    let reach = kernel.len() / 2;
    let mut gradient = vec![0.0f64; N - 1 + 2 * reach];
    for i in 0..7 {
        let at = (i * gradient.len() / 7 + (2.0 * (random.at(i, 1) + 2.0)).clamp(0.0, 6.0) as usize)
            .min(gradient.len() - 1);
        gradient[at] = 0.1 * f64::from(random.at(i, 2)).signum() * (1.0 + f64::from(random.at(i, 3)).abs());
    }
    let mut pixels = vec![0.5f32];
    for j in 0..N - 1 {
        let step: f64 = kernel.iter().enumerate().map(|(t, k)| k * gradient[j + t]).sum();
        pixels.push(pixels[j] + step as f32);
    }
    for (i, p) in pixels.iter_mut().enumerate() {
        *p += noise * random.at(i, 0);
    }
    (gradient[reach..reach + N - 1].to_vec(), Line::new(&pixels, &[noise * noise; N]))
}

#[test]
fn the_true_kernel_has_the_most_evidence_and_restores_best() {
    for (streak, sigma) in [(8.0, 0.0), (0.0, 2.0), (6.0, 1.0)] {
        let truth = kernel(streak, sigma);
        // The evidence of the true kernel scaled by a factor.
        let evidence = |scale: f32| {
            let k = kernel(scale * streak, scale * sigma);
            (0..12).map(|seed| edges(&truth, 0.003, seed).1.deconvolved(&k).1).sum::<f64>()
        };
        let error = |scale: f32| {
            let k = kernel(scale * streak, scale * sigma);
            (0..12)
                .map(|seed| {
                    let (gradient, line) = edges(&truth, 0.003, seed);
                    let found = line.deconvolved(&k).0;
                    let reach = k.len() / 2;
                    // Edges that are half a pixel off are as good, so sums of two neighbours are compared.
                    let pair = |v: &[f64], i: usize| v[i] + v[i + 1];
                    (0..gradient.len() - 1)
                        .map(|i| (pair(&found[reach..], i) - pair(&gradient, i)).powi(2))
                        .sum::<f64>()
                })
                .sum::<f64>()
        };
        let scales = [0.0, 0.6, 1.0, 1.5];
        println!("{:?} {:?}", scales.map(evidence), scales.map(error));
        for other in [0.0, 0.6, 1.5] {
            assert!(evidence(1.0) > evidence(other) + 10.0, "{streak} {sigma}: {other}");
            assert!(error(1.0) < 0.8 * error(other), "{streak} {sigma}: {other}");
        }
    }
}

#[test]
fn taps_of_nothing_hardly_change_the_evidence() {
    let k = kernel(5.0, 0.0);
    let padded: Vec<f64> = [&[0.0; 10], k.as_slice(), &[0.0; 10]].concat();
    let (_, line) = edges(&k, 0.003, 5);
    let (a, b) = (line.deconvolved(&k).1, line.deconvolved(&padded).1);
    // The padded kernel has 20 more unknowns, each of which would cost a nat or two if its share were not subtracted.
    assert!((a - b).abs() < 2.0, "{a} {b}");
}

#[test]
fn kernels_have_unit_sum_and_the_variance_of_their_parts() {
    for (streak, sigma) in [(0.0, 0.0), (9.0, 0.0), (0.0, 2.5), (7.0, 1.5)] {
        let k = kernel(streak, sigma);
        let reach = (k.len() / 2) as f64;
        let moment = |p: i32| k.iter().enumerate().map(|(i, k)| k * (i as f64 - reach).powi(p)).sum::<f64>();
        // The profile of a disk of std sigma (radius 2 sigma) has variance sigma^2, and the pixel's response has 0.25 px^2.
        let variance = f64::from(streak * streak / 12.0 + sigma * sigma) + 0.25;
        assert!((moment(0) - 1.0).abs() < 1e-9 && moment(1).abs() < 1e-6);
        // The narrow response of the pixel has slightly less variance when it is sampled at taps one pixel apart.
        assert!((moment(2) - variance).abs() < 0.01 * variance + 0.04, "{streak} {sigma}: {}", moment(2));
    }
    // The taps of a long streak are all equal in the middle.
    let k = kernel(40.0, 0.0);
    let middle = k.len() / 2;
    assert!(k[middle - 17..middle + 18].iter().all(|v| (v * 40.0 - 1.0).abs() < 0.03), "{k:?}");
}

/// The estimate by removal from three frames of a camera, with motion and depth given.
fn by_removal(camera: Camera) -> Estimation {
    let clip = Scene::new(3, (320, 240)).clip(4, |_| camera);
    let mut estimator =
        Estimator::new(EstimatorOptions { family: Family::Removal, ..EstimatorOptions::default() });
    for (i, shot) in clip.iter().enumerate().take(3) {
        let evidence = Evidence {
            flow: Some(&shot.flow),
            inverse_depth: Some((&shot.inverse_depth, DepthKind::Metric)),
            ..Evidence::default()
        };
        let previous = i.checked_sub(1).map(|i| &clip[i].frame);
        estimator
            .add(&FrameObservation { frame: &shot.frame, next: Some(&clip[i + 1].frame), previous, evidence })
            .unwrap();
    }
    estimator.estimate().unwrap()
}

#[test]
fn a_clip_without_clean_frames_tells_its_shutter_and_its_lens() {
    for exposure in [0.3, 0.6, 0.9] {
        let model = by_removal(Camera { exposure, ..CAMERA }).model;
        let found = model.motion_blur.known().expect("there is motion and texture");
        assert_eq!(found.method, Method::Removal);
        println!("{exposure}: {} {:?}", found.exposure.0, found.interval);
        assert!((found.exposure.0 - exposure).abs() < 0.08, "{} for {exposure}", found.exposure.0);
        let lens = model.defocus.known().expect("there are depth and texture");
        assert_eq!(lens.method, Method::Removal);
        assert!(matches!(lens.curve, DefocusCurve::ThinLens { .. }));
        let error =
            |d: f32| (lens.sigma_px(d) - CAMERA.sigma_at_infinity * (1.0 - d / CAMERA.focus).abs()).abs();
        println!("{:?}", leaves::LAYERS.map(error));
        assert!(leaves::LAYERS.iter().all(|&d| error(d) < 0.45), "{:?}", leaves::LAYERS.map(error));
    }
}

#[test]
fn a_closed_shutter_is_found_closed_and_a_still_camera_says_nothing_of_it() {
    let closed = by_removal(Camera { exposure: 0.0, ..CAMERA }).model;
    let found = closed.motion_blur.known().expect("there is motion and texture");
    assert!(found.exposure.0 < 0.15, "{}", found.exposure.0);
    assert!(by_removal(Camera { moves: false, ..CAMERA }).model.motion_blur.why_unknown().is_some());
}
