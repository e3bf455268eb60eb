"""What a campaign will take, by a sample of its own cells run here and now.

Of each kind, the cells of one configuration in one mode, some are run, judged and stored as in the
campaign, in one round: once with `FEW` steps and once with `MANY`. What the clock showed, less the
solvers' own time, is the harness's: so much a cell and so much a step, alike for all kinds.

    time = Σ over cells (a + (h + s_kind) · steps) / slots
    slots · wall − Σ solvers = a · cells + h · steps
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq

from dpbench.bench.campaign import Campaign
from dpbench.bench.engines.open_engine import open_engine
from dpbench.bench.plan.asked import Asked
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.progress import Progress, Silent
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.configuration import COLUMNS
from dpbench.bench.record.recorded_steps import read_steps
from dpbench.bench.record.result_folder import claimed
from dpbench.bench.sequences.source import is_at_edge, is_untimed
from dpbench.errors import InputError
from dpbench.locks import FOR_NOBODY

FEW, MANY = 10, 100
"""Steps of the sampled cells, at most."""
SHARE, MOST = 20, 32
"""Of a kind every twentieth cell is sampled, but no more than share a process."""
_KIND = ["mode", *COLUMNS]
Kind = tuple[str, ...]
Run = Callable[[Sequence[PlannedCell], Path], object]
"""Runs cells into a folder as a campaign."""


@dataclass(frozen=True)
class Estimate:
    """What a campaign will take.

    Parameters
    ----------
    cells, refused : how many run, and how many are rows without running.
    unmeasured : how many run whose time and size are in none of these figures.
    steps : that are recorded, of all rounds.
    time_s : on the slots it was measured for, without the report; size_bytes : of its tables.
    slots : closed loops at a time.
    sampled, took_s : cells that were run to know, and how long that took.
    """

    cells: int
    refused: int
    unmeasured: int
    steps: int
    time_s: float
    size_bytes: float
    slots: int
    sampled: int
    took_s: float

    @property
    def lines(self) -> list[str]:
        """What to print of it."""
        refused = f" and {_count(self.refused)} refused" if self.refused else ""
        apart = f"; {_count(self.unmeasured)} more of capability plots" if self.unmeasured else ""
        return [
            f"{_count(self.cells)} cells to run{refused}: {_count(self.steps)} recorded steps",
            f"about {_duration(self.time_s)} on this machine, {self.slots} closed loops at a time, "
            f"and {self.size_bytes / 1e6:.1f} MB of tables; without the report{apart}",
            f"measured just now in {_duration(self.took_s)}: {_count(self.sampled)} of the cells "
            f"in one round, of {FEW} and of {MANY} steps at most",
        ]


def _count(number: int) -> str:
    return f"{number:,}".replace(",", " ")


def _duration(seconds: float) -> str:
    """In the unit that leaves two digits or three."""
    for size, unit in ((86_400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.2g} s"


def recorded_steps(cell: Cell) -> int:
    """Steps that a cell leaves in the tables when it comes to its end."""
    return cell.steps * cell.rounds + cell.warmup_steps if cell.mode == "replay" else cell.steps


def estimated(planned: Sequence[PlannedCell], slots: int, run: Run) -> Estimate:
    """Run a sample of some cells, and say what all of them take.

    Capability plots, which take minutes each, are not measured.

    Parameters
    ----------
    slots : closed loops at a time; replays along a loop run one after the other.
    """
    started = time.monotonic()
    to_run = [p for p in planned if not p.refused]
    measured = [p for p in to_run if not is_at_edge(p.cell)]
    groups: dict[str, list[PlannedCell]] = {"loops": [], "replays": [], "untimed": []}
    for p in measured:
        replay = "untimed" if is_untimed(p.cell) else "replays"
        groups["loops" if p.cell.mode == "closed_loop" else replay].append(p)
    samples: list[tuple[_Sample, list[PlannedCell]]] = []
    with tempfile.TemporaryDirectory(prefix="dpbench-") as folder:
        # The first campaign of a process starts what all later ones find there.
        if measured:
            run([_cut(p, FEW) for p in measured[:1]], Path(folder) / "first")
        for name, cells in groups.items():
            if cells:
                at_a_time = 1 if name == "replays" else slots
                samples.append((_Sample(cells, run, Path(folder) / name, at_a_time), cells))
    return Estimate(
        len(to_run),
        len(planned) - len(to_run),
        len(to_run) - len(measured),
        sum(recorded_steps(p.cell) for p in to_run),
        sum(sample.time_s(cells) for sample, cells in samples),
        sum(sample.size_bytes(cells) for sample, cells in samples),
        slots,
        sum(sample.count for sample, _ in samples),
        time.monotonic() - started,
    )


def _kind(cell: Cell) -> Kind:
    return tuple(str(getattr(cell, name)) for name in _KIND)


def _cut(planned: PlannedCell, most: int) -> PlannedCell:
    """The same cell in one round, with few steps where its QPs are those along a loop."""
    cell = planned.cell
    steps = min(cell.steps, most) if cell.scenario else cell.steps
    rounds, warm_up = min(cell.rounds, 1), min(cell.warmup_steps, steps)
    return PlannedCell(replace(cell, steps=steps, rounds=rounds, warmup_steps=warm_up))


class _Sample:
    """Some cells of each kind, run twice below a folder with so many at a time."""

    def __init__(self, cells: Sequence[PlannedCell], run: Run, folder: Path, slots: int) -> None:
        kinds: dict[Kind, list[PlannedCell]] = {}
        for planned in cells:
            kinds.setdefault(_kind(planned.cell), []).append(planned)
        some = [
            planned
            for alike in kinds.values()
            for planned in alike[:: max(SHARE, -(-len(alike) // MOST))]
        ]
        self.count, self._slots = len(some), slots
        steps, harness_s = [0, 0], [0.0, 0.0]
        for i, most in enumerate((FEW, MANY)):
            started = time.monotonic()
            run([_cut(planned, most) for planned in some], folder / str(most))
            wall_s = time.monotonic() - started
            of_kind = _solver_times(folder / str(most))
            steps[i] = int(of_kind["size"].sum())
            harness_s[i] = max(0.0, slots * wall_s - 1e-9 * float(of_kind["sum"].sum()))
        added = steps[1] - steps[0]
        self._of_step_s = max(0.0, harness_s[1] - harness_s[0]) / added if added else 0.0
        self._of_cell_s = max(0.0, harness_s[1] - self._of_step_s * steps[1]) / len(some)
        self._solver_s = (1e-9 * of_kind["sum"] / of_kind["size"].clip(lower=1)).to_dict()
        tables = (folder / str(MANY) / f"{name}.parquet" for name in ("runs", "steps"))
        self._of_run_bytes, self._of_step_bytes = map(_bytes_of_row, tables)

    def time_s(self, cells: Sequence[PlannedCell]) -> float:
        """What cells of these kinds take."""
        work = ((recorded_steps(p.cell), self._solver_s.get(_kind(p.cell), 0.0)) for p in cells)
        took = sum(self._of_cell_s + (self._of_step_s + solver_s) * n for n, solver_s in work)
        return float(took / self._slots)

    def size_bytes(self, cells: Sequence[PlannedCell]) -> float:
        """What their rows take in the tables, under each name of their settings."""
        rows = [(1 + len(p.alias_settings), recorded_steps(p.cell)) for p in cells]
        return sum(n * (self._of_run_bytes + self._of_step_bytes * steps) for n, steps in rows)


def _solver_times(folder: Path) -> pd.DataFrame:
    """`sum` of the step times [ns] and `size`, how many they are, of each kind."""
    steps = read_steps(folder, ["run_id", "total_ns"]).to_pandas()
    by_run = steps.groupby("run_id", observed=True)["total_ns"].agg(["sum", "size"])
    runs = pq.read_table(folder / "runs.parquet", columns=["run_id", *_KIND]).to_pandas()
    timed_runs = runs.join(by_run, on="run_id").fillna({"sum": 0.0, "size": 0})
    of_kind: pd.DataFrame = timed_runs.groupby(_KIND)[["sum", "size"]].sum()
    return of_kind


def _bytes_of_row(path: Path) -> float:
    """What a row of a table takes in its file."""
    about = pq.read_metadata(path)
    groups = [about.row_group(i) for i in range(about.num_row_groups)]
    size = sum(g.column(j).total_compressed_size for g in groups for j in range(g.num_columns))
    return float(size / max(1, about.num_rows))


def estimate_campaign(
    suite: str | Path | None = None,
    *,
    jobs: int | None = None,
    engine: str = "local",
    progress: Progress | None = None,
    **asked: Any,
) -> Estimate:
    """What `run_campaign` would take on this machine, of which `asked` are other arguments; nothing
    is left behind.

    Raises
    ------
    InputError : as there, and for another engine than that of this machine.
    """
    if engine != "local":
        raise InputError("--dry-run", "", f"engine {engine}", "engine local, which is measured")
    plan = Asked(None if suite is None else str(suite), **asked).plan()
    (progress or Silent()).advance(0, "running a few of the cells")

    def run(cells: Sequence[PlannedCell], folder: Path) -> None:
        with open_engine(engine, jobs, patience=FOR_NOBODY) as opened, claimed(folder, plan.name):
            sample = replace(plan, cells=list(cells))
            Campaign(sample, [], folder, opened.machine).run(opened, Silent())

    return estimated(plan.cells, jobs or len(os.sched_getaffinity(0)), run)
