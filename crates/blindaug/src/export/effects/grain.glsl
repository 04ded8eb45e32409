#[compute]
#version 450

// The noise of a camera, for blindaug_grain.gd. Written by blindaug export.

layout(local_size_x = 8, local_size_y = 8, local_size_z = 1) in;

layout(rgba16f, set = 0, binding = 0) uniform image2D color_image;
// The noise's four octaves, finest first, in R, G, B, A: 0.5 + gain n.
layout(rgba8, set = 0, binding = 1) readonly uniform image2D bands_image;

// Std of each octave over encoded luminance, for R, G and B: slope Y + intercept.
layout(std140, set = 0, binding = 2) uniform Model {
	vec4 slope[3];
	vec4 intercept[3];
	// The level from which on the sensor clips.
	vec4 clip;
} model;

layout(push_constant, std430) uniform Params {
	// Where this frame reads the tile.
	ivec2 offset;
	ivec2 size;
} params;

vec3 encoded(vec3 v) {
	return mix(12.92 * v, 1.055 * pow(max(v, vec3(0.0)), vec3(1.0 / 2.4)) - 0.055, vec3(greaterThan(v, vec3(0.0031308))));
}

vec3 linear(vec3 v) {
	return mix(v / 12.92, pow((max(v, vec3(0.0)) + 0.055) / 1.055, vec3(2.4)), vec3(greaterThan(v, vec3(0.04045))));
}

void main() {
	ivec2 at = ivec2(gl_GlobalInvocationID.xy);
	if (at.x >= params.size.x || at.y >= params.size.y) {
		return;
	}
	// The channels read different parts of the tile, so that their noise is independent.
	ivec2 offsets[3] = ivec2[3](@offsets@);
	vec4 scene = imageLoad(color_image, at);
	// Noise lives in encoded values; light above 1 is left to the tonemapper.
	vec3 value = encoded(clamp(scene.rgb, vec3(0.0), vec3(1.0)));
	float luminance = dot(value, vec3(0.299, 0.587, 0.114));
	vec3 noise = vec3(0.0);
	for (int c = 0; c < 3; c++) {
		ivec2 texel = (at + params.offset + offsets[c]) & ivec2(@mask@);
		vec4 bands = imageLoad(bands_image, texel);
		vec4 sigma = max(model.slope[c] * luminance + model.intercept[c], vec4(0.0));
		noise[c] = dot(sigma, (bands - vec4(0.5)) / @gain@);
	}
	vec3 noisy = linear(clamp(value + noise, vec3(0.0), vec3(model.clip.x)));
	// None where the sensor clips; half an 8-bit step for the half floats of the picture.
	vec3 kept = vec3(greaterThanEqual(value, vec3(model.clip.x - 0.002)));
	imageStore(color_image, at, vec4(mix(noisy, scene.rgb, kept), scene.a));
}
