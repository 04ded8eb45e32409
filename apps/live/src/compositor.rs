//! The composite of the object over a frame.

use super::render::Layer;
use blindaug::{CameraModel, Result, composite::CompositeOptions};
use blindaug_gpu::{Bound, Compositor as Effects, Depth, Frame, Gpu, Inputs, Quality, Velocity, texture};
use blindaug_pipeline::live::LiveFrame;
use wgpu::{TextureFormat, TextureUsages, TextureView};

/// Composites one layer over frames of its size.
pub struct Compositor {
    effects: Effects,
    bound: Bound,
    /// The current frame, display-encoded.
    frame: wgpu::Texture,
}

impl Compositor {
    /// A compositor of `layer` into textures of this format.
    ///
    /// # Errors
    /// If the device cannot hold the textures between the passes.
    pub fn new(gpu: &Gpu, layer: &Layer, target: TextureFormat) -> Result<Self> {
        let size = layer.color.size();
        let size = [size.width as usize, size.height as usize, 1];
        let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
        let frame = texture(&gpu.device, "frame", size, TextureFormat::Rgba8Unorm, usage)?;
        let effects = Effects::new(&gpu.device, &gpu.queue, target);
        let inputs = Inputs {
            frame: &frame,
            color: &layer.color,
            depth: Some(Depth { texture: &layer.inverse_depth, scale: 1.0, offset: 0.0 }),
            velocity: Some(Velocity { texture: &layer.velocity, scale: [1.0; 2] }),
            apart: true,
        };
        let bound = effects.bind(&gpu.device, &inputs)?;
        Ok(Self { effects, bound, frame })
    }

    /// Composites the layer over a frame, once for each of the options.
    ///
    /// # Errors
    /// If the model is for frames of another width.
    pub fn composite(
        &self,
        gpu: &Gpu,
        shot: &LiveFrame,
        camera: &CameraModel,
        quality: Quality,
        targets: &[(CompositeOptions, &TextureView)],
    ) -> Result<()> {
        gpu.write(&self.frame, &[&shot.frame.0.map(|[r, g, b]| [r, g, b, 1.0])]);
        for (options, target) in targets {
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            let frame = Frame {
                model: camera,
                options: *options,
                quality,
                number: shot.number,
                area: None,
                targets: &[(*target).clone()],
                timer: None,
            };
            self.effects.encode(&gpu.queue, &mut encoder, &self.bound, &frame)?;
            // Each composite is submitted on its own, since the next one writes the same uniforms.
            gpu.queue.submit([encoder.finish()]);
        }
        Ok(())
    }
}
