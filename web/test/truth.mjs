// The page estimates from clips of known truth that a fake webcam plays: do its intervals cover the truth?
//
//   node test/truth.mjs CLIPS [FRAMES [SCREENSHOTS]]     # CLIPS: a folder from `webcam_clips`
import assert from 'node:assert/strict';
import { readFileSync, readdirSync } from 'node:fs';
import { join, resolve } from 'node:path';
import { open, serve, shown, watched } from './chromium.mjs';

const [folder, wanted = '40', shots] = process.argv.slice(2);
const clips = readdirSync(folder).filter((f) => f.endsWith('.y4m')).map((f) => f.slice(0, -4));
const server = await serve({ port: 0 });

/**
 * The root mean square, in steps of 8 bits, by which the webcam's picture differs from that of its planes with Cb and Cr interpolated linearly, as
 * the clips' truth takes it, and with the nearest ones: a negative control.
 */
const delivered = (page) => page.evaluate(async () => {
  const frame = new VideoFrame(window.blindaugSource().video);
  const { codedWidth: w, codedHeight: h, format, colorSpace } = frame;
  // Browsers decide for themselves by which matrix a webcam without a word on it is coded.
  const [kr, kb] = colorSpace.matrix === 'bt709' ? [0.2126, 0.0722] : [0.299, 0.114];
  const planes = new Uint8Array(frame.allocationSize());
  const layout = await frame.copyTo(planes);
  const shown = new Uint8Array(4 * w * h);
  await frame.copyTo(shown, { format: 'RGBA', colorSpace: 'srgb' });
  frame.close();
  const [y, u, v] = layout;
  const step = format === 'NV12' ? 2 : 1;
  const chroma = (c, i, j) => {
    const at = Math.min(h / 2 - 1, Math.max(0, j)) * u.stride + step * Math.min(w / 2 - 1, Math.max(0, i));
    return planes[(step === 2 ? u.offset + c : [u, v][c].offset) + at] - 128;
  };
  const linear = (c, x, j) => {
    const [px, py] = [0.5 * x - 0.25, 0.5 * j - 0.25];
    const [i, k, fx, fy] = [Math.floor(px), Math.floor(py), px - Math.floor(px), py - Math.floor(py)];
    const row = (r) => chroma(c, i, r) * (1 - fx) + chroma(c, i + 1, r) * fx;
    return row(k) * (1 - fy) + row(k + 1) * fy;
  };
  const rms = (of) => {
    let sum = 0;
    for (let j = 0; j < h; j++) {
      for (let x = 0; x < w; x++) {
        const luma = ((planes[y.offset + j * y.stride + x] - 16) * 255) / 219;
        const [cb, cr] = [of(0, x, j), of(1, x, j)].map((c) => (c * 255) / 224);
        const [r, b] = [luma + 2 * (1 - kr) * cr, luma + 2 * (1 - kb) * cb];
        const rgb = [r, (luma - kr * r - kb * b) / (1 - kr - kb), b];
        rgb.forEach((c, k) => (sum += (Math.min(255, Math.max(0, c)) - shown[4 * (j * w + x) + k]) ** 2));
      }
    }
    return Math.sqrt(sum / (3 * w * h));
  };
  return [rms(linear), rms((c, x, j) => chroma(c, x >> 1, j >> 1))];
});
const url = `http://localhost:${server.address().port}/demo/?gpu=never`;
const covered = { exposure: [], noise: [] };
for (const clip of clips) {
  const truth = JSON.parse(readFileSync(join(folder, `${clip}.json`)));
  const browser = await open({ webcam: resolve(folder, `${clip}.y4m`) });
  const { page, bad } = await watched(browser, url, { viewport: { width: 1280, height: 900 } });
  await page.evaluate(() => (document.getElementById('inWords').open = true));
  await page.click('#start');
  await shown(page, Number(wanted), 300_000);
  if (clip === clips[0]) {
    const [linear, nearest] = await delivered(page);
    console.log(`what the browser delivers differs from interpolated Cb and Cr by ${linear.toFixed(2)} steps, from the nearest ones by ${nearest.toFixed(2)}`);
    // Rounding alone is 0.29.
    assert.ok(linear < 0.4 && nearest > 0.4, `${linear} ${nearest}`);
  }
  // What people read, not what the program holds.
  const [rows, words] = await page.evaluate(() => [
    [...document.querySelectorAll('#parameters div')].map((d) => [d.children[0].textContent, d.children[1].textContent]),
    document.getElementById('words').textContent,
  ]);
  if (shots) await page.screenshot({ path: join(shots, `clip-${clip}.png`), fullPage: true });
  await browser.close();
  const exposure = rows.find(([name]) => name === 'exposure')?.[1] ?? '';
  const [, value, low, high] = (exposure.match(/([\d.]+) \[([\d.]+), ([\d.∞]+)\]/) ?? []).map(Number);
  const isIn = (v, lo, hi) => lo <= v && v <= hi;
  // Half of the last digit that is shown.
  if (value !== undefined) covered.exposure.push(isIn(truth.exposure, low - 0.005, high + 0.005));
  const line = words.match(/at luminance 0\.5: (.*)/)?.[1] ?? '';
  const intervals = [...line.matchAll(/([\d.]+) \(([\d.]+) to ([\d.]+)\)/g)].map((m) => m.slice(1).map(Number));
  const noise = intervals.map(([, lo, hi], c) => isIn(truth.noise_steps[c], lo - 0.005, hi + 0.005));
  covered.noise.push(...noise);
  const focus = rows.filter(([name]) => /focus|blur|lens/.test(name)).map((r) => r.join(': ')).join('; ');
  console.log(`${clip}: exposure ${truth.exposure.toFixed(3)}, shown ${exposure}; noise ${truth.noise_steps.map((v) => v.toFixed(2))}, shown ${line}; lens ${JSON.stringify(truth.lens)}, shown ${focus}`);
  assert.deepEqual(bad, [], `clip ${clip}`);
}
server.close();
const share = (list) => `${list.filter(Boolean).length} of ${list.length}`;
console.log(`covered: exposure ${share(covered.exposure)} (${clips.length - covered.exposure.length} unknown), noise ${share(covered.noise)}`);
assert.ok(covered.exposure.length >= 0.7 * clips.length, 'the exposure is unknown too often');
assert.ok(covered.exposure.filter(Boolean).length >= 0.9 * covered.exposure.length - 1e-9, 'exposures lie outside of their intervals');
assert.ok(covered.noise.filter(Boolean).length >= 0.9 * covered.noise.length - 1e-9, 'the noise lies outside of its intervals');
