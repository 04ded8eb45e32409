// The checks of tools/check-study.sh: check.mjs WORK BROWSER SHOTS.
import { mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';

const [work, browserPath, shots] = process.argv.slice(2);
mkdirSync(shots, { recursive: true });
const { chromium } = createRequire(join(work, 'package.json'))('playwright-core');
const address = pathToFileURL(join(work, 'kit/questionnaire.html')).href;
const orders = JSON.parse(readFileSync(join(work, 'kit/orders.json'), 'utf8'));

let failed = 0;
function check(ok, text) {
    console.log(`${ok ? 'ok    ' : 'FAILED'}  ${text}`);
    failed += !ok;
}

const browser = await chromium.launch({ executablePath: browserPath, args: ['--no-sandbox'] });
const screens = {
    phone: { viewport: { width: 400, height: 800 }, hasTouch: true, isMobile: true, deviceScaleFactor: 2 },
    desktop: { viewport: { width: 1200, height: 800 }, colorScheme: 'dark' },
};
const names = Object.keys(orders);

for (const [screen, options] of Object.entries(screens)) {
    const context = await browser.newContext({ ...options, acceptDownloads: true });
    const page = await context.newPage();
    const requests = [];
    const errors = [];
    page.on('request', (r) => { if (!/^(file|blob|data):/.test(r.url())) requests.push(r.url()); });
    page.on('pageerror', (e) => errors.push(e.message));
    const shot = (name) => page.screenshot({ path: join(shots, `${screen}-${name}.png`) });
    const press = (id) => (options.hasTouch ? page.tap(id) : page.click(id));
    const participant = names[screen === 'phone' ? 0 : 2];
    const open = async () => {
        await page.goto(`${address}?participant=${encodeURIComponent(participant)}`);
        check((await page.inputValue('#participant')) === participant, `${screen}: the address names the participant`);
        if (await page.isHidden('#trial')) await shot('start');
        await press('#begin button');
    };
    await open();
    const total = orders[participant].length;
    const given = [];
    let partial = false;
    while (given.length < total) {
        if (await page.isVisible('#part')) {
            if (given.length === 0) await shot('part');
            await press('#go');
        }
        await page.waitForSelector('#stimulus > *');
        // Each stimulus must really be shown.
        await page.waitForFunction(() => {
            const e = document.querySelector('#stimulus > *');
            return e.tagName === 'IMG' ? e.complete && e.naturalWidth > 0 : e.readyState >= 2 && e.videoWidth > 0;
        });
        if (given.length === 0 || given.length === total - 1) await shot(`trial-${given.length}`);
        const text = await page.evaluate(() => document.querySelector('main').innerText);
        if (/naive|ours|real\b/i.test(text)) check(false, `${screen}: a method is named: ${text}`);
        const yes = given.length % 3 !== 0;
        if (options.hasTouch) await press(yes ? '#yes' : '#no');
        else await page.keyboard.press(yes ? 'y' : 'n');
        given.push(yes ? 'yes' : 'no');
        if (given.length === 5 && !partial) {
            // A page that is loaded again goes on with the next question.
            partial = true;
            await open();
            const progress = await page.isVisible('#trial') ? await page.innerText('#progress') : '';
            check(progress === `6 of ${total}`, `${screen}: goes on after a reload (${progress})`);
        }
    }
    await page.waitForSelector('#end:not([hidden])');
    await shot('end');
    const [download] = await Promise.all([page.waitForEvent('download'), press('#download')]);
    const csv = readFileSync(await download.path(), 'utf8');
    check(csv === (await page.inputValue('#csv')), `${screen}: the file is the text beside it`);
    const order = await page.evaluate(() => trials);
    check(JSON.stringify(order) === JSON.stringify(orders[participant]), `${screen}: the order is that of the library`);
    const answers = [...csv.matchAll(/"(yes|no)","[\d.]+","\d+"$/gm)].map((m) => m[1]);
    check(JSON.stringify(answers) === JSON.stringify(given), `${screen}: every answer is in the file`);
    check(requests.length === 0 && errors.length === 0, `${screen}: no request, no error ${[...requests, ...errors]}`);
    const wide = await page.evaluate(() => document.documentElement.scrollWidth > window.innerWidth);
    check(!wide, `${screen}: nothing is wider than the screen`);
    writeFileSync(join(work, `answers-${screen}.csv`), csv);
    await context.close();
}

// Without storage, the page works and says that it does not save.
{
    const context = await browser.newContext();
    await context.addInitScript(() => {
        Object.defineProperty(window, 'localStorage', { get() { throw new Error('no storage'); } });
    });
    const page = await context.newPage();
    await page.goto(`${address}?participant=${encodeURIComponent('=1+1')}`);
    check((await page.inputValue('#participant')) === 'p=1+1', 'a name that a spreadsheet takes for a formula is changed');
    await page.click('#begin button');
    await page.click('#go');
    await page.click('#yes');
    check(await page.isVisible('#unsaved'), 'without storage, a warning is shown');
    await page.click('#export');
    check((await page.inputValue('#csv')).split('\n').length === 3, 'answers can be exported at any time');
    await context.close();
}
await browser.close();
process.exit(failed ? 1 : 0);
