//! What is handed in as footage: a file, a folder, an array, a sequence or an iterator; and what belongs to its frames.

use crate::{
    failure::{self, of},
    listener::{Listener, Raised},
    pixels,
};
use blindaug::{
    Encoded, Frame, Transfer,
    colour_space::{ColourSpace, doubts},
    model::FRAME_RATES,
};
use blindaug_io::{FrameRange, FrameSource, Reading, SideFolder, memory};
use blindaug_pipeline::{BoxedSide, Clip, Observer, Result, Side, footage::Frames};
use numpy::{PyUntypedArray, PyUntypedArrayMethods};
use pyo3::{
    prelude::*,
    types::{PyDict, PyIterator},
};
use std::{
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

/// The path, if a path is what was handed in.
pub fn path(value: &Bound<'_, PyAny>) -> Option<PathBuf> {
    value.extract().ok()
}

/// What is said of footage.
#[derive(Default)]
pub struct Said<'py> {
    /// The first and the last frame of a file or folder that are used, by number.
    pub frames: Option<(Option<u64>, Option<u64>)>,
    /// The colour space of the frames.
    pub colour_space: Option<&'py str>,
    /// Frames per second.
    pub fps: Option<f64>,
}

/// Frames from files or from Python.
pub enum Footage {
    /// A video, one image, or a folder of images.
    Files(Box<FrameSource>),
    /// An array, a sequence or an iterator.
    Python(PythonClip),
}

/// Fails if this is no frame rate.
pub fn check_fps(fps: Option<f64>) -> PyResult<()> {
    match fps.is_none_or(|fps| FRAME_RATES.contains(&fps)) {
        true => Ok(()),
        false => Err(of("fps", "must be a number from 0.01 to 100000")),
    }
}

impl Footage {
    /// Opens what was handed in.
    pub fn open(value: &Bound<'_, PyAny>, said: &Said, listener: &Listener) -> PyResult<Self> {
        let space = said.colour_space.map(|name| pixels::colour_space(name, "colour_space")).transpose()?;
        check_fps(said.fps)?;
        let Some(path) = path(value) else {
            if said.frames.is_some() {
                return Err(of("frames", "is for files and folders: hand in the frames that are wanted"));
            }
            let space = space.unwrap_or(ColourSpace::SRGB);
            return PythonClip::new(value, space, said.fps, listener.raised.clone()).map(Self::Python);
        };
        let (first, last) = said.frames.unwrap_or_default();
        if first.zip(last).is_some_and(|(first, last)| first > last) {
            return Err(of("frames", "must be the first and the last number, in this order"));
        }
        let source = FrameSource::open(&path, FrameRange { first, last }).map_err(failure::of_file)?;
        source.notes().iter().for_each(|sentence| listener.note(&format!("{}: {sentence}", shown(&path))));
        let source = match space {
            Some(space) => source.in_space(space),
            None => source,
        };
        if space.is_some() || source.format().is_exr() {
            let first = value.py().detach(|| source.frames().next().transpose()).map_err(failure::of_file)?;
            if let Some(doubt) = first.and_then(|f| doubts(&source.space(), &source.file_space(), &f.image)) {
                listener.warning(&format!("{}: {doubt}", shown(&path)));
            }
        }
        Ok(Self::Files(Box::new(source)))
    }

    /// The clip.
    pub fn clip(&self) -> &dyn Clip {
        match self {
            Self::Files(source) => &**source,
            Self::Python(clip) => clip,
        }
    }

    /// The clip, boxed.
    pub fn boxed(self) -> Box<dyn Clip> {
        match self {
            Self::Files(source) => source,
            Self::Python(clip) => Box::new(clip),
        }
    }

    /// The curve of the frames.
    pub fn transfer(&self) -> Transfer {
        match self {
            Self::Files(source) => source.space().transfer,
            Self::Python(clip) => clip.transfer(),
        }
    }

    /// The number of the first frame.
    pub fn first_number(&self) -> u64 {
        match self {
            Self::Files(source) => source.first_number(),
            Self::Python(_) => 1,
        }
    }

    /// How files of the same views are read.
    pub fn reading(&self) -> Reading {
        match self {
            Self::Files(source) => source.reading(),
            Self::Python(clip) => {
                let integers =
                    if clip.space.transfer == Transfer::Linear { ColourSpace::SRGB } else { clip.space };
                Reading { integers, transfer: clip.transfer(), ..Reading::default() }
            }
        }
    }

    /// The space of arrays of the same views.
    pub fn space(&self) -> ColourSpace {
        match self {
            Self::Files(source) => source.space(),
            Self::Python(clip) => clip.space,
        }
    }
}

/// Whether a value has a length and indices, as arrays, lists, and datasets in files do.
fn has_items(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(value.hasattr("__getitem__")? && value.hasattr("__len__")?)
}

fn shown(path: &Path) -> String {
    blindaug_io::Error::shown_path(path)
}

/// Frames that Python holds or makes, numbered from 1 on.
pub struct PythonClip {
    supply: Supply,
    size: (usize, usize),
    fps: Option<f64>,
    space: ColourSpace,
    raised: Raised,
}

enum Supply {
    /// Something with a length and indices, and its length.
    Items(Py<PyAny>, usize),
    /// An iterator, whose first frame was taken to know the size; `None` once that is used.
    Iterator(Py<PyIterator>, Mutex<Option<Encoded>>),
}

impl PythonClip {
    fn new(value: &Bound<'_, PyAny>, space: ColourSpace, fps: Option<f64>, raised: Raised) -> PyResult<Self> {
        const NAME: &str = "footage";
        if let Ok(array) = value.cast::<PyUntypedArray>() {
            let why = match array.shape() {
                [_, _, _, _] => None,
                [_, _, 3] => Some("one frame; hand in a[None]"),
                _ => Some("none"),
            };
            if let Some(why) = why {
                let shape = array.shape();
                return Err(of(
                    NAME,
                    format!("has the shape {shape:?}, and frames have (T, H, W, 3); this is {why}"),
                ));
            }
        }
        let kind = value.get_type().name()?.to_string();
        let of_kind = || {
            of(
                NAME,
                format!(
                    "must be a path, an array (T, H, W, 3) or frames one after another, and is of type {kind}"
                ),
            )
        };
        if value.cast::<PyDict>().is_ok() {
            return Err(of_kind());
        }
        let none = || of(NAME, "there is no frame in it");
        let clip = |supply, first: &Encoded| Self { supply, size: first.0.size(), fps, space, raised };
        let read = |value: &Bound<'_, PyAny>| {
            pixels::frame(value, &frame_name(1), (space, space.transfer.worked_on()), false).map(|f| f.0)
        };
        if has_items(value)? {
            let len = value.len()?;
            if len == 0 {
                return Err(none());
            }
            let first = read(&value.get_item(0)?)?;
            return Ok(clip(Supply::Items(value.clone().unbind(), len), &first));
        }
        let mut iterator = value.try_iter().map_err(|_| of_kind())?;
        let first = read(&iterator.next().ok_or_else(none)??)?;
        let supply = |first: &Encoded| Supply::Iterator(iterator.unbind(), Mutex::new(Some(first.clone())));
        Ok(clip(supply(&first), &first))
    }

    fn transfer(&self) -> Transfer {
        self.space.transfer.worked_on()
    }

    /// The frame of this number, from 1 on; `None` after the last one. An iterator gives its frames in order, whatever the number.
    pub fn frame(&self, py: Python<'_>, number: u64) -> PyResult<Option<Frame>> {
        let read = |value: &Bound<'_, PyAny>| -> PyResult<Option<Frame>> {
            let (image, _) = pixels::frame(value, &frame_name(number), (self.space, self.transfer()), false)?;
            if image.0.size() != self.size {
                let ((w, h), (width, height)) = (image.0.size(), self.size);
                return Err(of(
                    &frame_name(number),
                    format!("has {w} x {h} pixels, but the first has {width} x {height}"),
                ));
            }
            Ok(Some(Frame { number, image }))
        };
        match &self.supply {
            Supply::Items(_, len) if number > *len as u64 => Ok(None),
            Supply::Items(items, _) => read(&items.bind(py).get_item(number - 1)?),
            Supply::Iterator(iterator, first) => {
                if let Some(image) = first.lock().unwrap_or_else(PoisonError::into_inner).take() {
                    return Ok(Some(Frame { number, image }));
                }
                match iterator.bind(py).clone().next() {
                    Some(value) => read(&value?),
                    None => Ok(None),
                }
            }
        }
    }
}

fn frame_name(number: u64) -> String {
    format!("footage: frame {number}")
}

impl Clip for PythonClip {
    fn name(&self) -> String {
        "footage".into()
    }

    fn size(&self) -> (usize, usize) {
        self.size
    }

    fn fps(&self) -> Option<f64> {
        self.fps
    }

    fn len_hint(&self) -> Option<usize> {
        match self.supply {
            Supply::Items(_, len) => Some(len),
            Supply::Iterator(..) => None,
        }
    }

    fn reads_ahead(&self) -> bool {
        false
    }

    fn frames_if<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a> {
        let mut number = 0;
        Box::new(std::iter::from_fn(move || {
            loop {
                number += 1;
                let is_wanted = wanted(number);
                match self.supply {
                    Supply::Items(_, len) if number > len as u64 => return None,
                    Supply::Items(..) if !is_wanted => continue,
                    _ => {}
                }
                match Python::attach(|py| self.frame(py, number)).map_err(|e| self.raised.keep(e)) {
                    Ok(Some(_)) if !is_wanted => {}
                    frame => return frame.transpose(),
                }
            }
        }))
    }

    fn any_number(&self, wanted: &(dyn Fn(u64) -> bool + Sync)) -> Result<bool> {
        /// The number of an iterator's frames is not known, but hardly higher.
        const MOST: u64 = 1 << 20;
        Ok((1..=self.len_hint().map_or(MOST, |n| n as u64)).any(wanted))
    }

    fn check_memory(&self, what: &str, bytes: u64) -> Result<()> {
        Ok(memory::fits(Path::new("footage"), what, bytes)?)
    }
}

/// Reads what belongs to a frame, given its name in messages and the frame's size.
pub type Reader<T> = Box<dyn Fn(&Bound<'_, PyAny>, &str, (usize, usize)) -> PyResult<T> + Send + Sync>;

/// What belongs to frames, from files or from Python.
pub enum Beside<T> {
    /// A folder, or a file for all frames.
    Files(SideFolder<T>),
    /// An array or a sequence.
    Python(PythonSide<T>),
}

impl<T> Beside<T> {
    /// The files, if these are such.
    pub fn files(&self) -> Option<&dyn Side<T>> {
        match self {
            Self::Files(files) => Some(files),
            Self::Python(_) => None,
        }
    }
}

/// Arrays that belong to frames.
pub struct PythonSide<T> {
    name: &'static str,
    items: Items,
    read: Reader<T>,
    raised: Raised,
}

enum Items {
    /// An array for every frame.
    Every(Py<PyAny>),
    /// The number of the first frame, and an array for each frame from there on; `false` where there is none.
    Each(u64, Py<PyAny>, Vec<bool>),
}

impl<T: 'static> Beside<T> {
    /// Opens what belongs to the frames of some footage. `axes` is the number of axes of the array of one frame.
    pub fn open(
        value: Option<&Bound<'_, PyAny>>,
        (name, axes): (&'static str, usize),
        footage: &Footage,
        folder: impl FnOnce(&Path) -> blindaug_io::Result<SideFolder<T>>,
        read: Reader<T>,
        listener: &Listener,
    ) -> PyResult<Option<Self>> {
        let Some(value) = value else { return Ok(None) };
        if let Some(path) = path(value) {
            let folder = folder(&path).map_err(failure::of_file)?;
            folder
                .notes()
                .iter()
                .for_each(|sentence| listener.note(&format!("{}: {sentence}", shown(&path))));
            return Ok(Some(Self::Files(folder)));
        }
        let fail = |why: String| Err(of(name, why));
        let array = value.cast::<PyUntypedArray>().ok();
        let items = match array.map(|a| a.ndim()) {
            Some(n) if n == axes => Items::Every(value.clone().unbind()),
            Some(n) if n != axes + 1 => {
                return fail(format!(
                    "has {n} axes, and must have {axes} (for all frames) or {} (the frames first)",
                    axes + 1
                ));
            }
            _ => {
                if !has_items(value)? || value.cast::<PyDict>().is_ok() {
                    let kind = value.get_type().name()?;
                    return fail(format!(
                        "must be a path, an array, or a list with an array or None for each frame, and is of type {kind}"
                    ));
                }
                let len = value.len()?;
                if let Some(frames) = footage.clip().len_hint().filter(|&frames| frames != len) {
                    return fail(format!("is for {len} frames, but there are {frames}"));
                }
                let there = match array {
                    Some(_) => vec![true; len],
                    None => (0..len).map(|i| Ok(!value.get_item(i)?.is_none())).collect::<PyResult<_>>()?,
                };
                Items::Each(footage.first_number(), value.clone().unbind(), there)
            }
        };
        Ok(Some(Self::Python(PythonSide { name, items, read, raised: listener.raised.clone() })))
    }

    /// The same, for a job.
    pub fn boxed(self) -> BoxedSide<T>
    where
        SideFolder<T>: Side<T>,
    {
        match self {
            Self::Files(folder) => Box::new(folder),
            Self::Python(side) => Box::new(side),
        }
    }

    /// What belongs to a frame.
    pub fn get(&self, py: Python<'_>, number: u64, size: (usize, usize)) -> PyResult<Option<T>>
    where
        T: Send,
    {
        match self {
            Self::Files(folder) => py.detach(|| folder.get(number, size)).map_err(failure::of_file),
            Self::Python(side) => side.get(py, number, size),
        }
    }
}

impl<T> PythonSide<T> {
    fn get(&self, py: Python<'_>, number: u64, size: (usize, usize)) -> PyResult<Option<T>> {
        let name = format!("{}: frame {number}", self.name);
        let item = match &self.items {
            Items::Every(array) => return (self.read)(array.bind(py), self.name, size).map(Some),
            Items::Each(first, items, there) => match number.checked_sub(*first).map(|i| i as usize) {
                Some(i) if there.get(i) == Some(&true) => items.bind(py).get_item(i)?,
                _ => return Ok(None),
            },
        };
        (self.read)(&item, &name, size).map(Some)
    }
}

impl<T> Side<T> for PythonSide<T> {
    fn name(&self) -> String {
        self.name.into()
    }

    fn has(&self, number: u64) -> bool {
        match &self.items {
            Items::Every(_) => true,
            Items::Each(first, _, there) => {
                number.checked_sub(*first).is_some_and(|i| there.get(i as usize) == Some(&true))
            }
        }
    }

    fn get(&self, number: u64, size: (usize, usize)) -> Result<Option<T>> {
        Python::attach(|py| self.get(py, number, size)).map_err(|e| self.raised.keep(e))
    }
}
