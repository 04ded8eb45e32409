// Tracks frames of raw bytes R, G, B, A in a page that its server isolates, by the build with threads, in Chromium: a camera per line, and the
// median time per frame with one thread and with several.
//
//   node test/threads.mjs FILE WIDTH HEIGHT [THREADS]
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { open, serve, watched } from './chromium.mjs';

const [file, width, height, threads = '2'] = process.argv.slice(2);
const server = await serve({ port: 0, isolated: true });
const browser = await open();
const { page, bad } = await watched(browser, `http://localhost:${server.address().port}/demo/`);
await page.route('**/frames.rgba', (route) => route.fulfill({ body: readFileSync(file), contentType: 'application/octet-stream' }));
const track = (threads) =>
  page.evaluate(
    async ({ width, height, threads }) => {
      const { Tracker } = await import('../js/index.js');
      const bytes = new Uint8Array(await (await fetch('/frames.rgba')).arrayBuffer());
      const size = 4 * width * height;
      const tracker = await Tracker.create({ threads });
      const [lines, times] = [[], []];
      const note = (tracked) => {
        if (!tracked) return;
        lines.push(JSON.stringify({ frame: tracked.frame, ...tracked.camera }));
        times.push(tracked.times.estimate);
      };
      for (let i = 0; (i + 1) * size <= bytes.length; i++) note(await tracker.push({ width, height, data: bytes.slice(i * size, (i + 1) * size) }));
      note(await tracker.finish());
      tracker.close();
      times.sort((a, b) => a - b);
      return { lines, median: times[times.length >> 1], isolated: crossOriginIsolated };
    },
    { width: Number(width), height: Number(height), threads },
  );
const [one, several] = [await track(1), await track(Number(threads))];
await browser.close();
server.close();
assert.ok(one.isolated, 'the page is not isolated');
assert.deepEqual(several.lines, one.lines, 'threads give other cameras');
assert.deepEqual(bad, []);
console.log(several.lines.join('\n'));
console.error(`${one.median.toFixed(1)} ms with one thread, ${several.median.toFixed(1)} ms with ${threads}`);
