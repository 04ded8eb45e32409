//! A camera's noise, motion blur and defocus on virtual content in real time, and their estimation ([`fit`]), by
//! [wgpu](https://docs.rs/wgpu) on Vulkan, Metal, DirectX 12 and WebGPU. The reference for everything here is the crate `blindaug`.
//!
//! ```
//! use blindaug::{CameraModel, Raster, composite::CompositeOptions, model::Capture};
//! use blindaug_gpu::{Compositor, Frame, Gpu, Inputs, Quality};
//! use wgpu::{TextureFormat, TextureUsages};
//!
//! # fn main() -> blindaug::Result<()> {
//! # let Ok(_) = Gpu::new() else { return Ok(()) };
//! // A renderer has its own device and textures; this example makes some.
//! let gpu = Gpu::new()?;
//! let frame = gpu.upload(&[&Raster::filled(64, 48, [0.5f32, 0.5, 0.5, 1.0])], TextureFormat::Rgba8Unorm)?;
//! let color = gpu.upload(&[&Raster::filled(64, 48, [0.0f32; 4])], TextureFormat::Rgba16Float)?;
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
//! let camera = CameraModel::unknown(Capture { width: 64, height: 48, fps: None, frames_used: 0 }, "not yet");
//!
//! // The compositor is made once, the bindings once per size of frames.
//! let compositor = Compositor::new(&gpu.device, &gpu.queue, target.format());
//! let inputs = Inputs { frame: &frame, color: &color, depth: None, velocity: None, apart: false };
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
//!     timer: None,
//! };
//! compositor.encode(&gpu.queue, &mut encoder, &bound, &of_frame)?;
//! gpu.queue.submit([encoder.finish()]);
//! # let out = gpu.download::<[f32; 4]>(&target)?;
//! # assert!((out[0].at(5, 5)[0] - 0.5).abs() < 0.01);
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
pub use gpu::{Gpu, array_view, texture};
pub use inputs::{Depth, Inputs, Velocity};
pub use kernel::{bind, full_screen};
pub use quality::Quality;
pub use sharpening::unsharpening_steps;
pub use timer::{STEPS, Timer};
