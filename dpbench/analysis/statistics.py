"""Statistics of means, percentiles and paired ratios: estimates with 95 % intervals.

Step times follow the weather for tens of seconds: the ratio of two solvers has autocorrelations of
0.5 to 0.8 over 20 steps. An interval therefore comes from the means of a few long consecutive parts
of a sequence and Student's t, not from single steps. `benchmarks/coverage.py` measures how often
each interval holds the truth.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtr, stdtrit
from scipy.stats import beta

from dpbench.arrays import Floats
from dpbench.bench.judge.rules import has_enough_samples_for_percentile

PARTS = 5
"""Consecutive parts of a sequence whose means give the error of its mean."""
LEAST_STEPS = 500
"""Least number of steps for which an interval is stated: parts of fewer than 100 steps resemble
their neighbours."""
LARGEST_CORRELATION = 0.9
"""Largest correlation of neighbouring parts that an interval is widened for."""
LEAST_VARIANCE = 0.25
"""Least variance of a share over parts, in variances of independent steps: less is chance."""
SKEW_SHARE = 1.5
"""Factor on the skewness found: few values show too little of it."""
MARKED_WIDENING = 1.5
"""Width over that of Student's interval from which an interval is marked as widened: below it, a
fifth of the intervals of 10 symmetric values would be."""
LEAST_SKEW_DF = 2.5
"""Least degrees of freedom with which skewness is estimated."""
TAILS = (0.025, 0.975)
"""Tail probabilities of an interval at 95 % confidence."""


@dataclass(frozen=True)
class Interval:
    """Estimate with its 95 % confidence interval, infinitely wide where none is supported."""

    value: float
    low: float
    high: float

    def contains(self, number: float) -> bool:
        """Return whether the interval contains `number`; an undefined one contains every number."""
        return not (self.low > number or self.high < number)

    def is_within_spread(self, spread: float) -> bool:
        """Return whether an interval of a ratio overlaps 1/spread to spread."""
        return self.low <= spread and self.high >= 1.0 / spread


UNKNOWN = Interval(np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class MeanEstimate:
    """Mean of a sample with its standard error, degrees of freedom and skewness.

    Intervals and p-values are Student's, widened on the long side of a skewed estimate by Hall's
    transformation (1992, J. R. Stat. Soc. B 54, 221-228), and never narrowed by it.

    value, error : the mean and its standard error, 0 without spread and NaN if unknown; df : its
        degrees of freedom; skew : skewness of the estimate.
    """

    value: float
    error: float = math.nan
    df: float = 0.0
    skew: float = 0.0

    @property
    def has_error_estimate(self) -> bool:
        """True if the mean has a positive standard error and a degree of freedom."""
        return self.error > 0.0 and self.df >= 1.0

    @property
    def confidence_interval(self) -> Interval:
        """The mean with its 95 % confidence interval: Student's t, corrected for skewness."""
        if not self.has_error_estimate:
            return Interval(self.value, -math.inf, math.inf)
        quantile = float(stdtrit(self.df, TAILS[1]))
        below = max(quantile, self._invert_correction_for_skewness(quantile))
        above = max(quantile, -self._invert_correction_for_skewness(-quantile))
        return Interval(
            self.value, self.value - self.error * below, self.value + self.error * above
        )

    @property
    def widening(self) -> float:
        """Width of the interval over that of Student's, 1 or more; NaN without an interval."""
        if not self.has_error_estimate:
            return math.nan
        interval = self.confidence_interval
        students = 2.0 * self.error * float(stdtrit(self.df, TAILS[1]))
        return max(1.0, (interval.high - interval.low) / students)

    @property
    def is_clearly_widened(self) -> bool:
        """True if skewness widens the interval so much that it is marked."""
        return self.widening >= MARKED_WIDENING

    def compute_p_value_of_mean_above(self, bound: float) -> float:
        """Return the one-sided p-value of "the mean is larger than `bound`"; 1 if unsupported."""
        if not self.has_error_estimate:
            return 1.0
        distance = (self.value - bound) / self.error
        return float(
            max(stdtr(self.df, -distance), stdtr(self.df, -self._correct_t_for_skewness(distance)))
        )

    def compute_p_value_of_mean_below(self, bound: float) -> float:
        """Return the one-sided p-value of "the mean is smaller than `bound`"; 1 if unsupported."""
        return MeanEstimate(
            -self.value, self.error, self.df, -self.skew
        ).compute_p_value_of_mean_above(-bound)

    def compute_p_value_of_mean_beyond(self, bound: float) -> float:
        """Return the two-sided p-value of "the mean is farther than `bound` from 0"."""
        above = self.compute_p_value_of_mean_above(bound)
        return min(1.0, 2.0 * min(above, self.compute_p_value_of_mean_below(-bound)))

    def _correct_t_for_skewness(self, statistic: float) -> float:
        """Return a t statistic corrected for skewness by Hall's cubic transformation."""
        skew = SKEW_SHARE * self.skew
        return statistic + skew * statistic**2 / 3 + skew**2 * statistic**3 / 27 + skew / 6

    def _invert_correction_for_skewness(self, quantile: float) -> float:
        """Return the t statistic whose correction for skewness is this quantile."""
        skew = SKEW_SHARE * self.skew
        if abs(skew) < 1e-9:
            return quantile
        return 3.0 / skew * (math.cbrt(1.0 + skew * (quantile - skew / 6)) - 1.0)


def adjust_p_values_by_holm(p: Floats) -> Floats:
    """Return p-values adjusted for multiple tests by Holm's step-down Bonferroni method (1979)."""
    order = np.argsort(p, kind="stable")
    factors = np.arange(len(p), 0, -1)
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(factors * p[order]))
    return adjusted


def bound_probability_after_no_event(count: float) -> float:
    """Return the 95 % upper bound of a probability after `count` trials without an event.

    The rule of three (Hanley & Lippman-Hand 1983).
    """
    return min(1.0, 3.0 / count) if count > 0 else 1.0


def is_long_enough_for_interval(steps: int) -> bool:
    """Return whether a number of consecutive steps suffices for a confidence interval."""
    return steps >= LEAST_STEPS


def estimate_mean_of_series(values: Floats) -> MeanEstimate:
    """Return the mean of a series (K,), with its error from the means of consecutive parts.

    Parts that follow each other resemble each other: the error is widened by their correlation as
    for a first-order autoregression, after adding what so few parts underestimate.
    """
    mean, size = float(values.mean()), float(np.abs(values).max())
    if not is_long_enough_for_interval(len(values)):
        return MeanEstimate(mean)
    away = np.array([part.mean() for part in np.array_split(values, PARTS)]) - mean
    squares = float(away @ away)
    if math.sqrt(squares) <= 1e-12 * size:  # nothing but rounding
        return MeanEstimate(mean, 0.0, PARTS - 1)
    correlation = float(away[1:] @ away[:-1]) / squares + 2.0 / PARTS
    correlation = min(max(correlation, 0.0), LARGEST_CORRELATION)
    variance = squares / (PARTS - 1) / PARTS * (1.0 + correlation) / (1.0 - correlation)
    return MeanEstimate(mean, math.sqrt(variance), PARTS - 1)


def estimate_percentile_interval(values: Floats, percent: float) -> Interval:
    """Return a percentile of step times with its 95 % interval; NaN for too few steps.

    The share of steps beyond the percentile has an error from `PARTS` parts; as many independent
    steps as have that error give the interval of the share (Clopper & Pearson 1934), and its ends
    are percentiles again (Woodruff 1952).
    """
    steps, share = len(values), 1.0 - percent / 100.0
    if not has_enough_samples_for_percentile(steps, percent):
        return UNKNOWN
    value = float(np.percentile(values, percent))
    if not is_long_enough_for_interval(steps):
        return Interval(value, 0.0, np.inf)
    found = estimate_mean_of_series((values > value).astype(np.float64))
    widened = found.error * float(stdtrit(found.df, TAILS[1]) / ndtri(TAILS[1]))
    effect = max(LEAST_VARIANCE, widened**2 * steps / (share * (1.0 - share)))
    alone = steps / effect
    beyond = share * alone
    least = float(beta.ppf(TAILS[0], beyond, alone - beyond + 1.0))
    most = float(beta.ppf(TAILS[1], beyond + 1.0, alone - beyond))
    ordered = np.sort(values)
    low, high = math.floor((1.0 - most) * steps), math.ceil((1.0 - least) * steps)
    return Interval(
        value,
        float(ordered[low - 1]) if low > 0 else 0.0,
        float(ordered[high - 1]) if high < steps else np.inf,
    )


def select_long_series(logs: Sequence[Floats]) -> list[Floats]:
    """Return the step series long enough for a confidence interval; all if none is."""
    return [one for one in logs if is_long_enough_for_interval(len(one))] or list(logs)


def estimate_paired_time_ratio(slower: Floats, faster: Floats) -> Interval:
    """Return the geometric mean ratio of two step time arrays (K,) with its 95 % interval."""
    return estimate_pooled_ratio([np.log(slower / faster)])


def estimate_pooled_ratio(logs: Sequence[Floats]) -> Interval:
    """Return the geometric mean of time ratios over sequences, from logs, with 95 % interval.

    logs : by sequence, the log ratios of its steps; only long sequences count where there are any,
        and an empty one makes the mean unknown.
    """
    if not logs or not all(map(len, logs)):
        return UNKNOWN
    means = [estimate_mean_of_series(one) for one in select_long_series(logs)]
    errors = np.array([one.error for one in means])
    fourth = float((errors**4 / np.array([max(1.0, one.df) for one in means])).sum())
    pooled = MeanEstimate(
        float(np.mean([one.value for one in means])),
        float(np.linalg.norm(errors)) / len(means),
        float((errors**2).sum()) ** 2 / fourth if fourth > 0.0 else 0.0,
    ).confidence_interval
    return Interval(*np.exp([pooled.value, pooled.low, pooled.high]).tolist())


def bootstrap_error_of_mean(values: Floats, block: int) -> float:
    """Return the standard error of a mean by bootstrap over blocks of consecutive steps.

    Blocks are drawn independently (Politis & Romano 1992), so the variances of their sums add up.
    """
    count = len(values)
    block = max(1, min(block, count))
    blocks = -(-count // block)
    running = np.concatenate(([0.0], np.cumsum(np.concatenate((values, values[:block])))))
    whole, last = (
        float((running[length : length + count] - running[:count]).var())
        for length in (block, count - block * (blocks - 1))
    )
    return math.sqrt((blocks - 1) * whole + last) / count
