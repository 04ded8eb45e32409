// The camera's unsharp mask and its inverse, in the listed blocks: each is a Gaussian blur in two passes, rows and columns, and a sum. What
// they make is zero in blocks that are not listed. CPU twin: crates/blindaug/src/synth/sharpening.rs.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> mask: MaskPass;
// The right half of the Gaussian, centre first: `mask.radius` + 1 numbers.
@group(0) @binding(2) var<storage, read> half_kernel: array<f32>;
@group(0) @binding(3) var source: texture_2d_array<f32>;
@group(0) @binding(4) var written: texture_storage_2d_array<rgba16float, write>;
// The number of blocks, and the blocks.
@group(0) @binding(5) var<storage, read> list: array<u32>;

// The source at a pixel. The outermost pixels are repeated beyond the frame's edges.
fn source_at(at: vec2<i32>, eye: u32) -> vec3<f32> {
    return textureLoad(source, clamp(at, vec2(0), vec2<i32>(camera.frame) - 1), eye, 0).rgb;
}

// Blurs the source along rows.
@compute @workgroup_size(16, 16)
fn rows(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let entry = group.y * LIST_ROW + group.x;
    if entry >= list[0] {
        return;
    }
    let id = listed_pixel(camera, list[entry + 1u], thread);
    if any(id.xy >= camera.frame) {
        return;
    }
    let at = vec2<i32>(id.xy);
    var sum = half_kernel[0] * source_at(at, id.z);
    for (var i = 1; i <= i32(mask.radius); i++) {
        sum += half_kernel[i] * (source_at(at - vec2(i, 0), id.z) + source_at(at + vec2(i, 0), id.z));
    }
    textureStore(written, id.xy, id.z, vec4(sum, 0.0));
}

// The source, blurred along rows already.
@group(0) @binding(6) var blurred_rows: texture_2d_array<f32>;
// The result of the iteration's first step.
@group(0) @binding(7) var first: texture_2d_array<f32>;

fn row_at(at: vec2<i32>, eye: u32) -> vec3<f32> {
    return textureLoad(blurred_rows, clamp(at, vec2(0), vec2<i32>(camera.frame) - 1), eye, 0).rgb;
}

// Makes a step of the iteration: a weighted sum of the source, of the blurred source and of the first step's result.
@compute @workgroup_size(16, 16)
fn columns(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let entry = group.y * LIST_ROW + group.x;
    if entry >= list[0] {
        return;
    }
    let listed = list[entry + 1u];
    let id = listed_pixel(camera, listed, thread);
    if (listed & (LISTED_TO_SHARPEN | LISTED_TO_CLEAR)) == 0u || any(id.xy >= camera.frame) {
        return;
    }
    if (listed & LISTED_TO_CLEAR) != 0u {
        textureStore(written, id.xy, id.z, vec4(0.0));
        return;
    }
    let at = vec2<i32>(id.xy);
    var blurred = half_kernel[0] * row_at(at, id.z);
    for (var i = 1; i <= i32(mask.radius); i++) {
        blurred += half_kernel[i] * (row_at(at - vec2(0, i), id.z) + row_at(at + vec2(0, i), id.z));
    }
    let next = mask.of_source * source_at(at, id.z) + mask.of_blurred * blurred;
    // In the first step, the weight `of_first` is 0.
    let begun = mask.of_first * textureLoad(first, at, id.z, 0).rgb;
    textureStore(written, id.xy, id.z, vec4(next + begun, 0.0));
}
