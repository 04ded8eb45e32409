//! What a video says of itself.

use crate::yuv::Colour;

/// What a video says of itself.
#[derive(Clone, Debug)]
pub(crate) struct VideoHead {
    /// Frames per second.
    pub fps: Option<f64>,
    /// Number of frames, nearly.
    pub frames: Option<usize>,
    pub colour: Colour,
    /// Quarter turns clockwise to show a frame upright.
    pub quarter_turns: u8,
    /// Sentences for a person.
    pub notes: Vec<String>,
}

/// What is said of interlaced video.
pub(crate) const INTERLACED: &str = "the video is interlaced: every other row was filmed at another time, and both are taken for one picture, \
    which falsifies motion and exposure; deinterlace it first (ffmpeg -i IN -vf bwdif -c:v libx264 -crf 12 OUT.mp4)";

/// A sentence about frames that are not evenly spaced; `times` in s, rising.
pub(crate) fn uneven(times: &[f64]) -> Option<String> {
    /// Containers round times, to a ms at the coarsest.
    const ROUNDING: f64 = 0.0011;
    let apart = || times.windows(2).map(|t| t[1] - t[0]);
    let (least, most) = apart().fold((f64::INFINITY, 0.0f64), |(lo, hi), t| (lo.min(t), hi.max(t)));
    if most - least <= 2.0 * ROUNDING || most <= 1.1 * least {
        return None;
    }
    let mean = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let [least, most, mean] = [least, most, mean].map(|t| 1e3 * t);
    Some(format!(
        "its frames are not evenly spaced in time ({least:.0} to {most:.0} ms apart): the exposure is a share of the time from a frame \
         to the next, as if that were {mean:.0} ms throughout; footage of a constant frame rate is surer"
    ))
}
