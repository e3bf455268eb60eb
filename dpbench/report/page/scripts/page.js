// What follows from a change of the selection, what listens to the reader, and the start.
"use strict";

// The line that stays on a wide screen: the selected configuration, its verdict and times.
function drawChosen() {
  const c = state.c, timed = facts.experiments[C().timed_experiment_index[c]]?.label;
  const about = [
    C().verdict[c] !== "not judged" && `overall verdict ${C().verdict[c]}`,
    C().p50[c] !== null && `p50 ${time(C().p50[c])}${timed ? ` in \`${timed}\`` : ""}`,
    C().limited_by[c] || (C().max[c] !== null && `longest step ${time(C().max[c])}${C().max_wait[c]} in ${C().max_in[c]}`),
  ].filter(Boolean).join(", ");
  $("chosen").replaceChildren(...coded(`${marked(c)}${about && `, ${about}`}`));
}

// Draws the eye to what has changed.
function glow(node) {
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  node.animate([{ backgroundColor: "var(--warn-fill)" }, { backgroundColor: "transparent" }], 1500);
}

// What follows from a change of some parts of the selection; without them, from all of it.
async function draw(changed = ["slow", "c", "p", "b", "k", "cpi", "mhz"]) {
  if (!count()) { drawTable(); return; }
  drawChosen();
  const touched = (parts) => parts.some((part) => changed.includes(part));
  if (touched(["c", "p"])) glow($("chosen"));
  for (const own of sections()) if (touched(own.after)) await own.draw();
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
    button.textContent = "Selected: copy it by hand";
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
  for (const own of sections()) own.listen?.();
  for (const button of document.querySelectorAll("[data-copy]")) {
    button.addEventListener("click", () => copy(button, $(button.dataset.copy)));
  }
  listenPage();
}

// A link to a section or term of the page leaves the selection in the address.
function leadsTo(link) {
  link.addEventListener("click", (event) => {
    event.preventDefault();
    // The way back leads here again.
    history.pushState(null, "", location.hash || location.pathname);
    const id = link.getAttribute("href").slice(1);
    go(id);
    if (link.className === "term") glow($(id));
  });
}

// The address, the width, links to sections.
function listenPage() {
  addEventListener("popstate", arrived);
  for (const link of document.querySelectorAll("[data-section], .term")) leadsTo(link);
  // A badge leads to its result.
  for (const link of document.querySelectorAll(".chips a")) {
    link.addEventListener("click", (event) => {
      event.preventDefault();
      select({ c: facts.answer.first, p: Number(link.dataset.experiment), k: null });
      go("one");
    });
  }
  on("sections", "change", go);
  document.querySelectorAll(".term").forEach(explain);
  onNewLook(redraw);
  // Links within the page stop below the lines that stay, however many there are.
  new ResizeObserver(([bar]) => {
    document.documentElement.style.scrollPaddingTop = `${bar.target.offsetHeight + 4}px`;
  }).observe(document.querySelector(".top"));
}

// What a term means, for those who come to it by the keyboard: a mouse has its title.
function explain(term) {
  const box = $("tip"), hide = () => { box.hidden = true; };
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
