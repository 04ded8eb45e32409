//! Blender: a Python script that sets shutter and lens, and builds the noise in the compositor.
//!
//! - `render.motion_blur_shutter = lambda` (frames). The position is START, CENTER or END, whichever is nearest to the shutter's phase.
//! - The camera is a thin lens whose rays have the same angle wherever it focuses: the circle of confusion at infinity has the
//!   diameter `H (f / N) (f / h) / P` px. The script solves N for the camera's own angle, or sets the angle first.
//! - `dof.aperture_blades`, `aperture_rotation` and `aperture_ratio` are the shape of out-of-focus points. Blades are straight; a ratio narrows
//!   the shape along x.
//! - The noise is added in encoded values by compositor nodes, octave by octave.
//!
//! What sets the scene is the same text in the script and in the add-on (`engines/blender`).
//!
//! Source: Blender's `camera.cpp` and manual. The script was run in Blender 4.5 and its render estimated again: docs/engines.md.

use super::{
    Abilities, Camera, Export, File, Shapes, filled, grain, head, number, numbers, polygon_std, short,
};
use crate::model::NoiseModel;
use std::f32::consts::FRAC_PI_2;

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Blender 4.2 to 4.5, Cycles (and EEVEE for shutter and lens)",
    motion_blur: "exact",
    defocus: "exact",
    bokeh: Shapes { blades: Some([3, 16]), roundness: false, rotation: true, squeeze: true },
    grain: "compositor nodes: the whole model",
    checked: "script run in Blender 4.5, its render estimated blindly, its out-of-focus points measured",
};

/// The positions of Blender's shutter, each with the middle of the exposure after the frame's time, in exposures.
const POSITIONS: [(&str, f32); 3] = [("CENTER", 0.0), ("START", 0.5), ("END", -0.5)];

/// The noise as a dictionary of Python.
fn noise(model: &NoiseModel) -> String {
    let rows = |v: [[f32; 4]; 3]| format!("[{}]", v.map(|v| format!("[{}]", numbers(&v))).join(", "));
    let (slope, intercept) = grain::by_channel(model);
    let offsets = grain::CHANNEL_OFFSETS.map(|[x, y]| format!("({x}, {y})")).join(", ");
    format!(
        "{{\n        \"slope\": {},\n        \"intercept\": {},\n        \"clip\": {},\n        \"gain\": {},\n        \"side\": {},\n        \
         \"offsets\": [{offsets}],\n    }}",
        rows(slope),
        rows(intercept),
        number(model.clip()),
        number(grain::GAIN),
        grain::SIDE,
    )
}

/// The script and its texture.
pub(super) fn export(camera: &Camera) -> Export {
    let none = || String::from("None");
    let mut lost = camera.left.clone();
    if camera.noise.is_some() {
        // The add-on leaves out what begins so: it puts the picture over a clip, and adds what the clip's own noise lacks.
        lost.push(
            "this script adds noise to all of the picture alike, where the object is transparent, too".into(),
        );
        lost.push("the view transform is set to Standard, through which values are saved as they are".into());
    }
    let exposure = camera.exposure.map_or(0.0, |e| e.0);
    let off = |centre: f32| (centre * exposure - camera.shutter_centre).abs();
    let [mut nearest, others @ ..] = POSITIONS;
    for other in others {
        // With an exposure of 0 all are the same.
        if off(other.1) < off(nearest.1) {
            nearest = other;
        }
    }
    if off(nearest.1) > 0.005 {
        lost.push(format!(
            "the middle of the exposure is off by {} of the frame interval: Blender's shutter has no phase but the positions \
             START, CENTER and END",
            short(off(nearest.1))
        ));
    }
    let blades = camera.blades(ABILITIES.bokeh);
    // Blender's corners lie beside its x axis, counted against the clock; the model's first corner lies on top, and is turned clockwise.
    let rotation = blades.map_or(0.0, |(n, _, degrees)| {
        let turn = std::f32::consts::PI / f32::from(n);
        (FRAC_PI_2 - degrees.to_radians() - turn).rem_euclid(2.0 * turn)
    });
    // The diameter is that through the corners, down the picture, of blades that are straight.
    let larger = camera.aperture.stds(1.0)[1] / blades.map_or(1.0, |(n, ..)| polygon_std(n, 1.0));
    let text = filled(
        include_str!("effects/blender_camera.py"),
        &[
            ("exposure", camera.exposure.map_or_else(none, |e| number(e.0))),
            ("position", format!("\"{}\"", nearest.0)),
            ("sigma", camera.lens.map_or_else(none, |l| number(l.sigma_px_at_infinity))),
            ("focus", camera.lens.map_or_else(none, |l| number(l.focus_m))),
            ("blades", blades.map_or(0, |b| b.0).to_string()),
            ("rotation", number(rotation)),
            ("ratio", number(camera.aperture.squeeze)),
            ("larger", number(larger)),
            ("height", camera.height.to_string()),
            ("fov", camera.fov_y_degrees.map_or_else(none, number)),
            ("noise", camera.noise.as_ref().map_or_else(none, noise)),
            ("bands", grain::BANDS.into()),
        ],
    );
    let text =
        head("#", "A camera for Blender: run in the text editor, or blender FILE --python this", &lost)
            + include_str!("effects/blender_scene.py")
            + &text;
    let mut files = vec![File::text("blindaug_camera.py", text)];
    if camera.noise.is_some() {
        files.push(File::texture(grain::BANDS, grain::bands()));
    }
    Export { files, lost }
}
