//! Networks for the five operators of the paper's pipeline: removal of noise, of motion blur and of defocus, optical flow and depth.
//!
//! The networks are data, not code: a [`Manifest`] (TOML) beside an ONNX file gives the network's operator, inputs and output.
//! [`Store`] finds manifests and files, [`Network`] runs a network on frames of any size, and [`Chain`] runs those in the
//! [`Slots`] one after another as in the paper.
//!
//! | module | content | shapes |
//! |---|---|---|
//! | [`manifest`] | a network's operator, inputs and output | |
//! | [`runtime`] | ONNX: `rten`, or ONNX Runtime where `ORT_DYLIB_PATH` names it | tensors of f32 |
//! | [`network`] | padding, tiles, value ranges | frames in, frame / flow / inverse depth of the same size out |
//! | [`chain`] | removal over a window of frames | |
//! | [`store`], [`install`] | the built-in networks and the user's model folder | |

pub mod chain;
pub mod install;
pub mod manifest;
pub mod network;
mod onnx;
pub mod runtime;
pub mod store;
mod tiles;

pub use chain::{Chain, Operator, Removed, Slots};
pub use manifest::{Manifest, Slot};
pub use network::Network;
pub use store::{State, Store};
