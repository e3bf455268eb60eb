"""Recording of sequences, along an exactly solved loop or from files."""

import hashlib
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.bench.run.exact_loop import Part, rebuild_sequence, solve_loop_exactly
from dpbench.bench.run.formulation import QPBuilder
from dpbench.bench.sequences import qpsolvers_files as problem_files
from dpbench.bench.sequences.sequence_file import Recorded, load_recorded
from dpbench.errors import InputError
from dpbench.files.opening import open_regular_file
from dpbench.qp.program import CONSTANT, QPSequence
from dpbench.qp.random_mpc import (
    RandomMPC,
    generate_qps_and_optima_of_random_mpc,
    is_random_mpc_sequence_name,
)
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.scenario.problem_files import resolve_sequence_path
from dpbench.scenario.scenario import Scenario

WHAT = "a sequence by `dpbench export` (.npz), or a problem (.npz) or folder of them by qpsolvers"


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
            raise InputError("`steps`", "", steps, f"1 to {scenario.steps} of {scenario.name}")
        scenario = scenario.truncate(steps)
    exact = solve_loop_exactly(scenario)
    exact.require_certificates(scenario.name)
    sequence = rebuild_sequence(scenario, exact, part=part)
    meta = sequence.meta | scenario.problem.horizons_by_name
    sequence = thin_sequence(replace(sequence, meta=meta), None, every)
    builder = QPBuilder(scenario, "si")
    units = builder.condensed.scale
    if part == "allocation" and builder.allocation is not None:
        units = builder.allocation.scale
    return Recorded(sequence, certify_all_steps(sequence), units, {**scenario.files})


def thin_sequence(sequence: QPSequence, steps: int | None, every: int = 1) -> QPSequence:
    """Return each `every`-th of the first `steps` QPs of a sequence (None: of all)."""
    if steps is not None and not 1 <= steps <= len(sequence):
        raise InputError("`steps`", "", steps, f"1 to {len(sequence)} of {sequence.name}")
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
        raise InputError("`at`", "", k, f"0 to {len(sequence) - 1} of {sequence.name}")
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
    worst = f"; largest bound {max(bounds):.1e}" if bounds else ""
    n, m = sequence.base.n, sequence.base.m
    return f"{len(sequence)} QPs, n = {n}, m = {m}; certificates: {proofs}{worst}"


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
    if path.is_dir() or problem_files.is_problem_file(path):
        return Recorded(problem_files.read_problems(path), None)
    if not path.is_file():
        raise InputError(str(path), "", "no such file or folder", WHAT)
    return load_recorded(path)


def hash_sequence_files(path: Path) -> str:
    """Return the SHA-256 of a sequence file, or of all problem files in a folder."""
    total = hashlib.sha256()
    try:
        for file in problem_files.list_problem_files(path) if path.is_dir() else [path]:
            with open_regular_file(file, WHAT) as stream:
                size = os.fstat(stream.fileno()).st_size
                total.update(f"{file.name if path.is_dir() else ''}:{size}:".encode())
                while block := stream.read(2**20):
                    total.update(block)
    except OSError as error:
        found = error.strerror or "unreadable"
        raise InputError(str(error.filename or path), "", found, WHAT) from error
    return total.hexdigest()
