"""What the adapter of one library consists of, on route native and on route qpsolvers.

Behind qpsolvers it is data and two small functions; the workspace that drives it is common to all.
A module of `libraries/` or `through_qpsolvers/` that holds an adapter is found by `adapters_in`: to
write the file is to register the solver.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple, Protocol, TypeVar

from dpbench.errors import DpbenchError
from dpbench.qp.solution import Status
from dpbench.solvers.contract import Options, Policy, Workspace
from dpbench.solvers.one_sided import Box
from dpbench.solvers.record import RouteRecord, SolverRecord

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
        they are not known and not checked.
    settings_object : a fresh settings object of the library that takes options as attributes,
        None where it takes them otherwise.
    """

    record: SolverRecord
    workspace: Opened
    option_names: Callable[[], Iterable[str]] | None
    settings_object: Callable[[], Any] | None = None


class ClaimedStatus(NamedTuple):
    """What the library says about its answer; -1 and "" where it says nothing."""

    status: Status
    iterations: int = -1
    reported_ns: int = -1
    detail: str = ""


ReadStatus = Callable[[Any, Options], ClaimedStatus]
NO_REASON = ClaimedStatus(Status.UNKNOWN, detail="not found; qpsolvers does not pass the reason on")


def found_is_all(answer: Any, options: Options) -> ClaimedStatus:
    """The `read_status` of a library of which qpsolvers passes on `found` and nothing else."""
    return ClaimedStatus(Status.SOLVED) if answer.found else NO_REASON


def read_enumerated(statuses: Mapping[str, Status], unit_ns: float) -> ReadStatus:
    """The `read_status` of a library that times itself only where `compute_timings` asks for it.

    Parameters
    ----------
    statuses : by the names of its enumeration; unit_ns : the unit of its run time [ns].
    """

    def read_status(answer: Any, options: Options) -> ClaimedStatus:
        info = answer.extras["info"]
        name = info.status.name
        run_ns = round(info.run_time * unit_ns) if options.get("compute_timings", False) else -1
        return ClaimedStatus(statuses.get(name, Status.UNKNOWN), int(info.iter), run_ns, name)

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
    option_names : the names of the library's settings, asked of the library itself; the members
        of a group of settings as "group.name"; None where they are not known and not checked.
    settings_object : a fresh settings object of the library that takes options as attributes,
        None where it takes them as keywords.
    qpsolvers_name : its name in qpsolvers where that is not the name of its record.
    fixed : arguments of every call that are not settings of the algorithm.
    not_found : what is reported where nothing was found and nothing is said about it.
    prepare : called once when a workspace is opened, for what is no argument of a call.
    iterate_when_not_found : whether x means anything then; a vector of zeros does not.
    """

    record: SolverRecord
    box: Box
    read_status: ReadStatus
    option_names: Callable[[], Iterable[str]] | None
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

    def natively(self, can: RouteRecord, workspace: Opened) -> NativeAdapter:
        """The same library through its own interface as well, with the same settings."""
        record = self.record.with_native(can)
        return NativeAdapter(record, workspace, self.option_names, self.settings_object)

    def claimed_status(self, answer: Any, options: Options) -> ClaimedStatus:
        """Status, iterations and reported time of a `qpsolvers.Solution`.

        Problems without constraints are answered by qpsolvers itself for some libraries; such an
        answer has no extras.
        """
        if answer.extras:
            return self.read_status(answer, options)
        return ClaimedStatus(Status.SOLVED) if answer.found else self.not_found


def attributes(settings: Any) -> list[str]:
    """The names of the settings of an object that keeps them as attributes."""
    names = (name for name in dir(settings) if not name.startswith("_"))
    return [n for n in names if n != "verbose" and not callable(getattr(settings, n))]


def made_by(module: str, name: str) -> Callable[[], Any]:
    """The `settings_object` of a library whose `name` makes one, imported when it is asked for."""

    def settings_object() -> Any:
        return getattr(import_module(module), name)()

    return settings_object


class _Registered(Protocol):
    @property
    def record(self) -> SolverRecord: ...


Registered = TypeVar("Registered", bound=_Registered)


def adapters_in(
    package: str, kind: type[Registered], besides: Iterable[str]
) -> dict[str, Registered]:
    """The adapters that the modules of a package hold, by the name of their solver.

    Parameters
    ----------
    package : its name, while it is being imported.
    kind : the class of the adapters; besides : the modules that serve the others and hold none.

    Raises
    ------
    DpbenchError : a module without an adapter, or two adapters of one name.
    """
    registered: dict[str, Registered] = {}
    for name in _modules(package):
        if name in besides:
            continue
        module = import_module(f"{package}.{name}")
        adapters = [value for value in vars(module).values() if isinstance(value, kind)]
        if not adapters:
            raise DpbenchError(f"{module.__name__} holds no {kind.__name__}")
        for adapter in adapters:
            if registered.setdefault(adapter.record.name, adapter) is not adapter:
                raise DpbenchError(
                    f"{module.__name__}: solver {adapter.record.name} is there twice"
                )
    return registered


def _modules(package: str) -> Iterator[str]:
    return (info.name for info in pkgutil.iter_modules(import_module(package).__path__))
