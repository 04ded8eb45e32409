// The declarations that all kernels of the blind fits share. The CPU twins, tiles.rs and likelihood.rs in crates/blindaug/src/fit, explain
// the constants.

// The flags of a tile. USABLE: its parts move alike, or there is no flow. DEPTH_KNOWN: its parts have one depth.
const USABLE = 1u;
const DEPTH_KNOWN = 2u;

// The most bins of a tile: it has COLUMNS rings of like modulus, each of at most COLUMNS bins.
const BINS = COLUMNS * COLUMNS;

// The index that stands for no tile.
const NONE = 0xffffffffu;

@group(0) @binding(0) var<uniform> params: Params;
