"""The engines by name."""

import os
from contextlib import AbstractContextManager

from dpbench.bench.engines.engine import Engine, TlsFiles
from dpbench.bench.engines.local import LocalEngine
from dpbench.errors import InputError
from dpbench.locks import WaitLimit, find_safe_lock_folder

ENGINES = ("local", "dask")


def open_engine(
    name: str,
    jobs: int | None = None,
    scheduler: str | None = None,
    tls: TlsFiles | None = None,
    patience: WaitLimit = WaitLimit(),  # noqa: B008 - frozen
) -> AbstractContextManager[Engine]:
    """Open the engine that does a campaign's runs: "local" processes, or "dask" cluster workers.

    Without a `scheduler` the cluster is made of `jobs` workers of this machine; `patience` is with
    other campaigns on it. InputError for a bad option, without the extra of dask, and for a
    scheduler that does not answer or whose workers cannot run cells.
    """
    if name not in ENGINES:
        raise InputError("`engine`", "", repr(name), " or ".join(ENGINES))
    if name == "local" and scheduler is not None:
        raise InputError("`scheduler`", "", f"{scheduler} with engine local", "`engine` dask")
    if tls is not None and scheduler is None:
        raise InputError("`tls`", "", "files without `scheduler`", "`scheduler` tls://HOST:8786")
    if scheduler is not None and jobs is not None:
        found, allowed = f"{jobs} with `scheduler`", "one of the two: its workers are there"
        raise InputError("`jobs`", "", found, allowed)
    slots = count_slots(jobs)
    # Before anything is written: a folder that cannot be trusted refuses.
    find_safe_lock_folder()
    if name == "local":
        return LocalEngine(slots, patience)
    if patience != WaitLimit():
        raise InputError("`wait_s`", "", f"a limit with engine {name}", "engine local")
    try:
        # What an extra installs is imported only where it is asked for.
        from dpbench.bench.engines.dask_engine import open_dask_engine
    except ModuleNotFoundError as error:
        found, allowed = f"dask, without {error.name}", "pip install 'dpbench[cluster]', or local"
        raise InputError("`engine`", "", found, allowed) from error
    return open_dask_engine(scheduler, slots, tls)


def count_slots(jobs: int | None) -> int:
    """Return how many runs to do at a time: `jobs`, or all cores for None; InputError if more."""
    cores = len(os.sched_getaffinity(0))
    if jobs is not None and not 1 <= jobs <= cores:
        raise InputError("`jobs`", "", jobs, f"a number from 1 to {cores}, the cores available")
    return jobs or cores
