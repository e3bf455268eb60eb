// The page of a comparison: one chosen configuration on one sequence, kept in the address.
//
//   #s=osqp&w=native-warm&set=high&sc=paper&k=74
"use strict";

const ROWS = 20, NARROW = 640;
const views = {}, state = { c: 0, k: null };
const one = (name) => facts.compared[name][state.c];

// -- selection ----------------------------------------------------------------------------------

function read() {
  const asked = new URLSearchParams(location.hash.slice(1)), k = asked.get("k");
  asked.delete("k");
  const wanted = facts.compared.address.indexOf(String(asked));
  state.c = wanted < 0 ? 0 : wanted;
  state.k = k !== null && k !== "" && Number.isInteger(Number(k)) ? Number(k) : null;
}

function select(change) {
  Object.assign(state, change);
  const text = `#${one("address")}${state.k === null ? "" : `&k=${state.k}`}`;
  if (text !== location.hash) history.pushState(null, "", text);
  draw();
}

// -- figures ------------------------------------------------------------------------------------

function sized(name, width) {
  const spec = facts.charts[name], narrow = width < NARROW;
  const fit = { type: name === "ratios" ? "fit-x" : "fit", contains: "padding", resize: true };
  const square = Math.min(width, 460);
  const values = { narrow, ...(narrow ? { y_step: facts.row_step.narrow } : {}) };
  const signals = (spec.signals ?? []).map((s) => (s.name in values ? { ...s, value: values[s.name] } : s));
  return name === "ratios" ? { ...spec, width, autosize: fit, signals }
    : { ...spec, width: square, height: square, autosize: fit };
}

async function made(name, host) {
  const spec = sized(name, Math.floor(host.parentElement.clientWidth)), canvas = name === "steps";
  const aside = document.createElement("div");
  const view = new vega.View(vega.parse(canvas ? inked(spec) : spec), {
    renderer: canvas ? "canvas" : "svg", hover: true, tooltip: vegaTooltip(),
    loader: { load: () => null },
  });
  await view.initialize(aside).runAsync();
  host.replaceChildren(aside);
  view.addEventListener("click", (_, item) => {
    if (item?.datum?.k !== undefined) select({ k: item.datum.k });
    else if (item?.datum?.id !== undefined) select({ c: Number(item.datum.id), k: null });
  });
  return view;
}

async function figureOf(name) {
  const host = $(`figure-${name}`);
  if (!host || !facts.charts[name]) return null;
  views[name] ??= made(name, host);
  return views[name];
}

async function mark(name) {
  const view = await figureOf(name);
  if (!view) return;
  view.data("pick_store", [{ unit: "", fields: [{ type: "E", field: "id" }], values: [String(state.c)] }]);
  await view.runAsync();
}

async function redraw() {
  for (const name of Object.keys(views)) { (await views[name])?.finalize(); delete views[name]; }
  await draw();
}

// -- the chosen one -----------------------------------------------------------------------------

function rows() {
  const a = array(one("a")), b = array(one("b")), first = one("first");
  return a.map((ns, j) => ({ k: first + j, a_us: ns / 1e3, b_us: b[j] / 1e3, sequence: one("where") }))
    .filter((row) => row.a_us > 0 && row.b_us > 0);
}

async function drawOne() {
  const steps = rows();
  $("one-title").textContent = `${one("name")} on ${one("where")}`;
  $("one-said").textContent = `${one("said")} Above the dashed line, B is slower.`;
  $("step-said").textContent = "At least one of the two folders has no steps.";
  if (!steps.length) return;
  const at = steps.find((row) => row.k === state.k);
  $("step-said").textContent = at
    ? `Step ${at.k}: A ${figure(at.a_us)} µs, B ${figure(at.b_us)} µs, ratio ${figure(at.b_us / at.a_us)}.`
    : "Click a dot to see its step.";
  const furthest = [...steps].sort((x, y) => y.b_us / y.a_us - x.b_us / x.a_us).slice(0, 5);
  $("furthest").replaceChildren("Steps with the largest ratios: ", ...furthest.flatMap((row) => {
    const button = document.createElement("button");
    button.textContent = `step ${row.k}: × ${figure(row.b_us / row.a_us)}`;
    button.setAttribute("aria-pressed", String(row.k === state.k));
    button.addEventListener("click", () => select({ k: row.k }));
    return [button, " "];
  }));
  const view = await figureOf("steps");
  if (view) await view.data("pairs", steps).runAsync();
}

// -- the table ----------------------------------------------------------------------------------

function drawTable() {
  const filter = $("table-filter").value.toLowerCase(), table = facts.compared;
  const found = table.name.map((_, i) => i).filter((i) =>
    `${table.name[i]} ${table.cells[i].join(" ")}`.toLowerCase().includes(filter));
  const shown = found.slice(0, ROWS);
  $("times-body").replaceChildren(...shown.map((i) => {
    const tr = document.createElement("tr");
    table.cells[i].forEach((text, j) => {
      const td = document.createElement("td");
      td.dataset.name = j > 1 ? facts.heads[j] : "";
      if (j === 0) {
        const button = document.createElement("button");
        button.textContent = text;
        button.setAttribute("aria-pressed", String(i === state.c));
        td.append(button);
      } else td.textContent = text;
      if (j > 1 && j < facts.heads.length - 1) td.className = "n";
      tr.append(td);
    });
    tr.addEventListener("click", () => { select({ c: i, k: null }); $("one").scrollIntoView(); });
    return tr;
  }));
  $("table-said").textContent = `${shown.length} of ${found.length} rows`;
}

// -- drawing all of it --------------------------------------------------------------------------

async function draw() {
  drawTable();
  await mark("ratios");
  await mark("both");
  await drawOne();
}

async function start() {
  await unpack();
  for (const node of document.querySelectorAll("[data-live]")) node.hidden = false;
  for (const node of document.querySelectorAll("[data-static]")) node.hidden = true;
  $("table-filter").addEventListener("input", drawTable);
  addEventListener("popstate", () => { read(); draw(); });
  onNewLook(redraw);
  read();
  await draw();
  document.documentElement.dataset.ready = "yes";
}
start();
