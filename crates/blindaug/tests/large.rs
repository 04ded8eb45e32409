//! Frames so large that their flow is found at a reduced size.

mod leaves;

use blindaug::analysis::flow::FlowEstimator;
use blindaug::fit::{Estimator, Evidence, FrameObservation};
use blindaug::{CameraModel, Flow};
use leaves::{CAMERA, Scene, Shot};

/// The largest size that the test has time for: its flow is found at half of it.
const SIZE: (usize, usize) = (1024, 384);
const FRAMES: usize = 5;

/// What an estimator says of a clip, given flow (one less than there are frames) or none.
fn estimated(clip: &[Shot], flows: Option<&[Flow]>) -> CameraModel {
    let mut estimator = Estimator::new(Default::default()).expecting(clip.len());
    for (i, shot) in clip.iter().enumerate() {
        let next = clip.get(i + 1).map(|s| &s.frame);
        let previous = i.checked_sub(1).map(|i| &clip[i].frame);
        let flow = flows.map(|f| &f[i.min(f.len() - 1)]);
        let evidence = Evidence { flow, ..Evidence::default() };
        estimator.add(&FrameObservation { frame: &shot.frame, next, previous, evidence }).unwrap();
    }
    estimator.estimate().unwrap().model
}

/// The exposure fraction; NaN if it is unknown.
fn exposure(model: &CameraModel) -> f32 {
    model.motion_blur.known().map_or(f32::NAN, |m| m.exposure.0)
}

/// The std of the finest noise at half luminance, mean of the channels.
fn noise(model: &CameraModel) -> f32 {
    model.noise.known().map_or(f32::NAN, |n| {
        let l = n.lines().levels[0];
        (0..3).map(|c| l.slope[c] * 0.5 + l.intercept[c]).sum::<f32>() / 3.0
    })
}

#[test]
fn flow_at_half_the_size_gives_the_exposure_and_the_noise_that_flow_of_the_whole_gives() {
    /// Of the exposure fraction, and relative of the noise's std.
    const TOLERANCES: [f32; 2] = [0.02, 0.02];
    let clip = Scene::new(3, SIZE).clip(FRAMES, |_| CAMERA);
    let mut flow = FlowEstimator::new();
    let whole: Vec<Flow> =
        clip.windows(2).map(|w| flow.flow(&w[0].frame.luma(), &w[1].frame.luma()).unwrap()).collect();
    let reduced = estimated(&clip, None);
    let given = estimated(&clip, Some(&whole));
    let (a, b) = (exposure(&reduced), exposure(&given));
    assert!((a - b).abs() <= TOLERANCES[0] && (a - CAMERA.exposure).abs() < 0.05, "{a} {b}");
    let ratio = noise(&reduced) / noise(&given);
    assert!((ratio - 1.0).abs() <= TOLERANCES[1], "{ratio}");
    // The negative control: flow in px of the reduced frames, as if nobody had enlarged it.
    let wrong: Vec<Flow> = whole.iter().map(|f| f.map(|v| v.map(|c| 0.5 * c))).collect();
    let wrong = estimated(&clip, Some(&wrong));
    // The wrong flow may also make an estimate unknown, which is NaN here.
    assert!((exposure(&wrong) - b).abs() > 0.1 || exposure(&wrong).is_nan(), "{}", exposure(&wrong));
    // Flow that is wrong by a few px hardly makes the noise wrong, flow that leads elsewhere does.
    let elsewhere: Vec<Flow> = whole.iter().map(|f| f.map(|[u, v]| [u + 40.0, v + 25.0])).collect();
    let elsewhere = noise(&estimated(&clip, Some(&elsewhere)));
    assert!((elsewhere / noise(&given) - 1.0).abs() > 0.1 || elsewhere.is_nan(), "{elsewhere}");
}
