//! Blind estimation of a camera's noise, motion blur and defocus from its footage, and their synthesis on virtual content.

pub mod analysis;
mod colour;
pub mod composite;
mod error;
pub mod filter;
pub mod fit;
pub mod metrics;
pub mod model;
mod par;
pub mod pyramid;
mod raster;
pub mod synth;

pub use colour::{Encoded, Linear, Premultiplied, Transfer, luma};
pub use error::{Error, Result};
pub use model::CameraModel;
pub use raster::{Flow, Pixel, Plane, Raster};
