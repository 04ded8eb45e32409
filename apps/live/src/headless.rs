//! Makes the window's pictures without a window. Each frame is estimated in turn, so that runs can be repeated.

use super::{Scene, spectra::Spectra, times::Times};
use blindaug::fit::track::TileObserver;
use blindaug_cli::console::{self, Result, failure, note};
use blindaug_pipeline::{
    Output,
    live::{LiveEstimator, Loop},
};
use blindaug_report::words::count;
use blindaug_stage::{Look, Stage};
use std::time::{Duration, Instant};

/// The time between messages about the progress.
const TELL: Duration = Duration::from_secs(1);

/// Makes and writes `frames` frames, or fewer after Ctrl-C, and returns their number.
pub fn run(scene: &Scene, mut stage: Stage, look: &Look, frames: u64, output: &mut Output) -> Result<u64> {
    let source = &*scene.source;
    let mut clip = Loop::new(source);
    let mut estimation = LiveEstimator::new(scene.camera, scene.home, scene.fps);
    let size = source.size();
    let mut spectra = Spectra::of(&stage, size);
    if let Some(sentence) = stage.slow() {
        note(format_args!("{sentence}"));
    }
    let mut told = Told::new(frames);
    let mut rounded = None;
    while let Some(shot) = clip.next_frame()? {
        let start = Instant::now();
        let of_frame =
            |e: blindaug::Error| failure(source.path(), format_args!("frame {}: {e}", shot.number));
        let observer = spectra.as_mut().filter(|s| s.works()).map(|s| s as &mut dyn TileObserver);
        let estimate = estimation.push(&shot, scene.home, observer).map_err(of_frame)?;
        let estimated = start.elapsed();
        if rounded.is_none() {
            rounded =
                stage.rounded(&estimate.camera, look).inspect(|sentence| note(format_args!("{sentence}")));
        }
        let times = match Times::of_drawing(&stage, &shot, &estimate, look) {
            Ok(times) => times,
            Err(e) => {
                note(format_args!("{e}; starting again on a new one"));
                stage = scene.stage()?;
                spectra = Spectra::of(&stage, size);
                Times::of_drawing(&stage, &shot, &estimate, look).map_err(of_frame)?
            }
        };
        output.write(shot.number, &stage.read().map_err(of_frame)?)?;
        told.step(shot.number, start.elapsed(), estimated, times);
        if shot.number == frames {
            console::print(&format!("{}\n", estimate.tracked.to_json_line()))?;
        }
        if shot.number == frames || console::interrupted() {
            return Ok(shot.number);
        }
    }
    Err(failure(source.path(), "there are no frames in it"))
}

/// The message of each second: the mean times of a frame since the last message.
struct Told {
    total: u64,
    since: Instant,
    frames: u32,
    whole: Duration,
    estimate: Duration,
    times: Times,
}

impl Told {
    fn new(total: u64) -> Self {
        let zero = Duration::ZERO;
        Self { total, since: Instant::now(), frames: 0, whole: zero, estimate: zero, times: Times::default() }
    }

    fn step(&mut self, number: u64, whole: Duration, estimate: Duration, times: Times) {
        self.frames += 1;
        self.whole += whole;
        self.estimate += estimate;
        self.times.render += times.render;
        self.times.composite += times.composite;
        if self.since.elapsed() < TELL && number < self.total {
            return;
        }
        let ms = |sum: Duration| 1e3 * sum.as_secs_f64() / f64::from(self.frames);
        note(format_args!(
            "{} of {}, {:.1} ms a frame (estimate {:.1}, render {:.1}, composite {:.1})",
            number,
            count(self.total, "frame"),
            ms(self.whole),
            ms(self.estimate),
            ms(self.times.render),
            ms(self.times.composite)
        ));
        *self = Self::new(self.total);
    }
}
