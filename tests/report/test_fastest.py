"""The fastest way to run a solver."""

import math
from typing import Any

import pytest

from dpbench.report.demand import Demand
from dpbench.report.fastest import candidates, fastest_of
from dpbench.report.fastest_text import fastest_arm, fastest_table, fastest_way
from dpbench.report.verdict import judge, judge_all

DEMAND = Demand()


def _labels(records: Any) -> list[str]:
    return [c.label for c in candidates(records.view(), DEMAND)]


def test_the_verdict_stays_on_the_default_route(records: Any) -> None:
    """However fast or wrong a native arm is, the verdict is that of route qpsolvers, fresh."""
    records.loop("osqp")
    records.loop("osqp", route="native", policy="warm", error=0.5)
    records.replay("osqp", route="native", policy="fresh", median_us=5.0, error=0.5)
    records.replay("osqp", median_us=50.0)
    verdict = judge(records.view(), "osqp", "default", DEMAND)
    assert (verdict.outcome, verdict.route) == ("meets", "qpsolvers")
    assert verdict.p99_ns > 40e3


def test_a_solver_without_wrapper_is_judged_natively(records: Any) -> None:
    """A solver that was run on route native only has that as its default route."""
    records.loop("qoco", route="native")
    records.replay("qoco", route="native")
    verdict = judge(records.view(), "qoco", "default", DEMAND)
    assert (verdict.outcome, verdict.route) == ("meets", "native")


def test_the_fastest_arm_is_one_with_right_answers(records: Any) -> None:
    """A faster arm whose answers miss the demand, or fail, is no candidate."""
    records.replay("daqp", median_us=20.0)
    records.replay("daqp", median_us=10.0, route="native", policy="reuse")
    records.replay("daqp", median_us=5.0, route="native", policy="warm", error=0.5)
    records.replay("scs", median_us=1.0, route="native", policy="warm", failed=1)
    assert _labels(records) == ["daqp (native reuse)", "daqp (qpsolvers fresh)"]


def test_a_closed_loop_that_contradicts_an_arm_rules_it_out(records: Any) -> None:
    """An arm that was right on replays but not in its own closed loop is no candidate."""
    records.replay("scs", route="native", policy="warm")
    assert _labels(records) == ["scs (native warm)"]
    records.loop("scs", route="native", policy="warm", error=0.5)
    assert _labels(records) == []


def test_accuracy_in_closed_loop_is_claimed_only_where_one_was_run(records: Any) -> None:
    """An arm with replays alone is said to be judged on replays."""
    records.loop("daqp")
    records.replay("daqp", median_us=20.0)
    records.replay("daqp", median_us=5.0, route="native", policy="warm")
    view = records.view()
    found = candidates(view, DEMAND)
    assert [c.judged_on for c in found] == ["replays", "replays and 1 closed loop"]
    assert "no closed loop was run this way" in fastest_arm(view, found)[0]
    assert fastest_way(found, "daqp").endswith("(judged on replays).")


def test_an_arm_has_to_be_right_on_every_sequence(records: Any) -> None:
    """An arm that is right on one sequence and wrong on another, or absent there, is left out."""
    for sequence, error in (("paper", 1e-9), ("rough[900:1400]", 0.5)):
        records.replay("wrong_once", sequence, error=error, median_us=5.0)
        records.replay("right", sequence, median_us=20.0)
    records.replay("absent_once", median_us=1.0)
    assert _labels(records) == ["right (qpsolvers fresh)"]


def test_figures_come_from_the_sequence_with_the_worst_p99(records: Any) -> None:
    """p50 and p99 belong to one sequence, so p50 never exceeds p99; the largest step is of all.

    Without spread every algorithmic time is the median itself, rounded to 1 ns.
    """
    records.replay("daqp", steps=1000, median_us=10.0, spread=0.0)
    records.replay("daqp", "rough[900:1100]", steps=200, median_us=30.0, spread=0.0)
    (found,) = candidates(records.view(), DEMAND)
    assert (found.p50_ns, found.p99_ns, found.where) == (10e3, 10e3, "paper")
    assert found.algo_max_ns == 30e3


def test_short_sequences_have_a_fastest_arm_without_p99(records: Any) -> None:
    """With too few steps for a p99 the largest step ranks, and the text says so."""
    records.replay("slow", steps=100, median_us=40.0)
    records.replay("fast", steps=100, median_us=10.0)
    view = records.view()
    found = candidates(view, DEMAND)
    assert math.isnan(found[0].p99_ns)
    assert "**fast**" in fastest_arm(view, found)[0]
    assert "too few steps for a p99" in fastest_arm(view, found)[0]


def test_usual_settings_are_named_where_others_are_hardly_faster(records: Any) -> None:
    """A settings level that is 1 % faster does not displace `default`; one that is 20 % does."""
    for solver, median in (("same", 9.9), ("better", 8.0)):
        for settings, us in (("default", 10.0), ("high", median)):
            records.replay(solver, median_us=us, spread=0.0, settings=settings)
    found = candidates(records.view(), DEMAND)
    best = {solver: fastest_of(found, solver) for solver in ("same", "better")}
    assert {s: c and c.settings for s, c in best.items()} == {"same": "default", "better": "high"}


def test_a_headline_that_cannot_be_told_apart_carries_caution(records: Any) -> None:
    """The fastest way of all and the fastest way of another solver are compared in pairs."""
    for solver in ("a", "b"):
        records.replay(solver, median_us=10.0, spread=0.1, route="native", policy="warm")
        records.replay(solver, median_us=50.0)
    view = records.view()
    _, second = fastest_arm(view, candidates(view, DEMAND))
    assert second.startswith("Caution: ")
    assert "cannot be told apart" in second
    assert "(native warm)" in second


def test_the_table_names_who_has_no_way(records: Any) -> None:
    """A solver without any right arm is named in the note instead of having a row."""
    records.replay("daqp")
    records.replay("osqp", error=0.5)
    view = records.view()
    table = fastest_table(candidates(view, DEMAND), judge_all(view, DEMAND)["default"])
    assert table is not None
    assert [row[0].text for row in table.rows] == ["daqp"]
    assert "No such way: osqp" in table.note


@pytest.mark.parametrize(
    ("fill", "says"),
    [
        (False, "No way to run a solver is timed, as no replay left a step."),
        (True, "No replayed arm gives answers that meet the demand on every step."),
    ],
)
def test_no_candidate_is_said_plainly(records: Any, fill: bool, says: str) -> None:
    """Without any right replay nobody is called fastest, and without any nobody is called wrong."""
    if fill:
        records.replay("osqp", error=0.5)
    view = records.view()
    found = candidates(view, DEMAND)
    assert fastest_arm(view, found) == [says]
    assert fastest_way(found, "osqp") == ""
