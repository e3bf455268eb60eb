"""The record of one solver: what it is, in which form it gets its matrices, what it can do.

What a library can do depends on the way it is reached, so each route has a record of its own; the
conformance tests are generated from them and the report prints them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from dpbench.solvers.contract import Policy, Route

Form = Literal["dense", "csc"]
Box = Literal["native", "rows"]
Start = Literal["none", "primal", "dual", "primal and dual", "active set"]
Updates = Literal["nothing", "vectors", "vectors and matrices"]
Extra = Literal["core", "solvers", "jax", "casadi", "own", "plugin", "qpsolvers"]

# Faults several libraries share. A NaN compares false with everything.
NAN_ANSWER = {"solved despite a nan in q": "a NaN in q passes its tests of convergence"}
NAN_IGNORED = {"solved despite a nan in u": "a NaN limit is never violated, so it limits nothing"}


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
    """The build that an imported library chose; it is never less than the processor has.

    Parameters
    ----------
    module : the name its compiled modules share, without what they were compiled for.
    """
    found = (text for end, text in BUILDS.items() if sys.modules.get(f"{module}{end}") is not None)
    return Build(next(found, ""))


def _unread() -> Build:
    return UNREAD


@dataclass(frozen=True)
class Fact:
    """A statement and where the project makes it, in words; no source, no statement."""

    value: str = "not stated"
    source: str = ""


@dataclass(frozen=True)
class Project:
    """Facts about a solver's project.

    Parameters
    ----------
    licence, language : of the solver itself, not of its Python interface.
    c_code : whether it generates C code for a problem, or is C code one can embed.
    allocation_free : whether a solve after set-up allocates no memory.
    single_precision : whether it can be built in single precision.
    """

    licence: Fact = Fact()
    language: Fact = Fact()
    c_code: Fact = Fact()
    allocation_free: Fact = Fact()
    single_precision: Fact = Fact()


NOT_STATED = Project()


@dataclass(frozen=True)
class RouteRecord:
    """What a solver can do on one route.

    Parameters
    ----------
    policies : those it runs; `refused` says why a missing one is missing.
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
    updates: Updates = "vectors"
    start: Start = "none"
    keeps: str = ""
    two_sided: bool = False
    gives_multipliers: bool = True
    detects_infeasibility: bool = True
    refused: Mapping[Policy, str] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class SolverRecord:
    """One row of the table of solvers.

    Parameters
    ----------
    name : its name in dpbench; `qpsolvers_name` where qpsolvers calls it otherwise.
    distribution, module : what `pip` installs and what Python imports; "" for dpbench's own.
    method : the algorithm, in a line.
    extra : which part of dpbench's dependencies brings it; "own" needs nothing, "plugin" and
        "qpsolvers" are none of dpbench's business.
    form : the form its matrices are kept in, its own fastest.
    box : on route qpsolvers, whether bounds reach it as bounds, or as rows prepared once because
        qpsolvers would otherwise append an identity matrix at every solve.
    policies : the policies of each route; the first route is the default.
    refused : why a policy of a route is not there, where there is more to say than that.
    start, gives_multipliers, detects_infeasibility : as in `RouteRecord`, of the default route.
    needs_strict_convexity : whether P has to be positive definite.
    native : what it can do on route native, where qpsolvers is its default route.
    updates, two_sided, faults : as in `RouteRecord`, of the default route.
    project : what its own documentation says to a controller's author.
    build : reads from the installed library how it was built, where that can be read and decides
        how fast it is.
    """

    name: str
    distribution: str
    module: str
    method: str
    extra: Extra
    form: Form
    box: Box
    policies: Mapping[Route, tuple[Policy, ...]]
    start: Start = "none"
    needs_strict_convexity: bool = False
    gives_multipliers: bool = True
    detects_infeasibility: bool = True
    qpsolvers_name: str = ""
    refused: Mapping[tuple[Route, Policy], str] = field(default_factory=dict)
    native: RouteRecord | None = None
    updates: Updates = "nothing"
    two_sided: bool = False
    faults: Mapping[str, str] = field(default_factory=dict)
    project: Project = NOT_STATED
    build: Callable[[], Build] = _unread

    @property
    def default_route(self) -> Route:
        """The route taken when none is asked for."""
        return next(iter(self.policies))

    @property
    def remedy(self) -> str:
        """The command that installs it."""
        # Not through an extra of dpbench: the package index knows another project by that name.
        return f"pip install {self.distribution}" if self.distribution else "install it"

    @property
    def why_not_aboard(self) -> str:
        """Why it cannot be deployed on a ship as it is; "" where it can: a project's own compiled
        code, whose language its documentation states."""
        language = self.project.language
        if self.extra == "own":
            return f"own code of this benchmark ({language.value})"
        if not language.source:
            return "its language is not stated"
        return f"written in {language.value}" if language.value.startswith("Python") else ""

    def on(self, route: Route) -> RouteRecord:
        """What it can do on a route it has; KeyError on one it does not have."""
        if route == "native" and self.native is not None:
            return self.native
        return RouteRecord(
            policies=self.policies[route],
            updates=self.updates,
            start=self.start,
            two_sided=self.two_sided,
            gives_multipliers=self.gives_multipliers,
            detects_infeasibility=self.detects_infeasibility,
            refused={p: why for (r, p), why in self.refused.items() if r == route},
            faults=self.faults,
        )

    def with_native(self, native: RouteRecord) -> SolverRecord:
        """The same solver, reached through its own interface as well."""
        refused: dict[tuple[Route, Policy], str] = dict(self.refused)
        refused.update({("native", policy): why for policy, why in native.refused.items()})
        policies: dict[Route, tuple[Policy, ...]] = dict(self.policies)
        policies["native"] = native.policies
        return replace(self, policies=policies, refused=refused, native=native)
