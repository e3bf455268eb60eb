"""What accuracy costs: the tolerance levels of each solver as points of time and achieved error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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


def level_points(
    records: Records, sequences: Sequence[str], ways: Mapping[str, tuple[str, str]]
) -> dict[str, list[LevelPoint]]:
    """Per solver its points in one way, so that a line joins settings alone, the most usual first.

    Parameters
    ----------
    sequences : all of which a configuration was replayed on, or it has no point.
    ways : of each solver route and policy; one that is not in it has no points.
    """
    replays = records.select(mode="replay", units="scaled", sequence=tuple(sequences))
    wanted = [run for run in replays if (run.route, run.policy) == ways.get(run.solver)]
    configurations = grouped(wanted, lambda run: run.configuration.in_common_formulation)
    points = [
        point
        for configuration, runs in configurations.items()
        if len({run.sequence for run in runs}) == len(sequences)
        and (point := _level_point(records, configuration, runs)) is not None
    ]
    points.sort(key=lambda point: settings_level(point.configuration.settings))
    return grouped(points, lambda point: point.configuration.solver)


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
