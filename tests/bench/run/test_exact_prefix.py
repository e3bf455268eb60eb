"""An exactly solved loop of fewer steps is the beginning of the longer one, bit for bit: cells of
any length share it."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from dpbench.bench.run.exact_loop import solve_exactly
from dpbench.qp.referee.optimum import Optimum
from dpbench.scenario.scenario import load_scenario

SHORT, LONG = 7, 24
NAMES = {
    "paper": "nothing but slow forces",
    "weather": "gusts and waves",
    "waves": "a Kalman filter, and noise",
    "waves_passive": "a passive observer",
    "move_filtered": "a reference that moves",
    "turn": "a model linearised at each step",
    "thrusters_turning": "thrusters whose rows are other ones at each step",
    "thrusters_cascade": "a second QP at each step",
}


def assert_same(one: Optimum, other: Optimum) -> None:
    """Every number of two optima, and what they prove."""
    for part in fields(Optimum):
        np.testing.assert_array_equal(getattr(one, part.name), getattr(other, part.name))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_shorter_exact_loop_is_the_beginning_of_a_longer_one(name: str) -> None:
    """States, forces and certified optima alike, whatever the scenario has."""
    scenario = load_scenario(name)
    short, long = (solve_exactly(scenario.first(steps)) for steps in (SHORT, LONG))
    states = len(short.state)
    assert (len(long.theta), len(short.theta), states) == (LONG, SHORT, SHORT + 1)
    np.testing.assert_array_equal(short.state, long.state[:states])
    for part in ("theta", "tau", "thrust", "z"):
        np.testing.assert_array_equal(getattr(short, part), getattr(long, part)[:SHORT])
    assert (short.demand is not None) == scenario.controller.allocates
    if short.demand is not None and long.demand is not None:
        np.testing.assert_array_equal(short.demand, long.demand[:SHORT])
    assert len(short.allocated) == (SHORT if long.allocated else 0)
    for optima, others in ((short.optima, long.optima), (short.allocated, long.allocated)):
        for one, other in zip(optima, others, strict=False):
            assert_same(one, other)


@pytest.mark.parametrize("name", ["weather", "waves"])
def test_the_weather_of_a_shorter_run_is_the_beginning_of_a_longer_one(name: str) -> None:
    """However many samples are asked for, also beyond those that are summed up at a time."""
    scenario = load_scenario(name)
    sea, sample_s = scenario.environment, scenario.sample_s
    for steps, more in ((1, 2), (100, 101), (1021, 1400)):
        short, long = (
            (
                sea.stage_table(count, sample_s, 2),
                sea.measured_motion(count, sample_s),
                sea.noise_table(count),
            )
            for count in (steps, more)
        )
        for one, other in zip(short, long, strict=True):
            np.testing.assert_array_equal(one, other[:steps])
