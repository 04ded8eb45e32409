//! Real footage across cameras: the model of one half of a clip must fit the clip's other half better than any other clip's does.

use crate::run::Run;
use crate::table::{Cell, Table};
use blindaug::CameraModel;
use blindaug::model::NOISE_LEVELS;
use blindaug_io::{Error, FrameRange, FrameSource, Result};
use blindaug_pipeline::{Footage, Silent, estimate};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The most frames of a half that are looked at: the first ones.
const FRAMES: u64 = 48;
/// The luminances at which noise is compared.
const LUMINANCES: [f32; 5] = [0.2, 0.35, 0.5, 0.65, 0.8];
/// The std below which noise cannot be seen: a quarter of a step of 8 bits.
const INVISIBLE: f64 = 0.25 / 255.0;
/// Models whose distances to a clip differ by at most this do not tell the clip's camera from the other. All noise that cannot be seen
/// is alike.
const ALIKE: f64 = 0.02;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Case {
    clip: PathBuf,
    bytes: u64,
}

/// The cameras of the two halves.
type Halves = [CameraModel; 2];

/// The tables, and a sentence on what they say; nothing without clips.
///
/// # Errors
/// If a clip cannot be read or has fewer than four frames.
pub(crate) fn tables(run: &Run, clips: &[PathBuf]) -> Result<Option<(Vec<Table>, String)>> {
    let mut cases = vec![];
    for (i, clip) in clips.iter().enumerate() {
        let bytes = std::fs::metadata(clip).map_err(|e| Error::cannot_read(clip, &e))?.len();
        cases.push((format!("clip{i}"), Case { clip: clip.clone(), bytes }));
    }
    if cases.is_empty() {
        return Ok(None);
    }
    let outcomes: Vec<(Case, Halves)> = run.cases("cameras/footage", cases, |case| halves(&case.clip))?;
    let names = names(&outcomes.iter().map(|(c, _)| c.clip.as_path()).collect::<Vec<_>>());
    let mut tables = vec![];
    let mut won = vec![];
    for (what, caption, distance) in MEASURES {
        let of = |model: usize, footage: usize| distance(&outcomes[model].1[0], &outcomes[footage].1[1]);
        let rows = (0..names.len()).map(|model| {
            let cells = (0..names.len()).map(|footage| Cell::number(of(model, footage), 3));
            [Cell::text(&names[model])].into_iter().chain(cells).collect()
        });
        // By how much the own half is nearer than the nearest of the others.
        let nearer = |footage: usize| {
            let own = of(footage, footage)?;
            let others = (0..names.len()).filter(|m| *m != footage).filter_map(|m| of(m, footage));
            Some(others.fold(f64::INFINITY, f64::min) - own)
        };
        let known: Vec<f64> = (0..names.len()).filter_map(nearer).collect();
        let wins = known.iter().filter(|n| **n > ALIKE).count();
        let alike = known.iter().filter(|n| n.abs() <= ALIKE).count();
        let alike = if alike > 0 { format!(" ({alike} cannot be told from another)") } else { String::new() };
        won.push(format!("by {what} on {wins} of {}{alike}", known.len()));
        let of_halves = names.iter().map(|n| format!("second half of {n}"));
        tables.push(Table {
            name: format!("footage-{}", what.replace(' ', "-")),
            caption: caption.into(),
            head: ["model of the first half of".to_owned()].into_iter().chain(of_halves).collect(),
            rows: rows.collect(),
        });
    }
    let said = format!(
        "Real footage, each clip cut into two halves whose cameras are estimated apart: the model of a clip's own first half fits its \
         second half better than any other clip's does {}.",
        won.join(", ")
    );
    Ok(Some((tables, said)))
}

/// The clips' names in the tables: of each its file's name, with as many of the folders around it as tell it from the others, and its place
/// in the list if it is given twice.
fn names(clips: &[&Path]) -> Vec<String> {
    let last = |clip: &Path, parts: usize| {
        let all: Vec<_> = clip.iter().map(|p| p.to_string_lossy()).collect();
        all[all.len().saturating_sub(parts)..].join("/")
    };
    let longest = clips.iter().map(|c| c.iter().count()).max().unwrap_or(0);
    let name = |(i, clip): (usize, &&Path)| {
        let others = || clips.iter().enumerate().filter(move |(k, _)| *k != i);
        let own = |parts: &usize| others().all(|(_, o)| last(o, *parts) != last(clip, *parts));
        match (1..=longest).find(own) {
            Some(parts) => last(clip, parts),
            None => format!("{} ({})", last(clip, 1), i + 1),
        }
    };
    clips.iter().enumerate().map(name).collect()
}

/// A name, a caption and a distance between two cameras, `None` where a part is unknown.
type Measure = (&'static str, &'static str, fn(&CameraModel, &CameraModel) -> Option<f64>);

const MEASURES: [Measure; 2] = [
    (
        "noise",
        "Distance of the noise: the root mean square, over octaves, channels and luminances, of the logarithm of one std over the other.",
        |a, b| {
            let (a, b) = (a.noise.known()?, b.noise.known()?);
            let at = |level: usize, y: f32, c: usize| {
                let [a, b] = [a, b].map(|m| f64::from(m.std(level, y)[c]).max(INVISIBLE));
                let ratio = a / b;
                ratio.ln().powi(2)
            };
            let all = (0..NOISE_LEVELS)
                .flat_map(|l| LUMINANCES.into_iter().flat_map(move |y| (0..3).map(move |c| at(l, y, c))));
            Some((all.sum::<f64>() / (NOISE_LEVELS * LUMINANCES.len() * 3) as f64).sqrt())
        },
    ),
    ("exposure fraction", "Difference of the exposure fractions.", |a, b| {
        let (a, b) = (a.motion_blur.known()?, b.motion_blur.known()?);
        Some(f64::from((a.exposure.0 - b.exposure.0).abs()))
    }),
];

fn halves(clip: &Path) -> Result<Halves> {
    let source = FrameSource::open(clip, FrameRange::default())?;
    let mut numbers = vec![];
    for frame in source.frames() {
        numbers.push(frame?.number);
    }
    if numbers.len() < 4 {
        return Err(Error::new(
            clip,
            "it has fewer than four frames, so that it cannot be cut into two halves; leave it out",
        ));
    }
    let half = |first: usize, last: usize| {
        let last = last.min(first + FRAMES as usize - 1);
        let range = FrameRange { first: Some(numbers[first]), last: Some(numbers[last]) };
        let footage = Footage::new(FrameSource::open(clip, range)?);
        let fitted = estimate::estimate(&footage, estimate::Job::default(), &Silent)
            .map_err(|e| Error::new(clip, e.to_string()))?;
        Ok(fitted.estimation.model)
    };
    let middle = numbers.len() / 2;
    Ok([half(0, middle - 1)?, half(middle, numbers.len() - 1)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Provenance;
    use blindaug::{Encoded, Raster};
    use rand::{Rng, SeedableRng, rngs::StdRng};

    #[test]
    fn clips_of_one_name_are_told_apart() {
        let told = |clips: &[&str]| names(&clips.iter().map(Path::new).collect::<Vec<_>>());
        assert_eq!(told(&["a/b/x.mp4", "a/c/x.mp4", "y.mp4"]), ["b/x.mp4", "c/x.mp4", "y.mp4"]);
        assert_eq!(told(&["desk/color", "room/color"]), ["desk/color", "room/color"]);
        assert_eq!(told(&["x.mp4", "x.mp4"]), ["x.mp4 (1)", "x.mp4 (2)"]);
        assert_eq!(told(&["x.mp4", "a/x.mp4"]), ["x.mp4", "a/x.mp4"]);
    }

    #[test]
    fn a_clips_own_half_has_its_noise() {
        let folder = tempfile::tempdir().unwrap();
        let mut clips = vec![];
        for (name, std) in [("weak", 0.01), ("strong", 0.04)] {
            let clip = folder.path().join(name);
            std::fs::create_dir(&clip).unwrap();
            let mut rng = StdRng::seed_from_u64(1);
            for t in 0..6 {
                let noise: Vec<[f32; 3]> = (0..96 * 64)
                    .map(|_| std::array::from_fn(|_| std * 3.4 * (rng.random::<f32>() - 0.5)))
                    .collect();
                let frame = Encoded(Raster::from_fn(96, 64, |x, y| {
                    noise[y * 96 + x].map(|n| 0.2 + 0.006 * x as f32 + n)
                }));
                blindaug_io::write_png(clip.join(format!("{t}.png")), &frame).unwrap();
            }
            clips.push(clip);
        }
        let run =
            |name: &str| Run::new(&folder.path().join(name), Provenance::here(1), false, &Silent).unwrap();
        let (tables, said) = tables(&run("out"), &clips).unwrap().unwrap();
        assert!(said.contains("by noise on 2 of 2"), "{said}\n{}", tables[0].text());
        assert_eq!(tables[0].rows.len(), 2);
        assert!(super::tables(&run("none"), &[]).unwrap().is_none());
        let e = super::tables(&run("short"), &[folder.path().join("weak/0.png")]).unwrap_err();
        assert!(e.sentence().contains("fewer than four frames"), "{e}");
    }
}
