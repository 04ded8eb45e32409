import { program } from './module.js';

/** A worker that is asked questions, and is started again when it crashes. */
export class Host {
  #worker;
  #asked = new Map();
  #last = 0;
  #closed = false;
  #begin;
  #begun;
  #event;
  #crashes = [];

  /**
   * `begin` is the first question to each worker, with its argument, an object; `event` is called with what a worker says unasked, and with
   * `{ type: 'restart', why }` when a worker crashed and another one takes its place.
   */
  constructor(begin, event = () => {}) {
    this.#begin = begin;
    this.#event = event;
    this.#start();
  }

  #start() {
    const worker = new Worker(new URL('./worker.js', import.meta.url), { type: 'module', name: 'blindaug' });
    this.#worker = worker;
    worker.onmessage = ({ data }) => {
      if (this.#worker !== worker) return;
      if (data.type === 'crash') return this.#crashed(data.why);
      if (data.type !== 'answer') return this.#event(data);
      const { resolve, reject } = this.#asked.get(data.id) ?? {};
      this.#asked.delete(data.id);
      if (data.error === undefined) resolve?.(data.value);
      else reject?.(new Error(data.error));
    };
    worker.onerror = (e) => {
      e.preventDefault();
      if (this.#worker === worker) this.#crashed(e.message || 'its worker could not be loaded');
    };
    const [what, argument] = this.#begin;
    // Nothing is said to a worker before that.
    let ready;
    this.#begun = program(argument).then((compiled) => {
      ready = this.#send(worker, what, { ...argument, compiled });
    });
    this.ready = this.#begun.then(() => ready);
    this.ready.catch(() => {});
  }

  #crashed(why) {
    this.#worker.terminate();
    const asked = [...this.#asked.values()];
    this.#asked.clear();
    for (const { reject } of asked) reject(new Error(`the estimation stopped (${why})`));
    if (this.#closed) return;
    // What cannot even begin is not tried for ever.
    const now = performance.now();
    this.#crashes = this.#crashes.filter((t) => now - t < 10_000).concat(now);
    if (this.#crashes.length > 3) {
      this.#closed = true;
      this.#event({ type: 'end', why });
      return;
    }
    this.#start();
    this.#event({ type: 'restart', why });
  }

  #send(worker, what, argument, transfer = []) {
    const id = ++this.#last;
    return new Promise((resolve, reject) => {
      this.#asked.set(id, { resolve, reject });
      worker.postMessage({ id, what, argument }, transfer);
    });
  }

  /** Asks a worker, and gives its answer. */
  async ask(what, argument, transfer) {
    await this.#begun;
    if (this.#closed) throw new Error('it was closed');
    return this.#send(this.#worker, what, argument, transfer);
  }

  /** Tells a worker something that has no answer. */
  async tell(what, argument, transfer = []) {
    await this.#begun;
    if (!this.#closed) this.#worker.postMessage({ what, argument }, transfer);
  }

  /** Ends the worker. */
  close() {
    this.#closed = true;
    this.#worker.terminate();
    for (const { reject } of this.#asked.values()) reject(new Error('it was closed'));
    this.#asked.clear();
  }
}
