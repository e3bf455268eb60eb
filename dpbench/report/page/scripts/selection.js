// The page's one selection, kept in the address.
//
//   #s=osqp&w=native-warm&set=high&sc=turn&k=74&slow=100&b=daqp~native-warm~default
//
// Of a study the scenario is a realisation: `sc=seas: point 3, realisation 2`. What the page says of configurations
// and cells is looked up here; `draw` (page.js) follows it.
"use strict";

// `window` is the row of a window in the table of all runs, whose closed loop is shown, or null.
const state = { window: null };

// What each section registers: the `id` of a node without which it is not on the page, `draw` after
// a change of these parts of the selection, `redraw` in another look, and `listen` at the start.
const SECTIONS = [];
const sections = () => SECTIONS.filter((own) => $(own.id));
const on = (id, event, act) => $(id).addEventListener(event, (e) => act(e.target.value));

function time(ns) {
  if (ns === null || ns === undefined) return "–";
  const at = [1e3, 1e6, 1e9, Infinity].findIndex((end) => ns < 0.9995 * end);
  return `${significant(ns / 1e3 ** at)} ${["ns", "µs", "ms", "s"][at]}`;
}

const C = () => facts.configurations;
const callMode = (c) => `${C().route[c]}-${C().policy[c]}`;
const label = (c) => `${C().solver[c]} (${C().route[c]} ${C().policy[c]}, ${C().settings[c]})`;
const marked = (c) => label(c).replace(C().solver[c], `\`${C().solver[c]}\``);
const key = (c) => `${C().solver[c]}~${callMode(c)}~${C().settings[c]}`;
const count = () => C().solver?.length ?? 0;
const all = () => Array.from({ length: count() }, (_, c) => c);
const unique = (list) => [...new Set(list)];

function configuration(solver, w, settings) {
  const own = all().filter((c) => C().solver[c] === solver);
  return own.find((c) => callMode(c) === w && C().settings[c] === settings)
    ?? own.find((c) => callMode(c) === w) ?? own.find((c) => C().settings[c] === settings) ?? own[0];
}

// Of a solver the configuration that the figures of the answer show; of a call mode the one
// that was run in the chosen experiment, with the chosen settings if there is one.
function nearest(solver, w, settings) {
  if (solver !== C().solver[state.c]) return facts.answer.best[solver] ?? configuration(solver, w, settings);
  const ran = (c) => cell(c, state.p)?.t != null;
  const like = (c) => 2 * ran(c) + (C().settings[c] === settings);
  const own = all().filter((c) => C().solver[c] === solver && callMode(c) === w);
  return settings !== C().settings[state.c] ? configuration(solver, w, settings)
    : own.reduce((best, c) => (like(c) > like(best) ? c : best));
}

function cell(c, p) {
  const i = facts.index.get(`${c}/${p}`);
  return i === undefined ? null : Object.fromEntries(
    Object.entries(facts.cells).map(([name, column]) => [name, column[i]]));
}

// A slowdown that the slider can show.
const atMost = (text) => Math.min(1e4, Math.max(1, Number(text) || 1));

// A positive number; `usual` where there is none.
const positive = (text, usual) => (Number(text) > 0 && Number.isFinite(Number(text)) ? Number(text) : usual);

function read() {
  const asked = new URLSearchParams(location.hash.slice(1));
  Object.assign(state, { window: null, cpi: positive(asked.get("cpi"), 1), mhz: positive(asked.get("mhz"), 100) });
  if (!count()) { Object.assign(state, { c: null, p: 0, k: null, slow: 1, b: null }); return; }
  const first = facts.answer.first;
  const solver = asked.get("s") ?? C().solver[first];
  const c = configuration(solver, asked.get("w") ?? (asked.has("s") ? null : callMode(first)),
    asked.get("set") ?? (asked.has("s") ? null : C().settings[first])) ?? first;
  let p = facts.experiments.findIndex((experiment) => experiment.label === asked.get("sc"));
  if (p < 0 && !asked.has("s")) p = facts.answer.experiment ?? p;
  // Without a closed loop, the replay whose times the line of the selection shows.
  if (p < 0 && facts.experiments.every(({ mode }) => mode === "replay")) p = C().timed_experiment_index[c] ?? p;
  if (p < 0) p = facts.experiments.findIndex((_, i) => cell(c, i)?.t != null);
  const [bs, bw, bset] = (asked.get("b") ?? "").split("~");
  const b = configuration(bs, bw, bset) ?? null;
  const slow = atMost(asked.get("slow"));
  const k = asked.get("k") ? Number(asked.get("k")) : asked.has("s") ? null : facts.answer.k;
  Object.assign(state, { c, p: Math.max(0, p), k: Number.isInteger(k) ? k : null, slow, b });
}

function select(change) {
  // A window is left with its configuration or scenario.
  const left = "c" in change || "p" in change ? { window: null } : {};
  Object.assign(state, left, change);
  const hash = new URLSearchParams({
    s: C().solver[state.c], w: callMode(state.c), set: C().settings[state.c],
    sc: facts.experiments[state.p].label,
  });
  if (state.k !== null) hash.set("k", state.k);
  if (state.slow !== 1) hash.set("slow", plain(state.slow));
  if (state.cpi !== 1) hash.set("cpi", plain(state.cpi));
  if (state.mhz !== 100) hash.set("mhz", plain(state.mhz));
  if (state.b !== null) hash.set("b", key(state.b));
  const text = `#${hash}`;
  if (text !== location.hash) {
    // Sliding and playing leave no trail in the history; choosing does.
    const write = "c" in change || "p" in change || "b" in change ? "pushState" : "replaceState";
    history[write](null, "", text);
  }
  draw(Object.keys(change));
}
