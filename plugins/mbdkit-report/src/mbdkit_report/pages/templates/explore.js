"use strict";
(() => {
const { sliders, reference } = JSON.parse(document.getElementById("data").textContent);
const token = new URLSearchParams(location.search).get("token");
const element = id => document.getElementById(id);
const [verdict, headlines, curves, spec] = ["verdict", "headlines", "curves", "spec"].map(element);
const ghost = new Stage(element("ghost")), stage = new Stage(element("stage"));
ghost.named = false;
const [inputs, fields] = ["range", "number"].map(type => [...document.querySelectorAll(`input[type=${type}]`)]);
const short = value => String(Number(value.toPrecision(4)));
let shown = reference, ghostView, begin = performance.now(), asked = false, changed = false;

// --- sliders: 1000 steps from end to end; a value that is typed may lie between two steps or beyond the ends ---
const typed = sliders.map(() => null);
const place = (one, value = one.value) => Math.round(1000 * (value - one.low) / (one.high - one.low));
function valueOf(index) {
  const one = sliders[index], at = Number(inputs[index].value);
  if (typed[index] !== null) return typed[index];
  return at === place(one) ? one.value : Number((one.low + (one.high - one.low) * at / 1000).toPrecision(6));
}
function label(index) {
  const value = String(typed[index] ?? Number(valueOf(index).toPrecision(6))), { unit } = sliders[index];
  fields[index].value = value;
  inputs[index].setAttribute("aria-valuetext", unit ? `${value} ${unit}` : value);
}
function reset() {
  sliders.forEach((one, index) => {
    typed[index] = null;
    inputs[index].value = place(one);
    label(index);
  });
}
function take(index) {
  if (fields[index].value === "") return label(index);   // not a number
  typed[index] = Number(fields[index].value);
  inputs[index].value = place(sliders[index], typed[index]);
  label(index);
  ask();
}
const values = () => Object.fromEntries(sliders.map((one, index) => [one.key, valueOf(index)]));

// --- a run for each state of the sliders; states in between are skipped while one is computed ---
async function ask() {
  changed = true;
  if (asked) return;
  asked = true;
  try {
    while (changed) {
      changed = false;
      const reply = await fetch("answer", {
        method: "POST", headers: { "x-token": token, "content-type": "application/json" }, body: JSON.stringify(values()),
      });
      if (!reply.ok) throw new Error(String(reply.status));
      show(await reply.json());
    }
  } catch {
    refuse("The program that computes this page has ended.");
  }
  asked = false;
}

// --- an answer ---
/* Without an answer for the sliders, results of the last valid values stay visible, but faded. */
function stale(isStale) {
  document.body.classList.toggle("stale", isStale);
  for (const name of ["copy", "save"]) element(name).disabled = isStale;
}
function refuse(reason) {
  const rest = shown.error ? "" : " The faded results below belong to the last valid values.";
  verdict.textContent = `${reason.replace(/\.?$/, ".")}${rest}`;
  verdict.className = "verdict alarm";
  stale(true);
}
function show(answer) {
  spec.textContent = answer.spec;
  if (answer.error) {
    refuse(answer.error);
    return;
  }
  stale(false);
  shown = answer;
  verdict.textContent = [`Verdict: ${answer.verdict}`, ...answer.reasons].join(". ");
  verdict.className = `verdict ${answer.tone}`;
  headlines.replaceChildren(...answer.headlines.map(([name, text, id]) => {
    const item = document.createElement("div"), term = document.createElement("dt"), number = document.createElement("dd");
    term.textContent = name;
    number.textContent = text;
    number.dataset.id = id;
    item.append(term, number);
    return item;
  }));
  if (reference.film) {
    const views = [reference.film.view, answer.film.view];
    const view = [0, 1, 2, 3].map(k => (k % 2 ? Math.max : Math.min)(...views.map(one => one[k])));
    const placed = film => ({ ...film, view, poses: moved(film, view) });
    if (String(view) !== String(ghostView)) ghost.show(placed(reference.film));
    ghostView = view;
    stage.show(placed(answer.film));
  } else stage.show(answer.film);
  const kinds = String(answer.charts.map(chart => chart.name));
  if (kinds !== curves.dataset.kinds) curves.replaceChildren(...answer.charts.flatMap(chart => {
    const canvas = document.createElement("canvas"), key = document.createElement("ul");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${chart.title} over time; pale: with the values of the spec`);
    return [canvas, key];
  }));
  curves.dataset.kinds = kinds;
  answer.charts.forEach((chart, k) => curves.children[2 * k + 1].replaceChildren(...chart.lines.map(line => {
    const item = document.createElement("li");
    item.append(swatch(line), line.label);
    return item;
  })));
  draw();
}

/* Poses are relative to the centre of the view. */
function moved(film, view) {
  const [grain] = film.grain, own = film.view;
  const x = ((own[0] + own[1]) - (view[0] + view[1])) / 2 / grain, y = ((own[2] + own[3]) - (view[2] + view[3])) / 2 / grain;
  return film.poses.map((value, k) => value === null || k % 3 === 2 ? value : value + (k % 3 ? y : x));
}

// --- curves ---
function plot(canvas, chart, seconds) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight, { colors } = stage;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const pen = canvas.getContext("2d"), pale = (reference.charts ?? []).find(one => one.name === chart.name) ?? chart;
  const all = [...pale.lines, ...chart.lines].flatMap(line => line.y), times = chart.lines[0].x;
  const low = Math.min(0, ...all), high = Math.max(...all, low + 1e-12), left = 48, bottom = 18, top = 24;
  const X = t => left + (width - left - 4) * (t - times[0]) / (times.at(-1) - times[0] || 1);
  const Y = v => (height - bottom) - (height - bottom - top) * (v - low) / (high - low);
  pen.scale(ratio, ratio);
  pen.font = "12px system-ui";
  pen.fillStyle = colors.faint;
  pen.strokeStyle = colors.grid;
  for (const value of [low, (low + high) / 2, high]) {
    pen.fillText(short(value), 0, Math.max(top + 4, Y(value) + 4));
    pen.beginPath(); pen.moveTo(left, Y(value)); pen.lineTo(width, Y(value)); pen.stroke();
  }
  pen.fillText(short(times[0]), left, height - 4);
  pen.fillText(chart.y.title, 0, 11);
  const end = `${short(times.at(-1))}   ${chart.x.title}`;
  pen.fillText(end, width - pen.measureText(end).width - 2, height - 4);
  for (const set of [pale, chart]) for (const line of set.lines) {
    pen.globalAlpha = set === chart ? 1 : 0.3;
    pen.strokeStyle = colors[(chart.lines.find(one => one.label === line.label) ?? line).color];
    pen.setLineDash(DASHES[line.dash].split(" ").filter(Boolean).map(Number));
    pen.lineWidth = 1.6;
    pen.beginPath();
    line.y.forEach((value, i) => { if (value !== null) pen[i ? "lineTo" : "moveTo"](X(line.x[i]), Y(value)); });
    pen.stroke();
  }
  pen.globalAlpha = 1;
  pen.setLineDash([]);
  pen.strokeStyle = colors.ink;
  pen.beginPath(); pen.moveTo(X(seconds), top); pen.lineTo(X(seconds), height - bottom); pen.stroke();
}

// --- motion ---
function frameAt(film, seconds) {
  const count = film.time.length, start = film.time[0], end = film.time[count - 1];
  return Math.min(count - 1, Math.max(0, Math.round((seconds - start) / (end - start || 1) * (count - 1))));
}
function draw() {
  const { film } = shown;
  if (!film) return;
  const start = film.time[0], length = film.time.at(-1) - start;
  const seconds = calm.matches ? start + length : start + (performance.now() - begin) / 1000 * film.speed % (length || 1);
  if (reference.film) ghost.draw(frameAt(reference.film, seconds), false, 1);
  stage.draw(frameAt(film, seconds), false, 1);
  shown.charts.forEach((chart, k) => plot(curves.children[2 * k], chart, seconds));
}
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
function tick() {
  if (!calm.matches) draw();
  requestAnimationFrame(tick);
}
function fit() {
  if (!shown.film) return;
  stage.fit();
  if (reference.film) ghost.fit();
  draw();
}

inputs.forEach((input, index) => input.addEventListener("input", () => { typed[index] = null; label(index); ask(); }));
fields.forEach((field, index) => field.addEventListener("change", () => take(index)));
element("sliders").addEventListener("submit", event => event.preventDefault());   // Enter in a field
element("reset").addEventListener("click", () => { reset(); ask(); });
element("copy").addEventListener("click", () => navigator.clipboard.writeText(spec.textContent));
element("save").addEventListener("click", () => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([spec.textContent], { type: "text/yaml" }));
  link.download = "spec.yaml";
  link.click();
  URL.revokeObjectURL(link.href);
});
window.addEventListener("resize", fit);
let fitted = curves.clientWidth;
new ResizeObserver(() => {                             // a scrollbar that appears changes the width without a "resize"
  if (curves.clientWidth !== fitted) fit();
  fitted = curves.clientWidth;
}).observe(curves);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { stage.tint(); ghost.tint(); fit(); });
reset();
show(reference);
tick();
})();
