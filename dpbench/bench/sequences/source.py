"""Record sequences along a reference loop or from files, verify them, keep QPs of cells.

A cell's file is made once a source, then read by workers and evaluators. It has the reference
loop, or a sequence with its certified optima.
"""

import hashlib
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.bench.progress import Progress, Silent
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
from dpbench.bench.record.npz import open_arrays, read_arrays_and_pickles
from dpbench.bench.record.raw_log import compute_log_bytes, make_loop_layout, make_replay_layout
from dpbench.bench.run.exact_loop import (
    ExactLoop,
    Part,
    StepReport,
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
from dpbench.bench.sequences.sequence_file import (
    WHAT,
    Recorded,
    active_set,
    is_problem_file,
    list_problem_files,
    load_recorded,
    read_problems,
    save_sequence,
)
from dpbench.errors import InputError, ResultsError, SituationError
from dpbench.files.regular_files import open_regular_file
from dpbench.qp.program import CONSTANT, QPSequence, QuadraticProgram
from dpbench.qp.random_mpc import (
    RandomMPC,
    generate_qps_and_optima_of_random_mpc,
    is_random_mpc_sequence_name,
)
from dpbench.qp.random_sequence import generate_random_sequence
from dpbench.qp.referee.farkas import is_farkas_vector_proof
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify_all_steps, yield_certified_optima
from dpbench.qp.residuals import residuals
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.problem_files import resolve_sequence_path
from dpbench.scenario.scenario import Scenario, build_or_reuse_scenario, build_vessel_from_documents
from dpbench.ship.layout import AXES

_FILES = "a sequence written by `export_sequence()` (.npz), or a file or folder of other QPs"


def record_scenario(
    scenario: Scenario,
    *,
    horizons: tuple[int, int] | None = None,
    steps: int | None = None,
    every: int = 1,
    part: Part = "controller",
) -> Recorded:
    """Solve a scenario's loop exactly and return its QPs in scaled units, all certified.

    horizons : (N_p, N_c) instead of those of the tuning; they change the loop too.
    steps : length of the loop; every : of its steps the first and each `every`-th are kept.
    part : "allocation" for the second QPs of a cascade.
    InputError : for impossible horizons, steps, thinning or part; CertificateError when a step has
        neither a certified optimum nor proof that there is none.
    """
    if horizons is not None:
        scenario = scenario.with_horizons(*horizons)
    if steps is not None:
        if not 1 <= steps <= scenario.steps:
            raise InputError(
                "`steps`", "", steps, f"1 to {scenario.steps}, the steps of {scenario.name}"
            )
        scenario = scenario.truncate(steps)
    exact = solve_loop_exactly(scenario)
    exact.require_certificates(scenario.name)
    sequence = thin_sequence(rebuild_sequence(scenario, exact, part=part), None, every)
    return Recorded(sequence, certify_all_steps(sequence))


def thin_sequence(sequence: QPSequence, steps: int | None, every: int = 1) -> QPSequence:
    """Return each `every`-th of the first `steps` QPs of a sequence (None: of all)."""
    if steps is not None and not 1 <= steps <= len(sequence):
        raise InputError(
            "`steps`",
            "",
            steps,
            f"1 to {len(sequence)}, as the sequence stores {len(sequence)} QPs",
        )
    if every < 1:
        raise InputError("`every`", "", every, "1 or more")
    if every == 1 and steps in (None, len(sequence)):
        return sequence
    stride = every * int(sequence.meta.get("every", 1))
    name = f"{sequence.name}[:{steps or len(sequence)}:{every}]"
    return _select_steps(sequence, slice(0, steps, every), name, {"every": stride})


def select_step(sequence: QPSequence, k: int) -> QPSequence:
    """Return step k of a sequence of QPs as a sequence of one QP."""
    if not 0 <= k < len(sequence):
        raise InputError(
            "`at`",
            "",
            k,
            f"0 to {len(sequence) - 1}, as the sequence stores {len(sequence)} QPs",
        )
    first = int(sequence.meta.get("first", 0)) + k * int(sequence.meta.get("every", 1))
    return _select_steps(sequence, slice(k, k + 1), f"{sequence.name}[{k}]", {"first": first})


def _select_steps(sequence: QPSequence, kept: slice, name: str, meta: dict[str, Any]) -> QPSequence:
    """Return a slice of a sequence's steps, its scaled equivalent included, under a new name."""
    arrays = {part: getattr(sequence, part) for part in ("q", "l", "u", *CONSTANT)}
    cut: dict[str, Any] = {part: array[kept] for part, array in arrays.items() if array is not None}
    if sequence.scaled is not None:
        cut["scaled"] = _select_steps(sequence.scaled, kept, name, meta)
    # The sparse equivalent would have all steps.
    cut |= {"meta": sequence.meta | meta, "sparse_equivalent": None}
    return replace(sequence, name=name, **cut)


def describe_sequence(sequence: QPSequence, optima: Sequence[Optimum]) -> str:
    """Return half a line on a sequence of QPs: length, QP size, kinds of optimum proof."""
    kinds = Counter(optimum.kind for optimum in optima)
    bounds = [optimum.bound for optimum in optima if np.isfinite(optimum.bound)]
    proofs = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    worst = f"; largest error bound {max(bounds):.1e} [unit of z]" if bounds else ""
    n, m, qps = sequence.base.n, sequence.base.m, "QP" if len(sequence) == 1 else "QPs"
    return f"{len(sequence)} {qps}, n = {n}, m = {m}; certificates: {proofs}{worst}"


def load_named_sequence(name: str | Path) -> Recorded:
    """Return the QPs of a random MPC problem by its name, or of a stored sequence or a file.

    Only the former are sure to have optima. UnknownNameError or InputError for a name of nothing.
    """
    if is_random_mpc_sequence_name(name):
        return Recorded(
            *generate_qps_and_optima_of_random_mpc(RandomMPC.from_sequence_name(str(name)))
        )
    return read_sequence(resolve_sequence_path(name))


def read_sequence(path: Path) -> Recorded:
    """Return the QPs in a dpbench `.npz` with optima, or in qpsolvers files, which have none."""
    if path.is_dir() or is_problem_file(path):
        return Recorded(read_problems(path), None)
    if not path.is_file():
        raise InputError(str(path), "", "no such file or folder", _FILES)
    return load_recorded(path)


def hash_sequence_files(path: Path) -> str:
    """Return the SHA-256 of a sequence file, or of all problem files in a folder."""
    total = hashlib.sha256()
    try:
        for file in list_problem_files(path) if path.is_dir() else [path]:
            with open_regular_file(file, _FILES) as stream:
                size = os.fstat(stream.fileno()).st_size
                total.update(f"{file.name if path.is_dir() else ''}:{size}:".encode())
                while block := stream.read(2**20):
                    total.update(block)
    except OSError as error:
        found = error.strerror or "an unreadable file"
        raise InputError(str(error.filename or path), "", found, _FILES) from error
    return total.hexdigest()


LEAD_STEPS = 3
"""QPs that are solved before those of a window or stretch, as far as the loop has them."""


@dataclass(frozen=True, eq=False)
class ReplayInput:
    """The QPs of a replay, the time between them [s], and their certified optima if known.

    station : of QPs along a reference loop, its station keeping, see
    `compute_station_metrics`.
    lead : the QPs of the loop just before the first one, which give the first a warm start.
    """

    sequence: QPSequence
    sample_s: float
    optima: list[Optimum] | None
    station: dict[str, float] = field(default_factory=dict)
    lead: QPSequence | None = None


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
    """File with the reference loop of a scenario, from which its QPs are rebuilt.

    report : receiver of the steps done and to do while the file is made.
    """

    cell: Cell
    report: StepReport | None

    def make_file(self, path: Path) -> None:
        """Solve the run's scenario exactly and write the closed loop to `path`."""
        scenario = build_or_reuse_scenario(self.cell.scenario)
        steps = self.cell.steps_needed_in_file
        solve_loop_exactly(scenario.truncate(steps), self.report).save(path)

    def load_replay_input(self, path: Path) -> ReplayInput:
        """Return the QPs of the replay along the loop in the file, with their optima."""
        cell = self.cell
        scenario, exact = build_or_reuse_scenario(cell.scenario), ExactLoop.load(path)
        first, steps = cell.first, cell.steps
        if cell.is_hardest_window:
            first = find_hardest_window(
                exact.optima, first, cell.steps_needed_in_file - first, steps
            )
        rebuild = partial(rebuild_sequence, scenario, exact, units=cell.units)
        sequence, before = rebuild(first=first, count=steps), min(first, LEAD_STEPS)
        lead = rebuild(first=first - before, count=before) if before else None
        optima = exact.optima[first : first + steps]
        station = compute_station_metrics(scenario, exact, cell.steps_needed_in_file)
        return ReplayInput(sequence, scenario.sample_s, optima, station, lead)

    def refuse_damaged_file(self, path: Path) -> None:
        """Raise ResultsError where a loop's file, read whole, is damaged or has too few steps."""
        stored, needed = len(ExactLoop.load(path).theta), self.cell.steps_needed_in_file
        if stored < needed:
            raise ResultsError(str(path), "theta", f"{stored} steps", f"{needed} steps")

    def read_n_and_m(self, stored: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
        """Return n and m of the run's QPs from the arrays of the file."""
        return stored["z"].shape[1], stored["optimum_y"].shape[1]


@dataclass(frozen=True, eq=False)
class _ConsequenceFile(_LoopFile):
    """File with a reference loop, for the consequence analysis of a failure group."""

    source: ConsequenceSource

    def load_replay_input(self, path: Path) -> ReplayInput:
        """Return the consequence-analysis QPs of the replay's failure group, without optima."""
        cell, scenario = self.cell, build_or_reuse_scenario(self.cell.scenario)
        exact = ExactLoop.load(path)
        group, margin = self.source.group, self.source.margin
        whole = build_consequence_sequence(scenario, exact.tau, group, margin)
        replayed, first = slice(cell.first, cell.first + cell.steps), {"first": cell.first}
        sequence = _select_steps(whole, replayed, cell.sequence, first)
        sequence = replace(sequence, base=whole.problem(cell.first))
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
            digests = f"SHA-256 {actual[:12]}…, planned {planned[:12]}…"
            fault = f"the file has changed since its run was planned ({digests})"
            raise SituationError(str(origin), f"{fault}: restore the file")
        recorded = read_sequence(origin)
        save_sequence(path, recorded.sequence)


SourceFile = _LoopFile | _RandomFile | _CapabilityFile | _RecordedFile
"""The file behind the replays of one problem.

`make_file` writes it, which may take long (CertificateError when it cannot be done),
`load_replay_input` returns the QPs of the cell, `refuse_damaged_file` reads all of it (ResultsError
or InputError where it is damaged), and `read_n_and_m` returns n and m of the QPs by its arrays.
"""


def choose_source_file(cell: Cell, report: StepReport | None = None) -> SourceFile:
    """Return the object that makes and reads the file of a run's QPs, by the kind of these QPs.

    report : receiver of the steps done and to do while a reference loop is made.
    """
    match cell.source:
        case ControllerSource() | HardestSource():
            return _LoopFile(cell, report)
        case ConsequenceSource() as source:
            return _ConsequenceFile(cell, report, source)
        case RandomSource() as source:
            return _RandomFile(source)
        case CapabilitySource() as source:
            return _CapabilityFile(source)
        case RecordedSource() as source:
            return _RecordedFile(source)
        case QPSource() as source:
            raise TypeError(f"{source} has no file")


STATIONARY = 1e-9
"""Largest residual of stored multipliers, relative to the largest term of Pz + q + Aᵀy + y_box."""
ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
WITHOUT_OPTIMUM = ("infeasible", "undecided")
"""Kinds that a file may swap: the difference is rounding only."""


def verify_sequence(path: Path, progress: Progress | None = None) -> str:
    """Certify every step of a sequence and compare the stored optima; return one line on it.

    InputError : for a damaged file, or the first step whose stored optimum, multipliers, active
        set or proof of infeasibility are false.
    """
    where, shown = str(path), progress or Silent()
    recorded = read_sequence(path)
    sequence, claims = recorded.sequence, recorded.optima
    if claims is not None:
        _check_active_sets(path, claims)
    shown.start(len(sequence))
    optima = []
    for k, optimum in enumerate(yield_certified_optima(sequence)):
        if claims is not None:
            _check_step(where, k, sequence, claims[k], optimum)
        optima.append(optimum)
        shown.advance(1, path.stem)
    return f"{where}: {describe_sequence(sequence, optima if claims is None else claims)}"


def _check_active_sets(path: Path, claims: list[Optimum]) -> None:
    """Raise InputError where stored active sets differ from those of the stored multipliers."""
    stored = read_arrays_and_pickles(path, WHAT)[0].get("active")
    wanted = np.array([active_set(optimum) for optimum in claims])
    if stored is None or stored.shape != wanted.shape or stored.dtype != np.int8:
        found = "nothing" if stored is None else f"{stored.dtype}, shape {stored.shape}"
        raise InputError(str(path), "active", found, f"int8, shape {wanted.shape}")
    if (stored != wanted).any():
        k, i = (int(index) for index in np.argwhere(stored != wanted)[0])
        allowed = f"{wanted[k, i]}, the sign of its multiplier"
        raise InputError(str(path), f"active[{k}, {i}]", stored[k, i], allowed)


def _check_step(where: str, k: int, sequence: QPSequence, claim: Optimum, optimum: Optimum) -> None:
    """Raise InputError where the stored optimum of step k differs from the certified one."""
    without = optimum.kind in WITHOUT_OPTIMUM
    if (claim.kind in WITHOUT_OPTIMUM) != without:
        allowed = f"{optimum.kind!r}, as found when this step was certified again"
        raise InputError(where, f"certificate[{k}]", repr(claim.kind), allowed)
    if optimum.kind == "undecided":
        # Whether a point is feasible is a matter of rounding, and no proof is asked for.
        return
    if without:
        if not is_farkas_vector_proof(sequence.problem(k), claim.y, claim.y_box):
            allowed = f"a Farkas vector, as the step is infeasible (certificate[{k}])"
            raise InputError(where, f"y, y_box[{k}]", "no proof of infeasibility", allowed)
        return
    if not np.isfinite(claim.bound):
        return
    apart = float(np.abs(claim.z - optimum.z).max())
    rounding = ROUNDING * float(np.abs(claim.z).max())
    most = claim.bound + optimum.bound + rounding
    if not apart <= most:
        found = f"a difference of {apart:.1e} from the recomputed optimum"
        terms = "the stored error bound, the new error bound and rounding"
        allowed = f"at most {most:.1e}, the sum of {terms}"
        raise InputError(where, f"z[{k}]", found, allowed)
    _check_multipliers(where, k, sequence.problem(k), claim)


def _check_multipliers(where: str, k: int, qp: QuadraticProgram, claim: Optimum) -> None:
    """Raise InputError where the stored multipliers of step k do not prove its optimum."""
    measured = residuals(qp, Solution(Status.SOLVED, claim.z, claim.y, claim.y_box))
    terms = (qp.P @ claim.z, qp.q, claim.y, claim.y_box)
    size = max(1.0, *(float(np.abs(term).max(initial=0.0)) for term in terms))
    worst = max(measured.primal, measured.dual, measured.complementarity)
    if not worst <= STATIONARY * size:
        what = f"a primal, dual or complementarity residual of {worst:.1e}"
        raise InputError(where, f"y, y_box[{k}]", what, f"at most {STATIONARY * size:.1e}")
