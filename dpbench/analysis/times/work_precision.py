"""What accuracy costs: the settings ladder of each solver as points of time and achieved error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records import Row, View, settings_level, values
from dpbench.analysis.statistics import percentile, supports


@dataclass(frozen=True)
class Rung:
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


def usual_ladders(view: View, sequences: Sequence[str]) -> dict[str, list[Rung]]:
    """Per solver its rungs on the default route with policy fresh."""
    return _ladders(
        view, sequences, lambda row: bool(row["default_route"]) and row["policy"] == "fresh"
    )


def native_ladders(view: View, sequences: Sequence[str]) -> dict[str, list[Rung]]:
    """Per solver its rungs on route native, all with one policy: a line joins settings alone.

    It is the policy of least p50 at the most usual settings.
    """
    return _ladders(view, sequences, lambda row: row["route"] == "native")


def _ladders(
    view: View, sequences: Sequence[str], wanted: Callable[[Row], bool]
) -> dict[str, list[Rung]]:
    arms: dict[tuple[str, str, str, str], dict[str, Row]] = {}
    for row in view.select(mode="replay", units="scaled", sequence=tuple(sequences)):
        if wanted(row):
            key = (str(row["solver"]), str(row["route"]), str(row["policy"]), str(row["settings"]))
            arms.setdefault(key, {})[str(row["sequence"])] = row
    rungs = [
        rung
        for key, rows in arms.items()
        if len(rows) == len(sequences)
        and (rung := _rung(view, key, list(rows.values()))) is not None
    ]
    # The first of a solver has its policy: that of least p50 at the most usual settings.
    rungs.sort(key=lambda r: (settings_level(r.settings), r.p50_ns))
    ladders: dict[str, list[Rung]] = {}
    for rung in rungs:
        mine = ladders.setdefault(rung.solver, [])
        if not mine or mine[0].policy == rung.policy:
            mine.append(rung)
    return ladders


def _rung(view: View, key: tuple[str, str, str, str], rows: Sequence[Row]) -> Rung | None:
    times = [view.times(row) for row in rows]
    timed = [found.algo_ns for found in times if found is not None]
    if len(timed) < len(rows):
        return None
    whole = [algo for algo in timed if supports(len(algo), 99)]
    return Rung(
        *key,
        p50_ns=max(float(np.median(algo)) for algo in whole or timed),
        p99_ns=max((percentile(algo, 99) for algo in whole), default=math.nan),
        error_move=float(np.fmax.reduce(values(rows, "error_move_max"))),
        failed=int(np.nansum(values(rows, "failed_steps"))),
    )


def fastest_at(ladders: Mapping[str, Sequence[Rung]], error_move: float) -> list[str]:
    """Solvers with a rung of this accuracy and without a failed step, the fastest p50 first."""
    best = {
        solver: min(
            (r.p50_ns for r in rungs if r.failed == 0 and r.error_move <= error_move),
            default=math.inf,
        )
        for solver, rungs in ladders.items()
    }
    return sorted((s for s in best if math.isfinite(best[s])), key=lambda solver: best[solver])
