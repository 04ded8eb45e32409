// The noise of a camera, as a full-screen pass for Unity's Universal Render Pipeline 14 and later. Written by blindaug export.
// Make a material of this shader, give it @bands@ (sRGB off, point filter, repeat, no compression, no mipmaps), and add it
// to a Full Screen Pass renderer feature, injected after rendering post-processing.
Shader "Blindaug/Grain"
{
    Properties
    {
        // The noise's four octaves, finest first, in R, G, B, A: 0.5 + gain n.
        _Bands ("Bands", 2D) = "gray" {}
    }
    SubShader
    {
        Tags { "RenderPipeline" = "UniversalPipeline" }
        Pass
        {
            Name "Blindaug grain"
            ZTest Always
            ZWrite Off
            Cull Off

            HLSLPROGRAM
            #pragma vertex Vert
            #pragma fragment Frag
            // The pipeline's own first: it declares _Time, and the macros that Blit.hlsl takes for granted.
            #include "Packages/com.unity.render-pipelines.universal/ShaderLibrary/Core.hlsl"
            #include "Packages/com.unity.render-pipelines.core/ShaderLibrary/Color.hlsl"
            #include "Packages/com.unity.render-pipelines.core/Runtime/Utilities/Blit.hlsl"

            TEXTURE2D(_Bands);

            // Std of each octave over encoded luminance, for R, G and B: slope Y + intercept.
            static const float4 Slope[3] = { @slope@ };
            static const float4 Intercept[3] = { @intercept@ };
            // The channels read different parts of the tile, so that their noise is independent.
            static const int2 Offsets[3] = { @offsets@ };
            static const float Clip = @clip@;
            static const int Mask = @mask@;
            static const float Gain = @gain@;

            // A different part of the tile for each frame (pcg2d, Jarzynski & Olano 2020).
            int2 FrameOffset()
            {
                uint2 v = uint2(asuint(_Time.y), asuint(_Time.w)) * 1664525u + 1013904223u;
                v.x += v.y * 1664525u;
                v.y += v.x * 1664525u;
                v = v ^ (v >> 16u);
                v.x += v.y * 1664525u;
                v.y += v.x * 1664525u;
                return int2((v ^ (v >> 16u)) & uint(Mask));
            }

            float4 Frag(Varyings input) : SV_Target
            {
                UNITY_SETUP_STEREO_EYE_INDEX_POST_VERTEX(input);
                float4 scene = SAMPLE_TEXTURE2D_X(_BlitTexture, sampler_PointClamp, input.texcoord);
                // Noise lives in encoded values.
                float3 value = LinearToSRGB(saturate(scene.rgb));
                float luminance = dot(value, float3(0.299, 0.587, 0.114));
                int2 position = int2(input.positionCS.xy) + FrameOffset();
                float3 noisy;
                [unroll]
                for (int c = 0; c < 3; c++)
                {
                    float4 bands = LOAD_TEXTURE2D(_Bands, (position + Offsets[c]) & Mask);
                    float4 sigma = max(Slope[c] * luminance + Intercept[c], 0.0);
                    // There is none where the sensor clips; half an 8-bit step for pictures in half floats.
                    noisy[c] = value[c] >= Clip - 0.002 ? value[c] : clamp(value[c] + dot(sigma, (bands - 0.5) / Gain), 0.0, Clip);
                }
                return float4(SRGBToLinear(noisy), scene.a);
            }
            ENDHLSL
        }
    }
}
