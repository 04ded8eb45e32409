//! The scenes of the paper's results, each with a virtual object and a camera.

use crate::shot::{Device, ball};
use blindaug_scenes::camera::Setting;
use blindaug_scenes::scene::{Scene, TextureKind};
use blindaug_scenes::thing::{Path, Thing};
use serde::{Deserialize, Serialize};

/// A scene with a virtual object and the camera that films it.
pub(crate) struct Scenery {
    /// The name of files.
    pub(crate) name: &'static str,
    /// What is to be seen, in a sentence.
    pub(crate) about: &'static str,
    /// The scene without the object.
    pub(crate) scene: Scene,
    /// The object.
    pub(crate) object: Thing,
    /// The depth of the object, m.
    pub(crate) depth_m: f32,
    /// The camera.
    pub(crate) device: Device,
}

/// A number of frames of a scenery.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Take {
    /// The number of the scenery, below [`COUNT`].
    pub(crate) scenery: usize,
    /// The seed of the scene and of the noise.
    pub(crate) seed: u64,
    /// The number of frames.
    pub(crate) frames: u64,
    /// Width and height, px.
    pub(crate) size: (usize, usize),
}

impl Take {
    /// The frame in which the object is near the middle of the picture.
    pub(crate) fn middle(&self) -> usize {
        (self.frames / 2) as usize
    }

    /// The scenery.
    pub(crate) fn scenery(&self) -> Scenery {
        scenery(self.scenery, self.seed, self.size, self.middle() as f32)
    }
}

/// The number of sceneries.
pub(crate) const COUNT: usize = 6;

/// The scenery of this number, in pictures of this size; the object is near the middle of the picture in frame `middle`.
// This function is long, since it lists the numbers of each scene.
fn scenery(number: usize, seed: u64, size: (usize, usize), middle: f32) -> Scenery {
    // An object's radius is a part of the picture's width, so that it looks the same in any size.
    let px = |share: f32| share * size.0 as f32;
    let setting =
        |exposure, lens, noise| Setting { exposure, lens, noise, readout: 0.2, rolling_shutter: 0.0 };
    // Blur is a part of the width, too.
    let lens = |sigma: f32, focus: f32| Some((sigma * size.0 as f32 / 512.0, focus));
    let (name, about, device, depth, radius, texture) = match number {
        0 => (
            "out-of-focus",
            "A still object in front of the plane in focus; the camera moves",
            setting(0.3, lens(5.0, 4.0), 0.006),
            1.5,
            0.085,
            TextureKind::Bricks,
        ),
        1 => (
            "bouncing",
            "A ball that bounces, through a lens with little depth of field",
            setting(0.5, lens(3.0, 1.3), 0.008),
            1.8,
            0.07,
            TextureKind::LargeLeaves,
        ),
        2 => (
            "pendulum",
            "A pendulum that swings while the shutter is open for long",
            setting(0.8, lens(1.2, 2.0), 0.010),
            2.0,
            0.075,
            TextureKind::SmallLeaves,
        ),
        3 => (
            "fluttering",
            "A ball that flutters near the camera, far out of focus",
            setting(0.4, lens(4.0, 2.5), 0.006),
            1.1,
            0.07,
            TextureKind::Wood,
        ),
        4 => (
            "noise",
            "Strong noise, and a still object before a moving camera",
            setting(0.6, lens(1.5, 1.5), 0.035),
            2.2,
            0.085,
            TextureKind::Bricks,
        ),
        _ => (
            "still-camera",
            "A camera that stands still: a real ball moves in the scene, and so does the virtual one",
            setting(0.7, lens(2.5, 3.0), 0.008),
            1.8,
            0.07,
            TextureKind::LargeLeaves,
        ),
    };
    // In the middle frame, the ball has risen a little above the place that is free, and is fast.
    let path = |period: f32| Path::Bouncing { height_m: 0.2, period, phase: 0.15 - middle / period };
    // A scene in which no place is free is passed over.
    let found = (0..).find_map(|i| {
        let number = seed + number as u64 + 100 * i;
        let scene = Scene::new(number, size);
        let scene = if name == "still-camera" {
            let real = ball(&scene, 0.0, (2.6, px(0.09)), TextureKind::SmallLeaves, number + 1)?;
            scene.still_camera().with(real.moving(Path::Swinging {
                pivot: [0.0, -2.5, 2.6],
                angle: 0.25,
                period: 24.0,
                phase: 0.05,
            }))
        } else {
            scene
        };
        let object = ball(&scene, middle, (depth, px(radius)), texture, number)?;
        Some((scene, object))
    });
    let (scene, object) = found.expect("some scene has a free place");
    let object = match name {
        "bouncing" => object.moving(path(14.0)),
        "still-camera" => object.moving(path(18.0)),
        "pendulum" => {
            object.moving(Path::Swinging { pivot: [0.0, -1.8, 2.0], angle: 0.2, period: 22.0, phase: 0.0 })
        }
        "fluttering" => {
            object.moving(Path::Fluttering { shift_m: 0.03, angle: 0.5, period: 9.0, phase: 0.2 })
        }
        _ => object,
    };
    Scenery { name, about, scene, object, depth_m: depth, device: Device::plain(name, about, device) }
}
