//! Pixels of files that are not numbers (NaN).

use crate::{Error, Result};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

/// What was read of a file, and the number of its pixels that were not numbers (NaN) and became 0.
pub(crate) type Counted<T> = (T, usize);

/// The number of pixels that are not numbers, as a renderer may leave a few. `pixels` says of each whether it is none.
///
/// # Errors
/// If most of the pixels are not numbers.
pub(crate) fn few(path: &Path, pixels: impl Iterator<Item = bool>) -> Result<usize> {
    let (mut bad, mut all) = (0, 0);
    for is_bad in pixels {
        bad += usize::from(is_bad);
        all += 1;
    }
    if 2 * bad > all {
        return Err(Error::new(path, "most of its pixels are not numbers (NaN): export it again"));
    }
    Ok(bad)
}

/// The files that had some pixels that were not numbers (NaN), with how many.
#[derive(Debug, Default)]
pub(crate) struct NotNumbers(Mutex<BTreeMap<PathBuf, usize>>);

impl NotNumbers {
    /// Keeps in mind how many pixels of the file were not numbers, and gives what was read.
    pub(crate) fn keep<T>(&self, path: &Path, (read, pixels): Counted<T>) -> T {
        if pixels > 0 {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(path.into(), pixels);
        }
        read
    }

    /// A sentence without a full stop, if a file had such pixels.
    pub(crate) fn in_words(&self) -> Option<String> {
        let files = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (first, pixels) = files.first_key_value()?;
        let hold = if *pixels == 1 { "pixel holds" } else { "pixels hold" };
        let others = match files.len() - 1 {
            0 => String::new(),
            1 => ", and so do some of another file".into(),
            n => format!(", and so do some of {n} other files"),
        };
        Some(format!(
            "{}: {pixels} {hold} no number (NaN){others}; 0 is taken in place of these: export them again to mend it",
            Error::shown_path(first)
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_file_counts_once() {
        let found = NotNumbers::default();
        assert_eq!(found.keep(Path::new("a.exr"), (7, 0)), 7);
        assert_eq!(found.in_words(), None);
        let words = |path: &str, pixels| {
            found.keep(Path::new(path), ((), pixels));
            found.in_words().unwrap()
        };
        assert!(words("b.exr", 1).starts_with("b.exr: 1 pixel holds no number (NaN); 0 is"));
        assert!(words("b.exr", 1).starts_with("b.exr: 1 pixel holds no number (NaN); 0 is"));
        assert!(words("c.exr", 5).contains("and so do some of another file;"));
        assert!(
            words("a.exr", 3)
                .starts_with("a.exr: 3 pixels hold no number (NaN), and so do some of 2 other files;")
        );
    }
}
