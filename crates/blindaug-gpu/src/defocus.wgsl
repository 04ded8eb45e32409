// Defocus: each pixel becomes the mean of its surroundings under its own kernel (Potmesil & Chakravarty 1982). A wide kernel is applied to
// a smaller image. Octave o is the image halved o times, which has blurred it by a variance of (4^o - 1) / 3 px^2 already.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> quality: DefocusQuality;
@group(0) @binding(2) var bilinear: sampler;
// The table of discrete Gaussians: 8 taps, centre first, for each of GAUSSIANS variances, which rise evenly from 0 to GAUSSIAN_MOST px^2.
@group(0) @binding(3) var<storage, read> gaussians: array<vec4<f32>>;
// The table of disks: half the lengths of DISK_ROWS rows, from the middle one on, for each of DISKS stds, DISK_STEP px apart.
@group(0) @binding(14) var<storage, read> disks: array<vec4<f32>>;
@group(0) @binding(15) var<storage, read> numbers: array<u32>;
@group(0) @binding(4) var depth: texture_2d_array<f32>;
@group(0) @binding(5) var focused: texture_storage_2d_array<rgba16float, write>;
@group(0) @binding(6) var octave_0: texture_2d_array<f32>;
@group(0) @binding(7) var octave_1: texture_2d_array<f32>;
@group(0) @binding(8) var octave_2: texture_2d_array<f32>;
@group(0) @binding(9) var octave_3: texture_2d_array<f32>;
@group(0) @binding(10) var octave_4: texture_2d_array<f32>;
@group(0) @binding(11) var octave_5: texture_2d_array<f32>;
@group(0) @binding(12) var octave_6: texture_2d_array<f32>;
@group(0) @binding(13) var octave_7: texture_2d_array<f32>;
@group(0) @binding(16) var continued_0: texture_2d_array<f32>;
@group(0) @binding(17) var covered: texture_2d_array<f32>;
@group(0) @binding(18) var continued_1: texture_2d_array<f32>;
// The number of blocks to compute, and the blocks.
@group(0) @binding(19) var<storage, read> list: array<u32>;
// The layer as it was given.
@group(0) @binding(20) var layer: texture_2d_array<f32>;

// Whether the layer itself is read instead of octave 0, its copy.
var<private> direct: bool;

// The layer at pixel position `at` of an octave. Pixel centres are at integers.
fn tap(octave: u32, at: vec2<f32>, part: u32) -> vec4<f32> {
    let used = size_at(camera, octave);
    switch octave {
        case 0u: {
            if direct {
                return textureSampleLevel(layer, bilinear, coordinates(at, used, used), part, 0.0);
            }
            return textureSampleLevel(octave_0, bilinear, coordinates(at, used, textureDimensions(octave_0)), part, 0.0);
        }
        case 1u: { return textureSampleLevel(octave_1, bilinear, coordinates(at, used, textureDimensions(octave_1)), part, 0.0); }
        case 2u: { return textureSampleLevel(octave_2, bilinear, coordinates(at, used, textureDimensions(octave_2)), part, 0.0); }
        case 3u: { return textureSampleLevel(octave_3, bilinear, coordinates(at, used, textureDimensions(octave_3)), part, 0.0); }
        case 4u: { return textureSampleLevel(octave_4, bilinear, coordinates(at, used, textureDimensions(octave_4)), part, 0.0); }
        case 5u: { return textureSampleLevel(octave_5, bilinear, coordinates(at, used, textureDimensions(octave_5)), part, 0.0); }
        case 6u: { return textureSampleLevel(octave_6, bilinear, coordinates(at, used, textureDimensions(octave_6)), part, 0.0); }
        default: { return textureSampleLevel(octave_7, bilinear, coordinates(at, used, textureDimensions(octave_7)), part, 0.0); }
    }
}

// Finds the coarsest octave that leaves at least this variance to blur, px^2 of the octave.
fn octave_of(variance: f32, least: f32) -> u32 {
    // (variance - (4^o - 1) / 3) / 4^o >= least
    let o = 0.5 * log2(max((variance + 1.0 / 3.0) / (least + 1.0 / 3.0), 1.0));
    return min(u32(o), COARSEST);
}

// Weight and place (px) of the tap that reads the pixels `first` and `first` + 1 with these weights.
fn both(first: f32, weights: vec2<f32>) -> vec2<f32> {
    let sum = weights.x + weights.y;
    return vec2(sum, first + weights.y / max(sum, 1e-20));
}

// Weights and places (px) of the taps from the centre of the discrete Gaussian of this variance outward. Each tap reads two pixels; an odd
// number of taps has one in the centre that reads that pixel alone, and of an even number the two innermost ones share the centre.
fn gaussian_half(variance: f32, odd: bool) -> array<vec2<f32>, 4> {
    let at = min(variance / GAUSSIAN_MOST, 1.0) * f32(GAUSSIANS - 1u);
    let first = min(u32(at), GAUSSIANS - 2u);
    let low = mix(gaussians[2u * first], gaussians[2u * first + 2u], at - f32(first));
    let high = mix(gaussians[2u * first + 1u], gaussians[2u * first + 3u], at - f32(first));
    if odd {
        return array(vec2(low.x, 0.0), both(1.0, low.yz), both(3.0, vec2(low.w, high.x)), both(5.0, high.yz));
    }
    return array(both(0.0, vec2(0.5 * low.x, low.y)), both(2.0, low.zw), both(4.0, high.xy), both(6.0, high.zw));
}

// The mean under a Gaussian on the image itself, whose centre is that of a pixel.
fn gaussian_here(at: vec2<f32>, variance: f32, part: u32) -> vec4<f32> {
    // The kernel has as many pixels on either side of its centre as this, and one tap more than that.
    let radius = i32(clamp(ceil(quality.reach * sqrt(variance) - 0.25), 1.0, 6.0));
    let odd = (radius & 1) == 0;
    var half = gaussian_half(variance, odd);
    var sum = vec4(0.0);
    var total = 0.0;
    for (var j = -radius; j <= radius; j += 2) {
        let row = half[(abs(j) + i32(odd)) / 2];
        for (var i = -radius; i <= radius; i += 2) {
            let column = half[(abs(i) + i32(odd)) / 2];
            let weight = row.x * column.x;
            sum += weight * tap(0u, at + vec2(f32(sign(i)) * column.y, f32(sign(j)) * row.y), part);
            total += weight;
        }
    }
    return sum / total;
}

// Weight and place (px) of two neighbouring taps of a Gaussian around 0, the first of which lies at x.
fn gaussian_taps(x: f32, variance: f32) -> vec2<f32> {
    let first = exp(-0.5 * x * x / variance);
    let second = exp(-0.5 * (x + 1.0) * (x + 1.0) / variance);
    return vec2(first + second, x + second / (first + second));
}

fn gaussian_on(octave: u32, at: vec2<f32>, variance: f32, part: u32) -> vec4<f32> {
    let taps = i32(ceil(quality.reach * sqrt(variance)));
    let nearest = floor(at);
    let start = nearest - at - f32(taps - 1);
    var sum = vec4(0.0);
    var total = 0.0;
    for (var j = 0; j < taps; j++) {
        let row = gaussian_taps(start.y + 2.0 * f32(j), variance);
        for (var i = 0; i < taps; i++) {
            let column = gaussian_taps(start.x + 2.0 * f32(i), variance);
            let weight = row.x * column.x;
            sum += weight * tap(octave, at + vec2(column.y, row.y), part);
            total += weight;
        }
    }
    return sum / total;
}

// Half the length, px, of the row `dy` px from the middle of a disk on the image itself.
fn half_width(first: u32, dy: i32) -> f32 {
    return disks[first + u32(abs(dy)) / 4u][abs(dy) & 3];
}

// A uniform disk on the image itself, as rows of spans. The pixels at the ends of a span count by the share that the span covers.
fn disk_here(at: vec2<f32>, variance: f32, part: u32) -> vec4<f32> {
    let first = DISK_ROWS / 4u * min(u32(sqrt(variance) / DISK_STEP + 0.5), DISKS - 1u);
    var sum = vec4(0.0);
    var total = 0.0;
    for (var dy = 1 - i32(DISK_ROWS); dy < i32(DISK_ROWS); dy++) {
        let reach = half_width(first, dy);
        let most = i32(ceil(reach - 0.5));
        for (var dx = -most; dx <= most && reach > 0.0; dx++) {
            let weight = clamp(reach + 0.5 - f32(abs(dx)), 0.0, min(2.0 * reach, 1.0));
            sum += weight * tap(0u, at + vec2(f32(dx), f32(dy)), part);
            total += weight;
        }
    }
    return sum / total;
}

// A uniform disk on a smaller image. A pixel on the disk's rim counts by about the share that the disk covers.
fn disk_on(octave: u32, at: vec2<f32>, variance: f32, part: u32) -> vec4<f32> {
    // A rim that rises along 1 px adds 5/48 px^2 to the variance radius^2 / 4.
    let radius = sqrt(max(4.0 * variance - 5.0 / 12.0, 0.25));
    let most = i32(ceil(radius + 0.5));
    let nearest = floor(at + 0.5);
    var sum = vec4(0.0);
    var total = 0.0;
    for (var j = -most; j <= most; j++) {
        for (var i = -most; i <= most; i++) {
            let pixel = nearest + vec2(f32(i), f32(j));
            let weight = clamp(radius + 0.5 - distance(pixel, at), 0.0, 1.0);
            if weight > 0.0 {
                sum += weight * tap(octave, pixel, part);
                total += weight;
            }
        }
    }
    return sum / total;
}

var<workgroup> largest_sigma: atomic<u32>;
var<workgroup> seen: atomic<u32>;
var<workgroup> nearer_seen: atomic<u32>;

// Pixel `id` of a part under the kernel of this std, px.
fn defocused(id: vec2<u32>, part: u32, sigma: f32) -> vec4<f32> {
    if sigma == 0.0 && direct {
        return textureLoad(layer, id, part, 0);
    }
    if sigma == 0.0 {
        return textureLoad(octave_0, id, part, 0);
    }
    let variance = sigma * sigma;
    let disk = quality.disk != 0u;
    let octave = octave_of(variance, select(quality.least_variance.x, quality.least_variance.y, disk));
    let scale = exp2(-f32(octave));
    // Halving has blurred by (4^o - 1) / 3 px^2 already.
    let left = variance * scale * scale - (1.0 - scale * scale) / 3.0;
    let at = vec2<f32>(id);
    if disk && octave == 0u {
        return disk_here(at, left, part);
    }
    if disk {
        return disk_on(octave, at * scale, left, part);
    }
    if octave == 0u && left < GAUSSIAN_MOST {
        return gaussian_here(at, left, part);
    }
    return gaussian_on(octave, at * scale, left, part);
}

// A blurred part, divided by the share of its kernel that nearer parts do not hide (normalised convolution, Knutsson & Westin 1993). Where
// that share is small, coarser and coarser octaves fill in.
fn seen_of(id: vec2<u32>, part: u32, sigma: f32) -> vec4<f32> {
    let own = defocused(id, part, sigma);
    var hides = 0.0;
    for (var nearer = part + 1u; nearer < end_of_eye(camera, part); nearer++) {
        if numbers[number_of(nearer, LARGEST_ALPHA)] != 0u {
            hides += defocused(id, nearer, sigma).w;
        }
    }
    if hides <= 0.0 {
        return own;
    }
    var share = max(1.0 - hides, 0.0);
    var known = min(share / SEEN, 1.0);
    var sum = vec4(0.0);
    if share > 0.0 {
        sum = known / share * own;
    }
    for (var octave = 1u; octave <= COARSEST && known < 1.0; octave++) {
        let at = vec2<f32>(id) * exp2(-f32(octave));
        share = 1.0;
        for (var nearer = part + 1u; nearer < end_of_eye(camera, part); nearer++) {
            if numbers[number_of(nearer, LARGEST_ALPHA)] != 0u {
                share -= tap(octave, at, nearer).w;
            }
        }
        if share > 0.0 {
            let weight = (1.0 - known) * min(share / SEEN, 1.0);
            sum += weight / share * tap(octave, at, part);
            known += weight;
        }
    }
    return sum / max(known, 1e-6);
}

// The defocus std of a pixel, px.
fn sigma_at(at: vec2<u32>, part: u32, block_is_covered: bool) -> f32 {
    let most = bitcast<f32>(numbers[number_of(part, LARGEST_ALPHA)]);
    if block_is_covered || is_covered(covered, at, part, most) {
        let here = textureLoad(depth, at, part / camera.slabs, 0).x;
        return defocus_std(camera, camera.depth_map.x * here + camera.depth_map.y);
    }
    return defocus_std(camera, continued(camera, continued_0, continued_1, bilinear, at, part, most).x);
}

@compute @workgroup_size(8, 8)
fn defocus(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let entry = group.y * LIST_ROW + group.x;
    let listed = list[min(entry, list[0] - 1u) + 1u];
    let corner = listed_pixel(camera, listed, 0u);
    let part = corner.z;
    // A quarter of the block: a tile of 8 x 8 pixels.
    let first = corner.xy + 8u * vec2(group.z % 2u, group.z / 2u);
    let id = vec3(first + vec2(thread % 8u, thread / 8u), part);
    direct = reads_layer(camera, numbers[number_of(part, ANY_BROKEN)]);
    if thread == 0u {
        atomicStore(&largest_sigma, 0u);
        atomicStore(&seen, 0u);
        atomicStore(&nearer_seen, 0u);
    }
    workgroupBarrier();
    let inside = entry < list[0] && all(id.xy < camera.frame);
    let blurs = listed >= LISTED_TO_BLUR;
    var sigma = 0.0;
    if inside && blurs {
        sigma = sigma_at(id.xy, id.z, (listed & LISTED_AS_COVERED) != 0u);
    }
    atomicMax(&largest_sigma, bitcast<u32>(sigma));
    workgroupBarrier();
    // The tile stays empty if nothing is seen within the reach of its kernels. On an octave whose pixels are as large as that
    // reach, 5 x 5 pixels tell; of what covers the tile there is nothing to look for but nearer parts.
    let hidden_by_none = part + 1u == end_of_eye(camera, part);
    let sees_itself = (listed & LISTED_AS_COVERED) != 0u && hidden_by_none;
    if thread == 0u && sees_itself {
        atomicStore(&seen, 1u);
    }
    let reach = 4.5 * bitcast<f32>(atomicLoad(&largest_sigma)) + 8.0;
    let coarse = u32(ceil(log2(reach)));
    if thread < 25u && coarse <= COARSEST && blurs && !sees_itself {
        let middle = (vec2<f32>(first) + 4.0) / exp2(f32(coarse));
        let at = floor(middle) + vec2(f32(thread % 5u), f32(thread / 5u)) - 2.0;
        if tap(coarse, at, id.z).w > 0.0 {
            atomicStore(&seen, 1u);
        }
        for (var nearer = id.z + 1u; nearer < end_of_eye(camera, id.z); nearer++) {
            if numbers[number_of(nearer, LARGEST_ALPHA)] != 0u && tap(coarse, at, nearer).w > 0.0 {
                atomicStore(&nearer_seen, 1u);
            }
        }
    }
    workgroupBarrier();
    if !inside {
        return;
    }
    var out = vec4(0.0);
    if blurs && (atomicLoad(&seen) != 0u || coarse > COARSEST) {
        if atomicLoad(&nearer_seen) != 0u || coarse > COARSEST {
            out = seen_of(id.xy, id.z, sigma);
        } else {
            out = defocused(id.xy, id.z, sigma);
        }
    }
    textureStore(focused, id.xy, id.z, out);
}
