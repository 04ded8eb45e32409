//! The report of a camera that was followed: each number over time.

use super::plots::{self, CHANNELS, Course, ESTIMATE, noise_half_width};
use super::words::{distance, number};
use super::{
    Part, Sample, capture, cards, channel_key, footer, page_with, patches, pictures, sample_section,
    write_page,
};
use blindaug::CameraModel;
use blindaug::model::{CameraTrack, Changes, DefocusCurve, DepthKind, TrackedCamera, Unknown};
use blindaug_io::Result;
use maud::{Markup, html};
use plotters::style::RGBColor;
use std::path::Path;

/// What the report of a track shows.
pub struct TrackReportInput<'a> {
    /// Heading of the page, such as the clip's name.
    pub title: String,
    /// What was estimated for each frame.
    pub track: &'a CameraTrack,
    /// A few frames with what is known of them.
    pub samples: Vec<Sample>,
}

/// Writes the report of a track.
///
/// # Errors
/// If the file cannot be written; then nothing is left of it.
pub fn write_track(path: &Path, input: &TrackReportInput) -> Result<()> {
    write_page(path, page(input))
}

fn page(TrackReportInput { title, track, samples }: &TrackReportInput) -> Part {
    let frames = track.frames();
    let last = &frames[frames.len() - 1].camera;
    let metric = is_metric(frames);
    let noise_lines = [0, 1, 2].map(|c| (CHANNELS[c], move |m: &CameraModel| noise(m, c)));
    let body = html! {
        (summary(frames, metric))
        p.soft {
            "Each number is what a frame and those before it tell. Where the footage says nothing of it for a while, the last value stays and its "
            "interval (shaded, 95 %) widens; where nothing was seen of it yet, it is left out. Dashed lines: a change was noticed, which takes up to "
            "three frames."
        }
        section {
            h2 { "Motion blur: the shutter" }
            (figure(frames, "exposure, %", Some(100.0), &[(ESTIMATE, exposure)], |c| c.exposure)?)
            p.soft { "The part of the time from one frame to the next in which the shutter is open." }
            (in_words(frames, |c| c.exposure, |m| m.motion_blur.why_unknown()))
        }
        section {
            h2 { "Depth of field: the lens" }
            (figure(frames, "blur, px", None, &[(ESTIMATE, |m: &CameraModel| Some(lens(m)?[0]))], |c| c.defocus)?)
            p.soft { "Std of the Gaussian that is equivalent to the blur of what is very far" @if !metric { " (at relative inverse depth 0)" } "." }
            (figure(frames, if metric { "focus, 1/m" } else { "focus, relative" }, None, &[(ESTIMATE, |m: &CameraModel| Some(lens(m)?[1]))], |c| c.defocus)?)
            p.soft {
                "The inverse depth that is in focus"
                @if metric { ", in 1/m." } @else { ", relative: without a unit, larger is nearer, and on another scale after a cut." }
            }
            (in_words(frames, |c| c.defocus, |m| m.defocus.why_unknown()))
        }
        section {
            h2 { "Noise: the sensor" }
            (figure(frames, "std, 8-bit steps", None, &noise_lines, |c| c.noise)?)
            p.soft { "The std of the finest grain at luminance " (MIDDLE) ": " (channel_key()) }
            (in_words(frames, |c| c.noise, |m| m.noise.why_unknown()))
            (patches(samples, track))
        }
        (sample_section(track, samples, pictures::share_of_budget(samples.len())))
    };
    Ok(page_with(title, &capture(last), &body, &footer(last)))
}

/// A number and its interval.
type Known = Option<[f64; 3]>;

/// In % of the frame interval.
fn exposure(model: &CameraModel) -> Known {
    let m = model.motion_blur.known()?;
    Some([m.exposure.0, m.interval[0], m.interval[1]].map(|v| 100.0 * f64::from(v)))
}

/// Blur at infinity and focus of a thin lens, the only one that is tracked.
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

/// The luminance at which noise is told.
const MIDDLE: f32 = 0.5;

/// Of the finest level, in 8-bit steps.
fn noise(model: &CameraModel, channel: usize) -> Known {
    let m = model.noise.known()?;
    let (std, half) = (m.levels[0].sigma(MIDDLE)[channel], noise_half_width(m, 0, channel, MIDDLE));
    Some([std, (std - half).max(0.0), std + half].map(|v| 255.0 * f64::from(v)))
}

fn is_metric(frames: &[TrackedCamera]) -> bool {
    let mut kinds = frames.iter().rev().filter_map(|f| f.camera.defocus.known());
    kinds.next().is_some_and(|m| m.depth_kind == DepthKind::Metric)
}

fn summary(frames: &[TrackedCamera], metric: bool) -> Markup {
    // The numbers' range, and in how many frames they are known.
    let card = |of: &dyn Fn(&CameraModel) -> Option<f64>, text: &dyn Fn(String) -> String, more: &str| {
        let known: Vec<f64> = frames.iter().filter_map(|f| of(&f.camera)).collect();
        let [low, high] = plots::extent(known.iter().copied())?.map(number);
        let range = if low == high { low } else { format!("{low} to {high}") };
        Some((text(range), format!("{more}; known in {} of {} frames", known.len(), frames.len())))
    };
    let degrees = |m: &CameraModel| Some(f64::from(m.motion_blur.known()?.exposure.shutter_angle()));
    let focus = |m: &CameraModel| lens(m).map(|[_, [f, ..]]| if metric { distance(f) } else { f });
    let focus_meaning = if metric {
        "what lies there is sharp"
    } else {
        "in relative inverse depth: no unit, larger is nearer"
    };
    cards([
        card(&degrees, &|range| format!("{range}° shutter"), "360° is the whole frame interval"),
        card(&focus, &|range| format!("Focus at {range}{}", if metric { " m" } else { "" }), focus_meaning),
        card(
            &|m| Some(noise(m, 1)?[0]),
            &|range| format!("{range} of 255"),
            "std of the finest grain of green at middle brightness",
        ),
    ])
}

/// Numbers over time, and the changes that were noticed of them.
fn figure<F: Fn(&CameraModel) -> Known>(
    frames: &[TrackedCamera],
    name: &str,
    most: Option<f64>,
    lines: &[(RGBColor, F)],
    changed: impl Fn(Changes) -> bool,
) -> Part {
    let ends = [&frames[0], &frames[frames.len() - 1]].map(|f| f.frame as f64);
    let course = |(colour, of): &(RGBColor, F)| {
        let known = |f: &TrackedCamera| of(&f.camera).map(|[v, low, high]| [f.frame as f64, v, low, high]);
        let stretches = frames.chunk_by(|a, b| known(a).is_some() == known(b).is_some());
        let stretches = stretches.filter_map(|s| s.iter().map(known).collect()).collect();
        Course { stretches, colour: *colour }
    };
    let courses: Vec<Course> = lines.iter().map(course).collect();
    let changes: Vec<f64> = frames.iter().filter(|f| changed(f.changed)).map(|f| f.frame as f64).collect();
    let plot = plots::over_time(name, ends, most, &courses, &changes)?;
    Ok(html! { @if let Some(plot) = plot { figure { (plot) } } })
}

/// When a change was noticed, and when and why there is no estimate.
fn in_words(
    frames: &[TrackedCamera],
    changed: impl Fn(Changes) -> bool,
    why_unknown: impl Fn(&CameraModel) -> Option<&Unknown>,
) -> Markup {
    let changes: Vec<String> =
        frames.iter().filter(|f| changed(f.changed)).map(|f| f.frame.to_string()).collect();
    let unknown = |f: &TrackedCamera| why_unknown(&f.camera).is_some();
    html! {
        @if !changes.is_empty() { p { "A change was noticed in frame " (changes.join(", ")) "." } }
        @for stretch in frames.chunk_by(|a, b| unknown(a) == unknown(b)) {
            @let (first, last) = (&stretch[0], &stretch[stretch.len() - 1]);
            // Of several reasons the last: what was missing to the end.
            @if let Some(why) = why_unknown(&last.camera) {
                p.unknown {
                    strong { "Unknown in frame " (first.frame) @if first.frame < last.frame { " to " (last.frame) } ": " }
                    (why) "."
                }
            }
        }
    }
}
