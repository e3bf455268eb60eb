// Two configurations on the steps that both were timed on.
"use strict";

// The steps of all sequences that two configurations have replayed, with the time of each.
function together(first, second) {
  const rows = [];
  facts.experiments.forEach((experiment, p) => {
    const a = cell(first, p), b = cell(second, p);
    if (experiment.mode !== "replay" || !a || !b || a.t == null || b.t == null) return;
    const x = array(a.t), y = array(b.t), f = array(a.f), g = array(b.f);
    const whole = [a, b].some((run) => facts.arrays[run.t][4] !== undefined) ? Math.min(a.steps, b.steps) : null;
    x.forEach((ns, j) => {
      const i = a.first + j - b.first, other = y[i];
      if (ns > 0 && other > 0 && !((f[j] | g[i]) & HARD_ONLY)) rows.push({
        k: a.first + j, a_us: ns / 1e3, b_us: other / 1e3, sequence: experiment.label,
        variables: facts.paired.variables[p], whole, separate: whySeparate(first, second, p),
        spread: Math.max(spreadOf(first, p), spreadOf(second, p)) });
    });
  });
  return rows;
}

// Why two replays make no ratio; "" where they were interleaved.
function whySeparate(first, second, p) {
  const [a, b] = [first, second].map((c) => facts.paired.turns[p]?.[c]);
  if (!a || !b || a[0] === b[0]) return "";
  return a[1] === b[1] ? "not interleaved" : "timed in separate commands";
}

// The slowest over the fastest round of a disturbed replay, Infinity for one round; 1 if quiet.
function spreadOf(c, p) {
  const spread = facts.paired.spreads[p]?.[c];
  return spread === undefined ? 1 : spread ?? Infinity;
}

// Why a ratio with an interval from `low` > 1 ranks neither of two; "" where it does.
function whyUnranked(rows, low) {
  const spread = ofLargest(rows).reduce((most, row) => Math.max(most, row.spread), 1);
  if (!(low > 1 && low <= spread)) return "";
  return ` No ranking, as the machine was disturbed and ${Number.isFinite(spread)
    ? `rounds differ by a factor of up to ${figure(spread)}` : "there is a single round"}.`;
}

// The steps of which two make a ratio, those interleaved; all where there are none.
function comparedSteps(first, second) {
  const rows = together(first, second), paired = rows.filter((row) => !row.separate);
  return paired.length ? paired : rows;
}

// The steps of the largest QPs: the ratio depends on the size, and is not pooled over sizes.
function ofLargest(rows) {
  const most = rows.reduce((size, row) => Math.max(size, row.variables), 0);
  return rows.filter((row) => row.variables === most);
}

// The number of a pair of configurations in the packed arrays; -1 without one.
function pairOf(first, second) {
  const { c } = facts.paired;
  const [i, j] = [c.indexOf(first), c.indexOf(second)].sort((a, b) => a - b);
  return i < 0 ? -1 : i * c.length - (i * (i + 1)) / 2 + j - i - 1;
}

// How many times as long the second takes on the largest QPs: the geometric mean, each sequence of
// equal weight; over all steps where the ratio has an interval, else over those on the page.
function ratioOf(first, second, rows) {
  const { c, ratio } = facts.paired, log = array(ratio)[pairOf(first, second)] ?? null;
  if (log !== null) return Math.exp(c.indexOf(first) < c.indexOf(second) ? log : -log);
  const largest = ofLargest(rows);
  const means = unique(largest.map((row) => row.sequence)).map((name) => {
    const own = largest.filter((row) => row.sequence === name);
    return own.reduce((sum, row) => sum + Math.log(row.b_us / row.a_us), 0) / own.length;
  });
  return Math.exp(means.reduce((sum, x) => sum + x, 0) / means.length);
}

// In how many steps of the largest QPs the slower one is slower; "" where the interval excludes 1.
function slowerIn(rows, low, isSecond) {
  if (low > 1) return "";
  const largest = ofLargest(rows), longer = largest.filter((row) => (isSecond ? row.b_us > row.a_us : row.a_us > row.b_us));
  return `It is slower in ${grouped(longer.length)} of ${grouped(largest.length)} steps, but the interval includes 1. `;
}

// By what factor the 95 % interval of the ratio of two reaches up and down; null without one.
function reachOf(first, second) {
  const log = array(facts.paired.reach)[pairOf(first, second)] ?? null;
  return log === null ? null : Math.exp(log);
}

// The geometric mean time of a step of the largest QPs [ns] of the first ("a") or second ("b").
function meanOf(rows, which) {
  const logs = ofLargest(rows).map((row) => Math.log(row[`${which}_us`]));
  return 1e3 * Math.exp(logs.reduce((sum, x) => sum + x, 0) / logs.length);
}

// What tells a configuration from another: its solver, if that will do.
const unlike = (c, other) => (C().solver[c] === C().solver[other] ? marked(c) : `\`${C().solver[c]}\``);

// Which steps they are, all of the replays or those on the page; of QPs of several sizes also how
// large these are.
function commonSteps(rows, all = false) {
  const largest = ofLargest(rows);
  const counts = unique(largest.map((row) => row.sequence)).map((name) => {
    const own = largest.filter((row) => row.sequence === name);
    return `${grouped((all && own[0].whole) || own.length)} steps of \`${name}\``;
  });
  const [replay, are] = counts.length > 1 ? ["replays", "of equal weight, "] : ["replay", ""];
  const size = largest.length < rows.length ? `, ${are}the ${replay} with the largest QPs (${largest[0].variables} variables)` : are && ", of equal weight";
  return `${counts.join(" and ")}${size}`;
}

// What the dots of the figure are: those of QPs of one size are one cluster.
function captionOf(rows, second) {
  const replays = unique(rows.map((row) => row.sequence)).map((name) =>
    `of \`${name}\`, with ${rows.find((row) => row.sequence === name).variables} variables,`);
  return `Each dot is one step ${replays.join(" or ")} timed in its fastest round. Below the dashed line, ${
    unlike(second, state.c)} is faster.`;
}

// A caution on two compared mean times below the shortest time that was checked, or "".
function shortTimes(first, second, rows) {
  const { shortest } = facts.paired;
  const short = [[first, meanOf(rows, "a")], [second, meanOf(rows, "b")]].filter(([, ns]) => ns < shortest);
  if (!short.length) return "";
  const names = short.map(([c]) => marked(c)).join(" and "), times = short.map(([, ns]) => time(ns)).join(" and ");
  return ` Over these steps, ${names} ${short.length > 1 ? "take" : "takes"} ${times} on average, less than ${
    shortest / 1e3} µs, the shortest time for which the timing was checked. ${short.length > 1
    ? "Differences between such times may be due to the bindings, not the methods."
    : "The ratio may be less accurate than its interval indicates."}`;
}

// A configuration, with its verdict where it fails or is late.
const judged = (c) => `${marked(c)}${{ fail: ", which fails,", late: ", which is late," }[C().verdict[c]] ?? ""}`;

// The packed times, of which a ratio without an interval is, hold two digits: 1 is written as 1.0.
const twoDigits = (x) => (x >= 0.995 && x < 9.95 ? x.toFixed(1) : figure(x, 2));

async function drawTwo() {
  const others = all().filter((c) => c !== state.c && C().p50[c] !== null)
    .sort((a, b) => label(a).localeCompare(label(b)));
  // Unless one was asked for: the answer, beside the answer the next, or else another solver.
  const another = others.find((c) => C().solver[c] !== C().solver[state.c]) ?? others[0];
  const second = [state.b, facts.answer.first, facts.answer.second, another]
    .find((c) => others.includes(c));
  if (second === undefined) return;
  options("choose-other", others.map((c) => [c, label(c)]), second);
  const rows = comparedSteps(state.c, second), said = $("two-said");
  if (!rows.length) { said.textContent = "The two configurations have no replay in common."; $("two-figure").hidden = true; return; }
  $("two-figure").hidden = false;
  const over = ratioOf(state.c, second, rows), ratio = Math.max(over, 1 / over), reach = reachOf(state.c, second);
  const [slower, faster] = over >= 1 ? [second, state.c] : [state.c, second];
  const interval = reach !== null ? `The 95 % interval, for these measurements only, is ${significant(ratio / reach)} to ${significant(ratio * reach)}`
    : ratio === 1 ? "Both are one run, as the settings make no difference" : "There are too few steps for an interval";
  const text = rows[0].separate
    ? `${marked(state.c)} takes ${time(meanOf(rows, "a"))} per step and ${marked(second)} `
    + `${time(meanOf(rows, "b"))}, ${rows[0].separate}, so there is no ratio: geometric means over `
    + `${commonSteps(rows)}.`
    : `${judged(slower)} takes ${reach === null ? twoDigits(ratio) : significant(ratio)} times as long as ${judged(faster).replace(/,$/, "")}. `
    + `${interval}. ${reach === null ? "" : slowerIn(rows, ratio / reach, slower === second)}The ratio is the geometric mean over ${commonSteps(rows, reach !== null)}.`
    + `${reach === null ? "" : whyUnranked(rows, ratio / reach)}${shortTimes(state.c, second, rows)}`;
  said.replaceChildren(...coded(text));
  $("two-caption").replaceChildren(...coded(captionOf(rows, second)));
  const view = await figureOf("pairs");
  if (view) {
    view.signal("first", `${label(state.c)} [µs]`).signal("second", `${label(second)} [µs]`);
    await view.data("pairs", rows).runAsync();
  }
  $("two-markdown").textContent = `| | ${label(state.c)} | ${label(second)} |\n|---|---|---|\n`
    + [["p50", "p50"], ["limiting p99", "p99"]].map(([name, column]) => {
      const cells = [state.c, second].map((c) => `${time(C()[column][c])} in ${C()[`${column}_in`][c]}`);
      return `| ${name} | ${cells.join(" | ")} |`;
    }).join("\n")
    + `\n| longest step | ${time(C().max[state.c])} | ${time(C().max[second])} |`
    + `\n| largest error of the first move [maximum increments] | ${figure(C().error[state.c])} | ${figure(C().error[second])} |\n`
    + `| verdict | ${C().verdict[state.c]} | ${C().verdict[second]} |\n\n${text}\n`;
}

FIGURES.pairs = {
  canvas: true,
  sized: (spec, width) => {
    const square = Math.min(width, 460);
    return { ...named(spec), width: square, height: square, autosize: { ...FIT, type: "fit" } };
  },
};
SECTIONS.push({
  id: "two", after: ["c", "b"], draw: drawTwo,
  listen: () => on("choose-other", "change", (value) => select({ b: Number(value) })),
});
