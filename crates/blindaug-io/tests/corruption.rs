//! Tests that a reader of a damaged file returns a value, or an error of one sentence that names the file.

use blindaug::{CameraModel, Encoded, Plane, Raster, model::Capture};
use blindaug_io::*;
use proptest::prelude::*;
use std::{fs, path::Path};

type Read = fn(&Path) -> Result<()>;

/// A small file of each kind and variant, and its reader.
fn samples() -> Vec<(&'static str, Vec<u8>, Read)> {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let picture =
        Raster::from_fn(37, 29, |x, y| [x as f32 / 37.0, y as f32 / 29.0, ((x * y) % 7) as f32 / 7.0]);
    let bytes: Vec<u8> = picture.data().iter().flatten().map(|v| (255.0 * v) as u8).collect();
    let rgb = image::RgbImage::from_raw(37, 29, bytes).unwrap();
    let grey = image::ImageBuffer::from_fn(37, 29, |x, y| image::Luma([500u16 + 10 * (x * y) as u16]));
    for name in ["frame.jpg", "frame.tif", "frame.bmp", "frame.ppm"] {
        rgb.save(at(name)).unwrap();
    }
    for name in ["depth.png", "depth.pgm", "depth.tif"] {
        grey.save(at(name)).unwrap();
    }
    write_png(at("frame.png"), &Encoded(picture)).unwrap();
    write_flo(at("flow.flo"), &Raster::from_fn(7, 5, |x, y| [x as f32, -(y as f32)])).unwrap();
    let capture = Capture { width: 4, height: 3, fps: Some(25.0), frames_used: 5, pixel_aspect: 1.0 };
    write_camera(at("camera.json"), &CameraModel::unknown(capture, "nothing moves")).unwrap();
    for (name, compression, tiled) in [
        ("raw.exr", exr::prelude::Compression::Uncompressed, false),
        ("rle.exr", exr::prelude::Compression::RLE, false),
        ("zip.exr", exr::prelude::Compression::ZIP16, false),
        ("piz.exr", exr::prelude::Compression::PIZ, true),
        ("pxr24.exr", exr::prelude::Compression::PXR24, false),
        ("b44.exr", exr::prelude::Compression::B44, false),
        ("tiles.exr", exr::prelude::Compression::ZIP1, true),
    ] {
        write_exr(&at(name), compression, tiled);
    }
    let frame: Read = |p| read_frame(p).map(drop);
    let layer: Read = |p| {
        exr_contents(p)?;
        read_flow(p)?;
        read_inverse_depth(p, DepthFormat::default())?;
        read_virtual_layer(p).map(drop)
    };
    let depth: Read = |p| read_inverse_depth(p, DepthFormat::default()).map(drop);
    let mut samples = Vec::new();
    for entry in fs::read_dir(dir.path()).unwrap() {
        let path = entry.unwrap().path();
        let name: &'static str =
            Box::leak(path.file_name().unwrap().to_str().unwrap().to_owned().into_boxed_str());
        let read: Read = match name.rsplit_once('.').unwrap() {
            ("frame", _) => frame,
            ("depth", _) => depth,
            ("flow", _) => |p| read_flow(p).map(drop),
            ("camera", _) => |p| read_camera(p).map(drop),
            _ => layer,
        };
        read(&path).unwrap();
        samples.push((name, fs::read(&path).unwrap(), read));
    }
    assert_eq!(samples.len(), 17);
    samples.sort_by_key(|s| s.0);
    samples
}

fn write_exr(path: &Path, compression: exr::prelude::Compression, tiled: bool) {
    use exr::prelude::*;
    let size = (21, 34);
    let channel = |name: &str, scale: f32| {
        let values = (0..21 * 34).map(|i| f16::from_f32(scale * (1.0 + (i % 21) as f32))).collect();
        AnyChannel::new(name, FlatSamples::F16(values))
    };
    let channels = ["R", "G", "B", "A", "Z", "forward.u", "forward.v"];
    let channels = AnyChannels::sort(channels.iter().map(|c| channel(c, 0.04)).collect());
    let blocks = if tiled { Blocks::Tiles(Vec2(16, 16)) } else { Blocks::ScanLines };
    let encoding = Encoding {
        compression,
        blocks,
        line_order: if tiled { LineOrder::Unspecified } else { LineOrder::Increasing },
    };
    let layer = Layer::new(size, LayerAttributes::default(), encoding, channels);
    Image::from_layer(layer).write().non_parallel().to_file(path).unwrap();
}

/// Reads `bytes` as a file of this name, and checks and returns the error's text if that fails.
fn read_bytes(dir: &Path, name: &str, bytes: &[u8], read: Read) -> std::result::Result<(), String> {
    let path = dir.join(name);
    fs::write(&path, bytes).unwrap();
    let result = std::panic::catch_unwind(|| read(&path));
    let result = result.map_err(|_| format!("{name}: the reader panicked")).unwrap();
    result.map_err(|e| {
        let text = e.to_string();
        assert!(text.starts_with(&format!("{}: ", path.display())), "{text}");
        assert!(!text.contains('\n') && !e.sentence().ends_with('.'), "{text}");
        text
    })
}

#[test]
fn files_that_are_cut_short() {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes, read) in samples() {
        let mut refused = 0;
        for i in 0..40 {
            let cut = &bytes[..bytes.len() * i / 40];
            refused += usize::from(read_bytes(dir.path(), name, cut, read).is_err());
        }
        assert_eq!(refused, 40, "{name}");
    }
}

#[test]
fn files_of_another_kind() {
    let dir = tempfile::tempdir().unwrap();
    let samples = samples();
    for (name, _, read) in &samples {
        for bytes in
            [&b""[..], b"P", b"{}", b"hello, world", &[0; 4096], &[255; 4096], b"PIEH\xff\xff\xff\xff"]
        {
            let e = read_bytes(dir.path(), name, bytes, *read).unwrap_err();
            assert!(e.len() < 400, "{e}");
        }
    }
    let huge = [b"PIEH".as_slice(), &60_000i32.to_le_bytes(), &60_000i32.to_le_bytes()].concat();
    let read: Read = |p| read_flow(p).map(drop);
    let e = read_bytes(dir.path(), "a.flo", &huge, read).unwrap_err();
    assert!(e.contains("too large") && e.contains("60000"), "{e}");
    let read: Read = |p| read_frame(p).map(drop);
    for head in ["P6\n60000 60000\n255\n", "P6\n16384 16384\n255\n"] {
        let e = read_bytes(dir.path(), "a.ppm", head.as_bytes(), read).unwrap_err();
        assert!(e.contains("too large"), "{e}");
    }
    let e = read_bytes(dir.path(), "a.ppm", b"P6\n0 4\n255\n", read).unwrap_err();
    assert!(e.contains("a.ppm"), "{e}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn files_with_wrong_bytes(
        changes in prop::collection::vec((any::<prop::sample::Index>(), 1u8..=255), 1..4),
        // Half of the cases change only the head, which is small and where most faults are.
        in_head in any::<bool>(),
    ) {
        thread_local!(static SAMPLES: Vec<(&'static str, Vec<u8>, Read)> = samples());
        let dir = tempfile::tempdir().unwrap();
        SAMPLES.with(|samples| {
            for (name, bytes, read) in samples {
                let mut bytes = bytes.clone();
                let end = if in_head { bytes.len().min(400) } else { bytes.len() };
                for (at, mask) in &changes {
                    bytes[at.index(end)] ^= mask;
                }
                let _ = read_bytes(dir.path(), name, &bytes, *read);
            }
        });
    }
}

#[test]
fn depth_without_any_reading_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, values: [u16; 4]| {
        let path = dir.path().join(name);
        image::ImageBuffer::<image::Luma<u16>, _>::from_raw(2, 2, values.to_vec())
            .unwrap()
            .save(&path)
            .unwrap();
        path
    };
    let format = |values, per_metre| DepthFormat { values, per_metre };
    let some = write("some.png", [0, 500, 2000, 65535]);
    let read = |f| read_inverse_depth(&some, f).unwrap();
    let d = read(format(DepthValues::Metric, 1000.0));
    assert!(d.at(0, 0).is_nan() && (d.at(1, 0) - 2.0).abs() < 1e-6 && (d.at(0, 1) - 0.5).abs() < 1e-6);
    let d = read(format(DepthValues::Inverse, 1000.0));
    assert!(d.at(0, 0) == 0.0 && (d.at(1, 0) - 0.5).abs() < 1e-6);
    let d = read(format(DepthValues::RelativeInverse, 1000.0));
    assert!(d.at(0, 0) == 0.0 && d.at(1, 1) == 1.0);
    let none = write("none.png", [0; 4]);
    let e = read_inverse_depth(&none, DepthFormat::default()).unwrap_err().to_string();
    assert!(e.contains("none.png") && e.contains("no valid reading"), "{e}");
    for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(read_inverse_depth(&some, format(DepthValues::Metric, bad)).is_err());
    }
}

/// Writes one layer with these channels at `position` in a display window of `display` px.
fn write_channels(path: &Path, display: (usize, usize), position: (i32, i32), channels: &[(&str, Plane)]) {
    use exr::prelude::*;
    let size = channels[0].1.size();
    let list =
        channels.iter().map(|(name, plane)| AnyChannel::new(*name, FlatSamples::F32(plane.data().to_vec())));
    let attributes = LayerAttributes {
        layer_position: position.into(),
        layer_name: Some("ViewLayer".into()),
        ..LayerAttributes::default()
    };
    let layer = Layer::new(size, attributes, Encoding::FAST_LOSSLESS, AnyChannels::sort(list.collect()));
    let mut image = Image::from_layer(layer);
    image.attributes.display_window = IntegerBounds::from_dimensions(display);
    image.write().non_parallel().to_file(path).unwrap();
}

#[test]
fn exr_depth_that_is_zero_negative_infinite_or_nan() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("z.exr");
    let z = [0.0, -1.0, f32::INFINITY, f32::NAN, 1e10, 4.0];
    write_channels(&path, (6, 1), (0, 0), &[("Z", Plane::from_vec(6, 1, z.to_vec()).unwrap())]);
    let d = read_inverse_depth(&path, DepthFormat::default()).unwrap();
    assert!(d.data()[..5].iter().all(|v| v.is_nan()) && d.data()[5] == 0.25, "{:?}", d.data());
    let of = |far: f32, last: f32| {
        let z = Plane::from_fn(6, 1, |x, _| if x < 5 { far } else { last });
        write_channels(&path, (6, 1), (0, 0), &[("Z", z)]);
        read_inverse_depth(&path, DepthFormat::default())
    };
    // A renderer's frame without its object.
    assert!(of(f32::INFINITY, 1e10).unwrap().data().iter().all(|d| d.is_nan()));
    for broken in [f32::NAN, 0.0, -1.0] {
        assert!(of(f32::INFINITY, broken).unwrap_err().to_string().contains("z.exr"));
    }
}

#[test]
fn a_few_values_that_are_no_numbers_are_black_and_many_are_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("plate.exr");
    let of = |missing: usize| {
        let plane = Plane::from_fn(5, 2, |x, y| if 5 * y + x < missing { f32::NAN } else { 0.5 });
        write_channels(&path, (5, 2), (0, 0), &["B", "G", "R"].map(|c| (c, plane.clone())));
        read_linear(&path)
    };
    let few = of(5).unwrap();
    assert!(few.0.data()[..5].iter().all(|v| *v == [0.0; 3]) && few.0.at(0, 1) == [0.5; 3]);
    let error = of(6).unwrap_err().to_string();
    assert!(error.contains("plate.exr") && error.contains("NaN"), "{error}");
    // Any channel of a virtual layer may be the one that is broken.
    let path = dir.path().join("layer.exr");
    for broken in ["A", "R"] {
        let of = |missing: usize| {
            let plane = |name| {
                let missing = if name == broken { missing } else { 0 };
                Plane::from_fn(5, 2, |x, y| if 5 * y + x < missing { f32::NAN } else { 0.5 })
            };
            write_channels(&path, (5, 2), (0, 0), &["A", "B", "G", "R"].map(|c| (c, plane(c))));
            read_virtual_layer(&path)
        };
        let channel = if broken == "A" { 3 } else { 0 };
        let read = of(5).unwrap();
        assert_eq!((read.not_numbers, of(0).unwrap().not_numbers), (5, 0));
        let few = read.color.0;
        assert!(few.at(4, 0)[channel] == 0.0 && few.at(4, 0)[1] == 0.5 && few.at(0, 1) == [0.5; 4]);
        let error = of(6).unwrap_err().to_string();
        assert!(error.contains("layer.exr") && error.contains("NaN"), "{error}");
    }
    // Where a layer is transparent, its colour may be anything, and what is seen counts by itself.
    let with_colour = |inside: f32, outside: f32| {
        let beside = |inside, outside| Plane::from_fn(5, 2, |x, _| if x == 0 { inside } else { outside });
        let of = |c| (c, if c == "A" { beside(0.5, 0.0) } else { beside(inside, outside) });
        write_channels(&path, (5, 2), (0, 0), &["A", "B", "G", "R"].map(of));
        read_virtual_layer(&path)
    };
    let read = with_colour(0.5, f32::NAN).unwrap();
    assert_eq!(read.not_numbers, 0);
    let read = read.color.0;
    assert!(read.at(0, 1) == [0.5; 4] && read.at(1, 1) == [0.0; 4]);
    let error = with_colour(f32::NAN, 0.0).unwrap_err().to_string();
    assert!(error.contains("layer.exr") && error.contains("NaN"), "{error}");
}

#[test]
fn blender_s_names_and_data_windows() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("0001.exr");
    let plane = |v: f32| Plane::from_fn(3, 2, |x, y| v + x as f32 + 10.0 * y as f32);
    let channels = [
        ("Combined.A", Plane::filled(3, 2, 0.5)),
        ("Combined.B", plane(3.0)),
        ("Combined.G", plane(2.0)),
        ("Combined.R", plane(1.0)),
        ("DiffCol.B", plane(100.0)),
        ("DiffCol.G", plane(100.0)),
        ("DiffCol.R", plane(100.0)),
        ("Depth.Z", plane(4.0)),
        ("Mist.Z", plane(0.1)),
        ("Normal.X", plane(0.0)),
        ("Normal.Y", plane(0.0)),
        ("Normal.Z", plane(0.0)),
        ("Vector.W", plane(-7.0)),
        ("Vector.X", plane(0.0)),
        ("Vector.Y", plane(0.0)),
        ("Vector.Z", plane(7.0)),
    ];
    // The data window lies partly outside the display window on the left, and inside it below.
    write_channels(&path, (5, 4), (-1, 1), &channels);
    assert_eq!(
        exr_contents(&path).unwrap(),
        ExrContents { colour: true, alpha: true, depth: true, flow: true }
    );
    let layer = read_virtual_layer(&path).unwrap();
    // What lies on the left of the display window is kept as overscan.
    assert_eq!((layer.color.0.size(), layer.overscan.left, layer.overscan.right), ((6, 4), 1, 0));
    assert_eq!(layer.color.0.at(0, 1), [1.0, 2.0, 3.0, 0.5]);
    let color = layer.overscan.frame_of(&layer.color.0);
    assert_eq!(color.size(), (5, 4));
    assert_eq!(color.at(0, 1), [2.0, 3.0, 4.0, 0.5]);
    assert_eq!(color.at(1, 2), [13.0, 14.0, 15.0, 0.5]);
    for (x, y) in [(0, 0), (2, 1), (4, 2), (0, 3)] {
        assert_eq!(color.at(x, y), [0.0; 4], "{x} {y}");
    }
    let depth = layer.overscan.frame_of(&layer.inverse_depth.unwrap());
    assert!(depth.at(0, 1) == 0.2 && depth.at(0, 0).is_nan());
    assert_eq!(layer.overscan.frame_of(&layer.flow.unwrap()).at(0, 1), [-8.0, -6.0]);
    // The data window lies wholly outside the display window, far away.
    write_channels(&path, (5, 4), (i32::MAX / 2 - 10, -5), &channels);
    assert_eq!(read_frame(&path).unwrap(), Encoded(Raster::filled(5, 4, [0.0; 3])));
}

#[test]
fn nothing_half_written_is_left() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.png");
    let full = |_: &Path| Err(std::io::Error::from(std::io::ErrorKind::StorageFull));
    fs::write(&path, "before").unwrap();
    let e = write_atomically(&path, |p| fs::write(p, "half").and_then(|()| full(p))).unwrap_err().to_string();
    assert!(e.contains("a.png: cannot be written"), "{e}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "before");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    write_atomically(&path, |p| fs::write(p, "after")).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "after");
    let frame = Encoded(Raster::from_fn(3, 1, |x, _| [x as f32 / 2.0, f32::NAN, -1.0]));
    write_png(&path, &frame).unwrap();
    assert_eq!(read_frame(&path).unwrap().0.at(1, 0), [128.0 / 255.0, 0.0, 0.0]);
    assert!(write_png(dir.path().join("no/a.png"), &frame).unwrap_err().to_string().contains("no folder"));
    assert!(write_png(dir.path(), &frame).unwrap_err().to_string().contains("folder"));
    let empty = Encoded(Raster::filled(0, 0, [0.0; 3]));
    assert!(write_png(&path, &empty).is_err());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}
