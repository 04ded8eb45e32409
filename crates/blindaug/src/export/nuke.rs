//! Nuke: a Group to paste, with an input for the rendered layer and one for the plate, and a knob for each quantity of the camera.
//!
//! - `VectorBlur` along `forward.u`, `forward.v` (px to the next frame): `scale = lambda`, `offset = -0.5`, so that the streak is centred.
//!   Nodes with a shutter (MotionBlur3D, ScanlineRender) take `shutter = lambda` with the offset "centred".
//! - `ZDefocus`, math "depth": a radius of `size |1 - center / Z|` px (half of the circle of confusion): `size = 2 sigma_inf`. Its `filter_type` is a disc, or
//!   bladed with `blades` and `roundness`.
//! - `Merge` puts the layer over the plate, and `Copy` brings the layer's alpha back.
//! - Grain: the whole model in a `MergeExpression`, between two `Colorspace`s, since noise lives in encoded values. Where the layer's alpha
//!   a is partial, a part of the plate's own noise remains, so that only `sqrt(1 - (1 - a)^2)` of the model's noise is added.
//! - The std over luminance also comes as a table, for gizmos that take a look-up curve (DasGrain, ReGrain).
//!
//! Source: Foundry's documentation; not run in Nuke.

use super::{Abilities, Camera, Export, File, Shapes, ThinLens, grain, head, number};
use crate::model::NoiseModel;

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Nuke 13 and later",
    motion_blur: "exact, along the layer's own vectors",
    defocus: "exact",
    bokeh: Shapes { blades: Some([3, 16]), roundness: true, rotation: false, squeeze: false },
    grain: "an expression: the whole model, only what the layer's alpha needs",
    checked: "from the documentation; the group and its wires read by a strict reader; not run in Nuke",
};

/// A knob of the group: a number that an artist sets by hand.
struct Knob {
    name: &'static str,
    label: &'static str,
    tooltip: &'static str,
    /// The ends of the knob's slider; a number beyond can still be typed.
    range: [f32; 2],
    value: f32,
}

impl Knob {
    /// The line that adds the knob, and the one that sets it.
    fn lines(&self) -> String {
        let Self { name, label, tooltip, range: [from, to], value } = self;
        // 7 is Nuke's number of a knob with a floating-point number and a slider.
        format!(
            " addUserKnob {{7 {name} l \"{label}\" t \"{tooltip}\" R {from} {to}}}\n {name} {}\n",
            number(*value)
        )
    }
}

/// The largest radius of the blur that the defocus node makes with these knobs, px: near things blur most, and there is room for things at
/// a third of the focus distance.
fn most_radius(lens: &ThinLens) -> f32 {
    (4.0 * lens.sigma_px_at_infinity).max(100.0)
}

/// The std of the blur that the defocus node makes at a depth in m, px.
fn sigma_px(lens: &ThinLens, depth_m: f32) -> f32 {
    lens.sigma_px(depth_m).min(0.5 * most_radius(lens))
}

/// The knobs of what is known of a camera.
fn knobs(camera: &Camera) -> Vec<Knob> {
    let mut knobs = vec![];
    if let Some(exposure) = camera.exposure {
        knobs.push(Knob {
            name: "exposure",
            label: "exposure",
            tooltip: "The share of the frame interval during which the shutter is open: the length of a streak over the motion to the next frame. 0.5 is a shutter angle of 180 degrees.",
            range: [0.0, 1.0],
            value: exposure.0,
        });
    }
    if let Some(lens) = &camera.lens {
        knobs.push(Knob {
            name: "focus",
            label: "focus, m",
            tooltip: "The distance that is in focus, in the unit of depth.Z: metres.",
            // A slider that reaches three times as far as the focus, in steps of ten.
            range: [0.1, 10.0 * (0.3 * lens.focus_m).ceil().max(1.0)],
            value: lens.focus_m,
        });
        knobs.push(Knob {
            name: "blur",
            label: "blur, px",
            tooltip: "The standard deviation of the blur of things at infinity, in px: half of the radius of a disk. It grows with the width of the picture.",
            range: [0.0, 10.0 * (0.2 * lens.sigma_px_at_infinity).ceil().max(1.0)],
            value: lens.sigma_px_at_infinity,
        });
    }
    if camera.noise.is_some() {
        knobs.push(Knob {
            name: "grain",
            label: "grain amount",
            tooltip: "The strength of the grain: 1 is that of the camera, 0 is none.",
            range: [0.0, 2.0],
            value: 1.0,
        });
    }
    knobs
}

/// The expression of one channel: its value plus `max(s Y + i, 0) (band - 0.5) / gain` summed over the octaves, as far as alpha needs it.
fn expression(noise: &NoiseModel, channel: usize) -> String {
    let [dx, dy] = grain::CHANNEL_OFFSETS[channel];
    let side = grain::SIDE;
    let octaves = noise.lines().levels.iter().zip(["r", "g", "b", "a"]).map(|(level, band)| {
        format!(
            "max({}*luma+{},0)*(A{band}((x+dx+{dx})%{side},(y+dy+{dy})%{side})-0.5)",
            number(level.slope[channel]),
            number(level.intercept[channel])
        )
    });
    let sum = octaves.collect::<Vec<_>>().join("+");
    let (value, clip) = (["Br", "Bg", "Bb"][channel], number(noise.clip()));
    format!(
        "{value}>={clip}?{value}:max(min({value}+amount*sqrt(max(1-(1-Ba)*(1-Ba),0))/{}*({sum}),{clip}),0)",
        number(grain::GAIN)
    )
}

/// The group, the octaves, and the table.
pub(super) fn export(camera: &Camera) -> Export {
    let mut lost = camera.left.clone();
    let knobs = knobs(camera);
    let mut files = vec![];
    // A node takes its inputs from the top of the stack, the first one first, and is put there itself.
    let mut nodes = String::new();
    let mut group = String::new();
    for knob in &knobs {
        group += &knob.lines();
    }
    if camera.noise.is_some() {
        let bands = grain::BANDS;
        // 2 is Nuke's number of a knob with a file.
        group += &format!(
            " addUserKnob {{2 octaves l octaves t \"The path of {bands}, which was written beside these nodes.\"}}\n octaves {bands}\n"
        );
        nodes += "Read {\n inputs 0\n file \"\\[value parent.octaves]\"\n raw true\n name Octaves\n}\n";
    }
    nodes += "Input {\n inputs 0\n number 0\n name layer\n}\n";
    if let Some(lens) = &camera.lens {
        lost.extend(camera.blur_lost(|z| sigma_px(lens, z)));
        lost.push(format!("sizes in px are for pictures {} px wide; depth.Z is in metres", camera.width));
        nodes += "ZDefocus2 {\n channels rgba\n z_channel depth.Z\n math depth\n center {{parent.focus}}\n size {{2*parent.blur}}\n \
                  max_size {{max(4*parent.blur,100)}}\n";
        nodes += &match camera.blades(ABILITIES.bokeh) {
            Some((blades, roundness, _)) => {
                format!(" filter_type bladed\n blades {blades}\n roundness {}\n", number(roundness))
            }
            None => " filter_type disc\n".into(),
        };
        nodes += " name Defocus\n}\n";
    }
    if camera.exposure.is_some() {
        nodes += "VectorBlur {\n channels rgba\n uv forward\n scale {{parent.exposure}}\n offset -0.5\n name MotionBlur\n}\n";
    }
    if camera.noise.is_some() {
        // The layer is needed twice: for the merge, and for its alpha.
        nodes += "set Nlayer [stack 0]\npush $Nlayer\n";
    }
    nodes += "Input {\n inputs 0\n number 1\n name plate\n}\nMerge2 {\n inputs 2\n operation over\n name Over\n}\n";
    if let Some(noise) = &camera.noise {
        let side = grain::SIDE;
        nodes += "Copy {\n inputs 2\n from0 rgba.alpha\n to0 rgba.alpha\n name LayersAlpha\n}\n\
                  Colorspace {\n colorspace_out sRGB\n name Encode\n}\n";
        nodes += &format!(
            "MergeExpression {{\n inputs 2\n temp_name0 luma\n temp_expr0 \"0.299*Br+0.587*Bg+0.114*Bb\"\n temp_name1 dx\n \
             temp_expr1 \"floor({side}*random(frame))\"\n temp_name2 dy\n temp_expr2 \"floor({side}*random(frame+0.5))\"\n \
             temp_name3 amount\n temp_expr3 parent.grain\n"
        );
        for channel in 0..3 {
            nodes += &format!(" expr{channel} \"{}\"\n", expression(noise, channel));
        }
        nodes += " expr3 Ba\n name Grain\n}\nColorspace {\n colorspace_in sRGB\n name Decode\n}\n";
        files.push(File::text("blindaug_grain.csv", grain::table(noise)));
        files.push(File::texture(grain::BANDS, grain::bands()));
    }
    nodes += "Output {\n name Output\n}\n";
    let text = head(
        "#",
        "A camera's effects for Nuke: paste it, and connect the rendered layer and the plate",
        &lost,
    ) + &format!(
        "set cut_paste_input [stack 0]\nversion 13.0 v1\npush 0\npush $cut_paste_input\nGroup {{\n inputs 2\n \
             name Blindaug_Camera\n help \"The layer of the first input over the plate of the second one, as the plate's camera \
             would have filmed it.\"\n addUserKnob {{20 camera l Camera}}\n{group}}}\n{nodes}end_group\n"
    );
    files.insert(0, File::text("blindaug_camera.nk", text));
    Export { files, lost }
}
