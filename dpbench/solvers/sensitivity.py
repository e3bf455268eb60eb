"""Whether rounding decides where the compiled method's answer lies.

Where limits meet at an angle that is next to nothing, the optimality conditions hold to the last
digit at points far from the optimum; so they do where the cost hardly curves. Limits and cost are
therefore moved, by `MOVED` times what rounding may leave in a row and in the gradient, and the
problem is solved again: an answer that follows by more than `MOVED` times what an answer may be
wrong is none. All limits are tightened, all are widened, and some are moved at random, so that each
may become the one that counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dpbench.qp.joint import JointQP
from dpbench.qp.program import Matrix, QuadraticProgram, Vector
from dpbench.solvers import active_set_layout as layout
from dpbench.solvers.active_set_check import EPSILON
from dpbench.solvers.active_set_factor import VIOLATED
from dpbench.solvers.active_set_kernel import solve_step
from dpbench.solvers.careful_active_set import solve_carefully

MOVED = 2e4
"""Enough for a dependent row that is violated by as much to be seen as a contradiction."""
WRONG = 5e-7
"""Half of the tightest tolerance that answers are held to."""
RANDOM = 4
"""Trials with random signs."""


def is_sensitive(S: Matrix, qp: QuadraticProgram) -> bool:
    """Whether the answer in S follows limits that are moved by little; S is left as it was.

    Parameters
    ----------
    S : of `active_set_constants`, with an answer to `qp`.
    """
    n_pad = int(S[layout.HEAD, layout.N_PAD])
    vectors, factor = S[: layout.VECTORS], S[-n_pad:]
    before = vectors.copy(), factor.copy()
    z = S[layout.Z, : qp.n].copy()
    posed = JointQP.of(qp)
    columns = np.concatenate([n_pad + np.arange(qp.m), np.arange(qp.n)])
    far = _reach(posed, z, S[layout.UNIT, columns])
    push = MOVED * EPSILON * _terms(posed, z, S[layout.LAM, columns])
    try:
        for along, signs in zip(_signs(qp.n), _signs(len(far)), strict=True):
            S[layout.Q, : qp.n] = qp.q + along * push
            S[layout.LOW, columns] = posed.L - signs * far
            S[layout.HIGH, columns] = posed.U + signs * far
            if not np.abs(_answer(S, qp, columns) - z).max() <= MOVED * WRONG:
                return True
        return False
    finally:
        vectors[:], factor[:] = before


def _answer(S: Matrix, qp: QuadraticProgram, columns: NDArray[np.intp]) -> Vector:
    """The answer to the problem in S; NaN where there is none."""
    ending = solve_step(S)
    if ending >= 0 or ending == layout.DOUBTFUL:
        return S[layout.Z, : qp.n]
    if ending == layout.UNDECIDED:
        low, high = S[layout.LOW, columns], S[layout.HIGH, columns]
        l, lb = low[: qp.m], low[qp.m :]  # noqa: E741 - see QuadraticProgram.l
        u, ub = high[: qp.m], high[qp.m :]
        moved = QuadraticProgram(qp.P, S[layout.Q, : qp.n].copy(), qp.A, l, u, lb, ub)
        return solve_carefully(moved).z
    return np.full(qp.n, np.nan)


def _reach(posed: JointQP, z: Vector, unit: Vector) -> Vector:
    """How far each row's limits are moved.

    A row does not cross itself; one with equal limits stays, as `pinned.py` decides whether such
    rows depend on one another.
    """
    value = posed.C @ z
    size = np.linalg.norm(value * unit)
    far = MOVED * VIOLATED * (np.abs(value) + size / unit)
    # A row of zeros is no row.
    far[~posed.C.any(axis=1)] = 0.0
    return np.minimum(far, 0.25 * (posed.U - posed.L))


def _terms(posed: JointQP, z: Vector, lam: Vector) -> Vector:
    """The size of the terms that each entry of the gradient is the sum of."""
    size = np.abs(posed.q) + np.abs(posed.P) @ np.abs(z) + np.abs(lam) @ np.abs(posed.C)
    return np.asarray(size)


def _signs(size: int) -> list[Vector]:
    """Which way things are moved: all down, all up, each at random."""
    one = np.ones(size)
    return [-one, one, *np.random.default_rng(0).choice([-1.0, 1.0], (RANDOM, size))]
