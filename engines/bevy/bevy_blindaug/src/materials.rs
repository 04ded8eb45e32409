//! What of the real scene takes part in the virtual one.

use bevy::asset::{Asset, embedded_asset};
use bevy::prelude::*;
use bevy::reflect::TypePath;
use bevy::render::render_resource::AsBindGroup;
use bevy::shader::ShaderRef;

/// A surface of the real scene, such as the floor, on which virtual things cast the shadows of directional lights. Nothing else of it is
/// seen, and it hides virtual things behind it.
#[derive(Asset, TypePath, AsBindGroup, Clone, Debug)]
pub struct ShadowCatcher {
    /// The share of the real light that comes from where the directional lights stand for it, 0 to 1: how dark a full shadow is.
    #[uniform(0)]
    pub strength: f32,
}

impl Default for ShadowCatcher {
    /// Shadows that take 60 % of the light.
    fn default() -> Self {
        Self { strength: 0.6 }
    }
}

impl Material for ShadowCatcher {
    fn fragment_shader() -> ShaderRef {
        "embedded://bevy_blindaug/shadow_catcher.wgsl".into()
    }

    fn enable_shadows() -> bool {
        false
    }
}

/// A thing of the real scene that hides virtual things behind it, and is not seen itself.
#[derive(Asset, TypePath, AsBindGroup, Clone, Copy, Debug, Default)]
pub struct Occluder {}

impl Material for Occluder {
    fn fragment_shader() -> ShaderRef {
        "embedded://bevy_blindaug/occluder.wgsl".into()
    }

    fn enable_shadows() -> bool {
        false
    }
}

/// Adds the materials.
pub(crate) fn plugin(app: &mut App) {
    embedded_asset!(app, "shadow_catcher.wgsl");
    embedded_asset!(app, "occluder.wgsl");
    app.add_plugins((MaterialPlugin::<ShadowCatcher>::default(), MaterialPlugin::<Occluder>::default()));
}
