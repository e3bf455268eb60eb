"""What the adapter of one library consists of, on route native and on route qpsolvers.

Behind qpsolvers it is data and two small functions; the workspace that drives it is common to all.
A module of `libraries/` that holds an adapter is found by `adapters_in`: to write the file is to
register the solver.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple

from dpbench.errors import DpbenchError
from dpbench.qp.solution import Status
from dpbench.solvers.contract import Options, Policy, Workspace
from dpbench.solvers.one_sided import Box
from dpbench.solvers.record import SolverRecord

Opened = Callable[[SolverRecord, Policy, Options], Workspace]
"""Makes a workspace of a record, a policy and validated options."""


@dataclass(frozen=True)
class NativeAdapter:
    """One library through its own interface.

    Parameters
    ----------
    record : its row in the table, with what it can do on route native.
    workspace : makes a workspace of this record.
    option_names : the names of the library's settings, asked of the library itself; None where
        they are those of `settings_object`, or are not known and not checked.
    settings_object : a fresh settings object of the library that takes options as attributes,
        None where it takes them otherwise.
    """

    record: SolverRecord
    workspace: Opened
    option_names: Callable[[], Iterable[str]] | None = None
    settings_object: Callable[[], Any] | None = None


class ClaimedStatus(NamedTuple):
    """What the library says about its answer; -1 and "" where it says nothing."""

    status: Status
    iterations: int = -1
    reported_ns: int = -1
    detail: str = ""


Claim = tuple[Status, int, int, str]
"""A `ClaimedStatus`, or a plain tuple of the same where every step asks for one."""
ReadStatus = Callable[[Any, Options], Claim]
NO_REASON = ClaimedStatus(Status.UNKNOWN, detail="not found; qpsolvers does not pass the reason on")


def found_is_all(answer: Any, options: Options) -> Claim:
    """Read the status of a library of which qpsolvers passes on `found` and nothing else."""
    return ClaimedStatus(Status.SOLVED) if answer.found else NO_REASON


Tell = Callable[[Any, float, Options], Claim]
"""What a library claims, of its `info`, the time that counts in its own unit, and the options."""


def told(
    statuses: Mapping[Any, Status],
    unit_ns: float,
    *,
    word: Callable[[Any], str] = lambda info: str(info.status),
    number: Callable[[Any], int] | None = None,
    on_request: bool = False,
) -> Tell:
    """How a library tells of a solve: in an `info` with `status`, `iter` and times.

    Parameters
    ----------
    statuses : by its words; unit_ns : the unit of its times [ns].
    word : its word for the status; number : what stands for that in `statuses` instead.
    on_request : it times itself only where the option `compute_timings` asks for it.
    """

    def tell(info: Any, took: float, options: Options) -> Claim:
        name = word(info)
        status = statuses.get(name if number is None else number(info), Status.UNKNOWN)
        timed = not on_request or options.get("compute_timings", False)
        return status, int(info.iter), round(took * unit_ns) if timed else -1, name

    return tell


def with_setup(tell: Tell) -> ReadStatus:
    """Make the `read_status` of a library that tells so: its run time counts its set-up."""

    def read_status(answer: Any, options: Options) -> Claim:
        info = answer.extras["info"]
        return tell(info, info.run_time, options)

    return read_status


@dataclass(frozen=True)
class QpsolversAdapter:
    """One library behind qpsolvers.

    Parameters
    ----------
    record : its row in the table, with what it can do on route qpsolvers.
    box : whether bounds reach it as bounds, or as rows prepared once because qpsolvers would
        otherwise append an identity matrix at every solve.
    read_status : what a `qpsolvers.Solution` with extras says, given the options of the call.
    option_names, settings_object : as of `NativeAdapter`; the members of a group of settings as
        "group.name".
    qpsolvers_name : its name in qpsolvers where that is not the name of its record.
    fixed : arguments of every call that are not settings of the algorithm.
    not_found : what is reported where nothing was found and nothing is said about it.
    prepare : called once when a workspace is opened, for what is no argument of a call.
    iterate_when_not_found : whether x means anything then; a vector of zeros does not.
    """

    record: SolverRecord
    box: Box
    read_status: ReadStatus
    option_names: Callable[[], Iterable[str]] | None = None
    settings_object: Callable[[], Any] | None = None
    qpsolvers_name: str = ""
    fixed: Options = field(default_factory=dict)
    not_found: ClaimedStatus = NO_REASON
    prepare: Callable[[], None] | None = None
    iterate_when_not_found: bool = True

    @property
    def called(self) -> str:
        """Its name in qpsolvers."""
        return self.qpsolvers_name or self.record.name

    def natively(self, workspace: Opened) -> NativeAdapter:
        """Return the adapter of the library's own interface, with the same settings."""
        return NativeAdapter(self.record, workspace, self.option_names, self.settings_object)

    def claimed_status(self, answer: Any, options: Options) -> Claim:
        """Status, iterations and reported time of a `qpsolvers.Solution`.

        Problems without constraints are answered by qpsolvers itself for some libraries; such an
        answer has no extras.
        """
        if answer.extras:
            return self.read_status(answer, options)
        return ClaimedStatus(Status.SOLVED) if answer.found else self.not_found


def attributes(settings: Any) -> list[str]:
    """List the settings of an object that keeps them as attributes."""
    names = (name for name in dir(settings) if not name.startswith("_"))
    return [n for n in names if n != "verbose" and not callable(getattr(settings, n))]


def made_by(module: str, name: str) -> Callable[[], Any]:
    """Make the `settings_object` of a library whose `name` makes one, imported when called."""

    def settings_object() -> Any:
        return getattr(import_module(module), name)()

    return settings_object


def adapters_in(
    package: str, besides: Iterable[str]
) -> tuple[dict[str, NativeAdapter], dict[str, QpsolversAdapter]]:
    """Find the adapters that the modules of a package hold, by the name of their solver.

    Parameters
    ----------
    package : its name, while it is being imported.
    besides : the modules that serve the others and hold none.

    Returns
    -------
    Those of route native, and those of route qpsolvers.

    Raises
    ------
    DpbenchError : a module without an adapter, or two adapters of one name and route.
    """
    native: dict[str, NativeAdapter] = {}
    wrapped: dict[str, QpsolversAdapter] = {}
    for info in pkgutil.iter_modules(import_module(package).__path__):
        if info.name in besides:
            continue
        module = import_module(f"{package}.{info.name}")
        before = len(native) + len(wrapped)
        for held in vars(module).values():
            taken = False
            if isinstance(held, NativeAdapter):
                taken = native.setdefault(held.record.name, held) is not held
            elif isinstance(held, QpsolversAdapter):
                taken = wrapped.setdefault(held.record.name, held) is not held
            if taken:
                raise DpbenchError(f"{module.__name__}: solver {held.record.name} is there twice")
        if len(native) + len(wrapped) == before:
            raise DpbenchError(f"{module.__name__} holds no adapter")
    return native, wrapped
