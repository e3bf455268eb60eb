"""The fastest way to run each solver: route, policy and settings of the arms that are right.

An arm is a candidate when every answer of its replays meets the demand, in every sequence that the
widest replayed arms cover, and no closed loop that was run in the same way contradicts it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.report.demand import Demand
from dpbench.report.formats import as_float, plural
from dpbench.report.ranking import fastest_first
from dpbench.report.statistics import percentile
from dpbench.report.tables_timing import is_right
from dpbench.report.verdict import settings_level
from dpbench.report.view import Row, View, has_steps

ALIKE = 0.03
"""Settings whose figures differ by less are equally fast: another day may swap them."""


@dataclass(frozen=True)
class Candidate:
    """A way to run a solver whose answers meet the demand.

    Parameters
    ----------
    p50_ns, p99_ns : of the algorithmic step time on the sequence `where`, that of the worst p99;
        where no sequence supports a p99 it is NaN, and `where` is that of the worst p50.
    algo_max_ns : the largest algorithmic step time of all sequences.
    error_move : the largest error of the first move in its replays.
    steps : replayed steps, over `sequences` sequences; loops : closed loops run in the same way.
    """

    solver: str
    route: str
    policy: str
    settings: str
    p50_ns: float
    p99_ns: float
    where: str
    algo_max_ns: float
    error_move: float
    steps: int
    sequences: int
    loops: int

    @property
    def label(self) -> str:
        """Solver, route, policy and, where they are not `default`, settings."""
        extra = "" if self.settings == "default" else f", {self.settings}"
        return f"{self.solver} ({self.route} {self.policy}{extra})"

    @property
    def judged_on(self) -> str:
        """What its answers were judged on."""
        return f"replays and {plural(self.loops, 'closed loop')}" if self.loops else "replays"


def candidates(view: View, demand: Demand) -> list[Candidate]:
    """All ways to run a solver whose answers meet the demand, the fastest first."""
    arms: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in view.select(mode="replay", units="scaled"):
        key = (str(row["solver"]), str(row["route"]), str(row["policy"]), str(row["settings"]))
        arms.setdefault(key, []).append(row)
    found = [_candidate(view, key, rows, demand) for key, rows in arms.items()]
    right = [candidate for candidate in found if candidate is not None]
    widest = max((candidate.sequences for candidate in right), default=0)
    wide = [candidate for candidate in right if candidate.sequences == widest]
    # Where settings have no effect, one run stands under several names: the usual one is kept.
    usual_first = sorted(wide, key=lambda c: settings_level(c.settings))
    return fastest_first(usual_first)


def fastest_of(found: Sequence[Candidate], solver: str) -> Candidate | None:
    """The fastest way of one solver, at its most usual settings where others are hardly faster."""
    mine = [candidate for candidate in found if candidate.solver == solver]
    if not mine:
        return None
    best = mine[0]
    same_way = [c for c in mine if (c.route, c.policy) == (best.route, best.policy)]
    alike = [c for c in same_way if _figure(c) <= (1.0 + ALIKE) * _figure(best)]
    return min(alike, key=lambda c: settings_level(c.settings))


def _figure(candidate: Candidate) -> float:
    return candidate.p99_ns if math.isfinite(candidate.p99_ns) else candidate.p50_ns


def _candidate(
    view: View, key: tuple[str, str, str, str], rows: Sequence[Row], demand: Demand
) -> Candidate | None:
    solver, route, policy, settings = key
    loops = [
        row
        for row in view.longest_loops(solver, settings, route=route, policy=policy)
        if has_steps(row)
    ]
    times = {str(row["sequence"]): view.times(row) for row in rows}
    timed = {name: t for name, t in times.items() if t is not None}
    right = len(timed) == len(times) and all(is_right(row, demand) for row in rows)
    if not right or any(_contradicts(row, demand) for row in loops):
        return None
    p50 = {name: float(np.median(t.algo_ns)) for name, t in timed.items()}
    p99 = {name: percentile(t.algo_ns, 99) for name, t in timed.items()}
    supported = {name: value for name, value in p99.items() if math.isfinite(value)} or p50
    where = max(supported, key=lambda name: supported[name])
    return Candidate(
        *key,
        p50_ns=p50[where],
        p99_ns=p99[where],
        where=where,
        algo_max_ns=max(float(t.algo_ns.max()) for t in timed.values()),
        error_move=max(as_float(row["error_move_max"]) for row in rows),
        steps=sum(len(t.algo_ns) for t in timed.values()),
        sequences=len(timed),
        loops=len(loops),
    )


def _contradicts(loop: Row, demand: Demand) -> bool:
    return (
        as_float(loop["error_move_max"]) > demand.error_move
        or as_float(loop["failed_steps"]) > demand.failed_steps
    )
