"""Horizon sweeps: growth on known power laws, and when a topic is."""

import copy
import json
import math
from typing import Any

import pytest

from dpbench.analysis.times.contrasts import SweptConfiguration, find_sweeps
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.report.topics.sweeps import build_horizon_topic

REQUIREMENTS = Requirements()
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


def test_a_p99_whose_interval_holds_the_limit_settles_nothing(records: Any) -> None:
    """Spread makes the p99 of 100/20 uncertain by far more than the 1 % it is below the limit."""
    for solver, factor in (("daqp", 0.99), ("osqp", 0.2)):
        for pair in PAIRS:
            _replay(records, solver, pair, median_us=10.0 * pair[1], spread=0.3, rounds=1)
        (configuration,) = (
            a
            for s in find_sweeps(records.view(), REQUIREMENTS)
            for a in s.swept
            if a.configuration.solver == solver
        )
        limit_ns = configuration.points[100, 20].p99_ns / factor
        assert configuration.has_certain_horizons_within(limit_ns) is (solver == "osqp")


def test_own_settings_of_a_solver_are_lines_of_their_own_with_its_build(records: Any) -> None:
    more = {"policy": "reuse", "build": "BLASFEO generic"}
    _law(records, "hpipm_ocp", 1.0, 1.0, **more)
    own = {"settings": "block1", "options": '{"cond_block_size": 1}'}
    _law(records, "hpipm_ocp", 4.0, 1.0, **more, **own)
    topic = build_horizon_topic(records.view(), REQUIREMENTS)
    assert topic is not None
    (table,) = topic.tables
    assert [row[0] for row in table.rows] == [
        "hpipm_ocp (native reuse)",
        "hpipm_ocp (native reuse, block1)",
    ]
    assert "Builds of the libraries: hpipm_ocp (BLASFEO generic)." in topic.lines


def test_the_best_way_is_right_first_and_fast_second(records: Any) -> None:
    _law(records, "osqp", 1.0, 1.0, policy="warm", error=0.4)
    _law(records, "osqp", 3.0, 1.0, policy="reuse")
    (sweep,) = find_sweeps(records.view(), REQUIREMENTS)
    assert [
        configuration.configuration.call_text for configuration in sweep.best_configurations
    ] == ["native reuse"]
    every = [configuration.configuration.call_text for configuration in sweep.swept]
    assert every == ["native warm", "native reuse"]


def _best(records: Any) -> dict[tuple[str, str], SweptConfiguration]:
    (sweep,) = find_sweeps(records.view(), REQUIREMENTS)
    return {
        (s.configuration.solver, s.configuration.formulation): s for s in sweep.best_configurations
    }


def test_two_formulations_are_two_configurations(records: Any) -> None:
    """0.01·n³ against 9·n µs."""
    _law(records, "piqp", 0.01, 3.0)
    _law(records, "piqp", 9.0, 1.0, formulation="sparse")
    best = _best(records)
    box, sparse = best["piqp", "condensed_box"], best["piqp", "sparse"]
    medians = [s.points[100, 20].median_ns for s in (box, sparse)]
    assert medians == pytest.approx([2160e3, 540e3])


def test_the_largest_horizon_needs_right_answers_and_enough_steps(records: Any) -> None:
    """Medians of 150, 300, 600 and 1200 µs: 100/20 fits 1 ms; a wrong one there leaves 60/10,
    and none there and beyond leaves open whether more would fit.

    Without spread p99 is the median.
    """
    _law(records, "daqp", 10.0, 1.0)
    for pair in PAIRS:
        error = 0.4 if pair == (100, 20) else 1e-9
        exact = {"median_us": 30.0 * pair[1], "spread": 0.0, "rounds": 1}
        _replay(records, "osqp", pair, error=error, **exact)
        if pair in PAIRS[:2]:
            _replay(records, "piqp", pair, **exact)
    best = {solver: swept for (solver, _), swept in _best(records).items()}
    within = {solver: swept.find_largest_horizons_within(1e6) for solver, swept in best.items()}
    assert within == {"daqp": (100, 20), "osqp": (60, 10), "piqp": (60, 10)}
    beyond = {solver: swept.has_p99_at_longer_horizons((60, 10)) for solver, swept in best.items()}
    assert beyond == {"daqp": True, "osqp": True, "piqp": False}
    assert best["daqp"].find_largest_horizons_within(1e7) == (200, 40)


def test_the_topic_says_no_more_of_a_limit_than_the_runs(records: Any) -> None:
    """A p99 of 4.8 ms at 200/40 misses 3 ms; 999 steps support none."""
    _law(records, "daqp", 40.0, 1.0)
    for pair in PAIRS[:2]:
        _replay(records, "piqp", pair, median_us=30.0 * pair[1], spread=0.0, rounds=1)
    _law(records, "scs", 1000.0, 1.0)
    topic = build_horizon_topic(records.view(), REQUIREMENTS)
    shown = {row[0].split()[0]: row for row in topic.tables[0].rows}
    assert {name: row[3] for name, row in shown.items()} == {
        "daqp": "100/20",
        "piqp": "≥ 60/10",
        "scs": "none",
    }


def test_growth_is_stated_over_the_sizes_that_were_timed(records: Any) -> None:
    """20 + 0.01·n² µs: a power law through all sizes would name an exponent of neither term."""
    for pair in reversed(PAIRS):
        n = 3 * pair[1]
        _replay(records, "daqp", pair, median_us=20.0 + 0.01 * n**2, spread=0.0, rounds=1)
    _replay(records, "piqp", PAIRS[1], median_us=30.0, spread=0.0, rounds=1)
    topic = build_horizon_topic(records.view(), REQUIREMENTS)
    assert topic.tables[0].heads[1:3] == ("variables", "median step time")
    assert {row[0].split()[0]: row[1:3] for row in topic.tables[0].rows} == {
        "daqp": ("15 to 120", "22.2 µs to 164 µs (× 7.4)"),
        "piqp": ("30", "30.0 µs"),
    }


def test_a_thin_sweep_has_no_p99(records: Any) -> None:
    """999 steps leave less than ten beyond the 99th percentile; the largest step decides then."""
    _law(records, "daqp", 10.0, 1.0, steps=999)
    (swept,) = _best(records).values()
    assert all(math.isnan(point.p99_ns) for point in swept.points.values())
    assert swept.find_largest_horizons_within(1e9) is None
    topic = build_horizon_topic(records.view(), REQUIREMENTS)
    assert topic is not None and "and each of 999 steps within 3 ms are 200/40" in topic.lines[0]
    assert topic.tables[0].rows[0][3] == "200/40"


def test_the_figure_is_over_the_variables_of_the_qp(records: Any) -> None:
    """Three forces times the control horizon: 15 to 120; points with wrong answers are hollow."""
    _law(records, "daqp", 10.0, 1.0)
    _law(records, "osqp", 10.0, 1.0, error=0.4)
    topic = build_horizon_topic(records.view(), REQUIREMENTS)
    (data, *_) = (d for d in topic.figures[0].chart.to_dict()["datasets"].values() if len(d) > 1)
    assert sorted({row["x"] for row in data}) == [3 * N_c for _, N_c in PAIRS]
    assert {row["name"].split()[0]: row["good"] for row in data} == {"daqp": True, "osqp": False}


def test_a_cell_that_was_stopped_is_no_point(records: Any) -> None:
    for pair in PAIRS[:3]:
        _replay(records, "highs", pair, median_us=float(pair[1]) ** 2, spread=0.0, rounds=1)
    _replay(records, "highs", PAIRS[3], steps=400, rounds=1, stopped=True)
    records._runs[-1]["steps_planned"] = 1000
    swept = _best(records)["highs", "condensed_box"]
    assert swept.points[200, 40].times is None
    assert swept.points[200, 40].run.outcome == "timed_out"
    assert list(swept.timed_points) == list(PAIRS[:3])
    topic = build_horizon_topic(records.view(), REQUIREMENTS)
    assert topic.tables[0].rows[0][1:3] == ("15 to 60", "25.0 µs to 400 µs (× 16)")


def test_there_is_a_sweep_only_with_two_horizons_of_one_scenario(records: Any) -> None:
    records.replay("daqp", "paper", steps=40)
    assert find_sweeps(records.view(), REQUIREMENTS) == []
    _replay(records, "daqp", (60, 10), steps=40)
    _replay(records, "osqp", (60, 10), steps=50)
    assert find_sweeps(records.view(), REQUIREMENTS) == []
    assert build_horizon_topic(records.view(), REQUIREMENTS) is None
    _replay(records, "daqp", (30, 5), steps=40)
    (sweep,) = find_sweeps(records.view(), REQUIREMENTS)
    assert sweep.horizons == [(30, 5), (60, 10)]
