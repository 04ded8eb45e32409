//! Opening files to read, and protection of input files from being overwritten.

use crate::{Error, NamePattern, Result};
use std::{
    collections::HashMap,
    fs::{File, Metadata},
    io::{ErrorKind, Read},
    path::{Path, PathBuf},
    time::SystemTime,
};

/// Opens a file to be read. A pipe or a device is refused: it might never end, and opening it might wait for ever.
///
/// # Errors
/// If there is no such file, it cannot be opened, or it is a folder, a pipe, a device or a socket.
pub fn open_file(path: &Path) -> Result<File> {
    let metadata = path.metadata().map_err(|e| Error::cannot_read(path, &e))?;
    if metadata.is_dir() {
        return Err(Error::new(path, "this is a folder; give the name of a file"));
    }
    check_regular(path, &metadata)?;
    File::open(path).map_err(|e| Error::cannot_read(path, &e))
}

/// Fails if the path is neither a file's nor a folder's.
pub(crate) fn check_regular(path: &Path, metadata: &Metadata) -> Result<()> {
    if metadata.is_file() || metadata.is_dir() {
        return Ok(());
    }
    Err(Error::new(
        path,
        "this is a pipe or a device, not a file; save what it gives to a file, and give that",
    ))
}

/// Reads a file of at most `most` bytes.
///
/// # Errors
/// The same as [`open_file`], or if the file has more bytes.
pub fn read_file(path: &Path, most: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    // One more byte is read, to recognise a longer file.
    let read = open_file(path)?.take(most.saturating_add(1)).read_to_end(&mut bytes);
    read.map_err(|e| Error::cannot_read(path, &e))?;
    if bytes.len() as u64 > most {
        return Err(Error::new(
            path,
            format!("the file is too large: at most {most} bytes of this kind are read"),
        ));
    }
    Ok(bytes)
}

/// Reads a text file of at most `most` bytes.
///
/// # Errors
/// The same as [`read_file`], or if the file is no text.
pub fn read_text(path: &Path, most: u64) -> Result<String> {
    String::from_utf8(read_file(path, most)?)
        .map_err(|_| Error::new(path, "the file is no text (UTF-8); is it another kind of file?"))
}

/// The identity of a file, which is the same for all names and links of the file.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Identity {
    /// The device and inode number of an existing file or folder.
    #[cfg(unix)]
    Node(u64, u64),
    /// A path without links. For a file that does not exist yet, it is the path that the file would have.
    Path(PathBuf),
}

impl Identity {
    /// The identity of the file of a path; `None` if even the file's folder does not exist.
    fn of(path: &Path) -> Option<Self> {
        #[cfg(unix)]
        if let Ok(metadata) = path.metadata() {
            use std::os::unix::fs::MetadataExt;
            return Some(Self::Node(metadata.dev(), metadata.ino()));
        }
        if let Ok(path) = path.canonicalize() {
            return Some(Self::Path(path));
        }
        let path = link_target(path).ok()?;
        let folder = folder_of(&path).canonicalize().ok()?;
        Some(Self::Path(folder.join(path.file_name()?)))
    }
}

/// Whether two paths lead to the same file, which need not exist.
pub fn same_file(a: &Path, b: &Path) -> bool {
    matches!((Identity::of(a), Identity::of(b)), (Some(a), Some(b)) if a == b)
}

/// The folder that holds the last part of a path.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The destination of a path whose last part is a link, or a link to a link, else the path. The destination need not exist.
pub(crate) fn link_target(path: &Path) -> std::io::Result<PathBuf> {
    const MOST_LINKS: usize = 40;
    let mut path = path.to_path_buf();
    for _ in 0..MOST_LINKS {
        match path.read_link() {
            Ok(target) => path = folder_of(&path).join(target),
            // The path is no link, or does not exist.
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::InvalidInput | ErrorKind::NotFound | ErrorKind::NotADirectory
                ) =>
            {
                return Ok(path);
            }
            Err(e) => return Err(e),
        }
    }
    Err(std::io::Error::other("too many links"))
}

/// The extensions of the files that are read in folders.
const READ_IN_FOLDERS: [&str; 11] =
    ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "ppm", "pgm", "pnm", "exr", "flo"];

/// The files and folders that a command reads, so that it never writes over one of them.
#[derive(Debug, Default)]
pub struct Inputs(HashMap<Identity, PathBuf>);

impl Inputs {
    /// Collects these files, and these folders with the images, depth, flow and layers in them, and the files of
    /// name patterns. A path that does not exist is left out.
    pub fn of<P: AsRef<Path>>(paths: impl IntoIterator<Item = P>) -> Self {
        let mut inputs = Self::default();
        for path in paths {
            inputs.add(path.as_ref());
            let of_pattern = NamePattern::of(path.as_ref()).and_then(|pattern| pattern.files().ok());
            of_pattern.iter().flatten().for_each(|(_, path)| inputs.add(path));
            // Subfolders are not read, nor are files of another kind, such as a camera model that an earlier run wrote there.
            let files = path.as_ref().read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
            let is_read = |path: &PathBuf| has_extension(path, &READ_IN_FOLDERS) && !path.is_dir();
            files.filter(is_read).for_each(|path| inputs.add(&path));
        }
        inputs
    }

    fn add(&mut self, path: &Path) {
        // A path that does not exist is no input, though it may become an output.
        if let (true, Some(identity)) = (path.exists(), Identity::of(path)) {
            self.0.entry(identity).or_insert_with(|| path.into());
        }
    }

    /// Fails if this file, which is to be written, is also an input, under whatever name.
    ///
    /// # Errors
    /// If the output is an input; the error gives both names.
    pub fn check_output(&self, output: &Path) -> Result<()> {
        let Some(input) = Identity::of(output).and_then(|identity| self.0.get(&identity)) else {
            return Ok(());
        };
        let sentence = if input == output {
            "this is an input, which would be overwritten; give another name for the output".into()
        } else {
            format!(
                "this is the input {} under another name, which would be overwritten; give another name for the output",
                Error::shown_path(input)
            )
        };
        Err(Error::new(output, sentence))
    }

    /// Fails if this folder, which is to be written to, is also an input, or if a file in it is an input and `written` holds for the
    /// file's name.
    ///
    /// # Errors
    /// If the folder or a file is an input; the error names it.
    pub fn check_output_folder(&self, output: &Path, written: impl Fn(&str) -> bool) -> Result<()> {
        self.check_output(output)?;
        for entry in output.read_dir().into_iter().flatten().flatten() {
            if entry.file_name().to_str().is_some_and(&written) {
                self.check_output(&entry.path())?;
            }
        }
        Ok(())
    }
}

/// When a file was last changed; `None` if there is none, or the file system does not tell.
pub(crate) fn changed(path: &Path) -> Option<SystemTime> {
    path.metadata().ok()?.modified().ok()
}

/// Whether the file's extension is one of these, in upper or lower case.
pub fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension()
        .and_then(|e| e.to_str())
        .is_some_and(|e| extensions.iter().any(|x| x.eq_ignore_ascii_case(e)))
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn an_input_is_known_under_all_its_names() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::create_dir(at("in")).unwrap();
        std::fs::write(at("in/1.png"), "").unwrap();
        std::fs::write(at("other.png"), "").unwrap();
        std::fs::hard_link(at("in/1.png"), at("hard.png")).unwrap();
        symlink(at("in/1.png"), at("soft.png")).unwrap();
        symlink("in", at("folder")).unwrap();
        let inputs = Inputs::of([at("in"), at("missing")]);
        for name in ["in", "in/1.png", "hard.png", "soft.png", "folder/1.png", "in/../in/1.png", "folder"] {
            let e = inputs.check_output(&at(name)).unwrap_err().to_string();
            assert!(e.contains("overwritten"), "{e}");
        }
        for name in ["other.png", "in/2.png", "missing", "no/such/folder"] {
            assert_eq!(inputs.check_output(&at(name)), Ok(()), "{name}");
        }
        std::fs::create_dir(at("in/out")).unwrap();
        assert_eq!(Inputs::of([at("in")]).check_output_folder(&at("in/out"), |_| true), Ok(()));
        assert!(inputs.check_output_folder(dir.path(), |_| true).is_err());
        assert_eq!(inputs.check_output_folder(dir.path(), |name| name == "other.png"), Ok(()));
        // These are names of a file that does not exist yet.
        symlink("new.json", at("dangling")).unwrap();
        assert!(
            same_file(&at("new.json"), &at("in/../new.json")) && same_file(&at("new.json"), &at("dangling"))
        );
        assert!(!same_file(&at("new.json"), &at("newer.json")));
    }

    #[test]
    fn what_is_no_file_is_refused_without_waiting() {
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [&pipe, Path::new("/dev/zero")] {
            let e = open_file(path).unwrap_err().to_string();
            assert!(e.contains("a pipe or a device"), "{e}");
        }
        assert!(open_file(dir.path()).unwrap_err().to_string().contains("folder"));
        std::fs::write(dir.path().join("a"), [255; 10]).unwrap();
        assert_eq!(read_file(&dir.path().join("a"), 10).unwrap().len(), 10);
        assert!(read_file(&dir.path().join("a"), 9).unwrap_err().to_string().contains("too large"));
        assert!(read_text(&dir.path().join("a"), 10).unwrap_err().to_string().contains("no text"));
    }
}
