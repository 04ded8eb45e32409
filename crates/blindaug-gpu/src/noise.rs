//! The tile of unit noise, made once.

use crate::gpu::{array_view, texture};
use crate::kernel::{Binding, Kernel};
use crate::shaders;
use crate::uniforms::TileLevel;
use blindaug::model::NOISE_LEVELS;
use blindaug::synth::noise::{LEAST_STD, WINDOW_GAIN, white_band_std};
use wgpu::util::DeviceExt;
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

pub use crate::uniforms::TILE;

/// Makes the tile of noise: the contributions of the pyramid levels to a noise whose std is 1 in each level, as
/// [`blindaug::synth::noise::tileable_bands`] makes them from the same seed. The texture has three array layers; layer i holds R, G, B of
/// level i and channel i of the coarsest level.
pub fn tile(device: &wgpu::Device, queue: &wgpu::Queue, seed: u64) -> wgpu::Texture {
    let kernel =
        |entry, bindings: &[Binding]| Kernel::new(device, &shaders::NOISE_TILE, entry, [8, 8, 1], bindings);
    use Binding::{Buffer, BufferMut, Uniform};
    let white = kernel("white", &[Uniform, BufferMut]);
    let [down, up, unit] = ["down", "up", "unit"].map(|entry| kernel(entry, &[Uniform, BufferMut, Buffer]));
    let band = kernel("band", &[Uniform, BufferMut, Buffer, Buffer]);
    let pack = kernel(
        "pack",
        &[Uniform, Binding::Target(TextureFormat::Rgba16Float), Buffer, Buffer, Buffer, Buffer],
    );
    let buffer = |side: usize| {
        device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("noise"),
            size: (side * side * 16) as u64,
            usage: BufferUsages::STORAGE,
            mapped_at_creation: false,
        })
    };
    let usual_std = white_band_std();
    let level = |side: usize, l: usize| {
        let level = TileLevel {
            side: side as u32,
            floor: LEAST_STD * usual_std[l],
            gain: WINDOW_GAIN[l],
            seed: seed as u32,
            seed_high: (seed >> 32) as u32,
        };
        device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("noise level"),
            contents: bytemuck::bytes_of(&level),
            usage: BufferUsages::UNIFORM,
        })
    };
    let mut encoder = device.create_command_encoder(&Default::default());
    let mut pass = encoder.begin_compute_pass(&Default::default());
    let mut run = |kernel: &Kernel,
                   level: &wgpu::Buffer,
                   to: wgpu::BindingResource,
                   from: &[&wgpu::Buffer],
                   side: usize| {
        let mut resources = vec![level.as_entire_binding(), to];
        resources.extend(from.iter().map(|b| b.as_entire_binding()));
        kernel.run(&mut pass, &kernel.bind(device, &resources), [side as u32, side as u32, 1]);
    };
    let mut current = buffer(TILE);
    run(&white, &level(TILE, 0), current.as_entire_binding(), &[], TILE);
    let levels: [wgpu::Buffer; NOISE_LEVELS] = std::array::from_fn(|l| {
        let side = TILE >> l;
        let low = buffer(side / 2);
        run(&down, &level(side, l), low.as_entire_binding(), &[&current], side / 2);
        let difference = buffer(side);
        run(&band, &level(side / 2, l), difference.as_entire_binding(), &[&low, &current], side);
        let mut full = buffer(side);
        run(&unit, &level(side, l), full.as_entire_binding(), &[&difference], side);
        for l in (0..l).rev() {
            let enlarged = buffer(TILE >> l);
            run(&up, &level(TILE >> (l + 1), l), enlarged.as_entire_binding(), &[&full], TILE >> l);
            full = enlarged;
        }
        current = low;
        full
    });
    let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::STORAGE_BINDING | TextureUsages::COPY_SRC;
    let tile = texture(device, "noise tile", [TILE, TILE, 3], TextureFormat::Rgba16Float, usage)
        .expect("every device holds textures of 256 x 256 pixels");
    let view = array_view(&tile);
    run(&pack, &level(TILE, 0), wgpu::BindingResource::TextureView(&view), &levels.each_ref(), TILE);
    drop(pass);
    queue.submit([encoder.finish()]);
    tile
}
