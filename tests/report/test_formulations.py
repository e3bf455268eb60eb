"""Formulations side by side, and nowhere else mixed."""

from typing import Any

import pytest

from dpbench.analysis.demand import Demand
from dpbench.analysis.times.routes import route_comparisons
from dpbench.analysis.verdict import verdicts_of
from dpbench.report.formulations import OTHERS, formulation_tables
from dpbench.report.sections_time import timing_section
from dpbench.report.table import Table
from dpbench.report.tables_timing import timed_configurations
from dpbench.report.verdict_text import sentence

DEMAND = Demand()
CALM = {"spread": 0.05}


def _row(table: Table, solver: str) -> dict[str, str]:
    (row,) = [row for row in table.rows if row[0].text == solver]
    return {head: cell.text for head, cell in zip(table.heads, row, strict=True)}


def test_common_and_best_stand_side_by_side(records: Any) -> None:
    """The ratio of two configurations of known medians, 1000 paired steps of spread 0.07: 1 % is 4
    sigma. A form whose answers miss the demand is never the best, however fast; the fastest
    configuration is first."""
    records.replay("osqp", median_us=80.0, **CALM)
    records.replay("osqp", median_us=40.0, formulation="sparse", **CALM)
    records.replay("osqp", median_us=20.0, formulation="condensed_stacked", error=0.5, **CALM)
    records.replay("daqp", median_us=10.0, **CALM)
    records.replay("daqp", median_us=500.0, formulation="sparse", **CALM)
    records.replay("clarabel", median_us=15.0, **CALM)
    (table,) = formulation_tables(records.view(), DEMAND)
    assert [row[0].text for row in table.rows] == ["daqp", "osqp"]
    osqp = _row(table, "osqp")
    assert osqp["best formulation"] == "sparse"
    assert float(osqp["common over best"]) == pytest.approx(2.0, rel=0.01)
    low, high = (float(x) for x in osqp["interval"].strip("[]").split(","))
    assert low <= 2.0 <= high and 0.0 < high - low < 0.05
    assert float(osqp["condensed box [µs]"]) == pytest.approx(80.0, rel=0.02)
    assert float(osqp["condensed stacked [µs]"]) == pytest.approx(20.0, rel=0.02)
    daqp = _row(table, "daqp")
    assert (daqp["best formulation"], daqp["common over best"]) == ("condensed box", "1")
    # DAQP was never stacked.
    assert daqp["condensed stacked [µs]"] == "–"


@pytest.mark.slow
def test_configurations_are_told_apart_and_refusals_shown(records: Any) -> None:
    """Route, policy, settings and units make rows and tables of their own; a refused form is a
    word, not a gap."""
    for units in ("scaled", "si"):
        for route, median in (("qpsolvers", 50.0), ("native", 40.0)):
            configuration = {"route": route, "units": units}
            records.replay("piqp", median_us=median, **configuration)
            records.replay("piqp", median_us=90.0, formulation="sparse", **configuration)
    records.replay("quadprog", median_us=20.0)
    records.refused("quadprog", "P is only semidefinite", "replay", formulation="sparse")
    scaled, si = formulation_tables(records.view(), DEMAND)
    assert [(row[0].text, row[1].text) for row in scaled.rows] == [
        ("quadprog", "qpsolvers"),
        ("piqp", "native"),
        ("piqp", "qpsolvers"),
    ]
    assert _row(scaled, "quadprog")["sparse [µs]"] == "refused"
    assert len(si.rows) == 2 and si.title.endswith("SI units")


def test_without_a_second_formulation_there_is_nothing_to_say(records: Any) -> None:
    """One formulation, or each sequence in one of its own, is no comparison."""
    records.replay("daqp")
    records.replay("daqp", sequence="rough", formulation="sparse")
    view = records.view()
    assert formulation_tables(view, DEMAND) == []
    texts = [getattr(block, "text", "") for block in timing_section(view, DEMAND).blocks]
    assert OTHERS not in texts
    # The only formulation of a sequence is its common one.
    assert [run.formulation for run, _ in timed_configurations(view, "rough")] == ["sparse"]


def test_rankings_and_verdicts_keep_to_the_common_formulation(records: Any) -> None:
    """A sparse configuration that is faster, or wrong, moves no ranking, no way and no verdict."""
    records.replay("osqp", median_us=80.0, route="native", policy="reuse")
    records.replay("osqp", median_us=90.0, route="native", policy="fresh")
    records.loop("osqp", route="native")
    before = records.view()
    expected = (
        [sentence(v, DEMAND) for v in verdicts_of(before, DEMAND).all],
        [w.median_ns(way) for w in route_comparisons(before, "paper") for way in sorted(w.times)],
        [run.run_id for run, _ in timed_configurations(before, "paper")],
    )
    configuration = {"route": "native", "formulation": "sparse", "error": 0.7}
    records.replay("osqp", median_us=5.0, policy="reuse", **configuration)
    records.replay("osqp", median_us=5.0, policy="fresh", **configuration)
    records.loop("osqp", failed=9, **configuration)
    after = records.view()
    found = (
        [sentence(v, DEMAND) for v in verdicts_of(after, DEMAND).all],
        [w.median_ns(way) for w in route_comparisons(after, "paper") for way in sorted(w.times)],
        [run.run_id for run, _ in timed_configurations(after, "paper")],
    )
    assert found == expected
    assert len(after.all_runs) == len(before.all_runs) + 3
