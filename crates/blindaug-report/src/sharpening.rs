//! The section of the camera's own sharpening.

use crate::numbers::{interval, number};
use crate::page::{Parameter, basis, parameter_table, unknown};
use blindaug::CameraModel;
use blindaug::model::{Distortion, Estimate, Reason, SharpeningModel};
use maud::{Markup, html};

pub(crate) fn sharpening_section(model: &CameraModel) -> Markup {
    html! {
        section {
            h2 { "Sharpening: the camera's processing" }
            @match &model.sharpening {
                Estimate::Known(m) => {
                    (parameter_table(&sharpening_parameters(m)))
                    (basis(m.samples, "local measurements of the noise", m.method))
                }
                Estimate::Unknown(why) => (unknown(Distortion::Sharpening, why)),
            }
        }
    }
}

fn sharpening_parameters(m: &SharpeningModel) -> Vec<Parameter> {
    vec![
        Parameter {
            name: "Amount",
            value: number(m.amount.into()),
            interval: Some(interval(m.interval.map(f64::from), "")),
            meaning:
                "An unsharp mask adds this share of the difference between the picture and its blurred copy."
                    .into(),
        },
        Parameter {
            name: "Radius",
            value: format!("{} px", number(m.radius_px.into())),
            interval: None,
            meaning: "Std of the Gaussian that blurs the copy.".into(),
        },
    ]
}

/// The camera's sharpening in short. That none is seen is an answer too.
pub(crate) fn sharpening_card(sharpening: &Estimate<SharpeningModel>) -> Option<(String, String)> {
    match sharpening {
        Estimate::Known(m) => Some((
            format!("Unsharp mask of {}", number(m.amount.into())),
            format!("with a radius of {} px", number(m.radius_px.into())),
        )),
        Estimate::Unknown(why) if why.reason == Reason::NotSeen => {
            Some(("None seen".into(), "fine noise is no stronger than white noise is".into()))
        }
        Estimate::Unknown(_) => None,
    }
}
