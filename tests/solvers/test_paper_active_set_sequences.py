"""The paper's method from step to step: sequences of QPs, starts, odd arrays, size."""

from __future__ import annotations

import numpy as np
import pytest
import quadprog
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench import load_scenario
from dpbench.bench.exact import sequence_of, solve_exactly
from dpbench.qp.certify import Referee
from dpbench.qp.farkas import farkas_valid
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.residuals import is_true, residuals
from dpbench.qp.solution import Status
from dpbench.solvers import active_set_layout, active_set_moves
from dpbench.solvers.open import open_workspace
from dpbench.solvers.proof import contradicts

INF = np.inf
RULES = {"deadline": None, "derandomize": True, "database": None}


def workspace(policy="warm"):
    return open_workspace("paper_active_set", policy=policy)


@pytest.mark.parametrize("name", ["paper", "paper_tight", "calm", "rough"])
def test_every_step_of_a_scenario_is_the_certified_optimum(name):
    """Along the exactly solved loop every answer is the optimum to 1e-9 of a rate-limit step."""
    scenario = load_scenario(name)
    exact = solve_exactly(scenario)
    sequence = sequence_of(scenario, exact)
    iterations = {}
    for policy in ("reuse", "warm"):
        solver = workspace(policy)
        solver.setup(sequence.base)
        iterations[policy] = 0
        for k in range(len(sequence)):
            solver.update(sequence.step(k))
            solver.solve()
            answer = solver.read()
            assert answer.status is Status.SOLVED
            assert np.abs(answer.z - exact.z[k]).max() <= 1e-9
            iterations[policy] += answer.iterations
    # What a start is for: the set changes in few steps, by few rows.
    assert iterations["warm"] <= 0.15 * iterations["reuse"]


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
        solver.update(step)
        solver.solve()
        answer, qp = solver.read(), base.at(step)
        optimum = referee.certify(qp.q, qp.l, qp.u)
        if not answer.claimed:
            # Rows written twice, with equal limits that rounding has moved apart: hopeless.
            assert optimum.kind in ("infeasible", "none")
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
    """Up to 120 variables and 300 rows every claim satisfies the KKT conditions."""
    rng = np.random.default_rng(seed)
    base, steps = parametric(rng, int(rng.integers(20, 121)), int(rng.integers(0, 301)))
    solver = workspace()
    solver.setup(base)
    for step in steps:
        solver.update(step)
        solver.solve()
        answer, qp = solver.read(), base.at(step)
        assert answer.claimed
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
    solver.setup(qp)
    solver.solve()
    answer = solver.read()
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


def chain(block):
    """Six moves of one variable each, of which the third wants beyond its bound."""
    six = np.ones(6)
    q = np.array([0.0, 0.0, -3.0, 0.0, 0.0, 0.0])
    return QuadraticProgram(np.eye(6), q, np.zeros((0, 6)), [], [], -six, six, block)


@pytest.mark.parametrize(("block", "iterations"), [(1, 0), (2, 2), (0, 2)])
def test_the_kept_set_moves_on_by_one_move(block, iterations):
    """A set that came one move nearer needs no change; moved otherwise it costs a drop and an add.

    The next step's second variable is at its bound. Block 0 keeps variable 3, block 2 takes it to
    1: either is dropped, and variable 2 brought in.
    """
    qp = chain(block)
    solver = workspace()
    solver.setup(qp)
    solver.solve()
    assert solver.read().iterations == 1
    solver.update(QPStep(np.roll(qp.q, -1), qp.l, qp.u))
    solver.solve()
    answer = solver.read()
    np.testing.assert_allclose(answer.z, [0, 1, 0, 0, 0, 0], rtol=0, atol=1e-15)
    assert answer.iterations == iterations


def test_the_same_set_costs_no_iteration():
    """A set that is still optimal is kept as it is, whatever the block."""
    qp = chain(1)
    solver = workspace()
    solver.setup(qp)
    solver.solve()
    solver.update(QPStep(1.1 * qp.q, qp.l, qp.u))
    solver.solve()
    assert solver.read().iterations == 0
    solver.reset()
    solver.solve()
    assert solver.read().iterations == 1


@pytest.mark.parametrize("angle", [1e-3, 1e-5, 1e-8])
def test_nearly_parallel_rows_are_told_apart(angle):
    """Two rows at a small angle meet in one point, which is the optimum."""
    A = np.array([[1.0, 0.0], [1.0, angle]])
    # z0 ≤ 1 and z0 + angle·z1 ≤ 1 − angle meet in (1, −1); the cost pulls between the two rows.
    high = np.array([1.0, 1.0 - angle])
    z, y = np.array([1.0, -1.0]), np.array([2.0, 3.0])
    qp = QuadraticProgram(
        np.eye(2), -(z + A.T @ y), A, [-INF, -INF], high, [-INF, -INF], [INF, INF]
    )
    solver = workspace()
    solver.setup(qp)
    solver.solve()
    answer = solver.read()
    assert answer.status is Status.SOLVED
    # The rounding of `high` alone moves the point by 1e-16 over the angle.
    np.testing.assert_allclose(answer.z, z, rtol=0, atol=1e-15 / angle)


def odd(array, kind):
    """The same numbers in another kind of array."""
    if kind == "strided":
        return np.repeat(array, 2)[::2]
    if kind == "read-only":
        array = array.copy()
        array.flags.writeable = False
        return array
    return array.astype(kind)


@pytest.mark.parametrize("kind", ["strided", "read-only", ">f8", "float32"])
def test_other_kinds_of_arrays_are_taken_over_all_the_same(sequence, kind):
    """The compiled copy is for contiguous float64 arrays; others give the same answers."""
    expected, found = workspace(), workspace()
    for solver in (expected, found):
        solver.setup(sequence.base)
    for step in sequence.steps:
        q, low, high = (a.astype(np.float32).astype(float) for a in (step.q, step.l, step.u))
        expected.update(QPStep(q, low, high))
        found.update(QPStep(odd(q, kind), odd(low, kind), odd(high, kind)))
        expected.solve()
        found.solve()
        np.testing.assert_array_equal(found.read().z, expected.read().z)


def test_two_workspaces_do_not_disturb_each_other(sequence):
    """Workspaces that take turns give what each gives alone."""
    alone = workspace()
    alone.setup(sequence.base)
    expected = []
    for step in sequence.steps:
        alone.update(step)
        alone.solve()
        expected.append(alone.read().z)
    forth, back = workspace(), workspace()
    forth.setup(sequence.base)
    back.setup(sequence.base)
    for k, step in enumerate(sequence.steps):
        forth.update(step)
        back.update(sequence.steps[-1 - k])
        forth.solve()
        back.solve()
        np.testing.assert_array_equal(forth.read().z, expected[k])


def test_three_hundred_variables_and_six_hundred_rows():
    """With a box, 600 rows and some 200 of them active it agrees with quadprog."""
    rng = np.random.default_rng(0)
    n, m = 300, 600
    B = rng.normal(size=(n, n))
    P, A = B @ B.T / n + 0.1 * np.eye(n), rng.normal(size=(m, n)) / np.sqrt(n)
    q, two, one = 10 * rng.normal(size=n), 2 * np.ones(m), np.ones(n)
    solver = workspace()
    solver.setup(QuadraticProgram(P, q, A, -two, two, -one, one))
    C = np.vstack([A, -A, np.eye(n), -np.eye(n)]).T
    limit = -np.concatenate([two, two, one, one])
    for _ in range(2):
        solver.solve()
        answer = solver.read()
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(
            answer.z, quadprog.solve_qp(P, -q, C, limit)[0], rtol=0, atol=1e-10
        )
        assert np.count_nonzero(answer.y) + np.count_nonzero(answer.y_box) > 150
        q = q + 0.1 * rng.normal(size=n)
        solver.update(QPStep(q, -two, two))


def test_compiled_code_on_disk_is_not_used_after_a_change(monkeypatch):
    """The mark of the compiled code changes with a constant that some function of it names."""
    before = active_set_layout.stamp()
    assert active_set_layout.stamp() == before
    monkeypatch.setattr(active_set_moves, "CLOSE", 1e-7)
    assert active_set_layout.stamp() != before
