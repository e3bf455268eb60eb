"""The section on slow computers: who survives what, and that nothing else counts such loops."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from dpbench.analysis.demand import Demand
from dpbench.analysis.slowdown import DelayedGroup, cost_ratio, delayed_groups
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.record.schema import as_steps
from dpbench.report.figures_deadline import slowdown_figure
from dpbench.report.render import render_markdown
from dpbench.report.section_deadline import deadline_lines, deadline_section
from dpbench.report.style import styled
from dpbench.report.table import Table
from dpbench.report.tables_control import control_tables
from dpbench.report.tables_deadline import misses_table, survival_table
from dpbench.report.write import build_page, verdict_lines, write_report

COSTS = {
    "daqp": {1: 100.0, 100: 100.0, 1000: 109.9, 10000: 130.0},
    # Good luck on a slower computer does not make up for bad luck on a faster one.
    "hildreth": {1: 100.0, 100: 111.0, 1000: 100.0, 10000: 500.0},
    "scs": {1: 112.0, 100: 200.0, 1000: 1e6, 10000: 1e7},
}


def slow(records: Any, solver: str, slowdown: float, cost: float, **columns: Any) -> None:
    """A loop on a slow computer; the exactly solved loop costs 100."""
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
    (group,) = delayed_groups(records.view())
    return group


def column(table: Table, head: str) -> list[str]:
    """The texts of a column."""
    at = table.heads.index(head)
    return [row[at].text for row in table.rows]


def test_survival_ends_at_the_first_loop_that_costs_more(records: Any) -> None:
    """109.9 is within 10 % of 100, 111 is not; what comes after a lost loop does not count."""
    fill(records)
    survives = {
        configuration.name: configuration.survives
        for configuration in group_of(records).configurations
    }
    assert (survives["daqp"], survives["hildreth"]) == (1000.0, 1.0)
    assert math.isnan(survives["scs"])


def test_a_violated_limit_or_an_early_end_is_no_survival(records: Any) -> None:
    """A loop that broke a limit or was stopped is lost, however little it cost."""
    slow(records, "daqp", 1, 100.0, limit_violations=1)
    slow(records, "osqp", 1, 100.0, done=119, outcome="timed_out")
    configurations = group_of(records).configurations
    assert all(math.isnan(configuration.survives) for configuration in configurations)
    ratios = {
        configuration.name: cost_ratio(configuration.loops[1.0]) for configuration in configurations
    }
    assert ratios["daqp"] == 1.0 and math.isnan(ratios["osqp"])


def test_the_table_shows_cost_by_slow_down_best_first(records: Any) -> None:
    """One row a configuration, one column a slow-down; a loop that ended early says how."""
    fill(records)
    table = survival_table(group_of(records), "a CPU")
    assert column(table, "solver") == ["daqp", "hildreth", "scs"]
    assert column(table, "survives") == ["1\u202f000 ×", "1 ×", "none"]
    assert column(table, "cost at 100 ×") == ["1.00", "1.11", "2.00"]
    assert column(table, "cost at 10\u202f000 ×") == ["timed out", "5.00", "100\u202f000"]
    assert column(table, "step time p50")[0] == "20.0 µs"
    marks = [row[table.heads.index("cost at 1 ×")].mark for row in table.rows]
    assert marks == ["", "", "bad"]


def test_the_second_table_has_every_loop(records: Any) -> None:
    """Misses, streaks, recovery and latencies of all twelve loops."""
    fill(records)
    table = misses_table(group_of(records))
    assert len(table.rows) == 12
    assert set(column(table, "misses")) == {"7"} and set(column(table, "longest streak")) == {"3"}
    assert column(table, "latency p50")[:4] == ["20.0 µs", "2.00 ms", "20.0 ms", "200 ms"]


def test_no_recovery_is_told_from_none_needed(records: Any) -> None:
    """A loop that missed and never came back says so; one that missed nothing has a dash."""
    slow(records, "daqp", 1, 100.0, deadline_misses=0, miss_recover_steps_max=None)
    slow(records, "osqp", 1, 100.0, deadline_misses=3, miss_recover_steps_max=None)
    table = misses_table(group_of(records))
    shown = dict(zip(column(table, "solver"), column(table, "recovery [steps]"), strict=True))
    assert shown == {"daqp": "–", "osqp": "never"}


def test_a_suite_of_slow_loops_names_its_scenarios_and_no_rounds(records: Any) -> None:
    """What was run: the scenario is that of the slow loops, and nothing was replayed."""
    slow(records, "daqp", 1, 100.0)
    page = render_markdown(build_page(records.results()))
    said = next(line for line in page.splitlines() if line.startswith("1 cell with"))
    assert "in `paper`;" in said and "replay" not in said


@pytest.mark.slow
def test_loops_on_slow_computers_are_in_no_other_section(records: Any) -> None:
    """Verdict, control and figures of ordinary loops are the same with and without them."""
    for solver in COSTS:
        records.loop(solver)
    before = build_page(records.results())
    fill(records)
    after = build_page(records.results())
    keys = [section.key for section in after.sections]
    assert keys.index("deadline") == keys.index("control") + 1
    assert [key for key in keys if key != "deadline"] == [s.key for s in before.sections]
    for key in ("verdict", "accuracy", "control", "timing"):
        old, new = (
            next(s for s in page.sections if s.key == key).blocks for page in (before, after)
        )
        assert [repr(b) for b in old] == [repr(b) for b in new], key
    assert deadline_section(records.view()) is not None


def test_without_such_loops_there_is_no_section(records: Any) -> None:
    """A campaign whose ships wait for their answers has nothing to say on late ones."""
    records.loop("daqp")
    assert deadline_section(records.view()) is None and deadline_lines(records.view()) == []
    assert all(section.key != "deadline" for section in build_page(records.results()).sections)


@pytest.mark.slow
def test_a_suite_of_slow_computers_alone_has_a_report(records: Any, tmp_path: Path) -> None:
    """Nothing is missing from it, and the terminal hears who survives what."""
    fill(records)
    out = records.write(tmp_path / "slow")
    html = write_report(out).read_text(encoding="utf-8")
    assert "Missing:" not in html and "slowdown_1" in (out / "report.md").read_text("utf-8")
    (line,) = verdict_lines(load_results(out))
    assert "1\u202f000 ×: daqp; up to 1 ×: hildreth; at no slow-down: scs." in line


@pytest.mark.slow
def test_the_figure_has_a_line_per_configuration_that_ends_where_runs_end(records: Any) -> None:
    """Log on both axes; the loop of daqp that was stopped is no point of its line."""
    fill(records)
    with styled():
        figure = slowdown_figure(group_of(records))
    (ax,) = figure.axes
    assert isinstance(figure, Figure) and ax.get_xscale() == ax.get_yscale() == "log"
    lines = [line for line in ax.lines if len(line.get_xdata()) > 2]
    found = {tuple(np.asarray(line.get_xdata()).tolist()) for line in lines}
    assert found == {(1.0, 100.0, 1000.0), (1.0, 100.0, 1000.0, 10000.0)}
    assert {text.get_text() for text in ax.texts} == set(COSTS)


def test_the_control_table_counts_what_misses_the_demands_deadline(records: Any) -> None:
    """Steps longer than the suite's deadline on this machine, and the longest run of them."""
    records.loop("daqp")
    results = records.results()
    steps = results.steps.copy()
    steps["total_ns"] = 1000
    steps.loc[[3, 4, 5, 9], "total_ns"] = 2_000_001
    results.steps[:] = as_steps(steps)
    view = records.view().__class__(results)
    main, more = control_tables(view, "paper", Demand(deadline_ms=2.0))
    assert column(main, "late") == ["4"] and column(more, "longest late") == ["3"]
    (usual, _) = control_tables(view, "paper", Demand())
    assert column(usual, "late") == ["0"]


@pytest.mark.parametrize("budget", [0.1, 0.3])
def test_budgets_are_groups_of_their_own(records: Any, budget: float) -> None:
    """Loops with another budget of a step are not compared."""
    slow(records, "daqp", 10, 100.0, deadline_s=0.2)
    slow(records, "daqp", 10, 100.0, deadline_s=budget)
    assert [group.deadline_s for group in delayed_groups(records.view())] == [0.2, budget]
