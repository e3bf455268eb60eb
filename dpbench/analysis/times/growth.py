"""How step times grow with the size of the problem: a power law fitted to medians over steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.statistics import (
    BLOCK_STEPS,
    CONFIDENCE,
    RESAMPLES,
    SEED,
    Floats,
    Interval,
    block_indices,
    enough,
)

LEAST_POINTS = 3
"""Two points lie on a line whatever the law is."""


@dataclass(frozen=True)
class Growth:
    """t = scale · n^exponent, least squares of log t on log n.

    Parameters
    ----------
    exponent : with its bootstrap interval over steps; log_scale : log of t [ns] at n = 1.
    n_low, n_high : the sizes between which it was fitted; points : how many of them.
    misfit : largest factor between a median and the line; near 1 where it is a power law.
    """

    exponent: Interval
    log_scale: float
    n_low: float
    n_high: float
    points: int
    misfit: float

    def time_ns(self, n: float) -> float:
        """The fitted time [ns] at size n."""
        return math.exp(self.log_scale + self.exponent.value * math.log(n))


def fit_growth(
    sizes: Sequence[int],
    times: Sequence[Floats],
    *,
    resamples: int = RESAMPLES,
    seed: int = SEED,
) -> Growth | None:
    """The growth of median times; None with fewer than `LEAST_POINTS` different sizes.

    Parameters
    ----------
    sizes : n; times : (K,) step times [ns] at each size, of the same K steps. The bootstrap draws
        the same steps at all sizes, because the sweep passes the same manoeuvre.
    """
    if len(set(sizes)) < LEAST_POINTS:
        return None
    x = np.log(np.array(sizes, dtype=np.float64))
    weights = (x - x.mean()) / ((x - x.mean()) ** 2).sum()
    middle = np.log([np.median(t) for t in times])
    slope = float(weights @ middle)
    off = middle - middle.mean() - slope * (x - x.mean())
    low, high = -np.inf, np.inf
    if enough(len(times[0])):
        slopes = weights @ _resampled_logs(times, resamples, seed)
        low, high = np.quantile(slopes, ((1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0))
    return Growth(
        exponent=Interval(slope, float(low), float(high)),
        log_scale=float(middle.mean() - slope * x.mean()),
        n_low=float(min(sizes)),
        n_high=float(max(sizes)),
        points=len(sizes),
        misfit=float(np.exp(np.abs(off).max())),
    )


def _resampled_logs(times: Sequence[Floats], resamples: int, seed: int) -> Floats:
    """(sizes, resamples) logarithms of the medians over resampled steps."""
    drawn = block_indices(len(times[0]), BLOCK_STEPS, resamples, seed)
    logs: Floats = np.log([np.median(t[drawn], axis=1) for t in times])
    return logs


@dataclass(frozen=True)
class Crossover:
    """Where the fitted line of one undercuts that of another, within the range both cover.

    Parameters
    ----------
    n : the size at which the two lines meet; NaN where they do not within the range.
    n_low, n_high : the range.
    faster_low, faster_high : whether the one is faster than the other at its ends.
    """

    n: float
    n_low: float
    n_high: float
    faster_low: bool
    faster_high: bool


def crossover(one: Growth | None, other: Growth | None) -> Crossover | None:
    """Where the line of `one` undercuts that of `other`; None without two lines over a common
    range."""
    if one is None or other is None:
        return None
    low, high = max(one.n_low, other.n_low), min(one.n_high, other.n_high)
    if low >= high:
        return None
    faster = [one.time_ns(n) < other.time_ns(n) for n in (low, high)]
    meets = math.nan
    if faster[0] != faster[1]:
        steeper = other.exponent.value - one.exponent.value
        meets = math.exp((one.log_scale - other.log_scale) / steeper)
    return Crossover(meets, low, high, *faster)
