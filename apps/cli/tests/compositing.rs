//! What a compositor needs of the command line: colour spaces, numbering, mattes, a scale, and layers that lack depth or motion.

mod common;

use blindaug::{
    CameraModel, Encoded, Linear, Overscan, Plane, Premultiplied, Raster, Transfer,
    colour_space::{ColourSpace, Primaries, conversion, converted},
    composite::DistortedLayer,
    model::{
        Capture, DefocusModel, DepthKind, Estimate, ExposureFraction, Method, MotionBlurModel, NOISE_LEVELS,
        NoiseLevel, NoiseLines, NoiseModel, SceneDepth,
    },
};
use blindaug_io::{
    Coding, FileKind, FrameFormat, FrameRange, FrameSource, IccProfile, Reading, read_frame, read_linear,
    read_virtual_layer, write_camera, write_distorted_layer, write_png,
};
use common::*;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use tempfile::TempDir;

const W: usize = 272;

fn blindaug() -> std::process::Command {
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_blindaug"));
    command.stdin(std::process::Stdio::null());
    command
}

/// The path of a file of the demo's clip.
fn asset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo").join(name)
}

/// A camera of known parameters, whose noise is over values of this curve.
fn camera(transfer: Transfer) -> CameraModel {
    let mut model = CameraModel::unknown(
        Capture { width: W, height: W, fps: Some(25.0), frames_used: 3, pixel_aspect: 1.0 },
        "",
    );
    model.transfer = transfer;
    model.noise = Estimate::Known(NoiseModel::Lines(NoiseLines {
        levels: [NoiseLevel { slope: [0.0; 3], intercept: [0.006; 3] }; NOISE_LEVELS],
        interval: None,
        clip: 1.0,
        method: Method::Temporal,
        samples: 1000,
    }));
    model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.5)));
    model.defocus = Estimate::Known(DefocusModel::given_lens(2.0, 0.5));
    model
}

fn space(name: &str) -> ColourSpace {
    name.parse().unwrap()
}

/// Writes the demo's frames 2 and 3 in a colour space, as files of this kind.
fn write_plates(folder: &Path, file: ColourSpace, kind: FileKind, names: impl Fn(u64) -> String) {
    std::fs::create_dir(folder).unwrap();
    let bits = if kind == FileKind::Exr { 32 } else { 16 };
    let format = FrameFormat::PNG8.with(Some(kind), Some(bits)).unwrap();
    for n in 2..4 {
        let frame = read_frame(asset(&format!("frames/{n:04}.png"))).unwrap();
        let coding = Coding::new(ColourSpace::SRGB, file);
        format.write(&folder.join(names(n)), &frame, None, None, &coding).unwrap();
    }
}

/// The light of a file in linear sRGB.
fn light(path: &Path, file: ColourSpace) -> Linear {
    let reading =
        Reading { exr: Some(file), integers: file, transfer: Transfer::Linear, ..Reading::default() };
    let Encoded(image) = reading.read(path).unwrap();
    Linear(match conversion(file.primaries, Primaries::REC709) {
        Some(matrix) => image.map(|p| converted(&matrix, p)),
        None => image,
    })
}

/// The largest difference of two images, encoded as sRGB.
fn differ(a: &Linear, b: &Linear) -> f32 {
    let [a, b] = [a, b].map(|i| i.to_encoded(Transfer::Srgb).0);
    let pairs = a.data().iter().flatten().zip(b.data().iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn a_composite_is_the_same_light_in_every_colour_space() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let layers = asset("virtual");
    let layers = layers.display();
    write_camera(d.join("srgb.json"), &camera(Transfer::Srgb)).unwrap();
    let frames = asset("frames");
    let options = "--no-noise --format tiff --bits 16";
    succeeds(
        d,
        &format!(
            "composite {} --virtual {layers} --camera srgb.json -o srgb --frames 2..3 {options}",
            frames.display()
        ),
    );
    let want = light(&d.join("srgb/0003.tif"), ColourSpace::SRGB);
    let plate = light(&frames.join("0003.png"), ColourSpace::SRGB);
    assert!(differ(&want, &plate) > 0.2, "the object is seen");
    for (name, kind) in [
        ("s-log3", FileKind::Png),
        ("logc4", FileKind::Tiff),
        ("pq", FileKind::Png),
        ("acescg", FileKind::Exr),
        ("aces2065-1", FileKind::Exr),
    ] {
        let (file, extension) = (space(name), kind.extension());
        write_plates(&d.join(name), file, kind, |n| format!("{n:04}.{extension}"));
        let transfer = file.transfer.worked_on();
        write_camera(d.join("c.json"), &camera(transfer)).unwrap();
        // EXR files say what they are.
        let said = if kind == FileKind::Exr { String::new() } else { format!("--colour-space {name}") };
        let output = run(
            d,
            &format!("composite {name} --virtual {layers} --camera c.json -o out-{name} --no-noise {said}"),
        );
        let told = text(&output.stderr);
        assert!(output.status.success() && told.contains(name), "{told}");
        let made = d.join(format!("out-{name}/0003.{extension}"));
        let error = differ(&light(&made, file), &want);
        // Steps of 16 bits of a curve that spans sixteen stops.
        assert!(error < 0.004, "{name}: {error}");
        // Negative control: the same file taken for sRGB is another picture.
        assert!(
            differ(&light(&made, ColourSpace { transfer: Transfer::Srgb, ..file }), &want) > 0.05,
            "{name}"
        );
        // Pixels that are not changed are the plate's own, to the last bit.
        let values = Reading { exr: Some(ColourSpace::SRGB), ..Reading::default() };
        let [before, after] =
            [d.join(format!("{name}/0003.{extension}")), made].map(|p| values.read(p).unwrap());
        let same = before.0.data().iter().zip(after.0.data()).filter(|(a, b)| a == b).count();
        assert!(same > W * W / 4 || kind == FileKind::Exr, "{name}: {same}");
    }
    // A layer for a compositing program is in the plate's primaries, and light.
    succeeds(
        d,
        &format!(
            "composite s-log3 --colour-space s-log3 --virtual {layers} --camera c.json -o layer --layer --frames 3..3 --no-noise"
        ),
    );
    let layer = read_virtual_layer(d.join("layer/0003.exr")).unwrap();
    let plate = Reading { integers: space("s-log3"), transfer: Transfer::Linear, ..Reading::default() };
    let plate = plate.read(d.join("s-log3/0003.png")).unwrap().0;
    let over = Linear(Raster::from_fn(W, W, |x, y| {
        let ([r, g, b, a], f) = (layer.color.0.at(x, y), plate.at(x, y));
        let light = [r + (1.0 - a) * f[0], g + (1.0 - a) * f[1], b + (1.0 - a) * f[2]];
        converted(&conversion(Primaries::S_GAMUT3, Primaries::REC709).unwrap(), light)
    }));
    assert!(differ(&over, &want) < 0.01, "{}", differ(&over, &want));
    // The output may have another space than the input.
    succeeds(
        d,
        &format!(
            "composite acescg --virtual {layers} --camera srgb.json -o logc3 --no-noise --format png --output-colour-space logc3 --frames 3..3"
        ),
    );
    assert!(differ(&light(&d.join("logc3/0003.png"), space("logc3")), &want) < 0.004);
}

#[test]
fn a_camera_is_found_in_log_footage_as_in_srgb() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_plates(&d.join("log"), space("s-log3"), FileKind::Png, |n| format!("{n:04}.png"));
    let depth = asset("scene");
    let said = text(
        &run(d, &format!("estimate log -o log.json --colour-space slog3 --depth {}", depth.display())).stderr,
    );
    assert!(said.contains("taken as s-log3, not srgb"), "{said}");
    let frames = asset("frames");
    succeeds(
        d,
        &format!("estimate {} --frames 2..3 -o srgb.json --depth {}", frames.display(), depth.display()),
    );
    let [log, srgb] = ["log.json", "srgb.json"]
        .map(|name| CameraModel::from_json(&std::fs::read_to_string(d.join(name)).unwrap()).unwrap());
    assert_eq!((log.transfer, srgb.transfer), (Transfer::SLog3, Transfer::Srgb));
    // The same noise, over values that are closer together in log: at middle grey S-Log3 is three times as flat as sRGB.
    let [a, b] = [&log, &srgb].map(|m| m.noise.known().expect("there is noise").total_std(0.45)[1]);
    assert!(a < 0.7 * b && a > 0.1 * b, "{a} {b}");
    if let (Some(a), Some(b)) = (log.motion_blur.known(), srgb.motion_blur.known()) {
        assert!((a.exposure.0 - b.exposure.0).abs() < 0.1, "{a:?} {b:?}");
    }
    // What does not fit is said.
    let said = text(&run(d, "estimate log -o x.json --colour-space linear-srgb --frames 2..2").stderr);
    assert!(said.contains("log footage"), "{said}");
    assert!(
        !text(&run(d, "estimate log -o x.json --colour-space s-log3 --frames 2..2").stderr)
            .contains("warning")
    );
    let output = run(d, "estimate log -o x.json --colour-space arriraw");
    assert!(
        output.status.code() == Some(2) && text(&output.stderr).contains("logc4"),
        "{}",
        text(&output.stderr)
    );
    let layers = asset("virtual");
    let output = run(
        d,
        &format!(
            "composite log --virtual {} --camera log.json -o x --layer-colour-space s-log3",
            layers.display()
        ),
    );
    assert!(text(&output.stderr).contains("renders hold light"), "{}", text(&output.stderr));
}

#[test]
fn numbers_and_patterns_are_taken_as_artists_type_them() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_camera(d.join("c.json"), &camera(Transfer::Srgb)).unwrap();
    write_plates(&d.join("shot"), ColourSpace::SRGB, FileKind::Png, |n| format!("a_v02.{:04}.png", 999 + n));
    // Another version lies beside it.
    std::fs::write(d.join("shot/a_v01.1001.png"), "old").unwrap();
    std::fs::create_dir(d.join("fx")).unwrap();
    for n in 2..4 {
        std::fs::copy(asset(&format!("virtual/{n:04}.exr")), d.join(format!("fx/ball.{}.exr", 999 + n)))
            .unwrap();
    }
    succeeds(
        d,
        "composite shot/a_v02.%04d.png --virtual fx/ball.####.exr --camera c.json -o out/comp.%05d.png",
    );
    assert_eq!(files_in(&d.join("out")), ["comp.01001.png", "comp.01002.png"]);
    // A second run has nothing to do; --frames are the numbers of the names.
    let said = text(
        &run(
            d,
            "composite shot/a_v02.%04d.png --virtual fx/ball.####.exr --camera c.json -o out/comp.%05d.png",
        )
        .stderr,
    );
    assert!(said.contains("left as they are: 2"), "{said}");
    succeeds(d, "composite shot/a_v02.%04d.png --virtual fx --camera c.json -o one.png --frames 1002..1002");
    let [one, of_both] = ["one.png", "out/comp.01002.png"].map(|p| std::fs::read(d.join(p)).unwrap());
    assert!(one == of_both);
    // Frames are counted from another number on.
    std::fs::create_dir(d.join("plain")).unwrap();
    for n in 2..4 {
        std::fs::copy(asset(&format!("frames/{n:04}.png")), d.join(format!("plain/{n:04}.png"))).unwrap();
    }
    succeeds(d, "composite plain --first 1001 --virtual fx --camera c.json -o again --bits 16");
    assert_eq!(files_in(&d.join("again")), ["1001.png", "1002.png"]);
    let [again, before] = ["again/1001.png", "out/comp.01001.png"].map(|p| read_frame(d.join(p)).unwrap());
    assert!(again == before);
    for (arguments, says) in [
        ("composite shot/b.%04d.png --virtual fx --camera c.json -o x", "no file has a name of this pattern"),
        ("composite plain --virtual fx --camera c.json -o x", "(--first N"),
        (
            "composite plain --first 1001 --virtual fx --camera c.json -o x --frames 2..3",
            "its frames are 1001 to 1002",
        ),
        (
            "composite shot/a_v02.%04d.png --virtual fx --camera c.json -o shot/a_v02.%04d.png --overwrite",
            "would be overwritten",
        ),
    ] {
        let said = fails(d, arguments);
        assert!(said.contains(says), "{arguments}: {said}");
    }
    assert!(!d.join("x").exists());
}

fn set_time(file: &Path, time: SystemTime) {
    std::fs::File::options().append(true).open(file).unwrap().set_modified(time).unwrap();
}

#[test]
fn a_frame_is_made_anew_after_a_change_of_any_of_its_inputs() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_camera(d.join("c.json"), &camera(Transfer::Srgb)).unwrap();
    let mut sharp = camera(Transfer::Srgb);
    sharp.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.0)));
    write_camera(d.join("sharp.json"), &sharp).unwrap();
    for folder in ["frames", "virtual", "scene", "roto"] {
        std::fs::create_dir(d.join(folder)).unwrap();
    }
    let matte = Encoded(Raster::from_fn(W, W, |x, _| if x < W / 2 { [1.0; 3] } else { [0.0; 3] }));
    for n in 2..4 {
        for file in [format!("frames/{n:04}.png"), format!("virtual/{n:04}.exr"), format!("scene/{n:04}.exr")]
        {
            std::fs::copy(asset(&file), d.join(file)).unwrap();
        }
        write_png(d.join(format!("roto/{n:04}.png")), &matte).unwrap();
    }
    let hours_ago = |hours: u64| SystemTime::now() - Duration::from_secs(3600 * hours);
    let files_of = |folder: &str| -> Vec<PathBuf> {
        let all = std::fs::read_dir(d.join(folder)).unwrap().map(|entry| entry.unwrap().path());
        all.filter(|path| path.extension().is_some_and(|e| e == "png" || e == "exr")).collect()
    };
    for (command, inputs) in [
        (
            "composite frames --virtual virtual --holdout roto --camera c.json -o composed",
            vec!["frames", "virtual", "roto"],
        ),
        ("apply frames --depth scene --flow scene --camera c.json -o applied", vec!["frames", "scene"]),
        ("match frames --flow scene --from sharp.json --to c.json -o matched", vec!["frames", "scene"]),
    ] {
        let out = command.rsplit(' ').next().unwrap();
        let said = || text(&run(d, command).stderr);
        assert!(said().contains("2 frames written"), "{command}");
        for input in &inputs {
            inputs.iter().flat_map(|i| files_of(i)).for_each(|file| set_time(&file, hours_ago(3)));
            files_of(out).iter().for_each(|file| set_time(file, hours_ago(2)));
            // Negative control: nothing is newer than the frames.
            let none = said();
            assert!(none.contains("left as they are: 2"), "{command}: {none}");
            let changed =
                files_of(input).into_iter().find(|file| file.to_string_lossy().contains("0003")).unwrap();
            set_time(&changed, hours_ago(1));
            // A change in the future of another input hides none of this one.
            let other = inputs.iter().find(|other| *other != input).unwrap();
            files_of(other)
                .iter()
                .for_each(|file| set_time(file, SystemTime::now() + Duration::from_secs(100_000)));
            let one = said();
            assert!(
                one.contains("left as they are: 1") && one.contains("an input is newer: 1"),
                "{command}, {input}: {one}"
            );
        }
    }
}

#[test]
fn frames_whose_layer_has_changed_since_are_made_anew() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_camera(d.join("c.json"), &camera(Transfer::Srgb)).unwrap();
    std::fs::create_dir(d.join("fx")).unwrap();
    for n in 2..4 {
        std::fs::copy(asset(&format!("virtual/{n:04}.exr")), d.join(format!("fx/{n:04}.exr"))).unwrap();
    }
    let frames = asset("frames");
    let command = format!("composite {} --virtual fx --camera c.json -o out --frames 2..3", frames.display());
    let said = || text(&run(d, &command).stderr);
    assert!(said().contains("2 frames written"));
    // Negative control: where nothing has changed, nothing is made.
    let again = said();
    assert!(again.contains("left as they are: 2") && again.contains("0 frames written"), "{again}");
    let set_time = |file: &str, time| set_time(&d.join(file), time);
    let now = SystemTime::now();
    set_time("out/0003.png", now - Duration::from_secs(1_000_000_000));
    let anew = said();
    assert!(anew.contains("left as they are: 1") && anew.contains("an input is newer: 1"), "{anew}");
    assert!(said().contains("left as they are: 2"));
    // What lies outside the range that is asked for is left alone, and a change in the future, by another clock, is none.
    set_time("out/0003.png", now - Duration::from_secs(1_000_000_000));
    let of_range = text(&run(d, &command.replace("2..3", "2..2")).stderr);
    assert!(of_range.contains("left as they are: 1") && !of_range.contains("anew"), "{of_range}");
    assert!(said().contains("an input is newer: 1"));
    set_time("fx/0003.exr", now + Duration::from_secs(100_000));
    assert!(said().contains("left as they are: 2"));
    // An empty file of a frame's name is no frame.
    std::fs::write(d.join("out/0002.png"), "").unwrap();
    let whole = said();
    assert!(whole.contains("left as they are: 1") && whole.contains("1 frame written"), "{whole}");
    read_frame(d.join("out/0002.png")).unwrap();
    // Frames of which nobody knows how they were made are left alone, however old they are.
    std::fs::remove_file(d.join("out/.0000.png.settings")).unwrap();
    set_time("out/0002.png", now - Duration::from_secs(1_000_000_000));
    let foreign = said();
    assert!(foreign.contains("left as they are: 2") && foreign.contains("0 frames written"), "{foreign}");
}

#[test]
fn mattes_hold_the_object_out() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_camera(d.join("c.json"), &camera(Transfer::Srgb)).unwrap();
    let [frames, layers] = ["frames", "virtual"].map(asset);
    let (frames, layers) = (frames.display(), layers.display());
    std::fs::create_dir(d.join("roto")).unwrap();
    /// The row through the middle of the object.
    const MIDDLE: usize = 167;
    // Things in front of the object's upper half, in frame 2 alone.
    let matte = Encoded(Raster::from_fn(W, W, |_, y| if y < MIDDLE { [1.0; 3] } else { [0.0; 3] }));
    write_png(d.join("roto/0002.png"), &matte).unwrap();
    let f = format!("composite {frames} --virtual {layers} --camera c.json --frames 2..3 --no-noise");
    succeeds(d, &format!("{f} -o open"));
    let output = run(d, &format!("{f} -o held --holdout roto"));
    let said = text(&output.stderr);
    assert!(
        output.status.success() && said.contains("frame 3: no matte, so the object is not held out"),
        "{said}"
    );
    succeeds(d, &format!("{f} -o behind --holdout roto --holdout-of behind"));
    let read = |folder: &str, n: usize| read_frame(d.join(format!("{folder}/000{n}.png"))).unwrap();
    let plate = read_frame(asset("frames/0002.png")).unwrap();
    let (open, held, behind) = (read("open", 2), read("held", 2), read("behind", 2));
    let half = |image: &Encoded, upper: bool| match upper {
        true => image.0.crop(0, 0, W, MIDDLE),
        false => image.0.crop(0, MIDDLE, W, W - MIDDLE),
    };
    let same = |a: &Encoded, b: &Encoded, upper: bool| half(a, upper) == half(b, upper);
    assert!(same(&held, &plate, true) && same(&held, &open, false));
    assert!(same(&behind, &open, true) && same(&behind, &plate, false));
    assert!(!same(&open, &plate, true) && !same(&open, &plate, false), "the object is in both halves");
    // A frame without a matte is composited without.
    assert!(read("held", 3) == read("open", 3));
    write_png(d.join("roto/0003.png"), &Encoded(Raster::filled(9, 9, [0.0; 3]))).unwrap();
    let said = fails(d, &format!("{f} -o x --holdout roto"));
    assert!(
        said.contains("0003.png: mattes of frame 3: 9 x 9 pixels, but the frames are 272 x 272"),
        "{said}"
    );
    assert_eq!(files_in(&d.join("x")), ["0002.png"]);
}

/// A camera over relative inverse depth d = 0.4 / Z + 0.1, with the depth of its scene.
fn relative() -> (CameraModel, CameraModel) {
    let metric = camera(Transfer::Srgb);
    let mut relative = metric.clone();
    // 2 px at infinity, in focus at 2 m.
    let lens = DefocusModel::given_lens(2.0 * 0.3 / 0.2, 0.3);
    relative.defocus = Estimate::Known(DefocusModel { depth_kind: DepthKind::Relative, ..lens });
    // From 1 m on the left to 4 m on the right.
    let metres = |x: usize| 1.0 + 3.0 * (x / 9) as f32 / 30.0;
    let depth = Plane::from_fn(W, W, |x, y| if y < 200 { 0.4 / metres(x) + 0.1 } else { f32::NAN });
    relative.scene_depth = SceneDepth::of(&depth, DepthKind::Relative, 2);
    (metric, relative)
}

#[test]
fn a_scale_is_found_by_known_distances_or_not_needed() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let (metric, model) = relative();
    write_camera(d.join("metric.json"), &metric).unwrap();
    write_camera(d.join("relative.json"), &model).unwrap();
    let [frames, layers] = ["frames", "virtual"].map(asset);
    let f = format!("composite {} --virtual {} --frames 3..3 --no-noise", frames.display(), layers.display());
    let said = fails(d, &format!("{f} --camera relative.json -o x"));
    assert!(said.contains("--at") && said.contains("--match-at") && said.contains("--scene-scale"), "{said}");
    succeeds(d, &format!("{f} --camera metric.json -o metric"));
    succeeds(d, &format!("{f} --camera relative.json -o at --at 4,50=1m --at 265,50=3.9"));
    let read = |folder: &str| read_linear(d.join(folder).join("0003.png")).unwrap();
    assert!(differ(&read("metric"), &read("at")) < 0.02, "{}", differ(&read("metric"), &read("at")));
    // Negative control: wrong distances blur otherwise.
    succeeds(d, &format!("{f} --camera relative.json -o wrong --at 4,50=0.2m --at 265,50=0.8"));
    assert!(differ(&read("metric"), &read("wrong")) > 0.05);
    // As blurred as what is seen at a place, whatever the layer's depth: at 1 m the blur is 2 px, about 2 m it is sharp.
    let constant = |sigma: f32, name: &str| {
        let mut model = metric.clone();
        model.defocus = Estimate::Known(DefocusModel::given_lens(sigma, 1e-6));
        // A lens that is focused at infinity blurs in proportion to inverse depth; the layers' own depth is 1 m here.
        let curve = blindaug::model::DefocusCurve::Quadratic {
            a: 0.0,
            b: 0.0,
            c: sigma,
            inverse_depth_range: [0.0, 1.0],
        };
        model.defocus = Estimate::Known(DefocusModel::given(curve, DepthKind::Metric));
        write_camera(d.join(name), &model).unwrap();
    };
    constant(2.0, "two.json");
    succeeds(d, &format!("{f} --camera two.json -o two"));
    succeeds(d, &format!("{f} --camera relative.json -o near --match-at 4,50"));
    assert!(differ(&read("two"), &read("near")) < 0.01, "{}", differ(&read("two"), &read("near")));
    succeeds(d, &format!("{f} --camera relative.json -o middle --match-at 95,50"));
    assert!(differ(&read("two"), &read("middle")) > 0.05);
    for (options, says) in [
        ("--at 100,250=1m", "the footage does not tell the depth at 100,250 (frame 2); the nearest place"),
        ("--match-at 100,250", "the footage does not tell the depth at 100,250"),
        ("--match-at 1000,20", "outside the picture"),
        ("--at 4,50=3m --at 265,50=1m", "contradict"),
    ] {
        let said = fails(d, &format!("{f} --camera relative.json -o x {options}"));
        assert!(said.contains("relative.json: ") && said.contains(says), "{options}: {said}");
    }
    let said = fails(d, &format!("{f} --camera metric.json -o x --match-at 4,50"));
    assert!(said.contains("metric.json: it holds no depth of its scene"), "{said}");
    assert!(!d.join("x").exists());
    // inspect shows where there is depth.
    let shown = succeeds(d, "inspect relative.json");
    assert!(shown.contains("found in frame 2") && shown.contains("--at 4,4=METRES"), "{shown}");
}

#[test]
fn an_estimate_is_brought_to_metres_by_a_known_distance() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let frames = asset("frames");
    let frames = frames.display();
    let depth = asset("scene");
    succeeds(d, &format!("estimate {frames} -o metric.json --depth {}", depth.display()));
    let read = |name: &str| CameraModel::from_json(&std::fs::read_to_string(d.join(name)).unwrap()).unwrap();
    let metric = read("metric.json");
    let known = metric.scene_depth.clone().expect("the scene's depth is kept");
    assert_eq!(known.kind, DepthKind::Metric);
    let said = run(d, &format!("estimate {frames} -o at.json --depth {} --at 100,100=2m", depth.display()));
    assert!(
        !said.status.success() && text(&said.stderr).contains("metres already"),
        "{}",
        text(&said.stderr)
    );
    // The estimate itself is not lost.
    assert_eq!(read("at.json").defocus, metric.defocus);
}

#[test]
fn layers_without_depth_and_motion_are_given_some() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_camera(d.join("c.json"), &camera(Transfer::Srgb)).unwrap();
    std::fs::create_dir(d.join("flat")).unwrap();
    // The demo's layer without its Z and motion.
    let layer = read_virtual_layer(asset("virtual/0003.exr")).unwrap();
    let color = Encoded(layer.color.0.map(|[r, g, b, _]| [r, g, b]));
    let alpha = layer.color.0.map(|p| p[3]);
    let exr = FrameFormat::PNG8.with(Some(FileKind::Exr), Some(32)).unwrap();
    let light = Coding::new(ColourSpace::LINEAR_SRGB, ColourSpace::LINEAR_SRGB);
    exr.write(&d.join("flat/0003.exr"), &color, Some(&alpha), None, &light).unwrap();
    let [frames, scene] = ["frames", "scene"].map(asset);
    let f = format!("composite {} --frames 2..4 --camera c.json --no-noise --virtual flat", frames.display());
    let made = |name: &str, options: &str| {
        let output = run(d, &format!("{f} -o {name} {options}"));
        assert!(output.status.success(), "{}", text(&output.stderr));
        (read_linear(d.join(name).join("0003.png")).unwrap(), text(&output.stderr))
    };
    let (bare, said) = made("bare", "");
    assert!(said.contains("--layer-depth") && said.contains("--layer-motion"), "{said}");
    let (deep, said) = made("deep", "--layer-depth 0.5");
    assert!(differ(&bare, &deep) > 0.05 && !said.contains("--layer-depth"), "{said}");
    // A Z that is no distance tells no more than none.
    std::fs::rename(d.join("flat"), d.join("without")).unwrap();
    let far = DistortedLayer {
        color: layer.color.clone(),
        flow: Raster::filled(W, W, [f32::NAN; 2]),
        ..DistortedLayer::empty((W, W))
    };
    write_layer(&d.join("flat/0003.exr"), &far);
    let (untold, said) = made("untold", "");
    assert!(
        differ(&bare, &untold) == 0.0 && said.contains("the Z of its virtual layer is no distance"),
        "{said}"
    );
    assert!(said.contains("the motion of its virtual layer is no number"), "{said}");
    std::fs::remove_dir_all(d.join("flat")).unwrap();
    std::fs::rename(d.join("without"), d.join("flat")).unwrap();
    let (moved, said) = made("moved", "--layer-motion -12,3");
    assert!(differ(&bare, &moved) > 0.05 && !said.contains("--layer-motion"), "{said}");
    let (of_plate, said) =
        made("plate", &format!("--layer-depth plate --layer-motion plate --depth {}", scene.display()));
    assert!(differ(&bare, &of_plate) > 0.01 && !said.contains("--layer-"), "{said}");
    let said = fails(d, &format!("{f} -o x --layer-depth plate"));
    assert!(said.contains("--layer-depth plate needs the depth of the footage"), "{said}");
}

#[test]
fn video_of_ten_bits_stays_so() {
    if !blindaug_io::VideoWriter::is_available() {
        eprintln!("NOT TESTED: there is no ffmpeg program");
        return;
    }
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let pq = space("pq");
    write_camera(d.join("c.json"), &camera(pq.transfer)).unwrap();
    // A ramp whose steps are finer than those of 8 bits.
    let ramp = Encoded(Raster::from_fn(W, W, |x, _| [0.4 + 0.1 * x as f32 / W as f32; 3]));
    // Anamorphic: pixels are twice as wide as high.
    let shape = blindaug_io::VideoShape { size: (W, W), fps: 25.0, pixel_aspect: 2.0 };
    let mut video = blindaug_io::VideoWriter::create_in(d.join("in.mov"), shape, (pq, 10)).unwrap();
    for _ in 0..3 {
        video.write(&ramp).unwrap();
    }
    video.finish().unwrap();
    let layers = asset("virtual");
    let f = format!("composite in.mov --virtual {} --camera c.json --frames 1..1 --naive", layers.display());
    let output = run(d, &format!("{f} -o out.mp4"));
    let said = text(&output.stderr);
    assert!(output.status.success() && said.contains("in pq, as it says"), "{said}");
    succeeds(d, &format!("{f} -o out"));
    let still = read_frame(d.join("out/0001.png")).unwrap();
    let again = text(&run(d, "estimate out.mp4 -o again.json").stderr);
    assert!(again.contains("out.mp4: in pq, as it says"), "{again}");
    let written = blindaug_io::FrameSource::open(d.join("out.mp4"), Default::default()).unwrap();
    assert_eq!(written.pixel_aspect(), Some(2.0));
    // A row that the object does not cover has more levels than 8 bits would have.
    let levels = |frame: &Encoded| {
        let mut values: Vec<u32> = frame.0.row(2).iter().map(|p| (p[1] * 65535.0).round() as u32).collect();
        values.dedup();
        values.len()
    };
    assert!(levels(&still) > 60, "{}", levels(&still));
    let eight = Encoded(still.0.map(|p| p.map(|v| (v * 255.0).round() / 255.0)));
    assert!(levels(&eight) < 40, "{}", levels(&eight));
    let said = fails(d, &format!("{f} -o x.mp4 --bits 16"));
    assert!(said.contains("8 or 10 bits"), "{said}");
}

#[test]
fn light_below_zero_is_kept_where_nothing_covers_it() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    write_camera(d.join("c.json"), &camera(Transfer::Srgb)).unwrap();
    // Colours beyond the primaries are below 0 in one channel, as camera programs write them.
    let light =
        Encoded(Raster::from_fn(W, W, |x, y| [0.3 + 0.001 * x as f32, 0.2, -0.01 - 0.0001 * y as f32]));
    let float = FrameFormat::PNG8.with(Some(FileKind::Exr), Some(32)).unwrap();
    let coding = Coding::new(ColourSpace::LINEAR_SRGB, ColourSpace::LINEAR_SRGB);
    std::fs::create_dir(d.join("f")).unwrap();
    float.write(&d.join("f/0003.exr"), &light, None, None, &coding).unwrap();
    succeeds(d, &format!("composite f --virtual {} --camera c.json -o out", asset("virtual").display()));
    let reading = Reading { transfer: Transfer::Linear, below_zero: true, ..Reading::default() };
    let made = reading.read(d.join("out/0003.exr")).unwrap();
    let same =
        light.0.data().iter().zip(made.0.data()).filter(|(a, b)| (0..3).all(|c| (a[c] - b[c]).abs() < 1e-5));
    let same = same.count();
    assert!((W * W / 4..W * W).contains(&same), "{same}");
    // Negative control: what is read to be estimated from ends at 0.
    assert_eq!(read_linear(d.join("out/0003.exr")).unwrap().0.at(0, 0)[2], 0.0);
}

#[test]
fn every_command_of_the_page_works() {
    let page = include_str!("../../../docs/compositing.md");
    let commands: Vec<&str> = page.lines().filter_map(|l| l.strip_prefix("    blindaug ")).collect();
    assert!((5..=10).contains(&commands.len()), "{} commands", commands.len());
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    // The demo's clip stands for a plate and an object from Blender.
    let folders =
        [("plates", "shot"), ("object", "ball"), ("with", "floor"), ("without", "floor"), ("roto", "roto")];
    for (folder, _) in folders {
        std::fs::create_dir(d.join(folder)).unwrap();
    }
    let light = Coding::new(ColourSpace::SRGB, ColourSpace::LINEAR_SRGB);
    let half = FrameFormat::PNG8.with(Some(FileKind::Exr), None).unwrap();
    for n in 1..6 {
        let frame = read_frame(asset(&format!("frames/{n:04}.png"))).unwrap();
        half.write(&d.join(format!("plates/shot.{n:04}.exr")), &frame, None, None, &light).unwrap();
        for (folder, name, from, extension) in [
            ("object", "ball", "virtual", "exr"),
            ("with", "floor", "with", "png"),
            ("without", "floor", "without", "png"),
        ] {
            let to = d.join(format!("{folder}/{name}.{n:04}.{extension}"));
            std::fs::copy(asset(&format!("{from}/{n:04}.{extension}")), to).unwrap();
        }
        write_png(d.join(format!("roto/roto.{n:04}.png")), &Encoded(Raster::filled(W, W, [0.0; 3]))).unwrap();
    }
    for command in commands {
        let output = run(d, command);
        assert!(output.status.success(), "{command}: {}", text(&output.stderr));
        if let Some(made) = command.split_whitespace().skip_while(|w| *w != "-o").nth(1) {
            let made = d.join(made);
            let folder =
                if made.extension().is_some_and(|e| e == "exr") { made.parent().unwrap() } else { &made };
            assert!(folder.is_file() || files_in(folder).len() == 5, "{command}: {}", made.display());
        }
    }
}

/// Writes a file with the channels of a virtual layer.
fn write_layer(path: &Path, layer: &DistortedLayer) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    write_distorted_layer(path, layer, 32, None, &Coding::default()).unwrap();
}

#[test]
fn pixels_that_are_no_numbers_are_warned_of_and_frames_without_the_object_are_none() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let mut layer = DistortedLayer::empty((W, W));
    layer.color.0.data_mut()[20 * W..30 * W].fill([0.5, 0.5, 0.5, 1.0]);
    layer.inverse_depth.data_mut()[20 * W..30 * W].fill(0.5);
    write_layer(&d.join("whole/0001.exr"), &layer);
    layer.color.0.data_mut()[25 * W..][..3].fill([0.5, f32::NAN, 0.5, 1.0]);
    write_layer(&d.join("broken/0001.exr"), &layer);
    // A frame without the object, of which the renderer says that all is infinitely far.
    ["whole", "broken"]
        .iter()
        .for_each(|f| write_layer(&d.join(f).join("0002.exr"), &DistortedLayer::empty((W, W))));
    std::fs::create_dir(d.join("plate")).unwrap();
    for name in ["0001.png", "0002.png"] {
        write_png(d.join("plate").join(name), &Encoded(Raster::filled(W, W, [0.5; 3]))).unwrap();
    }
    write_camera(d.join("c.json"), &camera(Transfer::Srgb)).unwrap();
    let said = |command: &str| {
        let output = run(d, command);
        let said = text(&output.stderr);
        assert!(output.status.success(), "{said}");
        said
    };
    // Wherever such a file is used, each is counted once, though it may be read several times.
    let of = |layer: &str| {
        let renders = format!("--with {layer} --without whole");
        [
            (1, said(&format!("apply {layer} --camera c.json -o applied_{layer}"))),
            (1, said(&format!("apply {layer} --camera c.json --format png -o flat_{layer}"))),
            (1, said(&format!("composite plate --virtual {layer} --camera c.json -o over_{layer}"))),
            (1, said(&format!("composite plate --virtual whole {renders} --camera c.json -o lit_{layer}"))),
            (1, said(&format!("estimate {layer} -o of_{layer}.json"))),
            (2, said(&format!("estimate {layer} --clean {layer} -o clean_{layer}.json"))),
            (1, said(&format!("frames {layer}"))),
            (1, said(&format!("match {layer} --from c.json --to c.json -o matched_{layer}"))),
        ]
    };
    for (files, said) in of("broken") {
        let warned = said.matches("0001.exr: 3 pixels hold no number (NaN)").count();
        assert_eq!(warned, files, "{said}");
    }
    for (_, said) in of("whole") {
        assert!(!said.contains("NaN"), "{said}");
    }
    // The object's depth as that of the footage: one of two maps, or the only one, is infinitely far.
    let estimate = |range: &str| said(&format!("estimate plate --frames {range} --depth whole -o e.json"));
    assert!(estimate("1..2").contains("depth: 1 of 2 maps that were read have no reading"));
    assert!(estimate("2..2").contains("warning: depth: no map that was read has a reading"));
    // The colour of a frame may be whole where its alpha is not.
    let mut of_alpha = layer.clone();
    of_alpha.color.0.data_mut()[25 * W..][..3].fill([0.5, 0.5, 0.5, f32::NAN]);
    write_layer(&d.join("alpha/0001.exr"), &of_alpha);
    for said in [
        said("apply alpha --camera c.json -o applied_alpha"),
        said("composite plate --virtual whole --holdout alpha --camera c.json -o held_out"),
    ] {
        assert_eq!(said.matches("alpha/0001.exr: 3 pixels hold no number (NaN)").count(), 1, "{said}");
    }
}

#[test]
fn a_layer_s_overscan_is_blurred_into_the_frame() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let overscan = Overscan { left: 40, top: 30, right: 24, bottom: 10 };
    let (w, h) = overscan.picture_of((W, W));
    // A striped square across the corner of the frame, out of focus and moving.
    let inside = |x: usize, y: usize| (15..90).contains(&x) && (12..80).contains(&y);
    let object = |x: usize, y: usize| match inside(x, y) {
        true => [0.1 + 0.8 * ((x / 12 + y / 9) % 2) as f32, 0.3, 0.1, 1.0],
        false => [0.0; 4],
    };
    let layer = DistortedLayer {
        color: Premultiplied(Raster::from_fn(w, h, object)),
        inverse_depth: Plane::from_fn(w, h, |x, y| if inside(x, y) { 2.0 } else { f32::NAN }),
        flow: Raster::filled(w, h, [9.0, -6.0]),
        ..DistortedLayer::empty((w, h))
    };
    write_layer(&d.join("large/0001.exr"), &layer);
    let around = DistortedLayer { overscan, ..layer };
    write_layer(&d.join("layer/0001.exr"), &around);
    let bare = DistortedLayer {
        color: Premultiplied(overscan.frame_of(&around.color.0)),
        inverse_depth: overscan.frame_of(&around.inverse_depth),
        flow: overscan.frame_of(&around.flow),
        ..DistortedLayer::empty((W, W))
    };
    write_layer(&d.join("bare/0001.exr"), &bare);
    let plate = Encoded(Raster::from_fn(w, h, |x, y| [0.2 + 0.001 * x as f32, 0.3, 0.1 + 0.002 * y as f32]));
    let float = FrameFormat::PNG8.with(Some(FileKind::Exr), Some(32)).unwrap();
    let coding = Coding::new(ColourSpace::SRGB, ColourSpace::LINEAR_SRGB);
    for (name, plate) in [("whole", plate.clone()), ("plate", Encoded(overscan.frame_of(&plate.0)))] {
        std::fs::create_dir(d.join(name)).unwrap();
        float.write(&d.join(name).join("0001.exr"), &plate, None, None, &coding).unwrap();
    }
    let small = camera(Transfer::Srgb);
    let mut large = small.clone();
    (large.capture.width, large.capture.height) = (w, h);
    write_camera(d.join("small.json"), &small).unwrap();
    write_camera(d.join("large.json"), &large).unwrap();
    let composite = |plate: &str, layers: &str, camera: &str, options: &str| {
        let out = format!("{plate}-{layers}{options}");
        succeeds(
            d,
            &format!(
                "composite {plate} --virtual {layers} --camera {camera}.json -o {out} --no-noise {options}"
            ),
        );
        d.join(out).join("0001.exr")
    };
    let want = read_linear(composite("whole", "large", "large", "")).unwrap();
    let want = Linear(overscan.frame_of(&want.0));
    let made = read_linear(composite("plate", "layer", "small", "")).unwrap();
    assert!(differ(&made, &want) < 1e-4, "{}", differ(&made, &want));
    // Negative control: without what lies beyond the frame it is another picture.
    let without = read_linear(composite("plate", "bare", "small", "")).unwrap();
    assert!(differ(&without, &want) > 0.03, "{}", differ(&without, &want));
    // The layer apart, and what `apply` makes of it, keep its data window.
    let apart = read_virtual_layer(composite("plate", "layer", "small", "--layer")).unwrap();
    assert_eq!((apart.overscan, apart.color.0.size()), (overscan, (w, h)));
    succeeds(d, "apply layer --camera small.json -o applied --no-noise");
    let applied = read_virtual_layer(d.join("applied/0001.exr")).unwrap();
    assert_eq!(applied.overscan, overscan);
    let pairs = applied.color.0.data().iter().flatten().zip(apart.color.0.data().iter().flatten());
    let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    // The layer over the plate has no light of the plate, and half floats have 11 bits.
    assert!(worst < 2e-3, "{worst}");
    assert_eq!(
        read_virtual_layer(composite("plate", "bare", "small", "--layer")).unwrap().overscan,
        Overscan::default()
    );
}

#[test]
fn a_plate_s_icc_profile_is_believed_and_given_back() {
    let dir = TempDir::new().unwrap();
    let d = dir.path();
    let icc = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../crates/blindaug-io/tests/icc");
    write_camera(d.join("c.json"), &camera(Transfer::AdobeRgb)).unwrap();
    let frame = read_frame(asset("frames/0003.png")).unwrap();
    let write = |name: &str| {
        let profile = IccProfile::read(icc.join(format!("{name}.icc"))).unwrap();
        let coding = Coding::default().with_profile(Some(profile.clone()));
        FrameFormat::PNG8.write(&d.join("0003.png"), &frame, None, None, &coding).unwrap();
        profile
    };
    let profile = write("adobe-rgb");
    let layers = asset("virtual");
    let composite = format!("composite 0003.png --virtual {} --camera c.json --no-noise", layers.display());
    let said = text(&run(d, &format!("{composite} -o out")).stderr);
    assert!(said.contains("in adobe-rgb, as its ICC profile (Adobe RGB (1998)) says"), "{said}");
    let source = FrameSource::open(d.join("out/0003.png"), FrameRange::default()).unwrap();
    assert_eq!(source.profile(), Some(&profile));
    // The object is the same light, whatever the plate's space is.
    let [of_adobe, of_srgb] = [("out/0003.png", "adobe-rgb"), ("plain/0003.png", "srgb")];
    succeeds(d, &format!("{composite} -o plain --colour-space srgb"));
    let [a, b] = [of_adobe, of_srgb].map(|(path, name)| light(&d.join(path), space(name)).0.at(136, 136));
    let object = read_virtual_layer(layers.join("0003.exr")).unwrap().color.0.at(136, 136);
    assert!(object[3] > 0.99, "{object:?}");
    for c in 0..3 {
        assert!((a[c] - b[c]).abs() < 0.02, "{a:?} {b:?}");
    }
    // Of other spaces nothing says what the profile said.
    succeeds(d, &format!("{composite} -o p3 --output-colour-space display-p3"));
    let p3 = FrameSource::open(d.join("p3/0003.png"), FrameRange::default()).unwrap();
    assert!(p3.profile().is_none());
    // A profile may be given as a file.
    let said = text(
        &run(d, &format!("{composite} -o p --colour-space {}", icc.join("display-p3.icc").display())).stderr,
    );
    assert!(said.contains("taken as display-p3, not adobe-rgb"), "{said}");
    for (name, says) in [("table", "by a table"), ("cmyk", "CMYK"), ("gamma-1.4", "has a curve")] {
        write(name);
        let said = fails(d, &format!("{composite} -o bad"));
        assert!(said.contains(says) && said.contains("0003.png") && said.contains("colour space"), "{said}");
        assert!(!d.join("bad").exists());
        succeeds(d, &format!("{composite} -o said-{name} --colour-space adobe-rgb"));
    }
    let output = run(d, &format!("{composite} -o bad --colour-space none.icc"));
    assert!(
        output.status.code() == Some(2) && text(&output.stderr).contains("none.icc: there is no such file")
    );
}
