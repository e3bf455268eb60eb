// The matrix of solvers and experiments: its tiles, for any call mode of the solvers.
"use strict";

// The tiles of the matrix: as it was written, or all of one call mode.
function tiles() {
  // Copies by name: the figure has numbered its rows by a symbol, and takes a number once.
  const own = rowsDrawn("matrix").values.map((row) => Object.fromEntries(Object.entries(row)));
  const wanted = $("matrix-mode").value;
  return !wanted ? own : own.map((row) => {
    const c = all().find((i) => C().solver[i] === row.solver && callMode(i) === wanted
      && C().settings[i] === row.settings) ?? -1;
    const run = cell(c, Number(row.experiment_id));
    return { ...row, call_mode: wanted.replace("-", " "), id: String(c), verdict: run?.verdict ?? "not run", error: run?.error ?? null,
      failed: run?.failed ?? null, detail: run?.why ?? "" };
  });
}

// The result of the selected cell, below the cells.
function drawSelected() {
  const run = cell(state.c, state.p), link = document.createElement("a");
  link.href = "#one";
  link.textContent = "Show its steps";
  link.addEventListener("click", (event) => { event.preventDefault(); go("one"); });
  $("matrix-said").replaceChildren(...coded(!run ? `${marked(state.c)} was not run in \`${facts.experiments[state.p].label}\`.`
    : `${verdictOf(run, marked(state.c))}${unverifiedOf(run) ? `, although ${unverifiedOf(run)}` : [wrongOf(run), run.reason].filter(Boolean).map((text, i) => `${i ? ";" : ":"} ${text}`).join("")}.`), " ", link);
}

async function drawMatrix() {
  const view = await figureOf("matrix");
  if (view) await view.data(rowsDrawn("matrix").name, tiles()).runAsync();
}

// Names of experiments say what they are to who points at one, wherever among these marks an axis is.
function explained(node) {
  if (Array.isArray(node)) return node.map(explained);
  if (node === null || typeof node !== "object") return node;
  return Object.fromEntries(Object.entries(node).map(([name, part]) =>
    [name, name === "axes" ? part.map(withTips) : explained(part)]));
}

function withTips(axis) {
  const says = Object.fromEntries(facts.experiments.filter((experiment) => experiment.shows).map((experiment) => [experiment.label, experiment.shows]));
  const known = `${JSON.stringify(says)}[datum.value]`, labels = axis.encode?.labels;
  return axis.labels === false ? axis : { ...axis, encode: { ...axis.encode, labels: { ...labels, interactive: true,
    update: { ...labels?.update, tooltip: { signal: `${known} ? {'scenario or replay': datum.value, 'description': ${known}} : null` } } } } };
}

FIGURES.matrix = {
  sized: (wide, width) => {
    const table = wide.data.find((d) => d.values), below = facts.charts.matrix_narrow, narrow = width < NARROW;
    const spec = !narrow ? wide
      : { ...below, data: below.data.map((d) => (d.values ? { ...d, values: table.values } : d)) };
    const of = (key) => unique(table.values.map((row) => row[key]));
    const axes = spec.usermeta.tall ? ["solver", "experiment"] : ["experiment", "solver"];
    const labels = 14 + 7 * Math.max(...of(axes[1]).map((text) => text.length));
    const levels = narrow ? 1 : of("settings").length, slant = narrow ? 0 : 90;
    const step = (width - labels - slant - 16 * levels) / (levels * of(axes[0]).length);
    return withSignals({ ...spec, marks: explained(spec.marks) }, { x_step: Math.max(14, Math.min(46, step)) });
  },
  grid: () => {
    const own = tiles(), of = (key) => unique(own.map((row) => row[key]));
    const levels = of("settings"), solvers = of("solver"), experiments = of("experiment");
    const below = $("figure-matrix").classList.contains("narrow");
    const { tall } = facts.charts[below ? "matrix_narrow" : "matrix"].usermeta;
    const [across, down] = tall ? [solvers, experiments] : [experiments, solvers];
    return own.map((row) => {
      const level = levels.indexOf(row.settings);
      const [x, y] = [row.experiment, row.solver].map((value, i) => [experiments, solvers][i].indexOf(value));
      return { c: Number(row.id), p: Number(row.experiment_id),
        x: (tall ? y : x) + (below ? 0 : level * across.length),
        y: (tall ? x : y) + (below ? level * down.length : 0) };
    }).filter((tile) => tile.c >= 0);
  },
};
SECTIONS.push({
  id: "matrix", after: ["c", "p"],
  draw: () => { drawSelected(); return mark("matrix", { id: String(state.c), experiment_id: String(state.p) }); },
  redraw: () => $("matrix-mode").value && drawMatrix(),
  listen: () => {
    steerable("matrix", "cell");
    $("matrix-mode").append(...unique(all().map(callMode)).map((w) => new Option(w.replace("-", " "), w)));
    on("matrix-mode", "change", drawMatrix);
  },
});
