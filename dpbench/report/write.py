"""Write the report of a result folder: `report.html`, `report.md`, `figures/` and `tables/`."""

from collections.abc import Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from dpbench.bench.capability.edge_qps import load_capability_plots
from dpbench.bench.design import load_stability_records
from dpbench.bench.progress import Progress, Silent
from dpbench.bench.record.result_folder import load_results, lock_for_writing
from dpbench.embedded.table import load_counted_steps_of_folder
from dpbench.errors import InputError, require_type
from dpbench.files.regular_files import (
    make_folder_if_missing,
    write_file_set_into_folder,
    write_text_atomically,
)
from dpbench.report.charts.render import FORMATS, can_draw, encode_figure
from dpbench.report.documents.markdown import make_report_markdown
from dpbench.report.documents.sent import PAGE, prepare_sent_folder
from dpbench.report.documents.solver_comparison import compare_solver, format_worst_steps
from dpbench.report.documents.statement import write_statement
from dpbench.report.page.write import make_page_html
from dpbench.report.report import Report, write_tables


def write_report(out: str | Path, *, baseline: str | None = None) -> Path:
    """Write a result folder's report into it (page, Markdown, figures, tables); return the path.

    Parameters
    ----------
    baseline : solver to compare with; by default the one the suite names, otherwise a faster one
        that is not deployable or, if there is none, the next fastest deployable one.

    Returns
    -------
    Path of `report.html`.

    Raises
    ------
    ResultsError : when the folder holds no readable results.
    InputError : for a baseline that was not run, or a link in place of a folder; nothing is
        written.

    Examples
    --------
    >>> write_report("results/smoke").name
    'report.html'
    """
    return write_report_with_summary(out, baseline=baseline)[0]


def write_report_with_summary(
    out: str | Path,
    *,
    baseline: str | None = None,
    figures: Sequence[str] = (),
    statement: str | None = None,
    send: str | None = None,
    solver: str | None = None,
    against: Sequence[str] = (),
    progress: Progress | None = None,
) -> tuple[Path, list[tuple[str, str]]]:
    """Write the report of a result folder; return the page's path and a summary.

    Parameters
    ----------
    figures : further formats of the figures, of `FORMATS`; SVG is always written.
    statement : file to write the statement to, .pdf or .svg.
    send : folder to make that can be sent to others, see `documents/sent.py`.
    solver, against : solvers to compare in `SOLVER.md`, see `compare_solver`.
    progress : receiver of the name of each stage.

    Raises
    ------
    InputError : for an unknown format, a statement where nothing can be recommended, a folder to
        send that holds other things, or a solver that was not run.
    """
    require_type("out", out, str | PathLike, "the path of a result folder")
    for kind in figures:
        if kind not in FORMATS:
            raise InputError("`figures`", "", repr(kind), ", ".join(FORMATS))
    folder, progress = Path(out), progress or Silent()
    with lock_for_writing(folder):
        progress.advance(0, "report: judging the runs")
        beside_it = (
            load_stability_records(folder),
            baseline,
            load_capability_plots(folder),
            load_counted_steps_of_folder(folder),
        )
        report = Report.from_results(load_results(folder), *beside_it)
        comment, worst = ("", []) if solver is None else compare_solver(report, solver, against)
        drawn, tables = (
            make_folder_if_missing(folder / "figures"),
            make_folder_if_missing(folder / "tables"),
        )
        if statement is not None:
            write_statement(Path(statement), folder, report.results, report.data)
        _write_figures(drawn, report, ("svg", *figures), progress)
        progress.advance(0, "report: tables")
        write_tables(tables, report.tables)
        write_text_atomically(folder / "report.md", make_report_markdown(report))
        progress.advance(0, "report: page")
        page = folder / "report.html"
        write_text_atomically(page, _render_report_page(folder, report))
        if send is not None:
            prepare_sent_folder(folder, Path(send))
            write_text_atomically(
                Path(send) / PAGE, _render_report_page(Path(send), report, light=True)
            )
        ended = report.summary_rows()
        if solver is not None:
            write_text_atomically(folder / f"{solver}.md", comment)
            ended += [*format_worst_steps(worst), ("comment", str(folder / f"{solver}.md"))]
    return page, ended


def _render_report_page(folder: Path, report: Report, *, light: bool = False) -> str:
    """Return the report page of a folder as HTML; `light` leaves out the scripts."""
    r, light = report, light or not can_draw()
    return make_page_html(
        folder, r.results, r.data, r.recommendation, r.charts, r.topics, light=light
    )


def _write_figures(
    folder: Path, report: Report, formats: Sequence[str], progress: Progress
) -> None:
    """Write each chart of the report to a file per format; remove an earlier report's."""
    progress.advance(0, "report: charts")

    def encode(name: str, chart: Any, kind: str) -> bytes:
        progress.advance(0, f"report: figure {name}.{kind}")
        return encode_figure(chart, kind)

    files = {
        f"{name}.{kind}": partial(encode, name, chart, kind)
        for name, chart in report.figures.items()
        for kind in dict.fromkeys(formats)
    }
    write_file_set_into_folder(folder, files)
