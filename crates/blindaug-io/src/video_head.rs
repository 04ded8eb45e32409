//! The properties in a video's head.

use crate::yuv::Colour;
use blindaug::colour_space::ColourSpace;

/// The properties of a video, as its head gives them.
#[derive(Clone, Debug)]
pub(crate) struct VideoHead {
    /// Frames per second; `None` if they are not known.
    pub fps: Option<f64>,
    /// The approximate number of frames; `None` if it is not known.
    pub frames: Option<usize>,
    pub colour: Colour,
    /// The colour space of the frames once they are RGB. Rec. 709 counts as sRGB, as which screens show it.
    pub space: ColourSpace,
    /// The number of quarter turns clockwise that show a frame upright, 0 to 3.
    pub quarter_turns: u8,
    /// The width of a pixel of a frame as it is stored over its height; `None` if it is not known.
    pub pixel_aspect: Option<f32>,
    /// Notes for the user, a sentence each.
    pub notes: Vec<String>,
}

/// The note for the user on interlaced video.
pub(crate) const INTERLACED: &str = "the video is interlaced: every other row was filmed at another time, and both are taken for one picture, \
    which falsifies motion and exposure; deinterlace it first (ffmpeg -i IN -vf bwdif -c:v libx264 -crf 12 OUT.mp4)";

/// A note for the user if frames are not evenly spaced in time; `times` are in s and ascend.
pub(crate) fn uneven(times: &[f64]) -> Option<String> {
    /// The largest error of the time between two frames, s: containers round times, to a ms at the coarsest.
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
