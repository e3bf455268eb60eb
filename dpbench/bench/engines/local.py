"""The engine of one machine: processes on its cores, sources in files beside the results."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from dpbench.bench.engines.engine import (
    Kind,
    MadeFile,
    Target,
    by_source,
    interleaved,
    longest,
    stages,
    waves,
    without_source,
)
from dpbench.bench.engines.sources import SourceFiles
from dpbench.bench.progress import Progress
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.sequences.source import is_readable
from dpbench.bench.workers.child import template_context
from dpbench.bench.workers.compiled import missing, needed
from dpbench.bench.workers.executor import Bench, CellJob, Result
from dpbench.bench.workers.scratch import Scratch
from dpbench.bench.workers.worker import make_source
from dpbench.locks import Patience

COMPILING = "compiling the kernels, once after an installation: up to a minute"


class LocalEngine(ExitStack):
    """Runs cells on this machine, some side by side; an `Engine`.

    Parameters
    ----------
    slots : processes at a time, on as many cores; timed replays run one at a time.
    patience : with other campaigns on this machine.
    """

    def __init__(self, slots: int, patience: Patience = Patience()) -> None:  # noqa: B008 - frozen
        super().__init__()
        self.machine = describe_machine()
        self._slots, self._patience = slots, patience

    @property
    def remarks(self) -> list[str]:
        """Where logs lay elsewhere than they should."""
        return self._scratch.remarks

    def prepare(self, sources: SourceFiles, solvers: Sequence[str], progress: Progress) -> None:
        """Start what processes are forked from."""
        if missing(needed(solvers)):
            progress.remark(COMPILING)
        self._sources = sources
        self._scratch = self.enter_context(Scratch(sources.folder))
        cores = sorted(os.sched_getaffinity(0))
        context = template_context(solvers)
        machine_id = str(self.machine["id"])
        self._bench = Bench(
            context,
            self._scratch,
            cores,
            self._slots,
            progress,
            machine_id,
            work=str(sources.folder.parent),
            patience=self._patience,
        )

    def run(self, jobs: Sequence[CellJob]) -> Iterator[Result]:
        """Run cells kind by kind, in waves of as many sources as are kept at a time."""
        waiting = {job.run_id: job for job in jobs}
        if jobs:
            self._bench.find_machine_free(times=any(job.cell.is_timed for job in jobs))
        for kind, alike in stages(jobs):
            for wave in waves(alike):
                for result in self._run_wave(kind, wave):
                    waiting.pop(result.run_id)
                    yield result
                self._sources.drop({job.source_key for job in waiting.values()})

    def make_files(
        self, target: Target, descriptions: Mapping[Path, str], *, limit_s: float | None = None
    ) -> Iterator[MadeFile]:
        """As `Bench.make_files`."""
        for errand in self._bench.make_files(target, descriptions, limit_s=limit_s):
            yield errand.path, errand.outcome

    def _run_wave(self, kind: Kind, jobs: list[CellJob]) -> Iterator[Result]:
        """Make the sources of cells and run them; once again what was lost by a source that was
        damaged since it was looked at."""
        by_id, lost = {job.run_id: job for job in jobs}, list[Result]()
        for result in self._attempt(kind, jobs):
            if result.is_lost:
                lost.append(result)
            else:
                yield result
        of_key = by_source([by_id[result.run_id] for result in lost])
        sound = {key: self._is_sound(alike) for key, alike in of_key.items()}
        again = [job for key, alike in of_key.items() if not sound[key] for job in alike]
        yield from (result for result in lost if sound[by_id[result.run_id].source_key])
        if again:
            yield from self._attempt(kind, again)

    def _attempt(self, kind: Kind, jobs: list[CellJob]) -> Iterator[Result]:
        unmade = list(self._make_sources(jobs))
        yield from unmade
        without = {result.run_id for result in unmade}
        jobs = [job for job in jobs if job.run_id not in without]
        paths = {job.source_key: self._sources.path(job.source_key) for job in jobs}
        if kind == "replays":
            yield from self._bench.replays(interleaved(jobs), paths)
        else:
            yield from self._bench.batches(jobs, paths, kind)

    def _make_sources(self, jobs: list[CellJob]) -> Iterator[Result]:
        """Make what the QPs of cells are made from, each as long as the longest of its cells asks
        for; yields the results of cells that cannot be run for want of it."""
        of_path = {self._sources.path(key): alike for key, alike in by_source(jobs).items()}
        unmade = {
            path: longest(alike).to_json()
            for path, alike in of_path.items()
            if not self._is_sound(alike)
        }
        for path, outcome in self.make_files(make_source, unmade):
            if outcome.outcome != "finished":
                yield from without_source(of_path[path], outcome)

    def _is_sound(self, alike: list[CellJob]) -> bool:
        """Whether the file behind the QPs of these cells can be read to its end."""
        return is_readable(longest(alike), self._sources.path(alike[0].source_key))
