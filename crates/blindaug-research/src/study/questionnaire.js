// The questionnaire: which section is shown, the answers, and their export. questionnaire.rs writes the sections.
'use strict';
(() => {
    const byId = (id) => document.getElementById(id);
    const kit = JSON.parse(byId('kit').textContent);
    const total = kit.stimuli.length;

    // --- the order, as `order` in questionnaire.rs has it

    function hash32(text) {
        return new TextEncoder().encode(text).reduce((h, byte) => Math.imul(h ^ byte, 0x01000193), 0x811c9dc5) >>> 0;
    }

    /** A function that draws a number in 0..n. */
    function draws(state) {
        return (n) => {
            state = (state + 0x9e3779b9) | 0;
            let x = Math.imul(state ^ (state >>> 16), 0x85ebca6b);
            x = Math.imul(x ^ (x >>> 13), 0xc2b2ae35);
            return Math.floor((((x ^ (x >>> 16)) >>> 0) * n) / 2 ** 32);
        };
    }

    /** No two of a scene in succession, where that can be avoided. */
    function spread(left) {
        const scene = (i) => kit.stimuli[i].scene;
        const count = new Map();
        for (const i of left) count.set(scene(i), (count.get(scene(i)) ?? 0) + 1);
        const taken = [];
        while (left.length) {
            const other = (i) => !taken.length || scene(i) !== scene(taken.at(-1));
            let next = left.findIndex((i) => other(i) && 2 * count.get(scene(i)) > left.length);
            if (next < 0) next = left.findIndex(other);
            const [i] = left.splice(Math.max(next, 0), 1);
            count.set(scene(i), count.get(scene(i)) - 1);
            taken.push(i);
        }
        return taken;
    }

    function orderOf(participant) {
        return kit.tasks.flatMap(({ name }) => {
            const all = kit.stimuli.map((_, i) => i).filter((i) => kit.stimuli[i].task === name);
            const below = draws(hash32(`${kit.seed} ${name} ${participant}`));
            for (let last = all.length - 1; last > 0; last--) {
                const other = below(last + 1);
                [all[last], all[other]] = [all[other], all[last]];
            }
            return spread(all);
        });
    }

    // --- what is kept: the answers in the participant's order, each [yes, seconds], or null where it was left out

    let participant = '';
    let order = [];
    let answers = [];
    let rested = false;
    let exported = true;

    // Some browsers give files no storage, and say so by an exception.
    let storage = null;
    try {
        localStorage.setItem('blindaug-study', '1');
        storage = localStorage;
    } catch {
        byId('unsaved').hidden = false;
    }
    const keyOf = (id) => `blindaug-study:${kit.hash}:${id}`;
    const lastKey = `blindaug-study:${kit.hash}`;

    function store(key, value) {
        try {
            storage?.setItem(key, value);
        } catch {
            // Full, or forbidden in the meantime.
            storage = null;
            byId('unsaved').hidden = false;
        }
    }

    function stored(id) {
        try {
            const kept = JSON.parse(storage.getItem(keyOf(id)));
            const good = (a) => a === null || (Array.isArray(a) && typeof a[0] === 'boolean' && Number.isFinite(a[1]));
            return Array.isArray(kept) && kept.length <= total && kept.every(good) ? kept : [];
        } catch {
            return [];
        }
    }

    /**
     * An id that any table can hold: one line of at most 64 characters, which no spreadsheet takes for a formula. Cut by code points,
     * so that no half of a character is left.
     */
    function clean(id) {
        const line = id.normalize('NFC').replace(/[\p{C}\p{Z}]+/gu, ' ').trim();
        return Array.from(/^[=+\-@]/.test(line) ? `'${line}` : line).slice(0, 64).join('').trim();
    }

    // --- the export

    const quoted = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);

    function csv() {
        const rows = answers.flatMap((answer, position) => {
            if (!answer) return [];
            const { task, scene, method } = kit.stimuli[order[position]];
            const [yes, seconds] = answer;
            return [[participant, task, scene, method, yes ? 'yes' : 'no', seconds.toFixed(2), String(position + 1)]];
        });
        const head = ['participant', 'task', 'scene', 'method', 'answer', 'seconds', 'position'];
        return [head, ...rows].map((row) => `${row.map(quoted).join(',')}\n`).join('');
    }

    let file = null;
    function showExport() {
        const finished = answers.length === total;
        const given = answers.filter(Boolean).length;
        byId('export-title').textContent = finished ? 'Thank you, that was all' : 'Your answers so far';
        byId('count').textContent = `Participant ${participant}: ${given} of ${total} questions answered.`;
        byId('csv').value = csv();
        byId('copied').textContent = '';
        byId('as-text').open = false;
        byId('back').hidden = finished;
        if (file) URL.revokeObjectURL(file);
        file = URL.createObjectURL(new Blob([csv()], { type: 'text/csv' }));
        byId('save').href = file;
        byId('save').download = `answers-${participant.replace(/[^A-Za-z0-9_-]+/g, '_')}.csv`;
        show('export');
    }

    // --- one section at a time

    function show(id) {
        for (const section of document.querySelectorAll('main')) section.hidden = section.id !== id;
        byId('menu').open = false;
        if (id !== 'trial') clear();
        scrollTo(0, 0);
        // Readers of the screen go on at the new heading.
        byId(id).querySelector('h1').focus({ preventScroll: true });
    }

    let shown = null; // the picture or the clip
    let address = null; // its object URL
    let since = 0; // when it was shown, ms

    function clear() {
        shown?.remove();
        if (address) URL.revokeObjectURL(address);
        shown = address = null;
    }

    function enable(on) {
        byId('yes').disabled = byId('no').disabled = !on;
    }

    /**
     * As large as fits, but never more than one pixel of the stimulus on one pixel of the screen: an enlarged picture is interpolated,
     * which adds blur, and blur is what is judged.
     */
    function fit() {
        const width = shown?.naturalWidth || shown?.videoWidth;
        const height = shown?.naturalHeight || shown?.videoHeight;
        if (!width || !height) return;
        const stage = byId('stage');
        const scale = Math.min(1 / devicePixelRatio, stage.clientWidth / width, stage.clientHeight / height);
        shown.style.width = `${scale * width}px`;
        shown.style.height = `${scale * height}px`;
    }

    function next() {
        const position = answers.length;
        if (position === total) return showExport();
        const stimulus = kit.stimuli[order[position]];
        const first = position > 0 && kit.stimuli[order[position - 1]].task !== stimulus.task;
        if (first && !rested) return show('break');
        clear();
        enable(false);
        byId('broken').hidden = true;
        byId('progress').textContent = `${position + 1} of ${total}`;
        byId('bar').max = total;
        byId('bar').value = position;
        byId('question').textContent = kit.tasks.find((t) => t.name === stimulus.task).question;

        // From an object URL: some phones play no video from a data URI, and no name of a file can be seen.
        const bytes = Uint8Array.from(atob(byId(`media${order[position]}`).textContent), (c) => c.charCodeAt(0));
        address = URL.createObjectURL(new Blob([bytes], { type: stimulus.mime }));
        const video = stimulus.mime.startsWith('video/');
        const element = document.createElement(video ? 'video' : 'img');
        const current = (act) => () => element === shown && act();
        element.addEventListener(video ? 'loadeddata' : 'load', current(() => {
            fit();
            since = performance.now();
            // A second tap of the last answer must not answer this question.
            setTimeout(current(() => enable(true)), 400);
        }));
        element.addEventListener('error', current(() => {
            byId('broken').hidden = false;
        }));
        if (video) {
            element.muted = element.loop = element.playsInline = true;
            element.setAttribute('aria-label', 'The clip to judge');
        } else {
            element.alt = 'The picture to judge';
        }
        shown = element;
        byId('stage').append(element);
        element.src = address;
        if (video) {
            // Where clips may not start by themselves, the participant starts them.
            element.play().catch(() => (element.controls = true));
        }
        show('trial');
    }

    function answer(given) {
        answers.push(given);
        exported = false;
        store(keyOf(participant), JSON.stringify(answers));
        next();
    }

    function start(id) {
        participant = clean(id);
        if (!participant) return;
        order = orderOf(participant);
        answers = stored(participant);
        rested = false;
        store(lastKey, participant);
        next();
    }

    function welcome(id) {
        byId('participant').value = id;
        noteKept();
        show('start');
    }

    /** The button says where a known participant goes on. */
    function noteKept() {
        const kept = stored(clean(byId('participant').value)).length;
        byId('begin').querySelector('button').textContent = !kept ? 'I agree, start'
            : kept < total ? `I agree, go on at question ${kept + 1}` : 'To my answers';
    }

    function generated() {
        const letters = 'abcdefghjkmnpqrstuvwxyz23456789';
        return `p-${Array.from(crypto.getRandomValues(new Uint8Array(6)), (v) => letters[v % letters.length]).join('')}`;
    }

    // --- what the participant does

    byId('begin').addEventListener('submit', (event) => {
        event.preventDefault();
        start(byId('participant').value);
    });
    byId('participant').addEventListener('input', noteKept);
    const choose = (yes) => answer([yes, Math.max(0, performance.now() - since) / 1000]);
    byId('yes').addEventListener('click', () => choose(true));
    byId('no').addEventListener('click', () => choose(false));
    byId('skip').addEventListener('click', () => answer(null));
    byId('go-on').addEventListener('click', () => {
        rested = true;
        next();
    });
    byId('back').addEventListener('click', next);
    byId('save').addEventListener('click', () => (exported = true));
    byId('copy').addEventListener('click', async () => {
        try {
            await navigator.clipboard.writeText(csv());
            exported = true;
            byId('copied').textContent = 'Copied.';
        } catch {
            byId('as-text').open = true;
            byId('csv').select();
            byId('copied').textContent = 'The text is selected: copy it with the keyboard, or by a long press.';
        }
    });
    for (const button of document.querySelectorAll('[data-do=export]')) button.addEventListener('click', showExport);
    for (const button of document.querySelectorAll('[data-do=anew]')) {
        button.addEventListener('click', () => {
            if (!confirm(`Start anew? All answers of ${participant} on this device are removed.`)) return;
            storage?.removeItem(keyOf(participant));
            storage?.removeItem(lastKey);
            answers = [];
            exported = true;
            welcome(preset || generated());
        });
    }
    addEventListener('keydown', (event) => {
        const button = byId({ y: 'yes', n: 'no' }[event.key?.toLowerCase()] ?? '');
        const modified = event.ctrlKey || event.altKey || event.metaKey || event.repeat;
        // A disabled button, or one of a section that is not shown, is not clicked.
        if (button && !modified && !byId('trial').hidden) button.click();
    });
    addEventListener('resize', fit);
    addEventListener('beforeunload', (event) => {
        if (!storage && !exported) event.preventDefault();
    });

    const preset = clean(new URLSearchParams(location.search).get('participant') ?? '');
    let last = null;
    try {
        last = storage?.getItem(lastKey);
    } catch {
        // Asked for once more as the storage is tried.
    }
    welcome(preset || last || generated());
})();
