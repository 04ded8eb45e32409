// A stand-in for Unity's header of this name: a triangle over the whole picture, and the picture that it is drawn from.
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
