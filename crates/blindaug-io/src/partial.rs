//! Files that are written beside their place and get their name once they are complete.

use crate::{
    Error, Result,
    files::{folder_of, link_target},
};
use std::{
    collections::BTreeSet,
    ffi::OsStr,
    fs::{File, OpenOptions},
    path::{Path, PathBuf},
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
};

/// With what the names of incomplete files begin. The process's number, a count and the file's own name follow.
const PREFIX: &str = ".partial-";

/// The most bytes of a file's own name in the name of its incomplete form: file systems allow 255 for all of it.
const MOST_NAME: usize = 200;

/// The files of this process that are not complete.
static INCOMPLETE: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn incomplete() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // A set of paths is whole after every panic.
    INCOMPLETE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file under a temporary name, by which it is written; removed unless it is completed.
pub(crate) struct PartialFile {
    /// The name that was asked for.
    target: PathBuf,
    place: Place,
    partial: PathBuf,
    /// Open and locked as long as it is written, so that another run does not take it for a leftover.
    _lock: File,
}

/// Where a complete file goes.
enum Place {
    /// It gets this name; links have been followed.
    Name(PathBuf),
    /// It is copied into a pipe or a device.
    Stream,
}

impl PartialFile {
    /// Makes an empty file beside `target` (hidden, of the same extension); for a pipe or a device, in the system's folder for
    /// temporary files. Where `target` is a link, what it leads to is meant.
    pub(crate) fn beside(target: &Path) -> Result<Self> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let (place, folder) = match place_of(target)? {
            Place::Name(path) => {
                let folder = folder_of(&path).to_path_buf();
                (Place::Name(path), folder)
            }
            Place::Stream => (Place::Stream, std::env::temp_dir()),
        };
        let name = match &place {
            Place::Name(path) => path.file_name(),
            Place::Stream => target.file_name(),
        };
        let name = partial_name(name.unwrap_or_default());
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let partial = folder.join(format!("{PREFIX}{}-{count}-{name}", std::process::id()));
        // Held, so that the program does not end between the two (`remove_incomplete_files`).
        let mut files = incomplete();
        let lock = OpenOptions::new().write(true).create_new(true).open(&partial);
        let lock = lock.map_err(|e| cannot_write(target, &e))?;
        files.insert(partial.clone());
        drop(files);
        let file = Self { target: target.into(), place, partial, _lock: lock };
        // A file system without locks is no reason not to write; leftovers stay there. On Windows a lock would keep everybody else
        // from writing, the encoder of a video too.
        if cfg!(unix) {
            let _ = file._lock.try_lock();
        }
        Ok(file)
    }

    /// Where to write.
    pub(crate) fn path(&self) -> &Path {
        &self.partial
    }

    /// The name that was asked for.
    pub(crate) fn target(&self) -> &Path {
        &self.target
    }

    /// Gives the file its name, or copies it into its pipe or device.
    pub(crate) fn complete(self) -> Result<()> {
        let completed = match &self.place {
            Place::Name(name) => std::fs::rename(&self.partial, name),
            Place::Stream => copy_into(&self.partial, &self.target),
        };
        completed.map_err(|e| cannot_write(&self.target, &e))
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        // After a renaming there is nothing of this name.
        let _ = std::fs::remove_file(&self.partial);
        incomplete().remove(&self.partial);
    }
}

/// Where a file of this name goes.
fn place_of(target: &Path) -> Result<Place> {
    if target.file_name().is_none() {
        return Err(Error::new(target, "this is not the name of a file to write"));
    }
    if target.is_dir() {
        return Err(Error::new(target, "this is a folder; give the name of a file"));
    }
    if is_stream(target) {
        return Ok(Place::Stream);
    }
    let path = link_target(target).map_err(|e| cannot_write(target, &e))?;
    // A link to what the system calls this process's own output.
    if is_stream(&path) {
        return Ok(Place::Stream);
    }
    let folder = folder_of(&path);
    if !folder.is_dir() {
        let folder = Error::shown_path(folder);
        return Err(Error::new(target, format!("there is no folder {folder} to write it to; make it first")));
    }
    Ok(Place::Name(path))
}

/// Whether a path leads to a pipe or a device, which is written into and never replaced.
pub fn is_stream(path: &Path) -> bool {
    // These may be redirected to a file, which whoever opened it goes on to write.
    let own = ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc"];
    let is_there = || path.metadata().is_ok_and(|m| !m.is_file() && !m.is_dir());
    cfg!(unix) && (own.iter().any(|own| path.starts_with(own)) || is_there())
}

fn copy_into(from: &Path, stream: &Path) -> std::io::Result<()> {
    // At the end, in case it is a file after all.
    let mut stream = OpenOptions::new().append(true).open(stream)?;
    std::io::copy(&mut File::open(from)?, &mut stream).map(drop)
}

/// A file's own name as it stands in the name of its incomplete form: its end, which has the extension.
fn partial_name(name: &OsStr) -> String {
    let name = name.to_string_lossy();
    let start = (name.len().saturating_sub(MOST_NAME)..).find(|&i| name.is_char_boundary(i)).unwrap_or(0);
    name[start..].into()
}

/// Removes what earlier runs that were killed have left of the file `target`, and nothing that a running process writes.
pub(crate) fn remove_leftovers(target: &Path) {
    let Ok(Place::Name(path)) = place_of(target) else { return };
    let name = partial_name(path.file_name().unwrap_or_default());
    remove_leftovers_in(folder_of(&path), |of| of == name);
}

/// Checks that a file can be written, and removes what earlier runs that were killed have left of it. Nothing is written.
///
/// # Errors
/// If its folder is missing or cannot be written to, or the path is a folder's.
pub fn check_writable(target: &Path) -> Result<()> {
    remove_leftovers(target);
    PartialFile::beside(target).map(drop)
}

/// Removes what earlier runs that were killed have left in a folder, of the files for whose names `of` holds.
pub fn remove_leftovers_in(folder: &Path, of: impl Fn(&str) -> bool) {
    // Where files cannot be locked it cannot be told whether they are being written.
    if !cfg!(unix) {
        return;
    }
    let wanted = |name: &str| {
        let mut parts = name.strip_prefix(PREFIX)?.splitn(3, '-');
        let mut number = || parts.next().filter(|n| n.parse::<u32>().is_ok());
        number().and(number())?;
        parts.next().filter(|name| of(name)).map(drop)
    };
    for entry in folder.read_dir().into_iter().flatten().flatten() {
        let path = entry.path();
        let is_file = entry.file_type().is_ok_and(|t| t.is_file());
        if is_file && entry.file_name().to_str().and_then(wanted).is_some() {
            let unlocked = OpenOptions::new().write(true).open(&path).is_ok_and(|f| f.try_lock().is_ok());
            if unlocked {
                // Another run may be quicker.
                let _ = std::fs::remove_file(&path);
            }
        }
    }
}

/// Removes all files of this process that are not complete, and lets no thread begin another one: for a program that ends at once.
pub fn remove_incomplete_files() {
    let files = incomplete();
    for path in files.iter() {
        // It may have got its name just now.
        let _ = std::fs::remove_file(path);
    }
    // Whoever begins a file waits for this lock, until the program has ended.
    std::mem::forget(files);
}

/// An error of a file that is written.
pub(crate) fn cannot_write(path: &Path, e: &std::io::Error) -> Error {
    use std::io::ErrorKind;
    let sentence = match e.kind() {
        ErrorKind::FileTooLarge => {
            "cannot be written: it would be larger than files may be here (ulimit -f)".into()
        }
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            format!("cannot be written ({e}); free some space, or choose another folder")
        }
        ErrorKind::InvalidFilename => format!("cannot be written ({e}); give a shorter name"),
        _ => format!("cannot be written ({e})"),
    };
    Error::new(path, sentence)
}

/// Lets `write` write a file under a temporary name in the folder of `path`, then renames it: `path` is never half written. If
/// anything fails, nothing is left behind. A link is followed; a pipe or a device is written into.
///
/// # Errors
/// The error of `write`, or that the folder is missing or cannot be written to.
pub fn write_atomically(
    path: impl AsRef<Path>,
    write: impl FnOnce(&Path) -> std::io::Result<()>,
) -> Result<()> {
    let file = PartialFile::beside(path.as_ref())?;
    write(file.path()).map_err(|e| cannot_write(file.target(), &e))?;
    file.complete()
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            folder.read_dir().unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_link_stays_a_link_and_a_pipe_a_pipe() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::create_dir(at("there")).unwrap();
        std::fs::write(at("there/a"), "before").unwrap();
        symlink("there/a", at("link")).unwrap();
        symlink("there/b", at("to-nothing")).unwrap();
        write_atomically(at("link"), |p| std::fs::write(p, "after")).unwrap();
        write_atomically(at("to-nothing"), |p| std::fs::write(p, "new")).unwrap();
        assert!(at("link").is_symlink() && at("to-nothing").is_symlink());
        assert_eq!(std::fs::read_to_string(at("there/a")).unwrap(), "after");
        assert_eq!(std::fs::read_to_string(at("there/b")).unwrap(), "new");
        let pipe = at("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || std::fs::read_to_string(pipe).unwrap()
        });
        write_atomically(&pipe, |p| std::fs::write(p, "through")).unwrap();
        assert_eq!(reader.join().unwrap(), "through");
        write_atomically("/dev/null", |p| std::fs::write(p, "nowhere")).unwrap();
        assert!(is_stream(Path::new("/dev/null")) && is_stream(&pipe) && !is_stream(&at("link")));
        symlink("loop", at("loop")).unwrap();
        assert!(write_atomically(at("loop"), |p| std::fs::write(p, "")).is_err());
        assert_eq!(names(dir.path()), ["link", "loop", "pipe", "there", "to-nothing"]);
        assert_eq!(names(&at("there")), ["a", "b"]);
    }

    #[test]
    fn the_longest_names_can_be_written() {
        let dir = tempfile::tempdir().unwrap();
        for name in [format!("{}.json", "x".repeat(250)), format!("{}.json", "é".repeat(125))] {
            let path = dir.path().join(&name);
            write_atomically(&path, |p| {
                assert!(p.extension() == path.extension());
                std::fs::write(p, "")
            })
            .unwrap();
            assert!(path.exists());
        }
        let e = write_atomically(dir.path().join("x".repeat(256)), |p| std::fs::write(p, "")).unwrap_err();
        assert!(e.to_string().contains("cannot be written"), "{e}");
        assert_eq!(names(dir.path()).len(), 2);
    }

    #[test]
    fn a_later_run_removes_what_a_killed_one_left_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let others = [
            ".partial-1-2-b.json",
            ".partial-1-a.json",
            ".partial-x-2-a.json",
            "a.json",
            "partial-1-2-a.json",
        ];
        for name in others.into_iter().chain([".partial-1-2-a.json", ".partial-77-0-a.json"]) {
            std::fs::write(at(name), "").unwrap();
        }
        let written = PartialFile::beside(&at("a.json")).unwrap();
        remove_leftovers(&at("a.json"));
        assert!(written.path().exists());
        drop(written);
        let mut left = others.to_vec();
        left.sort_unstable();
        assert_eq!(names(dir.path()), left);
    }

    #[test]
    fn a_program_that_ends_at_once_can_take_its_files_with_it() {
        let dir = tempfile::tempdir().unwrap();
        let file = PartialFile::beside(&dir.path().join("a")).unwrap();
        assert_eq!(names(dir.path()).len(), 1);
        for path in incomplete().iter().filter(|p| p.starts_with(dir.path())) {
            std::fs::remove_file(path).unwrap();
        }
        assert!(names(dir.path()).is_empty());
        drop(file);
        assert!(!incomplete().iter().any(|p| p.starts_with(dir.path())));
    }
}

/// Checks, before anything is read, that a folder can be written to, or made.
///
/// # Errors
/// If it is something else, or the system does not allow it.
pub fn check_folder(folder: &Path) -> Result<()> {
    if folder.exists() && !folder.is_dir() {
        return Err(Error::new(folder, "this is a file; give the name of a folder"));
    }
    // What is there of the path.
    let there =
        folder.ancestors().find(|p| !p.as_os_str().is_empty() && p.exists()).unwrap_or(Path::new("."));
    if !there.is_dir() {
        let file = Error::shown_path(there);
        return Err(Error::new(folder, format!("the folder cannot be made: {file} is a file")));
    }
    let probe = there.join(format!(".blindaug-{}", std::process::id()));
    std::fs::File::create(&probe).and_then(|_| std::fs::remove_file(&probe)).map_err(|e| {
        Error::new(folder, format!("no file can be written to this folder ({e}); choose another"))
    })
}

/// Makes a folder for results, with those above it.
///
/// # Errors
/// If it cannot be made or written to.
pub fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .map_err(|e| Error::new(folder, format!("the folder cannot be made ({e}); choose another")))?;
    check_folder(folder)
}
