"""Cost of solvers as C on embedded cores, beside their times on this machine.

Instructions are counted by emulation; the desk's times are those of the same steps in a replay.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby
from math import isnan, nan
from typing import Any

import numpy as np
import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.verdict import find_solver_record_or_none
from dpbench.bench.record.result_folder import UncountedSolver
from dpbench.embedded.table import summarise_counted_runs
from dpbench.solvers.contract import DEFAULT
from dpbench.solvers.settings import find_options_of_preset, has_distinct_tolerance_presets

APART = 1.1
"""Ratio of p99 below which two solvers are not ranked, on the desk or by instructions."""
_PART = re.compile(r"(?P<scenario>.+)\[(?P<first>\d+):\d+\]")
"""Name of the QPs of a suite's counts, such as paper[0:200]."""


@dataclass(frozen=True)
class CountedSolver:
    """Counts of a solver's C along a sequence on one core, and its time on the desk.

    p50, p99, worst : instructions a step; k : of the worst, in the scenario.
    iterations, active : of the worst step; −1 where not reported.
    constants, static, heap, stack, code : bytes.
    error_move : largest error of the first move; failed_steps : steps without a claimed optimum.
    compiler : name and version.
    desk_p99_ns : p99 of the same steps on the desk, NaN if they were not timed there.
    desk_error_move : of that replay; NaN without one.
    settings : of the C code, where the answers depend on them and they are not the defaults that
        the replay on the desk has; else empty.
    """

    solver: str
    p50: int
    p99: int
    worst: int
    k: int
    iterations: int
    active: int
    code: int
    constants: int
    static: int
    heap: int
    stack: int
    error_move: float
    compiler: str
    desk_p99_ns: float
    desk_error_move: float
    settings: Mapping[str, bool | int | float]

    @property
    def is_ranked(self) -> bool:
        """True if the desk was timed with the settings of the C code."""
        return not isnan(self.desk_p99_ns) and not self.settings


@dataclass(frozen=True)
class CountedSequence:
    """Solvers counted along one sequence on one core, the fewest instructions at p99 first."""

    sequence: str
    target: str
    single: bool
    steps: int
    solvers: tuple[CountedSolver, ...]

    def find_pairs_ranked_otherwise(
        self, error_move: float
    ) -> list[tuple[CountedSolver, CountedSolver]]:
        """Return pairs that desk and counts rank otherwise; the first has fewer instructions.

        Only solvers of equal settings whose errors stay within `error_move` in both are ranked, and
        only p99 that differ by more than `APART`.
        """
        ranked = [
            one
            for one in self.solvers
            if one.is_ranked and max(one.error_move, one.desk_error_move) <= error_move
        ]
        return [
            (few, many)
            for few, many in combinations(ranked, 2)
            if many.p99 > APART * few.p99 and few.desk_p99_ns > APART * many.desk_p99_ns
        ]

    @property
    def desk_rank_by_solver(self) -> dict[str, int]:
        """Place of each ranked solver by its p99 on the desk, from 1."""
        timed = [one for one in self.solvers if one.is_ranked]
        timed.sort(key=lambda one: one.desk_p99_ns)
        return {one.solver: place for place, one in enumerate(timed, 1)}


@dataclass(frozen=True)
class EmbeddedResults:
    """All counts of a result folder, by sequence and core, and what could not be counted."""

    sequences: tuple[CountedSequence, ...]
    not_counted: tuple[UncountedSolver, ...] = ()
    uncounted_loops: tuple[str, ...] = ()
    """Scenarios of judged closed loops whose QPs were not counted."""

    @classmethod
    def from_counted_steps(cls, records: Records, steps: pd.DataFrame | None) -> "EmbeddedResults":
        """Return a summary of the steps of `embedded.parquet`, with their times on the desk."""
        missing = tuple(records.suite.get("not_counted", ()))
        if steps is None:
            return cls((), missing)
        compilers = dict(zip(steps["solver"], steps["compiler"], strict=True))
        key = ("sequence", "target", "single")
        runs = sorted(summarise_counted_runs(steps), key=lambda run: [run[name] for name in key])
        groups = []
        for _, group in groupby(runs, key=lambda run: [run[name] for name in key]):
            rows = list(group)
            names = {name: rows[0][name] for name in (*key, "steps")}
            solvers = [
                _summarise_counted_run(records, run, compilers[run["solver"]]) for run in rows
            ]
            solvers.sort(key=lambda one: (one.p99, one.solver))
            groups.append(CountedSequence(**names, solvers=tuple(solvers)))
        counted = {part["scenario"] for g in groups if (part := _PART.fullmatch(g.sequence))}
        loops = dict.fromkeys(run.scenario for run in records.select_runs(mode="closed_loop"))
        return cls(tuple(groups), missing, tuple(name for name in loops if name not in counted))

    def find_largest_count_of_solver(
        self, solver: str
    ) -> tuple[CountedSequence, CountedSolver] | None:
        """Return the sequence with a solver's most instructions in a step; None if not counted."""
        counted = [
            (sequence, one)
            for sequence in self.sequences
            for one in sequence.solvers
            if one.solver == solver
        ]
        return max(counted, key=lambda pair: pair[1].worst, default=None)


def _summarise_counted_run(records: Records, run: dict[str, Any], compiler: str) -> CountedSolver:
    """Return the summary of one run with the time of its steps on the desk."""
    desk = _find_desk_replay_and_p99(records, run["sequence"], run["solver"], run["steps"])
    return CountedSolver(
        solver=run["solver"],
        p50=run["instructions_p50"],
        p99=run["instructions_p99"],
        worst=run["instructions_max"],
        k=run["worst_step"] + _find_first_step(run["sequence"]),
        iterations=run["worst_iterations"],
        active=run["worst_active"],
        error_move=run["error_move"],
        compiler=compiler,
        desk_p99_ns=nan if desk is None else desk[1],
        desk_error_move=nan if desk is None else desk[0].error_move_max,
        settings=_find_settings_unlike_default(run["solver"], run["settings"]),
        **{name: run[f"{name}_bytes"] for name in ("code", "constants", "static", "heap", "stack")},
    )


def _find_first_step(sequence: str) -> int:
    """Return the step of the scenario at which a sequence named as `rough[900:1400]` starts."""
    found = re.fullmatch(r".*\[(\d+):\d*\]", sequence)
    return 0 if found is None else int(found[1])


def _find_settings_unlike_default(
    solver: str, settings: Mapping[str, bool | int | float]
) -> Mapping[str, bool | int | float]:
    """Return the settings of a counted solver if its answers depend on them; else none.

    A solver without distinct tolerance presets gives the exact answer at all settings.
    """
    if find_solver_record_or_none(solver) is None or not has_distinct_tolerance_presets(solver):
        return {}
    default = find_options_of_preset(DEFAULT, solver)
    return {} if all(default.get(key) == value for key, value in settings.items()) else settings


def _find_desk_replay_and_p99(
    records: Records, sequence: str, solver: str, steps: int
) -> tuple[RunRecord, float] | None:
    """Return the replay of the same steps at default settings and their p99 [ns]; None if none.

    A kept workspace comes before one that is set up anew, a warm start before a cold one.
    """
    part = _PART.fullmatch(sequence)
    if part is None:
        return None
    asked = {"mode": "replay", "scenario": part["scenario"], "solver": solver, "units": "scaled"}
    runs = [
        run
        for run in records.select_runs(**asked, route="native", settings="default")
        if not run.steps_searched_for_hardest
    ]
    for run in sorted(runs, key=lambda run: _PREFERENCE.index(run.policy)):
        times, first = records.get_step_times(run), int(part["first"]) - run.first
        if times is None:
            continue
        same = times.algo_ns[(times.k >= first) & (times.k < first + steps)]
        if first >= 0 and len(same) == steps:
            return run, float(np.quantile(same, 0.99))
    return None


_PREFERENCE: Sequence[str] = ("warm", "reuse", "fresh")
