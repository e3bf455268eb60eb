"""The files behind the QPs of cells: made once a source, then read by workers and evaluators.

A file has the exactly solved loop, or a sequence with its certified optima.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from dpbench.bench.record.cell import (
    CapabilitySource,
    Cell,
    ConsequenceSource,
    ControllerSource,
    HardestSource,
    QPSource,
    RandomSource,
    RecordedSource,
)
from dpbench.bench.record.npz import open_arrays
from dpbench.bench.record.raw_log import log_bytes, loop_layout, replay_layout
from dpbench.bench.run.exact_loop import (
    ExactLoop,
    read_allocation_sizes,
    rebuild_sequence,
    solve_exactly,
)
from dpbench.bench.sequences.capability_boundary import make_capability_boundary
from dpbench.bench.sequences.loop_sequences import (
    commanded_thruster_rows,
    consequence_sequence,
    find_hardest_window,
)
from dpbench.bench.sequences.recording import read_sequence, source_digest
from dpbench.bench.sequences.sequence_file import load_recorded, save_sequence
from dpbench.errors import InputError, ResultsError
from dpbench.qp.program import QPSequence
from dpbench.qp.random_sequence import random_sequence
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify_sequence
from dpbench.scenario.problem_files import sequence_path
from dpbench.scenario.scenario import build_vessel, cached_scenario
from dpbench.ship.layout import AXES


@dataclass(frozen=True, eq=False)
class ReplayInput:
    """The QPs of a replay, the time between them [s], and their optima if known."""

    sequence: QPSequence
    sample_s: float
    optima: list[Optimum] | None


_latest: dict[tuple[str, Path], ReplayInput] = {}


def read_replay(cell: Cell, path: Path) -> ReplayInput:
    """Return the certified QPs of a replay, read once for all cells in a row that share them."""
    key = cell.problem_key, path
    if key not in _latest:
        _latest.clear()
        known = source_file(cell).load(path)
        _latest[key] = replace(known, optima=known.optima or certify_sequence(known.sequence))
    return _latest[key]


def is_readable(cell: Cell, path: Path) -> bool:
    """Return whether the file behind a cell's QPs can be read to its end."""
    try:
        source_file(cell).check(path)
    except InputError:
        return False
    return True


def log_size(cell: Cell, path: Path) -> int:
    """Return the size of a cell's raw log [B]; ResultsError without the file of its QPs."""
    with open_arrays(path) as stored:
        n, m = source_file(cell).size(stored)
        if cell.mode == "closed_loop":
            n_theta, n_f = stored["theta"].shape[1], stored["thrust"].shape[1]
            second = read_allocation_sizes(stored)
            return log_bytes(
                loop_layout(cell.steps, n, m, n_theta, n_f, second, backup=bool(cell.backup))
            )
    return log_bytes(replay_layout(cell.rounds + 1, cell.steps, n, m))


@dataclass(frozen=True, eq=False)
class _Loop:
    """The QPs along the first steps of the exactly solved loop of a scenario."""

    cell: Cell

    def make(self, path: Path) -> None:
        solve_exactly(cached_scenario(self.cell.scenario).first(self.cell.last_step)).save(path)

    def load(self, path: Path) -> ReplayInput:
        cell = self.cell
        scenario, exact = cached_scenario(cell.scenario), ExactLoop.load(path)
        first = cell.first
        if cell.is_window:
            first = find_hardest_window(exact.optima, first, cell.last_step - first, cell.steps)
        sequence = rebuild_sequence(
            scenario, exact, units=cell.units, first=first, count=cell.steps
        )
        optima = exact.optima[first : first + cell.steps]
        return ReplayInput(sequence, scenario.sample_s, optima)

    def check(self, path: Path) -> None:
        stored, needed = len(ExactLoop.load(path).theta), self.cell.last_step
        if stored < needed:
            raise ResultsError(str(path), "theta", f"{stored} steps", f"{needed} of them")

    def size(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        return stored["z"].shape[1], stored["optimum_y"].shape[1]


@dataclass(frozen=True, eq=False)
class _Consequence(_Loop):
    """The loss of a failure group, at each sample of that loop."""

    source: ConsequenceSource

    def load(self, path: Path) -> ReplayInput:
        cell, scenario = self.cell, cached_scenario(self.cell.scenario)
        whole = consequence_sequence(scenario, ExactLoop.load(path).tau, self.source.group)
        last = cell.first + cell.steps
        sequence = replace(
            whole,
            name=cell.sequence,
            base=whole.problem(cell.first),
            meta=whole.meta | {"first": cell.first},
            **{name: getattr(whole, name)[cell.first : last] for name in ("q", "l", "u")},
        )
        return ReplayInput(sequence, scenario.sample_s, None)

    def size(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        thrusters, rows = commanded_thruster_rows(cached_scenario(self.cell.scenario))
        return thrusters.n_f, AXES + len(rows.low)


class _Stored:
    """A sequence with its optima in a file of our own."""

    def load(self, path: Path) -> ReplayInput:
        recorded = load_recorded(path)
        # Random QPs, and some that others recorded, follow each other by no known time.
        sample_s = float(recorded.sequence.meta.get("sample_s", float("nan")))
        return ReplayInput(recorded.sequence, sample_s, recorded.optima)

    def check(self, path: Path) -> None:
        load_recorded(path)

    def size(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        return stored["q"].shape[1], stored["A"].shape[0]


@dataclass(frozen=True, eq=False)
class _Random(_Stored):
    """A random sequence, certified once, as some optima take a second each."""

    source: RandomSource

    def make(self, path: Path) -> None:
        sequence = random_sequence(self.source.recipe)
        save_sequence(path, sequence, certify_sequence(sequence))


@dataclass(frozen=True, eq=False)
class _Capability(_Stored):
    """The QPs at the capability boundary, with the plot in the same file."""

    source: CapabilitySource

    def make(self, path: Path) -> None:
        source = self.source
        vessel = build_vessel({"vessel_name": source.vessel_name, "vessel": source.vessel})
        make_capability_boundary(path, vessel, source.sides, source.name)


@dataclass(frozen=True, eq=False)
class _Recorded(_Stored):
    """A sequence from a file of others, whose optima are certified again."""

    source: RecordedSource

    def make(self, path: Path) -> None:
        origin = sequence_path(self.source.path)
        actual, planned = source_digest(origin), self.source.sha256
        if actual != planned:
            allowed = f"the file the cell was planned with, SHA-256 {planned[:12]}…"
            raise InputError(str(origin), "", f"SHA-256 {actual[:12]}…", allowed)
        recorded = read_sequence(origin)
        save_sequence(path, recorded.sequence, units=recorded.units, documents=recorded.documents)


SourceFile = _Loop | _Random | _Capability | _Recorded
"""The file behind the replays of one problem.

`make` writes it, which may take long (CertificateError when it cannot be done), `load` returns the
QPs of the cell, `check` reads all of it (ResultsError or InputError where it is damaged), and
`size` returns n and m of the QPs by its arrays.
"""


def source_file(cell: Cell) -> SourceFile:
    """Return the file behind a cell's QPs."""
    match cell.source:
        case ControllerSource() | HardestSource():
            return _Loop(cell)
        case ConsequenceSource() as source:
            return _Consequence(cell, source)
        case RandomSource() as source:
            return _Random(source)
        case CapabilitySource() as source:
            return _Capability(source)
        case RecordedSource() as source:
            return _Recorded(source)
        case QPSource() as source:
            raise TypeError(f"no file is made of {source}")
