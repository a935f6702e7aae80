"use strict";
/* Samples of lines in legends: dashes and markers as in the charts. */
const DASHES = { solid: "", dash: "6 4", dot: "2 3", dashdot: "6 3 2 3", longdash: "10 4" };
const MARKS = {
  circle: "M14 2.5a3.5 3.5 0 1 0 .01 0z", square: "M10.8 2.8h6.4v6.4h-6.4z", diamond: "M14 1.5l4.5 4.5-4.5 4.5-4.5-4.5z",
  "triangle-up": "M14 1.8l4.4 7.4h-8.8z", cross: "M12.7 1.8h2.6v2.9h2.9v2.6h-2.9v2.9h-2.6v-2.9h-2.9v-2.6h2.9z",
  x: "M10.6 4.4l1.8-1.8 1.6 1.6 1.6-1.6 1.8 1.8-1.6 1.6 1.6 1.6-1.8 1.8-1.6-1.6-1.6 1.6-1.8-1.8 1.6-1.6z",
};

function swatch(line) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const add = (name, attributes) => {
    const part = document.createElementNS(svg.namespaceURI, name);
    for (const [key, value] of Object.entries(attributes)) part.setAttribute(key, value);
    svg.append(part);
  };
  for (const [key, value] of Object.entries({ width: 28, height: 12, "aria-hidden": "true" })) svg.setAttribute(key, value);
  const stroke = `var(--${line.color})`;
  if (line.kind !== "points") add("path", { d: "M0 6h28", style: `stroke:${stroke};stroke-width:${line.is_emphasized ? 3.6 : 2}`, "stroke-dasharray": DASHES[line.dash] });
  if (line.kind !== "line") add("path", { d: MARKS[line.symbol], style: `fill:${stroke}` });
  return svg;
}
