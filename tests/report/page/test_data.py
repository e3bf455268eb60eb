"""Data of the page: experiments, verdicts, cells and studies, against their records."""

import json
from typing import Any, get_args

import pytest

from dpbench.analysis.times.solver_tables import tabulate_experiment_verdicts
from dpbench.analysis.verdict.requirements import Cause, Doubt, Gap, Near, Requirements
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.report.documents.solver_comparison import compare_solver, format_worst_steps
from dpbench.report.page import data as page_data
from dpbench.report.page.data import PageData, convert_to_json_number, select_tiles
from dpbench.report.page.live import (
    _explain_further_verdicts,
    _explain_verdict_grid,
    describe_failures_in_si,
)
from dpbench.report.page.terms import describe_experiments
from dpbench.report.report import Report
from dpbench.report.verdict.findings_text import shorten_findings
from dpbench.report.verdict.verdict_text import describe_lateness
from dpbench.scenario.scenario import build_scenario_from_documents
from tests.report.conftest import HEIGHTS, LOOSE, OFFSETS, SEAS, of_seas

REQUIREMENTS = Requirements()


def _facts(records: Any) -> PageData:
    view = records.view()
    return PageData.from_verdicts(view, judge_solvers(view, REQUIREMENTS))


def test_a_cell_holds_the_figures_of_its_run(records: Any) -> None:
    records.loop("daqp", steps=50, error=1e-6, failed=2)
    records.loop("scs", outcome="crashed", outcome_detail="signal 11", done=0)
    facts = _facts(records)
    cells = {facts.configurations[cell["c"]].solver: cell for cell in facts.cells()}
    daqp, scs = cells["daqp"], cells["scs"]
    assert (daqp["steps"], daqp["planned"], daqp["error"], daqp["failed"]) == (50, 50, 1e-6, 2)
    assert daqp["first_failed"] is None  # no step fails in the table of steps
    records.replay("daqp", steps=20, failed=4, lost=(3, 5))
    assert [cell["first_failed"] for cell in _facts(records).cells()] == [None, None, 3]
    by_time, by_iterations, by_error = daqp["hard"]
    assert len(by_time) == len(by_error) == 5 and by_iterations == []
    assert by_error[0][:2] == [49, 1e-6], "the largest error is planted in the last step"
    assert (daqp["inaccurate"], scs.get("inaccurate")) == (0, None)
    assert "t" not in scs and (scs["outcome"], scs["why"]) == ("crashed", "signal 11")


def test_steps_of_a_range_are_numbered_as_in_the_scenario(records: Any) -> None:
    """Also in the reasons for a verdict and the export of the worst steps."""
    cell = json.dumps({"scenario": records.scenario("rough").files, "first": 900})
    range_of = {"scenario": "rough", "cell": cell, "steps": 500, "slow": {392: 100.0}}
    records.replay("daqp", "rough[900:1400]", error=0.5, failed=1, lost=(3,), **range_of)
    report = Report.from_results(records.results())
    (found,) = report.data.cells()
    assert (found["first"], found["first_failed"]) == (900, 903)
    assert found["hard"][0][0][0] == 1292
    assert 900 <= found["first_inaccurate"] < 1400
    why = report.data.verdicts.all_verdicts[0]
    assert f"at step {found['first_inaccurate']}" in report.recommendation.why(why)
    assert report.tables["verdicts"]["first_failed_step"].tolist() == ["rough, k 903"]
    worst = dict(format_worst_steps(compare_solver(report, "daqp")[1]))["worst time"]
    assert worst.startswith("step 1292 of rough[900:1400] ") and "--at 1292 " in worst


def test_a_cell_has_the_reason_for_an_inconclusive_verdict(records: Any) -> None:
    """None for a fail, of which the page states the count of wrong steps."""
    records.loop("daqp")
    records.loop("osqp", error=0.5)
    records.loop("scs", outcome="timed_out", done=10)
    facts = _facts(records)
    reasons = {facts.configurations[cell["c"]].solver: cell["reason"] for cell in facts.cells()}
    stopped = "`paper` was stopped at its time limit after 10 of 120 steps"
    assert reasons == {"daqp": "", "osqp": "", "scs": stopped}


def test_the_page_and_the_verdict_count_the_same_inaccurate_steps(
    records: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One planted in the last step of a loop, all rounds of a replay; no matter what is drawn."""
    monkeypatch.setattr(page_data.Room, "from_run_lengths", lambda _: page_data.Room(5, 5))
    records.loop("daqp", steps=50, error=0.5)
    records.replay("daqp", error=0.5)
    facts = _facts(records)
    limit = REQUIREMENTS.error_move
    counts = []
    for cell in facts.cells():
        run = facts.runs[cell["c"], cell["p"]]
        steps = facts.records.read_step_table(run)
        counts.append(cell["inaccurate"])
        assert cell["inaccurate"] == len(set(steps["k"][steps["error_move"] > limit])) > 0
    (verdict,) = facts.verdicts.all_verdicts
    (cause,) = verdict.causes
    assert cause.steps in counts


@pytest.mark.parametrize(("median_ns", "is_late"), [(5.0e6, True), (1e5, False)])
def test_a_slow_loop_is_late_although_its_replays_are_in_time(
    records: Any, median_ns: float, is_late: bool
) -> None:
    """Its replays allow a computer that is slower; the text names the loop, as the verdict does."""
    records.loop("daqp", "rough", steps=200, raw_p50_ns=median_ns)
    records.replay("daqp", "rough[900:1400]", median_us=50.0)
    facts = _facts(records)
    (verdict,) = facts.verdicts.all_verdicts
    margin = facts.get_speed_margin(verdict.configuration)
    assert margin is not None and margin.allowed_slowness_factor > 1.0
    assert (verdict.state == "late") == is_late
    reason = "its median timing in the closed loop `rough` is 5.00 ms, above the limit of 3.00 ms"
    assert describe_lateness(verdict) == (reason if is_late else "")


def test_the_track_is_a_distance_from_the_loop_closest_to_the_exact_one(records: Any) -> None:
    records.loop("far", error=0.9)
    records.loop("near", error=1e-9)
    facts = _facts(records)
    cells = list(facts.cells())
    assert [facts.configurations[cell["c"]].solver for cell in cells] == ["near", "far"]
    assert [cell["reference"] for cell in cells] == [True, False]


@pytest.mark.parametrize(
    ("value", "output"), [(1.5, 1.5), (float("nan"), None), (float("inf"), "inf"), (None, None)]
)
def test_numbers_are_such_as_json_has(value: Any, output: Any) -> None:
    assert convert_to_json_number(value) == output


def test_a_experiment_is_said_in_the_words_of_its_scenario(records: Any) -> None:
    records.loop("daqp", "rough")
    records.loop("daqp", "rough", units="si")
    records.replay("daqp", "rough[900:1400]", steps=500, cell=_of_window(records))
    records._scenarios["robot"] = records.scenario("rough")
    records.replay("daqp", "robot", steps=30, scenario="", cell="{}")
    facts = _facts(records)
    output = {word.term: word.meaning for word in describe_experiments(facts).values()}
    start = "Rough sea: sway force often at its limit. The mean and slowly varying forces of the"
    assert output["rough"] == (
        f"{start} weather correspond to DP capability numbers of about 6 to 7 (DNV-ST-0111)."
    )
    assert output["rough (in SI units)"].startswith(start)
    assert output["rough (in SI units)"].endswith(
        "these runs do not count towards the overall verdict."
    )
    window = (
        "Replay of steps 900 to 1399 of its reference loop (the solvers' closed loops end at step "
        "119). At least one limit is active in 0 %"
    )
    assert window in output["rough[900:1400] (replay)"]
    assert list(output) == [p.label for p in facts.experiments if p.name != "robot"]


def test_a_ship_with_drag_is_said_to_differ_from_its_model(records: Any) -> None:
    """After the words of the scenario; one that is linear has no such sentence."""
    files = records.scenario("calm").files
    hull = {"breadth_m": 18.0, "draught_m": 5.0}
    with_drag = files["vessel"] | {"drag": "cross_flow", "capability": hull}
    records._scenarios["rough"] = build_scenario_from_documents(files | {"vessel": with_drag})
    for name in ("calm", "rough"):
        records.loop("daqp", name)
    output = {word.term: word.meaning for word in describe_experiments(_facts(records)).values()}
    sentence = "Cross-flow drag acts on the ship; the controller's model is linear."
    assert output["rough"].endswith(sentence) and sentence not in output["calm"]


def _of_window(records: Any) -> str:
    return json.dumps({"scenario": records.scenario("rough").files, "first": 900})


def test_of_many_experiments_those_that_miss_most_are_drawn(records: Any, monkeypatch: Any) -> None:
    for i, scenario in enumerate(("calm", "rough", "paper", "turn")):
        for solver in ("daqp", "osqp"):
            wrong = solver == "osqp" and i in (1, 3)
            records.loop(solver, scenario, steps=20, error=1.0 if wrong else 1e-9)
    facts = _facts(records)
    tiles = tabulate_experiment_verdicts(facts)
    assert select_tiles(tiles).equals(tiles)
    monkeypatch.setattr(page_data, "MOST_TILES", 5)
    drawn = select_tiles(tiles)
    assert drawn["experiment"].unique().tolist() == ["rough", "turn"] and len(drawn) == 4
    output = _explain_verdict_grid(facts)
    assert (
        "the 2 of 4 scenarios and replays with the fewest passes" in output and "N·m" not in output
    )
    monkeypatch.undo()
    records.loop("daqp", units="si")
    towards = "Runs in SI units (N, N·m) do not count towards the overall verdict."
    assert towards in _explain_further_verdicts(_facts(records))
    assert "N·m" not in _explain_verdict_grid(_facts(records))
    records.loop("osqp", units="si", error=0.5)
    assert _explain_verdict_grid(_facts(records)).endswith(
        " In SI units (N, N·m), 1 of 2 solvers fails: `osqp`. Scale the QP, as all other runs do."
    )
    # osqp has the overall verdict "fail" already.
    assert describe_failures_in_si(_facts(records), beyond_verdicts=True) == ""
    records.loop("quadprog")
    records.loop("quadprog", units="si", error=0.5)
    found = describe_failures_in_si(_facts(records), beyond_verdicts=True)
    assert found == (
        "In SI units (N, N·m), 2 of 3 solvers fail: `osqp` and `quadprog`. Scale the QP, as all "
        "other runs do."
    )


def test_every_kind_of_finding_has_a_short_text() -> None:
    kinds = [kind for part in get_args(Cause) for kind in get_args(part)]
    kinds += [kind for part in (Doubt, Near, Gap) for kind in get_args(part)]
    assert len(kinds) > 40 and all(shorten_findings(kind) for kind in kinds)
    assert shorten_findings("") == ""
    assert shorten_findings("p99 late, failed") == "p99 above its limit. Failed steps"


@pytest.mark.slow
def test_every_sea_has_its_errors(records: Any) -> None:
    made = of_seas(records)
    facts = Report.from_results(made.results()).data
    (study,) = facts.study_documents
    runs = made.results().runs.set_index("run_id")
    own = study["runs"]
    assert sorted(own["id"]) == sorted(runs.index)
    assert study["names"][study["reference"]] == "daqp"
    for i, run_id in enumerate(own["id"]):
        run = runs.loc[run_id]
        same = (runs["study_point"] == own["point"][i]) & (runs["replicate"] == own["sea"][i])
        (reference,) = runs[same & (runs["solver"] == "daqp")]["r_95_m"]
        assert own["tail_m"][i] == pytest.approx(run["r_tail_max_m"], rel=1e-3)
        assert own["error_excess_cm"][i] == pytest.approx(
            100 * (run["r_95_m"] - reference), abs=1e-3
        )
        assert own["within"][i] == (run["r_tail_max_m"] <= 1.0)
        configuration = facts.configurations[study["c"][own["of"][i]]]
        assert (configuration.solver, configuration.settings) == (run["solver"], run["settings"])


@pytest.mark.slow
def test_it_opens_where_least_is_within(records: Any) -> None:
    facts = Report.from_results(of_seas(records).results()).data
    c, p = facts.opening
    experiment = facts.experiments[p]
    assert (facts.configurations[c].solver, facts.configurations[c].settings) == ("osqp", LOOSE)
    assert experiment.point >= len(OFFSETS) * (len(HEIGHTS) - 1) and experiment.replicate == 2
    assert experiment.label == f"seas: point {experiment.point}, realisation {experiment.replicate}"
    assert facts.runs[c, p].r_tail_max_m == 1.5


@pytest.mark.slow
def test_seas_enter_no_verdict(records: Any) -> None:
    made = of_seas(records)
    made.loop("daqp", "calm", steps=40)
    made.replay("daqp", "calm")
    report = Report.from_results(made.results())
    assert [report.data.experiments[p].label for p in report.data.judged_experiment_indices] == [
        "calm",
        "calm (replay)",
    ]
    assert report.data.opening is None
    assert not any("sea" in chip.text for chip in report.recommendation.chips)
    assert set(report.tables["experiments"]["experiment"]) == {"calm", "calm (replay)"}
    assert set(report.tables["experiments"]["settings"]) == {"default"}


@pytest.mark.slow
def test_a_page_keeps_the_first_seas_of_all_points(records: Any, monkeypatch: Any) -> None:
    room = 3 * len(HEIGHTS) * len(OFFSETS)
    monkeypatch.setattr(page_data, "MOST_LOOPS", room)
    facts = Report.from_results(of_seas(records).results()).data
    assert len(facts.runs) == room
    assert {facts.experiments[p].replicate for _, p in facts.runs} == {1}
    assert len(facts.experiments) == len(HEIGHTS) * len(OFFSETS) * SEAS
    assert len(facts.study_documents[0]["runs"]["id"]) == room * SEAS
