//! The values of the host's images as rasters, and back.

use crate::{
    effect::Failure,
    host::{Image, Pixels, Values},
};
use blindaug::Raster;
use half::f16;

/// The value that bytes stand for, in [0, 1] if they are integers.
fn value(bytes: &[u8], values: Values) -> f32 {
    match (values, bytes) {
        (Values::Byte, [v]) => f32::from(*v) / 255.0,
        (Values::Short, &[a, b]) => f32::from(u16::from_ne_bytes([a, b])) / 65_535.0,
        (Values::Half, &[a, b]) => f16::from_ne_bytes([a, b]).to_f32(),
        (Values::Float, &[a, b, c, d]) => f32::from_ne_bytes([a, b, c, d]),
        _ => f32::NAN,
    }
}

/// Writes a value as bytes; integers are rounded to the nearest.
fn put(v: f32, bytes: &mut [u8], values: Values) {
    match values {
        Values::Byte => bytes.copy_from_slice(&[(v.clamp(0.0, 1.0) * 255.0).round() as u8]),
        Values::Short => {
            bytes.copy_from_slice(&((v.clamp(0.0, 1.0) * 65_535.0).round() as u16).to_ne_bytes());
        }
        Values::Half => bytes.copy_from_slice(&f16::from_f32(v).to_ne_bytes()),
        Values::Float => bytes.copy_from_slice(&v.to_ne_bytes()),
    }
}

/// The part of an image that lies in `frame`, from the top; `outside` where the image has no pixels. An image of three channels has alpha 1;
/// the value of a single channel stands in all four.
pub fn raster(image: &Image, frame: Pixels, outside: [f32; 4]) -> Result<Raster<[f32; 4]>, Failure> {
    let (width, height) = (frame.width(), frame.height());
    let mut pixels = vec![outside; width * height];
    if let Some(common) = frame.within(image.bounds()) {
        let (channels, values) = (image.channels(), image.values());
        let pixel = channels * values.bytes();
        for y in common.y1..common.y2 {
            let Some(row) = image.row(y) else { continue };
            let row = row.chunks_exact(pixel).skip((common.x1 - image.bounds().x1) as usize);
            let at = (frame.y2 - 1 - y) as usize * width + (common.x1 - frame.x1) as usize;
            for (to, from) in pixels[at..][..common.width()].iter_mut().zip(row) {
                let of = |c: usize| value(&from[c * values.bytes()..][..values.bytes()], values);
                *to = match channels {
                    4 => [of(0), of(1), of(2), of(3)],
                    3 => [of(0), of(1), of(2), 1.0],
                    _ => [of(0); 4],
                };
            }
        }
    }
    Raster::from_vec(width, height, pixels).map_err(|e| Failure::Sentence(e.to_string()))
}

/// Writes what lies in `window` of a picture that fills `frame`, as far as the image has it; what is outside the frame becomes 0.
///
/// # Errors
/// If the image does not have four channels.
pub fn write(
    picture: &Raster<[f32; 4]>,
    frame: Pixels,
    window: Pixels,
    image: &mut Image,
) -> Result<(), Failure> {
    let (channels, values) = (image.channels(), image.values());
    if channels != 4 {
        return Err(Failure::Sentence(format!(
            "the output has {channels} channels, but must have R, G, B and A"
        )));
    }
    let bounds = image.bounds();
    let Some(window) = window.within(bounds) else { return Ok(()) };
    for y in window.y1..window.y2 {
        let inside = |x: i32| {
            let (x, y) = (x - frame.x1, frame.y2 - 1 - y);
            let there = x >= 0 && y >= 0 && (x as usize) < picture.width() && (y as usize) < picture.height();
            if there { picture.at(x as usize, y as usize) } else { [0.0; 4] }
        };
        let Some(row) = image.row_mut(y) else { continue };
        let row = row.chunks_exact_mut(channels * values.bytes()).skip((window.x1 - bounds.x1) as usize);
        for (x, to) in (window.x1..window.x2).zip(row) {
            for (v, bytes) in inside(x).into_iter().zip(to.chunks_exact_mut(values.bytes())) {
                put(v, bytes, values);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_within_half_a_step() {
        for (values, step) in
            [(Values::Byte, 1.0 / 255.0), (Values::Short, 1.0 / 65_535.0), (Values::Half, 1.0 / 2048.0)]
        {
            let mut bytes = vec![0; values.bytes()];
            let worst = (0..=1000).map(|i| i as f32 / 1000.0).map(|v| {
                put(v, &mut bytes, values);
                (value(&bytes, values) - v).abs()
            });
            let worst = worst.fold(0.0, f32::max);
            assert!(worst <= 0.5001 * step, "{values:?}: {worst}");
            // Negative control: the steps are not finer.
            assert!(worst > 0.2 * step, "{values:?}: {worst}");
        }
        let mut bytes = [0; 4];
        for v in [-1.5, 0.1, 7e4, f32::INFINITY] {
            put(v, &mut bytes, Values::Float);
            assert_eq!(value(&bytes, Values::Float), v);
        }
        let mut byte = [9];
        for (v, is) in [(f32::NAN, 0), (-1.0, 0), (2.0, 255)] {
            put(v, &mut byte, Values::Byte);
            assert_eq!(byte, [is]);
        }
    }
}
