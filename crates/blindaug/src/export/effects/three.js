import { ShaderMaterial, Vector2, Vector4 } from 'three';
import { FullScreenQuad, Pass } from 'three/addons/postprocessing/Pass.js';

/** The camera: null where it is unknown. */
export const camera = {
    /**
     * Fraction of the frame interval that the shutter is open: motion vectors times this are streaks. With three's TSL, whose velocity is
     * in normalized device coordinates and whose blur is in texture coordinates:
     *
     *     motionBlur( color, velocity.mul( vec2( 0.5, - 0.5 ) ).mul( camera.exposure ), 32 )
     */
    exposure: @exposure@,
    /** Blur of a std of `sigmaPxAtInfinity * |1 - focusDistance / z|` px, z in metres, on pictures `width` px wide. */
    lens: @lens@,
    /** Std of the noise's octaves, finest first, over encoded luminance Y: slope * Y + intercept, for R, G and B. */
    noise: @noise@,
};

/** Std of the lens's blur at a distance in metres, px on pictures `width` px wide. */
export function sigmaPx(distance, width = camera.lens?.width) {
    if (!camera.lens) return 0;
    const { sigmaPxAtInfinity, focusDistance } = camera.lens;
    return sigmaPxAtInfinity * width / camera.lens.width * Math.abs(1 - focusDistance / distance);
}

/**
 * For `dof( color, viewZ, focusDistance, focalLength, bokehScale )` of three's TSL: an approximation, see the notes above. `bokehScale`
 * is for pictures `camera.lens.width` px wide, and goes with the width.
 */
export const depthOfField = @depthOfField@;

/**
 * The camera's noise on the whole picture. Add it after OutputPass: noise lives in encoded values.
 *
 * `bands` is the texture @bands@, loaded without a colour space:
 *
 *     const bands = await new TextureLoader().loadAsync( '@bands@' );
 *     composer.addPass( new OutputPass() );
 *     composer.addPass( new GrainPass( bands ) );
 *
 * Where `camera.noise` is null there is no such file: `new GrainPass()` does nothing.
 */
export class GrainPass extends Pass {

    constructor( bands ) {

        super();
        // Without noise there is no texture, and the composer leaves the pass out.
        this.enabled = camera.noise !== null;
        if ( bands ) {

            bands.colorSpace = '';
            bands.flipY = false;
            bands.premultiplyAlpha = false;
            bands.generateMipmaps = false;
            bands.needsUpdate = true;

        }
        const noise = camera.noise ?? { slope: zeros(), intercept: zeros(), clip: 1 };
        const vectors = ( rows ) => rows.map( ( row ) => new Vector4( ...row ) );
        this.material = new ShaderMaterial( {
            uniforms: {
                tDiffuse: { value: null },
                bands: { value: bands ?? null },
                slope: { value: vectors( noise.slope ) },
                intercept: { value: vectors( noise.intercept ) },
                clipLevel: { value: noise.clip },
                offset: { value: new Vector2() },
            },
            vertexShader: /* glsl */ `
                void main() {
                    gl_Position = vec4( position.xy, 0.0, 1.0 );
                }`,
            fragmentShader: /* glsl */ `
                uniform sampler2D tDiffuse;
                // The noise's four octaves, finest first, in R, G, B, A: 0.5 + gain n.
                uniform sampler2D bands;
                uniform vec4 slope[3];
                uniform vec4 intercept[3];
                uniform float clipLevel;
                uniform vec2 offset;

                float of( int channel, ivec2 shift, float luminance ) {
                    ivec2 texel = ( ivec2( gl_FragCoord.xy ) + ivec2( offset ) + shift ) & ivec2( @mask@ );
                    vec4 sigma = max( slope[ channel ] * luminance + intercept[ channel ], 0.0 );
                    return dot( sigma, ( texelFetch( bands, texel, 0 ) - 0.5 ) / @gain@ );
                }

                void main() {
                    vec4 scene = texelFetch( tDiffuse, ivec2( gl_FragCoord.xy ), 0 );
                    vec3 value = clamp( scene.rgb, 0.0, 1.0 );
                    float luminance = dot( value, vec3( 0.299, 0.587, 0.114 ) );
                    // The channels read different parts of the tile, so that their noise is independent.
                    vec3 noise = vec3(
                        of( 0, ivec2( @offset0@ ), luminance ), of( 1, ivec2( @offset1@ ), luminance ), of( 2, ivec2( @offset2@ ), luminance ) );
                    // None where the sensor clips, to half an 8-bit step: the composer's half floats can fall short of the level.
                    vec3 clips = step( clipLevel - 0.5 / 255.0, value );
                    gl_FragColor = vec4( mix( clamp( value + noise, 0.0, clipLevel ), value, clips ), scene.a );
                }`,
            depthTest: false,
            depthWrite: false,
        } );
        this.quad = new FullScreenQuad( this.material );

    }

    render( renderer, writeBuffer, readBuffer ) {

        const { uniforms } = this.material;
        uniforms.tDiffuse.value = readBuffer.texture;
        // Another part of the tile for each frame, so that it is not seen to repeat.
        uniforms.offset.value.set( Math.floor( @side@ * Math.random() ), Math.floor( @side@ * Math.random() ) );
        renderer.setRenderTarget( this.renderToScreen ? null : writeBuffer );
        this.quad.render( renderer );

    }

    dispose() {

        this.material.dispose();
        this.quad.dispose();

    }

}

function zeros() {

    return [ [ 0, 0, 0, 0 ], [ 0, 0, 0, 0 ], [ 0, 0, 0, 0 ] ];

}
