// The textures between the passes have a layer for each slab of each eye. It is called a part, and its number is eye * slabs + slab, the
// farthest slab first.

// The numbers of each part that the pass `prepare` finds, as the bits of floats that are not negative: their order is that of the floats. They
// are the largest alpha, the largest defocus std (px), the largest distance (px) to which blur spreads a pixel, and whether any pixel is broken:
// 0 or more than 0.
const LARGEST_ALPHA = 0u;
const LARGEST_STD = 1u;
const LARGEST_REACH = 2u;
const ANY_BROKEN = 3u;

// The index of a number of a part in the buffer of all of them.
fn number_of(part: u32, which: u32) -> u32 {
    return PART_NUMBERS * part + which;
}

// Whether the passes read the layer itself, instead of its copy; `broken` is the number ANY_BROKEN of the part.
fn reads_layer(camera: Camera, broken: u32) -> bool {
    return camera.direct != 0u && broken == 0u;
}

// Frames are cut into blocks of BLOCK x BLOCK pixels, and each part has the bits OCCUPIED, OCCUPIED_BEFORE, VISIBLE, FOCUSED, COVERED and SHARPENED for each.

// The bit of a block in the list of blocks whose focused layer is to be computed, if it may hold anything.
const LISTED_TO_BLUR = 0x80000000u;
// The bit of a block in that list that has the bit COVERED.
const LISTED_AS_COVERED = 0x40000000u;
// The bit of a block in the list of blocks that the sharpening works on, if the sharpening changes something there. The other blocks of
// that list have rows that such blocks read, or are to be cleared.
const LISTED_TO_SHARPEN = 0x80000000u;
// The bit of a block in that list in which the sharpening no longer changes anything, so that its textures are to hold zeros.
const LISTED_TO_CLEAR = 0x40000000u;
// The vertices of the two triangles of a tile that is drawn, which is a block.
const TILE_VERTICES = 6u;
// The number of listed blocks in a row of workgroups.
const LIST_ROW = 256u;

// The number after that of the last part of this part's eye. The parts in between are nearer than this part.
fn end_of_eye(camera: Camera, part: u32) -> u32 {
    return (part / camera.slabs + 1u) * camera.slabs;
}

// The number of blocks along both axes.
fn blocks_of(camera: Camera) -> vec2<u32> {
    return (camera.frame + BLOCK - 1u) / BLOCK;
}

// The index of a block of a part in the buffer of all of them.
fn block_index(camera: Camera, block: vec2<u32>, part: u32) -> u32 {
    let all = blocks_of(camera);
    return (part * all.y + block.y) * all.x + block.x;
}

// Pixel `i`, rows first, of a block in a list: x, y, and the part or the eye.
fn listed_pixel(camera: Camera, listed: u32, i: u32) -> vec3<u32> {
    let block = listed & 0x3fffffffu;
    let all = blocks_of(camera);
    let first = BLOCK * vec2(block % all.x, block / all.x % all.y);
    return vec3(first + vec2(i % BLOCK, i / BLOCK), block / (all.x * all.y));
}

// The size of a frame that was halved `level` times, px.
fn size_at(camera: Camera, level: u32) -> vec2<u32> {
    return (camera.frame + (vec2(1u) << vec2(level)) - 1u) >> vec2(level);
}

// The texture coordinates of pixel position `at` (pixel centres are at integers) in the used corner of a texture. Outside of that corner,
// its nearest pixel is taken.
fn coordinates(at: vec2<f32>, used: vec2<u32>, all: vec2<u32>) -> vec2<f32> {
    return (clamp(at, vec2(0.0), vec2<f32>(used) - 1.0) + 0.5) / vec2<f32>(all);
}

// Makes four random numbers from four counters (Jarzynski & Olano 2020).
fn pcg4d(counters: vec4<u32>) -> vec4<u32> {
    var v = counters * 1664525u + 1013904223u;
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    v ^= v >> vec4(16u);
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    return v;
}

fn defocus_std(camera: Camera, inverse_depth: f32) -> f32 {
    let d = clamp(inverse_depth, camera.inverse_depths.x, camera.inverse_depths.y);
    let p = (camera.lens.x * d + camera.lens.y) * d + camera.lens.z;
    let sigma = min(select(max(p, 0.0), abs(p), camera.thin_lens != 0u), MAX_SIGMA_PX);
    // A blur this small cannot be seen. Without it, rounded depths do not change what is in focus.
    return select(sigma, 0.0, sigma < 1.0 / 128.0);
}
