"""Contents of a report: results, data made of them, recommendation and topics; its tables.

The tables are written as `tables/*.csv` with a legend, and read again.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import pandas as pd
from pandas.api.types import is_bool_dtype, is_numeric_dtype

from dpbench.analysis.records.machine import (
    find_largest_median_by_test_solver,
    select_delayed_loops,
    select_timed_replays,
    sum_disturbances,
)
from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.anytime import tabulate_limited_loops
from dpbench.analysis.suites.capability import build_capability_results, build_consequence_analyses
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
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.ship_results import tabulate_ship_results
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.bench.design import Designs
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import RUN_COLUMNS
from dpbench.errors import ResultsError
from dpbench.files.regular_files import write_file_set_into_folder
from dpbench.report.charts.render import NOT_DRAWN, can_draw
from dpbench.report.commands_text import describe_machine_states
from dpbench.report.embedded_text import yield_uncounted_sentences
from dpbench.report.formats import (
    Table,
    escape_markdown,
    escape_markdown_paragraph,
    strip_markdown,
)
from dpbench.report.own_settings_text import describe_own_settings, describe_own_settings_in_si
from dpbench.report.page.data import PageData
from dpbench.report.page.live import (
    describe_failures_in_si,
    draw_section_charts,
    select_static_charts,
)
from dpbench.report.page.recommendation import NEXT, Recommendation, build_recommendation
from dpbench.report.page.section import Topic
from dpbench.report.settings_grids import tabulate_settings_grids
from dpbench.report.ship.capability_text import list_wash_cautions
from dpbench.report.ship.open_losses import find_open_losses
from dpbench.report.study_effects_table import build_effects_table, build_interactions_table
from dpbench.report.topics.all import build_topics
from dpbench.report.topics.embedded import tabulate_counts
from dpbench.report.topics.study import (
    yield_disturbance_sentences,
    yield_excluded_points_sentences,
)
from dpbench.report.verdict.machine_text import describe_calibration
from dpbench.report.verdict.verdict_text import describe_which_solvers_pass
from dpbench.report.words import read_words, render_document

TERMINAL_NOTES = (
    "counted",
    "margin",
    "faster",
    "inconclusive",
    "next",
    "commands",
    "unanswered",
    "stopped",
)
"""Notes of the recommendation on a terminal."""
BESIDE = (
    "study",
    "settings",
    "embedded",
    "slowdown",
    "anytime",
    "random",
    "capability",
    "consequence",
)
"""Topics with a line of their own on a terminal where they are not the answer."""


@dataclass(frozen=True, eq=False)
class Report:
    """Report on a result folder: results, recommended solver, topics, charts and tables."""

    results: Results
    data: PageData
    recommendation: Recommendation
    topics: Sequence[Topic]

    @classmethod
    def from_results(
        cls,
        results: Results,
        designs: Designs | None = None,
        baseline: str | None = None,
        capability: pd.DataFrame | None = None,
        counted: pd.DataFrame | None = None,
    ) -> "Report":
        """Return the report on the results of a folder; write no file.

        baseline : solver to compare with; designs, capability, counted : stored tables of the
        folder, see `load_stability_records`, `load_capability_plots` and
        `load_counted_steps_of_folder`.
        """
        records, requirements = Records(results), Requirements.from_suite(results.suite)
        data = PageData.from_verdicts(records, judge_solvers(records, requirements), counted)
        named = results.suite.get("report", {}).get("baseline")
        if named not in {v.configuration.solver for v in data.verdicts.all_verdicts if v.steps}:
            named = None  # a part of the suite was run, without it
        recommendation = build_recommendation(data, results.machine, baseline or named)
        plots = build_capability_results(records, capability)
        analyses = build_consequence_analyses(records)
        losses, ship = find_open_losses(records, data.ships, plots, analyses), recommendation.ship
        caution = " ".join(filter(None, [ship.caution, losses.summary]))
        wash = " ".join(list_wash_cautions(records))
        recommendation = replace(recommendation, ship=replace(ship, caution=caution, wash=wash))
        topics = build_topics(
            records, data.verdicts, designs, capability, data.studies, data.counts
        )
        if not can_draw():
            topics = [replace(topic, figures=()) for topic in topics]
        return cls(results, data, recommendation, topics)

    @cached_property
    def charts(self) -> Mapping[str, dict[str, Any]]:
        """Charts that follow the reader's selection, by section of the page and name."""
        return draw_section_charts(self.data) if can_draw() else {}

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """All tables of the report as data frames, by name."""
        return build_tables(self.results, self.data, self.recommendation, self.topics)

    @property
    def figures(self) -> dict[str, Any]:
        """Charts that are written to files of their own, by name."""
        own = select_static_charts(self.charts)
        return own | {f.name: f.chart for topic in self.topics for f in topic.figures}

    def summary_rows(self) -> list[tuple[str, str]]:
        """Return keyword and text of each line of the summary that a run prints last."""
        lead = next((topic for topic in self.topics if topic.leads), None)
        ship = self.recommendation.ship
        caution = " ".join(filter(None, [ship.caution, ship.wash]))
        rows = [("warning", ship.warning), ("ship", ship.text), ("caution", caution)]
        rows = [row for row in rows if row[1]]
        rows += [("answer", lead.lines[0])] if lead else []
        headline, verdicts = self.recommendation, self.data.verdicts
        if headline.sentence and not (lead and lead.id == "loops"):
            rows.append(("solver" if lead else "answer", headline.sentence))
        noted = [(about, text) for about, text in headline.notes if about in TERMINAL_NOTES]
        rows += [(about, text.removeprefix(NEXT)) for about, text in noted]
        beside = (topic for topic in self.topics if topic.id in BESIDE and not topic.leads)
        rows += [(topic.id, topic.lines[0]) for topic in beside]
        if excluded := " ".join(yield_excluded_points_sentences(self.data.studies)):
            rows.append(("points", excluded))
        if self.data.counts.sequences:
            missing = yield_uncounted_sentences(self.data.counts.not_counted)
            rows += [("not counted", line.removeprefix("Not counted: ")) for line in missing]
        if verdicts.of:
            rows.append(("solvers", describe_which_solvers_pass(verdicts)))
            if in_si := describe_failures_in_si(self.data, beyond_verdicts=True):
                rows.append(("units", in_si))
            own = [
                *describe_own_settings(self.data.records, verdicts),
                *describe_own_settings_in_si(self.data),
            ]
            rows += [("options", line) for line in own]
        records = self.data.records
        timed = select_timed_replays(records) or select_delayed_loops(records)
        if sum_disturbances(timed).seconds > 0:
            rows.append(("machine", f"{describe_machine_states(timed)}."))
        if medians := find_largest_median_by_test_solver(records.calibration):
            rows.append(("timing", f"{describe_calibration(medians)}."))
        if disturbed := " ".join(yield_disturbance_sentences(self.data.studies)):
            rows.append(("times", disturbed))
        rows += [] if can_draw() else [("figures", f"{NOT_DRAWN}.")]
        return [(about, strip_markdown(text)) for about, text in rows]


LEGEND = "README.md"
TABLES: dict[str, str] = read_words(__file__)["tables"]
DESCRIPTION = "description"
"""Key of a data frame's `attrs`: the description of a table that is not in `TABLES`."""
COLUMNS: dict[str, str] = read_words(__file__)["columns"]
NAMES: dict[str, str] = read_words(__file__)["names"]
COLUMNS_OF: dict[str, dict[str, str]] = read_words(__file__)["columns_of"]
_TEXT_COLUMNS = [name for name, (kind, _) in RUN_COLUMNS.items() if kind == "str"]
_ARMED = r"^'(?=[-=+@])"
"""The apostrophe that keeps a spreadsheet from reading a text as a formula."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""First characters of a formula in a spreadsheet."""
RUN_MEANINGS = {name: meaning for name, (_, meaning) in RUN_COLUMNS.items()}


def build_tables(
    results: Results, data: PageData, recommendation: Recommendation, topics: Sequence[Topic]
) -> dict[str, pd.DataFrame]:
    """Return all tables of the report as data frames by name; some may be empty."""
    verdicts, ladder = tabulate_verdicts(data), tabulate_best_times(data).drop(columns="id")
    why = [strip_markdown(recommendation.why(v)) for v in data.verdicts.all_verdicts]
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
        "settings_grids": tabulate_settings_grids(data.verdicts),
        "study_excess": tabulate_differences_from_reference(data.studies),
        "study_points": tabulate_study_points(data.studies),
        "study_effects": build_effects_table(data.studies),
        "study_interactions": build_interactions_table(data.studies),
        "anytime": tabulate_limited_loops(data.records),
    }
    # Those of a study, of limits and of settings are written as numbers above, and counts below.
    numbers = ("study", "settings", "embedded", "anytime")
    for topic in (topic for topic in topics if topic.id not in numbers):
        for i, small in enumerate(topic.tables):
            name = topic.id if i == 0 else f"{topic.id}_{i + 1}"
            tables[name] = convert_to_frame(small)
            tables[name].attrs[DESCRIPTION] = f"{small.title or topic.title}."
    if data.counts.sequences:
        tables["embedded"] = tabulate_counts(data.counts)
    return tables


def describe_table(name: str, table: pd.DataFrame) -> str:
    """Return the description of a table; of a table of a topic, its title; "" without one."""
    return TABLES.get(name) or str(table.attrs.get(DESCRIPTION, ""))


def describe_columns(name: str, table: pd.DataFrame) -> dict[str, str]:
    """Return the meaning of each column of a table; columns without one are left out.

    A table of a topic, such as `paper_2`, has the columns of its topic only.
    """
    own = COLUMNS_OF.get(name if name in TABLES else re.sub(r"_\d+$", "", name), {})
    of_runs = RUN_MEANINGS if name in ("runs", "ships", "anytime") else {}
    shared = COLUMNS if name in TABLES and name != "runs" else {}
    known = NAMES | of_runs | shared | own
    patterns = [pattern for pattern in known if "*" in pattern]
    found = {
        column: known.get(column)
        or next((known[pattern] for pattern in patterns if fnmatchcase(column, pattern)), "")
        for column in map(str, table)
    }
    return {column: meaning for column, meaning in found.items() if meaning}


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write the report's tables as CSV with a README; remove those of earlier reports.

    Raises InputError where the folder is a link.
    """
    written = {name: table for name, table in tables.items() if len(table)}
    contents = {f"{name}.csv": partial(encode_csv, table) for name, table in written.items()}
    wording = {
        escape_markdown(name): (
            TABLES.get(name) or escape_markdown_paragraph(describe_table(name, table)),
            describe_columns(name, table),
        )
        for name, table in written.items()
    }
    legend = render_document("tables.md", tables=wording)
    write_file_set_into_folder(folder, {**contents, LEGEND: legend.encode})


def copy_tables(stored: Path, folder: Path) -> None:
    """Copy the tables that an earlier report wrote, unchanged, into another folder.

    Read and written again, whole numbers beside missing ones would have decimals.
    """
    files = [path for path in sorted(stored.glob("*.csv")) if path.is_file()]
    legend = stored / LEGEND
    files += [legend] if legend.is_file() else []
    contents = {path.name: path.read_bytes() for path in files}
    write_file_set_into_folder(
        folder, {name: partial(bytes, content) for name, content in contents.items()}
    )


def read_tables(folder: Path) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the tables that `write_tables` wrote into a folder, each with its name."""
    legend = folder / LEGEND
    text = legend.read_text(encoding="utf-8", errors="replace") if legend.is_file() else ""
    described = dict(re.findall(r"^## (.+)\.csv\n\n(.+)$", text, flags=re.MULTILINE))
    for path in sorted(folder.glob("*.csv")):
        table = read_table(path)
        table.attrs[DESCRIPTION] = described.get(path.stem, "")
        yield path.stem, table


def read_table(path: Path) -> pd.DataFrame:
    """Return a table that `write_tables` wrote; an empty text is "", as in the report.

    ResultsError, naming the file, where it is damaged.
    """
    try:
        table = pd.read_csv(path, dtype=dict.fromkeys(_TEXT_COLUMNS, "str"))
    except (OSError, ValueError) as error:
        found = f"a damaged file ({str(error)[:80]})"
        raise ResultsError(str(path), "", found, "a table that `dpbench report` writes") from error
    for name, dtype in table.dtypes.items():
        if not (is_numeric_dtype(dtype) or is_bool_dtype(dtype)):
            table[name] = table[name].fillna("").str.replace(_ARMED, "", regex=True)
    return table


def convert_to_frame(table: Table) -> pd.DataFrame:
    """Return all rows of a table as a DataFrame of text."""
    return pd.DataFrame(table.rows, columns=list(table.heads))


def encode_csv(table: pd.DataFrame) -> bytes:
    """Return a table as CSV; an apostrophe precedes texts that a spreadsheet takes for formulas."""
    named = table.rename(columns={name: _disarm_formula(name) for name in table.columns})
    texts = [i for i, dtype in enumerate(named.dtypes) if not is_numeric_dtype(dtype)]
    for i in texts:
        plain = named.iloc[:, i].map(_disarm_formula, na_action="ignore")
        named.isetitem(i, plain.to_numpy(dtype=object))
    return bytes(named.to_csv(index=False).encode())


def _disarm_formula(value: Any) -> Any:
    """Return a cell, with an apostrophe before a text that a spreadsheet takes for a formula."""
    if not isinstance(value, str) or not value.startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value
