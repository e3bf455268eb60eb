"""Grids of a solver's custom settings as tables, with the varied options as axes or columns."""

import math
from collections.abc import Sequence

import pandas as pd

from dpbench.analysis.times.solver_tables import make_configuration_columns
from dpbench.analysis.verdict.verdict import ACCURATE, Verdict, Verdicts
from dpbench.report.formats import MISSING, Table, as_float, format_error, format_time
from dpbench.report.own_settings_text import format_options_by_name, list_grids, list_varied_options


def make_grid_tables(verdicts: Verdicts) -> list[Table]:
    """Return a table of each grid over two options: a row per value of one, a column of the other.

    A cell has the verdict, and the limiting p99 of accurate settings, else the largest error.
    """
    tables = []
    for points in list_grids(verdicts):
        options = sorted(list_varied_options(points))
        if len(options) == 2:
            tables.append(_make_table_over_two_options(points, *options))
    return tables


def _make_table_over_two_options(points: Sequence[Verdict], down: str, across: str) -> Table:
    """Return the table of a grid with the values of one option down and of another across."""
    values = [format_options_by_name(verdict) for verdict in points]
    cells = {
        (own[down], own[across]): _describe_point(verdict)
        for own, verdict in zip(values, points, strict=True)
    }
    rows, columns = (
        sorted({own[option] for own in values}, key=_make_value_sort_key)
        for option in (down, across)
    )
    return Table(
        (down, *(f"{across}={value}" for value in columns)),
        tuple((row, *(cells.get((row, column), MISSING) for column in columns)) for row in rows),
        f"Grid of {points[0].configuration.solver} over {down} and {across}",
        "Verdict in the best call mode, with the limiting p99 of accurate settings (without a p99 "
        "the longest step), else the largest error of the first move. All points: "
        "tables/settings_grids.csv.",
    )


def _describe_point(verdict: Verdict) -> str:
    """Return verdict and limiting p99, or longest step, as a cell; of inaccurate ones the error."""
    if not verdict.is_finished:
        return f"{verdict.state}, not finished"
    if verdict.state not in ACCURATE:
        return f"{verdict.state}, {format_error(verdict.error_move)}"
    has_p99 = not math.isnan(verdict.p99_ns)
    time_ns = verdict.p99_ns if has_p99 else verdict.longest_ns
    return f"{verdict.state}, {format_time(time_ns)}"


def _make_value_sort_key(value: str) -> tuple[float, str]:
    """Return a sort key of an option's value: numbers in rising order, then texts."""
    number = as_float(value)
    return (math.inf if math.isnan(number) else number), value


COLUMNS = (
    *("solver", "route", "policy", "settings", "options"),
    *("verdict", "error_move", "failed_steps", "p50_us", "limiting_p99_us"),
)
"""Columns of the table of grids besides those of the varied options."""


def tabulate_settings_grids(verdicts: Verdicts) -> pd.DataFrame:
    """Return a table with one row per point of each grid; columns `x_<option>` are its options."""
    rows = []
    for points in list_grids(verdicts):
        varied = sorted(list_varied_options(points))
        for verdict in points:
            own = format_options_by_name(verdict)
            number = {name: as_float(own[name]) for name in varied}
            rows.append(
                make_configuration_columns(verdict.configuration)
                | {f"x_{n}": own[n] if math.isnan(x) else x for n, x in number.items()}
                | {
                    "verdict": verdict.state,
                    "error_move": verdict.error_move,
                    "failed_steps": verdict.failed_steps,
                    "p50_us": verdict.p50_ns / 1e3,
                    "limiting_p99_us": verdict.p99_ns / 1e3,
                }
            )
    table = pd.DataFrame(rows, columns=None if rows else COLUMNS)
    varied_columns = [name for name in table if name not in COLUMNS]
    return table[[*COLUMNS[:5], *varied_columns, *COLUMNS[5:]]]
