// A stand-in for Unity's header of this name. From the array of both eyes' pictures, Unity reads the one that the setup macro of
// Blit.hlsl chose.
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
