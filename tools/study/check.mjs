// The participants of tools/check-study.sh: check.mjs WORK BROWSER SHOTS EXAMPLE.
import { execFileSync } from 'node:child_process';
import { readFile, writeFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';

const [work, browserPath, shots, example] = process.argv.slice(2);
const { chromium } = createRequire(join(work, 'package.json'))('playwright-core');
const PAGE = join(work, 'kit', 'questionnaire.html');
const orders = JSON.parse(await readFile(join(work, 'kit', 'orders.json'), 'utf8'));
const html = await readFile(PAGE, 'utf8');
const kit = JSON.parse(html.match(/<script id="kit"[^>]*>(.*?)<\/script>/s)[1]);

let failed = 0;
function check(ok, text) {
    console.log(`${ok ? 'ok    ' : 'FAILED'}  ${text}`);
    failed += !ok;
}

const browser = await chromium.launch({ executablePath: browserPath, args: ['--no-sandbox'] });
const said = [];
const requests = [];

async function open(options, { file = PAGE, id, before } = {}) {
    const context = await browser.newContext({ acceptDownloads: true, ...options });
    context.on('request', (r) => requests.push(r.url()));
    const page = await context.newPage();
    page.on('pageerror', (e) => said.push(String(e)));
    page.on('console', (m) => ['error', 'warning'].includes(m.type()) && said.push(m.text()));
    page.on('dialog', (d) => d.accept());
    if (before) await page.addInitScript(before);
    await page.goto(`${pathToFileURL(file)}${id === undefined ? '' : `?participant=${encodeURIComponent(id)}`}`);
    return page;
}

/** Yes to every third question. */
const isYes = (position) => position % 3 === 0;

/** Answers the question that is shown; whether it could be answered. */
async function answer(page, position, keyboard) {
    await page.waitForFunction(() => !document.getElementById('yes').disabled || !document.getElementById('broken').hidden);
    if (await page.locator('#broken').isVisible()) {
        await page.click('#skip');
        return false;
    }
    if (keyboard) await page.keyboard.press(isYes(position) ? 'y' : 'n');
    else await page.locator(isYes(position) ? '#yes' : '#no').click();
    return true;
}

/** All that is visible: nothing is clipped, and the method is not told. */
async function look(page, name) {
    await page.waitForTimeout(500);
    await page.screenshot({ path: join(shots, `${name}.png`) });
    const seen = await page.evaluate(() => ({
        wide: document.documentElement.scrollWidth > innerWidth,
        high: document.documentElement.scrollHeight > innerHeight,
        text: document.body.innerText + [...document.querySelectorAll('main *')]
            .flatMap((e) => ['alt', 'title', 'aria-label', 'src'].map((a) => e.getAttribute(a))).join(' '),
    }));
    check(!seen.wide, `${name}: nothing is wider than the page`);
    return seen;
}

/** The rows of exported answers as they should be. */
function expected(id, order, skipped) {
    return order.flatMap((i, position) => {
        const s = kit.stimuli[i];
        return skipped.has(position) ? [] : [[id, s.task, s.scene, s.method, isYes(position)]];
    });
}

async function read(text, name) {
    const path = join(work, `${name}.csv`);
    await writeFile(path, text);
    return JSON.parse(execFileSync(example, [path], { encoding: 'utf8', stdio: ['ignore', 'pipe', 'ignore'] }));
}
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** A participant who answers everything, and reloads in the middle; the exported text. */
async function participate(name, options, { id, typed, keyboard }) {
    const page = await open(options, { id: typed === undefined ? id : undefined });
    if (typed !== undefined) await page.fill('#participant', typed);
    else check((await page.inputValue('#participant')) === id, `${name}: the address presets the participant's id`);
    await look(page, `${name}_start`);
    await page.click('#begin button');
    const skipped = new Set();
    const total = kit.stimuli.length;
    for (let position = 0; position < total; position++) {
        if (await page.locator('#break').isVisible()) {
            check(kit.stimuli[orders[id][position - 1]].task === 'identification', `${name}: a break stands between the tasks`);
            await look(page, `${name}_break`);
            await page.click('#go-on');
        }
        const progress = await page.textContent('#progress');
        if (progress !== `${position + 1} of ${total}`) check(false, `${name}: "${progress}" at question ${position + 1}`);
        if (position === 0 || position === total - 3) {
            const seen = await look(page, `${name}_question${position + 1}`);
            check(!seen.high, `${name}: question ${position + 1} needs no scrolling`);
            check(!/Ours|Naive|pasted|scene/.test(seen.text), `${name}: neither method nor scene is told`);
            const size = await page.evaluate(() => {
                const e = document.querySelector('#stage > *');
                const box = e.getBoundingClientRect();
                return { video: e.tagName === 'VIDEO', playing: e.paused === false, dots: box.width * devicePixelRatio, natural: e.naturalWidth || e.videoWidth,
                    ratio: box.width / box.height / ((e.naturalWidth || e.videoWidth) / (e.naturalHeight || e.videoHeight)) };
            });
            check(size.natural > 0 && size.dots <= size.natural + 0.5 && Math.abs(size.ratio - 1) < 0.01,
                `${name}: ${size.natural} px are shown on ${size.dots.toFixed(0)} px of the screen, at their aspect`);
            if (size.video) check(size.playing, `${name}: the clip plays`);
        }
        if (position === 4) {
            await page.reload();
            check(/go on at question 5/.test(await page.textContent('#begin button')), `${name}: a reloaded page goes on where it was`);
            await page.click('#begin button');
        }
        if (!(await answer(page, position, keyboard))) skipped.add(position);
    }
    check(skipped.size === 1, `${name}: the clip that cannot be played can be left out`);
    const end = await look(page, `${name}_export`);
    check(!/Ours|Naive/.test(end.text), `${name}: the end does not tell the methods unless it is asked to`);
    await page.click('#as-text summary');
    await look(page, `${name}_text`);
    const text = await page.inputValue('#csv');
    const [download] = await Promise.all([page.waitForEvent('download'), page.click('#save')]);
    check((await readFile(await download.path(), 'utf8')) === text, `${name}: ${download.suggestedFilename()} holds the text that is shown`);
    const { rows, notes } = await read(text, name);
    check(same(rows, expected(id, orders[id], skipped)), `${name}: read_answers has the answers of ${JSON.stringify(id)} in Rust's order`);
    check(notes.length === 0, `${name}: read_answers has nothing to remark`);
    check(!same(rows, expected(id, orders[id === 'p7' ? "'=cmd|' /C calc'!A0" : 'p7'], skipped)), `${name}: another participant's order is told from it`);
    const seconds = text.match(/,(yes|no),[0-9]+\.[0-9]{2},[0-9]+\n/g) ?? [];
    check(seconds.length === rows.length, `${name}: every row has seconds and a position`);
    await page.click('#export [data-do=anew]');
    const left = await page.evaluate((id) => Object.keys(localStorage).filter((k) => k.endsWith(`:${id}`)), id);
    check((await page.locator('#start').isVisible()) && left.length === 0, `${name}: starting anew removes the answers`);
    await page.context().close();
    return { text, skipped };
}

try {
    const phone = { viewport: { width: 400, height: 800 }, hasTouch: true, isMobile: true, deviceScaleFactor: 3 };
    const { text, skipped } = await participate('phone', phone, { id: 'p7' });
    await participate('desktop', { viewport: { width: 1200, height: 800 }, colorScheme: 'dark' },
        { id: "'=cmd|' /C calc'!A0", typed: " =cmd|' /C calc'!A0", keyboard: true });
    await participate('quotes', { viewport: { width: 800, height: 400 } }, { id: 'Zo\u00eb, "\u{1f993}" \'', typed: '  Zoe\u0308,\u2003"\u{1f993}" \'\u0000' });

    // Answers that contradict each other, and rows that are torn, are not taken.
    for (const [what, broken] of [['contradicting', text + text.split('\n')[1].replace(/,(yes|no),/, (a) => (a === ',yes,' ? ',no,' : ',yes,')) + '\n'], ['torn', text.slice(0, -20)]]) {
        let refused = false;
        try { await read(broken, what); } catch { refused = true; }
        check(refused, `${what} answers are refused`);
    }

    // A page with another seed has another order, which the comparison must notice.
    const other = join(work, 'other.html');
    await writeFile(other, html.replace(`"seed":"${kit.seed}"`, '"seed":"1"'));
    const page = await open(phone, { file: other, id: 'p7' });
    await page.click('#begin button');
    for (let position = 0; position < 6; position++) await answer(page, position);
    await page.click('summary');
    await look(page, 'menu');
    await page.click('#menu [data-do=export]');
    const { rows } = await read(await page.inputValue('#csv'), 'other');
    check(rows.length === 6 && !same(rows, expected('p7', orders.p7, skipped).slice(0, 6)), 'the order of another seed is told from it');
    await page.click('#back');
    check((await page.textContent('#progress')) === '7 of 19', 'the export leads back to the questions');
    await page.context().close();

    // Without storage.
    const bare = await open({ viewport: { width: 800, height: 400 } }, {
        id: `${'x'.repeat(500)}\n"`,
        before: () => Object.defineProperty(window, 'localStorage', { get() { throw new Error('denied'); } }),
    });
    check(await bare.locator('#unsaved').isVisible(), 'a browser without storage is warned of');
    await bare.click('#begin button');
    for (let position = 0; position < 3; position++) await answer(bare, position);
    await look(bare, 'without_storage');
    await bare.click('summary');
    await bare.click('#menu [data-do=export]');
    const long = await read(await bare.inputValue('#csv'), 'bare');
    check(long.rows.length === 3 && long.rows[0][0] === 'x'.repeat(64), 'it exports all the same, and a long id is cut');
    await bare.context().close();

    const outside = requests.filter((r) => !/^(file|blob|data):/.test(r));
    check(requests.length > 0 && outside.length === 0, `of ${requests.length} requests none leaves the machine`);
    check(said.length === 0, `the browser said nothing${said.length ? `: ${[...new Set(said)].join('; ')}` : ''}`);
} finally {
    await browser.close();
}
console.log(failed ? `${failed} checks failed` : `all checks passed; screenshots are in ${shots}`);
process.exitCode = failed ? 1 : 0;
