"""Last certificates of the referee, in equilibrated units.

The problem is equilibrated by powers of two, the active set guessed anew in those units (with a
proximal term where P is singular), completed by the rows that are weakly active, and certified by
the linear certificate or by the enclosure of a feasible point.

The enclosure is the gap certificate under equality rows: no z in float64, nor any finite one in
binary, need satisfy an equality row exactly. But with z~ a refined point, C_E the equality rows, r
their exact residual at z~ and B any approximate right inverse of C_E with ‖C_E B − I‖ ≤ α < 1, the
point

    ẑ = z~ + B (C_E B)⁻¹ r,   |ẑ − z~| ≤ e = |B| (|r| + α/(1−α) max|r|)

satisfies them exactly, and every other limit whose slack at z~ is at least |C| e: inequality rows
are held at limits moved inwards, equality rows where they are.

Let P be positive semidefinite (or P + Σ_E w c cᵀ be, which is the same cost on the feasible set),
y multipliers whose signs name finite limits, r = Pẑ + q + Cᵀy, g = Σ |y_i| slack_i(ẑ) over the
inequality rows, S those of them with y_i ≠ 0, M = P + Σ_{E,S} w_i c_i c_iᵀ positive definite and
d = z − ẑ for any feasible z that costs no more than ẑ. Comparing the costs,

    ½ dᵀPd + Σ |y_i| slack_i(z) ≤ g − rᵀd ≤ g + ρ‖d‖_M =: ε,   ρ² = rᵀM⁻¹r

so dᵀPd ≤ 2ε, |c_iᵀd| ≤ ε/|y_i| on S and c_iᵀd = 0 on E; with ω = Σ_S w_i/y_i² and ωρ² ≤ ¼

    ‖d‖²_M ≤ 2ε + ωε²   ⟹   ‖d‖_M ≤ x = 2ρ + √(4ρ² + 4g + 4ωg²),   |d_j| ≤ x √((M⁻¹)_jj)

Hence there is a minimiser, and every minimiser lies in that box. P may vanish wherever rows with
multipliers take its place: a vertex of a linear program is certified too.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linprog, nnls

from dpbench.arrays import Flags, Indices, Matrix, Vector
from dpbench.qp.referee.dyadic import Dyadic
from dpbench.qp.referee.gap import (
    EXCHANGES,
    TAU_EXPONENT,
    exchange_row_for_violated_one,
    find_signs_of_limits_met,
    refine_point_and_multipliers_exactly,
    select_independent_active_rows,
)
from dpbench.qp.referee.guesses import yield_active_set_guesses
from dpbench.qp.referee.implied import (
    remove_limits_of_zero_rows,
    turn_always_met_limits_into_equalities,
)
from dpbench.qp.referee.kernels import OUTWARD, UNIT
from dpbench.qp.referee.kkt import (
    Geometry,
    KKTSystem,
    compute_rounding_error_factor,
    is_proven_positive_definite,
    prove_optimum_by_kkt_error_bounds,
)
from dpbench.qp.referee.optimum import (
    ExactMatrices,
    JointQP,
    Kind,
    Proof,
    Scales,
    Signs,
    is_exact_after_power_of_two_scaling,
)

NO_MULTIPLIER = 1e-12  # A multiplier of less than this share of the largest one is no support for M
LEAST_MULTIPLIER = 2.0 ** (TAU_EXPONENT // 2)  # Moving limits by τ makes them of √τ at most
WEIGHT = 4.0  # w of every row, of the largest diagonal entry of P
AMOUNT_BITS = 20  # Inward amounts are multiples of 2^−AMOUNT_BITS·τ


@dataclass(frozen=True, slots=True, eq=False)
class EnclosedPoint:
    """Point z (n,) with a rigorous error bound for each variable, and multipliers y (N,)."""

    z: Vector
    y: Vector
    bound: Vector


@dataclass(frozen=True, slots=True, eq=False)
class _NearPoint:
    """Exact point z, λ and slacks, with a bound e (n,) of its distance to a feasible point."""

    z: Dyadic
    lam: Dyadic
    slack: Dyadic
    e: Vector


def enclose_all_optima(
    problem: JointQP, exact: ExactMatrices, system: KKTSystem, inward: Vector, *, convex: bool
) -> EnclosedPoint | None:
    """Enclose all optima of a QP with equality rows or singular P; None without proof.

    system : a `proven` system of independent rows, all equality-like rows among them.
    inward : (w,) how far its rows are held inside their limits, in units of 2^TAU_EXPONENT; 0 for
        equality-like rows.
    convex : whether P is proven positive semidefinite.
    """
    if (near := _refine_to_nearly_feasible_point(problem, exact, system, inward)) is None:
        return None
    rows = system.rows
    equal = problem.L[rows] == problem.U[rows]
    # A multiplier of the wrong sign is zero here and its row becomes part of r.
    keep = equal | (near.lam.entry_signs() == system.signs)
    lam = Dyadic(np.where(keep, near.lam.whole, 0), near.lam.exponent)
    size = np.abs(lam.round_to_floats())
    support = equal | (size > max(NO_MULTIPLIER * size.max(initial=0.0), LEAST_MULTIPLIER))
    inverse = _bound_penalised_hessian_inverse_entrywise(
        problem, rows[support], rows[equal], convex=convex
    )
    if inverse is None:
        return None
    weight = _choose_penalty_weight(problem.P)
    omega = float((weight / size[support & ~equal] ** 2).sum()) * OUTWARD
    slack = np.abs(near.slack.round_to_floats()) + np.abs(problem.C[rows]) @ near.e
    gap = float((size * slack)[~equal].sum()) * OUTWARD
    r = exact.P @ near.z + Dyadic.from_floats(problem.q) + exact.C[rows].T @ lam
    r_abs = (np.abs(r.round_to_floats()) + np.abs(problem.P) @ near.e) * OUTWARD
    rho = float(np.sqrt(r_abs @ inverse @ r_abs)) * OUTWARD
    if not omega * rho**2 * OUTWARD <= 0.25:
        return None
    x = (2.0 * rho + math.sqrt(4.0 * (rho**2 + gap + omega * gap**2))) * OUTWARD
    z = near.z.round_to_floats()
    # z.floats() is off by half a unit in the last place at most.
    bound = x * np.sqrt(np.diagonal(inverse)) + near.e + np.spacing(np.abs(z))
    y = np.zeros(len(problem.L))
    y[rows] = lam.round_to_floats()
    return EnclosedPoint(z, y, np.asarray(bound * OUTWARD, dtype=np.float64))


def _refine_to_nearly_feasible_point(
    problem: JointQP, exact: ExactMatrices, system: KKTSystem, inward: Vector
) -> _NearPoint | None:
    """Refine a point and prove that a feasible one is near; None without proof."""
    rows, n = system.rows, system.n
    limits = Dyadic.from_floats(np.concatenate((problem.U, problem.L))[system.limits])
    amounts = np.round(inward * 2.0**AMOUNT_BITS) * -system.signs
    shift = Dyadic.from_floats(amounts)
    target = limits + Dyadic(shift.whole, shift.exponent + TAU_EXPONENT - AMOUNT_BITS)
    if (refined := refine_point_and_multipliers_exactly(problem, exact, system, target)) is None:
        return None
    z, lam = refined
    equal = problem.L[rows] == problem.U[rows]
    value = exact.C @ z
    slack = limits - value[rows]
    e = _bound_distance_to_equality_rows(
        problem.C[rows[equal]], system.X[:n, n:][:, equal], slack[equal].round_to_floats()
    )
    others = problem.L != problem.U
    if e is None or not _are_limits_met_with_margin(
        problem, value, np.abs(problem.C) @ e * OUTWARD, others
    ):
        return None
    # Every equality-like row must be among those that ẑ satisfies.
    if others.sum() + equal.sum() != len(problem.L):
        return None
    return _NearPoint(z, lam, slack, e)


def _bound_distance_to_equality_rows(C: Matrix, B: Matrix, residual: Vector) -> Vector | None:
    """Return a bound (n,) of the distance to a point that satisfies equality rows C, or None."""
    if not len(C):
        return np.zeros(C.shape[1])
    identity = np.eye(len(C))
    defect = np.abs(C @ B - identity) + compute_rounding_error_factor(C.shape[1] + 2) * (
        np.abs(C) @ np.abs(B) + identity
    )
    alpha = float(defect.sum(axis=1).max()) * OUTWARD
    if not alpha < 0.5:
        return None
    size = np.abs(residual) * OUTWARD
    e: Vector = np.abs(B) @ (size + alpha / (1.0 - alpha) * size.max()) * OUTWARD
    return e


def _are_limits_met_with_margin(
    problem: JointQP, value: Dyadic, doubt: Vector, rows: Flags
) -> bool:
    """Return whether given constraint rows satisfy their limits by a margin of at least `doubt`."""
    for limit, sign in ((problem.U, 1), (problem.L, -1)):
        there = np.flatnonzero(rows & np.isfinite(limit))
        slack = Dyadic.from_floats(limit[there]) - value[there]
        least = sign * (slack - Dyadic.from_floats(sign * doubt[there])).entry_signs()
        if (least < 0).any():
            return False
    return True


def _choose_penalty_weight(P: Matrix) -> float:
    """Return the penalty weight w of the constraint rows C in the augmented Hessian P + w CᵀC."""
    return WEIGHT * (float(np.abs(np.diagonal(P)).max(initial=0.0)) or 1.0)


def _compute_matrix_below_penalised_hessian(P: Matrix, C: Matrix) -> Matrix:
    """Return a matrix provably below the augmented Hessian P + w CᵀC, rounding included."""
    w = _choose_penalty_weight(P)
    M = P + w * (C.T @ C)
    size = np.abs(P) + w * (np.abs(C).T @ np.abs(C))
    lost = compute_rounding_error_factor(len(C) + 4) * float(size.sum(axis=1).max())
    M = 0.5 * (M + M.T)
    return np.asarray(M - (2.0 * lost + UNIT * np.abs(M).max()) * np.eye(len(P)), dtype=np.float64)


def _bound_penalised_hessian_inverse_entrywise(
    problem: JointQP, support: Indices, equal: Indices, *, convex: bool
) -> Matrix | None:
    """Return upper bounds of the entries of |(P + w CᵀC)⁻¹|, C some rows; None without proof."""
    P, C = problem.P, problem.C
    if not convex and not is_proven_positive_definite(
        _compute_matrix_below_penalised_hessian(P, C[equal])
    ):
        return None
    M = _compute_matrix_below_penalised_hessian(P, C[support])
    if not is_proven_positive_definite(M):
        return None
    n = len(P)
    system = KKTSystem(M, np.zeros((0, n)), np.zeros(0, dtype=np.int8))
    return system.bound_inverse_entrywise() if system.is_proven_nonsingular else None


PROXIMAL = 10.0 ** -np.arange(4.0, 9.0)  # Weights of the proximal term where P is singular
PROXIMAL_STEPS = 6  # With each of them
SETTLED = 1e-9  # Relative change of the proximal point at which its active set is taken
ENOUGH = 1e-10  # A bound no better than it asks for another guess
USEFUL = 1e-6  # A bound above it, of the size of the optimum, is no optimum to judge anybody by
LARGEST = 1e6  # Inward amounts beyond it would need more room than the limits moved by τ leave


@dataclass(frozen=True, slots=True, eq=False)
class _SetGuess:
    """Guessed active set of a QP, and its primal point if known."""

    signs: Signs
    z: Vector | None


class LastResort:
    """Costliest certifier of optima of QPs with the same P and C: scaled, equalities enclosed."""

    def __init__(self, P: Matrix, C: Matrix, *, convex: bool) -> None:
        self._scales = Scales.compute_ruiz_scales(P, C)
        self._safe = is_exact_after_power_of_two_scaling(P, C)
        self._P, self._C = self._scales.scale_cost_matrix(P), self._scales.scale_constraint_rows(C)
        # It may be proven definite in these units where it is not in the others.
        self._definite = is_proven_positive_definite(self._P)
        self._convex = convex or self._definite
        self._geometry = Geometry(self._C)
        self._exact: ExactMatrices | None = None

    def prove_optimum(self, problem: JointQP) -> Proof | None:
        """Certify an optimum that is still open; y is NaN where implied limits took part."""
        if not (
            self._safe and is_exact_after_power_of_two_scaling(problem.q, problem.L, problem.U)
        ):
            return None
        if self._exact is None:
            self._exact = ExactMatrices.from_float_matrices(self._P, self._C)
        best: Proof | None = None
        posed = [remove_limits_of_zero_rows(problem)]
        for at in posed:
            scaled = self._scales.scale_problem(at, self._P, self._C)
            for guess in self._yield_active_set_guesses(scaled):
                proof, touched = self._prove_guess_or_find_flat_limits(scaled, guess)
                if proof is not None and (best is None or proof.bound < best.bound):
                    implied = at is not posed[0]
                    best = replace(proof, y=np.full_like(proof.y, np.nan)) if implied else proof
                if best is not None and best.bound <= ENOUGH:
                    return best
                tighter = (
                    None
                    if touched is None or len(posed) > 1
                    else turn_always_met_limits_into_equalities(at, touched)
                )
                if tighter is not None:
                    posed.append(tighter)
                    break
        if best is None or best.bound > USEFUL * max(1.0, float(np.abs(best.z).max())):
            return None
        return best

    def _yield_active_set_guesses(self, problem: JointQP) -> Iterator[_SetGuess]:
        """Yield guesses of the active set, by the proximal point method where P is singular."""
        if self._definite:
            for signs in yield_active_set_guesses(problem):
                if signs is not None:
                    yield _SetGuess(signs, None)
        else:
            yield from self._yield_active_sets_by_proximal_point(problem)

    def _yield_active_sets_by_proximal_point(self, problem: JointQP) -> Iterator[_SetGuess]:
        """Yield active sets that the proximal point method finds for a singular P."""
        n = len(problem.q)
        # On the feasible set the squares of equality rows are constant, whatever P is across it.
        E = problem.C[problem.L == problem.U]
        b = problem.U[problem.L == problem.U]
        P_E, q_E = problem.P + WEIGHT * E.T @ E, problem.q - WEIGHT * E.T @ b
        z, signs = np.zeros(n), None
        for weight in np.repeat(PROXIMAL, PROXIMAL_STEPS):
            at = replace(problem, P=P_E + weight * np.eye(n), q=q_E - weight * z)
            answer = next(yield_active_set_guesses(at), None)
            moved = None if answer is None else _minimise_with_active_rows_as_equalities(at, answer)
            if moved is None:
                break
            before, z, signs = z, moved, answer
            if np.abs(z - before).max() <= SETTLED * (1.0 + np.abs(z).max()):
                break
        if signs is not None:
            yield _SetGuess(signs, z)
            if (explaining := _find_limits_balancing_gradient(problem, z)) is not None:
                yield _SetGuess(explaining, z)

    def _prove_guess_or_find_flat_limits(
        self, problem: JointQP, guess: _SetGuess
    ) -> tuple[Proof | None, Signs | None]:
        """Return a proof from a guessed active set or None, and limits without interior or None."""
        assert self._exact is not None, "made before any guess is asked for"
        equal = np.where(problem.L == problem.U, 1, 0).astype(np.int8)
        held = select_independent_active_rows(problem.C, np.where(equal, equal, guess.signs), equal)
        system = KKTSystem(problem.P, problem.C, held)
        z = guess.z
        if system.is_proven_nonsingular:
            proof = prove_optimum_by_kkt_error_bounds(problem, self._geometry, system)
            if proof is not None and self._convex:
                bound = np.full(len(proof.z), proof.bound)
                return self._convert_proof_to_unscaled_problem(
                    proof.z, proof.y, bound, "linear"
                ), None
            z = system.X @ system.build_right_hand_side(problem.q, problem.L, problem.U)
        if z is None:
            return None, None
        touched = np.where(equal, equal, find_signs_of_limits_met(problem, z))
        return self._enclose_optimum_or_find_flat_limits(problem, held, touched)

    def _enclose_optimum_or_find_flat_limits(
        self, problem: JointQP, held: Signs, touched: Signs
    ) -> tuple[Proof | None, Signs | None]:
        """Return a proof at `touched` rows, and a set without interior; None for either absent."""
        assert self._exact is not None, "made before any guess is asked for"
        rows: Signs | None = select_independent_active_rows(
            problem.C, np.where(held, held, touched), held
        )
        for _ in range(EXCHANGES):
            if rows is None:
                break
            system = KKTSystem(problem.P, problem.C, rows)
            inward = _find_inward_shifts_of_active_rows(problem, system, touched)
            if inward is None:
                return None, touched
            if not system.is_proven_nonsingular:
                break
            found = enclose_all_optima(problem, self._exact, system, inward, convex=self._convex)
            if found is not None:
                return self._convert_proof_to_unscaled_problem(
                    found.z, found.y, found.bound, "gap"
                ), None
            rows = exchange_row_for_violated_one(problem, self._exact, system)
        return None, None

    def _convert_proof_to_unscaled_problem(
        self, z: Vector, y: Vector, bound: Vector, kind: Kind
    ) -> Proof:
        """Return a proof for the QP as given from that of its scaled form."""
        D = self._scales.D
        worst = float((D * bound).max()) * OUTWARD
        return Proof(D * z, self._scales.unscale_multipliers(y), worst, kind)


def _find_limits_balancing_gradient(problem: JointQP, z: Vector) -> Signs | None:
    """Return limits met at z whose multipliers of the right sign balance the gradient there."""
    touched = find_signs_of_limits_met(problem, z)
    equal = problem.L == problem.U
    rows = np.flatnonzero(np.where(equal, 0, touched))
    free = problem.C[equal].T
    columns = np.hstack(((touched[rows, np.newaxis] * problem.C[rows]).T, free, -free))
    # Without a column the library reads what is not there.
    if not columns.shape[1]:
        return None
    try:
        weights, _ = nnls(columns, -(problem.P @ z + problem.q), maxiter=30 * len(touched))
    except RuntimeError:
        return None
    signs: Signs = equal.astype(np.int8)
    used = rows[weights[: len(rows)] > 0.0]
    signs[used] = touched[used]
    return signs


def _minimise_with_active_rows_as_equalities(problem: JointQP, signs: Signs) -> Vector | None:
    """Return the minimiser with the rows `signs` held as equalities; None where singular."""
    held = select_independent_active_rows(problem.C, signs, signs)
    rows, n = np.flatnonzero(held), len(problem.q)
    G = problem.C[rows]
    K = np.block([[problem.P, G.T], [G, np.zeros((len(rows), len(rows)))]])
    limits = np.where(held > 0, problem.U, problem.L)[rows]
    try:
        z = np.linalg.solve(K, np.concatenate((-problem.q, limits)))[:n]
    except np.linalg.LinAlgError:
        return None
    return np.asarray(z) if np.isfinite(z).all() else None


def _find_inward_shifts_of_active_rows(
    problem: JointQP, system: KKTSystem, touched: Signs
) -> Vector | None:
    """Return how far inside its limit to hold each active row so that all near hold, or None."""
    equal = problem.L == problem.U
    amounts = np.where(equal[system.rows], 0.0, 1.0)
    others = touched != 0
    others[system.rows] = False
    if (others & equal).any():
        return None
    if not others.any():
        return amounts
    own = ~equal[system.rows]
    G = system.signs[own, np.newaxis] * problem.C[system.rows[own]]
    inside = np.vstack((G, touched[others, np.newaxis] * problem.C[others]))
    n, k = inside.shape[1], len(inside)
    E = problem.C[system.rows[~own]]
    A_ub = np.block([[inside, np.zeros((k, 1))], [-inside, -np.ones((k, 1))]])
    bounds = [(None, None)] * n + [(0.0, LARGEST)]
    along: dict[str, Any] = {}
    if len(E):
        along = {"A_eq": np.column_stack((E, np.zeros(len(E)))), "b_eq": np.zeros(len(E))}
    b_ub = np.repeat([-1.0, 0.0], k)
    answer = linprog(np.eye(n + 1)[n], A_ub=A_ub, b_ub=b_ub, bounds=bounds, **along)
    if answer.x is None:
        return None
    amounts[own] = -(G @ answer.x[:n])
    return amounts
