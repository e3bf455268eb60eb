"""Fixtures of the ship's tests: weather of one kind, a ship with hull data, the force that it
feels."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dpbench.scenario.scenario import load_vessel
from dpbench.ship.environment import Current, Environment
from dpbench.ship.plant import ShipPlant
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import WaveReflection, Windage

CALM = Environment(np.zeros(3), np.zeros(3), np.ones(3), np.zeros(3))


def linear_vessel(name: str) -> Vessel:
    """A ship of the library that meets its linear damping alone, as in the paper."""
    return replace(load_vessel(name), drag=None)


def flowing(speed_mps: float, to_rad: float) -> Environment:
    """A current and nothing else."""
    return replace(CALM, current=Current(speed_mps, to_rad))


def rotation(psi_rad: float) -> np.ndarray:
    c, s = np.cos(psi_rad), np.sin(psi_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture
def hull() -> Vessel:
    """The default ship with plausible areas above the water and at the waterline."""
    windage, reflection = Windage(290.0, 700.0), WaveReflection(18.0)
    return replace(load_vessel("supply_fs99"), windage=windage, reflection=reflection)


@pytest.fixture
def weather_force() -> Callable[..., np.ndarray]:
    """The force of the weather at time zero on a ship at a heading and velocity."""

    def force(
        ship: Vessel, weather: Environment, heading_rad: float = 0.0, nu: np.ndarray | None = None
    ) -> np.ndarray:
        start = np.zeros(6) if nu is None else np.concatenate([nu, np.zeros(3)])
        start[5] = heading_rad
        instant = 1e-5
        plant = ShipPlant(ship, start, instant, 1, loads=weather.wind_and_drift_coefficients(ship))
        plant.advance_by_one_sample(
            np.zeros(3), weather.build_weather_table_at_stages(1, instant, 1)[0]
        )
        return ship.M @ (plant.state[:3] - start[:3]) / instant + ship.D @ start[:3]

    return force
