//! A virtual thing in a video or in front of a camera, as that camera would have filmed it, with everything estimated while it plays.
//!
//!     cargo run --release --example mixed_reality -- clip.mp4
//!     cargo run --release --example mixed_reality -- camera:0
//!     cargo run --release --example mixed_reality -- clip.mp4 --headless picture.png --frames 60
//!
//! Keys: left and right move the line (left of it the thing is pasted on as it is), N leaves the noise out, B changes the shape of
//! out-of-focus points, up and down move the thing away and nearer, space stops the frame.

use bevy::app::{AppExit, ScheduleRunnerPlugin};
use bevy::camera::{Exposure, RenderTarget};
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::view::screenshot::{Capturing, Screenshot, save_to_disk};
use bevy::time::TimeUpdateStrategy;
use bevy::window::{ExitCondition, WindowResolution};
use bevy::winit::{UpdateMode, WinitPlugin, WinitSettings};
use bevy_blindaug::{
    BlindaugPlugin, FilmedCamera, LiveCamera, LiveEvent, LiveOptions, MatchedCamera, ShadowCatcher,
};
use blindaug::synth::defocus::Bokeh;
use std::f32::consts::PI;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};
use wgpu::{TextureFormat, TextureUsages};

/// The frames between two lines about time and memory.
const TELL: u64 = 100;
/// The share of a frame's mean light that comes from one direction, from above.
const DIRECT: f32 = 0.65;

/// What the command line says.
#[derive(Resource, Clone)]
struct Arguments {
    input: PathBuf,
    headless: Option<PathBuf>,
    frames: u64,
    split: f32,
}

impl Arguments {
    /// Reads the command line.
    ///
    /// # Errors
    /// If it makes no sense: one sentence.
    fn read() -> Result<Self, String> {
        let mut read = Self { input: PathBuf::new(), headless: None, frames: 60, split: 0.5 };
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or(format!("{word} needs a value"));
            match word.as_str() {
                "--headless" => read.headless = Some(value()?.into()),
                "--frames" => {
                    read.frames =
                        value()?.parse().map_err(|_| "--frames needs a number of frames".to_string())?;
                }
                "--split" => {
                    read.split =
                        value()?.parse().map_err(|_| "--split needs a number from 0 to 1".to_string())?;
                }
                _ if word.starts_with("--") => {
                    return Err(format!(
                        "{word} is no option; there are --headless PICTURE, --frames N and --split SHARE"
                    ));
                }
                _ => read.input = word.into(),
            }
        }
        if read.input.as_os_str().is_empty() {
            return Err("give a video, a folder of images, or a camera (camera:0)".into());
        }
        Ok(read)
    }
}

fn main() -> ExitCode {
    match Arguments::read().and_then(run) {
        Ok(code) => code,
        Err(sentence) => {
            eprintln!("mixed_reality: {sentence}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments) -> Result<ExitCode, String> {
    let mut app = App::new();
    let is_headless = arguments.headless.is_some();
    let window =
        Window { title: "mixed_reality".into(), resolution: WindowResolution::new(960, 540), ..default() };
    let plugins =
        DefaultPlugins.set(RenderPlugin { synchronous_pipeline_compilation: is_headless, ..default() });
    if is_headless {
        app.add_plugins(
            plugins
                .set(WindowPlugin {
                    primary_window: None,
                    exit_condition: ExitCondition::DontExit,
                    ..default()
                })
                .disable::<WinitPlugin>(),
        )
        .add_plugins(ScheduleRunnerPlugin::run_loop(Duration::ZERO))
        .add_systems(Last, finish);
    } else {
        app.add_plugins(plugins.set(WindowPlugin { primary_window: Some(window), ..default() }))
            .add_systems(Update, (keys, title));
    }
    app.add_plugins(BlindaugPlugin).add_systems(Startup, setup).add_systems(Update, (animate, tell));
    let live = app.world_mut().resource_scope(|world, mut images: Mut<Assets<Image>>| {
        let mut models = world.resource_mut::<Assets<FilmedCamera>>();
        let options = LiveOptions { every_frame: is_headless, ..default() };
        LiveCamera::open(&arguments.input, &options, &mut images, &mut models)
    });
    let live = live.map_err(|e| e.to_string())?;
    let interval = Duration::from_secs_f64(live.fps().recip());
    if is_headless {
        app.insert_resource(TimeUpdateStrategy::ManualDuration(interval));
    } else {
        // A frame is rendered for each filmed frame, which is what motion vectors then hold for.
        let mode = UpdateMode::Reactive {
            wait: interval,
            react_to_device_events: false,
            react_to_user_events: false,
            react_to_window_events: false,
        };
        app.insert_resource(WinitSettings { focused_mode: mode, unfocused_mode: mode });
    }
    app.insert_resource(live).insert_resource(arguments);
    match app.run() {
        AppExit::Success => Ok(ExitCode::SUCCESS),
        AppExit::Error(code) => Ok(ExitCode::from(code.get())),
    }
}

/// The picture that is rendered to without a window.
#[derive(Resource)]
struct Picture(Handle<Image>);

/// What stands on the plane.
#[derive(Component)]
struct Thing;

/// What turns around it.
#[derive(Component)]
struct Turning;

fn setup(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut catchers: ResMut<Assets<ShadowCatcher>>,
    mut images: ResMut<Assets<Image>>,
    mut windows: Query<&mut Window>,
    live: Res<LiveCamera>,
    arguments: Res<Arguments>,
) {
    let (w, h) = live.size();
    let mut camera = commands.spawn((
        MatchedCamera { background: live.background.clone(), split: arguments.split, ..default() },
        Projection::Perspective(live.projection()),
    ));
    if arguments.headless.is_some() {
        let mut image = Image::new_target_texture(w as u32, h as u32, TextureFormat::Rgba8UnormSrgb, None);
        image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        let image = images.add(image);
        camera.insert(RenderTarget::Image(image.clone().into()));
        commands.insert_resource(Picture(image));
    }
    for mut window in &mut windows {
        window.resolution.set(w as f32, h as f32);
    }
    commands.spawn((
        DirectionalLight { shadow_maps_enabled: true, ..default() },
        Transform::from_xyz(0.6, 2.0, 1.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    let paint = |color| StandardMaterial { base_color: color, perceptual_roughness: 0.45, ..default() };
    let [red, white, blue] =
        [Color::srgb(0.75, 0.12, 0.08), Color::srgb(0.85, 0.82, 0.75), Color::srgb(0.1, 0.25, 0.65)]
            .map(|c| materials.add(paint(c)));
    let thing = commands.spawn((Thing, Transform::default(), Visibility::Hidden)).id();
    let mut part = |mesh: Mesh, material: Handle<StandardMaterial>, place: Transform| {
        commands.spawn((Mesh3d(meshes.add(mesh)), MeshMaterial3d(material), place, ChildOf(thing))).id()
    };
    part(Cylinder::new(0.16, 0.05).into(), white.clone(), Transform::from_xyz(0.0, 0.025, 0.0));
    part(Capsule3d::new(0.03, 0.4).into(), white, Transform::from_xyz(0.0, 0.25, 0.0));
    part(Sphere::new(0.11).into(), red.clone(), Transform::from_xyz(0.0, 0.55, 0.0));
    let turning = part(Torus::new(0.2, 0.26).into(), blue, Transform::from_xyz(0.0, 0.55, 0.0));
    let ball = part(Sphere::new(0.06).into(), red, Transform::from_xyz(0.3, 0.55, 0.0));
    commands.entity(turning).insert(Turning);
    commands.entity(ball).insert(Turning);
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::new(Vec3::Y, Vec2::splat(1.0)))),
        MeshMaterial3d(catchers.add(ShadowCatcher::default())),
        ChildOf(thing),
    ));
}

/// Puts the thing where the plane is, turns it, and lights it as the frame is lit.
fn animate(
    live: Res<LiveCamera>,
    mut thing: Single<(&mut Transform, &mut Visibility), With<Thing>>,
    mut turning: Query<&mut Transform, (With<Turning>, Without<Thing>)>,
    mut light: Single<&mut DirectionalLight>,
    mut ambient: ResMut<GlobalAmbientLight>,
) {
    let (place, visibility) = &mut *thing;
    let Some(now) = live.place() else { return };
    **place = now;
    **visibility = Visibility::Visible;
    let angle = 2.4 * live.frame() as f32 / live.fps() as f32;
    for mut part in &mut turning {
        let radius = part.translation.with_y(0.0).length();
        part.translation =
            Vec3::new(radius * (2.0 * angle).cos(), part.translation.y, radius * (2.0 * angle).sin());
        part.rotation = Quat::from_rotation_y(angle) * Quat::from_rotation_x(0.6);
    }
    // The light from all sides, cd/m^2, that makes 1 of white; from one direction, pi times as much in lux does.
    let full = Exposure::default().exposure().recip();
    let mean = live.light();
    let strength = (mean.red + mean.green + mean.blue) / 3.0;
    let color = Color::LinearRgba(if strength > 0.0 { mean * (1.0 / strength) } else { LinearRgba::WHITE });
    light.color = color;
    light.illuminance = 2.0 * DIRECT * strength * full * PI;
    ambient.color = color;
    ambient.brightness = (1.0 - DIRECT) * strength * full;
}

/// Says what the estimator says.
fn tell(mut events: MessageReader<LiveEvent>) {
    for event in events.read() {
        info!("{event:?}");
    }
}

fn keys(
    pressed: Res<ButtonInput<KeyCode>>,
    mut camera: Single<&mut MatchedCamera>,
    mut live: ResMut<LiveCamera>,
    mut paused: Local<bool>,
) {
    let along =
        f32::from(pressed.pressed(KeyCode::ArrowRight)) - f32::from(pressed.pressed(KeyCode::ArrowLeft));
    if along != 0.0 {
        camera.split = (camera.split + 0.02 * along).clamp(0.0, 1.0);
    }
    if pressed.just_pressed(KeyCode::KeyN) {
        camera.options.no_noise = !camera.options.no_noise;
    }
    if pressed.just_pressed(KeyCode::KeyB) {
        camera.options.bokeh = match camera.options.bokeh {
            Some(Bokeh::Disk) => Some(Bokeh::Gaussian),
            _ => Some(Bokeh::Disk),
        };
    }
    for (key, factor) in [(KeyCode::ArrowUp, 1.1), (KeyCode::ArrowDown, 1.0 / 1.1)] {
        if pressed.just_pressed(key) {
            live.home.distance = (live.home.distance * factor).clamp(0.1, 100.0);
        }
    }
    if pressed.just_pressed(KeyCode::Space) {
        *paused = !*paused;
        live.set_paused(*paused);
    }
}

/// The camera's numbers, or why they are unknown.
fn words(live: &LiveCamera) -> String {
    let Some(estimate) = live.estimate() else { return "nothing was estimated yet".into() };
    let camera = &estimate.tracked.camera;
    let exposure = match camera.motion_blur.known() {
        Some(m) => format!("exposure {:.2} {:?}", m.exposure.0, m.interval),
        None => "exposure unknown".into(),
    };
    let lens = match camera.defocus.known() {
        Some(lens) => format!("blur {:.1} px at infinity", lens.sigma_px(0.0)),
        None => "lens unknown".into(),
    };
    let noise = match camera.noise.known() {
        Some(noise) => format!("noise {:.4}", noise.total_std(0.5)[1]),
        None => "noise unknown".into(),
    };
    format!("frame {}: {exposure}, {lens}, {noise}", live.frame())
}

fn title(live: Res<LiveCamera>, mut window: Single<&mut Window>) {
    window.title = words(&live);
}

/// The memory that this process has, MB; `None` where the system does not tell it in Linux's way.
fn memory() -> Option<u64> {
    let pages = std::fs::read_to_string("/proc/self/statm").ok()?;
    let resident: u64 = pages.split_whitespace().nth(1)?.parse().ok()?;
    Some(resident * 4096 / 1_000_000)
}

/// Without a window: writes the last picture, and ends.
fn finish(
    mut commands: Commands,
    live: Res<LiveCamera>,
    arguments: Res<Arguments>,
    picture: Res<Picture>,
    capturing: Query<(), With<Capturing>>,
    mut since: Local<Option<(Instant, u64)>>,
    mut asked: Local<Option<u32>>,
    mut exit: MessageWriter<AppExit>,
) {
    let (start, before) = *since.get_or_insert((Instant::now(), live.frame()));
    let done = live.frame() - before;
    if asked.is_none() && done >= TELL {
        let ms = 1e3 * start.elapsed().as_secs_f64() / done as f64;
        let memory = memory().map_or(String::new(), |m| format!(", {m} MB"));
        println!("{}; {ms:.0} ms a frame{memory}", words(&live));
        *since = Some((Instant::now(), live.frame()));
    }
    match &mut *asked {
        None if live.frame() >= arguments.frames => {
            println!("{}", words(&live));
            let path = arguments.headless.clone().unwrap_or_default();
            commands.spawn(Screenshot::image(picture.0.clone())).observe(save_to_disk(path));
            *asked = Some(0);
        }
        // The picture comes a few frames later.
        Some(after) => {
            *after += 1;
            if *after > 5 && capturing.is_empty() {
                exit.write(AppExit::Success);
            }
        }
        None => {}
    }
}
