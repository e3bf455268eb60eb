"""What one library's native adapter consists of."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from dpbench.solvers.contract import Policy, Workspace
from dpbench.solvers.record import SolverRecord
from dpbench.solvers.through_qpsolvers.adapter import Options


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
