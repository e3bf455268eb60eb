"""The engine of a cluster: batches of cells, and the sources of their QPs, as tasks of Dask.

A source is made on a worker, as an exactly solved loop takes as long as all of its cells together;
Dask hands its bytes to the workers whose cells need it, makes it anew where it was lost with its
worker, and lets it go after the last cell. Those that are needed next are made in one task, as a
process for each would take longer than the loop. What lies in files of the campaign's machine, as
recorded sequences do, is sent instead; what one task alone needs is made in that task.

Only some tasks more than there are slots are given away at a time: a batch that kills its worker
takes few others with it, and no scheduler holds a whole campaign.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import chain, count, groupby
from operator import getitem
from pathlib import Path
from typing import Any
from uuid import uuid4

from distributed import CancelledError, Future, KilledWorker, as_completed

from dpbench.bench.engines.dask_cluster import (
    EXCLUSIVE,
    connected,
    counted_anew,
    fleet_of,
    own_cluster,
)
from dpbench.bench.engines.engine import (
    Kind,
    MadeFile,
    Target,
    TlsFiles,
    by_source,
    interleaved,
    longest,
    stages,
    waves,
)
from dpbench.bench.engines.on_worker import Made, Order, given, make_files, run_cells
from dpbench.bench.engines.sources import SourceFiles
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.record.qp_source import RecordedSource
from dpbench.bench.sequences.source import is_readable, source_file
from dpbench.bench.workers.executor import (
    CellJob,
    Result,
    alternating,
    batch_cells,
    configuration_key,
    name_of,
    work_of,
)
from dpbench.bench.workers.worker import make_source
from dpbench.errors import CertificateError, InputError
from dpbench.files.writing import write_bytes

RETRIES = 2
"""How often a task is run again that failed by an error of the harness."""
AHEAD = 2
"""Tasks given away at a time, for each slot."""
RECOUNT_S = 5.0
"""How long the count of the slots holds: workers come and go."""
NOT_ALONE = (
    f"no worker offers the resource {EXCLUSIVE!r}: replays run beside others, and their times "
    "enter no ranking"
)


@dataclass(frozen=True, eq=False)
class Chunk:
    """Cells that are one task.

    suspect : whether workers died that had it; it is run with no other beside it then.
    """

    kind: Kind
    jobs: list[CellJob]
    suspect: bool = False

    @property
    def keys(self) -> list[str]:
        """Of the sources of their QPs."""
        return [*by_source(self.jobs)]

    def suspects(self) -> list[Chunk]:
        """What is to be run apart once workers died: replays of one sequence, or each cell."""
        apart = [self.jobs] if self.kind == "replays" else [[job] for job in self.jobs]
        return [Chunk(self.kind, jobs, suspect=True) for jobs in apart]


def dask_engine(scheduler: str | None, workers: int, tls: TlsFiles | None = None) -> DaskEngine:
    """The engine of a scheduler's workers, or of so many on this machine."""
    engine = DaskEngine(workers)
    with ExitStack() as until_connected:
        until_connected.push(engine)
        if scheduler is not None:
            engine.connect(scheduler, tls)
        until_connected.pop_all()
    return engine


class DaskEngine(ExitStack):
    """Runs cells on the workers of a cluster; an `Engine`.

    Parameters
    ----------
    workers : how many are started on this machine, unless it is connected to others.
    """

    def __init__(self, workers: int) -> None:
        super().__init__()
        self.machine = describe_machine()
        self.remarks: list[str] = []
        self._workers, self._where = workers, "on this machine"
        self._client: Any = None
        self._counted_s = time.monotonic()
        self._gone: CancelledError | None = None
        token = uuid4().hex[:8]
        # Two campaigns may ask one scheduler for the same.
        self._names = (f"{i}-{token}" for i in count())

    def connect(self, scheduler: str, tls: TlsFiles | None) -> None:
        """Take the workers of a scheduler; InputError where that cannot be."""
        self._client = self.enter_context(connected(scheduler, tls))
        self._where = f"at {scheduler}"
        self._fleet = fleet_of(self._client)
        self.machine = self._fleet.machine

    def prepare(self, sources: SourceFiles, solvers: Sequence[str], progress: Progress) -> None:
        """Start workers, where none are there."""
        self._sources, self._progress = sources, progress
        self._order = Order(solvers=tuple(dict.fromkeys(solvers)))
        if self._client is None:
            self._client = self.enter_context(own_cluster(self._workers))
            self._fleet = fleet_of(self._client)
        if self._fleet.kinds > 1:
            progress.remark(
                f"workers on {self._fleet.kinds} kinds of machines: replays of one kind are ranked"
            )

    def run(self, jobs: Sequence[CellJob]) -> Iterator[Result]:
        """Run cells kind by kind, so that nothing else runs while replays are timed."""
        modules = {job.cell.solver_module for job in jobs} - {""}
        texts = {path: Path(path).read_text(encoding="utf-8") for path in modules}
        self._order = Order(solvers=self._order.solvers, modules=texts)
        self._of_key = by_source(jobs)
        portions = [
            (kind, self._chunks(kind, wave))
            for kind, alike in stages(jobs)
            for wave in waves(alike)
        ]
        self._uses = Counter(
            key for _, chunks in portions for chunk in chunks for key in chunk.keys
        )
        self._single = {key for key, uses in self._uses.items() if uses == 1 and self._is_made(key)}
        self._kept: dict[str, Future] = {}
        self._together = self._made_together()
        if not self._fleet.exclusive and any(kind == "replays" for kind, _ in portions):
            self._progress.remark(NOT_ALONE)
        for kind, of_kind in groupby(portions, lambda portion: portion[0]):
            together = [chunks for _, chunks in of_kind]
            # Where times are taken no source is made beside them.
            for chunks in together if kind == "replays" else [[*chain.from_iterable(together)]]:
                if kind == "replays":
                    self._make_sources(chunks)
                yield from self._in_flight(chunks)

    def _make_sources(self, chunks: Sequence[Chunk]) -> None:
        """Make all that these need, and wait for it."""
        with suppress(CancelledError):
            made = {key: self._source(key) for chunk in chunks for key in chunk.keys}
            deque(as_completed(made.values(), loop=self._client.loop), maxlen=0)

    def make_files(
        self, target: Target, descriptions: Mapping[Path, str], *, limit_s: float | None = None
    ) -> Iterator[MadeFile]:
        """Have workers make files, and write them here."""
        futures: dict[Path, Future] = {}
        with suppress(CancelledError):
            for path, text in descriptions.items():
                futures[path] = self._files(target, {path.name: text}, limit_s)
        paths = {future.key: path for path, future in futures.items()}
        for future in as_completed(futures.values(), loop=self._client.loop):
            path, answer = paths[future.key], self._answer(future)
            (made,) = answer if isinstance(answer, list) else [Made(self._lost(answer))]
            if made.data:
                write_bytes(path, made.data)
            yield path, made.outcome
        for path in descriptions.keys() - futures.keys():
            yield path, self._lost(self._gone)

    def _chunks(self, kind: Kind, jobs: Sequence[CellJob]) -> list[Chunk]:
        """Cells that are tasks: replays of one sequence, or a batch of one configuration, and
        configurations by turns."""
        if kind == "replays":
            return [Chunk(kind, group) for group in interleaved(jobs)]
        most = batch_cells(len(jobs), self._fleet.slots)
        alike: dict[tuple[str, ...], list[CellJob]] = {}
        for job in jobs:
            alike.setdefault(configuration_key(job.cell), []).append(job)
        return alternating(
            [Chunk(kind, some[first : first + most]) for first in range(0, len(some), most)]
            for some in alike.values()
        )

    def _in_flight(self, chunks: Sequence[Chunk]) -> Iterator[Result]:
        """Give chunks away, some at a time; yields the results of each when it has come back.

        Whoever was on its way to a worker that died is as suspect as what ran there, so that these
        are run once more at the end, one by one: what kills then is known.
        """
        waiting, suspects, away = deque(chunks), deque[Chunk](), dict[str, Chunk]()
        completed = as_completed(loop=self._client.loop)

        def give_away() -> None:
            most = AHEAD * self._slots()
            with suppress(CancelledError):
                while len(away) < most and (waiting or (suspects and not away)):
                    queue = waiting or suspects
                    future = self._task(queue[0])
                    away[future.key] = queue.popleft()
                    completed.add(future)

        give_away()
        for future in completed:
            chunk, answer = away.pop(future.key), self._answer(future)
            if isinstance(answer, KilledWorker) and not chunk.suspect:
                apart = chunk.suspects()
                suspects += apart
                self._uses.update(key for one in apart for key in one.keys)
                answer = []
            yield from self._results(chunk, answer)
            future.release()
            give_away()
        for chunk in (*waiting, *suspects):
            yield from self._results(chunk, self._gone)

    def _slots(self) -> int:
        """Tasks that the workers run at a time, counted now and then."""
        if time.monotonic() - self._counted_s >= RECOUNT_S:
            self._fleet = counted_anew(self._client, self._fleet)
            self._counted_s = time.monotonic()
        return self._fleet.slots

    def _results(self, chunk: Chunk, answer: Any) -> Iterator[Result]:
        """The results of a chunk; the sources of which it was the last user are let go."""
        for key in chunk.keys:
            self._uses[key] -= 1
            if not self._uses[key] and key in self._kept:
                self._kept.pop(key).release()
        cells = {job.run_id: job.cell for job in chunk.jobs}
        if not isinstance(answer, list):
            lost = self._lost(answer)
            answer = [Result(run_id, lost) for run_id in cells]
        for result in answer:
            cell = cells[result.run_id]
            self._progress.advance(work_of(cell), name_of(cell))
            yield result

    def _answer(self, future: Future) -> Any:
        """What a task returned, or what it raised."""
        try:
            return future.result()
        except CancelledError as error:
            # Nobody else lets a task go: it went with the scheduler.
            self._gone = error
            return error
        except Exception as error:  # kept by `_lost` in the rows of its cells; others go on
            return error

    def _lost(self, error: object) -> Outcome:
        """What became of cells that have no answer: they are lost, whoever failed."""
        if isinstance(error, CancelledError):
            return Outcome("lost", f"the scheduler {self._where} went away")
        if isinstance(error, KilledWorker):
            return Outcome("lost", "every worker that it was given to died")
        return Outcome("lost", f"its worker failed: {type(error).__name__}: {error}"[:300])

    def _task(self, chunk: Chunk) -> Future:
        """A chunk on its way."""
        timed = chunk.kind == "replays"
        alone = timed and self._fleet.exclusive
        return self._submit(
            run_cells,
            self._order,
            chunk.kind,
            chunk.jobs,
            {key: self._source(key) for key in chunk.keys if key not in self._single},
            unmade={
                key: longest(self._of_key[key]).to_json()
                for key in chunk.keys
                if key in self._single
            },
            alone=alone,
            # What else runs on a machine that nobody has given over is not known.
            concurrency=1 if alone else max(2, self._fleet.concurrency),
            resources={EXCLUSIVE: 1} if alone else None,
            name=chunk.kind.replace(" ", "_"),
            retries=RETRIES,
        )

    def _submit(self, function: Callable[..., Any], *args: Any, name: str, **how: Any) -> Future:
        """A task on its way; CancelledError where the scheduler went away, with all that there was
        of tasks."""
        if self._gone is None and self._client.status != "running":
            self._gone = CancelledError()
        if self._gone is not None:
            raise self._gone
        key = f"{name}-{next(self._names)}"
        return self._client.submit(function, *args, key=key, pure=False, **how)

    def _is_made(self, key: str) -> bool:
        """Whether a source is made on a worker, at any time."""
        cell = longest(self._of_key[key])
        recorded = isinstance(cell.source, RecordedSource)
        there = recorded or is_readable(cell, self._sources.path(key))
        return not there and not any(job.cell.is_timed for job in self._of_key[key])

    def _made_together(self) -> dict[str, list[str]]:
        """By the key of a source that several tasks need, those that are made with it."""
        shared = [key for key in self._uses if key not in self._single]
        most = batch_cells(len(shared), self._fleet.slots)
        parts = [shared[first : first + most] for first in range(0, len(shared), most)]
        return {key: part for part in parts for key in part}

    def _source(self, key: str) -> Future:
        """What cells of that key need, once for all of them, as long as the longest of them asks
        for."""
        if key not in self._kept:
            alike = [other for other in self._together[key] if other not in self._kept]
            self._kept |= self._given(alike)
            self._kept |= self._made([other for other in alike if other not in self._kept])
        elif self._kept[key].status == "error":
            # Whichever of those that were made with it took their worker along.
            self._kept |= self._made([key])
        return self._kept[key]

    def _given(self, keys: Sequence[str]) -> dict[str, Future]:
        """Those of the sources that lie on this machine, or are made from what does."""
        cells = {key: (longest(self._of_key[key]), self._sources.path(key)) for key in keys}
        return {
            key: self._submit(given, _here(cell, path), name="source")
            for key, (cell, path) in cells.items()
            if isinstance(cell.source, RecordedSource) or is_readable(cell, path)
        }

    def _made(self, keys: Sequence[str]) -> dict[str, Future]:
        """Sources that are on their way to be made, in one task."""
        if not keys:
            return {}
        names = {key: self._sources.path(key).name for key in keys}
        texts = {name: longest(self._of_key[key]).to_json() for key, name in names.items()}
        together = self._files(make_source, texts, None)
        return {
            key: self._submit(getitem, together, i, name="source") for i, key in enumerate(keys)
        }

    def _files(self, target: Target, texts: Mapping[str, str], limit_s: float | None) -> Future:
        """Files on their way, by their names."""
        args = self._order, target, texts, limit_s
        return self._submit(make_files, *args, name=target.__name__, retries=RETRIES)


def _here(cell: Cell, path: Path) -> Made:
    """The file behind the QPs of a cell, made on this machine where it is not there."""
    if not is_readable(cell, path):
        try:
            source_file(cell).make(path)
        except (CertificateError, InputError) as error:
            return Made(Outcome("invalid", str(error)))
    return Made(Outcome("finished", ""), path.read_bytes())
