// Functions of numbers and colours that several shaders use.

// Tests the bits, since a shader's arithmetic may assume that there is no NaN.
fn is_finite(v: f32) -> bool {
    return (bitcast<u32>(v) & 0x7f800000u) != 0x7f800000u;
}

// The sRGB curve (IEC 61966-2-1) from light to encoded values. It goes on past 1, and below 0 as its mirror image.
fn encode(v: vec3<f32>) -> vec3<f32> {
    let x = abs(v);
    let y = select(1.055 * pow(x, vec3(1.0 / 2.4)) - 0.055, 12.92 * x, x <= vec3(0.0031308));
    return sign(v) * y;
}

fn decode(v: vec3<f32>) -> vec3<f32> {
    let y = abs(v);
    let x = select(pow((y + 0.055) / 1.055, vec3(2.4)), y / 12.92, y <= vec3(0.04045));
    return sign(v) * x;
}

// The slope d encoded / d linear of the sRGB curve at a linear value.
fn encoding_slope(v: vec3<f32>) -> vec3<f32> {
    let x = abs(v);
    return select(1.055 / 2.4 * pow(x, vec3(1.0 / 2.4 - 1.0)), vec3(12.92), x <= vec3(0.0031308));
}

// Luma, Y of YCbCr (Rec. 601), of encoded values, or of light with the same weights.
fn luma(v: vec3<f32>) -> f32 {
    return dot(v, LUMA);
}
