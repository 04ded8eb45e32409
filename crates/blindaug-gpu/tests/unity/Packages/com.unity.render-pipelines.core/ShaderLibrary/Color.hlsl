// A stand-in for Unity's header of this name, which declares only what that declares and the exported shader takes.
#ifndef COLOR
#define COLOR
float3 LinearToSRGB(float3 c) { return c <= 0.0031308 ? 12.92 * c : 1.055 * pow(abs(c), 1.0 / 2.4) - 0.055; }
float3 SRGBToLinear(float3 c) { return c <= 0.04045 ? c / 12.92 : pow(abs((c + 0.055) / 1.055), 2.4); }
#endif
