//! `blindaug composite` and `blindaug apply`: a camera's distortions on virtual layers over frames, and on whole frames.

use crate::{
    console::{self, Failure, Progress, Result, failure, note, warn},
    estimate::{DepthArgs, check_match, open_source, opened},
};
use blindaug::{
    CameraModel, Encoded, Flow, Plane, Raster, Transfer, analysis,
    composite::{self, CompositeOptions, Plate, VirtualLayer},
    model::{CameraTrack, Capture, DefocusModel, DepthKind, Distortion, Estimate, Reason},
    synth::{self, defocus::Bokeh, distorted_strips},
};
use blindaug_io::{
    Frame, FrameRange, FrameSource, Inputs, PngWriter, SideFolder, VideoWriter, VirtualLayerFile, is_stream,
    memory, read_camera_track, remove_leftovers_in,
};
use blindaug_report::words::count;
use clap::ValueEnum;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    str::FromStr,
};

/// Composite a rendered object into footage so that it looks filmed by the same camera
#[derive(clap::Args)]
pub struct Composite {
    /// The footage: a video, one image, or a folder of images in the order of the numbers in their names
    input: PathBuf,
    /// The rendered object, one EXR per frame: R G B A premultiplied and scene-linear, Z in metres, forward.u, forward.v
    #[arg(long = "virtual", value_name = "DIR")]
    layers: PathBuf,
    /// The camera model, or per-frame models, as written by estimate
    #[arg(long, value_name = "camera.json", required_unless_present = "naive")]
    camera: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    depth: DepthArgs,
    /// Renders of the local scene with the object, for its shadows and reflections (frame + with - without)
    #[arg(long, value_name = "DIR", requires = "without")]
    with: Option<PathBuf>,
    /// Renders of the local scene without the object
    #[arg(long, value_name = "DIR", requires = "with")]
    without: Option<PathBuf>,
    /// The footage's optical flow to the next frame, which blurs shadows and reflections [default: estimated]
    #[arg(long, value_name = "DIR")]
    flow: Option<PathBuf>,
    /// Paste the object as it is, without noise and blur
    #[arg(long)]
    naive: bool,
    #[command(flatten)]
    look: Look,
}

/// Apply a camera's blur and noise to a whole rendered clip
#[derive(clap::Args)]
pub struct Apply {
    /// The clip: a video, one image, or a folder of images in the order of the numbers in their names
    input: PathBuf,
    /// The camera model, or per-frame models, as written by estimate
    #[arg(long, value_name = "camera.json")]
    camera: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    depth: DepthArgs,
    /// Optical flow to the next frame, in px: .flo, or EXR with forward.u and forward.v [default: estimated]
    #[arg(long, value_name = "DIR")]
    flow: Option<PathBuf>,
    #[command(flatten)]
    look: Look,
}

#[derive(clap::Args)]
struct OutputArgs {
    /// A folder, which gets a PNG per frame, or a video by its extension
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Make frames anew that are there already
    #[arg(long)]
    overwrite: bool,
    /// Only these frames, by number, both ends included
    #[arg(long, value_name = "FIRST..LAST")]
    frames: Option<FrameRange>,
    /// Frames per second of a video, where the input does not say it
    #[arg(long, value_name = "N", value_parser = crate::frame_rate)]
    fps: Option<f64>,
}

impl OutputArgs {
    /// Checks, before anything is read, that the output can be written and is none of the inputs.
    fn check(&self, inputs: &[Option<&PathBuf>]) -> Result<()> {
        Output::check(&self.output, &Inputs::of(inputs.iter().flatten()))
    }

    fn open(&self, source: &FrameSource) -> Result<Output> {
        Output::open(&self.output, source, self.overwrite, self.fps)
    }
}

#[derive(clap::Args)]
struct Look {
    /// Relates a model in relative inverse depth d to metres: d = S / Z + O
    #[arg(long, value_name = "S[,O]")]
    scene_scale: Option<SceneScale>,
    #[command(flatten)]
    style: Style,
}

/// What of the camera is applied, and how.
#[derive(clap::Args)]
pub struct Style {
    /// Leave the noise out
    #[arg(long)]
    no_noise: bool,
    /// The shape of an out-of-focus point
    #[arg(long, value_enum, default_value = "gaussian")]
    bokeh: BokehArg,
    /// Which noise: the same seed gives the same noise
    #[arg(long, value_name = "N", default_value = "0")]
    seed: u64,
}

#[derive(Clone, Copy, ValueEnum)]
enum BokehArg {
    Gaussian,
    Disk,
}

impl Style {
    /// As the composite takes them.
    pub fn options(&self) -> CompositeOptions {
        CompositeOptions {
            naive: false,
            no_noise: self.no_noise,
            bokeh: match self.bokeh {
                BokehArg::Gaussian => Bokeh::Gaussian,
                BokehArg::Disk => Bokeh::Disk,
            },
            seed: self.seed,
        }
    }
}

/// d = scale / Z + offset.
#[derive(Clone, Copy)]
pub struct SceneScale {
    scale: f32,
    offset: f32,
}

impl FromStr for SceneScale {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let number = |t: &str| t.trim().parse::<f32>().ok().filter(|v| v.is_finite());
        let (scale, offset) = text.split_once(',').unwrap_or((text, "0"));
        match (number(scale), number(offset)) {
            (Some(scale), Some(offset)) if scale > 0.0 => Ok(Self { scale, offset }),
            _ => Err("give S or S,O with S > 0, so that the relative inverse depth is S / Z + O".into()),
        }
    }
}

/// Runs `composite`.
pub fn run(args: &Composite) -> Result<()> {
    let Composite { input, layers, camera, depth, with, without, flow, .. } = args;
    let depth_folder = depth.folder();
    args.output.check(&[
        Some(input),
        Some(layers),
        camera.as_ref(),
        depth_folder,
        with.as_ref(),
        without.as_ref(),
        flow.as_ref(),
    ])?;
    let footage = open_source(&args.input, args.output.frames)?;
    let layers = opened(SideFolder::virtual_layers(&args.layers)?);
    let flow = match (&args.flow, &args.with, args.depth.folder()) {
        (Some(path), _, _) => Some(opened(SideFolder::flow(path)?)),
        // A renderer writes depth and motion into one file.
        (None, Some(_), Some(depth)) => SideFolder::flow(depth).ok().map(opened),
        _ => None,
    };
    let renders = match (&args.with, &args.without) {
        (Some(with), Some(without)) => Some([
            opened(SideFolder::frames(with, "renders with the object")?),
            opened(SideFolder::frames(without, "renders without the object")?),
        ]),
        _ => None,
    };
    let scale = args.look.scene_scale;
    let depth = args.depth.open()?.map(|d| DepthMaps::in_metres(d, scale)).transpose()?;
    let scene = Scene { footage, layers, depth, flow, renders };
    scene.check()?;
    let track = match &args.camera {
        Some(path) if !args.naive => in_metres(open_camera(path, &scene.footage)?, path, scale)?,
        _ => naive(scene.footage.size()).into(),
    };
    let mut output = args.output.open(&scene.footage)?;
    composite(&scene, &track, &args.look.style.options(), &mut output)?;
    output.finish()
}

/// Runs `apply`.
pub fn run_apply(args: &Apply) -> Result<()> {
    args.output.check(&[Some(&args.input), Some(&args.camera), args.depth.folder(), args.flow.as_ref()])?;
    let clip = open_source(&args.input, args.output.frames)?;
    let depth = args.depth.open()?;
    let flow = match (&args.flow, args.depth.folder()) {
        (Some(path), _) => Some(opened(SideFolder::flow(path)?)),
        (None, Some(depth)) => SideFolder::flow(depth).ok().map(opened),
        _ => None,
    };
    check_match(&clip, depth.as_ref().map(|d| &d.0))?;
    check_match(&clip, flow.as_ref())?;
    let mut track = open_camera(&args.camera, &clip)?;
    let kind = |d: &(SideFolder<Plane>, DepthKind)| d.1;
    let depth = match (depth, depth_kind(&track)) {
        (Some(depth), Some(DepthKind::Relative)) if kind(&depth) == DepthKind::Relative => {
            // Depth and model are in the same unit, whatever it is.
            track = track.map(|m| map_defocus(m, |d| d.to_metric(1.0, 0.0)));
            Some(DepthMaps::as_they_are(depth.0))
        }
        (Some(depth), _) => {
            track = in_metres(track, &args.camera, args.look.scene_scale)?;
            Some(DepthMaps::in_metres(depth, args.look.scene_scale)?)
        }
        (None, known) => {
            if known.is_some() {
                warn("without --depth nothing is defocused");
            }
            track = track.map(|mut m| {
                m.defocus = Estimate::unknown(Reason::NoDepth, "there is no depth");
                m
            });
            None
        }
    };
    let CompositeOptions { no_noise, bokeh, seed, .. } = args.look.style.options();
    let options = synth::SynthesisOptions { bokeh, no_noise, seed };
    let moving = track.why_unknown(Distortion::MotionBlur).is_none();
    let finds_flow = moving && flow.is_none() && clip.len_hint() != Some(1);
    let given = if finds_flow { 3 * FRAME } else { FRAME } + if moving { FLOW } else { 0 };
    let work = synth::bytes_beside(clip.size(), depth.is_some());
    check_memory(&clip, given + if depth.is_some() { DEPTH } else { 0 }, finds_flow, work)?;
    let mut output = args.output.open(&clip)?;
    let mut missing = Missing::default();
    for_each_frame("applying", &clip, &mut output, moving && flow.is_none(), |frame, neighbours, rows| {
        let (number, size) = (frame.number, clip.size());
        let flow = match &flow {
            Some(folder) => folder.get(number, size)?,
            None if moving => neighbours.flow(frame)?,
            None => None,
        };
        missing.check(moving && flow.is_none(), number, "no flow", "is not motion-blurred");
        let inverse_depth = match &depth {
            Some(maps) => maps.get(number, size)?,
            None => None,
        };
        missing.check(depth.is_some() && inverse_depth.is_none(), number, "no depth", "is not defocused");
        let model = track.at(number);
        let (depth, flow) = (inverse_depth.as_ref(), flow.as_ref());
        distorted_strips(&frame.image, &model, depth, flow, &options, number)
            .map_err(|e| failure(clip.path(), format_args!("frame {number}: {e}")))?
            .try_for_each(|strip| rows.put(&strip))
    })?;
    output.finish()
}

/// Bytes of a pixel of a frame, of flow, of depth, of a virtual layer while it is read, and of a pair of renders with their light.
const FRAME: u64 = 12;
const FLOW: u64 = 8;
const DEPTH: u64 = 4;
const LAYER: u64 = 56;
const RENDERS: u64 = 48;

/// Fails if frames of a source with what belongs to them, bytes per pixel, and the work on one of them do not fit into the budget.
/// Where flow is to be found, that comes before the work.
fn check_memory(source: &FrameSource, per_pixel: u64, finds_flow: bool, work: u64) -> Result<()> {
    let (width, height) = source.size();
    let pixels = (width * height) as u64;
    let flow = if finds_flow { analysis::flow::BYTES_PER_PIXEL * pixels } else { 0 };
    let what = format!("work on frames of {width} x {height} pixels");
    Ok(memory::fits(source.path(), &what, per_pixel * pixels + work.max(flow))?)
}

/// A camera that distorts nothing.
pub fn naive((width, height): (usize, usize)) -> CameraModel {
    CameraModel::unknown(Capture { width, height, fps: None, frames_used: 0 }, "naive")
}

/// What a composite is made of.
pub struct Scene {
    /// The footage.
    pub footage: FrameSource,
    /// The virtual object.
    pub layers: SideFolder<VirtualLayerFile>,
    /// Real depth.
    pub depth: Option<DepthMaps>,
    /// The footage's optical flow, which blurs the renders' difference.
    pub flow: Option<SideFolder<Flow>>,
    /// Renders of the local scene with and without the object.
    pub renders: Option<[SideFolder<Encoded>; 2]>,
}

impl Scene {
    /// Fails if one of the folders has nothing for any of the frames.
    fn check(&self) -> Result<()> {
        let Self { footage, layers, depth, flow, renders } = self;
        check_match(footage, Some(layers))?;
        check_match(footage, depth.as_ref().map(|d| &d.folder))?;
        check_match(footage, flow.as_ref())?;
        renders.iter().flatten().try_for_each(|folder| check_match(footage, Some(folder)))
    }
}

/// Depth maps, in the unit that they are needed in.
pub struct DepthMaps {
    folder: SideFolder<Plane>,
    /// Wanted inverse depth = slope * read + offset.
    slope: f32,
    offset: f32,
}

impl DepthMaps {
    fn as_they_are(folder: SideFolder<Plane>) -> Self {
        Self { folder, slope: 1.0, offset: 0.0 }
    }

    /// In 1/m.
    ///
    /// # Errors
    /// If they are relative and there is no scale.
    pub fn in_metres(
        (folder, kind): (SideFolder<Plane>, DepthKind),
        scale: Option<SceneScale>,
    ) -> Result<Self> {
        match (kind, scale) {
            (DepthKind::Metric, _) => Ok(Self::as_they_are(folder)),
            (DepthKind::Relative, Some(SceneScale { scale, offset })) => {
                Ok(Self { folder, slope: scale.recip(), offset: -offset / scale })
            }
            (DepthKind::Relative, None) => Err(failure(
                folder.path(),
                "relative depth must be brought to metres: give --scene-scale S[,O], where relative inverse depth is S / Z + O",
            )),
        }
    }

    fn get(&self, number: u64, size: (usize, usize)) -> Result<Option<Plane>> {
        let mut depth = self.folder.get(number, size)?;
        let values = depth.iter_mut().flat_map(|d| d.data_mut());
        values.for_each(|d| *d = self.slope * *d + self.offset);
        Ok(depth)
    }
}

/// Composites every frame of a scene.
pub fn composite(
    scene: &Scene,
    track: &CameraTrack,
    options: &CompositeOptions,
    output: &mut Output,
) -> Result<()> {
    let Scene { footage, layers, depth, flow, renders } = scene;
    let moving = track.why_unknown(Distortion::MotionBlur).is_none();
    let defocused = track.why_unknown(Distortion::Defocus).is_none();
    let mut missing = Missing::default();
    let mut without_layer = 0;
    let estimates_flow = moving && renders.is_some() && flow.is_none();
    let size = footage.size();
    // The result is one more frame.
    let frames = if estimates_flow { 4 * FRAME } else { 2 * FRAME };
    let shadows = if renders.is_some() { RENDERS + FLOW } else { 0 };
    let given = frames + LAYER + shadows + if depth.is_some() { DEPTH } else { 0 };
    check_memory(footage, given, estimates_flow, 0)?;
    for_each_frame("compositing", footage, output, estimates_flow, |frame, neighbours, rows| {
        let number = frame.number;
        let Some(layer) = layers.get(number, size)? else {
            without_layer += 1;
            return rows.put(&frame.image.0);
        };
        let has_depth = layer.inverse_depth.is_some();
        missing.check(
            moving && layer.flow.is_none(),
            number,
            "its virtual layer has no flow",
            "gets no motion blur",
        );
        missing.check(defocused && !has_depth, number, "its virtual layer has no Z", "gets no defocus");
        missing.check(depth.is_some() && !has_depth, number, "its virtual layer has no Z", "is not occluded");
        let real_inverse_depth = match depth {
            Some(maps) => maps.get(number, size)?,
            None => None,
        };
        missing.check(
            depth.is_some() && real_inverse_depth.is_none(),
            number,
            "no real depth",
            "is not occluded",
        );
        let local = match renders {
            Some([with, without]) => with.get(number, size)?.zip(without.get(number, size)?),
            None => None,
        };
        let local = local.map(|(a, b)| [a, b].map(|r| r.to_linear(Transfer::Srgb)));
        let what = "no renders with and without it";
        missing.check(renders.is_some() && local.is_none(), number, what, "casts no shadows");
        let real_flow = match flow {
            Some(folder) => folder.get(number, size)?,
            None if estimates_flow && local.is_some() => neighbours.flow(frame)?,
            None => None,
        };
        let plate = Plate {
            frame: &frame.image,
            number,
            inverse_depth: real_inverse_depth.as_ref(),
            flow: real_flow.as_ref(),
            with_and_without: local.as_ref().map(|[with, without]| (with, without)),
        };
        let layer = VirtualLayer { color: layer.color, inverse_depth: layer.inverse_depth, flow: layer.flow };
        let (model, of_frame) =
            (track.at(number), |e| failure(footage.path(), format_args!("frame {number}: {e}")));
        let work = composite::bytes_beside(&plate, &layer, &model, options).map_err(of_frame)?;
        check_memory(footage, given, false, work)?;
        rows.put(&composite::composite(&plate, &layer, &model, options).map_err(of_frame)?.0)
    })?;
    if without_layer > 0 {
        note(format_args!("{} without a virtual layer left as they are", count(without_layer, "frame")));
    }
    Ok(())
}

/// Warns once per thing that is missing.
#[derive(Default)]
struct Missing(BTreeSet<&'static str>);

impl Missing {
    fn check(&mut self, is_missing: bool, number: u64, what: &str, effect: &'static str) {
        if is_missing && self.0.insert(effect) {
            warn(format_args!("frame {number}: {what}, so the object {effect} (said once)"));
        }
    }
}

/// Reads a camera model, or one for each frame, for frames of this size, and says what of it is not applied.
fn open_camera(path: &Path, source: &FrameSource) -> Result<CameraTrack> {
    let track = read_camera_track(path)?;
    let (width, height) = source.size();
    let Capture { width: w, height: h, .. } = track.frames()[0].camera.capture;
    if (w, h) != (width, height) {
        let path = path.display();
        note(format_args!(
            "{path}: for frames of {w} x {h}; its blur is scaled by the width to {width} x {height}"
        ));
        let shape = (width * h) as f64 / (height * w) as f64;
        if (shape - 1.0).abs() > 0.01 {
            warn(
                "these frames have another shape than the camera's; that is right only if they were cropped in height",
            );
        }
    }
    let track = track.map(|m| m.scaled_to(width, height));
    for distortion in Distortion::ALL {
        // That a camera does not sharpen, or that an old file says nothing of it, is nothing to warn of.
        let why = track.why_unknown(distortion);
        if let Some(why) = why.filter(|_| distortion != Distortion::Sharpening) {
            warn(format_args!("{} is unknown and not applied: {why}", distortion.name()));
        }
    }
    Ok(track)
}

/// What the lens's inverse depth is measured in, where it is known.
fn depth_kind(track: &CameraTrack) -> Option<DepthKind> {
    track.frames().iter().find_map(|f| f.camera.defocus.known()).map(|d| d.depth_kind)
}

/// The models over metric inverse depth.
///
/// # Errors
/// If they are over relative inverse depth and there is no scale.
pub fn in_metres(track: CameraTrack, path: &Path, scale: Option<SceneScale>) -> Result<CameraTrack> {
    match (depth_kind(&track), scale) {
        (Some(DepthKind::Relative), Some(s)) => {
            Ok(track.map(|m| map_defocus(m, |d| d.to_metric(s.scale, s.offset))))
        }
        (Some(DepthKind::Relative), None) => Err(failure(
            path,
            "its defocus is over relative inverse depth, but the layers are in metres: give --scene-scale S[,O], where relative inverse depth is S / Z + O, or estimate again with --depth in metres",
        )),
        _ => Ok(track),
    }
}

fn map_defocus(mut model: CameraModel, f: impl FnOnce(DefocusModel) -> DefocusModel) -> CameraModel {
    if let Estimate::Known(defocus) = &mut model.defocus {
        *defocus = f(*defocus);
    }
    model
}

/// Where frames go.
pub struct Output {
    path: PathBuf,
    sink: Sink,
    /// Whether the folder was made by this run.
    is_new: bool,
    written: u64,
    /// The last frame that was made and the next one that was not, after Ctrl-C.
    stopped: Option<(u64, u64)>,
}

enum Sink {
    /// PNG by number; these are there already.
    Folder(BTreeSet<u64>),
    Video(VideoWriter),
    Memory(BTreeMap<u64, Encoded>),
}

impl Output {
    /// Checks, before anything is read, that a video or a folder of this name can be written and is none of the inputs, and removes
    /// what earlier runs that were killed have left of it.
    ///
    /// # Errors
    /// Names what is wrong.
    pub fn check(path: &Path, inputs: &Inputs) -> Result<()> {
        if VideoWriter::is_video(path) {
            return console::check_outputs(inputs, [path]);
        }
        if path.exists() && !path.is_dir() {
            return Err(failure(path, "this is a file; give a folder, or a video by its extension (mp4)"));
        }
        let is_frame = |name: &str| number_of_png(name).is_some();
        inputs.check_output_folder(path, is_frame)?;
        console::check_folder(path)?;
        remove_leftovers_in(path, is_frame);
        Ok(())
    }

    /// A folder as by [`Output::folder`], or a video by its extension, which is not replaced unless it is to be overwritten. The
    /// frame rate is the source's where it is not given.
    pub fn open(path: &Path, source: &FrameSource, overwrite: bool, fps: Option<f64>) -> Result<Self> {
        if !VideoWriter::is_video(path) {
            return Self::folder(path, overwrite);
        }
        if path.exists() && !is_stream(path) && !overwrite {
            return Err(failure(path, "this video is there already; add --overwrite, or give another name"));
        }
        let fps = fps.or(source.fps()).unwrap_or_else(|| {
            note(format_args!(
                "{}: at {DEFAULT_FPS} frames a second, since the input does not say; --fps N for another",
                path.display()
            ));
            DEFAULT_FPS
        });
        let video = VideoWriter::create(path, source.size(), fps)?;
        Ok(Self { path: path.into(), sink: Sink::Video(video), is_new: false, written: 0, stopped: None })
    }

    /// A folder of PNG, which is made with the first frame if it is not there. Those that are in it are left, unless they are to be
    /// overwritten.
    pub fn folder(path: &Path, overwrite: bool) -> Result<Self> {
        let done = if overwrite || !path.exists() { BTreeSet::new() } else { numbers_of_pngs(path)? };
        Ok(Self { path: path.into(), sink: Sink::Folder(done), is_new: false, written: 0, stopped: None })
    }

    /// Keeps the frames.
    pub fn memory() -> Self {
        Self {
            path: PathBuf::new(),
            sink: Sink::Memory(BTreeMap::new()),
            is_new: false,
            written: 0,
            stopped: None,
        }
    }

    /// The frames of [`Output::memory`], by number.
    pub fn into_frames(self) -> BTreeMap<u64, Encoded> {
        match self.sink {
            Sink::Memory(frames) => frames,
            _ => BTreeMap::new(),
        }
    }

    /// Whether there are frames in it from before that are to be left.
    #[cfg(feature = "live")]
    pub fn has_frames(&self) -> bool {
        matches!(&self.sink, Sink::Folder(done) if !done.is_empty())
    }

    /// Begins the next frame, of this width and height.
    fn begin(&mut self, number: u64, size @ (width, height): (usize, usize)) -> Result<Rows> {
        if matches!(self.sink, Sink::Folder(_)) && !self.path.exists() {
            console::make_folder(&self.path)?;
            self.is_new = true;
        }
        Ok(match &self.sink {
            Sink::Folder(_) => {
                Rows::Png(Box::new(PngWriter::create(self.path.join(png_name(number)), size)?))
            }
            Sink::Video(_) | Sink::Memory(_) => Rows::Whole(width, Vec::with_capacity(width * height)),
        })
    }

    /// Removes the folder if this run has made it and nothing is in it.
    fn remove_if_empty(&self) {
        if self.is_new {
            // It fails for a folder with frames in it, which stays.
            let _ = std::fs::remove_dir(&self.path);
        }
    }

    /// Completes the frame of this number.
    fn end(&mut self, number: u64, rows: Rows) -> Result<()> {
        match rows {
            Rows::Png(png) => png.finish()?,
            Rows::Whole(width, pixels) => {
                let height = pixels.len() / width.max(1);
                let frame = Raster::from_vec(width, height, pixels).map_err(|e| failure(&self.path, e))?;
                match &mut self.sink {
                    Sink::Video(video) => video.write(&Encoded(frame))?,
                    Sink::Memory(frames) => drop(frames.insert(number, Encoded(frame))),
                    Sink::Folder(_) => {}
                }
            }
        }
        self.written += 1;
        Ok(())
    }

    /// Writes the next frame.
    #[cfg(feature = "live")]
    pub fn write(&mut self, number: u64, frame: Encoded) -> Result<()> {
        let mut rows = self.begin(number, frame.0.size())?;
        rows.put(&frame.0)?;
        self.end(number, rows)
    }

    /// Completes the output and says what was written.
    ///
    /// # Errors
    /// If it cannot be completed, or Ctrl-C stopped it: then with how to go on.
    pub fn finish(self) -> Result<()> {
        let is_video = matches!(self.sink, Sink::Video(_));
        if let Sink::Video(video) = self.sink {
            video.finish()?;
        }
        note(format_args!("{}: {} written", self.path.display(), count(self.written, "frame")));
        match self.stopped {
            None => Ok(()),
            Some((last, next)) if is_video => Err(failure(
                &self.path,
                format_args!(
                    "stopped after frame {last}; for the others, run it again with --frames {next}.. and another -o"
                ),
            )),
            Some((last, next)) => Err(failure(
                &self.path,
                format_args!("stopped after frame {last}; the same command goes on with frame {next}"),
            )),
        }
    }
}

/// A frame that is written a few rows at a time, from the top.
enum Rows {
    Png(Box<PngWriter>),
    /// The width, and the pixels so far.
    Whole(usize, Vec<[f32; 3]>),
}

impl Rows {
    fn put(&mut self, rows: &Raster<[f32; 3]>) -> Result<()> {
        match self {
            Self::Png(png) => png.write(rows.data())?,
            Self::Whole(_, pixels) => pixels.extend_from_slice(rows.data()),
        }
        Ok(())
    }
}

fn png_name(number: u64) -> String {
    format!("{number:04}.png")
}

/// The numbers of the frames that have been written to a folder.
fn numbers_of_pngs(folder: &Path) -> Result<BTreeSet<u64>> {
    let entries =
        folder.read_dir().map_err(|e| failure(folder, format_args!("the folder cannot be read ({e})")))?;
    Ok(entries.filter_map(|e| number_of_png(e.ok()?.file_name().to_str()?)).collect())
}

/// The number of a frame whose file has this name.
fn number_of_png(name: &str) -> Option<u64> {
    name.strip_suffix(".png")?.parse().ok().filter(|&n| png_name(n) == name)
}

/// Of a video that is made from images.
pub const DEFAULT_FPS: f64 = 30.0;

/// The frames before and after a frame, if they are at hand.
struct Neighbours<'a> {
    previous: Option<&'a Encoded>,
    next: Option<&'a Encoded>,
}

impl Neighbours<'_> {
    /// Flow to the next frame, estimated; for the last frame that from the previous one, taken to go on.
    fn flow(&self, frame: &Frame) -> Result<Option<Flow>> {
        let (other, sign) = match (self.next, self.previous) {
            (Some(next), _) => (next, 1.0),
            (None, Some(previous)) => (previous, -1.0),
            (None, None) => return Ok(None),
        };
        let flow = analysis::flow::flow(&frame.image.luma(), &other.luma())
            .map_err(|e| Failure(format!("frame {}: {e}", frame.number)))?;
        Ok(Some(flow.map(|v| v.map(|c| sign * c))))
    }
}

/// Calls `make` for each frame that is not done, and writes the rows that it puts. Only with `neighbours` are the frames before and
/// after it at hand; else one frame is in memory at a time.
fn for_each_frame(
    what: &'static str,
    source: &FrameSource,
    output: &mut Output,
    neighbours: bool,
    mut make: impl FnMut(&Frame, &Neighbours, &mut Rows) -> Result<()>,
) -> Result<()> {
    let done = match &mut output.sink {
        Sink::Folder(done) => std::mem::take(done),
        _ => BTreeSet::new(),
    };
    let needed = |n: u64| {
        let beside = |n: u64| neighbours && !done.contains(&n);
        !done.contains(&n) || beside(n + 1) || beside(n.saturating_sub(1))
    };
    if !done.is_empty() {
        note(format_args!(
            "{}: {} there already and left as they are (--overwrite makes them anew)",
            output.path.display(),
            count(done.len() as u64, "frame")
        ));
    }
    let total = source.len_hint().map(|n| n.saturating_sub(done.len()));
    let mut progress = Progress::new(what, total);
    let mut frames = source.frames_if(needed);
    let mut previous: Option<Frame> = None;
    let mut current = frames.next().transpose()?;
    while let Some(frame) = current.take() {
        let number = frame.number;
        // If it is damaged, this frame's motion would be another.
        let next = if neighbours { frames.next().transpose()? } else { None };
        if !done.contains(&number) {
            let around = Neighbours {
                previous: previous.as_ref().filter(|p| p.number + 1 == number).map(|p| &p.image),
                next: next.as_ref().filter(|n| n.number == number + 1).map(|n| &n.image),
            };
            let mut rows = output.begin(number, frame.image.0.size())?;
            if let Err(e) = make(&frame, &around, &mut rows) {
                drop(rows);
                output.remove_if_empty();
                return Err(e);
            }
            output.end(number, rows)?;
            progress.step();
        }
        (previous, current) = if neighbours {
            (Some(frame), next)
        } else {
            drop(frame);
            (None, frames.next().transpose()?)
        };
        if let (true, Some(next)) = (console::interrupted(), &current) {
            output.stopped = Some((number, next.number));
            break;
        }
    }
    Ok(())
}
