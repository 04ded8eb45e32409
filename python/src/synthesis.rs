//! `blindaug.apply` and `blindaug.composite`.

use crate::{
    camera::Camera,
    failure::{of, one_of},
    listener::Listener,
    pixels::{self, DepthUnit, Kind},
};
use blindaug::{
    Encoded, Flow, Frame, Plane, Raster, Transfer,
    colour_space::ColourSpace,
    composite::{CompositeOptions, DistortedLayer, VirtualLayer},
    model::CameraTrack,
    synth::SynthesisOptions,
};
use blindaug_io::memory;
use blindaug_pipeline::{
    BoxedSide, Clip, MemorySink, Result, Sink,
    composite::{
        DepthMaps, Fitting, FrameLayer, LayerDepth, LayerMotion, Product, Rendered, Scene, UnknownExposure,
        applying, composite as job, fitted_to, in_metres, naive,
    },
    footage::Frames,
};
use numpy::PyUntypedArray;
use pyo3::{prelude::*, types::PyDict};
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
    /// A frame, encoded as the camera's noise has it, if there is a camera.
    fn new(
        value: &Bound<'_, PyAny>,
        (name, number): (&'static str, Option<u64>),
        colour_space: Option<&str>,
        camera: Option<&Camera>,
    ) -> PyResult<Self> {
        let space = match colour_space {
            Some(name) => pixels::colour_space(name, "colour_space")?,
            None => ColourSpace::SRGB,
        };
        let transfer = camera.map_or(space.transfer.worked_on(), |camera| camera.model.transfer);
        let (image, kind) = pixels::frame(value, name, (space, transfer), true)?;
        let number = number.or(camera.and_then(|camera| camera.tracked).map(|t| t.0)).unwrap_or(1);
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
    fn fitted(&self, camera: &Camera, fitting: &Fitting, listener: &Listener) -> Result<CameraTrack> {
        Ok(fitted_to(camera.model.clone().into(), "cam", &self.clip, fitting, listener)?.0)
    }
}

/// What is applied of an unknown exposure.
fn unknown_exposure(name: &str) -> PyResult<UnknownExposure> {
    one_of("unknown", name, &[("leave", UnknownExposure::Left), ("middle", UnknownExposure::Middle)])
}

/// Keeps the last layer.
#[derive(Default)]
struct LayerSink(Option<DistortedLayer>);

impl Sink for LayerSink {
    fn begin(&mut self, _: u64, _: (usize, usize)) -> Result<()> {
        Ok(())
    }

    fn put(&mut self, _: &Raster<[f32; 3]>) -> Result<()> {
        Ok(())
    }

    fn put_layer(&mut self, layer: &DistortedLayer) -> Result<()> {
        self.0 = Some(layer.clone());
        Ok(())
    }

    fn end(&mut self) -> Result<()> {
        Ok(())
    }

    fn abandon(&mut self) {}
}

/// The arrays of a layer by their names.
fn layer_arrays<'py>(py: Python<'py>, layer: &DistortedLayer) -> PyResult<Bound<'py, PyAny>> {
    fn array<'py, const N: usize>(py: Python<'py>, raster: &Raster<[f32; N]>) -> PyResult<Bound<'py, PyAny>> {
        let (width, height) = raster.size();
        pixels::shaped(py, raster.data().as_flattened().to_vec(), &[height, width, N])
    }
    let plane = |plane: &Plane, of: fn(f32) -> f32| {
        let (width, height) = plane.size();
        pixels::shaped(py, plane.data().iter().map(|v| of(*v)).collect(), &[height, width])
    };
    let arrays = PyDict::new(py);
    arrays.set_item("layer", array(py, &layer.color.0)?)?;
    arrays.set_item("noise", array(py, &layer.noise)?)?;
    arrays.set_item("holdout", plane(&layer.holdout, |v| v)?)?;
    arrays.set_item("depth", plane(&layer.inverse_depth, |d| if d > 0.0 { 1.0 / d } else { f32::NAN })?)?;
    arrays.set_item("motion", array(py, &layer.flow)?)?;
    Ok(arrays.into_any())
}

fn made_of(sink: MemorySink) -> Option<Encoded> {
    sink.frames.into_values().next()
}

/// A sharp, noise-free frame as the camera would have filmed it.
#[pyfunction]
#[pyo3(signature = (rgb, cam, *, depth = None, flow = None, number = None, seed = 0, noise = true, unknown = "leave",
    colour_space = None, depth_kind = "metric"))]
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
    unknown: &str,
    colour_space: Option<&str>,
    depth_kind: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let (cam, listener) = (cam.get(), Listener::new(None)?);
    let fitting = Fitting { unknown: unknown_exposure(unknown)?, ..Fitting::default() };
    let given = Given::new(rgb, ("rgb", number), colour_space, Some(cam))?;
    let (size, unit) = (given.size(), DepthUnit::named(depth_kind)?);
    let depth = depth.map(|d| pixels::depth(d, "depth", size, unit)).transpose()?;
    let flow = flow.map(|f| pixels::flow(f, "flow", size)).transpose()?;
    let options =
        SynthesisOptions { no_noise: !noise, seed, unclipped: given.unclipped(), ..Default::default() };
    let (space, transfer, kind) = (given.space, given.transfer, given.kind);
    let sink = listener.run(py, || {
        let track = given.fitted(cam, &fitting, &listener)?;
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

/// The depth of a layer: a map, one distance for all of it, or that of the footage.
fn layer_depth(
    value: &Bound<'_, PyAny>,
    size: (usize, usize),
) -> PyResult<(Option<Plane>, Option<LayerDepth>)> {
    const NAME: &str = "layer_depth";
    if value.extract::<&str>().is_ok_and(|text| text == "plate") {
        return Ok((None, Some(LayerDepth::OfFootage)));
    }
    if value.cast::<PyUntypedArray>().is_ok() {
        return Ok((Some(pixels::depth(value, NAME, size, DepthUnit::Metres)?), None));
    }
    match value.extract::<f32>() {
        Ok(metres) if metres.is_finite() && metres > 0.0 => Ok((None, Some(LayerDepth::Metres(metres)))),
        _ => Err(of(NAME, "must be an array (H, W), a positive distance in metres, or \"plate\"")),
    }
}

/// The motion of a layer: a map, one for all of it, or that of the footage.
fn layer_motion(
    value: &Bound<'_, PyAny>,
    size: (usize, usize),
) -> PyResult<(Option<Flow>, Option<LayerMotion>)> {
    const NAME: &str = "layer_motion";
    if value.extract::<&str>().is_ok_and(|text| text == "plate") {
        return Ok((None, Some(LayerMotion::OfFootage)));
    }
    match value.extract::<(f32, f32)>() {
        Ok((u, v)) if u.is_finite() && v.is_finite() => Ok((None, Some(LayerMotion::Px([u, v])))),
        Ok(_) => Err(of(NAME, "must be finite numbers, in px")),
        Err(_) => Ok((Some(pixels::flow(value, NAME, size)?), None)),
    }
}

/// A layer over a frame as if the camera had filmed it.
#[pyfunction]
#[pyo3(signature = (frame, layer, cam, *, layer_depth = None, layer_motion = None, depth = None, flow = None, with_ = None,
    without = None, holdout = None, match_at = None, number = None, seed = 0, noise = true, unknown = "leave", product = "composite",
    colour_space = None, layer_colour_space = None))]
#[allow(clippy::too_many_arguments, reason = "these are the keyword arguments of a function in Python")]
pub fn composite<'py>(
    py: Python<'py>,
    frame: &Bound<'py, PyAny>,
    layer: &Bound<'py, PyAny>,
    cam: Option<&Bound<'py, Camera>>,
    layer_depth: Option<&Bound<'py, PyAny>>,
    layer_motion: Option<&Bound<'py, PyAny>>,
    depth: Option<&Bound<'py, PyAny>>,
    flow: Option<&Bound<'py, PyAny>>,
    with_: Option<&Bound<'py, PyAny>>,
    without: Option<&Bound<'py, PyAny>>,
    holdout: Option<&Bound<'py, PyAny>>,
    match_at: Option<(f32, f32)>,
    number: Option<u64>,
    seed: u64,
    noise: bool,
    unknown: &str,
    product: &str,
    colour_space: Option<&str>,
    layer_colour_space: Option<&str>,
) -> PyResult<Bound<'py, PyAny>> {
    let (cam, listener) = (cam.map(|cam| cam.get()), Listener::new(None)?);
    let product =
        one_of("product", product, &[("composite", Product::Composite), ("layer", Product::Layer)])?;
    if match_at.is_some_and(|(x, y)| !(x.is_finite() && y.is_finite())) {
        return Err(of("match_at", "must be a place, x and y in px"));
    }
    let match_at = match_at.map(|(x, y)| [x, y]);
    let fitting = Fitting { match_at, unknown: unknown_exposure(unknown)?, ..Fitting::default() };
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
    let holdout = holdout.map(|m| pixels::matte(m, "holdout", size)).transpose()?;
    let any_depth = any_depth.flatten().or(match_at.map(|_| LayerDepth::any(depth.is_some())));
    if any_depth == Some(LayerDepth::OfFootage) && depth.is_none() {
        return Err(of(
            "layer_depth",
            "needs the depth of the frame to be \"plate\": give depth, or a distance",
        ));
    }
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
    let (frames, layers) = listener.run(py, || {
        let track = match cam {
            Some(cam) => in_metres(given.fitted(cam, &fitting, &listener)?, "cam", None)?,
            None => naive(size, transfer).into(),
        };
        let layers = given.side(FrameLayer::from(layer));
        let scene = Scene {
            depth: depth.map(|d| DepthMaps::as_they_are(given.side(d))),
            flow: flow.map(|f| given.side(f)),
            renders: renders.map(|both| both.map(|r| given.side(r))),
            holdout: holdout.map(|m| given.side(m)),
            layer_depth: any_depth,
            layer_motion: any_motion.flatten(),
            ..Scene::new(Box::new(given.clip), layers)
        };
        let (mut frames, mut layers) = (MemorySink::default(), LayerSink::default());
        let sink: &mut dyn Sink = match product {
            Product::Composite => &mut frames,
            Product::Layer => &mut layers,
        };
        job(&scene, &track, (&options, product), sink, &listener)?;
        Ok((frames, layers))
    })?;
    if let Some(layer) = layers.0 {
        return layer_arrays(py, &layer);
    }
    let frame = made_of(frames).ok_or_else(|| of("frame", "no frame was made"))?;
    pixels::frame_array(py, &frame, (space, transfer), kind)
}
