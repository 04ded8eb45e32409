//! The source of the footage: a file, a folder, or a camera by its name.

use blindaug::Transfer;
use blindaug_io::{FrameSource, Result};
use std::path::Path;

/// The prefix that names a camera instead of a file.
const CAMERA: &str = "camera:";

/// Whether an input is a camera's name.
pub fn names_camera(input: &Path) -> bool {
    input.to_str().is_some_and(|i| i.starts_with(CAMERA))
}

/// Opens a video, a folder of images, or by `camera:0` a camera (on Windows `camera:NAME`). The frames come encoded as sRGB, as windows show them,
/// whatever their files are encoded by.
///
/// # Errors
/// If there is none, or it cannot be read.
pub fn open(input: &Path) -> Result<FrameSource> {
    match input.to_str().and_then(|i| i.strip_prefix(CAMERA)) {
        Some(name) => FrameSource::camera(name),
        None => FrameSource::open(input, Default::default()).map(|source| source.encoded_as(Transfer::Srgb)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_that_is_not_there_is_named() {
        let e = open(Path::new("camera:77")).unwrap_err().to_string();
        assert!(e.starts_with("camera:77: ") && !e.contains('\n'), "{e}");
    }
}
