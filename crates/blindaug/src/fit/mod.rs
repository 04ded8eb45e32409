//! Estimation of a camera model from footage.
//!
//! [`Estimator`] takes frames one after another, with whatever evidence is at hand, and gives one [`crate::CameraModel`];
//! [`track::Tracker`] gives one model for each frame.
//! Two families of estimators measure blur: [`spectral`] looks at the frames' spectra; [`motion_blur`] and [`defocus`] compare
//! with given clean frames (the paper's way), [`removal`] with sharp versions that it finds itself. [`Family::Auto`] takes, for each
//! distortion, the family with the tighter interval; it does not use [`removal`] without clean frames, which is less accurate.

mod agreement;
mod bokeh;
pub mod defocus;
mod distant;
mod estimator;
mod fourier;
mod geometry;
mod likelihood;
mod linear;
pub mod motion_blur;
pub mod noise;
mod observation;
pub mod removal;
mod robust;
mod sharpening;
pub mod spectral;
mod streaks;
mod tiles;
pub mod timing;
pub mod track;
mod uneven;
mod warnings;

pub use defocus::BlurPoint;
pub use estimator::Estimator;
pub use observation::{
    Curve, Diagnostics, Estimation, EstimatorOptions, Evidence, Family, FrameObservation, Shot,
};
#[cfg(test)]
pub(crate) use robust::uniform;
