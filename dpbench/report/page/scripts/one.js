// One solver in one experiment: its strips, its hardest steps, the chosen step, and the ship there.
"use strict";

function options(id, values, chosen) {
  const box = $(id);
  box.replaceChildren(...values.map(([value, text]) => new Option(text, value, false,
    String(value) === String(chosen))));
}

function settingsText(c) {
  const { settings, options: own } = C();
  return own[c] && own[c] !== settings[c] ? `${settings[c]} (${own[c]})` : settings[c];
}

function drawChoice() {
  const c = state.c, solver = C().solver[c];
  const own = all().filter((i) => C().solver[i] === solver);
  options("choose-solver", unique(C().solver).map((s) => [s, s]), solver);
  options("choose-mode", unique(own.map(callMode)).map((w) => [w, w.replace("-", " ")]), callMode(c));
  options("choose-settings", [...new Map(own.filter((i) => callMode(i) === callMode(c))
    .map((i) => [C().settings[i], settingsText(i)]))], C().settings[c]);
  // Of a study only the seas of one point, or they were hundreds.
  const { study, point } = facts.experiments[state.p];
  const near = (experiment) => !experiment.study || (experiment.study === study && experiment.point === point);
  options("choose-experiment", facts.experiments.map((experiment, p) => [p, experiment.label])
    .filter(([p]) => p === state.p || (near(facts.experiments[p]) && cell(c, p))), state.p);
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
  const track = { first: run.first, every: run.every, x: own, u: force };
  // Of equal steps the distance from the first of its place is kept, of others the track itself.
  const other = run.reference ? null : referenceOf(run.p);
  if (other?.every !== run.every) return track;
  const sum = (mine, theirs) => mine.map((values, i) =>
    values.map((v, j) => (v === null || theirs[i][j] == null ? null : v + theirs[i][j])));
  return { ...track, x: sum(own, other.x), u: sum(force, other.u) };
}

function referenceOf(p) {
  const i = facts.cells.p.findIndex((experiment, j) => experiment === p && facts.cells.reference[j]);
  return i < 0 ? null : trackOf(cell(facts.cells.c[i], p));
}

// Of a study the page keeps the steps of some runs alone: where those of another are.
function notKept() {
  const { study, point, sea } = facts.experiments[state.p], runs = facts.studies.find((s) => s.name === study)?.runs;
  const i = runs?.id.findIndex((_, j) => runs.point[j] === point && runs.sea[j] === sea
    && studied().c[runs.of[j]] === state.c) ?? -1;
  return i < 0 ? null : `This page contains no steps of this run: pandas.read_parquet("steps.parquet", `
    + `filters=[("run_id", "==", "${runs.id[i]}")]).`;
}

// How many steps are inaccurate, failed, or reported as solved but not optimal, in any round; ""
// where none is.
function wrongOf(run) {
  // Of a replay the false claims are those of all rounds.
  const once = run.answers === run.steps, were = (count) => (count === 1 ? "was" : "were");
  const at = (first, count) => ((first ?? -1) < 0 ? "" : ` (${count === 1 ? "" : "first "}at step ${first})`);
  const found = [[run.inaccurate ?? 0, "step", (count) => `${were(count)} inaccurate${at(run.first_inaccurate, count)}`],
    [run.failed, "step", (count) => `failed${at(run.first_failed, count)}`],
    [run.untrue, once ? "step" : "answer", (count) => `${once ? "" : `of ${grouped(run.answers)} `}${were(count)} reported as solved, but failed the referee's test of optimality`]]
    .filter(([count]) => count > 0)
    .map(([count, word, what], i) => `${i && (once || word === "step") ? grouped(count) : many(count, word)} ${what(count)}`);
  return found.length < 2 ? found.join("") : `${found.slice(0, -1).join(", ")} and ${found.at(-1)}`;
}

// What the referee did not verify of a run that passes; "" for nothing.
function unverifiedOf(run) {
  const kind = run.answers === run.steps ? "steps" : "answers";
  return run.verdict !== "pass" || !run.untrue || run.inaccurate || run.failed ? ""
    : `${grouped(run.untrue)} of the ${kind} reported as solved failed the referee's test of optimality; the error of the first move stayed within its limit`;
}

// The largest error of the first move as a sentence.
function largestErrorOf(run) {
  const error = figure(run.error);
  return run.error === "inf" ? "At least one step has no solution, and therefore no error."
    : error === "1" ? "The largest error of the first move is equal to the maximum increment."
      : `The largest error of the first move is ${error} times the maximum increment.`;
}

// The verdict on the selected configuration in the selected scenario or replay; of a study where it ran.
function verdictOf(run, name) {
  const experiment = facts.experiments[state.p];
  const verdict = { pass: "passes", borderline: "is borderline", late: "is late", fail: "fails" }[run.verdict] ?? "is inconclusive";
  return experiment.study ? `In \`${experiment.label}\`` : `${name} ${verdict} in \`${experiment.label}\``;
}

// The result of the selected configuration in the selected scenario or replay.
function resultOf(run) {
  const solver = `\`${C().solver[state.c]}\``;
  const unverified = unverifiedOf(run), all = run.infeasible > 0 ? ", and all with a feasible solution are accurate" : ", and all are accurate";
  if (run.outcome === "refused") return `${solver} was not run in \`${facts.experiments[state.p].label}\`, as it does not support this call mode (${run.why}).`;
  return [
    `${verdictOf(run, solver)}${facts.experiments[state.p].study ? `, ${solver}` : ": it"} ran ${grouped(run.steps)} of ${grouped(run.planned)} steps${
      unverified ? "" : wrongOf(run) ? `; ${wrongOf(run)}` : all}.`,
    unverified && `${unverified[0].toUpperCase()}${unverified.slice(1)}.`,
    run.reason && `Reason for this verdict: ${run.reason}.`,
    largestErrorOf(run),
    run.off_m === null ? "" : `At the start of a step, the ship is at most ${figure(run.off_m)} m from its position in the reference loop and at most ${figure(run.setpoint_m)} m from its setpoint.`,
    run.infeasible > 0 ? `${grouped(run.infeasible)} of the steps have no feasible solution${run.all_true ? ", which the solver reported correctly" : ""}.` : "",
    run.why && run.verdict !== "pass" ? `${run.outcome === "finished" ? "Messages of the solver" : `Outcome \`${run.outcome}\``}: ${run.why}.` : "",
  ].filter(Boolean).join(" ");
}

async function drawOne() {
  const run = cell(state.c, state.p), text = $("one-said");
  const solver = facts.solvers[C().solver[state.c]] ?? {};
  drawChoice();
  $("one-title").textContent = label(state.c);
  $("one-call").textContent = C().call[state.c];
  // That of the answer stands there; a refused call mode has none.
  $("one-call").parentElement.hidden = run?.outcome === "refused" || $("one-call").textContent === $("paste-1")?.textContent;
  if (!run) {
    text.replaceChildren(...coded(notKept() ?? `Not run in \`${facts.experiments[state.p].label}\`${C().verdict[state.c] === "not run" ? `: ${C().why[state.c]}` : ""}.`));
    for (const id of ["hard", "figure-strips", "strips-said", "step", "ship"]) $(id).hidden = true;
    return;
  }
  $("hard").hidden = false;
  $("ship").hidden = !trackOf(run);
  const judged = !["not judged", "not run"].includes(C().verdict[state.c]);
  text.replaceChildren(...coded([
    state.window === null ? "" : "A window has no chart of its own, so its closed loop is shown.",
    resultOf(run),
    judged && C().verdict[state.c] !== "pass" ? `Overall verdict, without runs in SI units: ${C().verdict[state.c]}${[run.reason, ""].includes(C().why[state.c]) ? "" : `, because ${C().why[state.c]}`}.` : "",
    solver.method ? `Method: ${solver.method}.` : "",
  ].filter(Boolean).join(" ")));
  drawHard(run);
  const drawn = run.t !== undefined && run.t !== null;
  $("figure-strips").hidden = $("strips-said").hidden = !drawn;
  $("strips-time").textContent = facts.experiments[state.p].mode === "replay"
    ? "Step time, error and iterations of each step. Each dot is one step, in its fastest round. The grey line ends at its largest timing. A replay has no plant, so no ship is shown."
    : "Step time, error, iterations and forces of each step. Each dot is one step. Do not compare these times with those of another solver: each step was timed once, while other runs used the machine.";
  const thinned = drawn && facts.arrays[run.t][4] !== undefined;
  $("strips-kept").hidden = !thinned;
  if (thinned) $("strips-kept").replaceChildren(...coded(
    `The figure shows ${grouped(rowsOf(run).length)} of the ${grouped(run.steps)} steps; \`steps.parquet\` contains all.`));
  if (!drawn) { drawShip(null); return; }
  const view = await figureOf("strips");
  if (view) {
    const track = trackOf(run), forces = [];
    if (track) track.u.forEach((values, i) => values.forEach((share, j) => {
      if (share !== null) forces.push({
        k: run.first + j * track.every, force: ["surge", "sway", "yaw"][i], share });
    }));
    view.data("steps", rowsOf(run));
    if (formOf("strips") === "strips") view.data("forces", forces);
    view.signal("at", state.k ?? -1);
    await view.runAsync();
    await fill(view, $("figure-strips"));
  }
  drawShip(run);
}

// Of the chosen configuration the steps that took longest in replays (m = 0), with the most iterations
// (1) or the largest error (2) over all experiments that enter its verdict, the worst first.
function worstAnywhere(m) {
  const known = facts.experiments.flatMap((experiment, p) => (experiment.trial || (m === 0 && experiment.mode !== "replay") ? []
    : cell(state.c, p)?.hard?.[m] ?? []).map(([k, value]) => ({ p, k, value })));
  // Windows have no experiment of their own: their steps are shown in the loop.
  if (m === 0) known.push(...C().longest_in_windows[state.c].map(([p, k, value]) => ({ p, k, value })));
  const rank = (x) => (x === "inf" ? Infinity : x);
  return known.sort((a, b) => rank(b.value) - rank(a.value))
    .filter(({ p, k }, i) => known.findIndex((other) => other.p === p && other.k === k) === i).slice(0, 5);
}

// Whether the iterations of a configuration differ from step to step.
function varies(c) {
  const known = facts.experiments.flatMap((_, p) => cell(c, p)?.hard?.[1] ?? []).map(([, value]) => value);
  const usual = facts.experiments.flatMap((_, p) => array(cell(c, p)?.i)).filter((x) => x !== null);
  return known.length > 0 && usual.some((x) => x !== known[0]);
}

// The lists of steps that are open: a list that the reader has opened or closed stays so.
const opened = { all: true, one: false };
function foldHard(kind, where, lines) {
  const list = document.createElement("details"), title = document.createElement("summary");
  title.replaceChildren(...coded(`Extreme steps ${where}`));
  list.append(title, ...lines.filter((line) => line?.children.length > 1));
  list.open = opened[kind];
  list.addEventListener("toggle", () => { opened[kind] = list.open; });
  return list.children.length > 1 ? [list] : [];
}

// A time (m = 0), a number of iterations (1), which is exact, or an error (2) of a step.
const written = (m, value) => (m === 0 ? time(value) : m === 1 && value ? grouped(value) : figure(value));

function drawHard(run) {
  const replayed = facts.experiments[state.p].mode === "replay";
  const names = [
    replayed ? "largest step times, each in its fastest round" : "largest single timings, including interruptions by other load", "most iterations", "largest error of the first move [maximum increments]",
  ];
  const row = (name, steps) => {
    const line = document.createElement("p"), head = document.createElement("span");
    Object.assign(head, { className: "soft", textContent: name });
    line.append(head, ...steps.map(({ p, k, said }) => {
      const button = document.createElement("button");
      button.textContent = said;
      button.setAttribute("aria-pressed", String(k === state.k && p === state.p));
      button.addEventListener("click", () => select({ p, k }));
      return button;
    }));
    return line;
  };
  const here = (run.hard ?? []).map((list, m) => row(names[m], list.map(([k, value]) =>
    ({ p: state.p, k, said: `step ${k}: ${written(m, value)}` }))));
  // Where a step is one timing its time is jitter as well: it comes last; iterations that are alike
  // everywhere say nothing.
  const order = (replayed ? [0, 1, 2] : [1, 2, 0]).filter((m) => m !== 1 || varies(state.c));
  const said = (m) => ({ p, k, value }) => ({ p, k,
    said: `${facts.experiments[p].label}, step ${k}: ${written(m, value)}` });
  // Of a single experiment its own lines are enough.
  const several = facts.experiments.filter((_, p) => cell(state.c, p)?.hard).length > 1;
  const most = varies(state.c) ? [1] : [], worst = most.length && !["late", "fail"].includes(C().verdict[state.c]) ? [] : [2];
  const everywhere = [[0, "largest step times of replays and windows, each in its fastest round"],
    ...[...worst, ...most].map((m) => [m, names[m]])];
  const place = `\`${facts.experiments[state.p].label}\``;
  const anywhere = several ? everywhere.map(([m, name]) => row(name, worstAnywhere(m).map(said(m)))) : [];
  $("hard").replaceChildren(...(several ? foldHard("all", "of all runs except those in SI units", anywhere) : []),
    ...foldHard(several ? "one" : "all", `of ${place}`, order.map((m) => here[m])));
  drawStep(run);
}

// Where the ship is at a step, and what it is pushed by.
function moved(run, k) {
  const track = trackOf(run);
  if (!track) return "";
  const at = Math.min(track.x[0].length - 1, Math.round((k - run.first) / track.every));
  const [n, e, psi] = track.x.map((values) => values[at]);
  if (n === null) return "";
  const signed = (x, digits) => figure(x, digits).replaceAll("-", "−");
  const force = ["surge", "sway", "yaw"].map((axis, i) => `${axis} ${signed(100 * track.u[i][at], 2)} %`);
  const kept = run.first + at * track.every;
  return `Ship${kept === k ? "" : ` at step ${kept}, the nearest one stored`}: ${signed(n)} m north, ${signed(e)} m east, heading ${signed((psi * 180) / Math.PI)}°; `
    + `forces ${force.join(", ")} of their amplitude limits.`;
}

// Whether a run has a step k, and the page its numbers.
const stepped = (run, k) => k !== null && typeof array(run.t)[k - run.first] === "number";

function drawStep(run) {
  const box = $("step"), k = state.k, j = k === null ? -1 : k - run.first;
  const t = array(run.t);
  if (!stepped(run, k)) { box.hidden = true; return; }
  const f = array(run.f)[j] ?? 0, said = (bit) => Boolean(f & (1 << bit));
  const known = (run.hard ?? []).flat().find((hard) => hard[0] === k);
  const flags = facts.flags.filter((_, i) => said(i + 2)).map(({ id, term, meaning }) =>
    Object.assign(document.createElement("a"), { className: "term", href: `#${id}`, title: meaning.replaceAll("`", ""), textContent: term }));
  // The packed arrays are rounded; what stands on the buttons is not.
  const exact = run.hard?.[0].find((hard) => hard[0] === k), off = run.hard?.[2].find((hard) => hard[0] === k);
  const error = off ? off[1] : array(run.e)[j];
  const inWindow = C().longest_in_windows[state.c].find((step) => step[0] === state.p && step[1] === k);
  const where = inWindow ? ` in the closed loop shown (${time(inWindow[2])} in its window, fastest round)` : "";
  $("step-said").textContent = `Step ${k}: ${time(exact ? exact[1] : t[j])}${where}, ${array(run.i)[j] == null ? "iterations not reported" : many(array(run.i)[j], "iteration")}, `
    + `${many(array(run.a)[j], "active limit")}, ${[Infinity, "inf"].includes(error) ? "no solution" : `error of the first move ${figure(error)}${error == null ? "" : " times the maximum increment"}`}. `
    + `The solver ${said(0) ? "reported “solved”" : `did not report “solved”${known ? ` (${known[2].toLowerCase()})` : ""}`}. `
    + (!said(0) && said(1) && /infeasible/i.test(known?.[2] ?? "") ? "The QP has no feasible solution. "
      : `Its solution ${said(1) ? "passes" : "fails"} the referee's test of optimality. `);
  $("step-said").append(...flags.flatMap((flag, i) => [i ? ", " : "Flags: ", flag]), flags.length ? ". " : "", moved(run, k));
  const experiment = facts.experiments[run.p];
  // A sea of a study has no file of its own to export from.
  $("step-export").parentElement.hidden = $("step-history").hidden = !experiment.source;
  $("step-history").textContent = (experiment.mode === "replay" ? "" : "This command writes the QP of the reference loop at this step, not that of the solver's own loop. ")
    + "An exported step has no history. To repeat a warm start, export the steps 0 to K with --steps K+1 instead of --at K, and replay the file with dpbench run --sequence FILE.";
  $("step-export").textContent =
    `dpbench export ${experiment.source} --at ${k} --out step-${k}.npz`;
  $("step-query").textContent =
    `pandas.read_parquet("steps.parquet", filters=[("run_id", "==", "${run.id}"), ("k", "==", ${k - (experiment.first ?? 0)})])`;
  box.hidden = false;
}

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
  const host = $("figure-ship"), track = trackOf(run), experiment = facts.experiments[state.p];
  $("ship").hidden = !track;
  if (!track) return;
  const exact = referenceOf(state.p), [N, E, psi] = track.x;
  const last = N.length - 1;
  let at = state.k === null ? last : Math.round((state.k - run.first) / track.every);
  at = Math.max(0, Math.min(last, at));
  const goal = experiment.reference, size = experiment.length_m;
  const all = [...N.map((n, i) => [n, E[i]]), ...(exact ? exact.x[0].map((n, i) => [n, exact.x[1][i]]) : [])]
    .filter(([n, e]) => n !== null && e !== null);
  // The circle of 1 m too, unless it would hide the path.
  if (goal) all.push([goal[0], goal[1]]);
  const reach = (i) => Math.max(...all.map((p) => p[i])) - Math.min(...all.map((p) => p[i]));
  if (goal && Math.max(reach(0), reach(1)) > 0.5) {
    for (const [n, e] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) all.push([goal[0] + n, goal[1] + e]);
  }
  const low = [0, 1].map((i) => Math.min(...all.map((p) => p[i])));
  const high = [0, 1].map((i) => Math.max(...all.map((p) => p[i])));
  const span = Math.max(high[0] - low[0], high[1] - low[1], 1e-3), half = 0.62 * Math.max(span, 0.4);
  const mid = [0, 1].map((i) => 0.5 * (low[i] + high[i])), width = 360;
  const X = (e) => width / 2 + ((e - mid[1]) / half) * (width / 2);
  const Y = (n) => width / 2 - ((n - mid[0]) / half) * (width / 2);
  const root = shape("svg", { viewBox: `0 0 ${width} ${width}`, role: "img",
    "aria-label": `Path of the ship in ${experiment.label} and its hull at the selected step` });
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
  // In a smaller frame the circle is outside.
  $("ship-circle").hidden = !goal || half < 1;
  if (goal) {
    shape("circle", { cx: X(goal[1]), cy: Y(goal[0]), r: (1 / half) * (width / 2), class: "circle" }, clip);
  }
  if (exact) {
    shape("path", { d: path(exact.x[0], exact.x[1]), class: "exact" }, clip);
    const k = run.first + at * track.every;
    const j = Math.max(0, Math.min(exact.x[0].length - 1, Math.round((k - exact.first) / exact.every)));
    hull(exact.x[0][j], exact.x[1][j], exact.x[2][j], { class: "hull-exact" });
  }
  shape("path", { d: path(N, E), class: "path" }, clip);
  if (N[at] !== null) hull(N[at], E[at], psi[at], { class: "hull" });
  // Above the hull, under which the ship has it in the end.
  if (goal) shape("path", { d: `M${X(goal[1]) - 6} ${Y(goal[0])}h12M${X(goal[1])} ${Y(goal[0]) - 6}v12`, class: "goal" }, clip);
  $("ship-hull").hidden = size <= 0.7 * half;
  const metre = 10 ** Math.floor(Math.log10(half)), bar = (metre / half) * (width / 2);
  shape("path", { d: `M12 ${width - 14}h${bar}`, class: "bar" }, root);
  const text = shape("text", { x: 12, y: width - 20, class: "small" }, root);
  text.textContent = `${figure(metre)} m, north up`;
  host.replaceChildren(root);
  const slider = $("ship-k");
  slider.max = String(last); slider.value = String(at);
  const kept = run.first + at * track.every;
  $("ship-said").textContent = `step ${kept}${state.k === null || state.k === kept ? "" : " (the nearest one stored)"}`;
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
    state.k = run.first + at * track.every; at += 2; drawShip(run); drawStep(run);
  }, 33);
}

// The step nearest to a click anywhere among the strips.
function nearestStep(view, event) {
  const x = event.clientX - view.container().querySelector("canvas").getBoundingClientRect().left;
  const wanted = view.scale("x").invert(x - view.origin()[0] - view.padding().left);
  const rows = rowsOf(cell(state.c, state.p));
  return rows.reduce((best, row) => (Math.abs(row.k - wanted) < Math.abs(best.k - wanted) ? row : best)).k;
}

// One solver: what is chosen, the step, the ship.
function listenOne() {
  const choose = (change) => {
    const solver = change.solver ?? C().solver[state.c];
    const c = nearest(solver, change.mode ?? callMode(state.c), change.settings ?? C().settings[state.c]);
    const p = cell(c, state.p) ? state.p : Math.max(0, facts.experiments.findIndex((_, i) => cell(c, i)));
    // The same step of another solver, where that has it.
    select({ c, p, k: p === state.p && stepped(cell(c, p), state.k) ? state.k : null });
  };
  for (const name of ["solver", "mode", "settings"]) on(`choose-${name}`, "change", (value) => choose({ [name]: value }));
  on("choose-experiment", "change", (value) => select({ p: Number(value), k: null }));
  on("ship-k", "input", (value) => {
    const run = cell(state.c, state.p), track = trackOf(run);
    select({ k: run.first + Number(value) * track.every });
  });
  $("ship-play").addEventListener("click", play);
}

FIGURES.strips = {
  canvas: true,
  // A replay and a plant that is no ship have no forces of a ship, so no strip of them.
  form: () => (facts.experiments[state.p].mode === "replay" || facts.experiments[state.p].own_plant
    ? "strips_without_forces" : "strips"),
  sized: (spec, width) => ({ ...spec, width: width - 78, autosize: { type: "pad", resize: true } }),
  picked: (datum, view, event) => select({ k: datum?.k ?? nearestStep(view, event) }),
};
SECTIONS.push({ id: "one", after: ["c", "p", "k"], draw: drawOne, listen: listenOne });
