//! Helpers for the tests of the programs, which run a program and check its messages and files. The test names the program by a function
//! `blindaug`.
#![allow(dead_code)]

use blindaug::{Encoded, Raster};
use blindaug_io::write_png;
use std::{path::Path, process::Output};

/// Runs the binary with these arguments, separated by spaces, in a folder.
pub fn run(folder: &Path, arguments: &str) -> Output {
    super::blindaug().current_dir(folder).args(arguments.split_whitespace()).output().unwrap()
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs the binary, which must succeed, and returns its standard output.
pub fn succeeds(folder: &Path, arguments: &str) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{arguments}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// Runs the binary, which must fail with exit status 1, and returns its sentence, the last line of standard error.
pub fn fails(folder: &Path, arguments: &str) -> String {
    sentence_of(&run(folder, arguments), arguments)
}

pub fn sentence_of(output: &Output, arguments: &str) -> String {
    sentence_with(1, output, arguments)
}

/// The sentence of a failure with another exit status: 130 after Ctrl-C.
pub fn sentence_with(status: i32, output: &Output, arguments: &str) -> String {
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{arguments}: {errors}");
    assert!(!errors.contains("panicked"), "{arguments}: {errors}");
    let said: Vec<&str> = errors.lines().filter(|l| l.starts_with("blindaug: ")).collect();
    assert_eq!(said.len(), 1, "{arguments}: {errors}");
    assert_eq!(errors.lines().last(), Some(said[0]), "{arguments}: {errors}");
    said[0].into()
}

/// All files in a folder, hidden ones too, by their paths from it.
pub fn files_in(folder: &Path) -> Vec<String> {
    fn visit(folder: &Path, root: &Path, found: &mut Vec<String>) {
        for entry in folder.read_dir().unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => visit(&path, root, found),
                // The settings of frames, beside them.
                false
                    if path.file_name().is_some_and(|name| {
                        let name = name.to_string_lossy();
                        name.ends_with(".settings") && !name.contains("partial")
                    }) => {}
                false => found.push(path.strip_prefix(root).unwrap().to_string_lossy().into_owned()),
            }
        }
    }
    let mut found = Vec::new();
    visit(folder, folder, &mut found);
    found.sort();
    found
}

/// A textured picture, moved by (2 t, t) px.
pub fn picture(width: usize, height: usize, t: usize) -> Encoded {
    Encoded(Raster::from_fn(width, height, |x, y| {
        let (x, y) = ((x + 2 * t) as f32, (y + t) as f32);
        let wave = |a: f32, b: f32| 0.5 + 0.25 * (a * x + b * y).sin() + 0.2 * (b * x - a * y).sin();
        [wave(0.31, 0.17), wave(0.13, 0.57), wave(0.77, 0.05)]
    }))
}

pub fn write_frames(
    folder: &Path,
    numbers: impl IntoIterator<Item = usize>,
    (width, height): (usize, usize),
) {
    std::fs::create_dir_all(folder).unwrap();
    for n in numbers {
        write_png(folder.join(format!("{n:04}.png")), &picture(width, height, n)).unwrap();
    }
}
