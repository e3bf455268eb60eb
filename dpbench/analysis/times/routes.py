"""The routes of a solver, from the wrapper down to a warm start, each compared with its
neighbour.

The order is qpsolvers fresh, native fresh, native reuse, native warm: the first step down is what
the wrapper costs, the second what a kept workspace gains, the third what a warm start gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.step_times import StepTimes
from dpbench.analysis.statistics import Interval, paired_ratio
from dpbench.analysis.times.pairs import paired

RoutePolicy = tuple[str, str]
"""Route and policy."""

WRAPPED, NATIVE, KEPT, WARM = (
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


@dataclass(frozen=True)
class Comparison:
    """A route of a solver beside its neighbour `above`, on the steps that both have done.

    gain : geometric mean over steps of the neighbour's time over this one's.
    """

    above: RoutePolicy
    gain: Interval


@dataclass(frozen=True, eq=False)
class RouteComparison:
    """One solver on all its routes, replayed on one sequence at one settings level."""

    solver: str
    settings: str
    times: dict[RoutePolicy, StepTimes]

    def median_ns(self, route: RoutePolicy) -> float:
        """Median of the algorithmic step time; NaN where the route left no step."""
        return float(np.median(self.times[route].algo_ns)) if route in self.times else np.nan

    def neighbour(self, route: RoutePolicy) -> RoutePolicy | None:
        """The route above it that was measured."""
        return next((above for above in ABOVE.get(route, ()) if above in self.times), None)

    def compare(self, route: RoutePolicy) -> Comparison | None:
        """A route beside its neighbour; None without one, or without a common step."""
        above = self.neighbour(route)
        if above is None:
            return None
        above_ns, route_ns = paired(self.times[above], self.times[route])
        return Comparison(above, paired_ratio(above_ns, route_ns)) if len(route_ns) else None


def route_comparisons(records: Records, sequence: str) -> list[RouteComparison]:
    """All solvers at all settings levels of a sequence, the fastest first; none without a step."""
    comparisons = []
    by_solver = grouped(records.replays(sequence), lambda run: (run.solver, run.settings))
    for (solver, settings), runs in by_solver.items():
        timed: dict[RoutePolicy, StepTimes | None]
        timed = {(run.route, run.policy): records.times(run) for run in runs}
        times = {route: of_route for route, of_route in timed.items() if of_route is not None}
        if times:
            comparisons.append(RouteComparison(solver, settings, times))
    return sorted(comparisons, key=lambda c: (min(map(c.median_ns, c.times)), c.solver))


def native_comparisons(comparisons: Sequence[RouteComparison]) -> list[RouteComparison]:
    """Those with a native configuration; none when not one of them has a neighbour to be compared
    with."""
    native = [c for c in comparisons if any(route == "native" for route, _ in c.times)]
    compared = any(c.neighbour(route) for c in native for route in c.times if route[0] == "native")
    return native if compared else []
