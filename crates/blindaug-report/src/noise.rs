//! The section of noise.

use crate::numbers::number;
use crate::page::{Card, Part, basis, heading, rgb, steps, swatch, unknown, zoomed};
use crate::pictures;
use crate::plots::{self, CHANNELS};
use blindaug::CameraModel;
use blindaug::Sample;
use blindaug::fit::Diagnostics;
use blindaug::model::{CameraTrack, Distortion, Estimate, NoiseModel};
use maud::{Markup, html};

/// The noise's card.
pub(crate) fn noise_card(m: &NoiseModel) -> Card {
    let [low, mean, high] = m.told_std(0.5).map(|std| std.iter().sum::<f32>() / 3.0);
    Card {
        big: format!("{} of 255", steps(mean)),
        interval: m.lines().interval.is_some().then(|| format!("{} to {}", steps(low), steps(high))),
        more: "std of the noise at middle brightness, mean of red, green and blue".into(),
    }
}

const CHANNEL_NAMES: [&str; 3] = ["Red", "Green", "Blue"];

pub(crate) fn noise_section(
    model: &CameraModel,
    diagnostics: &Diagnostics,
    track: &CameraTrack,
    samples: &[Sample],
) -> Part {
    let noise = model.noise.clone().map(NoiseModel::with_agreeing_lines);
    let plot = plots::noise(&diagnostics.noise_points, noise.known())?;
    Ok(html! {
        section {
            h2 { (heading(Distortion::Noise)) }
            @match &noise {
                Estimate::Known(m) => {
                    p { "The std of the noise, in steps of an 8-bit image (1/255 of full range), all bands together. Luminance Y runs from 0 (black) to 1 (white)." }
                    (noise_table(m))
                    (basis(m.samples(), "local measurements of the std", m.method()))
                    p.soft {
                        @if m.clip() < 1.0 { "The sensor clips at " (steps(m.clip())) " of 255: no noise is added there." }
                        @else if m.clip() > 1.0 { "The footage goes beyond white, up to " (steps(m.clip())) " of 255, and so does its noise." }
                        @else { "No noise is added where the picture is clipped (255 of 255)." }
                    }
                }
                Estimate::Unknown(why) => (unknown(Distortion::Noise, why)),
            }
            @match plot {
                Some(plot) => figure { (plot) figcaption {
                    (channel_key())
                    "· dots: measured"
                    @if diagnostics.noise_points.is_empty() { " (none were kept)" }
                    @if noise.known().is_some() { ", lines: the model, shaded: its 95 % interval" }
                    ". Each panel has its own scale."
                } },
                None => {}
            }
            @if let Some(m) = noise.known() {
                @if let Some(curves) = m.curves() { p.soft {
                    @let [rg, rb, gb] = curves.levels[0].correlation();
                    "The channels share the finest grain: its correlation is " (number(rg.into())) " of red and green, " (number(rb.into()))
                    " of red and blue, " (number(gb.into())) " of green and blue (0: coloured grain, 1: grey grain). Its correlation with the frame before is "
                    (number(curves.temporal_correlation.into())) " (0: grain boils, 1: grain stays in place)."
                } }
                (patches(samples, track))
                h3 { "The numbers of the model" }
                p { "Std = slope × Y + intercept per band and channel, in 8-bit steps, with 95 % intervals." }
                (band_table(m))
            }
        }
    })
}

/// The key of the channels' colours.
pub(crate) fn channel_key() -> Markup {
    html! { @for (name, colour) in CHANNEL_NAMES.iter().zip(CHANNELS) { (swatch(colour)) (name.to_lowercase()) " " } }
}

fn noise_table(m: &NoiseModel) -> Markup {
    html! {
        div.wide { table {
            thead { tr {
                th scope="col" { "Brightness" }
                @for name in CHANNEL_NAMES { th scope="col" { (name) @if m.lines().interval.is_some() { " (95 % interval)" } } }
            } }
            tbody { @for (name, y) in [("Dark, Y = 0.1", 0.1), ("Middle, Y = 0.5", 0.5), ("Bright, Y = 0.9", 0.9)] {
                @let [low, middle, high] = m.told_std(y);
                tr {
                    th scope="row" { (name) }
                    @for c in 0..3 { td.number data-label=(CHANNEL_NAMES[c]) {
                        (steps(middle[c]))
                        @if m.lines().interval.is_some() { " (" (steps(low[c])) " to " (steps(high[c])) ")" }
                    } }
                }
            } }
        } }
    }
}

fn band_table(m: &NoiseModel) -> Markup {
    let cell = |c: usize, value: f32, interval: Option<[f32; 2]>| {
        html! { td.number data-label=(CHANNEL_NAMES[c]) { (steps(value)) @if let Some([low, high]) = interval { " (" (steps(low)) " to " (steps(high)) ")" } } }
    };
    html! {
        div.wide { table {
            thead { tr { th scope="col" { "Band" } th scope="col" { "Number" } @for name in CHANNEL_NAMES { th scope="col" { (name) } } } }
            tbody { @for (level, l) in m.lines().levels.iter().enumerate() {
                @let known = m.lines().interval.map(|i| i[level]);
                tr {
                    th scope="row" rowspan="2" { (level + 1) ": " (plots::band_name(level)) }
                    td { "slope" }
                    @for c in 0..3 { (cell(c, l.slope[c], known.map(|i| i.slope[c]))) }
                }
                tr {
                    td { "intercept" }
                    @for c in 0..3 { (cell(c, l.intercept[c], known.map(|i| i.intercept[c]))) }
                }
            } }
        } }
    }
}

pub(crate) fn patches(samples: &[Sample], track: &CameraTrack) -> Markup {
    let patches = pictures::noise_patches(samples, track);
    html! {
        h3 { "A real patch of noise beside a synthetic one" }
        @if patches.is_empty() {
            p.soft { "The frames shown have no flat part that is large enough." }
        } @else {
            p {
                @if patches.iter().all(|p| p.temporal) {
                    "Left of each pair: the difference of two successive frames along the motion, in which the scene's own texture cancels, where "
                    "they match best. Right: the same of noise of the model over the same picture. Both are four times as large, and have about "
                    "√2 times the noise of one frame. "
                } @else {
                    "The flattest parts of single frames, each beside noise of the model for the same brightness, four times as large; what is left of the "
                    "scene's own texture is in the real patch only. "
                }
                "Shading is taken out of both and contrast is raised alike: grain, colour and strength should look the same. "
                "Below each pair stands what a two-sample test finds, of strength and colour in the two finest octaves."
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
                    br;
                    @if p.test.told_apart() { "differs (p = " (format!("{:.3}", p.test.p)) "): " (p.test.most) }
                    @else { "no difference found (p = " (format!("{:.2}", p.test.p)) ")" }
                    @if !p.flat { br; @if p.temporal { "no part matches the next frame well: this one has texture of the scene" } @else { "no part is flat: this one has texture of the scene" } }
                }
            } } }
        }
    }
}
