"""Losses of thrusters that no closed loop shows to be held.

`thrusters_loss` has 13.8 m/s of wind from 40° on `ratownik`, heads north and loses board A at 90 s.
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dpbench.analysis.suites.capability import (
    EDGES,
    HELD,
    LOST,
    SPAN,
    CapabilityResult,
    ConsequenceAnalysis,
)
from dpbench.analysis.verdict.ship_results import find_ship_results
from dpbench.bench.capability.frontier import FROM_DEG
from dpbench.report import report
from dpbench.report.documents.markdown import make_report_markdown
from dpbench.report.page.write import make_page_html
from dpbench.report.report import Report
from dpbench.report.ship.open_losses import OpenLosses, find_open_losses

LONG = {"steps": 500, "exact_loss_offset_max_m": 0.3, "exact_loss_heading_max_deg": 0.1}
"""A run of 150 s, so of 60 s after the loss."""


def plot(**held_mps: float) -> CapabilityResult:
    """A plot in which these winds are held from 40°, 13 m/s from 30° and 30 m/s from elsewhere."""
    rows = [
        (case.replace("_", " "), (), at, {40.0: most_mps, 30.0: 13.0}.get(at, 30.0), 1, 0)
        for case, most_mps in {"intact": 20.0, **held_mps}.items()
        for at in FROM_DEG
    ]
    return CapabilityResult("ratownik", 24, pd.DataFrame(rows, columns=list(EDGES)), ())


def analysis(span: list[tuple[float, float, str]]) -> ConsequenceAnalysis:
    """An analysis along `thrusters_loss` with these spans of time of board B; A is held."""
    spans = {"board A": [(0.0, 30.0, HELD)], "board B": span}
    rows = [(group, *one, 0) for group, own in spans.items() for one in own]
    table = pd.DataFrame(rows, columns=list(SPAN))
    return ConsequenceAnalysis("thrusters_loss[0:100]", tuple(spans), 1.25, table, ())


def find(records: Any, plots: list[CapabilityResult], *analyses: ConsequenceAnalysis) -> OpenLosses:
    view = records.view()
    return find_open_losses(view, find_ship_results(view), plots, analyses)


def test_a_loss_that_level_1_does_not_hold_is_not_held_though_another_is_simulated(
    records: Any,
) -> None:
    records.loop("daqp", "thrusters_loss", **LONG)
    found = find(records, [plot(board_A=14.0, board_B=1.29)])
    assert found.summary == (
        "Loss of board B in `thrusters_loss` (wind 13.8 m/s from 40°): not held by level 1 of "
        "DNV-ST-0111, by which the thrusters then hold at most 1.2 m/s from 40° off the bow to "
        "starboard; not simulated in this weather."
    )


def test_a_wind_that_only_the_polygons_of_a_plot_do_not_hold_is_held(records: Any) -> None:
    """24 sides give away less than 0.9 % of the thrust of a circle: 13.75 m/s of 13.8 m/s."""
    records.loop("daqp", "thrusters_loss", **LONG)
    assert "level 1" not in find(records, [plot(board_A=14.0, board_B=13.75)]).summary
    assert "level 1" in find(records, [plot(board_A=14.0, board_B=13.65)]).summary


def test_every_report_has_a_line_on_losses_that_no_closed_loop_shows_to_be_held(
    records: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """`report.md`, page and terminal, after what becomes of the ship."""
    not_held = "Loss of A: not held.", "Loss of B: not held."
    losses = OpenLosses(not_held, "Loss of C: not simulated.")
    summary = (
        "Loss of A: not held. Not held either: 1 more, listed by dpbench report --statement. Loss "
        "of C: not simulated."
    )
    records.loop("daqp")
    assert summary not in make_report_markdown(Report.from_results(records.results()))
    monkeypatch.setattr(report, "find_open_losses", lambda *_: losses)
    found = Report.from_results(records.results())
    assert ("caution", summary) in found.summary_rows()
    assert f"**{summary}**" in make_report_markdown(found)
    parts = found.results, found.data, found.recommendation, {}, found.topics
    page = make_page_html(tmp_path, *parts, light=True)
    assert summary in re.sub(r"<[^>]+>", "", page)


def test_a_loss_that_is_held_but_not_simulated_is_not_shown(records: Any) -> None:
    """The run ends before the loss. Without a plot or an analysis none is listed."""
    records.loop("daqp", "thrusters_loss", steps=200)
    found = find(records, [plot(board_A=14.0, board_B=14.0)])
    sentence = "Loss of board A or of board B: not simulated, so not shown to be held."
    assert found == OpenLosses((), sentence)
    assert find(records, []) == OpenLosses()


def test_the_loss_with_the_least_wind_held_is_listed_first(records: Any) -> None:
    records.loop("daqp", "thrusters_loss", steps=200)
    for winds, first in (((9.0, 2.0), "board B"), ((2.0, 9.0), "board A")):
        found = find(records, [plot(board_A=winds[0], board_B=winds[1])])
        assert len(found.not_held) == 2
        assert found.not_held[0].startswith(f"Loss of {first} in ")


def test_a_ship_on_station_until_a_short_run_ends_is_not_held(records: Any) -> None:
    records.loop("daqp", "thrusters_loss", **LONG)
    (sentence,) = find(records, [plot(board_A=2.0)]).not_held
    assert sentence.endswith(
        "hold at most 2.0 m/s from 40° off the bow to starboard; simulated: on station for 60.0 s "
        "after the loss."
    )
    (sentence,) = find(records, [plot(board_A=0.0)]).not_held
    assert "by which the thrusters then hold no wind from 40° off the bow to starboard;" in sentence


def test_a_loss_has_one_verdict_in_each_weather(records: Any) -> None:
    """In `other_weather` no thruster is lost, and the wind is stronger than in `thrusters_loss`."""
    records.loop("daqp", "thrusters_loss", **LONG)
    view = records.view()
    quiet = view.build_scenario("thrusters_loss")
    scenario = quiet.files["scenario"]
    wind = scenario["environment"]["wind"] | {"speed_mps": 20.7, "from_deg": 30.0}
    files = quiet.files | {
        "scenario": scenario
        | {"environment": scenario["environment"] | {"wind": wind}, "faults": []}
    }
    view._scenarios["other_weather"] = replace(quiet, name="other_weather", files=files)
    view.__dict__["scenarios"] = ["thrusters_loss", "other_weather"]
    ships = find_ship_results(view)
    found = find_open_losses(view, ships, [plot(board_A=14.0)], [analysis([(0.0, 30.0, HELD)])])
    assert found.not_held == (
        "Loss of board A in `other_weather` (wind 20.7 m/s from 30°): not held by level 1 of "
        "DNV-ST-0111, by which the thrusters then hold at most 13.0 m/s from 30° off the bow to "
        "starboard; not simulated in this weather.",
    )


@pytest.mark.parametrize(
    ("from_deg", "text"),
    [
        (0.0, "from ahead"),
        (30.0, "from 30° off the bow to starboard"),
        (180.0, "from astern"),
        (250.0, "from 110° off the bow to port"),
        (330.0, "from 30° off the bow to port"),
    ],
)
def test_a_direction_off_the_bow_has_a_side_and_at_most_180_degrees(
    from_deg: float, text: str, records: Any
) -> None:
    """The plot counts clockwise from ahead; the ship heads north."""
    records.loop("daqp", "thrusters_loss", **LONG)
    view = records.view()
    quiet = view.build_scenario("thrusters_loss")
    scenario = quiet.files["scenario"]
    wind = scenario["environment"]["wind"] | {"from_deg": from_deg}
    scenario = scenario | {"environment": scenario["environment"] | {"wind": wind}}
    view._scenarios["thrusters_loss"] = replace(quiet, files=quiet.files | {"scenario": scenario})
    weak = plot(board_A=2.0)
    weak = replace(weak, edges=weak.edges.assign(wind_mps=2.0))
    (sentence,) = find_open_losses(view, find_ship_results(view), [weak], []).not_held
    assert f"hold at most 2.0 m/s {text};" in sentence


def test_a_ship_that_leaves_after_the_loss_has_its_own_banner(records: Any) -> None:
    records.loop("daqp", "thrusters_loss", exact_left_s=100.0, exact_offset_max_m=9.0, **LONG)
    assert find(records, [plot(board_A=2.0)]) == OpenLosses()


@pytest.mark.parametrize(
    ("span", "said"),
    [
        ([(0.0, 30.0, LOST)], "at no time"),
        (
            [(0.0, 12.0, HELD), (12.0, 30.0, LOST)],
            "until 12 s, after which the remaining thrusters cannot produce the required force",
        ),
    ],
)
def test_a_consequence_analysis_that_finds_a_loss_not_held(
    records: Any, span: list[tuple[float, float, str]], said: str
) -> None:
    records.loop("daqp", "thrusters_loss", **LONG)
    assert find(records, [], analysis([(0.0, 30.0, HELD)])).not_held == ()
    assert find(records, [], analysis(span)).not_held == (
        "Loss of board B in `thrusters_loss` (wind 13.8 m/s from 40°): not held by the static "
        "consequence analysis of steps 0 to 99 of `thrusters_loss`, by which it can be held "
        f"{said}; not simulated in this weather.",
    )


def test_a_finding_of_a_ship_that_was_not_held_says_so(records: Any) -> None:
    """Level 1 holds the loss; the loop of the analysis diverges before."""
    records.loop("daqp", "thrusters_loss", **LONG)
    lost = replace(analysis([(0.0, 30.0, LOST)]), ship_left_s=12.0)
    (sentence,) = find(records, [], lost).not_held
    assert (
        "of `thrusters_loss` (of a ship that was not held), by which it can be held at" in sentence
    )
