"""Paired step times against one baseline, with intervals that hold together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.analysis.statistics import Interval, pooled_mean
from dpbench.analysis.times.pooled import Arm, Pool


@dataclass(frozen=True)
class Ratio:
    """How many times as long an arm takes as the baseline.

    Parameters
    ----------
    pooled : geometric mean over the common steps, every sequence of equal weight, with its
        simultaneous interval; `per_sequence` the geometric mean in each, NaN without common steps.
    steps : how many steps both have done.
    """

    arm: Arm
    pooled: Interval
    per_sequence: tuple[float, ...]
    steps: int

    @property
    def turns(self) -> bool:
        """Whether one sequence calls it faster and another slower than the baseline."""
        known = [ratio for ratio in self.per_sequence if ratio == ratio]
        return any(ratio > 1.0 for ratio in known) and any(ratio < 1.0 for ratio in known)


def baseline_of(pool: Pool, solver: str | None) -> Arm:
    """The arm that others are compared with.

    The fastest arm, by the geometric mean of its step times, among those of `solver` (of all where
    it is None or was not replayed) that meet the demand; among those that do not if there is none.
    """
    mine = [arm for arm in pool.arms if arm.solver == solver] or list(pool.arms)
    right = [arm for arm in mine if arm.right] or mine
    return min(right, key=lambda arm: _typical(arm, pool))


def _typical(arm: Arm, pool: Pool) -> float:
    """Mean logarithm of the step times; an arm that has not done every step comes last."""
    mean = float(pool.weights @ np.log(arm.time_ns))
    return mean if np.isfinite(mean) else float("inf")


def ratios(pool: Pool, baseline: Arm) -> list[Ratio]:
    """All other arms of a pool against the baseline, the fastest first, those without steps last.

    The intervals hold for all of them together with 95 % (Bonferroni). Quantiles so far out are
    beyond what resamples can show; the interval of the mean log ratio is therefore a normal one
    with the standard error of the block bootstrap, sequence by sequence.
    """
    others = [arm for arm in pool.arms if arm is not baseline]
    found = [_ratio(pool, arm, baseline, max(1, len(others))) for arm in others]
    return sorted(found, key=lambda r: (np.isnan(r.pooled.value), r.pooled.value, r.arm.solver))


def _ratio(pool: Pool, arm: Arm, baseline: Arm, comparisons: int) -> Ratio:
    logs = np.log(arm.time_ns / baseline.time_ns)
    by_sequence = [logs[pool.sequence_of == i] for i in range(len(pool.sequences))]
    common = [found[np.isfinite(found)] for found in by_sequence]
    return Ratio(
        arm,
        pooled_mean(common, comparisons),
        tuple(float(np.exp(found.mean())) if len(found) else float("nan") for found in common),
        sum(map(len, common)),
    )
