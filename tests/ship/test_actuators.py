"""Lost thrust and dead time between the command and the hull."""

import numpy as np
import pytest

from dpbench.scenario.scenario import load_vessel
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
