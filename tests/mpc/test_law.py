"""The unconstrained law, its gains and eigenvalues, the active-set correction."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.bench.run.formulation import convert_qp_to_one_sided_rows
from dpbench.errors import InputError
from dpbench.mpc.condense import ControlProblem, condense_mpc_matrices
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.law import (
    build_closed_loop_matrix,
    compute_closed_loop_eigenvalues,
    compute_state_feedback_gains,
    compute_unconstrained_increments,
)
from dpbench.mpc.model import StateSpace, augment_to_incremental_model, build_prediction_model
from dpbench.scenario.scenario import load_vessel
from tests.mpc.conftest import VESSELS, naive_build, sample_of, ship_problem, solve_by_quadprog

HORIZONS = {False: {"N_p": 30, "N_c": 5}, True: {"N_p": 60, "N_c": 10}}


def least_squares_plan(problem: Any, x: np.ndarray, Y_d: np.ndarray) -> np.ndarray:
    """The minimiser of eq. 17 as a least-squares problem with Q^½ and R^½, never forming E."""
    parts = naive_build(problem, x, Y_d, np.zeros(problem.model.n_u))
    root_Q, root_R = np.linalg.cholesky(parts.Q_bar).T, np.linalg.cholesky(parts.R_bar).T
    du = parts.move
    rows = np.vstack([root_Q @ parts.Phi, root_R]) * du
    right = np.concatenate([root_Q @ (Y_d.reshape(-1) - parts.F @ x), np.zeros(len(du))])
    return du * np.linalg.lstsq(rows, right, rcond=None)[0]


def test_unconstrained_plan_is_the_least_squares_plan(case: Any) -> None:
    """Eq. 27 minimises the cost, held or previewed, as a least-squares solver finds it."""
    matrices = condense_mpc_matrices(case.problem)
    du = np.tile(case.problem.du_max, case.problem.N_c)
    for Y_d in (case.held, case.preview()):
        expected = least_squares_plan(case.problem, case.x, Y_d) / du
        found = compute_unconstrained_increments(matrices, case.x, Y_d.reshape(-1)) / du
        # Normal equations square the condition number, up to about 1e4 here in scaled units.
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_gains_give_the_first_move_of_the_plan(case: Any) -> None:
    """Eq. 33: K_y y_d − K_mpc x is the first block of the unconstrained plan."""
    problem = case.problem
    law = compute_state_feedback_gains(problem)
    assert law.K_y.shape == (problem.model.n_u, problem.model.n_y)
    assert law.K_mpc.shape == (problem.model.n_u, problem.model.n_x)
    plan = compute_unconstrained_increments(
        condense_mpc_matrices(problem), case.x, case.held.reshape(-1)
    )
    first = law.K_y @ case.y_ref - law.K_mpc @ case.x
    expected = plan[: problem.model.n_u]
    size = np.abs(law.K_y @ case.y_ref) + np.abs(law.K_mpc @ case.x)
    np.testing.assert_allclose(first / size, expected / size, rtol=0, atol=1e-9)


def test_the_output_part_of_the_state_gain_is_the_reference_gain(case: Any) -> None:
    """K_mpc = [K_x K_y]: an offset of the output and one of the reference weigh the same."""
    law, n_y = compute_state_feedback_gains(case.problem), case.problem.model.n_y
    size = np.abs(law.K_y).max(axis=1, keepdims=True)
    np.testing.assert_allclose(law.K_mpc[:, -n_y:] / size, law.K_y / size, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("robust", "radius"),
    # Spectral radii from the least-squares loop of this test, to five digits.
    [(False, 0.94949), (True, 0.96726)],
    ids=["paper", "robust"],
)
def test_the_unconstrained_loop_is_stable(robust: bool, radius: float) -> None:
    problem = ship_problem("supply_fs99", robust=robust, **HORIZONS[robust])
    model, law = problem.model, compute_state_feedback_gains(problem)
    roots = compute_closed_loop_eigenvalues(model, law)
    target = np.zeros((problem.N_p, 3))
    columns = []
    for unit in np.eye(9):
        du = least_squares_plan(problem, unit, target)[:3]
        columns.append(model.A @ unit + model.B @ du)
    expected = np.linalg.eigvals(np.column_stack(columns))
    assert np.abs(roots[0]) == pytest.approx(radius, abs=5e-6)
    assert np.abs(expected).max() == pytest.approx(radius, abs=5e-6)
    assert (np.diff(np.abs(roots)) <= 1e-12).all()
    # Coefficients of the two characteristic polynomials, which do not depend on any pairing.
    np.testing.assert_allclose(np.poly(roots), np.poly(expected), rtol=0, atol=1e-7)


def test_closed_loop_matrix_is_one_step_of_the_loop(case: Any) -> None:
    """Eq. 34: (A − B K_mpc) x + B K_y y_d is the model stepped under the law of eq. 33."""
    model, law = case.problem.model, compute_state_feedback_gains(case.problem)
    du = law.K_y @ case.y_ref - law.K_mpc @ case.x
    after = build_closed_loop_matrix(model, law) @ case.x + model.B @ law.K_y @ case.y_ref
    np.testing.assert_allclose(after, model.A @ case.x + model.B @ du, rtol=1e-9, atol=1e-9)


def test_constrained_plan_is_the_unconstrained_one_less_the_correction(case: Any) -> None:
    """Eq. 31, 32 and 36."""
    builder = CondensedQP(case.problem)
    x, y_ref, n_u = case.x, case.y_ref, case.problem.model.n_u
    active = np.zeros(0, dtype=bool)
    while not active.any():
        x, y_ref = 4.0 * x, 4.0 * y_ref
        qp = builder.problem(builder.emit(x, y_ref, case.u_prev))
        z, y, y_box = solve_by_quadprog(qp)
        lam = np.concatenate([-y, y, -y_box, y_box])
        active = lam > 1e-9 * np.abs(qp.q).max()
    stacked = convert_qp_to_one_sided_rows(qp)
    K0 = np.linalg.solve(qp.P, stacked.A[active].T @ lam[active])
    free = np.linalg.solve(qp.P, -qp.q)
    size = 1e-9 * (1.0 + np.abs(free).max())
    np.testing.assert_allclose(free - K0, z, rtol=0, atol=size)
    law = compute_state_feedback_gains(case.problem)
    move = law.K_y @ y_ref - law.K_mpc @ x - case.problem.du_max * K0[:n_u]
    np.testing.assert_allclose(move / case.problem.du_max, z[:n_u], rtol=0, atol=10 * size)
    M, gamma = stacked.A[active], stacked.u[active]
    inverse = np.linalg.inv(qp.P)
    again = -np.linalg.solve(M @ inverse @ M.T, gamma + M @ inverse @ qp.q)
    np.testing.assert_allclose(again, lam[active], rtol=0, atol=1e-8 * (1.0 + lam.max()))


@pytest.mark.parametrize("psi0_rad", [0.0, 0.7])
@pytest.mark.parametrize("name", VESSELS)
def test_every_ship_is_controllable(name: str, psi0_rad: float) -> None:
    ship = load_vessel(name)
    model = build_prediction_model(ship.M, ship.D, psi0_rad, sample_of(name))
    # The Hautus test, eigenvalue by eigenvalue; all are 0.6 … 1 here, and rows are scaled because
    # positions and rates differ in size.
    for root in np.linalg.eigvals(model.A):
        pencil = np.hstack([root * np.eye(9) - model.A, model.B * np.diag(ship.M)])
        assert np.linalg.svd(pencil, compute_uv=False)[-1] > 1e-6


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
def test_with_a_terminal_cost_the_law_is_the_regulator_at_any_horizon(name: str, N: int) -> None:
    """With N_c = N_p moves the gain of eq. 33 is the LQR gain, whatever the horizon."""
    problem = replace(ship_problem(name, psi0_rad=0.5, N_p=N, N_c=N), terminal="riccati")
    expected = regulator(problem)
    found = compute_state_feedback_gains(problem).K_mpc / problem.du_max[:, np.newaxis]
    # Each column is a gain per unit of one state; the equation and E are solved to about 1e-10.
    size = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=1e-7)
    law = compute_state_feedback_gains(problem)
    axis = np.abs(law.K_y).max(axis=1, keepdims=True)
    np.testing.assert_allclose(law.K_mpc[:, 6:] / axis, law.K_y / axis, rtol=0, atol=1e-9)
    paper = (
        compute_state_feedback_gains(replace(problem, terminal="none")).K_mpc
        / problem.du_max[:, np.newaxis]
    )
    assert np.abs(paper - expected).max() > 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize(("N_p", "N_c"), [(30, 5), (60, 10), (7, 7)])
def test_the_terminal_cost_is_what_the_regulator_still_has_to_pay(N_p: int, N_c: int) -> None:
    """½zᵀPz + qᵀz + J0 is the cost of the horizon and of all steps after it under the regulator."""
    problem = replace(ship_problem("supply_fs99", N_p=N_p, N_c=N_c), terminal="riccati")
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
        cost = builder.problem(step).objective(builder.convert_increments_to_variables(moves))
        assert cost + builder.constant_part_of_cost(x, given) == pytest.approx(J, rel=1e-8)


def test_the_plan_under_a_terminal_cost_has_no_gradient() -> None:
    """Eq. 26 holds with the terminal cost in E, F_x and F_y alike, held or previewed."""
    problem = replace(ship_problem("supply_tmr", psi0_rad=0.7), terminal="riccati")
    builder, matrices = CondensedQP(problem), condense_mpc_matrices(problem)
    rng = np.random.default_rng(9)
    x, preview = rng.normal(size=9), rng.normal(size=(30, 3))
    for y_ref, Y_d in ((preview[0], np.tile(preview[0], 30)), (preview, preview.reshape(-1))):
        q = builder.emit(x, y_ref, np.zeros(3)).q
        z = builder.convert_increments_to_variables(
            compute_unconstrained_increments(matrices, x, Y_d).reshape(5, 3)
        )
        np.testing.assert_allclose(builder.P @ z + q, 0.0, atol=1e-9 * np.abs(q).max())
    np.testing.assert_array_equal(builder.P, builder.P.T)


def test_a_plant_that_cannot_be_stabilised_is_refused_by_name() -> None:
    rng = np.random.default_rng(2)
    plant = StateSpace(
        0.3 * rng.normal(size=(4, 4)), rng.normal(size=(4, 2)), rng.normal(size=(3, 4))
    )
    one = np.ones(2)
    problem = ControlProblem(
        augment_to_incremental_model(plant),
        5,
        2,
        np.eye(3),
        np.eye(2),
        -one,
        one,
        one,
        terminal="riccati",
    )
    with pytest.raises(InputError, match="riccati"):
        CondensedQP(problem)
