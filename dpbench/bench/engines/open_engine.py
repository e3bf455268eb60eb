"""The engines by name; that of one machine: processes on its cores, sources in files."""

import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack

from dpbench.bench.engines.engine import BATCHES_AHEAD, Completed, Engine, SourceFiles, TlsFiles
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.sequences.source import is_readable
from dpbench.bench.workers.child import has_compiled_kernels, start_forkserver
from dpbench.bench.workers.executor import CellExecutor
from dpbench.bench.workers.jobs import Batch, CellBatch, CellJob
from dpbench.bench.workers.scratch import Scratch
from dpbench.errors import InputError, SituationError, require_type, shorten_found
from dpbench.kernel_cache import COMPILING, is_compilation_announced
from dpbench.locks import WaitLimit, find_safe_lock_folder

ENGINES = ("local", "dask")


class LocalEngine(ExitStack):
    """Engine that does runs in `slots` processes on this machine; timed replays one at a time."""

    def __init__(self, slots: int, patience: WaitLimit = WaitLimit()) -> None:  # noqa: B008 - frozen, shared
        super().__init__()
        self.machine = describe_machine()
        self.slots, self._patience = slots, patience

    @property
    def remarks(self) -> list[str]:
        """Remarks on raw logs of runs that had no room in the usual folder."""
        return self._scratch.remarks

    def prepare(self, sources: SourceFiles, jobs: Sequence[CellJob], progress: Progress) -> None:
        """Start the server that forks processes, open temporary folders, check machine load."""
        if not (has_compiled_kernels() or is_compilation_announced()):
            progress.remark(COMPILING)
        self._sources = sources
        self._scratch = self.enter_context(Scratch(sources.folder))
        executor = CellExecutor(
            start_forkserver(),
            self._scratch,
            sorted(os.sched_getaffinity(0)),
            self.slots,
            progress,
            self.machine["id"],
            work=str(sources.folder.parent),
            patience=self._patience,
        )
        self._executor = self.enter_context(executor)
        if jobs:
            executor.check_machine_free(times=any(job.cell.is_timed for job in jobs))

    def count_batches_to_submit(self, *, timed: bool) -> int:
        """Return how many batches of runs to submit ahead: one if timed, else two per process."""
        return 1 if timed else BATCHES_AHEAD * self.slots

    def submit(self, batch: Batch) -> None:
        """Start or queue a batch of runs on the cores of this machine."""
        keys = batch.source_keys if isinstance(batch, CellBatch) else []
        self._executor.submit(batch, {key: self._sources.path(key) for key in keys})

    def yield_completed_batches(self) -> Iterator[Completed]:
        """Wait for completed batches of runs; yield each with its results."""
        return self._executor.wait_for_batches()

    def is_qp_file_intact(self, key: str, cell: Cell) -> bool:
        """Return whether the file of a run's QPs can be read to its end."""
        return is_readable(cell, self._sources.path(key))

    def release_source(self, key: str) -> None:
        """Delete a file of QPs that no run needs any more."""
        self._sources.remove(key)


def open_engine(
    name: str,
    jobs: int | None = None,
    scheduler: str | None = None,
    tls: TlsFiles | None = None,
    patience: WaitLimit = WaitLimit(),  # noqa: B008 - frozen, shared
) -> AbstractContextManager[Engine]:
    """Return the engine that does a campaign's runs: "local" processes, or "dask" cluster workers.

    Without a `scheduler` the cluster is made of `jobs` workers of this machine; `patience` is with
    other campaigns on it. InputError for a bad option, without the extra of dask, and for a
    scheduler that does not answer or whose workers cannot run cells.
    """
    slots = check_engine_options(name, jobs, scheduler, tls)
    # Before anything is written: a folder that cannot be trusted refuses.
    find_safe_lock_folder()
    if name == "local":
        return LocalEngine(slots, patience)
    if patience != WaitLimit():
        raise InputError(
            "`wait_s`", "", f"a limit with engine {name}", "`engine` local, or no limit"
        )
    try:
        # What an extra installs is imported only where it is asked for.
        from dpbench.bench.engines.dask_engine import open_dask_engine
    except ModuleNotFoundError as error:
        fault = f"dask needs the {error.name} package, which is not installed"
        remedy = "run `pip install 'dpbench[cluster]'`, or use the local engine"
        raise SituationError("`engine`", f"{fault}: {remedy}") from error
    return open_dask_engine(scheduler, slots, tls)


def check_engine_options(
    name: str, jobs: int | None, scheduler: str | None, tls: TlsFiles | None
) -> int:
    """Return how many runs to do at a time; InputError for options that do not fit an engine."""
    require_type("scheduler", scheduler, str | None, "the address of a Dask scheduler")
    three_files = "the files of the certificate authority, the certificate and the key"
    require_type("tls", tls, Sequence | None, three_files)
    if tls is not None and len(tls) != 3:
        raise InputError("`tls`", "", shorten_found(tls), three_files)
    if name not in ENGINES:
        raise InputError("`engine`", "", repr(name), " or ".join(ENGINES))
    if name == "local" and scheduler is not None:
        raise InputError("`scheduler`", "", f"{scheduler} with engine local", "`engine` dask")
    if tls is not None and scheduler is None:
        raise InputError("`tls`", "", "files without `scheduler`", "`scheduler` tls://HOST:8786")
    if scheduler is not None and jobs is not None:
        found, allowed = (
            f"{jobs} with `scheduler`",
            "one of the two, as a scheduler has its own workers",
        )
        raise InputError("`jobs`", "", found, allowed)
    return count_slots(jobs)


def count_slots(jobs: int | None) -> int:
    """Return how many runs to do at a time: `jobs`, or all cores for None; InputError if more."""
    cores = len(os.sched_getaffinity(0))
    if jobs is not None and not 1 <= jobs <= cores:
        raise InputError("`jobs`", "", jobs, f"1 to {cores}, the number of available cores")
    return jobs or cores
