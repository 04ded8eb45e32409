//! `blindaug.apply` and `blindaug.composite`.

use crate::{
    camera::Camera,
    failure::of,
    listener::Listener,
    pixels::{self, DepthUnit, Kind},
};
use blindaug::{
    Encoded, Flow, Frame, Plane, Transfer,
    colour_space::ColourSpace,
    composite::{CompositeOptions, VirtualLayer},
    model::CameraTrack,
    synth::SynthesisOptions,
};
use blindaug_io::memory;
use blindaug_pipeline::{
    BoxedSide, Clip, MemorySink, Result,
    composite::{
        DepthMaps, Fitting, LayerDepth, LayerMotion, Product, Rendered, Scene, applying, composite as job,
        fitted_to, in_metres,
    },
    footage::Frames,
};
use numpy::PyUntypedArray;
use pyo3::prelude::*;
use std::{collections::BTreeMap, path::Path};

/// One frame as a clip.
struct OneFrame {
    name: &'static str,
    frame: Frame,
}

impl Clip for OneFrame {
    fn name(&self) -> String {
        self.name.into()
    }

    fn size(&self) -> (usize, usize) {
        self.frame.image.0.size()
    }

    fn fps(&self) -> Option<f64> {
        None
    }

    fn len_hint(&self) -> Option<usize> {
        Some(1)
    }

    fn frames_if<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> Frames<'a> {
        Box::new(wanted(self.frame.number).then(|| Ok(self.frame.clone())).into_iter())
    }

    fn check_memory(&self, what: &str, bytes: u64) -> Result<()> {
        Ok(memory::fits(Path::new(self.name), what, bytes)?)
    }
}

/// A frame that was handed in, and how it is handed back.
struct Given {
    clip: OneFrame,
    space: ColourSpace,
    transfer: Transfer,
    kind: Kind,
}

impl Given {
    /// A frame, encoded as the camera's noise has it.
    fn new(
        value: &Bound<'_, PyAny>,
        (name, number): (&'static str, Option<u64>),
        colour_space: Option<&str>,
        camera: &Camera,
    ) -> PyResult<Self> {
        let space = match colour_space {
            Some(name) => pixels::colour_space(name, "colour_space")?,
            None => ColourSpace::SRGB,
        };
        let transfer = camera.model.transfer;
        let (image, kind) = pixels::frame(value, name, (space, transfer), true)?;
        let number = number.or(camera.tracked.map(|t| t.0)).unwrap_or(1);
        Ok(Self { clip: OneFrame { name, frame: Frame { number, image } }, space, transfer, kind })
    }

    fn size(&self) -> (usize, usize) {
        self.clip.size()
    }

    /// Whether values above white are kept.
    fn unclipped(&self) -> bool {
        self.kind.is_float() && self.space.transfer == Transfer::Linear
    }

    fn side<T: Clone + Sync + 'static>(&self, value: T) -> BoxedSide<T> {
        Box::new(BTreeMap::from([(self.clip.frame.number, value)]))
    }

    /// The camera for this frame.
    fn fitted(&self, camera: &Camera, listener: &Listener) -> Result<CameraTrack> {
        let track = camera.model.clone().into();
        Ok(fitted_to(track, "cam", &self.clip, &Fitting::default(), listener)?.0)
    }
}

fn made_of(sink: MemorySink) -> Option<Encoded> {
    sink.frames.into_values().next()
}

/// A sharp, noise-free frame as the camera would have filmed it.
#[pyfunction]
#[pyo3(signature = (rgb, cam, *, depth = None, flow = None, number = None, seed = 0, noise = true, colour_space = None,
    depth_kind = "metric"))]
#[allow(clippy::too_many_arguments, reason = "these are the keyword arguments of a function in Python")]
pub fn apply<'py>(
    py: Python<'py>,
    rgb: &Bound<'py, PyAny>,
    cam: &Bound<'py, Camera>,
    depth: Option<&Bound<'py, PyAny>>,
    flow: Option<&Bound<'py, PyAny>>,
    number: Option<u64>,
    seed: u64,
    noise: bool,
    colour_space: Option<&str>,
    depth_kind: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let (cam, listener) = (cam.get(), Listener::new(None)?);
    let given = Given::new(rgb, ("rgb", number), colour_space, cam)?;
    let (size, unit) = (given.size(), DepthUnit::named(depth_kind)?);
    let depth = depth.map(|d| pixels::depth(d, "depth", size, unit)).transpose()?;
    let flow = flow.map(|f| pixels::flow(f, "flow", size)).transpose()?;
    let options =
        SynthesisOptions { no_noise: !noise, seed, unclipped: given.unclipped(), ..Default::default() };
    let (space, transfer, kind) = (given.space, given.transfer, given.kind);
    let sink = listener.run(py, || {
        let track = given.fitted(cam, &listener)?;
        let depth = depth.map(|d| (given.side(d), unit.kind()));
        let flow = flow.map(|f| given.side(f));
        let rendered = Rendered { clip: Box::new(given.clip), layers: None, depth, flow };
        let job = applying(rendered, (track, "cam"), None, &listener)?;
        let mut sink = MemorySink::default();
        job.run(&options, &mut sink, &listener)?;
        Ok(sink)
    })?;
    let frame = made_of(sink).ok_or_else(|| of("rgb", "no frame was made"))?;
    pixels::frame_array(py, &frame, (space, transfer), kind)
}

/// The depth of a layer: a map, or one distance for all of it.
fn layer_depth(
    value: &Bound<'_, PyAny>,
    size: (usize, usize),
) -> PyResult<(Option<Plane>, Option<LayerDepth>)> {
    const NAME: &str = "layer_depth";
    if value.cast::<PyUntypedArray>().is_ok() {
        return Ok((Some(pixels::depth(value, NAME, size, DepthUnit::Metres)?), None));
    }
    match value.extract::<f32>() {
        Ok(metres) if metres.is_finite() && metres > 0.0 => Ok((None, Some(LayerDepth::Metres(metres)))),
        _ => Err(of(NAME, "must be an array (H, W) or a positive distance, in metres")),
    }
}

/// The motion of a layer: a map, or one for all of it.
fn layer_motion(
    value: &Bound<'_, PyAny>,
    size: (usize, usize),
) -> PyResult<(Option<Flow>, Option<LayerMotion>)> {
    const NAME: &str = "layer_motion";
    match value.extract::<(f32, f32)>() {
        Ok((u, v)) if u.is_finite() && v.is_finite() => Ok((None, Some(LayerMotion::Px([u, v])))),
        Ok(_) => Err(of(NAME, "must be finite numbers, in px")),
        Err(_) => Ok((Some(pixels::flow(value, NAME, size)?), None)),
    }
}

/// A layer over a frame as if the camera had filmed it.
#[pyfunction]
#[pyo3(signature = (frame, layer, cam, *, layer_depth = None, layer_motion = None, depth = None, flow = None, with_ = None,
    without = None, number = None, seed = 0, noise = true, colour_space = None, layer_colour_space = None))]
#[allow(clippy::too_many_arguments, reason = "these are the keyword arguments of a function in Python")]
pub fn composite<'py>(
    py: Python<'py>,
    frame: &Bound<'py, PyAny>,
    layer: &Bound<'py, PyAny>,
    cam: &Bound<'py, Camera>,
    layer_depth: Option<&Bound<'py, PyAny>>,
    layer_motion: Option<&Bound<'py, PyAny>>,
    depth: Option<&Bound<'py, PyAny>>,
    flow: Option<&Bound<'py, PyAny>>,
    with_: Option<&Bound<'py, PyAny>>,
    without: Option<&Bound<'py, PyAny>>,
    number: Option<u64>,
    seed: u64,
    noise: bool,
    colour_space: Option<&str>,
    layer_colour_space: Option<&str>,
) -> PyResult<Bound<'py, PyAny>> {
    let (cam, listener) = (cam.get(), Listener::new(None)?);
    let given = Given::new(frame, ("frame", number), colour_space, cam)?;
    let size = given.size();
    let layer_space = match layer_colour_space {
        Some(name) => pixels::colour_space(name, "layer_colour_space")?,
        None => ColourSpace::LINEAR_SRGB,
    };
    if layer_space.transfer != Transfer::Linear {
        return Err(of("layer_colour_space", "layers hold light: give linear-srgb, acescg or aces2065-1"));
    }
    let spaces = (layer_space, given.space);
    let color = pixels::layer(layer, "layer", size, spaces)?;
    let (inverse_depth, any_depth) = layer_depth.map(|d| self::layer_depth(d, size)).transpose()?.unzip();
    let (motion, any_motion) = layer_motion.map(|m| self::layer_motion(m, size)).transpose()?.unzip();
    let layer = VirtualLayer { color, inverse_depth: inverse_depth.flatten(), flow: motion.flatten() };
    let depth = depth.map(|d| pixels::depth(d, "depth", size, DepthUnit::Metres)).transpose()?;
    let flow = flow.map(|f| pixels::flow(f, "flow", size)).transpose()?;
    let renders = match (with_, without) {
        (Some(with), Some(without)) => Some([
            pixels::render(with, "with_", size, spaces)?,
            pixels::render(without, "without", size, spaces)?,
        ]),
        (None, None) => None,
        (Some(_), None) => return Err(of("without", "must be given too: shadows are told by both renders")),
        (None, Some(_)) => return Err(of("with_", "must be given too: shadows are told by both renders")),
    };
    let options =
        CompositeOptions { no_noise: !noise, seed, unclipped: given.unclipped(), ..Default::default() };
    let (space, transfer, kind) = (given.space, given.transfer, given.kind);
    let sink = listener.run(py, || {
        let track = in_metres(given.fitted(cam, &listener)?, "cam", None)?;
        let layers = given.side(layer);
        let scene = Scene {
            depth: depth.map(|d| DepthMaps::as_they_are(given.side(d))),
            flow: flow.map(|f| given.side(f)),
            renders: renders.map(|both| both.map(|r| given.side(r))),
            layer_depth: any_depth.flatten(),
            layer_motion: any_motion.flatten(),
            ..Scene::new(Box::new(given.clip), layers)
        };
        let mut sink = MemorySink::default();
        job(&scene, &track, (&options, Product::Composite), &mut sink, &listener)?;
        Ok(sink)
    })?;
    let frame = made_of(sink).ok_or_else(|| of("frame", "no frame was made"))?;
    pixels::frame_array(py, &frame, (space, transfer), kind)
}
