"""The routes of a solver, from the wrapper down to a warm start, each compared with its
neighbour.

The order is qpsolvers fresh, native fresh, native reuse, native warm: the first step down is what
the wrapper costs, the second what a kept workspace gains, the third what a warm start gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.analysis.statistics import Interval, paired_ratio
from dpbench.analysis.step_times import StepTimes
from dpbench.analysis.times.pairs import common_steps

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
"""The neighbours a route is compared with: the first that was measured."""

SLOWER_SHARE = 0.05
SLOWER_NS = 200.0
"""A step is slower when it takes longer by more than both of these; below is the clock's noise."""


@dataclass(frozen=True)
class Comparison:
    """A route of a solver beside its neighbour, on the steps that both have done.

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
    """One solver on all its routes, replayed on one sequence at one settings level."""

    solver: str
    settings: str
    runs: dict[RoutePolicy, RunRecord]
    times: dict[RoutePolicy, StepTimes]

    def median_ns(self, route: RoutePolicy) -> float:
        """Median of the algorithmic step time; NaN where the route left no step."""
        return float(np.median(self.times[route].algo_ns)) if route in self.times else np.nan

    @property
    def best_ns(self) -> float:
        """The smallest median of all routes."""
        return min(map(self.median_ns, self.times))

    def neighbour(self, route: RoutePolicy) -> RoutePolicy | None:
        """The route above it that was measured."""
        return next((above for above in ABOVE.get(route, ()) if above in self.times), None)

    def compare(
        self, route: RoutePolicy, above: RoutePolicy | None, comparisons: int = 1
    ) -> Comparison | None:
        """`route` beside `above`; None when one of them left no common step."""
        if above is None or above not in self.times or route not in self.times:
            return None
        here, there = self.times[route], self.times[above]
        i, j = common_steps(here, there)
        if len(i) == 0:
            return None
        here_ns, there_ns = here.algo_ns[i], there.algo_ns[j]
        longer_ns = here_ns - there_ns
        slower = (longer_ns > SLOWER_SHARE * there_ns) & (longer_ns > SLOWER_NS)
        return Comparison(
            above=above,
            gain=paired_ratio(there_ns, here_ns, comparisons=comparisons),
            saved_ns=float(np.median(there_ns) - np.median(here_ns)),
            steps=len(i),
            slower=int(slower.sum()),
            slower_ns=float(longer_ns[slower].max(initial=0.0)),
            wrong=tuple(here.k[i][~here.true[i] & there.true[j]].tolist()),
            mended=int((here.true[i] & ~there.true[j]).sum()),
        )


def route_comparisons(records: Records, sequence: str) -> list[RouteComparison]:
    """All solvers at all settings levels of a sequence, the fastest first; none without a step."""
    by_solver: dict[tuple[str, str], dict[RoutePolicy, RunRecord]] = {}
    for run in records.replays(sequence):
        by_solver.setdefault((run.solver, run.settings), {})[run.route, run.policy] = run
    comparisons = []
    for (solver, settings), runs in by_solver.items():
        timed = {route: records.times(run) for route, run in runs.items()}
        times = {route: of_route for route, of_route in timed.items() if of_route is not None}
        if times:
            comparisons.append(RouteComparison(solver, settings, runs, times))
    return sorted(comparisons, key=lambda comparison: (comparison.best_ns, comparison.solver))


def native_comparisons(comparisons: Sequence[RouteComparison]) -> list[RouteComparison]:
    """Those with a native configuration; none when not one of them has a neighbour to be compared
    with."""
    native = [c for c in comparisons if any(route == "native" for route, _ in c.times)]
    compared = any(c.neighbour(route) for c in native for route in c.times if route[0] == "native")
    return native if compared else []


def route_policy_text(route: RoutePolicy) -> str:
    """`native warm`."""
    return " ".join(route)
