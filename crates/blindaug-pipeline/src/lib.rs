//! Camera models and composites from footage: the code that every front end needs between frames and results.
//!
//! | module | from | to |
//! |---|---|---|
//! | [`footage`] | files, memory, or whatever implements [`Clip`] and [`Side`] | numbered frames with their accompanying data |
//! | [`estimate`] | [`Footage`] | one camera model, and the frames that it rests on |
//! | [`track`] | [`Footage`] | a camera model for each frame |
//! | [`composite`] | a [`composite::Scene`] and a camera | frames with a virtual object, or a whole clip distorted |
//! | [`matching`] | a [`Clip`] and two cameras | the clip as the other camera would show it |
//! | [`timing`] | a [`Clip`] | its doubled, dropped and interpolated frames |
//! | [`live`] | frames as they come | the camera and the place of an object, frame by frame |
//!
//! Nothing here prints or ends a process, and only what plays a clip reads a clock ([`live::Player`]): an [`Observer`] is told how far a job has come and says when to stop. The feature
//! `files` (on by default) adds frames and results in files, `networks` (on by default) neural networks; without both the crate also builds
//! for the web.
//!
//! An example with frames in memory, a camera for each frame, and a composite:
//!
//! ```
//! use blindaug::composite::{CompositeOptions, VirtualLayer};
//! use blindaug::{Encoded, Plane, Premultiplied, Raster};
//! use blindaug_pipeline::{Footage, MemoryClip, MemorySink, Silent, composite, composite::Product, track};
//! use std::collections::BTreeMap;
//!
//! let frames: Vec<Encoded> = (0..3)
//!     .map(|t| Encoded(Raster::from_fn(96, 64, |x, y| [((x * 7 + y * 13 + t * 5) % 97) as f32 / 97.0; 3])))
//!     .collect();
//! let footage = Footage::new(MemoryClip { frames: frames.clone(), fps: Some(25.0) });
//! let tracked = track::track(&footage, track::Job::default(), &Silent, &mut |camera| {
//!     println!("{}", camera.to_json_line());
//!     Ok(())
//! })?;
//! assert_eq!(tracked.track.frames().len(), 3);
//!
//! let square = |x: usize| if (20..40).contains(&x) { [0.2, 0.4, 0.1, 1.0] } else { [0.0; 4] };
//! let layer = VirtualLayer {
//!     color: Premultiplied(Raster::from_fn(96, 64, |x, _| square(x))),
//!     inverse_depth: Some(Plane::filled(96, 64, 0.5)),
//!     flow: None,
//! };
//! let footage = Box::new(MemoryClip { frames, fps: None });
//! let scene = composite::Scene::new(footage, Box::new(BTreeMap::from([(2, layer.into())])));
//! let mut made = MemorySink::default();
//! let options = (&CompositeOptions::default(), Product::Composite);
//! composite::composite(&scene, &tracked.track, options, &mut made, &Silent)?;
//! assert_eq!(made.frames.len(), 3);
//! # Ok::<(), blindaug_pipeline::Error>(())
//! ```
#![cfg_attr(
    feature = "files",
    doc = r#"
A folder of frames, an estimate, and its report as a `String`:

```
use blindaug_io::FrameSource;
use blindaug_pipeline::{Footage, Silent, estimate};
use blindaug_report::{ReportInput, page};

# let dir = tempfile::tempdir().unwrap();
# let folder = dir.path();
# for i in 1..=2u32 {
#     let noise = |x: usize, y: usize| ((x as u32 * 73 + y as u32 * 151 + i * 997).wrapping_mul(2_654_435_761) >> 24) as f32 / 2550.0;
#     let frame = blindaug::Encoded(blindaug::Raster::from_fn(96, 64, |x, y| [0.4 + noise(x, y); 3]));
#     blindaug_io::write_png(folder.join(format!("{i}.png")), &frame).unwrap();
# }
let footage = Footage::new(FrameSource::open(folder, Default::default())?);
let fitted = estimate::estimate(&footage, estimate::Job::default(), &Silent)?;
let estimation = &fitted.estimation;
let html = page(&ReportInput::new("A folder", &estimation.model, &estimation.diagnostics)).unwrap();
assert!(html.contains("A folder"));
# Ok::<(), blindaug_pipeline::Error>(())
```
"#
)]

mod by_hand;
pub mod composite;
mod error;
pub mod estimate;
pub mod footage;
mod frames;
pub mod live;
pub mod matching;
#[cfg(feature = "networks")]
mod networks;
mod observer;
mod operators;
#[cfg(feature = "files")]
mod output;
pub mod timing;
pub mod track;
mod window;

pub use by_hand::ByHand;
pub use error::{Error, Result};
pub use footage::{BoxedSide, Clip, Footage, MemoryClip, Side};
pub use frames::{Made, MemorySink, Sink};
#[cfg(feature = "networks")]
pub use networks::Networks;
pub use observer::{Observer, Silent, Steps};
pub use operators::{EvidenceSink, Operators};
#[cfg(feature = "files")]
pub use output::{ImageFiles, Output};
