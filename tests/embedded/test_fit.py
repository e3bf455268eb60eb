"""The largest horizon that fits: bisection against a search of all, and horizons that fail."""

import numpy as np
import pytest

from dpbench.embedded.fit import MOST, Trial, find_largest_horizon_for_memory, summarise_fit_as_dict
from dpbench.embedded.table import COUNTED, StepCounts

STACK = 24


def make_trial(N_c: int, memory: int) -> Trial:
    """A trial that takes this memory, 24 bytes of it as stack."""
    steps = {name: np.full(2, STACK) for name in COUNTED}
    parts = {"code": 100, "constants": 0, "static": memory - 100 - STACK, "heap": 0}
    zeros = np.zeros(2)
    z = np.zeros((2, 3 * N_c))
    return Trial(N_c, StepCounts("s", "m7", "q", False, {}, steps, z, zeros, zeros, parts))


@pytest.mark.parametrize("largest", [1, 4, 5, 6, 19, 20, 21, 41, 79, 80, 99])
def test_bisection_finds_what_a_search_of_all_finds(largest: int) -> None:
    tried = []

    def try_horizon(N_c: int) -> Trial:
        tried.append(N_c)
        return make_trial(N_c, 1024 if N_c <= largest else 1025)

    fit = find_largest_horizon_for_memory(try_horizon, 1)
    assert fit.largest and fit.following
    assert (fit.largest.N_c, fit.following.N_c) == (largest, largest + 1)
    assert len(set(tried)) <= 12


def test_nothing_fits_and_everything_fits() -> None:
    nothing = find_largest_horizon_for_memory(lambda N_c: make_trial(N_c, 2000 * N_c), 1)
    assert nothing.largest is None
    assert summarise_fit_as_dict(nothing)["next_memory_bytes"] == 2000
    everything = find_largest_horizon_for_memory(lambda N_c: make_trial(N_c, 1000), 1)
    assert everything.largest and everything.largest.N_c == MOST
    assert everything.following is None


def test_a_program_that_does_not_run_does_not_fit() -> None:
    def try_horizon(N_c: int) -> Trial:
        return make_trial(N_c, 500) if N_c < 8 else Trial(N_c, None, "it does not end")

    summary = summarise_fit_as_dict(find_largest_horizon_for_memory(try_horizon, 1))
    assert (summary["control_horizon"], summary["variables"]) == (7, 21)
    assert (summary["next_control_horizon"], summary["next_reason"]) == (8, "it does not end")
    assert summary["memory_bytes"] == 500
