"""Figures: the rose of a capability, file formats, colours, and a limited address space."""

import json
import math
import os
import re
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import altair as alt
import pandas as pd
import pytest

import dpbench
from dpbench.report.charts.capability import COLUMNS, draw_capability_rose
from dpbench.report.charts.render import encode_figure, render_svg, save_figure
from dpbench.report.charts.study import draw_within_maps
from dpbench.report.charts.style import FAMILY_COLOURS
from dpbench.solvers.contract import Family
from dpbench.solvers.table import TABLE
from tests.conftest import MadeRecords


@pytest.fixture(scope="module")
def chart() -> Any:
    """Two cases and four directions."""
    rows = [
        (case, from_deg, wind - less, 7)
        for case, less in (("intact", 0.0), ("board A", 5.0))
        for from_deg, wind in ((0.0, 30.0), (90.0, 15.0), (180.0, 25.0), (270.0, 15.0))
    ]
    return draw_capability_rose(pd.DataFrame(rows, columns=list(COLUMNS)), "Some ship")


def test_ahead_is_up_and_starboard_to_the_right(chart: Any) -> None:
    specification = chart.to_dict(validate=True)
    tables = specification["datasets"].values()
    points = next(table for table in tables if "case" in table[0] and "from_deg" in table[0])
    assert [point["case"] for point in points] == 5 * ["intact"] + 5 * ["board A"]
    places = {
        point["from_deg"]: (round(point["x"], 9), round(point["y"], 9))
        for point in points
        if point["case"] == "intact"
    }
    assert places == {0.0: (0, 30), 90.0: (15, 0), 180.0: (0, -25), 270.0: (-15, 0)}
    assert points[0]["x"] == points[4]["x"] and points[0]["y"] == points[4]["y"]


def test_the_worst_failure_comes_first_after_the_intact_ship() -> None:
    """By the least wind over all directions; winds are shown rounded down to 0.1 m/s."""
    winds = {"board A": (30.0, 9.0), "intact": (30.0, 12.0), "board B": (29.0, 8.08)}
    rows = [(case, 90.0 * i, mps, 5) for case, of in winds.items() for i, mps in enumerate(of)]
    made = draw_capability_rose(pd.DataFrame(rows, columns=list(COLUMNS)), "Some ship").to_dict()
    points = next(t for t in made["datasets"].values() if "case" in t[0] and "from_deg" in t[0])
    assert list(dict.fromkeys(p["case"] for p in points)) == ["intact", "board B", "board A"]
    assert [p["shown_mps"] for p in points if p["case"] == "board B"][1] == 8.0


def test_rings_are_named_where_no_line_runs(chart: Any) -> None:
    clear, rows = 135.0, []
    for from_deg in range(0, 360, 15):
        wind = 32.6 if from_deg != clear else 30.5
        rows.append(("intact", float(from_deg), wind, 7))
    specification = draw_capability_rose(
        pd.DataFrame(rows, columns=list(COLUMNS)), "Some ship"
    ).to_dict()
    tables = specification["datasets"].values()
    names = next(
        table for table in tables if set(table[0]) == {"x", "y", "name"} and table[0]["name"] == "3"
    )
    assert {round(math.degrees(math.atan2(row["x"], row["y"])), 6) for row in names} == {clear}


def test_points_with_untrue_claims_are_hollow() -> None:
    rows = [("intact", 0.0, 20.0, 7, 0), ("intact", 90.0, 15.0, 6, 2)]
    table = pd.DataFrame(rows, columns=[*COLUMNS, "untrue"])
    marks = [layer["mark"] for layer in draw_capability_rose(table, "Some ship").to_dict()["layer"]]
    assert [mark["filled"] for mark in marks if mark["type"] == "point"] == [True, False]
    plain = draw_capability_rose(table.assign(untrue=0), "Some ship").to_dict()["layer"]
    assert [m["mark"]["filled"] for m in plain if m["mark"]["type"] == "point"] == [True]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "begins"), [("svg", b"<svg"), ("pdf", b"%PDF"), ("png", b"\x89PNG"), ("html", b"<!")]
)
def test_it_has_four_formats(chart: Any, tmp_path: Path, suffix: str, begins: bytes) -> None:
    written = save_figure(chart, tmp_path / f"rose.{suffix}").read_bytes()
    assert written.lstrip().startswith(begins)
    assert b"<script src=" not in written


@pytest.mark.slow
def test_names_that_xml_cannot_hold_are_drawn() -> None:
    rows = [("a\x1b\x00\x0c\\\ufffeb", 0.0, 1.0, 7), ("c\\u001b", 0.0, 1.0, 7)]
    drawn = encode_figure(
        draw_capability_rose(pd.DataFrame(rows, columns=list(COLUMNS)), "x"), "svg"
    ).decode()
    assert "c\\u001b" in drawn and not {"\x1b", "\x00", "\x0c", "\ufffe"} & set(drawn)


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (2_000_000 * 1024,) * 2)


@pytest.mark.slow
def test_a_report_is_written_without_its_figures(records: MadeRecords, tmp_path: Path) -> None:
    for solver in ("daqp", "quadprog"):
        records.loop(solver, steps=30)
        records.replay(solver, steps=30)
    campaign = records.write(tmp_path / "results")
    run = [sys.executable, "-m", "dpbench", "report", str(campaign), "--json"]
    env = {**os.environ, "PYTHONPATH": str(Path(dpbench.__file__).parents[1])}
    for limit in (_limited, None):
        done = subprocess.run(run, env=env, preexec_fn=limit, capture_output=True, text=True)  # noqa: PLW1510 - asserted below, with what it said
        assert (done.returncode, done.stderr) == (0, "")
        drawn = limit is None
        page = (campaign / "report.html").read_text(encoding="utf-8")
        assert ("figures" in json.loads(done.stdout)) != drawn
        assert ("<script" in page and "<svg" in page) == drawn
        assert "daqp" in page
        assert any((campaign / "figures").glob("*.svg")) == drawn


def test_every_family_of_a_record_has_a_colour_of_its_own() -> None:
    assert set(get_args(Family)) <= set(FAMILY_COLOURS)
    assert len(set(FAMILY_COLOURS.values())) == len(FAMILY_COLOURS)
    assert "not stated" not in {row.family for row in TABLE.values()}


def test_a_chart_with_not_a_number_beside_texts_is_drawn() -> None:
    """Altair leaves NaN in a column that also has texts, which its compiler refuses."""
    table = pd.DataFrame({"x": [1.0, 2.0], "error": ["inf", float("nan")]})
    chart = alt.Chart(table).mark_point().encode(x="x:Q", tooltip="error:N")
    assert "<svg" in render_svg(chart)


def test_maps_of_a_study_share_the_names_of_their_axes() -> None:
    """Three maps of 2 × 2 tiles are narrower than the name of a key."""
    names = ["daqp", "piqp", "osqp"]
    rows = [(name, x, y, 1.0, 8) for name in names for x in (30, 60) for y in (1.0, 3.5)]
    table = pd.DataFrame(rows, columns=["configuration", "x", "y", "within", "runs"])
    chart = draw_within_maps(table, "Within 1 m", "horizon", "waves.hs_m", drawn=False)
    texts = re.findall(r">([^<>]+)</t", render_svg(chart))
    assert [text for text in texts if "horizon" in text] == ["horizontal: horizon"]
    assert [text for text in texts if "hs_m" in text] == ["vertical: waves.hs_m"]
