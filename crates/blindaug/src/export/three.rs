//! three.js: an ES module with the camera's numbers and a pass for the noise.
//!
//! - Motion blur: TSL's `motionBlur( input, velocity, n )` takes n taps that are off centre by 1 / (n - 1) and sum to (n + 1) / n; with
//!   `velocity.mul( exposure )` and many taps both vanish.
//! - Depth of field: TSL's `dof()` blurs by `bokehScale smoothstep( 0, focalLength, |z - focusDistance| )`: no thin lens. The nearest in
//!   least squares over inverse depth is given.
//! - Grain: `film()` and pmndrs's `NoiseEffect` are white, brighten, and have no response; a pass of ours instead.
//!
//! Source: `MotionBlur.js`, `DepthOfFieldNode.js`, `FilmNode.js`.

use super::{Abilities, Camera, Export, File, ThinLens, filled, grain, head, number, numbers, probes};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "three.js r170 and later",
    motion_blur: "the number; TSL's motionBlur() brightens by 1 / n and is off centre with few taps",
    defocus: "approximate: TSL's dof() is no thin lens, and its scale in px was not measured",
    grain: "a pass: the whole model",
    checked: "module parsed and run in headless Chromium, its noise measured there",
};

/// The arguments of TSL's `dof()`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthOfField {
    /// m.
    pub focus_distance: f32,
    /// From the focus to full blur, m.
    pub focal_length: f32,
    /// Radius of full blur, px.
    pub bokeh_scale: f32,
}

impl DepthOfField {
    /// The std of the blur at this depth in m, px.
    pub fn sigma_px(&self, depth_m: f32) -> f32 {
        let t = ((depth_m - self.focus_distance).abs() / self.focal_length).clamp(0.0, 1.0);
        0.5 * self.bokeh_scale * t * t * (3.0 - 2.0 * t)
    }
}

/// The nearest to a lens, in least squares over inverse depth.
pub fn depth_of_field(lens: &ThinLens) -> DepthOfField {
    let of = |focal_length: f32| {
        let unit = DepthOfField { focus_distance: lens.focus_m, focal_length, bokeh_scale: 1.0 };
        let [mut wanted, mut squares] = [0.0; 2];
        for z in probes(lens.focus_m) {
            wanted += unit.sigma_px(z) * lens.sigma_px(z);
            squares += unit.sigma_px(z).powi(2);
        }
        let fit = DepthOfField { bokeh_scale: wanted / f32::max(squares, 1e-12), ..unit };
        let loss: f32 = probes(lens.focus_m).map(|z| (fit.sigma_px(z) - lens.sigma_px(z)).powi(2)).sum();
        (fit, loss)
    };
    let candidates = (1..=400).map(|i| of(lens.focus_m * i as f32 / 50.0));
    candidates.min_by(|a, b| a.1.total_cmp(&b.1)).map_or_else(|| of(lens.focus_m).0, |best| best.0)
}

/// The module and its texture.
pub(super) fn export(camera: &Camera) -> Export {
    let mut lost = camera.left.clone();
    let null = || String::from("null");
    let mut depth_of_field_text = null();
    if camera.exposure.is_some() {
        lost.push(
            "TSL's motionBlur() with velocity.mul( camera.exposure ) brightens by 1 / n and is off centre by 1 / ( n - 1 ): take 32 taps or more"
                .into(),
        );
    }
    let lens = camera.lens.map_or_else(null, |lens| {
        let dof = depth_of_field(&lens);
        lost.extend(camera.blur_lost(|z| dof.sigma_px(z)));
        lost.push("TSL's dof() is no thin lens, and its scale in px was not measured: use sigmaPx() in a pass of your own where it matters".into());
        depth_of_field_text = format!(
            "{{ focusDistance: {}, focalLength: {}, bokehScale: {} }}",
            number(dof.focus_distance),
            number(dof.focal_length),
            number(dof.bokeh_scale)
        );
        format!(
            "{{ sigmaPxAtInfinity: {}, focusDistance: {}, width: {} }}",
            number(lens.sigma_px_at_infinity),
            number(lens.focus_m),
            camera.width
        )
    });
    let noise = camera.noise.as_ref().map_or_else(null, |noise| {
        let (slope, intercept) = grain::by_channel(noise);
        let rows = |v: [[f32; 4]; 3]| v.map(|v| format!("[ {} ]", numbers(&v))).join(", ");
        format!(
            "{{ slope: [ {} ], intercept: [ {} ], clip: {} }}",
            rows(slope),
            rows(intercept),
            number(noise.clip)
        )
    });
    lost.extend(grain::full_pass_lost(camera));
    let mut values = vec![
        ("exposure", camera.exposure.map_or_else(null, |e| number(e.0))),
        ("lens", lens),
        ("noise", noise),
        ("depthOfField", depth_of_field_text),
        ("bands", grain::BANDS.into()),
        ("mask", (grain::SIDE - 1).to_string()),
        ("side", grain::SIDE.to_string()),
        ("gain", number(grain::GAIN)),
    ];
    let offsets = grain::CHANNEL_OFFSETS.map(|[x, y]| format!("{x}, {y}"));
    values.extend(["offset0", "offset1", "offset2"].into_iter().zip(offsets));
    let text =
        head("//", "A camera for three.js", &lost) + &filled(include_str!("effects/three.js"), &values);
    let mut files = vec![File::text("blindaug_camera.js", text)];
    if camera.noise.is_some() {
        files.push(File::texture(grain::BANDS, grain::bands()));
    }
    Export { files, lost }
}
