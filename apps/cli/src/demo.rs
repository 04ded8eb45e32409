//! `blindaug demo`: the main job on a built-in clip of known truth.

use blindaug::{
    CameraModel, Encoded, Raster,
    composite::CompositeOptions,
    fit,
    metrics::{object_area, psnr},
    model::{
        Capture, DefocusCurve, DefocusModel, DepthKind, Estimate, ExposureFraction, MotionBlurModel,
        NOISE_LEVELS, Unknown,
    },
    pyramid,
    synth::noise,
};
use blindaug_cli::console::{self, CONSOLE, Failure, Result, note};
use blindaug_io::{
    DepthFormat, FrameSource, SideFolder, VideoWriter, make_folder, read_frame, write_atomically,
    write_camera, write_png,
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

    // The camera is estimated once from the frames and their depth alone, and once with the sharp renders of the scene, which compositing
    // shadows needs anyway. This clip is small and hard: the object stands where the blind estimate is least sure.
    let (frames, depth) = (clip.join("frames"), clip.join("scene"));
    let options = fit::EstimatorOptions { fps: Some(truth.fps), ..fit::EstimatorOptions::default() };
    let fit = |clean: Option<&Path>, keep_samples: bool| {
        let mut footage = Footage::new(FrameSource::open(&frames, Default::default())?);
        footage.depth =
            Some((Box::new(SideFolder::depth(&depth, DepthFormat::default())?), DepthKind::Metric));
        footage.clean = match clean {
            Some(clean) => Some(Box::new(SideFolder::frames(clean, "clean frames")?)),
            None => None,
        };
        let job = estimate::Job { options, keep_samples, ..estimate::Job::default() };
        Ok::<_, Failure>(estimate::estimate(&footage, job, CONSOLE)?)
    };
    let blind = fit(None, false)?;
    let fitted = fit(Some(&clip.join("without")), true)?;
    let model = &fitted.estimation.model;
    let camera = out.join("camera.json");
    write_camera(&camera, model)?;

    let depth = SideFolder::depth(&depth, DepthFormat::default())?;
    let footage = Box::new(FrameSource::open(&frames, Default::default())?);
    let layers = Box::new(SideFolder::virtual_layers(clip.join("virtual"))?);
    let scene = Scene {
        depth: Some(DepthMaps::as_they_are(Box::new(depth))),
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
    let naive = made(&composite::naive(size), false)?;
    let composites = made(model, true)?;
    for (name, frames) in [("naive", &naive), ("composite", &composites)] {
        let folder = out.join(name);
        make_folder(&folder)?;
        for (number, frame) in frames {
            write_png(folder.join(format!("{number:04}.png")), frame)?;
        }
    }

    let fidelity = Fidelity::measure(
        &clip,
        &scene,
        [&naive, &made(model, false)?, &made(&truth.model(model.capture), false)?],
    )?;
    let mut rows = comparison(model, &truth);
    let blind_rows = comparison(&blind.estimation.model, &truth).into_iter().take(3);
    rows.extend(
        blind_rows.map(|row| TruthRow { name: format!("from the frames alone: {}", row.name), ..row }),
    );
    console::print(&table(&rows, &fidelity))?;

    let frame = read_frame(clip.join(format!("frames/{SHOWN:04}.png")))?;
    let real = truth.with_noise(&read_frame(clip.join(format!("truth_with/{SHOWN:04}.png")))?);
    let pictures: Vec<Picture> = [
        ("The frame", Some(&frame)),
        ("The object pasted naively", naive.get(&SHOWN)),
        ("The object with the estimated camera", composites.get(&SHOWN)),
        ("The truth: the object was really there", Some(&real)),
    ]
    .into_iter()
    .filter_map(|(title, image)| Some(Picture { title: title.into(), image: image?.clone() }))
    .collect();
    let images: Vec<&Encoded> = pictures.iter().map(|p| &p.image).collect();
    write_png(out.join("comparison.png"), &side_by_side(&images))?;
    let video = write_video(&out.join("comparison.mp4"), &naive, &composites);
    let report = ReportInput {
        title: "The demo's camera".into(),
        model,
        diagnostics: &fitted.estimation.diagnostics,
        samples: fitted.samples,
        comparison: rows,
        pictures,
    };
    console::write_page(&out.join("report.html"), blindaug_report::page(&report))?;
    console::print(&next_steps(out, &clip, &camera, video))
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
    estimated: f64,
    oracle: f64,
}

impl Fidelity {
    /// Compares composites without added noise, since the truth has none.
    fn measure(clip: &Path, scene: &Scene, composites: [&BTreeMap<u64, Encoded>; 3]) -> Result<Self> {
        let truth = SideFolder::frames(clip.join("truth_with"), "the truth")?;
        let size = scene.footage.size();
        let mut sums = [0.0; 3];
        let mut compared = 0.0;
        for &number in composites[0].keys() {
            let (Some(truth), Some(layer)) = (truth.get(number, size)?, scene.layers.get(number, size)?)
            else {
                continue;
            };
            let area = object_area(&layer.color.0.map(|p| p[3]), GROWN_BY);
            for (sum, frames) in sums.iter_mut().zip(composites) {
                let Some(frame) = frames.get(&number) else { continue };
                *sum += psnr(frame, &truth, Some(&area))
                    .map_err(|e| console::failure(clip, format_args!("frame {number}: {e}")))?;
            }
            compared += 1.0;
        }
        let [naive, estimated, oracle] = sums.map(|sum| sum / compared);
        Ok(Self { naive, estimated, oracle })
    }
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

fn table(rows: &[TruthRow], fidelity: &Fidelity) -> String {
    let name_width = rows.iter().map(|r| r.name.len()).max().unwrap_or(0);
    let width = rows.iter().map(|r| r.estimated.len()).max().unwrap_or(0).max(9);
    let mut text = format!("{:name_width$}  {:width$}  true\n", "", "estimated");
    for TruthRow { name, estimated, truth } in rows {
        let _ = writeln!(text, "{name:name_width$}  {estimated:width$}  {truth}");
    }
    let Fidelity { naive, estimated, oracle } = fidelity;
    let _ = writeln!(
        text,
        "\ncomposite against the truth, PSNR over the object's area: naive {naive:.1} dB, estimated camera {estimated:.1} dB, true camera {oracle:.1} dB"
    );
    text
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

/// Writes a video of the naive composite beside the other one, played to and fro; without an encoder, a note says so. Returns whether the
/// video was written.
fn write_video(path: &Path, naive: &BTreeMap<u64, Encoded>, composites: &BTreeMap<u64, Encoded>) -> bool {
    const FPS: f64 = 10.0;
    const TURNS: usize = 4;
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

fn next_steps(out: &Path, clip: &Path, camera: &Path, video: bool) -> String {
    let video = if video { ", comparison.mp4 (naive beside the estimated camera)" } else { "" };
    let (out, clip, camera) = (out.display(), clip.display(), camera.display());
    format!(
        "\nwritten to {out}: comparison.png (frame, naive, estimated camera, truth){video}, naive/, composite/, camera.json, report.html\n\
         the same by hand, with the clip that is in {clip}:\n  \
         blindaug estimate {clip}/frames --depth {clip}/scene --clean {clip}/without -o {camera}\n  \
         blindaug composite {clip}/frames --virtual {clip}/virtual --camera {camera} --depth {clip}/scene \
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
    fn the_truth_is_there() {
        let truth = Truth::read().unwrap();
        assert!(truth.exposure > 0.0 && truth.focus_m > 0.0 && truth.noise_std(0.5) > truth.noise_std(0.1));
        let image = Encoded(Raster::filled(64, 64, [0.5; 3]));
        let noisy = truth.with_noise(&image);
        let variance = noisy.0.data().iter().map(|p| (p[1] - 0.5).powi(2)).sum::<f32>() / 4096.0;
        assert!((variance.sqrt() / truth.noise_std(0.5) - 1.0).abs() < 0.1);
    }
}
