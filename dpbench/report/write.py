"""Write the report of a result folder: `report.md`, `report.html` and `figures/`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import as_float
from dpbench.bench.design import Designs, load_designs
from dpbench.bench.record.result_folder import Results, load_results
from dpbench.report.blocks import Page, Section
from dpbench.report.formats import time_text
from dpbench.report.render import render_html, render_markdown
from dpbench.report.section_deadline import deadline_lines, deadline_section
from dpbench.report.section_harness import harness_lines, repeat_section
from dpbench.report.section_horizon import horizon_section
from dpbench.report.section_random import random_lines, random_section
from dpbench.report.section_ranks import check_baseline, ranks_section
from dpbench.report.section_reading import reading_section
from dpbench.report.section_solvers import solvers_section
from dpbench.report.section_use import use_section
from dpbench.report.section_verdict import verdict_lines as _lines
from dpbench.report.section_verdict import verdict_section
from dpbench.report.sections_control import (
    control_section,
    figures_section,
    reproduced_section,
)
from dpbench.report.sections_records import accuracy_section, runs_section, units_section
from dpbench.report.sections_time import timing_section
from dpbench.report.style import save, styled


def write_report(out: str | Path, *, baseline: str | None = None) -> Path:
    """Write the report of the result folder `out` into it.

    Parameters
    ----------
    baseline : the solver whose step times the others are compared with; by default the one the
        suite names, or the fastest whose answers meet the demand.

    Returns
    -------
    Path of `report.html`.

    Raises
    ------
    ResultsError : when the folder holds no readable results.
    InputError : for a baseline that was not replayed; nothing is written then.
    """
    return report_and_verdict(out, baseline=baseline)[0]


def report_and_verdict(out: str | Path, *, baseline: str | None = None) -> tuple[Path, list[str]]:
    """As `write_report`; with it the verdict on the folder in a few plain lines."""
    folder = Path(out)
    results = load_results(folder)
    if baseline is not None:
        check_baseline(Records(results), Demand.of(results.suite), baseline)
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    with styled():
        page = build_page(results, load_designs(folder), baseline=baseline)
        for stale in figures.glob("*.svg"):
            stale.unlink()
        for picture in page.pictures:
            save(picture.figure, folder / picture.file)
    drawn = {p.name: (folder / p.file).read_bytes() for p in page.pictures}
    (folder / "report.md").write_text(render_markdown(page), encoding="utf-8")
    html = folder / "report.html"
    html.write_text(render_html(page, drawn), encoding="utf-8")
    return html, verdict_lines(results)


def verdict_lines(results: Results) -> list[str]:
    """The verdict on results in a few plain lines."""
    view = Records(results)
    other = view.random or view.delayed or view.calibration
    judged = _lines(view, Demand.of(results.suite)) if view.runs or not other else []
    return [*judged, *deadline_lines(view), *random_lines(view), *harness_lines(view)]


def build_page(
    results: Results, designs: Designs | None = None, *, baseline: str | None = None
) -> Page:
    """The whole page, figures drawn but not written."""
    view, demand = Records(results), Demand.of(results.suite)
    suite = results.suite
    return Page(
        title=f"dpbench: {suite.get('name', 'results')}",
        subtitle=str(suite.get("title", "")),
        facts=_facts(results),
        sections=_sections(view, demand, designs, baseline or _baseline(suite)),
    )


def _baseline(suite: dict[str, Any]) -> str | None:
    """The baseline that the suite names."""
    named = suite.get("report", {}).get("baseline")
    return None if named is None else str(named)


def _sections(
    view: Records, demand: Demand, designs: Designs | None, baseline: str | None
) -> list[Section]:
    """All sections; of records without a ship, those that have something to say."""
    if view.calibration and not view.all_runs:
        return [timing_section(view, demand), reading_section()]
    claims, deadline = random_section(view), deadline_section(view)
    horizon = horizon_section(view, demand)
    repeat = repeat_section(view)
    slow = [deadline] if deadline is not None else []
    found = [claims] if claims is not None else []
    if (found or slow) and not view.runs:
        return [
            *slow,
            *found,
            runs_section(view),
            solvers_section(view),
            reading_section(),
        ]
    return [
        verdict_section(view, demand),
        runs_section(view),
        accuracy_section(view, demand),
        units_section(view),
        *found,
        timing_section(view, demand),
        ranks_section(view, demand, baseline),
        *([repeat] if repeat is not None else []),
        use_section(view, demand),
        *([horizon] if horizon is not None else []),
        figures_section(view, demand),
        control_section(view, demand),
        *slow,
        reproduced_section(view, designs),
        solvers_section(view),
        reading_section(),
    ]


def _facts(results: Results) -> list[tuple[str, str]]:
    suite, machine = results.suite, results.machine
    wall = as_float(suite.get("wall_s"))
    facts = [
        ("started", str(suite.get("started_utc", ""))),
        ("took", time_text(wall * 1e9) if wall == wall else ""),
        ("harness", str(suite.get("harness_version", ""))),
        ("machine", str(machine.get("id", ""))),
        ("processor", str(machine.get("cpu_model", ""))),
        ("cells", str(len(results.runs))),
    ]
    return [(name, value) for name, value in facts if value]
