//! The plugin's binary in a host made of the OpenFX project's own HostSupport library, which `check.sh` builds.

use crate::{clip::*, host::bytes_of};
use blindaug::{
    CameraModel, Raster, Transfer,
    model::{Estimate, Reason},
};
use blindaug_pipeline::ByHand;
use openfx::sys::{generic::core::*, image_effect_v1::image_effect::*};
use std::{
    env,
    ffi::CStr,
    fmt::Write,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

const NEEDS: &str = "run check.sh, which builds the host and the bundle and says where they are";

/// The images of a clip and its line of the job.
fn clip_of(
    folder: &Path,
    (name, depth): (&str, &CStr),
    way: &str,
    frames: &[Inputs],
    pick: impl Fn(&Inputs) -> Values,
) -> String {
    let folder = folder.join(name);
    fs::create_dir_all(&folder).unwrap();
    for (number, frame) in (1..).zip(frames) {
        fs::write(folder.join(format!("{number}.raw")), bytes(&pick(frame), depth, 4)).unwrap();
    }
    let (w, h) = frames[0].plate.size();
    // Optional clips get the channels of the first one, as hosts do it.
    let [depth, components] = [depth, kOfxImageComponentRGBA].map(|t| t.to_str().unwrap());
    format!("clip {name} {depth} {components} 0 0 {w} {h} {way} {}\n", folder.display())
}

/// Runs the host with a job; what it says, and whether it ended well.
fn run(folder: &Path, job: &str) -> (String, bool) {
    let file = folder.join("job.txt");
    fs::write(&file, job).unwrap();
    let [host, bundle] =
        ["BLINDAUG_OFX_HOST", "BLINDAUG_OFX_BUNDLE"].map(|name| env::var(name).expect(NEEDS));
    let plugin = "com.github.blindaug:MatchCamera";
    let ended = Command::new(host).arg(plugin).arg(&file).env("OFX_PLUGIN_PATH", bundle).output().unwrap();
    let said = String::from_utf8_lossy(&ended.stdout).into_owned();
    let status = ended.status;
    assert!(status.code().is_some(), "the host was ended by a signal: {status}, {said}");
    (said, status.success())
}

fn folder_of(test: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join(test);
    fs::create_dir_all(&out).unwrap();
    (folder, out)
}

/// The kind of a job's values.
#[derive(Clone, Copy)]
struct Kind {
    depth: &'static CStr,
    /// Whether they are display-encoded; else they are linear.
    srgb: bool,
    /// Whether depth and motion are given: integers cannot hold them, and hosts give everything in the most precise kind of values.
    moves: bool,
    /// The order of rows in memory.
    way: &'static str,
}

const LINEAR: Kind = Kind { depth: kOfxBitDepthFloat, srgb: false, moves: true, way: "up" };

/// The layer without soft edges, so that it is the same before and after it is encoded.
fn opaque(i: &Inputs) -> Values {
    i.layer.map(|p| if p[3] > 0.99 { [p[0], p[1], p[2], 1.0] } else { [0.0; 4] })
}

/// The job of compositing the clip.
fn job(folder: &Path, out: &Path, kind: Kind, model: &CameraModel) -> String {
    let frames: Vec<Inputs> = (1..=FRAMES).map(|number| inputs(number).clone()).collect();
    job_of(&frames, folder, out, kind, model)
}

/// The job of compositing frames.
fn job_of(frames: &[Inputs], folder: &Path, out: &Path, kind: Kind, model: &CameraModel) -> String {
    let Kind { depth, srgb, moves, way } = kind;
    let camera = folder.join("camera.json");
    fs::write(&camera, model.to_json()).unwrap();
    let of = |v: Values| if srgb { encoded(&v) } else { v };
    let (w, h) = frames[0].plate.size();
    let mut job = format!("project {w} {h}\nframes 1 {}\n", frames.len());
    job += &clip_of(folder, ("Source", depth), way, frames, |i| of(opaque(i)));
    job += &clip_of(folder, ("Plate", depth), way, frames, |i| of(i.plate.clone()));
    if moves {
        job += &clip_of(folder, ("Depth", depth), way, frames, |i| i.depth.clone());
        job += &clip_of(folder, ("Motion", depth), way, frames, |i| i.motion.clone());
    }
    write!(job, "output 0 0 {w} {h} {way} {}\nset colour {}\n", out.display(), i32::from(srgb)).unwrap();
    writeln!(job, "set camera {}", camera.display()).unwrap();
    job
}

/// What the library makes of what the host has.
fn want(number: u64, kind: Kind, model: &CameraModel, seed: u64) -> Values {
    let Kind { depth, srgb, moves, .. } = kind;
    let given = inputs(number);
    let light = |[r, g, b, a]: [f32; 4]| {
        let [r, g, b] = [r, g, b].map(|v| Transfer::Srgb.decode(v));
        [r, g, b, a]
    };
    let in_host = |v: &Values| match srgb {
        true => kept(&encoded(v), depth).map(light),
        false => kept(v, depth),
    };
    let moved = |v: &Values, without: f32| if moves { kept(v, depth) } else { v.map(|_| [without; 4]) };
    let given = Inputs {
        layer: in_host(&opaque(given)),
        plate: in_host(&given.plate),
        depth: moved(&given.depth, 1e10),
        motion: moved(&given.motion, 0.0),
    };
    let mut model = model.clone();
    if !moves {
        model.defocus = Estimate::unknown(Reason::NoDepth, "");
    }
    let made = Reference { inputs: &given, model: &model, number, seed, unclipped: !srgb };
    if srgb { made.encoded() } else { made.light() }
}

#[test]
#[ignore = "needs the demo host, which check.sh builds"]
fn the_demo_host_renders_the_library_s_frames() {
    let model = camera(0.5);
    let mut noisier = model.clone();
    let twice = ByHand { grain: Some(2.0), ..ByHand::default() };
    noisier = twice.applied(noisier).unwrap();
    for kind in [
        LINEAR,
        Kind { way: "down", ..LINEAR },
        Kind { depth: kOfxBitDepthHalf, way: "down", ..LINEAR },
        Kind { depth: kOfxBitDepthShort, srgb: true, moves: false, way: "up" },
        Kind { depth: kOfxBitDepthByte, srgb: true, moves: false, way: "down" },
    ] {
        let (folder, out) = folder_of("out");
        let context = if kind.way == "up" { "general" } else { "filter" };
        let job = job(folder.path(), &out, kind, &model) + "context " + context + "\n";
        let (said, ended_well) = run(folder.path(), &job);
        assert!(ended_well && !said.contains("MESSAGE"), "{said}");
        let Kind { depth, srgb, way, .. } = kind;
        let output = format!("OUTPUT {} OfxImageComponentRGBA varying 1", depth.to_str().unwrap());
        assert!(said.contains(&output), "{said}");
        let (mut worst, mut least) = (0.0f32, f32::INFINITY);
        for number in 1..=FRAMES {
            let made = fs::read(out.join(format!("{number}.raw"))).unwrap();
            assert_eq!(made.len(), SIZE.0 * SIZE.1 * 4 * bytes_of(depth));
            let got = values(&made, SIZE, depth);
            let off = |model: &CameraModel, seed| apart(&got, &want(number, kind, model, seed), depth);
            worst = worst.max(off(&model, 0));
            // Negative controls: another seed, a camera with more noise, and where things move another shutter.
            let others = [off(&model, 1), off(&noisier, 0), off(&camera(0.9), 0)];
            let others = &others[..if kind.moves { 3 } else { 2 }];
            least = others.iter().fold(least, |a, b| a.min(*b));
        }
        println!(
            "{depth:?}, srgb {srgb}, rows {way}: {FRAMES} frames, {worst:.3} of what is allowed; others at least {least:.1}"
        );
        assert!(worst <= 1.0, "{worst}");
        assert!(least > 10.0, "{least}");
    }
}

#[test]
#[ignore = "needs the demo host, which check.sh builds"]
fn the_demo_host_analyses_the_plate() {
    let (folder, out) = folder_of("out");
    let job = job(folder.path(), &out, LINEAR, &camera(0.5));
    // No camera is set, and the lens that the analysis finds has no unit for the depth.
    let job: String = job
        .lines()
        .filter(|l| !l.contains("camera") && !l.starts_with("clip Depth"))
        .fold(String::new(), |all, line| all + line + "\n");
    let (said, ended_well) = run(folder.path(), &(job + "press analyse\n"));
    assert!(ended_well && !said.contains("MESSAGE") && said.contains("PROGRESS 1"), "{said}");
    let analysed = fs::read_to_string(out.join("analysed.txt")).unwrap();
    let model = CameraModel::from_json(&analysed).unwrap();
    assert_eq!((model.capture.width, model.capture.frames_used), (SIZE.0, FRAMES as usize));
    assert!(fs::read_to_string(out.join("about.txt")).unwrap().contains("96 x 72"));
    assert!(out.join(format!("{FRAMES}.raw")).exists());
}

#[test]
#[ignore = "needs the demo host, which check.sh builds"]
fn the_demo_host_is_told_what_is_wrong() {
    let (folder, out) = folder_of("out");
    let good = job(folder.path(), &out, LINEAR, &camera(0.5));
    fs::write(folder.path().join("camera.json"), "{").unwrap();
    let (said, ended_well) = run(folder.path(), &good);
    assert!(!ended_well && said.contains("STATUS 1"), "{said}");
    assert!(
        said.contains("MESSAGE blindaug: ") && said.contains("camera.json: not a camera model"),
        "{said}"
    );
    fs::remove_file(folder.path().join("camera.json")).unwrap();
    let (said, ended_well) = run(folder.path(), &good);
    assert!(!ended_well && said.contains("cannot be read"), "{said}");
    let none: String =
        good.lines().filter(|l| !l.contains("camera.json")).map(|l| format!("{l}\n")).collect();
    let (said, ended_well) = run(folder.path(), &none);
    assert!(!ended_well && said.contains("there is no camera"), "{said}");
    // Negative control: with the file there is nothing to say.
    fs::write(folder.path().join("camera.json"), camera(0.5).to_json()).unwrap();
    let (said, ended_well) = run(folder.path(), &good);
    assert!(ended_well && !said.contains("MESSAGE"), "{said}");
}

/// Writes the plate, the layer pasted on, and the frame from the host side by side, as a picture to be looked at.
#[test]
#[ignore = "needs the demo host, which check.sh builds"]
fn a_picture_is_written_where_one_is_asked_for() {
    let Ok(path) = env::var("BLINDAUG_OFX_PICTURE") else {
        println!("no picture: BLINDAUG_OFX_PICTURE names none");
        return;
    };
    let (size, (folder, out)) = ((320, 240), folder_of("out"));
    // The camera of the scene: its blur is as large a part of the frame as in the small clip.
    let model = camera(0.5).scaled_to(size.0, size.1);
    let mut frame = inputs_of(size, 2);
    frame.plate = noisy(&frame.plate.map(|p| p.map(|v| v / 1.6)), &model, 2);
    let job = job_of(std::slice::from_ref(&frame), folder.path(), &out, LINEAR, &model);
    let (said, ended_well) = run(folder.path(), &job);
    assert!(ended_well, "{said}");
    let made = values(&fs::read(out.join("1.raw")).unwrap(), size, kOfxBitDepthFloat);
    let layer = opaque(&frame);
    let pasted: Values = Raster::from_fn(size.0, size.1, |x, y| {
        let (l, p) = (layer.at(x, y), frame.plate.at(x, y));
        std::array::from_fn(|c| l[c] + (1.0 - l[3]) * p[c])
    });
    assert!(apart(&made, &pasted, kOfxBitDepthFloat) > 10.0);
    let mut ppm = format!("P6\n{} {}\n255\n", 3 * size.0, size.1).into_bytes();
    for y in 0..size.1 {
        for image in [&frame.plate, &pasted, &made] {
            let encoded = |v: &f32| (Transfer::Srgb.encode(*v).clamp(0.0, 1.0) * 255.0).round() as u8;
            ppm.extend(image.row(y).iter().flat_map(|pixel| &pixel[..3]).map(encoded));
        }
    }
    fs::write(path, ppm).unwrap();
}
