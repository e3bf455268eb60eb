"""Expand a suite into cells, before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dpbench.bench.cell import Cell
from dpbench.bench.suite import ClosedLoopTable, ReplayTable, SuiteFile, UnitName
from dpbench.errors import InputError, UnknownNameError
from dpbench.scenario import Scenario, load_scenario
from dpbench.solvers.contract import Policy
from dpbench.solvers.open import REFUSED_BY_QPSOLVERS
from dpbench.solvers.table import (
    TABLE,
    UNCONSTRAINED_CLIPPED,
    available,
    record,
    settings_matter,
    solver_names,
)

CONTRAST = UNCONSTRAINED_CLIPPED.name


Arm = tuple[str, UnitName, str, Policy, tuple[str, ...]]
"""solver, units, settings, policy, and further names of the same settings."""


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

    "all" means every solver of the table except those of the extra `jax` that are not installed:
    they are left out by default (`dpbench list solvers` says so), and asked for by name.
    """
    names = list(only) if only else suite.solvers
    chosen: list[str] = []
    for name in names:
        if name == "all":
            chosen += [s for s in solver_names() if TABLE[s].extra != "jax" or available(s).ok]
            chosen.remove(CONTRAST)
        elif name in TABLE:
            chosen.append(name)
        else:
            raise UnknownNameError(
                "solver", "", repr(name), f"one of {', '.join(solver_names())}, or all"
            )
    if not only and suite.contrast:
        chosen.append(CONTRAST)
    return list(dict.fromkeys(chosen))


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
    wanted = set(scenarios) if scenarios else set(known)
    cells: list[Planned] = []
    for closed in suite.closed_loop:
        for name in closed.scenarios:
            if name in wanted:
                cells += _closed_loop_cells(suite, closed, loaded[name], chosen)
    for replay in suite.replay:
        if replay.scenario in wanted:
            cells += _replay_cells(suite, replay, loaded[replay.scenario], chosen)
    return cells


def _arms(solvers: Sequence[str], table: ClosedLoopTable | ReplayTable) -> list[Arm]:
    """The arms of one table of a suite."""
    arms: list[Arm] = []
    for units in table.units:
        for policy in table.policies:
            for solver in solvers:
                if settings_matter(solver):
                    arms += [(solver, units, name, policy, ()) for name in table.settings]
                else:
                    first, *others = table.settings
                    arms.append((solver, units, first, policy, tuple(others)))
    return arms


def _refusal(solver: str, policy: Policy) -> str:
    found, row = available(solver), record(solver)
    if not found.ok:
        return found.reason
    if policy in row.policies[row.default_route]:
        return ""
    reason = row.refused.get((row.default_route, policy), "")
    return f"policy {policy}: {reason or REFUSED_BY_QPSOLVERS.get(policy, 'not offered')}"


def _closed_loop_cells(
    suite: SuiteFile, table: ClosedLoopTable, scenario: Scenario, solvers: Sequence[str]
) -> list[Planned]:
    cells = []
    steps = min(table.steps or scenario.steps, scenario.steps)
    for solver, units, settings, policy, alias in _arms(solvers, table):
        contrast = solver == CONTRAST
        # The contrast law does not look at units or settings: it runs where the default arms do.
        if contrast and (units, settings, policy) != ("scaled", "default", "fresh"):
            continue
        cell = Cell(
            mode="closed_loop",
            scenario=scenario.files,
            solver=solver,
            route=record(solver).default_route,
            policy=policy,
            settings=settings,
            steps=steps,
            formulation="none" if contrast else table.formulation,
            units=units,
            limit_s=suite.cell_limit_s,
            fallback=table.fallback,
        )
        cells.append(Planned(cell, _refusal(solver, policy), alias))
    return cells


def _replay_cells(
    suite: SuiteFile, table: ReplayTable, scenario: Scenario, solvers: Sequence[str]
) -> list[Planned]:
    if table.first >= scenario.steps:
        raise InputError(
            f"suite: replay of {scenario.name}", "first", table.first, f"below {scenario.steps}"
        )
    cells = []
    steps = min(table.steps or scenario.steps, scenario.steps - table.first)
    for solver, units, settings, policy, alias in _arms(solvers, table):
        if solver == CONTRAST:
            continue
        cell = Cell(
            mode="replay",
            scenario=scenario.files,
            solver=solver,
            route=record(solver).default_route,
            policy=policy,
            settings=settings,
            steps=steps,
            formulation=table.formulation,
            units=units,
            first=table.first,
            rounds=suite.rounds,
            warmup_steps=min(suite.warmup_steps, steps),
            limit_s=suite.cell_limit_s,
        )
        cells.append(Planned(cell, _refusal(solver, policy), alias))
    return cells
