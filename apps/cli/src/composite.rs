//! `blindaug composite`, `blindaug apply` and `blindaug match`: a camera's distortions on virtual layers over frames, on whole frames, and
//! the difference of two cameras' on footage.

use crate::estimate::{DepthArgs, boxed, open_source, opened};
use blindaug::{
    composite::{CompositeOptions, VirtualLayer},
    model::{CameraTrack, DepthKind, SceneScale},
    synth::SynthesisOptions,
};
use blindaug_cli::{
    arguments::{ByHandArgs, Style},
    console::{CONSOLE, Result, failure, note},
    output::{self, Expected},
};
use blindaug_io::{
    DepthFormat, Error, FileKind, FrameRange, FrameSource, Inputs, SideFolder, read_camera_track,
};
use blindaug_pipeline::{
    BoxedSide, ByHand, ImageFiles, Made, Output,
    composite::{self, DepthMaps, Product, Rendered, Scene, UnknownExposure, fitted_to, in_metres, naive},
    footage::check_match,
    matching,
};
use blindaug_report::words::count;
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
    /// Write, instead of the composite, what it adds to the footage, for a compositing program: EXR with the distorted R G B A
    /// (premultiplied, scene-linear), noise, holdout, Z and forward
    #[arg(long)]
    layer: bool,
    #[command(flatten)]
    look: Look,
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
    #[arg(long, value_name = "DIR")]
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
    /// of 16 bits stay what they are, and all others become PNG of 8 bits]
    #[arg(long, value_name = "KIND")]
    format: Option<FileKind>,
    /// Bits per value: 8 or 16 of png and tiff, 16 (half) or 32 (float) of exr [default: as many as the input has]
    #[arg(long, value_name = "N")]
    bits: Option<u8>,
    /// Make frames anew that are there already
    #[arg(long)]
    overwrite: bool,
    /// Only these frames, by number, both ends included
    #[arg(long, value_name = "FIRST..LAST")]
    frames: Option<FrameRange>,
    /// Frames per second of a video, where the input does not say it
    #[arg(long, value_name = "N", value_parser = blindaug_cli::arguments::frame_rate)]
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
        let by_name = FileKind::of_name(&self.output).filter(|_| Output::is_file(&self.output));
        let asked = self.format.or(by_name);
        if layers && (Output::is_video(&self.output) || asked.is_some_and(|kind| kind != FileKind::Exr)) {
            return Err(failure(&self.output, "--layer writes EXR files: give a folder, or a name in .exr"));
        }
        if Output::is_video(&self.output) && (self.format.is_some() || self.bits.is_some()) {
            return Err(failure(
                &self.output,
                "--format and --bits are for images, and this is a video; leave them out",
            ));
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
        let format = source.format().with(kind, self.bits);
        let format = format.map_err(|e| failure(&self.output, e))?;
        Ok(ImageFiles { format, heads: Box::new(source.heads()) })
    }

    /// Opens the output for frames that are made from these.
    fn open(&self, expected: &Expected, files: ImageFiles) -> Result<Output> {
        let opened = output::open(&self.output, expected, files, self.overwrite)?;
        output::tell_done(&self.output, &opened);
        Ok(opened)
    }

    fn expected(&self, source: &FrameSource) -> Expected {
        let count = source.len_hint().map(|n| n as u64);
        Expected { size: source.size(), fps: self.fps.or(source.fps()), count }
    }

    fn finish(&self, output: Output, made: &Made) -> Result<()> {
        if made.without_layer > 0 {
            note(format_args!(
                "{} without a virtual layer left as they are",
                count(made.without_layer, "frame")
            ));
        }
        output::finish(&self.output, output, made)
    }
}

#[derive(clap::Args)]
struct Look {
    /// Relates a model in relative inverse depth d to metres: d = S / Z + O
    #[arg(long, value_name = "S[,O]", value_parser = scene_scale)]
    scene_scale: Option<SceneScale>,
    /// What to apply of an exposure that is unknown
    #[arg(long, value_enum, default_value = "leave")]
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
    /// The models of a file as they are applied to a clip.
    fn fitted(
        &self,
        track: CameraTrack,
        path: &Path,
        clip: &dyn blindaug_pipeline::Clip,
    ) -> Result<CameraTrack> {
        self.fitted_with(track, path, clip, self.by_hand.parts())
    }

    fn fitted_with(
        &self,
        track: CameraTrack,
        path: &Path,
        clip: &dyn blindaug_pipeline::Clip,
        by_hand: ByHand,
    ) -> Result<CameraTrack> {
        let unknown = match self.unknown {
            UnknownArg::Leave => UnknownExposure::Left,
            UnknownArg::Middle => UnknownExposure::Middle,
        };
        Ok(fitted_to(track, &shown(path), clip, (by_hand, unknown), CONSOLE)?)
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
        (Some(path), _, _) => Some(boxed(SideFolder::flow(path)?)),
        // A renderer writes depth and motion into one file, so the depth's files may have the flow.
        (None, Some(_), Some(depth)) => SideFolder::flow(depth).ok().map(boxed),
        _ => None,
    };
    let renders = match (&args.with, &args.without) {
        (Some(with), Some(without)) => Some([
            boxed(SideFolder::frames(with, "renders with the object")?),
            boxed(SideFolder::frames(without, "renders without the object")?),
        ]),
        _ => None,
    };
    let scale = args.look.scene_scale;
    let depth = args.depth.open()?.map(|(maps, kind)| DepthMaps::in_metres(Box::new(maps), kind, scale));
    let (size, expected) = (footage.size(), args.output.expected(&footage));
    let files = args.output.files(&footage, args.layer)?;
    let unclipped = is_unclipped(&footage, &files);
    let depth = depth.transpose()?;
    let scene = Scene { footage: Box::new(footage), layers: Box::new(layers), depth, flow, renders };
    scene.check()?;
    let track = match &args.camera {
        Some(path) if !args.naive => {
            let track = args.look.fitted(read_camera_track(path)?, path, &*scene.footage)?;
            in_metres(track, &shown(path), scale)?
        }
        _ => naive(size).into(),
    };
    let options = CompositeOptions { unclipped, ..args.look.style.options() };
    let mut output = args.output.open(&expected, files)?;
    let product = if args.layer { Product::Layer } else { Product::Composite };
    let made = composite::composite(&scene, &track, (&options, product), &mut output, CONSOLE)?;
    args.output.finish(output, &made)
}

/// Runs `apply`.
pub fn run_apply(args: &Apply) -> Result<()> {
    let Apply { input, camera, frames } = args;
    frames.check(&[input, camera])?;
    let Clip { rendered, expected, files, unclipped } = frames.clip(input)?;
    let track = frames.look.fitted(read_camera_track(camera)?, camera, &*rendered.clip)?;
    let CompositeOptions { no_noise, bokeh, seed, .. } = frames.look.style.options();
    let options = SynthesisOptions { bokeh, no_noise, seed, unclipped };
    let job = composite::applying(rendered, (track, &shown(camera)), frames.look.scene_scale, CONSOLE)?;
    let mut output = frames.output.open(&expected, files)?;
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
    source.format().is_scene_linear() && files.format.is_scene_linear()
}

impl FramesArgs {
    /// Checks, before anything is read, that the output can be written and is none of these inputs, the depth and the flow.
    fn check(&self, inputs: &[&PathBuf]) -> Result<()> {
        let given = inputs.iter().copied().map(Some);
        let all: Vec<_> = given.chain([self.depth.folder(), self.flow.as_ref()]).collect();
        self.output.check(&all)
    }

    /// Opens a clip with the depth and the flow that are given beside it. EXR frames may have their own.
    fn clip(&self, input: &Path) -> Result<Clip> {
        let clip = open_source(input, self.output.frames)?;
        let own = clip.exr_contents();
        let flow = match (&self.flow, self.depth.folder()) {
            (Some(path), _) => Some(opened(SideFolder::flow(path)?)),
            (None, Some(depth)) => SideFolder::flow(depth).ok().map(opened),
            (None, None) if own.is_some_and(|own| own.flow) => Some(opened(SideFolder::flow(input)?)),
            (None, None) => None,
        };
        let depth = match self.depth.open()? {
            None if own.is_some_and(|own| own.depth) => {
                let maps = SideFolder::depth(input, DepthFormat::default())?;
                Some((opened(maps), DepthKind::Metric))
            }
            given => given,
        };
        check_match(&clip, depth.as_ref().map(|d| &d.0 as _))?;
        check_match(&clip, flow.as_ref().map(|f| f as _))?;
        let (expected, files) = (self.output.expected(&clip), self.output.files(&clip, false)?);
        let unclipped = is_unclipped(&clip, &files);
        let layers = match own {
            Some(own) if own.alpha && unclipped => {
                Some(Box::new(SideFolder::virtual_layers(input)?) as BoxedSide<VirtualLayer>)
            }
            _ => None,
        };
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
    let Clip { rendered: footage, expected, files, .. } = frames.clip(input)?;
    let look = &frames.look;
    let source = look.fitted_with(read_camera_track(from)?, from, &*footage.clip, ByHand::default())?;
    // What is set by hand is the look that is wanted.
    let target = look.fitted(read_camera_track(to)?, to, &*footage.clip)?;
    let [target] = target.frames() else {
        return Err(failure(
            to,
            "it holds a model for each frame of other footage: give one that was estimated without --track",
        ));
    };
    let options = frames.look.style.options();
    let target = target.camera.clone();
    let job = matching::matching(footage, (source, &shown(from)), target, frames.look.scene_scale, CONSOLE)?;
    let mut output = frames.output.open(&expected, files)?;
    let made = job.run(&options, &mut output, CONSOLE)?;
    frames.output.finish(output, &made)
}

fn shown(path: &Path) -> String {
    Error::shown_path(path)
}
