//! Tests of the tracker on clips whose camera changes.

mod leaves;
mod shaken;

use blindaug::fit::{
    Estimation, Estimator, Evidence, FrameObservation,
    spectral::{EXPOSURES, ExposureObservation, numbers::EXPOSURE_STEP},
    track::{TileLook, TileObservations, TileObserver, Tracker},
};
use blindaug::model::{Bokeh, CameraModel, Changes, DefocusCurve, DepthKind, Distortion, Reason};
use blindaug::{Encoded, synth};
use leaves::{CAMERA, Camera, Scene, Shot};
use shaken::shaken;

const SIZE: (usize, usize) = (256, 192);

/// The tracker's models and changes for each frame of a clip, with motion and depth given.
fn tracked(clip: &[Shot]) -> Vec<(CameraModel, Changes)> {
    let mut tracker = Tracker::new(Default::default(), None);
    clip.windows(2)
        .map(|w| {
            let m = push(&mut tracker, &w[0], &w[1]);
            (m, tracker.changes())
        })
        .collect()
}

fn push(tracker: &mut Tracker, shot: &Shot, next: &Shot) -> CameraModel {
    tracker.push(&observation(shot, next)).unwrap().clone()
}

fn observation<'a>(shot: &'a Shot, next: &'a Shot) -> FrameObservation<'a> {
    let evidence = Evidence {
        flow: Some(&shot.flow),
        inverse_depth: Some((&shot.inverse_depth, DepthKind::Metric)),
        ..Evidence::default()
    };
    FrameObservation { frame: &shot.frame, next: Some(&next.frame), previous: None, evidence }
}

fn exposure(m: &CameraModel) -> f32 {
    m.motion_blur.known().map_or(f32::NAN, |m| m.exposure.0)
}

fn noise(m: &CameraModel) -> f32 {
    let white = synth::noise::white_band_std();
    m.noise.known().map_or(f32::NAN, |n| {
        let l = n.lines().levels[0];
        (0..3).map(|c| l.slope[c] * 0.4 + l.intercept[c]).sum::<f32>() / 3.0 / white[0]
    })
}

/// The mean error of the std of the blur at the depths of the scene, px.
fn blur_error(m: &CameraModel, truth: &Camera) -> f32 {
    let Some(lens) = m.defocus.known() else { return f32::NAN };
    let error = |d: f32| (lens.sigma_px(d) - truth.sigma_at_infinity * (1.0 - d / truth.focus).abs()).abs();
    leaves::LAYERS.map(error).iter().sum::<f32>() / leaves::LAYERS.len() as f32
}

fn mean(v: &[f32]) -> f32 {
    v.iter().sum::<f32>() / v.len() as f32
}

fn std(v: &[f32]) -> f32 {
    let mean = mean(v);
    (v.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / v.len() as f32).sqrt()
}

/// The frame in which the parameters jump.
const JUMP: usize = 25;
/// The number of frames after the jump by which the estimates must have settled.
const SETTLED: usize = 10;
/// The number of frames of a clip with a jump.
const JUMP_CLIP: usize = 46;

/// The models of a clip in which the camera jumps, from the frame on in which they must have settled, and the frames in which a change
/// was noticed, with the changes.
fn after_a_jump(seed: u64, to: Camera) -> (Vec<CameraModel>, Vec<(usize, Changes)>) {
    let clip = Scene::new(seed, SIZE).clip(JUMP_CLIP, |t| if t < JUMP { CAMERA } else { to });
    let models = tracked(&clip);
    let noticed =
        models.iter().enumerate().filter(|(_, (_, c))| !c.is_empty()).map(|(t, (_, c))| (t, *c)).collect();
    (models.into_iter().skip(JUMP + SETTLED).map(|(m, _)| m).collect(), noticed)
}

/// Whether an estimate of the exposure is close to the truth.
fn settled(estimate: f32, truth: f32) -> bool {
    (estimate - truth).abs() < 0.05
}

#[test]
fn a_jump_of_the_shutter_is_followed_within_ten_frames() {
    for (seed, exposure_after) in [(1, 0.75), (2, 0.25)] {
        let (models, noticed) = after_a_jump(seed, Camera { exposure: exposure_after, ..CAMERA });
        let found: Vec<f32> = models.iter().map(exposure).collect();
        println!("{exposure_after}: {found:.3?}, {noticed:?}");
        assert!(found.iter().all(|&e| settled(e, exposure_after)), "{found:?}");
        let [(at, changes)] = noticed[..] else { panic!("{noticed:?}") };
        assert!(changes.of(Distortion::MotionBlur), "{changes:?}");
        assert!((JUMP..JUMP + 6).contains(&at), "{at}");
        // The estimates of the lens and the noise have not changed.
        assert!(models.iter().all(|m| blur_error(m, &CAMERA) < 0.35 && (noise(m) / 0.01 - 1.0).abs() < 0.1));
    }
}

#[test]
fn what_never_forgets_is_seen_not_to_settle() {
    let clip = Scene::new(1, SIZE)
        .clip(JUMP_CLIP, |t| Camera { exposure: if t < JUMP { 0.5 } else { 0.75 }, ..CAMERA });
    let mut all = Estimator::new(Default::default());
    for w in clip.windows(2).take(JUMP + SETTLED) {
        let evidence = Evidence { flow: Some(&w[0].flow), ..Evidence::default() };
        all.add(&FrameObservation { frame: &w[0].frame, next: Some(&w[1].frame), previous: None, evidence })
            .unwrap();
    }
    let found = exposure(&all.estimate().unwrap().model);
    println!("{found}");
    assert!(!settled(found, 0.75));
}

#[test]
fn a_jump_of_the_focus_is_followed_within_ten_frames() {
    let to = Camera { focus: 0.4, ..CAMERA };
    let (models, noticed) = after_a_jump(1, to);
    let errors: Vec<f32> = models.iter().map(|m| blur_error(m, &to)).collect();
    println!("{errors:.2?}, {noticed:?}");
    assert!(errors.iter().all(|&e| e < 0.35), "{errors:?}");
    assert!(
        noticed.iter().any(|(t, c)| c.of(Distortion::Defocus) && (JUMP..JUMP + 6).contains(t)),
        "{noticed:?}"
    );
    // Negative control: the lens before the jump has a larger error than is allowed.
    let mut before = models[0].clone();
    before.defocus = blindaug::model::Estimate::Known(blindaug::model::DefocusModel::given_lens(
        CAMERA.sigma_at_infinity,
        CAMERA.focus,
    ));
    assert!(blur_error(&before, &to) > 0.5);
}

#[test]
fn the_shape_of_out_of_focus_points_is_told_where_much_is_blurred() {
    let lens_of = |sigma_at_infinity: f32, bokeh: Bokeh| {
        let camera = Camera { exposure: 0.2, sigma_at_infinity, bokeh, noise: 0.003, ..CAMERA };
        let clip = Scene::new(4, SIZE).clip(34, |_| camera);
        let (model, _) = tracked(&clip).pop().unwrap();
        let lens = *model.defocus.known().unwrap();
        let DefocusCurve::ThinLens { interval: Some(interval), .. } = lens.curve else { panic!("{lens:?}") };
        println!("{bokeh:?} {lens:?}");
        (lens.bokeh.bokeh, interval.sigma_px_at_infinity)
    };
    let (shape, [low, high]) = lens_of(4.0, Bokeh::Disk);
    assert!(shape == Bokeh::Disk && high < 2.0 * low, "{shape:?}, {low} to {high}");
    // Where Gaussians are told, the interval takes in what they would need beside what disks would.
    let (shape, [low, high]) = lens_of(4.0, Bokeh::Gaussian);
    assert!(
        shape == Bokeh::Gaussian && (low..=high).contains(&4.0) && high > 2.0 * low,
        "{shape:?}, {low} to {high}"
    );
    // Negative control: a sharp lens shows no disks.
    assert_eq!(lens_of(0.3, Bokeh::Disk).0, Bokeh::Gaussian);
}

#[test]
fn a_jump_of_the_gain_is_followed_within_ten_frames() {
    for (seed, std) in [(1, 0.02), (2, 0.006)] {
        let (models, noticed) = after_a_jump(seed, Camera { noise: std, ..CAMERA });
        let found: Vec<f32> = models.iter().map(noise).collect();
        println!("{std}: {found:.4?}, {noticed:?}");
        assert!(found.iter().all(|n| (n / std - 1.0).abs() < 0.12), "{found:?}");
        assert!(
            noticed.iter().any(|(t, c)| c.of(Distortion::Noise) && (JUMP..JUMP + 6).contains(t)),
            "{noticed:?}"
        );
        assert!(models.iter().all(|m| (exposure(m) - CAMERA.exposure).abs() < 0.08));
    }
}

#[test]
fn a_steady_camera_is_told_three_times_as_steadily_as_by_single_frames_and_nothing_is_noticed() {
    let clip = Scene::new(3, SIZE).clip(70, |_| CAMERA);
    let models = tracked(&clip);
    assert!(models.iter().all(|(_, c)| c.is_empty()));
    let late = &models[30..];
    let single: Vec<CameraModel> = clip
        .windows(2)
        .skip(30)
        .map(|w| push(&mut Tracker::new(Default::default(), None), &w[0], &w[1]))
        .collect();
    let blur = |m: &CameraModel| m.defocus.known().map_or(f32::NAN, |d| d.sigma_px(leaves::LAYERS[0]));
    let truth = CAMERA.sigma_at_infinity * (1.0 - leaves::LAYERS[0] / CAMERA.focus);
    let check = |name: &str, of: &dyn Fn(&CameraModel) -> f32, truth: f32| {
        let scatter = std(&late.iter().map(|(m, _)| of(m)).collect::<Vec<_>>());
        let squares: Vec<f32> =
            single.iter().map(of).filter(|v| v.is_finite()).map(|v| (v - truth).powi(2)).collect();
        let error = mean(&squares).sqrt();
        println!("{name}: scatter {scatter:.5}, error of single frames {error:.5}, {:.2}", scatter / error);
        assert!(squares.len() > 20 && scatter < error / 3.0, "{name}: {scatter} {error}");
    };
    check("exposure", &exposure, CAMERA.exposure);
    check("blur of what is far", &blur, truth);
    check("noise", &noise, CAMERA.noise);
}

#[test]
fn a_drift_of_the_shutter_is_followed() {
    let truth = |t: usize| 0.3 + 0.006 * t as f32;
    let clip = Scene::new(1, SIZE).clip(70, |t| Camera { exposure: truth(t), ..CAMERA });
    let errors: Vec<f32> =
        tracked(&clip).iter().enumerate().map(|(t, (m, _))| exposure(m) - truth(t)).collect();
    println!("{errors:.3?}");
    assert!(errors[20..].iter().all(|e| e.abs() < 0.13), "{errors:?}");
    assert!(mean(&errors[20..]).abs() < 0.08, "{}", mean(&errors[20..]));
}

#[test]
fn a_still_stretch_is_bridged_and_the_interval_widens() {
    let still = 20..50;
    let clip = Scene::new(1, SIZE).clip(65, |t| Camera { moves: !still.contains(&t), ..CAMERA });
    let models: Vec<CameraModel> = tracked(&clip).into_iter().map(|m| m.0).collect();
    let width = |t: usize| models[t].motion_blur.known().map(|m| m.interval[1] - m.interval[0]).unwrap();
    println!("{:.3?}", models.iter().map(exposure).collect::<Vec<_>>());
    // The last exposure stays while nothing moves, and its interval widens.
    assert!(still.clone().skip(1).all(|t| exposure(&models[t]) == exposure(&models[still.start])));
    assert!(width(48) > width(35) && width(35) > width(19), "{} {} {}", width(19), width(35), width(48));
    // The interval is narrower again soon after the camera moves on.
    assert!(width(60) < width(48) && settled(exposure(&models[60]), CAMERA.exposure));
    // The noise is measured all the time.
    assert!(still.clone().all(|t| (noise(&models[t]) / CAMERA.noise - 1.0).abs() < 0.1));
}

#[test]
fn frames_alone_are_enough() {
    let clip = Scene::new(1, SIZE).clip(30, |_| CAMERA);
    let mut tracker = Tracker::new(Default::default(), None);
    for w in clip.windows(2) {
        let evidence = Evidence::default();
        let observation =
            FrameObservation { frame: &w[0].frame, next: Some(&w[1].frame), previous: None, evidence };
        tracker.push(&observation).unwrap();
    }
    let model = tracker.model().unwrap();
    println!("{:.3} {:.4} {:?}", exposure(model), noise(model), model.defocus);
    assert!(
        (exposure(model) - CAMERA.exposure).abs() < 0.08 && (noise(model) / CAMERA.noise - 1.0).abs() < 0.15
    );
}

/// The exposure of each frame but the last, tracked by the frames alone, and whether it was found to have changed.
fn followed(frames: &[Encoded], with_previous: bool) -> Vec<(f32, [f32; 2], bool)> {
    let mut tracker = Tracker::new(Default::default(), None);
    let one = |observation: FrameObservation| {
        let previous = observation.previous.filter(|_| with_previous);
        let model = tracker.push(&FrameObservation { previous, ..observation }).unwrap();
        let told = model.motion_blur.known().map(|m| (m.exposure.0, m.interval));
        let (exposure, interval) = told.unwrap_or((f32::NAN, [0.0, 1.0]));
        (exposure, interval, tracker.changes().of(Distortion::MotionBlur))
    };
    FrameObservation::of_frames(frames).take(frames.len() - 1).map(one).collect()
}

#[test]
fn the_exposure_is_followed_under_a_shaking_hand() {
    for truth in [0.4, 0.9] {
        let frames = shaken(SIZE, 30, |_| truth, 3.0);
        for with_previous in [false, true] {
            let told = followed(&frames, with_previous);
            println!("{truth} {with_previous}: {told:.2?}");
            let of = &told[5..];
            assert!(
                of.iter()
                    .all(|(e, [low, high], _)| { (low..=high).contains(&&truth) && (e - truth).abs() < 0.1 })
            );
            assert!(told.iter().all(|t| !t.2), "nothing has changed");
            // Negative control: the intervals say something.
            assert!(of.iter().all(|(_, [low, high], _)| high - low < 0.45));
        }
    }
}

#[test]
fn a_shutter_that_changes_under_a_shaking_hand_is_found() {
    const AT: usize = 16;
    for (before, after) in [(0.3, 0.8), (0.8, 0.3)] {
        let told = followed(&shaken(SIZE, 32, |t| if t < AT { before } else { after }, 3.3), true);
        println!("{before} {after}: {told:.2?}");
        let changed: Vec<usize> = (0..told.len()).filter(|&t| told[t].2).collect();
        assert!(matches!(changed[..], [at] if (AT..AT + 6).contains(&at)), "{changed:?}");
        let near = |frames: &[(f32, [f32; 2], bool)], truth: f32| {
            frames.iter().all(|(e, [low, high], _)| (e - truth).abs() < 0.1 && (low..=high).contains(&&truth))
        };
        assert!(near(&told[5..AT], before) && near(&told[AT + 6..], after));
    }
}

#[test]
fn of_a_long_clip_too_the_motion_at_a_frame_s_own_time_counts() {
    const TRUTH: f32 = 0.5;
    let frames = shaken(SIZE, 60, |_| TRUTH, 5.0);
    let estimated = |with_previous: bool| {
        // Every second frame is looked at.
        let mut estimator = Estimator::new(Default::default()).expecting(frames.len());
        for observation in FrameObservation::of_frames(&frames) {
            let previous = observation.previous.filter(|_| with_previous);
            estimator.add(&FrameObservation { previous, ..observation }).unwrap();
        }
        estimator.estimate().unwrap()
    };
    let estimation = estimated(true);
    let found = estimation.model.motion_blur.known().expect("it is known");
    println!("{found:?}");
    let [low, high] = found.interval;
    assert!((found.exposure.0 - TRUTH).abs() < 0.1 && (low..=high).contains(&TRUTH) && high - low < 0.5);
    // Negative control: by the flow to the next frame alone, half an interval late, the frames are farther off.
    let errors = |e: &Estimation| {
        mean(&e.diagnostics.exposure_per_frame.iter().map(|(_, e)| (e - TRUTH).abs()).collect::<Vec<f32>>())
    };
    let (own, late) = (errors(&estimation), errors(&estimated(false)));
    println!("{own} {late}");
    assert!(own < 0.7 * late, "{own} {late}");
}

/// Claims that ten tiles of each frame show this exposure, and keeps what it was told.
struct Claims {
    exposure: f32,
    block: u32,
    told: Vec<(f32, bool)>,
}

impl TileObserver for Claims {
    fn observe(&mut self, look: &TileLook) -> blindaug::Result<TileObservations> {
        // Until the exposure is known, nothing that moves may be looked at for the lens.
        let unknown = |d: &blindaug::Plane| d.data().iter().any(|d| d.is_nan());
        self.told.push((look.exposure.0, look.inverse_depth.is_some_and(unknown)));
        assert!(look.motion.is_some() && look.noise.levels[0].intercept > 0.0);
        let curve = |i: usize| -0.5 * ((i as f32 * EXPOSURE_STEP - self.exposure) / 0.05).powi(2);
        let claim = |block| ExposureObservation {
            block,
            frame: 0,
            speed: 12.0,
            speed_error: 0.0,
            log_likelihood: (0..EXPOSURES).map(curve).collect(),
        };
        let exposure = (self.block..self.block + 10).map(claim).collect();
        Ok(TileObservations { exposure, lens: vec![] })
    }
}

#[test]
fn an_observer_looks_at_the_tiles_in_the_tracker_s_place() {
    let clip = Scene::new(3, SIZE).clip(4, |_| CAMERA);
    let mut tracker = Tracker::new(Default::default(), None);
    let mut claims = Claims { exposure: 0.3, block: 0, told: vec![] };
    for pair in clip.windows(2) {
        let model = tracker.push_with(&observation(&pair[0], &pair[1]), &mut claims).unwrap();
        // The depth is given in all frames, the exposure is known from the first one on.
        let why = model.defocus.why_unknown().expect("no tile was said to show the lens");
        let reason = if pair[0].frame == clip[0].frame { Reason::Uncertain } else { Reason::Flat };
        assert_eq!(why.reason, reason, "{why}");
    }
    let model = tracker.model().unwrap();
    assert!((exposure(model) - 0.3).abs() < 0.01, "{:?}", model.motion_blur);
    // The tracker found the noise itself.
    assert!(noise(model) > 0.0);
    let [first, _, third] = claims.told[..] else { panic!("three frames") };
    assert_eq!(first, (0.0, true));
    assert!((third.0 - 0.3).abs() < 0.01 && !third.1, "{third:?}");
    // Negative control: the tracker itself finds the camera's exposure, which is another.
    let own = tracked(&clip).pop().unwrap().0;
    assert!((exposure(&own) - exposure(model)).abs() > 0.1, "{:?}", own.motion_blur);
    // Blocks of the image that are not there are an error.
    claims.block = 20;
    assert!(tracker.push_with(&observation(&clip[2], &clip[3]), &mut claims).is_err());
}
