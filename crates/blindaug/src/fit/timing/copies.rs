//! Frames that repeat the one before, and motion over missing frames, told while a clip is looked at, for the estimators.
//!
//! Copies come where a clip was converted to a higher frame rate, or where a camera delivers its last picture once more. Beside a copy nothing
//! moves for a frame interval, so that motion seems uneven, streaks too short and noise too weak. Of a picture that is repeated, only the last
//! frame is therefore looked at, with the pictures before and after as its neighbours.

use super::FOUND;
use super::decide::{DIFFERENCE, MOVES, difference_sign};
use super::measure::{largest, mean_at_some, mean_of};
use crate::{Encoded, luma};
use std::collections::VecDeque;

/// The number of pairs of frames before a pair that say how much it should differ.
const NEAR: usize = 6;
/// The number of pairs of frames before a pair from which the spread of the sign is found.
const AROUND: usize = 24;
/// The spread of the sign while there are too few pairs to find it.
const USUAL_SPREAD: f32 = 0.33;
/// The largest difference of a copy, in steps of 8 bits: a coder leaves less, while the noise of a camera that stops is mostly more.
const LARGEST: f32 = 0.3;
/// The approximate number of pixels of a frame that are compared.
const SAMPLES: usize = 20_000;
/// The ratio of speeds from which on an even motion seems to go over missing frames. An even motion hardly changes from frame to frame; over
/// one missing frame everything moves twice as far.
const SUDDEN: f32 = 1.6;
/// The fewest copies that may come regularly.
const FEWEST: u64 = 4;

/// Tells which frames are repeated by the next one.
#[derive(Default)]
pub(in crate::fit) struct Copies {
    /// The mean differences in the cells of the last pairs of frames, encoded values.
    differences: VecDeque<Vec<f32>>,
    /// The signs of the last pairs.
    signs: VecDeque<f32>,
    /// The frames that were passed over since one was looked at.
    passed: Option<Passed>,
    /// The number of frames that the picture looked at last repeats.
    repeated: usize,
    /// The number of frames so far.
    frames: u64,
    found: Found,
}

/// The frames of one picture that were passed over.
struct Passed {
    /// The number of the frames.
    count: usize,
    /// The frame before them, if that was given.
    before: Option<Encoded>,
    /// The difference of the last one to its copy.
    difference: Vec<f32>,
}

/// The frames that were passed over so far.
#[derive(Default)]
struct Found {
    count: u64,
    /// The number of the last one.
    last: u64,
    /// The shortest and the longest distance of one to the next.
    distances: Option<[u64; 2]>,
    /// The first and the last one after the longest distance, as the number of the frame and how many were passed over before it: between
    /// them lie whole periods.
    periods: [(u64, u64); 2],
    /// The number of pictures, of those looked at, that were repeated.
    repeated: usize,
    /// The number of these beside which frames are missing.
    with_gap: usize,
}

/// What is to be made of a frame.
pub(in crate::fit) enum Look {
    /// The next frame repeats the frame, and is to be looked at in its place.
    Pass,
    /// The frame is to be looked at.
    At {
        /// The number of frames before it that it repeats.
        repeated: usize,
        /// The number of frames that the picture before repeats.
        repeated_before: usize,
        /// The picture before, where the frame repeats any, and it is known.
        before: Option<Encoded>,
    },
}

impl Copies {
    /// Says what is to be made of the next frame in the order of time.
    pub fn look(&mut self, frame: &Encoded, next: Option<&Encoded>, previous: Option<&Encoded>) -> Look {
        let number = self.frames;
        self.frames += 1;
        // Frames may have been left out since.
        let passed = self.passed.take().filter(|passed| {
            previous.is_some_and(|previous| difference(previous, frame) == passed.difference)
        });
        let (repeated, before) = passed.map_or((0, None), |passed| (passed.count, passed.before));
        let difference = next.map(|next| difference(frame, next));
        let Some(difference) = difference.filter(|difference| self.repeats(difference)) else {
            let repeated_before = std::mem::replace(&mut self.repeated, repeated);
            return Look::At { repeated, repeated_before, before };
        };
        self.found.add(number);
        let before = if repeated > 0 { before } else { previous.cloned() };
        self.passed = Some(Passed { count: repeated + 1, before, difference });
        Look::Pass
    }

    /// Whether a pair of frames with these differences shows one picture twice. The pair is one of those around the next ones.
    fn repeats(&mut self, difference: &[f32]) -> bool {
        let (found, sign) = self.told_by(difference);
        if !self.differences.is_empty() {
            self.signs.push_back(sign);
        }
        self.differences.push_back(difference.to_vec());
        self.signs.drain(..self.signs.len().saturating_sub(AROUND));
        self.differences.drain(..self.differences.len().saturating_sub(NEAR));
        found
    }

    /// Whether a pair of frames with these differences shows one picture twice, and the sign of that.
    fn told_by(&self, difference: &[f32]) -> (bool, f32) {
        let cells = |values: &[f32]| 255.0 * mean_of(values, &largest(values));
        let most = |a: Vec<f32>, b: &Vec<f32>| a.iter().zip(b).map(|(a, b)| a.max(*b)).collect();
        let expected = self.differences.iter().fold(vec![0.0; difference.len()], most);
        let (own, expected) = (cells(difference), cells(&expected));
        let sign = difference_sign([own, expected]);
        let spread = DIFFERENCE.spread(self.signs.iter().copied()).unwrap_or(USUAL_SPREAD);
        let is_same = difference.iter().all(|&v| v == 0.0);
        let is_copy = is_same || (own <= LARGEST && DIFFERENCE.tells(sign, spread) >= FOUND);
        (expected >= MOVES && is_copy, sign)
    }

    /// Whether two successive frames, which need not be those looked at, show one picture.
    pub fn are_one_picture(&self, frame: &Encoded, next: &Encoded) -> bool {
        self.told_by(&difference(frame, next)).0
    }

    /// Whether frames seem to be missing on one side of a picture, where the motion is `speed_ratio` times as fast as on the other. If the
    /// picture repeats n frames, they do from a ratio of the root of n + 1 on; if it repeats none, from [`SUDDEN`] on, and only where motion
    /// was even so far (`is_even`).
    pub fn gap_beside(&mut self, repeated: usize, speed_ratio: f32, is_even: bool) -> bool {
        if repeated == 0 {
            return is_even && speed_ratio > SUDDEN;
        }
        let is_gap = speed_ratio > (repeated as f32 + 1.0).sqrt();
        self.found.repeated += 1;
        self.found.with_gap += usize::from(is_gap);
        is_gap
    }

    /// Forgets how much frames differ, as at a cut.
    pub fn begin_shot(&mut self) {
        self.differences.clear();
        self.signs.clear();
        self.passed = None;
    }

    /// The number of pictures per second of a clip of `fps` frames per second, if its copies come regularly, else `fps`.
    pub fn pictures_per_second(&self, fps: Option<f64>) -> Option<f64> {
        let Found { count, last, distances, periods: [from, to], repeated, with_gap } = self.found;
        match distances {
            Some([shortest, longest])
                if count >= FEWEST
                    && longest - shortest <= 1
                    && self.frames - last <= longest + 1
                    && 2 * with_gap <= repeated
                    // While one picture stays, there are no others to count.
                    && to.1 - from.1 < to.0 - from.0 =>
            {
                Some(fps? * (1.0 - (to.1 - from.1) as f64 / (to.0 - from.0) as f64))
            }
            _ => fps,
        }
    }

    /// A sentence for the user about the copies, if there are any.
    pub fn words(&self, fps: Option<f64>) -> Option<String> {
        let Found { count, repeated, with_gap, .. } = self.found;
        let rate = self.pictures_per_second(fps).filter(|rate| Some(*rate) != fps);
        let others = match rate {
            Some(rate) => format!(
                "; the exposure is a share of the interval of the others, {} of which come a second",
                (100.0 * rate).round() / 100.0
            ),
            None if 2 * with_gap > repeated => ", mostly in the place of one that is missing".into(),
            None => "; the exposure is a share of the interval of the others".into(),
        };
        (count > 0).then(|| {
            format!("{count} of {} frames repeat the one before, and are left out{others}", self.frames)
        })
    }
}

impl Found {
    fn add(&mut self, number: u64) {
        if self.count > 0 {
            let distance = number - self.last;
            let here = (number, self.count);
            match &mut self.distances {
                Some([shortest, longest]) if distance <= *longest => {
                    *shortest = distance.min(*shortest);
                    if distance == *longest {
                        self.periods[1] = here;
                    }
                }
                distances => {
                    *distances = Some([distances.map_or(distance, |d| d[0]), distance]);
                    self.periods = [here; 2];
                }
            }
        }
        self.last = number;
        self.count += 1;
    }
}

/// The mean difference of luma in each cell of two frames, encoded values, at some of the pixels.
fn difference(Encoded(frame): &Encoded, Encoded(next): &Encoded) -> Vec<f32> {
    mean_at_some(frame.size(), SAMPLES, 0, |x, y| (luma(next.at(x, y)) - luma(frame.at(x, y))).abs())
}
