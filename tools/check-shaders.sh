#!/usr/bin/env bash
# Compiles the exported shaders: Unity's HLSL against stand-ins for its includes, and Godot's GLSL for Vulkan.
#
# Needs glslangValidator (glslang-tools); BLINDAUG is the binary to check, built here where it is not set. The stand-ins declare
# what Unity's headers do, so this finds errors of syntax and type, not names that a version of Unity no longer has.
# Run with glslang 12.0.0 (Debian 12).
set -euo pipefail
cd "$(dirname "$0")/.."

source tools/common.sh
need glslang-tools glslangValidator
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT

cat >"$dir/camera.json" <<'JSON'
{ "format": "blindaug-camera", "version": 1,
  "capture": { "width": 512, "height": 384, "fps": 30.0, "frames_used": 5 },
  "transfer": "srgb",
  "noise": { "levels": [
    { "slope": [0.012, 0.010, 0.018], "intercept": [0.010, 0.008, 0.014] },
    { "slope": [0.008, 0.007, 0.013], "intercept": [0.007, 0.006, 0.010] },
    { "slope": [0.004, 0.003, 0.006], "intercept": [0.003, 0.003, 0.005] },
    { "slope": [0.0, 0.0, 0.0], "intercept": [0.0, 0.0, 0.0] } ], "clip": 1.0, "method": "given", "samples": 0 },
  "motion_blur": { "exposure": 0.5, "interval": [0.5, 0.5], "method": "given", "samples": 0 },
  "defocus": { "model": "thin_lens", "sigma_px_at_infinity": 2.0, "focus_inverse_depth": 0.4, "depth_kind": "metric",
    "method": "given", "samples": 0 } }
JSON
export_to() {
    mkdir "$dir/$1"
    timeout 60 "$BLINDAUG" export "$dir/camera.json" --to "$1" -o "$dir/$1" 2>"$dir/log" || {
        cat "$dir/log" >&2
        return 1
    }
}
export_to unity-urp
export_to godot

# The stand-ins, in the folders that the shader names: each declares only what Unity's header declares, so that a missing include is found.
# From the array of both eyes' pictures, Unity reads the one that the setup macro chose.
core=$dir/Packages/com.unity.render-pipelines.core
universal=$dir/Packages/com.unity.render-pipelines.universal
mkdir -p "$core/ShaderLibrary" "$core/Runtime/Utilities" "$universal/ShaderLibrary"
cat >"$core/ShaderLibrary/Common.hlsl" <<'HLSL'
#ifndef COMMON
#define COMMON
#define TEXTURE2D(name) Texture2D name
#define SAMPLER(name) SamplerState name
#define SAMPLE_TEXTURE2D(name, sampler, at) name.Sample(sampler, at)
#define LOAD_TEXTURE2D(name, texel) name.Load(int3(texel, 0))
#endif
HLSL
cat >"$core/ShaderLibrary/Color.hlsl" <<'HLSL'
#ifndef COLOR
#define COLOR
float3 LinearToSRGB(float3 c) { return c <= 0.0031308 ? 12.92 * c : 1.055 * pow(abs(c), 1.0 / 2.4) - 0.055; }
float3 SRGBToLinear(float3 c) { return c <= 0.04045 ? c / 12.92 : pow(abs((c + 0.055) / 1.055), 2.4); }
#endif
HLSL
cat >"$universal/ShaderLibrary/Core.hlsl" <<'HLSL'
#ifndef CORE
#define CORE
#include "Packages/com.unity.render-pipelines.core/ShaderLibrary/Common.hlsl"
#ifdef STEREO
static uint eye;
#define TEXTURE2D_X(name) Texture2DArray name
#define SAMPLE_TEXTURE2D_X(name, sampler, at) name.Sample(sampler, float3(at, eye))
#else
#define TEXTURE2D_X(name) TEXTURE2D(name)
#define SAMPLE_TEXTURE2D_X(name, sampler, at) SAMPLE_TEXTURE2D(name, sampler, at)
#endif
float4 _Time;
#endif
HLSL
cat >"$core/Runtime/Utilities/Blit.hlsl" <<'HLSL'
#include "Packages/com.unity.render-pipelines.core/ShaderLibrary/Common.hlsl"
#include "Packages/com.unity.render-pipelines.core/ShaderLibrary/Color.hlsl"
#ifdef STEREO
#define UNITY_VERTEX_OUTPUT_STEREO uint eye : SV_RenderTargetArrayIndex;
#define UNITY_SETUP_STEREO_EYE_INDEX_POST_VERTEX(input) eye = input.eye
#else
#define UNITY_VERTEX_OUTPUT_STEREO
#define UNITY_SETUP_STEREO_EYE_INDEX_POST_VERTEX(input)
#endif
TEXTURE2D_X(_BlitTexture);
SamplerState sampler_PointClamp;
struct Attributes { uint vertexID : SV_VertexID; };
struct Varyings
{
    float4 positionCS : SV_POSITION;
    float2 texcoord : TEXCOORD0;
    UNITY_VERTEX_OUTPUT_STEREO
};
Varyings Vert(Attributes input)
{
    Varyings output = (Varyings)0;
    output.texcoord = float2((input.vertexID << 1) & 2, input.vertexID & 2);
    output.positionCS = float4(output.texcoord * 2.0 - 1.0, 0.0, 1.0);
    return output;
}
HLSL

hlsl=$dir/grain.hlsl
sed -n '/HLSLPROGRAM/,/ENDHLSL/{//!p}' "$dir/unity-urp/BlindaugGrain.shader" | sed 's/\r$//' >"$hlsl"
[[ -s $hlsl ]] || { echo "no HLSL in the shader"; exit 1; }
glsl=$dir/grain.comp
grep -v '^#\[compute\]' "$dir/godot/blindaug_grain.glsl" >"$glsl"

# compile_hlsl STAGE ENTRY_POINT FILE [OPTION...]
compile_hlsl() {
    timeout 60 glslangValidator -D -V -S "$1" -e "$2" -I"$dir" --auto-map-bindings -o "$dir/out.spv" "${@:4}" "$3" >"$dir/log"
}
compile_glsl() { timeout 60 glslangValidator -V --target-env vulkan1.0 -S comp -o "$dir/out.spv" "$1" >"$dir/log"; }

checked() {
    local name=$1
    shift
    rm -f "$dir/out.spv"
    if ! "$@"; then
        echo "$name does not compile:"
        cat "$dir/log"
        exit 1
    fi
    # The SPIR-V itself is checked where its tools are at hand.
    if command -v spirv-val >/dev/null; then spirv-val "$dir/out.spv"; fi
    echo "$name: $(wc -c <"$dir/out.spv") bytes of SPIR-V"
}
checked "Unity's Frag" compile_hlsl frag Frag "$hlsl"
checked "Unity's Frag, both eyes at once" compile_hlsl frag Frag "$hlsl" -DSTEREO
checked "Unity's Vert" compile_hlsl vert Vert "$hlsl"
checked "Godot's compute shader" compile_glsl "$glsl"

# Copies with a name that is not declared, a wrong type and a missing semicolon must fail.
rejected() {
    local name=$1 from=$2 to=$3
    shift 3
    sed "s|$from|$to|" "$name" >"$dir/broken"
    cmp -s "$name" "$dir/broken" && { echo "$from is not in the shader"; exit 1; }
    if "$@"; then
        echo "compiled, though $from had become $to"
        exit 1
    fi
}
for change in 'float luminance = dot(value|float luminance = dot(valve' 'float4 bands = LOAD|float4x4 bands = LOAD' 'float3 noise;|float3 noise'; do
    rejected "$hlsl" "${change%|*}" "${change#*|}" compile_hlsl frag Frag "$dir/broken"
done
for change in 'float luminance = dot(value|float luminance = dot(valve' 'vec4 bands = imageLoad|mat4 bands = imageLoad' 'vec3 noise = vec3(0.0);|vec3 noise = vec3(0.0)'; do
    rejected "$glsl" "${change%|*}" "${change#*|}" compile_glsl "$dir/broken"
done
echo "shaders compile; broken copies do not"
