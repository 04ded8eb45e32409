//! `blindaug estimate`: a camera model from footage.

use crate::{
    console::{self, Failure, Progress, Result, failure, note, warn},
    networks::{EvidenceWriter, Networks, or_removed},
};
use blindaug::{
    Encoded, Flow, Plane, analysis,
    fit::{
        Curve, Estimation, Estimator, EstimatorOptions, Evidence, Family, FrameObservation, Shot,
        track::Tracker,
    },
    model::{BlurSpace, CameraTrack, DepthKind, Stopped, TrackedCamera},
};
use blindaug_io::{
    CameraTrackWriter, DepthFormat, DepthValues, Frame, FrameRange, FrameSource, Inputs, PaperScene,
    SideFolder, memory, write_camera,
};
use blindaug_nets::Removed;
use blindaug_report::{ReportInput, Sample, TrackReportInput, words};
use clap::ValueEnum;
use std::{
    collections::VecDeque,
    fmt::Write,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

/// Estimate a camera's noise, motion blur and defocus from its footage
#[derive(clap::Args)]
pub struct Estimate {
    /// A video, one image, or a folder of images in the order of the numbers in their names
    #[arg(required_unless_present = "evidence")]
    input: Option<PathBuf>,
    /// Where to write the camera model
    #[arg(short, long, value_name = "camera.json")]
    output: PathBuf,
    #[command(flatten)]
    depth: DepthArgs,
    /// Optical flow to the next frame, in px: .flo, or EXR with forward.u and forward.v [default: estimated]
    #[arg(long, value_name = "DIR")]
    flow: Option<PathBuf>,
    /// The frames without noise and blur, as far as they are known
    #[arg(long, value_name = "DIR")]
    clean: Option<PathBuf>,
    /// A folder in the layout of the paper's data (original, denoised, .., flow, each with a folder per scene)
    #[arg(long, value_name = "DIR", requires = "scene")]
    evidence: Option<PathBuf>,
    /// The scene in the folder of --evidence
    #[arg(long, value_name = "NAME", requires = "evidence")]
    scene: Option<String>,
    /// How blur is estimated: from local spectra, or by its removal (with --clean: by comparison with those frames; else with
    /// networks, see --network); auto takes what is surer
    #[arg(long, value_enum, default_value = "auto")]
    method: MethodArg,
    /// A network that removes noise or blur, or finds flow or depth: a name of `blindaug models list`, or a manifest; may be
    /// repeated. `none`: no network [default: with --method removal the built-in ones]
    #[arg(long, value_name = "NAME")]
    network: Vec<String>,
    /// Write what the estimate rests on, every frame used, in the layout that --evidence reads
    #[arg(long, value_name = "DIR", conflicts_with_all = ["evidence", "track"])]
    save_evidence: Option<PathBuf>,
    /// Use only these frames, by number, both ends included
    #[arg(long, value_name = "FIRST..LAST")]
    frames: Option<FrameRange>,
    /// Frames per second, where the input does not say it
    #[arg(long, value_name = "N", value_parser = crate::frame_rate)]
    fps: Option<f64>,
    /// The curve of defocus over inverse depth
    #[arg(long, value_enum, default_value = "thin-lens")]
    curve: CurveArg,
    /// What shutter and lens act on: light, as real ones do, or encoded values, as in the paper
    #[arg(long, value_enum, default_value = "linear")]
    blur_in: BlurIn,
    /// Follow the camera: a model for each frame, as JSON lines, instead of one for all
    #[arg(long, conflicts_with_all = ["clean", "evidence"])]
    track: bool,
    /// Also write a report: one HTML file with what the estimate rests on
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
}

/// Depth and how to read it.
#[derive(clap::Args)]
pub struct DepthArgs {
    /// Depth: EXR with Z in metres, or PNG or PGM of 16 bit in millimetres
    #[arg(long, value_name = "DIR")]
    depth: Option<PathBuf>,
    /// Units per metre in integer depth files
    #[arg(long, value_name = "N", default_value = "1000", value_parser = crate::positive, requires = "depth")]
    depth_scale: f32,
    /// What the depth's numbers are
    #[arg(long, value_enum, default_value = "metric", requires = "depth")]
    depth_kind: DepthKindArg,
}

impl DepthArgs {
    /// Depth files in a folder, in metres.
    pub fn metric(folder: &Path) -> Self {
        let DepthFormat { per_metre, .. } = DepthFormat::default();
        Self { depth: Some(folder.into()), depth_scale: per_metre, depth_kind: DepthKindArg::Metric }
    }

    /// The folder.
    pub fn folder(&self) -> Option<&PathBuf> {
        self.depth.as_ref()
    }

    /// The depth maps, and what they are in.
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
    let options = EstimatorOptions {
        family: match args.method {
            MethodArg::Auto => Family::Auto,
            MethodArg::Spectral => Family::Spectral,
            MethodArg::Removal => Family::Removal,
        },
        curve: match args.curve {
            CurveArg::ThinLens => Curve::ThinLens,
            CurveArg::Quadratic => Curve::Quadratic,
        },
        blur_space: match args.blur_in {
            BlurIn::Linear => BlurSpace::Linear,
            BlurIn::Encoded => BlurSpace::Encoded,
        },
        fps: args.fps,
    };
    let inputs = args.inputs();
    console::check_outputs(
        &inputs,
        [Some(&args.output), args.report.as_ref()].into_iter().flatten().map(PathBuf::as_path),
    )?;
    if args.track {
        if options.family == Family::Removal || options.curve == Curve::Quadratic {
            return Err(Failure(
                "--track looks at local spectra and fits a thin lens: leave --method and --curve out".into(),
            ));
        }
        let networks = Networks::named(&args.network, false)?;
        if networks.remove() {
            return Err(Failure("--track does not remove blur: name only networks of flow and depth".into()));
        }
        return track(&Footage::open(args)?, networks, options, &args.output, args.report.as_deref());
    }
    let footage = Footage::open(args)?;
    let given = footage.has_removed();
    let networks = Networks::named(&args.network, options.family == Family::Removal && !given)?;
    if networks.remove() && (given || options.family == Family::Spectral) {
        let why = if given { "such frames are given" } else { "--method spectral removes nothing" };
        return Err(Failure(format!("{why}: name only networks of flow and depth")));
    }
    if !networks.is_empty() {
        note(format_args!("networks: {}", networks.names()));
    }
    let save = args.save_evidence.as_deref();
    let save = save.map(|d| EvidenceWriter::new(d, footage.source.path(), &inputs)).transpose()?;
    let fitted = fit(&footage, networks, save, options, args.report.is_some())?;
    let Estimation { model, diagnostics } = &fitted.estimation;
    write_camera(&args.output, model)?;
    let mut text = words::words(model, &[]);
    for sentence in &diagnostics.notes {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "Note       {sentence}");
    }
    console::print_beside(&args.output, &text)?;
    note(format_args!("written: {}", args.output.display()));
    if let Some(path) = &args.report {
        let input = ReportInput {
            title: report_title(&footage.source),
            model,
            diagnostics,
            samples: fitted.samples,
            comparison: Vec::new(),
            pictures: Vec::new(),
        };
        console::write_page(path, blindaug_report::page(&input))?;
        note(format_args!("written: {}", path.display()));
    }
    if model.stopped.is_some() {
        let (first, last) = (fitted.first, fitted.last);
        return Err(failure(
            &args.output,
            format_args!(
                "stopped: the model rests on frames {first} to {last}; for the others, run it again with --frames {}..",
                last + 1
            ),
        ));
    }
    Ok(())
}

impl Estimate {
    /// All that the command reads.
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
}

fn report_title(source: &FrameSource) -> String {
    let input = source.path();
    format!("The camera of {}", input.file_name().unwrap_or(input.as_os_str()).to_string_lossy())
}

/// Frames and what is known of them.
pub struct Footage {
    source: FrameSource,
    depth: Option<(SideFolder<Plane>, DepthKind)>,
    flow: Option<SideFolder<Flow>>,
    denoised: Option<SideFolder<Encoded>>,
    motion_deblurred: Option<SideFolder<Encoded>>,
    defocus_deblurred: Option<SideFolder<Encoded>>,
    clean: Option<SideFolder<Encoded>>,
    /// Whether these are of the paper's layout: what networks made.
    by_network: bool,
}

/// Says what was found in a folder.
pub fn opened<T>(folder: SideFolder<T>) -> SideFolder<T> {
    for sentence in folder.notes() {
        note(format_args!("{}: {sentence}", folder.path().display()));
    }
    folder
}

/// Opens an input and says what there is to say about it.
pub fn open_source(path: &Path, range: Option<FrameRange>) -> Result<FrameSource> {
    let source = FrameSource::open(path, range.unwrap_or_default())?;
    for sentence in source.notes() {
        note(format_args!("{}: {sentence}", path.display()));
    }
    Ok(source)
}

impl Footage {
    /// Frames of which nothing is known.
    fn of(source: FrameSource) -> Self {
        Self {
            source,
            depth: None,
            flow: None,
            denoised: None,
            motion_deblurred: None,
            defocus_deblurred: None,
            clean: None,
            by_network: false,
        }
    }

    /// Fails if the frames that are in memory at once, what belongs to one of them, those kept as samples, and so many bytes of work on
    /// a frame do not fit into the budget.
    fn check_memory(&self, networks: &Networks, keep_samples: bool, work: u64) -> Result<()> {
        /// Bytes of a pixel; of a sample with what belongs to it.
        const FRAME: u64 = 12;
        const SAMPLE: u64 = 36;
        let (width, height) = self.source.size();
        let removed = [&self.denoised, &self.motion_deblurred, &self.defocus_deblurred, &self.clean];
        let frames = self.source.len_hint().unwrap_or(usize::MAX).clamp(1, 2 * networks.reach().max(1) + 1);
        let frames = frames + removed.iter().filter(|f| f.is_some()).count();
        let per_pixel = FRAME * frames as u64
            + if self.depth.is_some() { 4 } else { 0 }
            + if self.flow.is_some() { 8 } else { 0 }
            + if keep_samples { SAMPLE * frames.min(SAMPLES) as u64 } else { 0 };
        let what = format!("estimation from frames of {width} x {height} pixels");
        let bytes = per_pixel * (width * height) as u64 + work;
        Ok(memory::fits(self.source.path(), &what, bytes)?)
    }

    /// Whether there are frames from which something was removed.
    fn has_removed(&self) -> bool {
        [&self.denoised, &self.motion_deblurred, &self.defocus_deblurred, &self.clean]
            .iter()
            .any(|f| f.is_some())
    }

    /// Frames with known depth in metres.
    pub fn with_depth(frames: &Path, depth: &Path, clean: Option<&Path>) -> Result<Self> {
        let depth = DepthArgs::metric(depth).open()?;
        let source = open_source(frames, None)?;
        let clean = clean.map(|c| SideFolder::frames(c, "clean frames").map(opened)).transpose()?;
        Ok(Self { depth, clean, ..Self::of(source) })
    }

    fn open(args: &Estimate) -> Result<Self> {
        let paper = match (&args.evidence, &args.scene) {
            (Some(dir), Some(scene)) => Some(PaperScene::open(dir, scene)?),
            _ => None,
        };
        let Some(input) = args.input.as_ref().or(paper.as_ref().map(|p| &p.original)) else {
            return Err(Failure("no input was given".into()));
        };
        let source = open_source(input, args.frames)?;
        let mut footage = Self::of(source);
        if let Some(paper) = paper {
            footage.depth = paper.depth.map(|d| (opened(d), DepthKind::Relative));
            footage.flow = paper.flow.map(opened);
            footage.denoised = paper.denoised.map(opened);
            footage.motion_deblurred = paper.de_motion_blurred.map(opened);
            let last = paper.de_focus_blurred.map(opened);
            // What was never rid of motion blur still has it.
            match footage.motion_deblurred {
                Some(_) => footage.clean = last,
                None => footage.defocus_deblurred = last,
            }
            footage.by_network = true;
        }
        if let Some(depth) = args.depth.open()? {
            footage.depth = Some(depth);
        }
        if let Some(path) = &args.flow {
            footage.flow = Some(opened(SideFolder::flow(path)?));
        }
        if let Some(path) = &args.clean {
            footage.clean = Some(opened(SideFolder::frames(path, "clean frames")?));
            footage.by_network = false;
        }
        Ok(footage)
    }
}

/// An estimate and which frames it rests on.
pub struct Fitted {
    /// The estimate.
    pub estimation: Estimation,
    /// A few frames for a report, if they were asked for.
    pub samples: Vec<Sample>,
    /// The first frame's number.
    pub first: u64,
    /// The last frame's number.
    pub last: u64,
}

/// At most this many frames are kept for a report.
const SAMPLES: usize = 3;

/// What belongs to a frame, from a folder; counts the frames that have it.
struct Side<'a, T> {
    folder: &'a SideFolder<T>,
    matched: u64,
}

impl<'a, T> Side<'a, T> {
    fn new(folder: &'a Option<SideFolder<T>>) -> Option<Self> {
        folder.as_ref().map(|folder| Self { folder, matched: 0 })
    }

    /// Counts the frame, and reads what belongs to it if it is wanted.
    fn get(side: &mut Option<Self>, number: u64, size: (usize, usize), wanted: bool) -> Result<Option<T>> {
        let Some(side) = side else { return Ok(None) };
        if !side.folder.has(number) {
            return Ok(None);
        }
        side.matched += 1;
        Ok(if wanted { side.folder.get(number, size)? } else { None })
    }

    /// Says so if it was not there for all frames.
    fn report(side: Option<Self>, what: &str, frames: u64) {
        if let Some(Self { matched, .. }) = side
            && matched < frames
        {
            note(format_args!("{what}: {matched} of {frames} frames have it"));
        }
    }
}

/// Fails if a folder has nothing for any of the frames.
pub fn check_match<T>(source: &FrameSource, folder: Option<&SideFolder<T>>) -> Result<()> {
    let Some(folder) = folder else { return Ok(()) };
    // Not so for a video, whose frames are numbered from 1 on and slow to count.
    let matches = if source.fps().is_none() {
        let found = AtomicBool::new(false);
        // Reads none of the images.
        let mut none = source.frames_if(|n| {
            found.fetch_or(folder.has(n), Ordering::Relaxed);
            false
        });
        none.next().transpose()?;
        drop(none);
        found.into_inner()
    } else {
        source.len_hint().is_none_or(|n| (1..=n as u64).any(|n| folder.has(n)))
    };
    if matches {
        return Ok(());
    }
    let sentence = "none of the numbers in its files' names is a frame's; rename them";
    Err(failure(folder.path(), format_args!("{sentence} (the frames: {})", source.path().display())))
}

/// Whoever looks at the frames of a clip, one after another.
trait Viewer {
    /// Whether it will look at the next frame, or only count it.
    fn wants_next(&self) -> bool;

    /// Takes a frame and what belongs to it, and saves what it finds of flow and depth.
    fn view(
        &mut self,
        number: u64,
        observation: &FrameObservation,
        save: &mut Option<EvidenceWriter>,
    ) -> Result<()>;
}

/// Which frames were seen.
struct Seen {
    frames: usize,
    first: u64,
    last: u64,
    /// How far it came, if it was asked to stop before the end.
    stopped: Option<Stopped>,
}

/// Shows a clip's frames with what is known of them, a few at a time in memory.
fn show(
    footage: &Footage,
    networks: &mut Networks,
    save: &mut Option<EvidenceWriter>,
    what: &'static str,
    viewer: &mut impl Viewer,
) -> Result<Seen> {
    let source = &footage.source;
    let size = source.size();
    let depth_kind = footage.depth.as_ref().map(|d| d.1);
    let mut depth = footage.depth.as_ref().map(|d| Side { folder: &d.0, matched: 0 });
    let mut flow = Side::new(&footage.flow);
    let mut denoised = Side::new(&footage.denoised);
    let mut motion_deblurred = Side::new(&footage.motion_deblurred);
    let mut defocus_deblurred = Side::new(&footage.defocus_deblurred);
    let mut clean = Side::new(&footage.clean);

    check_match(source, depth.as_ref().map(|s| s.folder))?;
    check_match(source, flow.as_ref().map(|s| s.folder))?;
    for side in [&denoised, &motion_deblurred, &defocus_deblurred, &clean] {
        check_match(source, side.as_ref().map(|s| s.folder))?;
    }

    let mut progress = Progress::new(what, source.len_hint());
    let mut frames = source.frames();
    let mut window: VecDeque<Frame> = VecDeque::new();
    let reach = networks.reach().max(1);
    let mut at = 0;
    let mut seen = Seen { frames: 0, first: 0, last: 0, stopped: None };
    let mut consecutive = false;
    loop {
        while window.len() <= at + reach
            && let Some(frame) = frames.next().transpose()?
        {
            window.push_back(frame);
        }
        let Some(frame) = window.get(at) else { break };
        let number = frame.number;
        // A gap in the numbers is a gap in time.
        let (run, own) = successive(&window, at);
        let after = run.get(own + 1).map(|f| f.1);
        let before = own.checked_sub(1).map(|i| run[i].1);
        consecutive |= after.is_some();
        let wanted = viewer.wants_next();
        let flow = Side::get(&mut flow, number, size, wanted)?;
        let inverse_depth = Side::get(&mut depth, number, size, wanted)?;
        let denoised = Side::get(&mut denoised, number, size, wanted)?;
        let motion_deblurred = Side::get(&mut motion_deblurred, number, size, wanted)?;
        let defocus_deblurred = Side::get(&mut defocus_deblurred, number, size, wanted)?;
        let clean = Side::get(&mut clean, number, size, wanted)?;
        let removed =
            if wanted && !networks.is_empty() { networks.run(&run, own) } else { Removed::default() };
        let given = Evidence {
            flow: flow.as_ref(),
            inverse_depth: inverse_depth.as_ref().zip(depth_kind),
            denoised: denoised.as_ref(),
            motion_deblurred: motion_deblurred.as_ref(),
            defocus_deblurred: defocus_deblurred.as_ref(),
            clean: clean.as_ref(),
            by_network: footage.by_network,
        };
        let evidence = or_removed(given, &removed);
        if let Some(save) = save {
            save.images(number, &frame.image, &evidence)?;
        }
        viewer.view(
            number,
            &FrameObservation { frame: &frame.image, next: after, previous: before, evidence },
            save,
        )?;
        seen.first = if seen.frames == 0 { number } else { seen.first };
        seen.last = number;
        seen.frames += 1;
        progress.step();
        at += 1;
        if at > reach {
            window.pop_front();
            at -= 1;
        }
        if console::interrupted() && at < window.len() {
            seen.stopped = Some(Stopped { after: seen.frames, of: source.len_hint() });
            break;
        }
    }
    drop(progress);
    let count = seen.frames as u64;
    Side::report(depth, "depth", count);
    Side::report(flow, "flow", count);
    Side::report(denoised, "denoised frames", count);
    Side::report(motion_deblurred, "motion-deblurred frames", count);
    Side::report(defocus_deblurred, "defocus-deblurred frames", count);
    Side::report(clean, "clean frames", count);
    if seen.frames > 1 && !consecutive {
        warn("no two frames have successive numbers, so there is no motion to see");
    }
    Ok(seen)
}

/// The frames around one that follow each other without a gap, and where it is among them.
fn successive(window: &VecDeque<Frame>, at: usize) -> (Vec<(u64, &Encoded)>, usize) {
    let follows = |i: usize| window[i].number + 1 == window[i + 1].number;
    let first = (0..at).rev().find(|&i| !follows(i)).map_or(0, |i| i + 1);
    let last = (at..window.len() - 1).find(|&i| !follows(i)).unwrap_or(window.len() - 1);
    (window.range(first..=last).map(|f| (f.number, &f.image)).collect(), at - first)
}

fn of_frame(source: &FrameSource, number: u64, e: blindaug::Error) -> Failure {
    failure(source.path(), format_args!("frame {number}: {e}"))
}

/// Keeps a few frames for a report, if there is one.
struct Samples<'a> {
    source: &'a FrameSource,
    wanted: bool,
    /// Frames so far.
    seen: usize,
    kept: Vec<Sample>,
}

impl<'a> Samples<'a> {
    fn new(source: &'a FrameSource, wanted: bool) -> Self {
        Self { source, wanted, seen: 0, kept: Vec::new() }
    }
}

impl Samples<'_> {
    /// Spread over the clip where its length is known, else the first ones.
    fn wants_next(&self) -> bool {
        let spread = |i: usize| match self.source.len_hint() {
            Some(n) if n > SAMPLES => (2 * i + 1) * n / (2 * SAMPLES),
            _ => i,
        };
        let kept = self.kept.len();
        self.wanted && kept < SAMPLES && self.seen >= spread(kept)
    }

    fn keep(&mut self, number: u64, observation: &FrameObservation) -> Result<()> {
        if self.wants_next() {
            let FrameObservation { frame, next, evidence, .. } = *observation;
            let flow = match (evidence.flow, next) {
                (None, Some(next)) => Some(
                    analysis::flow::flow(&frame.luma(), &next.luma())
                        .map_err(|e| of_frame(self.source, number, e))?,
                ),
                (flow, _) => flow.cloned(),
            };
            self.kept.push(Sample {
                number,
                frame: frame.clone(),
                flow,
                inverse_depth: evidence.inverse_depth.map(|d| d.0.clone()),
                clean: evidence.clean.cloned(),
            });
        }
        self.seen += 1;
        Ok(())
    }
}

/// Estimates one model.
struct WholeClip<'a> {
    source: &'a FrameSource,
    estimator: Estimator,
    /// Of the frames so far.
    numbers: Vec<u64>,
    samples: Samples<'a>,
}

impl Viewer for WholeClip<'_> {
    fn wants_next(&self) -> bool {
        self.estimator.wants_next() || self.samples.wants_next()
    }

    fn view(
        &mut self,
        number: u64,
        observation: &FrameObservation,
        save: &mut Option<EvidenceWriter>,
    ) -> Result<()> {
        self.numbers.push(number);
        let used = self.estimator.add(observation).map_err(|e| of_frame(self.source, number, e))?;
        if let (true, Some(save)) = (used, save) {
            save.geometry(number, &self.estimator)?;
        }
        self.samples.keep(number, observation)
    }
}

/// Estimates the model of a clip.
pub fn fit(
    footage: &Footage,
    mut networks: Networks,
    mut save: Option<EvidenceWriter>,
    mut options: EstimatorOptions,
    keep_samples: bool,
) -> Result<Fitted> {
    let source = &footage.source;
    let frames = source.len_hint().unwrap_or(Estimator::MAX_FRAMES);
    let moving = footage.flow.is_none();
    let work = Estimator::bytes(source.size(), frames, options.family, moving);
    footage.check_memory(&networks, keep_samples, work)?;
    options.fps = options.fps.or(source.fps());
    let estimator = Estimator::new(options).expecting(source.len_hint().unwrap_or(0));
    let mut clip =
        WholeClip { source, estimator, numbers: vec![], samples: Samples::new(source, keep_samples) };
    let Seen { first, last, stopped, .. } = show(footage, &mut networks, &mut save, "estimating", &mut clip)?;
    if let Some(save) = save {
        save.finish();
    }
    let mut estimation = clip.estimator.estimate().map_err(|e| failure(source.path(), e))?;
    estimation.model.stopped = stopped;
    let diagnostics = &mut estimation.diagnostics;
    if !diagnostics.shots.is_empty() {
        diagnostics.notes.insert(0, words_of_shots(&diagnostics.shots, &clip.numbers));
    }
    Ok(Fitted { estimation, samples: clip.samples.kept, first, last })
}

/// Where the cuts are, and what each shot alone says of the exposure; of a film, the first shots.
fn words_of_shots(shots: &[Shot], numbers: &[u64]) -> String {
    const TOLD: usize = 10;
    let words = |shot: &Shot| {
        let (first, last) = (numbers[shot.frames.start], numbers[shot.frames.end - 1]);
        match shot.motion_blur.known() {
            Some(m) => {
                let [low, high] = m.interval;
                format!("{first} to {last} (exposure {:.2}, {low:.2} to {high:.2})", m.exposure.0)
            }
            None => format!("{first} to {last} (exposure unknown)"),
        }
    };
    let told = shots.iter().take(TOLD).map(words).collect::<Vec<String>>().join(", ");
    let rest = if shots.len() > TOLD { ", .." } else { "" };
    format!(
        "there are {} shots: frames {told}{rest}; --frames FIRST..LAST estimates one alone, --track a model for each frame",
        shots.len()
    )
}

/// Estimates a model for each frame.
struct Following<'a> {
    source: &'a FrameSource,
    tracker: Tracker,
    writer: CameraTrackWriter,
    /// All but the last one are written.
    cameras: Vec<TrackedCamera>,
    samples: Samples<'a>,
}

impl Viewer for Following<'_> {
    fn wants_next(&self) -> bool {
        true
    }

    fn view(
        &mut self,
        number: u64,
        observation: &FrameObservation,
        _: &mut Option<EvidenceWriter>,
    ) -> Result<()> {
        let camera = self.tracker.push(observation).map_err(|e| of_frame(self.source, number, e))?.clone();
        if let Some(last) = self.cameras.last() {
            self.writer.write(last)?;
        }
        self.cameras.push(TrackedCamera { frame: number, changed: self.tracker.changes(), camera });
        self.samples.keep(number, observation)
    }
}

/// Writes the models of a clip's frames, and tells them.
fn track(
    footage: &Footage,
    mut networks: Networks,
    options: EstimatorOptions,
    output: &Path,
    report: Option<&Path>,
) -> Result<()> {
    let source = &footage.source;
    footage.check_memory(&networks, report.is_some(), Tracker::bytes(source.size()))?;
    let tracker = Tracker::new(options.blur_space, options.fps.or(source.fps()));
    let writer = CameraTrackWriter::create(output)?;
    let samples = Samples::new(source, report.is_some());
    let mut following = Following { source, tracker, writer, cameras: Vec::new(), samples };
    let seen = show(footage, &mut networks, &mut None, "tracking", &mut following)?;
    let Following { mut writer, mut cameras, samples, .. } = following;
    if let Some(last) = cameras.last_mut() {
        last.camera.stopped = seen.stopped;
        writer.write(last)?;
    }
    let track = CameraTrack::from_frames(cameras).map_err(|e| failure(source.path(), e))?;
    writer.finish()?;
    console::print_beside(output, &words::table(&track))?;
    note(format_args!("written: {}", output.display()));
    if let Some(path) = report {
        let samples = samples.kept;
        let input = TrackReportInput { title: report_title(source), track: &track, samples };
        console::write_page(path, blindaug_report::track_page(&input))?;
        note(format_args!("written: {}", path.display()));
    }
    if seen.stopped.is_some() {
        let Seen { first, last, .. } = seen;
        return Err(failure(
            output,
            format_args!(
                "stopped: it holds frames {first} to {last}; for the others, run it again with --frames {}.. and another -o",
                last + 1
            ),
        ));
    }
    Ok(())
}
