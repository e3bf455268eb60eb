// The page's one selection, kept in the address, and everything that follows it.
//
//   #s=osqp&w=native-warm&set=high&sc=turn&k=74&slow=100&b=daqp~native-warm~default
//
// The block of data is unpacked once; arrays are decoded when they are first looked at (common.js).
"use strict";

const ROWS = 20;
const NARROW = 640;  // A figure of less than this many pixels is drawn for a phone.
const views = {}, state = {};

// -- words --------------------------------------------------------------------------------------

function time(ns) {
  if (ns === null || ns === undefined) return "–";
  if (ns < 1e3) return `${figure(ns)} ns`;
  if (ns < 1e6) return `${figure(ns / 1e3)} µs`;
  return ns < 1e9 ? `${figure(ns / 1e6)} ms` : `${figure(ns / 1e9)} s`;
}

const C = () => facts.configurations;
const way = (c) => `${C().route[c]}-${C().policy[c]}`;
const label = (c) => `${C().solver[c]} (${C().route[c]} ${C().policy[c]}, ${C().settings[c]})`;
const key = (c) => `${C().solver[c]}~${way(c)}~${C().settings[c]}`;
const count = () => C().solver?.length ?? 0;
const all = () => Array.from({ length: count() }, (_, c) => c);
const unique = (list) => [...new Set(list)];

// -- selection ----------------------------------------------------------------------------------

function configuration(solver, w, settings) {
  const own = all().filter((c) => C().solver[c] === solver);
  return own.find((c) => way(c) === w && C().settings[c] === settings)
    ?? own.find((c) => way(c) === w) ?? own.find((c) => C().settings[c] === settings) ?? own[0];
}

// Of a solver the configuration most like the wanted one that was run in the chosen place.
function nearest(solver, w, settings) {
  const ran = (c) => cell(c, state.p)?.t != null, wanted = configuration(solver, w, settings);
  const like = (c) => 4 * ran(c) + 2 * (way(c) === w) + (C().settings[c] === settings);
  const own = all().filter((c) => C().solver[c] === solver);
  return own.reduce((best, c) => (like(c) > like(best) ? c : best), wanted);
}

function cell(c, p) {
  const i = facts.index.get(`${c}/${p}`);
  return i === undefined ? null : Object.fromEntries(
    Object.entries(facts.cells).map(([name, column]) => [name, column[i]]));
}

function read() {
  if (!count()) { Object.assign(state, { c: null, p: 0, k: null, slow: 1, b: null }); return; }
  const asked = new URLSearchParams(location.hash.slice(1));
  const first = facts.answer.first;
  const solver = asked.get("s") ?? C().solver[first];
  const c = configuration(solver, asked.get("w") ?? (asked.has("s") ? null : way(first)),
    asked.get("set") ?? (asked.has("s") ? null : C().settings[first])) ?? first;
  let p = facts.places.findIndex((place) => place.label === asked.get("sc"));
  if (p < 0) {
    p = facts.places.findIndex((_, i) => cell(c, i)?.t != null);
  }
  const [bs, bw, bset] = (asked.get("b") ?? "").split("~");
  const b = configuration(bs, bw, bset) ?? null;
  const slow = Math.min(1e4, Math.max(1, Number(asked.get("slow")) || 1));
  const k = asked.get("k") ? Number(asked.get("k")) : asked.has("s") ? null : facts.answer.k;
  Object.assign(state, { c, p: Math.max(0, p), k: Number.isInteger(k) ? k : null, slow, b });
}

function select(change) {
  Object.assign(state, change);
  const hash = new URLSearchParams({
    s: C().solver[state.c], w: way(state.c), set: C().settings[state.c],
    sc: facts.places[state.p].label,
  });
  if (state.k !== null) hash.set("k", state.k);
  if (state.slow !== 1) hash.set("slow", figure(state.slow));
  if (state.b !== null) hash.set("b", key(state.b));
  const text = `#${hash}`;
  if (text !== location.hash) {
    // Sliding and playing leave no trail in the history; choosing does.
    const write = "c" in change || "p" in change || "b" in change ? "pushState" : "replaceState";
    history[write](null, "", text);
  }
  draw(Object.keys(change));
}

// -- figures ------------------------------------------------------------------------------------

const HARD_ONLY = 64;  // Bit of a step that a thinned run keeps only since it is a hard one.
const CANVAS = ["strips", "pairs"];

async function figureOf(name) {
  const host = $(`figure-${name}`);
  if (!host || !facts.charts[name]) return null;
  views[name] ??= made(name, host);
  return views[name];
}

// A view drawn aside first: the figure that stands there is replaced only by a finished one.
async function made(name, host) {
  const spec = sized(name, Math.floor(host.parentElement.clientWidth)), aside = document.createElement("div");
  const view = new vega.View(vega.parse(CANVAS.includes(name) ? inked(spec) : spec), {
    renderer: CANVAS.includes(name) ? "canvas" : "svg", hover: true, tooltip: vegaTooltip(),
    loader: { load: () => null },
  });
  await view.initialize(aside).runAsync();
  host.replaceChildren(aside);
  // What paper has to make up for.
  host.classList.toggle("narrow", host.parentElement.clientWidth < NARROW);
  host.classList.toggle("dark", matchMedia("(prefers-color-scheme: dark)").matches);
  view.addEventListener("click", (_, item) => picked(name, item?.datum));
  return view;
}

// The specification for the width there is.
function sized(name, width) {
  const narrow = width < NARROW;
  const set = (spec, values) => ({ ...spec, signals: (spec.signals ?? []).map((signal) =>
    signal.name in values ? { ...signal, value: values[signal.name] } : signal) });
  const spec = facts.charts[name];
  if (name === "matrix") {
    const at = narrow ? facts.charts.matrix_narrow : spec, table = spec.data.find((d) => d.values);
    const of = (key) => unique(table.values.map((row) => row[key]));
    const tiles = of("place").length > facts.most_across ? ["solver", "place"] : ["place", "solver"];
    const labels = 14 + 7 * Math.max(...of(tiles[1]).map((text) => text.length));
    const levels = narrow ? 1 : of("settings").length, slant = narrow ? 0 : 90;
    const step = (width - labels - slant - 16 * levels) / (levels * of(tiles[0]).length);
    return set(at, { x_step: Math.max(14, Math.min(46, step)) });
  }
  if (name === "strips") return { ...spec, width: width - 78, autosize: { type: "pad", resize: true } };
  const fit = { type: name === "pairs" ? "fit" : "fit-x", contains: "padding", resize: true };
  const square = Math.min(width, 460);
  return name === "pairs" ? { ...spec, width: square, height: square, autosize: fit }
    : set({ ...spec, width, autosize: fit, marks: apart(spec.marks) }, { narrow });
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

function picked(name, datum) {
  if (!datum) return;
  if ((name === "strips") && datum.k !== undefined) select({ k: datum.k });
  else if (datum.id !== undefined) {
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
  const long = places.length > facts.most_across;
  const [across, down] = long ? [solvers, places] : [places, solvers];
  const below = $("figure-matrix").classList.contains("narrow");
  return own.map((row) => {
    const level = levels.indexOf(row.settings);
    const [x, y] = [row.place, row.solver].map((value, i) => [places, solvers][i].indexOf(value));
    return { c: Number(row.id), p: Number(row.place_id),
      x: (long ? y : x) + (below ? 0 : level * across.length),
      y: (long ? x : y) + (below ? level * down.length : 0) };
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

// -- one solver ---------------------------------------------------------------------------------

function options(id, values, chosen) {
  const box = $(id);
  box.replaceChildren(...values.map(([value, text]) => new Option(text, value, false,
    String(value) === String(chosen))));
}

function drawChoice() {
  const c = state.c, solver = C().solver[c];
  const own = all().filter((i) => C().solver[i] === solver);
  options("choose-solver", unique(C().solver).map((s) => [s, s]), solver);
  options("choose-way", unique(own.map(way)).map((w) => [w, w.replace("-", " ")]), way(c));
  options("choose-settings", unique(own.filter((i) => way(i) === way(c)).map((i) => C().settings[i]))
    .map((s) => [s, s]), C().settings[c]);
  options("choose-place", facts.places.map((place, p) => [p, place.label])
    .filter(([p]) => cell(c, p) || p === state.p), state.p);
}

function rowsOf(run) {
  const t = array(run.t), r = array(run.r), e = array(run.e), i = array(run.i), a = array(run.a),
    f = array(run.f);
  return t.map((ns, j) => ({
    k: run.first + j, time_us: ns === null ? null : ns / 1e3,
    raw_us: r[j] === undefined || r[j] === null ? null : r[j] / 1e3,
    error: e[j] === Infinity ? 1e9 : e[j], iterations: i[j], active: a[j], failed: Boolean(f[j] & 4),
  })).filter((row) => row.time_us !== null);
}

function trackOf(run) {
  if (!run || !run.x) return null;
  const own = run.x.map(array), force = run.u.map(array);
  if (run.reference) return { every: run.every, x: own, u: force };
  const other = referenceOf(run.p);
  if (!other) return null;
  const sum = (mine, theirs) => mine.map((values, i) =>
    values.map((v, j) => (v === null || theirs[i][j] == null ? null : v + theirs[i][j])));
  return { every: run.every, x: sum(own, other.x), u: sum(force, other.u) };
}

function referenceOf(p) {
  const i = facts.cells.p.findIndex((place, j) => place === p && facts.cells.reference[j]);
  return i < 0 ? null : trackOf(cell(facts.cells.c[i], p));
}

// On how many steps the first move is farther off than the demand allows.
function over(run) {
  return run.t == null ? "–" : array(run.e).filter((e) => e > facts.demand).length;
}

async function drawOne() {
  const run = cell(state.c, state.p), text = $("one-said");
  const solver = facts.solvers[C().solver[state.c]] ?? {};
  drawChoice();
  $("one-title").textContent = label(state.c);
  if (!run) {
    text.textContent = `Not run in ${facts.places[state.p].label}.`;
    for (const id of ["hard", "figure-strips", "strips-said", "step", "ship"]) $(id).hidden = true;
    return;
  }
  $("hard").hidden = false;
  const p99 = C().p99[state.c];
  text.textContent = [
    `${run.state === "meets" ? "Holds" : run.state === "misses" ? "Misses the demand" : "Open"} in `
    + `${facts.places[state.p].label}: ran ${run.steps} of ${run.planned} steps; first move beyond the `
    + `demand on ${over(run)}, at most ${figure(run.error)}; claimed solved and not true on `
    + `${figure(run.untrue)}; failed on ${figure(run.failed)}.`,
    run.off_m === null ? "" : `The ship was up to ${figure(run.off_m)} m off the exactly solved loop`
      + `${run.settle_s === null || run.settle_s === "inf" ? "." : ` and settled within 1 m and 1° at ${figure(run.settle_s)} s.`}`,
    run.why ? `${run.outcome}: ${run.why}.` : "",
    `Over the whole run: ${C().outcome[state.c]}${C().why[state.c] ? ` (${C().why[state.c]})` : ""}`
    + (p99 === null ? "." : `; p99 ${time(p99)} on ${C().timed_on[state.c]}.`),
    solver.method ? `Method: ${solver.method}.` : "",
  ].filter(Boolean).join(" ").replaceAll("`", "");
  drawHard(run);
  const stepped = run.t !== undefined && run.t !== null;
  $("figure-strips").hidden = $("strips-said").hidden = !stepped;
  $("strips-time").textContent = facts.places[state.p].mode === "replay"
    ? "Dot: the fastest counted round, grey up to the largest sample."
    : "Dot: one sample a step, not timed alone; only replays compare times.";
  if (!stepped) { drawShip(null); return; }
  const view = await figureOf("strips");
  if (view) {
    const track = trackOf(run), forces = [];
    if (track) track.u.forEach((values, i) => values.forEach((share, j) => {
      if (share !== null) forces.push({
        k: run.first + j * track.every, force: ["surge", "sway", "yaw"][i], share });
    }));
    view.data("steps", rowsOf(run)).data("forces", forces);
    view.signal("at", state.k ?? -1);
    await view.runAsync();
    await fill(view, $("figure-strips"));
  }
  drawShip(run);
}

function drawHard(run) {
  const replayed = facts.places[state.p].mode === "replay";
  const names = [
    replayed ? "slowest" : "slowest, one sample each", "most iterations", "largest error",
  ];
  const boxes = (run.hard ?? []).map((list, m) => {
    const row = document.createElement("p"), head = document.createElement("span");
    head.textContent = names[m]; head.className = "soft";
    row.append(head);
    for (const [k, value] of list) {
      const button = document.createElement("button");
      button.textContent = `k ${k}: ${m === 0 ? time(value) : figure(value)}`;
      button.setAttribute("aria-pressed", String(k === state.k));
      button.addEventListener("click", () => select({ k }));
      row.append(button);
    }
    return row;
  });
  $("hard").replaceChildren(...boxes);
  drawStep(run);
}

function drawStep(run) {
  const box = $("step"), k = state.k, j = k === null ? -1 : k - run.first;
  const t = array(run.t);
  if (k === null || t[j] === undefined || t[j] === null) { box.hidden = true; return; }
  const f = array(run.f)[j] ?? 0, said = (bit) => Boolean(f & (1 << bit));
  const known = (run.hard ?? []).flat().find((hard) => hard[0] === k);
  const flags = facts.flags.filter((_, bit) => bit > 1 && said(bit));
  $("step-said").textContent = `Step ${k}: ${time(t[j])}, ${figure(array(run.i)[j])} iterations, `
    + `${figure(array(run.a)[j])} active limits, error of the first move ${figure(array(run.e)[j])}; `
    + `claimed ${said(0) ? "solved" : `not solved${known ? ` (${known[2].toLowerCase()})` : ""}`}, `
    + `${said(1) ? "true" : "not true"}${flags.length ? `, ${flags.join(", ")}` : ""}.`;
  const place = facts.places[run.p];
  $("step-export").textContent =
    `dpbench export ${place.source} --at ${k + (place.first ?? 0)} --out step-${k}.npz`;
  $("step-query").textContent =
    `pandas.read_parquet("steps.parquet", filters=[("run_id", "==", "${run.id}"), ("k", "==", ${k})])`;
  box.hidden = false;
}

// -- the ship -----------------------------------------------------------------------------------

const SVG = "http://www.w3.org/2000/svg";
function shape(kind, attributes, parent) {
  const node = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  parent?.append(node);
  return node;
}

// The outline of a hull of length 1 from above, bow to the north.
const HULL = [[0.5, 0], [0.32, 0.11], [-0.5, 0.11], [-0.5, -0.11], [0.32, -0.11]];

function drawShip(run) {
  const host = $("figure-ship"), track = trackOf(run), place = facts.places[state.p];
  $("ship").hidden = !track;
  if (!track) return;
  const exact = referenceOf(state.p), [N, E, psi] = track.x;
  const last = N.length - 1;
  let at = state.k === null ? last : Math.round((state.k - run.first) / track.every);
  at = Math.max(0, Math.min(last, at));
  const goal = place.reference, size = place.length_m;
  const all = [...N.map((n, i) => [n, E[i]]), ...(exact ? exact.x[0].map((n, i) => [n, exact.x[1][i]]) : [])]
    .filter(([n, e]) => n !== null && e !== null);
  if (goal) all.push([goal[0], goal[1]]);
  const low = [0, 1].map((i) => Math.min(...all.map((p) => p[i])));
  const high = [0, 1].map((i) => Math.max(...all.map((p) => p[i])));
  const span = Math.max(high[0] - low[0], high[1] - low[1], 1e-3), half = 0.62 * Math.max(span, 0.4);
  const mid = [0, 1].map((i) => 0.5 * (low[i] + high[i])), width = 360;
  const X = (e) => width / 2 + ((e - mid[1]) / half) * (width / 2);
  const Y = (n) => width / 2 - ((n - mid[0]) / half) * (width / 2);
  const root = shape("svg", { viewBox: `0 0 ${width} ${width}`, role: "img",
    "aria-label": `Path of the ship in ${place.label} and its hull at the chosen step` });
  const clip = shape("g", {}, root);
  const path = (n, e) => n.map((v, i) => (v === null ? "" : `${i ? "L" : "M"}${X(e[i]).toFixed(1)} ${Y(v).toFixed(1)}`)).join("");
  const hull = (n, e, angle, look) => {
    // A hull true to scale would hide a path of a few metres: it is drawn at a third of the frame.
    const scale = Math.min(size, 0.7 * half);
    const points = HULL.map(([x, y]) => {
      const dn = scale * (x * Math.cos(angle) - y * Math.sin(angle));
      const de = scale * (x * Math.sin(angle) + y * Math.cos(angle));
      return `${X(e + de).toFixed(1)},${Y(n + dn).toFixed(1)}`;
    });
    shape("polygon", { points: points.join(" "), ...look }, clip);
  };
  if (goal) {
    shape("circle", { cx: X(goal[1]), cy: Y(goal[0]), r: (1 / half) * (width / 2), class: "circle" }, clip);
    shape("path", { d: `M${X(goal[1]) - 6} ${Y(goal[0])}h12M${X(goal[1])} ${Y(goal[0]) - 6}v12`, class: "goal" }, clip);
  }
  if (exact) {
    shape("path", { d: path(exact.x[0], exact.x[1]), class: "exact" }, clip);
    const j = Math.min(at, exact.x[0].length - 1);
    hull(exact.x[0][j], exact.x[1][j], exact.x[2][j], { class: "hull-exact" });
  }
  shape("path", { d: path(N, E), class: "path" }, clip);
  if (N[at] !== null) hull(N[at], E[at], psi[at], { class: "hull" });
  $("ship-hull").hidden = size <= 0.7 * half;
  const metre = 10 ** Math.floor(Math.log10(half)), bar = (metre / half) * (width / 2);
  shape("path", { d: `M12 ${width - 14}h${bar}`, class: "bar" }, root);
  const text = shape("text", { x: 12, y: width - 20, class: "small" }, root);
  text.textContent = `${figure(metre)} m, north up`;
  host.replaceChildren(root);
  const slider = $("ship-k");
  slider.max = String(last); slider.value = String(at);
  const kept = run.first + at * track.every;
  $("ship-said").textContent = `k ${kept}${state.k === null || state.k === kept ? "" : " (the nearest kept)"}: `
    + `${figure(N[at])} m north, ${figure(E[at])} m east, heading ${figure((psi[at] * 180) / Math.PI)}°`;
}

let playing = null;
function play() {
  const run = cell(state.c, state.p), track = trackOf(run);
  const stop = () => {
    clearInterval(playing); playing = null; $("ship-play").textContent = "Play";
    select({ k: state.k });
  };
  if (playing || !track) { stop(); return; }
  let at = 0;
  $("ship-play").textContent = "Stop";
  playing = setInterval(() => {
    if (at >= track.x[0].length) { stop(); return; }
    state.k = run.first + at * track.every; at += 2; drawShip(run);
  }, 33);
}

// -- two configurations -------------------------------------------------------------------------

async function drawTwo() {
  const others = all().filter((c) => c !== state.c && C().p50[c] !== null);
  // Unless one was asked for: the answer, and beside the answer the next.
  const second = [state.b, facts.answer.first, facts.answer.second, others[0]]
    .find((c) => others.includes(c));
  if (second === undefined) return;
  options("choose-other", others.map((c) => [c, label(c)]), second);
  const rows = [];
  facts.places.forEach((place, p) => {
    const a = cell(state.c, p), b = cell(second, p);
    if (place.mode !== "replay" || !a || !b || a.t == null || b.t == null) return;
    const x = array(a.t), y = array(b.t), f = array(a.f), g = array(b.f);
    x.forEach((ns, j) => {
      const i = a.first + j - b.first, other = y[i];
      if (ns > 0 && other > 0 && !((f[j] | g[i]) & HARD_ONLY)) rows.push({
        k: a.first + j, a_us: ns / 1e3, b_us: other / 1e3, sequence: place.label });
    });
  });
  const said = $("two-said");
  if (!rows.length) { said.textContent = "No sequence was replayed by both."; $("figure-pairs").hidden = true; return; }
  $("figure-pairs").hidden = false;
  const sequences = unique(rows.map((row) => row.sequence));
  const mean = sequences.map((name) => {
    const own = rows.filter((row) => row.sequence === name);
    return own.reduce((sum, row) => sum + Math.log(row.b_us / row.a_us), 0) / own.length;
  }).reduce((sum, x) => sum + x, 0) / sequences.length;
  const ratio = Math.exp(mean), pair = facts.paired[`${state.c}/${second}`];
  const interval = pair ? `, 95 % interval ${
    (ratio >= 1 ? pair : [1 / pair[1], 1 / pair[0]]).map((x) => figure(x)).join(" to ")}` : "";
  const [slower, faster] = ratio >= 1 ? [second, state.c] : [state.c, second];
  said.textContent = `${label(slower)} takes ${figure(Math.max(ratio, 1 / ratio))} times as long as `
    + `${label(faster)} (geometric mean over ${rows.length} steps, each sequence of equal weight`
    + `${interval}). Below the dashed line ${label(second)} is the faster one.`;
  const view = await figureOf("pairs");
  if (view) await view.data("pairs", rows).runAsync();
  $("two-markdown").textContent = `| | ${label(state.c)} | ${label(second)} |\n|---|---|---|\n`
    + [["p50", "p50"], ["p99", "p99"], ["largest step", "max"]].map(([name, column]) =>
      `| ${name} | ${time(C()[column][state.c])} | ${time(C()[column][second])} |`).join("\n")
    + `\n| largest error | ${figure(C().error[state.c])} | ${figure(C().error[second])} |\n`
    + `| demand | ${C().outcome[state.c]} | ${C().outcome[second]} |\n\n${said.textContent.split(" Below")[0]}\n`;
}

// -- the table ----------------------------------------------------------------------------------

const sorting = { column: 0, down: false };
function drawTable() {
  const table = facts.table, filter = $("table-filter").value.toLowerCase();
  const group = $("table-group").value;
  const shown = table.columns.map((column, i) => [column, i])
    .filter(([column]) => column.group === "" || column.group === group);
  const rows = Array.from({ length: table.rows }, (_, i) => i)
    .filter((i) => $("table-of").value === "all" || table.c[i] === state.c)
    .filter((i) => filter.split(/\s+/).every((word) => table.columns.some((column, j) => column.text
      && String(table.values[j][i]).toLowerCase().includes(word))));
  const values = table.values[sorting.column] ?? table.values[0];
  const rank = (x) => (x === null ? Infinity : x === "inf" ? 1e300 : x);
  rows.sort((a, b) => {
    const x = rank(values[a]), y = rank(values[b]);
    return (x < y ? -1 : x > y ? 1 : a - b) * (sorting.down ? -1 : 1);
  });
  const head = document.createElement("tr");
  for (const [column, j] of shown) {
    const th = document.createElement("th"), button = document.createElement("button");
    th.scope = "col"; button.textContent = column.label; button.title = column.meaning;
    if (sorting.column === j) th.setAttribute("aria-sort", sorting.down ? "descending" : "ascending");
    button.addEventListener("click", () => {
      sorting.down = sorting.column === j ? !sorting.down : false;
      sorting.column = j; drawTable();
    });
    th.append(button); head.append(th);
  }
  const open = (i) => {
    if (table.c[i] === null) return;
    select({ c: table.c[i], p: table.p[i], k: null });
    go("one");
  };
  const body = rows.slice(0, ROWS).map((i) => {
    const tr = document.createElement("tr");
    for (const [column, j] of shown) {
      const td = document.createElement("td"), value = table.values[j][i];
      td.dataset.name = column.group ? column.label : "";
      if (j === 0 && table.c[i] !== null) {
        const button = document.createElement("button");
        button.textContent = value;
        td.append(button);
      } else td.textContent = column.text ? value : figure(value, 4);
      if (!column.text) td.className = "n";
      if (value === null || value === "") td.classList.add("empty");
      tr.append(td);
    }
    tr.addEventListener("click", () => open(i));
    return tr;
  });
  $("table-head").replaceChildren(head);
  $("table-body").replaceChildren(...body);
  $("table-said").textContent = `${Math.min(ROWS, rows.length)} of ${rows.length} rows${
    $("table-of").value === "all" ? "" : `, of ${table.rows} in all`}`;
  const run = cell(state.c, state.p);
  $("data-query").textContent = run
    ? `steps = pandas.read_parquet("steps.parquet", filters=[("run_id", "==", "${run.id}")])`
      + `  # ${label(state.c)} in ${facts.places[state.p].label}`
      + (facts.places[state.p].mode === "replay"
        ? `\nsteps[steps.counts].groupby("k").total_ns.min().quantile([0.5, 0.99])  # p50 and p99`
        : "") : "";
  $("data-query").hidden = !run;
  state.rows = rows; state.shown = shown;
}

function csv() {
  const quote = (x) => (x === null ? "" : /[",\n]/.test(String(x)) ? `"${String(x).replaceAll('"', '""')}"` : String(x));
  // The run's name comes along with any columns: it leads to its row of the files.
  const id = facts.table.columns.findIndex((column) => column.name === "run_id");
  const shown = [...state.shown.filter(([, j]) => j !== id), [facts.table.columns[id], id]];
  const lines = [shown.map(([column]) => quote(column.name)).join(",")];
  for (const i of state.rows) lines.push(shown.map(([, j]) => quote(facts.table.values[j][i])).join(","));
  return `${lines.join("\n")}\n`;
}

function download(name, text) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/plain" }));
  link.download = name; link.click();
  URL.revokeObjectURL(link.href);
}

// -- drawing all of it --------------------------------------------------------------------------

// How many of the ladder still make the deadline on the slower computer, by their largest step.
function kept() {
  const sets = facts.charts.ladder.data.filter((data) => data.values?.length).map((data) => data.values);
  const rows = sets.find((values) => "max_ms" in values[0]);
  const { deadline } = sets.find((values) => "deadline" in values[0])[0];
  const within = rows.filter((row) => row.max_ms * state.slow <= deadline);
  const named = within.length && within.length <= 8 && within.length < rows.length
    ? `: ${within.map((row) => row.solver).join(", ")}` : "";
  const meet = within.filter((row) => row.outcome === "meets").length;
  const samples = state.slow > 1 ? "; single samples are not shown here" : "";
  return `${within.length} of ${rows.length} keep the deadline by their largest step${named}; `
    + `${meet} of them meet the demand${samples}`;
}

// What follows from a change of some parts of the selection; without them, from all of it.
async function draw(changed = ["slow", "c", "p", "b", "k"]) {
  if (!count()) { drawTable(); return; }
  const touched = (...parts) => parts.some((part) => changed.includes(part));
  const place = facts.places[state.p].label;
  const p99 = C().p99[state.c];
  $("chosen").textContent = `${label(state.c)}: ${C().outcome[state.c]}`
    + `${p99 === null ? "" : `, p99 ${time(p99)}`}; in ${place}${state.k === null ? "" : `, k ${state.k}`}`;
  if (touched("slow") && $("slow")) {
    $("slow-said").textContent = `× ${figure(state.slow)}`;
    $("slow").value = String(Math.log10(state.slow));
    $("slow-kept").textContent = kept();
    await signal("ladder", { slow: state.slow });
  }
  if (touched("c", "p")) {
    await mark("ladder", { id: String(state.c) });
    await mark("matrix", { id: String(state.c), place_id: String(state.p) });
    await mark("accuracy", { id: String(state.c) });
    drawTable();
  }
  if (touched("c", "p", "k")) await drawOne();
  if (touched("c", "b") && $("two")) await drawTwo();
}

// A text to the clipboard; where the browser has none to give, it is marked for copying by hand.
async function copy(button, text) {
  try {
    await navigator.clipboard.writeText(text.textContent);
    button.textContent = "Copied";
  } catch {
    text.hidden = false;
    getSelection().selectAllChildren(text);
    button.textContent = "Marked: copy by hand";
  }
}

// To a section; the address keeps the selection.
function go(id) {
  const section = $(id);
  if (section.tagName === "DETAILS") section.open = true;
  section.tabIndex = -1;
  section.focus({ preventScroll: true });
  section.scrollIntoView();
}

// The address has changed: a selection, or the bare name of a section.
function arrived() {
  const name = location.hash.slice(1);
  if (name && !name.includes("=") && $(name)) { go(name); return; }
  read();
  draw();
}

function listen() {
  listenOne();
  for (const name of ["ladder", "matrix"]) steerable(name);
  $("matrix-way")?.append(...unique(all().map(way)).map((w) => new Option(w.replace("-", " "), w)));
  $("matrix-way")?.addEventListener("change", drawMatrix);
  $("choose-other")?.addEventListener("change", (e) => select({ b: Number(e.target.value) }));
  $("slow")?.addEventListener("input", (e) => select({ slow: 10 ** Number(e.target.value) }));
  $("percentile")?.addEventListener("change", (e) => signal("accuracy", { percentile: e.target.value }));
  for (const button of document.querySelectorAll("[data-copy]")) {
    button.addEventListener("click", () => copy(button, $(button.dataset.copy)));
  }
  $("table-filter").addEventListener("input", drawTable);
  $("table-group").addEventListener("change", drawTable);
  $("table-csv").addEventListener("click", () => download("runs.csv", csv()));
  $("table-of").addEventListener("change", drawTable);
  listenPage();
}

// One solver: what is chosen, the step, the ship.
function listenOne() {
  if (!$("one")) return;
  const choose = (change) => {
    const solver = change.solver ?? C().solver[state.c];
    const c = nearest(solver, change.way ?? way(state.c), change.settings ?? C().settings[state.c]);
    select({ c, p: cell(c, state.p) ? state.p : Math.max(0, facts.places.findIndex((_, p) => cell(c, p))), k: null });
  };
  $("choose-solver").addEventListener("change", (e) => choose({ solver: e.target.value }));
  $("choose-way").addEventListener("change", (e) => choose({ way: e.target.value }));
  $("choose-settings").addEventListener("change", (e) => choose({ settings: e.target.value }));
  $("choose-place").addEventListener("change", (e) => select({ p: Number(e.target.value), k: null }));
  $("ship-k").addEventListener("input", (e) => {
    const run = cell(state.c, state.p), track = trackOf(run);
    select({ k: run.first + Number(e.target.value) * track.every });
  });
  $("ship-play").addEventListener("click", play);
}

// The address, the width, links to sections.
function listenPage() {
  addEventListener("popstate", arrived);
  for (const link of document.querySelectorAll("[data-section]")) {
    link.addEventListener("click", (event) => {
      event.preventDefault();
      go(link.getAttribute("href").slice(1));
    });
  }
  onNewLook(redraw);
  for (const button of document.querySelectorAll("[data-go]")) {
    button.addEventListener("click", () => {
      const [solver, w, settings] = button.dataset.go.split("~");
      select({ c: configuration(solver, w, settings), k: null });
    });
  }
}

async function start() {
  await unpack();
  facts.index = new Map((facts.cells.c ?? []).map((c, i) => [`${c}/${facts.cells.p[i]}`, i]));
  for (const node of document.querySelectorAll("[data-live]")) node.hidden = false;
  read();
  listen();
  const name = location.hash.slice(1);
  await draw();
  if (name && !name.includes("=") && $(name)) go(name);
  document.documentElement.dataset.ready = "yes";
}
start();
