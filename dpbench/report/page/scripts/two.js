// Two configurations on the steps that both were timed on.
"use strict";

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
