"""Guesses of the active set: by a library, a method of our own, or from that of the last step.

A certificate judges them: a failing guesser only costs time.

From a near set it is the primal-dual active-set method (Hintermüller, Ito and Kunisch, SIAM J.
Optim. 13, 2003): at the point of a set W, the rows whose multipliers have the wrong sign go, the
rows that the point violates come, and so on until nothing changes. That need not end, and the set
need not be right.

No system is built on the way. The point of a set that differs from W by some rows solves that of W
with a column for each of them, k in all,

    ┌ K_W  B ┐  ┌ x ┐     ┌ rhs ┐      B  [c_i; 0] for a row i to be added, t its limit
    └ Bᵀ   0 ┘  └ μ ┘  =  └  t  ┘         [0; e_j] for the row at place j to be dropped, t = 0

and with X ≈ K_W⁻¹ known that is a system of k: (BᵀXB) μ = BᵀX rhs − t,  x = X rhs − XB μ. The
column of a row dropped makes its multiplier zero and takes up whatever its equation says.

By hand, the point nearest (3, ½) under z₁ ≤ 1 and z₂ ≤ 1, from W = {1}, the row of z₂: there
z = (3, 1) and λ₁ = ½ − 1 = −½ is of the wrong sign while z₁ > 1. So row 1 goes and row 0 comes,

    X  1  0  0     B  1  0    at W: x = (3, 1, −½),  Bᵀx − t = (3 − 1, −½)
       0  0  1        0  0    BᵀXB = [1 0; 0 −1],    μ = (2, ½)
       0  1 −1        0  1    x − XB μ = (3, 1, −½) − 2·(1, 0, 0) − ½·(0, 1, −1) = (1, ½, 0)

and at that set z = (1, ½), λ₀ = μ₀ = 3 − 1 = 2, and nothing changes any more.

>>> C, L, U = np.eye(2), np.full(2, -np.inf), np.ones(2)
>>> problem = JointQP(np.eye(2), np.array([-3.0, -0.5]), C, L, U)
>>> near = KKTSystem(problem.P, C, np.array([0, 1], dtype=np.int8))
>>> guess_active_set_from_last_step(problem, Geometry(C), near).tolist()
[1, 0]
>>> x, mu = np.array([3.0, 1.0, -0.5]), np.zeros(2)
>>> place, signs, both = np.array([-1, 2]), np.array([1, 0]), np.array([0, 1])
>>> moved = _update_solution_to_active_set.py_func(C, L, U, near.X_T, place, signs, both, x, mu)
>>> moved, x.tolist(), mu.tolist()
(True, [1.0, 0.5, 0.0], [2.0, 0.5])
"""

# Compiled by numba, which infers the types.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from collections.abc import Iterator
from importlib import import_module

import numpy as np

from dpbench.arrays import Vector
from dpbench.qp.dual_active_set import Ending, find_active_set
from dpbench.qp.referee.kernels import add_matrix_vector_product, cached_njit, inlined_njit
from dpbench.qp.referee.kkt import Geometry, KKTSystem
from dpbench.qp.referee.optimum import JointQP, Signs

# Most exchanges, and rows other than those of W: a library finds distant sets sooner.
STEPS, MOST = 8, 12
FREE = 1e30  # Stands for an infinite limit in DAQP, which documents this value
_EQUALITY = 5  # DAQP's mark of a row that is always active
_INFEASIBLE = -1  # DAQP's exit flag for an empty feasible set


def guess_active_set_from_last_step(
    problem: JointQP, geometry: Geometry, system: KKTSystem
) -> Signs | None:
    """Guess the active set by iterating from that of the last step; None if that does not end."""
    signs: Signs = np.zeros(len(problem.L), dtype=np.int8)
    signs[system.rows] = system.signs
    posed = problem.q, problem.L, problem.U, problem.C
    return (
        signs
        if _iterate_active_set_in_place(*posed, geometry.C_T, system.X_T, system.rows, signs)
        else None
    )


@inlined_njit
def _get_active_limit_value(L, U, signs, i):
    """Return the limit at which row i is active; 0 where it is not active."""
    return U[i] if signs[i] > 0 else L[i] if signs[i] < 0 else 0.0


@inlined_njit
def _solve_linear_system_in_place(S, b):
    """Solve S x = b in place by Gauss-Jordan elimination; return False where S is singular."""
    for k in range(len(b)):
        best = k
        for i in range(k + 1, len(b)):
            if abs(S[i, k]) > abs(S[best, k]):
                best = i
        if S[best, k] == 0.0:
            return False
        for j in range(k, len(b)):
            S[k, j], S[best, j] = S[best, j], S[k, j]
        b[k], b[best] = b[best], b[k]
        for i in range(len(b)):
            share = S[i, k] / S[k, k] if i != k else 0.0
            b[i] -= share * b[k]
            for j in range(k, len(b)):
                S[i, j] -= share * S[k, j]
    for k in range(len(b)):
        b[k] /= S[k, k]
    return True


@inlined_njit
def _update_solution_to_active_set(C, L, U, X_T, place, signs, changed, x, mu):
    """Update the KKT solution x (n + w,) to the active set `signs`; False where that is singular.

    place (N,) : position of the row's equation in K_W, −1 for a row that is not in W.
    changed (k,) : the rows that are in W or in the set, but not in both.
    """
    B_T = np.zeros((len(mu), len(x)))
    X_B, S = np.zeros_like(B_T), np.zeros((len(mu), len(mu)))
    for k in range(len(mu)):
        i = changed[k]
        mu[k] = -_get_active_limit_value(L, U, signs, i)
        if place[i] >= 0:
            B_T[k, place[i]] = 1.0
        else:
            for j in range(C.shape[1]):
                B_T[k, j] = C[i, j]
        add_matrix_vector_product(X_T, B_T[k], X_B[k])
        for j in range(len(x)):
            mu[k] += B_T[k, j] * x[j]
            for other in range(k + 1):
                S[k, other] += B_T[k, j] * X_B[other, j]
        for other in range(k):
            S[other, k] = S[k, other]
    if not _solve_linear_system_in_place(S, mu):
        return False
    for k in range(len(mu)):
        for j in range(len(x)):
            x[j] -= mu[k] * X_B[k, j]
    return True


@inlined_njit
def _exchange_wrong_and_violated_rows(L, U, signs, place, changed, value, x, mu):
    """Add violated rows and drop those with wrong multipliers; return whether any changed."""
    multipliers = np.zeros(len(signs))
    for i in range(len(signs)):
        if place[i] >= 0:
            multipliers[i] = x[place[i]]
    for k in range(len(mu)):
        if place[changed[k]] < 0:
            multipliers[changed[k]] = mu[k]
    moved = False
    for i in range(len(signs)):
        sign = signs[i]
        if sign == 0:
            sign = 1 if value[i] > U[i] else -1 if value[i] < L[i] else 0
        elif L[i] != U[i] and not sign * multipliers[i] > 0.0:
            sign = 0
        moved |= sign != signs[i]
        signs[i] = sign
    return moved


@cached_njit
def _iterate_active_set_in_place(q, L, U, C, C_T, X_T, rows, signs):
    """Update the active set `signs` (N,) in place; return whether it converged within `STEPS`."""
    n, N = len(q), len(L)
    place, changed = np.full(N, -1), np.zeros(N, dtype=np.int64)
    for k in range(len(rows)):
        place[rows[k]] = n + k
    for _ in range(STEPS):
        x, rhs, value, count = np.zeros(len(X_T)), np.zeros(len(X_T)), np.zeros(N), 0
        for j in range(n):
            rhs[j] = -q[j]
        for i in range(N):
            if place[i] >= 0:
                rhs[place[i]] = _get_active_limit_value(L, U, signs, i)
            if (place[i] >= 0) != (signs[i] != 0):
                changed[count] = i
                count += 1
        add_matrix_vector_product(X_T, rhs, x)
        mu = np.zeros(count)
        if count > MOST or not _update_solution_to_active_set(
            C, L, U, X_T, place, signs, changed, x, mu
        ):
            return False
        add_matrix_vector_product(C_T, x[:n], value)
        if not _exchange_wrong_and_violated_rows(L, U, signs, place, changed, value, x, mu):
            return True
    return False


def yield_active_set_guesses(problem: JointQP) -> Iterator[Signs | None]:
    """Yield guesses of a QP's active set, best first; None where a solver finds it infeasible."""
    for guess in GUESSERS:
        try:
            yield guess(problem)
        except (ArithmeticError, ImportError, ValueError, TypeError, RuntimeError):
            continue


def _guess_active_set_by_daqp(problem: JointQP) -> Signs | None:
    """Return the active set that the solver DAQP finds; None where it claims infeasibility."""
    daqp = import_module("daqp")
    n = len(problem.q)
    m = len(problem.L) - n
    # Bounds come first in DAQP, and it may write to what it is given: own copies of all.
    upper = np.clip(np.roll(problem.U, n), -FREE, FREE)
    lower = np.clip(np.roll(problem.L, n), -FREE, FREE)
    sense = np.where(upper == lower, _EQUALITY, 0).astype(np.int32)
    A = problem.C[:m].copy()
    _, _, flag, info = daqp.solve(problem.P.copy(), problem.q.copy(), A, upper, lower, sense)
    if flag == _INFEASIBLE:
        return None
    if flag <= 0:
        raise RuntimeError("no answer")
    return _active_set_from_multiplier_signs(
        problem, np.roll(np.asarray(info["lam"], dtype=np.float64), -n)
    )


def _guess_active_set_by_dual_method(problem: JointQP) -> Signs | None:
    """Return the active set at which the dual method ends, its iterations limited."""
    outcome = find_active_set(problem.P, problem.C, problem.q, problem.L, problem.U)
    if outcome.ending is Ending.INFEASIBLE:
        return None
    signs = np.zeros(len(problem.L))
    signs[outcome.active] = outcome.side[outcome.active]
    return _active_set_from_multiplier_signs(problem, signs)


def _active_set_from_multiplier_signs(problem: JointQP, y: Vector) -> Signs:
    """Return the active set (N,) that the signs of multipliers y name; equalities are active."""
    signs = np.sign(np.nan_to_num(y))
    signs[(signs == 0.0) & (problem.L == problem.U)] = 1.0
    limit = np.where(signs > 0, problem.U, problem.L)
    return np.where(np.isfinite(limit), signs, 0).astype(np.int8)


GUESSERS = (_guess_active_set_by_daqp, _guess_active_set_by_dual_method)  # in this order
