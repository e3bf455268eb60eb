"""Paired step times against one baseline, with intervals that hold together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.analysis.statistics import Interval, pooled_mean
from dpbench.analysis.times.pooled import CommonSteps, PooledConfiguration


@dataclass(frozen=True)
class Ratio:
    """How many times as long a configuration takes as the baseline.

    Parameters
    ----------
    pooled : geometric mean over the common steps, every sequence of equal weight, with its
        simultaneous interval; `per_sequence` the geometric mean in each, NaN without common steps.
    steps : how many steps both have done.
    """

    configuration: PooledConfiguration
    pooled: Interval
    per_sequence: tuple[float, ...]
    steps: int

    @property
    def turns(self) -> bool:
        """Whether one sequence calls it faster and another slower than the baseline."""
        known = [ratio for ratio in self.per_sequence if ratio == ratio]
        return any(ratio > 1.0 for ratio in known) and any(ratio < 1.0 for ratio in known)


def baseline_of(common_steps: CommonSteps, solver: str | None) -> PooledConfiguration:
    """The configuration that others are compared with.

    The fastest configuration, by the geometric mean of its step times, among those of `solver` (of
    all where it is None or was not replayed) that meet the demand; among those that do not if there
    is none.
    """
    mine = [
        configuration
        for configuration in common_steps.configurations
        if configuration.solver == solver
    ] or list(common_steps.configurations)
    right = [configuration for configuration in mine if configuration.right] or mine
    return min(right, key=lambda configuration: _typical(configuration, common_steps))


def _typical(configuration: PooledConfiguration, common_steps: CommonSteps) -> float:
    """Mean logarithm of the step times; a configuration that has not done every step comes last."""
    mean = float(common_steps.weights @ np.log(configuration.time_ns))
    return mean if np.isfinite(mean) else float("inf")


def ratios(common_steps: CommonSteps, baseline: PooledConfiguration) -> list[Ratio]:
    """All other configurations of a common_steps against the baseline, the fastest first, those
    without steps last.

    The intervals hold for all of them together with 95 % (Bonferroni). Quantiles so far out are
    beyond what resamples can show; the interval of the mean log ratio is therefore a normal one
    with the standard error of the block bootstrap, sequence by sequence.
    """
    others = [
        configuration
        for configuration in common_steps.configurations
        if configuration is not baseline
    ]
    found = [
        _ratio(common_steps, configuration, baseline, max(1, len(others)))
        for configuration in others
    ]
    return sorted(
        found, key=lambda r: (np.isnan(r.pooled.value), r.pooled.value, r.configuration.solver)
    )


def _ratio(
    common_steps: CommonSteps,
    configuration: PooledConfiguration,
    baseline: PooledConfiguration,
    comparisons: int,
) -> Ratio:
    logs = np.log(configuration.time_ns / baseline.time_ns)
    by_sequence = [logs[common_steps.sequence_of == i] for i in range(len(common_steps.sequences))]
    common = [found[np.isfinite(found)] for found in by_sequence]
    return Ratio(
        configuration,
        pooled_mean(common, comparisons),
        tuple(float(np.exp(found.mean())) if len(found) else float("nan") for found in common),
        sum(map(len, common)),
    )
