"""Parts of a plan that can be run apart, by whatever starts commands on several machines."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, field
from heapq import heapify, heapreplace
from pathlib import Path
from typing import Any

from dpbench.bench.engines.engine import by_source, interleaved
from dpbench.bench.plan.asked import Asked
from dpbench.bench.record.cell import HARNESS_VERSION
from dpbench.bench.record.result_folder import read_json, write_json
from dpbench.bench.record.revision import Revision, revision
from dpbench.bench.sequences.source import is_timed
from dpbench.bench.workers.executor import BATCH_CELLS, CellJob, configuration_key, work_of
from dpbench.errors import InputError, ResultsError

SHARD_FILE = "shard.json"
"""What a folder of a shard says of it, from its beginning on."""


@dataclass(frozen=True)
class Shard:
    """The part `index` of `count`, from 1."""

    index: int
    count: int

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"

    @classmethod
    def of_text(cls, text: str | None) -> Shard:
        """Of "i/n"; the whole for None. InputError for what is no part."""
        if text is None:
            return WHOLE
        parts = re.fullmatch(r"(\d+)/(\d+)", text)
        shard = cls(*map(int, parts.groups())) if parts else cls(0, 0)
        if not 1 <= shard.index <= shard.count:
            raise InputError("--shard", "", repr(text), "i/n, as 1/4, with i from 1 to n")
        return shard

    def of_jobs(self, jobs: list[CellJob]) -> list[CellJob]:
        """The jobs of this part, in their order: the same wherever it is asked for.

        Parts are of about the same work. Each makes the sources of its own cells, so that cells of
        one source stay together as far as that allows; replays of one sequence always do, which are
        timed by turns.
        """
        if self == WHOLE:
            return jobs
        share = sum(_work(job) for job in jobs) / self.count
        bundles = []
        for alike in by_source(jobs).values():
            whole = sum(map(_work, alike)) <= share
            bundles += [alike] if whole else _units(alike)
        # The largest first, each to whoever has least: a cell's own text settles who that is.
        bundles.sort(key=lambda some: (-sum(map(_work, some)), some[0].cell.to_json()))
        loads = [(0, part) for part in range(1, self.count + 1)]
        heapify(loads)
        mine: set[str] = set()
        for some in bundles:
            load, part = loads[0]
            heapreplace(loads, (load + sum(map(_work, some)), part))
            if part == self.index:
                mine |= {job.run_id for job in some}
        return [job for job in jobs if job.run_id in mine]


WHOLE = Shard(1, 1)


def _work(job: CellJob) -> int:
    """What it takes where it can run: who divides it knows not what the others have installed."""
    return work_of(job.cell)


def _units(jobs: list[CellJob]) -> list[list[CellJob]]:
    """Jobs of one source in the smallest groups that stay together: replays of one sequence, and
    batches of one configuration."""
    units = interleaved([job for job in jobs if is_timed(job.cell)])
    alike: dict[tuple[str, ...], list[CellJob]] = {}
    for job in jobs:
        if not is_timed(job.cell):
            alike.setdefault(configuration_key(job.cell), []).append(job)
    for some in alike.values():
        units += [some[i : i + BATCH_CELLS] for i in range(0, len(some), BATCH_CELLS)]
    return units


@dataclass(frozen=True, eq=False)
class ShardRecord:
    """What a folder says of the shard in it.

    Parameters
    ----------
    digest : of the whole plan; machine : the one it runs on; revision : of dpbench.
    """

    asked: Asked
    shard: Shard
    digest: str
    machine: dict[str, Any]
    harness_version: str = HARNESS_VERSION
    revision: Revision = field(default_factory=revision)

    def write(self, folder: Path) -> None:
        """Write it into a folder."""
        write_json(folder / SHARD_FILE, json.loads(json.dumps(asdict(self))))

    @classmethod
    def read(cls, folder: Path) -> ShardRecord:
        """That of a folder; InputError where it has none."""
        try:
            document = read_json(folder / SHARD_FILE)
            asked, shard = Asked(**document.pop("asked")), Shard(**document.pop("shard"))
            return cls(asked=asked, shard=shard, **document)
        except (ResultsError, KeyError, TypeError) as error:
            allowed = "a folder of `dpbench cells`"
            raise InputError("gather", "", f"{folder} without a shard", allowed) from error
