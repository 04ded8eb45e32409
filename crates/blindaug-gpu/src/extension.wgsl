// The layer is brought to the space in which blur acts, and its depth and motion are continued past its silhouette (pull-push, Gortler et
// al. 1996). What is continued is smooth, so that it is kept at a quarter of the layer's size, on level CONTINUED, and on the levels above.

@group(0) @binding(0) var<uniform> camera: Camera;

@group(0) @binding(1) var layer: texture_2d_array<f32>;
@group(0) @binding(2) var layer_depth: texture_2d_array<f32>;
@group(0) @binding(3) var layer_velocity: texture_2d_array<f32>;
@group(0) @binding(4) var<storage, read_write> found: array<atomic<u32>>;
@group(0) @binding(5) var octave_0: texture_storage_2d_array<rgba16float, write>;
@group(0) @binding(6) var octave_1: texture_storage_2d_array<rgba16float, write>;
@group(0) @binding(7) var continued_0: texture_storage_2d_array<rgba16float, write>;
@group(0) @binding(8) var covered: texture_storage_2d_array<r32float, write>;
@group(0) @binding(9) var<storage, read_write> blocks: array<u32>;

// The slab that a pixel belongs to. At silhouettes, the neighbouring pixel that the object covers most decides.
fn slab_of(at: vec2<u32>, eye: u32, own_alpha: f32) -> u32 {
    var alpha = own_alpha;
    var place = vec2<i32>(at);
    if alpha < OPAQUE {
        let last = vec2<i32>(textureDimensions(layer)) - 1;
        for (var j = -1; j <= 1; j++) {
            for (var i = -1; i <= 1; i++) {
                let beside = clamp(vec2<i32>(at) + vec2(i, j), vec2(0), last);
                let other = textureLoad(layer, beside, eye, 0).w;
                if other > alpha {
                    alpha = other;
                    place = beside;
                }
            }
        }
    }
    let d = camera.depth_map.x * textureLoad(layer_depth, place, eye, 0).x + camera.depth_map.y;
    if !is_finite(d) {
        return 1u;
    }
    return select(select(1u, 2u, d > camera.cuts.y), 0u, d < camera.cuts.x);
}

// The range of half floats.
const MOST = 65504.0;

// The layer at a pixel of the frame; nothing outside of the area.
fn layer_at(at: vec2<u32>, eye: u32) -> vec4<f32> {
    // Left of and above the area, the difference wraps around to large numbers.
    if any(at - camera.origin >= camera.size) {
        return vec4(0.0);
    }
    return textureLoad(layer, at, eye, 0);
}

// Whether a value of the layer counts as empty.
fn is_void(v: vec4<f32>) -> bool {
    return !(is_finite(v.x) && is_finite(v.y) && is_finite(v.z) && is_finite(v.w)) || v.w < 0.0;
}

// Whether a value of the layer has to be mended before anything is made of it.
fn is_broken(v: vec4<f32>) -> bool {
    return is_void(v) || v.w > 1.0 || any(abs(v) > vec4(MOST));
}

// A part of the layer at a pixel of the frame, in the space in which blur acts; `value` is that of the layer there.
fn colour_of(value: vec4<f32>, at: vec2<u32>, part: u32) -> vec4<f32> {
    if is_void(value) {
        return vec4(0.0);
    }
    let eye = part / camera.slabs;
    var v = vec4(value.rgb, min(value.w, 1.0));
    if camera.slabs > 1u && v.w > 0.0 && slab_of(at, eye, v.w) != part % camera.slabs {
        return vec4(0.0);
    }
    if camera.encoded_space != 0u && v.w > 0.0 {
        v = vec4(encode(v.rgb / v.w) * v.w, v.w);
    }
    return clamp(v, vec4(-MOST), vec4(MOST));
}

// A workgroup has a block of BLOCK x BLOCK pixels and BEFORE pixels left of and above it, which the smaller images need; SIDE is the side of both.
const BEFORE = 3u;
const SIDE = 20u;

// The colours, the inverse depths and the paths. Where depth or path are unknown, the depth is UNKNOWN.
var<workgroup> colours: array<vec4<f32>, SIDE * SIDE>;
var<workgroup> depths: array<f32, SIDE * SIDE>;
var<workgroup> paths: array<vec2<f32>, SIDE * SIDE>;
// The numbers of the workgroup's pixels, as those of a part, and whether any of them has a colour.
var<workgroup> largest: array<atomic<u32>, PART_NUMBERS>;
var<workgroup> occupied: atomic<u32>;
// Whether a pixel of the block is not covered.
var<workgroup> uncovered: atomic<u32>;
// Whether the textures hold something in the block.
var<workgroup> dirty: u32;
const UNKNOWN = 1e9;

// Counts a number of the workgroup's pixels. The magnitude is taken, since the bits of -0 would be the largest.
fn count(which: u32, number: f32) {
    atomicMax(&largest[which], bitcast<u32>(abs(number)));
}

// The largest defocus std, px, that depths between this one and others may have: where the lens's curve has its maximum in between, that.
fn largest_std(d: f32) -> f32 {
    let own = defocus_std(camera, d);
    if camera.thin_lens != 0u || camera.lens.x >= 0.0 {
        return own;
    }
    return max(own, defocus_std(camera, -0.5 * camera.lens.y / camera.lens.x));
}

// Reads a pixel of the frame as pixel `i` of the workgroup's memory.
fn gather(i: u32, at: vec2<u32>, part: u32) {
    let eye = part / camera.slabs;
    var value = 0.0;
    // Left of and above the area, the difference wraps around to large numbers.
    let is_inside = all(at - camera.origin < camera.size);
    if camera.knows_nothing != 0u && is_inside {
        value = textureLoad(layer_depth, at, eye, 0).x;
        if value == camera.nothing {
            colours[i] = vec4(0.0);
            depths[i] = 0.0;
            paths[i] = vec2(0.0);
            return;
        }
    }
    let given = layer_at(at, eye);
    if is_broken(given) {
        count(ANY_BROKEN, 1.0);
    }
    let colour = colour_of(given, at, part);
    var d = 0.0;
    var path = vec2(0.0);
    if colour.w > 0.0 {
        if camera.defocuses != 0u {
            if camera.knows_nothing == 0u {
                value = textureLoad(layer_depth, at, eye, 0).x;
            }
            d = camera.depth_map.x * value + camera.depth_map.y;
        }
        if camera.moves != 0u {
            path = camera.path_scale * textureLoad(layer_velocity, at, eye, 0).xy;
        }
        let known = is_finite(d) && is_finite(path.x) && is_finite(path.y);
        d = select(0.0, clamp(d, -60000.0, 60000.0), known);
        path = select(vec2(0.0), clamp(path, vec2(-60000.0), vec2(60000.0)), known);
        count(LARGEST_ALPHA, colour.w);
        // Kernels end before 4.5 times the std, and 2 px of the octaves' own kernels come to it.
        var reach = 0.0;
        if camera.defocuses != 0u {
            let sigma = largest_std(d);
            count(LARGEST_STD, sigma);
            reach = select(0.0, 4.5 * sigma + 2.0, sigma > 0.0);
        }
        count(LARGEST_REACH, reach + (0.5 + abs(camera.path_centre)) * length(path));
        d = select(UNKNOWN, d, known);
    }
    if any(colour != vec4(0.0)) {
        atomicStore(&occupied, 1u);
    }
    colours[i] = colour;
    depths[i] = d;
    paths[i] = path;
}

// The pixel of octave 1 at a pixel of the workgroup's memory, by the binomial kernel [1 4 6 4 1] / 16.
fn octave_1_at(middle: vec2<u32>) -> vec4<f32> {
    var binomial = array<f32, 3>(0.375, 0.25, 0.0625);
    var sum = vec4(0.0);
    for (var j = -2; j <= 2; j++) {
        for (var i = -2; i <= 2; i++) {
            let at = vec2<i32>(middle) + vec2(i, j);
            sum += binomial[abs(i)] * binomial[abs(j)] * colours[u32(at.y) * SIDE + u32(at.x)];
        }
    }
    return sum;
}

// The mean inverse depth and path around a pixel of the workgroup's memory, and the eighth root of their weight. Where the object covers a
// pixel only in part, depth and motion may belong to what is behind it, so the weight is the eighth power of alpha. The root of the mean
// weight is kept, since half floats could not hold the weight itself, which is to be divided by that of the largest alpha.
fn continued_at(middle: vec2<u32>) -> vec4<f32> {
    var sum = vec3(0.0);
    var total = 0.0;
    for (var j = -3; j <= 3; j++) {
        for (var i = -3; i <= 3; i++) {
            let at = vec2<i32>(middle) + vec2(i, j);
            let index = u32(at.y) * SIDE + u32(at.x);
            let d = depths[index];
            if d < UNKNOWN {
                var weight = colours[index].w;
                weight *= weight;
                weight *= weight;
                weight *= weight;
                weight *= f32((4 - abs(i)) * (4 - abs(j))) / 256.0;
                sum += weight * vec3(d, paths[index]);
                total += weight;
            }
        }
    }
    if total <= 0.0 {
        return vec4(0.0);
    }
    return vec4(sum / total, sqrt(sqrt(sqrt(total))));
}

// Whether the object covers a pixel of the workgroup's memory and its values are known: more than half of the weight that the workgroup's
// most opaque pixel has.
fn is_known(index: u32) -> bool {
    let alpha = colours[index].w;
    let least = 0.917 * bitcast<f32>(atomicLoad(&largest[LARGEST_ALPHA]));
    return alpha > 0.0 && alpha >= least && depths[index] < UNKNOWN;
}

// Which of the 4 x 4 pixels from this one of the workgroup's memory on have known values and are covered, as bits, rows first. The bits from
// 16 on are the alpha of the workgroup's most opaque pixel, times 255.
fn covered_from(first: vec2<u32>) -> u32 {
    let most = bitcast<f32>(atomicLoad(&largest[LARGEST_ALPHA]));
    var bits = u32(255.0 * most + 0.5) << 16u;
    for (var i = 0u; i < 16u; i++) {
        let index = (first.y + i / 4u) * SIDE + first.x + i % 4u;
        bits |= select(0u, 1u << i, is_known(index));
    }
    return bits;
}

@compute @workgroup_size(16, 16)
fn prepare(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let part = group.z;
    let block = block_index(camera, group.xy, part);
    if thread < PART_NUMBERS {
        atomicStore(&largest[thread], 0u);
    } else if thread == PART_NUMBERS {
        atomicStore(&occupied, 0u);
        atomicStore(&uncovered, 0u);
    }
    workgroupBarrier();
    let last = vec2<i32>(camera.frame) - 1;
    let first = vec2<i32>(group.xy * BLOCK) - i32(BEFORE);
    for (var i = thread; i < SIDE * SIDE; i += BLOCK * BLOCK) {
        // Beyond the edges of the frame, its outermost pixels are repeated.
        let at = clamp(first + vec2<i32>(vec2(i % SIDE, i / SIDE)), vec2(0), last);
        gather(i, vec2<u32>(at), part);
    }
    workgroupBarrier();
    let own = vec2(thread % BLOCK, thread / BLOCK);
    let own_index = (own.y + BEFORE) * SIDE + own.x + BEFORE;
    if !is_known(own_index) {
        atomicStore(&uncovered, 1u);
    }
    workgroupBarrier();
    if thread < PART_NUMBERS && atomicLoad(&largest[thread]) > 0u {
        atomicMax(&found[number_of(part, thread)], atomicLoad(&largest[thread]));
    } else if thread == PART_NUMBERS {
        let now = atomicLoad(&occupied);
        let before = blocks[block];
        dirty = now | (before & OCCUPIED) | camera.refresh;
        // The most opaque pixel of the whole part is not more opaque than 1.
        let opaque = bitcast<f32>(atomicLoad(&largest[LARGEST_ALPHA])) >= OPAQUE;
        let covered_all = opaque && atomicLoad(&uncovered) == 0u;
        blocks[block] = (now * OCCUPIED) | ((before & OCCUPIED) * OCCUPIED_BEFORE) | (before & (FOCUSED | SHARPENED))
            | select(0u, COVERED, covered_all);
    }
    workgroupBarrier();
    // In an empty block, the textures hold zeros already, unless it was not empty in the frame before.
    if dirty == 0u {
        return;
    }
    if camera.direct == 0u && all(group.xy * BLOCK + own < camera.frame) {
        textureStore(octave_0, group.xy * BLOCK + own, part, colours[own_index]);
    }
    if thread < 64u {
        let pixel = vec2(thread % 8u, thread / 8u);
        let at = 8u * group.xy + pixel;
        if camera.defocuses != 0u && all(at < size_at(camera, 1u)) {
            textureStore(octave_1, at, part, octave_1_at(2u * pixel + BEFORE));
        }
    } else if thread < 80u {
        let pixel = vec2(thread % 4u, (thread - 64u) / 4u);
        let at = 4u * group.xy + pixel;
        if camera.defocuses + camera.moves != 0u && all(at < size_at(camera, CONTINUED)) {
            textureStore(continued_0, at, part, continued_at(4u * pixel + BEFORE));
            textureStore(covered, at, part, vec4(f32(covered_from(4u * pixel + BEFORE))));
        }
    }
}

// Copies the layer without its broken values, where the passes would read the layer itself but for these. A workgroup has MENDED x MENDED
// pixels. All of the frame is written, since the copy is not kept from frame to frame.
@compute @workgroup_size(16, 16)
fn mend(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) thread: vec3<u32>) {
    if atomicLoad(&found[number_of(group.z, ANY_BROKEN)]) == 0u {
        return;
    }
    let first = MENDED * group.xy + thread.xy;
    for (var y = first.y; y < min(first.y + MENDED, camera.frame.y); y += 16u) {
        for (var x = first.x; x < min(first.x + MENDED, camera.frame.x); x += 16u) {
            let at = vec2(x, y);
            textureStore(octave_0, at, group.z, colour_of(layer_at(at, group.z), at, group.z));
        }
    }
}

// The number of times that the finer of the two images was halved.
@group(0) @binding(1) var<uniform> level: u32;
@group(0) @binding(2) var bilinear: sampler;
@group(0) @binding(3) var finer: texture_2d_array<f32>;
@group(0) @binding(4) var<storage, read> block_bits: array<u32>;
@group(0) @binding(5) var coarse: texture_storage_2d_array<rgba16float, write>;

var<workgroup> any_bits: atomic<u32>;

// The first level of which all pixels are computed. There, a workgroup has more blocks to look at than it has work to save.
const WHOLE_FROM = 6u;

// Whether any block has one of these bits that lies under the workgroup's 8 x 8 pixels of a level, or under the kernels that halve down to
// that level: these reach less than 2 pixels of the level. From WHOLE_FROM on, always.
fn is_live(group: vec3<u32>, thread: u32, on: u32, bits: u32) -> bool {
    if on >= WHOLE_FROM {
        return true;
    }
    if thread == 0u {
        atomicStore(&any_bits, camera.refresh);
    }
    workgroupBarrier();
    let pixels = i32(8u << on);
    let around = i32(2u << on);
    let begin = vec2<i32>(group.xy) * pixels;
    let low = vec2<u32>(max(begin - around, vec2(0))) / BLOCK;
    let high = min(vec2<u32>(begin + pixels + around - 1) / BLOCK, blocks_of(camera) - 1u);
    let count = high - low + 1u;
    var found_bits = 0u;
    for (var i = thread; i < count.x * count.y; i += 64u) {
        found_bits |= block_bits[block_index(camera, low + vec2(i % count.x, i / count.x), group.z)];
    }
    atomicOr(&any_bits, found_bits & bits);
    workgroupBarrier();
    return atomicLoad(&any_bits) != 0u;
}

// A pixel of the image at half its size, by the binomial kernel [1 4 6 4 1] / 16, two taps at a time.
fn halved(id: vec3<u32>) -> vec4<f32> {
    let used = size_at(camera, level);
    let all = textureDimensions(finer);
    var sum = vec4(0.0);
    for (var j = -1; j <= 1; j++) {
        for (var i = -1; i <= 1; i++) {
            let at = vec2(f32(i), f32(j));
            let weight = (0.375 - 0.0625 * abs(at.x)) * (0.375 - 0.0625 * abs(at.y));
            let tap = coordinates(2.0 * vec2<f32>(id.xy) + 1.2 * at, used, all);
            sum += weight * textureSampleLevel(finer, bilinear, tap, id.z, 0.0);
        }
    }
    return sum;
}

@compute @workgroup_size(8, 8)
fn halve(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let live = is_live(group, thread, level + 1u, OCCUPIED | OCCUPIED_BEFORE);
    if live && all(id.xy < size_at(camera, level + 1u)) {
        textureStore(coarse, id.xy, id.z, halved(id));
    }
}

// Halves an image of values times their weight, which is the fourth number.
@compute @workgroup_size(8, 8)
fn pull(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let live = is_live(group, thread, level + 1u, OCCUPIED | OCCUPIED_BEFORE);
    if live && all(id.xy < size_at(camera, level + 1u)) {
        let sum = halved(id);
        textureStore(coarse, id.xy, id.z, vec4(sum.xyz / max(sum.w, 1e-6), 1.0) * confidence(sum.w));
    }
}

@group(0) @binding(6) var<storage, read> numbers: array<u32>;

// Halves level CONTINUED, as `pull` halves the levels above.
@compute @workgroup_size(8, 8)
fn pull_continued(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let live = is_live(group, thread, CONTINUED + 1u, OCCUPIED | OCCUPIED_BEFORE);
    if !live || any(id.xy >= size_at(camera, CONTINUED + 1u)) {
        return;
    }
    let most = bitcast<f32>(numbers[number_of(id.z, LARGEST_ALPHA)]);
    var binomial = array<f32, 3>(0.375, 0.25, 0.0625);
    let last = vec2<i32>(size_at(camera, CONTINUED)) - 1;
    var sum = vec4(0.0);
    for (var j = -2; j <= 2; j++) {
        for (var i = -2; i <= 2; i++) {
            let at = clamp(2 * vec2<i32>(id.xy) + vec2(i, j), vec2(0), last);
            let here = textureLoad(finer, at, id.z, 0);
            let known = of_continued(coverage(here.w, most));
            sum += binomial[abs(i)] * binomial[abs(j)] * vec4(here.xyz, 1.0) * known;
        }
    }
    textureStore(coarse, id.xy, id.z, vec4(sum.xyz / max(sum.w, 1e-6), 1.0) * confidence(sum.w));
}

@group(0) @binding(3) var coarser: texture_2d_array<f32>;
@group(0) @binding(5) var own: texture_2d_array<f32>;
@group(0) @binding(6) var filled: texture_storage_2d_array<rgba16float, write>;

// The value of a level, where it is known, else that of the next coarser level. To double the coarser level, even pixels take (1 6 1) / 8
// of its pixels, odd ones (1 1) / 2.
fn pushed(id: vec3<u32>) -> vec3<f32> {
    let here = textureLoad(own, id.xy, id.z, 0);
    if here.w >= 1.0 {
        return here.xyz;
    }
    let used = size_at(camera, level + 1u);
    let all = textureDimensions(coarser);
    let odd = vec2<f32>(id.xy & vec2(1u));
    let at = vec2<f32>(id.xy >> vec2(1u)) + 0.5 * odd;
    let apart = 0.25 * (1.0 - odd);
    var sum = vec3(0.0);
    for (var j = -1; j <= 1; j += 2) {
        for (var i = -1; i <= 1; i += 2) {
            let tap = coordinates(at + apart * vec2(f32(i), f32(j)), used, all);
            sum += textureSampleLevel(coarser, bilinear, tap, id.z, 0.0).xyz;
        }
    }
    return 0.25 * sum * (1.0 - here.w) + here.xyz;
}

@compute @workgroup_size(8, 8)
fn push(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    // Where the blurred layer is seen, the finer levels together reach less than 2 pixels of this one.
    let live = is_live(group, thread, level, VISIBLE);
    if live && all(id.xy < size_at(camera, level)) {
        textureStore(filled, id.xy, id.z, vec4(pushed(id), 1.0));
    }
}

// Fills the coarsest level, which has one pixel.
@compute @workgroup_size(1)
fn top(@builtin(global_invocation_id) id: vec3<u32>) {
    let here = textureLoad(own, id.xy, id.z, 0);
    textureStore(filled, id.xy, id.z, vec4(here.xyz / max(here.w, 1e-6), 1.0));
}
