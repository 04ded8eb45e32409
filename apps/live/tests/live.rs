//! Tests of `blindaug live` without its window.

#[path = "../../cli/tests/common/mod.rs"]
mod common;

use blindaug_gpu::Gpu;
use blindaug_io::{FrameSource, read_frame};
use common::*;
use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};
use tempfile::TempDir;

fn blindaug() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_blindaug-live"));
    command.stdin(Stdio::null());
    command
}

/// A clip of four frames.
fn clip() -> TempDir {
    let dir = TempDir::new().unwrap();
    write_frames(&dir.path().join("frames"), 1..=4, (128, 96));
    dir
}

#[test]
fn a_clip_is_played_again_and_again_and_two_runs_are_the_same() {
    if Gpu::for_tests().is_none() {
        return;
    }
    let dir = clip();
    let live = |more: &str| succeeds(dir.path(), &format!("frames --headless --frames 6 {more}"));
    let said = live("-o a");
    let camera: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!((&camera["frame"], &camera["capture"]["frames_used"]), (&6.into(), &6.into()), "{said}");
    assert!(camera["noise"].is_object() && said.lines().count() == 1);
    assert_eq!(live("-o b"), said);
    let names: Vec<String> = (1..=6).map(|n| format!("{n:04}.png")).collect();
    assert_eq!(files_in(&dir.path().join("a")), names);
    for name in &names {
        let read = |folder: &str| std::fs::read(dir.path().join(folder).join(name)).unwrap();
        assert_eq!(read("a"), read("b"), "{name}");
    }
    // Frame 5 is the first one again, with the object in the middle and the line beside it.
    let shown = read_frame(dir.path().join("a/0005.png")).unwrap();
    let filmed = read_frame(dir.path().join("frames/0001.png")).unwrap();
    assert_eq!(shown.0.at(3, 3), filmed.0.at(3, 3));
    assert_eq!(shown.0.at(64, 3), [1.0; 3]);
    assert_ne!(shown, filmed);
    // Left of the line the object is pasted, right of it the camera's distortions are on it.
    live("-o pasted --split 1");
    live("-o filmed --split 0");
    let [pasted, made] =
        ["pasted", "filmed"].map(|f| read_frame(dir.path().join(f).join("0005.png")).unwrap());
    let same = |other: &blindaug::Encoded, columns: std::ops::Range<usize>| {
        columns.into_iter().all(|x| (0..96).all(|y| shown.0.at(x, y) == other.0.at(x, y)))
    };
    assert!(same(&pasted, 0..63) && same(&made, 65..128) && !same(&pasted, 65..128));
    // An existing output is not replaced unasked.
    assert!(fails(dir.path(), "frames --headless --frames 6 -o a").contains("--overwrite"));
    live("-o a --overwrite");
}

#[cfg(unix)]
#[test]
fn ctrl_c_keeps_the_frames_so_far_and_says_that_there_should_be_more() {
    if Gpu::for_tests().is_none() {
        return;
    }
    let dir = clip();
    let d = dir.path();
    let mut command = blindaug();
    command.current_dir(d).args("frames --headless --frames 100000 -o out".split_whitespace());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let start = Instant::now();
    while !d.join("out/0002.png").exists() {
        assert!(start.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let said = sentence_with(130, &output, "live");
    let made = files_in(&d.join("out"));
    let wanted = format!(
        "stopped after frame {} of 100000; for all of them, run it again with --overwrite",
        made.len()
    );
    assert!(said.contains(&wanted), "{said}");
    assert!(output.stdout.is_empty());
    for name in &made {
        read_frame(d.join("out").join(name)).unwrap();
    }
}

#[test]
fn what_cannot_be_read_ends_in_a_sentence_and_leaves_nothing() {
    let dir = clip();
    std::fs::create_dir(dir.path().join("empty")).unwrap();
    std::fs::write(dir.path().join("cut.glb"), b"glTF\x02\0\0\0\xff\0\0\0\x40\0\0\0JSON{\"asset\":").unwrap();
    let before = files_in(dir.path());
    for (arguments, file) in [
        ("missing.mp4", "missing.mp4"),
        ("empty", "empty"),
        ("cut.glb", "cut.glb"),
        ("camera:77", "camera:77"),
        ("frames --object missing.glb", "missing.glb"),
        ("frames --object cut.glb", "cut.glb"),
        ("frames --object frames/0001.png", "0001.png"),
    ] {
        for output in ["out", "out.mp4"] {
            let said = fails(dir.path(), &format!("{arguments} --headless --frames 2 -o {output}"));
            assert!(said.contains(file), "{said}");
            assert_eq!(files_in(dir.path()), before, "{arguments}");
            assert!(!dir.path().join("out").exists(), "{arguments}");
        }
    }
    for wrong in [
        "--headless",
        "--headless --frames 0 -o out",
        "--frames 3",
        "--split 2",
        "--fov 0",
        "--distance x",
        "--fps 0",
    ] {
        let output = run(dir.path(), &format!("frames {wrong}"));
        assert_eq!(output.status.code(), Some(2), "{wrong}");
    }
}

#[test]
fn a_video_comes_out_of_a_video() {
    if Gpu::for_tests().is_none() {
        return;
    }
    let shared = std::env::var_os("BLINDAUG_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"), PathBuf::from);
    let video = shared.join("data/video/bikes.mp4");
    if !video.is_file() {
        eprintln!("NOT TESTED: no video at {} (set BLINDAUG_SHARED)", video.display());
        return;
    }
    let dir = TempDir::new().unwrap();
    let video = video.display();
    succeeds(dir.path(), &format!("{video} --headless --frames 5 -o out.mp4 --bokeh disk --size 1 --fps 10"));
    let made = FrameSource::open(dir.path().join("out.mp4"), Default::default()).unwrap();
    assert_eq!((made.size(), made.fps(), made.frames().count()), ((640, 272), Some(10.0), 5));
}
