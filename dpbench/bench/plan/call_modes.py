"""A choice of call modes: routes and policies in place of those of a suite's tables."""

from collections.abc import Sequence
from typing import get_args

from dpbench.bench.plan.configurations import BASELINE_LAW
from dpbench.bench.plan.study_points import RouteName
from dpbench.bench.plan.suite import SuiteFile
from dpbench.errors import PolicyError
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.contract import Policy, Route
from dpbench.solvers.own_settings import split_into_solver_and_options_text
from dpbench.solvers.record import SolverRecord
from dpbench.solvers.table import find_solver_record


def check_mode_names(routes: Sequence[str] | None, policies: Sequence[str] | None) -> None:
    """Raise PolicyError for an unknown route or policy."""
    for argument, chosen, known in (
        ("`routes`", routes, get_args(RouteName)),
        ("`policies`", policies, get_args(Policy)),
    ):
        for name in chosen or ():
            if name not in known:
                raise PolicyError(argument, "", repr(name)[:90], " | ".join(known))


def check_call_modes(suite: SuiteFile, solvers: Sequence[str], has_routes: bool) -> list[str]:
    """Return remarks on the solvers that do not run in the chosen routes and policies.

    suite : with the chosen routes and policies in its tables; solvers : its choices of solvers.
    has_routes : whether routes are chosen, and not policies alone.

    Raises PolicyError if no solver has one of the call modes.
    """
    names = {split_into_solver_and_options_text(choice)[0] for choice in solvers} - {
        BASELINE_LAW,
        *CALIBRATION,
    }
    records = {name: find_solver_record(name) for name in sorted(names)}
    modes = {
        (route, policy)
        for key in SuiteFile.list_names_of_run_tables()
        for table in getattr(suite, key)
        for route in table.routes
        for policy in table.policies
    }
    lacking = {name: _explain_lack(row, modes) for name, row in records.items()}
    missing = {name: reason for name, reason in lacking.items() if reason}
    if lacking and len(missing) == len(lacking):
        name, (found, allowed) = next(iter(missing.items()))
        others = f" (none of {len(missing)} solvers has it)" if len(missing) > 1 else ""
        argument = "`routes`" if has_routes else "`policies`"
        raise PolicyError(argument, "", f"{found}{others}", f"{allowed} of {name}")
    return [f"{name} does not run: it has no {found}" for name, (found, _) in missing.items()]


def _explain_lack(
    row: SolverRecord, modes: set[tuple[RouteName, Policy]]
) -> tuple[str, str] | None:
    """Return the call modes that a solver lacks and those it has; None if it has one of them."""
    wanted: set[tuple[Route, Policy]] = {
        (row.default_route if route == "default" else route, p) for route, p in modes
    }
    offered = {(route, p) for route in row.routes for p in row.get_route_record(route).policies}
    if wanted & offered:
        return None
    return _join_modes(wanted), _join_modes(offered)


def _join_modes(modes: set[tuple[Route, Policy]]) -> str:
    """Return call modes as text, such as `native fresh | native warm`."""
    return " | ".join(f"{route} {policy}" for route, policy in sorted(modes))
