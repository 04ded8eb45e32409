import { Live, cameraFile, cameraWords, exportCamera, exportTargets, frames, webcam } from '../js/index.js';
import { Plot } from './plot.js';
import { zip } from './zip.js';

const $ = (id) => document.getElementById(id);
/** The largest object file, bytes: in a page, what is made of it takes several times as much memory. */
const LARGEST = 100e6;
/** ?gpu=always or never, ?fps=N and ?lens=no-noise are for tests. */
const asked = new URLSearchParams(location.search);

const canvas = $('picture');
const context = canvas.getContext('2d', { alpha: false });
const plot = new Plot($('plot'));
const state = { split: 0.5, paused: false, source: undefined, shown: undefined, camera: undefined, skipped: 0, frames: 0, number: 0, lap: 0, clock: [] };
let live;

/** Shows a sentence about what went wrong, or none. */
function say(sentence) {
  // A file's name stays as it is.
  const named = /^\S+\.\w+\b/.test(sentence ?? '');
  const text = !sentence || named ? (sentence ?? '') : sentence[0].toUpperCase() + sentence.slice(1);
  $('trouble').textContent = text && /[.!?]$/.test(text) ? text : text && `${text}.`;
  $('trouble').hidden = !sentence;
}

/** What to do, in one sentence. */
function hint({ camera, onPlane }) {
  const known = (part) => camera[part].unknown === undefined;
  if (!known('motion_blur')) return 'Move the camera a little sideways: motion shows its shutter and its lens.';
  if (!known('defocus')) return 'Now move it past things that are near and far: they show the lens.';
  return onPlane
    ? 'The object stands on what you film: drag the line to compare.'
    : 'The object is fixed in view: film something flat, and it stands on that.';
}

function paint() {
  if (!state.shown) return;
  const { picture, width, height } = state.shown;
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const x = Math.round(state.split * width);
  if (x > 0) context.drawImage(picture, 0, 0, x, height, 0, 0, x, height);
  if (x < width) context.drawImage(picture, x, height, width - x, height, x, 0, width - x, height);
}

function setSplit(share) {
  state.split = Math.min(1, Math.max(0, share));
  const percent = Math.round(100 * state.split);
  const line = $('line');
  line.style.left = `${100 * state.split}%`;
  line.setAttribute('aria-valuenow', percent);
  line.setAttribute('aria-valuetext', `${percent} % of the width`);
  $('tagLeft').hidden = !state.shown || state.split < 0.15;
  $('tagRight').hidden = !state.shown || state.split > 0.85;
  paint();
}

function showParameters(parameters) {
  const rows = parameters.map(([name, text]) => {
    const row = document.createElement('div');
    const [term, value] = [document.createElement('dt'), document.createElement('dd')];
    term.textContent = name;
    value.textContent = text.replace(/^unknown: /, 'unknown because ');
    value.classList.toggle('unknown', text.startsWith('unknown'));
    row.append(term, value);
    return row;
  });
  $('parameters').replaceChildren(...rows);
}

/** The noise in steps of 8 bit, the mean of R, G and B. */
function noiseOf(parameters) {
  const row = parameters.find(([name, text]) => name.startsWith('noise') && !text.startsWith('unknown'));
  if (!row) return undefined;
  const values = row[1].replace(/\[[^\]]*\]/g, '').split(',').map(Number);
  return values.reduce((a, b) => a + b, 0) / values.length;
}

function onframe(frame) {
  if (!state.source || frame.number < state.source.first) return frame.picture.close();
  state.shown?.picture.close();
  const first = !state.shown;
  state.shown = frame;
  state.camera = frame.camera;
  state.frames += 1;
  state.skipped += Math.max(0, frame.number - state.number - 1);
  state.number = frame.number;
  paint();
  if (first) {
    $('welcome').hidden = true;
    $('line').hidden = false;
    performance.mark('first composite');
    for (const id of ['pause', 'record', 'saveCamera', 'saveExport', 'target']) $(id).disabled = false;
    setSplit(state.split);
  }
  showParameters(frame.parameters);
  if ($('inWords').open) cameraWords(frame.camera).then((words) => ($('words').textContent = words));
  const text = hint(frame);
  if ($('hint').textContent !== text) $('hint').textContent = text;
  const now = performance.now();
  const { exposure, interval } = frame.camera.motion_blur;
  plot.add(now / 1000, exposure, interval, noiseOf(frame.parameters));
  state.clock = state.clock.filter((t) => now - t < 2000).concat(now);
  const { estimate, composite } = frame.times;
  const rate = (state.clock.length - 1) / Math.max(0.001, (now - state.clock[0]) / 1000);
  const by = frame.by === 'webgpu' ? 'by WebGPU' : `on the processor, since ${frame.why}`;
  $('speed').textContent =
    `${frame.width} x ${frame.height} px, ${rate.toFixed(0)} pictures a second; estimate ${estimate.toFixed(0)} ms, composite ${composite.toFixed(0)} ms ${by}; ` +
    `${state.skipped} of ${state.frames + state.skipped} frames left out`;
  window.dispatchEvent(new CustomEvent('blindaug-frame', { detail: frame }));
  return undefined;
}

let starting;
async function start() {
  starting ??= Live.create({
    gpu: asked.get('gpu') ?? 'auto',
    fps: Number(asked.get('fps')) || undefined,
    onframe,
    onnote: say,
    onrestart: (why, end) => say(end ? `the estimation stopped again and again (${why}): load the page anew` : `the estimation stopped (${why}) and began anew`),
  });
  starting.catch(() => (starting = undefined));
  live = await starting;
  applyLook();
}

/** Ends what is being looked at. */
function stop() {
  const { source } = state;
  if (!source) return;
  state.source = undefined;
  source.end();
  source.stream?.getTracks().forEach((track) => track.stop());
  if (source.url) URL.revokeObjectURL(source.url);
  source.video.srcObject = null;
  source.video.removeAttribute('src');
}

/** The picture as it is, until the first one with an object has been made. */
function preview(video) {
  const scale = Math.min(1, 640 / Math.max(video.videoWidth, video.videoHeight));
  const [width, height] = [video.videoWidth, video.videoHeight].map((side) => Math.max(1, Math.round(scale * side)));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  context.drawImage(video, 0, 0, width, height);
  if (!$('welcome').hidden) performance.mark('first picture');
  $('welcome').hidden = true;
}

/** Looks at a video from now on; its frames are numbered on from the last ones. */
function follow(source) {
  stop();
  const offset = state.number + 10;
  state.lap += 1;
  state.source = { ...source, first: offset };
  state.number = offset;
  setPaused(false);
  plot.clear();
  state.source.end = frames(source.video, (video, { number }) => {
    // While a clip goes back to its beginning it has no picture.
    if ((state.paused && source.stream) || video.readyState < 2) return;
    if (!state.shown) preview(video);
    // At once, since a moment later the video shows another picture.
    live.push(video, { number: offset + number, lap: state.lap }).catch((e) => say(e.message));
  });
}

async function useWebcam() {
  try {
    say();
    $('hint').textContent = 'Allow the camera; the first picture comes at once.';
    const [opened] = await Promise.all([webcam(), start()]);
    opened.track.addEventListener('ended', () => {
      if (state.source?.track !== opened.track) return;
      state.source.unplugged = true;
      say('the webcam was unplugged: plug it in again, and it goes on');
    });
    follow(opened);
    $('camera').hidden = true;
    $('clipAgain').hidden = false;
  } catch (e) {
    say(e.message);
    $('camera').hidden = !state.shown;
    $('hint').textContent = 'Without a camera: drop a clip here, or open one.';
  }
}

navigator.mediaDevices?.addEventListener('devicechange', async () => {
  if (!state.source?.unplugged) return;
  const devices = await navigator.mediaDevices.enumerateDevices();
  if (devices.some((d) => d.kind === 'videoinput')) useWebcam();
});

async function useClip(file) {
  say();
  const video = document.createElement('video');
  const url = URL.createObjectURL(file);
  Object.assign(video, { muted: true, playsInline: true, preload: 'auto', src: url });
  try {
    await Promise.all([
      start(),
      new Promise((resolve, reject) => {
        video.addEventListener('loadeddata', resolve, { once: true });
        video.addEventListener('error', () => reject(new Error(`${file.name}: this browser cannot play it: try an MP4 with H.264, or a WebM`)), { once: true });
      }),
    ]);
    if (!video.videoWidth) throw new Error(`${file.name}: there is no picture in it that this browser can play: try an MP4 with H.264, or a WebM`);
    video.addEventListener('ended', () => {
      if (state.source?.video !== video) return;
      state.lap += 1;
      video.currentTime = 0;
      video.play().catch((e) => say(e.message));
    });
    video.addEventListener('error', () => state.source?.video === video && say(`${file.name}: the video is damaged from here on`));
    follow({ video, url });
    await video.play();
    $('camera').hidden = false;
    $('clipAgain').hidden = false;
  } catch (e) {
    URL.revokeObjectURL(url);
    say(e.message);
  }
}

async function useObject(file) {
  say();
  if (file.size > LARGEST) {
    say(`${file.name} has ${Math.round(file.size / 1e6)} MB, and a page takes ${LARGEST / 1e6} at most: reduce its triangles or textures`);
    return;
  }
  try {
    await start();
    const notes = await live.setObject(await file.arrayBuffer());
    if (notes.length) say(`${file.name}: ${notes.join('; ')}`);
    $('builtIn').hidden = false;
  } catch (e) {
    say(`${file.name}: ${e.message}`);
  }
}

function setPaused(paused) {
  state.paused = paused;
  $('pause').textContent = paused ? 'Go on' : 'Pause';
  $('pause').setAttribute('aria-pressed', paused);
  const { source } = state;
  if (!source || source.stream) return;
  if (paused) source.video.pause();
  else source.video.play().catch(() => {});
}

function download(name, blob) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

let recorder;
function record() {
  if (recorder) return recorder.stop();
  const kind = ['video/webm;codecs=vp9', 'video/webm', 'video/mp4'].find((k) => globalThis.MediaRecorder?.isTypeSupported(k));
  if (!kind) return say('this browser cannot record videos');
  const parts = [];
  recorder = new MediaRecorder(canvas.captureStream(30), { mimeType: kind, videoBitsPerSecond: 8e6 });
  recorder.ondataavailable = ({ data }) => parts.push(data);
  recorder.onstop = () => {
    recorder = undefined;
    $('record').textContent = 'Record';
    $('record').setAttribute('aria-pressed', false);
    download(`blindaug.${kind.includes('mp4') ? 'mp4' : 'webm'}`, new Blob(parts, { type: kind }));
  };
  recorder.start(1000);
  $('record').textContent = 'Stop recording';
  $('record').setAttribute('aria-pressed', true);
  return undefined;
}

/** The camera, with its lens over metres where the object stands. */
const applied = async () => (await live?.applied()) ?? state.camera;

async function saveExport() {
  try {
    const camera = await applied();
    const target = $('target').value;
    const names = target === 'all' ? [...$('target').options].map((o) => o.value).filter((v) => v !== 'all') : [target];
    const files = [];
    const notes = [];
    for (const name of names) {
      const made = await exportCamera(camera, name);
      files.push(...made.files.map((f) => (names.length > 1 ? { ...f, name: `${name}/${f.name}` } : f)));
      if (names.length === 1) notes.push(...made.notes);
    }
    if (files.length === 1) download(files[0].name, new Blob([files[0].bytes]));
    else download(`blindaug-${target}.zip`, zip(files));
    $('notes').textContent = notes.length ? `${notes.join('. ')}.` : '';
  } catch (e) {
    say(e.message);
  }
}

async function fillTargets() {
  const targets = await exportTargets();
  const option = (value, text) => Object.assign(document.createElement('option'), { value, textContent: text });
  $('target').replaceChildren(...targets.map((t) => option(t.name, t.name)), option('all', 'all of them'));
}

function applyLook() {
  const number = (id) => Number($(id).value);
  live?.setLook({
    size: number('size'),
    distance: number('distance'),
    x: number('across'),
    y: number('down'),
    noise: $('noise').checked,
    disk: $('disk').checked,
  });
}

// The line follows the finger.
const line = $('line');
const frame = $('frame');
const shareAt = (e) => (e.clientX - canvas.getBoundingClientRect().left) / canvas.getBoundingClientRect().width;
let dragging = false;
frame.addEventListener('pointerdown', (e) => {
  if (!state.shown || !$('welcome').hidden || e.target.closest('button, label')) return;
  dragging = true;
  frame.setPointerCapture(e.pointerId);
  setSplit(shareAt(e));
  line.focus({ preventScroll: true });
  e.preventDefault();
});
frame.addEventListener('pointermove', (e) => dragging && setSplit(shareAt(e)));
for (const type of ['pointerup', 'pointercancel']) frame.addEventListener(type, () => (dragging = false));

addEventListener('keydown', (e) => {
  if (e.ctrlKey || e.metaKey || e.altKey || !state.shown) return;
  const typing = e.target.matches?.('input, select, summary, button') && e.target.id !== 'line';
  const step = e.shiftKey ? 0.1 : 0.02;
  const to = { ArrowLeft: state.split - step, ArrowRight: state.split + step, Home: 0, End: 1 }[e.key];
  if (to !== undefined && !e.target.matches?.('input, select')) setSplit(to);
  else if (e.key === ' ' && !typing) setPaused(!state.paused);
  else if (e.key === 'r' && !e.target.matches?.('input, select')) record();
  else return;
  e.preventDefault();
});

$('start').addEventListener('click', useWebcam);
$('camera').addEventListener('click', useWebcam);
$('pause').addEventListener('click', () => setPaused(!state.paused));
$('record').addEventListener('click', record);
$('saveCamera').addEventListener('click', async () => {
  const text = await cameraFile(state.camera);
  download('camera.json', new Blob([text], { type: 'application/json' }));
});
$('saveExport').addEventListener('click', saveExport);
$('builtIn').addEventListener('click', async () => {
  await live.setObject(null);
  $('builtIn').hidden = true;
});
for (const id of ['size', 'distance', 'across', 'down', 'noise', 'disk']) $(id).addEventListener('input', applyLook);
const chosen = (id, use) =>
  $(id).addEventListener('change', ({ target }) => {
    const [file] = target.files;
    target.value = '';
    if (file) use(file);
  });
const useFile = (file) => (/\.(glb|gltf)$/i.test(file.name) ? useObject(file) : useClip(file));
$('inWords').addEventListener('toggle', async () => {
  if (state.camera && $('inWords').open) $('words').textContent = await cameraWords(state.camera);
});
chosen('clip', useClip);
chosen('glb', useObject);
for (const type of ['dragenter', 'dragover', 'dragleave', 'drop']) {
  addEventListener(type, (e) => {
    e.preventDefault();
    frame.classList.toggle('over', type === 'dragenter' || type === 'dragover');
    if (type === 'drop') for (const file of e.dataTransfer.files) useFile(file);
  });
}
setSplit(0.5);
// Before this, a click or a file would have been lost.
for (const id of ['start', 'clip']) $(id).disabled = false;
// The worker waits for the first frame rather than the frame for the worker; what fails here is said when it is asked for.
fillTargets()
  .then(() => start().catch(() => {}))
  .catch((e) => say(`the page's own files could not be loaded (${e.message}): load it again`));
// For tests, which ask for the reference and break things.
Object.defineProperty(window, 'blindaug', { get: () => live });
window.blindaugSource = () => state.source;
