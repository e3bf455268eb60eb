"""Lost thrust, dead time and lag between the command and the hull."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dpbench.scenario.scenario import load_scenario, load_vessel
from dpbench.ship.actuators import Actuators
from dpbench.ship.environment import Environment
from dpbench.ship.plant import SUBSTEPS, ShipPlant

ZERO = np.zeros(3)
STAGES = Environment(ZERO, ZERO, np.ones(3), ZERO).build_weather_table_at_stages(1, 0.3, SUBSTEPS)[
    0
]


def commands(steps: int) -> np.ndarray:
    ship = load_vessel("supply_fs99")
    return np.random.default_rng(3).uniform(ship.tau_min, ship.tau_max, (steps, 3))


def track(tau: np.ndarray, actuators: Actuators | None) -> np.ndarray:
    plant = ShipPlant(load_vessel("supply_fs99"), np.zeros(6), 0.3, actuators=actuators)
    states = []
    for command in tau:
        plant.advance_by_one_sample(command, STAGES)
        states.append(plant.state.copy())
    return np.array(states)


@pytest.mark.parametrize("delay", [0, 1, 4, 30])
def test_a_delayed_ship_does_what_it_was_told_some_samples_ago(delay: int) -> None:
    tau = commands(20)
    earlier = np.concatenate([np.zeros((delay, 3)), tau])[:20]
    late = track(tau, Actuators(delay_samples=delay))
    np.testing.assert_array_equal(late, track(earlier, None))


def test_lost_thrust_scales_the_force_on_the_hull() -> None:
    share = np.array([0.9, 0.45, 0.6])
    np.testing.assert_array_equal(
        track(commands(20), Actuators(share, 2)),
        track(np.concatenate([np.zeros((2, 3)), commands(20)])[:20] * share, None),
    )


def test_two_ships_of_one_design_do_not_share_their_commands() -> None:
    actuators = Actuators(delay_samples=3)
    first = track(commands(10), actuators)
    np.testing.assert_array_equal(first, track(commands(10), actuators))


def test_the_command_is_left_as_it_was() -> None:
    tau = commands(1)[0]
    before = tau.copy()
    plant = ShipPlant(
        load_vessel("supply_fs99"), np.zeros(6), 0.3, actuators=Actuators(np.full(3, 0.5), 1)
    )
    plant.advance_by_one_sample(tau, STAGES)
    np.testing.assert_array_equal(tau, before)


def test_a_lagging_force_is_that_of_a_differential_equation() -> None:
    """Mean force over each sample against scipy's solution of T df/dt = τ(t − delay) − f."""
    sample_s, lag_s, share = 0.3, 1.7, np.array([0.9, 1.0, 0.6])
    tau, delay = commands(12), 2
    late = np.concatenate([np.zeros((delay, 3)), tau])
    state = Actuators(share, delay, lag_s / sample_s).make_state_at_rest()
    f = np.zeros(3)
    for k, command in enumerate(tau):

        def slope(_: float, f: np.ndarray, goal: np.ndarray = late[k]) -> np.ndarray:
            return (goal - f) / lag_s

        found = solve_ivp(slope, (0.0, sample_s), f, rtol=1e-11, atol=1e-6, dense_output=True)
        nodes, weights = np.polynomial.legendre.leggauss(12)
        mean = found.sol(0.5 * sample_s * (nodes + 1.0)) @ weights / 2.0
        on_hull = state.force_on_hull_for_command(command)
        np.testing.assert_allclose(on_hull, share * mean, rtol=1e-7, atol=1e-2)
        f = found.y[:, -1]


def test_without_lag_nothing_changes_and_the_lag_of_a_model_is_scaled() -> None:
    """A model of 1:70 has times shorter by the root of 70."""
    tau = commands(20)
    np.testing.assert_array_equal(track(tau, Actuators(lag_samples=0.0)), track(tau, None))
    full, model = (
        load_scenario(name).with_keys({"plant.thruster_lag_s": 1.5})
        for name in ("rough", "rough@cybership2")
    )
    assert isinstance(full.actuators, Actuators) and isinstance(model.actuators, Actuators)
    assert full.actuators.lag_samples == pytest.approx(1.5 / 0.3, rel=1e-12)
    assert model.actuators.lag_samples == pytest.approx(full.actuators.lag_samples, rel=1e-9)
