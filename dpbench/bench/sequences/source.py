"""Files of the QPs of cells: made once a source, then read by workers and evaluators.

A file has the exactly solved loop, or a sequence with its certified optima.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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
from dpbench.bench.record.raw_log import compute_log_bytes, make_loop_layout, make_replay_layout
from dpbench.bench.run.exact_loop import (
    ExactLoop,
    compute_station_metrics,
    read_allocation_sizes,
    rebuild_sequence,
    solve_loop_exactly,
)
from dpbench.bench.sequences.capability_boundary import write_capability_boundary
from dpbench.bench.sequences.loop_sequences import (
    build_consequence_sequence,
    find_hardest_window,
    select_thruster_rows,
)
from dpbench.bench.sequences.recording import hash_sequence_files, read_sequence
from dpbench.bench.sequences.sequence_file import load_recorded, save_sequence
from dpbench.errors import InputError, ResultsError
from dpbench.qp.program import QPSequence
from dpbench.qp.random_sequence import generate_random_sequence
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.scenario.problem_files import resolve_sequence_path
from dpbench.scenario.scenario import build_or_reuse_scenario, build_vessel_from_documents
from dpbench.ship.layout import AXES


@dataclass(frozen=True, eq=False)
class ReplayInput:
    """The QPs of a replay, the time between them [s], and their certified optima if known.

    station : of QPs along an exactly solved loop, its station keeping, see
    `compute_station_metrics`.
    """

    sequence: QPSequence
    sample_s: float
    optima: list[Optimum] | None
    station: dict[str, float] = field(default_factory=dict)


_latest: dict[tuple[str, Path], ReplayInput] = {}


def read_replay(cell: Cell, path: Path) -> ReplayInput:
    """Return the certified QPs of a replay; the latest are kept for the next runs."""
    key = cell.problem_key, path
    if key not in _latest:
        _latest.clear()
        known = choose_source_file(cell).load_replay_input(path)
        _latest[key] = replace(known, optima=known.optima or certify_all_steps(known.sequence))
    return _latest[key]


def is_readable(cell: Cell, path: Path) -> bool:
    """Return whether the file of a run's QPs can be read to its end."""
    try:
        choose_source_file(cell).refuse_damaged_file(path)
    except InputError:
        return False
    return True


def log_size(cell: Cell, path: Path) -> int:
    """Return the size of a run's raw log [B]; ResultsError where its file of QPs is missing."""
    with open_arrays(path) as stored:
        n, m = choose_source_file(cell).read_n_and_m(stored)
        if cell.mode == "closed_loop":
            n_theta, n_f = stored["theta"].shape[1], stored["thrust"].shape[1]
            sizes = n, m, n_theta, n_f, read_allocation_sizes(stored)
            return compute_log_bytes(make_loop_layout(cell.steps, *sizes, backup=bool(cell.backup)))
    return compute_log_bytes(make_replay_layout(cell.rounds + 1, cell.steps, n, m))


@dataclass(frozen=True, eq=False)
class _LoopFile:
    """File with the exactly solved loop of a scenario, from which its QPs are rebuilt."""

    cell: Cell

    def make_file(self, path: Path) -> None:
        """Solve the run's scenario exactly and write the closed loop to `path`."""
        solve_loop_exactly(
            build_or_reuse_scenario(self.cell.scenario).truncate(self.cell.steps_needed_in_file)
        ).save(path)

    def load_replay_input(self, path: Path) -> ReplayInput:
        """Return the QPs of the replay along the loop in the file, with their optima."""
        cell = self.cell
        scenario, exact = build_or_reuse_scenario(cell.scenario), ExactLoop.load(path)
        first, steps = cell.first, cell.steps
        if cell.is_hardest_window:
            first = find_hardest_window(
                exact.optima, first, cell.steps_needed_in_file - first, steps
            )
        sequence = rebuild_sequence(scenario, exact, units=cell.units, first=first, count=steps)
        optima = exact.optima[first : first + steps]
        station = compute_station_metrics(scenario, exact, cell.steps_needed_in_file)
        return ReplayInput(sequence, scenario.sample_s, optima, station)

    def refuse_damaged_file(self, path: Path) -> None:
        """Raise ResultsError where a loop's file, read whole, is damaged or has too few steps."""
        stored, needed = len(ExactLoop.load(path).theta), self.cell.steps_needed_in_file
        if stored < needed:
            raise ResultsError(str(path), "theta", f"{stored} steps", f"{needed} of them")

    def read_n_and_m(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        """Return n and m of the run's QPs from the arrays of the file."""
        return stored["z"].shape[1], stored["optimum_y"].shape[1]


@dataclass(frozen=True, eq=False)
class _ConsequenceFile(_LoopFile):
    """File with an exactly solved loop, for the consequence analysis of a failure group."""

    source: ConsequenceSource

    def load_replay_input(self, path: Path) -> ReplayInput:
        """Return the consequence-analysis QPs of the replay's failure group, without optima."""
        cell, scenario = self.cell, build_or_reuse_scenario(self.cell.scenario)
        exact = ExactLoop.load(path)
        group, margin = self.source.group, self.source.margin
        whole = build_consequence_sequence(scenario, exact.tau, group, margin)
        last = cell.first + cell.steps
        sequence = replace(
            whole,
            name=cell.sequence,
            base=whole.problem(cell.first),
            meta=whole.meta | {"first": cell.first},
            **{name: getattr(whole, name)[cell.first : last] for name in ("q", "l", "u")},
        )
        station = compute_station_metrics(scenario, exact, cell.steps_needed_in_file)
        return ReplayInput(sequence, scenario.sample_s, None, station)

    def read_n_and_m(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        """Return n and m of the consequence-analysis QPs."""
        thrusters, rows = select_thruster_rows(build_or_reuse_scenario(self.cell.scenario))
        return thrusters.n_f, AXES + len(rows.low)


class _SequenceFile:
    """File with a sequence of QPs and its certified optima."""

    def load_replay_input(self, path: Path) -> ReplayInput:
        """Return the sequence of QPs in the file, with its optima and sample time."""
        recorded = load_recorded(path)
        # Random QPs, and some that others recorded, follow each other by no known time.
        sample_s = float(recorded.sequence.meta.get("sample_s", float("nan")))
        return ReplayInput(recorded.sequence, sample_s, recorded.optima)

    def refuse_damaged_file(self, path: Path) -> None:
        """Raise InputError where a file of QPs is damaged; the whole of it is read."""
        load_recorded(path)

    def read_n_and_m(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        """Return n and m of the QPs from the arrays of the file."""
        return stored["q"].shape[1], stored["A"].shape[0]


@dataclass(frozen=True, eq=False)
class _RandomFile(_SequenceFile):
    """File with a random sequence of QPs, certified once when it is made."""

    source: RandomSource

    def make_file(self, path: Path) -> None:
        """Generate and certify the random QPs and write them to `path`."""
        sequence = generate_random_sequence(self.source.recipe)
        save_sequence(path, sequence, certify_all_steps(sequence))


@dataclass(frozen=True, eq=False)
class _CapabilityFile(_SequenceFile):
    """File with a ship's capability plot and its certified QPs."""

    source: CapabilitySource

    def make_file(self, path: Path) -> None:
        """Compute a ship's wind limits and write the plot and its QPs to `path`."""
        source = self.source
        vessel = build_vessel_from_documents(
            {"vessel_name": source.vessel_name, "vessel": source.vessel}
        )
        write_capability_boundary(path, vessel, source.sides, source.name)


@dataclass(frozen=True, eq=False)
class _RecordedFile(_SequenceFile):
    """File with a sequence of QPs recorded by others, certified again."""

    source: RecordedSource

    def make_file(self, path: Path) -> None:
        """Read recorded QPs, check their SHA-256, certify them and write them to `path`."""
        origin = resolve_sequence_path(self.source.path)
        actual, planned = hash_sequence_files(origin), self.source.sha256
        if actual != planned:
            allowed = f"the file the cell was planned with, SHA-256 {planned[:12]}…"
            raise InputError(str(origin), "", f"SHA-256 {actual[:12]}…", allowed)
        recorded = read_sequence(origin)
        save_sequence(path, recorded.sequence, units=recorded.units, documents=recorded.documents)


SourceFile = _LoopFile | _RandomFile | _CapabilityFile | _RecordedFile
"""The file behind the replays of one problem.

`make_file` writes it, which may take long (CertificateError when it cannot be done),
`load_replay_input` returns the QPs of the cell, `refuse_damaged_file` reads all of it (ResultsError
or InputError where it is damaged), and `read_n_and_m` returns n and m of the QPs by its arrays.
"""


def choose_source_file(cell: Cell) -> SourceFile:
    """Return the object that makes and reads the file of a run's QPs, by the kind of these QPs."""
    match cell.source:
        case ControllerSource() | HardestSource():
            return _LoopFile(cell)
        case ConsequenceSource() as source:
            return _ConsequenceFile(cell, source)
        case RandomSource() as source:
            return _RandomFile(source)
        case CapabilitySource() as source:
            return _CapabilityFile(source)
        case RecordedSource() as source:
            return _RecordedFile(source)
        case QPSource() as source:
            raise TypeError(f"no file is made of {source}")
