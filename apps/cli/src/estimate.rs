//! `blindaug estimate`: a camera model from footage.

use crate::{
    arguments::{ByHandArgs, known_distance},
    console::{self, CONSOLE, Failure, Result, failure, note},
    source::SourceArgs,
};
use blindaug::{
    Plane, Transfer,
    fit::{Curve, Estimation, EstimatorOptions, Family},
    model::{BlurSpace, CameraModel, DepthKind, KnownDistance, NoiseKind, Space, Stopped},
};
use blindaug_io::{
    CameraTrackWriter, DepthFormat, DepthValues, EvidenceWriter, Inputs, PaperScene, SideFolder, write_camera,
};
use blindaug_pipeline::{BoxedSide, ByHand, Footage, Networks, Side, estimate, track};
use blindaug_report::{Provenance, ReportInput, TrackReportInput, words};
use clap::ValueEnum;
use std::{
    fmt::Write,
    path::{Path, PathBuf},
};

/// Estimate a camera's noise, motion blur and defocus from its footage
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug estimate shot.mp4 -o camera.json --report report.html")]
pub struct Estimate {
    /// A video, one image, or a folder of images in the order of the numbers in their names
    #[arg(required_unless_present = "evidence")]
    input: Option<PathBuf>,
    /// Where to write the camera model
    #[arg(
        help_heading = "Results",
        short,
        long,
        value_name = "camera.json",
        required_unless_present = "json"
    )]
    output: Option<PathBuf>,
    /// Print the camera model as JSON on standard output, in place of its description in words; with --track a line for each frame, once the
    /// noise of the frames around it is known, at most 624 frames later
    #[arg(help_heading = "Results", long)]
    json: bool,
    #[command(flatten)]
    depth: DepthArgs,
    /// Optical flow to the next frame, in px: .flo, or EXR with forward.u and forward.v [default: estimated]
    #[arg(help_heading = "Evidence", long, value_name = "DIR")]
    flow: Option<PathBuf>,
    /// The frames without noise and blur, as far as they are known
    #[arg(help_heading = "Evidence", long, value_name = "DIR")]
    clean: Option<PathBuf>,
    /// A folder in the layout of the paper's data (original, denoised, .., flow, each with a folder per scene)
    #[arg(help_heading = "Evidence", long, value_name = "DIR", requires = "scene")]
    evidence: Option<PathBuf>,
    /// The scene in the folder of --evidence
    #[arg(help_heading = "Evidence", long, value_name = "NAME", requires = "evidence")]
    scene: Option<String>,
    /// How blur is estimated: from local spectra, or by its removal (with --clean: by comparison with those frames; else with
    /// networks, see --network); auto takes what is surer
    #[arg(help_heading = "Estimation", long, value_enum, default_value = "auto")]
    method: MethodArg,
    /// A network that removes noise or blur, or finds flow or depth: a name of `blindaug models list`, or a manifest; may be
    /// repeated. `none`: no network [default: with --method removal the built-in ones]
    #[arg(help_heading = "Estimation", long, value_name = "NAME")]
    network: Vec<String>,
    /// Write what the estimate rests on, every frame used, in the layout that --evidence reads
    #[arg(help_heading = "Results", long, value_name = "DIR", conflicts_with_all = ["evidence", "track"])]
    save_evidence: Option<PathBuf>,
    #[command(flatten)]
    source: SourceArgs,
    /// A place in the picture whose distance is known, px and m, such as 640,360=2.5m; once, or twice for two places. It brings relative
    /// depth to metres
    #[arg(help_heading = "Evidence", long, value_name = "X,Y=METRES", value_parser = known_distance)]
    at: Vec<KnownDistance>,
    /// Frames per second, where the input does not say it
    #[arg(help_heading = "Frames", long, value_name = "N", value_parser = crate::arguments::frame_rate)]
    fps: Option<f64>,
    /// The curve of defocus over inverse depth
    #[arg(help_heading = "Estimation", long, value_enum, default_value = "thin-lens")]
    curve: CurveArg,
    /// The values that shutter and lens act on: light, as real ones do, or encoded values, as in the paper
    #[arg(help_heading = "Estimation", long, value_enum, default_value = "linear")]
    blur_in: BlurIn,
    /// The noise model: curves over the picture's colour with what channels and frames share, or the paper's straight lines over luminance
    #[arg(help_heading = "Estimation", long, value_enum, default_value = "curves")]
    noise_model: NoiseModelArg,
    #[command(flatten)]
    by_hand: ByHandArgs,
    /// Follow the camera: a model for each frame, as JSON lines, instead of one for all
    #[arg(help_heading = "Estimation", long, conflicts_with_all = ["clean", "evidence"])]
    track: bool,
    /// Also write a report: one HTML file with what the estimate rests on
    #[arg(help_heading = "Results", long, value_name = "FILE.html")]
    report: Option<PathBuf>,
}

/// The folder of depth and its format.
#[derive(clap::Args)]
pub struct DepthArgs {
    /// Depth: EXR with Z in metres, or PNG or PGM of 16 bit in millimetres
    #[arg(help_heading = "Evidence", long, value_name = "DIR")]
    depth: Option<PathBuf>,
    /// Units per metre in integer depth files
    #[arg(help_heading = "Evidence", long, value_name = "N", default_value = "1000", value_parser = crate::arguments::positive, requires = "depth")]
    depth_scale: f32,
    /// The kind of the depth's values
    #[arg(help_heading = "Evidence", long, value_enum, default_value = "metric", requires = "depth")]
    depth_kind: DepthKindArg,
}

impl DepthArgs {
    /// The folder of depth, if one is given.
    pub fn folder(&self) -> Option<&PathBuf> {
        self.depth.as_ref()
    }

    /// The depth maps and their kind, if a folder is given.
    pub fn open(&self) -> Result<Option<(SideFolder<Plane>, DepthKind)>> {
        let (values, kind) = match self.depth_kind {
            DepthKindArg::Metric => (DepthValues::Metric, DepthKind::Metric),
            DepthKindArg::Inverse => (DepthValues::Inverse, DepthKind::Metric),
            DepthKindArg::RelativeInverse => (DepthValues::RelativeInverse, DepthKind::Relative),
        };
        let Some(path) = &self.depth else { return Ok(None) };
        let format = DepthFormat { values, per_metre: self.depth_scale };
        Ok(Some((opened(SideFolder::depth(path, format)?), kind)))
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum MethodArg {
    Auto,
    Spectral,
    Removal,
}

#[derive(Clone, Copy, ValueEnum)]
enum CurveArg {
    ThinLens,
    Quadratic,
}

#[derive(Clone, Copy, ValueEnum)]
enum NoiseModelArg {
    Curves,
    Lines,
}

#[derive(Clone, Copy, ValueEnum)]
enum BlurIn {
    Linear,
    Encoded,
}

#[derive(Clone, Copy, ValueEnum)]
enum DepthKindArg {
    /// Depth along the view axis
    Metric,
    /// Inverse depth, 1/m
    Inverse,
    /// Inverse depth of unknown scale, larger is nearer
    RelativeInverse,
}

/// Runs the command.
pub fn run(args: &Estimate) -> Result<()> {
    let mut options = args.options();
    let inputs = args.inputs();
    console::check_outputs(
        &inputs,
        [args.output.as_ref(), args.report.as_ref()].into_iter().flatten().map(PathBuf::as_path),
    )?;
    if args.track {
        return run_track(args, &options);
    }
    let (footage, source, transfer, saved_fps) = args.footage()?;
    options = with_transfer(options, transfer);
    options.fps = options.fps.or(saved_fps);
    let mut networks = Networks::for_estimate(&args.network, options.family, &footage, CONSOLE)?;
    let save = args.save_evidence.as_deref();
    let mut save = save.map(|d| EvidenceWriter::new(d, &source, &inputs)).transpose()?;
    let job = estimate::Job {
        options,
        keep_samples: args.report.is_some(),
        operators: Some(&mut networks),
        save: save.as_mut().map(|s| s as &mut dyn blindaug_pipeline::EvidenceSink),
    };
    let fitted = estimate::estimate(&footage, job, CONSOLE)?;
    let Estimation { model, diagnostics } = &fitted.estimation;
    if let Some(save) = &mut save {
        save.finish(options.fps.or(footage.clip.fps()))?;
        tell_evidence(save);
    }
    let set = match &args.at[..] {
        [] => Ok(model.clone()),
        known => model.scale_by(known).map(|scale| model.clone().to_metric(scale)),
    };
    let model = &match set.and_then(|model| args.by_hand.parts().applied(model)) {
        Ok(model) => model,
        Err(e) => {
            let Some(output) = &args.output else { return Err(Failure(e.to_string())) };
            // An estimate that took long is not thrown away.
            write_camera(output, model)?;
            return Err(failure(output, format_args!("written as it was estimated, since {e}")));
        }
    };
    if let Some(output) = &args.output {
        write_camera(output, model)?;
    }
    let mut text = words::words(model, &[]);
    for sentence in &diagnostics.notes {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "Note       {sentence}");
    }
    if !diagnostics.shots.is_empty() {
        let _ = writeln!(
            text,
            "Note       --frames FIRST..LAST estimates one shot alone, --track a model for each frame"
        );
    }
    args.tell(&text, &model.to_json())?;
    if let Some(path) = &args.report {
        let input = ReportInput {
            samples: fitted.samples,
            numbers: fitted.numbers,
            provenance: Some(args.provenance(&source)?),
            ..ReportInput::new(&report_title(&source), model, diagnostics)
        };
        console::write_page(path, blindaug_report::page(&input))?;
        note(format_args!("written: {}", path.display()));
    }
    stopped(
        model,
        args.output.as_deref().unwrap_or(&source),
        format_args!(
            "stopped: the model rests on frames {} to {}; run it again for all, or with --frames {}.. and another -o for the others",
            fitted.first,
            fitted.last,
            fitted.last + 1
        ),
    )
}

/// Writes the models of a clip's frames, and prints them as a table.
fn run_track(args: &Estimate, options: &EstimatorOptions) -> Result<()> {
    if options.family == Family::Removal || options.curve == Curve::Quadratic {
        return Err(Failure(
            "--track looks at local spectra and fits a thin lens: leave --method and --curve out".into(),
        ));
    }
    if !args.at.is_empty() {
        return Err(Failure("--track holds no depth of one frame: give --at without it".into()));
    }
    if args.by_hand.parts() != ByHand::default() {
        return Err(Failure(
            "--track follows the footage: set parts by hand where the track is applied".into(),
        ));
    }
    let mut networks = Networks::named(&args.network, false, CONSOLE)?;
    if networks.remove() {
        return Err(Failure("--track does not remove blur: name only networks of flow and depth".into()));
    }
    let (footage, source, transfer, _) = args.footage()?;
    let options = &with_transfer(*options, transfer);
    let job = track::Job {
        space: options.space,
        noise_kind: options.noise_kind,
        fps: options.fps,
        keep_samples: args.report.is_some(),
        operators: Some(&mut networks),
    };
    let mut writer = args.output.as_ref().map(CameraTrackWriter::create).transpose()?;
    let mut printed = Ok(());
    let tracked = track::track(&footage, job, CONSOLE, &mut |camera| {
        if let Some(writer) = &mut writer {
            writer.write(camera)?;
        }
        if args.json && printed.is_ok() {
            printed = console::print(&(camera.to_json_line() + "\n"));
        }
        Ok(())
    })?;
    printed?;
    writer.map(CameraTrackWriter::finish).transpose()?;
    // The lines are printed already.
    args.tell(&words::table(&tracked.track), "")?;
    if let Some(path) = &args.report {
        let (title, samples) = (report_title(&source), tracked.samples);
        let provenance = Some(args.provenance(&source)?);
        let input = TrackReportInput { title, track: &tracked.track, samples, provenance };
        console::write_page(path, blindaug_report::track_page(&input))?;
        note(format_args!("written: {}", path.display()));
    }
    let frames = tracked.track.frames();
    stopped(
        &frames[frames.len() - 1].camera,
        args.output.as_deref().unwrap_or(&source),
        format_args!(
            "stopped: it holds frames {} to {}; for the others, run it again with --frames {}.. and another -o",
            tracked.first,
            tracked.last,
            tracked.last + 1
        ),
    )
}

/// Fails with a sentence if the estimation was stopped before the end of the clip.
fn stopped(model: &CameraModel, output: &Path, sentence: std::fmt::Arguments) -> Result<()> {
    match model.stopped {
        Some(Stopped { .. }) => Err(failure(output, sentence)),
        None => Ok(()),
    }
}

/// Says where evidence was written and how it is read again.
fn tell_evidence(writer: &EvidenceWriter) {
    let (folder, scene) = (writer.folder().display(), writer.scene());
    note(format_args!("evidence written: {folder} (read again by --evidence {folder} --scene {scene})"));
    if let Some(scale) = writer.depth_scale() {
        note(format_args!("its depth is inverse depth divided by {scale:.4}"));
    }
}

impl Estimate {
    /// Prints the result, in words or as JSON, and says what was written.
    fn tell(&self, words: &str, json: &str) -> Result<()> {
        match (&self.output, self.json) {
            (_, true) => console::print(json)?,
            (Some(output), false) => console::print_words_beside(output, words)?,
            (None, false) => console::print_words(words)?,
        }
        if let Some(output) = &self.output {
            note(format_args!("written: {}", output.display()));
        }
        Ok(())
    }

    /// Where the estimate comes from: the frames, and the folders of evidence that were given.
    fn provenance(&self, source: &Path) -> Result<Provenance> {
        let given = [&self.depth.depth, &self.flow, &self.clean].into_iter().flatten().map(PathBuf::as_path);
        crate::provenance::of([source].into_iter().chain(given))
    }

    /// All files and folders that the command reads.
    fn inputs(&self) -> Inputs {
        let mut paths: Vec<PathBuf> = [&self.input, &self.depth.depth, &self.flow, &self.clean]
            .into_iter()
            .flatten()
            .cloned()
            .collect();
        if let (Some(dir), Some(scene)) = (&self.evidence, &self.scene) {
            paths.extend(PaperScene::folders(dir, scene));
        }
        paths.extend(self.network.iter().map(PathBuf::from));
        Inputs::of(paths)
    }

    fn options(&self) -> EstimatorOptions {
        EstimatorOptions {
            family: match self.method {
                MethodArg::Auto => Family::Auto,
                MethodArg::Spectral => Family::Spectral,
                MethodArg::Removal => Family::Removal,
            },
            curve: match self.curve {
                CurveArg::ThinLens => Curve::ThinLens,
                CurveArg::Quadratic => Curve::Quadratic,
            },
            space: match self.blur_in {
                BlurIn::Linear => BlurSpace::Linear,
                BlurIn::Encoded => BlurSpace::Encoded,
            }
            .into(),
            noise_kind: match self.noise_model {
                NoiseModelArg::Curves => NoiseKind::Curves,
                NoiseModelArg::Lines => NoiseKind::Lines,
            },
            fps: self.fps,
        }
    }

    /// The footage with its evidence, the path of its frames, and their curve.
    ///
    /// The frame rate is that which was saved with the evidence, if any.
    fn footage(&self) -> Result<(Footage, PathBuf, Transfer, Option<f64>)> {
        let paper = match (&self.evidence, &self.scene) {
            (Some(dir), Some(scene)) => Some(PaperScene::open(dir, scene)?),
            _ => None,
        };
        let Some(input) = self.input.as_ref().or(paper.as_ref().map(|p| &p.original)) else {
            return Err(Failure("no input was given".into()));
        };
        let source = self.source.open(input)?;
        let (path, transfer) = (source.path().to_path_buf(), source.space().transfer);
        let reading = source.reading();
        let mut footage = Footage::new(source);
        let fps = paper.as_ref().and_then(|p| p.saved.as_ref()?.fps);
        if let Some(paper) = paper {
            footage.depth = paper.depth.map(|d| (Box::new(opened(d)) as _, DepthKind::Relative));
            footage.flow = paper.flow.map(boxed);
            footage.denoised = paper.denoised.map(boxed);
            footage.motion_deblurred = paper.de_motion_blurred.map(boxed);
            let last = paper.de_focus_blurred.map(boxed);
            // Frames from which motion blur was not removed still have it.
            match footage.motion_deblurred {
                Some(_) => footage.clean = last,
                None => footage.defocus_deblurred = last,
            }
            footage.by_network = true;
            if let Some(saved) = &paper.saved {
                footage.by_network = saved.by_network;
                footage.flow_found = saved.flow_found;
                if let (Some((_, kind)), Some(saved)) = (&mut footage.depth, saved.depth_kind) {
                    *kind = saved;
                }
                if saved.clean {
                    footage.clean = footage.clean.or(footage.defocus_deblurred.take());
                }
            }
        }
        if let Some((depth, kind)) = self.depth.open()? {
            footage.depth = Some((Box::new(depth), kind));
        }
        if let Some(path) = &self.flow {
            footage.flow = Some(boxed(SideFolder::flow(path)?));
        }
        if let Some(path) = &self.clean {
            footage.clean = Some(boxed(SideFolder::frames_beside(path, "clean frames", reading)?));
            footage.by_network = false;
        }
        Ok((footage, path, transfer, fps))
    }
}

fn report_title(input: &Path) -> String {
    format!("The camera of {}", input.file_name().unwrap_or(input.as_os_str()).to_string_lossy())
}

/// Prints the notes about a folder, and returns it.
pub fn opened<T>(folder: SideFolder<T>) -> SideFolder<T> {
    for sentence in folder.notes() {
        note(format_args!("{}: {sentence}", folder.path().display()));
    }
    folder
}

/// Does the same as [`opened`], and boxes the folder for [`Footage`].
pub fn boxed<T: 'static>(folder: SideFolder<T>) -> BoxedSide<T>
where
    SideFolder<T>: Side<T>,
{
    Box::new(opened(folder))
}

fn with_transfer(options: EstimatorOptions, transfer: Transfer) -> EstimatorOptions {
    EstimatorOptions { space: Space { transfer, ..options.space }, ..options }
}
