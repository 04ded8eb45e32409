//! The frames of a camera, or of a clip that starts again at its end, with their neighbours.

use blindaug::Encoded;
use blindaug_io::{Frame, FrameSource, Frames, Result};
use std::{path::Path, sync::Arc};

/// What names a camera instead of a file.
const CAMERA: &str = "camera:";

/// Whether an input is a camera's name.
pub fn names_camera(input: &Path) -> bool {
    input.to_str().is_some_and(|i| i.starts_with(CAMERA))
}

/// Opens a file, a folder, or by `camera:0` a camera.
pub fn open(input: &Path) -> Result<FrameSource> {
    match input.to_str().and_then(|i| i.strip_prefix(CAMERA)) {
        Some(name) => FrameSource::camera(name),
        None => FrameSource::open(input, Default::default()),
    }
}

/// A frame and those beside it.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Counts from 1 on, and on when a clip starts again.
    pub number: u64,
    /// How often the clip had started again.
    pub lap: u64,
    /// The frame.
    pub frame: Arc<Encoded>,
    /// `None` for the last one of a clip.
    pub next: Option<Arc<Encoded>>,
    /// `None` for the first one of a clip.
    pub previous: Option<Arc<Encoded>>,
}

/// Frames without an end.
pub struct Loop<'a> {
    source: &'a FrameSource,
    frames: Frames<'a>,
    previous: Option<Arc<Encoded>>,
    current: Option<Arc<Encoded>>,
    /// Of frames so far.
    count: u64,
    lap: u64,
}

impl<'a> Loop<'a> {
    /// Starts with the first frame.
    pub fn new(source: &'a FrameSource) -> Self {
        Self { source, frames: source.frames(), previous: None, current: None, count: 0, lap: 0 }
    }

    /// The next frame; `None` if there are no frames at all.
    ///
    /// # Errors
    /// If it, or the one after it, cannot be read.
    pub fn next(&mut self) -> Result<Option<Shot>> {
        let read =
            |frames: &mut Frames| Ok(frames.next().transpose()?.map(|Frame { image, .. }| Arc::new(image)));
        let frame = match self.current.take() {
            Some(frame) => frame,
            None => {
                if self.count > 0 {
                    self.frames = self.source.frames();
                    self.previous = None;
                    self.lap += 1;
                }
                let Some(first) = read(&mut self.frames)? else { return Ok(None) };
                first
            }
        };
        let next = read(&mut self.frames)?;
        self.count += 1;
        self.current.clone_from(&next);
        let previous = self.previous.replace(frame.clone());
        Ok(Some(Shot { number: self.count, lap: self.lap, frame, next, previous }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::Raster;

    #[test]
    fn a_clip_starts_again_and_its_ends_are_no_neighbours() {
        let dir = tempfile::tempdir().unwrap();
        for i in 1..=3u8 {
            let frame = Encoded(Raster::filled(4, 4, [f32::from(i) / 255.0; 3]));
            blindaug_io::write_png(dir.path().join(format!("{i}.png")), &frame).unwrap();
        }
        let source = open(dir.path()).unwrap();
        let mut frames = Loop::new(&source);
        let value =
            |f: &Option<Arc<Encoded>>| f.as_ref().map_or(0, |f| (255.0 * f.0.at(0, 0)[0]).round() as u8);
        for number in 1..=8u64 {
            let shot = frames.next().unwrap().unwrap();
            let [before, here, after] = [&shot.previous, &Some(shot.frame.clone()), &shot.next].map(value);
            let wanted = [[0, 1, 2], [1, 2, 3], [2, 3, 0]][(number as usize - 1) % 3];
            assert_eq!((shot.number, shot.lap), (number, (number - 1) / 3));
            assert_eq!([before, here, after], wanted);
        }
    }

    #[test]
    fn a_camera_that_is_not_there_is_named() {
        let e = open(Path::new("camera:77")).unwrap_err().to_string();
        assert!(e.starts_with("camera:77: ") && !e.contains('\n'), "{e}");
    }
}
