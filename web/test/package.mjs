// The packed package in an empty project: the README's ten lines run in Chromium, on a fake webcam.
//
//   node test/package.mjs PROJECT WEBCAM.y4m
import assert from 'node:assert/strict';
import { readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { open, serve, watched } from './chromium.mjs';

const [project, webcam] = process.argv.slice(2);
const readme = readFileSync(join(project, 'node_modules/blindaug/README.md'), 'utf8');
const lines = readme.match(/```js\n([\s\S]*?)```/)[1];
writeFileSync(join(project, 'ten-lines.js'), lines);
writeFileSync(
  join(project, 'index.html'),
  `<!doctype html><link rel="icon" href="data:,"><script type="importmap">{ "imports": { "blindaug": "./node_modules/blindaug/js/index.js" } }</script><script type="module" src="ten-lines.js"></script>`,
);
const server = await serve({ port: 0, folder: project });
const browser = await open({ webcam });
const { page, bad } = await watched(browser, `http://localhost:${server.address().port}/index.html`);
const said = [];
page.on('console', (m) => m.type() === 'log' && said.push(m.text()));
const start = Date.now();
while (said.length < 3 && Date.now() - start < 120_000) await page.waitForTimeout(200);
await browser.close();
server.close();
assert.deepEqual(bad, []);
assert.ok(said.length >= 3 && said.every((s) => s.includes('Noise')), said.join('\n'));
console.log(`the README's ten lines said ${said.length} times such as: ${said.at(-1).split('\n')[0]}`);
