/** blindaug in the browser: a camera's noise, motion blur and depth of field from its frames, and on virtual objects. */

/** What cannot be known, and why. */
export interface Unknown {
  unknown: string;
  reason?: string;
}

/** How a number was found: `spectral`, `temporal`, `given`, .. */
export type Method = string;

/** A value's 95 % interval. */
export type Interval = [number, number];

export type Rgb = [number, number, number];

/** Noise: the std of each encoded channel over luminance, a line per octave. */
export interface Noise {
  /** Four octaves, the finest first: std = intercept + slope x luminance, of R, G and B in [0, 1]. */
  levels: { slope: Rgb; intercept: Rgb }[];
  /** The encoded value from which on there is no noise. */
  clip: number;
  method: Method;
  samples: number;
  [more: string]: unknown;
}

export interface MotionBlur {
  /** The share of the frame interval for which the shutter is open. */
  exposure: number;
  interval: Interval;
  method: Method;
  samples: number;
  [more: string]: unknown;
}

/** Depth of field: the std of the blur at inverse depth d is `sigma_px_at_infinity |1 - d / focus_inverse_depth|`. */
export interface Defocus {
  model: 'thin_lens' | 'quadratic';
  sigma_px_at_infinity?: number;
  focus_inverse_depth?: number;
  depth_kind: 'metric' | 'relative';
  interval?: { sigma_px_at_infinity: Interval; focus_inverse_depth: Interval };
  method: Method;
  samples: number;
  [more: string]: unknown;
}

/** A camera, as in camera.json. */
export interface Camera {
  format: 'blindaug-camera';
  version: number;
  capture: { width: number; height: number; fps?: number | null; frames_used: number; [more: string]: unknown };
  transfer: string;
  noise: Noise | Unknown;
  motion_blur: MotionBlur | Unknown;
  defocus: Defocus | Unknown;
  warnings?: string[];
  [more: string]: unknown;
}

/** A camera at a frame. */
export interface TrackedCamera {
  /** The frame's number. */
  frame: number;
  /** What was found to have changed just before it. */
  changed: string[];
  camera: Camera;
  times: { /** Time to estimate, ms. */ estimate: number };
}

/** Bytes R, G, B, A of each pixel, row by row. */
export interface Pixels {
  width: number;
  height: number;
  data: Uint8Array | Uint8ClampedArray;
}

/** A frame. A `VideoFrame` or an `ImageBitmap` is given away: it is closed when it has been read. */
export type Source =
  | VideoFrame
  | ImageBitmap
  | HTMLVideoElement
  | HTMLImageElement
  | HTMLCanvasElement
  | OffscreenCanvas
  | ImageData
  | Pixels;

export interface Common {
  /** Frames per second; only copied into the cameras, and for `Live` the pace of the animation. */
  fps?: number;
  /** The largest side, px, of the frames that are worked on; larger ones are reduced. */
  maxSide?: number;
  /** How many threads estimate; more than one only in a page that its server isolates (COOP and COEP). Default: 1. */
  threads?: number;
}

export interface TrackerOptions extends Common {
  /** The noise as curves over colour beside the lines over luminance, or as lines only. Default: curves. */
  noise?: 'curves' | 'lines';
  /** Called when the worker crashed and another one has begun anew. */
  onrestart?: (why: string) => void;
}

/** Estimates a camera for each of the frames that are pushed one after another. */
export class Tracker {
  private constructor();
  static create(options?: TrackerOptions): Promise<Tracker>;
  /** Takes the next frame, and gives the camera of the frame before it; `null` for the first. A gap in the numbers is a gap in time. */
  push(source: Source, options?: { number?: number }): Promise<TrackedCamera | null>;
  /** The camera of the last frame; `null` if none waits. */
  finish(): Promise<TrackedCamera | null>;
  close(): void;
}

export interface LiveOptions extends Common {
  /** The camera's vertical field of view, degrees. Default: 50. */
  fov?: number;
  /** Whether a graphics device draws: `auto`, if there is a graphics card; else the processor does. Default: `auto`. */
  gpu?: 'auto' | 'always' | 'never';
  onframe?: (frame: LiveFrame) => void;
  /** Called with a sentence when something was left out or began anew. */
  onnote?: (sentence: string) => void;
  /** Called when the worker crashed; another one has begun anew, except at the `end`. */
  onrestart?: (why: string, end: boolean) => void;
}

/** A frame with the object in it. */
export interface LiveFrame {
  number: number;
  camera: Camera;
  changed: string[];
  /** Names and short texts: values with their intervals, or the reasons why they are unknown. */
  parameters: [string, string][];
  /** Whether the object stands on a plane that is tracked, rather than fixed in view. */
  onPlane: boolean;
  /** ms. */
  times: { estimate: number; composite: number };
  width: number;
  height: number;
  /** Twice as high as the frame: above with the object pasted on, below as the camera would have filmed it. To be closed. */
  picture: ImageBitmap;
  by: 'webgpu' | 'processor';
  /** Why the processor draws. */
  why?: string;
}

export interface Look {
  /** The object's longest side as a share of the height that is seen at its distance. Default: 0.5. */
  size?: number;
  /** Its first place in shares of width and height. Default: 0.5, 0.75. */
  x?: number;
  y?: number;
  /** Its first distance, m. Default: 2. */
  distance?: number;
  /** Whether it has the camera's noise. Default: true. */
  noise?: boolean;
  /** Whether out-of-focus points are disks. Default: false, what the lens shows. */
  disk?: boolean;
}

/** What a page's own renderer made, row by row from the top. */
export interface Layer {
  /** Premultiplied scene-linear R, G, B, A. */
  color: Float32Array;
  /** 1/m; 0 where there is nothing. */
  inverseDepth?: Float32Array;
  /** Motion to the next frame, px, x right, y down. */
  flow?: Float32Array;
}

/** An object in live footage. */
export class Live {
  private constructor();
  static create(options?: LiveOptions): Promise<Live>;
  /** Offers a frame; false where it was left out, since others wait. `lap`: how often a clip has started again. */
  push(source: Source, options: { number: number; lap?: number }): Promise<boolean>;
  setLook(look: Look): void;
  /** The object of a .glb file, or the built-in one; gives sentences about how it was read. */
  setObject(glb: ArrayBuffer | null): Promise<string[]>;
  /** What was shown last, as the reference composites it on the processor. */
  reference(): Promise<ImageData>;
  /** The camera as it is applied, with its lens over depth in metres; `null` before the first frame. */
  applied(): Promise<Camera | null>;
  /** A layer over the frame that was shown last. */
  composite(layer: Layer): Promise<ImageData>;
  /** Makes the worker crash, or its graphics device fail, to test that a page goes on. */
  breakDown(what: 'worker' | 'device'): void;
  close(): void;
}

/** Opens a webcam; an error is a sentence that says what to do. */
export function webcam(options?: {
  width?: number;
  height?: number;
  frameRate?: number;
  deviceId?: string;
  /** The element that shows it; otherwise a new one. */
  video?: HTMLVideoElement;
}): Promise<{ video: HTMLVideoElement; stream: MediaStream; track: MediaStreamTrack; fps: number | undefined }>;

/** Calls `each` for each new picture of a video; a picture that was missed is a gap in the numbers. The returned function ends it. */
export function frames(
  video: HTMLVideoElement,
  each: (video: HTMLVideoElement, at: { number: number; time: number }) => void,
): () => void;

/** A camera in words, a line per fact. */
export function cameraWords(camera: Camera | string): Promise<string>;
/** Names and short texts of a camera's parameters. */
export function cameraParameters(camera: Camera | string): Promise<[string, string][]>;
/** The text of camera.json. */
export function cameraFile(camera: Camera | string): Promise<string>;

export interface ExportTarget {
  name: string;
  tool: string;
  motionBlur: string;
  defocus: string;
  grain: string;
}
/** The tools that cameras can be exported to. */
export function exportTargets(): Promise<ExportTarget[]>;
/** A camera as settings of a tool: files, of which the first refers to the others, and what the tool cannot do. */
export function exportCamera(
  camera: Camera | string,
  target: string,
  options?: { /** The vertical field of view of the tool's camera, degrees. */ fov?: number },
): Promise<{ files: { name: string; bytes: Uint8Array }[]; notes: string[] }>;

/** A tile of noise for shaders: four octaves of std 1 in R, G, B, A, finest first, each stored as 0.5 + gain x value, 8 bit. */
export function noiseTile(): Promise<{
  /** Width and height, px. */
  side: number;
  gain: number;
  /** Where R, G and B read, so that their noise is independent. */
  offsets: [number, number][];
  data: Uint8Array;
}>;
