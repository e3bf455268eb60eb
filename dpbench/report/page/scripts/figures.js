// The figures that follow the selection: drawn for the width there is, marked, clicked, steered.
"use strict";

const NARROW = 640;  // A figure of less than this many pixels is drawn for a phone.
const views = {}, forms = {};
const HARD_ONLY = 64;  // Bit of a step that a thinned run keeps only since it is a hard one.
const CANVAS = ["strips", "pairs", "behind", "seas"];
const OF_STUDY = ["design", "behind", "seas"];

async function figureOf(name) {
  const host = $(`figure-${name}`);
  const form = formOf(name);
  if (!host || !facts.charts[form]) return null;
  if (views[name] && forms[name] !== form) {
    views[name].then((old) => old.finalize());
    delete views[name];
  }
  forms[name] = form;
  views[name] ??= made(name, host, form);
  return views[name];
}

// A replay has no forces, so no strip of them; a design of many values is no table.
function formOf(name) {
  if (name === "design") return asTiles(studied()) ? "design_tiles" : "design_points";
  return name === "strips" && facts.places[state.p].mode === "replay" ? "strips_replay" : name;
}

// A view drawn aside first: the figure that stands there is replaced only by a finished one.
async function made(name, host, form) {
  const spec = sized(form, Math.floor(host.parentElement.clientWidth)), aside = document.createElement("div");
  const view = new vega.View(vega.parse(CANVAS.includes(name) ? inked(spec) : spec), {
    renderer: CANVAS.includes(name) ? "canvas" : "svg", hover: true, tooltip: vegaTooltip(),
    loader: { load: () => null },
  });
  await view.initialize(aside).runAsync();
  if (forms[name] !== form) return view;
  host.replaceChildren(aside);
  // What paper has to make up for.
  host.classList.toggle("narrow", host.parentElement.clientWidth < NARROW);
  host.classList.toggle("dark", matchMedia("(prefers-color-scheme: dark)").matches);
  view.addEventListener("click", (event, item) => picked(name, item?.datum, view, event));
  return view;
}

// The specification for the width there is.
function sized(name, width) {
  const narrow = width < NARROW;
  const set = (spec, values) => ({ ...spec, signals: (spec.signals ?? []).map((signal) =>
    signal.name in values ? { ...signal, value: values[signal.name] } : signal) });
  const spec = facts.charts[name];
  if (name === "matrix") {
    const table = spec.data.find((d) => d.values), below = facts.charts.matrix_narrow;
    const at = !narrow ? spec
      : { ...below, data: below.data.map((d) => (d.values ? { ...d, values: table.values } : d)) };
    const of = (key) => unique(table.values.map((row) => row[key]));
    const tiles = at.usermeta.tall ? ["solver", "place"] : ["place", "solver"];
    const labels = 14 + 7 * Math.max(...of(tiles[1]).map((text) => text.length));
    const levels = narrow ? 1 : of("settings").length, slant = narrow ? 0 : 90;
    const step = (width - labels - slant - 16 * levels) / (levels * of(tiles[0]).length);
    return set({ ...at, marks: explained(at.marks) }, { x_step: Math.max(14, Math.min(46, step)) });
  }
  if (name.startsWith("strips")) return { ...spec, width: width - 78, autosize: { type: "pad", resize: true } };
  const fit = { type: name === "pairs" ? "fit" : "fit-x", contains: "padding", resize: true };
  const square = Math.min(width, 460);
  // On paper the ladder shares its sheet: names above its bars would take the matrix's place.
  const above = narrow && (name !== "ladder" || innerWidth < NARROW);
  if (name.startsWith("design")) return { ...named(spec), width, autosize: fit };
  return name === "pairs" ? { ...named(spec), width: square, height: square, autosize: fit }
    : set({ ...spec, width, autosize: fit, marks: apart(spec.marks), axes: spec.axes.map(clickable) },
      above ? { narrow: true, y_step: facts.row_step.narrow } : { narrow: false });
}

// Names of places say what they are to who points at one, wherever among these marks an axis is.
function explained(node) {
  if (Array.isArray(node)) return node.map(explained);
  if (node === null || typeof node !== "object") return node;
  return Object.fromEntries(Object.entries(node).map(([name, part]) =>
    [name, name === "axes" ? part.map(withTips) : explained(part)]));
}

function withTips(axis) {
  const says = Object.fromEntries(facts.places.filter((place) => place.shows).map((place) => [place.label, place.shows]));
  const known = `${JSON.stringify(says)}[datum.value]`, labels = axis.encode?.labels;
  return axis.labels === false ? axis : { ...axis, encode: { ...axis.encode, labels: { ...labels, interactive: true,
    update: { ...labels?.update, tooltip: { signal: `${known} ? {'in': datum.value, 'is': ${known}} : null` } } } } };
}

// Names of rows take clicks.
function clickable(axis) {
  const labels = axis.encode?.labels;
  return axis.scale !== "y" || axis.labels === false ? axis : { ...axis, encode: { ...axis.encode,
    labels: { ...labels, interactive: true, update: { ...labels?.update, cursor: { value: "pointer" } } } } };
}

// Axes called by what is compared, in signals of the first word of their titles: Vega-Lite cannot
// say so.
function named(spec) {
  const name = (axis) => axis.title.split(" ")[0];
  const called = (axis) => (axis.title ? { ...axis, title: { signal: name(axis) } } : axis);
  const names = unique(spec.axes.filter((axis) => axis.title).map(name));
  return { ...spec, axes: spec.axes.map(called),
    signals: [...(spec.signals ?? []), ...names.map((one) => ({ name: one, value: "" }))] };
}

// Names keep off the points too.
function apart(marks) {
  const points = marks.filter((mark) => mark.type === "symbol").map((mark) => mark.name);
  return marks.map((mark) => mark.transform?.[0].type !== "label" ? mark :
    { ...mark, transform: [{ ...mark.transform[0], avoidMarks: points, avoidBaseMark: true }] });
}

// Joined figures have no width as a whole: that of the panels is what the axes leave.
async function fill(view, host) {
  const room = Math.floor(host.parentElement.clientWidth);
  const taken = host.querySelector("canvas").clientWidth;
  if (taken !== room) await view.width(view.width() + room - taken).runAsync();
}

// All figures once more: the colours or the width there is have changed.
async function redraw() {
  const had = Object.keys(views);
  for (const name of had) { (await views[name])?.finalize(); delete views[name]; }
  for (const name of had) await figureOf(name);
  if ($("percentile")) await signal("accuracy", { percentile: $("percentile").value });
  if ($("matrix-way")?.value) await drawMatrix();
  await draw();
}

// The step nearest to a click anywhere among the strips.
function nearestStep(view, event) {
  const x = event.clientX - view.container().querySelector("canvas").getBoundingClientRect().left;
  const wanted = view.scale("x").invert(x - view.origin()[0] - view.padding().left);
  const rows = rowsOf(cell(state.c, state.p));
  return rows.reduce((best, row) => (Math.abs(row.k - wanted) < Math.abs(best.k - wanted) ? row : best)).k;
}

function picked(name, datum, view, event) {
  if (name === "strips") { select({ k: datum?.k ?? nearestStep(view, event) }); return; }
  if (!datum) return;
  if (OF_STUDY.includes(name)) { pickedOfStudy(datum); return; }
  // A name at the axis stands for its row.
  if (name === "ladder" && datum.id === undefined)
    datum = rowsDrawn("ladder").values.find((row) => row.label === datum.value) ?? datum;
  if (datum.id !== undefined) {
    const change = { c: Number(datum.id) };
    if (change.c < 0) return;
    if (datum.place_id !== undefined) change.p = Number(datum.place_id);
    if (C().solver[change.c] !== undefined) select({ ...change, k: null });
  }
}

// The rows that a figure was written with.
function rowsDrawn(name) {
  return facts.charts[name].data.find((data) => data.values?.[0]?.id !== undefined);
}

// The tiles of the matrix: as it was written, or all of one way of running the solvers.
function tiles() {
  // Copies by name: the figure has numbered its rows by a symbol, and takes a number once.
  const own = rowsDrawn("matrix").values.map((row) => Object.fromEntries(Object.entries(row)));
  const wanted = $("matrix-way").value;
  return !wanted ? own : own.map((row) => {
    const c = all().find((i) => C().solver[i] === row.solver && way(i) === wanted
      && C().settings[i] === row.settings) ?? -1;
    const run = cell(c, Number(row.place_id));
    return { ...row, way: wanted.replace("-", " "), id: String(c), state: run?.state ?? "not run", error: run?.error ?? null,
      failed: run?.failed ?? null, detail: run?.why ?? "" };
  });
}

async function drawMatrix() {
  const view = await figureOf("matrix");
  if (view) await view.data(rowsDrawn("matrix").name, tiles()).runAsync();
}

// The rows and tiles that can be chosen in a figure, each at its place in the grid that is seen.
function grid(name) {
  const own = name === "matrix" ? tiles() : rowsDrawn(name).values;
  if (name === "ladder") return own.map((row, y) => ({ c: Number(row.id), x: 0, y }));
  const of = (key) => unique(own.map((row) => row[key]));
  const levels = of("settings"), solvers = of("solver"), places = of("place");
  const below = $("figure-matrix").classList.contains("narrow");
  const { tall } = facts.charts[below ? "matrix_narrow" : "matrix"].usermeta;
  const [across, down] = tall ? [solvers, places] : [places, solvers];
  return own.map((row) => {
    const level = levels.indexOf(row.settings);
    const [x, y] = [row.place, row.solver].map((value, i) => [places, solvers][i].indexOf(value));
    return { c: Number(row.id), p: Number(row.place_id),
      x: (tall ? y : x) + (below ? 0 : level * across.length),
      y: (tall ? x : y) + (below ? level * down.length : 0) };
  }).filter((tile) => tile.c >= 0);
}

// A figure that the arrow keys choose in, as a click does; Enter opens what is chosen.
function steerable(name) {
  const host = $(`figure-${name}`);
  if (!host) return;
  host.tabIndex = 0;
  host.setAttribute("role", "application");
  host.setAttribute("aria-label", `${facts.charts[name].description} Arrow keys choose, Enter opens.`);
  host.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (event.key === "Enter") go("one");
    if (!step) return;
    event.preventDefault();
    const known = grid(name), [dx, dy] = step;
    const at = known.find((t) => t.c === state.c && (t.p ?? state.p) === state.p)
      ?? known.find((t) => C().solver[t.c] === C().solver[state.c]) ?? known[0];
    const ahead = (t) => (t.x - at.x) * dx + (t.y - at.y) * dy;
    const next = known.filter((t) => ahead(t) > 0 && (dx ? t.y === at.y : t.x === at.x))
      .sort((a, b) => ahead(a) - ahead(b))[0];
    if (next) select({ c: next.c, p: next.p ?? state.p, k: null });
  });
}

async function signal(name, values) {
  const view = await figureOf(name);
  if (!view) return;
  for (const [key, value] of Object.entries(values)) view.signal(key, value);
  await view.runAsync();
}

// What is chosen is marked in the figure, however it was chosen.
async function mark(name, values) {
  const view = await figureOf(name);
  if (!view) return;
  const fields = Object.keys(values).map((field) => ({ type: "E", field }));
  view.data("pick_store", [{ unit: "", fields, values: Object.values(values) }]);
  await view.runAsync();
}
