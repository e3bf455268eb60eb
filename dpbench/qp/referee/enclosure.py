"""The gap certificate under equality rows: the bound of a feasible point that is known to exist.

No z in float64, nor any finite one in binary, need satisfy an equality row exactly. But with z~ a
refined point, C_E the equality rows, r their exact residual at z~ and B any approximate right
inverse of C_E with ‖C_E B − I‖ ≤ α < 1, the point

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

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.qp.referee.dyadic import Dyadic
from dpbench.qp.referee.gap import TAU_EXPONENT, refine
from dpbench.qp.referee.joint import ExactMatrices, JointQP
from dpbench.qp.referee.kkt import OUTWARD, UNIT, KKTSystem, gamma, positive_definite

NO_MULTIPLIER = 1e-12
"""A multiplier of less than this share of the largest one is no support for M."""
LEAST_MULTIPLIER = 2.0 ** (TAU_EXPONENT // 2)
"""Nor is one that moving limits by τ may have made: it is of the size of √τ at most."""
WEIGHT = 4.0
"""w of every row, of the largest diagonal entry of P."""
AMOUNT_BITS = 20
"""Inward amounts are multiples of 2^−AMOUNT_BITS·τ."""


Among = NDArray[np.bool_]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Enclosed:
    """A point z (n,) with a rigorous bound of |z_j − z*_j| (n,) and multipliers y (N,)."""

    z: Vector
    y: Vector
    bound: Vector


@dataclass(frozen=True, slots=True, eq=False)
class _Feasible:
    """z~, λ of the rows of the system, and e (n,): a feasible ẑ exists within z~ ± e."""

    z: Dyadic
    lam: Dyadic
    slack: Dyadic
    e: Vector


def enclosure_certificate(
    problem: JointQP, exact: ExactMatrices, system: KKTSystem, inward: Vector, *, convex: bool
) -> Enclosed | None:
    """The minimisers of `problem` to within a bound, from the rows of `system`.

    Parameters
    ----------
    system : a `proven` system of independent rows, all equality-like rows among them.
    inward : (w,) how far its rows are held inside their limits, in units of 2^TAU_EXPONENT; 0 for
        equality-like rows.
    convex : whether P is proven positive semidefinite.
    """
    near = _feasible(problem, exact, system, inward)
    if near is None:
        return None
    rows = system.rows
    equal = problem.L[rows] == problem.U[rows]
    # A multiplier of the wrong sign is zero here and its row becomes part of r.
    keep = equal | (near.lam.signs() == system.signs)
    lam = Dyadic(np.where(keep, near.lam.whole, 0), near.lam.exponent)
    size = np.abs(lam.floats())
    support = equal | (size > max(NO_MULTIPLIER * size.max(initial=0.0), LEAST_MULTIPLIER))
    inverse = _inverse(problem, rows[support], rows[equal], convex=convex)
    if inverse is None:
        return None
    weight = _weight(problem.P)
    omega = float((weight / size[support & ~equal] ** 2).sum()) * OUTWARD
    slack = np.abs(near.slack.floats()) + np.abs(problem.C[rows]) @ near.e
    gap = float((size * slack)[~equal].sum()) * OUTWARD
    r = exact.P @ near.z + Dyadic.of(problem.q) + exact.C[rows].T @ lam
    r_abs = (np.abs(r.floats()) + np.abs(problem.P) @ near.e) * OUTWARD
    x = _radius(float(np.sqrt(r_abs @ inverse @ r_abs)) * OUTWARD, gap, omega)
    if x is None:
        return None
    z = near.z.floats()
    # z.floats() is off by half a unit in the last place at most.
    bound = x * np.sqrt(np.diagonal(inverse)) + near.e + np.spacing(np.abs(z))
    y = np.zeros(len(problem.L))
    y[rows] = lam.floats()
    return Enclosed(z, y, np.asarray(bound * OUTWARD, dtype=np.float64))


def _feasible(
    problem: JointQP, exact: ExactMatrices, system: KKTSystem, inward: Vector
) -> _Feasible | None:
    """A refined point with a proof that a feasible one is near, or None."""
    rows, n = system.rows, system.n
    limits = Dyadic.of(np.concatenate((problem.U, problem.L))[system.limits])
    amounts = np.round(inward * 2.0**AMOUNT_BITS) * -system.signs
    shift = Dyadic.of(amounts)
    target = limits + Dyadic(shift.whole, shift.exponent + TAU_EXPONENT - AMOUNT_BITS)
    refined = refine(problem, exact, system, target)
    if refined is None:
        return None
    z, lam = refined
    equal = problem.L[rows] == problem.U[rows]
    value = exact.C @ z
    slack = limits - value[rows]
    e = _distance(problem.C[rows[equal]], system.X[:n, n:][:, equal], slack[equal].floats())
    others = problem.L != problem.U
    if e is None or not _inside(problem, value, np.abs(problem.C) @ e * OUTWARD, others):
        return None
    # Every equality-like row must be among those that ẑ satisfies.
    if others.sum() + equal.sum() != len(problem.L):
        return None
    return _Feasible(z, lam, slack, e)


def _distance(C: Matrix, B: Matrix, residual: Vector) -> Vector | None:
    """e (n,), or None where C B is not proven to be near the identity."""
    if not len(C):
        return np.zeros(C.shape[1])
    identity = np.eye(len(C))
    defect = np.abs(C @ B - identity) + gamma(C.shape[1] + 2) * (np.abs(C) @ np.abs(B) + identity)
    alpha = float(defect.sum(axis=1).max()) * OUTWARD
    if not alpha < 0.5:
        return None
    size = np.abs(residual) * OUTWARD
    e: Vector = np.abs(B) @ (size + alpha / (1.0 - alpha) * size.max()) * OUTWARD
    return e


def _inside(problem: JointQP, value: Dyadic, doubt: Vector, rows: Among) -> bool:
    """Whether the values of these rows of C satisfy their limits with slacks of at least doubt."""
    for limit, sign in ((problem.U, 1), (problem.L, -1)):
        there = np.flatnonzero(rows & np.isfinite(limit))
        slack = Dyadic.of(limit[there]) - value[there]
        least = sign * (slack - Dyadic.of(sign * doubt[there])).signs()
        if (least < 0).any():
            return False
    return True


def _weight(P: Matrix) -> float:
    """What a row of size 1 counts in M."""
    return WEIGHT * (float(np.abs(np.diagonal(P)).max(initial=0.0)) or 1.0)


def _raised(P: Matrix, C: Matrix) -> Matrix:
    """A matrix that is at most P + w CᵀC in the order of symmetric matrices, rounding included."""
    w = _weight(P)
    M = P + w * (C.T @ C)
    size = np.abs(P) + w * (np.abs(C).T @ np.abs(C))
    lost = gamma(len(C) + 4) * float(size.sum(axis=1).max())
    M = 0.5 * (M + M.T)
    return np.asarray(M - (2.0 * lost + UNIT * np.abs(M).max()) * np.eye(len(P)), dtype=np.float64)


def _inverse(problem: JointQP, support: Rows, equal: Rows, *, convex: bool) -> Matrix | None:
    """Entrywise upper bounds of |M⁻¹| with the rows `support` in M, if all is proven of it."""
    P, C = problem.P, problem.C
    if not convex and not positive_definite(_raised(P, C[equal])):
        return None
    M = _raised(P, C[support])
    if not positive_definite(M):
        return None
    n = len(P)
    system = KKTSystem(M, np.zeros((0, n)), np.zeros(0, dtype=np.int8))
    return system.inverse_bounds() if system.proven else None


def _radius(rho: float, gap: float, omega: float) -> float | None:
    """x, where ωρ² ≤ ¼."""
    if not omega * rho**2 * OUTWARD <= 0.25:
        return None
    return (2.0 * rho + math.sqrt(4.0 * (rho**2 + gap + omega * gap**2))) * OUTWARD
