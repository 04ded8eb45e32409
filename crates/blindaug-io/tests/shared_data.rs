//! Tests of the readers on real and rendered files.

use blindaug::Transfer;
use blindaug_io::*;
use std::path::PathBuf;

/// The shared data folder; `None`, with a printed message, if it is missing.
fn shared() -> Option<PathBuf> {
    let root = std::env::var_os("BLINDAUG_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let data = root.join("data");
    if !data.is_dir() {
        eprintln!("NOT TESTED: no shared data at {} (set BLINDAUG_SHARED)", data.display());
        return None;
    }
    Some(data)
}

#[test]
fn a_rendered_clip_s_geometry_and_layer() {
    let Some(data) = shared() else { return };
    let clip = data.join("clips/table1");
    let frame = read_frame(clip.join("clean/0003.png")).unwrap();
    assert_eq!(frame.0.size(), (512, 512));
    assert!(frame.0.data().iter().flatten().all(|v| (0.0..=1.0).contains(v)));

    let geometry = clip.join("clean/0003.exr");
    assert_eq!(
        exr_contents(&geometry).unwrap(),
        ExrContents { colour: false, alpha: false, depth: true, flow: true }
    );
    let depth = read_inverse_depth(&geometry, DepthFormat::default()).unwrap();
    assert!(depth.data().iter().all(|d| d.is_nan() || (0.01..10.0).contains(d)));
    let flow = read_flow(&geometry).unwrap();
    assert_eq!(flow.size(), (512, 512));
    // The flow is right if the next frame, sampled along the flow, is nearly this frame, and much less so when sampled against it.
    let (a, b) = (read_frame(clip.join("clean/0002.png")).unwrap(), frame);
    let flow = read_flow(clip.join("clean/0002.exr")).unwrap();
    let error = |sign: f32| {
        let mut sum = 0.0;
        for y in 0..512 {
            for x in 0..512 {
                let [u, v] = flow.at(x, y);
                let p = b.0.bilinear(x as f32 + sign * u, y as f32 + sign * v);
                sum += (p[1] - a.0.at(x, y)[1]).abs();
            }
        }
        sum
    };
    assert!(error(1.0) < 0.3 * error(-1.0), "{} {}", error(1.0), error(-1.0));

    let layer = read_virtual_layer(clip.join("virtual/0003.exr")).unwrap();
    let (depth, flow) = (layer.inverse_depth.unwrap(), layer.flow.unwrap());
    assert_eq!((layer.color.0.size(), depth.size(), flow.size()), ((512, 512), (512, 512), (512, 512)));
    let solid: Vec<usize> = (0..512 * 512).filter(|&i| layer.color.0.data()[i][3] == 1.0).collect();
    assert!(solid.len() > 1000);
    assert!(solid.iter().all(|&i| depth.data()[i] > 0.0));
    assert!(read_virtual_layer(clip.join("clean/0003.png")).is_err());
    assert!(read_virtual_layer(&geometry).unwrap_err().to_string().contains("forward.u"));
    assert!(read_frame(&geometry).unwrap_err().to_string().contains("0003.exr"));
    // The linear and the encoded values of an EXR agree through the transfer curve.
    let linear = read_linear(clip.join("virtual/0003.exr")).unwrap();
    let encoded = read_frame(clip.join("virtual/0003.exr")).unwrap();
    let (l, e) = (linear.0.at(256, 256), encoded.0.at(256, 256));
    assert!((0..3).all(|c| (Transfer::Srgb.encode(l[c]) - e[c]).abs() < 1e-6));
}

#[test]
fn a_depth_camera_s_maps() {
    let Some(data) = shared() else { return };
    let format = DepthFormat::default();
    // The rendered desk has 5000 units per metre, as the TUM benchmark's files have.
    for (path, per_metre) in [("rgbd/room/depth/1.pgm", 1000.0), ("rgbd/desk/depth/1.png", 5000.0)] {
        let format = DepthFormat { per_metre, ..format };
        let depth = read_inverse_depth(data.join(path), format).unwrap();
        let mut metres: Vec<f32> = depth.data().iter().filter(|d| !d.is_nan()).map(|d| 1.0 / d).collect();
        metres.sort_by(f32::total_cmp);
        let median = metres[metres.len() / 2];
        assert!((0.4..6.0).contains(&median), "{path}: median depth {median} m");
    }
    let e = read_inverse_depth(data.join("rgbd/room/color/1.png"), format).unwrap_err();
    assert!(e.to_string().contains("colour picture"), "{e}");
}

#[test]
fn a_clip_s_folders_as_sources() {
    let Some(data) = shared() else { return };
    let clip = data.join("clips/shelf3");
    let source = FrameSource::open(clip.join("clean"), "2..4".parse().unwrap()).unwrap();
    assert_eq!((source.size(), source.len_hint()), ((512, 512), Some(3)));
    assert!(source.notes().is_empty(), "{:?}", source.notes());
    let depth = SideFolder::depth(clip.join("clean"), DepthFormat::default()).unwrap();
    let flow = SideFolder::flow(clip.join("clean")).unwrap();
    let layers = SideFolder::virtual_layers(clip.join("virtual")).unwrap();
    assert!(depth.notes()[0].starts_with("depth: 5 EXR files"), "{:?}", depth.notes());
    for frame in source.frames() {
        let n = frame.unwrap().number;
        assert!(depth.get(n, source.size()).unwrap().is_some());
        assert!(flow.get(n, source.size()).unwrap().is_some());
        assert!(layers.get(n, source.size()).unwrap().is_some());
    }
    assert!(!layers.has(1));
}

#[test]
fn a_video_as_a_source() {
    let Some(data) = shared() else { return };
    let path = data.join("video/bikes.mp4");
    let open = |range: &str| FrameSource::open(&path, range.parse().unwrap()).unwrap();
    let source = open("5..7");
    assert_eq!((source.size(), source.fps(), source.len_hint()), ((640, 272), Some(25.0), Some(3)));
    for _ in 0..2 {
        let numbers: Vec<u64> = source.frames().map(|f| f.unwrap().number).collect();
        assert_eq!(numbers, [5, 6, 7]);
    }
    let some: Vec<u64> = source.frames_if(|n| n == 6).map(|f| f.unwrap().number).collect();
    assert_eq!(some, [6]);
    let source = open("251..");
    let mut beyond = source.frames();
    let e = beyond.next().unwrap().unwrap_err().to_string();
    assert!(e.contains("251..") && e.contains("250 frames"), "{e}");
    assert!(beyond.next().is_none());
}
