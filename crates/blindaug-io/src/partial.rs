//! Files that are written under a temporary name and renamed once they are complete.

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

/// The prefix of the names of incomplete files, which the process's number, a count and the file's own name follow.
const PREFIX: &str = ".partial-";

/// The most bytes of a file's own name in its temporary name: file systems allow 255 bytes in all.
const MOST_NAME: usize = 200;

/// The temporary paths of this process's incomplete files.
static INCOMPLETE: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn incomplete() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // A panic of another thread cannot leave the set half changed.
    INCOMPLETE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file that is written under a temporary name, and removed when dropped unless it was completed.
pub(crate) struct PartialFile {
    /// The path that was asked for.
    target: PathBuf,
    place: Place,
    partial: PathBuf,
    /// The file, open and locked while it is written, so that another run does not take it for a leftover.
    _lock: File,
}

/// The destination of a complete file.
enum Place {
    /// The file is renamed to this path, in which links have been followed.
    Name(PathBuf),
    /// The file is copied into a pipe or a device.
    Stream,
}

impl PartialFile {
    /// Makes an empty hidden file of the same extension beside `target`, or, for a pipe or a device, in the system's folder for
    /// temporary files. If `target` is a link, the file is made beside the link's destination.
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
        // The lock is held until the new file is in the set, so that `remove_incomplete_files` does not miss it.
        let mut files = incomplete();
        let lock = OpenOptions::new().write(true).create_new(true).open(&partial);
        let lock = lock.map_err(|e| cannot_write(target, &e))?;
        files.insert(partial.clone());
        drop(files);
        let file = Self { target: target.into(), place, partial, _lock: lock };
        // On a file system without locks the file is written all the same, but leftovers are never removed. On Windows a lock would
        // keep other processes from writing, such as the encoder of a video.
        if cfg!(unix) {
            let _ = file._lock.try_lock();
        }
        Ok(file)
    }

    /// The temporary path to write to.
    pub(crate) fn path(&self) -> &Path {
        &self.partial
    }

    /// The path that was asked for.
    pub(crate) fn target(&self) -> &Path {
        &self.target
    }

    /// Renames the file to its target, or copies it into the target if that is a pipe or a device.
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
        // After a renaming there is no file of this name, and this error does not matter.
        let _ = std::fs::remove_file(&self.partial);
        incomplete().remove(&self.partial);
    }
}

/// The destination of a file that is asked for as `target`.
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
    // The link leads to this process's own output, such as /dev/stdout.
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
    // The process's own outputs may be redirected to a file, to which the program that opened it goes on writing.
    let own = ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc"];
    let is_there = || path.metadata().is_ok_and(|m| !m.is_file() && !m.is_dir());
    cfg!(unix) && (own.iter().any(|own| path.starts_with(own)) || is_there())
}

fn copy_into(from: &Path, stream: &Path) -> std::io::Result<()> {
    // The bytes are appended, in case the output is redirected to a file.
    let mut stream = OpenOptions::new().append(true).open(stream)?;
    std::io::copy(&mut File::open(from)?, &mut stream).map(drop)
}

/// The part of a file's own name that stands in its temporary name: its end, which has the extension.
fn partial_name(name: &OsStr) -> String {
    let name = name.to_string_lossy();
    let start = (name.len().saturating_sub(MOST_NAME)..).find(|&i| name.is_char_boundary(i)).unwrap_or(0);
    name[start..].into()
}

/// Removes incomplete files of `target` that killed runs have left, but none that a running process writes.
pub(crate) fn remove_leftovers(target: &Path) {
    let Ok(Place::Name(path)) = place_of(target) else { return };
    let name = partial_name(path.file_name().unwrap_or_default());
    remove_leftovers_in(folder_of(&path), |of| of == name);
}

/// Checks that a file can be written, and removes incomplete files of it that killed runs have left. The file stays as it is.
///
/// # Errors
/// If the file's folder is missing or cannot be written to, or the path is a folder's.
pub fn check_writable(target: &Path) -> Result<()> {
    remove_leftovers(target);
    PartialFile::beside(target).map(drop)
}

/// Removes incomplete files that killed runs have left in a folder, if `of` holds for the name of the complete file.
pub fn remove_leftovers_in(folder: &Path, of: impl Fn(&str) -> bool) {
    // Without locks an incomplete file cannot be told from one that is being written.
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
                // Another run may have removed the file already.
                let _ = std::fs::remove_file(&path);
            }
        }
    }
}

/// Removes all incomplete files of this process, and lets no thread begin another one. It is for a program that ends at once.
pub fn remove_incomplete_files() {
    let files = incomplete();
    for path in files.iter() {
        // The file may have been renamed just now.
        let _ = std::fs::remove_file(path);
    }
    // A thread that begins a file waits for this lock until the program has ended.
    std::mem::forget(files);
}

/// The error of a file that cannot be written.
pub fn cannot_write(path: &Path, e: &std::io::Error) -> Error {
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
/// The error of `write`, or an error if the folder is missing or cannot be written to.
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

/// Checks that a folder can be written to, or made, so that a command can fail before it reads its input.
///
/// # Errors
/// If the path is a file's, or the system does not allow writing there.
pub fn check_folder(folder: &Path) -> Result<()> {
    if folder.exists() && !folder.is_dir() {
        return Err(Error::new(folder, "this is a file; give the name of a folder"));
    }
    // The longest part of the path that exists.
    let there =
        folder.ancestors().find(|p| !p.as_os_str().is_empty() && p.exists()).unwrap_or(Path::new("."));
    if !there.is_dir() {
        let file = Error::shown_path(there);
        return Err(Error::new(folder, format!("the folder cannot be made: {file} is a file")));
    }
    // Each check has a file of its own, since others of this process and of others may be under way.
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    let probe = there.join(format!(".blindaug-{}-{count}", std::process::id()));
    let made = File::create(&probe).and_then(|_| match std::fs::remove_file(&probe) {
        // A process of the same number on another machine has removed it.
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    });
    made.map_err(|e| {
        Error::new(folder, format!("no file can be written to this folder ({e}); choose another"))
    })
}

/// Makes a folder for results, with its missing parent folders.
///
/// # Errors
/// If the folder cannot be made or written to.
pub fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .map_err(|e| Error::new(folder, format!("the folder cannot be made ({e}); choose another")))?;
    check_folder(folder)
}
