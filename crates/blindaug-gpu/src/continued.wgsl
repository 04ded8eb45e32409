// The inverse depth and the path of each pixel, continued past the object's silhouette (extension.wgsl).

// The share of the largest weight, 0 to 1, that the weights around a pixel of level CONTINUED have in the mean. `root` is the eighth root of
// that mean, and the largest weight is the eighth power of `most`, the largest alpha.
fn coverage(root: f32, most: f32) -> f32 {
    var weight = root / max(most, 1e-6);
    weight *= weight;
    weight *= weight;
    return weight * weight;
}

// How far the value of a pixel counts as known, 0 to 1. It is known if a quarter of the finer pixels under its kernel are.
fn confidence(coverage: f32) -> f32 {
    return select(0.0, min(4.0 * coverage, 1.0), coverage > 1e-6);
}

// The same for a pixel of level CONTINUED, which stands for two halvings.
fn of_continued(coverage: f32) -> f32 {
    return select(0.0, min(8.0 * coverage, 1.0), coverage > 1e-6);
}

// Whether the object covers a pixel, so that the pixel's own depth and motion are to be taken. `covered` has the bits that extension.wgsl
// writes. Where even the most opaque pixels nearby are faint beside the part's, depth and motion may be those of what is behind them.
fn is_covered(covered: texture_2d_array<f32>, at: vec2<u32>, part: u32, most: f32) -> bool {
    let bits = u32(textureLoad(covered, at >> vec2(CONTINUED), part, 0).x);
    let opaque = f32(bits >> 16u) > 0.95 * 255.0 * most - 1.0;
    return opaque && ((bits >> (4u * (at.y & 3u) + (at.x & 3u))) & 1u) != 0u;
}

// The continued inverse depth and path, px, at a pixel. `finest` is level CONTINUED, and `coarser` the next level, filled in.
fn continued(
    camera: Camera,
    finest: texture_2d_array<f32>,
    coarser: texture_2d_array<f32>,
    bilinear: sampler,
    at: vec2<u32>,
    part: u32,
    most: f32,
) -> vec3<f32> {
    let last = size_at(camera, CONTINUED) - 1u;
    let place = vec2<f32>(at) * exp2(-f32(CONTINUED));
    let next = fract(place);
    var sum = vec4(0.0);
    for (var j = 0u; j <= 1u; j++) {
        for (var i = 0u; i <= 1u; i++) {
            let here = textureLoad(finest, min(vec2<u32>(place) + vec2(i, j), last), part, 0);
            let share = select(1.0 - next.x, next.x, i == 1u) * select(1.0 - next.y, next.y, j == 1u);
            sum += share * of_continued(coverage(here.w, most)) * vec4(here.xyz, 1.0);
        }
    }
    let above = coordinates(0.5 * place, size_at(camera, CONTINUED + 1u), textureDimensions(coarser));
    return sum.xyz + (1.0 - sum.w) * textureSampleLevel(coarser, bilinear, above, part, 0.0).xyz;
}
