"""Hildreth's method against its textbook form, and the baseline law."""

from functools import partial

import numpy as np
import pytest

from dpbench.errors import SettingsError
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.farkas import is_farkas_vector_proof
from dpbench.qp.residuals import residuals
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from tests.solvers.conftest import solve_next, solve_qp
from tests.solvers.own.random_costs import INF, solve, unlimited

hildreth = partial(solve, solver="hildreth")


def textbook(P, q, A, u, sweeps):
    """Wang (2009), tutorial 2.1, in its own one-sided form: z after at most so many sweeps."""
    H = A @ np.linalg.solve(P, A.T)
    K = u + A @ np.linalg.solve(P, q)
    lam = np.zeros(len(u))
    for _ in range(sweeps):
        before = lam.copy()
        for i in range(len(u)):
            w = H[i] @ lam - H[i, i] * lam[i] + K[i]
            lam[i] = max(0.0, -w / H[i, i])
        if (lam - before) @ (lam - before) < 10e-8:
            break
    return -np.linalg.solve(P, q + A.T @ lam)


def one_sided(seed):
    rng = np.random.default_rng(seed)
    n, m = 6, 9
    B = rng.normal(size=(n, n))
    P, A = B @ B.T + np.eye(n), rng.normal(size=(m, n))
    q, u = 10 * rng.normal(size=n), rng.uniform(0.1, 1, m)
    return unlimited(P, q, A, np.full(m, -INF), u)


@pytest.mark.parametrize("sweeps", [1, 2, 7, 38])
def test_its_iterates_are_those_of_the_textbook(sweeps):
    for seed in range(10):
        qp = one_sided(seed)
        expected = textbook(qp.P, qp.q, qp.A, qp.u, sweeps)
        answer = hildreth(qp, {"max_iter": sweeps})
        # Rounding of up to 38 sweeps.
        np.testing.assert_allclose(answer.z, expected, rtol=0, atol=1e-11)


def test_by_default_it_stops_where_the_textbook_does():
    """At most 38 sweeps, and what has not converged by then is not called solved."""
    endings = {Status.SOLVED: 0, Status.MAX_ITERATIONS: 0}
    for seed in range(20):
        answer = hildreth(one_sided(seed))
        endings[answer.status] += 1
        assert answer.iterations <= 38
        if answer.status is Status.MAX_ITERATIONS:
            assert answer.iterations == 38
            assert np.isfinite(answer.z).all()
    assert all(endings.values())


@pytest.mark.parametrize(("settings", "tolerance"), [("low", 1e-3), ("mid", 1e-6), ("high", 1e-9)])
def test_the_ladder_keeps_what_it_promises(sequence, settings, tolerance):
    """A tolerance level bounds the residuals of P ≥ 1 by its number, give or take ten."""
    answers = sequence.answers(open_workspace("hildreth", policy="reuse", settings=settings))
    for step, answer in zip(sequence.steps, answers, strict=True):
        qp = sequence.base.at(step)
        assert answer.status is Status.SOLVED
        found = residuals(qp, answer)
        assert found.primal <= 10 * tolerance
        # Stationarity holds by construction.
        assert found.dual <= 1e-12


def test_a_start_from_the_previous_multipliers_saves_sweeps():
    qp = one_sided(3)
    sweeps = {}
    for policy in ("reuse", "warm"):
        workspace = open_workspace("hildreth", policy=policy, settings="high")
        workspace.setup(qp)
        workspace.solve()
        sweeps[policy] = 0
        for k in range(10):
            answer = solve_next(workspace, QPStep((1.0 + 1e-6 * k) * qp.q, qp.l, qp.u))
            assert answer.status is Status.SOLVED
            sweeps[policy] += answer.iterations
    assert sweeps["warm"] < 0.8 * sweeps["reuse"]


def test_the_multipliers_move_on_by_one_move():
    q = np.array([0.0, 0.0, -3.0, 0.0])
    qp = QuadraticProgram(np.eye(4), q, np.zeros((0, 4)), [], [], -np.ones(4), np.ones(4), 1)
    workspace = open_workspace("hildreth", policy="warm")
    assert solve_qp(workspace, qp).iterations == 2
    answer = solve_next(workspace, QPStep(np.roll(q, -1), qp.l, qp.u))
    assert answer.iterations == 1
    np.testing.assert_array_equal(answer.z, [0, 1, 0, 0])


def test_multipliers_without_end_are_a_proof():
    qp = QuadraticProgram(
        [[2.0, 0.5], [0.5, 1.0]], [-2, -6], [[1, 1], [1, -1]], [3, -9], [4, 9], [-1, -1], [1, 1]
    )
    answer = hildreth(qp, {"max_iter": 1000})
    assert answer.status is Status.PRIMAL_INFEASIBLE
    assert np.isnan(answer.z).all()
    assert is_farkas_vector_proof(qp, answer.y, answer.y_box)
    # After one sweep nothing is proven, and nothing is claimed.
    assert hildreth(qp, {"max_iter": 1}).status is Status.MAX_ITERATIONS


def test_a_row_of_zeros_that_asks_for_more_is_infeasible():
    qp = QuadraticProgram(np.eye(2), [1, 1], [[0, 0]], [1], [2], [-1, -1], [1, 1])
    answer = hildreth(qp)
    assert answer.status is Status.PRIMAL_INFEASIBLE
    assert is_farkas_vector_proof(qp, answer.y, answer.y_box)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"iterations": 3}, "max_iter"),
        ({"max_iter": 2.5}, "a whole number"),
        ({"eps_row": 0.0}, "above 0"),
        ({"eps_change": "small"}, "a number"),
    ],
)
def test_settings_it_does_not_know_are_refused(settings, words):
    with pytest.raises(SettingsError, match=words):
        open_workspace("hildreth", settings=settings)


@pytest.mark.parametrize("policy", ["fresh", "reuse"])
def test_the_baseline_law_minimises_the_cost_and_claims_nothing(sequence, policy):
    workspace = open_workspace("unconstrained_clipped", policy=policy)
    workspace.setup(sequence.base)
    for step in sequence.steps:
        answer = solve_next(workspace, step)
        # Two triangular solves with a condition number below 100 leave some 1e-14.
        np.testing.assert_allclose(sequence.base.P @ answer.z, -step.q, rtol=0, atol=1e-12)
        assert answer.status is Status.UNKNOWN
        assert not answer.y.any()
        assert not answer.y_box.any()


def test_new_matrices_of_the_baseline_law_are_factorised_again(sequence):
    workspace = open_workspace("unconstrained_clipped", policy="reuse")
    workspace.setup(sequence.base)
    first, second = sequence.steps[:2]
    workspace.update(QPStep(first.q, first.l, first.u, P=4.0 * sequence.base.P))
    z = solve_next(workspace, second).z
    np.testing.assert_allclose(4.0 * sequence.base.P @ z, -second.q, rtol=0, atol=1e-12)


def test_a_cost_without_a_minimum_is_an_error():
    workspace = open_workspace("unconstrained_clipped")
    eye = np.eye(2)
    answer = solve_qp(
        workspace,
        QuadraticProgram(np.diag([1.0, -1.0]), [1, 1], eye, [-1, -1], [1, 1], [-1, -1], [1, 1]),
    )
    assert answer.status is Status.ERROR
    assert np.isnan(answer.z).all()
