//! The report: one HTML file without outside resources that says what was estimated, in plain words, and shows on what
//! it rests.

mod pictures;
pub mod plots;
mod track;
mod words;

use crate::inspect::VISIBLE_PX;
use blindaug::fit::Diagnostics;
use blindaug::model::{
    BlurSpace, CameraTrack, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction, Method,
    MotionBlurModel, NoiseModel, Unknown,
};
use blindaug::{CameraModel, Encoded, Flow, Plane};
use blindaug_io::{Error, Result, write_atomically};
use maud::{DOCTYPE, Markup, PreEscaped, html};
pub use pictures::{Shown, shown};
pub use plots::PlotError;
use plots::{CHANNELS, ESTIMATE, POINTS};
use plotters::style::RGBColor;
use std::path::Path;
pub use track::{TrackReportInput, write_track};
use words::{count, distance, interval, metres, number};

/// What a report shows.
pub struct ReportInput<'a> {
    /// Heading of the page, such as the clip's name.
    pub title: String,
    /// What was estimated.
    pub model: &'a CameraModel,
    /// On what it rests.
    pub diagnostics: &'a Diagnostics,
    /// A few frames with what is known of them.
    pub samples: Vec<Sample>,
    /// Estimated beside true values, where the truth is known.
    pub comparison: Vec<TruthRow>,
    /// More pictures, such as composites.
    pub pictures: Vec<Picture>,
}

/// A frame with what is known of it. All rasters have the frame's size.
pub struct Sample {
    /// The frame's number.
    pub number: u64,
    /// As it was filmed.
    pub frame: Encoded,
    /// To the next frame.
    pub flow: Option<Flow>,
    /// In the unit of the model's defocus.
    pub inverse_depth: Option<Plane>,
    /// Sharp and without noise.
    pub clean: Option<Encoded>,
}

/// A row of the table of estimated and true values.
pub struct TruthRow {
    /// What it is, with its unit.
    pub name: String,
    /// The estimate.
    pub estimated: String,
    /// The truth.
    pub truth: String,
}

/// A picture with a title.
pub struct Picture {
    /// Below the picture.
    pub title: String,
    /// The picture.
    pub image: Encoded,
}

/// Writes the report.
///
/// # Errors
/// If the file cannot be written; then nothing is left of it.
pub fn write(path: &Path, input: &ReportInput) -> Result<()> {
    write_page(path, page(input))
}

fn write_page(path: &Path, page: Part) -> Result<()> {
    let page = page.map_err(|e| Error::new(path, format!("a plot cannot be drawn ({e})")))?;
    write_atomically(path, |partial| std::fs::write(partial, page.into_string()))
}

/// Part of a page that may have a plot.
type Part = std::result::Result<Markup, PlotError>;

fn page(input: &ReportInput) -> Part {
    let ReportInput { title, model, diagnostics, samples, comparison, pictures } = input;
    let full = samples.iter().map(|s| if s.clean.is_some() { 2 } else { 1 }).sum::<usize>() + pictures.len();
    let share = pictures::share_of_budget(full);
    let track = CameraTrack::from((*model).clone());
    let body = html! {
        (summary(model))
        (truth(comparison))
        (picture_section(pictures, share))
        (motion_blur_section(model, diagnostics)?)
        (defocus_section(model, diagnostics)?)
        (noise_section(model, diagnostics, &track, samples)?)
        (sample_section(&track, samples, share))
        (notes(diagnostics))
    };
    Ok(page_with(title, &capture(model), &body, &footer(model)))
}

fn footer(model: &CameraModel) -> String {
    format!(
        "An interval is the 95 % confidence interval: if the same camera were estimated from many such clips, 95 of 100 intervals \
         would hold the true value. Px are pixels of a frame {} px wide.",
        model.capture.width
    )
}

/// A page without outside resources.
pub fn page_with(title: &str, about: &str, body: &Markup, footer: &str) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                // Nothing from outside, by the browser's word as well.
                meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'";
                title { (title) " · camera report" }
                style { (PreEscaped(include_str!("report/page.css"))) }
            }
            body {
                header {
                    h1 { (title) }
                    p.soft { (about) }
                }
                main { (body) }
                footer.soft { p { "Written by blindaug " (env!("CARGO_PKG_VERSION")) ". " (footer) } }
            }
        }
    }
}

fn capture(model: &CameraModel) -> String {
    let c = &model.capture;
    let rate =
        c.fps.map_or("frame rate not known".into(), |f| format!("{} frames per second", words::tick(f)));
    let frames =
        if c.frames_used == 1 { "1 frame".into() } else { format!("{} frames", count(c.frames_used as u64)) };
    let space = match model.blur_space {
        BlurSpace::Linear => "blur acts on linear light",
        BlurSpace::Encoded => "blur acts on encoded values",
    };
    let stopped = model.stopped.map_or(String::new(), |stopped| format!(" ({stopped})"));
    format!("{} × {} px · {rate} · estimated from {frames}{stopped} · {space}", c.width, c.height)
}

fn method_in_words(method: Method) -> &'static str {
    match method {
        Method::Temporal => "differences of successive frames along the motion",
        Method::Spatial => "the flattest parts of single frames",
        Method::Spectral => "the spectra of image tiles (spectral)",
        Method::Removal => "comparison with clean frames, given or restored (removal)",
        Method::Given => "given, not estimated",
    }
}

fn basis(samples: u64, tiles: &str, method: Method) -> Markup {
    html! { p.basis { "Rests on " (count(samples)) " " (tiles) ". Method: " (method_in_words(method)) "." } }
}

/// What a sample of blur is, by method.
fn blur_samples(method: Method) -> &'static str {
    if method == Method::Removal { "places" } else { "image tiles" }
}

fn unknown(what: &str, why: &Unknown) -> Markup {
    html! { p.unknown { strong { "Unknown: " } (why.sentence) ". " (what) " is not applied to virtual objects." } }
}

fn swatch(RGBColor(r, g, b): RGBColor) -> Markup {
    html! { span.swatch style=(format!("background:rgb({r},{g},{b})")) {} }
}

fn picture(shown: &Shown, alt: &str, class: &str) -> Markup {
    html! { img class=(class) src=(shown.uri) width=(shown.width) height=(shown.height) alt=(alt); }
}

/// A small picture whose pixels are shown `zoom` times as large.
fn zoomed(shown: &Shown, alt: &str, zoom: u32) -> Markup {
    html! { img.zoom src=(shown.uri) width=(zoom * shown.width) height=(zoom * shown.height) alt=(alt); }
}

struct Parameter {
    name: &'static str,
    value: String,
    interval: Option<String>,
    meaning: String,
}

fn parameter_table(parameters: &[Parameter]) -> Markup {
    html! {
        div.wide { table {
            thead { tr { th scope="col" { "Quantity" } th scope="col" { "Estimate" } th scope="col" { "95 % interval" } th scope="col" { "What it means" } } }
            tbody { @for p in parameters { tr {
                th scope="row" { (p.name) }
                td.number { (p.value) }
                td.number { (p.interval.as_deref().unwrap_or("not estimated")) }
                td { (p.meaning) }
            } } }
        } }
    }
}

/// The three distortions in short, each as a few large words and more of them, if it is known.
fn cards(shutter_lens_noise: [Option<(String, String)>; 3]) -> Markup {
    html! {
        section aria-label="In short" {
            div.cards { @for (name, known) in ["Motion blur", "Depth of field", "Noise"].into_iter().zip(shutter_lens_noise) {
                div.card {
                    h3 { (name) }
                    @match known {
                        Some((big, more)) => { p.big { (big) } p { (more) } }
                        None => { p.big { "Unknown" } p { "The footage cannot tell; the reason is given below." } }
                    }
                }
            } }
        }
    }
}

fn summary(model: &CameraModel) -> Markup {
    let shutter = model.motion_blur.known().map(|m| {
        let more = match model.capture.fps {
            Some(fps) => format!("open for {} of each frame", seconds(m.exposure.seconds(fps))),
            None => format!("open for {} % of each frame", number(100.0 * f64::from(m.exposure.0))),
        };
        (format!("{}° shutter", number(m.exposure.shutter_angle().into())), more)
    });
    let lens = model.defocus.known().map(|m| match (focus(m), m.depth_kind) {
        (None, _) => ("No blur seen".into(), "everything that was seen is sharp".into()),
        (Some(d), DepthKind::Metric) => (
            format!("Focus at {}", metres(d)),
            sharp_ranges(m)
                .first()
                .map_or("no distance is quite sharp".into(), |r| format!("sharp {}", metric_range(*r))),
        ),
        (Some(d), DepthKind::Relative) => {
            (format!("Focus at {}", number(d)), "in relative inverse depth: no unit, larger is nearer".into())
        }
    });
    let noise = model.noise.known().map(|m| {
        let sigma = total_std(m, 0.5, 0.0);
        let mean = sigma.iter().sum::<f32>() / 3.0;
        (
            format!("{} of 255", steps(mean)),
            "std of the noise at middle brightness, mean of red, green and blue".into(),
        )
    });
    cards([shutter, lens, noise])
}

fn truth(rows: &[TruthRow]) -> Markup {
    html! {
        @if !rows.is_empty() {
            section {
                h2 { "Estimated beside true values" }
                p { "The truth of this clip is known, so the estimates can be checked." }
                div.wide { table {
                    thead { tr { th scope="col" { "Quantity" } th scope="col" { "Estimated" } th scope="col" { "True" } } }
                    tbody { @for r in rows { tr { th scope="row" { (r.name) } td.number { (r.estimated) } td.number { (r.truth) } } } }
                } }
            }
        }
    }
}

fn picture_section(pictures: &[Picture], share: usize) -> Markup {
    html! {
        @if !pictures.is_empty() {
            section {
                h2 { "Pictures" }
                div.row { @for p in pictures { figure {
                    @match pictures::shown(&p.image, share) {
                        Some(s) => { (picture(&s, &p.title, "fill")) figcaption { (p.title) (reduced(&s)) } }
                        None => figcaption { (p.title) ": an empty picture" }
                    }
                } } }
            }
        }
    }
}

/// Says so if a picture is smaller than the frame, since noise and blur then look weaker.
fn reduced(shown: &Shown) -> String {
    if shown.reduced <= 1.0 {
        String::new()
    } else {
        format!(" (reduced {} times: noise and blur look weaker here)", number(shown.reduced.into()))
    }
}

/// A short time in words.
fn seconds(s: f64) -> String {
    if s > 0.0 && s < 0.5 {
        format!("{} ms (1/{} s)", number(1000.0 * s), (1.0 / s).round())
    } else {
        format!("{} s", number(s))
    }
}

fn motion_blur_section(model: &CameraModel, diagnostics: &Diagnostics) -> Part {
    let known = model.motion_blur.known();
    let curve = plots::exposure(&diagnostics.exposure_curve, known)?;
    let per_frame = plots::exposure_per_frame(&diagnostics.exposure_per_frame, known, &diagnostics.shots)?;
    Ok(html! {
        section {
            h2 { "Motion blur: the shutter" }
            @match &model.motion_blur {
                Estimate::Known(m) => {
                    (parameter_table(&shutter_parameters(m, model.capture.fps)))
                    (basis(m.samples, blur_samples(m.method), m.method))
                }
                Estimate::Unknown(why) => (unknown("Motion blur", why)),
            }
            @match curve {
                Some(plot) => figure { (plot) figcaption {
                    "How well each exposure explains the frames: the higher, the better. "
                    @if known.is_some() { (swatch(ESTIMATE)) "the estimate and its 95 % interval. " }
                    @if known.is_some_and(|m| m.method == Method::Removal) { "Drawn is minus the error of re-blurred given clean frames, scaled as a log-likelihood, or, without such, the evidence." }
                } },
                None => @if known.is_some() { p.soft { "There is no likelihood curve for this estimate." } },
            }
            @if let Some(plot) = per_frame {
                figure { (plot) figcaption {
                    (swatch(POINTS)) "what each frame says alone"
                    @if !diagnostics.shots.is_empty() { ", " (swatch(ESTIMATE)) "what each shot says alone and its interval" }
                    @else if known.is_some() { ", " (swatch(ESTIMATE)) "the estimate from all frames and its interval" }
                    ". Points that scatter about one value speak for it; a trend would mean that the shutter changed."
                } }
            }
        }
    })
}

fn shutter_parameters(m: &MotionBlurModel, fps: Option<f64>) -> Vec<Parameter> {
    let of =
        |f: &dyn Fn(ExposureFraction) -> f64| (f(m.exposure), m.interval.map(|v| f(ExposureFraction(v))));
    let (share, share_interval) = of(&|e| 100.0 * f64::from(e.0));
    let (angle, angle_interval) = of(&|e| e.shutter_angle().into());
    let time = match fps {
        Some(fps) => {
            let (time, between) = of(&|e| 1000.0 * e.seconds(fps));
            Parameter {
                name: "Exposure time",
                value: seconds(time / 1000.0),
                interval: Some(interval(between, " ms")),
                meaning: format!(
                    "What the camera's display would show at {} frames per second.",
                    words::tick(fps)
                ),
            }
        }
        None => Parameter {
            name: "Exposure time",
            value: "not known".into(),
            interval: None,
            meaning: "It needs the frame rate, which an image sequence does not tell: give it with --fps."
                .into(),
        },
    };
    vec![
        Parameter {
            name: "Exposure",
            value: format!("{} %", number(share)),
            interval: Some(interval(share_interval, " %")),
            meaning: "The part of the time from one frame to the next in which the shutter is open. At 0 % moving things stay sharp, at \
                      100 % they are smeared over their whole way."
                .into(),
        },
        Parameter {
            name: "Shutter angle",
            value: format!("{}°", number(angle)),
            interval: Some(interval(angle_interval, "°")),
            meaning: "The same in film makers' degrees: 360° is the whole frame interval, 180° the usual look of films.".into(),
        },
        time,
    ]
}

/// The inverse depth that is sharpest; `None` if nothing is blurred.
fn focus(m: &DefocusModel) -> Option<f64> {
    match m.curve {
        DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, .. } => {
            (s > 0.0).then(|| f.into())
        }
        DefocusCurve::Quadratic { inverse_depth_range, .. } => {
            let all = places(inverse_depth_range);
            if all.iter().all(|&d| m.sigma_px(d as f32) < 0.01) {
                return None;
            }
            // Where a whole stretch is sharp, its middle.
            let least = all.iter().map(|&d| m.sigma_px(d as f32)).fold(f32::INFINITY, f32::min);
            let sharp: Vec<f64> = all.into_iter().filter(|&d| m.sigma_px(d as f32) <= least + 1e-4).collect();
            sharp.get(sharp.len() / 2).copied()
        }
    }
}

fn places([low, high]: [f32; 2]) -> Vec<f64> {
    const STEPS: usize = 1000;
    (0..=STEPS).map(|i| f64::from(low) + f64::from(high - low) * i as f64 / STEPS as f64).collect()
}

/// The inverse depths, low and high, between which blur stays below what is seen; the low end may be below 0: up to
/// infinity.
fn sharp_ranges(m: &DefocusModel) -> Vec<[f64; 2]> {
    match m.curve {
        DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, .. } => {
            vec![thin_lens_range(s.into(), f.into())]
        }
        DefocusCurve::Quadratic { inverse_depth_range, .. } => {
            let mut ranges: Vec<[f64; 2]> = vec![];
            let mut inside = false;
            for d in places(inverse_depth_range) {
                let sharp = m.sigma_px(d as f32) < VISIBLE_PX;
                match ranges.last_mut() {
                    Some(r) if sharp && inside => r[1] = d,
                    _ if sharp => ranges.push([d, d]),
                    _ => {}
                }
                inside = sharp;
            }
            ranges
        }
    }
}

fn thin_lens_range(s: f64, f: f64) -> [f64; 2] {
    let reach = f64::from(VISIBLE_PX) / s;
    if s > 0.0 { [f * (1.0 - reach), f * (1.0 + reach)] } else { [f64::NEG_INFINITY, f64::INFINITY] }
}

/// "from 0.8 m to 1.2 m" of inverse depths in 1/m.
fn metric_range([low, high]: [f64; 2]) -> String {
    let near = distance(high);
    match distance(low) {
        far if far.is_infinite() && (near == 0.0 || high.is_infinite()) => "at every distance".into(),
        far if far.is_infinite() => format!("from {} m on", number(near)),
        far => format!("from {} to {} m", number(near), number(far)),
    }
}

fn defocus_section(model: &CameraModel, diagnostics: &Diagnostics) -> Part {
    let known = model.defocus.known();
    let plot = plots::defocus(&diagnostics.blur_points, known)?;
    let points = diagnostics.blur_points.len();
    Ok(html! {
        section {
            h2 { "Depth of field: the lens" }
            @match &model.defocus {
                Estimate::Known(m) => {
                    (parameter_table(&lens_parameters(m)))
                    (basis(m.samples, blur_samples(m.method), m.method))
                    @if m.depth_kind == DepthKind::Relative {
                        p.soft { "Depth is known up to a scale and an offset only, so there are no metres here. Compositing needs the relation to metres (--scene-scale, or real depth)." }
                    }
                }
                Estimate::Unknown(why) => (unknown("Defocus", why)),
            }
            @match plot {
                Some(plot) => figure { (plot) figcaption {
                    @if points > 0 { (swatch(POINTS)) "the blur that fits each place best alone, the darker the more it says; " }
                    @if let Some(m) = known {
                        (swatch(ESTIMATE)) "the fitted curve"
                        @if matches!(m.curve, DefocusCurve::ThinLens { interval: Some(_), .. }) { " with both of its numbers anywhere in their 95 % intervals" }
                        "; "
                    }
                    "dashed: " (words::tick(VISIBLE_PX.into())) " px, where blur starts to show."
                    @if points == 0 { " No measured places were kept." }
                } },
                None => @if known.is_some() { p.soft { "There is nothing to plot for this estimate." } },
            }
        }
    })
}

fn lens_parameters(m: &DefocusModel) -> Vec<Parameter> {
    let metric = m.depth_kind == DepthKind::Metric;
    let place = |d: f64| if metric { metres(d) } else { number(d) };
    let place_interval = |[a, b]: [f64; 2]| {
        if metric { interval([distance(a), distance(b)], " m") } else { interval([a, b], "") }
    };
    let focus_name = if metric { "Focus distance" } else { "Focus (relative inverse depth)" };
    let ranges = sharp_ranges(m);
    let range_value = if ranges.is_empty() {
        "nowhere".into()
    } else if metric {
        ranges.iter().map(|r| metric_range(*r)).collect::<Vec<_>>().join("; ")
    } else {
        ranges.iter().map(|r| interval(*r, "")).collect::<Vec<_>>().join("; ")
    };
    let range = |interval: Option<String>| Parameter {
        name: "Blur stays below 0.5 px",
        value: range_value.clone(),
        interval,
        meaning: "Outside this range blur starts to show.".into(),
    };
    match m.curve {
        DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval: known } => {
            let ends = known.map(|i| {
                let corners: Vec<[f64; 2]> = i
                    .sigma_px_at_infinity
                    .iter()
                    .flat_map(|&s| i.focus_inverse_depth.map(|f| thin_lens_range(s.into(), f.into())))
                    .collect();
                let extreme = |end: usize| {
                    let values = corners.iter().map(|c| c[end]);
                    [values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max)]
                };
                let (far, near) = (place_interval(extreme(0)), place_interval(extreme(1)));
                format!("near end {near}\nfar end {far}")
            });
            vec![
                Parameter {
                    name: focus_name,
                    value: place(f.into()),
                    interval: known.map(|i| place_interval(i.focus_inverse_depth.map(f64::from))),
                    meaning: "What lies here is sharp.".into(),
                },
                range(ends),
                Parameter {
                    name: if metric { "Blur at infinity" } else { "Blur at relative inverse depth 0" },
                    value: format!("{} px", number(s.into())),
                    interval: known.map(|i| interval(i.sigma_px_at_infinity.map(f64::from), " px")),
                    meaning: format!(
                        "Std of the Gaussian that is equivalent to the blur of what is very far. A round aperture turns a point of light \
                         there into a disk {} px across.",
                        number(4.0 * f64::from(s))
                    ),
                },
            ]
        }
        DefocusCurve::Quadratic { a, b, c, inverse_depth_range: [low, high] } => {
            let (low, high) = (f64::from(low), f64::from(high));
            let mut rows = vec![range(None)];
            if let Some(d) = focus(m) {
                rows.insert(
                    0,
                    Parameter {
                        name: focus_name,
                        value: place(d),
                        interval: None,
                        meaning: "What lies here is sharpest.".into(),
                    },
                );
            }
            rows.push(Parameter {
                name: "Blur at the far and the near end",
                value: format!("{} px, {} px", number(m.sigma_px(low as f32).into()), number(m.sigma_px(high as f32).into())),
                interval: None,
                meaning: format!(
                    "Std of the equivalent Gaussian at the farthest and the nearest depth that was seen ({} and {}); beyond, it is taken as constant.",
                    place(low),
                    place(high)
                ),
            });
            let unit = if metric { " with d in 1/m" } else { " with d relative" };
            rows.push(Parameter {
                name: "Curve",
                value: format!("{} d² + {} d + {}", number(a.into()), number(b.into()), number(c.into())),
                interval: None,
                meaning: format!("Blur std in px over inverse depth d{unit}. Its three numbers depend on each other; the plot shows how far the points scatter."),
            });
            rows
        }
    }
}

/// An encoded value in steps of 8 bits.
fn steps(v: f32) -> String {
    number(255.0 * f64::from(v))
}

/// The std of the whole noise per channel at luminance `y`; each band's std is moved by `shift` of half its interval.
fn total_std(m: &NoiseModel, y: f32, shift: f32) -> [f32; 3] {
    pictures::total_std(m, |level, c| {
        let std = m.levels[level].sigma(y)[c] + shift * plots::noise_half_width(m, level, c, y);
        std.max(0.0)
    })
}

const CHANNEL_NAMES: [&str; 3] = ["Red", "Green", "Blue"];

fn noise_section(
    model: &CameraModel,
    diagnostics: &Diagnostics,
    track: &CameraTrack,
    samples: &[Sample],
) -> Part {
    let plot = plots::noise(&diagnostics.noise_points, model.noise.known())?;
    Ok(html! {
        section {
            h2 { "Noise: the sensor" }
            @match &model.noise {
                Estimate::Known(m) => {
                    p { "The std of the noise, in steps of an 8-bit image (1/255 of full range), all bands together. Luminance Y runs from 0 (black) to 1 (white)." }
                    (noise_table(m))
                    (basis(m.samples, "local measurements of the std", m.method))
                    p.soft {
                        @if m.clip < 1.0 { "The sensor clips at " (steps(m.clip)) " of 255: no noise is added there." }
                        @else { "No noise is added where the picture is clipped (255 of 255)." }
                    }
                }
                Estimate::Unknown(why) => (unknown("Noise", why)),
            }
            @match plot {
                Some(plot) => figure { (plot) figcaption {
                    (channel_key())
                    "· dots: measured"
                    @if diagnostics.noise_points.is_empty() { " (none were kept)" }
                    @if model.noise.known().is_some() { ", lines: the model, shaded: its 95 % interval" }
                    ". Each panel has its own scale."
                } },
                None => {}
            }
            @if let Some(m) = model.noise.known() {
                (patches(samples, track))
                h3 { "The numbers of the model" }
                p { "Std = slope × Y + intercept per band and channel, in 8-bit steps, with 95 % intervals." }
                (band_table(m))
            }
        }
    })
}

/// Which colour stands for which channel.
fn channel_key() -> Markup {
    html! { @for (name, colour) in CHANNEL_NAMES.iter().zip(CHANNELS) { (swatch(colour)) (name.to_lowercase()) " " } }
}

fn noise_table(m: &NoiseModel) -> Markup {
    html! {
        div.wide { table {
            thead { tr {
                th scope="col" { "Brightness" }
                @for name in CHANNEL_NAMES { th scope="col" { (name) @if m.interval.is_some() { " (95 % interval)" } } }
            } }
            tbody { @for (name, y) in [("Dark, Y = 0.1", 0.1), ("Middle, Y = 0.5", 0.5), ("Bright, Y = 0.9", 0.9)] {
                @let [low, middle, high] = [-1.0, 0.0, 1.0].map(|shift| total_std(m, y, shift));
                tr {
                    th scope="row" { (name) }
                    @for c in 0..3 { td.number {
                        (steps(middle[c]))
                        @if m.interval.is_some() { " (" (steps(low[c])) " to " (steps(high[c])) ")" }
                    } }
                }
            } }
        } }
    }
}

fn band_table(m: &NoiseModel) -> Markup {
    let cell = |value: f32, interval: Option<[f32; 2]>| {
        html! { td.number { (steps(value)) @if let Some([low, high]) = interval { " (" (steps(low)) " to " (steps(high)) ")" } } }
    };
    html! {
        div.wide { table {
            thead { tr { th scope="col" { "Band" } th scope="col" { "Number" } @for name in CHANNEL_NAMES { th scope="col" { (name) } } } }
            tbody { @for (level, l) in m.levels.iter().enumerate() {
                @let known = m.interval.map(|i| i[level]);
                tr {
                    th scope="row" rowspan="2" { (level + 1) ": " (plots::band_name(level)) }
                    td { "slope" }
                    @for c in 0..3 { (cell(l.slope[c], known.map(|i| i.slope[c]))) }
                }
                tr {
                    td { "intercept" }
                    @for c in 0..3 { (cell(l.intercept[c], known.map(|i| i.intercept[c]))) }
                }
            } }
        } }
    }
}

fn patches(samples: &[Sample], track: &CameraTrack) -> Markup {
    let patches = pictures::noise_patches(samples, track);
    html! {
        h3 { "A real patch of noise beside a synthetic one" }
        @if patches.is_empty() {
            p.soft { "The frames shown have no flat part that is large enough." }
        } @else {
            p {
                "The flattest parts of the frames, each beside noise of the model for the same brightness, four times as large. Shading is taken "
                "out of both and contrast is raised alike: grain, colour and strength should look the same. What is left of the scene's own texture is in the real patch only."
            }
            div.patches { @for p in &patches { figure {
                div.two {
                    (zoomed(&p.real, &format!("Real noise at luminance {}", number(p.y.into())), 4))
                    (zoomed(&p.synthetic, &format!("Synthetic noise at luminance {}", number(p.y.into())), 4))
                }
                figcaption {
                    "left real, right synthetic" br;
                    "frame " (p.number) ", Y = " (number(p.y.into())) " "
                    (swatch(rgb(p.colour))) br;
                    "std of luminance " (steps(p.sigma[0])) " and " (steps(p.sigma[1])) " of 255" br;
                    "contrast × " (number(p.gain.into()))
                    @if !p.flat { br; "no part is flat: this one has texture of the scene" }
                }
            } } }
        }
    }
}

fn rgb(colour: [f32; 3]) -> RGBColor {
    let [r, g, b] = colour.map(|v| (255.0 * v + 0.5) as u8);
    RGBColor(r, g, b)
}

fn sample_section(track: &CameraTrack, samples: &[Sample], share: usize) -> Markup {
    html! {
        section {
            h2 { "Frames" }
            @if samples.is_empty() { p.soft { "No frames were kept for this report." } }
            @for s in samples { (sample(&track.at(s.number), s, share)) }
            @if samples.iter().any(|s| s.flow.is_some()) {
                @if let Some(wheel) = pictures::flow_wheel() {
                    figure {
                        (picture(&wheel, "Colour wheel: each direction of motion has its hue", "wheel"))
                        figcaption { "Colours of the motion: hue is the direction, saturation the speed; grey is unknown." }
                    }
                }
            }
        }
    }
}

fn sample(model: &CameraModel, s: &Sample, share: usize) -> Markup {
    let number_of = s.number;
    let frame = pictures::shown(&s.frame, share);
    let synthetic = s.clean.as_ref().map(|clean| (clean, pictures::resynthesised(clean, s, model)));
    html! {
        h3 { "Frame " (number_of) }
        div.row {
            figure { @match &frame {
                Some(shown) => { (picture(shown, &format!("Frame {number_of} as filmed"), "fill")) figcaption { "As filmed" (reduced(shown)) } }
                None => figcaption { "The frame is empty." }
            } }
            @match &synthetic {
                Some((_, Ok((image, missing)))) => figure { @if let Some(shown) = pictures::shown(image, share) {
                    (picture(&shown, &format!("Frame {number_of} re-synthesised from the clean frame"), "fill"))
                    figcaption {
                        "Re-synthesised: the clean frame with the camera model's blur and noise"
                        @if !missing.is_empty() { ", without " (missing.join(", ")) " (no estimate, or no flow or depth)" }
                        (reduced(&shown))
                    }
                } @else { figcaption { "The clean frame is empty." } } },
                Some((_, Err(e))) => p.soft { "It could not be re-synthesised: " (e.to_string()) "." }
                None => {}
            }
        }
        @if let Some((clean, Ok((image, _)))) = &synthetic { (details(s, clean, image)) }
        @if s.clean.is_none() && frame.is_some() {
            p.soft { "There is no clean frame of this one, so blur cannot be shown re-synthesised; the patches above compare noise." }
        }
        @if s.flow.is_some() || s.inverse_depth.is_some() {
            div.row.small {
                @if let Some((shown, full)) = s.flow.as_ref().and_then(pictures::flow) { figure {
                    (picture(&shown, &format!("Optical flow of frame {number_of}"), "fill"))
                    figcaption { "Motion to the next frame; full colour: " (number(full.into())) " px" }
                } }
                @match s.inverse_depth.as_ref().map(pictures::inverse_depth) {
                    Some(Some((shown, [low, high]))) => figure {
                        (picture(&shown, &format!("Inverse depth of frame {number_of}"), "fill"))
                        figcaption { (depth_scale(model, low.into(), high.into())) }
                    },
                    Some(None) => p.soft { "The depth of this frame has no reading." }
                    None => {}
                }
            }
        }
    }
}

fn depth_scale(model: &CameraModel, low: f64, high: f64) -> String {
    match model.defocus.known().map(|m| m.depth_kind) {
        Some(DepthKind::Metric) => {
            format!("Depth: dark is far ({}), bright is near ({})", metres(low), metres(high))
        }
        _ => format!("Inverse depth: dark is far ({}), bright is near ({})", number(low), number(high)),
    }
}

/// Where blur changes most, from near.
fn details(s: &Sample, clean: &Encoded, synthetic: &Encoded) -> Markup {
    let crops =
        pictures::detail(&s.frame, clean).filter(|_| synthetic.0.size() == s.frame.0.size()).map(|part| {
            [("Clean", clean), ("As filmed", &s.frame), ("Re-synthesised", synthetic)]
                .map(|(name, frame)| (name, pictures::crop(frame, part)))
        });
    html! {
        @if let Some(crops) = crops {
            p.soft { "Where blur and noise change the picture most, three times as large:" }
            div.patches { @for (name, crop) in &crops { @if let Some(crop) = crop { figure {
                (zoomed(crop, &format!("Frame {}, a detail: {name}", s.number), 3))
                figcaption { (name) }
            } } } }
        }
    }
}

fn notes(diagnostics: &Diagnostics) -> Markup {
    html! {
        section {
            h2 { "Notes" }
            @if diagnostics.notes.is_empty() { p.soft { "Nothing was left out or chosen that would need a word." } }
            @else { ul { @for n in &diagnostics.notes { li { (n) } } } }
        }
    }
}

#[cfg(test)]
mod tests;
