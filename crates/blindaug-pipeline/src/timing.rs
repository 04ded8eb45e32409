//! Doubled, dropped and interpolated frames of a clip.

use crate::{
    Result,
    estimate::{of_clip, of_frame},
    footage::{Clip, READ_AHEAD, all_frames, read_ahead},
    frames::FRAME,
    observer::{Observer, Steps, warn},
};
use blindaug::{
    Transfer,
    fit::timing::{Timing, TimingAnalyser},
    model::Stopped,
};

/// What the frames of a clip tell of their times.
#[derive(Clone, Debug, PartialEq)]
pub struct Timed {
    /// The findings.
    pub timing: Timing,
    /// The number of the first frame.
    pub first: u64,
    /// The number of the last frame.
    pub last: u64,
    /// The progress, if the observer stopped the job before the end of the clip.
    pub stopped: Option<Stopped>,
}

/// Looks for frames, encoded by this curve, that were not taken at their time. A gap in the frames' numbers counts as a cut.
///
/// # Errors
/// If a frame cannot be used, there is only one, or memory does not suffice.
pub fn timing(clip: &dyn Clip, transfer: Transfer, observer: &dyn Observer) -> Result<Timed> {
    let (width, height) = clip.size();
    let per_pixel = TimingAnalyser::BYTES_PER_PIXEL + FRAME * (READ_AHEAD as u64 + 1);
    let kept = TimingAnalyser::BYTES_PER_FRAME * clip.len_hint().unwrap_or(0) as u64;
    let what = format!("a comparison of frames of {width} x {height} pixels");
    clip.check_memory(&what, per_pixel * (width * height) as u64 + kept)?;
    let mut analyser = TimingAnalyser::new(transfer);
    let (mut first, mut last, mut seen, mut stopped) = (None, 0, 0, None);
    let steps = Steps::begin(observer, "comparing", "frames", clip.len_hint());
    read_ahead(clip, all_frames, |frames| -> Result<()> {
        for frame in frames {
            let frame = frame?;
            last = frame.number;
            first.get_or_insert(last);
            analyser.push(last, frame.image).map_err(|e| of_frame(clip, last, e))?;
            seen += 1;
            steps.step();
            if observer.stops() && clip.len_hint() != Some(seen) {
                stopped = Some(Stopped { after: seen, of: clip.len_hint() });
                break;
            }
        }
        Ok(())
    })?;
    drop(steps);
    warn(observer, clip.warning());
    let timing = analyser.finish().map_err(|e| of_clip(clip, e))?;
    Ok(Timed { timing, first: first.unwrap_or(0), last, stopped })
}
