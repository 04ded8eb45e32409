//! Tests of folders of frames and of side folders.

use blindaug::{Encoded, Raster};
use blindaug_io::*;
use std::{fs, path::Path};
use tempfile::TempDir;

fn frame(width: usize, height: usize, value: f32) -> Encoded {
    Encoded(Raster::filled(width, height, [value, 0.5, 1.0]))
}

/// A folder with a frame of each of these names.
fn folder(names: &[&str]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (i, name) in names.iter().enumerate() {
        write_png(dir.path().join(name), &frame(4, 3, i as f32 / 100.0)).unwrap();
    }
    dir
}

fn all() -> FrameRange {
    FrameRange::default()
}

fn numbers(source: &FrameSource) -> Vec<u64> {
    source.frames().map(|f| f.unwrap().number).collect()
}

#[test]
fn frames_come_in_the_order_of_their_numbers() {
    let dir = folder(&["b10.png", "a9.png", "c_2_11.png", ".hidden12.png"]);
    fs::write(dir.path().join("notes7.txt"), "no image").unwrap();
    fs::create_dir(dir.path().join("13.png")).unwrap();
    let source = FrameSource::open(dir.path(), all()).unwrap();
    assert_eq!(numbers(&source), [9, 10, 11]);
    assert_eq!((source.size(), source.len_hint(), source.fps()), ((4, 3), Some(3), None));
    assert!(source.notes().is_empty(), "{:?}", source.notes());
    let first = source.frames().next().unwrap().unwrap();
    assert_eq!(first.image.0.at(0, 0)[0], (0.01f32 * 255.0).round() / 255.0);
    // A second pass over some of the frames does not read the other frames' files.
    fs::write(dir.path().join("b10.png"), "broken").unwrap();
    let some: Vec<u64> = source.frames_if(|n| n != 10).map(|f| f.unwrap().number).collect();
    assert_eq!(some, [9, 11]);
    let results: Vec<_> = source.frames().collect();
    assert!(results.len() == 2 && results[1].as_ref().unwrap_err().to_string().contains("b10.png"));
}

#[test]
fn gaps_and_files_without_number_are_told() {
    let dir = folder(&["1.png", "2.png", "6.png", "8.png", "poster.png"]);
    let source = FrameSource::open(dir.path(), all()).unwrap();
    assert_eq!(source.notes().len(), 2);
    assert!(source.notes()[0].contains("poster.png"));
    assert_eq!(source.notes()[1], "frames 3 to 5, 7 are missing");
}

#[test]
fn ranges_select_by_number() {
    let dir = folder(&["1.png", "2.png", "3.png", "7.png"]);
    let open = |text: &str| FrameSource::open(dir.path(), text.parse().unwrap());
    assert_eq!(numbers(&open("2..3").unwrap()), [2, 3]);
    assert_eq!(numbers(&open("..2").unwrap()), [1, 2]);
    assert_eq!(numbers(&open("3..").unwrap()), [3, 7]);
    assert!(open("2..3").unwrap().notes().is_empty());
    let e = open("4..6").unwrap_err().to_string();
    assert!(e.contains("4..6") && e.contains("1 to 7"), "{e}");
}

#[test]
fn the_frames_beside_a_range_are_given_to_whoever_asks() {
    let dir = folder(&["1.png", "2.png", "3.png", "7.png"]);
    let beside = |text: &str, wanted: fn(u64) -> bool| -> Vec<u64> {
        let source = FrameSource::open(dir.path(), text.parse().unwrap()).unwrap();
        source.frames_and_beside(wanted).map(|f| f.unwrap().number).collect()
    };
    assert_eq!(beside("2..2", |_| true), [1, 2, 3]);
    assert_eq!(beside("..2", |_| true), [1, 2, 3]);
    assert_eq!(beside("3..", |_| true), [2, 3, 7]);
    assert_eq!(beside("3..4", |n| n != 2), [3, 7]);
    assert_eq!(beside("..", |_| true), [1, 2, 3, 7]);
    // They are not the source's own.
    let source = FrameSource::open(dir.path(), "2..2".parse().unwrap()).unwrap();
    assert_eq!((numbers(&source), source.len_hint(), source.first_number()), (vec![2], Some(1), 2));
    assert!(source.contains(2) && !source.contains(3));
}

#[test]
fn one_image_is_a_clip_of_one_frame() {
    let dir = folder(&["portrait.png"]);
    for path in [dir.path().join("portrait.png"), dir.path().into()] {
        let source = FrameSource::open(path, all()).unwrap();
        assert_eq!(numbers(&source), [1]);
    }
    assert!(FrameSource::open(dir.path().join("portrait.png"), "2..".parse().unwrap()).is_err());
}

#[test]
fn bad_folders_are_refused_in_a_sentence() {
    let says = |dir: &Path, what: &str| {
        let e = FrameSource::open(dir, all()).unwrap_err().to_string();
        assert!(e.contains(what) && e.starts_with(&dir.display().to_string()) && !e.contains('\n'), "{e}");
    };
    says(folder(&[]).path(), "no images");
    says(Path::new("/no/such/place"), "no such file or folder");
    says(folder(&["a1.png", "b1.png"]).path(), "both have the number 1");
    says(folder(&["a.png", "b.png"]).path(), "no numbers");
    let dir = folder(&["1.png", "2.png"]);
    write_png(dir.path().join("2.png"), &frame(5, 3, 0.0)).unwrap();
    let source = FrameSource::open(dir.path(), all()).unwrap();
    let e = source.frames().nth(1).unwrap().unwrap_err().to_string();
    assert!(e.contains("2.png") && e.contains("5 x 3") && e.contains("4 x 3"), "{e}");
}

#[test]
fn several_kinds_side_by_side() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    for n in 1..3 {
        let rgb = image::RgbImage::from_pixel(4, 3, image::Rgb([200, 100, 50]));
        rgb.save(at(&format!("{n}.jpg"))).unwrap();
        let depth = image::ImageBuffer::from_pixel(4, 3, image::Luma([2000u16]));
        depth.save(at(&format!("{n}.png"))).unwrap();
        write_flo(at(&format!("{n}.flo")), &Raster::filled(4, 3, [1.0, 0.0])).unwrap();
    }
    let source = FrameSource::open(dir.path(), all()).unwrap();
    assert_eq!(numbers(&source), [1, 2]);
    assert!(source.notes()[0].contains("2 PNG files have no colour"), "{:?}", source.notes());
    let depth = SideFolder::depth(dir.path(), DepthFormat::default()).unwrap();
    assert_eq!(depth.get(2, (4, 3)).unwrap().unwrap().at(1, 1), 0.5);
    assert!(SideFolder::flow(dir.path()).unwrap().has(2));
    // Grey images are the frames if there are no others.
    fs::remove_file(at("1.jpg")).unwrap();
    fs::remove_file(at("2.jpg")).unwrap();
    assert_eq!(numbers(&FrameSource::open(dir.path(), all()).unwrap()), [1, 2]);
}

#[test]
fn a_side_folder_is_matched_by_number_and_size() {
    let dir = folder(&["0002.png", "0004.png"]);
    let clean = SideFolder::<Encoded>::frames(dir.path(), "clean frames").unwrap();
    assert_eq!(clean.notes(), ["clean frames: 2 PNG files, display-encoded"]);
    assert!(clean.has(4) && !clean.has(3));
    assert_eq!(clean.get(3, (4, 3)).unwrap(), None);
    assert_eq!(clean.get(4, (4, 3)).unwrap().unwrap().0.size(), (4, 3));
    let e = clean.get(4, (8, 6)).unwrap_err().to_string();
    assert!(e.contains("clean frames of frame 4") && e.contains("4 x 3") && e.contains("8 x 6"), "{e}");
    let e = SideFolder::flow(dir.path()).err().unwrap().to_string();
    assert!(e.contains("no files with flow") && e.contains(".flo"), "{e}");
}

#[test]
fn the_paper_s_layout_either_way_round() {
    for scene_first in [false, true] {
        let dir = tempfile::tempdir().unwrap();
        let place = |kind: &str| {
            let path = if scene_first {
                dir.path().join("lamp").join(kind)
            } else {
                dir.path().join(kind).join("lamp")
            };
            fs::create_dir_all(&path).unwrap();
            path
        };
        write_png(place("original").join("0.png"), &frame(4, 3, 0.5)).unwrap();
        write_png(place("denoised").join("0.png"), &frame(4, 3, 0.4)).unwrap();
        let grey = Encoded(Raster::from_fn(4, 3, |x, _| [x as f32 / 3.0; 3]));
        write_png(place("depth").join("0.png"), &grey).unwrap();
        let flow = Raster::filled(4, 3, [1.5, -2.0]);
        write_flo(place("flow").join("0.flo"), &flow).unwrap();
        let scene = PaperScene::open(dir.path(), "lamp").unwrap();
        assert_eq!(numbers(&FrameSource::open(&scene.original, all()).unwrap()), [0]);
        assert!(scene.denoised.is_some() && scene.de_motion_blurred.is_none());
        let depth = scene.depth.unwrap().get(0, (4, 3)).unwrap().unwrap();
        assert_eq!((depth.at(0, 0), depth.at(3, 2)), (0.0, 1.0));
        assert_eq!(scene.flow.unwrap().get(0, (4, 3)).unwrap().unwrap(), flow);
        let e = PaperScene::open(dir.path(), "other").err().unwrap().to_string();
        assert!(e.contains("no scene \"other\""), "{e}");
    }
}
