//! The host, behind safe types: the only module with `unsafe` code. Every table, handle, size and pointer that the host gives is checked
//! before it is used; what cannot be checked is listed at [`Host`].

#![allow(unsafe_code)]

use crate::effect::{self, Action, Failure, Reply};
use openfx::sys::{
    generic::{core::*, property::*},
    image_effect_v1::{image_effect::*, message::*, param::*, progress::*},
};
use std::{
    any::Any,
    ffi::{CStr, CString, c_char, c_int, c_void},
    panic::{AssertUnwindSafe, catch_unwind},
    ptr::{null, null_mut},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicPtr, Ordering},
    },
};

/// The largest side of a frame or an image, px; anything larger is taken for a mistake of the host.
pub const MAX_SIDE: i32 = 1 << 16;

/// A rectangle of pixels: the left, lower, right and upper end; y points up, and the right and the upper end are outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pixels {
    /// The left end, px.
    pub x1: i32,
    /// The lower end, px.
    pub y1: i32,
    /// The right end, px.
    pub x2: i32,
    /// The upper end, px.
    pub y2: i32,
}

impl Pixels {
    /// The rectangle of these four ends; `None` if it is empty or has a side of more than [`MAX_SIDE`].
    pub fn new([x1, y1, x2, y2]: [i32; 4]) -> Option<Self> {
        let fits = |a: i32, b: i32| b.checked_sub(a).is_some_and(|side| side > 0 && side <= MAX_SIDE);
        (fits(x1, x2) && fits(y1, y2)).then_some(Self { x1, y1, x2, y2 })
    }

    /// The width, px.
    pub fn width(self) -> usize {
        (self.x2 - self.x1) as usize
    }

    /// The height, px.
    pub fn height(self) -> usize {
        (self.y2 - self.y1) as usize
    }

    /// The part that lies in `other` too.
    pub fn within(self, other: Self) -> Option<Self> {
        Self::new([
            self.x1.max(other.x1),
            self.y1.max(other.y1),
            self.x2.min(other.x2),
            self.y2.min(other.y2),
        ])
    }
}

/// A rectangle in canonical coordinates (square pixels of full size): the left, lower, right and upper end.
pub type Region = [f64; 4];

/// The tables of functions that the host offers.
///
/// Taken on trust, since nothing can check it: that a table which is not null is one of the version asked for, that its functions do what
/// OpenFX says, that strings end with a zero byte, and that an image's memory is as large as its bounds and its row bytes say.
#[derive(Clone, Copy)]
pub struct Host {
    properties: OfxPropertySuiteV1,
    effects: OfxImageEffectSuiteV1,
    parameters: OfxParameterSuiteV1,
    message: Option<OfxMessageSuiteV1>,
    persistent_message: Option<OfxMessageSuiteV2>,
    progress: Progress,
}

#[derive(Clone, Copy)]
enum Progress {
    None,
    V1(OfxProgressSuiteV1),
    V2(OfxProgressSuiteV2),
}

/// What the host gave with `setHost`.
static GIVEN: AtomicPtr<OfxHost> = AtomicPtr::new(null_mut());
/// The tables, once the plugin was loaded.
static LOADED: Mutex<Option<Arc<Host>>> = Mutex::new(None);

impl Host {
    /// Fetches the host's tables.
    ///
    /// # Errors
    /// [`Failure::MissingFeature`] if the host has no property, image effect or parameter suite, or one without functions that are needed.
    fn fetch() -> Result<Self, Failure> {
        let missing = |what: &str| Failure::MissingFeature(format!("the host offers no {what}"));
        let given = GIVEN.load(Ordering::Acquire);
        // SAFETY: the pointer is null or what the host gave to `setHost`, which stays valid while the plugin is loaded.
        let given = unsafe { given.as_ref() }.ok_or_else(|| missing("host structure"))?;
        let fetch = given.fetchSuite.ok_or_else(|| missing("way to fetch suites"))?;
        // SAFETY: name and host are the ones that the function takes.
        let table = |name: &CStr, version: c_int| unsafe { fetch(given.host, name.as_ptr(), version) };
        /// Copies a table, if there is one.
        fn copied<T: Copy>(table: *const c_void) -> Option<T> {
            let table = table.cast::<T>();
            // SAFETY: it is aligned, not null, and the table of the suite and version asked for. Tables consist of optional functions, of
            // which every bit pattern that a host can have is a valid one.
            (!table.is_null() && table.is_aligned()).then(|| unsafe { table.read() })
        }
        let progress = match (copied(table(kOfxProgressSuite, 2)), copied(table(kOfxProgressSuite, 1))) {
            (Some(v2), _) => Progress::V2(v2),
            (_, Some(v1)) => Progress::V1(v1),
            _ => Progress::None,
        };
        let host = Self {
            properties: copied(table(kOfxPropertySuite, 1)).ok_or_else(|| missing("property suite"))?,
            effects: copied(table(kOfxImageEffectSuite, 1)).ok_or_else(|| missing("image effect suite"))?,
            parameters: copied(table(kOfxParameterSuite, 1)).ok_or_else(|| missing("parameter suite"))?,
            message: copied(table(kOfxMessageSuite, 1)),
            persistent_message: copied(table(kOfxMessageSuite, 2)),
            progress,
        };
        match host.is_complete() {
            true => Ok(host),
            false => Err(missing("complete property, image effect and parameter suites")),
        }
    }

    /// Whether the functions are there without which nothing can be described or rendered.
    fn is_complete(&self) -> bool {
        let Self { properties: p, effects: e, parameters: q, .. } = self;
        [
            p.propGetInt.is_some(),
            p.propGetDouble.is_some(),
            p.propGetString.is_some(),
            p.propGetPointer.is_some(),
        ]
        .into_iter()
        .chain([p.propSetInt.is_some(), p.propSetDouble.is_some(), p.propSetString.is_some()])
        .chain([e.getPropertySet.is_some(), e.getParamSet.is_some(), e.clipDefine.is_some()])
        .chain([e.clipGetHandle.is_some(), e.clipGetImage.is_some(), e.clipReleaseImage.is_some()])
        .chain([e.clipGetRegionOfDefinition.is_some(), q.paramDefine.is_some()])
        .chain([q.paramGetHandle.is_some(), q.paramGetValue.is_some(), q.paramGetValueAtTime.is_some()])
        .all(|there| there)
    }
}

/// A set of properties of anything that the host has.
#[derive(Clone)]
pub struct Properties {
    host: Arc<Host>,
    handle: OfxPropertySetHandle,
}

impl Properties {
    fn new(host: &Arc<Host>, handle: OfxPropertySetHandle) -> Option<Self> {
        (!handle.is_null()).then(|| Self { host: host.clone(), handle })
    }

    fn get<T>(
        &self,
        function: Option<
            unsafe extern "C" fn(OfxPropertySetHandle, *const c_char, c_int, *mut T) -> OfxStatus,
        >,
        (name, index): (&CStr, usize),
        mut value: T,
    ) -> Option<T> {
        // SAFETY: the handle is the host's and not null, the name ends with a zero byte, and the value outlives the call.
        let status = unsafe { function?(self.handle, name.as_ptr(), index as c_int, &mut value) };
        (status == kOfxStatOK).then_some(value)
    }

    /// An integer; `None` if there is none.
    pub fn int(&self, name: &CStr, index: usize) -> Option<i32> {
        self.get(self.host.properties.propGetInt, (name, index), 0)
    }

    /// Four integers.
    fn ints(&self, name: &CStr) -> Option<[i32; 4]> {
        Some([self.int(name, 0)?, self.int(name, 1)?, self.int(name, 2)?, self.int(name, 3)?])
    }

    /// A finite number; `None` if there is none.
    pub fn double(&self, name: &CStr, index: usize) -> Option<f64> {
        self.get(self.host.properties.propGetDouble, (name, index), 0.0).filter(|v| v.is_finite())
    }

    /// A text; `None` if there is none. What is no UTF-8 in it is replaced.
    pub fn text(&self, name: &CStr) -> Option<String> {
        let text = self.get(self.host.properties.propGetString, (name, 0), null_mut())?;
        // SAFETY: the pointer is not null, and strings end with a zero byte; it is copied before the host is called again.
        (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned())
    }

    fn pointer(&self, name: &CStr) -> Option<*mut c_void> {
        self.get(self.host.properties.propGetPointer, (name, 0), null_mut()).filter(|p| !p.is_null())
    }

    // Hosts that do not know a property refuse it, and are left without it: all of them have defaults.

    /// Sets an integer.
    pub fn set_int(&self, name: &CStr, index: usize, value: i32) {
        if let Some(set) = self.host.properties.propSetInt {
            // SAFETY: as in `get`.
            unsafe { set(self.handle, name.as_ptr(), index as c_int, value) };
        }
    }

    /// Sets numbers.
    pub fn set_doubles(&self, name: &CStr, values: &[f64]) {
        if let Some(set) = self.host.properties.propSetDouble {
            for (index, value) in (0..).zip(values) {
                // SAFETY: as in `get`.
                unsafe { set(self.handle, name.as_ptr(), index, *value) };
            }
        }
    }

    /// Sets texts.
    pub fn set_texts(&self, name: &CStr, values: &[&CStr]) {
        for (index, value) in values.iter().enumerate() {
            if let Some(set) = self.host.properties.propSetString {
                // SAFETY: as in `get`; the host copies the text.
                unsafe { set(self.handle, name.as_ptr(), index as c_int, value.as_ptr()) };
            }
        }
    }

    /// Sets texts, each up to its first zero byte.
    pub fn set_strs(&self, name: &CStr, values: &[&str]) {
        let texts: Vec<CString> = values.iter().map(|v| c_text(v)).collect();
        self.set_texts(name, &texts.iter().map(CString::as_c_str).collect::<Vec<_>>());
    }
}

/// A text with a zero byte at its end, up to its first zero byte.
fn c_text(text: &str) -> CString {
    CString::new(text.split('\0').next().unwrap_or_default()).unwrap_or_default()
}

/// An effect: its description, or an instance of it.
#[derive(Clone)]
pub struct Effect {
    host: Arc<Host>,
    handle: OfxImageEffectHandle,
}

// SAFETY: the handle is only ever given back to the host. The effect tells the host that it is fully thread-safe, whereupon hosts render
// several frames of one instance at once, with the same handles in several threads: their functions are made for that.
unsafe impl Send for Effect {}
// SAFETY: as above.
unsafe impl Sync for Effect {}

impl Effect {
    /// A number that tells instances apart.
    pub fn identity(&self) -> usize {
        self.handle.addr()
    }

    /// The properties of the effect.
    pub fn properties(&self) -> Option<Properties> {
        let mut handle = null_mut();
        // SAFETY: the effect's handle is the host's and not null.
        let status = unsafe { self.host.effects.getPropertySet?(self.handle, &mut handle) };
        Properties::new(&self.host, handle).filter(|_| status == kOfxStatOK)
    }

    /// Describes a clip; its properties, or `None` if the host refuses it.
    pub fn define_clip(&self, name: &CStr) -> Option<Properties> {
        let mut handle = null_mut();
        // SAFETY: as in `properties`.
        let status = unsafe { self.host.effects.clipDefine?(self.handle, name.as_ptr(), &mut handle) };
        Properties::new(&self.host, handle).filter(|_| status == kOfxStatOK)
    }

    fn parameter_set(&self) -> Option<OfxParamSetHandle> {
        let mut set = null_mut();
        // SAFETY: as in `properties`.
        let status = unsafe { self.host.effects.getParamSet?(self.handle, &mut set) };
        (status == kOfxStatOK && !set.is_null()).then_some(set)
    }

    /// Describes a parameter; its properties, or `None` if the host refuses it.
    pub fn define_parameter(&self, kind: &CStr, name: &CStr) -> Option<Properties> {
        let (set, mut handle) = (self.parameter_set()?, null_mut());
        let define = self.host.parameters.paramDefine?;
        // SAFETY: the set is the host's and not null.
        let status = unsafe { define(set, kind.as_ptr(), name.as_ptr(), &mut handle) };
        Properties::new(&self.host, handle).filter(|_| status == kOfxStatOK)
    }

    /// The handle of a parameter of this kind: only of that kind may be asked for its value.
    fn parameter(&self, kind: &CStr, name: &CStr) -> Option<OfxParamHandle> {
        let (set, mut handle, mut properties) = (self.parameter_set()?, null_mut(), null_mut());
        let get = self.host.parameters.paramGetHandle?;
        // SAFETY: the set is the host's and not null.
        let status = unsafe { get(set, name.as_ptr(), &mut handle, &mut properties) };
        let own = Properties::new(&self.host, properties).and_then(|p| p.text(kOfxParamPropType));
        // A host that does not say the kind is trusted to have the one that was defined.
        let is_of_kind = own.is_none_or(|own| own.as_bytes() == kind.to_bytes());
        (status == kOfxStatOK && !handle.is_null() && is_of_kind).then_some(handle)
    }

    /// The value of a number at a time; `None` if there is no such parameter.
    pub fn number(&self, name: &CStr, time: f64) -> Option<f64> {
        let (handle, mut value) = (self.parameter(kOfxParamTypeDouble, name)?, 0.0f64);
        let get = self.host.parameters.paramGetValueAtTime?;
        // SAFETY: the parameter is a double, of which the host writes one.
        let status = unsafe { get(handle, time, &mut value as *mut f64) };
        (status == kOfxStatOK && value.is_finite()).then_some(value)
    }

    /// The value of an integer, a choice or a switch at a time; `None` if there is no parameter of this name and kind.
    pub fn integer(&self, kind: &CStr, name: &CStr, time: f64) -> Option<i32> {
        if ![kOfxParamTypeInteger, kOfxParamTypeBoolean, kOfxParamTypeChoice].contains(&kind) {
            return None;
        }
        let (handle, mut value) = (self.parameter(kind, name)?, 0 as c_int);
        let get = self.host.parameters.paramGetValueAtTime?;
        // SAFETY: the parameter is of a kind of which the host writes one int.
        let status = unsafe { get(handle, time, &mut value as *mut c_int) };
        (status == kOfxStatOK).then_some(value)
    }

    /// The value of a text; `None` if there is no such parameter.
    pub fn text(&self, name: &CStr) -> Option<String> {
        let (handle, mut value) = (self.parameter(kOfxParamTypeString, name)?, null_mut::<c_char>());
        let get = self.host.parameters.paramGetValue?;
        // SAFETY: the parameter is a string, of which the host writes a pointer.
        let status = unsafe { get(handle, &mut value as *mut *mut c_char) };
        if status != kOfxStatOK || value.is_null() {
            return None;
        }
        // SAFETY: strings end with a zero byte; it is copied before the host is called again.
        Some(unsafe { CStr::from_ptr(value) }.to_string_lossy().into_owned())
    }

    /// Sets a text, up to its first zero byte. Whether the host took it.
    pub fn set_text(&self, name: &CStr, value: &str) -> bool {
        let (Some(handle), Some(set)) =
            (self.parameter(kOfxParamTypeString, name), self.host.parameters.paramSetValue)
        else {
            return false;
        };
        let value = c_text(value);
        // SAFETY: the parameter is a string, which takes a pointer to a text that the host copies.
        unsafe { set(handle, value.as_ptr()) == kOfxStatOK }
    }

    /// A clip of an instance; `None` if it has none of this name.
    pub fn clip(&self, name: &CStr) -> Option<Clip> {
        let (mut handle, mut properties) = (null_mut(), null_mut());
        let get = self.host.effects.clipGetHandle?;
        // SAFETY: as in `properties`.
        let status = unsafe { get(self.handle, name.as_ptr(), &mut handle, &mut properties) };
        if status != kOfxStatOK || handle.is_null() {
            return None;
        }
        Some(Clip { host: self.host.clone(), handle, properties: Properties::new(&self.host, properties)? })
    }

    /// Whether the host wants the running action to end.
    pub fn aborted(&self) -> bool {
        // SAFETY: as in `properties`.
        self.host.effects.abort.is_some_and(|abort| unsafe { abort(self.handle) } != 0)
    }

    /// Shows a sentence to the person at the host: on the node and until the next [`Effect::clear_message`] if `stays` and the host can do
    /// so, else as a message that is confirmed. Without a message suite it goes to standard error.
    pub fn message(&self, kind: &CStr, sentence: &str, stays: bool) {
        let text = c_text(sentence);
        let messages = self.host.message.and_then(|m| m.message);
        let persistent = self.host.persistent_message.as_ref();
        let plain = messages.or(persistent.and_then(|m| m.message));
        let shown = match persistent.and_then(|m| m.setPersistentMessage).filter(|_| stays).or(plain) {
            // SAFETY: the handle is the host's, and the format takes one text.
            Some(show) => unsafe {
                show(self.handle.cast(), kind.as_ptr(), c"blindaug".as_ptr(), c"%s".as_ptr(), text.as_ptr())
            },
            None => kOfxStatErrMissingHostFeature,
        };
        if shown != kOfxStatOK {
            eprintln!("{sentence}");
        }
    }

    /// Takes the sentence off the node again.
    pub fn clear_message(&self) {
        if let Some(clear) = self.host.persistent_message.and_then(|m| m.clearPersistentMessage) {
            // SAFETY: the handle is the host's.
            unsafe { clear(self.handle.cast()) };
        }
    }

    /// Begins to show the progress of `what`.
    pub fn progress_begin(&self, what: &CStr) {
        // SAFETY: the handle is the host's; texts end with a zero byte.
        match self.host.progress {
            Progress::V1(OfxProgressSuiteV1 { progressStart: Some(start), .. }) => unsafe {
                start(self.handle.cast(), what.as_ptr());
            },
            Progress::V2(OfxProgressSuiteV2 { progressStart: Some(start), .. }) => unsafe {
                start(self.handle.cast(), what.as_ptr(), c"blindaug".as_ptr());
            },
            _ => {}
        }
    }

    /// Shows the progress, from 0 to 1. False if the person at the host wants to stop.
    pub fn progress(&self, done: f64) -> bool {
        let update = match self.host.progress {
            Progress::V1(suite) => suite.progressUpdate,
            Progress::V2(suite) => suite.progressUpdate,
            Progress::None => None,
        };
        // SAFETY: the handle is the host's.
        update.is_none_or(|update| unsafe { update(self.handle.cast(), done) } != kOfxStatReplyNo)
    }

    /// Ends the progress.
    pub fn progress_end(&self) {
        let end = match self.host.progress {
            Progress::V1(suite) => suite.progressEnd,
            Progress::V2(suite) => suite.progressEnd,
            Progress::None => None,
        };
        if let Some(end) = end {
            // SAFETY: the handle is the host's.
            unsafe { end(self.handle.cast()) };
        }
    }
}

/// A clip of an instance.
#[derive(Clone)]
pub struct Clip {
    host: Arc<Host>,
    handle: OfxImageClipHandle,
    properties: Properties,
}

// SAFETY: as for `Effect`.
unsafe impl Send for Clip {}
// SAFETY: as for `Effect`.
unsafe impl Sync for Clip {}

impl Clip {
    /// The clip's properties.
    pub fn properties(&self) -> &Properties {
        &self.properties
    }

    /// The region in which the clip has pixels at a time; `None` if the host does not say it.
    pub fn region(&self, time: f64) -> Option<Region> {
        let mut r = OfxRectD { x1: 0.0, y1: 0.0, x2: 0.0, y2: 0.0 };
        // SAFETY: the handle is the host's and not null.
        let status = unsafe { self.host.effects.clipGetRegionOfDefinition?(self.handle, time, &mut r) };
        (status == kOfxStatOK).then_some([r.x1, r.y1, r.x2, r.y2])
    }

    /// The image at a time, as much of it as the host gives; `None` if the clip has none then, which means black and transparent.
    /// Sentences call the clip `name`.
    ///
    /// # Errors
    /// If the image cannot be used.
    pub fn image(&self, time: f64, name: &str) -> Result<Option<Image>, Failure> {
        let refused = |why: &str| Failure::Sentence(format!("the host's image of the {name} {why}"));
        let mut handle = null_mut();
        let get = self.host.effects.clipGetImage.ok_or_else(|| refused("cannot be fetched"))?;
        // SAFETY: the handle is the host's and not null; without a region the host gives what it wants to.
        let status = unsafe { get(self.handle, time, null(), &mut handle) };
        if status == kOfxStatFailed {
            return Ok(None);
        } else if status == kOfxStatErrMemory {
            return Err(Failure::Status(status));
        } else if status != kOfxStatOK {
            return Err(refused(&format!("cannot be fetched (status {status})")));
        }
        let properties = Properties::new(&self.host, handle).ok_or_else(|| refused("is null"))?;
        // From here on it is released however this function ends.
        let mut image = Image {
            properties,
            data: null_mut(),
            bounds: Pixels { x1: 0, y1: 0, x2: 1, y2: 1 },
            row_bytes: 0,
            values: Values::Float,
            channels: 0,
        };
        let p = &image.properties;
        let bounds = p.ints(kOfxImagePropBounds).ok_or_else(|| refused("has no bounds"))?;
        image.bounds = match Pixels::new(bounds) {
            Some(bounds) => bounds,
            None if bounds[0] == bounds[2] || bounds[1] == bounds[3] => return Ok(None),
            None => return Err(refused(&format!("has the bounds {bounds:?}, which are no picture"))),
        };
        let depth = p.text(kOfxImageEffectPropPixelDepth).unwrap_or_default();
        image.values = match depth.as_str() {
            "OfxBitDepthByte" => Values::Byte,
            "OfxBitDepthShort" => Values::Short,
            "OfxBitDepthHalf" => Values::Half,
            "OfxBitDepthFloat" => Values::Float,
            _ => return Err(refused(&format!("has values of an unknown kind ({depth:?})"))),
        };
        let components = p.text(kOfxImageEffectPropComponents).unwrap_or_default();
        image.channels = match components.as_str() {
            "OfxImageComponentRGBA" => 4,
            "OfxImageComponentRGB" => 3,
            "OfxImageComponentAlpha" => 1,
            _ => return Err(refused(&format!("has channels of an unknown kind ({components:?})"))),
        };
        image.data = p.pointer(kOfxImagePropData).ok_or_else(|| refused("has no pixels"))?.cast();
        let row = p.int(kOfxImagePropRowBytes, 0).ok_or_else(|| refused("has no row bytes"))? as isize;
        if row.unsigned_abs() < image.used_bytes() {
            return Err(refused(&format!(
                "has rows of {row} bytes, but one of its rows needs {}",
                image.used_bytes()
            )));
        }
        image.row_bytes = row;
        Ok(Some(image))
    }
}

/// The kind of an image's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Values {
    /// 8 bit, 0 to 255.
    Byte,
    /// 16 bit, 0 to 65535.
    Short,
    /// Half floats.
    Half,
    /// Floats.
    Float,
}

impl Values {
    /// The bytes of a value.
    pub fn bytes(self) -> usize {
        match self {
            Self::Byte => 1,
            Self::Short | Self::Half => 2,
            Self::Float => 4,
        }
    }
}

/// An image of a clip, which is released when this is dropped.
pub struct Image {
    properties: Properties,
    /// The leftmost pixel of the lowest row.
    data: *mut u8,
    bounds: Pixels,
    /// The distance from a row to the one above it, bytes; negative in hosts that store rows from the top.
    row_bytes: isize,
    values: Values,
    channels: usize,
}

impl Image {
    /// The image's properties.
    pub fn properties(&self) -> &Properties {
        &self.properties
    }

    /// The part of the picture that the image has.
    pub fn bounds(&self) -> Pixels {
        self.bounds
    }

    /// The kind of its values.
    pub fn values(&self) -> Values {
        self.values
    }

    /// The number of its channels: 4, 3 or 1.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// The bytes of a row that are used.
    fn used_bytes(&self) -> usize {
        self.bounds.width() * self.channels * self.values.bytes()
    }

    /// The place of row `y` of the picture in memory, if the image has it.
    fn row_at(&self, y: i32) -> Option<*mut u8> {
        if self.data.is_null() || !(self.bounds.y1..self.bounds.y2).contains(&y) {
            return None;
        }
        // SAFETY: the row is one of the image's, whose memory the host holds until the image is released.
        Some(unsafe { self.data.offset((y - self.bounds.y1) as isize * self.row_bytes) })
    }

    /// The bytes of row `y` of the picture; `None` if the image does not have it.
    pub fn row(&self, y: i32) -> Option<&[u8]> {
        // SAFETY: as many bytes are used in each row, and nothing writes to the image while it is borrowed.
        self.row_at(y).map(|row| unsafe { std::slice::from_raw_parts(row, self.used_bytes()) })
    }

    /// The bytes of row `y` of the picture, to be written; `None` if the image does not have it.
    pub fn row_mut(&mut self, y: i32) -> Option<&mut [u8]> {
        // SAFETY: as in `row`; the image is borrowed for writing. Hosts fill what they give, so that the bytes are initialised or
        // overwritten without being read.
        self.row_at(y).map(|row| unsafe { std::slice::from_raw_parts_mut(row, self.used_bytes()) })
    }
}

impl Drop for Image {
    fn drop(&mut self) {
        if let Some(release) = self.properties.host.effects.clipReleaseImage {
            // SAFETY: the handle is the host's image, which is released once.
            unsafe { release(self.properties.handle) };
        }
    }
}

static PLUGIN: OfxPlugin = OfxPlugin {
    pluginApi: kOfxImageEffectPluginApi.as_ptr(),
    apiVersion: kOfxImageEffectPluginApiVersion as c_int,
    pluginIdentifier: effect::IDENTIFIER.as_ptr(),
    pluginVersionMajor: effect::VERSION.0,
    pluginVersionMinor: effect::VERSION.1,
    setHost: Some(set_host),
    mainEntry: Some(main_entry),
};

/// The number of plugins in this binary.
#[unsafe(no_mangle)]
pub extern "C" fn OfxGetNumberOfPlugins() -> c_int {
    1
}

/// The plugin of this number, from 0 on.
#[unsafe(no_mangle)]
pub extern "C" fn OfxGetPlugin(nth: c_int) -> *const OfxPlugin {
    if nth == 0 { &PLUGIN } else { null() }
}

unsafe extern "C" fn set_host(host: *mut OfxHost) {
    GIVEN.store(host, Ordering::Release);
}

/// A panic's sentence.
fn sentence_of(panic: &(dyn Any + Send)) -> String {
    let why = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("no reason was given");
    format!("blindaug failed; please report this: {why}")
}

/// Shows why an action failed: on the node, or to a person who waits for an answer.
fn show(handle: *const c_void, sentence: &str, is_waited_for: bool) {
    let host = LOADED.lock().unwrap_or_else(PoisonError::into_inner).clone();
    match (host, handle.is_null()) {
        (Some(host), false) => {
            let effect = Effect { host, handle: handle.cast_mut().cast() };
            effect.message(kOfxMessageError, sentence, !is_waited_for);
        }
        _ => eprintln!("{sentence}"),
    }
}

/// The status of an action, whose failure is shown. A panic is a failure like others.
fn answered(
    handle: *const c_void,
    is_waited_for: bool,
    act: impl FnOnce() -> Result<Reply, Failure>,
) -> OfxStatus {
    let (status, sentence) = match catch_unwind(AssertUnwindSafe(act)) {
        Ok(Ok(Reply::Done)) => return kOfxStatOK,
        Ok(Ok(Reply::Default)) => return kOfxStatReplyDefault,
        Ok(Err(Failure::Status(status))) => return status,
        Ok(Err(Failure::Sentence(sentence))) => (kOfxStatFailed, format!("blindaug: {sentence}")),
        Ok(Err(Failure::MissingFeature(sentence))) => {
            (kOfxStatErrMissingHostFeature, format!("blindaug: {sentence}"))
        }
        Err(panic) => (kOfxStatFailed, sentence_of(&*panic)),
    };
    // Showing it must not end the host either.
    catch_unwind(AssertUnwindSafe(|| show(handle, &sentence, is_waited_for))).ok();
    status
}

unsafe extern "C" fn main_entry(
    action: *const c_char,
    handle: *const c_void,
    arguments: OfxPropertySetHandle,
    replies: OfxPropertySetHandle,
) -> OfxStatus {
    if action.is_null() {
        return kOfxStatErrValue;
    }
    // SAFETY: the host gives the action's name, which ends with a zero byte.
    let action = unsafe { CStr::from_ptr(action) };
    let is_waited_for = action == kOfxActionInstanceChanged;
    answered(handle, is_waited_for, || act(action, handle.cast_mut().cast(), arguments, replies))
}

/// Translates an action, and has it done.
fn act(
    action: &CStr,
    handle: OfxImageEffectHandle,
    arguments: OfxPropertySetHandle,
    replies: OfxPropertySetHandle,
) -> Result<Reply, Failure> {
    if action == kOfxActionLoad {
        let host = Arc::new(Host::fetch()?);
        *LOADED.lock().unwrap_or_else(PoisonError::into_inner) = Some(host);
        return Ok(Reply::Done);
    }
    if action == kOfxActionUnload {
        effect::unload();
        *LOADED.lock().unwrap_or_else(PoisonError::into_inner) = None;
        return Ok(Reply::Done);
    }
    let Some(action) = Action::of_name(action) else { return Ok(Reply::Default) };
    let host = LOADED.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let host = host.ok_or(Failure::Status(kOfxStatErrMissingHostFeature))?;
    if handle.is_null() {
        return Err(Failure::Status(kOfxStatErrBadHandle));
    }
    let [arguments, replies] = [arguments, replies].map(|handle| Properties::new(&host, handle));
    effect::act(action, &Effect { host, handle }, arguments, replies)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_a_status_and_goes_no_further() {
        let hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(|_| {}));
        let status = answered(null(), false, || panic!("{} of {}", 7, 6));
        std::panic::set_hook(hook);
        assert_eq!(status, kOfxStatFailed);
        assert_eq!(answered(null(), false, || Ok(Reply::Done)), kOfxStatOK);
        let panic: Box<dyn Any + Send> = Box::new("seven".to_owned());
        assert_eq!(sentence_of(&*panic), "blindaug failed; please report this: seven");
    }

    #[test]
    fn rectangles_that_are_none_or_huge_are_refused() {
        assert!(Pixels::new([0, 0, 4, 3]).is_some_and(|p| (p.width(), p.height()) == (4, 3)));
        for ends in [[0, 0, 0, 3], [4, 0, 0, 3], [i32::MIN, 0, i32::MAX, 3], [0, 0, 1 << 17, 1]] {
            assert_eq!(Pixels::new(ends), None);
        }
        let (a, b) = (Pixels::new([0, 0, 9, 9]).unwrap(), Pixels::new([5, -3, 20, 4]).unwrap());
        assert_eq!(a.within(b), Pixels::new([5, 0, 9, 4]));
        assert_eq!(a.within(Pixels::new([9, 0, 10, 9]).unwrap()), None);
    }
}
