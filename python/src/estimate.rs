//! `blindaug.estimate`.

use crate::{
    camera::{Camera, Kept},
    failure::one_of,
    footage::{Beside, Footage, Said, path},
    listener::Listener,
    pixels::{self, DepthUnit},
};
use blindaug::{
    fit::{Curve, Estimation, EstimatorOptions, Family},
    model::{BlurSpace, NoiseKind, Space},
};
use blindaug_io::{DepthFormat, DepthValues, SideFolder};
use blindaug_pipeline::{Networks, estimate as job};
use pyo3::prelude::*;

impl DepthUnit {
    /// The format of depth files that hold this.
    pub fn format(self) -> DepthFormat {
        let values = match self {
            Self::Metres => DepthValues::Metric,
            Self::Inverse => DepthValues::Inverse,
            Self::RelativeInverse => DepthValues::RelativeInverse,
        };
        DepthFormat { values, ..DepthFormat::default() }
    }
}

/// Opens depth of some footage.
pub fn open_depth(
    value: Option<&Bound<'_, PyAny>>,
    unit: DepthUnit,
    footage: &Footage,
    listener: &Listener,
) -> PyResult<Option<Beside<blindaug::Plane>>> {
    let read = Box::new(move |a: &Bound<'_, PyAny>, name: &str, size| pixels::depth(a, name, size, unit));
    Beside::open(value, ("depth", 2), footage, |path| SideFolder::depth(path, unit.format()), read, listener)
}

/// Opens the flow of some footage.
pub fn open_flow(
    value: Option<&Bound<'_, PyAny>>,
    footage: &Footage,
    listener: &Listener,
) -> PyResult<Option<Beside<blindaug::Flow>>> {
    let read = Box::new(|a: &Bound<'_, PyAny>, name: &str, size| pixels::flow(a, name, size));
    Beside::open(value, ("flow", 3), footage, |path| SideFolder::flow(path), read, listener)
}

/// Estimates a camera from its footage.
#[pyfunction]
#[pyo3(signature = (footage, *, depth = None, flow = None, clean = None, fps = None, frames = None, colour_space = None,
    depth_kind = "metric", method = "auto", networks = None, curve = "thin-lens", blur_in = "linear", noise_model = "curves",
    samples = false, progress = None))]
#[allow(clippy::too_many_arguments, reason = "these are the keyword arguments of a function in Python")]
pub fn estimate(
    py: Python<'_>,
    footage: &Bound<'_, PyAny>,
    depth: Option<&Bound<'_, PyAny>>,
    flow: Option<&Bound<'_, PyAny>>,
    clean: Option<&Bound<'_, PyAny>>,
    fps: Option<f64>,
    frames: Option<(Option<u64>, Option<u64>)>,
    colour_space: Option<&str>,
    depth_kind: &str,
    method: &str,
    networks: Option<Vec<String>>,
    curve: &str,
    blur_in: &str,
    noise_model: &str,
    samples: bool,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Camera> {
    let listener = Listener::new(progress)?;
    let unit = DepthUnit::named(depth_kind)?;
    let families = [("auto", Family::Auto), ("spectral", Family::Spectral), ("removal", Family::Removal)];
    let options = EstimatorOptions {
        family: one_of("method", method, &families)?,
        curve: one_of("curve", curve, &[("thin-lens", Curve::ThinLens), ("quadratic", Curve::Quadratic)])?,
        space: one_of("blur_in", blur_in, &[("linear", BlurSpace::Linear), ("encoded", BlurSpace::Encoded)])?
            .into(),
        noise_kind: one_of(
            "noise_model",
            noise_model,
            &[("curves", NoiseKind::Curves), ("lines", NoiseKind::Lines)],
        )?,
        fps,
    };
    let title = match path(footage).as_deref().and_then(std::path::Path::file_name) {
        Some(name) => format!("The camera of {}", name.to_string_lossy()),
        None => "The camera".into(),
    };
    let opened = Footage::open(footage, &Said { frames, colour_space, fps }, &listener)?;
    let depth = open_depth(depth, unit, &opened, &listener)?;
    let flow = open_flow(flow, &opened, &listener)?;
    let (space, reading) = (opened.space(), opened.reading());
    let transfer = opened.transfer();
    let read_clean = Box::new(move |a: &Bound<'_, PyAny>, name: &str, size| {
        let (frame, _) = pixels::frame(a, name, (space, transfer), false)?;
        pixels::check_size(frame.0.size(), size, name)?;
        Ok(frame)
    });
    let folder = |path: &std::path::Path| SideFolder::frames_beside(path, "clean frames", reading);
    let clean = Beside::open(clean, ("clean", 3), &opened, folder, read_clean, &listener)?;
    let footage = blindaug_pipeline::Footage {
        depth: depth.map(|d| (d.boxed(), unit.kind())),
        flow: flow.map(Beside::boxed),
        clean: clean.map(Beside::boxed),
        ..blindaug_pipeline::Footage::of(opened.boxed())
    };
    let options = EstimatorOptions { space: Space { transfer, ..options.space }, ..options };
    let fitted = listener.run(py, || {
        let names = networks.unwrap_or_default();
        let mut networks = Networks::for_estimate(&names, options.family, &footage, &listener)?;
        let job = job::Job {
            options,
            keep_samples: samples,
            operators: Some(&mut networks),
            ..job::Job::default()
        };
        job::estimate(&footage, job, &listener)
    })?;
    let Estimation { model, diagnostics } = fitted.estimation;
    let notes = diagnostics.notes.clone();
    let kept =
        samples.then_some(Kept { title, diagnostics, samples: fitted.samples, numbers: fitted.numbers });
    Ok(Camera::new(&model, notes, kept)?.of_shots(fitted.shots))
}
