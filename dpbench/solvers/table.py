"""The table of solvers: what there is, what each can do, and whether it is installed here."""

from __future__ import annotations

import importlib
import warnings
from dataclasses import dataclass
from importlib import metadata

from dpbench.errors import UnknownNameError
from dpbench.solvers.record import SolverRecord
from dpbench.solvers.settings import settings_matter
from dpbench.solvers.through_qpsolvers import ADAPTERS

PAPER_ACTIVE_SET = SolverRecord(
    name="paper_active_set",
    distribution="",
    module="",
    method="active set by its multipliers (paper eq. 30-32), pivoting of Goldfarb-Idnani",
    extra="own",
    form="dense",
    box="native",
    policies={"native": ("fresh", "reuse")},
    start="none",
    needs_strict_convexity=True,
    refused={("native", "warm"): "it starts from the empty set, the unconstrained optimum"},
)
UNCONSTRAINED_CLIPPED = SolverRecord(
    name="unconstrained_clipped",
    distribution="",
    module="",
    method="unconstrained law z = −P⁻¹q (paper eq. 27), to be clipped by the loop",
    extra="own",
    form="dense",
    box="native",
    policies={"native": ("fresh", "reuse")},
    start="none",
    needs_strict_convexity=True,
    gives_multipliers=False,
    detects_infeasibility=False,
    refused={("native", "warm"): "a direct solve has no start"},
)
TABLE: dict[str, SolverRecord] = dict(
    sorted(
        {
            **{name: adapter.record for name, adapter in ADAPTERS.items()},
            "paper_active_set": PAPER_ACTIVE_SET,
            "unconstrained_clipped": UNCONSTRAINED_CLIPPED,
        }.items()
    )
)


@dataclass(frozen=True)
class Availability:
    """Whether a solver can be used here; `reason` says why not and what installs it."""

    ok: bool
    version: str = ""
    reason: str = ""


def solver_names() -> tuple[str, ...]:
    """Every solver of the table, installed or not, in alphabetical order."""
    return tuple(TABLE)


def record(name: str) -> SolverRecord:
    """The row of a solver; UnknownNameError if there is none."""
    if name not in TABLE:
        raise UnknownNameError("solver", "", repr(name), ", ".join(TABLE))
    return TABLE[name]


def available(name: str) -> Availability:
    """Import the library of a solver and say whether it worked.

    A library that fails in its own way while it is imported is a library that is not available,
    whatever it raised.
    """
    row = record(name)
    if row.extra == "own":
        return Availability(True, metadata.version("dpbench"))
    try:
        version = metadata.version(row.distribution)
    except metadata.PackageNotFoundError:
        return Availability(False, "", f"{row.distribution} is not installed: {row.remedy}")
    try:
        with warnings.catch_warnings():
            # A library that warns on import is available all the same.
            warnings.simplefilter("ignore")
            importlib.import_module(row.module)
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic of Rust is no Exception
        reason = f"importing {row.module} failed: {type(error).__name__}: {error}"
        return Availability(False, version, " ".join(reason.split()))
    return Availability(True, version)


__all__ = ["TABLE", "Availability", "available", "record", "settings_matter", "solver_names"]
