// The tile of noise that noise.wgsl reads, from the generator of the reference: white normal noise, its Laplacian pyramid on a
// torus, each level over its own local std, enlarged.

struct Level {
    // Pixels along a side of the source.
    side: u32,
    // The least local std, so that windows with next to nothing in them are not blown up.
    floor: f32,
    // A normal number over its own window's std has a std slightly below 1: what makes it 1.
    gain: f32,
    seed: u32,
    seed_high: u32,
}

@group(0) @binding(0) var<uniform> level: Level;
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
    // 24 bits, at the middle of their interval: never 0. Pairs of uniform numbers to normal ones (Box & Muller 1958).
    let uniform_number = (vec4<f32>(bits >> vec4(8u)) + 0.5) / 16777216.0;
    let radius = sqrt(-2.0 * log(uniform_number.xz));
    let angle = 6.283185307 * uniform_number.yw;
    made[id.y * level.side + id.x] =
        vec4(radius.x * cos(angle.x), radius.x * sin(angle.x), radius.y * cos(angle.y), 0.0);
}

// Half the side, by the binomial kernel.
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

// Pixel `id` of the source at twice its side: even pixels see (1 6 1) / 8 of it, odd ones (1 1) / 2.
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

// What `second`, of twice the source's side, has beyond it.
@compute @workgroup_size(8, 8)
fn band(@builtin(global_invocation_id) id: vec3<u32>) {
    let at = id.y * (2u * level.side) + id.x;
    made[at] = second[at] - doubled(id.xy);
}

// The source over its own std in a window of 9 x 9 pixels, a Gaussian of std 4.
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

// The four levels as the three layers of the tile.
@compute @workgroup_size(8, 8)
fn pack(@builtin(global_invocation_id) id: vec3<u32>) {
    let at = id.y * level.side + id.x;
    let last = coarsest[at];
    textureStore(packed, id.xy, 0, vec4(source[at].rgb, last.r));
    textureStore(packed, id.xy, 1, vec4(second[at].rgb, last.g));
    textureStore(packed, id.xy, 2, vec4(third[at].rgb, last.b));
}
