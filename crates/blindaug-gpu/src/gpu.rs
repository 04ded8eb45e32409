//! The graphics device, and the transfer of rasters to and from its textures.

use blindaug::{Error, Pixel, Raster, Result, byte_from_encoded};
use half::f16;
use wgpu::{TextureFormat, TextureUsages};

/// A graphics device without a window, for programs that have none of their own. Everything else in this crate takes wgpu's own
/// [`wgpu::Device`] and [`wgpu::Queue`].
#[derive(Clone, Debug)]
pub struct Gpu {
    /// The device, which makes resources.
    pub device: wgpu::Device,
    /// The queue, which takes work.
    pub queue: wgpu::Queue,
    /// The name, the type and the backend of the device.
    pub info: wgpu::AdapterInfo,
}

impl Gpu {
    /// Takes the fastest device there is, software ones last; the environment variables of wgpu (`WGPU_BACKEND`, `WGPU_ADAPTER_NAME`)
    /// choose another. Timestamps are on if the device has them.
    ///
    /// # Errors
    /// If there is no device.
    pub fn new() -> Result<Self> {
        let instance = Self::instance(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        Ok(block_on(Self::request(&instance, None))?.0)
    }

    /// Makes the instance through which devices are found. OpenGL is left out: it lacks features that the shaders need, and would fail
    /// later.
    pub fn instance(mut descriptor: wgpu::InstanceDescriptor) -> wgpu::Instance {
        descriptor.backends.remove(wgpu::Backends::GL);
        wgpu::Instance::new(descriptor)
    }

    /// Takes a device as [`Gpu::new`] does, for tests; if there is none, it prints that nothing is tested.
    ///
    /// # Panics
    /// If there is no device and the environment variable `BLINDAUG_NEED_GPU` is set.
    pub fn for_tests() -> Option<Self> {
        match Self::new() {
            Ok(gpu) => Some(gpu),
            Err(why) if std::env::var_os("BLINDAUG_NEED_GPU").is_some() => panic!("{why}"),
            Err(why) => {
                eprintln!("NOT TESTED: {why}");
                None
            }
        }
    }

    /// Takes the fastest device that can draw on a window's surface, with its adapter, which knows the formats of the surface.
    ///
    /// # Errors
    /// If there is no device.
    pub fn for_surface(instance: &wgpu::Instance, surface: &wgpu::Surface) -> Result<(Self, wgpu::Adapter)> {
        block_on(Self::request(instance, Some(surface)))
    }

    /// Takes the fastest device, with its adapter, that can draw on a surface if there is one, without blocking: a page may not wait, and has a
    /// device only when its browser has found one.
    ///
    /// # Errors
    /// If there is no device.
    pub async fn request(
        instance: &wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
    ) -> Result<(Self, wgpu::Adapter)> {
        let none = |e: &dyn std::fmt::Display| {
            Error::new(format!(
                "no graphics device was found ({e}); install a driver for Vulkan, Metal or DirectX 12, or Mesa's software one \
                 (Debian: apt-get install mesa-vulkan-drivers)"
            ))
        };
        let adapter = match wgpu::util::initialize_adapter_from_env(instance, surface).await {
            Ok(adapter) => adapter,
            Err(_) => instance
                .request_adapter(&wgpu::RequestAdapterOptions {
                    power_preference: wgpu::PowerPreference::HighPerformance,
                    compatible_surface: surface,
                    ..Default::default()
                })
                .await
                .map_err(|e| none(&e))?,
        };
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                label: Some("blindaug"),
                required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
                required_limits: wgpu::Limits::default().using_resolution(adapter.limits()),
                ..Default::default()
            })
            .await
            .map_err(|e| none(&e))?;
        Ok((Self { device, queue, info: adapter.get_info() }, adapter))
    }

    /// Waits until everything that was submitted is done.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn wait(&self) -> Result<()> {
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        waited.map(|_| ()).map_err(|e| Error::new(format!("the graphics device stopped working: {e}")))
    }

    /// Makes a texture with one array layer per image: `Rgba8Unorm`, or `R`, `Rg`, `Rgba` of 16 or 32 bit floats, which take images of
    /// their number of channels.
    ///
    /// # Errors
    /// If there is no image, sizes differ, or the device cannot hold a texture as large.
    ///
    /// # Panics
    /// If the format does not fit the pixels.
    pub fn upload<P: Pixel>(&self, images: &[&Raster<P>], format: TextureFormat) -> Result<wgpu::Texture> {
        let (w, h) =
            images.first().map(|i| i.size()).ok_or_else(|| Error::new("there is no image to upload"))?;
        if images.iter().any(|i| i.size() != (w, h)) {
            return Err(Error::new("the images of an array of textures differ in size"));
        }
        let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST | TextureUsages::COPY_SRC;
        let texture = texture(&self.device, "upload", [w, h, images.len()], format, usage)?;
        self.write(&texture, images);
        Ok(texture)
    }

    /// Replaces the contents of a texture that [`Gpu::upload`] could have made of these images.
    ///
    /// # Panics
    /// If the format or the size does not fit.
    pub fn write<P: Pixel>(&self, texture: &wgpu::Texture, images: &[&Raster<P>]) {
        let flat = images.iter().flat_map(|i| P::flat(i.data()).iter().copied());
        let bytes: Vec<u8> = match texture.format() {
            TextureFormat::Rgba8Unorm => flat.map(byte_from_encoded).collect(),
            TextureFormat::R16Float | TextureFormat::Rg16Float | TextureFormat::Rgba16Float => {
                flat.flat_map(|v| f16::from_f32(v).to_ne_bytes()).collect()
            }
            TextureFormat::R32Float | TextureFormat::Rg32Float | TextureFormat::Rgba32Float => {
                flat.flat_map(f32::to_ne_bytes).collect()
            }
            format => panic!("{format:?} is none of the formats that can be written"),
        };
        let size = texture.size();
        let rows = (size.height * size.depth_or_array_layers) as usize;
        self.queue.write_texture(
            texture.as_image_copy(),
            &bytes,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some((bytes.len() / rows) as u32),
                rows_per_image: Some(size.height),
            },
            size,
        );
    }

    /// Reads the images of a texture's array layers. Values of 8 bit become [0, 1]; those of an `Srgb` format stay encoded.
    ///
    /// # Errors
    /// If the device was lost.
    ///
    /// # Panics
    /// If the format is neither `Rgba8UnormSrgb` nor one that [`Gpu::upload`] makes, or has another number of channels.
    pub fn download<P: Pixel>(&self, texture: &wgpu::Texture) -> Result<Vec<Raster<P>>> {
        let size = texture.size();
        let (w, h, layers) = (size.width as usize, size.height as usize, size.depth_or_array_layers as usize);
        let texel = texture.format().block_copy_size(None).expect("a color format") as usize;
        // Rows start at multiples of 256 bytes.
        let row = (w * texel).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("download"),
            size: (row * h * layers) as u64,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(row as u32),
                    rows_per_image: Some(h as u32),
                },
            },
            size,
        );
        self.queue.submit([encoder.finish()]);
        let bytes = self.read(&buffer)?;
        let values = |line: &[u8]| -> Vec<f32> {
            match texture.format() {
                TextureFormat::Rgba8Unorm | TextureFormat::Rgba8UnormSrgb => {
                    line.iter().map(|&v| f32::from(v) / 255.0).collect()
                }
                TextureFormat::R16Float | TextureFormat::Rg16Float | TextureFormat::Rgba16Float => {
                    line.chunks_exact(2).map(|b| f16::from_ne_bytes([b[0], b[1]]).to_f32()).collect()
                }
                TextureFormat::R32Float | TextureFormat::Rg32Float | TextureFormat::Rgba32Float => {
                    line.chunks_exact(4).map(|b| f32::from_ne_bytes([b[0], b[1], b[2], b[3]])).collect()
                }
                format => panic!("{format:?} is none of the formats that can be read"),
            }
        };
        let images = bytes.chunks_exact(row * h).map(|image| {
            let mut out = Raster::filled(w, h, P::default());
            for (y, line) in image.chunks_exact(row).enumerate() {
                P::flat_mut(out.row_mut(y)).copy_from_slice(&values(&line[..w * texel]));
            }
            out
        });
        Ok(images.collect())
    }

    /// Reads the bytes of a buffer that can be mapped for reading, once everything that was submitted is done.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn read(&self, buffer: &wgpu::Buffer) -> Result<Vec<u8>> {
        buffer.map_async(wgpu::MapMode::Read, .., |_| {});
        self.wait()?;
        let lost =
            |e: &dyn std::fmt::Display| Error::new(format!("the graphics device stopped working: {e}"));
        let bytes = buffer.get_mapped_range(..).mapped().map_err(|e| lost(&e))?.to_vec();
        buffer.unmap();
        Ok(bytes)
    }
}

/// What `wgpu::Buffer::get_mapped_range` returns: the view itself in wgpu 29, a view or an error in wgpu 30.
pub(crate) trait Mapped {
    /// The view of the buffer's bytes.
    ///
    /// # Errors
    /// If the buffer is not mapped, as one sentence.
    fn mapped(self) -> std::result::Result<wgpu::BufferView, String>;
}

impl Mapped for wgpu::BufferView {
    fn mapped(self) -> std::result::Result<wgpu::BufferView, String> {
        Ok(self)
    }
}

impl<E: std::fmt::Display> Mapped for std::result::Result<wgpu::BufferView, E> {
    fn mapped(self) -> std::result::Result<wgpu::BufferView, String> {
        self.map_err(|e| e.to_string())
    }
}

/// Makes a texture of [width (px), height (px), array layers].
///
/// # Errors
/// If a size is 0, or the device cannot hold a texture as large.
pub fn texture(
    device: &wgpu::Device,
    label: &str,
    [w, h, layers]: [usize; 3],
    format: TextureFormat,
    usage: TextureUsages,
) -> Result<wgpu::Texture> {
    let limits = device.limits();
    let (side, most) = (limits.max_texture_dimension_2d as usize, limits.max_texture_array_layers as usize);
    if w == 0 || h == 0 || layers == 0 {
        return Err(Error::new(format!(
            "{layers} images of {w} x {h} pixels are nothing to draw; give at least one pixel"
        )));
    }
    if w > side || h > side || layers > most {
        return Err(Error::new(format!(
            "{layers} images of {w} x {h} pixels are more than this graphics device can hold ({most} of {side} x {side}); use smaller ones"
        )));
    }
    Ok(device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width: w as u32, height: h as u32, depth_or_array_layers: layers as u32 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    }))
}

/// The aspect of a texture that shaders read: of a depth buffer the depth, not the stencil.
pub(crate) fn aspect(texture: &wgpu::Texture) -> wgpu::TextureAspect {
    if texture.format().has_depth_aspect() {
        wgpu::TextureAspect::DepthOnly
    } else {
        wgpu::TextureAspect::All
    }
}

/// A view of all array layers of a texture, as the kernels read it.
pub fn array_view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        aspect: aspect(texture),
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}

/// A view of each array layer of a texture, as the compositor's targets are.
pub fn layer_views(texture: &wgpu::Texture) -> Vec<wgpu::TextureView> {
    let view = |layer| {
        texture.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2),
            base_array_layer: layer,
            array_layer_count: Some(1),
            ..Default::default()
        })
    };
    (0..texture.depth_or_array_layers()).map(view).collect()
}

/// Waits for one of wgpu's futures, which natively are done as soon as they are polled.
fn block_on<T>(future: impl Future<Output = T>) -> T {
    let mut future = std::pin::pin!(future);
    let mut context = std::task::Context::from_waker(std::task::Waker::noop());
    loop {
        if let std::task::Poll::Ready(t) = future.as_mut().poll(&mut context) {
            return t;
        }
        std::thread::yield_now();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_there_is_only_opengl_there_is_no_device() {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::GL;
        let found = block_on(Gpu::request(&Gpu::instance(descriptor), None));
        let e = found.err().unwrap().to_string();
        assert!(e.starts_with("no graphics device was found") && !e.contains('\n'), "{e}");
    }
}
