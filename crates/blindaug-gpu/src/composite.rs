//! The virtual layer over the frame, as if the camera had filmed it: [`blindaug::composite::composite`] on the GPU.

use crate::camera::Uniforms;
use crate::gpu::{array_view, aspect, texture};
use crate::kernel::{Binding, Kernel, bind, full_screen, layout};
use crate::timer::Timer;
use crate::{noise, shaders};
use blindaug::composite::CompositeOptions;
use blindaug::model::CameraModel;
use blindaug::synth::defocus::{self, Bokeh};
use blindaug::{Error, Result, filter};
use wgpu::util::DeviceExt;
use wgpu::{
    BindGroup, BufferUsages, ShaderStages, Texture, TextureFormat, TextureSampleType, TextureUsages,
    TextureView,
};

/// How closely the reference is followed; what it costs is in docs/gpu.md.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Quality {
    /// For pictures that are kept, and fast GPUs.
    #[default]
    High,
    /// For headsets and desktops.
    Medium,
    /// For phones.
    Low,
}

/// Depth as a texture of one channel, or a depth buffer: inverse depth in 1/m is `scale * value + offset`. Of a perspective
/// projection that is always so: with reversed infinite depth, `scale` is 1 / near and `offset` 0.
#[derive(Clone, Copy, Debug)]
pub struct Depth<'a> {
    /// Any format of one float channel that can be loaded; NaN where unknown.
    pub texture: &'a Texture,
    /// 1/m per unit.
    pub scale: f32,
    /// 1/m.
    pub offset: f32,
}

/// How far each pixel moves to the next frame.
#[derive(Clone, Copy, Debug)]
pub struct Velocity<'a> {
    /// Two float channels; NaN where unknown.
    pub texture: &'a Texture,
    /// px (x right, y down) per unit of the two channels.
    pub scale: [f32; 2],
}

/// What is composited: textures of one size, with one array layer per eye.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a> {
    /// The camera's frame, display-encoded values in a format that can be filtered and is not `Srgb` (which would decode).
    pub frame: &'a Texture,
    /// The rendered object: premultiplied scene-linear R, G, B, A.
    pub color: &'a Texture,
    /// Its depth. Without it, there is no defocus.
    pub depth: Option<Depth<'a>>,
    /// Its motion. Without it, there is no motion blur.
    pub velocity: Option<Velocity<'a>>,
    /// Whether what lies behind the focus, in it and in front of it is blurred apart, so that something sharp does not bleed into
    /// blurred surroundings ([`blindaug::synth::Blur::of_layer`]). Takes three times the memory, and the time of as many layers as
    /// the object has such parts.
    pub apart: bool,
}

/// A part of the frame, px from its top left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Area {
    /// Left edge.
    pub x: u32,
    /// Top edge.
    pub y: u32,
    /// Width.
    pub width: u32,
    /// Height.
    pub height: u32,
}

impl Area {
    /// What of it lies in a frame of this size.
    fn within(self, width: u32, height: u32) -> Self {
        let (x, y) = (self.x.min(width), self.y.min(height));
        Self { x, y, width: self.width.min(width - x), height: self.height.min(height - y) }
    }
}

/// One frame to composite.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// The camera that filmed it.
    pub model: &'a CameraModel,
    /// How to composite. Layers that are composited one after the other need a seed each.
    pub options: CompositeOptions,
    /// How closely the reference is followed.
    pub quality: Quality,
    /// The frame's number, so that each has its own noise.
    pub number: u64,
    /// Where the object may be seen, blur included ([`blindaug::synth::Blur::reach_px`]); the rest is the camera's frame and
    /// costs no more than its copy. `None`: anywhere.
    pub area: Option<Area>,
    /// A view per eye, of the frame's size and the format that the compositor was made for, which gets display-encoded values.
    pub targets: &'a [TextureView],
    /// Times the steps.
    pub timer: Option<&'a Timer>,
}

/// Format of everything in between.
const BETWEEN: TextureFormat = TextureFormat::Rgba16Float;

/// Octaves of the image that defocus reads: `COARSEST` + 1 of defocus.wgsl.
pub(crate) const OCTAVES: usize = 8;

/// Variances of the table of discrete Gaussians, and the largest, px^2: as in defocus.wgsl.
pub(crate) const GAUSSIANS: usize = 64;
pub(crate) const GAUSSIAN_MOST: f32 = 3.25;

/// How many disks there are in the table, the distance of their stds, px, and the rows of each: as in defocus.wgsl.
pub(crate) const DISKS: usize = 235;
pub(crate) const DISK_STEP: f32 = 1.0 / 64.0;
pub(crate) const DISK_ROWS: usize = 12;

/// `Quality` of defocus.wgsl.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct DefocusQuality {
    least_variance: [f32; 2],
    reach: f32,
    bokeh: u32,
}

impl Quality {
    /// How often the layer is read for a pixel of this defocus std, px; the counterpart of defocus.wgsl.
    pub fn defocus_taps(self, bokeh: Bokeh, sigma_px: f32) -> u32 {
        let DefocusQuality { least_variance: [gaussian, disk], reach, .. } = DefocusQuality::new(self, bokeh);
        let least = if bokeh == Bokeh::Disk { disk } else { gaussian };
        let variance = sigma_px * sigma_px;
        let octave = (0.5 * ((variance + 1.0 / 3.0) / (least + 1.0 / 3.0)).max(1.0).log2()) as i32;
        let scale = 0.25f32.powi(octave.min(OCTAVES as i32 - 1));
        let left = variance * scale - (1.0 - scale) / 3.0;
        match bokeh {
            _ if sigma_px <= 0.0 => 1,
            Bokeh::Gaussian if octave == 0 && left < GAUSSIAN_MOST => {
                let pairs = (0.5 * (reach * left.sqrt() + 0.5).clamp(1.0, 6.0)).ceil() as u32;
                (2 * pairs + 1).pow(2)
            }
            Bokeh::Gaussian => ((reach * left.sqrt()).ceil() as u32).pow(2),
            // The area of the disk with its rim.
            Bokeh::Disk => (std::f32::consts::PI * (2.0 * left.sqrt() + 0.5).powi(2)).ceil() as u32,
        }
    }

    /// How often the layer is read for a pixel whose path is this long, px.
    pub fn motion_blur_taps(self, path_px: f32) -> u32 {
        (path_px.ceil() + 1.0).min(self.most_taps()) as u32
    }
}

impl DefocusQuality {
    fn new(quality: Quality, bokeh: Bokeh) -> Self {
        let (least_variance, reach) = match quality {
            Quality::High => ([0.5, 3.0], 3.3),
            Quality::Medium => ([0.3, 1.5], 2.6),
            Quality::Low => ([0.15, 0.75], 2.2),
        };
        Self { least_variance, reach, bokeh: u32::from(bokeh == Bokeh::Disk) }
    }
}

/// The effects and the compositor: everything that does not depend on the size of frames. Made once.
#[derive(Debug)]
pub struct Compositor {
    prepare: Kernel,
    spread: Kernel,
    pull: Kernel,
    top: Kernel,
    push: Kernel,
    blur: Kernel,
    halve: Kernel,
    defocus: Kernel,
    composite: wgpu::RenderPipeline,
    composite_layout: wgpu::BindGroupLayout,
    bilinear: wgpu::Sampler,
    gaussians: wgpu::Buffer,
    disks: wgpu::Buffer,
    tile: TextureView,
    nothing: TextureView,
    target: TextureFormat,
}

impl Compositor {
    /// For targets of this format, which can be rendered to. Makes the noise tile, too.
    // Long, since it lists every pass with its bindings, one after the other.
    pub fn new(device: &wgpu::Device, queue: &wgpu::Queue, target: TextureFormat) -> Self {
        use Binding::{Buffer, BufferMut, Sampler, Target, Texels, Texture, Uniform};
        let between = Target(BETWEEN);
        let of_extension = |entry, side, bindings: &[Binding]| {
            Kernel::new(device, &shaders::EXTENSION, entry, [side, side, 1], bindings)
        };
        let halving = [Uniform, Uniform, Sampler, Texture, Buffer, between];
        let doubling = [Uniform, Uniform, Sampler, Texture, Buffer, Texels, between];
        let mut of_defocus = vec![Uniform, Uniform, Sampler, Buffer, Texels, between];
        of_defocus.extend([Texture; OCTAVES]);
        of_defocus.extend([Buffer, Buffer]);
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
            ShaderStages::FRAGMENT,
            &[Uniform, Sampler, Texture, Texture, Texels, Texels, Buffer],
        );
        Self {
            prepare: of_extension("prepare", 16, &[Uniform, Texels, between, BufferMut, Texels]),
            spread: of_extension("spread", 16, &[Uniform, Texels, Texels, Texels, Buffer, between]),
            pull: of_extension("pull", 8, &halving),
            top: of_extension("top", 1, &doubling),
            push: of_extension("push", 8, &doubling),
            blur: of_extension("blur", 16, &doubling),
            halve: of_extension("halve", 8, &halving),
            defocus: Kernel::new(device, &shaders::DEFOCUS, "defocus", [8, 8, 1], &of_defocus),
            composite: composite_pipeline(device, &composite_layout, target),
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
            target,
        }
    }

    /// Everything that frames of these textures' size need; they are bound once and may be drawn to again and again.
    ///
    /// # Errors
    /// If sizes differ or are too large for the device.
    pub fn bind(&self, device: &wgpu::Device, inputs: &Inputs) -> Result<Bound> {
        Bound::new(self, device, inputs)
    }

    /// Records the passes of one frame, which must be submitted before the next is recorded with the same `bound` (its numbers
    /// are written through the queue). Nothing is allocated or read back. Parts of the model that are unknown are not applied, nor
    /// are those without their evidence (depth, velocity); the camera's sharpening is not.
    ///
    /// # Errors
    /// If the model is for another width or in relative inverse depth, or there are not as many targets as eyes.
    // Long, since it lists the passes of a frame in their order.
    pub fn encode(
        &self,
        queue: &wgpu::Queue,
        encoder: &mut wgpu::CommandEncoder,
        bound: &Bound,
        frame: &Frame,
    ) -> Result<()> {
        let Frame { model, options, quality, number, area, targets, timer } = *frame;
        let [w, h, eyes] = bound.size;
        if targets.len() != eyes as usize {
            return Err(Error::new(format!(
                "there are {} targets for {eyes} eyes; give one each",
                targets.len()
            )));
        }
        let mut camera = Uniforms::new(model, w as usize, bound.velocity_scale, &options, quality, number)?;
        camera.depth_map = bound.depth_map;
        camera.slabs = bound.slabs;
        camera.linear_target = u32::from(self.target.is_srgb());
        let whole = Area { x: 0, y: 0, width: w, height: h };
        let Area { x, y, width, height } = area.map_or(whole, |a| a.within(w, h));
        camera.origin = [x, y];
        camera.size = [width, height];
        let seen = width > 0 && height > 0;
        let defocuses = seen && camera.defocuses() && bound.has_depth;
        let blurs = defocuses || seen && camera.moves();
        queue.write_buffer(&bound.camera, 0, bytemuck::bytes_of(&camera));
        queue.write_buffer(
            &bound.quality,
            0,
            bytemuck::bytes_of(&DefocusQuality::new(quality, options.bokeh)),
        );
        encoder.clear_buffer(&bound.most, 0, None);

        let compute = |step: u32| wgpu::ComputePassDescriptor {
            label: None,
            timestamp_writes: timer.map(|t| t.compute(step)),
        };
        let at_level = |level: usize| {
            let halved = |s: u32| (s + (1 << level) - 1) >> level;
            [halved(width), halved(height), bound.slabs * eyes]
        };
        let mut pass = encoder.begin_compute_pass(&compute(0));
        if seen {
            self.prepare.run(&mut pass, &bound.prepare, at_level(0));
        }
        if blurs {
            self.spread.run(&mut pass, &bound.spread, at_level(0));
            for (level, group) in bound.pull.iter().enumerate() {
                self.pull.run(&mut pass, group, at_level(level + 1));
            }
            self.top.run(&mut pass, &bound.top, [1, 1, bound.slabs * eyes]);
            for (level, group) in bound.push.iter().enumerate().skip(1).rev() {
                self.push.run(&mut pass, group, at_level(level));
            }
            self.blur.run(&mut pass, &bound.push[0], at_level(0));
        }
        drop(pass);
        let mut pass = encoder.begin_compute_pass(&compute(1));
        for (level, group) in bound.halve.iter().enumerate().filter(|_| defocuses) {
            self.halve.run(&mut pass, group, at_level(level + 1));
        }
        drop(pass);
        let mut pass = encoder.begin_compute_pass(&compute(2));
        if defocuses {
            self.defocus.run(&mut pass, &bound.defocus, at_level(0));
        }
        drop(pass);
        let group = match (defocuses, blurs) {
            (true, _) => &bound.composite_focused,
            (false, true) => &bound.composite_sharp,
            (false, false) => &bound.composite_still,
        };
        for (eye, target) in (0..).zip(targets) {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: None,
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                timestamp_writes: timer.map(|t| t.render(3, eye == 0, eye + 1 == eyes)),
                ..Default::default()
            });
            pass.set_pipeline(&self.composite);
            pass.set_bind_group(0, group, &[]);
            pass.draw(0..3, eye..eye + 1);
        }
        if let Some(timer) = timer {
            timer.resolve(encoder);
        }
        Ok(())
    }
}

fn composite_pipeline(
    device: &wgpu::Device,
    group: &wgpu::BindGroupLayout,
    target: TextureFormat,
) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("composite"),
        source: wgpu::ShaderSource::Wgsl(shaders::COMPOSITE.as_str().into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("composite"),
        bind_group_layouts: &[Some(group)],
        immediate_size: 0,
    });
    full_screen(device, Some(&layout), &module, "composite", &[target])
}

fn view(v: &TextureView) -> wgpu::BindingResource<'_> {
    wgpu::BindingResource::TextureView(v)
}

/// 8 taps of the discrete Gaussian for each of some variances.
fn gaussian_table() -> [[f32; 8]; GAUSSIANS] {
    std::array::from_fn(|i| {
        let variance = GAUSSIAN_MOST * i as f32 / (GAUSSIANS - 1) as f32;
        let kernel = filter::gaussian_kernel(variance.sqrt());
        std::array::from_fn(|tap| kernel.get(tap).copied().unwrap_or(0.0))
    })
}

/// Half the lengths of the rows of disks of rising std, px.
fn disk_table() -> Vec<[f32; DISK_ROWS]> {
    let disk = |i: usize| {
        let halves = defocus::disk_half_widths(i as f32 * DISK_STEP);
        std::array::from_fn(|dy| halves.get(dy).copied().unwrap_or(0.0))
    };
    (0..DISKS).map(disk).collect()
}

/// The textures of a [`Compositor`]'s frames and what lies between them.
#[derive(Debug)]
pub struct Bound {
    /// Width, height, eyes.
    size: [u32; 3],
    slabs: u32,
    has_depth: bool,
    depth_map: [f32; 2],
    velocity_scale: [f32; 2],
    camera: wgpu::Buffer,
    quality: wgpu::Buffer,
    most: wgpu::Buffer,
    prepare: BindGroup,
    spread: BindGroup,
    /// By the level that is read.
    pull: Vec<BindGroup>,
    top: BindGroup,
    /// By the level that is written; the finest is for `blur`.
    push: Vec<BindGroup>,
    /// By the level that is read.
    halve: Vec<BindGroup>,
    defocus: BindGroup,
    /// The bindings of the composite for the focused layer, for the sharp one along its path, and for the sharp one.
    composite_focused: BindGroup,
    composite_sharp: BindGroup,
    composite_still: BindGroup,
}

impl Bound {
    fn new(of: &Compositor, device: &wgpu::Device, inputs: &Inputs) -> Result<Self> {
        let size = inputs.frame.size();
        let check = |name: &str, other: Option<&Texture>| match other.map(Texture::size) {
            Some(s) if s != size => Err(Error::new(format!(
                "{name} has {} x {} pixels for {} eyes but the frame {} x {} for {}; give textures of one size",
                s.width,
                s.height,
                s.depth_or_array_layers,
                size.width,
                size.height,
                size.depth_or_array_layers
            ))),
            _ => Ok(()),
        };
        check("the virtual layer", Some(inputs.color))?;
        check("the virtual layer's depth", inputs.depth.map(|d| d.texture))?;
        check("the virtual layer's velocity", inputs.velocity.map(|v| v.texture))?;
        let readable = |name: &str,
                        texture: Option<&Texture>,
                        fits: &dyn Fn(TextureSampleType) -> bool,
                        format: &str| {
            let Some(texture) = texture else { return Ok(()) };
            let kind = texture.format().sample_type(Some(aspect(texture)), Some(device.features()));
            let usable =
                texture.usage().contains(TextureUsages::TEXTURE_BINDING) && texture.sample_count() == 1;
            if usable && kind.is_some_and(fits) {
                return Ok(());
            }
            Err(Error::new(format!(
                "{name} is a texture of {:?} with {} samples and usage {:?}; give one of {format}, one sample, for TEXTURE_BINDING",
                texture.format(),
                texture.sample_count(),
                texture.usage()
            )))
        };
        let float = |t| matches!(t, TextureSampleType::Float { .. });
        let of_frame =
            |t| t == TextureSampleType::Float { filterable: true } && !inputs.frame.format().is_srgb();
        readable("the frame", Some(inputs.frame), &of_frame, "floats that can be filtered and are not Srgb")?;
        readable("the virtual layer", Some(inputs.color), &float, "floats")?;
        let of_depth = |t| float(t) || t == TextureSampleType::Depth;
        readable("the virtual layer's depth", inputs.depth.map(|d| d.texture), &of_depth, "floats or depth")?;
        readable("the virtual layer's velocity", inputs.velocity.map(|v| v.texture), &float, "floats")?;
        let (w, h, eyes) = (size.width, size.height, size.depth_or_array_layers);
        let slabs = if inputs.apart && inputs.depth.is_some() { 3 } else { 1 };
        let between = |label: &str, [w, h]: [u32; 2], layers: u32| {
            let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::STORAGE_BINDING;
            texture(device, label, [w as usize, h as usize, layers as usize], BETWEEN, usage)
                .map(|t| array_view(&t))
        };
        // Down to one pixel, which is halved once at least.
        let mut sizes = vec![[w, h]];
        while sizes.len() < 2 || sizes[sizes.len() - 1] != [1, 1] {
            sizes.push(sizes[sizes.len() - 1].map(|s| s.div_ceil(2)));
        }
        let level = |i: usize| sizes[i.min(sizes.len() - 1)];
        let views = |label: &str, levels: std::ops::Range<usize>| -> Result<Vec<TextureView>> {
            levels.map(|i| between(label, level(i), slabs * eyes)).collect()
        };
        let octaves = views("octave", 0..OCTAVES)?;
        let known = views("known", 0..sizes.len())?;
        let filled = views("filled", 0..sizes.len())?;
        // What is known at full size is no longer needed when the focused layer is written.
        let focused = &known[0];
        let uniform = |label, size| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let camera = uniform("camera", size_of::<Uniforms>() as u64);
        let quality = uniform("quality", size_of::<DefocusQuality>() as u64);
        let most = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("largest alpha"),
            size: 4 * u64::from(slabs * eyes),
            usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let bilinear = wgpu::BindingResource::Sampler(&of.bilinear);
        let [camera_binding, quality_binding, most_binding] =
            [&camera, &quality, &most].map(|b| b.as_entire_binding());
        let input = |t: Option<&Texture>| t.map_or_else(|| of.nothing.clone(), array_view);
        let frame = array_view(inputs.frame);
        let color = array_view(inputs.color);
        let depth = input(inputs.depth.map(|d| d.texture));
        let velocity = input(inputs.velocity.map(|v| v.texture));
        let last = sizes.len() - 1;
        let level_of: Vec<_> = (0..OCTAVES.max(last) as u32)
            .map(|level| {
                device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                    label: Some("level"),
                    contents: bytemuck::bytes_of(&level),
                    usage: BufferUsages::UNIFORM,
                })
            })
            .collect();
        let of_level = |i: usize| [camera_binding.clone(), level_of[i].as_entire_binding(), bilinear.clone()];
        let halved = |kernel: &Kernel, levels: &[TextureView]| -> Vec<BindGroup> {
            let halved = |i: usize| {
                let [camera, level, sampler] = of_level(i);
                let most = most_binding.clone();
                kernel.bind(device, &[camera, level, sampler, view(&levels[i]), most, view(&levels[i + 1])])
            };
            (0..levels.len() - 1).map(halved).collect()
        };
        let doubled = |kernel: &Kernel, coarser: usize, i: usize| {
            let [camera, level, sampler] = of_level(i.min(last - 1));
            let (most, images) = (most_binding.clone(), [&filled[coarser], &known[i], &filled[i]].map(view));
            let [coarser, own, filled] = images;
            kernel.bind(device, &[camera, level, sampler, coarser, most, own, filled])
        };
        let pushes = |i: usize| doubled(if i == 0 { &of.blur } else { &of.push }, i + 1, i);
        let mut of_defocus = vec![
            camera_binding.clone(),
            quality_binding,
            bilinear.clone(),
            of.gaussians.as_entire_binding(),
            view(&filled[0]),
            view(focused),
        ];
        of_defocus.extend(octaves.iter().map(view));
        of_defocus.extend([of.disks.as_entire_binding(), most_binding.clone()]);
        let composited = |layer: &TextureView, blur: &TextureView| {
            let resources = [
                camera_binding.clone(),
                bilinear.clone(),
                view(&frame),
                view(layer),
                view(blur),
                view(&of.tile),
                most_binding.clone(),
            ];
            bind(device, &of.composite_layout, &resources)
        };
        Ok(Self {
            size: [w, h, eyes],
            slabs,
            has_depth: inputs.depth.is_some(),
            depth_map: inputs.depth.map_or([0.0; 2], |d| [d.scale, d.offset]),
            velocity_scale: inputs.velocity.map_or([0.0; 2], |v| v.scale),
            prepare: of.prepare.bind(
                device,
                &[
                    camera_binding.clone(),
                    view(&color),
                    view(&octaves[0]),
                    most_binding.clone(),
                    view(&depth),
                ],
            ),
            spread: of.spread.bind(
                device,
                &[
                    camera_binding.clone(),
                    view(&octaves[0]),
                    view(&depth),
                    view(&velocity),
                    most_binding.clone(),
                    view(&known[0]),
                ],
            ),
            pull: halved(&of.pull, &known),
            // Reads no coarser level.
            top: doubled(&of.top, last - 1, last),
            push: (0..last).map(pushes).collect(),
            halve: halved(&of.halve, &octaves),
            defocus: of.defocus.bind(device, &of_defocus),
            composite_focused: composited(focused, &filled[0]),
            composite_sharp: composited(&octaves[0], &filled[0]),
            composite_still: composited(&octaves[0], &of.nothing),
            camera,
            quality,
            most,
        })
    }
}
