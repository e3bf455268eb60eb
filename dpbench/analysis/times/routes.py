"""RouteComparison to run a solver, from the wrapper down to a warm start, each compared with its
neighbour.

The order is qpsolvers fresh, native fresh, native reuse, native warm: the first step down is what
the wrapper costs, the second what a kept workspace gains, the third what a warm start gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records import Records, RunRecord
from dpbench.analysis.statistics import Interval, paired_ratio
from dpbench.analysis.step_times import StepTimes
from dpbench.analysis.times.pairs import common_steps
from dpbench.errors import UnknownNameError
from dpbench.solvers.table import record

RoutePolicy = tuple[str, str]
"""Route and policy."""

WRAPPED, NATIVE, KEPT, WARM = LEVELS = (
    ("qpsolvers", "fresh"),
    ("native", "fresh"),
    ("native", "reuse"),
    ("native", "warm"),
)
WRAPPED_WARM = ("qpsolvers", "warm")
ABOVE: dict[RoutePolicy, tuple[RoutePolicy, ...]] = {
    NATIVE: (WRAPPED,),
    KEPT: (NATIVE,),
    WARM: (KEPT, NATIVE),
    WRAPPED_WARM: (WRAPPED,),
}
"""The neighbours a way is compared with: the first that was measured."""

SLOWER_SHARE = 0.05
SLOWER_NS = 200.0
"""A step is slower when it takes longer by more than both of these; below is the clock's noise."""


@dataclass(frozen=True)
class Comparison:
    """One way of running a solver beside its neighbour, on the steps that both have done.

    Parameters
    ----------
    gain : geometric mean over steps of the neighbour's time over this one's.
    saved_ns : median of the neighbour less the median of this one.
    slower : steps that take longer; slower_ns : by how much at most, 0 if none does.
    wrong : steps whose answer is not true here and true there; mended : the other way round.
    """

    above: RoutePolicy
    gain: Interval
    saved_ns: float
    steps: int
    slower: int
    slower_ns: float
    wrong: tuple[int, ...]
    mended: int


@dataclass(frozen=True, eq=False)
class RouteComparison:
    """All ways in which one solver was replayed on one sequence at one settings level."""

    solver: str
    settings: str
    rows: dict[RoutePolicy, RunRecord]
    times: dict[RoutePolicy, StepTimes]

    def median_ns(self, way: RoutePolicy) -> float:
        """Median of the algorithmic step time; NaN where the way left no step."""
        return float(np.median(self.times[way].algo_ns)) if way in self.times else float(np.nan)

    @property
    def best_ns(self) -> float:
        """The smallest median of all ways."""
        return min(self.median_ns(way) for way in self.times)

    @property
    def best_kept(self) -> RoutePolicy | None:
        """The faster of native reuse and native warm; None where neither left a step."""
        return min((w for w in (KEPT, WARM) if w in self.times), key=self.median_ns, default=None)

    def neighbour(self, way: RoutePolicy) -> RoutePolicy | None:
        """The way above it that was measured."""
        return next((above for above in ABOVE.get(way, ()) if above in self.times), None)

    def compare(
        self, way: RoutePolicy, above: RoutePolicy | None, comparisons: int = 1
    ) -> Comparison | None:
        """`way` beside `above`; None when one of them left no common step."""
        if above is None or above not in self.times or way not in self.times:
            return None
        mine, theirs = self.times[way], self.times[above]
        i, j = common_steps(mine, theirs)
        if len(i) == 0:
            return None
        here, there = mine.algo_ns[i], theirs.algo_ns[j]
        longer = here - there
        slower = (longer > SLOWER_SHARE * there) & (longer > SLOWER_NS)
        return Comparison(
            above=above,
            gain=paired_ratio(there, here, comparisons=comparisons),
            saved_ns=float(np.median(there) - np.median(here)),
            steps=len(i),
            slower=int(slower.sum()),
            slower_ns=float(longer[slower].max(initial=0.0)),
            wrong=tuple(mine.k[i][~mine.true[i] & theirs.true[j]].tolist()),
            mended=int((mine.true[i] & ~theirs.true[j]).sum()),
        )

    def why_missing(self, way: RoutePolicy) -> str:
        """Why a way left no step, in the library's or the harness's own words."""
        row = self.rows.get(way)
        if row is None:
            return _not_offered(self.solver, way)
        detail = str(row["outcome_detail"]).strip().rstrip(".")
        if row["outcome"] == "finished":
            return "no counting round left a step"
        return detail or f"{str(row['outcome']).replace('_', ' ')}, no reason was recorded"


def _not_offered(solver: str, way: RoutePolicy) -> str:
    try:
        routes = record(solver).policies
    except UnknownNameError:
        return "the suite does not run it"
    if way[0] not in routes:
        return f"it has no route {way[0]}"
    return "the suite does not run it"


def route_comparisons(records: Records, sequence: str) -> list[RouteComparison]:
    """All solvers at all settings levels of a sequence, the fastest first; none without a step."""
    found: dict[tuple[str, str], dict[RoutePolicy, RunRecord]] = {}
    for row in records.replays(sequence):
        configurations = found.setdefault((str(row["solver"]), str(row["settings"])), {})
        configurations[str(row["route"]), str(row["policy"])] = row
    ways = []
    for (solver, settings), rows in found.items():
        timed = {way: records.times(row) for way, row in rows.items()}
        times = {way: t for way, t in timed.items() if t is not None}
        if times:
            ways.append(RouteComparison(solver, settings, rows, times))
    return sorted(ways, key=lambda w: (w.best_ns, w.solver))


def native_comparisons(ways: Sequence[RouteComparison]) -> list[RouteComparison]:
    """Those with a native configuration; none when not one of them has a neighbour to be compared
    with."""
    native = [w for w in ways if any(route == "native" for route, _ in w.times)]
    compared = any(w.neighbour(way) for w in native for way in w.times if way[0] == "native")
    return native if compared else []


def route_policy_text(way: RoutePolicy) -> str:
    """`native warm`."""
    return " ".join(way)
