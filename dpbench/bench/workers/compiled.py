"""Compiled kernels in two modules, compiled side by side into Numba's cache."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable, Sequence

from dpbench.kernel_cache import cache_folders
from dpbench.solvers.own.adapters import WITH_KERNELS

LOOP, OWN = "dpbench.bench.workers.template", "dpbench.solvers.own.primed"
"""Modules that compile as they are imported: what every cell needs, and dpbench's own solvers."""
_LAST = {LOOP: "replay._reference_kernel-*.nbi", OWN: "hildreth._entry_point.*.nbi"}
"""The index in the cache of what each of them compiles last."""


def needed(solvers: Iterable[str]) -> list[str]:
    """Return the modules that cells of these solvers need; `LOOP`, which is the template, last."""
    return [OWN, LOOP] if set(solvers) & set(WITH_KERNELS) else [LOOP]


def missing(modules: Sequence[str]) -> list[str]:
    """Return the modules that are not in Numba's cache on this machine yet."""
    folders = cache_folders()
    return [m for m in modules if not any(any(f.rglob(_LAST[m])) for f in folders)]


def compile_in_processes(modules: Sequence[str]) -> None:
    """Compile each of the modules in a process of its own, side by side.

    The error of one that fails appears where its kernels are needed.
    """
    processes: list[subprocess.Popen[bytes]] = []
    try:
        for module in modules:
            program = [sys.executable, "-c", f"import {module}"]
            processes.append(subprocess.Popen(program, stderr=subprocess.DEVNULL))
        for process in processes:
            process.wait()
    finally:
        for process in processes:
            process.kill()
            process.wait()
