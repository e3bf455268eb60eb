"""What accuracy costs: the tolerance levels of each solver as points of time and achieved error."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.bench.judge.rules import percentile, supports
from dpbench.bench.record.configuration import Configuration, settings_level


@dataclass(frozen=True)
class LevelPoint:
    """A configuration, at one settings level of its solver, over all sequences.

    Parameters
    ----------
    p50_ns, p99_ns : algorithmic step time, each the worst over the sequences that support a p99,
        so that both are of the same steps; where none does, p50 over all and p99 NaN.
    error_move : the largest error of the first move, NaN where no optimum is certified.
    failed : failed steps.
    """

    configuration: Configuration
    p50_ns: float
    p99_ns: float
    error_move: float
    failed: int


def default_route_levels(records: Records, sequences: Sequence[str]) -> dict[str, list[LevelPoint]]:
    """Per solver its points on the default route with policy fresh."""
    return _levels(records, sequences, lambda run: run.default_route and run.policy == "fresh")


def native_route_levels(records: Records, sequences: Sequence[str]) -> dict[str, list[LevelPoint]]:
    """Per solver its points on route native, all with one policy: a line joins settings alone.

    It is the policy of least p50 at the most usual settings.
    """
    return _levels(records, sequences, lambda run: run.route == "native")


def _levels(
    records: Records, sequences: Sequence[str], wanted: Callable[[RunRecord], bool]
) -> dict[str, list[LevelPoint]]:
    replays = records.select(mode="replay", units="scaled", sequence=tuple(sequences))
    configurations = grouped(
        filter(wanted, replays), lambda run: run.configuration.in_common_formulation
    )
    points = [
        point
        for configuration, runs in configurations.items()
        if len({run.sequence for run in runs}) == len(sequences)
        and (point := _level_point(records, configuration, runs)) is not None
    ]
    # The first of a solver has its policy: that of least p50 at the most usual settings.
    points.sort(key=lambda point: (settings_level(point.configuration.settings), point.p50_ns))
    return {
        solver: [p for p in own if p.configuration.policy == own[0].configuration.policy]
        for solver, own in grouped(points, lambda point: point.configuration.solver).items()
    }


def _level_point(
    records: Records, configuration: Configuration, runs: Sequence[RunRecord]
) -> LevelPoint | None:
    timed = [times.algo_ns for times in map(records.times, runs) if times is not None]
    if len(timed) < len(runs):
        return None
    whole = [algo for algo in timed if supports(len(algo), 99)]
    return LevelPoint(
        configuration,
        p50_ns=max(float(np.median(algo)) for algo in whole or timed),
        p99_ns=max((percentile(algo, 99) for algo in whole), default=math.nan),
        error_move=float(np.fmax.reduce([run.error_move_max for run in runs])),
        failed=int(np.nansum([run.failed_steps for run in runs])),
    )
