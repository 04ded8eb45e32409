// The page stands: memory stays flat, and it goes on after a crash of its worker, a lost device, a webcam that was unplugged and a hidden tab.
//
//   node test/soak.mjs WEBCAM.y4m [MINUTES [GPU]]     # by default 30 minutes; GPU: never or always
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { resolve } from 'node:path';
import { open, serve, watched } from './chromium.mjs';

const [webcam, minutes = '30', gpu = 'never'] = process.argv.slice(2);
const server = await serve({ port: 0 });
const browser = await open({ webcam: resolve(webcam) });
const { page, bad } = await watched(browser, `http://localhost:${server.address().port}/demo/?gpu=${gpu}`);
// What the test itself keeps must not grow.
await page.evaluate(() => {
  window.count = 0;
  addEventListener('blindaug-frame', () => {
    window.count += 1;
    window.seen.length = 0;
  });
});
await page.click('#start');

/** Resident memory of this browser's processes that run pages, MB. */
function memory() {
  const all = execFileSync('ps', ['-eo', 'pid,ppid,rss,args']).toString().trim().split('\n').map((l) => l.trim().split(/\s+/));
  const own = new Set([String(process.pid)]);
  for (let grew = true; grew; ) {
    grew = false;
    for (const [pid, parent] of all) if (own.has(parent) && !own.has(pid)) grew = own.add(pid) && true;
  }
  return all.filter(([pid, , , ...args]) => own.has(pid) && args.includes('--type=renderer')).reduce((sum, [, , rss]) => sum + Number(rss) / 1024, 0);
}

const events = [
  ['the worker crashes', () => page.evaluate(() => window.blindaug.breakDown('worker'))],
  ['the device is lost', () => page.evaluate(() => window.blindaug.breakDown('device'))],
  ['the tab is hidden and shown', async () => {
    const other = await page.context().newPage();
    await other.bringToFront();
    await page.waitForTimeout(5000);
    await other.close();
    await page.bringToFront();
  }],
  ['the webcam is unplugged and plugged in', async () => {
    await page.evaluate(() => {
      const { track } = window.blindaugSource();
      track.stop();
      track.dispatchEvent(new Event('ended'));
    });
    await page.waitForTimeout(2000);
    await page.evaluate(() => navigator.mediaDevices.dispatchEvent(new Event('devicechange')));
  }],
];
const start = Date.now();
const passed = () => (Date.now() - start) / 60_000;
const seen = [];
let next = 0;
let last = 0;
while (passed() < Number(minutes)) {
  await page.waitForTimeout(30_000);
  const frames = await page.evaluate(() => window.count);
  seen.push([passed(), memory(), frames]);
  console.log(`${passed().toFixed(1)} min: ${memory().toFixed(0)} MB, ${frames} frames`);
  assert.ok(frames > last, 'it stands still');
  last = frames;
  // One event every two and a half minutes, in the first half: then memory has time to be flat.
  if (passed() < 0.6 * Number(minutes) && passed() > 2.5 * (next + 1)) {
    const [name, happen] = events[next % events.length];
    console.log(`  ${name}`);
    await happen();
    next += 1;
  }
}
await browser.close();
server.close();
const middle = (from, to) => {
  const part = seen.filter(([t]) => t >= from * Number(minutes) && t <= to * Number(minutes)).map(([, m]) => m).sort((a, b) => a - b);
  return part[part.length >> 1];
};
const [early, late] = [middle(0.2, 0.4), middle(0.8, 1)];
console.log(`memory ${early.toFixed(0)} MB early, ${late.toFixed(0)} MB late; ${last} frames; ${next} events`);
assert.ok(late < 1.15 * early, 'memory grows');
assert.deepEqual(bad.filter((b) => !/it was asked to|device/i.test(b)), []);
