//! Correctness across settings: three levels each of exposure, noise, focus distance and aperture, of the same scenes.

use super::Scale;
use crate::figure::{Axis, Figure, Mark, Series, Style};
use crate::filming::Filming;
use crate::run::{Findings, Run};
use crate::statistics::{line, mean, proportional};
use crate::table::{Cell, Table};
use crate::validation::measure;
use blindaug_io::{Error, Result};
use blindaug_pipeline::Networks;
use blindaug_report::words::count;
use blindaug_scenes::camera::{Camera, Setting};
use blindaug_scenes::measure::{Given, Value};
use blindaug_scenes::scene::Scene;
use serde::{Deserialize, Serialize};

/// The name of the experiment's folder.
pub const NAME: &str = "settings";

/// What differs between the settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum What {
    Exposure,
    Noise,
    Focus,
    Aperture,
}

impl What {
    const ALL: [Self; 4] = [Self::Exposure, Self::Noise, Self::Focus, Self::Aperture];

    fn name(self) -> &'static str {
        match self {
            Self::Exposure => "exposure",
            Self::Noise => "noise",
            Self::Focus => "focus",
            Self::Aperture => "aperture",
        }
    }

    /// The quantity that is recovered, with its unit.
    fn quantity(self) -> &'static str {
        match self {
            Self::Exposure => "exposure fraction",
            Self::Noise => "noise std at mid-grey, of 1",
            Self::Focus => "inverse depth in focus, 1/m",
            Self::Aperture => "blur at infinity, px",
        }
    }

    /// The names and the settings of the three levels. A lens of the f-number N blurs infinity by a std of `APERTURE / N` px.
    fn levels(self) -> [(String, Setting); 3] {
        const APERTURE: f32 = 14.0;
        let normal = Setting {
            exposure: 0.4,
            lens: Some((APERTURE / 5.6, 1.6)),
            noise: 0.01,
            readout: 0.2,
            rolling_shutter: 0.0,
        };
        match self {
            // A longer exposure counts more photons, so that the picture of the same brightness has less noise.
            Self::Exposure => [0.2f32, 0.4, 0.8].map(|exposure| {
                let noise = 0.01 * (0.4 / exposure).sqrt();
                (format!("exposure fraction {exposure}"), Setting { exposure, noise, ..normal })
            }),
            Self::Noise => {
                [0.006, 0.012, 0.024].map(|noise| (format!("noise std {noise}"), Setting { noise, ..normal }))
            }
            Self::Focus => [1.0, 1.6, 3.5].map(|focus| {
                let lens = Some((APERTURE / 5.6, focus));
                (format!("focus at {focus} m"), Setting { lens, ..normal })
            }),
            Self::Aperture => [2.8, 5.6, 11.0].map(|n| {
                let lens = Some((APERTURE / n, 1.6));
                (format!("f/{n}"), Setting { lens, ..normal })
            }),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Case {
    what: What,
    level: usize,
    scene: u64,
    frames: u64,
    size: (usize, usize),
    setting: Setting,
    given: Given,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Outcome {
    truth: f32,
    /// `None`: unknown.
    recovered: Option<Value>,
}

/// Runs the experiment.
///
/// # Errors
/// If a file cannot be written.
pub fn run(run: &Run, scale: Scale) -> Result<Findings> {
    let Scale { scenes, frames, size } = scale;
    let mut cases = vec![];
    for scene in 1..=scenes {
        for what in What::ALL {
            for (level, (_, setting)) in what.levels().into_iter().enumerate() {
                for given in [Given::Depth, Given::Nothing] {
                    // Without depth, the focus has no unit to compare.
                    if given == Given::Nothing && what == What::Focus {
                        continue;
                    }
                    let seed = run.seed() + scene;
                    let name = format!("{}-{level}-scene{scene}-{given:?}", what.name()).to_lowercase();
                    cases.push((name, Case { what, level, scene: seed, frames, size, setting, given }));
                }
            }
        }
    }
    let mut sharp: Option<(u64, Filming)> = None;
    let outcomes = run.cases(NAME, cases, |case| {
        if sharp.as_ref().is_none_or(|s| s.0 != case.scene) {
            sharp = Some((case.scene, Filming::new(Scene::new(case.scene, case.size), case.frames)));
        }
        let filming = &mut sharp.as_mut().expect("it was just made").1;
        let fails = |e: blindaug::Error| Error::new(NAME, e.to_string());
        filming.film(Camera::Physics, case.setting, case.scene).map_err(fails)?;
        let footage = &filming.footage;
        let (measured, estimation) =
            measure(footage, case.given, &mut Networks::default(), run.observer()).map_err(fails)?;
        let lens = measured.lens.as_ref();
        let (sigma, focus) = case.setting.lens.unwrap_or_default();
        Ok(match case.what {
            What::Exposure => Outcome { truth: case.setting.exposure, recovered: measured.exposure },
            What::Focus => Outcome { truth: 1.0 / focus, recovered: lens.map(|l| l.focus_inverse_depth) },
            What::Aperture => Outcome { truth: sigma, recovered: lens.map(|l| l.sigma_px_at_infinity) },
            What::Noise => {
                // The finest octave of the green channel, at the luminance nearest to mid-grey that the scene has.
                let points = footage.noise.iter().flat_map(|n| n.points()).filter(|p| p.0 == 0 && p.1 == 1);
                let point = points.min_by(|a, b| (a.2 - 0.5).abs().total_cmp(&(b.2 - 0.5).abs()));
                let (luminance, truth) = point.map_or((0.5, f32::NAN), |p| (p.2, p.3));
                let recovered = estimation.model.noise.known().map(|m| m.std(0, luminance)[1]);
                let value = |estimate| Value { estimate, interval: [estimate; 2] };
                Outcome { truth, recovered: recovered.map(value) }
            }
        })
    })?;
    Ok(findings(&outcomes, scenes, frames))
}

fn findings(outcomes: &[(Case, Outcome)], scenes: u64, frames: u64) -> Findings {
    let of =
        |what: What, given: Given| outcomes.iter().filter(move |(c, _)| c.what == what && c.given == given);
    let mut levels = vec![];
    let mut slopes = vec![];
    for what in What::ALL {
        for given in [Given::Depth, Given::Nothing] {
            let known: Vec<(f64, f64, usize)> = of(what, given)
                .filter_map(|(c, o)| Some((o.truth.into(), o.recovered?.estimate.into(), c.level)))
                .filter(|p: &(f64, f64, usize)| p.0.is_finite())
                .collect();
            let all = of(what, given).count();
            if all == 0 {
                continue;
            }
            for (level, (name, _)) in what.levels().iter().enumerate() {
                let at = |k: usize| {
                    let values = known.iter().filter(|p| p.2 == level).map(|p| [p.0, p.1][k]);
                    Cell::spread(mean(values), 4)
                };
                let unknown =
                    of(what, given).filter(|(c, o)| c.level == level && o.recovered.is_none()).count();
                levels.push(vec![
                    Cell::text(what.quantity()),
                    Cell::text(name),
                    Cell::text(given.words()),
                    at(0),
                    at(1),
                    Cell::Number(unknown as f64, 0),
                ]);
            }
            let points: Vec<(f64, f64)> = known.iter().map(|p| (p.0, p.1)).collect();
            let logs: Vec<(f64, f64)> =
                points.iter().filter(|p| p.0 > 0.0 && p.1 > 0.0).map(|p| (p.0.ln(), p.1.ln())).collect();
            let cell = |l: Option<crate::statistics::Line>| {
                l.map_or(Cell::Empty, |l| Cell::Interval(l.slope, l.interval, 3))
            };
            slopes.push(vec![
                Cell::text(what.quantity()),
                Cell::text(given.words()),
                cell(proportional(&points)),
                cell(line(&logs)),
                Cell::text(in_order(outcomes, what, given)),
                Cell::Number(points.len() as f64, 0),
                Cell::Number((all - points.len()) as f64, 0),
            ]);
        }
    }
    let slopes = Table {
        name: "slopes".into(),
        caption: "Recovered over true value: the slope of the line through the origin, which should be 1; the slope of the logarithms, \
                  which is 1 for what goes in proportion (so that the blur at infinity goes as 1/N of the f-number N), with 95 % \
                  intervals; and in how many scenes the three levels come out in their order."
            .into(),
        head: ["quantity", "given", "slope", "slope of logarithms", "in order", "n", "unknown"].map(String::from).into(),
        rows: slopes,
    };
    let levels = Table {
        name: "levels".into(),
        caption: "Means over the scenes with their standard deviation.".into(),
        head: ["quantity", "setting", "given", "true", "recovered", "unknown"].map(String::from).into(),
        rows: levels,
    };
    Findings {
        name: NAME.into(),
        title: "Correctness across settings".into(),
        text: vec![format!(
            "{} of {}, filmed by physics (many pinhole views over lens and shutter, counted photons) with \
             three levels of one setting while the others stay: the exposure (with the noise that it brings), the noise, the focus \
             distance, and the apertures f/2.8, f/5.6 and f/11. All three distortions are there at once.",
            count(scenes, "scene"),
            count(frames, "frame")
        )],
        tables: vec![slopes, levels],
        figures: What::ALL.into_iter().map(|what| figure(what, outcomes)).collect(),
        ..Findings::default()
    }
}

/// The number of scenes whose levels come out in the order of the true ones, of those where all three are known.
fn in_order(outcomes: &[(Case, Outcome)], what: What, given: Given) -> String {
    let mut scenes: Vec<u64> = outcomes.iter().map(|(c, _)| c.scene).collect();
    scenes.sort_unstable();
    scenes.dedup();
    let mut counts = [0, 0];
    for scene in scenes {
        let mut of: Vec<(f32, f32)> = outcomes
            .iter()
            .filter(|(c, _)| c.scene == scene && c.what == what && c.given == given)
            .filter_map(|(_, o)| Some((o.truth, o.recovered?.estimate)))
            .collect();
        if of.len() == 3 {
            of.sort_by(|a, b| a.0.total_cmp(&b.0));
            counts[0] += usize::from(of.windows(2).all(|w| w[0].1 < w[1].1));
            counts[1] += 1;
        }
    }
    format!("{} of {}", counts[0], counts[1])
}

fn figure(what: What, outcomes: &[(Case, Outcome)]) -> Figure {
    let mut series = vec![];
    for (colour, given) in [Given::Depth, Given::Nothing].into_iter().enumerate() {
        let of = outcomes.iter().filter(|(c, _)| c.what == what && c.given == given);
        let marks: Vec<Mark> = of
            .filter_map(|(_, o)| {
                let v = o.recovered?;
                let interval = (v.interval[0] < v.interval[1]).then(|| v.interval.map(f64::from));
                Some(Mark { x: o.truth.into(), y: v.estimate.into(), interval })
            })
            .collect();
        if !marks.is_empty() {
            series.push(Series { name: given.words().into(), style: Style::Points, colour, marks });
        }
    }
    let most = outcomes.iter().filter(|(c, _)| c.what == what).map(|(_, o)| f64::from(o.truth));
    let most = most.filter(|v| v.is_finite()).fold(0.0, f64::max);
    let line = vec![Mark::new(0.0, 0.0), Mark::new(most, most)];
    series.push(Series { name: "truth".into(), style: Style::Reference, colour: 0, marks: line });
    Figure {
        name: what.name().into(),
        caption: format!("Recovered over true {}, with 95 % intervals.", what.quantity()),
        x: Axis::over(format!("true {}", what.quantity()), [0.0, 1.1 * most]),
        y: Axis::over("recovered", [0.0, 1.7 * most]),
        series,
    }
}
