"""Verification of a sequence: every optimum is certified and compared with the stored one."""

from pathlib import Path

import numpy as np

from dpbench.bench.progress import Progress, Silent
from dpbench.bench.record.npz import read_arrays_and_pickles
from dpbench.bench.sequences.sequence_file import WHAT, active_set
from dpbench.bench.sequences.source import describe_sequence, read_sequence
from dpbench.errors import InputError
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.qp.referee.farkas import is_farkas_vector_proof
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import yield_certified_optima
from dpbench.qp.residuals import residuals
from dpbench.qp.solution import Solution, Status

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
        raise InputError(where, f"certificate[{k}]", repr(claim.kind), repr(optimum.kind))
    if optimum.kind == "undecided":
        # Whether a point is feasible is a matter of rounding, and no proof is asked for.
        return
    if without:
        if not is_farkas_vector_proof(sequence.problem(k), claim.y, claim.y_box):
            allowed = "a Farkas vector: the step is infeasible"
            raise InputError(where, f"y, y_box[{k}]", "no proof of infeasibility", allowed)
        return
    if not np.isfinite(claim.bound):
        return
    apart = float(np.abs(claim.z - optimum.z).max())
    rounding = ROUNDING * float(np.abs(claim.z).max())
    most = claim.bound + optimum.bound + rounding
    if not apart <= most:
        found = f"an optimum {apart:.1e} from the certified one"
        raise InputError(where, f"z[{k}]", found, f"{most:.1e}, by its bound and the new one")
    _check_multipliers(where, k, sequence.problem(k), claim)


def _check_multipliers(where: str, k: int, qp: QuadraticProgram, claim: Optimum) -> None:
    """Raise InputError where the stored multipliers of step k do not prove its optimum."""
    measured = residuals(qp, Solution(Status.SOLVED, claim.z, claim.y, claim.y_box))
    terms = (qp.P @ claim.z, qp.q, claim.y, claim.y_box)
    size = max(1.0, *(float(np.abs(term).max(initial=0.0)) for term in terms))
    worst = max(measured.primal, measured.dual, measured.complementarity)
    if not worst <= STATIONARY * size:
        what = f"a residual of {worst:.1e}"
        raise InputError(where, f"y, y_box[{k}]", what, f"at most {STATIONARY * size:.1e}")
