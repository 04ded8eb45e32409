// Noise from a tile that noise_tile.wgsl makes. Its three layers hold R, G, B of the three finest levels of a Laplacian pyramid of white
// noise, and in the fourth channel one channel each of the coarsest level. The local std of each level is 1, and opposite edges of the tile
// continue each other.

// The plane is cut into cells with a random offset into the tile each, so that the tile does not repeat. CELL is their side, px; within
// BORDER px of a border, two cells are mixed so that the variance stays (as in Heitz & Neyret 2018).
const CELL = 192.0;
const BORDER = 16.0;

fn cell_texel(cell: vec2<i32>, at: vec2<i32>, key: vec2<u32>, tile: texture_2d_array<f32>, layer: i32) -> vec4<f32> {
    let offset = vec2<i32>(pcg4d(vec4(bitcast<vec2<u32>>(cell), key)).xy >> vec2(8u));
    return textureLoad(tile, (at + offset) & vec2(i32(NOISE_TILE) - 1), layer, 0);
}

// The noise at a pixel: the sum of all levels, each mixed as the model's channels are correlated and multiplied by its `sigma`.
fn noise(tile: texture_2d_array<f32>, pixel: vec2<u32>, key: vec2<u32>, sigma: array<vec3<f32>, NOISE_LEVELS>) -> vec3<f32> {
    // The grid of cells lies elsewhere in each frame.
    let shift = pcg4d(vec4(key, key.yx)).xy % vec2(u32(CELL));
    let at = vec2<i32>(pixel + shift);
    let place = vec2<f32>(at) / CELL;
    let cell = vec2<i32>(floor(place));
    // The share of the next cell: 0 inside a cell, up to 1 where the next one begins.
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
            let fine = sigma[0] * mixed(0u, a.rgb) + sigma[1] * mixed(1u, b.rgb);
            let coarse = sigma[2] * mixed(2u, c.rgb) + sigma[3] * mixed(3u, vec3(a.w, b.w, c.w));
            sum += weight * (fine + coarse);
            squares += weight * weight;
        }
    }
    return sum * inverseSqrt(squares);
}
