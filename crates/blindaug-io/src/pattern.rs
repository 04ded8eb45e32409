//! Names of numbered files as artists type them: `shot.%04d.exr`, `shot.####.exr`.

use crate::{Error, Result, files::folder_of};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// The names of numbered files in one folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamePattern {
    folder: PathBuf,
    prefix: String,
    /// The least number of digits.
    digits: usize,
    suffix: String,
}

impl NamePattern {
    /// Names of this folder: the number with four digits, and an extension.
    pub fn plain(folder: &Path, extension: &str) -> Self {
        Self { folder: folder.into(), prefix: String::new(), digits: 4, suffix: format!(".{extension}") }
    }

    /// The pattern in the last part of a path: `%04d` (or `%d`) or a row of `#`, one for each digit. A single `#`, as in `take #2`, is one only
    /// between a dot, `_` or `-` and the extension. `None` if there is none, or a file or folder has just that name.
    pub fn of(path: &Path) -> Option<Self> {
        if path.exists() {
            return None;
        }
        let name = path.file_name()?.to_str()?;
        let (prefix, digits, suffix) = hashes(name).or_else(|| printf(name))?;
        Some(Self { folder: folder_of(path).into(), prefix: prefix.into(), digits, suffix: suffix.into() })
    }

    /// The folder of the files.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The name of the file of this number, without its folder.
    pub fn name(&self, number: u64) -> String {
        format!("{}{number:0digits$}{}", self.prefix, self.suffix, digits = self.digits)
    }

    /// The path of the file of this number.
    pub fn path(&self, number: u64) -> PathBuf {
        self.folder.join(self.name(number))
    }

    /// The number of the file of this name; `None` if the name does not follow the pattern.
    pub fn number(&self, name: &str) -> Option<u64> {
        let digits = name.strip_prefix(&self.prefix)?.strip_suffix(&self.suffix)?;
        let number = digits.parse().ok()?;
        (self.name(number) == name).then_some(number)
    }

    /// The files that follow the pattern, by number.
    ///
    /// # Errors
    /// If the folder cannot be read, or has no such file.
    pub(crate) fn files(&self) -> Result<BTreeMap<u64, PathBuf>> {
        let shown = self.folder.join(format!("{}{}{}", self.prefix, "#".repeat(self.digits), self.suffix));
        let entries = self.folder.read_dir().map_err(|e| Error::cannot_read(&self.folder, &e))?;
        let files: BTreeMap<u64, PathBuf> = entries
            .flatten()
            .filter_map(|entry| Some((self.number(entry.file_name().to_str()?)?, entry.path())))
            .filter(|(_, path)| path.is_file())
            .collect();
        match files.is_empty() {
            true => Err(Error::new(&shown, "no file has a name of this pattern")),
            false => Ok(files),
        }
    }
}

/// The parts before and after the last row of `#`, and its length.
fn hashes(name: &str) -> Option<(&str, usize, &str)> {
    let (before, suffix) = name.rsplit_once('#')?;
    let prefix = before.trim_end_matches('#');
    let digits = before.len() - prefix.len() + 1;
    let is_number = digits > 1 || prefix.ends_with(['.', '_', '-']) && suffix.starts_with('.');
    is_number.then_some((prefix, digits, suffix))
}

/// The parts before and after `%04d` or `%d`, and its number of digits.
fn printf(name: &str) -> Option<(&str, usize, &str)> {
    let (prefix, rest) = name.split_once('%')?;
    let (width, suffix) = rest.split_once('d')?;
    let digits = match width.strip_prefix('0') {
        _ if width.is_empty() => 1,
        Some(digits) => digits.parse().ok().filter(|d| (1..=12).contains(d))?,
        None => return None,
    };
    (!suffix.contains('%')).then_some((prefix, digits, suffix))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_read_as_artists_type_them() {
        for (text, name) in [
            ("a/shot.%04d.exr", Some("shot.0007.exr")),
            ("a/shot.####.exr", Some("shot.0007.exr")),
            ("a/shot_%d.png", Some("shot_7.png")),
            ("a/shot.######.tif", Some("shot.000007.tif")),
            ("a/shot.%4d.exr", None),
            ("a/shot.exr", None),
            ("a/#shot#.exr", None),
            ("a/shot.#.exr", Some("shot.7.exr")),
            ("a/take #2", None),
            ("a/take#2/", None),
            ("a/take #2.####.exr", Some("take #2.0007.exr")),
            ("a/take#2_%04d.exr", Some("take#2_0007.exr")),
            ("a/%03d%03d.exr", None),
        ] {
            assert_eq!(NamePattern::of(Path::new(text)).map(|p| p.name(7)).as_deref(), name, "{text}");
        }
        let pattern = NamePattern::of(Path::new("a/shot.%04d.exr")).unwrap();
        assert_eq!(pattern.path(1001), Path::new("a/shot.1001.exr"));
        assert_eq!(pattern.number("shot.10001.exr"), Some(10001));
        for other in ["shot.101.exr", "shot.00101.exr", "shot.1001.png", "other.1001.exr", "shot..exr"] {
            assert_eq!(pattern.number(other), None, "{other}");
        }
    }

    #[test]
    fn only_files_of_the_pattern_are_taken() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.0003.exr", "a.0001.exr", "b.0002.exr", "a.0002.png", "a.1.exr"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let files = NamePattern::of(&folder.path().join("a.%04d.exr")).unwrap().files().unwrap();
        assert_eq!(files.keys().copied().collect::<Vec<_>>(), [1, 3]);
        let none = NamePattern::of(&folder.path().join("c.##.exr")).unwrap().files().unwrap_err().to_string();
        assert!(none.contains("c.##.exr") && none.contains("pattern"), "{none}");
    }
}
