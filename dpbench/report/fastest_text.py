"""Say in plain sentences who is fastest, and whether the second can be told apart."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.report.demand import Demand
from dpbench.report.fastest import Candidate, fastest_of
from dpbench.report.formats import (
    and_list,
    interval_text,
    plural,
    rounded_down,
    significant,
    time_text,
)
from dpbench.report.ranking import Contender, Duel, duel, fastest_first
from dpbench.report.verdict import Verdict
from dpbench.report.verdict_text import slack_text
from dpbench.report.view import View, has_steps


def fastest_usual(view: View, verdicts: Sequence[Verdict], demand: Demand) -> list[str]:
    """The fastest solver on its default route, policy fresh, its margin, and the second."""
    good = fastest_first([v for v in verdicts if v.outcome == "meets"])
    if not good:
        return [_nobody(verdicts)]
    best = good[0]
    if not math.isfinite(best.p99_ns):
        figure, of = best.algo_max_ns, "largest algorithmic step time"
    else:
        figure, of = best.p99_ns, f"p99 of the algorithmic step time on `{best.p99_of}`"
    lines = [
        f"The fastest by {yardstick(best)} that meets it on its default route, policy fresh, "
        f"is **{best.solver}** "
        f"(route {best.route}): {of} "
        f"{time_text(figure)}, {rounded_down(demand.p99_ns / figure)} times under the demand; "
        f"largest step {time_text(best.algo_max_ns)}; {slack_text(best, demand)}."
    ]
    if len(good) > 1:
        lines.append(duel_text(duel(view, best, good[1])))
        if good[1].route != best.route:
            lines.append(
                f"The two run on different routes ({best.solver}: {best.route}, "
                f"{good[1].solver}: {good[1].route}); the cost of the wrapper is part of the "
                "qpsolvers times."
            )
    return lines


def yardstick(arm: Contender) -> str:
    """What an arm is ranked by: its p99, or its largest step where there is no p99."""
    return "p99" if math.isfinite(arm.p99_ns) else "largest step"


def _nobody(verdicts: Sequence[Verdict]) -> str:
    """Why no fastest solver is named."""
    outcomes = {verdict.outcome for verdict in verdicts}
    if "open" in outcomes:
        return "No fastest solver is named while it is open whether one meets the demand."
    if "misses" in outcomes:
        return "No solver meets the demand, so no fastest one is named."
    return "No solver ran, so no fastest one is named."


def fastest_arm(view: View, found: Sequence[Candidate]) -> list[str]:
    """The fastest way of all to run a solver, and the fastest way of another solver beside it."""
    if not any(has_steps(row) for row in view.select(mode="replay", units="scaled")):
        return ["No way to run a solver is timed, as no replay left a step."]
    if not found:
        return ["No replayed arm gives answers that meet the demand on every step."]
    best, *others = first_ways(found)
    loops = (
        f" and in {plural(best.loops, 'closed loop')}"
        if best.loops
        else "; no closed loop was run this way"
    )
    lines = [
        f"Fastest by {yardstick(best)} of all ways to run a solver: **{best.solver}**, "
        f"route {best.route}, policy {best.policy}, settings `{best.settings}`, "
        f"with {figures(best)}. Its answers meet the demand on all "
        f"{plural(best.steps, 'replayed step')}{loops}."
    ]
    if others:
        lines.append(duel_text(duel(view, best, others[0])))
    return lines


def first_ways(found: Sequence[Candidate]) -> list[Candidate]:
    """The fastest way of each solver, the fastest solver first."""
    ways = [fastest_of(found, solver) for solver in dict.fromkeys(c.solver for c in found)]
    return [way for way in ways if way is not None]


def figures(candidate: Candidate) -> str:
    """p50, p99 and largest step of a way to run a solver."""
    p99 = (
        f"p99 {time_text(candidate.p99_ns)}"
        if math.isfinite(candidate.p99_ns)
        else "too few steps for a p99"
    )
    return (
        f"p50 {time_text(candidate.p50_ns)} and {p99} on `{candidate.where}`, largest step "
        f"{time_text(candidate.algo_max_ns)}"
    )


def fastest_way(found: Sequence[Candidate], solver: str) -> str:
    """The fastest way to run one solver, as a sentence to follow its verdict; empty if none."""
    best = fastest_of(found, solver)
    if best is None:
        return ""
    return (
        f" Fastest way to run it by {yardstick(best)}: route {best.route}, policy {best.policy}, "
        f"settings `{best.settings}`, {figures(best)} (judged on {best.judged_on})."
    )


def duel_text(found: Duel) -> str:
    """How the top two compare, with caution where they cannot be told apart."""
    if found.steps == 0:
        return f"{found.second} is second; no step was replayed by both, so they are not compared."
    ratio = significant(found.ratio.value)
    bounded = math.isfinite(found.ratio.high)
    span = interval_text(found.ratio.low, found.ratio.high)
    known = f"95 % interval {span}" if bounded else "too few for an interval"
    pair = (
        f"{found.second} takes {ratio} times as long as {found.first} per step "
        f"(geometric mean of the paired ratios of {plural(found.steps, 'step')}, each sequence of "
        "equal weight, "
        f"{known})"
    )
    if found.tied:
        why = "the interval holds 1, so" if bounded else "without one"
        return f"Caution: {pair}; {why} the two cannot be told apart."
    if found.unstable:
        by = {name: f"{found.leaders[name]} by {name}" for name in found.leaders}
        return (
            f"Caution: {pair}; the order depends on the yardstick: {and_list(list(by.values()))}."
        )
    return f"Second: {pair}."
