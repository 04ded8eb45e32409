import { postable } from './frame.js';
import { Host } from './host.js';

/** The most frames that wait for the worker. */
const WAITING = 6;

/** An object in live footage: estimated, drawn and composited in a worker of its own, as fast as it can. */
export class Live {
  #host;
  #look = {};
  #object;
  #sent = 0;

  /** Live estimation; see `LiveOptions` in index.d.ts. */
  static async create(options = {}) {
    const live = new Live();
    const { onframe, onrestart, onnote, ...rest } = options;
    live.#host = new Host(
      ['live', rest],
      (e) => {
        switch (e.type) {
          case 'taken':
            live.#sent -= 1;
            return undefined;
          case 'frame':
            return onframe ? onframe(e) : e.picture?.close();
          case 'note':
          case 'trouble':
            return onnote?.(e.why);
          case 'restart':
          case 'end':
            live.#sent = 0;
            if (e.type === 'restart') live.#restore(onnote);
            return onrestart?.(e.why, e.type === 'end');
          default:
            return undefined;
        }
      },
    );
    await live.#host.ready;
    return live;
  }

  /** Gives a new worker what the last one had been told. */
  #restore(onnote) {
    this.setLook({});
    if (this.#object) this.setObject(this.#object).catch((e) => onnote?.(e.message));
  }

  /**
   * Offers a frame. Gives false where too many wait already: then it is left out, as one that a camera dropped. `lap` counts how often a clip
   * has started again.
   */
  async push(source, { number, lap = 0 }) {
    if (this.#sent >= WAITING) {
      source.close?.();
      return false;
    }
    this.#sent += 1;
    try {
      const [frame, transfer] = await postable(source);
      await this.#host.tell('frame', { frame, number, lap }, transfer);
      return true;
    } catch (e) {
      this.#sent -= 1;
      throw e;
    }
  }

  /** Changes how the object looks; what is left out stays as it is. */
  setLook(look) {
    this.#look = { ...this.#look, ...look };
    this.#host.tell('look', this.#look);
  }

  /** The object of a .glb file (an ArrayBuffer), or with `null` the built-in one; gives sentences about how it was read. */
  async setObject(glb) {
    const notes = await this.#host.ask('object', glb);
    this.#object = glb;
    return notes;
  }

  /** The frame that was shown last as the reference, the processor, composites it: an ImageData, pasted above filmed. */
  reference() {
    return this.#host.ask('reference');
  }

  /** The camera as it is applied to the object, with its lens over depth in metres; `null` before the first frame. */
  applied() {
    return this.#host.ask('applied');
  }

  /** A layer of the page's own renderer over the frame that was shown last; see `Layer` in index.d.ts. Gives an ImageData. */
  composite({ color, inverseDepth, flow }) {
    return this.#host.ask('composite', { color, inverseDepth, flow });
  }

  /** Makes the worker crash, or its graphics device fail: to test that a page goes on. */
  breakDown(what) {
    this.#host.tell('breakDown', what);
  }

  /** Ends the worker. */
  close() {
    this.#host.close();
  }
}
