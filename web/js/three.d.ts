import type { Camera as ThreeCamera, RenderTarget, Scene, Texture, WebGLRenderTarget, WebGLRenderer, Vector2 } from 'three';
import type { Pass } from 'three/addons/postprocessing/Pass.js';
import type { Camera, Live } from './index.js';

/** Renders virtual objects alone: premultiplied colour with depth, and motion in px to the next frame. */
export class LayerRenderer {
  constructor(width: number, height: number);
  readonly target: WebGLRenderTarget;
  readonly motion: WebGLRenderTarget;
  /** The largest motion of a corner of what is rendered, px. */
  readonly reach: Vector2;
  setSize(width: number, height: number): void;
  /** Motion is that of rigid objects since the last call. */
  render(renderer: WebGLRenderer, scene: Scene, camera: ThreeCamera): void;
  dispose(): void;
}

/** The layer over a picture as the camera would have filmed it; writes display-encoded values. */
export class BlindaugPass extends Pass {
  constructor(options: { /** The camera's picture, encoded. */ plate: Texture; layer: LayerRenderer; camera: ThreeCamera });
  /** The least distance of what is rendered, m; default 0.5. */
  near?: number;
  /** The camera whose distortions are applied from now on; its lens must be over metres, as `Live.applied` gives it. */
  setCamera(camera: Camera): Promise<void>;
}

/** For `WebGPURenderer`: what was rendered, over the frame that `live` showed last. */
export function compositeWebGPU(
  renderer: { readRenderTargetPixelsAsync(target: RenderTarget, x: number, y: number, w: number, h: number): Promise<ArrayLike<number>> },
  live: Live,
  layer: { color: RenderTarget; inverseDepth?: RenderTarget; motion?: RenderTarget },
): Promise<ImageData>;
