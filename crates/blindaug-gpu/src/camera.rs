//! What the shaders know of a camera model.

use crate::composite::Quality;
use blindaug::Result;
use blindaug::composite::CompositeOptions;
use blindaug::model::{BlurSpace, CameraModel, DefocusCurve, NOISE_LEVELS};
use blindaug::synth::Blur;

/// All inverse depths; shaders need not know infinity.
const EVERYTHING: [f32; 2] = [f32::MIN, f32::MAX];

/// `Camera` of common.wgsl, field by field.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct Uniforms {
    lens: [f32; 3],
    thin_lens: u32,
    inverse_depths: [f32; 2],
    pub(crate) depth_map: [f32; 2],
    path_scale: [f32; 2],
    _to_16_bytes: [u32; 2],
    slope: [[f32; 4]; NOISE_LEVELS],
    intercept: [[f32; 4]; NOISE_LEVELS],
    clip: f32,
    noise: u32,
    encoded_space: u32,
    pub(crate) linear_target: u32,
    pub(crate) origin: [u32; 2],
    pub(crate) size: [u32; 2],
    key: [u32; 2],
    most_taps: f32,
    pub(crate) slabs: u32,
    cuts: [f32; 2],
    _padding: [u32; 2],
}

impl Uniforms {
    /// What of a model is known and asked for. `velocity_scale`: px per frame interval of a unit of the velocity texture.
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

    /// Whether anything is out of focus.
    pub(crate) fn defocuses(&self) -> bool {
        self.lens != [0.0; 3]
    }

    /// Whether anything moves while the shutter is open.
    pub(crate) fn moves(&self) -> bool {
        self.path_scale != [0.0; 2]
    }
}

impl Quality {
    pub(crate) fn most_taps(self) -> f32 {
        match self {
            Self::High => 128.0,
            Self::Medium => 24.0,
            Self::Low => 10.0,
        }
    }
}
