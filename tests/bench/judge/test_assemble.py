"""Figures of a run that `runs.parquet` holds beside the solver's own."""

import numpy as np
import pytest

from dpbench import load_scenario, open_workspace, record_sequence, replay, run_closed_loop
from dpbench.bench.judge.timing import load_time, reference_kernel_median


def test_the_reference_kernel_is_the_better_probe_of_each_round() -> None:
    """4, 6 and 9 of three rounds, a fourth stopped before its second probe; none: not available."""
    kernel_ns = np.array([[5, 4], [6, 30], [9, 0], [0, 0]])
    assert reference_kernel_median({"reference_kernel_ns": kernel_ns}) == pytest.approx(6.0)
    assert np.isnan(reference_kernel_median({"reference_kernel_ns": np.zeros((2, 2))}))


def test_a_replay_has_it_and_a_closed_loop_has_not() -> None:
    """The column is there for both, and empty where nothing was probed."""
    scenario = load_scenario("paper").first(5)
    run = replay(record_sequence(scenario), open_workspace("daqp"), repeats=2)
    assert run.summary["reference_kernel_ns"] > 0
    assert np.isnan(
        run_closed_loop(scenario, open_workspace("daqp")).summary["reference_kernel_ns"]
    )


def test_the_load_kernel_is_timed_as_a_step_is() -> None:
    """Per pass the minimum over the rounds that count, then the geometric mean of the passes."""
    load = np.full((4, 2, 2), 100.0)
    load[0] = 1.0  # the warm-up
    load[1, 0, 0], load[2, 0, 1], load[2, 1] = 20.0, 80.0, (40.0, 4.0)
    load[3] = 2.0  # a disturbed round
    columns = {"load_kernel_ns": load, "repeat": np.repeat(np.arange(4), 5)}
    found = load_time(columns, np.array([1, 2]))
    assert found == pytest.approx((20.0 * 80.0 * 40.0 * 4.0) ** 0.25)
    load[2, 1, 1] = 0.0  # stopped before it was timed: the round says nothing
    assert load_time(columns, np.array([1, 2])) == pytest.approx((20.0 * 100.0**3) ** 0.25)
    assert np.isnan(load_time(columns, np.array([2])))
