"""Tables of the report: `tables/*.csv` with a legend, and the frames of `load_results`."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import pandas as pd

from dpbench.analysis.times.solver_tables import (
    experiment_table,
    hard_step_table,
    ratio_table,
    time_table,
    verdict_table,
)
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import RUN_COLUMNS
from dpbench.files.writing import write_together
from dpbench.report.page.data import PageData
from dpbench.report.page.recommendation import Recommendation
from dpbench.report.page.section import Topic
from dpbench.report.table import csv_bytes, markdown_text
from dpbench.report.words import read_words, render_document

LEGEND = "README.md"
TABLES: dict[str, str] = read_words(__file__)["tables"]
COLUMNS: dict[str, str] = read_words(__file__)["columns"]
RUN_MEANINGS = {name: meaning for name, (_, meaning) in RUN_COLUMNS.items()}


def build_tables(
    results: Results, data: PageData, recommendation: Recommendation, topics: Sequence[Topic]
) -> dict[str, pd.DataFrame]:
    """Build all tables of the report as data frames by name; some may be empty."""
    tables = {
        "runs": results.runs.drop(columns="cell"),
        "verdicts": _verdicts_table(data, recommendation),
        "experiments": experiment_table(data),
        "hard_steps": hard_step_table(data, data.thinned_runs),
        "ladder": _microsecond_times(data),
        "paired_ratios": ratio_table(data),
    }
    for topic in topics:
        for i, small in enumerate(topic.tables):
            name = topic.id if i == 0 else f"{topic.id}_{i + 1}"
            tables[name] = small.frame
    return tables


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write the report's tables as CSV with a README; remove those of earlier reports.

    Raises InputError where the folder is a link.
    """
    written = {name: table for name, table in tables.items() if len(table)}
    contents = {f"{name}.csv": partial(csv_bytes, table) for name, table in written.items()}
    write_together(folder, {**contents, LEGEND: lambda: _describe_tables(written).encode()})


def _describe_tables(tables: Mapping[str, pd.DataFrame]) -> str:
    """Return the README that explains each CSV table and its columns."""
    known = {name: RUN_MEANINGS if name == "runs" else COLUMNS for name in tables}
    wording = {
        markdown_text(name): (
            TABLES.get(name, "A table of a part of the page."),
            {column: known[name][column] for column in table if column in known[name]},
        )
        for name, table in tables.items()
    }
    return render_document("tables.md", tables=wording)


def _microsecond_times(data: PageData) -> pd.DataFrame:
    """Tabulate solvers' step times [µs] and how much slower a computer may be."""
    table = time_table(data).drop(columns="id")
    times = [name for name in table.columns if name.endswith("_ms")]
    table[times] = 1e3 * table[times]
    return table.rename(columns={name: f"{name.removesuffix('_ms')}_us" for name in times})


def _verdicts_table(data: PageData, recommendation: Recommendation) -> pd.DataFrame:
    """Tabulate the verdict on each solver configuration with the reason for it."""
    table = verdict_table(data)
    if len(table):
        why = [recommendation.why(verdict) for verdict in data.verdicts.all]
        table.insert(list(table).index("verdict") + 1, "why", why)
    return table
