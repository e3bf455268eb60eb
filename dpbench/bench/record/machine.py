"""The machine and the revision of dpbench that a result comes from."""

import hashlib
import importlib.metadata
import json
import os
import platform
import time
from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from pathlib import Path

import psutil
from threadpoolctl import threadpool_info

from dpbench.bench.record.git_commit import read_built_commit, read_commit
from dpbench.bench.record.result_folder import (
    ComparedMachine,
    MachineDescription,
    Revision,
    SuiteDescription,
)

_CPU = Path("/sys/devices/system/cpu/cpu0")
VECTOR_INSTRUCTIONS = ("sse4_2", "avx", "avx2", "fma", "avx512f", "asimd", "sve", "sve2")
"""Instruction sets that numerical libraries choose their code by."""
LIBRARIES = ("dpbench", "numpy", "scipy", "numba", "pandas", "qpsolvers")
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "RAYON_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Set to 1 in a worker's environment before NumPy loads, so that no library starts threads."""


def limit_libraries_to_one_thread() -> None:
    """Limit numerical libraries that are loaded later to one thread, by the environment."""
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"


def measure_clock_cost_and_resolution_ns() -> tuple[float, int]:
    """Return the clock's median cost of a reading and its smallest nonzero difference [ns]."""
    clock = time.perf_counter_ns
    reads = [clock() for _ in range(20_000)]
    steps = sorted(b - a for a, b in pairwise(reads))
    return float(steps[len(steps) // 2]), next((s for s in steps if s > 0), 0)


def describe_machine() -> MachineDescription:
    """Return this machine's description for `machine.json`; `id` hashes what timings depend on.

    A solver's own version is part of each cell's key instead.
    """
    (read_cost, resolution), clock = measure_clock_cost_and_resolution_ns(), psutil.cpu_freq()
    lasting: ComparedMachine = {
        "cpu_model": _read_cpu_model(),
        "cores": os.cpu_count() or 1,
        "memory_GiB": round(psutil.virtual_memory().total / 2**30),
        "kernel": f"{platform.system()} {platform.release()}",
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "versions": {name: _find_installed_version(name) for name in LIBRARIES},
    }
    digest = hashlib.sha256(json.dumps(lasting, sort_keys=True).encode()).hexdigest()
    return {
        "id": digest[:12],
        "cpu_family": _describe_cpu_family(_read_cpu_facts()),
        "vector_instructions": _list_vector_instructions(_read_cpu_facts()),
        **lasting,  # type: ignore[typeddict-item] # it has no other keys than those written above
        "governor": _read_frequency_governor(),
        "frequency_MHz": round(clock.current) if clock and clock.current else "not visible",
        "blas": _list_blas(),
        "throttle_counters": "visible" if (_CPU / "thermal_throttle").is_dir() else "not visible",
        "affinity": sorted(os.sched_getaffinity(0)),
        "clock_read_ns": read_cost,
        "timer_resolution_ns": resolution,
        "load_average": [round(value, 2) for value in os.getloadavg()],
    }


def _find_installed_version(distribution: str) -> str:
    """Return the version of an installed distribution, or "not installed"."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _read_frequency_governor() -> str:
    """Return the frequency governor of the processor, or "not visible"."""
    try:
        return (_CPU / "cpufreq" / "scaling_governor").read_text(encoding="ascii").strip()
    except OSError:
        return "not visible"


def _list_blas() -> list[str]:
    """Return the loaded BLAS libraries with version and processor kernels, a line each."""
    return [
        " ".join(
            str(pool[key]) for key in ("internal_api", "version", "architecture") if pool.get(key)
        )
        for pool in threadpool_info()
        if pool["user_api"] == "blas"
    ]


def _read_cpu_facts() -> dict[str, str]:
    """Return what Linux describes of the first processor core, by name; empty elsewhere."""
    try:
        first = Path("/proc/cpuinfo").read_text(encoding="utf-8").partition("\n\n")[0]
    except OSError:
        return {}
    pairs = (line.partition(":") for line in first.splitlines())
    return {name.strip(): value.strip() for name, _, value in pairs}


def _read_cpu_model() -> str:
    """Return the name of the processor, from Linux or else from Python."""
    return _read_cpu_facts().get("model name") or platform.processor() or platform.machine()


def _describe_cpu_family(facts: Mapping[str, str]) -> str:
    """Return maker, family and model of a processor, which its name may leave out."""
    numbers = {"family": "cpu family", "model": "model", "stepping": "stepping"}
    named = [f"{word} {facts[key]}" for word, key in numbers.items() if key in facts]
    maker = facts.get("vendor_id", "")
    return " ".join(filter(None, (maker, ", ".join(named)))) or "not visible"


def _list_vector_instructions(facts: Mapping[str, str]) -> list[str]:
    """Return the vector instruction sets of a processor, in Linux' words."""
    flags = (facts.get("flags") or facts.get("Features", "")).split()
    return [name for name in VECTOR_INSTRUCTIONS if name in flags]


@cache
def find_running_revision() -> Revision | None:
    """Return the git revision of the running dpbench package; None where unknown."""
    package = Path(__file__).parents[2]
    found = read_commit(package) or read_installed_commit() or read_built_commit(package)
    return None if found is None else Revision(commit=found[0], clean=found[1])


def read_installed_commit() -> tuple[str, bool] | None:
    """Return the commit that dpbench was installed from, by its installer's note (PEP 610)."""
    try:
        noted = importlib.metadata.distribution("dpbench").read_text("direct_url.json")
    except importlib.metadata.PackageNotFoundError:
        return None
    commit = json.loads(noted or "{}").get("vcs_info", {}).get("commit_id")
    return None if commit is None else (str(commit), True)


def append_revision(earlier: list[Revision], now: Revision | None) -> list[Revision]:
    """Return the dpbench revisions of earlier runs, followed by the current one."""
    return [*(one for one in earlier if one != now), *([now] if now else [])]


def describe_revisions(suite: SuiteDescription) -> str:
    """Return the dpbench commits in `suite.json` as text; "" where there are none."""
    named = [
        f"{one['commit'][:12]}{'' if one['clean'] else ' with changes'}"
        for one in suite.get("revisions", [])
    ]
    return f"commit {', '.join(named)}" if named else ""


def describe_version(suite: SuiteDescription) -> str:
    """Return the dpbench version and commits in `suite.json` as text."""
    version = f"dpbench {suite.get('harness_version', '')}"
    # In brackets, or it is taken for the commit of the solver.
    return f"{version} ({describe_revisions(suite) or 'commit not known'})"
