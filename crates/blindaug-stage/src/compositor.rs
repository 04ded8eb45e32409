//! The composite of the object over a frame: by the passes of the graphics device, or by the processor where there is no graphics card.

use crate::render::Layer;
use blindaug::{
    CameraModel, Premultiplied, Result,
    composite::{CompositeOptions, Plate, VirtualLayer, composite},
};
use blindaug_gpu::{Bound, Compositor as Effects, Depth, Frame, Gpu, Inputs, Quality, Velocity, texture};
use blindaug_pipeline::live::LiveFrame;
use wgpu::{TextureFormat, TextureUsages};

/// What composites the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// The passes of the graphics device.
    Device,
    /// The processor, by the reference.
    Processor,
}

impl By {
    /// The faster one of the two. A graphics device that is only a program on the processor takes several times as long for its passes as
    /// the processor takes for the reference (docs/gpu.md). In a page it is always the device, since a page cannot wait for the layer that is
    /// copied from there.
    pub fn fastest(info: &wgpu::AdapterInfo) -> Self {
        match info.device_type {
            wgpu::DeviceType::Cpu if cfg!(not(target_arch = "wasm32")) => Self::Processor,
            _ => Self::Device,
        }
    }
}

/// Composites one layer over frames of its size.
pub enum Compositor {
    /// By the passes of the graphics device.
    Device {
        /// The passes.
        effects: Box<Effects>,
        /// The passes' textures.
        bound: Box<Bound>,
        /// The current frame, display-encoded.
        frame: wgpu::Texture,
    },
    /// By the processor.
    Processor {
        /// The layer on the device.
        layer: Layer,
    },
}

impl Compositor {
    /// A compositor of `layer` into textures of this format.
    ///
    /// # Errors
    /// If the device cannot hold the textures between the passes.
    pub fn new(gpu: &Gpu, by: By, layer: &Layer, target: TextureFormat) -> Result<Self> {
        if by == By::Processor {
            return Ok(Self::Processor { layer: layer.clone() });
        }
        let size = layer.color.size();
        let size = [size.width as usize, size.height as usize, 1];
        let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
        let frame = texture(&gpu.device, "frame", size, TextureFormat::Rgba8Unorm, usage)?;
        let effects = Effects::new(&gpu.device, &gpu.queue, target);
        // What is apart is copied whatever is promised of colours, and a frame in the target would be one more copy of it.
        let depth =
            Depth { texture: &layer.inverse_depth, scale: 1.0, offset: 0.0, nothing: Some(Layer::NOTHING) };
        let inputs = Inputs {
            frame: &frame,
            color: &layer.color,
            depth: Some(depth),
            velocity: Some(Velocity { texture: &layer.velocity, scale: [1.0; 2] }),
            cleared: false,
            apart: true,
        };
        let bound = effects.bind(&gpu.device, &inputs)?;
        Ok(Self::Device { effects: Box::new(effects), bound: Box::new(bound), frame })
    }

    /// Composites the layer over a frame, once for each of the options.
    ///
    /// # Errors
    /// If the model is for frames of another width, or the device was lost.
    pub fn composite(
        &self,
        gpu: &Gpu,
        shot: &LiveFrame,
        camera: &CameraModel,
        quality: Quality,
        targets: &[(CompositeOptions, &wgpu::Texture)],
    ) -> Result<()> {
        match self {
            Self::Device { effects, bound, frame } => {
                gpu.write(frame, &[&shot.frame.0.map(|[r, g, b]| [r, g, b, 1.0])]);
                for (options, target) in targets {
                    let mut encoder = gpu.device.create_command_encoder(&Default::default());
                    let of_frame = Frame {
                        model: camera,
                        options: *options,
                        quality,
                        number: shot.number,
                        area: None,
                        targets: &[target.create_view(&Default::default())],
                        frame_in_targets: false,
                        timer: None,
                    };
                    effects.encode(&gpu.queue, &mut encoder, bound, &of_frame)?;
                    // Each composite is submitted on its own, since the next one writes the same uniforms.
                    gpu.queue.submit([encoder.finish()]);
                }
            }
            Self::Processor { layer } => {
                let layer = on_processor(gpu, layer)?;
                let plate = Plate::new(&shot.frame, shot.number);
                for (options, target) in targets {
                    let made = composite(&plate, &layer, camera, options)?;
                    gpu.write(target, &[&made.0.map(|[r, g, b]| [r, g, b, 1.0])]);
                }
            }
        }
        Ok(())
    }
}

/// The layer, copied from the device; depth and motion are unknown where there is nothing.
fn on_processor(gpu: &Gpu, layer: &Layer) -> Result<VirtualLayer> {
    let color = gpu.download::<[f32; 4]>(&layer.color)?.remove(0);
    let depth = gpu.download::<f32>(&layer.inverse_depth)?.remove(0);
    let velocity = gpu.download::<[f32; 2]>(&layer.velocity)?.remove(0);
    let flow = blindaug::Flow::from_fn(velocity.width(), velocity.height(), |x, y| {
        if depth.at(x, y) > Layer::NOTHING { velocity.at(x, y) } else { [f32::NAN; 2] }
    });
    let inverse_depth = depth.map(|d| if d > Layer::NOTHING { d } else { f32::NAN });
    Ok(VirtualLayer { color: Premultiplied(color), inverse_depth: Some(inverse_depth), flow: Some(flow) })
}
