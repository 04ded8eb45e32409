//! The textures that a compositor reads its frames from, and the textures and buffers between its passes.

use crate::camera::Camera;
use crate::gpu::{array_view, aspect, texture};
use crate::inputs::Inputs;
use crate::kernel::{Kernel, bind};
use crate::passes::{BETWEEN, Passes, Views, view};
use crate::quality::{DefocusQuality, OCTAVES};
use crate::sharpening::{Sharpener, Sharpening};
use blindaug::{Error, Result};
use std::sync::OnceLock;
use wgpu::util::DeviceExt;
use wgpu::{BindGroup, BufferUsages, Texture, TextureSampleType, TextureUsages, TextureView};

/// The textures that a [`crate::Compositor`] reads its frames from, and the textures and buffers between its passes.
#[derive(Debug)]
pub struct Bound {
    pub(crate) views: Views,
    /// The number of slabs of depth that are blurred apart from each other, 1 or 3.
    pub(crate) slabs: u32,
    pub(crate) has_depth: bool,
    /// Scale and offset of [`crate::Depth`], 1/m.
    pub(crate) depth_map: [f32; 2],
    /// The scale of [`crate::Velocity`], px.
    pub(crate) velocity_scale: [f32; 2],
    /// The [`DefocusQuality`] of the current frame.
    pub(crate) quality: wgpu::Buffer,
    pub(crate) prepare: BindGroup,
    pub(crate) spread: BindGroup,
    /// The bindings of `pull`, by the level that is read.
    pub(crate) pull: Vec<BindGroup>,
    pub(crate) top: BindGroup,
    /// The bindings of `push`, by the level that is written; those of the finest level are for `blur`.
    pub(crate) push: Vec<BindGroup>,
    /// The bindings of `halve`, by the level that is read.
    pub(crate) halve: Vec<BindGroup>,
    pub(crate) defocus: BindGroup,
    /// The bindings of the last pass, one for each [`crate::sharpening::Blurred`].
    pub(crate) composite: [BindGroup; 3],
    /// The passes of the sharpening; empty until the first frame of a camera that sharpens.
    sharpening: OnceLock<Sharpening>,
}

/// The layer, and its inverse depth and path, at full size and halved again and again.
struct Pyramids {
    /// The layer, halved again and again.
    octaves: Vec<TextureView>,
    /// Inverse depth and path where they are known, times their weight, and the weight.
    known: Vec<TextureView>,
    /// Inverse depth and path, continued to every pixel. The finest level holds path and defocus std.
    filled: Vec<TextureView>,
}

impl Pyramids {
    ///
    /// # Errors
    /// If the device cannot hold the textures.
    fn new(device: &wgpu::Device, [w, h, parts]: [u32; 3]) -> Result<Self> {
        // The levels go down to one pixel, and there are at least two of them.
        let mut sizes = vec![[w, h]];
        while sizes.len() < 2 || sizes[sizes.len() - 1] != [1, 1] {
            sizes.push(sizes[sizes.len() - 1].map(|s| s.div_ceil(2)));
        }
        let level = |label: &str, i: usize| {
            let [w, h] = sizes[i.min(sizes.len() - 1)].map(|s| s as usize);
            let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::STORAGE_BINDING;
            texture(device, label, [w, h, parts as usize], BETWEEN, usage).map(|t| array_view(&t))
        };
        let levels = |label: &str, n: usize| (0..n).map(|i| level(label, i)).collect::<Result<Vec<_>>>();
        Ok(Self {
            octaves: levels("octave", OCTAVES)?,
            known: levels("known", sizes.len())?,
            filled: levels("filled", sizes.len())?,
        })
    }

    /// The index of the coarsest level, which has one pixel.
    fn last(&self) -> usize {
        self.known.len() - 1
    }
}

/// The resources that the bindings of several passes share.
struct Binder<'a> {
    of: &'a Passes,
    views: &'a Views,
    pyramids: &'a Pyramids,
    /// A uniform for each level: the number of times that the finer of two images was halved.
    levels: Vec<wgpu::Buffer>,
}

impl<'a> Binder<'a> {
    fn new(of: &'a Passes, views: &'a Views, pyramids: &'a Pyramids) -> Self {
        let level = |level: u32| {
            views.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("level"),
                contents: bytemuck::bytes_of(&level),
                usage: BufferUsages::UNIFORM,
            })
        };
        let levels = (0..OCTAVES.max(pyramids.last()) as u32).map(level).collect();
        Self { of, views, pyramids, levels }
    }

    fn camera(&self) -> wgpu::BindingResource<'_> {
        self.views.camera.as_entire_binding()
    }

    fn most(&self) -> wgpu::BindingResource<'_> {
        self.views.most.as_entire_binding()
    }

    fn bilinear(&self) -> wgpu::BindingResource<'_> {
        wgpu::BindingResource::Sampler(&self.of.bilinear)
    }

    /// The bindings of a kernel that halves, for all levels but the last.
    fn halved(&self, kernel: &Kernel, levels: &[TextureView]) -> Vec<BindGroup> {
        let halved = |i: usize| {
            let level = self.levels[i].as_entire_binding();
            let images = [&levels[i], &levels[i + 1]].map(view);
            let [finer, coarser] = images;
            kernel.bind(
                &self.views.device,
                &[self.camera(), level, self.bilinear(), finer, self.most(), coarser],
            )
        };
        (0..levels.len() - 1).map(halved).collect()
    }

    /// The bindings of a kernel that fills a level from a coarser one.
    fn doubled(&self, kernel: &Kernel, coarser: usize, level: usize) -> BindGroup {
        let Pyramids { known, filled, .. } = self.pyramids;
        let number = self.levels[level.min(self.pyramids.last() - 1)].as_entire_binding();
        let [coarser, own, written] = [&filled[coarser], &known[level], &filled[level]].map(view);
        kernel.bind(
            &self.views.device,
            &[self.camera(), number, self.bilinear(), coarser, self.most(), own, written],
        )
    }

    fn defocus(&self, quality: &wgpu::Buffer) -> BindGroup {
        let mut resources = vec![
            self.camera(),
            quality.as_entire_binding(),
            self.bilinear(),
            self.of.gaussians.as_entire_binding(),
            view(&self.views.blur),
            view(&self.views.focused),
        ];
        resources.extend(self.pyramids.octaves.iter().map(view));
        resources.extend([self.of.disks.as_entire_binding(), self.most()]);
        self.of.defocus.bind(&self.views.device, &resources)
    }

    fn composite(&self, layer: &TextureView, blur: &TextureView) -> BindGroup {
        let resources = [
            self.camera(),
            self.bilinear(),
            view(&self.views.frame),
            view(layer),
            view(blur),
            view(&self.of.tile),
            self.most(),
        ];
        bind(&self.views.device, &self.of.composite_layout, &resources)
    }
}

impl Bound {
    /// Makes the textures and buffers for frames of these textures' size, and binds them.
    ///
    /// # Errors
    /// If textures differ in size, cannot be read by the shaders, or are too large for the device.
    pub(crate) fn new(of: &Passes, device: &wgpu::Device, inputs: &Inputs) -> Result<Self> {
        check_sizes(inputs)?;
        check_formats(device, inputs)?;
        let size = inputs.frame.size();
        let (w, h, eyes) = (size.width, size.height, size.depth_or_array_layers);
        let slabs = if inputs.apart && inputs.depth.is_some() { 3 } else { 1 };
        let pyramids = Pyramids::new(device, [w, h, slabs * eyes])?;
        let buffer = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: usage | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let quality = buffer("quality", size_of::<DefocusQuality>() as u64, BufferUsages::UNIFORM);
        let views = Views {
            device: device.clone(),
            size: [w, h, eyes],
            camera: buffer("camera", size_of::<Camera>() as u64, BufferUsages::UNIFORM),
            most: buffer("largest alpha", 4 * u64::from(slabs * eyes), BufferUsages::STORAGE),
            frame: array_view(inputs.frame),
            sharp: pyramids.octaves[0].clone(),
            // The known depth and motion at full size are no longer needed when the focused layer is written.
            focused: pyramids.known[0].clone(),
            blur: pyramids.filled[0].clone(),
        };
        let input = |t: Option<&Texture>| t.map_or_else(|| of.nothing.clone(), array_view);
        let (color, depth) = (array_view(inputs.color), input(inputs.depth.map(|d| d.texture)));
        let velocity = input(inputs.velocity.map(|v| v.texture));
        let binder = Binder::new(of, &views, &pyramids);
        let last = pyramids.last();
        let prepare = [binder.camera(), view(&color), view(&views.sharp), binder.most(), view(&depth)];
        let spread = [
            binder.camera(),
            view(&views.sharp),
            view(&depth),
            view(&velocity),
            binder.most(),
            view(&pyramids.known[0]),
        ];
        let pushes = |i: usize| binder.doubled(if i == 0 { &of.blur } else { &of.push }, i + 1, i);
        Ok(Self {
            slabs,
            has_depth: inputs.depth.is_some(),
            depth_map: inputs.depth.map_or([0.0; 2], |d| [d.scale, d.offset]),
            velocity_scale: inputs.velocity.map_or([0.0; 2], |v| v.scale),
            prepare: of.prepare.bind(device, &prepare),
            spread: of.spread.bind(device, &spread),
            pull: binder.halved(&of.pull, &pyramids.known),
            // The kernel `top` reads no coarser level, so any texture will do.
            top: binder.doubled(&of.top, last - 1, last),
            push: (0..last).map(pushes).collect(),
            halve: binder.halved(&of.halve, &pyramids.octaves),
            defocus: binder.defocus(&quality),
            composite: [
                binder.composite(&views.focused, &views.blur),
                binder.composite(&views.sharp, &views.blur),
                binder.composite(&views.sharp, &of.nothing),
            ],
            sharpening: OnceLock::new(),
            quality,
            views,
        })
    }

    /// The passes of the sharpening. They are made when they are asked for first: cameras that do not sharpen need no textures for them.
    ///
    /// # Errors
    /// If the device cannot hold their textures.
    pub(crate) fn sharpening(&self, of: &Passes, sharpener: &Sharpener) -> Result<&Sharpening> {
        match self.sharpening.get() {
            Some(passes) => Ok(passes),
            None => {
                let made = Sharpening::new(of, sharpener, &self.views)?;
                Ok(self.sharpening.get_or_init(|| made))
            }
        }
    }
}

/// Checks that all textures have one size.
///
/// # Errors
/// If a texture has another size than the frame.
fn check_sizes(inputs: &Inputs) -> Result<()> {
    let size = inputs.frame.size();
    let check = |name: &str, other: Option<&Texture>| match other.map(Texture::size) {
        Some(s) if s != size => Err(Error::new(format!(
            "{name} has {} x {} pixels for {} eyes but the frame {} x {} for {}; give textures of one size",
            s.width, s.height, s.depth_or_array_layers, size.width, size.height, size.depth_or_array_layers
        ))),
        _ => Ok(()),
    };
    check("the virtual layer", Some(inputs.color))?;
    check("the virtual layer's depth", inputs.depth.map(|d| d.texture))?;
    check("the virtual layer's velocity", inputs.velocity.map(|v| v.texture))
}

/// Checks that shaders can read all textures.
///
/// # Errors
/// If a texture has a format, a number of samples or a usage with which the shaders cannot read it.
fn check_formats(device: &wgpu::Device, inputs: &Inputs) -> Result<()> {
    let readable = |name: &str,
                    texture: Option<&Texture>,
                    fits: &dyn Fn(TextureSampleType) -> bool,
                    format: &str| {
        let Some(texture) = texture else { return Ok(()) };
        let kind = texture.format().sample_type(Some(aspect(texture)), Some(device.features()));
        let usable = texture.usage().contains(TextureUsages::TEXTURE_BINDING) && texture.sample_count() == 1;
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
    let of_frame = |t| t == TextureSampleType::Float { filterable: true } && !inputs.frame.format().is_srgb();
    readable("the frame", Some(inputs.frame), &of_frame, "floats that can be filtered and are not Srgb")?;
    readable("the virtual layer", Some(inputs.color), &float, "floats")?;
    let of_depth = |t| float(t) || t == TextureSampleType::Depth;
    readable("the virtual layer's depth", inputs.depth.map(|d| d.texture), &of_depth, "floats or depth")?;
    readable("the virtual layer's velocity", inputs.velocity.map(|v| v.texture), &float, "floats")
}
