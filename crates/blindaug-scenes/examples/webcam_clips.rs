//! Writes clips of known exposure, lens and noise as a webcam delivers them, for browsers that play a file as their webcam: `N.y4m` (4:2:0, 8
//! bit) and `N.json` with the truth. The frames run forth and back, so that a clip that is played again and again has no seam.
//!
//!     cargo run --release -p blindaug-scenes --example webcam_clips -- FOLDER [CLIPS [WIDTH HEIGHT [FRAMES]]]

use blindaug::{Encoded, Plane, Raster, Transfer};
use blindaug_scenes::scene::{Exposure, Scene};
use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};
use std::{io::Write, path::Path};

/// The luminances around 0.5 at which the true noise is measured.
const MIDDLE: std::ops::Range<f32> = 0.35..0.65;
/// The frame rate in the head of a clip: low enough for every frame to be seen on a slow machine, as exposure is a share of the frame interval.
const FPS: u32 = 8;

/// The planes Y', Cb, Cr of a frame, Rec. 601 in its limited range, as webcams deliver them, but not yet rounded to their steps.
fn planes(frame: &Encoded) -> [Plane; 3] {
    let (w, h) = frame.0.size();
    let ycc = frame.0.map(|[r, g, b]: [f32; 3]| {
        let y = 0.299 * r + 0.587 * g + 0.114 * b;
        [16.0 + 219.0 * y, 128.0 + 224.0 * (b - y) / 1.772, 128.0 + 224.0 * (r - y) / 1.402]
    });
    let halved = |c: usize| {
        Plane::from_fn(w / 2, h / 2, |x, y| {
            let sum: f32 =
                [(0, 0), (1, 0), (0, 1), (1, 1)].iter().map(|(i, j)| ycc.at(2 * x + i, 2 * y + j)[c]).sum();
            0.25 * sum
        })
    };
    [ycc.map(|v| v[0]), halved(1), halved(2)]
}

/// The frame that Chromium makes of such planes: Cb and Cr, which lie amid four pixels, are interpolated linearly.
fn shown([y, cb, cr]: &[Plane; 3]) -> Encoded {
    Encoded(Raster::from_fn(y.width(), y.height(), |i, j| {
        let y = (y.at(i, j) - 16.0) / 219.0;
        let [cb, cr] = [cb, cr].map(|c| {
            // The edge goes on beyond the edge.
            let place = |at: usize, size: usize| (0.5 * at as f32 - 0.25).clamp(0.0, (size - 1) as f32);
            (c.bilinear(place(i, c.width()), place(j, c.height())) - 128.0) / 224.0
        });
        let (r, b) = (y + 1.402 * cr, y + 1.772 * cb);
        [r, (y - 0.299 * r - 0.114 * b) / 0.587, b].map(|v| v.clamp(0.0, 1.0))
    }))
}

/// The values in steps of 8 bits.
fn rounded(planes: [Plane; 3]) -> [Plane; 3] {
    planes.map(|p| p.map(|v| v.round().clamp(0.0, 255.0)))
}

fn main() -> std::io::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, usual: usize| arguments.get(i).and_then(|a| a.parse().ok()).unwrap_or(usual);
    let Some(folder) = arguments.first().map(Path::new) else {
        eprintln!("give a folder to write to");
        std::process::exit(2);
    };
    std::fs::create_dir_all(folder)?;
    let (clips, size, frames) = (number(1, 10), (number(2, 480), number(3, 360)), number(4, 24));
    for clip in 0..clips as u64 {
        let share = (clip as f32 + 0.5) / clips as f32;
        let exposure = 0.2 + 0.7 * share;
        // Noise and lens run through their ranges in other orders.
        let std = (1.5 + 0.35 * ((7 * clip) % 10) as f32) / 255.0;
        let (blur, focus) = (0.4 * ((3 * clip) % 6) as f32, 1.2 + 0.3 * (clip % 4) as f32);
        let lens = (blur > 0.0).then_some((blur, focus));
        let scene = Scene::new(100 + clip, size);
        let mut rng = StdRng::seed_from_u64(clip);
        let mut made = vec![];
        let mut noise = [(0.0f64, 0u64); 3];
        for t in 0..frames {
            let clean = scene
                .picture(t as f32, Exposure { fraction: exposure, lens, readout: 0.0 }, t as u64)
                .to_encoded(Transfer::Srgb);
            let (w, h) = clean.0.size();
            // The noise is drawn for one pixel after the other.
            let mut noisy = clean.clone();
            for y in 0..h {
                for pixel in noisy.0.row_mut(y) {
                    *pixel = pixel.map(|v| {
                        let n: f32 = StandardNormal.sample(&mut rng);
                        (v + std * n).clamp(0.0, 1.0)
                    });
                }
            }
            // The noise is all by which what a browser delivers differs from the picture without it: rounding, too, but once.
            let planes = rounded(self::planes(&noisy));
            let with = shown(&planes).0.map(|p| p.map(|v| (255.0 * v).round() / 255.0));
            let without = shown(&self::planes(&clean));
            let luma = without.luma();
            for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
                if MIDDLE.contains(&luma.at(x, y)) {
                    let (a, b) = (with.at(x, y), without.0.at(x, y));
                    for c in 0..3 {
                        noise[c].0 += f64::from(a[c] - b[c]).powi(2);
                        noise[c].1 += 1;
                    }
                }
            }
            made.push(planes);
        }
        let mut file = std::io::BufWriter::new(std::fs::File::create(folder.join(format!("{clip}.y4m")))?);
        writeln!(file, "YUV4MPEG2 W{} H{} F{FPS}:1 Ip A1:1 C420jpeg", size.0, size.1)?;
        for planes in made.iter().chain(made[1..frames - 1].iter().rev()) {
            writeln!(file, "FRAME")?;
            for plane in planes {
                file.write_all(&plane.data().iter().map(|v| *v as u8).collect::<Vec<_>>())?;
            }
        }
        file.flush()?;
        let std = noise.map(|(sum, n)| 255.0 * (sum / n.max(1) as f64).sqrt());
        let lens =
            lens.map_or("null".into(), |(s, f)| format!("{{\"sigma_px_at_infinity\":{s},\"focus_m\":{f}}}"));
        let truth = format!(
            "{{\"exposure\":{exposure},\"noise_steps\":{std:?},\"lens\":{lens},\"frames\":{frames}}}"
        );
        std::fs::write(folder.join(format!("{clip}.json")), truth)?;
        println!("{clip}: exposure {exposure:.3}, noise {std:.2?}, lens {lens}");
    }
    Ok(())
}
