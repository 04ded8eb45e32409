//! The exceptions of the package.

use crate::listener::in_python;
use pyo3::{PyErr, PyResult, create_exception, exceptions::PyValueError};

create_exception!(
    blindaug,
    Error,
    PyValueError,
    "What was handed in cannot be used; one sentence names the argument and says what to do."
);
create_exception!(
    blindaug,
    FileError,
    Error,
    "A file cannot be read, written or used; the sentence begins with its name."
);
create_exception!(
    blindaug,
    UnknownError,
    Error,
    "A number was asked of a part of a camera that is unknown; the sentence says why it is."
);

/// An error of an argument.
pub fn of(argument: &str, sentence: impl std::fmt::Display) -> PyErr {
    Error::new_err(format!("{argument}: {sentence}"))
}

/// The value that an argument names, one of these.
pub fn one_of<T: Copy>(argument: &str, name: &str, values: &[(&str, T)]) -> PyResult<T> {
    values.iter().find(|v| v.0 == name).map(|v| v.1).ok_or_else(|| {
        let names: Vec<String> = values.iter().map(|v| format!("\"{}\"", v.0)).collect();
        of(argument, format!("\"{name}\" is none of {}", names.join(", ")))
    })
}

/// The error of a file.
pub fn of_file(e: blindaug_io::Error) -> PyErr {
    match e.is_over_budget() {
        true => Error::new_err(format!("{e} (blindaug.set_memory_budget(BYTES) raises it)")),
        false => FileError::new_err(in_python(&e.to_string())),
    }
}

/// The error of a job.
pub fn of_job(e: blindaug_pipeline::Error) -> PyErr {
    use blindaug_pipeline::Error as E;
    match e {
        E::File(e) => of_file(e),
        E::NoSceneScale { .. } => Error::new_err(format!(
            "{e}: cam.to_metric(at=[(X, Y, METRES)]) brings it to metres by a place whose distance is known, cam.to_metric(S) by the scene's scale; \
             composite(.., match_at=(X, Y)) blurs the object like what is seen at a place"
        )),
        e => Error::new_err(in_python(&e.to_string())),
    }
}
