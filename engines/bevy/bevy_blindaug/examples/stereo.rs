//! Both eyes of a headset: two views of one virtual scene, each over its eye's frame, into the two layers of one texture, as a headset's
//! runtime has them. Without a headset and without a window: it writes both eyes side by side as a picture.
//!
//!     cargo run --release --example stereo -- picture.png
//!     cargo run --release --example stereo -- picture.png --size 516x552

use bevy::app::{PluginsState, TerminalCtrlCHandlerPlugin};
use bevy::asset::RenderAssetUsages;
use bevy::camera::{ManualTextureViewHandle, RenderTarget};
use bevy::prelude::*;
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::renderer::{RenderAdapterInfo, RenderDevice, RenderQueue};
use bevy::render::texture::{ManualTextureView, ManualTextureViews};
use bevy::render::{RenderApp, RenderPlugin};
use bevy::time::TimeUpdateStrategy;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_blindaug::{BlindaugPlugin, FilmedCamera, MatchedCamera};
use blindaug::model::{
    Capture, DefocusModel, Estimate, ExposureFraction, MotionBlurModel, NoiseLevel, NoiseModel,
};
use blindaug::{CameraModel, Encoded, Raster, composite::CompositeOptions};
use blindaug_gpu::Gpu;
use std::process::ExitCode;
use std::time::{Duration, Instant};
use wgpu::{Extent3d, TextureDimension, TextureFormat, TextureUsages};

/// The eyes of the headset of the paper, px.
const SIZE: [u32; 2] = [2064, 2208];
/// Half the distance of the eyes, m.
const HALF_DISTANCE: f32 = 0.032;
/// The number of frames before the picture: the pipelines must be there, and things must move.
const FRAMES: usize = 8;

/// A thing that turns around the scene's middle.
#[derive(Component)]
struct Turning;

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(sentence) => {
            eprintln!("stereo: {sentence}");
            ExitCode::FAILURE
        }
    }
}

/// Reads the command line: the picture's path, and the size of an eye's view, px.
fn arguments() -> Result<(String, [u32; 2]), String> {
    let usage = "give the picture to write, and perhaps --size WIDTHxHEIGHT";
    let words: Vec<String> = std::env::args().skip(1).collect();
    match &words[..] {
        [picture] => Ok((picture.clone(), SIZE)),
        [picture, option, size] if option == "--size" => {
            let numbers = size.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
            let numbers = numbers.filter(|[w, h]| (16..=8192).contains(w) && (16..=8192).contains(h));
            Ok((picture.clone(), numbers.ok_or(format!("{size} is no size from 16x16 to 8192x8192"))?))
        }
        _ => Err(usage.into()),
    }
}

/// A camera as `blindaug estimate` would find it, for views of this size.
fn camera([w, h]: [u32; 2]) -> CameraModel {
    let capture =
        Capture { width: w as usize, height: h as usize, fps: Some(45.0), frames_used: 1, pixel_aspect: 1.0 };
    let mut camera = CameraModel::unknown(capture, "not given");
    camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.6)));
    camera.defocus = Estimate::Known(DefocusModel::given_lens(0.006 * w as f32, 1.0 / 1.2));
    let level = |l: usize| NoiseLevel { slope: [0.01; 3], intercept: [0.02 / (l + 1) as f32; 3] };
    camera.noise = Estimate::Known(NoiseModel::given(std::array::from_fn(level), 1.0));
    camera
}

/// Both eyes' frames, as the layers of one picture.
fn frames([w, h]: [u32; 2]) -> Image {
    let pixel = |eye: u32, x: u32, y: u32| {
        let (u, v) = (x as f32 / w as f32 + 0.02 * eye as f32, y as f32 / h as f32);
        let wall = 0.35 + 0.1 * (40.0 * u).sin() * (30.0 * v).cos();
        let floor = if v > 0.6 { 0.15 } else { 0.0 };
        [wall + floor, wall + 0.6 * floor, wall].map(|v| (255.0 * v) as u8)
    };
    let places = (0..2).flat_map(|eye| (0..h).flat_map(move |y| (0..w).map(move |x| (eye, x, y))));
    let bytes = places.flat_map(|(eye, x, y)| {
        let [r, g, b] = pixel(eye, x, y);
        [r, g, b, 255]
    });
    let size = Extent3d { width: w, height: h, depth_or_array_layers: 2 };
    let usage = RenderAssetUsages::RENDER_WORLD;
    Image::new(size, TextureDimension::D2, bytes.collect(), TextureFormat::Rgba8UnormSrgb, usage)
}

fn run() -> Result<(), String> {
    let (picture, size) = arguments()?;
    let mut app = App::new();
    let plugins = DefaultPlugins
        .set(WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() })
        .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() })
        .disable::<WinitPlugin>()
        .disable::<TerminalCtrlCHandlerPlugin>()
        // The picture of an update is complete when the update has ended.
        .disable::<PipelinedRenderingPlugin>();
    app.add_plugins((plugins, BlindaugPlugin));
    app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::from_secs_f64(1.0 / 45.0)));
    app.add_systems(Update, |time: Res<Time>, mut things: Query<&mut Transform, With<Turning>>| {
        for mut thing in &mut things {
            thing.rotate_around(Vec3::new(0.0, 0.0, -1.2), Quat::from_rotation_y(1.5 * time.delta_secs()));
        }
    });
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();

    // The texture of the headset's runtime, with a layer for each eye.
    let device = app.world().resource::<RenderDevice>().wgpu_device().clone();
    let headset = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("headset"),
        size: Extent3d { width: size[0], height: size[1], depth_or_array_layers: 2 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: TextureDimension::D2,
        format: TextureFormat::Rgba8UnormSrgb,
        usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    let world = app.world_mut();
    let background = world.resource_mut::<Assets<Image>>().add(frames(size));
    let model = world.resource_mut::<Assets<FilmedCamera>>().add(FilmedCamera::from(camera(size)));
    for eye in 0..2 {
        let layer = headset.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2),
            base_array_layer: eye,
            array_layer_count: Some(1),
            ..default()
        });
        let view = ManualTextureView {
            texture_view: layer.into(),
            size: UVec2::from_array(size),
            view_format: TextureFormat::Rgba8UnormSrgb,
        };
        let handle = ManualTextureViewHandle(eye);
        world.resource_mut::<ManualTextureViews>().insert(handle, view);
        // Each eye has noise of its own.
        let options = CompositeOptions { seed: u64::from(eye), ..default() };
        world.spawn((
            MatchedCamera {
                model: model.clone(),
                background: background.clone(),
                background_layer: eye,
                options,
                // A headset's memory is small.
                apart: false,
                ..default()
            },
            Camera { order: eye as isize, ..default() },
            Projection::Perspective(PerspectiveProjection { fov: 1.6, ..default() }),
            RenderTarget::TextureView(handle),
            Msaa::Off,
            Transform::from_xyz(HALF_DISTANCE * (2.0 * eye as f32 - 1.0), 0.0, 0.0),
        ));
    }
    let mut thing = |mesh: Mesh, color: Color, place: Vec3, turns: bool| {
        let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
        let material = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial::from(color));
        let mut thing =
            world.spawn((Mesh3d(mesh), MeshMaterial3d(material), Transform::from_translation(place)));
        if turns {
            thing.insert(Turning);
        }
    };
    thing(
        Cuboid::new(0.25, 0.25, 0.25).into(),
        Color::srgb(0.7, 0.3, 0.1),
        Vec3::new(0.0, -0.1, -1.2),
        false,
    );
    thing(Sphere::new(0.12).into(), Color::srgb(0.1, 0.4, 0.7), Vec3::new(-0.5, 0.0, -1.2), true);
    thing(Torus::new(0.05, 0.12).into(), Color::srgb(0.5, 0.7, 0.1), Vec3::new(0.5, 0.2, -1.2), true);
    world.spawn((
        DirectionalLight { illuminance: 5000.0, ..default() },
        Transform::from_xyz(1.0, 2.0, 2.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));

    let mut start = Instant::now();
    for i in 0..FRAMES {
        // The pipelines are made in the first frames.
        if i == FRAMES / 2 {
            start = Instant::now();
        }
        app.update();
        let waited = device.poll(wgpu::PollType::wait_indefinitely());
        waited.map_err(|e| format!("the graphics device stopped working: {e}"))?;
    }
    let ms = 1e3 * start.elapsed().as_secs_f64() / (FRAMES - FRAMES / 2) as f64;
    println!("2 x {} x {}: {ms:.0} ms a frame", size[0], size[1]);

    let world = app.sub_app(RenderApp).world();
    let queue = (**world.resource::<RenderQueue>().0).clone();
    let info = (*world.resource::<RenderAdapterInfo>().0).clone();
    let eyes = Gpu { device, queue, info }.download::<[f32; 4]>(&headset).map_err(|e| e.to_string())?;
    let [w, h] = size.map(|s| s as usize);
    let both = Raster::from_fn(2 * w, h, |x, y| {
        let [r, g, b, _] = eyes[x / w].at(x % w, y);
        [r, g, b]
    });
    blindaug_io::write_png(picture, &Encoded(both)).map_err(|e| e.to_string())
}
