//! Godot 4: camera attributes, and a compositor effect for the noise.
//!
//! - `CameraAttributesPractical`: a radius of `64 amount |Z - P| / Z` px whatever the resolution, at most 32 px, when both
//!   transitions are negative ("physical"): `dof_blur_amount = sigma_inf / 32`.
//! - Motion blur: no released version has it. The pull request that proposes it takes `motion_blur_intensity = lambda`.
//! - Grain: Godot has none; a `CompositorEffect` of our own is exported.
//!
//! Source: the engine's `dof` shaders and the pull request.

use super::{Abilities, Camera, Export, File, Shapes, ThinLens, filled, grain, head, number, numbers, short};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Godot 4.3 and later, Forward+ or Mobile",
    motion_blur: "none in released versions; the number for the proposed effect is given",
    defocus: "exact up to a std of 16 px, at the resolution that it is exported for",
    bokeh: Shapes::DISKS,
    grain: "a compositor effect: the whole model",
    checked: "formula read in the source; .tres read by a strict reader, shader run and compared with the model; not run in the engine",
};

/// The numbers of `CameraAttributesPractical`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthOfField {
    /// `dof_blur_amount`, in [0, 1].
    pub amount: f32,
    /// `dof_blur_near_distance` and `dof_blur_far_distance`, m.
    pub distance: f32,
}

impl DepthOfField {
    /// The std of the blur at this depth in m, px.
    pub fn sigma_px(&self, depth_m: f32) -> f32 {
        0.5 * (64.0 * self.amount * (depth_m - self.distance).abs() / depth_m).min(32.0)
    }
}

/// The lens as Godot's numbers.
pub fn depth_of_field(lens: &ThinLens) -> DepthOfField {
    DepthOfField { amount: (lens.sigma_px_at_infinity / 32.0).min(1.0), distance: lens.focus_m.max(0.01) }
}

/// The attributes, and the compositor effect.
pub(super) fn export(camera: &Camera) -> Export {
    let mut lost = camera.left.clone();
    if let Some(exposure) = camera.exposure {
        lost.push(format!(
            "released versions have no motion blur; the proposed effect takes motion_blur_intensity = {}",
            short(exposure.0)
        ));
    }
    let mut resource = String::new();
    if let Some(lens) = &camera.lens {
        let dof = depth_of_field(lens);
        lost.extend(camera.blur_lost(|z| dof.sigma_px(z)));
        lost.push(format!(
            "the blur is for pictures {} px wide, since the engine does not scale it",
            camera.width
        ));
        let distance = number(dof.distance);
        resource = format!(
            "dof_blur_far_enabled = true\ndof_blur_far_distance = {distance}\ndof_blur_far_transition = -1.0\n\
             dof_blur_near_enabled = true\ndof_blur_near_distance = {distance}\ndof_blur_near_transition = -1.0\n\
             dof_blur_amount = {}\n",
            number(dof.amount)
        );
    }
    let mut files = vec![];
    if let Some(noise) = &camera.noise {
        lost.extend(grain::full_pass_lost(camera));
        let (slope, intercept) = grain::by_channel(noise);
        let script = filled(
            include_str!("effects/grain.gd"),
            &[
                ("bands", grain::BANDS.into()),
                ("slope", numbers(slope.as_flattened())),
                ("intercept", numbers(intercept.as_flattened())),
                ("clip", number(noise.clip())),
            ],
        );
        let shader = filled(
            include_str!("effects/grain.glsl"),
            &[
                ("offsets", grain::CHANNEL_OFFSETS.map(|[x, y]| format!("ivec2({x}, {y})")).join(", ")),
                ("mask", (grain::SIDE - 1).to_string()),
                ("gain", number(grain::GAIN)),
            ],
        );
        files = vec![
            File::text("blindaug_grain.gd", script),
            File::text("blindaug_grain.glsl", shader),
            File::texture(grain::BANDS, grain::bands()),
        ];
    }
    let head = head(";", "A camera as attributes for Godot's Camera3D or WorldEnvironment", &lost);
    let text = format!(
        "[gd_resource type=\"CameraAttributesPractical\" format=3]\n\n{head}\n[resource]\n\
         resource_name = \"Blindaug camera\"\n{resource}"
    );
    files.insert(0, File::text("blindaug_camera.tres", text));
    Export { files, lost }
}
