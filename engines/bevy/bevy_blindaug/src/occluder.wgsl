// A thing of the real scene that hides virtual things: it has depth, and nothing to see.

@fragment
fn fragment() -> @location(0) vec4<f32> {
    return vec4(0.0);
}
