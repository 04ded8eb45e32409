//! The parameters of the effect.

use crate::{
    effect::Failure,
    host::{Effect, Properties},
    shot::{Colour, Product, Settings},
};
use blindaug::model::{ExposureFraction, SceneScale};
use blindaug_pipeline::ByHand;
use openfx::sys::{generic::core::*, image_effect_v1::param::*};
use std::ffi::CStr;

/// A parameter.
pub struct Knob {
    /// The name in scripts and projects, which never changes.
    pub name: &'static CStr,
    /// The label at the host.
    pub label: &'static str,
    /// The kind, with the default and the range.
    pub kind: Kind,
    /// What it means, and its unit.
    pub hint: &'static str,
}

/// The kind of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// The path of a file.
    File,
    /// A button.
    Button,
    /// Lines that only the plugin writes.
    Words,
    /// A text that is kept in the project and not shown.
    Hidden,
    /// One of some options; the first is the default.
    Choice(&'static [&'static str]),
    /// On or off, by default.
    Switch(bool),
    /// A number, by default, from a least to a greatest one; sliders end at the last one.
    Number {
        /// The default.
        default: f64,
        /// The least and the greatest value.
        range: [f64; 2],
        /// The greatest value that sliders offer.
        slider: f64,
    },
    /// An integer, by default, from a least to a greatest one.
    Integer {
        /// The default.
        default: i32,
        /// The least and the greatest value.
        range: [i32; 2],
    },
}

/// The name of the camera file's path.
pub const CAMERA: &CStr = c"camera";
/// The name of the button that estimates the camera.
pub const ANALYSE: &CStr = c"analyse";
/// The name of the camera's description.
pub const ABOUT: &CStr = c"about";
/// The name of the estimated camera.
pub const ANALYSED: &CStr = c"analysed";

const OUTPUT: &CStr = c"output";
const COLOUR: &CStr = c"colour";
const MOTION_UP: &CStr = c"motionUp";
const SET_SHUTTER: &CStr = c"setShutter";
const SHUTTER: &CStr = c"shutter";
const SET_FOCUS: &CStr = c"setFocus";
const FOCUS: &CStr = c"focus";
const SET_BLUR: &CStr = c"setBlur";
const BLUR: &CStr = c"blur";
const GRAIN: &CStr = c"grain";
const NOISE: &CStr = c"noise";
const SEED: &CStr = c"seed";
const SET_SCALE: &CStr = c"setSceneScale";
const SCALE: &CStr = c"sceneScale";
const OFFSET: &CStr = c"sceneOffset";
const FRAME_OFFSET: &CStr = c"frameOffset";

/// All parameters, in the order in which hosts show them.
pub const KNOBS: [Knob; 20] = [
    Knob {
        name: CAMERA,
        label: "Camera file",
        kind: Kind::File,
        hint: "camera.json as blindaug estimate writes it, or per-frame models (JSON lines) of blindaug estimate --track. When a file is named, it is used instead of what was analysed.",
    },
    Knob {
        name: ANALYSE,
        label: "Analyse plate",
        kind: Kind::Button,
        hint: "Estimates the camera from the frames of the plate, and keeps it in the project in place of a camera file.",
    },
    Knob {
        name: ABOUT,
        label: "The camera",
        kind: Kind::Words,
        hint: "What the camera file or the analysis says, with 95 % intervals, and what is unknown and why.",
    },
    Knob {
        name: ANALYSED,
        label: "Analysed camera",
        kind: Kind::Hidden,
        hint: "The analysed camera as the text of a camera.json.",
    },
    Knob {
        name: OUTPUT,
        label: "Output",
        kind: Kind::Choice(&["Composite", "Layer"]),
        hint: "Composite: the layer over the plate. Layer: premultiplied, with the noise that the plate lacks there, to be merged over the plate in linear light. Without a plate it is the layer.",
    },
    Knob {
        name: COLOUR,
        label: "Colour",
        kind: Kind::Choice(&["Scene-linear", "sRGB"]),
        hint: "How the values of Source, Plate and Output encode light. Scene-linear: values above 1 are kept. sRGB: display-encoded, as in projects without colour management; composites only.",
    },
    Knob {
        name: MOTION_UP,
        label: "Motion's second channel",
        kind: Kind::Choice(&["Down", "Up"]),
        hint: "The direction in which the vertical motion counts: down as forward.v of blindaug's and most EXR files, or up as Nuke's own.",
    },
    Knob {
        name: SET_SHUTTER,
        label: "Set shutter",
        kind: Kind::Switch(false),
        hint: "Takes the shutter below instead of the camera's.",
    },
    Knob {
        name: SHUTTER,
        label: "Shutter",
        kind: Kind::Number { default: 180.0, range: [0.0, 360.0], slider: 360.0 },
        hint: "Shutter angle, degrees: 360 times the exposure fraction, the share of the frame interval for which the shutter is open.",
    },
    Knob {
        name: SET_FOCUS,
        label: "Set focus",
        kind: Kind::Switch(false),
        hint: "Takes the focus below instead of the camera's. A lens that is not known in metres needs the blur to be set as well.",
    },
    Knob {
        name: FOCUS,
        label: "Focus",
        kind: Kind::Number { default: 2.0, range: [0.01, 10_000.0], slider: 20.0 },
        hint: "Distance in focus, m.",
    },
    Knob {
        name: SET_BLUR,
        label: "Set blur",
        kind: Kind::Switch(false),
        hint: "Takes the blur below instead of the camera's. A lens that is not known in metres needs the focus to be set as well.",
    },
    Knob {
        name: BLUR,
        label: "Blur at infinity",
        kind: Kind::Number { default: 2.0, range: [0.0, 100.0], slider: 20.0 },
        hint: "Std of the blur of what is infinitely far away, px of a frame of full size. 0: everything is sharp.",
    },
    Knob {
        name: GRAIN,
        label: "Grain",
        kind: Kind::Number { default: 1.0, range: [0.0, 100.0], slider: 4.0 },
        hint: "Factor of the noise's std; 1 is the camera's.",
    },
    Knob {
        name: NOISE,
        label: "Noise",
        kind: Kind::Switch(true),
        hint: "Adds the noise that the plate lacks where the layer is.",
    },
    Knob {
        name: SEED,
        label: "Seed",
        kind: Kind::Integer { default: 0, range: [0, i32::MAX] },
        hint: "Seed of the noise, which is a function of the seed and the frame's number.",
    },
    Knob {
        name: SET_SCALE,
        label: "Set scene scale",
        kind: Kind::Switch(false),
        hint: "Relates a lens that is known over relative inverse depth d alone to metres: d = S / Z + O. Without it such a lens cannot be applied.",
    },
    Knob {
        name: SCALE,
        label: "Scene scale S",
        kind: Kind::Number { default: 1.0, range: [1e-6, 1e6], slider: 10.0 },
        hint: "Relative inverse depth of a point 1 m away, less the offset.",
    },
    Knob {
        name: OFFSET,
        label: "Scene offset O",
        kind: Kind::Number { default: 0.0, range: [-1e6, 1e6], slider: 1.0 },
        hint: "Relative inverse depth of a point that is infinitely far away.",
    },
    Knob {
        name: FRAME_OFFSET,
        label: "Frame offset",
        kind: Kind::Integer { default: 0, range: [-10_000_000, 10_000_000] },
        hint: "Frames added to the host's frame number to get the footage's, by which per-frame models and noise go.",
    },
];

/// Describes all parameters to the host.
///
/// # Errors
/// If the host refuses one.
pub fn describe(effect: &Effect) -> Result<(), Failure> {
    KNOBS.iter().try_for_each(|knob| describe_one(effect, knob))
}

fn describe_one(effect: &Effect, knob: &Knob) -> Result<(), Failure> {
    let Knob { name, label, kind, hint } = knob;
    let of_kind = match kind {
        Kind::File | Kind::Words | Kind::Hidden => kOfxParamTypeString,
        Kind::Button => kOfxParamTypePushButton,
        Kind::Choice(_) => kOfxParamTypeChoice,
        Kind::Switch(_) => kOfxParamTypeBoolean,
        Kind::Number { .. } => kOfxParamTypeDouble,
        Kind::Integer { .. } => kOfxParamTypeInteger,
    };
    let refused = || Failure::Sentence(format!("the host refuses the parameter \"{label}\""));
    let p: Properties = effect.define_parameter(of_kind, name).ok_or_else(refused)?;
    p.set_strs(kOfxPropLabel, &[label]);
    p.set_strs(kOfxParamPropHint, &[hint]);
    p.set_strs(kOfxParamPropScriptName, &[&name.to_string_lossy()]);
    match *kind {
        Kind::File => {
            p.set_texts(kOfxParamPropStringMode, &[kOfxParamStringIsFilePath]);
            p.set_int(kOfxParamPropAnimates, 0, 0);
        }
        Kind::Words => {
            p.set_texts(kOfxParamPropStringMode, &[kOfxParamStringIsMultiLine]);
            p.set_strs(kOfxParamPropDefault, &[NO_CAMERA]);
            p.set_int(kOfxParamPropEnabled, 0, 0);
            p.set_int(kOfxParamPropEvaluateOnChange, 0, 0);
            p.set_int(kOfxParamPropAnimates, 0, 0);
        }
        Kind::Hidden => {
            p.set_texts(kOfxParamPropStringMode, &[kOfxParamStringIsMultiLine]);
            p.set_int(kOfxParamPropSecret, 0, 1);
            p.set_int(kOfxParamPropAnimates, 0, 0);
        }
        Kind::Button => {}
        Kind::Choice(options) => {
            p.set_strs(kOfxParamPropChoiceOption, options);
            p.set_int(kOfxParamPropDefault, 0, 0);
            p.set_int(kOfxParamPropAnimates, 0, 0);
        }
        Kind::Switch(default) => p.set_int(kOfxParamPropDefault, 0, default.into()),
        Kind::Number { default, range: [least, greatest], slider } => {
            p.set_doubles(kOfxParamPropDefault, &[default]);
            p.set_doubles(kOfxParamPropMin, &[least]);
            p.set_doubles(kOfxParamPropMax, &[greatest]);
            p.set_doubles(kOfxParamPropDisplayMin, &[least.max(-slider)]);
            p.set_doubles(kOfxParamPropDisplayMax, &[slider]);
        }
        Kind::Integer { default, range: [least, greatest] } => {
            p.set_int(kOfxParamPropDefault, 0, default);
            p.set_int(kOfxParamPropMin, 0, least);
            p.set_int(kOfxParamPropMax, 0, greatest);
            p.set_int(kOfxParamPropDisplayMin, 0, least.max(-1000));
            p.set_int(kOfxParamPropDisplayMax, 0, greatest.min(1000));
        }
    }
    Ok(())
}

/// What the description says where there is no camera.
pub const NO_CAMERA: &str =
    "No camera yet: name a camera file, or connect the plate and press Analyse plate.";

/// The values of the parameters at a time; px are those of a frame of full size.
///
/// # Errors
/// If the host does not have one of them, or gives a value out of its range.
pub fn settings(effect: &Effect, time: f64) -> Result<Settings, Failure> {
    let of = |name: &'static CStr| Value { effect, name, time };
    let set = |switch: &'static CStr, name: &'static CStr| {
        Ok::<_, Failure>(if of(switch).switch()? { Some(of(name).number()? as f32) } else { None })
    };
    let scale = match set(SET_SCALE, SCALE)? {
        Some(scale) => Some(SceneScale { scale, offset: of(OFFSET).number()? as f32 }),
        None => None,
    };
    let grain = of(GRAIN).number()? as f32;
    Ok(Settings {
        product: if of(OUTPUT).choice()? == 0 { Product::Composite } else { Product::Layer },
        colour: if of(COLOUR).choice()? == 0 { Colour::Linear } else { Colour::Srgb },
        motion_up: of(MOTION_UP).choice()? == 1,
        by_hand: ByHand {
            exposure: set(SET_SHUTTER, SHUTTER)?.map(|degrees| ExposureFraction(degrees / 360.0)),
            focus_m: set(SET_FOCUS, FOCUS)?,
            blur_px: set(SET_BLUR, BLUR)?,
            // A factor of 1 changes nothing, also of a noise that is unknown.
            grain: (grain != 1.0).then_some(grain),
            ..ByHand::default()
        },
        no_noise: !of(NOISE).switch()?,
        seed: of(SEED).integer()? as u64,
        scale,
        frame_offset: of(FRAME_OFFSET).integer()?.into(),
    })
}

/// A parameter's value at a time.
struct Value<'a> {
    effect: &'a Effect,
    name: &'static CStr,
    time: f64,
}

impl Value<'_> {
    /// The value, if the host has it, and it is in its range.
    fn checked<T>(&self, value: Option<T>, holds: impl Fn(&T, &Kind) -> bool) -> Result<T, Failure> {
        let Some(knob) = KNOBS.iter().find(|knob| knob.name == self.name) else {
            return Err(Failure::Sentence(format!("there is no parameter {:?}", self.name)));
        };
        let value = value
            .ok_or_else(|| Failure::Sentence(format!("the host has no parameter \"{}\"", knob.label)))?;
        match holds(&value, &knob.kind) {
            true => Ok(value),
            false => {
                let label = knob.label;
                Err(Failure::Sentence(format!("the value of \"{label}\" is out of its range: {}", knob.hint)))
            }
        }
    }

    fn number(&self) -> Result<f64, Failure> {
        self.checked(self.effect.number(self.name, self.time), |v, kind| match kind {
            Kind::Number { range: [least, greatest], .. } => (*least..=*greatest).contains(v),
            _ => false,
        })
    }

    fn integer(&self) -> Result<i32, Failure> {
        let value = self.effect.integer(kOfxParamTypeInteger, self.name, self.time);
        self.checked(value, |v, kind| match kind {
            Kind::Integer { range: [least, greatest], .. } => (*least..=*greatest).contains(v),
            _ => false,
        })
    }

    fn switch(&self) -> Result<bool, Failure> {
        let value = self.effect.integer(kOfxParamTypeBoolean, self.name, self.time);
        Ok(self.checked(value, |_, kind| matches!(kind, Kind::Switch(_)))? != 0)
    }

    fn choice(&self) -> Result<usize, Failure> {
        let value = self.effect.integer(kOfxParamTypeChoice, self.name, self.time);
        let value = value.map(|v| usize::try_from(v).unwrap_or(usize::MAX));
        self.checked(value, |v, kind| match kind {
            Kind::Choice(options) => *v < options.len(),
            _ => false,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_readme_has_a_row_for_each_parameter_with_its_name_and_range() {
        let readme = include_str!("../../README.md");
        for Knob { name, label, kind, .. } in &KNOBS {
            let name = name.to_str().unwrap();
            let row =
                readme.lines().find(|line| line.starts_with("| ") && line.contains(&format!("`{name}`")));
            let row = row.unwrap_or_else(|| panic!("no row for {name}"));
            assert!(row.contains(label), "{row}");
            match kind {
                Kind::Number { default, range: [least, greatest], .. } => {
                    assert!(row.contains(&format!("{least} to {greatest}")), "{row}");
                    assert!(row.contains(&format!("{default}")), "{row}");
                }
                Kind::Choice(options) => assert!(options.iter().all(|o| row.contains(o)), "{row}"),
                _ => {}
            }
        }
        // Negative control: what is no parameter has no row.
        assert!(!readme.contains("`bokehShape`"));
    }

    #[test]
    fn names_differ_and_defaults_are_in_their_ranges() {
        for (i, knob) in KNOBS.iter().enumerate() {
            assert!(KNOBS[..i].iter().all(|other| other.name != knob.name && other.label != knob.label));
            match knob.kind {
                Kind::Number { default, range: [least, greatest], slider } => {
                    assert!(least <= default && default <= slider && slider <= greatest, "{}", knob.label);
                }
                Kind::Integer { default, range } => assert!(range[0] <= default && default <= range[1]),
                _ => {}
            }
        }
    }
}
