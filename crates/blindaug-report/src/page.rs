//! The parts of the pages: the frame around them, tables, cards, and texts that several sections share.

use crate::Provenance;
use crate::numbers::{count, interval, number, tick};
use crate::pictures::Shown;
use crate::plots::PlotError;
use blindaug::CameraModel;
use blindaug::model::{BlurSpace, Distortion, Method, Parameter, Reason, Unknown};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use plotters::style::RGBColor;

/// Part of a page that may have a plot.
pub(crate) type Part = std::result::Result<Markup, PlotError>;

/// A page without outside resources.
pub fn page_with(title: &str, about: &str, body: &Markup, footer: &str) -> Markup {
    page_of(title, about, body, footer, None)
}

/// The same as [`page_with`], with a line on where the page comes from.
pub(crate) fn page_of(
    title: &str,
    about: &str,
    body: &Markup,
    footer: &str,
    from: Option<&Provenance>,
) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                // The browser, too, is told to load nothing from outside.
                meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'";
                title { (title) " · blindaug" }
                style { (PreEscaped(include_str!("page.css"))) }
            }
            body {
                header {
                    h1 { (title) }
                    p.soft { (about) }
                }
                main { (body) }
                footer.soft {
                    p { "Written by blindaug " (env!("CARGO_PKG_VERSION")) ". " (footer) }
                    (provenance(from))
                }
            }
        }
    }
}

pub(crate) fn footer(model: &CameraModel) -> String {
    format!(
        "An interval is the 95 % confidence interval: if the same camera were estimated from many such clips, 95 of 100 intervals \
         would hold the true value. Px are pixels of a frame {} px wide.",
        model.capture.width
    )
}

pub(crate) fn capture(model: &CameraModel) -> String {
    let c = &model.capture;
    let rate = c.fps.map_or("frame rate not known".into(), |f| format!("{} frames per second", tick(f)));
    let frames =
        if c.frames_used == 1 { "1 frame".into() } else { format!("{} frames", count(c.frames_used as u64)) };
    let space = match model.blur_space {
        BlurSpace::Linear => "blur acts on linear light",
        BlurSpace::Encoded => "blur acts on encoded values",
    };
    let stopped = model.stopped.map_or(String::new(), |stopped| format!(" ({stopped})"));
    format!("{} × {} px · {rate} · estimated from {frames}{stopped} · {space}", c.width, c.height)
}

pub(crate) fn method_in_words(method: Method) -> &'static str {
    match method {
        Method::Temporal => "differences of successive frames along the motion",
        Method::Spatial => "the flattest parts of single frames",
        Method::Spectral => "the spectra of image tiles (spectral)",
        Method::Removal => "comparison with clean frames, given or restored (removal)",
        Method::Given => "given, not estimated",
    }
}

pub(crate) fn basis(samples: u64, tiles: &str, method: Method) -> Markup {
    html! { p.basis { "Rests on " (count(samples)) " " (tiles) ". Method: " (method_in_words(method)) "." } }
}

/// The name of a blur estimate's samples, by method.
pub(crate) fn blur_samples(method: Method) -> &'static str {
    if method == Method::Removal { "places" } else { "image tiles" }
}

pub(crate) fn unknown(distortion: Distortion, why: &Unknown) -> Markup {
    let name = capitalised(distortion.name());
    html! { p.unknown { strong { "Unknown: " } (why.sentence) ". " (name) " is not applied to virtual objects." } }
}

pub(crate) fn swatch(RGBColor(r, g, b): RGBColor) -> Markup {
    // A plot's colours are brighter on a dark page.
    html! { span.swatch style=(format!("background:var(--c{r:02x}{g:02x}{b:02x},rgb({r},{g},{b}))")) {} }
}

pub(crate) fn picture(shown: &Shown, alt: &str, class: &str) -> Markup {
    html! { img class=(class) src=(shown.uri) width=(shown.width) height=(shown.height) alt=(alt); }
}

/// A small picture whose pixels are shown `zoom` times as large.
pub(crate) fn zoomed(shown: &Shown, alt: &str, zoom: u32) -> Markup {
    html! { img.zoom src=(shown.uri) width=(zoom * shown.width) height=(zoom * shown.height) alt=(alt); }
}

/// A note that a picture is smaller than the frame, if it is, since noise and blur then look weaker.
pub(crate) fn reduced(shown: &Shown) -> String {
    if shown.reduced <= 1.0 {
        String::new()
    } else {
        format!(" (reduced {} times: noise and blur look weaker here)", number(shown.reduced.into()))
    }
}

/// A row of the table of a section.
pub(crate) struct Row {
    pub name: String,
    pub value: String,
    pub interval: Option<String>,
    pub meaning: String,
}

pub(crate) fn parameter_table(parameters: &[Row]) -> Markup {
    html! {
        div.wide { table {
            thead { tr { th scope="col" { "Quantity" } th scope="col" { "Estimate" } th scope="col" { "95 % interval" } th scope="col" { "What it means" } } }
            tbody { @for p in parameters { tr {
                th scope="row" { (p.name) }
                td.number data-label="Estimate" { (p.value) }
                td.number data-label="95 % interval" { (p.interval.as_deref().unwrap_or("not estimated")) }
                td { (p.meaning) }
            } } }
        } }
    }
}

/// The name of a distortion in the report.
pub(crate) fn title(distortion: Distortion) -> String {
    match distortion {
        Distortion::Defocus => "Depth of field".into(),
        other => capitalised(other.name()),
    }
}

/// The heading of a distortion's section: its name, and the part of the camera that causes it.
pub(crate) fn heading(distortion: Distortion) -> String {
    format!("{}: {}", title(distortion), distortion.part())
}

pub(crate) fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// The section of a distortion that has numbers but no plot of its own.
pub(crate) fn section(model: &CameraModel, distortion: Distortion) -> Markup {
    let rows: Vec<Row> = model.parameters(distortion).iter().map(row).collect();
    html! {
        section {
            h2 { (heading(distortion)) }
            @if let Some(why) = model.why_unknown(distortion) { (unknown(distortion, why)) }
            @if let Some((method, samples)) = model.basis(distortion) {
                (parameter_table(&rows))
                (basis(samples, "samples", method))
            }
        }
    }
}

fn row(p: &Parameter) -> Row {
    let unit = p.unit_after_value();
    Row {
        name: capitalised(p.name),
        value: number(p.value.into()) + &unit,
        interval: p.interval.map(|i| interval(i.map(f64::from), &unit)),
        meaning: p.meaning.into(),
    }
}

/// The headline of a distortion.
pub(crate) struct Card {
    /// The value, or what can be said in its place.
    pub big: String,
    /// The 95 % interval of the value, with its unit.
    pub interval: Option<String>,
    /// What the value means.
    pub more: String,
}

/// A distortion's card: its first number, or the answer that none of the distortion is seen.
pub(crate) fn card(model: &CameraModel, distortion: Distortion) -> Option<Card> {
    match model.why_unknown(distortion) {
        Some(why) if why.reason == Reason::NotSeen => {
            Some(Card { big: "None seen".into(), interval: None, more: why.sentence.clone() })
        }
        _ => {
            let p = model.parameters(distortion).into_iter().next()?;
            Some(Card {
                big: format!("{} {} {}", capitalised(p.name), number(p.value.into()), p.unit),
                interval: p.interval.map(|i| interval(i.map(f64::from), &p.unit_after_value())),
                more: p.meaning.into(),
            })
        }
    }
}

/// The cards of all distortions.
pub(crate) fn cards(known: impl Fn(Distortion) -> Option<Card>) -> Markup {
    html! {
        section aria-label="In short" {
            div.cards { @for distortion in Distortion::ALL {
                div.card {
                    h3 { (title(distortion)) }
                    @match known(distortion) {
                        Some(Card { big, interval, more }) => {
                            p.big { (big) }
                            @if let Some(interval) = interval { p.interval { (interval) " (95 %)" } }
                            p { (more) }
                        }
                        None => { p.big { "Unknown" } p { "The footage cannot tell; the reason is given below." } }
                    }
                }
            } }
        }
    }
}

/// What makes the numbers less sure, above all else.
pub(crate) fn warnings(model: &CameraModel) -> Markup {
    let stopped = model.stopped.map(|s| format!("the estimation was {s}"));
    let all: Vec<&str> = stopped.iter().chain(&model.warnings).map(String::as_str).collect();
    html! {
        @if !all.is_empty() {
            div.warnings role="note" {
                strong { "Before you rely on this" }
                ul { @for sentence in all { li { (capitalised(sentence)) "." } } }
            }
        }
    }
}

/// One line on where the page comes from, for the footer.
pub(crate) fn provenance(of: Option<&Provenance>) -> Markup {
    html! { @if let Some(p) = of {
        p.provenance {
            code { (p.command) } " · blindaug " (p.version) " · " (p.date)
            @for input in &p.inputs { " · " (input.name) @if let Some((hash, of)) = &input.sha256 { ": SHA-256 " code { (hash) } " (" (of) ")" } }
        }
    } }
}

/// An encoded value in steps of 8 bits.
pub(crate) fn steps(v: f32) -> String {
    number(255.0 * f64::from(v))
}

pub(crate) fn rgb(colour: [f32; 3]) -> RGBColor {
    let [r, g, b] = colour.map(|v| (255.0 * v + 0.5) as u8);
    RGBColor(r, g, b)
}
