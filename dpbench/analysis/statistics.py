"""Statistics of step times: percentiles that refuse thin data, bootstrap intervals, paired ratios.

Steps follow each other in time and so do their active sets; resamples are therefore drawn in
blocks of consecutive steps (circular block bootstrap: Politis & Romano 1992), not step by step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtri

from dpbench.arrays import Floats, Indices
from dpbench.bench.judge.rules import supports

BLOCK_STEPS = 20
"""Length of a bootstrap block: 6 s of the ship, longer than the control horizon of 1.5 or 3 s."""
LEAST_BLOCKS = 4
"""With fewer blocks resamples hardly differ, and an interval would be too narrow, or a point."""
RESAMPLES = 500
TAILS = (0.025, 0.975)
"""Of an interval at 95 % confidence."""
SEED = 20_240_917


@dataclass(frozen=True)
class Interval:
    """An estimate with its bootstrap interval; from -inf, or 0, to inf without blocks enough."""

    value: float
    low: float
    high: float

    def spans(self, number: float) -> bool:
        """Whether the interval holds `number`; an undefined one holds every number."""
        return not (self.low > number or self.high < number)


UNKNOWN = Interval(np.nan, np.nan, np.nan)


def enough(steps: int, block: int = BLOCK_STEPS) -> bool:
    """Whether so many steps make blocks enough for an interval."""
    return steps >= LEAST_BLOCKS * block


def percentile_interval(
    values: Floats,
    percent: float,
    *,
    block: int = BLOCK_STEPS,
    resamples: int = RESAMPLES,
    seed: int = SEED,
) -> Interval:
    """A percentile over steps with its interval, unknown when the steps do not support it."""
    if not supports(len(values), percent):
        return UNKNOWN
    value = float(np.percentile(values, percent))
    if not enough(len(values), block):
        return Interval(value, 0.0, np.inf)
    draws = block_indices(len(values), block, resamples, seed)
    resampled = np.percentile(values[draws], percent, axis=1)
    low, high = np.quantile(resampled, TAILS)
    return Interval(value, float(low), float(high))


def paired_ratio(slower: Floats, faster: Floats, *, resamples: int = 4 * RESAMPLES) -> Interval:
    """Geometric mean over the same steps (K,) of slower/faster, with its interval."""
    if len(slower) == 0:
        return UNKNOWN
    logs = np.log(slower / faster)
    if not enough(len(logs)):
        return Interval(float(np.exp(logs.mean())), 0.0, np.inf)
    low, high = np.quantile(resampled_means(logs, BLOCK_STEPS, resamples, SEED), TAILS)
    return Interval(float(np.exp(logs.mean())), float(np.exp(low)), float(np.exp(high)))


def pooled_mean(logs: Sequence[Floats]) -> Interval:
    """exp of the mean over sequences of the mean log ratio, with its interval.

    `logs` are the log ratios of the steps of each; an empty one makes the mean unknown.
    """
    if not logs or not all(map(len, logs)):
        return UNKNOWN
    means = np.array([of_sequence.mean() for of_sequence in logs])
    middle = float(means.mean())
    if not all(enough(len(of_sequence)) for of_sequence in logs):
        return Interval(float(np.exp(middle)), 0.0, np.inf)
    errors = [resampled_error(of_sequence, BLOCK_STEPS) for of_sequence in logs]
    spread = float(np.linalg.norm(errors)) / len(logs)
    reach = -float(ndtri(TAILS[0])) * spread
    low, high = np.exp([middle - reach, middle + reach]).tolist()
    return Interval(float(np.exp(middle)), low, high)


def _block_starts(count: int, block: int, resamples: int, seed: int) -> Indices:
    """(resamples, blocks) first steps of as many blocks as cover `count` steps."""
    blocks = -(-count // block)
    return np.random.default_rng(seed).integers(0, count, size=(resamples, blocks))


@lru_cache(maxsize=4)
def block_indices(count: int, block: int, resamples: int, seed: int) -> Indices:
    """(resamples, count) indices in circular blocks of consecutive steps."""
    block = max(1, min(block, count))
    starts = _block_starts(count, block, resamples, seed)
    drawn = (starts[:, :, None] + np.arange(block)) % count
    return drawn.reshape(resamples, -1)[:, :count]


def resampled_means(values: Floats, block: int, resamples: int, seed: int) -> Floats:
    """(resamples,) means over the steps of `block_indices`, block by block from running sums."""
    count = len(values)
    block = max(1, min(block, count))
    starts = _block_starts(count, block, resamples, seed)
    lengths = np.full(starts.shape[1], block)
    lengths[-1] = count - block * (len(lengths) - 1)
    running = np.concatenate(([0.0], np.cumsum(np.concatenate((values, values[:block])))))
    means: Floats = (running[starts + lengths] - running[starts]).sum(axis=1) / count
    return means


def resampled_error(values: Floats, block: int) -> float:
    """Standard deviation of `resampled_means` over all draws there could be: blocks are drawn
    independently, so the variances of their sums add up."""
    count = len(values)
    block = max(1, min(block, count))
    blocks = -(-count // block)
    running = np.concatenate(([0.0], np.cumsum(np.concatenate((values, values[:block])))))
    whole, last = (
        float((running[length : length + count] - running[:count]).var())
        for length in (block, count - block * (blocks - 1))
    )
    return math.sqrt((blocks - 1) * whole + last) / count


def holm(p: Floats) -> Floats:
    """Adjusted p-values (Holm 1979, step-down Bonferroni): ≤ α together at family-wise α."""
    order = np.argsort(p, kind="stable")
    factors = np.arange(len(p), 0, -1)
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(factors * p[order]))
    return adjusted
