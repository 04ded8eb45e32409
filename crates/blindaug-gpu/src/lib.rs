//! A camera's noise, motion blur and defocus on virtual content in real time, and their estimation ([`fit`]), by
//! [wgpu](https://docs.rs/wgpu) on Vulkan, Metal, DirectX 12 and WebGPU. The reference for everything here is the crate `blindaug`.
//!
//! ```
//! use blindaug::{ByteRows, CameraModel, Encoded, Raster, composite::CompositeOptions};
//! use blindaug::model::{Capture, DefocusModel, Estimate, ExposureFraction, MotionBlurModel};
//! use blindaug_gpu::{Compositor, Depth, Frame, Gpu, Inputs, Quality, Velocity};
//! use wgpu::{TextureFormat, TextureUsages};
//!
//! # fn main() -> blindaug::Result<()> {
//! # let Ok(_) = Gpu::new() else { return Ok(()) };
//! // A renderer has its own device and textures; this example makes some, of a camera's frame in bytes, and of a square in front of it.
//! let gpu = Gpu::new()?;
//! let (w, h) = (64, 48);
//! let filmed = Encoded::from_rgba8((w, h), ByteRows::new(&[128; 64 * 48 * 4], 64 * 4))?;
//! let frame = gpu.upload(&[&filmed.0.map(|[r, g, b]| [r, g, b, 1.0])], TextureFormat::Rgba8Unorm)?;
//! let is_square = |x: usize, y: usize| (24..40).contains(&x) && (16..32).contains(&y);
//! let square = Raster::from_fn(w, h, |x, y| if is_square(x, y) { [0.8, 0.1, 0.1, 1.0] } else { [0.0f32; 4] });
//! let color = gpu.upload(&[&square], TextureFormat::Rgba16Float)?;
//! // The depth buffer of a projection whose near plane is at 0.1 m and whose depth is 0.1 m / Z: here the square is at 2 m.
//! let buffer = Raster::from_fn(w, h, |x, y| if is_square(x, y) { 0.05f32 } else { 0.0 });
//! let depth = gpu.upload(&[&buffer], TextureFormat::R32Float)?;
//! // Motion in shares of the picture per frame, y down: here 6 px to the right.
//! let velocity = gpu.upload(&[&Raster::filled(w, h, [6.0f32 / 64.0, 0.0])], TextureFormat::Rg16Float)?;
//! let target = gpu.device.create_texture(&wgpu::TextureDescriptor {
//!     label: None,
//!     size: frame.size(),
//!     mip_level_count: 1,
//!     sample_count: 1,
//!     dimension: wgpu::TextureDimension::D2,
//!     format: TextureFormat::Rgba8Unorm,
//!     usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC,
//!     view_formats: &[],
//! });
//! // The camera is usually estimated, or read from a file.
//! let mut camera = CameraModel::unknown(Capture { width: w, height: h, fps: None, frames_used: 0, pixel_aspect: 1.0 }, "not yet");
//! camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.5)));
//! camera.defocus = Estimate::Known(DefocusModel::given_lens(3.0, 1.0));
//!
//! // The compositor is made once, the bindings once per size of frames.
//! let compositor = Compositor::new(&gpu.device, &gpu.queue, target.format());
//! let inputs = Inputs {
//!     frame: &frame,
//!     color: &color,
//!     depth: Some(Depth { texture: &depth, scale: 1.0 / 0.1, offset: 0.0, nothing: Some(0.0) }),
//!     velocity: Some(Velocity { texture: &velocity, scale: [w as f32, h as f32] }),
//!     cleared: true,
//!     apart: false,
//! };
//! let bound = compositor.bind(&gpu.device, &inputs)?;
//! // This is repeated for each frame.
//! let mut encoder = gpu.device.create_command_encoder(&Default::default());
//! let targets = [target.create_view(&Default::default())];
//! let of_frame = Frame {
//!     model: &camera,
//!     options: CompositeOptions::default(),
//!     quality: Quality::High,
//!     number: 0,
//!     area: None,
//!     targets: &targets,
//!     frame_in_targets: false,
//!     timer: None,
//! };
//! compositor.encode(&gpu.queue, &mut encoder, &bound, &of_frame)?;
//! gpu.queue.submit([encoder.finish()]);
//! # let out = gpu.download::<[f32; 4]>(&target)?;
//! # // Far from the square the frame is as it was; the square's edges are soft, those on the left and right more so.
//! # let red = |x: usize, y: usize| out[0].at(x, y)[0] - out[0].at(x, y)[1];
//! # assert!((out[0].at(5, 5)[0] - 0.5).abs() < 0.01 && red(32, 24) > 0.4);
//! # assert!(red(22, 24) > red(32, 14) && red(32, 14) > 0.02, "{} {}", red(22, 24), red(32, 14));
//! # Ok(())
//! # }
//! ```

mod blocks;
mod bound;
mod camera;
mod composite;
pub mod fit;
mod gpu;
mod inputs;
mod kernel;
mod layout;
pub mod noise;
mod passes;
mod prelude;
mod quality;
mod shaders;
mod sharpening;
mod timer;
mod uniforms;

pub use blocks::Block;
pub use bound::Bound;
pub use composite::{Area, Compositor, Frame};
pub use gpu::{Gpu, array_view, layer_views, texture};
pub use inputs::{Depth, Inputs, Velocity};
pub use kernel::{bind, full_screen};
pub use quality::{Quality, rounded};
pub use sharpening::unsharpening_steps;
pub use timer::{STEPS, Timer};
