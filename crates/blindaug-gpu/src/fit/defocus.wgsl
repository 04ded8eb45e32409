// The paper's search: at every 4th pixel each way it finds the std whose blur of the sharp image is closest to the target, by the error
// summed over 9 x 9 px.

@group(0) @binding(0) var<uniform> step: Step;

fn tap(j: u32) -> f32 {
    return step.half_kernel[j].x;
}

fn inside(p: vec2i) -> vec2i {
    return clamp(p, vec2i(0), vec2i(step.size) - 1);
}

@group(0) @binding(1) var before: texture_2d_array<f32>;
@group(0) @binding(2) var level: texture_storage_2d_array<r32float, write>;

const SIDE = 16u;
const PADDED = SIDE + 2u * MAX_RADIUS;
var<workgroup> window: array<f32, PADDED * PADDED>;
var<workgroup> rows: array<f32, SIDE * PADDED>;

@compute @workgroup_size(16, 16)
fn blur(
    @builtin(workgroup_id) group: vec3u,
    @builtin(global_invocation_id) pixel: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(local_invocation_index) thread: u32,
) {
    let side = SIDE + 2u * step.radius;
    let corner = vec2i(SIDE * group.xy) - i32(step.radius);
    for (var i = thread; i < side * side; i += SIDE * SIDE) {
        let p = inside(corner + vec2i(vec2u(i % side, i / side)));
        window[i] = textureLoad(before, p, 0, 0).x;
    }
    workgroupBarrier();
    for (var i = thread; i < SIDE * side; i += SIDE * SIDE) {
        let at = i / SIDE * side + i % SIDE + step.radius;
        var sum = tap(0u) * window[at];
        for (var j = 1u; j <= step.radius; j++) {
            sum += tap(j) * (window[at - j] + window[at + j]);
        }
        rows[i] = sum;
    }
    workgroupBarrier();
    let at = (local.y + step.radius) * SIDE + local.x;
    var sum = tap(0u) * rows[at];
    for (var j = 1u; j <= step.radius; j++) {
        sum += tap(j) * (rows[at - j * SIDE] + rows[at + j * SIDE]);
    }
    if all(pixel.xy < step.size) {
        textureStore(level, pixel.xy, 0, vec4f(sum));
    }
}

@group(0) @binding(1) var target_image: texture_2d_array<f32>;
@group(0) @binding(2) var blurred: texture_2d_array<f32>;
@group(0) @binding(3) var inverse_depth: texture_2d_array<f32>;
// For each place: inverse depth, the best std (px), the least and the greatest error of all stds.
@group(0) @binding(4) var<storage, read_write> searched: array<vec4f>;

// The number of places that a workgroup looks at, each way.
const POINTS = 8u;
const SPAN = STRIDE * (POINTS - 1u) + 2u * REACH + 1u;
var<workgroup> errors: array<f32, SPAN * SPAN>;
var<workgroup> columns: array<f32, POINTS * SPAN>;

@compute @workgroup_size(8, 8)
fn compare(
    @builtin(workgroup_id) group: vec3u,
    @builtin(global_invocation_id) point: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(local_invocation_index) thread: u32,
) {
    let corner = vec2i(STRIDE * POINTS * group.xy) - i32(REACH);
    for (var i = thread; i < SPAN * SPAN; i += POINTS * POINTS) {
        let p = corner + vec2i(vec2u(i % SPAN, i / SPAN));
        var error = 0.0;
        if all(p == inside(p)) {
            let difference = textureLoad(target_image, p, 0, 0).x - textureLoad(blurred, p, 0, 0).x;
            error = difference * difference;
        }
        errors[i] = error;
    }
    workgroupBarrier();
    for (var i = thread; i < POINTS * SPAN; i += POINTS * POINTS) {
        let at = i / SPAN * STRIDE * SPAN + i % SPAN;
        var sum = 0.0;
        for (var j = 0u; j <= 2u * REACH; j++) {
            sum += errors[at + j * SPAN];
        }
        columns[i] = sum;
    }
    workgroupBarrier();
    let points = step.size / STRIDE;
    if any(point.xy >= points) {
        return;
    }
    var sum = 0.0;
    for (var j = 0u; j <= 2u * REACH; j++) {
        sum += columns[local.y * SPAN + local.x * STRIDE + j];
    }
    let at = point.y * points.x + point.x;
    if step.sigma == 0.0 {
        let depth = textureLoad(inverse_depth, STRIDE * point.xy, 0, 0).x;
        searched[at] = vec4f(depth, 0.0, sum, sum);
        return;
    }
    var found = searched[at];
    if sum < found.z {
        found.y = step.sigma;
        found.z = sum;
    }
    found.w = max(found.w, sum);
    searched[at] = found;
}
