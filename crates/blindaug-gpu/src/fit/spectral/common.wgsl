// What the kernels of the spectral fit share. CPU twin, with the meaning of the constants: crates/blindaug/src/fit/spectral.rs.

struct Params {
    // Width and height of the frame, px.
    size: vec2u,
    linear_light: u32,
    has_flow: u32,
    has_depth: u32,
    exposure: f32,
    // Amount and radius, px, of the camera's unsharp mask.
    sharpening: vec2f,
    // For each resolution: the tiles across and down, its first tile, and where its light begins. The last ones may have no tiles.
    levels: array<vec4u, LEVELS>,
    // Per level: std of the noise per luma and at none, and the variance of white noise of std 1.
    noise: array<vec4f, 4>,
    // Variance of luma of a coder's errors that the exposure is kept from, and the lens.
    coding: vec2f,
}

struct Tile {
    // px of the tile per frame interval.
    motion: vec2f,
    speed: f32,
    inverse_depth: f32,
    noise_moments: vec3f,
    // Whether its parts move alike (or nothing is known to move), and have one depth.
    flags: u32,
    corner: vec2u,
    block: u32,
    scale: f32,
}
const USABLE = 1u;
const DEPTH_KNOWN = 2u;

const BINS = COLUMNS * COLUMNS;
const NONE = 0xffffffffu;

@group(0) @binding(0) var<uniform> params: Params;
