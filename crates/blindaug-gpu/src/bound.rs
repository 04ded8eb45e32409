//! The textures that a compositor reads its frames from, and the textures and buffers between its passes.

use crate::blocks::{BLOCK, Block};
use crate::camera::Camera;
use crate::gpu::{Gpu, array_view, aspect, texture};
use crate::inputs::Inputs;
use crate::kernel::{Kernel, bind};
use crate::passes::{BETWEEN, PART_NUMBERS, Passes, Views, view};
use crate::quality::{CONTINUED, DefocusQuality, OCTAVES};
use crate::sharpening::{Sharpener, Sharpening};
use blindaug::{Error, Result};
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use wgpu::util::DeviceExt;
use wgpu::{BindGroup, BufferUsages, Texture, TextureFormat, TextureSampleType, TextureUsages, TextureView};

/// The textures that a [`crate::Compositor`] reads its frames from, and the textures and buffers between its passes.
#[derive(Debug)]
pub struct Bound {
    pub(crate) views: Views,
    /// The number of slabs of depth that are blurred apart from each other, 1 or 3.
    pub(crate) slabs: u32,
    pub(crate) has_depth: bool,
    /// Whether the layer can be filtered, so that the passes may read it without a copy.
    pub(crate) filterable: bool,
    /// [`Inputs::cleared`].
    pub(crate) cleared: bool,
    /// The depth texture's value where nothing is, if it has one.
    pub(crate) nothing: Option<f32>,
    /// Scale and offset of [`crate::Depth`], 1/m.
    pub(crate) depth_map: [f32; 2],
    /// The scale of [`crate::Velocity`], px.
    pub(crate) velocity_scale: [f32; 2],
    /// The [`DefocusQuality`] of the current frame.
    pub(crate) quality: wgpu::Buffer,
    pub(crate) prepare: BindGroup,
    /// The bindings of the kernels that find the blocks in which something is seen, and those that the sharpening works on.
    pub(crate) list_blocks: BindGroup,
    pub(crate) pull_continued: BindGroup,
    /// The bindings of `pull`, by the level that is read, from `CONTINUED + 1` on.
    pub(crate) pull: Vec<BindGroup>,
    pub(crate) top: BindGroup,
    /// The bindings of `push`, by the level that is written, from `CONTINUED + 1` on.
    pub(crate) push: Vec<BindGroup>,
    /// The bindings of `halve`, by the level that is read, from the first one on.
    pub(crate) halve: Vec<BindGroup>,
    pub(crate) defocus: BindGroup,
    pub(crate) composite: BindGroup,
    /// The workgroups that the list of blocks takes.
    pub(crate) dispatch: wgpu::Buffer,
    /// For each eye, the numbers of the draw of the tiles in which something may be seen.
    pub(crate) draws: wgpu::Buffer,
    /// A number for the passes of the frame before.
    passes: AtomicU32,
    /// The passes of the sharpening; empty until the first frame of a camera that sharpens.
    sharpening: OnceLock<Sharpening>,
}

/// The layer, and its inverse depth and path, halved again and again.
struct Pyramids {
    /// The layer at full size and halved.
    octaves: Vec<TextureView>,
    /// Inverse depth and path where they are known, from level [`CONTINUED`] on: there, their means and the eighth root of their weight, on
    /// the levels above times their weight, and the weight.
    known: Vec<TextureView>,
    /// Inverse depth and path, continued to every pixel, from level `CONTINUED + 1` on.
    filled: Vec<TextureView>,
    /// Which of the pixels under a pixel of level `CONTINUED` the object covers, as the bits of a whole number.
    covered: TextureView,
    /// The layer after defocus.
    focused: TextureView,
}

impl Pyramids {
    ///
    /// # Errors
    /// If the device cannot hold the textures.
    fn new(device: &wgpu::Device, [w, h, parts]: [u32; 3]) -> Result<Self> {
        // The levels go down to one pixel, and there are at least two that continue depth and motion.
        let mut sizes = vec![[w, h]];
        while sizes.len() < CONTINUED + 2 || sizes[sizes.len() - 1] != [1, 1] {
            sizes.push(sizes[sizes.len() - 1].map(|s| s.div_ceil(2)));
        }
        let level = |label: &str, i: usize, format| {
            let [w, h] = sizes[i.min(sizes.len() - 1)].map(|s| s as usize);
            let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::STORAGE_BINDING;
            texture(device, label, [w, h, parts as usize], format, usage).map(|t| array_view(&t))
        };
        let levels =
            |label: &str, of: Range<usize>| of.map(|i| level(label, i, BETWEEN)).collect::<Result<Vec<_>>>();
        Ok(Self {
            octaves: levels("octave", 0..OCTAVES)?,
            known: levels("known", CONTINUED..sizes.len())?,
            filled: levels("filled", CONTINUED + 1..sizes.len())?,
            covered: level("covered", CONTINUED, TextureFormat::R32Float)?,
            focused: level("focused", 0, BETWEEN)?,
        })
    }

    /// The number of the coarsest level, which has one pixel.
    fn last(&self) -> usize {
        CONTINUED + self.known.len() - 1
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
        let levels = (0..=OCTAVES.max(pyramids.last()) as u32).map(level).collect();
        Self { of, views, pyramids, levels }
    }

    fn camera(&self) -> wgpu::BindingResource<'_> {
        self.views.camera.as_entire_binding()
    }

    fn numbers(&self) -> wgpu::BindingResource<'_> {
        self.views.numbers.as_entire_binding()
    }

    fn blocks(&self) -> wgpu::BindingResource<'_> {
        self.views.blocks.as_entire_binding()
    }

    fn bilinear(&self) -> wgpu::BindingResource<'_> {
        wgpu::BindingResource::Sampler(&self.of.bilinear)
    }

    fn pull_continued(&self) -> BindGroup {
        let level = self.levels[CONTINUED].as_entire_binding();
        let (finer, coarser) = (view(&self.pyramids.known[0]), view(&self.pyramids.known[1]));
        let resources =
            [self.camera(), level, self.bilinear(), finer, self.blocks(), coarser, self.numbers()];
        self.of.pull_continued.bind(&self.views.device, &resources)
    }

    /// The bindings of a kernel that halves successive levels, the first of which has number `first`, for all but the last.
    fn halved(&self, kernel: &Kernel, first: usize, levels: &[TextureView]) -> Vec<BindGroup> {
        let halved = |(images, level): (&[TextureView], &wgpu::Buffer)| {
            let level = level.as_entire_binding();
            let (finer, coarser) = (view(&images[0]), view(&images[1]));
            kernel.bind(
                &self.views.device,
                &[self.camera(), level, self.bilinear(), finer, self.blocks(), coarser],
            )
        };
        levels.windows(2).zip(&self.levels[first..]).map(halved).collect()
    }

    /// The bindings of a kernel that fills a level from the next coarser one.
    fn doubled(&self, kernel: &Kernel, level: usize) -> BindGroup {
        let Pyramids { known, filled, .. } = self.pyramids;
        let number = self.levels[level].as_entire_binding();
        // Nothing is coarser than the last level, whose kernel reads no other.
        let coarser = view(filled.get(level - CONTINUED).unwrap_or(&self.of.nothing));
        let (own, written) = (view(&known[level - CONTINUED]), view(&filled[level - CONTINUED - 1]));
        kernel.bind(
            &self.views.device,
            &[self.camera(), number, self.bilinear(), coarser, self.blocks(), own, written],
        )
    }

    fn defocus(&self, quality: &wgpu::Buffer, depth: &TextureView) -> BindGroup {
        let mut resources = vec![
            self.camera(),
            quality.as_entire_binding(),
            self.bilinear(),
            self.of.gaussians.as_entire_binding(),
            view(depth),
            view(&self.views.focused),
        ];
        resources.extend(self.pyramids.octaves.iter().map(view));
        resources.extend([self.of.disks.as_entire_binding(), self.numbers()]);
        resources.extend([&self.views.continued, &self.views.covered, &self.views.coarser].map(view));
        resources.extend([self.views.list.as_entire_binding(), view(&self.views.filtered)]);
        self.of.defocus.bind(&self.views.device, &resources)
    }

    fn composite(&self) -> BindGroup {
        let resources = [
            self.camera(),
            self.bilinear(),
            view(&self.views.frame),
            view(&self.views.focused),
            view(&self.views.sharp),
            view(&self.views.continued),
            view(&self.views.covered),
            view(&self.views.coarser),
            view(&self.of.tile),
            self.views.tiles.as_entire_binding(),
            self.blocks(),
            view(&self.views.velocity),
            self.numbers(),
            view(&self.views.filtered),
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
        let blocks = [w, h].map(|s| u64::from(s.div_ceil(BLOCK as u32)));
        let of_eye = blocks[0] * blocks[1];
        let blocks = of_eye * u64::from(slabs * eyes);
        let near = buffer("blocks near the object", 4 * blocks, BufferUsages::STORAGE);
        let dispatch = buffer("workgroups", 12, BufferUsages::STORAGE | BufferUsages::INDIRECT);
        let draws = buffer("draws", 16 * u64::from(eyes), BufferUsages::STORAGE | BufferUsages::INDIRECT);
        let input = |t: Option<&Texture>| t.map_or_else(|| of.nothing.clone(), array_view);
        let color = array_view(inputs.color);
        let filterable = sample_type(device, inputs.color) == FILTERABLE;
        let views = Views {
            device: device.clone(),
            size: [w, h, eyes],
            camera: buffer("camera", size_of::<Camera>() as u64, BufferUsages::UNIFORM),
            numbers: buffer(
                "numbers of the parts",
                4 * PART_NUMBERS as u64 * u64::from(slabs * eyes),
                BufferUsages::STORAGE,
            ),
            blocks: buffer("blocks", 4 * blocks, BufferUsages::STORAGE | BufferUsages::COPY_SRC),
            frame: array_view(inputs.frame),
            sharp: pyramids.octaves[0].clone(),
            filtered: if filterable { color.clone() } else { pyramids.octaves[0].clone() },
            tiles: buffer("tiles", 4 * of_eye * u64::from(eyes), BufferUsages::STORAGE),
            list: buffer("list of blocks", 4 * (blocks + 1), BufferUsages::STORAGE),
            focused: pyramids.focused.clone(),
            continued: pyramids.known[0].clone(),
            covered: pyramids.covered.clone(),
            coarser: pyramids.filled[0].clone(),
            velocity: input(inputs.velocity.map(|v| v.texture)),
        };
        let depth = input(inputs.depth.map(|d| d.texture));
        let binder = Binder::new(of, &views, &pyramids);
        let last = pyramids.last();
        let prepare = [
            binder.camera(),
            view(&color),
            view(&depth),
            view(&views.velocity),
            binder.numbers(),
            view(&views.sharp),
            view(&pyramids.octaves[1]),
            view(&views.continued),
            view(&views.covered),
            binder.blocks(),
        ];
        let list_blocks = [
            binder.camera(),
            binder.numbers(),
            binder.blocks(),
            near.as_entire_binding(),
            views.list.as_entire_binding(),
            dispatch.as_entire_binding(),
            draws.as_entire_binding(),
            views.tiles.as_entire_binding(),
        ];
        Ok(Self {
            slabs,
            has_depth: inputs.depth.is_some(),
            filterable,
            cleared: inputs.cleared,
            nothing: inputs.depth.and_then(|d| d.nothing),
            depth_map: inputs.depth.map_or([0.0; 2], |d| [d.scale, d.offset]),
            velocity_scale: inputs.velocity.map_or([0.0; 2], |v| v.scale),
            prepare: of.prepare.bind(device, &prepare),
            list_blocks: of.list_blocks.bind(device, &list_blocks),
            pull_continued: binder.pull_continued(),
            pull: binder.halved(&of.pull, CONTINUED + 1, &pyramids.known[1..]),
            top: binder.doubled(&of.top, last),
            push: (CONTINUED + 1..last).map(|level| binder.doubled(&of.push, level)).collect(),
            halve: binder.halved(&of.halve, 1, &pyramids.octaves[1..]),
            defocus: binder.defocus(&quality, &depth),
            composite: binder.composite(),
            dispatch,
            draws,
            passes: AtomicU32::new(0),
            sharpening: OnceLock::new(),
            quality,
            views,
        })
    }

    /// The blocks of the frame that was submitted last, for measurements: row by row, then for each part of the object that is blurred
    /// apart, then for each eye. Waits for the device.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn read_blocks(&self, gpu: &Gpu) -> Result<Vec<Block>> {
        let size = self.views.blocks.size();
        let readable = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("blocks to read"),
            size,
            usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&self.views.blocks, 0, &readable, 0, size);
        gpu.queue.submit([encoder.finish()]);
        let bytes = gpu.read(&readable)?;
        let bits: &[u32] = bytemuck::cast_slice(&bytes);
        Ok(bits.iter().map(|&b| Block::of_bits(b)).collect())
    }

    /// Whether the passes of a frame are others than those of the frame before, so that their textures do not hold that frame.
    pub(crate) fn passes_changed(&self, defocuses: bool, blurs: bool, direct: bool) -> bool {
        let now = 1 + u32::from(defocuses) + 2 * u32::from(blurs) + 4 * u32::from(direct);
        self.passes.swap(now, Ordering::Relaxed) != now
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

/// The kind of values of a texture that can be filtered.
const FILTERABLE: Option<TextureSampleType> = Some(TextureSampleType::Float { filterable: true });

/// The kind of values that a texture's shaders read.
fn sample_type(device: &wgpu::Device, texture: &Texture) -> Option<TextureSampleType> {
    texture.format().sample_type(Some(aspect(texture)), Some(device.features()))
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
        let kind = sample_type(device, texture);
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
    let of_frame = |t| Some(t) == FILTERABLE && !inputs.frame.format().is_srgb();
    readable("the frame", Some(inputs.frame), &of_frame, "floats that can be filtered and are not Srgb")?;
    readable("the virtual layer", Some(inputs.color), &float, "floats")?;
    let of_depth = |t| float(t) || t == TextureSampleType::Depth;
    readable("the virtual layer's depth", inputs.depth.map(|d| d.texture), &of_depth, "floats or depth")?;
    readable("the virtual layer's velocity", inputs.velocity.map(|v| v.texture), &float, "floats")
}
