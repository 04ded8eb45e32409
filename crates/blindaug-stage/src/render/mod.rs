//! Draws the object: its colour, inverse depth and velocity in a frame, by a graphics device or by the processor.
//!
//! The object is drawn with 2 x 2 samples per px: colour and alpha of a px are their mean, so that edges are soft; depth and velocity are
//! those of the nearest sample, since a mean over two surfaces would fit neither.

mod device;
mod processor;

pub use device::{Layer, Renderer, attachment};
pub use processor::drawn;

use crate::{light::Light, object::Object};
use blindaug_pipeline::live::{LiveEstimate, LiveFrame, Pinhole, Pose};
use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec2, Vec3, Vec3Swizzles, Vec4};

/// Samples per px along each axis.
const SAMPLES: usize = 2;
/// Depth of the near plane, m.
const NEAR: f32 = 0.01;
/// The share of the light that is taken away in the middle of the contact shadow.
const SHADOW: f32 = 0.6;
/// The half width of the contact shadow over that of the object near the ground, and the least one, as a share of the object's longest side.
const SHADOW_SIZE: (f32, f32) = (1.3, 0.12);
/// The distance of the shadow's middle from the object's foot, away from the light, in half widths of the shadow.
const SHADOW_SHIFT: f32 = 0.35;

/// The place and the appearance of the object in a frame.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// The object's poses in the frame and in the next one.
    pub poses: [Pose; 2],
    /// The time of the object's animation, s.
    pub seconds: f64,
    /// The time to the next frame, s.
    pub step: f64,
    /// The object's longest side, m.
    pub size: f32,
    /// The light on the object.
    pub light: Light,
}

impl Moment {
    /// The object of this size in a frame for which this was estimated, in footage of so many frames per second.
    pub fn of(shot: &LiveFrame, estimate: &LiveEstimate, size: f32, fps: f64) -> Self {
        let placed = estimate.placed_at(shot.number);
        Self {
            poses: [placed.now, placed.next],
            seconds: shot.number as f64 / fps,
            step: fps.recip(),
            size,
            light: Light::of_frame(&shot.frame),
        }
    }
}

/// What the shaders take, of one frame.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Scene {
    clip_from_object: [Mat4; 2],
    camera_from_object: Mat4,
    clip_from_ground: [Mat4; 2],
    light_direction: [f32; 3],
    width: f32,
    light: [f32; 3],
    height: f32,
    above: [f32; 3],
    near: f32,
    below: [f32; 3],
    shadow: f32,
}

/// How a camera sees an object that stands on a place.
#[derive(Clone, Debug)]
pub struct View {
    camera: Pinhole,
    /// The matrix that makes the object's longest side 1 and puts its foot on the origin.
    unit: Mat4,
    /// The half widths of the contact shadow along x and z, as shares of the object's longest side.
    shadow_size: Vec2,
}

impl View {
    /// The view of `camera` on `object`.
    pub fn new(object: &Object, camera: Pinhole) -> Self {
        let (unit, on_ground) = object.standing();
        let (factor, least) = SHADOW_SIZE;
        Self { camera, unit, shadow_size: (factor * on_ground).max(Vec2::splat(least)) }
    }

    fn scene(&self, moment: &Moment) -> Scene {
        let standing = moment.poses.map(|pose| camera_from_standing(&pose, moment.size));
        let in_camera = standing.map(|m| m * self.unit);
        let (w, h) = self.camera.size;
        let light = &moment.light;
        Scene {
            clip_from_object: in_camera.map(|m| self.projection() * m),
            camera_from_object: in_camera[0],
            clip_from_ground: standing
                .map(|m| self.projection() * m * self.standing_from_ground(&standing[0], light)),
            light_direction: light.direction.into(),
            width: w as f32,
            light: light.key.into(),
            height: h as f32,
            above: light.above.into(),
            near: NEAR,
            below: light.below.into(),
            shadow: SHADOW,
        }
    }

    /// The matrix from the contact shadow, a disk of radius 1 on the ground around the origin of x and z, to the coordinates of an object that
    /// stands on the origin.
    fn standing_from_ground(&self, camera_from_standing: &Mat4, light: &Light) -> Mat4 {
        let towards = camera_from_standing.inverse().transform_vector3(light.direction).normalize_or_zero();
        let size = self.shadow_size.extend(1.0).xzy();
        Mat4::from_translation(-SHADOW_SHIFT * size * Vec3::new(towards.x, 0.0, towards.z))
            * Mat4::from_scale(size)
    }

    /// The matrix from camera to clip coordinates; a point's depth is the distance of the near plane over that of the point.
    fn projection(&self) -> Mat4 {
        let (w, h) = self.camera.size;
        let f = 2.0 * self.camera.focal_length as f32;
        let row = |x, y, z, w| Vec4::new(x, y, z, w);
        Mat4::from_cols(
            row(f / w as f32, 0.0, 0.0, 0.0),
            row(0.0, -f / h as f32, 0.0, 0.0),
            row(0.0, 0.0, 0.0, 1.0),
            row(0.0, 0.0, NEAR, 0.0),
        )
    }
}

/// The matrix from the coordinates of an object that stands on the origin, y upward, and whose longest side is 1, to camera coordinates.
fn camera_from_standing(pose: &Pose, size: f32) -> Mat4 {
    let pose = Mat4::from_translation(pose.translation.as_vec3()) * Mat4::from_mat3(pose.rotation.as_mat3());
    // glTF's y is up, and its z towards the camera.
    pose * Mat4::from_scale(Vec3::new(size, -size, -size))
}
