//! The paper's validation: how far estimates lie from the truth, on scenes that are made here, on rendered clips, and on real pixels whose
//! exposure or noise is known.

pub mod clips;
mod estimate;
mod findings;
pub mod real;
pub mod still;

use crate::filming::{Filming, coded};
use crate::run::Run;
use blindaug::fit::Estimation;
use blindaug::synth::{self, defocus::Bokeh};
use blindaug::{Encoded, Transfer};
use blindaug_io::{Error, Result, VideoCoding, write_png};
use blindaug_pipeline::{Networks, Observer};
use blindaug_scenes::camera::{Camera, Setting};
use blindaug_scenes::measure::{Footage, Given, Measured, Truth};
use blindaug_scenes::scene::Scene;
use clips::{Condition, Fidelity};
pub use estimate::{given_with, measure};
pub use findings::findings;
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::Path};

/// The name of the experiment's folder.
pub const NAME: &str = "validation";

/// What is to be measured.
pub struct Job {
    /// The number of scenes; each is filmed with every setting by two cameras, the project's synthesis and one
    /// of physics, and with every strength of the noise by a third, whose noise is that of the paper's validation.
    pub scenes: u64,
    /// The number of frames of each scene.
    pub frames: u64,
    /// One small scene of four frames and few settings, instead.
    pub quick: bool,
    /// The constant rate factors of H.264 with which the frames of the camera of physics are also coded; needs the ffmpeg program.
    pub coded: Vec<u8>,
    /// The settings of the paper alone: motion blur, defocus or noise, not several at once and no shaking hand.
    pub paper_alone: bool,
    /// The kinds of evidence to give; those that need networks are left out where there are none.
    pub given: Vec<Given>,
    /// Rendered clips.
    pub clips: Vec<Condition>,
    /// The networks' names, as the user gave them.
    pub networks: Vec<String>,
}

/// Width and height of the pictures of the scenes, px.
const SIZE: (usize, usize) = (512, 384);
const QUICK_SIZE: (usize, usize) = (320, 240);

/// The paper's experiments.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Experiment {
    /// Exposures from 0.1 to 1 with a pinhole camera.
    MotionBlur,
    /// Several lenses with an exposure of 0.
    Defocus,
    /// Noise without blur.
    Noise,
    /// All three distortions.
    All,
    /// Three exposures with a pinhole camera that a shaking hand holds.
    Shaking,
    /// A rendered clip.
    Clip,
}

/// One measurement: a scene or a clip, a camera with a setting, and networks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// The case's name, which is also that of its file.
    pub name: String,
    /// The experiment of which the case is a part.
    pub experiment: Experiment,
    /// The camera; `None`: a rendered clip.
    pub camera: Option<Camera>,
    /// The constant rate factor of the video as which the frames are coded before the estimation; `None`: they are not coded.
    #[serde(default)]
    pub coded: Option<u8>,
    /// The number of the scene.
    pub scene: u64,
    /// The number of frames.
    pub frames: u64,
    /// Width and height of the frames, px.
    pub size: (usize, usize),
    /// The setting of the camera.
    pub setting: Option<Setting>,
    /// The networks, as the user named them.
    pub networks: Vec<String>,
    /// The kinds of evidence that are given.
    pub given: Vec<Given>,
}

/// A case with its results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The case.
    pub case: Case,
    /// The true camera.
    pub truth: Truth,
    /// The measurements, one for each kind of evidence given.
    pub measured: Vec<Measured>,
    /// The fidelity of composites of clips with a virtual object, with depth given.
    pub fidelity: Option<Fidelity>,
}

impl Outcome {
    /// Whether pictures of the case are written: those of the first scene with all distortions, with depth given.
    fn has_pictures(&self) -> bool {
        let c = &self.case;
        c.scene == 1
            && c.experiment == Experiment::All
            && c.coded.is_none()
            && c.given.contains(&Given::Depth)
    }

    /// The name of the file of one of the case's pictures.
    fn picture(&self, what: &str) -> String {
        format!("{}-{what}.png", self.case.name)
    }
}

/// Measures all cases of a job that an earlier run has not measured, and returns them all; fewer if the observer stops the run.
///
/// # Errors
/// If a clip cannot be read or a file cannot be written.
pub fn run(run: &Run, job: &Job, networks: &mut Networks) -> Result<Vec<Outcome>> {
    let folder = run.folder(NAME)?;
    let given: Vec<Given> = given_with(networks).into_iter().filter(|g| job.given.contains(g)).collect();
    let own = own_cases(job, &given);
    let clips = job.clips.iter().map(|condition| clip_case(condition, &job.networks, &given));
    let cases = own.into_iter().chain(clips).map(|c| (c.name.clone(), c)).collect();
    let mut sharp = SharpScene::default();
    let outcomes = run.cases(NAME, cases, |case| {
        let condition = job.clips.iter().find(|c| case.camera.is_none() && clip_name(c) == case.name);
        match condition {
            Some(condition) => measure_clip(case, condition, networks, run.observer()),
            None => measure_own(case, &mut sharp, networks, &folder, run.observer()),
        }
    })?;
    Ok(outcomes.into_iter().map(|(_, outcome)| outcome).collect())
}

/// The cases on scenes that are made here, with the settings of the paper's validation, over the ranges of real cameras.
fn own_cases(job: &Job, given: &[Given]) -> Vec<Case> {
    // Blur at infinity (px) and focus (m); scenes reach from about 0.9 to 8 m.
    const LENSES: [(f32, f32); 5] = [(1.5, 1.5), (3.0, 2.0), (1.0, 4.0), (6.0, 1.2), (8.5, 0.9)];
    let noise = |i: usize| 0.002 * 25f32.powf(i as f32 / 9.0);
    let readout = |i: usize| 0.15 + 0.07 * i as f32;
    let of =
        |exposure, lens, noise, readout| Setting { exposure, lens, noise, readout, rolling_shutter: 0.0 };
    let mut settings: Vec<(Experiment, usize, Setting)> = vec![];
    // The strengths of the noise are in another order than the exposures and the lenses.
    settings.extend((0..10).map(|i| {
        (Experiment::MotionBlur, i, of(0.1 * (i + 1) as f32, None, noise(3 * i % 10), readout(7 * i % 10)))
    }));
    settings
        .extend((0..5).map(|i| {
            (Experiment::Defocus, i, of(0.0, Some(LENSES[i]), noise((4 * i + 1) % 10), readout(i)))
        }));
    settings.extend((0..10).map(|i| (Experiment::Noise, i, of(0.0, None, noise(i), readout(7 * i % 10)))));
    settings.extend((0..5).map(|i| {
        let exposure = [0.5, 0.2, 0.9, 0.35, 0.7][i];
        (Experiment::All, i, of(exposure, Some(LENSES[i]), noise((3 * i + 2) % 10), readout(i)))
    }));
    let (scenes, frames, size) = if job.quick { (1, 4, QUICK_SIZE) } else { (job.scenes, job.frames, SIZE) };
    settings.extend((0..3).map(|i| {
        let exposure = [0.25, 0.5, 0.9][i];
        (Experiment::Shaking, i, of(exposure, None, noise((4 * i + 1) % 10), readout(i)))
    }));
    if job.paper_alone {
        settings
            .retain(|(e, ..)| [Experiment::MotionBlur, Experiment::Defocus, Experiment::Noise].contains(e));
    }
    if job.quick {
        settings.retain(|(e, i, _)| *i == if *e == Experiment::MotionBlur { 4 } else { 1 });
    }
    let mut cases = vec![];
    for scene in 1..=scenes {
        for (experiment, i, setting) in &settings {
            let cameras =
                [(Camera::Synthesis, None), (Camera::Heteroscedastic, None), (Camera::Physics, None)];
            // What was filmed is coded next, so that nothing is filmed twice.
            let coded = job.coded.iter().map(|&crf| (Camera::Physics, Some(crf)));
            for (camera, coded) in cameras.into_iter().chain(coded) {
                // A coder takes away the noise that this experiment measures.
                if coded.is_some() && *experiment == Experiment::Noise {
                    continue;
                }
                // It blurs as the synthesis does.
                if camera == Camera::Heteroscedastic && *experiment != Experiment::Noise {
                    continue;
                }
                // The synthesis blurs along straight paths.
                if camera == Camera::Synthesis && *experiment == Experiment::Shaking {
                    continue;
                }
                let what = match experiment {
                    Experiment::MotionBlur => "motion-blur",
                    Experiment::Defocus => "defocus",
                    Experiment::Noise => "noise",
                    Experiment::All | Experiment::Clip => "all",
                    Experiment::Shaking => "shaking",
                };
                let by = file_name(camera);
                cases.push(Case {
                    name: match coded {
                        Some(crf) => format!("scene{scene}-{by}-crf{crf}-{what}-{}", i + 1),
                        None => format!("scene{scene}-{by}-{what}-{}", i + 1),
                    },
                    experiment: *experiment,
                    camera: Some(camera),
                    coded,
                    scene,
                    frames,
                    size,
                    setting: Some(*setting),
                    networks: job.networks.clone(),
                    given: given.to_vec(),
                });
            }
        }
    }
    cases
}

/// The camera as a part of a file's name.
fn file_name(camera: Camera) -> &'static str {
    match camera {
        Camera::Synthesis => "synthesis",
        Camera::Heteroscedastic => "heteroscedastic",
        Camera::Physics => "physics",
    }
}

fn clip_name(condition: &Condition) -> String {
    format!("clip-{}", condition.title().replace(' ', "-"))
}

fn clip_case(condition: &Condition, networks: &[String], given: &[Given]) -> Case {
    Case {
        name: clip_name(condition),
        experiment: Experiment::Clip,
        camera: None,
        coded: None,
        scene: 0,
        frames: 0,
        size: (0, 0),
        setting: None,
        networks: networks.to_vec(),
        given: given.to_vec(),
    }
}

/// The scene that was filmed last: its sharp frames are the same for all settings. The key is the scene's number and whether a hand shakes.
#[derive(Default)]
struct SharpScene(Option<((u64, bool), Filming)>);

impl SharpScene {
    fn get(&mut self, case: &Case) -> &mut Filming {
        let key = (case.scene, case.experiment == Experiment::Shaking);
        if self.0.as_ref().is_none_or(|s| s.0 != key) {
            let steady = Scene::new(case.scene, case.size);
            let scene = if key.1 { steady.shaken(case.scene) } else { steady };
            self.0 = Some((key, Filming::new(scene, case.frames)));
        }
        &mut self.0.as_mut().expect("it was just made").1
    }
}

fn measure_own(
    case: &Case,
    sharp: &mut SharpScene,
    networks: &mut Networks,
    pictures: &Path,
    observer: &dyn Observer,
) -> Result<Outcome> {
    let (Some(camera), Some(setting)) = (case.camera, case.setting) else {
        return Err(Error::new(pictures, "a case without a camera"));
    };
    let filming = sharp.get(case);
    filming.film(camera, setting, case.scene).map_err(|e| Error::new(pictures, e.to_string()))?;
    let footage = &mut filming.footage;
    if let Some(crf) = case.coded {
        footage.frames =
            coded(&footage.frames, VideoCoding::H264 { crf }, &pictures.join(format!("{}.mp4", case.name)))?;
        // The coder has changed the noise, so the sensor's noise is no longer the truth.
        footage.noise = None;
    }
    let outcome = Outcome { case: case.clone(), truth: footage.truth, measured: vec![], fidelity: None };
    let mut measured = vec![];
    for &given in &case.given {
        if case.coded.is_some() && ![Given::DepthAndFlow, Given::Depth, Given::Nothing].contains(&given) {
            continue;
        }
        let (m, estimation) =
            measure(footage, given, networks, observer).map_err(|e| Error::new(pictures, e.to_string()))?;
        measured.push(m);
        if given == Given::Depth && outcome.has_pictures() {
            write_pictures(&outcome, footage, &estimation, pictures)?;
        }
    }
    Ok(Outcome { measured, ..outcome })
}

/// Writes the frame, the clean frame as the estimated camera would film it, and their difference.
fn write_pictures(
    outcome: &Outcome,
    footage: &Footage,
    estimation: &Estimation,
    pictures: &Path,
) -> Result<()> {
    let t = footage.frames.len() / 2;
    let made = |no_noise: bool| {
        synth::distort_frame(
            &footage.clean[t].to_linear(Transfer::Srgb),
            &estimation.model,
            Some(&footage.inverse_depth[t]),
            Some(&footage.flow[t]),
            &synth::SynthesisOptions { bokeh: Some(Bokeh::Disk), no_noise, seed: 1, unclipped: false },
            t as u64,
        )
        .map_err(|e| Error::new(pictures, e.to_string()))
    };
    write_png(pictures.join(outcome.picture("synthesised")), &made(false)?)?;
    let without_noise = made(true)?;
    write_png(pictures.join(outcome.picture("filmed")), &footage.frames[t])?;
    let (filmed, made) = (&footage.frames[t].0, &without_noise.0);
    let error = blindaug::Raster::from_fn(filmed.width(), filmed.height(), |x, y| {
        let (a, b) = (filmed.at(x, y), made.at(x, y));
        std::array::from_fn(|c| (0.5 + 2.0 * (a[c] - b[c])).clamp(0.0, 1.0))
    });
    write_png(pictures.join(outcome.picture("error")), &Encoded(error))?;
    Ok(())
}

fn measure_clip(
    case: &Case,
    condition: &Condition,
    networks: &mut Networks,
    observer: &dyn Observer,
) -> Result<Outcome> {
    let footage = condition.read()?;
    let mut measured = vec![];
    let mut fidelity = None;
    for &given in &case.given {
        let (m, estimation) = measure(&footage, given, networks, observer)
            .map_err(|e| Error::new(&condition.clip, e.to_string()))?;
        measured.push(m);
        if given == Given::Depth {
            fidelity = condition.fidelity(&estimation.model)?;
        }
    }
    Ok(Outcome { case: case.clone(), truth: footage.truth, measured, fidelity })
}

/// A row of the table: the measurements with the same camera and the same evidence given.
#[derive(Default)]
struct Summary {
    /// The errors |estimated - true| of the exposure in the cases with motion blur alone.
    exposure: Vec<f32>,
    /// The errors of the exposure in the cases with all three distortions.
    exposure_of_all: Vec<f32>,
    /// The estimates of the exposure in the cases without motion blur.
    exposure_where_none: Vec<f32>,
    /// The error and the mean of the defocus std in the cases with defocus alone, px.
    blur: Vec<[f32; 2]>,
    blur_of_all: Vec<[f32; 2]>,
    /// The errors of the defocus std in the cases without defocus, px.
    blur_where_none: Vec<f32>,
    /// The relative errors of the inverse depth in focus.
    focus: Vec<f32>,
    noise: Vec<f32>,
    noise_finest: Vec<f32>,
    /// The number of intervals that hold the truth, and that of all intervals.
    covered: BTreeMap<&'static str, (usize, usize)>,
    /// The number of distortions that are unknown though they could be known, and that of all that could be known.
    unknown: (usize, usize),
    /// For each case, the error of the exposure of all frames, and the median of the errors of single frames.
    against_single: Vec<[f32; 2]>,
}

impl Summary {
    fn of<'a>(outcomes: impl Iterator<Item = (&'a Outcome, &'a Measured)>) -> Self {
        let mut s = Self::default();
        for (outcome, m) in outcomes {
            s.add(outcome, m);
        }
        s
    }

    fn add(&mut self, outcome: &Outcome, m: &Measured) {
        let truth = outcome.truth;
        let both =
            outcome.case.experiment == Experiment::All || (truth.exposure > 0.0 && truth.lens.is_some());
        let mut cover = |what, covered: bool| {
            let count = self.covered.entry(what).or_default();
            count.0 += usize::from(covered);
            count.1 += 1;
        };
        if truth.exposure > 0.0 {
            self.unknown.1 += 1;
            match m.exposure {
                Some(e) => {
                    let error = (e.estimate - truth.exposure).abs();
                    if both {
                        self.exposure_of_all.push(error)
                    } else {
                        self.exposure.push(error)
                    }
                    cover("exposure", e.covers(truth.exposure));
                    let mut singles: Vec<f32> =
                        m.exposure_per_frame.iter().map(|v| (v - truth.exposure).abs()).collect();
                    singles.sort_by(f32::total_cmp);
                    if singles.len() > 2 {
                        self.against_single.push([error, singles[singles.len() / 2]]);
                    }
                }
                None => self.unknown.0 += 1,
            }
        } else if let Some(e) = m.exposure {
            self.exposure_where_none.push(e.estimate);
        }
        if let Some((_, focus)) = truth.lens {
            self.unknown.1 += 1;
            match &m.lens {
                Some(l) => {
                    let error = [l.error_px, l.mean_px];
                    if both {
                        self.blur_of_all.push(error)
                    } else {
                        self.blur.push(error)
                    }
                    if l.metric {
                        self.focus.push((l.focus_inverse_depth.estimate * focus - 1.0).abs());
                        let sigma = truth.lens.map_or(0.0, |l| l.0);
                        cover(
                            "lens",
                            l.sigma_px_at_infinity.covers(sigma) && l.focus_inverse_depth.covers(1.0 / focus),
                        );
                    }
                }
                None => self.unknown.0 += 1,
            }
        } else if let Some(l) = &m.lens {
            self.blur_where_none.push(l.error_px);
        }
        self.noise.extend(m.noise_median);
        self.noise_finest.extend(m.noise.first());
    }
}

#[cfg(test)]
mod tests;
