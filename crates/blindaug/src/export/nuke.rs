//! Nuke: nodes to paste, for a rendered layer over a plate.
//!
//! - `VectorBlur` along `forward.u`, `forward.v` (px to the next frame): `scale = lambda`, `offset = -0.5`, so that the streak is centred.
//!   Nodes with a shutter (MotionBlur3D, ScanlineRender) take `shutter = lambda` with the offset "centred".
//! - `ZDefocus`, math "depth": a radius of `size |1 - center / Z|` px (half of the circle of confusion): `size = 2 sigma_inf`.
//! - Grain: the whole model in a `MergeExpression`, between two `Colorspace`s, since noise lives in encoded values. Where the layer's alpha
//!   a is partial, a part of the plate's own noise remains, so that only `sqrt(1 - (1 - a)^2)` of the model's noise is added.
//! - The std over luminance also comes as a table, for gizmos that take a look-up curve (DasGrain, ReGrain).
//!
//! Source: Foundry's documentation; not run in Nuke.

use super::{Abilities, Camera, Export, File, grain, head, number};
use crate::model::NoiseModel;

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Nuke 13 and later",
    motion_blur: "exact, along the layer's own vectors",
    defocus: "exact",
    grain: "an expression: the whole model, only what the layer's alpha needs",
    checked: "from the documentation; nodes read by a strict reader; not run in Nuke",
};

/// The numbers of the nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// `VectorBlur.scale`, and the `shutter` of other nodes, in frames.
    pub shutter: Option<f32>,
    /// The settings of `ZDefocus2`, if the lens is known.
    pub defocus: Option<ZDefocus>,
}

/// The settings of `ZDefocus2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZDefocus {
    /// The depth in focus, m.
    pub center: f32,
    /// Radius of the blur at infinity, px.
    pub size: f32,
    /// The largest radius of the blur, px.
    pub max_size: f32,
}

impl ZDefocus {
    /// The std of the blur at this depth in m, px.
    pub fn sigma_px(&self, depth_m: f32) -> f32 {
        0.5 * (self.size * (1.0 - self.center / depth_m).abs()).min(self.max_size)
    }
}

/// The camera as Nuke's numbers.
pub fn settings(camera: &Camera) -> Settings {
    Settings {
        shutter: camera.exposure.map(|e| e.0),
        defocus: camera.lens.map(|lens| {
            let size = 2.0 * lens.sigma_px_at_infinity;
            // Near things blur most: the largest radius has room for things at a third of the focus distance.
            ZDefocus { center: lens.focus_m, size, max_size: (2.0 * size).max(100.0) }
        }),
    }
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
        "{value}>={clip}?{value}:min({value}+sqrt(max(1-(1-Ba)*(1-Ba),0))/{}*({sum}),{clip})",
        number(grain::GAIN)
    )
}

/// The nodes, the octaves, and the table.
pub(super) fn export(camera: &Camera) -> Export {
    let settings = settings(camera);
    let mut lost = camera.left.clone();
    let mut nodes = String::from("set cut_paste_input [stack 0]\nversion 13.0 v1\npush $cut_paste_input\n");
    if let Some(defocus) = settings.defocus {
        lost.extend(camera.blur_lost(|z| defocus.sigma_px(z)));
        lost.push(format!("sizes in px are for pictures {} px wide; depth.Z is in metres", camera.width));
        nodes += &format!(
            "ZDefocus2 {{\n channels rgba\n z_channel depth.Z\n math depth\n center {}\n size {}\n max_size {}\n filter_type disc\n \
             name Blindaug_Defocus\n}}\n",
            number(defocus.center),
            number(defocus.size),
            number(defocus.max_size)
        );
    }
    if let Some(shutter) = settings.shutter {
        nodes += &format!(
            "VectorBlur {{\n channels rgba\n uv forward\n scale {}\n offset -0.5\n label \"shutter {} of the frame, centred\"\n \
             name Blindaug_MotionBlur\n}}\n",
            number(shutter),
            number(shutter)
        );
    }
    let mut files = vec![];
    if let Some(noise) = &camera.noise {
        lost.push("for the grain, the alpha must be the layer's: 1 where it hides the plate, whose own noise stays elsewhere".into());
        let side = grain::SIDE;
        let bands = grain::BANDS;
        nodes += "Colorspace {\n colorspace_out sRGB\n name Blindaug_Encode\n}\nset Nblindaug [stack 0]\n";
        nodes += &format!(
            "Read {{\n inputs 0\n file {bands}\n raw true\n label \"octaves of the noise: set its path\"\n name Blindaug_Bands\n}}\n\
             push $Nblindaug\n"
        );
        nodes += &format!(
            "MergeExpression {{\n inputs 2\n temp_name0 luma\n temp_expr0 \"0.299*Br+0.587*Bg+0.114*Bb\"\n temp_name1 dx\n \
             temp_expr1 \"floor({side}*random(frame))\"\n temp_name2 dy\n temp_expr2 \"floor({side}*random(frame+0.5))\"\n"
        );
        for channel in 0..3 {
            nodes += &format!(" expr{channel} \"{}\"\n", expression(noise, channel));
        }
        nodes += " expr3 Ba\n name Blindaug_Grain\n}\nColorspace {\n colorspace_in sRGB\n name Blindaug_Decode\n}\n";
        files.push(File::text("blindaug_grain.csv", grain::table(noise)));
        files.push(File::texture(bands, grain::bands()));
    }
    let text = head("#", "A camera's effects for Nuke: paste below the rendered layer", &lost) + &nodes;
    files.insert(0, File::text("blindaug_camera.nk", text));
    Export { files, lost }
}
