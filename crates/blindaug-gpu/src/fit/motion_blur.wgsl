// The paper's search for the exposure, made continuous. It minimises the error of the sharp image, blurred along the flow, at places of
// contrast; the error is squared up to 1.5 stds, and absolute beyond.

@group(0) @binding(0) var<uniform> params: Params;

@group(0) @binding(1) var sharp: texture_2d_array<f32>;
@group(0) @binding(2) var flow: texture_2d_array<f32>;

fn inside(p: vec2i) -> vec2i {
    return clamp(p, vec2i(0), vec2i(params.size) - 1);
}

// The flow at a pixel, px; 0 where it is unknown.
fn flow_at(p: vec2i) -> vec2f {
    let f = textureLoad(flow, inside(p), 0, 0).xy;
    return select(vec2f(0.0), f, is_finite(f.x) && is_finite(f.y));
}

// The weights of Catmull & Rom's four cubic taps.
fn cubic_weights(f: f32) -> vec4f {
    let f2 = f * f;
    let f3 = f2 * f;
    return 0.5 * vec4f(2.0 * f2 - f3 - f, 3.0 * f3 - 5.0 * f2 + 2.0, 4.0 * f2 - 3.0 * f3 + f, f3 - f2);
}

fn cubic(at: vec2f) -> f32 {
    let p = clamp(at, vec2f(0.0), vec2f(params.size) - 1.0);
    let corner = vec2i(p);
    let x = cubic_weights(p.x - f32(corner.x));
    let y = cubic_weights(p.y - f32(corner.y));
    var sum = 0.0;
    for (var j = 0; j < 4; j++) {
        var line = 0.0;
        for (var i = 0; i < 4; i++) {
            line += x[i] * textureLoad(sharp, inside(corner + vec2i(i, j) - 1), 0, 0).x;
        }
        sum += y[j] * line;
    }
    return sum;
}

// The mean of the sharp image along the path of a pixel.
fn mean_along(p: vec2i, motion: vec2f, lambda: f32) -> f32 {
    let path = lambda * motion;
    let reach = length(path);
    if !(reach > 0.0 && reach < 1000.0) {
        return textureLoad(sharp, p, 0, 0).x;
    }
    let taps = u32(ceil(reach)) + 1u;
    var sum = 0.0;
    for (var i = 0u; i < taps; i++) {
        let t = (f32(i) + 0.5) / f32(taps) - 0.5;
        sum += cubic(vec2f(p) + t * path);
    }
    return sum / f32(taps);
}

@group(0) @binding(3) var target_image: texture_2d_array<f32>;
@group(0) @binding(4) var inverse_std: texture_2d_array<f32>;
@group(0) @binding(5) var<storage, read_write> found: array<Place>;

// Tells whether a pixel moves and does not lie within 8 px of an edge of the motion, across which the flow differs.
fn moves(p: vec2i) -> bool {
    let own = flow_at(p);
    let speed = length(own);
    if speed < 1.0 || speed >= 100.0 {
        return false;
    }
    for (var i = 0; i < 4; i++) {
        let sign = 8 * (i % 2) * 2 - 8;
        let near = inside(p + select(vec2i(0, sign), vec2i(sign, 0), i < 2));
        let other = textureLoad(flow, near, 0, 0).xy;
        if !is_finite(other.x) || !is_finite(other.y) || length(other - own) >= 0.15 * speed + 0.3 {
            return false;
        }
    }
    return true;
}

// Finds in each cell the place of most contrast, in stds of the noise.
@compute @workgroup_size(8, 8)
fn places(@builtin(global_invocation_id) cell: vec3u) {
    if any(cell.xy >= params.cells) {
        return;
    }
    var best = 1.0;
    var place = vec2i(-1);
    let corner = params.margin + params.cell * cell.xy;
    for (var y = 0u; y < params.cell; y += 2u) {
        for (var x = 0u; x < params.cell; x += 2u) {
            let p = vec2i(corner + vec2u(x, y));
            let difference = textureLoad(sharp, p, 0, 0).x - mean_along(p, flow_at(p), 0.7);
            let contrast = abs(difference) * textureLoad(inverse_std, p, 0, 0).x;
            if contrast > 1.0 && contrast >= best {
                best = contrast;
                place = p;
            }
        }
    }
    var out = Place(vec2f(-1.0), 0.0, 0.0);
    if place.x >= 0 && moves(place) {
        out = Place(
            vec2f(place),
            textureLoad(target_image, place, 0, 0).x,
            textureLoad(inverse_std, place, 0, 0).x,
        );
    }
    found[cell.y * params.cells.x + cell.x] = out;
}

@group(0) @binding(3) var<storage, read> found_places: array<Place>;
// STEPS predictions for each place: the blurred sharp image at exposure fractions from 0 to 1.
@group(0) @binding(4) var<storage, read_write> predictions: array<f32>;

@compute @workgroup_size(64)
fn predict(@builtin(global_invocation_id) id: vec3u) {
    let at = id.y * params.cells.x + id.x / STEPS;
    if id.x >= STEPS * params.cells.x {
        return;
    }
    let place = vec2i(found_places[at].at);
    if place.x >= 0 {
        let lambda = f32(id.x % STEPS) / f32(STEPS - 1u);
        predictions[at * STEPS + id.x % STEPS] = mean_along(place, flow_at(place), lambda);
    }
}

@group(0) @binding(1) var<storage, read> seen: array<Place>;
@group(0) @binding(2) var<storage, read> predicted: array<f32>;
// The result: exposure fraction, number of places, information, and the variance of the score at this exposure; then the scores of the
// curve; then the score at this exposure.
@group(0) @binding(3) var<storage, read_write> result: array<f32>;

const THREADS = 128u;

var<workgroup> partials: array<f32, THREADS * STEPS>;
var<workgroup> sums: array<f32, STEPS>;
var<workgroup> histogram: array<atomic<u32>, 16>;

fn model(place: u32, lambda: f32) -> f32 {
    let at = clamp(lambda, 0.0, 1.0) * f32(STEPS - 1u);
    let k = min(u32(at), STEPS - 2u);
    let low = predicted[place * STEPS + k];
    return low + (at - f32(k)) * (predicted[place * STEPS + k + 1u] - low);
}

fn residual(place: u32, lambda: f32) -> f32 {
    return (seen[place].observed - model(place, lambda)) * seen[place].weight;
}

// Adds up the threads' `partials` into `sums`.
fn add_up(thread: u32) {
    workgroupBarrier();
    if thread < STEPS {
        var sum = 0.0;
        for (var i = 0u; i < THREADS; i++) {
            sum += partials[i * STEPS + thread];
        }
        sums[thread] = sum;
    }
    workgroupBarrier();
}

// Puts the score of STEPS exposures into `sums`: minus half the sum of Huber's function of residual over scale. The exposures begin at
// `first` and are `step` apart.
fn score(thread: u32, scale: f32, first: f32, step: f32) {
    var own: array<f32, STEPS>;
    for (var i = thread; i < arrayLength(&seen); i += THREADS) {
        if seen[i].at.x >= 0.0 {
            for (var k = 0u; k < STEPS; k++) {
                let r = abs(residual(i, first + step * f32(k))) / scale;
                own[k] -= select(1.5 * r - 1.125, 0.5 * r * r, r < 1.5);
            }
        }
    }
    for (var k = 0u; k < STEPS; k++) {
        partials[thread * STEPS + k] = own[k];
    }
    add_up(thread);
}

fn best_near(thread: u32, scale: f32, center: f32, reach: f32) -> f32 {
    let first = max(center - reach, 0.0);
    let step = (min(center + reach, 1.0) - first) / f32(STEPS - 1u);
    score(thread, scale, first, step);
    var best = 0u;
    for (var k = 1u; k < STEPS; k++) {
        if sums[k] > sums[best] {
            best = k;
        }
    }
    return first + step * f32(best);
}

// The robust std of the residuals, from their absolute median. Each round finds four bits of the median; the bits of positive floats are in
// the order of the floats.
fn spread(thread: u32, count: u32, lambda: f32) -> f32 {
    var rank = count / 2u;
    var bits = 0u;
    for (var shift = 32u; shift > 0u;) {
        shift -= 4u;
        if thread < 16u {
            atomicStore(&histogram[thread], 0u);
        }
        workgroupBarrier();
        for (var i = thread; i < arrayLength(&seen); i += THREADS) {
            if seen[i].at.x >= 0.0 {
                let r = bitcast<u32>(abs(residual(i, lambda)));
                if (r >> shift) >> 4u == (bits >> shift) >> 4u {
                    atomicAdd(&histogram[(r >> shift) & 15u], 1u);
                }
            }
        }
        workgroupBarrier();
        var digit = 0u;
        for (; digit < 15u; digit++) {
            let n = atomicLoad(&histogram[digit]);
            if rank < n {
                break;
            }
            rank -= n;
        }
        bits |= digit << shift;
        workgroupBarrier();
    }
    return 1.4826 * max(bitcast<f32>(bits), 1e-4);
}

// The residual in stds, its weight in Huber's function, and the derivative of the model in stds.
fn influence(place: u32, scale: f32, lambda: f32) -> vec3f {
    let r = residual(place, lambda) / scale;
    let below = max(lambda - 0.05, 0.0);
    let above = min(lambda + 0.05, 1.0);
    let slope = (model(place, above) - model(place, below)) / (above - below);
    return vec3f(r, min(1.5 / max(abs(r), 1e-9), 1.0), slope * seen[place].weight / scale);
}

@compute @workgroup_size(128)
fn search(@builtin(local_invocation_index) thread: u32) {
    partials[thread * STEPS] = 0.0;
    for (var i = thread; i < arrayLength(&seen); i += THREADS) {
        partials[thread * STEPS] += select(0.0, 1.0, seen[i].at.x >= 0.0);
    }
    for (var k = 1u; k < STEPS; k++) {
        partials[thread * STEPS + k] = 0.0;
    }
    add_up(thread);
    let count = u32(sums[0]);

    var lambda = best_near(thread, 1.0, 0.5, 0.5);
    var reach = array<f32, 3>(0.1, 0.05, 0.02);
    for (var round = 0; round < 3; round++) {
        let scale = spread(thread, count, lambda);
        lambda = best_near(thread, scale, lambda, reach[round]);
    }
    let scale = spread(thread, count, lambda);

    // Blocks of the image are taken as independent, so that the variance of the score is the sum of their squared scores.
    var information = 0.0;
    var variance = 0.0;
    let blocks = params.size / BLOCK + 1u;
    for (var b = thread; b < blocks.x * blocks.y; b += THREADS) {
        let block = vec2u(b % blocks.x, b / blocks.x);
        let corner = BLOCK * block;
        // These are the cells that reach into the block.
        let first = (max(corner, vec2u(params.margin)) - params.margin) / params.cell;
        let end = min((corner + BLOCK) / params.cell + 1u, params.cells);
        var own = 0.0;
        for (var y = first.y; y < end.y; y++) {
            for (var x = first.x; x < end.x; x++) {
                let i = y * params.cells.x + x;
                if seen[i].at.x >= 0.0 && all(vec2u(seen[i].at) / BLOCK == block) {
                    let found = influence(i, scale, lambda);
                    own += found.y * found.x * found.z;
                    information += found.y * found.z * found.z;
                }
            }
        }
        variance += own * own;
    }
    partials[thread * STEPS] = information;
    partials[thread * STEPS + 1u] = variance;
    add_up(thread);
    if thread == 0u {
        result[0] = lambda;
        result[1] = f32(count);
        result[2] = sums[0];
        result[3] = sums[1];
    }
    for (var first = 0u; first < CURVE; first += STEPS) {
        score(thread, scale, 0.02 * f32(first), 0.02);
        if thread < STEPS && first + thread < CURVE {
            result[4u + first + thread] = sums[thread];
        }
        workgroupBarrier();
    }
    score(thread, scale, lambda, 0.0);
    if thread == 0u {
        result[4u + CURVE] = sums[0];
    }
}
