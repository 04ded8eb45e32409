//! The passes of a compositor: everything that does not depend on the size of frames.

use crate::gpu::{array_view, texture};
use crate::kernel::{Binding, Kernel, layout, triangles};
use crate::quality::{OCTAVES, disk_table, gaussian_table};
use crate::{noise, shaders};
use wgpu::util::DeviceExt;
use wgpu::{BufferUsages, ShaderStages, TextureFormat, TextureUsages, TextureView};

/// The format of all textures between the passes.
pub(crate) const BETWEEN: TextureFormat = TextureFormat::Rgba16Float;

/// The numbers that the first pass finds of each part of the layer.
pub(crate) const PART_NUMBERS: usize = 4;

/// The side of the square that a workgroup of the pass `mend` copies, px.
pub(crate) const MENDED: usize = 64;

/// The passes of every camera, and the tables and textures that stay the same in all frames.
#[derive(Debug)]
pub(crate) struct Passes {
    pub(crate) prepare: Kernel,
    pub(crate) mend: Kernel,
    pub(crate) near_in_row: Kernel,
    pub(crate) list_blocks: Kernel,
    pub(crate) list_tiles: Kernel,
    pub(crate) seen_in_row: Kernel,
    pub(crate) list_sharpened: Kernel,
    pub(crate) pull_continued: Kernel,
    pub(crate) pull: Kernel,
    pub(crate) top: Kernel,
    pub(crate) push: Kernel,
    pub(crate) halve: Kernel,
    pub(crate) defocus: Kernel,
    /// The frame, in the blocks that neither of the last passes draws.
    pub(crate) copied: wgpu::RenderPipeline,
    /// The last pass for a camera that does not sharpen, for the blocks in which the layer may be seen.
    pub(crate) composite: wgpu::RenderPipeline,
    pub(crate) composite_layout: wgpu::BindGroupLayout,
    pub(crate) bilinear: wgpu::Sampler,
    pub(crate) gaussians: wgpu::Buffer,
    pub(crate) disks: wgpu::Buffer,
    /// The tile of noise.
    pub(crate) tile: TextureView,
    /// A texture of one pixel, which stands for inputs that are not given.
    pub(crate) nothing: TextureView,
}

impl Passes {
    /// Compiles the passes for targets of this format, and makes the tile of noise.
    pub(crate) fn new(device: &wgpu::Device, queue: &wgpu::Queue, target: TextureFormat) -> Self {
        use Binding::{Buffer, BufferMut, Sampler, Target, Texels, Texture, Uniform};
        let between = Target(BETWEEN);
        let of_extension = |entry, side, bindings: &[Binding]| {
            Kernel::new(device, &shaders::EXTENSION, entry, [side, side, 1], bindings)
        };
        let halving = [Uniform, Uniform, Sampler, Texture, Buffer, between];
        let doubling = [Uniform, Uniform, Sampler, Texture, Buffer, Texels, between];
        let mut of_defocus = vec![Uniform, Uniform, Sampler, Buffer, Texels, between];
        of_defocus.extend([Texture; OCTAVES]);
        of_defocus.extend([Buffer, Buffer, Texels, Texels, Texture, Buffer, Texture]);
        let of_blocks = |entry| {
            let bindings =
                [Uniform, Buffer, BufferMut, BufferMut, BufferMut, BufferMut, BufferMut, BufferMut];
            Kernel::new(device, &shaders::BLOCKS, entry, [8, 8, 1], &bindings)
        };
        let table = |label, contents| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents,
                usage: BufferUsages::STORAGE,
            })
        };
        let composite_layout = layout(
            device,
            "composite",
            ShaderStages::VERTEX_FRAGMENT,
            &[
                Uniform, Sampler, Texture, Texture, Texture, Texels, Texels, Texture, Texels, Buffer, Buffer,
                Texels, Buffer, Texture,
            ],
        );
        let of_layer = [
            Uniform,
            Texels,
            Texels,
            Texels,
            BufferMut,
            between,
            between,
            between,
            Target(TextureFormat::R32Float),
            BufferMut,
        ];
        Self {
            prepare: of_extension("prepare", 16, &of_layer),
            mend: of_extension("mend", MENDED as u32, &of_layer),
            near_in_row: of_blocks("near_in_row"),
            list_blocks: of_blocks("list_blocks"),
            list_tiles: of_blocks("list_tiles"),
            seen_in_row: of_blocks("seen_in_row"),
            list_sharpened: of_blocks("list_sharpened"),
            pull_continued: of_extension("pull_continued", 8, &[&halving[..], &[Buffer]].concat()),
            pull: of_extension("pull", 8, &halving),
            top: of_extension("top", 1, &doubling),
            push: of_extension("push", 8, &doubling),
            halve: of_extension("halve", 8, &halving),
            defocus: Kernel::new(device, &shaders::DEFOCUS, "defocus", [8, 8, 1], &of_defocus),
            copied: pipeline(device, &composite_layout, target, ["whole", "copied"]),
            composite: pipeline(device, &composite_layout, target, ["of_tile", "composite"]),
            composite_layout,
            bilinear: device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("bilinear"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
            gaussians: table("discrete Gaussians", bytemuck::cast_slice(&gaussian_table())),
            disks: table("disks", bytemuck::cast_slice(&disk_table())),
            tile: array_view(&noise::tile(device, queue, 0)),
            nothing: array_view(
                &texture(device, "nothing", [1, 1, 1], BETWEEN, TextureUsages::TEXTURE_BINDING)
                    .expect("every device holds a texture of one pixel"),
            ),
        }
    }
}

/// The resources that several steps of a frame read or write.
#[derive(Debug)]
pub(crate) struct Views {
    /// The device, which makes the textures of the sharpening if they are needed.
    pub(crate) device: wgpu::Device,
    /// Width and height, px, and the number of eyes.
    pub(crate) size: [u32; 3],
    /// The [`Camera`] of the current frame.
    pub(crate) camera: wgpu::Buffer,
    /// The largest alpha, defocus std and reach of blur of each part, and whether any of its values is broken, as the bits of floats.
    pub(crate) numbers: wgpu::Buffer,
    /// The bits of each block of each part.
    pub(crate) blocks: wgpu::Buffer,
    /// The camera's frame.
    pub(crate) frame: TextureView,
    /// A copy of the layer before blur, in the space in which blur acts.
    pub(crate) sharp: TextureView,
    /// The layer as it was given, if it can be filtered; else the same as `sharp`.
    pub(crate) filtered: TextureView,
    /// The blocks that the last pass draws.
    pub(crate) tiles: wgpu::Buffer,
    /// The number of blocks that the pass `defocus`, and after it the sharpening, has work in, and the blocks.
    pub(crate) list: wgpu::Buffer,
    /// The layer after defocus.
    pub(crate) focused: TextureView,
    /// The inverse depth and the path on level [`CONTINUED`](crate::quality::CONTINUED).
    pub(crate) continued: TextureView,
    /// Which of the pixels under a pixel of that level the object covers.
    pub(crate) covered: TextureView,
    /// The inverse depth and the path on the next level, continued past the silhouette.
    pub(crate) coarser: TextureView,
    /// The object's motion.
    pub(crate) velocity: TextureView,
}

/// A pipeline of a vertex and a fragment shader of composite.wgsl.
pub(crate) fn pipeline(
    device: &wgpu::Device,
    group: &wgpu::BindGroupLayout,
    target: TextureFormat,
    [vertex, fragment]: [&str; 2],
) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(fragment),
        source: wgpu::ShaderSource::Wgsl(shaders::COMPOSITE.as_str().into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(fragment),
        bind_group_layouts: &[Some(group)],
        immediate_size: 0,
    });
    triangles(device, Some(&layout), &module, [vertex, fragment], &[target])
}

/// A view as a resource to bind.
pub(crate) fn view(v: &TextureView) -> wgpu::BindingResource<'_> {
    wgpu::BindingResource::TextureView(v)
}
