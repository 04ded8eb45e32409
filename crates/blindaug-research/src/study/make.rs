//! The stimuli of the study: stills and clips of each scene by each method, and with the object really there.

use super::answers::{REAL, Task};
use super::questionnaire::{Media, MediaFormat, Stimulus, questionnaire};
use crate::baselines::Method;
use crate::baselines::made::{Found, Ground, with_marker};
use crate::filming::write_video;
use crate::run::Run;
use crate::sceneries::{COUNT, Scenery, Take};
use crate::shot::Shot;
use blindaug::Encoded;
use blindaug::composite::{CompositeOptions, VirtualLayer};
use blindaug::synth::defocus::Bokeh;
use blindaug_io::{Error, Result, VideoCoding, write_atomically, write_png};
use blindaug_pipeline::Networks;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The folder of the stimuli.
const NAME: &str = "stimuli";

/// The methods that are compared, those of the paper.
pub const METHODS: [Method; 5] =
    [Method::Naive, Method::OkumuraLike, Method::OkumuraPlusLike, Method::LensNetLike, Method::Ours];

/// How often a clip's frames are shown forth and back: 25 frames, four times, are 8 s at 25 frames a second.
const TIMES: usize = 4;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Case {
    take: Take,
    with_clips: bool,
}

/// The files of a scene, by method.
type Files = Vec<(String, Vec<(Task, PathBuf)>)>;

/// The kit.
pub struct Kit {
    /// The page with the questions.
    pub page: PathBuf,
    /// The number of stimuli.
    pub stimuli: usize,
    /// The size of the page, bytes.
    pub bytes: u64,
}

/// Makes the stimuli that are not there yet, and the questionnaire; `None` if the observer stopped the run. Without `with_clips`, for
/// which an encoder is needed, there are only stills.
///
/// # Errors
/// If a file cannot be written.
pub fn make(run: &Run, quick: bool, with_clips: bool) -> Result<Option<Kit>> {
    let (frames, size) = if quick { (6, (256, 192)) } else { (25, (640, 480)) };
    let folder = run.folder(NAME)?;
    let cases = (0..COUNT).map(|i| {
        (format!("scene{i}"), Case { take: Take { scenery: i, seed: run.seed(), frames, size }, with_clips })
    });
    let mut networks = Networks::default();
    let outcomes = run.cases(NAME, cases.collect(), |case| files_of(case, &folder, &mut networks))?;
    if run.is_stopped() {
        return Ok(None);
    }
    let mut stimuli = vec![];
    let mut list = String::from("file,task,scene,method\n");
    for (scene, (_, files)) in outcomes.iter().enumerate() {
        for (method, files) in files {
            for (task, name) in files {
                let path = folder.join(name);
                let bytes = std::fs::read(&path).map_err(|e| Error::cannot_read(&path, &e))?;
                let format = if *task == Task::Identification { MediaFormat::Png } else { MediaFormat::Mp4 };
                // A participant who looks into the page must not find a scene's name.
                let scene = (scene + 1).to_string();
                list += &format!("{},{},{scene},{method}\n", name.display(), task.name());
                stimuli.push(Stimulus {
                    task: *task,
                    scene,
                    method: method.clone(),
                    media: Media { format, bytes },
                });
            }
        }
    }
    let page = run.path("questionnaire.html");
    let html = questionnaire("Real or virtual?", &stimuli, run.seed());
    write_atomically(&page, |partial| std::fs::write(partial, &html))?;
    write_atomically(run.path("stimuli.csv"), |partial| std::fs::write(partial, &list))?;
    Ok(Some(Kit { page, stimuli: stimuli.len(), bytes: html.len() as u64 }))
}

fn files_of(case: &Case, folder: &Path, networks: &mut Networks) -> Result<Files> {
    let fails = |e: blindaug::Error| Error::new(folder, e.to_string());
    let middle = case.take.middle();
    let Scenery { scene, object, device, depth_m, .. } = case.take.scenery();
    let (scene, marker) = with_marker(scene, &object, depth_m, middle as f32);
    let film = |scene, seed| Shot::film(scene, &object, &device, (case.take.frames, &[]), seed, folder);
    let shot = film(&scene, case.take.seed)?;
    let real = film(&scene.clone().with(object.clone()), case.take.seed + 1)?;
    let ground = Ground {
        shot: &shot,
        scene: &scene,
        marker: marker.as_ref(),
        setting: &device.setting,
        scenery: case.take.scenery,
    };
    let layers: Vec<VirtualLayer> =
        (0..case.take.frames).map(|t| scene.layer(&object, t as f32).into()).collect();
    let written = |method: &str, frames: &[Encoded]| -> Result<(String, Vec<(Task, PathBuf)>)> {
        let name = format!("{}-{}", case.take.scenery + 1, method.to_lowercase());
        let still = PathBuf::from(format!("{name}.png"));
        write_png(folder.join(&still), &frames[middle])?;
        let mut files = vec![(Task::Identification, still)];
        if case.with_clips {
            let clip = PathBuf::from(format!("{name}.mp4"));
            let round = frames.iter().chain(frames.iter().rev());
            let shown = (0..TIMES).flat_map(|_| round.clone());
            write_video(shown, VideoCoding::H264 { crf: 18 }, &folder.join(&clip))?;
            files.push((Task::Consistency, clip));
        }
        Ok((method.to_owned(), files))
    };
    let mut all = vec![written(REAL, &real.footage.frames)?];
    for method in METHODS {
        let found: Found = ground.estimate(method, networks).map_err(fails)?;
        let options = CompositeOptions {
            bokeh: Some(Bokeh::Disk),
            seed: case.take.seed,
            ..CompositeOptions::default()
        };
        let frames: Vec<Encoded> = layers
            .iter()
            .enumerate()
            .map(|(t, layer)| found.composite(&shot.plate(t, &shot.footage.frames[t]), layer, &options))
            .collect::<blindaug::Result<_>>()
            .map_err(fails)?;
        all.push(written(method.name(), &frames)?);
    }
    Ok(all)
}
