// The clipped log-likelihood of each exposure, given a tile, with V = amplitude of the ring * exp(c2 cos 2 theta + c4 cos 4 theta)
// |K_MB|^2 + exp(e) n. c2, c4 and e take their most likely values by Fisher scoring, the amplitudes are integrated over. Each thread looks
// after a ring.

const THREADS = 32u;
// The precisions of the priors of c2, c4 and e, in units of the likelihood before it is tempered.
var<private> precisions: vec3f;

// The properties of the bins; each ring has COLUMNS places.
var<workgroup> weight: array<f32, BINS>;
var<workgroup> power: array<f32, BINS>;
var<workgroup> noise: array<f32, BINS>;
var<workgroup> along: array<f32, BINS>;
var<workgroup> cos2: array<f32, BINS>;
var<workgroup> leaks: array<vec2f, BINS>;
var<workgroup> shutter: array<f32, BINS>;
// The sums of a ring: its log-likelihood; the score of c2, c4 and e; the same score without what the amplitude explains; and the six
// numbers of their information.
const SUMS = 13u;
var<workgroup> ring_sums: array<f32, SUMS * COLUMNS>;
var<workgroup> sums: array<f32, SUMS>;
// The gain in log-likelihood from each ring's amplitude, for each exposure of the table.
var<workgroup> gains: array<f32, MAX_STEPS * COLUMNS>;
var<workgroup> ends: array<vec2f, THREADS>;
var<workgroup> has_contrast: u32;

struct Scene {
    // The logarithm of the ring's amplitude.
    amplitude: f32,
    // c2, c4 and e.
    nuisances: vec3f,
}

struct Improved {
    scene: Scene,
    // The log-likelihood after the step, if it is quadratic, without the gains from the amplitudes; and the gain from this ring's
    // amplitude.
    log_likelihood: f32,
    gain: f32,
}

// Makes one step of Fisher scoring in all unknowns at once. Since a ring's amplitude touches no other ring's, it is eliminated first.
fn improve(thread: u32, n: u32, before: Scene) -> Improved {
    var own_score = 0.0;
    var own = 0.0;
    var mixed = vec3f(0.0);
    var score = vec3f(0.0);
    var log_likelihood = 0.0;
    // The information of c2 with itself; of c4 with c2 and itself; of e with c2, c4 and itself.
    var first = 0.0;
    var second = vec2f(0.0);
    var third = vec3f(0.0);
    let factor = exp(before.nuisances.z);
    for (var i = COLUMNS * thread; i < COLUMNS * thread + n; i++) {
        let c2 = cos2[i];
        let c4 = 2.0 * c2 * c2 - 1.0;
        let direction = before.nuisances.x * c2 + before.nuisances.y * c4;
        let signal = exp(before.amplitude + direction) * shutter[i];
        let variance = signal + factor * noise[i];
        let ratio = power[i] / variance;
        log_likelihood -= weight[i] * (log(variance) + ratio);
        let excess = weight[i] * (ratio - 1.0);
        let share = signal / variance;
        let slopes = vec3f(share * c2, share * c4, 1.0 - share);
        let weighted = weight[i] * slopes;
        own_score += share * excess;
        own += weight[i] * share * share;
        score += slopes * excess;
        mixed += share * weighted;
        first += weighted.x * slopes.x;
        second += weighted.y * slopes.xy;
        third += weighted.z * slopes;
    }
    own += 1e-6;
    if thread < COLUMNS {
        let left = score - mixed * own_score / own;
        let explained = mixed / own;
        var out = array<f32, SUMS>(
            log_likelihood, score.x, score.y, score.z, left.x, left.y, left.z,
            first - mixed.x * explained.x,
            second.x - mixed.y * explained.x, second.y - mixed.y * explained.y,
            third.x - mixed.z * explained.x, third.y - mixed.z * explained.y, third.z - mixed.z * explained.z,
        );
        for (var k = 0u; k < SUMS; k++) {
            ring_sums[k * COLUMNS + thread] = out[k];
        }
    }
    workgroupBarrier();
    if thread < SUMS {
        var sum = 0.0;
        for (var i = 0u; i < COLUMNS; i++) {
            sum += ring_sums[thread * COLUMNS + i];
        }
        sums[thread] = sum;
    }
    workgroupBarrier();
    let prior = precisions * before.nuisances;
    let slope = vec3f(sums[1], sums[2], sums[3]) - prior;
    let step = solve(vec3f(sums[4], sums[5], sums[6]) - prior);
    let change = clamp((own_score - dot(mixed, step)) / own, -1.5, 1.5);
    return Improved(
        Scene(before.amplitude + change, before.nuisances + step),
        sums[0] - 0.5 * dot(prior, before.nuisances) + 0.5 * dot(slope, step),
        0.5 * own_score * change - 0.5 * CORRELATED * log(own + AMPLITUDE_PRECISION),
    );
}

// Solves for the step by Cholesky's decomposition of the information. The step is clamped, since far from the solution a whole step may go
// too far.
fn solve(score: vec3f) -> vec3f {
    let l00 = sqrt(max(sums[7] + precisions.x, 1e-9));
    let l10 = sums[8] / l00;
    let l11 = sqrt(max(sums[9] + precisions.y - l10 * l10, 1e-9));
    let l20 = sums[10] / l00;
    let l21 = (sums[11] - l20 * l10) / l11;
    let l22 = sqrt(max(sums[12] + precisions.z - l20 * l20 - l21 * l21, 1e-9));
    var x = vec3f(score.x / l00, 0.0, 0.0);
    x.y = (score.y - l10 * x.x) / l11;
    x.z = (score.z - l20 * x.x - l21 * x.y) / l22;
    x.z = x.z / l22;
    x.y = (x.y - l21 * x.z) / l11;
    x.x = (x.x - l10 * x.y - l20 * x.z) / l00;
    return clamp(x, vec3f(-0.7), vec3f(0.7));
}

// This function is long, since all threads of a workgroup must reach each barrier together and exchange results through shared memory.
@compute @workgroup_size(32)
fn exposure(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let observation = group.x * EXPOSURE_OBSERVATION;
    let index = chosen[group.x];
    if thread == 0u {
        observations[observation] = 0.0;
    }
    if index == NONE {
        return;
    }
    let tile = tiles[index];
    if thread == 0u {
        observations[observation + 1u] = f32(tile.block);
        observations[observation + 2u] = tile.speed * tile.scale;
    }
    if tile.speed < MIN_SPEED {
        return;
    }
    precisions = vec3f(1.0 / (TEMPER * DIRECTION * DIRECTION), noise_precision(tile, EXPOSURE_NOISE_ERROR, params.coding.x));
    var n = 0u;
    var scene = Scene(0.0, vec3f(0.0));
    if thread < COLUMNS {
        var bins: array<vec4f, COLUMNS>;
        n = bins_of(index, tile, thread, params.coding.x, &bins);
        var weighted = vec2f(0.0);
        var unweighted = vec2f(0.0);
        for (var i = 0u; i < n; i++) {
            let bin = bins[i];
            let at = COLUMNS * thread + i;
            weight[at] = bin.x;
            power[at] = bin.y;
            noise[at] = noise_density(tile, bin.w, params.coding.x);
            along[at] = bin.z;
            let cosine = min(bin.z / bin.w, 1.0);
            cos2[at] = 2.0 * cosine * cosine - 1.0;
            leaks[at] = leaks_of(tile, bin);
            let seen = vec2f(bin.y, noise[at]);
            weighted += bin.x * seen;
            unweighted += seen;
        }
        let excess = max(max(unweighted.x - unweighted.y, 0.01 * unweighted.x), 1e-12);
        scene.amplitude = log(excess / f32(max(n, 1u)));
        ring_sums[thread] = weighted.x;
        ring_sums[COLUMNS + thread] = weighted.y;
    }
    workgroupBarrier();
    if thread == 0u {
        var seen = 0.0;
        var noise = 0.0;
        for (var i = 0u; i < COLUMNS; i++) {
            seen += ring_sums[i];
            noise += ring_sums[COLUMNS + i];
        }
        has_contrast = u32(seen > MIN_CONTRAST * noise);
        observations[observation] = f32(has_contrast);
    }
    if workgroupUniformLoad(&has_contrast) == 0u {
        return;
    }

    // Whole speeds lead to halves; these are rounded up even where the division is not exact.
    let steps = floor(MAX_LAMBDA / clamp(STREAK_STEP / tile.speed, LEAST_STEP, LARGEST_STEP) + 0.5001);
    let step = MAX_LAMBDA / steps;
    let len = u32(steps) + 1u;
    for (var l = 0u; l < len; l++) {
        for (var i = COLUMNS * thread; i < COLUMNS * thread + n; i++) {
            shutter[i] = shutter_gain(tile.speed, along[i], leaks[i], f32(l) * step);
        }
        // Few rounds suffice where the scoring starts near its solution, that is, except for the first exposure of the table.
        let rounds = select(2u, 13u, l == 0u);
        var improved: Improved;
        for (var i = 0u; i < rounds; i++) {
            improved = improve(thread, n, scene);
            scene = improved.scene;
        }
        if thread < COLUMNS {
            gains[l * COLUMNS + thread] = improved.gain;
        }
        if thread == 0u {
            values[l] = improved.log_likelihood;
        }
    }
    workgroupBarrier();
    if thread < len {
        var sum = values[thread];
        for (var i = 0u; i < COLUMNS; i++) {
            sum += gains[thread * COLUMNS + i];
        }
        values[thread] = TEMPER * sum;
    }
    workgroupBarrier();
    var highest = values[0];
    for (var i = 1u; i < len; i++) {
        highest = max(highest, values[i]);
    }

    // The likelihood is averaged over the length that texture may add to streaks. Where this average is wide, few of the exposures need to
    // be computed.
    let width = STREAK_ERROR / tile.speed / EXPOSURE_STEP;
    let stride = clamp(u32(0.25 * width), 1u, 8u);
    let count = (EXPOSURES - 1u + stride - 1u) / stride + 1u;
    let likelihood = MAX_STEPS;
    for (var i = thread; i < count; i += THREADS) {
        values[likelihood + i] = exp(interpolate(0u, len, f32(i * stride) * EXPOSURE_STEP / step) - highest);
    }
    workgroupBarrier();
    let blurred = likelihood + EXPOSURES + 1u;
    let sigma = width / f32(stride);
    let reach = u32(3.0 * sigma);
    for (var at = thread; at < count; at += THREADS) {
        var sum = 0.0;
        var total = 0.0;
        for (var i = max(at, reach) - reach; i < min(at + reach + 1u, count); i++) {
            let distance = (f32(i) - f32(at)) / sigma;
            let w = exp(-0.5 * distance * distance);
            sum += w * values[likelihood + i];
            total += w;
        }
        values[blurred + at] = log(max(sum / total, 1.2e-38));
    }
    workgroupBarrier();
    // The highest and the lowest value of this thread's exposures.
    var own_ends = vec2f(-1e30, 1e30);
    for (var i = thread; i < EXPOSURES; i += THREADS) {
        let v = interpolate(blurred, count, f32(i) / f32(stride));
        own_ends = vec2f(max(own_ends.x, v), min(own_ends.y, v));
    }
    ends[thread] = own_ends;
    workgroupBarrier();
    var all = ends[0];
    for (var i = 1u; i < THREADS; i++) {
        all = vec2f(max(all.x, ends[i].x), min(all.y, ends[i].y));
    }
    let most = all.x - all.y;
    for (var i = thread; i < EXPOSURES; i += THREADS) {
        let v = interpolate(blurred, count, f32(i) / f32(stride)) - all.x;
        observations[observation + HEAD + i] = clamp(v * most / (most + INFORMATIVE), -CLIP, 0.0);
    }
}
