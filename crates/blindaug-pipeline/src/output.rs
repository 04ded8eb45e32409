//! The output of frames into files: a folder of images, one image, or a video.

use crate::{
    Error, Result,
    frames::{Sink, whole},
};
use blindaug::{Encoded, Overscan, Plane, Raster, composite::DistortedLayer};
use blindaug_io::{
    Coding, Error as FileError, ExrHead, FileKind, FrameFormat, Inputs, NamePattern, PngWriter, VideoShape,
    VideoWriter, check_folder, has_extension, is_stream, make_folder, read_text, remove_leftovers_in,
    write_atomically, write_distorted_layer,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs::DirEntry,
    path::{Path, PathBuf},
    time::SystemTime,
};

/// The output of a job: a folder of images, one image, or a video.
pub struct Output {
    path: PathBuf,
    kind: Kind,
    begun: Option<Begun>,
}

/// What the files of images hold beside the frames: their format, and the heads of EXR files by the frame's number.
pub struct ImageFiles {
    /// The format of each file.
    pub format: FrameFormat,
    /// The head of an EXR file that the frame of this number is made from.
    pub heads: Box<dyn Fn(u64) -> Option<ExrHead> + Send>,
    /// The colour spaces of the frames and of the files.
    pub coding: Coding,
}

impl ImageFiles {
    /// Files of this format, whose heads say nothing, for frames that are encoded as the files are.
    pub fn plain(format: FrameFormat) -> Self {
        Self { format, heads: Box::new(|_| None), coding: Coding::default() }
    }
}

enum Kind {
    Folder {
        files: ImageFiles,
        names: NamePattern,
        /// The numbers of the frames that are there already, and when each was made if this program made it.
        there: BTreeMap<u64, Option<SystemTime>>,
        /// Whether the folder was made by this run.
        is_new: bool,
        /// `None` beside frames of which nobody knows the settings.
        record: Option<Record>,
        /// Whether frames that exist already are made anew.
        overwrite: bool,
    },
    Image(ImageFiles),
    Video(VideoWriter, Coding),
}

/// A frame that was begun.
enum Begun {
    Png(u64, Box<PngWriter>),
    Whole {
        number: u64,
        width: usize,
        /// The pixels so far.
        pixels: Vec<[f32; 3]>,
        alpha: Option<Plane>,
        /// How far the pixels and alpha reach beyond the frame.
        overscan: Overscan,
        /// The layer that is written in place of the pixels.
        layer: Option<Box<DistortedLayer>>,
    },
}

impl Output {
    /// Checks, before anything is read, that a folder of this name can be written and that no inputs in it would be replaced, and removes
    /// the leftovers of earlier runs that were killed. Videos and single images are files: see [`Output::is_file`].
    ///
    /// # Errors
    /// If the folder cannot be used; the sentence says why.
    pub fn check_folder(path: &Path, inputs: &Inputs) -> Result<()> {
        if !path.is_dir() && is_other_image(path) {
            let sentence =
                "images are written as exr, png or tif: give a name with such an extension, or a folder";
            return Err(FileError::new(path, sentence).into());
        }
        if !path.is_dir() && is_other_video(path) {
            let sentence =
                "videos are written as mp4, m4v, mov, mkv or avi: give a name with such an extension";
            return Err(FileError::new(path, sentence).into());
        }
        let pattern = NamePattern::of(path);
        let path = pattern.as_ref().map_or(path, NamePattern::folder);
        if path.exists() && !path.is_dir() {
            let sentence =
                "this is a file; give a folder, an image (exr, png, tif) or a video (mp4) by its extension";
            return Err(FileError::new(path, sentence).into());
        }
        let is_frame = |name: &str| match &pattern {
            Some(pattern) => pattern.number(name).is_some(),
            None => FileKind::of_name(Path::new(name))
                .is_some_and(|kind| names(path, kind).number(name).is_some()),
        };
        inputs.check_output_folder(path, is_frame)?;
        check_folder(path)?;
        remove_leftovers_in(path, |name| is_frame(name) || name.ends_with(SETTINGS));
        Ok(())
    }

    /// Whether a name is that of a video, by its extension.
    pub fn is_video(path: &Path) -> bool {
        VideoWriter::is_video(path)
    }

    /// Whether a name is that of a video or of one image, by its extension: no folder has it, and it is no pattern of many names.
    pub fn is_file(path: &Path) -> bool {
        (Self::is_video(path) || FileKind::of_name(path).is_some())
            && !path.is_dir()
            && NamePattern::of(path).is_none()
    }

    /// An output into a video of this shape and of `bits`, 8 or 10, for each value. An existing file is replaced only with `overwrite`.
    ///
    /// # Errors
    /// [`Error::AlreadyThere`], or if the file cannot be written.
    pub fn video(
        path: &Path,
        shape: VideoShape,
        (coding, bits): (Coding, u8),
        overwrite: bool,
    ) -> Result<Self> {
        check_new(path, overwrite)?;
        let video = VideoWriter::create_in(path, shape, (coding.file(), bits))?;
        Ok(Self { path: path.into(), kind: Kind::Video(video, coding), begun: None })
    }

    /// An output of the only frame of a job into an image. An existing file is replaced only with `overwrite`.
    ///
    /// # Errors
    /// [`Error::AlreadyThere`].
    pub fn image(path: &Path, files: ImageFiles, overwrite: bool) -> Result<Self> {
        check_new(path, overwrite)?;
        Ok(Self { path: path.into(), kind: Kind::Image(files), begun: None })
    }

    /// An output into a folder of images, or into images whose names follow a pattern ([`NamePattern`]). The folder is made with the first frame if it does not exist. Frames of the same kind of file that
    /// are in it already are kept unless an input is newer, or `overwrite` is set. `settings` is a text that differs where frames would come out
    /// otherwise; it is written into a hidden file beside the frames. Frames without such a file, of which nobody knows how they were made, are
    /// kept however old they are.
    ///
    /// # Errors
    /// If the folder cannot be read, or the frames in it are to be kept but were made with other settings.
    pub fn folder(path: &Path, files: ImageFiles, settings: &str, overwrite: bool) -> Result<Self> {
        let names = names(path, files.format.kind());
        let folder = names.folder();
        let written = read_text(&settings_file(&names), MOST_SETTINGS).ok();
        let there = || -> Result<BTreeMap<u64, Option<SystemTime>>> {
            let cannot = |e| FileError::new(folder, format!("the folder cannot be read ({e})"));
            let frame = |entry: std::io::Result<DirEntry>| {
                let entry = entry.ok()?;
                let number = names.number(entry.file_name().to_str()?)?;
                // What is empty is no frame: a full disk leaves such files.
                let about = entry.path().metadata().ok().filter(|about| about.len() > 0)?;
                Some((number, about.modified().ok().filter(|_| written.is_some())))
            };
            Ok(folder.read_dir().map_err(cannot)?.filter_map(frame).collect())
        };
        let there = if folder.exists() { there()? } else { BTreeMap::new() };
        if written.is_none() && !overwrite {
            for path in there.keys().map(|&number| names.path(number)) {
                FrameFormat::of_file(&path).map_err(|_| {
                    let sentence =
                        "this is no image, but has the name of a frame: move it, or give another folder";
                    FileError::new(&path, sentence)
                })?;
            }
        }
        let same = written.as_deref() == Some(settings);
        if !there.is_empty() && !same && !overwrite && written.is_some() {
            return Err(Error::OtherSettings { name: FileError::shown_path(folder) });
        }
        let is_known = there.is_empty() || overwrite || written.is_some();
        let record = is_known.then(|| Record {
            settings: settings.to_owned(),
            others: if same { BTreeSet::new() } else { there.keys().copied().collect() },
            written,
        });
        let there = if overwrite { BTreeMap::new() } else { there };
        let path = folder.into();
        let kind = Kind::Folder { files, names, there, is_new: false, record, overwrite };
        Ok(Self { path, kind, begun: None })
    }

    /// Whether the output is a folder with earlier frames that are not all made anew.
    pub fn has_frames(&self) -> bool {
        matches!(&self.kind, Kind::Folder { there, .. } if !there.is_empty())
    }

    /// Whether frames that exist already are made anew, so that a run that is repeated begins with the first frame.
    pub fn overwrites(&self) -> bool {
        matches!(&self.kind, Kind::Folder { overwrite: true, .. })
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

    /// Whether the files hold alpha, and pictures that reach beyond the frame.
    fn takes_alpha(&self) -> bool {
        match &self.kind {
            Kind::Folder { files, .. } | Kind::Image(files) => files.format.is_exr(),
            Kind::Video(..) => false,
        }
    }

    /// Writes the frame that was begun.
    fn end_frame(&mut self) -> Result<()> {
        let (number, width, pixels, alpha, overscan, layer) = match self.begun.take() {
            Some(Begun::Whole { number, width, pixels, alpha, overscan, layer }) => {
                (number, width, pixels, alpha, overscan, layer)
            }
            Some(Begun::Png(_, png)) => return Ok(png.finish()?),
            None => return Ok(()),
        };
        let frame = whole(width, pixels)
            .map_err(|error| Error::Clip { clip: FileError::shown_path(&self.path), error })?;
        let write = |path: &Path, files: &ImageFiles| {
            let head = (files.heads)(number);
            match &layer {
                Some(layer) => {
                    write_distorted_layer(path, layer, files.format.bits(), head.as_ref(), &files.coding)
                }
                None if overscan.is_none() => {
                    files.format.write(path, &frame, alpha.as_ref(), head.as_ref(), &files.coding)
                }
                None => {
                    let picture = (&frame, overscan);
                    files.format.write_around(path, picture, alpha.as_ref(), head.as_ref(), &files.coding)
                }
            }
        };
        match &mut self.kind {
            Kind::Video(video, coding) if coding.keeps() => video.write(&frame)?,
            Kind::Video(video, coding) => video.write(&Encoded(frame.0.map(|p| coding.pixel(p))))?,
            Kind::Image(files) => write(&self.path, files)?,
            Kind::Folder { files, names, .. } => write(&names.path(number), files)?,
        }
        Ok(())
    }

    /// Completes the output.
    ///
    /// # Errors
    /// If a video cannot be completed.
    pub fn finish(self) -> Result<()> {
        match self.kind {
            Kind::Video(video, _) => Ok(video.finish()?),
            Kind::Folder { .. } | Kind::Image(_) => Ok(()),
        }
    }
}

/// Whether a name is that of an image of a kind that is not written, by its extension.
fn is_other_image(path: &Path) -> bool {
    has_extension(path, &["jpg", "jpeg", "bmp", "gif", "webp", "dpx", "tga", "hdr"])
}

/// Whether a name is that of a kind of video that is not written.
fn is_other_video(path: &Path) -> bool {
    has_extension(path, &["mxf", "webm", "mpg", "mpeg", "m2v", "wmv", "flv", "ogv", "ts", "mts", "3gp"])
}

/// Fails if a file is there already that is not to be replaced.
fn check_new(path: &Path, overwrite: bool) -> Result<()> {
    match path.exists() && !is_stream(path) && !overwrite {
        true => Err(Error::AlreadyThere { name: FileError::shown_path(path) }),
        false => Ok(()),
    }
}

impl Sink for Output {
    fn there(&self) -> BTreeMap<u64, Option<SystemTime>> {
        match &self.kind {
            Kind::Folder { there, .. } => there.clone(),
            Kind::Image(_) | Kind::Video(..) => BTreeMap::new(),
        }
    }

    fn begin(&mut self, number: u64, size @ (width, height): (usize, usize)) -> Result<()> {
        if let Kind::Folder { is_new, .. } = &mut self.kind
            && !self.path.exists()
        {
            make_folder(&self.path)?;
            *is_new = true;
        }
        self.begun = Some(match &self.kind {
            Kind::Folder { files, names, .. }
                if files.format == FrameFormat::PNG8 && files.coding.keeps() =>
            {
                let profile = files.coding.profile();
                Begun::Png(number, Box::new(PngWriter::create_with(names.path(number), size, profile)?))
            }
            _ => Begun::Whole {
                number,
                width,
                pixels: Vec::with_capacity(width * height),
                alpha: None,
                overscan: Overscan::default(),
                layer: None,
            },
        });
        Ok(())
    }

    fn put(&mut self, rows: &Raster<[f32; 3]>) -> Result<()> {
        match &mut self.begun {
            Some(Begun::Png(_, png)) => png.write(rows.data())?,
            Some(Begun::Whole { pixels, .. }) => pixels.extend_from_slice(rows.data()),
            None => {}
        }
        Ok(())
    }

    fn put_with_alpha(&mut self, picture: &Encoded, of_picture: &Plane, beyond: Overscan) -> Result<()> {
        let takes_alpha = self.takes_alpha();
        match &mut self.begun {
            Some(Begun::Whole { width, pixels, alpha, overscan, .. }) if takes_alpha => {
                *width = picture.0.width();
                pixels.extend_from_slice(picture.0.data());
                (*alpha, *overscan) = (Some(of_picture.clone()), beyond);
                Ok(())
            }
            _ => self.put(&beyond.frame_of(&picture.0)),
        }
    }

    fn put_layer(&mut self, of_frame: &DistortedLayer) -> Result<()> {
        let takes_alpha = self.takes_alpha();
        match &mut self.begun {
            Some(Begun::Whole { layer, .. }) if takes_alpha => *layer = Some(Box::new(of_frame.clone())),
            _ => return Err(Error::NoLayers),
        }
        Ok(())
    }

    fn end(&mut self) -> Result<()> {
        let number = match &self.begun {
            Some(Begun::Png(number, _) | Begun::Whole { number, .. }) => *number,
            None => return Ok(()),
        };
        self.end_frame()?;
        if let Kind::Folder { names, record: Some(record), .. } = &mut self.kind {
            record.note(number, &settings_file(names));
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

/// The settings that frames are made with, as text, in a hidden file beside them.
struct Record {
    settings: String,
    /// The frames that were there and that are of other settings, or of settings that nobody knows.
    others: BTreeSet<u64>,
    /// What the file holds; `None` if there is none.
    written: Option<String>,
}

impl Record {
    /// Notes that a frame was made with these settings. That the file cannot be written is no reason to stop.
    fn note(&mut self, number: u64, file: &Path) {
        self.others.remove(&number);
        let text = if self.others.is_empty() { &self.settings } else { SEVERAL };
        if self.written.as_deref() != Some(text)
            && write_atomically(file, |path| std::fs::write(path, text)).is_ok()
        {
            self.written = Some(text.into());
        }
    }
}

/// What stands in the place of settings where frames were made with several.
const SEVERAL: &str = "several settings\n";

/// The end of the name of the file that holds settings.
const SETTINGS: &str = ".settings";

/// The most bytes of the settings of frames that are read.
const MOST_SETTINGS: u64 = 1 << 20;

/// The hidden file that holds the settings with which the frames of these names were made.
fn settings_file(names: &NamePattern) -> PathBuf {
    names.folder().join(format!(".{}{SETTINGS}", names.name(0)))
}

/// The names of the frames' files: those of a pattern, or in a folder the number alone.
fn names(path: &Path, kind: FileKind) -> NamePattern {
    NamePattern::of(path).unwrap_or_else(|| NamePattern::plain(path, kind.extension()))
}
