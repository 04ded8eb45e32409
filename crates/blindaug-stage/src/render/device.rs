//! Draws the object by a graphics device: its colour, inverse depth and velocity in a frame, each in a texture of the frame's size.

use super::{Moment, SAMPLES, Scene, View};
use crate::object::{Object, Part, Texture, Vertex};
use blindaug::{Error, Result};
use blindaug_gpu::{Gpu, bind, full_screen, texture};
use blindaug_pipeline::live::Pinhole;
use bytemuck::{Pod, Zeroable, bytes_of, cast_slice};
use glam::Mat4;
use wgpu::{
    BindingResource, BufferUsages, TextureFormat, TextureUsages, TextureView,
    util::{BufferInitDescriptor, DeviceExt},
};

/// The formats of colour (premultiplied and scene-linear), inverse depth (1/m) and velocity (px per frame interval).
const FORMATS: [TextureFormat; 3] =
    [TextureFormat::Rgba16Float, TextureFormat::R32Float, TextureFormat::Rg16Float];
const DEPTH: TextureFormat = TextureFormat::Depth32Float;

/// The object in a frame.
#[derive(Clone, Debug)]
pub struct Layer {
    /// The colour, [`TextureFormat::Rgba16Float`]: premultiplied and scene-linear.
    pub color: wgpu::Texture,
    /// The inverse depth, [`TextureFormat::R32Float`], 1/m; [`Layer::NOTHING`] where there is nothing, and more where there is something.
    pub inverse_depth: wgpu::Texture,
    /// The motion to the next frame, [`TextureFormat::Rg16Float`], px, x right, y down.
    pub velocity: wgpu::Texture,
}

impl Layer {
    /// The inverse depth where there is nothing, 1/m.
    pub const NOTHING: f32 = 0.0;
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct PartOnDevice {
    base_color: [f32; 4],
    metallic: f32,
    roughness: f32,
    alpha_cutoff: f32,
    first_joint: u32,
}

/// Draws one object into frames of one size.
pub struct Renderer {
    object: Object,
    view: View,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    scene: wgpu::Buffer,
    joints: wgpu::Buffer,
    group: wgpu::BindGroup,
    /// The bindings of each part's textures.
    textures: Vec<wgpu::BindGroup>,
    surface: wgpu::RenderPipeline,
    shadow: wgpu::RenderPipeline,
    shadow_group: wgpu::BindGroup,
    samples: [TextureView; 3],
    depth: TextureView,
    sample_group: wgpu::BindGroup,
    resolve: wgpu::RenderPipeline,
    layer: Layer,
    layer_views: [TextureView; 3],
}

impl Renderer {
    /// A renderer that draws `object` as `camera` sees it.
    ///
    /// # Errors
    /// If the device cannot hold the object, or textures of twice the frame's size.
    // This function is long, since it lists the pipeline's states and bindings.
    pub fn new(gpu: &Gpu, object: Object, camera: Pinhole) -> Result<Self> {
        let device = &gpu.device;
        let module = device.create_shader_module(wgpu::include_wgsl!("object.wgsl"));
        let buffer = |contents: &[u8], usage| -> Result<wgpu::Buffer> {
            check_fits(contents.len() as u64, usage, &device.limits())?;
            Ok(device.create_buffer_init(&BufferInitDescriptor { label: Some("object"), contents, usage }))
        };
        let parts: Vec<PartOnDevice> = object
            .parts
            .iter()
            .map(|Part { material: m, first_joint, .. }| PartOnDevice {
                base_color: m.base_color,
                metallic: m.metallic,
                roughness: m.roughness,
                alpha_cutoff: m.alpha_cutoff,
                first_joint: *first_joint,
            })
            .collect();
        let joints = object.joint_count() * 2 * size_of::<Mat4>();
        let scene = buffer(&[0; size_of::<Scene>()], BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        let joints = buffer(&vec![0; joints], BufferUsages::STORAGE | BufferUsages::COPY_DST)?;
        let parts = buffer(cast_slice(&parts), BufferUsages::STORAGE)?;
        let attributes = wgpu::vertex_attr_array![
            0 => Float32x3, 1 => Float32x3, 2 => Float32x2, 3 => Float32x4, 4 => Uint32x4, 5 => Float32x4];
        let corners = [Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Vertex>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &attributes,
        })];
        // The object hides its shadow, so that the shadow is drawn first and leaves no depth.
        let pipeline = |[vertex, fragment]: [&str; 2], buffers, hides| {
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("object"),
                layout: None,
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some(vertex),
                    compilation_options: Default::default(),
                    buffers,
                },
                primitive: Default::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(hides),
                    // The near plane has depth 1 and infinity depth 0, so that the relative precision of floats is the same everywhere.
                    depth_compare: Some(wgpu::CompareFunction::Greater),
                    stencil: Default::default(),
                    bias: Default::default(),
                }),
                multisample: Default::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(fragment),
                    compilation_options: Default::default(),
                    targets: &FORMATS.map(|f| Some(f.into())),
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let surface = pipeline(["vertex", "surface"], &corners, true);
        let shadow = pipeline(["ground", "shadow"], &[], false);
        let shadow_group = bind(device, &shadow.get_bind_group_layout(0), &[scene.as_entire_binding()]);
        let group = bind(
            device,
            &surface.get_bind_group_layout(0),
            &[scene.as_entire_binding(), joints.as_entire_binding(), parts.as_entire_binding()],
        );
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let white = Texture { size: [1, 1], texels: vec![255; 4] };
        let images: Vec<TextureView> =
            object.textures.iter().chain([&white]).map(|t| upload(gpu, t)).collect::<Result<_>>()?;
        let textures = object
            .parts
            .iter()
            .map(|part| {
                let image = &images[part.material.texture.unwrap_or(images.len() - 1)];
                let resources = [BindingResource::TextureView(image), BindingResource::Sampler(&sampler)];
                bind(device, &surface.get_bind_group_layout(1), &resources)
            })
            .collect();
        let resolve = full_screen(device, None, &module, "resolved", &FORMATS);
        let (w, h) = camera.size;
        let target = |format, scale, more| {
            let usage = TextureUsages::RENDER_ATTACHMENT | more;
            texture(device, "object", [scale * w, scale * h, 1], format, usage)
        };
        let view = |t: &wgpu::Texture| t.create_view(&Default::default());
        let sampled = |format| Ok(view(&target(format, SAMPLES, TextureUsages::TEXTURE_BINDING)?));
        let samples = [sampled(FORMATS[0])?, sampled(FORMATS[1])?, sampled(FORMATS[2])?];
        let depth = view(&target(DEPTH, SAMPLES, TextureUsages::empty())?);
        let sample_group = bind(
            device,
            &resolve.get_bind_group_layout(0),
            &samples.each_ref().map(BindingResource::TextureView),
        );
        let out = |format| target(format, 1, TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_SRC);
        let layer =
            Layer { color: out(FORMATS[0])?, inverse_depth: out(FORMATS[1])?, velocity: out(FORMATS[2])? };
        let layer_views = [view(&layer.color), view(&layer.inverse_depth), view(&layer.velocity)];
        Ok(Self {
            view: View::new(&object, camera),
            vertices: buffer(cast_slice(&object.vertices), BufferUsages::VERTEX)?,
            indices: buffer(cast_slice(&object.indices), BufferUsages::INDEX)?,
            object,
            scene,
            joints,
            group,
            textures,
            surface,
            shadow,
            shadow_group,
            samples,
            depth,
            sample_group,
            resolve,
            layer,
            layer_views,
        })
    }

    /// The layer that was drawn last.
    pub fn layer(&self) -> &Layer {
        &self.layer
    }

    /// Draws the object at a moment.
    pub fn draw(&self, gpu: &Gpu, moment: &Moment) {
        let joints = self.object.moving(moment.seconds, moment.step).concat();
        gpu.queue.write_buffer(&self.joints, 0, cast_slice(&joints));
        let scene = self.view.scene(moment);
        gpu.queue.write_buffer(&self.scene, 0, bytes_of(&scene));
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("object"),
                color_attachments: &self.samples.each_ref().map(attachment),
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &self.depth,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(0.0),
                        store: wgpu::StoreOp::Discard,
                    }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            pass.set_pipeline(&self.shadow);
            pass.set_bind_group(0, &self.shadow_group, &[]);
            pass.draw(0..6, 0..1);
            pass.set_pipeline(&self.surface);
            pass.set_bind_group(0, &self.group, &[]);
            pass.set_vertex_buffer(0, self.vertices.slice(..));
            pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
            for (i, (part, texture)) in (0..).zip(self.object.parts.iter().zip(&self.textures)) {
                pass.set_bind_group(1, texture, &[]);
                pass.draw_indexed(part.indices.clone(), 0, i..i + 1);
            }
        }
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("resolve"),
                color_attachments: &self.layer_views.each_ref().map(attachment),
                ..Default::default()
            });
            pass.set_pipeline(&self.resolve);
            pass.set_bind_group(0, &self.sample_group, &[]);
            pass.draw(0..3, 0..1);
        }
        gpu.queue.submit([encoder.finish()]);
    }
}

/// Fails if a device with these limits holds no buffer of `bytes` bytes.
fn check_fits(bytes: u64, usage: BufferUsages, limits: &wgpu::Limits) -> Result<()> {
    let most = if usage.contains(BufferUsages::STORAGE) {
        limits.max_buffer_size.min(limits.max_storage_buffer_binding_size)
    } else {
        limits.max_buffer_size
    };
    if bytes <= most {
        return Ok(());
    }
    Err(Error::new(format!(
        "the object is too large for the graphics device ({} MiB at once, of at most {}); give one with fewer triangles or joints",
        bytes.div_ceil(1 << 20),
        most >> 20
    )))
}

/// A colour attachment that is cleared to 0.
pub fn attachment(view: &TextureView) -> Option<wgpu::RenderPassColorAttachment<'_>> {
    Some(wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations {
            load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
            store: wgpu::StoreOp::Store,
        },
    })
}

fn upload(gpu: &Gpu, image: &Texture) -> Result<TextureView> {
    let [w, h] = image.size;
    let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
    let format = TextureFormat::Rgba8UnormSrgb;
    let texture = texture(&gpu.device, "base color", [w as usize, h as usize, 1], format, usage)?;
    gpu.queue.write_texture(
        texture.as_image_copy(),
        &image.texels,
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * w), rows_per_image: Some(h) },
        texture.size(),
    );
    Ok(texture.create_view(&Default::default()))
}

#[cfg(test)]
mod tests {
    use super::super::SHADOW;
    use super::*;
    use crate::{light::Light, object::Material};
    use blindaug::{Flow, Plane, Raster};
    use blindaug_pipeline::live::Pose;
    use glam::{DMat3, DVec3, Vec3};

    const SIZE: (usize, usize) = (64, 48);

    struct Drawn {
        color: Raster<[f32; 4]>,
        inverse_depth: Plane,
        velocity: Flow,
    }

    fn drawn(gpu: &Gpu, object: Object, poses: [Pose; 2], size: f32) -> Drawn {
        let camera = Pinhole::new(SIZE, 50.0);
        let renderer = Renderer::new(gpu, object, camera).unwrap();
        let light = Light::even(0.5);
        renderer.draw(gpu, &Moment { poses, seconds: 0.0, step: 0.04, size, light });
        let Layer { color, inverse_depth, velocity } = renderer.layer();
        Drawn {
            color: gpu.download(color).unwrap().remove(0),
            inverse_depth: gpu.download(inverse_depth).unwrap().remove(0),
            velocity: gpu.download(velocity).unwrap().remove(0),
        }
    }

    fn pose(angle: f64, translation: [f64; 3]) -> Pose {
        Pose { rotation: DMat3::from_rotation_y(angle), translation: DVec3::from(translation) }
    }

    #[test]
    fn depth_and_velocity_of_a_moving_square_are_what_geometry_says() {
        let Some(gpu) = Gpu::for_tests() else { return };
        // The square is 1 m wide, turned and moving, so that depth and velocity differ from px to px.
        let poses = [pose(0.5, [-0.03, 0.31, 2.0]), pose(0.6, [0.02, 0.33, 1.9])];
        let square = Object::square(Material::default());
        let Drawn { color, inverse_depth, velocity } = drawn(&gpu, square, poses, 1.0);
        let camera = Pinhole::new(SIZE, 50.0);
        let mut inside = 0;
        for (y, x) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (y, x))) {
            if color.at(x, y)[3] < 1.0 {
                continue;
            }
            inside += 1;
            // Depth and velocity are those of the nearest of the four samples, a quarter of a px away.
            let errors = [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)].map(|(a, b)| {
                let at = glam::DVec2::new(x as f64 + a, y as f64 + b) - camera.centre();
                let ray = (at / camera.focal_length).extend(1.0);
                let now = poses[0];
                let point = ray * now.rotation.z_axis.dot(now.translation) / now.rotation.z_axis.dot(ray);
                let local = now.rotation.transpose() * (point - now.translation);
                let next = poses[1].rotation * local + poses[1].translation;
                let then = next.truncate() / next.z * camera.focal_length;
                let [u, v] = velocity.at(x, y).map(f64::from);
                let depth = f64::from(inverse_depth.at(x, y)) * point.z - 1.0;
                (then - at - glam::DVec2::new(u, v)).length().max(1e3 * depth.abs())
            });
            let error = errors.into_iter().fold(f64::INFINITY, f64::min);
            assert!(error < 0.01, "({x}, {y}): {error}");
        }
        // The square's side of 1 m is seen at a distance of 2 m.
        let expected = (camera.focal_length * 0.5).powi(2) * 0.5f64.cos();
        assert!((f64::from(inside) / expected - 1.0).abs() < 0.2, "{inside} of {expected}");
        // Negative control: a square that stands still has no velocity.
        let Drawn { velocity, .. } = drawn(&gpu, Object::square(Material::default()), [poses[0]; 2], 1.0);
        assert!(velocity.data().iter().flatten().all(|v| v.abs() < 1e-3));
    }

    #[test]
    fn depth_tells_where_nothing_is() {
        let Some(gpu) = Gpu::for_tests() else { return };
        // Far away, near, and so near that a part of it is behind the camera.
        for (distance, size) in [(1e6, 1e5f32), (2.0, 1.0), (0.3, 1.0)] {
            let place = pose(0.5, [0.0, 0.3 * f64::from(size), distance]);
            let drawn = drawn(&gpu, Object::built_in(), [place; 2], size);
            let somewhere = drawn.color.data().iter().filter(|c| **c != [0.0; 4]).count();
            assert!((10..SIZE.0 * SIZE.1).contains(&somewhere), "{distance}: {somewhere}");
            for (color, &d) in drawn.color.data().iter().zip(drawn.inverse_depth.data()) {
                assert_eq!(*color != [0.0; 4], d > Layer::NOTHING, "{distance}: {color:?} {d}");
                assert!(d >= Layer::NOTHING);
            }
            // Negative control: another number does not tell it.
            let as_told = |nothing: f32| {
                let pixels = drawn.color.data().iter().zip(drawn.inverse_depth.data());
                pixels.filter(|(c, d)| (**c == [0.0; 4]) != (**d == nothing)).count()
            };
            assert_eq!([as_told(Layer::NOTHING), as_told(-1.0)], [0, SIZE.0 * SIZE.1 - somewhere]);
        }
    }

    #[test]
    fn what_the_device_cannot_hold_ends_in_a_sentence() {
        let limits = wgpu::Limits {
            max_buffer_size: 3 << 20,
            max_storage_buffer_binding_size: 2 << 20,
            ..Default::default()
        };
        for (usage, most) in [(BufferUsages::VERTEX, 3 << 20), (BufferUsages::STORAGE, 2 << 20)] {
            assert!(check_fits(most, usage, &limits).is_ok());
            let e = check_fits(most + 1, usage, &limits).unwrap_err().to_string();
            assert!(e.contains("too large") && !e.contains('\n'), "{e}");
        }
    }

    #[test]
    fn surfaces_without_a_normal_and_glaring_ones_have_finite_colors() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let mut square = Object::square(Material { base_color: [1e6, 1e6, 1e6, 1.0], ..Material::default() });
        square.vertices.iter_mut().for_each(|v| v.normal = [0.0; 3]);
        let Drawn { color, .. } = drawn(&gpu, square, [pose(0.0, [0.0, 0.5, 2.0]); 2], 1.0);
        assert!(color.data().iter().flatten().all(|v| (0.0..=64.0).contains(v)));
        assert!(color.data().contains(&[64.0, 64.0, 64.0, 1.0]));
    }

    #[test]
    fn color_is_premultiplied_and_edges_are_soft() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let color = [0.8, 0.4, 0.2, 1.0];
        let material = Material { base_color: color, ..Material::default() };
        let Drawn { color: drawn, .. } =
            drawn(&gpu, Object::square(material), [pose(0.0, [0.013, 0.517, 2.0]); 2], 1.0);
        let most = drawn.data().iter().find(|c| c[3] == 1.0).unwrap();
        // The colour is ambient light of 0.5 on the base colour and on the 4 % of a dielectric.
        for c in 0..3 {
            assert!((most[c] - 0.5 * (color[c] + 0.04)).abs() < 2e-3, "{most:?}");
        }
        let soft: Vec<_> = drawn.data().iter().filter(|c| c[3] > 0.0 && c[3] < 1.0).collect();
        assert!(soft.len() > 20);
        let mut without_shadow = 0;
        for pixel in soft {
            // Behind an edge there may be the shadow, which is black.
            let share = pixel[0] / most[0];
            assert!((0..3).all(|c| (pixel[c] - share * most[c]).abs() < 2e-3), "{pixel:?}");
            assert!((-2e-3..=SHADOW).contains(&(pixel[3] - share)), "{pixel:?}");
            without_shadow += usize::from((pixel[3] - share).abs() < 2e-3);
        }
        assert!(without_shadow > 20, "{without_shadow}");
        assert!(drawn.data().iter().all(|c| c[3] > 0.0 || *c == [0.0; 4]));
    }

    #[test]
    fn the_shadow_lies_on_the_ground_around_the_foot_and_away_from_the_light() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let camera = Pinhole::new(SIZE, 50.0);
        // The foot stands 0.4 m below the camera.
        let foot = DVec3::new(0.0, 0.4, 1.5);
        let standing = Pose { rotation: DMat3::IDENTITY, translation: foot };
        let moving = Pose { translation: foot + DVec3::new(0.03, 0.0, 0.0), ..standing };
        let shadow = |light: f32| {
            let renderer = Renderer::new(&gpu, Object::square(Material::default()), camera).unwrap();
            let direction = Vec3::new(light, -1.0, 0.0).normalize();
            let light = Light { direction, ..Light::even(0.5) };
            let poses = [standing, moving];
            renderer.draw(&gpu, &Moment { poses, seconds: 0.0, step: 0.04, size: 1.0, light });
            let Layer { color, inverse_depth, velocity } = renderer.layer();
            let color = gpu.download::<[f32; 4]>(color).unwrap().remove(0);
            let depth = gpu.download::<f32>(inverse_depth).unwrap().remove(0);
            let velocity = gpu.download::<[f32; 2]>(velocity).unwrap().remove(0);
            let (mut sum, mut middle) = (0.0, 0.0);
            for (y, x) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (y, x))) {
                let [r, g, b, a] = color.at(x, y);
                if [r, g, b] != [0.0; 3] || a == 0.0 {
                    continue;
                }
                assert!(a <= SHADOW + 1e-3, "{a}");
                // The ground is seen below the horizon, farther away towards it; the samples lie a quarter of a px off.
                let below = (y as f64 - camera.centre().y) / camera.focal_length;
                let off = 0.3 / camera.focal_length;
                let inverse = f64::from(depth.at(x, y));
                assert!(
                    ((below - off) / 0.4..(below + off) / 0.4).contains(&inverse),
                    "({x}, {y}): {inverse}"
                );
                let speed = 0.03 * inverse * camera.focal_length;
                let [u, v] = velocity.at(x, y);
                assert!((f64::from(u) - speed).abs() < 0.01 && v.abs() < 0.01, "{u} {v} {speed}");
                sum += a;
                middle += a * x as f32;
            }
            (sum, middle / sum)
        };
        let (strength, left) = shadow(-1.0);
        let (_, right) = shadow(1.0);
        assert!(strength > 1.0, "{strength}");
        // Light from the left throws it to the right.
        assert!(left > right + 1.0, "{left} {right}");
    }
}
