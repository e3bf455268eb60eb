"""Limit figures of a force limited by an attainable set, in runs worked by hand.

The set is the box of ±100 N, ±40 N and ±10 N·m, so that shares of it are easy to read.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from dpbench.bench.record.schema import FORCES
from dpbench.mpc.thrusters.attainable_set import AttainableSet
from dpbench.scenario.controllers.forces import JointForceController
from tests.bench.judge import known_runs
from tests.bench.judge.known_runs import Rows, round_ship, with_controller

HIGH = [100.0, 40.0, 10.0]
BOX = AttainableSet(np.eye(3), (np.array(list(product(*[(-h, h) for h in HIGH]))),))
STILL = [0.0, 0.0, 0.0]


def metrics_of(u: Rows, shares: list[float]) -> dict[str, float]:
    """Return the metrics of forces limited to these shares of the set, sample by sample.

    The largest increments are 10, 5 and 2.
    """
    high = np.multiply.outer(shares, HIGH)
    limits = (-high).tolist(), high.tolist()
    rows = BOX.rows()
    problem = replace(round_ship().problem, thrusters=rows, u_min=rows.low, u_max=rows.high)
    ship = with_controller(JointForceController, problem)
    return known_runs.metrics_of([STILL] * (len(u) + 1), u, limits=limits, scenario=ship)


def ramp(to: float) -> list[list[float]]:
    """Return surge forces that rise by 10 N per sample up to a force."""
    steps = round(abs(to) / 10)
    return [[10.0 * (i + 1) * (1 if to > 0 else -1), 0.0, 0.0] for i in range(steps)]


def test_columns_of_the_set_take_the_place_of_those_of_its_axes() -> None:
    """Rate shares are reported per axis, the amplitude share for the whole force."""
    found = metrics_of([[10.0, 0.0, 2.0], [10.0, 0.0, 4.0]], [1.0, 1.0])
    assert [found[f"at_rate_{axis}"] for axis in FORCES] == [0.5, 0.0, 1.0]
    assert not [name for name in found if name.startswith("at_amplitude")]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_share_of_steps_at_the_set(side: float) -> None:
    """A force within 1e-6 increments of the set in force is at its limit."""
    forces = [[0, 0, 2], [0, 0, 4], [0, 0, 6], [0, 0, 8], [0, 0, 10 - 1e-6], [0, 0, 10 - 1e-5]]
    turned = [[side * part for part in force] for force in forces]
    assert metrics_of(turned, [1.0] * 6)["at_limit_thrusters"] == pytest.approx(1 / 6)
    assert metrics_of(turned, [0.8, 0.8, 0.8, 0.8, 1, 1])["at_limit_thrusters"] == pytest.approx(
        2 / 6
    )


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("shares", "last", "violations"),
    [
        # The set stays: 50 N lies within it, 50.1 N beyond 0.5 of it
        ([0.5] * 6, 50.0, 0),
        ([0.5] * 6, 50.001, 1),
        ([1.0] * 6, 59.0, 0),
        # It has shrunk below the force before, 50 N: a smaller share is on its way, a larger not
        ([1.0] * 5 + [0.2], 40.0, 0),
        ([1.0] * 5 + [0.2], 49.9, 0),
        ([1.0] * 5 + [0.2], 50.1, 1),
        # Beyond the rate, within and outside
        ([1.0] * 6, 60.1, 1),
        ([1.0] * 5 + [0.2], 39.0, 1),
        ([1.0] * 5 + [0.2], 60.1, 1),
    ],
)
def test_outside_a_set_that_has_shrunk_the_force_comes_nearer(
    side: float, shares: list[float], last: float, violations: int
) -> None:
    """A force outside the set must not need a larger share of the whole set than before."""
    run = [*ramp(side * 50.0), [side * last, 0.0, 0.0]]
    assert metrics_of(run, shares)["limit_violations"] == violations


def test_the_share_is_that_of_the_axis_that_needs_most() -> None:
    """The largest share over the axes decides, here from 0.25 at (20, 10, 0).

    (28, 9, 0) needs 0.28 and is further out; (24, 8, 0) needs 0.24 and is nearer.
    """
    start = [[10.0, 5.0, 0.0], [20.0, 10.0, 0.0]]
    shares = [1.0, 1.0, 0.1]
    assert metrics_of([*start, [28.0, 9.0, 0.0]], shares)["limit_violations"] == 1.0
    assert metrics_of([*start, [24.0, 8.0, 0.0]], shares)["limit_violations"] == 0.0
