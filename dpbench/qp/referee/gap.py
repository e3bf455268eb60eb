"""Gap certificate: the optimum of a QP with weakly active rows.

For feasible z, and y whose signs name finite limits,

    gap = Σ y⁺(U − Cz) + Σ y⁻(Cz − L) + ½ rᵀP⁻¹r ≥ ½ (z − z*)ᵀP(z − z*),   r = Pz + q + Cᵀy
    |z_i − z*_i| ≤ √(2·gap·(P⁻¹)_ii)

z and y are refined in exact dyadic arithmetic against limits moved inwards by τ, so that z is
feasible to the last bit and every slack of an active row is τ to within the refinement; no
difference of objectives is taken, which would be rounding noise.

More rows than dimensions may meet in a point, as a sector's edge does in a corner of a polygon.
Rounding then decides which of them hold it, and the point of the others violates the rest by an
ulp: an exchange of rows by the dual simplex rule then leads to the ones that do.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.qp.referee.dyadic import Dyadic
from dpbench.qp.referee.kernels import OUTWARD
from dpbench.qp.referee.kkt import KKTSystem
from dpbench.qp.referee.optimum import ExactMatrices, JointQP, Proof, Signs

TAU_EXPONENT = -120
"""τ = 2^−120: √(2·τ·‖y‖₁·(P⁻¹)_ii) stays below 1e-12 for ‖y‖₁·(P⁻¹)_ii up to 1e12."""
LAST_BIT = -170  # Refined x is a multiple of 2^LAST_BIT
ROUNDS = 12  # Each round of refinement gains some 53 − log₂ cond(K) bits; 12 are enough up to 1e12
EXCHANGES = 20  # Most choices of rows that are tried where more than n meet in a point
NEAR = 1e-9  # Relative slack below which an inactive row counts as weakly active


def find_signs_of_limits_met(problem: JointQP, z: Vector) -> Signs:
    """Return the signs (N,) of the limits that z meets or violates, to within rounding."""
    value = problem.C @ z[: len(problem.q)]
    near = NEAR * (1.0 + np.abs(value))
    upper, lower = problem.U - value <= near, value - problem.L <= near
    return np.where(upper, 1, np.where(lower, -1, 0)).astype(np.int8)


def select_independent_active_rows(C: Matrix, signs: Signs, first: Signs) -> Signs:
    """Select linearly independent constraint rows of an active set, preferring those in `first`."""
    chosen = np.zeros_like(signs)
    n = C.shape[1]
    basis = np.zeros((0, n))
    for i in np.lexsort((np.arange(len(signs)), first == 0)):
        if not signs[i] or len(basis) == n:
            continue
        rest = C[i]
        # Twice is enough (Kahan and Parlett).
        for _ in range(2):
            rest = rest - basis.T @ (basis @ rest)
        size = float(np.linalg.norm(rest))
        if size > NEAR * float(np.linalg.norm(C[i])):
            basis = np.vstack((basis, rest / size))
            chosen[i] = signs[i]
    return chosen


def prove_optimum_by_duality_gap(
    problem: JointQP,
    exact: ExactMatrices,
    systems: Callable[[Signs], KKTSystem],
    signs: Signs,
    inverse: Matrix,
) -> Proof | None:
    """Certify an optimum by its duality gap at an exactly feasible point, or return None.

    signs (N,) : independent rows that may be active; systems : the KKT system of such a set;
    inverse (n, n) : entrywise upper bounds of |P⁻¹|, P positive definite. None where no feasible z
    is found this way, as with equality-like rows (see `last_resort`).
    """
    for _ in range(EXCHANGES):
        system = systems(signs)
        if not system.is_proven_nonsingular:
            return None
        limits = np.concatenate((problem.U, problem.L))[system.limits]
        inward = Dyadic(np.array([-int(s) for s in system.signs], dtype=object), TAU_EXPONENT)
        refined = refine_point_and_multipliers_exactly(
            problem, exact, system, Dyadic.from_floats(limits) + inward
        )
        if refined is None:
            return None
        z, lam = refined
        violated = _find_signs_of_violated_limits(problem, exact, z)
        if not violated.any():
            return _bound_distance_by_duality_gap(problem, exact, system, inverse, z, lam)
        exchanged = replace_dependent_row_by_violated_one(
            problem, system, lam.round_to_floats(), violated
        )
        if exchanged is None:
            return None
        signs = exchanged
    return None


def exchange_row_for_violated_one(
    problem: JointQP, exact: ExactMatrices, system: KKTSystem
) -> Signs | None:
    """Return signs of the active set with a row exchanged for one that its point violates, or None.

    Rows of the system, and equality rows, which no finite binary number need satisfy, do not count.
    """
    limits = np.concatenate((problem.U, problem.L))[system.limits]
    refined = refine_point_and_multipliers_exactly(
        problem, exact, system, Dyadic.from_floats(limits)
    )
    if refined is None:
        return None
    violated = _find_signs_of_violated_limits(problem, exact, refined[0])
    violated[system.rows], violated[problem.L == problem.U] = 0, 0
    return replace_dependent_row_by_violated_one(
        problem, system, refined[1].round_to_floats(), violated
    )


def replace_dependent_row_by_violated_one(
    problem: JointQP, system: KKTSystem, multipliers: Vector, violated: Signs
) -> Signs | None:
    """Return an active set (N,) in which a violated row replaces one that it depends on, or None.

    With s_t c_t = Σ α_i s_i c_i over the system's rows, the multiplier of a row t that enters rises
    until that of row i, λ_i − α_i λ_t, is the first to reach zero: row i leaves (dual simplex
    method; Nocedal & Wright 2006, section 13.6). Equality rows stay.
    """
    rows = system.rows
    own = problem.C[rows] * system.signs[:, np.newaxis]
    may_leave = problem.L[rows] != problem.U[rows]
    for t in np.flatnonzero(violated):
        enters = violated[t] * problem.C[t]
        share = np.linalg.lstsq(own.T, enters, rcond=None)[0]
        apart = np.abs(own.T @ share - enters).max() > NEAR * np.abs(enters).max()
        falling = may_leave & (share > NEAR)
        if apart or not falling.any():
            continue
        ratio = np.full(len(rows), np.inf)
        np.divide(multipliers * system.signs, share, out=ratio, where=falling)
        signs = np.zeros_like(violated)
        signs[rows] = system.signs
        signs[rows[np.argmin(ratio)]], signs[t] = 0, violated[t]
        return signs
    return None


def _bound_distance_by_duality_gap(
    problem: JointQP,
    exact: ExactMatrices,
    system: KKTSystem,
    inverse: Matrix,
    z: Dyadic,
    lam: Dyadic,
) -> Proof:
    """Bound the distance of z from the optimum by the duality gap, in exact arithmetic."""
    rows = system.rows
    limits = np.concatenate((problem.U, problem.L))[system.limits]
    # A multiplier of the wrong sign is set to zero: its row becomes part of r.
    lam = Dyadic(np.where(lam.entry_signs() == system.signs, lam.whole, 0), lam.exponent)
    G = exact.C[rows]
    slack = Dyadic.from_floats(limits) - G @ z
    r = exact.P @ z + Dyadic.from_floats(problem.q) + G.T @ lam
    size = np.abs(r.round_to_floats()) * OUTWARD
    gap = float((lam * slack).exact_sum().round_to_floats()) * OUTWARD + 0.5 * float(
        size @ inverse @ size
    )
    y = np.zeros(len(problem.L))
    y[rows] = lam.round_to_floats()
    radius = math.sqrt(2.0 * gap * float(np.diagonal(inverse).max())) * OUTWARD
    nearest = z.round_to_floats()
    # z.floats() is off by half a unit in the last place at most.
    rounding = float(np.spacing(np.abs(nearest)).max())
    return Proof(nearest, y, (radius + rounding) * OUTWARD, "gap")


def refine_point_and_multipliers_exactly(
    problem: JointQP, exact: ExactMatrices, system: KKTSystem, target: Dyadic
) -> tuple[Dyadic, Dyadic] | None:
    """Return an active set's z and multipliers, refined in exact numbers, or None."""
    n = system.n
    G, q = exact.C[system.rows], Dyadic.from_floats(problem.q)
    x = Dyadic(np.array([0] * len(system.weight), dtype=object), LAST_BIT)
    for _ in range(ROUNDS):
        z, lam = x[:n], x[n:]
        upper = -(exact.P @ z + q + G.T @ lam)
        lower = target - G @ z
        step = system.X @ np.concatenate((upper.round_to_floats(), lower.round_to_floats()))
        change = _round_step_to_integer_multiples(step)
        if not change.any():
            return z, lam
        x = Dyadic(np.asarray(x.whole + change, dtype=object), LAST_BIT)
        # Slacks need be right to far less than τ only.
        if max(abs(c) for c in change.tolist()) < 1 << (TAU_EXPONENT - LAST_BIT - 30):
            return x[:n], x[n:]
    return None


def _round_step_to_integer_multiples(step: Vector) -> NDArray[np.object_]:
    """Round a refinement step to integer multiples of a fixed power of two."""
    digits = Dyadic.from_floats(step)
    shift = digits.exponent - LAST_BIT
    if shift >= 0:
        return digits.integers_at_exponent(LAST_BIT)
    return np.asarray(digits.whole >> -shift, dtype=object)


def _find_signs_of_violated_limits(problem: JointQP, exact: ExactMatrices, z: Dyadic) -> Signs:
    """Return the signs (N,) of the limits that a point violates, in exact arithmetic."""
    value = exact.C @ z
    upper, lower = np.isfinite(problem.U), np.isfinite(problem.L)
    violated = np.zeros(len(problem.L), dtype=np.int8)
    violated[lower] -= (Dyadic.from_floats(problem.L[lower]) - value[lower]).entry_signs() > 0
    violated[upper] += (value[upper] - Dyadic.from_floats(problem.U[upper])).entry_signs() > 0
    return violated
