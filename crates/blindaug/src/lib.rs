//! Blind estimation of a camera's noise, motion blur and defocus from its footage, and their synthesis on virtual content.
//!
//! Footage goes into a [`fit::Estimator`], frame by frame; a [`CameraModel`] comes out, in which every number has an
//! interval, or a reason why it is unknown. [`composite::composite`] then puts a rendered layer over a frame as if that
//! camera had filmed it. This crate reads no files (`blindaug-io` does) and uses no GPU; without the feature `threads` it
//! also builds for the web.
//!
//! ```
//! use blindaug::composite::{CompositeOptions, Plate, VirtualLayer, composite};
//! use blindaug::fit::{Estimator, Evidence, FrameObservation};
//! use blindaug::{Encoded, Flow, Plane, Premultiplied, Raster};
//!
//! // Two frames of a noisy wall.
//! let noise = |x: usize, y: usize, t: u32| {
//!     let mut h = (x as u32) ^ ((y as u32) << 12) ^ (t << 24);
//!     (0..3).for_each(|_| h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d));
//!     (h >> 16) as f32 / 65536.0 - 0.5
//! };
//! let filmed = |t| Encoded(Raster::from_fn(160, 128, |x, y| [0.3 + x as f32 / 500.0 + 0.1 * noise(x, y, t); 3]));
//! let (frame, next) = (filmed(1), filmed(2));
//!
//! // Frames in, camera model out.
//! let mut estimator = Estimator::new(Default::default());
//! let still = Flow::filled(160, 128, [0.0; 2]);
//! estimator.add(&FrameObservation {
//!     frame: &frame,
//!     next: Some(&next),
//!     previous: None,
//!     evidence: Evidence { flow: Some(&still), ..Default::default() },
//! })?;
//! let camera = estimator.estimate()?.model;
//! assert!(camera.noise.known().is_some());
//! // Nothing moves and nothing has texture, so the shutter and the lens are unknown.
//! println!("{}", camera.motion_blur.why_unknown().unwrap());
//! assert!(camera.defocus.why_unknown().is_some());
//! println!("{}", camera.to_json());
//!
//! // A layer and a frame in, a composite out. A layer's colour is premultiplied and in linear light.
//! let square = |x: usize, y: usize| (60..100).contains(&x) && (40..80).contains(&y);
//! let layer = VirtualLayer {
//!     color: Premultiplied(Raster::from_fn(160, 128, |x, y| if square(x, y) { [0.2, 0.4, 0.1, 1.0] } else { [0.0; 4] })),
//!     inverse_depth: Some(Plane::filled(160, 128, 0.5)),
//!     flow: Some(Flow::filled(160, 128, [8.0, 0.0])),
//! };
//! let plate = Plate::new(&frame, 1);
//! let out = composite(&plate, &layer, &camera, &CompositeOptions::default())?;
//! assert_eq!(out.0.at(5, 5), frame.0.at(5, 5));
//! assert_ne!(out.0.at(80, 60), frame.0.at(80, 60));
//! # Ok::<(), blindaug::Error>(())
//! ```
//!
//! | module | from | to |
//! |---|---|---|
//! | [`analysis`] | frames | optical flow, relative inverse depth |
//! | [`fit`] | frames and evidence | [`CameraModel`] with intervals |
//! | [`model`] | | the camera model and its file |
//! | [`synth`] | sharp images, the model | defocus, motion blur, noise: the reference for every other backend |
//! | [`composite`] | a layer, a frame, the model | the composite |
//! | [`matching`] | a frame of one camera, two models | the frame as the other camera would show it |
//! | [`export`] | the model | settings of other people's tools |
//! | [`metrics`] | two frames | PSNR, SSIM |
//! | [`text`] | text from outside | one printable line |

pub mod analysis;
mod colour;
pub mod colour_space;
pub mod composite;
mod error;
pub mod export;
pub mod filter;
pub mod fit;
mod frame;
pub mod matching;
pub mod metrics;
pub mod model;
mod overscan;
mod par;
mod portable;
pub mod pyramid;
mod raster;
mod strips;
pub mod synth;
pub mod text;
mod transfer;

pub use colour::{
    BRIGHTEST, ByteRows, Encoded, LUMA, Linear, Premultiplied, byte_from_encoded, finite_light, luma,
    word_from_encoded,
};
pub use error::{Error, Result};
pub use frame::{Frame, Sample};
pub use model::CameraModel;
pub use overscan::Overscan;
pub use raster::{Flow, Pixel, Plane, Raster};
pub use transfer::Transfer;
