//! The tracker on clips whose camera changes.

mod leaves;

use blindaug::fit::{
    Evidence, Observation,
    track::{Changes, Tracker},
};
use blindaug::model::{BlurSpace, CameraModel, DefocusCurve, DepthKind};
use blindaug::synth;
use leaves::{CAMERA, Scene, Shot};

const SIZE: (usize, usize) = (256, 192);

/// The tracker's models of a clip, motion and depth given.
fn tracked(clip: &[Shot]) -> Vec<(CameraModel, Changes)> {
    let mut tracker = Tracker::new(BlurSpace::Linear, None);
    clip.windows(2)
        .map(|w| {
            let m = push(&mut tracker, &w[0], &w[1]);
            (m, tracker.changes())
        })
        .collect()
}

fn push(tracker: &mut Tracker, shot: &Shot, next: &Shot) -> CameraModel {
    let evidence = Evidence {
        flow: Some(&shot.flow),
        inverse_depth: Some((&shot.inverse_depth, DepthKind::Metric)),
        ..Evidence::default()
    };
    let observation = Observation { frame: &shot.frame, next: Some(&next.frame), previous: None, evidence };
    tracker.push(&observation).unwrap().clone()
}

fn exposure(m: &CameraModel) -> f32 {
    m.motion_blur.known().map_or(f32::NAN, |m| m.exposure.0)
}

fn noise(m: &CameraModel) -> f32 {
    let white = synth::noise::white_band_std();
    m.noise.known().map_or(f32::NAN, |n| {
        let l = n.levels[0];
        (0..3).map(|c| l.slope[c] * 0.4 + l.intercept[c]).sum::<f32>() / 3.0 / white[0]
    })
}

fn lens(m: &CameraModel) -> [f32; 2] {
    match m.defocus.known().map(|d| d.curve) {
        Some(DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, .. }) => {
            [sigma_px_at_infinity, focus_inverse_depth]
        }
        _ => [f32::NAN; 2],
    }
}

#[test]
fn look() {
    let now = std::time::Instant::now();
    let seed = std::env::var("SEED").map_or(1, |s| s.parse().unwrap());
    let scene = Scene::new(seed, SIZE);
    println!("scene {:?}", now.elapsed());
    let kind: String = std::env::var("KIND").unwrap_or_default();
    let clip = scene.clip(70, |t| {
        let mut c = CAMERA;
        match kind.as_str() {
            "lambda" => c.exposure = if t < 35 { 0.3 } else { 0.7 },
            "focus" => c.focus = if t < 35 { 0.9 } else { 0.4 },
            "noise" => c.noise = if t < 35 { 0.01 } else { 0.02 },
            "drift" => c.exposure = 0.3 + 0.004 * t as f32,
            "still" => c.moves = !(30..50).contains(&t),
            _ => {}
        }
        c
    });
    println!("clip {:?}", now.elapsed());
    let models = tracked(&clip);
    println!("tracked {:?}", now.elapsed());
    for (t, (m, c)) in models.iter().enumerate() {
        let mut single = Tracker::new(BlurSpace::Linear, None);
        let s = push(&mut single, &clip[t], &clip[t + 1]);
        let i = m.motion_blur.known().map_or([0.0; 2], |m| m.interval);
        println!(
            "{t} lambda {:.3} [{:.2} {:.2}] ({:.3})  lens {:.2?} ({:.2?}) noise {:.4} ({:.4}) {}{}{}",
            exposure(m),
            i[0],
            i[1],
            exposure(&s),
            lens(m),
            lens(&s),
            noise(m),
            noise(&s),
            if c.exposure { "LAMBDA " } else { "" },
            if c.defocus { "LENS " } else { "" },
            if c.noise { "NOISE" } else { "" },
        );
    }
}

#[test]
fn speed() {
    let clip = Scene::new(1, (640, 480)).clip(14, |_| CAMERA);
    let mut tracker = Tracker::new(BlurSpace::Linear, None);
    for _ in 0..3 {
        for w in clip.windows(2) {
            let observation = Observation {
                frame: &w[0].frame,
                next: Some(&w[1].frame),
                previous: None,
                evidence: Evidence::default(),
            };
            let m = tracker.push(&observation).unwrap().clone();
            println!(
                "geometry lambda {:.3} {:?} {:?} noise {:.4}",
                exposure(&m),
                m.motion_blur.known().map(|m| m.interval),
                lens(&m),
                noise(&m)
            );
        }
    }
}
