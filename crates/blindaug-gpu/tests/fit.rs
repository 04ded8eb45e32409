//! The fits on the device against those of the crate blindaug.

#[path = "../../blindaug/tests/leaves/mod.rs"]
mod leaves;

mod common;
use common::{GPU, no_gpu};

use std::thread;
use std::time::{Duration, Instant};

use blindaug::fit::noise::{LumaNoise, NoiseLine};
use blindaug::fit::track::Tracker;
use blindaug::fit::{BlurPoint, Evidence, FrameObservation, defocus, motion_blur, spectral};
use blindaug::model::{BlurSpace, DepthKind, ExposureFraction, SharpeningModel};
use blindaug::synth::{self, defocus::Bokeh};
use blindaug::{Flow, Plane, Raster, filter};
use blindaug_gpu::{Gpu, fit};
use wgpu::{Texture, TextureFormat};

fn plane(plane: &Plane) -> Texture {
    GPU.upload(&[plane], TextureFormat::R32Float).expect("it fits")
}

/// Polls until the device is done. The tests share the device, so that a poll in another test's thread may be what learns that this one's
/// work is done, and it may say so only after this thread's wait.
fn result<T>(mut poll: impl FnMut() -> blindaug::Result<Option<T>>) -> T {
    GPU.wait().expect("the device works");
    let waited = Instant::now();
    loop {
        if let Some(result) = poll().expect("the device works") {
            return result;
        }
        assert!(waited.elapsed() < Duration::from_secs(60), "the device never says that it is done");
        thread::yield_now();
    }
}

/// An image of waves of many lengths and directions, so that it has texture at every scale.
fn texture(w: usize, h: usize) -> Plane {
    Plane::from_fn(w, h, |x, y| {
        let (x, y) = (x as f32, y as f32);
        let wave = |k: i32| {
            let k = k as f32;
            let f = 0.04 * 1.17f32.powf(k);
            ((x * (2.4 * k).cos() + y * (2.4 * k).sin()) * f + k).sin() / (1.0 + 0.3 * k)
        };
        0.4 + 0.09 * (0..20).map(wave).sum::<f32>()
    })
}

/// The tolerance of a std, px, of which the search tries one every 0.1 px: two neighbours may be equally good, and sums in another order
/// choose the other one.
const SEARCHED_STD: f32 = 0.101;
/// The share of the places that only one of the two searches may take, since their contrast lies at the threshold.
const OTHER_PLACES: f32 = 0.01;

/// The largest difference of the stds, px, at places that both searches have, and the share of the places that only one of them has.
fn differences(a: &[BlurPoint], b: &[BlurPoint]) -> (f32, f32) {
    let (mut std, mut alone) = (0.0f32, 0);
    for p in a {
        match b.iter().find(|q| q.inverse_depth == p.inverse_depth) {
            Some(q) => std = std.max((p.sigma_px - q.sigma_px).abs()),
            None => alone += 1,
        }
    }
    (std, (alone + b.len() + alone - a.len()) as f32 / a.len().max(1) as f32)
}

#[test]
fn the_pooled_search_finds_what_the_cpu_finds() {
    if no_gpu() {
        return;
    }
    let (w, h) = (131, 90);
    let sharp = texture(w, h);
    // Each place has another depth, so that places can be told apart. The depth is not known everywhere.
    let depth =
        Plane::from_fn(
            w,
            h,
            |x, y| {
                if x < 9 { f32::NAN } else { 0.1 + x as f32 / 150.0 + y as f32 / 100_000.0 }
            },
        );
    let observed =
        synth::defocus::defocus(&sharp, &depth.map(|d| 4.0 * (d.max(0.1) - 0.3).abs()), Bokeh::Disk)
            .expect("one size");
    let expected = defocus::pooled_search(&observed, &sharp, &depth);
    let target = plane(&observed);
    let mut search = fit::defocus::PooledSearch::new(&GPU.device, &target, &plane(&sharp), &plane(&depth))
        .expect("one size");
    let mut found = || {
        assert!(search.submit(&GPU.device, &GPU.queue));
        assert!(!search.submit(&GPU.device, &GPU.queue), "the first one's result is still to come");
        result(|| search.poll(&GPU.device))
    };
    let (std, alone) = differences(&expected, &found());
    println!("{} places, std {std}, share in one alone {alone}", expected.len());
    assert!(expected.len() > 200 && std <= SEARCHED_STD && alone <= OTHER_PLACES, "{std} {alone}");
    let lens = |points: &[BlurPoint]| defocus::quadratic(points).expect("many depths").0;
    let (a, b) = (lens(&expected), lens(&found()));
    println!("{a:?} {b:?}");
    let at = |[a, b, c]: [f32; 3], d: f32| a * d * d + b * d + c;
    assert!([0.2, 0.5, 0.9].iter().all(|&d| (at(a, d) - at(b, d)).abs() < 0.01));

    // Other pixels in the same texture give another answer.
    GPU.write(&target, &[&filter::gaussian_blur(&observed, 1.0)]);
    let (std, alone) = differences(&expected, &found());
    println!("negative control: std {std}, {alone}");
    assert!(std > SEARCHED_STD, "{std} {alone}");
}

/// The tolerance of the exposure, which is the search's last step: two exposures as far apart may be equally good, and sums in another
/// order choose the other one.
const SEARCHED_EXPOSURE: f32 = 0.0021;
/// The number of places, out of thousands, that only one of the two searches may take, since rounding decides about their contrast.
const OTHER_SAMPLES: usize = 3;
/// The relative tolerance of the variance. It is a sum over places in another order, at exposures that are up to a step apart. The same
/// holds for the curve, whose tolerance is a share of its depth.
const VARIANCE: f64 = 0.05;
const CURVE: f32 = 0.01;

#[test]
fn the_exposure_search_finds_what_the_cpu_finds() {
    if no_gpu() {
        return;
    }
    let (w, h) = (144, 120);
    let sharp = texture(w, h);
    // The flow is unknown at the left, and has an edge at the top.
    let flow = Flow::from_fn(w, h, |x, y| match (x, y) {
        (0..20, _) => [f32::NAN; 2],
        (_, 0..30) => [-7.0, 5.0],
        _ => [9.0 + 0.02 * y as f32, 4.0 - 0.02 * x as f32],
    });
    let known = flow.map(|f| if f[0].is_finite() { f } else { [0.0; 2] });
    let observed = |lambda| {
        let blurred =
            synth::motion_blur::motion_blur(&sharp, &known, ExposureFraction(lambda)).expect("one size");
        // There is noise, so that the weights matter.
        Plane::from_fn(w, h, |x, y| blurred.at(x, y) + 0.01 * ((x * 7919 + y * 104_729) % 101) as f32 / 101.0)
    };
    let weight = Plane::from_fn(w, h, |x, _| 100.0 + x as f32 / 10.0);
    let target = plane(&observed(0.43));
    let flow_texture = GPU.upload(&[&flow], TextureFormat::Rg32Float).expect("it fits");
    let mut search = fit::motion_blur::ExposureSearch::new(
        &GPU.device,
        &target,
        &plane(&weight),
        &plane(&sharp),
        &flow_texture,
    )
    .expect("one size");
    let mut found = || {
        assert!(search.submit(&GPU.device, &GPU.queue));
        assert!(!search.submit(&GPU.device, &GPU.queue), "the first one's result is still to come");
        result(|| search.poll(&GPU.device))
    };
    let expected = motion_blur::fit_exposure(&observed(0.43), &weight, &sharp, &flow).expect("much moves");
    let fit = found().expect("much moves");
    let apart = (fit.exposure.0 - expected.exposure.0).abs();
    let variance = (fit.variance / expected.variance - 1.0).abs();
    let (mut curve, mut depth) = (0.0f32, 0.0f32);
    for (a, b) in fit.curve.iter().zip(&expected.curve) {
        assert!((a[0] - b[0]).abs() < 1e-6);
        curve = curve.max((a[1] - b[1]).abs());
        depth = depth.max(-b[1]);
    }
    println!(
        "{} and {}, apart {apart}; samples {} and {}, variance {variance}, curve {}",
        fit.exposure.0,
        expected.exposure.0,
        fit.samples,
        expected.samples,
        curve / depth
    );
    assert!(apart <= SEARCHED_EXPOSURE && (expected.exposure.0 - 0.43).abs() < 0.05);
    assert!(
        fit.samples.abs_diff(expected.samples) <= OTHER_SAMPLES && fit.curve.len() == expected.curve.len()
    );
    assert!(variance <= VARIANCE && curve <= CURVE * depth);

    GPU.write(&target, &[&observed(0.47)]);
    let wrong = found().expect("much moves");
    assert!((wrong.exposure.0 - expected.exposure.0).abs() > SEARCHED_EXPOSURE);

    // First the flow is 0, then it is unknown.
    for still in [0.0, f32::NAN] {
        GPU.write(&flow_texture, &[&Flow::filled(w, h, [still; 2])]);
        assert!(found().is_none());
    }
}

/// The tolerance of a curve, nats per tile. It is made of exponentials and logarithms of a few hundred bins in f32, whose last digits the
/// shaders' language leaves to the device, and of powers where the CPU has a table of the transfer curve.
const CURVE_TOLERANCE: f32 = 0.001;
/// The tolerance of a point's weight, 0 to 1, for the reasons of CURVE_TOLERANCE.
const WEIGHT: f32 = 0.001;
/// The relative tolerance of the lens, whose search ends in steps of 1/1000.
const LENS: f32 = 0.004;

/// The largest difference of two curves.
fn apart(a: &[[f32; 2]], b: &[[f32; 2]]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a[1] - b[1]).abs()).fold(0.0, f32::max)
}

/// The points (exposure fraction, log-likelihood) of all observations together, 0 at the maximum.
fn curve_of(observations: &[spectral::ExposureObservation]) -> Vec<[f32; 2]> {
    let sum = |i: usize| observations.iter().map(|w| w.log_likelihood[i]).sum::<f32>();
    let sums: Vec<f32> = (0..spectral::EXPOSURES).map(sum).collect();
    let most = sums.iter().copied().fold(f32::MIN, f32::max);
    let step = spectral::numbers::EXPOSURE_STEP;
    sums.iter().enumerate().map(|(i, v)| [i as f32 * step, v - most]).collect()
}

/// The largest difference of the weights of points, place by place; 1 if the places differ or find another std.
fn other_points(a: &[BlurPoint], b: &[BlurPoint]) -> f32 {
    let sorted = |points: &[BlurPoint]| {
        let mut points = points.to_vec();
        let key = |p: &BlurPoint| [p.inverse_depth, p.sigma_px, p.weight];
        points.sort_by(|p, q| key(p).partial_cmp(&key(q)).expect("finite"));
        points
    };
    let differ = |p: &BlurPoint, q: &BlurPoint| {
        if a.len() == b.len() && p.inverse_depth == q.inverse_depth && p.sigma_px == q.sigma_px {
            (p.weight - q.weight).abs()
        } else {
            1.0
        }
    };
    sorted(a).iter().zip(sorted(b)).map(|(p, q)| differ(p, &q)).fold(0.0, f32::max)
}

/// The relative difference of two lenses.
fn other_lens(a: &spectral::LensFit, b: &spectral::LensFit) -> f32 {
    (a.lens.slope / b.lens.slope - 1.0).abs().max((a.lens.focus / b.lens.focus - 1.0).abs())
}

// This test is long, since each of the three cases has its negative control.
#[test]
fn the_tiles_say_what_they_say_to_the_cpu() {
    if no_gpu() {
        return;
    }
    const CAMERA: leaves::Camera = leaves::Camera { exposure: 0.6, ..leaves::CAMERA };
    let Gpu { device, queue, .. } = &*GPU;
    let shot = &leaves::Scene::new(3, (256, 250)).clip(1, |_| CAMERA)[0];
    // The flow is not known everywhere: in so few pixels of the uppermost tiles that they count, and in so many of one below that it does not.
    let unknown = |x: usize, y: usize| y < 5 || (x < 20 && y >= 202);
    let flow = Flow::from_fn(256, 250, |x, y| if unknown(x, y) { [f32::NAN; 2] } else { shot.flow.at(x, y) });
    let rgba = shot.frame.0.map(|[r, g, b]| [r, g, b, 1.0]);
    let frame = GPU.upload(&[&rgba], TextureFormat::Rgba32Float).expect("it fits");
    let flow_texture = GPU.upload(&[&flow], TextureFormat::Rg32Float).expect("it fits");
    let depth = plane(&shot.inverse_depth);
    let levels = synth::noise::white_band_std().map(|std| NoiseLine { slope: 0.001, intercept: 0.008 * std });
    let sharpening = SharpeningModel::given(0.5, 1.0);
    let exposure = ExposureFraction(CAMERA.exposure);
    let cases = [(BlurSpace::Linear, 0.0), (BlurSpace::Encoded, 0.0), (BlurSpace::Linear, 0.03)];
    for (space, coding_error) in cases {
        let noise = LumaNoise { levels, coding_error };
        let mut evidence =
            fit::spectral::TileEvidence::new(device, &frame, Some(&flow_texture), Some(&depth), space)
                .expect("one size");
        let mut look = |noise: &LumaNoise, exposure| {
            assert!(evidence.submit(device, queue, noise, exposure, Some(&sharpening)));
            assert!(
                !evidence.submit(device, queue, noise, exposure, None),
                "the first one's result is still to come"
            );
            result(|| evidence.poll(device))
        };
        let tiles = spectral::tiles(&shot.frame, Some(&flow), Some(&shot.inverse_depth), space.into())
            .expect("one size");
        let expected = spectral::fit_exposure(&[&tiles], &[], &noise)
            .expect("sound observations")
            .into_known()
            .expect("much moves");
        let expected_lens = spectral::fit_lens(&[&tiles], &noise, exposure, Some(&sharpening))
            .expect("sound observations")
            .into_known()
            .expect("many depths");
        let found = look(&noise, exposure);
        let fit = spectral::exposure_of(&found.exposure, 1, noise.coding_error)
            .expect("sound observations")
            .into_known()
            .expect("much moves");
        let lens = spectral::lens_of(&found.lens, spectral::BOOTSTRAPS)
            .expect("sound observations")
            .into_known()
            .expect("many depths");
        let log_likelihood = apart(&fit.curve, &expected.curve) / expected.samples as f32;
        let (points, lenses) =
            (other_points(&lens.points, &expected_lens.points), other_lens(&lens, &expected_lens));
        println!(
            "{space:?}: {} observations of {:?}, nats per tile {log_likelihood}; {} of {:?}, weight {points}, lens {lenses}",
            fit.samples, fit.exposure, lens.samples, lens.lens
        );
        assert!(
            fit.samples == expected.samples
                && fit.exposure == expected.exposure
                && log_likelihood <= CURVE_TOLERANCE
        );
        assert!(lens.samples == expected_lens.samples && points <= WEIGHT && lenses <= LENS);

        // With another noise the tiles find other exposures likely, and with another exposure they find another lens.
        let other = levels.map(|n| NoiseLine { intercept: 1.2 * n.intercept, ..n });
        let other = if coding_error > 0.0 {
            LumaNoise { levels, coding_error: 1.2 * coding_error }
        } else {
            LumaNoise { levels: other, coding_error }
        };
        let found = look(&other, ExposureFraction(0.5));
        let wrong = curve_of(&found.exposure);
        assert!(apart(&wrong, &expected.curve) / expected.samples as f32 > CURVE_TOLERANCE);
        let wrong = spectral::lens_of(&found.lens, spectral::BOOTSTRAPS)
            .expect("sound observations")
            .into_known()
            .expect("many depths");
        assert!(other_lens(&wrong, &expected_lens) > LENS);
    }
}

#[test]
fn of_many_tiles_those_of_most_contrast_in_each_block_are_kept_and_nothing_need_move() {
    if no_gpu() {
        return;
    }
    let Gpu { device, queue, .. } = &*GPU;
    // The frame is large enough for tiles at a quarter of the resolution.
    let (w, h) = (800, 784);
    let sharp = texture(w, h);
    let depth = Plane::from_fn(w, h, |x, y| 0.2 + x as f32 / 1000.0 + y as f32 / 100_000.0);
    let sigma = depth.map(|d| 6.0 * (d - 0.3).abs());
    let image = synth::defocus::defocus(&sharp, &sigma, Bokeh::Disk).expect("one size");
    let rgba = image.map(|v| [v, v, v, 1.0]);
    let noise = LumaNoise { levels: [NoiseLine { slope: 0.0, intercept: 0.0005 }; 4], coding_error: 0.0 };
    let space = BlurSpace::Encoded;
    let encoded = blindaug::Encoded(image.map(|v| [v; 3]));
    let tiles = spectral::tiles(&encoded, None, Some(&depth), space.into()).expect("one size");
    // There are 1266 tiles. The fifth of them with least contrast is left out, and so are the tiles of a block beyond the most that it may
    // have, except for tiles that observe the exposure.
    assert_eq!(tiles.len(), 688);
    // Without a fifth of the 422 tiles of a small frame there would be fewer than EXPOSURE_TILES, so EXPOSURE_TILES of them are kept.
    let small = blindaug::Encoded(image.crop(0, 0, 640, 360).map(|v| [v; 3]));
    let of_small =
        spectral::tiles(&small, None, Some(&depth.crop(0, 0, 640, 360)), space.into()).expect("one size");
    assert_eq!(of_small.len(), spectral::EXPOSURE_TILES);
    let exposure = ExposureFraction(0.0);
    let of_small = spectral::fit_lens(&[&of_small], &noise, exposure, None)
        .expect("sound observations")
        .into_known()
        .expect("many depths");
    assert!(of_small.samples > 422 * 4 / 5, "{}", of_small.samples);
    let expected = spectral::fit_lens(&[&tiles], &noise, exposure, None)
        .expect("sound observations")
        .into_known()
        .expect("many depths");
    let frame = GPU.upload(&[&rgba], TextureFormat::Rgba32Float).expect("it fits");
    let mut evidence = fit::spectral::TileEvidence::new(device, &frame, None, Some(&plane(&depth)), space)
        .expect("one size");
    let mut look = || {
        assert!(evidence.submit(device, queue, &noise, exposure, None));
        let found = result(|| evidence.poll(device));
        assert!(found.exposure.is_empty());
        spectral::lens_of(&found.lens, spectral::BOOTSTRAPS)
            .expect("sound observations")
            .into_known()
            .expect("many depths")
    };
    let points = other_points(&look().points, &expected.points);
    println!("{} observations, weight {points}", expected.samples);
    assert!(points <= WEIGHT);

    GPU.write(&frame, &[&sharp.map(|v| [v, v, v, 1.0])]);
    assert!(other_points(&look().points, &expected.points) > WEIGHT);
}

/// The tolerance of the exposure. The tracker looks at some tiles of a frame and the device at all of them, so that the results differ as
/// two samples do, by about the width of their intervals.
const TRACKED_EXPOSURE: f32 = 0.1;

#[test]
fn a_tracker_that_looks_at_one_frame_follows_the_others_by_what_the_device_finds() {
    if no_gpu() {
        return;
    }
    let Gpu { device, queue, .. } = &*GPU;
    let (w, h) = (256, 200);
    let scene = leaves::Scene::new(5, (w, h));
    let unknown = Flow::filled(w, h, [f32::NAN; 2]);
    let frame =
        GPU.upload(&[&Raster::filled(w, h, [0.0f32; 4])], TextureFormat::Rgba32Float).expect("it fits");
    let flow = GPU.upload(&[&unknown], TextureFormat::Rg32Float).expect("it fits");
    let depth = plane(&Plane::filled(w, h, f32::NAN));
    let mut evidence =
        fit::spectral::TileEvidence::new(device, &frame, Some(&flow), Some(&depth), BlurSpace::Linear)
            .expect("one size");
    // The tracker's result after four frames. It looks at all of them itself, or only at the first.
    let mut tracked = |exposure: f32, itself: bool| {
        let clip = scene.clip(5, |_| leaves::Camera { exposure, ..leaves::CAMERA });
        let mut tracker = Tracker::new(Default::default(), None);
        assert!(tracker.push_observations(&[], &[], DepthKind::Metric).is_err());
        for (i, pair) in clip.windows(2).enumerate() {
            let shot = &pair[0];
            if itself || i == 0 {
                let observation = FrameObservation {
                    frame: &shot.frame,
                    next: Some(&pair[1].frame),
                    previous: None,
                    evidence: fit_evidence(shot),
                };
                tracker.push(&observation).expect("one size");
            } else {
                GPU.write(&frame, &[&shot.frame.0.map(|[r, g, b]| [r, g, b, 1.0])]);
                GPU.write(&flow, &[&shot.flow]);
                GPU.write(&depth, &[&shot.inverse_depth]);
                let model = tracker.model().expect("a frame was pushed");
                let exposure = model.motion_blur.known().map_or(ExposureFraction(0.0), |m| m.exposure);
                let sharpening = model.sharpening.known();
                assert!(evidence.submit(
                    device,
                    queue,
                    tracker.luma_noise().expect("noise is seen"),
                    exposure,
                    sharpening
                ));
                let found = result(|| evidence.poll(device));
                tracker
                    .push_observations(&found.exposure, &found.lens, DepthKind::Metric)
                    .expect("of this fit");
            }
        }
        let outside = spectral::ExposureObservation {
            block: 25,
            frame: 0,
            speed: 3.0,
            speed_error: 0.0,
            log_likelihood: vec![0.0; 251],
        };
        assert!(tracker.push_observations(&[outside], &[], DepthKind::Metric).is_err());
        let model = tracker.model().expect("four frames");
        (model.motion_blur.known().map(|m| m.exposure.0), model.defocus.known().is_some())
    };
    let (expected, found, wrong) = (tracked(0.5, true), tracked(0.5, false), tracked(0.8, false));
    println!("{expected:?} {found:?} {wrong:?}");
    let apart = |of: (Option<f32>, bool)| (of.0.expect("much moves") - expected.0.expect("much moves")).abs();
    assert!(apart(found) <= TRACKED_EXPOSURE && found.1 == expected.1);
    assert!(apart(wrong) > TRACKED_EXPOSURE);
}

fn fit_evidence(shot: &leaves::Shot) -> Evidence<'_> {
    Evidence {
        flow: Some(&shot.flow),
        inverse_depth: Some((&shot.inverse_depth, DepthKind::Metric)),
        ..Default::default()
    }
}

#[test]
fn tiny_unequal_and_unknown_images_are_an_answer_or_an_error() {
    if no_gpu() {
        return;
    }
    let Gpu { device, queue, .. } = &*GPU;
    let (one, other) = (plane(&Plane::filled(1, 1, f32::NAN)), plane(&Plane::filled(2, 1, 0.0)));
    let mut search = fit::defocus::PooledSearch::new(device, &one, &one, &one).expect("one size");
    assert!(search.submit(device, queue));
    assert!(result(|| search.poll(device)).is_empty());
    assert!(search.poll(device).expect("the device works").is_none());
    let mut search = fit::motion_blur::ExposureSearch::new(device, &one, &one, &one, &one).expect("one size");
    assert!(search.submit(device, queue));
    assert!(result(|| search.poll(device)).is_none());
    assert!(fit::defocus::PooledSearch::new(device, &one, &one, &other).is_err());
    assert!(fit::motion_blur::ExposureSearch::new(device, &one, &one, &other, &one).is_err());
    let evidence = |frame: &Texture, flow| {
        fit::spectral::TileEvidence::new(device, frame, flow, Some(frame), BlurSpace::Linear)
    };
    assert!(evidence(&one, Some(&other)).is_err());
    for (w, h) in [(1, 1), (48, 48), (97, 49)] {
        let unknown = plane(&Plane::filled(w, h, f32::NAN));
        let mut evidence = evidence(&unknown, None).expect("one size");
        assert!(evidence.submit(device, queue, &Default::default(), ExposureFraction(0.5), None));
        let found = result(|| evidence.poll(device));
        assert!(found.exposure.is_empty() && found.lens.is_empty());
    }
}
