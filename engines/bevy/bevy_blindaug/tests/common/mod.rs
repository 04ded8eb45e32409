//! Bevy without a window: an app whose pictures are read back.

#![allow(dead_code, reason = "each test file uses a part of this")]

use bevy::app::{PluginsState, TerminalCtrlCHandlerPlugin};
use bevy::asset::{AssetPlugin, RenderAssetUsages};
use bevy::camera::RenderTarget;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_asset::RenderAssets;
use bevy::render::renderer::{RenderAdapterInfo, RenderDevice, RenderQueue};
use bevy::render::texture::GpuImage;
use bevy::render::{RenderApp, RenderPlugin};
use bevy::time::TimeUpdateStrategy;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_blindaug::{BlindaugPlugin, ViewLayer};
use blindaug::composite::VirtualLayer;
use blindaug::{Encoded, Premultiplied, Raster};
use blindaug_gpu::Gpu;
use std::path::Path;
use std::time::Duration;
use wgpu::{Extent3d, TextureDimension, TextureFormat, TextureUsages};

/// The time between two rendered frames, s.
pub const STEP: f32 = 0.04;

/// Whether there is no graphics device to test with, which is said; a panic if `BLINDAUG_NEED_GPU` is set.
pub fn no_gpu() -> bool {
    Gpu::for_tests().is_none()
}

/// An app that renders without a window, one frame at each update, with its assets in a folder.
pub fn app(assets: &Path) -> App {
    let mut app = App::new();
    let plugins = DefaultPlugins
        .set(WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() })
        .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() })
        .set(AssetPlugin {
            file_path: assets.to_string_lossy().into_owned(),
            watch_for_changes_override: Some(true),
            ..default()
        })
        .disable::<LogPlugin>()
        .disable::<TerminalCtrlCHandlerPlugin>()
        .disable::<WinitPlugin>()
        // The picture of an update is complete when the update has ended.
        .disable::<PipelinedRenderingPlugin>();
    app.add_plugins((plugins, BlindaugPlugin));
    app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::from_secs_f32(STEP)));
    app
}

/// Waits until the plugins are ready, in particular the graphics device.
pub fn start(app: &mut App) {
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
}

/// A picture in sRGB from encoded values.
pub fn picture(image: &Encoded) -> Image {
    let (w, h) = image.0.size();
    let bytes = image
        .0
        .data()
        .iter()
        .flat_map(|v| [v[0], v[1], v[2], 1.0].map(|v| (v * 255.0).round() as u8))
        .collect();
    let size = Extent3d { width: w as u32, height: h as u32, depth_or_array_layers: 1 };
    Image::new(size, TextureDimension::D2, bytes, TextureFormat::Rgba8UnormSrgb, RenderAssetUsages::all())
}

/// A target to render to, with the component that sends a camera there.
pub fn target(images: &mut Assets<Image>, [w, h]: [u32; 2]) -> (Handle<Image>, RenderTarget) {
    let mut image = Image::new_target_texture(w, h, TextureFormat::Rgba8UnormSrgb, None);
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    let handle = images.add(image);
    (handle.clone(), RenderTarget::Image(handle.into()))
}

/// Bevy's own device.
pub fn gpu(app: &App) -> Gpu {
    let world = app.sub_app(RenderApp).world();
    let device = world.resource::<RenderDevice>().wgpu_device().clone();
    let queue: wgpu::Queue = (**world.resource::<RenderQueue>().0).clone();
    Gpu { device, queue, info: (*world.resource::<RenderAdapterInfo>().0).clone() }
}

/// The picture in a target, encoded values.
pub fn read(app: &App, target: &Handle<Image>) -> Raster<[f32; 3]> {
    let images = app.sub_app(RenderApp).world().resource::<RenderAssets<GpuImage>>();
    let texture: &wgpu::Texture = &images.get(target).expect("the target is on the device").texture;
    gpu(app).download::<[f32; 4]>(texture).unwrap().remove(0).map(|[r, g, b, _]| [r, g, b])
}

/// What the only view was composited from: the frame behind, and the layer.
pub fn layer(app: &mut App) -> (Encoded, VirtualLayer) {
    let gpu = gpu(app);
    let world = app.sub_app_mut(RenderApp).world_mut();
    let mut views = world.query::<&ViewLayer>();
    let view = views.single(world).expect("there is one view");
    let frame = gpu.download::<[f32; 4]>(&view.frame).unwrap().remove(0);
    let known = |v: f32| if v.is_finite() { v } else { f32::NAN };
    // Inverse depth is negative where nothing is.
    let of_depth = |d: f32| if d < 0.0 { f32::NAN } else { known(d) };
    let layer = VirtualLayer {
        color: Premultiplied(gpu.download::<[f32; 4]>(&view.color).unwrap().remove(0)),
        inverse_depth: Some(gpu.download::<f32>(&view.inverse_depth).unwrap().remove(0).map(of_depth)),
        flow: Some(gpu.download::<[f32; 2]>(&view.motion).unwrap().remove(0).map(|v| v.map(known))),
    };
    (Encoded(frame.map(|[r, g, b, _]| [r, g, b])), layer)
}

/// The root mean square difference of encoded values.
pub fn difference(a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>) -> f32 {
    let pairs = a.data().as_flattened().iter().zip(b.data().as_flattened());
    (pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>() / (3 * a.data().len()) as f32).sqrt()
}

/// Writes a picture to the folder in BLINDAUG_PICTURES, for people to look at, if there is one.
pub fn keep(name: &str, image: &Raster<[f32; 3]>) {
    if let Some(folder) = std::env::var_os("BLINDAUG_PICTURES") {
        blindaug_io::write_png(Path::new(&folder).join(name), &Encoded(image.clone())).unwrap();
    }
}
