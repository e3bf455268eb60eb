"""Grids of settings as tables, against points written by hand."""

import json
from typing import Any

from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.report.report import Report
from dpbench.report.settings_grids import make_grid_tables, tabulate_settings_grids


def add(records: Any, error: float, **options: object) -> None:
    """A closed loop and a replay of OSQP at some options."""
    own = {"settings": ",".join(map(str, options.values())), "options": json.dumps(options)}
    records.loop("osqp", error=error, **own)
    records.replay("osqp", median_us=10.0, spread=0.0, **own)


def test_a_grid_over_two_options_has_one_down_and_one_across(records: Any) -> None:
    """Sorted as numbers; a point that was not run has an empty cell, and `max_iter` no axis."""
    for eps, rho, error in ((1e-3, 10, 0.4), (1e-3, 2, 0.3), (1e-6, 10, 1e-9)):
        add(records, error, rho=rho, eps_abs=eps, max_iter=50)
    verdicts = judge_solvers(records.view(), Requirements())
    (table,) = make_grid_tables(verdicts)
    assert table.title == "Grid of osqp over eps_abs and rho"
    assert table.heads == ("eps_abs", "rho=2", "rho=10")
    assert table.rows == (("1e-6", "–", "pass, 10.0 µs"), ("0.001", "fail, 0.30", "fail, 0.40"))
    report = Report.from_results(records.results())
    (topic,) = (topic for topic in report.topics if topic.id == "settings")
    assert topic.tables[0] == table


def test_the_best_of_a_grid_has_the_smallest_limiting_p99(records: Any) -> None:
    """Its p99 is larger, but its closed loop needs no more iterations than its replay."""
    for rho, us, iterations in ((1, 10.0, 40.0), (2, 12.0, 10.0), (3, 30.0, 10.0)):
        own = {"settings": str(rho), "options": json.dumps({"rho": rho, "alpha": 1 + rho % 2 / 4})}
        records.loop("osqp", iterations_p99=iterations, iterations_max=iterations, **own)
        figures = {"iterations_p99": 9.0, "iterations_max": 9.0}
        records.replay("osqp", median_us=us, spread=0.0, **figures, **own)
    rows = Report.from_results(records.results()).summary_rows()
    (best,) = (text for about, text in rows if text.startswith("Best of 3"))
    assert best.startswith("Best of 3 settings of osqp by limiting p99 (13.2 µs): 2;")
    verdicts = judge_solvers(records.view(), Requirements())
    (table,) = make_grid_tables(verdicts)
    assert "pass, 13.2 µs" in table.rows[0]
    limiting = tabulate_settings_grids(verdicts)["limiting_p99_us"]
    assert sorted(limiting.round(1)) == [13.2, 33.0, 41.0]


def test_the_points_of_a_grid_have_a_column_per_varied_option(records: Any) -> None:
    """A grid of three options has numbers and text; settings that are no grid are left out."""
    for rho, alpha, kind in ((1, 1.5, "a"), (2, 1.5, "b"), (1, 1.6, "b")):
        add(records, 0.3, rho=rho, alpha=alpha, linsys=kind)
    add(records, 0.3, sigma=1e-5)
    verdicts = judge_solvers(records.view(), Requirements())
    assert make_grid_tables(verdicts) == []
    table = tabulate_settings_grids(verdicts)
    found = table[["x_rho", "x_alpha", "x_linsys"]].to_numpy().tolist()
    assert sorted(found) == [[1.0, 1.5, '"a"'], [1.0, 1.6, '"b"'], [2.0, 1.5, '"b"']]
    assert set(table["verdict"]) == {"fail"} and set(table["error_move"]) == {0.3}
