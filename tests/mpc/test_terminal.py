"""The Riccati terminal cost against the linear-quadratic regulator and simulation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.errors import InputError
from dpbench.mpc.condense import ControlProblem, condense_matrices
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.law import gains, unconstrained_plan
from dpbench.mpc.model import StateSpace, augment

VESSELS = ("supply_fs99", "supply_mss", "supply_tmr", "osv", "cybership2")


def regulator(problem: ControlProblem) -> np.ndarray:
    """The LQR gain by dynamic programming backwards until it stands still, in steps of du_max."""
    A, B = problem.model.A, problem.model.B * problem.du_max
    R = problem.R * np.outer(problem.du_max, problem.du_max)
    stage = problem.model.C.T @ problem.Q @ problem.model.C
    S, K = stage, np.zeros((B.shape[1], len(A)))
    for _ in range(20_000):
        before, K = K, np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)
        rest = A - B @ K
        # Joseph's form keeps S symmetric positive semidefinite over thousands of steps.
        S = rest.T @ S @ rest + K.T @ R @ K + stage
        if np.abs(K - before).max() < 1e-14 * np.abs(K).max():
            break
    return K


@pytest.mark.parametrize("N", [1, 2, 12, 30])
@pytest.mark.parametrize("name", VESSELS)
def test_with_a_terminal_cost_the_law_is_the_regulator_at_any_horizon(
    ship: Any, name: str, N: int
) -> None:
    """With N_c = N_p moves the gain of eq. 33 is the LQR gain, whatever the horizon; without the
    terminal cost it is not."""
    problem = replace(ship(name, psi0_rad=0.5, N_p=N, N_c=N), terminal="riccati")
    expected = regulator(problem)
    found = gains(problem).K_mpc / problem.du_max[:, np.newaxis]
    # Each column is a gain per unit of one state; the equation and E are solved to about 1e-10.
    size = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=1e-7)
    law = gains(problem)
    axis = np.abs(law.K_y).max(axis=1, keepdims=True)
    np.testing.assert_allclose(law.K_mpc[:, 6:] / axis, law.K_y / axis, rtol=0, atol=1e-9)
    paper = gains(replace(problem, terminal="none")).K_mpc / problem.du_max[:, np.newaxis]
    assert np.abs(paper - expected).max() > 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize(("N_p", "N_c"), [(30, 5), (60, 10), (7, 7)])
def test_the_terminal_cost_is_what_the_regulator_still_has_to_pay(
    ship: Any, N_p: int, N_c: int
) -> None:
    """½zᵀPz + qᵀz + J0 is the cost of the horizon and of all steps after it under the regulator,
    by stepping the model until nothing is left; held or previewed."""
    problem = replace(ship("supply_fs99", N_p=N_p, N_c=N_c), terminal="riccati")
    rng = np.random.default_rng(4)
    x = np.concatenate([0.02 * rng.normal(size=6), rng.normal(size=3)])
    moves = rng.uniform(-1, 1, (N_c, 3)) * problem.du_max
    held = np.tile([0.4, -0.2, 0.05], (N_p, 1))
    preview = held + 0.05 * np.cumsum(rng.normal(size=(N_p, 3)), axis=0)
    K = regulator(problem) * problem.du_max[:, np.newaxis]
    model = problem.model
    for given, Y_d in ((held[0], held), (preview, preview)):
        J, state = 0.0, x
        for i in range(N_p + 3000):
            y_d = Y_d[min(i, N_p - 1)]
            du = np.zeros(3)
            if i < N_c:
                du = moves[i]
            elif i >= N_p:
                du = -K @ (state - model.C.T @ y_d)
            state = model.A @ state + model.B @ du
            error = y_d - model.C @ state
            J += 0.5 * float(error @ problem.Q @ error + du @ problem.R @ du)
        builder = CondensedQP(problem)
        step = builder.emit(x, given, np.zeros(3))
        cost = builder.problem(step).objective(builder.plan(moves))
        assert cost + builder.constant_cost(x, given) == pytest.approx(J, rel=1e-8)


def test_the_plan_under_a_terminal_cost_has_no_gradient(ship: Any) -> None:
    """Eq. 26 holds with the terminal cost in E, F_x and F_y alike, held or previewed."""
    problem = replace(ship("supply_tmr", psi0_rad=0.7), terminal="riccati")
    builder, matrices = CondensedQP(problem), condense_matrices(problem)
    rng = np.random.default_rng(9)
    x, preview = rng.normal(size=9), rng.normal(size=(30, 3))
    for y_ref, Y_d in ((preview[0], np.tile(preview[0], 30)), (preview, preview.reshape(-1))):
        q = builder.emit(x, y_ref, np.zeros(3)).q
        z = builder.plan(unconstrained_plan(matrices, x, Y_d).reshape(5, 3))
        np.testing.assert_allclose(builder.P @ z + q, 0.0, atol=1e-9 * np.abs(q).max())
    np.testing.assert_array_equal(builder.P, builder.P.T)


def test_a_plant_that_cannot_be_stabilised_is_refused_by_name(ship: Any) -> None:
    """Three outputs that two inputs cannot steer have no Riccati cost, and an unknown name no
    meaning."""
    rng = np.random.default_rng(2)
    plant = StateSpace(
        0.3 * rng.normal(size=(4, 4)), rng.normal(size=(4, 2)), rng.normal(size=(3, 4))
    )
    one = np.ones(2)
    problem = ControlProblem(
        augment(plant), 5, 2, np.eye(3), np.eye(2), -one, one, one, terminal="riccati"
    )
    with pytest.raises(InputError, match="riccati"):
        CondensedQP(problem)
    with pytest.raises(InputError, match='\'lqr\'; allowed: "none" or "riccati"'):
        replace(ship("supply_fs99"), terminal="lqr")
