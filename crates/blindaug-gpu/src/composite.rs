//! The virtual layer over the frame, as if the camera had filmed it: [`blindaug::composite::composite`] on the GPU.

use crate::blocks::BLOCK;
use crate::bound::Bound;
use crate::camera::Camera;
use crate::inputs::Inputs;
use crate::passes::Passes;
use crate::quality::{self, CONTINUED, DefocusQuality, Quality};
use crate::sharpening::{self, Sharpener};
use crate::timer::{self, Timer};
use blindaug::composite::CompositeOptions;
use blindaug::model::{CameraModel, SharpeningModel};
use blindaug::{Error, Result};
use wgpu::{TextureFormat, TextureView};

/// A rectangle of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Area {
    /// The distance of the left edge from the frame's left edge, px.
    pub x: u32,
    /// The distance of the top edge from the frame's top edge, px.
    pub y: u32,
    /// The width, px.
    pub width: u32,
    /// The height, px.
    pub height: u32,
}

impl Area {
    /// The part of the area that lies in a frame of this size.
    fn within(self, width: u32, height: u32) -> Self {
        let (x, y) = (self.x.min(width), self.y.min(height));
        Self { x, y, width: self.width.min(width - x), height: self.height.min(height - y) }
    }

    /// Whether the area holds no pixel.
    fn is_empty(self) -> bool {
        self.width == 0 || self.height == 0
    }
}

/// One frame to composite.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// The camera that filmed the frame. Of its lens, out-of-focus points are Gaussians or round disks: see [`crate::rounded`].
    pub model: &'a CameraModel,
    /// The options of compositing. Layers that are composited one after the other need different seeds.
    pub options: CompositeOptions,
    /// The quality, that is, how closely the compositor follows the reference.
    pub quality: Quality,
    /// The frame's number, so that each has its own noise.
    pub number: u64,
    /// The area in which the object may be seen, blur included ([`blindaug::synth::Blur::reach_px`]). Outside of the area, the layer is not
    /// looked at, and the frame is only copied, but for the margin that a sharpening camera changes. `None`: the whole frame, in which the
    /// compositor finds the object itself.
    pub area: Option<Area>,
    /// A view per eye, of the frame's size and the format that the compositor was made for. The views get display-encoded values, or light
    /// after [`Compositor::with_linear_output`].
    pub targets: &'a [TextureView],
    /// Whether the targets hold the frame already, as the compositor would write it where nothing is seen of the object. Then nothing but
    /// the blocks in which the object may be seen is drawn, and those that the sharpening changes; the rest costs nothing.
    pub frame_in_targets: bool,
    /// The timer that measures how long the steps take, if any.
    pub timer: Option<&'a Timer>,
}

/// The compositor: its shaders and tables, which do not depend on the size of frames. It is made once.
#[derive(Debug)]
pub struct Compositor {
    passes: Passes,
    sharpener: Sharpener,
    /// Whether the shaders write light: the target's hardware encodes it, or the target holds light.
    linear_output: bool,
}

/// The effects of the camera on a frame, and the area that they change.
struct Plan {
    /// The area in which the blurred layer may be seen.
    area: Area,
    defocuses: bool,
    /// Whether the lens or motion blurs.
    blurs: bool,
    /// Whether the layer itself is read, unless it has broken values, without a copy in the space in which blur acts.
    direct: bool,
    sharpening: Option<SharpeningModel>,
}

impl Compositor {
    /// A compositor for targets of this format, which must be one that can be rendered to. It makes the tile of noise, too.
    pub fn new(device: &wgpu::Device, queue: &wgpu::Queue, target: TextureFormat) -> Self {
        Self {
            passes: Passes::new(device, queue, target),
            sharpener: Sharpener::new(device, target),
            linear_output: target.is_srgb(),
        }
    }

    /// The same compositor, which writes scene-linear light (sRGB's curve undone) instead of display-encoded values: for the float target
    /// of a renderer that blends and encodes after it. Targets of an `Srgb` format hold light anyway.
    pub fn with_linear_output(mut self) -> Self {
        self.linear_output = true;
        self
    }

    /// Makes everything that frames of these textures' size need. The textures are bound once and may be drawn to again and again.
    ///
    /// # Errors
    /// If sizes differ or are too large for the device.
    pub fn bind(&self, device: &wgpu::Device, inputs: &Inputs) -> Result<Bound> {
        Bound::new(&self.passes, device, inputs)
    }

    /// Records the passes of one frame, which must be submitted before the next is recorded with the same `bound`, since the queue writes
    /// the frame's numbers into buffers of `bound`. Nothing is read back, and nothing is allocated except for the textures of the
    /// sharpening, at the first frame of a camera that sharpens. Parts of the model that are unknown are not applied, nor are those without
    /// their evidence (depth, velocity).
    ///
    /// # Errors
    /// If the model is for another width or in relative inverse depth, there are not as many targets as eyes, or the device cannot hold
    /// the textures of the sharpening.
    pub fn encode(
        &self,
        queue: &wgpu::Queue,
        encoder: &mut wgpu::CommandEncoder,
        bound: &Bound,
        frame: &Frame,
    ) -> Result<()> {
        let eyes = bound.views.size[2];
        if frame.targets.len() != eyes as usize {
            return Err(Error::new(format!(
                "there are {} targets for {eyes} eyes; give one each",
                frame.targets.len()
            )));
        }
        let plan = self.plan(queue, bound, frame)?;
        encoder.clear_buffer(&bound.views.numbers, 0, None);
        encoder.clear_buffer(&bound.dispatch, 0, None);
        // Only the list's length is cleared.
        encoder.clear_buffer(&bound.views.list, 0, Some(4));
        encoder.clear_buffer(&bound.draws, 0, None);
        self.encode_blur(encoder, bound, &plan, frame);
        let sharpened = self.encode_sharpening(queue, encoder, bound, &plan, frame.timer)?;
        let (pipeline, group) = match sharpened {
            Some(group) => (&self.sharpener.sharpened, group),
            None => (&self.passes.composite, &bound.composite),
        };
        let kept = frame.frame_in_targets;
        let load = if kept { wgpu::LoadOp::Load } else { wgpu::LoadOp::Clear(wgpu::Color::BLACK) };
        for (eye, target) in (0..).zip(frame.targets) {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: None,
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
                })],
                timestamp_writes: frame.timer.map(|t| t.render(timer::COMPOSITE, eye == 0, eye + 1 == eyes)),
                ..Default::default()
            });
            // The frame is copied by a pass of its own: a pixel of the last pass takes many registers, of which a GPU has too few to hide
            // the time of the copy's reads behind each other.
            if !kept {
                pass.set_pipeline(&self.passes.copied);
                pass.set_bind_group(0, &bound.composite, &[]);
                pass.draw(0..3, eye..eye + 1);
            }
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, group, &[]);
            pass.draw_indirect(&bound.draws, 16 * u64::from(eye));
        }
        if let Some(timer) = frame.timer {
            timer.resolve(encoder);
        }
        Ok(())
    }

    /// Uploads the uniforms of a frame's passes, and decides which passes run.
    fn plan(&self, queue: &wgpu::Queue, bound: &Bound, frame: &Frame) -> Result<Plan> {
        let Frame { model, options, quality, number, area, .. } = *frame;
        let [w, h, _] = bound.views.size;
        let mut camera = Camera::new(model, w as usize, bound.velocity_scale, &options, quality, number)?;
        let whole = Area { x: 0, y: 0, width: w, height: h };
        let area = area.map_or(whole, |a| a.within(w, h));
        let seen = !area.is_empty();
        let sharpening =
            model.sharpening.known().copied().filter(|s| seen && !options.naive && s.amount > 0.0);
        if let Some(sharpening) = &sharpening {
            camera.sharpening_blocks = sharpening::reach_px(sharpening).div_ceil(BLOCK as u32);
        }
        camera.depth_map = bound.depth_map;
        camera.slabs = bound.slabs;
        camera.linear_target = u32::from(self.linear_output);
        camera.origin = [area.x, area.y];
        camera.size = [area.width, area.height];
        let defocuses = seen && camera.has_lens() && bound.has_depth;
        let moves = seen && camera.has_path();
        camera.defocuses = u32::from(defocuses);
        camera.moves = u32::from(moves);
        camera.frame = [w, h];
        // Where the layer is not looked at, it may hold anything, unless it was cleared.
        let is_known = bound.cleared || (area == whole && bound.nothing.is_none());
        let direct = is_known && bound.filterable && bound.slabs == 1 && camera.encoded_space == 0;
        camera.direct = u32::from(direct);
        camera.over_targets = u32::from(frame.frame_in_targets);
        camera.knows_nothing = u32::from(bound.nothing.is_some());
        camera.nothing = bound.nothing.unwrap_or_default();
        camera.refresh = u32::from(bound.passes_changed(defocuses, defocuses || moves, direct));
        queue.write_buffer(&bound.views.camera, 0, bytemuck::bytes_of(&camera));
        let defocus = DefocusQuality::new(quality, quality::shape_of(model, &options));
        queue.write_buffer(&bound.quality, 0, bytemuck::bytes_of(&defocus));
        Ok(Plan { area, defocuses, blurs: defocuses || moves, direct, sharpening })
    }

    /// Records the passes that extend the layer, halve it and put it out of focus.
    fn encode_blur(&self, encoder: &mut wgpu::CommandEncoder, bound: &Bound, plan: &Plan, frame: &Frame) {
        let timer = frame.timer;
        let [w, h, eyes] = bound.views.size;
        let parts = bound.slabs * eyes;
        let at_level = |level: usize| {
            let halved = |s: u32| (s + (1 << level) - 1) >> level;
            [halved(w), halved(h), parts]
        };
        let mut pass = timer::compute_pass(encoder, timer, timer::EXTENSION);
        if !plan.area.is_empty() {
            self.passes.prepare.run(&mut pass, &bound.prepare, at_level(0));
            if plan.direct {
                self.passes.mend.run(&mut pass, &bound.prepare, at_level(0));
            }
            let blocks = [w, h].map(|s| s.div_ceil(BLOCK as u32));
            for kernel in [&self.passes.near_in_row, &self.passes.list_blocks] {
                kernel.run(&mut pass, &bound.list_blocks, [blocks[0], blocks[1], parts]);
            }
            if plan.sharpening.is_none() {
                self.passes.list_tiles.run(&mut pass, &bound.list_blocks, [blocks[0], blocks[1], eyes]);
            }
        }
        if plan.blurs {
            self.passes.pull_continued.run(&mut pass, &bound.pull_continued, at_level(CONTINUED + 1));
            for (level, group) in (CONTINUED + 2..).zip(&bound.pull) {
                self.passes.pull.run(&mut pass, group, at_level(level));
            }
            self.passes.top.run(&mut pass, &bound.top, [1, 1, parts]);
            for (i, group) in bound.push.iter().enumerate().rev() {
                self.passes.push.run(&mut pass, group, at_level(CONTINUED + 1 + i));
            }
        }
        drop(pass);
        let mut pass = timer::compute_pass(encoder, timer, timer::OCTAVES);
        // The first octave comes from the extension.
        for (level, group) in (2..).zip(&bound.halve).filter(|_| plan.defocuses) {
            self.passes.halve.run(&mut pass, group, at_level(level));
        }
        drop(pass);
        let mut pass = timer::compute_pass(encoder, timer, timer::DEFOCUS);
        if plan.defocuses {
            self.passes.defocus.run_counted(&mut pass, &bound.defocus, &bound.dispatch);
        }
    }

    /// Records the passes of the sharpening up to the last one, whose bind group it returns; `None` for a camera that does not sharpen.
    fn encode_sharpening<'a>(
        &self,
        queue: &wgpu::Queue,
        encoder: &mut wgpu::CommandEncoder,
        bound: &'a Bound,
        plan: &Plan,
        timer: Option<&Timer>,
    ) -> Result<Option<&'a wgpu::BindGroup>> {
        let Some(model) = &plan.sharpening else {
            // The timer needs the beginning and the end of every step.
            if timer.is_some() {
                drop(timer::compute_pass(encoder, timer, timer::SHARPENING));
            }
            return Ok(None);
        };
        let passes = bound.sharpening(&self.passes, &self.sharpener)?;
        let steps = passes.write(queue, model)?;
        // The list of blocks to put out of focus makes room for that of the blocks to sharpen.
        encoder.clear_buffer(&bound.dispatch, 0, None);
        encoder.clear_buffer(&bound.views.list, 0, Some(4));
        let mut pass = timer::compute_pass(encoder, timer, timer::SHARPENING);
        let [w, h, eyes] = bound.views.size;
        let blocks = [w, h].map(|s| s.div_ceil(BLOCK as u32));
        for kernel in [&self.passes.seen_in_row, &self.passes.list_sharpened] {
            kernel.run(&mut pass, &bound.list_blocks, [blocks[0], blocks[1], eyes]);
        }
        passes.run(&self.sharpener, &mut pass, steps, &bound.dispatch);
        Ok(Some(&passes.sharpened))
    }
}
