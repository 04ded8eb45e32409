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
const url = `http://localhost:${server.address().port}/demo/?gpu=never`;
const covered = { exposure: [], noise: [] };
for (const clip of clips) {
  const truth = JSON.parse(readFileSync(join(folder, `${clip}.json`)));
  const browser = await open({ webcam: resolve(folder, `${clip}.y4m`) });
  const { page, bad } = await watched(browser, url, { viewport: { width: 1280, height: 900 } });
  await page.evaluate(() => (document.getElementById('inWords').open = true));
  await page.click('#start');
  await shown(page, Number(wanted), 300_000);
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
