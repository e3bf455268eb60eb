"""Contrasts on the same QPs: routes, settings, formulations, and two solvers.

Routes are compared with their neighbours, in the order qpsolvers fresh, native fresh, native reuse,
native warm: the first step down is what the wrapper costs, the second what a kept workspace gains,
the third what a warm start gains.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.step_times import StepTimes
from dpbench.analysis.statistics import Interval, paired_ratio
from dpbench.analysis.times.pairs import paired
from dpbench.analysis.verdict.demand import Demand, is_right
from dpbench.bench.judge.rules import median
from dpbench.bench.record.configuration import settings_level

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


def right_levels(records: Records, demand: Demand) -> dict[str, list[str]]:
    """The settings levels at which each solver is right on every step, the most usual first."""
    runs = sorted(records.runs, key=lambda run: settings_level(run.settings))
    levels_of = {
        solver: grouped(own, lambda run: run.settings)
        for solver, own in grouped(runs, lambda run: run.solver).items()
    }
    return {
        solver: [level for level, own in of.items() if all(is_right(run, demand) for run in own)]
        for solver, of in levels_of.items()
    }


def fastest_forms(records: Records, demand: Demand) -> Counter[str]:
    """How often each formulation has the least median step time, of the configurations that are
    right on a sequence in two at least."""
    by_case: dict[tuple[str, str, str], dict[str, float]] = {}
    for run in records.all_runs:
        times = records.times(run) if run.mode == "replay" and not run.has_topic else None
        if times is not None and is_right(run, demand):
            case = run.sequence, run.units, run.configuration.in_common_formulation.label
            by_case.setdefault(case, {})[run.formulation] = median(times.algo_ns)
    cases = [forms for forms in by_case.values() if len(forms) > 1]
    return Counter(min(forms, key=lambda form: forms[form]) for forms in cases)


def common_replays(
    records: Records, first: str, second: str
) -> Iterator[tuple[RunRecord, StepTimes, StepTimes]]:
    """Every timed replay of a solver that another has done in the same way, and both step times."""
    for sequence in records.sequences:
        for run in records.replays(sequence, solver=first):
            rivals = (
                other
                for other in records.replays(sequence, solver=second)
                if other.configuration.label_of(first) == run.configuration.label
            )
            rival = next(rivals, None)
            here, there = records.times(run), None if rival is None else records.times(rival)
            if here is not None and there is not None:
                yield run, here, there
