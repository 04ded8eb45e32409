//! Writes the captures with which `train/lensnet.py` trains the networks of the LensNet-like baseline: for each camera a file
//! `NAME.f32` of little-endian floats of the shape `[captures, 9, side, side]`, which are the sharp target's premultiplied R, G, B and A,
//! its inverse depth (1/m, 0 where there is none), and the captured R, G, B and A.
//!
//!     cargo run --release -p blindaug-research --example lensnet_captures -- DIR

use blindaug_research::baselines::lens_net::{CAMERAS, captures};
use std::io::{BufWriter, Write};
use std::path::PathBuf;

/// The number of captures of each camera.
const COUNT: usize = 60;

fn main() -> std::io::Result<()> {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        eprintln!("name the folder for the captures");
        std::process::exit(2);
    };
    std::fs::create_dir_all(&folder)?;
    for camera in 0..CAMERAS {
        let (name, all) = captures(camera, COUNT, 1);
        let mut file = BufWriter::new(std::fs::File::create(folder.join(format!("{name}.f32")))?);
        for (i, capture) in all.enumerate() {
            let (sharp, depth) = (capture.layer.color.0.data(), capture.layer.inverse_depth.data());
            let captured = capture.captured.0.data();
            let planes = (0..4)
                .map(|c| sharp.iter().map(|p| p[c]).collect::<Vec<f32>>())
                .chain([depth.iter().map(|d| if d.is_finite() { *d } else { 0.0 }).collect()])
                .chain((0..4).map(|c| captured.iter().map(|p| p[c]).collect()));
            for v in planes.flatten() {
                file.write_all(&v.to_le_bytes())?;
            }
            eprint!("\r{name}: {} of {COUNT} ", i + 1);
        }
        file.flush()?;
        eprintln!();
    }
    Ok(())
}
