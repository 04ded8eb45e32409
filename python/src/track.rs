//! `blindaug.track` and `blindaug.Tracker`.

use crate::{
    camera::Camera,
    estimate::{open_depth, open_flow},
    failure::{self, of},
    footage::{self, Footage, PythonClip, Said, check_fps},
    listener::{Listener, check_process},
    pixels::{self, DepthUnit},
};
use blindaug::{
    Flow, Frame, Plane,
    colour_space::ColourSpace,
    fit::track::Tracker as Fit,
    model::{NoiseKind, Space, TrackedCamera},
};
use blindaug_io::{FrameSource, memory};
use blindaug_pipeline::{
    Observer,
    footage::check_match,
    track::{Beside, ClipTracker, FrameTracker},
};
use pyo3::{exceptions::PyException, prelude::*};
use std::{
    path::Path,
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver, RecvTimeoutError, sync_channel},
    },
    time::Duration,
};

/// A state that one thread at a time works on.
struct Exclusive<T>(Mutex<Option<T>>);

impl<T> Exclusive<T> {
    fn new(state: T) -> Self {
        Self(Mutex::new(Some(state)))
    }

    /// Works on the state; fails if another thread does.
    fn work<R>(&self, name: &str, work: impl FnOnce(&mut T) -> PyResult<R>) -> PyResult<R> {
        // Arrays become frames by the threads that compute, too.
        check_process()?;
        /// Puts the state back, also after a panic.
        struct Taken<'a, T>(&'a Mutex<Option<T>>, Option<T>);
        impl<T> Drop for Taken<'_, T> {
            fn drop(&mut self) {
                *self.0.lock().unwrap_or_else(PoisonError::into_inner) = self.1.take();
            }
        }
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        let mut taken = Taken(&self.0, state);
        match &mut taken.1 {
            Some(state) => work(state),
            None => {
                // The state is put back by whoever has it.
                std::mem::forget(taken);
                Err(of(name, "another thread is at work on it; give each thread its own, or take turns"))
            }
        }
    }
}

/// The exception of a frame that cannot be used.
fn unusable(error: blindaug::Error) -> PyErr {
    failure::Error::new_err(error.to_string())
}

/// What a tracker found, for Python.
fn camera_of(found: blindaug::Result<Option<TrackedCamera>>) -> PyResult<Option<Camera>> {
    found.map_err(unusable)?.as_ref().map(Camera::of_frame).transpose()
}

/// Follows a camera by frames that are pushed one after another.
#[pyclass(frozen, module = "blindaug")]
pub struct Tracker {
    space: ColourSpace,
    unit: DepthUnit,
    state: Exclusive<State>,
}

struct State {
    tracker: FrameTracker,
    /// The number of the last frame.
    number: u64,
    /// The size of the first frame.
    size: Option<(usize, usize)>,
}

#[pymethods]
impl Tracker {
    #[new]
    #[pyo3(signature = (*, fps = None, colour_space = None, depth_kind = "metric"))]
    fn new(fps: Option<f64>, colour_space: Option<&str>, depth_kind: &str) -> PyResult<Self> {
        check_fps(fps)?;
        let space =
            colour_space.map_or(Ok(ColourSpace::SRGB), |name| pixels::colour_space(name, "colour_space"))?;
        let blur = Space { transfer: space.transfer.worked_on(), ..Space::default() };
        let tracker = FrameTracker::new(blur, NoiseKind::default(), fps, None);
        let state = Exclusive::new(State { tracker, number: 0, size: None });
        Ok(Self { space, unit: DepthUnit::named(depth_kind)?, state })
    }

    /// Takes the next frame, and gives the camera of the frame before it; None for the first frame.
    #[pyo3(signature = (frame, *, depth = None, flow = None, number = None))]
    fn push(
        &self,
        py: Python<'_>,
        frame: &Bound<'_, PyAny>,
        depth: Option<&Bound<'_, PyAny>>,
        flow: Option<&Bound<'_, PyAny>>,
        number: Option<u64>,
    ) -> PyResult<Option<Camera>> {
        self.state.work("Tracker", |state| {
            let number = number.unwrap_or(state.number + 1);
            if number <= state.number {
                return Err(of(
                    "number",
                    format!("must rise from frame to frame, and the last one was {}", state.number),
                ));
            }
            let (image, _) =
                pixels::frame(frame, "frame", (self.space, self.space.transfer.worked_on()), false)?;
            let size = image.0.size();
            let first @ (width, height) = *state.size.get_or_insert(size);
            if size != first {
                let (w, h) = size;
                return Err(of(
                    "frame",
                    format!("has {w} x {h} pixels, but the first has {width} x {height}"),
                ));
            }
            let depth = depth.map(|d| pixels::depth(d, "depth", size, self.unit)).transpose()?;
            let beside = Beside {
                depth: depth.map(|d| (d, self.unit.kind())),
                flow: flow.map(|f| pixels::flow(f, "flow", size)).transpose()?,
            };
            state.number = number;
            camera_of(py.detach(|| state.tracker.push(Frame { number, image }, beside)))
        })
    }

    /// The camera of the last frame, or None if there is none that waits.
    fn finish(&self, py: Python<'_>) -> PyResult<Option<Camera>> {
        self.state.work("Tracker", |state| camera_of(py.detach(|| state.tracker.finish())))
    }
}

/// The cameras of the frames of some footage, found while they are asked for.
#[pyclass(frozen, module = "blindaug")]
pub struct Track {
    state: Exclusive<Following>,
    len: Option<usize>,
    listener: Listener,
}

struct Following {
    tracker: ClipTracker,
    frames: FramesSource,
    size: (usize, usize),
    depth: Option<footage::Beside<Plane>>,
    flow: Option<footage::Beside<Flow>>,
    unit: DepthUnit,
    /// Whether there are no more frames, or one could not be used.
    ended: bool,
    /// Why the frames ended early, until that is raised.
    failure: Option<PyErr>,
}

enum FramesSource {
    /// The frames of a file, which a thread of their own reads.
    Files(Receiver<blindaug_io::Result<Frame>>, Arc<FrameSource>),
    /// Frames of Python, and the number of the next one.
    Python(PythonClip, u64),
}

impl FramesSource {
    /// What is wrong with the frames that were read so far.
    fn warning(&self) -> Option<String> {
        match self {
            Self::Files(_, source) => source.warning(),
            Self::Python(..) => None,
        }
    }

    fn next(&mut self, py: Python<'_>) -> PyResult<Option<Frame>> {
        /// How often signals are looked for while a frame is waited for.
        const PAUSE: Duration = Duration::from_millis(100);
        match self {
            Self::Python(clip, number) => {
                let frame = clip.frame(py, *number)?;
                *number += 1;
                Ok(frame)
            }
            Self::Files(frames, _) => loop {
                // A receiver is not shared between threads, so that it is lent as a whole.
                let frames = &mut *frames;
                let received = py.detach(move || frames.recv_timeout(PAUSE));
                match received {
                    Ok(frame) => return frame.map(Some).map_err(failure::of_file),
                    Err(RecvTimeoutError::Timeout) => py.check_signals()?,
                    Err(RecvTimeoutError::Disconnected) => return Ok(None),
                }
            },
        }
    }
}

impl Following {
    /// The next camera; `None` at the end. What a bad frame raises comes after the cameras of the frames before it, an interrupt at once.
    fn next(&mut self, py: Python<'_>, listener: &Listener) -> PyResult<Option<Camera>> {
        loop {
            if let Some(camera) = self.tracker.take() {
                return Camera::of_frame(&camera).map(Some);
            }
            if self.ended {
                return self.failure.take().map_or(Ok(None), Err);
            }
            py.check_signals()?;
            // After an error there are no more frames.
            self.ended = true;
            match self.look(py) {
                Ok(true) => {
                    self.ended = false;
                    listener.step();
                    listener.check()?;
                }
                Ok(false) => {
                    self.frames.warning().iter().for_each(|words| listener.warning(words));
                    listener.tell(py)?;
                }
                Err(failure) if failure.is_instance_of::<PyException>(py) => {
                    self.tracker.stop();
                    self.failure = Some(failure);
                }
                Err(interrupt) => return Err(interrupt),
            }
        }
    }

    /// Hands the next frame to the tracker, or tells it that there are no more; gives whether there was one.
    fn look(&mut self, py: Python<'_>) -> PyResult<bool> {
        let frame = self.frames.next(py)?;
        let tracker = &mut self.tracker;
        let Some(frame) = frame else {
            return py.detach(|| tracker.finish()).map_err(unusable).map(|()| false);
        };
        let read = |number: u64| -> PyResult<Beside> {
            let depth = self.depth.as_ref().map(|d| d.get(py, number, self.size)).transpose()?.flatten();
            let flow = self.flow.as_ref().map(|f| f.get(py, number, self.size)).transpose()?.flatten();
            Ok(Beside { depth: depth.map(|d| (d, self.unit.kind())), flow })
        };
        // Without what belongs to it, this frame is still the next one of the frame before it.
        let (beside, result) = match read(frame.number) {
            Ok(beside) => (beside, Ok(true)),
            Err(failure) => (Beside::default(), Err(failure)),
        };
        py.detach(|| tracker.push(frame, beside)).map_err(unusable)?;
        result
    }
}

#[pymethods]
impl Track {
    fn __iter__(slf: Bound<'_, Self>) -> Bound<'_, Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Camera>> {
        self.state.work("track", |following| following.next(py, &self.listener))
    }

    fn __length_hint__(&self) -> usize {
        self.len.unwrap_or(0)
    }
}

/// Estimates a camera for each frame of some footage, one after another.
#[pyfunction]
#[pyo3(signature = (footage, *, depth = None, flow = None, fps = None, frames = None, colour_space = None, depth_kind = "metric",
    progress = None))]
#[allow(clippy::too_many_arguments, reason = "these are the keyword arguments of a function in Python")]
pub fn track(
    py: Python<'_>,
    footage: &Bound<'_, PyAny>,
    depth: Option<&Bound<'_, PyAny>>,
    flow: Option<&Bound<'_, PyAny>>,
    fps: Option<f64>,
    frames: Option<(Option<u64>, Option<u64>)>,
    colour_space: Option<&str>,
    depth_kind: &str,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Track> {
    let listener = Listener::new(progress)?;
    let unit = DepthUnit::named(depth_kind)?;
    let opened = Footage::open(footage, &Said { frames, colour_space, fps }, &listener)?;
    let depth = open_depth(depth, unit, &opened, &listener)?;
    let flow = open_flow(flow, &opened, &listener)?;
    let clip = opened.clip();
    check_match(clip, depth.as_ref().and_then(footage::Beside::files)).map_err(failure::of_job)?;
    check_match(clip, flow.as_ref().and_then(footage::Beside::files)).map_err(failure::of_job)?;
    let (size, len, aspect) = (clip.size(), clip.len_hint(), clip.pixel_aspect());
    memory::fits(Path::new(&clip.name()), "tracking its camera", Fit::bytes(size))
        .map_err(failure::of_file)?;
    let space = Space { transfer: opened.transfer(), ..Space::default() };
    let tracker = ClipTracker::new(space, NoiseKind::default(), fps.or(clip.fps()), aspect);
    let frames = match opened {
        Footage::Python(clip) => FramesSource::Python(clip, 1),
        Footage::Files(source) => {
            let (sender, receiver) = sync_channel(1);
            let source: Arc<FrameSource> = Arc::from(source);
            let read = Arc::clone(&source);
            // The thread ends when nobody takes frames any more.
            std::thread::spawn(move || read.frames().try_for_each(|frame| sender.send(frame)).ok());
            FramesSource::Files(receiver, source)
        }
    };
    listener.begin("tracking", "frames", len);
    listener.tell(py)?;
    let following = Following { tracker, frames, size, depth, flow, unit, ended: false, failure: None };
    Ok(Track { state: Exclusive::new(following), len, listener })
}
