//! Tests of the estimators on synthetic frames with known answers.

use blindaug::fit::noise::{LumaNoise, NoiseLine};
use blindaug::fit::track::Tracker;
use blindaug::fit::{Estimation, Estimator, EstimatorOptions, Evidence, Family, FrameObservation, spectral};
use blindaug::model::{
    BlurSpace, DefocusCurve, DepthKind, Estimate, ExposureFraction, NoiseModel, Reason, SharpeningModel,
};
use blindaug::synth::{self, defocus::Bokeh};
use blindaug::{Encoded, Flow, Plane, Raster, filter};

const N: usize = 320;

/// White noise of std 1 that depends on the seed, n x n px.
fn white(n: usize, seed: u64) -> Plane {
    let unit = synth::noise::unit_bands(n, n, seed, 0);
    let std = synth::noise::white_band_std();
    synth::noise::modulated(unit, |l, _, _| [std[l]; 3]).map(|v| v[0])
}

/// A texture whose spectrum falls like a natural image's, stretched along x by the factor `stretch`.
fn texture(seed: u64, stretch: usize) -> Plane {
    texture_of(N, seed, stretch)
}

fn texture_of(n: usize, seed: u64, stretch: usize) -> Plane {
    let mut sum = Plane::filled(n, n, 0.5);
    for octave in 0..n.ilog2() - 2 {
        let smooth =
            filter::gaussian_blur(&white(n, seed + u64::from(octave)), 0.6 * 2f32.powi(octave as i32));
        let gain = 0.12 * 2f32.powi(octave as i32);
        sum = Plane::from_fn(n, n, |x, y| sum.at(x, y) + gain * smooth.at(x / stretch, y));
    }
    sum.map(|v| v.clamp(0.05, 0.95))
}

fn noisy(image: &Plane, std: f32, seed: u64) -> Encoded {
    let n = image.width();
    let noise = white(n, seed);
    Encoded(Raster::from_fn(n, n, |x, y| [image.at(x, y) + std * noise.at(x, y); 3]))
}

fn estimator(family: Family) -> Estimator {
    Estimator::new(EstimatorOptions {
        family,
        space: BlurSpace::Encoded.into(),
        ..EstimatorOptions::default()
    })
}

/// The estimate from a single frame that is blurred along `moved` and whose given flow is `told`.
fn blind(sharp: &Plane, moved: [f32; 2], told: [f32; 2], lambda: f32) -> Estimation {
    let blurred =
        synth::motion_blur::motion_blur(sharp, &Flow::filled(N, N, moved), ExposureFraction(lambda)).unwrap();
    let mut e = estimator(Family::Spectral);
    let flow = Flow::filled(N, N, told);
    let evidence = Evidence { flow: Some(&flow), ..Evidence::default() };
    e.add(&FrameObservation { frame: &noisy(&blurred, 0.004, 99), next: None, previous: None, evidence })
        .unwrap();
    e.estimate().unwrap()
}

fn exposure(e: &Estimation) -> (f32, [f32; 2]) {
    let m = e.model.motion_blur.known().expect("there is motion and texture");
    (m.exposure.0, m.interval)
}

#[test]
fn a_blurred_frame_tells_its_exposure() {
    for (seed, flow, lambda) in [(1, [16.0, 0.0], 0.3), (2, [0.0, 14.0], 0.7), (3, [9.0, -12.0], 0.5)] {
        let (estimate, [low, high]) = exposure(&blind(&texture(seed, 1), flow, flow, lambda));
        println!("{lambda}: {estimate} [{low}, {high}]");
        assert!((estimate - lambda).abs() < 0.05, "{estimate} for {lambda}");
        assert!((low..=high).contains(&lambda), "[{low}, {high}] for {lambda}");
    }
}

#[test]
fn a_sharp_frame_has_no_exposure_even_if_told_to_move_and_nor_has_one_blurred_across() {
    let (sharp, _) = exposure(&blind(&texture(4, 1), [16.0, 0.0], [16.0, 0.0], 0.0));
    let (across, _) = exposure(&blind(&texture(4, 1), [0.0, 16.0], [16.0, 0.0], 0.5));
    println!("{sharp} {across}");
    assert!(sharp < 0.15 && across < 0.15, "{sharp} {across}");
}

#[test]
fn a_picture_that_is_softer_along_the_motion_leaves_short_streaks_unsure_but_not_long_ones() {
    let sharp = texture(6, 1);
    // The filters of cameras and scalers differ by as much: by a variance of 0.24 square px, as a streak of 1.7 px has it.
    let at = |x: usize, y: usize| sharp.at(x.min(N - 1), y);
    let soft =
        Plane::from_fn(N, N, |x, y| 0.12 * (at(x.saturating_sub(1), y) + at(x + 1, y)) + 0.76 * at(x, y));
    // A third of the motion is seen, as the mean over whole px.
    let of = |image: &Plane, streak: usize| {
        let at = |x: usize, y: usize| image.at(x.min(N - 1), y);
        let seen =
            Plane::from_fn(N, N, |x, y| (0..streak).map(|i| at(x + i, y)).sum::<f32>() / streak as f32);
        let told = [3.0 * streak as f32, 0.0];
        exposure(&blind(&seen, [0.0; 2], told, 0.0))
    };
    let (short, [low, high]) = of(&soft, 2);
    println!("2 px: {short} [{low}, {high}]");
    assert!(short > 0.45 && low < 0.33 && high < 0.7, "{short} [{low}, {high}]");
    let (long, [low, high]) = of(&soft, 6);
    println!("6 px: {long} [{low}, {high}]");
    assert!((long - 0.333).abs() < 0.02 && high - low < 0.15, "{long} [{low}, {high}]");
}

#[test]
fn what_lens_and_noise_leave_of_a_texture_tells_its_exposure_without_bias() {
    const STD: f32 = 0.015;
    let flow = Flow::filled(N, N, [11.0, 4.0]);
    let levels = synth::noise::white_band_std().map(|white| NoiseLine { slope: 0.0, intercept: STD * white });
    let noise = LumaNoise { levels, coding_error: 0.0 };
    for lambda in [0.0, 0.5, 0.8] {
        let tiles: Vec<Vec<spectral::Tile>> = (0..4)
            .map(|seed| {
                let sharp = texture(10 * seed, 1);
                let soft = synth::defocus::defocus(&sharp, &Plane::filled(N, N, 2.5), Bokeh::Disk).unwrap();
                let blurred =
                    synth::motion_blur::motion_blur(&soft, &flow, ExposureFraction(lambda)).unwrap();
                let frame = noisy(&blurred, STD, 50 + seed);
                spectral::tiles(&frame, Some(&flow), None, BlurSpace::Encoded.into()).unwrap()
            })
            .collect();
        let tiles: Vec<&[spectral::Tile]> = tiles.iter().map(Vec::as_slice).collect();
        let fit = spectral::fit_exposure(&tiles, &[], &noise).unwrap().into_known().unwrap();
        println!("{lambda}: {:?} {:?}", fit.exposure, fit.interval);
        assert!((fit.exposure.0 - lambda).abs() < 0.06, "{:?} for {lambda}", fit.exposure);
        assert!((fit.interval[0]..=fit.interval[1]).contains(&lambda), "{:?} for {lambda}", fit.interval);
    }
}

#[test]
fn boards_along_the_motion_do_not_look_blurred() {
    let flow = [16.0, 0.0];
    let (estimate, _) = exposure(&blind(&texture(5, 4), flow, flow, 0.45));
    println!("{estimate}");
    assert!((estimate - 0.45).abs() < 0.1, "{estimate}");
    // Rails, which look the same all along their motion, must not look like a long exposure: it is unknown, or may be near 0.
    for stretch in [16, 64] {
        let rails = blind(&texture(5, stretch), flow, flow, 0.0);
        println!("{:?}", rails.model.motion_blur);
        assert!(rails.model.motion_blur.known().is_none_or(|m| m.interval[0] < 0.1), "{stretch}");
    }
}

/// The camera shakes: the motion turns from one frame to the next.
#[test]
fn frames_that_move_differently_tell_the_exposure_of_a_texture_that_looks_blurred_itself() {
    let motions = [[14.0, 3.0], [13.0, -7.0]];
    let flows = motions.map(|m| Flow::filled(N, N, m));
    let blurred = |image: &Plane, flow, lambda| {
        synth::motion_blur::motion_blur(image, flow, ExposureFraction(lambda)).unwrap()
    };
    // The texture itself looks as if blurred along half the first frame's motion.
    let texture = blurred(&texture(6, 1), &flows[0], 0.5);
    // The motion of the second frame at its own time is the mean of the flows to this frame and from it.
    let own = Flow::filled(N, N, [0, 1].map(|c| 0.5 * (motions[0][c] + motions[1][c])));
    // The second frame shows the texture displaced by the first frame's motion.
    let moved = Plane::from_fn(N, N, |x, y| texture.at((x + N - 14) % N, (y + N - 3) % N));
    for lambda in [0.15, 0.3] {
        let frames = [
            noisy(&blurred(&texture, &flows[0], lambda), 0.004, 98),
            noisy(&blurred(&moved, &own, lambda), 0.004, 99),
        ];
        let found = |pairs: bool| {
            let mut e = estimator(Family::Spectral);
            for i in 0..2 {
                let evidence = Evidence { flow: Some(&flows[i]), ..Evidence::default() };
                let previous = (pairs && i == 1).then(|| &frames[0]);
                e.add(&FrameObservation { frame: &frames[i], next: frames.get(i + 1), previous, evidence })
                    .unwrap();
            }
            exposure(&e.estimate().unwrap())
        };
        let ((alone, _), (both, [low, high])) = (found(false), found(true));
        println!("{lambda}: {alone}; {both} [{low}, {high}]");
        assert!(
            (both - lambda).abs() < 0.04 && (low..=high).contains(&lambda),
            "{both} [{low}, {high}] for {lambda}"
        );
        assert!((alone - lambda).abs() > 0.05, "{alone} for {lambda}");
    }
}

/// The pan speeds up by a third in each frame. The flow to the next frame is half a frame late.
#[test]
fn a_camera_that_speeds_up_is_measured_by_its_motion_while_the_shutter_is_open() {
    const LAMBDA: f32 = 0.6;
    let steps = [12.0, 16.0, 21.0, 28.0];
    let flows = steps.map(|s| Flow::filled(N, N, [s, 0.0]));
    let texture = texture(8, 1);
    let at = |frame: usize| {
        let way = steps[..frame].iter().sum::<f32>() as usize;
        let moved = Plane::from_fn(N, N, |x, y| texture.at((x + N - way) % N, y));
        let own = 0.5 * (steps[frame - 1] + steps[frame]);
        let own = Flow::filled(N, N, [own, 0.0]);
        let filmed = synth::motion_blur::motion_blur(&moved, &own, ExposureFraction(LAMBDA)).unwrap();
        noisy(&filmed, 0.004, 200 + frame as u64)
    };
    let frames = [1, 2, 3].map(at);
    // The motion at the time of the first frame is not known, since no frame precedes it.
    let found = |first: usize, given: &dyn Fn(usize) -> Option<Flow>| {
        let mut e = estimator(Family::Spectral);
        for i in first..3 {
            let flow = given(i);
            let evidence = Evidence { flow: flow.as_ref(), ..Evidence::default() };
            let previous = (i > first).then(|| &frames[i - 1]);
            e.add(&FrameObservation { frame: &frames[i], next: frames.get(i + 1), previous, evidence })
                .unwrap();
        }
        e.estimate().unwrap().diagnostics.exposure_per_frame
    };
    let given = found(0, &|i| Some(flows[i + 1].clone()));
    println!("{given:?}; {:?}", found(0, &|_| None));
    for (frame, lambda) in &given[1..] {
        assert!((lambda - LAMBDA).abs() < 0.03, "{lambda} of frame {frame}");
    }
    // By the flow to the next frame alone, the exposure looks too short, like that of the first frame.
    assert!(given[0].1 < LAMBDA - 0.05, "{}", given[0].1);
    let late = found(1, &|i| Some(flows[i + 1].clone()))[0];
    assert!(late.1 < LAMBDA - 0.05, "{}", late.1);
    // The tracker looks at the last frame, either as its first frame or after the two frames before.
    let tracked = |frames_before: usize| {
        let mut tracker = Tracker::new(Default::default(), None);
        for i in 2 - frames_before..3 {
            let evidence = Evidence { flow: Some(&flows[i + 1]), ..Evidence::default() };
            let next = frames.get(i + 1);
            tracker.push(&FrameObservation { frame: &frames[i], next, previous: None, evidence }).unwrap();
        }
        let model = tracker.model().unwrap();
        model.motion_blur.known().map_or(f32::NAN, |m| m.exposure.0)
    };
    let (alone, after) = (tracked(0), tracked(2));
    println!("tracker: {alone}, {after}");
    assert!(alone < LAMBDA - 0.05 && after > alone + 0.02, "{alone} {after}");
}

#[test]
fn without_motion_nothing_is_said_of_the_shutter_and_without_texture_nothing_of_anything() {
    let still = blind(&texture(6, 1), [0.0; 2], [0.2, 0.1], 0.5);
    assert!(still.model.motion_blur.known().is_none());
    let flat = blind(&Plane::filled(N, N, 0.5), [16.0, 0.0], [16.0, 0.0], 0.5);
    assert!(flat.model.motion_blur.known().is_none());
}

/// The std of the blur at infinity, px, and the inverse depth in focus.
const LENS: (f32, f32) = (3.0, 0.8);

/// Inverse depth in columns of 64 px, from 0.15 to 1.2.
fn columns() -> Plane {
    Plane::from_fn(N, N, |x, _| 0.15 + 1.05 * (x / 64) as f32 / (N / 64 - 1) as f32)
}

/// A texture, sharp and blurred by a lens.
fn through_a_lens(seed: u64, depth: &Plane, (at_infinity, focus): (f32, f32)) -> (Plane, Plane) {
    let sharp = texture_of(depth.width(), seed, 1);
    let sigma = depth.map(|d| at_infinity * (1.0 - d / focus).abs());
    let blurred = synth::defocus::defocus(&sharp, &sigma, Bokeh::Disk).unwrap();
    (sharp, blurred)
}

/// The mean absolute error of the std of the blur over the pixels, px.
fn lens_error(e: &Estimation, depth: &Plane, (at_infinity, focus): (f32, f32)) -> f32 {
    let model = e.model.defocus.known().expect("there are depth and texture");
    let DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, .. } = model.curve else {
        panic!("a thin lens was asked for")
    };
    let error = |d: f32| {
        let (found, true_blur) =
            (sigma_px_at_infinity * (1.0 - d / focus_inverse_depth), at_infinity * (1.0 - d / focus));
        (found.abs() - true_blur.abs()).abs()
    };
    depth.data().iter().map(|&d| error(d)).sum::<f32>() / depth.data().len() as f32
}

#[test]
fn a_frame_with_depth_tells_its_lens() {
    let depth = columns();
    let (_, blurred) = through_a_lens(7, &depth, LENS);
    let mut e = estimator(Family::Spectral);
    let evidence = Evidence { inverse_depth: Some((&depth, DepthKind::Metric)), ..Evidence::default() };
    e.add(&FrameObservation { frame: &noisy(&blurred, 0.004, 98), next: None, previous: None, evidence })
        .unwrap();
    let error = lens_error(&e.estimate().unwrap(), &depth, LENS);
    println!("{error}");
    assert!(error < 0.3, "{error}");

    // A wall has one depth, through which many lenses fit.
    let wall = Plane::filled(N, N, 0.3);
    let mut e = estimator(Family::Spectral);
    let evidence = Evidence { inverse_depth: Some((&wall, DepthKind::Metric)), ..Evidence::default() };
    e.add(&FrameObservation { frame: &noisy(&blurred, 0.004, 98), next: None, previous: None, evidence })
        .unwrap();
    assert!(e.estimate().unwrap().model.defocus.known().is_none());
}

/// The mean error, px, of the blur estimated from a frame that a lens blurs everywhere; inverse depth doubles from left to right.
fn error_of_strong_lens(n: usize, seed: u64, lens: (f32, f32)) -> f32 {
    let depth = Plane::from_fn(n, n, |x, _| 0.5 * 2f32.powf(x as f32 / (n - 1) as f32));
    let (_, blurred) = through_a_lens(seed, &depth, lens);
    let mut e = estimator(Family::Spectral);
    let evidence = Evidence { inverse_depth: Some((&depth, DepthKind::Metric)), ..Evidence::default() };
    e.add(&FrameObservation {
        frame: &noisy(&blurred, 0.004, 98 + seed),
        next: None,
        previous: None,
        evidence,
    })
    .unwrap();
    let error = lens_error(&e.estimate().unwrap(), &depth, lens);
    println!("{lens:?}: {error}");
    error
}

/// A tile that is blurred by 5 px shows little but the window's leakage, and would look like one blurred by 4 px.
#[test]
fn a_lens_that_blurs_most_of_the_frame_by_more_than_a_tile_tells_is_not_taken_for_a_weaker_one() {
    for seed in [7, 20, 33] {
        assert!(error_of_strong_lens(N, seed, (13.0, 1.2)) < 0.5);
    }
}

/// The blur in the frame is 4 to 14 px.
#[test]
fn large_frames_tell_lenses_as_strong_as_they_need_for_the_same_look() {
    assert!(error_of_strong_lens(800, 7, (24.0, 1.2)) < 1.2);
}

#[test]
fn a_clean_frame_tells_both_at_once() {
    let depth = columns();
    let (sharp, blurred) = through_a_lens(8, &depth, LENS);
    let flow = Flow::filled(N, N, [10.0, 4.0]);
    let blurred = synth::motion_blur::motion_blur(&blurred, &flow, ExposureFraction(0.6)).unwrap();
    let clean = Encoded(sharp.map(|v| [v; 3]));
    let mut e = estimator(Family::Removal);
    let evidence = Evidence {
        flow: Some(&flow),
        inverse_depth: Some((&depth, DepthKind::Metric)),
        clean: Some(&clean),
        ..Evidence::default()
    };
    e.add(&FrameObservation { frame: &noisy(&blurred, 0.01, 97), next: None, previous: None, evidence })
        .unwrap();
    let e = e.estimate().unwrap();
    let (error, (lambda, _)) = (lens_error(&e, &depth, LENS), exposure(&e));
    println!("{error} {lambda}");
    assert!(error < 0.1 && (lambda - 0.6).abs() < 0.04, "{error} {lambda}");
}

#[test]
fn of_a_long_clip_evenly_spaced_frames_are_used() {
    let frame = Encoded(Raster::filled(64, 64, [0.5; 3]));
    let used = |mut e: Estimator, n: usize| -> Vec<usize> {
        let add = |e: &mut Estimator| {
            let evidence = Evidence::default();
            e.add(&FrameObservation { frame: &frame, next: None, previous: None, evidence }).unwrap()
        };
        (0..n).filter(|_| add(&mut e)).collect()
    };
    let spaced = used(Estimator::new(EstimatorOptions::default()).expecting(200), 200);
    assert_eq!(spaced, (0..200).step_by(5).collect::<Vec<_>>());
    let thinned = used(Estimator::new(EstimatorOptions::default()), 200);
    assert!(thinned.len() > spaced.len() && thinned.windows(2).all(|w| w[1] - w[0] <= 4), "{thinned:?}");
}

#[test]
fn a_camera_that_sharpens_is_told_by_its_noise_and_one_that_does_not_is_not() {
    let sharp = texture(7, 1);
    let flow = Flow::filled(N, N, [0.0; 2]);
    let filmed = |amount: f32| {
        let [frame, next] = [1, 2].map(|seed| {
            let frame = noisy(&sharp, 0.015, seed);
            Encoded(synth::sharpening::sharpen(&frame.0, &SharpeningModel::given(amount, 1.0)))
        });
        let mut e = estimator(Family::Spectral);
        let evidence = Evidence { flow: Some(&flow), ..Evidence::default() };
        e.add(&FrameObservation { frame: &frame, next: Some(&next), previous: None, evidence }).unwrap();
        e.estimate().unwrap().model.sharpening
    };
    let found = *filmed(1.2).known().expect("its noise is sharpened");
    println!("{found:?}");
    assert!((found.amount - 1.2).abs() < 0.4, "{found:?}");
    assert!((found.interval[0]..found.interval[1]).contains(&1.2), "{found:?}");
    assert_eq!(filmed(0.0).why_unknown().map(|why| why.reason), Some(Reason::NotSeen));
}

#[test]
fn the_noise_of_one_frame_is_told_in_a_wide_interval_and_that_between_frames_in_a_narrow_one() {
    let still = Flow::filled(N, N, [0.0; 2]);
    let frames = [1, 2].map(|seed| noisy(&texture(1, 1), 0.02, seed));
    let observation = |next| FrameObservation {
        frame: &frames[0],
        next,
        previous: None,
        evidence: Evidence { flow: next.map(|_: &Encoded| &still), ..Evidence::default() },
    };
    let ends = |noise: &Estimate<NoiseModel>| {
        let noise = noise.known().expect("there is noise");
        noise.interval_of_total_std(0.5).map(|end| (end[1] / noise.total_std(0.5)[1]).ln().abs())
    };
    let estimated = |next| {
        let mut e = Estimator::new(EstimatorOptions::default());
        e.add(&observation(next)).unwrap();
        ends(&e.estimate().unwrap().model.noise)
    };
    let mut tracker = Tracker::new(Default::default(), None);
    let tracked = ends(&tracker.push(&observation(None)).unwrap().noise);
    let (of_frames, spread) = tracker.noise_of_frames().unwrap();
    let (is_wide, is_narrow) = (|end: &f32| (0.35..1.2).contains(end), |end: &f32| *end < 0.25);
    let [single, pair] = [estimated(None), estimated(Some(&frames[1]))];
    assert!(single.iter().chain(&tracked).all(is_wide), "{single:?} {tracked:?}");
    assert!(pair.iter().chain(&ends(of_frames)).all(is_narrow), "{pair:?} {:?}", ends(of_frames));
    assert!((0.15..0.45).contains(&spread), "{spread}");
}

/// Observations in all blocks of the image that agree on an exposure and prefer it by at most `nats` each.
fn agreeing_tiles(tiles: u32, exposure: f32, nats: f32) -> Vec<spectral::ExposureObservation> {
    let of_exposure = |i: usize| -nats * (0.005 * i as f32 - exposure).abs().min(1.0);
    let log_likelihood: Vec<f32> = (0..spectral::EXPOSURES).map(of_exposure).collect();
    let observation = |i: u32| spectral::ExposureObservation {
        block: i % 25,
        frame: 0,
        speed: 20.0,
        speed_error: 0.0,
        log_likelihood: log_likelihood.clone(),
    };
    (0..tiles).map(observation).collect()
}

#[test]
fn an_exposure_that_looks_longer_than_a_frame_lasts_is_a_whole_frame() {
    // The tiles are as sure as they can be, of 1.1 or of 0.4.
    let of = |exposure: f32| {
        spectral::exposure_of(&agreeing_tiles(400, exposure, 8.0), 1, 0.0).unwrap().into_known().unwrap()
    };
    let fit = of(1.1);
    let [low, high] = fit.interval;
    assert!(fit.exposure.0 == 1.0 && (0.9..0.96).contains(&low) && high == 1.0, "{low} {high}");
    let fit = of(0.4);
    assert!((fit.exposure.0 - 0.4).abs() < 0.01 && fit.interval[0] < 0.4 && fit.interval[1] > 0.4);
}

#[test]
fn tiles_that_agree_but_hardly_object_to_anything_else_tell_no_exposure() {
    // The bootstrap alone would give a narrow interval, since all its replicas are alike.
    let why = spectral::exposure_of(&agreeing_tiles(50, 1.0, 0.05), 1, 0.0).unwrap();
    let why = why.why_unknown().unwrap();
    assert_eq!(why.reason, Reason::Uncertain);
    assert!(
        why.sentence.starts_with("too little in the frames moves, or what moves has too little texture"),
        "{why}"
    );
    let why = spectral::exposure_of(&agreeing_tiles(50, 1.0, 0.05), 1, 0.03).unwrap();
    let why = why.why_unknown().unwrap();
    assert!(why.sentence.contains("compression"), "{why}");
    // However sure slow tiles are, softness may be what they show.
    let mut slow = agreeing_tiles(400, 0.5, 8.0);
    slow.iter_mut().for_each(|w| w.speed = 2.0);
    let why = spectral::exposure_of(&slow, 1, 0.0).unwrap();
    assert!(why.why_unknown().unwrap().sentence.contains("about 2.0 px a frame, too slowly"), "{why:?}");
    let width = |tiles: u32| {
        let [low, high] = spectral::exposure_of(&agreeing_tiles(tiles, 0.5, 8.0), 1, 0.0)
            .unwrap()
            .into_known()
            .unwrap()
            .interval;
        high - low
    };
    let (few, many) = (width(7), width(700));
    assert!(few > 0.25 && many < 0.12, "{few} {many}");
}

#[test]
fn what_texture_hides_of_slow_streaks_is_allowed_for_once_in_clips_of_any_length() {
    let of = |frames: usize| {
        let slow = agreeing_tiles(400, 0.5, 8.0).into_iter().enumerate();
        let slow: Vec<_> =
            slow.map(|(i, w)| spectral::ExposureObservation { frame: i % frames, speed: 6.0, ..w }).collect();
        spectral::exposure_of(&slow, frames, 0.0).unwrap().into_known().unwrap().interval
    };
    // The interval is from about 0.45 less a streak of 2.1 px to about 0.55 plus one of 1.9 px.
    let [low, high] = of(1);
    assert!((low - 0.284).abs() < 0.02 && (high - 0.639).abs() < 0.02, "{low} {high}");
    let [low_of_many, high_of_many] = of(20);
    assert!((low_of_many - low).abs() < 0.02 && (high_of_many - high).abs() < 0.02, "{:?}", of(20));
}

#[test]
fn frames_whose_speed_may_be_off_are_as_sure_as_their_mean() {
    // Six frames, each sure of its own streaks, which are longer or shorter than the mean motion makes them.
    let seen = |swing: f32, speed_error: f32| {
        let frames = [-1.0, 0.6, 0.2, -0.5, 1.0, -0.3].map(|v: f32| 0.6 * (1.0 + swing * v));
        let observations = (0..).zip(frames).flat_map(|(frame, exposure)| {
            let of_frame = agreeing_tiles(50, exposure, 8.0).into_iter();
            of_frame.map(move |w| spectral::ExposureObservation { frame, speed_error, ..w })
        });
        let observations: Vec<_> = observations.collect();
        spectral::exposure_of(&observations, 6, 0.0).unwrap().into_known().unwrap()
    };
    let width = |[low, high]: [f32; 2]| high - low;
    let covers = |[low, high]: [f32; 2]| low < 0.6 && 0.6 < high;
    let (even, uneven) = (seen(0.0, 0.0), seen(0.3, 0.25));
    assert!(covers(even.interval) && width(even.interval) < 0.16, "{:?}", even.interval);
    assert!(covers(uneven.interval) && width(uneven.interval) > 0.2, "{:?}", uneven.interval);
    // Frames that agree are less sure too if their speed may be off, and frames that contradict each other if nothing else tells it.
    assert!(width(seen(0.0, 0.25).interval) > 1.5 * width(even.interval));
    assert!(width(seen(0.5, 0.0).interval) > 1.5 * width(even.interval), "{:?}", seen(0.5, 0.0).interval);
}
