// Chromium with WebGPU by a program, as tests use it, and the package's folder served.
import { chromium } from 'playwright-core';
import { serve } from '../demo/serve.mjs';

const GPU = ['--no-sandbox', '--enable-unsafe-webgpu', '--use-angle=swiftshader', '--use-webgpu-adapter=swiftshader', '--enable-features=Vulkan', '--use-vulkan=swiftshader', '--enable-unsafe-swiftshader'];
export const executablePath = process.env.CHROMIUM ?? '/usr/bin/chromium';

/** Opens a browser, whose webcam plays `webcam`, a y4m file, if there is one; `true`: a browser without a camera that is allowed to ask. */
export async function open({ webcam, flags = [], deny = false } = {}) {
  const fake = webcam
    ? ['--use-fake-ui-for-media-stream', '--use-fake-device-for-media-stream', `--use-file-for-fake-video-capture=${webcam}`]
    : [];
  const args = [...GPU, ...fake, ...(deny ? ['--deny-permission-prompts'] : []), ...flags];
  return chromium.launch({ executablePath, ignoreDefaultArgs: ['--disable-gpu'], args });
}

/** A page that notes what a page must not do: errors on the console, and requests that leave the origin. */
export async function watched(browser, url, options = {}) {
  const page = await (await browser.newContext(options)).newPage();
  const bad = [];
  page.on('console', (m) => ['error', 'warning'].includes(m.type()) && bad.push(`${m.type()}: ${m.text()}`));
  page.on('pageerror', (e) => bad.push(`error: ${e.message}`));
  let bytes = 0;
  page.on('request', (r) => !r.url().startsWith(new URL(url).origin) && !/^(blob|data):/.test(r.url()) && bad.push(`left the origin: ${r.url()}`));
  page.on('response', (r) => (bytes += Number(r.headers()['content-length'] ?? 0)));
  await page.addInitScript(() => {
    window.seen = [];
    addEventListener('blindaug-frame', ({ detail: { picture, ...frame } }) => window.seen.push(frame));
  });
  await page.goto(url);
  return { page, bad, bytes: () => bytes };
}

/** Waits until the page has shown so many frames. */
export const shown = (page, frames, timeout = 120_000) =>
  page.waitForFunction((n) => window.seen.length >= n, frames, { timeout, polling: 200 });

export { serve };
