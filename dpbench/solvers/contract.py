"""The contract of every solver: the workspace it is driven through, and the record of its facts.

    setup(qp)      prepare the problem; the only call that may be slow
    update(step)   hand over what changed
    solve()        the solver's work, and nothing else
    read()         copy the answer out, map signs and status

The time of each call is measured, so each must do its own duty only. A workspace turns the
library's failures into a `Status`; it raises only for a person's mistake.

The harness hands over arrays for this workspace alone. The vectors of a step never change later;
where every step is set up, the matrices come in the same memory each time, restored before.

Tables, legends, tolerance levels, conformance tests and deployability are read from the record. No
field has a default that would hide a forgotten one: what is not known is `UNKNOWN_FACT`.
"""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from shlex import quote
from typing import Literal

from dpbench.arrays import Vector
from dpbench.errors import DpbenchError, ShapeError, SituationError
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from dpbench.qp.solution import Solution, Status

Route = Literal["qpsolvers", "native"]
Policy = Literal["fresh", "reuse", "warm"]
Options = Mapping[str, object]
Settings = str | Options
Form = Literal["dense", "csc"]


class Workspace(ABC):
    """Interface that every QP solver implements: set up, update, solve, read, for QPs of one shape.

    Attributes
    ----------
    form : the form of the library's matrices.
    setup_every_step : the harness calls `setup` with the whole problem at every step instead of
        `update` (policy fresh on route native).
    matrix_updates : updates so far that brought new P, A, lb or ub.
    reopen : makes another workspace of the same solver, route, policy and settings.
    requested_settings : those it was opened with.

    Examples
    --------
    >>> import numpy as np
    >>> from dpbench import QuadraticProgram, open_workspace
    >>> workspace = open_workspace("quadprog", route="native")
    >>> workspace
    <Workspace of quadprog (native, fresh)>
    >>> none = np.zeros((0, 1)), np.zeros(0), np.zeros(0)
    >>> workspace.setup(QuadraticProgram(np.eye(1), [-2.0], *none, [-9.0], [1.0]))
    >>> workspace.solve()
    >>> workspace.read().z
    array([1.])
    """

    setup_every_step: bool = False
    matrix_updates: int = 0
    form: Form = "dense"
    reopen: "Callable[[], Workspace] | None" = None
    requested_settings: Settings = "default"

    def __init__(self, solver: str, route: Route, policy: Policy) -> None:
        self.solver, self.route, self.policy = solver, route, policy

    def __repr__(self) -> str:
        settings = self.requested_settings
        if isinstance(settings, Mapping):
            settings = ", ".join(f"{key}={value!r}" for key, value in settings.items())
        shown = "" if settings in ("", DEFAULT) else f", {settings}"
        return f"<Workspace of {self.solver} ({self.route}, {self.policy}{shown})>"

    @abstractmethod
    def setup(self, qp: QuadraticProgram) -> None:
        """Store and prepare the whole problem `qp`, so that the next `solve` solves it.

        Examples
        --------
        >>> from dpbench import QuadraticProgram, open_workspace
        >>> workspace = open_workspace("daqp", route="native", policy="warm")
        >>> workspace.setup(QuadraticProgram([[1.0]], [-2.0], lb=[-9.0], ub=[1.0]))
        """

    @abstractmethod
    def update(self, step: QPStep) -> None:
        """Store the vectors and matrices of the next QP; ShapeError on wrong shapes.

        Examples
        --------
        >>> import numpy as np
        >>> from dpbench import QuadraticProgram, open_workspace
        >>> workspace = open_workspace("daqp", route="native", policy="warm")
        >>> workspace.setup(QuadraticProgram([[1.0]], [-2.0], [[1.0]], [-9.0], [1.0]))
        >>> workspace.update(QPStep(q=np.array([3.0]), l=np.array([-9.0]), u=np.array([1.0])))
        >>> workspace.solve()
        >>> workspace.read().z
        array([-3.])
        """

    @abstractmethod
    def solve(self) -> None:
        """Solve the current QP and store the answer; a library's failure becomes a status.

        Examples
        --------
        >>> from dpbench import QuadraticProgram, open_workspace
        >>> workspace = open_workspace("daqp", route="native", policy="warm")
        >>> workspace.setup(QuadraticProgram([[1.0]], [-2.0], lb=[-9.0], ub=[1.0]))
        >>> workspace.solve()
        >>> workspace.read().z
        array([1.])
        """

    @abstractmethod
    def read(self) -> Solution:
        """Return a copy of the answer: status, solution z and multipliers.

        Examples
        --------
        >>> from dpbench import QuadraticProgram, open_workspace
        >>> workspace = open_workspace("daqp", route="native", policy="warm")
        >>> workspace.setup(QuadraticProgram([[1.0]], [-2.0], lb=[-9.0], ub=[1.0]))
        >>> workspace.solve()
        >>> workspace.read().status
        <Status.SOLVED: 0>
        """

    def open_again_with_equal_settings(self) -> "Workspace":
        """Return the same solver, opened with equal settings; SituationError unless by name.

        Examples
        --------
        >>> from dpbench import open_workspace
        >>> workspace = open_workspace("daqp", route="native", policy="warm")
        >>> workspace.open_again_with_equal_settings()
        <Workspace of daqp (native, warm)>
        """
        if self.reopen is None:
            sentence = "a cascade needs two workspaces; open this solver with open_workspace"
            raise SituationError(f"solver {self.solver}", sentence)
        return self.reopen()

    def reset(self) -> None:  # noqa: B027 - a workspace without memory has nothing to forget
        """Discard earlier answers and warm-start data, after a step that was not solved.

        Examples
        --------
        >>> from dpbench import QuadraticProgram, open_workspace
        >>> workspace = open_workspace("daqp", route="native", policy="warm")
        >>> workspace.setup(QuadraticProgram([[1.0]], [-2.0], lb=[-9.0], ub=[1.0]))
        >>> workspace.reset()
        >>> workspace.solve()
        >>> workspace.read().z
        array([1.])
        """


def check_step(step: QPStep, n: int, m: int) -> None:
    """Raise ShapeError unless a step's arrays fit a QP of n variables and m rows."""
    rows = (m,)
    fits = step.q.shape == (n,) and step.l.shape == rows and step.u.shape == rows
    if fits and step.refresh is Refresh.VECTORS:
        return
    expected = {"q": (n,), "l": (m,), "u": (m,), "P": (n, n), "A": (m, n), "lb": (n,), "ub": (n,)}
    for name, shape in expected.items():
        array = getattr(step, name)
        if array is not None and array.shape != shape:
            raise ShapeError.from_shapes("QPStep", name, array.shape, f"shape {shape}")


def describe_exception_unless_interrupt(error: BaseException) -> str:
    """Return class and message of a solver library's exception as text; re-raise an interrupt."""
    if isinstance(error, (KeyboardInterrupt, SystemExit)):
        raise error
    return f"{type(error).__name__}: {error}"


def make_error_for_missing_setup(call: str) -> DpbenchError:
    """Return the error for calling a solver's method before its set-up."""
    return DpbenchError(f"{call} before setup: call setup with the whole problem first")


def shift_into(target: Vector, source: Vector, block: int) -> None:
    """Write a vector to `target`, shifted by one control increment; the last block is zero."""
    if block == 0:
        target[:] = source
    elif target.size:
        target[:-block] = source[block:]
        target[-block:] = 0.0


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
"""Kind of method; "harness" is none, "not stated" that of a plug-in without one."""
Levels = Mapping[str, Options]
"""The options of each name of settings; a tolerance level that is missing sets nothing."""

POLICIES: Mapping[Policy, str] = {
    "fresh": "set up from nothing at each step",
    "reuse": "factorisation and memory kept, start reset",
    "warm": "previous answer kept as start",
}
# Why a policy is missing, where a record does not say more.
NOT_OFFERED = "not offered"
REFUSED_BY_QPSOLVERS: Mapping[Policy, str] = {
    "reuse": "qpsolvers sets the library up again at every solve, so nothing can be reused",
    "warm": "the solver ignores a start passed by qpsolvers, so warm cannot differ from fresh",
}

# Faults several libraries share. A NaN compares false with everything.
NAN_IGNORED = {"solved despite a nan in u": "a NaN limit is never violated, so it limits nothing"}
NAN_FAULTS = {
    "solved despite a nan in q": "a NaN in q passes its tests of convergence",
    **NAN_IGNORED,
}

# What a known failure of some libraries is.
INFEASIBLE_CALLED_ERROR = "it answers infeasible QPs so"

DEFAULT, MID, HIGH = "default", "mid", "high"
TOLERANCES = {"low": 1e-3, MID: 1e-6, HIGH: 1e-9}
LEVELS = (DEFAULT, *TOLERANCES)
"""The tolerance levels: the library's own choice, then those of `TOLERANCES`."""


def make_tolerance_presets(
    *criteria: str, always: Options | None = None, **constant: object
) -> Levels:
    """Return option presets default, low, mid and high, from the names of tolerance options.

    criteria : options that are the tolerance at the levels of `TOLERANCES`.
    always : options of every level, and of a person's own settings.
    constant : further options of the levels of `TOLERANCES`.
    """
    always = always or {}
    return {DEFAULT: always} | {
        name: {**always, **dict.fromkeys(criteria, eps), **constant}
        for name, eps in TOLERANCES.items()
    }


@dataclass(frozen=True)
class Build:
    """Build of a solver library: its instruction set, "" if unknown.

    `generic`: it has kernels for vector instructions, and this build has none.
    """

    text: str = ""
    generic: bool = False


BUILDS = {"_avx512": "AVX-512", "_avx2": "AVX2", "": "no AVX"}
"""Instruction sets by the end of a module's name."""


def find_instruction_set_of_library(module: str) -> Build:
    """Return the CPU instruction set that the loaded library `module` was compiled for."""
    built = (text for end, text in BUILDS.items() if sys.modules.get(f"{module}{end}") is not None)
    return Build(next(built, ""))


UNKNOWN_FACT = "not stated", ""


@dataclass(frozen=True)
class Fact:
    """A fact about a solver's project and its source, such as a licence and the file stating it."""

    value: str
    source: str


@dataclass(frozen=True)
class CSettings:
    """Name of a solver's C settings structure and of the C function that fills its defaults.

    list_policy_options : the settings that a policy of route native sets besides the options.
    warm_start : the C function that takes the starting point of policy warm; "" where not known.
    """

    struct: str
    defaults: str
    source: str
    list_policy_options: Callable[[Policy], Options] = field(default=lambda _: {}, kw_only=True)
    warm_start: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class Project:
    """Facts on embedding a solver: licence, language, C code, memory allocation, single precision.

    licence, language : of the solver itself, not of its Python interface.
    c_code : whether it generates C code for a problem, or is C code one can embed.
    allocation_free : whether a solve after set-up allocates no memory.
    single_precision : whether it can be built in single precision.
    c_settings : None where the options have other names in C.
    """

    licence: Fact
    language: Fact
    c_code: Fact
    allocation_free: Fact
    single_precision: Fact
    c_settings: CSettings | None = field(default=None, kw_only=True)


def make_project_facts(
    *,
    licence: tuple[str, str] | None,
    language: tuple[str, str] | None,
    c_code: tuple[str, str] | None = None,
    allocation_free: tuple[str, str] | None = None,
    single_precision: tuple[str, str] | None = None,
    c_settings: CSettings | None = None,
) -> Project:
    """Return the facts on embedding a solver, from pairs (value, source), None where unknown."""
    facts = (licence, language, c_code, allocation_free, single_precision)
    return Project(*(Fact(*(fact or UNKNOWN_FACT)) for fact in facts), c_settings=c_settings)


NO_PROJECT_FACTS = make_project_facts(licence=None, language=None)


@dataclass(frozen=True)
class RouteRecord:
    """Abilities of a solver through one interface: ways of starting, updates, known faults.

    policies : those it runs; `refused` : the reasons for missing ones, where there is one to give.
    updates : what the library takes over without a new set-up.
    start : what a warm start consists of.
    keeps : what a kept workspace carries into the next solve beside factors, memory and a start;
        "" for nothing that would change an answer by more than rounding.
    two_sided : whether l ≤ A z ≤ u reaches the library as such.
    gives_multipliers : whether y and y_box come back.
    detects_infeasibility : whether an infeasible problem is reported as such, and not only as
        "no answer".
    faults : known faults, by the name of their conformance test, which fails without them.
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


@dataclass(frozen=True)
class Range:
    """Allowed values of a numeric option, in words and as a test."""

    text: str
    contains: Callable[[float], bool]


ABOVE_ZERO = Range("above 0", lambda value: value > 0)
ZERO_OR_MORE = Range("0 or more", lambda value: value >= 0)


@dataclass(frozen=True, kw_only=True)
class SolverRecord:
    """All facts about one solver: method, package, interfaces, option presets, project.

    method : the algorithm in a line.
    distribution, module : of `pip install` and `import`; "" for dpbench's own.
    extra : the part of dpbench's dependencies that installs it; "own", "plugin" and "qpsolvers" are
        none.
    form : the form of its matrices, its own fastest.
    routes : the first is the default.
    levels : see `make_tolerance_presets`; {} without a tolerance to set.
    needs_strict_convexity : whether P has to be positive definite.
    needs_modules : further libraries that it imports, which isolation must not hide.
    build : reads how the installed library was built, where that decides its speed.
    time_limit : its option that ends a solve after so many seconds; "" without one.
    iteration_limit : its option that ends a solve after so many iterations with the last iterate,
        "" without one; limits_outer_iterations : whether that counts the outer ones alone.
    adapted : options that are only the first value of what the solver adapts while another option
        is on, by that other option's name.
    ranges : options whose range the library checks only in its set-up, where it names no option;
        one_above_zero : options of which it needs at least one above 0.
    known_failures : what is known of failing steps by the status reported, SOLVED for claims that
        do not hold; shown where such a step is.
    keeps_answers : whether it keeps what it found for a QP it may meet again; unknown of a plug-in.
    choose_instead : a solver of the same code that is never the worse choice; "" for none. Suites
        may leave out what has one.
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
    build: Callable[[], Build] = Build
    time_limit: str = ""
    iteration_limit: str = ""
    limits_outer_iterations: bool = False
    adapted: Mapping[str, str] = field(default_factory=dict)
    ranges: Mapping[str, Range] = field(default_factory=dict)
    one_above_zero: tuple[str, ...] = ()
    known_failures: Mapping[Status, str] = field(default_factory=dict)
    keeps_answers: bool = False
    choose_instead: str = ""

    @property
    def default_route(self) -> Route:
        """Default interface to the solver's library, native or qpsolvers: the first listed."""
        return next(iter(self.routes))

    @property
    def policies_by_route(self) -> dict[Route, tuple[Policy, ...]]:
        """Ways of starting each solve (fresh, reuse, warm) offered, by interface to the library."""
        return {route: can.policies for route, can in self.routes.items()}

    @property
    def install_command(self) -> str:
        """Shell command that installs the solver, or where to look for one."""
        # Not through an extra of dpbench: the package index knows another project by that name.
        if self.distribution:
            return f"pip install {quote(self.distribution)}"
        return "see the documentation of qpsolvers"

    @property
    def reason_not_deployable(self) -> str:
        """Reason why the solver cannot run on a ship's controller; "" if it can.

        Compiled code whose language the project documents is deployable.
        """
        language = self.project.language
        if not language.source:
            return "its language is not stated"
        return f"written in {language.value}" if language.value.startswith("Python") else ""

    def get_route_record(self, route: Route) -> RouteRecord:
        """Return what the solver can do through an interface; KeyError if it does not have it."""
        return self.routes[route]

    def state_why_policy_is_unavailable(self, route: Route, policy: Policy) -> str:
        """Return why an interface lacks a way of starting each solve; "" if it offers it."""
        can = self.routes[route]
        if policy in can.policies:
            return ""
        usual = REFUSED_BY_QPSOLVERS if route == "qpsolvers" else {}
        return can.refused.get(policy) or usual.get(policy, NOT_OFFERED)
