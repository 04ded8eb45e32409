// The page: what it shows, what the canvas holds beside the reference, keys, recording, exports, and everything that goes wrong.
//
//   node test/page.mjs WEBCAM.y4m [SCREENSHOTS [ONLY]]     # ONLY: a part of a test's name
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { open, serve, shown, watched } from './chromium.mjs';

const [webcam, shots, only] = process.argv.slice(2);
const server = await serve({ port: 0 });
const url = `http://localhost:${server.address().port}/demo/`;
const work = mkdtempSync(join(tmpdir(), 'blindaug-page-'));
process.on('exit', () => rmSync(work, { recursive: true, force: true }));
const trouble = (page) => page.evaluate(() => (document.getElementById('trouble').hidden ? '' : document.getElementById('trouble').textContent));
const saysOf = async (page, pattern) => {
  await page.waitForFunction((p) => new RegExp(p).test(document.getElementById('trouble').textContent), pattern, { timeout: 60_000 });
  return trouble(page);
};
const more = async (page, n) => shown(page, (await page.evaluate(() => window.seen.length)) + n, 240_000);
/** Waits until what was under way when the page was paused has been shown: on a busy machine a picture takes several seconds. */
const settled = async (page) => {
  const count = () => page.evaluate(() => window.seen.length);
  let before;
  do {
    before = await count();
    await page.waitForTimeout(12_000);
  } while ((await count()) > before);
};
/**
 * The root mean square of the difference of what the canvas holds right of the line and the reference, in [0, 1], over the whole frame, and over the
 * object: the pixels in which the reference's two halves differ.
 */
const apart = (page, half) => page.evaluate(async (half) => {
  const canvas = document.getElementById('picture');
  const { width, height } = canvas;
  const reference = await window.blindaug.reference();
  const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);
  const below = 4 * width * height;
  const [all, object] = [{ sum: 0, n: 0 }, { sum: 0, n: 0 }];
  for (let i = 0; i < below; i += 4) {
    // The line itself is no part of the canvas.
    const at = half === 'pasted' ? i : below + i;
    const squares = [0, 1, 2].reduce((sum, c) => sum + ((data[i + c] - reference.data[at + c]) / 255) ** 2, 0);
    const differ = [0, 1, 2].some((c) => Math.abs(reference.data[i + c] - reference.data[below + i + c]) > 2);
    for (const of of differ ? [all, object] : [all]) {
      of.sum += squares;
      of.n += 3;
    }
  }
  return { frame: Math.sqrt(all.sum / all.n), object: object.n > 300 ? Math.sqrt(object.sum / object.n) : NaN };
}, half);
const both = ({ frame, object }) => `${frame.toFixed(4)} and ${object.toFixed(4)}`;

const results = [];
const test = async (name, body) => {
  if (only && !name.includes(only)) return;
  try {
    const said = await body();
    results.push(`ok    ${name}${said ? `: ${said}` : ''}`);
  } catch (e) {
    results.push(`FAIL  ${name}: ${e.message.split('\n').slice(0, 4).join(' | ')}`);
    process.exitCode = 1;
  }
  console.log(results.at(-1));
};

for (const gpu of ['never', 'always']) {
  await test(`first picture, canvas beside the reference, keys, screenshots, ?gpu=${gpu}`, async () => {
    const browser = await open({ webcam: resolve(webcam) });
    const { page, bad, bytes } = await watched(browser, `${url}?gpu=${gpu}`, { viewport: { width: 1440, height: 900 } });
    const start = Date.now();
    await page.evaluate(() => document.getElementById('start').addEventListener('click', () => (window.clicked = performance.now())));
    await page.click('#start');
    await shown(page, 1);
    const composited = Date.now() - start;
    const first = await page.evaluate(() => Math.round(performance.getEntriesByName('first picture')[0].startTime - window.clicked));
    // A program that plays a graphics card takes seconds for a picture.
    await shown(page, gpu === 'never' ? 12 : 3, 240_000);
    // Without noise, which device and processor draw from other random numbers.
    await page.evaluate(() => document.querySelector('.settings').setAttribute('open', ''));
    await page.uncheck('#noise');
    await more(page, 2);
    await page.click('#pause');
    await settled(page);
    await page.keyboard.press('Home');
    const filmed = await apart(page, 'filmed');
    // Negative control: the pasted object is another picture.
    const control = await apart(page, 'pasted');
    await page.keyboard.press('End');
    const pasted = await apart(page, 'pasted');
    const by = await page.evaluate(() => window.seen.at(-1).by);
    assert.equal(by, gpu === 'never' ? 'processor' : 'webgpu');
    // Half a step of 8 bits on either side, and the tolerance of the passes (docs/gpu.md).
    assert.ok(filmed.frame < 0.004 && pasted.frame < 0.004, `${filmed.frame} ${pasted.frame}`);
    // The object is a small part of the frame, and what is pasted has hard edges, which device and processor sample at other places. To that the
    // passes add their tolerance, over the object alone.
    const most = Math.hypot(pasted.object, 0.0035);
    assert.ok(filmed.object < most && pasted.object < 0.01, `${filmed.object} ${pasted.object}`);
    assert.ok(control.object > 2 * most, `${control.object}`);
    await page.focus('#line');
    await page.keyboard.press('Home');
    for (let i = 0; i < 5; i++) await page.keyboard.press('Shift+ArrowRight');
    assert.equal(await page.getAttribute('#line', 'aria-valuenow'), '50');
    const before = await page.getAttribute('#pause', 'aria-pressed');
    await page.keyboard.press('Space');
    assert.notEqual(await page.getAttribute('#pause', 'aria-pressed'), before);
    await more(page, 1);
    if (shots) {
      for (const [width, height] of [[360, 740], [768, 1024], [1440, 900]]) {
        for (const colorScheme of ['light', 'dark']) {
          await page.emulateMedia({ colorScheme });
          await page.setViewportSize({ width, height });
          await page.waitForTimeout(300);
          await page.screenshot({ path: join(shots, `page-${gpu}-${width}-${colorScheme}.png`), fullPage: width < 1000 });
          assert.ok((await page.evaluate(() => document.documentElement.scrollWidth)) <= width);
        }
      }
    }
    // This test itself reads the canvas.
    assert.deepEqual(bad.filter((b) => !b.includes('willReadFrequently')), []);
    const wire = bytes();
    assert.ok(wire < 4e6, `${wire} bytes`);
    await browser.close();
    assert.ok(first < 2000, `the first picture came after ${first} ms`);
    return `first picture after ${first} ms, with the object after ${composited} ms, ${(wire / 1e6).toFixed(2)} MB, apart over frame and object by ${both(filmed)} (pasted ${both(pasted)}, control ${both(control)})`;
  });
}

await test('recording, camera.json and exports', async () => {
  const browser = await open({ webcam: resolve(webcam) });
  const { page, bad } = await watched(browser, `${url}?gpu=never`);
  await page.click('#start');
  await shown(page, 8);
  const saved = async (click) => {
    const waiting = page.waitForEvent('download', { timeout: 60_000 });
    await click();
    const download = await waiting;
    const path = join(work, download.suggestedFilename());
    await download.saveAs(path);
    return path;
  };
  const camera = JSON.parse(readFileSync(await saved(() => page.click('#saveCamera'))));
  assert.equal(camera.format, 'blindaug-camera');
  await page.selectOption('#target', 'all');
  const zip = await saved(() => page.click('#saveExport'));
  const list = execFileSync('python3', ['-m', 'zipfile', '-l', zip]).toString();
  execFileSync('python3', ['-m', 'zipfile', '-t', zip]);
  assert.ok(list.includes('three/blindaug_camera.js') && list.includes('blender/'), list);
  await page.click('#record');
  await more(page, 8);
  await page.waitForTimeout(1500);
  const video = await saved(() => page.click('#record'));
  const size = execFileSync('ffprobe', ['-v', 'error', '-count_frames', '-show_entries', 'stream=width,height,nb_read_frames', '-of', 'csv=p=0', video]).toString().trim();
  assert.match(size, /^\d+,\d+,\d+$/);
  assert.deepEqual(bad, []);
  await browser.close();
  return `recorded ${size} (width, height, frames)`;
});

await test('a worker that crashes, a device that is lost, a hidden tab', async () => {
  const browser = await open({ webcam: resolve(webcam) });
  const { page } = await watched(browser, `${url}?gpu=always`);
  await page.click('#start');
  await shown(page, 4);
  await page.evaluate(() => window.blindaug.breakDown('device'));
  const device = await saysOf(page, 'starting again');
  await more(page, 3);
  await page.evaluate(() => window.blindaug.breakDown('worker'));
  const worker = await saysOf(page, 'began anew');
  await more(page, 3);
  const other = await page.context().newPage();
  await other.bringToFront();
  await page.waitForTimeout(3000);
  await page.bringToFront();
  await more(page, 3);
  await browser.close();
  return `${device} ${worker}`;
});

await test('a webcam that is unplugged', async () => {
  const browser = await open({ webcam: resolve(webcam) });
  const { page, bad } = await watched(browser, `${url}?gpu=never`);
  await page.click('#start');
  await shown(page, 3);
  await page.evaluate(() => {
    const track = window.blindaugSource().track;
    track.stop();
    track.dispatchEvent(new Event('ended'));
  });
  const said = await saysOf(page, 'unplugged');
  await page.evaluate(() => navigator.mediaDevices.dispatchEvent(new Event('devicechange')));
  await more(page, 3);
  assert.equal(await trouble(page), '');
  assert.deepEqual(bad, []);
  await browser.close();
  return said;
});

await test('no permission, no camera', async () => {
  const browser = await open({ deny: true });
  const { page, bad } = await watched(browser, url);
  await page.click('#start');
  const said = await saysOf(page, 'camera');
  assert.deepEqual(bad, []);
  await page.evaluate(() => {
    navigator.mediaDevices.getUserMedia = () => Promise.reject(new DOMException('', 'NotAllowedError'));
  });
  await page.click('#start');
  const denied = await saysOf(page, 'allow it');
  await browser.close();
  return `${said} ${denied}`;
});

await test('clips: one that plays and starts again, one of a codec that the browser lacks, one that is no video', async () => {
  const good = join(work, 'good.webm');
  execFileSync('ffmpeg', ['-v', 'error', '-y', '-i', webcam, '-frames:v', '10', '-c:v', 'libvpx', '-b:v', '4M', '-deadline', 'realtime', good]);
  const hevc = join(work, 'hevc.mp4');
  execFileSync('ffmpeg', ['-v', 'error', '-y', '-f', 'lavfi', '-i', 'testsrc=s=320x240:r=10:d=1', '-c:v', 'mpeg4', '-vtag', 'mp4v', hevc]);
  const text = join(work, 'text.mp4');
  writeFileSync(text, 'this is no video');
  const browser = await open({});
  const { page, bad } = await watched(browser, `${url}?gpu=never`);
  await page.setInputFiles('#clip', text);
  const none = await saysOf(page, 'text.mp4');
  await page.setInputFiles('#clip', hevc);
  const codec = await saysOf(page, 'hevc.mp4');
  await page.setInputFiles('#clip', good);
  await shown(page, 14);
  assert.equal(await trouble(page), '');
  assert.deepEqual(bad.filter((b) => !/Failed to load resource|ERR_/.test(b)), []);
  await browser.close();
  return `${none} ${codec}`;
});

await test('objects: a .glb, a corrupt one, one of 200 MB', async () => {
  const browser = await open({ webcam: resolve(webcam) });
  const { page, bad } = await watched(browser, `${url}?gpu=never`);
  await page.click('#start');
  await shown(page, 3);
  const glb = triangle();
  const corrupt = join(work, 'corrupt.glb');
  writeFileSync(corrupt, glb.subarray(0, 200));
  await page.setInputFiles('#glb', corrupt);
  const said = await saysOf(page, 'corrupt.glb');
  await more(page, 2);
  const large = join(work, 'large.glb');
  execFileSync('truncate', ['-s', '200000000', large]);
  await page.setInputFiles('#glb', large);
  const tooLarge = await saysOf(page, 'large.glb');
  const good = join(work, 'triangle.glb');
  writeFileSync(good, glb);
  const before = await page.evaluate(() => document.getElementById('picture').toDataURL().length);
  await page.setInputFiles('#glb', good);
  await page.waitForFunction(() => !document.getElementById('builtIn').hidden);
  await more(page, 2);
  assert.equal(await trouble(page), '');
  assert.ok(before > 0);
  assert.deepEqual(bad, []);
  await browser.close();
  return `${said} ${tooLarge}`;
});

/** A .glb of one triangle. */
function triangle() {
  const binary = Buffer.from(new Float32Array([0, 0, 0, 1, 0, 0, 0, 1, 0]).buffer);
  let json = JSON.stringify({
    asset: { version: '2.0' }, scene: 0, scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }], meshes: [{ primitives: [{ attributes: { POSITION: 0 } }] }],
    buffers: [{ byteLength: binary.length }], bufferViews: [{ buffer: 0, byteLength: binary.length }],
    accessors: [{ bufferView: 0, componentType: 5126, count: 3, type: 'VEC3', min: [0, 0, 0], max: [1, 1, 0] }],
  });
  json = Buffer.from(json.padEnd(Math.ceil(json.length / 4) * 4));
  const number = (n) => Buffer.from(new Uint32Array([n]).buffer);
  return Buffer.concat([Buffer.from('glTF'), number(2), number(12 + 8 + json.length + 8 + binary.length), number(json.length), Buffer.from('JSON'), json, number(binary.length), Buffer.from('BIN\0'), binary]);
}

server.close();
