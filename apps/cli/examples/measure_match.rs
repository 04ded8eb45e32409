//! Measures `blindaug match`: a scene is filmed by two cameras of known settings, the footage of B is matched to A, with the true models and
//! with models that were estimated from the footage of each, and compared with the footage of A. `cargo run --release --example
//! measure_match` prints the tables of docs/match.md.

use blindaug::composite::CompositeOptions;
use blindaug::fit::EstimatorOptions;
use blindaug::metrics::psnr;
use blindaug::model::{CameraTrack, DepthKind, NOISE_LEVELS};
use blindaug::synth::defocus::Bokeh;
use blindaug::{CameraModel, Encoded, Flow, Linear, Plane};
use blindaug_pipeline::composite::Rendered;
use blindaug_pipeline::{Footage, MemoryClip, MemorySink, Silent, estimate, matching};
use blindaug_scenes::camera::{Camera, Filmed, Setting, model};
use blindaug_scenes::measure::NoiseTruth;
use blindaug_scenes::scene::{Exposure, Scene};
use std::collections::BTreeMap;

const SIZE: (usize, usize) = (384, 288);
const FRAMES: u64 = 12;

/// The cases: a name, the settings of B and of A as (exposure, lens, noise).
type Settings = (f32, Option<(f32, f32)>, f32);
const CASES: [(&str, Settings, Settings); 6] = [
    ("exposure 0.25 to 0.5", (0.25, None, 0.01), (0.5, None, 0.01)),
    ("exposure 0.5 to 0.9", (0.5, None, 0.01), (0.9, None, 0.01)),
    ("lens 1 px to 3 px, focus 2 m", (0.25, Some((1.0, 2.0)), 0.01), (0.25, Some((3.0, 2.0)), 0.01)),
    ("lens 2 px, focus 1.5 m to 4 m", (0.25, Some((2.0, 1.5)), 0.01), (0.25, Some((2.0, 4.0)), 0.01)),
    ("noise 0.01 to 0.02", (0.25, None, 0.01), (0.25, None, 0.02)),
    (
        "all: 0.25 to 0.5, 1 px to 2 px, 0.005 to 0.015",
        (0.25, Some((1.0, 2.0)), 0.005),
        (0.5, Some((2.0, 2.0)), 0.015),
    ),
];

/// The footage of a scene by one camera.
struct Filming {
    noisy: Vec<Encoded>,
    clean: Vec<Encoded>,
    depth: BTreeMap<u64, Plane>,
    flow: BTreeMap<u64, Flow>,
}

fn film(scene: &Scene, camera: Camera, (exposure, lens, noise): Settings, seed: u64) -> Filming {
    let setting = Setting { exposure, lens, noise, readout: 0.3, rolling_shutter: 0.0 };
    let mut filming = Filming { noisy: vec![], clean: vec![], depth: BTreeMap::new(), flow: BTreeMap::new() };
    for t in 0..FRAMES {
        let sharp: Linear = scene.picture(t as f32, Exposure::default(), 0);
        let (depth, motion) = (scene.inverse_depth(t as f32), scene.motion(t as f32));
        let Filmed { frame, without_noise } =
            camera.film(scene, t, (&sharp, &depth, &motion), &setting, seed).expect("pictures of one size");
        filming.noisy.push(frame);
        filming.clean.push(without_noise);
        filming.depth.insert(t + 1, depth);
        filming.flow.insert(t + 1, motion);
    }
    filming
}

/// The model that the footage alone gives, with depth from elsewhere.
fn estimated(filming: &Filming) -> CameraModel {
    let mut footage = Footage::new(MemoryClip { frames: filming.noisy.clone(), fps: None });
    footage.depth = Some((Box::new(filming.depth.clone()), DepthKind::Metric));
    let job = estimate::Job { options: EstimatorOptions::default(), ..Default::default() };
    estimate::estimate(&footage, job, &Silent).expect("frames").estimation.model
}

/// The frames of B matched to A.
fn matched(frames: &[Encoded], b: &Filming, [from, to]: [&CameraModel; 2], no_noise: bool) -> Vec<Encoded> {
    let footage = Rendered {
        layers: None,
        clip: Box::new(MemoryClip { frames: frames.to_vec(), fps: None }),
        depth: Some((Box::new(b.depth.clone()), DepthKind::Metric)),
        flow: None,
    };
    let job = matching::matching(footage, (CameraTrack::from(from.clone()), "B"), to.clone(), None, &Silent)
        .expect("models");
    let mut sink = MemorySink::default();
    let options = CompositeOptions { no_noise, bokeh: Some(Bokeh::Disk), ..Default::default() };
    job.run(&options, &mut sink, &Silent).expect("frames");
    sink.frames.into_values().collect()
}

fn mean_psnr(a: &[Encoded], b: &[Encoded]) -> f64 {
    let mse = a.iter().zip(b).map(|(a, b)| 10f64.powf(-0.1 * psnr(a, b, None).expect("one size")));
    -10.0 * (mse.sum::<f64>() / a.len() as f64).log10()
}

/// The std of the noise in each level, green.
fn noise_std(noisy: &[Encoded], clean: &[Encoded]) -> NoiseTruth {
    let mut truth = NoiseTruth::default();
    noisy.iter().zip(clean).for_each(|(n, c)| truth.add(n, c));
    truth
}

/// The mean over luminance of the ratio of stds in each level.
fn ratios(of: &NoiseTruth, to: &NoiseTruth) -> String {
    let to: BTreeMap<(usize, usize, u32), f32> =
        to.points().map(|(l, c, y, s)| ((l, c, (100.0 * y) as u32), s)).collect();
    let level = |level: usize| {
        let (mut sum, mut n) = (0.0, 0.0);
        for (l, c, y, s) in of.points() {
            if let (true, Some(t)) = (l == level, to.get(&(l, c, (100.0 * y) as u32))) {
                (sum, n) = (sum + s / t, n + 1.0);
            }
        }
        format!("{:.2}", sum / n)
    };
    (0..NOISE_LEVELS).map(level).collect::<Vec<_>>().join(" ")
}

/// The numbers of a model, for people.
fn words(model: &CameraModel) -> String {
    let exposure = model.motion_blur.known().map_or("?".into(), |m| format!("{:.2}", m.exposure.0));
    let lens = model.defocus.known().map_or("?".into(), |m| format!("{:.1} px", m.sigma_px(0.0)));
    format!("{exposure}, {lens}")
}

fn main() {
    println!(
        "| case | camera | PSNR to A without noise: B, matched by true, by estimated models | noise std over A's in 4 octaves: B | true | estimated |"
    );
    println!("|---|---|---|---|---|---|");
    for (name, b, a) in CASES {
        for camera in [Camera::Synthesis, Camera::Physics] {
            let (mut before, mut by_true, mut by_estimate) = (0.0, 0.0, 0.0);
            let mut noises = [(); 3].map(|()| vec![]);
            const SCENES: [u64; 2] = [101, 106];
            for number in SCENES {
                let scene = Scene::new(number, SIZE);
                let [of_b, of_a] = [film(&scene, camera, b, number), film(&scene, camera, a, number + 1000)];
                let true_models = [b, a].map(|(exposure, lens, noise)| {
                    model(SIZE, &Setting { exposure, lens, noise, readout: 0.3, rolling_shutter: 0.0 })
                });
                let estimates = [estimated(&of_b), estimated(&of_a)];
                eprintln!(
                    "{name}, {camera:?}, scene {number}: B {}, A {}",
                    words(&estimates[0]),
                    words(&estimates[1])
                );
                before += mean_psnr(&of_b.clean, &of_a.clean) / SCENES.len() as f64;
                let noise_of_a = noise_std(&of_a.noisy, &of_a.clean);
                noises[0].push(ratios(&noise_std(&of_b.noisy, &of_b.clean), &noise_of_a));
                for (k, models) in [&true_models, &estimates].into_iter().enumerate() {
                    let models = [&models[0], &models[1]];
                    let clean = matched(&of_b.clean, &of_b, models, true);
                    let noisy = matched(&of_b.noisy, &of_b, models, false);
                    let psnr = mean_psnr(&clean, &of_a.clean) / SCENES.len() as f64;
                    *[&mut by_true, &mut by_estimate][k] += psnr;
                    noises[k + 1].push(ratios(&noise_std(&noisy, &clean), &noise_of_a));
                }
            }
            let [n0, n1, n2] = noises.map(|n| n.join(" / "));
            println!(
                "| {name} | {camera:?} | {before:.1} {by_true:.1} {by_estimate:.1} | {n0} | {n1} | {n2} |"
            );
        }
    }
}
