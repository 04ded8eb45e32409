//! The results as a table and as a page with the paper's plots.

use super::{Experiment, Outcome, Summary, mean, worst};
use blindaug_io::{Result, read_frame, write_atomically};
use blindaug_report::page_with;
use blindaug_report::plots::{self, PlotError};
use blindaug_scenes::camera::Camera;
use blindaug_scenes::measure::{Given, Measured, median};
use maud::{Markup, html};
use std::{collections::BTreeSet, fmt::Write, path::Path};

/// The cells of a row.
type Row = Vec<String>;

const HEAD: [&str; 12] = [
    "camera",
    "given",
    "lambda (worst)",
    "where none",
    "delta px",
    "%",
    "where none",
    "focus %",
    "both: lambda, delta",
    "noise %, finest",
    "covered",
    "unknown",
];

fn number(v: Option<f32>, digits: usize) -> String {
    v.map_or("-".into(), |v| format!("{v:.digits$}"))
}

fn rows(outcomes: &[Outcome]) -> Vec<Row> {
    let coded: BTreeSet<u8> = outcomes.iter().filter_map(|o| o.case.coded).collect();
    let coded =
        coded.into_iter().map(|c| (format!("physics, H.264 crf {c}"), Some(Camera::Physics), Some(c), false));
    let groups = [
        ("synthesis".to_owned(), Some(Camera::Synthesis), None, false),
        ("physics".to_owned(), Some(Camera::Physics), None, false),
    ];
    let shaking = outcomes.iter().filter(|o| o.case.experiment == Experiment::Shaking);
    let shaking: BTreeSet<Option<u8>> = shaking.map(|o| o.case.coded).collect();
    let shaking = shaking.into_iter().map(|coded| {
        let how = coded.map_or(String::new(), |c| format!(", H.264 crf {c}"));
        (format!("physics, shaking hand{how}"), Some(Camera::Physics), coded, true)
    });
    let clips = ("rendered clips".to_owned(), None, None, false);
    let mut rows = vec![];
    for (name, camera, coded, shaking) in groups.into_iter().chain(coded).chain(shaking).chain([clips]) {
        for given in Given::ALL {
            let of = outcomes
                .iter()
                .filter(|o| o.case.camera == camera && o.case.coded == coded)
                .filter(|o| (o.case.experiment == Experiment::Shaking) == shaking)
                .flat_map(|o| o.measured.iter().filter(|m| m.given == given).map(move |m| (o, m)));
            if of.clone().next().is_none() {
                continue;
            }
            let s = Summary::of(of);
            let px = |v: &[[f32; 2]]| mean(&v.iter().map(|b| b[0]).collect::<Vec<_>>());
            let share = |v: &[[f32; 2]]| {
                let sum = |k: usize| v.iter().map(|b| b[k]).sum::<f32>();
                (!v.is_empty()).then(|| 100.0 * sum(0) / sum(1).max(1e-6))
            };
            let covered: Vec<String> =
                s.covered.iter().map(|(what, (n, of))| format!("{what} {n}/{of}")).collect();
            rows.push(vec![
                name.clone(),
                given.words().into(),
                format!("{} ({})", number(mean(&s.exposure), 3), number(worst(&s.exposure), 2)),
                number(mean(&s.exposure_where_none), 3),
                number(px(&s.blur), 3),
                number(share(&s.blur), 1),
                number(mean(&s.blur_where_none), 3),
                number(median(s.focus.clone()).map(|v| 100.0 * v), 1),
                format!("{}, {} px", number(mean(&s.exposure_of_all), 3), number(px(&s.blur_of_all), 3)),
                format!(
                    "{}, {}",
                    number(median(s.noise.clone()).map(|v| 100.0 * v), 1),
                    number(median(s.noise_finest.clone()).map(|v| 100.0 * v), 1)
                ),
                covered.join(", "),
                format!("{}/{}", s.unknown.0, s.unknown.1),
            ]);
        }
    }
    rows
}

/// The mean errors of lambda: of all frames together, and of a typical single frame.
fn against_single(outcomes: &[Outcome]) -> Option<[f32; 2]> {
    let blind = |o: &&Outcome| {
        !matches!(o.case.experiment, Experiment::Clip | Experiment::Shaking) && o.case.coded.is_none()
    };
    let s = Summary::of(
        outcomes
            .iter()
            .filter(blind)
            .flat_map(|o| o.measured.iter().filter(|m| m.given == Given::DepthAndFlow).map(move |m| (o, m))),
    );
    let of = |k: usize| mean(&s.against_single.iter().map(|v| v[k]).collect::<Vec<_>>());
    Some([of(0)?, of(1)?])
}

/// The table for a terminal.
pub fn table(outcomes: &[Outcome]) -> String {
    let rows = rows(outcomes);
    let width = |i: usize| rows.iter().map(|r| r[i].len()).chain([HEAD[i].len()]).max().unwrap_or(0);
    let widths: Vec<usize> = (0..HEAD.len()).map(width).collect();
    let mut text = String::new();
    let mut line = |cells: &mut dyn Iterator<Item = &str>| {
        let cells: Vec<String> = cells.zip(&widths).map(|(c, &w)| format!("{c:w$}")).collect();
        let _ = writeln!(text, "{}", cells.join("  ").trim_end());
    };
    line(&mut HEAD.into_iter());
    for row in &rows {
        line(&mut row.iter().map(String::as_str));
    }
    if let Some([together, single]) = against_single(outcomes) {
        let _ = writeln!(
            text,
            "\nblind lambda, depth and flow given: all frames together {together:.3}, a typical single frame {single:.3}"
        );
    }
    let clips: Vec<&Outcome> = outcomes.iter().filter(|o| o.case.experiment == Experiment::Clip).collect();
    if !clips.is_empty() {
        text.push('\n');
    }
    for o in clips {
        let cell = |given: Given| {
            let Some(m) = o.measured.iter().find(|m| m.given == given) else { return String::new() };
            format!("{} {}", exposure_cell(m), lens_cell(m))
        };
        let _ = write!(
            text,
            "{:<24} true {:.2}  clean given: {}  depth, flow given: {}",
            o.case.name,
            o.truth.exposure,
            cell(Given::Everything),
            cell(Given::DepthAndFlow)
        );
        if let Some(f) = o.fidelity {
            let _ = write!(
                text,
                "  composite: naive {:.1}, estimated {:.1}, true camera {:.1} dB",
                f.naive, f.estimated, f.oracle
            );
        }
        text.push('\n');
    }
    text
}

fn exposure_cell(m: &Measured) -> String {
    m.exposure.map_or("unknown".into(), |e| {
        format!("{:.3} [{:.2}, {:.2}]", e.estimate, e.interval[0], e.interval[1])
    })
}

fn lens_cell(m: &Measured) -> String {
    m.lens.as_ref().map_or("unknown".into(), |l| format!("{:.3} of {:.2} px", l.error_px, l.mean_px))
}

/// Writes the page.
///
/// # Errors
/// If the page cannot be written; then no file is left.
pub fn write(path: &Path, outcomes: &[Outcome], pictures: &Path) -> Result<()> {
    let page = page(outcomes, pictures)
        .map_err(|e| blindaug_io::Error::new(path, format!("a plot cannot be drawn ({e})")))?;
    write_atomically(path, |partial| std::fs::write(partial, page.into_string()))
}

fn page(outcomes: &[Outcome], pictures: &Path) -> std::result::Result<Markup, PlotError> {
    let frames: u64 = outcomes.iter().map(|o| o.case.frames).max().unwrap_or(0);
    let scenes = outcomes.iter().map(|o| o.case.scene).max().unwrap_or(0);
    // The plots show the cases without video coding.
    let plain: Vec<Outcome> = outcomes.iter().filter(|o| o.case.coded.is_none()).cloned().collect();
    let about = format!("{} cases · {scenes} scenes of {frames} frames", outcomes.len());
    let body = html! {
        section {
            h2 { "How far estimates lie from the truth" }
            p {
                "Mean absolute errors. " strong { "lambda" } ": exposure fraction, cases with motion blur alone. " strong { "delta" }
                ": defocus std over the scene's pixels, cases with defocus alone. " strong { "where none" }
                ": what is found although the camera was sharp. " strong { "both" } ": motion blur, defocus and noise at once. "
                strong { "noise" } ": median error of the std per level, channel and luminance. " strong { "covered" }
                ": 95 % intervals that hold the truth. " strong { "unknown" } ": parts that were not estimated, of all that could be."
            }
            div.wide {
                table {
                    thead { tr { @for h in HEAD { th { (h) } } } }
                    tbody { @for row in rows(outcomes) { tr { @for cell in row { td.number { (cell) } } } } }
                }
            }
            @if let Some([together, single]) = against_single(outcomes) {
                p { "Blind lambda with depth and flow given: error " (format!("{together:.3}")) " of all frames together, "
                    (format!("{single:.3}")) " of a typical single frame." }
            }
        }
        section {
            h2 { "Exposure: true and recovered" }
            div.row {
                @for (title, plot) in exposure_plots(&plain)? { figure { (plot) figcaption { (title) } } }
            }
        }
        section {
            h2 { "Defocus over inverse depth: true (black) and recovered" }
            div.row {
                @for (title, plot) in lens_plots(&plain)? { figure { (plot) figcaption { (title) } } }
            }
        }
        section {
            h2 { "Noise: error of the std over the strength of the noise" }
            @if let Some(plot) = noise_plot(&plain)? {
                figure { (plot) figcaption { "Each point is a case: median over levels, channels and luminances; nothing given but the frames." } }
            }
        }
        (picture_section(&plain, pictures))
    };
    Ok(page_with(
        "Validation",
        &about,
        &body,
        "The truth is known because the scenes are made by this program.",
    ))
}

const CAMERAS: [(Camera, &str); 2] = [(Camera::Synthesis, "own synthesis"), (Camera::Physics, "physics")];

fn exposure_plots(outcomes: &[Outcome]) -> std::result::Result<Vec<(String, Markup)>, PlotError> {
    let mut all = vec![];
    for given in Given::ALL {
        let groups: Vec<Vec<[f64; 4]>> = CAMERAS
            .iter()
            .map(|(camera, _)| {
                let of = outcomes.iter().filter(|o| {
                    o.case.camera == Some(*camera)
                        && matches!(o.case.experiment, Experiment::MotionBlur | Experiment::All)
                });
                of.filter_map(|o| {
                    let m = o.measured.iter().find(|m| m.given == given)?;
                    let e = m.exposure?;
                    Some([o.truth.exposure, e.estimate, e.interval[0], e.interval[1]].map(f64::from))
                })
                .collect()
            })
            .collect();
        if groups.iter().all(Vec::is_empty) {
            continue;
        }
        let caption = format!("{} given. Blue: {}, orange: {}.", given.words(), CAMERAS[0].1, CAMERAS[1].1);
        all.push((caption, plots::true_and_estimated("exposure fraction", 1.0, &groups)?));
    }
    Ok(all)
}

fn lens_plots(outcomes: &[Outcome]) -> std::result::Result<Vec<(String, Markup)>, PlotError> {
    let mut all = vec![];
    for o in outcomes.iter().filter(|o| o.case.experiment == Experiment::Defocus && o.case.scene == 1) {
        let curves: Vec<(Given, &[[f32; 3]])> =
            o.measured.iter().filter_map(|m| Some((m.given, m.lens.as_ref()?.curve.as_slice()))).collect();
        let Some((_, first)) = curves.first() else { continue };
        let line = |c: &[[f32; 3]], k: usize| {
            c.iter().map(|p| [f64::from(p[0]), f64::from(p[k])]).collect::<Vec<_>>()
        };
        let truth = line(first, 1);
        let recovered: Vec<Vec<[f64; 2]>> = curves.iter().map(|(_, c)| line(c, 2)).collect();
        let names: Vec<&str> = curves.iter().map(|(g, _)| g.words()).collect();
        let caption = format!("{}. Given, from blue to orange: {}.", o.case.name, names.join("; "));
        all.push((caption, plots::curves("inverse depth, 1/m", "blur std, px", &truth, &recovered)?));
    }
    Ok(all)
}

fn noise_plot(outcomes: &[Outcome]) -> std::result::Result<Option<Markup>, PlotError> {
    let groups: Vec<Vec<[f64; 2]>> = CAMERAS
        .iter()
        .map(|(camera, _)| {
            outcomes
                .iter()
                .filter(|o| o.case.camera == Some(*camera))
                .filter_map(|o| {
                    let m = o.measured.iter().find(|m| m.given == Given::Nothing)?;
                    Some([f64::from(o.case.setting?.noise), 100.0 * f64::from(m.noise_median?)])
                })
                .collect()
        })
        .collect();
    if groups.iter().all(Vec::is_empty) {
        return Ok(None);
    }
    plots::scatter("noise std at mid-grey (of 1)", "median error of the std, %", &groups).map(Some)
}

fn picture_section(outcomes: &[Outcome], pictures: &Path) -> Markup {
    let shown = |name: String| {
        let frame = read_frame(pictures.join(name)).ok()?;
        blindaug_report::shown(&frame, 512 * 384)
    };
    let rows: Vec<(&Outcome, Vec<(&str, blindaug_report::Shown)>)> = outcomes
        .iter()
        .filter(|o| o.case.scene == 1 && o.case.experiment == Experiment::All)
        .map(|o| {
            let of = |what: &'static str, caption: &'static str| {
                Some((caption, shown(format!("{}-{what}.png", o.case.name))?))
            };
            let all = [
                of("filmed", "filmed"),
                of("synthesised", "the sharp frame with the estimated camera"),
                of("error", "difference without synthetic noise, twice as strong, around grey"),
            ];
            (o, all.into_iter().flatten().collect::<Vec<_>>())
        })
        .filter(|(_, all)| !all.is_empty())
        .take(4)
        .collect();
    html! {
        @if !rows.is_empty() {
            section {
                h2 { "Filmed and synthesised, depth given" }
                @for (o, pictures) in &rows {
                    h3 { (o.case.name) }
                    div.row.small {
                        @for (caption, shown) in pictures {
                            figure { img.fill src=(shown.uri) width=(shown.width) height=(shown.height) alt=(caption); figcaption { (caption) } }
                        }
                    }
                }
            }
        }
    }
}
