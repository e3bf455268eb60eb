"""Wrapper, kept workspace and warm start: differences between neighbouring rows."""

import re
from typing import Any

import pytest

from dpbench.analysis.demand import Demand
from dpbench.analysis.times.routes import (
    KEPT,
    NATIVE,
    WARM,
    WRAPPED,
    RouteComparison,
    native_comparisons,
    route_comparisons,
)
from dpbench.report.routes_text import beside_wrapped, remark_lines, remarks
from dpbench.report.section_use import use_section
from dpbench.report.table import Table
from dpbench.report.tables_use import kept_table, missing_table, route_table

DEMAND = Demand()
CALM = {"spread": 0.05, "steps": 1000}


def _routes(records: Any, solver: str, *medians_us: float | None, **warm: Any) -> None:
    """Replays of qpsolvers fresh, native fresh, native reuse, native warm; None is left out."""
    for (route, policy), median in zip((WRAPPED, NATIVE, KEPT, WARM), medians_us, strict=True):
        more = warm if policy == "warm" else {}
        if median is not None:
            configuration = {"route": route, "policy": policy, "median_us": median}
            records.replay(solver, **CALM, **configuration, **more)


def _ways(records: Any) -> RouteComparison:
    (ways,) = route_comparisons(records.view(), "paper")
    return ways


def _cells(table: Table | None, head: str) -> list[str]:
    assert table is not None
    return [row[table.heads.index(head)].text for row in table.rows]


def test_each_step_down_is_a_ratio_to_the_way_above(records: Any) -> None:
    """Wrapper, reuse and warm gain are the ratios between neighbouring ways.

    The geometric mean of 1000 paired ratios of spread 0.07 is within 1 % of its value (4 sigma),
    and the difference of two medians within 2 % of the larger one.
    """
    _routes(records, "daqp", 40.0, 20.0, 10.0, 8.0)
    table = route_table(route_comparisons(records.view(), "paper"), "paper")
    ratios = [
        float(_cells(table, head)[0].partition(" ")[0])
        for head in ("wrapper ratio", "reuse gains", "warm gains")
    ]
    assert ratios == pytest.approx([2.0, 2.0, 1.25], rel=0.01)
    assert float(_cells(table, "wrapper costs [µs]")[0]) == pytest.approx(20.0, abs=0.8)


@pytest.mark.slow
def test_warm_is_compared_with_fresh_where_there_is_no_reuse(records: Any) -> None:
    """A missing neighbour is skipped, the cell says so, and its reason is listed."""
    _routes(records, "scs", 40.0, 20.0, None, 10.0)
    reason = "policy reuse: it keeps nothing"
    records.refused("scs", reason, "replay", route="native", policy="reuse")
    ways = native_comparisons(route_comparisons(records.view(), "paper"))
    table = route_table(ways, "paper")
    assert _cells(table, "warm gains")[0].endswith("] on fresh")
    assert _cells(table, "native reuse") == ["refused"]
    absent = missing_table({"paper": ways})
    assert (_cells(absent, "way"), _cells(absent, "reason")) == (["native reuse"], [reason])


def test_a_route_that_a_solver_has_not_is_said_so(records: Any) -> None:
    """A solver that only has route native misses the wrapper by nature, not by failure."""
    _routes(records, "paper_active_set", None, 20.0, 10.0, 5.0)
    absent = missing_table(
        {"paper": native_comparisons(route_comparisons(records.view(), "paper"))}
    )
    assert _cells(absent, "reason") == ["it has no route qpsolvers"]


def test_slower_steps_are_counted_beyond_the_noise(records: Any) -> None:
    """A step is slower only when it is so by more than 5 % and by more than 0.2 µs.

    Without spread every other step of both configurations takes its median exactly.
    """
    for policy, slow in (("reuse", {}), ("warm", {1: 1.04, 2: 1.3, 4: 2.0})):
        records.replay("a", median_us=10.0, spread=0.0, route="native", policy=policy, slow=slow)
        records.replay("b", median_us=0.5, spread=0.0, route="native", policy=policy, slow=slow)
    slower = {w.solver: w.compare(WARM, KEPT) for w in route_comparisons(records.view(), "paper")}
    assert {name: found and found.slower for name, found in slower.items()} == {"a": 2, "b": 1}
    assert slower["a"] is not None
    assert slower["a"].slower_ns == pytest.approx(10_000, abs=1)


def test_an_answer_that_a_warm_start_breaks_is_named(records: Any) -> None:
    """A step counts as wrong where the warm answer is not true and its neighbour's is."""
    _routes(records, "scs", 40.0, 20.0, 10.0, 8.0, wrong=(7, 9))
    (clause,) = remarks(_ways(records), 1)
    assert clause.startswith("native warm breaks answers: 2 of 1\u202f000 steps are not true")
    assert clause.endswith("(k = 7, 9)")


def test_a_step_that_neither_solves_is_no_regression(records: Any) -> None:
    """Where the neighbour is wrong as well, the warm start has broken nothing."""
    for policy, wrong in (("reuse", (7, 9)), ("warm", (9,))):
        records.replay("scs", route="native", policy=policy, wrong=wrong)
    found = _ways(records).compare(WARM, KEPT)
    assert found is not None
    assert (found.wrong, found.mended) == ((), 1)


def test_a_warm_start_that_costs_time_is_said_with_its_iterations(records: Any) -> None:
    """The sentence gives the ratio, the slower steps and what the iterations did.

    Two medians of 1.5 apart with spread 0.05 differ on every step by more than 5 %.
    """
    _routes(records, "proxqp", 40.0, 20.0, 10.0, 15.0, iterations=9)
    (clause,) = remarks(_ways(records), 1)
    assert re.match(r"a warm start costs time: native warm takes 1\.(49|50|51?) times", clause)
    assert "1\u202f000 of 1\u202f000 steps slower" in clause
    assert "10.5 iterations on average against 6.50" in clause


def test_native_slower_than_its_own_wrapper_is_said_with_reasons(records: Any) -> None:
    """When no kept native way reaches qpsolvers fresh, the report says why as the rows show it."""
    records.replay("x", median_us=10.0, **CALM)
    records.replay(
        "x", median_us=20.0, **CALM, route="native", policy="reuse", setup=True, form="csc"
    )
    ways = _ways(records)
    text = "; ".join(remarks(ways, 1))
    assert "native reuse takes 2.0" in text or "native reuse takes 1.9" in text
    assert "as long as its own qpsolvers fresh" in text
    assert "of set-up inside each step" in text
    assert "csc matrices against dense" in text
    assert "1 solver on both routes 0 are at least as fast" in beside_wrapped("paper", [ways])


def test_a_solver_that_gains_at_each_step_has_no_remark(records: Any) -> None:
    """Nothing is said about what is as it should be."""
    _routes(records, "daqp", 40.0, 20.0, 10.0, 5.0)
    assert remark_lines([_ways(records)]) == []


def test_gain_of_a_warm_start_through_the_wrapper(records: Any) -> None:
    """A warm start that halves the time is a gain of two, one that does nothing is flagged.

    The geometric mean of 1000 paired ratios of spread 0.07 is within 1 % of 2 (4 sigma).
    """
    for solver, warm_us in (("helped", 10.0), ("untouched", 20.0)):
        records.replay(solver, median_us=20.0, spread=0.05)
        records.replay(solver, median_us=warm_us, spread=0.05, policy="warm")
    table = kept_table(route_comparisons(records.view(), "paper"), "paper")
    assert _cells(table, "") == ["gain", "no difference"]
    assert float(_cells(table, "neighbour / policy")[0]) == pytest.approx(2.0, rel=0.01)


def test_other_settings_are_folded_apart(records: Any) -> None:
    """The open table holds settings default alone; the folded one names the others."""
    for settings in ("default", "mid", "default_polished"):
        for route, policy in (WRAPPED, NATIVE, KEPT):
            records.replay("osqp", route=route, policy=policy, settings=settings, steps=100)
    ways = route_comparisons(records.view(), "paper")
    assert _cells(route_table(ways, "paper"), "solver") == ["osqp"]
    others = route_table(ways, "paper", others=True)
    assert sorted(_cells(others, "settings")) == ["default_polished", "mid"]
    assert others is not None and others.folded


def test_records_without_native_configurations_say_so(records: Any) -> None:
    """A folder from before there was a route native has a section that says what is missing."""
    records.replay("daqp", steps=100)
    texts = [getattr(block, "text", "") for block in use_section(records.view(), DEMAND).blocks]
    assert "Missing: no solver was replayed both natively and through qpsolvers." in texts
    assert not any(block.kind == "table" for block in use_section(records.view(), DEMAND).blocks)
