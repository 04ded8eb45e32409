//! Tracks frames of raw bytes R, G, B, A: a camera per line on standard output, and the median time per frame on standard error. The check of
//! the npm package compares the same in WebAssembly with it.
//!
//!     RAYON_NUM_THREADS=1 cargo run --release -p blindaug-pipeline --no-default-features --features threads --example track_raw -- FILE WIDTH HEIGHT

use blindaug::{ByteRows, Encoded, Frame};
use blindaug_pipeline::track::{Beside, FrameTracker};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, width, height] = &arguments[..] else { return Err("give FILE WIDTH HEIGHT".into()) };
    let size @ (width, height) = (width.parse()?, height.parse::<usize>()?);
    let bytes = std::fs::read(file)?;
    let mut tracker = FrameTracker::new(Default::default(), Default::default(), None, None);
    let mut times = vec![];
    for (number, rgba) in (1..).zip(bytes.chunks_exact(4 * width * height)) {
        let start = Instant::now();
        let image = Encoded::from_rgba8(size, ByteRows::new(rgba, 4 * width))?;
        let camera = tracker.push(Frame { number, image }, Beside::default())?;
        times.push(start.elapsed().as_secs_f64());
        if let Some(camera) = camera {
            println!("{}", camera.to_json_line());
        }
    }
    if let Some(camera) = tracker.finish()? {
        println!("{}", camera.to_json_line());
    }
    times.sort_by(f64::total_cmp);
    eprintln!("{:.1} ms", 1e3 * times.get(times.len() / 2).ok_or("there is no frame in it")?);
    Ok(())
}
