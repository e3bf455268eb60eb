"""Step times of replayed configurations on the same steps, pooled over sequences of equal
weight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dpbench.analysis.demand import Demand, is_right
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.analysis.statistics import Floats
from dpbench.bench.record.configuration import Configuration, settings_level


@dataclass(frozen=True, eq=False)
class PooledTimes:
    """The times of a configuration on common steps.

    Parameters
    ----------
    time_ns : (K,) algorithmic step time, NaN on steps it has not done.
    error : (K,) accuracy achieved, as in `StepTimes.error`; inf on steps it has not done.
    right : whether its answers meet the demand in every sequence it was replayed on.
    is_default : whether it runs on its solver's default route with policy fresh.
    """

    configuration: Configuration
    time_ns: Floats
    error: Floats
    right: bool
    is_default: bool

    def solved(self, level: float) -> NDArray[np.bool_]:
        """(K,) where it has a true answer of this accuracy."""
        return self.error <= level


@dataclass(frozen=True, eq=False)
class CommonSteps:
    """All configurations that were replayed on the same sequences, in the order of the suite.

    Parameters
    ----------
    sequences : those with a step, in the order in which their steps stand.
    sequence_of : (K,) index of the sequence of each step.
    pooled : the configurations that were asked for in every one of them; where settings have no
        effect the one run that stands under several names is there once.
    left_out : how many other configurations were replayed on fewer.
    """

    sequences: tuple[str, ...]
    sequence_of: NDArray[np.intp]
    pooled: tuple[PooledTimes, ...]
    left_out: int

    @cached_property
    def weights(self) -> Floats:
        """(K,) weights of the steps that sum to 1: each sequence weighs the same."""
        return self.weights_without(-1)

    def weights_without(self, sequence: int) -> Floats:
        """(K,) the same with the steps of one sequence left out."""
        kept = self.sequence_of != sequence
        counts = np.bincount(self.sequence_of[kept], minlength=len(self.sequences))
        share = np.where(kept, 1.0 / np.maximum(counts[self.sequence_of], 1), 0.0)
        return np.asarray(share / share.sum(), dtype=np.float64)


def common_steps(records: Records, demand: Demand) -> CommonSteps | None:
    """The common steps of the sequences that most configurations share; None when no replay left a
    step."""
    replays: dict[Configuration, dict[str, RunRecord]] = {}
    for run in records.select(mode="replay", units="scaled"):
        if run.outcome not in ("refused", "invalid"):
            by_sequence = replays.setdefault(run.configuration.in_common_formulation, {})
            by_sequence[run.sequence] = run
    sets = [frozenset(by_sequence) for by_sequence in replays.values()]
    if not sets:
        return None
    # The widest set; of several as wide, the one with the most configurations, then the first.
    widest = max(sets, key=lambda names: (len(names), sum(names <= other for other in sets)))
    members = {who: runs for who, runs in replays.items() if widest <= set(runs)}
    done = {
        sequence: _steps(records, [runs[sequence] for runs in members.values()])
        for sequence in records.sequences
        if sequence in widest
    }
    steps = {sequence: k for sequence, k in done.items() if len(k)}
    if not steps:
        return None
    pooled = [_pooled(records, who, runs, steps, demand) for who, runs in members.items()]
    return CommonSteps(
        tuple(steps),
        np.repeat(np.arange(len(steps)), [len(k) for k in steps.values()]),
        tuple(_distinct([times for times in pooled if np.isfinite(times.time_ns).any()])),
        len(replays) - len(members),
    )


def _distinct(pooled: Sequence[PooledTimes]) -> list[PooledTimes]:
    """Each run once, under its most usual settings."""
    once: dict[tuple[str, str, str, bytes], PooledTimes] = {}
    for times in pooled:
        who = times.configuration
        key = who.solver, who.route, who.policy, times.time_ns.tobytes()
        known = once.setdefault(key, times).configuration
        if settings_level(who.settings) < settings_level(known.settings):
            once[key] = times
    return list(once.values())


def _steps(records: Records, runs: Sequence[RunRecord]) -> NDArray[np.int64]:
    """The steps of a sequence that any configuration has done."""
    done = [times.k for times in map(records.times, runs) if times is not None]
    return np.unique(np.concatenate(done)) if done else np.empty(0, dtype=np.int64)


def _pooled(
    records: Records,
    configuration: Configuration,
    runs: Mapping[str, RunRecord],
    steps: Mapping[str, NDArray[np.int64]],
    demand: Demand,
) -> PooledTimes:
    """The times of one configuration, of which `runs` has the replay of each sequence."""
    times_ns, errors = [], []
    for sequence, asked in steps.items():
        time_ns, error = np.full(len(asked), np.nan), np.full(len(asked), np.inf)
        times = records.times(runs[sequence])
        if times is not None:
            done = np.searchsorted(asked, times.k)
            time_ns[done], error[done] = times.algo_ns, times.error
        times_ns.append(time_ns)
        errors.append(error)
    default_route = runs[next(iter(steps))].default_route
    return PooledTimes(
        configuration,
        time_ns=np.concatenate(times_ns),
        error=np.concatenate(errors),
        right=all(is_right(run, demand) for run in runs.values()),
        is_default=default_route and configuration.policy == "fresh",
    )
