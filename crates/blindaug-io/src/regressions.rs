//! Tests with files that fuzzing (`tools/fuzz.sh`) found, and similar files: fuzz/regressions has a folder for each reader.

use crate::*;
use std::{path::Path, sync::mpsc, time::Duration};

/// The time limit for reading one file, far longer than any file takes.
const LIMIT: Duration = Duration::from_secs(60);

type Read = fn(&Path) -> Result<()>;

fn image(path: &Path) -> Result<()> {
    read_frame(path)?;
    read_linear(path)?;
    read_inverse_depth(path, DepthFormat::default()).map(drop)
}

#[test]
fn files_of_before_are_read_or_end_in_a_sentence() {
    let readers: [(&str, Read); 10] = [
        ("png", image),
        ("jpeg", image),
        ("tiff", image),
        ("bmp", image),
        ("pnm", image),
        ("exr", |p| {
            exr_contents(p)?;
            read_flow(p)?;
            read_virtual_layer(p)?;
            image(p)
        }),
        ("flo", |p| read_flow(p).map(drop)),
        ("mp4", |p| {
            let video = video::Video::open_built_in(p)?;
            let mut frames = video.frames()?;
            (0..3).try_for_each(|_| frames.next_frame().map(drop))
        }),
        ("camera", |p| read_camera(p).map(drop)),
        ("tracks", |p| read_camera_track(p).map(drop)),
    ];
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fuzz/regressions"));
    for (name, read) in readers {
        let Ok(files) = folder.join(name).read_dir() else { continue };
        for file in files {
            let path = file.unwrap().path();
            let (result, ended) = mpsc::channel();
            let of = path.clone();
            std::thread::spawn(move || result.send(read(&of)));
            let ended = ended.recv_timeout(LIMIT);
            if let Err(e) = ended.unwrap_or_else(|_| panic!("{}: no end, or a panic", path.display())) {
                let e = e.sentence();
                assert!(!e.contains(char::is_control) && !e.ends_with('.'), "{}: {e}", path.display());
                assert!(e.len() < 2000, "{}: a sentence of {} bytes", path.display(), e.len());
            }
        }
    }
}
