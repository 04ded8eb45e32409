/** What a worker does for `Live`: frames come as they come, and the newest one that has its neighbours is worked on. */
import { bytes } from './frame.js';
import { load } from './module.js';

/** The graphics devices that are only a program on the processor: there, the processor itself is faster. */
const isProgram = (adapter) =>
  adapter.isFallbackAdapter || adapter.info?.isFallbackAdapter || /swiftshader|llvmpipe|warp/i.test(`${adapter.info?.architecture} ${adapter.info?.description}`);

const say = (type, more = {}, transfer = []) => self.postMessage({ type, ...more }, transfer);

/** Whether a graphics device is to draw, or the sentence why none does. */
async function whyNoDevice(gpu) {
  if (gpu === 'never') return 'it was asked for';
  if (!navigator.gpu) return 'this browser has no WebGPU';
  const adapter = await navigator.gpu.requestAdapter({ powerPreference: 'high-performance' }).catch(() => null);
  if (!adapter) return 'the browser found no graphics device';
  if (gpu !== 'always' && isProgram(adapter)) return 'there is no graphics card, only a program that plays one';
  return undefined;
}

export async function live({ fps, fov = 50, maxSide = 640, threads = 1, gpu = 'auto', compiled } = {}) {
  const module = await load({ threads, compiled });
  const { Live, Screen } = module;
  /** The newest frames: width, height, number, lap, data. */
  let recent = [];
  let current;
  let look = {};
  let object = null;
  let done = 0;
  let canvas;
  let by;
  let failures = 0;
  let newestLap = 0;
  /** The frame that was worked on last, and the one that is to be drawn once more. */
  let last;
  let again;
  let scheduled = false;
  const channel = new MessageChannel();

  /** Draws by a graphics device if there is one that is worth it. */
  async function openScreen() {
    canvas = undefined;
    by = { by: 'processor', why: await whyNoDevice(gpu) };
    if (by.why) return current.live.leaveScreen();
    try {
      const made = new OffscreenCanvas(current.width, 2 * current.height);
      current.live.setScreen(await Screen.open(made));
      canvas = made;
      by = { by: 'webgpu' };
    } catch (e) {
      if (e instanceof WebAssembly.RuntimeError) throw e;
      current.live.leaveScreen();
      by.why = e.message;
    }
    return undefined;
  }

  async function sized(width, height) {
    if (current?.width === width && current.height === height) return;
    current?.live.free();
    current = { width, height, live: new Live(width, height, fov, fps) };
    if (object) current.live.setObject(new Uint8Array(object));
    applyLook();
    await openScreen();
  }

  function applyLook() {
    const { size = 0.5, x = 0.5, y = 0.75, distance = 2, noise = true, disk = false } = look;
    current?.live.setLook(size, x, y, distance, !noise, disk);
  }

  /** The picture of what was estimated last. */
  async function picture() {
    const data = (() => {
      try {
        return current.live.draw();
      } catch (e) {
        if (e instanceof WebAssembly.RuntimeError || !canvas) throw e;
        return e;
      }
    })();
    if (data instanceof Error) {
      // A device that was lost once may come back; one that is lost again and again is left alone.
      failures += 1;
      say('note', { why: `${data.message}; starting again ${failures > 3 ? 'without one' : 'on a new one'}` });
      if (failures > 3) gpu = 'never';
      await openScreen();
      return picture();
    }
    if (!data) return canvas.transferToImageBitmap();
    return createImageBitmap(new ImageData(new Uint8ClampedArray(data), current.width, 2 * current.height));
  }

  /** Estimates from a frame with its neighbours and shows it. */
  async function work(frame) {
    [done, last, again] = [frame.number, frame, undefined];
    // What comes while a device is opened does not take the place of these.
    const around = new Set([frame, ...recent]);
    await sized(frame.width, frame.height);
    const { live } = current;
    const start = performance.now();
    for (const { number, data, width, height } of around) {
      const near = Math.abs(number - frame.number) <= 1 && width === frame.width && height === frame.height;
      if (near && !live.has(number)) live.add(number, data);
    }
    const { frame: number, changed = [], ...camera } = JSON.parse(live.estimate(frame.number, frame.lap));
    const estimated = performance.now();
    const parameters = JSON.parse(module.cameraParameters(JSON.stringify(camera)));
    const drawn = await picture();
    const times = { estimate: estimated - start, composite: performance.now() - estimated };
    const { width, height } = current;
    say('frame', { number, changed, camera, parameters, onPlane: live.onPlane, times, width, height, picture: drawn, ...by }, [drawn]);
  }

  /** The newest frame whose next one is here, too, and which was not worked on: only a frame with its neighbours shows motion. */
  const due = () => recent.slice(-2, -1).find((frame) => frame.number > done) ?? again;

  function schedule() {
    if (scheduled || !due()) return;
    scheduled = true;
    // What came in the meantime is taken first.
    channel.port2.postMessage(0);
  }

  channel.port1.onmessage = async () => {
    try {
      const frame = due();
      if (frame) await work(frame);
    } catch (e) {
      if (e instanceof WebAssembly.RuntimeError) say('crash', { why: e.message });
      else say('trouble', { why: e.message ?? String(e) });
    }
    scheduled = false;
    schedule();
  };

  const needs = () => {
    if (!current) throw new Error('there is no frame yet');
    return current.live;
  };
  return {
    async frame({ frame, number, lap }) {
      try {
        if (lap !== newestLap) [recent, newestLap] = [[], lap];
        recent.push({ ...(await bytes(frame, maxSide)), number, lap });
        recent = recent.slice(-3);
      } finally {
        say('taken');
      }
      schedule();
    },
    look(given) {
      look = given;
      applyLook();
      again = last;
      schedule();
    },
    object(glb) {
      // Before the first frame the object is only looked at.
      const live = current?.live ?? new Live(16, 16, fov, fps);
      const notes = live.setObject(glb ? new Uint8Array(glb) : undefined);
      object = glb;
      if (!current) live.free();
      again = last;
      schedule();
      return notes;
    },
    reference() {
      return new ImageData(new Uint8ClampedArray(needs().reference()), current.width, 2 * current.height);
    },
    applied() {
      const json = current?.live.applied();
      if (!json) return null;
      const { frame: _frame, changed: _changed, ...camera } = JSON.parse(json);
      return camera;
    },
    composite({ color, inverseDepth, flow }) {
      const data = needs().composite(color, inverseDepth, flow);
      return new ImageData(new Uint8ClampedArray(data), current.width, current.height);
    },
    breakDown(what) {
      if (what === 'device') current?.live.loseDevice();
      else throw new WebAssembly.RuntimeError('it was asked to');
    },
  };
}
