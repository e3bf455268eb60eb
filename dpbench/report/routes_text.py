"""Say what stands out on the way from the wrapper to a warm start, with what the rows show."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.analysis.step_times import StepTimes
from dpbench.analysis.times.routes import (
    KEPT,
    NATIVE,
    SLOWER_SHARE,
    WARM,
    WRAPPED,
    WRAPPED_WARM,
    Comparison,
    RouteComparison,
    RoutePolicy,
    route_policy_text,
)
from dpbench.errors import UnknownNameError
from dpbench.report.formats import (
    and_list,
    count_text,
    interval_text,
    plural,
    share_text,
    significant,
    time_text,
)
from dpbench.solvers.table import record

FEW_SLOWER = 0.05
"""Up to this share of slower steps goes without a sentence; the table counts them all."""
NAMED_STEPS = 8
KEEPING = {"reuse": "a kept workspace", "warm": "a warm start"}


def remarks(ways: RouteComparison, comparisons: int) -> list[str]:
    """Plain clauses about one solver at one settings level; none when nothing stands out.

    comparisons : how many intervals are to hold together.
    """
    clauses = _breaks(ways)
    for way in (WRAPPED_WARM, KEPT, WARM):
        clauses += _costs(ways, way, comparisons)
    wrapper = ways.compare(NATIVE, ways.neighbour(NATIVE), comparisons)
    if wrapper is not None and wrapper.gain.high < 1.0:
        clauses.append(_slower_than_wrapped(ways, NATIVE, wrapper))
    return clauses + _kept_beside_wrapped(ways, comparisons)


def beside_wrapped(sequence: str, ways: Sequence[RouteComparison]) -> str:
    """How many solvers are faster kept natively than through qpsolvers; empty without any."""
    ratios = {
        w.solver: found.gain.value
        for w in ways
        if w.best_kept and (found := w.compare(w.best_kept, WRAPPED)) is not None
    }
    if not ratios:
        return ""
    faster = {solver: ratio for solver, ratio in ratios.items() if ratio >= 1.0}
    least, most = min(ratios, key=ratios.__getitem__), max(ratios, key=ratios.__getitem__)
    return (
        f"In the replay of `{sequence}`, of {plural(len(ratios), 'solver')} on both routes "
        f"{len(faster)} {'is' if len(faster) == 1 else 'are'} at least as fast with a kept native "
        f"workspace as through qpsolvers fresh: from × {significant(ratios[least])} ({least}) to "
        f"× {significant(ratios[most])} ({most})."
    )


def _breaks(ways: RouteComparison) -> list[str]:
    """Answers that a kept workspace or a warm start breaks."""
    clauses = []
    for way in (WRAPPED_WARM, KEPT, WARM):
        found = ways.compare(way, ways.neighbour(way))
        if found is not None and found.wrong:
            named = ", ".join(str(k) for k in found.wrong[:NAMED_STEPS])
            more = ", …" if len(found.wrong) > NAMED_STEPS else ""
            be = "is" if len(found.wrong) == 1 else "are"
            clauses.append(
                f"{route_policy_text(way)} breaks answers: {len(found.wrong)} of "
                f"{plural(found.steps, 'step')} {be} not true on which "
                f"{route_policy_text(found.above)} is "
                f"right (k = {named}{more}){_kept_state(ways, way)}"
            )
    return clauses


def _kept_state(ways: RouteComparison, way: RoutePolicy) -> str:
    """Why a kept workspace answers otherwise than a new one, where the table of solvers knows."""
    try:
        keeps = record(ways.solver).on("native").keeps if way == KEPT else ""
    except (UnknownNameError, KeyError):  # a plug-in that is not here any more
        return ""
    if not keeps:
        return ""
    return f": it keeps {keeps}, so at a loose tolerance it stops elsewhere than a new one"


def _costs(ways: RouteComparison, way: RoutePolicy, comparisons: int) -> list[str]:
    """A clause when a kept workspace or a warm start costs time, or does so on many steps."""
    found = ways.compare(way, ways.neighbour(way), comparisons)
    if found is None:
        return []
    beside, name = route_policy_text(found.above), route_policy_text(way)
    more = iterations_text(ways.times[way], ways.times[found.above])
    count = plural(found.steps, "step")
    if found.gain.high < 1.0 and found.gain.value < 1.0 / (1.0 + SLOWER_SHARE):
        return [
            f"{KEEPING[way[1]]} costs time: {name} takes {_times(found)} as long as {beside} "
            f"({count_text(found.slower)} of {count} slower{more})"
        ]
    if found.slower > FEW_SLOWER * found.steps and found.gain.high >= 1.0:
        usual = "though it gains on the whole" if found.gain.low > 1.0 else "and gains nothing"
        share = share_text(found.slower / found.steps)
        return [
            f"{name} makes {share} of {count} slower than {beside}, by up to "
            f"{time_text(found.slower_ns)}, {usual} (× {significant(found.gain.value)}{more})"
        ]
    return []


def iterations_text(mine: StepTimes, theirs: StepTimes) -> str:
    """The mean iterations of two configurations where they differ; empty where they do not."""
    a, b = mine.iterations[1], theirs.iterations[1]
    if not (math.isfinite(a) and math.isfinite(b)) or significant(a) == significant(b):
        return ""
    return f"; {significant(a)} iterations on average against {significant(b)}"


def _times(found: Comparison) -> str:
    """`1.3 times [1.2, 1.4]`: how many times as long as its neighbour."""
    gain = found.gain
    return f"{significant(1 / gain.value)} times {interval_text(1 / gain.high, 1 / gain.low)}"


def _kept_beside_wrapped(ways: RouteComparison, comparisons: int) -> list[str]:
    """A clause when neither reuse nor warm is as fast as the solver's own qpsolvers fresh."""
    best = ways.best_kept
    found = ways.compare(best, WRAPPED, comparisons) if best else None
    if best is None or found is None or found.gain.value >= 1.0:
        return []
    if found.gain.high >= 1.0:
        return [
            f"{route_policy_text(best)} cannot be told apart from its own qpsolvers fresh "
            f"(× {significant(1 / found.gain.value)})"
        ]
    return [_slower_than_wrapped(ways, best, found)]


def _slower_than_wrapped(ways: RouteComparison, way: RoutePolicy, found: Comparison) -> str:
    return (
        f"{route_policy_text(way)} takes {_times(found)} as long as its own qpsolvers fresh; "
        "the rows show "
        f"{and_list(evidence(ways, way))}"
    )


def evidence(ways: RouteComparison, way: RoutePolicy) -> list[str]:
    """What the rows show about the time of a native way beside qpsolvers fresh."""
    mine, theirs = ways.times[way], ways.times[WRAPPED]
    shown = []
    setup = mine.phase_ns["setup"]
    if setup == setup:
        shown.append(f"{time_text(setup)} of set-up inside each step")
    more = iterations_text(mine, theirs)
    if more:
        shown.append(more.removeprefix("; "))
    forms = ways.runs[way].form, ways.runs[WRAPPED].form
    if forms[0] != forms[1]:
        shown.append(f"{forms[0]} matrices against {forms[1]}")
    phases = {name: ns for name, ns in mine.phase_ns.items() if name != "setup" and ns == ns}
    shown += [f"{name} {time_text(ns)}" for name, ns in phases.items()]
    return [*shown, f"against a solve of {time_text(theirs.phase_ns['solve'])} through qpsolvers"]


def remark_lines(ways: Sequence[RouteComparison]) -> list[tuple[str, str, str]]:
    """Solver, settings and sentence for all in which something stands out."""
    lines = []
    for w in ways:
        clauses = remarks(w, len(ways))
        if clauses:
            lines.append((w.solver, w.settings, f"{'; '.join(clauses)}."))
    return lines
