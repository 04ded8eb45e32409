//! The results of the validation as tables, the paper's figures, and pictures.

use super::{Experiment, NAME, Outcome, Summary};
use crate::figure::{Axis, Figure, Mark, Series, Style};
use crate::run::{Findings, Pictures};
use crate::statistics::{Mean, mean};
use crate::table::{Cell, Table};
use blindaug_report::words::count;
use blindaug_scenes::camera::Camera;
use blindaug_scenes::measure::{Given, Measured};
use std::collections::BTreeSet;

/// The cameras, with their names in tables and figures.
const CAMERAS: [(Camera, &str); 3] = [
    (Camera::Synthesis, "own synthesis"),
    (Camera::Heteroscedastic, "the paper's noise"),
    (Camera::Physics, "physics"),
];

/// The findings, in the folder [`NAME`].
pub fn findings(outcomes: &[Outcome]) -> Findings {
    let frames: u64 = outcomes.iter().map(|o| o.case.frames).max().unwrap_or(0);
    let scenes = outcomes.iter().map(|o| o.case.scene).max().unwrap_or(0);
    // The figures show the cases without video coding.
    let plain: Vec<&Outcome> = outcomes.iter().filter(|o| o.case.coded.is_none()).collect();
    let mut text = vec![
        format!(
            "{} cases; {} of {}. Every scene is filmed by the project's own synthesis, by which what is \
             fitted is what was applied, as in the paper; and by physics: many pinhole views over lens and shutter, counted photons. \
             Every strength of noise is also filmed with the noise of the paper's validation, white and Gaussian, of the std k_readout + \
             k_shot sqrt(I).",
            outcomes.len(),
            count(scenes, "scene"),
            count(frames, "frame")
        ),
        "\"Clean frames, depth, flow\" given is the paper's OPTIMIZATION, \"nothing\" its FULLPIPELINE."
            .into(),
    ];
    if let Some([together, single]) = against_single(outcomes) {
        text.push(format!(
            "With depth and flow given, the error of the exposure fraction of all frames together is {together:.3}, that of a typical \
             single frame {single:.3}."
        ));
    }
    let mut tables: Vec<Table> = errors(outcomes).into();
    tables.extend(clips(outcomes));
    let mut figures = exposure_figures(&plain);
    figures.extend(lens_figures(&plain));
    figures.extend(noise_figure(&plain));
    Findings {
        name: NAME.into(),
        title: "Validation: how far estimates lie from the truth".into(),
        text,
        tables,
        figures,
        pictures: pictures(outcomes),
        ..Findings::default()
    }
}

/// The tables of errors and of intervals: a row for each camera and each kind of evidence given.
fn errors(outcomes: &[Outcome]) -> [Table; 2] {
    let coded: BTreeSet<u8> = outcomes.iter().filter_map(|o| o.case.coded).collect();
    let shaking = outcomes.iter().filter(|o| o.case.experiment == Experiment::Shaking);
    let shaking: BTreeSet<Option<u8>> = shaking.map(|o| o.case.coded).collect();
    let physics = Some(Camera::Physics);
    let groups = CAMERAS
        .into_iter()
        .map(|(camera, name)| (name.to_owned(), Some(camera), None, false))
        .chain(coded.into_iter().map(|c| (format!("physics, H.264 crf {c}"), physics, Some(c), false)))
        .chain(shaking.into_iter().map(|coded| {
            let how = coded.map_or(String::new(), |c| format!(", H.264 crf {c}"));
            (format!("physics, shaking hand{how}"), physics, coded, true)
        }))
        .chain([("rendered clips".to_owned(), None, None, false)]);
    let mut rows = vec![];
    for (name, camera, coded, shaking) in groups {
        for given in Given::ALL {
            let of = outcomes
                .iter()
                .filter(|o| o.case.camera == camera && o.case.coded == coded)
                .filter(|o| (o.case.experiment == Experiment::Shaking) == shaking)
                .flat_map(|o| o.measured.iter().filter(|m| m.given == given).map(move |m| (o, m)));
            if of.clone().next().is_some() {
                rows.push(row(&name, given, &Summary::of(of)));
            }
        }
    }
    let head = [
        "camera",
        "given",
        "exposure fraction",
        "worst",
        "where none: exposure fraction",
        "blur, px",
        "%",
        "where none: blur, px",
        "focus, % (median)",
        "both: exposure fraction",
        "both: blur, px",
        "noise, % (median)",
        "finest octave, %",
        "exposure covered, %",
        "lens covered, %",
        "unknown, %",
    ];
    // Two narrow tables can be read where a wide one would have to be scrolled.
    let part = |name: &str, caption: &str, columns: &[usize]| Table {
        name: name.into(),
        caption: caption.into(),
        head: columns.iter().map(|&i| head[i].to_owned()).collect(),
        rows: rows.iter().map(|row: &Vec<Cell>| columns.iter().map(|&i| row[i].clone()).collect()).collect(),
    };
    [
        part(
            "errors",
            "Mean absolute errors with their standard deviation over the cases. Exposure fraction: cases with motion blur alone; blur: the \
             std of the defocus over the scene's pixels, cases with defocus alone; noise: error of the std per octave, channel and \
             luminance. Medians with the quartiles in brackets.",
            &[0, 1, 2, 3, 5, 6, 8, 11, 12],
        ),
        part(
            "intervals",
            "What is found although the camera was sharp (where none); errors where motion blur, defocus and noise come at once (both); 95 % \
             intervals that hold the truth (covered); parts that were not estimated, of all that could be (unknown).",
            &[0, 1, 4, 7, 9, 10, 13, 14, 15],
        ),
    ]
}

fn row(name: &str, given: Given, s: &Summary) -> Vec<Cell> {
    let spread = |v: &[f32], digits| Cell::spread(mean(v.iter().map(|&v| f64::from(v))), digits);
    let px = |v: &[[f32; 2]]| spread(&v.iter().map(|b| b[0]).collect::<Vec<_>>(), 3);
    let of_blur = |v: &[[f32; 2]]| {
        let sum = |k: usize| v.iter().map(|b| f64::from(b[k])).sum::<f64>();
        (!v.is_empty()).then(|| 100.0 * sum(0) / sum(1).max(1e-6))
    };
    let percent = |v: &[f32]| {
        quartiles(v).map_or(Cell::Empty, |q| {
            let [first, middle, last] = q.map(|v| 100.0 * f64::from(v));
            Cell::Interval(middle, [first, last], 1)
        })
    };
    let covered = |what| s.covered.get(what).map(|&(n, of)| share(n, of));
    let worst = s.exposure.iter().copied().reduce(f32::max);
    vec![
        Cell::text(name),
        Cell::text(given.words()),
        spread(&s.exposure, 3),
        Cell::number(worst.map(f64::from), 2),
        spread(&s.exposure_where_none, 3),
        px(&s.blur),
        Cell::number(of_blur(&s.blur), 1),
        spread(&s.blur_where_none, 3),
        percent(&s.focus),
        spread(&s.exposure_of_all, 3),
        px(&s.blur_of_all),
        percent(&s.noise),
        percent(&s.noise_finest),
        Cell::spread(covered("exposure"), 0),
        Cell::spread(covered("lens"), 0),
        Cell::spread(Some(share(s.unknown.0, s.unknown.1)).filter(|m| m.n > 0), 0),
    ]
}

/// The values of rank 1/4, 1/2 and 3/4; `None` if there are no values.
fn quartiles(v: &[f32]) -> Option<[f32; 3]> {
    let mut sorted = v.to_vec();
    sorted.sort_by(f32::total_cmp);
    (!sorted.is_empty()).then(|| [1, 2, 3].map(|k| sorted[k * (sorted.len() - 1) / 4]))
}

/// A share in %, with the standard deviation of one case and the number of cases.
fn share(n: usize, of: usize) -> Mean {
    let p = n as f64 / of.max(1) as f64;
    Mean { mean: 100.0 * p, std: 100.0 * (p * (1.0 - p)).sqrt(), n: of }
}

/// The mean errors of the exposure fraction: of all frames together, and of a typical single frame.
fn against_single(outcomes: &[Outcome]) -> Option<[f64; 2]> {
    let blind = |o: &&Outcome| {
        !matches!(o.case.experiment, Experiment::Clip | Experiment::Shaking) && o.case.coded.is_none()
    };
    let s = Summary::of(
        outcomes
            .iter()
            .filter(blind)
            .flat_map(|o| o.measured.iter().filter(|m| m.given == Given::DepthAndFlow).map(move |m| (o, m))),
    );
    let of = |k: usize| mean(s.against_single.iter().map(|v| f64::from(v[k]))).map(|m| m.mean);
    Some([of(0)?, of(1)?])
}

/// The table of rendered clips.
fn clips(outcomes: &[Outcome]) -> Option<Table> {
    let of_clips = outcomes.iter().filter(|o| o.case.experiment == Experiment::Clip);
    let exposure = |m: Option<&Measured>| {
        m.and_then(|m| m.exposure)
            .map_or(Cell::Empty, |e| Cell::Interval(f64::from(e.estimate), e.interval.map(f64::from), 3))
    };
    let blur = |m: Option<&Measured>| {
        Cell::number(m.and_then(|m| m.lens.as_ref()).map(|l| f64::from(l.error_px)), 3)
    };
    let rows: Vec<Vec<Cell>> = of_clips
        .map(|o| {
            let of = |given| o.measured.iter().find(|m| m.given == given);
            let (clean, blind) = (of(Given::Everything), of(Given::DepthAndFlow));
            let psnr = |k: usize| Cell::number(o.fidelity.map(|f| [f.naive, f.estimated, f.oracle][k]), 1);
            let mut row = vec![Cell::text(&o.case.name), Cell::Number(f64::from(o.truth.exposure), 2)];
            row.extend([
                exposure(clean),
                exposure(blind),
                blur(clean),
                blur(blind),
                psnr(0),
                psnr(1),
                psnr(2),
            ]);
            row
        })
        .collect();
    let head = [
        "clip",
        "true exposure fraction",
        "clean frames given",
        "depth and flow given",
        "blur error, clean frames given, px",
        "blur error, depth and flow given, px",
        "PSNR naive, dB",
        "PSNR estimated, dB",
        "PSNR true camera, dB",
    ];
    (!rows.is_empty()).then(|| Table {
        name: "clips".into(),
        caption: "Rendered clips: the exposure fraction with its 95 % interval, the mean error of the blur, and the PSNR of composites \
                  over the object with depth given."
            .into(),
        head: head.map(String::from).into(),
        rows,
    })
}

/// The paper's figure of recovered exposures, one for each kind of evidence.
fn exposure_figures(outcomes: &[&Outcome]) -> Vec<Figure> {
    let figure = |given: Given| {
        let mut series: Vec<Series> = CAMERAS
            .iter()
            .enumerate()
            .map(|(i, (camera, name))| {
                let of = outcomes.iter().filter(|o| {
                    o.case.camera == Some(*camera)
                        && matches!(o.case.experiment, Experiment::MotionBlur | Experiment::All)
                });
                let marks = of.filter_map(|o| {
                    let e = o.measured.iter().find(|m| m.given == given)?.exposure?;
                    // Cases of one exposure lie beside each other.
                    let beside = 0.008 * (o.case.scene as f64 % 5.0 - 2.0) + 0.004 * i as f64;
                    Some(Mark {
                        x: f64::from(o.truth.exposure) + beside,
                        y: f64::from(e.estimate),
                        interval: Some(e.interval.map(f64::from)),
                    })
                });
                Series { name: (*name).into(), style: Style::Points, colour: i, marks: marks.collect() }
            })
            .collect();
        series.retain(|s| !s.marks.is_empty());
        if series.is_empty() {
            return None;
        }
        let line = vec![Mark::new(0.0, 0.0), Mark::new(1.0, 1.0)];
        series.push(Series { name: "truth".into(), style: Style::Reference, colour: 0, marks: line });
        Some(Figure {
            name: format!("exposure-{}", file_name(given)),
            caption: format!("Recovered exposure fraction with 95 % intervals; given: {}.", given.words()),
            x: Axis::over("true exposure fraction", [0.0, 1.05]),
            y: Axis::over("recovered", [0.0, 1.2]),
            series,
        })
    };
    Given::ALL.into_iter().filter_map(figure).collect()
}

/// The paper's figure of recovered lenses: the first scene through every lens, one figure for each kind of evidence.
fn lens_figures(outcomes: &[&Outcome]) -> Vec<Figure> {
    let mut figures = vec![];
    for (camera, by) in CAMERAS {
        let of_camera = || {
            outcomes.iter().filter(move |o| {
                o.case.experiment == Experiment::Defocus && o.case.scene == 1 && o.case.camera == Some(camera)
            })
        };
        for given in Given::ALL {
            let mut series = vec![];
            for (colour, o) in of_camera().enumerate() {
                let Some(lens) = o.measured.iter().find(|m| m.given == given).and_then(|m| m.lens.as_ref())
                else {
                    continue;
                };
                let marks = |k: usize| {
                    lens.curve.iter().map(|p| Mark::new(f64::from(p[0]), f64::from(p[k]))).collect()
                };
                // The first lens stands in the legend for all.
                let name = |what: &str| if series.is_empty() { what.to_owned() } else { String::new() };
                let names = ["true", "recovered"].map(name);
                series.push(Series { name: names[0].clone(), style: Style::Line, colour, marks: marks(1) });
                series.push(Series { name: names[1].clone(), style: Style::Points, colour, marks: marks(2) });
            }
            if !series.is_empty() {
                let camera = super::file_name(camera);
                figures.push(Figure {
                    name: format!("lens-{camera}-{}", file_name(given)),
                    caption: format!(
                        "Lenses, a colour each, filmed by {by}; given: {}. Lines: true; points: recovered.",
                        given.words()
                    ),
                    x: Axis::new("inverse depth, 1/m"),
                    y: Axis::new("blur std, px"),
                    series,
                });
            }
        }
    }
    figures
}

fn noise_figure(outcomes: &[&Outcome]) -> Option<Figure> {
    let mut series: Vec<Series> = CAMERAS
        .iter()
        .enumerate()
        .map(|(i, (camera, name))| {
            let of = outcomes.iter().filter(|o| o.case.camera == Some(*camera));
            let marks = of.filter_map(|o| {
                let m = o.measured.iter().find(|m| m.given == Given::Nothing)?;
                Some(Mark::new(f64::from(o.case.setting?.noise), 100.0 * f64::from(m.noise_median?)))
            });
            Series { name: (*name).into(), style: Style::Points, colour: i, marks: marks.collect() }
        })
        .collect();
    series.retain(|s| !s.marks.is_empty());
    (!series.is_empty()).then(|| Figure {
        name: "noise".into(),
        caption: "Median error of the noise std over octaves, channels and luminances, a point for each case; nothing given.".into(),
        x: Axis::new("noise std at mid-grey, of 1"),
        y: Axis::new("error of the std, %"),
        series,
    })
}

/// The kind of evidence as a part of a file's name.
fn file_name(given: Given) -> String {
    given.words().replace([' ', ','], "-").replace("--", "-")
}

fn pictures(outcomes: &[Outcome]) -> Vec<Pictures> {
    let shown = |o: &&Outcome| o.has_pictures();
    outcomes
        .iter()
        .filter(shown)
        .take(4)
        .map(|o| Pictures {
            title: format!("{}, depth given", o.case.name),
            files: [
                ("filmed", "filmed"),
                ("synthesised", "the sharp frame with the estimated camera"),
                ("error", "difference without synthetic noise, twice as strong, around grey"),
            ]
            .map(|(what, caption)| (caption.to_owned(), o.picture(what).into()))
            .into(),
        })
        .collect()
}
