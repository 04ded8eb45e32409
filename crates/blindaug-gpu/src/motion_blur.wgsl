// Motion blur: the mean over the path that a pixel travels while the shutter is open (Potmesil & Chakravarty 1983). The path is centred on
// `at`.

// Interleaved gradient noise (Jimenez 2014), 0 to 1. Neighbouring pixels differ as much as they can.
fn gradient_noise(at: vec2<f32>) -> f32 {
    return fract(52.9829189 * fract(dot(at, vec2(0.06711056, 0.00583715))));
}

// Takes the mean along a path by the midpoint rule with ceil(length / step) + 1 taps. The taps of a path that needs more than `most` are
// jittered, so that they leave noise rather than steps.
fn motion_blurred(
    image: texture_2d_array<f32>,
    bilinear: sampler,
    at: vec2<f32>,
    path: vec2<f32>,
    eye: u32,
    step: f32,
    most: f32,
    jitter: vec2<f32>,
) -> vec4<f32> {
    let wanted = ceil(length(path) / step) + 1.0;
    let taps = min(wanted, most);
    var phase = 0.5;
    if wanted > most {
        phase = gradient_noise(at + jitter);
    }
    let all = textureDimensions(image);
    var sum = vec4(0.0);
    for (var i = 0.0; i < taps; i += 1.0) {
        let t = (i + phase) / taps - 0.5;
        sum += textureSampleLevel(image, bilinear, coordinates(at + t * path, all, all), eye, 0.0);
    }
    return sum / taps;
}
