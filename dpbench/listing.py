"""What `dpbench list` and `dpbench check` say, and tables of the report on a terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from dpbench.bench.plan import plan
from dpbench.bench.running import Progress
from dpbench.bench.sequence_file import active_set, load_recorded
from dpbench.bench.suite import load_suite, naming
from dpbench.bench.verify import verify_sequence
from dpbench.errors import InputError
from dpbench.problem_files import (
    KINDS,
    SEQUENCES,
    is_stored,
    problem_names,
    problem_path,
    read_toml,
    sequence_path,
)
from dpbench.report.table import Table as ReportTable
from dpbench.scenario import load_scenario, load_vessel
from dpbench.solvers.settings import describe_ladder
from dpbench.solvers.table import available, record, solver_names


def listing(what: str) -> Table:
    """A table of the vessels, scenarios, suites, sequences or solvers there are."""
    tables = {"vessels": _vessels, "scenarios": _scenarios, "suites": _suites}
    return (tables | {"sequences": _sequences, "solvers": _solvers})[what]()


def _table(*columns: str) -> Table:
    table = Table(show_edge=False, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, no_wrap=i == 0)
    return table


def rich_table(table: ReportTable) -> Table:
    """A table of the report for a terminal, its note below it."""
    shown = Table(
        title=table.title,
        title_justify="left",
        caption=table.note,
        caption_justify="left",
        show_edge=False,
        pad_edge=False,
    )
    for i, head in enumerate(table.heads):
        shown.add_column(escape(head), justify="left" if i < table.text_columns else "right")
    styles = {"good": "green", "bad": "bold red", "warn": "yellow"}
    for row in table.rows:
        shown.add_row(*(Text(cell.text, style=styles.get(cell.mark, "")) for cell in row))
    return shown


def _vessels() -> Table:
    table = _table("name", "ship", "time constants [s]", "max acceleration [mm/s², mm/s², mrad/s²]")
    for name in problem_names("vessels"):
        vessel = load_vessel(name)
        times = ", ".join(f"{t:.3g}" for t in vessel.time_constants_s())
        reach = 1e3 * vessel.reachable_acceleration()[1]
        table.add_row(name, vessel.title, times, ", ".join(f"{a:.3g}" for a in reach))
    return table


def _scenarios() -> Table:
    table = _table("name", "vessel", "tuning", "steps", "what it shows")
    for name in problem_names("scenarios"):
        scenario = load_scenario(name)
        tuning = f"{scenario.tuning} {scenario.N_p}/{scenario.N_c}"
        table.add_row(name, scenario.vessel.id, tuning, str(scenario.steps), scenario.shows)
    return table


def _suites() -> Table:
    table = _table("name", "cells", "title")
    for name in problem_names("suites"):
        path, suite = load_suite(name)
        table.add_row(name, str(len(plan(suite, beside=path.parent))), suite.title)
    return table


def _sequences() -> Table:
    table = _table("name", "n", "m", "K", "active", "matrices", "source")
    for name in problem_names(SEQUENCES):
        recorded = load_recorded(sequence_path(name))
        sequence, meta = recorded.sequence, recorded.sequence.meta
        sets = [active_set(o) for o in recorded.optima or [] if np.isfinite(o.bound)]
        base, every = sequence.base, int(meta.get("every", 1))
        stride = "each sample" if every == 1 else f"each {every}th sample"
        table.add_row(
            name,
            *(str(count) for count in (base.n, base.m, len(sequence))),
            f"{np.count_nonzero(sets) / np.size(sets):.1%}" if sets else "–",
            "constant" if sequence.P is None else "each step's",
            f"{recorded.documents['scenario']['title']}; exactly solved loop, {stride}",
        )
    return table


def _solvers() -> Table:
    table = _table(
        "name", "version", "build", "method", "form", "policies", "installed", "settings"
    )
    for name in solver_names():
        row, found = record(name), available(name)
        policies = "; ".join(f"{route}: {', '.join(p)}" for route, p in row.policies.items())
        table.add_row(
            name,
            found.version or "–",
            found.build.text or "–",
            row.method,
            row.form,
            policies,
            "yes" if found.ok else escape(found.reason),
            escape(describe_ladder(name)),
        )
    return table


def check_file(path: str, progress: Progress | None = None) -> str:
    """Check a TOML file as what it is, by its tables, or a sequence; one line of what it describes.

    Every optimum of a sequence is certified anew, which may take a while.

    Raises
    ------
    InputError : naming file, key, what was found and what is allowed.
    """
    if path.endswith(".npz") or is_stored(path):
        return verify_sequence(sequence_path(path), progress)
    file = Path(path)
    for kind in KINDS:
        if path in problem_names(kind):
            file = problem_path(kind, path)
    if not file.is_file():
        found = "a folder" if file.is_dir() else "no such file"
        allowed = "a vessel, scenario or suite file in TOML, or a sequence (.npz)"
        raise InputError(path, "", found, allowed)
    document = read_toml(file)
    if "limits" in document:
        vessel = load_vessel(file)
        return f"{file}: a vessel, {vessel.title}"
    if "controller" in document or "environment" in document:
        scenario = load_scenario(file)
        return f"{file}: a scenario of {scenario.steps} steps with vessel {scenario.vessel.id}"
    if any(table in document for table in ("closed_loop", "replay", "recorded", "random")):
        suite_path, suite = load_suite(file)
        with naming(suite_path):
            return f"{file}: a suite of {len(plan(suite, beside=suite_path.parent))} cells"
    raise InputError(
        str(file),
        "",
        f"tables {', '.join(document) or '(none)'}",
        "[limits] (a vessel), [controller] and [environment] (a scenario), "
        "or [[closed_loop]], [[replay]], [[recorded]] and [[random]] (a suite)",
    )
