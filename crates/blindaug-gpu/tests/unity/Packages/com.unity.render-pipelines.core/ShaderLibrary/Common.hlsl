// A stand-in for Unity's header of this name, which declares only what that declares and the exported shader takes.
#ifndef COMMON
#define COMMON
#define TEXTURE2D(name) Texture2D name
#define SAMPLER(name) SamplerState name
#define SAMPLE_TEXTURE2D(name, sampler, at) name.Sample(sampler, at)
#define LOAD_TEXTURE2D(name, texel) name.Load(int3(texel, 0))
#endif
