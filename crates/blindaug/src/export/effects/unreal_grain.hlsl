// Std of each octave over encoded luminance, for R, G and B: slope Y + intercept.
const float4 Slope[3] = { @slope@ };
const float4 Intercept[3] = { @intercept@ };
// The channels read different parts of the octaves, so that their noise is independent.
const int2 Offsets[3] = { @offsets@ };
const float Clip = @clip@;
const int Mask = @mask@;
const float Gain = @gain@;

// A different part of the octaves for each frame (pcg2d, Jarzynski & Olano 2020).
uint2 v = uint2(View.StateFrameIndex, 0u) * 1664525u + 1013904223u;
v.x += v.y * 1664525u;
v.y += v.x * 1664525u;
v = v ^ (v >> 16u);
v.x += v.y * 1664525u;
v.y += v.x * 1664525u;
v = v ^ (v >> 16u);
int2 position = int2(Parameters.SvPosition.xy) + int2(v & uint(Mask));

// After tonemapping the picture is display-encoded, as the noise is.
float3 value = saturate(Scene.rgb);
float luminance = dot(value, float3(0.299, 0.587, 0.114));
float3 noisy;
[unroll]
for (int c = 0; c < 3; c++)
{
    float4 bands = Bands.Load(int3((position + Offsets[c]) & Mask, 0));
    float4 sigma = max(Slope[c] * luminance + Intercept[c], 0.0);
    // There is none where the sensor clips.
    noisy[c] = value[c] >= Clip ? value[c] : clamp(value[c] + dot(sigma, (bands - 0.5) / Gain), 0.0, Clip);
}
return noisy;
