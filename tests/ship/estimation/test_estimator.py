"""Promises of every estimator, on the nonlinear ship."""

from collections.abc import Callable

import numpy as np
import pytest

from dpbench.errors import ShapeError
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.environment import Environment
from dpbench.ship.estimation.estimator import Estimator, MeasuredState
from dpbench.ship.estimation.kalman import SENSOR_STD, KalmanFilter, KalmanTuning
from dpbench.ship.estimation.observer import (
    PassiveObserver,
    PassiveTuning,
    WaveModel,
    build_matrix_of_sample_change,
    write_model_change_of_sample,
)
from dpbench.ship.plant import SUBSTEPS, ShipPlant
from tests.ship.conftest import linear_vessel

SAMPLE_S = 0.3
SHIP = load_vessel("supply_fs99")
WAVES = WaveModel.from_peak_period(8.5, np.array([0.3, 0.3, np.radians(1.0)]))
BIAS = np.array([-60e3, 90e3, 1e6])
NOTHING = np.zeros(3)
START = np.array([0.3, -0.2, 0.004, 12.0, -7.0, 0.8])


def kalman() -> KalmanFilter:
    return KalmanFilter(SHIP, KalmanTuning.choose_for_ship(SHIP, WAVES), SAMPLE_S)


def passive() -> PassiveObserver:
    return PassiveObserver(SHIP, PassiveTuning.choose_for_ship(SHIP, WAVES), SAMPLE_S)


FILTERS = (kalman, passive)
ALL = (MeasuredState, *FILTERS)


def turning_ship(
    estimator: Estimator, steps: int, heading_rad: float, wrapped: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States, estimates and changes (steps, 6) of a ship that is steered to a heading."""
    sea = Environment(BIAS, NOTHING, np.ones(3), NOTHING)
    table = sea.build_weather_table_at_stages(1, SAMPLE_S, SUBSTEPS)[0]
    plant, tau = ShipPlant(SHIP, START, SAMPLE_S), np.zeros(3)
    estimator.start_from_state(START)
    states, estimates, changes = np.empty((3, steps, 6))
    for k in range(steps):
        measured = plant.state.copy()
        if wrapped:
            measured[5] = np.arctan2(np.sin(measured[5]), np.cos(measured[5]))
        states[k] = plant.state
        estimates[k] = estimator.update_and_return_state(measured, tau)
        changes[k] = estimator.change
        error = plant.state[3:] - [0.0, 0.0, heading_rad]
        c, s = np.cos(plant.state[5]), np.sin(plant.state[5])
        in_body = np.array([c * error[0] + s * error[1], c * error[1] - s * error[0], error[2]])
        tau = -np.diag(SHIP.M) * (0.05**2 * in_body + 2 * 0.05 * plant.state[:3])
        plant.advance_by_one_sample(tau, table)
    return states, estimates, changes


@pytest.mark.parametrize("make", ALL)
def test_the_first_update_is_at_the_start(make: Callable[[], Estimator]) -> None:
    estimator = make()
    for _ in range(2):
        estimator.start_from_state(START)
        # The rotation to and from vessel-parallel axes rounds.
        np.testing.assert_allclose(
            estimator.update_and_return_state(START, SHIP.tau_max), START, rtol=1e-14
        )
        np.testing.assert_array_equal(estimator.change, 0.0)
        estimator.update_and_return_state(START + 1.0, SHIP.tau_max)


@pytest.mark.parametrize("make", ALL)
def test_a_wrapped_heading_is_unwrapped(make: Callable[[], Estimator]) -> None:
    """A compass that jumps at ±180° gives the estimates of one that does not."""
    states, plain, changes = turning_ship(make(), 500, 4.5)
    _, wrapped, wrapped_changes = turning_ship(make(), 500, 4.5, wrapped=True)
    assert states[:, 5].max() > np.pi
    # Adding a whole turn rounds by 1e-15, which the filters do not amplify.
    np.testing.assert_allclose(wrapped, plain, rtol=0, atol=1e-9)
    np.testing.assert_allclose(wrapped_changes, changes, rtol=0, atol=1e-9)
    assert np.abs(np.diff(wrapped[:, 5])).max() < 0.1


def test_the_measured_state_is_passed_on_with_its_difference() -> None:
    states, estimates, changes = turning_ship(MeasuredState(), 50, 1.0)
    np.testing.assert_array_equal(estimates, states)
    np.testing.assert_array_equal(changes[1:], states[1:] - states[:-1])


@pytest.mark.parametrize("make", FILTERS)
def test_a_pose_is_all_a_filter_reads(make: Callable[[], Estimator]) -> None:
    full, pose = make(), make()
    full.start_from_state(START)
    pose.start_from_state(START)
    rng = np.random.default_rng(3)
    for _ in range(20):
        measured, tau = START + rng.normal(size=6), SHIP.tau_max * rng.normal(size=3)
        np.testing.assert_array_equal(
            full.update_and_return_state(measured, tau),
            pose.update_and_return_state(measured[3:], tau),
        )


@pytest.mark.parametrize("make", FILTERS)
def test_a_ship_that_turns_by_ninety_degrees_is_followed(
    make: Callable[[], KalmanFilter | PassiveObserver],
) -> None:
    """While the ship turns by 90° the estimate converges and the bias is recovered to 1 %."""
    estimator = make()
    states, estimates, changes = turning_ship(estimator, 1500, START[5] + np.pi / 2)
    assert abs(states[-1, 5] - START[5]) > 1.4
    tail = slice(1000, None)
    # The ship still creeps; a millimetre and a hundredth of a degree are far below any sensor.
    np.testing.assert_allclose(estimates[tail, 3:5], states[tail, 3:5], rtol=0, atol=2e-3)
    np.testing.assert_allclose(estimates[tail, 5], states[tail, 5], rtol=0, atol=2e-4)
    np.testing.assert_allclose(estimates[tail, :3], states[tail, :3], rtol=0, atol=1e-3)
    np.testing.assert_allclose(estimator.estimated_bias_force, BIAS, rtol=0.01)
    np.testing.assert_allclose(changes[tail], np.diff(states, axis=0)[999:], rtol=0, atol=3e-4)


def test_the_change_by_the_model_is_that_of_the_ship() -> None:
    heading, tau = 0.7, np.array([300e3, -200e3, 0.0])
    # Without coupling to yaw the heading stays, so that the nonlinear ship is exactly linear.
    ship = linear_vessel("supply_tmr")
    ship.M[1, 2] = ship.M[2, 1] = 0.0
    b = np.array([50e3, 80e3, 0.0])
    table = Environment(b, NOTHING, np.ones(3), NOTHING).build_weather_table_at_stages(
        1, SAMPLE_S, SUBSTEPS
    )[0]
    before = np.array([0.4, -0.3, 0.0, 3.0, 4.0, heading])
    plant = ShipPlant(ship, before, SAMPLE_S)
    plant.advance_by_one_sample(tau, table)
    change = np.empty(6)
    write_model_change_of_sample(
        build_matrix_of_sample_change(ship, SAMPLE_S), plant.state, tau, b, change
    )
    # Differences of 1e-2 in states of 1 leave 1e-14; the integrator is exact to 1e-13.
    np.testing.assert_allclose(change, plant.state - before, rtol=0, atol=1e-12)


@pytest.mark.parametrize("make", FILTERS)
def test_sensor_noise_reaches_the_change_less_than_the_difference(
    make: Callable[[], Estimator],
) -> None:
    estimator, rng = make(), np.random.default_rng(11)
    estimator.start_from_state(np.zeros(6))
    estimates, changes = np.empty((2, 4000, 6))
    for k in range(4000):
        estimates[k] = estimator.update_and_return_state(SENSOR_STD * rng.normal(size=3), NOTHING)
        changes[k] = estimator.change
    noise = changes[1000:].std(axis=0) / np.diff(estimates[999:], axis=0).std(axis=0)
    assert (noise < 0.2).all()


def test_a_pose_does_not_make_a_measured_state() -> None:
    estimator = MeasuredState()
    estimator.start_from_state(np.zeros(6))
    with pytest.raises(ShapeError, match=r"MeasuredState: measured: found shape \(3,\)"):
        estimator.update_and_return_state(np.zeros(3), NOTHING)
