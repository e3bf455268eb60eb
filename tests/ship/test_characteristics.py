"""Characteristics of a ship: against its equations solved in other ways, and the plant itself."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from dpbench.scenario.problem_files import list_shipped_problem_names
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.characteristics import (
    compute_axis_time_constants_s,
    compute_linear_damping_speeds,
    compute_mean_weather_force,
    compute_speeds_at_force_limits,
    find_largest_current_abeam_mps,
)
from dpbench.ship.environment import Current, Environment
from dpbench.ship.plant import ShipPlant
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import Sea, WaveDrift, Wind
from tests.ship.conftest import CALM, linear_vessel

ZERO = np.zeros(3)


@pytest.mark.parametrize("name", list_shipped_problem_names("vessels"))
def test_time_constants_are_those_of_the_eigenvalues(name: str) -> None:
    """All three modes, each once: the generalised eigenvalues of D v = λ M v."""
    vessel = load_vessel(name)
    rates = scipy.linalg.eig(vessel.D, vessel.M, right=False)
    np.testing.assert_allclose(
        np.sort(compute_axis_time_constants_s(vessel)), np.sort(1.0 / rates.real), rtol=1e-9
    )


@pytest.mark.parametrize("name", list_shipped_problem_names("vessels"))
def test_the_surge_of_a_ship_dies_away_with_its_time_constant(name: str) -> None:
    """Surge is coupled to nothing in these ships: after T of the model it has 1/e of its speed."""
    vessel = linear_vessel(name)
    T = compute_axis_time_constants_s(vessel)[0]
    plant = ShipPlant(vessel, np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), T / 100)
    for stages in CALM.build_weather_table_at_stages(100, T / 100, 10):
        plant.advance_by_one_sample(ZERO, stages)
    assert plant.state[0] == pytest.approx(np.exp(-1.0), rel=1e-6)


@pytest.mark.parametrize("swap", [False, True])
def test_a_mode_belongs_to_the_axis_that_moves_in_it(swap: bool) -> None:
    slow, fast = 100.0, 10.0
    T = np.array([50.0, fast, slow] if swap else [50.0, slow, fast])
    ship = load_vessel("supply_fs99")
    D = ship.M / T
    D[1, 2] = D[2, 1] = 1e-3 * np.sqrt(D[1, 1] * D[2, 2])
    found = compute_axis_time_constants_s(replace(ship, D=D))
    np.testing.assert_allclose(found, T, rtol=1e-3)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [0, 1])
def test_the_steady_speed_is_where_the_ship_ends_up(axis: int, side: int) -> None:
    ship = load_vessel("supply_fs99")
    ship = replace(ship, M=np.diag(np.diag(ship.M)), D=np.diag(np.diag(ship.D)))
    plant = ShipPlant(ship, np.zeros(6), 10.0)
    tau = np.zeros(3)
    tau[axis] = (ship.tau_min, ship.tau_max)[side][axis]
    for stages in CALM.build_weather_table_at_stages(200, 10.0, 10):
        plant.advance_by_one_sample(tau, stages)
    assert plant.state[axis] == pytest.approx(
        compute_speeds_at_force_limits(ship)[side, axis], rel=1e-6
    )


def test_the_force_sideways_keeps_the_ship_at_that_speed() -> None:
    """Under D [0, 1, 0] a ship that goes sideways at 1 m/s neither slows nor turns."""
    ship = linear_vessel("supply_mss")
    plant = ShipPlant(ship, np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), 1.0)
    for stages in CALM.build_weather_table_at_stages(100, 1.0, 10):
        plant.advance_by_one_sample(ship.force_to_keep_velocity(np.eye(3)[1]), stages)
    np.testing.assert_allclose(plant.state[:3], [0.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("name", list_shipped_problem_names("vessels"))
def test_the_largest_current_abeam_takes_all_of_one_axis(name: str) -> None:
    ship = load_vessel(name)
    force = ship.force_to_keep_velocity(np.array([0.0, find_largest_current_abeam_mps(ship), 0.0]))
    share = np.abs(force) / np.minimum(-ship.tau_min, ship.tau_max)
    assert share.max() == pytest.approx(1.0, rel=1e-12)


def anchored_mean(
    ship: Vessel, weather: Environment, heading_rad: float, hours: float
) -> np.ndarray:
    """The mean force on a ship whose enormous mass keeps it where it is: its momentum over time."""
    still = replace(ship, M=1e9 * ship.M)
    state = np.array([0.0, 0.0, 0.0, 0.0, 0.0, heading_rad])
    loads = weather.wind_and_drift_coefficients(ship)
    steps = round(3600 * hours)
    plant = ShipPlant(still, state, 1.0, 1, loads=loads)
    for stages in weather.build_weather_table_at_stages(steps, 1.0, 1):
        plant.advance_by_one_sample(ZERO, stages)
    mean: np.ndarray = still.M @ plant.state[:3] / steps
    return mean


@pytest.mark.parametrize("heading_deg", [0.0, 35.0, -120.0])
def test_the_mean_load_is_what_an_anchored_ship_feels(heading_deg: float) -> None:
    ship, heading = load_vessel("supply_mss"), np.radians(heading_deg)
    mean = np.array([2e4, -3e4, 4e5])
    weather = replace(
        CALM, mean=mean, wind=Wind(9.0, np.radians(130.0), "none"), current=Current(0.4, 0.3)
    )
    felt = anchored_mean(ship, weather, heading, 0.1)
    np.testing.assert_allclose(compute_mean_weather_force(ship, weather, heading), felt, rtol=1e-6)


def test_the_mean_drift_is_what_an_anchored_ship_feels() -> None:
    """Over two hours, in which drift has some 240 values of its own size: within a fifth."""
    ship = load_vessel("supply_fs99")
    weather = replace(CALM, drift=WaveDrift(Sea(3.1, 8.5, np.radians(200.0))), seed=4)
    felt = anchored_mean(ship, weather, 0.0, 2.0)
    np.testing.assert_allclose(compute_mean_weather_force(ship, weather), felt, rtol=0.2)


def test_slow_is_the_same_froude_number_at_any_size() -> None:
    ship = load_vessel("supply_fs99")
    longer = compute_linear_damping_speeds(replace(ship, length_m=4 * ship.length_m))
    np.testing.assert_allclose(longer / compute_linear_damping_speeds(ship), [2.0, 2.0, 0.5])
    assert compute_linear_damping_speeds(ship)[0] == pytest.approx(0.2 * np.sqrt(9.81 * 76.2))
