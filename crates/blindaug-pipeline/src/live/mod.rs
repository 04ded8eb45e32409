//! Live estimation: the camera and the place of an object, frame by frame.

mod estimate;
mod frames;
mod placement;

pub use estimate::{Home, LiveEstimate, LiveEstimator};
pub use frames::{LiveFrame, Loop};
pub use placement::{Pinhole, Placed, Placement, Pose};
