"""Paired step times against one baseline, with intervals that hold together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.analysis.statistics import Interval, pooled_mean
from dpbench.analysis.times.pooled import CommonSteps, PooledTimes


@dataclass(frozen=True)
class Ratio:
    """How many times as long a configuration takes as the baseline.

    Parameters
    ----------
    mean : geometric mean over the common steps, every sequence of equal weight, with its
        simultaneous interval; `per_sequence` the geometric mean in each, NaN without common steps.
    steps : how many steps both have done.
    """

    pooled: PooledTimes
    mean: Interval
    per_sequence: tuple[float, ...]
    steps: int

    @property
    def turns(self) -> bool:
        """Whether one sequence calls it faster and another slower than the baseline."""
        faster = any(ratio < 1.0 for ratio in self.per_sequence)
        return faster and any(ratio > 1.0 for ratio in self.per_sequence)


def ratios(common_steps: CommonSteps, baseline: PooledTimes) -> list[Ratio]:
    """All other configurations on common steps against the baseline, the fastest first, those
    without steps last.

    The intervals hold for all of them together with 95 % (Bonferroni). Quantiles so far out are
    beyond what resamples can show; the interval of the mean log ratio is therefore a normal one
    with the standard error of the block bootstrap, sequence by sequence.
    """
    others = [pooled for pooled in common_steps.pooled if pooled is not baseline]
    comparisons = max(1, len(others))
    return sorted(
        (_ratio(common_steps, pooled, baseline, comparisons) for pooled in others),
        key=lambda r: (np.isnan(r.mean.value), r.mean.value, r.pooled.configuration.solver),
    )


def _ratio(
    common_steps: CommonSteps, pooled: PooledTimes, baseline: PooledTimes, comparisons: int
) -> Ratio:
    logs = np.log(pooled.time_ns / baseline.time_ns)
    by_sequence = [logs[common_steps.sequence_of == i] for i in range(len(common_steps.sequences))]
    common = [of_sequence[np.isfinite(of_sequence)] for of_sequence in by_sequence]
    return Ratio(
        pooled,
        pooled_mean(common, comparisons),
        tuple(float(np.exp(part.mean())) if len(part) else np.nan for part in common),
        sum(map(len, common)),
    )
