"use strict";
(() => {
const films = JSON.parse(document.getElementById("films").textContent);
const shortcuts = "shortcuts" in document.getElementById("player").dataset;
const [canvas, scrub, play, back, next, choice, speed, whole, clock, magnify, gap, legend, shown, printed,
  forces, names] =
  ["stage", "scrub", "play", "back", "next", "film", "speed", "whole", "clock", "magnify", "gap", "legend", "shown", "printed",
   "forces", "names"]
    .map(id => document.getElementById(id));
const stage = new Stage(canvas);
const REST = 0.8;            // pause [s] on the last frame before the animation restarts
const WIDEST = 0.12;         // share of the picture: the largest gap at the end of the slider
const ON_PAPER = 6;          // number of frames that are printed
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
let run, frames, start, end, time, frame = 0, playing = false, rested = 0, before = 0, pending = 0, visible = true;

// --- number formatting ---
const power = value => value === 0 ? "0" : value >= 0.01 && value < 1000
  ? String(Number(value.toPrecision(3))) : value.toExponential(1).replace("e+", "e");
const magnification = () => 10 ** Number(magnify.value);

function largestGap() {
  let largest = 0;
  for (let joint = 0; joint < run.gaps.joints.length; joint++) {
    const size = Math.hypot(...stage.gap(frame, joint));
    if (size > largest) largest = size;
  }
  return largest;
}

// --- one frame ---
function draw() {
  stage.pushed = forces.checked;
  stage.named = names.checked;
  stage.draw(frame, whole.checked, magnification());
  clock.textContent = `t = ${run.time[frame].toFixed(3)} s`;
  scrub.value = frame;
  scrub.setAttribute("aria-valuetext", `${run.time[frame].toFixed(3)} s of ${end.toFixed(3)} s`);
  if (magnify.disabled) return;
  const now = largestGap(), factor = magnification();
  gap.textContent = factor === 1
    ? `not magnified: the largest gap is ${power(now)} m now, ${power(run.gaps.largest)} m over all frames`
    : `${power(factor)} times: the largest gap, ${power(now)} m now, is drawn as ${power(now * factor)} m`;
}

function show(number) {
  frame = Math.min(frames - 1, Math.max(0, number));
  time = run.time[frame];
  rested = 0;
  draw();
}

function magnified() {
  const factor = magnification();
  magnify.setAttribute("aria-valuetext", factor === 1 ? "not magnified" : `${power(factor)} times`);
  draw();
}

// --- playback ---
function tick(now) {
  if (!playing || !visible) return;
  const passed = Math.min(0.1, Math.max(0, (now - before) / 1000));   // the first stamp may lie before `before`
  before = now;
  time = Math.min(end, time + passed * Number(speed.value));
  if (time >= end && (rested += passed) > REST) { time = start; rested = 0; }
  frame = Math.round((time - start) / (end - start) * (frames - 1));
  draw();
  pending = requestAnimationFrame(tick);
}

function roll() {
  cancelAnimationFrame(pending);
  before = performance.now();
  pending = requestAnimationFrame(tick);
}

function go(on) {
  playing = on && frames > 1;
  if (playing && frame === frames - 1) show(0);
  play.textContent = playing ? "Pause" : "Play";
  roll();
}

// --- the scale of the bending moments of beams ---
function scale(names) {
  const item = document.createElement("li"), swatch = document.createElement("span");
  const most = power(run.bending.largest);
  swatch.className = "scale";
  const who = names.length > 3 ? `${names.length} beams` : names.join(", ");
  item.append(`${who}: bending moment, \u2212${most} to ${most} N m`, swatch);
  return item;
}

// --- a film ---
function load(number) {
  run = films[number];
  frames = run.time.length;
  start = run.time[0];
  end = run.time[frames - 1];
  stage.show(run);
  canvas.setAttribute("aria-label", `The mechanism in motion${run.label ? `: ${run.label}` : ""}`);
  shown.textContent = run.label ? `Shown: ${run.label}` : "";
  const few = run.links.length <= 6, bent = run.bending ? run.beams.map(beam => beam.name) : [];
  const entry = (name, color) => {
    const item = document.createElement("li"), swatch = document.createElement("span");
    swatch.style.background = `var(--${color})`;
    item.append(swatch, name);
    return item;
  };
  legend.replaceChildren(...(few ? run.links : []).filter(([name]) => !bent.includes(name)).map(link => entry(...link)));
  legend.append(...run.key.map(part => entry(...part)));
  if (bent.length) legend.append(scale(bent));
  for (const [kind, text] of Object.entries(run.arrows?.texts ?? {})) legend.append(entry(text, Stage.FORCES[kind]));
  if (run.arrows) legend.append(`longest arrow ${Number(run.arrows.longest.toPrecision(3))} N`);
  legend.hidden = !legend.childNodes.length;
  forces.parentElement.hidden = !run.arrows;
  const chosen = speed.selectedIndex;
  speed.replaceChildren(...[0.1, 0.25, 0.5, 1, 2, 4].map(factor => {
    const value = factor * run.speed;
    return new Option(value === 1 ? "real time" : `${Number(value.toPrecision(3))} \u00d7`, value);
  }));
  speed.selectedIndex = chosen < 0 ? 3 : chosen;
  scrub.max = frames - 1;
  for (const control of [scrub, play, back, next, speed]) control.disabled = frames < 2;
  const most = run.gaps.largest > 0 ? Math.log10(WIDEST * stage.size / run.gaps.largest) : 0;
  magnify.disabled = most <= 0;
  magnify.max = Math.max(0, most);
  if (magnify.disabled) {
    gap.textContent = run.gaps.largest > 0 ? "The gaps are visible without magnification." : "The joints have no gaps.";
  }
  magnified();
  show(Math.min(frame, frames - 1));
}

// --- controls ---
play.addEventListener("click", () => go(!playing));
back.addEventListener("click", () => { go(false); show(frame - 1); });
next.addEventListener("click", () => { go(false); show(frame + 1); });
scrub.addEventListener("input", () => { go(false); show(Number(scrub.value)); });
whole.addEventListener("change", draw);
forces.addEventListener("change", draw);
names.addEventListener("change", draw);
magnify.addEventListener("input", magnified);
if (choice) {
  films.forEach((film, number) => choice.add(new Option(film.label, number)));
  choice.addEventListener("change", () => load(Number(choice.value)));
}
if (shortcuts) document.addEventListener("keydown", event => {
  if (event.target !== document.body || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === " ") go(!playing);
  else if (event.key === "ArrowLeft") { go(false); show(frame - 1); }
  else if (event.key === "ArrowRight") { go(false); show(frame + 1); }
  else return;
  event.preventDefault();
});
window.addEventListener("beforeprint", () => {
  go(false);
  stage.tint();
  const count = Math.min(ON_PAPER, frames);
  const spacing = stage.strip(Array.from({ length: count }, (_, k) => Math.round(k / Math.max(1, count - 1) * (frames - 1))));
  printed.textContent = `Grid lines are ${Number(spacing.toPrecision(3))} m apart.`;
});
window.addEventListener("afterprint", () => { stage.tint(); stage.fit(); draw(); });
window.addEventListener("resize", () => { stage.fit(); draw(); });
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { stage.tint(); draw(); });
new IntersectionObserver(([entry]) => { visible = entry.isIntersecting; roll(); }).observe(canvas);

load(0);
if (!calm.matches) go(true);
})();
