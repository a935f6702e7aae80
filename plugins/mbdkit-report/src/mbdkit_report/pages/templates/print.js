"use strict";
// Loaded first, so that the other scripts redraw after the class has put the colours and sizes of paper in force.
for (const [name, on] of [["beforeprint", true], ["afterprint", false]]) window.addEventListener(name, () => {
  document.documentElement.classList.toggle("printing", on);
  for (const rows of document.querySelectorAll("details.rows")) rows.open = on;
});
