"""Horizon sweeps: growth on known power laws, crossover of known lines, and when a section is."""

from __future__ import annotations

import copy
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.statistics import Interval
from dpbench.analysis.times.growth import Growth, crossover, fit_growth
from dpbench.analysis.times.horizon_sweep import between_ends, sweeps
from dpbench.report.blocks import Paragraph
from dpbench.report.figures_horizon import growth_figure
from dpbench.report.labels import kept_apart
from dpbench.report.section_horizon import horizon_section
from dpbench.report.style import styled
from dpbench.report.table import Table
from dpbench.report.tables_horizon import crossover_text, growth_table
from dpbench.report.write import build_page

DEMAND = Demand()
PAIRS = ((30, 5), (60, 10), (100, 20), (200, 40))


def _replay(records: Any, solver: str, pair: tuple[int, int], **more: Any) -> None:
    """A replay of `paper` under other horizons, as a campaign names it."""
    N_p, N_c = pair
    files = copy.deepcopy(records.scenario("paper").files)
    controller = files["scenario"]["controller"]
    controller["prediction_horizon"], controller["control_horizon"] = N_p, N_c
    files["name"] = name = f"paper-{N_p}-{N_c}"
    columns = {"N_p": N_p, "N_c": N_c, "n": 3 * N_c, "m": 3 * N_c, "route": "native"}
    columns |= {"scenario": name, "cell": json.dumps({"scenario": files, "first": 0})}
    records._scenarios[name] = records.scenario("paper")
    records.replay(solver, name, **columns | more)


def _law(records: Any, solver: str, scale_us: float, power: float, **more: Any) -> None:
    """Replays at all horizons with medians of scale_us · n^power and no spread."""
    for pair in PAIRS:
        median = scale_us * (3 * pair[1]) ** power
        _replay(records, solver, pair, **{"median_us": median, "spread": 0.0, "rounds": 1} | more)


def _column(table: Table, head: str) -> dict[tuple[str, str], str]:
    where = table.heads.index(head)
    return {(row[0].text, row[1].text): row[where].text for row in table.rows}


def _best_table(view: Records) -> Table:
    (sweep,) = sweeps(view, DEMAND)
    return growth_table(sweep, sweep.best)


def _line(scale: float, power: float, low: float = 15.0, high: float = 120.0) -> Growth:
    return Growth(Interval(power, power, power), math.log(scale), low, high, 4, 1.0)


@pytest.mark.slow
@given(
    power=st.floats(-1.0, 4.0),
    scale=st.floats(1e2, 1e6),
    sizes=st.lists(st.integers(3, 400), min_size=3, max_size=7, unique=True),
)
def test_a_pure_power_law_is_found_exactly(power: float, scale: float, sizes: list[int]) -> None:
    """t = scale · n^power has that slope and scale, and an interval of no width.

    Times of one size are all equal, so every resample has the same medians. Sizes that differ by
    one in 400 leave the slope to rounding of the logarithms over 0.0025: 1e-12 at worst.
    """
    growth = fit_growth(sizes, [np.full(80, scale * n**power) for n in sizes])
    assert growth is not None
    assert growth.exponent.value == pytest.approx(power, abs=1e-9)
    assert growth.exponent.low == pytest.approx(power, abs=1e-9)
    assert growth.exponent.high == pytest.approx(power, abs=1e-9)
    assert growth.misfit == pytest.approx(1.0, abs=1e-7)
    assert growth.time_ns(100.0) == pytest.approx(scale * 100.0**power, rel=1e-7)


def test_the_misfit_is_the_largest_factor_off_the_line() -> None:
    """A point lifted by a factor f in the middle of three leaves the line by f^(2/3).

    With log times (0, f, 0) at equally spaced log sizes the slope is 0 and the mean f/3.
    """
    growth = fit_growth([10, 100, 1000], [np.full(20, t) for t in (5.0, 40.0, 5.0)])
    assert growth is not None
    assert growth.exponent.value == pytest.approx(0.0, abs=1e-12)
    assert growth.misfit == pytest.approx(8.0 ** (2 / 3))


@pytest.mark.slow
def test_the_interval_holds_the_slope_of_a_noisy_law_about_as_often_as_it_says() -> None:
    """Over 200 drawn sweeps of independent steps the 95 % interval holds the slope in 95 % of them.

    A bootstrap of blocks is a little narrow at 300 steps; below 85 % (over six standard deviations
    of a count of 200 at 95 %) it would be wrong. An interval that always holds it is too wide.
    """
    rng = np.random.default_rng(3)
    sizes, held = [15, 30, 60, 120], 0
    for _ in range(200):
        times = [1e3 * n**1.7 * np.exp(0.3 * rng.standard_normal(300)) for n in sizes]
        growth = fit_growth(sizes, times, resamples=200)
        assert growth is not None
        held += growth.exponent.spans(1.7)
    assert 170 <= held < 200


def test_no_exponent_below_three_sizes() -> None:
    """Two sizes lie on any line, also where one of them is there twice."""
    times = [np.full(20, 1.0), np.full(20, 2.0), np.full(20, 3.0)]
    assert fit_growth([15, 30], times[:2]) is None
    assert fit_growth([15, 30, 30], times) is None


@given(meet=st.floats(20.0, 100.0), flat=st.floats(0.2, 1.5), steep=st.floats(1.6, 4.0))
def test_lines_cross_where_they_were_made_to(meet: float, flat: float, steep: float) -> None:
    """Lines through one point at n = meet undercut each other from there on, either way round."""
    ours, theirs = _line(7.0 * meet**-flat, flat), _line(7.0 * meet**-steep, steep)
    found, other = crossover(ours, theirs), crossover(theirs, ours)
    assert found is not None and other is not None
    assert found.n == pytest.approx(meet, rel=1e-9)
    assert (found.faster_low, found.faster_high) == (False, True)
    assert other.n == pytest.approx(meet, rel=1e-9)
    assert crossover_text(other) == f"up to n = {meet:.0f} only"


def test_a_crossing_outside_the_sizes_measured_is_none() -> None:
    """Lines that meet at 1000 or at 2 do not meet between 15 and 120; sizes must overlap."""
    beyond = crossover(_line(10.0, 1.0), _line(0.01, 2.0))
    before = crossover(_line(1.0, 1.0), _line(0.5, 2.0))
    assert beyond is not None and before is not None
    assert math.isnan(beyond.n) and math.isnan(before.n)
    assert crossover_text(beyond) == "none up to n = 120"
    assert crossover_text(before) == "at every n from 15 to 120"
    assert crossover(_line(1.0, 1.0, 15, 30), _line(1.0, 2.0, 30, 60)) is None
    assert crossover(None, _line(1.0, 1.0)) is None


def test_growth_and_crossover_of_two_formulations_stand_in_the_table(records: Any) -> None:
    """0.01·n³ against 9·n µs: they meet at n = 30, and each row has its own exponent."""
    _law(records, "piqp", 0.01, 3.0)
    _law(records, "piqp", 9.0, 1.0, formulation="sparse")
    table = _best_table(records.view())
    box, sparse = ("piqp", "condensed box"), ("piqp", "sparse")
    exponents = {key: float(text) for key, text in _column(table, "exponent").items()}
    assert exponents == {box: pytest.approx(3.0), sparse: pytest.approx(1.0)}
    undercuts = _column(table, "sparse undercuts condensed")
    assert undercuts == {box: "", sparse: "from n = 30"}
    assert _column(table, "n = 60 (100/20) [µs]") == {box: "2160", sparse: "540"}


@pytest.mark.slow
def test_the_largest_horizon_within_a_limit_needs_right_answers_and_enough_steps(
    records: Any,
) -> None:
    """Medians of 150, 300, 600 and 1200 µs: 100/20 fits 1 ms; a wrong one there leaves 60/10,
    and none there and beyond leaves open whether more would fit.

    Without spread p99 is the median. 999 steps do not support a p99.
    """
    _law(records, "daqp", 10.0, 1.0)
    for pair in PAIRS:
        wrong = pair == (100, 20)
        _replay(
            records,
            "osqp",
            pair,
            median_us=30.0 * pair[1],
            spread=0.0,
            rounds=1,
            error=0.4 if wrong else 1e-9,
        )
    for pair in PAIRS[:2]:
        _replay(records, "piqp", pair, median_us=30.0 * pair[1], spread=0.0, rounds=1)
    table = _best_table(records.view())
    form = "condensed box"
    within = _column(table, "p99 ≤ 1 ms")
    assert (within["daqp", form], within["osqp", form]) == ("100/20", "60/10")
    assert within["piqp", form] == "≥ 60/10"
    assert _column(table, "p99 ≤ 10 ms")["daqp", form] == "≥ 200/40"
    assert _column(table, "n = 60 (100/20) [µs]")["osqp", form] == "600 ○"


def test_a_thin_sweep_has_no_p99(records: Any) -> None:
    """999 steps leave less than ten beyond the 99th percentile."""
    _law(records, "daqp", 10.0, 1.0, steps=999)
    table = _best_table(records.view())
    assert not any(head.startswith("p99") for head in table.heads)
    assert "do not support a p99" in table.note


@pytest.mark.slow
def test_a_p99_whose_interval_holds_the_limit_settles_nothing(records: Any) -> None:
    """Spread makes the p99 of 100/20 uncertain by far more than the 1 % it is below the limit."""
    for solver, factor in (("daqp", 0.99), ("osqp", 0.2)):
        for pair in PAIRS:
            _replay(records, solver, pair, median_us=10.0 * pair[1], spread=0.3, rounds=1)
        (configuration,) = (
            a
            for s in sweeps(records.view(), DEMAND)
            for a in s.swept
            if a.configuration.solver == solver
        )
        limit_ns = configuration.points[100, 20].p99_ns / factor
        assert configuration.settled(limit_ns) is (solver == "osqp")


def test_a_cell_that_was_stopped_is_no_point(records: Any) -> None:
    """A configuration that did not do every step at a horizon says why there, and is fitted without
    it."""
    for pair in PAIRS[:3]:
        _replay(records, "highs", pair, median_us=float(pair[1]) ** 2, spread=0.0, rounds=1)
    asked = {"N_p": 200, "N_c": 40}
    _replay(records, "highs", PAIRS[3], steps=400, rounds=1, **asked, stopped=True)
    records._runs[-1]["steps_planned"] = 1000
    table = _best_table(records.view())
    key = ("highs", "condensed box")
    assert _column(table, "n = 120 (200/40) [µs]")[key] == "timed out"
    assert _column(table, "points")[key] == "3"
    assert float(_column(table, "exponent")[key]) == pytest.approx(2.0)


def test_the_best_way_is_right_first_and_fast_second(records: Any) -> None:
    """A fast way with wrong answers gives way to a slower one; both stand in the table of all."""
    _law(records, "osqp", 1.0, 1.0, policy="warm", error=0.4)
    _law(records, "osqp", 3.0, 1.0, policy="reuse")
    (sweep,) = sweeps(records.view(), DEMAND)
    assert [configuration.configuration.options for configuration in sweep.best] == ["native reuse"]
    every = growth_table(sweep, sweep.swept, every=True)
    assert [row[2].text for row in every.rows] == ["native warm", "native reuse"]
    assert every.folded


@pytest.mark.slow
def test_there_is_a_section_only_with_two_horizons_of_one_scenario(records: Any) -> None:
    """One horizon, two windows of it, or another scenario make no sweep."""
    records.replay("daqp", "paper", steps=40)
    assert horizon_section(records.view(), DEMAND) is None
    _replay(records, "daqp", (60, 10), steps=40)
    _replay(records, "osqp", (60, 10), steps=50)
    assert horizon_section(records.view(), DEMAND) is None
    _replay(records, "daqp", (30, 5), steps=40)
    found = horizon_section(records.view(), DEMAND)
    assert found is not None and found.key == "horizon"
    keys = [section.key for section in build_page(records.results()).sections]
    assert keys.index("use") + 1 == keys.index("horizon")


@pytest.mark.slow
def test_other_sections_keep_to_the_ends_of_a_sweep(records: Any) -> None:
    """Between the ends no figure of one sequence is drawn, and its tables are folded."""
    for solver in ("daqp", "osqp"):
        for policy in ("reuse", "warm"):
            _law(records, solver, 1.0, 1.0, policy=policy, steps=60)
    view = records.view()
    assert between_ends(sweeps(view, DEMAND)) == {"paper-60-10", "paper-100-20"}
    page = build_page(records.results())
    titles = " ".join(picture.title for picture in page.pictures)
    assert "paper-30-5" in titles and "paper-200-40" in titles
    assert "paper-60-10" not in titles


@pytest.mark.slow
def test_points_are_hollow_where_an_answer_misses_the_demand(records: Any) -> None:
    """Each formulation has its panel; markers of wrong answers have a white face."""
    _law(records, "osqp", 1.0, 1.0, error=0.4, steps=60)
    _law(records, "daqp", 1.0, 1.0, steps=60)
    _law(records, "daqp", 1.0, 1.0, formulation="sparse", steps=60)
    (sweep,) = sweeps(records.view(), DEMAND)
    with styled():
        first, second = growth_figure(sweep, sweep.best).axes
    assert [first.get_title(loc="left"), second.get_title(loc="left")] == [
        "condensed box",
        "sparse",
    ]
    faces = [line.get_markerfacecolor() for line in first.lines if line.get_marker() == "o"]
    assert len(faces) == 2 * len(PAIRS)
    assert faces.count("white") == len(PAIRS)


@given(st.lists(st.floats(0.0, 300.0), min_size=1, max_size=25), st.floats(1.0, 20.0))
def test_names_are_kept_apart_and_in_order(places: list[float], gap: float) -> None:
    """No two closer than the gap, those that are far apart stay, and the mean does not move."""
    wanted = np.sort(np.array(places))
    found = kept_apart(wanted, gap)
    assert (np.diff(found) >= gap - 1e-9).all()
    assert found.mean() == pytest.approx(wanted.mean(), abs=1e-6)
    if (np.diff(wanted) >= gap).all():
        np.testing.assert_allclose(found, wanted, atol=1e-9)


@pytest.mark.slow
def test_a_generic_build_is_marked_at_its_horizons_and_crossovers(records: Any) -> None:
    """Rows, the sparse crossover among their cells, and sentences name the solver with the
    mark."""
    build = {"build": "BLASFEO generic", "generic_build": True}
    _law(records, "hpipm", 0.01, 3.0, **build)
    _law(records, "hpipm", 9.0, 1.0, formulation="sparse", **build)
    _law(records, "osqp", 90.0, 1.0)
    table = _best_table(records.view())
    assert {row[0].text for row in table.rows} == {"hpipm †", "osqp"}
    assert table.note.count("†: BLASFEO generic:") == 1
    section = horizon_section(records.view(), DEMAND)
    assert section is not None
    texts = [block.text for block in section.blocks if isinstance(block, Paragraph)]
    (words,) = (text for text in texts if "fastest of" in text)
    assert "**hpipm †**" in words and "†: BLASFEO generic:" in words
