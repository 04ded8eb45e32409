//! The object: triangles, materials and an animation, from a glTF file or made here.

mod reader;
#[cfg(all(test, feature = "files"))]
mod tests;

use self::reader::Reader;
use blindaug::{Error, Result, text::one_line};
use bytemuck::{Pod, Zeroable};
use glam::{EulerRot, Mat4, Quat, Vec2, Vec3, Vec4};
use gltf::{Gltf, animation::Interpolation};
use std::{f32::consts::TAU, ops::Range};

/// The number of times after the start of the animation at which the object's size is measured.
const UNIT_LOOKS: u8 = 8;

/// The share of its height up to which an object counts as near the ground.
const NEAR_GROUND: f32 = 0.1;

/// The object as it is measured at a time of its animation.
struct Look {
    /// The lowest and the highest coordinates.
    bounds: [Vec3; 2],
    /// Half the widths along x and z of what is near the ground.
    on_ground: Vec2,
}

/// The most memory that a file with all that belongs to it may take, bytes: in a page, which has 4 GB at most, less.
pub const MAX_BYTES: u64 = if cfg!(target_pointer_width = "32") { 1 << 29 } else { 1 << 31 };

/// Reads at most so many bytes that a file refers to by a URI; what is wrong with them continues a sentence that begins with their name.
pub type ReadBeside<'a> = dyn Fn(&str, u64) -> std::result::Result<Vec<u8>, String> + 'a;

/// A corner of a triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// The position, in the joints' coordinates before they move.
    pub position: [f32; 3],
    /// The normal, of length 1; 0 where it is unknown.
    pub normal: [f32; 3],
    /// The place in the base colour's texture, in [0, 1], (0, 0) top left.
    pub uv: [f32; 2],
    /// A linear colour that multiplies the base colour.
    pub color: [f32; 4],
    /// The joints that move the vertex, counted from the part's first joint on.
    pub joints: [u32; 4],
    /// The weights of the joints, which sum to 1.
    pub weights: [f32; 4],
}

/// The material of a surface: metallic-roughness, as in glTF.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// The base colour, linear, with alpha.
    pub base_color: [f32; 4],
    /// The metalness of the surface, in [0, 1].
    pub metallic: f32,
    /// The roughness of the surface, in [0, 1].
    pub roughness: f32,
    /// The least alpha at which there is a surface.
    pub alpha_cutoff: f32,
    /// The index of the base colour's texture in [`Object::textures`].
    pub texture: Option<usize>,
}

impl Default for Material {
    fn default() -> Self {
        Self { base_color: [1.0; 4], metallic: 0.0, roughness: 0.5, alpha_cutoff: 0.0, texture: None }
    }
}

/// An image in sRGB with alpha, 8 bit.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// Width and height, px.
    pub size: [u32; 2],
    /// Four bytes per texel.
    pub texels: Vec<u8>,
}

/// Triangles of one material that move together.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// The range of the part's corners in [`Object::indices`].
    pub indices: Range<u32>,
    /// The material.
    pub material: Material,
    /// The index of the part's first joint among the matrices of the object's joints.
    pub first_joint: u32,
}

/// Translation, rotation and scale.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Transform {
    translation: Vec3,
    rotation: Quat,
    scale: Vec3,
}

impl Transform {
    const IDENTITY: Self = Self { translation: Vec3::ZERO, rotation: Quat::IDENTITY, scale: Vec3::ONE };

    fn matrix(&self) -> Mat4 {
        Mat4::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }
}

#[derive(Clone, Debug)]
struct Node {
    /// The index of the parent, which comes before the node in the list.
    parent: Option<usize>,
    rest: Transform,
}

/// A joint, which moves vertices: a node, and the matrix from the vertices' coordinates to the node's.
#[derive(Clone, Debug)]
struct Joint {
    node: usize,
    inverse_bind: Mat4,
}

#[derive(Clone, Copy, Debug)]
enum Property {
    Translation,
    Rotation,
    Scale,
}

/// One property of one node over time.
#[derive(Clone, Debug)]
struct Channel {
    node: usize,
    property: Property,
    interpolation: Interpolation,
    /// The times of the values, rising, s.
    times: Vec<f32>,
    /// One value per time; for cubic splines three: tangent in, value, tangent out.
    values: Vec<Vec4>,
}

/// An animated object. Its coordinates are glTF's: x right, y up, z towards the viewer.
#[derive(Clone, Debug, Default)]
pub struct Object {
    /// The corners of all triangles.
    pub vertices: Vec<Vertex>,
    /// The indices of the corners, three per triangle.
    pub indices: Vec<u32>,
    /// The parts that are drawn.
    pub parts: Vec<Part>,
    /// Images that the materials use.
    pub textures: Vec<Texture>,
    /// Notes for the user about how the object was read, a sentence each.
    pub notes: Vec<String>,
    nodes: Vec<Node>,
    joints: Vec<Joint>,
    channels: Vec<Channel>,
    /// The time after which the animation starts again, s; 0: nothing moves.
    duration: f32,
}

impl Object {
    /// The joints' matrices in a frame and in the one `step` seconds later. The animation starts again at its end; over that seam, where
    /// the object may jump, its last motion is extrapolated, so that the jump does not count as motion.
    pub fn moving(&self, seconds: f64, step: f64) -> [Vec<Mat4>; 2] {
        let duration = f64::from(self.duration);
        if duration <= 0.0 {
            let joints = self.joints(0.0);
            return [joints.clone(), joints];
        }
        let time = seconds % duration;
        let now = self.joints(time as f32);
        let next = if time + step <= duration {
            self.joints((time + step) as f32)
        } else {
            let before = self.joints((time - step) as f32);
            now.iter().zip(&before).map(|(&now, &before)| 2.0 * now - before).collect()
        };
        [now, next]
    }

    /// The number of joints.
    pub fn joint_count(&self) -> usize {
        self.joints.len()
    }

    /// The joints' matrices at a time of the animation, s.
    fn joints(&self, time: f32) -> Vec<Mat4> {
        let mut local: Vec<Transform> = self.nodes.iter().map(|n| n.rest).collect();
        for channel in &self.channels {
            channel.apply(time, &mut local[channel.node]);
        }
        let mut global: Vec<Mat4> = Vec::with_capacity(local.len());
        for (node, local) in self.nodes.iter().zip(&local) {
            let parent = node.parent.map_or(Mat4::IDENTITY, |p| global[p]);
            global.push(parent * local.matrix());
        }
        self.joints.iter().map(|j| global[j.node] * j.inverse_bind).collect()
    }

    /// The matrix that puts the object's foot on the origin and makes its longest side 1. The longest side is looked for throughout the
    /// animation, since an object may grow out of a point; the foot is that at the first time at which the object has at least half of the
    /// size. Beside it, half the widths along x and z of the part of the object that is near the ground, as shares of its longest side: their
    /// means over the animation.
    pub fn standing(&self) -> (Mat4, Vec2) {
        let looks = if self.duration > 0.0 { UNIT_LOOKS } else { 0 };
        let side = |[low, high]: [Vec3; 2]| (high - low).max_element();
        let looks: Vec<Look> = (0..=looks)
            .map(|i| self.look(self.duration * f32::from(i) / f32::from(UNIT_LOOKS)))
            .filter(|l| side(l.bounds).is_finite())
            .collect();
        let longest = looks.iter().map(|l| side(l.bounds)).fold(0.0, f32::max);
        let grown: Vec<&Look> =
            looks.iter().filter(|l| longest > 0.0 && side(l.bounds) >= 0.5 * longest).collect();
        let Some(Look { bounds: [low, high], .. }) = grown.first() else {
            return (Mat4::IDENTITY, Vec2::ZERO);
        };
        let foot = Vec3::new(0.5 * (low.x + high.x), low.y, 0.5 * (low.z + high.z));
        let unit = Mat4::from_scale(Vec3::splat(longest.recip())) * Mat4::from_translation(-foot);
        let on_ground = grown.iter().map(|l| l.on_ground).sum::<Vec2>() / grown.len() as f32;
        (unit, on_ground / longest)
    }

    /// Measures the object at a time of the animation, s.
    fn look(&self, time: f32) -> Look {
        let joints = self.joints(time);
        let positions = || {
            self.parts.iter().flat_map(|part| {
                let corners = &self.indices[part.indices.start as usize..part.indices.end as usize];
                corners.iter().map(|&i| {
                    let vertex = &self.vertices[i as usize];
                    (0..4)
                        .map(|i| {
                            let joint = joints[(part.first_joint + vertex.joints[i]) as usize];
                            vertex.weights[i] * joint.transform_point3(vertex.position.into())
                        })
                        .sum::<Vec3>()
                })
            })
        };
        let around = |bounds: [Vec3; 2], p: Vec3| [bounds[0].min(p), bounds[1].max(p)];
        let nothing = [Vec3::INFINITY, Vec3::NEG_INFINITY];
        let bounds @ [low, high] = positions().fold(nothing, around);
        let near = low.y + NEAR_GROUND * (high.y - low.y);
        let [left, right] = positions().filter(|p| p.y <= near).fold(nothing, around);
        Look { bounds, on_ground: 0.5 * Vec2::new(right.x - left.x, right.z - left.z) }
    }

    /// A ring that rolls on the spot, with a ball that circles it: the object that is shown without a file.
    pub fn built_in() -> Self {
        const SECONDS: f32 = 4.0;
        const STEPS: u16 = 16;
        let mut object = Self { duration: SECONDS, ..Self::default() };
        let node =
            |parent, translation| Node { parent, rest: Transform { translation, ..Transform::IDENTITY } };
        object.nodes = vec![
            node(None, Vec3::new(0.0, 0.5, 0.0)),
            node(None, Vec3::new(0.0, 0.5, 0.0)),
            node(Some(1), Vec3::X * 0.42),
        ];
        let times: Vec<f32> = (0..=STEPS).map(|i| SECONDS * f32::from(i) / f32::from(STEPS)).collect();
        let turning = |node, turn: &dyn Fn(f32) -> Quat| Channel {
            node,
            property: Property::Rotation,
            interpolation: Interpolation::Linear,
            values: times.iter().map(|t| turn(TAU * t / SECONDS).into()).collect(),
            times: times.clone(),
        };
        let channels = vec![
            turning(0, &|a| Quat::from_euler(EulerRot::YXZ, a, 0.35 * a.sin(), 0.0)),
            turning(1, &|a| Quat::from_euler(EulerRot::ZYX, 0.4, -2.0 * a, 0.0)),
        ];
        object.channels = channels;
        let ring = |[u, v]: [f32; 2]| {
            let (a, b) = (TAU * u, TAU * v);
            let out = Vec3::new(a.cos(), a.sin(), 0.0);
            let normal = out * b.cos() + Vec3::Z * b.sin();
            (0.34 * out + 0.13 * normal, normal)
        };
        let ball = |[u, v]: [f32; 2]| {
            let (a, b) = (TAU * u, 0.5 * TAU * v);
            let normal = Vec3::new(a.cos() * b.sin(), b.cos(), a.sin() * b.sin());
            (0.08 * normal, normal)
        };
        let stripes = |[u, v]: [f32; 2]| {
            let odd = ((12.0 * u) as u32 + (4.0 * v) as u32) % 2 == 1;
            if odd { [0.75, 0.12, 0.05, 1.0] } else { [0.8, 0.75, 0.65, 1.0] }
        };
        let material = |metallic, roughness| Material { metallic, roughness, ..Material::default() };
        object.add_surface(0, [96, 32], &ring, &stripes, material(0.0, 0.35));
        object.add_surface(2, [32, 16], &ball, &|_| [0.9, 0.65, 0.25, 1.0], material(1.0, 0.3));
        object
    }

    /// Adds a surface over [0, 1] x [0, 1] in quads of one colour each.
    fn add_surface(
        &mut self,
        node: usize,
        [columns, rows]: [u16; 2],
        place: &dyn Fn([f32; 2]) -> (Vec3, Vec3),
        color: &dyn Fn([f32; 2]) -> [f32; 4],
        material: Material,
    ) {
        let start = self.indices.len() as u32;
        let at = |x: f32, y: f32| [x / f32::from(columns), y / f32::from(rows)];
        for (x, y) in (0..rows).flat_map(|y| (0..columns).map(move |x| (f32::from(x), f32::from(y)))) {
            let first = self.vertices.len() as u32;
            let color = color(at(x + 0.5, y + 0.5));
            for uv in [at(x, y), at(x + 1.0, y), at(x + 1.0, y + 1.0), at(x, y + 1.0)] {
                let (position, normal) = place(uv);
                let (position, normal) = (position.into(), normal.into());
                let weights = [1.0, 0.0, 0.0, 0.0];
                self.vertices.push(Vertex { position, normal, uv, color, joints: [0; 4], weights });
            }
            self.indices.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
        }
        let first_joint = self.joints.len() as u32;
        self.joints.push(Joint { node, inverse_bind: Mat4::IDENTITY });
        self.parts.push(Part { indices: start..self.indices.len() as u32, material, first_joint });
    }

    /// Reads the default scene of a .glb or .gltf file with its first animation: nodes that move, and skins. Of materials the
    /// base colour with its texture and the factors of metallic-roughness are used.
    ///
    /// # Errors
    /// If the file is missing, damaged, or has no triangles.
    #[cfg(feature = "files")]
    pub fn load(path: &std::path::Path) -> blindaug_io::Result<Self> {
        // The parser does not check everything in a file, so it may panic.
        blindaug_io::guarded(path, || {
            let bytes = blindaug_io::read_file(path, MAX_BYTES)?;
            let read = |uri: &str, most| crate::beside::read(path, uri, most);
            Self::from_bytes(&bytes, &read).map_err(|e| blindaug_io::Error::new(path, e.to_string()))
        })
    }

    /// Reads an object, as [`Object::load`] does, from the bytes of a file, and by `beside` what the file refers to.
    ///
    /// # Errors
    /// If the bytes are damaged, or have no triangles.
    ///
    /// # Panics
    /// Of some damaged files, in which the parser does not check everything.
    pub fn from_bytes(bytes: &[u8], beside: &ReadBeside) -> Result<Self> {
        let Gltf { document, blob } = Gltf::from_slice(bytes).map_err(|e| {
            let e = one_line(&e.to_string());
            Error::new(format!("not a glTF file that can be read, or a damaged one ({e})"))
        })?;
        let given = bytes.len() as u64;
        if given > MAX_BYTES {
            return Err(too_large());
        }
        let mut reader = Reader::new(beside, &document, given);
        reader.read_buffers(blob)?;
        reader.object()
    }
}

/// The error of an object that takes more memory than there may be.
fn too_large() -> Error {
    Error::new(format!(
        "the object takes more than {} GB; reduce its triangles, textures or animations",
        MAX_BYTES as f64 / 2f64.powi(30)
    ))
}

impl Channel {
    fn apply(&self, time: f32, transform: &mut Transform) {
        let value = self.at(time);
        match self.property {
            Property::Translation => transform.translation = value.truncate(),
            Property::Rotation => transform.rotation = Quat::from_vec4(value).normalize(),
            Property::Scale => transform.scale = value.truncate(),
        }
    }

    /// The value at a time: the first one before the first time, the last one after the last.
    fn at(&self, time: f32) -> Vec4 {
        let after = self.times.partition_point(|&t| t <= time);
        let cubic = self.interpolation == Interpolation::CubicSpline;
        let value = |i: usize| if cubic { self.values[3 * i + 1] } else { self.values[i] };
        if after == 0 || after == self.times.len() {
            return value(after.saturating_sub(1));
        }
        let (a, b) = (value(after - 1), value(after));
        let span = self.times[after] - self.times[after - 1];
        let t = (time - self.times[after - 1]) / span;
        match (self.interpolation, self.property) {
            (Interpolation::Step, _) => a,
            (Interpolation::Linear, Property::Rotation) => {
                Quat::from_vec4(a).normalize().slerp(Quat::from_vec4(b).normalize(), t).into()
            }
            (Interpolation::Linear, _) => a.lerp(b, t),
            (Interpolation::CubicSpline, _) => {
                let (out, into) = (span * self.values[3 * after - 1], span * self.values[3 * after]);
                let (t2, t3) = (t * t, t * t * t);
                a * (2.0 * t3 - 3.0 * t2 + 1.0)
                    + out * (t3 - 2.0 * t2 + t)
                    + b * (3.0 * t2 - 2.0 * t3)
                    + into * (t3 - t2)
            }
        }
    }
}

#[cfg(test)]
impl Object {
    /// A square that faces the camera and does not move.
    pub fn square(material: Material) -> Self {
        let nodes = vec![Node { parent: None, rest: Transform::IDENTITY }];
        let mut object = Self { nodes, ..Self::default() };
        object.add_surface(0, [1, 1], &|[u, v]| (Vec3::new(u, v, 0.0), Vec3::Z), &|_| [1.0; 4], material);
        object
    }
}
