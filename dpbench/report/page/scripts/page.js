// What follows from a change of the selection, what listens to the reader, and the start.
"use strict";

// Names, of many only where the computer is slower.
const listed = (rows, say = (row) => row.solver) => (rows.length && (rows.length <= 6 || state.slow > 1)
  ? `: ${rows.map(say).join(", ")}` : "");

// The speed margin of the chosen configuration, and the solvers that stay within both limits on the
// slower computer: of those that meet the demand here, or that nothing contradicts where none does.
function kept() {
  const { deadline_ms, p99_ms } = facts.demand, margin = C().margin[state.c];
  const own = margin === null ? "" : `${C().solver[state.c]}: ${
    margin < state.slow ? "late beyond" : "up to"} × ${roundedDown(margin)}. `;
  const which = (...states) => rowsDrawn("ladder").values.filter((row) => states.includes(row.state));
  const meeting = which("meets"), right = meeting.length ? meeting : which("borderline", "open");
  if (!right.length) return own;
  const safe = right.filter((row) => state.slow <= 1 || row.margin >= state.slow).sort((a, b) => b.margin - a.margin);
  return `${own}${safe.length} of the ${right.length} that ${meeting.length ? "meet the demand" : "nothing contradicts"
  } here keep the deadline of ${deadline_ms} ms and a p99 of ${p99_ms} ms${
    listed(safe, (row) => `${row.solver} (× ${roundedDown(row.margin)})`)}.`;
}

// Where the slider stops: 1, 2 and 5 of each decade.
const notch = (i) => [1, 2, 5][i % 3] * 10 ** Math.floor(i / 3);

// How the chosen one's times compare with those of the answer.
function beside() {
  const first = facts.answer.first, rows = first === state.c ? [] : together(first, state.c);
  return rows.length
    ? `, ${figure(ratioOf(rows))} × the time of ${unlike(first, state.c)} (geometric mean of the same steps)` : "";
}

// The line that stays: the chosen one with its times and where it is shown; on a phone without what
// stands elsewhere too.
function drawChosen() {
  const c = state.c, timed = facts.places[C().timed_at[c]]?.label, longest = facts.places[C().longest_at[c]]?.label;
  const wide = (text) => {
    const span = document.createElement("span");
    span.className = "wide-only"; span.textContent = text;
    return span;
  };
  const times = [["p50", "p50"], ["p99", "replay_p99", timed && ` in ${timed}`],
    ["p99 of timings", "raw_p99"], ["worst p99", "p99", ` in ${C().p99_in[c]}`], ["hardest step", "max", " of all replays"],
    ["largest timing", "longest", longest && ` in ${longest}`]]
    .filter(([, column]) => C()[column][c] !== null)
    .flatMap(([name, column, where]) => [`, ${name} ${time(C()[column][c])}`, wide(where ?? "")]);
  const outcome = C().outcome[c] === "not judged" ? "" : `: ${C().outcome[c]}`;
  $("chosen").replaceChildren(`${label(c)}${outcome}`, ...times, wide(beside()),
    `; shown in ${facts.places[state.p].label}${state.k === null ? "" : `, k ${state.k}`}`);
}

// Whose point is the large one, as a phone has no room for every name.
function pointed() {
  const own = rowsDrawn("accuracy").values.find((row) => Number(row.id) === state.c);
  return own ? `Largest point, the chosen one: ${label(state.c)}.` : `${label(state.c)} has no point here.`;
}

// Draws the eye to what has changed.
function glow(node) {
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  node.animate([{ backgroundColor: "var(--warn-fill)" }, { backgroundColor: "transparent" }], 1500);
}

// What follows from a change of some parts of the selection; without them, from all of it.
async function draw(changed = ["slow", "c", "p", "b", "k"]) {
  if (!count()) { drawTable(); return; }
  const touched = (...parts) => parts.some((part) => changed.includes(part));
  drawChosen();
  if (touched("c", "p")) glow($("chosen"));
  if (touched("slow", "c") && $("slow")) {
    $("slow-said").value = figure(state.slow);
    $("slow").value = String(Math.round(3 * Math.log10(state.slow)));
    $("slow").setAttribute("aria-valuetext", `× ${figure(state.slow)}`);
    $("slow-kept").textContent = kept();
    await signal("ladder", { slow: state.slow });
  }
  if (touched("c", "p")) {
    await mark("ladder", { id: String(state.c) });
    await mark("matrix", { id: String(state.c), place_id: String(state.p) });
    await mark("accuracy", { id: String(state.c) });
    if ($("accuracy-chosen")) $("accuracy-chosen").textContent = pointed();
    drawTable();
  }
  if (touched("c", "p")) await drawStudy();
  if (touched("c", "p", "k")) await drawOne();
  if (touched("c", "b") && $("two")) await drawTwo();
}

// A text to the clipboard; where the browser has none to give, it is marked for copying by hand.
async function copy(button, text) {
  try {
    await navigator.clipboard.writeText(text.textContent);
    const said = button.textContent;
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = said; }, 2000);
  } catch {
    text.hidden = false;
    getSelection().selectAllChildren(text);
    button.textContent = "Marked: copy by hand";
  }
}

// To a section; the address keeps the selection.
function go(id) {
  const section = $(id), folded = section.closest("details");
  if (folded) folded.open = true;
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
  listenStudy();
  for (const name of ["ladder", "matrix"]) steerable(name);
  $("matrix-way")?.append(...unique(all().map(way)).map((w) => new Option(w.replace("-", " "), w)));
  $("matrix-way")?.addEventListener("change", drawMatrix);
  $("choose-other")?.addEventListener("change", (e) => select({ b: Number(e.target.value) }));
  $("slow")?.addEventListener("input", (e) => select({ slow: notch(Number(e.target.value)) }));
  $("slow-said")?.addEventListener("change", (e) => select({ slow: atMost(e.target.value) }));
  $("percentile")?.addEventListener("change", (e) => signal("accuracy", { percentile: e.target.value }));
  for (const button of document.querySelectorAll("[data-copy]")) {
    button.addEventListener("click", () => copy(button, $(button.dataset.copy)));
  }
  for (const [id, event] of [["filter", "input"], ["group", "change"], ["of", "change"]]) {
    $(`table-${id}`).addEventListener(event, () => { sorting.from = 0; drawTable(); });
  }
  $("table-back").addEventListener("click", () => { sorting.from -= ROWS; drawTable(); });
  $("table-next").addEventListener("click", () => { sorting.from += ROWS; drawTable(); });
  $("table-csv").addEventListener("click", () => download("runs.csv", csv()));
  listenPage();
}

// One solver: what is chosen, the step, the ship.
function listenOne() {
  if (!$("one")) return;
  const choose = (change) => {
    const solver = change.solver ?? C().solver[state.c];
    const c = nearest(solver, change.way ?? way(state.c), change.settings ?? C().settings[state.c]);
    const p = cell(c, state.p) ? state.p : Math.max(0, facts.places.findIndex((_, i) => cell(c, i)));
    // The same step of another solver, where that has it.
    select({ c, p, k: p === state.p && stepped(cell(c, p), state.k) ? state.k : null });
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
  for (const link of document.querySelectorAll("[data-section], .term")) {
    link.addEventListener("click", (event) => {
      event.preventDefault();
      // The way back leads here again.
      history.pushState(null, "", location.hash || location.pathname);
      const id = link.getAttribute("href").slice(1);
      go(id);
      if (link.className === "term") glow($(id));
    });
  }
  listenTerms();
  onNewLook(redraw);
  // Links within the page stop below the lines that stay, however many there are.
  new ResizeObserver(([bar]) => {
    document.documentElement.style.scrollPaddingTop = `${bar.target.offsetHeight + 4}px`;
  }).observe(document.querySelector(".top"));
  for (const button of document.querySelectorAll("[data-go]")) {
    button.addEventListener("click", () => {
      const [solver, w, settings] = button.dataset.go.split("~");
      select({ c: configuration(solver, w, settings), k: null });
    });
  }
}

// What a term means, for those who come to it by the keyboard: a mouse has its title.
function listenTerms() {
  const box = $("tip"), hide = () => { box.hidden = true; };
  for (const term of document.querySelectorAll(".term")) {
    term.addEventListener("focus", () => {
      if (!term.matches(":focus-visible")) return;
      box.textContent = term.title;
      box.hidden = false;
      const place = term.getBoundingClientRect();
      box.style.left = `${Math.max(8, Math.min(place.left, innerWidth - box.offsetWidth - 8)) + scrollX}px`;
      box.style.top = `${place.bottom + 6 + scrollY}px`;
    });
    term.addEventListener("blur", hide);
    term.addEventListener("keydown", (event) => { if (event.key === "Escape") hide(); });
  }
}

async function start() {
  await unpack();
  facts.index = new Map((facts.cells.c ?? []).map((c, i) => [`${c}/${facts.cells.p[i]}`, i]));
  for (const node of document.querySelectorAll("[data-live]")) node.hidden = false;
  for (const node of document.querySelectorAll("[data-static]")) node.hidden = true;
  read();
  listen();
  const name = location.hash.slice(1);
  await draw();
  if (name && !name.includes("=") && $(name)) go(name);
  document.documentElement.dataset.ready = "yes";
}
start();
