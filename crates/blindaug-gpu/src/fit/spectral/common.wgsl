// What all kernels of the blind fits share. CPU twins, with the meaning of the constants: tiles.rs and likelihood.rs in
// crates/blindaug/src/fit.

// The flags of a tile: its parts move alike, or nothing is known to move; and they have one depth.
const USABLE = 1u;
const DEPTH_KNOWN = 2u;

// The most bins of a tile: it has COLUMNS rings of like modulus, each of which has at most as many bins.
const BINS = COLUMNS * COLUMNS;

// Stands where there is no tile.
const NONE = 0xffffffffu;

@group(0) @binding(0) var<uniform> params: Params;
