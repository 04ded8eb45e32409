//! Real pixels whose exposure is known: photographs that are moved, and frames of a video that are averaged.

use blindaug::analysis::cuts::cut_between;
use blindaug::fit::{Estimator, EstimatorOptions, Evidence, FrameObservation};
use blindaug::{Encoded, Transfer};
use blindaug_cli::console::{self, Progress, Result, failure, note};
use blindaug_io::{FrameRange, FrameSource, Inputs, read_frame, write_atomically};
use blindaug_scenes::measure::Value;
use blindaug_scenes::moved::{Averaged, Course, Filming, Found, Hand, film, of_averaged, reduced, table};
use std::path::{Path, PathBuf};

/// Frames of each case.
const FRAMES: usize = 6;

/// The exposure fractions of moved photographs; each photograph is filmed with every second one, by both hands.
const EXPOSURES: [f32; 8] = [0.5, 0.15, 0.75, 0.25, 1.0, 0.35, 0.9, 0.6];

/// How many frames are averaged, of how many.
const AVERAGED: [(usize, usize); 8] = [(1, 4), (2, 4), (3, 4), (4, 4), (2, 8), (4, 8), (6, 8), (8, 8)];

/// The places of a video at which frames are averaged, evenly spread.
const PLACES: usize = 6;

/// The std of the noise of moved photographs, of encoded values.
const NOISE: f32 = 0.006;

/// Measures the exposure of moved photographs, of averaged frames of a video, or of both, prints a table and writes it and all cases.
///
/// # Errors
/// If nothing can be read, or the results cannot be written.
pub fn run(photos: Option<&Path>, film: Option<&Path>, output: &Path) -> Result<()> {
    let inputs = Inputs::of(photos.iter().chain(film.iter()));
    inputs.check_output_folder(output, |_| true)?;
    blindaug_io::make_folder(output)?;
    let mut all = vec![];
    if let Some(folder) = photos {
        all.extend(of_photos(folder)?);
    }
    if let Some(clip) = film {
        all.extend(of_film(clip)?);
    }
    let text = table(&all);
    let json = serde_json::to_string_pretty(&all).expect("what was found is plain data");
    for (name, text) in [("real.json", &json), ("real.md", &text)] {
        write_atomically(output.join(name), |partial| std::fs::write(partial, text))?;
    }
    console::print(&text)?;
    if film.is_some() {
        note(
            "of averaged frames, the exposure is n/N only if the video's own shutter is open all the time; every exposure from (n - 1)/N, for one that is hardly open, to n/N counts as true",
        );
    }
    note(format_args!("written: {}", output.join("real.json").display()));
    Ok(())
}

/// The images of a folder that can be read, in the order of their names.
fn images(folder: &Path) -> Result<Vec<PathBuf>> {
    let listed =
        std::fs::read_dir(folder).map_err(|e| failure(folder, format_args!("it cannot be listed ({e})")))?;
    let mut paths: Vec<PathBuf> =
        listed.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.is_file()).collect();
    paths.sort();
    Ok(paths)
}

fn of_photos(folder: &Path) -> Result<Vec<Found>> {
    let paths = images(folder)?;
    let mut progress = Progress::counting("photographs", "files", Some(paths.len()));
    let mut all = vec![];
    let (mut seed, mut left_out) = (0, 0);
    for path in &paths {
        progress.step();
        if console::interrupted() {
            break;
        }
        let Ok(photo) = read_frame(path) else {
            left_out += 1;
            continue;
        };
        let photo = reduced(photo.to_linear(Transfer::Srgb));
        let mut filmed = 0;
        for hand in [Hand::Steady, Hand::Shaking] {
            for i in 0..EXPOSURES.len() / 2 {
                seed += 1;
                let exposure = EXPOSURES[(2 * i + all.len() / EXPOSURES.len()) % EXPOSURES.len()];
                let filming = Filming { exposure, frames: FRAMES, noise: NOISE, seed };
                let Some(frames) = film(&photo, &Course::new(hand, FRAMES, seed), &filming) else { continue };
                filmed += 1;
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                let group = match hand {
                    Hand::Steady => "photographs, moved steadily",
                    Hand::Shaking => "photographs, moved by a shaking hand",
                };
                all.push(found(format!("{name} {exposure}"), group.into(), [exposure; 2], &frames, path)?);
            }
        }
        left_out += usize::from(filmed == 0);
    }
    drop(progress);
    if left_out > 0 {
        note(format_args!("{left_out} of {} files are no images, or too small to be moved", paths.len()));
    }
    if all.is_empty() {
        return Err(failure(folder, "there is no photograph of at least 400 x 300 px here"));
    }
    Ok(all)
}

fn of_film(clip: &Path) -> Result<Vec<Found>> {
    let whole = FrameSource::open(clip, FrameRange::default())?;
    let most = AVERAGED.iter().map(|a| a.1).max().unwrap_or(1) * FRAMES;
    let count = match whole.len_hint() {
        Some(count) => count,
        None => whole.frames().filter_map(|f| f.ok()).count(),
    };
    if count < most {
        return Err(failure(clip, format_args!("it has {count} frames, and {most} are needed")));
    }
    let places = PLACES.min(count / most);
    let mut progress = Progress::counting("averaging", "places", Some(places));
    let mut all = vec![];
    for place in 0..places {
        progress.step();
        if console::interrupted() {
            break;
        }
        let first = (count - most) * place / places.max(2).saturating_sub(1).max(1);
        let first = first.min(count - most) as u64;
        let range = FrameRange { first: Some(first), last: Some(first + most as u64 - 1) };
        let source = FrameSource::open(clip, range)?;
        let mut averaged: Vec<Vec<Averaged>> = AVERAGED.iter().map(|_| vec![]).collect();
        let mut last: Option<Encoded> = None;
        let mut cut = false;
        for (i, frame) in source.frames().enumerate() {
            let frame = halved(frame?.image);
            if let Some(last) = &last {
                cut |= cut_between(last, &frame).map_err(|e| failure(clip, e))?;
            }
            for ((n, of), averaged) in AVERAGED.iter().zip(&mut averaged) {
                match averaged.last_mut() {
                    _ if i / of >= FRAMES || i % of >= *n => {}
                    Some(sum) if i % of > 0 => sum.add(&frame),
                    _ => averaged.push(Averaged::new(&frame)),
                }
            }
            last = Some(frame);
        }
        if cut {
            continue;
        }
        for ((n, of), averaged) in AVERAGED.iter().zip(&averaged) {
            let frames: Vec<Encoded> = averaged.iter().map(Averaged::frame).collect();
            let name = format!("{n} of every {of} from frame {first}");
            all.push(found(name, format!("{n} of every {of}"), of_averaged(*n, *of), &frames, clip)?);
        }
    }
    drop(progress);
    if all.is_empty() {
        return Err(failure(clip, format_args!("it has cuts wherever {most} frames were looked at")));
    }
    Ok(all)
}

/// A frame halved until it is no larger than those of [`blindaug_scenes::moved::film`].
fn halved(frame: Encoded) -> Encoded {
    reduced(frame.to_linear(Transfer::Srgb)).to_encoded(Transfer::Srgb)
}

/// The exposure of frames, nothing given, beside the truth.
fn found(name: String, group: String, truth: [f32; 2], frames: &[Encoded], path: &Path) -> Result<Found> {
    let mut estimator = Estimator::new(EstimatorOptions::default());
    for (i, frame) in frames.iter().enumerate() {
        let observation = FrameObservation {
            frame,
            next: frames.get(i + 1),
            previous: i.checked_sub(1).map(|i| &frames[i]),
            evidence: Evidence::default(),
        };
        estimator.add(&observation).map_err(|e| failure(path, e))?;
    }
    let estimation = estimator.estimate().map_err(|e| failure(path, e))?;
    let exposure = &estimation.model.motion_blur;
    Ok(Found {
        name,
        group,
        truth,
        exposure: exposure.known().map(|m| Value { estimate: m.exposure.0, interval: m.interval }),
        per_frame: estimation.diagnostics.exposure_per_frame.iter().map(|f| f.1).collect(),
        unknown: exposure.why_unknown().map(ToString::to_string),
    })
}
