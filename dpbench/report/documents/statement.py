"""Statement: one page that a control engineer can give to a class society.

It is drawn as SVG and turned into PDF, and claims nothing that is not on the page.
"""

import textwrap
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import vl_convert as vlc

from dpbench.analysis.verdict.fastest import choose_solver
from dpbench.analysis.verdict.verdict import Verdict
from dpbench.bench.record.machine import describe_version
from dpbench.bench.record.result_folder import Results, hash_files
from dpbench.errors import InputError
from dpbench.files.writing import write_named_file
from dpbench.report.charts.style import INK, LINE, SOFT
from dpbench.report.page.data import PageData
from dpbench.report.page.recommendation import speed_margin_text
from dpbench.report.page.terms import DRAG_MISMATCH
from dpbench.report.verdict_text import deployment_facts, judged_runs_text, requirements_text
from dpbench.report.words import render_document
from dpbench.solvers.settings import all_options

WIDTH, HEIGHT, MARGIN = 595, 842, 48
"""A4 in points."""
HASHED = ("runs.parquet", "steps.parquet", "machine.json", "suite.json")


@dataclass(frozen=True)
class TextLine:
    """Line of text on the one-page statement: size, weight, gap above it, colour."""

    text: str
    size: float = 9.5
    bold: bool = False
    gap: float = 3.0
    colour: str = INK


def statement_svg(folder: Path, results: Results, data: PageData) -> str:
    """Return the one-page statement on the recommended solver as SVG, A4.

    Raises InputError when nothing can be recommended, so that there is nothing to state.
    """
    chosen = choose_solver(data.verdicts).chosen
    if chosen is None or chosen.state != "pass":
        found = "no configuration that passes everywhere and can go aboard"
        raise InputError(str(folder), "--statement", found, "results with a recommendation")
    return _render_svg(_format_lines(folder, results, data, chosen))


def write_statement(path: Path, folder: Path, results: Results, data: PageData) -> Path:
    """Write the one-page statement on the recommended solver, as .pdf or .svg."""
    drawn = statement_svg(folder, results, data)
    if path.suffix == ".svg":
        write_named_file(path, drawn.encode())
    elif path.suffix == ".pdf":
        write_named_file(path, vlc.svg_to_pdf(drawn))
    else:
        raise InputError("--statement", "", str(path), "a file that ends in .pdf or .svg")
    return path


_LOOKS: dict[str, dict[str, Any]] = {
    "#": {"size": 14, "bold": True},
    ">": {"size": 10, "colour": SOFT},
    "##": {"size": 11, "bold": True, "gap": 12.0},
    "`": {"size": 7.5},
    "~": {"size": 8.5},
}
"""Look of a line by the mark it begins with; a line without one is wrapped."""


def _format_lines(
    folder: Path, results: Results, data: PageData, chosen: Verdict
) -> Iterator[TextLine]:
    """Yield the text lines of the statement on the recommended solver, styled and wrapped."""
    for line in _fill_statement(folder, results, data, chosen).splitlines():
        mark, _, text = line.partition(" ")
        if mark in _LOOKS:
            yield TextLine(text, **_LOOKS[mark])
        else:
            yield from map(TextLine, textwrap.wrap(" ".join(line.split()), 104))


def _fill_statement(folder: Path, results: Results, data: PageData, chosen: Verdict) -> str:
    """Return the text of the one-page statement: solver, settings, ship, machine, file hashes."""
    c, scenarios = chosen.configuration, map(data.records.scenario, data.records.scenarios)
    options = all_options(c.solver_settings, c.solver)
    versions = results.runs.loc[results.runs["solver"] == c.solver, "solver_version"]
    vessels = {s.vessel.id: s.vessel for s in scenarios if s is not None}
    return render_document(
        "statement",
        made_by=describe_version(results.suite),
        c=c,
        v=chosen,
        judged_runs_text=judged_runs_text(chosen),
        version=", ".join(sorted({str(v) for v in versions if v})),
        numbers=", ".join(f"{key} = {value!r}" for key, value in options.items())
        or "the library's own",
        aboard=deployment_facts(c.solver),
        requirements=requirements_text(data.requirements),
        slower=speed_margin_text(data, chosen),
        ships=[f"{vessel.title} ({vessel.id})" for vessel in vessels.values()],
        mismatch=DRAG_MISMATCH if any(vessel.drag for vessel in vessels.values()) else "",
        experiments=[
            data.experiments[p].label
            for p in data.judged_experiments
            if data.state(data.index(c), p) == "pass"
        ],
        machine=defaultdict(str, results.machine),
        hashes=hash_files(folder, HASHED),
        suite=defaultdict(str, results.suite),
    )


def _render_svg(lines: Iterable[TextLine]) -> str:
    """Render lines of text as one SVG page."""
    parts, y = [], float(MARGIN)
    for line in lines:
        y += line.size * 1.22 + line.gap
        weight = "600" if line.bold else "400"
        parts.append(
            f'<text x="{MARGIN}" y="{y:.1f}" font-size="{line.size:g}" font-weight="{weight}" '
            f'fill="{line.colour}">{escape(line.text)}</text>'
        )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}" font-family="DejaVu Sans, Helvetica, Arial, sans-serif">'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>'
        f'<rect x="{MARGIN}" y="{MARGIN - 8}" width="{WIDTH - 2 * MARGIN}" height="1" '
        f'fill="{LINE}"/>' + "".join(parts) + "</svg>"
    )
