// Compares two files of cameras, a JSON line each: every number may differ by 1e-4 of the larger of itself and 1.
//
//   node test/same.mjs A B
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';

const TOLERANCE = 1e-4;

/** The largest difference of two values, and where it is. */
export function apart(a, b, place = '') {
  if (typeof a === 'number' && typeof b === 'number') {
    return { by: Math.abs(a - b) / Math.max(1, Math.abs(a), Math.abs(b)), place };
  }
  if (a && b && typeof a === 'object' && typeof b === 'object') {
    const keys = new Set([...Object.keys(a), ...Object.keys(b)]);
    let worst = { by: 0, place };
    for (const key of keys) {
      const found = apart(a[key], b[key], `${place}/${key}`);
      if (found.by > worst.by) worst = found;
    }
    return worst;
  }
  // A reason names numbers, of which the last digit may differ.
  const words = (v) => (typeof v === 'string' ? v.replace(/[-+0-9.e]+/g, '#') : v);
  return { by: words(a) === words(b) ? 0 : Infinity, place };
}

const [a, b] = process.argv.slice(2).map((file) => readFileSync(file, 'utf8').trim().split('\n').map(JSON.parse));
assert.ok(a.length > 2 && a.length === b.length, `${a.length} and ${b.length} cameras`);
const parts = (cameras, part) => cameras.map((c) => c[part]);
const worst = {};
for (const part of ['noise', 'motion_blur', 'sharpening', 'defocus']) worst[part] = apart(parts(a, part), parts(b, part));
// Negative control: another frame's camera is another one.
const last = a.length - 1;
assert.ok(apart(a[last], a[last - 1]).by > TOLERANCE);
for (const [part, { by, place }] of Object.entries(worst)) {
  console.log(`${part}: ${a.length} cameras differ by up to ${by.toExponential(1)}, at ${place}`);
  assert.ok(by <= TOLERANCE, part);
}
