"""Other values of a scenario's keys, against a file written with those values by hand."""

from pathlib import Path

import numpy as np
import pytest

from dpbench.errors import InputError
from dpbench.scenario.dotted_keys import read_value_of_dotted_key
from dpbench.scenario.problem_files import find_folder_of_shipped_problems
from dpbench.scenario.scenario import (
    build_or_reuse_scenario,
    build_scenario_from_documents,
    load_scenario,
)
from dpbench.scenario.variation import copy_scenario_with_values, differ_in_behaviour_within_steps


def _by_hand(tmp_path: Path, name: str, *edits: tuple[str, str]) -> Path:
    """A shipped scenario's file with some of its text replaced."""
    text = (find_folder_of_shipped_problems() / "scenarios" / f"{name}.toml").read_text(
        encoding="utf-8"
    )
    for old, new in edits:
        assert text.count(old) == 1, f"{old} stands once in {name}"
        text = text.replace(old, new)
    path = tmp_path / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_varied_scenario_is_the_file_with_these_values(tmp_path: Path) -> None:
    values = {
        "environment.wind.speed_mps": 14.5,
        "environment.seed": 7,
        "controller.prediction_horizon": 30,
        "controller.output_weight.2": 2500.0,
    }
    edited = _by_hand(
        tmp_path,
        "weather",
        ("speed_mps = 10.7", "speed_mps = 14.5"),
        ("seed = 1", "seed = 7"),
        ("prediction_horizon = 60", "prediction_horizon = 30"),
        ("[1.0, 1.0, 3000.0]", "[1.0, 1.0, 2500.0]"),
    )
    assert (
        copy_scenario_with_values(load_scenario("weather"), values, "test").files
        == load_scenario(edited).files
    )


def test_keys_of_the_vessel_and_another_vessel() -> None:
    base = load_scenario("rough")
    other = copy_scenario_with_values(base, {"vessel": "supply_mss"}, "test")
    assert other.files["vessel"] == load_scenario("rough@supply_mss").files["vessel"]
    heavier = copy_scenario_with_values(base, {"vessel.limits.surge_N.1": 5e5}, "test")
    assert heavier.vessel.tau_max[0] == 5e5 and base.vessel.tau_max[0] != 5e5
    np.testing.assert_array_equal(heavier.vessel.M, base.vessel.M)


def test_newer_keys_that_a_file_leaves_out_can_be_set(tmp_path: Path) -> None:
    added = "\n[plant]\nthruster_lag_s = 1.5\n\n[start]\nsway_mps = 0.2\n"
    path = _by_hand(tmp_path, "weather")
    base = load_scenario(path)
    path.write_text(path.read_text(encoding="utf-8") + added, encoding="utf-8")
    values = {"plant.thruster_lag_s": 1.5, "start.sway_mps": 0.2}
    varied = base.with_keys(values)
    assert varied.files["scenario"] == load_scenario(path).files["scenario"]
    assert varied.actuators is not None and base.actuators is None
    for key, default in (("plant.thruster_lag_s", 0.0), ("vessel.drag", "linear")):
        assert read_value_of_dotted_key(base.files, key, "test") == default
    again = varied.with_keys({"plant.thruster_lag_s": 0.0, "start.sway_mps": 0.0})
    assert again.files["scenario"] == base.files["scenario"]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"plant.thruster_lags": 1.0}, "plant.thruster_lags.*thruster_lag_s"),
        ({"environment.wind.sped_mps": 3.0}, "environment.wind.sped_mps.*speed_mps"),
        ({"environment.squalls.0.start_s": 3.0}, "no table environment.squalls: add"),
        ({"environment.noise.position_m": 3.0}, "no table environment.noise: add the whole table"),
        ({"environment.seed.x": 3}, "the key 'x' of environment.seed, which is a single value"),
        ({"environment.wind.speed_mps": "much"}, "speed_mps.*'much'"),
        ({"controller.control_horizon": 70}, "control_horizon.*70"),
        ({"vessel": "titanic"}, "vessel name.*titanic"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(values: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        copy_scenario_with_values(load_scenario("weather"), values, "study")


def test_own_values_and_what_has_none() -> None:
    base = load_scenario("weather")
    assert read_value_of_dotted_key(base.files, "environment.waves.hs_m", "x") == 2.1
    assert read_value_of_dotted_key(base.files, "vessel", "x") == "supply_fs99"
    assert read_value_of_dotted_key(base.files, "controller.output_weight.1", "x") == 1.0
    with pytest.raises(InputError, match="seeed"):
        read_value_of_dotted_key(base.files, "environment.seeed", "x")


@pytest.mark.parametrize(
    ("scenario", "key", "pair", "steps", "expected"),
    [
        ("weather", "environment.seed", (1, 2), 50, True),
        ("rough", "environment.seed", (1, 2), 50, False),
        ("rough", "title", ("a", "b"), 50, False),
        ("rough", "controller.tuning", ("a", "b"), 50, False),
        ("rough", "start.east_m", (1.0, 2.0), 50, True),
        ("rough", "controller.move_weight_relative.0", (0.2, 0.3), 50, True),
        ("weather", "vessel.windage.frontal_m2", (200.0, 300.0), 50, True),
        ("rough", "environment.ramp_s", (0.0, 40.0), 50, True),
    ],
)
def test_whether_a_key_makes_a_difference(
    scenario: str, key: str, pair: tuple[object, object], steps: int, expected: bool
) -> None:
    base = load_scenario(scenario)
    one, other = (copy_scenario_with_values(base, {key: value}, "test") for value in pair)
    assert differ_in_behaviour_within_steps(one, other, steps) is expected


def test_weather_after_the_last_step_makes_no_difference() -> None:
    base = load_scenario("squall")
    key = "environment.squalls.0.start_s"
    one, other = (
        copy_scenario_with_values(base, {key: start_s}, "test") for start_s in (10.0, 12.0)
    )
    assert not differ_in_behaviour_within_steps(one, other, round(5.0 / base.sample_s))
    assert differ_in_behaviour_within_steps(one, other, round(20.0 / base.sample_s))


@pytest.mark.parametrize("name", ["weather", "waves", "rough"])
def test_a_scenario_that_is_made_once_is_made_for_all_seas(name: str) -> None:
    base = load_scenario(name)
    for seed in (5, 0, 6):
        files = copy_scenario_with_values(base, {"environment.seed": seed}, "test").files
        once, alone = build_or_reuse_scenario(files), build_scenario_from_documents(files)
        assert once.files == files and once.environment.seed == seed
        assert not differ_in_behaviour_within_steps(once, alone, 50)
        assert differ_in_behaviour_within_steps(once, base, 50) == base.environment.is_random
