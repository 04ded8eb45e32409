//! A small host, which can be told to lie.

use openfx::sys::{
    generic::{core::*, property::*},
    image_effect_v1::{image_effect::*, message::*, param::*, progress::*},
};
use std::{
    collections::BTreeMap,
    ffi::{CStr, CString, c_char, c_int, c_void},
    ptr::{null, null_mut},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
};

/// A value of a property.
#[derive(Clone, Debug)]
pub enum Value {
    Ints(Vec<i32>),
    Doubles(Vec<f64>),
    Texts(Vec<CString>),
    Pointer(usize),
}

/// Properties by name; a handle of properties points to one of these.
#[derive(Default)]
pub struct Set(Mutex<BTreeMap<CString, Value>>);

impl Set {
    pub fn put(&self, name: &CStr, value: Value) {
        locked(&self.0).insert(name.to_owned(), value);
    }

    pub fn with(self, name: &CStr, value: Value) -> Self {
        self.put(name, value);
        self
    }

    pub fn get(&self, name: &CStr) -> Option<Value> {
        locked(&self.0).get(name).cloned()
    }

    fn handle(&self) -> OfxPropertySetHandle {
        (self as *const Self).cast_mut().cast()
    }
}

pub fn texts(values: &[&CStr]) -> Value {
    Value::Texts(values.iter().map(|&v| v.to_owned()).collect())
}

pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An image as the host gives it.
#[derive(Clone, Debug)]
pub struct Picture {
    /// The left, lower, right and upper end.
    pub bounds: [i32; 4],
    pub depth: &'static CStr,
    pub components: &'static CStr,
    /// The values from the lowest row on, without padding.
    pub bytes: Vec<u8>,
    /// Whether rows are stored from the top.
    pub from_top: bool,
    pub premultiplication: &'static CStr,
}

pub fn bytes_of(depth: &CStr) -> usize {
    match depth.to_bytes() {
        b"OfxBitDepthByte" => 1,
        b"OfxBitDepthFloat" => 4,
        _ => 2,
    }
}

/// What images are asked for, by time.
type Pictures = Arc<dyn Fn(f64) -> Option<Picture> + Send + Sync>;

pub struct Clip {
    pub properties: Set,
    pub region: [f64; 4],
    pub pictures: Pictures,
    /// What was written into the last image, from the lowest row on.
    pub written: Arc<Mutex<Vec<u8>>>,
}

impl Clip {
    pub fn new(region: [f64; 4], pictures: impl Fn(f64) -> Option<Picture> + Send + Sync + 'static) -> Self {
        let properties = Set::default()
            .with(kOfxImageClipPropConnected, Value::Ints(vec![1]))
            .with(kOfxImagePropPixelAspectRatio, Value::Doubles(vec![1.0]))
            .with(kOfxImageEffectPropFrameRange, Value::Doubles(vec![1.0, 4.0]))
            .with(kOfxImageEffectPropFrameRate, Value::Doubles(vec![25.0]));
        Self { properties, region, pictures: Arc::new(pictures), written: Arc::default() }
    }
}

pub enum Held {
    Number(f64),
    Integer(i32),
    Text(CString),
    Nothing,
}

pub struct Parameter {
    pub properties: Set,
    pub value: Mutex<Held>,
}

/// An effect, described or as an instance; handles of effects and of parameter sets point to one of these.
#[derive(Default)]
pub struct Effect {
    pub properties: Set,
    pub parameters: Mutex<BTreeMap<CString, Box<Parameter>>>,
    pub clips: Mutex<BTreeMap<CString, Box<Clip>>>,
}

/// What the host lies about.
#[derive(Clone, Debug, Default)]
pub struct Lies {
    /// Suites that it does not have.
    pub missing_suites: Vec<&'static CStr>,
    /// Suites whose table has no functions.
    pub empty_suites: Vec<&'static CStr>,
    /// Properties of images that it changes, or removes.
    pub image: Vec<(&'static CStr, Option<Value>)>,
    /// It gives a null image.
    pub null_image: bool,
    /// What it answers to requests of images.
    pub image_status: Option<OfxStatus>,
    /// A parameter that it does not have.
    pub missing_parameter: Option<&'static CStr>,
    /// A parameter that it gives another one for.
    pub other_parameter: Option<(&'static CStr, &'static CStr)>,
    /// It wants the action to end.
    pub aborts: bool,
    /// It wants an analysis to end after as many frames.
    pub cancels_after: Option<usize>,
}

pub static LIES: Mutex<Lies> = Mutex::new(Lies {
    missing_suites: vec![],
    empty_suites: vec![],
    image: vec![],
    null_image: false,
    image_status: None,
    missing_parameter: None,
    other_parameter: None,
    aborts: false,
    cancels_after: None,
});
/// The sentences that the plugin said.
pub static SAID: Mutex<Vec<String>> = Mutex::new(Vec::new());
pub static CLEARED: AtomicUsize = AtomicUsize::new(0);
pub static PROGRESS: Mutex<Vec<f64>> = Mutex::new(Vec::new());

struct Given {
    properties: Box<Set>,
    memory: Vec<u8>,
    picture: Picture,
    row: usize,
    written: Arc<Mutex<Vec<u8>>>,
}

/// The images that were not released.
static IMAGES: Mutex<BTreeMap<usize, Given>> = Mutex::new(BTreeMap::new());

pub fn images_held() -> usize {
    locked(&IMAGES).len()
}

/// Bytes before, between and after the rows, which nobody may write.
const GUARD: u8 = 0xA5;
const AROUND: usize = 64;
const PADDING: usize = 12;

// The functions of the suites.

unsafe fn set<'a>(handle: OfxPropertySetHandle) -> Option<&'a Set> {
    unsafe { handle.cast::<Set>().as_ref() }
}

unsafe fn name<'a>(text: *const c_char) -> &'a CStr {
    unsafe { CStr::from_ptr(text) }
}

macro_rules! setter {
    ($name:ident, $of:ty, $variant:ident, $default:expr, $value:ident => $make:expr) => {
        unsafe extern "C" fn $name(
            p: OfxPropertySetHandle,
            n: *const c_char,
            index: c_int,
            $value: $of,
        ) -> OfxStatus {
            let Some(set) = (unsafe { set(p) }) else { return kOfxStatErrBadHandle };
            let n = unsafe { name(n) };
            let mut all = locked(&set.0);
            let held = all.entry(n.to_owned()).or_insert(Value::$variant(vec![]));
            let Value::$variant(held) = held else { return kOfxStatErrValue };
            if held.len() <= index as usize {
                held.resize(index as usize + 1, $default);
            }
            held[index as usize] = $make;
            kOfxStatOK
        }
    };
}
setter!(set_int, c_int, Ints, 0, v => v);
setter!(set_double, f64, Doubles, 0.0, v => v);
setter!(set_string, *const c_char, Texts, CString::default(), v => unsafe { name(v) }.to_owned());

macro_rules! getter {
    ($name:ident, $of:ty, $pattern:pat => $value:expr, $index:ident) => {
        unsafe extern "C" fn $name(
            p: OfxPropertySetHandle,
            n: *const c_char,
            $index: c_int,
            out: *mut $of,
        ) -> OfxStatus {
            let Some(set) = (unsafe { set(p) }) else { return kOfxStatErrBadHandle };
            let value: Option<$of> = match locked(&set.0).get(unsafe { name(n) }) {
                Some($pattern) => $value,
                _ => None,
            };
            let Some(value) = value else { return kOfxStatErrUnknown };
            unsafe { *out = value };
            kOfxStatOK
        }
    };
}
getter!(get_int, c_int, Value::Ints(v) => v.get(i as usize).copied(), i);
getter!(get_double, f64, Value::Doubles(v) => v.get(i as usize).copied(), i);
getter!(get_string, *mut c_char, Value::Texts(v) => v.get(i as usize).map(|t| t.as_ptr().cast_mut()), i);
getter!(get_pointer, *mut c_void, Value::Pointer(v) => (i == 0).then_some(*v as *mut c_void), i);

unsafe fn effect<'a>(handle: *mut OfxImageEffectStruct) -> &'a Effect {
    unsafe { &*handle.cast::<Effect>() }
}

unsafe extern "C" fn property_set(e: OfxImageEffectHandle, out: *mut OfxPropertySetHandle) -> OfxStatus {
    unsafe { *out = effect(e).properties.handle() };
    kOfxStatOK
}

unsafe extern "C" fn param_set(e: OfxImageEffectHandle, out: *mut OfxParamSetHandle) -> OfxStatus {
    unsafe { *out = e.cast() };
    kOfxStatOK
}

unsafe extern "C" fn clip_define(
    e: OfxImageEffectHandle,
    n: *const c_char,
    out: *mut OfxPropertySetHandle,
) -> OfxStatus {
    let clip = Box::new(Clip::new([0.0; 4], |_| None));
    unsafe { *out = clip.properties.handle() };
    locked(&unsafe { effect(e) }.clips).insert(unsafe { name(n) }.to_owned(), clip);
    kOfxStatOK
}

unsafe extern "C" fn clip_get(
    e: OfxImageEffectHandle,
    n: *const c_char,
    out: *mut OfxImageClipHandle,
    properties: *mut OfxPropertySetHandle,
) -> OfxStatus {
    match locked(&unsafe { effect(e) }.clips).get(unsafe { name(n) }) {
        Some(clip) => unsafe {
            *out = (&**clip as *const Clip).cast_mut().cast();
            if !properties.is_null() {
                *properties = clip.properties.handle();
            }
            kOfxStatOK
        },
        None => kOfxStatErrUnknown,
    }
}

unsafe extern "C" fn clip_region(clip: OfxImageClipHandle, _: f64, out: *mut OfxRectD) -> OfxStatus {
    let [x1, y1, x2, y2] = unsafe { &*clip.cast::<Clip>() }.region;
    unsafe { *out = OfxRectD { x1, y1, x2, y2 } };
    kOfxStatOK
}

unsafe extern "C" fn clip_image(
    clip: OfxImageClipHandle,
    time: f64,
    _: *const OfxRectD,
    out: *mut OfxPropertySetHandle,
) -> OfxStatus {
    let lies = locked(&LIES).clone();
    let clip = unsafe { &*clip.cast::<Clip>() };
    if let Some(status) = lies.image_status {
        return status;
    }
    let Some(picture) = (clip.pictures)(time) else { return kOfxStatFailed };
    if lies.null_image {
        unsafe { *out = null_mut() };
        return kOfxStatOK;
    }
    let [x1, y1, x2, y2] = picture.bounds;
    let channels = match picture.components.to_bytes() {
        b"OfxImageComponentRGBA" => 4,
        b"OfxImageComponentRGB" => 3,
        _ => 1,
    };
    let used = (x2 - x1) as usize * channels * bytes_of(picture.depth);
    let (rows, row) = ((y2 - y1) as usize, used + PADDING);
    assert_eq!(picture.bytes.len(), used * rows);
    let mut memory = vec![GUARD; 2 * AROUND + rows * row];
    for (y, from) in picture.bytes.chunks_exact(used).enumerate() {
        let y = if picture.from_top { rows - 1 - y } else { y };
        memory[AROUND + y * row..][..used].copy_from_slice(from);
    }
    let first = AROUND + if picture.from_top { (rows - 1) * row } else { 0 };
    let row_bytes = if picture.from_top { -(row as i32) } else { row as i32 };
    let properties = Box::new(
        Set::default()
            .with(kOfxImagePropBounds, Value::Ints(picture.bounds.to_vec()))
            .with(kOfxImageEffectPropPixelDepth, texts(&[picture.depth]))
            .with(kOfxImageEffectPropComponents, texts(&[picture.components]))
            .with(kOfxImageEffectPropPreMultiplication, texts(&[picture.premultiplication]))
            .with(kOfxImageEffectPropRenderScale, Value::Doubles(vec![1.0; 2]))
            .with(kOfxImagePropRowBytes, Value::Ints(vec![row_bytes]))
            .with(kOfxImagePropData, Value::Pointer(memory.as_mut_ptr() as usize + first)),
    );
    for (name, lie) in lies.image {
        match lie {
            Some(value) => properties.put(name, value),
            None => {
                locked(&properties.0).remove(name);
            }
        }
    }
    let handle = properties.handle();
    unsafe { *out = handle };
    let held = Given { properties, memory, picture, row, written: clip.written.clone() };
    locked(&IMAGES).insert(handle.addr(), held);
    kOfxStatOK
}

unsafe extern "C" fn release(image: OfxPropertySetHandle) -> OfxStatus {
    let Some(held) = locked(&IMAGES).remove(&image.addr()) else { return kOfxStatErrBadHandle };
    let Given { properties, memory, picture, row, written } = held;
    drop(properties);
    let rows = (picture.bounds[3] - picture.bounds[1]) as usize;
    let used = picture.bytes.len() / rows;
    let body = &memory[AROUND..AROUND + rows * row];
    let guards = memory[..AROUND].iter().chain(&memory[AROUND + rows * row..]);
    let paddings = body.chunks_exact(row).flat_map(|row| &row[used..]);
    assert!(guards.chain(paddings).all(|b| *b == GUARD), "written outside of an image");
    let mut rows: Vec<&[u8]> = body.chunks_exact(row).map(|row| &row[..used]).collect();
    if picture.from_top {
        rows.reverse();
    }
    *locked(&written) = rows.concat();
    kOfxStatOK
}

unsafe extern "C" fn abort(_: OfxImageEffectHandle) -> c_int {
    locked(&LIES).aborts.into()
}

unsafe extern "C" fn param_define(
    e: OfxParamSetHandle,
    kind: *const c_char,
    n: *const c_char,
    out: *mut OfxPropertySetHandle,
) -> OfxStatus {
    let properties = Set::default().with(kOfxParamPropType, texts(&[unsafe { name(kind) }]));
    let parameter = Box::new(Parameter { properties, value: Mutex::new(Held::Nothing) });
    unsafe { *out = parameter.properties.handle() };
    locked(&unsafe { effect(e.cast()) }.parameters).insert(unsafe { name(n) }.to_owned(), parameter);
    kOfxStatOK
}

unsafe extern "C" fn param_get(
    e: OfxParamSetHandle,
    n: *const c_char,
    out: *mut OfxParamHandle,
    properties: *mut OfxPropertySetHandle,
) -> OfxStatus {
    let (mut n, lies) = (unsafe { name(n) }, locked(&LIES).clone());
    if lies.missing_parameter == Some(n) {
        return kOfxStatErrUnknown;
    }
    if let Some((_, other)) = lies.other_parameter.filter(|(from, _)| *from == n) {
        n = other;
    }
    match locked(&unsafe { effect(e.cast()) }.parameters).get(n) {
        Some(parameter) => unsafe {
            *out = (&**parameter as *const Parameter).cast_mut().cast();
            if !properties.is_null() {
                *properties = parameter.properties.handle();
            }
            kOfxStatOK
        },
        None => kOfxStatErrUnknown,
    }
}

unsafe extern "C" fn value_at(parameter: OfxParamHandle, _: f64, out: *mut c_void) -> OfxStatus {
    unsafe { value(parameter, out) }
}

unsafe extern "C" fn value(parameter: OfxParamHandle, out: *mut c_void) -> OfxStatus {
    match &*locked(&unsafe { &*parameter.cast::<Parameter>() }.value) {
        Held::Number(v) => unsafe { *out.cast::<f64>() = *v },
        Held::Integer(v) => unsafe { *out.cast::<c_int>() = *v },
        Held::Text(v) => unsafe { *out.cast::<*mut c_char>() = v.as_ptr().cast_mut() },
        Held::Nothing => return kOfxStatErrUnsupported,
    }
    kOfxStatOK
}

unsafe extern "C" fn set_value(parameter: OfxParamHandle, text: *const c_char) -> OfxStatus {
    match &mut *locked(&unsafe { &*parameter.cast::<Parameter>() }.value) {
        Held::Text(v) => *v = unsafe { name(text) }.to_owned(),
        _ => return kOfxStatErrUnsupported,
    }
    kOfxStatOK
}

unsafe extern "C" fn say(
    _: *mut c_void,
    _: *const c_char,
    _: *const c_char,
    format: *const c_char,
    text: *const c_char,
) -> OfxStatus {
    assert_eq!(unsafe { name(format) }, c"%s");
    locked(&SAID).push(unsafe { name(text) }.to_str().unwrap().to_owned());
    kOfxStatOK
}

unsafe extern "C" fn clear(_: *mut c_void) -> OfxStatus {
    CLEARED.fetch_add(1, Ordering::Relaxed);
    kOfxStatOK
}

unsafe extern "C" fn progress_start(_: *mut c_void, _: *const c_char, _: *const c_char) -> OfxStatus {
    locked(&PROGRESS).clear();
    kOfxStatOK
}

unsafe extern "C" fn progress_update(_: *mut c_void, done: f64) -> OfxStatus {
    let mut all = locked(&PROGRESS);
    all.push(done);
    let cancels = locked(&LIES).cancels_after.is_some_and(|n| all.len() >= n);
    if cancels { kOfxStatReplyNo } else { kOfxStatReplyYes }
}

unsafe extern "C" fn progress_end(_: *mut c_void) -> OfxStatus {
    kOfxStatOK
}

static PROPERTIES: OfxPropertySuiteV1 = OfxPropertySuiteV1 {
    propSetPointer: None,
    propSetString: Some(set_string),
    propSetDouble: Some(set_double),
    propSetInt: Some(set_int),
    propSetPointerN: None,
    propSetStringN: None,
    propSetDoubleN: None,
    propSetIntN: None,
    propGetPointer: Some(get_pointer),
    propGetString: Some(get_string),
    propGetDouble: Some(get_double),
    propGetInt: Some(get_int),
    propGetPointerN: None,
    propGetStringN: None,
    propGetDoubleN: None,
    propGetIntN: None,
    propReset: None,
    propGetDimension: None,
};

static EFFECTS: OfxImageEffectSuiteV1 = OfxImageEffectSuiteV1 {
    getPropertySet: Some(property_set),
    getParamSet: Some(param_set),
    clipDefine: Some(clip_define),
    clipGetHandle: Some(clip_get),
    clipGetPropertySet: None,
    clipGetImage: Some(clip_image),
    clipReleaseImage: Some(release),
    clipGetRegionOfDefinition: Some(clip_region),
    abort: Some(abort),
    imageMemoryAlloc: None,
    imageMemoryFree: None,
    imageMemoryLock: None,
    imageMemoryUnlock: None,
};

/// A function as a variadic one, which it is called as.
macro_rules! variadic {
    ($function:expr, $of:ty as $to:ty) => {
        Some(unsafe { std::mem::transmute::<$of, $to>($function) })
    };
}

type Say = unsafe extern "C" fn(
    *mut c_void,
    *const c_char,
    *const c_char,
    *const c_char,
    *const c_char,
) -> OfxStatus;
type SayAny =
    unsafe extern "C" fn(*mut c_void, *const c_char, *const c_char, *const c_char, ...) -> OfxStatus;

static PARAMETERS: OfxParameterSuiteV1 = OfxParameterSuiteV1 {
    paramDefine: Some(param_define),
    paramGetHandle: Some(param_get),
    paramSetGetPropertySet: None,
    paramGetPropertySet: None,
    paramGetValue: variadic!(
        value,
        unsafe extern "C" fn(OfxParamHandle, *mut c_void) -> OfxStatus as unsafe extern "C" fn(OfxParamHandle, ...) -> OfxStatus
    ),
    paramGetValueAtTime: variadic!(
        value_at,
        unsafe extern "C" fn(OfxParamHandle, f64, *mut c_void) -> OfxStatus as unsafe extern "C" fn(OfxParamHandle, f64, ...) -> OfxStatus
    ),
    paramGetDerivative: None,
    paramGetIntegral: None,
    paramSetValue: variadic!(
        set_value,
        unsafe extern "C" fn(OfxParamHandle, *const c_char) -> OfxStatus as unsafe extern "C" fn(OfxParamHandle, ...) -> OfxStatus
    ),
    paramSetValueAtTime: None,
    paramGetNumKeys: None,
    paramGetKeyTime: None,
    paramGetKeyIndex: None,
    paramDeleteKey: None,
    paramDeleteAllKeys: None,
    paramCopy: None,
    paramEditBegin: None,
    paramEditEnd: None,
};

static MESSAGES: OfxMessageSuiteV2 = OfxMessageSuiteV2 {
    message: variadic!(say, Say as SayAny),
    setPersistentMessage: variadic!(say, Say as SayAny),
    clearPersistentMessage: Some(clear),
};

static PROGRESSES: OfxProgressSuiteV2 = OfxProgressSuiteV2 {
    progressStart: Some(progress_start),
    progressUpdate: Some(progress_update),
    progressEnd: Some(progress_end),
};

/// A table without functions.
static EMPTY: [usize; 32] = [0; 32];

unsafe extern "C" fn fetch(_: OfxPropertySetHandle, n: *const c_char, version: c_int) -> *const c_void {
    let (n, lies) = (unsafe { name(n) }, locked(&LIES).clone());
    if lies.missing_suites.contains(&n) {
        return null();
    }
    if lies.empty_suites.contains(&n) {
        return (&raw const EMPTY).cast();
    }
    match (n.to_bytes(), version) {
        (b"OfxPropertySuite", 1) => (&raw const PROPERTIES).cast(),
        (b"OfxImageEffectSuite", 1) => (&raw const EFFECTS).cast(),
        (b"OfxParameterSuite", 1) => (&raw const PARAMETERS).cast(),
        (b"OfxMessageSuite", 1 | 2) => (&raw const MESSAGES).cast(),
        (b"OfxProgressSuite", 2) => (&raw const PROGRESSES).cast(),
        _ => null(),
    }
}

/// The host and an instance of the plugin. Only one is there at a time.
pub struct Host {
    _alone: MutexGuard<'static, ()>,
    plugin: &'static OfxPlugin,
    pub instance: Box<Effect>,
    pub size: [f64; 2],
}

static ALONE: Mutex<()> = Mutex::new(());

impl Host {
    /// Lets the host tell these lies from now on.
    pub fn lies(&self, lies: Lies) {
        *locked(&LIES) = lies;
    }

    /// Loads the plugin; the status of that.
    pub fn load(lies: Lies) -> (Self, OfxStatus) {
        let alone = locked(&ALONE);
        *locked(&LIES) = lies;
        locked(&SAID).clear();
        let host = Box::leak(Box::new(OfxHost { host: null_mut(), fetchSuite: Some(fetch) }));
        assert_eq!(blindaug_ofx::OfxGetNumberOfPlugins(), 1);
        assert!(blindaug_ofx::OfxGetPlugin(1).is_null() && blindaug_ofx::OfxGetPlugin(-1).is_null());
        let plugin = unsafe { &*blindaug_ofx::OfxGetPlugin(0) };
        unsafe { plugin.setHost.unwrap()(host) };
        let host = Self { _alone: alone, plugin, instance: Box::default(), size: [0.0; 2] };
        let status = host.call_with(kOfxActionLoad, null_mut(), None, None);
        (host, status)
    }

    /// An instance for frames of this size; parameters have their defaults.
    pub fn new(size: (usize, usize)) -> Self {
        let (mut host, status) = Self::load(Lies::default());
        assert_eq!(status, kOfxStatOK);
        host.size = [size.0 as f64, size.1 as f64];
        host.instance.properties.put(kOfxImageEffectPropProjectSize, Value::Doubles(host.size.to_vec()));
        host.instance.properties.put(kOfxImageEffectPropProjectOffset, Value::Doubles(vec![0.0; 2]));
        // One object is the description and the instance.
        assert_eq!(host.call(kOfxActionDescribe, None, None), kOfxStatOK);
        assert_eq!(host.call(kOfxImageEffectActionDescribeInContext, None, None), kOfxStatOK);
        for parameter in locked(&host.instance.parameters).values() {
            let p = &parameter.properties;
            let Some(Value::Texts(kind)) = p.get(kOfxParamPropType) else { panic!("no type") };
            *locked(&parameter.value) = match (kind[0].to_bytes(), p.get(kOfxParamPropDefault)) {
                (_, Some(Value::Doubles(v))) => Held::Number(v[0]),
                (_, Some(Value::Ints(v))) => Held::Integer(v[0]),
                (_, Some(Value::Texts(v))) => Held::Text(v[0].clone()),
                (b"OfxParamTypeString", None) => Held::Text(CString::default()),
                (b"OfxParamTypePushButton", None) => Held::Nothing,
                (kind, default) => panic!("{kind:?} {default:?}"),
            };
        }
        for (name, clip) in locked(&host.instance.clips).iter() {
            let connected = i32::from(name.as_c_str() == c"Output");
            clip.properties.put(kOfxImageClipPropConnected, Value::Ints(vec![connected]));
        }
        assert_eq!(host.call(kOfxActionCreateInstance, None, None), kOfxStatOK);
        host
    }

    pub fn connect(&self, name: &CStr, clip: Clip) {
        locked(&self.instance.clips).insert(name.to_owned(), Box::new(clip));
    }

    pub fn written(&self) -> Vec<u8> {
        locked(&locked(&self.instance.clips)[c"Output"].written).clone()
    }

    pub fn set(&self, name: &CStr, value: Held) {
        let parameters = locked(&self.instance.parameters);
        let parameter = parameters.get(name).unwrap_or_else(|| panic!("no parameter {name:?}"));
        *locked(&parameter.value) = value;
    }

    pub fn text(&self, name: &CStr) -> String {
        match &*locked(&locked(&self.instance.parameters)[name].value) {
            Held::Text(v) => v.to_str().unwrap().to_owned(),
            _ => panic!("no text"),
        }
    }

    fn call_with(
        &self,
        action: &CStr,
        effect: *mut c_void,
        arguments: Option<&Set>,
        replies: Option<&Set>,
    ) -> OfxStatus {
        let handle = |set: Option<&Set>| set.map_or(null_mut(), Set::handle);
        let main = self.plugin.mainEntry.unwrap();
        unsafe { main(action.as_ptr(), effect, handle(arguments), handle(replies)) }
    }

    pub fn call(&self, action: &CStr, arguments: Option<&Set>, replies: Option<&Set>) -> OfxStatus {
        let effect = (&*self.instance as *const Effect).cast_mut().cast();
        let status = self.call_with(action, effect, arguments, replies);
        assert_eq!(images_held(), 0, "an image was not released");
        status
    }

    /// Calls an action with null handles.
    pub fn call_without(&self, action: &CStr) -> OfxStatus {
        self.call_with(action, null_mut(), None, None)
    }

    /// The arguments of a render.
    pub fn arguments(time: f64, scale: [f64; 2], window: [i32; 4]) -> Set {
        Set::default()
            .with(kOfxPropTime, Value::Doubles(vec![time]))
            .with(kOfxImageEffectPropRenderScale, Value::Doubles(scale.to_vec()))
            .with(kOfxImageEffectPropRenderWindow, Value::Ints(window.to_vec()))
            .with(kOfxImageEffectPropFieldToRender, texts(&[kOfxImageFieldNone]))
    }

    pub fn render(&self, time: f64, scale: [f64; 2], window: [i32; 4]) -> OfxStatus {
        self.call(kOfxImageEffectActionRender, Some(&Self::arguments(time, scale, window)), None)
    }

    /// Tells the plugin that a person changed a parameter.
    pub fn changed(&self, name: &CStr) -> OfxStatus {
        let arguments = Self::arguments(1.0, [1.0; 2], [0; 4])
            .with(kOfxPropName, texts(&[name]))
            .with(kOfxPropType, texts(&[kOfxTypeParameter]))
            .with(kOfxPropChangeReason, texts(&[kOfxChangeUserEdited]));
        self.call(kOfxActionInstanceChanged, Some(&arguments), None)
    }

    /// The only sentence that the plugin said since this was last asked.
    pub fn said(&self) -> Option<String> {
        let mut said = std::mem::take(&mut *locked(&SAID));
        assert!(said.len() <= 1, "{said:?}");
        said.pop()
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        self.call_without(kOfxActionUnload);
        locked(&IMAGES).clear();
    }
}
