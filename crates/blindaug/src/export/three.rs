//! three.js: an ES module with the camera's numbers and a pass for the noise.
//!
//! - Motion blur: TSL's `motionBlur( input, velocity, n )` moves its taps by `velocity` in texture coordinates, from -1/2 to 1/2, while the
//!   pass's velocity is in normalized device coordinates: twice as long, y up. Hence `vec2( 0.5, - 0.5 )`, without which streaks are twice
//!   as long and mirrored. The taps are off centre by 1 / (n - 1) and sum to (n + 1) / n; with many taps both errors vanish.
//! - Depth of field: TSL's `dof()` spreads 64 taps over a disk of the radius `bokehScale smoothstep( 0, focalLength, |z - focusDistance| )`
//!   in px of the full picture, which is no thin lens. It also works at half resolution, takes a maximum over the same disk, by which
//!   bright things grow, and mixes in the sharp picture below half of full blur. [`DepthOfField::sigma_px`] includes all of this, as
//!   measured at edges; the export has the settings nearest to the lens in least squares over inverse depth.
//! - Grain: `film()` and pmndrs's `NoiseEffect` are white, brighten, and have no response, so a pass of our own is exported.
//!
//! Source: `MotionBlur.js`, `VelocityNode.js`, `DepthOfFieldNode.js`, `FilmNode.js`; `tools/check-three.sh` measures these statements.

use super::{
    Abilities, Camera, Export, File, Shapes, ThinLens, filled, grain, head, number, numbers, probes,
};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "three.js r170 and later; dof() from r180",
    motion_blur: "the number; TSL's motionBlur() brightens by 1 / n and is off centre with few taps",
    defocus: "approximate: TSL's dof() is no thin lens, and spreads by 1.3 px or more",
    bokeh: Shapes::DISKS,
    grain: "a pass: the whole model",
    checked: "module run in headless Chromium: its noise, dof() and motionBlur() measured there",
};

/// Variance that `dof()` adds by working at half resolution, px^2.
const HALF_RESOLUTION: f32 = 1.7;

/// The share of its radius by which `dof()` enlarges bright things, over all directions.
const GROWTH: f32 = 0.8;

/// The arguments of TSL's `dof()`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthOfField {
    /// The distance in focus, m.
    pub focus_distance: f32,
    /// The distance from the focus to full blur, m.
    pub focal_length: f32,
    /// Radius of full blur, px of the picture that is blurred.
    pub bokeh_scale: f32,
}

impl DepthOfField {
    /// The std of the spread of an edge at this depth in m, px.
    pub fn sigma_px(&self, depth_m: f32) -> f32 {
        let t = ((depth_m - self.focus_distance).abs() / self.focal_length).clamp(0.0, 1.0);
        let coc = t * t * (3.0 - 2.0 * t);
        let radius = self.bokeh_scale * coc;
        let mixed = (2.0 * coc).min(1.0);
        // A bright area grows as it is blurred, so that its blurred edge lies off the sharp edge with which it is mixed.
        let apart = mixed * (1.0 - mixed) * (GROWTH * radius).powi(2);
        (mixed * (0.25 * radius * radius + HALF_RESOLUTION) + apart).sqrt()
    }
}

/// The arguments of `dof()` nearest to a lens, in least squares over inverse depth.
pub fn depth_of_field(lens: &ThinLens) -> DepthOfField {
    let of = |focal_length: f32| {
        let at = |bokeh_scale: f32| {
            let fit = DepthOfField { focus_distance: lens.focus_m, focal_length, bokeh_scale };
            let loss: f32 = probes(lens.focus_m).map(|z| (fit.sigma_px(z) - lens.sigma_px(z)).powi(2)).sum();
            (fit, loss)
        };
        // The scale is found by ternary search: the loss falls up to the best scale and rises from there.
        let [mut low, mut high] = [0.0, 4.0 * lens.sigma_px_at_infinity];
        for _ in 0..24 {
            let third = (high - low) / 3.0;
            if at(low + third).1 < at(high - third).1 { high -= third } else { low += third }
        }
        at(0.5 * (low + high))
    };
    let candidates = (1..=200).map(|i| of(lens.focus_m * i as f32 / 25.0));
    candidates.min_by(|a, b| a.1.total_cmp(&b.1)).map_or_else(|| of(lens.focus_m).0, |best| best.0)
}

/// The module and its texture.
pub(super) fn export(camera: &Camera) -> Export {
    let mut lost = camera.left.clone();
    let null = || String::from("null");
    let mut depth_of_field_text = null();
    if camera.exposure.is_some() {
        lost.push(
            "TSL's motionBlur() brightens by 1 / n and is off centre by 1 / ( n - 1 ) of the streak: take 32 taps or more"
                .into(),
        );
    }
    let lens = camera.lens.map_or_else(null, |lens| {
        let dof = depth_of_field(&lens);
        lost.extend(camera.blur_lost(|z| dof.sigma_px(z)));
        lost.push("TSL's dof() is no thin lens, and what is bright grows by about 0.8 of its radius: use sigmaPx() in a pass of your own where it matters".into());
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
            number(noise.clip())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_spreads_as_was_measured_in_a_browser() {
        // The columns are bokehScale, |z - focusDistance| over focalLength, and the std of an edge in px, measured by tools/check-three.sh.
        for (bokeh_scale, t, want) in [
            (1.0, 1.0, 1.34),
            (4.0, 1.0, 2.44),
            (8.0, 1.0, 4.24),
            (16.0, 1.0, 8.15),
            (8.0, 0.75, 3.61),
            (8.0, 0.5, 2.44),
            (8.0, 0.3, 1.27),
            (8.0, 0.1, 0.22),
        ] {
            let dof = DepthOfField { focus_distance: 2.0, focal_length: 1.0, bokeh_scale };
            for z in [2.0 + t, 2.0 - t] {
                let got = dof.sigma_px(z);
                assert!((got - want).abs() < 0.12, "{bokeh_scale} {t}: {got} px instead of {want}");
            }
        }
    }

    #[test]
    fn no_other_scale_or_length_is_nearer_to_the_lens() {
        for sigma_px_at_infinity in [1.2, 4.0, 9.0] {
            let lens = ThinLens { sigma_px_at_infinity, focus_m: 3.0 };
            let loss = |dof: DepthOfField| -> f32 {
                probes(3.0).map(|z| (dof.sigma_px(z) - lens.sigma_px(z)).powi(2)).sum()
            };
            let best = depth_of_field(&lens);
            for (scale, length) in [
                (1.05, 1.0),
                (0.95, 1.0),
                (1.0, 1.1),
                (1.0, 0.9),
                (0.5, 1.0),
                (2.0, 1.0),
                (2.0, 2.0),
                (0.5, 0.5),
            ] {
                let other = DepthOfField {
                    bokeh_scale: scale * best.bokeh_scale,
                    focal_length: length * best.focal_length,
                    ..best
                };
                assert!(loss(other) >= loss(best), "{sigma_px_at_infinity}: {best:?} {other:?}");
            }
        }
    }
}
