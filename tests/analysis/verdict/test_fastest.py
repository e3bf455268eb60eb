"""The fastest configurations that nothing is said against."""

import math
from typing import Any

import pytest

from dpbench.analysis.verdict.fastest import rank_configurations, rank_solvers
from dpbench.analysis.verdict.requirements import Requirements, is_right
from dpbench.analysis.verdict.verdict import Verdicts, judge_solvers
from dpbench.report.report import Report
from dpbench.report.verdict_text import judged_runs_text

REQUIREMENTS = Requirements()


def _found(records: Any) -> Verdicts:
    return judge_solvers(records.view(), REQUIREMENTS)


def _labels(records: Any) -> list[str]:
    return [verdict.configuration.label for verdict in rank_configurations(_found(records))]


def test_the_verdict_stays_on_the_default_route(records: Any) -> None:
    """However fast or wrong a native configuration is, the verdict is that of route qpsolvers,
    fresh."""
    records.loop("osqp")
    records.loop("osqp", route="native", policy="warm", error=0.5)
    records.replay("osqp", route="native", policy="fresh", median_us=5.0, error=0.5)
    records.replay("osqp", median_us=50.0)
    (verdict,) = _found(records).references
    assert (verdict.state, verdict.configuration.route) == ("pass", "qpsolvers")
    assert verdict.p99_ns > 40e3


def test_a_closed_loop_that_contradicts_a_configuration_rules_it_out(records: Any) -> None:
    """A configuration that was right on replays but not in its own closed loop is left out."""
    records.replay("scs", route="native", policy="warm")
    assert _labels(records) == ["scs (native warm)"]
    records.loop("scs", route="native", policy="warm", error=0.5)
    assert _labels(records) == []


def test_accuracy_in_closed_loop_is_claimed_only_where_one_was_run(records: Any) -> None:
    """Where no solver steered a ship, replays rank, and what is open is said."""
    records.replay("daqp", median_us=20.0)
    records.replay("daqp", median_us=5.0, route="native", policy="warm")
    assert [judged_runs_text(v) for v in rank_configurations(_found(records))] == [
        "1 replay",
        "1 replay",
    ]
    text = Report.of(records.results()).recommendation.sentence
    assert text.startswith("Nothing contradicts daqp (native, warm, default): right on every step")
    assert "of 1 replay" in text and "no closed loop was run" in text


@pytest.mark.parametrize("witness", [{"first_visit_ratio": 40.0}, {"loop_ratio": 40.0}])
def test_who_remembers_answers_is_never_the_fastest(
    records: Any, witness: dict[str, float]
) -> None:
    for solver, median in (("table", 1.0), ("daqp", 20.0)):
        records.loop(solver)
        records.replay(solver, median_us=median, **(witness if solver == "table" else {}))
    found = _found(records)
    assert {v.configuration.solver: v.state for v in found.references} == {
        "table": "inconclusive",
        "daqp": "pass",
    }
    assert _labels(records) == ["daqp (qpsolvers fresh)"]
    right = {run.solver: is_right(run, REQUIREMENTS) for run in records.view().replays("paper")}
    assert right == {"table": False, "daqp": True}


def test_a_configuration_has_to_be_right_on_every_sequence(records: Any) -> None:
    """A configuration that is right on one sequence and wrong on another, or absent there, is left
    out."""
    for sequence, error in (("paper", 1e-9), ("rough[900:1400]", 0.5)):
        records.replay("wrong_once", sequence, error=error, median_us=5.0)
        records.replay("right", sequence, median_us=20.0)
    records.replay("absent_once", median_us=1.0)
    assert _labels(records) == ["right (qpsolvers fresh)"]


def test_short_sequences_have_a_fastest_configuration_without_p99(records: Any) -> None:
    """With too few steps for a p99 the largest step ranks, and the text says so."""
    records.replay("slow", steps=100, median_us=40.0)
    records.replay("fast", steps=100, median_us=10.0)
    assert [v.configuration.solver for v in rank_configurations(_found(records))] == [
        "fast",
        "slow",
    ]
    assert math.isnan(rank_configurations(_found(records))[0].p99_ns)
    records.replay("daqp", steps=100, median_us=5.0)
    assert "p99" not in records.ending()["answer"] and "p50" in records.ending()["answer"]


def test_a_headline_that_cannot_be_told_apart_carries_caution(records: Any) -> None:
    for solver in ("daqp", "osqp"):
        records.replay(solver, median_us=10.0, spread=0.1, route="native", policy="warm")
        records.replay(solver, median_us=50.0)
    second = records.ending()["next"]
    assert "cannot be told apart" in second
    assert "(native warm)" in second


@pytest.mark.parametrize(
    ("fill", "says"),
    [
        (False, "Nothing is recommended, as no replay left a step, so nothing is timed."),
        (True, "Nothing is recommended: no solver passes in any configuration that was"),
    ],
)
def test_no_candidate_is_said_plainly(records: Any, fill: bool, says: str) -> None:
    records.loop("osqp")
    if fill:
        records.replay("osqp", error=0.5)
    assert Report.of(records.results()).recommendation.sentence.startswith(says)
    assert rank_solvers(_found(records)) == []
