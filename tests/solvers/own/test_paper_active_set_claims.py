"""What the paper's method claims on random problems is true: solved and infeasible alike."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.feasibility.farkas import farkas_valid
from dpbench.qp.referee.referee import Referee
from dpbench.qp.residuals import is_true, residuals
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own.proof import contradicts
from tests.solvers.conftest import solve_next, solve_qp

INF = np.inf
RULES = {"deadline": None, "derandomize": True, "database": None}


def workspace(policy="warm"):
    return open_workspace("paper_active_set", policy=policy)


def matrices(rng, n, m):
    """P with a condition up to 1e8, and rows of unit norm, some of them zero or written twice."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P = (Q * np.geomspace(1.0, 10.0 ** rng.uniform(0, 8), n)) @ Q.T
    A = rng.normal(size=(m, n)) if rng.random() < 0.5 else rng.integers(-1, 2, (m, n)) * 1.0
    A = A * (rng.random((m, n)) < rng.uniform(0.1, 1))
    length = np.linalg.norm(A, axis=1)
    A /= np.where(length > 0.0, length, 1.0)[:, None]
    if m > 6 and rng.random() < 0.7:
        twice = int(rng.integers(1, m // 2))
        A[rng.integers(0, m, twice)] = A[rng.integers(0, m, twice)]
    return 0.5 * (P + P.T), A


def parametric(rng, n, m):
    """A QP and five steps: equal, infinite and touching limits, costs far beyond them."""
    P, A = matrices(rng, n, m)
    z = rng.normal(size=n) * 10.0 ** rng.uniform(-1, 1)
    w = A @ z
    low, high = (w + side * rng.uniform(0, 1, m) * (rng.random(m) < 0.7) for side in (-1, 1))
    kind = rng.random(m)
    low = np.where(kind < 0.2, -INF, low)
    high = np.where((kind > 0.1) & (kind < 0.35), INF, high)
    lb, ub = (z + side * rng.uniform(0, 1, n) * (rng.random(n) < 0.8) for side in (-1, 1))
    lb, ub = np.where(rng.random(n) < 0.3, -INF, lb), np.where(rng.random(n) < 0.3, INF, ub)
    q = rng.normal(size=n) * 10.0 ** rng.uniform(-1, 3)
    base = QuadraticProgram(P, q, A, low, high, lb, ub)
    steps = []
    for _ in range(5):
        q = q + 0.1 * np.abs(q).max() * rng.normal(size=n)
        steps.append(QPStep(q, low - 0.05 * rng.random(m), high + 0.05 * rng.random(m)))
    return base, [QPStep(base.q, low, high), *steps]


@pytest.mark.slow
@settings(max_examples=120, **RULES)
@given(st.integers(0, 2**32 - 1))
def test_what_it_calls_solved_the_referee_finds_true(seed):
    """On random sequences every claim holds against the certified optimum, or is not made."""
    rng = np.random.default_rng(seed)
    base, steps = parametric(rng, int(rng.integers(2, 13)), int(rng.integers(0, 20)))
    referee = Referee(base.P, base.A, base.lb, base.ub)
    solver = workspace()
    solver.setup(base)
    for step in steps:
        answer, qp = solve_next(solver, step), base.at(step)
        optimum = referee.certify(qp.q, qp.l, qp.u)
        if not answer.claimed:
            # Limits through one point that rounding has moved apart: infeasible.
            assert optimum.kind != "linear"
            solver.reset()
            continue
        found, size = residuals(qp, answer), 1.0 + np.abs(answer.z).max()
        # A thousand times rounding: limits and rows are of the size of z.
        assert found.primal <= 1e-12 * size
        if np.isfinite(optimum.bound):
            error = np.abs(answer.z - optimum.z).max()
            # Rounding is 1e-16, times a condition of 1e8, of what may be 1e5 times a plan in size.
            assert is_true(qp, found, error / size, 1e-6)


@settings(max_examples=15, **RULES)
@given(st.integers(0, 2**32 - 1))
def test_larger_sequences_satisfy_the_optimality_conditions(seed):
    """Up to 120 variables and 300 rows every answer satisfies the KKT conditions."""
    rng = np.random.default_rng(seed)
    base, steps = parametric(rng, int(rng.integers(20, 121)), int(rng.integers(0, 301)))
    solver = workspace()
    solver.setup(base)
    for k, step in enumerate(steps):
        answer, qp = solve_next(solver, step), base.at(step)
        assert answer.claimed or (k == 0 and answer.status is Status.INACCURATE)
        found = residuals(qp, answer)
        size = 1.0 + np.abs(answer.z).max()
        # A thousand times rounding of the terms each residual is a sum of.
        assert found.primal <= 1e-12 * size
        terms = np.abs(qp.q).max() + np.abs(qp.P).max() * size + np.abs(answer.y).max(initial=0.0)
        assert found.dual <= 1e-12 * terms
        assert found.complementarity <= 1e-12 * terms * size


@settings(max_examples=60, **RULES)
@given(st.integers(0, 2**32 - 1))
def test_between_finite_limits_the_proof_of_infeasibility_is_exact(seed):
    """Within a finite box y alone proves the contradiction, and the referee decides it exactly."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 30)), int(rng.integers(2, 40))
    P, A = matrices(rng, n, m)
    j = int(rng.integers(0, m))
    A[j] = rng.normal(size=n)
    low, high = -rng.uniform(0, 1, m), rng.uniform(0, 1, m)
    # No z within ±1 has a row value beyond the sum of the row's entries.
    low[j] = np.abs(A[j]).sum() * (1.0 + 10.0 ** rng.uniform(-6, 0))
    high[j] = low[j] + 1.0
    qp = QuadraticProgram(P, 100 * rng.normal(size=n), A, low, high, -np.ones(n), np.ones(n))
    solver = workspace()
    answer = solve_qp(solver, qp)
    assert answer.status is Status.PRIMAL_INFEASIBLE
    assert farkas_valid(qp, answer.y, answer.y_box)
    assert contradicts(qp, answer.y, answer.y_box)


def test_a_ray_that_proves_nothing_is_no_proof():
    """A vector that does not cancel, or whose limits leave room, proves nothing."""
    one = np.ones(1)
    qp = QuadraticProgram(np.eye(1), one, [[1.0]], [2.0], [3.0], [-1.0], [1.0])
    assert contradicts(qp, -one, one)
    assert not contradicts(qp, -one, 0.5 * one)
    assert not contradicts(qp, one, -one)
