"""Tables of the report: `tables/*.csv` with a legend, written and read, and the frames."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from pandas.api.types import is_bool_dtype, is_numeric_dtype

from dpbench.analysis.suites.study_tables import (
    tabulate_differences_from_reference,
    tabulate_study_points,
)
from dpbench.analysis.times.solver_tables import (
    tabulate_best_times,
    tabulate_experiment_verdicts,
    tabulate_hard_steps,
    tabulate_time_ratios,
    tabulate_verdicts,
)
from dpbench.analysis.verdict.ship_results import tabulate_ship_results
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import RUN_COLUMNS
from dpbench.errors import ResultsError
from dpbench.files.writing import write_file_set_into_folder
from dpbench.report.formats import Table, escape_markdown
from dpbench.report.page.data import PageData
from dpbench.report.page.recommendation import Recommendation
from dpbench.report.page.section import Topic
from dpbench.report.study_effects_table import build_effects_table
from dpbench.report.words import read_words, render_document

LEGEND = "README.md"
TABLES: dict[str, str] = read_words(__file__)["tables"]
COLUMNS: dict[str, str] = read_words(__file__)["columns"]
_TEXT_COLUMNS = [name for name, (kind, _) in RUN_COLUMNS.items() if kind == "str"]
_ARMED = r"^'(?=[-=+@])"
"""The apostrophe that keeps a spreadsheet from reading a text as a formula."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""First characters of a formula in a spreadsheet."""
RUN_MEANINGS = {name: meaning for name, (_, meaning) in RUN_COLUMNS.items()}


def build_tables(
    results: Results, data: PageData, recommendation: Recommendation, topics: Sequence[Topic]
) -> dict[str, pd.DataFrame]:
    """Build all tables of the report as data frames by name; some may be empty."""
    verdicts, ladder = tabulate_verdicts(data), tabulate_best_times(data).drop(columns="id")
    if len(verdicts):
        why = [recommendation.why(verdict) for verdict in data.verdicts.all_verdicts]
        verdicts.insert(list(verdicts).index("verdict") + 1, "why", why)
    times = [name for name in ladder.columns if name.endswith("_ms")]
    ladder[times] = 1e3 * ladder[times]
    tables = {
        "ships": tabulate_ship_results(data.ships),
        "runs": results.runs.drop(columns="cell"),
        "verdicts": verdicts,
        "experiments": tabulate_experiment_verdicts(data),
        "hard_steps": tabulate_hard_steps(data, data.thinned_runs),
        "ladder": ladder.rename(columns={n: f"{n.removesuffix('_ms')}_us" for n in times}),
        "paired_ratios": tabulate_time_ratios(data),
        "study_behind": tabulate_differences_from_reference(data.studies),
        "study_points": tabulate_study_points(data.studies),
        "study_effects": build_effects_table(data.studies),
    }
    # Those of a study are written as numbers above.
    for topic in (topic for topic in topics if topic.id != "study"):
        for i, small in enumerate(topic.tables):
            name = topic.id if i == 0 else f"{topic.id}_{i + 1}"
            tables[name] = convert_to_frame(small)
    return tables


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write the report's tables as CSV with a README; remove those of earlier reports.

    Raises InputError where the folder is a link.
    """
    written = {name: table for name, table in tables.items() if len(table)}
    contents = {f"{name}.csv": partial(encode_csv, table) for name, table in written.items()}
    of_runs = {"runs": RUN_MEANINGS, "ships": RUN_MEANINGS | COLUMNS}
    known = {name: of_runs.get(name, COLUMNS) for name in written}
    wording = {
        escape_markdown(name): (
            TABLES.get(name, "A table of a part of the page."),
            {column: known[name][column] for column in table if column in known[name]},
        )
        for name, table in written.items()
    }
    legend = render_document("tables.md", tables=wording)
    write_file_set_into_folder(folder, {**contents, LEGEND: legend.encode})


def read_table(path: Path) -> pd.DataFrame:
    """Return a table that `write_tables` wrote; an empty text is "", as in the report.

    ResultsError, naming the file, where it is damaged.
    """
    try:
        table = pd.read_csv(path, dtype=dict.fromkeys(_TEXT_COLUMNS, "str"))
    except (OSError, ValueError) as error:
        found = f"a damaged file ({str(error)[:80]})"
        raise ResultsError(str(path), "", found, "a table of a report") from error
    for name, dtype in table.dtypes.items():
        if not (is_numeric_dtype(dtype) or is_bool_dtype(dtype)):
            table[name] = table[name].fillna("").str.replace(_ARMED, "", regex=True)
    return table


def convert_to_frame(table: Table) -> pd.DataFrame:
    """Return all rows of a table as a DataFrame of text."""
    return pd.DataFrame(table.rows, columns=list(table.heads))


def encode_csv(table: pd.DataFrame) -> bytes:
    """Encode a table as CSV; an apostrophe precedes texts that a spreadsheet takes for formulas."""
    named = table.rename(columns={name: _disarm_formula(name) for name in table.columns})
    texts = [i for i, dtype in enumerate(named.dtypes) if not is_numeric_dtype(dtype)]
    for i in texts:
        plain = named.iloc[:, i].map(_disarm_formula, na_action="ignore")
        named.isetitem(i, plain.to_numpy(dtype=object))
    return bytes(named.to_csv(index=False).encode())


def _disarm_formula(value: Any) -> Any:
    """Put an apostrophe before a text that a spreadsheet would take for a formula."""
    if not isinstance(value, str) or not value.startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value
