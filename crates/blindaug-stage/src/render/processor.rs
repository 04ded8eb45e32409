//! Draws the object by the processor, where there is no graphics device: the shaders of `object.wgsl`, with the same samples.
//!
//! It differs in one place: a triangle that reaches behind the near plane is left out, where a graphics device cuts it.

use super::{Moment, SAMPLES, Scene, View};
use crate::object::{Material, Object, Texture};
use blindaug::{Flow, Plane, Premultiplied, Raster, Transfer, composite::VirtualLayer};
use glam::{Mat4, Vec2, Vec3, Vec4, Vec4Swizzles};

/// The largest value of a colour, as in the shader.
const BRIGHTEST: f32 = 64.0;

/// A corner of a triangle, or a place in it, as the camera sees it.
#[derive(Clone, Copy, Default)]
struct Corner {
    /// Clip coordinates in this frame and in the next one.
    now: Vec4,
    next: Vec4,
    /// The place in camera coordinates, m; of the ground, the place on the disk of the shadow.
    place: Vec3,
    normal: Vec3,
    uv: Vec2,
    color: Vec4,
}

/// A sample of the layer.
#[derive(Clone, Copy, Default)]
struct Sample {
    /// The colour, premultiplied and linear.
    color: Vec4,
    /// The inverse depth, 1/m; 0 where there is nothing.
    inverse_depth: f32,
    /// The motion, px per frame interval.
    velocity: Vec2,
    /// The depth of a surface that hides what is behind it, the near plane's distance over its own.
    hides: f32,
}

/// The samples of a rectangle of the frame.
struct Samples {
    /// The first pixel, and width and height, px.
    origin: (usize, usize),
    size: (usize, usize),
    data: Vec<Sample>,
}

/// The object at a moment, as the camera of `view` sees it: premultiplied scene-linear colour, inverse depth in 1/m, and motion in px to the
/// next frame; depth and motion are unknown where there is nothing.
pub fn drawn(object: &Object, view: &View, moment: &Moment) -> VirtualLayer {
    let scene = view.scene(moment);
    let (width, height) = view.camera.size;
    let [now, next] = object.moving(moment.seconds, moment.step);
    let corners = corners(object, &scene, &now, &next);
    let ground: [Corner; 4] = std::array::from_fn(|i| {
        let place = Vec2::new(if i & 1 > 0 { 1.0 } else { -1.0 }, if i & 2 > 0 { 1.0 } else { -1.0 });
        let at = Vec4::new(place.x, 0.0, place.y, 1.0);
        let [now, next] = scene.clip_from_ground.map(|m| m * at);
        Corner { now, next, place: place.extend(0.0), ..Corner::default() }
    });
    let mut samples = Samples::around(corners.iter().chain(&ground), &scene);
    for triangle in [[0, 1, 2], [1, 3, 2]] {
        samples.fill(triangle.map(|i| ground[i]), &scene, |at| shadow(at, &scene));
    }
    for part in &object.parts {
        let texture = part.material.texture.map(|i| &object.textures[i]);
        let indices = &object.indices[part.indices.start as usize..part.indices.end as usize];
        for triangle in indices.as_chunks::<3>().0 {
            let triangle = triangle.map(|i| corners[i as usize]);
            samples.fill(triangle, &scene, |at| surface(at, &part.material, texture, &scene));
        }
    }
    samples.resolved(width, height)
}

/// Every corner of the object, moved by its joints.
fn corners(object: &Object, scene: &Scene, now: &[Mat4], next: &[Mat4]) -> Vec<Corner> {
    let mut corners = vec![Corner::default(); object.vertices.len()];
    for part in &object.parts {
        let indices = &object.indices[part.indices.start as usize..part.indices.end as usize];
        let (Some(&first), Some(&last)) = (indices.iter().min(), indices.iter().max()) else { continue };
        // A part's vertices are its own, and stand side by side.
        let own = first as usize..=last as usize;
        for (corner, vertex) in corners[own.clone()].iter_mut().zip(&object.vertices[own]) {
            let joined = |joints: &[Mat4]| {
                let mut sum = Mat4::ZERO;
                for (&joint, &weight) in vertex.joints.iter().zip(&vertex.weights) {
                    if weight != 0.0 {
                        sum += joints[(part.first_joint + joint) as usize] * weight;
                    }
                }
                sum
            };
            let position = Vec3::from(vertex.position).extend(1.0);
            let joint = joined(now);
            let here = joint * position;
            let m = scene.camera_from_object * joint;
            let [x, y, z] = [m.x_axis.xyz(), m.y_axis.xyz(), m.z_axis.xyz()];
            let normal = Vec3::from(vertex.normal);
            *corner = Corner {
                now: scene.clip_from_object[0] * here,
                next: scene.clip_from_object[1] * (joined(next) * position),
                place: (scene.camera_from_object * here).xyz(),
                // Cofactors keep normals perpendicular whatever the scale.
                normal: y.cross(z) * normal.x + z.cross(x) * normal.y + x.cross(y) * normal.z,
                uv: vertex.uv.into(),
                color: vertex.color.into(),
            };
        }
    }
    corners
}

/// The place of clip coordinates in the frame, in samples from its top left corner.
fn in_samples(clip: Vec4, scene: &Scene) -> Vec2 {
    let ndc = clip.xy() / clip.w;
    SAMPLES as f32 * 0.5 * Vec2::new((ndc.x + 1.0) * scene.width, (1.0 - ndc.y) * scene.height)
}

impl Samples {
    /// Samples of the rectangle around what is before the camera.
    fn around<'a>(corners: impl Iterator<Item = &'a Corner>, scene: &Scene) -> Self {
        let whole = Vec2::new(scene.width, scene.height);
        let mut low = whole;
        let mut high = Vec2::ZERO;
        for corner in corners.filter(|c| c.now.w > scene.near) {
            let at = in_samples(corner.now, scene) / SAMPLES as f32;
            if at.is_finite() {
                (low, high) = (low.min(at), high.max(at));
            }
        }
        let low = low.floor().clamp(Vec2::ZERO, whole);
        let high = high.ceil().clamp(low, whole);
        let size = high - low;
        let (w, h) = (size.x as usize, size.y as usize);
        let data = vec![Sample::default(); SAMPLES * SAMPLES * w * h];
        Self { origin: (low.x as usize, low.y as usize), size: (w, h), data }
    }

    /// Draws a triangle: `shade` gives the colour of a place in it, and whether it hides what is behind; `None` where there is nothing.
    fn fill(&mut self, corners: [Corner; 3], scene: &Scene, shade: impl Fn(&Corner) -> Option<(Vec4, bool)>) {
        if corners.iter().any(|c| c.now.w <= scene.near) {
            return;
        }
        let origin = (SAMPLES * self.origin.0, SAMPLES * self.origin.1);
        let (w, h) = (SAMPLES * self.size.0, SAMPLES * self.size.1);
        let first = Vec2::new(origin.0 as f32, origin.1 as f32);
        let [a, b, c] = corners.map(|corner| in_samples(corner.now, scene) - first);
        let area = (b - a).perp_dot(c - a);
        if !area.is_finite() || area == 0.0 {
            return;
        }
        let inside = |v: f32, most: usize| v.clamp(0.0, most as f32) as usize;
        // Samples lie in the middles of their cells.
        let (low, high) = (a.min(b).min(c) - 0.5, a.max(b).max(c) + 0.5);
        for y in inside(low.y.floor(), h)..inside(high.y.ceil(), h) {
            for x in inside(low.x.floor(), w)..inside(high.x.ceil(), w) {
                let p = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                let share = [(b, c), (c, a), (a, b)].map(|(from, to)| (to - from).perp_dot(p - from) / area);
                if share.iter().any(|s| *s < 0.0) {
                    continue;
                }
                // Depth is linear in the picture, all else over it.
                let depth: f32 = (0..3).map(|i| share[i] * corners[i].now.z / corners[i].now.w).sum();
                let sample = &mut self.data[y * w + x];
                if depth <= sample.hides {
                    continue;
                }
                let weights = [0, 1, 2].map(|i| share[i] / corners[i].now.w);
                let sum: f32 = weights.iter().sum();
                let at = Corner::mean(&corners, weights.map(|v| v / sum));
                let Some((color, hides)) = shade(&at) else { continue };
                *sample = Sample {
                    color,
                    inverse_depth: depth / scene.near,
                    velocity: velocity(&at, scene),
                    hides: if hides { depth } else { sample.hides },
                };
            }
        }
    }

    /// The layer of a whole frame: each pixel has the mean colour of its samples, and depth and motion of the nearest one.
    fn resolved(&self, width: usize, height: usize) -> VirtualLayer {
        let mut color = Raster::filled(width, height, [0.0; 4]);
        let mut inverse_depth = Plane::filled(width, height, f32::NAN);
        let mut flow = Flow::filled(width, height, [f32::NAN; 2]);
        let (w, h) = self.size;
        let (left, top) = self.origin;
        let stride = SAMPLES * w;
        for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
            let corner = SAMPLES * (y * stride + x);
            let four = [0, 1, stride, stride + 1].map(|i| &self.data[corner + i]);
            let mut nearest = four[0];
            let mut sum = Vec4::ZERO;
            for sample in four {
                sum += sample.color;
                if sample.inverse_depth > nearest.inverse_depth {
                    nearest = sample;
                }
            }
            if nearest.inverse_depth > 0.0 {
                color.row_mut(top + y)[left + x] = (0.25 * sum).into();
                inverse_depth.row_mut(top + y)[left + x] = nearest.inverse_depth;
                flow.row_mut(top + y)[left + x] = nearest.velocity.into();
            }
        }
        VirtualLayer { color: Premultiplied(color), inverse_depth: Some(inverse_depth), flow: Some(flow) }
    }
}

impl Corner {
    fn mean(of: &[Self; 3], weights: [f32; 3]) -> Self {
        let [a, b, c] = of;
        macro_rules! mean {
            ($field:ident) => {
                a.$field * weights[0] + b.$field * weights[1] + c.$field * weights[2]
            };
        }
        Self {
            now: mean!(now),
            next: mean!(next),
            place: mean!(place),
            normal: mean!(normal),
            uv: mean!(uv),
            color: mean!(color),
        }
    }
}

/// The motion, px, of a place.
fn velocity(at: &Corner, scene: &Scene) -> Vec2 {
    let moved = at.next.xy() / at.next.w.max(scene.near) - at.now.xy() / at.now.w;
    moved * 0.5 * Vec2::new(scene.width, -scene.height)
}

/// The shadow where the object touches the ground.
fn shadow(at: &Corner, scene: &Scene) -> Option<(Vec4, bool)> {
    let inside = (1.0 - at.place.truncate().length_squared()).max(0.0);
    let alpha = scene.shadow * inside * inside;
    (alpha >= 1.0 / 512.0).then_some((Vec4::new(0.0, 0.0, 0.0, alpha), false))
}

fn surface(
    at: &Corner,
    material: &Material,
    texture: Option<&Texture>,
    scene: &Scene,
) -> Option<(Vec4, bool)> {
    let mut color = Vec4::from(material.base_color) * at.color;
    if let Some(texture) = texture {
        color *= texel(texture, at.uv);
    }
    if color.w < material.alpha_cutoff {
        return None;
    }
    let view = -at.place.normalize_or_zero();
    // A surface without a normal faces the viewer.
    let outward = at.normal.try_normalize().unwrap_or(view);
    let normal = if outward.dot(view) > 0.0 { outward } else { -outward };
    let light = shaded(color.xyz(), material, normal, view, scene);
    Some((light.clamp(Vec3::ZERO, Vec3::splat(BRIGHTEST)).extend(1.0), true))
}

/// The texture's colour at a place, which it repeats, linear, from its four nearest texels.
fn texel(texture: &Texture, uv: Vec2) -> Vec4 {
    let [w, h] = texture.size.map(|s| s as f32);
    let at = uv * Vec2::new(w, h) - 0.5;
    let (low, share) = (at.floor(), at - at.floor());
    let wrapped = |v: f32, size: f32| v.rem_euclid(size).min(size - 1.0) as usize;
    let read = |x: f32, y: f32| {
        let i = 4 * (wrapped(low.y + y, h) * texture.size[0] as usize + wrapped(low.x + x, w));
        let [r, g, b, a] = std::array::from_fn(|c| f32::from(texture.texels[i + c]) / 255.0);
        Vec4::new(Transfer::Srgb.decode(r), Transfer::Srgb.decode(g), Transfer::Srgb.decode(b), a)
    };
    let row = |y| read(0.0, y).lerp(read(1.0, y), share.x);
    row(0.0).lerp(row(1.0), share.y)
}

/// Lambert, and GGX with Schlick's Fresnel term and the height-correlated Smith term (Heitz 2014), of one light, as in the shader.
fn shaded(albedo: Vec3, material: &Material, normal: Vec3, view: Vec3, scene: &Scene) -> Vec3 {
    let Material { metallic, roughness, .. } = *material;
    let towards = Vec3::from(scene.light_direction);
    let a = (roughness * roughness).max(0.002);
    let half_way = (view + towards).normalize_or_zero();
    let nl = normal.dot(towards).clamp(0.0, 1.0);
    let nv = normal.dot(view).clamp(1e-3, 1.0);
    let nh = normal.dot(half_way).clamp(0.0, 1.0);
    let f0 = Vec3::splat(0.04).lerp(albedo, metallic);
    let fresnel = f0 + (1.0 - f0) * (1.0 - view.dot(half_way).clamp(0.0, 1.0)).powi(5);
    let spread = nh * nh * (a * a - 1.0) + 1.0;
    let distribution = a * a / (spread * spread);
    let rough = |n: f32| (n * n * (1.0 - a * a) + a * a).sqrt();
    let visibility = 0.5 / (nl * rough(nv) + nv * rough(nl));
    let diffuse = (1.0 - metallic) * albedo;
    let direct =
        nl * Vec3::from(scene.light) * ((1.0 - fresnel) * diffuse + fresnel * (distribution * visibility));
    // In camera coordinates, y is down.
    let ambient = Vec3::from(scene.above).lerp(scene.below.into(), 0.5 + 0.5 * normal.y);
    direct + ambient * (diffuse + f0)
}

#[cfg(test)]
mod tests {
    use super::super::Renderer;
    use super::*;
    use crate::Light;
    use blindaug_gpu::Gpu;
    use blindaug_pipeline::live::{Pinhole, Pose};
    use glam::{DMat3, DVec3};

    #[test]
    fn processor_and_device_draw_alike() {
        let Some(gpu) = Gpu::for_tests() else { return };
        let size = (96, 72);
        let camera = Pinhole::new(size, 50.0);
        let object = Object::built_in();
        let view = View::new(&object, camera);
        let pose = |x| Pose { rotation: DMat3::from_rotation_x(0.2), translation: DVec3::new(x, 0.4, 2.0) };
        let light = Light {
            direction: Vec3::new(-0.5, -0.7, -0.6).normalize(),
            key: Vec3::new(0.6, 0.5, 0.4),
            ..Light::even(0.3)
        };
        let moving =
            |x, by| Moment { poses: [pose(x), pose(x + by)], seconds: 0.7, step: 0.04, size: 1.0, light };
        let moment = |x| moving(x, 0.05);
        let renderer = Renderer::new(&gpu, object.clone(), camera).unwrap();
        renderer.draw(&gpu, &moment(0.1));
        let layer = renderer.layer();
        let color = gpu.download::<[f32; 4]>(&layer.color).unwrap().remove(0);
        let depth = gpu.download::<f32>(&layer.inverse_depth).unwrap().remove(0);
        let velocity = gpu.download::<[f32; 2]>(&layer.velocity).unwrap().remove(0);
        // The shares of pixels whose colour, depth and motion differ: edges go to one side or to the other by the rounding of a sample's place.
        let apart = |layer: &VirtualLayer| {
            let VirtualLayer { color: Premultiplied(c), inverse_depth: Some(d), flow: Some(f) } = layer
            else {
                panic!("a part of the layer is missing");
            };
            let mut counts = [0, 0, 0];
            for (y, x) in (0..size.1).flat_map(|y| (0..size.0).map(move |x| (y, x))) {
                let near = |a: &[f32], b: &[f32], by: f32| a.iter().zip(b).all(|(a, b)| (a - b).abs() < by);
                counts[0] += usize::from(!near(&c.at(x, y), &color.at(x, y), 0.02));
                let seen = depth.at(x, y);
                let here = d.at(x, y);
                let same = if here.is_nan() { seen == 0.0 } else { (here - seen).abs() < 2e-3 };
                counts[1] += usize::from(!same);
                counts[2] += usize::from(same && seen > 0.0 && !near(&f.at(x, y), &velocity.at(x, y), 0.02));
            }
            counts.map(|n| n as f32 / depth.data().iter().filter(|d| **d > 0.0).count() as f32)
        };
        let same = apart(&drawn(&object, &view, &moment(0.1)));
        assert!(same.iter().all(|share| *share < 0.02), "{same:?}");
        // Negative controls: the object elsewhere has another colour and depth, and one that moves otherwise another motion.
        let [color, depth, _] = apart(&drawn(&object, &view, &moment(0.0)));
        assert!(color > 0.2 && depth > 0.2, "{color} {depth}");
        let [.., motion] = apart(&drawn(&object, &view, &moving(0.1, 0.2)));
        assert!(motion > 0.2, "{motion}");
    }

    #[test]
    fn what_is_behind_the_camera_or_beside_the_frame_is_not_drawn() {
        let object = Object::built_in();
        let view = View::new(&object, Pinhole::new((32, 24), 50.0));
        for (place, seen) in [([0.0, 0.4, 2.0], true), ([0.0, 0.4, -2.0], false), ([9.0, 0.4, 2.0], false)] {
            let pose = Pose { rotation: DMat3::IDENTITY, translation: place.into() };
            let light = Light::even(0.3);
            let moment = Moment { poses: [pose; 2], seconds: 0.0, step: 0.04, size: 1.0, light };
            let layer = drawn(&object, &view, &moment);
            let depth = layer.inverse_depth.unwrap();
            assert_eq!(depth.data().iter().any(|d| d.is_finite()), seen, "{place:?}");
            assert!(layer.color.0.data().iter().flatten().all(|v| v.is_finite()));
        }
    }
}
