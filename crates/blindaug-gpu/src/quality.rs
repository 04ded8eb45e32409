//! The quality of the compositor, that is, how closely it follows the reference, and the tables that defocus reads.

use crate::layout::wgsl_struct;
use blindaug::CameraModel;
use blindaug::composite::CompositeOptions;
use blindaug::filter;
use blindaug::model::Aperture;
use blindaug::synth::defocus::{self, Bokeh};

/// The quality of the compositor, that is, how closely it follows the reference. docs/gpu.md has the cost of each quality.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Quality {
    /// The quality for pictures that are kept, and for fast GPUs.
    #[default]
    High,
    /// The quality for headsets and desktops.
    Medium,
    /// The quality for phones.
    Low,
}

/// The number of octaves of the image that defocus reads: the image itself, and seven more, each of half the size of the one before.
pub(crate) const OCTAVES: usize = 8;

/// The number of times that the layer is halved for the finest image of the inverse depth and motion that are continued past its silhouette.
/// The shader extension.wgsl makes it in one pass, by a kernel for two halvings.
pub(crate) const CONTINUED: usize = 2;

/// The distance from one sample along a path to the next in defocus stds, if it is more than 1 px: what is blurred by a Gaussian has less than
/// 0.008 of its contrast left in what such samples miss.
pub(crate) const STEP_OF_STD: f32 = 2.0;

/// The number of variances in the table of discrete Gaussians; they rise evenly from 0 to [`GAUSSIAN_MOST`].
pub(crate) const GAUSSIANS: usize = 64;

/// The largest variance in the table of discrete Gaussians, px^2.
pub(crate) const GAUSSIAN_MOST: f32 = 3.25;

/// The number of disks in their table.
pub(crate) const DISKS: usize = 235;

/// The step of the std from each disk in the table to the next, px.
pub(crate) const DISK_STEP: f32 = 1.0 / 64.0;

/// The number of rows that the table has for each disk, from its middle row on.
pub(crate) const DISK_ROWS: usize = 12;

wgsl_struct! {
    /// The quality and the shape of out-of-focus points, as the defocus shader reads them.
    pub(crate) struct DefocusQuality {
        /// The least variance that is left to blur on an octave, px^2 of the octave: for Gaussians and for disks.
        least_variance: [f32; 2],
        /// The radius at which a Gaussian is cut off, in stds.
        reach: f32,
        /// 1 if out-of-focus points become disks, 0 if they become Gaussians.
        disk: u32,
    }
}

impl Quality {
    /// The longest distance along the path of a pixel from each sample to the next, px.
    pub(crate) fn most_step_px(self) -> f32 {
        match self {
            Self::High => 1.0,
            Self::Medium => 4.0,
            Self::Low => 6.0,
        }
    }

    /// The most samples along the path of a pixel.
    pub(crate) fn most_taps(self) -> f32 {
        match self {
            Self::High => 128.0,
            Self::Medium => 24.0,
            Self::Low => 10.0,
        }
    }

    /// The number of times that the layer is halved, 0 to 7, for the image that the shader defocus.wgsl reads for a pixel of this defocus std,
    /// px.
    pub fn octave(self, bokeh: Bokeh, sigma_px: f32) -> usize {
        let [gaussian, disk] = DefocusQuality::new(self, bokeh).least_variance;
        let least = if bokeh == Bokeh::Gaussian { gaussian } else { disk };
        let ratio = (sigma_px * sigma_px + 1.0 / 3.0) / (least + 1.0 / 3.0);
        ((0.5 * ratio.max(1.0).log2()) as usize).min(OCTAVES - 1)
    }

    /// The number of times that the shader defocus.wgsl reads the layer for a pixel of this defocus std, px.
    pub fn defocus_taps(self, bokeh: Bokeh, sigma_px: f32) -> u32 {
        let DefocusQuality { reach, .. } = DefocusQuality::new(self, bokeh);
        let variance = sigma_px * sigma_px;
        let octave = self.octave(bokeh, sigma_px);
        let scale = 0.25f32.powi(octave as i32);
        let left = variance * scale - (1.0 - scale) / 3.0;
        match bokeh {
            _ if sigma_px <= 0.0 => 1,
            Bokeh::Gaussian if octave == 0 && left < GAUSSIAN_MOST => {
                (1 + (reach * left.sqrt() - 0.25).ceil().clamp(1.0, 6.0) as u32).pow(2)
            }
            Bokeh::Gaussian => ((reach * left.sqrt()).ceil() as u32).pow(2),
            // The area of the disk with its rim.
            _ => (std::f32::consts::PI * (2.0 * left.sqrt() + 0.5).powi(2)).ceil() as u32,
        }
    }

    /// The number of times that the layer is read for a pixel whose path is this long, px, and which has this defocus std, px.
    pub fn motion_blur_taps(self, path_px: f32, sigma_px: f32) -> u32 {
        let step = (STEP_OF_STD * sigma_px).min(self.most_step_px()).max(1.0);
        ((path_px / step).ceil() + 1.0).min(self.most_taps()) as u32
    }
}

impl DefocusQuality {
    /// The numbers of a quality and a shape.
    pub(crate) fn new(quality: Quality, bokeh: Bokeh) -> Self {
        let (least_variance, reach) = match quality {
            Quality::High => ([0.5, 3.0], 3.3),
            Quality::Medium => ([0.3, 1.5], 2.4),
            Quality::Low => ([0.15, 0.75], 2.2),
        };
        Self { least_variance, reach, disk: u32::from(bokeh != Bokeh::Gaussian) }
    }
}

/// The aperture with which a camera's out-of-focus points are composited.
fn aperture_of(model: &CameraModel, options: &CompositeOptions) -> Option<Aperture> {
    let lens = model.defocus.known()?;
    Some(Aperture { bokeh: options.bokeh.unwrap_or(lens.bokeh.bokeh), ..lens.bokeh })
}

/// The shape that the compositor gives to out-of-focus points.
pub(crate) fn shape_of(model: &CameraModel, options: &CompositeOptions) -> Bokeh {
    match aperture_of(model, options).map(|aperture| aperture.bokeh) {
        None | Some(Bokeh::Gaussian) => Bokeh::Gaussian,
        Some(_) => Bokeh::Disk,
    }
}

/// A sentence about a camera's out-of-focus points whose shape the compositor does not have, without a full stop; `None` if it has the shape. It
/// has Gaussians and disks that are round in px; the reference on the processor has all shapes.
pub fn rounded(model: &CameraModel, options: &CompositeOptions) -> Option<String> {
    let aperture = aperture_of(model, options)?;
    let wide = model.capture.pixel_aspect;
    let of_pixels = match wide {
        1.0 => String::new(),
        _ => format!(" in pixels {wide} times as wide as high"),
    };
    let shape = shape_of(model, options);
    (aperture != shape.into() || wide != 1.0).then(|| {
        format!(
            "on the GPU, out-of-focus points are {} of the same second moment, round in px, instead of {}{of_pixels}",
            Aperture::from(shape).words(),
            aperture.words()
        )
    })
}

/// The right halves of discrete Gaussians of rising variance, 8 taps each, centre first.
pub(crate) fn gaussian_table() -> [[f32; 8]; GAUSSIANS] {
    std::array::from_fn(|i| {
        let variance = GAUSSIAN_MOST * i as f32 / (GAUSSIANS - 1) as f32;
        let kernel = filter::gaussian_kernel(variance.sqrt());
        std::array::from_fn(|tap| kernel.get(tap).copied().unwrap_or(0.0))
    })
}

/// Half the length of each row, px, of disks of rising std, from the middle row on.
pub(crate) fn disk_table() -> Vec<[f32; DISK_ROWS]> {
    let disk = |i: usize| {
        let halves = defocus::disk_half_widths(i as f32 * DISK_STEP);
        std::array::from_fn(|dy| halves.get(dy).copied().unwrap_or(0.0))
    };
    (0..DISKS).map(disk).collect()
}

#[cfg(test)]
mod tests {
    use super::{filter, rounded};
    use blindaug::CameraModel;
    use blindaug::composite::CompositeOptions;
    use blindaug::model::{Aperture, Bokeh, Capture, DefocusModel, Estimate};

    #[test]
    fn shapes_that_the_compositor_does_not_have_are_told() {
        let capture = Capture { width: 64, height: 48, fps: None, frames_used: 1, pixel_aspect: 1.0 };
        let of = |bokeh: Aperture, pixel_aspect| {
            let mut model = CameraModel::unknown(Capture { pixel_aspect, ..capture }, "not needed");
            model.defocus = Estimate::Known(DefocusModel { bokeh, ..DefocusModel::given_lens(3.0, 1.0) });
            rounded(&model, &CompositeOptions::default())
        };
        assert_eq!(of(Bokeh::Gaussian.into(), 1.0), None);
        assert_eq!(of(Bokeh::Disk.into(), 1.0), None);
        let polygon = Bokeh::Polygon { blades: 6, roundness: 0.0, rotation_degrees: 0.0 };
        let said = of(polygon.into(), 1.0).expect("polygons are not there");
        assert!(said.contains("are a disk") && said.contains("of 6 blades"), "{said}");
        assert!(of(Aperture { squeeze: 2.0, ..Bokeh::Gaussian.into() }, 1.0).is_some());
        assert!(of(Bokeh::Disk.into(), 2.0).is_some_and(|said| said.contains("2 times as wide")));
        assert_eq!(rounded(&CameraModel::unknown(capture, "not needed"), &CompositeOptions::default()), None);
    }

    #[test]
    fn the_smoothing_of_the_shader_has_the_reference_s_std_and_leaves_as_little_noise() {
        let number = |name: &str| -> f64 {
            let line =
                include_str!("composite.wgsl").lines().find(|l| l.starts_with(&format!("const {name} = ")));
            let value = line.and_then(|l| l.split_once(" = ")).expect("the constant is there").1;
            value.trim_end_matches(';').parse().expect("a number")
        };
        let (middle, side) = (number("SMOOTHING_MIDDLE"), number("SMOOTHING_SIDE"));
        // Each side's tap lies 1.5 px from the middle, so that it reads two pixels alike.
        let kernel = [middle, 0.5 * side, 0.5 * side];
        let of = |kernel: &[f64], weigh: &dyn Fn(f64, f64) -> f64| {
            let sides =
                kernel.iter().enumerate().skip(1).map(|(i, &w)| 2.0 * weigh(w, i as f64)).sum::<f64>();
            weigh(kernel[0], 0.0) + sides
        };
        assert!((of(&kernel, &|w, _| w) - 1.0).abs() < 1e-12);
        // The reference's `missing_noise` smooths the frame by 1.5 px.
        assert!((of(&kernel, &|w, x| w * x * x) - 1.5f64.powi(2)).abs() < 1e-12);
        let reference: Vec<f64> = filter::gaussian_kernel(1.5).iter().map(|&w| f64::from(w)).collect();
        let [ours, theirs] = [&kernel[..], &reference].map(|k| of(k, &|w, _| w * w));
        assert!((ours / theirs - 1.0).abs() < 0.15, "{ours} {theirs}");
        // A mean over 3 pixels leaves much more.
        assert!(of(&[1.0 / 3.0; 2], &|w, _| w * w) / theirs > 1.5);
    }
}
