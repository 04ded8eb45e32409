//! EXR files that are written, read with the exr crate itself.

use blindaug::{Encoded, Plane, Premultiplied, Raster, colour_space::ColourSpace, composite::DistortedLayer};
use blindaug_io::{
    Coding, ExrHead, FileKind, FrameFormat, FrameRange, FrameSource, read_virtual_layer,
    write_distorted_layer,
};
use exr::prelude::*;

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
        ..LayerAttributes::default()
    };
    let layer = Layer::new(size, own, Encoding::UNCOMPRESSED, AnyChannels::sort(list.into_iter().collect()));
    Image::new(attributes.clone(), layer).write().to_file(at("in.exr")).unwrap();

    let head = ExrHead::read(at("in.exr")).unwrap();
    assert_eq!(head.pixel_aspect(), 2.0);
    let aspect = |name: &str| FrameSource::open(at(name), FrameRange::default()).unwrap().pixel_aspect();
    assert_eq!(aspect("in.exr"), Some(2.0));
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
    assert_eq!(aspect("plain.exr"), Some(1.0));
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
