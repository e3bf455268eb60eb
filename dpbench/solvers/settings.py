"""The tolerance levels: one place that says what each name means for each solver.

`default` is the library's own choice; `low`, `mid` and `high` ask for 1e-3, 1e-6 and 1e-9 absolute,
relative criteria off (or at the same number where the library needs them positive), criteria on
the duality gap on, and iteration limits high enough to get there. A solver without an entry has no
tolerance to set. The names mean the same on both routes.

OSQP's polishing is a second algorithm whose failures are silent, so it has names of its own:
`default_polished` and `high_polished`.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

from dpbench.errors import SettingsError
from dpbench.solvers.contract import Options, Settings
from dpbench.solvers.plugins import find_plugin
from dpbench.solvers.record import SolverRecord

DEFAULT, LOW, MID, HIGH = "default", "low", "mid", "high"
TOLERANCES = {LOW: 1e-3, MID: 1e-6, HIGH: 1e-9}


def _coneqp(tolerance: float) -> Options:
    return {"abstol": tolerance, "reltol": tolerance, "feastol": tolerance, "maxiters": 200}


def _hpipm(tolerance: float) -> Options:
    return {
        "tol_stat": tolerance,
        "tol_eq": tolerance,
        "tol_ineq": tolerance,
        "tol_comp": tolerance,
        "iter_max": 200,
    }


def _piqp(tolerance: float) -> Options:
    return {**_proxqp(tolerance), "max_iter": 1000}


def _proxqp(tolerance: float) -> Options:
    return {
        "eps_abs": tolerance,
        "eps_rel": 0.0,
        "check_duality_gap": True,
        "eps_duality_gap_abs": tolerance,
        "eps_duality_gap_rel": 0.0,
    }


def _level(tolerance: float) -> dict[str, Options]:
    """What a tolerance means for each solver."""
    first_order: Options = {"eps_abs": tolerance, "eps_rel": 0.0}
    return {
        "clarabel": {
            "tol_gap_abs": tolerance,
            "tol_gap_rel": tolerance,
            "tol_feas": tolerance,
            "max_iter": 500,
        },
        "cvxopt": _coneqp(tolerance),
        # dual_tol stays at DAQP's own 1e-12, which is tighter.
        # A semidefinite P it solves by proximal steps, which end by a tolerance of their own.
        "daqp": {"primal_tol": tolerance, "eta_prox": tolerance},
        "ecos": {"abstol": tolerance, "reltol": tolerance, "feastol": tolerance, "max_iters": 500},
        # Sweeps are cheap, and there are problems that take tens of thousands.
        "hildreth": {"eps_row": tolerance, "max_iter": 1_000_000},
        "highs": {
            "primal_feasibility_tolerance": tolerance,
            "dual_feasibility_tolerance": tolerance,
            "qp_regularization_value": 0.0,
        },
        "hpipm": _hpipm(tolerance),
        "hpipm_ocp": _hpipm(tolerance),
        "jaxopt": {"tol": tolerance, "maxiter": 100_000},
        "kvxopt": _coneqp(tolerance),
        "osqp": {**first_order, "max_iter": 200_000},
        "piqp": _piqp(tolerance),
        "piqp_multistage": _piqp(tolerance),
        "piqp_sparse": _piqp(tolerance),
        "proxqp": _proxqp(tolerance),
        "proxqp_sparse": _proxqp(tolerance),
        "qoco": {"abstol": tolerance, "reltol": tolerance, "max_iters": 500},
        "qpalm": {**first_order, "max_iter": 100_000},
        # qpax 0.1.4 stalls short of 1e-7 in its own measure: exact answers that it does not claim.
        "qpax": {"solver_tol": tolerance, "max_iter": 100},
        "qtqp": {
            "tol_feas": tolerance,
            "tol_gap_abs": tolerance,
            "tol_gap_rel": tolerance,
            "max_iter": 500,
        },
        "scs": {**first_order, "max_iters": 1_000_000},
        "sip": first_order,
    }


# OSQP 1.x adapts ρ every so many iterations by default, as others did by the clock: said aloud.
# HPIPM's dense solver meets equalities by a Schur complement by default, which takes a positive
# definite cost; by the null space (0) it takes any convex one.
FAIR: Mapping[str, Options] = {
    "hpipm": {"kkt_fact_alg": 0},
    "osqp": {"adaptive_rho": 1, "adaptive_rho_interval": 50},
}


def _fair(level_options: Mapping[str, Options]) -> dict[str, Options]:
    return {
        **level_options,
        **{name: {**keys, **level_options.get(name, {})} for name, keys in FAIR.items()},
    }


LEVELS: Mapping[str, Mapping[str, Options]] = {
    DEFAULT: _fair({}),
    **{name: _fair(_level(tolerance)) for name, tolerance in TOLERANCES.items()},
}
_POLISH: Options = {"polishing": True}
VARIANTS: Mapping[str, Mapping[str, Options]] = {
    "osqp": {f"{name}_polished": {**LEVELS[name]["osqp"], **_POLISH} for name in (DEFAULT, HIGH)},
}
"""Further names that one solver has beside the tolerance levels."""


class Configurable(Protocol):
    """What is asked of an adapter about its settings."""

    @property
    def record(self) -> SolverRecord: ...

    @property
    def option_names(self) -> Callable[[], Iterable[str]] | None: ...

    @property
    def settings_object(self) -> Callable[[], Any] | None: ...


def settings_matter(solver: str) -> bool:
    """Whether the tolerance levels differ for this solver."""
    return any(level_options(name, solver) != level_options(DEFAULT, solver) for name in LEVELS)


def resolve(settings: Settings, adapter: Configurable) -> Options:
    """The keyword arguments that `settings` means for a library.

    Raises
    ------
    SettingsError : for a name that is no tolerance level, a key the library does not have, or a
        value that its settings object refuses.
    """
    name = adapter.record.name
    if isinstance(settings, str):
        return dict(level_options(settings, name))
    if adapter.option_names is not None:
        check_names(name, settings, adapter.option_names())
    if adapter.settings_object is not None:
        _check_values(name, settings, adapter.settings_object())
    return {**FAIR.get(name, {}), **settings}


def setting_names(solver: str) -> tuple[str, ...]:
    """The names of settings of a solver: the tolerance levels and its variants."""
    return *LEVELS, *VARIANTS.get(solver, {})


def level_options(name: str, solver: str) -> Options:
    """What the setting of that name means for a solver; SettingsError if there is none."""
    if name in LEVELS:
        if solver in LEVELS[name]:
            return LEVELS[name][solver]
        plugin = find_plugin(solver)
        return {} if plugin is None else plugin.levels.get(name, {})
    variants = VARIANTS.get(solver, {})
    if name not in variants:
        allowed = " | ".join(setting_names(solver))
        raise SettingsError(f"settings of {solver}", "", repr(name), allowed)
    return variants[name]


def describe_levels(solver: str) -> str:
    """One line per name of its settings: what it sets, "the library's defaults" for nothing."""
    lines = []
    for name in setting_names(solver):
        keys = ", ".join(f"{key}={value!r}" for key, value in level_options(name, solver).items())
        lines.append(f"{name}: {keys or _nothing(name, solver)}")
    return "\n".join(lines)


def _nothing(name: str, solver: str) -> str:
    if settings_matter(solver) or name == DEFAULT:
        return "the library's defaults"
    return "as default: it has no tolerance to set"


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
