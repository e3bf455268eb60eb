"""Step times of replayed configurations on the same steps, pooled over sequences of equal
weight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dpbench.analysis.demand import Demand, is_right
from dpbench.analysis.records import Records, RunRecord, settings_level
from dpbench.analysis.statistics import Floats

Key = tuple[str, str, str, str]
"""Solver, route, policy and settings."""


@dataclass(frozen=True, eq=False)
class PooledConfiguration:
    """One way to run a solver on all steps of a common_steps.

    Parameters
    ----------
    time_ns : (K,) algorithmic step time, NaN on steps it has not done.
    error : (K,) accuracy achieved, as in `StepTimes.error`; inf on steps it has not done.
    right : whether its answers meet the demand in every sequence it was replayed on.
    usual : whether it runs on its solver's default route with policy fresh.
    """

    solver: str
    route: str
    policy: str
    settings: str
    time_ns: Floats
    error: Floats
    right: bool
    usual: bool

    @property
    def label(self) -> str:
        """Solver and how it is run."""
        return f"{self.solver} ({self.route} {self.policy}, {self.settings})"

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
    configurations : the configurations that were asked for in every one of them; where settings
        have no effect the one run that stands under several names is there once.
    left_out : how many other configurations were replayed on fewer.
    """

    sequences: tuple[str, ...]
    sequence_of: NDArray[np.intp]
    configurations: tuple[PooledConfiguration, ...]
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
    """The common_steps of the sequences that most configurations share; None when no replay left a
    step."""
    rows: dict[Key, dict[str, RunRecord]] = {}
    for row in records.select(mode="replay", units="scaled"):
        if row["outcome"] not in ("refused", "invalid"):
            rows.setdefault(_key(row), {})[str(row["sequence"])] = row
    sets = [frozenset(by_sequence) for by_sequence in rows.values()]
    if not sets:
        return None
    # The widest set; of several as wide, the one with the most configurations, then the first.
    widest = max(sets, key=lambda names: (len(names), sum(names <= other for other in sets)))
    members = {key: found for key, found in rows.items() if widest <= set(found)}
    done = {
        name: _steps(records, [found[name] for found in members.values()])
        for name in records.sequences
        if name in widest
    }
    sequences = tuple(name for name, k in done.items() if len(k))
    steps = [done[name] for name in sequences]
    if not steps:
        return None
    configurations = [
        _configuration(records, key, found, sequences, steps, demand)
        for key, found in members.items()
    ]
    return CommonSteps(
        sequences,
        np.repeat(np.arange(len(sequences)), [len(k) for k in steps]),
        tuple(
            _distinct(
                [
                    configuration
                    for configuration in configurations
                    if np.isfinite(configuration.time_ns).any()
                ]
            )
        ),
        len(rows) - len(members),
    )


def _distinct(configurations: Sequence[PooledConfiguration]) -> list[PooledConfiguration]:
    """Each run once, under its most usual settings."""
    once: dict[tuple[str, str, str, bytes], PooledConfiguration] = {}
    for configuration in configurations:
        key = (
            configuration.solver,
            configuration.route,
            configuration.policy,
            configuration.time_ns.tobytes(),
        )
        known = once.setdefault(key, configuration)
        if settings_level(configuration.settings) < settings_level(known.settings):
            once[key] = configuration
    return list(once.values())


def _key(row: RunRecord) -> Key:
    return str(row["solver"]), str(row["route"]), str(row["policy"]), str(row["settings"])


def _steps(records: Records, rows: Sequence[RunRecord]) -> NDArray[np.int64]:
    """The steps of a sequence that any configuration has done."""
    done = [times.k for times in map(records.times, rows) if times is not None]
    return np.unique(np.concatenate(done)) if done else np.empty(0, dtype=np.int64)


def _configuration(
    records: Records,
    key: Key,
    rows: dict[str, RunRecord],
    sequences: Sequence[str],
    steps: Sequence[NDArray[np.int64]],
    demand: Demand,
) -> PooledConfiguration:
    times, errors = [], []
    for name, asked in zip(sequences, steps, strict=True):
        time, error = np.full(len(asked), np.nan), np.full(len(asked), np.inf)
        found = records.times(rows[name])
        if found is not None:
            where = np.searchsorted(asked, found.k)
            time[where], error[where] = found.algo_ns, found.error
        times.append(time)
        errors.append(error)
    first = rows[sequences[0]]
    return PooledConfiguration(
        *key,
        time_ns=np.concatenate(times),
        error=np.concatenate(errors),
        right=all(is_right(row, demand) for row in rows.values()),
        usual=bool(first["default_route"]) and key[2] == "fresh",
    )
