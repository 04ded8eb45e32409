"use strict";
// The questionnaire: one stimulus after another, an answer each, saved at once. Nothing is loaded from outside.
const kit = JSON.parse(document.getElementById("kit").textContent);
const $ = (id) => document.getElementById(id);

// FNV-1a of the text's UTF-8 bytes, 32 bits. order() below and `order` in questionnaire.rs must agree.
function hash(text) {
  let h = 0x811c9dc5;
  for (const byte of new TextEncoder().encode(text)) h = Math.imul(h ^ byte, 0x01000193) >>> 0;
  return h;
}

// Numbers of 32 bits from a seed (mulberry32).
function random(seed) {
  let a = seed;
  return () => {
    a = (a + 0x6d2b79f5) >>> 0;
    let t = Math.imul(a ^ (a >>> 15), a | 1);
    t = (t + Math.imul(t ^ (t >>> 7), t | 61)) ^ t;
    return (t ^ (t >>> 14)) >>> 0;
  };
}

// The stimuli of a task in a participant's own order, without the same scene twice in a row where that can be avoided.
function order(participant, task) {
  const all = kit.stimuli.flatMap((s, i) => (s.task === task ? [i] : []));
  const next = random(hash(`${kit.seed}|${participant}|${task}`));
  for (let i = all.length - 1; i > 0; i--) {
    const j = Math.floor((next() * (i + 1)) / 4294967296);
    [all[i], all[j]] = [all[j], all[i]];
  }
  const scene = (k) => kit.stimuli[all[k]].scene;
  for (let i = 1; i < all.length; i++) {
    if (scene(i) !== scene(i - 1)) continue;
    for (let j = i + 1; j < all.length; j++) {
      if (scene(j) !== scene(i - 1)) {
        [all[i], all[j]] = [all[j], all[i]];
        break;
      }
    }
  }
  return all;
}

let participant = "";
let trials = [];
let answers = [];
let shownAt = 0;
let url = null;

const key = () => `blindaug-study:${kit.hash}:${participant}`;

// Storage fails in private windows, and in some browsers for files.
function save() {
  try {
    localStorage.setItem(key(), JSON.stringify(answers));
    return true;
  } catch {
    $("unsaved").hidden = false;
    return false;
  }
}

function stored() {
  try {
    const all = JSON.parse(localStorage.getItem(key()) ?? "[]");
    const fits = (a, i) => a.stimulus === trials[i] && (a.answer === "yes" || a.answer === "no");
    return Array.isArray(all) && all.length <= trials.length && all.every(fits) ? all : [];
  } catch {
    return [];
  }
}

// Spreadsheets take some first characters for formulas.
function cleaned(text) {
  const plain = text.replace(/[\u0000-\u001f\u007f]/g, " ").trim().slice(0, 60);
  return /^[=+\-@]/.test(plain) ? `p${plain}` : plain;
}

function show(screen) {
  for (const s of document.querySelectorAll("main > section")) s.hidden = s.id !== screen;
  window.scrollTo(0, 0);
  $(screen).querySelector("h1, h2")?.focus();
}

function media(index) {
  const { mime } = kit.stimuli[index];
  const bytes = Uint8Array.from(atob($(`s${index}`).textContent), (c) => c.charCodeAt(0));
  if (url) URL.revokeObjectURL(url);
  url = URL.createObjectURL(new Blob([bytes], { type: mime }));
  const video = mime.startsWith("video/");
  const element = document.createElement(video ? "video" : "img");
  if (video) Object.assign(element, { muted: true, loop: true, autoplay: true, playsInline: true, controls: false });
  else element.alt = "The picture in question";
  element.addEventListener("error", () => { $("broken").hidden = false; });
  element.src = url;
  $("broken").hidden = true;
  $("stimulus").replaceChildren(element);
  if (video) element.play().catch(() => { element.controls = true; });
}

function next() {
  const i = answers.length;
  if (i === trials.length) return finish();
  const { task } = kit.stimuli[trials[i]];
  const first = i === 0 || kit.stimuli[trials[i - 1]].task !== task;
  if (first) {
    $("part-question").textContent = kit.questions[task];
    $("part-count").textContent = trials.filter((t) => kit.stimuli[t].task === task).length;
    show("part");
  } else trial();
}

function trial() {
  const i = answers.length;
  $("question").textContent = kit.questions[kit.stimuli[trials[i]].task];
  $("progress").textContent = `${i + 1} of ${trials.length}`;
  $("bar").value = i;
  $("bar").max = trials.length;
  media(trials[i]);
  show("trial");
  shownAt = performance.now();
}

function answer(value) {
  if ($("trial").hidden) return;
  const seconds = Math.round((performance.now() - shownAt) / 10) / 100;
  answers.push({ stimulus: trials[answers.length], answer: value, seconds });
  save();
  next();
}

function csv() {
  const quoted = (v) => `"${String(v).replace(/"/g, '""')}"`;
  const rows = answers.map((a, i) => {
    const s = kit.stimuli[a.stimulus];
    return [participant, s.task, s.scene, s.method, a.answer, a.seconds, i + 1].map(quoted).join(",");
  });
  return ["participant,task,scene,method,answer,seconds,position", ...rows].join("\n") + "\n";
}

function finish() {
  $("count").textContent = `${answers.length} of ${trials.length}`;
  $("csv").value = csv();
  const link = $("download");
  link.href = URL.createObjectURL(new Blob([csv()], { type: "text/csv" }));
  link.download = `answers-${participant.replace(/[^a-zA-Z0-9_-]/g, "_") || "participant"}.csv`;
  $("back").hidden = answers.length === trials.length;
  show("end");
}

$("begin").addEventListener("submit", (event) => {
  event.preventDefault();
  participant = cleaned($("participant").value);
  if (!participant) return;
  trials = kit.tasks.flatMap((task) => order(participant, task));
  answers = stored();
  $("unsaved").hidden = true;
  save();
  $("export").hidden = false;
  next();
});
$("go").addEventListener("click", trial);
$("yes").addEventListener("click", () => answer("yes"));
$("no").addEventListener("click", () => answer("no"));
$("export").addEventListener("click", finish);
$("back").addEventListener("click", next);
$("copy").addEventListener("click", () => {
  $("csv").select();
  navigator.clipboard?.writeText($("csv").value).catch(() => {});
});
$("anew").addEventListener("click", () => {
  if (!confirm("Delete the answers of this participant and start anew?")) return;
  answers = [];
  try { localStorage.removeItem(key()); } catch { /* nothing was stored */ }
  $("export").hidden = true;
  show("start");
});
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.repeat || event.target.matches("input, textarea")) return;
  if (event.key === "y" || event.key === "Y") answer("yes");
  if (event.key === "n" || event.key === "N") answer("no");
});

const given = new URLSearchParams(location.search).get("participant");
$("participant").value = cleaned(given ?? `p${1000 + (crypto.getRandomValues(new Uint32Array(1))[0] % 9000)}`);
show("start");
