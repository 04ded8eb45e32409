//! Reading frames from image files, and writing PNG and TIFF files.

use crate::{
    Error, IccProfile, Reading, Result,
    error::{guarded, one_line},
    exr,
    files::open_file,
    limits::{BYTES_PER_PIXEL, DEFLATE_RATIO, MAX_PIXELS, check_length, check_size, is_exr, pixels_in_words},
    memory,
    not_numbers::{Counted, few},
    partial::{PartialFile, cannot_write, write_atomically},
};
use ::image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError, ImageFormat, ImageReader,
    Limits,
    codecs::{
        png::PngEncoder,
        tiff::{TiffDecoder, TiffEncoder},
    },
    metadata::Orientation,
};
use blindaug::{
    Encoded, Linear, Plane, Raster, Transfer, byte_from_encoded, finite_light, word_from_encoded,
};
use std::{
    cell::RefCell,
    fs::File,
    io::{self, BufReader, BufWriter, Read, Write},
    path::Path,
    rc::Rc,
};

/// Reads a frame. Integer images are taken as display-encoded and mapped to [0, 1]. EXR is scene-linear and is encoded here;
/// its values may exceed 1. Grey becomes RGB, alpha is left out, and the orientation that a camera noted is applied.
///
/// # Errors
/// If the file is missing, damaged, too large ([`MAX_SIDE`](crate::MAX_SIDE), [`MAX_PIXELS`]), or no image with colour.
pub fn read_frame(path: impl AsRef<Path>) -> Result<Encoded> {
    Reading::default().read(path)
}

/// Reads a frame's values as they are stored, integers mapped to [0, 1]; invalid ones become 0, and negative ones too, unless those of EXR are
/// to be kept.
pub(crate) fn read_values(path: &Path, below_zero: bool) -> Result<Counted<Encoded>> {
    if is_exr(path)? {
        let (Linear(values), not_numbers) = exr::read_colour(path, below_zero)?;
        return Ok((Encoded(values), not_numbers));
    }
    let (image, orientation) = decode(path)?;
    encoded_from_image(path, image, orientation)
}

/// Reads an image in linear light: EXR as it is (its negative and invalid values become 0), others decoded by the
/// sRGB curve.
///
/// # Errors
/// The same as [`read_frame`].
pub fn read_linear(path: impl AsRef<Path>) -> Result<Linear> {
    let path = path.as_ref();
    let reading = Reading { transfer: Transfer::Linear, ..Reading::default() };
    Ok(Linear(reading.read(path)?.0))
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

/// Whether an image has colour channels, from the head of its file.
pub(crate) fn has_colour(path: &Path) -> Result<bool> {
    with_decoder(path, |decoder, _| Ok(decoder.color_type().has_color()))
}

/// The ICC profile that an image's file holds, if any.
pub(crate) fn icc_profile(path: &Path) -> Result<Option<Vec<u8>>> {
    let profile = with_decoder(path, |mut decoder, _| Ok(decoder.icc_profile().unwrap_or(None)))?;
    let is_tiff =
        [b"II".as_slice(), b"MM"].iter().any(|mark| head(path).is_ok_and(|h| h.bytes.starts_with(mark)));
    if profile.is_some() || !is_tiff {
        return Ok(profile);
    }
    // Within the limits that the pixels need, a TIFF file's tags of more bytes than these are left out.
    guarded(path, || {
        let decoder = TiffDecoder::new(BufReader::new(open_file(path)?));
        Ok(decoder.and_then(|mut decoder| decoder.icc_profile()).unwrap_or(None))
    })
}

/// The bits of a value, 8, 16 or 32, from the head of an image's file.
pub(crate) fn decoded_bits(path: &Path) -> Result<u8> {
    with_decoder(path, |decoder, _| {
        let color = decoder.color_type();
        Ok((8 * u16::from(color.bytes_per_pixel()) / u16::from(color.channel_count())) as u8)
    })
}

/// The pixels as they are stored, and the orientation in which to show them.
pub(crate) fn decode(path: &Path) -> Result<(DynamicImage, Orientation)> {
    with_decoder(path, |decoder, orientation| {
        let image = DynamicImage::from_decoder(decoder).map_err(|e| from_image_error(path, e))?;
        Ok((image, orientation))
    })
}

/// Reads and checks an image's head, then returns the result of `read`, which gets the decoder and the orientation.
fn with_decoder<T>(
    path: &Path,
    read: impl FnOnce(Box<dyn ImageDecoder>, Orientation) -> Result<T>,
) -> Result<T> {
    guarded(path, || {
        let file = open_file(path)?;
        let mut reader = ImageReader::new(BufReader::new(file))
            .with_guessed_format()
            .map_err(|e| Error::cannot_read(path, &e))?;
        if reader.format().is_none() {
            return Err(Error::new(path, "not an image that can be read (PNG, JPEG, TIFF, BMP, PNM or EXR)"));
        }
        let head = head(path)?;
        if reader.format() == Some(ImageFormat::Jpeg) {
            // Both `jpeg_is_whole` and the decoder hold the whole file.
            memory::fits(path, "the file", 2 * head.length)?;
            if !jpeg_is_whole(path)? {
                return Err(Error::new(path, "the file is cut short"));
            }
        }
        let format = reader.format();
        let mut limits = Limits::no_limits();
        limits.max_alloc = Some(memory::budget().min(16 * MAX_PIXELS as u64));
        reader.limits(limits);
        let mut decoder = reader.into_decoder().map_err(|e| from_image_error(path, e))?;
        let (width, height) = decoder.dimensions();
        let (width, height) = (u64::from(width), u64::from(height));
        check_size(path, width, height)?;
        let stored = decoder.total_bytes();
        let least = least_length(format, &head.bytes, (width, height), stored);
        check_length(path, head.length, least, (width, height))?;
        // The memory that the decoder takes, bytes, besides that of our own frame.
        let decoded = match format {
            // The TIFF decoder assembles a copy of its own from strips.
            Some(ImageFormat::Tiff) => 2 * stored,
            // A progressive JPEG also needs memory for its coefficients.
            Some(ImageFormat::Jpeg) => stored + 2 * (stored + head.length),
            _ => stored,
        };
        let frame = width * height * BYTES_PER_PIXEL;
        memory::fits(path, &pixels_in_words(width, height), decoded + frame)?;
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        read(Box::new(decoder), orientation)
    })
}

/// The first bytes of a file, 64 at most, and the file's length in bytes.
struct Head {
    bytes: Vec<u8>,
    length: u64,
}

fn head(path: &Path) -> Result<Head> {
    let fail = |e| Error::cannot_read(path, &e);
    let file = open_file(path)?;
    let length = file.metadata().map_err(fail)?.len();
    let mut bytes = Vec::new();
    file.take(64).read_to_end(&mut bytes).map_err(fail)?;
    Ok(Head { bytes, length })
}

/// The least length, bytes, of a file of this format that holds an image of this size, px, and of `decoded` bytes when decoded.
fn least_length(format: Option<ImageFormat>, head: &[u8], (width, height): (u64, u64), decoded: u64) -> u64 {
    /// The most pixels per byte: a block of 8 x 8 takes two bits, or one in a progressive file; doubled, to be safe.
    const JPEG_PIXELS: u64 = 1024;
    /// A compression ratio above that of LZW with codes of 12 bits. Fax codes of bilevel pages have no limit, and are not checked.
    const TIFF_RATIO: u64 = 4096;
    let pixels = width * height;
    let number = |at: usize, bytes: usize| {
        let bytes = head.get(at..at + bytes).unwrap_or_default();
        bytes.iter().rev().fold(0u64, |n, &b| n << 8 | u64::from(b))
    };
    match format {
        Some(ImageFormat::Png) => {
            // The first chunk, IHDR, has the bits per sample in byte 24 of the file and the colour type in byte 25.
            let samples = match number(25, 1) {
                2 => 3,
                4 => 2,
                6 => 4,
                _ => 1,
            };
            ((width * samples * number(24, 1)).div_ceil(8) + 1) * height / DEFLATE_RATIO
        }
        Some(ImageFormat::Jpeg) => pixels / JPEG_PIXELS,
        Some(ImageFormat::Tiff) if decoded > pixels => decoded / TIFF_RATIO,
        Some(ImageFormat::Bmp) => {
            // Run-length coding (1 and 2) may leave out any number of pixels.
            let (bits, runs) = match number(14, 4) {
                12 => (number(24, 2), false),
                _ => (number(28, 2), [1, 2].contains(&number(30, 4))),
            };
            if runs { 0 } else { (width * bits).div_ceil(8) * height }
        }
        Some(ImageFormat::Pnm) => match head {
            // P4 holds packed bits; P1, P2 and P3 hold decimal numbers, with spaces between them except in P1; the others hold bytes.
            [b'P', b'4', ..] => width.div_ceil(8) * height,
            [b'P', b'1', ..] => pixels,
            [b'P', b'2', ..] => 2 * pixels - 1,
            [b'P', b'3', ..] => 6 * pixels - 1,
            // P7 holds at least a byte per pixel, even for samples of one bit.
            [b'P', b'7', ..] => pixels,
            _ => decoded,
        },
        _ => 0,
    }
}

/// Whether the coded picture of a JPEG file ends with an end marker. The decoder would fill a missing part with grey.
fn jpeg_is_whole(path: &Path) -> Result<bool> {
    let bytes = std::fs::read(path).map_err(|e| Error::cannot_read(path, &e))?;
    // Segments, each of a marker and a length, precede the coded picture, whose data cannot look like a marker.
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
            // The library lists the bits of each sample of a pixel, of which a damaged file may have thousands.
            let e = one_line(&e.to_string());
            Error::new(path, format!("this variant of the format cannot be read ({e}); save it as PNG"))
        }
        ImageError::Limits(e) => Error::new(path, format!("the image is too large ({e})")),
        e => Error::damaged(path, e),
    }
}

fn encoded_from_image(
    path: &Path,
    mut image: DynamicImage,
    orientation: Orientation,
) -> Result<Counted<Encoded>> {
    image.apply_orientation(orientation);
    let (width, height) = (image.width() as usize, image.height() as usize);
    // Float images may hold negative or invalid values; integer ones lie in [0, 1] already.
    let is_float = matches!(image, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_));
    let mut data = Vec::with_capacity(width * height);
    if let DynamicImage::ImageRgb8(bytes) = &image {
        // RGB of 8 bits, which most frames are, is converted without copies.
        let values: Vec<f32> = (0..=255u8).map(|v| f32::from(v) / 255.0).collect();
        data.extend(bytes.pixels().map(|p| p.0.map(|v| values[usize::from(v)])));
    } else {
        strips(&image).for_each(|s| data.extend(s.into_rgb32f().pixels().map(|p| p.0)));
    }
    let mut values = Raster::from_vec(width, height, data).map_err(|e| Error::new(path, e.to_string()))?;
    let mut not_numbers = 0;
    if is_float {
        not_numbers = few(path, values.data().iter().map(|p| p.iter().any(|v| v.is_nan())))?;
        values = values.map(|p| p.map(|v| finite_light(v, 0.0)));
    }
    Ok((Encoded(values), not_numbers))
}

/// Reads a matte, 0 to 1: the alpha of an image with any transparency, else the brightness (the mean of R, G and B).
pub(crate) fn read_matte(path: &Path) -> Result<Plane> {
    let (mut image, orientation) = decode(path)?;
    image.apply_orientation(orientation);
    let (width, height) = (image.width() as usize, image.height() as usize);
    let of = |alpha: bool| -> Vec<f32> {
        let rgba = strips(&image).flat_map(|s| s.into_rgba32f().pixels().map(|p| p.0).collect::<Vec<_>>());
        rgba.map(|[r, g, b, a]| if alpha { a } else { (r + g + b) / 3.0 }).collect()
    };
    let alpha = image.color().has_alpha().then(|| of(true)).filter(|a| a.iter().any(|v| *v < 1.0));
    let data = alpha.unwrap_or_else(|| of(false));
    Plane::from_vec(width, height, data).map_err(|e| Error::new(path, e.to_string()))
}

/// Copies of a few rows of the image each, so that its conversion needs no copy of the whole image.
pub(crate) fn strips(image: &DynamicImage) -> impl Iterator<Item = DynamicImage> + '_ {
    /// The most pixels of a strip, unless a single row has more.
    const STRIP: u32 = 1 << 20;
    let (width, height) = (image.width(), image.height());
    let rows = (STRIP / width.max(1)).max(1);
    (0..height).step_by(rows as usize).map(move |y| image.crop_imm(0, y, width, rows.min(height - y)))
}

/// Writes a frame as [`write_png`] does, with an ICC profile.
///
/// # Errors
/// The same as [`write_png`].
pub(crate) fn write_png_with(path: &Path, frame: &Encoded, profile: Option<&IccProfile>) -> Result<()> {
    let mut png = PngWriter::create_with(path, frame.0.size(), profile)?;
    png.write(frame.0.data())?;
    png.finish()
}

/// Writes a frame as a PNG of 8 bits per value; values are clipped to [0, 1] and rounded to the nearest.
///
/// # Errors
/// If the file cannot be written; no part of it is left.
pub fn write_png(path: impl AsRef<Path>, frame: &Encoded) -> Result<()> {
    write_png_with(path.as_ref(), frame, None)
}

/// A writer of the same PNG as [`write_png`], a few rows at a time; the file gets its name in [`PngWriter::finish`].
pub struct PngWriter {
    file: PartialFile,
    rows: png::StreamWriter<'static, Shared>,
    shared: Shared,
    bytes: Vec<u8>,
}

impl PngWriter {
    /// Begins a file of this width and height, px.
    ///
    /// # Errors
    /// If the file cannot be created, or the width or height is 0.
    pub fn create(path: impl AsRef<Path>, size: (usize, usize)) -> Result<Self> {
        Self::create_with(path, size, None)
    }

    /// [`PngWriter::create`] of a file with an ICC profile.
    ///
    /// # Errors
    /// The same as [`PngWriter::create`].
    pub fn create_with(
        path: impl AsRef<Path>,
        (width, height): (usize, usize),
        profile: Option<&IccProfile>,
    ) -> Result<Self> {
        let file = PartialFile::beside(path.as_ref())?;
        let begin = || -> io::Result<_> {
            let shared = Shared::new(File::create(file.path())?);
            let mut info = png::Info::with_size(width as u32, height as u32);
            info.icc_profile = profile.map(|p| p.bytes().to_vec().into());
            let mut encoder = png::Encoder::with_info(shared.clone(), info)?;
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_depth(png::BitDepth::Eight);
            encoder.set_compression(png::Compression::Fast);
            encoder.set_filter(png::Filter::Adaptive);
            Ok((encoder.write_header()?.into_stream_writer()?, shared))
        };
        let (rows, shared) = begin().map_err(|e| cannot_write(file.target(), &e))?;
        Ok(Self { file, rows, shared, bytes: Vec::new() })
    }

    /// Writes the next pixels, row by row from the top left; a call may write whole rows or parts of rows.
    ///
    /// # Errors
    /// If the pixels cannot be written.
    pub fn write(&mut self, pixels: &[[f32; 3]]) -> Result<()> {
        /// The number of pixels that are converted at once.
        const PART: usize = 1 << 16;
        for part in pixels.chunks(PART) {
            self.bytes.clear();
            self.bytes.extend(part.as_flattened().iter().map(|&v| byte_from_encoded(v)));
            self.rows.write_all(&self.bytes).map_err(|e| cannot_write(self.file.target(), &e))?;
        }
        Ok(())
    }

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    /// If pixels are missing, or the file cannot be completed.
    pub fn finish(self) -> Result<()> {
        let Self { file, rows, shared, .. } = self;
        let end = || -> io::Result<()> {
            rows.finish()?;
            shared.finish()
        };
        end().map_err(|e| cannot_write(file.target(), &e))?;
        file.complete()
    }
}

/// A file that is shared with its encoder. The encoder writes the end of a PNG when it is dropped, which cannot return an error,
/// so the first error is kept here.
#[derive(Clone)]
struct Shared(Rc<RefCell<(BufWriter<File>, Option<io::Error>)>>);

impl Shared {
    fn new(file: File) -> Self {
        Self(Rc::new(RefCell::new((BufWriter::new(file), None))))
    }

    /// Calls `write` on the file, and keeps the first error.
    fn with<T>(&self, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>) -> io::Result<T> {
        let (file, failure) = &mut *self.0.borrow_mut();
        write(file).inspect_err(|e| {
            failure.get_or_insert_with(|| io::Error::new(e.kind(), e.to_string()));
        })
    }

    /// Writes what is left in the buffer, and fails if any write failed before.
    fn finish(self) -> io::Result<()> {
        self.with(|file| file.flush())?;
        self.0.borrow_mut().1.take().map_or(Ok(()), Err)
    }
}

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.with(|file| file.write(bytes))
    }

    /// Does nothing, because an encoder flushes after each chunk; [`Shared::finish`] flushes once, at the end.
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes a texture of four values in [0, 1] per pixel as an RGBA PNG of 8 bits per value.
///
/// # Errors
/// If the file cannot be written; no part of it is left.
pub fn write_texture(path: impl AsRef<Path>, texture: &Raster<[f32; 4]>) -> Result<()> {
    write_png_of(path.as_ref(), texture.size(), (&bytes_of(texture), ExtendedColorType::Rgba8), None)
}

/// Writes a frame as [`write_png`] does, with 16 bits per value.
///
/// # Errors
/// If the file cannot be written; no part of it is left.
pub fn write_png16(path: impl AsRef<Path>, frame: &Encoded) -> Result<()> {
    write_png16_with(path.as_ref(), frame, None)
}

/// Writes a frame as [`write_png16`] does, with an ICC profile.
///
/// # Errors
/// The same as [`write_png16`].
pub(crate) fn write_png16_with(path: &Path, frame: &Encoded, profile: Option<&IccProfile>) -> Result<()> {
    let bytes = bytes16_of(frame.0.data().as_flattened());
    write_png_of(path, frame.0.size(), (&bytes, ExtendedColorType::Rgb16), profile)
}

/// Writes a frame as a TIFF of 8 or of 16 bits per value, with an ICC profile; values are clipped to [0, 1] and rounded to the nearest.
///
/// # Errors
/// If the file cannot be written; no part of it is left.
pub(crate) fn write_tiff(path: &Path, frame: &Encoded, bits: u8, profile: Option<&IccProfile>) -> Result<()> {
    let (bytes, color) = match bits {
        8 => (bytes_of(&frame.0), ExtendedColorType::Rgb8),
        _ => (bytes16_of(frame.0.data().as_flattened()), ExtendedColorType::Rgb16),
    };
    write_image(path, frame.0.size(), |file, width, height| {
        let mut tiff = TiffEncoder::new(file);
        if let Some(profile) = profile {
            tiff.set_icc_profile(profile.bytes().to_vec()).map_err(ImageError::Unsupported)?;
        }
        tiff.write_image(&bytes, width, height, color)
    })
}

/// Writes values in [0, 1] as a grey PNG of 16 bits; NaN becomes 0.
///
/// # Errors
/// If the file cannot be written; no part of it is left.
pub fn write_grey16(path: impl AsRef<Path>, plane: &Plane) -> Result<()> {
    write_png_of(path.as_ref(), plane.size(), (&bytes16_of(plane.data()), ExtendedColorType::L16), None)
}

fn bytes_of<const N: usize>(image: &Raster<[f32; N]>) -> Vec<u8> {
    image.data().as_flattened().iter().map(|&v| byte_from_encoded(v)).collect()
}

/// The values as 16-bit integers in the byte order of this machine, as encoders expect.
fn bytes16_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|&v| word_from_encoded(v).to_ne_bytes()).collect()
}

fn write_png_of(
    path: &Path,
    size: (usize, usize),
    (bytes, color): (&[u8], ExtendedColorType),
    profile: Option<&IccProfile>,
) -> Result<()> {
    write_image(path, size, |file, width, height| {
        let mut png = PngEncoder::new(file);
        if let Some(profile) = profile {
            png.set_icc_profile(profile.bytes().to_vec()).map_err(ImageError::Unsupported)?;
        }
        png.write_image(bytes, width, height, color)
    })
}

/// Lets `encode` write an image of this width and height, px.
fn write_image(
    path: &Path,
    (width, height): (usize, usize),
    encode: impl FnOnce(&mut BufWriter<File>, u32, u32) -> std::result::Result<(), ImageError>,
) -> Result<()> {
    let (width, height) = (width as u32, height as u32);
    write_atomically(path, |partial| {
        let mut file = BufWriter::new(File::create(partial)?);
        encode(&mut file, width, height).map_err(|e| match e {
            ImageError::IoError(e) => e,
            e => std::io::Error::other(e),
        })?;
        file.flush()
    })
}
