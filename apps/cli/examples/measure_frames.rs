//! Measures `blindaug frames`: clips are damaged at known places, coded, and looked at. `cargo run --release --example measure_frames
//! [VIDEO ..]` prints the tables of docs/frames.md: first for scenes that are filmed by physics with known exposures, then for each
//! video. Coding needs the `ffmpeg` program.

use blindaug::analysis::flow::flow_with_occlusion;
use blindaug::fit::timing::Kind;
use blindaug::{Encoded, Raster};
use blindaug_io::{FrameSource, VideoCoding, VideoWriter};
use blindaug_pipeline::{Clip, MemoryClip, Silent, timing::timing};
use blindaug_scenes::camera::{Camera, Setting};
use blindaug_scenes::scene::{Exposure, Scene};
use std::collections::BTreeSet;
use std::path::Path;

const SIZE: (usize, usize) = (384, 288);
const FRAMES: u64 = 48;
/// The most frames of a video.
const MOST: usize = 300;

/// Films of scenes: a group, an exposure, and the std of the noise.
const FILMS: [(&str, f32, f32); 7] = [
    ("steady", 0.1, 0.01),
    ("steady", 0.25, 0.02),
    ("steady", 0.5, 0.01),
    ("steady", 0.8, 0.005),
    ("shaken", 0.5, 0.01),
    ("shaken", 0.25, 0.01),
    ("surging", 0.5, 0.01),
];

#[derive(Clone, Copy, PartialEq)]
enum Damage {
    None,
    /// So many frames are taken out.
    Dropped(usize),
    /// A copy is put in.
    Doubled,
    /// A copy takes a frame's place.
    Frozen,
    /// A mixture of its neighbours takes a frame's place.
    Blended,
    /// A mixture of its neighbours along the motion takes a frame's place.
    Warped,
    /// Such a mixture is put in between two frames.
    WarpedIn,
}

const DAMAGES: [(Damage, &str); 8] = [
    (Damage::None, "none"),
    (Damage::Dropped(1), "1 dropped"),
    (Damage::Dropped(2), "2 dropped"),
    (Damage::Doubled, "doubled"),
    (Damage::Frozen, "doubled for a dropped one"),
    (Damage::Blended, "blended"),
    (Damage::Warped, "warped"),
    (Damage::WarpedIn, "warped, put in"),
];

/// Frames, and what is wrong with which of them, by their number from 1 on.
type Damaged = (Vec<Encoded>, BTreeSet<(Kind, u64)>);

fn in_steps(v: f32) -> f32 {
    (v.clamp(0.0, 1.0) * 255.0).round() / 255.0
}

fn mixed(a: &Encoded, b: &Encoded, along_motion: bool) -> Encoded {
    let (w, h) = a.0.size();
    let pair = along_motion.then(|| flow_with_occlusion(&a.luma(), &b.luma()).expect("one size"));
    Encoded(Raster::from_fn(w, h, |x, y| {
        let [[u, v], [p, q]] =
            pair.as_ref().map_or([[0.0; 2]; 2], |f| [f.forward.at(x, y), f.backward.at(x, y)]);
        let (x, y) = (x as f32, y as f32);
        let (a, b) = (a.0.bilinear(x - 0.5 * u, y - 0.5 * v), b.0.bilinear(x - 0.5 * p, y - 0.5 * q));
        std::array::from_fn(|c| in_steps(0.5 * (a[c] + b[c])))
    }))
}

fn damaged(frames: &[Encoded], damage: Damage) -> Damaged {
    let (mut out, mut truth) = (vec![], BTreeSet::new());
    let places: BTreeSet<usize> =
        (1..).map(|k| 9 * k + k * k % 4).take_while(|p| p + 6 < frames.len()).collect();
    let mut i = 0;
    while i < frames.len() {
        if !places.contains(&i) {
            out.push(frames[i].clone());
            i += 1;
            continue;
        }
        let number = out.len() as u64;
        match damage {
            Damage::None => out.push(frames[i].clone()),
            Damage::Dropped(n) => {
                truth.insert((Kind::Dropped, number));
                i += n - 1;
            }
            Damage::Doubled | Damage::Frozen => {
                out.push(frames[i - 1].clone());
                truth.insert((Kind::Doubled, number + 1));
                match damage {
                    Damage::Doubled => out.push(frames[i].clone()),
                    _ => drop(truth.insert((Kind::Dropped, number + 1))),
                }
            }
            Damage::Blended | Damage::Warped => {
                out.push(mixed(&frames[i - 1], &frames[i + 1], damage == Damage::Warped));
                truth.insert((Kind::Interpolated, number + 1));
            }
            Damage::WarpedIn => {
                out.push(mixed(&frames[i - 1], &frames[i], true));
                truth.insert((Kind::Interpolated, number + 1));
                out.push(frames[i].clone());
            }
        }
        i += 1;
    }
    (out, truth)
}

/// What was found of one damage.
#[derive(Clone, Copy, Default)]
struct Score {
    frames: usize,
    there: usize,
    found: usize,
    wrong: usize,
}

impl Score {
    fn add(&mut self, (frames, truth): &Damaged, crf: Option<u8>) {
        let folder = std::env::temp_dir().join(format!("blindaug-frames-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let clip: Box<dyn Clip> = match crf {
            None => Box::new(MemoryClip { frames: frames.clone(), fps: None }),
            Some(crf) => {
                let path = folder.join("clip.mp4");
                let mut video =
                    VideoWriter::create_coded(&path, frames[0].0.size(), 25.0, VideoCoding::H264 { crf })
                        .expect("a video");
                frames.iter().for_each(|f| video.write(f).expect("a frame"));
                video.finish().expect("a video");
                Box::new(FrameSource::open(&path, Default::default()).expect("a video"))
            }
        };
        let timing = timing(&*clip, &Silent).expect("frames").timing;
        let found: BTreeSet<(Kind, u64)> =
            timing.findings.iter().map(|f| (f.event.kind(), f.frame)).collect();
        self.frames += frames.len();
        self.there += truth.len();
        self.found += truth.intersection(&found).count();
        self.wrong += found.difference(truth).count();
        drop(clip);
        std::fs::remove_dir_all(&folder).expect("the folder");
    }
}

fn table(group: &str, clips: &[Vec<Encoded>], crfs: &[Option<u8>], damages: &[(Damage, &str)]) {
    let name = |crf: &Option<u8>| crf.map_or("not coded".to_owned(), |crf| format!("crf {crf}"));
    println!("\n| {group} | {} |", crfs.iter().map(name).collect::<Vec<_>>().join(" | "));
    println!("|---|{}", "---|".repeat(crfs.len()));
    for (damage, what) in damages {
        let made: Vec<Damaged> = clips.iter().map(|frames| damaged(frames, *damage)).collect();
        let cell = |crf: &Option<u8>| {
            let mut score = Score::default();
            made.iter().for_each(|clip| score.add(clip, *crf));
            let Score { frames, there, found, wrong } = score;
            match damage {
                Damage::None => format!("{wrong} wrong in {frames} frames"),
                _ => format!("{found} of {there}, {wrong} wrong"),
            }
        };
        println!("| {what} | {} |", crfs.iter().map(cell).collect::<Vec<_>>().join(" | "));
    }
}

fn film(number: u64, (how, exposure, noise): (&str, f32, f32)) -> Vec<Encoded> {
    let scene = match how {
        "shaken" => Scene::new(number, SIZE).shaken(number),
        "surging" => Scene::new(number, SIZE).surging(&[9.5, 19.5, 30.5, 39.5]),
        _ => Scene::new(number, SIZE),
    };
    let setting = Setting { exposure, lens: None, noise, readout: 0.3, rolling_shutter: 0.0 };
    let filmed = |t: u64| {
        let (sharp, time) = (scene.picture(t as f32, Exposure::default(), 0), t as f32);
        let evidence = (&sharp, &scene.inverse_depth(time), &scene.motion(time));
        Camera::Physics.film(&scene, t, evidence, &setting, number).expect("pictures of one size").frame
    };
    (0..FRAMES).map(filmed).collect()
}

fn main() {
    let crfs = [None, Some(18), Some(23), Some(28)];
    for group in ["steady", "shaken", "surging"] {
        let films: Vec<Vec<Encoded>> =
            (201..).zip(FILMS).filter(|(_, f)| f.0 == group).map(|(number, f)| film(number, f)).collect();
        // What surges is the control: nothing of it is to be found.
        table(group, &films, &crfs, if group == "surging" { &DAMAGES[..1] } else { &DAMAGES });
    }
    for path in std::env::args().skip(1) {
        let source = FrameSource::open(Path::new(&path), Default::default()).expect("a video");
        let frames: Vec<Encoded> =
            source.frames_if(|_| true).take(MOST).map(|f| f.expect("a frame").image).collect();
        let name = Path::new(&path).file_name().unwrap_or_default().to_string_lossy().into_owned();
        table(&name, &[frames], &[None, Some(23)], &DAMAGES);
    }
}
