"use strict";
(() => {
const { figures, columns } = JSON.parse(document.getElementById("figure-data").textContent);
for (const { lines } of Object.values(figures)) for (const line of lines) {
  [line.x, line.y] = [columns[line.x], columns[line.y]];
}
const dark = window.matchMedia("(prefers-color-scheme: dark)"), coarse = window.matchMedia("(pointer: coarse)");
const MARGIN = { l: 62, r: 14, t: 8, b: 48 };
// With equal scales, automatic margins would oscillate: labels change the margins, which change the scale and labels.
const EQUAL = { scaleanchor: "x", scaleratio: 1, automargin: false };
// plotly.js reads texts as markup; names from specs are plain text.
const plain = text => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

const paper = () => document.documentElement.classList.contains("printing");

function palette() {
  const style = getComputedStyle(document.documentElement);
  return name => style.getPropertyValue(`--${name}`).trim();
}

function traces(figure, color) {
  // Different widths keep coinciding paths distinguishable.
  const width = number => figure.equal && figure.lines.length < 5 ? 1.6 + 1.3 * (figure.lines.length - 1 - number) : 1.8;
  const curves = figure.lines.map((line, number) => ({
    type: "scatter", visible: !line.hidden, x: line.x, y: line.y, name: plain(line.label),
    mode: { line: "lines", points: "markers", both: "lines+markers" }[line.x.length === 1 ? "points" : line.kind],
    line: { color: color(line.color), width: width(number) * (line.is_emphasized ? 1.8 : 1), dash: line.dash },
    marker: { color: color(line.color), size: 7, symbol: line.symbol },
    hovertemplate: `%{y:.4~g} ${plain(figure.y.unit)} at %{x:.5~g} ${plain(figure.x.unit)}<extra>%{fullData.name}</extra>`,
  }));
  return [...curves, ...banded(figure).map(line => ({                        // after the curves, which keep their numbers
    type: "scatter", mode: "lines", visible: !line.hidden, x: line.band.x, y: line.band.y, fill: "toself",
    fillcolor: color(line.color), opacity: 0.25, line: { width: 0 }, hoverinfo: "skip",
  })), ...figure.guides.map(guide => ({
    type: "scatter", mode: "lines", x: guide.x, y: guide.y, hoverinfo: "skip",
    line: { color: color("faint"), width: 1.2, dash: "dot" },
  }))];
}

// Annotations on a logarithmic axis are placed by the logarithm.
const coordinate = (value, axis) => axis.log ? Math.log10(value) : value;
const middle = ([a, b], axis) => (coordinate(a, axis) + coordinate(b, axis)) / 2;

function banded(figure) {
  return figure.lines.filter(line => line.band);
}

// The labels of a logarithmic axis that spans few decades: by default, digits stand between powers of ten. Numbers are
// written out or, where they are too long for that, shown at powers of ten only.
function notation(one, values) {
  if (!one.log) return {};
  let low = Infinity, high = 0;
  for (const value of values) if (value > 0) [low, high] = [Math.min(low, value), Math.max(high, value)];
  if (low >= 1e-3 && high < 1e5) return { tickformat: "~r" };
  return high < 700 * low && high > 5 * low ? { dtick: 1 } : {};
}

function axis(one, color, values, more) {
  return {
    title: { text: plain(one.title), standoff: 10, font: { size: paper() ? 11 : 13 } }, type: one.log ? "log" : "linear",
    exponentformat: "power", minexponent: 4, automargin: true, gridcolor: color("grid"), linecolor: color("edge"),
    zeroline: false, ticks: "outside", tickcolor: color("edge"), tickfont: { size: paper() ? 10 : 12 },
    nticks: one.log ? 4 : paper() ? 6 : 8, ...notation(one, values), ...more,    // more on a logarithmic axis would be digits between the decades
  };
}

function layout(figure, color) {
  return {
    paper_bgcolor: color("paper"), plot_bgcolor: color("paper"), margin: { ...MARGIN }, autosize: true,
    font: { family: "system-ui, sans-serif", size: 13, color: color("ink") },
    xaxis: axis(figure.x, color, figure.lines.flatMap(line => line.x)),
    yaxis: axis(figure.y, color, figure.lines.flatMap(line => line.y), figure.equal ? EQUAL : {}),
    showlegend: false, hovermode: "closest", dragmode: coarse.matches ? false : "zoom",
    hoverlabel: { bgcolor: color("card"), bordercolor: color("edge"), font: { color: color("ink") } },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: color("faint"), activecolor: color("c0") },
    shapes: [...figure.bands.map(band => ({
      type: "rect", xref: "paper", x0: 0, x1: 1, y0: band.low, y1: band.high, layer: "below",
      fillcolor: color("faint"), opacity: 0.18, line: { width: 0 },
    })), ...figure.marks.map(mark => ({
      type: "line", yref: "paper", x0: mark.x, x1: mark.x, y0: 0, y1: 1, layer: "below",
      line: { width: 1, dash: "dot", color: color("faint") },
    }))],
    annotations: [...figure.bands.map(band => ({
      text: plain(band.label), xref: "paper", x: 0.01, xanchor: "left", showarrow: false, yanchor: "top",
      y: coordinate(band.high, figure.y), font: { size: 11, color: color("faint") },
    })), ...figure.marks.filter(mark => mark.label).map(mark => ({
      text: plain(mark.label), x: mark.x, xanchor: "left", yref: "paper", y: 1, yanchor: "top", showarrow: false,
      textangle: -90, font: { size: 11, color: color("faint") },
    })), ...figure.guides.map(guide => ({
      text: plain(guide.label), x: middle(guide.x, figure.x), y: middle(guide.y, figure.y), showarrow: false,
      bgcolor: color("paper"), font: { size: 11, color: color("faint") },
    }))],
  };
}

// These buttons and no others: by default there is one that uploads the data.
const OPTIONS = {
  responsive: true, displaylogo: false, displayModeBar: "hover", showSendToCloud: false, plotlyServerURL: "",
  modeBarButtons: [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]],
};

function drawAll() {
  const color = palette();
  for (const chart of document.querySelectorAll(".chart")) {
    const figure = figures[chart.dataset.figure], kept = chart.layout;
    const wanted = layout(figure, color);
    if (paper()) Object.assign(wanted, { autosize: false, width: chart.clientWidth, height: chart.clientHeight });
    if (kept) for (const name of ["xaxis", "yaxis"]) {       // keep the reader's zoom
      if (kept[name].autorange === false) { wanted[name].range = kept[name].range; wanted[name].autorange = false; }
    }
    Plotly.react(chart, traces(figure, color), wanted, { ...OPTIONS, toImageButtonOptions: { filename: figure.name, scale: 2 } });
  }
}

// --- legend: a button for each curve hides and shows it ---
for (const chart of document.querySelectorAll(".chart")) {
  const key = chart.parentElement.querySelector(".key");
  if (key) figures[chart.dataset.figure].lines.forEach((line, number) => {
    const item = document.createElement("li"), button = document.createElement("button");
    button.type = "button";
    button.setAttribute("aria-pressed", "true");
    button.append(swatch(line), line.label);
    button.addEventListener("click", () => {
      line.hidden = !line.hidden;
      button.setAttribute("aria-pressed", String(!line.hidden));
      const { lines } = figures[chart.dataset.figure], band = banded(figures[chart.dataset.figure]).indexOf(line);
      Plotly.restyle(chart, { visible: !line.hidden }, band < 0 ? [number] : [number, lines.length + band]);
    });
    item.append(button);
    key.append(item);
  });
}

// --- keyboard control ---
function ranges(chart, change) {
  const update = {};
  for (const name of ["xaxis", "yaxis"]) {
    const [low, high] = chart._fullLayout[name].range, [from, to] = change(name, low, high);
    update[`${name}.range`] = [from, to];
    update[`${name}.autorange`] = false;
  }
  Plotly.relayout(chart, update);
}

function zoom(chart, factor) {
  ranges(chart, (name, low, high) => {
    const middle = (low + high) / 2, half = (high - low) / 2 * factor;
    return [middle - half, middle + half];
  });
}

function move(chart, dx, dy) {
  ranges(chart, (name, low, high) => {
    const shift = (high - low) * 0.15 * (name === "xaxis" ? dx : dy);
    return [low + shift, high + shift];
  });
}

const KEYS = {
  "+": chart => zoom(chart, 0.7), "=": chart => zoom(chart, 0.7), "-": chart => zoom(chart, 1 / 0.7),
  "0": chart => Plotly.relayout(chart, { "xaxis.autorange": true, "yaxis.autorange": true }),
  ArrowLeft: chart => move(chart, -1, 0), ArrowRight: chart => move(chart, 1, 0),
  ArrowDown: chart => move(chart, 0, -1), ArrowUp: chart => move(chart, 0, 1),
};

for (const chart of document.querySelectorAll(".chart")) chart.addEventListener("keydown", event => {
  const action = KEYS[event.key];
  if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
  action(chart);
  event.preventDefault();
});

drawAll();
dark.addEventListener("change", drawAll);
window.addEventListener("beforeprint", drawAll);
window.addEventListener("afterprint", drawAll);
})();
