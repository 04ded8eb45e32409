//! Unreal Engine 5: a Python script for the editor that spawns a post-process volume.
//!
//! - `MotionBlurAmount = lambda` with `MotionBlurTargetFPS = 0` (the game's own frame rate). Movie Render Queue takes a shutter
//!   angle instead: 360 lambda degrees.
//! - Depth of field: a radius of `0.5 W / sensorW coc_inf |1 - P / Z|` px, `coc_inf = f^2 / (N (P - f))`, f from the field of view
//!   and `DepthOfFieldSensorWidth`; clamped to 0.025 W. The sensor has the default width, 24.576 mm, unless N leaves [1, 32].
//!   `DepthOfFieldBladeCount` and a `DepthOfFieldMinFstop` of 0 give straight blades.
//! - Grain: the script imports the octaves and makes a post-process material with the whole noise model, which works on display-encoded
//!   values after tonemapping. The engine's own film grain can be chosen instead: three zones of luminance, each with its own intensity.
//!
//! Source: Epic's documentation; not run in the engine.

use super::{Abilities, Camera, Export, File, Shapes, ThinLens, filled, grain, head, number};
use crate::model::NoiseModel;

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Unreal Engine 5.1 and later",
    motion_blur: "exact",
    defocus: "exact up to a radius of 2.5 % of the width",
    bokeh: Shapes { blades: Some([4, 16]), roundness: false, rotation: false, squeeze: false },
    grain: "a post-process material: the whole model; or the film grain: three zones of luminance, its scale is an assumption",
    checked: "from the documentation; script compiled, the material's function run and compared with the model; not run in the engine",
};

/// The numbers of `PostProcessSettings`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// `MotionBlurAmount`, in [0, 1].
    pub motion_blur_amount: Option<f32>,
    /// Depth of field.
    pub depth_of_field: Option<DepthOfField>,
    /// `FilmGrainIntensityShadows`, `Midtones`, `Highlights`, in [0, 1].
    pub film_grain: Option<[f32; 3]>,
}

/// The settings of `PostProcessSettings`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthOfField {
    /// `DepthOfFieldFstop`, in [1, 32].
    pub f_stop: f32,
    /// `DepthOfFieldFocalDistance`, cm.
    pub focal_distance: f32,
    /// `DepthOfFieldSensorWidth`, mm.
    pub sensor_width: f32,
}

impl DepthOfField {
    /// The std of the blur at this depth in m, px.
    pub fn sigma_px(&self, depth_m: f32, camera: &Camera) -> f32 {
        let aspect = camera.width as f32 / camera.height as f32;
        let sensor_m = self.sensor_width / 1000.0;
        let focal_m = camera.focal_length_per_sensor_height() * sensor_m / aspect;
        let focus_m = self.focal_distance / 100.0;
        let coc = focal_m * focal_m / (self.f_stop * (focus_m - focal_m));
        let radius = camera.width as f32 * (1.0 - focus_m / depth_m).abs() * 0.5 * coc / sensor_m;
        0.5 * radius.min(0.025 * camera.width as f32)
    }
}

/// The linear luminances, in the middle of shadows, midtones and highlights, at which the zones' intensities are taken.
const ZONES: [f32; 3] = [0.045, 0.25, 0.7];

fn depth_of_field(camera: &Camera, lens: &ThinLens) -> DepthOfField {
    const SENSOR_WIDTH_M: f32 = 0.024_576;
    let aspect = camera.width as f32 / camera.height as f32;
    let per_height = camera.focal_length_per_sensor_height();
    let height_m = SENSOR_WIDTH_M / aspect;
    let f_stop = lens.f_number(per_height * height_m, height_m, camera.height).clamp(1.0, 32.0);
    // The sensor of height h on which this f-number gives the blur satisfies 4 sigma N (P - t h) = t^2 h H, t the focal length over h.
    let blur = 4.0 * lens.sigma_px_at_infinity * f_stop;
    let height_m = blur * lens.focus_m / (per_height.powi(2) * camera.height as f32 + blur * per_height);
    DepthOfField { f_stop, focal_distance: 100.0 * lens.focus_m, sensor_width: 1000.0 * height_m * aspect }
}

fn zones(noise: &NoiseModel, camera: &Camera) -> [f32; 3] {
    ZONES.map(|light| {
        let y = camera.transfer.encode(light);
        let rms = grain::root_mean_square(noise.total_std(y));
        // The texture's std as a factor around 1 is 2 GAIN.
        (rms / camera.transfer.slope(light) / light / (2.0 * grain::GAIN)).min(1.0)
    })
}

/// The camera as Unreal's numbers.
pub fn settings(camera: &Camera) -> Settings {
    Settings {
        motion_blur_amount: camera.exposure.map(|e| e.0),
        depth_of_field: camera.lens.map(|lens| depth_of_field(camera, &lens)),
        film_grain: camera.noise.as_ref().map(|n| zones(n, camera)),
    }
}

/// The script and the textures of the grain.
pub(super) fn export(camera: &Camera) -> Export {
    let settings = settings(camera);
    let mut lost = camera.left.clone();
    let mut values = vec![];
    let mut set = |name: &str, value: f32| values.push(format!("    \"{name}\": {},\n", number(value)));
    let mut queue = String::new();
    if let Some(amount) = settings.motion_blur_amount {
        set("motion_blur_amount", amount);
        set("motion_blur_max", 100.0);
        queue = format!("# Movie Render Queue: a shutter angle of {} degrees.\n", number(360.0 * amount));
    }
    if let Some(dof) = settings.depth_of_field {
        set("depth_of_field_fstop", dof.f_stop);
        set("depth_of_field_focal_distance", dof.focal_distance);
        set("depth_of_field_sensor_width", dof.sensor_width);
        lost.extend(camera.blur_lost(|z| dof.sigma_px(z, camera)));
        lost.push(camera.for_this_view());
    }
    if settings.motion_blur_amount.is_some() {
        values.push("    \"motion_blur_target_fps\": 0,\n".into());
    }
    if let (Some(_), Some((blades, ..))) = (settings.depth_of_field, camera.blades(ABILITIES.bokeh)) {
        // Blades are straight at a least f-number of 0. The engine keeps the shape's area, and so its std, but for 3 % at most.
        values.push(format!(
            "    \"depth_of_field_blade_count\": {blades},\n    \"depth_of_field_min_fstop\": 0.0,\n"
        ));
    }
    let mut files = vec![];
    let (mut grain, mut add_grain) = (String::new(), "");
    if let (Some([shadows, midtones, highlights]), Some(noise)) = (settings.film_grain, &camera.noise) {
        lost.extend(grain::full_pass_lost(camera));
        lost.push(
            "the engine's own film grain, which can be chosen instead of the material, has one intensity for shadows, midtones and \
             highlights each; that its texture multiplies the light is an assumption, compare by eye"
                .into(),
        );
        grain = filled(
            include_str!("effects/unreal_grain.py"),
            &[
                ("shadows", number(shadows)),
                ("midtones", number(midtones)),
                ("highlights", number(highlights)),
                ("tile", grain::TILE.into()),
                ("bands", grain::BANDS.into()),
                ("code", filled(include_str!("effects/unreal_grain.hlsl"), &grain::hlsl_values(noise))),
            ],
        );
        add_grain = "add_grain(settings)\n";
        files.push(File::texture(grain::BANDS, grain::bands()));
        files.push(File::texture(grain::TILE, grain::tile(noise)));
    }
    let script = filled(
        include_str!("effects/unreal.py"),
        &[("values", values.concat()), ("grain", grain), ("add_grain", add_grain.into())],
    );
    let text = head("#", "A camera as a post-process volume of Unreal Engine", &lost) + &queue + &script;
    files.insert(0, File::text("blindaug_camera.py", text));
    Export { files, lost }
}
