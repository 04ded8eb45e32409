//! Arrays of numpy as frames, depth, flow and layers, and frames as arrays.

use crate::failure::{self, of, one_of};
use blindaug::{
    Encoded, Flow, Pixel, Plane, Premultiplied, Raster, Transfer, byte_from_encoded,
    colour_space::{ColourSpace, conversion, converted},
    model::{DepthKind, inverse_of_metric},
    text::one_line,
    word_from_encoded,
};
use blindaug_io::{MAX_SIDE, memory};
use half::f16;
use numpy::{
    Element, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::{prelude::*, types::PyString};
use std::path::Path;

/// The type of an array's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// uint8, 255 is 1.
    U8,
    /// uint16, 65535 is 1.
    U16,
    /// float16.
    F16,
    /// float32.
    F32,
    /// float64.
    F64,
}

impl Kind {
    /// Whether values are floats.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F16 | Self::F32 | Self::F64)
    }
}

/// The array of numpy over the memory of another library's, such as a tensor of PyTorch; `None` if this is no such array, or it cannot be lent.
fn by_dlpack<'py>(value: &Bound<'py, PyAny>, name: &str) -> PyResult<Option<Bound<'py, PyAny>>> {
    /// The memory that the processor reads: its own, and that which it shares with a device of CUDA or ROCm.
    const ON_CPU: [i64; 4] = [1, 3, 11, 13];
    if value.cast::<PyUntypedArray>().is_ok() || !value.hasattr("__dlpack_device__")? {
        return Ok(None);
    }
    let device = value.call_method0("__dlpack_device__").and_then(|d| d.extract::<(i64, i64)>());
    match device {
        Ok((device, _)) if !ON_CPU.contains(&device) => Err(of(
            name,
            "lies in the memory of another device than the CPU: bring it there, by tensor.cpu() (PyTorch), jax.device_get(array) (JAX) or \
             cupy.asnumpy(array) (CuPy)",
        )),
        Ok(_) => Ok(value.py().import("numpy")?.call_method1("from_dlpack", (value,)).ok()),
        Err(_) => Ok(None),
    }
}

/// What is handed in as an array.
fn array<'py>(value: &Bound<'py, PyAny>, name: &str) -> PyResult<Bound<'py, PyUntypedArray>> {
    let py = value.py();
    if value.is_none() || value.is_instance_of::<PyString>() {
        return Err(of(name, format!("must be an array, and is of type {}", value.get_type().name()?)));
    }
    let numpy = py.import("numpy")?;
    let array = match by_dlpack(value, name)? {
        Some(array) => Ok(array),
        None => numpy.call_method1("asarray", (value,)),
    };
    let array = array.map_err(|e| {
        of(name, format!("cannot be taken as an array ({})", one_line(&e.value(py).to_string())))
    })?;
    let mut array = array.cast_into::<PyUntypedArray>().map_err(|_| of(name, "is no array of numpy"))?;
    if array.dtype().is_native_byteorder() == Some(false) {
        let native = array.dtype().call_method1("newbyteorder", ("=",))?;
        array = array.call_method1("astype", (native,))?.cast_into().map_err(PyErr::from)?;
    }
    Ok(array)
}

fn shape_in_words(shape: &[usize]) -> String {
    let sides: Vec<String> = shape.iter().map(usize::to_string).collect();
    format!("({}{})", sides.join(", "), if shape.len() == 1 { "," } else { "" })
}

/// The pixels of an array of this kind of values.
fn values<T: Element + Copy, const N: usize, P>(
    array: &Bound<'_, PyUntypedArray>,
    pixel: impl Fn([T; N]) -> P,
) -> PyResult<Option<Vec<P>>> {
    let Ok(typed) = array.cast::<PyArrayDyn<T>>() else { return Ok(None) };
    let borrowed = typed.try_readonly().map_err(|e| failure::Error::new_err(e.to_string()))?;
    let slice = borrowed.as_slice().map_err(|e| failure::Error::new_err(e.to_string()))?;
    Ok(Some(slice.as_chunks::<N>().0.iter().map(|p| pixel(*p)).collect()))
}

/// The pixels of a picture of N channels, whose shape was checked, and the type of its values.
fn pixels<const N: usize>(
    array: &Bound<'_, PyUntypedArray>,
    name: &str,
    integers: bool,
) -> PyResult<(Vec<[f32; N]>, Kind)> {
    let mut array = array.clone();
    if !array.is_c_contiguous() || !array.is_aligned() {
        let required = array.py().import("numpy")?.call_method1("require", (&array, array.dtype(), "CA"))?;
        array = required.cast_into().map_err(PyErr::from)?;
    }
    if integers {
        let [bytes, words] = [f32::from(u8::MAX), f32::from(u16::MAX)];
        if let Some(of_bytes) = values(&array, |p: [u8; N]| p.map(|v| f32::from(v) / bytes))? {
            return Ok((of_bytes, Kind::U8));
        }
        if let Some(of_words) = values(&array, |p: [u16; N]| p.map(|v| f32::from(v) / words))? {
            return Ok((of_words, Kind::U16));
        }
    }
    if let Some(singles) = values(&array, |p: [f32; N]| p)? {
        return Ok((singles, Kind::F32));
    }
    if let Some(halves) = values(&array, |p: [f16; N]| p.map(f16::to_f32))? {
        return Ok((halves, Kind::F16));
    }
    if let Some(doubles) = values(&array, |p: [f64; N]| p.map(|v| v as f32))? {
        return Ok((doubles, Kind::F64));
    }
    let wanted = if integers { "uint8, uint16 or floats" } else { "floats" };
    Err(of(name, format!("has values of type {}, and must have {wanted}", array.dtype())))
}

/// The width and the height of a picture of so many channels.
fn size_of(
    array: &Bound<'_, PyUntypedArray>,
    name: &str,
    channels: usize,
    what: &str,
) -> PyResult<(usize, usize)> {
    let shape = array.shape();
    let wanted = if channels == 1 { "(H, W)".into() } else { format!("(H, W, {channels})") };
    let fail = |why: &str| {
        let shape = shape_in_words(shape);
        Err(of(name, format!("has the shape {shape}, and {what} has {wanted}{why}")))
    };
    let size = match (shape, channels) {
        ([h, w], 1) | ([h, w, 1], 1) => (*w, *h),
        ([h, w, c], _) if *c == channels => (*w, *h),
        ([_, _], 3) => return fail(": repeat a grey one three times, as by numpy.stack([a] * 3, axis=-1)"),
        ([c, _, _], _) if *c == channels && channels > 1 => {
            return fail(": its channels come first; move them to the end by numpy.moveaxis(a, 0, -1)");
        }
        ([_, _, 4], 3) => return fail(": leave alpha out by a[..., :3]"),
        _ => return fail(""),
    };
    match size {
        (0, _) | (_, 0) => fail(", of at least one pixel"),
        (w, h) if w > MAX_SIDE || h > MAX_SIDE => fail(&format!(", of at most {MAX_SIDE} pixels a side")),
        _ => Ok(size),
    }
}

fn raster<P: Pixel>((width, height): (usize, usize), name: &str, pixels: Vec<P>) -> PyResult<Raster<P>> {
    Raster::from_vec(width, height, pixels).map_err(|e| of(name, e))
}

/// Fails if what belongs to a frame has another size.
pub fn check_size(size: (usize, usize), wanted: (usize, usize), name: &str) -> PyResult<()> {
    let ((w, h), (width, height)) = (size, wanted);
    match size == wanted {
        true => Ok(()),
        false => Err(of(name, format!("has {w} x {h} pixels, but the frame has {width} x {height}"))),
    }
}

/// A frame in a colour space, brought to `transfer`; its values are checked. `below_zero` keeps light below 0, as EXR may have it.
pub fn frame(
    value: &Bound<'_, PyAny>,
    name: &str,
    (space, transfer): (ColourSpace, Transfer),
    below_zero: bool,
) -> PyResult<(Encoded, Kind)> {
    /// Encoded floats above this are taken for numbers that run to 255.
    const MOST: f32 = 64.0;
    let array = array(value, name)?;
    let size = size_of(&array, name, 3, "a frame")?;
    memory::fits(Path::new(name), "the frame", 12 * (size.0 * size.1) as u64).map_err(failure::of_file)?;
    let (pixels, kind) = pixels::<3>(&array, name, true)?;
    let mut frame = raster(size, name, pixels)?;
    if kind.is_float() {
        let values = || frame.data().as_flattened().iter();
        if values().any(|v| !v.is_finite()) {
            return Err(of(name, "holds values that are not finite numbers: replace NaN and infinity"));
        }
        let most = values().fold(0.0, |most: f32, v| most.max(*v));
        if most > MOST && space.transfer != Transfer::Linear {
            return Err(of(
                name,
                format!("holds floats up to {most}, and they must be in [0, 1]: divide them, by 255 perhaps"),
            ));
        }
        if !below_zero || space.transfer != Transfer::Linear {
            frame = frame.map(|p| p.map(|v| v.max(0.0)));
        }
    }
    if space.transfer != transfer {
        frame = frame.map(|p| p.map(|v| transfer.encode(space.transfer.decode(v))));
    }
    Ok((Encoded(frame), kind))
}

/// Inverse depth from a depth map, NaN where it says nothing.
pub fn depth(value: &Bound<'_, PyAny>, name: &str, size: (usize, usize), unit: DepthUnit) -> PyResult<Plane> {
    let plane = plane(value, name, size, false)?;
    let known = |d: f32| if d.is_finite() { d } else { f32::NAN };
    Ok(plane.map(|v| match unit {
        DepthUnit::Metres => inverse_of_metric(v),
        DepthUnit::Inverse | DepthUnit::RelativeInverse => known(if v >= 0.0 { v } else { f32::NAN }),
    }))
}

/// The share of each pixel that a matte shows, in [0, 1]; 0 where it is NaN.
pub fn matte(value: &Bound<'_, PyAny>, name: &str, size: (usize, usize)) -> PyResult<Plane> {
    let share = |v: f32| if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) };
    Ok(plane(value, name, size, true)?.map(share))
}

fn plane(value: &Bound<'_, PyAny>, name: &str, size: (usize, usize), integers: bool) -> PyResult<Plane> {
    let array = array(value, name)?;
    check_size(size_of(&array, name, 1, "it")?, size, name)?;
    let (pixels, _) = pixels::<1>(&array, name, integers)?;
    raster(size, name, pixels.into_iter().map(|[v]| v).collect())
}

/// What a depth map holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthUnit {
    /// Depth along the view axis, m.
    Metres,
    /// Inverse depth, 1/m.
    Inverse,
    /// Inverse depth of unknown scale and offset.
    RelativeInverse,
}

impl DepthUnit {
    /// The unit of this name, as the command line has it.
    pub fn named(name: &str) -> PyResult<Self> {
        let units = [
            ("metric", Self::Metres),
            ("inverse", Self::Inverse),
            ("relative-inverse", Self::RelativeInverse),
        ];
        one_of("depth_kind", name, &units)
    }

    /// The kind of the inverse depth that comes out.
    pub fn kind(self) -> DepthKind {
        match self {
            Self::Metres | Self::Inverse => DepthKind::Metric,
            Self::RelativeInverse => DepthKind::Relative,
        }
    }
}

/// Optical flow, px, NaN where it is unknown.
pub fn flow(value: &Bound<'_, PyAny>, name: &str, size: (usize, usize)) -> PyResult<Flow> {
    let array = array(value, name)?;
    check_size(size_of(&array, name, 2, "it")?, size, name)?;
    let (pixels, _) = pixels::<2>(&array, name, false)?;
    raster(size, name, pixels)
}

/// A premultiplied layer in linear light of one colour space, brought to the primaries of another.
pub fn layer(
    value: &Bound<'_, PyAny>,
    name: &str,
    size: (usize, usize),
    (space, plate): (ColourSpace, ColourSpace),
) -> PyResult<Premultiplied> {
    let array = array(value, name)?;
    check_size(size_of(&array, name, 4, "a layer")?, size, name)?;
    let (mut pixels, _) = pixels::<4>(&array, name, false)?;
    if pixels.iter().flatten().any(|v| !v.is_finite()) {
        return Err(of(name, "holds values that are not finite numbers: replace NaN and infinity"));
    }
    if let Some(m) = conversion(space.primaries, plate.primaries) {
        for p in &mut pixels {
            let [r, g, b] = converted(&m, [p[0], p[1], p[2]]);
            *p = [r, g, b, p[3]];
        }
    }
    Ok(Premultiplied::from_render(&raster(size, name, pixels)?))
}

/// A sharp render of the local scene, as sRGB in the primaries of the plate: integers are sRGB, floats are light of `space`.
pub fn render(
    value: &Bound<'_, PyAny>,
    name: &str,
    size: (usize, usize),
    (space, plate): (ColourSpace, ColourSpace),
) -> PyResult<Encoded> {
    let srgb = Transfer::Srgb;
    let array = array(value, name)?;
    let is_float = array.dtype().kind() == b'f';
    let own = if is_float { space } else { ColourSpace::SRGB };
    let (Encoded(mut image), _) = frame(value, name, (own, srgb), false)?;
    check_size(image.size(), size, name)?;
    if let Some(m) = conversion(own.primaries, plate.primaries) {
        image = image.map(|p| converted(&m, p.map(|v| srgb.decode(v))).map(|v| srgb.encode(v)));
    }
    Ok(Encoded(image))
}

/// The array of a frame, in the colour space and of the type of values of the one that it was made from.
pub fn frame_array<'py>(
    py: Python<'py>,
    frame: &Encoded,
    (space, transfer): (ColourSpace, Transfer),
    kind: Kind,
) -> PyResult<Bound<'py, PyAny>> {
    let values = frame.0.data().as_flattened().iter();
    let values = values.map(|&v| match space.transfer == transfer {
        true => v,
        false => space.transfer.encode(transfer.decode(v)),
    });
    let (width, height) = frame.0.size();
    let shape = [height, width, 3];
    match kind {
        Kind::U8 => shaped(py, values.map(byte_from_encoded).collect(), &shape),
        Kind::U16 => shaped(py, values.map(word_from_encoded).collect(), &shape),
        Kind::F16 => shaped(py, values.map(f16::from_f32).collect(), &shape),
        Kind::F32 => shaped(py, values.collect::<Vec<f32>>(), &shape),
        Kind::F64 => shaped(py, values.map(f64::from).collect(), &shape),
    }
}

/// An array of this shape.
pub fn shaped<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.into_any())
}

/// What a function makes of each number of an array: an array of the same shape, with a further axis if the function gives several numbers. A
/// plain number gives a plain number.
pub fn mapped<'py, const N: usize>(
    value: &Bound<'py, PyAny>,
    name: &str,
    function: impl Fn(f32) -> [f32; N],
) -> PyResult<Bound<'py, PyAny>> {
    let py = value.py();
    let numpy = py.import("numpy")?;
    let numbers = numpy.call_method1("asarray", (value, "float32"));
    let numbers = numbers
        .map_err(|e| of(name, format!("must be a number or an array of numbers ({})", e.value(py))))?;
    let array = numbers.cast_into::<PyUntypedArray>().map_err(|_| of(name, "is no array of numpy"))?;
    let mut shape = array.shape().to_vec();
    let (numbers, _) = pixels::<1>(&array, name, false)?;
    let made: Vec<[f32; N]> = numbers.iter().map(|[v]| function(*v)).collect();
    if N > 1 {
        shape.push(N);
    }
    let made = made.into_flattened();
    match (&shape[..], &made[..]) {
        ([], [v]) => Ok(f64::from(*v).into_pyobject(py)?.into_any()),
        _ => shaped(py, made, &shape),
    }
}

/// The colour space of this name.
pub fn colour_space(name: &str, argument: &str) -> PyResult<ColourSpace> {
    name.parse().map_err(|e| of(argument, e))
}
