"""Each ship result is stated with its realisations, sensors, estimator, lag, delay and mismatch."""

import json
import math
from typing import Any

import pytest

from dpbench.analysis.verdict.ship_results import ShipResult, find_ship_results
from dpbench.report.documents.markdown import make_report_markdown
from dpbench.report.report import Report
from dpbench.report.ship.conditions_text import (
    caution_on_ideal_sensors,
    describe_conditions_of_ships,
    list_conditions,
)
from dpbench.scenario.scenario import load_scenario
from tests.conftest import MadeRecords

IDEAL = (
    "exact sensors, no first-order wave motion, no state estimator, no thruster lag, no delay, no "
    "model mismatch"
)
FILTERED = {
    "environment": {"noise": {"position_m": 0.3, "heading_deg": 0.1}},
    "estimator": {"kind": "kalman"},
    "plant": {
        "thruster_lag_s": 2.5,
        "delay_samples": 2,
        "mass_percent": 10.0,
        "damping_percent": -20.0,
    },
}


class _Run:
    """A run that has only the documents of its scenario."""

    def __init__(self, files: dict[str, Any]) -> None:
        self.scenario_documents = files
        self.study = ""
        self.exact_steps = 10.0
        self.exact_left_s = math.nan
        self.exact_offset_end_m = self.exact_heading_end_deg = 0.0
        self.station_radius_m = 5.0


def _ship(name: str, values: dict[str, Any], study: str = "") -> Any:
    files = load_scenario("paper").files
    run: Any = _Run({**files, "scenario": {**files["scenario"], **values}})
    run.study = study
    return ShipResult(name, run)


def _text(ship: Any) -> str:
    return ", ".join(list_conditions(ship.run))


def test_conditions_follow_from_the_scenario() -> None:
    assert _text(_ship("paper", {})) == IDEAL
    assert _text(_ship("paper", FILTERED)) == (
        "measurement noise (standard deviation 0.3 m, 0.1°), no first-order wave motion, Kalman "
        "filter, thruster lag 2.5 s, delay of 2 samples, with model mismatch (mass +10 %; damping "
        "-20 %)"
    )
    observer = {"estimator": {"kind": "passive", "wave_filter": False}}
    assert "passive observer without wave filter" in list_conditions(_ship("a", observer).run)
    losses = {"plant": {"thrust_loss_percent": [10.0, 0.0, 5.0]}}
    assert _text(_ship("a", losses)).endswith("with model mismatch (thrust loss 10/0/5 %)")
    linear = _ship("a", {})
    linear.run.scenario_documents["vessel"] = {"drag": "linear"}
    assert _text(linear) == IDEAL


def test_exact_sensors_of_a_ship_of_ones_own_call_for_caution() -> None:
    ships = [_ship("calm", {}), _ship("turn", {})]
    assert caution_on_ideal_sensors(ships) == []
    for ship in ships:
        ship.run.scenario_documents["vessel_name"] = "my_ship"
    (text,) = caution_on_ideal_sensors(ships)
    assert text.startswith("Exact sensors and no first-order wave motion in every scenario: ")
    moving = {"environment": {"waves": {"motion": {}}}}
    for values in (FILTERED, moving):
        assert caution_on_ideal_sensors([*ships, _ship("real", values)]) == []


def test_scenarios_with_equal_conditions_are_named_together() -> None:
    ships = [_ship("calm", {}), _ship("real", FILTERED), _ship("turn", {})]
    assert describe_conditions_of_ships(ships) == (
        "Conditions in `calm` and `turn`: exact sensors, no state estimator, no thruster lag, no "
        "delay, no model mismatch. Conditions in `real`: one realisation (seed 0), measurement "
        "noise (standard deviation 0.3 m, 0.1°), Kalman filter, thruster lag 2.5 s, delay of 2 "
        "samples, with model mismatch (mass +10 %; damping -20 %). Conditions of every result: no "
        "first-order wave motion."
    )
    assert describe_conditions_of_ships(ships[:1]) == f"Conditions of this result: {IDEAL}."
    assert describe_conditions_of_ships(ships[::2]) == f"Conditions of every result: {IDEAL}."
    assert describe_conditions_of_ships([]) == ""


def test_a_study_of_several_conditions_is_named_in_each() -> None:
    seas = [_ship("sea", {}, "lags"), _ship("sea", {"plant": {"thruster_lag_s": 1.0}}, "lags")]
    text = describe_conditions_of_ships(seas)
    assert text.startswith(
        "Conditions in points of `lags`: no thruster lag. Conditions in points of `lags`: thruster "
        "lag 1 s. Conditions of every result: "
    )


def test_realisations_and_seed_of_random_weather_are_named() -> None:
    """These are gusts, waves and noise; without them, no seed matters."""
    noise, gusts = {"noise": {"position_m": 0.3}}, {"wind": {"speed_mps": 9.0}}
    still = {"hs_m": 1.0, "drift": False}
    steady = {"wind": {"speed_mps": 9.0, "gusts": "none"}, "waves": still}
    moving = {"waves": {**still, "motion": {}}}
    for weather in (noise, gusts, {"waves": {"hs_m": 1.0}}, moving):
        ship = _ship("a", {"environment": {**weather, "seed": 7}})
        text = describe_conditions_of_ships(
            [ship, _ship("b", ship.run.scenario_documents["scenario"])]
        )
        assert text.startswith("Conditions of every result: one realisation (seed 7), ")
    calm = _ship("calm", {"environment": {**steady, "seed": 7}})
    assert describe_conditions_of_ships([calm]) == f"Conditions of this result: {IDEAL}."
    unseeded = _ship("gusty", {"environment": gusts})
    assert describe_conditions_of_ships([calm, unseeded]) == (
        f"Conditions in `gusty`: one realisation (seed 0). Conditions of every result: {IDEAL}."
    )
    seas = [_ship("a", {"environment": {**gusts, "seed": i % 3}}, "seas") for i in range(6)]
    text = describe_conditions_of_ships(seas)
    assert text == f"Conditions of every result: 3 realisations, {IDEAL}."


@pytest.mark.parametrize("count", [12, 13])
def test_a_long_group_is_counted(count: int) -> None:
    ships = [_ship(f"s{i}", {}) for i in range(count)] + [_ship("real", FILTERED)]
    assert ("`s11` and 1 more scenario:" in describe_conditions_of_ships(ships)) == (count == 13)


def test_the_report_has_the_conditions_of_its_ships(records: MadeRecords) -> None:
    records.loop("daqp", "paper")
    (ship,) = find_ship_results(records.view())
    assert describe_conditions_of_ships([ship]) == f"Conditions of this result: {IDEAL}."


@pytest.mark.parametrize(
    ("scenario", "limited", "is_named"),
    [("thrusters", False, True), ("thrusters", True, False), ("weather", False, False)],
)
def test_commanded_azimuths_turn_freely_unless_the_controller_limits_it(
    scenario: str, limited: bool, is_named: bool
) -> None:
    files: dict[str, Any] = json.loads(json.dumps(load_scenario(scenario).files))
    if limited:
        files["scenario"]["controller"]["thrusters"]["azimuth_turning"] = True
    run: Any = _Run(files)
    assert ("no rate limit on azimuth angles" in list_conditions(run)) == is_named


@pytest.mark.parametrize("vessel", ["ratownik", "my_ship"])
def test_the_report_warns_of_wash_on_a_ship_of_ones_own(records: MadeRecords, vessel: str) -> None:
    files = {**records.scenario("thrusters").files, "vessel_name": vessel}
    records.loop("daqp", "thrusters", cell=json.dumps({"scenario": files}))
    report = Report.from_results(records.results())
    wash = report.recommendation.ship.wash
    assert wash.startswith("Closed loops do not model the wash of") == (vessel == "my_ship")
    caution, words = dict(report.summary_rows()).get("caution", ""), wash.replace("`", "")
    assert words in caution and caution.startswith("Exact sensors ") == (vessel == "my_ship")
    assert wash in " ".join(make_report_markdown(report).split())
