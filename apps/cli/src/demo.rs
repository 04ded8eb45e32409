//! `blindaug demo`: the main job on a built-in clip of known truth.

use crate::console::{self, CONSOLE, Failure, Result, note};
use blindaug::{
    CameraModel, Encoded, Plane, Raster,
    composite::CompositeOptions,
    fit,
    metrics::{object_area, psnr},
    model::{
        Capture, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction, MotionBlurModel,
        NOISE_LEVELS, Reason, SceneScale, Unknown,
    },
    pyramid,
    synth::noise,
};
use blindaug_io::{
    DepthFormat, FrameSource, SideFolder, VideoWriter, make_folder, read_camera, read_frame,
    write_atomically, write_camera, write_png,
};
use blindaug_pipeline::{
    Footage, MemorySink,
    composite::{self, DepthMaps, Product, Scene},
    estimate,
};
use blindaug_report::{Picture, ReportInput, TruthRow};
use std::{
    collections::BTreeMap,
    fmt::Write,
    path::{Path, PathBuf},
};

/// Do the main job on a built-in clip of known truth: estimate, composite, report
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug demo -o demo")]
pub struct Demo {
    /// A folder for the results
    #[arg(short, long, value_name = "DIR", default_value = "blindaug-demo")]
    output: PathBuf,
}

/// The names and the bytes of files of the rendered clip.
macro_rules! files {
    ($($name:literal)*) => {
        [$(($name, include_bytes!(concat!("../assets/demo/", $name)) as &[u8])),*]
    };
}

/// `frames`: the footage; `scene`: its depth and flow; `virtual`: the object; `with` and `without`: renders of the scene with and without
/// the object; `truth_with`: the footage, without noise, if the object had really been there.
const CLIP: [(&str, &[u8]); 28] = files![
    "frames/0001.png" "frames/0002.png" "frames/0003.png" "frames/0004.png" "frames/0005.png"
    "scene/0001.exr" "scene/0002.exr" "scene/0003.exr" "scene/0004.exr" "scene/0005.exr"
    "virtual/0001.exr" "virtual/0002.exr" "virtual/0003.exr" "virtual/0004.exr" "virtual/0005.exr"
    "with/0001.png" "with/0002.png" "with/0003.png" "with/0004.png" "with/0005.png"
    "without/0001.png" "without/0002.png" "without/0003.png" "without/0004.png" "without/0005.png"
    "truth_with/0002.png" "truth_with/0003.png" "truth_with/0004.png"
];

/// The camera that rendered the clip.
const TRUTH: &str = include_str!("../assets/demo/truth.json");

/// The frame that is shown as a picture.
const SHOWN: u64 = 3;

/// Luminances at which noise is compared.
const LUMINANCES: [f32; 3] = [0.2, 0.5, 0.8];

/// The margin of the object's area around its silhouette, px. It holds the object's soft edge, and little of the frame, whose noise the
/// truth does not have.
const GROWN_BY: usize = 4;

/// The camera that rendered the clip.
struct Truth {
    exposure: f32,
    sigma_px_at_infinity: f32,
    focus_m: f32,
    /// Noise std of an encoded value I: readout + shot sqrt(I).
    readout: f32,
    shot: f32,
    fps: f64,
}

impl Truth {
    fn read() -> Result<Self> {
        let all: serde_json::Value =
            serde_json::from_str(TRUTH).map_err(|e| Failure(format!("the demo's truth.json: {e}")))?;
        let number = |path: &str| {
            let value = all.pointer(path).and_then(serde_json::Value::as_f64);
            value.ok_or_else(|| Failure(format!("the demo's truth.json has no {path}")))
        };
        Ok(Self {
            exposure: number("/demo/exposure")? as f32,
            sigma_px_at_infinity: number("/demo/lens/sigma_px_at_infinity")? as f32,
            focus_m: number("/demo/lens/focus_distance_m")? as f32,
            readout: number("/demo/noise/k_readout")? as f32,
            shot: number("/demo/noise/k_shot")? as f32,
            fps: number("/demo/fps")?,
        })
    }

    fn noise_std(&self, y: f32) -> f32 {
        self.readout + self.shot * y.max(0.0).sqrt()
    }

    /// A camera model with the true blur and without noise.
    fn model(&self, capture: Capture) -> CameraModel {
        let mut model = CameraModel::unknown(capture, "left out");
        model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(self.exposure)));
        model.defocus =
            Estimate::Known(DefocusModel::given_lens(self.sigma_px_at_infinity, self.focus_m.recip()));
        model
    }

    /// The frame with white noise of the true strength.
    fn with_noise(&self, frame: &Encoded) -> Encoded {
        let (width, height) = frame.0.size();
        let luma = frame.luma();
        let smaller = pyramid::halvings(&luma, NOISE_LEVELS - 1);
        let bands = noise::white_band_std();
        let noise = noise::modulated(noise::unit_bands(width, height, 1, SHOWN), |level, x, y| {
            let luma = if level == 0 { &luma } else { &smaller[level - 1] };
            [bands[level] * self.noise_std(luma.at(x, y)); 3]
        });
        Encoded(Raster::from_fn(width, height, |x, y| {
            let (a, b) = (frame.0.at(x, y), noise.at(x, y));
            [0, 1, 2].map(|c| a[c] + b[c])
        }))
    }
}

/// Runs the command.
// This function is long, since it lists the demo's steps in order.
pub fn run(args: &Demo) -> Result<()> {
    let out = &args.output;
    make_folder(out)?;
    let clip = out.join("clip");
    write_clip(&clip)?;
    let truth = Truth::read()?;

    // The camera is estimated from the frames alone, which is what the demo shows; then with their depth; then with sharp renders of the
    // scene too, which compositing shadows needs anyway.
    let (frames, depth) = (clip.join("frames"), clip.join("scene"));
    let options = fit::EstimatorOptions { fps: Some(truth.fps), ..fit::EstimatorOptions::default() };
    let fit = |depth_given: bool, clean: Option<&Path>| {
        let mut footage = Footage::new(FrameSource::open(&frames, Default::default())?);
        if depth_given {
            let maps = SideFolder::depth(&depth, DepthFormat::default())?;
            footage.depth = Some((Box::new(maps), DepthKind::Metric));
        }
        footage.clean = match clean {
            Some(clean) => Some(Box::new(SideFolder::frames(clean, "clean frames")?)),
            None => None,
        };
        let job = estimate::Job { options, keep_samples: !depth_given, ..estimate::Job::default() };
        Ok::<_, Failure>(estimate::estimate(&footage, job, CONSOLE)?)
    };
    let fitted = fit(false, None)?;
    let with_depth = fit(true, None)?;
    let all_given = fit(true, Some(&clip.join("without")))?;
    let estimated = &fitted.estimation.model;
    let camera = out.join("camera.json");
    write_camera(&camera, estimated)?;
    // What is composited here is what the file and the printed command say.
    let written = read_camera(&camera)?;

    let maps = || SideFolder::depth(&depth, DepthFormat::default());
    // Parallax tells depth without its unit, which the object's metres need.
    let scale = match &fitted.estimation.diagnostics.inverse_depth {
        Some((index, relative)) => {
            maps()?.get(*index as u64 + 1, relative.size())?.and_then(|metric| scene_scale(relative, &metric))
        }
        None => None,
    };
    let blind = match scale {
        Some(scale) => written.to_metric(scale),
        None => {
            let why = "no relation of its depth to metres was found";
            let mut model = written;
            model.defocus = Estimate::unknown(Reason::NoDepth, why);
            model
        }
    };
    let columns = [&blind, &with_depth.estimation.model, &all_given.estimation.model];

    let footage = Box::new(FrameSource::open(&frames, Default::default())?);
    let layers = Box::new(SideFolder::virtual_layers(clip.join("virtual"))?);
    let scene = Scene {
        depth: Some(DepthMaps::as_they_are(Box::new(maps()?))),
        flow: Some(Box::new(SideFolder::flow(clip.join("scene"))?)),
        renders: Some([
            Box::new(SideFolder::frames(clip.join("with"), "renders with the object")?),
            Box::new(SideFolder::frames(clip.join("without"), "renders without the object")?),
        ]),
        ..Scene::new(footage, layers)
    };
    let size = scene.footage.size();
    let made = |model: &CameraModel, noise: bool| {
        let mut made = MemorySink::default();
        let options = CompositeOptions { no_noise: !noise, ..CompositeOptions::default() };
        composite::composite(
            &scene,
            &model.clone().into(),
            (&options, Product::Composite),
            &mut made,
            CONSOLE,
        )?;
        stop_if_interrupted(out)?;
        Ok::<_, Failure>(made.frames)
    };
    let naive = made(&composite::naive(size, blind.transfer), false)?;
    let composites = made(&blind, true)?;
    for (name, frames) in [("naive", &naive), ("composite", &composites)] {
        let folder = out.join(name);
        make_folder(&folder)?;
        for (number, frame) in frames {
            write_png(folder.join(format!("{number:04}.png")), frame)?;
        }
    }

    // Composites without added noise are compared, since the truth has none.
    let compared = |model: &CameraModel| fidelity(&clip, &scene, &made(model, false)?);
    let fidelity = Fidelity {
        naive: fidelity(&clip, &scene, &naive)?,
        estimated: [compared(columns[0])?, compared(columns[1])?, compared(columns[2])?],
        oracle: compared(&truth.model(blind.capture))?,
    };
    let of_columns = columns.map(|model| comparison(model, &truth));
    console::print(&table(&of_columns, &fidelity))?;
    let named = |(given, rows): (&str, &Vec<TruthRow>)| -> Vec<TruthRow> {
        let row = |r: &TruthRow| TruthRow {
            name: format!("{given}: {}", r.name),
            estimated: r.estimated.clone(),
            truth: r.truth.clone(),
        };
        rows.iter().map(row).collect()
    };
    let rows: Vec<TruthRow> = GIVEN.into_iter().zip(&of_columns).flat_map(named).collect();

    let frame = read_frame(clip.join(format!("frames/{SHOWN:04}.png")))?;
    let real = truth.with_noise(&read_frame(clip.join(format!("truth_with/{SHOWN:04}.png")))?);
    let pictures: Vec<Picture> = [
        ("The frame", Some(&frame)),
        ("The object pasted naively", naive.get(&SHOWN)),
        ("The object with the camera that was estimated from the frames alone", composites.get(&SHOWN)),
        ("The truth: the object was really there", Some(&real)),
    ]
    .into_iter()
    .filter_map(|(title, image)| Some(Picture { title: title.into(), image: image?.clone() }))
    .collect();
    let images: Vec<&Encoded> = pictures.iter().map(|p| &p.image).collect();
    write_png(out.join("comparison.png"), &enlarged(&two_by_two(&images)))?;
    let video = write_video(&out.join("comparison.mp4"), &naive, &composites);
    let report = ReportInput {
        title: "The demo's camera".into(),
        model: estimated,
        diagnostics: &fitted.estimation.diagnostics,
        samples: fitted.samples,
        comparison: rows,
        pictures,
        numbers: fitted.numbers,
        provenance: Some(crate::provenance::of([frames.as_path()])?),
    };
    console::write_page(&out.join("report.html"), blindaug_report::page(&report))?;
    console::print(&next_steps(out, &clip, &camera, scale, video))
}

/// What is given to each of the demo's estimates.
const GIVEN: [&str; 3] = ["frames alone", "frames and depth", "all given"];

/// The relation of relative inverse depth to metric inverse depth of the same frame, by least squares, three times without the half that
/// fits worst; `None` if there is too little to compare.
fn scene_scale(relative: &Plane, metric: &Plane) -> Option<SceneScale> {
    const LEAST: usize = 100;
    let pairs = relative.data().iter().zip(metric.data()).map(|(r, m)| [*m, *r]);
    let mut pairs: Vec<[f32; 2]> = pairs.filter(|p| p.iter().all(|v| v.is_finite())).collect();
    let line = |pairs: &[[f32; 2]]| {
        let n = pairs.len() as f64;
        let mean = |of: &dyn Fn(&[f32; 2]) -> f64| pairs.iter().map(of).sum::<f64>() / n;
        let [x, y] = [mean(&|p| p[0].into()), mean(&|p| p[1].into())];
        let spread = mean(&|p| (f64::from(p[0]) - x).powi(2));
        let slope = mean(&|p| (f64::from(p[0]) - x) * (f64::from(p[1]) - y)) / spread;
        SceneScale { scale: slope as f32, offset: (y - slope * x) as f32 }
    };
    for _ in 0..3 {
        if pairs.len() < LEAST {
            return None;
        }
        let SceneScale { scale, offset } = line(&pairs);
        let off = |p: &[f32; 2]| (p[1] - scale * p[0] - offset).abs();
        pairs.sort_by(|a, b| off(a).total_cmp(&off(b)));
        pairs.truncate(pairs.len() / 2);
    }
    let SceneScale { scale, offset } = line(&pairs);
    // As many decimals as are printed.
    let rounded = |v: f32| (1e4 * v).round() / 1e4;
    let found = SceneScale { scale: rounded(scale), offset: rounded(offset) };
    Some(found).filter(|s| s.scale.is_finite() && s.scale > 0.0 && s.offset.is_finite())
}

fn write_clip(clip: &Path) -> Result<()> {
    for (name, bytes) in CLIP {
        let path = clip.join(name);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)
                .map_err(|e| console::failure(folder, format_args!("the folder cannot be made ({e})")))?;
        }
        write_atomically(&path, |partial| std::fs::write(partial, bytes))?;
    }
    Ok(())
}

fn stop_if_interrupted(out: &Path) -> Result<()> {
    if console::interrupted() {
        return Err(console::failure(out, "stopped; the demo is not complete"));
    }
    Ok(())
}

/// Mean PSNR over the object's area, against the render in which the object really was in front of the camera, dB.
struct Fidelity {
    naive: f64,
    /// With each of the estimated cameras, in the order of [`GIVEN`].
    estimated: [f64; 3],
    oracle: f64,
}

/// [`Fidelity`] of some composites.
fn fidelity(clip: &Path, scene: &Scene, composites: &BTreeMap<u64, Encoded>) -> Result<f64> {
    let truth = SideFolder::frames(clip.join("truth_with"), "the truth")?;
    let size = scene.footage.size();
    let (mut sum, mut compared) = (0.0, 0.0);
    for (&number, frame) in composites {
        let (Some(truth), Some(layer)) = (truth.get(number, size)?, scene.layers.get(number, size)?) else {
            continue;
        };
        let area = object_area(&layer.layer.color.0.map(|p| p[3]), GROWN_BY);
        sum += psnr(frame, &truth, Some(&area))
            .map_err(|e| console::failure(clip, format_args!("frame {number}: {e}")))?;
        compared += 1.0;
    }
    Ok(sum / compared)
}

/// The estimated parameters beside the true ones.
fn comparison(model: &CameraModel, truth: &Truth) -> Vec<TruthRow> {
    let row = |name: &str, estimated: String, truth: String| TruthRow { name: name.into(), estimated, truth };
    let text = |v: f32| format!("{v:.2}");
    let with_interval = |v: f32, i: Option<[f32; 2]>| match i {
        Some([lo, hi]) => format!("{v:.2} ({lo:.2} to {hi:.2})"),
        None => text(v),
    };
    let unknown = |e: Option<&Unknown>| match e {
        Some(why) => format!("unknown: {why}"),
        None => "unknown: not a thin lens".into(),
    };
    let exposure = model.motion_blur.known().map(|m| with_interval(m.exposure.0, Some(m.interval)));
    let lens = match model.defocus.known().map(|d| d.curve) {
        Some(DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval }) => {
            let metres = |[lo, hi]: [f32; 2]| [hi.recip(), lo.recip()];
            Some((
                with_interval(s, interval.map(|i| i.sigma_px_at_infinity)),
                with_interval(f.recip(), interval.map(|i| metres(i.focus_inverse_depth))),
            ))
        }
        _ => None,
    };
    let (sigma, focus) = lens.unzip();
    let why = || unknown(model.defocus.why_unknown());
    let mut rows = vec![
        row(
            "exposure, fraction of the frame interval",
            exposure.unwrap_or_else(|| unknown(model.motion_blur.why_unknown())),
            text(truth.exposure),
        ),
        row("blur at infinity, px", sigma.unwrap_or_else(why), text(truth.sigma_px_at_infinity)),
        row("focus distance, m", focus.unwrap_or_else(why), text(truth.focus_m)),
    ];
    for y in LUMINANCES {
        let std = model.noise.known().map(|n| n.total_std(y).iter().sum::<f32>() / 3.0);
        rows.push(row(
            &format!("noise std at luminance {y}, steps of 8 bit"),
            std.map_or_else(|| unknown(model.noise.why_unknown()), |s| text(255.0 * s)),
            text(255.0 * truth.noise_std(y)),
        ));
    }
    rows
}

/// The estimates of each of [`GIVEN`] beside the truth, and how well composites with them match it.
fn table(columns: &[Vec<TruthRow>; 3], fidelity: &Fidelity) -> String {
    let Fidelity { naive, estimated, oracle } = fidelity;
    let mut lines: Vec<[String; 5]> =
        vec![["".into(), GIVEN[0].into(), GIVEN[1].into(), GIVEN[2].into(), "true".into()]];
    for (i, row) in columns[0].iter().enumerate() {
        let [a, b, c] = [0, 1, 2].map(|k| columns[k][i].estimated.clone());
        lines.push([row.name.clone(), a, b, c, row.truth.clone()]);
    }
    let db = |v: f64| format!("{v:.1}");
    let [a, b, c] = estimated.map(db);
    lines.push([format!("composite, PSNR in dB (pasted on: {naive:.1})"), a, b, c, db(*oracle)]);
    let width = |k: usize| lines.iter().map(|l| l[k].chars().count()).max().unwrap_or(0);
    let widths = [0, 1, 2, 3, 4].map(width);
    let mut text = String::new();
    for line in &lines {
        let cells: Vec<String> =
            line.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        let _ = writeln!(text, "{}", cells.join("  ").trim_end());
    }
    text + "\nIn brackets: 95 % intervals. PSNR is over the object's area, against renders in which the object really was there.\n"
}

/// Images of one height in a row, with a white gap.
fn side_by_side(images: &[&Encoded]) -> Encoded {
    const GAP: usize = 4;
    let height = images.iter().map(|i| i.0.height()).max().unwrap_or(0);
    let mut row = Vec::new();
    for y in 0..height {
        for (i, image) in images.iter().enumerate() {
            if i > 0 {
                row.extend([[1.0; 3]; GAP]);
            }
            row.extend_from_slice(image.0.row(y));
        }
    }
    let width = row.len() / height.max(1);
    Encoded(Raster::from_fn(width, height, |x, y| row[y * width + x]))
}

/// Pictures of one size two by two, with white gaps.
fn two_by_two(images: &[&Encoded]) -> Encoded {
    let turned = |image: &Encoded| {
        let (w, h) = image.0.size();
        Encoded(Raster::from_fn(h, w, |x, y| image.0.at(y, x)))
    };
    let rows: Vec<Encoded> = images.chunks(2).map(|row| turned(&side_by_side(row))).collect();
    turned(&side_by_side(&rows.iter().collect::<Vec<_>>()))
}

/// The picture with each pixel as a square of several, so that noise and blur stay as they are.
fn enlarged(image: &Encoded) -> Encoded {
    const ZOOM: usize = 3;
    let (w, h) = image.0.size();
    Encoded(Raster::from_fn(ZOOM * w, ZOOM * h, |x, y| image.0.at(x / ZOOM, y / ZOOM)))
}

/// Writes a video of the naive composite beside the other one, played to and fro; without an encoder, a note says so. Returns whether the
/// video was written.
fn write_video(path: &Path, naive: &BTreeMap<u64, Encoded>, composites: &BTreeMap<u64, Encoded>) -> bool {
    const FPS: f64 = 10.0;
    const TURNS: usize = 2;
    let frames: Vec<Encoded> =
        naive.values().zip(composites.values()).map(|(a, b)| side_by_side(&[a, b])).collect();
    let Some(first) = frames.first() else { return false };
    let to_and_fro = || frames.iter().chain(frames.iter().rev().skip(1).take(frames.len().saturating_sub(2)));
    let written = VideoWriter::create(path, first.0.size(), FPS).and_then(|mut video| {
        for _ in 0..TURNS {
            for frame in to_and_fro() {
                video.write(frame)?;
            }
        }
        video.finish()
    });
    if let Err(e) = &written {
        note(format_args!("no video: {e}"));
    }
    written.is_ok()
}

fn next_steps(out: &Path, clip: &Path, camera: &Path, scale: Option<SceneScale>, video: bool) -> String {
    let video = if video { ", comparison.mp4 (naive beside the estimated camera)" } else { "" };
    let (out, clip, camera) = (out.display(), clip.display(), camera.display());
    let scale = scale.map_or(String::new(), |s| format!(" --scene-scale {:.4},{:.4}", s.scale, s.offset));
    format!(
        "\nwritten to {out}: comparison.png (frame and naive above, estimated from the frames alone and truth below){video}, naive/, composite/, camera.json, report.html\n\
         the same by hand, with the clip that is in {clip}:\n  \
         blindaug estimate {clip}/frames -o {camera}\n  \
         blindaug composite {clip}/frames --virtual {clip}/virtual --camera {camera}{scale} --depth {clip}/scene \
         --with {clip}/with --without {clip}/without -o {out}/by-hand\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_stand_side_by_side() {
        let image = |v: f32| Encoded(Raster::filled(3, 2, [v; 3]));
        let row = side_by_side(&[&image(0.1), &image(0.2)]);
        assert_eq!(row.0.size(), (10, 2));
        assert_eq!((row.0.at(2, 1)[0], row.0.at(3, 1)[0], row.0.at(7, 1)[0]), (0.1, 1.0, 0.2));
    }

    #[test]
    fn pictures_stand_two_by_two_and_are_enlarged() {
        let image = |v: f32| Encoded(Raster::filled(3, 2, [v; 3]));
        let [a, b, c, d] = [0.1, 0.2, 0.3, 0.4].map(image);
        let grid = two_by_two(&[&a, &b, &c, &d]);
        assert_eq!(grid.0.size(), (10, 8));
        let corners = [(0, 0), (9, 0), (0, 7), (9, 7)].map(|(x, y)| grid.0.at(x, y)[0]);
        assert_eq!(corners, [0.1, 0.2, 0.3, 0.4]);
        assert_eq!(grid.0.at(0, 3)[0], 1.0);
        let large = enlarged(&grid);
        assert_eq!((large.0.size(), large.0.at(29, 23)[0]), ((30, 24), 0.4));
    }

    #[test]
    fn the_scale_of_relative_depth_is_found_although_some_of_it_is_wrong() {
        let metric = Plane::from_fn(40, 30, |x, y| 0.1 + 0.02 * x as f32 + 0.001 * y as f32);
        let wrong = |x: usize, y: usize| (x + 3 * y).is_multiple_of(5);
        let relative =
            Plane::from_fn(40, 30, |x, y| if wrong(x, y) { 0.9 } else { 0.5 * metric.at(x, y) + 0.1 });
        let found = scene_scale(&relative, &metric).unwrap();
        assert!((found.scale - 0.5).abs() < 1e-3 && (found.offset - 0.1).abs() < 1e-3, "{found:?}");
        assert_eq!(scene_scale(&Plane::filled(40, 30, f32::NAN), &metric), None);
    }

    #[test]
    fn the_truth_is_there() {
        let truth = Truth::read().unwrap();
        assert!(truth.exposure > 0.0 && truth.focus_m > 0.0 && truth.noise_std(0.5) > truth.noise_std(0.1));
        let image = Encoded(Raster::filled(64, 64, [0.5; 3]));
        let noisy = truth.with_noise(&image);
        let variance = noisy.0.data().iter().map(|p| (p[1] - 0.5).powi(2)).sum::<f32>() / 4096.0;
        assert!((variance.sqrt() / truth.noise_std(0.5) - 1.0).abs() < 0.1);
    }
}
