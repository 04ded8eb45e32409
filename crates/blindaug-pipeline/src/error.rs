//! The one error type of this crate.

use std::fmt;

/// Why a job failed; one sentence without a full stop, which says of which file or frame.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be read, written or used.
    #[cfg(feature = "files")]
    File(blindaug_io::Error),
    /// A frame, or what belongs to it, cannot be used.
    Frame {
        /// The clip's name.
        clip: String,
        /// The frame's number.
        number: u64,
        /// What is wrong.
        error: blindaug::Error,
    },
    /// A clip as a whole cannot be used.
    Clip {
        /// The clip's name.
        clip: String,
        /// What is wrong.
        error: blindaug::Error,
    },
    /// None of the numbers of what should belong to frames is a frame's.
    NoMatch {
        /// The name of what should belong to them.
        side: String,
        /// The clip's name.
        clip: String,
    },
    /// Something is known over relative inverse depth, and how that relates to metres was not said.
    NoSceneScale {
        /// The name of what is relative.
        name: String,
        /// Whether it is a camera model, or else depth.
        is_model: bool,
    },
    /// An output is there already and must not be replaced unasked.
    AlreadyThere {
        /// Its name.
        name: String,
    },
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
                "{side}: none of the numbers in its files' names is a frame's; rename them (the frames: {clip})"
            ),
            Self::NoSceneScale { name, is_model: false } => {
                write!(f, "{name}: relative depth must be brought to metres by the scene's scale")
            }
            Self::NoSceneScale { name, is_model: true } => write!(
                f,
                "{name}: its defocus is over relative inverse depth, but the layers are in metres: give the scene's scale, or estimate \
                 again with depth in metres"
            ),
            Self::AlreadyThere { name } => write!(f, "{name}: this is there already; give another name"),
            Self::Networks(sentence) => f.write_str(sentence),
        }
    }
}

impl std::error::Error for Error {}
