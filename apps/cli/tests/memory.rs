//! Tests of the memory that large frames take, and of the message if that is more than the budget.

use blindaug::{
    CameraModel, Encoded, Raster,
    model::{Capture, Estimate, NOISE_LEVELS, NoiseLevel, NoiseModel, SharpeningModel},
};
use blindaug_io::{write_camera, write_png};
use std::{
    path::Path,
    process::{Command, Output, Stdio},
};

/// Width and height of the picture, px: 201 MB as a frame of f32.
const SIDE: usize = 4096;

fn blindaug(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_blindaug"));
    command.current_dir(folder).args(arguments.split_whitespace()).stdin(Stdio::null());
    command
}

fn output(folder: &Path, arguments: &str) -> Output {
    blindaug(folder, arguments).output().unwrap()
}

/// A folder with a large picture, and a camera of noise and sharpening.
fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let tile = Raster::from_fn(64, 64, |x, y| {
        [0.3 + 0.3 * ((x / 8 + y / 8) % 2) as f32, 0.5, 0.2 + 0.005 * ((x * 7 + y * 13) % 64) as f32]
    });
    let picture = Raster::from_fn(SIDE, SIDE, |x, y| tile.at(x % 64, y % 64));
    write_png(dir.path().join("large.png"), &Encoded(picture)).unwrap();
    let capture = Capture { width: SIDE, height: SIDE, fps: None, frames_used: 1, pixel_aspect: 1.0 };
    let mut camera = CameraModel::unknown(capture, "not measured");
    let level = NoiseLevel { slope: [0.01; 3], intercept: [0.005; 3] };
    camera.noise = Estimate::Known(NoiseModel::given([level; NOISE_LEVELS], 1.0));
    camera.sharpening = Estimate::Known(SharpeningModel::given(0.5, 1.0));
    write_camera(dir.path().join("camera.json"), &camera).unwrap();
    dir
}

/// The peak memory of a command, bytes.
#[cfg(target_os = "linux")]
fn most_memory(folder: &Path, arguments: &str) -> u64 {
    // Each thread adds memory of its own, about 10 MB; the limits are for two.
    let mut command = blindaug(folder, arguments);
    command.env("RAYON_NUM_THREADS", "2").stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let mut most = 0;
    loop {
        // The kernel keeps the maximum; it is gone when the process has ended.
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
        let kilobytes = line.and_then(|l| l.trim().strip_suffix("kB")?.trim().parse::<u64>().ok());
        most = kilobytes.map_or(most, |kb| most.max(kb << 10));
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "{arguments}");
            return most;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_large_picture_is_distorted_and_measured_in_strips() {
    let dir = folder();
    // The commands hold the frame and the strips; before they worked in strips, they took 1.8 GB and 1.3 GB.
    for arguments in ["apply large.png --camera camera.json -o out", "estimate large.png -o large.json"] {
        let most = most_memory(dir.path(), arguments);
        assert!((200_000_000..800_000_000).contains(&most), "{arguments}: {} MB", most / 1_000_000);
    }
}

#[test]
fn what_does_not_fit_into_the_budget_is_refused_before_anything_is_made() {
    let dir = folder();
    let refused = |arguments: &str, says: &str| {
        let output = output(dir.path(), arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{arguments}: {said}");
        let last = said.lines().last().unwrap_or_default();
        assert!(last.starts_with("blindaug: large.png: ") && last.contains(says), "{arguments}: {said}");
    };
    // The frame alone does not fit into 100 MB, and with the memory for its distortion it does not fit into 300 MB.
    refused(
        "--memory 100M apply large.png --camera camera.json -o out",
        "an image of 4096 x 4096 pixels takes 202 MB of memory, and the budget is 100 MB: raise it, or",
    );
    refused(
        "apply large.png --camera camera.json -o out --memory 0.3G",
        "of memory, and the budget is 300 MB",
    );
    refused("estimate large.png -o large.json --memory 300M", "of memory, and the budget is 300 MB");
    let left: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|f| f.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
    for wrong in ["4", "4K", "0G", "-1G", "2000G", "much"] {
        let output = output(dir.path(), &format!("--memory={wrong} inspect camera.json"));
        assert_eq!(output.status.code(), Some(2), "{wrong}");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains("64M to 1000G"), "{said}");
    }
    assert!(output(dir.path(), "--memory 64M inspect camera.json").status.success());
}
