//! A video or a camera that plays behind the virtual things, and is estimated meanwhile.

use crate::camera_file::FilmedCamera;
use crate::matched::MatchedCamera;
use bevy::asset::RenderAssetUsages;
use bevy::prelude::*;
use bevy::tasks::{AsyncComputeTaskPool, Task, block_on, futures::check_ready};
use blindaug::model::Distortion;
use blindaug::{CameraModel, Encoded, Transfer};
use blindaug_io::FrameSource;
use blindaug_pipeline::live::{
    self, Home, LiveEstimate, LiveEstimator, LiveFrame, Pace, Pinhole, Placed, Player, Pose,
};
use std::path::Path;
use std::sync::Arc;
use wgpu::{Extent3d, TextureDimension, TextureFormat};

/// The frame rate of what names none, such as a folder of images, frames per second.
const DEFAULT_FPS: f64 = 30.0;
/// The step along each axis, px, between the pixels whose mean is a frame's light.
const LIGHT_STRIDE: usize = 8;

/// What a [`LiveCamera`] is told when it is opened.
#[derive(Clone, Copy, Debug)]
pub struct LiveOptions {
    /// The vertical field of view of the camera, degrees, above 0 and below 180.
    pub fov: f64,
    /// The place of an object until a plane is found, and the distance at which the plane is then taken to be.
    pub home: Home,
    /// Whether every frame is estimated before it is shown, so that a run repeats exactly; each update then waits for a frame. Otherwise
    /// frames come at their own pace, and those for which there is no time are left out.
    pub every_frame: bool,
}

impl Default for LiveOptions {
    /// A field of view of 50 degrees, and a place 2 m away in the lower half.
    fn default() -> Self {
        Self { fov: 50.0, home: Home { at: [0.5, 0.75].into(), distance: 2.0 }, every_frame: false }
    }
}

/// A video, a folder of images or a camera that plays, starts again at its end, and is estimated by blindaug's tracker in a background
/// task.
///
/// Every [`MatchedCamera`] whose background is [`LiveCamera::background`] gets each frame's number and the model at that frame.
#[derive(Resource)]
pub struct LiveCamera {
    /// The frame that is shown.
    pub background: Handle<Image>,
    /// The camera as it was last estimated, with its lens over inverse depth in 1/m.
    pub model: Handle<FilmedCamera>,
    /// The place of the object until a plane is found. Where it changes, the object is placed anew.
    pub home: Home,
    source: Arc<FrameSource>,
    pinhole: Pinhole,
    every_frame: bool,
    player: Player,
    /// The estimator while it has nothing to do.
    idle: Option<LiveEstimator>,
    task: Option<Task<(LiveEstimator, blindaug::Result<LiveEstimate>)>>,
    /// The newest frame, while its estimate is waited for.
    pending: Option<LiveFrame>,
    shown: Option<LiveFrame>,
    estimate: Option<LiveEstimate>,
    on_plane: bool,
    ended: bool,
}

/// What happened to a [`LiveCamera`].
#[derive(Message, Clone, Debug, PartialEq)]
pub enum LiveEvent {
    /// The camera changed just before a frame: its light, focus or shutter.
    Changed {
        /// The number of the frame.
        frame: u64,
        /// What changed.
        distortions: Vec<Distortion>,
    },
    /// From now on an object stands on a plane that is tracked.
    PlaneFound,
    /// There is no plane any more: an object is fixed in view.
    PlaneLost,
    /// The footage cannot be read or estimated any more; the last frame and model stay. One sentence.
    Ended(String),
}

impl LiveCamera {
    /// Opens a video, a folder of images, or by `camera:0` a camera, and begins to read.
    ///
    /// # Errors
    /// If there is no such thing, or it cannot be read.
    pub fn open(
        input: impl AsRef<Path>,
        options: &LiveOptions,
        images: &mut Assets<Image>,
        models: &mut Assets<FilmedCamera>,
    ) -> blindaug_io::Result<Self> {
        let source = Arc::new(live::open(input.as_ref())?);
        let LiveOptions { fov, home, every_frame } = *options;
        let size = source.size();
        let pinhole = Pinhole::new(size, fov);
        let pace = match (every_frame, live::names_camera(source.path())) {
            (true, _) => Pace::EveryFrame,
            (false, true) => Pace::AsTheyCome,
            (false, false) => Pace::FramesPerSecond(source.fps().unwrap_or(DEFAULT_FPS)),
        };
        let extent = Extent3d { width: size.0 as u32, height: size.1 as u32, depth_or_array_layers: 1 };
        let black = Image::new_fill(
            extent,
            TextureDimension::D2,
            &[0, 0, 0, 255],
            TextureFormat::Rgba8UnormSrgb,
            RenderAssetUsages::RENDER_WORLD,
        );
        let capture = blindaug::model::Capture {
            width: size.0,
            height: size.1,
            fps: source.fps(),
            frames_used: 0,
            pixel_aspect: 1.0,
        };
        Ok(Self {
            background: images.add(black),
            model: models.add(FilmedCamera::from(CameraModel::unknown(capture, "nothing was seen yet"))),
            home,
            player: Player::start(source.clone(), pace, || true),
            idle: Some(LiveEstimator::new(pinhole, home, source.fps())),
            source,
            pinhole,
            every_frame,
            task: None,
            pending: None,
            shown: None,
            estimate: None,
            on_plane: false,
            ended: false,
        })
    }

    /// Width and height of the frames, px.
    pub fn size(&self) -> (usize, usize) {
        self.pinhole.size
    }

    /// Frames per second: those of the footage, or 30 where it names none.
    pub fn fps(&self) -> f64 {
        self.source.fps().unwrap_or(DEFAULT_FPS)
    }

    /// The projection of a Bevy camera that sees what the real one sees.
    pub fn projection(&self) -> PerspectiveProjection {
        let (w, h) = (self.pinhole.size.0 as f64, self.pinhole.size.1 as f64);
        let fov = 2.0 * (0.5 * h / self.pinhole.focal_length).atan();
        PerspectiveProjection { fov: fov as f32, aspect_ratio: (w / h) as f32, ..default() }
    }

    /// The number of the frame that is shown; it counts from 1 on, and goes on when a clip starts again. 0 before the first one.
    pub fn frame(&self) -> u64 {
        self.shown.as_ref().map_or(0, |shot| shot.number)
    }

    /// The last estimate: the camera with its intervals, or the reasons why parts of it are unknown (`estimate.tracked`), and the
    /// object's place. It may be of a frame before the one that is shown.
    pub fn estimate(&self) -> Option<&LiveEstimate> {
        self.estimate.as_ref()
    }

    /// The place of the object in the frame that is shown, for a Bevy camera at the origin: on the plane that is tracked, or fixed in
    /// view. Its y axis points up in the picture, its z axis towards the camera when the plane was found.
    pub fn place(&self) -> Option<Transform> {
        let placed: Placed = self.estimate.as_ref()?.placed_at(self.frame());
        Some(transform(&placed.now))
    }

    /// The mean light of the frame that is shown, linear.
    pub fn light(&self) -> LinearRgba {
        let Some(shot) = &self.shown else { return LinearRgba::BLACK };
        let (w, h) = shot.frame.0.size();
        let mut sum = [0.0; 3];
        let mut count = 0.0f32;
        for (x, y) in
            (0..h).step_by(LIGHT_STRIDE).flat_map(|y| (0..w).step_by(LIGHT_STRIDE).map(move |x| (x, y)))
        {
            let pixel = shot.frame.0.at(x, y);
            sum.iter_mut().zip(pixel).for_each(|(s, v)| *s += Transfer::Srgb.decode(v));
            count += 1.0;
        }
        let [r, g, b] = sum.map(|s| s / count);
        LinearRgba::rgb(r, g, b)
    }

    /// Whether no frame is being estimated, and none waits for it.
    pub fn is_idle(&self) -> bool {
        self.task.is_none() && self.pending.is_none()
    }

    /// Stops at the frame that is shown, or goes on.
    pub fn set_paused(&self, paused: bool) {
        self.player.set_paused(paused);
    }

    /// Gives the estimator a frame if it has nothing to do.
    fn offer(&mut self, shot: &LiveFrame) {
        let Some(mut estimator) = self.idle.take() else { return };
        let (shot, home) = (shot.clone(), self.home);
        self.task = Some(AsyncComputeTaskPool::get().spawn(async move {
            let estimate = estimator.push(&shot, home, None);
            (estimator, estimate)
        }));
    }

    /// Takes what is new, and returns the frame that is to be shown: it is shown when it has been estimated or when the next one is
    /// there.
    ///
    /// # Errors
    /// If the footage cannot be read or estimated: one sentence.
    fn follow(&mut self) -> Result<Option<LiveFrame>, String> {
        let mut due = None;
        let new = if self.every_frame { self.player.next_frame() } else { self.player.newest() };
        if let Some(shot) = new.map_err(|e| e.to_string())? {
            self.offer(&shot);
            due = self.pending.replace(shot);
        }
        let finished = match &mut self.task {
            Some(task) if self.every_frame => Some(block_on(task)),
            Some(task) => check_ready(task),
            None => None,
        };
        if let Some((estimator, estimate)) = finished {
            (self.task, self.idle) = (None, Some(estimator));
            self.estimate = Some(estimate.map_err(|e| e.to_string())?);
        }
        let estimated = self.estimate.as_ref().map_or(0, |e| e.tracked.frame);
        if self.pending.as_ref().is_some_and(|p| p.number <= estimated) {
            due = self.pending.take();
        }
        Ok(due)
    }
}

/// A pose of an object as a transform in Bevy's axes (x right, y up, z backward), which differ from the pose's by half a turn around x.
fn transform(pose: &Pose) -> Transform {
    let Pose { rotation, translation } = pose;
    let column = |v: [f64; 3], sign: f32| sign * Vec3::new(v[0] as f32, -v[1] as f32, -v[2] as f32);
    let axes = Mat3::from_cols(
        column(rotation.x_axis.to_array(), 1.0),
        column(rotation.y_axis.to_array(), -1.0),
        column(rotation.z_axis.to_array(), -1.0),
    );
    Transform {
        translation: column(translation.to_array(), 1.0),
        rotation: Quat::from_mat3(&axes),
        scale: Vec3::ONE,
    }
}

/// The bytes of a picture of format `Rgba8UnormSrgb`.
fn bytes(frame: &Encoded) -> Vec<u8> {
    frame.0.data().iter().flat_map(|&[r, g, b]| [r, g, b, 1.0].map(|v| (255.0 * v).round() as u8)).collect()
}

/// Plays the footage.
pub(crate) fn play(
    live: Option<ResMut<LiveCamera>>,
    mut images: ResMut<Assets<Image>>,
    mut models: ResMut<Assets<FilmedCamera>>,
    mut cameras: Query<&mut MatchedCamera>,
    mut events: MessageWriter<LiveEvent>,
) {
    let Some(mut live) = live.filter(|live| !live.ended) else { return };
    let before = live.estimate.as_ref().map_or(0, |e| e.tracked.frame);
    let due = match live.follow() {
        Ok(due) => due,
        Err(sentence) => {
            warn!("{sentence}; the last frame stays");
            events.write(LiveEvent::Ended(sentence));
            live.ended = true;
            return;
        }
    };
    if let Some(estimate) = live.estimate.as_ref().filter(|e| e.tracked.frame != before) {
        let (changed, on_plane) = (estimate.tracked.changed, estimate.placed.on_plane);
        if !changed.is_empty() {
            let distortions = Distortion::ALL.into_iter().filter(|&d| changed.of(d)).collect();
            events.write(LiveEvent::Changed { frame: estimate.tracked.frame, distortions });
        }
        if on_plane != live.on_plane {
            events.write(if on_plane { LiveEvent::PlaneFound } else { LiveEvent::PlaneLost });
        }
        // The handle keeps the asset's place.
        models.insert(&live.model, FilmedCamera::from(estimate.camera.clone())).ok();
        live.on_plane = on_plane;
    }
    let Some(shot) = due else { return };
    if let Some(mut image) = images.get_mut(&live.background) {
        image.data = Some(bytes(&shot.frame));
    }
    for mut camera in cameras.iter_mut().filter(|c| c.background == live.background) {
        camera.frame = shot.number;
        if camera.model != live.model {
            camera.model = live.model.clone();
        }
    }
    live.shown = Some(shot);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_turned_into_bevy_s_axes() {
        let pinhole = Pinhole::new((320, 180), 50.0);
        let mut placement = live::Placement::new(pinhole, [0.5, 0.75].into(), 2.0);
        let pose = placement.skip().now;
        let place = transform(&pose);
        // An object below the middle of the picture that faces the camera.
        assert!(place.translation.z == -2.0 && place.translation.y < -0.1, "{place:?}");
        assert!(place.translation.x.abs() < 0.01);
        assert!(place.rotation.angle_between(Quat::IDENTITY) < 1e-3, "{place:?}");
    }
}
