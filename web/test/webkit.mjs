// The page in WebKit, as Debian's package webkit2gtk-driver has it (the engine of Safari): a clip from a file, then WebKit's own mock of a
// webcam. Needs a display, for example that of xvfb-run.
//
//   node test/webkit.mjs CLIP.webm [SCREENSHOTS]     # WEBKIT: the browser, by default Debian's MiniBrowser
import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { existsSync, writeFileSync } from 'node:fs';
import { join, resolve } from 'node:path';
import { setTimeout as sleep } from 'node:timers/promises';
import { serve } from '../demo/serve.mjs';

const [clip, shots] = process.argv.slice(2);
const binary = process.env.WEBKIT ?? ['x86_64', 'aarch64'].map((a) => `/usr/lib/${a}-linux-gnu/webkit2gtk-4.1/MiniBrowser`).find(existsSync);
const [FRAMES, WAIT] = [40, 240_000];

const server = await serve({ port: 0 });
const port = 4400 + (process.pid % 500);
const driver = spawn('WebKitWebDriver', [`--port=${port}`], { stdio: 'ignore' });
process.on('exit', () => driver.kill());
/** A command of the protocol WebDriver. */
const ask = async (method, path, body) => {
  const answer = await fetch(`http://127.0.0.1:${port}${path}`, { method, body: body && JSON.stringify(body) });
  const { value } = await answer.json();
  if (!answer.ok) throw new Error(`${path}: ${value.message}`);
  return value;
};
for (let tries = 0; tries < 100 && !(await ask('GET', '/status').catch(() => null)); tries++) await sleep(100);

const args = ['--automation', '--enable-media-stream=true', '--enable-mock-capture-devices=true'];
const { sessionId, capabilities } = await ask('POST', '/session', { capabilities: { alwaysMatch: { 'webkitgtk:browserOptions': { binary, args } } } });
const session = `/session/${sessionId}`;
const run = (script) => ask('POST', `${session}/execute/sync`, { script, args: [] });
const element = async (selector) => Object.values(await ask('POST', `${session}/element`, { using: 'css selector', value: selector }))[0];

/** Opens the page, begins, and waits until it has shown so many frames. */
async function shown(what, begin) {
  await ask('POST', `${session}/url`, { url: `http://localhost:${server.address().port}/demo/` });
  await run(`[window.seen, window.bad] = [0, []];
    addEventListener('blindaug-frame', () => window.seen++);
    addEventListener('error', (e) => window.bad.push(e.message));
    addEventListener('unhandledrejection', (e) => window.bad.push(String(e.reason)));`);
  // WebKit says that a page is loaded before its modules are.
  for (let tries = 0; tries < 200 && (await run(`return document.getElementById('start').disabled`)); tries++) await sleep(100);
  await begin();
  const start = performance.now();
  let state;
  do {
    await sleep(500);
    state = await run(`const trouble = document.getElementById('trouble');
      return { seen: window.seen, bad: window.bad, trouble: trouble.hidden ? '' : trouble.textContent, page: document.body.innerText };`);
    assert.deepEqual([state.bad, state.trouble], [[], ''], what);
  } while (state.seen < FRAMES && performance.now() - start < WAIT);
  if (shots) writeFileSync(join(shots, `webkit-${what}.png`), Buffer.from(await ask('GET', `${session}/screenshot`), 'base64'));
  assert.ok(state.seen >= FRAMES, `${what}: ${state.seen} frames after ${WAIT / 1000} s`);
  assert.match(state.page, /noise/i);
  console.log(`ok    ${what}: ${state.seen} frames in ${((performance.now() - start) / 1000).toFixed(1)} s`);
}

try {
  console.log(`${capabilities.browserName} ${capabilities.browserVersion}`);
  await shown('clip', async () => ask('POST', `${session}/element/${await element('#clip')}/value`, { text: resolve(clip) }));
  await shown('webcam', async () => ask('POST', `${session}/element/${await element('#start')}/click`, {}));
} finally {
  await ask('DELETE', session).catch(() => {});
  driver.kill();
  server.close();
}
