//! A compute shader with its bindings.

use wgpu::{BindGroup, BindingType, ShaderStages, TextureFormat};

/// The kind of resource of a shader's binding. Bindings are numbered in their order in group 0; textures are arrays of 2D textures.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Binding {
    Uniform,
    /// A texture that is read by texel.
    Texels,
    /// A texture that is read through a sampler.
    Texture,
    Sampler,
    /// A texture that is written by texel.
    Target(TextureFormat),
    Buffer,
    BufferMut,
}

/// Makes the layout of group 0 of these bindings.
pub(crate) fn layout(
    device: &wgpu::Device,
    label: &str,
    stages: ShaderStages,
    bindings: &[Binding],
) -> wgpu::BindGroupLayout {
    let texture = |filterable| BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable },
        view_dimension: wgpu::TextureViewDimension::D2Array,
        multisampled: false,
    };
    let buffer = |ty| BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    let entries: Vec<_> = bindings
        .iter()
        .enumerate()
        .map(|(i, binding)| wgpu::BindGroupLayoutEntry {
            binding: i as u32,
            visibility: stages,
            ty: match *binding {
                Binding::Uniform => buffer(wgpu::BufferBindingType::Uniform),
                Binding::Texels => texture(false),
                Binding::Texture => texture(true),
                Binding::Sampler => BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                Binding::Target(format) => BindingType::StorageTexture {
                    access: wgpu::StorageTextureAccess::WriteOnly,
                    format,
                    view_dimension: wgpu::TextureViewDimension::D2Array,
                },
                Binding::Buffer => buffer(wgpu::BufferBindingType::Storage { read_only: true }),
                Binding::BufferMut => buffer(wgpu::BufferBindingType::Storage { read_only: false }),
            },
            count: None,
        })
        .collect();
    device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}

/// Binds resources, in the order of a layout's bindings.
pub fn bind(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    resources: &[wgpu::BindingResource],
) -> BindGroup {
    let entries: Vec<_> = resources
        .iter()
        .enumerate()
        .map(|(i, r)| wgpu::BindGroupEntry { binding: i as u32, resource: r.clone() })
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
}

/// Makes a pipeline that covers the whole image with a fragment shader, into targets of some formats; the vertex shader `whole` makes one
/// triangle. Without a layout, the pipeline takes the shaders' own.
pub fn full_screen(
    device: &wgpu::Device,
    layout: Option<&wgpu::PipelineLayout>,
    module: &wgpu::ShaderModule,
    fragment: &str,
    targets: &[TextureFormat],
) -> wgpu::RenderPipeline {
    triangles(device, layout, module, ["whole", fragment], targets)
}

/// Makes a pipeline of a vertex shader that makes triangles by itself and a fragment shader.
pub(crate) fn triangles(
    device: &wgpu::Device,
    layout: Option<&wgpu::PipelineLayout>,
    module: &wgpu::ShaderModule,
    [vertex, fragment]: [&str; 2],
    targets: &[TextureFormat],
) -> wgpu::RenderPipeline {
    let targets: Vec<_> = targets.iter().map(|&format| Some(format.into())).collect();
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(fragment),
        layout,
        vertex: wgpu::VertexState {
            module,
            entry_point: Some(vertex),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: Default::default(),
        depth_stencil: None,
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(fragment),
            compilation_options: Default::default(),
            targets: &targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A compute pipeline and the layout of its one bind group.
#[derive(Clone, Debug)]
pub(crate) struct Kernel {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    workgroup: [u32; 3],
}

impl Kernel {
    /// Compiles the entry point `entry` of a WGSL text, whose `@workgroup_size` is `workgroup`.
    pub(crate) fn new(
        device: &wgpu::Device,
        source: &str,
        entry: &str,
        workgroup: [u32; 3],
        bindings: &[Binding],
    ) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(entry),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        let layout = layout(device, entry, ShaderStages::COMPUTE, bindings);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(entry),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions {
                // Every shader writes its workgroup's memory before it reads it.
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        });
        Self { pipeline, layout, workgroup }
    }

    pub(crate) fn bind(&self, device: &wgpu::Device, resources: &[wgpu::BindingResource]) -> BindGroup {
        bind(device, &self.layout, resources)
    }

    /// Runs the shader with at least `threads` threads along each axis.
    pub(crate) fn run(&self, pass: &mut wgpu::ComputePass, group: &BindGroup, threads: [u32; 3]) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, group, &[]);
        let [x, y, z]: [u32; 3] = std::array::from_fn(|i| threads[i].div_ceil(self.workgroup[i]));
        pass.dispatch_workgroups(x, y, z);
    }

    /// Runs the shader with as many workgroups along each axis as a buffer holds at its beginning.
    pub(crate) fn run_counted(
        &self,
        pass: &mut wgpu::ComputePass,
        group: &BindGroup,
        workgroups: &wgpu::Buffer,
    ) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, group, &[]);
        pass.dispatch_workgroups_indirect(workgroups, 0);
    }
}
