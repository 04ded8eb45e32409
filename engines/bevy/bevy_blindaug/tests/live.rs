//! A clip that plays behind the virtual things, and is estimated meanwhile.

mod common;

use bevy::prelude::*;
use bevy_blindaug::{FilmedCamera, LiveCamera, LiveEvent, LiveOptions, MatchedCamera};
use blindaug::{Encoded, Raster};
use common::*;
use std::path::Path;
use std::time::{Duration, Instant};

const SIZE: [u32; 2] = [128, 96];
const FRAMES: u32 = 4;

/// A textured wall with noise, which moves by 2 px a frame.
fn filmed(number: u32) -> Encoded {
    let hash = |x: u32, y: u32, seed: u32| {
        let mut v =
            x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b) ^ seed.wrapping_mul(0xc2b2_ae35);
        v = (v ^ (v >> 15)).wrapping_mul(0x2c1b_3c6d);
        v = (v ^ (v >> 12)).wrapping_mul(0x297a_2d39);
        ((v ^ (v >> 15)) >> 8) as f32 / 16_777_216.0
    };
    Encoded(Raster::from_fn(SIZE[0] as usize, SIZE[1] as usize, |x, y| {
        let (x, y) = (x as u32, y as u32);
        let at = x + 2 * number;
        let wall = 0.3 + 0.2 * hash(at / 3, y / 3, 1) + 0.15 * hash(at / 11, y / 7, 2);
        std::array::from_fn(|c| {
            let noise = 0.05 * (hash(x, y, 17 * number + c as u32 + 5) - 0.5);
            ((wall + noise).clamp(0.0, 1.0) * 255.0).round() / 255.0
        })
    }))
}

/// A folder with a clip.
fn clip() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for number in 1..=FRAMES {
        blindaug_io::write_png(folder.path().join(format!("{number}.png")), &filmed(number)).unwrap();
    }
    folder
}

/// What happened.
#[derive(Resource, Default)]
struct Happened(Vec<LiveEvent>);

fn listen(mut events: MessageReader<LiveEvent>, mut happened: ResMut<Happened>) {
    happened.0.extend(events.read().cloned());
}

/// An app that plays a clip, and the picture of its camera.
fn playing(folder: &Path, every_frame: bool) -> (App, Handle<Image>) {
    let mut app = app(Path::new("assets"));
    start(&mut app);
    app.init_resource::<Happened>().add_systems(Last, listen);
    let world = app.world_mut();
    let options = LiveOptions { every_frame, ..default() };
    let live = world.resource_scope(|world, mut images: Mut<Assets<Image>>| {
        let mut models = world.resource_mut::<Assets<FilmedCamera>>();
        LiveCamera::open(folder, &options, &mut images, &mut models).unwrap()
    });
    let (output, target) = target(&mut world.resource_mut::<Assets<Image>>(), SIZE);
    let projection = Projection::Perspective(live.projection());
    world.spawn((MatchedCamera { background: live.background.clone(), ..default() }, projection, target));
    world.insert_resource(live);
    (app, output)
}

#[test]
fn every_frame_is_shown_and_estimated_in_its_turn() {
    if no_gpu() {
        return;
    }
    let folder = clip();
    let run = || {
        let (mut app, output) = playing(folder.path(), true);
        for update in 1..=2 * u64::from(FRAMES) {
            app.update();
            let live = app.world().resource::<LiveCamera>();
            assert_eq!((live.frame(), live.estimate().unwrap().tracked.frame), (update, update));
            assert_eq!(live.size(), (SIZE[0] as usize, SIZE[1] as usize));
            assert!(live.place().is_some());
            // The picture shows the frame of this update; the clip has started again after its last one.
            let shown = read(&app, &output);
            let number = (update as u32 - 1) % FRAMES + 1;
            let [right, wrong] = [number, number % FRAMES + 1].map(|n| difference(&shown, &filmed(n).0));
            // Bevy's renderer needs the first updates to begin.
            if update > 2 {
                assert!(right < 0.001 && wrong > 0.03, "update {update}: {right} {wrong}");
            }
        }
        let world = app.world_mut();
        let matched = world.query::<&MatchedCamera>().single(world).unwrap().clone();
        let live = world.resource::<LiveCamera>();
        assert_eq!((matched.frame, &matched.model), (2 * u64::from(FRAMES), &live.model));
        let camera = live.estimate().unwrap().tracked.camera.clone();
        let models = world.resource::<Assets<FilmedCamera>>();
        let Some(FilmedCamera(Ok(track))) = models.get(&matched.model) else { panic!("there is a model") };
        assert_eq!(track.at(0).noise, camera.noise);
        camera
    };
    let camera = run();
    // Uniform noise of width 0.05 has a std of 0.014.
    let noise = camera.noise.known().expect("the noise is seen").total_std(0.45)[1];
    println!("noise {noise}");
    assert!((0.009..0.022).contains(&noise), "{noise}");
    // What is unknown has a reason.
    for part in blindaug::model::Distortion::ALL {
        assert!(camera.why_unknown(part).is_none_or(|why| !why.sentence.is_empty()));
    }
    assert_eq!(run(), camera, "a run repeats");
}

#[test]
fn a_clip_plays_at_its_own_pace_and_stands_still_when_it_is_told() {
    if no_gpu() {
        return;
    }
    let folder = clip();
    let start = Instant::now();
    let (mut app, _) = playing(folder.path(), false);
    let frame = |app: &App| app.world().resource::<LiveCamera>().frame();
    // Updates until something holds of the frame's number, for at most a minute.
    let until = |app: &mut App, holds: &dyn Fn(u64) -> bool| {
        let start = Instant::now();
        while !holds(frame(app)) {
            assert!(start.elapsed() < Duration::from_secs(300), "frame {} is shown too long", frame(app));
            app.update();
        }
    };
    until(&mut app, &|frame| frame >= 3);
    // Thirty frames a second, and the first one at once.
    assert!(frame(&app) as f64 <= 30.0 * start.elapsed().as_secs_f64() + 1.0);
    app.world().resource::<LiveCamera>().set_paused(true);
    // The frame whose estimate is waited for still comes.
    let estimated = |app: &App| app.world().resource::<LiveCamera>().is_idle();
    let rest = |app: &mut App| {
        for _ in 0..8 {
            app.update();
            std::thread::sleep(Duration::from_millis(50));
        }
        frame(app)
    };
    let start = Instant::now();
    while !estimated(&app) && start.elapsed() < Duration::from_secs(300) {
        rest(&mut app);
    }
    let paused = rest(&mut app);
    assert_eq!(rest(&mut app), paused);
    app.world().resource::<LiveCamera>().set_paused(false);
    until(&mut app, &|frame| frame > paused);
}

#[test]
fn footage_that_ends_is_said_once_and_the_last_frame_stays() {
    if no_gpu() {
        return;
    }
    let folder = clip();
    let (mut app, _) = playing(folder.path(), true);
    app.update();
    for number in 1..=FRAMES {
        std::fs::write(folder.path().join(format!("{number}.png")), "no picture").unwrap();
    }
    (0..3 * FRAMES).for_each(|_| app.update());
    let ended: Vec<_> =
        app.world().resource::<Happened>().0.iter().filter(|e| matches!(e, LiveEvent::Ended(_))).collect();
    let [LiveEvent::Ended(sentence)] = ended[..] else { panic!("{ended:?}") };
    assert!(sentence.contains(".png") && !sentence.contains('\n'), "{sentence}");
    assert!(app.world().resource::<LiveCamera>().frame() >= 1);
    // What is not there at all is an error at once.
    let world = app.world_mut();
    let missing = world.resource_scope(|world, mut images: Mut<Assets<Image>>| {
        let mut models = world.resource_mut::<Assets<FilmedCamera>>();
        LiveCamera::open("no-such-clip.mp4", &LiveOptions::default(), &mut images, &mut models).err()
    });
    assert!(missing.unwrap().to_string().contains("no-such-clip.mp4"));
}
