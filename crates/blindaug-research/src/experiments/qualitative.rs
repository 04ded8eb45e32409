//! The paper's results as pictures: scenes of its kinds with the object pasted, with our composite, and with the object really there.

use super::Scale;
use crate::fidelity::Fidelity;
use crate::filming::write_video;
use crate::run::{Findings, Pictures, Run};
use crate::sceneries::{Scenery, Take};
use crate::shot::Shot;
use crate::statistics::mean;
use crate::table::{Cell, Table};
use blindaug::composite::{CompositeOptions, composite};
use blindaug::synth::defocus::Bokeh;
use blindaug::{Encoded, Raster};
use blindaug_io::{Error, Result, VideoCoding, VideoWriter, write_png};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The name of the experiment's folder.
pub const NAME: &str = "qualitative";

/// The pictures of a frame, in the order in which they stand beside each other.
const SHOWN: [&str; 3] = ["naive", "ours", "truth"];

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Outcome {
    name: String,
    about: String,
    /// The likeness of the pasted object and of our composite to the truth, without noise.
    fidelity: [Fidelity; 2],
    /// What is unknown of the camera, and why.
    unknown: Vec<String>,
    /// Whether a video was written.
    has_video: bool,
}

/// Runs the experiment on the first sceneries.
///
/// # Errors
/// If a file cannot be written.
pub fn run(run: &Run, scale: Scale) -> Result<Findings> {
    let Scale { scenes, frames, size } = scale;
    let folder = run.folder(NAME)?;
    let cases = (0..scenes as usize)
        .map(|i| (format!("scene{i}"), Take { scenery: i, seed: run.seed(), frames, size }))
        .collect();
    let outcomes = run.cases(NAME, cases, |case| outcome(case, &folder))?;
    let outcomes: Vec<Outcome> = outcomes.into_iter().map(|o| o.1).collect();
    let rows = outcomes.iter().map(|o| {
        let [naive, ours] = o.fidelity.map(|f| Cell::Number(f.psnr, 2));
        let unknown = if o.unknown.is_empty() { "nothing".into() } else { o.unknown.join("; ") };
        vec![Cell::text(&o.name), naive, ours, Cell::text(unknown)]
    });
    let mut rows: Vec<Vec<Cell>> = rows.collect();
    let of = |k: usize| Cell::spread(mean(outcomes.iter().map(|o| o.fidelity[k].psnr)), 2);
    rows.push(vec![Cell::text("mean"), of(0), of(1), Cell::Empty]);
    let table = Table {
        name: "psnr".into(),
        caption: format!(
            "PSNR over the object's area against the middle one of {frames} frames with the object really there, without noise, dB."
        ),
        head: ["scene", "naive", "ours", "unknown of the camera"].map(String::from).into(),
        rows,
    };
    let pictures = outcomes.iter().map(|o| Pictures {
        title: format!("{}: {}", o.name, o.about),
        files: SHOWN.map(|what| (what.to_owned(), format!("{}-{what}.png", o.name).into())).into(),
    });
    let videos = outcomes.iter().filter(|o| o.has_video);
    Ok(Findings {
        name: NAME.into(),
        title: "Qualitative results".into(),
        text: vec![
            "Scenes of the kinds of the paper's results, filmed by physics: the object pasted as it is; by the camera that is estimated \
             from the footage alone; and really there. The middle frame is shown; videos, where an encoder is there, lie beside."
                .into(),
        ],
        tables: vec![table],
        pictures: pictures.collect(),
        files: videos.map(|o| (format!("{} (video)", o.name), format!("{}.mp4", o.name).into())).collect(),
        ..Findings::default()
    })
}

fn outcome(case: &Take, folder: &Path) -> Result<Outcome> {
    let fails = |e: blindaug::Error| Error::new(folder, e.to_string());
    let middle = case.middle();
    let Scenery { name, about, scene, object, device, .. } = case.scenery();
    let video = folder.join(format!("{name}.mp4"));
    let shot = Shot::film(&scene, &object, &device, (case.frames, &[middle]), case.seed, &video)?;
    let with = scene.clone().with(object.clone());
    // The noise of the true pictures is another than that of the footage.
    let truths = Shot::film(&with, &object, &device, (case.frames, &[]), case.seed + 1, &video)?;
    let model = shot.metric(&shot.estimate().map_err(fails)?);
    let of = |naive| shot.fidelity(|c| shot.composite(c, &model, naive)).map_err(fails);
    let fidelity = [of(true)?, of(false)?];
    let mut side_by_side = vec![];
    for t in 0..case.frames as usize {
        let layer = scene.layer(&object, t as f32).into();
        let plate = shot.plate(t, &shot.footage.frames[t]);
        let made = |naive| {
            let options = CompositeOptions {
                naive,
                no_noise: naive,
                bokeh: Some(Bokeh::Disk),
                seed: case.seed,
                unclipped: false,
            };
            composite(&plate, &layer, &model, &options).map_err(fails)
        };
        let pictures = [made(true)?, made(false)?, truths.footage.frames[t].clone()];
        if t == middle {
            for (what, picture) in SHOWN.iter().zip(&pictures) {
                write_png(folder.join(format!("{name}-{what}.png")), picture)?;
            }
        }
        side_by_side.push(beside(&pictures));
    }
    // Without an encoder there are pictures all the same.
    let has_video = VideoWriter::is_available();
    if has_video {
        write_video(&side_by_side, VideoCoding::H264 { crf: 14 }, &video)?;
    }
    let unknown = [
        ("noise", model.noise.why_unknown()),
        ("motion blur", model.motion_blur.why_unknown()),
        ("defocus", model.defocus.why_unknown()),
    ];
    let unknown = unknown.into_iter().filter_map(|(what, why)| Some(format!("{what} ({})", why?.sentence)));
    Ok(Outcome { name: name.into(), about: about.into(), fidelity, unknown: unknown.collect(), has_video })
}

/// The pictures beside each other.
fn beside(pictures: &[Encoded; 3]) -> Encoded {
    let (w, h) = pictures[0].0.size();
    Encoded(Raster::from_fn(w * pictures.len(), h, |x, y| pictures[x / w].0.at(x % w, y)))
}
