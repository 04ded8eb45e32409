//! Tests on frames with bars of one colour at their edges, which no camera filmed.

mod leaves;

use blindaug::fit::track::Tracker;
use blindaug::fit::{Estimator, EstimatorOptions, FrameObservation};
use blindaug::model::{CameraModel, Estimate, NoiseModel};
use blindaug::{Encoded, Raster, synth};
use leaves::{CAMERA, Camera, Scene};

const NOISE: f32 = 0.01;

/// A moving scene of low contrast through a sharp lens, each frame with bars of this height, px, and colour above and below.
fn letterboxed(bar: usize, colour: [f32; 3]) -> Vec<Encoded> {
    let camera = Camera { sigma_at_infinity: 0.0, exposure: 0.6, noise: 0.0, ..CAMERA };
    let (w, h) = (288, 240);
    let barred = |(t, Encoded(frame)): (usize, Encoded)| {
        let bands = synth::noise::unit_bands(w, h, t as u64, 0);
        let white = synth::noise::white_band_std();
        let noise = synth::noise::modulated(bands, |l, _, _| [NOISE * white[l]; 3]);
        let filmed =
            |x, y| std::array::from_fn(|c| 0.4 + 0.3 * (frame.at(x, y)[c] - 0.4) + noise.at(x, y)[c]);
        Encoded(Raster::from_fn(w, h, |x, y| if (bar..h - bar).contains(&y) { filmed(x, y) } else { colour }))
    };
    Scene::new(2, (w, h))
        .clip(5, |_| camera)
        .into_iter()
        .map(|shot| shot.frame)
        .enumerate()
        .map(barred)
        .collect()
}

fn estimate(frames: &[Encoded]) -> CameraModel {
    let mut estimator = Estimator::new(EstimatorOptions::default());
    FrameObservation::of_frames(frames).for_each(|o| assert!(estimator.add(&o).unwrap()));
    estimator.estimate().unwrap().model
}

fn track(frames: &[Encoded]) -> CameraModel {
    let mut tracker = Tracker::new(Default::default(), None);
    for observation in FrameObservation::of_frames(frames) {
        tracker.push(&observation).unwrap();
    }
    tracker.model().unwrap().clone()
}

/// The std of the noise of the finest level in green at this luminance.
fn std_at(luminance: f32, noise: &Estimate<NoiseModel>) -> f32 {
    noise.known().expect("there is noise").lines().levels[0].sigma(luminance)[1]
}

#[test]
fn bars_change_neither_exposure_nor_noise() {
    for find in [estimate, track] {
        let whole = find(&letterboxed(0, [0.0; 3]));
        for (bar, colour) in [(40, [0.0; 3]), (40, [0.2; 3])] {
            let model = find(&letterboxed(bar, colour));
            let [exposure, own] =
                [&whole, &model].map(|m| m.motion_blur.known().expect("much moves").exposure.0);
            let [noise, own_noise] = [&whole, &model].map(|m| std_at(0.4, &m.noise));
            println!("exposure {exposure} and {own}, noise {noise} and {own_noise}");
            assert!((own - 0.6).abs() < 0.06 && (own - exposure).abs() < 0.02, "{own} for {exposure}");
            assert!((own_noise / noise - 1.0).abs() < 0.05, "{own_noise} for {noise}");
        }
    }
}

#[test]
fn bars_of_a_single_image_are_not_its_flattest_parts() {
    let of = |bar| std_at(0.2, &estimate(&letterboxed(bar, [0.2; 3])[..1]).noise);
    let (whole, barred) = (of(0), of(40));
    println!("{whole} and {barred}");
    assert!(barred > 0.5 * whole, "{barred} for {whole}");
}
