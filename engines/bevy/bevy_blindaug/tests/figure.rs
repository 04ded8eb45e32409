//! The walking figure of the example `mixed_reality`: Bevy loads it as glTF, and its skin moves.

mod common;
#[path = "../examples/mixed_reality/walker.rs"]
#[allow(dead_code, reason = "the length of a stride is the example's")]
mod walker;

use bevy::asset::io::embedded::EmbeddedAssetRegistry;
use bevy::prelude::*;
use bevy::world_serialization::{WorldAssetRoot, WorldInstanceReady};
use bevy_blindaug::MatchedCamera;
use blindaug::{Encoded, Raster};
use common::*;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const SIZE: [u32; 2] = [120, 160];

/// The moment of the walk, s.
#[derive(Resource)]
struct Moment(f32);

fn walk(moment: Res<Moment>, mut players: Query<&mut AnimationPlayer>) {
    for mut player in &mut players {
        for (_, active) in player.playing_animations_mut() {
            active.pause().seek_to(moment.0);
        }
    }
}

#[test]
fn the_figure_is_loaded_and_its_legs_move_with_known_motion() {
    if no_gpu() {
        return;
    }
    let mut app = app(Path::new("assets"));
    start(&mut app);
    app.insert_resource(Moment(0.0)).add_systems(Update, walk);
    let world = app.world_mut();
    let file = walker::glb();
    world.resource::<EmbeddedAssetRegistry>().insert_asset(PathBuf::new(), "walker.glb".as_ref(), file);
    let server = world.resource::<AssetServer>().clone();
    let figure = "embedded://walker.glb";
    let clip = server.load(GltfAssetLabel::Animation(0).from_asset(figure));
    let (graph, node) = AnimationGraph::from_clip(clip);
    let graph = world.resource_mut::<Assets<AnimationGraph>>().add(graph);
    let mut images = world.resource_mut::<Assets<Image>>();
    let grey = Encoded(Raster::filled(SIZE[0] as usize, SIZE[1] as usize, [0.25; 3]));
    let background = images.add(picture(&grey));
    let (output, target) = target(&mut images, SIZE);
    let above = Transform::from_xyz(0.0, 0.33, 1.2);
    world.spawn((MatchedCamera { background, ..default() }, above, Msaa::Off, target));
    world.insert_resource(GlobalAmbientLight { brightness: 800.0, ..default() });
    let scene = WorldAssetRoot(server.load(GltfAssetLabel::Scene(0).from_asset(figure)));
    let begin = move |ready: On<WorldInstanceReady>,
                      mut commands: Commands,
                      children: Query<&Children>,
                      mut players: Query<&mut AnimationPlayer>| {
        for child in children.iter_descendants(ready.entity) {
            if let Ok(mut player) = players.get_mut(child) {
                player.play(node);
                commands.entity(child).insert(AnimationGraphHandle(graph.clone()));
            }
        }
    };
    // Seen from its left.
    world.spawn((scene, Transform::from_rotation(Quat::from_rotation_y(-1.57)))).observe(begin);
    world.flush();

    let covered = |app: &mut App| layer(app).1.color.0.data().iter().filter(|c| c[3] > 0.5).count();
    let started = Instant::now();
    app.update();
    while covered(&mut app) == 0 {
        assert!(started.elapsed() < Duration::from_secs(300), "the figure was not loaded");
        app.update();
        std::thread::sleep(Duration::from_millis(5));
    }
    let mut at = |share: f32| {
        app.insert_resource(Moment(share * walker::CYCLE));
        (0..4).for_each(|_| app.update());
        read(&app, &output)
    };
    // The legs are together twice in a cycle, and apart in between.
    let [together, apart, again] = [at(0.0), at(0.25), at(0.0)];
    keep("figure.png", &apart);
    assert!(difference(&together, &again) < 1e-4);
    assert!(difference(&together, &apart) > 0.03, "{}", difference(&together, &apart));
    let width = |image: &Raster<[f32; 3]>| {
        // The columns of the picture's lower third that show anything but the frame.
        let rows = || SIZE[1] as usize * 3 / 5..SIZE[1] as usize;
        let seen = |x: usize| rows().any(|y| (image.at(x, y)[0] - 0.25).abs() > 0.02);
        (0..SIZE[0] as usize).filter(|&x| seen(x)).count()
    };
    println!("legs: {} px wide together, {} px apart", width(&together), width(&apart));
    assert!(width(&apart) > width(&together) + 8);
    // From one moment to the next the legs have motion; when nothing moves, they have none.
    let fastest = |app: &mut App| {
        let flow = layer(app).1.flow.unwrap();
        flow.data().iter().filter(|v| v[0].is_finite()).map(|v| v[0].hypot(v[1])).fold(0.0, f32::max)
    };
    assert!(fastest(&mut app) < 0.01);
    app.insert_resource(Moment(0.06 * walker::CYCLE));
    app.update();
    let moved = fastest(&mut app);
    println!("{moved} px in a frame");
    assert!((2.0..20.0).contains(&moved), "{moved}");
}
