//! The camera that shows virtual things as a real camera would have filmed them.

use crate::camera_file::FilmedCamera;
use bevy::asset::LoadState;
use bevy::camera::{ClearColorConfig, Hdr};
use bevy::core_pipeline::prepass::{DepthPrepass, MotionVectorPrepass, NoBackgroundMotionVectors};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::ecs::{lifecycle::HookContext, world::DeferredWorld};
use bevy::prelude::*;
use blindaug::CameraModel;
use blindaug::composite::CompositeOptions;
use blindaug::model::{Capture, DepthKind, Estimate, Reason, SceneScale};
use blindaug_gpu::Quality;
use blindaug_pipeline::ByHand;
use std::sync::Arc;

/// A 3D camera whose picture goes over the frame of a real camera, with that camera's defocus, motion blur, sharpening and noise.
///
/// What it needs beside it comes by itself (see the `require` attribute): a float target without tonemapping, the prepasses for depth and
/// motion, and a transparent background. Post-processing that comes before tonemapping may see the picture before or after it is
/// composited.
///
/// The frame fills the view; where their proportions differ, its edges are cut off alike on both sides. A camera with a viewport is not
/// composited: give it a target of its own.
#[derive(Component, Clone, Debug)]
#[require(
    Camera3d,
    Hdr,
    Tonemapping = Tonemapping::None,
    DebandDither = DebandDither::Disabled,
    DepthPrepass,
    MotionVectorPrepass,
    NoBackgroundMotionVectors,
    CameraInUse
)]
#[component(on_insert = clear_to_nothing)]
pub struct MatchedCamera {
    /// The camera to match, loaded from camera.json or from what `blindaug estimate --track` writes, or made by [`crate::LiveCamera`].
    /// Until it is loaded, and where it is missing or broken, virtual things are pasted on undistorted.
    pub model: Handle<FilmedCamera>,
    /// The frame behind the virtual things, a picture in sRGB (such as `Rgba8UnormSrgb`) of any size. Nothing is composited until it is
    /// loaded.
    pub background: Handle<Image>,
    /// The array layer of the background that is this camera's, for a background with a layer for each eye.
    pub background_layer: u32,
    /// The frame's number: each number has noise of its own, and a camera over time has a model for each.
    pub frame: u64,
    /// The interval between filmed frames divided by that between rendered frames. 1: a frame is rendered for each filmed frame. Motion
    /// vectors hold from one rendered frame to the next, the exposure is a share of the interval between filmed frames.
    pub frame_interval: f32,
    /// How closely the compositor follows the reference, and how long it takes.
    pub quality: Quality,
    /// The parts of the camera that are set by hand, whatever the model says.
    pub by_hand: ByHand,
    /// What is left out (noise, or everything: `naive`), the shape of out-of-focus points, and the seed of the noise.
    pub options: CompositeOptions,
    /// Whether what is behind the focus, in it and in front of it is blurred apart, so that something sharp does not bleed into blurred
    /// surroundings. It takes three times the memory.
    pub apart: bool,
    /// Relates a lens in relative inverse depth, as a video alone gives it, to metres. A lens that is metric needs none; a relative one
    /// without it is left out, with a warning.
    pub scene_scale: Option<SceneScale>,
    /// A line as a share of the view's width, 0 to 1: left of it virtual things are pasted on undistorted. 0: no line.
    pub split: f32,
}

impl Default for MatchedCamera {
    fn default() -> Self {
        Self {
            model: Handle::default(),
            background: Handle::default(),
            background_layer: 0,
            frame: 0,
            frame_interval: 1.0,
            quality: Quality::default(),
            by_hand: ByHand::default(),
            options: CompositeOptions::default(),
            apart: true,
            scene_scale: None,
            split: 0.0,
        }
    }
}

/// Virtual things are rendered on nothing, unless somebody chose another background.
fn clear_to_nothing(mut world: DeferredWorld, HookContext { entity, .. }: HookContext) {
    if let Some(mut camera) = world.get_mut::<Camera>(entity)
        && matches!(camera.clear_color, ClearColorConfig::Default)
    {
        camera.clear_color = ClearColorConfig::Custom(Color::NONE);
    }
}

/// What a [`MatchedCamera`] applies in the current frame.
#[derive(Component, Clone, Debug, Default)]
pub struct CameraInUse {
    /// The model for pictures of the view's size, with its lens in 1/m; `None` if nothing is applied.
    pub model: Option<Arc<CameraModel>>,
    /// Why less is applied than was asked for: one sentence, which was said once as a warning and a [`CameraProblem`].
    pub problem: Option<String>,
}

/// A camera whose model, or a part of it, cannot be applied. Each problem is said once, here and as a warning in the log.
#[derive(Message, Clone, Debug, PartialEq, Eq)]
pub struct CameraProblem {
    /// The entity of the [`MatchedCamera`].
    pub camera: Entity,
    /// What is wrong, what is done, and what to do: one sentence.
    pub sentence: String,
}

/// A model, or the reason why there is none. Neither: it is being loaded, or there is nothing to load.
type Found = Result<Option<CameraModel>, String>;

/// The model that a handle leads to at a frame.
fn found(
    handle: &Handle<FilmedCamera>,
    frame: u64,
    models: &Assets<FilmedCamera>,
    server: &AssetServer,
) -> Found {
    if *handle == Handle::default() {
        return Ok(None);
    }
    let name = || handle.path().map_or_else(|| "the camera".to_string(), ToString::to_string);
    match models.get(handle) {
        Some(FilmedCamera(Ok(track))) => Ok(Some(track.at(frame).into_owned())),
        Some(FilmedCamera(Err(why))) => {
            Err(format!("{}: {why}; virtual things are shown undistorted", name()))
        }
        None => match server.get_load_state(handle) {
            Some(LoadState::Failed(why)) => {
                let why = why.to_string().replace('\n', " ");
                Err(format!("{}: it cannot be read ({why}); virtual things are shown undistorted", name()))
            }
            _ => Ok(None),
        },
    }
}

/// The model, with what is set by hand, for a view of this size (px) that its frames fill, and what of it had to be left out.
fn fitted(
    mut model: CameraModel,
    by_hand: &ByHand,
    scale: Option<SceneScale>,
    [w, h]: [usize; 2],
) -> (CameraModel, Option<String>) {
    let mut problem = None;
    if let Some(scale) = scale {
        model = model.to_metric(scale);
    }
    match by_hand.applied(model.clone()) {
        Ok(set) => model = set,
        Err(why) => problem = Some(format!("what is set by hand is left out: {why}")),
    }
    if model.defocus.known().is_some_and(|lens| lens.depth_kind == DepthKind::Relative) {
        let why = "its lens is in relative inverse depth, which has no scale";
        problem =
            Some(format!("{why}; there is no defocus until MatchedCamera::scene_scale relates it to metres"));
        model.defocus = Estimate::unknown(Reason::NoDepth, why);
    }
    let Capture { width, height, .. } = model.capture;
    // The frame covers the view, so that its blur grows with the larger of the two ratios.
    let scale = (w as f64 / width as f64).max(h as f64 / height as f64);
    let [shown_w, shown_h] = [width, height].map(|s| (s as f64 * scale).round() as usize);
    let mut model = model.scaled_to(shown_w, shown_h);
    (model.capture.width, model.capture.height) = (w, h);
    (model, problem)
}

/// Finds the model of every camera, and says what is wrong.
pub(crate) fn find_models(
    mut cameras: Query<(Entity, &MatchedCamera, &Camera, &mut CameraInUse)>,
    models: Res<Assets<FilmedCamera>>,
    server: Res<AssetServer>,
    mut problems: MessageWriter<CameraProblem>,
) {
    for (entity, matched, camera, mut in_use) in &mut cameras {
        let Some(size) = camera.physical_target_size().filter(|s| s.x > 0 && s.y > 0) else { continue };
        let (model, problem) = match found(&matched.model, matched.frame, &models, &server) {
            Ok(Some(model)) => {
                let size = [size.x as usize, size.y as usize];
                let (model, problem) = fitted(model, &matched.by_hand, matched.scene_scale, size);
                (Some(Arc::new(model)), problem)
            }
            Ok(None) => (None, None),
            Err(why) => (None, Some(why)),
        };
        let problem = match &camera.viewport {
            Some(_) => Some("a camera with a viewport is not composited; give it a target of its own".into()),
            None => problem,
        };
        if let Some(sentence) = &problem
            && in_use.problem != problem
        {
            warn!("{sentence}");
            problems.write(CameraProblem { camera: entity, sentence: sentence.clone() });
        }
        *in_use = CameraInUse { model, problem };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use blindaug::model::DefocusModel;

    fn camera(width: usize, height: usize) -> CameraModel {
        let capture = Capture { width, height, fps: None, frames_used: 1, pixel_aspect: 1.0 };
        let mut camera = CameraModel::unknown(capture, "not given");
        camera.defocus = Estimate::Known(DefocusModel::given_lens(4.0, 0.5));
        camera
    }

    fn sigma(model: &CameraModel) -> Option<f32> {
        model.defocus.known().map(|lens| lens.sigma_px(0.0))
    }

    #[test]
    fn blur_grows_with_the_frame_that_covers_the_view() {
        for (view, want) in [([100, 80], 4.0), ([200, 160], 8.0), ([50, 80], 4.0), ([200, 80], 8.0)] {
            let (model, problem) = fitted(camera(100, 80), &ByHand::default(), None, view);
            assert_eq!((sigma(&model), problem), (Some(want), None), "{view:?}");
            assert!(model.check_width(view[0]).is_ok());
        }
    }

    #[test]
    fn what_is_set_by_hand_is_in_px_of_the_model_s_width() {
        let by_hand = ByHand { blur_px: Some(3.0), focus_m: Some(1.0), ..ByHand::default() };
        let (model, problem) = fitted(camera(100, 80), &by_hand, None, [200, 160]);
        assert_eq!((sigma(&model), problem), (Some(6.0), None));
        assert_eq!(model.defocus.known().unwrap().sigma_px(1.0), 0.0);
        // What cannot be set is said, and the rest of the model stays.
        let by_hand = ByHand { grain: Some(2.0), ..ByHand::default() };
        let (model, problem) = fitted(camera(100, 80), &by_hand, None, [100, 80]);
        assert_eq!(sigma(&model), Some(4.0));
        assert!(problem.unwrap().contains("noise is unknown"));
    }

    #[test]
    fn a_relative_lens_needs_a_scale() {
        let (by_hand, mut relative) = (ByHand::default(), camera(100, 80));
        relative.defocus =
            relative.defocus.map(|lens| DefocusModel { depth_kind: DepthKind::Relative, ..lens });
        let (model, problem) = fitted(relative.clone(), &by_hand, None, [100, 80]);
        assert_eq!(sigma(&model), None);
        assert!(problem.unwrap().contains("scene_scale"));
        let scale = SceneScale { scale: 0.5, offset: 0.0 };
        let (model, problem) = fitted(relative, &by_hand, Some(scale), [100, 80]);
        assert_eq!((sigma(&model), problem), (Some(4.0), None));
        assert_eq!(model.defocus.known().unwrap().depth_kind, DepthKind::Metric);
    }
}
