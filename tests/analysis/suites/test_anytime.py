"""Answers stopped early: which limit of iterations suffices, by hand."""

import json
import math
from typing import Any

import pytest

from dpbench.analysis.suites.anytime import group_limited_runs
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.report.own_settings_text import describe_own_settings
from dpbench.report.report import Report
from dpbench.report.topics.anytime import build_anytime_topic
from dpbench.solvers.settings import find_options_of_preset

COSTS = {
    "osqp": {1: 250.0, 5: 108.0, 20: 112.0, 50: 100.0, 100: 100.0},
    "piqp": {1: 130.0, 5: 101.0, 20: 100.0},
    "daqp": {1: 900.0, 5: 120.0},
}
"""Cost of the loop by limit; the reference loop costs 100."""
KEYS = {"osqp": "max_iter", "piqp": "max_iter", "daqp": "iter_limit"}


def limit(solver: str, iterations: int) -> dict[str, str]:
    """Settings `high` of a solver with a limit of iterations."""
    options = {**find_options_of_preset("high", solver), KEYS[solver]: iterations}
    return {"settings": f"own {iterations}", "options": json.dumps(options)}


def set_limits_in_suite(records: Any) -> None:
    """Give the suite a table with limits of iterations."""
    records.suite["closed_loop"] = [{"iteration_limits": [1, 5], "time_limits": []}]


def fill(records: Any) -> None:
    """All loops of `COSTS`, and a replay of piqp at two limits."""
    set_limits_in_suite(records)
    for solver, costs in COSTS.items():
        for iterations, cost in costs.items():
            figures = {"closed_loop_cost": cost, "exact_cost": 100.0, "unconverged": 7}
            figures["dev_position_max_m"] = 0.25
            records.loop(solver, steps=120, error=0.5, **figures, **limit(solver, iterations))
    for iterations, error in ((1, 0.5), (5, 0.0)):
        records.replay("piqp", steps=30, error=error, **limit("piqp", iterations))


def test_a_limit_suffices_if_all_larger_ones_do(records: Any) -> None:
    """osqp is within 10 % at 5 iterations and not at 20."""
    fill(records)
    loops, replay = group_limited_runs(records.view())
    assert {
        one.configuration.label: one.least_sufficient_limit for one in loops.configurations
    } == {
        "osqp (qpsolvers fresh, high)": 50,
        "piqp (qpsolvers fresh, high)": 5,
        "daqp (qpsolvers fresh, high)": math.inf,
    }
    assert replay.mode == "replay" and replay.limits == [1, 5]


def test_runs_without_a_limit_or_with_one_are_no_group(records: Any) -> None:
    """The limit of a preset is none of the options of its run."""
    records.loop("osqp", settings="high")
    records.loop("osqp", settings="other", options='{"rho": 1.0}')
    records.loop("piqp", **limit("piqp", 5))
    records.loop("not known here", settings="own", options='{"max_iter": 5}')
    view = records.view()
    assert group_limited_runs(view) == []
    assert build_anytime_topic(view, Requirements()) is None


def test_the_topic_shows_least_limits_and_the_ship_at_the_smallest(records: Any) -> None:
    fill(records)
    topic = build_anytime_topic(records.view(), Requirements())
    assert topic is not None
    assert topic.lines[0] == (
        "In `paper` a limit of 5 iterations per step keeps `piqp` (qpsolvers fresh, high) within "
        "10 % of the cost of the reference loop; 1 of 3 configurations exceed it at all limits. "
        "At this limit 7 of 120 steps are unfinished, and the ship is up to 0.250 m from the "
        "reference loop, in `paper`."
    )
    (table,) = topic.tables
    assert [(row[0].split()[0], *row[1:5]) for row in table.rows] == [
        ("piqp", "5", "7 of 120", "0.50", "1.30"),
        ("osqp", "50", "7 of 120", "0.50", "2.50"),
        ("daqp", "none", "–", "–", "9.00"),
    ]
    assert [figure.name for figure in topic.figures] == [
        "anytime-closed_loop-paper",
        "anytime-replay-paper",
    ]
    costs, errors = (
        {(row["x"], row["y"], row["good"]) for row in data}
        for figure in topic.figures
        for data in figure.chart.to_dict()["datasets"].values()
        if len(data) > 1
    )
    assert {(5, 1.08, True), (20, 1.12, False), (1, 9.0, False)} < costs and len(costs) == 10
    # An error of zero is drawn at the floor of the logarithmic axis.
    assert errors == {(1, 0.5, False), (5, 1e-16, True)}


def test_the_limit_is_the_largest_that_a_scenario_needs(records: Any) -> None:
    """5 iterations suffice in `calm`, and 50 in `paper`; `rough` is farther off there."""
    set_limits_in_suite(records)
    loops = {
        "paper": {5: (130.0, 3.0, 90), 50: (101.0, 0.2, 40)},
        "calm": {5: (101.0, 0.5, 100), 50: (100.0, 0.1, 30)},
        "rough": {5: (105.0, 2.0, 100), 50: (109.0, 2.69, 100)},
    }
    for scenario, runs in loops.items():
        for iterations, (cost, off_m, unfinished) in runs.items():
            figures = {"closed_loop_cost": cost, "exact_cost": 100.0, "unconverged": unfinished}
            figures["dev_position_max_m"] = off_m
            records.loop("osqp", scenario, steps=100, **figures, **limit("osqp", iterations))
    # A configuration that ran in one of the scenarios is not compared.
    for iterations in (5, 50):
        figures = {"closed_loop_cost": 100.0, "exact_cost": 100.0}
        records.loop("piqp", **figures, **limit("piqp", iterations))
    assert records.ending()["answer"] == (
        "In all 3 scenarios a limit of 50 iterations per step keeps osqp (qpsolvers fresh, high) "
        "within 10 % of the cost of the reference loop. At this limit 170 of 300 steps are "
        "unfinished, and the ship is up to 2.69 m from the reference loop, in rough."
    )
    tables = Report.from_results(records.results()).tables
    assert not [name for name in tables if name.startswith("anytime_")]
    table = tables["anytime"]
    own = table[table["configuration"] == "osqp (qpsolvers fresh, high)"]
    columns = ["scenario", "limit", "cost_ratio", "dev_position_max_m", "unconverged"]
    assert set(own[columns].itertuples(index=False, name=None)) == {
        (scenario, iterations, cost / 100.0, off_m, unfinished)
        for scenario, runs in loops.items()
        for iterations, (cost, off_m, unfinished) in runs.items()
    }


def test_limits_of_time_are_a_group_of_their_own(records: Any) -> None:
    """The limit of iterations in the preset of clarabel is none that was asked for."""
    preset = find_options_of_preset("high", "clarabel")
    assert "max_iter" in preset
    for seconds, cost in ((1e-4, 300.0), (1e-3, 101.0)):
        options = json.dumps({**preset, "time_limit": seconds})
        figures = {"closed_loop_cost": cost, "exact_cost": 100.0, "unconverged": 3}
        records.loop("clarabel", settings=f"high {seconds}", options=options, **figures)
    fill(records)
    times, *others = group_limited_runs(records.view())
    assert (times.limit_of, times.limits) == ("time", [1e-4, 1e-3])
    assert {group.limit_of for group in others} == {"iterations"}
    topic = build_anytime_topic(records.view(), Requirements())
    assert topic is not None
    assert topic.lines[0].startswith(
        "In `paper` a limit of 1.00 ms per step keeps `clarabel` (qpsolvers f"
    )
    table, _ = topic.tables
    assert table.rows[0][1:5] == ("1.00 ms", "3 of 120", table.rows[0][3], "3.00")
    assert table.heads[-1] == "median timing at 100 µs"
    assert topic.figures[0].name == "anytime-time-closed_loop-paper"


def test_replays_alone_have_their_errors(records: Any) -> None:
    set_limits_in_suite(records)
    for solver, error in (("osqp", 0.02), ("piqp", 0.5)):
        for iterations in (1, 5):
            records.replay(solver, steps=30, error=error, **limit(solver, iterations))
    assert records.ending()["answer"] == (
        "In the replay of paper, the largest error of the first move at a limit of 5 iterations "
        "per step is 0.020 to 0.50 times the maximum increment, depending on the configuration."
    )


def test_it_is_the_answer_of_a_page_of_limited_runs_alone(records: Any) -> None:
    fill(records)
    assert records.ending()["answer"].startswith(
        "In paper a limit of 5 iterations per step keeps piqp"
    )
    records.loop("daqp")
    assert not records.ending().get("answer", "").startswith("In paper a limit")


def test_a_grid_over_limits_leaves_the_answer_to_the_recommendation(records: Any) -> None:
    """Only a suite with limits of its own is about them; runs in SI units do not count."""
    for iterations in (5, 50):
        own = limit("osqp", iterations)
        records.loop("osqp", closed_loop_cost=100.0, exact_cost=100.0, **own)
        records.loop("osqp", closed_loop_cost=900.0, exact_cost=100.0, units="si", **own)
        records.replay("osqp", **own)
    ending = records.ending()
    assert not ending["answer"].startswith("In paper a limit")
    assert ending["anytime"].startswith("In paper a limit of 5 iterations per step keeps osqp")
    assert "exceed it" not in ending["anytime"]


def test_limits_alone_have_no_best_settings(records: Any) -> None:
    """The largest limit would be at the edge of the grid, to be widened."""
    fill(records)
    view = records.view()
    own = describe_own_settings(view, judge_solvers(view, Requirements()))
    assert not any(line.startswith("Best of") for line in own)
    for rho, iterations in ((0.1, 5), (1.0, 5), (1.0, 50), (2.0, 50)):
        options = json.dumps({"rho": rho, "max_iter": iterations})
        records.loop("osqp", settings=f"{rho} {iterations}", options=options)
    view = records.view()
    lines = describe_own_settings(view, judge_solvers(view, Requirements()))
    assert [line[:9] for line in lines if line.startswith("Best of")] == ["Best of 4"]


@pytest.mark.parametrize(
    ("names", "name"),
    [
        (("mine[max_iter=5]", "mine[max_iter=50]"), "mine"),
        (("mine[max_iter=5,rho=1]", "mine[max_iter=50,rho=1]"), "mine[rho=1]"),
        (("mine[alpha=1,max_iter=5]", "mine[alpha=1,max_iter=50]"), "mine[alpha=1]"),
        (("max_iter=5,rho=1", "max_iter=50,rho=1"), "rho=1"),
        (("mine[rho=1][max_iter=5]", "mine[rho=1][max_iter=50]"), "mine[rho=1]"),
        (("mine[max_iter=5]", "other"), "high"),
        (("max_iter=5", "max_iter=50"), "high"),
        (("a[max_iter=5]", "b[max_iter=50]"), "high"),
        (("my_max_iter=5", "my_max_iter=50"), "high"),
    ],
)
def test_a_curve_has_the_name_of_its_settings(
    records: Any, names: tuple[str, str], name: str
) -> None:
    """Without a common name of the runs, it is that of a preset with equal options."""
    for iterations, own in zip((5, 50), names, strict=True):
        records.loop("osqp", **{**limit("osqp", iterations), "settings": own})
    (group,) = group_limited_runs(records.view())
    (one,) = group.configurations
    assert one.configuration.settings == name and list(one.runs) == [5, 50]
