// Joins two composites: the naive one left of a line, the one with the camera's distortions right of it.

@group(0) @binding(0) var naive: texture_2d<f32>;
@group(0) @binding(1) var filmed: texture_2d<f32>;
// The place of the line as a share of the width, in the first number.
@group(0) @binding(2) var<uniform> split: vec4f;

// Half of the line's width, px.
const LINE = 1.0;

@vertex
fn whole(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    return vec4f(f32(i & 1u) * 4.0 - 1.0, f32(i & 2u) * 2.0 - 1.0, 0.0, 1.0);
}

@fragment
fn joined(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let right = position.x - split.x * f32(textureDimensions(naive).x);
    if split.x > 0.0 && split.x < 1.0 && abs(right) < LINE {
        return vec4f(1.0);
    }
    let at = vec2i(position.xy);
    if right < 0.0 {
        return vec4f(textureLoad(naive, at, 0).rgb, 1.0);
    }
    return vec4f(textureLoad(filmed, at, 0).rgb, 1.0);
}
