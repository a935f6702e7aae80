"use strict";
(() => {
// --- files, made in the page: nothing is sent ---
function download(text, type, name) {
  const link = document.createElement("a"), address = URL.createObjectURL(new Blob([text], { type }));
  link.href = address;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}

function button(label, about, action) {
  const made = document.createElement("button");
  made.type = "button";
  made.textContent = label;
  made.setAttribute("aria-label", `${label}: ${about}`);
  made.addEventListener("click", () => action(made));
  return made;
}

function tools(after, ...buttons) {
  const box = document.createElement("div");
  box.className = "tools";
  box.append(...buttons);
  after.after(box);
}

// --- CSV ---
// As `csv_cell` of mbdkit.base.text: control characters are shown, and no spreadsheet takes a text for a formula.
const HIDDEN = /[\u0000-\u001f\u007f-\u009f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff]/g;
const shown = text => text.replace(HIDDEN, char => `\\u${char.charCodeAt(0).toString(16).padStart(4, "0")}`);
const harmless = text => /^[=+\-@\uff1d\uff0b\uff0d\uff20]/.test(text) ? `'${text}` : text;
const quoted = text => /[",']/.test(text) ? `"${text.replace(/"/g, '""')}"` : text;
const content = cell => cell.dataset.value ?? quoted(harmless(shown(cell.textContent.trim().replace(/\s+/g, " "))));
const csv = rows => rows.map(row => [...row.cells].map(content).join(",") + "\r\n").join("");

// --- sorting ---
function compare(a, b) {
  const [x, y] = [a, b].map(cell => cell.dataset.value), [s, t] = [a, b].map(cell => cell.textContent.trim());
  if (x !== undefined && y !== undefined) return Number(x) - Number(y);
  return s.localeCompare(t, "en", { numeric: true });
}

const blank = cell => cell.dataset.value === undefined && ["", "-"].includes(cell.textContent.trim());

// On a telephone each row is a list of names and values.
function stackable(table) {
  const labels = [...table.tHead.rows[0].cells].map(head => head.textContent.trim());
  if (labels.length < 4) return;
  table.classList.add("stack");
  for (const row of table.tBodies[0].rows) [...row.cells].forEach((cell, k) => { cell.dataset.label = labels[k]; });
}

function sortable(table) {
  const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells], rows = [...body.rows];
  if (rows.length < 2) return;
  heads.forEach((head, column) => {
    const turn = head.classList.contains("number") ? ["descending", "ascending"] : ["ascending", "descending"];
    const control = document.createElement("button");
    control.type = "button";
    control.append(...head.childNodes);
    head.append(control);
    control.addEventListener("click", () => {
      const next = turn[turn.indexOf(head.getAttribute("aria-sort")) + 1];   // after the last one, the first order
      for (const other of heads) other.removeAttribute("aria-sort");
      if (next) head.setAttribute("aria-sort", next);
      const sign = next === "descending" ? -1 : 1;
      body.append(...(next ? [...rows].sort((a, b) => {
        const [one, two] = [a.cells[column], b.cells[column]];
        return blank(one) - blank(two) || sign * compare(one, two);
      }) : rows));
    });
  });
}

for (const table of document.querySelectorAll("table[data-file]")) {
  const title = table.caption.textContent;
  tools(table.parentElement, button("Download CSV", title, () =>
    download(csv([...table.rows]), "text/csv;charset=utf-8", `${table.dataset.file}.csv`)));
  stackable(table);
  sortable(table);
}

// --- listings ---
async function copy(listing, pressed) {
  try {
    await navigator.clipboard.writeText(listing.textContent);
  } catch {                                                    // no clipboard without a secure context
    getSelection().selectAllChildren(listing);
    document.execCommand("copy");
    getSelection().removeAllRanges();
  }
  pressed.textContent = "Copied";
  setTimeout(() => { pressed.textContent = "Copy"; }, 1500);
}

for (const listing of document.querySelectorAll("pre")) {
  const label = listing.getAttribute("aria-label"), { file } = listing.dataset;
  const made = [button("Copy", label, pressed => copy(listing, pressed))];
  if (file) made.push(button("Download", file, () => download(listing.textContent, "text/plain;charset=utf-8", file)));
  tools(listing, ...made);
}
})();
