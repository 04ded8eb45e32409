//! Measures the noise of a real camera that stands still before a still scene. The median over time is the clean picture.

use blindaug::fit::{Estimator, EstimatorOptions, Evidence, FrameObservation};
use blindaug::model::{Estimate, NOISE_LEVELS, NoiseModel};
use blindaug::synth;
use blindaug::{Encoded, Plane, Raster, filter};
use blindaug_io::{Error, FrameRange, FrameSource, Result};
use blindaug_nets::Removed;
use blindaug_pipeline::{Networks, Observer};
use blindaug_scenes::measure::{NoiseTruth, median, noise_errors};
use std::fmt::Write;
use std::path::Path;

/// The number of frames, spread over the clip, whose median is the clean picture; and that of the successive frames from which the noise is
/// estimated.
const CLEAN_FROM: usize = 48;
const ESTIMATED_FROM: usize = 12;
/// The difference from the median, in stds, from which on a pixel counts as moving.
const STILL: f32 = 4.0;

/// A text with the errors of the noise that is estimated from a clip.
///
/// # Errors
/// If the clip cannot be read, is too short, or little in it stands still.
// This function is long, since it is one experiment whose parts share all measurements.
pub fn measure(path: &Path, networks: &mut Networks, observer: &dyn Observer) -> Result<String> {
    let source = FrameSource::open(path, FrameRange::default())?;
    let count = source.len_hint().unwrap_or(10 * CLEAN_FROM);
    let stride = (count / CLEAN_FROM).max(1);
    let (mut spread, mut first): (Vec<Encoded>, Vec<Encoded>) = (vec![], vec![]);
    for (i, frame) in source.frames().enumerate() {
        let image = frame?.image;
        if first.len() < ESTIMATED_FROM {
            first.push(image.clone());
        }
        if i % stride == 0 {
            spread.push(image);
        }
        if spread.len() == CLEAN_FROM {
            break;
        }
    }
    if spread.len() < ESTIMATED_FROM {
        let wanted = format!("a still clip needs {ESTIMATED_FROM} frames or more, and has {}", spread.len());
        return Err(Error::new(path, wanted));
    }
    let (w, h) = spread[0].0.size();
    let middle = |x: usize, y: usize, of: &dyn Fn([f32; 3], usize) -> f32| -> [f32; 3] {
        std::array::from_fn(|c| {
            let mut v: Vec<f32> = spread.iter().map(|f| of(f.0.at(x, y), c)).collect();
            let half = v.len() / 2;
            *v.select_nth_unstable_by(half, f32::total_cmp).1
        })
    };
    let clean = Encoded(Raster::from_fn(w, h, |x, y| middle(x, y, &|p, c| p[c])));
    // 8-bit steps make the median of small differences coarse, so it is at least one step.
    let std = Raster::from_fn(w, h, |x, y| {
        let own = clean.0.at(x, y);
        middle(x, y, &|p, c| (p[c] - own[c]).abs()).map(|v| 1.4826 * v.max(1.0 / 255.0))
    });
    let still = |frame: &Encoded| {
        Plane::from_fn(w, h, |x, y| {
            let (p, own, std) = (frame.0.at(x, y), clean.0.at(x, y), std.at(x, y));
            if (0..3).all(|c| (p[c] - own[c]).abs() < STILL * std[c]) { 1.0 } else { 0.0 }
        })
    };
    let mut truth = NoiseTruth::default();
    let mut share = 0.0;
    for frame in &first {
        let still = still(frame);
        share += still.data().iter().sum::<f32>() / (w * h * first.len()) as f32;
        truth.add_where(frame, &clean, &still);
    }
    if share < 0.5 {
        return Err(Error::new(
            path,
            format!(
                "only {:.0} % of the picture stands still: take a clip of a camera on a tripod",
                100.0 * share
            ),
        ));
    }
    let mut text =
        format!("{}: {} frames, {:.0} % of the picture still\n", path.display(), first.len(), 100.0 * share);
    let by_network = networks.remove_noise();
    let numbered: Vec<(u64, &Encoded)> = (0..).zip(&first).collect();
    let mut of = |what: &str, single: bool, by_networks: bool| -> Result<()> {
        networks.clear();
        let mut estimator = Estimator::new(EstimatorOptions::default());
        let frames = if single { 1 } else { first.len() };
        for (i, frame) in first.iter().enumerate().take(frames) {
            let none = Removed::default();
            let removed = if by_networks { networks.run(&numbered, i, observer) } else { &none };
            let next = first.get(i + 1).filter(|_| !single);
            let previous = i.checked_sub(1).map(|i| &first[i]);
            // The denoised frame is given as if no network had made it, since an estimate leaves a network's residual out.
            let evidence = Evidence { denoised: removed.denoised.as_deref(), ..Evidence::default() };
            estimator
                .add(&FrameObservation { frame, next, previous, evidence })
                .map_err(|e| Error::new(path, e.to_string()))?;
        }
        let model = estimator.estimate().map_err(|e| Error::new(path, e.to_string()))?.model;
        let Estimate::Known(noise) = &model.noise else {
            let why = model.noise.why_unknown().map_or("", |why| &why.sentence);
            let _ = writeln!(text, "  {what}: unknown ({why})");
            return Ok(());
        };
        let errors = noise_errors(noise, &truth);
        let level = |l: usize| median(errors.iter().filter(|e| e.0 == l).map(|e| e.1).collect());
        let percent = |v: Option<f32>| v.map_or("-".into(), |v| format!("{:.1} %", 100.0 * v));
        let levels: Vec<String> = (0..NOISE_LEVELS).map(|l| percent(level(l))).collect();
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "  {what}: error of the std {} (levels: {}); correlation of the synthesised noise with the image's gradient {:.3}",
            percent(median(errors.iter().map(|e| e.1).collect())),
            levels.join(", "),
            structure(noise, &clean)
        );
        Ok(())
    };
    of("between frames", false, false)?;
    of("single frame", true, false)?;
    if by_network {
        of("single frame, by the network's residual", true, true)?;
    }
    let blurred = filter::gaussian_blur(&first[0].0, 1.0);
    let residual = Raster::from_fn(w, h, |x, y| {
        let (a, b) = (first[0].0.at(x, y), blurred.at(x, y));
        std::array::from_fn(|c| a[c] - b[c])
    });
    let _ = writeln!(
        text,
        "  for comparison, a frame less the same frame blurred: correlation {:.3}",
        correlation(&residual, &clean)
    );
    Ok(text)
}

/// The correlation of a model's synthesised noise with the image's gradient.
fn structure(noise: &NoiseModel, clean: &Encoded) -> f32 {
    correlation(&synth::noise::noise(noise, &clean.0, 1, 0), clean)
}

/// The correlation of the noise's size, relative to its mean at the same luminance, with the size of the image's gradient.
fn correlation(noise: &Raster<[f32; 3]>, clean: &Encoded) -> f32 {
    const BINS: usize = 32;
    let luma = clean.luma();
    let (w, h) = luma.size();
    let bin = |y: f32| ((y * BINS as f32) as usize).min(BINS - 1);
    let size = noise.map(|n| n.iter().map(|v| v.abs()).sum::<f32>());
    let mut usual = [[0.0f64; 2]; BINS];
    for (s, y) in size.data().iter().zip(luma.data()) {
        usual[bin(*y)][0] += f64::from(*s);
        usual[bin(*y)][1] += 1.0;
    }
    let mut sums = [0.0f64; 6];
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let gradient =
                (luma.at(x + 1, y) - luma.at(x - 1, y)).hypot(luma.at(x, y + 1) - luma.at(x, y - 1));
            let [sum, count] = usual[bin(luma.at(x, y))];
            let (a, b) = (f64::from(gradient), f64::from(size.at(x, y)) / (sum / count).max(1e-9));
            for (s, v) in sums.iter_mut().zip([1.0, a, b, a * a, b * b, a * b]) {
                *s += v;
            }
        }
    }
    let [n, a, b, aa, bb, ab] = sums;
    let covariance = ab / n - a / n * (b / n);
    let variances = (aa / n - (a / n).powi(2)) * (bb / n - (b / n).powi(2));
    (covariance / variances.max(1e-30).sqrt()) as f32
}
