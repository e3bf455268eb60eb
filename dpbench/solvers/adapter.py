"""The adapter of one library, on route native and on route qpsolvers.

A module of `libraries/` that holds an adapter is found by `import_all_adapters`: to write the file
is to register the solver.
"""

import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from inspect import signature
from operator import attrgetter
from typing import Any, NamedTuple

from dpbench.errors import DpbenchError
from dpbench.qp.solution import Status
from dpbench.solvers.contract import Options, Policy, SolverRecord, Workspace
from dpbench.solvers.one_sided import Box

OpenWorkspace = Callable[[SolverRecord, Policy, Options], Workspace]
"""Makes a workspace of a record, a policy and validated options."""


@dataclass(frozen=True)
class NativeAdapter:
    """Means to call a solver library by its own Python interface: facts, constructor, options.

    record : its row in the table, with its abilities on route native.
    workspace : makes a workspace of this record.
    list_options : the names of the library's settings, in a mapping with their defaults; None where
        they are those of `make_settings`, or are unknown and not checked.
    make_settings : a new settings object of the library that takes options as attributes, None
        where it takes them otherwise.
    format_call : writes Python code that calls the library without dpbench, from a policy and
        validated options, as `workspace` does; None where there is none to show.
    """

    record: SolverRecord
    workspace: OpenWorkspace
    list_options: Callable[[], Iterable[str]] | None = None
    make_settings: Callable[[], Any] | None = None
    format_call: Callable[[Policy, Options], str] | None = None


class ClaimedStatus(NamedTuple):
    """Status, iterations, time [ns] and detail that a library reports; -1 and "" for none."""

    status: Status
    iterations: int = -1
    reported_ns: int = -1
    detail: str = ""


Claim = tuple[Status, int, int, str]
"""A `ClaimedStatus`, or a plain tuple of the same where it is made at every step."""
ReadStatus = Callable[[Any, Options], Claim]
NO_REASON = ClaimedStatus(Status.UNKNOWN, detail="not found; qpsolvers does not pass the reason on")


def read_solved_flag_as_claim(answer: Any, options: Options) -> Claim:
    """Return SOLVED or an unknown status from a qpsolvers solution, which says no more."""
    return ClaimedStatus(Status.SOLVED) if answer.found else NO_REASON


InfoReader = Callable[[Any, float, Options], Claim]
"""Reads a claim from a library's `info`, the solve time in its own unit, and the options."""


def make_reader_of_library_info(
    statuses: Mapping[Any, Status],
    unit_ns: float,
    *,
    word: Callable[[Any], str] = lambda info: str(info.status),
    number: Callable[[Any], int] | None = None,
    on_request: bool = False,
) -> InfoReader:
    """Return a function that reads status, iterations and time [ns] from a library's info object.

    statuses : by `word`, or by `number` where there is one; unit_ns : the unit of its times [ns].
    on_request : it times itself only with the option `compute_timings`.
    """

    def read_info(info: Any, took: float, options: Options) -> Claim:
        name = word(info)
        status = statuses.get(name if number is None else number(info), Status.UNKNOWN)
        timed = not on_request or options.get("compute_timings", False)
        return status, int(info.iter), round(took * unit_ns) if timed else -1, name

    return read_info


def make_reader_of_qpsolvers_status(read_info: InfoReader) -> ReadStatus:
    """Return a function that reads status, iterations and time from a qpsolvers solution's info."""

    def read_status(answer: Any, options: Options) -> Claim:
        info = answer.extras["info"]
        return read_info(info, info.run_time, options)

    return read_status


@dataclass(frozen=True)
class QpsolversAdapter:
    """Means to call a solver library through qpsolvers: facts, status reader, option names.

    record : its row in the table, with its abilities on route qpsolvers.
    box : "native" for bounds as bounds, "rows" for rows prepared once because qpsolvers would
        otherwise append an identity matrix at every solve.
    read_status : reads a `qpsolvers.Solution` with extras, given the options of the call.
    list_options, make_settings : as of `NativeAdapter`; the members of a group of settings as
        "group.name".
    qpsolvers_name : its name in qpsolvers where that is not the name of its record.
    fixed : arguments of every call that are not settings of the algorithm.
    not_found : the claim where nothing was found and no reason is given.
    prepare : called once when a workspace is opened.
    iterate_when_not_found : whether x is an iterate then; a vector of zeros is none.
    """

    record: SolverRecord
    box: Box
    read_status: ReadStatus
    list_options: Callable[[], Iterable[str]] | None = None
    make_settings: Callable[[], Any] | None = None
    qpsolvers_name: str = ""
    fixed: Options = field(default_factory=dict)
    not_found: ClaimedStatus = NO_REASON
    prepare: Callable[[], None] | None = None
    iterate_when_not_found: bool = True

    @property
    def qpsolvers_key(self) -> str:
        """The solver's name in the qpsolvers package."""
        return self.qpsolvers_name or self.record.name

    def make_native_adapter(
        self,
        workspace: OpenWorkspace,
        format_call: Callable[[Policy, Options], str] | None = None,
    ) -> NativeAdapter:
        """Return the adapter of this solver's own interface, with the same facts and options."""
        return NativeAdapter(
            self.record, workspace, self.list_options, self.make_settings, format_call
        )

    def read_claim_from_qpsolvers_solution(self, answer: Any, options: Options) -> Claim:
        """Return the status, iterations and time that a `qpsolvers.Solution` reports."""
        if answer.extras:
            return self.read_status(answer, options)
        # qpsolvers itself answers problems without constraints for some libraries.
        return ClaimedStatus(Status.SOLVED) if answer.found else self.not_found


SET_BY_DPBENCH = {
    "verbose": "an option that dpbench sets, as it runs solvers without output",
    "warm_starting": "an option that the policy sets, which `policy` selects, such as 'warm'",
}
"""Options that a user cannot set, with what is reported as found."""


def list_public_settings_attributes(settings: Any) -> list[str]:
    """Return the public, non-callable attributes of a settings object that a user may set."""
    names = (name for name in dir(settings) if not name.startswith("_"))
    return [n for n in names if n not in SET_BY_DPBENCH and not callable(getattr(settings, n))]


def list_keyword_parameters(module: str, name: str, *besides: str) -> dict[str, object]:
    """Return default by name of a library's keyword parameters, except those in `besides`."""
    parameters = signature(attrgetter(name)(import_module(module))).parameters
    return {key: one.default for key, one in parameters.items() if key not in besides}


def import_all_adapters(
    package: str, besides: Iterable[str]
) -> tuple[dict[str, NativeAdapter], dict[str, QpsolversAdapter]]:
    """Import all modules of a package; return its native and qpsolvers interfaces by solver.

    package : its name, while it is being imported; besides : modules without an adapter.
    Raises DpbenchError : a module without an adapter, or two adapters of one name and route.
    """
    native: dict[str, NativeAdapter] = {}
    wrapped: dict[str, QpsolversAdapter] = {}
    for info in pkgutil.iter_modules(import_module(package).__path__):
        if info.name in besides:
            continue
        module = import_module(f"{package}.{info.name}")
        before = len(native) + len(wrapped)
        for value in vars(module).values():
            duplicate = False
            if isinstance(value, NativeAdapter):
                duplicate = native.setdefault(value.record.name, value) is not value
            elif isinstance(value, QpsolversAdapter):
                duplicate = wrapped.setdefault(value.record.name, value) is not value
            if duplicate:
                raise DpbenchError(
                    f"{module.__name__}: solver {value.record.name} is defined twice"
                )
        if len(native) + len(wrapped) == before:
            raise DpbenchError(f"{module.__name__} has no adapter")
    return native, wrapped
