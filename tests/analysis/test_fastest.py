"""The fastest configurations that nothing is said against."""

import math
from typing import Any

import pytest

from dpbench.analysis.demand import Demand
from dpbench.analysis.times.fastest import fastest_of, podium, ranked
from dpbench.analysis.times.pooled import common_steps
from dpbench.analysis.verdict import Verdicts, verdicts_of
from dpbench.report.table import Table
from dpbench.report.tables_levels import level_tables, levels_of
from dpbench.report.verdict_text import judged_on, recommendation

DEMAND = Demand()


def _found(records: Any) -> Verdicts:
    return verdicts_of(records.view(), DEMAND)


def _labels(records: Any) -> list[str]:
    return [verdict.configuration.label for verdict in ranked(_found(records))]


def test_the_verdict_stays_on_the_default_route(records: Any) -> None:
    """However fast or wrong a native configuration is, the verdict is that of route qpsolvers,
    fresh."""
    records.loop("osqp")
    records.loop("osqp", route="native", policy="warm", error=0.5)
    records.replay("osqp", route="native", policy="fresh", median_us=5.0, error=0.5)
    records.replay("osqp", median_us=50.0)
    (verdict,) = _found(records).references
    assert (verdict.outcome, verdict.configuration.route) == ("meets", "qpsolvers")
    assert verdict.p99_ns > 40e3


def test_a_solver_without_wrapper_is_judged_natively(records: Any) -> None:
    """A solver that was run on route native only has that as its default route."""
    records.loop("qoco", route="native")
    records.replay("qoco", route="native")
    (verdict,) = _found(records).references
    assert (verdict.outcome, verdict.configuration.route) == ("meets", "native")


def test_the_fastest_configuration_is_one_with_right_answers(records: Any) -> None:
    """A faster configuration whose answers miss the demand, or fail, is no candidate."""
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
    assert [judged_on(v) for v in ranked(_found(records))] == ["1 replay", "1 replay"]
    text = recommendation(records.view(), _found(records))[0]
    assert text.startswith("Nothing contradicts **daqp** (route native, policy warm")
    assert "right on every step of 1 replay, no closed loop was run" in text


@pytest.mark.parametrize("witness", [{"first_visit_ratio": 40.0}, {"loop_ratio": 40.0}])
def test_who_remembers_answers_is_never_the_fastest(
    records: Any, witness: dict[str, float]
) -> None:
    """Times of remembered answers leave the verdict open, and win no place."""
    for solver, median in (("table", 1.0), ("daqp", 20.0)):
        records.loop(solver)
        records.replay(solver, median_us=median, **(witness if solver == "table" else {}))
    found = _found(records)
    assert {v.configuration.solver: v.outcome for v in found.references} == {
        "table": "open",
        "daqp": "meets",
    }
    assert _labels(records) == ["daqp (qpsolvers fresh)"]
    pooled = common_steps(records.view(), DEMAND)
    assert pooled is not None
    assert {
        configuration.configuration.solver: configuration.right for configuration in pooled.pooled
    } == {"table": False, "daqp": True}


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
    (found,) = ranked(_found(records))
    assert (found.p50_ns, found.p99_ns, found.timed_on) == (10e3, 10e3, "paper")
    assert found.algo_max_ns == 30e3


def test_short_sequences_have_a_fastest_configuration_without_p99(records: Any) -> None:
    """With too few steps for a p99 the largest step ranks, and the text says so."""
    records.replay("slow", steps=100, median_us=40.0)
    records.replay("fast", steps=100, median_us=10.0)
    assert [v.configuration.solver for v in ranked(_found(records))] == ["fast", "slow"]
    assert math.isnan(ranked(_found(records))[0].p99_ns)
    records.replay("daqp", steps=100, median_us=5.0)
    assert "too few steps for a p99" in recommendation(records.view(), _found(records))[0]


def test_usual_settings_are_named_where_others_are_hardly_faster(records: Any) -> None:
    """A settings level that is 1 % faster does not displace `default`; one that is 20 % does."""
    for solver, median in (("same", 9.9), ("better", 8.0)):
        for settings, us in (("default", 10.0), ("high", median)):
            records.replay(solver, median_us=us, spread=0.0, settings=settings)
    found = _found(records)
    fastest = {solver: fastest_of(found, solver) for solver in ("same", "better")}
    settings = {solver: best and best.configuration.settings for solver, best in fastest.items()}
    assert settings == {"same": "default", "better": "high"}


def test_a_headline_that_cannot_be_told_apart_carries_caution(records: Any) -> None:
    """The fastest way of all and the fastest way of another solver are compared in pairs."""
    for solver in ("daqp", "osqp"):
        records.replay(solver, median_us=10.0, spread=0.1, route="native", policy="warm")
        records.replay(solver, median_us=50.0)
    _, second = recommendation(records.view(), _found(records))
    assert second.startswith("Caution: ")
    assert "cannot be told apart" in second
    assert "(native warm)" in second


def _headline(records: Any) -> list[Table]:
    return level_tables(records.view(), DEMAND)


def _places(table: Table) -> list[tuple[str, str, str]]:
    return [(row[0].text, row[1].text, row[2].text) for row in table.rows]


def test_the_headline_names_who_is_fastest_at_each_accuracy(records: Any) -> None:
    """A fast solver with errors of 1e-3 leads at 1e-2 alone; who has no way is named instead."""
    records.replay("rough_one", error=1e-3, median_us=5.0)
    records.replay("exact", error=1e-12, median_us=20.0)
    records.replay("middling", error=1e-5, median_us=10.0)
    (table,) = _headline(records)
    assert _places(table) == [
        ("≤ 0.01", "1", "rough_one"),
        ("≤ 0.01", "2", "middling"),
        ("≤ 0.01", "3", "exact"),
        ("≤ 0.0001", "1", "middling"),
        ("≤ 0.0001", "2", "exact"),
        ("≤ 1e-06", "1", "exact"),
    ]
    assert "at 0.0001 rough_one; at 1e-06 rough_one and middling" in table.note


def test_tighter_settings_earn_a_place_at_a_higher_accuracy(records: Any) -> None:
    """At each accuracy a solver stands once, with the settings that reach it fastest."""
    records.replay("osqp", error=1e-3, median_us=10.0)
    records.replay("osqp", error=1e-8, median_us=30.0, settings="high")
    (table,) = _headline(records)
    settings = table.heads.index("settings")
    assert [row[settings].text for row in table.rows] == ["default", "high", "high"]


def test_an_accuracy_has_to_be_achieved_on_every_sequence(records: Any) -> None:
    """One sequence with a larger error takes the place away, and the largest error is printed."""
    for solver, error in (("once", 1e-3), ("both", 1e-7)):
        records.replay(solver, error=1e-7)
        records.replay(solver, "rough[900:1400]", error=error)
    (table,) = _headline(records)
    assert [r[2] for r in _places(table) if r[0] == "≤ 1e-06"] == ["both"]
    error = table.heads.index("error_move max")
    shown = {row[2].text: row[error].text for row in table.rows if row[0].text == "≤ 0.01"}
    assert shown == {"once": "1.0e-03", "both": "1.0e-07"}


def test_the_accuracy_of_the_demand_is_among_those_of_the_headline() -> None:
    """A demand of its own is a level of its own; one of the usual three is there once."""
    assert levels_of(Demand(error_move=1e-3)) == [1e-2, 1e-3, 1e-4, 1e-6]
    assert levels_of(Demand(error_move=1e-2)) == [1e-2, 1e-4, 1e-6]


@pytest.mark.slow
def test_places_behind_the_first_five_are_folded(records: Any) -> None:
    """The headline stays short, and nobody is lost."""
    for i in range(7):
        records.replay(f"s{i}", error=1e-3, median_us=10.0 + 5 * i)
    head, rest = _headline(records)
    assert [solver for *_, solver in _places(head)] == [f"s{i}" for i in range(5)]
    assert [(place, solver) for _, place, solver in _places(rest)] == [("6", "s5"), ("7", "s6")]
    assert rest.folded


def test_without_a_right_configuration_there_is_no_headline(records: Any) -> None:
    """No table is made of nobody."""
    records.replay("osqp", error=0.5)
    assert _headline(records) == []


@pytest.mark.parametrize(
    ("fill", "says"),
    [
        (False, "Nothing is recommended, as no replay left a step, so nothing is timed."),
        (True, "Nothing is recommended: no solver meets the demand in any configuration that was"),
    ],
)
def test_no_candidate_is_said_plainly(records: Any, fill: bool, says: str) -> None:
    """Without any right replay nobody is called fastest, and without any nobody is called wrong."""
    records.loop("osqp")
    if fill:
        records.replay("osqp", error=0.5)
    assert recommendation(records.view(), _found(records))[0].startswith(says)
    assert podium(_found(records)) == []
