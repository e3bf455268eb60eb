"""What a campaign asks of whoever runs its cells, and the order in which cells are run.

An engine runs cells and hands over their results; it knows no result folder. The campaign alone
writes what is kept, one part a batch, so that nothing is there twice whatever an engine loses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Literal, Protocol

from dpbench.bench.engines.sources import SourceFiles
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.descriptions import MachineDescription
from dpbench.bench.workers.executor import CellJob, Result

WAVE_STEPS = 100_000
"""Steps of the sources that cells run from at a time: some 2 kB each."""
Kind = Literal["closed loops", "replays", "problems without a deadline"]
Target = Callable[[str, Path, str, int, Path], None]
"""What makes a file in a process of its own; see `Errand`."""
MadeFile = tuple[Path, Outcome]
"""A file, and what became of whoever made it."""
TlsFiles = Sequence[str | Path]
"""Of a cluster with TLS, in PEM format: its certificate authority, a client's certificate, its
key."""


class Engine(AbstractContextManager["Engine"], Protocol):
    """Runs cells; whatever it has started ends with the `with` block.

    Attributes
    ----------
    machine : the machine that cells run on, as `describe_machine` describes it; of several the one
        that times replays.
    remarks : lines for whoever started the campaign, at its end.
    """

    machine: MachineDescription

    @property
    def remarks(self) -> Sequence[str]: ...

    def prepare(self, sources: SourceFiles, solvers: Sequence[str], progress: Progress) -> None:
        """Get ready to run cells of some solvers.

        Parameters
        ----------
        sources : where the files behind QPs lie on the machine of the campaign.
        progress : told how far it is.
        """

    def run(self, jobs: Sequence[CellJob]) -> Iterator[Result]:
        """Run cells; yields the result of each, once, when it is known."""

    def make_files(
        self, target: Target, descriptions: Mapping[Path, str], *, limit_s: float | None = None
    ) -> Iterator[MadeFile]:
        """Make files from their descriptions, each in a process of its own; as in `Errand`."""


def stages(jobs: Sequence[CellJob]) -> Iterator[tuple[Kind, list[CellJob]]]:
    """Cells in the order they run: what is timed alone has nothing else beside it."""
    loops = [job for job in jobs if job.cell.mode == "closed_loop"]
    replays = [job for job in jobs if job.cell.mode == "replay"]
    yield "closed loops", loops
    yield "replays", [job for job in replays if job.cell.is_timed]
    yield "problems without a deadline", [job for job in replays if not job.cell.is_timed]


def waves(jobs: Sequence[CellJob]) -> Iterator[list[CellJob]]:
    """Jobs in groups whose sources have some `WAVE_STEPS` steps together."""
    wave: list[CellJob] = []
    steps = 0
    for alike in by_source(jobs).values():
        wave += alike
        steps += max(job.cell.last_step for job in alike)
        if steps >= WAVE_STEPS:
            yield wave
            wave, steps = [], 0
    if wave:
        yield wave


def by_source(jobs: Sequence[CellJob]) -> dict[str, list[CellJob]]:
    """Jobs by the key of the source of their QPs."""
    of_key: dict[str, list[CellJob]] = {}
    for job in jobs:
        of_key.setdefault(job.source_key, []).append(job)
    return of_key


def interleaved(jobs: Sequence[CellJob]) -> list[list[CellJob]]:
    """Replay jobs that see the same QPs, which are timed by turns."""
    groups: dict[str, list[CellJob]] = {}
    for job in jobs:
        groups.setdefault(job.cell.problem_key, []).append(job)
    return list(groups.values())


def longest(jobs: Sequence[CellJob]) -> Cell:
    """Of the cells of one source the one that needs most of it."""
    return max((job.cell for job in jobs), key=lambda cell: cell.last_step)


def without_source(jobs: Sequence[CellJob], outcome: Outcome) -> list[Result]:
    """Of cells whose QPs could not be made: by their nature, or by an accident of the harness."""
    what = "exactly solved loop" if jobs[0].cell.scenario else "sequence"
    became = "lost" if outcome.outcome == "lost" else "invalid"
    cause = Outcome(became, f"the {what} failed: {outcome.detail}")
    return [Result(job.run_id, cause) for job in jobs]
