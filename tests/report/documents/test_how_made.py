"""The last paragraph of the report: what was run, by which versions, on which machine."""

import json
from pathlib import Path
from typing import Any

import pytest

from dpbench.report.documents import markdown
from dpbench.report.documents.markdown import HOW_MADE, MOST_BYTES, make_report_markdown
from dpbench.report.report import Report
from dpbench.report.write import write_report
from tests.conftest import MACHINE


def _paragraph(text: str) -> str:
    return text.split(f"## {HOW_MADE}\n\n")[1]


def test_the_report_ends_with_how_it_was_made(records: Any, tmp_path: Path) -> None:
    """Runs of a study are counted as well as those beside it."""
    records.loop("daqp", "calm", steps=40)
    for sea in (1, 2):
        records.sea("osqp", 0, sea, {"start.east_m": 1.0})
    results = records.results()
    versions = results.runs.groupby("solver")["solver_version"].first()
    steps = int(results.runs["steps_done"].sum())
    report = Report.from_results(results)
    text = make_report_markdown(report)
    made = _paragraph(text)
    assert made.count("\n") == 1 and f"3 runs with {steps} steps" in made
    for solver in ("daqp", "osqp"):
        assert f"`{solver}` {versions[solver]}" in made
    assert str(MACHINE["python"]) in made and str(MACHINE["cpu_model"]) in made
    assert "Call modes: `qpsolvers fresh`. " in made
    assert "Study `seas`: 1 point in 2 realisations. " in made and "Rounds" not in made
    folder = records.write(tmp_path / "out")
    page = write_report(folder).read_text("utf-8")
    shown = (
        page.replace("\xa0", " ")
        .replace("&#39;", "'")
        .replace("<code>", "`")
        .replace("</code>", "`")
    )
    assert made.strip() in shown and len(text.encode()) <= MOST_BYTES


def test_a_long_report_keeps_the_paragraph(records: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr("dpbench.report.documents.markdown.MOST_BYTES", 900)
    records.loop("daqp", "calm", steps=40)
    text = make_report_markdown(Report.from_results(records.results()))
    assert "\n| daqp |" in text and "daqp" in _paragraph(text)
    assert "\n\nFurther results are left out here" in text


def test_runs_that_are_not_counted_or_counted_twice_are_named(records: Any) -> None:
    """One row is the same run under another name; two are of other subjects."""
    columns = {"route": "native", "policy": "warm", "replay_s": 1.25, "raw_max_ns": 5e4}
    for settings in ("default", "high"):
        records.replay("quadprog", settings=settings, setup=False, **columns)
    records.loop("daqp", "thrusters_loss", steps=40)
    source = {
        "kind": "consequence",
        "name": "thrusters_loss[2:6], board A lost",
        "group": "board A",
    }
    files = records.scenario("thrusters_loss").files
    cell = json.dumps({"scenario": files, "source": source})
    records.replay("daqp", source["name"], steps=4, scenario="thrusters_loss", cell=cell)
    records.loop("daqp", "thrusters_loss", steps=40, slowdown=100.0)
    frame = records.results().runs
    assert len(frame) == 5
    made = _paragraph(make_report_markdown(Report.from_results(records.results())))
    assert "3 runs with" in made and "`native warm`" in made
    assert (
        "Rounds of each replay: 3; the time of each step is that of its fastest round. Over all"
        in made
    )
    assert (
        "These numbers count 1 run twice (two settings names with the same solver options) and "
        "exclude 1 run on simulated slower computers and 1 run of consequence analyses. "
        "Scenarios: `"
    ) in made


def test_the_report_and_the_page_open_with_their_subject(records: Any, tmp_path: Path) -> None:
    records.suite["title"] = "Two ships"
    records.loop("daqp", "calm", steps=40)
    title, _, subject = make_report_markdown(Report.from_results(records.results())).split("\n")[:3]
    assert title == f"# dpbench: suite `{records.suite['name']}`"
    assert subject == (
        "QP solvers in the model predictive controller of a dynamically positioned ship. Two ships."
    )
    page = write_report(records.write(tmp_path / "out")).read_text("utf-8")
    assert f'<span class="soft">{subject.removesuffix(".")}</span>' in page


def test_a_report_that_is_too_long_loses_conditions_before_its_legend(
    records: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Machine, legend of the table and verdicts are what a reader of a pull request needs."""
    for solver in ("daqp", "quadprog"):
        records.loop(solver)
        records.replay(solver)
    report = Report.from_results(records.results())
    whole = make_report_markdown(report)
    monkeypatch.setattr(markdown, "MOST_BYTES", len(whole.encode()) - 1)
    cut = make_report_markdown(report)
    conditions = "Conditions of "
    assert conditions in whole and conditions not in cut
    for needed in (
        "apply to this machine only",
        "The speed margin is the factor",
        "2 of 2 solvers pass",
        "All figures",
    ):
        assert needed in cut, needed
