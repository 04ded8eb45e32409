// The log-likelihood of each defocus std, given a tile, with V = a / |w|^alpha |K_MB|^2 |K_DoF|^2 + n. The amplitude a and the noise's
// exact power take their most likely values, and the slope alpha is integrated over. Eight threads look after each of six slopes.

// The table of |K_DoF|^2: GAINS values over the modulus for each std, in steps of 1/256 cycle per px.
@group(0) @binding(7) var<storage, read> lens_gains: array<f32>;

const LANES = 8u;

// The properties of the bins, ring after ring; bins that motion blur leaves alike are merged.
var<workgroup> weight: array<f32, BINS>;
var<workgroup> power: array<f32, BINS>;
var<workgroup> noise: array<f32, BINS>;
var<workgroup> modulus: array<f32, BINS>;
var<workgroup> shutter: array<f32, BINS>;
// The power of the signal without defocus at amplitude 1, for each slope and bin.
var<workgroup> scenes: array<f32, ALPHAS * BINS>;
var<workgroup> counts: array<u32, COLUMNS>;
var<workgroup> lane_sums: array<vec3f, ALPHAS * LANES>;
var<workgroup> has_contrast: u32;

// The distance of a slope from the prior's mean, in stds of the prior.
fn deviation(alpha: u32) -> f32 {
    return 0.8 * (f32(alpha) - 0.5 * f32(ALPHAS - 1u));
}

// Adds up the values of the threads of a slope.
fn lanes_total(thread: u32, own: vec3f) -> vec3f {
    lane_sums[thread] = own;
    workgroupBarrier();
    var sum = vec3f(0.0);
    for (var i = 0u; i < LANES; i++) {
        sum += lane_sums[thread / LANES * LANES + i];
    }
    workgroupBarrier();
    return sum;
}

fn lens_gain(sigma: u32, modulus: f32) -> f32 {
    let at = min(modulus * 256.0, f32(GAINS) - 1.001);
    let i = sigma * GAINS + u32(at);
    return lens_gains[i] + fract(at) * (lens_gains[i + 1u] - lens_gains[i]);
}

// The std, px, that an index of the tables stands for; `index_of` is its inverse.
fn sigma_of(index: u32) -> f32 {
    let i = f32(index);
    return select(max(3.0 + 0.5 * (i - 20.0), 10.0 + 2.0 * (i - 34.0)), 0.15 * i, index <= 20u);
}

fn index_of(sigma: f32) -> f32 {
    let coarse = min(20.0 + (sigma - 3.0) / 0.5, 34.0 + max(sigma - 10.0, 0.0) / 2.0);
    return clamp(select(coarse, sigma / 0.15, sigma <= 3.0), 0.0, f32(SIGMAS - 1u));
}

// The log-likelihood of a std of the tables, px of the frame, that a tile of this scale gives.
fn of_frame(index: u32, scale: f32) -> f32 {
    let sigma = sigma_of(index) / scale;
    let largest = sigma_of(TILE_SIGMAS - 1u);
    return interpolate(0u, TILE_SIGMAS, index_of(min(sigma, largest))) - LARGER_BLUR * max(sigma - largest, 0.0);
}

// This function is long, since all threads of a workgroup must reach each barrier together and exchange results through shared memory.
@compute @workgroup_size(48)
fn defocus(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let observation = LENSES_AT + group.x * LENS_OBSERVATION;
    let index = chosen[EXPOSURE_TILES + group.x];
    if thread == 0u {
        observations[observation] = 0.0;
    }
    if index == NONE {
        return;
    }
    let tile = tiles[index];
    if (tile.flags & DEPTH_KNOWN) == 0u {
        return;
    }
    // Neighbouring bins of a ring are taken together if motion blur leaves them alike.
    var bins: array<vec4f, COLUMNS>;
    var gains: array<f32, COLUMNS>;
    var densities: array<f32, COLUMNS>;
    var n = 0u;
    if thread < COLUMNS {
        let all = bins_of(index, tile, thread, params.coding.y, &bins);
        var seen = vec3f(0.0);
        var first = 0.0;
        for (var i = 0u; i < all; i++) {
            let bin = bins[i];
            let density = noise_density(tile, bin.w, params.coding.y);
            let gain = shutter_gain(tile.speed, bin.z, leaks_of(tile, bin), params.exposure);
            seen += bin.x * vec3f(bin.y, density, 0.0);
            if n > 0u && max(first / gain, gain / first) < 1.3 {
                let last = bins[n - 1u];
                let sum = last.x + bin.x;
                bins[n - 1u] = vec4f(sum, (last.x * last.yzw + bin.x * bin.yzw) / sum);
                gains[n - 1u] = (last.x * gains[n - 1u] + bin.x * gain) / sum;
                densities[n - 1u] = (last.x * densities[n - 1u] + bin.x * density) / sum;
            } else {
                first = gain;
                bins[n] = bin;
                gains[n] = gain;
                densities[n] = density;
                n++;
            }
        }
        counts[thread] = n;
        lane_sums[thread] = seen;
    }
    workgroupBarrier();
    if thread == 0u {
        var seen = vec3f(0.0);
        for (var i = 0u; i < COLUMNS; i++) {
            seen += lane_sums[i];
        }
        has_contrast = u32(seen.x > MIN_CONTRAST * seen.y);
        observations[observation] = f32(has_contrast);
        observations[observation + 1u] = f32(tile.block);
        observations[observation + 2u] = tile.inverse_depth;
    }
    if workgroupUniformLoad(&has_contrast) == 0u {
        return;
    }
    var start = 0u;
    var count = 0u;
    for (var i = 0u; i < COLUMNS; i++) {
        start += select(0u, counts[i], i < thread);
        count += counts[i];
    }
    for (var i = 0u; i < n; i++) {
        weight[start + i] = bins[i].x;
        power[start + i] = bins[i].y;
        modulus[start + i] = bins[i].w;
        noise[start + i] = densities[i];
        shutter[start + i] = gains[i];
    }
    workgroupBarrier();
    for (var i = thread; i < ALPHAS * count; i += ALPHAS * LANES) {
        let alpha = i / count;
        let bin = i % count;
        let pixel = 2.0 * PI * PIXEL_RESPONSE / tile.scale * modulus[bin];
        let x = 2.0 * PI * params.sharpening.y * modulus[bin] / tile.scale;
        let sharpened = 1.0 + params.sharpening.x * (1.0 - exp(-0.5 * x * x));
        let scene = pow(modulus[bin] / 0.2, -(ALPHA + ALPHA_STD * deviation(alpha))) * exp(-pixel * pixel);
        scenes[alpha * BINS + bin] = shutter[bin] * scene * sharpened * sharpened;
    }
    workgroupBarrier();

    let noise_prior = noise_precision(tile, LENS_NOISE_ERROR, params.coding.y);
    let alpha = thread / LANES;
    let lane = thread % LANES;
    let terms = TILE_SIGMAS;
    var log_amplitude = 0.0;
    var log_noise = 0.0;
    for (var s = 0u; s < TILE_SIGMAS; s++) {
        if s == 0u {
            var own = vec3f(0.0);
            for (var i = lane; i < count; i += LANES) {
                own += weight[i] * vec3f(power[i], scenes[alpha * BINS + i] * lens_gain(s, modulus[i]), 0.0);
            }
            let total = lanes_total(thread, own);
            log_amplitude = log(max(total.x / total.y, 1e-12));
        }
        // Few rounds suffice where the scoring starts near its solution, that is, except for the first std.
        let rounds = select(2u, 10u, s == 0u);
        var log_likelihood = 0.0;
        for (var round = 0u; round < rounds; round++) {
            let a = exp(log_amplitude);
            let factor = exp(log_noise);
            var own_scores = vec3f(0.0);
            var own_information = vec3f(0.0);
            for (var i = lane; i < count; i += LANES) {
                let signal = a * scenes[alpha * BINS + i] * lens_gain(s, modulus[i]);
                let variance = signal + factor * noise[i];
                let share = signal / variance;
                let ratio = power[i] / variance;
                let excess = ratio - 1.0;
                own_scores += weight[i] * vec3f(share * excess, (1.0 - share) * excess, -log(variance) - ratio);
                own_information += weight[i] * vec3f(share * share, (1.0 - share) * (1.0 - share), share * (1.0 - share));
            }
            let scores = lanes_total(thread, own_scores) - vec3f(0.0, noise_prior * log_noise, 0.0);
            let information = lanes_total(thread, own_information) + vec3f(1e-6, noise_prior, 0.0);
            let left = information.y - information.z * information.z / information.x;
            let change_noise = clamp((scores.y - information.z * scores.x / information.x) / left, -0.7, 0.7);
            let change = clamp((scores.x - information.z * change_noise) / information.x, -1.5, 1.5);
            // This is the log-likelihood after the step, if it is quadratic.
            log_likelihood = scores.z - 0.5 * noise_prior * log_noise * log_noise
                + 0.5 * (scores.x * change + scores.y * change_noise);
            log_amplitude = max(log_amplitude + change, -27.0);
            log_noise += change_noise;
        }
        if lane == 0u {
            let prior = 0.5 * deviation(alpha) * deviation(alpha);
            values[terms + s * ALPHAS + alpha] = log_likelihood * TEMPER - prior;
        }
    }
    workgroupBarrier();
    for (var s = thread; s < TILE_SIGMAS; s += ALPHAS * LANES) {
        let first = terms + s * ALPHAS;
        var highest = values[first];
        for (var k = 1u; k < ALPHAS; k++) {
            highest = max(highest, values[first + k]);
        }
        var sum = 0.0;
        for (var k = 0u; k < ALPHAS; k++) {
            sum += exp(values[first + k] - highest);
        }
        values[s] = highest + log(sum);
    }
    workgroupBarrier();
    var highest = -1e30;
    for (var s = 0u; s < SIGMAS; s++) {
        highest = max(highest, of_frame(s, tile.scale));
    }
    for (var s = thread; s < SIGMAS; s += ALPHAS * LANES) {
        observations[observation + HEAD + s] = of_frame(s, tile.scale) - highest;
    }
}
