//! The error type of this crate.

use std::fmt;

/// The reason why a job failed: one sentence without a full stop, which names the file or the frame.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be read, written or used.
    #[cfg(feature = "files")]
    File(blindaug_io::Error),
    /// A frame, or its accompanying data, cannot be used.
    Frame {
        /// The clip's name.
        clip: String,
        /// The frame's number.
        number: u64,
        /// The reason.
        error: blindaug::Error,
    },
    /// A clip as a whole cannot be used.
    Clip {
        /// The clip's name.
        clip: String,
        /// The reason.
        error: blindaug::Error,
    },
    /// None of the accompanying data have the number of a frame.
    NoMatch {
        /// The name of the accompanying data.
        side: String,
        /// The clip's name.
        clip: String,
    },
    /// A camera model or depth is over relative inverse depth, and no scene scale was given.
    NoSceneScale {
        /// The name of the camera model or of the depth.
        name: String,
        /// Whether the camera model is relative; else the depth is.
        is_model: bool,
    },
    /// An output exists already and must not be replaced unasked.
    AlreadyThere {
        /// The output's name.
        name: String,
    },
    /// The frames that an output has already were made with other settings.
    OtherSettings {
        /// The output's name.
        name: String,
    },
    /// An output that takes frames alone was given a layer.
    NoLayers,
    /// Two networks, or a network and what is given, are for the same place.
    Networks(String),
}

/// The result type of this crate.
pub type Result<T> = std::result::Result<T, Error>;

#[cfg(feature = "files")]
impl From<blindaug_io::Error> for Error {
    fn from(e: blindaug_io::Error) -> Self {
        Self::File(e)
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            #[cfg(feature = "files")]
            Self::File(e) => e.fmt(f),
            Self::Frame { clip, number, error } => write!(f, "{clip}: frame {number}: {error}"),
            Self::Clip { clip, error } => write!(f, "{clip}: {error}"),
            Self::NoMatch { side, clip } => write!(
                f,
                "{side}: none of the numbers in its files' names is that of a frame of {clip}: give the number of the first frame, other frames, or rename the files"
            ),
            Self::NoSceneScale { name, is_model: false } => {
                write!(f, "{name}: relative depth must be brought to metres by the scene's scale")
            }
            Self::NoSceneScale { name, is_model: true } => {
                write!(f, "{name}: its defocus is over relative inverse depth, but the layers are in metres")
            }
            Self::AlreadyThere { name } => write!(f, "{name}: this is there already; give another name"),
            Self::OtherSettings { name } => {
                write!(f, "{name}: the frames there were made with other settings; give another folder")
            }
            Self::NoLayers => f.write_str(
                "layers are written to EXR files alone: give a folder, or a name that ends in .exr",
            ),
            Self::Networks(sentence) => f.write_str(sentence),
        }
    }
}

impl std::error::Error for Error {}
