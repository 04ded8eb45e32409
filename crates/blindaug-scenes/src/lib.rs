//! Scenes whose truth is known, cameras that film them, and estimates compared with that truth.
//!
//! A [`scene::Scene`] is a textured room that a moving camera looks into; it gives exact depth and optical flow. A [`camera::Camera`] films
//! it with a known exposure, lens and noise, either by the project's own synthesis or by physics alone (many pinhole views over lens and
//! shutter, counted photons), so that no model is judged by itself. [`measure`] compares an estimate with the truth.
//!
//! ```
//! use blindaug_scenes::scene::{Exposure, Scene};
//!
//! let scene = Scene::new(3, (64, 48));
//! let sharp = scene.picture(0.0, Exposure::default(), 1);
//! // A lens that blurs what is far away by a std of 4 px, focused at 1 m.
//! let blurred = scene.picture(0.0, Exposure { lens: Some((4.0, 1.0)), ..Exposure::default() }, 1);
//! let contrast = |image: &blindaug::Linear| {
//!     let row = image.0.row(10);
//!     row.windows(2).map(|w| (w[1][1] - w[0][1]).abs()).sum::<f32>()
//! };
//! assert!(contrast(&blurred) < 0.7 * contrast(&sharp));
//! ```

pub mod camera;
pub mod measure;
pub mod moved;
pub mod scene;
pub mod thing;
