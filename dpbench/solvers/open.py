"""Opening a workspace: the one door through which a solver is asked for by name."""

from __future__ import annotations

import warnings

from dpbench.errors import InputError, PolicyError, SolverUnavailableError
from dpbench.solvers.calibration import CALIBRATION, open_calibration
from dpbench.solvers.contract import Policy, Route, Settings, Workspace
from dpbench.solvers.native import NATIVE
from dpbench.solvers.plugins import find_plugin
from dpbench.solvers.record import SolverRecord
from dpbench.solvers.settings import check_names, level_options, resolve
from dpbench.solvers.table import available, record
from dpbench.solvers.through_qpsolvers import ADAPTERS
from dpbench.solvers.through_qpsolvers.generic import generic_adapter

HILDRETH_KEYS = ("max_iter", "eps_change", "eps_row")
POLICIES: dict[str, str] = {
    "fresh": "set up from nothing at each step",
    "reuse": "factorisation and memory kept, start reset",
    "warm": "previous answer kept as start",
}
REFUSED_BY_QPSOLVERS = {
    "reuse": "qpsolvers sets the library up anew at every solve, so nothing can be reused",
    "warm": "it ignores a start handed over by qpsolvers, so it cannot differ from fresh",
}


def open_workspace(
    solver: str,
    *,
    route: Route | None = None,
    policy: Policy = "fresh",
    settings: Settings = "default",
) -> Workspace:
    """A workspace of `solver`, not yet set up.

    Parameters
    ----------
    solver : a name of the table, of a plug-in, or one that qpsolvers serves.
    route : "qpsolvers" or "native"; None takes the solver's own default.
    policy : "fresh", "reuse" or "warm", where the route has it.
    settings : a tolerance level, or a mapping of the solver's own keys.

    Raises
    ------
    UnknownNameError : there is no such solver.
    PolicyError : the solver has no such route, or the route no such policy; says why.
    SettingsError : unknown name, or a key or value that the library does not accept.
    SolverUnavailableError : the library is missing or fails to import; names the remedy.
    """
    row = record(solver)
    route = row.default_route if route is None else route
    _check_policy(row, route, policy)
    found = available(solver)
    if not found.ok:
        raise SolverUnavailableError("solver", solver, found.reason, f"after {row.remedy}")
    if row.extra == "own":
        return _open_own(row, policy, settings)
    if row.extra == "plugin":
        return _open_plugin(row, policy, settings)
    if route == "native":
        native = NATIVE[solver]
        return native.workspace(row, policy, resolve(settings, native))
    adapter = ADAPTERS[solver] if solver in ADAPTERS else generic_adapter(solver)
    options = resolve(settings, adapter)
    if adapter.prepare is not None:
        adapter.prepare()
    # qpsolvers imports every library it finds, so it is imported only when it is needed, and
    # without their warnings.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from dpbench.solvers.through_qpsolvers.workspace import QpsolversWorkspace

    return QpsolversWorkspace(adapter, policy, options)


def _check_policy(row: SolverRecord, route: Route, policy: Policy) -> None:
    where = f"solver {row.name}"
    if route not in row.policies:
        raise PolicyError(where, "route", repr(route), " | ".join(row.policies))
    allowed = row.policies[route]
    if policy in allowed:
        return
    if policy not in POLICIES:
        raise PolicyError(where, "policy", repr(policy), " | ".join(allowed))
    reason = row.refused.get((route, policy), REFUSED_BY_QPSOLVERS.get(policy, ""))
    raise PolicyError(where, f"route {route}: policy", repr(policy), f"{_join(allowed)} ({reason})")


def _join(allowed: tuple[Policy, ...]) -> str:
    return " | ".join(f"{policy}: {POLICIES[policy]}" for policy in allowed)


def _open_plugin(row: SolverRecord, policy: Policy, settings: Settings) -> Workspace:
    plugin = find_plugin(row.name)
    assert plugin is not None, "its record came from there"
    options = level_options(settings, row.name) if isinstance(settings, str) else dict(settings)
    workspace = plugin.open(policy, options)
    if not isinstance(workspace, Workspace):
        raise InputError(f"solver {row.name}", "open", repr(workspace), "a Workspace")
    # A plug-in's author need not know how the harness tells a fresh workspace.
    workspace.setup_every_step = policy == "fresh"
    return workspace


def _open_own(row: SolverRecord, policy: Policy, settings: Settings) -> Workspace:
    if isinstance(settings, str):
        options = level_options(settings, row.name)
    else:
        check_names(row.name, settings, HILDRETH_KEYS if row.name == "hildreth" else ())
        options = dict(settings)
    if row.name in CALIBRATION:
        return open_calibration(row.name)
    # What is compiled is loaded, or compiled at the first time, only when it is asked for.
    if row.name == "paper_active_set":
        from dpbench.solvers.own.paper_active_set import PaperActiveSet

        return PaperActiveSet(row.name, "native", policy)
    if row.name == "hildreth":
        from dpbench.solvers.own.hildreth import Hildreth, HildrethSettings

        return Hildreth(row.name, "native", policy, HildrethSettings.of(options))
    from dpbench.solvers.own.unconstrained import FreshUnconstrained, Unconstrained

    kind = FreshUnconstrained if policy == "fresh" else Unconstrained
    return kind(row.name, "native", policy)
