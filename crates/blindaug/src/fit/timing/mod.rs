//! Frames of a clip that were not taken at their time: doubled ones, dropped ones, and ones that were made from their neighbours.
//!
//! Each kind leaves a sign, a number that is about 0 for a frame as it should be:
//! - **doubled**: a frame differs from the one before by far less than the pairs of frames around it do;
//! - **dropped**: between two frames everything moves n + 1 times as far as between their neighbours, while the streaks of motion blur in
//!   both stay as long as the exposure makes them; a camera that really moves faster draws longer streaks;
//! - **interpolated**: a frame is nearer to a mixture of its neighbours, in place or along the motion, than frames around it are, and
//!   its finest detail is weaker, since the mean of two noises is.
//!
//! A sign's own spread over the frames around, which is large where a hand shakes, says how much it tells. Errors are taken to be
//! Laplacian, whose tails are long, and what a sign tells is a log-likelihood ratio in nats. What lies above [`FOUND`] is told.

mod copies;
mod decide;
mod measure;

use crate::{Encoded, Error, Result, Transfer};
pub(super) use copies::{Copies, Look};
use measure::Measurer;
use serde::Serialize;

/// The log-likelihood ratio, in nats, from which on something is told: of 1000 to 1, as such frames are rare.
pub const FOUND: f32 = 6.9;

/// Takes the frames of a clip one after another, and tells which were not taken at their time.
pub struct TimingAnalyser {
    measurer: Measurer,
}

impl TimingAnalyser {
    /// An analyser of frames that this curve encodes.
    pub fn new(transfer: Transfer) -> Self {
        Self { measurer: Measurer::new(transfer) }
    }

    /// The most bytes, approximately, for each pixel of a frame, beside the frame that is given.
    pub const BYTES_PER_PIXEL: u64 = 200;
    /// The bytes, approximately, that are kept of each frame.
    pub const BYTES_PER_FRAME: u64 = 1600;

    /// Takes the next frame. If its number does not follow the last one's, a new shot begins with it, as after a cut.
    ///
    /// # Errors
    /// If the frame has no pixels, or another size than the one before.
    pub fn push(&mut self, number: u64, image: Encoded) -> Result<()> {
        self.measurer.push(number, image)
    }

    /// What the frames tell.
    ///
    /// # Errors
    /// If there were fewer than two frames.
    pub fn finish(mut self) -> Result<Timing> {
        self.measurer.end_shot();
        if self.measurer.seen.len() < 2 {
            return Err(Error::new(
                "there is only one frame, which cannot be compared with any; give a clip",
            ));
        }
        Ok(decide::timing(&self.measurer.seen))
    }
}

/// What the frames of a clip tell of their times.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Timing {
    /// The number of frames.
    pub frames: usize,
    /// The number of shots.
    pub shots: usize,
    /// The exposure fraction that the streaks of all frames agree on; `None` if they do not tell.
    pub exposure: Option<f32>,
    /// The findings in the order of their frames.
    pub findings: Vec<Finding>,
    /// The kinds of findings that come back regularly.
    pub cadences: Vec<Cadence>,
    /// The frames of which a kind of finding cannot be told.
    pub unknown: Vec<Untold>,
}

/// A frame that was not taken at its time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The number of the frame: the one that repeats the frame before, the one after which frames are missing, or the one that was made
    /// from its neighbours.
    pub frame: u64,
    /// The finding, with its evidence.
    #[serde(flatten)]
    pub event: Event,
    /// The log of the likelihood of the signs with this finding over that without it, nats.
    pub log_likelihood_ratio: f32,
}

/// The kinds of findings, with their evidence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Event {
    /// The frame repeats the one before.
    Doubled {
        /// The mean difference to the frame before where pictures around it differ most, in steps of 8 bits.
        difference: f32,
        /// The same between the pairs of frames around it.
        expected: f32,
    },
    /// Frames are missing after this one.
    Dropped {
        /// The number of missing frames.
        missing: u32,
        /// The motion to the next frame over that between the frames around.
        motion_ratio: f32,
        /// What the lengths of the streaks in both frames say of it, nats; negative: the camera really moves faster. `None`: nothing.
        streaks: Option<f32>,
    },
    /// The frame was made from its neighbours.
    Interpolated {
        /// How it was made.
        how: Interpolation,
        /// The share of the next frame in the mixture that is nearest to it.
        share: f32,
        /// The mean difference to that mixture where the neighbours differ most, in steps of 8 bits.
        to_blend: f32,
        /// The mean difference to the neighbours' mean along the motion, in steps of 8 bits.
        to_warp: f32,
        /// The finest detail over that of the neighbours.
        detail: f32,
    },
}

/// The ways of making a frame from its neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Interpolation {
    /// As a mixture of both, in place.
    Blend,
    /// As a mixture of both, along the motion.
    Warp,
}

/// The kinds of findings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// [`Event::Doubled`].
    Doubled,
    /// [`Event::Dropped`].
    Dropped,
    /// [`Event::Interpolated`].
    Interpolated,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Doubled, Self::Dropped, Self::Interpolated];

    /// The kind in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Doubled => "doubled",
            Self::Dropped => "dropped",
            Self::Interpolated => "interpolated",
        }
    }
}

impl Event {
    /// The kind of the finding.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Doubled { .. } => Kind::Doubled,
            Self::Dropped { .. } => Kind::Dropped,
            Self::Interpolated { .. } => Kind::Interpolated,
        }
    }
}

/// A kind of finding that comes back in the same places of every period.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Cadence {
    /// The kind of finding.
    pub kind: Kind,
    /// The number of frames after which it comes back.
    pub period: u64,
    /// How many of these frames have the finding.
    pub of_period: usize,
}

/// Frames of which a kind of finding cannot be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Untold {
    /// The kind of finding.
    pub kind: Kind,
    /// The number of the first frame.
    pub first: u64,
    /// The number of the last frame.
    pub last: u64,
    /// The reason.
    pub reason: WhyUntold,
}

/// The reasons why something cannot be told of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum WhyUntold {
    /// At the ends of a shot, or of a short one, there are too few frames to compare with.
    TooShort,
    /// Too little moves.
    Still,
    /// Too little of the frame is found again in the next one.
    NotFollowed,
    /// A neighbour was found to be doubled or interpolated.
    BesideAnother,
}

impl WhyUntold {
    /// The reason in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::TooShort => "too few frames around",
            Self::Still => "too little moves",
            Self::NotFollowed => "the motion could not be followed",
            Self::BesideAnother => "beside a doubled or interpolated frame",
        }
    }
}
