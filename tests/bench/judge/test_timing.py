"""The columns of `runs.parquet` on step times, from few steps worked by hand."""

from typing import Any

import numpy as np
import pytest

from dpbench.bench.judge.evaluation import EvaluatedCell
from dpbench.bench.judge.rules import mask_counted_rows, select_step_rows
from dpbench.bench.judge.timing import (
    average_load_test_ns,
    compute_timing_percentiles,
    find_disturbed_rounds,
    median_reference_kernel_ns,
)
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.schema import MISSING_INT

CONFIGURATION = {"solver": "x", "route": "native", "policy": "fresh", "settings": "default"}
REPLAY = Cell(mode="replay", scenario={}, steps=20, rounds=3, **CONFIGURATION)
LOOP = Cell(mode="closed_loop", scenario={}, steps=20, **CONFIGURATION)
LOADS = np.array([[[1.0]], [[8.0]], [[2.0]], [[4.0]]])


def replayed(slowed: tuple[int, ...] = (0, 2), **columns: Any) -> dict[str, Any]:
    """A warm-up of 5 steps and three rounds of 20, those of `slowed` disturbed.

    Step k takes 100 + k ns in round 1 and 300 − k in round 3, both 1 ns in the other rounds.
    """
    repeat = np.repeat(np.arange(4), [5, 20, 20, 20])
    k = np.concatenate([np.arange(5), *3 * [np.arange(20)]])
    total = np.select([repeat == 1, repeat == 3], [100 + k, 300 - k], 1)
    disturbed = np.isin(repeat, slowed)
    steps = {"repeat": repeat, "k": k, "total_ns": total, "disturbed": disturbed}
    evaluated = EvaluatedCell(
        {
            "repeat": repeat,
            "setup_once_ns": np.array([7]),
            "matrix_updates": np.array([0, 3, 5, 4]),
            "reference_kernel_ns": np.array([[9.0, 4.0], [4.0, 4.5], [6.0, 5.5], [5.0, 4.2]]),
            "load_kernel_ns": np.broadcast_to(LOADS, (4, 1, 1)).copy(),
        }
        | columns,
        {},
    )
    counting = select_step_rows(steps, mask_counted_rows(repeat, disturbed))
    return compute_timing_percentiles(REPLAY, evaluated, counting)


def test_the_algorithmic_time_is_the_minimum_over_the_rounds_that_count() -> None:
    """The time of step k is the smaller of 100 + k and 300 − k: 100 to 119, with the median
    109.5."""
    timing = replayed()
    assert (timing["algo_p50_ns"], timing["algo_max_ns"]) == (109.5, 119.0)
    # Means of both rounds are 200 at each step, and so is the median of two.
    assert timing["algo_median_p50_ns"] == 200.0
    # 20 steps carry a median and no more.
    assert np.isnan([timing["algo_p95_ns"], timing["algo_p99_ns"]]).all()


def test_the_raw_times_are_all_samples_of_the_rounds_that_count() -> None:
    """100 to 119 and 281 to 300: the median lies halfway between 119 and 281."""
    timing = replayed()
    assert (timing["raw_samples"], timing["raw_p50_ns"], timing["raw_max_ns"]) == (40, 200.0, 300.0)
    assert np.isnan([timing["raw_p99_ns"], timing["raw_p999_ns"]]).all()


def test_what_disturbed_a_replay_is_counted_without_its_warm_up() -> None:
    """The best kernel is 4, so that 6 and the 9 of the warm-up are beyond 5 and 5 is not."""
    timing = replayed()
    assert (timing["rounds"], timing["disturbed_rounds"], timing["counting_disturbed"]) == (2, 1, 0)
    # The better one of each round: 4, 4, 5.5 and 4.2.
    assert timing["reference_kernel_ns"] == pytest.approx(4.1)
    # Rounds 1 and 3 count: the smaller of 8 and 4.
    assert timing["load_kernel_ns"] == pytest.approx(4.0)


def test_where_all_rounds_are_disturbed_they_count_and_are_counted() -> None:
    """Three rounds, of which the second takes 1 ns a step, and none of them was quiet."""
    timing = replayed(slowed=(0, 1, 2, 3))
    assert (timing["rounds"], timing["counting_disturbed"]) == (3, 3)
    assert (timing["raw_samples"], timing["algo_max_ns"]) == (60, 1.0)


def test_disturbed_rounds_are_named_by_their_number() -> None:
    columns = {
        "repeat": np.array([0, 2, 2, 5]),
        "reference_kernel_ns": np.array([[4, 4], [4, 9], [9, 4]]),
    }
    assert find_disturbed_rounds(columns).tolist() == [2, 5]


def test_a_cascade_is_set_up_twice() -> None:
    assert replayed()["setup_once_ns"] == 7
    assert replayed(allocation_setup_once_ns=np.array([11]))["setup_once_ns"] == 18
    shortest = replayed(setup_once_ns=np.array([1]), allocation_setup_once_ns=np.array([11]))
    assert shortest["setup_once_ns"] == 12
    without = replayed(setup_once_ns=np.array([0]), allocation_setup_once_ns=np.array([11]))
    assert np.isnan(without["setup_once_ns"])
    assert replayed()["matrix_updates"] == 5


def looped(**columns: Any) -> dict[str, Any]:
    """A loop of 20 steps of 1 to 20 ns."""
    steps = {
        "total_ns": np.arange(1, 21),
        "waited_ns": np.array([MISSING_INT] * 17 + [0, 4, 6]),
        "emit_ns": np.array([MISSING_INT] * 17 + [0, 4, 6]),
        "overhead_ns": np.full(20, MISSING_INT),
    }
    evaluated = EvaluatedCell({"setup_once_ns": np.array([3]), "matrix_updates": np.array([2])}, {})
    return compute_timing_percentiles(LOOP, evaluated, steps | columns)


def test_the_times_of_a_loop_are_those_of_its_steps() -> None:
    timing = looped()
    assert (timing["raw_p50_ns"], timing["raw_max_ns"], timing["raw_samples"]) == (10.5, 20.0, 20)
    assert timing["emit_p50_ns"] == 4.0
    # 1 + … + 20 = 210 ns, in which the core was missing for 10 ns; a wait nobody saw is none.
    assert timing["solve_s"] == pytest.approx(200e-9)
    assert np.isnan(timing["overhead_p50_ns"])
    assert not {"rounds", "algo_p50_ns", "controller_p50_ns", "reference_kernel_ns"} & set(timing)


def test_a_thousand_steps_carry_a_p99_and_ten_thousand_a_p999() -> None:
    """The percentiles of 0 to 10 000 ns are themselves; those of both QPs of a cascade are
    apart."""
    total = np.arange(10_001)
    timing = looped(total_ns=total, waited_ns=0 * total, allocation_ns=total // 10)
    for name, expected in (("p50", 5000.0), ("p99", 9900.0), ("p999", 9990.0)):
        assert timing[f"raw_{name}_ns"] == pytest.approx(expected, abs=1e-6)
    assert (timing["allocation_p50_ns"], timing["allocation_p99_ns"]) == (500.0, 990.0)
    # k − ⌊k/10⌋ is ⌈9k/10⌉.
    assert (timing["controller_p50_ns"], timing["controller_p99_ns"]) == (4500.0, 8910.0)


def rounds_of(repeat: Any, k: Any, total_ns: Any) -> dict[str, Any]:
    kernels = {"reference_kernel_ns": np.ones((2, 2)), "load_kernel_ns": np.ones((2, 1, 1))}
    once = {"setup_once_ns": np.array([0]), "matrix_updates": np.array([0])}
    steps = {"repeat": repeat, "k": k, "total_ns": total_ns, "disturbed": repeat > 2}
    return compute_timing_percentiles(
        REPLAY, EvaluatedCell(kernels | once | {"repeat": repeat}, {}), steps
    )


def test_many_steps_of_a_replay_carry_percentiles() -> None:
    """1001 steps of k ns in round 1 and k + 1 in round 2."""
    k, repeat = np.tile(np.arange(1001), 2), np.repeat([1, 2], 1001)
    timing = rounds_of(repeat, k, k + repeat - 1)
    assert (timing["algo_p50_ns"], timing["algo_p95_ns"]) == (500.0, 950.0)
    assert timing["algo_p99_ns"] == pytest.approx(990.0)
    assert timing["algo_median_p50_ns"] == 500.5


def test_a_round_that_ended_early_leaves_its_later_steps_to_the_others() -> None:
    """Round 1 has steps 0 and 1, round 2 steps 1 and 2: three steps, of which 1 has two times."""
    repeat, k = np.array([1, 1, 2, 2]), np.array([0, 1, 1, 2])
    timing = rounds_of(repeat, k, np.array([50, 30, 20, 40]))
    assert (timing["rounds"], timing["algo_max_ns"], timing["raw_max_ns"]) == (2, 50.0, 50.0)
    assert timing["raw_samples"] == 4


def test_a_kernel_that_was_not_timed_is_no_time() -> None:
    assert median_reference_kernel_ns({"reference_kernel_ns": np.array([[0.0, 1.0]])}) == 1.0
    load = {"repeat": np.array([1, 2]), "load_kernel_ns": np.array([[[1.0, 2.0]], [[3.0, 0.0]]])}
    assert average_load_test_ns(load, np.array([1, 2])) == pytest.approx(np.sqrt(2.0))
