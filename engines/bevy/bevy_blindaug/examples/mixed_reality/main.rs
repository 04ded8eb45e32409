//! A virtual figure that walks in a video or in front of a camera, as that camera would have filmed it, with everything estimated while it
//! plays.
//!
//!     cargo run --release --example mixed_reality -- clip.mp4
//!     cargo run --release --example mixed_reality -- camera:0
//!     cargo run --release --example mixed_reality -- clip.mp4 --headless picture.png --frames 60
//!
//! The line is dragged with the mouse, or moved by the keys left and right: left of it the figure is pasted on as it is. The sliders set
//! exposure, focus, blur and noise by hand; R returns to what is estimated. N leaves the noise out, B changes the shape of out-of-focus
//! points, up and down move the figure away and nearer, space stops the frame. Without a window, --by-hand EXPOSURE,FOCUS,BLUR,NOISE sets
//! what the sliders set (m, px, a factor).

mod panel;
mod walker;

use bevy::app::{AppExit, ScheduleRunnerPlugin};
use bevy::asset::io::embedded::EmbeddedAssetRegistry;
use bevy::camera::visibility::NoFrustumCulling;
use bevy::camera::{Exposure, RenderTarget};
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::view::screenshot::{Capturing, Screenshot, save_to_disk};
use bevy::time::TimeUpdateStrategy;
use bevy::ui::IsDefaultUiCamera;
use bevy::window::{ExitCondition, WindowResolution};
use bevy::winit::{UpdateMode, WinitPlugin, WinitSettings};
use bevy::world_serialization::{WorldAssetRoot, WorldInstanceReady};
use bevy_blindaug::{
    BlindaugPlugin, ByHand, FilmedCamera, LiveCamera, LiveEvent, LiveOptions, MatchedCamera, ShadowCatcher,
};
use blindaug::model::ExposureFraction;
use blindaug::synth::defocus::Bokeh;
use std::f32::consts::{FRAC_PI_2, PI};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};
use wgpu::{TextureFormat, TextureUsages};

/// The frames between two lines about time and memory.
const TELL: u64 = 100;
/// The share of a frame's mean light that comes from one direction, from above.
const DIRECT: f32 = 0.65;
/// The radius of the circle in which the figure walks, m.
const RADIUS: f32 = 0.3;

/// What the command line says.
#[derive(Resource, Clone)]
struct Arguments {
    input: PathBuf,
    headless: Option<PathBuf>,
    frames: u64,
    split: f32,
    by_hand: ByHand,
}

impl Arguments {
    /// Reads the command line.
    ///
    /// # Errors
    /// If it makes no sense: one sentence.
    fn read() -> Result<Self, String> {
        let mut read = Self {
            input: PathBuf::new(),
            headless: None,
            frames: 60,
            split: 0.5,
            by_hand: ByHand::default(),
        };
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
                "--by-hand" => {
                    let value = value()?;
                    let numbers: Option<Vec<f32>> = value.split(',').map(|n| n.parse().ok()).collect();
                    let Some(&[exposure, focus, blur, noise]) = numbers.as_deref() else {
                        return Err("--by-hand needs EXPOSURE,FOCUS,BLUR,NOISE, such as 0.5,2,3,1".into());
                    };
                    read.by_hand = ByHand {
                        exposure: Some(ExposureFraction(exposure)),
                        focus_m: Some(focus),
                        blur_px: Some(blur),
                        grain: Some(noise),
                        ..ByHand::default()
                    };
                }
                _ if word.starts_with("--") => {
                    return Err(format!(
                        "{word} is no option; there are --headless PICTURE, --frames N, --split SHARE and --by-hand"
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
            .add_systems(Update, (keys, drag, title));
    }
    app.add_plugins(BlindaugPlugin)
        .add_systems(Startup, setup)
        .add_systems(Update, (animate, tell, panel::show));
    app.world_mut().resource::<EmbeddedAssetRegistry>().insert_asset(
        PathBuf::new(),
        "walker.glb".as_ref(),
        walker::glb(),
    );
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

/// The middle of the figure's circle on the plane.
#[derive(Component)]
struct Place;

/// The figure.
#[derive(Component)]
struct Walker;

fn setup(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut graphs: ResMut<Assets<AnimationGraph>>,
    assets: Res<AssetServer>,
    mut catchers: ResMut<Assets<ShadowCatcher>>,
    mut images: ResMut<Assets<Image>>,
    mut windows: Query<&mut Window>,
    live: Res<LiveCamera>,
    arguments: Res<Arguments>,
) {
    let (w, h) = live.size();
    let mut camera = commands.spawn((
        MatchedCamera {
            background: live.background.clone(),
            split: arguments.split,
            by_hand: arguments.by_hand,
            ..default()
        },
        IsDefaultUiCamera,
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
    let figure = "embedded://walker.glb";
    let (graph, walk) =
        AnimationGraph::from_clip(assets.load(GltfAssetLabel::Animation(0).from_asset(figure)));
    let graph = graphs.add(graph);
    let place = commands.spawn((Place, Transform::default(), Visibility::Hidden)).id();
    let scene = WorldAssetRoot(assets.load(GltfAssetLabel::Scene(0).from_asset(figure)));
    let start = move |ready: On<WorldInstanceReady>,
                      mut commands: Commands,
                      children: Query<&Children>,
                      mut players: Query<&mut AnimationPlayer>| {
        for child in children.iter_descendants(ready.entity) {
            // Skinned meshes are not where their bounds at rest are.
            commands.entity(child).insert(NoFrustumCulling);
            if let Ok(mut player) = players.get_mut(child) {
                player.play(walk).repeat();
                commands.entity(child).insert(AnimationGraphHandle(graph.clone()));
            }
        }
    };
    commands.spawn((Walker, Transform::default(), scene, ChildOf(place))).observe(start);
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::new(Vec3::Y, Vec2::splat(1.0)))),
        MeshMaterial3d(catchers.add(ShadowCatcher::default())),
        ChildOf(place),
    ));
    panel::spawn(&mut commands);
}

/// Puts the figure on the plane and lets it walk there in a circle, and lights it as the frame is lit.
fn animate(
    live: Res<LiveCamera>,
    mut place: Single<(&mut Transform, &mut Visibility), With<Place>>,
    mut walker: Single<&mut Transform, (With<Walker>, Without<Place>)>,
    mut players: Query<&mut AnimationPlayer>,
    mut light: Single<&mut DirectionalLight>,
    mut ambient: ResMut<GlobalAmbientLight>,
) {
    let (at, visibility) = &mut *place;
    let Some(now) = live.place() else { return };
    **at = now;
    **visibility = Visibility::Visible;
    // The figure walks with the frames, so that it stops where the picture stops.
    let seconds = live.frame() as f32 / live.fps() as f32;
    let angle = seconds * walker::STRIDE / walker::CYCLE / RADIUS;
    walker.translation = RADIUS * Vec3::new(angle.sin(), 0.0, angle.cos());
    walker.rotation = Quat::from_rotation_y(angle + FRAC_PI_2);
    for mut player in &mut players {
        for (_, active) in player.playing_animations_mut() {
            active.pause().seek_to(seconds % walker::CYCLE);
        }
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
    if pressed.just_pressed(KeyCode::KeyR) {
        camera.by_hand = ByHand::default();
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

/// Moves the line to the mouse while its left button is held above the panel.
fn drag(
    pressed: Res<ButtonInput<MouseButton>>,
    window: Single<&Window>,
    mut camera: Single<&mut MatchedCamera>,
) {
    if let Some(at) = window.cursor_position().filter(|_| pressed.pressed(MouseButton::Left))
        && at.y < window.height() - panel::HEIGHT
    {
        camera.split = at.x / window.width();
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
