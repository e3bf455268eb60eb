"""`dpbench tune` from its arguments to the scenario it writes."""

import csv
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpbench.bench.run.exact_loop import compute_station_metrics, solve_loop_exactly
from dpbench.cli.main import main
from dpbench.errors import InputError
from dpbench.locks import Holder
from dpbench.scenario.own_ship import make_environment_of_dp_number
from dpbench.scenario.scenario import load_scenario
from dpbench.scenario.variation import copy_scenario_with_values, write_scenario_and_own_ship_files
from dpbench.tuning.search import Trial
from dpbench.tuning.tune_controller import (
    NO_PROMISE,
    WORSE_IN_TEST,
    ControllerTuning,
    LoopScore,
    change_controller,
    choose_controller,
    draw_realisations,
    find_pareto_front,
    make_unchanged_options,
    rate_controller,
    tune_controller,
)

SMALL = ["--trials", "6", "--steps", "60", "--realisations", "1"]


def _trial(share: float, wear_per_h: float) -> Trial[LoopScore]:
    return Trial({"share": share}, np.zeros(1), LoopScore(share, wear_per_h))


def _read_rows(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "tune.csv").read_text().splitlines()))


def test_the_front_has_what_nothing_beats_in_both() -> None:
    trials = [_trial(*score) for score in [(0.5, 9), (0.9, 2), (0.6, 9), (0.3, 12), (0.7, 5)]]
    assert [trial.score.share for trial in find_pareto_front(trials)] == [0.3, 0.5, 0.7, 0.9]


@pytest.mark.parametrize(("margin", "share"), [(0.8, 0.7), (0.4, 0.3), (0.1, 0.3)])
def test_least_wear_within_the_margin_is_chosen_else_the_least_offset(
    margin: float, share: float
) -> None:
    trials = [_trial(*score) for score in [(0.5, 9), (0.9, 2), (0.3, 12), (0.7, 5)]]
    assert choose_controller(trials, margin).score.share == share


@pytest.mark.parametrize(
    ("share", "margin", "shown"),
    [(0.7, 0.7, "70 %"), (0.7004, 0.7, "70.04 %"), (0.699, 0.7, "70 %"), (0.0014, 0.001, "0.14 %")],
)
def test_a_rounded_offset_is_shown_on_its_side_of_the_margin(
    share: float, margin: float, shown: str
) -> None:
    trial = _trial(share, 9.0)
    tuning = ControllerTuning([trial], trial, trial.score, trial.score, margin, "seas", ())
    held = "within" if share <= margin else "NOT within"
    assert any(f"{held} the margin: offset {shown}, wear 9" in line for line in tuning.lines)
    assert f"within {100.0 * margin:g} % of the limits" in tuning.lines[1]


@pytest.mark.parametrize(("own", "is_named"), [((0.3, 8.0), True), ((0.3, 9.5), False)])
def test_an_original_controller_that_is_no_worse_in_the_test_is_named(
    own: tuple[float, float], is_named: bool
) -> None:
    """The chosen one has an offset of 31 % and a wear of 9 there."""
    trials, tested = [_trial(0.73, 9.0), _trial(0.72, 22.0)], _trial(0.31, 9.0).score
    tuning = ControllerTuning(trials, trials[1], tested, _trial(*own).score, 0.8, "seas", ())
    assert (WORSE_IN_TEST in tuning.lines) is is_named


@pytest.mark.parametrize("name", ["weather", "thrusters", "thrusters_cascade", "paper_tight"])
def test_factors_of_one_leave_the_controller_as_it_is(name: str) -> None:
    scenario = load_scenario(name)
    assert change_controller(scenario, make_unchanged_options(scenario)).files == scenario.files


def test_a_larger_increment_weight_wears_less_in_the_same_sea() -> None:
    """The offset is that of the reference loop; a slower controller lets the ship off more."""
    scenario = load_scenario("weather")
    seas = draw_realisations([scenario], [], 0, 1, 200)
    own = make_unchanged_options(scenario)
    first = rate_controller(own, seas)
    exact = compute_station_metrics(scenario, solve_loop_exactly(scenario.truncate(200)), 200)
    assert first.share == pytest.approx(
        max(exact["exact_offset_max_m"] / 5.0, exact["exact_heading_max_deg"] / 5.0), rel=1e-4
    )
    slow = rate_controller({**own, "increment_weight": 1000.0}, seas)
    assert slow.wear_per_h < first.wear_per_h and slow.share > first.share


def _write_calm(folder: Path) -> Path:
    """Write `weather` without wind, waves and current, 40 steps long."""
    weather = load_scenario("weather")
    values: dict[str, Any] = {f"environment.{part}": None for part in ("wind", "waves", "current")}
    values |= {"duration_s": 40 * weather.sample_s}
    calm = copy_scenario_with_values(weather, values, "calm")
    write_scenario_and_own_ship_files(calm.files, folder / "calm.toml")
    return folder / "calm.toml"


def test_of_several_scenarios_the_largest_offset_counts_and_the_mean_wear(tmp_path: Path) -> None:
    """In any order; each loop is as long as its scenario."""
    scenarios = [load_scenario("weather"), load_scenario(_write_calm(tmp_path))]
    own = make_unchanged_options(scenarios[0])
    alone = [rate_controller(own, draw_realisations([s], [], 0, 1, 60)) for s in scenarios]
    assert alone[0].share > alone[1].share
    assert {one.largest_in for one in alone} == {""}
    for order in (scenarios, scenarios[::-1]):
        seas = draw_realisations(order, [], 0, 1, 60)
        assert sorted(sea.steps for sea in seas) == [40, 60]
        both = rate_controller(own, seas)
        assert (both.share, both.largest_in) == (alone[0].share, "weather")
        assert both.wear_per_h == pytest.approx(np.mean([one.wear_per_h for one in alone]))


@pytest.mark.parametrize(
    ("title", "tuned_title"),
    [
        ("own in the sea of DP capability number 7", "own in the sea of DP capability number 6"),
        ("own", "own, in the sea of DP capability number 6"),
    ],
)
def test_the_hardest_of_the_tried_seas_is_written(
    title: str, tuned_title: str, tmp_path: Path
) -> None:
    """From the direction of the scenario's wind, with its wave motion and noise."""
    values: dict[str, Any] = {
        "title": title,
        "environment.wind.from_deg": 330.0,
        "environment.waves.motion": {"along_m_per_m": 0.5},
        "environment.noise": {"position_m": 0.3, "heading_deg": 0.1},
    }
    changed = copy_scenario_with_values(load_scenario("weather"), values, "own")
    write_scenario_and_own_ship_files(changed.files, tmp_path / "own.toml")
    own = load_scenario(tmp_path / "own.toml")
    tuning = tune_controller(
        tmp_path / "own.toml", seas="6,5", trials=1, steps=5, realisations=1, out=tmp_path / "out"
    )
    written = load_scenario(tmp_path / "out" / "own_tuned.toml").files["scenario"]
    own_sea, sea = own.files["scenario"]["environment"], written["environment"]
    hardest = make_environment_of_dp_number(6, from_deg=330.0).model_dump()
    hardest["waves"]["motion"] = own_sea["waves"]["motion"]
    assert sea == hardest | {"noise": own_sea["noise"], "seed": own_sea["seed"] + 1}
    assert written["title"].startswith(f"{tuned_title}, {'unchanged' * tuning.is_unchanged}")
    assert "gusty wind of 13.8 m/s" in written["shows"] and "330°" in written["shows"]


@pytest.mark.slow
def test_several_scenarios_are_written_with_one_controller(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calm = str(_write_calm(tmp_path))
    command = ["tune", "weather", calm, "--trials", "2", "--steps", "20", "--realisations", "1"]
    assert main([*command, "--out", str(tmp_path)]) in (0, 1)
    assert "search (2 scenarios, the weather of each" in " ".join(capsys.readouterr().out.split())
    tuned = [load_scenario(tmp_path / f"{name}_tuned.toml") for name in ("weather", "calm")]
    first, second = (one.files["scenario"] for one in tuned)
    assert [one["environment"]["seed"] for one in (first, second)] == [2, 2]
    assert first["controller"] == second["controller"]
    assert second["environment"]["wind"] is None and first["environment"]["wind"]


@pytest.mark.slow
def test_a_suite_runs_the_tuned_scenarios_as_a_suite_of_init(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`thrusters_loss` loses a board at 90 s, step 300: the analysis is of the 100 steps before."""
    command = ["tune", "thrusters_loss", "--trials", "1", "--steps", "5", "--realisations", "1"]
    assert main([*command, "--out", str(tmp_path)]) in (0, 1)
    said = "".join(capsys.readouterr().out.split())
    suite = tmp_path / "tuned_suite.toml"
    assert f"next:dpbenchrun{suite}--solverpaper_active_set" in said
    plan = tomllib.loads(suite.read_text())
    (loop,) = plan["closed_loop"]
    assert loop["scenarios"] == ["thrusters_loss_tuned.toml"]
    ship = ["--length", "80", "--breadth", "18", "--draught", "6", "--displacement", "6000"]
    assert main(["init", "own", *ship, "--thrust", "900", "--out", str(tmp_path)]) == 0
    own = tomllib.loads((tmp_path / "own_suite.toml").read_text())
    tables = {"title", "closed_loop", "replay", "capability"}
    assert {key: plan[key] for key in plan.keys() - tables} == {
        key: own[key] for key in own.keys() - tables
    }
    modes = ("routes", "policies", "settings")
    assert all(loop[key] == own["closed_loop"][0][key] for key in modes)
    assert plan["replay"][1]["first"] == 200 and plan["replay"][1]["steps"] == 100
    assert plan["capability"] == [{"vessel": "ratownik"}]
    assert main(["check", str(suite)]) == 0


@pytest.mark.slow
def test_a_controller_that_no_trial_beats_is_called_unchanged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the result, and in title and comment of the file; five steps are 1.5 s of 240 s."""
    command = ["tune", "thrusters_loss", "--trials", "1", "--steps", "5", "--realisations", "1"]
    assert main([*command, "--out", str(tmp_path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    sentence = "unchanged: no trial has a better score than the scenario's own controller"
    assert said.startswith(f"{sentence} own controller, with offsets within 70 %")
    assert "before the end of the scenario (1.50 of 240 s)" in said
    file = tmp_path / "thrusters_loss_tuned.toml"
    kept, own = (load_scenario(at).files["scenario"] for at in (file, "thrusters_loss"))
    # The search runs the scenario's own seed 7, the test seed 8.
    fresh = {"environment": own["environment"] | {"seed": 8}}
    assert kept == own | fresh | {"title": f"{own['title']}, {sentence}"}
    text = file.read_text()
    assert f"# {sentence}\n" in text and "found by `dpbench tune`" not in text
    assert "(1.50 of 240 s)" in text


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ("weather", "SCENARIO: found weather and weather; allowed: scenarios with different names"),
        ("thrusters", "SCENARIO: thrusters: found a vessel other than that of weather; allowed"),
        ("paper_tight", "SCENARIO: paper_tight: found a controller other than that of weather"),
    ],
)
def test_scenarios_of_several_ships_or_controllers_are_refused(
    other: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        tune_controller(["weather", other], out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seas": "4,x"}, "--seas: found '4,x'; allowed: DP capability numbers from 1 to 9"),
        ({"seas": "4,4"}, "--seas: found '4,4'"),
        ({"trials": 0}, "--trials: found 0"),
        ({"realisations": 0}, "--realisations: found 0"),
        ({"margin": 1.5}, "--margin: found 1.5"),
        ({"margin": float("nan")}, "--margin: found nan"),
        ({"steps": -1}, "--steps: found -1"),
    ],
)
def test_a_mistake_is_found_before_anything_runs(
    arguments: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        tune_controller("weather", out=tmp_path / "out", **arguments)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_vessel_file_stands_for_the_scenario_written_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    size = "--length 80 --breadth 18 --draught 6 --displacement 6000 --thrust 300"
    assert main(["init", "ship", *size.split()]) == 0
    tuning = tune_controller(tmp_path / "ship.toml", trials=1, steps=5, out=tmp_path / "a")
    assert tmp_path / "a" / "ship_weather_tuned.toml" in tuning.paths
    (tmp_path / "ship_weather.toml").unlink()
    with pytest.raises(InputError, match="this is a vessel, and ship_weather"):
        tune_controller(tmp_path / "ship.toml", trials=1, steps=5, out=tmp_path / "b")


@pytest.mark.slow
def test_a_controller_is_found_tried_anew_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An interrupted search goes on from its file, also behind half a line."""
    command = ["tune", "weather", "--seas", "3", *SMALL, "--out", str(tmp_path)]
    assert main(command) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "test in other realisations, within the margin: " in said
    assert all(line in said for line in NO_PROMISE)
    rows = _read_rows(tmp_path)
    (chosen,) = [row for row in rows if row["kind"] == "chosen"]
    own, found = load_scenario("weather"), load_scenario(tmp_path / "weather_tuned.toml")
    table = found.files["scenario"].pop("controller")
    assert table["prediction_horizon"] == int(chosen["prediction_horizon"])
    assert table["output_weight"][2] == pytest.approx(3000.0 * float(chosen["heading_weight"]))
    own.files["scenario"].pop("controller")
    sea = make_environment_of_dp_number(3, from_deg=40.0).model_dump()
    expected = own.files["scenario"] | {
        "title": "Wind, current and waves of DP capability number 3, tuned",
        "shows": found.shows,
        "environment": sea | {"seed": own.files["scenario"]["environment"]["seed"] + 1},
    }
    assert found.files["scenario"] == expected
    assert "dashed line: required margin (70 % of" in (tmp_path / "front.svg").read_text()
    kept = tmp_path / "trials.jsonl"
    lines = kept.read_text().splitlines(keepends=True)
    kept.write_text("".join(lines[:5]) + lines[5][:9])
    assert main(command) == 0
    assert kept.read_text().splitlines(keepends=True) == lines
    assert _read_rows(tmp_path) == rows


@pytest.mark.parametrize("holders", [[Holder("results/other", 0.0, 7)], []])
def test_a_search_names_the_runs_that_it_may_disturb(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    holders: list[Holder],
) -> None:
    (tmp_path / "trials.jsonl").write_text('{"search": "another"}\n')
    monkeypatch.setattr("dpbench.locks.find_machine_lock_holders", lambda: holders)
    assert main(["tune", "weather", *SMALL, "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert ("dpbench: this search may disturb the step times of " in said) == bool(holders)
    assert all(str(holder) in said for holder in holders)


def test_the_trials_of_another_search_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "trials.jsonl").write_text('{"search": "another"}\n')
    assert main(["tune", "weather", *SMALL, "--out", str(tmp_path)]) == 2
    assert "belongs to another search; name another folder" in capsys.readouterr().err


@pytest.mark.slow
def test_a_damaged_trial_is_named(tmp_path: Path) -> None:
    tune = {"trials": 6, "steps": 20, "realisations": 1, "out": tmp_path}
    tune_controller("weather", **tune)  # type: ignore[arg-type] # keyword values of mixed types
    kept = tmp_path / "trials.jsonl"
    first = kept.read_text().splitlines()[0]
    kept.write_text(f"{first}\n[1, 2]\n")
    with pytest.raises(InputError, match=r"trials.jsonl: line 2: found '\[1, 2\]'"):
        tune_controller("weather", **tune)  # type: ignore[arg-type] # keyword values of mixed types


@pytest.mark.slow
def test_a_ship_that_nothing_holds_is_said_to_be_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1; the scenario of least offset is written all the same."""
    command = ["tune", "weather", "--seas", "9", "--margin", "0.001", *SMALL]
    assert main([*command, "--out", str(tmp_path)]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert (
        "none of 7 controllers stays within 0.1 % of the limits of 5 m and 5°; the nearest" in said
    )
    title = load_scenario(tmp_path / "weather_tuned.toml").title
    assert title.endswith(", NOT within the margin of 0.1 %")
