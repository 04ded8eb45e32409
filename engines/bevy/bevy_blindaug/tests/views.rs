//! Pictures that Bevy renders without a window, against blindaug's reference on the CPU.

mod common;

use bevy::camera::{ManualTextureViewHandle, RenderTarget};
use bevy::prelude::*;
use bevy::render::texture::{ManualTextureView, ManualTextureViews};
use bevy_blindaug::{FilmedCamera, MatchedCamera, Occluder, ShadowCatcher};
use blindaug::composite::{self, CompositeOptions, Plate, VirtualLayer};
use blindaug::model::{
    Capture, DefocusModel, Estimate, ExposureFraction, MotionBlurModel, NOISE_LEVELS, NoiseLevel, NoiseModel,
};
use blindaug::{CameraModel, Encoded, Raster};
use common::*;
use std::path::Path;

/// The size of the view, px.
const SIZE: [u32; 2] = [160, 120];
/// The vertical field of view, rad.
const FOV: f32 = 0.8;
/// The way of the moving things in a frame, m: to the right and up.
const WAY: Vec3 = Vec3::new(0.2, 0.08, 0.0);
/// The place of the moving things before the first frame, m: after twelve frames they are in the middle of the view.
const START: Vec3 = Vec3::new(-2.58, -1.0, -2.5);

/// A thing that moves by `WAY` in each frame.
#[derive(Component)]
struct Moving;

fn step(mut moving: Query<&mut Transform, With<Moving>>) {
    for mut place in &mut moving {
        place.translation += WAY;
    }
}

fn camera(exposure: f32, sigma: f32, focus: f32, noise: f32) -> CameraModel {
    let capture = Capture {
        width: SIZE[0] as usize,
        height: SIZE[1] as usize,
        fps: None,
        frames_used: 1,
        pixel_aspect: 1.0,
    };
    let mut camera = CameraModel::unknown(capture, "not given");
    camera.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(exposure)));
    camera.defocus = Estimate::Known(DefocusModel::given_lens(sigma, focus));
    let level = NoiseLevel { slope: [0.0; 3], intercept: [noise; 3] };
    camera.noise = Estimate::Known(NoiseModel::given([level; NOISE_LEVELS], 1.0));
    camera
}

/// The camera of most tests: 6 px of blur at infinity, in focus at 2.9 m.
fn usual() -> CameraModel {
    camera(0.6, 6.0, 0.35, 0.0)
}

fn frame() -> Encoded {
    Encoded(Raster::from_fn(SIZE[0] as usize, SIZE[1] as usize, |x, y| {
        let v = 0.45 + 0.25 * (0.13 * x as f32).sin() * (0.09 * y as f32).cos();
        [v, 0.8 * v + 0.1, 1.0 - v].map(|v| (v * 255.0).round() / 255.0)
    }))
}

/// A scene with a moving ball at 2.5 m, a still box at 4 m and a pane of glass at 2 m.
fn spawn_things(
    commands: &mut Commands,
    meshes: &mut Assets<Mesh>,
    materials: &mut Assets<StandardMaterial>,
) {
    let material = |color, alpha_mode| StandardMaterial {
        base_color: color,
        alpha_mode,
        perceptual_roughness: 0.6,
        ..default()
    };
    commands.spawn((
        Mesh3d(meshes.add(Sphere::new(0.35))),
        MeshMaterial3d(materials.add(material(Color::srgb(0.8, 0.2, 0.1), AlphaMode::Opaque))),
        Transform::from_translation(START),
        Moving,
    ));
    commands.spawn((
        Mesh3d(meshes.add(Cuboid::new(0.9, 0.9, 0.1))),
        MeshMaterial3d(materials.add(material(Color::srgb(0.1, 0.5, 0.8), AlphaMode::Opaque))),
        Transform::from_xyz(0.6, 0.3, -4.0).with_rotation(Quat::from_rotation_z(0.3)),
    ));
    commands.spawn((
        Mesh3d(meshes.add(Rectangle::new(0.4, 0.4))),
        MeshMaterial3d(materials.add(material(Color::srgba(0.9, 0.9, 0.2, 0.5), AlphaMode::Blend))),
        Transform::from_xyz(0.2, -0.4, -2.0),
    ));
    commands.spawn((
        DirectionalLight { illuminance: 6000.0, ..default() },
        Transform::from_xyz(1.0, 2.0, 2.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

/// What of the camera's options differs from test to test.
struct Setup {
    matched: MatchedCamera,
    msaa: Msaa,
}

/// The scene seen by a camera, with the picture that it renders to.
fn scene(assets: &Path, setup: impl FnOnce(&mut World) -> Setup) -> (App, Handle<Image>) {
    let mut app = app(assets);
    start(&mut app);
    app.add_systems(Update, step);
    let world = app.world_mut();
    let Setup { matched, msaa } = setup(world);
    let mut images = world.resource_mut::<Assets<Image>>();
    let background = images.add(picture(&frame()));
    let (output, target) = target(&mut images, SIZE);
    world.spawn((
        MatchedCamera { background, ..matched },
        Camera3d::default(),
        Projection::Perspective(PerspectiveProjection { fov: FOV, ..default() }),
        target,
        msaa,
    ));
    world.resource_scope(|world, mut meshes: Mut<Assets<Mesh>>| {
        world.resource_scope(|world, mut materials: Mut<Assets<StandardMaterial>>| {
            spawn_things(&mut world.commands(), &mut meshes, &mut materials);
        });
    });
    world.flush();
    (app, output)
}

/// The scene with a model that is there at once.
fn scene_of(model: CameraModel, msaa: Msaa, options: CompositeOptions) -> (App, Handle<Image>) {
    scene(Path::new("assets"), |world| {
        let model = world.resource_mut::<Assets<FilmedCamera>>().add(FilmedCamera::from(model));
        Setup { matched: MatchedCamera { model, options, frame: 3, ..default() }, msaa }
    })
}

fn update(app: &mut App, times: usize) {
    (0..times).for_each(|_| app.update());
}

/// The reference's composite of what the view was composited from.
fn reference(frame: &Encoded, layer: &VirtualLayer, model: &CameraModel, naive: bool) -> Raster<[f32; 3]> {
    let plate = Plate::new(frame, 3);
    let options = CompositeOptions { naive, no_noise: true, ..default() };
    composite::composite(&plate, layer, model, &options).unwrap().0
}

/// The tolerance of the picture: that of the GPU's blur in high quality (docs/gpu.md), and rounding to 8 bits.
const TOLERANCE: f32 = 0.002 + 0.0012;

#[test]
fn the_picture_is_the_reference_s() {
    if no_gpu() {
        return;
    }
    let without_noise = CompositeOptions { no_noise: true, ..default() };
    for msaa in [Msaa::Off, Msaa::Sample4] {
        let (mut app, output) = scene_of(usual(), msaa, without_noise);
        update(&mut app, 12);
        let got = read(&app, &output);
        let (behind, layer) = layer(&mut app);
        keep(&format!("reference-{}.png", msaa.samples()), &got);
        assert_eq!(behind, frame(), "the frame has passed through the device");
        let right = difference(&got, &reference(&behind, &layer, &usual(), false));
        let wrong = [camera(1.0, 6.0, 0.35, 0.0), camera(0.6, 9.0, 0.35, 0.0), camera(0.6, 6.0, 0.25, 0.0)]
            .map(|model| difference(&got, &reference(&behind, &layer, &model, false)));
        let naive = difference(&got, &reference(&behind, &layer, &usual(), true));
        println!("{msaa:?}: {right}; other cameras {wrong:?}; naive {naive}");
        assert!(right < TOLERANCE, "{right}");
        assert!(wrong.into_iter().chain([naive]).all(|d| d > 1.5 * TOLERANCE), "{wrong:?} {naive}");
        // A wrong layer is found out as well: this one moves to the other side.
        let flow = layer.flow.as_ref().map(|f| f.map(|[u, v]| [-v, u]));
        let turned = VirtualLayer { flow, ..layer };
        assert!(difference(&got, &reference(&behind, &turned, &usual(), false)) > 1.5 * TOLERANCE);
    }
}

#[test]
fn noise_is_added_with_the_model_s_strength() {
    if no_gpu() {
        return;
    }
    // Noise of 0.02 in each octave makes the whole: the octaves' noises are added.
    let of = |noise: f32, frame: u64| {
        let model = camera(0.6, 6.0, 0.35, noise);
        let (mut app, output) = scene_of(model, Msaa::Off, CompositeOptions::default());
        let world = app.world_mut();
        world.query::<&mut MatchedCamera>().single_mut(world).unwrap().frame = frame;
        update(&mut app, 12);
        read(&app, &output)
    };
    // The middle of the box, which is opaque.
    let part = |image: &Raster<[f32; 3]>| image.crop(96, 36, 20, 20);
    let clean = part(&of(0.0, 3));
    let std = |noise, frame| difference(&part(&of(noise, frame)), &clean);
    let model = camera(0.6, 6.0, 0.35, 0.02);
    let want = model.noise.known().unwrap().total_std(0.5)[1];
    let [got, other] = [std(0.02, 3), std(0.02, 4)];
    println!("std {got} and {other} for {want}");
    assert!((got / want - 1.0).abs() < 0.25 && (other / want - 1.0).abs() < 0.25);
    assert!(std(0.04, 3) > 1.5 * want, "twice the noise is found out");
    // Each frame has noise of its own.
    assert!(difference(&part(&of(0.02, 3)), &part(&of(0.02, 4))) > want);
}

#[test]
fn depth_and_motion_are_those_of_the_scene() {
    if no_gpu() {
        return;
    }
    for (msaa, frame_interval) in [(Msaa::Off, 1.0), (Msaa::Sample4, 2.0)] {
        let (mut app, _) = scene(Path::new("assets"), |_| Setup {
            matched: MatchedCamera { frame_interval, ..default() },
            msaa,
        });
        update(&mut app, 12);
        let (_, layer) = layer(&mut app);
        let (depth, flow) = (layer.inverse_depth.unwrap(), layer.flow.unwrap());
        // After 12 frames, the ball's centre is here; its front is a radius nearer.
        let place = START + 12.0 * WAY;
        let focal = 0.5 * SIZE[1] as f32 / (0.5 * FOV).tan();
        let seen =
            focal * Vec2::new(place.x, -place.y) / -place.z + 0.5 * Vec2::new(SIZE[0] as f32, SIZE[1] as f32);
        let at = (seen.x as usize, seen.y as usize);
        let front = 1.0 / (place.length() - 0.35);
        let got = (depth.at(at.0, at.1), flow.at(at.0, at.1));
        let want = [WAY.x, -WAY.y].map(|v| frame_interval * focal * v * front);
        println!("{msaa:?} at {at:?}: depth {} for {front}, motion {:?} for {want:?}", got.0, got.1);
        assert!((got.0 / front - 1.0).abs() < 0.03);
        assert!((got.1[0] / want[0] - 1.0).abs() < 0.05 && (got.1[1] / want[1] - 1.0).abs() < 0.05);
        // The box stands still, and what nothing was drawn on is unknown.
        let on_box = (105, 50);
        assert!((depth.at(on_box.0, on_box.1) - 0.25).abs() < 0.01, "{}", depth.at(on_box.0, on_box.1));
        assert!(flow.at(on_box.0, on_box.1).iter().all(|v| v.abs() < 0.01));
        assert!(depth.at(2, 2).is_nan() && flow.at(2, 2)[0].is_nan());
    }
}

/// The texture of a headset, with a layer for each eye.
fn headset(app: &App) -> wgpu::Texture {
    gpu(app).device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width: SIZE[0], height: SIZE[1], depth_or_array_layers: 2 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba8UnormSrgb,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}

#[test]
fn each_eye_s_layer_is_what_a_camera_alone_shows() {
    if no_gpu() {
        return;
    }
    let no_noise = CompositeOptions { no_noise: true, ..default() };
    let place = |eye: u32| Transform::from_xyz(0.1 * (2.0 * eye as f32 - 1.0), 0.0, 0.0);
    // Each eye alone, over a picture of its own.
    let frames = [frame(), Encoded(frame().0.map(|[r, g, b]| [b, r, g]))];
    let alone = |eye: u32| {
        let (mut app, output) = scene_of(usual(), Msaa::Off, no_noise);
        let world = app.world_mut();
        let background = world.resource_mut::<Assets<Image>>().add(picture(&frames[eye as usize]));
        let mut camera = world.query::<(&mut MatchedCamera, &mut Transform)>();
        let (mut matched, mut transform) = camera.single_mut(world).unwrap();
        (matched.background, *transform) = (background, place(eye));
        update(&mut app, 12);
        read(&app, &output)
    };
    // Both, into the layers of one texture, over the layers of one picture.
    let (mut app, _) = scene_of(usual(), Msaa::Off, no_noise);
    let texture = headset(&app);
    let both = {
        let mut image = picture(&frames[0]);
        let other = picture(&frames[1]);
        image.texture_descriptor.size.depth_or_array_layers = 2;
        image.data.as_mut().unwrap().extend(other.data.unwrap());
        image
    };
    let world = app.world_mut();
    let (first, matched) = {
        let (entity, matched) = world.query::<(Entity, &MatchedCamera)>().single(world).unwrap();
        (entity, matched.clone())
    };
    world.despawn(first);
    let background = world.resource_mut::<Assets<Image>>().add(both);
    for eye in 0..2 {
        let view = texture.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2),
            base_array_layer: eye,
            array_layer_count: Some(1),
            ..default()
        });
        let handle = ManualTextureViewHandle(eye);
        let view = ManualTextureView {
            texture_view: view.into(),
            size: UVec2::from_array(SIZE),
            view_format: wgpu::TextureFormat::Rgba8UnormSrgb,
        };
        world.resource_mut::<ManualTextureViews>().insert(handle, view);
        world.spawn((
            MatchedCamera { background: background.clone(), background_layer: eye, ..matched.clone() },
            Projection::Perspective(PerspectiveProjection { fov: FOV, ..default() }),
            Camera { order: eye as isize, ..default() },
            RenderTarget::TextureView(handle),
            Msaa::Off,
            place(eye),
        ));
    }
    update(&mut app, 12);
    let eyes = gpu(&app).download::<[f32; 4]>(&texture).unwrap();
    let eyes: Vec<_> = eyes.iter().map(|i| i.map(|[r, g, b, _]| [r, g, b])).collect();
    let [left, right] = [0, 1].map(alone);
    let (own, other) = (
        [difference(&eyes[0], &left), difference(&eyes[1], &right)],
        [difference(&eyes[0], &right), difference(&eyes[1], &left)],
    );
    println!("own {own:?}, the other eye's {other:?}");
    assert!(own.iter().all(|d| *d < 0.001) && other.iter().all(|d| *d > 0.02), "{own:?} {other:?}");
}

#[test]
fn shadows_fall_on_the_real_scene_and_real_things_hide_virtual_ones() {
    if no_gpu() {
        return;
    }
    // A wall of the real scene 3 m away, a real box 1.5 m away in the left half, a virtual ball 2 m away.
    let of = |catches: bool, hides: bool| {
        let (mut app, output) =
            scene(Path::new("assets"), |_| Setup { matched: MatchedCamera::default(), msaa: Msaa::Off });
        let world = app.world_mut();
        let things: Vec<Entity> = world.query_filtered::<Entity, With<Mesh3d>>().iter(world).collect();
        things.into_iter().for_each(|thing| {
            world.despawn(thing);
        });
        let mut light = world.query::<(&mut DirectionalLight, &mut Transform)>();
        let (mut light, mut at) = light.single_mut(world).unwrap();
        light.shadow_maps_enabled = true;
        *at = Transform::from_xyz(-1.0, 1.0, 2.0).looking_at(Vec3::ZERO, Vec3::Y);
        let white = StandardMaterial { base_color: Color::WHITE, unlit: true, ..default() };
        let mesh = |world: &mut World, mesh: Mesh, at: Vec3| {
            let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
            world.spawn((Mesh3d(mesh), Transform::from_translation(at))).id()
        };
        let ball = mesh(world, Sphere::new(0.3).into(), Vec3::new(0.0, 0.0, -2.0));
        let white = world.resource_mut::<Assets<StandardMaterial>>().add(white);
        world.entity_mut(ball).insert(MeshMaterial3d(white));
        if catches {
            let wall = mesh(world, Rectangle::new(6.0, 6.0).into(), Vec3::new(0.0, 0.0, -3.0));
            let catcher = world.resource_mut::<Assets<ShadowCatcher>>().add(ShadowCatcher { strength: 0.5 });
            world.entity_mut(wall).insert(MeshMaterial3d(catcher));
        }
        if hides {
            let real = mesh(world, Rectangle::new(1.0, 3.0).into(), Vec3::new(-0.5, 0.0, -1.5));
            let occluder = world.resource_mut::<Assets<Occluder>>().add(Occluder {});
            world.entity_mut(real).insert(MeshMaterial3d(occluder));
        }
        update(&mut app, 12);
        read(&app, &output)
    };
    let [neither, shadow, hidden] = [of(false, false), of(true, false), of(false, true)];
    keep("shadow.png", &shadow);
    keep("hidden.png", &hidden);
    let behind = frame().0;
    // The light comes from the upper left, so that the shadow is to the lower right of the ball. Half of the light is left there.
    let darkest = |image: &Raster<[f32; 3]>| {
        let ratio = |x: usize, y: usize| {
            let light = |v: f32| blindaug::Transfer::Srgb.decode(v);
            light(image.at(x, y)[1]) / light(behind.at(x, y)[1])
        };
        let places = (0..120).flat_map(|y| (0..160).map(move |x| (x, y)));
        places
            .map(|(x, y)| (ratio(x, y), (x, y)))
            .fold((f32::MAX, (0, 0)), |a, b| if b.0 < a.0 { b } else { a })
    };
    let (least, place) = darkest(&shadow);
    println!(
        "the shadow leaves {least} of the light at {place:?}; without a catcher {:?}",
        darkest(&neither)
    );
    assert!((least - 0.5).abs() < 0.03 && place.0 > 80 && place.1 > 60);
    assert!(darkest(&neither).0 > 0.97);
    // The ball's left half is hidden, its right half is not.
    let [left, right] = [(72, 60), (88, 60)];
    assert!(neither.at(left.0, left.1)[1] > 0.99 && neither.at(right.0, right.1)[1] > 0.99);
    assert!((hidden.at(left.0, left.1)[1] - behind.at(left.0, left.1)[1]).abs() < 0.004);
    assert!(hidden.at(right.0, right.1)[1] > 0.99);
}

#[test]
fn left_of_the_line_things_are_pasted_on() {
    if no_gpu() {
        return;
    }
    let of = |split: f32, naive: bool| {
        let options = CompositeOptions { no_noise: true, naive, ..default() };
        let (mut app, output) = scene_of(usual(), Msaa::Off, options);
        let world = app.world_mut();
        world.query::<&mut MatchedCamera>().single_mut(world).unwrap().split = split;
        update(&mut app, 12);
        read(&app, &output)
    };
    let [both, pasted, matched] = [of(0.5, false), of(0.0, true), of(0.0, false)];
    let half = |image: &Raster<[f32; 3]>, x: usize| image.crop(x, 0, 78, 120);
    assert!(difference(&half(&both, 0), &half(&pasted, 0)) < 0.001);
    assert!(difference(&half(&both, 82), &half(&matched, 82)) < 0.001);
    assert!((0..120).all(|y| both.at(79, y) == [1.0; 3] && both.at(80, y) == [1.0; 3]));
    assert!(difference(&half(&both, 0), &half(&matched, 0)) > 0.01);
    assert!(difference(&half(&both, 82), &half(&pasted, 82)) > 0.01);
}
