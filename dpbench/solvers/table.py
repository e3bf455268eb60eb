"""The table of solvers: what there is, what each can do, and whether it is installed here."""

from __future__ import annotations

import importlib
import warnings
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

from dpbench.errors import SolverUnavailableError, UnknownNameError, one_of
from dpbench.solvers.adapter import NativeAdapter, QpsolversAdapter
from dpbench.solvers.calibration import CALIBRATION, open_calibration
from dpbench.solvers.contract import words_of
from dpbench.solvers.libraries import NATIVE, THROUGH_QPSOLVERS
from dpbench.solvers.libraries.generic import generic_adapter, is_served
from dpbench.solvers.own.adapters import OWN
from dpbench.solvers.plugins import (
    entry_point_names,
    find_plugin,
    load_file,
    loaded_names,
    try_file,
)
from dpbench.solvers.record import UNREAD, Build, SolverRecord

LISTING = "dpbench list solvers"
"""The command that lists all solvers."""
_ON_NATIVE: dict[str, NativeAdapter] = {**NATIVE, **OWN}
TABLE: dict[str, SolverRecord] = {
    name: _ON_NATIVE[name].record if name in _ON_NATIVE else THROUGH_QPSOLVERS[name].record
    for name in sorted({*_ON_NATIVE, *THROUGH_QPSOLVERS})
}
"""The own solvers and the libraries with an adapter, in alphabetical order."""


@dataclass(frozen=True)
class Availability:
    """Whether a solver can be used here; `reason` says why not and what installs it."""

    ok: bool
    version: str = ""
    reason: str = ""
    build: Build = UNREAD

    @property
    def identity(self) -> str:
        """Version and build: times of another of the two are not those of this library."""
        return f"{self.version} {self.build.text}".strip()


def solver_names() -> tuple[str, ...]:
    """Every solver of the table, installed or not, and every plug-in, in alphabetical order.

    The harness's own (`calibration.py`) have records but are no solvers, and not among them.
    """
    return tuple(sorted({*TABLE, *loaded_names(), *entry_point_names()}))


def record(name: str) -> SolverRecord:
    """Look up a solver: of the table, of a plug-in, or of one that only qpsolvers knows.

    The harness's own have a row too.

    Raises
    ------
    UnknownNameError : there is no such solver.
    InputError : it is a plug-in that fails to load.
    """
    if name in TABLE:
        return TABLE[name]
    if name in CALIBRATION:
        return CALIBRATION[name]
    plugin = find_plugin(name)
    if plugin is not None:
        return plugin.record
    if is_served(name):
        return generic_adapter(name).record
    raise UnknownNameError("solver", "", repr(name), one_of(name, solver_names(), listing=LISTING))


def native_adapter(name: str) -> NativeAdapter:
    """Return the adapter of a solver with route native, a plug-in's too; KeyError for another."""
    if name in CALIBRATION:
        return NativeAdapter(
            CALIBRATION[name], lambda record, policy, options: open_calibration(name), lambda: ()
        )
    plugin = None if name in TABLE else find_plugin(name)
    return _ON_NATIVE[name] if plugin is None else plugin.adapter


def qpsolvers_adapter(name: str) -> QpsolversAdapter:
    """Return the adapter of a solver on route qpsolvers."""
    return THROUGH_QPSOLVERS[name] if name in THROUGH_QPSOLVERS else generic_adapter(name)


def load_solver_module(path: str | Path, *, tried: bool = False) -> SolverRecord:
    """Load a plug-in from a Python file, so that its name is one of a solver in this process.

    Parameters
    ----------
    tried : whether the file is known not to end the process that runs it, or may do so.

    Raises
    ------
    InputError : the file is missing, fails when run, is no plug-in, or takes a name of the table.
    """
    if not tried:
        try_file(path)
    return load_file(path, {**TABLE, **CALIBRATION})


@cache
def _version(distribution: str) -> str:
    """Of an installed distribution: a suite asks thousands of times, parsing it takes 2 ms."""
    return metadata.version(distribution)


def available(name: str, *, imported: bool = True) -> Availability:
    """Return whether the library of a solver is installed and can be imported.

    A library is not available whatever error it raises while it is imported. Without importing it
    (`imported=False`) its build is not read.
    """
    row = record(name)
    if row.extra == "own":
        return Availability(True, _version("dpbench"))
    if row.extra == "qpsolvers":
        return _through_qpsolvers(name)
    plugin = None if name in TABLE else find_plugin(name)
    if plugin is not None:
        return Availability(True, plugin.version)
    try:
        version = _version(row.distribution)
    except metadata.PackageNotFoundError:
        return Availability(False, "", f"{row.distribution} is not installed: {row.remedy}")
    if not imported:
        return Availability(True, version)
    try:
        with warnings.catch_warnings():
            # A library that warns on import is available all the same.
            warnings.simplefilter("ignore")
            importlib.import_module(row.module)
            build = row.build()
    except BaseException as error:
        reason = f"importing {row.module} failed: {words_of(error)}"
        return Availability(False, version, " ".join(reason.split()))
    return Availability(True, version, build=build)


def check_available(name: str) -> None:
    """Raise SolverUnavailableError where a solver cannot be used, with what installs it."""
    here, remedy = available(name), record(name).remedy
    if not here.ok:
        advice = "" if remedy in here.reason else f"; {remedy}"
        raise SolverUnavailableError(f"solver {name}", f"{here.reason}{advice}")


def _through_qpsolvers(name: str) -> Availability:
    """Whether qpsolvers found the library of a solver that is not in the table."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        served = importlib.import_module("qpsolvers").available_solvers
    if name not in served:
        return Availability(False, "", f"qpsolvers does not find it: pip install qpsolvers[{name}]")
    try:
        return Availability(True, _version(name))
    except metadata.PackageNotFoundError:
        return Availability(True, f"qpsolvers {_version('qpsolvers')}")
