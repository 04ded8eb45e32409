//! Frames that were doubled, dropped and interpolated are found at their places, and nothing else is; estimates do without them.

use blindaug::CameraModel;
use blindaug::fit::timing::{Event, Kind, Timing, TimingAnalyser, WhyUntold};
use blindaug::fit::track::Tracker;
use blindaug::fit::{Estimation, Estimator, EstimatorOptions, FrameObservation};
use blindaug::{Encoded, Raster, Transfer};

const W: usize = 224;
const H: usize = 176;

fn hash(a: i64, b: i64, seed: i64) -> f32 {
    let mut h = (a as u32).wrapping_mul(0x9e37_79b1)
        ^ (b as u32).wrapping_mul(0x85eb_ca6b)
        ^ (seed as u32).wrapping_mul(0xc2b2_ae35);
    (0..2).for_each(|_| h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d));
    (h >> 8) as f32 / 16_777_216.0
}

/// A texture of three octaves at a place, px.
fn texture(x: f32, y: f32) -> f32 {
    let octave = |size: f32, seed: i64| {
        let (x, y) = (x / size, y / size);
        let (i, j) = (x.floor(), y.floor());
        let (u, v) = (x - i, y - j);
        let at = |di: i64, dj: i64| hash(i as i64 + di, j as i64 + dj, seed);
        let row = |dj: i64| at(0, dj) + u * (at(1, dj) - at(0, dj));
        row(0) + v * (row(1) - row(0))
    };
    0.15 + 0.3 * octave(23.0, 1) + 0.25 * octave(7.0, 2) + 0.15 * octave(2.5, 3)
}

fn noise(x: usize, y: usize, seed: i64) -> f32 {
    0.01 * (0..4).map(|k| hash(x as i64, y as i64, 1000 * seed + k) - 0.5).sum::<f32>()
}

/// The frame at a time: the texture moves by `place`, the shutter is open for `exposure` of the frame interval, and there is noise.
fn frame(time: f32, place: impl Fn(f32) -> f32 + Sync, exposure: f32, seed: i64) -> Encoded {
    const TAPS: usize = 8;
    Encoded(Raster::from_fn(W, H, |x, y| {
        let taps = (0..TAPS).map(|i| {
            let p = place(time + exposure * ((i as f32 + 0.5) / TAPS as f32 - 0.5));
            texture(x as f32 - p, y as f32 - 0.4 * p)
        });
        [taps.sum::<f32>() / TAPS as f32 + noise(x, y, seed); 3]
    }))
}

const FRAMES: usize = 26;

fn steady(t: usize) -> Encoded {
    frame(t as f32, |t| 6.0 * t, 0.5, t as i64)
}

fn timing(frames: impl IntoIterator<Item = Encoded>) -> Timing {
    let mut analyser = TimingAnalyser::new(Transfer::Srgb);
    for (number, frame) in (1..).zip(frames) {
        analyser.push(number, frame).unwrap();
    }
    analyser.finish().unwrap()
}

fn found(timing: &Timing) -> Vec<(Kind, u64)> {
    timing.findings.iter().map(|f| (f.event.kind(), f.frame)).collect()
}

#[test]
fn damaged_frames_are_found_where_they_are() {
    let frames: Vec<Encoded> = (0..FRAMES).map(steady).collect();
    let mixed = |i: usize| {
        let (a, b) = (&frames[i - 1].0, &frames[i + 1].0);
        Encoded(Raster::from_fn(W, H, |x, y| [0.5 * (a.at(x, y)[0] + b.at(x, y)[0]); 3]))
    };
    let copies = |at: usize| frames[..at].iter().chain(&frames[at - 1..]).cloned().collect::<Vec<_>>();
    let without =
        |at: usize, n: usize| frames[..at].iter().chain(&frames[at + n..]).cloned().collect::<Vec<_>>();
    let blended = |at: usize| {
        let mut all = frames.clone();
        all[at] = mixed(at);
        all
    };
    // Negative control: of what is as it should be, nothing is found.
    let as_it_is = timing(frames.clone());
    assert_eq!((found(&as_it_is), as_it_is.shots), (vec![], 1));
    let exposure = as_it_is.exposure.expect("it moves");
    assert!((exposure - 0.5).abs() < 0.15, "{exposure}");
    assert_eq!(found(&timing(copies(9))), [(Kind::Doubled, 10)]);
    let dropped = timing(without(12, 1));
    assert_eq!(found(&dropped), [(Kind::Dropped, 12)]);
    let dropped_two = timing(without(12, 2));
    for (timing, n) in [(dropped, 1), (dropped_two, 2)] {
        let [finding] = timing.findings[..] else { panic!("{timing:?}") };
        let Event::Dropped { missing, motion_ratio, .. } = finding.event else { panic!("{finding:?}") };
        assert!(missing == n && (motion_ratio - 1.0 - n as f32).abs() < 0.2, "{finding:?}");
    }
    assert_eq!(found(&timing(blended(14))), [(Kind::Interpolated, 15)]);
}

#[test]
fn a_camera_that_really_moves_faster_for_a_moment_drops_no_frame() {
    // Within one interval it moves on as far as else in nearly two.
    let surge = |t: f32| 4.0 * (t + 0.5 + 0.5 * ((t - 12.5) / 0.5).tanh());
    let timing = timing((0..FRAMES).map(|t| frame(t as f32, surge, 0.5, t as i64)));
    assert_eq!(found(&timing), []);
}

#[test]
fn a_thing_that_crosses_the_frame_misses_no_frame_beside_copies() {
    // Its front and its rear are in other cells of the frame before a copy than after it.
    let crossing = |t: usize| {
        let left = 9.0 * t as f32 - 60.0;
        Encoded(Raster::from_fn(W, H, |x, y| {
            let on = (0.0..60.0).contains(&(x as f32 - left)) && (40..130).contains(&y);
            let value =
                if on { texture(x as f32 - left + 700.0, y as f32) } else { texture(x as f32, y as f32) };
            [value + noise(x, y, t as i64); 3]
        }))
    };
    let frames: Vec<Encoded> =
        (0..30).flat_map(|t| vec![crossing(t); if t % 5 == 3 { 2 } else { 1 }]).collect();
    let timing = timing(frames);
    let of = |kind: Kind| timing.findings.iter().filter(|f| f.event.kind() == kind).count();
    assert!(of(Kind::Doubled) >= 4 && of(Kind::Dropped) == 0, "{:?}", timing.findings);
}

#[test]
fn where_nothing_moves_nothing_is_told() {
    let still = timing((0..12).map(|t| frame(0.0, |_| 0.0, 0.5, t)));
    assert_eq!(found(&still), []);
    let untold = |kind: Kind| still.unknown.iter().any(|u| u.kind == kind && u.reason == WhyUntold::Still);
    assert!(untold(Kind::Dropped), "{still:?}");
}

#[test]
fn a_regular_cadence_is_told_as_such() {
    // As from 24 to 30 frames a second: every fourth frame twice.
    let frames = (0..24).flat_map(|t| std::iter::repeat_n(t, if t % 4 == 3 { 2 } else { 1 })).map(steady);
    let timing = timing(frames);
    let doubled = found(&timing);
    assert!(
        doubled.len() >= 5 && doubled.iter().all(|&(kind, frame)| kind == Kind::Doubled && frame % 5 == 0),
        "{doubled:?}"
    );
    let [cadence] = timing.cadences[..] else { panic!("{:?}", timing.cadences) };
    assert_eq!((cadence.kind, cadence.period, cadence.of_period), (Kind::Doubled, 5, 1));
}

#[test]
fn a_cut_drops_no_frame_and_one_frame_tells_nothing() {
    let other = |t: usize| {
        let Encoded(f) = steady(t);
        Encoded(Raster::from_fn(W, H, |x, y| f.at(W - 1 - x, H - 1 - y).map(|v| 0.9 - v)))
    };
    let cut = timing((0..14).map(steady).chain((40..54).map(other)));
    assert_eq!((found(&cut), cut.shots), (vec![], 2));
    let mut one = TimingAnalyser::new(Transfer::Srgb);
    one.push(1, steady(0)).unwrap();
    assert!(one.push(2, Encoded(Raster::filled(9, 9, [0.0; 3]))).unwrap_err().to_string().contains("size"));
    assert!(one.finish().unwrap_err().to_string().contains("only one frame"));
}

#[test]
fn of_three_equal_frames_two_are_doubled() {
    // As from 10 to 30 frames a second.
    let frames: Vec<usize> = (0..12).flat_map(|t| [t; 3]).collect();
    let doubled = found(&timing(frames.iter().map(|&t| steady(t))));
    let wanted: Vec<(Kind, u64)> = (4..=33).filter(|n| n % 3 != 1).map(|n| (Kind::Doubled, n)).collect();
    assert!(wanted.iter().all(|w| doubled.contains(w)), "{doubled:?}");
    assert!(doubled.iter().all(|&(kind, n)| kind == Kind::Doubled && n % 3 != 1), "{doubled:?}");
}

fn estimation(times: impl IntoIterator<Item = usize>) -> Estimation {
    let frames: Vec<Encoded> = times.into_iter().map(steady).collect();
    let mut estimator = Estimator::new(EstimatorOptions { fps: Some(30.0), ..Default::default() });
    for observation in FrameObservation::of_frames(&frames) {
        estimator.add(&observation).unwrap();
    }
    estimator.estimate().unwrap()
}

fn tracked(times: impl IntoIterator<Item = usize>) -> Vec<CameraModel> {
    let frames: Vec<Encoded> = times.into_iter().map(steady).collect();
    let mut tracker = Tracker::new(Default::default(), Some(30.0));
    FrameObservation::of_frames(&frames).map(|o| tracker.push(&o).unwrap().clone()).collect()
}

/// As from 24 to 30 frames a second.
fn doubled() -> impl Iterator<Item = usize> {
    (0..20).flat_map(|t| std::iter::repeat_n(t, if t % 4 == 3 { 2 } else { 1 }))
}

#[test]
fn estimates_of_a_clip_with_copies_are_those_of_its_pictures() {
    let wanted = estimation(0..20);
    let Estimation { mut model, diagnostics } = estimation(doubled());
    let fps = model.capture.fps.unwrap();
    assert!((fps - 24.0).abs() < 1e-9, "{fps}");
    assert!(
        diagnostics.notes.iter().any(|n| n.starts_with("5 of 25 frames repeat")),
        "{:?}",
        diagnostics.notes
    );
    model.capture.fps = wanted.model.capture.fps;
    assert_eq!(model, wanted.model);
    assert!(wanted.model.motion_blur.known().is_some_and(|m| (m.exposure.0 - 0.5).abs() < 0.1));
}

#[test]
fn a_picture_that_freezes_for_some_frames_leaves_the_frame_rate() {
    let frozen = || (0..12).chain([11; 5]);
    let Estimation { model, diagnostics } = estimation(frozen());
    assert_eq!(model.capture.fps, Some(30.0));
    assert!(diagnostics.notes.iter().any(|n| n.starts_with("5 of 17 frames repeat")), "{diagnostics:?}");
    assert!(tracked(frozen().chain(12..16)).iter().all(|m| m.capture.fps == Some(30.0)));
}

#[test]
fn a_frame_that_is_repeated_has_the_model_before_and_its_copy_its_own() {
    let (wanted, found) = (tracked(0..20), tracked(doubled()));
    for (frame, time) in doubled().enumerate() {
        let is_repeated = doubled().nth(frame + 1) == Some(time);
        let own = &wanted[if is_repeated { time - 1 } else { time }];
        let mut model = found[frame].clone();
        model.capture.fps = own.capture.fps;
        assert_eq!(&model, own, "{frame}");
    }
}

#[test]
fn exposures_do_not_suffer_from_missing_frames() {
    let whole = estimation(0..24).model;
    // The picture of a missing frame is not there, or the one before is there in its place.
    let missing = |t: &usize| [7, 14, 15, 19].contains(t);
    let left_out = estimation((0..24).filter(|t| !missing(t)));
    let replaced = estimation((0..24).map(|t| (0..=t).rev().find(|t| !missing(t)).unwrap()));
    assert_eq!(replaced.model.capture.fps, Some(30.0));
    for Estimation { model, .. } in [left_out, replaced] {
        let exposure = model.motion_blur.known().unwrap();
        let wanted = whole.motion_blur.known().unwrap();
        assert!((exposure.exposure.0 - wanted.exposure.0).abs() < 0.03, "{exposure:?} {wanted:?}");
    }
}

#[test]
fn a_still_picture_that_repeats_itself_is_not_left_out() {
    let clip = |pictures: &dyn Fn(usize) -> usize| {
        let frames: Vec<Encoded> = (0..12).map(|t| frame(0.0, |_| 0.0, 0.5, pictures(t) as i64)).collect();
        let mut estimator = Estimator::new(EstimatorOptions::default());
        FrameObservation::of_frames(&frames).map(|o| usize::from(estimator.add(&o).unwrap())).sum::<usize>()
    };
    assert_eq!(clip(&|_| 0), 12);
}

#[test]
fn a_tracker_that_sees_one_of_four_frames_takes_the_motion_from_their_neighbours() {
    const TRUTH: f32 = 0.8;
    // The camera turns around every six frames.
    let place = |t: f32| 5.0 * (t.rem_euclid(12.0) - 6.0).abs();
    let frames: Vec<Encoded> = (0..64).map(|t| frame(t as f32, place, TRUTH, t)).collect();
    let exposure = |with_previous: bool| {
        let mut tracker = Tracker::new(Default::default(), None);
        for observation in FrameObservation::of_frames(&frames).skip(2).step_by(4) {
            let previous = observation.previous.filter(|_| with_previous);
            tracker.push(&FrameObservation { previous, ..observation }).unwrap();
        }
        tracker.model().unwrap().motion_blur.known().map(|m| (m.exposure.0, m.interval))
    };
    let (found, [low, high]) = exposure(true).unwrap();
    assert!((found - TRUTH).abs() < 0.1 && (low..=high).contains(&TRUTH), "{found} [{low}, {high}]");
    // Negative control: by the motion of the frame that was looked at before, streaks seem short.
    let without = exposure(false);
    assert!(without.is_none_or(|(_, [_, high])| high < TRUTH), "{without:?}");
}
