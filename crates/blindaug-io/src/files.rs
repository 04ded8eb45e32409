//! Files that are written beside their place and get their name once they are complete.

use crate::{Error, Result};
use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicU32, Ordering},
};

/// A file under a temporary name in the folder of its target; removed unless it is completed.
pub(crate) struct PartialFile {
    target: PathBuf,
    partial: PathBuf,
    complete: bool,
}

impl PartialFile {
    /// Picks a name beside `target` (hidden, of the same extension). Nothing is created yet.
    pub(crate) fn beside(target: &Path) -> Result<Self> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let Some(name) = target.file_name() else {
            return Err(Error::new(target, "this is not the name of a file to write"));
        };
        if target.is_dir() {
            return Err(Error::new(target, "this is a folder; give the name of a file"));
        }
        let folder = target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            return Err(Error::new(
                target,
                format!("there is no folder {} to write it to", folder.display()),
            ));
        }
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let mut partial = std::ffi::OsString::from(format!(".partial-{}-{count}-", std::process::id()));
        partial.push(name);
        Ok(Self { target: target.into(), partial: folder.join(partial), complete: false })
    }

    /// Where to write.
    pub(crate) fn path(&self) -> &Path {
        &self.partial
    }

    /// The name it will have.
    pub(crate) fn target(&self) -> &Path {
        &self.target
    }

    /// Gives the file its name.
    pub(crate) fn complete(mut self) -> Result<()> {
        std::fs::rename(&self.partial, &self.target).map_err(|e| cannot_write(&self.target, &e))?;
        self.complete = true;
        Ok(())
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        if !self.complete {
            // It may not have been created.
            let _ = std::fs::remove_file(&self.partial);
        }
    }
}

/// An error of a file that is written.
pub(crate) fn cannot_write(path: &Path, e: &std::io::Error) -> Error {
    Error::new(path, format!("cannot be written ({e})"))
}

/// Lets `write` write a file under a temporary name in the folder of `path`, then renames it: `path` is never half
/// written. If anything fails, nothing is left behind.
///
/// # Errors
/// That of `write`, or if the folder is missing or cannot be written to.
pub fn write_atomically(
    path: impl AsRef<Path>,
    write: impl FnOnce(&Path) -> std::io::Result<()>,
) -> Result<()> {
    let file = PartialFile::beside(path.as_ref())?;
    write(file.path()).map_err(|e| cannot_write(file.target(), &e))?;
    file.complete()
}
