"""The determinism audit on logs whose differences are known."""

import numpy as np
import pytest

from dpbench.bench.judge.replay import repeatability
from dpbench.bench.record.raw_log import RawLog, replay_layout

ONES = np.ones(2)


def _log(rounds: int = 3, steps: int = 4) -> RawLog:
    """A log of full rounds that are all alike."""
    log = RawLog.in_memory(replay_layout(rounds, steps, 2, 1))
    log.z[:] = np.arange(2.0 * steps).reshape(steps, 2)
    log.iterations[:] = np.arange(steps)
    log.done[:] = steps
    return log


def test_rounds_that_are_alike_are_identical() -> None:
    """The same bits in every round, NaN included."""
    log = _log()
    log.z[:, 2] = np.nan
    assert repeatability(log, ONES) == {
        "bit_identical_share": 1.0,
        "answer_spread_max": 0.0,
        "iterations_identical_share": 1.0,
        "iterations_spread": 0.0,
    }


def test_the_last_bit_counts_and_so_does_the_sign_of_zero() -> None:
    """One step off by one unit in the last place, another by the sign of its zero."""
    log = _log()
    log.z[2, 1, 0] = np.nextafter(2.0, 3.0)
    log.z[1, 0, 0] = -0.0
    found = repeatability(log, ONES)
    assert found["bit_identical_share"] == 0.5
    assert found["answer_spread_max"] == np.spacing(2.0)


def test_spreads_are_the_largest_and_in_scaled_units() -> None:
    """z apart by 3 of a unit that is 2 scaled ones; iterations from 3 to 9 at one step of four."""
    log = _log()
    log.z[2, 3, 1] += 3.0
    log.iterations[:, 3] = (5, 9, 3)
    found = repeatability(log, np.array([1.0, 2.0]))
    assert found["answer_spread_max"] == 1.5
    assert (found["iterations_identical_share"], found["iterations_spread"]) == (0.75, 6.0)


def test_an_answer_that_is_missing_once_is_not_the_same() -> None:
    """A number in one round and none in another: not the same bits, and no distance to measure."""
    log = _log()
    log.z[1, 0] = np.nan
    found = repeatability(log, ONES)
    assert (found["bit_identical_share"], found["answer_spread_max"]) == (0.75, 0.0)


def test_only_what_was_recorded_is_compared() -> None:
    """Rows behind the end of a shorter round hold nothing: no difference, no repetition."""
    log = _log(rounds=2)
    log.done[0] = 2
    log.z[0, 2:] = 99.0
    log.iterations[0, 2:] = 99
    assert repeatability(log, ONES)["bit_identical_share"] == 1.0
    assert repeatability(log, ONES)["iterations_spread"] == 0.0
    log.done[0] = 0
    assert all(np.isnan(value) for value in repeatability(log, ONES).values())


@pytest.mark.parametrize("counts", [(-1, -1, -1), (-1, 4, 4)])
def test_a_solver_that_does_not_count_is_not_said_to_repeat_its_count(
    counts: tuple[int, ...],
) -> None:
    """−1 is no number of iterations."""
    log = _log(steps=1)
    log.iterations[:, 0] = counts
    found = repeatability(log, ONES)
    assert np.isnan(found["iterations_identical_share"]) and np.isnan(found["iterations_spread"])
