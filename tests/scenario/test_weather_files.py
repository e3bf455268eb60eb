"""Weather, estimator, plant and faults as a person writes them."""

import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dpbench import load_scenario
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.errors import DpbenchError
from dpbench.scenario.controllers.controller import stack_lower_and_upper_limits
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents
from dpbench.ship.estimation.estimator import MeasuredState
from dpbench.ship.estimation.kalman import KalmanFilter
from dpbench.ship.estimation.observer import PassiveObserver

Change = Callable[[dict[str, Any]], None]


def changed(name: str, change: Change, vessel: Change | None = None) -> Scenario:
    files = copy.deepcopy(load_scenario(name).files)
    change(files["scenario"])
    if vessel is not None:
        vessel(files["vessel"])
    return build_scenario_from_documents(files, "my.toml", "ship.toml")


def test_sailors_name_wind_and_waves_by_where_they_come_from() -> None:
    """Wind and sea from 40° run towards 220°; a current towards 220° sets there."""
    weather = load_scenario("weather").environment
    assert weather.wind is not None
    assert weather.current is not None
    assert weather.drift is not None
    for to_rad in (weather.wind.to_rad, weather.drift.sea.to_rad, weather.current.to_rad):
        assert math.remainder(to_rad - math.radians(220.0), 2 * math.pi) == pytest.approx(0.0)
    assert weather.wind.speed_mps == 10.7
    assert weather.drift.sea.hs_m == 2.1


@pytest.mark.parametrize(
    ("name", "kind"),
    [("calm", MeasuredState), ("waves", KalmanFilter), ("waves_passive", PassiveObserver)],
)
def test_the_scenario_chooses_the_estimator(name: str, kind: type) -> None:
    assert type(load_scenario(name).estimator()) is kind


def test_an_estimator_starts_where_the_ship_starts() -> None:
    scenario = changed("waves", lambda s: s["start"].update(north_m=3.0, heading_deg=20.0))
    estimate = scenario.estimator().update_and_return_state(
        np.append(np.zeros(3), scenario.start), np.zeros(3)
    )
    np.testing.assert_allclose(estimate, [0, 0, 0, 3.0, 0.0, np.radians(20.0)], atol=1e-12)


def test_limits_change_at_the_sample_of_the_fault() -> None:
    """Until 121 s the vessel's limits hold, from then on the share the file says."""
    scenario = load_scenario("thruster_loss")
    low, high = stack_lower_and_upper_limits(
        scenario.controller.list_planned_force_limits_by_sample(scenario.steps)
    )
    k = round(121.0 / 0.3)
    np.testing.assert_array_equal(high[k - 1], scenario.vessel.tau_max)
    np.testing.assert_allclose(high[k], [1240e3, 187.65e3, 10.8e6], rtol=1e-12)
    np.testing.assert_allclose(low[-1], [-980e3, -187.65e3, -10.8e6], rtol=1e-12)


def test_the_true_ship_differs_by_per_cent() -> None:
    scenario = load_scenario("mismatch")
    np.testing.assert_allclose(scenario.true_ship.M, 1.2 * scenario.vessel.M, rtol=1e-15)
    np.testing.assert_allclose(scenario.true_ship.D, 0.7 * scenario.vessel.D, rtol=1e-15)
    assert scenario.actuators is not None
    np.testing.assert_allclose(scenario.actuators.efficiency, [1.0, 0.9, 1.0])
    assert scenario.actuators.delay_samples == 2


def with_harris_gusts(document: dict[str, Any]) -> None:
    document["environment"]["wind"]["gusts"] = "harris"


def with_drag(ship: dict[str, Any]) -> None:
    hull = {"breadth_m": 18.0, "draught_m": 5.0, "submerged_m2": 370.0, "current_x_m": 2.0}
    ship |= {"drag": "cross_flow", "capability": hull}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change", "vessel"),
    [
        ("thruster_loss", lambda s: None, lambda v: None),
        ("squall", lambda s: None, lambda v: None),
        ("weather", lambda s: None, lambda v: None),
        ("weather", with_harris_gusts, lambda v: None),
        ("weather", lambda s: None, with_drag),
        ("squall", lambda s: None, with_drag),
        ("waves", lambda s: None, lambda v: None),
        ("waves_passive", lambda s: None, lambda v: None),
    ],
)
def test_a_model_ship_sails_the_full_size_run_at_its_scale(
    name: str, change: Change, vessel: Change
) -> None:
    """A ship scaled 1 : 70 by hand makes the same run, lengths /70 and times /√70."""
    ratio = 70.0
    full = changed(name, change, vessel)

    def shrink(ship: dict[str, Any]) -> None:
        vessel(ship)
        m, mx, mxx = ratio**-3, ratio**-4, ratio**-5
        mass = np.array([[m, m, mx], [m, m, mx], [mx, mx, mxx]])
        ship["inertia"] = (np.array(ship["inertia"]) * mass).tolist()
        ship["damping"] = (np.array(ship["damping"]) * mass * math.sqrt(ratio)).tolist()
        limits = ship["limits"]
        for key, factor in (("surge_N", m), ("sway_N", m), ("yaw_Nm", mx)):
            limits[key] = [value * factor for value in limits[key]]
        rates = np.array(limits["rate_max_N_per_s"]) * [m, m, mx] * math.sqrt(ratio)
        limits["rate_max_N_per_s"] = rates.tolist()
        ship["model_scale"] = ratio
        ship["length_m"] /= ratio
        for area in ("frontal_m2", "lateral_m2"):
            ship["windage"][area] /= ratio**2
        ship["reflection"]["breadth_m"] /= ratio
        for key, value in ship.get("capability", {}).items():
            ship["capability"][key] = value / ratio ** (2 if key.endswith("_m2") else 1)

    model = changed(name, change, shrink)
    assert model.sample_s == pytest.approx(0.3 / math.sqrt(70.0))
    large, small = solve_loop_exactly(full), solve_loop_exactly(model)
    # The loop amplifies rounding by what it does not damp; a nanometre of a metre is plenty.
    np.testing.assert_allclose(
        small.state[:, 3:] * [ratio, ratio, 1.0], large.state[:, 3:], rtol=0, atol=1e-7
    )
    np.testing.assert_allclose(
        small.tau * [ratio**3, ratio**3, ratio**4], large.tau, rtol=0, atol=1.0
    )


CASCADE = "thrusters_cascade"


def of_thrusters(document: dict[str, Any], **keys: Any) -> None:
    document["controller"]["thrusters"].update(keys)


def delete(table: str, key: str) -> Change:
    return lambda document: document[table].pop(key)


@pytest.mark.parametrize(
    ("name", "change", "vessel", "words"),
    [
        ("weather", lambda s: None, lambda v: v.update(windage=None), "windage"),
        ("weather", lambda s: None, lambda v: v.update(reflection=None), "reflection"),
        ("calm", lambda s: s["estimator"].update(kind="kalman"), None, "peak_period_s"),
        ("calm", lambda s: s["estimator"].update(kind="kalmann"), None, "kalman"),
        ("weather", lambda s: s["environment"]["wind"].update(gusts="davenport"), None, "norsok"),
        ("weather", lambda s: s["environment"]["waves"].update(tp_s=0.0), None, "waves.tp_s"),
        ("squall", lambda s: s["environment"]["squalls"][0].update(rise_s=90.0), None, "hold_unt"),
        ("mismatch", lambda s: s["plant"].update(mass_percent=-100.0), None, "mass_percent"),
        ("mismatch", lambda s: s["plant"].update(thrust_loss_percent=[0, 101.0, 0]), None, "loss"),
        ("thruster_loss", lambda s: s["faults"][0].update(limit_share=[1, 2.0, 1]), None, "share"),
        ("move_filtered", lambda s: s["reference"]["filter"].update(period_s=-1.0), None, "period"),
        ("watch_circle", lambda s: s["controller"].update(outputs={}), None, "radius_m"),
        ("turn", lambda s: s["controller"].update(amplitude="weak"), None, "reachable"),
        ("turn", lambda s: s["controller"].update(terminal="lqr"), None, "riccati"),
        (CASCADE, lambda s: of_thrusters(s, slack_weight_relative=None), None, "found no slack"),
        (
            CASCADE,
            lambda s: of_thrusters(s, thrust_weight_relative=0.0),
            None,
            "controller.thrusters: found thrust_weight_relative = 0; allowed: slack_weight_rel",
        ),
        (CASCADE, lambda s: of_thrusters(s, allocation="lp"), None, "pseudo_inverse"),
        (
            CASCADE,
            lambda s: of_thrusters(s, azimuth_turning=True),
            None,
            'found azimuth_turning = true with kind = "cascade"; allowed: azimuth_turning with',
        ),
        (
            CASCADE,
            lambda s: s["controller"].pop("thrusters"),
            None,
            'controller: found kind = "cascade" without [controller.thrusters]; allowed: both',
        ),
        (
            CASCADE,
            lambda s: s["controller"].pop("move_weight_relative"),
            None,
            "found neither move_weight nor move_weight_relative; allowed: one of the two",
        ),
        (
            CASCADE,
            lambda s: s["controller"].update(kind="forces"),
            None,
            'allowed: this table with kind = "thrusters" or "cascade"',
        ),
        (CASCADE, lambda s: None, lambda v: v.update(thrusters=[]), "cascade"),
        (
            "thrusters",
            lambda s: of_thrusters(s, allocation="qp"),
            None,
            'found allocation with kind = "thrusters"; allowed: allocation with kind = "cascade"',
        ),
        (
            "thrusters",
            lambda s: s["controller"].update(move_weight=[1.0, 1.0, 1.0]),
            None,
            'controller: found move_weight with kind = "thrusters"; allowed: move_weight_relative',
        ),
        (
            "thrusters",
            lambda s: s["controller"].update(limits="attainable"),
            None,
            'controller.limits: found "attainable"; allowed: "box" with kind = "thrusters"',
        ),
        (
            "thrusters",
            lambda s: s["controller"].update(terminal="riccati"),
            None,
            'controller.terminal: found "riccati"; allowed: "none" with kind = "thrusters"',
        ),
        # The fault at fault is the second in the file and the first in time.
        (
            "thrusters_loss",
            lambda s: s["faults"].append({"at_s": 1.5, "lost": ["bow 9"]}),
            None,
            "my.toml: [[faults]] number 2, key lost: found 'bow 9'",
        ),
        (
            "calm",
            lambda s: None,
            lambda v: v["limits"].update(yaw_Nm=[2.0, -1.0]),
            "limits.yaw_Nm: found [2.0, -1.0]",
        ),
    ],
)
def test_bad_weather_ships_and_faults_are_refused_in_one_line(
    name: str, change: Change, vessel: Change | None, words: str
) -> None:
    with pytest.raises(DpbenchError) as caught:
        changed(name, change, vessel)
    text = str(caught.value)
    assert words in text
    assert ".toml" in text
    assert "\n" not in text
