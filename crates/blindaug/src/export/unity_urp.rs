//! Unity's Universal Render Pipeline: a C# editor script that makes a `VolumeProfile`.
//!
//! - `MotionBlur`: samples `uv +- 0.5 v intensity`, v the motion in normalised device coordinates, which span two per picture: a
//!   streak is 2 intensity times as long as the motion between frames. So `intensity = lambda / 2`.
//! - `DepthOfField`, Bokeh: `coc = clamp((1 - P / Z) maxCoC, -1, 1)`, `maxCoC = (f_mm / N) F / (P - F)`, F = f_mm / 1000 m; a radius of
//!   `14 |coc|` px (of less in pictures under 280 px: 5 % of their height). Only f^2 / N matters: N is set to 5.6, and f to match.
//!   The kernel's radius is `(cos(pi / n) / cos(angle))^(1 - bladeCurvature)` for n = `bladeCount`, turned clockwise by `bladeRotation`.
//! - `FilmGrain`: [`grain::Response`].
//!
//! Source: the pipeline's `PostProcessPass.cs` and `Common.hlsl`; not run in the editor here.

use super::unity::{self, f};
use super::{Abilities, Camera, Export, Shapes, grain, inward, polygon_std};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "Unity, Universal Render Pipeline 12 and later",
    motion_blur: "exact; motion beyond 0.2 of the screen is clamped",
    defocus: "exact up to a std of 7 px (less under 280 px of height)",
    bokeh: Shapes { blades: Some([3, 9]), roundness: true, rotation: true, squeeze: false },
    grain: "FilmGrain: grey, none at black, one spectrum; or a full-screen shader: the whole model",
    checked: "formulas read in the source; script parsed, shader run on stand-ins for Unity's includes and compared with the model; not run in the editor",
};

/// The numbers of the volume's components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// `MotionBlur.intensity`, in [0, 1].
    pub motion_blur_intensity: Option<f32>,
    /// `DepthOfField` in its mode Bokeh.
    pub bokeh: Option<Bokeh>,
    /// `FilmGrain`.
    pub film_grain: Option<grain::Response>,
}

/// The settings of `DepthOfField`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bokeh {
    /// `focusDistance`, m, at least 0.1.
    pub focus_distance: f32,
    /// `focalLength`, mm, in [1, 300].
    pub focal_length: f32,
    /// `aperture`, the f-number, in [1, 32].
    pub aperture: f32,
    /// `bladeCount`, in [3, 9].
    pub blade_count: u8,
    /// `bladeCurvature`, from 0, straight blades, to 1, a disk.
    pub blade_curvature: f32,
    /// `bladeRotation`, degrees.
    pub blade_rotation: f32,
}

impl Bokeh {
    /// The std of the blur at this depth in m, px, on pictures `height` px high.
    pub fn sigma_px(&self, depth_m: f32, height: usize) -> f32 {
        let coc = unity::coc(self.focal_length, self.aperture, self.focus_distance, depth_m);
        0.5 * most_radius(height) * coc * polygon_std(self.blade_count, 1.0 - self.blade_curvature)
    }
}

/// The largest radius of the bokeh, px.
fn most_radius(height: usize) -> f32 {
    (0.05 * height as f32).min(14.0)
}

/// The camera as URP's numbers.
pub fn settings(camera: &Camera) -> Settings {
    let bokeh = camera.lens.map(|lens| {
        let focus_distance = lens.focus_m.max(0.1);
        let (blade_count, blade_curvature, blade_rotation) = match camera.blades(ABILITIES.bokeh) {
            Some((blades, roundness, rotation)) => {
                // The kernel's corners lie beside its x axis, and a gather turns it upside down; the model's first corner lies on top.
                let sector = 360.0 / f32::from(blades);
                let turned = (rotation + 0.5 * sector + 90.0).rem_euclid(sector);
                (blades, 1.0 - inward(blades, roundness), turned)
            }
            None => (9, 1.0, 0.0),
        };
        let std = polygon_std(blade_count, 1.0 - blade_curvature);
        let max_coc = 2.0 * lens.sigma_px_at_infinity / (std * most_radius(camera.height));
        let focal_length = unity::focal_length(max_coc, 5.6, focus_distance).clamp(1.0, 300.0);
        let focal_m = focal_length / 1000.0;
        let aperture = focal_length * focal_m / (max_coc * (focus_distance - focal_m).max(1e-3));
        let aperture = aperture.clamp(1.0, 32.0);
        Bokeh { focus_distance, focal_length, aperture, blade_count, blade_curvature, blade_rotation }
    });
    Settings {
        motion_blur_intensity: camera.exposure.map(|e| 0.5 * e.0),
        bokeh,
        film_grain: camera.noise.as_ref().map(|n| grain::Response::nearest(n, camera.transfer)),
    }
}

/// The script, the grain's texture, and the full-screen pass.
pub(super) fn export(camera: &Camera) -> Export {
    let settings = settings(camera);
    let mut lost = camera.left.clone();
    let mut body = String::new();
    if let Some(intensity) = settings.motion_blur_intensity {
        body += &format!(
            "
        var motionBlur = Add<MotionBlur>(profile);
        motionBlur.intensity.Override({});
        motionBlur.clamp.Override(0.2f);
        motionBlur.quality.Override(MotionBlurQuality.High);
",
            f(intensity)
        );
    }
    if let Some(bokeh) = settings.bokeh {
        lost.extend(camera.blur_lost(|z| bokeh.sigma_px(z, camera.height)));
        body += &format!(
            "
        var depthOfField = Add<DepthOfField>(profile);
        depthOfField.mode.Override(DepthOfFieldMode.Bokeh);
        depthOfField.focusDistance.Override({});
        depthOfField.focalLength.Override({});
        depthOfField.aperture.Override({});
        depthOfField.bladeCount.Override({});
        depthOfField.bladeCurvature.Override({});
        depthOfField.bladeRotation.Override({});
",
            f(bokeh.focus_distance),
            f(bokeh.focal_length),
            f(bokeh.aperture),
            bokeh.blade_count,
            f(bokeh.blade_curvature),
            f(bokeh.blade_rotation),
        );
    }
    let pipeline = ["Universal Render Pipeline", "UnityEngine.Rendering.Universal"];
    let mut export = unity::export(camera, pipeline, body, settings.film_grain, lost);
    export.files.extend(unity::grain_shader(camera).into_iter().flatten());
    export
}
