//! Tests of networks with known results (tests/data/make.py) on frames of any size.

use blindaug::model::DepthKind;
use blindaug::{Encoded, Raster};
use blindaug_nets::{Manifest, Network};
use std::path::{Path, PathBuf};

fn data(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(file)
}

fn manifest(operator: &str, file: &str, more: &str) -> Manifest {
    let text = format!(
        "name = 'n'\noperator = '{operator}'\ntitle = 't'\nlicence = 'MIT'\nsource = 's'\nfile = '{file}'\n{more}"
    );
    Manifest::parse(&text, Path::new("n.toml")).unwrap()
}

fn opened(operator: &str, file: &str, more: &str) -> Network {
    let onnx = std::fs::read(data(file)).unwrap();
    Network::new(manifest(operator, file, more), &data(file), onnx).unwrap()
}

fn error(operator: &str, onnx: Vec<u8>, more: &str) -> String {
    let network = Network::new(manifest(operator, "x.onnx", more), Path::new("x.onnx"), onnx);
    network.and_then(|n| n.image(&[&frame(20, 10)]).map(|_| ())).unwrap_err().to_string()
}

fn frame(w: usize, h: usize) -> Encoded {
    Encoded(Raster::from_fn(w, h, |x, y| {
        let v = ((x * 7 + y * 13) % 29) as f32 / 29.0;
        [v, 0.5 * v + 0.2, (x + y) as f32 / (w + h) as f32]
    }))
}

/// The mean of the 5 x 5 px around a pixel, which must lie at least 2 px inside the frame.
fn box_of(frame: &Encoded, x: usize, y: usize) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for dy in 0..5 {
        for dx in 0..5 {
            let p = frame.0.at(x + dx - 2, y + dy - 2);
            (0..3).for_each(|c| sum[c] += p[c] / 25.0);
        }
    }
    sum
}

fn close(a: [f32; 3], b: [f32; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5)
}

const IMAGE: &str = "[output]\nkind = 'image'\n";

#[test]
fn tiles_give_what_the_whole_frame_gives() {
    let frame = frame(150, 97);
    let whole = opened("removeDoF", "box.onnx", IMAGE).image(&[&frame]).unwrap();
    let tiled =
        opened("removeDoF", "box.onnx", &format!("[input]\ntile = 64\noverlap = 16\nmultiple = 8\n{IMAGE}"));
    let tiled = tiled.image(&[&frame]).unwrap();
    for (x, y) in [(20, 20), (60, 40), (75, 48), (120, 80), (147, 94)] {
        assert!(close(whole.0.at(x, y), box_of(&frame, x, y)));
        // The network sees nothing beyond the edge of a tile. Blending hides most of the difference, but not all of it.
        let off = (0..3).map(|c| (tiled.0.at(x, y)[c] - whole.0.at(x, y)[c]).abs()).fold(0.0, f32::max);
        assert!(off < 0.02, "{x} {y} {off}");
    }
    // Without overlap the seams show.
    let seams = opened("removeDoF", "box.onnx", &format!("[input]\ntile = 64\noverlap = 0\n{IMAGE}"));
    let seams = seams.image(&[&frame]).unwrap();
    let worst = |i: &Encoded| {
        let inside = (0..97 - 4).flat_map(|y| (0..150 - 4).map(move |x| (x + 2, y + 2)));
        inside.map(|(x, y)| (i.0.at(x, y)[1] - whole.0.at(x, y)[1]).abs()).fold(0.0, f32::max)
    };
    assert!(worst(&tiled) < 0.3 * worst(&seams), "{} {}", worst(&tiled), worst(&seams));
}

#[test]
fn any_size_is_padded_to_what_the_network_takes() {
    let network = opened("removeDoF", "box.onnx", &format!("[input]\nmultiple = 16\n{IMAGE}"));
    for (w, h) in [(1, 1), (1, 40), (17, 3), (33, 31)] {
        let frame = frame(w, h);
        let out = network.image(&[&frame]).unwrap();
        assert_eq!(out.0.size(), (w, h));
        if w > 4 && h > 4 {
            assert!(close(out.0.at(w / 2, h / 2), box_of(&frame, w / 2, h / 2)));
        }
    }
}

#[test]
fn channels_ranges_and_residuals_are_as_the_manifest_says() {
    let frame = frame(40, 30);
    let at = |more: &str| opened("removeDoF", "box.onnx", more).image(&[&frame]).unwrap().0.at(20, 15);
    let expected = box_of(&frame, 20, 15);
    assert!(close(
        at(
            "[input]\nchannels = 'bgr'\nmean = [0.1, 0.2, 0.3]\nstd = [0.5, 2.0, 4.0]\n[output]\nkind = 'image'"
        ),
        expected
    ));
    let own = frame.0.at(20, 15);
    let added = std::array::from_fn(|c| (own[c] + expected[c]).min(1.0));
    assert!(close(at("[output]\nkind = 'residual'"), added));
    // An output `mean` in the manifest replaces that of the input.
    let brighter = expected.map(|v| v + 0.1);
    assert!(close(at("[output]\nkind = 'image'\nmean = [0.1, 0.1, 0.1]"), brighter));
}

#[test]
fn neighbours_and_the_noise_are_given() {
    let more = format!(
        "[input]\nframes = [-1, 0, 1]\nnoise = {{ input = 'sigma', scale = 1, shape = [1, 1, 1, 1] }}\n{IMAGE}"
    );
    let network = opened("removeNoise", "three.onnx", &more);
    let flat = |v: f32| Encoded(Raster::filled(64, 48, [v, v, 0.5]));
    let [a, b, c] = [0.2, 0.3, 0.7].map(flat);
    let [r, _, blue] = network.image(&[&a, &b, &c]).unwrap().0.at(9, 9);
    assert!((r - 0.4).abs() < 0.01 && (blue - 0.5).abs() < 0.01, "{r} {blue}");
    // The test network subtracts the noise std from a noisy frame.
    let mut seed = 1u32;
    let mut noise = || {
        let mut sum = -6.0;
        for _ in 0..12 {
            seed = seed.wrapping_mul(1664525).wrapping_add(1013904223);
            sum += (seed >> 8) as f32 / (1 << 24) as f32;
        }
        0.05 * sum
    };
    let mut noisy = flat(0.5);
    noisy.0.data_mut().iter_mut().for_each(|p| p.iter_mut().for_each(|v| *v += noise()));
    let out = network.image(&[&noisy, &noisy, &noisy]).unwrap();
    let mean = out.0.data().iter().map(|p| p[0]).sum::<f32>() / out.0.data().len() as f32;
    assert!((mean - 0.45).abs() < 0.01, "{mean}");
    assert!(network.image(&[&a]).unwrap_err().to_string().contains("1 frames were given to a network of 3"));
}

#[test]
fn flow_and_depth_come_in_their_units() {
    let more = "[input]\nframes = [0, 1]\nlayout = 'inputs'\ntile = 32\noverlap = 8\n[output]\nkind = 'flow'\nscale = 10.0";
    let network = opened("getFlow", "flow.onnx", more);
    let (a, b) = (frame(50, 40), Encoded(frame(50, 40).0.map(|p| p.map(|v| v + 0.25))));
    let flow = network.flow(&[&a, &b]).unwrap();
    let [u, v] = flow.at(30, 20);
    assert!((u - 2.5).abs() < 1e-4 && (v - 20.0 * a.0.at(30, 20)[2]).abs() < 1e-4, "{u} {v}");
    let wrong = network.image(&[&a, &b]).unwrap_err().to_string();
    assert!(wrong.contains("gives 2 channels where 3 are needed"), "{wrong}");

    let relative =
        opened("getDepth", "depth.onnx", "[input]\nsize = [32, 24]\n[output]\nkind = 'inverse-depth'");
    let ramp = Encoded(Raster::from_fn(96, 72, |x, _| [0.0, 0.2 + 0.5 * x as f32 / 95.0, 0.0]));
    let (depth, kind) = relative.inverse_depth(&[&ramp]).unwrap();
    assert_eq!((kind, depth.size()), (DepthKind::Relative, (96, 72)));
    assert!((0..96).all(|x| (depth.at(x, 30) - ramp.0.at(x, 30)[1]).abs() < 0.02));
    let metric = opened("getDepth", "depth.onnx", "[input]\nsize = [32, 24]\n[output]\nkind = 'depth'");
    let (depth, kind) = metric.inverse_depth(&[&ramp]).unwrap();
    assert_eq!(kind, DepthKind::Metric);
    assert!((1.0 / depth.at(48, 30) - ramp.0.at(48, 30)[1]).abs() < 0.02);
}

#[test]
fn a_damaged_or_foreign_file_is_an_error_that_says_so() {
    let read = |file: &str| std::fs::read(data(file)).unwrap();
    let whole = read("box.onnx");
    for n in [0, 7, whole.len() / 2, whole.len() - 3] {
        let e = error("removeDoF", whole[..n].to_vec(), IMAGE);
        assert!(e.starts_with("x.onnx: ") && e.contains("it may be cut short"), "{n}: {e}");
    }
    if std::env::var_os("ORT_DYLIB_PATH").is_none() {
        let e = error("removeDoF", read("cubic.onnx"), IMAGE);
        assert!(e.contains("cubic interpolation"), "{e}");
    }
    let e = error("removeDoF", read("nan.onnx"), IMAGE);
    assert!(e.contains("gives values that are no numbers"), "{e}");
    let e = error("removeDoF", read("flow.onnx"), IMAGE);
    assert!(e.contains("takes 2 inputs (a, b) but its manifest speaks of 1"), "{e}");
    let e = error("removeDoF", read("depth.onnx"), IMAGE);
    assert!(e.contains("does not run on [1, 3, 10, 20]"), "{e}");
    let e = error("removeDoF", read("box.onnx"), &format!("sha256 = '{}'\n{IMAGE}", "a".repeat(64)));
    assert!(e.contains("is not the one that the manifest of n names"), "{e}");
    let e =
        error("removeDoF", read("box.onnx"), "[input]\nmemory = 1000000000000\n[output]\nkind = 'image'\n");
    assert!(e.contains("needs") && e.contains("MB are free"), "{e}");
    let e = Network::open(&data("missing.toml")).err().map(|e| e.to_string());
    assert!(e.is_some_and(|e| e.contains("there is no such file")));
}
