// The answer: its figure of times, and the computer that is slower.
"use strict";

// Names, of many only where the computer is slower.
const listed = (rows, say = (row) => `\`${row.solver}\``) => (rows.length && (rows.length <= 4 || state.slow > 1)
  ? `: ${rows.map(say).join(", ")}` : "");

// How much slower a computer may be for the chosen configuration, of which a cause of its verdict may
// make it late on this machine already.
function paceOf(c, margin) {
  const late = C().late[c], verdict = C().verdict[c];
  if (verdict === "fail") return "fails, so it has no speed margin";
  const limited = `× ${roundedDown(margin)}, set by its ${C().limited_by[c]}`;
  if (late) return `is late on this machine (${late})${margin < 1 ? `. Its speed margin is ${limited}` : ""}`;
  if (margin < 1) return `exceeds a limit on this machine (speed margin ${limited}; overall verdict: ${verdict})`;
  const other = ["pass", "not judged"].includes(verdict) ? "" : ` in the replays and windows that were run (overall verdict: ${verdict})`;
  return `${margin < state.slow ? "is late beyond a slowdown of" : "meets both limits up to a slowdown of"} ${limited}${other}`;
}

// A configuration's solver, with its settings unless they are the default.
const withSettings = (c) => `\`${C().solver[c]}\`${C().settings[c] === "default" ? "" : ` with settings \`${C().settings[c]}\``}`;

// The speed margin of the chosen configuration, and the solvers that stay within both limits on the
// slower computer: of those that pass here, or that nothing contradicts where none does.
function kept() {
  const { deadline_ms, p99_ms } = facts.requirements, margin = C().margin[state.c];
  if (deadline_ms === null) return "Lateness is not judged, as no deadline is known.";
  // The summary above states the margin of the recommended configuration.
  const own = margin === null || (state.c === facts.answer.first && state.slow <= 1) ? "" : `${withSettings(state.c)} ${paceOf(state.c, margin)}. `;
  const slowed = own && state.slow > 1 ? `At × ${figure(state.slow)}, this time is at ${figure((100 * state.slow) / margin, 2)} % of its limit. ` : "";
  const which = (...verdicts) => rowsDrawn("ladder").values.filter((row) => verdicts.includes(row.verdict));
  const passing = which("pass"), right = passing.length ? passing : which("borderline", "inconclusive");
  if (!right.length) return own + slowed;
  // A solver has further rows for custom settings.
  const solvers = right.sort((a, b) => b.margin - a.margin).filter((row, i) => right.findIndex((r) => r.solver === row.solver) === i);
  const safe = solvers.filter((row) => state.slow <= 1 || row.margin >= state.slow);
  const every = { 1: "the one", 2: "both" }[solvers.length] ?? `all ${solvers.length}`;
  const count = safe.length < solvers.length ? `${safe.length} of the ${solvers.length}` : every;
  return `${own}${slowed}At a slowdown of × ${figure(state.slow)}, ${count} ${passing.length ? "passing" : "borderline or inconclusive"
  } solver${solvers.length > 1 ? "s" : ""} ${state.slow > 1 ? "still " : ""}${safe.length === 1 ? "meets" : "meet"} both limits (p99 of ${p99_ms} ms, longest step of ${deadline_ms} ms)${
    listed(safe, (row) => `${withSettings(Number(row.id))} (up to × ${roundedDown(row.margin)})`)}.`;
}

// Where the slider stops: 1, 2 and 5 of each decade.
const notch = (i) => [1, 2, 5][i % 3] * 10 ** Math.floor(i / 3);

async function drawSlow() {
  $("slow-said").value = plain(state.slow);
  $("slow").value = String(Math.round(3 * Math.log10(state.slow)));
  $("slow").setAttribute("aria-valuetext", `× ${figure(state.slow)}`);
  $("slow-kept").replaceChildren(...coded(kept()));
  await signal("ladder", { slow: state.slow });
}

FIGURES.ladder = {
  // On paper the ladder shares its sheet: names above its bars would take the matrix's place.
  sized: (spec, width) => fitted(spec, width, width < NARROW && innerWidth < NARROW),
  // A name at the axis stands for its row.
  picked: (datum) => datum && pickedRow(datum.id !== undefined ? datum
    : rowsDrawn("ladder").values.find((row) => row.label === datum.value) ?? datum),
  grid: () => rowsDrawn("ladder").values.map((row, y) => ({ c: Number(row.id), x: 0, y })),
};
SECTIONS.push({
  id: "figure-ladder", after: ["c", "p"],
  draw: () => mark("ladder", { id: String(state.c) }),
  listen: () => steerable("ladder", "row"),
}, {
  id: "slow", after: ["slow", "c"], draw: drawSlow,
  listen: () => {
    on("slow", "input", (value) => select({ slow: notch(Number(value)) }));
    on("slow-said", "input", (value) => value && select({ slow: atMost(value) }));
  },
});
