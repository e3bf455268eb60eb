"""Gap certificate: the optimum of a QP with weakly active rows.

For feasible z, and y whose signs name finite limits,

    gap = Σ y⁺(U − Cz) + Σ y⁻(Cz − L) + ½ rᵀP⁻¹r ≥ ½ (z − z*)ᵀP(z − z*),   r = Pz + q + Cᵀy
    |z_i − z*_i| ≤ √(2·gap·(P⁻¹)_ii)

z and y are refined in exact dyadic arithmetic against limits moved inwards by τ, so that z is
feasible to the last bit and every slack of an active row is τ to within the refinement; no
difference of objectives is taken, which would be rounding noise.
"""

import math

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.qp.referee.dyadic import Dyadic
from dpbench.qp.referee.joint import ExactMatrices, JointQP, Proof, Signs
from dpbench.qp.referee.kernels import OUTWARD
from dpbench.qp.referee.kkt import KKTSystem

TAU_EXPONENT = -120
"""τ = 2^−120: √(2·τ·‖y‖₁·(P⁻¹)_ii) stays below 1e-12 for ‖y‖₁·(P⁻¹)_ii up to 1e12."""
LAST_BIT = -170  # Refined x is a multiple of 2^LAST_BIT
ROUNDS = 12  # Each round of refinement gains some 53 − log₂ cond(K) bits; 12 are enough up to 1e12
NEAR = 1e-9  # Relative slack below which an inactive row counts as weakly active


def find_met_limits(problem: JointQP, z: Vector) -> Signs:
    """Return the signs (N,) of the limits that z meets or violates, to within rounding."""
    value = problem.C @ z[: len(problem.q)]
    near = NEAR * (1.0 + np.abs(value))
    upper, lower = problem.U - value <= near, value - problem.L <= near
    return np.where(upper, 1, np.where(lower, -1, 0)).astype(np.int8)


def select_independent(C: Matrix, signs: Signs, first: Signs) -> Signs:
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


def gap_certificate(
    problem: JointQP, exact: ExactMatrices, system: KKTSystem, inverse: Matrix
) -> Proof | None:
    """Certify an optimum by its duality gap at an exactly feasible point, or return None.

    system : a `proven` system of all rows that may be active; inverse (n, n) : entrywise upper
    bounds of |P⁻¹|, P positive definite. None where no feasible z is found this way, as with
    equality-like rows (see `last_resort`).
    """
    rows = system.rows
    limits = np.concatenate((problem.U, problem.L))[system.limits]
    inward = Dyadic(np.array([-int(s) for s in system.signs], dtype=object), TAU_EXPONENT)
    target = Dyadic.of(limits) + inward
    refined = refine_exactly(problem, exact, system, target)
    if refined is None:
        return None
    z, lam = refined
    if not _is_feasible(problem, exact, z):
        return None
    # A multiplier of the wrong sign is set to zero: its row becomes part of r.
    lam = Dyadic(np.where(lam.signs() == system.signs, lam.whole, 0), lam.exponent)
    G = exact.C[rows]
    slack = Dyadic.of(limits) - G @ z
    r = exact.P @ z + Dyadic.of(problem.q) + G.T @ lam
    size = np.abs(r.floats()) * OUTWARD
    gap = float((lam * slack).sum().floats()) * OUTWARD + 0.5 * float(size @ inverse @ size)
    y = np.zeros(len(problem.L))
    y[rows] = lam.floats()
    radius = math.sqrt(2.0 * gap * float(np.diagonal(inverse).max())) * OUTWARD
    nearest = z.floats()
    # z.floats() is off by half a unit in the last place at most.
    rounding = float(np.spacing(np.abs(nearest)).max())
    return Proof(nearest, y, (radius + rounding) * OUTWARD, "gap")


def refine_exactly(
    problem: JointQP, exact: ExactMatrices, system: KKTSystem, target: Dyadic
) -> tuple[Dyadic, Dyadic] | None:
    """Solve an active set's KKT system by iterative refinement in exact numbers, or return None."""
    n = system.n
    G, q = exact.C[system.rows], Dyadic.of(problem.q)
    x = Dyadic(np.array([0] * len(system.weight), dtype=object), LAST_BIT)
    for _ in range(ROUNDS):
        z, lam = x[:n], x[n:]
        upper = -(exact.P @ z + q + G.T @ lam)
        lower = target - G @ z
        step = system.X @ np.concatenate((upper.floats(), lower.floats()))
        change = _round_to_multiples(step)
        if not change.any():
            return z, lam
        x = Dyadic(np.asarray(x.whole + change, dtype=object), LAST_BIT)
        # Slacks need be right to far less than τ only.
        if max(abs(c) for c in change.tolist()) < 1 << (TAU_EXPONENT - LAST_BIT - 30):
            return x[:n], x[n:]
    return None


def _round_to_multiples(step: Vector) -> NDArray[np.object_]:
    """Round a refinement step to integer multiples of a fixed power of two."""
    digits = Dyadic.of(step)
    shift = digits.exponent - LAST_BIT
    if shift >= 0:
        return digits.at(LAST_BIT)
    return np.asarray(digits.whole >> -shift, dtype=object)


def _is_feasible(problem: JointQP, exact: ExactMatrices, z: Dyadic) -> bool:
    """Return whether a point satisfies all limits, in exact arithmetic."""
    value = exact.C @ z
    upper, lower = np.isfinite(problem.U), np.isfinite(problem.L)
    over = value[upper] - Dyadic.of(problem.U[upper])
    under = Dyadic.of(problem.L[lower]) - value[lower]
    return not any((excess.signs() > 0).any() for excess in (over, under))
