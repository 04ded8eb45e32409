//! What the compositor's shaders know of a camera model.

use crate::layout::wgsl_struct;
use crate::quality::Quality;
use blindaug::Result;
use blindaug::composite::CompositeOptions;
use blindaug::model::{BlurSpace, CameraModel, DefocusCurve, NOISE_LEVELS};
use blindaug::synth::Blur;

/// The range of all inverse depths, 1/m. It is finite, since shaders need not know infinity.
const EVERYTHING: [f32; 2] = [f32::MIN, f32::MAX];

wgsl_struct! {
    /// What every pass knows of the camera and the frame.
    pub(crate) struct Camera {
        /// The defocus std at inverse depth d, px, is p = a d^2 + b d + c: its magnitude for a thin lens, else its positive part.
        lens: [f32; 3],
        /// 1 for a thin lens.
        thin_lens: u32,
        /// The range into which d is clamped, 1/m.
        inverse_depths: [f32; 2],
        /// The inverse depth in 1/m is the first number times the depth texture's value, plus the second.
        pub(crate) depth_map: [f32; 2],
        /// px per frame interval of a unit of the velocity texture, times the exposure fraction: the path while the shutter is open.
        path_scale: [f32; 2],
        /// Unused.
        padding: [u32; 2],
        /// The noise std of each pyramid level is slope * luma + intercept, for R, G and B; the fourth number is unused.
        slope: [[f32; 4]; NOISE_LEVELS],
        /// The other number of `slope`'s formula.
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
        /// The size of the area, px; everything between the passes is as large.
        pub(crate) size: [u32; 2],
        /// The seed of the frame's noise, and of the jitter along paths.
        key: [u32; 2],
        /// The most samples along the path of a pixel.
        most_taps: f32,
        /// How many slabs of depth are blurred apart, 1 or 3.
        pub(crate) slabs: u32,
        /// The first of three slabs lies behind the first of these inverse depths, 1/m, the last one in front of the second.
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
