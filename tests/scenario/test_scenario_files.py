"""Scenario and vessel files of one's own: where they are found, units, and what mistakes say."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dpbench.errors import InputError, UnknownNameError
from dpbench.scenario.problem_files import (
    find_folder_of_shipped_problems,
    list_shipped_problem_names,
)
from dpbench.scenario.scenario import build_scenario_from_documents, load_scenario, load_vessel


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes a shipped file under a new name with one piece of its text replaced."""

    def written(kind: str, name: str, old: str = "", new: str = "") -> Path:
        text = (find_folder_of_shipped_problems() / kind / f"{name}.toml").read_text(
            encoding="utf-8"
        )
        assert old in text
        path = tmp_path / f"my_{kind[:-1]}.toml"
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        return path

    return written


def test_a_file_of_ones_own_needs_no_installation(write: Callable[..., Path]) -> None:
    write("vessels", "supply_tmr")
    path = write("scenarios", "calm", '"supply_fs99"', '"my_vessel.toml"')
    scenario = load_scenario(path)
    assert (scenario.name, scenario.vessel.id) == ("my_scenario", "my_vessel")
    np.testing.assert_array_equal(scenario.vessel.M, load_vessel("supply_tmr").M)
    assert load_scenario(str(path)).steps == 1000


def test_degrees_and_kilonewtons_in_files_are_radians_and_newtons_in_the_run(
    write: Callable[..., Path],
) -> None:
    path = write("scenarios", "paper", "heading_deg = 0.0", "heading_deg = 90.0")
    assert load_scenario(path).start[2] == pytest.approx(np.pi / 2, rel=1e-15)
    path = write("scenarios", "paper", "[controller]", "[controller]\nmodel_heading_deg = -45.0")
    scenario = load_scenario(path)
    assert scenario.controller.psi0_rad == pytest.approx(-np.pi / 4, rel=1e-15)
    # One sample of surge speed carries the ship north and west alike.
    A = scenario.problem.model.A
    assert A[3, 0] == pytest.approx(-A[4, 0], rel=1e-12)


def test_a_start_under_way_is_in_SI_and_scales_with_the_ship(
    write: Callable[..., Path],
) -> None:
    """Speeds become SI; at 1 : 70 the Froude number u/√(gL) and the turn in a length r·L/u stay."""
    speeds = "surge_mps = 0.6\nsway_mps = -0.2\nyaw_degps = 0.5\n\n[environment]"
    path = write("scenarios", "paper", "[environment]", speeds)
    ship, model = load_scenario(path), load_scenario(f"{path}@cybership2")
    np.testing.assert_allclose(ship.velocity, [0.6, -0.2, np.pi / 360], rtol=1e-15)
    np.testing.assert_array_equal(ship.first_state, np.append(ship.velocity, ship.start))
    np.testing.assert_allclose(model.velocity[:2], ship.velocity[:2] / 70**0.5, rtol=1e-12)
    turn = ship.velocity[2] / ship.velocity[0]
    assert model.velocity[2] / 70 / model.velocity[0] == pytest.approx(turn, rel=1e-12)
    again = build_scenario_from_documents(json.loads(json.dumps(ship.files)))
    np.testing.assert_array_equal(again.velocity, ship.velocity)


def test_rest_is_not_written() -> None:
    files = load_scenario("paper").files
    assert files["scenario"]["start"] == {"north_m": 1.2, "east_m": 1.3, "heading_deg": 0.0}
    np.testing.assert_array_equal(build_scenario_from_documents(files).velocity, 0.0)


BAD_SCENARIOS = [
    ("[controller]", "[start]\nsurge_mps = 340.0\n[controller]", "start.surge_mps", "340.0", "100"),
    ("[controller]", "[wind]\n[controller]", "wind", "unknown key", "one of title, "),
    ("[environment]", "[controller.environment]", "controller.environment", "unknown", "one of "),
    (
        "-20.0, 55.0, 500.0]",
        "-20.0, 55.0]",
        "environment.mean_kN",
        "[-20.0, 55.0]",
        "an array of 3 entries",
    ),
    ("sample_s = 0.3", "sample_s = true", "sample_s", "True", "number"),
    ("= 5", "= 5.5", "controller.control_horizon", "5.5", "whole number"),
    ("500.0]", "nan]", "environment.mean_kN, entry 3", "nan", "finite"),
    ("sample_s = 0.3", "sample_s = -0.3", "sample_s", "-0.3", "0.0001 or more"),
    ("duration_s = 300.0", "duration_s = 0.1", "duration_s", "0.1", "samples of 0.3 s"),
    ("[150.0, 120.0", "[150.0, 0.0", "environment.period_s, entry 2", "0.0", "above 0"),
    ("= 5", "= 31", "controller.control_horizon", "31", "1 to prediction_horizon (30)"),
    (
        "[1.0, 1.0, 100.0]",
        "[1.0, -1.0, 1.0]",
        "controller.output_weight, entry 2",
        "-1.0",
        "0 or more",
    ),
    ("[1e-10, 1e-10", "[1e-10, 0.0", "controller.move_weight, entry 2", "0.0", "above 0"),
    (
        "move_weight =",
        "move_weight_relative = [1.0, 1.0, 1.0]\nmove_weight =",
        "controller",
        "both move_weight and move_weight_relative",
        "one of the two",
    ),
]


LATE_FAULT = "[controller]", "[[faults]]\nat_s = 300.0\nlimit_share = [0.5, 0.5, 0.5]\n[controller]"
BAD_SCENARIOS += [
    (*LATE_FAULT, "[[faults]] number 1, key at_s", "300", "before the end of the run, 300 s")
]


BAD_VESSELS = [
    ("3.7454e9]]", "3.7454e9], [1.0, 1.0, 1.0]]", "inertia", "[1.0, 1.0, 1.0]", "3 entries"),
    ("[[5.3122e6", "[[-5.3122e6", ": inertia:", "-5.31e+06", "positive definite"),
    ("4.1894e8", "0.0", ": damping:", "eigenvalue", "positive definite"),
    ("sway_N = [-417000.0", "sway_N = [1000.0", "limits.sway_N", "[1000.0, 417000.0]", "a minimum"),
    (
        "surge_N = [-980000.0,",
        "surge_N = [1.0, -2.0] #",
        "limits.surge_N",
        "[1.0, -2.0]",
        "a minimum",
    ),
    ("[109120.0", "[0.0", "limits.rate_max_N_per_s, entry 1", "0.0", "above 0"),
    ("inertia =", "inertia_bis =", "", "", "either inertia and damping"),
    ("inertia =", "mass_kg = 6e6\ninertia =", "", "mass_kg", "either inertia and damping"),
    ("length_m = 76.2", "length_m = 1e-320", "length_m", "1e-320", "0.001"),
]


@pytest.mark.parametrize(
    ("kind", "old", "new", "key", "found", "allowed"),
    [*(("scenarios", *bad) for bad in BAD_SCENARIOS), *(("vessels", *bad) for bad in BAD_VESSELS)],
)
def test_a_mistake_in_a_file_is_one_line(
    kind: str, old: str, new: str, key: str, found: str, allowed: str, write: Callable[..., Path]
) -> None:
    calls: list[tuple[Callable[[Path], object], Path]] = []
    if kind == "vessels":
        calls = [(load_scenario, write("scenarios", "calm", '"supply_fs99"', '"my_vessel.toml"'))]
    path = write(kind, {"scenarios": "calm", "vessels": "supply_fs99"}[kind], old, new)
    calls += [(load_scenario if kind == "scenarios" else load_vessel, path)]
    for load, file in calls:
        with pytest.raises(InputError) as caught:
            load(file)
        text, error = str(caught.value), caught.value
        assert "\n" not in text
        assert text.startswith(str(path)) and key in text.removeprefix(str(path))
        assert found in str(error.found) and allowed in error.allowed
        assert f"found {' '.join(str(error.found).split())}; allowed: " in text


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("x_m = 37.0", "x_m = 60.0", "thruster bow 1: x_m"),
        ("[capability]", "[capability]\nlateral_x_m = 60.0", "capability.lateral_x_m"),
        ("[capability]", "[capability]\nskegs = [[60.0, 0.0], [-30.0, 0.0]]", "capability.skegs"),
    ],
)
def test_a_place_ahead_of_the_ship_is_one_line(
    old: str, new: str, key: str, write: Callable[..., Path]
) -> None:
    """`osv` is 83 m long: 49.8 m from midships are 0.6 of it."""
    path = write("vessels", "osv", old, new)
    with pytest.raises(InputError, match=rf"{key}: found 60; allowed: -49.8 to 49.8 m from"):
        load_vessel(path)


@pytest.mark.parametrize(
    ("name", "hint"),
    [("papr", "paper, "), ("Rough", "rough, "), ("zzz", ""), ("", ""), ("x" * 300, "")],
)
def test_an_unknown_scenario_name_lists_the_nearest(name: str, hint: str) -> None:
    with pytest.raises(UnknownNameError) as caught:
        load_scenario(name)
    assert repr(name)[:78] in str(caught.value)
    assert caught.value.allowed.startswith(hint)
    known = list_shipped_problem_names("scenarios")
    assert sum(word in known for word in re.split("[ ,]+", caught.value.allowed)) == 3
    assert f"… {len(known) - 3} more: `list_scenarios()`" in caught.value.allowed


def test_a_scenario_takes_another_vessel_by_name(write: Callable[..., Path]) -> None:
    scenario = load_scenario("rough@osv")
    assert (scenario.name, scenario.vessel.id) == ("rough@osv", "osv")
    path = write("scenarios", "calm", '"supply_fs99"', '"suply_fs99"')
    for name, where in (("rough@osw", "rough@osw"), (path, path.name)):
        with pytest.raises(UnknownNameError, match=f"{where}: vessel: .*(osv|supply_fs99)"):
            load_scenario(name)


def test_a_vessel_with_drag_has_it_in_every_scenario(write: Callable[..., Path]) -> None:
    """The true ship has it, in water at rest too; the model of the controller is the same."""
    path = write("vessels", "osv", 'drag = "cross_flow"\n', "")
    plain, scenario = load_scenario(f"calm@{path}"), load_scenario("calm@osv")
    assert scenario.true_ship.drag is not None and plain.true_ship.drag is None
    still = np.zeros(6)
    table = scenario.environment.build_weather_table_at_stages(2, 0.3, 10)
    np.testing.assert_array_equal(table[..., 3:], np.broadcast_to(still, (2, 21, 6)))
    np.testing.assert_array_equal(scenario.problem.model.A, plain.problem.model.A)
    assert "drag" not in plain.files["vessel"] and scenario.files["vessel"]["drag"] == "cross_flow"


def test_drag_without_a_hull_is_refused(write: Callable[..., Path]) -> None:
    """In the line of any other mistake."""
    path = write("vessels", "supply_fs99", "length_m =", 'drag = "cross_flow"\nlength_m =')
    with pytest.raises(InputError, match="whose hull it uses"):
        load_vessel(path)
