// The last pass: motion blur of the focused layer, over the frame, in display-encoded values, with the noise that is missing.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var bilinear: sampler;
@group(0) @binding(2) var frame: texture_2d_array<f32>;
@group(0) @binding(3) var focused: texture_2d_array<f32>;
@group(0) @binding(4) var blur: texture_2d_array<f32>;
@group(0) @binding(5) var tile: texture_2d_array<f32>;

// As in defocus.wgsl.
@group(0) @binding(6) var<storage, read> most_of: array<u32>;

struct Vertex {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) eye: u32,
}

// One triangle over everything; the instance is the eye.
@vertex
fn whole(@builtin(vertex_index) i: u32, @builtin(instance_index) eye: u32) -> Vertex {
    return Vertex(vec4(4.0 * f32(i & 1u) - 1.0, 4.0 * f32(i >> 1u) - 1.0, 0.0, 1.0), eye);
}

fn to_blur_space(v: vec3<f32>) -> vec3<f32> {
    if camera.encoded_space != 0u {
        return v;
    }
    return decode(v);
}

// The frame, blurred by a Gaussian of std 1.5 px: its luminance without most of its noise.
fn smoothed(at: vec2<f32>, eye: u32) -> vec3<f32> {
    // Taps 0, 1 and 2, 3 and 4 of the kernel.
    var weights = array<f32, 3>(0.26656, 0.32303, 0.04369);
    var places = array<f32, 3>(0.0, 1.33924, 3.17429);
    let size = textureDimensions(frame);
    var sum = vec3(0.0);
    for (var j = -2; j <= 2; j++) {
        for (var i = -2; i <= 2; i++) {
            let offset = vec2(f32(sign(i)) * places[abs(i)], f32(sign(j)) * places[abs(j)]);
            let weight = weights[abs(i)] * weights[abs(j)];
            sum += weight * textureSampleLevel(frame, bilinear, coordinates(at + offset, size, size), eye, 0.0).rgb;
        }
    }
    return sum;
}

fn model_std(level: i32, y: f32) -> vec3<f32> {
    return max(camera.slope[level].rgb * y + camera.intercept[level].rgb, vec3(0.0));
}

// The noise that lifts what is left of the frame's own to the model's variance at the result's luminance. `kept` is
// d light / d frame.
fn missing_noise(pixel: vec2<u32>, eye: u32, filmed: vec3<f32>, clean: vec3<f32>, kept: f32) -> vec3<f32> {
    var gain = vec3(0.0);
    var frame_luma = 0.0;
    var noise_free = clean;
    if kept > 1.0 / 1024.0 {
        let smooth_frame = smoothed(vec2<f32>(pixel), eye);
        gain = vec3(kept);
        if camera.encoded_space == 0u {
            gain *= encoding_slope(decode(clean)) / encoding_slope(decode(smooth_frame));
        }
        gain = select(clamp(gain, vec3(0.0), vec3(1.5)), vec3(0.0), smooth_frame >= vec3(camera.clip));
        frame_luma = luma(smooth_frame);
        // The part of the frame that is left brings its noise along.
        noise_free -= gain * (filmed - smooth_frame);
    }
    let y = luma(noise_free);
    var sigma: array<vec3<f32>, 4>;
    for (var level = 0; level < 4; level++) {
        let want = model_std(level, y);
        let there = gain * model_std(level, frame_luma);
        sigma[level] = sqrt(max(want * want - there * there, vec3(0.0)));
    }
    return noise(tile, pixel, camera.key ^ vec2(eye * 0x9e3779b9u), sigma);
}

fn to_target(v: vec3<f32>) -> vec4<f32> {
    if camera.linear_target != 0u {
        return vec4(decode(v), 1.0);
    }
    return vec4(v, 1.0);
}

// A part of the layer along the path of its pixel.
fn along_path(at: vec2<u32>, part: u32) -> vec4<f32> {
    let path = textureLoad(blur, at, part, 0).xy;
    let jitter = vec2<f32>(camera.key % vec2(64u));
    return motion_blurred(
        focused, bilinear, camera.size, vec2<f32>(at), path, part, camera.most_taps, jitter,
    );
}

@fragment
fn composite(in: Vertex) -> @location(0) vec4<f32> {
    let pixel = vec2<u32>(in.position.xy);
    let filmed = textureLoad(frame, pixel, in.eye, 0).rgb;
    let at = pixel - camera.origin;
    var layer = vec4(0.0);
    // Left of and above the origin, the difference wraps.
    if all(at < camera.size) {
        // From the nearest slab on.
        for (var slab = camera.slabs; slab > 0u; slab--) {
            let part = in.eye * camera.slabs + slab - 1u;
            if most_of[part] != 0u {
                layer += (1.0 - layer.a) * along_path(at, part);
            }
        }
    }
    // Nothing virtual is seen: the frame, bit by bit.
    if layer.a <= 0.0 {
        return to_target(filmed);
    }
    let light = max(to_blur_space(filmed) * (1.0 - layer.a) + layer.rgb, vec3(0.0));
    var clean = light;
    if camera.encoded_space == 0u {
        clean = encode(light);
    }
    var noisy = clean;
    if camera.noise != 0u {
        noisy += missing_noise(pixel, in.eye, filmed, clean, 1.0 - layer.a);
    }
    let limit = min(camera.clip, 1.0);
    return to_target(select(clamp(noisy, vec3(0.0), vec3(limit)), vec3(limit), clean >= vec3(limit)));
}
