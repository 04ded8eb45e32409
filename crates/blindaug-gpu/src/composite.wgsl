// The last pass for a camera that does not sharpen: it blurs the focused layer along its motion, puts it over the frame, and adds the noise
// that is missing. The result is display-encoded.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var bilinear: sampler;
@group(0) @binding(2) var frame: texture_2d_array<f32>;
@group(0) @binding(3) var focused: texture_2d_array<f32>;
// A copy of the layer, and the layer itself.
@group(0) @binding(4) var sharp: texture_2d_array<f32>;
@group(0) @binding(13) var layer_given: texture_2d_array<f32>;
@group(0) @binding(5) var continued_0: texture_2d_array<f32>;
@group(0) @binding(6) var covered: texture_2d_array<f32>;
@group(0) @binding(7) var continued_1: texture_2d_array<f32>;
@group(0) @binding(8) var tile: texture_2d_array<f32>;
@group(0) @binding(10) var<storage, read> blocks: array<u32>;
@group(0) @binding(11) var velocity: texture_2d_array<f32>;
@group(0) @binding(12) var<storage, read> numbers: array<u32>;

struct Vertex {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) eye: u32,
}

// Makes one triangle that covers everything. The instance is the eye.
@vertex
fn whole(@builtin(vertex_index) i: u32, @builtin(instance_index) eye: u32) -> Vertex {
    return Vertex(vec4(4.0 * f32(i & 1u) - 1.0, 4.0 * f32(i >> 1u) - 1.0, 0.0, 1.0), eye);
}

// For each eye, the blocks that are drawn.
@group(0) @binding(9) var<storage, read> tiles: array<u32>;

// Makes the two triangles of a block. The instance is its number among those that are drawn, and the first vertex tells the eye.
@vertex
fn of_tile(@builtin(vertex_index) i: u32, @builtin(instance_index) tile_number: u32) -> Vertex {
    let eye = i / TILE_VERTICES;
    let all = blocks_of(camera);
    let block = tiles[eye * all.x * all.y + tile_number];
    // The corners of the block, rows first.
    var corners = array<u32, TILE_VERTICES>(0, 1, 2, 2, 1, 3);
    let corner = corners[i % TILE_VERTICES];
    let at = BLOCK * (vec2(block % all.x, block / all.x) + vec2(corner & 1u, corner >> 1u));
    let place = 2.0 * vec2<f32>(at) / vec2<f32>(camera.frame) - 1.0;
    return Vertex(vec4(place.x, -place.y, 0.0, 1.0), eye);
}

// Brings encoded values to the space in which blur acts.
fn to_blur_space(v: vec3<f32>) -> vec3<f32> {
    if camera.encoded_space != 0u {
        return v;
    }
    return decode(v);
}

// A tap of a kernel of std 1.5 px of 5 x 5 pixels: its place (x, y, px), and its weight. i and j run from -1 to 1; each tap but the middle
// one stands for two neighbouring pixels along an axis.
fn smoothing_tap(i: i32, j: i32) -> vec3<f32> {
    let weights = mix(vec2(SMOOTHING_MIDDLE), vec2(SMOOTHING_SIDE), abs(vec2(f32(i), f32(j))));
    return vec3(1.5 * vec2(f32(i), f32(j)), weights.x * weights.y);
}

// The weight of the middle pixel of an axis of that kernel, and that of the two pixels on either side together.
const SMOOTHING_MIDDLE = 0.1;
const SMOOTHING_SIDE = 0.45;

// The frame blurred by that kernel, which leaves little of its noise. The noise's strength depends on it, not the picture itself, so that
// its shape matters little.
fn smoothed(at: vec2<f32>, eye: u32) -> vec3<f32> {
    let size = textureDimensions(frame);
    var sum = vec3(0.0);
    for (var j = -1; j <= 1; j++) {
        for (var i = -1; i <= 1; i++) {
            let tap = smoothing_tap(i, j);
            sum += tap.z * textureSampleLevel(frame, bilinear, coordinates(at + tap.xy, size, size), eye, 0.0).rgb;
        }
    }
    return sum;
}

// Point `i` of all curves of the noise's variance, in a row.
fn curve_point(i: u32) -> f32 {
    return camera.variance[i / 4u][i % 4u];
}

// Where a colour lies on the curves of the noise's variance: for each channel the point below its value, and the share of the way to the
// next point.
struct OnCurves {
    below: vec3<u32>,
    share: vec3<f32>,
}

fn on_curves(colour: vec3<f32>) -> OnCurves {
    var found: OnCurves;
    if camera.noise_curves == 0u {
        return found;
    }
    for (var k = 0u; k < 3u; k++) {
        let v = clamp(colour[k], 0.0, 1.0);
        var below = 0u;
        for (var i = 1u; i < NOISE_KNOTS - 1u; i++) {
            below += u32(v >= camera.knots[i / 4u][i % 4u]);
        }
        let low = camera.knots[below / 4u][below % 4u];
        let high = camera.knots[(below + 1u) / 4u][(below + 1u) % 4u];
        found.below[k] = below;
        found.share[k] = (v - low) / (high - low);
    }
    return found;
}

// The std of the noise of a level over content of this encoded colour, which lies `at` on the curves.
fn model_std(level: u32, colour: vec3<f32>, at: OnCurves) -> vec3<f32> {
    if camera.noise_curves == 0u {
        return max(camera.slope[level].rgb * luma(colour) + camera.intercept[level].rgb, vec3(0.0));
    }
    var variance = vec3(0.0);
    for (var k = 0u; k < 3u; k++) {
        for (var c = 0u; c < 3u; c++) {
            let i = ((3u * level + c) * 3u + k) * NOISE_KNOTS + at.below[k];
            variance[c] += mix(curve_point(i), curve_point(i + 1u), at.share[k]);
        }
    }
    return sqrt(max(variance, vec3(0.0)));
}

// Noise of std 1 of a level: three independent noises become those of R, G and B.
fn mixed(level: u32, unit: vec3<f32>) -> vec3<f32> {
    let row = 3u * level;
    return vec3(
        dot(camera.mixing[row].rgb, unit),
        dot(camera.mixing[row + 1u].rgb, unit),
        dot(camera.mixing[row + 2u].rgb, unit),
    );
}

// The least share of the background's light at which the background's noise counts.
const LEAST_KEPT = 1.0 / 1024.0;

// The noise that lifts what is left of the background's own noise to the model's variance at the result's luminance. `kept` is the share of
// the background's light that is still seen, 0 to 1; `smooth_background` has to be known where that is above LEAST_KEPT.
fn missing_noise(
    pixel: vec2<u32>,
    eye: u32,
    background: vec3<f32>,
    smooth_background: vec3<f32>,
    clean: vec3<f32>,
    kept: f32,
) -> vec3<f32> {
    var gain = vec3(0.0);
    var noise_free = clean;
    if kept > LEAST_KEPT {
        gain = vec3(kept);
        if camera.encoded_space == 0u {
            gain *= encoding_slope(decode(clean)) / encoding_slope(decode(smooth_background));
        }
        gain = select(clamp(gain, vec3(0.0), vec3(1.5)), vec3(0.0), smooth_background >= vec3(camera.clip));
        // The visible share of the background brings its noise along, which is subtracted here.
        noise_free -= gain * (background - smooth_background);
    }
    let of_result = on_curves(noise_free);
    var sigma = array<vec3<f32>, NOISE_LEVELS>(
        model_std(0u, noise_free, of_result),
        model_std(1u, noise_free, of_result),
        model_std(2u, noise_free, of_result),
        model_std(3u, noise_free, of_result),
    );
    if kept > LEAST_KEPT {
        let of_background = on_curves(smooth_background);
        for (var level = 0u; level < NOISE_LEVELS; level++) {
            let there = gain * model_std(level, smooth_background, of_background);
            sigma[level] = sqrt(max(sigma[level] * sigma[level] - there * there, vec3(0.0)));
        }
    }
    var sum = vec3(0.0);
    for (var age = 0u; age < camera.noise_terms; age++) {
        // The noise of earlier frames is that of their numbers.
        let key = vec2(camera.key.x, camera.key.y - age) ^ vec2(eye * 0x9e3779b9u);
        sum += camera.noise_weights[age / 4u][age % 4u] * noise(tile, pixel, key, sigma);
    }
    return sum;
}

fn to_target(v: vec3<f32>) -> vec4<f32> {
    if camera.linear_target != 0u {
        return vec4(decode(v), 1.0);
    }
    return vec4(v, 1.0);
}

// The path of a pixel while the shutter is open, px, and the distance from each sample along it to the next, px.
struct Path {
    way: vec2<f32>,
    step: f32,
}

// `defocused` says whether the lens blurs the part.
fn path_at(at: vec2<u32>, part: u32, bits: u32, defocused: bool) -> Path {
    // What is blurred already needs fewer samples.
    let may_step = defocused && camera.most_step > 1.0;
    let most = bitcast<f32>(numbers[number_of(part, LARGEST_ALPHA)]);
    var known: vec3<f32>;
    if (bits & COVERED) != 0u || is_covered(covered, at, part, most) {
        known = vec3(0.0, camera.path_scale * textureLoad(velocity, at, part / camera.slabs, 0).xy);
        if may_step {
            // The depth around the pixel is enough to choose a step by.
            let above = coordinates(vec2<f32>(at) * exp2(-f32(CONTINUED + 1u)), size_at(camera, CONTINUED + 1u), textureDimensions(continued_1));
            known.x = textureSampleLevel(continued_1, bilinear, above, part, 0.0).x;
        }
    } else {
        known = continued(camera, continued_0, continued_1, bilinear, at, part, most);
    }
    var step = 1.0;
    if may_step {
        step = clamp(STEP_OF_STD * defocus_std(camera, known.x), 1.0, camera.most_step);
    }
    return Path(known.yz, step);
}

// The mean of a part of the layer along the path of a pixel, in a block of these bits.
fn along_path(at: vec2<u32>, part: u32, bits: u32) -> vec4<f32> {
    // All blocks in which the part is seen have the bit, or none.
    let defocused = camera.defocuses != 0u && (bits & FOCUSED) != 0u;
    let direct = reads_layer(camera, numbers[number_of(part, ANY_BROKEN)]);
    if camera.moves == 0u {
        if defocused {
            return textureLoad(focused, at, part, 0);
        }
        if direct {
            return textureLoad(layer_given, at, part, 0);
        }
        return textureLoad(sharp, at, part, 0);
    }
    let path = path_at(at, part, bits, defocused);
    let jitter = vec2<f32>(camera.key % vec2(64u));
    // What is seen here in the middle of the exposure is elsewhere at the frame's time.
    let middle = vec2<f32>(at) - camera.path_centre * path.way;
    if defocused {
        return motion_blurred(focused, bilinear, middle, path.way, part, path.step, camera.most_taps, jitter);
    }
    if direct {
        return motion_blurred(layer_given, bilinear, middle, path.way, part, path.step, camera.most_taps, jitter);
    }
    return motion_blurred(sharp, bilinear, middle, path.way, part, path.step, camera.most_taps, jitter);
}

// The blurred layer at a pixel of the frame: premultiplied, in the space in which blur acts.
fn layer_at(at: vec2<u32>, eye: u32) -> vec4<f32> {
    var layer = vec4(0.0);
    // The nearest slab comes first, and the others are seen through what it leaves.
    for (var slab = camera.slabs; slab > 0u; slab--) {
        let part = eye * camera.slabs + slab - 1u;
        let bits = blocks[block_index(camera, at / BLOCK, part)];
        if (bits & VISIBLE) != 0u {
            layer += (1.0 - layer.a) * along_path(at, part, bits);
        }
    }
    return layer;
}

// Puts the layer over a background of encoded values. The result is encoded and may exceed 1.
fn over(background: vec3<f32>, layer: vec4<f32>) -> vec3<f32> {
    var light = layer.rgb;
    if layer.a < 1.0 {
        light += to_blur_space(background) * (1.0 - layer.a);
    }
    light = max(light, vec3(0.0));
    if camera.encoded_space == 0u {
        return encode(light);
    }
    return light;
}

// Whether a block of an eye is among those that are drawn: those in which something may be seen or, for a camera that sharpens, those that
// the sharpening changes. All parts of an eye have one bit for the latter.
fn is_drawn(block: vec2<u32>, eye: u32) -> bool {
    // With an empty area, the bits are those of an earlier frame.
    if any(camera.size == vec2(0u)) {
        return false;
    }
    if camera.sharpening_blocks > 0u {
        return (blocks[block_index(camera, block, eye * camera.slabs)] & SHARPENED) != 0u;
    }
    return is_seen(block, eye);
}

// Writes the frame, bit by bit, to the blocks that are not drawn.
@fragment
fn copied(in: Vertex) -> @location(0) vec4<f32> {
    let pixel = vec2<u32>(in.position.xy);
    if is_drawn(pixel / BLOCK, in.eye) {
        discard;
    }
    return to_target(textureLoad(frame, pixel, in.eye, 0).rgb);
}

@fragment
fn composite(in: Vertex) -> @location(0) vec4<f32> {
    let pixel = vec2<u32>(in.position.xy);
    var layer = vec4(0.0);
    // Left of and above the origin, the difference wraps around to large numbers.
    if all(pixel - camera.origin < camera.size) {
        layer = layer_at(pixel, in.eye);
    }
    if layer.a <= 0.0 && camera.over_targets != 0u {
        discard;
    }
    // The frame is not read where nothing of it is seen.
    var filmed = vec3(0.0);
    if layer.a < 1.0 {
        filmed = textureLoad(frame, pixel, in.eye, 0).rgb;
    }
    // Where nothing virtual is seen, the result is the frame, bit by bit.
    if layer.a <= 0.0 {
        return to_target(filmed);
    }
    let clean = over(filmed, layer);
    var noisy = clean;
    if camera.noise != 0u {
        let kept = 1.0 - layer.a;
        var smooth_frame = vec3(0.0);
        if kept > LEAST_KEPT {
            smooth_frame = smoothed(vec2<f32>(pixel), in.eye);
        }
        noisy += missing_noise(pixel, in.eye, filmed, smooth_frame, clean, kept);
    }
    let limit = min(camera.clip, 1.0);
    return to_target(select(clamp(noisy, vec3(0.0), vec3(limit)), vec3(limit), clean >= vec3(limit)));
}
