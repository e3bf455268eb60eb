// A study: what is chosen of it is the configuration and the experiment, a sea at one of its points.
"use strict";

const MOST_TILES = 12;  // Values of a key that stand side by side as tiles.

// The study of the chosen experiment; the first where that is of none.
const studied = () => facts.studies.find((s) => s.name === facts.experiments[state.p]?.study) ?? facts.studies[0];

// The chosen point and sea; of a page that shows another experiment, the study's first.
function there(study) {
  const experiment = facts.experiments[state.p];
  return experiment.study === study.name ? experiment : { point: study.points[0], sea: study.runs.sea[0] };
}

// The number of a sea among the experiments; of a sea that is not there, of the point's first.
function placeOf(study, point, sea) {
  const of = (wanted) => facts.experiments.findIndex((experiment) => experiment.study === study.name
    && experiment.point === point && (wanted === null || experiment.sea === wanted));
  const p = of(sea);
  return p < 0 ? of(null) : p;
}

// Which of the study's configurations is chosen; −1 for none of them.
const whoOf = (study) => study.c.indexOf(state.c);

// The runs of one configuration at one point, or at all of them.
function runsOf(study, who, point = null) {
  const { of, point: at } = study.runs;
  return of.map((_, i) => i).filter((i) => of[i] === who && (point === null || at[i] === point));
}

// Those of some runs that are judged: neither their time limit nor the benchmark ended them.
const judgedOf = (study, runs) => runs.filter((i) => study.runs.within[i] !== null);

// The values of a study's keys at a point, in words.
function valuesAt(study, i) {
  return study.keys.map((key, j) => `${lastOf(key)} ${told(study.values[j][i])}`).join(", ");
}
const lastOf = (key) => key.split(".").slice(/^\d+$/.test(key.split(".").at(-1)) ? -2 : -1).join(".");
const told = (value) => (typeof value === "number" ? figure(value) : String(value ?? "–"));

// The keys that the design is drawn over: those asked for; else the first, and of the others the one
// that tells most points apart beside it, which none does that changes together with it. Of a single
// key twice the same.
function axesOf(study) {
  const [across, up] = ["study-across", "study-up"].map((id) => $(id).value)
    .map((value) => (value !== "" && Number(value) < study.keys.length ? Number(value) : null));
  const first = across ?? 0;
  const apart = (j) => unique(study.points.map((_, i) => `${study.values[first][i]}/${study.values[j][i]}`)).length;
  const others = study.keys.map((_, j) => j).filter((j) => j !== first);
  return [first, up ?? others.reduce((most, j) => (apart(j) > apart(most) ? j : most), others[0] ?? first)];
}

// Few values of two keys make a table; what is no number has no axis.
function asTiles(study) {
  const [across, up] = axesOf(study), own = [across, up].map((j) => unique(study.values[j]));
  return own.flat().some((value) => typeof value !== "number")
    || (across !== up && own.every((values) => values.length <= MOST_TILES));
}

// A row for each place in the plane of two keys: in how many of its seas the ship stays within.
function designRows(study) {
  const [across, up] = axesOf(study), { point } = there(study), who = Math.max(0, whoOf(study));
  const groups = new Map(), tiles = asTiles(study);
  study.points.forEach((id, i) => {
    const x = study.values[across][i], y = across === up ? "" : study.values[up][i];
    const at = `${x}/${y}`;
    if (!groups.has(at)) groups.set(at, { x, y, points: [], within: 0, seas: 0 });
    const group = groups.get(at), own = runsOf(study, who, id);
    group.points.push([id, i]);
    group.seas += judgedOf(study, own).length;
    group.within += own.filter((j) => study.runs.within[j]).length;
  });
  return [...groups.values()].filter((group) => group.seas > 0).map((group) => {
    const chosen = group.points.find(([id]) => id === point);
    const [id, i] = chosen ?? group.points[0];
    // Over one key the height is free: it is the share within.
    const y = across === up && !tiles ? (100 * group.within) / group.seas : group.y;
    return { x: group.x, y, point: id, chosen: Boolean(chosen),
      state: group.within === group.seas ? "all within" : group.within ? "some within" : "none within",
      said: `${group.within}/${group.seas}`,
      values: `${id}: ${valuesAt(study, i)}${group.points.length > 1 ? `, and ${group.points.length - 1} more` : ""}` };
  });
}

// The seas of the chosen point, in the order of how far off the reference is in each.
function seaRows(study) {
  const { point, sea } = there(study), who = Math.max(0, whoOf(study));
  const of = (which) => runsOf(study, which, point).map((i) => ({ i, sea: study.runs.sea[i], value: study.runs.tail_m[i] }))
    .filter((row) => row.value !== null);
  const reference = of(study.reference), own = of(who);
  const order = unique([...[...reference].sort((a, b) => a.value - b.value), ...own].map((row) => row.sea));
  const rows = (list, name) => list.map((row) => ({ order: order.indexOf(row.sea) + 1, value: row.value,
    who: name, replicate: row.sea, chosen: row.sea === sea && name === "chosen" }));
  return [...(who === study.reference ? [] : rows(reference, "reference")), ...rows(own, "chosen")];
}

function meanRows(study) {
  return study.means.map((mean, i) => ({ ...mean, name: study.names[i], c: study.c[i], chosen: study.c[i] === state.c }));
}

function behindRows(study) {
  const { point, sea } = there(study);
  return study.runs.of.map((_, i) => i)
    .filter((i) => study.runs.point[i] === point && study.runs.error_excess_cm[i] !== null && study.runs.of[i] !== study.reference)
    .map((i) => ({ name: study.names[study.runs.of[i]], c: study.c[study.runs.of[i]], error_excess_cm: study.runs.error_excess_cm[i],
      replicate: study.runs.sea[i], chosen: study.runs.sea[i] === sea && study.c[study.runs.of[i]] === state.c }));
}

// What is said of the chosen configuration, point and sea.
function studySaid(study) {
  const { point, sea } = there(study), who = whoOf(study), i = study.points.indexOf(point);
  const at = `Point ${point} (${valuesAt(study, i)})`;
  if (who < 0) return `${at}. ${label(state.c)} is not in this study.`;
  const own = runsOf(study, who, point), all = judgedOf(study, runsOf(study, who)), within = (list) => list.filter((j) => study.runs.within[j]).length;
  const run = own.find((j) => study.runs.sea[j] === sea), behind = run === undefined ? null : study.runs.error_excess_cm[run];
  const tail = run === undefined ? null : study.runs.tail_m[run];
  const here = run === undefined ? "was not run" : study.runs.within[run] === null ? "was not judged, as its time limit or the benchmark ended it"
    : tail === null ? "did not end"
    : `${study.runs.within[run] ? "within the radius" : "beyond the radius"}, at most ${figure(tail)} m off in the second half`
      + (behind === null || who === study.reference ? "" : `, ${figure(behind)} cm more error than ${study.names[study.reference]}`);
  const share = all.length ? within(all) / all.length : NaN, none = study.bound_of_none_percent;
  const bounded = share === 1 || share === 0
    ? ` (95 % bound: at ${share ? "least" : "most"} ${share ? 100 - none : none} % of all realisations)` : "";
  return `${at}: with ${study.names[who]} the ship stays within ${study.radius_m} m in ${within(own)} of ${judgedOf(study, own).length} realisations, and over all points in `
    + `${within(all)} of ${all.length}${bounded}. Realisation ${sea}: ${here}.`;
}

function drawStudyChoice(study) {
  const { point, sea } = there(study), axes = axesOf(study);
  options("study-of", facts.studies.map((s) => [s.name, s.name]), study.name);
  options("study-who", study.names.map((name, i) => [study.c[i], name]), state.c);
  for (const [id, j] of [["study-across", axes[0]], ["study-up", axes[1]]])
    options(id, study.keys.map((key, i) => [i, key]), j);
  for (const node of document.querySelectorAll(".keys")) node.hidden = study.keys.length < 3;
  const seas = runsOf(study, Math.max(0, whoOf(study)), point).map((i) => study.runs.sea[i]);
  const bounds = { "study-point": [point, study.points], "study-sea": [sea, seas.length ? seas : [sea]] };
  for (const [id, [value, known]] of Object.entries(bounds)) {
    Object.assign($(id), { value, min: Math.min(...known), max: Math.max(...known) });
  }
}

async function drawStudy() {
  const study = studied();
  if (!study) return;
  drawStudyChoice(study);
  $("study-said").textContent = studySaid(study);
  const fill = async (name, tables, signals = {}) => {
    const view = await figureOf(name);
    if (!view) return;
    for (const [key, value] of Object.entries(signals)) view.signal(key, value);
    for (const [key, rows] of Object.entries(tables)) view.data(key, rows);
    await view.runAsync();
  };
  const [across, other] = axesOf(study).map((j) => study.keys[j]);
  const up = across !== other ? other : asTiles(study) ? "" : "realisations within [%]";
  $("figure-design").parentElement.hidden = !study.keys.length;
  if (study.keys.length) await fill("design", { design: designRows(study) }, { across, up });
  await fill("behind", { means: meanRows(study), seas: behindRows(study) });
  await fill("seas", { there: seaRows(study), radius: [{ limit: study.radius_m }] });
}

// A point, a row, a dot: what it stands for is chosen, the rest of the selection stays.
function pickedOfStudy(datum) {
  const study = studied(), now = there(study);
  const p = placeOf(study, datum.point ?? now.point, datum.replicate ?? now.sea);
  select({ c: datum.c ?? state.c, p: p < 0 ? state.p : p, k: null });
}

function listenStudy() {
  const choose = (change) => {
    const study = studied(), now = { ...there(study), ...change };
    if (study.points.includes(now.point)) select({ p: placeOf(study, now.point, now.sea), k: null });
    else drawStudyChoice(study);
  };
  const chosen = (id, act) => on(id, "change", act);
  chosen("study-of", (name) => {
    const study = facts.studies.find((s) => s.name === name);
    const p = placeOf(study, study.points[0], study.runs.sea[0]);
    select({ c: study.c.includes(state.c) ? state.c : study.c[0], p, k: null });
  });
  chosen("study-who", (c) => select({ c: Number(c), k: null }));
  chosen("study-point", (point) => choose({ point: Number(point) }));
  chosen("study-sea", (sea) => choose({ sea: Number(sea) }));
  for (const id of ["study-across", "study-up"]) chosen(id, drawStudy);
}

const OF_STUDY = { picked: (datum) => datum && pickedOfStudy(datum) };
FIGURES.design = {
  ...OF_STUDY,
  // A design of many values is no table.
  form: () => (asTiles(studied()) ? "design_tiles" : "design_points"),
  sized: (spec, width) => ({ ...named(spec), width, autosize: FIT }),
};
FIGURES.behind = FIGURES.seas = { ...OF_STUDY, canvas: true };
SECTIONS.push({ id: "study-live", after: ["c", "p"], draw: drawStudy, listen: listenStudy });
