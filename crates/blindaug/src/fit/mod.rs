//! From evidence to a camera model.

pub mod defocus;
pub mod motion_blur;
pub mod noise;
