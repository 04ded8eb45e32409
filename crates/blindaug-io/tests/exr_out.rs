//! EXR files that are written, read with the exr crate itself.

use blindaug::{
    Encoded, Overscan, Plane, Premultiplied, Raster, colour_space::ColourSpace, composite::DistortedLayer,
};
use blindaug_io::{
    Coding, ExrHead, FileKind, FrameFormat, FrameRange, FrameSource, read_virtual_layer,
    write_distorted_layer,
};
use exr::prelude::*;

/// A channel's name, and its values by place.
type Channel = (&'static str, fn(i32, i32) -> f32);

/// The values of all channels of a file, by name.
fn channels(path: &std::path::Path) -> Vec<(String, Vec<f32>)> {
    let image = read_first_flat_layer_from_file(path).unwrap();
    let list = image.layer_data.channel_data.list.iter();
    list.map(|c| (c.name.to_string(), c.sample_data.values_as_f32().collect())).collect()
}

#[test]
fn the_head_of_a_frame_goes_on_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let size = Vec2(6, 4);
    let values = |v: f32| FlatSamples::F32(vec![v; 24]);
    let list = ["R", "G", "B"].map(|name| AnyChannel::new(name, values(0.5)));
    let mut attributes = ImageAttributes::new(IntegerBounds::new((10, 20), size));
    attributes.pixel_aspect = 2.0;
    attributes.time_code = Some(exr::meta::attribute::TimeCode::from_tv60_time(0x0123_4567, 0));
    attributes.chromaticities = Some(exr::meta::attribute::Chromaticities {
        red: Vec2(0.713, 0.293),
        green: Vec2(0.165, 0.83),
        blue: Vec2(0.128, 0.044),
        white: Vec2(0.32168, 0.33767),
    });
    let own = LayerAttributes {
        owner: Some("a studio".into()),
        layer_position: Vec2(10, 20),
        frames_per_second: Some((24000, 1001)),
        ..LayerAttributes::default()
    };
    let layer = Layer::new(size, own, Encoding::UNCOMPRESSED, AnyChannels::sort(list.into_iter().collect()));
    Image::new(attributes.clone(), layer).write().to_file(at("in.exr")).unwrap();

    let head = ExrHead::read(at("in.exr")).unwrap();
    assert_eq!(head.pixel_aspect(), 2.0);
    let aspect = |name: &str| FrameSource::open(at(name), FrameRange::default()).unwrap().pixel_aspect();
    assert_eq!(aspect("in.exr"), Some(2.0));
    let rate = |name: &str| FrameSource::open(at(name), FrameRange::default()).unwrap().fps();
    assert_eq!(rate("in.exr"), Some(24000.0 / 1001.0));
    let frame = Encoded(Raster::filled(6, 4, [0.5; 3]));
    let acescg: ColourSpace = "acescg".parse().unwrap();
    let in_acescg = Coding::new(acescg, acescg);
    let float = FrameFormat::PNG8.with(Some(FileKind::Exr), Some(32)).unwrap();
    float.write(&at("out.exr"), &frame, None, Some(&head), &in_acescg).unwrap();
    float.write(&at("plain.exr"), &frame, None, None, &Coding::default()).unwrap();
    let read = |name| read_first_flat_layer_from_file(at(name)).unwrap();
    let out = read("out.exr");
    assert_eq!(out.attributes, attributes);
    assert_eq!(out.layer_data.attributes.owner, Some("a studio".into()));
    assert_eq!(out.layer_data.attributes.layer_position, Vec2(10, 20));
    assert_ne!(read("plain.exr").attributes, attributes);
    assert_eq!((aspect("plain.exr"), rate("plain.exr")), (Some(1.0), None));
    // Images of other kinds say nothing, and an aspect that cannot be counts as none.
    let png = FrameFormat::PNG8;
    png.write(&at("plain.png"), &frame, None, None, &Coding::default()).unwrap();
    assert_eq!(aspect("plain.png"), None);
    attributes.pixel_aspect = 0.001;
    let list = ["R", "G", "B"].map(|name| AnyChannel::new(name, values(0.5)));
    let layer = Layer::new(
        size,
        LayerAttributes::default(),
        Encoding::UNCOMPRESSED,
        AnyChannels::sort(list.into_iter().collect()),
    );
    Image::new(attributes, layer).write().to_file(at("thin.exr")).unwrap();
    assert_eq!(aspect("thin.exr"), Some(1.0));
}

#[test]
fn a_distorted_layer_has_all_its_channels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("1.exr");
    let layer = DistortedLayer {
        color: Premultiplied(Raster::filled(5, 3, [0.25, -0.125, 2.0, 0.5])),
        noise: Raster::filled(5, 3, [0.01, -0.02, 0.03]),
        holdout: Plane::filled(5, 3, 0.75),
        inverse_depth: Plane::from_fn(5, 3, |x, _| if x == 0 { f32::NAN } else { 0.3 }),
        flow: Raster::filled(5, 3, [1.5, -2.5]),
        overscan: Overscan::default(),
    };
    write_distorted_layer(&path, &layer, 16, None, &Coding::default()).unwrap();
    let found = channels(&path);
    let of = |name: &str| &found.iter().find(|c| c.0 == name).unwrap_or_else(|| panic!("{name}")).1;
    for (name, value) in [
        ("R", 0.25),
        ("G", -0.125),
        ("B", 2.0),
        ("A", 0.5),
        ("noise.G", -0.02),
        ("holdout.A", 0.75),
        ("forward.u", 1.5),
        ("forward.v", -2.5),
        ("Z", 1.0 / 0.3),
    ] {
        assert!((of(name)[1] - value).abs() < 1e-5 * value.abs().max(1.0), "{name}: {}", of(name)[1]);
    }
    assert_eq!((found.len(), of("Z")[0]), (11, 1e10));
    // It can be read as a virtual layer again, whose light is not below 0.
    let again = read_virtual_layer(&path).unwrap();
    assert_eq!(again.color.0.at(1, 1), [0.25, 0.0, 2.0, 0.5]);
    assert!(again.inverse_depth.unwrap().at(0, 0).is_nan());
}

/// Writes an EXR file with these channels as floats, whose display window of 6 x 4 px begins at (10, 20) and whose data window begins and ends
/// elsewhere.
fn write_displaced(path: &std::path::Path, at: [i32; 2], size: [usize; 2], channels: &[Channel]) {
    let [w, h] = size;
    let list = channels.iter().map(|(name, value)| {
        let of = |i: usize| value(at[0] + (i % w) as i32, at[1] + (i / w) as i32);
        AnyChannel::new(*name, FlatSamples::F32((0..w * h).map(of).collect()))
    });
    let attributes = ImageAttributes::new(IntegerBounds::new((10, 20), (6, 4)));
    let own = LayerAttributes { layer_position: Vec2(at[0], at[1]), ..LayerAttributes::default() };
    let layer = Layer::new(Vec2(w, h), own, Encoding::SMALL_LOSSLESS, AnyChannels::sort(list.collect()));
    Image::new(attributes, layer).write().to_file(path).unwrap();
}

/// A value that tells the pixel.
fn told(x: i32, y: i32) -> f32 {
    0.01 * x as f32 + y as f32
}

#[test]
fn a_layer_keeps_what_lies_beyond_the_display_window() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("1.exr");
    let channels: &[Channel] = &[
        ("R", told),
        ("G", told),
        ("B", told),
        ("A", |_, _| 0.5),
        ("Z", told),
        ("forward.u", told),
        ("forward.v", told),
    ];
    for (at, size, overscan) in [
        ([8, 17], [11, 9], Overscan { left: 2, top: 3, right: 3, bottom: 2 }),
        // The data begin inside of the display window and end outside.
        ([12, 22], [9, 5], Overscan { left: 0, top: 0, right: 5, bottom: 3 }),
        // They lie beside it.
        ([1, 20], [3, 4], Overscan { left: 9, top: 0, right: 0, bottom: 0 }),
        ([11, 21], [2, 2], Overscan::default()),
    ] {
        write_displaced(&path, at, size, channels);
        let layer = read_virtual_layer(&path).unwrap();
        assert_eq!((layer.overscan, layer.color.0.size()), (overscan, overscan.picture_of((6, 4))), "{at:?}");
        let [depth, flow] = [layer.inverse_depth.clone().unwrap(), layer.flow.clone().unwrap().map(|v| v[0])];
        for y in 0..layer.color.0.height() {
            for x in 0..layer.color.0.width() {
                let (px, py) = (x as i32 + 10 - overscan.left as i32, y as i32 + 20 - overscan.top as i32);
                let inside = (at[0]..at[0] + size[0] as i32).contains(&px)
                    && (at[1]..at[1] + size[1] as i32).contains(&py);
                let want = if inside { told(px, py) } else { 0.0 };
                assert_eq!(layer.color.0.at(x, y)[0], want, "{at:?} {px} {py}");
                assert_eq!(flow.at(x, y), want);
                assert_eq!((1.0 / depth.at(x, y) - want).abs() < 1e-4, inside);
            }
        }
        // The layer that is written has the same data window, and is read as the same again.
        let distorted = DistortedLayer {
            color: layer.color.clone(),
            noise: Raster::filled(layer.color.0.width(), layer.color.0.height(), [0.0; 3]),
            holdout: Plane::filled(layer.color.0.width(), layer.color.0.height(), 1.0),
            inverse_depth: depth,
            flow: layer.flow.clone().unwrap(),
            overscan,
        };
        let head = ExrHead::read(&path).unwrap();
        let out = folder.path().join("out.exr");
        write_distorted_layer(&out, &distorted, 32, Some(&head), &Coding::default()).unwrap();
        let read = read_first_flat_layer_from_file(&out).unwrap();
        assert_eq!(read.attributes.display_window, IntegerBounds::new((10, 20), (6, 4)));
        let corner = Vec2(10 - overscan.left as i32, 20 - overscan.top as i32);
        assert_eq!(read.layer_data.attributes.layer_position, corner);
        let again = read_virtual_layer(&out).unwrap();
        assert_eq!((again.overscan, again.color, again.flow), (overscan, layer.color, layer.flow));
    }
    // A data window so far away that it would take all memory is an error.
    write_displaced(&path, [2_000_000, 20], [3, 4], channels);
    let e = read_virtual_layer(&path).unwrap_err().to_string();
    assert!(e.contains("too large"), "{e}");
}

#[test]
fn what_a_plate_has_beyond_its_display_window_goes_on_untouched() {
    let folder = tempfile::tempdir().unwrap();
    let [from, to] = ["in.exr", "out.exr"].map(|name| folder.path().join(name));
    write_displaced(&from, [7, 19], [12, 9], &[("R", told), ("G", |x, _| -0.1 * x as f32), ("B", told)]);
    let source = FrameSource::open(&from, FrameRange::default()).unwrap();
    assert_eq!(source.size(), (6, 4));
    let head = source.heads_with_overscan()(1).unwrap();
    let frame = Encoded(Raster::filled(6, 4, [0.5; 3]));
    let coding = Coding::new(source.space(), source.file_space());
    let float = FrameFormat::PNG8.with(Some(FileKind::Exr), Some(32)).unwrap();
    float.write(&to, &frame, None, Some(&head), &coding).unwrap();
    let read = |path| read_first_flat_layer_from_file(path).unwrap();
    let [before, after] = [&from, &to].map(read);
    assert_eq!(after.attributes.display_window, before.attributes.display_window);
    assert_eq!(after.layer_data.attributes.layer_position, before.layer_data.attributes.layer_position);
    assert_eq!(after.layer_data.size, before.layer_data.size);
    let [before, after] = [&from, &to].map(|p| channels(p));
    let light = blindaug::Transfer::Srgb.decode(0.5);
    for ((name, old), (_, new)) in before.iter().zip(&after) {
        for (i, (old, new)) in old.iter().zip(new).enumerate() {
            let (x, y) = (7 + i % 12, 19 + i / 12);
            let framed = (10..16).contains(&x) && (20..24).contains(&y);
            assert_eq!(*new, if framed { light } else { *old }, "{name} {x} {y}");
        }
    }
    // Into another space it is brought as the frame is.
    let acescg: ColourSpace = "acescg".parse().unwrap();
    float.write(&to, &frame, None, Some(&head), &Coding::new(source.space(), acescg)).unwrap();
    let [r, old] = [&channels(&to)[2].1, &before[2].1];
    assert!(r[0] != old[0] && r[0].is_finite());
    // Negative control: a head alone has nothing beyond.
    float.write(&to, &frame, None, Some(&ExrHead::read(&from).unwrap()), &coding).unwrap();
    assert_eq!(read(&to).layer_data.size, Vec2(6, 4));
}
