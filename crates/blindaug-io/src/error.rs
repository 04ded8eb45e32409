//! The one error type of this crate.

pub use blindaug::text::one_line;
use blindaug::text::{cut, printable};
use std::{
    cell::Cell,
    io,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    sync::Once,
};

/// The path of a file, and one sentence on what is wrong with the file and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    path: PathBuf,
    sentence: String,
    over_budget: bool,
}

/// The result type of this crate.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An error of a file. The sentence follows the file's name and has no full stop.
    pub fn new(path: impl AsRef<Path>, sentence: impl Into<String>) -> Self {
        Self { path: path.as_ref().into(), sentence: sentence.into(), over_budget: false }
    }

    /// An error of a file that cannot be read.
    pub fn cannot_read(path: &Path, e: &io::Error) -> Self {
        Self::new(
            path,
            match e.kind() {
                io::ErrorKind::NotFound => "there is no such file or folder".into(),
                io::ErrorKind::UnexpectedEof => "the file is cut short".into(),
                _ => format!("cannot be read ({e})"),
            },
        )
    }

    pub(crate) fn damaged(path: &Path, e: impl std::fmt::Display) -> Self {
        Self::new(path, format!("the file is damaged or cut short ({})", one_line(&e.to_string())))
    }

    /// A path as messages show it: printable, and cut if it is very long.
    pub fn shown_path(path: &Path) -> String {
        const LONGEST_PATH: usize = 1000;
        printable(&cut(&path.to_string_lossy(), LONGEST_PATH)).replace('\n', "\\n")
    }

    /// An error of a file that would take more memory than the budget.
    pub(crate) fn over_budget(path: &Path, sentence: String) -> Self {
        Self { over_budget: true, ..Self::new(path, sentence) }
    }

    /// Whether the file would take more memory than the budget, so that a larger budget would help.
    pub fn is_over_budget(&self) -> bool {
        self.over_budget
    }

    /// The path of the file or folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The sentence on what is wrong, without the file's name.
    pub fn sentence(&self) -> &str {
        &self.sentence
    }
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", Self::shown_path(&self.path), self.sentence)
    }
}

impl std::error::Error for Error {}

/// Returns the result of `decode`. A panic of the decoder becomes an error of the file, and is not printed.
///
/// # Errors
/// The decoder's error; if the decoder panics, that the file is damaged.
pub fn guarded<T>(path: &Path, decode: impl FnOnce() -> Result<T>) -> Result<T> {
    thread_local!(static GUARDED: Cell<bool> = const { Cell::new(false) });
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let report = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if !GUARDED.get() {
                report(info);
            }
        }));
    });
    let before = GUARDED.replace(true);
    let result = catch_unwind(AssertUnwindSafe(decode));
    GUARDED.set(before);
    result.unwrap_or_else(|_| Err(Error::damaged(path, "its decoder gave up on it")))
}
