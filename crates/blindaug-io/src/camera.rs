//! Reading and writing camera.json and per-frame camera models.

use crate::files::read_text;
use crate::partial::{PartialFile, cannot_write};
use crate::{Error, Result, write_atomically};
use blindaug::CameraModel;
use blindaug::model::{CameraTrack, TrackedCamera};
use std::{
    fs::File,
    io::{BufWriter, Write},
    path::Path,
};

/// The largest camera.json that is read, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// The largest file of per-frame models that is read, bytes; a line has about three thousand.
const MAX_TRACK_BYTES: u64 = 1 << 29;

/// Reads a camera model.
///
/// # Errors
/// If the file is missing, or no camera model of this version.
pub fn read_camera(path: impl AsRef<Path>) -> Result<CameraModel> {
    let path = path.as_ref();
    CameraModel::from_json(&read_text(path, MAX_BYTES)?).map_err(|e| Error::new(path, e.to_string()))
}

/// Reads a camera model that holds for all frames, or per-frame models (JSON lines).
///
/// # Errors
/// The same as [`read_camera`], with the number of the line.
pub fn read_camera_track(path: impl AsRef<Path>) -> Result<CameraTrack> {
    let path = path.as_ref();
    CameraTrack::from_json(&read_text(path, MAX_TRACK_BYTES)?).map_err(|e| Error::new(path, e.to_string()))
}

/// A writer of per-frame models, one after another; the file gets its name in [`CameraTrackWriter::finish`].
pub struct CameraTrackWriter {
    file: PartialFile,
    lines: BufWriter<File>,
}

impl CameraTrackWriter {
    /// Begins a file of per-frame models.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub fn create(path: impl AsRef<Path>) -> Result<Self> {
        let file = PartialFile::beside(path.as_ref())?;
        let lines = File::create(file.path()).map_err(|e| cannot_write(file.target(), &e))?;
        Ok(Self { file, lines: BufWriter::new(lines) })
    }

    /// Adds a frame's model.
    ///
    /// # Errors
    /// If a number of the model is out of its range, or the line cannot be written.
    pub fn write(&mut self, camera: &TrackedCamera) -> Result<()> {
        let path = self.file.target();
        camera.camera.validate().map_err(|e| Error::new(path, format!("frame {}: {e}", camera.frame)))?;
        writeln!(self.lines, "{}", camera.to_json_line()).map_err(|e| cannot_write(path, &e))
    }

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    /// If the file cannot be completed.
    pub fn finish(self) -> Result<()> {
        let Self { file, mut lines } = self;
        lines.flush().map_err(|e| cannot_write(file.target(), &e))?;
        drop(lines);
        file.complete()
    }
}

/// Writes a camera model.
///
/// # Errors
/// If a number of the model is out of its range, or the file cannot be written.
pub fn write_camera(path: impl AsRef<Path>, camera: &CameraModel) -> Result<()> {
    let path = path.as_ref();
    // A model that could not be read again is not written.
    camera.validate().map_err(|e| Error::new(path, format!("the camera model is not written: {e}")))?;
    write_atomically(path, |partial| std::fs::write(partial, camera.to_json()))
}
