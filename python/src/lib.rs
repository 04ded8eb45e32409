//! `blindaug._blindaug`: the compiled part of the Python package.
//!
//! Nothing is computed here. Arrays become frames and back (`pixels`), what Python hands in becomes a clip with its accompanying data
//! (`footage`), and the jobs of `blindaug-pipeline` run without the interpreter's lock (`listener`), which is taken again only to fetch a
//! frame from Python, to tell it of progress, and to see whether a signal has come. The command line is here too, since the package installs
//! it: a second copy of all this as a program would double the package, and could be of another version.

mod camera;
mod estimate;
mod export;
mod failure;
mod footage;
mod listener;
mod parts;
mod pixels;
mod synthesis;
mod track;

use pyo3::prelude::*;
use std::ffi::OsString;

// Whole images are allocated and freed all the time, as in the command line.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Sets how much memory may be taken, in bytes; 0 for the default, half of what the machine has.
#[pyfunction]
fn set_memory_budget(bytes: u64) {
    blindaug_io::memory::set_budget(bytes);
}

/// Runs the command line of these arguments, of which the first is the program's name, and gives its exit status.
#[pyfunction]
fn run(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| blindaug_cli::run(arguments))
}

/// The module.
#[pymodule]
fn _blindaug(m: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = m.py();
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add("Error", py.get_type::<failure::Error>())?;
    m.add("FileError", py.get_type::<failure::FileError>())?;
    m.add("UnknownError", py.get_type::<failure::UnknownError>())?;
    m.add_class::<camera::Camera>()?;
    m.add_class::<parts::Exposure>()?;
    m.add_class::<parts::Noise>()?;
    m.add_class::<parts::Defocus>()?;
    m.add_class::<parts::Sharpening>()?;
    m.add_class::<export::Export>()?;
    m.add_class::<track::Track>()?;
    m.add_class::<track::Tracker>()?;
    m.add("COLOUR_SPACES", blindaug::colour_space::ColourSpace::NAMED.map(|(name, ..)| name).to_vec())?;
    m.add("EXPORT_TARGETS", export::names())?;
    m.add_function(wrap_pyfunction!(estimate::estimate, m)?)?;
    m.add_function(wrap_pyfunction!(synthesis::apply, m)?)?;
    m.add_function(wrap_pyfunction!(synthesis::composite, m)?)?;
    m.add_function(wrap_pyfunction!(track::track, m)?)?;
    m.add_function(wrap_pyfunction!(camera::read_track, m)?)?;
    m.add_function(wrap_pyfunction!(camera::write_track, m)?)?;
    m.add_function(wrap_pyfunction!(set_memory_budget, m)?)?;
    m.add_function(wrap_pyfunction!(run, m)?)
}
