"""Solvers of third parties: by an entry point, or by a Python file.

A plug-in is a module (or any object) with

    RECORD                   its row in the table, made by `solver_record`
    open(policy, options)    a Workspace, not yet set up; `options` maps its own keys to values
    LEVELS                   optional: the options of "low", "mid" and "high"

An installed distribution names it by an entry point of the group `dpbench.solvers` with the name of
the solver; a file is loaded by `table.load_plugin_solver_from_file`. RECORD names the module of its
library, so that it can be measured alone in a process.
"""

import hashlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib import metadata
from inspect import getsource
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, get_args

from dpbench.errors import InputError, SituationError, warn_of_outdated_name
from dpbench.files.regular_files import is_plain_file_name
from dpbench.solvers.adapter import NativeAdapter, OpenWorkspace
from dpbench.solvers.contract import (
    NO_PROJECT_FACTS,
    POLICIES,
    Build,
    Family,
    Form,
    Levels,
    Options,
    Policy,
    Project,
    RouteRecord,
    SolverRecord,
    Workspace,
)

GROUP = "dpbench.solvers"
_IMPORTABLE = "a file that can be imported"
_INSTALL = (
    "install the package of this module (in its repository: `pip install .`) or set PYTHONPATH to "
    "the folder that contains it"
)
_PLUGIN_FILE = "a Python file that defines RECORD and open()"
TRIAL_S = 60.0  # Time limit of a plug-in's file in `try_plugin_file_in_child`
# The last line that the process of `try_plugin_file_in_child` prints.
_RAN = b"\ndpbench: ran\n"
_TRIAL = f"""
import json, os, sys
sys.path[:], where, file = json.loads(sys.argv[1])
from dpbench.solvers.plugins import run_plugin_file_ignoring_exceptions
out = os.dup(1)
os.dup2(2, 1)
run_plugin_file_ignoring_exceptions(where, file)
os.write(out, {_RAN!r})
os._exit(0)
"""


@dataclass(frozen=True)
class Plugin:
    """A third-party solver: how to call it, version or file checksum, where it was loaded from."""

    adapter: NativeAdapter
    version: str
    origin: str

    @property
    def record(self) -> SolverRecord:
        """Facts about the plug-in solver: name, method, abilities."""
        return self.adapter.record


_LOADED: dict[str, Plugin] = {}


def solver_record(
    name: str,
    *,
    method: str,
    family: Family = "not stated",
    policies: tuple[Policy, ...] = ("fresh",),
    form: Form = "dense",
    distribution: str = "",
    module: str = "",
    project: Project = NO_PROJECT_FACTS,
    needs_strict_convexity: bool = False,
    build: Callable[[], Build] = Build,
    refused: Mapping[Any, str] = MappingProxyType({}),
    **abilities: Any,
) -> SolverRecord:
    """Return the facts of a plug-in solver: name, method, and abilities of its own interface.

    refused : reasons of missing policies, by policy, or by ("native", policy) as in old releases.
    abilities : further fields of `RouteRecord`.
    """
    why = {key[-1] if isinstance(key, tuple) else key: reason for key, reason in refused.items()}
    return SolverRecord(
        name=name,
        family=family,
        method=method,
        distribution=distribution,
        module=module,
        extra="plugin",
        form=form,
        routes={"native": RouteRecord(policies, refused=why, **abilities)},
        levels={},
        project=project,
        needs_strict_convexity=needs_strict_convexity,
        build=build,
    )


def load_solver_from_file(path: str | Path, taken: Collection[str]) -> SolverRecord:
    """Return the solver in a Python file; InputError if it fails or its name is in `taken`."""
    where, file = _require_plugin_file_and_label(path)
    module = _import_plugin_file(where, file)
    version = hashlib.sha256(getsource(module).encode()).hexdigest()[:12]
    return _check_and_register_plugin(where, module, version, str(file), taken).record


def try_plugin_file_in_child(path: str | Path) -> None:
    """Raise InputError if a plug-in's file is missing, or crashes or hangs in a child process."""
    where, file = _require_plugin_file_and_label(path)
    command = [sys.executable, "-c", _TRIAL, json.dumps([sys.path, where, str(file)])]
    null = subprocess.DEVNULL
    process = subprocess.Popen(
        command, stdin=null, stdout=subprocess.PIPE, stderr=null, start_new_session=True
    )
    try:
        output, _ = process.communicate(timeout=TRIAL_S)
        code = process.returncode
        how = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        fault = "" if output.endswith(_RAN) else f"the file ended its process when imported ({how})"
    except subprocess.TimeoutExpired:
        fault = f"found an import that takes more than {TRIAL_S:g} s"
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        assert process.stdout is not None, "it is a pipe"
        process.stdout.close()
    if fault:
        raise SituationError(where, f"{fault}; required: {_IMPORTABLE}")


def run_plugin_file_ignoring_exceptions(where: str, file: str) -> None:
    """Run a plug-in's file in a trial process, ignoring exceptions: only a crash matters."""
    with suppress(InputError):
        _import_plugin_file(where, Path(file))


def _require_plugin_file_and_label(path: str | Path) -> tuple[str, Path]:
    """Return a plug-in file's label for errors and its full path; InputError if missing."""
    where, file = f"solver module {path}", Path(path).resolve()
    if not file.is_file():
        raise InputError(where, "", "no such file", _PLUGIN_FILE)
    return where, file


def _import_plugin_file(where: str, file: Path) -> ModuleType:
    """Return a plug-in's Python file executed as a new module; its exceptions become InputError."""
    digest = hashlib.sha256(str(file).encode()).hexdigest()[:12]
    spec = importlib.util.spec_from_file_location(f"dpbench_plugin_{digest}", file)
    if spec is None or spec.loader is None:
        raise InputError(where, "", "a file that is not Python", "a file name that ends in .py")
    module = importlib.util.module_from_spec(spec)
    # Dataclasses and pickling look a class up in its module.
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except InputError as error:
        raise SituationError(where, str(error)) from error
    except BaseException as error:  # a stranger's code may raise anything; it becomes an InputError
        if isinstance(error, OSError) and error.filename == str(file):
            fault = error.strerror or "an unreadable file"
            raise InputError(where, "", fault, _PLUGIN_FILE) from error
        fault = _describe_exception_on_one_line(error)
        if isinstance(error, ModuleNotFoundError):
            # A name on PyPI may be of a stranger's package.
            raise SituationError(where, f"{fault}; {_INSTALL}") from error
        raise InputError(where, "", fault, _IMPORTABLE) from error
    return module


def _describe_exception_on_one_line(error: BaseException) -> str:
    """Return class and message of an exception, on one line of limited length."""
    text = " ".join(str(error).split())[:300]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


@cache
def _find_plugin_entry_points() -> dict[str, metadata.EntryPoint]:
    """Return the entry points of installed packages that bring a solver, by name."""
    return {point.name: point for point in metadata.entry_points(group=GROUP)}


def find_plugin(name: str) -> Plugin | None:
    """Return a plug-in solver by name; None if there is none, InputError if it fails to load."""
    if name in _LOADED:
        return _LOADED[name]
    point = _find_plugin_entry_points().get(name)
    if point is None:
        return None
    where = f"entry point {point.name} = {point.value}"
    try:
        module = point.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a stranger's code may raise anything; it becomes an InputError
        raise InputError(
            where, "", _describe_exception_on_one_line(error), "an entry point that can be loaded"
        ) from error
    version = point.dist.version if point.dist is not None else ""
    plugin = _check_and_register_plugin(where, module, version, point.value)
    if plugin.record.name != name:
        raise InputError(where, "RECORD.name", repr(plugin.record.name), repr(name))
    return plugin


def list_plugin_names() -> set[str]:
    """Return the names of plug-in solvers, loaded or in an installed package."""
    return {*_LOADED, *_find_plugin_entry_points()}


def refuse_bad_or_taken_name(where: str, key: str, name: str, taken: Collection[str]) -> None:
    """Raise InputError for a new solver's name that has a path, or is one of dpbench's `taken`."""
    if not is_plain_file_name(name):
        raise InputError(where, key, repr(name), "a name without a path")
    if name in taken:
        raise InputError(where, key, repr(name), "a name that no solver of dpbench has")


def _check_and_register_plugin(
    where: str, module: Any, version: str, origin: str, taken: Collection[str] = ()
) -> Plugin:
    """Add a loaded plug-in to the known solvers if RECORD and open() are right; return it."""
    record, opener = getattr(module, "RECORD", None), getattr(module, "open", None)
    if not isinstance(record, SolverRecord):
        found = "nothing" if record is None else repr(record)
        raise InputError(where, "RECORD", found, "a SolverRecord, made by solver_record()")
    if not callable(opener):
        found = "nothing" if opener is None else repr(opener)
        raise InputError(where, "open", found, "a function of (policy, options)")
    refuse_bad_or_taken_name(where, "RECORD.name", record.name, taken)
    other = _LOADED.get(record.name)
    if other is not None and other.origin != origin:
        allowed = f"a name that no solver in {other.origin} has"
        raise InputError(where, "RECORD.name", repr(record.name), allowed)
    if set(record.routes) != {"native"}:
        raise InputError(where, "RECORD.routes", sorted(record.routes), "route native only")
    policies = record.routes["native"].policies
    if not policies or not set(policies) <= set(POLICIES):
        allowed = f"one or more of {', '.join(POLICIES)}"
        raise InputError(where, "RECORD.policies", repr(policies), allowed)
    if record.family not in get_args(Family):
        raise InputError(where, "RECORD.family", repr(record.family), ", ".join(get_args(Family)))
    row = replace(
        record, extra="plugin", levels=_read_tolerance_levels_of_plugin(where, module, record)
    )
    # `opener` states the option names of its function; those of another open() are unknown.
    names: list[str] | None = getattr(opener, "option_names", None)
    list_options = None if names is None else lambda: names
    adapter = NativeAdapter(row, _wrap_opener_to_check_result(opener), list_options)
    plugin = Plugin(adapter, version, origin)
    _LOADED[row.name] = plugin
    return plugin


def _read_tolerance_levels_of_plugin(where: str, module: Any, record: SolverRecord) -> Levels:
    """Return the tolerance levels that a plug-in states, or those of its record."""
    if not hasattr(module, "LEVELS") and hasattr(module, "LADDER"):
        warn_of_outdated_name(where, "LADDER", "LEVELS")
    return dict(getattr(module, "LEVELS", getattr(module, "LADDER", record.levels)))


def _wrap_opener_to_check_result(opener: Callable[[Policy, Options], Workspace]) -> OpenWorkspace:
    """Return a plug-in's open(), wrapped to raise InputError if it does not return a solver."""

    def open_plugin(record: SolverRecord, policy: Policy, options: Options) -> Workspace:
        workspace = opener(policy, options)
        if not isinstance(workspace, Workspace):
            raise InputError(f"solver {record.name}", "open", repr(workspace), "a Workspace")
        # A plug-in need not set this.
        workspace.setup_every_step = policy == "fresh"
        return workspace

    return open_plugin
