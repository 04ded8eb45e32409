//! The page of one model.

use crate::defocus::{defocus_section, focus_card};
use crate::exposure::{motion_blur_section, shutter_card};
use crate::noise::{noise_card, noise_section};
use crate::page::{Part, capture, card, cards, footer, page_of, picture, reduced, section, warnings};
use crate::samples::{before_and_after, sample_section};
use crate::{Picture, ReportInput, TruthRow, pictures};
use blindaug::CameraModel;
use blindaug::fit::Diagnostics;
use blindaug::model::{CameraTrack, Distortion};
use maud::{Markup, html};

pub(crate) fn page(input: &ReportInput) -> Part {
    let ReportInput { title, model, diagnostics, samples, comparison, pictures, numbers, provenance } = input;
    let full = samples.iter().map(|s| if s.clean.is_some() { 2 } else { 1 }).sum::<usize>() + pictures.len();
    let share = pictures::share_of_budget(full);
    let track = CameraTrack::from((*model).clone());
    let body = html! {
        (warnings(model))
        (summary(model))
        (before_and_after(&track, samples))
        (truth(comparison))
        (picture_section(pictures, share))
        @for distortion in Distortion::ALL {
            @match distortion {
                Distortion::Defocus => (defocus_section(model, diagnostics)?),
                Distortion::MotionBlur => (motion_blur_section(model, diagnostics, numbers)?),
                Distortion::Noise => (noise_section(model, diagnostics, &track, samples)?),
                other => (section(model, other)),
            }
        }
        (sample_section(&track, samples, share))
        (notes(diagnostics))
    };
    Ok(page_of(title, &capture(model), &body, &footer(model), provenance.as_ref()))
}

fn summary(model: &CameraModel) -> Markup {
    cards(|distortion| match distortion {
        Distortion::Defocus => model.defocus.known().map(focus_card),
        Distortion::MotionBlur => model.motion_blur.known().map(|m| shutter_card(m, model.capture.fps)),
        Distortion::Noise => model.noise.known().map(noise_card),
        other => card(model, other),
    })
}

fn truth(rows: &[TruthRow]) -> Markup {
    html! {
        @if !rows.is_empty() {
            section {
                h2 { "Estimated beside true values" }
                p { "The truth of this clip is known, so the estimates can be checked." }
                div.wide { table {
                    thead { tr { th scope="col" { "Quantity" } th scope="col" { "Estimated" } th scope="col" { "True" } } }
                    tbody { @for r in rows { tr { th scope="row" { (r.name) } td.number data-label="Estimated" { (r.estimated) } td.number data-label="True" { (r.truth) } } } }
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

fn notes(diagnostics: &Diagnostics) -> Markup {
    html! {
        section {
            h2 { "Notes" }
            @if diagnostics.notes.is_empty() { p.soft { "There is nothing to note about this estimate." } }
            @else { ul { @for n in &diagnostics.notes { li { (n) } } } }
        }
    }
}
