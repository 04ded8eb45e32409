use crate::plots::PlotError;

/// The reasons why a page cannot be made.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// A plot cannot be drawn.
    Plot(PlotError),
}

/// The result type of this crate.
pub type Result<T> = std::result::Result<T, Error>;

impl From<PlotError> for Error {
    fn from(e: PlotError) -> Self {
        Self::Plot(e)
    }
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Plot(e) => write!(f, "a plot cannot be drawn ({e})"),
        }
    }
}

impl std::error::Error for Error {}
