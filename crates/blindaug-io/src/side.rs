//! Side folders: depth, flow and other data of frames, matched to the frames by number.

use crate::{
    DepthFormat, DepthValues, Error, FrameSource, NamePattern, Reading, Result, VirtualLayerFile, exr,
    exr_contents,
    files::{changed, check_regular, has_extension},
    image,
    limits::is_exr,
    not_numbers::{Counted, NotNumbers, few},
    read_flow, read_inverse_depth, read_virtual_layer,
    sequence::{frame_files, numbered_files},
};
use blindaug::{
    Encoded, Flow, Plane,
    colour_space::{ColourSpace, Primaries, conversion, converted},
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::SystemTime,
};

/// A folder of files that belong to frames, matched to the frames by the last number in the files' names. A single file in place
/// of the folder belongs to every frame.
pub struct SideFolder<T> {
    path: PathBuf,
    kind: SideKind<T>,
    files: Files,
    read: Reader<T>,
    notes: Vec<String>,
    /// The files with pixels that are not numbers, of those that were read.
    not_numbers: NotNumbers,
}

type Reader<T> = Box<dyn Fn(&Path) -> Result<Counted<T>> + Send + Sync>;

/// A reader of data that say themselves where they are unknown.
fn all_numbers<T>(read: impl Fn(&Path) -> Result<T> + Send + Sync + 'static) -> Reader<T> {
    Box::new(move |path| Ok((read(path)?, 0)))
}

/// The kind of data in a side folder.
struct SideKind<T> {
    /// The name of the data, for messages.
    what: &'static str,
    /// The file formats that are accepted, for messages.
    accepted: &'static str,
    size_of: fn(&T) -> (usize, usize),
}

/// The files of a side folder.
pub(crate) enum Files {
    Numbered(BTreeMap<u64, PathBuf>),
    One(PathBuf),
}

impl Files {
    fn first(&self) -> Option<&Path> {
        match self {
            Self::Numbered(files) => files.values().next().map(PathBuf::as_path),
            Self::One(path) => Some(path),
        }
    }
}

impl SideFolder<Encoded> {
    /// Opens frames of another kind; `what` ("the clean frames", say) names them in messages.
    ///
    /// # Errors
    /// If there is no such folder or no frame in it, or two frames have the same number.
    pub fn frames(path: impl AsRef<Path>, what: &'static str) -> Result<Self> {
        Self::images(path.as_ref(), what, Box::new(|p| Reading::default().read_counted(p)), "display-encoded")
    }

    /// Opens frames of another kind of the views of a clip whose own frames are read like this.
    ///
    /// # Errors
    /// The same as [`SideFolder::frames`].
    pub fn frames_beside(path: impl AsRef<Path>, what: &'static str, reading: Reading) -> Result<Self> {
        let unit = reading.transfer.name();
        Self::images(path.as_ref(), what, Box::new(move |p| reading.read_counted(p)), unit)
    }

    /// Opens sharp renders of a local scene. They come out encoded as sRGB, but in these primaries, whatever their own are: those of `said`,
    /// or what each file tells.
    ///
    /// # Errors
    /// The same as [`SideFolder::frames`].
    pub fn renders(
        path: impl AsRef<Path>,
        what: &'static str,
        said: Option<ColourSpace>,
        primaries: Primaries,
    ) -> Result<Self> {
        let reading = Reading { exr: said, ..Reading::default() };
        let read = move |path: &Path| {
            let (Encoded(image), not_numbers) = reading.read_counted(path)?;
            let matrix = conversion(reading.space_of(path)?.primaries, primaries);
            let t = reading.transfer;
            let image = match matrix {
                Some(m) => image.map(|p| converted(&m, p.map(|v| t.decode(v))).map(|v| t.encode(v))),
                None => image,
            };
            Ok((Encoded(image), not_numbers))
        };
        Self::images(path.as_ref(), what, Box::new(read), "sharp renders")
    }

    fn images(path: &Path, what: &'static str, read: Reader<Encoded>, unit: &str) -> Result<Self> {
        let files =
            |path: &Path, notes: &mut Vec<String>| Ok(frame_files(path, notes)?.into_iter().collect());
        let kind = SideKind { what, accepted: "images", size_of: |i: &Encoded| i.0.size() };
        let unit = unit.to_owned();
        Self::open(path, kind, files, read, |_| unit)
    }
}

impl SideFolder<Plane> {
    /// Opens depth maps: EXR with `Z`, else PGM, else PNG, else TIFF. They are read as inverse depth; NaN is no reading.
    ///
    /// # Errors
    /// If there is no such folder or no depth in it, or two files have the same number.
    pub fn depth(path: impl AsRef<Path>, format: DepthFormat) -> Result<Self> {
        let unit = |files: &Files| Self::depth_unit(files, format);
        let files = |path: &Path, notes: &mut Vec<String>| {
            let exr = numbered_files(path, &["exr"], notes)?;
            let has_z = match exr.values().next() {
                Some(first) => exr_contents(first)?.depth,
                None => false,
            };
            let kinds: [&[&str]; 3] = [&["pgm"], &["png"], &["tif", "tiff"]];
            let mut files = if has_z { exr } else { BTreeMap::new() };
            for kind in kinds {
                if files.is_empty() {
                    files = numbered_files(path, kind, notes)?;
                }
            }
            Ok(files)
        };
        let read = all_numbers(move |p| read_inverse_depth(p, format));
        Self::open(path.as_ref(), Self::DEPTH, files, read, unit)
    }

    /// The depth in the files of these frames, in metres there; `None` unless the first of them is an EXR file with `Z`.
    pub fn depth_of_frames(frames: &FrameSource) -> Option<Self> {
        let format = DepthFormat::default();
        let (files, read) =
            (frames.exr_files(|has| has.depth)?, all_numbers(move |p| read_inverse_depth(p, format)));
        let unit = |files: &Files| Self::depth_unit(files, format);
        Some(Self::new(frames.path(), Self::DEPTH, files, read, vec![], unit))
    }

    const DEPTH: SideKind<Plane> =
        SideKind { what: "depth", accepted: "EXR with a channel Z, PGM, PNG or TIFF", size_of: Plane::size };

    fn depth_unit(files: &Files, format: DepthFormat) -> String {
        // The scale is said only of integer files, since EXR has metres.
        let is_exr = files.first().is_some_and(|path| has_extension(path, &["exr"]));
        match (format.values, is_exr) {
            (DepthValues::Metric, true) => "in metres".into(),
            (DepthValues::Metric, false) => format!("{} units a metre", format.per_metre),
            (DepthValues::Inverse, true) => "inverse depth in 1/m".into(),
            (DepthValues::Inverse, false) => format!("inverse depth, {} units for 1/m", format.per_metre),
            (DepthValues::RelativeInverse, _) => "relative inverse depth".into(),
        }
    }

    /// Opens inverse depth that [`crate::EvidenceWriter`] wrote, in its own unit: `scale` is the inverse depth of the largest integer; 0 is
    /// no reading.
    ///
    /// # Errors
    /// If there is no such folder or no depth in it, or two files have the same number.
    pub(crate) fn saved_depth(path: impl AsRef<Path>, scale: f32) -> Result<Self> {
        let format = DepthFormat { values: DepthValues::RelativeInverse, ..DepthFormat::default() };
        let mut folder = Self::depth(path, format)?;
        folder.read = all_numbers(move |p| {
            let stored = read_inverse_depth(p, format)?;
            Ok(stored.map(|d| if d > 0.0 { d * scale } else { f32::NAN }))
        });
        Ok(folder)
    }
}

/// The side of an object on which the things lie that a matte shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MatteSide {
    /// White is in front of the object and hides it.
    #[default]
    Front,
    /// White is behind the object, which is seen there alone.
    Behind,
}

impl SideFolder<Plane> {
    /// Opens mattes: EXR (alpha, or the only channel, or red), else PNG or TIFF (alpha if there is any transparency, else the brightness), 0 to
    /// 1. They are read as the share of each pixel that hides the object.
    ///
    /// # Errors
    /// If there is no such folder or no matte in it, or two files have the same number.
    pub fn mattes(path: impl AsRef<Path>, side: MatteSide) -> Result<Self> {
        let files = |path: &Path, notes: &mut Vec<String>| {
            let kinds: [&[&str]; 3] = [&["exr"], &["png"], &["tif", "tiff"]];
            let mut files = BTreeMap::new();
            for kind in kinds {
                if files.is_empty() {
                    files = numbered_files(path, kind, notes)?;
                }
            }
            Ok(files)
        };
        let read = move |path: &Path| {
            let matte = if is_exr(path)? { exr::read_matte(path)? } else { image::read_matte(path)? };
            let not_numbers = few(path, matte.data().iter().map(|v| v.is_nan()))?;
            let share = |v: f32| if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) };
            Ok((matte.map(|v| if side == MatteSide::Front { share(v) } else { 1.0 - share(v) }), not_numbers))
        };
        let kind = SideKind { what: "mattes", accepted: "EXR, PNG or TIFF", size_of: Plane::size };
        let unit = match side {
            MatteSide::Front => "white is in front of the object",
            MatteSide::Behind => "white is behind the object",
        };
        Self::open(path.as_ref(), kind, files, Box::new(read), |_| unit.into())
    }
}

impl SideFolder<Flow> {
    /// Opens optical flow: EXR with `forward.u` and `forward.v`, else `.flo`.
    ///
    /// # Errors
    /// If there is no such folder or no flow in it, or two files have the same number.
    pub fn flow(path: impl AsRef<Path>) -> Result<Self> {
        let files = |path: &Path, notes: &mut Vec<String>| {
            let exr = numbered_files(path, &["exr"], notes)?;
            match exr.values().next() {
                Some(first) if exr_contents(first)?.flow => Ok(exr),
                _ => numbered_files(path, &["flo"], notes),
            }
        };
        Self::open(path.as_ref(), Self::KIND, files, all_numbers(|p| read_flow(p)), Self::unit)
    }

    /// The optical flow in the files of these frames; `None` unless the first of them is an EXR file with flow.
    pub fn of_frames(frames: &FrameSource) -> Option<Self> {
        let files = frames.exr_files(|has| has.flow)?;
        Some(Self::new(frames.path(), Self::KIND, files, all_numbers(|p| read_flow(p)), vec![], Self::unit))
    }

    const KIND: SideKind<Flow> = SideKind {
        what: "flow",
        accepted: ".flo, or EXR with channels forward.u and forward.v",
        size_of: Flow::size,
    };

    fn unit(_: &Files) -> String {
        "px to the next frame".into()
    }
}

impl SideFolder<VirtualLayerFile> {
    /// Opens rendered virtual layers, one EXR per frame.
    ///
    /// # Errors
    /// If there is no such folder or no EXR in it, or two files have the same number.
    pub fn virtual_layers(path: impl AsRef<Path>) -> Result<Self> {
        Self::virtual_layers_in(path, None, Primaries::REC709)
    }

    /// Opens rendered virtual layers, whose light comes out in these primaries, whatever their own are: those of `said`, or what each file
    /// tells.
    ///
    /// # Errors
    /// The same as [`SideFolder::virtual_layers`].
    pub fn virtual_layers_in(
        path: impl AsRef<Path>,
        said: Option<ColourSpace>,
        primaries: Primaries,
    ) -> Result<Self> {
        let files = |path: &Path, notes: &mut Vec<String>| numbered_files(path, &["exr"], notes);
        Self::open(path.as_ref(), Self::KIND, files, Self::reader(said, primaries), Self::unit)
    }

    /// The frames themselves, as layers whose light is in the primaries of the frames; `None` unless the first of them is an EXR file with
    /// alpha.
    pub fn of_frames(frames: &FrameSource) -> Option<Self> {
        let files = frames.exr_files(|has| has.alpha)?;
        let read = Self::reader(frames.reading().exr, frames.space().primaries);
        Some(Self::new(frames.path(), Self::KIND, files, read, vec![], Self::unit))
    }

    const KIND: SideKind<VirtualLayerFile> = SideKind {
        what: "virtual layers",
        accepted: "EXR with channels R G B A",
        size_of: |v| v.overscan.frame_size(v.color.0.size()),
    };

    fn unit(_: &Files) -> String {
        "premultiplied, scene-linear".into()
    }

    fn reader(said: Option<ColourSpace>, primaries: Primaries) -> Reader<VirtualLayerFile> {
        Box::new(move |path| {
            let mut layer = read_virtual_layer(path)?;
            let own = Reading { exr: said, ..Reading::default() }.space_of(path)?.primaries;
            if let Some(m) = conversion(own, primaries) {
                layer.color.0 = layer.color.0.map(|[r, g, b, a]| {
                    let [r, g, b] = converted(&m, [r, g, b]);
                    [r, g, b, a]
                });
            }
            let not_numbers = layer.not_numbers;
            Ok((layer, not_numbers))
        })
    }
}

impl<T> SideFolder<T> {
    fn open(
        path: &Path,
        kind: SideKind<T>,
        list: impl FnOnce(&Path, &mut Vec<String>) -> Result<BTreeMap<u64, PathBuf>>,
        read: Reader<T>,
        unit: impl FnOnce(&Files) -> String,
    ) -> Result<Self> {
        let mut notes = Vec::new();
        let files = if let Some(pattern) = NamePattern::of(path) {
            Files::Numbered(pattern.files()?)
        } else if path.is_dir() {
            let files = list(path, &mut notes)?;
            if files.is_empty() {
                return Err(Error::new(
                    path,
                    format!("the folder has no files with {} ({})", kind.what, kind.accepted),
                ));
            }
            Files::Numbered(files)
        } else {
            check_regular(path, &path.metadata().map_err(|e| Error::cannot_read(path, &e))?)?;
            Files::One(path.into())
        };
        Ok(Self::new(path, kind, files, read, notes, unit))
    }

    fn new(
        path: &Path,
        kind: SideKind<T>,
        files: Files,
        read: Reader<T>,
        mut notes: Vec<String>,
        unit: impl FnOnce(&Files) -> String,
    ) -> Self {
        let said = match &files {
            Files::Numbered(files) => {
                let extension =
                    |p: &PathBuf| p.extension().unwrap_or_default().to_string_lossy().to_uppercase();
                let mut kinds = BTreeMap::new();
                for p in files.values() {
                    *kinds.entry(extension(p)).or_insert(0) += 1;
                }
                let kinds: Vec<_> = kinds.iter().map(|(k, n)| format!("{n} {k}")).collect();
                format!("{} {}", kinds.join(" and "), if files.len() == 1 { "file" } else { "files" })
            }
            Files::One(_) => "one file, for every frame".into(),
        };
        notes.insert(0, format!("{}: {said}, {}", kind.what, unit(&files)));
        Self { path: path.into(), kind, files, read, notes, not_numbers: NotNumbers::default() }
    }

    /// The path of the folder, or of the single file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Notes for the user about the files that were found, a sentence each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// What is wrong with the files that were read so far, a sentence without a full stop: some pixels of colour or mattes may not be numbers
    /// (NaN), for which 0 is taken. Depth and flow are unknown there.
    pub fn warning(&self) -> Option<String> {
        self.not_numbers.in_words()
    }

    /// Whether there is a file for this frame.
    pub fn has(&self, number: u64) -> bool {
        self.file(number).is_some()
    }

    /// When the file for this frame was last changed; `None` if there is none, or the file system does not tell.
    pub fn changed(&self, number: u64) -> Option<SystemTime> {
        changed(self.file(number)?)
    }

    /// Reads the data of this frame; `None` if there is no file for the frame.
    ///
    /// # Errors
    /// If the file is damaged or of another kind, or its size is not `size`, the size of the frames, px.
    pub fn get(&self, number: u64, size: (usize, usize)) -> Result<Option<T>> {
        let Some(path) = self.file(number) else { return Ok(None) };
        let value = self.not_numbers.keep(path, (self.read)(path)?);
        let (width, height) = (self.kind.size_of)(&value);
        if (width, height) != size {
            let frames = format!("the frames are {} x {}", size.0, size.1);
            return Err(Error::new(
                path,
                format!(
                    "{} of frame {number}: {width} x {height} pixels, but {frames}; bring both to one size",
                    self.kind.what
                ),
            ));
        }
        Ok(Some(value))
    }

    fn file(&self, number: u64) -> Option<&Path> {
        match &self.files {
            Files::Numbered(files) => files.get(&number).map(PathBuf::as_path),
            Files::One(path) => Some(path),
        }
    }
}
