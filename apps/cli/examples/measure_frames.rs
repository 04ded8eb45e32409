//! Measures `blindaug frames`: clips are damaged at known places, coded, and looked at. `cargo run --release --example measure_frames
//! [VIDEO ..]` prints the tables of docs/frames.md: for the given videos or, without any, for scenes that are filmed by physics with known
//! exposures. With `--exposures` it prints the exposures that are estimated from such scenes with copies and without some of their frames.
//! Coding needs the `ffmpeg` program.

use blindaug::Transfer;
use blindaug::analysis::flow::flow_with_occlusion;
use blindaug::fit::timing::Kind;
use blindaug::{CameraModel, Encoded, Raster};
use blindaug_io::{FrameSource, VideoCoding, VideoWriter};
use blindaug_pipeline::{Clip, Footage, MemoryClip, Silent, estimate, timing::timing, track};
use blindaug_scenes::camera::{Camera, Setting};
use blindaug_scenes::scene::{Exposure, Scene};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const SIZE: (usize, usize) = (384, 288);
const FRAMES: u64 = 64;
/// The most frames of a video.
const MOST: usize = 250;

/// Films: the number of the scene, a group, an exposure, and the std of the noise.
const FILMS: [(u64, &str, f32, f32); 5] = [
    (103, "steady", 0.8, 0.005),
    (106, "steady", 0.1, 0.01),
    (104, "shaken", 0.5, 0.01),
    (105, "shaken", 0.25, 0.01),
    (107, "surging", 0.5, 0.01),
];

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Damage {
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

/// The damages, which take turns at the damaged places of a clip.
const DAMAGES: [(Damage, &str); 7] = [
    (Damage::Dropped(1), "1 dropped"),
    (Damage::Doubled, "doubled"),
    (Damage::Warped, "warped"),
    (Damage::Frozen, "doubled in place of a dropped one"),
    (Damage::Blended, "blended"),
    (Damage::Dropped(2), "2 dropped"),
    (Damage::WarpedIn, "warped, put in"),
];
/// The number of frames from one damaged place to the next.
const APART: usize = 7;

/// What is wrong with a frame, by its number from 1 on, and the damage that made it so.
type Truth = BTreeMap<(Kind, u64), Damage>;

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

/// Damages every seventh frame, with the damages in turn from the one of number `first` on.
fn damaged(frames: &[Encoded], first: usize) -> (Vec<Encoded>, Truth) {
    let (mut out, mut truth) = (vec![], Truth::new());
    let mut turns = DAMAGES.iter().cycle().skip(first);
    let mut i = 0;
    while i < frames.len() {
        if i == 0 || i % APART != 0 || i + 4 > frames.len() {
            out.push(frames[i].clone());
            i += 1;
            continue;
        }
        let damage = turns.next().map_or(Damage::Doubled, |d| d.0);
        let number = out.len() as u64;
        let mut say = |kind: Kind, number: u64| {
            truth.insert((kind, number), damage);
        };
        match damage {
            Damage::Dropped(n) => {
                say(Kind::Dropped, number);
                i += n - 1;
            }
            Damage::Doubled => {
                say(Kind::Doubled, number + 1);
                out.extend([frames[i - 1].clone(), frames[i].clone()]);
            }
            Damage::Frozen => {
                say(Kind::Doubled, number + 1);
                say(Kind::Dropped, number + 1);
                out.push(frames[i - 1].clone());
            }
            Damage::Blended | Damage::Warped => {
                say(Kind::Interpolated, number + 1);
                out.push(mixed(&frames[i - 1], &frames[i + 1], damage == Damage::Warped));
            }
            Damage::WarpedIn => {
                say(Kind::Interpolated, number + 1);
                out.extend([mixed(&frames[i - 1], &frames[i], true), frames[i].clone()]);
            }
        }
        i += 1;
    }
    (out, truth)
}

/// What `look` makes of frames after they were coded.
fn coded<R>(frames: &[Encoded], crf: Option<u8>, look: impl FnOnce(Box<dyn Clip>) -> R) -> R {
    let Some(crf) = crf else { return look(Box::new(MemoryClip { frames: frames.to_vec(), fps: None })) };
    let path = std::env::temp_dir().join(format!("blindaug-frames-{}.mp4", std::process::id()));
    let mut video = VideoWriter::create_coded(&path, frames[0].0.size(), 25.0, VideoCoding::H264 { crf })
        .expect("a video");
    frames.iter().for_each(|f| video.write(f).expect("a frame"));
    video.finish().expect("a video");
    let found = look(Box::new(FrameSource::open(&path, Default::default()).expect("a video")));
    std::fs::remove_file(&path).expect("the video");
    found
}

/// What is found in frames after they were coded.
fn found(frames: &[Encoded], crf: Option<u8>) -> BTreeSet<(Kind, u64)> {
    let timing = coded(frames, crf, |clip| timing(&*clip, Transfer::Srgb, &Silent).expect("frames").timing);
    timing.findings.iter().map(|f| (f.event.kind(), f.frame)).collect()
}

/// The frames of a clip of this many that are shown, in their order.
type Shown = fn(usize) -> Vec<usize>;

/// The clips whose exposures are estimated.
const SHOWN: [(&str, Shown); 6] = [
    ("as they are", |n| (0..n).collect()),
    ("one of five twice (24 frames a second as 30)", |n| {
        (0..n).flat_map(|t| std::iter::repeat_n(t, if t % 4 == 3 { 2 } else { 1 })).collect()
    }),
    ("each twice (15 as 30)", |n| (0..n).flat_map(|t| [t; 2]).collect()),
    ("each three times (10 as 30)", |n| (0..n).flat_map(|t| [t; 3]).collect()),
    ("one of seven missing", |n| (0..n).filter(|t| t * 3 % 7 != 4).collect()),
    ("one of seven missing, the one before in its place", |n| {
        (0..n).map(|t| t - usize::from(t * 3 % 7 == 4)).collect()
    }),
];

/// The sum of the errors of known exposures, the number of these, and that of those whose intervals hold the truth.
#[derive(Default)]
struct Errors {
    sum: f32,
    known: usize,
    covered: usize,
}

impl Errors {
    /// Adds the error of the exposure of what is called `name`, and says it if the interval does not hold the truth.
    fn add(&mut self, camera: &CameraModel, truth: f32, name: &str) {
        if let Some(found) = camera.motion_blur.known() {
            let (exposure, [low, high]) = (found.exposure.0, found.interval);
            self.sum += (exposure - truth).abs();
            self.known += 1;
            if (low..=high).contains(&truth) {
                self.covered += 1;
            } else {
                eprintln!("{name}: {exposure:.2} [{low:.2}, {high:.2}] for {truth:.2}");
            }
        }
    }

    fn words(&self) -> String {
        format!("{:.3}, {} of {}", self.sum / self.known as f32, self.covered, self.known)
    }
}

/// Prints the exposures of scenes with copies and without some of their frames.
fn exposures() {
    const CLIPS: u64 = 10;
    let exposure = |i: u64| 0.15 + 0.08 * i as f32;
    let films: Vec<Vec<Encoded>> =
        (0..CLIPS).map(|i| film((201 + i, "steady", exposure(i), 0.008))).collect();
    println!(
        "\n| {CLIPS} clips, H.264 at crf 20 | `estimate`: mean error, covered of known | the last frame of `--track` |"
    );
    println!("|---|---|---|");
    for (what, shown) in SHOWN {
        let mut errors = [Errors::default(), Errors::default()];
        for (i, film) in films.iter().enumerate() {
            let frames: Vec<Encoded> = shown(film.len()).into_iter().map(|t| film[t].clone()).collect();
            let cameras = coded(&frames, Some(20), |clip| {
                let footage = Footage { clip, ..Footage::new(MemoryClip::default()) };
                let of_clip = estimate::estimate(&footage, Default::default(), &Silent).expect("frames");
                let tracked =
                    track::track(&footage, Default::default(), &Silent, &mut |_| Ok(())).expect("frames");
                let last = tracked.track.frames().last().expect("frames");
                [of_clip.estimation.model, last.camera.clone()]
            });
            let truth = exposure(i as u64);
            for ((errors, camera), job) in errors.iter_mut().zip(&cameras).zip(["estimate", "--track"]) {
                errors.add(camera, truth, &format!("{what}, clip {i}, {job}"));
            }
        }
        println!("| {what} | {} | {} |", errors[0].words(), errors[1].words());
    }
}

/// The scores of a coding: for each damage how many were found of how many; by kind the findings that are right and those that are not; the
/// findings in untouched clips, and these clips' frames.
#[derive(Default)]
struct Score {
    damages: BTreeMap<Damage, [usize; 2]>,
    kinds: BTreeMap<Kind, [usize; 2]>,
    untouched: [usize; 2],
}

fn table(group: &str, clips: &[Vec<Encoded>], crfs: &[Option<u8>], with_damage: bool) {
    let name = |crf: &Option<u8>| crf.map_or("not coded".to_owned(), |crf| format!("crf {crf}"));
    println!("\n| {group} | {} |", crfs.iter().map(name).collect::<Vec<_>>().join(" | "));
    println!("|---|{}", "---|".repeat(crfs.len()));
    let scores: Vec<Score> = crfs
        .iter()
        .map(|&crf| {
            let mut score = Score::default();
            for (first, frames) in clips.iter().enumerate() {
                let wrong = found(frames, crf);
                if !wrong.is_empty() {
                    eprintln!("{group}, clip {first}, {}: {wrong:?}", name(&crf));
                }
                score.untouched[0] += wrong.len();
                score.untouched[1] += frames.len();
                if !with_damage {
                    continue;
                }
                let (frames, truth) = damaged(frames, first);
                let found = found(&frames, crf);
                for (place, damage) in &truth {
                    let [there, right] = score.damages.entry(*damage).or_default();
                    *there += 1;
                    *right += usize::from(found.contains(place));
                }
                for place in &found {
                    score.kinds.entry(place.0).or_default()[usize::from(!truth.contains_key(place))] += 1;
                }
            }
            score
        })
        .collect();
    let row = |what: &str, of: &dyn Fn(&Score) -> String| {
        println!("| {what} | {} |", scores.iter().map(of).collect::<Vec<_>>().join(" | "));
    };
    row("untouched: wrong findings", &|s| format!("{} in {} frames", s.untouched[0], s.untouched[1]));
    if !with_damage {
        return;
    }
    for (damage, what) in DAMAGES {
        row(&format!("{what}: found"), &|s| {
            s.damages.get(&damage).map_or("none".into(), |[there, found]| format!("{found} of {there}"))
        });
    }
    for kind in Kind::ALL {
        row(&format!("{}: right of the findings", kind.name()), &|s| {
            s.kinds.get(&kind).map_or("none".into(), |[right, wrong]| format!("{right} of {}", right + wrong))
        });
    }
}

fn film((number, how, exposure, noise): (u64, &str, f32, f32)) -> Vec<Encoded> {
    let scene = match how {
        "shaken" => Scene::new(number, SIZE).shaken(number),
        "surging" => Scene::new(number, SIZE).surging(&[9.5, 19.5, 30.5, 40.5, 52.5]),
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
    let videos: Vec<String> = std::env::args().skip(1).collect();
    if videos.first().is_some_and(|v| v == "--exposures") {
        return exposures();
    }
    let crfs = [None, Some(23), Some(28)];
    for group in ["steady", "shaken", "surging"] {
        if !videos.is_empty() {
            break;
        }
        let films: Vec<Vec<Encoded>> = FILMS.into_iter().filter(|f| f.1 == group).map(film).collect();
        // What surges is the control: nothing of it is to be found.
        table(group, &films, &crfs, group != "surging");
    }
    for path in videos {
        let source = FrameSource::open(Path::new(&path), Default::default()).expect("a video");
        let all = source.frames_if(|_| true).take(MOST);
        let frames: Vec<Encoded> = all.map(|f| f.expect("a frame").image).collect();
        let name = Path::new(&path).file_name().unwrap_or_default().to_string_lossy().into_owned();
        table(&name, &[frames], &[None, Some(23)], true);
    }
}
