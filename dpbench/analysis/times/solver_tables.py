"""Tables of solvers: verdicts, times, solver by experiment, accuracy against time, hard steps.

A configuration and an experiment are numbered as in `RunMatrix`, as text, where a table has
`id` and `experiment_id`; −1 is a configuration that was not run.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from math import isfinite, isnan, nan
from typing import Any

import numpy as np
import pandas as pd

from dpbench.analysis.records.machine import compute_round_spread, find_library_call_ns
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key, map_first_by_key
from dpbench.analysis.records.thinned_runs import HardRow, ThinnedRun
from dpbench.analysis.times.paired_times import (
    RATIO_COLUMNS,
    PairedComparison,
    TimedReplay,
    compare_paired_times,
    compare_settings_of_solvers,
    compute_log_ratio_with_half_width,
)
from dpbench.analysis.verdict.requirements import Cause
from dpbench.analysis.verdict.run_matrix import RunMatrix
from dpbench.analysis.verdict.verdict import (
    MOST_OWN,
    Verdict,
    Verdicts,
    find_solver_family,
    list_best_verdict_of_each_solver,
    list_best_verdict_of_own_settings,
    list_main_verdicts,
    make_sort_key_of_settings,
    sort_best_first,
    sort_fastest_first,
)
from dpbench.bench.judge.rules import has_enough_samples_for_percentile, percentile_or_nan
from dpbench.bench.record.cell import Configuration, sort_key_of_settings
from dpbench.solvers.own_settings import decode_options_from_json, format_options_as_toml

LARGEST_ERROR = 1e3
"""Answers that are farther off are none, and have no point beside others."""


def make_configuration_columns(configuration: Configuration) -> dict[str, str]:
    """Return a configuration's solver, interface, warm start, settings and options by column."""
    names = ("solver", "route", "policy", "settings")
    options = format_options_as_toml(decode_options_from_json(configuration.options))
    return {name: getattr(configuration, name) for name in names} | {"options": options}


VERDICT_COLUMNS = (
    *("solver", "route", "policy", "settings", "options", "verdict", "closed_loops", "replays"),
    *("windows", "steps", "error_move", "failed_steps", "first_failed_step"),
    *("first_inaccurate_step", "p50_us", "replay_p99_us", "raw_p99_us", "limiting_p99_us"),
    *("p99_low_us", "p99_high_us", "max_us", "raw_max_us", "timed_on", "p99_on", "margin"),
    *("margin_p99", "p99_step", "p99_step_us", "p99_step_iterations", "p99_step_active"),
    *("margin_deadline", "deadline_step", "deadline_step_us", "deadline_step_iterations"),
    "deadline_step_active",
)


def tabulate_verdicts(matrix: RunMatrix) -> pd.DataFrame:
    """Return a table of the verdict, errors and step times [µs] of every configuration."""
    return pd.DataFrame(
        [
            {
                **make_configuration_columns(v.configuration),
                "verdict": v.state,
                "closed_loops": v.loops,
                "replays": v.replays,
                "windows": v.windows,
                "steps": v.steps,
                "error_move": v.error_move,
                "failed_steps": v.failed_steps,
                "first_failed_step": _name_first_step(v, "failed"),
                "first_inaccurate_step": _name_first_step(v, "inaccurate"),
                "p50_us": v.p50_ns / 1e3,
                "replay_p99_us": v.replay_p99_ns / 1e3,
                "raw_p99_us": v.raw_p99_ns / 1e3,
                "limiting_p99_us": v.p99_ns / 1e3,
                "p99_low_us": v.p99_interval.low / 1e3,
                "p99_high_us": v.p99_interval.high / 1e3,
                "max_us": v.longest_ns / 1e3,
                "raw_max_us": v.raw_max_ns / 1e3,
                "timed_on": v.timed_on,
                "p99_on": v.sequence_of_limiting_p99,
                **_make_margin_columns(matrix, v),
            }
            for v in matrix.verdicts.all_verdicts
        ],
        columns=list(VERDICT_COLUMNS),
    )


def _name_first_step(verdict: Verdict, kind: Cause) -> str:
    """Return scenario and step of the worst run's first failed or inaccurate step; "" if none."""
    known = (f for f in verdict.causes if f.kind == kind and f.first >= 0)
    steps = ((f.runs[0], f.runs[0].first_step + f.first) for f in known)
    return next((f"{run.scenario or run.sequence}, k {k}" for run, k in steps), "")


def _make_margin_columns(matrix: RunMatrix, verdict: Verdict) -> dict[str, Any]:
    """Return how much slower a computer may be for a configuration, and the limiting steps."""
    margin = matrix.get_speed_margin(verdict.configuration)
    if margin is None:
        return {"margin": nan}
    columns: dict[str, Any] = {"margin": margin.allowed_slowness_factor}
    parts = {"p99": (margin.p99_limit, margin.p99), "deadline": (margin.deadline, margin.hardest)}
    for name, (factor, step) in parts.items():
        columns[f"margin_{name}"] = factor
        columns[f"{name}_step"] = f"{step.run.scenario or step.run.sequence}, k {step.k}"
        columns[f"{name}_step_us"] = step.time_ns / 1e3
        columns[f"{name}_step_iterations"] = step.iterations
        columns[f"{name}_step_active"] = step.n_active
    return columns


TIMES = (
    *("id", "solver", "label", "verdict", "p50_ms", "limiting_p99_ms", "max_ms"),
    *("longest_ms", "replay_p99_ms", "raw_p99_ms", "margin", "share"),
    *("error_move", "failed_steps"),
)
"""`longest_ms`: largest single timing of everything that was judged, loops too. `margin`: speed
margin, see `time_findings.py`. `share`: part of the median that calling the library costs, by the
calibration configuration that only copies; 0 where it was not run."""


def tabulate_best_times(matrix: RunMatrix) -> pd.DataFrame:
    """Return a table of step times [ms] of each solver's best configuration and own settings."""
    called_ns = find_library_call_ns(matrix.records)
    rows = [
        {
            "id": str(matrix.find_index(verdict.configuration)),
            "solver": verdict.configuration.solver,
            "label": verdict.configuration.label,
            "verdict": verdict.state,
            "p50_ms": verdict.p50_ns / 1e6,
            "limiting_p99_ms": verdict.p99_ns / 1e6,
            "replay_p99_ms": verdict.replay_p99_ns / 1e6,
            "raw_p99_ms": verdict.raw_p99_ns / 1e6,
            "max_ms": verdict.longest_ns / 1e6,
            "longest_ms": nan
            if (longest := matrix.find_longest_timing(verdict.configuration)) is None
            else longest.raw_max_ns / 1e6,
            "margin": nan
            if (margin := matrix.get_speed_margin(verdict.configuration)) is None
            else margin.allowed_slowness_factor,
            "share": 0.0 if isnan(called_ns) else min(1.0, called_ns / verdict.p50_ns),
            "error_move": verdict.error_move,
            "failed_steps": verdict.failed_steps,
        }
        for verdict in list_main_verdicts(matrix.verdicts)
        if verdict.timed_on
    ]
    return pd.DataFrame(rows, columns=list(TIMES))


EXPERIMENT_COLUMNS = (
    *("solver", "settings", "call_mode", "experiment", "verdict", "error", "failed"),
    *("id", "experiment_id", "detail"),
)


def tabulate_experiment_verdicts(matrix: RunMatrix) -> pd.DataFrame:
    """Return a table of the verdict on each solver by scenario or replay, and settings.

    In the call mode of its best configuration, or of its best one with these custom settings; where
    it did not run so, in that of the best verdict.
    """
    best = {
        v.configuration.solver: v.configuration
        for v in list_best_verdict_of_each_solver(matrix.verdicts)
    }
    own = {
        (v.configuration.solver, v.configuration.settings): v.configuration
        for v in list_best_verdict_of_own_settings(matrix.verdicts)
    }
    rows = []
    for reference in matrix.reference_configurations:
        usual = best.get(reference.solver, reference)
        for level in matrix.settings_levels:
            known = _order_call_modes(matrix, own.get((usual.solver, level), usual), level)
            rows += [
                _make_experiment_row(matrix, known, p) for p in matrix.judged_experiment_indices
            ]
    return pd.DataFrame(rows, columns=list(EXPERIMENT_COLUMNS))


def _order_call_modes(matrix: RunMatrix, usual: Configuration, level: str) -> list[Configuration]:
    """Return a solver's configurations of one settings level, those in the usual call mode first.

    The others follow, sorted by `sort_best_first`. Only the usual one if none was run.
    """
    ran = [c for c in matrix.configurations if (c.solver, c.settings) == (usual.solver, level)]
    judged = sort_best_first(matrix.verdicts.of.get(usual.solver, ()))
    order = {verdict.configuration: i for i, verdict in enumerate(judged)}
    mode = usual.route, usual.policy
    ran.sort(key=lambda c: ((c.route, c.policy) != mode, order.get(c, len(order))))
    return ran or [replace(usual, settings=level, options="")]


def _make_experiment_row(
    matrix: RunMatrix, known: Sequence[Configuration], p: int
) -> dict[str, Any]:
    """Return a table row of the first of some configurations with a verdict in an experiment."""
    judged = (
        c for c in known if matrix.get_state_in_experiment(matrix.find_index(c), p) != "not run"
    )
    wanted = next(judged, known[0])
    c = matrix.find_index(wanted)
    run, verdict = matrix.runs.get((c, p)), matrix.states.get((c, p))
    findings = () if verdict is None else verdict.causes or (*verdict.doubts, *verdict.near)
    return {
        "solver": wanted.solver,
        "settings": wanted.settings,
        "call_mode": f"{wanted.route} {wanted.policy}",
        "experiment": matrix.experiments[p].label,
        "verdict": matrix.get_state_in_experiment(c, p),
        "error": None if run is None else run.error_move_max,
        "failed": None if run is None else run.failed_steps,
        "id": str(c),
        "experiment_id": str(p),
        "detail": ", ".join(dict.fromkeys(f.kind for f in findings)),
    }


def tabulate_tolerance_levels(matrix: RunMatrix) -> pd.DataFrame:
    """Return a table of each solver's largest error and step time at its tolerance settings.

    In the call mode of its best configuration; no row for an answer beyond `LARGEST_ERROR`.
    """
    best = (v.configuration for v in list_best_verdict_of_each_solver(matrix.verdicts))
    modes = {c.solver: (c.route, c.policy) for c in best}
    levels = build_level_points(matrix.records, matrix.records.sequences, modes)
    states: dict[Configuration, str] = {
        v.configuration: v.state for v in matrix.verdicts.all_verdicts
    }
    rows = []
    for point in chain.from_iterable(levels.values()):
        if not point.error_move < LARGEST_ERROR or isnan(point.p50_ns):
            continue
        judged = point.configuration.moved_to_common_formulation
        columns = {
            "id": str(matrix.find_index(judged)),
            "family": find_solver_family(judged.solver),
            "error": point.error_move,
            "p50_us": point.p50_ns / 1e3,
            "p99_us": point.p99_ns / 1e3,
            "timed_on": "; ".join(point.timed_on),
            "verdict": states.get(judged, "not judged"),
        }
        rows.append(make_configuration_columns(point.configuration) | columns)
    return pd.DataFrame(rows)


def tabulate_hard_steps(matrix: RunMatrix, kept: Mapping[str, ThinnedRun]) -> pd.DataFrame:
    """Return a table of the steps of every run that are largest in time, iterations and error.

    kept : by run id.
    """
    labels = {
        run.run_id: {"configuration": matrix.configurations[c].label, "experiment": where.label}
        for (c, p), run in matrix.runs.items()
        if not (where := matrix.experiments[p]).study
    }
    rows = [
        {"run_id": run_id, **labels[run_id], "by": measure}
        | hard._asdict()
        | ({"value": hard.value / 1e3} if measure == "time" else {})
        for run_id, of_run in kept.items()
        if run_id in labels
        for measure, of_measure in of_run.hard.items()
        for hard in of_measure
    ]
    heads = ["run_id", "configuration", "experiment", "by", *HardRow._fields]
    return pd.DataFrame(rows, columns=heads)


def _list_timed_best_fastest_first(verdicts: Verdicts) -> list[Verdict]:
    """Return the best verdict of each solver that was timed, the fastest first."""
    best = list_best_verdict_of_each_solver(verdicts)
    return sort_fastest_first([verdict for verdict in best if verdict.timed_on])


def compare_own_settings_with_fastest(
    records: Records, verdicts: Verdicts
) -> list[PairedComparison]:
    """Return step time ratios of other solvers' custom settings to the fastest solver.

    The best settings of each solver come first; `MOST_OWN` settings at most are compared.
    """
    own = [v for v in list_best_verdict_of_own_settings(verdicts) if v.timed_on]
    own.sort(key=make_sort_key_of_settings)
    best = map_first_by_key(own, lambda v: v.configuration.solver).values()
    ordered = [*best, *(verdict for verdict in own if verdict not in best)][:MOST_OWN]
    fastest = next(iter(_list_timed_best_fastest_first(verdicts)), None)
    return [
        one
        for verdict in ordered
        if fastest is not None and verdict.configuration.solver != fastest.configuration.solver
        for one in compare_paired_times(records, fastest, verdict)
    ]


def tabulate_time_ratios(matrix: RunMatrix) -> pd.DataFrame:
    """Return a table of step time ratios, one row for each two configurations and size of QP.

    Each solver's best configuration and custom settings over the fastest's, then each solver's
    settings over the first.
    """
    records, verdicts = matrix.records, matrix.verdicts
    timed = _list_timed_best_fastest_first(verdicts)
    pairs = [one for v in timed[1:] for one in compare_paired_times(records, timed[0], v)]
    pairs += compare_own_settings_with_fastest(records, verdicts)
    pairs += compare_settings_of_solvers(records)
    rows = map_first_by_key(pairs, lambda one: (one.first, one.second, one.variables)).values()
    return pd.DataFrame([one.table_row for one in rows], columns=list(RATIO_COLUMNS))


@dataclass(frozen=True, eq=False)
class PairRatios:
    """Log time ratio of each two timed configurations, and its half-width.

    timed : indices of the configurations; logs, widths : of the pairs in the order (0, 1), (0, 2),
        ... (1, 2), ...; sizes : variables of the QPs of each replay, 0 if unknown.
    turns : by replay, for each configuration the numbers of the replays that it was timed with by
        turns, which alone make a ratio, and of their command.
    spreads : by replay and configuration `compute_round_spread` of those that other load disturbed;
        None for one round.
    """

    timed: list[int]
    logs: list[float]
    widths: list[float]
    sizes: dict[int, float]
    turns: dict[int, dict[int, tuple[int, int]]]
    spreads: dict[int, dict[int, float | None]]


def compute_ratios_of_pairs(matrix: RunMatrix) -> PairRatios:
    """Return the log time ratio of each two timed configurations, and its half-width."""
    timed: dict[int, dict[int, TimedReplay]] = {}
    sizes: dict[int, float] = {}
    for (c, p), run in matrix.runs.items():
        times = (
            matrix.records.get_step_times(run) if matrix.experiments[p].mode == "replay" else None
        )
        if times is not None:
            timed.setdefault(c, {})[p] = run, times
            # A run that crashed has no size.
            sizes[p] = max(sizes.get(p, 0.0), 0.0 if isnan(run.n) else run.n)
    pairs = combinations(timed.values(), 2)
    ratios = [compute_log_ratio_with_half_width(*two, sizes) for two in pairs]
    logs, widths = [log for log, _ in ratios], [width for _, width in ratios]
    turns: dict[int, dict[int, tuple[int, int]]] = {p: {} for p in sizes}
    spreads: dict[int, dict[int, float | None]] = {}
    numbers: dict[str, int] = {}
    for c, replays in timed.items():
        for p, (run, times) in replays.items():
            group, command = (
                numbers.setdefault(key, len(numbers)) for key in (run.turns, run.campaign_utc)
            )
            turns[p][c] = group, command
            if (spread := compute_round_spread(matrix.records, run, times)) != 1.0:
                spreads.setdefault(p, {})[c] = spread if isfinite(spread) else None
    return PairRatios(list(timed), logs, widths, sizes, turns, spreads)


@dataclass(frozen=True)
class LevelPoint:
    """Step times and error of a solver at one tolerance setting, over all QP sequences.

    p50_ns, p99_ns : algorithmic step time, each the worst over the sequences that support a p99;
        where none does, p50 over all and p99 NaN. timed_on : the sequences of p50_ns.
    error_move : the largest error of the first move, NaN where no optimum is certified.
    """

    configuration: Configuration
    p50_ns: float
    p99_ns: float
    error_move: float
    failed: int
    timed_on: tuple[str, ...]


def build_level_points(
    records: Records, sequences: Sequence[str], modes: Mapping[str, tuple[str, str]]
) -> dict[str, list[LevelPoint]]:
    """Return, by solver, step times and error at each of its tolerance settings.

    sequences : all of which a configuration was replayed on, whole, or it has no point.
    modes : route and policy by solver; one that is not in it has no points.
    """
    replays = records.select_runs(mode="replay", units="scaled", sequence=tuple(sequences))
    wanted = [run for run in replays if (run.route, run.policy) == modes.get(run.solver)]
    configurations = group_by_key(wanted, lambda run: run.configuration.moved_to_common_formulation)
    points = [
        point
        for configuration, runs in configurations.items()
        if len({run.sequence for run in runs}) == len(sequences)
        and (point := _build_level_point(records, configuration, runs)) is not None
    ]
    points.sort(key=lambda point: sort_key_of_settings(point.configuration.settings))
    return group_by_key(points, lambda point: point.configuration.solver)


def _build_level_point(
    records: Records, configuration: Configuration, runs: Sequence[RunRecord]
) -> LevelPoint | None:
    """Return one configuration's worst step times and error over QP sequences; or None."""
    timed = {
        run.sequence: times.algo_ns
        for run in runs
        if run.has_all_steps and (times := records.get_step_times(run)) is not None
    }
    if len(timed) < len(runs):
        return None
    whole = {
        sequence: algo
        for sequence, algo in timed.items()
        if has_enough_samples_for_percentile(len(algo), 99)
    }
    return LevelPoint(
        configuration,
        p50_ns=max(float(np.median(algo)) for algo in (whole or timed).values()),
        p99_ns=max((percentile_or_nan(algo, 99) for algo in whole.values()), default=math.nan),
        error_move=float(np.fmax.reduce([run.error_move_max for run in runs])),
        failed=int(np.nansum([run.failed_steps for run in runs])),
        timed_on=tuple(whole or timed),
    )
