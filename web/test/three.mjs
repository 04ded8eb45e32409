// The pass for three.js in Chromium: edges spread and the noise has the std that the camera says.
//
//   node test/three.mjs
import assert from 'node:assert/strict';
import { open, serve, watched } from './chromium.mjs';

const server = await serve({ port: 0 });
const browser = await open();
const { page, bad } = await watched(browser, `http://localhost:${server.address().port}/test/three.html`);
await page.waitForFunction(() => window.ready, undefined, { timeout: 60_000 });

const decoded = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
/** The std of the spread of the edge in the middle row, and the place of the edge, px. */
async function edge(options) {
  const { bytes, size } = await page.evaluate(async (o) => ({ bytes: await window.drawn(o), size: window.size }), options);
  const row = Array.from({ length: size }, (_, x) => decoded(bytes[4 * ((size / 2) * size + x)] / 255));
  const steps = row.slice(1).map((v, i) => Math.max(0, row[i] - v));
  const sum = steps.reduce((a, b) => a + b, 0);
  const mean = steps.reduce((a, v, i) => a + v * (i + 1), 0) / sum;
  return { sum, mean, std: Math.sqrt(steps.reduce((a, v, i) => a + v * (i + 1 - mean) ** 2, 0) / sum) };
}
const near = (got, want, by, what) => assert.ok(Math.abs(got - want) <= by, `${what}: ${got} instead of ${want}`);

const sharp = await edge({});
near(sharp.sum, 1, 0.02, 'the edge');
assert.ok(sharp.std < 0.5, `${sharp.std}`);
for (const [sigma, depth] of [[3, 2], [6, 2], [6, 4]]) {
  // The lens is focused at 1 m.
  const want = sigma * Math.abs(1 - 1 / depth);
  const got = await edge({ sigma, focus: 1, depth });
  near(got.std, want, 0.15 * want + 0.2, `a lens of ${sigma} px at ${depth} m`);
  near(got.mean, sharp.mean, 0.5, 'the edge');
  console.log(`lens: std ${got.std.toFixed(2)} px, should be ${want.toFixed(2)}`);
}
for (const [speed, exposure] of [[12, 0.5], [24, 0.5], [12, 1]]) {
  const want = (speed * exposure) / Math.sqrt(12);
  const got = await edge({ speed, exposure });
  near(got.std, want, 0.15 * want + 0.2, `motion of ${speed} px at exposure ${exposure}`);
  console.log(`motion: std ${got.std.toFixed(2)} px, should be ${want.toFixed(2)}`);
}
// Negative control: without motion there is no streak.
assert.ok((await edge({ exposure: 0.5 })).std < 0.8);

const level = (std) => ({ slope: [0, 0, 0], intercept: std });
/** Std of R, G and B over the covered picture, in [0, 1]. */
async function noise(levels) {
  const bytes = await page.evaluate((o) => window.drawn(o), { light: 0.2, covers: 1, noise: levels });
  return [0, 1, 2].map((c) => {
    const values = bytes.filter((_, i) => i % 4 === c).map((v) => v / 255);
    const mean = values.reduce((a, b) => a + b, 0) / values.length;
    return Math.sqrt(values.reduce((a, v) => a + (v - mean) ** 2, 0) / values.length);
  });
}
const zero = level([0, 0, 0]);
const std = await noise([level([0.02, 0.03, 0.04]), zero, zero, zero]);
std.forEach((s, c) => near(s, [0.02, 0.03, 0.04][c], 0.003, `noise of channel ${c}`));
const silent = await noise(undefined);
assert.ok(silent.every((s) => s < 1e-3), `${silent}`);
console.log(`noise: ${std.map((s) => s.toFixed(4))}, should be 0.02, 0.03, 0.04`);
assert.deepEqual(bad.filter((b) => !/GPU stall|GL Driver/.test(b)), []);
await browser.close();
server.close();
