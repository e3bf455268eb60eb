"""Percentiles, bootstrap intervals and paired ratios against known distributions."""

import numpy as np
import pytest

from dpbench.analysis.statistics import (
    BLOCK_STEPS,
    LEAST_BLOCKS,
    UNKNOWN,
    Interval,
    block_indices,
    enough,
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


# 20 steps of +1, 20 of −1, and both again. The sum of a block of 20 steps is 20 − 2s from step s of
# a period on, down to −20, and up again: its squares over the 40 starts are 134 on average.
SQUARE_WAVE = np.tile(np.repeat([1.0, -1.0], BLOCK_STEPS), 2)
ERROR_OF_SQUARE_WAVE = np.sqrt(4 * 134.0) / 80  # four independent blocks


def test_the_error_of_a_mean_by_hand() -> None:
    """Whole blocks, and a last one that is shorter; a constant adds nothing.

    Blocks of 4 of +1 +1 +1 −1 −1 −1: sums of 2, 0, −2, −2, 0, 2; the last of 2 steps has the same.
    """
    assert resampled_error(SQUARE_WAVE + 5.0, BLOCK_STEPS) == pytest.approx(ERROR_OF_SQUARE_WAVE)
    short = 3.0 + np.repeat([1.0, -1.0], 3)
    assert resampled_error(short, 4) == pytest.approx(np.sqrt(16 / 6 + 16 / 6) / 6)
    # One block cannot be longer than the sequence: each resample is the sequence, turned round.
    assert resampled_error(short, 100) == pytest.approx(0.0, abs=1e-15)
    # Blocks of one step: the standard error of independent steps.
    assert resampled_error(short, 0) == resampled_error(short, 1) == pytest.approx(1 / np.sqrt(6))


def test_a_pooled_mean_by_hand() -> None:
    """Two sequences weigh the same, whatever their length; their errors add up in squares.

    0.03 and 0.04 times the same wave give 0.05 times its error, halved by the mean of two; 1.95996
    of those make 95 %.
    """
    logs = [0.1 + 0.03 * SQUARE_WAVE, 0.3 + 0.04 * SQUARE_WAVE]
    reach = 1.959963984540054 * 0.05 * ERROR_OF_SQUARE_WAVE / 2
    found = pooled_mean(logs)
    expected = np.exp([0.2, 0.2 - reach, 0.2 + reach])
    np.testing.assert_allclose([found.value, found.low, found.high], expected, rtol=1e-12)
    # Twice as long at the same spread of a block: 1/√2 of the error.
    longer = pooled_mean([np.tile(0.3 + SQUARE_WAVE, 2)])
    assert np.log(longer.high / longer.value) == pytest.approx(
        1.959963984540054 * ERROR_OF_SQUARE_WAVE / np.sqrt(2)
    )


def test_a_pooled_mean_is_unknown_without_steps() -> None:
    """No sequences, or one without steps, give no estimate; one that is short gives no interval."""
    assert pooled_mean([]) is UNKNOWN
    assert pooled_mean([SQUARE_WAVE, np.empty(0)]) is UNKNOWN
    found = pooled_mean([np.zeros(80), np.full(79, 2.0)])
    assert found == Interval(np.exp(1.0), 0.0, np.inf)


def test_eighty_steps_are_enough_for_an_interval() -> None:
    """Four blocks of 20 steps; `enough` counts blocks of another length too."""
    assert enough(80) and not enough(79)
    assert enough(12, block=3) and not enough(11, block=3)


def test_an_interval_holds_its_ends() -> None:
    """Both ends belong to the interval, and nothing beyond them."""
    interval = Interval(2.0, 1.0, 3.0)
    assert interval.spans(1.0) and interval.spans(3.0)
    assert not interval.spans(0.999) and not interval.spans(3.001)


def test_drawn_blocks_are_consecutive_and_circular() -> None:
    """Seven steps in blocks of three: two whole blocks and one step of a third; every step starts
    a block as often as any other."""
    drawn = block_indices(7, 3, 2000, 1)
    assert drawn.shape == (2000, 7)
    for first in (0, 3):
        np.testing.assert_array_equal(drawn[:, first + 1], (drawn[:, first] + 1) % 7)
        np.testing.assert_array_equal(drawn[:, first + 2], (drawn[:, first] + 2) % 7)
    # 2000 draws of 7 steps: 286 each, with a standard deviation of 16.
    for first in (0, 3, 6):
        assert np.abs(np.bincount(drawn[:, first], minlength=7) - 2000 / 7).max() < 5 * 16
    # The third block has no say in the first two.
    assert np.unique((drawn[:, 6] - drawn[:, 3]) % 7).size == 7
    # A block is no longer than the sequence.
    np.testing.assert_array_equal(block_indices(3, 50, 5, 1), block_indices(3, 3, 5, 1))


def test_an_interval_is_as_wide_as_the_error_of_the_mean() -> None:
    """The bootstrap interval of a ratio spans 1.96 errors to both sides, as the sum of 4 blocks is
    nearly normal; 2000 resamples tell its ends to 5 %."""
    found = paired_ratio(np.exp(0.1 + 0.01 * np.tile(SQUARE_WAVE, 10)), np.ones(800))
    reach = 1.96 * 0.01 * ERROR_OF_SQUARE_WAVE / np.sqrt(10)
    assert np.log(found.value) == pytest.approx(0.1)
    assert np.log(found.value / found.low) == pytest.approx(reach, rel=0.1)
    assert np.log(found.high / found.value) == pytest.approx(reach, rel=0.1)


def test_a_block_has_one_step_at_least() -> None:
    """No block is shorter; steps drawn one by one are the ordinary bootstrap."""
    np.testing.assert_array_equal(block_indices(7, 0, 5, 1), block_indices(7, 1, 5, 1))
    values = np.arange(7.0)
    np.testing.assert_array_equal(
        resampled_means(values, 0, 5, 1), resampled_means(values, 1, 5, 1)
    )
    assert np.unique(np.diff(block_indices(7, 1, 50, 1), axis=1) % 7).size == 7


def test_a_ratio_is_resampled_two_thousand_times() -> None:
    """Its ends are those of 2000 resamples where no number is given, and of another number else."""
    times = np.random.default_rng(8).uniform(1.0, 2.0, (2, 100))
    found = paired_ratio(*times)
    assert found == paired_ratio(*times, resamples=2000)
    assert found != paired_ratio(*times, resamples=1999)
