// What the kernels of the spectral fit share. CPU twin, with the meaning of the constants: crates/blindaug/src/fit/spectral.rs.

const USABLE = 1u;
const DEPTH_KNOWN = 2u;

const BINS = COLUMNS * COLUMNS;
const NONE = 0xffffffffu;

@group(0) @binding(0) var<uniform> params: Params;
