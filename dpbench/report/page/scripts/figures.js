// The figures that follow the selection: drawn for the width there is, marked, clicked, steered.
"use strict";

const NARROW = 640;  // A figure of less than this many pixels is drawn for a phone.
const views = {}, forms = {};
const HARD_ONLY = 64;  // Bit of a step that a thinned run keeps only since it is a hard one.
const FIT = { type: "fit-x", contains: "padding", resize: true };

// What a figure has of its own, by name, registered by the script of its section: `canvas` for many
// marks, `form()` where it has several specifications, `sized(spec, width)`, `picked(datum, view,
// event)` on a click, and `grid()`, the cells of one that arrow keys choose in.
const FIGURES = {};

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

const formOf = (name) => FIGURES[name]?.form?.() ?? name;

// A view drawn aside first: the figure that stands there is replaced only by a finished one.
async function made(name, host, form) {
  const own = FIGURES[name] ?? {}, spec = (own.sized ?? fitted)(facts.charts[form], Math.floor(host.parentElement.clientWidth));
  const aside = document.createElement("div");
  const view = new vega.View(vega.parse(own.canvas ? inked(spec) : spec), {
    renderer: own.canvas ? "canvas" : "svg", hover: true, tooltip: vegaTooltip(),
    loader: { load: () => null },
  });
  await view.initialize(aside).runAsync();
  if (forms[name] !== form) return view;
  host.replaceChildren(aside);
  // What paper has to make up for.
  host.classList.toggle("narrow", host.parentElement.clientWidth < NARROW);
  host.classList.toggle("dark", matchMedia("(prefers-color-scheme: dark)").matches);
  view.addEventListener("click", (event, item) => (own.picked ?? pickedRow)(item?.datum, view, event));
  return view;
}

const withSignals = (spec, values) => ({ ...spec, signals: (spec.signals ?? []).map((signal) =>
  signal.name in values ? { ...signal, value: values[signal.name] } : signal) });

// A figure for a width; `above` puts the names of rows above them.
function fitted(spec, width, above = width < NARROW) {
  return withSignals({ ...spec, width, autosize: FIT, marks: apart(spec.marks), axes: spec.axes.map(clickable) },
    above ? { narrow: true, y_step: facts.row_step.narrow } : { narrow: false });
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

// A row or tile chooses its configuration and experiment.
function pickedRow(datum) {
  const c = Number(datum?.id ?? -1);
  if (c < 0 || C().solver[c] === undefined) return;
  select({ c, ...(datum.experiment_id === undefined ? {} : { p: Number(datum.experiment_id) }), k: null });
}

// The rows that a figure was written with.
function rowsDrawn(name) {
  return facts.charts[name].data.find((data) => data.values?.[0]?.id !== undefined);
}

// A figure that the arrow keys choose in, as a click does; Enter opens what is chosen.
function steerable(name, item) {
  const host = $(`figure-${name}`);
  host.tabIndex = 0;
  host.setAttribute("role", "application");
  host.setAttribute("aria-label", `${facts.charts[name].description} Use the arrow keys to select a ${item} and Enter to show its steps.`);
  host.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (event.key === "Enter") go("one");
    if (!step) return;
    event.preventDefault();
    const known = FIGURES[name].grid(), [dx, dy] = step;
    const at = known.find((t) => t.c === state.c && (t.p ?? state.p) === state.p)
      ?? known.find((t) => C().solver[t.c] === C().solver[state.c]) ?? known[0];
    const ahead = (t) => (t.x - at.x) * dx + (t.y - at.y) * dy;
    const next = known.filter((t) => ahead(t) > 0 && (dx ? t.y === at.y : t.x === at.x))
      .sort((a, b) => ahead(a) - ahead(b))[0];
    if (next) select({ c: next.c, p: next.p ?? state.p, k: null });
  });
}

// All figures once more: the colours or the width there is have changed.
async function redraw() {
  const had = Object.keys(views);
  for (const name of had) { (await views[name])?.finalize(); delete views[name]; }
  for (const name of had) await figureOf(name);
  for (const own of sections()) await own.redraw?.();
  await draw();
}
