//! The estimation of a camera model on the device: the parts of `blindaug::fit` that take most of the time.
//!
//! Each type is bound to its textures when it is made, and then allocates nothing more. `submit` hands the device a frame's work and
//! returns at once; `poll` gives the result once the device is done, usually a frame later. `blindaug` finishes the estimate from a handful
//! of numbers for each place or tile.
//!
//! | type | counterpart in `blindaug::fit` |
//! |---|---|
//! | [`defocus::PooledSearch`] | `defocus::pooled_search` |
//! | [`motion_blur::ExposureSearch`] | `motion_blur::fit_exposure` |
//! | [`spectral::TileEvidence`] | `spectral::tiles` and the likelihoods that `spectral::fit_exposure` and `spectral::fit_lens` sum |

pub mod defocus;
pub mod motion_blur;
pub mod spectral;

use crate::gpu::Mapped;
use crate::kernel::{Binding, Kernel};
use blindaug::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

/// A buffer whose contents are on their way back from the device.
#[derive(Debug)]
struct Readback {
    source: wgpu::Buffer,
    landing: wgpu::Buffer,
    /// The state of the transfer: one of the constants below.
    state: Arc<AtomicU8>,
}

const IDLE: u8 = 0;
const UNDER_WAY: u8 = 1;
const ARRIVED: u8 = 2;
const LOST: u8 = 3;

impl Readback {
    /// A new buffer of `len` f32 that kernels write to.
    fn new(device: &wgpu::Device, label: &str, len: usize) -> Self {
        let buffer = |usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: 4 * len.max(4) as u64,
                usage,
                mapped_at_creation: false,
            })
        };
        Self {
            source: buffer(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC),
            landing: buffer(wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
            state: Arc::new(AtomicU8::new(IDLE)),
        }
    }

    /// Whether nothing is under way and nothing waits to be picked up.
    fn is_idle(&self) -> bool {
        self.state.load(Ordering::Acquire) == IDLE
    }

    /// Runs what `encode` puts into a pass, and sends the buffer's contents back.
    fn submit(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        label: &str,
        encode: impl FnOnce(&mut wgpu::ComputePass),
    ) {
        let mut encoder =
            device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) });
        encode(
            &mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(label),
                timestamp_writes: None,
            }),
        );
        encoder.copy_buffer_to_buffer(&self.source, 0, &self.landing, 0, self.source.size());
        queue.submit([encoder.finish()]);
        self.state.store(UNDER_WAY, Ordering::Release);
        let state = Arc::clone(&self.state);
        self.landing.map_async(wgpu::MapMode::Read, .., move |mapped| {
            state.store(if mapped.is_ok() { ARRIVED } else { LOST }, Ordering::Release);
        });
    }

    /// Gives what `read` makes of the contents, if they have arrived.
    ///
    /// # Errors
    /// If the device was lost.
    fn poll<T>(&mut self, device: &wgpu::Device, read: impl FnOnce(&[f32]) -> T) -> Result<Option<T>> {
        let lost = |why: &dyn std::fmt::Display| {
            Error::new(format!("the graphics device stopped working ({why}); make it anew"))
        };
        device.poll(wgpu::PollType::Poll).map_err(|e| lost(&e))?;
        match self.state.load(Ordering::Acquire) {
            ARRIVED => {}
            LOST => return Err(lost(&"a buffer could not be read")),
            _ => return Ok(None),
        }
        let view = self.landing.get_mapped_range(..).mapped().map_err(|e| lost(&e))?;
        let out = read(bytemuck::cast_slice(&view));
        drop(view);
        self.landing.unmap();
        self.state.store(IDLE, Ordering::Release);
        Ok(Some(out))
    }
}

/// A kernel with its bindings and its number of threads along each axis.
#[derive(Debug)]
struct Stage {
    kernel: Kernel,
    group: wgpu::BindGroup,
    threads: [u32; 3],
}

impl Stage {
    /// Compiles a kernel as [`Kernel::new`] does, and binds its resources.
    fn new(
        device: &wgpu::Device,
        source: &str,
        entry: &str,
        workgroup: [u32; 3],
        threads: [u32; 3],
        bindings: &[Bound],
    ) -> Self {
        let (kinds, resources): (Vec<_>, Vec<_>) = bindings.iter().cloned().unzip();
        let kernel = Kernel::new(device, source, entry, workgroup, &kinds);
        let group = kernel.bind(device, &resources);
        Self { kernel, group, threads }
    }

    fn run(&self, pass: &mut wgpu::ComputePass) {
        self.kernel.run(pass, &self.group, self.threads);
    }
}

/// The kind of a binding and its resource.
type Bound<'a> = (Binding, wgpu::BindingResource<'a>);

fn view(view: &wgpu::TextureView) -> Bound<'_> {
    (Binding::Texels, wgpu::BindingResource::TextureView(view))
}

fn uniform(buffer: &wgpu::Buffer) -> Bound<'_> {
    (Binding::Uniform, buffer.as_entire_binding())
}

fn read(buffer: &wgpu::Buffer) -> Bound<'_> {
    (Binding::Buffer, buffer.as_entire_binding())
}

fn write(buffer: &wgpu::Buffer) -> Bound<'_> {
    (Binding::BufferMut, buffer.as_entire_binding())
}

/// Makes a buffer that only the device reads and writes.
fn storage(device: &wgpu::Device, label: &str, bytes: usize) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: bytes as u64,
        usage: wgpu::BufferUsages::STORAGE,
        mapped_at_creation: false,
    })
}

/// Makes a buffer that holds `contents`.
fn filled<T: bytemuck::NoUninit>(
    device: &wgpu::Device,
    label: &str,
    contents: &[T],
    usage: wgpu::BufferUsages,
) -> wgpu::Buffer {
    use wgpu::util::DeviceExt;
    device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some(label),
        contents: bytemuck::cast_slice(contents),
        usage,
    })
}

/// The width and height, px, of textures that must share them.
///
/// # Errors
/// If the sizes differ.
fn common_size(textures: &[&wgpu::Texture]) -> Result<[u32; 2]> {
    let size = |t: &wgpu::Texture| [t.width(), t.height()];
    let first = size(textures[0]);
    match textures.iter().find(|t| size(t) != first) {
        None => Ok(first),
        Some(other) => Err(Error::new(format!(
            "a texture has {} x {} px, another {} x {}: all must have one size",
            other.width(),
            other.height(),
            first[0],
            first[1]
        ))),
    }
}
