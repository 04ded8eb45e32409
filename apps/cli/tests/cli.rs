//! Tests of the binary: every command, its messages, and the files that it leaves behind when something is wrong.

mod common;
mod harm;
mod networks;

use blindaug::{
    CameraModel, Linear, Plane, Raster, Transfer,
    colour_space::ColourSpace,
    export::Target,
    model::{
        Aperture, Bokeh, Capture, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction, Method,
        MotionBlurModel, NOISE_LEVELS, NoiseLevel, NoiseLines, NoiseModel, Reason, SharpeningModel,
        ThinLensInterval, TrackedCamera, Unknown,
    },
};
use blindaug_io::{
    Coding, FileKind, FrameFormat, read_frame, read_linear, read_virtual_layer, write_camera, write_grey16,
};
use common::*;
use std::{
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};
use tempfile::TempDir;

fn blindaug() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_blindaug"));
    command.stdin(Stdio::null());
    command
}

/// A camera of known parameters.
fn camera(width: usize, height: usize, depth_kind: DepthKind) -> CameraModel {
    let capture = Capture { width, height, fps: Some(25.0), frames_used: 3, pixel_aspect: 1.0 };
    let mut model = CameraModel::unknown(capture, "");
    model.noise = Estimate::Known(NoiseModel::Lines(NoiseLines {
        levels: [NoiseLevel { slope: [0.01; 3], intercept: [0.01; 3] }; NOISE_LEVELS],
        interval: None,
        clip: 1.0,
        method: Method::Temporal,
        samples: 1000,
    }));
    model.motion_blur = Estimate::Known(MotionBlurModel {
        exposure: ExposureFraction(0.5),
        interval: [0.45, 0.55],
        method: Method::Spectral,
        samples: 100,
        phase_degrees: None,
    });
    model.defocus = Estimate::Known(DefocusModel {
        curve: DefocusCurve::ThinLens { sigma_px_at_infinity: 2.0, focus_inverse_depth: 0.5, interval: None },
        depth_kind,
        bokeh: Aperture::default(),
        method: Method::Spectral,
        samples: 100,
        inverse_depth_seen: None,
    });
    model
}

/// The path of a file of the demo's clip.
fn asset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo").join(name)
}

fn demo_arguments() -> String {
    let path = |name| asset(name).display().to_string();
    format!("{} --virtual {} --depth {}", path("frames"), path("virtual"), path("scene"))
}

#[test]
fn help_and_version_are_there() {
    let dir = TempDir::new().unwrap();
    let help = succeeds(dir.path(), "--help");
    for command in ["demo", "estimate", "composite", "apply", "match", "frames", "inspect"] {
        assert!(help.contains(command), "{command}");
        assert!(succeeds(dir.path(), &format!("{command} --help")).contains("Usage"));
    }
    assert!(succeeds(dir.path(), "--version").starts_with("blindaug "));
}

#[test]
fn wrong_usage_exits_with_2() {
    let dir = TempDir::new().unwrap();
    for arguments in [
        "",
        "paint",
        "estimate",
        "estimate a.png",
        "estimate -o c.json",
        "estimate a.png -o c.json --frames 5",
        "estimate a.png -o c.json --method magic",
        "estimate a.png -o c.json --evidence d",
        "estimate a.png -o c.json --fps 0",
        "estimate a.png -o c.json --depth d --depth-scale -1",
        "composite a.png --virtual v -o out",
        "composite a.png --virtual v --camera c.json -o out --with w",
        "composite a.png --virtual v --camera c.json -o out --without w",
        "composite a.png --virtual v --camera c.json -o out --scene-scale 0",
        "composite a.png --virtual v --camera c.json -o out --seed -1",
        "inspect",
        "inspect c.json --at-depth 1,nan",
    ] {
        let output = run(dir.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments}: {}", text(&output.stderr));
        assert!(!output.stderr.is_empty());
    }
    assert!(files_in(dir.path()).is_empty());
}

#[test]
fn inputs_that_are_not_there_or_empty_are_named() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    std::fs::create_dir(d.join("empty")).unwrap();
    for file in ["notes.txt", "notes.exr"] {
        std::fs::write(d.join(file), "no video").unwrap();
    }
    write_camera(d.join("c.json"), &camera(8, 8, DepthKind::Metric)).unwrap();
    write_frames(&d.join("f"), 1..3, (8, 8));
    for (arguments, says) in [
        ("estimate none.mp4 -o c2.json", "none.mp4: there is no such file"),
        ("estimate empty -o c2.json", "empty: the folder has no images"),
        ("estimate notes.txt -o c2.json", "notes.txt: "),
        ("estimate notes.exr -o c2.json", "notes.exr: not an image that can be read"),
        ("estimate f -o c2.json --frames 7..9", "no frame in 7..9"),
        ("estimate f -o c2.json --depth none", "none: there is no such file"),
        ("estimate f -o c2.json --depth empty", "empty: the folder has no files with depth"),
        ("estimate -o c2.json --evidence empty --scene x", "no scene \"x\""),
        ("composite none --virtual f --camera c.json -o out", "none: there is no such file"),
        (
            "composite f --virtual empty --camera c.json -o out",
            "empty: the folder has no files with virtual layers",
        ),
        ("apply f --camera none.json -o out", "none.json: there is no such file"),
        ("apply f --camera c.json -o f", "this is an input, which would be overwritten"),
        ("match f --from c.json --to none.json -o out", "none.json: there is no such file"),
        ("match f --from c.json --to c.json -o f", "this is an input, which would be overwritten"),
        ("frames none.mp4", "none.mp4: there is no such file"),
        ("frames notes.txt", "notes.txt: "),
        ("frames f -o notes/r.json", "notes"),
        ("inspect none.json", "none.json: there is no such file"),
    ] {
        let said = fails(d, arguments);
        assert!(said.contains(says), "{arguments}: {said}");
    }
    assert!(!d.join("c2.json").exists());
    assert_eq!(files_in(&d.join("f")).len(), 2);
}

#[test]
fn bad_camera_files_are_refused_with_the_reason() {
    let dir = TempDir::new().unwrap();
    let good = camera(8, 8, DepthKind::Metric).to_json();
    for (from, to, says) in [
        ("\"version\": 1", "\"version\": 2", "version 2"),
        ("\"version\": 1,", "", "version"),
        ("\"exposure\": 0.5", "\"exposures\": 0.5", "exposure"),
        ("\"exposure\": 0.5", "\"exposure\": NaN", "not a camera model"),
        ("\"exposure\": 0.5", "\"exposure\": -0.5", "exposure"),
        ("\"sigma_px_at_infinity\": 2.0", "\"sigma_px_at_infinity\": -2.0", "sigma_px_at_infinity"),
        ("\"width\": 8", "\"width\": 0", "width"),
        ("blindaug-camera", "something-else", "something-else"),
        ("}", "", "not a camera model"),
    ] {
        assert!(good.contains(from), "{from} in {good}");
        std::fs::write(dir.path().join("c.json"), good.replacen(from, to, 1)).unwrap();
        let said = fails(dir.path(), "inspect c.json");
        assert!(said.contains("c.json: ") && said.contains(says), "{said}");
    }
    std::fs::write(dir.path().join("c.json"), [0xff, 0xfe, 0]).unwrap();
    fails(dir.path(), "inspect c.json");
}

#[test]
fn a_camera_is_told_in_words_and_as_json() {
    let dir = TempDir::new().unwrap();
    write_camera(dir.path().join("c.json"), &camera(640, 480, DepthKind::Metric)).unwrap();
    let words = succeeds(dir.path(), "inspect c.json --at-depth 1,4");
    for says in
        ["640 x 480", "180 degrees", "20.0 ms", "in focus at 2 m", "at 1 m: 2.00 px", "at 4 m: 1.00 px"]
    {
        assert!(words.contains(says), "{says} in {words}");
    }
    let json = succeeds(dir.path(), "inspect c.json --at-depth 1 --json");
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let near = |path: &str, want: f64| {
        let got = json.pointer(path).and_then(|v| v.as_f64()).unwrap_or_else(|| panic!("{path} in {json}"));
        assert!((got - want).abs() < 1e-4, "{path}: {got}");
    };
    near("/motion_blur/shutter_angle_degrees", 180.0);
    near("/motion_blur/exposure_time_s", 0.02);
    near("/defocus/focus_distance_m", 2.0);
    near("/defocus/depth_m_with_sigma_below_half_px/0", 1.6);
    near("/defocus/depth_m_with_sigma_below_half_px/1", 1.0 / 0.375);
    near("/defocus/at/0/sigma_px", 2.0);
    assert!(!words.contains("sharpen") && json.get("sharpening").is_none());
    near("/motion_blur/shutter_angle_interval/0", 162.0);
    near("/motion_blur/exposure_time_interval/1", 0.022);
    let mut sharpening = camera(640, 480, DepthKind::Metric);
    sharpening.sharpening = Estimate::Known(SharpeningModel {
        amount: 0.7,
        radius_px: 1.25,
        interval: [0.5, 0.9],
        method: Method::Temporal,
        samples: 40,
    });
    write_camera(dir.path().join("c.json"), &sharpening).unwrap();
    let words = succeeds(dir.path(), "inspect c.json");
    for says in ["amount 0.7 (0.5 to 0.9, 95 % sure)", "radius 1.25 px", "of successive frames (40 samples)"]
    {
        assert!(words.contains(says), "{says} in {words}");
    }
    assert!(succeeds(dir.path(), "inspect c.json --json").contains("\"radius_px\": 1.25"));
    let unknown = CameraModel::unknown(
        Capture { width: 4, height: 3, fps: None, frames_used: 1, pixel_aspect: 1.0 },
        "nothing moves",
    );
    write_camera(dir.path().join("c.json"), &unknown).unwrap();
    let words = succeeds(dir.path(), "inspect c.json --at-depth 1");
    assert_eq!(words.matches("unknown: nothing moves").count(), 3, "{words}");
}

#[test]
fn intervals_stand_beside_values_and_numbers_have_no_dust() {
    let dir = TempDir::new().unwrap();
    let told = |model: &CameraModel| {
        write_camera(dir.path().join("c.json"), model).unwrap();
        (
            succeeds(dir.path(), "inspect c.json --at-depth 1"),
            succeeds(dir.path(), "inspect c.json --at-depth 1 --json"),
        )
    };
    let mut model = camera(640, 480, DepthKind::Metric);
    let lens = |s: f32, low: f32, f: f32| DefocusModel {
        inverse_depth_seen: Some([0.25, 0.8]),
        ..DefocusModel::given(
            DefocusCurve::ThinLens {
                sigma_px_at_infinity: s,
                focus_inverse_depth: f,
                interval: Some(ThinLensInterval {
                    sigma_px_at_infinity: [low, s + 0.3],
                    focus_inverse_depth: [0.8 * f, 1.25 * f],
                }),
            },
            DepthKind::Metric,
        )
    };
    // 0.1 + 0.7 - 0.32 is 0.48000002 in f32.
    model.motion_blur = Estimate::Known(MotionBlurModel {
        exposure: ExposureFraction(0.1 + 0.7 - 0.32),
        interval: [0.44, 0.52],
        method: Method::Spectral,
        samples: 100,
        phase_degrees: None,
    });
    model.warnings = vec!["the model rests on one frame only".into()];
    model.defocus = Estimate::Known(lens(2.0, 1.7, 0.5));
    let (words, json) = told(&model);
    assert!(words.lines().nth(1).unwrap().starts_with("Warning    the model rests on one frame"), "{words}");
    assert!(words.contains("in focus at 2 m (1.6 m to 2.5 m)"), "{words}");
    assert!(words.contains("at 1 m: 2.00 px ("), "{words}");
    assert!(!words.contains('\x1b'), "{words}");
    let value: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(value["motion_blur"]["exposure"].to_string(), "0.48");
    assert_eq!(value["defocus"]["focus_distance_m_interval"].to_string(), "[1.6,2.5]");
    assert_eq!(value["defocus"]["sigma_px_at_infinity_interval"].to_string(), "[1.7,2.3]");
    assert!(value["defocus"]["at"][0]["interval"].is_array() && value["warnings"].is_array());
    let file = std::fs::read_to_string(dir.path().join("c.json")).unwrap();
    assert!(file.contains("\"exposure\": 0.48,"), "{file}");
    // No number in either has more than six digits.
    for text in [&json, &file] {
        for number in text.split(|c: char| !(c.is_ascii_digit() || c == '.')).filter(|n| n.contains('.')) {
            let digits = number.replace('.', "");
            assert!(digits.trim_start_matches('0').len() <= 6, "{number}");
        }
    }
    // A focus outside of what was seen is no number, and blur that cannot be told from none is a bound.
    model.defocus = Estimate::Known(lens(2.0, 1.7, 1.5));
    let (words, json) = told(&model);
    assert!(
        words.contains("in focus nearer than all that is seen") && !words.contains("in focus at"),
        "{words}"
    );
    assert!(json.contains("\"focus_outside_of_what_was_seen\": \"nearer than all that is seen\""), "{json}");
    model.defocus = Estimate::Known(lens(2.0, 1.7, 0.1));
    assert!(told(&model).0.contains("in focus beyond all that is seen, that is beyond 4 m"));
    model.defocus = Estimate::Known(lens(1e-6, 0.0, 0.5));
    let (words, _) = told(&model);
    assert!(words.contains("everything is in focus") && words.contains("below 0.30 px"), "{words}");
}

#[test]
fn estimates_are_printed_as_json_with_and_without_a_file() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    write_frames(&folder.join("clip"), 1..=4, (160, 128));
    let printed = succeeds(folder, "estimate clip --json");
    let model = CameraModel::from_json(&printed).unwrap();
    assert!(model.warnings.iter().any(|w| w.contains("4 frames only")), "{:?}", model.warnings);
    assert_eq!(files_in(folder).len(), 4);
    assert_eq!(succeeds(folder, "estimate clip --json -o camera.json"), printed);
    assert_eq!(std::fs::read_to_string(folder.join("camera.json")).unwrap(), printed);
    // Negative control: without --json the words are printed, and -o is needed.
    assert!(succeeds(folder, "estimate clip -o camera.json").starts_with("Camera "));
    assert_eq!(run(folder, "estimate clip").status.code(), Some(2));
    let lines = succeeds(folder, "estimate clip --track --json -o track.jsonl");
    assert_eq!(lines.lines().count(), 4);
    assert_eq!(std::fs::read_to_string(folder.join("track.jsonl")).unwrap(), lines);
    assert_eq!(succeeds(folder, "estimate clip --track --json"), lines);
}

#[test]
fn saved_evidence_gives_the_same_estimate_again() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let demo = |options: &str| {
        let frames = asset("frames");
        succeeds(folder, &format!("estimate {} --fps 24 --json {options}", frames.display()))
    };
    let again = "estimate --evidence saved --scene frames --json";
    // After frame 3 flow leads out of the range.
    for options in ["--frames 1..3", "", &format!("--depth {}", asset("scene").display())] {
        std::fs::remove_dir_all(folder.join("saved")).ok();
        let first = demo(&format!("--save-evidence saved {options}"));
        let second = succeeds(folder, again);
        let [a, b] = [&first, &second].map(|text| CameraModel::from_json(text).unwrap());
        assert_eq!(a.capture, b.capture);
        assert_eq!(a.capture.fps, Some(24.0));
        assert_eq!(a.motion_blur, b.motion_blur, "{options}");
        let [lens_a, lens_b] = [&a, &b].map(|m| *m.defocus.known().expect("depth is known"));
        assert_eq!(lens_a.depth_kind, lens_b.depth_kind);
        // Depth has 16 bits in files.
        for d in [0.1, 0.3, 0.5] {
            let [s, t] = [lens_a, lens_b].map(|lens| lens.sigma_px(d));
            assert!((s - t).abs() < 0.02 * s.max(0.5), "{options}: {s} {t}");
        }
    }
    // Negative control: without the file beside them, the unit of depth and the frame rate are not known.
    std::fs::remove_file(folder.join("saved/frames.evidence.json")).unwrap();
    let without = CameraModel::from_json(&succeeds(folder, again)).unwrap();
    assert_eq!(without.capture.fps, None);
    assert_ne!(without.defocus.known().map(|d| d.depth_kind), Some(DepthKind::Metric));
    std::fs::write(folder.join("saved/frames.evidence.json"), "{}").unwrap();
    let sentence = fails(folder, again);
    assert!(sentence.contains("frames.evidence.json: it does not describe evidence"), "{sentence}");
}

#[test]
fn what_was_read_is_said_with_its_unit_once_and_help_has_groups_and_examples() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    write_frames(&folder.join("clip"), 1..=2, (160, 128));
    let output = run(
        folder,
        &format!("estimate {} --depth {} -o c.json", asset("frames").display(), asset("scene").display()),
    );
    let said = text(&output.stderr);
    assert!(said.contains("depth: 5 EXR files, in metres") && !said.contains("units"), "{said}");
    let grey = blindaug::Plane::from_fn(160, 128, |x, _| 0.01 + 0.0001 * x as f32);
    std::fs::create_dir(folder.join("depth")).unwrap();
    blindaug_io::write_grey16(folder.join("depth/0001.png"), &grey).unwrap();
    let said = text(&run(folder, "estimate clip --depth depth -o c.json").stderr);
    assert!(said.contains("depth: 1 PNG file, 1000 units a metre"), "{said}");
    let help = succeeds(folder, "--help");
    for part in ["From footage to a composite:", "Research:", "for example: blindaug estimate shot.mp4"] {
        assert!(help.contains(part), "{part} in {help}");
    }
    let help = succeeds(folder, "estimate --help");
    for part in ["Evidence:", "Results:", "Set by hand:", "Example: blindaug estimate"] {
        assert!(help.contains(part), "{part} in {help}");
    }
}

#[test]
fn a_report_begins_with_warnings_and_ends_with_where_it_comes_from() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    write_frames(&folder.join("clip"), 1..=3, (160, 128));
    succeeds(folder, "estimate clip -o c.json --report r.html");
    let html = std::fs::read_to_string(folder.join("r.html")).unwrap();
    let at = |part: &str| html.find(part).unwrap_or_else(|| panic!("{part}"));
    let order = [
        "The model rests on 3 frames only",
        "aria-label=\"In short\"",
        "<h2>Before and after</h2>",
        "<h2>Frames</h2>",
    ];
    assert!(order.windows(2).all(|pair| at(pair[0]) < at(pair[1])));
    let hash = blindaug_io::fingerprint(folder.join("clip")).unwrap().unwrap().sha256;
    for part in [
        "blindaug estimate clip -o c.json --report r.html",
        " UTC",
        &hash,
        "3 files, their names and contents",
    ] {
        assert!(html[at("<footer")..].contains(part), "{part}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_and_a_closed_pipe_are_no_panic() {
    let dir = TempDir::new().unwrap();
    write_camera(dir.path().join("c.json"), &camera(8, 8, DepthKind::Metric)).unwrap();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let output =
        blindaug().current_dir(dir.path()).args(["inspect", "c.json"]).stdout(full).output().unwrap();
    assert!(sentence_of(&output, "inspect").contains("standard output"));

    // Files that may not grow stand for a disk without room.
    write_frames(&dir.path().join("f"), 1..3, (64, 64));
    let before = files_in(dir.path());
    for arguments in ["estimate f -o new.json", "apply f --camera c.json -o ."] {
        let binary = env!("CARGO_BIN_EXE_blindaug");
        let output = Command::new("sh")
            .args(["-c", &format!("trap '' XFSZ; ulimit -f 0; exec {binary} {arguments}")])
            .current_dir(dir.path())
            .output()
            .unwrap();
        sentence_of(&output, arguments);
        assert_eq!(files_in(dir.path()), before, "{arguments}");
    }

    let mut child = blindaug()
        .current_dir(dir.path())
        .args(["inspect", "c.json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{}", text(&output.stderr));
}

#[test]
fn outputs_that_cannot_be_written_are_known_before_the_work_starts() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    std::fs::write(d.join("file"), "").unwrap();
    write_frames(&d.join("f"), 1..3, (8, 8));
    write_camera(d.join("c.json"), &camera(8, 8, DepthKind::Metric)).unwrap();
    let before = files_in(d);
    for (arguments, says) in [
        ("estimate f -o none/c.json", "there is no folder none"),
        ("estimate f -o file/c.json", "there is no folder file"),
        ("estimate f -o f", "f: this is a folder"),
        ("estimate f -o new.json --report none/r.html", "there is no folder none"),
        ("apply f --camera c.json -o file", "file: this is a file"),
        ("apply f --camera c.json -o file/out", "file/out: the folder cannot be made"),
        ("apply f --camera c.json -o none/out.mp4", "there is no folder none"),
        ("demo -o file", "file: the folder cannot be made"),
    ] {
        let said = fails(d, arguments);
        assert!(said.contains(says), "{arguments}: {said}");
        assert_eq!(files_in(d), before, "{arguments}");
    }
}

#[test]
fn damaged_and_mixed_frames_end_in_a_sentence_with_the_file_s_name() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    // Without motion blur no frame needs the next one.
    let mut still = camera(32, 32, DepthKind::Metric);
    still.motion_blur = Estimate::unknown(Reason::NoMotion, "nothing moves");
    write_camera(d.join("c.json"), &still).unwrap();
    write_frames(&d.join("mixed"), 1..3, (32, 32));
    write_frames(&d.join("mixed"), 3..4, (31, 32));
    write_frames(&d.join("cut"), 1..4, (32, 32));
    let png = std::fs::read(d.join("cut/0003.png")).unwrap();
    std::fs::write(d.join("cut/0003.png"), &png[..png.len() / 2]).unwrap();
    write_frames(&d.join("twice"), 1..2, (32, 32));
    write_frames(&d.join("twice"), [10], (32, 32));
    std::fs::rename(d.join("twice/0010.png"), d.join("twice/a1.png")).unwrap();
    write_frames(&d.join("other"), 100..102, (32, 32));
    write_frames(&d.join("good"), 1..3, (32, 32));
    write_frames(&d.join("small"), 1..3, (16, 16));
    for (arguments, says) in [
        ("estimate mixed -o new.json", "0003.png: frame 3 is 31 x 32"),
        ("estimate cut -o new.json", "0003.png: the file is damaged or cut short"),
        ("estimate twice -o new.json", "both have the number 1"),
        ("estimate good -o new.json --clean other", "other: none of the numbers"),
        ("estimate good -o new.json --clean small", "small/0001.png"),
        ("estimate good -o new.json --depth good", "colour picture"),
        ("estimate good -o new.json --flow good", "no files with flow"),
    ] {
        let said = fails(d, arguments);
        assert!(said.contains(says), "{arguments}: {said}");
        assert!(!d.join("new.json").exists());
    }
    // The frames that were made before the damaged one are complete, and stay.
    let said = fails(d, "apply cut --camera c.json -o out");
    assert!(said.contains("0003.png"), "{said}");
    assert_eq!(files_in(&d.join("out")), ["0001.png", "0002.png"]);
    read_frame(d.join("out/0002.png")).unwrap();
}

#[test]
fn a_single_image_says_nothing_about_the_exposure() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(d, 1..2, (64, 64));
    let words = succeeds(d, "estimate 0001.png -o c.json");
    assert!(words.contains("Exposure   unknown"), "{words}");
    let model = blindaug_io::read_camera(d.join("c.json")).unwrap();
    assert!(model.motion_blur.why_unknown().is_some());
    assert_eq!(model.capture.frames_used, 1);
}

#[test]
fn images_of_one_pixel_are_no_panic() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("f"), 1..4, (1, 1));
    succeeds(d, "estimate f -o c.json");
    let model = blindaug_io::read_camera(d.join("c.json")).unwrap();
    assert!(model.motion_blur.why_unknown().is_some() && model.defocus.why_unknown().is_some());
    write_camera(d.join("c.json"), &camera(1, 1, DepthKind::Metric)).unwrap();
    succeeds(d, "apply f --camera c.json -o out");
    assert_eq!(files_in(&d.join("out")).len(), 3);
}

#[test]
fn a_rerun_skips_what_is_done_and_a_seed_gives_the_same_frames() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("f"), 8..12, (48, 40));
    write_camera(d.join("c.json"), &camera(48, 40, DepthKind::Metric)).unwrap();
    let bytes = |name: &str| std::fs::read(d.join(name)).unwrap();
    succeeds(d, "apply f --camera c.json -o a --seed 7");
    assert_eq!(files_in(&d.join("a")), ["0008.png", "0009.png", "0010.png", "0011.png"]);
    assert_ne!(bytes("a/0009.png"), bytes("f/0009.png"));
    // Frames that are made in two runs are the same.
    succeeds(d, "apply f --camera c.json -o b --seed 7 --frames 8..9");
    assert_eq!(files_in(&d.join("b")).len(), 2);
    let marked = bytes("f/0008.png");
    std::fs::remove_file(d.join("b/0009.png")).unwrap();
    std::fs::write(d.join("b/0008.png"), &marked).unwrap();
    succeeds(d, "apply f --camera c.json -o b --seed 7");
    assert_eq!(bytes("b/0008.png"), marked, "what is done is left as it is");
    for name in ["0009.png", "0010.png", "0011.png"] {
        assert_eq!(bytes(&format!("a/{name}")), bytes(&format!("b/{name}")), "{name}");
    }
    succeeds(d, "apply f --camera c.json -o b --seed 7 --overwrite");
    assert_eq!(bytes("a/0008.png"), bytes("b/0008.png"));
    // Frames that were made otherwise are neither kept as if they were what is asked for, nor replaced.
    let kept = bytes("b/0010.png");
    for changed in ["--seed 8", "--seed 7 --shutter 90"] {
        let said = fails(d, &format!("apply f --camera c.json -o b {changed}"));
        assert!(said.contains("made with other settings; add --overwrite"), "{said}");
    }
    let mut other = camera(48, 40, DepthKind::Metric);
    other.capture.fps = Some(24.0);
    write_camera(d.join("c.json"), &other).unwrap();
    assert!(fails(d, "apply f --camera c.json -o b --seed 7").contains("made with other settings"));
    write_camera(d.join("c.json"), &camera(48, 40, DepthKind::Metric)).unwrap();
    assert_eq!(bytes("b/0010.png"), kept);
    for name in ["b.jpg", "b.%04d.jpg"] {
        let said = fails(d, &format!("apply f --camera c.json -o {name}"));
        assert!(said.contains("written as exr, png or tif"), "{said}");
    }
    // As long as some frames are of other settings, none are taken for what is asked for.
    succeeds(d, "apply f --camera c.json -o b --seed 8 --overwrite --frames 8..9");
    for seed in [7, 8] {
        let said = fails(d, &format!("apply f --camera c.json -o b --seed {seed}"));
        assert!(said.contains("made with other settings"), "{said}");
    }
    assert_eq!(bytes("b/0010.png"), kept);
    succeeds(d, "apply f --camera c.json -o b --seed 8 --overwrite");
    succeeds(d, "apply f --camera c.json -o b --seed 8 --frames 9..");
    // Frames of which nobody knows the settings are kept, and not said to be of these.
    std::fs::remove_file(d.join("b/.0000.png.settings")).unwrap();
    std::fs::remove_file(d.join("b/0011.png")).unwrap();
    succeeds(d, "apply f --camera c.json -o b --seed 8");
    assert!(!d.join("b/.0000.png.settings").exists());
    assert_ne!(bytes("a/0008.png"), bytes("b/0008.png"));
    let said = text(&run(d, "apply f --camera c.json -o small --no-noise").stderr);
    assert!(said.contains("without depth nothing is defocused"), "{said}");
}

#[test]
fn frames_that_are_made_by_ranges_are_those_of_the_whole_clip() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let path = |name| asset(name).display().to_string();
    let (frames, scene) = (path("frames"), path("scene"));
    succeeds(d, &format!("estimate {frames} --depth {scene} -o c.json"));
    let shadows = format!("--with {} --without {}", path("with"), path("without"));
    // The motion of each frame is found: that of a range's last frame with the frame after it, that of the clip's last with the one before.
    for (name, command) in [
        ("applied", format!("apply {frames} --camera c.json")),
        (
            "composited",
            format!(
                "composite {frames} --virtual {} --camera c.json {shadows} --layer-motion plate",
                path("virtual")
            ),
        ),
    ] {
        let make =
            |to: &str, options: &str| succeeds(d, &format!("{command} --seed 3 -o {name}_{to} {options}"));
        let read = |to: &str, n: usize| std::fs::read(d.join(format!("{name}_{to}/{n:04}.png"))).unwrap();
        make("whole", "");
        for range in ["5..5", "1..2", "3..4"] {
            make("parts", &format!("--frames {range}"));
        }
        assert_eq!(files_in(&d.join(format!("{name}_parts"))).len(), 5);
        for n in 1..=5 {
            assert_eq!(read("parts", n), read("whole", n), "{name} {n}");
        }
        // Negative control: a clip that ends after frame 2 gives that frame another motion.
        std::fs::create_dir_all(d.join("short")).unwrap();
        for n in 1..=2 {
            std::fs::copy(asset(&format!("frames/{n:04}.png")), d.join(format!("short/{n:04}.png"))).unwrap();
        }
        succeeds(d, &format!("{} --seed 3 -o {name}_short", command.replace(&frames, "short")));
        assert_eq!(read("short", 1), read("whole", 1));
        assert_ne!(read("short", 2), read("whole", 2));
    }
    // Evidence: the frames and their motion. Depth is not the same, as parallax is followed from frame to frame.
    succeeds(d, &format!("estimate {frames} -o e.json --save-evidence whole"));
    for range in ["1..3", "4..5"] {
        succeeds(d, &format!("estimate {frames} -o e.json --save-evidence parts --frames {range}"));
    }
    let read = |of: &str, file: &str| std::fs::read(d.join(of).join(file)).ok();
    for n in 1..=5 {
        let file = format!("original/frames/{n:04}.png");
        assert!(read("whole", &file).is_some() && read("parts", &file) == read("whole", &file), "{file}");
        let file = format!("flow/frames/{n:04}.flo");
        assert!(read("parts", &file) == read("whole", &file), "{file}");
        assert_eq!(read("whole", &file).is_some(), n != 5, "{file}");
    }
}

#[test]
fn a_doubled_frame_is_told_in_words_and_as_json() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("f"), 1..21, (160, 120));
    let words = succeeds(d, "frames f");
    for says in ["20 frames in 1 shot", "doubled: 0", "dropped: 0", "interpolated: 0"] {
        assert!(words.contains(says), "{says} in {words}");
    }
    // Frame 11 comes twice.
    for n in (11..21).rev() {
        std::fs::rename(d.join(format!("f/{n:04}.png")), d.join(format!("f/{:04}.png", n + 1))).unwrap();
    }
    std::fs::copy(d.join("f/0012.png"), d.join("f/0011.png")).unwrap();
    let words = succeeds(d, "frames f -o report.json");
    assert!(words.contains("frame 12 is doubled") && words.contains("doubled: 1"), "{words}");
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(d.join("report.json")).unwrap()).unwrap();
    let finding = &report["findings"][0];
    assert_eq!((&finding["kind"], &finding["frame"]), (&"doubled".into(), &12.into()), "{report}");
    assert!(finding["log_likelihood_ratio"].as_f64().unwrap() > 6.9, "{report}");
    assert_eq!(report["findings"].as_array().unwrap().len(), 1, "{report}");
    let said = fails(d, "frames f/0001.png");
    assert!(said.contains("there is only one frame"), "{said}");
}

#[test]
fn footage_is_matched_to_another_camera_and_nothing_is_taken_away() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("f"), 1..4, (96, 64));
    let less = camera(96, 64, DepthKind::Metric);
    let mut more = less.clone();
    more.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(1.0)));
    let level = NoiseLevel { slope: [0.02; 3], intercept: [0.02; 3] };
    more.noise = Estimate::Known(NoiseModel::given([level; NOISE_LEVELS], 1.0));
    write_camera(d.join("less.json"), &less).unwrap();
    write_camera(d.join("more.json"), &more).unwrap();
    let frame = |path: &str| read_frame(d.join(path)).unwrap();
    succeeds(d, "match f --from less.json --to more.json -o up --seed 7");
    assert_eq!(files_in(&d.join("up")), ["0001.png", "0002.png", "0003.png"]);
    assert_ne!(frame("up/0002.png"), frame("f/0002.png"));
    succeeds(d, "match f --from less.json --to less.json -o same");
    assert_eq!(frame("same/0002.png"), frame("f/0002.png"));
    let said = text(&run(d, "match f --from more.json --to less.json -o down").stderr);
    assert_eq!(frame("down/0002.png"), frame("f/0002.png"));
    for says in [
        "its streaks stay, 0.50 of the motion too long",
        "its noise stays",
        "without depth defocus stays as it is",
    ] {
        assert!(said.contains(says), "{says} in {said}");
    }
    // A model of another shape is scaled by its width, and that is said.
    write_camera(d.join("wide.json"), &camera(192, 64, DepthKind::Metric)).unwrap();
    let said = text(&run(d, "match f --from less.json --to wide.json -o wide").stderr);
    assert!(said.contains("wide.json: for frames of 192 x 64") && said.contains("another shape"), "{said}");
    let lines: Vec<String> = (1..3)
        .map(|frame| {
            TrackedCamera { frame, changed: Default::default(), camera: more.clone() }.to_json_line()
        })
        .collect();
    std::fs::write(d.join("track.jsonl"), lines.join("\n")).unwrap();
    let said = fails(d, "match f --from less.json --to track.jsonl -o none");
    assert!(said.contains("track.jsonl: it holds a model for each frame"), "{said}");
    succeeds(d, "match f --from track.jsonl --to more.json -o tracked");
    // The scale of the footage's scene says nothing of a lens that was found over the relative depth of another.
    write_camera(d.join("relative.json"), &camera(96, 64, DepthKind::Relative)).unwrap();
    write_grey16(d.join("depth.png"), &Plane::filled(96, 64, 0.03)).unwrap();
    let scaled =
        "match f --from relative.json --to relative.json --depth depth.png --scene-scale 1 -o scaled";
    let said = text(&run(d, scaled).stderr);
    assert!(said.contains("means nothing in another scene"), "{said}");
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_after_the_frame_in_hand_and_the_next_run_goes_on() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    const FRAMES: usize = 60;
    write_frames(&d.join("f"), 1..FRAMES + 1, (320, 240));
    write_camera(d.join("c.json"), &camera(320, 240, DepthKind::Metric)).unwrap();
    let started = |arguments: &str| {
        let mut command = blindaug();
        command.current_dir(d).args(arguments.split_whitespace());
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let interrupt =
        |id: u32| assert!(Command::new("kill").args(["-INT", &id.to_string()]).status().unwrap().success());

    let child = started("apply f --camera c.json -o out");
    let start = Instant::now();
    while !d.join("out/0002.png").exists() {
        assert!(start.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(5));
    }
    interrupt(child.id());
    let said = sentence_with(130, &child.wait_with_output().unwrap(), "apply");
    let made = files_in(&d.join("out"));
    assert!(made.len() < FRAMES, "it was not stopped");
    let next = made.len() + 1;
    assert!(said.contains(&format!("goes on with frame {next}")), "{said}");
    for name in &made {
        read_frame(d.join("out").join(name)).unwrap();
    }
    succeeds(d, "apply f --camera c.json -o out");
    assert_eq!(files_in(&d.join("out")).len(), FRAMES);

    // An estimate from the frames so far is written, and a message says which frames these are. The missing frame is reported before the
    // work starts.
    std::fs::remove_file(d.join("f/0050.png")).unwrap();
    let mut child = started("estimate f -o e.json");
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    let mut said = String::new();
    errors.read_line(&mut said).unwrap();
    assert!(said.contains("frame 50 is missing"), "{said}");
    interrupt(child.id());
    errors.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    let model = blindaug_io::read_camera(d.join("e.json")).unwrap();
    assert!(said.contains("--frames") && model.capture.frames_used < FRAMES, "{said}");

    // Per-frame models of the frames so far are kept, with their report; the message says how to get the others.
    let mut child = started("estimate f -o t.jsonl --track --report t.html");
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    let mut said = String::new();
    errors.read_line(&mut said).unwrap();
    interrupt(child.id());
    errors.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    let last = |name: &str| {
        let track = blindaug_io::read_camera_track(d.join(name)).unwrap();
        track.frames().iter().map(|f| f.frame).max().unwrap() as usize
    };
    let done = last("t.jsonl");
    assert!(done < FRAMES && said.contains(&format!("run it again with --frames {}..", done + 1)), "{said}");
    assert!(std::fs::read_to_string(d.join("t.html")).unwrap().ends_with("</html>"));
    succeeds(d, &format!("estimate f -o rest.jsonl --track --frames {}..", done + 1));
    assert_eq!(last("rest.jsonl"), FRAMES);
    assert!(files_in(d).iter().all(|name| !name.contains("partial")));
}

#[test]
fn composites_take_the_layer_s_frames_and_leave_the_others() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let model = camera(272, 272, DepthKind::Metric);
    write_camera(d.join("c.json"), &model).unwrap();
    // A layer for frame 2 alone.
    std::fs::create_dir(d.join("v")).unwrap();
    std::fs::copy(asset("virtual/0002.exr"), d.join("v/0002.exr")).unwrap();
    let frames = asset("frames");
    let frames = frames.display();
    succeeds(d, &format!("composite {frames} --virtual v --camera c.json -o out --frames 1..3"));
    assert_eq!(files_in(&d.join("out")), ["0001.png", "0002.png", "0003.png"]);
    let same = |n: u32| {
        read_frame(d.join(format!("out/000{n}.png"))).unwrap()
            == read_frame(asset(&format!("frames/000{n}.png"))).unwrap()
    };
    assert!(same(1) && !same(2) && same(3));
    // A naive composite needs no camera.
    succeeds(d, &format!("composite {frames} --virtual v -o naive --naive --frames 2..2"));
    assert_eq!(files_in(&d.join("naive")), ["0002.png"]);
    // None of the layers has the number of a frame.
    std::fs::rename(d.join("v/0002.exr"), d.join("v/0999.exr")).unwrap();
    std::fs::copy(d.join("v/0999.exr"), d.join("v/0998.exr")).unwrap();
    let said = fails(d, &format!("composite {frames} --virtual v --camera c.json -o out2"));
    assert!(said.contains("v: none of the numbers"), "{said}");
    assert!(!d.join("out2").exists());
}

/// The largest difference of two pictures in linear light, as a share of the brighter one or of 0.01.
fn differs(a: &Linear, b: &Linear) -> f32 {
    let pairs = a.0.data().iter().flatten().zip(b.0.data().iter().flatten());
    pairs.map(|(a, b)| (a - b).abs() / a.max(*b).max(0.01)).fold(0.0, f32::max)
}

/// The relative error of a half float, twice over.
const HALF: f32 = 2.0 / 2048.0;

#[test]
fn exr_stays_exr_and_keeps_light_above_white() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_camera(d.join("c.json"), &camera(272, 272, DepthKind::Metric)).unwrap();
    // The demo's frames, two stops brighter.
    std::fs::create_dir(d.join("f")).unwrap();
    let exr = FrameFormat::PNG8.with(Some(FileKind::Exr), None).unwrap();
    let coding = Coding::new(ColourSpace::SRGB, ColourSpace::LINEAR_SRGB);
    for n in 2..4 {
        let light = read_linear(asset(&format!("frames/000{n}.png"))).unwrap();
        let bright = Linear(light.0.map(|p| p.map(|v| 4.0 * v))).to_encoded(Transfer::Srgb);
        exr.write(&d.join(format!("f/000{n}.exr")), &bright, None, None, &coding).unwrap();
    }
    let layers = asset("virtual");
    let virtual_and_camera = format!("--virtual {} --camera c.json", layers.display());
    succeeds(d, &format!("composite f {virtual_and_camera} -o out"));
    assert_eq!(files_in(&d.join("out")), ["0002.exr", "0003.exr"]);
    let plate = read_linear(d.join("f/0002.exr")).unwrap();
    let made = read_linear(d.join("out/0002.exr")).unwrap();
    let same = plate
        .0
        .data()
        .iter()
        .zip(made.0.data())
        .filter(|(a, b)| (0..3).all(|c| (a[c] - b[c]).abs() <= HALF * a[c]));
    let brightest = made.0.data().iter().flatten().copied().fold(0.0, f32::max);
    let pixels = 272 * 272;
    assert!((pixels / 4..pixels).contains(&same.count()) && brightest > 2.0, "{brightest}");
    // What it adds, over the plate, is the composite.
    succeeds(d, &format!("composite f {virtual_and_camera} -o apart --layer --no-noise"));
    succeeds(d, &format!("composite f {virtual_and_camera} -o quiet --no-noise"));
    let layer = read_virtual_layer(d.join("apart/0002.exr")).unwrap();
    let over = Linear(Raster::from_fn(272, 272, |x, y| {
        let (l, f) = (layer.color.0.at(x, y), plate.0.at(x, y));
        std::array::from_fn(|c| l[c] + (1.0 - l[3]) * f[c])
    }));
    let quiet = read_linear(d.join("quiet/0002.exr")).unwrap();
    // Alpha is rounded too, so that the error is a share of the plate's light, where that is brighter.
    let worst = (0..272 * 272)
        .flat_map(|i| (0..3).map(move |c| (i, c)))
        .map(|(i, c)| {
            let [a, b, f] = [&over, &quiet, &plate].map(|p| p.0.data()[i][c]);
            (a - b).abs() / b.max(f).max(0.01)
        })
        .fold(0.0, f32::max);
    assert!(worst < 2.0 * HALF, "{worst}");
    assert!(differs(&plate, &quiet) > 0.1, "the object changes the plate");
    assert!(layer.inverse_depth.is_some() && layer.flow.is_some());
    // One frame may be a file.
    let f = format!("composite f {virtual_and_camera}");
    let said = fails(d, &format!("{f} -o one.exr"));
    assert!(said.contains("one.exr: this is one image, but there are 2 frames: give a folder"), "{said}");
    succeeds(d, &format!("{f} -o one.exr --frames 2..2"));
    assert_eq!(std::fs::read(d.join("one.exr")).unwrap(), std::fs::read(d.join("out/0002.exr")).unwrap());
    assert!(fails(d, &format!("{f} -o one.exr --frames 2..2")).contains("this is there already"));
    // Other formats.
    succeeds(d, &format!("{f} -o png --format png --frames 2..2"));
    let deep = read_frame(d.join("png/0002.png")).unwrap();
    let off_steps = |v: f32| (v * 255.0 - (v * 255.0).round()).abs() > 0.01;
    assert!(deep.0.data().iter().flatten().any(|v| off_steps(*v)), "16 bits hold what 8 do not");
    for (options, says) in [
        ("-o x --bits 8", "EXR files have 16 or 32 bits per value, not 8"),
        ("-o x.mp4 --format exr", "--format is for images"),
        ("-o x.png --frames 2..2 --format exr", "--format asks for exr, its name for another"),
        ("-o x --layer --format png", "--layer writes EXR files"),
        ("-o x.mp4 --layer", "--layer writes EXR files"),
    ] {
        let said = fails(d, &format!("{f} {options}"));
        assert!(said.contains(says), "{options}: {said}");
        assert!(["x", "x.mp4", "x.png"].iter().all(|x| !d.join(x).exists()), "{options}");
    }
}

#[test]
fn parts_of_a_camera_are_set_by_hand() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let mut model = camera(272, 272, DepthKind::Relative);
    model.motion_blur = Estimate::unknown(Reason::NoMotion, "nothing moves");
    write_camera(d.join("c.json"), &model).unwrap();
    let mut same = camera(272, 272, DepthKind::Metric);
    same.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.25)));
    same.defocus = Estimate::Known(DefocusModel::given_lens(3.0, 0.5));
    write_camera(d.join("same.json"), &same).unwrap();
    let f = format!("composite {} --frames 2..2 --camera", demo_arguments());
    let by_hand = "--shutter 90 --focus 2 --blur 3";
    let said = text(&run(d, &format!("{f} c.json {by_hand} -o hand")).stderr);
    assert!(said.contains("1 frame written") && !said.contains("unknown"), "{said}");
    succeeds(d, &format!("{f} same.json -o file"));
    let read = |folder: &str| read_frame(d.join(folder).join("0002.png")).unwrap();
    assert_eq!(read("hand"), read("file"));
    succeeds(d, &format!("{f} c.json {by_hand} --grain x3 -o grainy"));
    assert_ne!(read("hand"), read("grainy"));
    // The shape of out-of-focus points and the shutter's phase are the camera's, too.
    let shape = "--bokeh polygon:6,0.25,10 --squeeze 1.5 --cats-eye 0.5 --shutter-phase 0";
    succeeds(d, &format!("{f} c.json {by_hand} {shape} -o shape"));
    assert_ne!(read("hand"), read("shape"));
    if let (Estimate::Known(lens), Estimate::Known(shutter)) = (&mut same.defocus, &mut same.motion_blur) {
        let bokeh = Bokeh::Polygon { blades: 6, roundness: 0.25, rotation_degrees: 10.0 };
        lens.bokeh = Aperture { bokeh, squeeze: 1.5, cats_eye: 0.5 };
        shutter.phase_degrees = Some(0.0);
    }
    write_camera(d.join("shape.json"), &same).unwrap();
    succeeds(d, &format!("{f} shape.json -o shaped"));
    assert_eq!(read("shape"), read("shaped"));
    let said = succeeds(d, "inspect shape.json");
    assert!(
        said.contains("a polygon of 6 blades, 1.5 times as high as wide")
            && said.contains("a phase of 0 degrees"),
        "{said}"
    );
    let said = fails(d, &format!("{f} c.json {by_hand} --cats-eye 0.5 -o none"));
    assert!(said.contains("a Gaussian has no edge"), "{said}");
    let output = run(d, &format!("{f} c.json {by_hand} --bokeh polygon:2 -o none"));
    assert!(output.status.code() == Some(2) && text(&output.stderr).contains("3 to 16 blades"));
    // The model's lens has no metres, so that its focus alone cannot be set.
    let said = fails(d, &format!("{f} c.json --focus 2 -o none"));
    assert!(said.contains("c.json: its lens is not known in metres"), "{said}");
    // An estimate writes what is set, as given.
    succeeds(d, &format!("estimate {} --frames 2..3 --shutter 180 -o e.json", asset("frames").display()));
    let written = std::fs::read_to_string(d.join("e.json")).unwrap();
    let written = CameraModel::from_json(&written).unwrap();
    let shutter = written.motion_blur.known().unwrap();
    assert_eq!((shutter.exposure.0, shutter.method), (0.5, Method::Given));
}

#[test]
fn shells_and_manuals_know_every_command() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let script = succeeds(d, "completions bash");
    assert!(script.contains("--scene-scale") && script.contains("reproduce"), "{script}");
    succeeds(d, "man -o pages");
    let pages = files_in(&d.join("pages"));
    for page in ["blindaug.1", "blindaug-estimate.1", "blindaug-study-make.1"] {
        assert!(pages.contains(&page.to_owned()), "{pages:?}");
    }
    let page = std::fs::read_to_string(d.join("pages/blindaug-composite.1")).unwrap();
    assert!(page.contains("premultiplied"), "{page}");
}

#[test]
fn apply_takes_the_depth_and_the_motion_of_exr_frames() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let mut model = camera(272, 272, DepthKind::Metric);
    model.noise = Estimate::unknown(Reason::Flat, "");
    write_camera(d.join("c.json"), &model).unwrap();
    let rendered = asset("virtual");
    let rendered = rendered.display();
    let said = text(&run(d, &format!("apply {rendered} --camera c.json -o own --frames 2..2")).stderr);
    assert!(said.contains("EXR files, in metres") && !said.contains("without depth"), "{said}");
    succeeds(
        d,
        &format!(
            "apply {rendered} --depth {rendered} --flow {rendered} --camera c.json -o given --frames 2..2"
        ),
    );
    let [own, given] = ["own", "given"].map(|f| read_linear(d.join(f).join("0002.exr")).unwrap());
    assert_eq!(own, given);
    // Alpha is blurred as the colour is.
    let [sharp, soft] =
        [asset("virtual/0002.exr"), d.join("own/0002.exr")].map(|p| read_virtual_layer(p).unwrap());
    let partly = |l: &blindaug_io::VirtualLayerFile| {
        l.color.0.data().iter().filter(|p| (0.02..0.98).contains(&p[3])).count()
    };
    assert!(partly(&soft) > 2 * partly(&sharp), "{} and {}", partly(&soft), partly(&sharp));
    let sum = |l: &blindaug_io::VirtualLayerFile| l.color.0.data().iter().map(|p| p[3]).sum::<f32>();
    assert!((sum(&soft) / sum(&sharp) - 1.0).abs() < 0.1, "{} and {}", sum(&soft), sum(&sharp));
    assert!(soft.color.0.data().iter().all(|p| p[3] > 0.0 || p[..3] == [0.0; 3]));
    assert!(differs(&own, &read_linear(asset("virtual/0002.exr")).unwrap()) > 0.1, "it is blurred");
    // Counted from another number on, or in other primaries, each frame still has its own depth, motion and alpha.
    succeeds(d, &format!("apply {rendered} --camera c.json -o counted --first 11 --frames 12..12"));
    succeeds(d, &format!("apply {rendered} --camera c.json -o wide --frames 2..2 --colour-space acescg"));
    assert_eq!(read_linear(d.join("counted/0012.exr")).unwrap(), own);
    assert_eq!(read_linear(d.join("wide/0002.exr")).unwrap(), own);
}

#[test]
fn an_object_is_pasted_on_in_the_encoding_of_the_frames() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let mut nothing = camera(272, 272, DepthKind::Metric);
    nothing.transfer = Transfer::SLog3;
    nothing.noise = Estimate::unknown(Reason::Flat, "");
    nothing.motion_blur = Estimate::unknown(Reason::NoMotion, "");
    nothing.defocus = Estimate::unknown(Reason::NoDepth, "");
    write_camera(d.join("c.json"), &nothing).unwrap();
    let f = format!("composite {} --frames 2..2 --colour-space s-log3", demo_arguments());
    succeeds(d, &format!("{f} --naive -o pasted"));
    succeeds(d, &format!("{f} --camera c.json -o nothing"));
    succeeds(d, &format!("composite {} --frames 2..2 --naive -o srgb", demo_arguments()));
    let read = |folder: &str| read_frame(d.join(folder).join("0002.png")).unwrap();
    assert_eq!(read("pasted"), read("nothing"));
    assert_ne!(read("pasted"), read("srgb"));
}

#[test]
fn a_model_in_relative_depth_needs_a_scale() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let metric = camera(272, 272, DepthKind::Metric);
    write_camera(d.join("metric.json"), &metric).unwrap();
    // Relative inverse depth d = 0.4 / Z + 0.1.
    let mut relative = metric;
    if let Estimate::Known(DefocusModel {
        curve: DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, .. },
        depth_kind,
        ..
    }) = &mut relative.defocus
    {
        *depth_kind = DepthKind::Relative;
        let focus = 0.4 * *focus_inverse_depth + 0.1;
        *sigma_px_at_infinity *= focus / (focus - 0.1);
        *focus_inverse_depth = focus;
    }
    write_camera(d.join("relative.json"), &relative).unwrap();
    let arguments = |camera: &str, out: &str, more: &str| {
        format!("composite {} --camera {camera} -o {out} --frames 3..3 {more}", demo_arguments())
    };
    let said = fails(d, &arguments("relative.json", "a", ""));
    assert!(said.contains("relative.json: ") && said.contains("--scene-scale"), "{said}");
    assert!(!d.join("a").exists());
    succeeds(d, &arguments("relative.json", "b", "--scene-scale 0.4,0.1"));
    succeeds(d, &arguments("metric.json", "c", ""));
    let (b, c) = (read_frame(d.join("b/0003.png")).unwrap(), read_frame(d.join("c/0003.png")).unwrap());
    let differ =
        b.0.data()
            .iter()
            .flatten()
            .zip(c.0.data().iter().flatten())
            .map(|(b, c)| (b - c).abs())
            .fold(0.0, f32::max);
    assert!(differ < 1.5 / 255.0, "{differ}");
    succeeds(d, &arguments("relative.json", "n", "--naive"));
}

#[test]
fn an_unknown_exposure_is_left_or_its_middle_applied() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let known = camera(272, 272, DepthKind::Metric);
    assert_eq!(known.motion_blur.known().unwrap().exposure.0, 0.5);
    write_camera(d.join("known.json"), &known).unwrap();
    let unknown = |fits: Option<[f32; 2]>| {
        let why = Unknown { fits, ..Unknown::new(Reason::Uncertain, "too little moves") };
        let mut camera = known.clone();
        camera.motion_blur = Estimate::Unknown(why);
        camera
    };
    write_camera(d.join("fits.json"), &unknown(Some([0.3, 0.7]))).unwrap();
    write_camera(d.join("nothing.json"), &unknown(None)).unwrap();
    let composite = |camera: &str, out: &str, more: &str| {
        let arguments =
            format!("composite {} --camera {camera} -o {out} --frames 3..3 {more}", demo_arguments());
        let output = run(d, &arguments);
        let said = text(&output.stderr);
        assert!(output.status.success(), "{said}");
        (read_frame(d.join(out).join("0003.png")).unwrap(), said)
    };
    let (blurred, _) = composite("known.json", "a", "");
    let (middle, said) = composite("fits.json", "b", "--unknown middle");
    assert!(said.contains("0.50 is applied, the middle of 0.30 to 0.70"), "{said}");
    assert_eq!(middle, blurred);
    let (left, said) = composite("fits.json", "c", "");
    assert!(said.contains("motion blur is unknown and not applied"), "{said}");
    assert_ne!(left, blurred);
    let (nothing, said) = composite("nothing.json", "e", "--unknown middle");
    assert!(said.contains("does not tell which exposures fit"), "{said}");
    assert_eq!(nothing, left);
    // A range that is none is refused.
    let text = std::fs::read_to_string(d.join("fits.json")).unwrap();
    assert!(text.contains("0.7"));
    std::fs::write(d.join("wrong.json"), text.replace("0.7", "7.0")).unwrap();
    let said = fails(d, "inspect wrong.json");
    assert!(said.contains("wrong.json: ") && said.contains("motion_blur.fits"), "{said}");
}

#[test]
fn a_camera_is_exported_to_standard_output_to_a_file_and_to_all_tools() {
    let dir = TempDir::new().unwrap();
    write_camera(dir.path().join("camera.json"), &camera(64, 48, DepthKind::Metric)).unwrap();
    let list = succeeds(dir.path(), "export --list");
    let help = succeeds(dir.path(), "help export");
    for target in Target::ALL {
        assert!(list.contains(&format!("{target}\n")) && help.contains(target.name()), "{target}");
        let output = run(dir.path(), &format!("export camera.json --to {target}"));
        assert!(output.status.success() && !output.stdout.is_empty(), "{target}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains("note: "), "{target} says nothing of what is lost");
    }
    assert_eq!(files_in(dir.path()), ["camera.json"], "what goes to standard output leaves nothing behind");

    let snippet = succeeds(dir.path(), "export camera.json --to bevy");
    assert!(snippet.contains("shutter_angle: 0.5,"), "{snippet}");
    // The lens is for the size and the field of view that are asked for.
    let other = succeeds(dir.path(), "export camera.json --to bevy --size 128x96 --fov 60");
    assert_ne!(snippet, other);

    succeeds(dir.path(), "export camera.json --to unity-urp -o Camera.cs");
    let files =
        ["BlindaugGrain.shader", "Camera.cs", "blindaug_bands.png", "blindaug_grain.png", "camera.json"];
    assert_eq!(files_in(dir.path()), files);
    assert_eq!(read_frame(dir.path().join("blindaug_grain.png")).unwrap().0.size(), (512, 512));

    succeeds(dir.path(), "export camera.json --to all -o tools");
    for target in Target::ALL {
        assert!(dir.path().join("tools").join(target.name()).read_dir().unwrap().count() > 0, "{target}");
    }
    succeeds(dir.path(), "export camera.json --to nuke -o tools");
    assert!(dir.path().join("tools/blindaug_camera.nk").is_file(), "a folder gets the tool's own names");
}

#[test]
fn exports_that_cannot_be_made_end_in_a_sentence() {
    let dir = TempDir::new().unwrap();
    write_camera(dir.path().join("camera.json"), &camera(64, 48, DepthKind::Relative)).unwrap();
    // A lens in relative depth is left out, with a note; with a scale it is exported.
    let output = run(dir.path(), "export camera.json --to bevy");
    assert!(output.status.success() && text(&output.stderr).contains("--scene-scale"));
    assert!(!text(&output.stdout).contains("DepthOfField"));
    assert!(
        succeeds(dir.path(), "export camera.json --to bevy --scene-scale 2,0.1").contains("DepthOfField")
    );

    let line = "{\"frame\": 1}\n{\"frame\": 2}\n";
    std::fs::write(dir.path().join("bad.json"), line).unwrap();
    std::fs::write(dir.path().join("half.json"), "{ \"format\": \"blindaug-camera\"").unwrap();
    let model = camera(64, 48, DepthKind::Metric);
    let track: String = (1..=2)
        .map(|frame| {
            let tracked = TrackedCamera { frame, camera: model.clone(), changed: Default::default() };
            tracked.to_json_line() + "\n"
        })
        .collect();
    std::fs::write(dir.path().join("track.jsonl"), track).unwrap();
    let before = files_in(dir.path());
    for (arguments, says) in [
        ("missing.json --to nuke", "missing.json"),
        ("bad.json --to nuke", "bad.json"),
        ("half.json --to nuke", "half.json"),
        ("track.jsonl --to nuke", "without --track"),
        ("camera.json --to nuke -o missing/camera.nk", "missing"),
        ("camera.json --to nuke -o blindaug_bands.png", "another name"),
        ("camera.json --to texture -o grain.png", "give a name that ends in .csv"),
        ("camera.json --to all -o camera.json", "camera.json"),
    ] {
        let sentence = fails(dir.path(), &format!("export {arguments}"));
        assert!(sentence.contains(says), "{arguments}: {sentence}");
        assert_eq!(files_in(dir.path()), before, "{arguments}");
    }
    for arguments in [
        "camera.json",
        "camera.json --to maya",
        "camera.json --to all",
        "camera.json --to nuke --size 0x9",
        "camera.json --to nuke --fov 0",
        "camera.json --to nuke --fov nan",
    ] {
        assert_eq!(run(dir.path(), &format!("export {arguments}")).status.code(), Some(2), "{arguments}");
    }
}

#[test]
fn a_clip_is_tracked_told_and_applied_frame_by_frame() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    write_frames(&folder.join("clip"), 1..=5, (160, 128));
    let told = succeeds(folder, "estimate clip -o camera.jsonl --track --report report.html");
    let report = std::fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(report.contains("The camera of clip") && report.contains("estimated from 5 frames"));
    let lines = std::fs::read_to_string(folder.join("camera.jsonl")).unwrap();
    assert_eq!(lines.lines().count(), 5);
    for (line, number) in lines.lines().zip(1u64..) {
        let value: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(value["frame"], number);
        CameraModel::from_json(line).unwrap();
    }
    assert_eq!(succeeds(folder, "inspect camera.jsonl"), told);
    assert!(told.contains("tracked over 5 frames (1 to 5)"), "{told}");
    assert_eq!(files_in(folder).iter().filter(|f| f.contains("camera")).count(), 1);

    // Frames 1 and 3 have cameras without and with noise, and 2 the one between them.
    let track = |noise: [f32; 2]| {
        let line = |(frame, noise): (u64, f32)| {
            let mut model = camera(160, 128, DepthKind::Metric);
            let level = NoiseLevel { slope: [0.0; 3], intercept: [noise; 3] };
            model.noise = Estimate::Known(NoiseModel::given([level; NOISE_LEVELS], 1.0));
            model.motion_blur = Estimate::unknown(Reason::NotEstimated, "not looked at");
            model.defocus = Estimate::unknown(Reason::NotEstimated, "not looked at");
            let mut value = serde_json::to_value(&model).unwrap();
            value["frame"] = frame.into();
            if frame == 3 {
                value["changed"] = serde_json::json!({ "noise": true });
            }
            format!("{value}\n")
        };
        [(1, noise[0]), (3, noise[1])].map(line).concat()
    };
    std::fs::write(folder.join("given.jsonl"), track([0.0, 0.06])).unwrap();
    let shown: serde_json::Value =
        serde_json::from_str(&succeeds(folder, "inspect --json given.jsonl")).unwrap();
    let told = |i: usize| (shown[i]["frame"].as_u64(), shown[i]["changed"].clone());
    let expected = [(Some(1), serde_json::json!({})), (Some(3), serde_json::json!({ "noise": true }))];
    assert_eq!([told(0), told(1)], expected);
    succeeds(folder, "apply clip --camera given.jsonl -o applied");
    let std = |number: usize| {
        let read = |from: &str| read_frame(folder.join(format!("{from}/{number:04}.png"))).unwrap();
        let (a, b) = (read("applied"), read("clip"));
        let pairs = a.0.data().iter().zip(b.0.data());
        (pairs.map(|(a, b)| (a[1] - b[1]).powi(2)).sum::<f32>() / a.0.data().len() as f32).sqrt()
    };
    let [none, half, whole, after] = [1, 2, 3, 5].map(std);
    assert!(
        none < 0.003 && (half / whole - 0.5).abs() < 0.1 && (after / whole - 1.0).abs() < 0.1,
        "{none} {half} {whole} {after}"
    );

    let broken = track([0.0, 0.1]).replacen("srgb", "film", 2).replacen("film", "srgb", 1);
    std::fs::write(folder.join("broken.jsonl"), broken).unwrap();
    for command in ["inspect broken.jsonl", "apply clip --camera broken.jsonl -o again"] {
        let sentence = fails(folder, command);
        assert!(sentence.contains("broken.jsonl: line 2: "), "{sentence}");
    }
}

/// The numbers in a line of the demo's table or of its last line, after `label`.
fn numbers_after(text: &str, label: &str) -> Vec<f32> {
    let line = text.lines().find(|l| l.contains(label)).unwrap_or_else(|| panic!("{label} in {text}"));
    let rest = &line[line.find(label).unwrap() + label.len()..];
    rest.split(|c: char| !(c.is_ascii_digit() || c == '.'))
        .filter_map(|t| t.trim_end_matches('.').parse().ok())
        .collect()
}

#[test]
fn the_demo_finds_the_truth_and_beats_the_naive_composite() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let table = succeeds(d, "demo -o out");
    let close = |label: &str, within: f32| {
        let numbers = numbers_after(&table, label);
        let (estimated, truth) = (numbers[0], numbers[numbers.len() - 1]);
        assert!((estimated - truth).abs() < within, "{label}: {estimated}, true {truth}\n{table}");
    };
    close("exposure, fraction of the frame interval", 0.1);
    close("blur at infinity, px", 0.6);
    close("focus distance, m", 0.5);
    for y in [0.2, 0.5, 0.8] {
        close(&format!("noise std at luminance {y}, steps of 8 bit"), 1.5);
    }
    let fidelity = numbers_after(&table, "composite, PSNR in dB (pasted on:");
    let [naive, blind, with_depth, all_given, oracle] = fidelity[..] else { panic!("{fidelity:?}") };
    assert!([blind, with_depth, all_given, oracle].iter().all(|v| *v > naive + 5.0), "{fidelity:?}");
    // Every interval covers the truth: what is given, the clean frames too, makes the estimate sure of nothing wrong.
    for (label, widest) in [
        ("exposure, fraction of the frame interval", 0.4),
        ("blur at infinity, px", 2.0),
        ("focus distance, m", 3.0),
    ] {
        let numbers = numbers_after(&table, label);
        assert_eq!(numbers.len(), 10, "{table}");
        for known in numbers[..9].chunks(3) {
            assert!(known[1] <= numbers[9] && numbers[9] <= known[2], "{label}\n{table}");
            assert!(known[2] - known[1] < widest, "{label}\n{table}");
        }
    }
    let made = files_in(&d.join("out"));
    for name in ["camera.json", "comparison.png", "report.html", "naive/0003.png", "composite/0005.png"] {
        assert!(made.iter().any(|m| m == name), "{name} in {made:?}");
    }
    assert!(made.iter().all(|m| !m.contains(".partial")));
    // The command that the demo prints makes the same frames.
    let by_hand = table.lines().find(|l| l.contains("blindaug composite")).unwrap();
    succeeds(d, by_hand.trim().trim_start_matches("blindaug "));
    let bytes = |name: &str| std::fs::read(d.join("out").join(name)).unwrap();
    assert_eq!(bytes("by-hand/0003.png"), bytes("composite/0003.png"));
}

#[test]
fn a_study_is_analysed_or_its_wrong_row_is_named() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let head = "participant,task,scene,method,answer\n";
    let answers = |participants: std::ops::Range<usize>| -> String {
        let of = |p: usize| {
            let answer = if p.is_multiple_of(3) { "yes" } else { "no" };
            format!("p{p},identification,1,Ours,{answer}\np{p},identification,1,Naive,yes\n")
        };
        participants.map(of).collect()
    };
    std::fs::write(d.join("a.csv"), format!("{head}{}", answers(0..6))).unwrap();
    std::fs::write(d.join("b.csv"), format!("{head}{}", answers(6..9))).unwrap();
    let table = succeeds(d, "study analyse a.csv b.csv -o out");
    assert!(table.contains("Ours") && table.contains("66.7"), "{table}");
    let made = files_in(&d.join("out"));
    for name in ["index.html", "study.json", "study/shares.tex", "study/shares.pdf", "study/tests.csv"] {
        assert!(made.iter().any(|m| m == name), "{name} in {made:?}");
    }
    std::fs::write(d.join("c.csv"), format!("{head}p1,identification,1,Ours,perhaps\n")).unwrap();
    let said = fails(d, "study analyse a.csv c.csv -o new");
    assert!(said.contains("c.csv: line 2") && !d.join("new").exists(), "{said}");
    let said = fails(d, "study analyse a.csv -o new --reference Theirs");
    assert!(said.contains("Naive, Ours") && !d.join("new").exists(), "{said}");
    let said = fails(d, "reproduce cameras --quick --footage none.mp4 -o new");
    assert!(said.contains("none.mp4"), "{said}");
}
