// Draws colour, inverse depth and velocity of the object's surface, at twice the size of the frame.

struct Scene {
    // The matrices from the object's to clip coordinates, in this frame and in the next.
    clip_from_object: array<mat4x4f, 2>,
    // The matrix from the object's to camera coordinates (x right, y down, z forward, m).
    camera_from_object: mat4x4f,
    // The matrices from the disk of the contact shadow to clip coordinates, in this frame and in the next.
    clip_from_ground: array<mat4x4f, 2>,
    // The direction towards the light, in camera coordinates.
    light_direction: vec3f,
    // Width and height of the frame, px.
    width: f32,
    light: vec3f,
    height: f32,
    // The light from all sides on a surface that faces upward.
    above: vec3f,
    // Depth of the near plane, m.
    near: f32,
    // The light from all sides on a surface that faces downward.
    below: vec3f,
    // The share of the light that is taken away in the middle of the contact shadow.
    shadow: f32,
}

struct Part {
    base_color: vec4f,
    metallic: f32,
    roughness: f32,
    alpha_cutoff: f32,
    first_joint: u32,
}

struct Vertex {
    @builtin(position) position: vec4f,
    @location(0) now: vec4f,
    @location(1) next: vec4f,
    @location(2) place: vec3f,
    @location(3) normal: vec3f,
    @location(4) uv: vec2f,
    @location(5) color: vec4f,
    @location(6) @interpolate(flat) part: u32,
}

struct Surface {
    // The colour, premultiplied and linear.
    @location(0) color: vec4f,
    // The inverse depth, 1/m.
    @location(1) inverse_depth: f32,
    // The motion, px per frame interval, x right, y down.
    @location(2) velocity: vec2f,
}

@group(0) @binding(0) var<uniform> scene: Scene;
// The joints of this frame, then those of the next.
@group(0) @binding(1) var<storage, read> joints: array<mat4x4f>;
@group(0) @binding(2) var<storage, read> parts: array<Part>;
@group(1) @binding(0) var base_color: texture_2d<f32>;
@group(1) @binding(1) var base_color_sampler: sampler;

fn joined(first: u32, indices: vec4u, weights: vec4f) -> mat4x4f {
    return weights.x * joints[first + indices.x] + weights.y * joints[first + indices.y]
        + weights.z * joints[first + indices.z] + weights.w * joints[first + indices.w];
}

@vertex
fn vertex(
    @builtin(instance_index) part: u32,
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) color: vec4f,
    @location(4) indices: vec4u,
    @location(5) weights: vec4f,
) -> Vertex {
    let first = parts[part].first_joint;
    let joint = joined(first, indices, weights);
    let here = joint * vec4f(position, 1.0);
    let then = joined(first + arrayLength(&joints) / 2u, indices, weights) * vec4f(position, 1.0);
    let m = scene.camera_from_object * joint;
    // Cofactors keep normals perpendicular whatever the scale.
    let cofactors = mat3x3f(cross(m[1].xyz, m[2].xyz), cross(m[2].xyz, m[0].xyz), cross(m[0].xyz, m[1].xyz));
    var out: Vertex;
    out.now = scene.clip_from_object[0] * here;
    out.next = scene.clip_from_object[1] * then;
    out.position = out.now;
    out.place = (scene.camera_from_object * here).xyz;
    out.normal = cofactors * normal;
    out.uv = uv;
    out.color = color;
    out.part = part;
    return out;
}

// Lambert, and GGX with Schlick's Fresnel term and the height-correlated Smith term (Heitz 2014), of one light.
fn shaded(albedo: vec3f, metallic: f32, roughness: f32, normal: vec3f, view: vec3f) -> vec3f {
    let a = max(roughness * roughness, 0.002);
    let half_way = normalize(view + scene.light_direction);
    let nl = clamp(dot(normal, scene.light_direction), 0.0, 1.0);
    let nv = clamp(dot(normal, view), 1e-3, 1.0);
    let nh = clamp(dot(normal, half_way), 0.0, 1.0);
    let f0 = mix(vec3f(0.04), albedo, metallic);
    let fresnel = f0 + (1.0 - f0) * pow(1.0 - clamp(dot(view, half_way), 0.0, 1.0), 5.0);
    let spread = nh * nh * (a * a - 1.0) + 1.0;
    let distribution = a * a / (spread * spread);
    let visibility = 0.5 / (nl * sqrt(nv * nv * (1.0 - a * a) + a * a) + nv * sqrt(nl * nl * (1.0 - a * a) + a * a));
    let diffuse = (1.0 - metallic) * albedo;
    // `scene.light` is the radiance of a white surface that faces the light, 1 / pi of the light's irradiance, so that both terms lack
    // their 1 / pi.
    let direct = nl * scene.light * ((1.0 - fresnel) * diffuse + fresnel * distribution * visibility);
    // In camera coordinates, y is down.
    let ambient = mix(scene.above, scene.below, 0.5 + 0.5 * normal.y);
    return direct + ambient * (diffuse + f0);
}

// The largest value of a colour. A highlight of one px must not hide everything around it when it is blurred.
const BRIGHTEST = 64.0;

@fragment
fn surface(in: Vertex, @builtin(front_facing) front: bool) -> Surface {
    let part = parts[in.part];
    let color = part.base_color * in.color * textureSample(base_color, base_color_sampler, in.uv);
    if color.a < part.alpha_cutoff {
        discard;
    }
    let view = -normalize(in.place);
    // A surface without a normal faces the viewer.
    let length = length(in.normal);
    let outward = select(view, in.normal / length, length > 0.0);
    let normal = select(-outward, outward, dot(outward, view) > 0.0);
    var out: Surface;
    let light = shaded(color.rgb, part.metallic, part.roughness, normal, view);
    out.color = vec4f(clamp(light, vec3f(0.0), vec3f(BRIGHTEST)), 1.0);
    out.inverse_depth = in.position.z / scene.near;
    out.velocity = velocity(in.now, in.next);
    return out;
}

// The motion, px, of a point from its clip coordinates in this frame and in the next.
fn velocity(now: vec4f, next: vec4f) -> vec2f {
    // A point behind the camera has no place in the picture, so w is at least that of the near plane.
    return (next.xy / max(next.w, scene.near) - now.xy / now.w) * 0.5 * vec2f(scene.width, -scene.height);
}

struct Ground {
    @builtin(position) position: vec4f,
    @location(0) now: vec4f,
    @location(1) next: vec4f,
    // The place on the disk, whose radius is 1.
    @location(2) place: vec2f,
}

// Two triangles around the disk of the contact shadow.
@vertex
fn ground(@builtin(vertex_index) i: u32) -> Ground {
    let corner = select(i, 6u - i, i > 2u);
    let place = vec2f(select(-1.0, 1.0, (corner & 1u) > 0u), select(-1.0, 1.0, (corner & 2u) > 0u));
    var out: Ground;
    out.now = scene.clip_from_ground[0] * vec4f(place.x, 0.0, place.y, 1.0);
    out.next = scene.clip_from_ground[1] * vec4f(place.x, 0.0, place.y, 1.0);
    out.position = out.now;
    out.place = place;
    return out;
}

// The shadow where the object touches the ground: black that covers a part of what is behind it, less towards the edge.
@fragment
fn shadow(in: Ground) -> Surface {
    let inside = max(1.0 - dot(in.place, in.place), 0.0);
    let alpha = scene.shadow * inside * inside;
    // What hardly darkens anything is not there, so that it has no depth.
    if alpha < 1.0 / 512.0 {
        discard;
    }
    var out: Surface;
    out.color = vec4f(0.0, 0.0, 0.0, alpha);
    out.inverse_depth = in.position.z / scene.near;
    out.velocity = velocity(in.now, in.next);
    return out;
}

@group(0) @binding(0) var colors: texture_2d<f32>;
@group(0) @binding(1) var inverse_depths: texture_2d<f32>;
@group(0) @binding(2) var velocities: texture_2d<f32>;

@vertex
fn whole(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    return vec4f(f32(i & 1u) * 4.0 - 1.0, f32(i & 2u) * 2.0 - 1.0, 0.0, 1.0);
}

// Makes a pixel from 2 x 2 samples: the mean colour, and depth and velocity of the nearest sample.
@fragment
fn resolved(@builtin(position) position: vec4f) -> Surface {
    let corner = 2 * vec2i(position.xy);
    var out: Surface;
    for (var i = 0; i < 4; i++) {
        let at = corner + vec2i(i & 1, i >> 1u);
        out.color += 0.25 * textureLoad(colors, at, 0);
        let inverse_depth = textureLoad(inverse_depths, at, 0).r;
        if inverse_depth > out.inverse_depth {
            out.inverse_depth = inverse_depth;
            out.velocity = textureLoad(velocities, at, 0).xy;
        }
    }
    return out;
}
