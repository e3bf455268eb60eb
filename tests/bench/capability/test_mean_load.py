"""The share of thrust that a scenario's mean load takes, against a balance by hand."""

import copy
import math

import pytest

from dpbench.bench.capability.mean_load import compute_share_of_thrust, find_overload
from dpbench.scenario.scenario import load_scenario
from dpbench.ship.characteristics import compute_mean_weather_force


def test_a_load_beyond_the_limits_is_an_overload() -> None:
    """Wind force grows with the square of its speed: 0.3 of the limits becomes more than 1."""
    scenario = load_scenario("weather")
    assert math.isnan(find_overload(scenario.files))
    files = copy.deepcopy(scenario.files)
    files["scenario"]["environment"]["wind"]["speed_mps"] *= 4.0
    load = compute_mean_weather_force(
        scenario.vessel, scenario.environment, float(scenario.reference[2])
    )
    calm = copy.deepcopy(scenario.files)
    calm["scenario"]["environment"]["wind"]["speed_mps"] = 0.0
    limits = scenario.vessel.tau_max
    assert compute_share_of_thrust(scenario.vessel, load) == pytest.approx(
        max(abs(load) / limits), rel=1e-12
    )
    assert find_overload(files) > 1.0
    assert math.isnan(find_overload(calm)) and math.isnan(find_overload({}))


def test_the_share_of_thrusters_is_the_largest_multiple_of_the_load() -> None:
    """A load of s times the largest force ahead takes the share s of the thrust."""
    vessel = load_scenario("thrusters").vessel
    assert vessel.thrusters is not None
    _, high = vessel.thrusters.least_and_largest_force_by_axis()
    share = compute_share_of_thrust(vessel, -0.5 * high * [1.0, 0.0, 0.0])
    assert share == pytest.approx(0.5, rel=1e-6)
