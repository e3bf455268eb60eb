"""Current as velocity relative to the water."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dpbench.scenario.scenario import load_vessel
from dpbench.ship.environment import Current, Environment
from dpbench.ship.plant import SUBSTEPS, Plant


def flowing(speed_mps: float, to_rad: float) -> Environment:
    """A current and nothing else."""
    zero = np.zeros(3)
    return Environment(zero, zero, np.ones(3), zero, current=Current(speed_mps, to_rad))


@pytest.mark.parametrize("name", ["supply_fs99", "supply_mss", "supply_tmr"])
def test_a_free_ship_ends_up_drifting_with_the_current(name: str) -> None:
    """Without thrust a ship at rest is carried along until it moves as the water does."""
    ship, weather = load_vessel(name), flowing(0.75, 2.0)
    plant = Plant(ship, np.zeros(6), 0.3, loads=weather.load_coefficients(ship))
    # 12 000 s are 100 of the longest time constants; the table of one sample serves for all.
    stages = weather.stage_table(1, 0.3, SUBSTEPS)[0]
    for _ in range(40_000):
        plant.advance(np.zeros(3), stages)
    u, v, r, *_, psi = plant.state
    north, east = np.cos(psi) * u - np.sin(psi) * v, np.sin(psi) * u + np.cos(psi) * v
    np.testing.assert_allclose([north, east], 0.75 * np.array([np.cos(2), np.sin(2)]), atol=1e-9)
    assert r == pytest.approx(0.0, abs=1e-12)


def test_a_ship_that_moves_with_the_water_feels_nothing(felt_force: Callable[..., object]) -> None:
    """A ship that moves as the water does keeps its velocity: its damping D ν is undone."""
    ship, nu = load_vessel("supply_fs99"), np.array([0.5, 0.0, 0.0])
    found = felt_force(ship, flowing(0.5, 0.3), 0.3, nu)
    np.testing.assert_allclose(found, ship.D @ nu, rtol=1e-6, atol=0.5)


def test_a_ship_at_rest_is_pushed_by_its_damping_times_the_current(
    felt_force: Callable[..., object],
) -> None:
    """The force on a ship at rest is D ν_c with the current in body axes."""
    ship, psi = load_vessel("supply_mss"), 1.1
    inside = 0.6 * np.array([np.cos(2.0 - psi), np.sin(2.0 - psi), 0.0])
    found = felt_force(ship, flowing(0.6, 2.0), psi)
    np.testing.assert_allclose(found, ship.D @ inside, rtol=1e-5)
