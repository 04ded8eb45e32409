//! Tests on clips of several shots.

mod leaves;

use blindaug::Encoded;
use blindaug::fit::track::Tracker;
use blindaug::fit::{Estimation, Estimator, EstimatorOptions, FrameObservation};
use blindaug::model::Reason;
use leaves::{CAMERA, Camera, Scene};

const FRAMES: usize = 4;

/// The frames of a scene filmed with these exposures.
fn filmed(scene: u64, exposures: &[f32]) -> Vec<Encoded> {
    let camera = |t: usize| Camera { exposure: exposures[t], noise: 0.006, ..CAMERA };
    Scene::new(scene, (256, 192)).clip(exposures.len(), camera).into_iter().map(|shot| shot.frame).collect()
}

/// The estimate from two scenes filmed one after the other with these exposures.
fn montage(exposures: [f32; 2]) -> Estimation {
    let [first, second] = exposures.map(|e| [e; FRAMES]);
    estimate(&[filmed(1, &first), filmed(100, &second)].concat())
}

fn estimate(frames: &[Encoded]) -> Estimation {
    let mut estimator = Estimator::new(EstimatorOptions::default());
    FrameObservation::of_frames(frames).for_each(|o| assert!(estimator.add(&o).unwrap()));
    estimator.estimate().unwrap()
}

#[test]
fn shots_of_different_shutters_are_told_apart() {
    let Estimation { model, diagnostics } = montage([0.25, 0.8]);
    let why = model.motion_blur.why_unknown().expect("no one exposure is that of both");
    println!("{why}");
    assert_eq!(why.reason, Reason::Contradicting);
    assert!(why.sentence.contains("shot 1") && why.sentence.contains("shot 2"), "{why}");
    assert_eq!(diagnostics.shots.iter().map(|s| s.frames.clone()).collect::<Vec<_>>(), [0..4, 4..8]);
    for (shot, exposure) in diagnostics.shots.iter().zip([0.25, 0.8]) {
        let found = shot.motion_blur.known().expect("each can tell").exposure.0;
        assert!((found - exposure).abs() < 0.08, "{found} for {exposure}");
    }
}

#[test]
fn shots_of_one_shutter_are_measured_together() {
    let Estimation { model, diagnostics } = montage([0.5, 0.5]);
    assert_eq!(diagnostics.shots.len(), 2);
    let found = model.motion_blur.known().expect("they agree");
    println!("{} {:?}", found.exposure.0, found.interval);
    assert!((found.exposure.0 - 0.5).abs() < 0.05, "{}", found.exposure.0);
    let samples = |i: usize| diagnostics.shots[i].motion_blur.known().map_or(0, |m| m.samples);
    assert_eq!(found.samples, samples(0) + samples(1));
    // All frames can be followed to a neighbour within their shot.
    assert!(model.warnings.iter().all(|n| !n.contains("followed")), "{:?}", model.warnings);
}

#[test]
fn a_clip_without_a_cut_is_one_shot_whatever_its_shutter_does() {
    let Estimation { diagnostics, .. } = estimate(&filmed(1, &[0.25, 0.25, 0.25, 0.8, 0.8, 0.8]));
    assert!(diagnostics.shots.is_empty(), "{:?}", diagnostics.shots);
}

#[test]
fn a_tracker_does_not_carry_over_a_cut_what_it_knows_of_the_shutter() {
    let known = |frames: &[Encoded]| -> Vec<Option<f32>> {
        let mut tracker = Tracker::new(Default::default(), None);
        let exposure = |o: FrameObservation| Some(tracker.push(&o).unwrap().motion_blur.known()?.exposure.0);
        FrameObservation::of_frames(frames).map(exposure).collect()
    };
    let moving = filmed(1, &[0.5; 6]);
    // A camera that stands still says nothing of its shutter.
    let still = |scene| {
        let camera = Camera { noise: 0.006, moves: false, ..CAMERA };
        Scene::new(scene, (256, 192)).clip(4, |_| camera).into_iter().map(|shot| shot.frame)
    };
    let same = known(&moving.iter().cloned().chain(still(1)).collect::<Vec<_>>());
    let other = known(&moving.iter().cloned().chain(still(100)).collect::<Vec<_>>());
    println!("{same:?}\n{other:?}");
    // Without a cut, the exposure is kept.
    assert!(same[5..].iter().all(|e| e.is_some_and(|e| (e - 0.5).abs() < 0.1)));
    assert!(other[6..].iter().all(Option::is_none));
}
