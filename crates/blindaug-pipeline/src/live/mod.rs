//! Frames as they come: the camera, and the place of an object in the picture.

mod estimate;
mod frames;
mod placement;

pub use estimate::{Home, LiveEstimate, LiveEstimator};
pub use frames::{LiveFrame, Loop};
pub use placement::{Pinhole, Placed, Placement, Pose};
