"""The effect of the controller on the ship comes first, on every surface, before any solver."""

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from dpbench import load_results, open_workspace, run_closed_loop
from dpbench.analysis.verdict.ship_results import find_ship_results
from dpbench.cli.main import main
from dpbench.report.documents.markdown import make_report_markdown
from dpbench.report.report import Report
from dpbench.report.ship.ship_text import (
    BANNER,
    LOST as NOT_HELD,
    NOT_RUN,
    ShipSummary,
    describe_ship,
    describe_unmet,
    summarise_ships,
)
from dpbench.scenario.dotted_keys import copy_documents_with_values
from dpbench.scenario.scenario import load_scenario

LOST = {
    "exact_left_s": 9.0,
    "exact_offset_max_m": 37.0,
    "exact_offset_max_s": 30.0,
    "exact_offset_end_m": 36.0,
}
ADVICE = re.compile(r"\bUse `?\w+`? \(|[Rr]ecommend")
SCENARIO = """\
title = "Still water, or a storm"
shows = "A mean force from abeam, of thrusters that hold 417 kN."
vessel = "supply_fs99"
sample_s = 0.3
duration_s = 12.0

[environment]
mean_kN = [0.0, {sway_kN:.1f}, 0.0]

[controller]
tuning = "paper"
prediction_horizon = 30
control_horizon = 5
output_weight = [1.0, 1.0, 100.0]
move_weight = [1e-10, 1e-10, 1e-14]
"""
SUITE = """\
title = "A ship alone"
solvers = ["paper_active_set"]
cell_limit_s = 5.0
rounds = 2
warmup_steps = 5

[[closed_loop]]
scenarios = ["ship.toml"]

[[replay]]
scenario = "ship.toml"
"""


def _summary(records: Any) -> ShipSummary:
    return summarise_ships(find_ship_results(records.view()))


def test_a_ship_whose_load_exceeds_its_thrust_is_not_held(
    records: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that ends early shows it on station; no solver is recommended without the warning."""
    records.loop("daqp", "rough", steps=100)
    records.replay("daqp", "rough")
    over = {"rough": 1.09}
    monkeypatch.setattr(
        "dpbench.analysis.verdict.ship_results.find_overload",
        lambda files: over.get(files["name"], math.nan),
    )
    told = _summary(records)
    assert told.warning == (
        "The controller does not hold this ship, whatever the solver, in `rough`: the mean load "
        "needs 109 % of the thrust. The run (30 s) ended before the ship left its station."
    )
    assert "on station" not in told.state
    assert " As a solver of these QPs alone, daqp" in records.ending()["answer"]
    records.loop("daqp", "extreme", steps=200, **LOST)
    assert " Nor does it hold it in `rough`: the mean load " in _summary(records).warning


def test_a_lost_ship_is_a_banner_with_when_and_how_far(records: Any) -> None:
    records.loop("daqp", "rough", steps=100)
    records.loop("daqp", "extreme", steps=200, **LOST)
    told = _summary(records)
    assert told.warning == (
        f"{NOT_HELD} in the weather of 1 of 2 scenarios (it holds it in 1), whatever the solver: "
        "in `extreme` it leaves its station (5 m, 5°) at 9.00 s; "
        "largest offset 37.0 m at 30.0 s, last offset 36.0 m."
    )
    assert (
        "in 1 of 2 scenarios of 30 s. There, the largest offset is 1.77 m, at the start of `rough` "
        "(" in told.text
    )
    assert "Over all 2 scenarios, limits are active in " in told.limits


@pytest.mark.parametrize(
    ("at_s", "other", "clause"),
    [
        (8.0, {}, " after the loss of board A"),
        (9.5, {}, ""),
        (8.0, LOST, ""),
    ],
)
def test_a_failure_is_named_where_every_lost_ship_left_after_one(
    records: Any, at_s: float, other: dict[str, float], clause: str
) -> None:
    """The ship leaves at 9 s: after a loss at 8 s, before one at 9.5 s."""
    faults = [{"at_s": at_s, "lost": ["board A"]}]
    cell = json.dumps({"scenario": {"scenario": {"controller": {}, "faults": faults}}})
    records.loop("daqp", "thruster_loss", cell=cell, **LOST)
    records.loop("daqp", "paper", **other)
    warning = _summary(records).warning
    part = f"{NOT_HELD} in the weather of 1 of 2 scenarios{clause} (it holds it in 1)"
    assert warning.startswith(f"{BANNER + clause if other else part}, whatever the solver: in `")


def test_an_intact_ship_that_leaves_is_named_before_ships_with_a_loss(records: Any) -> None:
    """Three ships go farther after a loss; the intact one is named, and the last of them is not."""
    faults = [{"at_s": 8.0, "lost": ["board A"]}]
    cell = json.dumps({"scenario": {"scenario": {"controller": {}, "faults": faults}}})
    for name, far_m in {"turn": 50.0, "move": 40.0, "thruster_loss": 45.0}.items():
        records.loop("daqp", name, cell=cell, **LOST | {"exact_offset_max_m": far_m})
    records.loop("daqp", "rough", **LOST)
    warning = _summary(records).warning
    intact = "whatever the solver: in `rough` the intact ship leaves its station (5 m, 5°) at 9.00 "
    assert warning.startswith(f"{BANNER}, {intact}s; largest offset 37.0 m at 30.0 s")
    assert "; in `turn` it leaves its station" in warning and "`move`" not in warning
    assert warning.index("`turn`") < warning.index("`thruster_loss`")


@pytest.mark.parametrize("keys", [{}, {"fallbacks": 1}, {"error_move_max": 0.5}])
@pytest.mark.parametrize(("lost", "most_m"), [(LOST, 180.0), (LOST, 70.0), ({}, 20.0), ({}, 4.0)])
def test_an_accurate_solver_whose_ship_goes_much_farther_is_named(
    records: Any, lost: dict[str, float], most_m: float, keys: dict[str, float]
) -> None:
    """More than twice the 37 m of the reference loop, or beyond the station of a ship kept.

    One that is inaccurate or falls back is marked as such, and named only of a lost ship.
    """
    records.loop("daqp", "rough", r_max_m=3.0, **lost)
    records.loop("proxqp", "rough", r_max_m=most_m, **lost, **keys)
    told = _summary(records)
    is_named = most_m in ((180.0,) if keys else (180.0, 20.0))
    fails = ", which is inaccurate or fails there," if keys else ""
    text = told.warning if lost else told.caution
    assert (f"(with `proxqp`{fails} up to {most_m:.3g}" in text) == is_named
    assert ("daqp" in text) is False and ("proxqp" in text) == is_named


@pytest.mark.parametrize(
    "keys", [{"environment": {"noise": {"position_m": 0.3}}}, {"estimator": {"kind": "kalman"}}, {}]
)
def test_sensors_are_named_beside_the_weather_where_the_scenario_has_some(
    records: Any, keys: dict[str, Any]
) -> None:
    cell = json.dumps({"scenario": {"scenario": {"controller": {}} | keys}})
    records.loop("daqp", "rough", cell=cell, **LOST)
    sensors = " with these sensors" if keys else ""
    assert _summary(records).warning.startswith(f"{BANNER}{sensors}, whatever the solver: in")


def test_a_ship_that_turns_away_or_comes_back_is_lost_too(records: Any) -> None:
    records.loop("daqp", "turn", exact_left_s=3.0, exact_heading_max_deg=40.0)
    (ship,) = find_ship_results(records.view())
    assert ship.state == "leaves and returns"
    told = _summary(records).warning
    assert "in `turn` it leaves its station (5 m, 5°) at 3.00 s and returns; largest offset" in told
    assert told.endswith("m; largest heading error 40.0°.")


MOVING = {"exact_offset_max_m": 1.0, "exact_offset_max_s": 35.9, "exact_offset_end_m": 0.95}


@pytest.mark.parametrize(
    ("columns", "is_moving"),
    [
        ({}, True),
        ({"exact_offset_max_s": 32.0}, False),
        ({"exact_offset_end_m": 0.8}, False),
        ({"exact_offset_max_m": 0.4, "exact_offset_end_m": 0.4}, False),
        ({"exact_steps": 140}, False),
    ],
)
def test_a_run_that_ends_at_the_largest_offset_is_said_to(
    records: Any, columns: dict[str, float], is_moving: bool
) -> None:
    """The run of 120 steps ends after 36 s; below 0.5 m nothing is said of a station of 5 m."""
    records.loop("daqp", "rough", **MOVING | columns)
    sentence = (
        "The ship is still moving away when the run ends in `rough`: only a longer run shows "
        "whether it stays on station."
    )
    assert _summary(records).caution == (sentence if is_moving else "")


def test_an_offset_that_rises_after_a_loss_is_said_to(records: Any) -> None:
    """Offset and time since the loss at 90 s; 500 samples of 0.3 s end 60 s later."""
    rise = MOVING | {"exact_offset_max_s": 149.0, "exact_loss_offset_max_m": 1.0}
    records.loop("daqp", "thrusters_loss", steps=500, **rise)
    assert _summary(records).caution == (
        "The offset after a loss still rises when the run ends in `thrusters_loss` (0.950 m of "
        "5 m, 60.0 s after the loss): a longer `duration_s` shows whether it settles."
    )


@pytest.mark.parametrize(("steps", "is_stopped"), [(300, True), (301, False)])
def test_a_run_that_is_stopped_before_a_loss_is_named(
    records: Any, steps: int, is_stopped: bool
) -> None:
    """The loss is at 90 s, after 300 samples of 0.3 s."""
    records.loop("daqp", "thrusters_loss", steps=steps)
    said = "The run of `thrusters_loss` was stopped before a loss in the scenario, so the ship was"
    assert (said in _summary(records).headline) == is_stopped


@pytest.mark.parametrize(
    ("columns", "is_settled"),
    [
        ({"exact_offset_max_m": 0.271, "exact_offset_max_s": 149.5}, False),
        ({"exact_offset_max_m": 0.271, "exact_offset_max_s": 120.0}, True),
        ({"exact_offset_max_m": 1.8, "exact_offset_max_s": 20.0}, False),
        ({"exact_offset_max_m": 1.8, "exact_offset_end_m": 0.2}, True),
    ],
)
def test_a_small_offset_that_is_largest_at_the_end_is_not_settled(
    records: Any, columns: dict[str, float], is_settled: bool
) -> None:
    """0.271 m after the loss and at the end, be an offset before the loss larger or not."""
    own = {"exact_loss_offset_max_m": 0.271, "exact_offset_end_m": 0.271} | columns
    records.loop("daqp", "thrusters_loss", steps=500, **own)
    said = "At the end of `thrusters_loss`, the offset has not settled."
    assert (said in _summary(records).headline) != is_settled
    assert "At the end, 60.0 s after the loss, the offset is 0.2" in _summary(records).details
    assert "still rises" not in _summary(records).caution


def test_a_lost_ship_that_is_still_moving_away_is_said_to(records: Any) -> None:
    records.loop("daqp", "rough", **MOVING | {"exact_left_s": 30.0, "exact_heading_end_deg": 9.0})
    told = _summary(records)
    assert told.warning.endswith("last offset 0.950 m, still moving away when the run ends.")
    assert told.caution == ""


@pytest.mark.parametrize(
    ("columns", "share"),
    [
        ({"exact_offset_max_m": 3.99}, ""),
        ({"exact_offset_max_m": 4.0}, "80.0 % (offset 4.00 m)"),
        ({"exact_heading_max_deg": 4.8}, "96.0 % (heading error 4.80°)"),
        ({"exact_offset_max_m": 4.0, "exact_left_s": 9.0}, ""),
    ],
)
def test_a_ship_near_the_limits_of_its_station_is_named(
    records: Any, columns: dict[str, float], share: str
) -> None:
    records.loop("daqp", "paper")
    records.loop("daqp", "rough", **columns)
    expected = (
        f"The margin is small: the ship reaches {share} of the limits of its station in `rough`."
    )
    assert _summary(records).caution == (expected if share else "")


def test_the_smallest_margin_in_a_study_has_its_point(records: Any) -> None:
    for point, far_m in enumerate((4.1, 4.6, 1.0)):
        records.sea("daqp", point, 1, {"N_p": 20.0 + point}, exact_offset_max_m=far_m)
    worst = "92.0 % (offset 4.60 m, point 1 with `N_p = 21`, realisation 1 of `seas`)"
    assert f"up to {worst} of the limits of its station in `seas`." in _summary(records).caution


def test_the_longest_loop_of_a_scenario_counts_whichever_solver_ran_it(records: Any) -> None:
    records.loop("osqp", "rough", steps=60)
    records.loop("daqp", "rough", steps=90, done=3, outcome="crashed", **LOST)
    records.loop("unconstrained_clipped", "rough", steps=70, formulation="none")
    assert [ship.state for ship in find_ship_results(records.view())] == ["leaves"]


def test_a_ship_on_its_way_and_one_without_a_loop_are_said_to_be(records: Any) -> None:
    records.loop("daqp", "move", exact_offset_end_m=12.0)
    records.replay("daqp", "paper")
    told = _summary(records)
    assert told.warning == ""
    assert (
        "The ship is not at its setpoint at the end of `move` (offset up to 12.0 m)." in told.text
    )
    assert "The ship was not run in `paper`: there is no reference loop." in told.text
    records.loop("daqp", "paper")
    assert "not run" not in _summary(records).text


def test_without_any_loop_the_ship_is_not_run(records: Any) -> None:
    records.replay("daqp", "paper")
    assert _summary(records) == ShipSummary(state=NOT_RUN)


def test_a_qp_that_never_meets_a_limit_was_never_hard(records: Any) -> None:
    records.loop("daqp", "calm", exact_active_share=0.0)
    assert _summary(records).text.endswith("No limit is ever active, so no QP is hard.")
    records.loop("daqp", "rough", exact_active_share=0.2)
    assert _summary(records).text.endswith(
        "Limits are active in 0 % (`calm`) to 20.0 % (`rough`) of the steps. In `calm` no limit is "
        "ever active."
    )


NEEDED = {
    "a loss of thrusters or limits": {"faults": [{"at_s": 1.0, "limit_share": [0.5, 0.5, 0.5]}]},
    "first-order wave motion": {"environment.waves.motion": {}},
    "gusts": {},
    "measurement noise": {"environment.noise": {"position_m": 0.1, "heading_deg": 0.1}},
    "a state estimator": {"estimator.kind": "kalman"},
    "thruster lag": {"plant.thruster_lag_s": 1.5},
    "actuator delay": {"plant.delay_samples": 2},
    "thrust below that commanded": {"plant.thrust_loss_percent": [0.0, 5.0, 0.0]},
    "a model mismatch of the mass": {"plant.mass_percent": 10.0},
    "a model mismatch of the damping": {"plant.damping_percent": -10.0},
}
"""Keys of a scenario file that bring each condition into it; gusts are in `weather`."""


@pytest.mark.parametrize("condition", NEEDED)
def test_each_condition_is_unmet_until_a_scenario_contains_it(condition: str) -> None:
    plain = load_scenario("weather")
    absent = describe_unmet([], [plain])
    assert set(absent) >= {"an active limit", *NEEDED} - {"gusts"}
    assert "waves" not in absent and "gusts" not in absent and "squalls" in absent
    with_it = plain.with_keys(NEEDED[condition])
    found = describe_unmet([], [plain, with_it])
    assert set(absent) - set(found) == {condition} - {"gusts"}
    still = plain.with_keys({"environment.wind.gusts": "none"})
    assert "gusts" in describe_unmet([], [still])


def test_a_table_of_wave_motion_without_keys_is_met() -> None:
    """The motion is then that of the waves of the weather."""
    moved = load_scenario("weather").with_keys({"environment.waves.motion": {}})
    assert "first-order wave motion" not in describe_unmet([], [moved])


def test_a_ship_with_cross_flow_drag_has_another_damping_than_its_model() -> None:
    plain, other = load_scenario("weather"), load_scenario("weather@osv")
    assert plain.files["vessel"].get("drag", "linear") == "linear"
    assert other.files["vessel"]["drag"] == "cross_flow"
    assert "a model mismatch of the damping" in describe_unmet([], [plain])
    assert "a model mismatch of the damping" not in describe_unmet([], [other])


def test_seas_of_a_study_are_counted(records: Any) -> None:
    for sea in (1, 2, 3):
        records.sea("daqp", 0, sea, {"waves.hs_m": 4.0}, **(LOST if sea > 1 else {}))
    told = _summary(records)
    assert (
        told.warning
        == f"{NOT_HELD} in the weather of 2 of 3 realisations (it holds it in 1), whatever the "
        "solver: in 2 realisations of `seas` it leaves, by up to 37.0 m at point 0 with "
        "`waves.hs_m = 4`, realisation 2."
    )
    assert "in 1 of 3 realisations" in told.text


@pytest.mark.parametrize("others", [0, 1])
def test_a_loop_unstable_without_limits_is_not_blamed_on_the_weather(
    records: Any, others: int
) -> None:
    """`rough` has |λ| = 1.0129 by eq. 35 at a prediction horizon of 15, and less at 20 and 60."""
    files = {}
    for horizon in (15, 20, 60):
        values = {"controller.prediction_horizon": horizon}
        files[horizon] = copy_documents_with_values(load_scenario("rough").files, values, "test")
    places = [(20, 0, 1), (15, 2, 1), (60, 1, 1)][: 2 + others]
    for horizon, point, sea in places:
        study = {"name": "seas", "point": point, "replicate": sea, "x": {}}
        cell = json.dumps({"scenario": files[horizon], "study": study})
        columns = {"study": "seas", "study_point": point, "replicate": sea}
        records.loop("daqp", "rough", cell=cell, **columns, **LOST)
    warning = _summary(records).warning
    weather = (
        f"{BANNER}, whatever the solver: in 1 realisation of `seas` it leaves, by up to 37.0 m "
    )
    loop = (
        "its loop is unstable without limits at `prediction_horizon = 15 and 20` (largest |λ| "
        "1.0129, paper eq. 35), whatever weather and solver: in 2 realisations of `seas` it "
        "leaves, by up to 37.0 m at point 0, realisation 1."
    )
    expected = (
        f"{weather}at point 1, realisation 1. Elsewhere {loop}" if others else f"{NOT_HELD}: {loop}"
    )
    assert warning == expected


@pytest.mark.parametrize("others", [0, 1])
def test_a_ship_that_starts_off_its_station_is_not_blamed_on_the_weather(
    records: Any, others: int
) -> None:
    records.loop("daqp", "turn", **LOST | {"exact_left_s": 0.0})
    if others:
        records.loop("daqp", "rough", **LOST)
    start = (
        "off its station and ends farther away: in `turn` it starts off its station (5 m, 5°); "
        "largest offset 37.0 m at 30.0 s, last offset 36.0 m."
    )
    warning = _summary(records).warning
    assert warning.endswith(f"Elsewhere it starts {start}" if others else f"it starts {start}")
    assert warning.startswith(f"{BANNER}, whatever" if others else f"{NOT_HELD}: it starts off")


@pytest.mark.slow
def test_no_solver_is_recommended_before_the_ship(records: Any) -> None:
    """Report.md, the terminal's rows, the page's data: the banner comes first, none advises."""
    records.loop("daqp", **LOST)
    records.replay("daqp")
    report = Report.from_results(records.results())
    assert "caution" not in dict(report.summary_rows())
    alone = "As a solver of these QPs alone, `daqp` (qpsolvers fresh, default) passes."
    assert f"was run. {alone}" in report.recommendation.sentence
    assert [about for about, _ in report.summary_rows()][:3] == ["warning", "ship", "answer"]
    first, _, rest = make_report_markdown(report).partition(alone)
    assert f"**{BANNER}" in first and BANNER not in rest


class Written:
    """A campaign of one ship in a sway force [kN], and what each surface shows of it."""

    def __init__(self, folder: Path, sway_kN: float, capsys: Any) -> None:
        self.out = folder / "out"
        (folder / "ship.toml").write_text(SCENARIO.format(sway_kN=sway_kN))
        (folder / "suite.toml").write_text(SUITE)
        run = ["run", str(folder / "suite.toml"), "--out", str(self.out), "--strict", "--json"]
        self.code = main(run)
        printed = capsys.readouterr()
        self.json, self.errors = json.loads(printed.out), printed.err
        report = ["report", str(self.out)]
        self.code_without = main(report)
        self.terminal = " ".join(capsys.readouterr().out.split())
        self.markdown = (self.out / "report.md").read_text(encoding="utf-8")
        page = (self.out / "report.html").read_text(encoding="utf-8")
        shown = page.partition("<main>")[2].partition("<script")[0]
        self.page = re.sub(r"<[^>]*>", "", shown).replace("\xa0", " ")


@pytest.mark.slow
def test_every_surface_says_first_that_the_ship_is_lost(tmp_path: Path, capsys: Any) -> None:
    lost = Written(tmp_path, 1300.0, capsys)
    assert (lost.code, lost.code_without) == (1, 0)
    assert BANNER in lost.errors and lost.json["warning"].startswith(BANNER)
    assert list(lost.json)[1] == "warning"
    for surface in (lost.terminal, lost.page, lost.markdown):
        assert 0 <= surface.index(BANNER) < surface.index("paper_active_set")
        assert not ADVICE.search(surface)
        assert "As a solver of these QPs alone, paper_active_set (" in surface.replace("`", "")
    assert "alert" not in lost.page and "leaves its station (5 m, 5°)" in lost.page
    results = load_results(lost.out)
    assert results.answer.startswith(BANNER)
    assert not ADVICE.search(" ".join(map(str, (results.answer, results._repr_html_(), lost.json))))
    html = str(results._repr_html_())
    assert html.startswith(f"<p>{BANNER}") and html.count(BANNER) == 1
    assert html.index(BANNER) < html.index("<table>") and BANNER in repr(results)
    assert list(results.ships()["ship"]) == ["leaves"]
    assert set(results.runs["mode"]) == {"closed_loop", "replay"}
    assert (results.runs["exact_steps"] == 40).all()
    scenario = load_scenario(tmp_path / "ship.toml")
    run = run_closed_loop(scenario, open_workspace("paper_active_set"))
    assert BANNER in repr(run) and BANNER in run._repr_html_()


@pytest.mark.slow
def test_a_ship_on_station_has_no_banner_anywhere(tmp_path: Path, capsys: Any) -> None:
    kept = Written(tmp_path, 5.0, capsys)
    assert (kept.code, kept.code_without) == (0, 0)
    assert "warning" not in kept.json and BANNER not in kept.errors
    for surface in (kept.terminal, kept.page, kept.markdown):
        assert BANNER not in surface and ADVICE.search(surface)
        assert (
            "With exactly solved QPs, the controller holds the ship on station (5 m, 5°)" in surface
        )
        assert "No limit is ever active, so no QP is hard." in surface
    opening = kept.page.split("<summary>Details")[0]
    assert "No limit is ever active, so no QP is hard." in opening, "visible before the folded part"
    ships = load_results(kept.out).ships()
    assert list(ships["ship"]) == ["on station"]
    assert math.isnan(ships["exact_left_s"][0])
    scenario = load_scenario(tmp_path / "ship.toml")
    run = run_closed_loop(scenario, open_workspace("paper_active_set"))
    assert BANNER not in repr(run) and "on station" in run._repr_html_()


@pytest.mark.slow
def test_every_surface_warns_of_a_force_beyond_the_thrust(tmp_path: Path, capsys: Any) -> None:
    """In a force that the thrusters do not hold the run ends before the ship has left."""
    near = Written(tmp_path, 700.0, capsys)
    assert (near.code, near.code_without) == (1, 0)
    lost = (
        "The controller does not hold this ship, whatever the solver, in ship: the mean load needs"
    )
    moving = "The ship is still moving away when the run ends in ship: only a longer run shows"
    small = "The margin is small: the ship reaches 83.0 % (offset 4.15 m) of the limits of its "
    statement = tmp_path / "a.svg"
    assert main(["report", str(near.out), "--statement", str(statement)]) == 0
    drawn = " ".join(re.sub(r"<[^>]*>", " ", statement.read_text("utf-8")).split())
    markdown = near.markdown.replace("`", "")
    for surface in (near.terminal, near.page, markdown, near.json["caution"], drawn):
        assert moving in surface and small in surface
    run = run_closed_loop(load_scenario(tmp_path / "ship.toml"), open_workspace("paper_active_set"))
    notebook = run._repr_html_().replace("`", "")
    assert moving in notebook
    for surface in (near.terminal, near.page, markdown, near.json["warning"], drawn, notebook):
        assert lost in surface


def test_a_ship_moving_away_in_a_study_has_its_point(records: Any) -> None:
    for point in range(5):
        records.sea("daqp", point, 1, {"N_p": 20.0 + point}, **MOVING | {"exact_steps": 120})
    named = (
        f"point {point} with `N_p = {20 + point}`, realisation 1 of `seas`" for point in (0, 1, 2)
    )
    assert f"when the run ends in {', '.join(named)} and 2 more: only" in _summary(records).caution


def test_the_largest_offset_in_a_study_has_its_point(records: Any) -> None:
    for point, sea, offset_m in ((0, 1, 1.5), (3, 2, 2.5), (4, 1, 2.0)):
        records.sea("daqp", point, sea, {"N_p": 20.0}, exact_offset_max_m=offset_m)
    text = summarise_ships(find_ship_results(records.view())).text
    assert "is 2.50 m, at the start of point 3 with `N_p = 20`, realisation 2 of `seas` (" in text


def test_a_study_with_one_point_of_active_limits_was_hard(records: Any) -> None:
    """The realisations have one scenario: named by point and realisation, not by it."""
    for point, share in enumerate((0.0, 0.245)):
        records.sea("daqp", point, 1, {"waves.hs_m": 2.0 + point}, exact_active_share=share)
    text = _summary(records).text
    limits = (
        "Limits are active in 0 % (point 0 with `waves.hs_m = 2`, realisation 1 of `seas`) to "
        "24.5 % (point 1 with `waves.hs_m = 3`, realisation 1 of `seas`)"
    )
    assert text.endswith(f"{limits} of the steps.")


def test_the_largest_and_the_last_offset_after_a_loss_are_stated(records: Any) -> None:
    """The scenario file names the loss; a scenario without one has no such sentence."""
    after = {"exact_loss_offset_max_m": 2.5, "exact_loss_heading_max_deg": 1.25}
    records.loop("daqp", "thrusters_loss", **after)
    records.loop("daqp", "paper")
    assert _summary(records).text.count("After the loss") == 1
    assert (
        "After the loss of board A at 90 s in `thrusters_loss`, the largest offset is 2.50 m and "
        "the largest heading error 1.25°. At the end, the offset is 0.0400 m and the heading error "
        "0.0100°."
    ) in _summary(records).text


@pytest.mark.parametrize(("swing_m", "is_named"), [(0.5, True), (0.499, False), (0.0, False)])
def test_an_undamped_swing_after_a_loss_is_named(
    records: Any, swing_m: float, is_named: bool
) -> None:
    """A range of 0.5 m is a tenth of the station's radius of 5 m."""
    after = {"exact_loss_offset_max_m": 2.5, "exact_loss_heading_max_deg": 1.25}
    records.loop("daqp", "thrusters_loss", exact_loss_swing_m=swing_m, **after)
    summary = _summary(records)
    said = "At the end of `thrusters_loss`, the offset has not settled."
    assert (said in summary.headline) == is_named
    ending = "heading error 0.0100°; the ship still swings by 0.500 m, without decay."
    assert (ending in summary.details) == is_named


def test_weather_from_one_direction_is_named_with_it(records: Any) -> None:
    """Wind and waves of `weather` come from 40°, its current goes to 220°; `paper` has none."""
    records.loop("daqp", "weather")
    assert (
        "(5 m, 5°) in weather from 40° in `weather` (36 s). The largest" in _summary(records).text
    )
    records.loop("daqp", "thrusters")
    assert "(5 m, 5°) in weather from 40° in 2 of 2 scenarios of 36 s. " in _summary(records).text
    records.loop("daqp", "paper")
    assert "weather from" not in _summary(records).text


def test_a_point_is_named_by_its_first_values_where_they_are_short(records: Any) -> None:
    weather = {"environment.wind.speed_mps": 5.4, "environment.wind.from_deg": 90.0}
    records.sea("daqp", 7, 3, {"environment.current.speed_mps": 0.5} | weather, **LOST)
    warning = _summary(records).warning
    values = "`wind.speed_mps = 5.4`, `wind.from_deg = 90`, …"
    assert warning.endswith(f"by up to 37.0 m at point 7 with {values}, realisation 3.")


def test_a_ship_that_begins_farthest_off_is_said_to(records: Any) -> None:
    records.loop("daqp", "calm", exact_offset_max_s=0.0)
    assert " at the start (" in _summary(records).text


TURN = {
    "exact_offset_max_m": 0.831,
    "exact_offset_max_s": 104.0,
    "exact_transfer_offset_max_m": 17.0,
    "exact_transfer_s": 73.8,
    "exact_offset_rise_m": -0.01,
}


def test_a_transfer_is_no_station_keeping_from_the_start(records: Any) -> None:
    """The offset on the way is stated beside the largest of the rest, and until when it lasts."""
    records.loop("daqp", "paper")
    records.loop("daqp", "turn", **TURN)
    text = _summary(records).text
    assert text.startswith(
        "With exactly solved QPs, the controller holds the ship on station (5 m, 5°) in 2 of 2 "
        "scenarios of 36 s, in scenario `turn` after an approach. The largest "
        "offset on station is 1.77 m, at the start of `paper` (0.0400 m at its end)."
    )
    assert text.endswith(
        "In the reference loop of `turn`, the ship is up to 17.0 m from its setpoint during the "
        "approach and on station from t = 73.8 s."
    )
    farther = {"exact_transfer_offset_max_m": 25.0, "exact_transfer_s": 40.2}
    records.loop("daqp", "move", **TURN | farther)
    assert (
        "in scenarios `turn` and `move` after an approach. The largest offset on station is"
        in _summary(records).text
    )
    assert (
        "In the reference loops of `turn` and `move`, the ship is up to 25.0 m from its setpoint "
        "during the approach and on station from t = 73.8 s at the latest."
    ) in _summary(records).text


def test_a_transfer_of_an_earlier_release_is_named_without_numbers(records: Any) -> None:
    """Its scenario file asks for a turn of 90°; that of `paper` for none."""
    for name in ("paper", "turn"):
        cell = json.dumps({"scenario": load_scenario(name).files})
        records.loop("daqp", name, cell=cell)
    assert (
        "In the reference loop of `turn`, the ship is on station after the approach to its "
        "setpoint." in _summary(records).details
    )


def test_the_line_of_a_ship_after_a_transfer_states_both_offsets(records: Any) -> None:
    records.loop("daqp", "turn", **TURN)
    (ship,) = find_ship_results(records.view())
    assert describe_ship(ship).startswith(
        "`turn`: up to 17.0 m from its setpoint during the approach and on station from "
        "t = 73.8 s; largest offset after it 0.831 m at 104 s, last 0.0400 m; "
    )


GROWING = {"exact_offset_max_m": 0.446, "exact_offset_max_s": 36.0, "exact_offset_end_m": 0.446}


def test_a_small_offset_that_grows_until_the_end_has_not_settled(records: Any) -> None:
    """As after a loss; an offset from 0.5 m on is in the caution, and in it alone."""
    records.loop("daqp", "paper")
    records.loop("daqp", "thrusters", exact_offset_rise_m=0.3, **GROWING)
    assert "At the end of `thrusters`, the offset has not settled." in _summary(records).headline
    said = "After the last step of `thrusters`, the offset is 0.446 m and still growing."
    assert said in _summary(records).details and _summary(records).caution == ""
    records.loop("daqp", "waves", exact_offset_rise_m=0.1, **GROWING | {"exact_offset_end_m": 0.45})
    said = (
        "After the last step of `thrusters` and `waves`, the offset is up to 0.450 m and still "
        "growing."
    )
    assert said in _summary(records).details


@pytest.mark.parametrize(
    "columns",
    [
        {"exact_offset_rise_m": -0.1},
        {"exact_offset_max_m": 0.7, "exact_offset_end_m": 0.7},
        {"exact_left_s": 3.0},
    ],
    ids=["comes back", "caution", "left"],
)
def test_a_ship_that_settles_or_is_named_elsewhere_is_not_named(
    records: Any, columns: dict[str, float]
) -> None:
    records.loop("daqp", "thrusters", **GROWING | columns)
    text = _summary(records).text
    assert "still growing" not in text and "not settled" not in text


def test_realisations_of_a_study_are_not_named_for_their_last_wave(records: Any) -> None:
    records.sea("daqp", 0, 1, {"N_p": 20.0}, **GROWING | {"exact_offset_max_s": 12.0})
    text = _summary(records).text
    assert "still growing" not in text and "not settled" not in text
