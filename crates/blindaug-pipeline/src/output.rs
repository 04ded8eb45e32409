//! The output of frames into files: a folder of PNG files, or a video.

use crate::{
    Error, Result,
    frames::{Sink, whole},
};
use blindaug::{Encoded, Raster};
use blindaug_io::{
    Error as FileError, Inputs, PngWriter, VideoWriter, check_folder, is_stream, make_folder,
    remove_leftovers_in,
};
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

/// The output of a job: a folder of PNG files, or a video.
pub struct Output {
    path: PathBuf,
    kind: Kind,
    begun: Option<Begun>,
}

enum Kind {
    Folder {
        /// The numbers of the frames that exist already.
        done: BTreeSet<u64>,
        /// Whether the folder was made by this run.
        is_new: bool,
    },
    Video(VideoWriter),
}

/// A frame that was begun.
enum Begun {
    Png(Box<PngWriter>),
    /// The width, and the pixels so far.
    Whole(usize, Vec<[f32; 3]>),
}

impl Output {
    /// Checks, before anything is read, that a folder of this name can be written and that no inputs in it would be replaced, and removes
    /// the leftovers of earlier runs that were killed. Videos are files: see [`Output::is_video`].
    ///
    /// # Errors
    /// If the folder cannot be used; the sentence says why.
    pub fn check_folder(path: &Path, inputs: &Inputs) -> Result<()> {
        if path.exists() && !path.is_dir() {
            let sentence = "this is a file; give a folder, or a video by its extension (mp4)";
            return Err(FileError::new(path, sentence).into());
        }
        let is_frame = |name: &str| number_of_png(name).is_some();
        inputs.check_output_folder(path, is_frame)?;
        check_folder(path)?;
        remove_leftovers_in(path, is_frame);
        Ok(())
    }

    /// Whether a name is that of a video, by its extension.
    pub fn is_video(path: &Path) -> bool {
        VideoWriter::is_video(path)
    }

    /// An output into a video of `fps` frames per second. An existing file is replaced only with `overwrite`.
    ///
    /// # Errors
    /// [`Error::AlreadyThere`], or if the file cannot be written.
    pub fn video(path: &Path, size: (usize, usize), fps: f64, overwrite: bool) -> Result<Self> {
        if path.exists() && !is_stream(path) && !overwrite {
            return Err(Error::AlreadyThere { name: FileError::shown_path(path) });
        }
        let video = VideoWriter::create(path, size, fps)?;
        Ok(Self { path: path.into(), kind: Kind::Video(video), begun: None })
    }

    /// An output into a folder of PNG files, which is made with the first frame if it does not exist. Frames that are in it already are
    /// kept, unless `overwrite` is set.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub fn folder(path: &Path, overwrite: bool) -> Result<Self> {
        let done = if overwrite || !path.exists() { BTreeSet::new() } else { numbers_of_pngs(path)? };
        Ok(Self { path: path.into(), kind: Kind::Folder { done, is_new: false }, begun: None })
    }

    /// Whether the output is a folder with earlier frames that are kept.
    pub fn has_frames(&self) -> bool {
        matches!(&self.kind, Kind::Folder { done, .. } if !done.is_empty())
    }

    /// Writes a whole frame.
    ///
    /// # Errors
    /// If the frame cannot be written.
    pub fn write(&mut self, number: u64, frame: &Encoded) -> Result<()> {
        self.begin(number, frame.0.size())?;
        self.put(&frame.0)?;
        self.end()
    }

    /// Completes the output.
    ///
    /// # Errors
    /// If a video cannot be completed.
    pub fn finish(self) -> Result<()> {
        match self.kind {
            Kind::Video(video) => Ok(video.finish()?),
            Kind::Folder { .. } => Ok(()),
        }
    }
}

impl Sink for Output {
    fn done(&self) -> BTreeSet<u64> {
        match &self.kind {
            Kind::Folder { done, .. } => done.clone(),
            Kind::Video(_) => BTreeSet::new(),
        }
    }

    fn begin(&mut self, number: u64, size @ (width, height): (usize, usize)) -> Result<()> {
        self.begun = Some(match &mut self.kind {
            Kind::Folder { is_new, .. } => {
                if !self.path.exists() {
                    make_folder(&self.path)?;
                    *is_new = true;
                }
                Begun::Png(Box::new(PngWriter::create(self.path.join(png_name(number)), size)?))
            }
            Kind::Video(_) => Begun::Whole(width, Vec::with_capacity(width * height)),
        });
        Ok(())
    }

    fn put(&mut self, rows: &Raster<[f32; 3]>) -> Result<()> {
        match &mut self.begun {
            Some(Begun::Png(png)) => png.write(rows.data())?,
            Some(Begun::Whole(_, pixels)) => pixels.extend_from_slice(rows.data()),
            None => {}
        }
        Ok(())
    }

    fn end(&mut self) -> Result<()> {
        match (self.begun.take(), &mut self.kind) {
            (Some(Begun::Png(png)), _) => png.finish()?,
            (Some(Begun::Whole(width, pixels)), Kind::Video(video)) => {
                let frame = whole(width, pixels)
                    .map_err(|error| Error::Clip { clip: FileError::shown_path(&self.path), error })?;
                video.write(&frame)?;
            }
            _ => {}
        }
        Ok(())
    }

    fn abandon(&mut self) {
        self.begun = None;
        if let Kind::Folder { is_new: true, .. } = self.kind {
            // `remove_dir` fails for a folder with frames in it, so that this folder stays.
            let _ = std::fs::remove_dir(&self.path);
        }
    }
}

fn png_name(number: u64) -> String {
    format!("{number:04}.png")
}

/// The numbers of the frames that have been written to a folder.
fn numbers_of_pngs(folder: &Path) -> Result<BTreeSet<u64>> {
    let cannot = |e| FileError::new(folder, format!("the folder cannot be read ({e})"));
    let entries = folder.read_dir().map_err(cannot)?;
    Ok(entries.filter_map(|e| number_of_png(e.ok()?.file_name().to_str()?)).collect())
}

/// The number of a frame whose file has this name.
fn number_of_png(name: &str) -> Option<u64> {
    name.strip_suffix(".png")?.parse().ok().filter(|&n| png_name(n) == name)
}
