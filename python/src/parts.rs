//! The parts of a camera as Python sees them: known with intervals, or unknown with a reason.

use crate::{
    failure::{UnknownError, of},
    pixels::mapped,
};
use blindaug::{
    CameraModel,
    model::{
        DefocusModel, DepthKind, Estimate, Focus, MotionBlurModel, NOISE_LEVELS, NoiseModel, OutsideFocus,
        SharpeningModel, Unknown,
    },
    text::rounded,
};
use pyo3::prelude::*;
use serde_json::json;

/// The number as files have it, with six digits.
pub fn number(v: f32) -> f64 {
    rounded(v).to_string().parse().unwrap_or_else(|_| v.into())
}

/// An interval, low and high.
type Interval = (f64, f64);

fn interval([low, high]: [f32; 2]) -> Interval {
    (number(low), number(high))
}

/// A name as files have it.
fn name(value: serde_json::Value) -> String {
    value.as_str().unwrap_or_default().into()
}

/// The reason why a part is unknown.
fn reason<T>(part: &Estimate<T>) -> Option<String> {
    part.why_unknown().map(Unknown::to_string)
}

/// The reason as a word for programs.
fn reason_code<T>(part: &Estimate<T>) -> Option<String> {
    part.why_unknown().map(|why| name(json!(why.reason)))
}

/// The range of the part's most important number that fits, though the number itself is unknown.
fn fits<T>(part: &Estimate<T>) -> Option<Interval> {
    part.why_unknown().and_then(|why| why.fits).map(interval)
}

fn known<'a, T>(part: &'a Estimate<T>, what: &str) -> PyResult<&'a T> {
    match part {
        Estimate::Known(known) => Ok(known),
        Estimate::Unknown(why) => {
            Err(UnknownError::new_err(format!("the camera's {what} is unknown: {why}")))
        }
    }
}

fn shown(what: &str, value: Option<String>, reason: Option<String>) -> String {
    match (value, reason) {
        (Some(value), _) => format!("<{what} {value}>"),
        (None, Some(why)) => format!("<{what} unknown: {why}>"),
        (None, None) => format!("<{what}>"),
    }
}

fn with_interval(value: f64, unit: &str, interval: Option<Interval>) -> String {
    match interval {
        Some((low, high)) => format!("{value}{unit} [{low}, {high}]"),
        None => format!("{value}{unit}"),
    }
}

/// The shutter: how long it is open, as a share of the frame interval.
#[pyclass(frozen, module = "blindaug")]
pub struct Exposure {
    part: Estimate<MotionBlurModel>,
    fps: Option<f64>,
}

impl Exposure {
    /// The part of this camera.
    pub fn of(camera: &CameraModel) -> Self {
        Self { part: camera.motion_blur.clone(), fps: camera.capture.fps }
    }
}

#[pymethods]
impl Exposure {
    #[getter]
    fn known(&self) -> bool {
        self.part.known().is_some()
    }

    #[getter]
    fn value(&self) -> Option<f64> {
        self.part.known().map(|m| number(m.exposure.0))
    }

    #[getter]
    fn interval(&self) -> Option<Interval> {
        self.part.known().map(|m| interval(m.interval))
    }

    #[getter]
    fn fits(&self) -> Option<Interval> {
        fits(&self.part)
    }

    #[getter]
    fn reason(&self) -> Option<String> {
        reason(&self.part)
    }

    #[getter]
    fn reason_code(&self) -> Option<String> {
        reason_code(&self.part)
    }

    #[getter]
    fn shutter_angle(&self) -> Option<f64> {
        self.part.known().map(|m| number(m.exposure.shutter_angle()))
    }

    #[getter]
    fn phase_degrees(&self) -> Option<f64> {
        self.part.known().and_then(|m| m.phase_degrees).map(number)
    }

    #[getter]
    fn seconds(&self) -> Option<f64> {
        self.part.known().zip(self.fps).map(|(m, fps)| m.exposure.seconds(fps))
    }

    #[getter]
    fn method(&self) -> Option<String> {
        self.part.known().map(|m| name(json!(m.method)))
    }

    #[getter]
    fn samples(&self) -> Option<u64> {
        self.part.known().map(|m| m.samples)
    }

    fn __repr__(&self) -> String {
        shown("Exposure", self.value().map(|v| with_interval(v, "", self.interval())), self.reason())
    }
}

/// The noise of encoded frames.
#[pyclass(frozen, module = "blindaug")]
pub struct Noise(Estimate<NoiseModel>);

impl Noise {
    /// The part of this camera.
    pub fn of(camera: &CameraModel) -> Self {
        Self(camera.noise.clone())
    }
}

#[pymethods]
impl Noise {
    #[getter]
    fn known(&self) -> bool {
        self.0.known().is_some()
    }

    #[getter]
    fn reason(&self) -> Option<String> {
        reason(&self.0)
    }

    #[getter]
    fn reason_code(&self) -> Option<String> {
        reason_code(&self.0)
    }

    /// The std of R, G and B over an even grey of this luminance; of one level of the pyramid, or of all together.
    #[pyo3(signature = (luminance = None, *, level = None), text_signature = "($self, luminance=0.5, *, level=None)")]
    fn std<'py>(
        &self,
        py: Python<'py>,
        luminance: Option<Bound<'py, PyAny>>,
        level: Option<usize>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let noise = known(&self.0, "noise")?;
        if level.is_some_and(|level| level >= NOISE_LEVELS) {
            return Err(of("level", format!("must be from 0, the finest, to {}", NOISE_LEVELS - 1)));
        }
        let luminance = luminance.unwrap_or(0.5f32.into_pyobject(py)?.into_any());
        mapped(&luminance, "luminance", |y| match level {
            Some(level) => noise.std(level, y),
            None => noise.told_std(y)[1],
        })
    }

    #[getter]
    fn clip(&self) -> Option<f64> {
        self.0.known().map(|m| number(m.clip()))
    }

    #[getter]
    fn temporal_correlation(&self) -> Option<f64> {
        self.0.known().map(|m| number(m.temporal_correlation()))
    }

    #[getter]
    fn method(&self) -> Option<String> {
        self.0.known().map(|m| name(json!(m.method())))
    }

    #[getter]
    fn samples(&self) -> Option<u64> {
        self.0.known().map(NoiseModel::samples)
    }

    fn __repr__(&self) -> String {
        let std = self.0.known().map(|m| m.told_std(0.5)[1].map(|v| format!("{:.2}", 255.0 * v)).join(", "));
        shown("Noise", std.map(|std| format!("std {std} (1/255) at luminance 0.5")), self.reason())
    }
}

/// The lens: the blur of what is out of focus.
#[pyclass(frozen, module = "blindaug")]
pub struct Defocus(Estimate<DefocusModel>);

impl Defocus {
    /// The part of this camera.
    pub fn of(camera: &CameraModel) -> Self {
        Self(camera.defocus.clone())
    }
}

#[pymethods]
impl Defocus {
    #[getter]
    fn known(&self) -> bool {
        self.0.known().is_some()
    }

    #[getter]
    fn reason(&self) -> Option<String> {
        reason(&self.0)
    }

    #[getter]
    fn reason_code(&self) -> Option<String> {
        reason_code(&self.0)
    }

    #[getter]
    fn depth_kind(&self) -> Option<String> {
        self.0.known().map(|lens| name(json!(lens.depth_kind)))
    }

    /// The std of the blur, px of the frames' width, at depths in metres, or at inverse depths in the lens's own unit.
    #[pyo3(signature = (depth_m = None, *, inverse_depth = None))]
    fn sigma_px<'py>(
        &self,
        depth_m: Option<Bound<'py, PyAny>>,
        inverse_depth: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let lens = known(&self.0, "defocus")?;
        let (value, name) = match (&depth_m, &inverse_depth) {
            (Some(depth), None) => (depth, "depth_m"),
            (None, Some(inverse)) => (inverse, "inverse_depth"),
            _ => return Err(of("depth_m", "give either depths in metres, or inverse_depth")),
        };
        if depth_m.is_some() && lens.depth_kind == DepthKind::Relative {
            return Err(of(
                name,
                "the lens is over relative inverse depth, which has no metres: give inverse_depth, or bring the camera to metres by \
                 cam.to_metric",
            ));
        }
        mapped(value, name, |v| {
            [match depth_m {
                // A depth of 0 or less is unknown, an infinite one is not.
                Some(_) if v > 0.0 => lens.sigma_px(v.recip()),
                Some(_) => f32::NAN,
                None => lens.sigma_px(v),
            }]
        })
    }

    #[getter]
    fn sigma_px_at_infinity(&self) -> Option<f64> {
        self.0.known().and_then(|lens| lens.facts().sigma_px_at_infinity).map(number)
    }

    #[getter]
    fn sigma_px_at_infinity_interval(&self) -> Option<Interval> {
        self.0.known().and_then(|lens| lens.facts().sigma_interval).map(interval)
    }

    #[getter]
    fn focus_inverse_depth(&self) -> Option<f64> {
        match self.0.known().map(|lens| lens.facts().focus) {
            Some(Focus::At(d)) => Some(number(d)),
            _ => None,
        }
    }

    #[getter]
    fn focus_inverse_depth_interval(&self) -> Option<Interval> {
        self.0.known().and_then(|lens| lens.facts().focus_interval).map(interval)
    }

    #[getter]
    fn focus_m(&self) -> Option<f64> {
        let metric = self.0.known().filter(|lens| lens.depth_kind == DepthKind::Metric);
        match metric.map(|lens| lens.facts().focus) {
            Some(Focus::At(d)) if d > 0.0 => Some(number(d.recip())),
            _ => None,
        }
    }

    /// "nearer" or "beyond" where the focus lies outside of what was seen.
    #[getter]
    fn focus_outside(&self) -> Option<&'static str> {
        match self.0.known()?.facts().outside? {
            OutsideFocus::Nearer(_) => Some("nearer"),
            OutsideFocus::Beyond(_) => Some("beyond"),
        }
    }

    #[getter]
    fn method(&self) -> Option<String> {
        self.0.known().map(|lens| name(json!(lens.method)))
    }

    #[getter]
    fn samples(&self) -> Option<u64> {
        self.0.known().map(|lens| lens.samples)
    }

    fn __repr__(&self) -> String {
        let infinity = self.sigma_px_at_infinity();
        let infinity = infinity.map(|v| with_interval(v, " px", self.sigma_px_at_infinity_interval()));
        let known = self.depth_kind().map(|kind| match infinity {
            Some(infinity) => format!("{infinity} at infinity, over {kind} inverse depth"),
            None => format!("over {kind} inverse depth"),
        });
        shown("Defocus", known, self.reason())
    }
}

/// The camera's sharpening, an unsharp mask.
#[pyclass(frozen, module = "blindaug")]
pub struct Sharpening(Estimate<SharpeningModel>);

impl Sharpening {
    /// The part of this camera.
    pub fn of(camera: &CameraModel) -> Self {
        Self(camera.sharpening.clone())
    }
}

#[pymethods]
impl Sharpening {
    #[getter]
    fn known(&self) -> bool {
        self.0.known().is_some()
    }

    #[getter]
    fn value(&self) -> Option<f64> {
        self.0.known().map(|m| number(m.amount))
    }

    #[getter]
    fn interval(&self) -> Option<Interval> {
        self.0.known().map(|m| interval(m.interval))
    }

    #[getter]
    fn radius_px(&self) -> Option<f64> {
        self.0.known().map(|m| number(m.radius_px))
    }

    #[getter]
    fn reason(&self) -> Option<String> {
        reason(&self.0)
    }

    #[getter]
    fn reason_code(&self) -> Option<String> {
        reason_code(&self.0)
    }

    fn __repr__(&self) -> String {
        shown("Sharpening", self.value().map(|v| with_interval(v, "", self.interval())), self.reason())
    }
}
