"""The statement: one page that a control engineer can give to a class society.

What is recommended, in numbers; where that is valid; what was run it on, with hashes; what is not
covered. It is drawn as SVG and turned into PDF, and claims nothing that is not on the page.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import vl_convert as vlc

from dpbench.analysis.verdict.fastest import recommend
from dpbench.analysis.verdict.verdict import Verdict
from dpbench.bench.record.result_folder import Results, hashes
from dpbench.bench.record.revision import made_by
from dpbench.errors import InputError
from dpbench.report.charts.style import INK, LINE, SOFT
from dpbench.report.formats import error_text, plural, time_text
from dpbench.report.page.answer import slower_text
from dpbench.report.page.facts import Facts
from dpbench.report.verdict_text import aboard, demand_text
from dpbench.solvers.settings import level_options

WIDTH, HEIGHT, MARGIN = 595, 842, 48
"""A4 in points."""
HASHED = ("runs.parquet", "steps.parquet", "machine.json", "suite.json")
NOT_COVERED = (
    "Other vessels, thrusters, tunings, horizons, limits and weather than those named here.",
    "Other computers, compilers, library builds and versions; times of an embedded target.",
    "The rest of the control system: sensors, observers, allocation, power, communication.",
    "Worst cases beyond the steps that were run: nothing here bounds the time of a step never met.",
)


@dataclass(frozen=True)
class Line:
    """A line of text at a size; bold for headings, `gap` above it."""

    text: str
    size: float = 9.5
    bold: bool = False
    gap: float = 3.0
    colour: str = INK


def statement_svg(folder: Path, results: Results, facts: Facts) -> str:
    """The statement on a result folder as SVG, A4.

    Raises
    ------
    InputError : when nothing can be recommended, so that there is nothing to state.
    """
    chosen = recommend(facts.verdicts).chosen
    if chosen is None or chosen.outcome != "meets":
        found = "no configuration that meets the demand everywhere and can go aboard"
        raise InputError(str(folder), "--statement", found, "results with a recommendation")
    return _page(_lines(folder, results, facts, chosen))


def write_statement(path: Path, folder: Path, results: Results, facts: Facts) -> Path:
    """Write the statement as the name of the file ends: .pdf or .svg."""
    drawn = statement_svg(folder, results, facts)
    if path.suffix == ".svg":
        path.write_text(drawn, encoding="utf-8")
    elif path.suffix == ".pdf":
        path.write_bytes(vlc.svg_to_pdf(drawn))
    else:
        raise InputError("--statement", "", str(path), "a file that ends in .pdf or .svg")
    return path


def _lines(folder: Path, results: Results, facts: Facts, chosen: Verdict) -> list[Line]:
    c = chosen.configuration
    options = level_options(c.settings, c.solver)
    own = ", ".join(f"{key} = {value!r}" for key, value in options.items()) or "the library's own"
    version = _version(results, c.solver)
    return [
        Line("QP solver for the model predictive controller of a DP vessel", 14, bold=True),
        Line(f"Statement on measured results, {made_by(results.suite)}", 10, colour=SOFT),
        *_section("Recommended"),
        Line(
            f"Solver {c.solver} {version}, route {c.route}, policy {c.policy}, settings "
            f"{c.settings}."
        ),
        *_wrapped(f"Settings in numbers: {own}."),
        *_wrapped(aboard(c.solver)),
        *_section("Demand, and what was measured"),
        *_wrapped(demand_text(facts.demand)),
        *_wrapped(
            f"Measured on every judged step of {plural(chosen.loops, 'closed loop')} and "
            f"{plural(chosen.replays, 'replay')} ({chosen.steps} steps): largest error of the "
            f"first move {error_text(chosen.error_move)} of a rate-limit step, "
            f"{plural(chosen.failed_steps, 'failed step')}; step time p50 "
            f"{time_text(chosen.p50_ns)}, p99 {time_text(chosen.p99_ns)}, largest step "
            f"{time_text(chosen.algo_max_ns)}, largest single timing "
            f"{time_text(chosen.raw_max_ns)}."
        ),
        *_wrapped(slower_text(facts, chosen)),
        *_section("Valid for"),
        *_wrapped(_ships(facts)),
        *_wrapped(f"Runs: {_places(facts, chosen)}."),
        *_wrapped(_machine(results)),
        *_section("Not covered"),
        *(line for text in NOT_COVERED for line in _wrapped(f"– {text}")),
        *_section("Where the numbers are"),
        *(Line(f"{name}  SHA-256 {sha}", 7.5) for name, sha in hashes(folder, HASHED).items()),
        Line(
            f"Suite {results.suite.get('name', '')}, started "
            f"{results.suite.get('started_utc', '')[:19]} UTC.",
            8.5,
        ),
    ]


def _section(title: str) -> list[Line]:
    return [Line(title, 11, bold=True, gap=12.0)]


def _wrapped(text: str) -> list[Line]:
    return [Line(part) for part in textwrap.wrap(" ".join(text.split()), 104)]


def _version(results: Results, solver: str) -> str:
    versions = results.runs.loc[results.runs["solver"] == solver, "solver_version"]
    return ", ".join(sorted({str(v) for v in versions if v}))


def _ships(facts: Facts) -> str:
    ships = {}
    for name in facts.records.scenarios:
        scenario = facts.records.scenario(name)
        if scenario is not None:
            ships[scenario.vessel.id] = f"{scenario.vessel.title} ({scenario.vessel.id})"
    return f"Ship: {'; '.join(ships.values())}."


def _places(facts: Facts, chosen: Verdict) -> str:
    c = facts.index(chosen.configuration)
    held = [facts.places[p].label for p in facts.judged_places if facts.state(c, p) == "meets"]
    return ", ".join(held)


def _machine(results: Results) -> str:
    machine = results.machine
    versions = machine.get("versions", {})
    return (
        f"Machine: {machine.get('cpu_model', '')}, {machine.get('cores', '')} cores, "
        f"{machine.get('memory_GiB', '')} GiB, {machine.get('kernel', '')}, "
        f"{machine.get('python', '')}, "
        f"numpy {versions.get('numpy', '')}; description {machine.get('id', '')}."
    )


def _page(lines: Sequence[Line]) -> str:
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
