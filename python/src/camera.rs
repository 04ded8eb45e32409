//! A camera, as it was estimated, read or tracked.

use crate::{
    export::{self, Export},
    failure::{self, of},
    listener::check_process,
    parts::{Defocus, Exposure, Noise, Sharpening},
};
use blindaug::{
    CameraModel, Sample,
    fit::Diagnostics,
    model::{CameraTrack, Changes, Distortion, ExposureFraction, KnownDistance, SceneScale, TrackedCamera},
};
use blindaug_cli::arguments::bokeh as shape;
use blindaug_io::{CameraTrackWriter, read_camera_track, write_atomically, write_camera};
use blindaug_pipeline::ByHand;
use blindaug_report::{ReportInput, words};
use pyo3::{prelude::*, types::PyType};
use std::{fmt::Write, ops::RangeInclusive, path::PathBuf, sync::Arc};

/// What an estimate keeps for its report.
pub struct Kept {
    /// The title of the page.
    pub title: String,
    /// The measurements.
    pub diagnostics: Diagnostics,
    /// A few frames.
    pub samples: Vec<Sample>,
    /// The numbers of all frames that were looked at.
    pub numbers: Vec<u64>,
}

/// A camera: its noise, exposure, defocus and sharpening, each with an interval or with the reason why it is unknown.
#[pyclass(frozen, module = "blindaug")]
pub struct Camera {
    /// The model, with its numbers as a file has them.
    pub model: CameraModel,
    /// The frame that the camera is that of, and what had changed just before it, if the camera was tracked.
    pub tracked: Option<(u64, Changes)>,
    notes: Vec<String>,
    shots: Vec<(u64, u64)>,
    kept: Option<Arc<Kept>>,
}

impl Camera {
    /// The camera of a model. Its numbers become those that a file of it has, so that a camera is the same before and after it is written.
    ///
    /// # Errors
    /// If a number is out of its range.
    pub fn new(model: &CameraModel, notes: Vec<String>, kept: Option<Kept>) -> PyResult<Self> {
        let model =
            CameraModel::from_json(&model.to_json()).map_err(|e| failure::Error::new_err(e.to_string()))?;
        Ok(Self { model, tracked: None, notes, shots: vec![], kept: kept.map(Arc::new) })
    }

    /// The camera of one frame, with the same rounding.
    ///
    /// # Errors
    /// If a number is out of its range.
    pub fn of_frame(tracked: &TrackedCamera) -> PyResult<Self> {
        Self::parsed(&tracked.to_json_line())
    }

    fn parsed(json: &str) -> PyResult<Self> {
        let track = CameraTrack::from_json(json).map_err(|e| of("text", e))?;
        match track.frames() {
            [one] => Ok(Self::read_from(one, json)),
            frames => {
                Err(of("text", format!("holds {} cameras, one for each frame: use read_track", frames.len())))
            }
        }
    }

    fn read_from(one: &TrackedCamera, json: &str) -> Self {
        let of_frame =
            json.trim_start_matches('\u{feff}').lines().next().is_some_and(|l| l.contains("\"frame\""));
        let tracked = of_frame.then_some((one.frame, one.changed));
        Self { model: one.camera.clone(), tracked, notes: vec![], shots: vec![], kept: None }
    }

    /// The camera as one of a track.
    fn in_track(&self) -> Option<TrackedCamera> {
        let (frame, changed) = self.tracked?;
        Some(TrackedCamera { frame, changed, camera: self.model.clone() })
    }

    /// The camera of footage with these shots, by the numbers of their first and last frames.
    pub fn of_shots(self, shots: Vec<(u64, u64)>) -> Self {
        Self { shots, ..self }
    }

    /// The camera with another model.
    fn with(&self, model: &CameraModel) -> PyResult<Self> {
        let shots = self.shots.clone();
        Ok(Self { tracked: self.tracked, shots, ..Self::new(model, self.notes.clone(), None)? })
    }
}

/// The attribute of a camera that holds a distortion's part.
fn attribute(distortion: Distortion) -> &'static str {
    match distortion {
        Distortion::MotionBlur => "exposure",
        Distortion::Defocus | Distortion::Sharpening | Distortion::Noise => distortion.name(),
    }
}

#[pymethods]
impl Camera {
    /// Reads camera.json.
    #[classmethod]
    fn read(_: &Bound<'_, PyType>, py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let track = py.detach(|| read_camera_track(&path)).map_err(failure::of_file)?;
        match track.frames() {
            [one] if one.frame > 0 => Self::of_frame(one),
            [one] => Self::new(&one.camera, vec![], None),
            frames => {
                let sentence = format!("holds {} cameras, one for each frame: use read_track", frames.len());
                Err(failure::of_file(blindaug_io::Error::new(&path, sentence)))
            }
        }
    }

    /// The camera of the text of camera.json, or of one line of a track.
    #[classmethod]
    fn from_json(_: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        Self::parsed(text)
    }

    /// The text of camera.json; of a tracked camera the line of a track.
    fn to_json(&self) -> String {
        self.in_track().map_or_else(|| self.model.to_json(), |tracked| tracked.to_json_line())
    }

    /// Writes camera.json.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| write_camera(&path, &self.model)).map_err(failure::of_file)
    }

    #[getter]
    fn exposure(&self) -> Exposure {
        Exposure::of(&self.model)
    }

    #[getter]
    fn noise(&self) -> Noise {
        Noise::of(&self.model)
    }

    #[getter]
    fn defocus(&self) -> Defocus {
        Defocus::of(&self.model)
    }

    #[getter]
    fn sharpening(&self) -> Sharpening {
        Sharpening::of(&self.model)
    }

    #[getter]
    fn width(&self) -> usize {
        self.model.capture.width
    }

    #[getter]
    fn height(&self) -> usize {
        self.model.capture.height
    }

    #[getter]
    fn fps(&self) -> Option<f64> {
        self.model.capture.fps
    }

    #[getter]
    fn frames_used(&self) -> usize {
        self.model.capture.frames_used
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.model.warnings.clone()
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// The numbers of the first and last frame of each shot of the footage.
    #[getter]
    fn shots(&self) -> Vec<(u64, u64)> {
        self.shots.clone()
    }

    /// The number of the frame, of a tracked camera.
    #[getter]
    fn frame(&self) -> Option<u64> {
        self.tracked.map(|t| t.0)
    }

    /// The parts that were found to have changed just before this frame, of a tracked camera.
    #[getter]
    fn changed(&self) -> Vec<&'static str> {
        let changed = self.tracked.map(|t| t.1).unwrap_or_default();
        Distortion::ALL.into_iter().filter(|d| changed.of(*d)).map(attribute).collect()
    }

    /// The camera with its lens over metres.
    #[pyo3(signature = (scale = None, offset = 0.0, *, at = None))]
    fn to_metric(&self, scale: Option<f32>, offset: f32, at: Option<Vec<(f32, f32, f32)>>) -> PyResult<Self> {
        let scale = match (scale, at) {
            (Some(scale), None) if scale.is_finite() && scale > 0.0 && offset.is_finite() => {
                SceneScale { scale, offset }
            }
            (Some(_), None) => {
                return Err(of(
                    "scale",
                    "must be a positive number, so that relative inverse depth is scale / Z + offset",
                ));
            }
            (None, Some(places)) => {
                if places
                    .iter()
                    .any(|(x, y, z)| !(x.is_finite() && y.is_finite() && z.is_finite() && *z > 0.0))
                {
                    return Err(of("at", "must hold x and y in px, and a positive distance in metres"));
                }
                let known: Vec<KnownDistance> =
                    places.iter().map(|&(x, y, metres)| KnownDistance { place: [x, y], metres }).collect();
                self.model.scale_by(&known).map_err(|e| of("at", e))?
            }
            _ => return Err(of("scale", "give either the scene's scale, or at=[(X, Y, METRES)]")),
        };
        self.with(&self.model.clone().to_metric(scale))
    }

    /// The camera with parts that are set by hand.
    #[pyo3(signature = (*, shutter = None, shutter_phase = None, focus = None, blur = None, bokeh = None, squeeze = None, cats_eye = None,
        grain = None))]
    #[allow(clippy::too_many_arguments, reason = "these are the keyword arguments of a function in Python")]
    fn replace(
        &self,
        shutter: Option<f64>,
        shutter_phase: Option<f64>,
        focus: Option<f64>,
        blur: Option<f64>,
        bokeh: Option<&str>,
        squeeze: Option<f64>,
        cats_eye: Option<f64>,
        grain: Option<f64>,
    ) -> PyResult<Self> {
        let within = |name: &str, value: Option<f64>, range: RangeInclusive<f64>| match value {
            Some(v) if !range.contains(&v) => {
                Err(of(name, format!("must be a number from {} to {}", range.start(), range.end())))
            }
            value => Ok(value.map(|v| v as f32)),
        };
        if focus.is_some_and(|m| !(m.is_finite() && m > 0.0)) {
            return Err(of("focus", "must be a positive distance, in metres"));
        }
        let angle = within("shutter", shutter, ByHand::SHUTTER_DEGREES)?;
        let by_hand = ByHand {
            exposure: angle.map(|degrees| ExposureFraction(degrees / 360.0)),
            phase_degrees: within("shutter_phase", shutter_phase, ByHand::PHASE_DEGREES)?,
            focus_m: focus.map(|m| m as f32),
            blur_px: within("blur", blur, ByHand::BLUR_PX)?,
            bokeh: bokeh.map(|text| shape(text).map_err(|e| of("bokeh", e))).transpose()?,
            squeeze: within("squeeze", squeeze, ByHand::SQUEEZE)?,
            cats_eye: within("cats_eye", cats_eye, ByHand::CATS_EYE)?,
            grain: within("grain", grain, ByHand::GRAIN)?,
        };
        let set = by_hand.applied(self.model.clone()).map_err(|e| of("cam", e))?;
        self.with(&set)
    }

    /// The camera as settings of another tool.
    #[pyo3(signature = (target, *, fov = None, size = None, scene_scale = None))]
    fn export(
        &self,
        target: &str,
        fov: Option<f32>,
        size: Option<(usize, usize)>,
        scene_scale: Option<(f32, f32)>,
    ) -> PyResult<Export> {
        check_process()?;
        let scaled =
            scene_scale.map(|(scale, offset)| self.to_metric(Some(scale), offset, None)).transpose()?;
        export::exported(scaled.as_ref().map_or(&self.model, |camera| &camera.model), target, fov, size)
    }

    /// Writes the page that shows what the estimate rests on.
    fn report(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let Some(kept) = &self.kept else {
            return Err(failure::Error::new_err(
                "this camera holds nothing of its estimate, which a report shows: estimate with samples=True",
            ));
        };
        check_process()?;
        let written = py.detach(|| -> Result<_, String> {
            let input = ReportInput {
                samples: kept.samples.clone(),
                numbers: kept.numbers.clone(),
                ..ReportInput::new(&kept.title, &self.model, &kept.diagnostics)
            };
            let page = blindaug_report::page(&input).map_err(|e| e.to_string())?;
            Ok(write_atomically(&path, |partial| std::fs::write(partial, &page)))
        });
        written.map_err(failure::Error::new_err)?.map_err(failure::of_file)
    }

    /// What follows from the camera, with all intervals: what `blindaug inspect --json` prints.
    fn facts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        py.import("json")?.call_method1("loads", (words::derived(&self.model, &[]).to_string(),))
    }

    fn _repr_html_(&self) -> String {
        let escaped = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        let mut html = String::from("<table><caption>");
        html += &escaped(self.__repr__().trim_matches(['<', '>']));
        html += "</caption>";
        for (name, value) in words::parameters(&self.model) {
            // Writing to a String cannot fail.
            let _ = write!(html, "<tr><th>{}</th><td>{}</td></tr>", escaped(name), escaped(&value));
        }
        for sentence in &self.model.warnings {
            let _ = write!(html, "<tr><th>warning</th><td>{}</td></tr>", escaped(sentence));
        }
        html + "</table>"
    }

    fn __str__(&self) -> String {
        words::words(&self.model, &[])
    }

    fn __repr__(&self) -> String {
        let of = |part: Distortion| if self.model.why_unknown(part).is_none() { "known" } else { "unknown" };
        let [defocus, exposure, _, noise] = Distortion::ALL.map(of);
        let frame = self.tracked.map_or(String::new(), |(frame, _)| format!(" of frame {frame}"));
        let (w, h) = (self.width(), self.height());
        format!("<Camera{frame}, {w} x {h} px: noise {noise}, exposure {exposure}, defocus {defocus}>")
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|other| {
            let other = other.get();
            (&self.model, self.tracked) == (&other.model, other.tracked)
        })
    }

    /// Pickles the camera without what it keeps for a report.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        Ok((py.get_type::<Self>().getattr("from_json")?, (self.to_json(),)))
    }
}

/// Reads the cameras of a track, or one camera.
#[pyfunction]
pub fn read_track(py: Python<'_>, path: PathBuf) -> PyResult<Vec<Camera>> {
    let track = py.detach(|| read_camera_track(&path)).map_err(failure::of_file)?;
    match track.frames() {
        [one] if one.frame == 0 => Ok(vec![Camera::new(&one.camera, vec![], None)?]),
        frames => frames.iter().map(Camera::of_frame).collect(),
    }
}

/// Writes the cameras of a track, in the order of their frames.
#[pyfunction]
pub fn write_track(py: Python<'_>, path: PathBuf, cameras: Vec<Bound<'_, Camera>>) -> PyResult<()> {
    let tracked = |camera: &Bound<'_, Camera>| {
        camera
            .get()
            .in_track()
            .ok_or_else(|| of("cameras", "must be tracked ones, each with the number of its frame"))
    };
    let frames = cameras.iter().map(tracked).collect::<PyResult<Vec<_>>>()?;
    let track = CameraTrack::from_frames(frames).map_err(|e| of("cameras", e))?;
    let write = || -> blindaug_io::Result<()> {
        let mut writer = CameraTrackWriter::create(&path)?;
        track.frames().iter().try_for_each(|camera| writer.write(camera))?;
        writer.finish()
    };
    py.detach(write).map_err(failure::of_file)
}
