//! Bevy: a Rust function that returns the components of a camera entity.
//!
//! - `MotionBlur { shutter_angle, samples }`: `shutter_angle` is a fraction of the frame interval: lambda. Things that move by less
//!   than 1 px are not blurred.
//! - `DepthOfField`: a circle of confusion of diameter `H f^2 / (h N) |Z - P| / (Z (P - f))` px, `f = 0.5 h / tan(fov / 2)`. In the mode
//!   Gaussian its kernel of std c / 4 is cut off at 1.5 std, which leaves a std of 0.743 c / 4; the f-number is smaller by that factor.
//! - Grain: Bevy has none.
//!
//! Source: `bevy_post_process` (`bevy_core_pipeline` before 0.17).

use super::{Abilities, Camera, Export, File, Shapes, ThinLens, head, number};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Bevy 0.17 and later",
    motion_blur: "exact; below 1 px of motion there is none",
    defocus: "exact, for the field of view that is given",
    bokeh: Shapes::DISKS,
    grain: "none",
    checked: "formulas read in the source; snippet parsed",
};

/// The share of its std that a Gaussian keeps when it is cut off at 1.5 std.
const TRUNCATION: f32 = 0.743;

/// The default of Bevy's `sensor_height`, m: Super 35.
const SENSOR_HEIGHT_M: f32 = 0.018_66;

/// The numbers of `DepthOfField`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthOfField {
    /// The distance in focus, m.
    pub focal_distance: f32,
    /// The f-number.
    pub aperture_f_stops: f32,
    /// The largest diameter of the circle of confusion, px.
    pub max_circle_of_confusion_diameter: f32,
}

impl DepthOfField {
    /// The std of the blur at this depth in m, px.
    pub fn sigma_px(&self, depth_m: f32, camera: &Camera) -> f32 {
        let focal_m = camera.focal_length_per_sensor_height() * SENSOR_HEIGHT_M;
        let scale = camera.height as f32 * focal_m * focal_m / (SENSOR_HEIGHT_M * self.aperture_f_stops);
        let diameter =
            scale * (depth_m - self.focal_distance).abs() / (depth_m * (self.focal_distance - focal_m));
        TRUNCATION * diameter.min(self.max_circle_of_confusion_diameter) / 4.0
    }
}

/// The lens as Bevy's numbers.
pub fn depth_of_field(camera: &Camera, lens: &ThinLens) -> DepthOfField {
    let wanted = ThinLens { sigma_px_at_infinity: lens.sigma_px_at_infinity / TRUNCATION, ..*lens };
    let focal_m = camera.focal_length_per_sensor_height() * SENSOR_HEIGHT_M;
    // A lens cannot focus nearer than its focal length.
    let focal_distance = lens.focus_m.max(focal_m + 1e-3);
    DepthOfField {
        focal_distance,
        aperture_f_stops: wanted.f_number(focal_m, SENSOR_HEIGHT_M, camera.height),
        // Near things blur most: the largest diameter has room for things at a third of the focus distance.
        max_circle_of_confusion_diameter: (8.0 * wanted.sigma_px_at_infinity).max(64.0),
    }
}

/// The source file with the camera's components.
pub(super) fn export(camera: &Camera) -> Export {
    let mut lost = camera.left.clone();
    let mut components = vec![];
    let mut imports = vec![];
    if let Some(exposure) = camera.exposure {
        components
            .push(format!("        MotionBlur {{ shutter_angle: {}, samples: 4 }},\n", number(exposure.0)));
        imports.push("motion_blur::MotionBlur");
    }
    if let Some(lens) = &camera.lens {
        let dof = depth_of_field(camera, lens);
        lost.extend(camera.blur_lost(|z| dof.sigma_px(z, camera)));
        lost.push(camera.for_this_view());
        components.push(format!(
            "        DepthOfField {{
            mode: DepthOfFieldMode::Gaussian,
            focal_distance: {},
            sensor_height: {},
            aperture_f_stops: {},
            max_circle_of_confusion_diameter: {},
            max_depth: f32::INFINITY,
        }},
",
            number(dof.focal_distance),
            number(SENSOR_HEIGHT_M),
            number(dof.aperture_f_stops),
            number(dof.max_circle_of_confusion_diameter),
        ));
        imports.push("dof::{DepthOfField, DepthOfFieldMode}");
    }
    if camera.noise.is_some() {
        lost.push("Bevy has no grain effect".into());
    }
    let head = head("//", "A camera's components for Bevy", &lost);
    let imports: String = imports.iter().map(|i| format!("use bevy::post_process::{i};\n")).collect();
    let text = format!(
        "{head}// Before Bevy 0.17 the effects are in bevy::core_pipeline.
use bevy::prelude::*;
{imports}
/// Spawn these together with `Camera3d`.
pub fn blindaug_camera() -> impl Bundle {{
    (
{components}    )
}}
",
        components = components.concat()
    );
    Export { files: vec![File::text("blindaug_camera.rs", text)], lost }
}
