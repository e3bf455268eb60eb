"""What the adapter of one library consists of: on route native, and on route qpsolvers.

Behind qpsolvers it is data and two small functions; the workspace that drives it is common to all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from dpbench.qp.solution import Status
from dpbench.solvers.contract import Options, Policy, Workspace
from dpbench.solvers.record import SolverRecord


@dataclass(frozen=True)
class NativeAdapter:
    """One library through its own interface.

    Parameters
    ----------
    record : its row in the table, with what it can do on route native.
    workspace : makes a workspace of its record, a policy and validated options.
    option_names : the names of the library's settings, asked of the library itself.
    settings_object : a fresh settings object of the library that takes options as attributes,
        None where it takes them otherwise.
    """

    record: SolverRecord
    workspace: Callable[[SolverRecord, Policy, Options], Workspace]
    option_names: Callable[[], Iterable[str]] | None
    settings_object: Callable[[], Any] | None = None


class ClaimedStatus(NamedTuple):
    """What the library says about its answer; -1 and "" where it says nothing."""

    status: Status
    iterations: int = -1
    reported_ns: int = -1
    detail: str = ""


NO_REASON = ClaimedStatus(Status.UNKNOWN, detail="not found; qpsolvers does not pass the reason on")


def status_of_found(answer: Any, options: Options) -> ClaimedStatus:
    """The read_status of a library of which qpsolvers passes on `found` and nothing else."""
    return ClaimedStatus(Status.SOLVED) if answer.found else NO_REASON


@dataclass(frozen=True)
class Adapter:
    """One library behind qpsolvers.

    Parameters
    ----------
    record : its row in the table.
    read_status : maps a `qpsolvers.Solution` with extras, and the options of the call, to a
        claimed_status.
    option_names : the names of the library's settings, asked of the library itself; the members
        of a group of settings as "group.name"; None where they are not known and not checked.
    settings_object : a fresh settings object of the library that takes options as attributes,
        None where it takes them as keywords.
    fixed : arguments of every call that are not settings of the algorithm.
    not_found : the claimed_status where nothing was found and nothing is said about it.
    prepare : called once when a workspace is opened, for what is no argument of a call.
    iterate_when_not_found : whether x means anything then; a vector of zeros does not.
    """

    record: SolverRecord
    read_status: Callable[[Any, Options], ClaimedStatus]
    option_names: Callable[[], Iterable[str]] | None
    settings_object: Callable[[], Any] | None = None
    fixed: Options = field(default_factory=dict)
    not_found: ClaimedStatus = NO_REASON
    prepare: Callable[[], None] | None = None
    iterate_when_not_found: bool = True

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
