"""Scenarios and vessels against a table typed from the literature.

The numbers below are typed from the sources (paper section IV; vessel data of the named
publications), not read from the files under `problems/`.
"""

import json
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.errors import InputError
from dpbench.scenario.own_ship import scale_inertia_and_damping
from dpbench.scenario.problem_files import list_shipped_problem_names
from dpbench.scenario.scenario import (
    Scenario,
    build_or_reuse_scenario,
    build_scenario_from_documents,
    condense,
    load_scenario,
    load_vessel,
)
from dpbench.scenario.variation import copy_scenario_with_values, differ_in_behaviour_within_steps

FULL_LIMITS = (
    [-980e3, -417e3, -18e6],
    [1240e3, 417e3, 18e6],
    [32_736.0, 11_008.0, 475_200.0],
)
PAPER_SAMPLE_S = 0.3
MODEL_SAMPLE_S = 0.035857

# id: (M, D); the Bis-scaled ship has m = 6e6 kg, L = 76.2 m and √(g/L) = 0.358804 1/s.
VESSELS: dict[str, tuple[list[list[float]], list[list[float]]]] = {
    "supply_fs99": (
        [[5.3122e6, 0, 0], [0, 8.2831e6, 0], [0, 0, 3.7454e9]],
        [[5.0242e4, 0, 0], [0, 2.7229e5, -4.3933e6], [0, -4.3933e6, 4.1894e8]],
    ),
    "supply_mss": (
        [
            [6e6 * 1.1274, 0, 0],
            [0, 6e6 * 1.8902, -6e6 * 0.0744 * 76.2],
            [0, -6e6 * 0.0744 * 76.2, 6e6 * 0.1278 * 76.2**2],
        ],
        [
            [6e6 * 0.358804 * 0.0358, 0, 0],
            [0, 6e6 * 0.358804 * 0.1183, -6e6 * 0.358804 * 0.0124 * 76.2],
            [0, -6e6 * 0.358804 * 0.0041 * 76.2, 6e6 * 0.358804 * 0.0308 * 76.2**2],
        ],
    ),
    "supply_tmr": (
        [[7.0101e6, 0, 0], [0, 8.5190e6, 4.7187e5], [0, 4.7187e5, 3.7973e9]],
        [[2.6486e5, 0, 0], [0, 8.8164e5, 0], [0, 0, 3.3774e8]],
    ),
    "osv": (
        [[5.577e6, 0, 0], [0, 6.977e6, -3.150e7], [0, -3.150e7, 3.485e9]],
        [[5.58e4, 0, 0], [0, 6.98e4, 0], [0, 0, 3.49e9]],
    ),
    "cybership2": (
        [[25.8, 0, 0], [0, 33.8, 1.0115], [0, 1.0115, 2.76]],
        [[2, 0, 0], [0, 7, 0.1], [0, 0.1, 0.5]],
    ),
}

# Per axis north, east, yaw; forces in kN and kN·m.
PAPER_SEA = ([0, 0, 0], [100, 80, 3000], [60, 60, 60], 0.0)
SCENARIOS: dict[str, dict[str, Any]] = {
    "paper": {"steps": 1000, "start": [1.2, 1.3, 0.0], "sea": PAPER_SEA, "R": 1.0},
    "paper_tight": {"steps": 1000, "start": [1.2, 1.3, 0.0], "sea": PAPER_SEA, "R": 0.7},
    "calm": {
        "steps": 1000,
        "start": [0.0, 0.0, 0.0],
        "sea": ([-20, 55, 500], [10, 30, 300], [150, 120, 100], 60.0),
        "R": 1.0,
    },
    "rough": {
        "steps": 2000,
        "start": [0.0, 0.0, 0.0],
        "sea": ([-90, 260, 1800], [60, 175, 1500], [90, 75, 110], 60.0),
        "R": None,
    },
}


@pytest.mark.parametrize("name", VESSELS)
def test_vessels_carry_the_published_matrices(name: str) -> None:
    M, D = VESSELS[name]
    ship = load_vessel(name)
    np.testing.assert_allclose(ship.M, M, rtol=1e-14)
    # √(g/L) of the Bis-scaled ship is typed to six digits.
    np.testing.assert_allclose(ship.D, D, rtol=2e-6 if name == "supply_mss" else 1e-14)
    assert ship.id == name
    assert ship.source
    assert ship.title


@pytest.mark.parametrize("name", [name for name in VESSELS if name != "cybership2"])
def test_full_scale_vessels_have_the_limits_of_the_paper(name: str) -> None:
    """Amplitude limits and the rate limits per 0.3 s sample are those of section IV."""
    ship, (low, high, step) = load_vessel(name), FULL_LIMITS
    np.testing.assert_array_equal(ship.tau_min, low)
    np.testing.assert_array_equal(ship.tau_max, high)
    np.testing.assert_allclose(
        ship.largest_force_change_per_sample(PAPER_SAMPLE_S), step, rtol=1e-14
    )
    # In every axis the rate is 2.64 % of the positive amplitude a sample.
    np.testing.assert_allclose(np.array(step) / high, 0.0264, rtol=1e-3)


def test_the_model_ship_has_froude_scaled_limits() -> None:
    """The 1:70 model has the limits of the paper divided by 70³ and 70⁴, per scaled sample."""
    ship = load_vessel("cybership2")
    np.testing.assert_allclose(ship.tau_min, [-2.857, -1.2157, -0.7497], rtol=1e-4)
    np.testing.assert_allclose(ship.tau_max, [3.615, 1.2157, 0.7497], rtol=1e-4)
    step = ship.largest_force_change_per_sample(MODEL_SAMPLE_S)
    np.testing.assert_allclose(step, [0.09544, 0.03209, 0.019792], rtol=2e-4)


SCALED = {"ratownik": ("supply_tmr", 6.5e6)}
"""Vessels without published matrices: scaled from which one, to which mass [kg]."""


@pytest.mark.parametrize("name", SCALED)
def test_vessels_without_published_matrices_have_scaled_ones(name: str) -> None:
    ship, (like, mass_kg) = load_vessel(name), SCALED[name]
    M, D = scale_inertia_and_damping(like, ship.length_m, mass_kg)
    np.testing.assert_allclose(ship.M, M, rtol=5e-5)
    np.testing.assert_allclose(ship.D, D, rtol=5e-5)
    assert ship.thrusters is not None
    np.testing.assert_array_equal(ship.tau_max, ship.thrusters.least_and_largest_force_by_axis()[1])


def test_nothing_but_the_tabled_problems_is_shipped_untested() -> None:
    assert set(list_shipped_problem_names("vessels")) == {*VESSELS, *SCALED}
    assert set(SCENARIOS) <= set(list_shipped_problem_names("scenarios"))


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_are_those_of_the_table(name: str) -> None:
    row, scenario = SCENARIOS[name], load_scenario(name)
    mean, amplitude, period_s, ramp_s = row["sea"]
    assert scenario.name == name
    assert scenario.vessel.id == "supply_fs99"
    assert scenario.sample_s == 0.3
    assert scenario.steps == row["steps"]
    np.testing.assert_array_equal(scenario.start, row["start"])
    np.testing.assert_array_equal(scenario.reference, np.zeros(3))
    sea = scenario.environment
    np.testing.assert_array_equal(sea.mean, 1e3 * np.array(mean))
    np.testing.assert_array_equal(sea.amplitude, 1e3 * np.array(amplitude))
    np.testing.assert_array_equal(sea.period_s, period_s)
    np.testing.assert_array_equal(sea.phase_rad, [0.0, 1.0, 2.0])
    assert sea.ramp_s == ramp_s


@pytest.mark.parametrize("name", SCENARIOS)
def test_tunings_are_those_of_the_table(name: str) -> None:
    """`paper` is 30/5 with R in SI, `robust` 60/10 with R = 0.1·diag(1/Δu_max²); ψ0 = 0."""
    row, scenario = SCENARIOS[name], load_scenario(name)
    control = scenario.problem
    du_max = np.array(FULL_LIMITS[2])
    robust = row["R"] is None
    assert (control.N_p, control.N_c) == ((60, 10) if robust else (30, 5))
    np.testing.assert_array_equal(control.Q, np.diag([1.0, 1.0, 3000.0 if robust else 100.0]))
    R = 0.1 / du_max**2 if robust else row["R"] * np.array([1e-10, 1e-10, 1e-14])
    np.testing.assert_allclose(control.R, np.diag(R), rtol=1e-14)
    np.testing.assert_array_equal(control.u_min, FULL_LIMITS[0])
    np.testing.assert_array_equal(control.u_max, FULL_LIMITS[1])
    np.testing.assert_allclose(control.du_max, du_max, rtol=1e-14)
    np.testing.assert_array_equal(scenario.problem.du_max, control.du_max)
    # ψ0 = 0: the model turns body into compass axes by nothing.
    assert scenario.controller.psi0_rad == 0.0
    assert scenario.controller.tuning.startswith("robust" if robust else "paper")


def test_condensed_sizes_are_those_of_the_paper() -> None:
    """The paper's horizons give 15 variables and rows; z = 1 is one maximum increment."""
    scaled, si = condense(load_scenario("paper")), condense(load_scenario("paper"), units="si")
    assert scaled.P.shape == scaled.A.shape == (15, 15)
    np.testing.assert_array_equal(scaled.ub, np.ones(15))
    np.testing.assert_array_equal(scaled.lb, -np.ones(15))
    np.testing.assert_allclose(si.ub, np.tile(FULL_LIMITS[2], 5), rtol=1e-14)
    assert condense(load_scenario("rough")).P.shape == (30, 30)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_comes_back_from_its_documents(name: str) -> None:
    scenario = load_scenario(name)
    again = build_scenario_from_documents(json.loads(json.dumps(scenario.files)))
    assert (again.name, again.steps, again.vessel.id) == (name, scenario.steps, scenario.vessel.id)
    first, second = condense(scenario), condense(again)
    np.testing.assert_array_equal(first.P, second.P)
    np.testing.assert_array_equal(first.Z, second.Z)
    t_s = np.linspace(0.0, 120.0, 7)
    np.testing.assert_array_equal(
        scenario.environment.compute_slow_forces_and_squalls(t_s),
        again.environment.compute_slow_forces_and_squalls(t_s),
    )


def test_a_scenario_can_be_cut_to_its_first_steps() -> None:
    scenario = load_scenario("paper")
    assert scenario.truncate(120).steps == 120
    assert scenario.truncate(5000).steps == 1000


def test_other_horizons_are_those_of_the_problem_and_the_length_stays() -> None:
    scenario = load_scenario("paper").truncate(40)
    longer = scenario.with_horizons(60, 8)
    assert (longer.problem.N_p, longer.problem.N_c, longer.steps) == (60, 8, 40)
    assert (scenario.problem.N_p, scenario.problem.N_c) == (30, 5)
    with pytest.raises(InputError, match=r"paper with horizons 5/8.*control_horizon"):
        scenario.with_horizons(5, 8)


def test_another_wind_is_that_of_a_study_and_survives_other_horizons() -> None:
    scenario = load_scenario("weather").truncate(40)
    speed = {"environment.wind.speed_mps": np.float64(16.0)}
    stormy = scenario.with_keys(speed)
    study = copy_scenario_with_values(scenario, {"environment.wind.speed_mps": 16.0}, "study")
    assert not differ_in_behaviour_within_steps(stormy, study, 40)
    assert (stormy.name, stormy.steps) == ("weather-environment.wind.speed_mps=16.0", 40)
    assert (
        json.loads(json.dumps(stormy.files))["scenario"]["environment"]["wind"]["speed_mps"] == 16
    )
    longer = stormy.with_horizons(70, 12)
    assert longer.environment.wind is not None and longer.environment.wind.speed_mps == 16.0
    assert (longer.problem.N_p, longer.name) == (70, f"{stormy.name}-70-12")


def test_a_sea_without_wind_gets_one_by_its_whole_table() -> None:
    windy = load_scenario("paper").with_keys({"environment.wind": {"speed_mps": 9, "from_deg": 0}})
    assert windy.name == "paper-environment.wind"
    gusty = windy.with_keys({"environment.wind.gusts": "none", "environment.seed": np.int64(3)})
    assert gusty.environment.wind is not None
    assert (gusty.environment.wind.speed_mps, gusty.environment.wind.gusts) == (9.0, "none")
    assert gusty.environment.seed == 3


def test_an_unknown_key_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"environment\.wind\.sped: found an unknown key 'sped'"):
        load_scenario("weather").with_keys({"environment.wind.sped": 16.0})


def test_a_scenario_that_is_no_longer_its_files_is_not_copied_from_them() -> None:
    """The copy would have the sea of the files."""
    calm = replace(load_scenario("weather"), environment=load_scenario("paper").environment)
    with pytest.raises(InputError, match="environment changed in place"):
        calm.with_horizons(30, 5)
    with pytest.raises(InputError, match="environment changed in place"):
        calm.with_keys({"start.east_m": 3.0})


@pytest.mark.parametrize("name", list_shipped_problem_names("scenarios"))
def test_every_scenario_is_what_its_files_say(name: str) -> None:
    scenario = load_scenario(name)
    N_p, N_c = scenario.problem.N_p + 1, scenario.problem.N_c
    sent: Scenario = pickle.loads(pickle.dumps(build_or_reuse_scenario(scenario.files)))
    assert sent.with_horizons(N_p, N_c).problem.N_p == N_p
