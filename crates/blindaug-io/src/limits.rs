//! Limits that a file's head is checked against before memory is taken for its pixels.

use crate::{Error, Result, files::open_file, memory};
use std::{io::Read, path::Path};

/// The longest side of an image that is read, px.
pub const MAX_SIDE: usize = 16_384;

/// The largest area of an image that is read, px.
pub const MAX_PIXELS: usize = 1 << 27;

/// Bytes of a pixel of a frame in memory: three channels of f32.
pub(crate) const BYTES_PER_PIXEL: u64 = 12;

/// Checks the size, px, that a file claims: it must be within the limits, and a frame of it must fit into the memory budget.
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
    memory::fits(path, &pixels_in_words(width, height), width * height * BYTES_PER_PIXEL)?;
    Ok((width as usize, height as usize))
}

/// The size of an image, px, as messages on the budget give it.
pub(crate) fn pixels_in_words(width: u64, height: u64) -> String {
    format!("an image of {width} x {height} pixels")
}

/// Fails if a file of `length` bytes cannot hold an image of this size, px, which takes at least `least` bytes.
pub(crate) fn check_length(path: &Path, length: u64, least: u64, (width, height): (u64, u64)) -> Result<()> {
    if length >= least {
        return Ok(());
    }
    Err(Error::new(
        path,
        format!(
            "the file is damaged or cut short: its head tells of {width} x {height} pixels, which take {least} bytes at least, and it has {length}"
        ),
    ))
}

/// The largest compression ratio that deflate reaches: 258 bytes from two bits.
pub(crate) const DEFLATE_RATIO: u64 = 1032;

/// Whether the file starts with the magic number of EXR.
pub(crate) fn is_exr(path: &Path) -> Result<bool> {
    let mut magic = [0; 4];
    let mut file = open_file(path)?;
    match file.read(&mut magic) {
        Ok(n) => Ok(n == 4 && magic == [0x76, 0x2f, 0x31, 0x01]),
        Err(e) => Err(Error::cannot_read(path, &e)),
    }
}
