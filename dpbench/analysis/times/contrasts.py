"""The same QPs, one thing changed: settings levels that are right, forms that are fastest, replays
that two solvers have in common."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.step_times import StepTimes
from dpbench.analysis.verdict.demand import Demand, is_right
from dpbench.bench.judge.rules import median
from dpbench.bench.record.configuration import settings_level


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
