//! Inverse depth from depth maps.

use crate::{
    Error, Result, exr,
    image::{decode, strips},
    limits::is_exr,
};
use blindaug::{Plane, Raster, model::inverse_of_metric};
use std::path::Path;

/// The meaning of the numbers in a depth map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthValues {
    /// Depth along the view axis: EXR in metres, integers divided by [`DepthFormat::per_metre`]; 0 is no reading.
    #[default]
    Metric,
    /// Inverse depth: EXR in 1/m, integers divided by [`DepthFormat::per_metre`]; 0 is infinitely far.
    Inverse,
    /// Inverse depth of unknown scale: EXR as it is, integers mapped to [0, 1]; 0 is the farthest.
    RelativeInverse,
}

/// The format of depth maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthFormat {
    /// The meaning of the numbers; metric depth by default.
    pub values: DepthValues,
    /// Integer values per metre (or per 1/m), > 0; 1000 (millimetres) by default. EXR values are not divided by it.
    pub per_metre: f32,
}

impl Default for DepthFormat {
    fn default() -> Self {
        Self { values: DepthValues::Metric, per_metre: 1000.0 }
    }
}

/// Reads a depth map as inverse depth, 1/m or relative ([`DepthValues`]); NaN: no reading. Metric depths that are
/// zero, negative, infinite (from 1e9 m on) or NaN, and negative or invalid inverse depths, are no readings.
///
/// # Errors
/// If the file is missing, damaged, too large, a colour picture, an EXR without `Z`, or without a single reading, or if
/// `per_metre` is not positive, or the default one for metric depth of 8 bits, which would end at 0.255 m. An EXR of metric depth may say that all is infinitely far, as renderers do of frames that their object has left:
/// the map is then NaN everywhere.
pub fn read_inverse_depth(path: impl AsRef<Path>, format: DepthFormat) -> Result<Plane> {
    let path = path.as_ref();
    if !(format.per_metre.is_finite() && format.per_metre > 0.0) {
        return Err(Error::new(path, "the depth scale must be a positive number of units per metre"));
    }
    // `values` are as stored; `max` is the largest value of an integer image's type.
    let (values, max) = if is_exr(path)? { (exr::read_depth(path)?, None) } else { integers(path)? };
    if let (Some(max), DepthValues::Metric) = (max, format.values)
        && max <= u8::MAX.into()
        && format.per_metre == DepthFormat::default().per_metre
    {
        let farthest = max / format.per_metre;
        return Err(Error::new(
            path,
            format!(
                "8 bits per value reach as far as {farthest} m at {} units a metre: give the depth scale (units a metre), or depth of 16 bits",
                format.per_metre
            ),
        ));
    }
    let scale = match (max, format.values) {
        (None, _) => 1.0,
        (Some(max), DepthValues::RelativeInverse) => max.recip(),
        (Some(_), _) => format.per_metre.recip(),
    };
    let all_is_far = max.is_none()
        && format.values == DepthValues::Metric
        && values.data().iter().all(|&v| v > 0.0 && inverse_of_metric(v).is_nan());
    let mut inverse = values;
    for v in inverse.data_mut() {
        *v = match format.values {
            DepthValues::Metric => inverse_of_metric(*v * scale),
            _ if *v >= 0.0 && v.is_finite() => *v * scale,
            _ => f32::NAN,
        };
    }
    if !all_is_far && inverse.data().iter().all(|d| d.is_nan()) {
        return Err(Error::new(
            path,
            "the depth map has no valid reading (its values are zero, negative, infinite or NaN)",
        ));
    }
    Ok(inverse)
}

/// The values of a grey integer image, and the largest value of its type.
fn integers(path: &Path) -> Result<(Plane, Option<f32>)> {
    // The orientation noted in the file is not applied: depth maps are taken as they are stored.
    let (image, _) = decode(path)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let color = image.color();
    if color.bytes_per_pixel() > 2 * color.channel_count() {
        return Err(Error::new(
            path,
            "depth as floats is read from EXR files: save it as EXR with a channel Z",
        ));
    }
    let max: u16 = if color.bytes_per_pixel() > color.channel_count() { u16::MAX } else { u8::MAX.into() };
    let mut data = Vec::with_capacity(width * height);
    for strip in strips(&image) {
        let values: Option<Vec<f32>> = match max {
            u16::MAX => grey(strip.into_rgb16().pixels().map(|p| p.0)),
            _ => grey(strip.into_rgb8().pixels().map(|p| p.0)),
        };
        let Some(values) = values else {
            return Err(Error::new(path, "this is a colour picture, not a depth map of one channel"));
        };
        data.extend(values);
    }
    let plane = Raster::from_vec(width, height, data).map_err(|e| Error::new(path, e.to_string()))?;
    Ok((plane, Some(max.into())))
}

/// The value of each pixel if its three channels are always equal (many tools write depth as RGB), else `None`.
fn grey<T: Copy + PartialEq + Into<f32>>(pixels: impl Iterator<Item = [T; 3]>) -> Option<Vec<f32>> {
    pixels.map(|[r, g, b]| (r == g && g == b).then_some(r.into())).collect()
}
