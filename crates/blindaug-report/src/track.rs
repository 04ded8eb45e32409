//! The report of a tracked camera: each number over time.

use crate::noise::{channel_key, patches};
use crate::numbers::{distance, interval, number};
use crate::page::{Card, Part, capture, cards, footer, heading, page_of, warnings};
use crate::plots::{self, CHANNELS, Course, ESTIMATE};
use crate::samples::{before_and_after, sample_section};
use crate::{TrackReportInput, pictures};
use blindaug::CameraModel;
use blindaug::model::{DefocusCurve, DepthKind, Distortion, TrackedCamera};
use maud::{Markup, html};
use plotters::style::RGBColor;

pub(crate) fn page(TrackReportInput { title, track, samples, provenance }: &TrackReportInput) -> Part {
    let frames = track.frames();
    let last = &frames[frames.len() - 1].camera;
    let metric = is_metric(frames);
    let noise_lines = [0, 1, 2].map(|c| (CHANNELS[c], move |m: &CameraModel| noise(m, c)));
    let body = html! {
        (warnings(last))
        (summary(frames, metric))
        (before_and_after(track, samples))
        p.soft {
            "Each number is what a frame and those before it tell; the noise is a mean over the frames before and after it. Where the footage says "
            "nothing of a number for a while, the last value stays and its interval (shaded, 95 %) widens; where nothing was seen of it yet, it is left "
            "out. Dashed lines: a change was noticed. That takes up to three frames; a change of the noise is drawn where it was."
        }
        @for distortion in Distortion::ALL {
            section {
                h2 { (heading(distortion)) }
                @match distortion {
                    Distortion::Defocus => (defocus_figures(frames, metric)?),
                    Distortion::MotionBlur => {
                        (figure(frames, "exposure, %", Some(100.0), &[(ESTIMATE, exposure)], distortion, &html! {
                            "The part of the time from one frame to the next in which the shutter is open."
                        })?)
                    },
                    Distortion::Noise => {
                        (figure(frames, "std, 8-bit steps", None, &noise_lines, distortion, &html! {
                            "The std of the finest grain at luminance " (MIDDLE) ": " (channel_key())
                        })?)
                    },
                    other => (first_figure(frames, other)?),
                }
                (in_words(frames, distortion))
                @if distortion == Distortion::Noise { (patches(samples, track)) }
            }
        }
        (sample_section(track, samples, pictures::share_of_budget(samples.len())))
    };
    Ok(page_of(title, &capture(last), &body, &footer(last), provenance.as_ref()))
}

fn defocus_figures(frames: &[TrackedCamera], metric: bool) -> Part {
    let sigma = |m: &CameraModel| Some(lens(m)?[0]);
    let focus = |m: &CameraModel| Some(lens(m)?[1]);
    let focus_name = if metric { "focus, 1/m" } else { "focus, relative" };
    let of_sigma = html! {
        "Std of the Gaussian that is equivalent to the blur of what is very far" @if !metric { " (at relative inverse depth 0)" } "."
    };
    let of_focus = html! {
        "The inverse depth that is in focus"
        @if metric { ", in 1/m." } @else { ", relative: without a unit, larger is nearer, and on another scale after a cut." }
    };
    Ok(html! {
        (figure(frames, "blur, px", None, &[(ESTIMATE, sigma)], Distortion::Defocus, &of_sigma)?)
        (figure(frames, focus_name, None, &[(ESTIMATE, focus)], Distortion::Defocus, &of_focus)?)
    })
}

/// A number and the ends of its interval, if they are known.
type Known = Option<[f64; 3]>;

/// The exposure fraction in %.
fn exposure(model: &CameraModel) -> Known {
    let m = model.motion_blur.known()?;
    Some([m.exposure.0, m.interval[0], m.interval[1]].map(|v| 100.0 * f64::from(v)))
}

/// Blur at infinity and focus of a thin lens, the only curve that is tracked.
fn lens(model: &CameraModel) -> Option<[[f64; 3]; 2]> {
    match model.defocus.known()?.curve {
        DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval } => {
            let [[s_low, s_high], [f_low, f_high]] =
                interval.map_or([[s; 2], [f; 2]], |i| [i.sigma_px_at_infinity, i.focus_inverse_depth]);
            Some([[s, s_low, s_high], [f, f_low, f_high]].map(|v| v.map(f64::from)))
        }
        DefocusCurve::Quadratic { .. } => None,
    }
}

/// The first parameter of a distortion.
fn first(model: &CameraModel, distortion: Distortion) -> Known {
    let p = model.parameters(distortion).into_iter().next()?;
    let [low, high] = p.interval.unwrap_or([p.value; 2]);
    Some([p.value, low, high].map(f64::from))
}

/// The plot of a distortion's first parameter over time, and its meaning.
fn first_figure(frames: &[TrackedCamera], distortion: Distortion) -> Part {
    let Some(p) = frames.iter().find_map(|f| f.camera.parameters(distortion).into_iter().next()) else {
        return Ok(html! {});
    };
    let name = if p.unit.is_empty() { p.name.to_owned() } else { format!("{}, {}", p.name, p.unit) };
    let lines = [(ESTIMATE, |m: &CameraModel| first(m, distortion))];
    figure(frames, &name, None, &lines, distortion, &html! { (p.meaning) })
}

/// The luminance at which the noise is reported.
const MIDDLE: f32 = 0.5;

/// The std of the finest level's noise in a channel, in steps of 8 bit.
fn noise(model: &CameraModel, channel: usize) -> Known {
    let m = model.noise.known()?;
    let (std, [low, high]) = (m.std(0, MIDDLE)[channel], m.interval_of_std(0, channel, MIDDLE));
    Some([std, low, high].map(|v| 255.0 * f64::from(v)))
}

fn is_metric(frames: &[TrackedCamera]) -> bool {
    let mut kinds = frames.iter().rev().filter_map(|f| f.camera.defocus.known());
    kinds.next().is_some_and(|m| m.depth_kind == DepthKind::Metric)
}

fn summary(frames: &[TrackedCamera], metric: bool) -> Markup {
    // A card shows the range of a number, that of its intervals, and the count of frames in which it is known.
    let card =
        |of: &dyn Fn(&CameraModel) -> Known, text: &dyn Fn(String) -> String, unit: &str, more: &str| {
            let known: Vec<[f64; 3]> = frames.iter().filter_map(|f| of(&f.camera)).collect();
            let [low, high] = plots::extent(known.iter().map(|k| k[0]))?.map(number);
            let range = if low == high { low } else { format!("{low} to {high}") };
            // Infinite ends, as of distances, are ends too.
            let end = |pick: fn(f64, f64) -> f64| known.iter().flat_map(|k| [k[1], k[2]]).reduce(pick);
            let intervals = end(f64::min).zip(end(f64::max));
            Some(Card {
                big: text(range),
                interval: intervals
                    .map(|(low, high)| format!("all intervals {}", interval([low, high], unit))),
                more: format!("{more}; known in {} of {} frames", known.len(), frames.len()),
            })
        };
    let degrees = |m: &CameraModel| {
        let m = m.motion_blur.known()?;
        Some([m.exposure.0, m.interval[0], m.interval[1]].map(|v| 360.0 * f64::from(v)))
    };
    let outside = |m: &CameraModel| m.defocus.known().and_then(|lens| lens.facts().outside);
    let focus = |m: &CameraModel| {
        let [_, known] = lens(m).filter(|_| outside(m).is_none())?;
        Some(if metric { known.map(distance) } else { known })
    };
    let focus_meaning = if metric {
        "what lies there is sharp"
    } else {
        "in relative inverse depth: no unit, larger is nearer"
    };
    cards(|distortion| match distortion {
        Distortion::Defocus => {
            let unit = if metric { " m" } else { "" };
            let within = card(&focus, &|range| format!("Focus at {range}{unit}"), unit, focus_meaning);
            within.or_else(|| {
                let outside: Vec<_> = frames.iter().filter_map(|f| outside(&f.camera)).collect();
                let more = format!("in {} of {} frames", outside.len(), frames.len());
                let big = format!("Focus {}", outside.last()?.words());
                Some(Card { big, interval: None, more })
            })
        }
        Distortion::MotionBlur => {
            card(&degrees, &|range| format!("{range}° shutter"), "°", "360° is the whole frame interval")
        }
        Distortion::Noise => card(
            &|m| noise(m, 1),
            &|range| format!("{range} of 255"),
            "",
            "std of the finest grain of green at middle brightness",
        ),
        other => card(&|m| first(m, other), &|range| range, "", "as in the plot below"),
    })
}

/// The plot of numbers over time, with the changes that were noticed, and its caption; nothing if no number is known.
fn figure<F: Fn(&CameraModel) -> Known>(
    frames: &[TrackedCamera],
    name: &str,
    most: Option<f64>,
    lines: &[(RGBColor, F)],
    distortion: Distortion,
    caption: &Markup,
) -> Part {
    let ends = [&frames[0], &frames[frames.len() - 1]].map(|f| f.frame as f64);
    let course = |(colour, of): &(RGBColor, F)| {
        let known = |f: &TrackedCamera| of(&f.camera).map(|[v, low, high]| [f.frame as f64, v, low, high]);
        let stretches = frames.chunk_by(|a, b| known(a).is_some() == known(b).is_some());
        let stretches = stretches.filter_map(|s| s.iter().map(known).collect()).collect();
        Course { stretches, colour: *colour }
    };
    let courses: Vec<Course> = lines.iter().map(course).collect();
    let changes: Vec<f64> =
        frames.iter().filter(|f| f.changed.of(distortion)).map(|f| f.frame as f64).collect();
    let plot = plots::over_time(name, ends, most, &courses, &changes)?;
    Ok(html! { @if let Some(plot) = plot { figure { (plot) } p.soft { (caption) } } })
}

/// The frames in which a change is told, and the frames without an estimate, with the reason.
fn in_words(frames: &[TrackedCamera], distortion: Distortion) -> Markup {
    let changes: Vec<String> =
        frames.iter().filter(|f| f.changed.of(distortion)).map(|f| f.frame.to_string()).collect();
    let unknown = |f: &TrackedCamera| f.camera.why_unknown(distortion).is_some();
    html! {
        @match &changes[..] {
            [] => {}
            [only] => p { "A change just before frame " (only) "." }
            [others @ .., last] => p { "Changes just before frames " (others.join(", ")) " and " (last) "." }
        }
        @for stretch in frames.chunk_by(|a, b| unknown(a) == unknown(b)) {
            @let (first, last) = (&stretch[0], &stretch[stretch.len() - 1]);
            // Of several reasons, the last one is shown: it held until the end.
            @if let Some(why) = last.camera.why_unknown(distortion) {
                p.unknown {
                    strong {
                        @if first.frame < last.frame { "Unknown in frames " (first.frame) " to " (last.frame) ": " }
                        @else { "Unknown in frame " (first.frame) ": " }
                    }
                    (why.sentence) "."
                }
            }
        }
    }
}
