//! Correctness across cameras: four cameras film the same scenes; the model of each is tried on the footage of each.

use super::{Scale, halves};
use crate::fidelity::Fidelity;
use crate::run::{Findings, Run};
use crate::shot::{Device, Shot, ball};
use crate::statistics::mean;
use crate::table::{Cell, Table};
use blindaug::CameraModel;
use blindaug::model::SharpeningModel;
use blindaug_io::{Error, Result, VideoCoding};
use blindaug_scenes::camera::Setting;
use blindaug_scenes::measure::{median, noise_errors};
use blindaug_scenes::scene::{Scene, TextureKind};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The name of the experiment's folder.
pub const NAME: &str = "cameras";

/// The cameras, which differ as the paper's do.
fn devices(width: usize) -> [Device; 4] {
    let lens = |sigma: f32, focus: f32| Some((sigma * width as f32 / 512.0, focus));
    let setting = |exposure, lens, noise, rolling_shutter| Setting {
        exposure,
        lens,
        noise,
        readout: 0.2,
        rolling_shutter,
    };
    let phone = Device::plain(
        "phone",
        "a small sensor, sharpening, a short exposure, H.264",
        setting(0.2, lens(0.8, 1.5), 0.008, 0.3),
    );
    let webcam = Device::plain(
        "webcam",
        "a long exposure, a rolling shutter, motion JPEG with half the chroma",
        setting(0.9, lens(1.0, 0.8), 0.015, 0.7),
    );
    [
        Device {
            sharpening: Some(SharpeningModel::given(0.8, 1.0)),
            coding: Some(VideoCoding::H264 { crf: 18 }),
            ..phone
        },
        Device::plain("compact", "strong noise", setting(0.5, lens(1.8, 2.5), 0.03, 0.0)),
        Device::plain("f/1.8", "an interchangeable lens at f/1.8", setting(0.4, lens(6.0, 1.0), 0.005, 0.0)),
        Device { coding: Some(VideoCoding::Mjpeg { scale: 4 }), ..webcam },
    ]
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Case {
    scene: u64,
    frames: u64,
    size: (usize, usize),
    cameras: Vec<String>,
}

/// The results on one scene, as `[footage][model]`.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Outcome {
    /// The estimated camera of each footage.
    models: Vec<CameraModel>,
    /// Composites by each camera's model; last, the object pasted as it is.
    fidelity: Vec<Vec<Fidelity>>,
    /// The median over octaves, channels and luminances of |model's std of the noise / true std - 1|; `None`: unknown.
    noise: Vec<Vec<Option<f32>>>,
}

/// Runs the experiment. `footage` are real clips, each of another camera.
///
/// # Errors
/// If a file cannot be written, or there is no ffmpeg program for the coders.
pub fn run(run: &Run, scale: Scale, footage: &[PathBuf]) -> Result<Findings> {
    let Scale { scenes, frames, size } = scale;
    let devices = devices(size.0);
    let folder = run.folder(NAME)?;
    let names: Vec<String> = devices.iter().map(|d| format!("{d:?}")).collect();
    let cases = (0..scenes)
        .map(|i| (format!("scene{i}"), Case { scene: run.seed() + i, frames, size, cameras: names.clone() }))
        .collect();
    let outcomes = run.cases(NAME, cases, |case| {
        let fails = |e: blindaug::Error| Error::new(NAME, e.to_string());
        let middle = (case.frames / 2) as usize;
        let found = (0..).find_map(|i| {
            let number = case.scene + 100 * i;
            let scene = Scene::new(number, case.size);
            let radius = 0.08 * case.size.0 as f32;
            let object = ball(&scene, middle as f32, (1.9, radius), TextureKind::Bricks, number)?;
            Some((scene, object))
        });
        let (scene, object) = found.expect("some scene has a free place");
        let mut shots = vec![];
        let mut models = vec![];
        for device in &devices {
            let video = folder.join(format!("scene{}-{}.avi", case.scene, device.name.replace('/', "")));
            let shot = Shot::film(&scene, &object, device, (case.frames, &[middle]), case.scene, &video)?;
            models.push(shot.metric(&shot.estimate().map_err(fails)?));
            shots.push(shot);
        }
        let mut outcome = Outcome { models: models.clone(), fidelity: vec![], noise: vec![] };
        for shot in &shots {
            let mut row = vec![];
            for model in &models {
                row.push(shot.fidelity(|c| shot.composite(c, model, false)).map_err(fails)?);
            }
            row.push(shot.fidelity(|c| shot.composite(c, &models[0], true)).map_err(fails)?);
            outcome.fidelity.push(row);
            let error = |model: &CameraModel| {
                let noise = model.noise.known()?;
                median(noise_errors(noise, shot.footage.noise.as_ref()?).into_iter().map(|e| e.1).collect())
            };
            outcome.noise.push(models.iter().map(error).collect());
        }
        Ok(outcome)
    })?;
    let mut findings = findings(&devices, &outcomes.into_iter().map(|o| o.1).collect::<Vec<_>>(), frames);
    if let Some((tables, said)) = halves::tables(run, footage)? {
        findings.tables.extend(tables);
        findings.text.push(said);
    }
    Ok(findings)
}

fn findings(devices: &[Device], outcomes: &[Outcome], frames: u64) -> Findings {
    let n = devices.len();
    let head = || {
        let of = devices.iter().map(|d| format!("footage of {}", d.name));
        ["model of".to_owned()].into_iter().chain(of).collect()
    };
    let mut tables = vec![];
    let mut text = vec![format!(
        "{} scenes of {frames} frames, each filmed by four cameras: {}. The model of each is estimated from its own footage and nothing \
         else, and composites a ball into the footage of each camera, which is compared with the picture in which the ball is really \
         there. Noise is left out of both pictures, and compared in a table of its own.",
        outcomes.len(),
        devices.iter().map(|d| format!("{} ({})", d.name, d.about)).collect::<Vec<_>>().join("; ")
    )];
    for (k, measure) in Fidelity::NAMES.into_iter().enumerate() {
        let value = |footage: usize, model: usize| {
            mean(outcomes.iter().filter_map(|o| Some(o.fidelity.get(footage)?.get(model)?.values()[k])))
        };
        let rows: Vec<Vec<Cell>> = (0..=n)
            .map(|model| {
                let name = devices.get(model).map_or("naive", |d| d.name);
                let cells = (0..n).map(|footage| Cell::spread(value(footage, model), Fidelity::DIGITS[k]));
                [Cell::text(name)].into_iter().chain(cells).collect()
            })
            .collect();
        let sign = if Fidelity::LARGER_IS_BETTER[k] { 1.0 } else { -1.0 };
        let of =
            |footage: usize, model: usize| sign * value(footage, model).map_or(f64::NEG_INFINITY, |m| m.mean);
        text.push(verdict(devices, measure, &of));
        let worse: Vec<&str> = (0..n).filter(|&f| of(f, n) > of(f, f)).map(|f| devices[f].name).collect();
        if !worse.is_empty() {
            text.push(format!(
                "By {measure}, the object pasted as it is comes nearer yet on: {}.",
                worse.join(", ")
            ));
        }
        tables.push(Table {
            name: measure.split([',', ' ']).next().unwrap_or(measure).to_lowercase(),
            caption: format!("{measure} over the object, by the model of one camera on the footage of another: mean over the scenes."),
            head: head(),
            rows,
        });
    }
    let noise = |footage: usize, model: usize| {
        mean(outcomes.iter().filter_map(|o| Some(100.0 * f64::from((*o.noise.get(footage)?.get(model)?)?))))
    };
    text.push(verdict(devices, "noise", &|footage, model| {
        -noise(footage, model).map_or(f64::INFINITY, |m| m.mean)
    }));
    let rows = (0..n).map(|model| {
        let cells = (0..n).map(|footage| Cell::spread(noise(footage, model), 0));
        [Cell::text(devices[model].name)].into_iter().chain(cells).collect()
    });
    tables.push(Table {
        name: "noise".into(),
        caption: "Error of the model's noise std against the noise of the footage, %: the median over octaves, channels and luminances, \
                  its mean over the scenes. Of coded footage, what the coder lost counts as noise too."
            .into(),
        head: head(),
        rows: rows.collect(),
    });
    tables.push(recovered(devices, outcomes));
    Findings {
        name: NAME.into(),
        title: "Correctness across cameras".into(),
        text,
        tables,
        ..Findings::default()
    }
}

/// Whether each camera's own model is the best on its footage; `of(footage, model)` is larger for what is better.
fn verdict(devices: &[Device], measure: &str, of: &dyn Fn(usize, usize) -> f64) -> String {
    let all = 0..devices.len();
    let best = |footage: usize| all.clone().max_by(|&a, &b| of(footage, a).total_cmp(&of(footage, b)));
    let lost: Vec<&str> = all.clone().filter(|&f| best(f) != Some(f)).map(|f| devices[f].name).collect();
    match lost.as_slice() {
        [] => format!("By {measure}, each camera's own model is the best of the four on its footage."),
        _ => format!(
            "By {measure}, another camera's model is better than the own one on: {}.",
            lost.join(", ")
        ),
    }
}

/// The recovered cameras beside the true ones.
fn recovered(devices: &[Device], outcomes: &[Outcome]) -> Table {
    let rows = devices.iter().enumerate().map(|(i, d)| {
        let models = || outcomes.iter().filter_map(move |o| o.models.get(i));
        let of = |value: &dyn Fn(&CameraModel) -> Option<f32>, digits| {
            Cell::spread(mean(models().filter_map(|m| Some(f64::from(value(m)?)))), digits)
        };
        // The blur at these distances says more than a lens's two numbers, which can change together.
        let blur = |m: &CameraModel, depth: f32| Some(m.defocus.known()?.sigma_px(1.0 / depth));
        let (sigma, focus) = d.setting.lens.unwrap_or_default();
        let truth = |depth: f32| Cell::Number(f64::from(sigma * (1.0 - focus / depth).abs()), 2);
        vec![
            Cell::text(d.name),
            Cell::Number(d.setting.exposure.into(), 2),
            of(&|m| Some(m.motion_blur.known()?.exposure.0), 2),
            truth(1.9),
            of(&|m| blur(m, 1.9), 2),
            truth(6.0),
            of(&|m| blur(m, 6.0), 2),
            Cell::number(d.sharpening.map(|s| s.amount.into()), 2),
            of(&|m| Some(m.sharpening.known()?.amount), 2),
        ]
    });
    let head = [
        "camera",
        "true exposure fraction",
        "recovered exposure fraction",
        "true blur at 1.9 m, px",
        "recovered blur at 1.9 m, px",
        "true blur at 6 m, px",
        "recovered blur at 6 m, px",
        "true sharpening",
        "recovered sharpening",
    ];
    Table {
        name: "recovered".into(),
        caption: "True and recovered cameras; n is the number of scenes in which the part is known.".into(),
        head: head.map(String::from).into(),
        rows: rows.collect(),
    }
}
