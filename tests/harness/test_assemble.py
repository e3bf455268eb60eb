"""Figures of a run that `runs.parquet` holds beside the solver's own."""

import numpy as np
import pytest

from dpbench import load_scenario, open_workspace, record_sequence, replay, run_closed_loop
from dpbench.bench.timing_columns import probe_median


def test_the_reference_kernel_is_the_better_probe_of_each_round() -> None:
    """4, 6 and 9 of three rounds, a fourth stopped before its second probe; none: not available."""
    probes = np.array([[5, 4], [6, 30], [9, 0], [0, 0]])
    assert probe_median({"probe_ns": probes}) == pytest.approx(6.0)
    assert np.isnan(probe_median({"probe_ns": np.zeros((2, 2))}))


def test_a_replay_has_it_and_a_closed_loop_has_not() -> None:
    """The column is there for both, and empty where nothing was probed."""
    scenario = load_scenario("paper").first(5)
    run = replay(record_sequence(scenario), open_workspace("daqp"), repeats=2)
    assert run.summary["probe_ns"] > 0
    assert np.isnan(run_closed_loop(scenario, open_workspace("daqp")).summary["probe_ns"])
