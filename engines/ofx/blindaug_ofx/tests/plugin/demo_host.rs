//! The plugin's binary in a host made of the OpenFX project's own HostSupport library, which `check.sh` builds.

use crate::{clip::*, host::bytes_of};
use blindaug::{CameraModel, Raster, Transfer};
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
    (name, depth, components): (&str, &CStr, &CStr),
    way: &str,
    pick: impl Fn(&Inputs) -> Values,
) -> String {
    let folder = folder.join(name);
    fs::create_dir_all(&folder).unwrap();
    let channels = if components == kOfxImageComponentRGBA { 4 } else { 1 };
    for number in 1..=FRAMES {
        fs::write(folder.join(format!("{number}.raw")), bytes(&pick(inputs(number)), depth, channels))
            .unwrap();
    }
    let [depth, components] = [depth, components].map(|t| t.to_str().unwrap());
    format!("clip {name} {depth} {components} 0 0 {} {} {way} {}\n", SIZE.0, SIZE.1, folder.display())
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

/// The job of compositing the clip.
fn job(folder: &Path, out: &Path, depth: &CStr, way: &str, srgb: bool, model: &CameraModel) -> String {
    let camera = folder.join("camera.json");
    fs::write(&camera, model.to_json()).unwrap();
    let rgba = kOfxImageComponentRGBA;
    let plate = |i: &Inputs| if srgb { encoded(&i.plate) } else { i.plate.clone() };
    // The tests' layers are almost everywhere opaque or empty: here, only those pixels are taken.
    let layer = |i: &Inputs| {
        let opaque = i.layer.map(|p| if p[3] > 0.99 { [p[0], p[1], p[2], 1.0] } else { [0.0; 4] });
        if srgb { encoded(&opaque) } else { opaque }
    };
    let float = kOfxBitDepthFloat;
    let mut job = format!("project {} {}\nframes 1 {FRAMES}\n", SIZE.0, SIZE.1);
    job += &clip_of(folder, ("Source", depth, rgba), way, layer);
    job += &clip_of(folder, ("Depth", float, kOfxImageComponentAlpha), way, |i| i.depth.clone());
    job += &clip_of(folder, ("Motion", float, rgba), way, |i| i.motion.clone());
    job += &clip_of(folder, ("Plate", depth, rgba), way, plate);
    let [w, h] = [SIZE.0, SIZE.1];
    write!(job, "output 0 0 {w} {h} {way} {}\nset colour {}\n", out.display(), i32::from(srgb)).unwrap();
    writeln!(job, "set camera {}", camera.display()).unwrap();
    job
}

/// What the library makes of what the host has.
fn want(number: u64, depth: &CStr, srgb: bool, model: &CameraModel, seed: u64) -> Values {
    let given = inputs(number);
    let opaque = given.layer.map(|p| if p[3] > 0.99 { [p[0], p[1], p[2], 1.0] } else { [0.0; 4] });
    let light = |[r, g, b, a]: [f32; 4]| {
        let [r, g, b] = [r, g, b].map(|v| Transfer::Srgb.decode(v));
        [r, g, b, a]
    };
    let in_host = |v: &Values| match srgb {
        true => kept(&encoded(v), depth).map(light),
        false => kept(v, depth),
    };
    let given = Inputs { layer: in_host(&opaque), plate: in_host(&given.plate), ..given.clone() };
    let made = Reference { inputs: &given, model, number, seed, unclipped: !srgb };
    if srgb { made.encoded() } else { made.light() }
}

#[test]
#[ignore = "needs the demo host, which check.sh builds"]
fn the_demo_host_renders_the_library_s_frames() {
    let model = camera(0.5);
    for (depth, srgb, way) in [
        (kOfxBitDepthFloat, false, "up"),
        (kOfxBitDepthFloat, false, "down"),
        (kOfxBitDepthHalf, false, "down"),
        (kOfxBitDepthShort, true, "up"),
        (kOfxBitDepthByte, true, "down"),
    ] {
        let (folder, out) = folder_of("out");
        let job = job(folder.path(), &out, depth, way, srgb, &model);
        let (said, ended_well) = run(folder.path(), &job);
        assert!(ended_well && !said.contains("MESSAGE"), "{said}");
        let output = format!("OUTPUT {} OfxImageComponentRGBA varying 1", depth.to_str().unwrap());
        assert!(said.contains(&output), "{said}");
        let mut worst = 0.0f32;
        for number in 1..=FRAMES {
            let made = fs::read(out.join(format!("{number}.raw"))).unwrap();
            assert_eq!(made.len(), SIZE.0 * SIZE.1 * 4 * bytes_of(depth));
            let got = values(&made, SIZE, depth);
            let off = |model: &CameraModel, seed| apart(&got, &want(number, depth, srgb, model, seed), depth);
            worst = worst.max(off(&model, 0));
            // Negative controls: another seed, and another camera.
            assert!(off(&model, 1) > 10.0 && off(&camera(0.9), 0) > 10.0, "{number}");
        }
        println!("{depth:?} srgb {srgb} rows {way}: {FRAMES} frames, {worst:.3} of what is allowed");
        assert!(worst <= 1.0, "{worst}");
    }
}

#[test]
#[ignore = "needs the demo host, which check.sh builds"]
fn the_demo_host_analyses_the_plate() {
    let (folder, out) = folder_of("out");
    let job = job(folder.path(), &out, kOfxBitDepthFloat, "up", false, &camera(0.5));
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
    let good = job(folder.path(), &out, kOfxBitDepthFloat, "up", false, &camera(0.5));
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
    let (folder, out) = folder_of("out");
    let job = job(folder.path(), &out, kOfxBitDepthFloat, "up", false, &camera(0.5));
    let (said, ended_well) = run(folder.path(), &job);
    assert!(ended_well, "{said}");
    let made = values(&fs::read(out.join("2.raw")).unwrap(), SIZE, kOfxBitDepthFloat);
    let Inputs { layer, plate, .. } = inputs(2);
    let pasted: Values = Raster::from_fn(SIZE.0, SIZE.1, |x, y| {
        let (l, p) = (layer.at(x, y), plate.at(x, y));
        std::array::from_fn(|c| l[c] + (1.0 - l[3]) * p[c])
    });
    let mut ppm = format!("P6\n{} {}\n255\n", 3 * SIZE.0, SIZE.1).into_bytes();
    for y in 0..SIZE.1 {
        for image in [plate, &pasted, &made] {
            for pixel in image.row(y) {
                ppm.extend(
                    pixel[..3]
                        .iter()
                        .map(|v| (Transfer::Srgb.encode(*v).clamp(0.0, 1.0) * 255.0).round() as u8),
                );
            }
        }
    }
    fs::write(path, ppm).unwrap();
}
