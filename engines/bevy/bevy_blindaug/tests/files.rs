//! camera.json while the app runs: loaded, changed, broken, missing.

mod common;

use bevy::prelude::*;
use bevy_blindaug::{CameraInUse, CameraProblem, FilmedCamera, MatchedCamera};
use blindaug::composite::CompositeOptions;
use blindaug::model::{Capture, DefocusModel, Estimate};
use blindaug::{CameraModel, Encoded, Raster};
use common::*;
use std::path::Path;
use std::time::{Duration, Instant};

const SIZE: [u32; 2] = [96, 72];

fn camera(sigma: f32) -> CameraModel {
    let capture = Capture {
        width: SIZE[0] as usize,
        height: SIZE[1] as usize,
        fps: None,
        frames_used: 1,
        pixel_aspect: 1.0,
    };
    let mut camera = CameraModel::unknown(capture, "not given");
    camera.defocus = Estimate::Known(DefocusModel::given_lens(sigma, 0.1));
    camera
}

/// A white square 2 m away over grey, through the model of a file.
fn scene(assets: &Path) -> (App, Handle<Image>) {
    let mut app = app(assets);
    start(&mut app);
    let world = app.world_mut();
    let model = world.resource::<AssetServer>().load::<FilmedCamera>("camera.json");
    let mut images = world.resource_mut::<Assets<Image>>();
    let grey = Encoded(Raster::filled(SIZE[0] as usize, SIZE[1] as usize, [0.25; 3]));
    let background = images.add(picture(&grey));
    let (output, target) = target(&mut images, SIZE);
    let options = CompositeOptions { no_noise: true, ..default() };
    // Without samples, the square's edges are hard.
    world.spawn((MatchedCamera { model, background, options, ..default() }, Msaa::Off, target));
    let mesh = world.resource_mut::<Assets<Mesh>>().add(Rectangle::new(0.7, 0.7));
    let white = StandardMaterial { base_color: Color::WHITE, unlit: true, ..default() };
    let material = world.resource_mut::<Assets<StandardMaterial>>().add(white);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(material), Transform::from_xyz(0.0, 0.0, -2.0)));
    (app, output)
}

/// Updates until something holds of the app, for at most two minutes; then a few times more, so that the picture shows it.
fn update_until(app: &mut App, mut holds: impl FnMut(&mut App) -> bool) {
    let start = Instant::now();
    while !holds(app) {
        assert!(start.elapsed() < Duration::from_secs(120), "it took too long");
        app.update();
        std::thread::sleep(Duration::from_millis(5));
    }
    (0..4).for_each(|_| app.update());
}

fn in_use(app: &mut App) -> CameraInUse {
    let world = app.world_mut();
    world.query::<&CameraInUse>().single(world).unwrap().clone()
}

/// The problems that were said since the last call.
fn problems(app: &mut App) -> Vec<String> {
    let mut messages = app.world_mut().resource_mut::<Messages<CameraProblem>>();
    messages.drain().map(|p| p.sentence).collect()
}

/// The number of pixels between the square's white and the frame's grey.
fn soft(picture: &Raster<[f32; 3]>) -> usize {
    picture.data().iter().filter(|v| (0.3..0.95).contains(&v[1])).count()
}

#[test]
fn a_file_that_changes_takes_effect_and_a_broken_one_is_said_once() {
    if no_gpu() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("camera.json");
    let write = |text: &str| std::fs::write(&file, text).unwrap();
    write(&camera(2.0).to_json());
    let (mut app, output) = scene(folder.path());
    let sigma = |app: &mut App| {
        let model = in_use(app).model?;
        model.defocus.known().map(|lens| lens.sigma_px(0.0))
    };
    update_until(&mut app, |app| sigma(app) == Some(2.0));
    let little = read(&app, &output);
    assert_eq!(problems(&mut app), [""; 0]);

    write(&camera(5.0).to_json());
    update_until(&mut app, |app| sigma(app) == Some(5.0));
    let much = read(&app, &output);
    println!("{} and {} soft pixels", soft(&little), soft(&much));
    assert!(soft(&little) > 100 && soft(&much) as f32 > 1.3 * soft(&little) as f32);

    // A camera over time is a file, too.
    let line = |frame: u64, sigma| {
        let tracked = blindaug::model::TrackedCamera { frame, changed: default(), camera: camera(sigma) };
        tracked.to_json_line()
    };
    write(&format!("{}\n{}\n", line(0, 3.0), line(10, 4.0)));
    update_until(&mut app, |app| sigma(app) == Some(3.0));
    let world = app.world_mut();
    world.query::<&mut MatchedCamera>().single_mut(world).unwrap().frame = 10;
    update_until(&mut app, |app| sigma(app) == Some(4.0));
    assert_eq!(problems(&mut app), [""; 0]);

    for (bad, word) in [
        (camera(5.0).to_json().replace("\"version\": 1", "\"version\": 99"), "newer"),
        ("{ \"format\": \"blindaug".into(), "not a camera model"),
    ] {
        write(&bad);
        update_until(&mut app, |app| in_use(app).problem.is_some_and(|p| p.contains(word)));
        (0..20).for_each(|_| app.update());
        // Messages live for two updates, and nothing was said in the last ones.
        assert_eq!(problems(&mut app), [""; 0]);
        assert!(in_use(&mut app).model.is_none());
        let pasted = read(&app, &output);
        assert_eq!(soft(&pasted), 0);
    }
    // What is mended is applied again.
    write(&camera(2.0).to_json());
    update_until(&mut app, |app| sigma(app) == Some(2.0));
    assert!(difference(&read(&app, &output), &little) < 0.001);
    assert!(in_use(&mut app).problem.is_none());
}

/// Counts what is said.
#[derive(Resource, Default)]
struct Said(Vec<String>);

fn listen(mut messages: MessageReader<CameraProblem>, mut said: ResMut<Said>) {
    said.0.extend(messages.read().map(|p| p.sentence.clone()));
}

#[test]
fn a_file_that_is_missing_or_broken_is_said_once_and_nothing_is_distorted() {
    if no_gpu() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("camera.json");
    for (text, word) in [(None, "cannot be read"), (Some("nonsense"), "not a camera model")] {
        if let Some(text) = text {
            std::fs::write(&file, text).unwrap();
        }
        let (mut app, output) = scene(folder.path());
        app.init_resource::<Said>().add_systems(Last, listen);
        update_until(&mut app, |app| !app.world().resource::<Said>().0.is_empty());
        (0..20).for_each(|_| app.update());
        let said = &app.world().resource::<Said>().0;
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(
            said[0].contains("camera.json") && said[0].contains(word) && !said[0].contains('\n'),
            "{said:?}"
        );
        assert!(said[0].contains("undistorted"), "{said:?}");
        let pasted = read(&app, &output);
        assert_eq!(soft(&pasted), 0);
        // The square is there, and so is the frame.
        let [middle, corner] = [pasted.at(48, 36)[1], pasted.at(2, 2)[1]];
        assert!(middle > 0.99 && (corner - 0.25).abs() < 0.003, "{middle} {corner}");
    }
    // Negative control: a camera is no problem, and distorts.
    std::fs::write(&file, camera(5.0).to_json()).unwrap();
    let (mut app, output) = scene(folder.path());
    app.init_resource::<Said>().add_systems(Last, listen);
    update_until(&mut app, |app| in_use(app).model.is_some());
    assert!(app.world().resource::<Said>().0.is_empty());
    assert!(soft(&read(&app, &output)) > 100);
}
