// The layer is brought to the space in which blur acts, and its depth and motion are continued past its silhouette (pull-push, Gortler et
// al. 1996).

@group(0) @binding(0) var<uniform> camera: Camera;

@group(0) @binding(1) var layer: texture_2d_array<f32>;
@group(0) @binding(2) var color: texture_storage_2d_array<rgba16float, write>;
// The largest alpha of each part, as the bits of its float, which are in the order of the floats.
@group(0) @binding(3) var<storage, read_write> most: array<atomic<u32>>;
@group(0) @binding(4) var layer_depth: texture_2d_array<f32>;

// The slab that a pixel belongs to. At silhouettes, the neighbouring pixel that the object covers most decides.
fn slab_of(at: vec2<u32>, eye: u32, own_alpha: f32) -> u32 {
    var alpha = own_alpha;
    var place = vec2<i32>(at);
    if alpha < OPAQUE {
        let last = vec2<i32>(textureDimensions(layer)) - 1;
        for (var j = -1; j <= 1; j++) {
            for (var i = -1; i <= 1; i++) {
                let beside = clamp(vec2<i32>(at) + vec2(i, j), vec2(0), last);
                let other = textureLoad(layer, beside, eye, 0).w;
                if other > alpha {
                    alpha = other;
                    place = beside;
                }
            }
        }
    }
    let d = camera.depth_map.x * textureLoad(layer_depth, place, eye, 0).x + camera.depth_map.y;
    if !is_finite(d) {
        return 1u;
    }
    return select(select(1u, 2u, d > camera.cuts.y), 0u, d < camera.cuts.x);
}

var<workgroup> most_here: atomic<u32>;

@compute @workgroup_size(16, 16)
fn prepare(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    if thread == 0u {
        atomicStore(&most_here, 0u);
    }
    workgroupBarrier();
    if all(id.xy < camera.size) {
        let at = camera.origin + id.xy;
        let eye = id.z / camera.slabs;
        var v = textureLoad(layer, at, eye, 0);
        // Pixels of broken values count as empty.
        if !(is_finite(v.x) && is_finite(v.y) && is_finite(v.z) && is_finite(v.w)) || v.w < 0.0 {
            v = vec4(0.0);
        }
        v.w = min(v.w, 1.0);
        if camera.slabs > 1u && v.w > 0.0 && slab_of(at, eye, v.w) != id.z % camera.slabs {
            v = vec4(0.0);
        }
        if camera.encoded_space != 0u && v.w > 0.0 {
            v = vec4(encode(v.rgb / v.w) * v.w, v.w);
        }
        // Half floats have this range.
        textureStore(color, id.xy, id.z, clamp(v, vec4(-65504.0), vec4(65504.0)));
        // The magnitude is taken, since the bits of -0 would be the largest.
        atomicMax(&most_here, bitcast<u32>(abs(v.w)));
    }
    workgroupBarrier();
    if thread == 0u {
        atomicMax(&most[id.z], atomicLoad(&most_here));
    }
}

@group(0) @binding(1) var prepared: texture_2d_array<f32>;
@group(0) @binding(2) var depth: texture_2d_array<f32>;
@group(0) @binding(3) var velocity: texture_2d_array<f32>;
@group(0) @binding(5) var known: texture_storage_2d_array<rgba16float, write>;
// The buffer `most`, bound for reading. The passes skip parts in which nothing is seen.
@group(0) @binding(4) var<storage, read> most_of: array<u32>;

// Writes (inverse depth, path) times their weight, and the weight. Where the object covers a pixel only in part, depth and motion may
// belong to what is behind it, so pixels that are covered fully have by far the most weight.
@compute @workgroup_size(16, 16)
fn spread(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= camera.size) || most_of[id.z] == 0u {
        return;
    }
    let alpha = textureLoad(prepared, id.xy, id.z, 0).w / max(bitcast<f32>(most_of[id.z]), 1e-6);
    if alpha <= 0.0 {
        textureStore(known, id.xy, id.z, vec4(0.0));
        return;
    }
    let at = camera.origin + id.xy;
    let eye = id.z / camera.slabs;
    let d = camera.depth_map.x * textureLoad(depth, at, eye, 0).x + camera.depth_map.y;
    let path = camera.path_scale * textureLoad(velocity, at, eye, 0).xy;
    let value = vec3(clamp(d, -60000.0, 60000.0), clamp(path, vec2(-60000.0), vec2(60000.0)));
    var weight = alpha * alpha;
    weight *= weight;
    weight *= weight;
    if !(is_finite(d) && is_finite(path.x) && is_finite(path.y)) || weight < 1e-6 {
        textureStore(known, id.xy, id.z, vec4(0.0));
    } else {
        textureStore(known, id.xy, id.z, vec4(value * weight, weight));
    }
}

// The number of times that the finer of the two images was halved.
@group(0) @binding(1) var<uniform> level: u32;
@group(0) @binding(2) var bilinear: sampler;
@group(0) @binding(3) var finer: texture_2d_array<f32>;
@group(0) @binding(5) var coarse: texture_storage_2d_array<rgba16float, write>;

// A pixel of the image at half its size, by the binomial kernel [1 4 6 4 1] / 16, two taps at a time.
fn halved(id: vec3<u32>) -> vec4<f32> {
    let used = size_at(camera, level);
    let all = textureDimensions(finer);
    var sum = vec4(0.0);
    for (var j = -1; j <= 1; j++) {
        for (var i = -1; i <= 1; i++) {
            let at = vec2(f32(i), f32(j));
            let weight = (0.375 - 0.0625 * abs(at.x)) * (0.375 - 0.0625 * abs(at.y));
            let tap = coordinates(2.0 * vec2<f32>(id.xy) + 1.2 * at, used, all);
            sum += weight * textureSampleLevel(finer, bilinear, tap, id.z, 0.0);
        }
    }
    return sum;
}

@compute @workgroup_size(8, 8)
fn halve(@builtin(global_invocation_id) id: vec3<u32>) {
    if all(id.xy < size_at(camera, level + 1u)) && most_of[id.z] != 0u {
        textureStore(coarse, id.xy, id.z, halved(id));
    }
}

// Halves an image of weighted values. A coarse pixel has full weight if a quarter of the fine pixels under its kernel have it.
@compute @workgroup_size(8, 8)
fn pull(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= size_at(camera, level + 1u)) || most_of[id.z] == 0u {
        return;
    }
    let sum = halved(id);
    let confidence = select(0.0, min(4.0 * sum.w, 1.0), sum.w > 1e-6);
    textureStore(coarse, id.xy, id.z, vec4(sum.xyz / max(sum.w, 1e-6), 1.0) * confidence);
}

@group(0) @binding(3) var coarser: texture_2d_array<f32>;
@group(0) @binding(5) var own: texture_2d_array<f32>;
@group(0) @binding(6) var filled: texture_storage_2d_array<rgba16float, write>;

// The value of a level, where it is known, else that of the next coarser level. To double the coarser level, even pixels take (1 6 1) / 8
// of its pixels, odd ones (1 1) / 2.
fn pushed(id: vec3<u32>) -> vec3<f32> {
    let here = textureLoad(own, id.xy, id.z, 0);
    if here.w >= 1.0 {
        return here.xyz;
    }
    let used = size_at(camera, level + 1u);
    let all = textureDimensions(coarser);
    let odd = vec2<f32>(id.xy & vec2(1u));
    let at = vec2<f32>(id.xy >> vec2(1u)) + 0.5 * odd;
    let apart = 0.25 * (1.0 - odd);
    var sum = vec3(0.0);
    for (var j = -1; j <= 1; j += 2) {
        for (var i = -1; i <= 1; i += 2) {
            let tap = coordinates(at + apart * vec2(f32(i), f32(j)), used, all);
            sum += textureSampleLevel(coarser, bilinear, tap, id.z, 0.0).xyz;
        }
    }
    return 0.25 * sum * (1.0 - here.w) + here.xyz;
}

@compute @workgroup_size(8, 8)
fn push(@builtin(global_invocation_id) id: vec3<u32>) {
    if all(id.xy < size_at(camera, level)) && most_of[id.z] != 0u {
        textureStore(filled, id.xy, id.z, vec4(pushed(id), 1.0));
    }
}

// Fills the coarsest level, which has one pixel.
@compute @workgroup_size(1)
fn top(@builtin(global_invocation_id) id: vec3<u32>) {
    let here = textureLoad(own, id.xy, id.z, 0);
    textureStore(filled, id.xy, id.z, vec4(here.xyz / max(here.w, 1e-6), 1.0));
}

// Fills the finest level with the blur of each pixel: its path while the shutter is open, px, and its defocus std, px.
@compute @workgroup_size(16, 16)
fn blur(@builtin(global_invocation_id) id: vec3<u32>) {
    if all(id.xy < camera.size) && most_of[id.z] != 0u {
        let v = pushed(id);
        textureStore(filled, id.xy, id.z, vec4(v.yz, defocus_std(camera, v.x), 1.0));
    }
}
