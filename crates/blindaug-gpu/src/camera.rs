//! A camera model as the compositor's shaders read it.

use crate::layout::wgsl_struct;
use crate::quality::Quality;
use blindaug::composite::CompositeOptions;
use blindaug::model::{BlurSpace, CameraModel, DefocusCurve, KNOTS, NOISE_KNOTS, NOISE_LEVELS, NoiseModel};
use blindaug::synth::Blur;
use blindaug::synth::noise::{MOST_TERMS, temporal_weights};
use blindaug::{Error, Result, Transfer};

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
        /// 1 if the noise follows curves over the picture's colour, 0 if it follows straight lines over luminance.
        noise_curves: u32,
        /// The number of frames whose white noise is summed for the noise of a frame.
        noise_terms: u32,
        /// The slopes of the noise std of each pyramid level, slope * luma + intercept, for R, G and B; the fourth number is unused.
        slope: [[f32; 4]; NOISE_LEVELS],
        /// The intercepts of the noise std of each pyramid level, for R, G and B; the fourth number is unused.
        intercept: [[f32; 4]; NOISE_LEVELS],
        /// The encoded values at which the curves of the noise's variance have their points.
        knots: [[f32; 4]; NOISE_KNOTS / 4],
        /// The points of the curves, in the order of `blindaug::model::CurveLevel::variance`, levels first.
        variance: [[f32; 4]; 9 * NOISE_LEVELS * NOISE_KNOTS / 4],
        /// The rows of the matrices by which three independent noises become those of R, G and B, three rows for each level.
        mixing: [[f32; 4]; 3 * NOISE_LEVELS],
        /// The weights of the white noise of the frame, the frame before it and so on.
        noise_weights: [[f32; 4]; MOST_TERMS / 4],
        /// The encoded value at which the sensor clips.
        clip: f32,
        /// 1 if there is noise to add.
        noise: u32,
        /// 1 if blur acts on encoded values, 0 if it acts on light.
        pub(crate) encoded_space: u32,
        /// 1 if light is written, 0 if display-encoded values are.
        pub(crate) linear_target: u32,
        /// The top left corner of the area in which the layer may be seen, px of the frame.
        pub(crate) origin: [u32; 2],
        /// The size of the area, px.
        pub(crate) size: [u32; 2],
        /// The seed of the frame's noise, and of the jitter along paths.
        key: [u32; 2],
        /// The most samples along the path of a pixel.
        most_taps: f32,
        /// The number of slabs of depth that are blurred apart from each other, 1 or 3.
        pub(crate) slabs: u32,
        /// The inverse depths between the three slabs, 1/m: the first slab lies behind `cuts[0]`, the last one in front of `cuts[1]`.
        cuts: [f32; 2],
        /// The size of the frame, px.
        pub(crate) frame: [u32; 2],
        /// 1 if every pass is to write all of its pixels, since the frame before had other passes.
        pub(crate) refresh: u32,
        /// The middle of the exposure after the frame's time, in paths.
        path_centre: f32,
        /// 1 if the lens may put the layer out of focus.
        pub(crate) defocuses: u32,
        /// 1 if the layer may move while the shutter is open.
        pub(crate) moves: u32,
        /// The longest distance along the path of a pixel from each sample to the next, px.
        most_step: f32,
        /// 1 if the depth texture tells where nothing is.
        pub(crate) knows_nothing: u32,
        /// The depth texture's value where nothing is.
        pub(crate) nothing: f32,
        /// 1 if the passes read the layer itself, unless it has broken values; 0 if they read a copy of it in the space in which blur acts.
        pub(crate) direct: u32,
        /// 1 if the targets hold the frame already.
        pub(crate) over_targets: u32,
        /// The blocks up to whose distance the camera's sharpening spreads a change; 0 for a camera that does not sharpen.
        pub(crate) sharpening_blocks: u32,
        /// Nothing, for the struct's size in WGSL.
        padding: [u32; 2],
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
        if model.transfer != Transfer::Srgb {
            return Err(Error::new(format!(
                "the camera model is of {} frames, but the graphics device composites sRGB: composite on the processor",
                model.transfer.name()
            )));
        }
        let mut uniforms = Self {
            clip: 1.0,
            encoded_space: u32::from(model.blur_space == BlurSpace::Encoded),
            key: [
                options.seed as u32 ^ (options.seed >> 32) as u32 ^ ((number >> 32) as u32).rotate_left(16),
                number as u32,
            ],
            most_taps: quality.most_taps(),
            most_step: quality.most_step_px(),
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
            let shutter = motion_blur.shutter();
            uniforms.path_scale = velocity_scale.map(|s| s * shutter.exposure.0);
            uniforms.path_centre =
                if shutter.exposure.0 > 0.0 { shutter.centre / shutter.exposure.0 } else { 0.0 };
        }
        if let Some(noise) = model.noise.known().filter(|_| !options.no_noise) {
            uniforms.noise = 1;
            uniforms.clip = noise.clip();
            uniforms.set_noise(noise);
        }
        Ok(uniforms)
    }

    fn set_noise(&mut self, noise: &NoiseModel) {
        let rgb = |[r, g, b]: [f32; 3]| [r, g, b, 0.0];
        self.slope = noise.lines().levels.map(|l| rgb(l.slope));
        self.intercept = noise.lines().levels.map(|l| rgb(l.intercept));
        for (row, c) in self.mixing.iter_mut().zip((0..3).cycle()) {
            row[c] = 1.0;
        }
        let weights = temporal_weights(noise.temporal_correlation());
        self.noise_terms = weights.len() as u32;
        self.noise_weights.as_flattened_mut()[..weights.len()].copy_from_slice(&weights);
        if let Some(curves) = noise.curves() {
            self.noise_curves = 1;
            self.knots.as_flattened_mut().copy_from_slice(&KNOTS);
            let points = curves.levels.iter().flat_map(|l| l.variance.as_flattened().as_flattened());
            self.variance.as_flattened_mut().iter_mut().zip(points).for_each(|(to, v)| *to = *v);
            let rows = curves.levels.iter().flat_map(|l| l.mixing);
            self.mixing.iter_mut().zip(rows).for_each(|(to, row)| *to = rgb(row));
        }
    }

    /// Whether the lens may put anything out of focus.
    pub(crate) fn has_lens(&self) -> bool {
        self.lens != [0.0; 3]
    }

    /// Whether the shutter is open while things move.
    pub(crate) fn has_path(&self) -> bool {
        self.path_scale != [0.0; 2]
    }
}
