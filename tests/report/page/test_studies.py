"""What the page carries of a study: every sea with its errors, the loops, and where it opens."""

from __future__ import annotations

from typing import Any

import pytest

from dpbench.report.page import data as page_data
from dpbench.report.report import Report
from tests.report.conftest import HEIGHTS, LOOSE, OFFSETS, SEAS, of_seas

pytestmark = pytest.mark.slow


def test_every_sea_has_its_errors(records: Any) -> None:
    """Those of its run: how far off, whether held, and how far behind the reference there."""
    made = of_seas(records)
    facts = Report.of(made.results()).data
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
        assert own["behind_cm"][i] == pytest.approx(100 * (run["r_95_m"] - reference), abs=1e-3)
        assert own["held"][i] == (run["r_tail_max_m"] <= 1.0)
        configuration = facts.configurations[study["c"][own["of"][i]]]
        assert (configuration.solver, configuration.settings) == (run["solver"], run["settings"])


def test_it_opens_where_least_is_held(records: Any) -> None:
    facts = Report.of(of_seas(records).results()).data
    assert facts.opening is not None
    c, p = facts.opening
    experiment = facts.experiments[p]
    assert (facts.configurations[c].solver, facts.configurations[c].settings) == ("osqp", LOOSE)
    assert experiment.point >= len(OFFSETS) * (len(HEIGHTS) - 1) and experiment.replicate == 2
    assert experiment.label == f"seas: point {experiment.point}, sea {experiment.replicate}"
    assert facts.runs[c, p].r_tail_max_m == 1.5


def test_seas_enter_no_verdict(records: Any) -> None:
    made = of_seas(records)
    made.loop("daqp", "calm", steps=40)
    made.replay("daqp", "calm")
    report = Report.of(made.results())
    assert [report.data.experiments[p].label for p in report.data.judged_experiments] == [
        "calm",
        "calm (replay)",
    ]
    assert report.data.opening is None
    assert not any("sea" in chip.text for chip in report.recommendation.chips)
    assert set(report.tables["experiments"]["experiment"]) == {"calm", "calm (replay)"}
    assert set(report.tables["experiments"]["settings"]) == {"default"}


def test_a_page_keeps_the_first_seas_of_all_points(
    records: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = 3 * len(HEIGHTS) * len(OFFSETS)
    monkeypatch.setattr(page_data, "MOST_LOOPS", room)
    facts = Report.of(of_seas(records).results()).data
    assert len(facts.runs) == room
    assert {facts.experiments[p].replicate for _, p in facts.runs} == {1}
    assert len(facts.experiments) == len(HEIGHTS) * len(OFFSETS) * SEAS
    assert len(facts.study_documents[0]["runs"]["id"]) == room * SEAS
