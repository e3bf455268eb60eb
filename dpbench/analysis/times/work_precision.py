"""What accuracy costs: the tolerance levels of each solver as points of time and achieved error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records import Records, RunRecord, settings_level, values
from dpbench.analysis.statistics import percentile, supports


@dataclass(frozen=True)
class LevelPoint:
    """A solver run in one way at one settings level, over all sequences.

    Parameters
    ----------
    p50_ns, p99_ns : algorithmic step time, each the worst over the sequences that support a p99,
        so that both are of the same steps; where none does, p50 over all and p99 NaN.
    error_move : the largest error of the first move, NaN where no optimum is certified.
    failed : failed steps.
    """

    solver: str
    route: str
    policy: str
    settings: str
    p50_ns: float
    p99_ns: float
    error_move: float
    failed: int


def default_route_levels(records: Records, sequences: Sequence[str]) -> dict[str, list[LevelPoint]]:
    """Per solver its points on the default route with policy fresh."""
    return _levels(
        records, sequences, lambda row: bool(row["default_route"]) and row["policy"] == "fresh"
    )


def native_route_levels(records: Records, sequences: Sequence[str]) -> dict[str, list[LevelPoint]]:
    """Per solver its points on route native, all with one policy: a line joins settings alone.

    It is the policy of least p50 at the most usual settings.
    """
    return _levels(records, sequences, lambda row: row["route"] == "native")


def _levels(
    records: Records, sequences: Sequence[str], wanted: Callable[[RunRecord], bool]
) -> dict[str, list[LevelPoint]]:
    configurations: dict[tuple[str, str, str, str], dict[str, RunRecord]] = {}
    for row in records.select(mode="replay", units="scaled", sequence=tuple(sequences)):
        if wanted(row):
            key = (str(row["solver"]), str(row["route"]), str(row["policy"]), str(row["settings"]))
            configurations.setdefault(key, {})[str(row["sequence"])] = row
    points = [
        point
        for key, rows in configurations.items()
        if len(rows) == len(sequences)
        and (point := _level_point(records, key, list(rows.values()))) is not None
    ]
    # The first of a solver has its policy: that of least p50 at the most usual settings.
    points.sort(key=lambda r: (settings_level(r.settings), r.p50_ns))
    levels_by_solver: dict[str, list[LevelPoint]] = {}
    for point in points:
        mine = levels_by_solver.setdefault(point.solver, [])
        if not mine or mine[0].policy == point.policy:
            mine.append(point)
    return levels_by_solver


def _level_point(
    records: Records, key: tuple[str, str, str, str], rows: Sequence[RunRecord]
) -> LevelPoint | None:
    times = [records.times(row) for row in rows]
    timed = [found.algo_ns for found in times if found is not None]
    if len(timed) < len(rows):
        return None
    whole = [algo for algo in timed if supports(len(algo), 99)]
    return LevelPoint(
        *key,
        p50_ns=max(float(np.median(algo)) for algo in whole or timed),
        p99_ns=max((percentile(algo, 99) for algo in whole), default=math.nan),
        error_move=float(np.fmax.reduce(values(rows, "error_move_max"))),
        failed=int(np.nansum(values(rows, "failed_steps"))),
    )


def fastest_at(
    levels_by_solver: Mapping[str, Sequence[LevelPoint]], error_move: float
) -> list[str]:
    """Solvers with a point of this accuracy and without a failed step, the fastest p50 first."""
    best = {
        solver: min(
            (r.p50_ns for r in points if r.failed == 0 and r.error_move <= error_move),
            default=math.inf,
        )
        for solver, points in levels_by_solver.items()
    }
    return sorted((s for s in best if math.isfinite(best[s])), key=lambda solver: best[solver])
