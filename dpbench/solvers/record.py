"""The record of one solver: all that dpbench says about it, in one place.

Its row in every table, its colour and place in a legend, its tolerance levels, the conformance
tests and why it may not go aboard are read from here. Nothing has a default that would hide what
was forgotten: what is not known is said to be `UNSTATED`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from dpbench.solvers.contract import Form, Options, Policy, Route

Start = Literal["none", "primal", "dual", "primal and dual", "active set"]
Updates = Literal["nothing", "vectors", "vectors and matrices"]
Extra = Literal["core", "solvers", "jax", "casadi", "own", "plugin", "qpsolvers"]
Family = Literal[
    "active set",
    "interior point",
    "first order",
    "augmented Lagrangian",
    "baseline law",
    "harness",
    "not stated",
]
"""What kind of method it is; "harness" is none, "not stated" a plug-in whose author is silent."""
Levels = Mapping[str, Options]
"""The options that each name of settings means; a tolerance level that is missing sets nothing."""

POLICIES: Mapping[Policy, str] = {
    "fresh": "set up from nothing at each step",
    "reuse": "factorisation and memory kept, start reset",
    "warm": "previous answer kept as start",
}
# Why a policy is missing, where a record does not say more.
NOT_OFFERED = "not offered"
REFUSED_BY_QPSOLVERS: Mapping[Policy, str] = {
    "reuse": "qpsolvers sets the library up anew at every solve, so nothing can be reused",
    "warm": "it ignores a start handed over by qpsolvers, so it cannot differ from fresh",
}

# Faults several libraries share. A NaN compares false with everything.
NAN_IGNORED = {"solved despite a nan in u": "a NaN limit is never violated, so it limits nothing"}
NAN_FAULTS = {
    "solved despite a nan in q": "a NaN in q passes its tests of convergence",
    **NAN_IGNORED,
}

DEFAULT, MID, HIGH = "default", "mid", "high"
TOLERANCES = {"low": 1e-3, MID: 1e-6, HIGH: 1e-9}
LEVELS = (DEFAULT, *TOLERANCES)
"""The tolerance levels: the library's own choice, then those of `TOLERANCES`."""


def by_tolerance(*criteria: str, always: Options | None = None, **beside: object) -> Levels:
    """Make the levels of a solver: at those of `TOLERANCES` its criteria are the tolerance.

    Parameters
    ----------
    criteria : options that become the tolerance; relative ones where it needs them positive.
    always : options of every level, and of a person's own settings.
    beside : options of the three levels that are the same for each: relative criteria off, those
        on the duality gap on, iteration limits high enough to get there.
    """
    always = always or {}
    asked = {k: {**dict.fromkeys(criteria, eps), **beside} for k, eps in TOLERANCES.items()}
    return {DEFAULT: always} | {name: {**always, **options} for name, options in asked.items()}


@dataclass(frozen=True)
class Build:
    """How the library that is installed was built, as read from it.

    Parameters
    ----------
    text : in a few words; "" where nothing can be read from it.
    generic : it has kernels for the vector instructions of processors, and this build has none.
    """

    text: str = ""
    generic: bool = False


UNREAD = Build()
BUILDS = {"_avx512": "AVX-512", "_avx2": "AVX2", "": "no AVX"}
"""What the end of a module's name says it was compiled for."""


def vectorised_build(module: str) -> Build:
    """Read the build that an imported library chose; it is never less than the processor has.

    Parameters
    ----------
    module : the name its compiled modules share, without what they were compiled for.
    """
    built = (text for end, text in BUILDS.items() if sys.modules.get(f"{module}{end}") is not None)
    return Build(next(built, ""))


def unread() -> Build:
    """Nothing is known of the build."""
    return UNREAD


UNSTATED = "not stated", ""


@dataclass(frozen=True)
class Fact:
    """A statement and where the project makes it, in words; no source, no statement."""

    value: str
    source: str


@dataclass(frozen=True)
class CSettings:
    """The structure of a C library whose fields have the names of the options.

    Parameters
    ----------
    struct : its type; `defaults` : the function that fills one, given its address.
    source : where the library says so.
    """

    struct: str
    defaults: str
    source: str


@dataclass(frozen=True)
class Project:
    """What a controller's author asks about a solver, as its own documentation answers it.

    Parameters
    ----------
    licence, language : of the solver itself, not of its Python interface.
    c_code : whether it generates C code for a problem, or is C code one can embed.
    allocation_free : whether a solve after set-up allocates no memory.
    single_precision : whether it can be built in single precision.
    c_settings : how its options are set in C; None where they have other names there.
    """

    licence: Fact
    language: Fact
    c_code: Fact
    allocation_free: Fact
    single_precision: Fact
    c_settings: CSettings | None = field(default=None, kw_only=True)


def stated(
    *,
    licence: tuple[str, str] | None,
    language: tuple[str, str] | None,
    c_code: tuple[str, str] | None = None,
    allocation_free: tuple[str, str] | None = None,
    single_precision: tuple[str, str] | None = None,
    c_settings: CSettings | None = None,
) -> Project:
    """Record what a project states, each with the place.

    None where it does not, as far as is known here: nothing is inferred.
    """
    facts = (licence, language, c_code, allocation_free, single_precision)
    return Project(*(Fact(*(fact or UNSTATED)) for fact in facts), c_settings=c_settings)


NOT_STATED = stated(licence=None, language=None)


@dataclass(frozen=True)
class RouteRecord:
    """What a solver can do on one route.

    Parameters
    ----------
    policies : those it runs; `refused` says why a missing one is missing, where there is more to
        say than that.
    updates : what the library takes over without being set up anew.
    start : what a warm start is made of.
    keeps : what a kept workspace carries into the next solve beside factors, memory and a start;
        "" for nothing that would change an answer by more than rounding.
    two_sided : whether l ≤ A z ≤ u reaches the library as such.
    gives_multipliers : whether y and y_box come back.
    detects_infeasibility : whether an infeasible problem is reported as such, and not only as
        "no answer".
    faults : known faulty behaviour, by the name of the conformance test that shows it; the test
        fails when the fault disappears.
    """

    policies: tuple[Policy, ...]
    updates: Updates = "nothing"
    start: Start = "none"
    keeps: str = ""
    two_sided: bool = False
    gives_multipliers: bool = True
    detects_infeasibility: bool = True
    refused: Mapping[Policy, str] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SolverRecord:
    """One row of the table of solvers.

    Parameters
    ----------
    name : its name in dpbench.
    family, method : the kind of method, and the algorithm in a line.
    distribution, module : what `pip` installs and what Python imports; "" for dpbench's own.
    extra : which part of dpbench's dependencies brings it; "own" needs nothing, "plugin" and
        "qpsolvers" are none of dpbench's business.
    form : the form its matrices are kept in, its own fastest.
    routes : what it can do on each route; the first is the default.
    levels : what each name of settings means, see `by_tolerance`; {} without a tolerance to set.
    project : what its own documentation says to a controller's author.
    needs_strict_convexity : whether P has to be positive definite.
    needs_modules : further libraries that it imports, which isolation must not hide.
    build : reads from the installed library how it was built, where that can be read and decides
        how fast it is.
    time_limit : its option that ends a solve after so many seconds; "" without one.
    """

    name: str
    family: Family
    method: str
    distribution: str
    module: str
    extra: Extra
    form: Form
    routes: Mapping[Route, RouteRecord]
    levels: Levels
    project: Project
    needs_strict_convexity: bool = False
    needs_modules: tuple[str, ...] = ()
    build: Callable[[], Build] = unread
    time_limit: str = ""

    @property
    def default_route(self) -> Route:
        """The route taken when none is asked for."""
        return next(iter(self.routes))

    @property
    def policies(self) -> dict[Route, tuple[Policy, ...]]:
        """The policies of each route."""
        return {route: can.policies for route, can in self.routes.items()}

    @property
    def remedy(self) -> str:
        """The command that installs it."""
        # Not through an extra of dpbench: the package index knows another project by that name.
        return f"pip install {self.distribution}" if self.distribution else "install it"

    @property
    def deployment_blocker(self) -> str:
        """Why it cannot be deployed on a ship as it is; "" where it can.

        Deployable is a project's own compiled code, whose language its documentation states.
        """
        language = self.project.language
        if self.extra == "own":
            return f"own code of this benchmark ({language.value})"
        if not language.source:
            return "its language is not stated"
        return f"written in {language.value}" if language.value.startswith("Python") else ""

    def on(self, route: Route) -> RouteRecord:
        """Return what it can do on a route it has; KeyError on one it does not have."""
        return self.routes[route]

    def refusal(self, route: Route, policy: Policy) -> str:
        """Why a route it has does not run a policy; "" where it does."""
        can = self.routes[route]
        if policy in can.policies:
            return ""
        usual = REFUSED_BY_QPSOLVERS if route == "qpsolvers" else {}
        return can.refused.get(policy) or usual.get(policy, NOT_OFFERED)
