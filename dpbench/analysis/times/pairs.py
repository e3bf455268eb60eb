"""Rank the step times of replayed configurations and compare them in pairs, step by step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dpbench.analysis.records import Records
from dpbench.analysis.statistics import UNKNOWN, Floats, Interval, pooled_mean
from dpbench.analysis.step_times import StepTimes


class TimedConfiguration(Protocol):
    """A configuration with the figures it is ranked by: a verdict on a solver, or any other
    replayed configuration."""

    @property
    def label(self) -> str: ...

    @property
    def solver(self) -> str: ...

    @property
    def route(self) -> str: ...

    @property
    def policy(self) -> str: ...

    @property
    def settings(self) -> str: ...

    @property
    def p99_ns(self) -> float: ...

    @property
    def algo_max_ns(self) -> float: ...


AnyTimedConfiguration = TypeVar("AnyTimedConfiguration", bound=TimedConfiguration)


@dataclass(frozen=True)
class PairedComparison:
    """Two configurations on the same steps: how many times as long `second` takes as `first`.

    `leaders` names the faster one by each yardstick; where they differ the order is unstable.
    """

    first: str
    second: str
    ratio: Interval
    steps: int
    leaders: dict[str, str]

    @property
    def tied(self) -> bool:
        """Whether the two cannot be told apart."""
        return self.ratio.spans(1.0)

    @property
    def unstable(self) -> bool:
        """Whether another yardstick names another leader."""
        return len(set(self.leaders.values())) > 1 or self.ratio.high < 1.0


def fastest_first(timed: Sequence[AnyTimedConfiguration]) -> list[AnyTimedConfiguration]:
    """By p99, those without one by their largest step time, those without time last."""
    return sorted(timed, key=lambda c: (_known(c.p99_ns), _known(c.algo_max_ns), c.solver))


def _known(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def common_steps(first: StepTimes, second: StepTimes) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Where in each of two configurations the steps stand that both have done."""
    _, mine, theirs = np.intersect1d(first.k, second.k, return_indices=True)
    return mine, theirs


def paired(slower: StepTimes, faster: StepTimes) -> tuple[Floats, Floats]:
    """Algorithmic times of the steps that both configurations have done."""
    mine, theirs = common_steps(slower, faster)
    return slower.algo_ns[mine], faster.algo_ns[theirs]


def paired_comparison(
    records: Records, first: TimedConfiguration, second: TimedConfiguration
) -> PairedComparison:
    """Compare two configurations on the steps of all sequences, each of equal weight."""
    logs: list[Floats] = []
    leaders: dict[str, str] = {}
    for sequence in records.sequences:
        both = [_times(records, sequence, configuration) for configuration in (first, second)]
        if both[0] is None or both[1] is None:
            continue
        a, b = paired(both[1], both[0])
        if len(a) == 0:
            continue
        logs.append(np.log(a / b))
        leaders[f"median on `{sequence}`"] = (
            first.label if np.median(b) <= np.median(a) else second.label
        )
    if not logs:
        return PairedComparison(first.label, second.label, UNKNOWN, 0, {})
    leaders["p99" if math.isfinite(first.p99_ns) else "largest step"] = first.label
    return PairedComparison(
        first.label, second.label, pooled_mean(logs), sum(map(len, logs)), leaders
    )


def _times(records: Records, sequence: str, configuration: TimedConfiguration) -> StepTimes | None:
    rows = records.replays(
        sequence,
        solver=configuration.solver,
        settings=configuration.settings,
        route=configuration.route,
        policy=configuration.policy,
    )
    return records.times(rows[0]) if rows else None
