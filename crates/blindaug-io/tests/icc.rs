//! ICC profiles of images, beside littlecms' numbers, which `tools/icc_reference.py` wrote.

use blindaug::{
    Encoded, Transfer,
    colour_space::{ColourSpace, Primaries, conversion, converted},
};
use blindaug_io::{Coding, FileKind, FrameFormat, FrameRange, FrameSource, IccProfile};
use image::{
    ExtendedColorType, ImageEncoder,
    codecs::{jpeg::JpegEncoder, png::PngEncoder, tiff::TiffEncoder},
};
use std::path::{Path, PathBuf};

const REFERENCE: &str = include_str!("icc/reference.csv");

fn icc(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/icc/{name}.icc"))
}

/// The colour space of a profile.
fn told(path: &Path) -> blindaug_io::Result<ColourSpace> {
    IccProfile::read(path)?.space(path)
}

/// Writes an image of one row, with a profile, by the encoder for its extension.
fn write(path: &Path, pixels: &[u8], profile: &[u8]) {
    let mut file = std::io::Cursor::new(Vec::new());
    let width = pixels.len() as u32 / 3;
    match path.extension().unwrap().to_str().unwrap() {
        "png" => encode(PngEncoder::new(&mut file), pixels, width, profile),
        "tif" => encode(TiffEncoder::new(&mut file), pixels, width, profile),
        _ => encode(JpegEncoder::new_with_quality(&mut file, 100), pixels, width, profile),
    }
    std::fs::write(path, file.into_inner()).unwrap();
}

fn encode(mut encoder: impl ImageEncoder, pixels: &[u8], width: u32, profile: &[u8]) {
    encoder.set_icc_profile(profile.to_vec()).unwrap();
    encoder.write_image(pixels, width, 1, ExtendedColorType::Rgb8).unwrap();
}

fn open(path: &Path) -> FrameSource {
    FrameSource::open(path, FrameRange::default()).unwrap()
}

fn read(source: &FrameSource) -> blindaug_io::Result<Encoded> {
    source.frames().next().unwrap().map(|frame| frame.image)
}

/// A frame's colours in sRGB, 0 to 255.
fn in_srgb(source: &FrameSource) -> Vec<[f32; 3]> {
    let (space, Encoded(image)) = (source.space(), read(source).unwrap());
    let matrix = conversion(space.primaries, Primaries::REC709);
    let light = image.map(|p| p.map(|v| space.transfer.decode(v)));
    let light = light.map(|p| matrix.map_or(p, |m| converted(&m, p)));
    light.data().iter().map(|p| p.map(|v| 255.0 * Transfer::Srgb.encode(v).clamp(0.0, 1.0))).collect()
}

#[test]
fn images_are_the_colours_that_littlecms_makes_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut names: Vec<&str> = REFERENCE.lines().skip(1).map(|l| l.split(',').next().unwrap()).collect();
    names.dedup();
    assert_eq!(names.len(), 7);
    for name in names {
        let rows: Vec<Vec<u8>> = REFERENCE
            .lines()
            .filter_map(|l| l.strip_prefix(name)?.strip_prefix(','))
            .map(|l| l.split(',').map(|v| v.parse().unwrap()).collect())
            .collect();
        let pixels: Vec<u8> = rows.iter().flat_map(|r| r[..3].to_vec()).collect();
        let profile = std::fs::read(icc(name)).unwrap();
        let worst = |source: &FrameSource| {
            let ours = in_srgb(source);
            let pairs = ours.iter().zip(&rows).flat_map(|(o, r)| o.iter().zip(&r[3..]));
            pairs.map(|(o, t)| (o - f32::from(*t)).abs()).fold(0.0, f32::max)
        };
        for extension in ["png", "tif"] {
            let path = folder.path().join(format!("{name}.{extension}"));
            write(&path, &pixels, &profile);
            let source = open(&path);
            // Their numbers are rounded to whole ones, and computed with 15 bits.
            assert!(worst(&source) < 1.1, "{name}: {}", worst(&source));
            // Negative control: taken for sRGB, the colours of the other spaces are others.
            let as_srgb = worst(&open(&path).in_space(ColourSpace::SRGB));
            assert_eq!(as_srgb > 4.0, !name.starts_with("srgb"), "{name}: {as_srgb}");
            assert_eq!(told(&icc(name)).unwrap(), source.file_space());
        }
        // JPEG rounds colours, but has the same profile.
        let path = folder.path().join(format!("{name}.jpg"));
        write(&path, &pixels, &profile);
        assert_eq!(open(&path).file_space(), told(&icc(name)).unwrap());
    }
    for (icc_of, space) in
        [("srgb", "srgb"), ("srgb-table", "srgb"), ("linear", "linear-srgb"), ("display-p3", "display-p3")]
    {
        assert_eq!(told(&icc(icc_of)).unwrap(), space.parse().unwrap());
    }
    for name in ["adobe-rgb", "prophoto"] {
        assert_eq!(told(&icc(name)).unwrap(), name.parse().unwrap());
    }
}

#[test]
fn what_is_written_has_the_same_profile_again() {
    let folder = tempfile::tempdir().unwrap();
    let from = folder.path().join("1.png");
    let profile = std::fs::read(icc("adobe-rgb")).unwrap();
    write(&from, &[10, 200, 30, 90, 80, 70], &profile);
    let source = open(&from);
    assert_eq!(source.profile().unwrap().name(), "Adobe RGB (1998)");
    let frame = read(&source).unwrap();
    let plain = Coding::new(source.space(), source.file_space());
    let coding = plain.clone().with_profile(source.profile().cloned());
    for (kind, bits) in [(FileKind::Png, 8), (FileKind::Png, 16), (FileKind::Tiff, 8), (FileKind::Tiff, 16)] {
        let path = folder.path().join(format!("{bits}.{}", kind.extension()));
        let format = FrameFormat::PNG8.with(Some(kind), Some(bits)).unwrap();
        format.write(&path, &frame, None, None, &coding).unwrap();
        let again = open(&path);
        assert_eq!(again.profile().unwrap().bytes(), profile, "{kind:?} {bits}");
        assert_eq!((again.file_space(), read(&again).unwrap()), (source.file_space(), frame.clone()));
        // Negative control: without it the file is taken for sRGB.
        format.write(&path, &frame, None, None, &plain).unwrap();
        assert_eq!(open(&path).file_space(), ColourSpace::SRGB);
    }
}

#[test]
fn a_profile_that_cannot_be_believed_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("1.png");
    let fails = |profile: &[u8], says: &str| {
        write(&path, &[10, 200, 30, 90, 80, 70], profile);
        let e = read(&open(&path)).unwrap_err().to_string();
        assert!(e.contains(says) && e.contains("1.png") && e.contains("colour space"), "{e}");
        assert!(!e.contains('\n'), "{e}");
        // What is said counts more.
        let said = open(&path).in_space(ColourSpace::SRGB);
        assert!((read(&said).unwrap().0.at(0, 0)[1] - 200.0 / 255.0).abs() < 1e-6);
    };
    fails(&std::fs::read(icc("gamma-1.4")).unwrap(), "A power of 1.4) has a curve");
    fails(&std::fs::read(icc("table")).unwrap(), "by a table");
    fails(&std::fs::read(icc("cmyk")).unwrap(), "CMYK");
    let whole = std::fs::read(icc("display-p3")).unwrap();
    for length in (1..whole.len()).step_by(7) {
        fails(&whole[..length], "damaged or cut short");
    }
    // Broken bytes give a space or a sentence, and no panic.
    for at in 0..whole.len() {
        let mut broken = whole.clone();
        broken[at] ^= 0xff;
        write(&path, &[10, 200, 30, 90, 80, 70], &broken);
        if let Err(e) = read(&open(&path)) {
            assert!(e.to_string().contains("ICC profile"), "{at}: {e}");
        }
    }
    let missing = told(&folder.path().join("none.icc")).unwrap_err().to_string();
    assert!(missing.contains("no such file"), "{missing}");
    std::fs::write(folder.path().join("text.icc"), "no profile").unwrap();
    assert!(told(&folder.path().join("text.icc")).unwrap_err().to_string().contains("damaged"));
}
