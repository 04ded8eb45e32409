//! The object: triangles, materials and an animation, from a glTF file or made here.

use blindaug::{Error, Result, text::one_line};
use bytemuck::{Pod, Zeroable};
use glam::{EulerRot, Mat4, Quat, Vec2, Vec3, Vec4};
use gltf::{
    Accessor, Document, Gltf, Semantic,
    accessor::sparse::IndexType,
    animation::{Interpolation, util::ReadOutputs},
    buffer::{self, View},
    mesh::Mode,
};
use image::{DynamicImage, ImageFormat, ImageReader};
use std::{f32::consts::TAU, io::Cursor, ops::Range};

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

/// The most parts of an object, each of which takes a draw call.
const MAX_PARTS: usize = 1 << 14;

/// The most memory that a file with all that belongs to it may take, bytes: in a page, which has 4 GB at most, less.
pub const MAX_BYTES: u64 = if cfg!(target_pointer_width = "32") { 1 << 29 } else { 1 << 31 };

/// The largest side of a texture, px, and its most texels.
const MAX_SIDE: u32 = 16_384;
const MAX_TEXELS: u64 = 1 << 27;

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

/// A glTF file with its buffers.
struct Reader<'a> {
    beside: &'a ReadBeside<'a>,
    document: &'a Document,
    buffers: Vec<Vec<u8>>,
    object: Object,
    /// The index in the object of each of the file's nodes.
    nodes: Vec<Option<usize>>,
    /// The index in the object of each of the file's images.
    images: Vec<Option<usize>>,
    /// The length of the file and of the data that it refers to, bytes.
    given: u64,
    /// The memory that may still be taken, bytes.
    left: u64,
}

impl<'a> Reader<'a> {
    /// A reader for a document from a file of `bytes` bytes.
    fn new(beside: &'a ReadBeside<'a>, document: &'a Document, bytes: u64) -> Self {
        Self {
            beside,
            document,
            buffers: Vec::new(),
            object: Object::default(),
            nodes: vec![None; document.nodes().len()],
            images: vec![None; document.images().len()],
            given: bytes,
            left: MAX_BYTES - bytes,
        }
    }

    fn read_buffers(&mut self, mut blob: Option<Vec<u8>>) -> Result<()> {
        for buffer in self.document.buffers() {
            let bytes = match buffer.source() {
                buffer::Source::Bin => blob
                    .take()
                    .ok_or_else(|| self.fail("the file is damaged (its binary part is missing)"))?,
                buffer::Source::Uri(uri) => self.beside("buffer", uri)?,
            };
            if bytes.len() < buffer.length() {
                return Err(self.fail("the file is damaged (one of its buffers is cut short)"));
            }
            self.buffers.push(bytes);
        }
        Ok(())
    }

    /// The bytes that the file names by a URI. Messages call them `what`.
    fn beside(&mut self, what: &str, uri: &str) -> Result<Vec<u8>> {
        let bytes = (self.beside)(uri, self.left).map_err(|why| {
            let name = if uri.starts_with("data:") { "in it".into() } else { one_line(uri) };
            self.fail(&format!("its {what} {name} {why}"))
        })?;
        self.take(bytes.len() as u64)?;
        self.given += bytes.len() as u64;
        Ok(bytes)
    }

    fn fail(&self, sentence: &str) -> Error {
        Error::new(sentence)
    }

    /// Counts `bytes` bytes of memory as taken.
    fn take(&mut self, bytes: u64) -> Result<()> {
        let left = self.left.checked_sub(bytes).ok_or_else(too_large)?;
        self.left = left;
        Ok(())
    }

    /// Counts the memory of an accessor's values, `each` bytes per value, as taken, and checks that the values are there.
    fn check(&mut self, accessor: Option<Accessor>, each: usize) -> Result<()> {
        let Some(accessor) = accessor else { return Ok(()) };
        let count = accessor.count() as u64;
        self.take(count.saturating_mul(each as u64))?;
        let size = accessor.size();
        let mut there =
            accessor.view().is_none_or(|view| self.is_there(&view, accessor.offset(), count, size));
        if let Some(sparse) = accessor.sparse() {
            let (changed, indices, values) = (sparse.count() as u64, sparse.indices(), sparse.values());
            let index = match indices.index_type() {
                IndexType::U8 => 1,
                IndexType::U16 => 2,
                IndexType::U32 => 4,
            };
            there &= changed <= count
                && self.is_there(&indices.view(), indices.offset(), changed, index)
                && self.is_there(&values.view(), values.offset(), changed, size);
            // All other values are zero; there may be no more of them than the file has bytes.
            there &= accessor.view().is_some() || count <= self.given;
        }
        if there {
            Ok(())
        } else {
            Err(self.fail("the file is damaged (values that are not in its buffers)"))
        }
    }

    /// Whether `count` values of `size` bytes, at least one value, lie in a view.
    fn is_there(&self, view: &View, offset: usize, count: u64, size: usize) -> bool {
        let stride = view.stride().unwrap_or(size);
        let end = || -> Option<u64> {
            let last = (stride as u64).checked_mul(count.checked_sub(1)?)?;
            last.checked_add(size as u64)?.checked_add(offset as u64)
        };
        let buffer = self.buffers.get(view.buffer().index()).map_or(0, Vec::len);
        stride >= size
            && end().is_some_and(|end| end <= view.length() as u64)
            && view.offset().checked_add(view.length()).is_some_and(|end| end <= buffer)
    }

    fn object(mut self) -> Result<Object> {
        let document = self.document;
        let Some(scene) = document.default_scene().or(document.scenes().next()) else {
            return Err(self.fail("there is no scene in it"));
        };
        let mut order = Vec::new();
        let mut waiting: Vec<(gltf::Node, Option<usize>)> = scene.nodes().map(|n| (n, None)).collect();
        while let Some((node, parent)) = waiting.pop() {
            if self.nodes[node.index()].is_some() {
                return Err(self.fail("the file is damaged (a node has two parents)"));
            }
            let (translation, rotation, scale) = node.transform().decomposed();
            let rest = Transform {
                translation: translation.into(),
                rotation: Quat::from_array(rotation),
                scale: scale.into(),
            };
            let index = self.object.nodes.len();
            self.nodes[node.index()] = Some(index);
            self.object.nodes.push(Node { parent, rest });
            waiting.extend(node.children().map(|child| (child, Some(index))));
            order.push(node);
        }
        for node in &order {
            self.add_meshes(node)?;
        }
        if self.object.indices.is_empty() {
            return Err(self.fail("there are no triangles in its scene"));
        }
        if let Some(animation) = document.animations().next() {
            self.add_animation(&animation)?;
        }
        if document.animations().len() > 1 {
            self.object
                .notes
                .push(format!("of its {} animations the first one is played", document.animations().len()));
        }
        Ok(self.object)
    }

    fn add_meshes(&mut self, node: &gltf::Node) -> Result<()> {
        let Some(mesh) = node.mesh() else { return Ok(()) };
        let first_joint = self.object.joints.len() as u32;
        let Some(own) = self.nodes[node.index()] else { return Ok(()) };
        let joints = node.skin().map_or(1, |s| s.joints().len());
        self.take((size_of::<Joint>() * joints) as u64)?;
        match node.skin() {
            None => self.object.joints.push(Joint { node: own, inverse_bind: Mat4::IDENTITY }),
            Some(skin) => {
                self.check(skin.inverse_bind_matrices(), size_of::<Mat4>())?;
                let buffers = &self.buffers;
                let reader = skin.reader(|b| buffers.get(b.index()).map(|d| d.as_slice()));
                let mut inverse_binds = reader.read_inverse_bind_matrices().into_iter().flatten();
                for joint in skin.joints() {
                    let Some(node) = self.nodes[joint.index()] else {
                        return Err(self.fail("the file is damaged (a skin's joint is not in its scene)"));
                    };
                    let inverse_bind =
                        inverse_binds.next().map_or(Mat4::IDENTITY, |m| Mat4::from_cols_array_2d(&m));
                    self.object.joints.push(Joint { node, inverse_bind });
                }
            }
        }
        let joints = self.object.joints.len() as u32 - first_joint;
        if joints == 0 {
            return Err(self.fail("the file is damaged (a skin without joints)"));
        }
        for primitive in mesh.primitives() {
            self.take(size_of::<Part>() as u64)?;
            let mut note = |sentence: &str| {
                if !self.object.notes.iter().any(|n| n == sentence) {
                    self.object.notes.push(sentence.into());
                }
            };
            if primitive.mode() != Mode::Triangles {
                note("lines, points, strips and fans are not shown");
                continue;
            }
            if primitive.morph_targets().len() > 0 {
                note("morph targets are not moved");
            }
            if primitive.material().alpha_mode() == gltf::material::AlphaMode::Blend {
                note("transparent surfaces are shown as opaque ones where their alpha is over 0.5");
            }
            let material = self.material(&primitive.material())?;
            self.add_triangles(&primitive, material, (first_joint, joints))?;
        }
        Ok(())
    }

    // This function is long, since it checks and reads each attribute of a vertex in turn.
    fn add_triangles(
        &mut self,
        primitive: &gltf::Primitive,
        material: Material,
        (first_joint, joint_count): (u32, u32),
    ) -> Result<()> {
        let texture = primitive.material().pbr_metallic_roughness().base_color_texture();
        let texture_set = texture.map_or(0, |texture| texture.tex_coord());
        self.check(primitive.get(&Semantic::Positions), size_of::<Vertex>())?;
        self.check(primitive.indices(), size_of::<u32>())?;
        for semantic in [
            Semantic::TexCoords(texture_set),
            Semantic::Colors(0),
            Semantic::Joints(0),
            Semantic::Weights(0),
            Semantic::Normals,
        ] {
            self.check(primitive.get(&semantic), 1)?;
        }
        let buffers = &self.buffers;
        let reader = primitive.reader(|b| buffers.get(b.index()).map(|d| d.as_slice()));
        let Some(positions) = reader.read_positions() else {
            return Err(self.fail("the file is damaged (triangles without positions)"));
        };
        let mut vertices: Vec<Vertex> = positions
            .map(|position| Vertex {
                position,
                color: [1.0; 4],
                weights: [1.0, 0.0, 0.0, 0.0],
                ..Vertex::default()
            })
            .collect();
        let corners: Vec<u32> = match reader.read_indices() {
            Some(indices) => indices.into_u32().collect(),
            None => (0..vertices.len() as u32).collect(),
        };
        let finite = vertices.iter().all(|v| v.position.iter().all(|v| v.is_finite()));
        if !finite || corners.iter().any(|&i| i as usize >= vertices.len()) {
            return Err(self.fail("the file is damaged (triangles with corners that are not there)"));
        }
        for (vertex, uv) in vertices
            .iter_mut()
            .zip(reader.read_tex_coords(texture_set).into_iter().flat_map(|t| t.into_f32()))
        {
            vertex.uv = uv;
        }
        for (vertex, color) in
            vertices.iter_mut().zip(reader.read_colors(0).into_iter().flat_map(|c| c.into_rgba_f32()))
        {
            vertex.color = color;
        }
        if joint_count > 1
            && let (Some(joints), Some(weights)) = (reader.read_joints(0), reader.read_weights(0))
        {
            for (vertex, (joints, weights)) in
                vertices.iter_mut().zip(joints.into_u16().zip(weights.into_f32()))
            {
                (vertex.joints, vertex.weights) = (joints.map(u32::from), weights);
            }
            if vertices.iter().any(|v| v.joints.iter().any(|&j| j >= joint_count)) {
                return Err(self.fail("the file is damaged (a corner is moved by a joint that is not there)"));
            }
        }
        match reader.read_normals() {
            Some(normals) => vertices.iter_mut().zip(normals).for_each(|(v, normal)| v.normal = normal),
            None => add_normals(&mut vertices, &corners),
        }
        let numbers = |v: &Vertex| {
            v.normal.iter().chain(&v.uv).chain(&v.color).chain(&v.weights).all(|v| v.is_finite())
        };
        if !vertices.iter().all(numbers) {
            return Err(self.fail(
                "the file is damaged (normals, colours, weights or texture coordinates that are not numbers)",
            ));
        }
        for vertex in &mut vertices {
            let sum: f32 = vertex.weights.iter().sum();
            vertex.weights = if sum > 0.0 { vertex.weights.map(|w| w / sum) } else { [1.0, 0.0, 0.0, 0.0] };
            vertex.normal = Vec3::from(vertex.normal).normalize_or_zero().into();
        }
        let (first, start) = (self.object.vertices.len() as u32, self.object.indices.len() as u32);
        let indices = start..start + corners.len() as u32 / 3 * 3;
        // Each part takes a draw call, so triangles of the same material as the part before are added to it.
        let parts = &mut self.object.parts;
        let full = parts.len() == MAX_PARTS;
        match parts.last_mut().filter(|part| part.material == material) {
            Some(part) => {
                let joints_between = first_joint - part.first_joint;
                vertices.iter_mut().for_each(|v| v.joints = v.joints.map(|j| j + joints_between));
                part.indices.end = indices.end;
            }
            None if full => {
                return Err(self.fail("the object has too many parts; join those of one material"));
            }
            None => parts.push(Part { indices, material, first_joint }),
        }
        self.object.vertices.append(&mut vertices);
        self.object.indices.extend(corners.as_chunks::<3>().0.as_flattened().iter().map(|i| first + i));
        Ok(())
    }

    fn material(&mut self, material: &gltf::Material) -> Result<Material> {
        let pbr = material.pbr_metallic_roughness();
        let alpha_cutoff = match material.alpha_mode() {
            gltf::material::AlphaMode::Opaque => 0.0,
            _ => material.alpha_cutoff().unwrap_or(0.5),
        };
        let texture = pbr.base_color_texture().map(|t| self.texture(&t.texture().source())).transpose()?;
        Ok(Material {
            base_color: pbr.base_color_factor(),
            metallic: pbr.metallic_factor(),
            roughness: pbr.roughness_factor(),
            alpha_cutoff,
            texture,
        })
    }

    fn texture(&mut self, image: &gltf::Image) -> Result<usize> {
        if let Some(known) = self.images[image.index()] {
            return Ok(known);
        }
        let texture = match image.source() {
            gltf::image::Source::Uri { uri, .. } => {
                let bytes = self.beside("texture", uri)?;
                self.decoded(&bytes)?
            }
            gltf::image::Source::View { view, .. } => {
                let range = view.offset()..view.offset().saturating_add(view.length());
                let bytes = self.buffers.get(view.buffer().index()).and_then(|b| b.get(range));
                let missing = || self.fail("the file is damaged (a texture that is not in its buffers)");
                self.decoded(bytes.ok_or_else(missing)?)?
            }
        };
        self.take(texture.texels.len() as u64)?;
        let index = self.object.textures.len();
        self.object.textures.push(texture);
        self.images[image.index()] = Some(index);
        Ok(index)
    }

    /// Decodes a picture after a check of its size.
    fn decoded(&self, bytes: &[u8]) -> Result<Texture> {
        let fail = |e: &dyn std::fmt::Display| {
            self.fail(&format!("one of its textures cannot be read ({})", one_line(&e.to_string())))
        };
        let Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) = image::guess_format(bytes) else {
            return Err(self.fail("one of its textures is neither PNG nor JPEG; save it as one of them"));
        };
        let reader = || ImageReader::with_format(Cursor::new(bytes), format);
        let (width, height) = reader().into_dimensions().map_err(|e| fail(&e))?;
        let texels = u64::from(width) * u64::from(height);
        if width.max(height) > MAX_SIDE || texels > MAX_TEXELS || 4 * texels > self.left {
            return Err(self.fail(&format!(
                "one of its textures is too large ({width} x {height} pixels; at most {MAX_SIDE} a side are read)"
            )));
        }
        use DynamicImage::{ImageLuma8, ImageLumaA8, ImageRgb8, ImageRgba8};
        let image = reader().decode().map_err(|e| fail(&e))?;
        if !matches!(image, ImageLuma8(_) | ImageLumaA8(_) | ImageRgb8(_) | ImageRgba8(_)) {
            return Err(self.fail("one of its textures has more than 8 bit; save it with 8 bit"));
        }
        Ok(Texture { size: [width, height], texels: image.into_rgba8().into_raw() })
    }

    fn add_animation(&mut self, animation: &gltf::Animation) -> Result<()> {
        for channel in animation.channels() {
            self.take(size_of::<Channel>() as u64)?;
            self.check(Some(channel.sampler().input()), size_of::<f32>())?;
            self.check(Some(channel.sampler().output()), size_of::<Vec4>())?;
            let buffers = &self.buffers;
            let Some(node) = self.nodes[channel.target().node().index()] else { continue };
            let reader = channel.reader(|b| buffers.get(b.index()).map(|d| d.as_slice()));
            let (Some(times), Some(values)) = (reader.read_inputs(), reader.read_outputs()) else {
                return Err(self.fail("the file is damaged (an animation without values)"));
            };
            let times: Vec<f32> = times.collect();
            let vector = |v: [f32; 3]| Vec3::from(v).extend(0.0);
            let (property, values): (_, Vec<Vec4>) = match values {
                ReadOutputs::Translations(v) => (Property::Translation, v.map(vector).collect()),
                ReadOutputs::Rotations(v) => (Property::Rotation, v.into_f32().map(Vec4::from).collect()),
                ReadOutputs::Scales(v) => (Property::Scale, v.map(vector).collect()),
                // The note about morph targets was made with the mesh.
                ReadOutputs::MorphTargetWeights(_) => continue,
            };
            let interpolation = channel.sampler().interpolation();
            let wanted =
                if interpolation == Interpolation::CubicSpline { 3 * times.len() } else { times.len() };
            let rising = times.iter().all(|t| t.is_finite()) && times.is_sorted_by(|a, b| a < b);
            if times.is_empty() || !rising || values.len() != wanted || values.iter().any(|v| !v.is_finite())
            {
                return Err(self.fail("the file is damaged (an animation's times and values do not fit)"));
            }
            self.object.duration = self.object.duration.max(times[times.len() - 1]);
            self.object.channels.push(Channel { node, property, interpolation, times, values });
        }
        Ok(())
    }
}

/// Adds to each corner the normals of the triangles around it, weighted by their areas.
fn add_normals(vertices: &mut [Vertex], corners: &[u32]) {
    for triangle in corners.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|i| Vec3::from(vertices[triangle[i] as usize].position));
        let normal = (b - a).cross(c - a);
        for &i in triangle {
            let vertex = &mut vertices[i as usize];
            vertex.normal = (Vec3::from(vertex.normal) + normal).into();
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

#[cfg(all(test, feature = "files"))]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_built_in_object_starts_again_without_a_jump_and_is_brought_to_unit_size() {
        let object = Object::built_in();
        let apart = |a: f32, b: f32| {
            let difference = |(a, b): (&Mat4, &Mat4)| {
                (*a - *b).to_cols_array().iter().map(|v| v.abs()).fold(0.0, f32::max)
            };
            object.joints(a).iter().zip(&object.joints(b)).map(difference).fold(0.0, f32::max)
        };
        assert!(apart(0.0, 3.9999) < 1e-3 && apart(0.0, 4.0) < 1e-6 && apart(0.5, 1.0) > 0.1);
        let unit = object.standing().0;
        let corners = object.vertices.iter().map(|v| unit.transform_point3(v.position.into()));
        assert!(corners.fold(0.0f32, |m, p| m.max(p.abs().max_element())) < 2.0);
    }

    /// A triangle that a joint moves 1 m to the right within 2 s.
    fn file() -> Vec<u8> {
        let mut binary = Vec::new();
        let mut views = Vec::new();
        let mut add = |bytes: &[u8]| {
            views.push(format!(
                r#"{{"buffer":0,"byteOffset":{},"byteLength":{}}}"#,
                binary.len(),
                bytes.len()
            ));
            binary.extend_from_slice(bytes);
        };
        let floats = |values: &[f32]| bytemuck::cast_slice::<_, u8>(values).to_vec();
        add(&floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]));
        add(&floats(&[0.0, 2.0]));
        add(&floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]));
        add(&[0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0]);
        add(&floats(&[1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]));
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0,1]}}],
            "nodes":[{{"mesh":0,"skin":0}},{{"children":[2]}},{{}}],
            "skins":[{{"joints":[1,2]}}],
            "materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[0.5,0.25,0.125,1],"metallicFactor":0}}}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"JOINTS_0":3,"WEIGHTS_0":4}},"material":0}}]}}],
            "animations":[{{"samplers":[{{"input":1,"output":2}}],"channels":[{{"sampler":0,"target":{{"node":2,"path":"translation"}}}}]}}],
            "buffers":[{{"byteLength":{}}}],"bufferViews":[{}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
            {{"bufferView":1,"componentType":5126,"count":2,"type":"SCALAR","min":[0],"max":[2]}},
            {{"bufferView":2,"componentType":5126,"count":2,"type":"VEC3"}},
            {{"bufferView":3,"componentType":5121,"count":3,"type":"VEC4"}},
            {{"bufferView":4,"componentType":5126,"count":3,"type":"VEC4"}}]}}"#,
            binary.len(),
            views.join(",")
        );
        let mut json = json.into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let length = |n: usize| (n as u32).to_le_bytes();
        let mut file = b"glTF\x02\0\0\0".to_vec();
        file.extend(length(12 + 8 + json.len() + 8 + binary.len()));
        for (kind, chunk) in [(b"JSON", json), (b"BIN\0", binary)] {
            file.extend(length(chunk.len()));
            file.extend(kind);
            file.extend(chunk);
        }
        file
    }

    #[test]
    fn a_skin_in_a_file_moves_as_it_says() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("skin.glb");
        std::fs::write(&path, file()).unwrap();
        let object = Object::load(&path).unwrap();
        assert_eq!((object.parts.len(), object.indices.len(), object.notes.len()), (1, 3, 0));
        assert_eq!(object.parts[0].material.base_color, [0.5, 0.25, 0.125, 1.0]);
        // Both joints have half of the weight, and the second one moves.
        let vertex = object.vertices[1];
        assert_eq!((vertex.joints, vertex.weights), ([0, 1, 0, 0], [0.5, 0.5, 0.0, 0.0]));
        assert_eq!(vertex.normal, [0.0, 0.0, 1.0]);
        for (seconds, x) in [(0.0, 0.0), (0.5, 0.25), (1.5, 0.75), (2.5, 0.25)] {
            let [joints, _] = object.moving(seconds, 0.04);
            assert_eq!((joints[0].w_axis.x, joints[1].w_axis.x), (0.0, x));
        }
        // The jump back at the end does not count as motion.
        let fps = 24.7;
        for frame in 0..200 {
            let [now, next] = object.moving(f64::from(frame) / fps, fps.recip());
            let speed = f64::from(next[1].w_axis.x - now[1].w_axis.x) * fps;
            assert!((speed - 0.5).abs() < 1e-4, "frame {frame}: {speed} m/s");
        }
    }

    #[test]
    fn an_object_that_grows_out_of_a_point_has_the_size_that_it_grows_to() {
        let mut object = Object::square(Material::default());
        let still = object.standing().0;
        object.duration = 2.0;
        object.channels.push(Channel {
            node: 0,
            property: Property::Scale,
            interpolation: Interpolation::Linear,
            times: vec![0.0, 2.0],
            values: vec![Vec4::ZERO, Vec4::splat(3.0)],
        });
        assert_eq!((still.x_axis.x, object.standing().0.x_axis.x), (1.0, 1.0 / 3.0));
        // An object that always is a point has no size.
        object.channels[0].values[1] = Vec4::ZERO;
        assert_eq!(object.standing().0, Mat4::IDENTITY);
    }

    #[test]
    fn damaged_files_end_in_a_sentence() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("hurt.glb");
        let whole = file();
        let load = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            let object = Object::load(&path);
            if let Err(e) = &object {
                let e = e.to_string();
                assert!(e.contains("hurt.glb: ") && !e.contains('\n'), "{e}");
            }
            object
        };
        for i in 0..40 {
            assert!(load(&whole[..whole.len() * i / 40]).is_err());
        }
        // The last number is a weight.
        for number in [f32::NAN, f32::INFINITY] {
            let hurt = [&whole[..whole.len() - 4], &number.to_le_bytes()].concat();
            assert!(load(&hurt).unwrap_err().to_string().contains("not numbers"));
        }
        // Whatever is damaged, an object that is loaded can be drawn.
        let mut random = 1u32;
        let mut next = |n: usize| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 8) as usize % n
        };
        for _ in 0..300 {
            let mut hurt = whole.clone();
            hurt[next(whole.len())] = b"0123456789,[]{}\xff"[next(16)];
            if let Ok(object) = load(&hurt) {
                let joints = object.moving(0.7, 0.1)[1].len() as u32;
                assert!(object.indices.iter().all(|&i| (i as usize) < object.vertices.len()));
                assert!(object.parts.iter().all(|p| p.first_joint < joints && !p.indices.is_empty()));
                object.standing();
            }
        }
    }

    /// The number of corners of a file with this text, or the sentence of the error.
    fn said(folder: &Path, text: &str) -> String {
        let path = folder.join("said.gltf");
        std::fs::write(&path, text).unwrap();
        match Object::load(&path) {
            Ok(object) => format!("{} corners", object.indices.len()),
            Err(e) => {
                let e = e.to_string();
                assert!(e.contains("said.gltf: ") && !e.contains(char::is_control), "{e}");
                e
            }
        }
    }

    /// The text of a file with a triangle and a texture, whose data these URIs name.
    fn text(buffer: &str, texture: &str) -> String {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],
            "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],
            "textures":[{{"source":0}}],"images":[{{"uri":"{texture}"}}],
            "buffers":[{{"byteLength":36,"uri":"{buffer}"}}],"bufferViews":[{{"buffer":0,"byteLength":36}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}]}}"#
        )
    }

    #[test]
    fn only_files_beside_the_object_and_below_are_opened() {
        let outside = tempfile::tempdir().unwrap();
        let folder = outside.path().join("object");
        std::fs::create_dir_all(folder.join("in it")).unwrap();
        let corners: Vec<u8> = bytemuck::cast_slice(&[0f32, 0., 0., 1., 0., 0., 0., 1., 0.]).to_vec();
        let mut picture = Cursor::new(Vec::new());
        image::RgbImage::from_pixel(2, 1, image::Rgb([9, 8, 7]))
            .write_to(&mut picture, ImageFormat::Png)
            .unwrap();
        let picture = picture.into_inner();
        for folder in [outside.path(), &folder, &folder.join("in it")] {
            std::fs::write(folder.join("corners.bin"), &corners).unwrap();
            std::fs::write(folder.join("a picture.png"), &picture).unwrap();
        }
        use base64::{Engine, engine::general_purpose::STANDARD};
        let data = |bytes: &[u8]| format!("data:;base64,{}", STANDARD.encode(bytes));
        for buffer in ["corners.bin", "./corners.bin", "in%20it/corners.bin", &data(&corners)] {
            for texture in ["a%20picture.png", "in it/a%20picture.png", &data(&picture)] {
                assert_eq!(said(&folder, &text(buffer, texture)), "3 corners", "{buffer} {texture}");
            }
        }
        let absolute = outside.path().join("corners.bin");
        let absolute = absolute.to_str().unwrap();
        let away =
            ["../corners.bin", "in it/../corners.bin", "%2e%2e/corners.bin", "..%2fcorners.bin", absolute];
        let schemes = [format!("file://{absolute}"), format!("file:{absolute}"), "file%3Acorners.bin".into()];
        for uri in away.into_iter().chain(schemes.iter().map(String::as_str)) {
            let e = said(&folder, &text(uri, "a%20picture.png"));
            assert!(e.contains("buffer") && e.contains("beside the file or below"), "{e}");
            let e = said(&folder, &text("corners.bin", uri));
            assert!(e.contains("texture") && e.contains("beside the file or below"), "{e}");
        }
        let many = format!("{}.bin", "x".repeat(10_000));
        for (uri, sentence) in [
            (r"none\u001b[31m\n.bin", r"none\u{1b}[31m .bin is not there"),
            ("%zz.bin", "is no URI"),
            (&many, " .. "),
            ("in it", "this is a folder"),
            ("data:;base64,A", "is damaged"),
            ("data:,abc", "not in Base64"),
            ("a%20picture.png%00", "cannot be read"),
        ] {
            let e = said(&folder, &text(uri, "a%20picture.png"));
            assert!(e.contains(sentence) && e.len() < 800, "{e}");
        }
        // One file is not a picture, and one picture is larger than any graphics card takes.
        let e = said(&folder, &text("corners.bin", "corners.bin"));
        assert!(e.contains("neither PNG nor JPEG"), "{e}");
        let mut large = picture.clone();
        large[16..20].copy_from_slice(&60_000u32.to_be_bytes());
        let e = said(&folder, &text("corners.bin", &data(&large)));
        assert!(e.contains("texture"), "{e}");
    }

    #[cfg(unix)]
    #[test]
    fn links_that_lead_away_and_pipes_are_not_opened() {
        use std::os::unix::fs::symlink;
        let outside = tempfile::tempdir().unwrap();
        let folder = outside.path().join("object");
        std::fs::create_dir(&folder).unwrap();
        let away = outside.path().join("corners.bin");
        std::fs::write(&away, [0; 36]).unwrap();
        std::fs::write(folder.join("own.bin"), [0; 36]).unwrap();
        symlink(&away, folder.join("away.bin")).unwrap();
        symlink("own.bin", folder.join("inside.bin")).unwrap();
        symlink(outside.path(), folder.join("up")).unwrap();
        let none = |uri: &str| said(&folder, &text(uri, "none.png"));
        assert!(none("inside.bin").contains("none.png is not there"), "{}", none("inside.bin"));
        for uri in ["away.bin", "up/corners.bin"] {
            assert!(none(uri).contains("is a link to a place"), "{}", none(uri));
        }
        let made = std::process::Command::new("mkfifo").arg(folder.join("pipe")).status();
        if made.is_ok_and(|s| s.success()) {
            assert!(none("pipe").contains("a pipe or a device"), "{}", none("pipe"));
            let e = Object::load(&folder.join("pipe")).unwrap_err().to_string();
            assert!(e.contains("pipe: ") && e.contains("a pipe or a device"), "{e}");
        }
    }

    #[test]
    fn files_that_fuzzing_found_end_in_a_sentence() {
        let folder = tempfile::tempdir().unwrap();
        let found = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fuzz/regressions/gltf");
        for entry in std::fs::read_dir(found).unwrap() {
            let bytes = std::fs::read(entry.unwrap().path()).unwrap();
            let path = folder.path().join("found.glb");
            std::fs::write(&path, bytes).unwrap();
            if let Ok(object) = Object::load(&path) {
                object.moving(0.3, 0.04);
                object.standing();
            }
        }
    }

    #[test]
    fn values_that_are_not_in_the_file_are_not_read() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("corners.bin"), [0; 60]).unwrap();
        let of = |view: &str, count: u64, sparse: &str, stride: &str| {
            format!(
                r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
                "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
                "buffers":[{{"byteLength":60,"uri":"corners.bin"}}],
                "bufferViews":[{{"buffer":0,"byteLength":60{stride}}}],
                "accessors":[{{{view}"componentType":5126,"count":{count},"type":"VEC3","min":[0,0,0],"max":[1,1,0]{sparse}}}]}}"#
            )
        };
        let sparse = |count: u64| {
            format!(
                r#","sparse":{{"count":{count},"indices":{{"bufferView":0,"componentType":5121}},"values":{{"bufferView":0}}}}"#
            )
        };
        let load = |text: &str| said(folder.path(), text);
        let view = r#""bufferView":0,"#;
        assert_eq!(load(&of(view, 3, "", "")), "3 corners");
        assert_eq!(load(&of(view, 3, &sparse(3), "")), "3 corners");
        assert_eq!(load(&of("", 6, &sparse(3), "")), "6 corners");
        for count in [6, 3_000_000_000, u64::MAX] {
            assert!(load(&of(view, count, "", "")).contains("file is damaged") || count > 6);
            assert!(!load(&of(view, count, "", "")).contains("corners"));
            assert!(!load(&of(view, 5, &sparse(count), "")).contains("corners"));
        }
        for count in [5_000, 3_000_000_000, u64::MAX] {
            assert!(!load(&of("", count, &sparse(1), "")).contains("corners"), "{count}");
        }
        // Values that overlap one another are refused.
        assert!(!load(&of(view, 3, "", r#","byteStride":4"#)).contains("corners"));
        assert!(!load(&of(view, 3, "", r#","byteStride":0"#)).contains("corners"));
        let e = load(&of(r#""bufferView":0,"byteOffset":18446744073709551615,"#, 3, "", ""));
        assert!(!e.contains("corners"), "{e}");
    }

    /// An object of `nodes` nodes with a triangle each, the first of which has all others as children.
    fn family(nodes: usize) -> String {
        let children = (1..nodes).map(|i| i.to_string()).collect::<Vec<_>>().join(",");
        let others = r#",{"mesh":0}"#.repeat(nodes - 1);
        text("corners.bin", "none.png")
            .replace(r#","material":0"#, "")
            .replace(r#"[{"mesh":0}]"#, &format!(r#"[{{"mesh":0,"children":[{children}]}}{others}]"#))
    }

    #[test]
    fn many_nodes_and_triangles_that_are_drawn_again_and_again() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("corners.bin"), [0; 36]).unwrap();
        assert_eq!(said(folder.path(), &family(300_000)), "900000 corners");
        // The triangles are drawn at once; where two materials take turns, they cannot be.
        let object = Object::load(&folder.path().join("said.gltf")).unwrap();
        assert_eq!((object.parts.len(), object.joint_count()), (1, 300_000));
        assert_eq!(object.vertices[899_999].joints, [299_999; 4]);
        let turns = r#"{"attributes":{"POSITION":0}},{"attributes":{"POSITION":0},"material":0}"#;
        let turns = family(10_000).replace(r#"{"attributes":{"POSITION":0}}"#, turns);
        let turns = turns.replace(r#""baseColorTexture":{"index":0}"#, r#""metallicFactor":0"#);
        assert!(said(folder.path(), &turns).contains("too many parts"));
        // A mesh of many parts in each of many nodes takes too much memory.
        let part = r#"{"attributes":{"POSITION":0},"mode":0}"#;
        let many = family(30_000).replace(
            r#"{"attributes":{"POSITION":0}}"#,
            &format!("{part}{}", format!(",{part}").repeat(9_999)),
        );
        assert!(said(folder.path(), &many).contains("more than 2 GB"));
    }

    #[test]
    fn values_are_interpolated_as_gltf_says() {
        let channel = |interpolation, values: &[f32]| Channel {
            node: 0,
            property: Property::Translation,
            interpolation,
            times: vec![1.0, 3.0],
            values: values.iter().map(|&v| Vec4::splat(v)).collect(),
        };
        let at = |c: &Channel, times: [f32; 4]| times.map(|t| c.at(t).x);
        assert_eq!(
            at(&channel(Interpolation::Linear, &[2.0, 4.0]), [0.0, 1.0, 1.5, 9.0]),
            [2.0, 2.0, 2.5, 4.0]
        );
        assert_eq!(
            at(&channel(Interpolation::Step, &[2.0, 4.0]), [0.0, 1.0, 2.9, 3.0]),
            [2.0, 2.0, 2.0, 4.0]
        );
        // A straight line, as a spline with tangents of its slope.
        let spline = channel(Interpolation::CubicSpline, &[1.0, 2.0, 1.0, 1.0, 4.0, 1.0]);
        assert_eq!(at(&spline, [0.0, 1.5, 2.0, 3.5]), [2.0, 2.5, 3.0, 4.0]);
    }
}
