"""Slow computers: who survives what, and that nothing else counts such loops."""

import math
from typing import Any

import pytest

from dpbench.analysis.suites.slowdown import DelayedGroup, group_delayed_loops
from dpbench.analysis.verdict.requirements import Requirements, compute_cost_ratio
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.report.topics.capability import build_consequence_topic
from dpbench.report.topics.random import build_random_topic
from dpbench.report.topics.sweeps import build_slowdown_topic

COSTS = {
    "daqp": {1: 100.0, 100: 100.0, 1000: 109.9, 10000: 130.0},
    # Good luck on a slower computer does not make up for bad luck on a faster one.
    "hildreth": {1: 100.0, 100: 111.0, 1000: 100.0, 10000: 500.0},
    "scs": {1: 112.0, 100: 200.0, 1000: 1e6, 10000: 1e7},
}


def slow(records: Any, solver: str, slowdown: float, cost: float, **columns: Any) -> None:
    """A loop on a slow computer; the reference loop costs 100."""
    figures = {"closed_loop_cost": cost, "exact_cost": 100.0, "deadline_s": 0.3}
    figures |= {"deadline_misses": 7, "longest_miss_streak": 3, "miss_recover_steps_max": 5}
    figures |= {"computations": 50, "interrupted": 1, "fallbacks": 6}
    figures |= {"latency_p50_ns": 2e4 * slowdown, "latency_max_ns": 5e4 * slowdown}
    records.loop(solver, slowdown=slowdown, **(figures | columns))


def fill(records: Any) -> None:
    """All loops of `COSTS`, the last of daqp stopped early."""
    for solver, costs in COSTS.items():
        for slowdown, cost in costs.items():
            early = {"done": 60, "outcome": "timed_out"} if cost == 130.0 else {}
            slow(records, solver, slowdown, cost, **early)


def group_of(records: Any) -> DelayedGroup:
    """The only group of the records."""
    (group,) = group_delayed_loops(records.view())
    return group


def test_survival_ends_at_the_first_loop_that_costs_more(records: Any) -> None:
    """109.9 is within 10 % of 100, 111 is not; what comes after a lost loop does not count."""
    fill(records)
    survives = {
        configuration.configuration.solver: configuration.largest_survived_slowdown
        for configuration in group_of(records).configurations
    }
    assert (survives["daqp"], survives["hildreth"]) == (1000.0, 1.0)
    assert math.isnan(survives["scs"])


def test_a_violated_limit_or_an_early_end_is_no_survival(records: Any) -> None:
    slow(records, "daqp", 1, 100.0, limit_violations=1)
    slow(records, "osqp", 1, 100.0, done=119, outcome="timed_out")
    configurations = group_of(records).configurations
    assert all(
        math.isnan(configuration.largest_survived_slowdown) for configuration in configurations
    )
    ratios = {
        configuration.configuration.solver: compute_cost_ratio(configuration.loops[1.0])
        for configuration in configurations
    }
    assert ratios["daqp"] == 1.0 and math.isnan(ratios["osqp"])


@pytest.mark.parametrize("budget", [0.1, 0.3])
def test_budgets_are_groups_of_their_own(records: Any, budget: float) -> None:
    slow(records, "daqp", 10, 100.0, deadline_s=0.2)
    slow(records, "daqp", 10, 100.0, deadline_s=budget)
    assert [group.deadline_s for group in group_delayed_loops(records.view())] == [0.2, budget]


def test_the_topic_shows_who_survives_best_first(records: Any) -> None:
    fill(records)
    topic = build_slowdown_topic(records.view())
    (table,) = topic.tables
    assert [(row[0].split()[0], row[1]) for row in table.rows] == [
        ("daqp", "1000"),
        ("hildreth", "1"),
        ("scs", "–"),
    ]
    # 50 µs on this machine, 10 000 times slower.
    assert {row[2] for row in table.rows} == {"500 ms"}
    (data, *_) = (d for d in topic.figures[0].chart.to_dict()["datasets"].values() if len(d) > 1)
    points = {(row["name"].split()[0], row["x"]): (row["y"], row["good"]) for row in data}
    assert len(points) == 11, "the loop of daqp that was stopped is no point"
    assert points["daqp", 1000] == (pytest.approx(1.099), True)
    assert points["hildreth", 100] == (pytest.approx(1.11), False)


def test_loops_on_slow_computers_are_in_no_verdict(records: Any) -> None:
    for solver in COSTS:
        records.loop(solver)
    before = records.view()
    fill(records)
    after = records.view()
    assert [run.run_id for run in after.runs] == [run.run_id for run in before.runs]
    old, new = (judge_solvers(view, Requirements()).all_verdicts for view in (before, after))
    assert [(v.configuration, v.state, v.loops, v.steps) for v in new] == [
        (v.configuration, v.state, v.loops, v.steps) for v in old
    ]
    assert len(after.delayed) == 12


def test_the_terminal_hears_who_survives_what(records: Any) -> None:
    fill(records)
    paper = "daqp (qpsolvers fresh) × 1000, hildreth (qpsolvers fresh) × 1."
    said = f"Largest slowdown survived in paper: {paper}"
    assert records.ending()["answer"] == said and "solver" not in records.ending()


def test_the_largest_slowdown_run_is_a_bound(records: Any) -> None:
    for slowdown in (1, 100):
        slow(records, "daqp", slowdown, 100.0)
    bound = "daqp (qpsolvers fresh) at least × 100 (the largest run)."
    assert records.ending()["answer"] == f"Largest slowdown survived in paper: {bound}"


def test_nobody_survives_is_said(records: Any) -> None:
    slow(records, "scs", 1, 112.0)
    assert records.ending()["answer"].endswith("survived in paper: none by any solver.")


def test_the_machine_of_slow_loops_is_judged(records: Any) -> None:
    slow(records, "daqp", 1, 100.0, replay_s=2.0, involuntary_switches=400, steal_s=0.0)
    slow(records, "osqp", 1, 100.0, replay_s=2.0, involuntary_switches=420, steal_s=0.0)
    assert "involuntary context switches per second" in records.ending()["machine"]


@pytest.mark.parametrize(
    "topic", [build_slowdown_topic, build_random_topic, build_consequence_topic]
)
def test_without_runs_of_its_kind_there_is_no_topic(records: Any, topic: Any) -> None:
    records.loop("daqp")
    records.replay("daqp")
    assert topic(records.view()) is None
    assert "slowdown" not in records.ending()
