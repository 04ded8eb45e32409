//! A camera's noise, motion blur and defocus on virtual content in real time, and their estimation, on any device that
//! [wgpu](https://docs.rs/wgpu) reaches. The reference for everything here is the crate `blindaug`.

pub mod fit;
mod gpu;
mod kernel;

pub use gpu::{Gpu, array_view};
