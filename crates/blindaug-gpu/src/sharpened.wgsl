// The last passes for a camera that sharpens. The layer goes over the frame as it was before the camera sharpened it; the change is then
// sharpened and added to the frame. This file follows composite.wgsl in one source. CPU twin: composite in
// crates/blindaug/src/composite.rs.

@group(0) @binding(8) var difference_out: texture_storage_2d_array<rgba16float, write>;
// The difference that undoes the frame's sharpening when it is added; for the pass `difference`, and for the pass `sharpened`.
@group(0) @binding(9) var unsharpening_before: texture_2d_array<f32>;
@group(0) @binding(7) var unsharpening_after: texture_2d_array<f32>;

// The number of blocks in which the difference is computed, and the blocks.
@group(0) @binding(14) var<storage, read> list: array<u32>;

// The frame at a pixel as it was before the camera sharpened it.
fn unsharpened(unsharpening: texture_2d_array<f32>, at: vec2<u32>, eye: u32) -> vec3<f32> {
    return textureLoad(frame, at, eye, 0).rgb + textureLoad(unsharpening, at, eye, 0).rgb;
}

// Writes the change that the layer makes to the unsharpened frame, in encoded values, and the layer's alpha. The sensor clips before the
// camera sharpens.
@compute @workgroup_size(16, 16)
fn difference(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let entry = group.y * LIST_ROW + group.x;
    if entry >= list[0] {
        return;
    }
    let listed = list[entry + 1u];
    let id = listed_pixel(camera, listed, thread);
    if (listed & (LISTED_TO_SHARPEN | LISTED_TO_CLEAR)) == 0u || any(id.xy >= camera.frame) {
        return;
    }
    var layer = vec4(0.0);
    if all(id.xy - camera.origin < camera.size) {
        layer = layer_at(id.xy, id.z);
    }
    var out = vec4(0.0);
    if layer.a > 0.0 {
        let background = unsharpened(unsharpening_before, id.xy, id.z);
        let clean = clamp(over(background, layer), vec3(0.0), vec3(min(camera.clip, 1.0)));
        out = vec4(clean - background, layer.a);
    }
    textureStore(difference_out, id.xy, id.z, out);
}

// The result of `difference`, and that result blurred along rows.
@group(0) @binding(3) var differences: texture_2d_array<f32>;
@group(0) @binding(4) var blurred_rows: texture_2d_array<f32>;
@group(0) @binding(5) var<uniform> mask: MaskPass;
// The right half of the mask's Gaussian, centre first.
@group(0) @binding(6) var<storage, read> half_kernel: array<f32>;

fn row_at(at: vec2<i32>, eye: u32) -> vec3<f32> {
    return textureLoad(blurred_rows, clamp(at, vec2(0), vec2<i32>(camera.frame) - 1), eye, 0).rgb;
}

// `unsharpening_after` blurred by the kernel with which `smoothed` blurs the frame.
fn smoothed_unsharpening(at: vec2<f32>, eye: u32) -> vec3<f32> {
    let all = textureDimensions(unsharpening_after);
    var sum = vec3(0.0);
    for (var j = -1; j <= 1; j++) {
        for (var i = -1; i <= 1; i++) {
            let tap = smoothing_tap(i, j);
            let place = coordinates(at + tap.xy, camera.frame, all);
            sum += tap.z * textureSampleLevel(unsharpening_after, bilinear, place, eye, 0.0).rgb;
        }
    }
    return sum;
}

@fragment
fn sharpened(in: Vertex) -> @location(0) vec4<f32> {
    let pixel = vec2<u32>(in.position.xy);
    let filmed = textureLoad(frame, pixel, in.eye, 0).rgb;
    let own = textureLoad(differences, pixel, in.eye, 0);
    let place = vec2<i32>(pixel);
    var blurred = half_kernel[0] * row_at(place, in.eye);
    for (var i = 1; i <= i32(mask.radius); i++) {
        blurred += half_kernel[i] * (row_at(place - vec2(0, i), in.eye) + row_at(place + vec2(0, i), in.eye));
    }
    let added = own.rgb + mask.amount * (own.rgb - blurred);
    let clean = filmed + added;
    if own.a <= 0.0 {
        // Pixels without the layer get the halo of the sharpened object, or, beyond the halo, the frame itself, bit by bit.
        if all(added == vec3(0.0)) && camera.over_targets != 0u {
            discard;
        }
        return to_target(select(clamp(clean, vec3(0.0), vec3(1.0)), filmed, added == vec3(0.0)));
    }
    var noisy = clean;
    if camera.noise != 0u {
        let background = unsharpened(unsharpening_after, pixel, in.eye);
        let kept = 1.0 - own.a;
        var smooth_background = vec3(0.0);
        if kept > LEAST_KEPT {
            smooth_background = smoothed(vec2<f32>(pixel), in.eye) + smoothed_unsharpening(vec2<f32>(pixel), in.eye);
        }
        noisy += missing_noise(pixel, in.eye, background, smooth_background, background + own.rgb, kept);
    }
    let limit = vec3(min(camera.clip, 1.0));
    return to_target(select(clamp(noisy, vec3(0.0), limit), limit, clean >= limit));
}
