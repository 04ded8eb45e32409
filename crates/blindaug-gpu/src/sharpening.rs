//! The camera's sharpening in the compositor: it unsharpens the frame, and sharpens the change that the layer makes to it.
//!
//! The frame is unsharpened by Richardson's iteration `u + s (frame - sharpened u)`, as the reference does, but with the steps s of
//! Chebyshev's polynomial instead of equal ones: half as many steps or fewer leave as little of the sharpening. Between the steps the
//! difference to the frame is kept, which half floats hold more exactly than the frame itself.
//!
//! All passes work on the blocks within the mask's reach of what is seen; elsewhere, the difference is zero. So the iteration finds the
//! difference within these blocks that undoes the sharpening there, and where something is seen, all that the mask reads is within them.

use crate::blocks::BLOCK;
use crate::gpu::{array_view, texture};
use crate::kernel::{Binding, Kernel, bind, layout};
use crate::passes::{BETWEEN, Passes, Views, pipeline, view};
use crate::shaders;
use crate::uniforms::MaskPass;
use blindaug::model::SharpeningModel;
use blindaug::synth::sharpening::LEFT;
use blindaug::{Error, Result, filter};
use wgpu::{BindGroup, BufferUsages, ShaderStages, TextureFormat, TextureUsages};

/// The most steps that the iteration takes: those for an amount of 20, the largest that a camera model may have. For a larger amount the
/// iteration leaves more of the sharpening than the reference does.
const MOST_STEPS: usize = 16;

/// The most taps of the right half of the mask's Gaussian.
const MOST_TAPS: usize = 4096;

/// Bytes from one pass's numbers to the next one's: the alignment that every device allows for parts of uniform buffers.
const SLOT: usize = 256;

/// The step sizes of the iteration that unsharpens a mask of this amount: the inverses of the roots of Chebyshev's polynomial over the
/// mask's gains, 1 to 1 + amount. Their number is such that at most [`LEFT`] of what the sharpening did is left.
fn step_sizes(amount: f32) -> Vec<f32> {
    let amount = f64::from(amount);
    let root = (1.0 + amount).sqrt();
    let rate = (root - 1.0) / (root + 1.0);
    let steps = ((f64::from(LEFT) / 2.0).ln() / rate.ln()).ceil() as usize;
    let steps = steps.clamp(2, MOST_STEPS);
    let gain = |i: usize| {
        let angle = std::f64::consts::PI * (i as f64 + 0.5) / steps as f64;
        1.0 + 0.5 * amount * (1.0 - angle.cos())
    };
    // Leja's order keeps rounding errors from growing: it begins with the lowest gain, and each next root is the one farthest from those
    // before.
    let mut left: Vec<f64> = (0..steps).map(gain).collect();
    let mut ordered = vec![left.remove(0)];
    while !left.is_empty() {
        let far = |g: f64| ordered.iter().map(|o| (g - o).abs().ln()).sum::<f64>();
        let next = (0..left.len()).max_by(|&a, &b| far(left[a]).total_cmp(&far(left[b]))).unwrap_or(0);
        ordered.push(left.remove(next));
    }
    ordered.iter().map(|gain| (1.0 / gain) as f32).collect()
}

/// The number of steps of the iteration that undoes a camera's sharpening before an object is composited; each step moves 48 bytes per
/// pixel.
pub fn unsharpening_steps(sharpening: &SharpeningModel) -> u32 {
    step_sizes(sharpening.amount).len() as u32
}

/// The distance up to which a change of an image affects its sharpened version, px, and at least that up to which the frame is smoothed for
/// its noise.
pub(crate) fn reach_px(sharpening: &SharpeningModel) -> u32 {
    (filter::gaussian_kernel(sharpening.radius_px).len() as u32 - 1).max(2)
}

/// The kernels and the pipeline of the sharpening, which do not depend on the size of frames.
#[derive(Debug)]
pub(crate) struct Sharpener {
    rows: Kernel,
    columns: Kernel,
    difference: Kernel,
    /// The last pass, which writes the blocks that the sharpening changes.
    pub(crate) sharpened: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
}

impl Sharpener {
    /// Compiles the shaders, for targets of this format.
    pub(crate) fn new(device: &wgpu::Device, target: TextureFormat) -> Self {
        use Binding::{Buffer, Sampler, Target, Texels, Texture, Uniform};
        let kernel = |source: &str, entry, bindings: &[Binding]| {
            Kernel::new(device, source, entry, [BLOCK as u32, BLOCK as u32, 1], bindings)
        };
        let between = Target(BETWEEN);
        let layout = layout(
            device,
            "sharpened",
            ShaderStages::VERTEX_FRAGMENT,
            &[Uniform, Sampler, Texture, Texels, Texels, Uniform, Buffer, Texture, Texels, Buffer],
        );
        Self {
            rows: kernel(&shaders::SHARPENING, "rows", &[Uniform, Uniform, Buffer, Texels, between, Buffer]),
            columns: kernel(
                &shaders::SHARPENING,
                "columns",
                &[Uniform, Uniform, Buffer, Texels, between, Buffer, Texels, Texels],
            ),
            difference: kernel(
                &shaders::COMPOSITE,
                "difference",
                &[
                    Uniform, Sampler, Texture, Texture, Texture, Texels, Texels, Texture, between, Texture,
                    Buffer, Texels, Buffer, Texture, Buffer,
                ],
            ),
            sharpened: pipeline(device, &layout, target, ["of_tile", "sharpened"]),
            layout,
        }
    }
}

/// The textures of the sharpening for frames of one size, made at the first frame of a camera that sharpens.
#[derive(Debug)]
pub(crate) struct Sharpening {
    /// The [`MaskPass`] of each step in its slot, and in the last slot that of the mask itself.
    passes: wgpu::Buffer,
    half_kernel: wgpu::Buffer,
    /// The bindings of `rows` for the frame, for the first step's result, and for each of the two textures that take turns.
    rows_of_frame: BindGroup,
    rows_of_first: BindGroup,
    rows_of_turns: [BindGroup; 2],
    /// The bindings of the first step, which reads the frame.
    begin: BindGroup,
    /// For each slot, the bindings of the second step, which reads the first step's result.
    second: Vec<BindGroup>,
    /// For each slot, the bindings of a step after the second.
    later: Vec<BindGroup>,
    difference: BindGroup,
    /// The bindings of the last pass.
    pub(crate) sharpened: BindGroup,
}

/// The index, 0 or 1, of the texture that the step of a slot writes. The two textures take turns, and the step of the last slot writes
/// texture 0.
fn turn_of(slot: usize) -> usize {
    (MOST_STEPS - 1 - slot) % 2
}

impl Sharpening {
    /// Makes the textures, and binds them to every pass.
    ///
    /// # Errors
    /// If the device cannot hold the textures.
    // This function is long, since it lists the bindings of all passes.
    pub(crate) fn new(of_all: &Passes, of: &Sharpener, views: &Views) -> Result<Self> {
        let device = &views.device;
        let [w, h, eyes] = views.size.map(|s| s as usize);
        let between = |label: &str| {
            let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::STORAGE_BINDING;
            texture(device, label, [w, h, eyes], BETWEEN, usage).map(|t| array_view(&t))
        };
        let (rows, first) = (between("sharpening: rows")?, between("sharpening: first step")?);
        let turns = [between("sharpening: turn 0")?, between("sharpening: turn 1")?];
        let buffer = |label, size: usize, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: size as u64,
                usage: usage | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let passes = buffer("sharpening: passes", SLOT * (MOST_STEPS + 1), BufferUsages::UNIFORM);
        let half_kernel = buffer("sharpening: kernel", 4 * MOST_TAPS, BufferUsages::STORAGE);
        let pass = |slot: usize| {
            wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                buffer: &passes,
                offset: (SLOT * slot) as u64,
                size: wgpu::BufferSize::new(size_of::<MaskPass>() as u64),
            })
        };
        let (camera, taps) = (views.camera.as_entire_binding(), half_kernel.as_entire_binding());
        let list = views.list.as_entire_binding();
        let rows_of = |slot, source| {
            let resources =
                [camera.clone(), pass(slot), taps.clone(), view(source), view(&rows), list.clone()];
            of.rows.bind(device, &resources)
        };
        let columns = |slot, source, first, written| {
            let resources = [
                camera.clone(),
                pass(slot),
                taps.clone(),
                view(source),
                view(written),
                list.clone(),
                view(&rows),
                view(first),
            ];
            of.columns.bind(device, &resources)
        };
        let bilinear = wgpu::BindingResource::Sampler(&of_all.bilinear);
        let difference = [
            camera.clone(),
            bilinear.clone(),
            view(&views.frame),
            view(&views.focused),
            view(&views.sharp),
            view(&views.continued),
            view(&views.covered),
            view(&views.coarser),
            view(&turns[1]),
            view(&turns[0]),
            views.blocks.as_entire_binding(),
            view(&views.velocity),
            views.numbers.as_entire_binding(),
            view(&views.filtered),
            list.clone(),
        ];
        let sharpened = [
            camera.clone(),
            bilinear.clone(),
            view(&views.frame),
            view(&turns[1]),
            view(&rows),
            pass(MOST_STEPS),
            taps.clone(),
            view(&turns[0]),
            view(&of_all.tile),
            views.tiles.as_entire_binding(),
        ];
        Ok(Self {
            rows_of_frame: rows_of(0, &views.frame),
            rows_of_first: rows_of(MOST_STEPS, &first),
            rows_of_turns: turns.each_ref().map(|t| rows_of(MOST_STEPS, t)),
            begin: columns(0, &views.frame, &of_all.nothing, &first),
            second: (0..MOST_STEPS).map(|s| columns(s, &first, &first, &turns[turn_of(s)])).collect(),
            later: (0..MOST_STEPS)
                .map(|s| columns(s, &turns[1 - turn_of(s)], &first, &turns[turn_of(s)]))
                .collect(),
            difference: of.difference.bind(device, &difference),
            sharpened: bind(device, &of.layout, &sharpened),
            passes,
            half_kernel,
        })
    }

    /// Uploads the mask for the passes, and returns the number of steps of the iteration.
    ///
    /// # Errors
    /// If the mask is wider than there is room for.
    pub(crate) fn write(&self, queue: &wgpu::Queue, sharpening: &SharpeningModel) -> Result<usize> {
        let kernel = filter::gaussian_kernel(sharpening.radius_px);
        if kernel.len() > MOST_TAPS {
            return Err(Error::new(format!(
                "the camera's sharpening has a radius of {} px, which is more than can be composited; it is at most about {} px",
                sharpening.radius_px,
                MOST_TAPS / 6
            )));
        }
        let amount = sharpening.amount;
        let sizes = step_sizes(amount);
        let mask = MaskPass { radius: kernel.len() as u32 - 1, amount, ..MaskPass::default() };
        let mut bytes = vec![0; SLOT * (MOST_STEPS + 1)];
        let mut put = |slot: usize, pass: MaskPass| {
            bytes[SLOT * slot..][..size_of::<MaskPass>()].copy_from_slice(bytemuck::bytes_of(&pass));
        };
        // Let e be the difference that is added to the frame f, and G the Gaussian. A step of size s turns e into
        // (1 - s (1 + amount)) e + s amount G e + s amount (G f - f); the first step, where e is 0, has only the last term.
        let first = sizes[0] * amount;
        put(0, MaskPass { of_source: -first, of_blurred: first, ..mask });
        for (step, size) in sizes.iter().enumerate().skip(1) {
            let pass = MaskPass {
                of_source: 1.0 - size * (1.0 + amount),
                of_blurred: size * amount,
                of_first: size / sizes[0],
                ..mask
            };
            put(MOST_STEPS - sizes.len() + step, pass);
        }
        put(MOST_STEPS, mask);
        queue.write_buffer(&self.passes, 0, &bytes);
        queue.write_buffer(&self.half_kernel, 0, bytemuck::cast_slice(&kernel));
        Ok(sizes.len())
    }

    /// Records the passes up to the last one: the frame is unsharpened in `steps` steps, and the change that the layer makes to it is
    /// blurred along rows. `workgroups` are those of the list of blocks.
    pub(crate) fn run(
        &self,
        of: &Sharpener,
        pass: &mut wgpu::ComputePass,
        steps: usize,
        workgroups: &wgpu::Buffer,
    ) {
        of.rows.run_counted(pass, &self.rows_of_frame, workgroups);
        of.columns.run_counted(pass, &self.begin, workgroups);
        for step in 1..steps {
            let slot = MOST_STEPS - steps + step;
            let (rows, columns) = match step {
                1 => (&self.rows_of_first, &self.second[slot]),
                _ => (&self.rows_of_turns[1 - turn_of(slot)], &self.later[slot]),
            };
            of.rows.run_counted(pass, rows, workgroups);
            of.columns.run_counted(pass, columns, workgroups);
        }
        of.difference.run_counted(pass, &self.difference, workgroups);
        of.rows.run_counted(pass, &self.rows_of_turns[1], workgroups);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_steps_leave_as_little_as_the_reference_and_are_fewer() {
        for amount in [0.01f32, 0.3, 0.5, 1.0, 2.0, 5.0, 20.0] {
            let sizes = step_sizes(amount);
            // The share of the error that is left at a gain of the mask.
            let left = |gain: f32| sizes.iter().map(|s| 1.0 - s * gain).product::<f32>().abs();
            let worst = (0..=1000).map(|i| left(1.0 + amount * i as f32 / 1000.0)).fold(0.0, f32::max);
            assert!(worst <= 1.01 * LEFT, "{amount}: {worst}");
            let equal = (LEFT.ln() / (amount / (2.0 + amount)).ln()).ceil() as usize;
            assert!(sizes.len() <= equal.max(2), "{amount}: {} steps, {equal} equal ones", sizes.len());
            // Fewer steps would leave more of the error.
            if sizes.len() > 2 {
                let rate = (1.0 - (1.0 + amount).recip().sqrt()) / (1.0 + (1.0 + amount).recip().sqrt());
                assert!(2.0 * rate.powi(sizes.len() as i32 - 1) > LEFT);
            }
        }
    }
}
