//! What the host asks for.

use crate::{
    analysis,
    host::{Clip, Effect, MAX_SIDE, Pixels, Properties, Region, Values},
    knobs, pixels,
    shot::Shot,
};
use blindaug::{
    Raster,
    model::{CameraTrack, PIXEL_ASPECTS},
};
use blindaug_report::words;
use openfx::sys::{generic::core::*, image_effect_v1::image_effect::*};
use std::{
    collections::BTreeMap,
    ffi::CStr,
    path::Path,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::SystemTime,
};

/// The name by which projects know the plugin.
pub const IDENTIFIER: &CStr = c"com.github.blindaug:MatchCamera";
/// The version of its parameters and of what it makes of them: major, minor.
pub const VERSION: (u32, u32) = (1, 0);

/// The clip of the rendered object.
const LAYER: &CStr = kOfxImageEffectSimpleSourceClipName;
/// The clip of its depth.
const DEPTH: &CStr = c"Depth";
/// The clip of its motion.
const MOTION: &CStr = c"Motion";
/// The clip of the footage.
pub const PLATE: &CStr = c"Plate";
/// The plate in sentences.
pub const PLATE_NAME: &str = "plate";
const OUTPUT: &CStr = kOfxImageEffectOutputClipName;

/// The largest frame that is rendered, px: 16 K by 8 K.
const MAX_PIXELS: usize = 1 << 27;

/// The largest file of camera models that is read, bytes.
const MAX_CAMERA_BYTES: u64 = 1 << 29;

/// What the host wants to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Describe the effect.
    Describe,
    /// Describe its clips and parameters.
    DescribeInContext,
    /// Prepare an instance.
    CreateInstance,
    /// Forget an instance.
    DestroyInstance,
    /// React to a change of a parameter.
    InstanceChanged,
    /// Say where the output has pixels.
    RegionOfDefinition,
    /// Say what of the inputs is needed.
    RegionsOfInterest,
    /// Say what the output is like.
    ClipPreferences,
    /// Make a frame.
    Render,
}

impl Action {
    /// The action of a name; `None` for those that are left to the host.
    pub fn of_name(name: &CStr) -> Option<Self> {
        [
            (kOfxActionDescribe, Self::Describe),
            (kOfxImageEffectActionDescribeInContext, Self::DescribeInContext),
            (kOfxActionCreateInstance, Self::CreateInstance),
            (kOfxActionDestroyInstance, Self::DestroyInstance),
            (kOfxActionInstanceChanged, Self::InstanceChanged),
            (kOfxImageEffectActionGetRegionOfDefinition, Self::RegionOfDefinition),
            (kOfxImageEffectActionGetRegionsOfInterest, Self::RegionsOfInterest),
            (kOfxImageEffectActionGetClipPreferences, Self::ClipPreferences),
            (kOfxImageEffectActionRender, Self::Render),
        ]
        .into_iter()
        .find(|(of, _)| *of == name)
        .map(|(_, action)| action)
    }
}

/// The answer to an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// It is done.
    Done,
    /// The host does what it does by default.
    Default,
}

/// Why an action fails.
#[derive(Clone, Debug, PartialEq)]
pub enum Failure {
    /// The person at the host is told: one sentence without a full stop.
    Sentence(String),
    /// The host cannot run the plugin, for this reason.
    MissingFeature(String),
    /// The host is told.
    Status(OfxStatus),
}

impl Failure {
    /// The failure in words.
    pub fn sentence(&self) -> String {
        match self {
            Self::Sentence(sentence) | Self::MissingFeature(sentence) => sentence.clone(),
            Self::Status(status) => format!("the host failed with status {status}"),
        }
    }
}

/// The shortest way to a failure of one sentence.
fn sentence(text: impl Into<String>) -> Failure {
    Failure::Sentence(text.into())
}

/// A camera that was read, and from what: a path with the file's time and length, or a text.
struct Read {
    from: (String, Option<(SystemTime, u64)>),
    track: Arc<CameraTrack>,
}

/// What is kept of an instance from one action to the next.
#[derive(Default)]
struct Instance {
    camera: Mutex<Option<Read>>,
    /// Whether a failure of rendering is shown on the node.
    failed: AtomicBool,
}

/// The instances by the host's handles.
static INSTANCES: Mutex<BTreeMap<usize, Arc<Instance>>> = Mutex::new(BTreeMap::new());

/// Nothing that a panic may leave behind in these is half done.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn instance(effect: &Effect) -> Arc<Instance> {
    locked(&INSTANCES).entry(effect.identity()).or_default().clone()
}

/// Forgets all instances.
pub fn unload() {
    locked(&INSTANCES).clear();
}

/// Does what the host wants.
///
/// # Errors
/// Says why it cannot be done.
pub fn act(
    action: Action,
    effect: &Effect,
    arguments: Option<Properties>,
    replies: Option<Properties>,
) -> Result<Reply, Failure> {
    let arguments = || arguments.as_ref().ok_or(Failure::Status(kOfxStatErrBadHandle));
    let replies = || replies.as_ref().ok_or(Failure::Status(kOfxStatErrBadHandle));
    match action {
        Action::Describe => describe(effect),
        Action::DescribeInContext => describe_in_context(effect),
        Action::CreateInstance => {
            locked(&INSTANCES).insert(effect.identity(), Arc::default());
            Ok(Reply::Done)
        }
        Action::DestroyInstance => {
            locked(&INSTANCES).remove(&effect.identity());
            Ok(Reply::Done)
        }
        Action::InstanceChanged => changed(effect, arguments()?),
        Action::RegionOfDefinition => {
            let region = FrameRegion::of(effect, time(arguments()?)?)?.region;
            replies()?.set_doubles(kOfxImageEffectPropRegionOfDefinition, &region);
            Ok(Reply::Done)
        }
        Action::RegionsOfInterest => {
            // Blur, noise and sharpening reach far, and the noise of a pixel depends on the whole frame's.
            let region = FrameRegion::of(effect, time(arguments()?)?)?.region;
            for name in [
                c"OfxImageClipPropRoI_Source",
                c"OfxImageClipPropRoI_Depth",
                c"OfxImageClipPropRoI_Motion",
                c"OfxImageClipPropRoI_Plate",
            ] {
                replies()?.set_doubles(name, &region);
            }
            Ok(Reply::Done)
        }
        Action::ClipPreferences => {
            let p = replies()?;
            p.set_texts(c"OfxImageClipPropComponents_Output", &[kOfxImageComponentRGBA]);
            p.set_texts(kOfxImageEffectPropPreMultiplication, &[kOfxImagePreMultiplied]);
            // Each frame has its own noise, also where nothing else changes.
            p.set_int(kOfxImageEffectFrameVarying, 0, 1);
            Ok(Reply::Done)
        }
        Action::Render => {
            let instance = instance(effect);
            let done = render(effect, &instance, arguments()?);
            match &done {
                Err(Failure::Sentence(_)) => instance.failed.store(true, Ordering::Relaxed),
                _ if instance.failed.swap(false, Ordering::Relaxed) => effect.clear_message(),
                _ => {}
            }
            done
        }
    }
}

fn describe(effect: &Effect) -> Result<Reply, Failure> {
    let p = effect.properties().ok_or(Failure::Status(kOfxStatErrBadHandle))?;
    p.set_strs(kOfxPropLabel, &["blindaug Match camera"]);
    p.set_strs(kOfxImageEffectPluginPropGrouping, &["blindaug"]);
    p.set_strs(
        kOfxPropPluginDescription,
        &["Puts a rendered object into footage as the footage's camera would have filmed it: with its defocus, motion blur, \
           sharpening and noise, as blindaug estimates them."],
    );
    p.set_texts(
        kOfxImageEffectPropSupportedContexts,
        &[kOfxImageEffectContextFilter, kOfxImageEffectContextGeneral],
    );
    p.set_texts(
        kOfxImageEffectPropSupportedPixelDepths,
        &[kOfxBitDepthByte, kOfxBitDepthShort, kOfxBitDepthHalf, kOfxBitDepthFloat],
    );
    // Frames are made as a whole, whatever part of them is wanted.
    p.set_int(kOfxImageEffectPropSupportsTiles, 0, 0);
    p.set_int(kOfxImageEffectPropSupportsMultiResolution, 0, 1);
    p.set_int(kOfxImageEffectPropSupportsMultipleClipDepths, 0, 1);
    p.set_int(kOfxImageEffectPropSupportsMultipleClipPARs, 0, 0);
    // The analysis goes through the plate's frames.
    p.set_int(kOfxImageEffectPropTemporalClipAccess, 0, 1);
    p.set_texts(kOfxImageEffectPluginRenderThreadSafety, &[kOfxImageEffectRenderFullySafe]);
    p.set_int(kOfxImageEffectPluginPropHostFrameThreading, 0, 0);
    p.set_int(kOfxImageEffectPluginPropFieldRenderTwiceAlways, 0, 0);
    Ok(Reply::Done)
}

fn describe_in_context(effect: &Effect) -> Result<Reply, Failure> {
    let (rgba, rgb) = (kOfxImageComponentRGBA, kOfxImageComponentRGB);
    let clips: [(&CStr, &str, &[&CStr], bool); 5] = [
        (LAYER, "Layer: the rendered object, premultiplied", &[rgba], false),
        (PLATE, "Plate: the footage", &[rgba, rgb], true),
        (DEPTH, "Depth: of the object, in m", &[rgba, rgb, kOfxImageComponentAlpha], true),
        (MOTION, "Motion: of the object to the next frame, in px", &[rgba, rgb], true),
        (OUTPUT, "Output", &[rgba], false),
    ];
    for (name, label, components, optional) in clips {
        let refused = || sentence(format!("the host refuses the clip {}", name.to_string_lossy()));
        let p = effect.define_clip(name).ok_or_else(refused)?;
        p.set_strs(kOfxPropLabel, &[label]);
        p.set_texts(kOfxImageEffectPropSupportedComponents, components);
        p.set_int(kOfxImageEffectPropSupportsTiles, 0, 0);
        if name != OUTPUT {
            p.set_int(kOfxImageClipPropOptional, 0, optional.into());
            p.set_texts(kOfxImageClipPropFieldExtraction, &[kOfxImageFieldBoth]);
        }
        if name == PLATE {
            p.set_int(kOfxImageEffectPropTemporalClipAccess, 0, 1);
        }
    }
    knobs::describe(effect)?;
    Ok(Reply::Done)
}

fn time(arguments: &Properties) -> Result<f64, Failure> {
    arguments.double(kOfxPropTime, 0).ok_or_else(|| sentence("the host does not say which frame it wants"))
}

/// A clip, if something is connected to it.
pub fn connected(effect: &Effect, name: &CStr) -> Option<Clip> {
    effect.clip(name).filter(|clip| clip.properties().int(kOfxImageClipPropConnected, 0).unwrap_or(0) != 0)
}

/// The place of the frame: the plate's; without a plate the project's; without that the layer's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameRegion {
    /// In canonical coordinates.
    pub region: Region,
    /// The width of a pixel over its height.
    pixel_aspect: f64,
}

impl FrameRegion {
    /// The place of the frame of a time.
    ///
    /// # Errors
    /// If the host says of none of them where they are.
    pub fn of(effect: &Effect, time: f64) -> Result<Self, Failure> {
        let of_clip = |name: &CStr| {
            let clip = connected(effect, name)?;
            let pixel_aspect = clip.properties().double(kOfxImagePropPixelAspectRatio, 0).unwrap_or(1.0);
            Self { region: clip.region(time)?, pixel_aspect }.checked()
        };
        let of_project = || {
            let p = effect.properties()?;
            let [x, y] = [0, 1].map(|i| p.double(kOfxImageEffectPropProjectOffset, i).unwrap_or(0.0));
            let size = |i| p.double(kOfxImageEffectPropProjectSize, i);
            let region = [x, y, x + size(0)?, y + size(1)?];
            let pixel_aspect = p.double(kOfxImageEffectPropProjectPixelAspectRatio, 0).unwrap_or(1.0);
            Self { region, pixel_aspect }.checked()
        };
        of_clip(PLATE)
            .or_else(of_project)
            .or_else(|| of_clip(LAYER))
            .ok_or_else(|| sentence("the host does not say how large a frame is: connect the plate"))
    }

    /// The width of a pixel over its height; `None` if it is one that no camera model can have.
    pub fn pixel_aspect(self) -> Option<f32> {
        Some(self.pixel_aspect as f32).filter(|aspect| PIXEL_ASPECTS.contains(aspect))
    }

    fn checked(self) -> Option<Self> {
        let Self { region: [x1, y1, x2, y2], pixel_aspect } = self;
        let fits = |v: f64| v.is_finite() && v.abs() <= f64::from(MAX_SIDE);
        (self.region.into_iter().all(fits) && x2 > x1 && y2 > y1 && pixel_aspect > 0.0).then_some(self)
    }

    /// The pixels of the frame at a scale.
    ///
    /// # Errors
    /// If there are none.
    pub fn pixels(self, [across, up]: [f64; 2]) -> Result<Pixels, Failure> {
        let [x1, y1, x2, y2] = self.region;
        let x = across / self.pixel_aspect;
        // The pixels that hold the region, less what is only rounding.
        let (low, high) = (|v: f64| (v + 1e-3).floor() as i32, |v: f64| (v - 1e-3).ceil() as i32);
        let pixels = Pixels::new([low(x1 * x), low(y1 * up), high(x2 * x), high(y2 * up)])
            .ok_or_else(|| sentence("the frame has no pixels, or far too many, at the host's scale"))?;
        match pixels.width() * pixels.height() <= MAX_PIXELS {
            true => Ok(pixels),
            false => Err(sentence(format!(
                "a frame of {} x {} pixels is too large: the most are {MAX_PIXELS} pixels",
                pixels.width(),
                pixels.height()
            ))),
        }
    }
}

/// The camera of an instance and its name; `None` if there is none.
fn camera(effect: &Effect, instance: &Instance) -> Result<Option<(Arc<CameraTrack>, String)>, Failure> {
    let text = |name: &CStr| {
        let missing = || sentence(format!("the host has no parameter \"{}\"", name.to_string_lossy()));
        effect.text(name).ok_or_else(missing)
    };
    let path = text(knobs::CAMERA)?;
    let path = path.trim();
    let (from, name, bytes) = if path.is_empty() {
        let analysed = text(knobs::ANALYSED)?;
        if analysed.trim().is_empty() {
            return Ok(None);
        }
        ((analysed, None), "the analysed camera", 0)
    } else {
        let about = Path::new(path).metadata().map_err(|e| cannot_read(path, &e))?;
        let changed = about.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        ((path.to_owned(), Some((changed, about.len()))), path, about.len())
    };
    if let Some(read) = locked(&instance.camera).as_ref().filter(|read| read.from == from) {
        return Ok(Some((read.track.clone(), name.into())));
    }
    if bytes > MAX_CAMERA_BYTES {
        return Err(sentence(format!("{path}: it is too large to be a camera file; choose another")));
    }
    let json = match from.1 {
        Some(_) => std::fs::read_to_string(path).map_err(|e| cannot_read(path, &e))?,
        None => from.0.clone(),
    };
    let track = CameraTrack::from_json(&json).map_err(|e| sentence(format!("{name}: {e}")))?;
    let track = Arc::new(track);
    *locked(&instance.camera) = Some(Read { from, track: track.clone() });
    Ok(Some((track, name.into())))
}

fn cannot_read(path: &str, error: &std::io::Error) -> Failure {
    sentence(format!(
        "{path}: the camera file cannot be read ({error}); choose one that blindaug estimate wrote"
    ))
}

/// Reacts to what a person changes.
fn changed(effect: &Effect, arguments: &Properties) -> Result<Reply, Failure> {
    let by_person = arguments
        .text(kOfxPropChangeReason)
        .is_some_and(|why| why.as_bytes() == kOfxChangeUserEdited.to_bytes());
    let name = arguments.text(kOfxPropName).unwrap_or_default();
    if !by_person {
        return Ok(Reply::Default);
    }
    let is = |knob: &CStr| name.as_bytes() == knob.to_bytes();
    let instance = instance(effect);
    if is(knobs::ANALYSE) {
        let colour = knobs::settings(effect, arguments.double(kOfxPropTime, 0).unwrap_or(0.0))?.colour;
        let Some(model) = analysis::estimated(effect, colour)? else { return Ok(Reply::Done) };
        // The file's name goes, since a file is used rather than what was analysed.
        let kept = effect.set_text(knobs::ANALYSED, &model.to_json()) && effect.set_text(knobs::CAMERA, "");
        if !kept {
            return Err(sentence("the host does not keep the analysed camera"));
        }
        effect.set_text(knobs::ABOUT, &words::words(&model, &[]));
    } else if is(knobs::CAMERA) {
        let about = match camera(effect, &instance) {
            Ok(None) => knobs::NO_CAMERA.to_owned(),
            Ok(Some((track, _))) => match track.frames() {
                [one] => words::words(&one.camera, &[]),
                _ => words::table(&track),
            },
            Err(failure) => {
                effect.set_text(knobs::ABOUT, knobs::NO_CAMERA);
                return Err(failure);
            }
        };
        effect.set_text(knobs::ABOUT, &about);
    } else {
        return Ok(Reply::Default);
    }
    Ok(Reply::Done)
}

/// Makes a frame.
fn render(effect: &Effect, instance: &Instance, arguments: &Properties) -> Result<Reply, Failure> {
    let time = time(arguments)?;
    let scale = [0, 1].map(|i| arguments.double(kOfxImageEffectPropRenderScale, i).unwrap_or(1.0));
    if scale.iter().any(|s| !(1e-4..=1e4).contains(s)) {
        return Err(sentence("the host asks for a frame of no size"));
    }
    let window = [0, 1, 2, 3].map(|i| arguments.int(kOfxImageEffectPropRenderWindow, i));
    let [Some(x1), Some(y1), Some(x2), Some(y2)] = window else {
        return Err(sentence("the host does not say which part of the frame it wants"));
    };
    let Some(window) = Pixels::new([x1, y1, x2, y2]) else { return Ok(Reply::Done) };
    let settings = knobs::settings(effect, time)?;
    let read = camera(effect, instance)?;
    let by_hand = settings.by_hand;
    if read.is_none() && by_hand == Default::default() {
        return Err(sentence(
            "there is no camera: name a camera file, press Analyse plate, or set the shutter, or focus and blur",
        ));
    }
    let region = FrameRegion::of(effect, time)?;
    let frame = region.pixels(scale)?;
    let fetched = |name: &CStr, called: &str, outside: [f32; 4]| {
        let Some(clip) = connected(effect, name) else { return Ok(None) };
        let Some(image) = clip.image(time, called)? else { return Ok(None) };
        if [DEPTH, MOTION].contains(&name) && [Values::Byte, Values::Short].contains(&image.values()) {
            return Err(sentence(format!(
                "the {called} has integer values, which cannot hold it: give it as float"
            )));
        }
        let straight = name == LAYER
            && image.properties().text(kOfxImageEffectPropPreMultiplication).as_deref()
                == kOfxImageUnPreMultiplied.to_str().ok();
        let values: Raster<[f32; 4]> = pixels::raster(&image, frame, outside)?;
        Ok(Some(if straight { values.map(|[r, g, b, a]| [r * a, g * a, b * a, a]) } else { values }))
    };
    let nothing = [0.0; 4];
    let shot = Shot {
        size: (frame.width(), frame.height()),
        proxy: scale.map(|s| s as f32),
        pixel_aspect: region.pixel_aspect(),
        number: settings.frame_number(time),
        layer: fetched(LAYER, "layer", nothing)?,
        depth: fetched(DEPTH, "depth", [f32::NAN; 4])?,
        motion: fetched(MOTION, "motion", nothing)?,
        plate: fetched(PLATE, PLATE_NAME, nothing)?,
        camera: read.as_ref().map(|(track, name)| (&**track, name.as_str())),
        settings,
    };
    if effect.aborted() {
        return Ok(Reply::Done);
    }
    let made = shot.make().map_err(sentence)?;
    let output = effect.clip(OUTPUT).ok_or_else(|| sentence("the host has no output clip"))?;
    let image = output.image(time, "output")?;
    let mut image = image.ok_or_else(|| sentence("the host gives no image to render into"))?;
    pixels::write(&made, frame, window, &mut image)?;
    Ok(Reply::Done)
}
