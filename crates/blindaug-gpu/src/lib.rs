//! A camera's noise, motion blur and defocus on virtual content in real time, on any device that
//! [wgpu](https://docs.rs/wgpu) reaches. The reference for everything here is the crate `blindaug`.

mod camera;
mod composite;
mod gpu;
mod kernel;
pub mod noise;
mod shaders;
mod timer;

pub use composite::{Area, Bound, Compositor, Depth, Frame, Inputs, Options, Quality, Velocity};
pub use gpu::{Gpu, array_view};
pub use timer::{STEPS, Timer};
