// Noise from a tile of each level of a Laplacian pyramid of white noise, of local std 1, that continue at their opposite edges;
// three layers of (R, G, B of one of the three finest levels, one channel of the coarsest). Made by noise_tile.wgsl.

// The tile is cut into cells of random offset, so that it does not repeat; beside their borders two cells are mixed so that the
// variance stays (as in Heitz & Neyret 2018).
const CELL = 192.0;
const BORDER = 16.0;

fn cell_texel(cell: vec2<i32>, at: vec2<i32>, key: vec2<u32>, tile: texture_2d_array<f32>, layer: i32) -> vec4<f32> {
    let offset = vec2<i32>(pcg4d(vec4(bitcast<vec2<u32>>(cell), key)).xy >> vec2(8u));
    return textureLoad(tile, (at + offset) & vec2(i32(NOISE_TILE) - 1), layer, 0);
}

// The four levels' unit noise at a pixel, each channel of a level scaled by `sigma`.
fn noise(tile: texture_2d_array<f32>, pixel: vec2<u32>, key: vec2<u32>, sigma: array<vec3<f32>, 4>) -> vec3<f32> {
    // The grid of cells is elsewhere in each frame.
    let shift = pcg4d(vec4(key, key.yx)).xy % vec2(u32(CELL));
    let at = vec2<i32>(pixel + shift);
    let place = vec2<f32>(at) / CELL;
    let cell = vec2<i32>(floor(place));
    // 0 inside a cell, up to 1 at the next one.
    let next = clamp((fract(place) - 1.0) * (CELL / BORDER) + 1.0, vec2(0.0), vec2(1.0));
    var sum = vec3(0.0);
    var squares = 0.0;
    for (var j = 0; j <= i32(next.y > 0.0); j++) {
        for (var i = 0; i <= i32(next.x > 0.0); i++) {
            let weight = select(1.0 - next.x, next.x, i == 1) * select(1.0 - next.y, next.y, j == 1);
            let source = cell + vec2(i, j);
            let a = cell_texel(source, at, key, tile, 0);
            let b = cell_texel(source, at, key, tile, 1);
            let c = cell_texel(source, at, key, tile, 2);
            sum += weight * (sigma[0] * a.rgb + sigma[1] * b.rgb + sigma[2] * c.rgb + sigma[3] * vec3(a.w, b.w, c.w));
            squares += weight * weight;
        }
    }
    return sum * inverseSqrt(squares);
}
