//! Frames from image files.

use crate::{Error, Result, error::guarded, exr, write_atomically};
use ::image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError, ImageFormat, ImageReader,
    Limits, codecs::png::PngEncoder, metadata::Orientation,
};
use blindaug::{Encoded, Linear, Plane, Raster, Transfer};
use std::{
    fs::File,
    io::{BufReader, BufWriter, Read, Write},
    path::Path,
};

/// The longest side of an image that is read, px.
pub const MAX_SIDE: usize = 16_384;

/// The largest area of an image that is read, px.
pub const MAX_PIXELS: usize = 1 << 27;

/// Checks a size that a file claims, before memory is taken for it.
pub(crate) fn check_size(path: &Path, width: u64, height: u64) -> Result<(usize, usize)> {
    if width == 0 || height == 0 {
        return Err(Error::new(path, format!("the image is empty ({width} x {height} pixels)")));
    }
    if width.max(height) > MAX_SIDE as u64 || width * height > MAX_PIXELS as u64 {
        return Err(Error::new(
            path,
            format!(
                "the image is too large ({width} x {height} pixels; at most {MAX_SIDE} a side and {} megapixels are read)",
                MAX_PIXELS / 1_000_000
            ),
        ));
    }
    Ok((width as usize, height as usize))
}

/// Reads a frame: integer images are taken as display-encoded and mapped to [0, 1], EXR is scene-linear and encoded
/// here (it may exceed 1). Grey becomes RGB, alpha is left out, the orientation that a camera noted is applied.
///
/// # Errors
/// If the file is missing, damaged, too large ([`MAX_SIDE`], [`MAX_PIXELS`]), or no image with colour.
pub fn read_frame(path: impl AsRef<Path>) -> Result<Encoded> {
    let path = path.as_ref();
    if is_exr(path)? {
        return Ok(exr::read_colour(path)?.to_encoded(Transfer::Srgb));
    }
    let (image, orientation) = decode(path)?;
    encoded_from_image(path, image, orientation)
}

/// Reads an image in linear light: EXR as it is (its negative and invalid values become 0), others decoded by the
/// sRGB curve.
///
/// # Errors
/// As [`read_frame`].
pub fn read_linear(path: impl AsRef<Path>) -> Result<Linear> {
    let path = path.as_ref();
    if is_exr(path)? { exr::read_colour(path) } else { Ok(read_frame(path)?.to_linear(Transfer::Srgb)) }
}

/// Whether the file starts as an EXR does.
pub(crate) fn is_exr(path: &Path) -> Result<bool> {
    let mut magic = [0; 4];
    let mut file = File::open(path).map_err(|e| Error::cannot_read(path, &e))?;
    match file.read(&mut magic) {
        Ok(n) => Ok(n == 4 && magic == [0x76, 0x2f, 0x31, 0x01]),
        Err(e) => Err(Error::cannot_read(path, &e)),
    }
}

/// Width and height of a frame, px, from the head of its file.
pub(crate) fn frame_size(path: &Path) -> Result<(usize, usize)> {
    if is_exr(path)? {
        return exr::size(path);
    }
    with_decoder(path, |decoder, orientation| {
        let (w, h) = decoder.dimensions();
        use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
        let turned = matches!(orientation, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH);
        Ok(if turned { (h as usize, w as usize) } else { (w as usize, h as usize) })
    })
}

/// Whether an image has more than grey, from the head of its file.
pub(crate) fn has_colour(path: &Path) -> Result<bool> {
    with_decoder(path, |decoder, _| Ok(decoder.color_type().has_color()))
}

/// The pixels as they are stored, and the orientation in which to show them.
pub(crate) fn decode(path: &Path) -> Result<(DynamicImage, Orientation)> {
    with_decoder(path, |decoder, orientation| {
        let image = DynamicImage::from_decoder(decoder).map_err(|e| from_image_error(path, e))?;
        Ok((image, orientation))
    })
}

/// What `read` makes of an image whose head has been read and checked, and of its orientation.
fn with_decoder<T>(
    path: &Path,
    read: impl FnOnce(Box<dyn ImageDecoder>, Orientation) -> Result<T>,
) -> Result<T> {
    guarded(path, || {
        let file = File::open(path).map_err(|e| Error::cannot_read(path, &e))?;
        let mut reader = ImageReader::new(BufReader::new(file))
            .with_guessed_format()
            .map_err(|e| Error::cannot_read(path, &e))?;
        if reader.format().is_none() {
            return Err(Error::new(path, "not an image that can be read (PNG, JPEG, TIFF, BMP, PNM or EXR)"));
        }
        if reader.format() == Some(ImageFormat::Jpeg) && !jpeg_is_whole(path)? {
            return Err(Error::new(path, "the file is cut short"));
        }
        let mut limits = Limits::no_limits();
        limits.max_alloc = Some(16 * MAX_PIXELS as u64);
        reader.limits(limits);
        let mut decoder = reader.into_decoder().map_err(|e| from_image_error(path, e))?;
        let (width, height) = decoder.dimensions();
        check_size(path, width.into(), height.into())?;
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        read(Box::new(decoder), orientation)
    })
}

/// Whether the picture of a JPEG file ends with its end mark. The decoder would fill up what is missing with grey.
fn jpeg_is_whole(path: &Path) -> Result<bool> {
    let bytes = std::fs::read(path).map_err(|e| Error::cannot_read(path, &e))?;
    // Segments of a mark and a length, up to the coded picture, in which marks are unique.
    let mut rest = bytes.get(2..).unwrap_or(&[]);
    loop {
        match rest {
            [0xff, 0xda, picture @ ..] => return Ok(picture.windows(2).any(|mark| mark == [0xff, 0xd9])),
            [0xff, rest_of_fill @ ..] if rest_of_fill.first() == Some(&0xff) => rest = rest_of_fill,
            [0xff, _, high, low, ..] => {
                let length = usize::from(u16::from_be_bytes([*high, *low]));
                rest = rest.get(2 + length..).unwrap_or(&[]);
            }
            _ => return Ok(false),
        }
    }
}

fn from_image_error(path: &Path, e: ImageError) -> Error {
    match e {
        ImageError::Unsupported(e) => {
            Error::new(path, format!("this variant of the format cannot be read ({e}); save it as PNG"))
        }
        ImageError::Limits(e) => Error::new(path, format!("the image is too large ({e})")),
        e => Error::damaged(path, e),
    }
}

fn encoded_from_image(path: &Path, mut image: DynamicImage, orientation: Orientation) -> Result<Encoded> {
    image.apply_orientation(orientation);
    let (width, height) = (image.width() as usize, image.height() as usize);
    // Float images may hold anything; integer ones lie in [0, 1] already.
    let finite = |v: f32| if v.is_finite() { v.max(0.0) } else { 0.0 };
    let float = matches!(image, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_));
    let image = image.into_rgb32f();
    if float {
        exr::mostly_numbers(path, image.pixels().flat_map(|p| p.0))?;
    }
    let data = image.pixels().map(|p| p.0.map(finite)).collect();
    Raster::from_vec(width, height, data).map(Encoded).map_err(|e| Error::new(path, e.to_string()))
}

/// Writes a PNG of 8 bits per value, rounded to the nearest and clipped to [0, 1].
///
/// # Errors
/// If the file cannot be written; then nothing is left of it.
pub fn write_png(path: impl AsRef<Path>, frame: &Encoded) -> Result<()> {
    write_png_of(path.as_ref(), frame.0.size(), &bytes_of(&frame.0), ExtendedColorType::Rgb8)
}

/// Writes four values in [0, 1] per pixel as an RGBA PNG of 8 bits, alpha being one of them.
///
/// # Errors
/// If the file cannot be written; then nothing is left of it.
pub fn write_texture(path: impl AsRef<Path>, texture: &Raster<[f32; 4]>) -> Result<()> {
    write_png_of(path.as_ref(), texture.size(), &bytes_of(texture), ExtendedColorType::Rgba8)
}

/// Writes a frame as [`write_png`] does, with 16 bits per value.
///
/// # Errors
/// If the file cannot be written; then nothing is left of it.
pub fn write_png16(path: impl AsRef<Path>, frame: &Encoded) -> Result<()> {
    let bytes = bytes16_of(frame.0.data().as_flattened());
    write_png_of(path.as_ref(), frame.0.size(), &bytes, ExtendedColorType::Rgb16)
}

/// Writes values in [0, 1] as a grey PNG of 16 bits; NaN becomes 0.
///
/// # Errors
/// If the file cannot be written; then nothing is left of it.
pub fn write_grey16(path: impl AsRef<Path>, plane: &Plane) -> Result<()> {
    write_png_of(path.as_ref(), plane.size(), &bytes16_of(plane.data()), ExtendedColorType::L16)
}

fn bytes_of<const N: usize>(image: &Raster<[f32; N]>) -> Vec<u8> {
    image.data().as_flattened().iter().map(|&v| byte_from_encoded(v)).collect()
}

/// In the byte order of this machine, as encoders take them.
fn bytes16_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| ((v.clamp(0.0, 1.0) * 65535.0).round() as u16).to_ne_bytes()).collect()
}

fn write_png_of(
    path: &Path,
    (width, height): (usize, usize),
    bytes: &[u8],
    color: ExtendedColorType,
) -> Result<()> {
    let (width, height) = (width as u32, height as u32);
    write_atomically(path, |partial| {
        let mut file = BufWriter::new(File::create(partial)?);
        PngEncoder::new(&mut file).write_image(bytes, width, height, color).map_err(|e| match e {
            ImageError::IoError(e) => e,
            e => std::io::Error::other(e),
        })?;
        file.flush()
    })
}

/// The 8-bit value that is nearest to an encoded one.
pub(crate) fn byte_from_encoded(v: f32) -> u8 {
    // A cast saturates, and takes NaN to 0.
    (255.0 * v + 0.5) as u8
}
