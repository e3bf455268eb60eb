"""The ladder of settings: one place that says what each name means for each solver.

`default` is the library's own choice; `high` asks for 1e-9 absolute, relative criteria off (or at
1e-9 where the library needs them positive), criteria on the duality gap on, and iteration limits
high enough to get there. A solver without an entry has no tolerance to set.

OSQP's polishing stays off in `high`: it is a second algorithm, and its failures are silent.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

from dpbench.errors import SettingsError
from dpbench.solvers.contract import Settings
from dpbench.solvers.through_qpsolvers import Adapter
from dpbench.solvers.through_qpsolvers.adapter import Options

HIGH = 1e-9

_CONEQP = {"abstol": HIGH, "reltol": HIGH, "feastol": HIGH, "maxiters": 200}
LADDER: Mapping[str, Mapping[str, Options]] = {
    "default": {},
    "high": {
        "clarabel": {"tol_gap_abs": HIGH, "tol_gap_rel": HIGH, "tol_feas": HIGH, "max_iter": 500},
        "cvxopt": _CONEQP,
        # dual_tol stays at DAQP's own 1e-12, which is tighter.
        "daqp": {"primal_tol": HIGH},
        "ecos": {"abstol": HIGH, "reltol": HIGH, "feastol": HIGH, "max_iters": 500},
        "highs": {
            "primal_feasibility_tolerance": HIGH,
            "dual_feasibility_tolerance": HIGH,
            "qp_regularization_value": 0.0,
        },
        "jaxopt": {"tol": HIGH, "maxiter": 100_000},
        "kvxopt": _CONEQP,
        "osqp": {"eps_abs": HIGH, "eps_rel": 0.0, "max_iter": 200_000},
        "piqp": {
            "eps_abs": HIGH,
            "eps_rel": 0.0,
            "check_duality_gap": True,
            "eps_duality_gap_abs": HIGH,
            "eps_duality_gap_rel": 0.0,
            "max_iter": 1000,
        },
        "proxqp": {
            "eps_abs": HIGH,
            "eps_rel": 0.0,
            "check_duality_gap": True,
            "eps_duality_gap_abs": HIGH,
            "eps_duality_gap_rel": 0.0,
        },
        "qpalm": {"eps_abs": HIGH, "eps_rel": 0.0, "max_iter": 100_000},
        # qpax 0.1.4 stalls short of 1e-7 in its own measure: exact answers that it does not claim.
        "qpax": {"solver_tol": HIGH, "max_iter": 100},
        "qtqp": {"tol_feas": HIGH, "tol_gap_abs": HIGH, "tol_gap_rel": HIGH, "max_iter": 500},
        "scs": {"eps_abs": HIGH, "eps_rel": 0.0, "max_iters": 1_000_000},
        "sip": {"eps_abs": HIGH, "eps_rel": 0.0},
    },
}


def settings_matter(solver: str) -> bool:
    """Whether the names of the ladder differ for this solver."""
    return any(rung.get(solver) for rung in LADDER.values())


def resolve(settings: Settings, adapter: Adapter) -> Options:
    """The keyword arguments that `settings` means for a library.

    Raises
    ------
    SettingsError : for a name that is not in the ladder, a key the library does not have, or a
        value that its settings object refuses.
    """
    name = adapter.record.name
    if isinstance(settings, str):
        return dict(rung(settings).get(name, {}))
    check_names(name, settings, adapter.option_names())
    if adapter.settings_object is not None:
        _check_values(name, settings, adapter.settings_object())
    return dict(settings)


def rung(name: str) -> Mapping[str, Options]:
    """The rung of the ladder of that name; SettingsError if there is none."""
    if name not in LADDER:
        raise SettingsError("settings", "", repr(name), " | ".join(LADDER))
    return LADDER[name]


def check_names(solver: str, settings: Mapping[str, object], allowed: Iterable[str]) -> None:
    """Raise SettingsError naming the first key that is not allowed, and its nearest neighbours.

    The libraries behind qpsolvers cannot be trusted with this: several drop what they do not know.
    """
    known = sorted(allowed)
    for key in _flat(settings):
        if key not in known:
            near = difflib.get_close_matches(key, known, n=5, cutoff=0.4) or known
            raise SettingsError(
                f"settings of {solver}", key, "an unknown key", ", ".join(near) or "no settings"
            )


def _flat(settings: Mapping[str, object]) -> Iterable[str]:
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from (f"{key}.{member}" for member in value)
        else:
            yield key


def _check_values(solver: str, settings: Mapping[str, object], target: Any) -> None:
    for key, value in settings.items():
        try:
            setattr(target, key, value)
        except (TypeError, ValueError) as error:
            kind = type(getattr(target, key)).__name__
            raise SettingsError(f"settings of {solver}", key, repr(value), f"a {kind}") from error
