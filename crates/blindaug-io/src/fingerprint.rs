//! What an input was: its SHA-256, which anybody can compute again.

use crate::{Error, NamePattern, Result};
use sha2::{Digest, Sha256};
use std::{
    ffi::OsString,
    fmt::Write,
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

/// The largest number of bytes that are read for a fingerprint: half a second's work.
const MOST: u64 = 256 << 20;
/// The bytes that are read from each end of a file that is larger.
const END: u64 = 8 << 20;

/// The SHA-256 of an input, and what was hashed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fingerprint {
    /// The hash, 64 hexadecimal digits.
    pub sha256: String,
    /// What was hashed, as in "SHA-256 of the file".
    pub of: String,
}

/// The fingerprint of a file, of the files of a folder, or of those of a name pattern; `None` if there is nothing to hash, as of a live camera.
///
/// That of a file is what `sha256sum FILE` prints; that of a folder, or of a pattern's files in their folder, is what `sha256sum * | sha256sum` prints in it: over the files' hashes
/// and names, in the order of the names' bytes, hidden files and folders left out. Of a file of more than 256 MiB, or of the files of a
/// folder that have more together, only the first and the last 8 MiB are hashed, after the size in bytes as text.
///
/// # Errors
/// If a file cannot be read.
pub fn fingerprint(path: impl AsRef<Path>) -> Result<Option<Fingerprint>> {
    let path = path.as_ref();
    if let Some(pattern) = NamePattern::of(path) {
        let of_file = |file: PathBuf| {
            let size = file.metadata().map_err(|e| Error::cannot_read(&file, &e))?.len();
            Ok((file.file_name().unwrap_or_default().to_owned(), file, size))
        };
        return of_files(pattern.files()?.into_values().map(of_file).collect::<Result<_>>()?).map(Some);
    }
    let Ok(metadata) = path.metadata() else { return Ok(None) };
    if metadata.is_file() {
        let whole = metadata.len() <= MOST;
        let of = if whole { "the file" } else { "its size and its first and last 8 MiB" };
        return Ok(Some(Fingerprint { sha256: hash_of(path, metadata.len(), whole)?, of: of.into() }));
    }
    if !metadata.is_dir() {
        return Ok(None);
    }
    let cannot = |e: std::io::Error| Error::cannot_read(path, &e);
    let mut files = vec![];
    for entry in path.read_dir().map_err(cannot)? {
        let entry = entry.map_err(cannot)?;
        let name = entry.file_name();
        let file = entry.path();
        let Ok(metadata) = file.metadata() else { continue };
        if metadata.is_file() && !name.as_encoded_bytes().starts_with(b".") {
            files.push((name, file, metadata.len()));
        }
    }
    of_files(files).map(Some)
}

/// The fingerprint of files, each with its name and its size in bytes.
fn of_files(mut files: Vec<(OsString, PathBuf, u64)>) -> Result<Fingerprint> {
    files.sort();
    let whole = files.iter().map(|f| f.2).sum::<u64>() <= MOST;
    let mut lines = Sha256::new();
    for (name, file, size) in &files {
        lines.update(format!("{}  ", hash_of(file, *size, whole)?));
        lines.update(name.as_encoded_bytes());
        lines.update("\n");
    }
    let what = if whole { "their names and contents" } else { "their names, sizes and first and last 8 MiB" };
    Ok(Fingerprint { sha256: hex(lines), of: format!("{} files, {what}", files.len()) })
}

/// The hash of a file of this size: of all of it, or of its size and its ends.
fn hash_of(path: &Path, size: u64, whole: bool) -> Result<String> {
    let cannot = |e: std::io::Error| Error::cannot_read(path, &e);
    let mut file = File::open(path).map_err(cannot)?;
    let mut hash = Sha256::new();
    if !whole {
        hash.update(size.to_string());
    }
    let mut take = |from: u64, most: u64| -> std::io::Result<()> {
        file.seek(SeekFrom::Start(from))?;
        let mut part = (&file).take(most);
        let mut buffer = vec![0; 1 << 20];
        loop {
            match part.read(&mut buffer)? {
                0 => return Ok(()),
                n => hash.update(&buffer[..n]),
            }
        }
    };
    let taken = if whole {
        take(0, u64::MAX)
    } else {
        take(0, END.min(size)).and_then(|()| take(size.saturating_sub(END).max(END.min(size)), END))
    };
    taken.map_err(cannot)?;
    Ok(hex(hash))
}

fn hex(hash: Sha256) -> String {
    hash.finalize().iter().fold(String::new(), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_files_of_a_pattern_have_the_fingerprint_of_a_folder_that_holds_them_alone() {
        let dir = tempfile::tempdir().unwrap();
        for folder in ["alone", "among"] {
            std::fs::create_dir(dir.path().join(folder)).unwrap();
            (1..4).for_each(|i| {
                std::fs::write(dir.path().join(folder).join(format!("f.{i:04}.png")), [i]).unwrap()
            });
        }
        std::fs::write(dir.path().join("among/other.txt"), "").unwrap();
        let of = |name: &str| fingerprint(dir.path().join(name)).unwrap().unwrap();
        assert_eq!(of("among/f.####.png"), of("alone"));
        assert_ne!(of("among"), of("alone"));
    }

    #[test]
    fn a_file_s_fingerprint_is_its_sha256_and_a_folder_s_covers_names_and_contents() {
        let dir = tempfile::tempdir().unwrap();
        let of = |name: &str| fingerprint(dir.path().join(name)).unwrap();
        std::fs::write(dir.path().join("a"), "abc").unwrap();
        let known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(of("a"), Some(Fingerprint { sha256: known.into(), of: "the file".into() }));
        let before = of("").unwrap();
        // What `sha256sum a | sha256sum` prints.
        let line = format!("{known}  a\n");
        assert_eq!(before.sha256, hex(Sha256::new().chain_update(line)));
        assert_eq!(before.of, "1 files, their names and contents");
        std::fs::write(dir.path().join(".hidden"), "x").unwrap();
        assert_eq!(of("").unwrap(), before);
        std::fs::rename(dir.path().join("a"), dir.path().join("b")).unwrap();
        assert_ne!(of("").unwrap().sha256, before.sha256);
        assert_eq!(of("nothing"), None);
    }

    #[test]
    fn a_huge_file_is_hashed_at_its_ends() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("huge");
        let file = File::create(&path).unwrap();
        file.set_len(MOST + 1).unwrap();
        let of = fingerprint(&path).unwrap().unwrap();
        assert!(of.of.contains("first and last 8 MiB"), "{}", of.of);
        // Another size is another file.
        file.set_len(MOST + 2).unwrap();
        assert_ne!(fingerprint(&path).unwrap().unwrap().sha256, of.sha256);
    }
}
