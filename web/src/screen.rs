//! A canvas on which a graphics device draws.

use crate::failure::of;
use blindaug_gpu::Gpu;
use wasm_bindgen::JsError;
use wasm_bindgen::prelude::*;
use web_sys::OffscreenCanvas;
use wgpu::{SurfaceTarget, TextureFormat, TextureUsages};

/// A graphics device and a canvas of its own, which shows one picture above the other.
#[wasm_bindgen]
pub struct Screen {
    pub(crate) gpu: Gpu,
    surface: wgpu::Surface<'static>,
}

#[wasm_bindgen]
impl Screen {
    /// Takes a device that draws on the canvas, which gets its size from whoever draws.
    ///
    /// # Errors
    /// If the browser has no WebGPU, or no device.
    pub async fn open(canvas: OffscreenCanvas) -> Result<Screen, JsError> {
        let instance = Gpu::instance(wgpu::InstanceDescriptor::new_without_display_handle());
        let surface = instance.create_surface(SurfaceTarget::OffscreenCanvas(canvas)).map_err(of)?;
        let (gpu, _) = Gpu::request(&instance, Some(&surface)).await.map_err(of)?;
        Ok(Screen { gpu, surface })
    }
}

impl Screen {
    /// Prepares the canvas for two pictures of this size, px.
    pub fn configure(&self, (width, height): (usize, usize)) {
        self.surface.configure(
            &self.gpu.device,
            &wgpu::SurfaceConfiguration {
                usage: TextureUsages::COPY_DST | TextureUsages::RENDER_ATTACHMENT,
                format: TextureFormat::Rgba8Unorm,
                width: width as u32,
                height: 2 * height as u32,
                present_mode: wgpu::PresentMode::Fifo,
                desired_maximum_frame_latency: 2,
                alpha_mode: wgpu::CompositeAlphaMode::Opaque,
                view_formats: vec![],
                color_space: Default::default(),
            },
        );
    }

    /// Shows two pictures, of which the first stands above the second.
    ///
    /// # Errors
    /// If the canvas was lost.
    pub fn show(&self, pictures: [&wgpu::Texture; 2]) -> blindaug::Result<()> {
        use wgpu::CurrentSurfaceTexture::{Suboptimal, Success};
        let (Success(target) | Suboptimal(target)) = self.surface.get_current_texture() else {
            return Err(blindaug::Error::new("the graphics device gives no picture of the canvas"));
        };
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        for (i, picture) in (0..).zip(pictures) {
            let size = picture.size();
            let mut place = target.texture.as_image_copy();
            place.origin.y = i * size.height;
            encoder.copy_texture_to_texture(picture.as_image_copy(), place, size);
        }
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.queue.present(target);
        Ok(())
    }
}
