"""Whether rounding decides where the compiled method's answer lies.

Where limits meet at an angle that is next to nothing, the optimality conditions hold to the last
digit at points far from the optimum; so they do where the cost hardly curves. Limits and cost are
therefore moved, by `MOVED` times what rounding leaves in a row and in the gradient, and the problem
is solved again: an answer that follows by more than `MOVED` times what an answer may be wrong is
none. The cost is moved where it matters most, both ways. All limits are tightened, all are widened,
and then one half against the other, so that of every two rows either is moved in while the other is
moved out.
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.joint import JointQP
from dpbench.solvers.own.active_set import layout as layout
from dpbench.solvers.own.active_set.check import EPSILON, WRONG
from dpbench.solvers.own.active_set.kernel import solve_step
from dpbench.solvers.own.active_set.pricing import VIOLATED
from dpbench.solvers.own.safeguards.careful import solve_carefully
from dpbench.solvers.own.safeguards.pinned import INDEPENDENT, apart

MOVED = 2e4
"""Enough for a dependent row that is violated by as much to be seen as a contradiction."""
OFF = 10.0
"""Roundings by which a row may be missed that has no room to be moved as far."""
HALVES = 6
"""Ways of halving the rows: any two of the 64 nearest their limits are apart in one of them."""


def is_sensitive(S: Matrix, qp: QuadraticProgram) -> bool:
    """Whether the answer in S follows limits that are moved by little; S is left as it was.

    Parameters
    ----------
    S : of `active_set.layout`, with an answer to `qp`.
    """
    n_pad = int(S[layout.HEAD, layout.N_PAD])
    vectors, factor = S[: layout.VECTORS], S[-n_pad:]
    before = vectors.copy(), factor.copy()
    z = S[layout.Z, : qp.n].copy()
    posed = JointQP.of(qp)
    columns = np.concatenate([n_pad + np.arange(qp.m), np.arange(qp.n)])
    far = _reach(posed, z, S[layout.UNIT, columns])
    if far is None:
        return True
    inverse = S[layout.VECTORS : layout.VECTORS + qp.n, : qp.n]
    allowed = MOVED * WRONG * unit_of(qp)
    lam = S[layout.LAM, columns]
    along, start = _push(posed, z, lam, inverse), np.sign(lam)
    try:
        for k, sides in enumerate(_sides(posed, z)):
            S[layout.Q, : qp.n] = qp.q + (along if k % 2 else -along)
            S[layout.LOW, columns] = posed.L - sides * far
            S[layout.HIGH, columns] = posed.U + sides * far
            ending = solve_step(S)
            # The careful method takes a second at n = 200: it is asked where all limits move.
            if ending != layout.UNDECIDED or k < 2:
                followed = _answer(S, qp, columns, ending, start)
                if not (np.abs(followed - z) <= allowed).all():
                    return True
            vectors[:], factor[:] = before
        return False
    finally:
        vectors[:], factor[:] = before


def unit_of(qp: QuadraticProgram) -> Vector:
    """Return the unit of each variable's error (n,): half of what its bounds leave it.

    In scaled units that is 1, a rate-limit step. Where there is no bound, or less room, it is 1.
    """
    half = 0.5 * (qp.ub - qp.lb)
    return np.where(np.isfinite(half), np.maximum(half, 1.0), 1.0)


def _answer(
    S: Matrix, qp: QuadraticProgram, columns: Indices, ending: int, start: Vector
) -> Vector:
    """Read the answer to the problem in S, on which `solve_step` ended so.

    NaN where there is none.
    """
    if ending >= 0 or ending == layout.DOUBTFUL:
        return S[layout.Z, : qp.n]
    if ending == layout.UNDECIDED:
        low, high = S[layout.LOW, columns], S[layout.HIGH, columns]
        l, lb = low[: qp.m], low[qp.m :]  # noqa: E741 - l ≤ Az ≤ u, the name of the field
        u, ub = high[: qp.m], high[qp.m :]
        moved = QuadraticProgram(qp.P, S[layout.Q, : qp.n].copy(), qp.A, l, u, lb, ub)
        return solve_carefully(moved, start=start).z
    return np.full(qp.n, np.nan)


def _reach(posed: JointQP, z: Vector, unit: Vector) -> Vector | None:
    """Return how far each row's limits are moved.

    None if those that cannot be moved as far are in doubt: violated, or dependent on one another.

    A row does not cross itself; one with equal limits stays, as `pinned.py` decides whether such
    rows depend on one another.
    """
    value = posed.C @ z
    rounding = VIOLATED * (np.abs(value) + np.linalg.norm(value * unit) / unit)
    violation = np.maximum(value - posed.U, posed.L - value)
    far, room = MOVED * np.maximum(rounding, violation), 0.25 * (posed.U - posed.L)
    # A row of zeros is no row.
    far[~posed.C.any(axis=1)] = 0.0
    narrow = room < far
    if (violation > OFF * rounding)[narrow].any():
        return None
    if (room[narrow] > 0.0).any() and not apart(posed.C[narrow], INDEPENDENT):
        return None
    return np.minimum(far, room)


def _push(posed: JointQP, z: Vector, lam: Vector, inverse: Matrix) -> Vector:
    """How far the cost is moved, with the signs by which the free optimum would follow most."""
    terms = np.abs(posed.q) + np.abs(posed.P) @ np.abs(z) + np.abs(lam) @ np.abs(posed.C)
    r = posed.q + posed.P @ z + lam @ posed.C
    size = MOVED * np.maximum(EPSILON * terms, np.abs(r))
    most = int(np.argmax(np.abs(inverse) @ size))
    return np.asarray(np.sign(inverse[most]) * size)


def _sides(posed: JointQP, z: Vector) -> list[Vector]:
    """−1 for a row that is tightened, +1 for one that is widened: all, and half against half."""
    value = posed.C @ z
    nearest = np.argsort(np.minimum(posed.U - value, value - posed.L), kind="stable")
    place = np.empty_like(nearest)
    place[nearest] = np.arange(len(nearest))
    one = np.ones(len(value))
    ways = [one, *(np.where(place >> bit & 1, one, -one) for bit in range(HALVES))]
    return [side for way in ways for side in (-way, way)]
