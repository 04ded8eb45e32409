//! Rendered clips of known truth from a folder: one folder per clip, with `clean/`, a folder per condition and `truth.json`.

use blindaug::composite::{self, CompositeOptions, Plate, VirtualLayer};
use blindaug::metrics::{object_area, psnr};
use blindaug::model::{DefocusModel, Estimate, ExposureFraction, MotionBlurModel};
use blindaug::synth::{defocus::Bokeh, noise::white_band_std};
use blindaug::text::why_not_json;
use blindaug::{CameraModel, Encoded, Transfer};
use blindaug_io::{Error, Result, one_line};
use blindaug_scenes::measure::{Footage, NoiseTruth, Truth};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The largest `truth.json` that is read, bytes.
const MAX_TRUTH: u64 = 1 << 24;

/// One condition of a clip.
pub struct Condition {
    /// The clip's folder.
    pub clip: PathBuf,
    /// The folder of its frames.
    pub name: String,
    truth: Truth,
    /// The two coefficients of the noise of an encoded value I: std = readout + shot sqrt(I).
    noise: Option<[f32; 2]>,
}

/// PSNR in dB over the object's area of composites against renders with the object really there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fidelity {
    /// The PSNR of the object pasted as it is, dB.
    pub naive: f64,
    /// The PSNR of the composite with the estimated camera, dB.
    pub estimated: f64,
    /// The PSNR of the composite with the true camera, dB.
    pub oracle: f64,
}

/// All conditions of all clips in a folder.
///
/// # Errors
/// If there is no condition, or a `truth.json` cannot be read.
pub fn conditions(folder: &Path) -> Result<Vec<Condition>> {
    let listed =
        std::fs::read_dir(folder).map_err(|e| Error::new(folder, format!("it cannot be listed ({e})")))?;
    let mut clips: Vec<PathBuf> =
        listed.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.join("truth.json").is_file()).collect();
    clips.sort();
    let mut all = vec![];
    for clip in clips {
        let path = clip.join("truth.json");
        let text = blindaug_io::read_text(&path, MAX_TRUTH)?;
        let json: serde_json::Map<String, serde_json::Value> =
            serde_json::from_str(text.trim_start_matches('\u{feff}')).map_err(|e| {
                Error::new(&path, format!("is not the truth of a clip: {}", why_not_json(&text, &e)))
            })?;
        for (name, truth) in json {
            // The name becomes that of a folder that is read and of a file that is written.
            if name.is_empty()
                || name.starts_with('.')
                || name.contains(['/', '\\', ':'])
                || one_line(&name) != name
            {
                let name = one_line(&name);
                return Err(Error::new(
                    &path,
                    format!("\"{name}\" must be the plain name of a folder beside it"),
                ));
            }
            let number = |v: &serde_json::Value| v.as_f64().map(|v| v as f32);
            let pair = |of: &str, a: &str, b: &str| Some((number(&truth[of][a])?, number(&truth[of][b])?));
            let noise = pair("noise", "k_readout", "k_shot").map(|(a, b)| [a, b]);
            // Only frames with noise are those of a camera; the other folders hold truths.
            if noise.is_none()
                || name.ends_with("_with")
                || name.ends_with("_plain")
                || !clip.join(&name).is_dir()
            {
                continue;
            }
            let exposure = number(&truth["exposure"]).unwrap_or(0.0);
            let lens = pair("lens", "sigma_px_at_infinity", "focus_distance_m");
            all.push(Condition { clip: clip.clone(), name, truth: Truth { exposure, lens }, noise });
        }
    }
    if all.is_empty() {
        return Err(Error::new(
            folder,
            "there is no clip here: each needs a folder with truth.json, clean/ and a folder per condition that truth.json names",
        ));
    }
    Ok(all)
}

impl Condition {
    /// The title, `CLIP CONDITION`.
    pub fn title(&self) -> String {
        let clip = self.clip.file_name().unwrap_or_default().to_string_lossy();
        format!("{clip} {}", self.name)
    }

    fn numbers(&self, of: &str) -> Vec<u64> {
        let listed = std::fs::read_dir(self.clip.join(of)).into_iter().flatten();
        let mut numbers: Vec<u64> =
            listed.filter_map(|e| e.ok()?.file_name().to_str()?.strip_suffix(".png")?.parse().ok()).collect();
        numbers.sort_unstable();
        numbers
    }

    fn frame(&self, of: &str, number: u64) -> Result<Encoded> {
        blindaug_io::read_frame(self.clip.join(format!("{of}/{number:04}.png")))
    }

    /// Reads the frames and the truth of the condition.
    ///
    /// # Errors
    /// If a file is missing.
    pub fn read(&self) -> Result<Footage> {
        let numbers = self.numbers(&self.name);
        let geometry = |n: &u64| self.clip.join(format!("clean/{n:04}.exr"));
        let frames: Vec<Encoded> =
            numbers.iter().map(|&n| self.frame(&self.name, n)).collect::<Result<_>>()?;
        let plain = self.name.strip_suffix("_without").map(|prefix| format!("{prefix}_plain"));
        let mut noise = None;
        if let Some(plain) = plain.filter(|p| self.clip.join(p).is_dir()) {
            let truth = noise.insert(NoiseTruth::default());
            for (frame, &n) in frames.iter().zip(&numbers) {
                truth.add(frame, &self.frame(&plain, n)?);
            }
        } else if let Some([readout, plate]) = self.noise {
            let white = white_band_std();
            // 8-bit rounding adds a variance of 1/12 of a squared step.
            let rounding = (1.0 / 255.0f32).powi(2) / 12.0;
            let std = |y: f32| ((readout + plate * y.sqrt()).powi(2) + rounding).sqrt();
            noise = Some(NoiseTruth::known(|level, y| std(y) * white[level]));
        }
        Ok(Footage {
            clean: numbers.iter().map(|&n| self.frame("clean", n)).collect::<Result<_>>()?,
            inverse_depth: numbers
                .iter()
                .map(|n| blindaug_io::read_inverse_depth(geometry(n), Default::default()))
                .collect::<Result<_>>()?,
            flow: numbers.iter().map(|n| blindaug_io::read_flow(geometry(n))).collect::<Result<_>>()?,
            frames,
            truth: self.truth,
            noise,
        })
    }

    /// Composites the clip's virtual object, if it has one, without noise.
    ///
    /// # Errors
    /// If a file is missing.
    pub fn fidelity(&self, model: &CameraModel) -> Result<Option<Fidelity>> {
        let Some(prefix) = self.name.strip_suffix("_without") else { return Ok(None) };
        let (with, plain) = (format!("{prefix}_with"), format!("{prefix}_plain"));
        let numbers = self.numbers(&with);
        let (true, Some((sigma, focus))) =
            (!numbers.is_empty() && self.clip.join("virtual").is_dir(), self.truth.lens)
        else {
            return Ok(None);
        };
        let mut real = model.clone();
        real.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(self.truth.exposure)));
        real.defocus = Estimate::Known(DefocusModel::given_lens(sigma, 1.0 / focus));
        let mut sums = [0.0; 3];
        for &n in &numbers {
            let layer = blindaug_io::read_virtual_layer(self.clip.join(format!("virtual/{n:04}.exr")))?;
            let layer =
                VirtualLayer { color: layer.color, inverse_depth: layer.inverse_depth, flow: layer.flow };
            let linear = |of: &str| Ok::<_, Error>(self.frame(of, n)?.to_linear(Transfer::Srgb));
            let (local_with, local) = (linear("clean_with")?, linear("clean")?);
            let (frame, truth) = (self.frame(&plain, n)?, self.frame(&with, n)?);
            let geometry = self.clip.join(format!("clean/{n:04}.exr"));
            let depth = blindaug_io::read_inverse_depth(&geometry, Default::default())?;
            let flow = blindaug_io::read_flow(&geometry)?;
            let plate = Plate {
                inverse_depth: Some(&depth),
                flow: Some(&flow),
                with_and_without: Some((&local_with, &local)),
                ..Plate::new(&frame, n)
            };
            let area = object_area(&layer.color.0.map(|p| p[3]), 20);
            for (sum, (model, naive)) in sums.iter_mut().zip([(model, true), (model, false), (&real, false)])
            {
                let options = CompositeOptions {
                    naive,
                    no_noise: true,
                    bokeh: Some(Bokeh::Disk),
                    ..CompositeOptions::default()
                };
                let made = composite::composite(&plate, &layer, model, &options);
                let made = made.and_then(|made| psnr(&made, &truth, Some(&area)));
                *sum += made.map_err(|e| Error::new(&self.clip, e.to_string()))? / numbers.len() as f64;
            }
        }
        let [naive, estimated, oracle] = sums;
        Ok(Some(Fidelity { naive, estimated, oracle }))
    }
}
