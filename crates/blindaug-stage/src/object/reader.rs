//! The reader of glTF files, which checks what the parser does not.

use super::{
    Channel, Joint, MAX_BYTES, Material, Node, Object, Part, Property, ReadBeside, Texture, Transform,
    Vertex, too_large,
};
use blindaug::{Error, Result, text::one_line};
use glam::{Mat4, Quat, Vec3, Vec4};
use gltf::{
    Accessor, Document, Semantic,
    accessor::sparse::IndexType,
    animation::{Interpolation, util::ReadOutputs},
    buffer::{self, View},
    mesh::Mode,
};
use image::{DynamicImage, ImageFormat, ImageReader};
use std::io::Cursor;

/// The most parts of an object, each of which takes a draw call.
const MAX_PARTS: usize = 1 << 14;

/// The largest side of a texture, px, and its most texels.
const MAX_SIDE: u32 = 16_384;
const MAX_TEXELS: u64 = 1 << 27;

/// A glTF file with its buffers.
pub(super) struct Reader<'a> {
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
    pub fn new(beside: &'a ReadBeside<'a>, document: &'a Document, bytes: u64) -> Self {
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

    pub fn read_buffers(&mut self, mut blob: Option<Vec<u8>>) -> Result<()> {
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

    pub fn object(mut self) -> Result<Object> {
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
