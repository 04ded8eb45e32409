//! Unity's High Definition Render Pipeline: a C# editor script that makes a `VolumeProfile`, with the camera's own numbers in it.
//!
//! - `MotionBlur`: a streak is `intensity / 2` times as long as the motion between frames: `intensity = 2 lambda`.
//!   `minimumVelocity` is set to 0 and `maximumVelocity` to its limit, so that slow and fast things blur too.
//! - `DepthOfField` with the physical camera: `coc = clamp((1 - P / Z) maxCoC, -1, 1)`, `maxCoC = (f_mm / N) F / (P - F)`, a radius
//!   of `2 maxBlur H / 1080 |coc|` px. Near and far get the same `maxBlur`, 8, the most that near takes. The field of view stays
//!   the same when focal length and sensor grow together: N is set to 5.6, and f to the value that gives the blur.
//!   `bladeCount` and `curvature`, which makes blades rounder the wider the aperture is open, are the shape; the aperture also turns it.
//! - `FilmGrain`: [`grain::Response`].
//!
//! Source: the pipeline's `HDRenderPipeline.PostProcess.cs`; derived, not run in the editor here.

use super::unity::{self, f};
use super::{Abilities, Camera, Export, Shapes, grain, inward, polygon_std};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Unity, High Definition Render Pipeline 12 and later",
    motion_blur: "exact; above 1500 px per frame it is clamped",
    defocus: "exact up to a std of 8 px at 1080 lines; the camera's sensor is resized",
    bokeh: Shapes { blades: Some([3, 11]), roundness: true, rotation: false, squeeze: false },
    grain: "FilmGrain: grey, none at black, one spectrum",
    checked: "formulas derived from the source; script parsed; not run in the editor",
};

/// The value of `nearMaxBlur` and `farMaxBlur`, the most that `nearMaxBlur` takes.
const MAX_BLUR: f32 = 8.0;

/// The numbers of the volume's components and of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// `MotionBlur.intensity`, >= 0.
    pub motion_blur_intensity: Option<f32>,
    /// The physical camera.
    pub lens: Option<PhysicalCamera>,
    /// `FilmGrain`.
    pub film_grain: Option<grain::Response>,
}

/// The settings of the `Camera`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhysicalCamera {
    /// `focusDistance`, m.
    pub focus_distance: f32,
    /// `focalLength`, mm.
    pub focal_length: f32,
    /// `aperture`, the f-number, in [0.7, 32].
    pub aperture: f32,
    /// `sensorSize`, mm: the size that keeps the field of view.
    pub sensor_size: [f32; 2],
    /// `bladeCount`, in [3, 11].
    pub blade_count: u8,
    /// `curvature`: the f-numbers at which the shape is a disk and at which blades are straight, in [0.7, 32].
    pub curvature: [f32; 2],
}

impl PhysicalCamera {
    /// How far the blades lie inwards: 0 for a disk, 1 for straight blades.
    fn inward(&self) -> f32 {
        let [round, straight] = self.curvature;
        ((self.aperture - round) / (straight - round)).clamp(0.0, 1.0)
    }

    /// The std of the blur at this depth in m, px, on pictures `height` px high.
    pub fn sigma_px(&self, depth_m: f32, height: usize) -> f32 {
        let coc = unity::coc(self.focal_length, self.aperture, self.focus_distance, depth_m);
        MAX_BLUR * height as f32 / 1080.0 * coc * polygon_std(self.blade_count, self.inward())
    }
}

/// The camera as HDRP's numbers.
pub fn settings(camera: &Camera) -> Settings {
    let lens = camera.lens.map(|lens| {
        let aperture = 5.6;
        let (blade_count, inward) = match camera.blades(ABILITIES.bokeh) {
            Some((blades, roundness, _)) => (blades, inward(blades, roundness)),
            None => (5, 0.0),
        };
        let curvature = [aperture - inward, aperture - inward + 1.0];
        let std = polygon_std(blade_count, inward);
        let max_coc = lens.sigma_px_at_infinity / (std * MAX_BLUR * camera.height as f32 / 1080.0);
        let focal_length = unity::focal_length(max_coc, aperture, lens.focus_m);
        let sensor_height = focal_length / camera.focal_length_per_sensor_height();
        let aspect = camera.width as f32 / camera.height as f32;
        PhysicalCamera {
            focus_distance: lens.focus_m,
            focal_length,
            aperture,
            sensor_size: [aspect * sensor_height, sensor_height],
            blade_count,
            curvature,
        }
    });
    Settings {
        motion_blur_intensity: camera.exposure.map(|e| 2.0 * e.0),
        lens,
        film_grain: camera.noise.as_ref().map(|n| grain::Response::nearest(n, camera.transfer)),
    }
}

/// The script and the grain's texture.
pub(super) fn export(camera: &Camera) -> Export {
    let settings = settings(camera);
    let mut lost = camera.left.clone();
    let mut body = String::new();
    if let Some(intensity) = settings.motion_blur_intensity {
        body += &format!(
            "
        var motionBlur = Add<MotionBlur>(profile);
        motionBlur.quality.levelAndOverride = (0, true);
        motionBlur.intensity.Override({});
        motionBlur.minimumVelocity.Override(0.0f);
        motionBlur.maximumVelocity.Override(1500.0f);
        motionBlur.sampleCount = 16;
",
            f(intensity)
        );
    }
    if let Some(lens) = settings.lens {
        lost.extend(camera.blur_lost(|z| lens.sigma_px(z, camera.height)));
        lost.push(camera.for_this_view());
        lost.push(
            "the camera's sensor and focal length are changed together, so that it sees the same".into(),
        );
        let [focus, focal, aperture, width, height] =
            [lens.focus_distance, lens.focal_length, lens.aperture, lens.sensor_size[0], lens.sensor_size[1]]
                .map(f);
        let (blur, blades, [round, straight]) = (f(MAX_BLUR), lens.blade_count, lens.curvature.map(f));
        body += &format!(
            "
        var depthOfField = Add<DepthOfField>(profile);
        depthOfField.quality.levelAndOverride = (0, true);
        depthOfField.focusMode.Override(DepthOfFieldMode.UsePhysicalCamera);
        depthOfField.focusDistanceMode.Override(FocusDistanceMode.Camera);
        depthOfField.nearMaxBlur = {blur};
        depthOfField.farMaxBlur = {blur};

        var camera = Camera.main;
        if (camera != null)
        {{
            camera.usePhysicalProperties = true;
            camera.sensorSize = new Vector2({width}, {height});
            camera.focalLength = {focal};
            camera.aperture = {aperture};
            camera.focusDistance = {focus};
            camera.bladeCount = {blades};
            camera.curvature = new Vector2({round}, {straight});
        }}
"
        );
    }
    let pipeline = ["High Definition Render Pipeline", "UnityEngine.Rendering.HighDefinition"];
    unity::export(camera, pipeline, body, settings.film_grain, lost)
}
