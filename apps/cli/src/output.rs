//! Outputs of frames: a folder of images, one image, or a video.

use crate::console::{self, Result, failure, note};
use crate::provenance;
use blindaug_io::{Inputs, VideoShape, fingerprint};
use blindaug_pipeline::{ImageFiles, Made, Output};
use blindaug_report::words::count;
use std::path::Path;

/// The frames per second of a video that is made from images.
pub const DEFAULT_FPS: f64 = 30.0;

/// The frames that an output is opened for.
pub struct Expected {
    /// Width and height of each, px.
    pub size: (usize, usize),
    /// Frames per second, where that is known.
    pub fps: Option<f64>,
    /// The number of frames, where that is known.
    pub count: Option<u64>,
    /// The bits of a value in a video: 8 or 10.
    pub video_bits: u8,
    /// The width of a pixel over its height, where that is known.
    pub pixel_aspect: Option<f32>,
}

/// Checks, before anything is read, that a video, an image or a folder of this name can be written and is none of the inputs, and removes the
/// leftovers of earlier runs that were killed.
///
/// # Errors
/// If the output cannot be used; the sentence says why.
pub fn check(path: &Path, inputs: &Inputs) -> Result<()> {
    if Output::is_file(path) {
        return console::check_outputs(inputs, [path]);
    }
    Ok(Output::check_folder(path, inputs)?)
}

/// What the frames that this command line makes depend on: its arguments, without those that choose frames and say where they go, and what
/// the files hold that the cameras come from.
///
/// # Errors
/// If a file cannot be read.
fn settings(cameras: &[&Path]) -> Result<String> {
    let mut text = chosen(provenance::arguments().into_iter()).join("\n");
    for camera in cameras {
        let hash = fingerprint(camera)?.map_or_else(|| "no file".into(), |f| f.sha256);
        text.push_str(&format!("\n{hash}"));
    }
    text.push('\n');
    Ok(text)
}

/// The arguments that frames depend on. What the camera's file holds counts, not its name.
fn chosen(mut arguments: impl Iterator<Item = String>) -> Vec<String> {
    const WITH_VALUE: [&str; 5] = ["-o", "--output", "--frames", "--memory", "--camera"];
    let mut kept = vec![];
    while let Some(argument) = arguments.next() {
        let joined = || {
            let long = WITH_VALUE[1..].iter().any(|name| argument.starts_with(&format!("{name}=")));
            long || argument.starts_with("-o")
        };
        if WITH_VALUE.contains(&argument.as_str()) {
            arguments.next();
        } else if argument != "--overwrite" && !joined() {
            kept.push(argument);
        }
    }
    kept
}

/// Opens a folder, or an image or a video by its extension, for frames. Existing frames of a folder are kept, unless `overwrite` is set.
///
/// # Errors
/// If an image or a video exists already and `overwrite` is not set, frames of a folder were made with other settings, an image is to
/// take several frames, or the output cannot be written.
pub fn open(
    path: &Path,
    expected: &Expected,
    files: ImageFiles,
    cameras: &[&Path],
    overwrite: bool,
) -> Result<Output> {
    if Output::is_video(path) {
        let fps = expected.fps.unwrap_or_else(|| {
            note(format_args!(
                "{}: at {DEFAULT_FPS} frames a second, since the input does not say; --fps N for another",
                path.display()
            ));
            DEFAULT_FPS
        });
        let shape =
            VideoShape { size: expected.size, fps, pixel_aspect: expected.pixel_aspect.unwrap_or(1.0) };
        return Ok(Output::video(path, shape, (files.coding, expected.video_bits), overwrite)?);
    }
    if !Output::is_file(path) {
        return Ok(Output::folder(path, files, &settings(cameras)?, overwrite)?);
    }
    match expected.count {
        Some(1) => Ok(Output::image(path, files, overwrite)?),
        n => {
            let n = n.map_or("the input has several frames".to_owned(), |n| format!("there are {n} frames"));
            Err(failure(
                path,
                format_args!("this is one image, but {n}: give a folder, or one frame by --frames N..N"),
            ))
        }
    }
}

/// Completes an output and prints what was written.
///
/// # Errors
/// If the output cannot be completed, or a signal stopped the job; the sentence then says how to go on.
pub fn finish(path: &Path, output: Output, made: &Made) -> Result<()> {
    let overwrites = output.overwrites();
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
        Some((last, next)) if overwrites => Err(failure(
            path,
            format_args!("stopped after frame {last}; for the others, run it again with --frames {next}.."),
        )),
        Some((last, next)) => Err(failure(
            path,
            format_args!("stopped after frame {last}; the same command goes on with frame {next}"),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_depend_on_all_arguments_but_those_that_choose_them_and_say_where_they_go() {
        let of = |line: &str| chosen(line.split(' ').map(str::to_owned));
        let line = "composite plates --virtual obj --camera c.json --shutter 180";
        let asked = of(line);
        assert_eq!(asked.len(), 6);
        for more in ["-o out", "--output=out", "--frames 3..", "--frames=3..", "--overwrite", "--memory 1G"] {
            assert_eq!(of(&format!("{line} {more}")), asked, "{more}");
        }
        assert_ne!(of(&line.replace("180", "90")), asked);
    }
}
