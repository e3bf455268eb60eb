"""The table of solvers, their availability here, and isolation of one from the others."""

import importlib
import sys
import warnings
from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path

from dpbench.errors import (
    DpbenchError,
    SolverUnavailableError,
    UnknownNameError,
    format_allowed_names,
)
from dpbench.solvers import plugins
from dpbench.solvers.adapter import NativeAdapter, QpsolversAdapter, read_solved_flag
from dpbench.solvers.calibration import CALIBRATION, open_calibration
from dpbench.solvers.contract import Policy, describe_exception
from dpbench.solvers.libraries import NATIVE, THROUGH_QPSOLVERS
from dpbench.solvers.own.adapters import OWN
from dpbench.solvers.record import NO_PROJECT_FACTS, Build, RouteRecord, SolverRecord

_ON_NATIVE: dict[str, NativeAdapter] = {**NATIVE, **OWN}
TABLE: dict[str, SolverRecord] = {
    name: (_ON_NATIVE if name in _ON_NATIVE else THROUGH_QPSOLVERS)[name].record
    for name in sorted({*_ON_NATIVE, *THROUGH_QPSOLVERS})
}
"""The own solvers and the libraries with an adapter, in alphabetical order."""
# Libraries that qpsolvers looks for and that are not in the table.
OTHER_LIBRARIES = (
    "coptpy",
    "gurobipy",
    "hpipm_python",
    "jax",
    "mosek",
    "nppro",
    "pdhcg",
    "qpoases",
    "qpSWIFT",
)


@dataclass(frozen=True)
class Availability:
    """Availability of a solver here: version and build, or why it cannot be used."""

    ok: bool
    version: str = ""
    reason: str = ""
    build: Build = field(default_factory=Build)

    @property
    def identity(self) -> str:
        """Version of the solver's library and instruction set it was built for, as one text."""
        return f"{self.version} {self.build.text}".strip()


def solver_names() -> tuple[str, ...]:
    """List the names of all known solvers, installed or not, plug-ins included, alphabetically."""
    return tuple(sorted({*TABLE, *plugins.plugin_names()}))


def find_record(name: str) -> SolverRecord:
    """Return the facts about a solver by its name; UnknownNameError if there is none."""
    row = TABLE.get(name) or CALIBRATION.get(name)
    if row is not None:
        return row
    plugin = plugins.find_plugin(name)
    if plugin is not None:
        return plugin.record
    if _is_served_by_qpsolvers(name):
        return _make_generic_adapter(name).record
    raise UnknownNameError(
        "solver",
        "",
        repr(name),
        format_allowed_names(name, solver_names(), listing="list_solvers()"),
    )


def native_adapter(name: str) -> NativeAdapter:
    """Return how to call a solver by its own interface; KeyError if it has none."""
    if name in CALIBRATION:
        return NativeAdapter(
            CALIBRATION[name], lambda record, policy, options: open_calibration(name), lambda: ()
        )
    plugin = _find_plugin(name)
    return _ON_NATIVE[name] if plugin is None else plugin.adapter


def qpsolvers_adapter(name: str) -> QpsolversAdapter:
    """Return how to call a solver through qpsolvers, in a generic way if dpbench lacks it."""
    return THROUGH_QPSOLVERS.get(name) or _make_generic_adapter(name)


def _find_plugin(name: str) -> plugins.Plugin | None:
    """Return the plug-in solver of a name; None if dpbench has a solver of it or there is none."""
    return None if name in TABLE else plugins.find_plugin(name)


def _is_served_by_qpsolvers(name: str) -> bool:
    """Return whether qpsolvers has a solver of this name, without importing it."""
    loaded = sys.modules.get("qpsolvers")
    if loaded is not None and name in loaded.available_solvers:
        return True
    spec = find_spec("qpsolvers") if loaded is None else loaded.__spec__
    folders = [f"{folder}/solvers" for folder in (spec and spec.submodule_search_locations) or ()]
    return name.isidentifier() and PathFinder.find_spec(f"{name}_", folders) is not None


def _make_generic_adapter(name: str) -> QpsolversAdapter:
    """Describe how to call a solver that only qpsolvers has; its settings go unchecked."""
    refused: dict[Policy, str] = {"warm": "whether it takes a start is not known"}
    can = RouteRecord(("fresh",), detects_infeasibility=False, refused=refused)
    record = SolverRecord(
        name=name,
        family="not stated",
        method="not in the table; as qpsolvers drives it",
        distribution=name,
        module="qpsolvers",
        extra="qpsolvers",
        form="dense",
        routes={"qpsolvers": can},
        levels={},
        project=NO_PROJECT_FACTS,
    )
    return QpsolversAdapter(record, "native", read_solved_flag)


def load_solver_module(path: str | Path, *, tried: bool = False) -> SolverRecord:
    """Load a plug-in solver from a Python file into this process; return the facts about it.

    tried : whether the file is known not to end the process that runs it, or may do so.
    InputError : the file is missing, fails when run, is no plug-in, or takes a name of the table.
    """
    if not tried:
        plugins.try_file(path)
    return plugins.load_file(path, {**TABLE, **CALIBRATION})


# Parsing takes 2 ms, and a suite calls this thousands of times.
@cache
def _installed_version(distribution: str) -> str:
    """Return the installed version of a Python package; PackageNotFoundError if missing."""
    return metadata.version(distribution)


def check_availability(name: str, *, imported: bool = True) -> Availability:
    """Return whether a solver's library is installed and, if `imported`, can be imported."""
    row = find_record(name)
    if row.extra == "own":
        return Availability(True, _installed_version("dpbench"))
    if row.extra == "qpsolvers":
        return _check_qpsolvers_availability(name)
    plugin = _find_plugin(name)
    if plugin is not None:
        return Availability(True, plugin.version)
    try:
        version = _installed_version(row.distribution)
    except metadata.PackageNotFoundError:
        return Availability(False, "", f"{row.distribution} is not installed: {row.remedy}")
    if not imported:
        return Availability(True, version)
    try:
        # A library that warns on import is available all the same.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            importlib.import_module(row.module)
            build = row.build()
    except BaseException as error:
        reason = f"importing {row.module} failed: {describe_exception(error)}"
        return Availability(False, version, " ".join(reason.split()))
    return Availability(True, version, build=build)


def check_available(name: str) -> None:
    """Raise SolverUnavailableError, with the install command, if a solver cannot be used."""
    here, remedy = check_availability(name), find_record(name).remedy
    if not here.ok:
        advice = "" if remedy in here.reason else f"; {remedy}"
        raise SolverUnavailableError(f"solver {name}", f"{here.reason}{advice}")


def _check_qpsolvers_availability(name: str) -> Availability:
    """Return whether qpsolvers finds the library of a solver that dpbench does not have."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        served = importlib.import_module("qpsolvers").available_solvers
    if name not in served:
        return Availability(False, "", f"qpsolvers does not find it: pip install qpsolvers[{name}]")
    try:
        return Availability(True, _installed_version(name))
    except metadata.PackageNotFoundError:
        return Availability(True, f"qpsolvers {_installed_version('qpsolvers')}")


class HiddenModules(MetaPathFinder):
    """Import hook that hides modules: a None in `sys.modules` SciPy would take for "jax"."""

    def __init__(self, names: Collection[str]) -> None:
        self._names = frozenset(names)

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> None:
        """Raise ModuleNotFoundError for a module that is to stay hidden; return None for others."""
        if fullname in self._names:
            raise ModuleNotFoundError(f"{fullname} is hidden in this process", name=fullname)


def isolate(*solvers: str) -> None:
    """Block imports of all solver libraries but those of given solvers, for this whole process.

    `import qpsolvers` imports every solver library it finds, which costs time and memory, starts
    threads and lets one library's OpenMP or BLAS settings act on another's.

    Raises UnknownNameError : there is no such solver.
    DpbenchError : qpsolvers was imported before, so it is too late.
    """
    rows = [find_record(solver) for solver in solvers]
    if "qpsolvers" in sys.modules:
        raise DpbenchError("isolate comes too late: qpsolvers has been imported in this process")
    used = {module for row in rows for module in (row.module, *row.needs_modules)}
    modules = {entry.module for entry in TABLE.values() if entry.module}
    # The modules that a solver outside the table needs are unknown.
    others = () if any(row.extra == "qpsolvers" for row in rows) else OTHER_LIBRARIES
    hidden = {*modules, *others} - used
    for module in hidden:
        sys.modules.pop(module, None)
    sys.meta_path.insert(0, HiddenModules(hidden))
