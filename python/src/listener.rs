//! The running of jobs without the interpreter's lock, and what Python hears of them.

use crate::failure;
use blindaug_pipeline::Observer;
use pyo3::{exceptions::PyUserWarning, prelude::*};
use std::{
    ffi::CString,
    sync::{
        Arc, Mutex, MutexGuard, OnceLock, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
};

/// The first exception that Python raised while a job ran; the job ends with an error of its own, in whose place this one is raised.
#[derive(Clone, Default)]
pub struct Raised(Arc<Mutex<Option<PyErr>>>);

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Raised {
    /// Keeps an exception, unless there is one, and gives the error by which the job is to end.
    pub fn keep(&self, exception: PyErr) -> blindaug_pipeline::Error {
        locked(&self.0).get_or_insert(exception);
        blindaug_pipeline::Error::Clip {
            clip: "Python".into(),
            error: blindaug::Error::new("it raised an exception"),
        }
    }

    fn is_some(&self) -> bool {
        locked(&self.0).is_some()
    }

    fn take(&self) -> Option<PyErr> {
        locked(&self.0).take()
    }
}

/// Hears what a job says.
pub struct Listener {
    /// The exceptions of this job.
    pub raised: Raised,
    progress: Option<Py<PyAny>>,
    total: Mutex<Option<usize>>,
    done: AtomicUsize,
    /// Sentences, and whether each is a warning.
    said: Mutex<Vec<(bool, String)>>,
}

impl Listener {
    /// A listener that calls `progress` with the number of frames that are done, and of all frames or None.
    ///
    /// # Errors
    /// If `progress` is no function, or this process cannot compute ([`check_process`]).
    pub fn new(progress: Option<Bound<'_, PyAny>>) -> PyResult<Self> {
        check_process()?;
        if let Some(progress) = progress.as_ref().filter(|p| !p.is_callable()) {
            let kind = progress.get_type().name()?;
            return Err(failure::of(
                "progress",
                format!("must be a function of two numbers, done and total, and is of type {kind}"),
            ));
        }
        Ok(Self {
            raised: Raised::default(),
            progress: progress.map(Bound::unbind),
            total: Mutex::default(),
            done: AtomicUsize::new(0),
            said: Mutex::default(),
        })
    }

    /// Runs a job without the interpreter's lock. An exception that Python raised meanwhile goes before the job's own error or result.
    pub fn run<T: Send>(
        &self,
        py: Python<'_>,
        job: impl FnOnce() -> blindaug_pipeline::Result<T> + Send,
    ) -> PyResult<T> {
        let result = py.detach(job);
        self.check()?;
        // What was said before a failure may explain it.
        let told = self.tell(py);
        let result = result.map_err(failure::of_job)?;
        told.map(|()| result)
    }

    /// Fails if Python raised an exception.
    pub fn check(&self) -> PyResult<()> {
        self.raised.take().map_or(Ok(()), Err)
    }

    /// Hands on what was said: notes to the logger "blindaug", warnings to Python's warnings.
    pub fn tell(&self, py: Python<'_>) -> PyResult<()> {
        for (is_warning, sentence) in std::mem::take(&mut *locked(&self.said)) {
            let sentence = in_python(&sentence);
            match (is_warning, CString::new(sentence.as_str())) {
                (true, Ok(sentence)) => PyErr::warn(py, &py.get_type::<PyUserWarning>(), &sentence, 1)?,
                _ => {
                    let logger = py.import("logging")?.call_method1("getLogger", ("blindaug",))?;
                    logger.call_method1("info", ("%s", sentence))?;
                }
            }
        }
        Ok(())
    }
}

/// A sentence with the options of the command line as the arguments of the same names.
pub fn in_python(sentence: &str) -> String {
    let mut parts = sentence.split("--");
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find(|c: char| !c.is_ascii_lowercase() && c != '-').unwrap_or(part.len());
        text += &part[..end].replace('-', "_");
        text += &part[end..];
    }
    text
}

/// Fails in a process that was forked after its parent had computed: the threads that compute are not there any more, and it would wait
/// for them for ever.
pub fn check_process() -> PyResult<()> {
    static FIRST: OnceLock<u32> = OnceLock::new();
    let own = std::process::id();
    match *FIRST.get_or_init(|| own) == own {
        true => Ok(()),
        false => Err(failure::Error::new_err(
            "this process was forked from one that has used blindaug, whose threads it lacks: start processes by \"spawn\" \
             (multiprocessing.set_start_method(\"spawn\")), or use blindaug only after the fork",
        )),
    }
}

impl Observer for Listener {
    fn begin(&self, _: &'static str, unit: &'static str, total: Option<usize>) {
        // What has no unit counts no frames.
        if !unit.is_empty() {
            *locked(&self.total) = total;
        }
    }

    fn step(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        let total = *locked(&self.total);
        if let Some(progress) = self.progress.as_ref().filter(|_| !self.raised.is_some()) {
            Python::attach(|py| {
                if let Err(exception) = progress.call1(py, (done, total)) {
                    self.raised.keep(exception);
                }
            });
        }
    }

    fn note(&self, sentence: &str) {
        locked(&self.said).push((false, sentence.into()));
    }

    fn warning(&self, sentence: &str) {
        locked(&self.said).push((true, sentence.into()));
    }

    fn stops(&self) -> bool {
        if let Err(exception) = Python::attach(|py| py.check_signals()) {
            self.raised.keep(exception);
        }
        self.raised.is_some()
    }
}
