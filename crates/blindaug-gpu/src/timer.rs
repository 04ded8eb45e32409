//! The time that the compositor's steps take on the GPU.

use crate::Gpu;
use blindaug::{Error, Result};
use wgpu::{BufferUsages, QueryType};

/// The steps of [`crate::Compositor::encode`], in their order.
pub const STEPS: [&str; 5] = ["extension", "octaves", "defocus", "sharpening", "composite"];

/// The indices of the steps in [`STEPS`].
pub(crate) const EXTENSION: u32 = 0;
pub(crate) const OCTAVES: u32 = 1;
pub(crate) const DEFOCUS: u32 = 2;
pub(crate) const SHARPENING: u32 = 3;
pub(crate) const COMPOSITE: u32 = 4;

/// Begins a pass of compute shaders, and times it as a step if there is a timer.
pub(crate) fn compute_pass<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    timer: Option<&Timer>,
    step: u32,
) -> wgpu::ComputePass<'a> {
    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
        label: Some(STEPS[step as usize]),
        timestamp_writes: timer.map(|t| t.compute(step)),
    })
}

/// Timestamps around each step of a frame.
#[derive(Debug)]
pub struct Timer {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    readable: wgpu::Buffer,
    period: f32,
}

/// The number of timestamps: the beginning and the end of each step.
const QUERIES: u32 = 2 * STEPS.len() as u32;

impl Timer {
    /// A timer for frames on this device.
    ///
    /// # Errors
    /// If the device has no timestamps.
    pub fn new(gpu: &Gpu) -> Result<Self> {
        if !gpu.device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return Err(Error::new("this graphics device has no timestamps; time whole frames instead"));
        }
        let buffer = |usage| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("timestamps"),
                size: 8 * u64::from(QUERIES),
                usage,
                mapped_at_creation: false,
            })
        };
        Ok(Self {
            queries: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("steps"),
                ty: QueryType::Timestamp,
                count: QUERIES,
            }),
            resolved: buffer(BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC),
            readable: buffer(BufferUsages::MAP_READ | BufferUsages::COPY_DST),
            period: gpu.queue.get_timestamp_period(),
        })
    }

    /// The timestamps that the compute pass of a step writes.
    fn compute(&self, step: u32) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * step),
            end_of_pass_write_index: Some(2 * step + 1),
        }
    }

    /// The timestamps that a render pass of a step writes. There is a pass per eye: the first one writes the beginning of the step, the
    /// last one its end.
    pub(crate) fn render(&self, step: u32, first: bool, last: bool) -> wgpu::RenderPassTimestampWrites<'_> {
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: first.then_some(2 * step),
            end_of_pass_write_index: last.then_some(2 * step + 1),
        }
    }

    /// Records the copy of the timestamps into a buffer that can be read.
    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..QUERIES, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.readable, 0, 8 * u64::from(QUERIES));
    }

    /// The milliseconds of each of [`STEPS`] in the frame that was submitted last; a step that was not needed takes what an empty
    /// pass takes. Waits for the device.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn read(&self, gpu: &Gpu) -> Result<[f32; STEPS.len()]> {
        let bytes = gpu.read(&self.readable)?;
        let ticks: &[u64] = bytemuck::cast_slice(&bytes);
        Ok(std::array::from_fn(|i| ticks[2 * i + 1].saturating_sub(ticks[2 * i]) as f32 * self.period * 1e-6))
    }
}
