//! Local blur from a frame and its version without defocus: the paper's per-pixel search.

use super::{Readback, common_size, filled};
use crate::gpu::{array_view, texture};
use crate::kernel::{Binding, Kernel};
use crate::layout::{Layout, structs, wgsl_struct};
use crate::prelude::constants;
use blindaug::fit::BlurPoint;
use blindaug::fit::defocus::{SEARCH_REACH, SEARCH_STRIDE, Searched, searched_stds, textured};
use blindaug::{Error, Result, filter};
use std::sync::LazyLock;
use wgpu::{BindGroup, BindingResource, BufferUsages, TextureFormat, TextureUsages};

/// The struct of the search for the defocus against clean frames.
pub(crate) const STRUCTS: [Layout; 1] = [Step::LAYOUT];

/// The WGSL declarations of the search for the defocus against clean frames.
pub(crate) fn shared() -> String {
    constants(&[("STRIDE", &SEARCH_STRIDE), ("REACH", &SEARCH_REACH), ("MAX_RADIUS", &MAX_RADIUS)])
        + &structs(&STRUCTS)
}

pub(crate) static SOURCE: LazyLock<String> = LazyLock::new(|| shared() + include_str!("defocus.wgsl"));

/// The paper's search, as [`blindaug::fit::defocus::pooled_search`] does it: at every 4th pixel each way, of 101 stds from 0 to 10 px, it
/// finds the one whose Gaussian blur of the sharp image is closest to the target, by the squared error summed over 9 x 9 px.
/// [`blindaug::fit::defocus::quadratic`] fits the lens to these stds.
#[derive(Debug)]
pub struct PooledSearch {
    blur: Kernel,
    compare: Kernel,
    /// For each std, the bindings of `blur`, which makes the blurred image (none for the first std, 0), and of `compare`.
    levels: Vec<(Option<BindGroup>, BindGroup)>,
    size: [u32; 2],
    points: [u32; 2],
    found: Readback,
}

/// The largest radius of a kernel that blurs the image of one std to that of the next, px. The stds of these kernels are at most 1.5 px, so
/// they reach less far.
pub(crate) const MAX_RADIUS: usize = 11;

wgsl_struct! {
    /// The numbers with which the blurred image of a std is made from that of the std before, and compared with the target.
    pub(crate) struct Step {
        /// Width and height of the images, px.
        size: [u32; 2],
        /// The std of the blurred image, px.
        sigma: f32,
        /// The radius of the kernel that makes the blurred image, px.
        radius: u32,
        /// The right half of the kernel, centre first, in the first of each four numbers; the other three are 0.
        half_kernel: [[f32; 4]; MAX_RADIUS + 1],
    }
}

/// Bytes from one step to the next: the alignment that every device allows for parts of uniform buffers.
const SLOT: usize = 256;
const _: () = assert!(size_of::<Step>() <= SLOT);

impl Step {
    /// The step to a std, px, from the one before.
    fn new(size: [u32; 2], before: f32, sigma: f32) -> Self {
        let kernel = filter::gaussian_kernel((sigma * sigma - before * before).sqrt());
        let mut step = Self { size, sigma, radius: kernel.len() as u32 - 1, ..Self::default() };
        step.half_kernel.iter_mut().zip(kernel).for_each(|(place, tap)| place[0] = tap);
        step
    }

    /// The step's bytes, padded up to the next step.
    fn slot(&self) -> [u8; SLOT] {
        let mut bytes = [0; SLOT];
        bytes[..size_of::<Self>()].copy_from_slice(bytemuck::bytes_of(self));
        bytes
    }
}

impl PooledSearch {
    /// Makes a search that compares `target` with blurs of `sharp`, both in the space in which blur acts, at places whose `inverse_depth`
    /// is not NaN. It takes the red channel of each texture's first layer.
    ///
    /// # Errors
    /// If the textures differ in size.
    pub fn new(
        device: &wgpu::Device,
        target: &wgpu::Texture,
        sharp: &wgpu::Texture,
        inverse_depth: &wgpu::Texture,
    ) -> Result<Self> {
        let size @ [w, h] = common_size(&[target, sharp, inverse_depth])?;
        let points = size.map(|v| v / SEARCH_STRIDE as u32);
        let blur = Kernel::new(
            device,
            &SOURCE,
            "blur",
            [16, 16, 1],
            &[Binding::Uniform, Binding::Texels, Binding::Target(TextureFormat::R32Float)],
        );
        let compare = Kernel::new(
            device,
            &SOURCE,
            "compare",
            [8, 8, 1],
            &[Binding::Uniform, Binding::Texels, Binding::Texels, Binding::Texels, Binding::BufferMut],
        );
        let usage = TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING;
        let level = || {
            let texture =
                texture(device, "level", [w as usize, h as usize, 1], TextureFormat::R32Float, usage)?;
            Ok::<_, Error>(array_view(&texture))
        };
        let [target, sharp, inverse_depth] = [target, sharp, inverse_depth].map(array_view);
        let turns = [level()?, level()?];
        let stds: Vec<f32> = searched_stds().collect();
        let befores = [0.0].into_iter().chain(stds.iter().copied());
        let steps: Vec<u8> = befores.zip(&stds).flat_map(|(b, &s)| Step::new(size, b, s).slot()).collect();
        let steps = filled(device, "steps of the search", &steps, BufferUsages::UNIFORM);
        let found = Readback::new(device, "what the search found", 4 * (points[0] * points[1]) as usize);
        let levels = (0..stds.len())
            .map(|i| {
                let step = BindingResource::Buffer(wgpu::BufferBinding {
                    buffer: &steps,
                    offset: (i * SLOT) as u64,
                    size: wgpu::BufferSize::new(size_of::<Step>() as u64),
                });
                let view = BindingResource::TextureView;
                let level = |i: usize| if i == 0 { &sharp } else { &turns[i % 2] };
                let blur =
                    (i > 0).then(|| blur.bind(device, &[step.clone(), view(level(i - 1)), view(level(i))]));
                let source = found.source.as_entire_binding();
                let compared = [step, view(&target), view(level(i)), view(&inverse_depth), source];
                (blur, compare.bind(device, &compared))
            })
            .collect();
        Ok(Self { blur, compare, levels, size, points, found })
    }

    /// Starts a search in the textures as they are now. It returns `false` and does nothing as long as the last result has not been picked
    /// up.
    pub fn submit(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) -> bool {
        if !self.found.is_idle() {
            return false;
        }
        self.found.submit(device, queue, "pooled search", |pass| {
            for (blur, compare) in &self.levels {
                if let Some(blur) = blur {
                    self.blur.run(pass, blur, [self.size[0], self.size[1], 1]);
                }
                self.compare.run(pass, compare, [self.points[0], self.points[1], 1]);
            }
        });
        true
    }

    /// Gives the local blur at places that have texture and depth, once it is known; until then `None`.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn poll(&mut self, device: &wgpu::Device) -> Result<Option<Vec<BlurPoint>>> {
        self.found.poll(device, |found| {
            let (found, _) = found.as_chunks();
            let searched = found[..(self.points[0] * self.points[1]) as usize].iter().map(
                |&[inverse_depth, sigma_px, least, greatest]| Searched {
                    inverse_depth,
                    sigma_px,
                    errors: [least, greatest],
                },
            );
            textured(&searched.collect::<Vec<Searched>>())
        })
    }
}
