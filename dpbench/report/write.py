"""Write the report of a result folder: `report.html`, `report.md`, `figures/` and `tables/`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.verdict.demand import Demand
from dpbench.analysis.verdict.verdict import verdicts_of
from dpbench.bench.capability.table import load_capability
from dpbench.bench.design import Designs, load_designs
from dpbench.bench.record.result_folder import Results, load_results
from dpbench.errors import InputError
from dpbench.report.charts.render import FORMATS, save
from dpbench.report.csv_tables import tables_of, write_tables
from dpbench.report.documents.comment import beside, worst_text
from dpbench.report.documents.markdown import report_markdown
from dpbench.report.documents.sent import PAGE, prepare
from dpbench.report.documents.statement import write_statement
from dpbench.report.ending import ending
from dpbench.report.page.answer import Answer, answer_of
from dpbench.report.page.facts import Facts
from dpbench.report.page.topic import Topic
from dpbench.report.page.write import DRAWN, charts_of, page_html
from dpbench.report.topics.all import topics_of
from dpbench.report.topics.trust import calling_ns


@dataclass(frozen=True, eq=False)
class Report:
    """What a report is made of."""

    results: Results
    facts: Facts
    answer: Answer
    topics: Sequence[Topic]

    @classmethod
    def of(
        cls,
        results: Results,
        designs: Designs | None = None,
        baseline: str | None = None,
        capability: pd.DataFrame | None = None,
    ) -> Report:
        """The report on some results, nothing written.

        Parameters
        ----------
        designs, capability : what lies beside them, see `topics_of`; baseline : as in
            `write_report`.
        """
        records, demand = Records(results), Demand.of(results.suite)
        facts = Facts.of(records, demand, verdicts_of(records, demand))
        named = results.suite.get("report", {}).get("baseline")
        if named not in {v.configuration.solver for v in facts.verdicts.all if v.steps}:
            named = None  # a part of the suite was run, without it
        answer = answer_of(facts, results.machine, baseline or named)
        topics = topics_of(records, facts.verdicts, designs, capability)
        return cls(results, facts, answer, topics)

    @cached_property
    def charts(self) -> Mapping[str, Any]:
        """The figures of the page that follow what is chosen there, by name."""
        return charts_of(self.facts, calling_ns(self.facts.records))

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """All tables, by name: see `csv_tables.tables_of`."""
        return tables_of(self.results, self.facts, self.answer, self.topics)

    @property
    def figures(self) -> dict[str, Any]:
        """The figures that stand alone, by name."""
        own = {name: chart for name, chart in self.charts.items() if name in DRAWN}
        return own | {f.name: f.chart for topic in self.topics for f in topic.figures}


def write_report(out: str | Path, *, baseline: str | None = None) -> Path:
    """Write the report of the result folder `out` into it.

    Parameters
    ----------
    baseline : the solver that the page sets beside the answer; by default the one the suite names,
        or the next best.

    Returns
    -------
    Path of `report.html`.

    Raises
    ------
    ResultsError : when the folder holds no readable results.
    InputError : for a baseline that was not run; nothing is written then.
    """
    return report_and_ending(out, baseline=baseline)[0]


def report_and_ending(
    out: str | Path,
    *,
    baseline: str | None = None,
    figures: Sequence[str] = (),
    statement: str | None = None,
    send: str | None = None,
    solver: str | None = None,
    against: Sequence[str] = (),
) -> tuple[Path, list[tuple[str, str]]]:
    """As `write_report`; with it what a run ends with: see `ending`.

    Parameters
    ----------
    figures : further formats of the figures, of `FORMATS`; SVG is always written.
    statement : the file to write the one-page statement to, .pdf or .svg.
    send : a folder to make that can be sent to others, see `documents/sent.py`.
    solver, against : a solver to set beside others, in `SOLVER.md`, see `documents/comment.py`.

    Raises
    ------
    InputError : for an unknown format, a statement where nothing can be recommended, a folder to
        send that holds other things, or a solver that was not run.
    """
    for kind in figures:
        if kind not in FORMATS:
            raise InputError("--figures", "", repr(kind), " | ".join(FORMATS))
    folder = Path(out)
    beside_it = load_designs(folder), baseline, load_capability(folder)
    report = Report.of(load_results(folder), *beside_it)
    comment, worst = ("", []) if solver is None else beside(report, solver, against)
    if statement is not None:
        write_statement(Path(statement), folder, report.results, report.facts)
    _write_figures(folder / "figures", report, ("svg", *figures))
    write_tables(folder / "tables", report.tables)
    text = report_markdown(report.results, report.facts, report.answer, report.topics)
    (folder / "report.md").write_text(text, encoding="utf-8")
    page = folder / "report.html"
    page.write_text(_page(folder, report), encoding="utf-8")
    if send is not None:
        prepare(folder, Path(send))
        light = _page(Path(send), report, light=True)
        (Path(send) / PAGE).write_text(light, encoding="utf-8")
    ended = ending(report.facts, report.answer, report.topics)
    if solver is not None:
        (folder / f"{solver}.md").write_text(comment, encoding="utf-8")
        ended += [*worst_text(worst), ("comment", str(folder / f"{solver}.md"))]
    return page, ended


def _page(folder: Path, report: Report, *, light: bool = False) -> str:
    """The page, with links to the files in `folder`."""
    r = report
    return page_html(folder, r.results, r.facts, r.answer, r.charts, r.topics, light=light)


def _write_figures(folder: Path, report: Report, formats: Sequence[str]) -> None:
    """Every figure that stands alone, in each format; those of an earlier report go."""
    folder.mkdir(exist_ok=True)
    for kind in FORMATS:
        for stale in folder.glob(f"*.{kind}"):
            stale.unlink()
    for name, chart in report.figures.items():
        for kind in dict.fromkeys(formats):
            save(chart, folder / f"{name}.{kind}")
