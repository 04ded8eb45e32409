//! A camera model as the compositor's shaders read it.

use crate::layout::wgsl_struct;
use crate::quality::Quality;
use blindaug::Result;
use blindaug::composite::CompositeOptions;
use blindaug::model::{BlurSpace, CameraModel, DefocusCurve, NOISE_LEVELS};
use blindaug::synth::Blur;

/// The range of all inverse depths, 1/m. It is finite, since shaders need not know infinity.
const EVERYTHING: [f32; 2] = [f32::MIN, f32::MAX];

wgsl_struct! {
    /// The camera and the frame, as every pass reads them.
    pub(crate) struct Camera {
        /// The coefficients a, b, c of p = a d^2 + b d + c, px. The defocus std at inverse depth d is |p| for a thin lens, else max(p, 0).
        lens: [f32; 3],
        /// 1 for a thin lens, 0 for a quadratic curve.
        thin_lens: u32,
        /// The range into which the inverse depth is clamped, 1/m.
        inverse_depths: [f32; 2],
        /// The inverse depth in 1/m is the first number times the depth texture's value, plus the second.
        pub(crate) depth_map: [f32; 2],
        /// The path while the shutter is open, px, of a unit of the velocity texture: px per frame interval times the exposure fraction.
        path_scale: [f32; 2],
        /// Unused.
        padding: [u32; 2],
        /// The slopes of the noise std of each pyramid level, slope * luma + intercept, for R, G and B; the fourth number is unused.
        slope: [[f32; 4]; NOISE_LEVELS],
        /// The intercepts of the noise std of each pyramid level, for R, G and B; the fourth number is unused.
        intercept: [[f32; 4]; NOISE_LEVELS],
        /// The encoded value at which the sensor clips.
        clip: f32,
        /// 1 if there is noise to add.
        noise: u32,
        /// 1 if blur acts on encoded values, 0 if it acts on light.
        encoded_space: u32,
        /// 1 if the target's hardware encodes what is written.
        pub(crate) linear_target: u32,
        /// The top left corner of the area in which the layer may be seen, px of the frame.
        pub(crate) origin: [u32; 2],
        /// The size of the area, px, which is also the used part of the textures between the passes.
        pub(crate) size: [u32; 2],
        /// The seed of the frame's noise, and of the jitter along paths.
        key: [u32; 2],
        /// The most samples along the path of a pixel.
        most_taps: f32,
        /// The number of slabs of depth that are blurred apart from each other, 1 or 3.
        pub(crate) slabs: u32,
        /// The inverse depths between the three slabs, 1/m: the first slab lies behind `cuts[0]`, the last one in front of `cuts[1]`.
        cuts: [f32; 2],
        /// Unused.
        more_padding: [u32; 2],
    }
}

impl Camera {
    /// The distortions that a model knows and the options ask for; `velocity_scale` is what a unit of the velocity texture means, px per
    /// frame interval. Sharpening has passes of its own.
    ///
    /// # Errors
    /// If the model is for another width, or its defocus is in relative inverse depth.
    pub(crate) fn new(
        model: &CameraModel,
        width: usize,
        velocity_scale: [f32; 2],
        options: &CompositeOptions,
        quality: Quality,
        number: u64,
    ) -> Result<Self> {
        model.check_width(width)?;
        let mut uniforms = Self {
            clip: 1.0,
            encoded_space: u32::from(model.blur_space == BlurSpace::Encoded),
            key: [
                options.seed as u32 ^ (options.seed >> 32) as u32 ^ ((number >> 32) as u32).rotate_left(16),
                number as u32,
            ],
            most_taps: quality.most_taps(),
            cuts: EVERYTHING,
            ..Self::default()
        };
        if options.naive {
            return Ok(uniforms);
        }
        if let Some(cuts) = Blur::new(model, width, options.bokeh)?.cuts() {
            uniforms.cuts = cuts.map(|d| d.clamp(f32::MIN, f32::MAX));
        }
        if let Some(defocus) = model.defocus.known() {
            (uniforms.lens, uniforms.thin_lens, uniforms.inverse_depths) = match defocus.curve {
                DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, .. } => {
                    ([0.0, -s / f, s], 1, EVERYTHING)
                }
                DefocusCurve::Quadratic { a, b, c, inverse_depth_range } => {
                    ([a, b, c], 0, inverse_depth_range)
                }
            };
        }
        if let Some(motion_blur) = model.motion_blur.known() {
            uniforms.path_scale = velocity_scale.map(|s| s * motion_blur.exposure.0);
        }
        if let Some(noise) = model.noise.known().filter(|_| !options.no_noise) {
            uniforms.noise = 1;
            uniforms.clip = noise.clip();
            let rgb = |[r, g, b]: [f32; 3]| [r, g, b, 0.0];
            uniforms.slope = noise.lines().levels.map(|l| rgb(l.slope));
            uniforms.intercept = noise.lines().levels.map(|l| rgb(l.intercept));
        }
        Ok(uniforms)
    }

    /// Whether the lens may put anything out of focus.
    pub(crate) fn defocuses(&self) -> bool {
        self.lens != [0.0; 3]
    }

    /// Whether the shutter is open while things move.
    pub(crate) fn moves(&self) -> bool {
        self.path_scale != [0.0; 2]
    }
}
