"""Cells to run and files to make, their results, and batches of them."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeVar

from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.record.cell import CONFIGURATION_COLUMNS, HARNESS_VERSION, Cell, Outcome
from dpbench.bench.record.step_table import BatchPart
from dpbench.solvers.table import Availability

Item = TypeVar("Item")
Key = TypeVar("Key")
CELL_S, STEP_S = 0.009, 0.00025
"""Rates measured for `docs/guide/scale.md`: a cell, and a step of it with its judgement."""
BATCH_CELLS = 32  # Cells of a batch at most
SHORTEST_S, LONGEST_S = 0.1, 1.0
"""Work of a batch by those rates, from the least worth a process to what an accident may cost (4000
steps leave some 8 MB of raw logs). A longer cell is a batch of its own."""
BATCHES_PER_SLOT = 4
"""Batches of a slot at least, as far as that allows: all slots end at about the same time."""
Kind = Literal["closed loops", "replays", "problems without a deadline"]
Target = Callable[[str, Path, str, int, Path], None]
"""Makes a file in a process, called as target(description, folder, name, core, path)."""


@dataclass(eq=False)
class CellJob:
    """A planned run with its run_id, solver version and outcome; `machine_id` is in its run_id.

    campaign_utc : see the column of that name.
    """

    planned: PlannedCell
    run_id: str
    library: Availability
    machine_id: str
    outcome: Outcome | None = None
    campaign_utc: str = ""

    @property
    def cell(self) -> Cell:
        """The description of the planned run, without its id and outcome."""
        return self.planned.cell

    @cached_property
    def source_key(self) -> str:
        """Hash key of the file of the run's QPs, shared by runs that use the same file."""
        return self.cell.source_key(HARNESS_VERSION)


@dataclass(frozen=True)
class Result:
    """Outcome of a run by run_id or of a file by path; part : the finished cells, or None."""

    run_id: str
    outcome: Outcome
    part: BatchPart | None = None


@dataclass(eq=False)
class CellBatch:
    """Runs of one solver configuration that share a process, or timed replays of one sequence.

    isolated : whether it runs alone, because an earlier process of it took others along.
    attempts : how often it was handed over in vain.
    shown_work : steps that the progress bar shows of it before it is completed.
    """

    kind: Kind
    jobs: Sequence[CellJob]
    isolated: bool = False
    attempts: int = 0
    shown_work: int = 0

    @property
    def is_timed(self) -> bool:
        """Return whether the batch is timed, so that nothing else may run on the machine."""
        return self.kind == "replays"

    @property
    def names(self) -> list[str]:
        """The run_id of each run of the batch."""
        return [job.run_id for job in self.jobs]

    @property
    def source_keys(self) -> list[str]:
        """Hash keys of the files of the batch's QPs, each once."""
        return [*group_by_source(self.jobs)]

    def split_for_isolated_retry(self, names: Collection[str]) -> "list[CellBatch]":
        """Return batches to do the runs `names` again, alone; timed replays stay together."""
        jobs = [job for job in self.jobs if job.run_id in names]
        groups = [jobs] if self.is_timed else [[job] for job in jobs]
        return [CellBatch(self.kind, group, isolated=True) for group in groups]


@dataclass(eq=False)
class FileBatch:
    """Files, mostly of QPs, to be made one after the other in one process.

    texts : the description of each file, by its path.
    limit_s : time limit of each; None for none.
    are_sources : whether cells need them: they are stored where the cells run.
    isolated, attempts : as of a `CellBatch`.
    """

    target: Target
    texts: Mapping[Path, str] = field(default_factory=dict)
    limit_s: float | None = None
    are_sources: bool = False
    isolated: bool = False
    attempts: int = 0
    is_timed = False

    @property
    def names(self) -> list[str]:
        """The path of each file of the batch, as text."""
        return [str(path) for path in self.texts]

    def split_for_isolated_retry(self, names: Collection[str]) -> "list[FileBatch]":
        """Return a batch for each of the files `names`, to be made again alone."""
        return [
            FileBatch(self.target, {path: text}, self.limit_s, self.are_sources, isolated=True)
            for path, text in self.texts.items()
            if str(path) in names
        ]


Batch = CellBatch | FileBatch


def group_jobs(jobs: Iterable[CellJob], key: Callable[[CellJob], Key]) -> dict[Key, list[CellJob]]:
    """Return runs grouped by a key, in the order in which the keys appear."""
    groups: dict[Key, list[CellJob]] = {}
    for job in jobs:
        groups.setdefault(key(job), []).append(job)
    return groups


def group_by_source(jobs: Iterable[CellJob]) -> dict[str, list[CellJob]]:
    """Return runs grouped by the file of their QPs."""
    return group_jobs(jobs, lambda job: job.source_key)


def group_by_problem(jobs: Iterable[CellJob]) -> list[list[CellJob]]:
    """Return replays grouped by their QPs; the solvers of a group are interleaved."""
    return list(group_jobs(jobs, lambda job: job.cell.problem_key).values())


def configuration_key(cell: Cell) -> tuple[str, ...]:
    """Return a key that is equal for runs that may share a worker process."""
    return (cell.mode, cell.backup, *(getattr(cell, name) for name in CONFIGURATION_COLUMNS))


def split_into_batches(kind: Kind, jobs: Sequence[CellJob], slots: int) -> list[CellBatch]:
    """Return runs of one kind as batches, sea by sea, enough to keep `slots` processes busy."""
    if kind == "replays":
        return [CellBatch(kind, group) for group in group_by_problem(jobs)]
    alike = group_jobs(jobs, lambda job: configuration_key(job.cell))
    size_s = choose_batch_seconds(sum(estimate_cell_seconds(job) for job in jobs), slots)
    groups = [
        g for some in alike.values() for g in cut_into_groups(some, estimate_cell_seconds, size_s)
    ]
    turn = {key: i for i, key in enumerate(group_by_source(jobs))}
    groups.sort(key=lambda group: turn[group[0].source_key])
    return [CellBatch(kind, group) for group in groups]


def choose_batch_seconds(total_s: float, slots: int) -> float:
    """Return how long a batch of runs should take [s], so that all `slots` processes get some."""
    return min(LONGEST_S, max(SHORTEST_S, total_s / (BATCHES_PER_SLOT * slots)))


def cut_into_groups(
    items: Iterable[Item], seconds_of: Callable[[Item], float], size_s: float
) -> Iterator[list[Item]]:
    """Yield groups of runs or files with `size_s` of work or more, at most `LONGEST_S`."""
    group: list[Item] = []
    total_s = 0.0
    for item in items:
        seconds = seconds_of(item)
        if group and total_s + seconds > LONGEST_S:
            yield group
            group, total_s = [], 0.0
        group.append(item)
        total_s += seconds
        if total_s >= size_s or len(group) == BATCH_CELLS:
            yield group
            group, total_s = [], 0.0
    if group:
        yield group


def estimate_cell_seconds(job: CellJob) -> float:
    """Return the expected time of a run [s], by measured times of a run and a step."""
    return CELL_S + STEP_S * count_steps(job.cell)


def count_steps(cell: Cell) -> int:
    """Return the number of steps a run will take, for the progress bar."""
    return cell.steps * max(1, cell.rounds)


def make_cell_label(cell: Cell) -> str:
    """Return a run's solver and scenario or sequence as text, for the progress bar."""
    return f"{cell.solver} {cell.scenario_name or cell.sequence}"
