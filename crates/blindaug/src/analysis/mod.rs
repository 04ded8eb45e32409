//! What the frames themselves say of the scene: optical flow, and relative inverse depth from parallax.

pub(crate) mod brightness;
pub mod depth;
pub mod flow;
mod variational;
