//! The section of frames, with the motion and depth that were found in them.

use crate::numbers::{metres, number};
use crate::page::{capitalised, picture, reduced, zoomed};
use crate::{balls, pictures};
use blindaug::Sample;
use blindaug::model::{CameraTrack, DepthKind};
use blindaug::{CameraModel, Encoded};
use maud::{Markup, html};

pub(crate) fn sample_section(track: &CameraTrack, samples: &[Sample], share: usize) -> Markup {
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

/// A virtual object in a frame, pasted on and with the camera: of the frames, the one of which most is known.
pub(crate) fn before_and_after(track: &CameraTrack, samples: &[Sample]) -> Markup {
    let known = |s: &Sample| usize::from(s.flow.is_some()) + usize::from(s.inverse_depth.is_some());
    let made = samples
        .iter()
        .max_by_key(|s| known(s))
        .and_then(|s| balls::before_after(s, &track.at(s.number)).ok().flatten());
    html! { @if let Some(balls::BeforeAfter { number: frame, pasted, matched, left_out }) = made {
        section {
            h2 { "Before and after" }
            div.row.pair {
                @for (image, what) in [(&pasted, "pasted on"), (&matched, "with this camera")] {
                    @if let Some(shown) = pictures::shown(image, usize::MAX) { figure {
                        (picture(&shown, &format!("A grey ball and a mirror ball in frame {frame}, {what}"), "fill"))
                        figcaption { (capitalised(what)) }
                    } }
                }
            }
            p.soft {
                "A grey ball and a mirror ball of the program's own in the middle of frame " (frame) ", lit by the picture, as far away as what is behind "
                "them and moving along with it. The camera is all that differs."
                @if !left_out.is_empty() { " Left out, since it or what it needs is unknown: " (left_out.join(", ")) "." }
            }
        }
    } }
}

pub(crate) fn sample(model: &CameraModel, s: &Sample, share: usize) -> Markup {
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

pub(crate) fn depth_scale(model: &CameraModel, low: f64, high: f64) -> String {
    match model.defocus.known().map(|m| m.depth_kind) {
        Some(DepthKind::Metric) => {
            format!("Depth: dark is far ({}), bright is near ({})", metres(low), metres(high))
        }
        _ => format!("Inverse depth: dark is far ({}), bright is near ({})", number(low), number(high)),
    }
}

/// Enlarged crops of the place where blur changes the frame most.
pub(crate) fn details(s: &Sample, clean: &Encoded, synthetic: &Encoded) -> Markup {
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
