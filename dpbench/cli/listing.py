"""What `dpbench list` and `dpbench check` say."""

from __future__ import annotations

import difflib
import os
from pathlib import Path

import numpy as np
from rich.console import Group, RenderableType

from dpbench.bench.plan.plan import plan
from dpbench.bench.plan.suite import SuiteFile, load_suite, naming
from dpbench.bench.progress import Progress
from dpbench.bench.sequences.sequence_file import active_set, load_recorded
from dpbench.bench.sequences.verify import verify_sequence
from dpbench.cli.check import scenario_text, vessel_text
from dpbench.cli.terminal import entry, plain, small_table
from dpbench.errors import InputError
from dpbench.report.documents.sent import SENDER, check_sent
from dpbench.scenario.problem_files import (
    KINDS,
    SEQUENCES,
    is_stored,
    problem_names,
    problem_path,
    read_toml,
    sequence_path,
)
from dpbench.scenario.scenario import load_scenario, load_vessel
from dpbench.solvers.settings import describe_levels
from dpbench.solvers.table import available, record, solver_names

CHECKED = (
    "a vessel, scenario, scenario@vessel, suite or sequence by name, a TOML file, "
    "a .npz or a folder of problems by qpsolvers, a folder of results/community"
)
"""What `dpbench check` takes."""
SEQUENCES_ARE = """
Each is the exactly solved loop of the scenario it is named after, at the
horizons N_p-N_c of its name, every optimum certified. n: variables; m: rows;
K: QPs; active: share of all limits; samples: which of the loop were kept."""


def listing(what: str) -> RenderableType:
    """The vessels, scenarios, suites, sequences or solvers there are, in 80 columns."""
    makers = {"vessels": _vessels, "scenarios": _scenarios, "suites": _suites}
    return (makers | {"sequences": _sequences, "solvers": _solvers})[what]()


def _vessels() -> RenderableType:
    entries = []
    for name in problem_names("vessels"):
        vessel = load_vessel(name)
        times = ", ".join(f"{t:.3g}" for t in vessel.time_constants_s())
        surge, sway, yaw = 1e3 * vessel.reachable_acceleration()[1]
        reached = f"{surge:.3g} and {sway:.3g} mm/s², {yaw:.3g} mrad/s²"
        about = [f"time constants: {times} s", f"acceleration at full thrust: {reached}"]
        entries.append(entry(name, [vessel.title, *about]))
    return plain("\n".join(entries))


def _scenarios() -> RenderableType:
    entries = []
    for name in problem_names("scenarios"):
        scenario = load_scenario(name)
        tuning = f"{scenario.tuning} {scenario.N_p}/{scenario.N_c}"
        about = f"vessel {scenario.vessel.id}, tuning {tuning}, {scenario.steps} steps"
        entries.append(entry(name, [about, scenario.shows]))
    return plain("\n".join(entries))


def _suites() -> RenderableType:
    table = small_table("name", "cells", "asks")
    for name in problem_names("suites"):
        path, suite = load_suite(name)
        table.add_row(name, str(len(plan(suite, beside=path.parent))), suite.title)
    return table


def _sequences() -> RenderableType:
    table = small_table("name", "n", "m", "K", "active", "matrices", "samples")
    for name in problem_names(SEQUENCES):
        recorded = load_recorded(sequence_path(name))
        sequence, meta = recorded.sequence, recorded.sequence.meta
        sets = [active_set(o) for o in recorded.optima or [] if np.isfinite(o.bound)]
        base, every = sequence.base, int(meta.get("every", 1))
        table.add_row(
            name,
            *(str(count) for count in (base.n, base.m, len(sequence))),
            f"{np.count_nonzero(sets) / np.size(sets):.1%}" if sets else "–",
            "constant" if sequence.P is None else "each step's",
            "each" if every == 1 else f"each {every}th",
        )
    return Group(table, plain(SEQUENCES_ARE))


def _solvers() -> RenderableType:
    return plain("\n".join(map(_solver, solver_names())))


def _solver(name: str) -> str:
    row, library = record(name), available(name)
    installed = library.version or "" if library.ok else f"not installed: {library.reason}"
    build = f", {library.build.text}" if library.build.text else ""
    policies = "; ".join(f"{route}: {', '.join(p)}" for route, p in row.policies.items())
    about = [row.method, f"form {row.form}; {policies}", *describe_levels(name).splitlines()]
    return entry(f"{name} {installed}{build}".rstrip(), about)


def check_file(asked: str, progress: Progress | None = None) -> str:
    """Check what `run` takes, by its name or path; what it is, in one line, or a dozen of a ship.

    That is a vessel, scenario (`rough`, `rough@osv`) or suite, a sequence, or a problem or a folder
    of problems by qpsolvers; or a folder of results that was sent to us. Every optimum is
    certified, which may take a while.

    Raises
    ------
    InputError : naming file, key, what was found and what is allowed.
    """
    if is_stored(asked):
        return verify_sequence(sequence_path(asked), progress)
    # A scenario and a suite may have one name.
    paths = [problem_path(kind, asked) for kind in KINDS if asked in problem_names(kind)]
    if paths:
        return "\n".join(_check_document(path, progress) for path in paths)
    if any(os.path.isfile(os.path.join(asked, name)) for name in (SENDER, "runs.parquet")):
        return check_sent(Path(asked))
    # Unlike Path.exists, these are False for a name that is too long to exist.
    if os.path.isdir(asked) or asked.endswith(".npz"):
        return verify_sequence(Path(asked), progress)
    if os.path.isfile(asked):
        return _check_document(Path(asked), progress)
    if "@" in asked:
        return scenario_text(asked, load_scenario(asked), progress)
    if asked.endswith(".toml") or "/" in asked:
        raise InputError(asked, "", "no such file or folder", CHECKED)
    raise _unknown(asked)


def _unknown(asked: str) -> InputError:
    """The error of a name that nothing has, with the nearest names of all kinds."""
    names = [name for kind in (*KINDS, SEQUENCES) for name in problem_names(kind)]
    near = difflib.get_close_matches(asked, names, n=3)
    hint = f"e.g. {', '.join(near)}; " if near else ""
    shown = repr(asked if len(asked) <= 80 else f"{asked[:77]}...")
    return InputError("check", "", shown, f"{hint}{CHECKED}; `dpbench list` has the names")


def _check_document(file: Path, progress: Progress | None) -> str:
    """A TOML file, recognised by its tables."""
    document = read_toml(file)
    if "limits" in document or "thrusters" in document:
        return vessel_text(file, load_vessel(file), progress)
    if "controller" in document or "environment" in document:
        return scenario_text(file, load_scenario(file), progress)
    of_suite = SuiteFile.tables_of_cells()
    if any(table in document for table in of_suite):
        suite_path, suite = load_suite(file)
        with naming(suite_path):
            return f"{file}: a suite of {len(plan(suite, beside=suite_path.parent))} cells"
    raise InputError(
        str(file),
        "",
        f"tables {', '.join(document) or '(none)'}",
        "[limits] or [[thrusters]] (a vessel), [controller] and [environment] (a scenario), "
        f"or {', '.join(f'[[{table}]]' for table in of_suite)} (a suite)",
    )
