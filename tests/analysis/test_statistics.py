"""Percentiles, bootstrap intervals and paired ratios against known distributions."""

import numpy as np
import pytest

from dpbench.analysis.statistics import (
    BLOCK_STEPS,
    LEAST_BLOCKS,
    UNKNOWN,
    Interval,
    block_indices,
    paired_ratio,
    percentile_interval,
    pooled_mean,
    resampled_error,
    resampled_means,
)
from dpbench.bench.judge.rules import percentile, supports


@pytest.mark.parametrize(("percent", "enough"), [(50, 20), (95, 200), (99, 1000), (99.9, 10_000)])
def test_a_percentile_needs_ten_samples_beyond_it(percent: float, enough: int) -> None:
    """A percentile is refused with fewer than ten samples beyond it and given from there on."""
    assert supports(enough, percent)
    assert not supports(enough - 1, percent)
    assert np.isnan(percentile(np.ones(enough - 1), percent))
    assert percentile(np.ones(enough), percent) == 1.0


def test_interval_is_unknown_where_the_percentile_is_refused() -> None:
    """No interval is made up for a percentile that is not printed."""
    assert percentile_interval(np.ones(500), 99) is UNKNOWN


def test_interval_covers_a_known_median() -> None:
    """The 95 % interval of the median of independent samples covers the true one about as often.

    Over 200 draws the coverage of a perfect interval has a standard deviation of 1.5 %; block
    bootstraps with 20 blocks of 20 cover a little less, so 88 % is the floor.
    """
    rng = np.random.default_rng(1)
    covered = 0
    for draw in range(200):
        values = np.exp(rng.standard_normal(400))  # lognormal: the median is 1
        found = percentile_interval(values, 50, resamples=200, seed=draw)
        covered += found.spans(1.0)
    assert 0.88 * 200 <= covered <= 200


def test_blocks_widen_the_interval_of_correlated_steps() -> None:
    """Neighbouring steps that resemble each other carry less information, and it shows.

    With runs of 20 equal values the interval is √20 times wider; a factor of 2 is asked for.
    """
    values = np.repeat(np.random.default_rng(2).standard_normal(50), 20)
    blocks = percentile_interval(values, 50, block=20)
    single = percentile_interval(values, 50, block=1)
    assert blocks.high - blocks.low > 2 * (single.high - single.low)


def test_a_constant_ratio_is_found_exactly() -> None:
    """Two solvers whose times differ by a factor on every step differ by exactly that factor.

    Tolerance: rounding of a mean of logarithms.
    """
    times = np.random.default_rng(3).uniform(1.0, 100.0, 500)
    found = paired_ratio(1.25 * times, times)
    np.testing.assert_allclose([found.value, found.low, found.high], 1.25, rtol=1e-12)


def test_pairing_removes_what_both_share() -> None:
    """A difference of 1 % shows through steps that differ by a factor of 100 among themselves."""
    rng = np.random.default_rng(4)
    shared = 10.0 ** rng.uniform(0, 2, 1000)
    noise = np.exp(0.01 * rng.standard_normal((2, 1000)))
    found = paired_ratio(1.01 * shared * noise[0], shared * noise[1])
    assert not found.spans(1.0)
    assert found.spans(1.01)


def test_an_unknown_interval_decides_nothing() -> None:
    """Where nothing is known nothing is told apart."""
    assert UNKNOWN.spans(1.0)
    assert not Interval(2.0, 1.5, 2.5).spans(1.0)
    assert paired_ratio(np.empty(0), np.empty(0)) is UNKNOWN


@pytest.mark.parametrize("count", [1, 7, 20, 50, 1000])
def test_means_from_running_sums_are_those_of_the_drawn_steps(count: int) -> None:
    """The interval of a ratio draws the same blocks of steps as that of a percentile.

    A running sum of a thousand terms of order one is exact to 1e-12.
    """
    values = np.random.default_rng(3).standard_normal(count)
    drawn = values[block_indices(count, 20, 40, 5)]
    np.testing.assert_allclose(
        resampled_means(values, 20, 40, 5), drawn.mean(axis=1), rtol=0, atol=1e-12
    )


def test_a_few_blocks_of_steps_give_no_interval() -> None:
    """Of one block every resample is the whole sequence, which would be an interval of no width.

    The estimate stands; the interval that says nothing holds every number.
    """
    few = LEAST_BLOCKS * BLOCK_STEPS - 1
    times = np.random.default_rng(6).uniform(1.0, 2.0, few)
    middle = float(np.median(times))
    assert percentile_interval(times, 50) == Interval(middle, 0.0, np.inf)
    assert percentile_interval(times, 99) is UNKNOWN
    for found in (paired_ratio(2.0 * times, times), pooled_mean([np.full(few, np.log(2.0))])):
        assert found.value == pytest.approx(2.0)
        assert (found.low, found.high) == (0.0, np.inf)
        assert found.spans(1.0) and found.spans(1e9)


def test_the_least_blocks_give_an_interval_that_often_holds() -> None:
    """Of 300 draws of as few steps as give one, the 95 % interval holds the truth in 80 % or more.

    With four blocks it is too narrow, as every bootstrap is of so few; at 80 % it is of some use.
    """
    rng, held = np.random.default_rng(7), 0
    for _ in range(300):
        times = np.exp(0.2 * rng.standard_normal((2, LEAST_BLOCKS * BLOCK_STEPS)))
        held += paired_ratio(times[0], times[1], resamples=200).spans(1.0)
    assert 240 <= held < 300


@pytest.mark.parametrize("steps", [80, 97, 1000])
def test_the_error_of_a_mean_is_that_of_its_resamples(steps: int) -> None:
    """Of correlated values; 20000 resamples tell their own spread to half a percent."""
    rng = np.random.default_rng(5)
    values = np.cumsum(rng.standard_normal(steps)) / 10.0
    drawn = resampled_means(values, BLOCK_STEPS, 20_000, 3).std()
    assert resampled_error(values, BLOCK_STEPS) == pytest.approx(drawn, rel=0.03)
