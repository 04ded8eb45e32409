//! The section of motion blur.

use crate::numbers::{interval, number, tick};
use crate::page::{Card, Part, Row, basis, blur_samples, heading, parameter_table, swatch, unknown};
use crate::plots::{self, ESTIMATE, POINTS};
use blindaug::CameraModel;
use blindaug::fit::Diagnostics;
use blindaug::model::{Distortion, Estimate, ExposureFraction, Method, MotionBlurModel};
use maud::html;

pub(crate) fn motion_blur_section(model: &CameraModel, diagnostics: &Diagnostics, numbers: &[u64]) -> Part {
    let known = model.motion_blur.known();
    let curve = plots::exposure(&diagnostics.exposure_curve, known)?;
    let Diagnostics { exposure_per_frame, shots, .. } = diagnostics;
    let per_frame = plots::exposure_per_frame(exposure_per_frame, known, shots, numbers)?;
    Ok(html! {
        section {
            h2 { (heading(Distortion::MotionBlur)) }
            @match &model.motion_blur {
                Estimate::Known(m) => {
                    (parameter_table(&shutter_parameters(m, model.capture.fps)))
                    (basis(m.samples, blur_samples(m.method), m.method))
                }
                Estimate::Unknown(why) => {
                    (unknown(Distortion::MotionBlur, why))
                    // The middle of all exposures is no better than another one.
                    @if let Some(m) = MotionBlurModel::middle(why).filter(|m| m.interval[1] - m.interval[0] < 0.95) { p.soft {
                        "A composite that shall have motion blur nevertheless can take the middle of the exposures that fit, "
                        (number(m.exposure.0.into())) " of the frame interval (" code { "composite --unknown middle" } ")."
                    } }
                },
            }
            @match curve {
                Some(plot) => figure { (plot) figcaption {
                    "How well each exposure explains the frames: the higher, the better. "
                    @if known.is_some() { (swatch(ESTIMATE)) "the estimate and its 95 % interval. " }
                    @if known.is_some_and(|m| m.method == Method::Removal) { "The curve is minus the error of the given clean frames when blurred again, scaled as a log-likelihood; if none were given, it is the log evidence of each exposure." }
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

fn shutter_parameters(m: &MotionBlurModel, fps: Option<f64>) -> Vec<Row> {
    let of =
        |f: &dyn Fn(ExposureFraction) -> f64| (f(m.exposure), m.interval.map(|v| f(ExposureFraction(v))));
    let (share, share_interval) = of(&|e| 100.0 * f64::from(e.0));
    let (angle, angle_interval) = of(&|e| e.shutter_angle().into());
    let time = match fps {
        Some(fps) => {
            let (time, between) = of(&|e| 1000.0 * e.seconds(fps));
            Row {
                name: "Exposure time".into(),
                value: seconds(time / 1000.0),
                interval: Some(interval(between, " ms")),
                meaning: format!("What the camera's display would show at {} frames per second.", tick(fps)),
            }
        }
        None => Row {
            name: "Exposure time".into(),
            value: "not known".into(),
            interval: None,
            meaning:
                "It needs the frame rate, which an image sequence does not tell: give it to the estimate."
                    .into(),
        },
    };
    let mut rows = vec![
        Row {
            name: "Exposure".into(),
            value: format!("{} %", number(share)),
            interval: Some(interval(share_interval, " %")),
            meaning: "The part of the time from one frame to the next in which the shutter is open. At 0 % moving things stay sharp, at \
                      100 % they are smeared over their whole way."
                .into(),
        },
        Row {
            name: "Shutter angle".into(),
            value: format!("{}°", number(angle)),
            interval: Some(interval(angle_interval, "°")),
            meaning: "The same in film makers' degrees: 360° is the whole frame interval, 180° the usual look of films.".into(),
        },
        time,
    ];
    rows.extend(m.phase_degrees.map(|phase| Row {
        name: "Shutter phase".into(),
        value: format!("{}°", number(phase.into())),
        interval: None,
        meaning: "When the shutter opens: 0° is the frame's time, minus half the shutter angle is centred on it. It was given.".into(),
    }));
    rows
}

/// The shutter's card.
pub(crate) fn shutter_card(m: &MotionBlurModel, fps: Option<f64>) -> Card {
    let angles = m.interval.map(|v| f64::from(ExposureFraction(v).shutter_angle()));
    let more = match fps {
        Some(fps) => format!("open for {} of each frame", seconds(m.exposure.seconds(fps))),
        None => format!("open for {} % of each frame", number(100.0 * f64::from(m.exposure.0))),
    };
    let estimated = m.method != Method::Given;
    // No shutter is open for no time: what may be that short is known from above.
    if estimated && angles[0] < 0.5 && m.exposure.0 < 0.02 {
        let most = ExposureFraction(m.interval[1]);
        return Card {
            big: format!("below {:.0}° shutter", angles[1].ceil()),
            interval: None,
            more: match fps {
                Some(fps) => format!("open for less than {} of each frame", seconds(most.seconds(fps))),
                None => format!("open for less than {:.0} % of each frame", (100.0 * most.0).ceil()),
            },
        };
    }
    Card {
        big: format!("{}° shutter", number(m.exposure.shutter_angle().into())),
        interval: estimated.then(|| interval(angles, "°")),
        more,
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
