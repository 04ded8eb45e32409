//! `blindaug validate`: measures how far estimates lie from the truth, on scenes that it makes, on rendered clips and on real pixels.

use crate::console::{self, CONSOLE, Result, failure, note};
use blindaug_io::{Error, Inputs, write_atomically};
use blindaug_pipeline::Networks;
use blindaug_research::run::{Provenance, Run};
use blindaug_research::validation::{self, Job, clips, real, still};
use blindaug_scenes::measure::Given;
use blindaug_scenes::moved;
use std::path::{Path, PathBuf};

/// Measure how far estimates lie from the truth: the paper's experiments, on scenes that are made here
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug validate --quick -o validation")]
pub struct Validate {
    /// A folder for the results: index.html, validate.json, and a file per case, so that a run that was stopped goes on
    #[arg(short, long, value_name = "DIR", default_value = "blindaug-validate")]
    output: PathBuf,
    /// Scenes; each is filmed with every setting by two cameras, the project's synthesis and one of physics, and with each noise by a third
    #[arg(long, value_name = "N", default_value = "10", value_parser = clap::value_parser!(u64).range(1..=1000))]
    scenes: u64,
    /// Frames of each scene; ten of ten scenes, with each of 73 settings, take about three hours on two cores
    #[arg(long, value_name = "N", default_value = "10", value_parser = clap::value_parser!(u64).range(1..=1000))]
    frames: u64,
    /// Also code the frames of the camera of physics as H.264 video with this constant rate factor (0 to 51; 18 is good, 28 is bad); may be
    /// repeated. Needs the ffmpeg program; takes a third as long again for each
    #[arg(long, value_name = "CRF", value_parser = clap::value_parser!(u8).range(0..=51))]
    coded: Vec<u8>,
    /// Also rendered clips: a folder with a folder per clip, each with truth.json
    #[arg(long, value_name = "DIR")]
    clips: Option<PathBuf>,
    /// Measure only noise, on this real clip of a camera that stood still: the median over time is the truth
    #[arg(long, value_name = "CLIP", conflicts_with_all = ["scenes", "frames", "coded", "clips", "quick"])]
    still: Option<PathBuf>,
    /// Only the exposure, of these photographs: each is moved along steady and shaking paths while the shutter is open; a folder of images
    #[arg(long, value_name = "DIR", conflicts_with_all = ["scenes", "frames", "coded", "clips", "quick", "still", "network", "overwrite"])]
    photos: Option<PathBuf>,
    /// Only the exposure, of this real video: n of every N successive frames averaged in light make one frame of exposure n/N, or
    /// somewhat less, down to (n - 1)/N, as the video's own exposure is unknown
    #[arg(long, value_name = "CLIP", conflicts_with_all = ["scenes", "frames", "coded", "clips", "quick", "still", "network", "overwrite"])]
    film: Option<PathBuf>,
    /// Only the clips, no scenes
    #[arg(long, requires = "clips", conflicts_with = "coded")]
    only_clips: bool,
    /// A network that removes noise or blur, for the rows "by networks": a name of `blindaug models list`, or a manifest; may be
    /// repeated. `none`: leave these rows out [default: the built-in ones]
    #[arg(long, value_name = "NAME")]
    network: Vec<String>,
    /// A run of a minute: one small scene, few settings
    #[arg(long, conflicts_with_all = ["scenes", "frames"])]
    quick: bool,
    /// Measure cases anew that are there already
    #[arg(long)]
    overwrite: bool,
}

/// Runs the command.
pub fn run(args: &Validate) -> Result<()> {
    if args.photos.is_some() || args.film.is_some() {
        return measure_real(args.photos.as_deref(), args.film.as_deref(), &args.output);
    }
    let mut networks = Networks::named(&args.network, true, CONSOLE)?;
    if let Some(clip) = &args.still {
        return console::print(&still::measure(clip, &mut networks, CONSOLE)?);
    }
    Inputs::of(args.clips.iter()).check_output_folder(&args.output, |_| true)?;
    let job = Job {
        scenes: if args.only_clips { 0 } else { args.scenes },
        frames: args.frames,
        quick: args.quick,
        coded: args.coded.clone(),
        paper_alone: false,
        given: Given::ALL.into(),
        clips: args.clips.as_deref().map(clips::conditions).transpose()?.unwrap_or_default(),
        networks: args.network.clone(),
    };
    let run = Run::new(&args.output, Provenance::here(0), args.overwrite, CONSOLE)?;
    let found = validation::findings(&validation::run(&run, &job, &mut networks)?);
    for table in &found.tables {
        console::print(&format!("{}\n", table.text()))?;
    }
    let page = run.write("validate", "Validation", &[found])?;
    finish(&run, &args.output, &page)
}

/// Says where the page of a run lies, and what is missing in it.
pub fn finish(run: &Run, output: &Path, page: &Path) -> Result<()> {
    let [already, done, all] = run.counts();
    if already > 0 {
        note(format_args!("{already} of {all} cases were there already; --overwrite measures them anew"));
    }
    note(format_args!("written: {}", Error::shown_path(page)));
    match run.is_stopped() {
        true => Err(failure(
            output,
            format_args!("stopped after {done} of {all} cases; run the same command again to go on"),
        )),
        false => Ok(()),
    }
}

/// Measures the exposure of moved photographs, of averaged frames of a video, or of both.
fn measure_real(photos: Option<&Path>, film: Option<&Path>, output: &Path) -> Result<()> {
    let inputs = Inputs::of(photos.iter().chain(film.iter()));
    inputs.check_output_folder(output, |_| true)?;
    blindaug_io::make_folder(output)?;
    let mut all = vec![];
    if let Some(folder) = photos {
        all.extend(real::of_photos(folder, CONSOLE)?);
    }
    if let Some(clip) = film {
        all.extend(real::of_film(clip, CONSOLE)?);
    }
    let text = moved::table(&all);
    let json = serde_json::to_string_pretty(&all).expect("what was found is plain data");
    for (name, text) in [("real.json", &json), ("real.md", &text)] {
        write_atomically(output.join(name), |partial| std::fs::write(partial, text))?;
    }
    console::print(&text)?;
    if film.is_some() {
        note(
            "of averaged frames, the exposure is n/N only if the video's own shutter is open all the time; every exposure from (n - 1)/N, for one that is hardly open, to n/N counts as true",
        );
    }
    note(format_args!("written: {}", output.join("real.json").display()));
    Ok(())
}
