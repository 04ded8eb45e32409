//! `blindaug composite`, `blindaug apply` and `blindaug match`: a camera's distortions on virtual layers over frames, on whole frames, and
//! the difference of two cameras' on footage.

use crate::estimate::{DepthArgs, boxed, open_source, opened};
use blindaug::{composite::CompositeOptions, model::SceneScale, synth::SynthesisOptions};
use blindaug_cli::{
    arguments::Style,
    console::{CONSOLE, Result, failure, note},
    output,
};
use blindaug_io::{Error, FrameRange, Inputs, SideFolder, read_camera_track};
use blindaug_pipeline::{
    Made, Output,
    composite::{self, DepthMaps, Rendered, Scene, UnknownExposure, fitted_to, in_metres, naive},
    footage::check_match,
    matching,
};
use blindaug_report::words::count;
use clap::ValueEnum;
use std::path::{Path, PathBuf};

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
    frames: FramesArgs,
}

/// Make one camera's footage look like another's: add the blur and the noise that it lacks
#[derive(clap::Args)]
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
    #[arg(long, value_name = "N", value_parser = blindaug_cli::arguments::frame_rate)]
    fps: Option<f64>,
}

impl OutputArgs {
    /// Checks, before anything is read, that the output can be written and is none of the inputs.
    fn check(&self, inputs: &[Option<&PathBuf>]) -> Result<()> {
        output::check(&self.output, &Inputs::of(inputs.iter().flatten()))
    }

    fn open(&self, size: (usize, usize), fps: Option<f64>) -> Result<Output> {
        let opened = output::open(&self.output, size, self.fps.or(fps), self.overwrite)?;
        output::tell_done(&self.output, &opened);
        Ok(opened)
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
    fn unknown_exposure(&self) -> UnknownExposure {
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
    let (size, fps) = (footage.size(), footage.fps());
    let depth = depth.transpose()?;
    let scene = Scene { footage: Box::new(footage), layers: Box::new(layers), depth, flow, renders };
    scene.check()?;
    let track = match &args.camera {
        Some(path) if !args.naive => {
            let unknown = args.look.unknown_exposure();
            let track = fitted_to(read_camera_track(path)?, &shown(path), &*scene.footage, unknown, CONSOLE);
            in_metres(track, &shown(path), scale)?
        }
        _ => naive(size).into(),
    };
    let mut output = args.output.open(size, fps)?;
    let options = args.look.style.options();
    let made = composite::composite(&scene, &track, &options, &mut output, CONSOLE)?;
    args.output.finish(output, &made)
}

/// Runs `apply`.
pub fn run_apply(args: &Apply) -> Result<()> {
    let Apply { input, camera, frames } = args;
    frames.check(&[input, camera])?;
    let rendered = frames.rendered(input)?;
    let (size, fps) = (rendered.clip.size(), rendered.clip.fps());
    let (track, unknown) = (read_camera_track(camera)?, frames.look.unknown_exposure());
    let track = fitted_to(track, &shown(camera), &*rendered.clip, unknown, CONSOLE);
    let CompositeOptions { no_noise, bokeh, seed, .. } = frames.look.style.options();
    let options = SynthesisOptions { bokeh, no_noise, seed };
    let job = composite::applying(rendered, (track, &shown(camera)), frames.look.scene_scale, CONSOLE)?;
    let mut output = frames.output.open(size, fps)?;
    let made = job.run(&options, &mut output, CONSOLE)?;
    frames.output.finish(output, &made)
}

impl FramesArgs {
    /// Checks, before anything is read, that the output can be written and is none of these inputs, the depth and the flow.
    fn check(&self, inputs: &[&PathBuf]) -> Result<()> {
        let given = inputs.iter().copied().map(Some);
        let all: Vec<_> = given.chain([self.depth.folder(), self.flow.as_ref()]).collect();
        self.output.check(&all)
    }

    /// Opens a clip with the depth and the flow that are given beside it.
    fn rendered(&self, input: &Path) -> Result<Rendered> {
        let clip = open_source(input, self.output.frames)?;
        let flow = match (&self.flow, self.depth.folder()) {
            (Some(path), _) => Some(opened(SideFolder::flow(path)?)),
            (None, Some(depth)) => SideFolder::flow(depth).ok().map(opened),
            _ => None,
        };
        let depth = self.depth.open()?;
        check_match(&clip, depth.as_ref().map(|d| &d.0 as _))?;
        check_match(&clip, flow.as_ref().map(|f| f as _))?;
        Ok(Rendered {
            clip: Box::new(clip),
            depth: depth.map(|(maps, kind)| (Box::new(maps) as _, kind)),
            flow: flow.map(|f| Box::new(f) as _),
        })
    }
}

/// Runs `match`.
pub fn run_match(args: &Match) -> Result<()> {
    let Match { input, from, to, frames } = args;
    frames.check(&[input, from, to])?;
    let footage = frames.rendered(input)?;
    let (size, fps) = (footage.clip.size(), footage.clip.fps());
    let read = |path: &Path| -> Result<_> {
        let track = read_camera_track(path)?;
        Ok(fitted_to(track, &shown(path), &*footage.clip, frames.look.unknown_exposure(), CONSOLE))
    };
    let (source, target) = (read(from)?, read(to)?);
    let [target] = target.frames() else {
        return Err(failure(
            to,
            "it holds a model for each frame of other footage: give one that was estimated without --track",
        ));
    };
    let options = frames.look.style.options();
    let target = target.camera.clone();
    let job = matching::matching(footage, (source, &shown(from)), target, frames.look.scene_scale, CONSOLE)?;
    let mut output = frames.output.open(size, fps)?;
    let made = job.run(&options, &mut output, CONSOLE)?;
    frames.output.finish(output, &made)
}

fn shown(path: &Path) -> String {
    Error::shown_path(path)
}
