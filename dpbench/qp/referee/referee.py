"""The referee: certified optima of QPs that share P and A, each with a rigorous error bound.

In order: the linear certificate with the active set of the step before, then with guesses; the gap
certificate where rows are weakly active; the rational one for small problems; all of it again in
other units, with equality rows enclosed (`last_resort`). No guess is trusted: every certificate
stands on its own.

Certificates work on the rows of C = [A; I], rows first and bounds behind them. A set of active ones
is an array of signs over them; an inverse is kept for each set by its bytes:

    row of C      0 … m−1      m … m+n−1                        n      w
    limits     L  l            lb                            ┌  P     C_Wᵀ ┐  ┌ z   ┐     ┌ −q  ┐
               U  u            ub                     K_W =  └  C_W   0    ┘  └ λ_W ┘  =  └ b_W ┘
    signs      +1 at U, −1 at L, 0 inactive           b_W the limits that the signs of W name
    result     y            y_box                     X ≈ K_W⁻¹ and a proof of how near

By hand, the point nearest (3, 3) under z₁ ≤ 1 and z₂ ≤ 1: W = {1, 2}, C_W = I, z = (1, 1) and
λ = (3, 3) − z = (2, 2). Its certificate depends on a row l ≤ z₁ + z₂ ≤ u beside them:

- u = 2.5: the slack of ½ and the multipliers of 2 are beyond doubt, "linear".
- u = 2: the row is met without a multiplier, and no rounding may decide whether it is active. Held
  at limits moved inwards by τ = 2⁻¹²⁰, z = (1 − τ, 1 − τ) is feasible, the gap is Σ λ·slack = 4 τ,
  and √(2·gap) = 2.5e-18 and the rounding of z to float64, 2.2e-16, bound the error: "gap".
- l = 3: 1·z₁ + 1·z₂ ≤ 2 and −1·(z₁ + z₂) ≤ −3 add up to 0 ≤ −1: y = −1, y_box = (1, 1) times any
  positive number prove it "infeasible".

>>> def nearest(l, u):
...     free = np.full(2, -np.inf)
...     rows = [[1, 1]], [l], [u], free, [1, 1]
...     return certify(QuadraticProgram(np.eye(2), [-3, -3], *rows))
>>> apart, touching, empty = nearest(-np.inf, 2.5), nearest(-np.inf, 2), nearest(3, np.inf)
>>> apart.kind, touching.kind, empty.kind
('linear', 'gap', 'infeasible')
>>> apart.z.round(12).tolist(), apart.y.tolist(), apart.y_box.round(12).tolist()
([1.0, 1.0], [0.0], [2.0, 2.0])
>>> touching.z.tolist(), f"{touching.bound:.1e}"
([1.0, 1.0], '2.2e-16')
>>> (empty.y_box / -empty.y).round(12).tolist(), bool(empty.y[0] < 0.0)
([1.0, 1.0], True)
"""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import lru_cache
from threading import get_ident

import numpy as np
from scipy.sparse.csgraph import connected_components

from dpbench.arrays import Matrix, Vector
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.qp.referee.dyadic import Dyadic, is_integer_matrix_semidefinite
from dpbench.qp.referee.farkas import (
    bound_least_constraint_violation,
    find_farkas_vector,
    find_farkas_vector_by_magnified_lps,
    find_unbounded_direction,
    is_direction_proof_of_unboundedness,
    is_farkas_vector_proof,
)
from dpbench.qp.referee.gap import (
    find_signs_of_limits_met,
    prove_optimum_by_duality_gap,
    select_independent_active_rows,
)
from dpbench.qp.referee.guesses import guess_active_set_from_last_step, yield_active_set_guesses
from dpbench.qp.referee.implied import fix_variables_forced_to_bounds
from dpbench.qp.referee.kernels import (
    CROSSED_LIMITS,
    INVALID_DATA,
    classify_limits_as_ordered_crossed_or_nan,
)
from dpbench.qp.referee.kkt import (
    Geometry,
    KKTSystem,
    is_proven_positive_definite,
    prove_optimum_by_kkt_error_bounds,
)
from dpbench.qp.referee.last_resort import LastResort
from dpbench.qp.referee.optimum import (
    ExactMatrices,
    JointQP,
    Kind,
    Optimum,
    Proof,
    Signs,
    is_exact_after_power_of_two_scaling,
    scale_to_unit_diagonal,
)
from dpbench.qp.referee.rational import prove_optimum_in_exact_arithmetic
from dpbench.qp.residuals import fit_row_and_bound_multipliers
from dpbench.qp.solution import Solution, Status

WANTED = 1e-10  # A bound above it sends the problem to the next, costlier certificate
REMEMBERED = 128  # Active sets whose KKT inverse is kept
EXACT_SIZE = 40  # Largest n for the rational certificate, whose cost grows like n⁴: 0.3 s at n = 30
INVALID = "P, q or A is not finite, or limits are NaN or infinite on the wrong side"
INDEFINITE = "P is not proven positive semidefinite"
SINGULAR = "P is singular, and the QP may be unbounded"
SEMIDEFINITE_SIZE = 100
"""Largest block of P for the exact test of semidefiniteness, done once per referee."""


@dataclass(slots=True)
class _MatrixData:
    """Cached factorisations and exact matrices for QPs with the same P and A, made on first use."""

    systems: OrderedDict[bytes, KKTSystem] = field(default_factory=OrderedDict)
    inverse: Matrix | None = None
    exact: ExactMatrices | None = None
    last_resort: LastResort | None = None


class Referee:
    """Independent checker that certifies optima of QPs with the same P, A, lb and ub.

    P counts by its symmetric part, rounded once. For P proven positive definite all certificates
    are open. For P that is exactly semidefinite (decided for blocks of up to `SEMIDEFINITE_SIZE`
    variables) the linear one is, which proves that the optimum is the only one, and the enclosure
    of the last resort, which bounds all minimisers. The latter is open too where P is definite on
    the directions that the equality rows leave. Otherwise only infeasibility is certified.
    """

    def __init__(self, P: Matrix, A: Matrix, lb: Vector, ub: Vector) -> None:
        n = len(lb)
        self._m = A.shape[0]
        self._P = 0.5 * (P + P.T)
        self._A, self._lb, self._ub = A.copy(), lb.copy(), ub.copy()
        self._C = np.vstack((A, np.eye(n)))
        self._geometry = Geometry(self._C)
        self._last: Signs = np.zeros(self._m + n, dtype=np.int8)
        self._farkas: tuple[Vector, Vector] | None = None
        self._data = _MatrixData()
        self._finite = bool(np.isfinite(P).all() and np.isfinite(A).all())
        self._definite = self._finite and is_proven_positive_definite(self._P)
        self._convex = self._definite or (self._finite and self._is_proven_convex())

    def for_changed_matrices(self, P: Matrix, A: Matrix, lb: Vector, ub: Vector) -> "Referee":
        """Return a checker of optima for a later step's matrices, started at the last set."""
        later = Referee(P, A, lb, ub)
        if len(later._last) == len(self._last):
            later._last = self._last
        return later

    def copy_without_memory(self) -> "Referee":
        """Return a copy of this checker without memory of earlier QPs; matrix data are shared."""
        other = copy(self)
        other._last, other._farkas = np.zeros_like(self._last), None
        return other

    def _is_proven_convex(self) -> bool:
        """Return whether P is proven positive semidefinite."""
        P = self._P
        if (np.diagonal(P) < 0.0).any():
            return False
        if is_exact_after_power_of_two_scaling(P) and is_proven_positive_definite(
            scale_to_unit_diagonal(P)
        ):
            return True
        count, part = connected_components(P != 0.0, directed=False)
        blocks = [np.flatnonzero(part == i) for i in range(count)]
        if max(len(block) for block in blocks) > SEMIDEFINITE_SIZE:
            return False
        return all(
            is_integer_matrix_semidefinite(Dyadic.from_floats(P[np.ix_(block, block)]).whole)
            for block in blocks
        )

    def _get_exact_matrices(self) -> ExactMatrices:
        """Return Hessian P and constraint rows C in exact arithmetic, from a cache."""
        if self._data.exact is None:
            self._data.exact = ExactMatrices.from_float_matrices(self._P, self._C)
        return self._data.exact

    def certify_vectors(self, q: Vector, l: Vector, u: Vector) -> Optimum:  # noqa: E741 - as in QuadraticProgram
        """Certify the optimum of the QP with vectors q (n,), l and u (m,)."""
        # Kernels are compiled for arrays that may be written to, whatever memory q lies in.
        q, L, U = q.copy(), np.concatenate((l, self._lb)), np.concatenate((u, self._ub))
        limits = classify_limits_as_ordered_crossed_or_nan(q, L, U)
        if limits == INVALID_DATA or not self._finite:
            return replace(self._make_optimum_without_proof(), reason=INVALID)
        problem = JointQP(self._P, q, self._C, L, U)
        if limits == CROSSED_LIMITS:
            return self._find_proof_of_infeasibility(problem) or self._make_optimum_without_proof()
        proof = self._try_proof_by_kkt_error_bounds(
            problem, self._last
        ) or self._try_last_active_set(problem)
        if proof is None or proof.bound > WANTED:
            return self._reuse_earlier_proof_of_infeasibility(
                problem
            ) or self._certify_by_guessed_active_sets(problem)
        return self._convert_proof_to_optimum(proof)

    def _try_last_active_set(self, problem: JointQP) -> Proof | None:
        """Prove the optimum with an active set guessed from the last QP's; None if unproven."""
        system = self._get_kkt_system_of_active_set(self._last) if self._convex else None
        if system is None or not system.is_proven_nonsingular:
            return None
        signs = guess_active_set_from_last_step(problem, self._geometry, system)
        proof = None if signs is None else self._try_proof_by_kkt_error_bounds(problem, signs)
        if signs is not None and proof is not None:
            self._last = signs
        return proof

    def _certify_by_guessed_active_sets(self, problem: JointQP) -> Optimum:
        """Certify a QP's optimum or infeasibility from guessed active sets, cheapest first."""
        fixed = fix_variables_forced_to_bounds(problem)
        posed = problem if fixed is None else fixed
        tried: list[Signs] = []
        best: Proof | None = None
        for signs in yield_active_set_guesses(posed):
            if signs is None:
                if (empty := self._find_proof_of_infeasibility(problem)) is not None:
                    return empty
                continue
            tried.append(signs)
            best = self._try_proof_by_kkt_error_bounds(posed, signs)
            if best is not None:
                self._last = signs
                break
        if best is None or best.bound > WANTED:
            best = self._try_gap_and_exact_proofs(posed, tried, best)
        if best is None or WANTED < best.bound < np.inf:
            return self._try_costliest_proof(problem, posed, best)
        if best.kind == "infeasible":
            return self._find_proof_of_infeasibility(
                problem
            ) or self._certify_infeasible_by_exact_multipliers(problem, best.y)
        return self._convert_proof_to_optimum_with_fitted_multipliers(problem, posed, best)

    def _try_costliest_proof(
        self, problem: JointQP, posed: JointQP, known: Proof | None
    ) -> Optimum:
        """Try the costliest proof of the optimum; return the better of it and the known proof."""
        if known is None and (empty := self._find_proof_of_infeasibility(problem)) is not None:
            return empty
        if self._data.last_resort is None:
            self._data.last_resort = LastResort(self._P, self._C, convex=self._convex)
        closer = self._data.last_resort.prove_optimum(posed)
        if closer is not None and (known is None or closer.bound < known.bound):
            return self._convert_proof_to_optimum_with_fitted_multipliers(problem, None, closer)
        if known is not None:
            return self._convert_proof_to_optimum_with_fitted_multipliers(problem, posed, known)
        farkas = find_farkas_vector_by_magnified_lps(self._convert_joint_problem_to_qp(problem))
        return (
            self._make_optimum_without_proof()
            if farkas is None
            else self._certify_infeasible_if_proven(problem, *farkas)
        )

    def _convert_proof_to_optimum_with_fitted_multipliers(
        self, problem: JointQP, posed: JointQP | None, proof: Proof
    ) -> Optimum:
        """Return a proof as an optimum, with multipliers fitted to the original problem."""
        if posed is problem:
            return self._convert_proof_to_optimum(proof)
        try:
            y, y_box = fit_row_and_bound_multipliers(
                self._convert_joint_problem_to_qp(problem), proof.z, 1e-9
            )
        except RuntimeError:
            # Non-negative least squares gave up: the optimum is valid without multipliers.
            y, y_box = np.full(self._m, np.nan), np.full(len(proof.z), np.nan)
        return Optimum(proof.z, y, y_box, proof.bound, proof.kind)

    def _try_proof_by_kkt_error_bounds(self, problem: JointQP, signs: Signs) -> Proof | None:
        """Try to prove an active set optimal by error bounds of its KKT solution, else None."""
        system = self._get_kkt_system_of_active_set(signs) if self._convex else None
        if system is None or not system.is_proven_nonsingular:
            return None
        return prove_optimum_by_kkt_error_bounds(problem, self._geometry, system)

    def _get_kkt_system_of_active_set(self, signs: Signs) -> KKTSystem:
        """Return the KKT system of an active set, from a cache of the last ones."""
        key = signs.tobytes()
        system = self._data.systems.get(key)
        if system is None:
            system = self._data.systems[key] = KKTSystem(self._P, self._C, signs)
            if len(self._data.systems) > REMEMBERED:
                self._data.systems.popitem(last=False)
        else:
            self._data.systems.move_to_end(key)
        return system

    def _try_gap_and_exact_proofs(
        self, problem: JointQP, tried: list[Signs], known: Proof | None
    ) -> Proof | None:
        """Return the best proof: known, or by gap or exactly from tried active sets; or None."""
        if not self._definite:
            return known
        proofs = [] if known is None else [known]
        starts = tried or [np.zeros(len(problem.L), dtype=np.int8)]
        # Guesses differ in their weakly active rows.
        for signs in reversed(starts):
            if (by_gap := self._try_proof_by_duality_gap(problem, signs)) is not None:
                proofs.append(by_gap)
                if by_gap.bound <= WANTED:
                    break
        if not any(proof.bound <= WANTED for proof in proofs) and len(problem.q) <= EXACT_SIZE:
            # Rows that depend on others exactly would make it begin with none.
            start = select_independent_active_rows(self._C, starts[-1], starts[-1])
            exact = prove_optimum_in_exact_arithmetic(problem, self._get_exact_matrices(), start)
            proofs += [] if exact is None else [exact]
        return min(proofs, key=lambda p: (p.kind == "infeasible", p.bound), default=None)

    def _try_proof_by_duality_gap(self, problem: JointQP, signs: Signs) -> Proof | None:
        """Try to prove the optimum by its duality gap from the active set `signs`, else None."""
        if self._data.inverse is None:
            free = self._get_kkt_system_of_active_set(np.zeros_like(signs))
            if not free.is_proven_nonsingular:
                return None
            self._data.inverse = free.bound_inverse_entrywise()
        held = select_independent_active_rows(self._C, signs, signs)
        system = self._get_kkt_system_of_active_set(held)
        if not system.is_proven_nonsingular:
            return None
        # The point to rounding is enough to see which limits it touches.
        touched = find_signs_of_limits_met(
            problem, system.X @ system.build_right_hand_side(problem.q, problem.L, problem.U)
        )
        signs = select_independent_active_rows(self._C, np.where(held, held, touched), held)
        exact, inverse = self._get_exact_matrices(), self._data.inverse
        return prove_optimum_by_duality_gap(
            problem, exact, self._get_kkt_system_of_active_set, signs, inverse
        )

    def _convert_proof_to_optimum(self, proof: Proof) -> Optimum:
        """Return a proof as an optimum, its multipliers split into rows and bounds."""
        y, y_box = proof.y[: self._m], proof.y[self._m :]
        return Optimum(proof.z, y, y_box, proof.bound, proof.kind)

    def _find_proof_of_infeasibility(self, problem: JointQP) -> Optimum | None:
        """Return a verdict of infeasibility with a verified Farkas vector, or None."""
        farkas = find_farkas_vector(self._convert_joint_problem_to_qp(problem))
        if farkas is None:
            return None
        self._farkas = farkas
        return self._certify_infeasible_if_proven(problem, *farkas)

    def _reuse_earlier_proof_of_infeasibility(self, problem: JointQP) -> Optimum | None:
        """Return the verdict "infeasible" by an earlier Farkas vector that is still valid, or None.

        Problems undecided at rounding need a vector of their own.
        """
        if self._farkas is None:
            return None
        both = np.concatenate(self._farkas)
        used = np.flatnonzero(both)
        limits = np.where(both > 0.0, problem.U, problem.L)[used]
        # Most vectors of another step are seen to prove nothing before they are tried exactly.
        if not both[used] @ limits < 0.0 or not is_farkas_vector_proof(
            self._convert_joint_problem_to_qp(problem), *self._farkas
        ):
            return None
        verdict = self._certify_infeasible_if_proven(problem, *self._farkas)
        return verdict if verdict.kind == "infeasible" else None

    def _certify_infeasible_if_proven(self, problem: JointQP, y: Vector, y_box: Vector) -> Optimum:
        """Return a certificate of infeasibility, from multipliers that prove it, or undecided."""
        least = bound_least_constraint_violation(
            self._convert_joint_problem_to_qp(problem), np.concatenate((y, y_box))
        )
        kind: Kind = "undecided" if least.is_undecided else "infeasible"
        return Optimum(np.full(len(problem.q), np.nan), y, y_box, np.inf, kind)

    def _certify_infeasible_by_exact_multipliers(
        self, problem: JointQP, multipliers: Vector
    ) -> Optimum:
        """Return the infeasibility verdict of exact Farkas multipliers if valid once rounded.

        Where they do not, the least violation may still be seen to be rounding.
        """
        y = multipliers[: self._m]
        y_box = -(y @ self._A)
        if is_farkas_vector_proof(self._convert_joint_problem_to_qp(problem), y, y_box):
            return self._certify_infeasible_if_proven(problem, y, y_box)
        if bound_least_constraint_violation(
            self._convert_joint_problem_to_qp(problem)
        ).is_undecided:
            return replace(self._make_optimum_without_proof(), kind="undecided")
        return self._make_optimum_without_proof()

    def _make_optimum_without_proof(self) -> Optimum:
        """Return the result for a QP with nothing proven: NaN arrays, infinite error bound."""
        n, nan = len(self._lb), np.nan
        reason = "" if self._definite else SINGULAR if self._convex else INDEFINITE
        nothing = np.full(n, nan), np.full(self._m, nan), np.full(n, nan)
        return Optimum(*nothing, np.inf, "none", reason)

    def _convert_joint_problem_to_qp(self, problem: JointQP) -> QuadraticProgram:
        """Return a problem of this referee's matrices as a QP with rows and bounds."""
        m = self._m
        return QuadraticProgram(
            self._P, problem.q, self._A, problem.L[:m], problem.U[:m], self._lb, self._ub
        )


def get_shared_referee(P: Matrix, A: Matrix, lb: Vector, ub: Vector) -> Referee:
    """Return a checker of QP optima that shares cached data of equal matrices in this thread."""
    parts = P.tobytes(), A.tobytes(), lb.tobytes(), ub.tobytes()
    return _make_cached_referee(get_ident(), len(lb), *parts).copy_without_memory()


@lru_cache(maxsize=8)
def _make_cached_referee(thread: int, n: int, P: bytes, A: bytes, lb: bytes, ub: bytes) -> Referee:
    """Make the referee of some matrices, given as bytes; cached by thread."""
    square, rows, *bounds = (np.array(memoryview(part).cast("d")) for part in (P, A, lb, ub))
    return Referee(square.reshape(n, n), rows.reshape(-1, n), *bounds)


def certify(qp: QuadraticProgram) -> Optimum:
    """Certify the optimum of a single QP: return it with an error bound, or what is proven.

    Examples
    --------
    >>> limits = {"l": [-9.0], "u": [2.0], "lb": [-9.0, -9.0], "ub": [1.0, 1.0]}
    >>> certify(QuadraticProgram(P=[[1, 0], [0, 1]], q=[-3.0, -3.0], A=[[1.0, 1.0]], **limits)).z
    array([1., 1.])
    """
    if not isinstance(qp, QuadraticProgram):
        raise TypeError(
            f"qp: found an object of type {type(qp).__name__}; allowed: a QuadraticProgram"
        )
    return Referee(qp.P, qp.A, qp.lb, qp.ub).certify_vectors(qp.q, qp.l, qp.u)


def measure_first_move_and_plan_errors_of_many(
    z: Matrix, optima: Sequence[Optimum], block: int, moves: int = 0
) -> tuple[Vector, Vector]:
    """Return the largest distance of K answers z (K, n) to the optima: (K,) of first move and plan.

    With `moves` only the first `moves` variables of each block count, the others being slacks.
    All variables are one block if block is 0; inf where z is not finite; NaN where there is no
    certified optimum to compare with. The bound of the optimum is not added.
    """
    size = block or z.shape[1]
    error = np.abs(z - np.array([optimum.z for optimum in optima]))
    by_block = error.reshape(len(z), -1, size)[:, :, : moves or size]
    errors = by_block[:, 0].max(axis=1), by_block.max(axis=(1, 2))
    lost = ~np.isfinite(z).all(axis=1)
    unknown = ~np.isfinite([optimum.bound for optimum in optima])
    move, plan = (np.where(unknown, np.nan, np.where(lost, np.inf, part)) for part in errors)
    return move, plan


def yield_certified_optima(sequence: QPSequence) -> Iterator[Optimum]:
    """Yield the certified optimum of each step of a QP sequence in scaled units."""
    qp = sequence.base
    referee = Referee(qp.P, qp.A, qp.lb, qp.ub)
    for k in range(len(sequence)):
        step = sequence.step(k)
        if qp.changed_by(step):
            qp = qp.at(step)
            referee = referee.for_changed_matrices(qp.P, qp.A, qp.lb, qp.ub)
        yield referee.certify_vectors(step.q, step.l, step.u)


def certify_all_steps(sequence: QPSequence) -> list[Optimum]:
    """Return the certified optimum of each step of a QP sequence in scaled units."""
    return list(yield_certified_optima(sequence))


def is_infeasibility_or_unboundedness_claim_true(
    qp: QuadraticProgram, solution: Solution, optimum: Optimum
) -> bool:
    """Return whether a claim of infeasible or unbounded is proven, by its vectors or by ours."""
    if solution.status is Status.PRIMAL_INFEASIBLE:
        return optimum.kind == "infeasible" or is_farkas_vector_proof(
            qp, solution.y, solution.y_box
        )
    if solution.status is Status.DUAL_INFEASIBLE:
        if optimum.kind not in ("none", "infeasible"):
            return False
        return (
            is_direction_proof_of_unboundedness(qp, solution.z)
            or find_unbounded_direction(qp) is not None
        )
    return False
