"""Tables of solvers: verdicts, times, tiles of solver and place, accuracy against time, hard steps.

A configuration and a place are told by their numbers in `RunMatrix`, as text, where a table has
`id` and `place_id`; −1 is a configuration that was not run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from math import isnan, nan
from typing import Any

import pandas as pd

from dpbench.analysis.records.kept_runs import KeptRun
from dpbench.analysis.records.step_times import StepTimes
from dpbench.analysis.times.machine import calling_ns
from dpbench.analysis.times.pairs import log_reach, paired_comparison
from dpbench.analysis.times.work_precision import LevelPoint, level_points
from dpbench.analysis.verdict.fastest import best_of_each, family_of, fastest_first
from dpbench.analysis.verdict.run_matrix import RunMatrix
from dpbench.analysis.verdict.verdict import Verdict
from dpbench.bench.record.configuration import Configuration

LARGEST_ERROR = 1e3
"""Answers that are farther off are none, and have no point beside others."""


def way_of(configuration: Configuration) -> dict[str, str]:
    """What a configuration is told apart by where a solver stands in a column of its own."""
    names = ("solver", "route", "policy", "settings")
    return {name: getattr(configuration, name) for name in names}


def verdict_table(placed: RunMatrix) -> pd.DataFrame:
    """Every configuration held against the demand over all its runs; times in µs."""
    return pd.DataFrame(
        [
            {
                **way_of(v.configuration),
                "outcome": v.outcome,
                "closed_loops": v.loops,
                "replays": v.replays,
                "windows": v.windows,
                "steps": v.steps,
                "error_move": v.error_move,
                "failed_steps": v.failed_steps,
                "p50_us": v.p50_ns / 1e3,
                "replay_p99_us": v.replay_p99_ns / 1e3,
                "raw_p99_us": v.raw_p99_ns / 1e3,
                "p99_us": v.p99_ns / 1e3,
                "max_us": v.algo_max_ns / 1e3,
                "raw_max_us": v.raw_max_ns / 1e3,
                "timed_on": v.timed_on,
                "p99_on": v.p99_on,
                **_margin_columns(placed, v),
            }
            for v in placed.verdicts.all
        ]
    )


def _margin_columns(placed: RunMatrix, verdict: Verdict) -> dict[str, Any]:
    """Return the speed margin of a configuration, and the step that bounds each of its parts."""
    margin = placed.margin(verdict.configuration)
    if margin is None:
        return {"margin": nan}
    columns: dict[str, Any] = {"margin": margin.factor}
    parts = {"p99": (margin.p99_limit, margin.p99), "deadline": (margin.deadline, margin.hardest)}
    for name, (factor, step) in parts.items():
        columns[f"margin_{name}"] = factor
        columns[f"{name}_step"] = f"{step.run.scenario or step.run.sequence}, k {step.k}"
        columns[f"{name}_step_us"] = step.time_ns / 1e3
        columns[f"{name}_step_iterations"] = step.iterations
        columns[f"{name}_step_active"] = step.n_active
    return columns


TIMES = (
    *("id", "solver", "label", "state", "p50_ms", "p99_ms", "max_ms", "longest_ms"),
    *("replay_p99_ms", "raw_p99_ms", "margin", "share"),
)
"""`longest_ms`: largest single timing of everything that was judged, loops too. `margin`: speed
margin, see `speed_margin.py`. `share`: part of the median that calling the library costs, by the
calibration configuration that only copies; 0 where it was not run."""


def time_table(placed: RunMatrix) -> pd.DataFrame:
    """Columns `TIMES`: the best configuration of each solver that was timed, see `best_of_each`."""
    called_ns = calling_ns(placed.records)
    rows = [
        {
            "id": str(placed.index(verdict.configuration)),
            "solver": verdict.configuration.solver,
            "label": verdict.configuration.label,
            "state": verdict.state,
            "p50_ms": verdict.p50_ns / 1e6,
            "p99_ms": verdict.p99_ns / 1e6,
            "replay_p99_ms": verdict.replay_p99_ns / 1e6,
            "raw_p99_ms": verdict.raw_p99_ns / 1e6,
            "max_ms": verdict.algo_max_ns / 1e6,
            "longest_ms": _longest_ms(placed, verdict),
            "margin": nan if (m := placed.margin(verdict.configuration)) is None else m.factor,
            "share": 0.0 if isnan(called_ns) else min(1.0, called_ns / verdict.p50_ns),
        }
        for verdict in best_of_each(placed.verdicts)
        if verdict.timed_on
    ]
    return pd.DataFrame(rows, columns=list(TIMES))


def _longest_ms(placed: RunMatrix, verdict: Verdict) -> float:
    longest = placed.longest_timing(verdict.configuration)
    return nan if longest is None else longest[1].raw_max_ns / 1e6


def tile_table(placed: RunMatrix) -> pd.DataFrame:
    """Solver × place × settings, of each solver in the way of its best configuration, so that of
    the one to use these are its own places."""
    best = {v.configuration.solver: v.configuration for v in best_of_each(placed.verdicts)}
    ways = [best.get(reference.solver, reference) for reference in placed.references]
    return pd.DataFrame(
        [
            _tile(placed, replace(way, settings=level), p)
            for way in ways
            for level in placed.levels
            for p in placed.judged_experiments
        ]
    )


def _tile(placed: RunMatrix, wanted: Configuration, p: int) -> dict[str, Any]:
    c = placed.index(wanted)
    run, verdict = placed.runs.get((c, p)), placed.states.get((c, p))
    findings = () if verdict is None else (*verdict.causes, *verdict.doubts, *verdict.near)
    return {
        "solver": wanted.solver,
        "settings": wanted.settings,
        "way": f"{wanted.route} {wanted.policy}",
        "place": placed.experiments[p].label,
        "state": placed.state(c, p),
        "error": None if run is None else run.error_move_max,
        "failed": None if run is None else run.failed_steps,
        "id": str(c),
        "place_id": str(p),
        "detail": ", ".join(dict.fromkeys(f.kind for f in findings)),
    }


def level_table(placed: RunMatrix) -> pd.DataFrame:
    """Error and time at each settings level of each solver, in the way of its best configuration;
    no row for an answer beyond `LARGEST_ERROR`."""
    best = (v.configuration for v in best_of_each(placed.verdicts))
    ways = {c.solver: (c.route, c.policy) for c in best}
    levels = level_points(placed.records, placed.records.sequences, ways)
    states: dict[Configuration, str] = {v.configuration: v.state for v in placed.verdicts.all}
    rows = [
        _point(placed, point, states)
        for points in levels.values()
        for point in points
        if point.error_move < LARGEST_ERROR and not isnan(point.p50_ns)
    ]
    return pd.DataFrame(rows)


def _point(
    placed: RunMatrix, point: LevelPoint, states: Mapping[Configuration, str]
) -> dict[str, Any]:
    judged = point.configuration.in_common_formulation
    return way_of(point.configuration) | {
        "id": str(placed.index(judged)),
        "family": family_of(judged.solver),
        "error": point.error_move,
        "p50_us": point.p50_ns / 1e3,
        "p99_us": point.p99_ns / 1e3,
        "state": states.get(judged, "not judged"),
    }


def hard_step_table(placed: RunMatrix, kept: Mapping[str, KeptRun]) -> pd.DataFrame:
    """The hardest steps of every run outside studies by each measure; times in µs.

    Parameters
    ----------
    kept : what is kept of each run, by its id.
    """
    labels = {
        run.run_id: placed.configurations[c].label
        for (c, p), run in placed.runs.items()
        if not placed.experiments[p].study
    }
    rows = [
        {"run_id": run_id, "configuration": labels[run_id], "by": measure}
        | hard._asdict()
        | ({"value": hard.value / 1e3} if measure == "time" else {})
        for run_id, of_run in kept.items()
        if run_id in labels
        for measure, of_measure in of_run.hard.items()
        for hard in of_measure
    ]
    return pd.DataFrame(rows)


def ratio_table(placed: RunMatrix) -> pd.DataFrame:
    """How many times as long each solver's best configuration takes as the fastest of them, step
    by step, with the interval of the mean."""
    timed = fastest_first([v for v in best_of_each(placed.verdicts) if v.timed_on])
    pairs = [paired_comparison(placed.records, timed[0], verdict) for verdict in timed[1:]]
    return pd.DataFrame([pair.row for pair in pairs])


def pair_reaches(placed: RunMatrix) -> tuple[list[int], list[float]]:
    """The configurations that were timed, and of any two of them, (0, 1), (0, 2), ... (1, 2), ...,
    how far the 95 % interval of their paired ratio reaches, see `log_reach`."""
    timed: dict[int, dict[int, StepTimes]] = {}
    for (c, p), run in placed.runs.items():
        if (
            placed.experiments[p].mode == "replay"
            and (times := placed.records.times(run)) is not None
        ):
            timed.setdefault(c, {})[p] = times
    return list(timed), [log_reach(*two) for two in combinations(timed.values(), 2)]
