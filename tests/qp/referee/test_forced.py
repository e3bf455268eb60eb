"""Rows that force their variables: the feasible set of a dropped amplitude limit."""

from __future__ import annotations

import numpy as np
import pytest

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.feasibility.implied import fix_forced
from dpbench.qp.referee.joint import ExactMatrices, JointQP
from dpbench.qp.referee.rational import rational_certificate
from dpbench.qp.referee.referee import certify
from dpbench.qp.residuals import is_true, residuals
from dpbench.qp.solution import Solution, Status


def _dropped(blocks: int, forced: int, seed: int) -> QuadraticProgram:
    """Summed moves of three axes; the first axis must fall at full rate for `forced` moves."""
    rng = np.random.default_rng(seed)
    n = 3 * blocks
    A = np.kron(np.tril(np.ones((blocks, blocks))), np.eye(3))
    B = rng.normal(size=(n, n))
    # Limits drawn at random are no sums of moves at full rate: all but the forced part is regular.
    u = rng.uniform(4.1, 4.9, n)
    for i in range(blocks):
        u[3 * i] = -(i + 1.0) if i < forced else rng.uniform(0.1, 0.9) - forced
    ones = np.ones(n)
    P = B.T @ B / n + np.eye(n)
    q = 5.0 * rng.normal(size=n)
    return QuadraticProgram(0.5 * (P + P.T), q, A, np.full(n, -9.0), u, -ones, ones, block=3)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("blocks", "forced"), [(5, 1), (5, 3), (5, 5), (10, 6)])
def test_dropped_limit_has_a_cheap_certificate(blocks: int, forced: int, seed: int) -> None:
    """A limit that drops for several moves is certified linearly, with multipliers that explain."""
    qp = _dropped(blocks, forced, seed)
    optimum = certify(qp)
    assert optimum.kind == "linear"
    assert optimum.bound <= 1e-12
    answer = Solution(Status.UNKNOWN, optimum.z, optimum.y, optimum.y_box)
    assert is_true(qp, residuals(qp, answer), 0.0, 1e-6)
    assert residuals(qp, answer).complementarity <= 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_fixing_keeps_the_optimum(seed: int) -> None:
    """The certificate with fixed variables encloses the optimum of the problem as posed."""
    qp = _dropped(3, 2, seed)
    joint = JointQP.of(qp)
    assert fix_forced(joint) is not None
    guess = np.zeros(qp.n + qp.m, dtype=np.int8)
    exact = rational_certificate(joint, ExactMatrices.of(joint.P, joint.C), guess)
    optimum = certify(qp)
    assert exact is not None
    assert np.abs(exact.z - optimum.z).max() <= exact.bound + optimum.bound


def test_one_bit_of_freedom_is_not_forcing() -> None:
    """A row that leaves one unit in the last place of freedom fixes nothing."""
    one, ten = np.ones(1), np.full(1, 10.0)
    for limit, forcing in ((-10.0, True), (np.nextafter(-10.0, 0.0), False)):
        qp = QuadraticProgram(np.eye(1), one, np.eye(1), [-np.inf], [limit], -ten, ten)
        assert (fix_forced(JointQP.of(qp)) is not None) is forcing
        optimum = certify(qp)
        assert abs(optimum.z[0] + 10.0) <= optimum.bound + 2e-15
        assert optimum.bound <= 1e-12


def test_contradicting_rows_are_infeasible() -> None:
    """Two rows that force one variable to different bounds leave no feasible point."""
    A = np.array([[1.0, 1.0], [1.0, -1.0]])
    ones = np.ones(2)
    qp = QuadraticProgram(np.eye(2), ones, A, [-np.inf, 2.0], [-2.0, np.inf], -ones, ones)
    assert certify(qp).kind == "infeasible"
