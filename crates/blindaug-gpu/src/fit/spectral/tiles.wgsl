// Makes the periodograms of a frame's tiles from the frame, its flow and its inverse depth.

@group(0) @binding(1) var frame: texture_2d_array<f32>;
// The luma on which blur acts, of light or of encoded values: first of the frame, then of each further resolution, whose pixels are means
// of 2 x 2 px of the one before.
@group(0) @binding(2) var<storage, read_write> light_out: array<f32>;

var<workgroup> means: array<f32, 64>;

@compute @workgroup_size(8, 8)
fn light(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(local_invocation_index) thread: u32,
) {
    var sum = 0.0;
    for (var i = 0u; i < 4u; i++) {
        let p = 2u * id.xy + vec2u(i & 1u, i >> 1u);
        if all(p < params.size) {
            let v = textureLoad(frame, p, 0, 0).xyz;
            var out = luma(v);
            if params.linear_light != 0u {
                out = luma(decode(v));
            }
            light_out[p.y * params.size.x + p.x] = out;
            sum += out;
        }
    }
    for (var level = 1u; level < LEVELS; level++) {
        // The threads that hold means of one resolution are this far apart.
        let step = 1u << (level - 1u);
        if all(local.xy % step == vec2u(0u)) {
            if level > 1u {
                let half = step / 2u;
                sum = means[thread] + means[thread + half] + means[thread + 8u * half] + means[thread + 9u * half];
            }
            means[thread] = 0.25 * sum;
            let p = id.xy / step;
            let size = params.size >> vec2u(level);
            if params.levels[level].x > 0u && all(p < size) {
                light_out[params.levels[level].w + p.y * size.x + p.x] = 0.25 * sum;
            }
        }
        workgroupBarrier();
    }
}

@group(0) @binding(2) var flow: texture_2d_array<f32>;
@group(0) @binding(3) var inverse_depth: texture_2d_array<f32>;
@group(0) @binding(4) var<storage, read_write> tiles_out: array<Tile>;

const LOCATE_THREADS = 64u;
// SAMPLES is the number of every second pixel of a tile, each way. The two components of the flow and the inverse depth are kept as
// unsigned numbers in the order of the values; UNKNOWN, the largest, stands for unknown values.
var<workgroup> keys: array<array<u32, SAMPLES>, 3>;
const UNKNOWN = 0xffffffffu;
// The order statistics that are looked for: the medians of the two components of the flow, and three quantiles of inverse depth. Each has a
// histogram of its own.
const STATISTICS = 5u;
var<workgroup> histogram: array<atomic<u32>, STATISTICS * 16u>;
var<workgroup> selected: array<u32, STATISTICS>;
var<workgroup> ranks: array<u32, STATISTICS>;
var<workgroup> partial_sums: array<vec4f, LOCATE_THREADS>;

fn key_of(v: f32) -> u32 {
    let bits = bitcast<u32>(v);
    return select(bits | 0x80000000u, ~bits, bits >> 31u == 1u);
}

fn of_key(key: u32) -> f32 {
    return bitcast<f32>(select(~key, key & 0x7fffffffu, key >> 31u == 1u));
}

// The sum of all threads' values.
fn total(thread: u32, own: vec4f) -> vec4f {
    partial_sums[thread] = own;
    workgroupBarrier();
    var sum = vec4f(0.0);
    for (var i = 0u; i < LOCATE_THREADS; i++) {
        sum += partial_sums[i];
    }
    workgroupBarrier();
    return sum;
}

// Y^2, Y and 1 of a pixel, times the variance of the noise of light over that of luma.
fn moments_of(p: vec3f) -> vec3f {
    var gain = 1.0;
    if params.linear_light != 0u {
        let slopes = encoding_slope(decode(max(p, vec3f(0.02))));
        gain = dot(LUMA * LUMA, 1.0 / (slopes * slopes)) / dot(LUMA, LUMA);
    }
    let y = luma(p);
    return gain * vec3f(y * y, y, 1.0);
}

// Finds where each tile lies, how it moves and how far it is. This function is long, since all threads of a workgroup must reach each
// barrier together and exchange results through shared memory.
@compute @workgroup_size(64)
fn locate(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    var level = 0u;
    while level + 1u < LEVELS && group.x >= params.levels[level + 1u].z {
        level++;
    }
    let index = group.x - params.levels[level].z;
    let across = params.levels[level].x;
    let scale = 1u << level;
    let corner = TILE / 2u * vec2u(index % across, index / across);
    var known = vec4f(0.0);
    for (var i = thread; i < SAMPLES; i += LOCATE_THREADS) {
        let p = scale * (corner + 2u * vec2u(i % (TILE / 2u), i / (TILE / 2u)));
        let f = textureLoad(flow, p, 0, 0).xy / f32(scale);
        let d = textureLoad(inverse_depth, p, 0, 0).x;
        let moves = params.has_flow != 0u && is_finite(f.x) && is_finite(f.y);
        let placed = params.has_depth != 0u && is_finite(d);
        keys[0][i] = select(UNKNOWN, key_of(f.x), moves);
        keys[1][i] = select(UNKNOWN, key_of(f.y), moves);
        keys[2][i] = select(UNKNOWN, key_of(d), placed);
        known += vec4f(f32(moves), f32(placed), 0.0, 0.0);
    }
    known = total(thread, known);
    if thread < STATISTICS {
        let share = f32(max(u32(known.y), 1u) - 1u);
        var rank = u32(known.x) / 2u;
        switch thread {
            case 2u: { rank = u32(0.1 * share); }
            case 3u: { rank = u32(0.5 * share); }
            case 4u: { rank = u32(0.9 * share); }
            default: {}
        }
        ranks[thread] = rank;
        selected[thread] = 0u;
    }
    // Each round finds four bits of every statistic.
    for (var shift = 32u; shift > 0u;) {
        shift -= 4u;
        for (var i = thread; i < STATISTICS * 16u; i += LOCATE_THREADS) {
            atomicStore(&histogram[i], 0u);
        }
        workgroupBarrier();
        for (var i = thread; i < SAMPLES; i += LOCATE_THREADS) {
            for (var s = 0u; s < STATISTICS; s++) {
                let key = keys[min(s, 2u)][i];
                if (key >> shift) >> 4u == (selected[s] >> shift) >> 4u {
                    atomicAdd(&histogram[16u * s + ((key >> shift) & 15u)], 1u);
                }
            }
        }
        workgroupBarrier();
        if thread < STATISTICS {
            var rank = ranks[thread];
            var digit = 0u;
            for (; digit < 15u; digit++) {
                let n = atomicLoad(&histogram[16u * thread + digit]);
                if rank < n {
                    break;
                }
                rank -= n;
            }
            ranks[thread] = rank;
            selected[thread] |= digit << shift;
        }
        workgroupBarrier();
    }
    let motion = vec2f(of_key(selected[0]), of_key(selected[1]));
    var sums = vec4f(0.0);
    for (var i = thread; i < SAMPLES; i += LOCATE_THREADS) {
        if keys[0][i] != UNKNOWN {
            sums.x += length(vec2f(of_key(keys[0][i]), of_key(keys[1][i])) - motion);
        }
    }
    // The moments of the noise are means over every second pixel of the frame, each way.
    let side = TILE * scale / 2u;
    for (var i = thread; i < side * side; i += LOCATE_THREADS) {
        let p = 2u * vec2u(i % side, i / side) + scale * corner;
        sums += vec4f(0.0, moments_of(textureLoad(frame, p, 0, 0).xyz));
    }
    sums = total(thread, sums);

    if thread == 0u {
        var tile = Tile(vec2f(0.0), 0.0, 0.0, sums.yzw / f32(side * side), USABLE, corner, 0u, f32(scale));
        if params.has_flow != 0u {
            let speed = length(motion);
            tile.motion = motion;
            tile.speed = speed;
            let deviation = sums.x / max(known.x, 1.0);
            if known.x < f32(KNOWN_SAMPLES) || deviation > max(0.15 * speed, 0.5) || speed > MAX_SPEED {
                tile.flags = 0u;
            }
        }
        let low = of_key(selected[2]);
        let middle = of_key(selected[3]);
        let high = of_key(selected[4]);
        if known.y >= f32(SAMPLES / 2u) && high - low <= 0.25 * abs(middle) {
            tile.inverse_depth = middle;
            tile.flags |= DEPTH_KNOWN;
        }
        // The image has BLOCKS blocks each way.
        let cell = corner * BLOCKS / (params.size / scale);
        tile.block = BLOCKS * cell.y + cell.x;
        tiles_out[group.x] = tile;
    }
}

@group(0) @binding(1) var<storage, read> light_in: array<f32>;
@group(0) @binding(2) var<storage, read> tiles: array<Tile>;
// The window, and sine and cosine of each 48th of a turn.
@group(0) @binding(3) var<storage, read> tables: array<vec4f, TILE>;
// The frequencies: x, y and modulus (cycles per px of the tile), and the place in a periodogram.
@group(0) @binding(4) var<storage, read> frequencies: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> periodograms: array<f32>;
// The power of a tile in all frequencies; -1 for tiles that are not usable.
@group(0) @binding(6) var<storage, read_write> contrasts: array<f32>;

const THREADS = 128u;
// The number of values in `z` of 24 pairs of rows; after the rows come the columns of their transforms.
const ROWS = TILE * TILE / 2u;
var<workgroup> z: array<vec2f, ROWS + COLUMNS * TILE>;
var<workgroup> partials: array<f32, THREADS>;

fn sum_of_partials() -> f32 {
    workgroupBarrier();
    var sum = 0.0;
    for (var i = 0u; i < THREADS; i++) {
        sum += partials[i];
    }
    workgroupBarrier();
    return sum;
}

// The product a exp(-2 pi i k / 48).
fn turned(a: vec2f, k: u32) -> vec2f {
    let t = tables[k % TILE];
    return vec2f(a.x * t.z + a.y * t.y, a.y * t.z - a.x * t.y);
}

// Transforms 48 values in place, by 6 x 8 (Cooley & Tukey 1965). This first step takes six values that are 8 apart.
fn transform_sixes(line: u32, n: u32) {
    var v: array<vec2f, 6>;
    for (var i = 0u; i < 6u; i++) {
        v[i] = z[line + 8u * i + n];
    }
    for (var k = 0u; k < 6u; k++) {
        var sum = v[0];
        for (var i = 1u; i < 6u; i++) {
            sum += turned(v[i], 8u * i * k);
        }
        z[line + 8u * k + n] = turned(sum, n * k);
    }
}

// The second step takes eight values in a row. Frequency k ends up at place(k).
fn transform_eights(line: u32, n: u32) {
    var v: array<vec2f, 8>;
    for (var i = 0u; i < 8u; i++) {
        v[i] = z[line + 8u * n + i];
    }
    for (var k = 0u; k < 8u; k++) {
        var sum = v[0];
        for (var i = 1u; i < 8u; i++) {
            sum += turned(v[i], 6u * i * k);
        }
        z[line + 8u * n + k] = sum;
    }
}

fn place(frequency: u32) -> u32 {
    return 8u * (frequency % 6u) + frequency / 6u;
}

// The periodogram |FFT(window (tile - mean))|^2 / 48^2.
@compute @workgroup_size(128)
fn periodogram(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let tile = tiles[group.x];
    if (tile.flags & USABLE) == 0u {
        if thread == 0u {
            contrasts[group.x] = -1.0;
        }
        return;
    }
    let level = firstTrailingBit(u32(tile.scale));
    let width = params.size.x >> level;
    let first = params.levels[level].w + tile.corner.y * width + tile.corner.x;
    var own = 0.0;
    var weight = 0.0;
    for (var i = 0u; i < TILE; i++) {
        weight += tables[i].x;
    }
    for (var i = thread; i < TILE * TILE; i += THREADS) {
        let p = vec2u(i % TILE, i / TILE);
        own += tables[p.x].x * tables[p.y].x * light_in[first + p.y * width + p.x];
    }
    partials[thread] = own;
    let mean = sum_of_partials() / (weight * weight);
    // Two rows of real values are transformed as one row of complex values.
    for (var i = thread; i < ROWS; i += THREADS) {
        let x = i % TILE;
        let y = 2u * (i / TILE);
        let at = first + y * width + x;
        let window = tables[x].x * vec2f(tables[y].x, tables[y + 1u].x);
        z[i] = window * (vec2f(light_in[at], light_in[at + width]) - mean);
    }
    workgroupBarrier();
    for (var i = thread; i < TILE / 2u * 8u; i += THREADS) {
        transform_sixes(i / 8u * TILE, i % 8u);
    }
    workgroupBarrier();
    for (var i = thread; i < TILE / 2u * 6u; i += THREADS) {
        transform_eights(i / 6u * TILE, i % 6u);
    }
    workgroupBarrier();
    for (var i = thread; i < TILE / 2u * COLUMNS; i += THREADS) {
        let x = i / (TILE / 2u);
        let pair = i % (TILE / 2u);
        let a = z[pair * TILE + place(x)];
        let b = z[pair * TILE + place((TILE - x) % TILE)];
        let column = ROWS + x * TILE + 2u * pair;
        z[column] = 0.5 * vec2f(a.x + b.x, a.y - b.y);
        z[column + 1u] = 0.5 * vec2f(a.y + b.y, b.x - a.x);
    }
    workgroupBarrier();
    for (var i = thread; i < COLUMNS * 8u; i += THREADS) {
        transform_sixes(ROWS + i / 8u * TILE, i % 8u);
    }
    workgroupBarrier();
    for (var i = thread; i < COLUMNS * 6u; i += THREADS) {
        transform_eights(ROWS + i / 6u * TILE, i % 6u);
    }
    workgroupBarrier();
    own = 0.0;
    for (var i = thread; i < arrayLength(&frequencies); i += THREADS) {
        let f = frequencies[i];
        let at = u32(f.w);
        let v = z[ROWS + at / TILE * TILE + place(at % TILE)];
        let power = dot(v, v) / f32(TILE * TILE);
        periodograms[group.x * COLUMNS * TILE + at] = power;
        own += select(power, 0.5 * power, f.x == 0.0);
    }
    partials[thread] = own;
    let contrast = sum_of_partials();
    if thread == 0u {
        contrasts[group.x] = select(-1.0, contrast, is_finite(contrast));
    }
}

@group(0) @binding(1) var<storage, read> contrast_of: array<f32>;
// The numbers of the tiles that are chosen: first those of most contrast, in their order, for the exposure; then, in each block of the
// image, those of most contrast for the lens. NONE stands where there is no tile.
@group(0) @binding(3) var<storage, read_write> chosen_out: array<u32>;

@compute @workgroup_size(64)
fn choose(@builtin(global_invocation_id) id: vec3u) {
    let n = arrayLength(&contrast_of);
    let of_lens = id.x / LENS_TILES_PER_BLOCK;
    // `rank` counts the tiles that come before tile `id.x`, in the image and in its block. `usable` counts the usable tiles, in the image
    // and in block `of_lens`.
    let own = select(-1.0, contrast_of[min(id.x, n - 1u)], id.x < n);
    let block = tiles[min(id.x, n - 1u)].block;
    var rank = vec2u(0u);
    var usable = vec2u(0u);
    for (var i = 0u; i < n; i++) {
        let other = contrast_of[i];
        let above = other > own || (other == own && i < id.x);
        rank += select(vec2u(0u), vec2u(1u, u32(tiles[i].block == block)), above);
        usable += select(vec2u(0u), vec2u(1u, u32(tiles[i].block == of_lens)), other >= 0.0);
    }
    if own >= 0.0 && rank.x < EXPOSURE_TILES {
        chosen_out[rank.x] = id.x;
    }
    if own >= 0.0 && rank.y < LENS_TILES_PER_BLOCK {
        let enough = rank.x < max(4u * usable.x / 5u, EXPOSURE_TILES);
        chosen_out[EXPOSURE_TILES + block * LENS_TILES_PER_BLOCK + rank.y] = select(NONE, id.x, enough);
    }
    if id.x >= usable.x && id.x < EXPOSURE_TILES {
        chosen_out[id.x] = NONE;
    }
    if of_lens < BLOCK_COUNT && id.x % LENS_TILES_PER_BLOCK >= usable.y {
        chosen_out[EXPOSURE_TILES + id.x] = NONE;
    }
}
