//! `blindaug live`: an animated object in the footage of a camera or a video while it runs.

mod headless;
mod panel;
mod spectra;
mod times;
mod window;

use blindaug::{composite::CompositeOptions, model::Bokeh};
use blindaug_cli::{
    arguments::{Style, memory_size, within},
    console::{self, Failure, Result, failure, note},
    output::{self, DEFAULT_FPS, Expected},
};
use blindaug_gpu::{Gpu, Quality};
use blindaug_io::{FrameFormat, FrameSource, Inputs};
use blindaug_pipeline::{
    ImageFiles, Made,
    live::{self, Home, Pinhole},
};
use blindaug_stage::{Look, Object, Stage};
use clap::Parser;
use glam::DVec2;
use std::{ops::RangeInclusive, path::PathBuf, process::ExitCode, sync::Arc};

// Whole images are allocated and freed all the time: see the note in Cargo.toml.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// The first place of the object's foot, in shares of the frame's width and height.
const FOOT: DVec2 = DVec2::new(0.5, 0.75);
/// The ranges of --size (a share of the visible height) and --distance (m), and of the window's sliders.
const SIZES: RangeInclusive<f64> = 0.01..=10.0;
const DISTANCES: RangeInclusive<f64> = 0.1..=100.0;

/// Put an animated object into the footage of a camera or a video while it runs
#[derive(Parser)]
#[command(name = "blindaug live", version, max_term_width = 110)]
struct Live {
    /// A video, a folder of images, or a camera: camera:0, on Windows camera:NAME
    #[arg(default_value = "camera:0")]
    input: PathBuf,
    /// The object, glTF 2.0, of which the first animation is played [default: one that is built in]
    #[arg(long, value_name = "FILE.glb")]
    object: Option<PathBuf>,
    /// The object's longest side, as a share of the height that is seen at its distance, 0.01 to 10
    #[arg(long, value_name = "SHARE", default_value = "0.5", value_parser = |t: &str| within(t, SIZES))]
    size: f64,
    /// How far away the object and the plane that it stands on are at first, 0.1 to 100 m
    #[arg(long, value_name = "METRES", default_value = "2", value_parser = |t: &str| within(t, DISTANCES))]
    distance: f64,
    /// The camera's vertical field of view, 5 to 150 degrees
    #[arg(long, value_name = "DEGREES", default_value = "50", value_parser = |t: &str| within(t, 5.0..=150.0))]
    fov: f64,
    /// Where the line is, as a share of the width, 0 to 1: left of it the object is pasted as it is
    #[arg(long, value_name = "SHARE", default_value = "0.5", value_parser = |t: &str| within(t, 0.0..=1.0))]
    split: f64,
    /// Frames per second, where the input does not say it: of the clip, the animation and the video that is written
    #[arg(long, value_name = "N", value_parser = blindaug_cli::arguments::frame_rate)]
    fps: Option<f64>,
    /// The shape of an out-of-focus point, gaussian or disk
    #[arg(long, value_name = "gaussian|disk", value_parser = round_bokeh)]
    bokeh: Option<Bokeh>,
    #[command(flatten)]
    style: Style,
    /// Without a window: write as many frames as --frames says and print the last one's camera model; a clip starts again at its end
    #[arg(long, requires_all = ["frames", "output"])]
    headless: bool,
    /// How many frames to write
    #[arg(long, value_name = "N", requires = "headless", value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// A folder, which gets a PNG per frame, or a video by its extension
    #[arg(short, long, value_name = "OUT", requires = "headless")]
    output: Option<PathBuf>,
    /// Replace an output that is there already
    #[arg(long, requires = "headless")]
    overwrite: bool,
    /// How much memory may be taken: a number with M or G (millions or billions of bytes), from 64M to 1000G [default: half of what
    /// the machine has]
    #[arg(long, value_name = "SIZE", value_parser = memory_size)]
    memory: Option<u64>,
}

/// Parses a shape of out-of-focus points that the processor and the graphics card have.
fn round_bokeh(text: &str) -> std::result::Result<Bokeh, String> {
    match blindaug_cli::arguments::bokeh(text)? {
        Bokeh::Polygon { .. } => Err("here, it is gaussian or disk".into()),
        shape => Ok(shape),
    }
}

fn main() -> ExitCode {
    let live = match Live::try_parse() {
        Ok(live) => live,
        Err(e) => return ExitCode::from(console::said(&e)),
    };
    console::begin(live.memory);
    console::catch_signals();
    ExitCode::from(console::ended(run(&live)))
}

/// The footage, and the object that is put into it.
struct Scene {
    source: Arc<FrameSource>,
    object: Object,
    camera: Pinhole,
    home: Home,
    /// Frames per second, as given or else as the source says.
    fps: Option<f64>,
}

impl Scene {
    /// A stage on a device of its own.
    fn stage(&self) -> Result<Stage> {
        Gpu::new().map_err(|e| Failure(e.to_string())).and_then(|gpu| self.stage_on(gpu))
    }

    fn stage_on(&self, gpu: Gpu) -> Result<Stage> {
        Stage::new(gpu, self.object.clone(), self.camera, self.pace()).map_err(|e| Failure(e.to_string()))
    }

    /// The frames per second that are played.
    fn pace(&self) -> f64 {
        self.fps.unwrap_or(DEFAULT_FPS)
    }

    /// The height that is seen at the home distance, m.
    fn seen(&self) -> f64 {
        self.camera.seen_height(self.home.distance)
    }

    fn is_camera(&self) -> bool {
        live::names_camera(self.source.path())
    }
}

/// Runs the command.
fn run(args: &Live) -> Result<()> {
    if let Some(output) = &args.output {
        output::check(output, &Inputs::of([Some(&args.input), args.object.as_ref()].into_iter().flatten()))?;
    }
    let source = live::open(&args.input)?;
    for sentence in source.notes() {
        note(format_args!("{}: {sentence}", args.input.display()));
    }
    let object = match &args.object {
        Some(path) => {
            let object = Object::load(path)?;
            for sentence in &object.notes {
                note(format_args!("{}: {sentence}", path.display()));
            }
            object
        }
        None => Object::built_in(),
    };
    let camera = Pinhole::new(source.size(), args.fov);
    let home = Home { at: FOOT, distance: args.distance };
    let fps = args.fps.or(source.fps());
    let scene = Scene { source: Arc::new(source), object, camera, home, fps };
    let look = Look {
        split: args.split as f32,
        size: (args.size * scene.seen()) as f32,
        options: CompositeOptions { naive: false, bokeh: args.bokeh, ..args.style.options() },
        quality: Quality::default(),
    };
    let (true, Some(frames), Some(path)) = (args.headless, args.frames, &args.output) else {
        return window::run(scene, look);
    };
    // The stage is made before the output, so that no output is left if there is no device.
    let stage = scene.stage()?;
    let (size, pixel_aspect) = (scene.source.size(), scene.source.pixel_aspect());
    let expected = Expected { size, fps: scene.fps, count: Some(frames), video_bits: 8, pixel_aspect };
    let files = ImageFiles::plain(FrameFormat::PNG8);
    let mut output = output::open(path, &expected, files, &[], args.overwrite)?;
    if output.has_frames() {
        return Err(failure(
            path,
            "there are frames in this folder already; add --overwrite, or give another one",
        ));
    }
    let last = headless::run(&scene, stage, &look, frames, &mut output)?;
    output::finish(path, output, &Made { frames: last, ..Made::default() })?;
    if last < frames {
        let sentence =
            format!("stopped after frame {last} of {frames}; for all of them, run it again with --overwrite");
        return Err(failure(path, sentence));
    }
    Ok(())
}
