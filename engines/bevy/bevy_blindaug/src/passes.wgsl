// The passes before and after blindaug's compositor. Each covers the whole picture.

struct Numbers {
    // The inverse depth in 1/m is the first number times the depth buffer's value, plus the second; both are 0 where that does not hold.
    depth_map: vec2f,
    // Motion to the next filmed frame, px, of a unit of the motion vectors.
    motion_scale: vec2f,
    // The part of the frame that is shown: its size and its top left corner, in shares of the frame's size.
    shown_size: vec2f,
    shown_origin: vec2f,
    // 1 if there is a line at the right edge of what is pasted on, 0 if not.
    line: f32,
    // The position of that edge, px.
    edge: f32,
}

@group(0) @binding(0) var<uniform> numbers: Numbers;

struct Vertex {
    @builtin(position) position: vec4f,
    @location(0) uv: vec2f,
}

// Makes one triangle that covers everything.
@vertex
fn whole(@builtin(vertex_index) i: u32) -> Vertex {
    let uv = vec2f(2.0 * f32(i & 1u), 2.0 * f32(i >> 1u));
    return Vertex(vec4f(2.0 * uv.x - 1.0, 1.0 - 2.0 * uv.y, 0.0, 1.0), uv);
}

@group(0) @binding(1) var background: texture_2d<f32>;
@group(0) @binding(2) var bilinear: sampler;

// The part of the frame that is shown, which is written twice.
struct Shown {
    // For the compositor; the hardware encodes it.
    @location(0) frame: vec4f,
    // The view's light where nothing virtual is seen.
    @location(1) light: vec4f,
}

// Copies the part of the frame that is shown. The hardware decodes what is read.
@fragment
fn frame(in: Vertex) -> Shown {
    let at = numbers.shown_origin + in.uv * numbers.shown_size;
    let light = vec4f(textureSampleLevel(background, bilinear, at, 0.0).rgb, 1.0);
    return Shown(light, light);
}

struct Layer {
    // The colour, premultiplied and scene-linear, and alpha.
    @location(0) color: vec4f,
    // The inverse depth, 1/m; NOTHING where nothing is.
    @location(1) inverse_depth: f32,
    // The motion to the next filmed frame, px, x right, y down.
    @location(2) motion: vec2f,
}

@group(0) @binding(1) var color: texture_2d<f32>;
@group(0) @binding(2) var depth: texture_depth_2d;
@group(0) @binding(3) var motion: texture_2d<f32>;

// The inverse depth where nothing is, as render.rs tells the compositor.
const NOTHING = -1.0;

// Tests the bits, since a shader's arithmetic may assume that there is no NaN.
fn is_finite(v: f32) -> bool {
    return (bitcast<u32>(v) & 0x7f800000u) != 0x7f800000u;
}

fn layer_of(at: vec2u, depth_value: f32, motion_value: vec2f) -> Layer {
    // Where nothing wrote depth, such as below transparent things, depth and motion are unknown, which is infinity for the compositor.
    let unknown = bitcast<f32>(0x7f800000u | u32(numbers.line) * 0u);
    let known = depth_value > 0.0 && any(numbers.depth_map != vec2f(0.0));
    var out: Layer;
    out.color = textureLoad(color, at, 0);
    out.color.a = clamp(out.color.a, 0.0, 1.0);
    // Broken light counts as nothing.
    if !(is_finite(out.color.r) && is_finite(out.color.g) && is_finite(out.color.b) && is_finite(out.color.a)) {
        out.color = vec4f(0.0);
    }
    out.inverse_depth = select(unknown, numbers.depth_map.x * depth_value + numbers.depth_map.y, known);
    if all(out.color == vec4f(0.0)) {
        out.inverse_depth = NOTHING;
    }
    out.motion = select(vec2f(unknown), numbers.motion_scale * motion_value, depth_value > 0.0);
    return out;
}

// Gathers what the compositor reads of a view.
@fragment
fn gather(in: Vertex) -> Layer {
    let at = vec2u(in.position.xy);
    return layer_of(at, textureLoad(depth, at, 0), textureLoad(motion, at, 0).xy);
}

@group(0) @binding(2) var depths: texture_depth_multisampled_2d;
@group(0) @binding(3) var motions: texture_multisampled_2d<f32>;

// The same of a view with several samples in each pixel: colour is their mean already, depth and motion are those of the nearest.
@fragment
fn gather_samples(in: Vertex) -> Layer {
    let at = vec2u(in.position.xy);
    var nearest = 0.0;
    var motion_value = vec2f(0.0);
    for (var i = 0u; i < textureNumSamples(depths); i++) {
        let value = textureLoad(depths, at, i);
        if value > nearest {
            nearest = value;
            motion_value = textureLoad(motions, at, i).xy;
        }
    }
    return layer_of(at, nearest, motion_value);
}

@group(0) @binding(2) var filmed: texture_2d<f32>;

// Pastes the layer on the frame as it is, in light.
@fragment
fn paste(in: Vertex) -> @location(0) vec4f {
    if numbers.line > 0.0 && abs(in.position.x - numbers.edge) < 1.0 {
        return vec4f(1.0);
    }
    let at = vec2u(in.position.xy);
    let over = textureLoad(color, at, 0);
    let light = textureLoad(filmed, at, 0).rgb * (1.0 - over.a) + over.rgb;
    return vec4f(clamp(light, vec3f(0.0), vec3f(1.0)), 1.0);
}
