"""A page for every solver, from its record and from what is known of its faults."""

import tomllib
from pathlib import Path

from dpbench.solvers.contract import (
    DEFAULT,
    NOT_OFFERED,
    POLICIES,
    TOLERANCES,
    Route,
    RouteRecord,
    SolverRecord,
)
from dpbench.solvers.settings import (
    find_options_of_preset,
    has_distinct_tolerance_presets,
    list_preset_names,
)
from dpbench.solvers.table import TABLE
from sitegen.markup import code, prose, table

PITFALLS: dict[str, list[str]] = tomllib.loads(
    Path(__file__).with_name("pitfalls.toml").read_text(encoding="utf-8")
)
"""Warnings about the use of a solver, by its name."""
ROUTES: dict[Route, str] = {
    "native": "through its own interface",
    "qpsolvers": "through the package qpsolvers",
}
INTRODUCTION = """# Solvers

One page for each solver that dpbench has an adapter for. A solver that qpsolvers serves works by
its name without one, and [your own](../tutorials/add-a-solver.md) is one file. Others were
[looked at and left out](../looked-at.md).
`dpbench list solvers` lists which are installed here, in which version.
"""
EXTRAS = {
    "core": "with dpbench",
    "solvers": "with the extra `solvers`",
    "jax": "with the extra `jax` (some 600 MB)",
    "casadi": "with the extra `casadi`",
    "own": "part of dpbench",
}


def pages() -> dict[str, str]:
    """Markdown by file of the documentation."""
    return {"solvers/index.md": _index()} | {
        f"solvers/{name}.md": _page(row) for name, row in TABLE.items()
    }


def _index() -> str:
    rows = (
        (
            f"[{name}]({name}.md)",
            row.family,
            prose(row.method),
            ", ".join(row.routes),
            prose(row.project.licence.value),
            prose(row.project.language.value),
        )
        for name, row in TABLE.items()
    )
    heads = ("solver", "family", "method", "routes", "licence", "language")
    return f"{INTRODUCTION}\n{table(heads, rows)}"


def _page(row: SolverRecord) -> str:
    parts = [f"# {row.name}\n", f"{prose(row.method[0].upper() + row.method[1:])}.\n", _facts(row)]
    for route, can in row.routes.items():
        parts += [f"## Route {code(route)}\n", f"Run {ROUTES[route]}.\n"]
        parts += [_abilities(row, route, can), *_faults(can)]
    parts += ["## Settings\n", _settings(row)]
    known = [
        f"Steps that end as `{status.name}`: {text}." for status, text in row.known_failures.items()
    ]
    known += PITFALLS.get(row.name, [])
    if known:
        parts += ["## Notes for users\n"]
        parts += ["\n".join(f"- {prose(text)}" for text in known), ""]
    return "\n".join(parts)


def _facts(row: SolverRecord) -> str:
    install = f"`pip install {row.distribution}`; " if row.distribution else ""
    rows = [
        ("name in dpbench", code(row.name), ""),
        ("family", row.family, ""),
        ("installation", f"{install}{EXTRAS[row.extra]}", ""),
        ("matrices", {"dense": "dense", "csc": "sparse, by columns"}[row.form], ""),
        ("P has to be positive definite", _yes(row.needs_strict_convexity), ""),
        ("may be deployed on a ship as it is", _unless(row.reason_not_deployable), ""),
    ]
    stated = {
        "licence": row.project.licence,
        "language": row.project.language,
        "C code": row.project.c_code,
        "solves without allocating": row.project.allocation_free,
        "single precision": row.project.single_precision,
    }
    if row.choose_instead:
        better = f"[{row.choose_instead}]({row.choose_instead}.md)"
        rows.append(("choose instead", f"{better}; suite `standard` leaves this one out", ""))
    rows += [(what, prose(fact.value), prose(fact.source)) for what, fact in stated.items()]
    return table(("", "", "source"), rows)


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _unless(reason: str) -> str:
    """Format "yes" without a reason against it; else "no" with the reason, if there is one."""
    if reason == NOT_OFFERED:
        return "no"
    return f"no: {prose(reason)}" if reason else "yes"


def _abilities(row: SolverRecord, route: Route, can: RouteRecord) -> str:
    rows = [
        (
            f"policy {code(policy)}: {text}",
            _unless(row.state_why_policy_is_unavailable(route, policy)),
        )
        for policy, text in POLICIES.items()
    ]
    rows += [
        ("takes over without a new set-up", can.updates),
        ("a warm start is made of", can.start),
        ("two-sided limits reach it as such", _yes(can.two_sided)),
        ("multipliers come back", _yes(can.gives_multipliers)),
        ("an infeasible problem is reported as such", _yes(can.detects_infeasibility)),
    ]
    if can.keeps:
        rows.append(("a kept workspace also keeps", prose(can.keeps)))
    return table(("capability", ""), rows)


def _faults(can: RouteRecord) -> list[str]:
    if not can.faults:
        return []
    lines = (f"- {prose(name)}: {prose(why)}" for name, why in can.faults.items())
    return ["Known faults; a test shows each, and fails on the day it is gone:\n", *lines, ""]


def _settings(row: SolverRecord) -> str:
    same, names = "", list_preset_names(row.name)
    if not has_distinct_tolerance_presets(row.name):
        same = "It has no tolerance to set: all presets are the same.\n"
        names = tuple(name for name in names if name not in TOLERANCES)
        if names == (DEFAULT,):
            return same
    rows = []
    for name in names:
        keys = find_options_of_preset(name, row.name).items()
        options = ", ".join(code(f"{key}={value!r}") for key, value in keys)
        rows.append((code(name), options or "the library's own defaults"))
    return same + ("\n" if same else "") + table(("settings", "options"), rows)
