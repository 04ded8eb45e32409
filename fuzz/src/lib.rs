//! Code that the fuzz targets share.
//!
//! A target fails on a panic that reaches it, on an abort, on five seconds without an end, and on too much memory. A panic within
//! [`blindaug_io::guarded`] does not count, because it becomes an error of the file, as in the program: the hook of `guarded` hands
//! only other panics on to libFuzzer's hook.

use blindaug::{
    CameraModel,
    export::{Camera, Target, View, grain},
    model::{CameraTrack, DefocusModel, DepthKind},
};
use std::{
    fmt::Display,
    path::{Path, PathBuf},
    sync::OnceLock,
};

/// Writes the bytes to a file with this extension, in memory if possible, and returns its path; the next call overwrites the file.
pub fn file(bytes: &[u8], ending: &str) -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    let path = PATH.get_or_init(|| {
        let memory = Path::new("/dev/shm");
        let temporary = std::env::temp_dir();
        let parent = if memory.is_dir() { memory } else { &temporary };
        // Each run has a folder of its own, so that the files that an object refers to are not those of another run.
        let folder = parent.join(format!("blindaug-fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder for the input");
        folder.join(format!("input.{ending}"))
    });
    std::fs::write(path, bytes).expect("a file for the input");
    path
}

/// Checks that an error is one line of moderate length without control characters; returns the value if there is no error.
pub fn check<T, E: Display>(result: Result<T, E>) -> Option<T> {
    result
        .map_err(|e| {
            let text = e.to_string();
            assert!(text.len() < 2000, "an error of {} bytes", text.len());
            assert!(!text.contains(['\n', '\r', '\x1b']), "an error with control characters: {text:?}");
        })
        .ok()
}

/// Reads an image as a frame, as linear light and as depth.
pub fn image(bytes: &[u8], ending: &str) {
    let path = file(bytes, ending);
    check(blindaug_io::read_frame(path));
    check(blindaug_io::read_linear(path));
    check(blindaug_io::read_inverse_depth(path, blindaug_io::DepthFormat::default()));
}

/// Does with a camera model what the program does after reading one.
pub fn use_camera(model: &CameraModel) {
    let text = model.to_json();
    assert!(
        check(CameraModel::from_json(&text)).is_some(),
        "what was read and written is not read again: {text}"
    );
    check(model.check_width(model.capture.width));
    for (width, height) in [(1, 1), (1920, 1080), (16_384, 8_192)] {
        let scaled = model.scaled_to(width, height);
        if let Some(defocus) = scaled.defocus.known() {
            use_defocus(defocus);
        }
        if let Some(noise) = scaled.noise.known() {
            let _ = [0.0, 0.5, 1.0].map(|y| noise.total_std(y));
        }
        if let (Some(blur), Some(fps)) = (scaled.motion_blur.known(), scaled.capture.fps) {
            let _ = (blur.exposure.shutter_angle(), blur.exposure.seconds(fps));
        }
        if let Some(sharpening) = scaled.sharpening.known() {
            sharpening.gain(0.25);
        }
    }
    let view = View { size: Some((640, 360)), fov_y_degrees: Some(50.0) };
    if let Some(camera) = check(Camera::new(model, &view)) {
        // Textures of grain take seconds with the sanitizer, and depend on the model by a few factors only.
        camera.noise.as_ref().map(grain::table);
        let without_noise = Camera { noise: None, ..camera };
        for target in Target::ALL {
            target.export(&without_noise);
        }
    }
}

fn use_defocus(defocus: &DefocusModel) {
    for d in [0.0, 0.1, 1.0, 10.0] {
        defocus.sigma_px(d);
    }
    defocus.focus_range(0.5);
    if defocus.depth_kind == DepthKind::Relative {
        defocus.to_metric(0.7, 0.1).sigma_px(1.0);
    }
}

/// Does with per-frame camera models what the program does after reading them.
pub fn use_track(track: &CameraTrack) {
    for frame in [0, 1, 7, u64::MAX] {
        use_camera(&track.at(frame));
    }
    // Only the first few models are used, since the file may hold as many as its size allows.
    for camera in track.frames().iter().take(4) {
        camera.to_json_line();
        use_camera(&camera.camera);
    }
}
