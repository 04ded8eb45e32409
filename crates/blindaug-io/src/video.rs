//! Videos: decoded by the `ffmpeg` program where there is one (any format), else by the built-in decoder (H.264 in MP4).

use crate::{
    Error, Result, ffmpeg,
    ffmpeg::Ffmpeg,
    mp4::{Mp4, Mp4Frames},
};
use blindaug::{Encoded, Raster};
use std::path::{Path, PathBuf};

/// A video whose head has been read.
#[derive(Debug)]
pub(crate) struct Video {
    path: PathBuf,
    decoder: Decoder,
    size: (usize, usize),
    head: VideoHead,
}

#[derive(Debug)]
enum Decoder {
    Ffmpeg(Ffmpeg),
    BuiltIn(Mp4),
}

/// What a video says of itself.
#[derive(Clone, Debug, Default)]
pub(crate) struct VideoHead {
    /// Frames per second.
    pub fps: Option<f64>,
    /// Number of frames, nearly.
    pub frames: Option<usize>,
    /// Sentences for a person.
    pub notes: Vec<String>,
}

impl Video {
    /// Opens a video with the `ffmpeg` program, or with the built-in decoder if there is none.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        match ffmpeg::find() {
            Some(program) => Self::open_with_ffmpeg(path, program),
            None => Self::open_built_in(path),
        }
    }

    pub(crate) fn open_with_ffmpeg(path: &Path, program: std::ffi::OsString) -> Result<Self> {
        let (ffmpeg, head) = Ffmpeg::open(program, path)?;
        Self::with_first_frame(path, Decoder::Ffmpeg(ffmpeg), head)
    }

    pub(crate) fn open_built_in(path: &Path) -> Result<Self> {
        let (mp4, head) = Mp4::open(path)?;
        Self::with_first_frame(path, Decoder::BuiltIn(mp4), head)
    }

    /// Decodes the first frame, which alone knows the size that frames have when they are shown.
    fn with_first_frame(path: &Path, decoder: Decoder, head: VideoHead) -> Result<Self> {
        let mut video = Self { path: path.into(), decoder, size: (0, 0), head };
        let Some(first) = video.frames()?.next_frame(true)? else {
            return Err(Error::new(path, "the video has no frames"));
        };
        video.size = first.encoded(path)?.0.size();
        Ok(video)
    }

    pub(crate) fn size(&self) -> (usize, usize) {
        self.size
    }

    pub(crate) fn fps(&self) -> Option<f64> {
        self.head.fps
    }

    pub(crate) fn len_hint(&self) -> Option<usize> {
        self.head.frames
    }

    pub(crate) fn notes(&self) -> &[String] {
        &self.head.notes
    }

    /// Starts to decode.
    pub(crate) fn frames(&self) -> Result<VideoFrames> {
        Ok(match &self.decoder {
            Decoder::Ffmpeg(f) => VideoFrames::Ffmpeg(f.frames(&self.path)?),
            Decoder::BuiltIn(m) => VideoFrames::BuiltIn(m.frames(&self.path)?),
        })
    }
}

/// A video that is being decoded.
pub(crate) enum VideoFrames {
    Ffmpeg(ffmpeg::FfmpegFrames),
    BuiltIn(Mp4Frames),
}

impl VideoFrames {
    /// The next frame, or `None` at the end. What is not wanted need not be converted.
    pub(crate) fn next_frame(&mut self, wanted: bool) -> Result<Option<VideoImage>> {
        match self {
            Self::Ffmpeg(f) => f.next_frame(),
            Self::BuiltIn(m) => m.next_frame(wanted),
        }
    }
}

/// A decoded frame.
pub(crate) enum VideoImage {
    /// RGB, of one byte per value or of two (big-endian), row by row.
    Packed {
        size: (usize, usize),
        two_bytes: bool,
        data: Vec<u8>,
    },
    Converted(Encoded),
    /// Decoded, but not wanted.
    Skipped,
}

impl VideoImage {
    /// The frame with values in [0, 1].
    pub(crate) fn encoded(self, path: &Path) -> Result<Encoded> {
        let fail = |e: blindaug::Error| Error::new(path, e.to_string());
        match self {
            Self::Packed { size: (w, h), two_bytes: false, data } => {
                let pixels = data.as_chunks::<3>().0.iter();
                let data = pixels.map(|p| p.map(|v| f32::from(v) / 255.0)).collect();
                Raster::from_vec(w, h, data).map(Encoded).map_err(fail)
            }
            Self::Packed { size: (w, h), two_bytes: true, data } => {
                let pixels = data.as_chunks::<2>().0.as_chunks::<3>().0.iter();
                let data = pixels.map(|p| p.map(|v| f32::from(u16::from_be_bytes(v)) / 65535.0)).collect();
                Raster::from_vec(w, h, data).map(Encoded).map_err(fail)
            }
            Self::Converted(image) => Ok(image),
            Self::Skipped => Err(Error::new(path, "a frame that was left out was asked for")),
        }
    }
}
