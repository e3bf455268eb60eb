"""Expand a suite into cells, before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from dpbench.bench.cell import Cell
from dpbench.bench.suite import ClosedLoopTable, ReplayTable, SuiteFile, UnitName
from dpbench.errors import InputError, SettingsError
from dpbench.scenario import Scenario, load_scenario
from dpbench.solvers.contract import Policy, Route
from dpbench.solvers.open import REFUSED_BY_QPSOLVERS
from dpbench.solvers.plugins import find_plugin
from dpbench.solvers.settings import setting_names
from dpbench.solvers.table import (
    TABLE,
    UNCONSTRAINED_CLIPPED,
    available,
    record,
    settings_matter,
    solver_names,
)

CONTRAST = UNCONSTRAINED_CLIPPED.name


@dataclass(frozen=True)
class Arm:
    """One way of running one solver; `alias` are further names of the same settings."""

    solver: str
    route: Route
    policy: Policy
    units: UnitName
    settings: str
    alias: tuple[str, ...] = ()


@dataclass(frozen=True)
class Planned:
    """A cell to run, or the reason why it is a row without running.

    `alias_settings` are further names of the same settings, shown as rows of their own.
    """

    cell: Cell
    refused: str = ""
    alias_settings: tuple[str, ...] = ()


def choose_solvers(suite: SuiteFile, only: Sequence[str] | None) -> list[str]:
    """The solvers of a suite, or those of `only`; UnknownNameError for an unknown one.

    "all" means every solver of the table except those of an optional extra that is not installed:
    they are left out by default (`dpbench list solvers` says so), and asked for by name.
    """
    names = list(only) if only else suite.solvers
    chosen: list[str] = []
    for name in names:
        if name == "all":
            chosen += [s for s in solver_names() if s != CONTRAST and _by_default(s)]
        else:
            chosen.append(record(name).name)
    if not only and suite.contrast:
        chosen.append(CONTRAST)
    return list(dict.fromkeys(chosen))


def _by_default(solver: str) -> bool:
    return record(solver).extra not in ("jax", "casadi") or available(solver).ok


def _module_of(solver: str) -> str:
    """The file of a plug-in that a worker has to load; "" for every other solver."""
    plugin = None if solver in TABLE else find_plugin(solver)
    return plugin.origin if plugin is not None and Path(plugin.origin).is_file() else ""


def plan(
    suite: SuiteFile,
    *,
    solvers: Sequence[str] | None = None,
    scenarios: Sequence[str] | None = None,
    beside: Path | None = None,
) -> list[Planned]:
    """All cells of a suite in the order they run: closed loops first, then replays.

    Paths of scenarios are relative to the folder `beside`, that of the suite.

    Raises
    ------
    InputError : for an unknown scenario or solver, or a scenario that the suite does not have.
    """
    chosen = choose_solvers(suite, solvers)
    known = [name for table in suite.closed_loop for name in table.scenarios]
    known += [table.scenario for table in suite.replay]
    for name in scenarios or ():
        if name not in known:
            allowed = ", ".join(dict.fromkeys(known))
            raise InputError("--scenario", "", repr(name), f"a scenario of the suite: {allowed}")
    loaded = {name: load_scenario(name, beside=beside) for name in dict.fromkeys(known)}
    stems = [scenario.name for scenario in loaded.values()]
    for stem in stems:
        if stems.count(stem) > 1:
            allowed = "files of different names, which tell their results apart"
            raise InputError("suite", "scenarios", f"two scenarios called {stem!r}", allowed)
    wanted = set(scenarios) if scenarios else set(known)
    cells: list[Planned] = []
    for closed in suite.closed_loop:
        for name in closed.scenarios:
            if name in wanted:
                cells += _closed_loop_cells(suite, closed, loaded[name], chosen)
    for replay in suite.replay:
        if replay.scenario in wanted:
            cells += _replay_cells(suite, replay, loaded[replay.scenario], chosen)
    return _merged(cells)


def _merged(cells: Sequence[Planned]) -> list[Planned]:
    """Each cell once, with all names of its settings.

    Two tables may ask for the same cell, e.g. by its route's name and as the default one.
    """
    once: dict[str, Planned] = {}
    for planned in cells:
        known = once.setdefault(planned.cell.to_json(), planned)
        names = dict.fromkeys((*known.alias_settings, *planned.alias_settings))
        once[planned.cell.to_json()] = replace(known, alias_settings=tuple(names))
    return list(once.values())


def _arms(solvers: Sequence[str], table: ClosedLoopTable | ReplayTable) -> list[Arm]:
    """The arms of one table of a suite; a solver is left out of a route it does not have."""
    known = [name for solver in solvers for name in setting_names(solver)]
    for name in table.settings:
        if name not in known:
            raise SettingsError("settings", "", repr(name), " | ".join(dict.fromkeys(known)))
    arms: list[Arm] = []
    for units, policy, wanted, solver in product(
        table.units, table.policies, table.routes, solvers
    ):
        row = record(solver)
        route: Route = row.default_route if wanted == "default" else wanted
        if route not in row.policies:
            continue
        names = [name for name in table.settings if name in setting_names(solver)]
        if settings_matter(solver):
            arms += [Arm(solver, route, policy, units, name) for name in names]
        elif names:
            arms.append(Arm(solver, route, policy, units, names[0], tuple(names[1:])))
    return arms


def _refusal(arm: Arm) -> str:
    found, row = available(arm.solver), record(arm.solver)
    if not found.ok:
        return found.reason
    if arm.policy in row.policies[arm.route]:
        return ""
    reason = row.refused.get((arm.route, arm.policy), "")
    return f"policy {arm.policy}: {reason or REFUSED_BY_QPSOLVERS.get(arm.policy, 'not offered')}"


def _cell(arm: Arm, suite: SuiteFile, table: ClosedLoopTable | ReplayTable, **more: Any) -> Planned:
    contrast = arm.solver == CONTRAST
    cell = Cell(
        solver=arm.solver,
        route=arm.route,
        policy=arm.policy,
        settings=arm.settings,
        formulation="none" if contrast else table.formulation,
        units=arm.units,
        limit_s=suite.cell_limit_s,
        solver_module=_module_of(arm.solver),
        **more,
    )
    return Planned(cell, _refusal(arm), arm.alias)


def _closed_loop_cells(
    suite: SuiteFile, table: ClosedLoopTable, scenario: Scenario, solvers: Sequence[str]
) -> list[Planned]:
    steps = min(table.steps or scenario.steps, scenario.steps)
    # The contrast law does not look at units or settings: it runs where the default arms do.
    plain = ("scaled", "default", "fresh")
    return [
        _cell(
            arm,
            suite,
            table,
            mode="closed_loop",
            scenario=scenario.files,
            steps=steps,
            fallback=table.fallback,
        )
        for arm in _arms(solvers, table)
        if arm.solver != CONTRAST or (arm.units, arm.settings, arm.policy) == plain
    ]


def _replay_cells(
    suite: SuiteFile, table: ReplayTable, scenario: Scenario, solvers: Sequence[str]
) -> list[Planned]:
    if table.first >= scenario.steps:
        raise InputError(
            f"suite: replay of {scenario.name}", "first", table.first, f"below {scenario.steps}"
        )
    steps = min(table.steps or scenario.steps, scenario.steps - table.first)
    return [
        _cell(
            arm,
            suite,
            table,
            mode="replay",
            scenario=scenario.files,
            steps=steps,
            first=table.first,
            rounds=suite.rounds,
            warmup_steps=min(suite.warmup_steps, steps),
        )
        for arm in _arms(solvers, table)
        if arm.solver != CONTRAST
    ]
