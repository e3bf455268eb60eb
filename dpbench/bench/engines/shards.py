"""Parts of a plan that run apart, on several machines."""

import json
import re
from dataclasses import asdict, dataclass, field
from heapq import heapify, heapreplace
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from dpbench.bench.plan.run_request import RunRequest
from dpbench.bench.record.cell import HARNESS_VERSION
from dpbench.bench.record.machine import find_running_revision
from dpbench.bench.record.result_folder import (
    MachineDescription,
    Revision,
    check_document_as_type,
    read_json,
    write_json,
)
from dpbench.bench.workers.jobs import (
    BATCH_CELLS,
    CellJob,
    configuration_key,
    count_steps,
    group_by_problem,
    group_by_source,
)
from dpbench.errors import InputError, SituationError, require_type

SHARD_FILE = "shard.json"
"""File that identifies the folder of a shard, there from its beginning on."""


MOST_SHARDS = 10_000
"""A study of a million loops of a minute each takes two hours in as many."""


@dataclass(frozen=True)
class Shard:
    """Part `index` (from 1) of the `count` parts into which a suite's runs are divided."""

    index: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.index <= self.count <= MOST_SHARDS:
            allowed = f"I/N, such as 1/4, with I from 1 to N and N up to {MOST_SHARDS}"
            raise InputError("`shard`", "", repr(str(self)), allowed)

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"

    @classmethod
    def from_text(cls, text: str | None) -> "Shard":
        """Return part i of n from a text "i/n", the whole for None; InputError for other texts."""
        if text is None:
            return WHOLE
        require_type("shard", text, str, "text I/N, such as 1/4")
        parts = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
        if parts is None:
            raise InputError("`shard`", "", repr(text)[:80], "I/N, such as 1/4, with I from 1 to N")
        return cls(*map(int, parts.groups()))

    def select_jobs(self, jobs: list[CellJob]) -> list[CellJob]:
        """Return the runs of this part of a suite, in order; all parts have about equal work.

        Cells of one source stay together as far as possible; replays of one sequence always do, as
        they are interleaved.
        """
        if self == WHOLE:
            return jobs
        share = _sum_planned_steps(jobs) / self.count
        bundles = []
        for alike in group_by_source(jobs).values():
            whole = _sum_planned_steps(alike) <= share
            bundles += [alike] if whole else _split_into_inseparable_groups(alike)
        # The largest first, each to whoever has least: a cell's own text settles who that is.
        bundles.sort(key=lambda some: (-_sum_planned_steps(some), some[0].cell.to_json()))
        loads = [(0, part) for part in range(1, self.count + 1)]
        heapify(loads)
        mine: set[str] = set()
        for some in bundles:
            load, part = loads[0]
            heapreplace(loads, (load + _sum_planned_steps(some), part))
            if part == self.index:
                mine |= {job.run_id for job in some}
        return [job for job in jobs if job.run_id in mine]


WHOLE = Shard(1, 1)


def _sum_planned_steps(jobs: list[CellJob]) -> int:
    """Sum the planned steps of all jobs."""
    return sum(count_steps(job.cell) for job in jobs)


def _split_into_inseparable_groups(jobs: list[CellJob]) -> list[list[CellJob]]:
    """Return runs on one file of QPs in the smallest groups that must stay on one machine."""
    units = group_by_problem([job for job in jobs if job.cell.is_timed])
    alike: dict[tuple[str, ...], list[CellJob]] = {}
    for job in jobs:
        if not job.cell.is_timed:
            alike.setdefault(configuration_key(job.cell), []).append(job)
    for some in alike.values():
        units += [some[i : i + BATCH_CELLS] for i in range(0, len(some), BATCH_CELLS)]
    return units


@dataclass(frozen=True, eq=False)
class ShardRecord:
    """Content of `shard.json`: the request, the part of it that ran, machine and version."""

    asked: RunRequest
    shard: Shard
    digest: str
    machine: MachineDescription
    harness_version: str = HARNESS_VERSION
    revision: Revision | None = field(default_factory=find_running_revision)

    def write(self, folder: Path) -> None:
        """Write `shard.json` into a result folder."""
        write_json(folder / SHARD_FILE, json.loads(json.dumps(asdict(self))))

    @classmethod
    def read(cls, folder: Path) -> "ShardRecord":
        """Read `shard.json` of a result folder; InputError where it is missing or damaged."""
        path = folder / SHARD_FILE
        if not path.exists():
            allowed = "a folder written by `dpbench cells`"
            if not folder.exists():
                raise InputError(str(folder), "", "no such folder", allowed)
            raise SituationError(str(folder), f"no shard in this folder; required: {allowed}")
        read = check_document_as_type(read_json(path), _ShardFile, path)
        return cls(**{name: getattr(read, name) for name in _ShardFile.model_fields})


class _ShardFile(BaseModel):
    """Types of the keys of `shard.json`, for validation."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)

    asked: RunRequest
    shard: Shard
    digest: str
    machine: MachineDescription
    harness_version: str
    revision: Revision | None
