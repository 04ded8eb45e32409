//! Real footage across cameras: the model of one half of a clip must fit the clip's other half better than any other clip's does.

use crate::run::Run;
use crate::statistics::normal_quantile;
use crate::table::{Cell, Table};
use blindaug::CameraModel;
use blindaug::fit::noise::UNSEEN_STD;
use blindaug::model::{GREYS, NOISE_LEVELS};
use blindaug_io::{Error, FrameRange, FrameSource, Result};
use blindaug_pipeline::{Footage, Silent, estimate};
use rand::{Rng, SeedableRng, rngs::StdRng};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The most frames of a half that are looked at: the first ones.
const FRAMES: u64 = 48;
/// [`UNSEEN_STD`] in double precision.
const UNSEEN: f64 = UNSEEN_STD as f64;
/// The draws of both halves' parameters from their intervals, by which it is told whether one model surely fits better than another.
const DRAWS: usize = 400;
/// The share of draws in which a model must fit better to surely do so.
const SURE: f64 = 0.95;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Case {
    clip: PathBuf,
    bytes: u64,
}

/// What is known of the two halves of a clip.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Halves {
    cameras: [CameraModel; 2],
    /// Whether frames of a half could not be followed from one to the next, as across a cut.
    cut: bool,
}

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
    let named = |clips: &[usize]| match clips {
        [] => "none".to_owned(),
        clips => clips.iter().map(|i| names[*i].as_str()).collect::<Vec<_>>().join(", "),
    };
    let mut tables = vec![];
    let mut won = vec![];
    for measure in &MEASURES {
        let Measure { what, caption, parameters, misfit } = measure;
        let halves: Vec<[Option<Half>; 2]> = outcomes
            .iter()
            .map(|(_, of)| of.cameras.each_ref().map(|camera| Some((camera, parameters(camera)?))))
            .collect();
        let of = |model: usize, footage: usize| {
            Some(misfit_of(*misfit, halves[model][0].as_ref()?, halves[footage][1].as_ref()?))
        };
        let rows = (0..names.len()).map(|model| {
            let cells = (0..names.len()).map(|footage| Cell::number(of(model, footage), 3));
            [Cell::text(&names[model])].into_iter().chain(cells).collect()
        });
        let Some(Tally { clips, best, surely, lost }) = tally(&halves, *misfit, run.seed()) else {
            won.push(format!("and of fewer than two clips the {what} is known in both halves"));
            continue;
        };
        let others: Vec<usize> = clips.iter().copied().filter(|i| !best.contains(i)).collect();
        won.push(format!(
            "by {what} on {} of {} (not on: {}; whatever the intervals allow: {}; another clip's fits better whatever they allow: {})",
            best.len(),
            clips.len(),
            named(&others),
            named(&surely),
            named(&lost)
        ));
        let of_halves = names.iter().map(|n| format!("second half of {n}"));
        tables.push(Table {
            name: format!("footage-{}", what.replace(' ', "-")),
            caption: (*caption).into(),
            head: ["model of the first half of".to_owned()].into_iter().chain(of_halves).collect(),
            rows: rows.collect(),
        });
    }
    let cut: Vec<usize> = (0..names.len()).filter(|i| outcomes[*i].1.cut).collect();
    let cut = match cut.as_slice() {
        [] => String::new(),
        cut => format!(
            " Not all frames could be followed from one to the next in {}, as where a clip is cut; halves of a clip that is cut are not of \
             one take.",
            named(cut)
        ),
    };
    let said = format!(
        "Real footage, each clip cut into two halves whose cameras are estimated apart: the model of a clip's own first half fits its \
         second half better than any other clip's does {}.{cut}",
        won.join(", ")
    );
    Ok(Some((tables, said)))
}

/// Which clips their own half's model fits best.
struct Tally {
    /// The clips whose parameters are known in both halves.
    clips: Vec<usize>,
    /// The clips which their own half's model fits best.
    best: Vec<usize>,
    /// The clips which their own half's model fits better than each other one in the share [`SURE`] of draws.
    surely: Vec<usize>,
    /// The clips which another clip's model fits better in that share of draws.
    lost: Vec<usize>,
}

/// Finds on which clips the own half's model fits best; `None` if there are fewer than two to compare.
fn tally(halves: &[[Option<Half>; 2]], misfit: Misfit, seed: u64) -> Option<Tally> {
    let known: Vec<(usize, [&Half; 2])> =
        halves.iter().enumerate().filter_map(|(i, [a, b])| Some((i, [a.as_ref()?, b.as_ref()?]))).collect();
    let count = known.len();
    let mut rng = StdRng::seed_from_u64(seed);
    let drawn: Vec<[Vec<Vec<f64>>; 2]> =
        known.iter().map(|(_, halves)| halves.map(|(_, half)| draws(half, &mut rng))).collect();
    let others = |footage: usize| (0..count).filter(move |model| *model != footage);
    let best = |footage: &usize| {
        let of = |model: usize| misfit_of(misfit, known[model].1[0], known[*footage].1[1]);
        others(*footage).all(|model| of(*footage) < of(model))
    };
    // Whether one clip's model surely fits the footage better than another's. Models that fit alike, as all whose noise cannot be seen, are
    // not told apart.
    let surely = |one: usize, other: usize, footage: usize| {
        let of = |model: usize, k: usize| {
            let camera = |clip: usize, half: usize| (known[clip].1[half].0, &*drawn[clip][half][k]);
            misfit(camera(model, 0), camera(footage, 1))
        };
        (0..DRAWS).filter(|k| of(one, *k) < of(other, *k)).count() as f64 >= SURE * DRAWS as f64
    };
    let those =
        |which: &dyn Fn(&usize) -> bool| (0..count).filter(which).map(|i| known[i].0).collect::<Vec<_>>();
    (count > 1).then(|| Tally {
        clips: those(&|_| true),
        best: those(&best),
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

/// A camera and its parameters.
type Half<'a> = (&'a CameraModel, Vec<Parameter>);

/// How badly the model of one half fits another half.
fn misfit_of(misfit: Misfit, (model, of_model): &Half, (footage, of_footage): &Half) -> f64 {
    let values = |parameters: &[Parameter]| parameters.iter().map(|p| p.value).collect::<Vec<_>>();
    misfit((model, &values(of_model)), (footage, &values(of_footage)))
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

/// How badly a model fits footage, from the model's camera and the footage's own, each with values of its parameters; 0 if they are alike.
type Misfit = fn((&CameraModel, &[f64]), (&CameraModel, &[f64])) -> f64;

/// What of two cameras is compared.
struct Measure {
    what: &'static str,
    caption: &'static str,
    /// The parameters that have intervals; `None` where they are unknown.
    parameters: fn(&CameraModel) -> Option<Vec<Parameter>>,
    misfit: Misfit,
}

const MEASURES: [Measure; 2] = [
    Measure {
        what: "noise",
        caption: "The divergence (Kullback and Leibler 1951) of the footage's noise from the model's, nats per value: mean over octaves, \
                  luminances, and the sum and the difference of successive frames. It compares the noise's std in each channel and its \
                  correlation between channels and between frames; noise of a quarter of a step of 8 bits, which cannot be seen, is added to both.",
        parameters: stds,
        misfit: divergence,
    },
    Measure {
        what: "exposure fraction",
        caption: "Difference of the exposure fractions.",
        parameters: |camera| {
            let exposure = camera.motion_blur.known()?;
            let [low, high] = exposure.interval.map(f64::from);
            Some(vec![Parameter { value: exposure.exposure.0.into(), low, high }])
        },
        misfit: |(_, model), (_, footage)| (model[0] - footage[0]).abs(),
    },
];

/// The natural logarithms of the noise's std, by octave, luminance and channel.
fn stds(camera: &CameraModel) -> Option<Vec<Parameter>> {
    let noise = camera.noise.known()?;
    let at = |level: usize, y: f32, c: usize| {
        let ln = |std: f32| f64::from(std).max(0.1 * UNSEEN).ln();
        let [low, high] = noise.interval_of_std(level, c, y).map(ln);
        Parameter { value: ln(noise.std(level, y)[c]), low, high }
    };
    let over = |l| GREYS.into_iter().flat_map(move |y| (0..3).map(move |c| at(l, y, c)));
    Some((0..NOISE_LEVELS).flat_map(over).collect())
}

/// The mean divergence of the footage's noise from the model's, nats per value, with these logarithms of the stds.
fn divergence(
    (model, of_model): (&CameraModel, &[f64]),
    (footage, of_footage): (&CameraModel, &[f64]),
) -> f64 {
    // The covariance of the channels in the sum (`sign` 1) or the difference (-1) of successive frames, over the square root of 2.
    let covariance = |camera: &CameraModel, ln_std: &[f64], level: usize, sign: f64| {
        let curves = camera.noise.known().and_then(|n| n.curves());
        let [rg, rb, gb] = curves.map_or([0.0; 3], |c| c.levels[level].correlation()).map(f64::from);
        let over_time = 1.0 + sign * curves.map_or(0.0, |c| f64::from(c.temporal_correlation));
        let mut all = [[1.0, rg, rb], [rg, 1.0, gb], [rb, gb, 1.0]];
        for (i, row) in all.iter_mut().enumerate() {
            for (j, v) in row.iter_mut().enumerate() {
                *v *= over_time * (ln_std[i] + ln_std[j]).exp();
            }
            row[i] += UNSEEN * UNSEEN;
        }
        all
    };
    let mut sum = 0.0;
    for (place, (m, f)) in of_model.chunks(3).zip(of_footage.chunks(3)).enumerate() {
        let level = place / GREYS.len();
        for sign in [-1.0, 1.0] {
            sum += of_gaussians(covariance(model, m, level, sign), covariance(footage, f, level, sign));
        }
    }
    sum / (2 * of_model.len()) as f64
}

/// The divergence, in nats, of a normal distribution with the covariance `footage` from one with the covariance `model`.
fn of_gaussians(model: [[f64; 3]; 3], footage: [[f64; 3]; 3]) -> f64 {
    // The cofactors of a symmetric matrix; over its determinant they are its inverse.
    let cofactor = |m: &[[f64; 3]; 3], i: usize, j: usize| {
        let [a, b, c, d] = [(i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3];
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant = |m: &[[f64; 3]; 3]| (0..3).map(|j| m[0][j] * cofactor(m, 0, j)).sum::<f64>();
    let (of_model, of_footage) = (determinant(&model), determinant(&footage));
    let trace: f64 =
        (0..9).map(|k| cofactor(&model, k / 3, k % 3) * footage[k / 3][k % 3]).sum::<f64>() / of_model;
    0.5 * (trace - 3.0 + (of_model / of_footage).ln())
}

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
        Ok((fitted.estimation.model, fitted.shots.len() > 1))
    };
    let middle = numbers.len() / 2;
    let [first, second] = [half(0, middle - 1)?, half(middle, numbers.len() - 1)?];
    Ok(Halves { cut: first.1 || second.1, cameras: [first.0, second.0] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Provenance;
    use blindaug::model::Capture;
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
        let capture = Capture { width: 64, height: 48, fps: None, frames_used: 2, pixel_aspect: 1.0 };
        let camera = CameraModel::unknown(capture, "a test");
        let half = |value: f64, width: f64| {
            Some((&camera, vec![Parameter { value, low: value - width, high: value + width }]))
        };
        let misfit: Misfit = |(_, a), (_, b)| (a[0] - b[0]).abs();
        let counted = |width: f64, second: f64| {
            let halves = [[half(0.0, width), half(0.1, width)], [half(1.0, width), half(second, width)]];
            let Tally { clips, best, surely, lost } = tally(&halves, misfit, 1).unwrap();
            assert_eq!(clips, [0, 1]);
            (best, surely, lost)
        };
        assert_eq!(counted(0.05, 1.1), (vec![0, 1], vec![0, 1], vec![]));
        assert_eq!(counted(2.0, 1.1), (vec![0, 1], vec![], vec![]));
        // The second clip's second half is that of the first clip's camera.
        assert_eq!(counted(0.05, 0.1), (vec![0], vec![0], vec![1]));
        // Models that are alike.
        let alike = [[half(0.0, 0.0), half(0.1, 0.0)], [half(0.0, 0.0), half(0.1, 0.0)]];
        let Tally { best, surely, lost, .. } = tally(&alike, misfit, 1).unwrap();
        assert_eq!((best, surely, lost), (vec![], vec![], vec![]));
        let alone = [half(1.0, 0.1), half(1.1, 0.1)];
        assert!(tally(&[alone, [half(1.0, 0.1), None]], misfit, 1).is_none());
    }

    #[test]
    fn the_divergence_is_that_of_normal_distributions() {
        let noise = |variances: [f64; 3], correlation: f64| -> [[f64; 3]; 3] {
            std::array::from_fn(|i| {
                std::array::from_fn(|j| {
                    (variances[i] * variances[j]).sqrt() * if i == j { 1.0 } else { correlation }
                })
            })
        };
        let alike = noise([1.0, 2.0, 3.0], 0.6);
        assert!(of_gaussians(alike, alike).abs() < 1e-12);
        // In one dimension, of which there are three here: half of r - 1 - ln r, r the variance over the model's.
        let one = |r: f64| 0.5 * (r - 1.0 - r.ln());
        let apart = of_gaussians(noise([1.0; 3], 0.0), noise([2.0, 0.5, 1.0], 0.0));
        assert!((apart - one(2.0) - one(0.5)).abs() < 1e-12);
        // Noise of three independent channels under a model whose channels are correlated: its eigenvalues are 1 + 2 c and twice 1 - c.
        let apart = of_gaussians(noise([1.0; 3], 0.5), noise([1.0; 3], 0.0));
        assert!((apart - one(0.5) - 2.0 * one(2.0)).abs() < 1e-12);
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
        assert!(said.contains("by noise on 2 of 2 (not on: none; whatever the intervals allow: weak, strong; another clip's fits better whatever they allow: none)"), "{said}\n{}", tables[0].text());
        assert_eq!(tables[0].rows.len(), 2);
        assert!(super::tables(&run("none"), &[]).unwrap().is_none());
        let e = super::tables(&run("short"), &[folder.path().join("weak/0.png")]).unwrap_err();
        assert!(e.sentence().contains("fewer than four frames"), "{e}");
    }
}
