import { postable } from './frame.js';
import { Host } from './host.js';

/** Estimates a camera for each frame, in a worker of its own. */
export class Tracker {
  #host;
  #number = 0;

  /** A tracker; see `TrackerOptions` in index.d.ts. */
  static async create(options = {}) {
    const tracker = new Tracker();
    const { fps, noise = 'curves', maxSide, threads = 1, onrestart } = options;
    const begin = ['tracker', { fps, lines: noise === 'lines', maxSide, threads }];
    tracker.#host = new Host(begin, (e) => (e.type === 'restart' || e.type === 'end') && onrestart?.(e.why));
    await tracker.#host.ready;
    return tracker;
  }

  /**
   * Takes the next frame, and gives the camera of the frame before it; `null` for the first one. A gap in the numbers is a gap in time; without a
   * number the frame follows the last one.
   */
  async push(source, { number = this.#number + 1 } = {}) {
    this.#number = number;
    const [frame, transfer] = await postable(source);
    return this.#host.ask('push', { frame, number }, transfer);
  }

  /** The camera of the last frame; `null` if none waits. */
  finish() {
    return this.#host.ask('finish');
  }

  /** Ends the worker. */
  close() {
    this.#host.close();
  }
}
