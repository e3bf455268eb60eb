"""Table of all solvers: version, method, routes and policies, tolerance presets."""

from __future__ import annotations

from rich.text import Text

from dpbench.cli.terminal import entry, plain
from dpbench.solvers.settings import describe_levels
from dpbench.solvers.table import available, record, solver_names


def solver_list() -> Text:
    """Make the table of the solvers, in 80 columns."""
    return plain("\n".join(map(_solver, solver_names())))


def _solver(name: str) -> str:
    row, library = record(name), available(name)
    installed = library.version or "" if library.ok else f"not installed: {library.reason}"
    build = f", {library.build.text}" if library.build.text else ""
    policies = "; ".join(f"{route}: {', '.join(p)}" for route, p in row.policies.items())
    about = [row.method, f"form {row.form}; {policies}", *describe_levels(name).splitlines()]
    return entry(f"{name} {installed}{build}".rstrip(), about)
