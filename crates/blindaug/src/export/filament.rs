//! Filament: a C++ function that sets a view and a camera.
//!
//! - Depth of field: `c = cocScale H / 0.024 A f / (S - f) |1 - S / Z|` px, A = f / N the aperture's diameter, a radius of at most
//!   32 px, no blur below 1 px. The camera's aperture also sets its exposure, so that its f-number is left as it is and `cocScale`
//!   makes up for the difference, as Filament's documentation proposes: `cocScale = aperture / N`.
//! - Motion blur and grain: none.
//!
//! Source: `PostProcessManager.cpp` and `Options.h`.

use super::{Abilities, Camera, Export, File, Shapes, ThinLens, head, number};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Filament 1.9 and later",
    motion_blur: "none",
    defocus: "exact between 1 px and 64 px of diameter, for the field of view that is given",
    bokeh: Shapes::DISKS,
    grain: "none",
    checked: "formula read in the source; not run",
};

const SENSOR_HEIGHT_M: f32 = 0.024;

/// The f-number that gives the blur with `cocScale` 1.
pub fn f_number(camera: &Camera, lens: &ThinLens) -> f32 {
    lens.f_number(camera.focal_length_per_sensor_height() * SENSOR_HEIGHT_M, SENSOR_HEIGHT_M, camera.height)
}

/// The std of the blur at this depth in m, px.
fn sigma_px(camera: &Camera, f_number: f32, focus_m: f32, depth_m: f32) -> f32 {
    let focal_m = camera.focal_length_per_sensor_height() * SENSOR_HEIGHT_M;
    let aperture = focal_m / f_number;
    let diameter = camera.height as f32 / SENSOR_HEIGHT_M
        * (aperture * focal_m / (focus_m - focal_m)).max(0.0)
        * (1.0 - focus_m / depth_m).abs();
    if diameter < 1.0 { 0.0 } else { diameter.min(64.0) / 4.0 }
}

/// The header with a function that sets the depth of field.
pub(super) fn export(camera: &Camera) -> Export {
    let mut lost = camera.left.clone();
    if camera.exposure.is_some() {
        lost.push("Filament has no motion blur".into());
    }
    if camera.noise.is_some() {
        lost.push("Filament has no grain".into());
    }
    let body = match &camera.lens {
        None => String::new(),
        Some(lens) => {
            let n = f_number(camera, lens);
            lost.extend(camera.blur_lost(|z| sigma_px(camera, n, lens.focus_m, z)));
            lost.push(camera.for_this_view());
            format!(
                "    camera.setFocusDistance({}f);
    filament::View::DepthOfFieldOptions depthOfField;
    depthOfField.enabled = true;
    // The aperture stays what the exposure needs; the blur is that of f/{n}.
    depthOfField.cocScale = camera.getAperture() / {n}f;
    depthOfField.maxForegroundCOC = 32;
    depthOfField.maxBackgroundCOC = 32;
    view.setDepthOfFieldOptions(depthOfField);
",
                number(lens.focus_m),
                n = number(n),
            )
        }
    };
    let head = head("//", "A camera's depth of field for Filament", &lost);
    let text = format!(
        "{head}#include <filament/Camera.h>
#include <filament/View.h>

inline void blindaugCamera(filament::View& view, filament::Camera& camera) {{
{body}}}
"
    );
    Export { files: vec![File::text("blindaug_camera.h", text)], lost }
}
