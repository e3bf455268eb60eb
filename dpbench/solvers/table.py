"""The table of solvers, their availability here, and isolation of one from the others."""

import importlib
import sys
import warnings
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder
from importlib.util import find_spec
from os import PathLike
from pathlib import Path

from dpbench.errors import (
    DpbenchError,
    SolverUnavailableError,
    UnknownNameError,
    format_allowed_names,
    require_type,
)
from dpbench.solvers import plugins
from dpbench.solvers.adapter import NativeAdapter, QpsolversAdapter, read_solved_flag_as_claim
from dpbench.solvers.calibration import CALIBRATION, open_calibration_solver
from dpbench.solvers.contract import (
    NO_PROJECT_FACTS,
    Build,
    Policy,
    RouteRecord,
    SolverRecord,
    describe_exception_unless_interrupt,
)
from dpbench.solvers.libraries import NATIVE, THROUGH_QPSOLVERS
from dpbench.solvers.own.adapters import OWN

_ON_NATIVE: dict[str, NativeAdapter] = {**NATIVE, **OWN}
TABLE: dict[str, SolverRecord] = {
    name: (_ON_NATIVE if name in _ON_NATIVE else THROUGH_QPSOLVERS)[name].record
    for name in sorted({*_ON_NATIVE, *THROUGH_QPSOLVERS})
}
"""The own solvers and the libraries with an adapter, in alphabetical order."""
BUILT_IN: dict[str, SolverRecord] = {**TABLE, **CALIBRATION}
"""All solvers of dpbench; no other solver may have the name of one."""
CONTROLLER_SOLVERS = ("paper_active_set", "osqp", "daqp")
"""Solvers that `dpbench codegen` can include in the C code of a controller."""
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

PluginFiles = str | Path | Sequence[str | Path] | None
"""One file of a plug-in, several or none."""


@dataclass(frozen=True)
class Availability:
    """Availability of a solver here: version and build, or why it cannot be used."""

    ok: bool
    version: str = ""
    reason: str = ""
    build: Build = field(default_factory=Build)

    @property
    def version_and_build_text(self) -> str:
        """Version of the solver's library and instruction set it was built for, as one text."""
        return f"{self.version} {self.build.text}".strip()


def list_all_solver_names() -> tuple[str, ...]:
    """Return all known solvers' names in order, installed or not, plug-ins included."""
    return tuple(sorted({*TABLE, *plugins.list_plugin_names()}))


def find_solver_record(name: str) -> SolverRecord:
    """Return the facts about a solver by its name; UnknownNameError if there is none."""
    row = BUILT_IN.get(name)
    if row is not None:
        return row
    plugin = plugins.find_plugin(name)
    if plugin is not None:
        return plugin.record
    if _is_solver_of_qpsolvers(name):
        return _make_generic_qpsolvers_adapter(name).record
    raise UnknownNameError(
        "solver",
        "",
        repr(name),
        format_allowed_names(name, list_all_solver_names(), listing="list_solvers()"),
    )


def get_native_adapter(name: str) -> NativeAdapter:
    """Return how to call a solver by its own interface; KeyError if it has none."""
    if name in CALIBRATION:
        return NativeAdapter(
            CALIBRATION[name],
            lambda record, policy, options: open_calibration_solver(name),
            lambda: (),
        )
    plugin = _find_plugin_unless_built_in(name)
    return _ON_NATIVE[name] if plugin is None else plugin.adapter


def get_qpsolvers_adapter(name: str) -> QpsolversAdapter:
    """Return how to call a solver through qpsolvers, in a generic way if dpbench lacks it."""
    return THROUGH_QPSOLVERS.get(name) or _make_generic_qpsolvers_adapter(name)


def _find_plugin_unless_built_in(name: str) -> plugins.Plugin | None:
    """Return the plug-in solver of a name; None if dpbench has a solver of it or there is none."""
    return None if name in TABLE else plugins.find_plugin(name)


def _is_solver_of_qpsolvers(name: str) -> bool:
    """Return whether qpsolvers has a solver of this name, without importing it."""
    loaded = sys.modules.get("qpsolvers")
    if loaded is not None and name in loaded.available_solvers:
        return True
    spec = find_spec("qpsolvers") if loaded is None else loaded.__spec__
    folders = [f"{folder}/solvers" for folder in (spec and spec.submodule_search_locations) or ()]
    return name.isidentifier() and PathFinder.find_spec(f"{name}_", folders) is not None


@cache
def _list_extras_of_qpsolvers() -> list[str]:
    """Return the extras of qpsolvers, which have the names of its solvers, but not of all."""
    return metadata.metadata("qpsolvers").get_all("Provides-Extra", [])


def _make_generic_qpsolvers_adapter(name: str) -> QpsolversAdapter:
    """Return how to call a solver that only qpsolvers has; its settings go unchecked."""
    refused: dict[Policy, str] = {"warm": "whether it accepts a start is not known"}
    can = RouteRecord(("fresh",), detects_infeasibility=False, refused=refused)
    record = SolverRecord(
        name=name,
        family="not stated",
        method="not in the table; as qpsolvers drives it",
        distribution=f"qpsolvers[{name}]" if name in _list_extras_of_qpsolvers() else "",
        module="qpsolvers",
        extra="qpsolvers",
        form="dense",
        routes={"qpsolvers": can},
        levels={},
        project=NO_PROJECT_FACTS,
    )
    return QpsolversAdapter(record, "native", read_solved_flag_as_claim)


def load_plugin_solver_from_file(path: str | Path, *, tried: bool = False) -> SolverRecord:
    """Load a plug-in solver from a Python file into this process; return the facts about it.

    tried : whether the file is known not to end the process that runs it, or may do so.
    InputError : the file is missing, fails when run, is no plug-in, or takes a name of `BUILT_IN`.
    """
    if not tried:
        plugins.try_plugin_file_in_child(path)
    return plugins.load_solver_from_file(path, BUILT_IN)


def list_plugin_files(solver_module: PluginFiles) -> list[str]:
    """Return the files of plug-ins in an argument: one, several or none."""
    if isinstance(solver_module, str | PathLike):
        return [str(solver_module)]
    allowed = "a Python file, or a list of Python files"
    require_type("solver_module", solver_module, Iterable | None, allowed)
    files = [*(solver_module or ())]
    for file in files:
        require_type("solver_module", file, str | PathLike, allowed)
    return [*map(str, files)]


def load_plugin_solvers(solver_module: PluginFiles) -> None:
    """Load the plug-in solvers in one file, several or none; errors as for a single file."""
    for file in list_plugin_files(solver_module):
        load_plugin_solver_from_file(file)


# Parsing takes 2 ms, and a suite calls this thousands of times.
@cache
def _get_installed_package_version(distribution: str) -> str:
    """Return the installed version of a Python package; PackageNotFoundError if missing."""
    return metadata.version(distribution)


def find_solver_availability(name: str, *, imported: bool = True) -> Availability:
    """Return version or fault of a solver's library; if `imported`, also whether it imports."""
    row = find_solver_record(name)
    if row.extra == "own":
        return Availability(True, _get_installed_package_version("dpbench"))
    if row.extra == "qpsolvers":
        return _find_qpsolvers_availability(row)
    plugin = _find_plugin_unless_built_in(name)
    if plugin is not None:
        return Availability(True, plugin.version)
    try:
        version = _get_installed_package_version(row.distribution)
    except metadata.PackageNotFoundError:
        reason = f"{row.distribution} is not installed; run `{row.install_command}`"
        return Availability(False, "", reason)
    if not imported:
        return Availability(True, version)
    try:
        # A library that warns on import is available all the same.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            importlib.import_module(row.module)
            build = row.build()
    except BaseException as error:
        reason = f"importing {row.module} failed: {describe_exception_unless_interrupt(error)}"
        return Availability(False, version, " ".join(reason.split()))
    return Availability(True, version, build=build)


def require_solver_available(name: str) -> None:
    """Raise SolverUnavailableError, with the install command, if a solver cannot be used."""
    require_any_solver_available([name])


def require_any_solver_available(names: Sequence[str]) -> None:
    """Raise SolverUnavailableError, with all reasons, if none of the named solvers can be used."""
    faults: dict[str, None] = {}
    for name in names:
        here, remedy = find_solver_availability(name), find_solver_record(name).install_command
        if here.ok:
            return
        faults[here.reason if remedy in here.reason else f"{here.reason}; run `{remedy}`"] = None
    if names:
        where = f"solver{'s' * (len(names) > 1)} {', '.join(names)}"
        raise SolverUnavailableError(where, "; ".join(faults))


def _find_qpsolvers_availability(row: SolverRecord) -> Availability:
    """Return whether qpsolvers finds the library of a solver that dpbench does not have."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        served = importlib.import_module("qpsolvers").available_solvers
    if row.name not in served:
        remedy = f"run `{row.install_command}`" if row.distribution else row.install_command
        return Availability(False, "", f"qpsolvers does not find {row.name}: {remedy}")
    try:
        return Availability(True, _get_installed_package_version(row.name))
    except metadata.PackageNotFoundError:
        return Availability(True, f"qpsolvers {_get_installed_package_version('qpsolvers')}")


class HiddenModules(MetaPathFinder):
    """Import hook that hides modules: a None in `sys.modules` SciPy would take for "jax"."""

    def __init__(self, names: Collection[str]) -> None:
        self._names = frozenset(names)

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> None:
        """Raise ModuleNotFoundError for a module that is to stay hidden; return None for others."""
        if fullname in self._names:
            raise ModuleNotFoundError(f"{fullname} is hidden in this process", name=fullname)


def block_imports_of_other_solvers(*solvers: str) -> None:
    """Block imports of all solver libraries but those of given solvers, for this whole process.

    `import qpsolvers` imports every solver library it finds, which costs time and memory, starts
    threads and lets one library's OpenMP or BLAS settings act on another's.

    Raises UnknownNameError : there is no such solver.
    DpbenchError : qpsolvers was imported before, so it is too late.
    """
    rows = [find_solver_record(solver) for solver in solvers]
    if "qpsolvers" in sys.modules:
        raise DpbenchError(
            "isolate was called too late: qpsolvers has been imported in this process"
        )
    used = {module for row in rows for module in (row.module, *row.needs_modules)}
    modules = {entry.module for entry in TABLE.values() if entry.module}
    # The modules that a solver outside the table needs are unknown.
    others = () if any(row.extra == "qpsolvers" for row in rows) else OTHER_LIBRARIES
    hidden = {*modules, *others} - used
    for module in hidden:
        sys.modules.pop(module, None)
    sys.meta_path.insert(0, HiddenModules(hidden))
