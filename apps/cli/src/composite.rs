//! `blindaug composite`, `blindaug apply` and `blindaug match`: a camera's distortions on virtual layers over frames, on whole frames, and
//! the difference of two cameras' on footage.

use crate::{
    arguments::{ByHandArgs, Style, known_distance, layer_depth, layer_motion, place},
    console::{CONSOLE, Failure, Result, failure, note},
    estimate::{DepthArgs, boxed, opened},
    output::{self, Expected},
    source::{SourceArgs, linear_space},
};
use blindaug::{
    Flow, Transfer,
    colour_space::ColourSpace,
    composite::CompositeOptions,
    model::{CameraTrack, DepthKind, KnownDistance, SceneScale},
    synth::SynthesisOptions,
};
use blindaug_io::{
    Coding, Error, FileKind, FrameFormat, FrameSource, Inputs, MatteSide, NamePattern, SideFolder,
    VirtualLayerFile, read_camera_track,
};
use blindaug_pipeline::{
    BoxedSide, ImageFiles, Made, Output,
    composite::{
        self, DepthMaps, Fitting, FrameLayer, LayerDepth, LayerMotion, Product, Rendered, Scene,
        UnknownExposure, fitted_to, in_metres, naive,
    },
    footage::check_match,
    matching,
};
use clap::ValueEnum;
use std::path::{Path, PathBuf};

/// Composite a rendered object into footage so that it looks filmed by the same camera
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug composite shot.mp4 --virtual object/ --camera camera.json -o out/")]
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
    /// Sharp renders of the local scene with the object, for its shadows (their ratio to --without, below 1) and reflections (what is added)
    #[arg(help_heading = "Scene", long, value_name = "DIR", requires = "without")]
    with: Option<PathBuf>,
    /// Sharp renders of the local scene without the object
    #[arg(help_heading = "Scene", long, value_name = "DIR", requires = "with")]
    without: Option<PathBuf>,
    /// The footage's optical flow to the next frame, which blurs shadows and reflections [default: estimated]
    #[arg(help_heading = "Scene", long, value_name = "DIR")]
    flow: Option<PathBuf>,
    /// Mattes of things in front of the object, an image per frame: white hides the object
    #[arg(help_heading = "Scene", long, value_name = "DIR")]
    holdout: Option<PathBuf>,
    /// What the mattes show: things in front of the object, or the part behind it, where alone it is seen
    #[arg(help_heading = "Scene", long, value_enum, default_value = "front", requires = "holdout")]
    holdout_of: HoldoutArg,
    /// Blur the object as much as the footage is blurred at this place, px, whatever its depth, so that no scale is needed
    #[arg(help_heading = "Scene", long, value_name = "X,Y", value_parser = place, conflicts_with_all = ["focus", "blur"])]
    match_at: Option<[f32; 2]>,
    /// The depth of layers that have no Z: a distance in metres, or `plate` for the median of --depth where the object is
    #[arg(help_heading = "Scene", long, value_name = "METRES|plate", value_parser = layer_depth)]
    layer_depth: Option<LayerDepth>,
    /// The motion of layers that have none: U,V in px to the next frame (x right, y down), or `plate` for the footage's own where the object is
    #[arg(help_heading = "Scene", long, value_name = "U,V|plate", value_parser = layer_motion, allow_hyphen_values = true)]
    layer_motion: Option<LayerMotion>,
    /// The colour space of the rendered object and of --with and --without: linear-srgb, acescg or aces2065-1 [default: what the files say,
    /// else linear-srgb]
    #[arg(help_heading = "Scene", long, value_name = "SPACE", value_parser = linear_space)]
    layer_colour_space: Option<ColourSpace>,
    /// Paste the object as it is, without noise and blur
    #[arg(help_heading = "Look", long, conflicts_with_all = ["shutter", "shutter_phase", "focus", "blur", "bokeh", "squeeze", "cats_eye", "grain", "match_at"])]
    naive: bool,
    /// Write, instead of the composite, what it adds to the footage, for a compositing program: EXR with the distorted R G B A
    /// (premultiplied, scene-linear), noise, holdout, Z and forward
    #[arg(help_heading = "Results", long)]
    layer: bool,
    #[command(flatten)]
    look: Look,
}

#[derive(Clone, Copy, ValueEnum)]
enum HoldoutArg {
    Front,
    Behind,
}

/// Apply a camera's blur and noise to a whole rendered clip
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug apply render/ --camera camera.json -o out/")]
pub struct Apply {
    /// The clip: a video, one image, or a folder of images in the order of the numbers in their names
    input: PathBuf,
    /// The camera model, or per-frame models, as written by estimate
    #[arg(long, value_name = "camera.json")]
    camera: PathBuf,
    #[command(flatten)]
    frames: FramesArgs,
}

/// Make one camera's footage look like another's: add the blur and the noise that it lacks
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug match b.mp4 --from camera_b.json --to camera_a.json -o out/")]
pub struct Match {
    /// The footage: a video, one image, or a folder of images in the order of the numbers in their names
    input: PathBuf,
    /// The model of the camera that filmed it, or per-frame models, as written by estimate
    #[arg(long, value_name = "camera_b.json")]
    from: PathBuf,
    /// The model of the camera that it is to look like
    #[arg(long, value_name = "camera_a.json")]
    to: PathBuf,
    #[command(flatten)]
    frames: FramesArgs,
}

/// What is said of whole frames and of what becomes of them.
#[derive(clap::Args)]
struct FramesArgs {
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    depth: DepthArgs,
    /// Optical flow to the next frame, in px: .flo, or EXR with forward.u and forward.v [default: estimated]
    #[arg(help_heading = "Evidence", long, value_name = "DIR")]
    flow: Option<PathBuf>,
    #[command(flatten)]
    look: Look,
}

#[derive(clap::Args)]
struct OutputArgs {
    /// A folder, which gets an image per frame, or a video or one image by its extension
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// The kind of images: exr (scene-linear, not clipped), png or tiff [default: by the extension of OUT; else EXR stays EXR, PNG and TIFF
    /// of 16 bits stay what they are, video of more than 8 bits becomes PNG of 16, and all others PNG of 8 bits]
    #[arg(help_heading = "Results", long, value_name = "KIND")]
    format: Option<FileKind>,
    /// Bits per value: 8 or 16 of png and tiff, 16 (half) or 32 (float) of exr, 8 (H.264) or 10 (HEVC) of videos [default: as many as the
    /// input has]
    #[arg(help_heading = "Results", long, value_name = "N")]
    bits: Option<u8>,
    /// Make frames anew that are there already
    #[arg(help_heading = "Results", long)]
    overwrite: bool,
    #[command(flatten)]
    source: SourceArgs,
    /// The colour space of what is written [default: that of the input; of EXR made from other files, their light; of other files made from
    /// light, srgb]
    #[arg(help_heading = "Results", long, value_name = "SPACE")]
    output_colour_space: Option<ColourSpace>,
    /// Frames per second of a video, where the input does not say it
    #[arg(help_heading = "Frames", long, value_name = "N", value_parser = crate::arguments::frame_rate)]
    fps: Option<f64>,
}

impl OutputArgs {
    /// Checks, before anything is read, that the output can be written and is none of the inputs.
    fn check(&self, inputs: &[Option<&PathBuf>]) -> Result<()> {
        output::check(&self.output, &Inputs::of(inputs.iter().flatten()))
    }

    /// The files that frames made from these, or layers over them, are written to.
    ///
    /// # Errors
    /// If the options contradict each other.
    fn files(&self, source: &FrameSource, layers: bool) -> Result<ImageFiles> {
        let one_or_pattern = Output::is_file(&self.output) || NamePattern::of(&self.output).is_some();
        let by_name = FileKind::of_name(&self.output).filter(|_| one_or_pattern);
        let asked = self.format.or(by_name);
        if layers && (Output::is_video(&self.output) || asked.is_some_and(|kind| kind != FileKind::Exr)) {
            return Err(failure(&self.output, "--layer writes EXR files: give a folder, or a name in .exr"));
        }
        let is_video = Output::is_video(&self.output);
        if is_video && self.format.is_some() {
            return Err(failure(&self.output, "--format is for images, and this is a video; leave it out"));
        }
        if is_video && self.bits.is_some_and(|bits| ![8, 10].contains(&bits)) {
            return Err(failure(&self.output, "a video has 8 or 10 bits per value"));
        }
        if let (Some(name), Some(format)) = (by_name, self.format)
            && name != format
        {
            let asked = format.extension();
            return Err(failure(
                &self.output,
                format_args!("--format asks for {asked}, its name for another"),
            ));
        }
        let kind = if layers { Some(FileKind::Exr) } else { asked };
        let format = source.format().with(kind, self.bits.filter(|_| !is_video));
        let format = format.map_err(|e| failure(&self.output, e))?;
        let file = self.file_space(source, if is_video { FileKind::Png } else { format.kind() });
        if layers && file.transfer != Transfer::Linear {
            return Err(failure(
                &self.output,
                "layers hold light: --output-colour-space must be a linear one",
            ));
        }
        // Values that stay what they are go on being what their profile says.
        let profile = source.profile().filter(|_| file == source.file_space()).cloned();
        let coding = Coding::new(source.space(), file).with_profile(profile);
        Ok(ImageFiles { format, heads: Box::new(source.heads()), coding })
    }

    /// The colour space of files of this kind that are made from frames of a source.
    fn file_space(&self, source: &FrameSource, kind: FileKind) -> ColourSpace {
        let own = source.file_space();
        let from_exr = source.format().is_exr();
        self.output_colour_space.unwrap_or(match (kind, own.transfer) {
            (FileKind::Exr, _) if from_exr => own,
            (FileKind::Exr, _) => ColourSpace { transfer: Transfer::Linear, ..own },
            (_, Transfer::Linear) => ColourSpace::SRGB,
            _ => own,
        })
    }

    /// Opens the output for frames that are made from these.
    fn open(&self, expected: &Expected, files: ImageFiles, cameras: &[&Path]) -> Result<Output> {
        output::open(&self.output, expected, files, cameras, self.overwrite)
    }

    fn expected(&self, source: &FrameSource) -> Expected {
        let count = source.len_hint().map(|n| n as u64);
        // Images become videos that every program plays.
        let deep = source.is_video() && source.format() != FrameFormat::PNG8;
        let video_bits = self.bits.unwrap_or(if deep { 10 } else { 8 });
        let fps = self.fps.or(source.fps());
        Expected { size: source.size(), fps, count, video_bits, pixel_aspect: source.pixel_aspect() }
    }

    fn finish(&self, output: Output, made: &Made) -> Result<()> {
        output::finish(&self.output, output, made)
    }
}

#[derive(clap::Args)]
struct Look {
    /// Relates a model in relative inverse depth d to metres: d = S / Z + O
    #[arg(help_heading = "Scene", long, value_name = "S[,O]", value_parser = scene_scale)]
    scene_scale: Option<SceneScale>,
    /// A place in the picture whose distance is known, px and m, such as 640,360=2.5m, which brings a model in relative inverse depth to metres;
    /// once, or twice for two places. `inspect` shows which places have a depth
    #[arg(help_heading = "Scene", long, value_name = "X,Y=METRES", value_parser = known_distance, conflicts_with = "scene_scale")]
    at: Vec<KnownDistance>,
    /// What to apply of an exposure that is unknown
    #[arg(help_heading = "Look", long, value_enum, default_value = "leave")]
    unknown: UnknownArg,
    #[command(flatten)]
    by_hand: ByHandArgs,
    #[command(flatten)]
    style: Style,
}

#[derive(Clone, Copy, ValueEnum)]
enum UnknownArg {
    /// Nothing: no motion blur
    Leave,
    /// The middle of the exposures that fit
    Middle,
}

impl Look {
    /// The models of a file as they are applied to a clip, and the scale of the scene if it is known.
    fn fitted(
        &self,
        track: CameraTrack,
        path: &Path,
        clip: &dyn blindaug_pipeline::Clip,
        match_at: Option<[f32; 2]>,
    ) -> Result<(CameraTrack, Option<SceneScale>)> {
        let fitting = Fitting { match_at, by_hand: self.by_hand.parts(), ..self.of_scene() };
        Ok(fitted_to(track, &shown(path), clip, &fitting, CONSOLE)?)
    }

    /// What brings a model of the clip's own camera to metres.
    fn of_scene(&self) -> Fitting {
        let known = self.at.clone();
        Fitting { scale: self.scene_scale, known, unknown: self.unknown(), ..Fitting::default() }
    }

    fn unknown(&self) -> UnknownExposure {
        match self.unknown {
            UnknownArg::Leave => UnknownExposure::Left,
            UnknownArg::Middle => UnknownExposure::Middle,
        }
    }
}

/// Parses S or S,O.
pub fn scene_scale(text: &str) -> std::result::Result<SceneScale, String> {
    let number = |t: &str| t.trim().parse::<f32>().ok().filter(|v| v.is_finite());
    let (scale, offset) = text.split_once(',').unwrap_or((text, "0"));
    match (number(scale), number(offset)) {
        (Some(scale), Some(offset)) if scale > 0.0 => Ok(SceneScale { scale, offset }),
        _ => Err("give S or S,O with S > 0, so that the relative inverse depth is S / Z + O".into()),
    }
}

/// Runs `composite`.
pub fn run(args: &Composite) -> Result<()> {
    let Composite { input, layers, camera, depth, with, without, flow, holdout, .. } = args;
    let depth_folder = depth.folder();
    args.output.check(&[
        Some(input),
        Some(layers),
        camera.as_ref(),
        depth_folder,
        with.as_ref(),
        without.as_ref(),
        flow.as_ref(),
        holdout.as_ref(),
    ])?;
    let track = match &args.camera {
        Some(path) if !args.naive => Some((read_camera_track(path)?, path)),
        _ => None,
    };
    let source = args.output.source.open(&args.input)?.with_light_below_zero();
    let footage = encoded_for(source, track.as_ref().map(|(t, p)| (t, p.as_path())));
    let (said, primaries) = (args.layer_colour_space, footage.space().primaries);
    let layers = opened(SideFolder::virtual_layers_in(&args.layers, said, primaries)?);
    let flow = match (&args.flow, &args.with, args.depth.folder()) {
        (Some(path), _, _) => Some(boxed(SideFolder::flow(path)?)),
        // A renderer writes depth and motion into one file, so the depth's files may have the flow.
        (None, Some(_), Some(depth)) => SideFolder::flow(depth).ok().map(boxed),
        _ => None,
    };
    let local = |path, what| -> Result<_> { Ok(boxed(SideFolder::renders(path, what, said, primaries)?)) };
    let renders = match (&args.with, &args.without) {
        (Some(with), Some(without)) => {
            Some([local(with, "renders with the object")?, local(without, "renders without the object")?])
        }
        _ => None,
    };
    let side = match args.holdout_of {
        HoldoutArg::Front => MatteSide::Front,
        HoldoutArg::Behind => MatteSide::Behind,
    };
    let holdout = args.holdout.as_ref().map(|path| SideFolder::mattes(path, side)).transpose()?.map(boxed);
    let (size, transfer, expected) =
        (footage.size(), footage.space().transfer, args.output.expected(&footage));
    let files = args.output.files(&footage, args.layer)?;
    // The frames' surroundings go on into composites. A layer has its own.
    let files = match args.layer {
        true => files,
        false => ImageFiles { heads: Box::new(footage.heads_with_overscan()), ..files },
    };
    let unclipped = is_unclipped(&footage, &files);
    let depth = args.depth.open()?;
    let footage: Box<dyn blindaug_pipeline::Clip> = Box::new(footage);
    let (track, scale) = match track {
        Some((track, path)) => {
            let (track, scale) = args.look.fitted(track, path, &*footage, args.match_at)?;
            (in_metres(track, &shown(path), scale)?, scale)
        }
        None => (naive(size, transfer).into(), args.look.scene_scale),
    };
    let depth = depth.map(|(maps, kind)| DepthMaps::in_metres(Box::new(maps), kind, scale)).transpose()?;
    let layer_depth = args.layer_depth.or(args.match_at.map(|_| LayerDepth::any(depth.is_some())));
    let layer_motion = args.layer_motion;
    if layer_depth == Some(LayerDepth::OfFootage) && depth.is_none() {
        return Err(Failure(
            "--layer-depth plate needs the depth of the footage: give --depth, or a distance".into(),
        ));
    }
    let layers = Box::new(layers);
    let scene = Scene { footage, layers, depth, flow, renders, holdout, layer_depth, layer_motion };
    scene.check()?;
    let options = CompositeOptions { unclipped, ..args.look.style.options() };
    let cameras: Vec<&Path> = args.camera.iter().map(PathBuf::as_path).collect();
    let mut output = args.output.open(&expected, files, &cameras)?;
    let product = if args.layer { Product::Layer } else { Product::Composite };
    let made = composite::composite(&scene, &track, (&options, product), &mut output, CONSOLE)?;
    args.output.finish(output, &made)
}

/// The frames encoded as a camera's model has it, in whose encoding its noise is.
fn encoded_for(source: FrameSource, camera: Option<(&CameraTrack, &Path)>) -> FrameSource {
    let Some((track, path)) = camera else { return source };
    let (own, wanted) = (source.space().transfer, track.frames()[0].camera.transfer);
    if own != wanted {
        note(format_args!(
            "{}: the camera's noise is that of {} values, so that frames are brought to these and back",
            path.display(),
            wanted.name()
        ));
    }
    source.encoded_as(wanted)
}

/// Runs `apply`.
pub fn run_apply(args: &Apply) -> Result<()> {
    let Apply { input, camera, frames } = args;
    frames.check(&[input, camera])?;
    let track = read_camera_track(camera)?;
    let Clip { rendered, expected, files, unclipped } = frames.clip(input, (&track, camera))?;
    let (track, scale) = frames.look.fitted(track, camera, &*rendered.clip, None)?;
    let CompositeOptions { no_noise, bokeh, seed, .. } = frames.look.style.options();
    let options = SynthesisOptions { bokeh, no_noise, seed, unclipped };
    let job = composite::applying(rendered, (track, &shown(camera)), scale, CONSOLE)?;
    let mut output = frames.output.open(&expected, files, &[camera])?;
    let made = job.run(&options, &mut output, CONSOLE)?;
    frames.output.finish(output, &made)
}

/// A clip with what is given beside it, and the files that frames made from its frames are written to.
struct Clip {
    rendered: Rendered,
    expected: Expected,
    files: ImageFiles,
    /// Whether values above white are kept.
    unclipped: bool,
}

/// Whether values above white are kept: if both the frames and what is made of them have such values.
fn is_unclipped(source: &FrameSource, files: &ImageFiles) -> bool {
    source.file_space().transfer == Transfer::Linear && files.coding.file().transfer == Transfer::Linear
}

impl FramesArgs {
    /// Checks, before anything is read, that the output can be written and is none of these inputs, the depth and the flow.
    fn check(&self, inputs: &[&PathBuf]) -> Result<()> {
        let given = inputs.iter().copied().map(Some);
        let all: Vec<_> = given.chain([self.depth.folder(), self.flow.as_ref()]).collect();
        self.output.check(&all)
    }

    /// Opens a clip with the depth and the flow that are given beside it. EXR frames may have their own.
    fn clip(&self, input: &Path, camera: (&CameraTrack, &Path)) -> Result<Clip> {
        let clip = encoded_for(self.output.source.open(input)?, Some(camera));
        let flow = match (&self.flow, self.depth.folder()) {
            (Some(path), _) => Some(opened(SideFolder::flow(path)?)),
            (None, Some(depth)) => SideFolder::flow(depth).ok().map(opened),
            (None, None) => SideFolder::<Flow>::of_frames(&clip).map(opened),
        };
        let own_depth = || Some((opened(SideFolder::depth_of_frames(&clip)?), DepthKind::Metric));
        let depth = self.depth.open()?.or_else(own_depth);
        check_match(&clip, depth.as_ref().map(|d| &d.0 as _))?;
        check_match(&clip, flow.as_ref().map(|f| f as _))?;
        let (expected, files) = (self.output.expected(&clip), self.output.files(&clip, false)?);
        let unclipped = is_unclipped(&clip, &files);
        let own_layers = || SideFolder::<VirtualLayerFile>::of_frames(&clip);
        let layers = unclipped.then(own_layers).flatten().map(|own| Box::new(own) as BoxedSide<FrameLayer>);
        let rendered = Rendered {
            clip: Box::new(clip),
            layers,
            depth: depth.map(|(maps, kind)| (Box::new(maps) as _, kind)),
            flow: flow.map(|f| Box::new(f) as _),
        };
        Ok(Clip { rendered, expected, files, unclipped })
    }
}

/// Runs `match`.
pub fn run_match(args: &Match) -> Result<()> {
    let Match { input, from, to, frames } = args;
    frames.check(&[input, from, to])?;
    let track = read_camera_track(from)?;
    let Clip { rendered: footage, expected, files, .. } = frames.clip(input, (&track, from))?;
    let look = &frames.look;
    let wanted = read_camera_track(to)?;
    let [own, other] = [&track, &wanted].map(|t| t.frames()[0].camera.transfer);
    if own != other {
        return Err(failure(
            to,
            format_args!(
                "its noise is that of {} values, that of --from of {}: estimate both from footage of one encoding",
                other.name(),
                own.name()
            ),
        ));
    }
    let (source, scale) = fitted_to(track, &shown(from), &*footage.clip, &look.of_scene(), CONSOLE)?;
    // What is set by hand is the look that is wanted. The places whose distance is known, and the scale, are those of the footage.
    let fitting = Fitting { by_hand: look.by_hand.parts(), unknown: look.unknown(), ..Fitting::default() };
    let (target, _) = fitted_to(wanted, &shown(to), &*footage.clip, &fitting, CONSOLE)?;
    let [target] = target.frames() else {
        return Err(failure(
            to,
            "it holds a model for each frame of other footage: give one that was estimated without --track",
        ));
    };
    let options = frames.look.style.options();
    let target = target.camera.clone();
    let job = matching::matching(footage, (source, &shown(from)), target, scale, CONSOLE)?;
    let mut output = frames.output.open(&expected, files, &[from, to])?;
    let made = job.run(&options, &mut output, CONSOLE)?;
    frames.output.finish(output, &made)
}

fn shown(path: &Path) -> String {
    Error::shown_path(path)
}
