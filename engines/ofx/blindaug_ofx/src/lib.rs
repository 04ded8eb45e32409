//! An OpenFX plugin, *blindaug Match camera*: a rendered object in footage, as the footage's camera would have filmed it.
//!
//! | module | what it does |
//! |---|---|
//! | `host` | the host's functions, handles and images behind safe types; the only unsafe code |
//! | [`knobs`] | the parameters: their names, units, ranges and hints, and their values at a time |
//! | `pixels` | the images' values as rasters, and back |
//! | [`shot`] | one frame: what blindaug makes of the layer, the plate and the camera; knows no host |
//! | `analysis` | the camera, estimated from the plate's frames |
//! | `effect` | what the host asks for, done with the above |
//!
//! Everything that is computed is computed by the crates `blindaug` and `blindaug-pipeline`.

mod analysis;
mod effect;
mod host;
pub mod knobs;
mod pixels;
pub mod shot;

pub use host::{OfxGetNumberOfPlugins, OfxGetPlugin};
