//! Frames in order, from a folder of numbered images, one image, a video or a camera.

use crate::{
    Error, ExrContents, ExrHead, FrameFormat, IccProfile, NamePattern, Reading, Result,
    coding::recoded,
    exr,
    files::{changed, check_regular, has_extension},
    image::{frame_size, has_colour, icc_profile},
    limits::is_exr,
    not_numbers::NotNumbers,
    side::Files,
    video::{Video, VideoFrames},
};
use blindaug::{
    Encoded, Frame, Transfer,
    colour_space::ColourSpace,
    text::{one_line, ranges_in_words},
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    str::FromStr,
    time::SystemTime,
};

/// Extensions of images that can be frames; an EXR file can be a frame too, if it has colour.
const IMAGE_EXTENSIONS: [&str; 7] = ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "ppm"];

/// A range of frame numbers, both ends included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameRange {
    /// The first number; `None` stands for the start.
    pub first: Option<u64>,
    /// The last number; `None` stands for the end.
    pub last: Option<u64>,
}

impl FrameRange {
    /// Whether the frame of this number is in the range.
    pub fn contains(&self, number: u64) -> bool {
        self.first.is_none_or(|f| f <= number) && self.last.is_none_or(|l| number <= l)
    }
}

impl FromStr for FrameRange {
    type Err = blindaug::Error;

    /// Reads `FIRST..LAST`, where either number may be left out.
    fn from_str(text: &str) -> std::result::Result<Self, Self::Err> {
        let fail = || {
            let form = "frames are given as FIRST..LAST, by number, both included (3..7, 3.. or ..7)";
            blindaug::Error::new(format!("\"{text}\": {form}"))
        };
        let number = |t: &str| match t.trim() {
            "" => Ok(None),
            t => t.parse().map(Some).map_err(|_| fail()),
        };
        let (first, last) = text.split_once("..").ok_or_else(fail)?;
        let range = Self { first: number(first)?, last: number(last)? };
        match range {
            Self { first: Some(f), last: Some(l) } if f > l => Err(fail()),
            range => Ok(range),
        }
    }
}

impl std::fmt::Display for FrameRange {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let text = |n: Option<u64>| n.map_or(String::new(), |n| n.to_string());
        write!(f, "{}..{}", text(self.first), text(self.last))
    }
}

/// The frames of an input, not yet read.
#[derive(Debug)]
pub struct FrameSource {
    path: PathBuf,
    range: FrameRange,
    size: (usize, usize),
    format: FrameFormat,
    space: ColourSpace,
    reading: Reading,
    kind: Kind,
    notes: Vec<String>,
    /// The ICC profile of the first image.
    profile: Option<IccProfile>,
    /// Why the colour space that the files tell is not known; no frame is read then.
    unread: Option<Error>,
    /// The images with pixels that are not numbers, of those that were read.
    not_numbers: NotNumbers,
}

#[derive(Debug)]
enum Kind {
    /// The numbers and paths of the images, in the order of the numbers: those in the range, and at most one on each side of it.
    Images { files: Vec<(u64, PathBuf)>, before: Option<(u64, PathBuf)>, after: Option<(u64, PathBuf)> },
    /// A video, and the number of its first frame.
    Video(Box<Video>, u64),
}

impl FrameSource {
    /// Opens a folder of numbered images, one image, or a video, of which the frames in `range` are used.
    ///
    /// In a folder that holds several kinds side by side, the frames are the images with colour (an EXR with `R G B`
    /// counts where no other image has its number).
    ///
    /// # Errors
    /// If the path does not exist, the range has no frame, two frames have the same number, or the first frame is damaged. An ICC profile that is not
    /// known is an error only when frames are read whose colour space was not said ([`FrameSource::in_space`]).
    pub fn open(path: impl AsRef<Path>, range: FrameRange) -> Result<Self> {
        Self::open_from(path, range, None)
    }

    /// [`FrameSource::open`], with a number for the input's first frame, from which the others are counted on: 1001, where a video belongs to
    /// layers that begin there. Without it frames have the numbers in their names, and those of a video begin with 1.
    ///
    /// # Errors
    /// The same as [`FrameSource::open`].
    pub fn open_from(path: impl AsRef<Path>, range: FrameRange, first: Option<u64>) -> Result<Self> {
        let path = path.as_ref();
        let mut notes = Vec::new();
        let numbered = |files: Vec<(u64, PathBuf)>| {
            let lowest = files.first().map_or(0, |f| f.0);
            let begin = first.unwrap_or(lowest);
            files.into_iter().map(|(n, path)| (begin.saturating_add(n - lowest), path)).collect::<Vec<_>>()
        };
        let files = match NamePattern::of(path) {
            Some(pattern) => Some(pattern.files()?.into_iter().collect()),
            None if path.is_dir() => Some(frame_files(path, &mut notes)?),
            None => None,
        };
        if let Some(files) = files {
            return Self::of_images(path, numbered(files), range, notes);
        }
        let metadata = path.metadata().map_err(|e| Error::cannot_read(path, &e))?;
        check_regular(path, &metadata)?;
        let is_image = has_extension(path, &IMAGE_EXTENSIONS)
            || has_extension(path, &["exr", "pgm", "pnm"])
            || is_exr(path)?;
        if is_image {
            let number = number_of(path).unwrap_or(1);
            return Self::of_images(path, numbered(vec![(number, path.into())]), range, notes);
        }
        let video = Video::open(path)?;
        let begin = first.unwrap_or(1);
        if range.last.is_some_and(|last| last < begin) {
            return Err(Error::new(
                path,
                format!("no frame in {range} (the video's first frame is {begin})"),
            ));
        }
        let end = video.len_hint().map(|n| begin.saturating_add(n as u64) - 1);
        if let Some(end) = end.filter(|&end| range.last.is_some_and(|last| last > end)) {
            notes.push(format!("{range} reaches beyond its frames, which are about {begin} to {end}"));
        }
        notes.extend(video.notes().iter().cloned());
        let (size, format, space) = (video.size(), FrameFormat::of_video(video.bits()), video.space());
        let kind = Kind::Video(Box::new(video), begin);
        let reading = Reading { transfer: space.transfer.worked_on(), ..Reading::default() };
        Ok(Self::new(path, (range, size, format), (space, reading), kind, notes))
    }

    /// The images, in the order of their numbers, that are in the range.
    fn of_images(
        path: &Path,
        mut files: Vec<(u64, PathBuf)>,
        range: FrameRange,
        mut notes: Vec<String>,
    ) -> Result<Self> {
        let all: Vec<u64> = files.iter().map(|f| f.0).collect();
        let before =
            files.iter().rfind(|(number, _)| range.first.is_some_and(|first| *number < first)).cloned();
        let after = files.iter().find(|(number, _)| range.last.is_some_and(|last| *number > last)).cloned();
        files.retain(|(number, _)| range.contains(*number));
        let Some((_, first)) = files.first() else {
            let have = match all[..] {
                [only] => format!("this one image is number {only}"),
                [low, .., high] => format!("its frames are {low} to {high}"),
                [] => "it has none".into(),
            };
            return Err(Error::new(path, format!("no frame in {range} ({have})")));
        };
        notes.extend(missing_numbers(files.iter().map(|f| f.0)));
        let (low, high) = (all.iter().min(), all.iter().max());
        let beyond = range.first.is_some_and(|first| low.is_some_and(|low| first < *low))
            || range.last.is_some_and(|last| high.is_some_and(|high| last > *high));
        if let (true, Some(low), Some(high)) = (beyond, low, high) {
            notes.push(format!("{range} reaches beyond its frames, which are {low} to {high}"));
        }
        let (size, format) = (frame_size(first)?, FrameFormat::of_file(first)?);
        let icc = if format.is_exr() { None } else { icc_profile(first)? };
        let (profile, told) = match icc.map(|bytes| IccProfile::of(first, &bytes)) {
            None => (None, Reading::default().space_of(first)),
            Some(Ok(profile)) => (Some(profile.clone()), profile.space(first)),
            Some(Err(damaged)) => (None, Err(damaged)),
        };
        let (space, unread) = match told {
            Ok(space) => (space, None),
            Err(e) => (ColourSpace::SRGB, Some(e)),
        };
        let reading = Reading { transfer: space.transfer.worked_on(), ..Reading::default() };
        let reading = if format.is_exr() { reading } else { Reading { integers: space, ..reading } };
        let kind = Kind::Images { files, before, after };
        let source = Self::new(path, (range, size, format), (space, reading), kind, notes);
        Ok(Self { profile, unread, ..source })
    }

    fn new(
        path: &Path,
        (range, size, format): (FrameRange, (usize, usize), FrameFormat),
        (space, reading): (ColourSpace, Reading),
        kind: Kind,
        notes: Vec<String>,
    ) -> Self {
        let (path, profile, unread, not_numbers) = (path.into(), None, None, NotNumbers::default());
        Self { path, range, size, format, space, reading, kind, notes, profile, unread, not_numbers }
    }

    /// Opens a camera: `name` is its number, or the name by which ffmpeg lists it (on Windows always the name). Its frames have no end.
    ///
    /// # Errors
    /// If there is no such camera, the camera is in use, or there is no ffmpeg program.
    pub fn camera(name: &str) -> Result<Self> {
        let path = PathBuf::from(format!("camera:{name}"));
        let video = Video::open_camera(&path, name)?;
        let (size, notes) = (video.size(), video.notes().to_vec());
        let (space, reading) = (video.space(), Reading::default());
        let kind = Kind::Video(Box::new(video), 1);
        let (range, format) = (FrameRange::default(), FrameFormat::PNG8);
        Ok(Self::new(&path, (range, size, format), (space, reading), kind, notes))
    }

    /// The same frames, whose files are in this colour space whatever they say themselves.
    pub fn in_space(self, space: ColourSpace) -> Self {
        let transfer = space.transfer.worked_on();
        let reading = Reading { exr: Some(space), integers: space, transfer, ..self.reading };
        Self { space, reading, unread: None, ..self }
    }

    /// The same frames, encoded by this curve whatever their files are encoded by.
    pub fn encoded_as(self, transfer: Transfer) -> Self {
        Self { reading: Reading { transfer, ..self.reading }, ..self }
    }

    /// The same frames, with the light below 0 that EXR files may hold.
    pub fn with_light_below_zero(self) -> Self {
        Self { reading: Reading { below_zero: true, ..self.reading }, ..self }
    }

    /// The ICC profile of the first image, if it has one that is whole.
    pub fn profile(&self) -> Option<&IccProfile> {
        self.profile.as_ref()
    }

    /// The colour space of the files' values: what they say, or what was said in its place.
    pub fn file_space(&self) -> ColourSpace {
        self.space
    }

    /// The colour space of the frames. Light is encoded as sRGB, all else by the files' own curve; the primaries are those of the files.
    pub fn space(&self) -> ColourSpace {
        ColourSpace { transfer: self.reading.transfer, ..self.space }
    }

    /// How images of the same views are read, so that they compare with the frames: EXR as light or as the frames' files are, others in the
    /// frames' own colour space.
    pub fn reading(&self) -> Reading {
        let integers =
            if self.space.transfer == Transfer::Linear { self.reading.integers } else { self.space };
        Reading { integers, ..self.reading }
    }

    /// When the file of the frame of this number was last changed; `None` if there is none, or the file system does not tell.
    pub fn changed(&self, number: u64) -> Option<SystemTime> {
        let path = match &self.kind {
            Kind::Video(..) => &self.path,
            Kind::Images { files, before, after } => {
                let own = files.binary_search_by_key(&number, |f| f.0).ok().map(|i| &files[i]);
                let beside = || before.iter().chain(after).find(|f| f.0 == number);
                &own.or_else(beside)?.1
            }
        };
        changed(path)
    }

    /// The path of the file or folder, or `camera:` and the camera's name.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Width and height of every frame, px.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// The format in which frames that are made from these are written: as precise as the first frame's file, see [`FrameFormat`]. Frames of
    /// a video become PNG, of 16 bits if the video has more than 8.
    pub fn format(&self) -> FrameFormat {
        self.format
    }

    /// The kinds of channels in the first frame's file, if that is an EXR file.
    fn exr_contents(&self) -> Option<ExrContents> {
        match &self.kind {
            Kind::Images { files, .. } if self.format.is_exr() => {
                files.first().and_then(|(_, first)| crate::exr_contents(first).ok())
            }
            _ => None,
        }
    }

    /// The heads of the frames' files, if they are EXR files.
    pub fn heads(&self) -> impl Fn(u64) -> Option<ExrHead> + Send + use<> {
        self.heads_by(|path| ExrHead::read(path))
    }

    /// The heads of the frames' files, if they are EXR files, with the colour that the files have beyond the frames: it is written, as it is, into
    /// the EXR files that get these heads.
    pub fn heads_with_overscan(&self) -> impl Fn(u64) -> Option<ExrHead> + Send + use<> {
        let space = self.space;
        self.heads_by(move |path| ExrHead::read_with_overscan(path, space))
    }

    fn heads_by<R>(&self, read: R) -> impl Fn(u64) -> Option<ExrHead> + Send + use<R>
    where
        R: Fn(&Path) -> Result<ExrHead> + Send,
    {
        let files = self.exr_images().unwrap_or_default();
        // A file without a head that can be read is no frame, which is said when it is read as one.
        move |number| read(files.get(&number)?).ok()
    }

    /// The images of the range, and those next to it, by their numbers; `None` if they are no EXR files.
    fn exr_images(&self) -> Option<BTreeMap<u64, PathBuf>> {
        match &self.kind {
            Kind::Images { files, before, after } if self.format.is_exr() => {
                Some(before.iter().chain(files).chain(after).cloned().collect())
            }
            _ => None,
        }
    }

    /// The EXR files of the frames, for what they hold beside the frames; `None` unless the first of them holds it.
    pub(crate) fn exr_files(&self, holds: impl FnOnce(ExrContents) -> bool) -> Option<Files> {
        holds(self.exr_contents()?).then(|| self.exr_images().map(Files::Numbered))?
    }

    /// The width of a pixel over its height, as the picture is shown, if the head of the first EXR file or of a video tells it. (The built-in
    /// decoder of videos does not read it.)
    pub fn pixel_aspect(&self) -> Option<f32> {
        match &self.kind {
            Kind::Images { .. } => self.first_head().map(|head| head.pixel_aspect()),
            Kind::Video(v, _) => v.pixel_aspect(),
        }
    }

    /// Whether the frames are those of a video or a camera rather than images.
    pub fn is_video(&self) -> bool {
        matches!(self.kind, Kind::Video(..))
    }

    /// The head of the first file if it is an EXR file.
    fn first_head(&self) -> Option<ExrHead> {
        match &self.kind {
            Kind::Images { files, .. } if self.format.is_exr() => ExrHead::read(&files.first()?.1).ok(),
            _ => None,
        }
    }

    /// Frames per second, if the head of a video or of the first EXR file gives them; other images do not.
    pub fn fps(&self) -> Option<f64> {
        match &self.kind {
            Kind::Images { .. } => self.first_head()?.fps(),
            Kind::Video(v, _) => v.fps(),
        }
    }

    /// The number of frames in the range; for a video the number that its head gives, if any.
    pub fn len_hint(&self) -> Option<usize> {
        match &self.kind {
            Kind::Images { files, .. } => Some(files.len()),
            Kind::Video(v, begin) => v.len_hint().map(|n| {
                let end = begin.saturating_add(n as u64);
                let last = self.range.last.map_or(end, |last| last.saturating_add(1)).min(end);
                last.saturating_sub(self.range.first.map_or(*begin, |first| first.max(*begin))) as usize
            }),
        }
    }

    /// The number of the first frame in the range, if the input has it.
    pub fn first_number(&self) -> u64 {
        match &self.kind {
            Kind::Images { files, .. } => files.first().map_or(1, |f| f.0),
            Kind::Video(_, begin) => self.range.first.map_or(*begin, |first| first.max(*begin)),
        }
    }

    /// Notes for the user about the input (missing numbers, which of two kinds was taken), a sentence each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// What is wrong with the frames that were read so far, a sentence without a full stop: some of their pixels may not be numbers (NaN), for
    /// which 0 is taken.
    pub fn warning(&self) -> Option<String> {
        self.not_numbers.in_words()
    }

    /// The frames from the first one on, each read when it is asked for. This can be called again for another pass.
    pub fn frames(&self) -> Frames<'_> {
        self.frames_if(|_| true)
    }

    /// The frames for whose number `wanted` holds; the image files of other frames are not read.
    pub fn frames_if<'a>(&'a self, wanted: impl Fn(u64) -> bool + Send + 'a) -> Frames<'a> {
        self.frames_of(false, Box::new(wanted))
    }

    /// [`FrameSource::frames_if`], and besides the input's frames next to the range, one on each side of it, if they are wanted: what is made
    /// of a part of a clip with the help of a frame's neighbours is then what is made of the whole clip.
    pub fn frames_and_beside<'a>(&'a self, wanted: impl Fn(u64) -> bool + Send + 'a) -> Frames<'a> {
        self.frames_of(true, Box::new(wanted))
    }

    fn frames_of<'a>(&'a self, beside: bool, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a> {
        Frames { source: self, beside, wanted, next: 0, video: None, ended: false }
    }

    /// Whether the range contains this number.
    pub fn contains(&self, number: u64) -> bool {
        self.range.contains(number)
    }
}

/// The frames of a [`FrameSource`], in order. After an error there are no more frames.
pub struct Frames<'a> {
    source: &'a FrameSource,
    /// Whether the frames next to the range are given, too.
    beside: bool,
    wanted: Box<dyn Fn(u64) -> bool + Send + 'a>,
    /// Index of the next file, or number of frames decoded from the video.
    next: usize,
    video: Option<VideoFrames>,
    ended: bool,
}

impl Iterator for Frames<'_> {
    type Item = Result<Frame>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        if let Some(e) = &self.source.unread {
            self.ended = true;
            return Some(Err(e.clone()));
        }
        let frame = match &self.source.kind {
            Kind::Images { files, before, after } => {
                let beside = self.beside;
                let [before, after] = [before, after].map(|file| file.iter().filter(move |_| beside));
                self.next_image(before.chain(files).chain(after))
            }
            Kind::Video(video, begin) => self.next_video_frame(video, *begin),
        };
        self.ended = !matches!(frame, Some(Ok(_)));
        frame
    }
}

impl Frames<'_> {
    fn next_image<'f>(&mut self, files: impl Iterator<Item = &'f (u64, PathBuf)>) -> Option<Result<Frame>> {
        let mut files = files.skip(self.next);
        let (number, path) = loop {
            let (number, path) = files.next()?;
            self.next += 1;
            if (self.wanted)(*number) {
                break (*number, path);
            }
        };
        let read = self.source.reading.read_counted(path);
        Some(read.and_then(|read| self.checked(path, number, self.source.not_numbers.keep(path, read))))
    }

    fn next_video_frame(&mut self, video: &Video, begin: u64) -> Option<Result<Frame>> {
        loop {
            let number = begin.saturating_add(self.next as u64);
            let range = self.read_range();
            if range.last.is_some_and(|last| number > last) {
                return None;
            }
            if self.video.is_none() {
                match video.frames() {
                    Ok(frames) => self.video = Some(frames),
                    Err(e) => return Some(Err(e)),
                }
            }
            let next = self.video.as_mut()?.next_frame();
            self.next += 1;
            match next {
                Ok(None) => {
                    // The number of frames of a video is known only at its end.
                    let range = self.source.range;
                    let first = range.first.unwrap_or(begin);
                    return (number <= first && !range.contains(number - 1)).then(|| {
                        let have = match begin {
                            1 => format!("the video has {} frames", number - 1),
                            _ => format!("the video's frames are {begin} to {}", number - 1),
                        };
                        Err(Error::new(&self.source.path, format!("no frame in {range} ({have})")))
                    });
                }
                Ok(Some(frame)) if range.contains(number) && (self.wanted)(number) => {
                    let FrameSource { path, space, reading, .. } = self.source;
                    let image = recoded(video.encoded(&frame), space.transfer, reading.transfer);
                    return Some(self.checked(path, number, image));
                }
                Ok(Some(_)) => {}
                Err(e) => return Some(Err(e)),
            }
        }
    }

    /// The numbers of the frames that are given if they are wanted.
    fn read_range(&self) -> FrameRange {
        let FrameRange { first, last } = self.source.range;
        let wider = u64::from(self.beside);
        FrameRange {
            first: first.map(|n| n.saturating_sub(wider)),
            last: last.map(|n| n.saturating_add(wider)),
        }
    }

    fn checked(&self, path: &Path, number: u64, image: Encoded) -> Result<Frame> {
        let ((w, h), (first_w, first_h)) = (image.0.size(), self.source.size);
        if (w, h) != (first_w, first_h) {
            return Err(Error::new(
                path,
                format!(
                    "frame {number} is {w} x {h} pixels, but the first frame is {first_w} x {first_h}; all must have one size"
                ),
            ));
        }
        Ok(Frame { number, image })
    }
}

/// The last number in the file's name, without its extension.
pub(crate) fn number_of(path: &Path) -> Option<u64> {
    let stem = path.file_stem()?.to_str()?;
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end].rfind(|c: char| !c.is_ascii_digit()).map_or(0, |i| {
        // The character before the number may be longer than a byte.
        i + stem[i..].chars().next().map_or(1, char::len_utf8)
    });
    stem[start..end].parse().ok()
}

/// The files of a folder with one of these extensions, in the order of their names, without hidden ones.
fn files_with_extension(folder: &Path, extensions: &[&str]) -> Result<Vec<PathBuf>> {
    let fail = |e: std::io::Error| Error::cannot_read(folder, &e);
    let mut files = Vec::new();
    for entry in folder.read_dir().map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let hidden = path.file_name().is_some_and(|n| n.as_encoded_bytes().starts_with(b"."));
        if !hidden && has_extension(&path, extensions) && path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// The files of a folder with one of these extensions, by number. Hidden files are left out; files without a number
/// too, with a note, unless there is only one file (which then is number 1).
///
/// # Errors
/// If the folder cannot be read, two of the files have the same number, or there are several and none has a number.
pub(crate) fn numbered_files(
    folder: &Path,
    extensions: &[&str],
    notes: &mut Vec<String>,
) -> Result<BTreeMap<u64, PathBuf>> {
    by_number(folder, files_with_extension(folder, extensions)?, notes)
}

/// Sorts these files by number, as [`numbered_files`] does.
fn by_number(folder: &Path, files: Vec<PathBuf>, notes: &mut Vec<String>) -> Result<BTreeMap<u64, PathBuf>> {
    if let [only] = &files[..] {
        return Ok([(number_of(only).unwrap_or(1), only.clone())].into());
    }
    let name = |p: &Path| one_line(&p.file_name().unwrap_or_default().to_string_lossy());
    let mut numbered = BTreeMap::<u64, PathBuf>::new();
    let mut unnumbered = Vec::new();
    for path in files {
        let Some(number) = number_of(&path) else {
            unnumbered.push(path);
            continue;
        };
        if let Some(other) = numbered.get(&number) {
            let (a, b) = (name(other), name(&path));
            return Err(Error::new(
                folder,
                format!(
                    "{a} and {b} both have the number {number}; the last number in a name must be the frame's own"
                ),
            ));
        }
        numbered.insert(number, path);
    }
    match (unnumbered.first(), numbered.is_empty()) {
        (Some(first), true) => {
            let what = "its files have no numbers in their names";
            return Err(Error::new(
                folder,
                format!("{what} ({} and others); name them 0001.png and so on", name(first)),
            ));
        }
        (Some(first), false) => {
            let others = match unnumbered.len() - 1 {
                0 => String::new(),
                n => format!(" (and {n} more)"),
            };
            notes.push(format!("{}{others} has no number in its name and is left out", name(first)));
        }
        (None, _) => {}
    }
    Ok(numbered)
}

/// The images with colour of a folder, in the order of their numbers.
///
/// # Errors
/// The same as [`numbered_files`], or if there are no images.
pub(crate) fn frame_files(folder: &Path, notes: &mut Vec<String>) -> Result<Vec<(u64, PathBuf)>> {
    let files = without_grey_kinds(files_with_extension(folder, &IMAGE_EXTENSIONS)?, notes)?;
    let mut frames = by_number(folder, files, notes)?;
    let exrs = numbered_files(folder, &["exr"], notes)?;
    let mut without_colour = 0;
    let mut both_seen = false;
    for (number, path) in exrs {
        match frames.get(&number) {
            None if exr::exr_contents(&path)?.colour => {
                frames.insert(number, path);
            }
            None => without_colour += 1,
            // Only the first file is looked at, since the files of a clip are alike.
            Some(_) if both_seen => {}
            Some(frame) => {
                both_seen = true;
                if exr::exr_contents(&path)?.colour {
                    let used = frame.extension().unwrap_or_default().to_string_lossy().to_uppercase();
                    notes.push(format!(
                        "frame {number} is there as EXR as well; the {used} is used where there are both"
                    ));
                }
            }
        }
    }
    if frames.is_empty() {
        let exr = match without_colour {
            0 => String::new(),
            n => format!("; its {n} EXR files have no channels R, G and B"),
        };
        let kinds = "PNG, JPEG, TIFF, BMP, PPM or EXR";
        return Err(Error::new(folder, format!("the folder has no images ({kinds}){exr}")));
    }
    Ok(frames.into_iter().collect())
}

/// Leaves out a kind of files without colour (depth maps) if files of another kind have the same numbers.
fn without_grey_kinds(files: Vec<PathBuf>, notes: &mut Vec<String>) -> Result<Vec<PathBuf>> {
    let kind = |p: &Path| p.extension().unwrap_or_default().to_string_lossy().to_uppercase();
    let mut kinds = BTreeMap::<String, Vec<PathBuf>>::new();
    for file in &files {
        kinds.entry(kind(file)).or_default().push(file.clone());
    }
    let mut numbers: Vec<u64> = files.iter().filter_map(|f| number_of(f)).collect();
    numbers.sort_unstable();
    if kinds.len() < 2 || numbers.windows(2).all(|n| n[0] != n[1]) {
        return Ok(files);
    }
    let mut with_colour = Vec::new();
    for (kind, files) in kinds {
        // Only the first file is looked at, since the files of a clip are alike.
        if has_colour(&files[0])? {
            with_colour.extend(files);
        } else {
            notes.push(format!(
                "the {} {kind} files have no colour and are not taken for frames",
                files.len()
            ));
        }
    }
    Ok(if with_colour.is_empty() { files } else { with_colour })
}

/// A note for the user about the gaps in ascending numbers, if there are any.
fn missing_numbers(numbers: impl Iterator<Item = u64>) -> Option<String> {
    let (mut gaps, mut last) = (Vec::new(), None::<u64>);
    for n in numbers {
        if let Some(l) = last.filter(|l| n - l > 1) {
            gaps.push((l + 1, n - 1));
        }
        last = Some(n);
    }
    match gaps[..] {
        [] => None,
        [(first, last)] if first == last => Some(format!("frame {first} is missing")),
        _ => Some(format!("frames {} are missing", ranges_in_words(&gaps))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_last_in_names() {
        for (name, number) in [
            ("0001.png", Some(1)),
            ("IMG_2024_0012.jpg", Some(12)),
            ("take2_10b.png", Some(10)),
            ("größe7é.png", Some(7)),
            ("é12.png", Some(12)),
            ("frame.png", None),
            ("99999999999999999999999.png", None),
            ("shot.0042.exr", Some(42)),
        ] {
            assert_eq!(number_of(Path::new(name)), number, "{name}");
        }
    }

    #[test]
    fn gaps_are_told() {
        let told = |n: &[u64]| missing_numbers(n.iter().copied());
        assert_eq!(told(&[1, 2, 3]), None);
        assert_eq!(told(&[]), None);
        assert_eq!(told(&[1, 3]).unwrap(), "frame 2 is missing");
        assert_eq!(told(&[3, 5, 6, 10]).unwrap(), "frames 4, 7 to 9 are missing");
        assert_eq!(
            told(&[0, 2, 4, 6, 8, 10, 12]).unwrap(),
            "frames 1, 3, 5, 7, 9, ... (6 in all) are missing"
        );
    }

    #[test]
    fn ranges_are_parsed() {
        let parse = |t: &str| t.parse::<FrameRange>();
        assert_eq!(parse("3..7").unwrap(), FrameRange { first: Some(3), last: Some(7) });
        assert_eq!(parse("..7").unwrap(), FrameRange { first: None, last: Some(7) });
        assert_eq!(parse("..").unwrap(), FrameRange::default());
        assert!(parse("3..7").unwrap().contains(7) && !parse("3..7").unwrap().contains(8));
        for bad in ["", "5", "7..3", "a..b", "-1..3", "1...3", "1..99999999999999999999"] {
            assert!(parse(bad).unwrap_err().to_string().contains("FIRST..LAST"), "{bad}");
        }
    }
}
