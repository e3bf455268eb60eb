"""Contrasts on the same QPs: routes, settings, formulations, and two solvers.

Routes are compared with their neighbours, in the order qpsolvers fresh, native fresh, native
reuse, native warm: the first step is the cost of the wrapper, the second the gain of a kept
workspace, the third that of a warm start.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.step_times import StepTimes
from dpbench.analysis.statistics import Interval, paired_ratio
from dpbench.analysis.times.pairs import paired
from dpbench.analysis.verdict.requirements import Requirements, is_right
from dpbench.bench.judge.rules import median
from dpbench.bench.record.configuration import settings_level

RoutePolicy = tuple[str, str]

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
"""Neighbours a route is compared with: the first that was measured."""


@dataclass(frozen=True)
class RouteGain:
    """Route of a solver at one settings level, against its neighbour `above`.

    Parameters
    ----------
    gain : geometric mean of the neighbour's time over this one's, over their common steps.
    median_ns : median of its algorithmic step time.
    """

    solver: str
    settings: str
    above: RoutePolicy
    route: RoutePolicy
    gain: Interval
    median_ns: float


def route_gains(records: Records, sequence: str) -> list[RouteGain]:
    """Compare the routes of solvers that were also run natively, the fastest solver first.

    None where no native route has a neighbour.
    """
    medians: dict[tuple[float, str], list[RouteGain]] = {}
    by_solver = grouped(records.replays(sequence), lambda run: (run.solver, run.settings))
    for (solver, settings), runs in by_solver.items():
        times: dict[RoutePolicy, StepTimes] = {}
        for run in runs:
            if (of_run := records.times(run)) is not None:
                times[run.route, run.policy] = of_run
        if any(route == "native" for route, _ in times):
            fastest = min(float(np.median(of_route.algo_ns)) for of_route in times.values())
            own = medians.setdefault((fastest, solver), [])
            own += [RouteGain(solver, settings, *gain) for gain in _gains(times)]
    gains = [gain for key in sorted(medians) for gain in medians[key]]
    return gains if any(gain.route[0] == "native" for gain in gains) else []


def _gains(
    times: Mapping[RoutePolicy, StepTimes],
) -> Iterator[tuple[RoutePolicy, RoutePolicy, Interval, float]]:
    """Yield neighbour, route, gain and median of each route with a neighbour and common steps."""
    for route, own in times.items():
        above = next((above for above in ABOVE.get(route, ()) if above in times), None)
        if above is not None:
            above_ns, own_ns = paired(times[above], own)
            if len(own_ns):
                yield above, route, paired_ratio(above_ns, own_ns), float(np.median(own.algo_ns))


def right_levels(records: Records, requirements: Requirements) -> dict[str, list[str]]:
    """Return the levels at which each solver is right on every step, the most usual first."""
    runs = sorted(records.runs, key=lambda run: settings_level(run.settings))
    levels_of = {
        solver: grouped(own, lambda run: run.settings)
        for solver, own in grouped(runs, lambda run: run.solver).items()
    }
    return {
        solver: [
            level for level, own in of.items() if all(is_right(run, requirements) for run in own)
        ]
        for solver, of in levels_of.items()
    }


def fastest_forms(records: Records, requirements: Requirements) -> Counter[str]:
    """Count how often each formulation has the least median step time.

    Of the configurations that are right on a sequence in two at least.
    """
    by_case: dict[tuple[str, str, str], dict[str, float]] = {}
    for run in records.all_runs:
        times = records.times(run) if run.mode == "replay" and not run.has_topic else None
        if times is not None and is_right(run, requirements):
            case = run.sequence, run.units, run.configuration.in_common_formulation.label
            by_case.setdefault(case, {})[run.formulation] = median(times.algo_ns)
    cases = [forms for forms in by_case.values() if len(forms) > 1]
    return Counter(min(forms, key=lambda form: forms[form]) for forms in cases)


def common_replays(
    records: Records, first: str, second: str
) -> Iterator[tuple[RunRecord, StepTimes, StepTimes]]:
    """Yield timed replays of two solvers in the same call mode, with both step times."""
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
