"""Say the verdict in plain sentences; every number in them comes from rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dpbench.report.demand import Demand
from dpbench.report.formats import (
    and_list,
    as_float,
    count_text,
    error_text,
    plural,
    rounded_down,
    significant,
    time_text,
)
from dpbench.report.ranking import fastest_first
from dpbench.report.verdict import NO_LOOP, NO_REPLAY, Outcome, Verdict
from dpbench.report.view import Row, View, has_steps, is_contrast

Verdicts = Mapping[str, Sequence[Verdict]]


def summary(verdicts: Verdicts) -> list[str]:
    """How many meet the demand, by settings level, and who."""
    if not any(verdicts.values()):
        return ["No solver was run, so there is nothing to judge."]
    first, *others = verdicts
    default = verdicts[first]
    run = [v for v in default if v.outcome != "not run"]
    good = fastest_first(_with(default, "meets"))
    lines = [_count_line(run, good, first)]
    rest = [v for v in run if v.outcome != "meets"]
    for level in others:
        won = _solvers(_with(verdicts[level], "meets"))
        lines += _gained(rest, won, first, level)
        rest = [v for v in rest if v.solver not in won]
        lost = [v for v in _with(verdicts[level], "misses") if v.solver in _solvers(good)]
        if lost:
            lines.append(f"With settings `{level}` no longer: {_names(lost)}.")
    missing, unsure = _with(rest, "misses"), _with(rest, "open")
    if missing:
        lines.append(f"{_names(missing)} {_verb(missing, 'miss')} it.")
    if unsure:
        lines.append(f"{_names(unsure)} cannot be judged on these records.")
    absent = _with(default, "not run")
    if absent:
        lines.append(f"Not run: {_names(absent)}.")
    return lines


def _count_line(run: Sequence[Verdict], good: Sequence[Verdict], level: str) -> str:
    """How many meet the demand; that this is open where nobody can be said to."""
    if not run:
        return f"No solver ran with settings `{level}`."
    if not good and all(NO_REPLAY in v.doubts for v in run):
        return "Nothing can be judged on time: no replay was run."
    unsure = _with(run, "open")
    if not good and unsure:
        why = f", as {NO_LOOP}" if all(NO_LOOP in v.doubts for v in unsure) else ""
        return (
            f"Whether a solver meets the demand with settings `{level}` is open: "
            f"{len(unsure)} of {plural(len(run), 'solver')} that ran cannot be judged{why}."
        )
    names = f": {_names(good)}" if good else ""
    return (
        f"{len(good)} of {plural(len(run), 'solver')} that ran {_verb(good, 'meet')} the demand "
        f"with settings `{level}`{names}."
    )


def _gained(rest: Sequence[Verdict], won: set[str], first: str, level: str) -> list[str]:
    """Who meets the demand at `level` but not, or not for certain, at the first one."""
    only = [v for v in _with(rest, "misses") if v.solver in won]
    also = [v for v in _with(rest, "open") if v.solver in won]
    lines = [f"Only with settings `{level}`: {_names(only)}."] if only else []
    if also:
        lines.append(f"With settings `{level}`, while `{first}` is open: {_names(also)}.")
    return lines


def _verb(subjects: Sequence[Verdict], verb: str) -> str:
    return verb if len(subjects) != 1 else f"{verb}es" if verb.endswith("ss") else f"{verb}s"


def _with(verdicts: Sequence[Verdict], outcome: Outcome) -> list[Verdict]:
    return [v for v in verdicts if v.outcome == outcome]


def _solvers(verdicts: Sequence[Verdict]) -> set[str]:
    return {v.solver for v in verdicts}


def _names(verdicts: Sequence[Verdict]) -> str:
    return and_list([v.solver for v in verdicts])


def sentence(verdict: Verdict, demand: Demand) -> str:
    """The verdict on one solver in one sentence."""
    head = f"**{verdict.solver}** "
    if verdict.outcome == "not run":
        return f"{head}was not run: {verdict.doubts[0]}."
    if verdict.outcome == "misses":
        return f"{head}misses the demand: {'; '.join(verdict.causes)}.{_also(verdict)}"
    if verdict.outcome == "open":
        return f"{head}cannot be judged: {'; '.join(verdict.doubts)}.{_so_far(verdict)}"
    return f"{head}meets the demand: {_figures(verdict)}; {slack_text(verdict, demand)}."


def slack_text(verdict: Verdict, demand: Demand) -> str:
    """How much slower a computer may be, as a clause."""
    deadline = f"{demand.deadline_ms / 1e3:g} s"
    if verdict.slowdown(demand) < 1.0:
        return f"its largest step, {time_text(verdict.algo_max_ns)}, misses the {deadline}"
    times = rounded_down(verdict.slowdown(demand))
    return f"a computer {times} times slower would still make the {deadline} deadline"


def _also(verdict: Verdict) -> str:
    return f" Besides, {'; '.join(verdict.doubts)}." if verdict.doubts else ""


def _so_far(verdict: Verdict) -> str:
    if not verdict.steps:
        return ""
    error = error_text(verdict.error_move)
    return (
        f" What it did do contradicts nothing ({plural(verdict.steps, 'judged step')}, "
        f"error_move at most {error})."
    )


def elsewhere(verdicts: Verdicts, verdict: Verdict) -> str:
    """What the other settings levels change about a verdict; empty when nothing."""
    text = ""
    for level in list(verdicts)[1:]:
        other = next((v for v in verdicts[level] if v.solver == verdict.solver), None)
        if other is None or other.outcome == "not run" or other.causes == verdict.causes:
            continue
        if other.outcome == "misses":
            text += f" With settings `{level}`: {'; '.join(other.causes)}."
        elif other.outcome == "open":
            text += f" With settings `{level}` it cannot be judged: {'; '.join(other.doubts)}."
        elif verdict.outcome != "meets":
            only = "only " if verdict.outcome == "misses" else ""
            text += f" It meets the demand {only}with settings `{level}`: {_figures(other)}."
    return text


def _figures(verdict: Verdict) -> str:
    """The figures behind a verdict that meets the demand."""
    p99 = (
        f"p99 {time_text(verdict.p99_ns)} on `{verdict.p99_of}`"
        if math.isfinite(verdict.p99_ns)
        else f"largest step {time_text(verdict.algo_max_ns)} (too few steps for a p99)"
    )
    return (
        f"error_move at most {error_text(verdict.error_move)} over "
        f"{plural(verdict.steps, 'judged step')}, {p99}"
    )


def contrast(view: View) -> str:
    """The contrast law in one sentence: it solves no QP and is never ranked."""
    rows = [r for r in view.select(mode="closed_loop") if is_contrast(r) and has_steps(r)]
    if not rows:
        return "Contrast: the clipped unconstrained law was not run."
    longest: dict[str, Row] = {}
    for row in sorted(rows, key=lambda row: as_float(row["steps_done"])):
        longest[str(row["scenario"])] = row
    names = [name for name in view.scenarios if name in longest]
    shown = [
        f"{significant(as_float(longest[name]['r_tail_max_m']), 2)} m in `{name}`"
        for name in names
        if view.is_whole(longest[name]) and np.isfinite(as_float(longest[name]["r_tail_max_m"]))
    ]
    short = [
        f"{count_text(longest[name]['steps_done'])} of {plural(view.whole_steps(name), 'step')} "
        f"in `{name}`"
        for name in names
        if not view.is_whole(longest[name])
    ]
    clauses = [f"`{rows[0]['solver']}` clips the unconstrained optimum"]
    if shown:
        clauses.append(
            f"its largest radial error in the second half of the run is {and_list(shown)}"
        )
    if short:
        clauses.append(f"its steady error is not measured where it ran {and_list(short)}")
    return f"Contrast (never ranked): {'; '.join(clauses)}."
