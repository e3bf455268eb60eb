"""Say the verdict in plain sentences; every number in them comes from rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dpbench.report.demand import Demand
from dpbench.report.formats import (
    and_list,
    as_float,
    error_text,
    plural,
    significant,
    time_text,
)
from dpbench.report.ranking import fastest_first
from dpbench.report.verdict import Outcome, Verdict
from dpbench.report.view import View, has_steps, is_contrast

Verdicts = Mapping[str, Sequence[Verdict]]


def summary(verdicts: Verdicts) -> list[str]:
    """How many meet the demand, by settings level, and who."""
    if not any(verdicts.values()):
        return ["No solver was run, so there is nothing to judge."]
    first, *others = verdicts
    default = verdicts[first]
    run = [v for v in default if v.outcome != "not run"]
    good = fastest_first(_with(default, "meets"))
    names = f": {_names(good)}" if good else ""
    lines = [
        f"{len(good)} of {plural(len(run), 'solver')} that ran {_verb(good, 'meet')} the demand "
        f"with settings `{first}`{names}."
    ]
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
    return (
        f"{head}meets the demand: {_figures(verdict)}; a computer "
        f"{significant(verdict.slowdown(demand))} times slower would miss "
        f"{demand.deadline_ms / 1e3:g} s."
    )


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
    worst = {str(row["scenario"]): as_float(row["r_tail_max_m"]) for row in rows}
    shown = [f"{significant(r, 2)} m in `{name}`" for name, r in worst.items() if np.isfinite(r)]
    return (
        f"Contrast (never ranked): `{rows[0]['solver']}` clips the unconstrained optimum; its "
        f"largest radial error in the second half of the run is {and_list(shown)}."
    )
