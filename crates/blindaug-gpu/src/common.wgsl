// The textures between the passes have a layer for each slab of each eye. It is called a part, and its number is eye * slabs + slab, the
// farthest slab first.

// The size of an image that was halved `level` times, px.
fn size_at(camera: Camera, level: u32) -> vec2<u32> {
    return (camera.size + (vec2(1u) << vec2(level)) - 1u) >> vec2(level);
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
