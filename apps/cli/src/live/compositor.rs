//! The object over a frame, on the processor.

use super::render::Layer;
use blindaug::{
    CameraModel, Encoded, Pixel, Premultiplied, Raster, Result,
    composite::{Options, Shot, VirtualLayer, composite},
};
use blindaug_gpu::Gpu;

/// Composites into textures.
pub struct Compositor;

impl Compositor {
    /// Composites the layer over a frame, once for each of the options, into a texture of display-encoded values each.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn composite(
        &self,
        gpu: &Gpu,
        (frame, number): (&Encoded, u64),
        layer: &Layer,
        camera: &CameraModel,
        targets: &[(Options, &wgpu::Texture)],
    ) -> Result<()> {
        let layer = VirtualLayer {
            color: Premultiplied(only(gpu, &layer.color)?),
            inverse_depth: Some(only(gpu, &layer.inverse_depth)?),
            flow: Some(only(gpu, &layer.velocity)?),
        };
        let shot = Shot { frame, number, inverse_depth: None, flow: None, with_and_without: None };
        for (options, target) in targets {
            let Encoded(made) = composite(&shot, &layer, camera, options)?;
            gpu.write(target, &[&made.map(|[r, g, b]| [r, g, b, 1.0])]);
        }
        Ok(())
    }
}

/// A texture's one image.
fn only<P: Pixel>(gpu: &Gpu, texture: &wgpu::Texture) -> Result<Raster<P>> {
    Ok(gpu.download(texture)?.swap_remove(0))
}
