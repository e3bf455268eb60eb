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
from dpbench.analysis.verdict.ship_results import ship_table
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import RUN_COLUMNS
from dpbench.files.writing import write_together
from dpbench.report.page.data import PageData
from dpbench.report.page.recommendation import Recommendation
from dpbench.report.page.section import Topic
from dpbench.report.table import csv_bytes, markdown_text
from dpbench.report.topics.study import build_effects_table
from dpbench.report.words import read_words, render_document

LEGEND = "README.md"
TABLES: dict[str, str] = read_words(__file__)["tables"]
COLUMNS: dict[str, str] = read_words(__file__)["columns"]
RUN_MEANINGS = {name: meaning for name, (_, meaning) in RUN_COLUMNS.items()}


def build_tables(
    results: Results, data: PageData, recommendation: Recommendation, topics: Sequence[Topic]
) -> dict[str, pd.DataFrame]:
    """Build all tables of the report as data frames by name; some may be empty."""
    verdicts, ladder = verdict_table(data), time_table(data).drop(columns="id")
    if len(verdicts):
        why = [recommendation.why(verdict) for verdict in data.verdicts.all]
        verdicts.insert(list(verdicts).index("verdict") + 1, "why", why)
    times = [name for name in ladder.columns if name.endswith("_ms")]
    ladder[times] = 1e3 * ladder[times]
    tables = {
        "ships": ship_table(data.ships),
        "runs": results.runs.drop(columns="cell"),
        "verdicts": verdicts,
        "experiments": experiment_table(data),
        "hard_steps": hard_step_table(data, data.thinned_runs),
        "ladder": ladder.rename(columns={n: f"{n.removesuffix('_ms')}_us" for n in times}),
        "paired_ratios": ratio_table(data),
        "study_effects": build_effects_table(data.studies),
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
    of_runs = {"runs": RUN_MEANINGS, "ships": RUN_MEANINGS | COLUMNS}
    known = {name: of_runs.get(name, COLUMNS) for name in written}
    wording = {
        markdown_text(name): (
            TABLES.get(name, "A table of a part of the page."),
            {column: known[name][column] for column in table if column in known[name]},
        )
        for name, table in written.items()
    }
    legend = render_document("tables.md", tables=wording)
    write_together(folder, {**contents, LEGEND: legend.encode})
