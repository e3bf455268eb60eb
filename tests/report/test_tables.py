"""Tables: their population, their order and what they refuse to print."""

import math
from typing import Any

import pytest

from dpbench.analysis.demand import Demand
from dpbench.report.table import Table, markdown, row_of
from dpbench.report.tables_accuracy import accuracy_table, units_matrix, units_table
from dpbench.report.tables_control import control_tables
from dpbench.report.tables_runs import population_table, unfinished_table
from dpbench.report.tables_timing import jitter_table, timing_tables

DEMAND = Demand()


def _column(table: Table, head: str) -> list[str]:
    i = table.heads.index(head)
    return [row[i].text for row in table.rows]


def test_a_ragged_table_is_refused() -> None:
    """Every row has as many cells as there are heads."""
    with pytest.raises(ValueError, match="expected 2 cells, found 1"):
        Table("t", "", ("a", "b"), (row_of("1"),))


def test_pipes_do_not_break_markdown() -> None:
    """A pipe in a reason stays inside its cell."""
    assert markdown(Table("t", "", ("a",), (row_of("x | y"),))).endswith("| x \\| y |")


def test_accuracy_is_sorted_by_error_with_the_baseline_law_last(records: Any) -> None:
    """The most exact solver comes first, one without an answer after all others."""
    records.loop("unconstrained_clipped", formulation="none", error=1e-3)
    records.loop("silent", error=math.inf)
    records.loop("rough", error=0.1)
    records.loop("exact", error=1e-13)
    table = accuracy_table(records.view(), "paper", DEMAND)
    assert table is not None
    assert _column(table, "solver") == [
        "exact",
        "rough",
        "silent",
        "unconstrained_clipped (baseline_law)",
    ]
    assert _column(table, "error_move max")[2] == "no answer"


def test_short_loops_do_not_mix_with_full_ones(records: Any) -> None:
    """The accuracy table holds full-length runs at default settings in scaled units only."""
    records.loop("daqp", steps=100)
    records.loop("daqp", steps=40, settings="high")
    records.loop("daqp", steps=40, units="si")
    table = accuracy_table(records.view(), "paper", DEMAND)
    assert table is not None
    assert _column(table, "steps") == ["100"]


def test_units_compare_the_same_first_steps(records: Any) -> None:
    """A full-length run is cut to the steps its neighbours have, before it is compared.

    The large error of the record is in the last step, which is beyond the cut.
    """
    records.loop("daqp", steps=120, error=0.9)
    records.loop("daqp", steps=30, units="si", error=0.5)
    matrix = units_matrix(records.view())
    assert matrix is not None
    scaled = matrix.cells["daqp", ("paper", "scaled", "default")]
    si = matrix.cells["daqp", ("paper", "si", "default")]
    assert (scaled.steps, si.steps) == (30, 30)
    assert scaled.error_move < 0.5 + 1e-12 < 0.9
    assert si.error_move == 0.5
    assert len(units_table(matrix).heads) == 3


def test_a_step_never_reached_is_not_true(records: Any) -> None:
    """A run that stopped half way has at most half of its steps right."""
    records.loop("daqp", steps=40)
    records.loop("daqp", steps=40, done=20, units="si", outcome="timed_out")
    matrix = units_matrix(records.view())
    assert matrix is not None
    assert matrix.cells["daqp", ("paper", "si", "default")].true_share == 0.5


def test_timing_refuses_a_p99_of_few_steps(records: Any) -> None:
    """Five hundred steps have a p95 and no p99, and the note says so."""
    records.replay("daqp", steps=500, median_us=20.0)
    (table,) = timing_tables(records.view(), "paper", DEMAND)
    assert _column(table, "p99 [µs]") == ["–"]
    assert _column(table, "p95 [µs]") != ["–"]
    assert "do not support a p99" in table.note


@pytest.mark.slow
def test_raw_tails_need_their_samples(records: Any) -> None:
    """A p99.9 needs 10 000 samples, and the table counts them."""
    records.replay("few", steps=1000, rounds=3)
    records.replay("many", steps=1000, rounds=10)
    table = jitter_table(records.view(), "paper")
    assert table is not None
    shown = dict(zip(_column(table, "solver"), _column(table, "raw p99.9 [µs]"), strict=True))
    assert shown["few"] == "–" != shown["many"]
    assert sorted(_column(table, "samples")) == ["10\u202f000", "3\u202f000"]


@pytest.mark.slow
def test_settings_without_effect_are_named(records: Any) -> None:
    """A solver whose settings do nothing is shown under both names, and the note says so."""
    for settings in ("default", "high"):
        records.replay("quadprog", settings=settings, raw_p50_ns=1.0, raw_max_ns=2.0)
        records.replay("osqp", settings=settings)
    table, others = timing_tables(records.view(), "paper", DEMAND)
    assert others.folded
    assert "Settings have no effect on quadprog:" in table.note


def test_control_is_sorted_by_deviation_and_counts_steps(records: Any) -> None:
    """Control tables start with the loop closest to the exact one and print how far each got."""
    records.loop("far", error=0.9)
    records.loop("near", error=1e-9, done=60, outcome="timed_out")
    main, more = control_tables(records.view(), "paper", DEMAND)
    assert _column(main, "solver") == ["near", "far"]
    assert _column(main, "steps") == ["60", "120"]
    assert "near (60 steps)" in main.note
    assert more.folded


def test_every_unfinished_cell_is_counted_with_its_reason(records: Any) -> None:
    """No cell that failed is hidden, and equal reasons stand together."""
    records.loop("daqp")
    for policy in ("reuse", "warm"):
        records.refused("ecos", "it keeps no workspace", policy=policy)
    records.loop("highs", outcome="crashed", outcome_detail="signal 11", done=0)
    table = unfinished_table(records.view())
    assert table is not None
    assert _column(table, "cells") == ["2", "1"]
    assert _column(table, "reason") == ["it keeps no workspace", "signal 11"]
    assert _column(population_table(records.view()), "finished") == ["1", "0", "0"]


def test_steps_undecided_at_rounding_are_said_with_the_accuracy(records: Any) -> None:
    """Where there are any, their count stands below the title; where not, nothing is said."""
    records.loop("daqp")
    table = accuracy_table(records.view(), "paper", DEMAND)
    assert table is not None and "undecided" not in table.note
    records.loop("osqp", undecided_steps=6)
    table = accuracy_table(records.view(), "paper", DEMAND)
    assert table is not None and "6 steps of them all are feasible or infeasible only" in table.note


def test_a_generic_build_is_marked_beside_its_times(records: Any) -> None:
    """Each row of a solver on a generic build has the mark, and one sentence says which build."""
    records.replay("hpipm", median_us=30.0, build="BLASFEO generic", generic_build=True)
    records.replay("piqp", median_us=50.0, build="AVX2", generic_build=False)
    view = records.view()
    (times,), raw = timing_tables(view, "paper", DEMAND), jitter_table(view, "paper")
    assert raw is not None
    for table in (times, raw):
        assert _column(table, "solver") == ["hpipm †", "piqp"]
        assert table.note.count("†: BLASFEO generic:") == 1
        assert "AVX2" not in table.note
    assert _column(population_table(view), "build") == ["BLASFEO generic", "AVX2"]


def test_without_a_generic_build_there_is_no_mark(records: Any) -> None:
    """Records without one say nothing of builds beside times."""
    records.replay("piqp", median_us=50.0, build="AVX2", generic_build=False)
    (times,) = timing_tables(records.view(), "paper", DEMAND)
    assert "†" not in times.note and _column(times, "solver") == ["piqp"]


@pytest.mark.slow
def test_remembered_answers_are_marked_beside_their_times(records: Any) -> None:
    """Either witness marks a row: its first visits, or its own closed loop; no other is."""
    records.replay("by_first", median_us=14.0, first_visit_ratio=140.0)
    records.replay("by_loop", median_us=15.0, first_visit_ratio=1.0, loop_ratio=140.0)
    records.replay("honest", median_us=30.0, first_visit_ratio=1.1, loop_ratio=1.5)
    (times,) = timing_tables(records.view(), "paper", DEMAND)
    assert _column(times, "solver") == ["by_first ‡", "by_loop ‡", "honest"]
    assert times.note.count("‡: it remembers answers") == 1
