"""The fastest configurations that nothing is said against."""

import math
from typing import Any

import pytest

from dpbench.analysis.times.solver_tables import LevelPoint, level_points
from dpbench.analysis.verdict.fastest import fastest_of, qualifying, ranked_qualifying
from dpbench.analysis.verdict.requirements import Requirements, is_right
from dpbench.analysis.verdict.verdict import Verdicts, verdicts_of
from dpbench.report.report import Report
from dpbench.report.verdict_text import judged_on

REQUIREMENTS = Requirements()


def _found(records: Any) -> Verdicts:
    return verdicts_of(records.view(), REQUIREMENTS)


def _labels(records: Any) -> list[str]:
    return [verdict.configuration.label for verdict in qualifying(_found(records))]


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


def test_a_solver_without_wrapper_is_judged_natively(records: Any) -> None:
    """A solver that was run on route native only has that as its default route."""
    records.loop("qoco", route="native")
    records.replay("qoco", route="native")
    (verdict,) = _found(records).references
    assert (verdict.state, verdict.configuration.route) == ("pass", "native")


def test_the_fastest_configuration_is_one_with_right_answers(records: Any) -> None:
    """A faster configuration whose answers fail, or fail, is no candidate."""
    records.replay("daqp", median_us=20.0)
    records.replay("daqp", median_us=10.0, route="native", policy="reuse")
    records.replay("daqp", median_us=5.0, route="native", policy="warm", error=0.5)
    records.replay("scs", median_us=1.0, route="native", policy="warm", failed=1)
    assert _labels(records) == ["daqp (native reuse)", "daqp (qpsolvers fresh)"]


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
    assert [judged_on(v) for v in qualifying(_found(records))] == ["1 replay", "1 replay"]
    text = Report.of(records.results()).recommendation.sentence
    assert text.startswith("Nothing contradicts daqp (native, warm, default): right on every step")
    assert "of 1 replay" in text and "no closed loop was run" in text


@pytest.mark.parametrize("witness", [{"first_visit_ratio": 40.0}, {"loop_ratio": 40.0}])
def test_who_remembers_answers_is_never_the_fastest(
    records: Any, witness: dict[str, float]
) -> None:
    """Times of remembered answers leave the verdict open, and win no place."""
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


def test_figures_come_from_the_sequence_with_the_worst_p99(records: Any) -> None:
    """p50 and p99 belong to one sequence, so p50 never exceeds p99; the largest step is of all.

    Without spread every algorithmic time is the median itself, rounded to 1 ns.
    """
    records.replay("daqp", steps=1000, median_us=10.0, spread=0.0)
    records.replay("daqp", "rough[900:1100]", steps=200, median_us=30.0, spread=0.0)
    (found,) = qualifying(_found(records))
    assert (found.p50_ns, found.p99_ns, found.timed_on) == (10e3, 10e3, "paper")
    assert found.algo_max_ns == 30e3


def test_short_sequences_have_a_fastest_configuration_without_p99(records: Any) -> None:
    """With too few steps for a p99 the largest step ranks, and the text says so."""
    records.replay("slow", steps=100, median_us=40.0)
    records.replay("fast", steps=100, median_us=10.0)
    assert [v.configuration.solver for v in qualifying(_found(records))] == ["fast", "slow"]
    assert math.isnan(qualifying(_found(records))[0].p99_ns)
    records.replay("daqp", steps=100, median_us=5.0)
    assert "p99" not in records.ending()["answer"] and "p50" in records.ending()["answer"]


def test_usual_settings_are_named_where_others_are_hardly_faster(records: Any) -> None:
    """A settings level that is 1 % faster does not displace `default`; one that is 20 % does."""
    for solver, median in (("same", 9.9), ("better", 8.0)):
        for settings, us in (("default", 10.0), ("high", median)):
            records.replay(solver, median_us=us, spread=0.0, settings=settings)
    found = _found(records)
    fastest = {solver: fastest_of(found, solver) for solver in ("same", "better")}
    settings = {solver: best and best.configuration.settings for solver, best in fastest.items()}
    assert settings == {"same": "default", "better": "high"}


def test_a_level_that_is_faster_by_one_lucky_round_does_not_displace_the_default(
    records: Any,
) -> None:
    """The least of the rounds is lower by half, but the slow rounds of both are alike: on a machine
    of two speeds the level that met the fast one is not the faster one."""
    records.replay("daqp", median_us=12.0, spread=0.0)
    records.replay("daqp", median_us=7.0, spread=0.0, settings="high")
    assert _settings(records) == "high", "without a slow round it is faster"
    steps = records._steps[-1]
    last = steps["repeat"] == steps["repeat"].max()
    steps.loc[last, "total_ns"] = 13_000
    assert _settings(records) == "default"


def _settings(records: Any) -> str:
    best = fastest_of(_found(records), "daqp")
    assert best is not None
    return str(best.configuration.settings)


def test_a_headline_that_cannot_be_told_apart_carries_caution(records: Any) -> None:
    """The fastest way of all and the fastest way of another solver are compared in pairs."""
    for solver in ("daqp", "osqp"):
        records.replay(solver, median_us=10.0, spread=0.1, route="native", policy="warm")
        records.replay(solver, median_us=50.0)
    second = records.ending()["next"]
    assert "cannot be told apart" in second
    assert "(native warm)" in second


def _levels(records: Any) -> list[LevelPoint]:
    view = records.view()
    ways = {run.solver: ("qpsolvers", "fresh") for run in view.runs}
    return [p for points in level_points(view, view.sequences, ways).values() for p in points]


def _reaching(records: Any, error_move: float) -> list[str]:
    """The solvers with a point of this accuracy, the fastest first."""
    points = sorted(_levels(records), key=lambda point: point.p50_ns)
    return [p.configuration.solver for p in points if not p.failed and p.error_move <= error_move]


def test_who_reaches_an_accuracy_is_told_by_its_error(records: Any) -> None:
    """A fast solver with errors of 1e-3 leads at 1e-2 alone."""
    records.replay("rough_one", error=1e-3, median_us=5.0)
    records.replay("exact", error=1e-12, median_us=20.0)
    records.replay("middling", error=1e-5, median_us=10.0)
    assert _reaching(records, 1e-2) == ["rough_one", "middling", "exact"]
    assert _reaching(records, 1e-4) == ["middling", "exact"]
    assert _reaching(records, 1e-6) == ["exact"]


def test_tighter_settings_reach_a_higher_accuracy(records: Any) -> None:
    """Each settings level is a point of its own."""
    records.replay("osqp", error=1e-3, median_us=10.0)
    records.replay("osqp", error=1e-8, median_us=30.0, settings="high")
    reach = {p.configuration.settings: p.error_move <= 1e-4 for p in _levels(records)}
    assert reach == {"default": False, "high": True}


def test_an_accuracy_has_to_be_achieved_on_every_sequence(records: Any) -> None:
    """One sequence with a larger error takes it away, and a failed step does."""
    for solver, error, failed in (("once", 1e-3, 0), ("both", 1e-7, 0), ("failing", 1e-7, 1)):
        records.replay(solver, error=1e-7)
        records.replay(solver, "rough[900:1400]", error=error, failed=failed)
    assert _reaching(records, 1e-6) == ["both"]
    assert {p.configuration.solver: p.error_move for p in _levels(records)}["once"] == 1e-3


@pytest.mark.parametrize(
    ("fill", "says"),
    [
        (False, "Nothing is recommended, as no replay left a step, so nothing is timed."),
        (True, "Nothing is recommended: no solver passes in any configuration that was"),
    ],
)
def test_no_candidate_is_said_plainly(records: Any, fill: bool, says: str) -> None:
    """Without any right replay nobody is called fastest, and without any nobody is called wrong."""
    records.loop("osqp")
    if fill:
        records.replay("osqp", error=0.5)
    assert Report.of(records.results()).recommendation.sentence.startswith(says)
    assert ranked_qualifying(_found(records)) == []
