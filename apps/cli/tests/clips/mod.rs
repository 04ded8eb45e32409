//! The rendered clips of known truth in the shared folder, and how far estimates lie from it.

use blindaug::composite::{self, Shot, VirtualLayer};
use blindaug::fit::{Curve, Estimation, Estimator, Evidence, Family, Observation, Options};
use blindaug::metrics::{object_area, psnr};
use blindaug::model::{
    BlurSpace, CameraModel, DefocusModel, DepthKind, Estimate, ExposureFraction, MotionBlurModel,
};
use blindaug::synth::defocus::Bokeh;
use blindaug::{Encoded, Flow, Plane, Transfer};
use std::path::{Path, PathBuf};

/// The folder of clips, or `None`, said loudly, where the shared data are missing.
pub fn folder() -> Option<PathBuf> {
    let shared = std::env::var_os("BLINDAUG_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"), PathBuf::from);
    let clips = shared.join("data/clips");
    if !clips.is_dir() {
        eprintln!("SKIPPED: no clips in {}; set BLINDAUG_SHARED to the shared folder", clips.display());
        return None;
    }
    Some(clips)
}

/// The names of the clips.
pub fn names(clips: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(clips)
        .expect("the clips can be listed")
        .filter_map(|e| e.ok()?.file_name().into_string().ok())
        .filter(|n| clips.join(n).join("truth.json").is_file())
        .collect();
    names.sort();
    names
}

/// The truth of one condition of a clip.
pub struct Truth {
    pub exposure: f32,
    /// sigma at infinity (px) and focus distance (m).
    pub lens: Option<(f32, f32)>,
    /// Readout and shot noise: std = readout + shot sqrt(I).
    pub noise: Option<(f32, f32)>,
}

impl Truth {
    pub fn of(clip: &Path, condition: &str) -> Self {
        let text = std::fs::read_to_string(clip.join("truth.json")).expect("truth.json");
        let all: serde_json::Value = serde_json::from_str(&text).expect("truth.json holds JSON");
        let t = &all[condition];
        let number = |v: &serde_json::Value| v.as_f64().map(|v| v as f32);
        let pair = |v: &serde_json::Value, a: &str, b: &str| Some((number(&v[a])?, number(&v[b])?));
        Self {
            exposure: number(&t["exposure"]).unwrap_or(0.0),
            lens: pair(&t["lens"], "sigma_px_at_infinity", "focus_distance_m"),
            noise: pair(&t["noise"], "k_readout", "k_shot"),
        }
    }

    pub fn sigma_px(&self, d: f32) -> f32 {
        self.lens.map_or(0.0, |(sigma, focus)| sigma * (1.0 - focus * d).abs())
    }
}

/// The conditions of a clip whose names begin so.
pub fn conditions(clip: &Path, prefix: &str) -> Vec<String> {
    let mut all: Vec<String> = std::fs::read_dir(clip)
        .expect("the clip can be listed")
        .filter_map(|e| e.ok()?.file_name().into_string().ok())
        .filter(|n| n.starts_with(prefix))
        .collect();
    all.sort();
    all
}

pub fn frame(clip: &Path, condition: &str, number: u64) -> Encoded {
    blindaug_io::read_frame(clip.join(format!("{condition}/{number:04}.png"))).expect("a frame")
}

pub fn numbers(clip: &Path, condition: &str) -> Vec<u64> {
    (1..=99).filter(|n| clip.join(format!("{condition}/{n:04}.png")).is_file()).collect()
}

pub fn flow(clip: &Path, number: u64) -> Flow {
    blindaug_io::read_flow(clip.join(format!("clean/{number:04}.exr"))).expect("flow")
}

pub fn inverse_depth(clip: &Path, number: u64) -> Plane {
    blindaug_io::read_inverse_depth(clip.join(format!("clean/{number:04}.exr")), Default::default())
        .expect("depth")
}

/// What is given beside the frames.
#[derive(Clone, Copy, Default)]
pub struct Given {
    pub flow: bool,
    pub depth: bool,
    pub clean: bool,
    pub quadratic: bool,
}

/// Estimates one condition of a clip.
pub fn estimate(clip: &Path, condition: &str, given: Given) -> Estimation {
    let mut estimator = Estimator::new(Options {
        family: if given.clean { Family::Removal } else { Family::Spectral },
        curve: if given.quadratic { Curve::Quadratic } else { Curve::ThinLens },
        blur_space: BlurSpace::Linear,
        fps: Some(30.0),
    });
    let numbers = numbers(clip, condition);
    let frames: Vec<Encoded> = numbers.iter().map(|&n| frame(clip, condition, n)).collect();
    for (i, &n) in numbers.iter().enumerate() {
        // A single frame of a clip whose camera moves, but whose shutter was closed: nothing is known of its motion.
        let flow = (given.flow && numbers.len() > 1).then(|| flow(clip, n));
        let depth = given.depth.then(|| inverse_depth(clip, n));
        let clean = given.clean.then(|| self::frame(clip, "clean", n));
        estimator
            .add(&Observation {
                frame: &frames[i],
                next: frames.get(i + 1),
                previous: i.checked_sub(1).map(|i| &frames[i]),
                evidence: Evidence {
                    flow: flow.as_ref(),
                    inverse_depth: depth.as_ref().map(|d| (d, DepthKind::Metric)),
                    clean: clean.as_ref(),
                    ..Default::default()
                },
            })
            .expect("the clips are sound");
    }
    estimator.estimate().expect("there are frames")
}

/// Estimated exposure fraction and its interval.
pub fn exposure(e: &Estimation) -> Option<(f32, [f32; 2])> {
    e.model.motion_blur.known().map(|m| (m.exposure.0, m.interval))
}

/// Mean over the scene's pixels of |estimated - true| blur, and of the true blur, px.
pub fn delta_error(clip: &Path, e: &Estimation, truth: &Truth) -> Option<(f32, f32)> {
    let d = inverse_depth(clip, 3);
    let model = e.model.defocus.known()?;
    let n = d.data().len() as f32;
    let error = d.data().iter().map(|&d| (model.sigma_px(d) - truth.sigma_px(d)).abs()).sum::<f32>() / n;
    Some((error, d.data().iter().map(|&d| truth.sigma_px(d)).sum::<f32>() / n))
}

/// Per level, the mean over R, G, B and luminances of |estimated / true - 1| of the noise std.
pub fn noise_error(e: &Estimation, truth: &Truth) -> Option<Vec<f32>> {
    let (readout, shot) = truth.noise?;
    let Estimate::Known(model) = &e.model.noise else { return None };
    let white = blindaug::synth::noise::white_band_std();
    let luminances = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7];
    Some(
        model
            .levels
            .iter()
            .zip(white)
            .map(|(level, white)| {
                let error = |y: f32| {
                    // 8-bit rounding adds a variance of 1/12 step.
                    let std = ((readout + shot * y.sqrt()).powi(2) + (1.0 / 255.0f32).powi(2) / 12.0).sqrt()
                        * white;
                    level.sigma(y).iter().map(|s| (s / std - 1.0).abs()).sum::<f32>() / 3.0
                };
                luminances.iter().map(|&y| error(y)).sum::<f32>() / luminances.len() as f32
            })
            .collect(),
    )
}

/// Mean PSNR in dB over the object's area grown by 20 px of the composites `PREFIX_plain` + virtual object against
/// `PREFIX_with`, with this camera; without noise.
pub fn composite_psnr(clip: &Path, prefix: &str, model: &CameraModel, naive: bool) -> f64 {
    let numbers = numbers(clip, &format!("{prefix}_with"));
    let sum: f64 = numbers
        .iter()
        .map(|&n| {
            let layer =
                blindaug_io::read_virtual_layer(clip.join(format!("virtual/{n:04}.exr"))).expect("a layer");
            let layer =
                VirtualLayer { color: layer.color, inverse_depth: layer.inverse_depth, flow: layer.flow };
            let linear = |c: &str| frame(clip, c, n).to_linear(Transfer::Srgb);
            let (with, without) = (linear("clean_with"), linear("clean"));
            let (plain, truth) =
                (frame(clip, &format!("{prefix}_plain"), n), frame(clip, &format!("{prefix}_with"), n));
            let (depth, flow) = (inverse_depth(clip, n), flow(clip, n));
            let shot = Shot {
                frame: &plain,
                number: n,
                inverse_depth: Some(&depth),
                flow: Some(&flow),
                with_and_without: Some((&with, &without)),
            };
            let options = composite::Options { naive, no_noise: true, bokeh: Bokeh::Disk, seed: 0 };
            let made = composite::composite(&shot, &layer, model, &options).expect("sizes agree");
            psnr(&made, &truth, Some(&object_area(&layer.color.0.map(|p| p[3]), 20)))
                .expect("the object is in view")
        })
        .sum();
    sum / numbers.len() as f64
}

/// The camera as it really was.
pub fn true_model(estimated: &CameraModel, truth: &Truth) -> CameraModel {
    let mut model = estimated.clone();
    model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(truth.exposure)));
    let (sigma_px_at_infinity, focus) = truth.lens.expect("a condition with a lens");
    model.defocus = Estimate::Known(DefocusModel::given_lens(sigma_px_at_infinity, 1.0 / focus));
    model
}
