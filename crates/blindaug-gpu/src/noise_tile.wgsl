// Makes the tile of noise that noise.wgsl reads, from the generator of the reference: white normal noise becomes a Laplacian pyramid on a
// torus, and each level is divided by its own local std and enlarged.

@group(0) @binding(0) var<uniform> level: TileLevel;
@group(0) @binding(1) var<storage, read_write> made: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> second: array<vec4<f32>>;

fn wrapped(at: vec2<i32>, side: i32) -> u32 {
    let p = (at + 16 * side) % side;
    return u32(p.y * side + p.x);
}

fn of_source(at: vec2<i32>) -> vec4<f32> {
    return source[wrapped(at, i32(level.side))];
}

@compute @workgroup_size(8, 8)
fn white(@builtin(global_invocation_id) id: vec3<u32>) {
    let key = pcg4d(vec4(level.seed, level.seed_high, 0u, 0u));
    let bits = pcg4d(vec4(id.xy ^ key.xy, key.zw));
    // The upper 24 bits are taken at the middle of their interval, so that they never give 0. Pairs of uniform numbers become normal ones
    // (Box & Muller 1958).
    let uniform_number = (vec4<f32>(bits >> vec4(8u)) + 0.5) / 16777216.0;
    let radius = sqrt(-2.0 * log(uniform_number.xz));
    let angle = 6.283185307 * uniform_number.yw;
    made[id.y * level.side + id.x] =
        vec4(radius.x * cos(angle.x), radius.x * sin(angle.x), radius.y * cos(angle.y), 0.0);
}

// Halves the side of the source by the binomial kernel.
@compute @workgroup_size(8, 8)
fn down(@builtin(global_invocation_id) id: vec3<u32>) {
    var weights = array<f32, 3>(0.375, 0.25, 0.0625);
    var sum = vec4(0.0);
    for (var j = -2; j <= 2; j++) {
        for (var i = -2; i <= 2; i++) {
            sum += weights[abs(i)] * weights[abs(j)] * of_source(2 * vec2<i32>(id.xy) + vec2(i, j));
        }
    }
    made[id.y * (level.side / 2u) + id.x] = sum;
}

// Pixel `id` of the source at twice its side. Even pixels take (1 6 1) / 8 of the source, odd ones (1 1) / 2.
fn doubled(id: vec2<u32>) -> vec4<f32> {
    let at = vec2<i32>(id / 2u);
    var sum = vec4(0.0);
    for (var j = -1; j <= 1; j++) {
        for (var i = -1; i <= 1; i++) {
            let offset = vec2(i, j);
            let even = select(vec2(0.125), vec2(0.75), offset == vec2(0));
            let odd = select(vec2(0.5), vec2(0.0), offset < vec2(0));
            let weight = select(even, odd, (id & vec2(1u)) == vec2(1u));
            sum += weight.x * weight.y * of_source(at + offset);
        }
    }
    return sum;
}

@compute @workgroup_size(8, 8)
fn up(@builtin(global_invocation_id) id: vec3<u32>) {
    made[id.y * (2u * level.side) + id.x] = doubled(id.xy);
}

// Makes a band of the pyramid: `second`, which has twice the source's side, less the enlarged source.
@compute @workgroup_size(8, 8)
fn band(@builtin(global_invocation_id) id: vec3<u32>) {
    let at = id.y * (2u * level.side) + id.x;
    made[at] = second[at] - doubled(id.xy);
}

// Divides the source by its own std in a window of 9 x 9 pixels, weighted by a Gaussian of std 4 px.
@compute @workgroup_size(8, 8)
fn unit(@builtin(global_invocation_id) id: vec3<u32>) {
    var mean = vec4(0.0);
    var square = vec4(0.0);
    var total = 0.0;
    for (var j = -4; j <= 4; j++) {
        for (var i = -4; i <= 4; i++) {
            let weight = exp(-f32(i * i + j * j) / 32.0);
            let v = of_source(vec2<i32>(id.xy) + vec2(i, j));
            mean += weight * v;
            square += weight * v * v;
            total += weight;
        }
    }
    mean /= total;
    let sigma = sqrt(max(square / total - mean * mean, vec4(0.0)));
    made[id.y * level.side + id.x] = of_source(vec2<i32>(id.xy)) * level.gain / max(sigma, vec4(level.floor));
}

@group(0) @binding(1) var packed: texture_storage_2d_array<rgba16float, write>;
@group(0) @binding(4) var<storage, read> third: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> coarsest: array<vec4<f32>>;

// Packs the four levels into the three layers of the tile.
@compute @workgroup_size(8, 8)
fn pack(@builtin(global_invocation_id) id: vec3<u32>) {
    let at = id.y * level.side + id.x;
    let last = coarsest[at];
    textureStore(packed, id.xy, 0, vec4(source[at].rgb, last.r));
    textureStore(packed, id.xy, 1, vec4(second[at].rgb, last.g));
    textureStore(packed, id.xy, 2, vec4(third[at].rgb, last.b));
}
