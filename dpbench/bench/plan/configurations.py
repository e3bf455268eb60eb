"""The configurations of a suite: its solvers in every mode of each table."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path

from dpbench.bench.plan.solver_settings import (
    list_settings_of_choice,
    refuse_invalid_own_settings,
    refuse_unknown_settings_names,
)
from dpbench.bench.plan.suite import (
    CapabilityTable,
    ClosedLoopTable,
    RandomTable,
    RecordedTable,
    ReplayTable,
    ScenarioRunsTable,
    SuiteFile,
)
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.configuration import Configuration
from dpbench.errors import InputError, format_allowed_names
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.contract import Route
from dpbench.solvers.own.adapters import UNCONSTRAINED_CLIPPED
from dpbench.solvers.own_settings import (
    expand_choice_over_option_grid,
    split_into_solver_and_options_text,
)
from dpbench.solvers.plugins import find_plugin
from dpbench.solvers.table import (
    TABLE,
    Availability,
    find_solver_availability,
    find_solver_record,
    list_all_solver_names,
)

BASELINE_LAW = UNCONSTRAINED_CLIPPED.name
Table = ClosedLoopTable | ReplayTable | RandomTable | RecordedTable | CapabilityTable


def choose_solvers(suite: SuiteFile, only: Sequence[str] | None) -> list[str]:
    """Return the solvers of a suite, or those of `only` where some are chosen.

    A solver with options of one's own is a text such as `osqp[rho=1.6]`. "all" leaves out those of
    an optional extra that is not installed. UnknownNameError for an unknown solver; SettingsError
    for options that a solver does not have; InputError for a baseline of the report, or solvers of
    a table, that the suite has not.
    """
    named = _resolve_solvers("solvers", suite.solvers)
    for kind, tables in (("closed_loop", suite.closed_loop), ("replay", suite.replay)):
        key = f"{kind}.solvers"
        for table in tables:
            wanted = _resolve_solvers(key, table.solvers)
            if wanted and not any(_is_choice_among(choice, wanted) for choice in named):
                found = ", ".join(table.solvers)
                allowed = f"a solver of the suite: {format_allowed_names(found, named)}"
                raise InputError("suite", key, found, allowed)
    baseline = suite.report.baseline
    solvers = [split_into_solver_and_options_text(choice)[0] for choice in named]
    if baseline is not None and baseline not in solvers:
        allowed = f"a solver of the suite: {format_allowed_names(baseline, solvers)}"
        raise InputError("suite", "report.baseline", repr(baseline), allowed)
    chosen = _expand_solver_choices(only) if only else named
    if not only and suite.baseline_law:
        chosen.append(BASELINE_LAW)
    if not only and suite.calibration:
        chosen += CALIBRATION
    refuse_invalid_own_settings(suite, chosen, "`solvers`" if only else "suite: solvers")
    return list(dict.fromkeys(chosen))


def _is_choice_among(choice: str, names: Sequence[str]) -> bool:
    """Return whether a choice such as `osqp[rho=1.6]`, or its solver, is one of `names`."""
    return choice in names or split_into_solver_and_options_text(choice)[0] in names


def _resolve_solvers(key: str, names: Sequence[str]) -> list[str]:
    """Return the solvers that an entry of the suite names; an InputError names the entry."""
    try:
        return _expand_solver_choices(names)
    except InputError as error:
        place = f"{key}: {error.key}" if error.key else key
        raise type(error)("suite", place, error.found, error.allowed) from error


def _expand_solver_choices(names: Sequence[str]) -> list[str]:
    """Return choices of solvers without repeats, with "all" and grids of settings expanded."""
    chosen: list[str] = []
    for name in names:
        if name == "all":
            chosen += [
                s for s in list_all_solver_names() if s != BASELINE_LAW and _is_default_solver(s)
            ]
        else:
            find_solver_record(split_into_solver_and_options_text(name)[0])
            chosen += expand_choice_over_option_grid(name)
    return list(dict.fromkeys(chosen))


def _is_default_solver(solver: str) -> bool:
    """Return whether "all solvers" includes one: it is no optional extra, or is installed."""
    return (
        find_solver_record(solver).extra not in ("jax", "casadi")
        or find_solver_availability(solver).ok
    )


def find_backup_and_refusal(name: str) -> tuple[str, str]:
    """Return the backup solver of a closed loop, and why it cannot be opened; "" for neither.

    UnknownNameError for an unknown solver; InputError for a plug-in of a file, which the workers of
    another solver do not load.
    """
    if not name:
        return "", ""
    one = name != "all" and "[" not in name
    (solver,) = _resolve_solvers("closed_loop.backup", [name]) if one else ("",)
    if not solver or find_plugin_file(solver) or solver in CALIBRATION:
        allowed = "one solver of `list_solvers()`, or of an installed plug-in"
        raise InputError("suite", "closed_loop.backup", repr(name), allowed)
    here = find_solver_availability(solver)
    return solver, "" if here.ok else f"backup {solver}: {here.reason}"


def identify_libraries_of_cell(cell: Cell, library: Availability) -> str:
    """Return version and build of the libraries of a run's solver and backup solver."""
    if not cell.backup:
        return library.version_and_build_text
    backup = find_solver_availability(cell.backup)
    return f"{library.version_and_build_text}, backup {backup.version_and_build_text}"


def find_plugin_file(solver: str) -> str:
    """Return the Python plug-in file that a solver is loaded from; "" for other solvers."""
    plugin = None if solver in TABLE else find_plugin(solver)
    return plugin.origin if plugin is not None and Path(plugin.origin).is_file() else ""


def list_configurations(
    suite: SuiteFile, solvers: Sequence[str], table: Table
) -> list[Configuration]:
    """Return each solver of a suite table in every call mode, settings, units and QP form.

    Of solvers named by the table, those of the suite take part. The harness's own configurations
    have one call mode, whatever the table has, and take part in timed replays alone.
    """
    solvers = _select_solvers(solvers, table)
    if not solvers:
        return []
    refuse_unknown_settings_names(suite, table, solvers)
    own = [name for name in solvers if name in CALIBRATION]
    solvers = [name for name in solvers if name not in CALIBRATION]
    configurations: list[Configuration] = []
    for units, formulation, policy, wanted, choice in product(
        table.units, table.formulations, table.policies, table.routes, solvers
    ):
        row = find_solver_record(split_into_solver_and_options_text(choice)[0])
        route: Route = row.default_route if wanted == "default" else wanted
        if route not in row.policies_by_route:
            continue
        configurations += [
            Configuration(row.name, route, policy, name, units, formulation, options, alias)
            for name, options, alias in list_settings_of_choice(choice, table, suite)
        ]
    timed = isinstance(table, ReplayTable | RecordedTable)
    return configurations + [Configuration(name, "native", "reuse") for name in own if timed]


def _select_solvers(solvers: Sequence[str], table: Table) -> list[str]:
    """Return the suite's solvers that take part in a table, by its `solvers` and `without`."""
    if not isinstance(table, ScenarioRunsTable):
        return list(solvers)
    named = _expand_solver_choices(table.solvers) if table.solvers else solvers
    without = _expand_solver_choices(table.without)
    return [
        choice
        for choice in solvers
        if _is_choice_among(choice, named) and not _is_choice_among(choice, without)
    ]


def find_reason_to_refuse(configuration: Configuration) -> str:
    """Return why a solver configuration cannot run on this machine; "" where it can."""
    here = find_solver_availability(configuration.solver)
    if not here.ok:
        return here.reason
    policy = configuration.policy
    reason = find_solver_record(configuration.solver).state_why_policy_is_unavailable(
        configuration.route, policy
    )
    return f"policy {policy}: {reason}" if reason else ""
