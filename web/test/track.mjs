// Tracks frames of raw bytes R, G, B, A in WebAssembly, as crates/blindaug-pipeline/examples/track_raw.rs does natively.
//
//   node test/track.mjs FILE WIDTH HEIGHT [MODULE]     # MODULE: wasm (with SIMD) or wasm-plain
import { readFileSync } from 'node:fs';

const [file, w, h, kind = 'wasm'] = process.argv.slice(2);
const [width, height] = [Number(w), Number(h)];
const folder = new URL(`../${kind}/`, import.meta.url);
const module = await import(new URL('blindaug.js', folder));
module.initSync({ module: readFileSync(new URL('blindaug_bg.wasm', folder)) });
const bytes = readFileSync(file);
const tracker = new module.FrameTracker(undefined, false);
const times = [];
// What starts a tracker and its code costs more than what goes on: from the 60th frame on, where there are so many.
let processor = process.cpuUsage();
const size = 4 * width * height;
const lines = [];
for (let i = 0; (i + 1) * size <= bytes.length; i++) {
  if (i === 60) {
    processor = process.cpuUsage();
    times.length = 0;
  }
  const start = performance.now();
  const line = tracker.push(i + 1, width, height, bytes.subarray(i * size, (i + 1) * size));
  times.push(performance.now() - start);
  if (line) lines.push(line);
}
const { user, system } = process.cpuUsage(processor);
lines.push(tracker.finish());
console.log(lines.join('\n'));
times.sort((a, b) => a - b);
console.error(`${times[times.length >> 1].toFixed(1)} ms, of the processor ${((user + system) / 1e3 / times.length).toFixed(1)} ms`);
