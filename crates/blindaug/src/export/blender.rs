//! Blender: a Python script that sets shutter and lens, and builds the noise in the compositor.
//!
//! - `render.motion_blur_shutter = lambda` (frames), position CENTER.
//! - The camera is a thin lens whose rays have the same angle wherever it focuses: the circle of confusion at infinity has the
//!   diameter `H (f / N) (f / h) / P` px. The script solves N for the camera's own angle, or sets the angle first.
//! - The noise is added in encoded values by compositor nodes, octave by octave.
//!
//! Source: Blender's `camera.cpp` and manual. The script was run in Blender 4.5 and its render estimated again: docs/engines.md.

use super::{Abilities, Camera, Export, File, filled, grain, head, number, numbers};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Blender 4.2 to 4.5, Cycles (and EEVEE for shutter and lens)",
    motion_blur: "exact",
    defocus: "exact",
    grain: "compositor nodes: the whole model",
    checked: "script run in Blender 4.5, its render estimated blindly",
};

/// The script and its texture.
pub(super) fn export(camera: &Camera) -> Export {
    let none = || String::from("None");
    let mut lost = camera.left.clone();
    lost.extend(grain::full_pass_lost(camera));
    if camera.noise.is_some() {
        lost.push("the view transform is set to Standard, through which values are saved as they are".into());
    }
    let rows = |v: [[f32; 4]; 3]| format!("[{}]", v.map(|v| format!("[{}]", numbers(&v))).join(", "));
    let [slope, intercept] = match &camera.noise {
        Some(noise) => {
            let (slope, intercept) = grain::by_channel(noise);
            [rows(slope), rows(intercept)]
        }
        None => [none(), none()],
    };
    let text = filled(
        include_str!("effects/blender.py"),
        &[
            ("exposure", camera.exposure.map_or_else(none, |e| number(e.0))),
            ("sigma", camera.lens.map_or_else(none, |l| number(l.sigma_px_at_infinity))),
            ("focus", camera.lens.map_or_else(none, |l| number(l.focus_m))),
            ("height", camera.height.to_string()),
            ("fov", camera.fov_y_degrees.map_or_else(none, number)),
            ("slope", slope),
            ("intercept", intercept),
            ("clip", camera.noise.as_ref().map_or_else(none, |n| number(n.clip()))),
            ("bands", grain::BANDS.into()),
            ("gain", number(grain::GAIN)),
            ("side", grain::SIDE.to_string()),
            ("offsets", grain::CHANNEL_OFFSETS.map(|[x, y]| format!("({x}, {y})")).join(", ")),
        ],
    );
    let text =
        head("#", "A camera for Blender: run in the text editor, or blender FILE --python this", &lost)
            + &text;
    let mut files = vec![File::text("blindaug_camera.py", text)];
    if camera.noise.is_some() {
        files.push(File::texture(grain::BANDS, grain::bands()));
    }
    Export { files, lost }
}
