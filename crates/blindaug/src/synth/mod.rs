//! Synthesis of each distortion: the reference that every other backend is compared with.

pub mod defocus;
pub mod motion_blur;
pub mod noise;
