// The table of all runs: found, sorted, chosen from, saved.
"use strict";

const ROWS = 20;
const sorting = { column: 0, down: false, from: 0 };
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
  const rank = (x) => (x === "inf" ? 1e300 : x);
  rows.sort((a, b) => {
    const x = rank(values[a]), y = rank(values[b]);
    // What has no value stands last, whichever way the others are sorted.
    if ((x === null) !== (y === null)) return x === null ? 1 : -1;
    return (x < y ? -1 : x > y ? 1 : a - b) * (sorting.down ? -1 : 1);
  });
  const from = sorting.from = Math.max(0, Math.min(sorting.from, rows.length - 1));
  const head = document.createElement("tr");
  for (const [column, j] of shown) {
    const th = document.createElement("th"), button = document.createElement("button");
    th.scope = "col"; button.textContent = column.label; button.title = column.meaning ? `${column.name}: ${column.meaning.replaceAll("; ", "\n")}` : "";
    if (sorting.column === j) th.setAttribute("aria-sort", sorting.down ? "descending" : "ascending");
    button.addEventListener("click", () => {
      sorting.down = sorting.column === j ? !sorting.down : false;
      sorting.column = j; sorting.from = 0; drawTable();
    });
    th.append(button); head.append(th);
  }
  // A row is chosen where it stands; its name opens it above.
  // A window has no experiment of its own: its closed loop is shown.
  const choose = (i) => {
    const window = table.windows.includes(i) ? i : null;
    if (table.p[i] !== null) select({ c: table.c[i], p: table.p[i], k: null, window });
  };
  const body = rows.slice(from, from + ROWS).map((i) => {
    const tr = document.createElement("tr");
    for (const [column, j] of shown) {
      const td = document.createElement("td"), value = table.values[j][i];
      td.dataset.name = column.group ? column.label : "";
      if (j === 0 && table.p[i] !== null) {
        const button = document.createElement("button");
        button.textContent = value;
        button.addEventListener("click", () => { choose(i); go("one"); });
        td.append(button);
      } else td.textContent = column.text ? value : figure(scaled(value, column), 4);
      if (!column.text) td.className = "n";
      if (value === null || value === "") td.classList.add("empty");
      tr.append(td);
    }
    const isShown = table.c[i] === state.c && table.p[i] === state.p && !table.windows.includes(i);
    if (state.window === null ? isShown : i === state.window) tr.setAttribute("aria-current", "true");
    tr.addEventListener("click", () => choose(i));
    return tr;
  });
  $("table-head").replaceChildren(head);
  $("table-body").replaceChildren(...body);
  $("table-said").textContent = `${rows.length ? `rows ${grouped(from + 1)} to ${grouped(Math.min(from + ROWS, rows.length))} of ${grouped(rows.length)}` : "no row matches"}${
    rows.length === table.rows ? "" : `${rows.length ? " selected" : ""}; ${grouped(table.rows)} in total`}${
    table.calibration_runs ? `, including ${many(table.calibration_runs, "calibration run")}` : ""}`;
  turnable($("table-back"), from > 0, $("table-next"));
  turnable($("table-next"), from + ROWS < rows.length, $("table-back"));
  state.rows = rows; state.shown = shown;
  drawQuery();
}

// Whether there are more rows that way; at the end of them the keys go over to the other button.
function turnable(button, more, other) {
  const had = document.activeElement === button;
  button.disabled = !more;
  if (had && !more) { other.disabled = false; other.focus(); }
}

// A number as it is shown: in the unit of its column's name there.
function scaled(value, column) {
  return column.scale && typeof value === "number" ? value * column.scale : value;
}

// The value of a column of the table in a row.
const valueOf = (name, i) => facts.table.values[facts.table.columns.findIndex((column) => column.name === name)][i];

// The row of the run with the limiting p99, until the reader selects a scenario; then null.
function limitingRow() {
  const ids = facts.table.columns.findIndex((column) => column.name === "run_id");
  const row = new URLSearchParams(location.hash.slice(1)).has("sc") ? -1
    : facts.table.values[ids].indexOf(C().p99_run_id?.[state.c]);
  return row < 0 ? null : row;
}

// The steps of the selected run.
function drawQuery() {
  const run = cell(state.c, state.p), row = state.window ?? limitingRow();
  const id = row === null ? run?.id : valueOf("run_id", row);
  const where = row === null ? facts.experiments[state.p]?.label : valueOf("where", row);
  $("data-query").closest("details").hidden = !id;
  $("data-query").textContent = !id ? ""
    : `steps = pandas.read_parquet("steps.parquet", filters=[("run_id", "==", "${id}")])`
      + `  # ${label(state.c)} in ${where}`
      + (row !== null || facts.experiments[state.p].mode === "replay"
        ? `\ntotal_ns = steps.filter(regex="^(setup|update|solve|read|allocation)_ns$").sum(axis=1)`
          + `\ntotal_ns[steps.counts].groupby(steps.k).min()`
          + (!facts.table.windows.includes(row) ? `.quantile([0.5, 0.99]) / 1e3  # p50 and p99 [µs]`
            : ` / 1e3  # time of each step [µs]; k = 0 is the first step of the window`)
        : "");
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

SECTIONS.push({
  id: "data", after: ["c", "p", "window"], draw: drawTable,
  listen: () => {
    for (const [id, event] of [["filter", "input"], ["group", "change"], ["of", "change"]]) {
      on(`table-${id}`, event, () => { sorting.from = 0; drawTable(); });
    }
    $("table-back").addEventListener("click", () => { sorting.from -= ROWS; drawTable(); });
    $("table-next").addEventListener("click", () => { sorting.from += ROWS; drawTable(); });
    $("table-csv").addEventListener("click", () => download("runs.csv", csv()));
  },
});
