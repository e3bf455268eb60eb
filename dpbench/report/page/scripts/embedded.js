// Solvers on the ship's computer: counted instructions as times, at a clock and cycles per instruction.
"use strict";

FIGURES.embedded = { picked: () => {} };

async function drawCoreTimes() {
  $("cpi").value = plain(state.cpi);
  $("mhz").value = plain(state.mhz);
  const { deadline_ms } = facts.requirements, cycles = state.cpi === 1 ? "cycle" : "cycles";
  $("core-said").textContent = `Assumed: ${figure(state.cpi)} ${cycles} per instruction at `
    + `${figure(state.mhz)} MHz; ${deadline_ms === null ? "no deadline is known" : `deadline of ${deadline_ms} ms`}.`;
  const ns = (instructions) => 1e3 * instructions * state.cpi / state.mhz;
  facts.counts.forEach(({ p99, worst }, i) => {
    const texts = [time(ns(p99)), time(ns(worst)), deadline_ms === null ? "–" : `${figure(ns(worst) / deadline_ms / 1e4, 2)} %`];
    const { cells } = $("core-times").tBodies[0].rows[i];
    texts.forEach((text, j) => { cells[2 + j].textContent = text; });
  });
  await figureOf("embedded");
}

SECTIONS.push({
  id: "core-times", after: ["cpi", "mhz"], draw: drawCoreTimes,
  listen: () => {
    on("cpi", "change", (value) => select({ cpi: positive(value, 1) }));
    on("mhz", "change", (value) => select({ mhz: positive(value, 100) }));
  },
});
