//! Real pixels whose exposure is known: photographs that are moved, as a whole and frame by frame, and frames of a video that are averaged.

use blindaug::fit::{Estimator, EstimatorOptions, FrameObservation, track::Tracker};
use blindaug::model::{Estimate, MotionBlurModel, Reason};
use blindaug::{Encoded, Transfer};
use blindaug_io::{Error, FrameRange, FrameSource, Result, read_frame};
use blindaug_pipeline::{Observer, Steps};
use blindaug_report::words::count;
use blindaug_scenes::measure::Value;
use blindaug_scenes::moved::{
    Course, Film, FilmMaker, Filming, Found, GHOSTS_PX, Hand, film, of_averaged, reduced,
};
use std::path::{Path, PathBuf};

/// The number of frames of each case.
const FRAMES: usize = 6;

/// The exposure fractions of moved photographs; each photograph is filmed with every second one, by both hands.
const EXPOSURES: [f32; 8] = [0.5, 0.15, 0.75, 0.25, 1.0, 0.35, 0.9, 0.6];

/// The most cases of a video; the cases come from its beginning.
const CASES_OF_FILM: usize = 160;

/// The std of the noise of moved photographs, of encoded values.
const NOISE: f32 = 0.006;

/// The images of a folder that can be read, in the order of their names.
fn images(folder: &Path) -> Result<Vec<PathBuf>> {
    let listed =
        std::fs::read_dir(folder).map_err(|e| Error::new(folder, format!("it cannot be listed ({e})")))?;
    let mut paths: Vec<PathBuf> =
        listed.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.is_file()).collect();
    paths.sort();
    Ok(paths)
}

/// The exposures of moved photographs: the images of a folder.
///
/// # Errors
/// If the folder has no photograph that is large enough.
pub fn of_photos(folder: &Path, observer: &dyn Observer) -> Result<Vec<Found>> {
    let paths = images(folder)?;
    let progress = Steps::begin(observer, "photographs", "files", Some(paths.len()));
    let mut all = vec![];
    let (mut seed, mut left_out) = (0, 0);
    for path in &paths {
        progress.step();
        if observer.stops() {
            break;
        }
        let Ok(photo) = read_frame(path) else {
            left_out += 1;
            continue;
        };
        let photo = reduced(photo.to_linear(Transfer::Srgb));
        let photos = all.len() / (2 * EXPOSURES.len());
        let mut filmed = 0;
        for hand in [Hand::Steady, Hand::Shaking] {
            for i in 0..EXPOSURES.len() / 2 {
                seed += 1;
                let exposure = EXPOSURES[(2 * i + photos) % EXPOSURES.len()];
                let filming = Filming { exposure, frames: FRAMES, noise: NOISE, seed };
                let Some(frames) = film(&photo, &Course::new(hand, FRAMES, seed), &filming) else { continue };
                filmed += 1;
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                let group = match hand {
                    Hand::Steady => "photographs, moved steadily",
                    Hand::Shaking => "photographs, moved by a shaking hand",
                };
                let name = format!("{name} {exposure}");
                let told = estimated(&frames, path)?;
                all.push(found(name.clone(), group.into(), [exposure; 2], told));
                let told = tracked(&frames, path)?;
                all.push(found(name, format!("{group}, tracked"), [exposure; 2], told));
            }
        }
        left_out += usize::from(filmed == 0);
    }
    drop(progress);
    if left_out > 0 {
        observer
            .note(&format!("{left_out} of {} files are no images, or too small to be moved", paths.len()));
    }
    if all.is_empty() {
        return Err(Error::new(folder, "there is no photograph of at least 400 x 300 px here"));
    }
    Ok(all)
}

/// The exposures of averaged frames of a video.
///
/// # Errors
/// If the clip cannot be read, or no part of it can be used.
pub fn of_film(clip: &Path, observer: &dyn Observer) -> Result<Vec<Found>> {
    let source = FrameSource::open(clip, FrameRange::default())?;
    let progress = Steps::begin(observer, "averaging", "frames", source.len_hint());
    let mut maker = FilmMaker::default();
    let mut all = vec![];
    let of = |film: &Film| {
        let Film { first, averaged, of, frames } = film;
        let name = format!("{averaged} of every {of} from frame {first}");
        let group = format!("{averaged} of every {of}");
        Ok(found(name, group, of_averaged(*averaged, *of), estimated(frames, clip)?))
    };
    for frame in source.frames() {
        progress.step();
        for film in maker.push(&frame?.image).map_err(|e| Error::new(clip, e.to_string()))? {
            all.push(of(&film)?);
        }
        if observer.stops() || all.len() >= CASES_OF_FILM {
            break;
        }
    }
    if all.len() < CASES_OF_FILM {
        all.extend(maker.finish().iter().map(of).collect::<Result<Vec<Found>>>()?);
    }
    drop(progress);
    let too_fast = maker.too_fast();
    let ghosts = format!(
        "what moves does so by more than {GHOSTS_PX} px a frame, and averaged frames would show ghosts rather than streaks"
    );
    if all.is_empty() && too_fast > 0 {
        let else_do = "give a video of slower motion or of more frames a second";
        return Err(Error::new(clip, format!("{ghosts}; {else_do}")));
    }
    if all.is_empty() {
        return Err(Error::new(clip, "it has no 24 frames without a cut"));
    }
    if too_fast > 0 {
        observer.note(&format!("{} left out: {ghosts}", count(too_fast as u64, "piece")));
    }
    Ok(all)
}

/// An exposure, and those of the single frames.
type Told = (Estimate<MotionBlurModel>, Vec<f32>);

/// The exposure that is estimated from the frames alone, and by each frame alone.
fn estimated(frames: &[Encoded], path: &Path) -> Result<Told> {
    let mut estimator = Estimator::new(EstimatorOptions::default());
    for observation in FrameObservation::of_frames(frames) {
        estimator.add(&observation).map_err(|e| Error::new(path, e.to_string()))?;
    }
    let estimation = estimator.estimate().map_err(|e| Error::new(path, e.to_string()))?;
    let per_frame = estimation.diagnostics.exposure_per_frame.iter().map(|f| f.1).collect();
    Ok((estimation.model.motion_blur, per_frame))
}

/// The exposure that is tracked from frame to frame, as of the last one, and as of each in which it is known.
fn tracked(frames: &[Encoded], path: &Path) -> Result<Told> {
    let mut tracker = Tracker::new(Default::default(), None);
    let mut told = vec![];
    let mut last = Estimate::unknown(Reason::TooShort, "there is no frame");
    for observation in FrameObservation::of_frames(frames) {
        let model = tracker.push(&observation).map_err(|e| Error::new(path, e.to_string()))?;
        told.extend(model.motion_blur.known().map(|m| m.exposure.0));
        last.clone_from(&model.motion_blur);
    }
    Ok((last, told))
}

/// An exposure beside the true one.
fn found(name: String, group: String, truth: [f32; 2], (exposure, per_frame): Told) -> Found {
    Found {
        name,
        group,
        truth,
        exposure: exposure.known().map(|m| Value { estimate: m.exposure.0, interval: m.interval }),
        per_frame,
        unknown: exposure.why_unknown().map(ToString::to_string),
    }
}
