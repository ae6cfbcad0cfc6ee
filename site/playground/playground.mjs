// SPDX-License-Identifier: GPL-3.0-or-later
// The page: sliders, hands and time around the engine and its picture.
import { compiled, start, unzipped } from "./engine.mjs";
import { Picture } from "./picture.mjs";

const FRAME = 1 / 60;  // s
const MOST_OWED = 3;  // frames: a slow machine shows slow motion
const HAND = 22;  // 1/s, of the spring by which a hand moves the character
const TAP = 6;  // CSS pixels that a finger may slip

const $ = (id) => document.getElementById(id);
const made = (parent, kind, properties = {}) =>
  parent.appendChild(Object.assign(document.createElement(kind), properties));
const times = { begun: performance.now() };
const spent = { frames: 0, ms: 0 };
let picture, models, frames, module, engine, model, method = "dynamic", sliders = [], meters = [], script = null;
let asked = 0;  // how many characters: the last one counts
let goal = [0, 0, 0], offset = [0, 0, 0], speed = [0, 0, 0], grip = null, failed = false;

const sentence = (error) => `${error?.message ?? error}.`.replace(/([.!?])\.$/, "$1");

function tell(error) {
  failed = true;
  $("message").textContent = sentence(error);
}

async function fetched(name) {
  const answer = await fetch(new URL(name, import.meta.url));
  if (!answer.ok) throw new Error(`${name} could not be loaded (${answer.status})`);
  return answer.arrayBuffer();
}

/// Shows another character, unless the reader asks for yet another one meanwhile.
async function load(next) {
  const mine = ++asked;
  $("message").textContent = `Loading ${next.title} …`;
  try {
    const bytes = await unzipped(await fetched(`${next.file}.dynamorph.gz`));
    const started = await start(module, bytes, next.sliders);
    if (mine == asked) enter(next, started, bytes);
  } catch (error) {
    if (mine == asked) tell(error);
  }
}

function enter(next, started, bytes) {
  const first = !engine;
  engine = started;
  model = next;
  script = null;
  failed = false;
  goal = [0, 0, 0]; offset = [0, 0, 0]; speed = [0, 0, 0];
  addControls();
  engine.single(method == "single");
  engine.step(0, 0, 0);
  engine.skin(true);
  picture.show(engine.triangles(), engine.surface(), model);
  show();
  $("message").textContent = "";
  setTimeout(() => prove(next, bytes).catch((error) => { $("proof").textContent = sentence(error); }), 1500);
  if (!first) return;
  listen();
  run();
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) shake();
}

/// Repeats the fixed motion of the native engine in another instance, and compares.
async function prove(shown, bytes) {
  const other = await start(module, bytes, shown.sliders);
  if (shown != model) return;
  const { native } = shown, hash = other.fixedMotion(frames);
  const off = Math.max(...other.coordinates().map((x, i) => Math.abs(x - native.coordinates[i])));
  const largest = Math.max(...native.coordinates.map(Math.abs));
  const same = hash == native.hash ? "the same motion" : "ANOTHER MOTION";
  $("proof").textContent = `Fixed motion, ${frames} frames, to nine digits: ${hash} in this browser, ${native.hash} ` +
    `compiled for a desktop: ${same}. The largest relative difference is ${(off / largest).toExponential(0)}.`;
  shown.proof = { hash, off: off / largest };
}

function addControls() {
  $("sliders").replaceChildren();
  sliders = model.sliders.map(({ title, unit, keys }, s) => {
    const label = made($("sliders"), "label", { className: "slider", textContent: `${title} ` });
    const [[min], [max]] = [keys[0], keys.at(-1)];
    const slider = made(label, "input", { type: "range", min, max, step: "any", value: model.pose[s] });
    const out = made(label, "output");
    const shown = () => { out.textContent = `${Math.round(slider.value)}${unit == "%" ? " " : ""}${unit}`; };
    slider.addEventListener("input", () => { script = null; shown(); });
    shown();
    engine.slide(s, +slider.value);
    return { slider, shown, at: +slider.value };
  });
  $("weights").replaceChildren("Target weights");
  meters = engine.about.targets.map((name) => {
    const row = made($("weights"), "div", { textContent: name });
    return { number: made(row, "span"), meter: made(row, "meter", { max: 1, ariaLabel: name }) };
  });
  $("bounce").value = 0;
  bounce(false);
}

/// Stiffness goes with the square of the natural frequency.
function bounce(changed = true) {
  const factor = 2 ** +$("bounce").value;
  $("bounce").nextElementSibling.textContent = `${(factor * engine.about.frequency).toFixed(1)} Hz`;
  if (changed) engine.stiffness(factor ** 2);
}

// --- Hands -----------------------------------------------------------------------------------------------------------

/// work(t) at each frame, t from 0 to 1 in so many simulated seconds: where those are slow, by the clock, so is a hand.
function scripted(seconds, work) {
  let t = 0;
  script = () => {
    t = Math.min(t + FRAME / seconds, 1);
    if (t == 1) script = null;
    work(t);
  };
}

/// As often as the tissue swings by itself.
const shake = () => scripted(0.9, (t) => {
  const swing = Math.sin(2 * Math.PI * engine.about.frequency * 0.9 * t);
  const reach = t < 1 ? 0.1 * picture.size * swing : 0;
  goal = picture.axes.right.map((r, i) => reach * (0.6 * r + picture.axes.above[i]));
});

function bend() {
  const from = sliders.map(({ slider }) => +slider.value);
  const up = from[0] < (+sliders[0].slider.min + +sliders[0].slider.max) / 2;
  scripted(0.45, (t) => sliders.forEach(({ slider, shown }, s) => {
    slider.value = from[s] + (t * t * (3 - 2 * t)) * ((up ? +slider.max : Math.min(0, from[s])) - from[s]);
    shown();
  }));
}

function poke(x = $("view").clientWidth / 2, y = $("view").clientHeight / 2) {
  engine.poke(picture.axes.eye, picture.ray(x, y));
}

function listen() {
  const view = $("view");
  view.addEventListener("pointerdown", (event) => {
    grip = { x: event.clientX, y: event.clientY, tap: true };
    view.setPointerCapture(event.pointerId);
  });
  view.addEventListener("pointermove", (event) => {
    if (!grip) return;
    const [x, y] = [event.clientX - grip.x, event.clientY - grip.y];
    if (Math.hypot(x, y) > TAP) grip.tap = false;
    if (!grip.tap) { script = null; goal = picture.moved(x, y); }
  });
  const release = (event) => {
    if (grip?.tap && event.type == "pointerup") poke(event.offsetX, event.offsetY);
    grip = null;
    goal = [0, 0, 0];
    $("hint").hidden = true;
  };
  view.addEventListener("pointerup", release);
  view.addEventListener("pointercancel", release);
  const arrows = { ArrowLeft: [-60, 0], ArrowRight: [60, 0], ArrowUp: [0, -60], ArrowDown: [0, 60] };
  view.addEventListener("keydown", (event) => {
    if (arrows[event.key]) goal = picture.moved(...arrows[event.key]);
    else if (event.key == " " || event.key == "Enter") poke();
    else return;
    event.preventDefault();
  });
  view.addEventListener("keyup", () => { goal = [0, 0, 0]; });
  for (const radio of document.getElementsByName("method"))
    radio.addEventListener("change", () => { method = radio.value; engine.single(method == "single"); });
  $("bounce").addEventListener("input", () => guarded(bounce));
  for (const [id, work] of Object.entries({ shake, bend, poke: () => poke() })) $(id).addEventListener("click", work);
}

// --- Time ------------------------------------------------------------------------------------------------------------

function guarded(work) {
  try {
    work();
  } catch (error) {
    tell(error);
  }
}

function advance() {
  script?.();
  for (let i = 0; i < 3; ++i) {
    speed[i] += FRAME * (HAND * HAND * (goal[i] - offset[i]) - 2 * HAND * speed[i]);
    offset[i] += FRAME * speed[i];
  }
  sliders.forEach((each, s) => {
    const most = (each.slider.max - each.slider.min) / 12;
    each.at += Math.max(-most, Math.min(most, 0.5 * (each.slider.value - each.at)));
    engine.slide(s, each.at);
  });
  engine.step(...offset);
}

function show() {
  engine.skin(method != "plain");
  picture.draw(engine.surface());
  times.picture ??= performance.now();
  engine.weights().forEach((weight, j) => {
    meters[j].meter.value = weight;
    meters[j].number.textContent = `${Math.round(100 * weight)} %`;
  });
}

function run() {
  let last = performance.now(), owed = 0;
  const frame = (now) => {
    owed = Math.min(owed + (now - last) / 1000, MOST_OWED * FRAME);
    last = now;
    if (!failed) guarded(() => {
      const begun = performance.now();
      const due = owed >= FRAME;
      for (; owed >= FRAME; owed -= FRAME) { advance(); ++spent.frames; }
      if (due) show();
      spent.ms += performance.now() - begun;
    });
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
}

try {
  picture = new Picture($("view"));
  const wasm = fetched("playground.wasm.gz").then(unzipped).then(compiled);
  const described = fetched("models.json").then((bytes) => JSON.parse(new TextDecoder().decode(bytes)));
  [module, { frames, models }] = await Promise.all([wasm, described]);
  for (const each of models) {
    const label = made($("models"), "label");
    const radio = made(label, "input", { type: "radio", name: "model", checked: each == models[0] });
    made(label, "span", { textContent: each.title });
    radio.addEventListener("change", () => load(each));
  }
  load(models[0]);
} catch (error) {
  tell(error);
}
/// For tests, which step by hand.
globalThis.playground = { advance, show, times, spent, get engine() { return engine; }, get model() { return model; },
  set goal(to) { goal = to; }, stop: () => { failed = true; } };
