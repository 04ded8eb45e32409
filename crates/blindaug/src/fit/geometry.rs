//! Motion and depth in a frame, found with its neighbour, for both [`super::Estimator`] and [`super::track::Tracker`].
//!
//! The estimator looks at whole frames, and detects a cut before it follows them. The tracker looks at reduced frames, with parallax in
//! every third frame, near the camera's last direction, and with a scale of depth that it drops as soon as too little is found again;
//! the parameters of [`Follower::follow`] make these differences.

use super::observation::FrameObservation;
use crate::analysis::cuts::MIN_CONFIRMED;
use crate::analysis::depth::{Parallax, ParallaxTracker, inverse_depth_from_flow};
use crate::analysis::flow::{FlowEstimator, FlowPair};
use crate::model::Unknown;
use crate::{Error, Flow, Plane, Raster, Result};

/// Finds flow between frames, and depth from its parallax.
pub(super) struct Follower {
    flow: FlowEstimator,
    parallax: ParallaxTracker,
    near_the_last: bool,
}

/// The flow and the depth that were found between a frame and its neighbour.
pub(super) struct Followed {
    /// Optical flow to the neighbour, px, NaN where the backward flow contradicts it; `None` if too little of the frame is found again.
    pub flow: Option<Flow>,
    /// The share of the frame that is found again, in [0, 1].
    pub confirmed: f32,
    /// The depth by parallax, if parallax was looked for.
    pub parallax: Option<Parallax>,
}

/// The conditions under which parallax is looked for.
#[derive(Clone, Copy)]
pub(super) struct WantsParallax {
    /// The least share of the frame that must be found again, in [0, 1].
    pub confirmed: f32,
    /// The number of frames until parallax is looked for again.
    pub stride: usize,
}

impl Follower {
    /// A follower that has seen nothing; `near_the_last`: whether the camera's direction is searched near the last direction only.
    pub fn new(near_the_last: bool) -> Self {
        let mut new = Self { flow: FlowEstimator::new(), parallax: ParallaxTracker::new(), near_the_last };
        new.forget_scale();
        new
    }

    /// Forgets the scale of relative depth, so that later depth is in another unit.
    pub fn forget_scale(&mut self) {
        let new = ParallaxTracker::new();
        self.parallax = if self.near_the_last { new.near_the_last() } else { new };
    }

    /// Follows a frame (luma) to its neighbour.
    pub fn follow(&mut self, from: &Plane, to: &Plane, wants: Option<WantsParallax>) -> Result<Followed> {
        let pair = self.flow.flow_with_occlusion(from, to)?;
        let confirmed = pair.confirmed();
        let flow = (confirmed >= MIN_CONFIRMED).then(|| known_flow(&pair));
        let parallax = match wants.filter(|w| confirmed >= w.confirmed) {
            Some(WantsParallax { stride, .. }) => Some(self.parallax.push(&pair, stride)?),
            None => None,
        };
        Ok(Followed { flow, confirmed, parallax })
    }
}

/// The depth by parallax of a frame whose flow was given.
pub(super) fn parallax_of(flow: &Flow) -> Result<Parallax> {
    let unknown = flow.map(|f| !f[0].is_finite());
    inverse_depth_from_flow(flow, &unknown)
}

/// The forward flow, NaN where the backward flow does not confirm it.
fn known_flow(pair: &FlowPair) -> Flow {
    let (w, h) = pair.forward.size();
    Flow::from_fn(w, h, |x, y| if pair.occluded.at(x, y) { [f32::NAN; 2] } else { pair.forward.at(x, y) })
}

/// The reason why the depth is unknown if none was given and parallax gives none.
pub(super) fn no_parallax(why: &Unknown) -> Unknown {
    Unknown::new(why.reason, format!("no depth was given, and parallax gives none: {why}"))
}

/// Fails if a frame or its evidence differs in size from the first frame, or if the frame is not finite. `first` is the size of the first
/// frame, and is set by the first call.
pub(super) fn check_sizes(first: &mut Option<(usize, usize)>, observation: &FrameObservation) -> Result<()> {
    let FrameObservation { frame, next, previous, evidence } = observation;
    let size = frame.0.size();
    if size.0 == 0 || size.1 == 0 {
        return Err(Error::new("the frame has no pixels"));
    }
    let first = *first.get_or_insert(size);
    let removed = [evidence.denoised, evidence.motion_deblurred, evidence.defocus_deblurred, evidence.clean];
    let others = [*next, *previous].into_iter().chain(removed).flatten().map(|i| i.0.size());
    let others =
        others.chain(evidence.flow.map(Raster::size)).chain(evidence.inverse_depth.map(|d| d.0.size()));
    for s in others.chain([first]) {
        if s != size {
            return Err(Error::new(format!(
                "a frame or its evidence has {} x {} px, another {} x {}: all must have one size",
                s.0, s.1, size.0, size.1
            )));
        }
    }
    if frame.0.data().iter().flatten().any(|v| !v.is_finite()) {
        return Err(Error::new(
            "the frame holds values that are not finite numbers: export it again without NaN or infinity",
        ));
    }
    Ok(())
}
