//! Our composites beside those of the baselines, against the pictures in which the object is really there.

use super::Scale;
use crate::baselines::Method;
use crate::baselines::made::{Ground, with_marker};
use crate::fidelity::Fidelity;
use crate::figure::{Axis, Figure, Mark, Series, Style};
use crate::run::{Findings, Pictures, Run};
use crate::sceneries::{Scenery, Take};
use crate::shot::{Compared, Shot};
use crate::statistics::{Mean, mean};
use crate::table::{Cell, Table};
use blindaug::composite::CompositeOptions;
use blindaug::synth::defocus::Bokeh;
use blindaug_io::{Error, Result, write_png};
use blindaug_pipeline::Networks;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Instant;

/// The name of the experiment's folder.
pub const NAME: &str = "baselines";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Case {
    take: Take,
    networks: String,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Outcome {
    scene: String,
    methods: Vec<Made>,
}

/// What a method made of a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Made {
    method: Method,
    fidelity: Fidelity,
    /// The duration of the estimate, s.
    seconds: f64,
    /// What the method found, in a few words.
    found: String,
}

/// Runs the experiment on the first sceneries.
///
/// # Errors
/// If a file cannot be written.
pub fn run(run: &Run, scale: Scale, networks: &mut Networks) -> Result<Findings> {
    let Scale { scenes, frames, size } = scale;
    let folder = run.folder(NAME)?;
    let cases = (0..scenes as usize).map(|i| {
        let case =
            Case { take: Take { scenery: i, seed: run.seed(), frames, size }, networks: networks.names() };
        (format!("scene{i}"), case)
    });
    let outcomes = run.cases(NAME, cases.collect(), |case| outcome(case, &folder, networks))?;
    Ok(findings(&outcomes.into_iter().map(|o| o.1).collect::<Vec<_>>(), frames))
}

fn outcome(case: &Case, folder: &Path, networks: &mut Networks) -> Result<Outcome> {
    let fails = |e: blindaug::Error| Error::new(folder, e.to_string());
    let middle = case.take.middle();
    let Scenery { name, scene, object, device, depth_m, .. } = case.take.scenery();
    let (scene, marker) = with_marker(scene, &object, depth_m, middle as f32);
    let shot = Shot::film(&scene, &object, &device, (case.take.frames, &[middle]), case.take.seed, folder)?;
    let ground = Ground {
        shot: &shot,
        scene: &scene,
        marker: marker.as_ref(),
        setting: &device.setting,
        scenery: case.take.scenery,
    };
    let mut methods = vec![];
    for method in Method::ALL {
        let start = Instant::now();
        let found = ground.estimate(method, networks).map_err(fails)?;
        let seconds = start.elapsed().as_secs_f64();
        let options =
            CompositeOptions { no_noise: true, bokeh: Some(Bokeh::Disk), ..CompositeOptions::default() };
        let make = |c: &Compared| found.composite(&shot.plate(c.number, &c.plate), &c.layer, &options);
        let fidelity = shot.fidelity(make).map_err(fails)?;
        for c in &shot.compared {
            write_png(folder.join(picture(name, method.name())), &make(c).map_err(fails)?)?;
            write_png(folder.join(picture(name, "truth")), &c.truth)?;
        }
        methods.push(Made { method, fidelity, seconds, found: found.words() });
    }
    Ok(Outcome { scene: name.into(), methods })
}

fn picture(scene: &str, what: &str) -> String {
    format!("{scene}-{}.png", what.to_lowercase().replace(' ', "-"))
}

fn findings(outcomes: &[Outcome], frames: u64) -> Findings {
    let of =
        |method: Method| outcomes.iter().filter_map(move |o| o.methods.iter().find(|m| m.method == method));
    let value = |method: Method, k: usize| mean(of(method).map(|m| m.fidelity.values()[k]));
    let rows = Method::ALL.into_iter().map(|method| {
        let measures = (0..3).map(|k| Cell::spread(value(method, k), Fidelity::DIGITS[k]));
        let seconds = Cell::spread(mean(of(method).map(|m| m.seconds)), 2);
        [Cell::text(method.name())]
            .into_iter()
            .chain(measures)
            .chain([seconds, Cell::text(method.needs())])
            .collect()
    });
    let head = ["method"].into_iter().chain(Fidelity::NAMES).chain(["time, s", "is given"]);
    let means = Table {
        name: "means".into(),
        caption: "Likeness of composites to the pictures in which the object is really there, over the object and 20 px around it, \
                  without noise: mean over the scenes with their standard deviation."
            .into(),
        head: head.map(String::from).collect(),
        rows: rows.collect(),
    };
    let per_scene = Table {
        name: "scenes".into(),
        caption: "PSNR in each scene, dB, and what was found.".into(),
        head: ["scene", "method", "PSNR, dB", "SSIM", "FLIP", "found"].map(String::from).into(),
        rows: outcomes
            .iter()
            .flat_map(|o| o.methods.iter().map(move |m| (o, m)))
            .map(|(o, m)| {
                let [a, b, c] = m.fidelity.values();
                let [p, q, r] = Fidelity::DIGITS;
                let numbers = [Cell::Number(a, p), Cell::Number(b, q), Cell::Number(c, r)];
                let mut row = vec![Cell::text(&o.scene), Cell::text(m.method.name())];
                row.extend(numbers);
                row.push(Cell::text(&m.found));
                row
            })
            .collect(),
    };
    Findings {
        name: NAME.into(),
        title: "Baselines".into(),
        text: vec![
            format!(
                "{} scenes of {frames} frames with a circular marker in them. Methods whose names end in \"-like\" follow a paper's text, \
                 not its code. Each is given what it needs, by its true value: the marker's pose is the true one, so that no detector's \
                 errors count against it. Ours is given the frames alone; as whoever places the object knows how far away it is, the \
                 scale of our depth is set by the scene's.",
                outcomes.len()
            ),
            verdict(&value, outcomes),
        ],
        tables: vec![means, per_scene],
        figures: vec![figure(outcomes)],
        pictures: pictures(outcomes),
        ..Findings::default()
    }
}

/// Whether ours beats every other method that does not know the camera, on the mean of each measure.
fn verdict(value: &dyn Fn(Method, usize) -> Option<Mean>, outcomes: &[Outcome]) -> String {
    let mut lost = vec![];
    for (k, measure) in Fidelity::NAMES.into_iter().enumerate() {
        let sign = if Fidelity::LARGER_IS_BETTER[k] { 1.0 } else { -1.0 };
        let of = |method| sign * value(method, k).map_or(f64::NAN, |m| m.mean);
        for method in Method::ALL {
            if ![Method::Ours, Method::TrueCamera].contains(&method) && of(method) >= of(Method::Ours) {
                lost.push(format!("{} by {measure}", method.name()));
            }
        }
    }
    match lost.as_slice() {
        [] => "On the mean of every measure, ours, which is given nothing, is better than every baseline."
            .into(),
        _ => {
            let unknown = outcomes.iter().filter(|o| {
                o.methods.iter().any(|m| m.method == Method::Ours && m.found.contains("unknown"))
            });
            let unknown: Vec<&str> = unknown.map(|o| &*o.scene).collect();
            let why = match unknown.as_slice() {
                [] => String::new(),
                _ => format!(
                    " Where the footage does not tell the exposure or the lens, ours leaves it out rather than guess: {}. A marker tells it \
                     all the same.",
                    unknown.join(", ")
                ),
            };
            format!("Better than ours on the mean: {}.{why}", lost.join("; "))
        }
    }
}

fn figure(outcomes: &[Outcome]) -> Figure {
    let series = outcomes.iter().enumerate().map(|(i, o)| Series {
        name: o.scene.clone(),
        style: Style::Points,
        colour: i,
        marks: Method::ALL
            .iter()
            .enumerate()
            .filter_map(|(row, method)| {
                let made = o.methods.iter().find(|m| m.method == *method)?;
                let beside = 0.08 * (i as f64 - 0.5 * (outcomes.len() as f64 - 1.0));
                Some(Mark::new(made.fidelity.psnr, row as f64 + beside))
            })
            .collect(),
    });
    Figure {
        name: "psnr".into(),
        caption: "PSNR over the object in each scene.".into(),
        x: Axis::new("PSNR, dB"),
        y: Axis::of_rows(Method::ALL.map(|m| m.name().to_owned()).into()),
        series: series.collect(),
    }
}

fn pictures(outcomes: &[Outcome]) -> Vec<Pictures> {
    let row = |o: &Outcome| {
        let made = o.methods.iter().map(|m| {
            let psnr = m.fidelity.psnr;
            (format!("{}, {psnr:.1} dB", m.method.name()), picture(&o.scene, m.method.name()).into())
        });
        let truth = ("truth".to_owned(), picture(&o.scene, "truth").into());
        Pictures { title: o.scene.clone(), files: made.chain([truth]).collect() }
    };
    outcomes.iter().map(row).collect()
}
