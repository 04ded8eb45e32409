//! Real footage across cameras: the model of one half of a clip must fit the clip's other half better than any other clip's does.

use crate::run::Run;
use crate::statistics::normal_quantile;
use crate::table::{Cell, Table};
use blindaug::CameraModel;
use blindaug::model::NOISE_LEVELS;
use blindaug_io::{Error, FrameRange, FrameSource, Result};
use blindaug_pipeline::{Footage, Silent, estimate};
use rand::{Rng, SeedableRng, rngs::StdRng};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The most frames of a half that are looked at: the first ones.
const FRAMES: u64 = 48;
/// The luminances at which noise is compared.
const LUMINANCES: [f32; 5] = [0.2, 0.35, 0.5, 0.65, 0.8];
/// The std below which noise cannot be seen: a quarter of a step of 8 bits.
const INVISIBLE: f64 = 0.25 / 255.0;
/// The draws of both halves' parameters from their intervals, by which it is told whether one model is surely nearer than another.
const DRAWS: usize = 400;
/// The share of draws in which a model must be nearer to be surely nearer.
const SURE: f64 = 0.95;

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
    for (what, caption, measured) in MEASURES {
        let halves: Vec<[Option<Vec<Parameter>>; 2]> =
            outcomes.iter().map(|(_, halves)| halves.each_ref().map(measured)).collect();
        let of = |model: usize, footage: usize| {
            let (a, b) = (halves[model][0].as_ref()?, halves[footage][1].as_ref()?);
            Some(distance(a.iter().map(|v| v.value), b.iter().map(|v| v.value)))
        };
        let rows = (0..names.len()).map(|model| {
            let cells = (0..names.len()).map(|footage| Cell::number(of(model, footage), 3));
            [Cell::text(&names[model])].into_iter().chain(cells).collect()
        });
        let Some(Tally { clips, nearest, surely, lost }) = tally(&halves, run.seed()) else {
            won.push(format!("and of none the {what} is known in both halves"));
            continue;
        };
        let named = |clips: &[usize]| match clips {
            [] => "none".to_owned(),
            clips => clips.iter().map(|i| names[*i].as_str()).collect::<Vec<_>>().join(", "),
        };
        won.push(format!(
            "by {what} on {nearest} of {clips} (whatever the intervals allow: {}; another clip's fits better whatever they allow: {})",
            named(&surely),
            named(&lost)
        ));
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

/// What the distances say of the clips whose parameters are known in both halves.
struct Tally {
    clips: usize,
    /// The number of clips whose own half is the nearest.
    nearest: usize,
    /// The clips whose own half is nearer than each other one in the share [`SURE`] of draws.
    surely: Vec<usize>,
    /// The clips of which another clip's half is nearer in that share of draws.
    lost: Vec<usize>,
}

/// Counts the clips; `None` if there are none to count.
fn tally(halves: &[[Option<Vec<Parameter>>; 2]], seed: u64) -> Option<Tally> {
    let known: Vec<(usize, [&Vec<Parameter>; 2])> =
        halves.iter().enumerate().filter_map(|(i, [a, b])| Some((i, [a.as_ref()?, b.as_ref()?]))).collect();
    let clips = known.len();
    let mut rng = StdRng::seed_from_u64(seed);
    let drawn: Vec<[Vec<Vec<f64>>; 2]> =
        known.iter().map(|(_, halves)| halves.map(|half| draws(half, &mut rng))).collect();
    let others = |footage: usize| (0..clips).filter(move |model| *model != footage);
    let nearest = |footage: &usize| {
        let of = |model: usize| {
            let value = |half: usize, clip: usize| known[clip].1[half].iter().map(|v| v.value);
            distance(value(0, model), value(1, *footage))
        };
        others(*footage).all(|model| of(*footage) < of(model))
    };
    // Whether one clip's model is surely nearer to the footage than another's. Models at one distance, as all whose noise cannot be seen, are
    // not told apart.
    let surely = |one: usize, other: usize, footage: usize| {
        let of = |model: usize, k: usize| {
            distance(drawn[model][0][k].iter().copied(), drawn[footage][1][k].iter().copied())
        };
        (0..DRAWS).filter(|k| of(one, *k) < of(other, *k)).count() as f64 >= SURE * DRAWS as f64
    };
    let those = |which: &dyn Fn(&usize) -> bool| -> Vec<usize> {
        (0..clips).filter(which).map(|i| known[i].0).collect()
    };
    (clips > 0).then(|| Tally {
        clips,
        nearest: those(&nearest).len(),
        surely: those(&|f| others(*f).all(|other| surely(*f, other, *f))),
        lost: those(&|f| others(*f).any(|other| surely(other, *f, *f))),
    })
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

/// A parameter of a camera with the ends of its interval.
struct Parameter {
    value: f64,
    low: f64,
    high: f64,
}

/// The root mean square of the differences of two cameras' parameters.
fn distance(a: impl ExactSizeIterator<Item = f64>, b: impl Iterator<Item = f64>) -> f64 {
    let count = a.len().max(1) as f64;
    (a.zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / count).sqrt()
}

/// Parameters drawn from their intervals, [`DRAWS`] times: all of a draw lie as far above or below their values, by the scale of their
/// intervals, since what makes them wrong is mostly common to them.
fn draws(parameters: &[Parameter], rng: &mut StdRng) -> Vec<Vec<f64>> {
    let draw = |_| {
        let deviation = normal_quantile(rng.random_range(1e-6..1.0 - 1e-6)) / normal_quantile(0.975);
        let at = |v: &Parameter| {
            v.value + deviation * if deviation > 0.0 { v.high - v.value } else { v.value - v.low }
        };
        parameters.iter().map(at).collect()
    };
    (0..DRAWS).map(draw).collect()
}

/// A name, a caption and the parameters of a camera that are compared, `None` where they are unknown.
type Measure = (&'static str, &'static str, fn(&CameraModel) -> Option<Vec<Parameter>>);

const MEASURES: [Measure; 2] = [
    (
        "noise",
        "Distance of the noise: the root mean square, over octaves, channels and luminances, of the logarithm of one std over the other.",
        |camera| {
            let noise = camera.noise.known()?;
            let at = |level: usize, y: f32, c: usize| {
                // All noise that cannot be seen is alike.
                let ln = |std: f32| f64::from(std).max(INVISIBLE).ln();
                let [low, high] = noise.interval_of_std(level, c, y).map(ln);
                Parameter { value: ln(noise.std(level, y)[c]), low, high }
            };
            let over = |l| LUMINANCES.into_iter().flat_map(move |y| (0..3).map(move |c| at(l, y, c)));
            Some((0..NOISE_LEVELS).flat_map(over).collect())
        },
    ),
    ("exposure fraction", "Difference of the exposure fractions.", |camera| {
        let exposure = camera.motion_blur.known()?;
        let [low, high] = exposure.interval.map(f64::from);
        Some(vec![Parameter { value: exposure.exposure.0.into(), low, high }])
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

    #[test]
    fn clips_of_one_name_are_told_apart() {
        let told = |clips: &[&str]| names(&clips.iter().map(Path::new).collect::<Vec<_>>());
        assert_eq!(told(&["a/b/x.mp4", "a/c/x.mp4", "y.mp4"]), ["b/x.mp4", "c/x.mp4", "y.mp4"]);
        assert_eq!(told(&["desk/color", "room/color"]), ["desk/color", "room/color"]);
        assert_eq!(told(&["x.mp4", "x.mp4"]), ["x.mp4 (1)", "x.mp4 (2)"]);
        assert_eq!(told(&["x.mp4", "a/x.mp4"]), ["x.mp4", "a/x.mp4"]);
    }

    #[test]
    fn halves_are_told_apart_as_far_as_their_intervals_allow() {
        let half =
            |value: f64, width: f64| Some(vec![Parameter { value, low: value - width, high: value + width }]);
        let counted = |width: f64, second: f64| {
            let halves = [[half(0.0, width), half(0.1, width)], [half(1.0, width), half(second, width)]];
            let Tally { clips, nearest, surely, lost } = tally(&halves, 1).unwrap();
            assert_eq!(clips, 2);
            (nearest, surely, lost)
        };
        assert_eq!(counted(0.05, 1.1), (2, vec![0, 1], vec![]));
        assert_eq!(counted(2.0, 1.1), (2, vec![], vec![]));
        // The second clip's second half is that of the first clip's camera.
        assert_eq!(counted(0.05, 0.1), (1, vec![0], vec![1]));
        // Models that are alike.
        let alike = [[half(0.0, 0.0), half(0.1, 0.0)], [half(0.0, 0.0), half(0.1, 0.0)]];
        let Tally { nearest, surely, lost, .. } = tally(&alike, 1).unwrap();
        assert_eq!((nearest, surely, lost), (0, vec![], vec![]));
        assert!(tally(&[[half(1.0, 0.1), None]], 1).is_none());
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
        assert!(said.contains("by noise on 2 of 2 (whatever the intervals allow: weak, strong; another clip's fits better whatever they allow: none)"), "{said}\n{}", tables[0].text());
        assert_eq!(tables[0].rows.len(), 2);
        assert!(super::tables(&run("none"), &[]).unwrap().is_none());
        let e = super::tables(&run("short"), &[folder.path().join("weak/0.png")]).unwrap_err();
        assert!(e.sentence().contains("fewer than four frames"), "{e}");
    }
}
