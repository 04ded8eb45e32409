// The measurements of tools/check-three.sh: check.mjs WORK BROWSER SHOTS.
import { createServer } from 'node:http';
import { readFile, writeFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { dirname, extname, join, normalize } from 'node:path';
import { fileURLToPath } from 'node:url';
import { inflateSync } from 'node:zlib';

const [work, browserPath, shots] = process.argv.slice(2);
const here = dirname(fileURLToPath(import.meta.url));
const { chromium } = createRequire(join(work, 'package.json'))('playwright-core');

const [WIDTH, HEIGHT, FRAMES] = [512, 320, 8];
const CHANNELS = ['R', 'G', 'B'];

let failed = 0;
function check(ok, text) {
    console.log(`${ok ? 'ok    ' : 'FAILED'}  ${text}`);
    failed += !ok;
}

// --- statistics

const mean = (v) => v.reduce((a, b) => a + b, 0) / v.length;
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const correlation = (a, b) => dot(a, b) / Math.sqrt(dot(a, a) * dot(b, b));

/** The inside of a patch: [index of the pixel, ...] of a picture, the lowest row first. */
function inside({ x, y, w, h, round }) {
    const margin = round ? Math.ceil(0.16 * w) : 2;
    const pixels = [];
    for (let j = y + margin; j < y + h - margin; j++) {
        for (let i = x + margin; i < x + w - margin; i++) pixels.push(j * WIDTH + i);
    }
    return pixels;
}

/** Values of a patch less its mean over the frames, as [frame][channel][pixel], in 8-bit steps; and the means. */
function noiseOf(frames, patch) {
    const pixels = inside(patch);
    const values = frames.map((f) => [0, 1, 2].map((c) => Float64Array.from(pixels, (p) => f[4 * p + c])));
    const means = [0, 1, 2].map((c) => mean(values.map((v) => mean(v[c]))));
    return { means, noise: values.map((v) => v.map((channel, c) => channel.map((x) => x - means[c]))) };
}

function variance(noise, c) {
    const squares = noise.map((frame) => dot(frame[c], frame[c]) / frame[c].length);
    return mean(squares);
}

/** Correlation with the right neighbour and the one above, mean of both. */
function lag1(noise, width) {
    let [sum, count] = [0, 0];
    for (let i = 0; i < noise.length; i++) {
        if ((i + 1) % width) (sum += noise[i] * noise[i + 1]), count++;
        if (i + width < noise.length) (sum += noise[i] * noise[i + width]), count++;
    }
    return sum / count / (dot(noise, noise) / noise.length);
}

// --- files

async function table(folder) {
    const lines = (await readFile(join(work, folder, 'blindaug_grain.csv'), 'utf8')).split('\n').filter((l) => /^[0-9]/.test(l));
    const rows = lines.map((l) => l.split(',').map(Number));
    return (luminance) => {
        const i = Math.min(Math.floor(luminance * (rows.length - 1)), rows.length - 2);
        const t = luminance * (rows.length - 1) - i;
        return [1, 2, 3].map((c) => (1 - t) * rows[i][c] + t * rows[i + 1][c]);
    };
}

/** An 8-bit RGBA PNG without interlace: { width, data }. */
async function png(path) {
    const file = await readFile(path);
    const [width, height] = [file.readUInt32BE(16), file.readUInt32BE(20)];
    if (file[24] !== 8 || file[25] !== 6 || file[28] !== 0) throw new Error(`${path} is no plain RGBA PNG`);
    const parts = [];
    for (let at = 8; at < file.length; at += 12 + file.readUInt32BE(at)) {
        if (file.toString('latin1', at + 4, at + 8) === 'IDAT') parts.push(file.subarray(at + 8, at + 8 + file.readUInt32BE(at)));
    }
    const raw = inflateSync(Buffer.concat(parts));
    const stride = 4 * width;
    const data = new Uint8Array(stride * height);
    for (let y = 0; y < height; y++) {
        const filter = raw[y * (stride + 1)];
        for (let x = 0; x < stride; x++) {
            const a = x >= 4 ? data[y * stride + x - 4] : 0;
            const b = y ? data[(y - 1) * stride + x] : 0;
            const c = x >= 4 && y ? data[(y - 1) * stride + x - 4] : 0;
            const near = [a, b, c].map((v) => Math.abs(a + b - c - v));
            const paeth = near[0] <= near[1] && near[0] <= near[2] ? a : near[1] <= near[2] ? b : c;
            data[y * stride + x] = raw[y * (stride + 1) + 1 + x] + [0, a, b, (a + b) >> 1, paeth][filter];
        }
    }
    return { width, data };
}

// --- the page

const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.png': 'image/png' };
const server = createServer(async (request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url, 'http://localhost').pathname));
    try {
        const body = await readFile(join(path.endsWith('.html') ? here : work, path));
        response.writeHead(200, { 'content-type': TYPES[extname(path)] ?? 'application/octet-stream' }).end(body);
    } catch {
        response.writeHead(404).end();
    }
});
await new Promise((done) => server.listen(0, '127.0.0.1', done));
const browser = await chromium.launch({
    executablePath: browserPath,
    ignoreDefaultArgs: ['--disable-gpu'],
    args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'],
});
const said = [];
async function open(name) {
    const page = await browser.newPage({ viewport: { width: WIDTH, height: HEIGHT } });
    page.on('pageerror', (e) => said.push(String(e)));
    page.on('console', (m) => ['error', 'warning'].includes(m.type()) && said.push(m.text()));
    await page.goto(`http://127.0.0.1:${server.address().port}/${name}.html`);
    await page.waitForFunction(() => window.ready, undefined, { timeout: 60000 });
    return page;
}

async function grain() {
    const page = await open('grain');
    const revision = await page.evaluate(() => window.ready);
    console.log(`three r${revision}, Chromium ${browser.version()}`);
    const grey = [26, 51, 77, 102, 128, 153, 179, 204, 230];
    const patches = grey.map((v, i) => ({ x: 4 + 56 * i, y: 100, w: 54, h: 216, rgb: [v, v, v] }));
    patches.push({ x: 208, y: 2, w: 96, h: 96, rgb: [205, 120, 60], round: true });
    const render = async (folder, frames, pass) => {
        const text = await page.evaluate((a) => window.render(...a), [folder, patches, frames, pass]);
        const bytes = Buffer.from(text, 'base64');
        const size = 4 * WIDTH * HEIGHT;
        return Array.from({ length: frames }, (_, i) => bytes.subarray(i * size, (i + 1) * size));
    };
    const shot = async (name) => {
        await page.screenshot({ path: join(shots, `${name}.png`) });
        console.log(`wrote ${join(shots, `${name}.png`)}`);
    };

    const [clean] = await render('plain', 1, false);
    await shot('without_grain');
    const exact = patches.every((patch) => inside(patch).every((p) => patch.rgb.every((v, c) => clean[4 * p + c] === v)));
    check(exact, 'without the pass every patch has the colour that was meant');

    const frames = await render('plain', FRAMES, true);
    await shot('grain');
    const luminance = ({ rgb: [r, g, b] }) => (0.299 * r + 0.587 * g + 0.114 * b) / 255;
    const measured = patches.map((patch) => noiseOf(frames, patch));

    // The std, without the variance of rounding to 8 bits, relative to the model's.
    const ratios = (wanted) => measured.map(({ noise }, i) => wanted(luminance(patches[i]))
        .map((std, c) => Math.sqrt(Math.max(variance(noise, c) - 1 / 12, 0)) / 255 / std));
    const model = await table('plain');
    const found = ratios(model);
    console.log('std over the model\'s, by patch:');
    found.forEach((r, i) => console.log(`    ${String(patches[i].rgb).padEnd(12)} Y ${luminance(patches[i]).toFixed(3)}  ${r.map((v) => v.toFixed(3)).join('  ')}`));
    const off = (r) => Math.max(...r.flat().map((v) => Math.abs(v - 1)));
    check(off(found) < 0.08, `std of every patch and channel: ${(100 * off(found)).toFixed(1)} % from the model's at most (8)`);
    const other = off(ratios(await table('double')));
    check(other > 0.08, `a camera with twice the noise is told from it: ${(100 * other).toFixed(1)} % off`);

    const shift = Math.max(...measured.flatMap(({ means }, i) => means.map((m, c) => Math.abs(m - patches[i].rgb[c]))));
    check(shift < 0.3, `mean of every patch and channel: ${shift.toFixed(3)} of an 8-bit step off at most (0.3)`);

    // The noise of all patches together, each scaled to std 1.
    const whole = frames.map((_, f) => [0, 1, 2].map((c) => measured.flatMap(({ noise }) => {
        const std = Math.sqrt(variance(noise, c));
        return Array.from(noise[f][c], (v) => v / std);
    })));
    let [worst, pairs] = [0, 0];
    for (let a = 0; a < FRAMES; a++) {
        for (let b = 0; b < a; b++) {
            for (let c = 0; c < 3; c++, pairs++) worst = Math.max(worst, Math.abs(correlation(whole[a][c], whole[b][c])));
        }
    }
    check(worst < 0.05, `noise of different frames: |r| ${worst.toFixed(4)} at most over ${pairs} pairs (0.05)`);
    worst = Math.max(...whole.flatMap((f) => [[0, 1], [0, 2], [1, 2]].map(([a, b]) => Math.abs(correlation(f[a], f[b])))));
    check(worst < 0.05, `noise of different channels: |r| ${worst.toFixed(4)} at most over ${3 * FRAMES} pairs (0.05)`);

    // The tile has the model's spectrum at luminance 0.5.
    const middle = grey.indexOf(128);
    const tile = await png(join(work, 'plain', 'blindaug_grain.png'));
    const lags = CHANNELS.map((_, c) => {
        const values = Float64Array.from({ length: tile.data.length / 4 }, (_, i) => tile.data[4 * i + c]);
        const centre = mean(values);
        const wanted = lag1(values.map((v) => v - centre), tile.width);
        const got = mean(measured[middle].noise.map((f) => lag1(f[c], patches[middle].w - 4)));
        return [got, wanted];
    });
    check(lags.every(([a, b]) => Math.abs(a - b) < 0.05),
        `correlation with the neighbour, as in the grain tile: ${lags.map(([a, b]) => `${a.toFixed(3)} (${b.toFixed(3)})`).join(', ')} (within 0.05)`);

    // 230 / 255 as a half float falls short of the level.
    const pixels = patches.map(inside);
    for (const level of [204, 230]) {
        const clipped = await render(`clip${level}`, FRAMES, true);
        await shot(`grain_clip${level}`);
        const every = (holds) => patches.every((patch, i) =>
            pixels[i].every((p) => clipped.every((f) => [0, 1, 2].every((c) => holds(f[4 * p + c], patch.rgb[c])))));
        check(every((v, was) => was < level || v === was), `clip level ${level}: values at and above it stay as they are`);
        check(every((v, was) => was >= level || v <= level), `clip level ${level}: noise takes no value above it`);
        const below = noiseOf(clipped, patches[middle]).noise;
        const ratio = Math.sqrt(variance(below, 1) - 1 / 12) / 255 / model(128 / 255)[1];
        check(Math.abs(ratio - 1) < 0.08, `clip level ${level}: below it there is noise as before`);
    }

    const silent = await render('silent', 2, true);
    check(silent.every((f) => Buffer.compare(f, clean) === 0), 'with noise unknown the pass changes nothing');
    await page.close();
    return Number(revision);
}

// --- three's own effects

async function effects() {
    const page = await open('effects');
    const size = 128;

    // The std of an edge and its shift, px: means over both phases of the half resolution.
    const spread = async (...setting) => {
        const both = [];
        for (const at of [size / 2, size / 2 + 1]) {
            const v = await page.evaluate((a) => window.edge(...a), [...setting.slice(0, 2), at, setting[2]]);
            const row = Array.from({ length: size }, (_, x) => mean([62, 63, 64, 65].map((y) => v[y * size + x])));
            const step = row.slice(1).map((value, x) => value - row[x]);
            const sum = step.reduce((a, b) => a + b, 0);
            const centre = dot(step, step.map((_, x) => x + 1)) / sum;
            both.push([Math.sqrt(dot(step, step.map((_, x) => (x + 1 - centre) ** 2)) / sum), at - centre]);
        }
        return [0, 1].map((k) => mean(both.map((v) => v[k])));
    };
    console.log('dof(): bokehScale, way to full blur: std of an edge (as three.rs has it), px that it moves to the dark side');
    let [worst, growths] = [0, []];
    for (const [scale, t] of [[1, 1], [2, 1], [4, 1], [8, 1], [16, 1], [8, 0.75], [8, 0.5], [8, 0.3], [8, 0.1]]) {
        const c = t * t * (3 - 2 * t);
        const [r, b] = [scale * c, Math.min(2 * c, 1)];
        const wanted = Math.sqrt(b * (r * r / 4 + 1.7) + b * (1 - b) * 0.64 * r * r);
        for (const near of [false, true]) {
            const [std, moved] = await spread(scale, t, near);
            console.log(`    ${String(scale).padEnd(2)} ${t.toFixed(2)} ${near ? 'near' : 'far '}  ${std.toFixed(2)} (${wanted.toFixed(2)})  ${moved.toFixed(2)}`);
            worst = Math.max(worst, Math.abs(std - wanted));
            if (b === 1) growths.push(moved / r);
        }
    }
    check(worst < 0.12, `dof() spreads an edge as three.rs says: ${worst.toFixed(3)} px off at most (0.12)`);
    check(growths.every((g) => g > 0.59 && g < 0.97), `dof() lets what is bright grow by ${mean(growths).toFixed(2)} of its radius`);

    const [dx, dy] = [20, 10];
    const streak = async (scale, taps) => {
        const v = await page.evaluate((a) => window.moving(...a), [dx, dy, scale, taps]);
        const at = (f) => v.reduce((sum, w, i) => sum + w * f(i % size, Math.floor(i / size)), 0);
        const s = at(() => 1);
        const [x, y] = [at((x) => x) / s, at((_, y) => y) / s];
        return { s, x, y, xx: at((x) => x * x) / s - x * x, yy: at((_, y) => y * y) / s - y * y, xy: at((x, y) => x * y) / s - x * y };
    };
    const still = await streak([1, 1], 0);
    const [right, up] = [still.x - (size - 1) / 2, still.y - (size - 1) / 2];
    check(Math.abs(right - dx) < 0.1 && Math.abs(Math.abs(up) - dy) < 0.1, 'the point moves as was meant');
    // A streak as long as the motion has the variance of length^2 / 12, along the motion.
    const along = (s) => [(s.xx - still.xx) / (dx * dx / 12), (s.yy - still.yy) / (dy * dy / 12), s.xy / (right * up / 12)];
    const say = (s) => along(s).map((v) => v.toFixed(2)).join(', ');
    const good = await streak([0.5, -0.5], 32);
    check(along(good).every((v) => Math.abs(v - 1) < 0.1), `motionBlur() with vec2( 0.5, - 0.5 ): ${say(good)} of the variance along x, y and both (1)`);
    const half = await streak([0.25, -0.25], 32);
    check(along(half).every((v) => Math.abs(v - 0.25) < 0.03), `with half the exposure: ${say(half)} (0.25)`);
    const bare = await streak([1, 1], 32);
    check(Math.abs(along(bare)[0] - 4) < 0.4 && along(bare)[2] < -3, `without it the streak is twice as long and mirrored: ${say(bare)}`);
    for (const taps of [8, 32]) {
        const s = await streak([0.5, -0.5], taps);
        check(Math.abs(s.s / still.s - (taps + 1) / taps) < 0.002 && Math.abs((still.x - s.x) / dx - taps / (taps + 1) / (taps - 1)) < 0.005,
            `${taps} taps: brighter by ${(s.s / still.s - 1).toFixed(4)}, off centre by ${((still.x - s.x) / dx).toFixed(4)} of the streak`);
    }
    await page.close();
}

try {
    // dof() took other arguments before r180.
    if ((await grain()) >= 180) await effects();
    check(said.length === 0, `the browser said nothing${said.length ? `: ${[...new Set(said)].join('; ')}` : ''}`);
} finally {
    await browser.close();
    server.close();
}
console.log(failed ? `${failed} checks failed` : 'all checks passed');
process.exitCode = failed ? 1 : 0;
