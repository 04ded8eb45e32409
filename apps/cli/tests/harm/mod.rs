//! Tests that neither the contents nor the name of a file can harm the person who runs a command: no foreign text becomes code or reaches a
//! terminal, no input is overwritten, nothing waits for ever, and a run that is stopped leaves nothing half written behind.

use super::{
    blindaug, camera, demo_arguments, fails, files_in, run, sentence_of, succeeds, text, write_frames,
};
use blindaug::{CameraModel, model::Capture, model::DepthKind};
use blindaug_io::write_camera;
use std::{
    path::Path,
    process::{Child, Command, Output, Stdio},
    time::{Duration, Instant},
};
use tempfile::TempDir;

/// A text that ends comments, moves cursors and clears screens where it is not escaped.
const HOSTILE: &str =
    "x\nimport os; os.system('id')\r#*/\u{2028}evil();\u{1b}[2J\u{9b}2J\u{7}\u{202e}</script><img src=x>\\";

/// Writes a camera file in which nothing is known, with the hostile text `why` as the reason.
fn write_hostile_camera(path: &Path, why: &str) {
    let capture = Capture { width: 64, height: 48, fps: None, frames_used: 1, pixel_aspect: 1.0 };
    let json = CameraModel::unknown(capture, "REASON").to_json();
    std::fs::write(path, json.replace("\"REASON\"", &serde_json::to_string(why).unwrap())).unwrap();
}

fn is_printable(text: &str) -> bool {
    text.chars().all(|c| c == '\n' || !(c.is_control() || matches!(c, '\u{2028}'..='\u{202e}')))
}

#[test]
fn what_a_camera_file_says_stays_a_comment_in_every_language() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_hostile_camera(&d.join("c.json"), HOSTILE);
    let names: Vec<String> = succeeds(d, "export --list")
        .lines()
        .filter(|l| !l.is_empty() && !l.contains(' '))
        .map(str::to_owned)
        .collect();
    assert_eq!(names.len(), 11, "{names:?}");
    let mut commented = 0;
    for target in names {
        let output = run(d, &format!("export c.json --to {target}"));
        assert!(output.status.success(), "{target}: {}", text(&output.stderr));
        let (exported, said) = (text(&output.stdout), text(&output.stderr));
        assert!(is_printable(&exported) && is_printable(&said), "{target}: {exported:?} {said:?}");
        for line in exported.lines().filter(|l| l.contains("import hostile") || l.contains("evil()")) {
            let comment = ["# ", "// ", "; "].iter().any(|marker| line.starts_with(marker));
            assert!(comment && !line.ends_with('\\'), "{target}: {line}");
            commented += 1;
        }
    }
    // Negative control: the text does reach the targets.
    assert!(commented >= 9, "{commented}");
}

#[test]
fn what_a_camera_file_says_is_one_short_printable_line_wherever_it_is_shown() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("f"), 1..2, (64, 48));
    for why in [HOSTILE, &"long ".repeat(100_000)] {
        write_hostile_camera(&d.join("c.json"), why);
        for arguments in
            ["inspect c.json", "inspect c.json --json", "apply f --camera c.json -o out --overwrite"]
        {
            let output = run(d, arguments);
            let said = text(&output.stdout) + &text(&output.stderr);
            assert!(output.status.success() && is_printable(&said), "{arguments}: {said:?}");
            assert!(said.lines().all(|l| l.len() < 1200), "{arguments}");
        }
        let words = succeeds(d, "inspect c.json");
        assert_eq!(words.lines().count(), 4, "{words}");
    }
    // The same holds for messages about a file that is no camera, and for file names.
    for json in [
        format!("{{\"format\": {}}}", serde_json::to_string(HOSTILE).unwrap()),
        format!("{{\"format\": \"{}\"}}", "x".repeat(90_000)),
    ] {
        std::fs::write(d.join("bad.json"), json).unwrap();
        let said = fails(d, "inspect bad.json");
        assert!(is_printable(&said) && said.len() < 1000, "{}", said.len());
    }
    let name = "a\u{1b}[2J\nb.json";
    let output = blindaug().current_dir(d).args(["inspect", name]).output().unwrap();
    assert!(is_printable(&sentence_of(&output, name)) && text(&output.stderr).lines().count() == 1);
}

#[test]
fn a_byte_order_mark_is_no_damage() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let json = camera(64, 48, DepthKind::Metric).to_json();
    std::fs::write(d.join("c.json"), format!("\u{feff}{json}")).unwrap();
    assert!(succeeds(d, "inspect c.json").contains("64 x 48"));
    let line: serde_json::Value = serde_json::from_str(&json).unwrap();
    let track: String = (1..3)
        .map(|frame| {
            let mut line = line.clone();
            line["frame"] = frame.into();
            format!("{line}\n")
        })
        .collect();
    std::fs::write(d.join("t.jsonl"), format!("\u{feff}{track}")).unwrap();
    assert!(succeeds(d, "inspect t.jsonl").contains("tracked over 2 frames"));
}

/// Each file below a folder with its bytes.
fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let bytes = |name: String| (name.clone(), std::fs::read(folder.join(name)).unwrap());
    files_in(folder).into_iter().map(bytes).collect()
}

#[cfg(unix)]
#[test]
fn no_output_is_ever_an_input() {
    use std::os::unix::fs::symlink;
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("in"), 1..4, (64, 48));
    write_frames(&d.join("clean"), 1..4, (64, 48));
    write_camera(d.join("c.json"), &camera(64, 48, DepthKind::Metric)).unwrap();
    std::fs::create_dir(d.join("v")).unwrap();
    std::fs::copy(super::asset("virtual/0001.exr"), d.join("v/0001.exr")).unwrap();
    // This file need not be a video, since commands must refuse it before they read anything.
    std::fs::write(d.join("v.mp4"), "no video").unwrap();
    std::fs::hard_link(d.join("v.mp4"), d.join("hard.mp4")).unwrap();
    symlink("v.mp4", d.join("soft.mp4")).unwrap();
    symlink("in", d.join("also-in")).unwrap();
    std::fs::create_dir(d.join("links")).unwrap();
    symlink("../in/0001.png", d.join("links/0001.png")).unwrap();
    std::fs::create_dir_all(d.join("e/original")).unwrap();
    std::fs::rename(d.join("clean"), d.join("e/original/s")).unwrap();
    let before = contents(d);
    for arguments in [
        "estimate v.mp4 -o v.mp4",
        "estimate v.mp4 -o hard.mp4",
        "estimate v.mp4 -o soft.mp4",
        "estimate v.mp4 -o ./e/../v.mp4",
        "estimate in -o in/0001.png",
        "estimate in -o also-in/0001.png",
        "estimate in -o links/0001.png",
        "estimate v.mp4 -o new.json --report v.mp4",
        "estimate v.mp4 -o new.json --report new.json",
        "estimate v.mp4 -o new.json --report ./new.json",
        "estimate in -o new.json --depth v -o v/0001.exr",
        "estimate in -o v/0001.exr --flow v",
        "estimate --evidence e --scene s -o e/original/s/0001.png",
        "estimate e/original/s -o new.json --save-evidence e",
        "estimate in --track -o in/0001.png",
        "export c.json --to nuke -o c.json",
        "apply in --camera c.json -o in",
        "apply in --camera c.json -o in --overwrite",
        "apply in --camera c.json -o also-in --overwrite",
        "apply in --camera c.json -o links --overwrite",
        "apply in --camera c.json --depth v -o v --overwrite",
        "apply v.mp4 --camera c.json -o v.mp4 --overwrite",
        "apply v.mp4 --camera c.json -o hard.mp4 --overwrite",
        "composite in --virtual v --camera c.json --with e/original/s --without in -o e/original/s --overwrite",
        "composite in --virtual v --camera c.json -o v --overwrite",
        "composite in --virtual v --naive -o in --overwrite",
        "validate --clips e -o e",
    ] {
        let words = arguments.replace("-o new.json --depth v -o v/0001.exr", "-o v/0001.exr --depth v");
        let said = fails(d, &words);
        assert!(
            said.contains("would be overwritten") || said.contains("written to this one file"),
            "{words}: {said}"
        );
        assert_eq!(contents(d), before, "{words}");
    }
    // New files beside the inputs are allowed.
    succeeds(d, "estimate in -o in/camera.json --report in/report.html");
    succeeds(d, "estimate in -o in/camera.json --report in/report.html");
    succeeds(d, "apply in --camera c.json -o in/out");
    succeeds(d, "apply in --camera c.json -o in/out --overwrite");
}

#[cfg(target_os = "linux")]
#[test]
fn links_are_followed_and_pipes_and_devices_written_into() {
    use std::os::unix::fs::{FileTypeExt, symlink};
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("f"), 1..2, (64, 48));
    std::fs::create_dir(d.join("real")).unwrap();
    std::fs::write(d.join("real/c.json"), "before").unwrap();
    symlink("real/c.json", d.join("link.json")).unwrap();
    succeeds(d, "estimate f -o link.json");
    assert!(d.join("link.json").is_symlink());
    blindaug_io::read_camera(d.join("real/c.json")).unwrap();

    // Standard output gets the model and nothing else.
    let output = run(d, "estimate f -o /dev/stdout");
    assert!(output.status.success(), "{}", text(&output.stderr));
    CameraModel::from_json(&text(&output.stdout)).unwrap();
    assert!(text(&output.stderr).contains("Exposure   unknown"));
    let file = std::fs::File::create(d.join("redirected.json")).unwrap();
    let status = blindaug().current_dir(d).args(["estimate", "f", "-o", "/dev/stdout"]).stdout(file).status();
    assert!(status.unwrap().success());
    blindaug_io::read_camera(d.join("redirected.json")).unwrap();
    let tracked = run(d, "estimate f --track -o /dev/stdout");
    assert!(CameraModel::from_json(&text(&tracked.stdout)).is_ok(), "{}", text(&tracked.stdout));

    let before = files_in(d);
    for arguments in ["estimate f -o /dev/null --report /dev/null", "export link.json --to nuke -o /dev/null"]
    {
        // Two results into /dev/null may be accepted or refused.
        let output = run(d, arguments);
        assert!(output.status.success() || text(&output.stderr).contains("this one file"), "{arguments}");
    }
    succeeds(d, "estimate f -o /dev/null");
    succeeds(d, "estimate f --track -o /dev/null");
    assert!(std::fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    assert_eq!(files_in(d), before);
}

/// Makes a named pipe, which nobody writes to.
#[cfg(unix)]
fn make_pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// The output of a command, which must end by itself.
#[cfg(unix)]
fn ends(folder: &Path, arguments: &str) -> Output {
    let mut command = blindaug();
    command
        .current_dir(folder)
        .args(arguments.split_whitespace())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > Duration::from_secs(60) {
            child.kill().unwrap();
            panic!("{arguments}: it waits");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    child.wait_with_output().unwrap()
}

#[cfg(unix)]
#[test]
fn pipes_as_inputs_are_refused_without_waiting() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    make_pipe(&d.join("pipe"));
    make_pipe(&d.join("pipe.png"));
    make_pipe(&d.join("pipe.toml"));
    write_frames(&d.join("f"), 1..2, (64, 48));
    write_camera(d.join("c.json"), &camera(64, 48, DepthKind::Metric)).unwrap();
    for arguments in [
        "estimate pipe -o new.json",
        "estimate pipe.png -o new.json",
        "estimate f --depth pipe -o new.json",
        "estimate f --flow pipe -o new.json",
        "estimate f --clean pipe -o new.json",
        "estimate f --network pipe.toml -o new.json",
        "inspect pipe",
        "export pipe --to nuke",
        "apply f --camera pipe -o out",
        "composite f --virtual pipe --camera c.json -o out",
        "composite pipe --virtual f --camera c.json -o out",
    ] {
        let said = sentence_of(&ends(d, arguments), arguments);
        assert!(said.contains("a pipe or a device"), "{arguments}: {said}");
    }
    assert!(!d.join("new.json").exists() && !d.join("out").exists());
}

/// Starts a command with its output piped.
#[cfg(unix)]
fn started(folder: &Path, arguments: &str) -> Child {
    let mut command = blindaug();
    command.current_dir(folder).args(arguments.split_whitespace());
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

#[cfg(unix)]
fn wait_for(what: impl Fn() -> bool) {
    let start = Instant::now();
    while !what() {
        assert!(start.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[cfg(unix)]
fn signal(child: &Child, name: &str) {
    assert!(
        Command::new("kill").args([&format!("-{name}"), &child.id().to_string()]).status().unwrap().success()
    );
}

#[cfg(unix)]
#[test]
fn every_signal_stops_alike_and_nothing_is_left_half_written() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    // There are so many frames that a signal arrives before the last one on a busy machine, too.
    const FRAMES: usize = 600;
    write_frames(&d.join("f"), 1..=4, (320, 240));
    for i in 5..=FRAMES {
        std::fs::hard_link(d.join("f/0001.png"), d.join(format!("f/{i:04}.png"))).unwrap();
    }
    write_camera(d.join("c.json"), &camera(320, 240, DepthKind::Metric)).unwrap();
    for (name, status) in [("INT", 130), ("TERM", 143), ("HUP", 129)] {
        let out = d.join(name);
        let child = started(d, &format!("apply f --camera c.json -o {name}"));
        wait_for(|| out.join("0002.png").exists());
        signal(&child, name);
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(status), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains("the same command goes on"));
        let made = files_in(&out);
        assert!(made.len() < FRAMES && made.iter().all(|n| !n.contains("partial")), "{made:?}");
    }
    // A second signal ends the program at once, and half-written files are removed.
    let child = started(d, "apply f --camera c.json -o at-once");
    wait_for(|| d.join("at-once/0002.png").exists());
    signal(&child, "INT");
    signal(&child, "TERM");
    assert!(child.wait_with_output().unwrap().status.code().is_some_and(|c| c == 130 || c == 143));
    assert!(files_in(&d.join("at-once")).iter().all(|n| !n.contains("partial")));

    // A job under nohup must go on when its terminal is closed.
    let nohup = Command::new("sh")
        .args(["-c", "trap '' HUP; exec \"$0\" apply f --camera c.json -o nohup --frames 1..4"])
        .arg(env!("CARGO_BIN_EXE_blindaug"))
        .current_dir(d)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_for(|| d.join("nohup/0001.png").exists());
    // Only Linux tells which signals a program was started to ignore.
    if cfg!(target_os = "linux") {
        signal(&nohup, "HUP");
    }
    assert!(nohup.wait_with_output().unwrap().status.success());
    assert_eq!(files_in(&d.join("nohup")).len(), 4);
}

#[cfg(unix)]
#[test]
fn an_estimate_that_was_stopped_says_how_far_it_came() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    const FRAMES: usize = 60;
    write_frames(&d.join("f"), (1..=FRAMES).filter(|n| *n != 50), (320, 240));
    for (arguments, name) in
        [("estimate f -o c.json", "c.json"), ("estimate f --track -o c.jsonl", "c.jsonl")]
    {
        let mut child = started(d, arguments);
        let mut first = [0];
        // The program says that frame 50 is missing before the work starts.
        std::io::Read::read_exact(child.stderr.as_mut().unwrap(), &mut first).unwrap();
        signal(&child, "INT");
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
        let track = blindaug_io::read_camera_track(d.join(name)).unwrap();
        let stopped = track.frames().last().unwrap().camera.stopped.unwrap();
        assert!(stopped.of == Some(FRAMES - 1) && stopped.after < FRAMES - 1, "{stopped:?}");
        let words = format!("stopped after {} of {} frames", stopped.after, FRAMES - 1);
        assert!(succeeds(d, &format!("inspect {name}")).contains(&words), "{words}");
    }
    // A model of all frames was not stopped.
    succeeds(d, "estimate f -o whole.json --frames 1..2");
    assert_eq!(blindaug_io::read_camera(d.join("whole.json")).unwrap().stopped, None);
}

#[cfg(unix)]
#[test]
fn what_killed_runs_leave_is_removed_by_the_next_and_only_that() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("f"), 1..3, (64, 48));
    write_camera(d.join("c.json"), &camera(64, 48, DepthKind::Metric)).unwrap();
    std::fs::create_dir(d.join("out")).unwrap();
    for name in [
        ".partial-1-0-new.json",
        ".partial-1-0-other.json",
        "out/.partial-9-3-0007.png",
        "out/.partial-9-3-notes.txt",
    ] {
        std::fs::write(d.join(name), "half").unwrap();
    }
    succeeds(d, "estimate f -o new.json");
    assert!(!d.join(".partial-1-0-new.json").exists() && d.join(".partial-1-0-other.json").exists());
    succeeds(d, "apply f --camera c.json -o out");
    assert_eq!(files_in(&d.join("out")), [".partial-9-3-notes.txt", "0001.png", "0002.png"]);
}

#[cfg(target_os = "linux")]
#[test]
fn files_that_may_not_grow_end_in_a_sentence_without_help_from_the_shell() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("f"), 1..3, (64, 64));
    write_camera(d.join("c.json"), &camera(64, 64, DepthKind::Metric)).unwrap();
    let before = files_in(d);
    let with_video = Command::new("ffmpeg").arg("-version").output().is_ok();
    let video = with_video.then_some("apply f --camera c.json -o out.mp4");
    for arguments in ["estimate f -o new.json", "apply f --camera c.json -o ."].into_iter().chain(video) {
        let command = format!("ulimit -f 0; exec {} {arguments}", env!("CARGO_BIN_EXE_blindaug"));
        let output = Command::new("sh").args(["-c", &command]).current_dir(d).output().unwrap();
        let said = sentence_of(&output, arguments);
        assert!(said.contains("larger than files may be") || said.contains("cannot be written"), "{said}");
        assert_eq!(files_in(d), before, "{arguments}");
    }
}

#[test]
fn words_that_a_person_understands() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_frames(&d.join("f"), 1..3, (64, 48));
    write_camera(d.join("c.json"), &camera(64, 48, DepthKind::Metric)).unwrap();
    // A value outside of the range that the help names is wrong usage.
    for fov in ["180", "0", "nan", "-5"] {
        let output = run(d, &format!("export c.json --to bevy --fov={fov}"));
        assert_eq!(output.status.code(), Some(2), "{fov}");
        assert!(text(&output.stderr).contains("from 1 to 170"));
    }
    // A long value is shortened in messages.
    let long = "x".repeat(5000);
    for arguments in
        [format!("export c.json --to {long}"), format!("estimate {long} -o new.json"), format!("{long} a")]
    {
        let output = run(d, &arguments);
        let said = text(&output.stderr);
        assert!(!output.status.success() && said.len() < 2000, "{}", said.len());
    }
    // This is the longest name that a file can have.
    let name = format!("{}.json", "n".repeat(250));
    succeeds(d, &format!("estimate f -o {name}"));
    assert!(d.join(name).exists());
    // No folder is made if the range holds no frame.
    let said = fails(d, "apply f --camera c.json -o out --frames 100..");
    assert!(said.contains("no frame in 100.."), "{said}");
    assert!(!d.join("out").exists());
}

#[cfg(target_os = "linux")]
#[test]
fn help_that_cannot_be_written_is_a_failure() {
    for arguments in [&["--help"][..], &["estimate", "--help"], &["--version"], &["help", "export"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = blindaug().args(arguments).stdout(full).output().unwrap();
        assert!(sentence_of(&output, "help").contains("standard output"));
    }
}

/// Makes a file by ffmpeg with these options; `None`, with a message, where there is no ffmpeg.
fn made_by_ffmpeg(folder: &Path, options: &str, name: &str) -> Option<()> {
    let Ok(made) = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-y"])
        .args(options.split_whitespace())
        .arg(folder.join(name))
        .output()
    else {
        eprintln!("NOT TESTED: there is no ffmpeg program");
        return None;
    };
    assert!(made.status.success(), "{options}: {}", text(&made.stderr));
    Some(())
}

#[test]
fn videos_that_are_not_what_they_seem_are_told() -> Result<(), ()> {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let clip = "-f lavfi -i testsrc2=s=96x64:r=30:d=0.7";
    let made = |options: &str, name: &str| made_by_ffmpeg(d, options, name);
    let all = || {
        made("-f lavfi -i sine=d=1 -c:a aac", "sound.m4a")?;
        made("-f lavfi -i sine=d=1 -c:a aac", "sound.mp4")?;
        made(&format!("{clip} -c:v prores_ks"), "prores.mov")?;
        made(
            &format!("{clip} -vf tinterlace=4 -flags +ilme+ildct -c:v libx264 -x264-params interlaced=1"),
            "fields.mp4",
        )?;
        made(&format!("{clip} -vf select='not(between(n\\,5\\,9))' -vsync vfr -c:v libx264"), "uneven.mp4")?;
        made(&format!("{clip} -c:v libx264"), "even.mp4")
    };
    if all().is_none() {
        return Ok(());
    }
    let with = |arguments: &str, ffmpeg: &str| {
        let mut command = blindaug();
        command.current_dir(d).env("BLINDAUG_FFMPEG", ffmpeg).args(arguments.split_whitespace());
        command.output().unwrap()
    };
    for (name, ffmpeg, says) in [
        ("sound.m4a", "ffmpeg", "there is no video in this file, only sound"),
        ("sound.mp4", "ffmpeg", "there is no video in this file, only sound"),
        ("sound.mp4", "none", "there is no video in this file, only sound"),
        ("prores.mov", "none", "only H.264 can be read"),
        ("fields.mp4", "none", "interlaced"),
    ] {
        let arguments = format!("estimate {name} -o new.json");
        let said = sentence_of(&with(&arguments, ffmpeg), &arguments);
        assert!(said.contains(says) && !said.contains("damaged"), "{name} {ffmpeg}: {said}");
    }
    for (name, ffmpeg, says) in [
        ("fields.mp4", "ffmpeg", "interlaced"),
        ("uneven.mp4", "ffmpeg", "not evenly spaced"),
        ("uneven.mp4", "none", "not evenly spaced"),
        ("prores.mov", "ffmpeg", "written"),
    ] {
        let output = with(&format!("estimate {name} -o new.json"), ffmpeg);
        assert!(
            output.status.success() && text(&output.stderr).contains(says),
            "{name}: {}",
            text(&output.stderr)
        );
    }
    for ffmpeg in ["ffmpeg", "none"] {
        let said = text(&with("estimate even.mp4 -o new.json", ffmpeg).stderr);
        assert!(!said.contains("evenly") && !said.contains("interlaced"), "{said}");
    }
    Ok(())
}

#[cfg(unix)]
#[test]
fn a_video_that_is_stopped_leaves_nothing_half_written() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        eprintln!("NOT TESTED: there is no ffmpeg program");
        return;
    }
    write_frames(&d.join("f"), 1..=60, (320, 240));
    write_camera(d.join("c.json"), &camera(320, 240, DepthKind::Metric)).unwrap();
    let partial = || files_in(d).into_iter().filter(|n| n.contains("partial")).collect::<Vec<_>>();
    for name in ["TERM", "KILL"] {
        let child = started(d, "apply f --camera c.json -o out.mp4 --fps 25 --overwrite");
        wait_for(|| !partial().is_empty());
        std::thread::sleep(Duration::from_millis(200));
        signal(&child, name);
        let output = child.wait_with_output().unwrap();
        if name == "TERM" {
            assert_eq!(output.status.code(), Some(143), "{}", text(&output.stderr));
            assert!(partial().is_empty());
        }
    }
    // The video's encoder ends when it gets no frames any more.
    std::thread::sleep(Duration::from_millis(500));
    // A killed run cannot remove its leftovers, so the next run does.
    succeeds(d, "apply f --camera c.json -o out.mp4 --fps 25 --overwrite --frames 1..2");
    assert!(partial().is_empty(), "{:?}", partial());
}

#[test]
fn names_in_a_clip_s_truth_lead_nowhere_else() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    std::fs::create_dir_all(d.join("clips/a")).unwrap();
    for name in ["../../b", "/etc", "..", "a\\nb"] {
        let json = format!("{{ \"{name}\": {{ \"noise\": {{ \"k_readout\": 0.1, \"k_shot\": 0.1 }} }} }}");
        std::fs::write(d.join("clips/a/truth.json"), json).unwrap();
        let said = fails(d, "validate --clips clips --only-clips -o out");
        assert!(said.contains("plain name"), "{said}");
    }
}

#[test]
fn a_composite_of_the_demo_still_works_beside_all_checks() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_camera(d.join("c.json"), &camera(272, 272, DepthKind::Metric)).unwrap();
    succeeds(d, &format!("composite {} --camera c.json -o out --frames 3..3", demo_arguments()));
    assert_eq!(files_in(&d.join("out")), ["0003.png"]);
}
