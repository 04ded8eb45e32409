//! Tests that the size in a file's head is checked against the file's length and the budget before memory is taken for it.

use blindaug::{Encoded, Raster};
use blindaug_io::*;
use std::{fs, path::Path};

/// The error of reading these bytes as a file of this name.
fn refused(name: &str, bytes: &[u8], read: fn(&Path) -> Result<()>) -> String {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    fs::write(&path, bytes).unwrap();
    let e = read(&path).expect_err(name).to_string();
    assert!(e.contains(name) && !e.contains('\n'), "{e}");
    e
}

/// The bytes of a small file that `write` writes.
fn written(name: &str, write: impl FnOnce(&Path)) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    write(&dir.path().join(name));
    fs::read(dir.path().join(name)).unwrap()
}

fn at(bytes: &[u8], what: &[u8]) -> usize {
    bytes.windows(what.len()).position(|w| w == what).unwrap()
}

fn small() -> image::RgbImage {
    image::RgbImage::from_fn(16, 16, |x, y| image::Rgb([10 * x as u8, 10 * y as u8, 77]))
}

/// Small files that claim 8192 x 8192 pixels.
fn bombs() -> Vec<(&'static str, Vec<u8>)> {
    const SIDE: u32 = 8192;
    let (big, little) = (SIDE.to_be_bytes(), SIDE.to_le_bytes());
    let mut png = written("a.png", |p| small().save(p).unwrap());
    png[16..20].copy_from_slice(&big);
    png[20..24].copy_from_slice(&big);
    // The checksum of the chunk must be right.
    let mut crc = u32::MAX;
    for byte in &png[12..29] {
        crc ^= u32::from(*byte);
        (0..8).for_each(|_| crc = if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 });
    }
    png[29..33].copy_from_slice(&(!crc).to_be_bytes());
    let mut jpeg = written("a.jpg", |p| small().save(p).unwrap());
    let frame = at(&jpeg, &[0xff, 0xc0]);
    jpeg[frame + 5..frame + 9].copy_from_slice(&[big[2], big[3], big[2], big[3]]);
    let mut bmp = written("a.bmp", |p| small().save(p).unwrap());
    bmp[18..22].copy_from_slice(&little);
    bmp[22..26].copy_from_slice(&little);
    let ppm = [b"P6\n8192 8192\n255\n".as_slice(), &[7; 500]].concat();
    let text = [b"P3\n8192 8192\n255\n".as_slice(), b"1 2 3 ".repeat(50).as_slice()].concat();
    vec![("a.png", png), ("a.jpg", jpeg), ("a.bmp", bmp), ("a.ppm", ppm), ("b.ppm", text)]
}

#[test]
fn a_small_file_that_claims_a_huge_image_is_refused_by_its_length() {
    for (name, bytes) in bombs() {
        let readers: [fn(&Path) -> Result<()>; 2] =
            [|p| read_frame(p).map(drop), |p| read_linear(p).map(drop)];
        for read in readers {
            let e = refused(name, &bytes, read);
            assert!(e.contains("8192 x 8192 pixels, which take"), "{e}");
        }
        let e = refused(name, &bytes, |p| FrameSource::open(p, FrameRange::default()).map(drop));
        assert!(e.contains("8192 x 8192 pixels, which take"), "{e}");
    }
    let pgm = b"P5\n8192 8192\n65535\n0123456789";
    let e = refused("a.pgm", pgm, |p| read_inverse_depth(p, DepthFormat::default()).map(drop));
    assert!(e.contains("take 134217728 bytes at least"), "{e}");
    let flo = [b"PIEH".as_slice(), &8192i32.to_le_bytes(), &8192i32.to_le_bytes(), &[0; 80]].concat();
    let e = refused("a.flo", &flo, |p| read_flow(p).map(drop));
    assert!(e.contains("8192 x 8192 pixels of flow take 536870924"), "{e}");
}

#[test]
fn a_tiff_that_claims_a_huge_image_is_refused() {
    let mut tiff = written("a.tif", |p| small().save(p).unwrap());
    for tag in [256u16, 257] {
        // A tag is followed by its type, LONG (4) or SHORT (3), and one value.
        let entry = [tag.to_le_bytes().as_slice(), &[4, 0, 1, 0, 0, 0, 16, 0, 0, 0]].concat();
        let short = [tag.to_le_bytes().as_slice(), &[3, 0, 1, 0, 0, 0, 16, 0, 0, 0]].concat();
        let place = tiff.windows(12).position(|w| w == entry || w == short).unwrap();
        tiff[place + 8..place + 10].copy_from_slice(&8192u16.to_le_bytes());
    }
    let e = refused("a.tif", &tiff, |p| read_frame(p).map(drop));
    assert!(e.contains("8192 x 8192 pixels, which take"), "{e}");
}

fn exr(path: &Path, size: (usize, usize)) {
    use exr::prelude::*;
    let channel = |name: &str| {
        AnyChannel::new(name, FlatSamples::F32((0..size.0 * size.1).map(|i| 1.0 + (i % 9) as f32).collect()))
    };
    let names = ["R", "G", "B", "A", "Z", "forward.u", "forward.v"];
    let channels = AnyChannels::sort(names.iter().map(|n| channel(n)).collect());
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let layer = Layer::new(size, LayerAttributes::default(), encoding, channels);
    Image::from_layer(layer).write().non_parallel().to_file(path).unwrap();
}

#[test]
fn an_exr_that_claims_a_huge_image_is_refused() {
    let mut bytes = written("a.exr", |p| exr(p, (16, 16)));
    for window in ["dataWindow\0box2i\0", "displayWindow\0box2i\0"] {
        let place = at(&bytes, window.as_bytes()) + window.len() + 4;
        bytes[place + 8..place + 12].copy_from_slice(&8191i32.to_le_bytes());
        bytes[place + 12..place + 16].copy_from_slice(&8191i32.to_le_bytes());
    }
    // The number of chunks of 16 rows that 8192 rows take.
    let chunks = "chunkCount\0int\0";
    let place = at(&bytes, chunks.as_bytes()) + chunks.len() + 4;
    bytes[place..place + 4].copy_from_slice(&512i32.to_le_bytes());
    let readers: [fn(&Path) -> Result<()>; 4] = [
        |p| read_frame(p).map(drop),
        |p| read_virtual_layer(p).map(drop),
        |p| read_flow(p).map(drop),
        |p| read_inverse_depth(p, DepthFormat::default()).map(drop),
    ];
    for read in readers {
        let e = refused("a.exr", &bytes, read);
        assert!(e.contains("8192 x 8192 pixels, which take"), "{e}");
    }
}

#[test]
fn a_flat_image_compresses_as_far_as_it_can_and_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let flat = image::RgbImage::from_pixel(2048, 1024, image::Rgb([90, 120, 30]));
    for name in ["flat.png", "flat.jpg", "flat.tif", "flat.bmp", "flat.ppm"] {
        let path = dir.path().join(name);
        flat.save(&path).unwrap();
        assert_eq!(read_frame(&path).unwrap().0.size(), (2048, 1024), "{name}");
    }
    let bits = [b"P4\n2048 1024\n".as_slice(), &[0x55; 2048 * 1024 / 8]].concat();
    fs::write(dir.path().join("bits.pbm"), bits).unwrap();
    assert_eq!(read_frame(dir.path().join("bits.pbm")).unwrap().0.size(), (2048, 1024));
}

// The budget that this test sets is enough for the other tests of this file, which may run at the same time.
#[test]
fn what_does_not_fit_into_the_budget_is_refused_before_it_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let (w, h) = (9000, 3500);
    // Only the file's head is read: a frame of this size takes 378 MB.
    let ppm = [format!("P6\n{w} {h}\n255\n").into_bytes(), vec![9; 3 * w * h]].concat();
    fs::write(d.join("a.ppm"), ppm).unwrap();
    write_flo(d.join("a.flo"), &Raster::filled(w, h, [1.0, 2.0])).unwrap();
    exr(&d.join("a.exr"), (3600, 2000));
    memory::set_budget(300_000_000);
    let say = |result: Result<()>, what: &str| {
        let e = result.unwrap_err().to_string();
        assert!(e.contains(what) && e.contains("and the budget is 300 MB: raise it"), "{e}");
    };
    say(
        read_frame(d.join("a.ppm")).map(drop),
        "a.ppm: an image of 9000 x 3500 pixels takes 378 MB of memory",
    );
    say(FrameSource::open(d.join("a.ppm"), FrameRange::default()).map(drop), "a.ppm");
    say(read_flow(d.join("a.flo")).map(drop), "a.flo");
    say(read_virtual_layer(d.join("a.exr")).map(drop), "a.exr: an image of 3600 x 2000 pixels takes 436 MB");
    memory::set_budget(0);
    assert_eq!(read_frame(d.join("a.ppm")).unwrap().0.size(), (w, h));
    // A picture written a few rows at a time gives the same file as one written at once.
    let frame = Encoded(Raster::from_fn(301, 97, |x, y| [x as f32 / 301.0, y as f32 / 97.0, 0.3]));
    write_png(d.join("whole.png"), &frame).unwrap();
    let mut png = PngWriter::create(d.join("rows.png"), (301, 97)).unwrap();
    frame.0.data().chunks(301 * 7).for_each(|rows| png.write(rows).unwrap());
    png.finish().unwrap();
    assert!(fs::read(d.join("whole.png")).unwrap() == fs::read(d.join("rows.png")).unwrap());
    // A file that is not completed leaves nothing behind.
    let mut png = PngWriter::create(d.join("half.png"), (301, 97)).unwrap();
    png.write(&frame.0.data()[..5000]).unwrap();
    assert!(png.finish().is_err());
    drop(PngWriter::create(d.join("none.png"), (301, 97)).unwrap());
    assert!(fs::read_dir(d).unwrap().all(|f| {
        let name = f.unwrap().file_name().into_string().unwrap();
        !name.contains("half") && !name.contains("none")
    }));
}
