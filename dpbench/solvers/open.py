"""Open a workspace by the name of its solver."""

import warnings
from collections.abc import Mapping
from functools import partial

from dpbench.errors import PolicyError, UnknownNameError, require_type
from dpbench.solvers.contract import (
    POLICIES,
    Options,
    Policy,
    Route,
    Settings,
    SolverRecord,
    Workspace,
)
from dpbench.solvers.own_settings import (
    convert_numbers_of_numpy,
    parse_options_of_choice,
    split_into_solver_and_options_text,
)
from dpbench.solvers.settings import resolve_settings_to_options
from dpbench.solvers.table import (
    find_solver_record,
    get_native_adapter,
    get_qpsolvers_adapter,
    require_solver_available,
)


def open_workspace(
    solver: str,
    *,
    route: Route | None = None,
    policy: Policy = "fresh",
    settings: Settings = "default",
    step_limit_s: float | None = None,
) -> Workspace:
    """Return a QP solver opened by name, ready for its set-up with a first problem.

    Parameters
    ----------
    solver : a name of the table, of a plug-in, or one that qpsolvers serves.
    route : "qpsolvers" or "native"; None for the solver's default, which is "qpsolvers" where it
        has both.
    policy : "fresh", "reuse" or "warm", where the route has it. Compare times on route "native"
        with "warm" where there is one: every other call includes set-up.
    settings : a name of its settings, or a mapping of the solver's own keys.
    step_limit_s : time limit of a solve [s] for a library with an option for it, unless `settings`
        has this option.

    Raises
    ------
    UnknownNameError : there is no such solver.
    PolicyError : the solver has no such route, or the route no such policy.
    SettingsError : unknown name, or a key or value that the library does not accept.
    SolverUnavailableError : the library is missing or fails to import.

    Examples
    --------
    >>> open_workspace("osqp", route="native", policy="warm", settings={"eps_abs": 1e-5})
    <Workspace of osqp (native, warm, eps_abs=1e-05)>
    """
    require_type("solver", solver, str, "the name of a solver")
    require_type("route", route, str | None, "the name of a route")
    require_type("policy", policy, str, "the name of a policy")
    allowed = "a name such as 'high', a tolerance as text such as '1e-4', or a mapping of options"
    require_type("settings", settings, str | Mapping, allowed)
    for option in () if isinstance(settings, str) else settings:
        require_type("settings", option, str, "names of options")
    if not isinstance(settings, str):
        settings = convert_numbers_of_numpy(settings)
    name, brackets = split_into_solver_and_options_text(solver)
    if brackets:
        options = parse_options_of_choice(solver)
        allowed = f"{name!r} with settings={options!r}"
        raise UnknownNameError("solver", "", repr(solver), allowed)
    row = find_solver_record(solver)
    route = row.default_route if route is None else route
    _require_route_and_policy(row, route, policy)
    make = partial(_make_workspace_of_route, row, route, policy, settings, step_limit_s)
    workspace = make()
    workspace.reopen, workspace.requested_settings = make, settings
    return workspace


def _make_workspace_of_route(
    row: SolverRecord,
    route: Route,
    policy: Policy,
    settings: Settings,
    step_limit_s: float | None,
) -> Workspace:
    """Return the workspace of a solver by route, policy, settings and time limit per step [s]."""
    solver = row.name
    require_solver_available(solver)
    limited = row.time_limit and step_limit_s is not None
    limits: Options = {row.time_limit: step_limit_s} if limited else {}
    if route == "native":
        native = get_native_adapter(solver)
        return native.workspace(
            row, policy, {**limits, **resolve_settings_to_options(settings, native)}
        )
    adapter = get_qpsolvers_adapter(solver)
    options = {**limits, **resolve_settings_to_options(settings, adapter)}
    if adapter.prepare is not None:
        adapter.prepare()
    # qpsolvers imports every library it finds, so it is imported only when needed.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from dpbench.solvers.libraries.qpsolvers_workspace import QpsolversWorkspace

    return QpsolversWorkspace(adapter, policy, options)


def _require_route_and_policy(row: SolverRecord, route: Route, policy: Policy) -> None:
    """Raise PolicyError if a solver lacks this interface or this way of starting each solve."""
    where = f"solver {row.name}"
    if route not in row.routes:
        raise PolicyError(where, "route", repr(route), ", ".join(row.routes))
    runs = ", ".join(row.get_route_record(route).policies)
    for other in row.routes:
        if other != route:
            runs += f" (route {other}: {', '.join(row.get_route_record(other).policies)})"
    if policy not in POLICIES:
        raise PolicyError(where, f"route {route}: policy", repr(policy), runs)
    reason = row.state_why_policy_is_unavailable(route, policy)
    if reason:
        raise PolicyError(where, f"route {route}: policy", f"{policy!r} ({reason})", runs)
