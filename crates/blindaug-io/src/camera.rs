//! camera.json.

use crate::{Error, Result, write_atomically};
use blindaug::CameraModel;
use std::{fs::File, io::Read, path::Path};

/// The largest camera.json that is read, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// Reads a camera model.
///
/// # Errors
/// If the file is missing, or no camera model of this version.
pub fn read_camera(path: impl AsRef<Path>) -> Result<CameraModel> {
    let path = path.as_ref();
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|f| f.take(MAX_BYTES).read_to_end(&mut bytes))
        .map_err(|e| Error::cannot_read(path, &e))?;
    let text = String::from_utf8(bytes)
        .map_err(|_| Error::new(path, "not a camera model of blindaug: it is no text"))?;
    CameraModel::from_json(&text).map_err(|e| Error::new(path, e.to_string()))
}

/// Writes a camera model.
///
/// # Errors
/// If a number of it is out of its range, or the file cannot be written.
pub fn write_camera(path: impl AsRef<Path>, camera: &CameraModel) -> Result<()> {
    let path = path.as_ref();
    // What could not be read again is not written.
    camera.validate().map_err(|e| Error::new(path, format!("the camera model is not written: {e}")))?;
    write_atomically(path, |partial| std::fs::write(partial, camera.to_json()))
}
