//! Virtual layers over the frames of a clip, and a camera's distortions on whole frames.

use crate::{
    ByHand, Error, Result,
    estimate::of_frame,
    footage::{BoxedSide, Clip, changed, check_match, has_reading},
    frames::{DEPTH, FLOW, FRAME, Made, Neighbours, Sink, check_memory, for_each_frame},
    observer::{Observer, warn},
};
use blindaug::{
    CameraModel, Encoded, Flow, Frame, Linear, Overscan, Plane, Raster, Transfer,
    composite::{self, CompositeOptions, DistortedLayer, Plate, VirtualLayer},
    model::{
        CameraTrack, Capture, DefocusCurve, DefocusModel, DepthKind, Distortion, Estimate, KnownDistance,
        MotionBlurModel, Reason, SceneScale, TrackedCamera,
    },
    synth::{self, SynthesisOptions, distorted_strips},
    text::ranges_in_words,
};
use std::{collections::BTreeMap, time::SystemTime};

/// Bytes per pixel of a virtual layer while it is read, and of a pair of renders with their linear light.
const LAYER: u64 = 56;
const RENDERS: u64 = 48;
/// Bytes per pixel of a distorted layer and of its channels as they are written.
const DISTORTED_LAYER: u64 = 88;
/// Bytes per pixel of a frame with alpha while it is distorted, which may change all of it, beside the layer that comes out.
const WITH_ALPHA: u64 = 324 + DISTORTED_LAYER;

/// The share of a virtual layer with light but without alpha, above which its alpha may be straight rather than premultiplied.
const MUCH_LIGHT_ALONE: f32 = 0.02;

/// A camera that distorts nothing, for frames of this width and height, px, encoded like this.
pub fn naive((width, height): (usize, usize), transfer: Transfer) -> CameraModel {
    let capture = Capture { width, height, fps: None, frames_used: 0, pixel_aspect: 1.0 };
    let mut model = CameraModel::unknown(capture, "naive");
    model.transfer = transfer;
    model
}

/// A model for a clip's frames of this width and height, px, and with pixels of this width over height, if it is known. A model of frames of
/// the same size with square pixels says nothing of its pixels' shape, which is then taken to be that of the clip.
pub fn sized_to(
    model: &CameraModel,
    (width, height): (usize, usize),
    pixel_aspect: Option<f32>,
) -> CameraModel {
    let as_if_square = says_nothing_of_pixels(&model.capture, (width, height));
    let own = model.capture.pixel_aspect;
    let scaled = model.scaled_to(width, height);
    match pixel_aspect.filter(|&aspect| aspect != own) {
        None => scaled,
        Some(aspect) if as_if_square => scaled.measured_in_pixels_of(aspect),
        Some(aspect) => scaled.with_pixel_aspect(aspect),
    }
}

fn says_nothing_of_pixels(capture: &Capture, size: (usize, usize)) -> bool {
    (capture.width, capture.height) == size && capture.pixel_aspect == 1.0
}

/// Real inverse depth, converted to the unit in which it is needed.
pub struct DepthMaps {
    maps: BoxedSide<Plane>,
    scale: Option<SceneScale>,
}

impl DepthMaps {
    /// The maps in their own unit.
    pub fn as_they_are(maps: BoxedSide<Plane>) -> Self {
        Self { maps, scale: None }
    }

    /// The maps in 1/m.
    ///
    /// # Errors
    /// [`Error::NoSceneScale`] if the maps are relative and there is no scale.
    pub fn in_metres(maps: BoxedSide<Plane>, kind: DepthKind, scale: Option<SceneScale>) -> Result<Self> {
        match (kind, scale) {
            (DepthKind::Metric, _) => Ok(Self::as_they_are(maps)),
            (DepthKind::Relative, Some(scale)) => Ok(Self { maps, scale: Some(scale) }),
            (DepthKind::Relative, None) => Err(Error::NoSceneScale { name: maps.name(), is_model: false }),
        }
    }

    /// When the map of this frame was last changed, if that is known.
    pub(crate) fn changed(&self, number: u64) -> Option<SystemTime> {
        self.maps.changed(number)
    }

    pub(crate) fn get(&self, number: u64, size: (usize, usize)) -> Result<Option<Plane>> {
        let depth = self.maps.get(number, size)?;
        Ok(match self.scale {
            Some(scale) => depth.map(|d| scale.to_metric(d)),
            None => depth,
        })
    }
}

/// The models with their lens over metric inverse depth. Messages call the models `name`.
///
/// # Errors
/// [`Error::NoSceneScale`] if the models are over relative inverse depth and there is no scale.
pub fn in_metres(track: CameraTrack, name: &str, scale: Option<SceneScale>) -> Result<CameraTrack> {
    match (track.depth_kind(), scale) {
        (Some(DepthKind::Relative), Some(scale)) => Ok(track.to_metric(scale)),
        (Some(DepthKind::Relative), None) => Err(Error::NoSceneScale { name: name.into(), is_model: true }),
        _ => Ok(track),
    }
}

/// What is applied of an exposure that is unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnknownExposure {
    /// No motion blur is applied.
    #[default]
    Left,
    /// The middle of the exposures that fit is applied, where the footage tells which fit ([`MotionBlurModel::middle`]).
    Middle,
}

/// What is said of models before they are applied.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fitting {
    /// The scale of the scene, which brings lenses over relative inverse depth to metres.
    pub scale: Option<SceneScale>,
    /// One or two places whose distance is known, in place of the scale; px of the clip.
    pub known: Vec<KnownDistance>,
    /// A place, px of the clip, as blurred as which an object is to be, whatever its depth ([`matched_at`]).
    pub match_at: Option<[f32; 2]>,
    /// The parts that are set by hand.
    pub by_hand: ByHand,
    /// What is applied of an unknown exposure.
    pub unknown: UnknownExposure,
}

/// Scales the models to a clip's frames, brings them to metres if the scale of the scene is given or follows from known distances, sets the
/// parts that are set by hand, and tells the observer which distortions are not applied. Returns the scale as well. Messages call the models
/// `name`.
///
/// # Errors
/// If known distances give no scale, or a part cannot be set by hand: see [`CameraModel::scale_by`], [`matched_at`] and [`ByHand::applied`].
pub fn fitted_to(
    track: CameraTrack,
    name: &str,
    clip: &dyn Clip,
    fitting: &Fitting,
    observer: &dyn Observer,
) -> Result<(CameraTrack, Option<SceneScale>)> {
    let Fitting { by_hand, unknown, .. } = *fitting;
    let (width, height) = clip.size();
    let Capture { width: w, height: h, pixel_aspect, .. } = track.frames()[0].camera.capture;
    if (w, h) != (width, height) {
        observer.note(&format!(
            "{name}: for frames of {w} x {h}; its blur is scaled by the width to {width} x {height}"
        ));
        let shape = (width * h) as f64 / (height * w) as f64;
        let aspects = clip.pixel_aspect().map_or(1.0, |a| f64::from(a / pixel_aspect));
        if (shape * aspects - 1.0).abs() > 0.01 {
            observer.warning(
                "these frames have another shape than the camera's; that is right only if they were cropped in height",
            );
        }
    }
    if let Some(aspect) = clip.pixel_aspect().filter(|&aspect| aspect != pixel_aspect) {
        observer.note(&match says_nothing_of_pixels(&track.frames()[0].camera.capture, clip.size()) {
            true => format!("{name}: says nothing of its pixels' shape, which is taken to be that of these frames, {aspect} to 1"),
            false => format!("{name}: for pixels of {pixel_aspect} to 1; its blur is scaled to pixels of {aspect} to 1"),
        });
    }
    let mut track = track.map(|m| sized_to(&m, clip.size(), clip.pixel_aspect()));
    let scale = match &fitting.known[..] {
        [] => fitting.scale,
        known => {
            let scale = track.frames()[0].camera.scale_by(known);
            let scale = scale.map_err(|error| Error::Clip { clip: name.into(), error })?;
            observer.note(&format!(
                "{name}: relative inverse depth is {:.4} / Z + {:.4}",
                scale.scale, scale.offset
            ));
            Some(scale)
        }
    };
    if let Some(scale) = scale {
        track = track.to_metric(scale);
    }
    if let Some(place) = fitting.match_at {
        track = matched_at(track, name, place)?;
    }
    let set = |f: &TrackedCamera| {
        let camera = by_hand.applied(f.camera.clone())?;
        Ok(TrackedCamera { frame: f.frame, changed: f.changed, camera })
    };
    let set: blindaug::Result<Vec<TrackedCamera>> = track.frames().iter().map(set).collect();
    track =
        set.and_then(CameraTrack::from_frames).map_err(|error| Error::Clip { clip: name.into(), error })?;
    if unknown == UnknownExposure::Middle {
        track = with_middle_exposure(track, observer);
    }
    for distortion in Distortion::ALL.into_iter().filter(|d| d.in_every_camera()) {
        if let Some(why) = track.why_unknown(distortion) {
            observer.warning(&format!("{name}: {} is unknown and not applied: {why}", distortion.name()));
        }
    }
    Ok((track, scale))
}

/// The models with the middle of the exposures that fit in place of an unknown exposure.
fn with_middle_exposure(track: CameraTrack, observer: &dyn Observer) -> CameraTrack {
    let of = |camera: &CameraModel| camera.motion_blur.why_unknown().and_then(MotionBlurModel::middle);
    let frames = track.frames();
    let taken: Vec<MotionBlurModel> = frames.iter().filter_map(|f| of(&f.camera)).collect();
    let unknown = frames.iter().filter(|f| f.camera.motion_blur.known().is_none()).count();
    match taken.as_slice() {
        [] if unknown > 0 => observer.warning("the footage does not tell which exposures fit, so that they have no middle"),
        [one] if frames.len() == 1 => observer.note(&format!(
            "the exposure is unknown; {:.2} is applied, the middle of {:.2} to {:.2}, which all fit",
            one.exposure.0, one.interval[0], one.interval[1]
        )),
        [] => {}
        some => observer.note(&format!(
            "in {} of {unknown} frames with an unknown exposure, the middle of the exposures that fit is applied",
            some.len()
        )),
    }
    track.map(|mut m| {
        if let Some(middle) = of(&m) {
            m.motion_blur = Estimate::Known(middle);
        }
        m
    })
}

/// Warns of each effect of missing data in the first frame that it concerns, and in the end of all frames.
pub(crate) struct Missing<'a> {
    observer: &'a dyn Observer,
    /// The numbers of the frames of each effect.
    frames: BTreeMap<&'static str, Vec<u64>>,
}

impl<'a> Missing<'a> {
    pub(crate) fn new(observer: &'a dyn Observer) -> Self {
        Self { observer, frames: BTreeMap::new() }
    }

    pub(crate) fn check(&mut self, is_missing: bool, number: u64, what: &str, effect: &'static str) {
        if !is_missing {
            return;
        }
        let frames = self.frames.entry(effect).or_default();
        if frames.is_empty() {
            self.observer.warning(&format!("frame {number}: {what}, so {effect}"));
        }
        frames.push(number);
    }
}

impl Drop for Missing<'_> {
    fn drop(&mut self) {
        for (effect, frames) in self.frames.iter().filter(|(_, frames)| frames.len() > 1) {
            self.observer.warning(&format!("frames {}: {effect}", in_words(frames)));
        }
    }
}

/// Rising numbers of frames in words.
fn in_words(numbers: &[u64]) -> String {
    let runs = numbers.chunk_by(|a, b| *b == a + 1);
    ranges_in_words(&runs.map(|run| (run[0], run[run.len() - 1])).collect::<Vec<_>>())
}

/// The virtual layer of a frame.
#[derive(Clone, Debug)]
pub struct FrameLayer {
    /// The layer, larger than the frame by its overscan.
    pub layer: VirtualLayer,
    /// How far the layer reaches beyond the frame, px.
    pub overscan: Overscan,
}

impl From<VirtualLayer> for FrameLayer {
    /// A layer as large as the frame.
    fn from(layer: VirtualLayer) -> Self {
        Self { layer, overscan: Overscan::default() }
    }
}

/// The parts of a composite.
pub struct Scene {
    /// The footage.
    pub footage: Box<dyn Clip>,
    /// The virtual object.
    pub layers: BoxedSide<FrameLayer>,
    /// Real inverse depth, 1/m.
    pub depth: Option<DepthMaps>,
    /// The footage's optical flow to the next frame, px, which blurs the renders' difference.
    pub flow: Option<BoxedSide<Flow>>,
    /// Renders of the local scene with and without the object, for its shadows and reflections.
    pub renders: Option<[BoxedSide<Encoded>; 2]>,
    /// Mattes: the share of each pixel that things in front of the object cover, in [0, 1].
    pub holdout: Option<BoxedSide<Plane>>,
    /// The depth of layers that have none.
    pub layer_depth: Option<LayerDepth>,
    /// The motion of layers that have none.
    pub layer_motion: Option<LayerMotion>,
}

/// The depth of a whole layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LayerDepth {
    /// A distance, m, > 0.
    Metres(f32),
    /// The median of the real depth where the object is.
    OfFootage,
}

impl LayerDepth {
    /// The depth of layers that have none, for a lens whose blur does not depend on depth ([`matched_at`]), which needs some all the same: that
    /// of the footage if it is known.
    pub fn any(footage_is_known: bool) -> Self {
        if footage_is_known { Self::OfFootage } else { Self::Metres(1.0) }
    }
}

/// The motion of a whole layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LayerMotion {
    /// A motion to the next frame, px, x right and y down.
    Px([f32; 2]),
    /// The median of the footage's motion where the object is.
    OfFootage,
}

/// Replaces the lenses by the blur that each finds at a place of its own frames, px: an object is then as blurred as what is seen there,
/// whatever its depth. Messages call the models `name`.
///
/// # Errors
/// If a lens is unknown, or its model holds no depth at this place.
pub fn matched_at(track: CameraTrack, name: &str, place: [f32; 2]) -> Result<CameraTrack> {
    let matched = |f: &TrackedCamera| {
        let mut camera = f.camera.clone();
        let lens = camera.defocus.known().copied();
        let lens =
            lens.ok_or_else(|| blindaug::Error::new("its lens is unknown, so that no place has a blur to match: set the focus and the blur by hand, or estimate the camera from footage that tells them"))?;
        let sigma = lens.sigma_px(camera.depth_at(place)?);
        let curve = DefocusCurve::Quadratic { a: 0.0, b: 0.0, c: sigma, inverse_depth_range: [0.0, 1.0] };
        let constant = DefocusModel::given(curve, DepthKind::Metric);
        camera.defocus = Estimate::Known(DefocusModel { bokeh: lens.bokeh, ..constant });
        Ok(TrackedCamera { camera, ..*f })
    };
    let frames: blindaug::Result<Vec<TrackedCamera>> = track.frames().iter().map(matched).collect();
    frames.and_then(CameraTrack::from_frames).map_err(|error| Error::Clip { clip: name.into(), error })
}

/// The median of finite values; `None` if there are none.
fn median(values: impl Iterator<Item = f32>) -> Option<f32> {
    let mut values: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// The places of a layer's object in the frame, as indices of the frame's pixels.
fn places(layer: &VirtualLayer, overscan: Overscan) -> impl Iterator<Item = usize> + '_ {
    let color = &layer.color.0;
    let (width, height) = overscan.frame_size(color.size());
    (0..height).flat_map(move |y| {
        let row = color.row(overscan.top + y)[overscan.left..][..width].iter().enumerate();
        row.filter(|(_, p)| p[3] >= 0.5).map(move |(x, _)| y * width + x)
    })
}

impl Scene {
    /// Footage with a virtual object, of whose scene nothing else is known.
    pub fn new(footage: Box<dyn Clip>, layers: BoxedSide<FrameLayer>) -> Self {
        let (depth, flow, renders, holdout) = (None, None, None, None);
        Self { footage, layers, depth, flow, renders, holdout, layer_depth: None, layer_motion: None }
    }

    /// Fails if a part of the scene has nothing for any of the frames.
    ///
    /// # Errors
    /// [`Error::NoMatch`] names the part.
    pub fn check(&self) -> Result<()> {
        let Self { footage, layers, depth, flow, renders, holdout, .. } = self;
        let clip = &**footage;
        check_match(clip, Some(&**layers))?;
        check_match(clip, depth.as_ref().map(|d| &*d.maps))?;
        check_match(clip, flow.as_ref().map(|f| &**f))?;
        check_match(clip, holdout.as_ref().map(|m| &**m))?;
        renders.iter().flatten().try_for_each(|r| check_match(clip, Some(&**r)))
    }

    /// When what is given beside the footage for this frame was changed, as far as that is known.
    fn changed_beside(&self, number: u64) -> Vec<SystemTime> {
        let renders = self.renders.iter().flatten().map(|renders| renders.changed(number));
        let depth = self.depth.as_ref().and_then(|maps| maps.changed(number));
        let others = [
            self.layers.changed(number),
            depth,
            changed(self.flow.as_ref(), number),
            changed(self.holdout.as_ref(), number),
        ];
        renders.chain(others).flatten().collect()
    }

    /// Reads the data of a frame beside its layer, and warns about missing data.
    fn around(
        &self,
        frame: &Frame,
        neighbours: &Neighbours,
        (layer, overscan): (&mut VirtualLayer, Overscan),
        applied: &Applied,
        missing: &mut Missing,
    ) -> Result<Around> {
        let (number, size) = (frame.number, self.footage.size());
        let inverse_depth = match &self.depth {
            Some(maps) => maps.get(number, size)?,
            None => None,
        };
        let no_depth = self.depth.is_some() && !inverse_depth.as_ref().is_some_and(has_reading);
        missing.check(no_depth, number, "no real depth", "the object is not occluded");
        let renders = match &self.renders {
            Some([with, without]) => with.get(number, size)?.zip(without.get(number, size)?),
            None => None,
        };
        let renders = renders.map(|(a, b)| [a, b].map(|r| r.to_linear(Transfer::Srgb)));
        let no_renders = self.renders.is_some() && renders.is_none();
        missing.check(no_renders, number, "no renders with and without it", "the object casts no shadows");
        let flow = match &self.flow {
            Some(flow) => flow.get(number, size)?,
            None if applied.finds_flow => neighbours.flow(frame)?,
            None => None,
        };
        let holdout = match &self.holdout {
            Some(mattes) => mattes.get(number, size)?,
            None => None,
        };
        let no_matte = self.holdout.is_some() && holdout.is_none();
        missing.check(no_matte, number, "no matte", "the object is not held out");
        let alone = layer.color.share_of_light_alone();
        missing.check(
            alone > MUCH_LIGHT_ALONE,
            number,
            &format!("{:.0} % of its virtual layer is light where alpha is 0", 100.0 * alone),
            "light without alpha is added, as that of fire is (if the layer's alpha is straight, premultiply it)",
        );
        self.complete(layer, overscan, (inverse_depth.as_ref(), flow.as_ref()));
        let is_seen = || layer.color.0.data().iter().any(|p| p[3] > 0.0);
        let no_flow = match &layer.flow {
            None => Some("its virtual layer has no motion (--layer-motion gives it one)"),
            Some(f) => (f.data().iter().flatten().all(|v| !v.is_finite()) && is_seen())
                .then_some("the motion of its virtual layer is no number anywhere"),
        };
        let no_z = match &layer.inverse_depth {
            None => Some("its virtual layer has no Z (--layer-depth gives it one)"),
            Some(d) => (!has_reading(d) && is_seen())
                .then_some("the Z of its virtual layer is no distance anywhere (above 0, below 1e9 m)"),
        };
        for (needed, lacks, effect) in [
            (applied.moving, no_flow, "the object gets no motion blur"),
            (applied.defocused, no_z, "the object gets no defocus"),
            (self.depth.is_some(), no_z, "the object is not occluded"),
        ] {
            missing.check(needed && lacks.is_some(), number, lacks.unwrap_or_default(), effect);
        }
        Ok(Around { inverse_depth, flow, renders, holdout })
    }

    /// Gives a layer the depth and the motion that it lacks, of those that the scene has for it.
    fn complete(
        &self,
        layer: &mut VirtualLayer,
        overscan: Overscan,
        (depth, flow): (Option<&Plane>, Option<&Flow>),
    ) {
        let (w, h) = layer.color.0.size();
        if layer.inverse_depth.is_none() {
            let inverse = match self.layer_depth {
                Some(LayerDepth::Metres(metres)) => Some(1.0 / metres),
                Some(LayerDepth::OfFootage) => {
                    depth.and_then(|d| median(places(layer, overscan).map(|i| d.data()[i])))
                }
                None => None,
            };
            layer.inverse_depth = inverse.map(|d| Plane::filled(w, h, d));
        }
        if layer.flow.is_none() {
            let motion = match self.layer_motion {
                Some(LayerMotion::Px(motion)) => Some(motion),
                Some(LayerMotion::OfFootage) => flow.and_then(|f| {
                    let of = |c: usize| median(places(layer, overscan).map(|i| f.data()[i][c]));
                    Some([of(0)?, of(1)?])
                }),
                None => None,
            };
            layer.flow = motion.map(|v| Flow::filled(w, h, v));
        }
    }
}

/// The blurs that are applied in any frame, and whether flow is estimated.
struct Applied {
    moving: bool,
    defocused: bool,
    finds_flow: bool,
}

/// The data of a frame beside its layer.
struct Around {
    inverse_depth: Option<Plane>,
    flow: Option<Flow>,
    /// The renders of the scene with the object and without it.
    renders: Option<[Linear; 2]>,
    holdout: Option<Plane>,
}

/// What is made of each frame of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Product {
    /// The composite.
    #[default]
    Composite,
    /// What the composite adds to the frame, apart, for a compositing program.
    Layer,
}

/// Composites every frame of a scene that the sink does not have yet.
///
/// # Errors
/// If a frame or its accompanying data cannot be used, memory does not suffice, or the sink fails.
pub fn composite(
    scene: &Scene,
    track: &CameraTrack,
    (options, product): (&CompositeOptions, Product),
    sink: &mut dyn Sink,
    observer: &dyn Observer,
) -> Result<Made> {
    let Scene { footage, layers, depth, flow, renders, .. } = scene;
    let clip = &**footage;
    let moving = track.why_unknown(Distortion::MotionBlur).is_none();
    let applied = Applied {
        moving,
        defocused: track.why_unknown(Distortion::Defocus).is_none(),
        finds_flow: moving
            && flow.is_none()
            && (renders.is_some() || scene.layer_motion == Some(LayerMotion::OfFootage)),
    };
    let mut missing = Missing::new(observer);
    let mut without_layer = vec![];
    // The result is in memory beside the frames that are read.
    let frames = if applied.finds_flow { 4 * FRAME } else { 2 * FRAME };
    let shadows = if renders.is_some() { RENDERS + FLOW } else { 0 };
    let mattes = if scene.holdout.is_some() { DEPTH } else { 0 };
    let apart = if product == Product::Layer { DISTORTED_LAYER } else { 0 };
    let given = frames + LAYER + apart + shadows + mattes + if depth.is_some() { DEPTH } else { 0 };
    check_memory(clip, given, applied.finds_flow, 0)?;
    let finds_flow = applied.finds_flow;
    let beside = |n: u64| scene.changed_beside(n);
    let make = |frame: &Frame, neighbours: &Neighbours, sink: &mut dyn Sink| {
        let number = frame.number;
        let Some(FrameLayer { mut layer, overscan }) = layers.get(number, clip.size())? else {
            without_layer.push(number);
            return match product {
                Product::Composite => sink.put(&frame.image.0),
                Product::Layer => sink.put_layer(&DistortedLayer::empty(clip.size())),
            };
        };
        let around = scene.around(frame, neighbours, (&mut layer, overscan), &applied, &mut missing)?;
        let plate = Plate {
            overscan,
            inverse_depth: around.inverse_depth.as_ref(),
            flow: around.flow.as_ref(),
            with_and_without: around.renders.as_ref().map(|[with, without]| (with, without)),
            holdout: around.holdout.as_ref(),
            ..Plate::new(&frame.image, number)
        };
        let model = track.at(number);
        let of_frame = |e| of_frame(clip, number, e);
        let work = composite::bytes_beside(&plate, &layer, &model, options).map_err(of_frame)?;
        check_memory(clip, given, false, work + beyond_frame(&layer, clip.size(), LAYER + apart))?;
        match product {
            Product::Composite => {
                sink.put(&composite::composite(&plate, &layer, &model, options).map_err(of_frame)?.0)
            }
            Product::Layer => sink
                .put_layer(&composite::distorted_layer(&plate, &layer, &model, options).map_err(of_frame)?),
        }
    };
    let made = for_each_frame("compositing", (clip, &beside), sink, finds_flow, observer, make);
    // Also after an error, since the frames before it stay.
    warn(observer, clip.warning());
    warn(observer, layers.warning());
    renders.iter().flatten().for_each(|side| warn(observer, side.warning()));
    scene.holdout.iter().for_each(|side| warn(observer, side.warning()));
    let made = made?;
    match &without_layer[..] {
        [] => {}
        [one] => observer.warning(&format!("frame {one} has no virtual layer and is left as it is")),
        some => observer
            .warning(&format!("frames {} have no virtual layer and are left as they are", in_words(some))),
    }
    Ok(made)
}

/// The bytes that a layer takes beyond a frame of this size, where a pixel takes so many.
fn beyond_frame(layer: &VirtualLayer, frame: (usize, usize), per_pixel: u64) -> u64 {
    let [all, within] = [layer.color.0.size(), frame].map(|(w, h)| (w * h) as u64);
    per_pixel * all.saturating_sub(within)
}

/// A rendered clip with its depth and flow.
pub struct Rendered {
    /// The clip.
    pub clip: Box<dyn Clip>,
    /// The frames with their alpha, if they have it and it is to be kept: their colour is then premultiplied.
    pub layers: Option<BoxedSide<FrameLayer>>,
    /// Inverse depth and its kind.
    pub depth: Option<(BoxedSide<Plane>, DepthKind)>,
    /// Optical flow to the next frame, px; estimated if not given.
    pub flow: Option<BoxedSide<Flow>>,
}

/// The application of a camera's distortions to a rendered clip, with depth and lens in one unit.
pub struct Application {
    clip: Box<dyn Clip>,
    layers: Option<BoxedSide<FrameLayer>>,
    depth: Option<DepthMaps>,
    flow: Option<BoxedSide<Flow>>,
    track: CameraTrack,
    /// Whether motion blur is applied.
    moving: bool,
    /// Whether the lens is over metric inverse depth, as the depth of layers is.
    metric: bool,
}

/// Brings a rendered clip's depth and a camera's lens to one unit. Messages call the camera `name`.
///
/// # Errors
/// If depth and lens are in units that do not relate, or memory does not suffice.
pub fn applying(
    rendered: Rendered,
    (track, name): (CameraTrack, &str),
    scale: Option<SceneScale>,
    observer: &dyn Observer,
) -> Result<Application> {
    let Rendered { clip, layers, depth, flow } = rendered;
    let metric =
        !matches!(depth, Some((_, DepthKind::Relative))) || track.depth_kind() != Some(DepthKind::Relative);
    let (depth, track) = match (depth, track.depth_kind()) {
        (Some((maps, DepthKind::Relative)), Some(DepthKind::Relative)) => {
            // Depth and model are taken to be in the same unit, whatever it is.
            let same = SceneScale { scale: 1.0, offset: 0.0 };
            (Some(DepthMaps::as_they_are(maps)), track.to_metric(same))
        }
        (Some((maps, kind)), _) => {
            let track = in_metres(track, name, scale)?;
            (Some(DepthMaps::in_metres(maps, kind, scale)?), track)
        }
        (None, known) => {
            if known.is_some() {
                observer.warning("without depth nothing is defocused");
            }
            let without = |mut m: CameraModel| {
                m.defocus = Estimate::unknown(Reason::NoDepth, "there is no depth");
                m
            };
            (None, track.map(without))
        }
    };
    let moving = track.why_unknown(Distortion::MotionBlur).is_none();
    let finds_flow = moving && flow.is_none() && clip.len_hint() != Some(1);
    let given = if finds_flow { 3 * FRAME } else { FRAME } + if moving { FLOW } else { 0 };
    let work = synth::bytes_beside(clip.size(), depth.is_some());
    let with_alpha = if layers.is_some() { LAYER + WITH_ALPHA } else { 0 };
    let given = given + with_alpha + if depth.is_some() { DEPTH } else { 0 };
    check_memory(&*clip, given, finds_flow, work)?;
    Ok(Application { clip, layers, depth, flow, track, moving, metric })
}

impl Application {
    /// Makes every frame that the sink does not have yet.
    ///
    /// # Errors
    /// If a frame or its accompanying data cannot be used, or the sink fails.
    pub fn run(
        &self,
        options: &SynthesisOptions,
        sink: &mut dyn Sink,
        observer: &dyn Observer,
    ) -> Result<Made> {
        let Self { clip, layers, depth, flow, track, moving, metric } = self;
        let (clip, moving) = (&**clip, *moving);
        let mut missing = Missing::new(observer);
        let neighbours = moving && flow.is_none();
        let beside = |n: u64| {
            let depth = depth.as_ref().and_then(|maps| maps.changed(n));
            [depth, changed(layers.as_ref(), n), changed(flow.as_ref(), n)].into_iter().flatten().collect()
        };
        let make = |frame: &Frame, neighbours: &Neighbours, sink: &mut dyn Sink| {
            let (number, size) = (frame.number, clip.size());
            let flow = match flow {
                Some(flow) => flow.get(number, size)?,
                None if moving => neighbours.flow(frame)?,
                None => None,
            };
            missing.check(moving && flow.is_none(), number, "no flow", "the object is not motion-blurred");
            let inverse_depth = match depth {
                Some(maps) => maps.get(number, size)?,
                None => None,
            };
            let no_depth = depth.is_some() && inverse_depth.is_none();
            missing.check(no_depth, number, "no depth", "the object is not defocused");
            let model = track.at(number);
            let layer = match layers {
                Some(layers) => layers.get(number, size)?,
                None => None,
            };
            if let Some(FrameLayer { layer: own, overscan }) = layer {
                let layer = VirtualLayer {
                    inverse_depth: around(inverse_depth, own.inverse_depth.filter(|_| *metric), overscan),
                    flow: around(flow, own.flow, overscan),
                    color: own.color,
                };
                check_memory(clip, 0, false, beyond_frame(&layer, size, LAYER + WITH_ALPHA))?;
                let distorted = distorted_with_alpha(&layer, overscan, &model, (options, number));
                let (picture, alpha) = distorted.map_err(|e| of_frame(clip, number, e))?;
                return sink.put_with_alpha(&picture, &alpha, overscan);
            }
            distorted_strips(&frame.image, &model, inverse_depth.as_ref(), flow.as_ref(), options, number)
                .map_err(|e| of_frame(clip, number, e))?
                .try_for_each(|strip| sink.put(&strip))
        };
        let made = for_each_frame("applying", (clip, &beside), sink, neighbours, observer, make);
        // Layers are the clip's own files, of which they know the alpha, too.
        warn(observer, layers.as_ref().map_or_else(|| clip.warning(), |layers| layers.warning()));
        made
    }
}

/// What is known of a frame and, beyond it, of the layer itself; where that does not tell it either, the frame's edge is repeated.
fn around<T: Copy + Default + Send + Sync>(
    of_frame: Option<Raster<T>>,
    own: Option<Raster<T>>,
    overscan: Overscan,
) -> Option<Raster<T>> {
    let of_frame = of_frame?;
    if overscan.is_none() {
        return Some(of_frame);
    }
    let mut whole = own.unwrap_or_else(|| overscan.continued(&of_frame));
    overscan.put_frame(&of_frame, &mut whole);
    Some(whole)
}

/// A rendered frame with alpha as the camera would have filmed it, premultiplied, and its alpha: the layer that a composite would lay over
/// black, so that both are blurred past the silhouette.
fn distorted_with_alpha(
    layer: &VirtualLayer,
    overscan: Overscan,
    model: &CameraModel,
    (options, number): (&SynthesisOptions, u64),
) -> blindaug::Result<(Encoded, Plane)> {
    let &SynthesisOptions { bokeh, no_noise, seed, unclipped } = options;
    let (width, height) = layer.color.0.size();
    let frame = overscan.frame_size((width, height));
    let black = Encoded(Raster::filled(frame.0, frame.1, [0.0; 3]));
    let plate = Plate { overscan, ..Plate::new(&black, number) };
    let options = CompositeOptions { naive: false, no_noise, bokeh, seed, unclipped };
    let DistortedLayer { color, noise, .. } = composite::distorted_layer(&plate, layer, model, &options)?;
    let light = Linear(Raster::from_fn(width, height, |x, y| {
        let (c, n) = (color.0.at(x, y), noise.at(x, y));
        std::array::from_fn(|i| c[i] + n[i])
    }));
    Ok((light.to_encoded(model.transfer), color.0.map(|p| p[3])))
}

#[cfg(feature = "files")]
impl crate::Side<FrameLayer> for blindaug_io::SideFolder<blindaug_io::VirtualLayerFile> {
    fn name(&self) -> String {
        blindaug_io::Error::shown_path(self.path())
    }

    fn has(&self, number: u64) -> bool {
        self.has(number)
    }

    fn get(&self, number: u64, size: (usize, usize)) -> Result<Option<FrameLayer>> {
        let read = self.get(number, size)?;
        Ok(read.map(|file| {
            let blindaug_io::VirtualLayerFile { color, inverse_depth, flow, overscan, .. } = file;
            FrameLayer { layer: VirtualLayer { color, inverse_depth, flow }, overscan }
        }))
    }

    fn changed(&self, number: u64) -> Option<SystemTime> {
        self.changed(number)
    }

    fn warning(&self) -> Option<String> {
        self.warning()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{footage::AlteredClip, observer::Silent};
    use blindaug::model::DefocusModel;

    #[test]
    fn numbers_of_frames_are_told_in_runs() {
        assert_eq!(in_words(&[3]), "3");
        assert_eq!(in_words(&[3, 4, 5, 9]), "3 to 5, 9");
        assert_eq!(in_words(&[1, 3, 5, 7, 9, 11, 12]), "1, 3, 5, 7, 9, ... (7 in all)");
    }

    #[test]
    fn a_camera_takes_the_shape_of_the_plate_s_pixels() {
        let clip = |width, aspect| {
            let frames = vec![Encoded(Raster::filled(width, 48, [0.5; 3]))];
            AlteredClip { pixel_aspect: Some(aspect), ..AlteredClip::of(frames) }
        };
        let camera = |width, pixel_aspect| {
            let capture = Capture { width, height: 48, fps: None, frames_used: 1, pixel_aspect };
            let mut model = CameraModel::unknown(capture, "not needed");
            model.defocus = Estimate::Known(DefocusModel::given_lens(2.0, 0.5));
            model
        };
        let fitted = |model: CameraModel, clip: &AlteredClip| {
            let (track, _) = fitted_to(model.into(), "camera", clip, &Fitting::default(), &Silent).unwrap();
            let model = track.at(1);
            (model.capture.pixel_aspect, model.defocus.known().unwrap().sigma_px(0.0))
        };
        assert_eq!(fitted(camera(64, 1.0), &clip(64, 1.0)), (1.0, 2.0));
        // The camera's pixels are those of the plate, though the camera does not know their shape.
        let (aspect, sigma) = fitted(camera(64, 1.0), &clip(64, 2.0));
        assert!(aspect == 2.0 && (sigma - 2.0 / (0.5f32 * 1.25).sqrt()).abs() < 1e-4, "{sigma}");
        // The camera knows it.
        assert_eq!(fitted(camera(64, 2.0), &clip(64, 2.0)), (2.0, 2.0));
        // A camera of the same view in square pixels.
        assert_eq!(fitted(camera(128, 1.0), &clip(64, 2.0)), (2.0, 2.0));
    }
}
