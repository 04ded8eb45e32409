//! Scenes whose truth is known, cameras that film them, and estimates compared with that truth.
//!
//! A [`scene::Scene`] is a textured room that a moving camera looks into; it gives exact depth and optical flow. [`thing::Thing`]s can be
//! added to it, or rendered alone as virtual objects. A [`camera::Camera`] films it with a known exposure, lens and noise, either by the
//! project's own synthesis or by physics alone (many pinhole views over lens and shutter, counted photons), so that no model is judged
//! by itself. [`measure`] compares an estimate with the truth.
//!
//! ```
//! use blindaug::composite::{CompositeOptions, Plate, composite};
//! use blindaug::{Encoded, Transfer};
//! use blindaug_scenes::camera::{Setting, model};
//! use blindaug_scenes::scene::{Exposure, Scene, TextureKind};
//! use blindaug_scenes::thing::Thing;
//!
//! // A ball in focus at 0.8 m, and a lens that blurs what is far away by a std of 3 px.
//! let scene = Scene::new(3, (64, 48));
//! let ball = Thing::ball(scene.point_at(0.0, [32.0, 24.0], 0.8), 0.15, TextureKind::Bricks, 7);
//! let lens = Some((3.0, 0.8));
//! let film = |scene: &Scene| {
//!     scene.picture(0.0, Exposure { lens, ..Exposure::default() }, 1).to_encoded(Transfer::Srgb)
//! };
//!
//! // The ball is filmed, and it is composited as a virtual object over the frame without it.
//! let (truth, frame) = (film(&scene.clone().with(ball.clone())), film(&scene));
//! let (depth, motion) = (scene.inverse_depth(0.0), scene.motion(0.0));
//! let plate = Plate { inverse_depth: Some(&depth), flow: Some(&motion), ..Plate::new(&frame, 0) };
//! let setting = Setting { exposure: 0.0, lens, noise: 0.0, readout: 0.0, rolling_shutter: 0.0 };
//! let layer = scene.layer(&ball, 0.0).into();
//! let virtual_one = composite(&plate, &layer, &model(scene.size(), &setting), &CompositeOptions::default())?;
//! let apart = |a: &Encoded| {
//!     let values = a.0.data().iter().flatten().zip(truth.0.data().iter().flatten());
//!     values.map(|(a, b)| (a - b).abs()).sum::<f32>()
//! };
//! assert!(apart(&virtual_one) < 0.1 * apart(&frame));
//! # Ok::<(), blindaug::Error>(())
//! ```

pub mod camera;
pub mod measure;
pub mod moved;
mod rectangles;
pub mod scene;
pub mod thing;
