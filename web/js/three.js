/**
 * three.js: a camera's motion blur, depth of field and noise on what three renders, over a picture of that camera.
 *
 * `LayerRenderer` renders the virtual objects alone: colour, depth and motion. `BlindaugPass` puts them over the picture, for `EffectComposer` of
 * `WebGLRenderer`. `compositeWebGPU` does the same for `WebGPURenderer` by `Live.composite`, the reference on the processor.
 */
import {
  Color, DataTexture, DepthTexture, FloatType, HalfFloatType, Matrix4, NearestFilter, NoColorSpace, RGBAFormat, RepeatWrapping, ShaderMaterial,
  Vector2, Vector3, Vector4, WebGLRenderTarget,
} from 'three';
import { FullScreenQuad, Pass } from 'three/addons/postprocessing/Pass.js';
import { noiseTile } from './camera.js';

/** Rendered apart from the picture behind: premultiplied colour with depth, and motion in px to the next frame. */
export class LayerRenderer {
  #before = new WeakMap();
  #motion;

  constructor(width, height) {
    this.target = new WebGLRenderTarget(width, height, {
      type: HalfFloatType, format: RGBAFormat, samples: 4, depthTexture: new DepthTexture(width, height, FloatType),
    });
    this.motion = new WebGLRenderTarget(width, height, { type: HalfFloatType, format: RGBAFormat, minFilter: NearestFilter, magFilter: NearestFilter });
    /** The largest motion of a corner of what is rendered, px. */
    this.reach = new Vector2();
    this.#motion = new ShaderMaterial({
      uniforms: { previous: { value: new Matrix4() }, size: { value: new Vector2(width, height) } },
      vertexShader: /* glsl */ `
        uniform mat4 previous;
        varying vec4 now;
        varying vec4 before;
        void main() {
          now = projectionMatrix * modelViewMatrix * vec4( position, 1.0 );
          before = projectionMatrix * previous * vec4( position, 1.0 );
          gl_Position = now;
        }`,
      fragmentShader: /* glsl */ `
        uniform vec2 size;
        varying vec4 now;
        varying vec4 before;
        void main() {
          vec2 moved = 0.5 * size * ( now.xy / now.w - before.xy / before.w );
          gl_FragColor = vec4( moved, 0.0, 1.0 );
        }`,
    });
  }

  setSize(width, height) {
    this.target.setSize(width, height);
    this.motion.setSize(width, height);
    this.#motion.uniforms.size.value.set(width, height);
  }

  /** Renders the objects of a scene whose background is left out. Motion is that of rigid objects since the last call. */
  render(renderer, scene, camera) {
    const kept = { background: scene.background, color: renderer.getClearColor(new Color()), alpha: renderer.getClearAlpha(), target: renderer.getRenderTarget() };
    scene.background = null;
    renderer.setClearColor(0x000000, 0);
    renderer.setRenderTarget(this.target);
    renderer.clear();
    renderer.render(scene, camera);
    const meshes = [];
    this.reach.set(0, 0);
    const size = this.#motion.uniforms.size.value;
    scene.traverseVisible((mesh) => {
      if (!mesh.isMesh) return;
      const view = new Matrix4().multiplyMatrices(camera.matrixWorldInverse, mesh.matrixWorld);
      const previous = this.#before.get(mesh) ?? view;
      this.#before.set(mesh, view);
      mesh.geometry.boundingBox ?? mesh.geometry.computeBoundingBox();
      const { min, max } = mesh.geometry.boundingBox;
      for (let i = 0; i < 8; i++) {
        const corner = new Vector3(i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z);
        const at = (matrix) => corner.clone().applyMatrix4(matrix).applyMatrix4(camera.projectionMatrix);
        const moved = at(view).sub(at(previous));
        this.reach.max(new Vector2(Math.abs(0.5 * size.x * moved.x), Math.abs(0.5 * size.y * moved.y)));
      }
      const material = this.#motion.clone();
      material.uniforms.previous.value.copy(previous);
      material.side = mesh.material.side ?? 0;
      meshes.push([mesh, mesh.material]);
      mesh.material = material;
    });
    renderer.setRenderTarget(this.motion);
    renderer.clear();
    renderer.render(scene, camera);
    for (const [mesh, material] of meshes) {
      mesh.material.dispose();
      mesh.material = material;
    }
    scene.background = kept.background;
    renderer.setClearColor(kept.color, kept.alpha);
    renderer.setRenderTarget(kept.target);
  }

  dispose() {
    this.target.dispose();
    this.motion.dispose();
    this.#motion.dispose();
  }
}

/** The most taps to each side of a pixel. */
const TAPS = 24;

/**
 * The layer over a picture as the camera would have filmed it. Out-of-focus points are Gaussians, streaks are straight; each tap carries the
 * blur of the place that it comes from. It writes display-encoded values: add it after `OutputPass`, or alone.
 */
export class BlindaugPass extends Pass {
  #bands;
  #lens;
  #exposure = 0;

  /** `plate`: the camera's picture, a texture of encoded values without a colour space; `layer`: a `LayerRenderer`; `camera`: three's own. */
  constructor({ plate, layer, camera }) {
    super();
    this.layer = layer;
    this.camera = camera;
    const zeros = () => [0, 1, 2].map(() => new Vector4());
    plate.colorSpace = NoColorSpace;
    this.material = new ShaderMaterial({
      uniforms: {
        plate: { value: plate }, color: { value: layer.target.texture }, depth: { value: layer.target.depthTexture }, motion: { value: layer.motion.texture },
        inverseProjection: { value: new Matrix4() }, size: { value: new Vector2() }, reach: { value: new Vector2() },
        exposure: { value: 0 }, sigma: { value: 0 }, focus: { value: 0 },
        bands: { value: null }, slope: { value: zeros() }, intercept: { value: zeros() }, clipLevel: { value: 1 }, offset: { value: new Vector2() },
      },
      vertexShader: /* glsl */ `void main() { gl_Position = vec4( position.xy, 0.0, 1.0 ); }`,
      fragmentShader: /* glsl */ `
        uniform sampler2D plate, color, depth, motion, bands;
        uniform mat4 inverseProjection;
        uniform vec2 size, reach, offset;
        uniform float exposure, sigma, focus, clipLevel;
        uniform vec4 slope[3], intercept[3];
        const int TAPS = ${TAPS};

        vec3 decoded( vec3 v ) { return mix( v / 12.92, pow( ( v + 0.055 ) / 1.055, vec3( 2.4 ) ), step( 0.04045, v ) ); }
        vec3 encoded( vec3 v ) { v = clamp( v, 0.0, 1.0 ); return mix( v * 12.92, 1.055 * pow( v, vec3( 1.0 / 2.4 ) ) - 0.055, step( 0.0031308, v ) ); }
        // The integral of a normal distribution.
        float below( float x ) { float t = x * ( 1.5957691 + 0.07288 * x * x ); return 1.0 / ( 1.0 + exp( - t ) ); }

        float inverseDepth( vec2 uv ) {
          float z = texture2D( depth, uv ).x;
          if ( z >= 1.0 ) return 0.0;
          vec4 at = inverseProjection * vec4( 2.0 * uv - 1.0, 2.0 * z - 1.0, 1.0 );
          return - at.w / at.z;
        }

        // How much of the light of a place lands d px away from it: a Gaussian along a streak.
        float spread( vec2 d, float std, vec2 streak ) {
          float length_ = length( streak );
          vec2 along = length_ > 1e-3 ? streak / length_ : vec2( 1.0, 0.0 );
          float a = dot( d, along );
          float across = dot( d, vec2( - along.y, along.x ) );
          float line = length_ > 0.5 * std
            ? ( below( ( a + 0.5 * length_ ) / std ) - below( ( a - 0.5 * length_ ) / std ) ) / length_
            : exp( - 0.5 * a * a / ( std * std ) ) / ( 2.5066283 * std );
          return line * exp( - 0.5 * across * across / ( std * std ) ) / ( 2.5066283 * std );
        }

        #ifdef HAS_NOISE
        float noise( int channel, ivec2 shift, float luminance ) {
          vec4 std = max( slope[ channel ] * luminance + intercept[ channel ], 0.0 );
          return dot( std, ( texelFetch( bands, ( ivec2( gl_FragCoord.xy ) + ivec2( offset ) + shift ) & ivec2( MASK ), 0 ) - 0.5 ) / GAIN );
        }
        #endif

        void main() {
          vec2 uv = gl_FragCoord.xy / size;
          vec4 sum = texture2D( color, uv );
          if ( max( reach.x, reach.y ) > 1.0 ) {
            // Taps stand on a grid over all that may reach this pixel.
            ivec2 taps = ivec2( clamp( ceil( reach ), vec2( 1.0 ), vec2( float( TAPS ) ) ) );
            vec2 step_ = reach / vec2( taps );
            sum = vec4( 0.0 );
            for ( int y = - TAPS; y <= TAPS; y ++ ) {
              if ( abs( y ) > taps.y ) continue;
              for ( int x = - TAPS; x <= TAPS; x ++ ) {
                if ( abs( x ) > taps.x ) continue;
                vec2 d = step_ * vec2( float( x ), float( y ) );
                vec2 at = uv + d / size;
                vec4 light = texture2D( color, at );
                if ( light.a <= 0.0 ) continue;
                float inverse = inverseDepth( at );
                // A narrower Gaussian would fall between the taps.
                float std = max( inverse > 0.0 ? abs( sigma * ( 1.0 - inverse / focus ) ) : 0.0, 0.5 * max( step_.x, step_.y ) );
                sum += light * spread( d, std, exposure * texture2D( motion, at ).xy ) * step_.x * step_.y;
              }
            }
          }
          float covered = min( sum.a, 1.0 );
          vec3 behind = decoded( texture2D( plate, uv ).rgb );
          vec3 value = encoded( sum.rgb + ( 1.0 - covered ) * behind );
          if ( covered < 1.0 / 512.0 ) value = texture2D( plate, uv ).rgb;
          #ifdef HAS_NOISE
          float luminance = dot( value, vec3( 0.299, 0.587, 0.114 ) );
          vec3 grain = vec3( noise( 0, OFFSET_0, luminance ), noise( 1, OFFSET_1, luminance ), noise( 2, OFFSET_2, luminance ) );
          // The picture has its own noise where it shows.
          float own = 1.0 - covered;
          value = clamp( value + grain * sqrt( max( 1.0 - own * own, 0.0 ) ), 0.0, clipLevel );
          #endif
          gl_FragColor = vec4( value, 1.0 );
        }`,
      depthTest: false,
      depthWrite: false,
      defines: {},
    });
    this.quad = new FullScreenQuad(this.material);
  }

  /** The camera whose distortions are applied from now on, as `Tracker` gives it; its lens must be over metres, as `Live.applied` gives it. */
  async setCamera(camera) {
    const { uniforms, defines } = this.material;
    const known = (part) => (camera[part]?.unknown === undefined ? camera[part] : undefined);
    this.#exposure = known('motion_blur')?.exposure ?? 0;
    const lens = known('defocus');
    this.#lens = lens?.depth_kind === 'metric' && lens.model === 'thin_lens' ? { sigma: lens.sigma_px_at_infinity, focus: lens.focus_inverse_depth, width: camera.capture.width } : undefined;
    const noise = known('noise');
    if (noise) this.#bands ??= await tileOfNoise();
    const has = Boolean(noise);
    if (has) {
      const vectors = (key) => [0, 1, 2].map((c) => new Vector4(...noise.levels.map((level) => level[key][c])));
      uniforms.slope.value = vectors('slope');
      uniforms.intercept.value = vectors('intercept');
      uniforms.clipLevel.value = noise.clip;
      uniforms.bands.value = this.#bands.texture;
      const { side, gain, offsets } = this.#bands;
      Object.assign(defines, { MASK: side - 1, GAIN: gain.toFixed(6) });
      offsets.forEach(([x, y], c) => (defines[`OFFSET_${c}`] = `ivec2( ${x}, ${y} )`));
    }
    if (has !== 'HAS_NOISE' in defines) {
      if (has) defines.HAS_NOISE = '';
      else delete defines.HAS_NOISE;
      this.material.needsUpdate = true;
    }
  }

  render(renderer, writeBuffer) {
    const { uniforms } = this.material;
    const { width, height } = this.layer.target;
    uniforms.size.value.set(width, height);
    uniforms.inverseProjection.value.copy(this.camera.projectionMatrixInverse);
    uniforms.exposure.value = this.#exposure;
    const sigma = this.#lens ? (this.#lens.sigma * width) / this.#lens.width : 0;
    uniforms.sigma.value = sigma;
    uniforms.focus.value = this.#lens?.focus ?? 1;
    // Three std of the largest blur, of what is at the near end of the scene or at infinity, and half a streak.
    const blur = 3 * sigma * Math.max(1, Math.abs(1 - 1 / ((this.near ?? 0.5) * uniforms.focus.value)));
    uniforms.reach.value.copy(this.layer.reach).multiplyScalar(0.5 * this.#exposure).addScalar(sigma > 0 || this.#exposure > 0 ? blur + 1 : 0);
    uniforms.offset.value.set(Math.floor(1024 * Math.random()), Math.floor(1024 * Math.random()));
    renderer.setRenderTarget(this.renderToScreen ? null : writeBuffer);
    this.quad.render(renderer);
  }

  dispose() {
    this.material.dispose();
    this.quad.dispose();
    this.#bands?.texture.dispose();
  }
}

/** The octaves of the noise as a texture, and how it is read. */
async function tileOfNoise() {
  const { side, gain, offsets, data } = await noiseTile();
  const texture = new DataTexture(data, side, side);
  texture.wrapS = texture.wrapT = RepeatWrapping;
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return { texture, side, gain, offsets };
}

/**
 * For `WebGPURenderer`: what was rendered into targets of floats, over the frame that `live` showed last, as an ImageData. `color` is premultiplied
 * and linear, `inverseDepth` holds 1/m in its first channel (0: nothing), `motion` px to the next frame (x right, y down) in its first two; each a
 * `RenderTarget` of the frame's size.
 */
export async function compositeWebGPU(renderer, live, { color, inverseDepth, motion }) {
  const { width, height } = color;
  const read = async (target, channels) => {
    if (!target) return undefined;
    const all = await renderer.readRenderTargetPixelsAsync(target, 0, 0, width, height);
    const stride = all.length / height;
    const out = new Float32Array(channels * width * height);
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++) {
        for (let c = 0; c < channels; c++) out[channels * (y * width + x) + c] = all[y * stride + 4 * x + c];
      }
    }
    return out;
  };
  const [light, depth, flow] = await Promise.all([read(color, 4), read(inverseDepth, 1), read(motion, 2)]);
  return live.composite({ color: light, inverseDepth: depth, flow });
}
