"""Percentiles, intervals and paired ratios against known distributions and numbers by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from dpbench.analysis.statistics import (
    LEAST_STEPS,
    PARTS,
    UNKNOWN,
    Interval,
    MeanEstimate,
    adjust_p_values_by_holm,
    bootstrap_error_of_mean,
    bound_probability_after_no_event,
    estimate_mean_of_series,
    estimate_paired_time_ratio,
    estimate_percentile_interval,
    estimate_pooled_ratio,
)
from dpbench.bench.judge.rules import has_enough_samples_for_percentile, percentile_or_nan


@pytest.mark.parametrize(("percent", "enough"), [(50, 20), (95, 200), (99, 1000), (99.9, 10_000)])
def test_a_percentile_needs_ten_samples_beyond_it(percent: float, enough: int) -> None:
    assert has_enough_samples_for_percentile(enough, percent)
    assert not has_enough_samples_for_percentile(enough - 1, percent)
    assert np.isnan(percentile_or_nan(np.ones(enough - 1), percent))
    assert percentile_or_nan(np.ones(enough), percent) == 1.0


def test_interval_is_unknown_where_the_percentile_is_refused() -> None:
    assert estimate_percentile_interval(np.ones(500), 99) is UNKNOWN


def _autoregression(correlation: float, steps: int, rng: np.random.Generator) -> np.ndarray:
    """Steps of a stationary first-order autoregression with variance 1."""
    values = np.empty(steps)
    values[0] = rng.standard_normal()
    noise = math.sqrt(1.0 - correlation**2) * rng.standard_normal(steps)
    for k in range(1, steps):
        values[k] = correlation * values[k - 1] + noise[k]
    return values


@pytest.mark.parametrize("correlation", [0.0, 0.97])
def test_intervals_of_correlated_steps_hold_the_truth(correlation: float) -> None:
    """At least 90 % of the intervals of a mean and of a median hold the truth, in 200 draws.

    A coverage of 95 % has a standard deviation of 1.5 % over 200 draws. Blocks of 20 steps gave
    65 % at a correlation of 0.97, which two solvers show from step to step.
    """
    rng, held = np.random.default_rng(1), np.zeros(2)
    for _ in range(200):
        times = np.exp(0.2 * _autoregression(correlation, 1000, rng))
        found = (
            estimate_paired_time_ratio(times, np.ones(1000)),
            estimate_percentile_interval(times, 50),
        )
        held += [interval.contains(1.0) for interval in found]
    assert (held >= 180).all()


def test_an_interval_worked_by_hand() -> None:
    """Part means 1, 3, 1, 3, 2 about 2: squares 4, lag products -1 -1 -1 + 0 = -3, correlation
    -0.75 + 0.4 < 0, so nothing widens sqrt(4 / 4 / 5); t of 4 degrees of freedom is 2.776."""
    values = np.repeat([1.0, 3.0, 1.0, 3.0, 2.0], LEAST_STEPS // PARTS)
    found = estimate_mean_of_series(values)
    assert (found.value, found.error, found.df) == pytest.approx((2.0, math.sqrt(0.2), 4.0))
    assert found.confidence_interval.high == pytest.approx(
        2.0 + 2.776445 * math.sqrt(0.2), rel=1e-6
    )


def test_parts_that_resemble_their_neighbours_widen_an_interval() -> None:
    """Part means 0, 1, 2, 3, 4 about 2: squares 10, lag products 2 + 0 + 0 + 2 = 4, correlation 0.4
    + 0.4, which widens sqrt(10 / 4 / 5) by sqrt(1.8 / 0.2) = 3."""
    found = estimate_mean_of_series(np.repeat(np.arange(5.0), LEAST_STEPS // PARTS))
    assert found.error == pytest.approx(3.0 * math.sqrt(0.5))


def test_a_constant_ratio_is_found_exactly_and_has_no_interval() -> None:
    """Two solvers whose times differ by a factor on every step differ by exactly that factor.

    Without any spread there is nothing to take an error from.
    """
    times = np.random.default_rng(3).uniform(1.0, 100.0, 500)
    found = estimate_paired_time_ratio(1.25 * times, times)
    assert found.value == pytest.approx(1.25, rel=1e-12)
    assert (found.low, found.high) == (0.0, np.inf)


def test_pairing_removes_what_both_share() -> None:
    """A difference of 1 % shows through steps that differ by a factor of 100 among themselves."""
    rng = np.random.default_rng(4)
    shared = 10.0 ** rng.uniform(0, 2, 1000)
    noise = np.exp(0.01 * rng.standard_normal((2, 1000)))
    found = estimate_paired_time_ratio(1.01 * shared * noise[0], shared * noise[1])
    assert not found.contains(1.0)
    assert found.contains(1.01)


def test_few_steps_give_no_interval() -> None:
    times = np.random.default_rng(6).uniform(1.0, 2.0, LEAST_STEPS - 1)
    middle = float(np.median(times))
    assert estimate_percentile_interval(times, 50) == Interval(middle, 0.0, np.inf)
    assert estimate_percentile_interval(times, 99) is UNKNOWN
    found = estimate_paired_time_ratio(2.0 * times, np.ones(LEAST_STEPS - 1))
    assert (found.low, found.high) == (0.0, np.inf)
    assert found.contains(1.0) and found.contains(1e9)


def test_short_sequences_do_not_cost_a_long_one_its_interval() -> None:
    """A window of 100 steps is left out of a mean that has a sequence of 1000 beside it."""
    rng = np.random.default_rng(8)
    long, short = rng.normal(0.5, 0.1, 1000), rng.normal(3.0, 0.1, 100)
    assert estimate_pooled_ratio([long, short]) == estimate_pooled_ratio([long])
    assert estimate_pooled_ratio([short]).value == pytest.approx(math.exp(3.0), rel=0.05)


@pytest.mark.parametrize("steps", [80, 97, pytest.param(1000, marks=pytest.mark.slow)])
def test_the_error_of_a_mean_over_blocks_is_that_of_its_resamples(steps: int) -> None:
    """The values are correlated; 20000 resamples tell their own spread to half a percent."""
    rng = np.random.default_rng(5)
    values = np.cumsum(rng.standard_normal(steps)) / 10.0
    starts = rng.integers(0, steps, size=(20_000, -(-steps // 20)))
    drawn = ((starts[:, :, None] + np.arange(20)) % steps).reshape(20_000, -1)[:, :steps]
    means = np.array([values[rows].mean() for rows in drawn])
    assert bootstrap_error_of_mean(values, 20) == pytest.approx(means.std(), rel=0.03)


@given(st.floats(-5, 5), st.floats(0.01, 3), st.floats(1, 60))
def test_without_skewness_it_is_the_t_interval(value: float, error: float, df: float) -> None:
    found = MeanEstimate(value, error, df)
    low, high = stats.t.interval(0.95, df, value, error)
    assert (found.confidence_interval.low, found.confidence_interval.high) == pytest.approx(
        (low, high), rel=1e-9
    )
    assert found.compute_p_value_of_mean_above(0.0) == pytest.approx(
        stats.t.sf(value / error, df), rel=1e-6, abs=1e-12
    )


@given(st.floats(0.05, 3), st.floats(2, 60), st.floats(-3, 3))
def test_an_interval_ends_at_a_p_value_of_one_in_forty(
    error: float, df: float, skew: float
) -> None:
    found = MeanEstimate(1.0, error, df, skew)
    symmetric = MeanEstimate(1.0, error, df).confidence_interval
    interval = found.confidence_interval
    assert found.compute_p_value_of_mean_above(interval.low) == pytest.approx(0.025, rel=1e-6)
    assert found.compute_p_value_of_mean_below(interval.high) == pytest.approx(0.025, rel=1e-6)
    assert interval.low <= symmetric.low + 1e-9 and interval.high >= symmetric.high - 1e-9


def test_nothing_is_claimed_of_a_mean_without_an_error() -> None:
    """No spread, an unknown one and too few degrees of freedom: no interval, p-values of 1."""
    for found in (MeanEstimate(3.0, 0.0, 9.0), MeanEstimate(3.0), MeanEstimate(3.0, 1e-9, 0.5)):
        assert (found.confidence_interval.low, found.confidence_interval.high) == (-np.inf, np.inf)
        assert (
            found.compute_p_value_of_mean_above(0.0)
            == found.compute_p_value_of_mean_below(9.0)
            == found.compute_p_value_of_mean_beyond(0.0)
            == 1.0
        )


@pytest.mark.parametrize(
    ("number", "inside"), [(0.999, False), (1.0, True), (3.0, True), (3.001, False)]
)
def test_an_interval_holds_its_ends(number: float, inside: bool) -> None:
    assert Interval(2.0, 1.0, 3.0).contains(number) is inside
    assert (
        UNKNOWN.contains(number)
        and estimate_pooled_ratio([np.empty(0)]) is estimate_pooled_ratio([]) is UNKNOWN
    )


def test_one_degree_of_freedom_is_enough() -> None:
    """The quantile of Student's t with one degree of freedom is tan(0.475 π) = 12.7."""
    reach = 2.0 * math.tan(0.475 * math.pi)
    interval = MeanEstimate(3.0, 2.0, 1.0).confidence_interval
    assert (interval.low, interval.high) == pytest.approx((3.0 - reach, 3.0 + reach))
    assert MeanEstimate(3.0, 2.0, 0.999).confidence_interval.low == -math.inf


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_skewed_mean_by_hand(sign: float) -> None:
    """A skewness of -2/3 counts as -1: 3 becomes 3 - 3 + 1 - 1/6 = 5/6, with p of a Cauchy tail."""
    found = MeanEstimate(3.0 * sign, 1.0, 1.0, -2.0 / 3.0 * sign)
    p = (
        found.compute_p_value_of_mean_above(0.0)
        if sign > 0
        else found.compute_p_value_of_mean_below(0.0)
    )
    assert p == pytest.approx(0.5 - math.atan(5.0 / 6.0) / math.pi)


def test_the_interval_of_a_skewed_mean_by_hand() -> None:
    """With q = 1.96 and a skewness that counts as 1 the upper end is 3 (1 + (q - 5/6)^(1/3)) away.

    The lower end, 3 ((q + 5/6)^(1/3) - 1) = 1.22 away, would be nearer than q and stays there.
    """
    quantile = 1.959963985
    interval = MeanEstimate(5.0, 2.0, 1e12, 2.0 / 3.0).confidence_interval
    assert interval.high == pytest.approx(5.0 + 6.0 * (1.0 + math.cbrt(quantile - 5.0 / 6.0)))
    assert interval.low == pytest.approx(5.0 - 2.0 * quantile)


@pytest.mark.parametrize(
    ("value", "bound", "p"),
    [(3.0, 2.0, 0.5), (-3.0, 2.0, 0.5), (0.0, 1.0, 1.0), (3.0, 0.0, 0.2048328)],
)
def test_a_mean_beyond_a_bound_on_either_side(value: float, bound: float, p: float) -> None:
    """One error beyond the bound is a Cauchy tail of 1/4, twice that for both sides."""
    assert MeanEstimate(value, 1.0, 1.0).compute_p_value_of_mean_beyond(bound) == pytest.approx(p)


def test_adjusted_p_values_rise_in_their_order_up_to_one() -> None:
    """0.01 * 4, then 0.2 * 3 = 0.6, 0.25 * 2 = 0.5 that stays at 0.6, and 0.9."""
    assert adjust_p_values_by_holm(np.array([0.25, 0.9, 0.01, 0.2])) == pytest.approx(
        [0.6, 0.9, 0.04, 0.6]
    )
    assert adjust_p_values_by_holm(np.array([0.7, 0.6])).tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("count", "share"), [(0, 1.0), (0.5, 1.0), (3, 1.0), (4, 0.75), (30, 0.1)])
def test_the_rule_of_three(count: float, share: float) -> None:
    assert bound_probability_after_no_event(count) == share


def _in_turn(parts: int, each: int) -> np.ndarray:
    """0, 1, 2, ... in an order that takes one of each part of the range in turn."""
    return np.arange(float(parts * each)).reshape(parts, each).T.ravel()


@pytest.mark.parametrize(
    ("percent", "value", "low", "high"), [(50, 499.5, 483.0, 515.0), (90, 899.1, 889.0, 909.0)]
)
def test_percentiles_of_even_parts(percent: float, value: float, low: float, high: float) -> None:
    """Equal shares in all parts count as 4000 independent steps for 1000.

    The shares of 2000 and of 400 in 4000 lie within 0.4844 and 0.5156, and within 0.0909 and
    0.1097: 1000 times the rest is rounded outwards and gives the steps in order, counted from one.
    """
    found = estimate_percentile_interval(_in_turn(10, 100), percent)
    assert (found.value, found.low, found.high) == pytest.approx((value, low, high))


def test_the_interval_of_a_median_of_uneven_parts() -> None:
    """Shares of 0.6, 0.4, 0.6, 0.4 and 0.5 have a variance of 0.04 / 4 / 5 = 0.002.

    Widened by (2.776 / 1.960)^2 it is that of 0.25 / 0.00401 = 62.3 steps. The share of 31.1 in
    62.3 lies within 0.3706 and 0.6294 (Clopper and Pearson).
    """
    below, above = iter(range(250)), iter(range(250, 500))
    values = [
        float(next(above if k < beyond else below))
        for beyond in (60, 40, 60, 40, 50)
        for k in range(100)
    ]
    found = estimate_percentile_interval(np.array(values), 50)
    assert (found.value, found.low, found.high) == (249.5, 184.0, 314.0)


@pytest.mark.parametrize("percent", [2, 98])
def test_an_extreme_percentile_has_one_end(percent: float) -> None:
    """All ten extreme steps of 500 in one part: their share may be next to nothing."""
    found = estimate_percentile_interval(np.arange(500.0), percent)
    if percent == 98:
        assert math.isinf(found.high) and 0.0 < found.low < found.value
    else:
        assert found.low == 0.0 and found.value < found.high < 500.0


def test_a_pooled_mean_by_hand() -> None:
    """Means 2 and 3 with errors sqrt(0.2) and 4 degrees of freedom each.

    The pooled error is sqrt(0.4) / 2 with 0.4^2 / (2 * 0.2^2 / 4) = 8 degrees of freedom, of which
    the quantile is 2.306.
    """
    parts = np.array([1.0, 3.0, 1.0, 3.0, 2.0])
    found = estimate_pooled_ratio([np.repeat(parts, 100), np.repeat(parts + 1.0, 100)])
    reach = 2.306004135 * math.sqrt(0.4) / 2.0
    expected = (math.exp(2.5), math.exp(2.5 - reach), math.exp(2.5 + reach))
    assert (found.value, found.low, found.high) == pytest.approx(expected)


def test_two_of_three_sequences_without_spread_leave_an_interval() -> None:
    """An error of 3 sqrt(0.2) / 3 with the 4 degrees of freedom of its only sequence."""
    parts = 3.0 * np.array([1.0, 3.0, 1.0, 3.0, 2.0])
    found = estimate_pooled_ratio([np.zeros(500), np.repeat(parts, 100), np.zeros(500)])
    assert found.value == pytest.approx(math.exp(2.0))
    assert found.high == pytest.approx(math.exp(2.0 + 2.776445105 * math.sqrt(0.2)))


@pytest.mark.parametrize(
    ("values", "block", "error"),
    [
        ([0.0, 0.0, 3.0, 3.0], 2, 0.75),
        ([0.0, 0.0, 0.0, 0.0, 5.0], 2, 0.8),
        ([0.0, 0.0, 0.0, 0.0, 5.0], 0, math.sqrt(20.0) / 5.0),
        ([0.0, 0.0, 0.0, 0.0, 5.0], 1, math.sqrt(20.0) / 5.0),
        ([0.0, 0.0, 0.0, 0.0, 5.0], 5, 0.0),
        ([0.0, 0.0, 0.0, 0.0, 5.0], 9, 0.0),
    ],
)
def test_the_error_of_resampled_blocks(values: list[float], block: int, error: float) -> None:
    """Sums of two of 0, 0, 0, 0, 5 in a circle have a variance of 6, single values of 4.

    Two blocks of two and one of one: sqrt(2 * 6 + 4) / 5 = 0.8.
    """
    assert bootstrap_error_of_mean(np.array(values), block) == pytest.approx(error)


def test_a_mean_of_499_steps_has_no_error() -> None:
    """From 500 steps on a mean has an error."""
    values = np.repeat([1.0, 3.0, 1.0, 3.0, 2.0], 100)
    assert estimate_mean_of_series(values).error > 0.0
    assert math.isnan(estimate_mean_of_series(values[1:]).error)
    constant = estimate_mean_of_series(np.full(500, 2.0))
    assert (constant.value, constant.error, constant.df) == (2.0, 0.0, 4)
    for spread, error in ((0.5e-12, 0.0), (2e-12, pytest.approx(1e-12, rel=0.1))):
        assert (
            estimate_mean_of_series(np.repeat([1.0, 1.0 + spread] * 2 + [1.0], 100)).error == error
        )
