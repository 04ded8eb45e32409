//! Outputs of frames: a folder of PNG files, or a video.

use crate::console::{self, Result, failure, note};
use blindaug_io::Inputs;
use blindaug_pipeline::{Made, Output};
use blindaug_report::words::count;
use std::path::Path;

/// The frames per second of a video that is made from images.
pub const DEFAULT_FPS: f64 = 30.0;

/// Checks, before anything is read, that a video or a folder of this name can be written and is none of the inputs, and removes the
/// leftovers of earlier runs that were killed.
///
/// # Errors
/// If the output cannot be used; the sentence says why.
pub fn check(path: &Path, inputs: &Inputs) -> Result<()> {
    if Output::is_video(path) {
        return console::check_outputs(inputs, [path]);
    }
    Ok(Output::check_folder(path, inputs)?)
}

/// Opens a folder, or a video by its extension, for frames of a size. Existing frames are kept, unless `overwrite` is set.
///
/// # Errors
/// If a video exists already and `overwrite` is not set, or the output cannot be written.
pub fn open(path: &Path, size: (usize, usize), fps: Option<f64>, overwrite: bool) -> Result<Output> {
    if !Output::is_video(path) {
        return Ok(Output::folder(path, overwrite)?);
    }
    let fps = fps.unwrap_or_else(|| {
        note(format_args!(
            "{}: at {DEFAULT_FPS} frames a second, since the input does not say; --fps N for another",
            path.display()
        ));
        DEFAULT_FPS
    });
    Ok(Output::video(path, size, fps, overwrite)?)
}

/// Prints how many frames exist already and are kept.
pub fn tell_done(path: &Path, output: &Output) {
    use blindaug_pipeline::Sink;
    let done = output.done().len() as u64;
    if done > 0 {
        note(format_args!(
            "{}: {} there already and left as they are (--overwrite makes them anew)",
            path.display(),
            count(done, "frame")
        ));
    }
}

/// Completes an output and prints what was written.
///
/// # Errors
/// If the output cannot be completed, or a signal stopped the job; the sentence then says how to go on.
pub fn finish(path: &Path, output: Output, made: &Made) -> Result<()> {
    output.finish()?;
    note(format_args!("{}: {} written", path.display(), count(made.frames, "frame")));
    match made.stopped {
        None => Ok(()),
        Some((last, next)) if Output::is_video(path) => Err(failure(
            path,
            format_args!(
                "stopped after frame {last}; for the others, run it again with --frames {next}.. and another -o"
            ),
        )),
        Some((last, next)) => Err(failure(
            path,
            format_args!("stopped after frame {last}; the same command goes on with frame {next}"),
        )),
    }
}
