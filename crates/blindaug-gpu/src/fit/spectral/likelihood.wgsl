// The declarations that the likelihoods of the exposure and of the lens share.

@group(0) @binding(1) var<storage, read> tiles: array<Tile>;
@group(0) @binding(2) var<storage, read> chosen: array<u32>;
@group(0) @binding(3) var<storage, read> periodograms: array<f32>;
// The frequencies, ring by ring: x, y and modulus (cycles per px of the tile), and the place in a periodogram. `rings` holds the index of
// the first frequency of each ring.
@group(0) @binding(4) var<storage, read> frequencies: array<vec4f>;
@group(0) @binding(5) var<storage, read> rings: array<u32, COLUMNS + 1u>;
// The observations. For each tile chosen for the exposure: 1 if it is valid, its block, its speed, and its clipped log-likelihood. Then for
// each tile chosen for the lens: 1 if it is valid, its block, its inverse depth, and its table over the std.
@group(0) @binding(6) var<storage, read_write> observations: array<f32>;

// The index at which the observations of the lens begin.
const LENSES_AT = EXPOSURE_TILES * EXPOSURE_OBSERVATION;

const PI = 3.14159265;

// The density of the white noise with which a tile is noise-padded against a coder's errors of this variance of luma. The white noise is
// part of the tile's power and of its noise.
fn padding(tile: Tile, coding: f32) -> f32 {
    return coding * tile.noise_moments.z / (tile.scale * tile.scale);
}

// The density of the noise at a modulus, the padding included.
fn noise_density(tile: Tile, modulus: f32, coding: f32) -> f32 {
    let m = tile.noise_moments;
    let level = clamp(log2(0.35 * tile.scale / modulus), 0.0, 3.0);
    let i = min(u32(level), 2u);
    var density: array<f32, 2>;
    for (var k = 0u; k < 2u; k++) {
        let n = params.noise[i + k];
        density[k] = max(n.x * n.x * m.x + 2.0 * n.x * n.y * m.y + n.y * n.y * m.z, 0.0) / n.z;
    }
    let between = density[0] + (level - f32(i)) * (density[1] - density[0]);
    return max(between / (tile.scale * tile.scale), 1e-9) + padding(tile, coding);
}

// The prior precision of the log of the noise's factor, in units of the likelihood before it is tempered. The log of the noise's power may
// be off by error.x, and noise of std error.y in luma may be present beside the measured noise.
fn noise_precision(tile: Tile, error: vec2f, coding: f32) -> f32 {
    let white = tile.noise_moments.z / (tile.scale * tile.scale);
    let unseen = log(1.0 + error.y * error.y * white / noise_density(tile, MIDDLE, coding));
    return 1.0 / (TEMPER * (error.x * error.x + unseen * unseen));
}

// Fills the bins of a ring, as (weight, padded power, component along the motion, modulus), and returns their number.
fn bins_of(index: u32, tile: Tile, ring: u32, coding: f32, bins: ptr<function, array<vec4f, COLUMNS>>) -> u32 {
    let moves = tile.speed >= MIN_SPEED;
    let direction = tile.motion / max(tile.speed, 1e-30);
    for (var i = rings[ring]; i < rings[ring + 1u]; i++) {
        let f = frequencies[i];
        let along = select(0.0, abs(f.x * direction.x + f.y * direction.y), moves);
        let power = periodograms[index * COLUMNS * TILE + u32(f.w)] + padding(tile, coding);
        let bin = min(u32(along * f32(TILE)), COLUMNS - 1u);
        (*bins)[bin] += select(1.0, 0.5, f.x == 0.0) * vec4f(1.0, power, along, f.z);
    }
    var n = 0u;
    for (var i = 0u; i < COLUMNS; i++) {
        let bin = (*bins)[i];
        if bin.x > 0.0 {
            (*bins)[n] = vec4f(bin.x, bin.yzw / bin.x);
            n++;
        }
    }
    return n;
}

// The power of a scene at the two frequencies LEAK below and above a bin along the motion, which leak into the bin, relative to that in the
// bin.
fn leaks_of(tile: Tile, bin: vec4f) -> vec2f {
    if tile.speed <= 0.0 {
        return vec2f(1.0);
    }
    let by = vec2f(-LEAK, LEAK);
    let square = 1.0 + (2.0 * bin.z + by) * by / (bin.w * bin.w);
    return exp(-0.5 * ALPHA * log(max(square, vec2f(0.1))));
}

// Sine and cosine, exact to rounding (Moshier's Cephes). WGSL's own functions may be off by 1/2000, and by anything beyond pi.
fn sine_and_cosine(x: f32) -> vec2f {
    let turns = round(x * (2.0 / PI));
    let r = x - turns * 1.5703125 - turns * 4.837513e-4 - turns * 7.54979e-8;
    let r2 = r * r;
    let s = r + r * r2 * (-1.6666655e-1 + r2 * (8.332161e-3 - r2 * 1.9515296e-4));
    let c = 1.0 - 0.5 * r2 + r2 * r2 * (4.1666646e-2 + r2 * (-1.3887316e-3 + r2 * 2.4433157e-5));
    let quarter = i32(turns) & 3;
    let turned = select(vec2f(s, c), vec2f(c, -s), (quarter & 1) == 1);
    return select(turned, -turned, (quarter & 2) == 2);
}

fn sinc2(sine: f32, x: f32) -> f32 {
    if abs(x) < 1e-3 {
        return 1.0;
    }
    return sine / x * (sine / x);
}

// |K_MB|^2 of a bin, averaged with the frequencies beside it.
fn shutter_gain(speed: f32, along: f32, leaks: vec2f, lambda: f32) -> f32 {
    let reach = PI * lambda * speed;
    let x = along * reach;
    let d = LEAK * reach;
    let own = sine_and_cosine(x);
    let by = sine_and_cosine(d);
    let a = own.x * by.y;
    let b = own.y * by.x;
    let sum = 4.0 * sinc2(own.x, x) + leaks.x * sinc2(a - b, x - d) + leaks.y * sinc2(a + b, x + d);
    return sum / 6.0 + SHUTTER_FLOOR;
}

// The memory for tables and curves, one after the other.
var<workgroup> values: array<f32, MAX_STEPS + 2u * (EXPOSURES + 1u)>;

// Interpolates between the entries of a table in `values` by Catmull & Rom's cubic, whose ends continue in a straight line.
fn interpolate(table: u32, len: u32, at: f32) -> f32 {
    let i = min(u32(at), len - 2u);
    let f = clamp(at - f32(i), 0.0, 1.0);
    let a = values[table + i];
    let b = values[table + i + 1u];
    var before = 2.0 * a - b;
    if i > 0u {
        before = values[table + i - 1u];
    }
    var after = 2.0 * b - a;
    if i + 2u < len {
        after = values[table + i + 2u];
    }
    let f2 = f * f;
    let f3 = f2 * f;
    return (2.0 * f3 - 3.0 * f2 + 1.0) * a + (f3 - 2.0 * f2 + f) * 0.5 * (b - before)
        + (3.0 * f2 - 2.0 * f3) * b + (f3 - f2) * 0.5 * (after - a);
}
