/** Exposure and noise over the last seconds, as SVG. */

const SECONDS = 12;
const [LEFT, RIGHT, TOP, BOTTOM] = [26, 294, 8, 132];
const svg = (name, attributes, text) => {
  const element = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
};

export class Plot {
  #element;
  #points = [];

  constructor(element) {
    this.#element = element;
    this.#draw(0);
  }

  /** Adds a time, s, the exposure with its interval and the noise in steps of 8 bit; `undefined` where they are unknown. */
  add(time, exposure, interval, noise) {
    this.#points.push({ time, exposure, interval, noise });
    while (this.#points[0].time < time - SECONDS) this.#points.shift();
    this.#draw(time);
  }

  clear() {
    this.#points = [];
    this.#draw(0);
  }

  #draw(now) {
    const noisiest = Math.max(4, ...this.#points.map((p) => p.noise ?? 0));
    const most = Math.ceil(noisiest / 4) * 4;
    const x = (time) => (RIGHT - ((now - time) / SECONDS) * (RIGHT - LEFT)).toFixed(1);
    const y = (share) => (BOTTOM - Math.min(1, Math.max(0, share)) * (BOTTOM - TOP)).toFixed(1);
    const parts = [];
    for (const share of [0, 0.5, 1]) {
      parts.push(svg('line', { class: 'grid-line', x1: LEFT, x2: RIGHT, y1: y(share), y2: y(share) }));
      parts.push(svg('text', { x: LEFT - 4, y: +y(share) + 3.5, 'text-anchor': 'end' }, share));
      parts.push(svg('text', { x: RIGHT + 4, y: +y(share) + 3.5 }, share * most));
    }
    parts.push(svg('text', { x: LEFT, y: 147 }, `${SECONDS} s ago`), svg('text', { x: RIGHT, y: 147, 'text-anchor': 'end' }, 'now'));
    // A line breaks where a value is unknown.
    const runs = (known) => this.#points.reduce((runs, p) => {
      if (!known(p)) runs.push([]);
      else runs.at(-1).push(p);
      return runs;
    }, [[]]).filter((run) => run.length > 1);
    for (const run of runs((p) => p.exposure !== undefined)) {
      const [low, high] = [0, 1].map((i) => run.map((p) => `${x(p.time)},${y(p.interval[i])}`));
      parts.push(svg('polygon', { class: 'band', points: [...low, ...high.reverse()].join(' ') }));
      parts.push(svg('polyline', { class: 'exposure', points: run.map((p) => `${x(p.time)},${y(p.exposure)}`).join(' ') }));
    }
    for (const run of runs((p) => p.noise !== undefined)) {
      parts.push(svg('polyline', { class: 'noise', points: run.map((p) => `${x(p.time)},${y(p.noise / most)}`).join(' ') }));
    }
    this.#element.replaceChildren(...parts);
  }
}
