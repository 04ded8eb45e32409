//! Virtual things in real footage, as its camera would have filmed them: with that camera's defocus, motion blur, sharpening and noise,
//! which [blindaug](https://github.com/blindaug/blindaug) estimates from any video.
//!
//! # A video and its camera
//!
//! `blindaug estimate clip.mp4 -o camera.json` writes the camera. An app shows it in five lines:
//!
//! ```no_run
//! use bevy::prelude::*;
//! use bevy_blindaug::{BlindaugPlugin, MatchedCamera};
//!
//! fn main() {
//!     App::new().add_plugins((DefaultPlugins, BlindaugPlugin)).add_systems(Startup, setup).run();
//! }
//!
//! fn setup(mut commands: Commands, assets: Res<AssetServer>) {
//!     commands.spawn(MatchedCamera {
//!         model: assets.load("camera.json"),
//!         background: assets.load("frame.png"),
//!         ..default()
//!     });
//!     // Everything that this camera sees is composited over the background.
//! }
//! ```
//!
//! [`MatchedCamera`] brings a 3D camera with it. [`MatchedCamera::background`] may be any picture, of which each new frame replaces the
//! last one; [`MatchedCamera::frame`] is its number, on which the noise depends. With Bevy's feature `file_watcher`, a camera.json that
//! changes takes effect at once.
//!
//! A camera.json that is missing, broken or of a newer version leaves virtual things undistorted, and is said once, in the log and as a
//! [`CameraProblem`]. What a model does not know is not applied.
//!
//! # A video or a camera that is estimated while it plays
//!
//! ```no_run
//! # use bevy::prelude::*;
//! # use bevy_blindaug::{FilmedCamera, LiveCamera, LiveOptions, MatchedCamera};
//! fn setup(
//!     mut commands: Commands,
//!     mut images: ResMut<Assets<Image>>,
//!     mut models: ResMut<Assets<FilmedCamera>>,
//! ) -> Result {
//!     let live = LiveCamera::open("camera:0", &LiveOptions::default(), &mut images, &mut models)?;
//!     commands.spawn((
//!         MatchedCamera { background: live.background.clone(), ..default() },
//!         Projection::Perspective(live.projection()),
//!     ));
//!     commands.insert_resource(live);
//!     Ok(())
//! }
//! ```
//!
//! [`LiveCamera`] is a resource: it has the camera with its intervals and the reasons why parts of it are unknown, and the place of an
//! object on a plane that it tracks. [`LiveEvent`]s tell when the camera changes.
//!
//! # The real scene
//!
//! A [`ShadowCatcher`] is a real surface on which virtual things cast shadows, an [`Occluder`] a real thing that hides them. Both are
//! materials.
//!
//! # How it works
//!
//! The camera renders its scene on nothing, to a float target without tonemapping, with Bevy's prepasses for depth and motion vectors.
//! Before tonemapping, a pass gathers colour, depth and motion; blindaug's compositor ([`blindaug_gpu::Compositor`]) then runs on Bevy's
//! own device, in the view's own command encoder, and writes scene-linear light, which Bevy encodes. Nothing is read back and nothing
//! is allocated from frame to frame but bindings. [`ViewLayer`] has the textures, for those who want to look at them.
//!
//! - Motion vectors lead from the last rendered frame to this one, and are taken for the motion to the next.
//! - Transparent things have no depth in Bevy's prepass; they take that of what is beside or behind them.
//! - Virtual things whose light exceeds 1 clip as a sensor does: choose lights so that they are as bright as the frame
//!   ([`LiveCamera::light`]).
//! - A pixel of the view costs what docs/gpu.md of blindaug says, whatever part of it virtual things cover.

mod camera_file;
mod live;
mod matched;
mod materials;
mod render;

use bevy::prelude::*;

pub use blindaug_pipeline::ByHand;
pub use camera_file::FilmedCamera;
pub use live::{LiveCamera, LiveEvent, LiveOptions};
pub use matched::{CameraInUse, CameraProblem, MatchedCamera};
pub use materials::{Occluder, ShadowCatcher};
pub use render::ViewLayer;

/// Adds [`MatchedCamera`] and everything that it needs to an app that renders.
#[derive(Clone, Copy, Debug, Default)]
pub struct BlindaugPlugin;

impl Plugin for BlindaugPlugin {
    fn build(&self, app: &mut App) {
        app.init_asset::<FilmedCamera>()
            .init_asset_loader::<camera_file::FilmedCameraLoader>()
            .add_message::<CameraProblem>()
            .add_message::<LiveEvent>()
            .add_systems(PreUpdate, live::play)
            .add_systems(PostUpdate, matched::find_models.after(bevy::camera::CameraUpdateSystems))
            .add_plugins((materials::plugin, render::plugin));
    }
}
